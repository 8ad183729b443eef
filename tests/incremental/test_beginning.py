"""Networks of which much is not determined begin with the rest of them; what waits says why."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.variables import State
from factorgraph_adj.ledger.ledger import Ledger
from factorgraph_adj.ledger.waiting_observations import Candidates, NothingKnown
from factorgraph_adj.network.network import Network
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from tests.benchmarks.beginning import (
    grid_of_directions,
    grid_of_single_distances,
    loose_strips,
    unknown_stations,
)

SMALL: dict[str, Callable[[], Network]] = {
    "single distances": lambda: grid_of_single_distances(25),
    "directions alone": lambda: grid_of_directions(36),
    "loose strips": lambda: loose_strips(2_000, 100),
    "stations without heights": lambda: unknown_stations(16, 12),
}
"""Small networks of each sort of the benchmark."""
AT_REST = 1e-6
"""Largest deviation of a settled state from the batch adjustment, relative to σ."""


def lacks(inc: fga.IncrementalAdjustment) -> dict[str, str]:
    return {w.id: w.lacks for w in inc.waiting}


@pytest.mark.parametrize("name", SMALL)
def test_the_determined_part_is_adjusted_as_by_the_batch(name: str) -> None:
    inc = fga.IncrementalAdjustment(SMALL[name]())
    assert len(inc) and inc.n_waiting
    inc.settle()
    solution, batch = inc.solution(), fga.adjust(inc.network())
    table = batch.equations.unknowns["point"]
    names = [n for n in table.names if table.offset[table.number[n]] >= 0]
    for point in names[:: max(len(names) // 20, 1)]:
        off = np.abs(solution.point(point) - batch.point(point))
        sigma = np.sqrt(np.diag(batch.covariance(point)))
        assert np.max(off / np.where(sigma > 0, sigma, np.inf)) < AT_REST


@pytest.mark.parametrize("name", SMALL)
def test_what_waits_and_why_is_the_same_whether_it_is_there_or_arrives(name: str) -> None:
    whole = SMALL[name]()
    begun = fga.IncrementalAdjustment(whole, policy="accept")
    waits = lacks(begun)
    late = [f"{o.photo}/{o.point}" in waits for o in whole.image_points()]
    rays = [o for o, waits_on in zip(whole.image_points(), late, strict=True) if waits_on]
    rest = [Ledger.of(whole).observation(i) for i in whole.observations if i in waits]
    first = whole.copy()
    first.observations = {i: o for i, o in whole.observations.items() if i not in waits}
    first.image_mask(~np.array(late, dtype=bool))
    inc = fga.IncrementalAdjustment(first, policy="accept")
    assert not inc.n_waiting
    inc.add([*rays, *rest])
    assert lacks(inc).keys() == waits.keys()
    assert set(lacks(inc).values()) == set(waits.values())


def test_reasons_do_not_depend_on_what_else_waits() -> None:
    every = lacks(fga.IncrementalAdjustment(unknown_stations(16, 12)))
    alone = lacks(fga.IncrementalAdjustment(unknown_stations(16, 1)))
    assert len(every) == 12 * 4 and len(alone) == 4
    assert {i: every[i] for i in alone} == alone
    assert all("its height is not observed" in why for why in every.values())


def test_a_point_with_one_distance_says_what_it_needs() -> None:
    inc = fga.IncrementalAdjustment(grid_of_single_distances(25))
    need = "1 of the 3 readings that it needs"
    assert [w.lacks for w in inc.waiting] == [
        f"point 'late {i}' has 1 slope distance: {need}" for i in range(12)
    ]


def test_variables_are_counted_as_by_leaving_out_one_after_the_other() -> None:
    rng = np.random.default_rng(5)
    network = fga.Network("some distances")
    for i in range(30):
        network.add_point(f"{i}", rng.uniform(0.0, 100.0, 3), fixed="xyz" if i < 4 else "")
    for _ in range(85):
        a, b = rng.choice(30, 2, replace=False).tolist()
        network.add(fga.observations.SlopeDistance(f"{a}", f"{b}", 50.0, sigma=0.01))
    ledger = Ledger.of(network)
    every = Candidates(ledger, NothingKnown(), ledger.having("accepted"))
    left, lost = every.counted()
    rows = dict(enumerate(o.points() for o in network.observations.values()))
    few: dict[str, int] = {}
    while True:
        n = {p: 0 for ends in rows.values() for p in ends if int(p) >= 4}
        for ends in rows.values():
            for p in ends:
                n[p] = n.get(p, 0) + 1
        bad = {p: k for p, k in n.items() if int(p) >= 4 and k < 3}
        if not bad:
            break
        few |= bad
        rows = {i: ends for i, ends in rows.items() if not bad.keys() & set(ends)}
    assert 0 < len(rows) < 85
    assert left.rows.tolist() == list(rows)
    assert lost == {("point", p): k for p, k in few.items()}
    again = Candidates(ledger, NothingKnown(), left.rows)
    assert left.counts == again.counts
    assert [set(v) for v in left.lacking()] == [set(v) for v in again.lacking()]


def test_no_state_is_linearised_twice_on_the_way_to_the_minimum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network, states = grid_of_single_distances(196), list[bytes]()
    make = NormalEquations.__init__

    def noted(self: NormalEquations, solver: Solver, state: State, *further: Any) -> None:
        states.append(state["point"].tobytes())
        make(self, solver, state, *further)

    monkeypatch.setattr(NormalEquations, "__init__", noted)
    assert fga.IncrementalAdjustment(network).n_waiting
    assert len(states) > 1
    assert len(set(states)) == len(states)
