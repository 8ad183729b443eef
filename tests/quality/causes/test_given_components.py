"""Given points that are wrong: every component that the readings tell of, and tests by χ² or F."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.misfit_causes import given_values_section

PLACES = {
    "A": (0.0, 0.0, 10.0),
    "B": (185.2, 62.4, 15.0),
    "P": (60.0, 95.0, 12.0),
    "Q": (150.0, 140.0, 18.0),
    "R": (110.0, 50.0, 11.0),
}


def trilateration(seed: int = 1, *, off: tuple[float, float, float] = (0, 0, 0)) -> fga.Network:
    """Return distances and height differences between two held points and three new ones."""
    rng = np.random.default_rng(seed)
    network = fga.Network("trilateration")
    for name, xyz in PLACES.items():
        move = np.array(off) if name == "B" else 0.0
        network.add_point(name, np.add(xyz, move), fixed="xyz" if name in "AB" else "")
    for a, b in combinations(PLACES, 2):
        d = np.subtract(PLACES[b], PLACES[a])
        network.add(
            fga.SlopeDistance(a, b, float(np.linalg.norm(d) + rng.normal(0, 2e-3)), sigma=2e-3)
        )
        network.add(fga.HeightDifference(a, b, float(d[2] + rng.normal(0, 1e-3)), sigma=1e-3))
    return network


def test_components_that_hang_together_are_each_told_as_if_it_alone_were_wrong() -> None:
    """Distances tell of B along A – B alone: 5 cm there are 5.3 cm of x, or 15.6 cm of y."""
    along = np.subtract(PLACES["B"], PLACES["A"])[:2]
    along /= np.linalg.norm(along)
    off = 0.05 * along
    found = fga.causes(fga.reliability(fga.adjust(trilateration(off=(*off, 0.0)))))
    told = next(c for c in found.found if c.where == "of point 'B'")
    by_name = {name: (error, alone) for name, _, error, _, alone in told.estimates}
    assert list(by_name) == ["x", "y", "z"]
    for name, share in zip("xy", along, strict=True):
        error, alone = by_name[name]
        assert alone
        assert error == pytest.approx(0.05 / share, abs=0.012 / share)
    assert not by_name["z"][1]
    assert str(told).count("if it alone is wrong") == 2


def levelling(seed: int, *, factor: float = 1.0, off: float = 0.0) -> fga.Network:
    """Return three bench marks and new points; errors are larger than stated by a factor."""
    rng = np.random.default_rng(seed)
    heights = {"A": 10.0, "B": 12.0, "C": 11.0, "P": 9.0, "Q": 13.0, "R": 14.0}
    network = fga.Network("levelling")
    for name, z in heights.items():
        held = name in "ABC"
        known = (0.0, 0.0, z + off * (name == "C"))
        network.add_point(name, known, fixed="xyz" if held else "xy")
    for a, b in combinations(heights, 2):
        if not {a, b} <= set("ABC"):
            value = heights[b] - heights[a] + factor * rng.normal(0, 1e-3)
            network.add(fga.HeightDifference(a, b, value, sigma=1e-3))
    return network


def said(network: fga.Network) -> str:
    solution = fga.adjust(network, variance="a-posteriori")
    return " ".join("\n".join(given_values_section(Report(solution))).split())


def test_given_values_are_tested_with_the_estimated_variance() -> None:
    """σ that are stated ten times too small are no wrong bench marks; 10 cm at 1 cm are."""
    for seed in range(10):
        assert "all fit" in said(levelling(seed, factor=10.0))
    assert "point C z" in said(levelling(1, factor=10.0, off=0.1))
