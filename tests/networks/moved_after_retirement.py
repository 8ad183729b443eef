"""Random networks of which some unknowns are retired, and the others are then moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import ControlPoint, Direction, SlopeDistance
from factorgraph_adj.types import Array

from .photo_block import CONTROL, PHOTOS, POINTS, SIGMA, block

KINDS = ("distances", "directions", "photos")
"""What is observed."""
MOVEMENTS = ("one point", "all points", "weakest direction")
"""What moves after something was retired: σ of a point in any direction, of some points each as
they are correlated, and of these points where their joint cofactor matrix is largest."""
NEAREST = 0.1
"""Smallest distance of two points in the plane, relative to its side."""
MOST_MOVED = 6
"""Largest number of points that move together."""


def two_points() -> fga.Network:
    """Return two points in a plane beside three that are held, without observations."""
    network = fga.Network("weak")
    for name, at in {"A": (0, 0, 0), "B": (9, 0, 0), "C": (0, 9, 0)}.items():
        network.add_point(name, at, fixed="xyz")
    network.add_point("P", (4.0, 5.0, 0.0), fixed="z")
    network.add_point("Q", (6.0, 8.0, 0.0), fixed="z")
    return network


def two_points_by_distances(sigma: float) -> fga.Network:
    """Return `two_points` with six distances without errors.

    Args:
        sigma: their standard deviation, metres.
    """
    network = two_points()
    for a, b in ("AP", "BP", "CP", "PQ", "AQ", "BQ"):
        d = np.subtract(network.points[b].coordinates, network.points[a].coordinates)
        network.add(SlopeDistance(a, b, float(np.linalg.norm(d)), sigma=sigma))
    return network


def retired_with_residuals(residual: float) -> fga.IncrementalAdjustment:
    """Return an adjustment that retired a point with residuals, and moved what observed it.

    Args:
        residual: error of the distances to the point, in their standard deviations.
    """
    network = two_points()
    network.add_point("R", (5.0, -5.0, 0.0), fixed="z")
    network.points["Q"] = replace(network.points["Q"], coordinates=(9.0, 6.0, 0.0))
    pairs = dict.fromkeys(("AP", "BP", "CP", "AR", "BR", "CR"), 0.0)
    pairs |= {"PQ": residual, "RQ": residual, "AQ": -residual}
    sigma = 0.2
    for (a, b), error in pairs.items():
        d = np.subtract(network.points[b].coordinates, network.points[a].coordinates)
        reading = float(np.linalg.norm(d)) + error * sigma
        network.add(SlopeDistance(a, b, reading, sigma=sigma))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.settle()
    inc.retire(points="Q")
    s = inc.standard_deviations("P")[:2]
    x, y = inc.estimate("P")[:2] + np.array([0.5, -0.5]) * s
    stated = tuple((0.2 * s).tolist())
    inc.add([ControlPoint("P", (float(x), float(y)), axes="xy", sigma=stated)])
    inc.settle()
    return inc


def plane(rng: np.random.Generator, *, directions: bool) -> fga.Network:
    """Return points in a plane, each observed from some of those before it."""
    network = fga.Network("plane")
    size = 10.0 ** rng.uniform(1.0, 3.3)
    at = {name: size * np.array(x) for name, x in (("A", (0, 0)), ("B", (1, 0)), ("C", (0.2, 1)))}
    sigma = 10.0 ** rng.uniform(-4.0, -1.5)
    for name, x in at.items():
        network.add_point(name, (*x.tolist(), 0.0), fixed="xyz")
    for i in range(int(rng.integers(4, 13))):
        name, others = f"P{i}", list(at)
        x = rng.uniform(0.0, size, 2)
        while min(np.linalg.norm(x - y) for y in at.values()) < NEAREST * size:
            x = rng.uniform(0.0, size, 2)
        at[name] = x
        start = at[name] + size * sigma * rng.normal(size=2)
        network.add_point(name, (*start.tolist(), 0.0), fixed="z")
        near = sorted(others, key=lambda n: float(np.linalg.norm(at[n] - at[name])))[:2]
        for other in sorted({*near, *rng.choice(others, 3, replace=False).tolist()}):
            d = at[name] - at[other]
            length = float(np.linalg.norm(d))
            reading = length + size * sigma * rng.normal()
            network.add(SlopeDistance(other, name, reading, sigma=size * sigma))
            if directions:
                azimuth = np.arctan2(d[0], d[1]) + sigma * rng.normal()
                network.add(Direction(other, name, float(azimuth % (2 * np.pi)), sigma=sigma))
    return network


def moved_after_retirement(
    seed: int, kind: str, movement: str, journal: str | Path | None = None
) -> fga.IncrementalAdjustment:
    """Return a settled adjustment after up to three retirements and movements.

    Args:
        seed: the seed.
        kind: one of `KINDS`.
        movement: one of `MOVEMENTS`.
        journal: its journal; none: it keeps none.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind), MOVEMENTS.index(movement)])
    if kind == "photos":
        network = block(seed, SIGMA * 10.0 ** rng.uniform(0.0, 1.3))
        left = [f"P{i}" for i in range(CONTROL, POINTS)]
    else:
        network = plane(rng, directions=kind == "directions")
        left = [n for n in network.points if n.startswith("P")]
    inc = fga.IncrementalAdjustment(network, policy="accept", journal=journal)
    inc.settle()
    left = [name for name in left if inc.determined(name)]
    for turn in range(int(rng.integers(1, 4))):
        gone = rng.choice(left, max(1, len(left) // 4), replace=False).tolist()
        left = [name for name in left if name not in gone]
        photos = [f"F{turn + 1}"] if kind == "photos" and rng.random() < 0.3 else []
        inc.retire(points=gone, photos=[p for p in photos if 2 * turn < PHOTOS])
        move(inc, left, movement, rng, turn)
        inc.settle()
    return inc


def move(
    inc: fga.IncrementalAdjustment,
    left: Sequence[str],
    movement: str,
    rng: np.random.Generator,
    turn: int,
) -> None:
    """Observe coordinates of points up to ten σ away from where they are."""
    some = min(len(left), 1 if movement == "one point" else MOST_MOVED)
    names = rng.choice(list(left), some, replace=False).tolist()
    q = np.block([[inc.covariance(a, b) for b in names] for a in names])
    values, vectors = np.linalg.eigh((q + q.T) / 2)
    values = np.sqrt(np.maximum(values, 0.0))
    along: Array = np.append(np.zeros(len(values) - 1), rng.choice([-1.0, 1.0]))
    if movement != "weakest direction":
        along = rng.normal(size=len(values))
    d = 10.0 ** rng.uniform(-0.5, 1.0) * (vectors @ (values * along)).reshape(-1, 3)
    narrower = 10.0 ** rng.uniform(-1.5, 0.0)
    for i, name in enumerate(names):
        sigma = inc.standard_deviations(name)
        axes = "".join(a for a, s in zip("xyz", sigma, strict=True) if s > 0)
        to, on = inc.estimate(name) + d[i], sigma > 0
        stated = tuple((narrower * sigma[on]).tolist())
        ident = f"{name} moved {turn}"
        inc.add([ControlPoint(name, tuple(to[on].tolist()), axes=axes, sigma=stated, id=ident)])


def truly_missed(inc: fga.IncrementalAdjustment) -> float:
    """Take everything back; return the largest change of an unknown, relative to its σ."""
    before = inc.solution()
    inc.settle(all=True)
    after, worst = inc.solution(), 0.0
    for kind, table in before.equations.unknowns.tables.items():
        for name, number in table.number.items():
            sigma = np.sqrt(np.maximum(np.diag(after.variable_covariance((kind, name))), 0.0))
            there = after.state[kind][after.number(kind, name)]
            step = UNKNOWNS[kind].local(before.state[kind][number : number + 1], there[None])
            d, on = step[0, : len(sigma)], sigma > 0
            worst = max(worst, float((np.abs(d[on]) / sigma[on]).max(initial=0.0)))
    return worst
