"""Two scenes of a pushbroom scanner of one pass, from the orbit of an exact sensor.

The satellite flies at 700 km with the Earth turning below it; its axes turn with the orbit, with a
slow oscillation in roll. Two lines of detectors, 24° ahead and 24° behind, scan the same ground 90
seconds apart. The times of lines and the image coordinates of ground points follow from the orbit
alone, without the model of the adjustment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq

from factorgraph_adj.frames import TopocentricFrame
from factorgraph_adj.models.arcs import arc_places
from factorgraph_adj.models.scanner_lens import LineLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.types import Array

FRAME = TopocentricFrame(np.radians(47.0), np.radians(11.0), 500.0)
GM, SPIN = 3.986004418e14, 7.292115e-5
HEIGHT, GSD = 700e3, 2.5
LINES, SAMPLES = 12_000, 12_000
FOCAL = HEIGHT / GSD
"""Principal distance, px."""
SIGMA_PX, SIGMA_CONTROL = 0.3, 0.3
LOOK = np.radians(24.0)
WOBBLE, PERIOD = 2e-6, 20.0
"""Amplitude, rad, and period, s, of the oscillation in roll: 1.4 m on the ground."""
SIGMA_POSITION, SIGMA_ATTITUDE = 3.0, 2e-5
"""Of the poses at the middle lines, from GNSS and star trackers."""


def _arc() -> Array:
    """Return the orbit, whose epoch is over the middle of the scene."""
    up = FRAME.basis(np.zeros((1, 3)), np.zeros((1, 2))).enu[0]
    place = up[2] * HEIGHT
    south = -up[1] * np.cos(0.15) - up[0] * np.sin(0.15)
    return np.array([*place, *(7500.0 * south), GM, SPIN])


ARC = _arc()


def place(time: float) -> Array:
    """Return the place of the satellite, (3,) metres."""
    return np.asarray(arc_places(FRAME, ARC[None], np.array([time]))[0][0])


def attitude(time: float, look: float) -> Array:
    """Return world_R_camera (3, 3): z along the look, y ahead, to where lines proceed."""
    down = -(FRAME.to_geocentric(place(time)[None])[0]) @ FRAME.axes_in_geocentric.T
    down /= np.linalg.norm(down)
    ahead = place(time + 0.05) - place(time - 0.05)
    ahead -= down * (ahead @ down)
    ahead /= np.linalg.norm(ahead)
    nadir = np.stack([np.cross(ahead, down), ahead, down], axis=1)
    roll = WOBBLE * np.sin(2 * np.pi * time / PERIOD)
    return np.asarray(nadir @ exp_rotation(np.array([-look, roll, 0.0])))


@dataclass(frozen=True)
class Scene:
    """A scene of one line of detectors."""

    look: float
    """Angle of the look ahead, radians."""
    middle: float
    """Time of its middle line, seconds."""
    seconds: float
    """Time that all its lines take."""

    def image(self, ground: Array) -> tuple[float, float] | None:
        """Return x right and y up, px, of a ground point; None: it is outside."""

        def seen(time: float) -> Array:
            p = (ground - place(time)) @ attitude(time, self.look)
            return np.asarray(FOCAL * p[:2] / p[2])

        first, last = self.middle - self.seconds, self.middle + self.seconds
        ends = [seen(t)[1] for t in (first, last)]
        if ends[0] * ends[1] > 0:
            return None
        time = brentq(lambda t: seen(t)[1], first, last, xtol=1e-13)
        x, y = float(seen(time)[0]), -(time - self.middle) / self.seconds * LINES
        return (x, y) if abs(x) < SAMPLES / 2 and abs(y) < LINES / 2 else None


@cache
def scenes() -> tuple[Scene, Scene]:
    """Return the scene that looks ahead and the one that looks back."""
    out = []
    for look in (LOOK, -LOOK):

        def away(time: float, look: float = look) -> float:
            p = -place(time) @ attitude(time, look)
            return float(p[1] / p[2])

        middle = brentq(away, -90.0, 90.0)
        # One line takes the time in which the ground moves by one pixel.
        rate = (away(middle + 0.1) - away(middle - 0.1)) / 0.2
        out.append(Scene(look, middle, abs(LINES / (FOCAL * rate))))
    return out[0], out[1]


@cache
def motion_of(scene: Scene, powers: int) -> Array:
    """Return a motion that fits the orbit at the lines of a scene, (6 powers,)."""
    time = np.linspace(-scene.seconds / 2, scene.seconds / 2, 25)
    at, turn = place(scene.middle), attitude(scene.middle, scene.look)
    away = np.array([place(scene.middle + t) - at for t in time])
    turned = log_rotation(np.array([turn.T @ attitude(scene.middle + t, scene.look) for t in time]))
    a = time[:, None] ** np.arange(1, powers + 1)
    fits = [np.linalg.lstsq(a, values, rcond=None)[0] for values in (away, turned)]
    return np.concatenate(fits, axis=1).ravel()


def ground(n: int, seed: int = 7) -> Array:
    """Return points of hilly ground within the scenes, (n, 3)."""
    rng = np.random.default_rng(seed)
    plan = rng.uniform(-13e3, 13e3, (n, 2))
    height = 400.0 * np.sin(plan[:, 0] / 4e3) + rng.uniform(0.0, 800.0, n)
    height -= np.sum(plan**2, axis=1) / 2 / 6.37e6
    return np.column_stack([plan, height])


@cache
def images(n: int) -> tuple[Array, tuple[tuple[tuple[float, float], ...], ...]]:
    """Return ground points that both scenes see, and their image coordinates in each."""
    points = ground(n)
    found = [[s.image(x) for x in points] for s in scenes()]
    used = [i for i in range(n) if all(f[i] is not None for f in found)]
    return points[used], tuple(tuple(xy for i in used if (xy := f[i])) for f in found)


def pair(
    powers: int = 2,
    *,
    n: int = 60,
    control: int = 9,
    weights: Callable[[int], Array] | None = None,
    noise: int | None = 1,
) -> Network:
    """Return both scenes as measured, with start values from the satellite.

    Args:
        powers: powers of time in the motions.
        n: number of ground points.
        control: number of those that are control; others are check points.
        weights: standard deviations of the motion's components of a power; None: free.
        noise: seed of the errors of measurements; None: none.
    """
    rng = np.random.default_rng(0 if noise is None else noise)
    size = 0.0 if noise is None else 1.0
    network = Network("pushbroom pair", frame=FRAME)
    points, found = images(n)
    used = range(len(points))
    for i in used:
        x, y, z = points[i].tolist()
        rough = points[i] + size * rng.normal(0.0, 30.0, 3)
        network.add_point(f"P{i}", rough, check=(x, y, z))
    for i in used[:: max(1, len(used) // control)][:control]:
        at = points[i] + size * rng.normal(0.0, SIGMA_CONTROL, 3)
        network.add(ControlPoint(f"P{i}", tuple(at.tolist()), sigma=(SIGMA_CONTROL,) * 3))
    for name, scene, seen in zip(("ahead", "back"), scenes(), found, strict=True):
        camera = f"line {name}"
        network.add_camera(
            camera,
            LineLens(),
            {"c": FOCAL},
            unit="px",
            format=(SAMPLES, LINES),
            readout=scene.seconds,
        )
        at = place(scene.middle) + size * rng.normal(0.0, SIGMA_POSITION, 3)
        turn = exp_rotation(size * rng.normal(0.0, SIGMA_ATTITUDE, 3))
        network.add_photo(
            name,
            camera,
            position=at,
            rotation=attitude(scene.middle, scene.look) @ turn,
            sigma_position=(SIGMA_POSITION,) * 3,
            sigma_attitude=SIGMA_ATTITUDE,
        )
        sigma = None
        if weights is not None:
            sigma = np.concatenate([weights(j) for j in range(1, powers + 1)]).tolist()
        network.set_unknown("photo_motion", name, motion_of(scene, powers), sigma=sigma)
        xy = np.array(seen) + size * rng.normal(0.0, SIGMA_PX, (len(used), 2))
        network.add_image_points(name, [f"P{i}" for i in used], xy, sigma=SIGMA_PX)
    return network


def usual_weights(power: int) -> Array:
    """Return standard deviations of what the satellite knows of its motion."""
    if power == 1:
        return np.array([0.05] * 3 + [3e-6] * 3)
    return np.array([1e-3] * 3 + [1e-6] * 3)
