"""A day at a total station, with targets whose names were exchanged at some set-ups."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Direction,
    GnssPosition,
    HeightDifference,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.types import Array

SIGMA_ANGLE, SIGMA_DISTANCE, SIGMA_LEVEL = 8e-6, 0.0015, 0.0003
"""Standard deviations: radians (0.5 mgon), metres, metres."""
SIGMA_GNSS = (0.006, 0.006, 0.010)
"""Standard deviations of positions, metres."""
ABOVE = 1.5
"""Height of all targets, metres."""
FEWEST, MOST = 10, 60
"""Numbers of targets."""
STATIONS = (2, 4)
"""Numbers of set-ups."""


@dataclass(frozen=True)
class Exchanged:
    """Two targets with each other's names at a station."""

    station: str
    pair: tuple[str, str]
    told: bool
    """Whether two others at least say where one of them is: then no other single exchange, and no
    other name, makes all readings fit."""


@dataclass(frozen=True)
class Day:
    """A network, what was exchanged in it, and the truth."""

    network: Network
    exchanged: tuple[Exchanged, ...]
    true: dict[str, Array]


def day(seed: int, *, exchanges: int | None = None, most: int = MOST) -> Day:
    """Return a day with one to three exchanges, or another number; even seeds have coordinates.

    Args:
        seed: seed of everything that is drawn.
        exchanges: number of exchanges; none: drawn.
        most: largest number of targets.
    """
    rng = np.random.default_rng([seed, 36])
    n = round(float(np.exp(rng.uniform(np.log(FEWEST), np.log(most)))))
    stations = [f"S{i}" for i in range(1, int(rng.integers(STATIONS[0], STATIONS[1] + 1)) + 1)]
    targets = [f"P{i}" for i in range(1, n + 1)]
    true = _places(rng, stations, targets)
    readings = _sights(rng, true, stations, targets)
    levelled = rng.permutation(targets)[: int(rng.integers(0, n // 2 + 1))].tolist()
    seen = {
        s: sorted({o.target for o in readings if o.station == s} - {*stations}) for s in stations
    }
    number = int(rng.integers(1, 4)) if exchanges is None else exchanges
    gnss = ["P1", "P2", "P3"]
    swapped = _drawn(rng, seen, number)
    network = Network(f"day {seed}")
    for name, at in true.items():
        near = None if seed % 2 else tuple((at + rng.normal(0.0, 0.1, 3)).tolist())
        network.add_point(name, near)
    names = {(s, a): b for s, (a, b) in swapped} | {(s, b): a for s, (a, b) in swapped}
    network.add(*(replace(o, target=names.get((o.station, o.target), o.target)) for o in readings))
    for a, b in itertools.pairwise(levelled):
        rise = float(true[b][2] - true[a][2] + SIGMA_LEVEL * rng.normal())
        network.add(HeightDifference(a, b, rise, sigma=SIGMA_LEVEL))
    for name in gnss:
        at = true[name] + rng.normal(0.0, SIGMA_GNSS)
        network.add(GnssPosition(name, tuple(at.tolist()), sigma=SIGMA_GNSS))
    told = tuple(
        Exchanged(s, pair, _others(s, pair, seen, swapped, levelled, gnss, true) > 1)
        for s, pair in swapped
    )
    return Day(network, told, true)


def _places(rng: np.random.Generator, stations: list[str], targets: list[str]) -> dict[str, Array]:
    turn = rng.uniform(0.0, 2 * np.pi) + 2 * np.pi * np.arange(len(stations)) / len(stations)
    out = {
        s: np.array([70 * np.sin(a), 70 * np.cos(a), rng.uniform(-2.0, 2.0)])
        for s, a in zip(stations, turn.tolist(), strict=True)
    }
    for t in targets:
        out[t] = np.append(rng.uniform(-60.0, 60.0, 2), rng.uniform(-8.0, 12.0))
    return out


def _sights(
    rng: np.random.Generator, true: dict[str, Array], stations: list[str], targets: list[str]
) -> list[Any]:
    """Return direction, zenith angle and slope distance of every sight, with noise."""
    out: list[Any] = []
    for station in stations:
        height = round(float(rng.uniform(1.45, 1.7)), 3)
        share = rng.uniform(0.6, 1.0)
        # Everyone sees three targets in common, and every target is seen from somewhere.
        some = {t for t in targets if rng.uniform() < share} | set(targets[:3])
        some |= {t for i, t in enumerate(targets) if stations[i % len(stations)] == station}
        orientation = rng.uniform(0.0, 2 * np.pi)
        for target in [*(s for s in stations if s != station), *sorted(some)]:
            d = true[target] + [0.0, 0.0, ABOVE] - true[station] - [0.0, 0.0, height]
            length, e = float(np.linalg.norm(d)), rng.normal(0.0, 1.0, 3)
            heights: dict[str, Any] = {"instrument_height": height, "target_height": ABOVE}
            azimuth = np.arctan2(d[0], d[1]) - orientation + SIGMA_ANGLE * e[0]
            zenith = np.arccos(d[2] / length) + SIGMA_ANGLE * e[1]
            both: dict[str, Any] = {"sigma": SIGMA_ANGLE, **heights}
            out += [
                Direction(station, target, float(azimuth % (2 * np.pi)), **both),
                ZenithAngle(station, target, float(zenith), **both),
                SlopeDistance(
                    station,
                    target,
                    length + SIGMA_DISTANCE * float(e[2]),
                    sigma=SIGMA_DISTANCE,
                    **heights,
                ),
            ]
    return out


def _drawn(
    rng: np.random.Generator, seen: dict[str, list[str]], number: int
) -> list[tuple[str, tuple[str, str]]]:
    """Draw exchanges; at one set-up a target is in one of them at most."""
    out: list[tuple[str, tuple[str, str]]] = []
    while len(out) < number:
        station = str(rng.choice(sorted(seen)))
        a, b = sorted(rng.choice(seen[station], 2, replace=False).tolist())
        if not any(s == station and {a, b} & set(pair) for s, pair in out):
            out.append((station, (a, b)))
    return out


def _others(
    station: str,
    pair: tuple[str, str],
    seen: dict[str, list[str]],
    swapped: list[tuple[str, tuple[str, str]]],
    levelled: list[str],
    gnss: list[str],
    true: dict[str, Array],
) -> int:
    """Return how many others say where a pair is: other set-ups, levelling, GNSS."""
    wrong = {s for s, other in swapped if set(other) & set(pair)}
    n = sum(bool(set(pair) & set(t)) for s, t in seen.items() if s not in wrong)
    apart = abs(true[pair[0]][2] - true[pair[1]][2]) > 100 * SIGMA_LEVEL
    n += bool(set(pair) & set(levelled)) and len(levelled) > 2 and bool(apart)
    return n + bool(set(pair) & set(gnss))
