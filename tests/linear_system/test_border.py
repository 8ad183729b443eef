"""New unknowns beside a base of fronts: at any time, and at rest, they are those of the batch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.linear_system import linearisation_error
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.observations import AnyObservation, HeightDifference
from tests.benchmarks.grids import simulate_grid
from tests.networks.random_small import handed_over, random_network
from tests.support.arrivals import compare, ids_of

SEEDS = (1, 2, 3, 29, 52)
"""Random networks that are determined: of all kinds, with groups, photos, frames and drifts."""
POINTS = 25
STATIONS = 15
"""Stations with which the grid begins."""


def system(inc: fga.IncrementalAdjustment) -> FrontSystem:
    found = inc._state.system
    assert isinstance(found, FrontSystem)
    return found


@pytest.fixture
def large(monkeypatch) -> None:
    """Let small networks be looked at as large ones are."""
    monkeypatch.setattr(linearisation_error, "MAX_SMALL_UNKNOWNS", 0)


def stations() -> tuple[fga.Network, list[list[AnyObservation]]]:
    """Return a grid without observations, and those of each of its stations."""
    network = simulate_grid(1, points=POINTS).network
    side = round(np.sqrt(POINTS))
    far, near = f"{side - 1}-0", f"0-{side - 1}"  # the first stations are to have the datum
    network.points[far] = replace(network.points[far], fixed=(False,) * 3)
    network.points[near] = replace(network.points[near], fixed=(True, False, False))
    of: dict[str, list[AnyObservation]] = {}
    for ident, o in network.observations.items():
        of.setdefault(o.station, []).append(replace(o, id=ident))
    bare = network.copy()
    bare.observations = {}
    return bare, list(of.values())


def growing(
    engine: str, policy: str = "flag"
) -> tuple[fga.IncrementalAdjustment, Iterator[list[AnyObservation]]]:
    bare, own = stations()
    network = handed_over(bare, [o for some in own[:STATIONS] for o in some])
    inc = fga.IncrementalAdjustment(network, engine=engine, policy=policy)
    return inc, iter(own[STATIONS:])


@pytest.mark.parametrize("seed", SEEDS)
def test_random_networks_that_grow_are_those_of_the_batch(seed: int, large) -> None:
    drawn = random_network(seed, more=seed % 3 == 0)
    n = len(drawn.items) // 2
    rng = np.random.default_rng(seed)
    items = [drawn.items[i] for i in rng.permutation(len(drawn.items))]
    begun = handed_over(drawn.bare, items[:n])
    inc = fga.IncrementalAdjustment(begun, engine="fronts", policy="accept")
    for number, item in enumerate(items[n:], start=1):
        inc.add(item)
        if number % 5 == 0 and (found := compare(inc, str(number), rng=rng)):
            assert found.promise <= 1.0, found
    inc.settle()
    found = compare(inc, "settled", rng=rng)
    assert found is not None and found.promise <= 1.0, found


def test_stations_with_their_points_stand_beside_the_base(large) -> None:
    inc, own = growing("fronts")
    base, rng, known = system(inc).base, np.random.default_rng(1), 0
    for arriving in own:
        inc.add(arriving)
        assert system(inc).base is base
        assert len(system(inc).border.unknowns) > known
        known = len(system(inc).border.unknowns)
    assert not inc.waiting and not inc.suspects
    found = compare(inc, "all", rng=rng)
    assert found is not None and found.estimates < 1e-2 and found.sigmas < 1e-3, found
    solution = inc.solution()
    assert (inc.n_observations, inc.redundancy) == (solution.n_observations, solution.redundancy)
    assert inc.vtpv == pytest.approx(solution.vtpv, rel=1e-4)
    a, b = "4-0", "4-4"
    assert inc.covariance(a, b) == pytest.approx(solution.covariance(a, b), rel=1e-3, abs=1e-9)
    assert inc.covariance(a, "0-1") == pytest.approx(
        solution.covariance(a, "0-1"), rel=1e-3, abs=1e-9
    )


def test_gross_errors_of_new_stations_are_found_as_in_a_tree(large) -> None:
    told = []
    for engine in ("fronts", "isam2"):
        inc, own = growing(engine, "reject")
        verdicts = []
        for number, arriving in enumerate(own):
            if number in (1, 7):
                known = [o for o in arriving if o.kind == "direction" and inc.determined(o.target)]
                wrong = replace(known[1], value=known[1].value + 5e-4)
                arriving = [wrong if o is known[1] else o for o in arriving]
            verdicts += inc.add(arriving).verdicts
        told.append((verdicts, [v.id for v in inc.rejected]))
    (fronts, out), (tree, out_of_tree) = told
    assert out == out_of_tree and out
    for a, b in zip(fronts, tree, strict=True):
        assert (a.id, a.verdict, a.dof) == (b.id, b.verdict, b.dof)
        if a.dof:
            assert a.t2 == pytest.approx(b.t2, rel=1e-2, abs=1e-2)
            assert a.redundancy_numbers == pytest.approx(b.redundancy_numbers, abs=1e-3)
        for x, y in zip(a.gains, b.gains, strict=True):
            assert x.after == pytest.approx(y.after, rel=1e-2)


def test_readings_of_a_new_point_that_contradict_each_other_are_judged_as_in_a_tree(large) -> None:
    outcomes = []
    benchmark = fga.Point("benchmark", (10.0, 10.0, 1.0), fixed=(True, True, False))
    for engine in ("fronts", "isam2"):
        inc, own = growing(engine)
        inc.add(next(own))
        heights = [
            HeightDifference("0-0", "benchmark", 1.0, sigma=1e-3, id="one"),
            HeightDifference("1-1", "benchmark", 9.0, sigma=1e-3, id="other"),
        ]
        verdicts = inc.add(heights, points=[benchmark]).verdicts
        told = sorted(v.verdict for v in verdicts)  # which of them is wrong, nothing tells
        outcomes.append((told, {w.id for w in inc.waiting}, inc.determined("benchmark")))
    assert outcomes[0] == outcomes[1]


def test_what_stands_beside_the_base_can_leave(large) -> None:
    inc, own = growing("fronts")
    arriving = next(own)
    inc.add(arriving)
    assert system(inc).border.unknowns
    inc.remove(ids_of(arriving[-1]))
    found = compare(inc, "removed", rng=np.random.default_rng(1))
    assert found is not None and found.promise <= 1.0, found
    inc.remove([i for o in arriving[:-1] for i in ids_of(o)])
    assert not inc.determined("4-4") or inc.network().observations


def test_a_journal_resumes_what_stood_beside_the_base(tmp_path) -> None:
    bare, own = stations()
    network = handed_over(bare, [o for some in own[:STATIONS] for o in some])
    path = tmp_path / "survey.journal"
    inc = fga.IncrementalAdjustment(network, engine="fronts", journal=path)
    inc.add(own[STATIONS])
    inc.settle()
    name = own[STATIONS][0].target
    at, sigma = inc.estimate(name), inc.standard_deviations(name)
    del inc
    again = fga.IncrementalAdjustment.resume(path)
    assert (np.abs(again.estimate(name) - at) <= 1e-6 * sigma).all()
    assert again.standard_deviations(name) == pytest.approx(sigma, rel=1e-6)


def test_a_base_is_renewed_in_stages_before_there_is_no_room_beside_it(large, monkeypatch) -> None:
    monkeypatch.setattr(FrontSystem, "most_beside", 60)
    inc, own = growing("fronts")
    bases, stages = [system(inc).base], []
    for arriving in own:
        inc.add(arriving)
        stages.append(inc._state.renewal is not None)
        if system(inc).base is not bases[-1]:
            bases.append(system(inc).base)
    assert len(bases) == 2 and sum(stages) == 3 and not stages[-1]
    assert len(system(inc).update.signs)  # what came in between
    found = compare(inc, "renewed", rng=np.random.default_rng(1))
    assert found is not None and found.estimates < 1e-2 and found.sigmas < 1e-3, found


def test_what_leaves_while_a_base_is_renewed_is_not_in_the_new_one(large, monkeypatch) -> None:
    monkeypatch.setattr(FrontSystem, "most_beside", 60)
    inc, own = growing("fronts")
    for arriving in own:
        inc.add(arriving)
        if inc._state.renewal is not None:
            break
    inc.remove(ids_of(arriving[-1]))
    for more in own:
        inc.add(more)
    assert ids_of(arriving[-1])[0] not in inc.network().observations
    found = compare(inc, "removed", rng=np.random.default_rng(1))
    assert found is not None and found.estimates < 1e-2 and found.sigmas < 1e-3, found
