"""Comparisons of two epochs for reports and exports."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

import factorgraph_adj as fga
from tests.networks.epochs import PLACES, epoch, solved

SHIFTS = {"B": (0.02, 0.01), "P": (0.01, -0.015), "Q": (0.01, -0.015)}
"""Displacements of the epochs in plan: a reference point, and a block of two object points."""


@cache
def in_plan():
    """Return a comparison in which B left the reference, and P and Q moved."""
    return fga.congruence(solved(20), solved(21, SHIFTS), objects=["P", "Q"], variance="a-priori")


@cache
def block():
    """Return the common motion of P and Q."""
    return fga.block_motion(in_plan(), ["P", "Q"])


@cache
def joint():
    """Return the comparison of both epochs in one adjustment: B, P and Q have second places."""
    first, second = (s.network for s in in_plan().solutions)
    both, later = first.copy(), {n: f"{n}2" for n in "BPQ"}
    for n, other in later.items():
        both.add_point(other, first.points[n].coordinates, fixed="z")
    for o in second.observations.values():
        ends = {e: later.get(getattr(o, e), getattr(o, e)) for e in ("station", "target")}
        own = {"set": "later"} if isinstance(o, fga.Direction) else {}
        both.add(replace(o, **ends, **own, id=None))
    return fga.congruence(fga.adjust(both), pairs=later, variance="a-priori")


@cache
def few():
    """Return a comparison with two reference points, which tell only their distance."""
    return fga.congruence(
        solved(20), solved(21, {"P": SHIFTS["P"]}), reference=["A", "C"], objects=["P", "Q"]
    )


@cache
def strained():
    """Return the affine motion of three points."""
    found = fga.congruence(
        solved(20), solved(21, SHIFTS), reference=["A", "C", "D"], objects=["B", "P", "Q"]
    )
    return found, fga.block_motion(found, ["B", "P", "Q"], model="affine")


@cache
def kept():
    """Return a comparison in which nothing moved."""
    return fga.congruence(solved(20), solved(21), objects=["P", "Q"], variance="a-priori")


@cache
def doubtful():
    """Return a comparison whose second epoch is three times less accurate than it says."""
    return fga.congruence(solved(20), solved(21, scale=3.0), objects=["P", "Q"])


def _heights(seed, rise, *, plan):
    rng = np.random.default_rng(seed)
    network = fga.Network(f"levelled {seed}", datum="free")
    heights = {n: 100.0 + i + rise * (n == "P") for i, n in enumerate(PLACES)}
    for i, (n, at) in enumerate(PLACES.items()):
        network.add_point(n, (*(at if plan else (0, 0)), 100.0 + i), fixed="xy")
    for a in PLACES:
        for b in PLACES:
            if a < b:
                observed = heights[b] - heights[a] + rng.normal(0, 1e-3)
                network.add(fga.HeightDifference(a, b, observed, sigma=1e-3))
    return fga.adjust(network)


@cache
def heights(*, plan=True):
    """Return a comparison of heights in which P sank by 12 mm, with plan coordinates or without."""
    first, second = (_heights(i, -0.012 * (i - 1), plan=plan) for i in (1, 2))
    return fga.congruence(first, second, objects=["P", "Q"], variance="a-priori")


def _vectors(seed, frame, origin, shift):
    rng = np.random.default_rng(seed)
    network = fga.Network(f"vectors {seed}", frame=frame, datum="free")
    places = {n: np.array([*at, 3.0 * i]) for i, (n, at) in enumerate(PLACES.items())}
    for n, at in places.items():
        network.add_point(n, origin + at)
    for a in places:
        for b in places:
            if a < b:
                d = places[b] - places[a] + (b == "P") * shift - (a == "P") * shift
                seen = tuple(d + rng.normal(0, 2e-3, 3))
                network.add(fga.GnssVector(a, b, seen, covariance=4e-6 * np.eye(3)))
    return fga.adjust(network)


@cache
def in_space(*, geocentric=False):
    """Return a comparison in three dimensions, in a local or a geocentric frame."""
    frame = fga.GeocentricFrame() if geocentric else fga.LocalFrame()
    origin = np.array([3.9e6, 0.7e6, 5.0e6]) if geocentric else np.zeros(3)
    shift = np.array([0.02, -0.01, 0.015])
    first, second = (_vectors(i, frame, origin, (i - 1) * shift) for i in (1, 2))
    return fga.congruence(first, second, objects=["P", "Q"], variance="a-priori")


def with_system(*, known=True):
    """Return a comparison in plan with coordinates of UTM, of a known system or not."""
    crs = fga.ReferenceSystem("EPSG:25832", heights="ellipsoidal") if known else None
    networks = []
    for seed, shifts in ((20, {}), (21, SHIFTS)):
        plain = epoch(seed, shifts)
        network = fga.Network(plain.name, datum="free", crs=crs)
        for n, p in plain.points.items():
            network.add_point(n, np.add(p.coordinates, (5e5, 5.5e6, 0.0)), fixed="z")
        network.add(*plain.observations.values())
        networks.append(network)
    first, second = (fga.adjust(n) for n in networks)
    return fga.congruence(first, second, objects=["P", "Q"], variance="a-priori")
