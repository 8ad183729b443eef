"""A building site: total stations with heights of instruments and targets, and GNSS vectors."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Direction,
    GnssVector,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.types import Array

STATIONS, TARGETS, SIGHTS, VECTORS = 6, 12, 10, 14
"""Numbers of stations, of targets, of targets that each station sees, and of GNSS vectors."""
SIGMA_ANGLE, SIGMA_DISTANCE, SIGMA_VECTOR = 1.5e-5, 0.002, (0.004, 0.004, 0.008)
"""Standard deviations: radians (1 mgon), metres, metres."""
CONTROL = ("T0", "T1", "T2", "T3")
"""Held points."""
ROVER, BASE = 1.7, 1.6
"""Heights of the antennas, metres."""


def places(rng: np.random.Generator) -> dict[str, Array]:
    """Return true coordinates (3,), metres."""
    turn = 2 * np.pi * np.arange(STATIONS) / STATIONS
    out = {
        f"S{i}": np.array([60 * np.cos(a), 60 * np.sin(a), 0.0])
        + np.append(rng.normal(0.0, 5.0, 2), rng.uniform(0.0, 6.0))
        for i, a in enumerate(turn.tolist())
    }
    for i in range(TARGETS):
        out[f"T{i}"] = np.append(rng.uniform(-90.0, 90.0, 2), rng.uniform(-5.0, 15.0))
    return out


def described(true: dict[str, Array], rng: np.random.Generator) -> Network:
    """Return the points, with rough coordinates where they are not held."""
    network = Network("building site")
    for name, at in true.items():
        held = name in CONTROL
        near = at if held else at + rng.normal(0.0, 0.05, 3)
        network.add_point(name, tuple(near.tolist()), fixed="xyz" if held else "")
    return network


def sights(true: dict[str, Array], rng: np.random.Generator) -> list[Observation]:
    """Return readings with noise: direction, zenith angle and slope distance of every sight."""
    out: list[Observation] = []
    for number in range(STATIONS):
        station, height = f"S{number}", round(1.5 + 0.1 * float(rng.normal()), 3)
        others = [n for n in true if n != station]
        orientation = rng.uniform(0.0, 2 * np.pi)
        for target in sorted(rng.choice(others, SIGHTS, replace=False).tolist()):
            above = 0.1 if target.startswith("T") else 1.3
            d = true[target] + [0.0, 0.0, above] - true[station] - [0.0, 0.0, height]
            length = float(np.linalg.norm(d))
            noise = rng.normal(0.0, 1.0, 3)
            direction = np.arctan2(d[0], d[1]) - orientation + SIGMA_ANGLE * noise[0]
            zenith = np.arccos(d[2] / length) + SIGMA_ANGLE * noise[1]
            heights = {"instrument_height": height, "target_height": above}
            out += [
                Direction(
                    station, target, float(direction % (2 * np.pi)), sigma=SIGMA_ANGLE, **heights
                ),
                ZenithAngle(station, target, float(zenith), sigma=SIGMA_ANGLE, **heights),
                SlopeDistance(
                    station,
                    target,
                    length + SIGMA_DISTANCE * float(noise[2]),
                    sigma=SIGMA_DISTANCE,
                    **heights,
                ),
            ]
    return out


def vectors(true: dict[str, Array], rng: np.random.Generator) -> list[Observation]:
    """Return GNSS vectors from three bases, with noise."""
    bases = ("S0", "S2", "T4")
    out: list[Observation] = []
    for number in range(VECTORS):
        base = bases[number % len(bases)]
        rover = str(rng.choice([n for n in true if n not in bases]))
        d = true[rover] + [0.0, 0.0, ROVER] - true[base] - [0.0, 0.0, BASE]
        value = tuple((d + rng.normal(0.0, SIGMA_VECTOR)).tolist())
        out.append(
            GnssVector(
                base,
                rover,
                value,
                sigma=SIGMA_VECTOR,
                instrument_height=BASE,
                target_height=ROVER,
            )
        )
    return out


def site(seed: int) -> tuple[Network, list[Observation], dict[str, Array]]:
    """Return the points, the readings, and the true coordinates."""
    rng = np.random.default_rng(seed)
    true = places(rng)
    network = described(true, rng)
    return network, [*sights(true, rng), *vectors(true, rng)], true
