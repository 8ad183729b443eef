"""Levelling, azimuths and long sights whose readings all share one mistake of a given size."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    HeightDifference,
    Observation,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from factorgraph_adj.types import Array

RADIUS = 6_371_000.0
"""Radius of the Earth, metres."""
ANGLE = 1e-5
"""Standard deviation of angles, radians."""


def levelling(seed: int, scale: float) -> Network:
    """Return lines between eight points, three of them held, levelled too large by a ratio."""
    rng = np.random.default_rng([seed, 71])
    network = Network("levelling")
    heights = rng.permutation(np.linspace(0.0, 20.0, 8)) + rng.uniform(0.0, 1.0, 8)
    for i, z in enumerate(heights.tolist()):
        fixed = "xyz" if i < 3 else "xy"
        network.add_point(f"B{i}", (100.0 * i, 7.0, z), fixed=fixed)
    lines = [(i, i + 1) for i in range(7)] + [(0, 3), (1, 4), (2, 6), (5, 7), (3, 7)]
    for i, j in lines:
        rise = (heights[j] - heights[i]) * (1.0 + scale) + 0.001 * rng.normal()
        network.add(HeightDifference(f"B{i}", f"B{j}", float(rise), sigma=0.001))
    return network


def azimuths(seed: int, turn: float) -> Network:
    """Return three set-ups among four held points; the azimuths of S1 are turned, radians."""
    rng = np.random.default_rng([seed, 72])
    network = Network("azimuths")
    true: dict[str, Array] = {
        f"K{i}": np.array([x, y, 100.0 + i])
        for i, (x, y) in enumerate([(0, 0), (110, -5), (120, 95), (-10, 100)])
    }
    for i in range(3):
        true[f"S{i}"] = np.append(rng.uniform(20.0, 90.0, 2), 101.0)
    for i in range(2):
        true[f"P{i}"] = np.append(rng.uniform(10.0, 100.0, 2), rng.uniform(100.0, 120.0))
    for name, at in true.items():
        network.add_point(name, tuple(at.tolist()), fixed="xyz" if name[0] == "K" else "")
    for station, target in permutations(true, 2):
        if station[0] != "S":
            continue
        d = true[target] - true[station]
        length = float(np.linalg.norm(d))
        e = rng.normal(0.0, 1.0, 3)
        azimuth = np.arctan2(d[0], d[1]) + 2 * ANGLE * e[0] + turn * (station == "S1")
        zenith = float(np.arccos(d[2] / length) + 2 * ANGLE * e[1])
        network.add(
            Azimuth(station, target, float(azimuth % (2 * np.pi)), sigma=2 * ANGLE),
            ZenithAngle(station, target, zenith, sigma=2 * ANGLE),
            SlopeDistance(station, target, length + 0.002 * float(e[2]), sigma=0.002),
        )
    return network


def long_sights(seed: int, share: float) -> Network:
    """Return sights of some kilometres in a plane frame.

    Zenith angles are too large by a share of d / 2R; vertical angles (of H3), and readings in face
    2 (of H4), are too small.
    """
    rng = np.random.default_rng([seed, 73])
    network = Network("long sights")
    corners = [(0, 0), (2400, 100), (800, 900), (1500, -700), (-300, 1700)]
    true = {
        f"H{i}": np.append(xy + rng.uniform(-200.0, 200.0, 2), rng.uniform(50.0, 150.0))
        for i, xy in enumerate(corners)
    }
    for i, (name, at) in enumerate(true.items()):
        network.add_point(name, tuple(at.tolist()), fixed="xyz" if i < 2 else "")
    for station, target in permutations(true, 2):
        d = true[target] - true[station]
        length, plan = float(np.linalg.norm(d)), float(np.hypot(d[0], d[1]))
        e = rng.normal(0.0, 1.0, 3)
        azimuth = float((np.arctan2(d[0], d[1]) + ANGLE * e[0]) % (2 * np.pi))
        zenith = float(np.arccos(d[2] / length) + ANGLE * e[1] + share * plan / (2 * RADIUS))
        inclined: dict[str, Observation] = {
            "H3": VerticalAngle(station, target, 0.5 * np.pi - zenith, sigma=ANGLE),
            "H4": ZenithAngle(station, target, 2.0 * np.pi - zenith, face=2, sigma=ANGLE),
        }
        network.add(
            Direction(station, target, azimuth, sigma=ANGLE),
            inclined.get(station, ZenithAngle(station, target, zenith, sigma=ANGLE)),
            SlopeDistance(station, target, length + 0.004 * float(e[2]), sigma=0.004),
        )
    return network


def prisms(seed: int, constant: float) -> Network:
    """Return four set-ups in a yard; all distances to K7, with another prism, are too long."""
    rng = np.random.default_rng([seed, 74])
    network = Network("prisms")
    true = {f"K{i}": np.append(rng.uniform(0.0, 120.0, 2), 100.0) for i in range(7)}
    true["K7"] = np.array([60.0, 60.0, 100.0])
    for i, (name, at) in enumerate(true.items()):
        network.add_point(name, tuple(at.tolist()), fixed="z" if i > 1 else "xyz")
    stations = [f"K{i}" for i in (2, 3, 4, 5)]
    for station, target in permutations(true, 2):
        if station not in stations:
            continue
        d = true[target] - true[station]
        e = rng.normal(0.0, 1.0, 2)
        azimuth = float((np.arctan2(d[0], d[1]) + 2 * ANGLE * e[0]) % (2 * np.pi))
        length = float(np.hypot(d[0], d[1]) + 0.002 * e[1] + constant * (target == "K7"))
        network.add(
            Direction(station, target, azimuth, sigma=2 * ANGLE),
            SlopeDistance(station, target, length, sigma=0.002),
        )
    return network


MISTAKES: dict[str, tuple[Callable[[int, float], Network], float, str]] = {
    "the scale of levelled height differences (staff or line of sight)": (
        levelling,
        0.0025,
        "everywhere",
    ),
    "the north of azimuths": (azimuths, 0.03, "at station 'S1'"),
    "the curvature of the Earth or refraction": (long_sights, 0.87, "everywhere"),
    "the zero constant (prism constant) of distances": (prisms, 0.0175, "to 'K7'"),
}
"""The network, the size, and the place of each mistake."""


YARD: dict[str, tuple[float, float, float]] = {
    "K0": (0.0, 0.0, 100.0),
    "K1": (110.0, -5.0, 102.0),
    "K2": (120.0, 95.0, 104.0),
    "K3": (-10.0, 100.0, 101.0),
    "S0": (30.0, 25.0, 100.5),
    "S1": (80.0, 30.0, 101.5),
    "S2": (70.0, 75.0, 102.0),
    "P0": (50.0, 50.0, 110.0),
    "P1": (55.0, 45.0, 104.0),
}
"""Points of a yard that was measured at several epochs: held ones K, stations S, objects P."""


def yard(
    seed: int,
    *,
    height: float = 0.0,
    constant: float = 0.0,
    exchanged: bool = False,
    shift: float = 0.0,
) -> Network:
    """Return one epoch of the yard.

    Args:
        seed: what draws the errors.
        height: error of the recorded height of the instrument at S1, metres.
        constant: what all distances are too long by, metres.
        exchanged: whether P0 and K2 have one another's names, seen from S1.
        shift: how far P1 moved to the east, metres.
    """
    rng = np.random.default_rng([seed, 75])
    network = Network(f"epoch {seed}")
    for name, at in YARD.items():
        network.add_point(name, at, fixed="xyz" if name[0] == "K" else "")
    true = {name: np.array(at) for name, at in YARD.items()}
    true["P1"][0] += shift
    other = {"P0": "K2", "K2": "P0"}
    for station, target in permutations(YARD, 2):
        if station[0] != "S":
            continue
        d = true[target] - true[station] - [0.0, 0.0, 0.1]  # instrument 1.6 m, target 1.5 m
        length, e = float(np.linalg.norm(d)), rng.normal(0.0, 1.0, 3)
        azimuth = float((np.arctan2(d[0], d[1]) + 2 * ANGLE * e[0]) % (2 * np.pi))
        zenith = float(np.arccos(d[2] / length) + 2 * ANGLE * e[1])
        length += 0.002 * float(e[2]) + constant
        above = 1.6 + height * (station == "S1")
        heights = {"instrument_height": above, "target_height": 1.5}
        name = other.get(target, target) if exchanged and station == "S1" else target
        network.add(
            Direction(station, name, azimuth, sigma=2 * ANGLE, **heights),
            ZenithAngle(station, name, zenith, sigma=2 * ANGLE, **heights),
            SlopeDistance(station, name, length, sigma=0.002, **heights),
        )
    return network
