"""Gross errors that lead an adjustment astray are no defect of its network."""

from __future__ import annotations

import pytest

import factorgraph_adj as fga
from factorgraph_adj.quality.robust_estimation import robust_adjust
from tests.field_mistakes.mistakes import MISTAKES
from tests.field_mistakes.projects import yard

LONG = pytest.mark.slow(
    "data snooping from an adjustment that went astray; short tests see that it did"
)


@pytest.fixture
def exchanged(tmp_path):
    """The yard with two targets exchanged: the plain adjustment has no way to a minimum."""
    mistake = next(m for m in MISTAKES if m.name == "two targets exchanged")
    return fga.read_project(mistake.make().write(tmp_path / "yard"))


def test_an_adjustment_that_went_astray_is_not_converged(exchanged):
    solution = fga.adjust(exchanged)
    assert not solution.converged
    assert "where it ended something is not determined that was at the start" in solution.reason
    assert "NOT CONVERGED" in repr(solution)


def test_a_robust_estimate_begins_at_the_approximate_values(exchanged, tmp_path):
    found = robust_adjust(exchanged)
    assert found.converged
    right = fga.adjust(fga.read_project(yard().write(tmp_path / "right")))
    for name in ("S1", "S2", "S3", "E"):
        off = found.solution.point(name) - right.point(name)
        assert abs(off).max() < 5 * right.standard_deviations(name).max()


@LONG
def test_snooping_needs_no_minimum_of_the_whole(exchanged):
    found = fga.snoop(exchanged, start=fga.adjust(exchanged))
    aside = {(r.kind, r.label.split()[-2:][0]) for r in found.rejected}
    assert len(found.rejected) == 6 and found.solution.converged and aside
    assert found.causes is not None
    assert found.causes.found[0].cause == "two targets, exchanged:"
    assert len(found.causes.found[0].ids) == 6


def test_a_defect_of_the_network_is_still_one():
    """A point with one direction: not determined at the start, nor anywhere."""
    network = fga.Network("a point too many")
    for name, at in {"A": (0, 0, 0), "B": (50, 0, 0), "C": (0, 50, 0)}.items():
        network.add_point(name, at, fixed="xyz")
    network.add_point("P", (20.0, 20.0, 0.0), fixed="z")
    network.add_point("Q", (30.0, 10.0, 0.0), fixed="z")
    for target, value in (("B", 0.0), ("C", 4.71238898)):
        network.add(fga.Direction("A", target, value, sigma=1e-5))
    network.add(fga.SlopeDistance("A", "P", 28.3, sigma=0.01))
    network.add(fga.SlopeDistance("B", "P", 36.1, sigma=0.01))
    network.add(fga.Direction("A", "Q", 0.2, sigma=1e-5))
    with pytest.raises(fga.DatumError, match="part with Q"):
        fga.adjust(network)
