"""Simulated blocks: aerial ones of any size, a geocentric one with every kind of observation.

Vertical photos 150 m above a terrain with 20 m of relief, 70 % overlap along and 40 % across
unless another overlap is asked for, every second strip flown backwards; with this overlap points
are seen in five to six photos on average. The datum comes from GNSS positions of the photos and
four control points; the camera is self-calibrated.

A quarry of 300 × 200 m with 30 signalised points, surveyed from eight pillars up to 1.3 km
apart with height differences up to 150 m, and from ten photos of a drone. The block has all kinds
of observations and unknowns of the library: slope and horizontal distances with scale and zero
constant of the distance meter, vertical and zenith angles with three coefficients of
refraction, directions in one or two sets, horizontal angles, azimuths, levelling, astronomic
latitude and longitude, GNSS vectors (including a correlated pair), GNSS positions, one height,
photo positions with a lever arm, image coordinates with a self-calibrating camera, and a
deflection of the vertical for each pillar. Instruments and targets stand above their points.
"""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from ..errors import InputError
from ..frames import GeocentricFrame, TopocentricFrame
from ..models.lens import BrownForwardLens
from ..network.network import Network
from ..observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    ControlPoint,
    Correlated,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    PhotoPosition,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ..rotation import world_R_camera
from ..stochastic_model import StandardDeviation
from ..types import Array, Index
from ..units import ARCSEC, MILLIMETRE
from .generate.scene import corners
from .measurement import Seed, SimulatedNetwork, Truth, disturb, look_at, measure

AERIAL_GEOMETRY_SEED = 2000
"""Seed of the geometry; blocks of equal size are equal."""
HEIGHT = 150.0
"""Flying height, metres."""
RELIEF = 10.0
"""Amplitude of the terrain, metres."""
AERIAL_SENSOR_MM = (36.0, 24.0)
"""Width of the sensor across and along the strip, mm."""
OVERLAP = (0.4, 0.7)
"""Overlap of the photos across and along the strip, where no other one is asked for."""
AERIAL_CAMERA = "camera"
AERIAL_CALIBRATION = {
    "c": 35.1,
    "x0": 0.04,
    "y0": -0.03,
    "k1": -6e-5,
    "k2": 2e-8,
    "p1": 3e-6,
    "p2": 2e-6,
}
"""True calibration, mm; all of it is free."""
SIGMA_IMAGE_MM = 2e-3
"""Standard deviation of image coordinates, mm."""
SIGMA_GNSS = (0.02, 0.02, 0.04)
"""Standard deviations of the photos' GNSS positions, X, Y, Z, metres."""
SIGMA_CONTROL = (0.01, 0.01, 0.01)
"""Standard deviations of control points, X, Y, Z, metres."""
GEOCENTRIC_GEOMETRY_SEED = 1986
"""Seed of the geometry: every simulation has the same block."""
PRISM = 0.25
"""Height of the reflector on a signalised point, metres."""
QUARRY = TopocentricFrame(np.deg2rad(47.2), np.deg2rad(8.8), 620.0)
"""Topocentric frame of the block; its geocentric frame is the frame of the network."""
PILLARS = {
    # East, north, up, metres; height of instrument and target.
    "A": ((-420.0, -260.0, 12.0), 1.47),
    "B": ((380.0, -350.0, 45.0), 1.52),
    "C": ((520.0, 310.0, 118.0), 1.39),
    "D": ((-350.0, 420.0, 64.0), 1.61),
    "E": ((-90.0, -140.0, 3.0), 1.55),
    "F": ((130.0, -120.0, 8.0), 1.44),
    "G": ((160.0, 150.0, 21.0), 1.58),
    "H": ((-140.0, 170.0, 150.0), 1.41),
}
ASTRONOMIC = ("A", "C", "H")
"""Pillars with astronomic latitude and longitude; their deflections are free, the deflections
of the other pillars are weighted."""
REFRACTION = {"morning": 0.21, "noon": 0.08, "": 0.13}
"""True coefficients of refraction: two free ones for the zenith angles of four pillars each, and a
weighted one for the vertical angles."""
DISTANCE_METER = "EDM"
SCALE, ZERO = 4.0e-6, 2.3 * MILLIMETRE
"""True scale and zero constant of the distance meter, free."""
DRONE_CAMERA = "drone"
DRONE_CALIBRATION = {
    "c": 24.31,
    "x0": 0.05,
    "y0": -0.08,
    "k1": -1.3e-4,
    "k2": 1.1e-7,
    "p1": 6e-6,
    "p2": -4e-6,
}
"""True calibration, mm; all of it is free. The sensor has 36 × 24 mm."""
DRONE_SENSOR_MM = (36.0, 24.0)
LEVER_ARM = (0.12, -0.05, -0.21)
"""Vector from the projection centre to the antenna of the drone, metres."""
SIGMA_ANGLE = StandardDeviation(constant=1.0 * ARCSEC, centring_target=0.3 * MILLIMETRE)
SIGMA_DISTANCE = StandardDeviation(constant=1.0 * MILLIMETRE, ppm=1.0)
SIGMA_LEVELLING = StandardDeviation(per_sqrt_km=0.7 * MILLIMETRE)
SIGMA_AZIMUTH = 3.0 * ARCSEC
SIGMA_ASTRONOMIC = 0.3 * ARCSEC
SIGMA_DEFLECTION = 5.0 * ARCSEC
SIGMA_REFRACTION = 0.05


def simulate_aerial_block(
    seed: Seed,
    *,
    image_points: int = 10_000,
    points_per_photo: int = 1000,
    overlap: tuple[float, float] = OVERLAP,
) -> SimulatedNetwork:
    """Simulate the measurements of an aerial block.

    Args:
        seed: seed of measuring errors and approximate values.
        image_points: approximate number of image points, with 2 coordinates each.
        points_per_photo: approximate number of image points in one photo.
        overlap: overlap of the photos across and along the strip, as parts of a photo.

    Returns:
        The network with approximate values (errors of 1 m for points, 1 m and 1° for photos; only
        c for the camera), and the truth.
    """
    photos = round(image_points / points_per_photo)
    if photos < 4 or points_per_photo < 20:
        raise InputError(
            f"{image_points} image points, {points_per_photo} in a photo, make {photos} photos; "
            "a block needs 4 photos with 20 points"
        )
    c = AERIAL_CALIBRATION["c"]
    footprint = HEIGHT / c * np.array(AERIAL_SENSOR_MM)
    base = footprint * (1 - np.array(overlap))
    # The block is as square as possible; the strips run along Y.
    strips = max(1, round(np.sqrt(photos * base[1] / base[0])))
    in_strip = [len(part) for part in np.array_split(np.arange(photos), strips)]
    spacing = float(np.sqrt(footprint.prod() / points_per_photo))
    grid = _terrain(spacing, base * [strips - 1, max(in_strip) - 1], footprint)

    plan = Network(f"aerial block of {photos} photos, simulated")
    rng = np.random.default_rng([AERIAL_GEOMETRY_SEED, photos, points_per_photo])
    poses: list[tuple[Array, Array]] = []
    for strip, n in enumerate(in_strip):
        for k in range(n):
            at = np.array([strip * base[0], k * base[1], HEIGHT])
            at += rng.normal(0.0, [3.0, 3.0, 2.0])
            omega, phi, turn = rng.normal(0.0, np.deg2rad(2.0), 3)
            poses.append((at, world_R_camera(omega, phi, turn + np.pi * (strip % 2))))
    seen = [_seen(grid, spacing, footprint, *pose) for pose in poses]
    rays = np.bincount(np.concatenate(seen), minlength=grid.size // 3)
    used = np.flatnonzero(rays >= 2)
    names = np.array([f"{i}" for i in range(len(rays))], dtype=object)
    points = grid.reshape(-1, 3)
    plan.add_points(names[used].tolist(), points[used])
    plan.add_camera(AERIAL_CAMERA, BrownForwardLens(), AERIAL_CALIBRATION, free=AERIAL_CALIBRATION)
    for i, ((at, rotation), inside) in enumerate(zip(poses, seen, strict=True)):
        chosen = names[inside[rays[inside] >= 2]].tolist()
        photo = f"photo {i}"
        plan.add_photo(photo, AERIAL_CAMERA, position=at.tolist(), rotation=rotation)
        plan.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE_MM)
        plan.add(PhotoPosition(photo, (0.0, 0.0, 0.0), sigma=SIGMA_GNSS))
    for corner in used[corners(points[used, :2])].tolist():
        plan.add(ControlPoint(names[corner], tuple(points[corner].tolist()), sigma=SIGMA_CONTROL))
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=1.0, centres=1.0, attitudes=np.deg2rad(1.0)
    )
    del network.cameras[AERIAL_CAMERA]
    network.add_camera(AERIAL_CAMERA, BrownForwardLens(), {"c": 35.0}, free=AERIAL_CALIBRATION)
    return SimulatedNetwork(network, Truth.of(plan))


def _terrain(spacing: float, extent: Array, footprint: Array) -> Array:
    """Return a jittered grid of points (columns, rows, 3), metres, under the whole block."""
    first = -footprint / 2
    columns, rows = np.ceil((extent + footprint) / spacing).astype(int) + 1
    rng = np.random.default_rng([AERIAL_GEOMETRY_SEED, columns, rows])
    x = first[0] + spacing * np.arange(columns)[:, None]
    y = first[1] + spacing * np.arange(rows)[None, :]
    x, y = (a + rng.uniform(-0.3, 0.3, (columns, rows)) * spacing for a in (x, y))
    z = RELIEF * np.sin(x / 60.0) * np.cos(y / 45.0) + rng.uniform(0.0, 2.0, x.shape)
    return np.stack([x, y, z], axis=2)


def _seen(grid: Array, spacing: float, footprint: Array, at: Array, rotation: Array) -> Index:
    """Return the numbers of the grid points that are on a photo."""
    rows = grid.shape[1]
    # Only the part of the grid near the photo is projected.
    reach = 0.8 * footprint
    low = np.floor((at[:2] - reach + footprint / 2) / spacing).astype(int).clip(0)
    high = np.ceil((at[:2] + reach + footprint / 2) / spacing).astype(int) + 1
    window = grid[low[0] : high[0], low[1] : high[1]]
    p = (window - at) @ rotation
    t = np.abs(p[..., :2] / p[..., 2:])
    i, j = np.nonzero(np.all(t < np.array(AERIAL_SENSOR_MM) / 2 / AERIAL_CALIBRATION["c"], axis=2))
    return np.asarray((i + low[0]) * rows + (j + low[1]), dtype=np.intp)


def simulate_geocentric_block(seed: Seed) -> SimulatedNetwork:
    """Simulate the measurements of the quarry in a geocentric frame (GRS80).

    Args:
        seed: seed of measuring errors and approximate values; the block is always the same.

    Returns:
        The network with approximate values (errors of 0.3 m for points and projection centres,
        1° for attitudes), and the truth.
    """
    plan = Network("quarry, simulated", frame=GeocentricFrame())
    rng = np.random.default_rng([GEOCENTRIC_GEOMETRY_SEED])
    targets = _add_unknowns(plan, rng)
    _add_total_stations(plan, targets)
    _add_levelling_and_astronomy(plan)
    _add_gnss(plan)
    _add_photos(plan, targets)
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=0.3, centres=0.3, attitudes=np.deg2rad(1.0)
    )
    return SimulatedNetwork(network, Truth.of(plan))


def _add_unknowns(plan: Network, rng: np.random.Generator) -> dict[str, Array]:
    """Add points, deflections, refraction and distance meter; return the targets, e, n, u."""
    quarry = rng.uniform([-150.0, -100.0, -20.0], [150.0, 100.0, 15.0], (30, 3))
    targets = {f"T{i:02d}": enu for i, enu in enumerate(quarry, 1)}
    for name, (enu, _) in PILLARS.items():
        plan.add_point(name, QUARRY.to_geocentric(np.array(enu)).tolist())
    for name, enu in targets.items():
        plan.add_point(name, QUARRY.to_geocentric(enu).tolist())
    for name in PILLARS:
        xi, eta = SIGMA_DEFLECTION * rng.standard_normal(2)
        sigma = None if name in ASTRONOMIC else SIGMA_DEFLECTION
        plan.set_vertical(name, xi=xi, eta=eta, sigma=sigma)
    for group, value in REFRACTION.items():
        plan.set_refraction(group, value=value, sigma=None if group else SIGMA_REFRACTION)
    plan.set_distance_meter(DISTANCE_METER, scale=SCALE, zero=ZERO, free=("scale", "zero"))
    return targets


def _add_total_stations(plan: Network, targets: dict[str, Array]) -> None:
    """Add the observations of the total stations to all pillars and two of three targets."""
    names = list(PILLARS)
    for i, station in enumerate(names):
        others = [p for p in names if p != station]
        seen = [t for k, t in enumerate(targets) if (k + i) % 3]
        for s, marks in (("1", [*others, *seen]), ("2", others if i % 2 else ())):
            if marks:
                plan.set_orientation(station, set=s, value=0.4 + i + 0.1 * int(s))
            for mark in marks:
                above = _above(station, mark)
                plan.add(Direction(station, mark, 0.0, sigma=SIGMA_ANGLE, set=s, **above))
        for mark in others:
            above = _above(station, mark)
            group = "morning" if i < 4 else "noon"
            plan.add(
                SlopeDistance(
                    station, mark, 0.0, sigma=SIGMA_DISTANCE, instrument=DISTANCE_METER, **above
                ),
                ZenithAngle(station, mark, 0.0, sigma=SIGMA_ANGLE, refraction=group, **above),
            )
        for mark in seen:
            above = _above(station, mark)
            plan.add(
                HorizontalDistance(
                    station, mark, 0.0, sigma=SIGMA_DISTANCE, instrument=DISTANCE_METER, **above
                ),
                VerticalAngle(station, mark, 0.0, sigma=SIGMA_ANGLE, **above),
            )
        back, fore = others[0], others[3]
        plan.add(
            HorizontalAngle(
                station,
                back,
                fore,
                0.0,
                sigma=SIGMA_ANGLE,
                **_above(station, back),
                target2_height=_height(fore),
            )
        )


class _Above(TypedDict):
    """Heights of instrument and target above their points, metres."""

    instrument_height: float
    target_height: float


def _above(here: str, there: str) -> _Above:
    return {"instrument_height": _height(here), "target_height": _height(there)}


def _height(name: str) -> float:
    return PILLARS[name][1] if name in PILLARS else PRISM


def _add_levelling_and_astronomy(plan: Network) -> None:
    names = list(PILLARS)
    for here, there in zip(names, names[1:] + names[:1], strict=True):
        plan.add(HeightDifference(here, there, 0.0, sigma=SIGMA_LEVELLING))
    for station in ASTRONOMIC:
        plan.add(
            AstronomicLatitude(station, 0.0, sigma=SIGMA_ASTRONOMIC),
            AstronomicLongitude(station, 0.0, sigma=SIGMA_ASTRONOMIC),
        )
    for here, there in (("A", "C"), ("B", "D"), ("H", "B")):
        plan.add(Azimuth(here, there, 0.0, sigma=SIGMA_AZIMUTH))


def _covariance(east: float, north: float, up: float) -> Array:
    """Return the geocentric covariance (3, 3) of standard deviations in e, n, u, metres.

    North and up have a correlation of 0.4, as the northern sky has no satellites.
    """
    correlation = np.eye(3)
    correlation[1, 2] = correlation[2, 1] = 0.4
    sigma = np.array([east, north, up])
    turn = _enu()
    return np.asarray(turn.T @ (correlation * np.outer(sigma, sigma)) @ turn)


def _enu() -> Array:
    """Return the rows e, n, u of the quarry in geocentric axes, (3, 3)."""
    return QUARRY.to_geocentric(np.eye(3)) - QUARRY.to_geocentric(np.zeros((1, 3)))


def _add_gnss(plan: Network) -> None:
    """Add GNSS vectors, GNSS positions that define the datum, and one levelled height."""
    zero = (0.0, 0.0, 0.0)
    vector = _covariance(2.0 * MILLIMETRE, 2.0 * MILLIMETRE, 5.0 * MILLIMETRE)
    for here, there in (("A", "B"), ("B", "C"), ("C", "D"), ("D", "A")):
        plan.add(
            GnssVector(
                here,
                there,
                zero,
                covariance=vector,
                **_above(here, there),
            )
        )
    # The two vectors from one occupation of H have its errors in common.
    together: Array = np.kron(np.array([[1.0, 0.5], [0.5, 1.0]]), vector)
    pair = [
        GnssVector(
            "H",
            there,
            zero,
            covariance=vector,
            **_above("H", there),
        )
        for there in ("A", "C")
    ]
    plan.add(Correlated(tuple(pair), together))
    position = _covariance(4.0 * MILLIMETRE, 4.0 * MILLIMETRE, 9.0 * MILLIMETRE)
    for name in ("A", "C", "D"):
        plan.add(GnssPosition(name, plan.points[name].coordinates, covariance=position))
    height = plan.points["B"].coordinates
    plan.add(ControlPoint("B", height, axes="u", sigma=(3.0 * MILLIMETRE,)))


def _add_photos(plan: Network, targets: dict[str, Array]) -> None:
    """Add ten photos from a height of about 120 m, with different tilts and headings."""
    plan.add_camera(DRONE_CAMERA, BrownForwardLens(), DRONE_CALIBRATION, free=DRONE_CALIBRATION)
    names, points = list(targets), np.array(list(targets.values()))
    turn = _enu()
    sigma = _covariance(15.0 * MILLIMETRE, 15.0 * MILLIMETRE, 30.0 * MILLIMETRE)
    for i in range(10):
        at = np.array([-140.0 + 70.0 * (i % 5), -60.0 + 120.0 * (i // 5), 118.0 + 6.0 * (i % 3)])
        rotation = look_at(at, at * [0.55, 0.3, 0.0] + [6.0, 4.0, 0.0])
        if i % 2:
            # Every second photo is turned by 90°, which separates principal point and tilt.
            rotation = rotation @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        p = (points - at) @ rotation
        seen = (p[:, 2] > 0) & np.all(
            np.abs(p[:, :2] / p[:, 2:]) < 0.48 * np.array(DRONE_SENSOR_MM) / DRONE_CALIBRATION["c"],
            axis=1,
        )
        photo = f"photo {i + 1:02d}"
        plan.add_photo(
            photo,
            DRONE_CAMERA,
            position=QUARRY.to_geocentric(at).tolist(),
            rotation=turn.T @ rotation,
        )
        chosen = [n for n, s in zip(names, seen, strict=True) if s]
        plan.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE_MM)
        plan.add(PhotoPosition(photo, (0.0, 0.0, 0.0), covariance=sigma, lever_arm=LEVER_ARM))
