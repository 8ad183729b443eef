"""What was left out is tested again when it may fit by now, and says so when it comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental import readmission
from factorgraph_adj.observations import ControlPoint, HeightDifference, SlopeDistance

MM = 1e-3
LARGE = 300
"""Number of heights beyond which networks are not adjusted anew for each arrival."""


def line(journal: Path | None = None) -> fga.IncrementalAdjustment:
    """Return two points on a line, one of them roughly known."""
    network = fga.Network("a line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.0, 0.0), fixed="yz", sigma=(1.0, np.inf, np.inf))
    network.add_point("C", (5.0, 0.0, 0.0), fixed="yz")
    network.add(SlopeDistance("A", "C", 5.001, sigma=2 * MM, id="elsewhere"))
    network.add(SlopeDistance("A", "B", 10.050, sigma=2 * MM, id="wrong"))
    return fga.IncrementalAdjustment(network, journal=journal)


def measured(value: float, ident: str) -> SlopeDistance:
    """Return a distance."""
    return SlopeDistance("A", "B", value, sigma=2 * MM, id=ident)


def test_suspects_come_back_when_what_they_contradicted_has_left(tmp_path: Path) -> None:
    """Two right readings beside a wrong one that came first."""
    journal = tmp_path / "line.jsonl"
    inc = line(journal)
    for value, ident in ((10.002, "first"), (10.000, "second")):
        assert inc.add(measured(value, ident)).verdicts[0].verdict == "suspect"
    arrival = inc.remove("wrong")
    assert not arrival.waits
    assert [v.id for v in arrival.verdicts] == ["first", "second"]
    assert all(v.verdict == "accepted" and v.entered for v in arrival.verdicts)
    assert not inc.suspects
    inc.settle()
    assert inc.estimate("B")[0] == pytest.approx(10.001, abs=1e-6)
    assert inc.solution().vtpv == pytest.approx(fga.adjust(inc.network()).vtpv, rel=1e-6)
    del inc
    again = fga.IncrementalAdjustment.resume(journal)
    assert not again.suspects
    assert len(again) == 3


def test_a_suspect_that_does_not_fit_yet_keeps_its_first_figures() -> None:
    """It contradicts what is in, whatever else leaves."""
    inc = line()
    inc.add(measured(10.051, "other"))
    (suspect,) = inc.add(measured(10.002, "lone")).verdicts
    arrival = inc.remove("other")
    assert not arrival.verdicts
    (told,) = inc.suspects
    assert told.t2 == suspect.t2


@pytest.mark.parametrize("elsewhere", [True, False])
def test_suspects_come_back_when_what_determined_their_point_has_left(
    tmp_path: Path, *, elsewhere: bool
) -> None:
    """The wrong reading came first, alone; with it the point is gone, or everything is."""
    network = fga.Network("levelling")
    network.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    for name in ("B", "C"):
        network.add_point(name, (100.0, 0.0, np.nan), fixed="xy")
    journal = tmp_path / "levelling.jsonl"
    inc = fga.IncrementalAdjustment(network, journal=journal)
    if elsewhere:
        inc.add(HeightDifference("A", "C", 2.0, sigma=MM, id="elsewhere"))
    for ident, value in (("wrong", 1.5), ("first", 1.0), ("second", 1.001)):
        inc.add(HeightDifference("A", "B", value, sigma=MM, id=ident))
    assert {v.id for v in inc.suspects} == {"first", "second"}
    arrival = inc.remove("wrong")
    assert {v.id for v in arrival.verdicts} == {"first", "second"}
    assert not inc.suspects and not inc.n_waiting
    assert inc.estimate("B")[2] == pytest.approx(101.0005, abs=1e-9)
    del inc
    assert fga.IncrementalAdjustment.resume(journal).estimate("B")[2] == pytest.approx(101.0005)


def test_suspects_come_back_when_a_wrong_weight_has_left() -> None:
    network = fga.Network("a weighted height")
    network.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    network.add_point("W", (100.0, 0.0, 101.5), fixed="xy", sigma=MM)
    inc = fga.IncrementalAdjustment(network)
    for ident, value in (("first", 1.0), ("second", 1.001)):
        (verdict,) = inc.add(HeightDifference("A", "W", value, sigma=MM, id=ident)).verdicts
        assert verdict.verdict == "suspect"
    arrival = inc.remove("point W z")
    assert {v.id for v in arrival.verdicts} == {"first", "second"}
    assert inc.estimate("W")[2] == pytest.approx(101.0005, abs=1e-9)


def test_a_suspect_waits_where_nothing_determines_its_point_any_more() -> None:
    """It is no suspect of anything then."""
    network = fga.Network("a lone sight")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("P", (30.0, 40.0, 0.0), fixed="z")
    inc = fga.IncrementalAdjustment(network)
    for ident, by in (("x", (30.0, 40.0)), ("y", (30.0, 40.0))):
        inc.add(ControlPoint("P", (*by, 0.0), sigma=(MM, MM, MM), id=ident))
    inc.add(SlopeDistance("A", "P", 51.0, sigma=MM, id="tape"))
    assert {v.id for v in inc.suspects} == {"tape"}
    inc.remove(["x", "y"])
    assert not inc.suspects
    assert [w.id for w in inc.waiting] == ["tape"]


def benchmarks(more: int) -> fga.IncrementalAdjustment:
    """Return a height with a good reading left out, as a slightly wrong one came first.

    Args:
        more: number of other heights.
    """
    network = fga.Network("levelling")
    network.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    for name in ("B", *(f"C{i}" for i in range(more))):
        network.add_point(name, (100.0, 0.0, np.nan), fixed="xy")
    for i in range(more):
        network.add(HeightDifference("A", f"C{i}", 1.0, sigma=MM))
    inc = fga.IncrementalAdjustment(network)
    for ident, value in (("wrong", 1.006), ("good", 1.000)):
        inc.add(HeightDifference("A", "B", value, sigma=MM, id=ident))
    assert [v.id for v in inc.suspects] == ["good"]
    return inc


@pytest.mark.parametrize("more", [0, LARGE])
def test_a_suspect_comes_back_with_the_arrival_that_makes_it_fit(more: int) -> None:
    """In networks of every size, at once: not when the engine makes a new base, or at `settle`."""
    inc = benchmarks(more)
    arrival = inc.add(HeightDifference("A", "B", 1.0015, sigma=MM, id="another"))
    assert [(v.id, v.verdict, v.cause) for v in arrival.verdicts] == [
        ("another", "accepted", ""),
        ("good", "accepted", "came back after add()"),
    ]
    # T² = vᵀPv with it − vᵀPv without, 3.75² mm² / (1 + 1/2) mm².
    assert arrival.verdicts[1].t2 == pytest.approx(3.75**2 / 1.5, rel=1e-4)
    assert not inc.suspects
    assert inc.estimate("B")[2] == pytest.approx(101.0 + 7.5 * MM / 3.0, abs=1e-7)


def test_suspects_that_agree_do_not_come_back_against_what_is_in() -> None:
    """Each is tested alone: five gross errors of the same size do not outvote a good reading."""
    inc = benchmarks(0)
    for i in range(5):
        inc.add(HeightDifference("A", "B", 1.0, sigma=MM, id=f"like it {i}"))
    assert len(inc.suspects) == 6
    arrival = inc.add(HeightDifference("A", "B", 1.0055, sigma=MM, id="another"))
    assert [v.id for v in arrival.verdicts] == ["another"]
    assert len(inc.suspects) == 6


def test_what_still_contradicts_is_recognised_without_a_covariance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its innovation exceeds the σ of its last test, which what enters only makes smaller."""
    inc = benchmarks(0)
    inc.add(HeightDifference("A", "B", 1.5, sigma=MM, id="bad"))
    inc.discard("good")
    tested: list[int] = []
    monkeypatch.setattr(
        readmission, "innovation_tests", lambda *_: tested.extend(_[2].tolist()) or ()
    )
    inc.add(HeightDifference("A", "B", 1.0062, sigma=MM, id="another"))
    assert [v.id for v in inc.suspects] == ["bad"] and not tested
