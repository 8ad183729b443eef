"""Scenes of a satellite by an exact pushbroom sensor, and rational polynomials fitted to it.

The sensor is independent of the lens model: each line has its own projection centre on a circular
orbit and its own attitude, and the time at which it sees a point is found by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import Frame, GeocentricFrame
from factorgraph_adj.models.rpc_lens import BIAS, NORMALISATION, POWERS, RpcLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array

WGS84 = ellipsoid("WGS84")
PLACE = np.array([6.3, 46.6, 700.0])
"""Longitude and latitude, degrees, and height, metres, of the middle of the scene."""
EXTENT = np.array([0.09, 0.06, 500.0])
"""Half the extent of the scene."""
LINES, SAMPLES = 12_000, 12_000
HEIGHT, SPEED = 620_000.0, 7_500.0
"""Height of the orbit above the scene, metres, and speed, metres per second."""
HEADING = np.radians(190.0)
PIXEL = 1.0
"""Size of a pixel on the ground, metres."""
DURATION = LINES * PIXEL / SPEED
"""Time of a scene, roughly, seconds."""
SIGMA = 0.4
"""Standard deviation of image coordinates, px."""


@dataclass(frozen=True)
class Pushbroom:
    """An exact sensor: line l is exposed at the time (l − LINES/2) PIXEL/speed over ground."""

    pitch: float
    """Angle by which it looks ahead, radians."""
    errors: Array
    """Errors: shift of the orbit (3, metres along flight, across, up), roll, pitch, yaw (3), and
    their rates by the time of the whole scene (3), radians."""

    def image(self, place: Array) -> Array:
        """Return samples and lines (n, 2) of geocentric places (n, 3)."""
        time = np.zeros(len(place))
        for _ in range(12):
            step = 1e-4
            here, there = self._ray(place, time), self._ray(place, time + step)
            time = time - step * here[:, 0] / (there[:, 0] - here[:, 0])
        ray = self._ray(place, time)
        c = HEIGHT / np.cos(self.pitch) / PIXEL
        ground_speed = SPEED * WGS84.a / (WGS84.a + HEIGHT)
        return np.stack([SAMPLES / 2 + c * ray[:, 1], LINES / 2 + time * ground_speed / PIXEL], 1)

    def _ray(self, place: Array, time: Array) -> Array:
        """Return tangents (along, across) of rays in the axes of the sensor at times (n,)."""
        up = CENTRE / np.linalg.norm(CENTRE)
        east = np.cross([0.0, 0.0, 1.0], up)
        east /= np.linalg.norm(east)
        ahead = np.sin(HEADING) * east + np.cos(HEADING) * np.cross(up, east)
        across = np.cross(ahead, up)
        radius = np.linalg.norm(CENTRE) + HEIGHT

        def body(at: Array) -> tuple[Array, Array]:
            angle = (SPEED * at - HEIGHT * np.tan(self.pitch))[:, None] / radius
            return np.cos(angle) * up + np.sin(angle) * ahead, np.cos(angle) * ahead - np.sin(
                angle
            ) * up

        u0, a0 = body(np.zeros(1))
        look = CENTRE - radius * u0[0]
        look /= np.linalg.norm(look)
        u, a = body(time)
        z = (look @ u0[0]) * u + (look @ a0[0]) * a
        y = np.broadcast_to(across, z.shape)
        x = np.cross(y, z)
        roll, pitch, yaw = self.errors[3:6, None] + self.errors[6:, None] * (time / DURATION)
        turn = exp_rotation(np.stack([roll, pitch, yaw], axis=1))
        axes = np.stack([x, y, z], axis=2) @ turn
        at = (radius + self.errors[2]) * u + self.errors[0] * a + self.errors[1] * across
        q = np.einsum("nij,ni->nj", axes, place - at)
        return q[:, :2] / q[:, 2:]


def fitted(sensor: Pushbroom) -> dict[str, float]:
    """Return offsets, scales and coefficients fitted to a sensor on a grid in space."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, n) for n in (11, 11, 5)]), -1)
    lph = grid.reshape(-1, 3) * 1.1
    samples, lines = sensor.image(geocentric(PLACE + lph * EXTENT)).T
    terms = np.prod(lph[:, None, :] ** POWERS, axis=2)
    out = dict(zip(NORMALISATION, [LINES / 2, SAMPLES / 2, *PLACE[[1, 0, 2]]], strict=False))
    out |= dict(zip(NORMALISATION[5:], [LINES / 2, SAMPLES / 2, *EXTENT[[1, 0, 2]]], strict=True))
    for name, values in (("line", lines), ("samp", samples)):
        ratio = (values - out[f"{name}_off"]) / out[f"{name}_scale"]
        a = np.concatenate([terms, -ratio[:, None] * terms[:, 1:]], axis=1)
        found = np.linalg.lstsq(a, ratio, rcond=1e-11)[0]
        for part, numbers in (("num", found[:20]), ("den", [1.0, *found[20:]])):
            out |= {f"{name}_{part}_{i}": float(c) for i, c in enumerate(numbers, 1)}
    return out


def geocentric(places: Array) -> Array:
    """Return geocentric coordinates (n, 3) of longitudes, latitudes (degrees) and heights."""
    longitude, latitude, height = np.asarray(places).T
    return WGS84.to_cartesian(np.radians(latitude), np.radians(longitude), height)


CENTRE = geocentric(PLACE[None])[0]
DELIVERED = {
    "ahead": Pushbroom(np.radians(22.0), np.zeros(9)),
    "down": Pushbroom(np.radians(-3.0), np.zeros(9)),
    "back": Pushbroom(np.radians(-24.0), np.zeros(9)),
}
"""Sensors as orbit and attitude that the operator delivers have them."""
ERRORS = {
    "ahead": (4.0, -6.0, 3.0, 2e-5, -1.5e-5, 2e-5, 1e-6, -1e-6, 1e-6),
    "down": (-3.0, 5.0, -2.0, -1e-5, 2e-5, -1e-5, -1e-6, 1e-6, 1e-6),
    "back": (2.0, 3.0, 4.0, 1.5e-5, 1e-5, 1.5e-5, 1e-6, 1e-6, -1e-6),
}
"""True errors of these, see `Pushbroom.errors`."""
POINTS, CONTROL = 40, 9


def satellites(
    *,
    free: tuple[str, ...] = ("x0", "y0"),
    frame: Frame | None = None,
    seed: int | None = 1,
    placed: bool = False,
) -> tuple[Network, Array]:
    """Return three scenes that the true sensors took, with delivered RPC, and the true points.

    Args:
        free: free parameters of the bias.
        frame: frame of the network; None: geocentric.
        seed: seed of errors of image coordinates; None: they have none.
        placed: whether all points have coordinates; otherwise those of control alone.
    """
    rng = np.random.default_rng(5)
    network = Network("scenes", frame=frame or GeocentricFrame("WGS84"))
    lattice = np.stack(np.meshgrid(*[np.linspace(-0.9, 0.9, 3)] * 2), -1).reshape(-1, 2)
    plan = np.concatenate([lattice, rng.uniform(-0.9, 0.9, (POINTS - CONTROL, 2))])
    height = rng.uniform(-0.6, 0.6, (POINTS, 1))
    true = geocentric(PLACE + np.concatenate([plan, height], axis=1) * EXTENT)
    shown = (
        true if isinstance(network.frame, GeocentricFrame) else network.frame.from_geocentric(true)
    )
    for i, at in enumerate(shown.tolist()):
        known = i < CONTROL
        network.add_point(f"P{i}", at if known or placed else None, fixed="xyz" if known else "")
    noise = np.random.default_rng([seed or 0, 8])
    for name, sensor in DELIVERED.items():
        values = {**dict.fromkeys(BIAS, 0.0), "c": 1.0, **fitted(sensor)}
        network.add_camera(
            name,
            RpcLens(),
            values,
            free=free,
            unit="px",
            format=(SAMPLES, LINES),
            origin="upper left",
            y_down_in_files=True,
        )
        network.add_photo(name, name)
        xy = replace(sensor, errors=np.array(ERRORS[name])).image(true) * [1.0, -1.0]
        xy += 0.0 if seed is None else noise.normal(0.0, SIGMA, xy.shape)
        network.add_image_points(name, list(network.points), xy, sigma=SIGMA)
    return network, shown
