"""Simulated geocentric combined block with every kind of observation.

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
from ..stochastic import StandardDeviation
from ..types import Array
from ..units import ARCSEC
from .simulate import Seed, SimulatedNetwork, Truth, disturb, look_at, measure

MILLIMETRE = 1e-3

GEOMETRY = 1986
"""Seed of the geometry: every simulation has the same block."""
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
PRISM = 0.25
"""Height of the reflector on a signalised point, metres."""

REFRACTION = {"morning": 0.21, "noon": 0.08, "": 0.13}
"""True coefficients of refraction: two free ones for the zenith angles of four pillars each, and a
weighted one for the vertical angles."""
DISTANCE_METER = "EDM"
SCALE, ZERO = 4.0e-6, 2.3 * MILLIMETRE
"""True scale and zero constant of the distance meter, free."""

CAMERA = "drone"
CALIBRATION = {
    "c": 24.31,
    "x0": 0.05,
    "y0": -0.08,
    "k1": -1.3e-4,
    "k2": 1.1e-7,
    "p1": 6e-6,
    "p2": -4e-6,
}
"""True calibration, mm; all of it is free. The sensor has 36 × 24 mm."""
SENSOR = (36.0, 24.0)
LEVER_ARM = (0.12, -0.05, -0.21)
"""Vector from the projection centre to the antenna of the drone, metres."""

SIGMA_ANGLE = StandardDeviation(constant=1.0 * ARCSEC, centring_target=0.3 * MILLIMETRE)
SIGMA_DISTANCE = StandardDeviation(constant=1.0 * MILLIMETRE, ppm=1.0)
SIGMA_LEVELLING = StandardDeviation(per_sqrt_km=0.7 * MILLIMETRE)
SIGMA_AZIMUTH = 3.0 * ARCSEC
SIGMA_ASTRONOMIC = 0.3 * ARCSEC
SIGMA_DEFLECTION = 5.0 * ARCSEC
SIGMA_REFRACTION = 0.05
SIGMA_IMAGE = 2e-3
"""Standard deviation of image coordinates, mm."""


def simulate_geocentric_block(seed: Seed) -> SimulatedNetwork:
    """Simulate the measurements of the quarry in a geocentric frame (GRS80).

    Args:
        seed: seed of measuring errors and approximate values; the block is always the same.

    Returns:
        The network with approximate values (errors of 0.3 m for points and projection centres,
        1° for attitudes), and the truth.
    """
    plan = Network("quarry, simulated", frame=GeocentricFrame())
    rng = np.random.default_rng([GEOMETRY])
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
    plan.add_camera(CAMERA, BrownForwardLens(), CALIBRATION, free=CALIBRATION)
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
            np.abs(p[:, :2] / p[:, 2:]) < 0.48 * np.array(SENSOR) / CALIBRATION["c"], axis=1
        )
        photo = f"photo {i + 1:02d}"
        plan.add_photo(
            photo, CAMERA, position=QUARRY.to_geocentric(at).tolist(), rotation=turn.T @ rotation
        )
        chosen = [n for n, s in zip(names, seen, strict=True) if s]
        plan.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE)
        plan.add(PhotoPosition(photo, (0.0, 0.0, 0.0), covariance=sigma, lever_arm=LEVER_ARM))
