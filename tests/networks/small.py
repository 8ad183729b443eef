"""Networks of redundancy 1 or 2 with one gross error: nearly nothing tells where it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Direction,
    HeightDifference,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.types import Array

TIMES = 20.0
"""Size of the error, in the standard deviation of the reading."""
SIGMA_ANGLE, SIGMA_LENGTH = 1.5e-5, 0.002
"""Standard deviations: radians, metres."""


def small(seed: int) -> Network:
    """Return a network: side shots with one backsight, trilateration, or levelling."""
    rng = np.random.default_rng([seed, 3])
    make = (_side_shots, _trilateration, _levelling)[seed % 3]
    network, readings = make(rng)
    wrong = int(rng.integers(len(readings)))
    spoiled: Any = readings[wrong]
    readings[wrong] = replace(spoiled, value=spoiled.value + TIMES * spoiled.sigma)
    network.add(*readings)
    return network


def _side_shots(rng: np.random.Generator) -> tuple[Network, list[Observation]]:
    network = Network("side shots")
    true = {"S": np.array([0.0, 0.0, 100.0])}
    for i in range(5):
        true[f"P{i}"] = np.append(rng.uniform(-90.0, 90.0, 2), rng.uniform(95.0, 110.0))
    for name, at in true.items():
        network.add_point(name, tuple(at.tolist()), fixed="xyz" if name in ("S", "P0") else "")
    readings: list[Observation] = []
    with_distance = rng.uniform() < 0.5
    for i in range(5):
        target = f"P{i}"
        d = true[target] - true["S"]
        heights: dict[str, Any] = {"instrument_height": 1.5, "target_height": 1.5}
        e, length = rng.normal(0.0, 1.0, 3), float(np.linalg.norm(d))
        azimuth = float(np.arctan2(d[0], d[1]) + SIGMA_ANGLE * e[0]) % (2 * np.pi)
        zenith = float(np.arccos(d[2] / length) + SIGMA_ANGLE * e[1])
        readings.append(Direction("S", target, azimuth, sigma=SIGMA_ANGLE, **heights))
        readings.append(ZenithAngle("S", target, zenith, sigma=SIGMA_ANGLE, **heights))
        if i or with_distance:
            length += SIGMA_LENGTH * float(e[2])
            readings.append(SlopeDistance("S", target, length, sigma=SIGMA_LENGTH, **heights))
    return network, readings


def _trilateration(rng: np.random.Generator) -> tuple[Network, list[Observation]]:
    network = Network("trilateration")
    n = int(rng.integers(3, 5))
    turn = rng.uniform(0.0, 1.0) + 2 * np.pi * np.arange(n) / n
    point: Array = rng.uniform(-30.0, 30.0, 2)
    network.add_point("P", (*point.tolist(), 0.0), fixed="z")
    readings: list[Observation] = []
    for i, a in enumerate(turn.tolist()):
        at = 90.0 * np.array([np.sin(a), np.cos(a)])
        network.add_point(f"A{i}", (*at.tolist(), 0.0), fixed="xyz")
        length = float(np.linalg.norm(at - point) + SIGMA_LENGTH * rng.normal())
        readings.append(HorizontalDistance(f"A{i}", "P", length, sigma=SIGMA_LENGTH))
    return network, readings


def _levelling(rng: np.random.Generator) -> tuple[Network, list[Observation]]:
    network = Network("levelling")
    n = int(rng.integers(3, 6))
    height = rng.uniform(90.0, 110.0, n)
    for i in range(n):
        network.add_point(
            f"B{i}", (10.0 * i, 0.0, float(height[i])), fixed="xyz" if not i else "xy"
        )
    lines = [(i, (i + 1) % n) for i in range(n)]
    if n > 3 and rng.uniform() < 0.5:
        lines.append((0, 2))
    return network, [
        HeightDifference(
            f"B{a}",
            f"B{b}",
            float(height[b] - height[a] + 0.001 * rng.normal()),
            sigma=0.001,
        )
        for a, b in lines
    ]
