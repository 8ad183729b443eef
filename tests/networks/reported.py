"""Small networks of every dimension, with names that a page must not take for its own."""

from __future__ import annotations

from math import atan2

import numpy as np

import factorgraph_adj as fga

NASTY = ("<script>alert(1)</script>", "</script>", "a\"b'c&d", "Größe Ω 点 🚩", "=1+1,2", "<b>")
"""Names of points that are text and nothing else."""


def three_points() -> fga.Network:
    """A point from two distances and an azimuth: one redundant observation."""
    network = fga.Network("three points")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (100.0, 0.0, 0.0), fixed="xyz")
    network.add_point("P", (50.0, 60.0, 0.0), fixed="z")
    network.add(fga.SlopeDistance("A", "P", 78.105, sigma=0.003))
    network.add(fga.SlopeDistance("B", "P", 78.100, sigma=0.003))
    network.add(fga.Azimuth("A", "P", atan2(50.0, 60.0), sigma=5e-5))
    return network


def heights_alone() -> fga.Network:
    """Levelled heights without plan coordinates, seed 2."""
    true = {"BM1": 100.0, "h1": 101.234, "h2": 99.5, "h3": 103.2, "h4": 98.0}
    network, rng = fga.Network("levelling"), np.random.default_rng(2)
    for name, height in true.items():
        fixed = "xyz" if name == "BM1" else "xy"
        network.add_point(name, (0.0, 0.0, height), fixed=fixed)
    for pair in ("BM1 h1", "h1 h2", "h2 h3", "h3 h4", "h4 BM1", "h1 h3", "h2 h4"):
        a, b = pair.split()
        observed = true[b] - true[a] + rng.normal(0.0, 0.002)
        network.add(fga.HeightDifference(a, b, observed, sigma=0.002))
    return network


def nasty_names() -> fga.Network:
    """Levelled points whose names are markup, formulas, quotes and letters of other scripts."""
    network = fga.Network("</title><script>alert('name')</script>")
    network.add_point("BM", (0.0, 0.0, 10.0), fixed="xyz")
    for i, name in enumerate(NASTY):
        network.add_point(name, (10.0 * i + 10.0, 5.0 * (i % 2), 10.0 + i), fixed="xy")
    names = ["BM", *NASTY]
    heights = dict(zip(names, (10.0, *(10.0 + i for i in range(len(NASTY)))), strict=True))
    for a, b in zip(names, [*names[1:], "BM"], strict=True):
        source = f"<i>{b}</i>.csv:1"
        network.add(fga.HeightDifference(a, b, heights[b] - heights[a], sigma=0.001, source=source))
    return network


def levelled_field(side: int = 45) -> fga.Network:
    """Heights of side × side points with known plan coordinates, 100 m apart, seed 5."""
    network, rng = fga.Network("field"), np.random.default_rng(5)
    for i in range(side):
        for j in range(side):
            fixed = "xyz" if i == j == 0 else "xy"
            network.add_point(f"{i}-{j}", (100.0 * i, 100.0 * j, 0.0), fixed=fixed)
    for i in range(side):
        for j in range(side):
            for a, b in ((i + 1, j), (i, j + 1)):
                if a < side and b < side:
                    noise = float(rng.normal(0.0, 0.002))
                    network.add(fga.HeightDifference(f"{i}-{j}", f"{a}-{b}", noise, sigma=0.002))
    return network
