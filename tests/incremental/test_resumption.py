"""A resumed journal is where the adjustment was, wherever approximate values would lead."""

import copy

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.incremental.resumption import resumed
from factorgraph_adj.io.journal import Journal
from factorgraph_adj.ledger.journal_entries import start_of
from factorgraph_adj.observations import Correlated, SlopeDistance

from ..benchmarks.vehicle import Drive


def lines_of(journal):
    """Return the lines of a journal."""
    opened, header, entries, _ = Journal.open(journal)
    opened.close()
    return [header, *entries]


def state_of(lines, folder):
    """Return the state after lines."""
    network, rules = start_of(lines[0], "journal", folder, (), False)
    return resumed(network, lines[0], lines[1:], rules, "journal")


def values_of(state, names):
    return {n: x for n in names if (x := state.system.value("point", n)) is not None}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A survey vehicle whose approximate values lead nowhere: its journal, and where it was."""
    journal = tmp_path_factory.mktemp("drive") / "journal"
    road = Drive(6.0, rays=12, seed=4)
    inc = fga.IncrementalAdjustment(road.network(), journal=journal)
    for event in road.events():
        inc.add(event.observations, points=event.points, photos=event.photos)
    names = [n for n in inc.network().points if inc.determined(n)]
    there = {n: (inc.estimate(n), inc.standard_deviations(n)) for n in names}
    vtpv = inc.vtpv
    del inc
    return journal, there, vtpv


def off(there, found):
    """Return the largest deviation relative to σ."""
    every = [np.abs(found[n] - x)[s > 0] / s[s > 0] for n, (x, s) in there.items()]
    return max(float(e.max()) for e in every if len(e))


def test_a_journal_resumes_where_approximate_values_lead_to_no_minimum(drive, tmp_path):
    journal, there, vtpv = drive
    lines = lines_of(journal)
    state = state_of(lines, tmp_path)
    assert off(there, values_of(state, there)) < 0.01
    assert state.system.vtpv == pytest.approx(vtpv, rel=1e-5)
    assert not state.system.base.second_places
    for line in lines[1:]:
        line.pop("estimates", None), line.pop("vtpv", None)
    assert state_of(lines, tmp_path).system.doubt


def test_a_journal_is_followed_where_its_estimates_lead_to_another_minimum(drive, tmp_path):
    journal, there, vtpv = drive
    lines = lines_of(journal)
    for line in lines[1:]:
        line.pop("estimates", None)
    state = state_of(lines, tmp_path)
    assert off(there, values_of(state, there)) < 0.01
    assert state.system.vtpv == pytest.approx(vtpv, rel=1e-5)


def test_a_minimum_that_is_not_found_again_is_told(drive, tmp_path):
    lines = lines_of(drive[0])
    lines[-1]["vtpv"] -= 50.0
    (told,) = state_of(lines, tmp_path).system.base.second_places
    assert "the journal ended at a minimum with vᵀPv 85.6951, which was not found again" in told


def test_a_minimum_that_is_not_found_again_is_told_beside_other_places(tmp_path):
    network = sided()
    network.add_point("Q", (31.0, -38.0, 0.0), fixed="z")
    inc = fga.IncrementalAdjustment(network, journal=tmp_path / "journal")
    at = {"A": 50.0, "B": 50.0, "C": 60.0}
    inc.add([SlopeDistance(s, "P", d, sigma=0.01) for s, d in at.items()])
    inc.add([SlopeDistance(s, "Q", 50.0, sigma=0.01) for s in "AB"])
    del inc
    lines = lines_of(tmp_path / "journal")
    lines[-1]["vtpv"] += 50.0
    side, told = state_of(lines, tmp_path).system.base.second_places
    assert "point 'Q' fits equally well" in side
    assert "which was not found again" in told


def sided():
    """Return a network whose point has approximate values on the wrong side."""
    network = fga.Network("two sides")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (60.0, 0.0, 0.0), fixed="xyz")
    network.add_point("C", (30.0, 100.0, 0.0), fixed="xyz")
    network.add_point("P", (31.0, -38.0, 0.0), fixed="z")
    return network


@pytest.mark.parametrize("settles", [False, True])
def test_a_side_that_a_reading_told_stays_when_that_has_left(tmp_path, settles):
    inc = fga.IncrementalAdjustment(sided(), journal=tmp_path / "journal")
    at = {"A": 50.0, "B": 50.0, "C": 60.0}
    inc.add([SlopeDistance(s, "P", d, sigma=0.01, id=s) for s, d in at.items()])
    assert inc.estimate("P")[1] == pytest.approx(40.0, abs=0.1)
    inc.remove("C")
    if settles:
        inc.settle()
    there, places = inc.estimate("P"), inc.solution().second_places
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert again.estimate("P") == pytest.approx(there, abs=1e-6)
    assert [p.split(" at ")[0] for p in again.solution().second_places] == [
        p.split(" at ")[0] for p in places
    ]


def test_a_journal_resumes_where_a_given_solution_was(tmp_path):
    network = sided()
    at = {"A": 50.0, "B": 50.0}
    network.add(*(SlopeDistance(s, "P", d, sigma=0.01, id=s) for s, d in at.items()))
    other = network.copy()
    other.add(SlopeDistance("C", "P", 60.0, sigma=0.01))
    inc = fga.IncrementalAdjustment(network, start=fga.adjust(other), journal=tmp_path / "journal")
    there = inc.estimate("P")
    assert there[1] == pytest.approx(40.0, abs=0.1)
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert again.estimate("P") == pytest.approx(there, abs=1e-6)


def test_what_waited_at_the_start_waits_when_resumed(tmp_path):
    network = sided()
    network.add(SlopeDistance("A", "P", 50.0, sigma=0.01, id="alone"))
    inc = fga.IncrementalAdjustment(network, journal=tmp_path / "journal")
    said, waits = repr(inc), inc.waiting
    assert [w.id for w in waits] == ["alone"]
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "journal")
    assert repr(again) == said
    assert [(w.id, w.lacks) for w in again.waiting] == [(w.id, w.lacks) for w in waits]


def test_all_estimates_stand_in_a_line_when_as_many_observations_have_changed(drive):
    lines = lines_of(drive[0])
    n = [sum(map(len, line.get("estimates", {}).values())) for line in lines[1:]]
    assert sum(n) < 4 * sum(
        len(line.get("observations", ())) + sum(len(i["points"]) for i in line.get("images", ()))
        for line in lines
    )
    assert all("vtpv" in line for line in lines[-5:])
    known = {
        (kind, name) for x in lines[1:] for kind, v in x.get("estimates", {}).items() for name in v
    }
    assert known >= {("point", name) for name in drive[1]}


@pytest.mark.parametrize(
    ("estimates", "told"),
    [
        ({"point": {"P": [1.0, None, 2.0]}}, "not an estimate of 'P'"),
        ({"pose": {"F": [1.0] * 12}}, "the estimate of 'F' has no rotation"),
        ({"pose": {"F": [1.0]}}, "damaged"),
        ({"tone": {"F": [1.0]}}, "damaged"),
        ([1.0], "damaged"),
    ],
)
def test_estimates_that_are_none_are_refused(tmp_path, estimates, told):
    inc = fga.IncrementalAdjustment(sided(), journal=tmp_path / "journal")
    inc.add([SlopeDistance(s, "P", 50.0, sigma=0.01) for s in "AB"])
    del inc
    lines = copy.deepcopy(lines_of(tmp_path / "journal"))
    lines[1]["estimates"] = estimates
    with pytest.raises(InputError, match=rf"journal:2.*{told}"):
        state_of(lines, tmp_path)


def test_vtpv_counts_groups_and_what_has_left():
    network = sided()
    for (a, b), d in {("A", "P"): 50.0, ("B", "P"): 50.01, ("C", "P"): 59.99}.items():
        network.add(SlopeDistance(a, b, d, sigma=0.01, id=a))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    both = [
        SlopeDistance(s, "P", d, sigma=0.01, id=f"2{s}") for s, d in (("A", 50.02), ("B", 50.0))
    ]
    inc.add(Correlated(both, np.array([[1e-4, 6e-5], [6e-5, 2e-4]])))
    inc.remove("C")
    assert inc.vtpv == pytest.approx(fga.adjust(inc.network()).vtpv, rel=1e-4)
