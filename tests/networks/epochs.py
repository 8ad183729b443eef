"""Epochs of a network of distances and directions, and how often their tests reject."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga

PLACES = {
    "A": (0, 0),
    "B": (300, 20),
    "C": (280, 310),
    "D": (-10, 290),
    "E": (150, -60),
    "P": (120, 140),
    "Q": (180, 160),
}
"""A to E are reference points, P and Q objects; metres."""


def epoch(seed, shifts=None, *, datum="free", sigma=0.002, scale=1.0):
    """Return a network of distances and directions between all points, measured at one epoch."""
    rng = np.random.default_rng(seed)
    true = {n: np.array([*xy, 0.0]) for n, xy in PLACES.items()}
    for n, shift in (shifts or {}).items():
        true[n] = true[n] + [*shift, 0.0]
    network = fga.Network(f"epoch {seed}", datum=datum)
    for n, xy in PLACES.items():
        fixed = "xyz" if datum == "given" and n in "AC" else "z"
        network.add_point(n, (*xy, 0.0), fixed=fixed)
    for a in PLACES:
        for b in PLACES:
            if a == b:
                continue
            d = true[b] - true[a]
            length = np.hypot(d[0], d[1]) + scale * rng.normal(0, sigma)
            network.add(fga.HorizontalDistance(a, b, length, sigma=sigma))
            azimuth = np.arctan2(d[0], d[1]) + scale * rng.normal(0, 1e-5)
            network.add(fga.Direction(a, b, azimuth % (2 * np.pi), sigma=1e-5))
    return network


def solved(seed, shifts=None, **options):
    return fga.adjust(epoch(seed, shifts, **options))


def rates(seeds, shift, **options):
    """Return how often the shape is rejected, and the object P is found to move."""
    shape = objects = 0
    for seed in seeds:
        found = fga.congruence(
            solved(2 * seed), solved(2 * seed + 1, {"P": shift}), objects=["P", "Q"], **options
        )
        shape += not found.global_test.accepted
        # Against all reference points: a false alarm of theirs is no matter of the object's test.
        if found.global_test.accepted:
            objects += found.displacement("P").moved
    return shape / len(seeds), objects / max(len(seeds) - round(shape), 1)


def detectable_shift():
    x = fga.congruence(solved(1), solved(2), objects=["P", "Q"], variance="a-priori").displacement(
        "P"
    )
    return tuple(x.detectable * x.hardest[:2])


def turned_vectors(turn: float, seed: int) -> fga.Solution:
    """Return vectors from a held point to five others, all turned about the vertical."""
    rng, network = np.random.default_rng(seed), fga.Network("vectors")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    c, s = np.cos(turn), np.sin(turn)
    for i, (x, y) in enumerate(((40, 5), (-30, 22), (11, -50), (35, 31), (-20, -25))):
        network.add_point(f"P{i}", (x, y, 1.0))
        at = np.array([c * x - s * y, s * x + c * y, 1.0])
        for k in range(2):
            value = tuple((at + 0.001 * rng.normal(size=3)).tolist())
            network.add(fga.GnssVector("A", f"P{i}", value, sigma=(0.001,) * 3, id=f"{i}.{k}"))
    return fga.adjust(network)


def solved_without(name, seed):
    """Return an epoch that lacks a point."""
    full = epoch(seed)
    network = fga.Network(f"without {name}", datum="free")
    for n, p in full.points.items():
        if n != name:
            network.add_point(n, p.coordinates, fixed="z")
    for o in full.observations.values():
        if name not in (o.station, o.target):
            network.add(o)
    return fga.adjust(network)
