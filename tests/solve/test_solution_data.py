"""A solution is data: it is copied, pickled, made from its parts; and starts carry values alone."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import fields, replace

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.factor_graph.network_graph import build_graph
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import HeightDifference, SlopeDistance
from factorgraph_adj.solve.added_factors import AddedFactors
from factorgraph_adj.solve.adjustment_run import RunRecord
from factorgraph_adj.solve.linearised_equations import ExtraRows
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from factorgraph_adj.solve.solution import Solution, solution_at
from factorgraph_adj.start.start_values import Start
from tests.networks.simulated import free_block, gnss, own_cameras, weighted_photos
from tests.networks.small_block import small_block
from tests.networks.total_station import total_station


def sights() -> fga.Network:
    return total_station(1, coarse=0.01)


def pickled(solution: Solution) -> Solution:
    back = pickle.loads(pickle.dumps(solution))
    assert isinstance(back, Solution)
    return back


ROUNDING = 1e-9
"""Part of the largest variance that another order of sums makes."""
COPIES: dict[str, Callable[[Solution], Solution]] = {
    "copied": copy.copy,
    "deeply": copy.deepcopy,
    "pickled": pickled,
}
CASES: dict[str, Callable[[], Solution]] = {
    "given datum": lambda: fga.adjust(small_block()),
    "free": lambda: fga.adjust(free_block()),
    "a posteriori": lambda: fga.adjust(small_block(), variance="a-posteriori"),
    "not at rest": lambda: fga.adjust(small_block(), max_iterations=1),
    "over other points": lambda: fga.s_transform(fga.adjust(small_block()), ["P1", "P4", "P12"]),
    "carried": lambda: fga.s_transform(fga.adjust(sights()), list(sights().points)[:3]),
    "correlated": lambda: fga.adjust(gnss()),
    "own cameras": lambda: fga.adjust(own_cameras()),
    "weighted photos": lambda: fga.adjust(weighted_photos()),
    "incremental": lambda: fga.IncrementalAdjustment(small_block()).solution(),
}


@pytest.fixture(scope="module", params=CASES)
def solution(request: pytest.FixtureRequest) -> Solution:
    found = CASES[request.param]()
    found.point_covariances  # noqa: B018 - what follows from the data is there already
    return found


@pytest.mark.parametrize("how", COPIES)
def test_a_copy_has_the_same_figures(solution: Solution, how: str) -> None:
    other = COPIES[how](solution)
    assert repr(other) == repr(solution)
    points = list(solution.network.points)
    for name in points:
        np.testing.assert_array_equal(other.point(name), solution.point(name))
    bound = ROUNDING * np.abs(solution.point_covariances).max()
    for found, own in (
        (other.point_covariances, solution.point_covariances),
        (other.covariance(*points[-2:]), solution.covariance(*points[-2:])),
    ):
        np.testing.assert_allclose(found, own, rtol=0, atol=bound)
    assert [r.id for r in other.observations] == [r.id for r in solution.observations]
    row = len(solution.observations) - 1
    assert other.equations.label(row) == solution.equations.label(row)
    if solution.converged:
        r = fga.reliability(solution).redundancy_numbers
        np.testing.assert_allclose(fga.reliability(other).redundancy_numbers, r, atol=ROUNDING)


def test_what_is_pickled_starts_another_adjustment() -> None:
    solution = fga.adjust(small_block())
    again = fga.adjust(small_block(), start=pickled(solution))
    assert again.iterations <= 2
    assert again.vtpv == pytest.approx(solution.vtpv, rel=1e-9)


def test_a_solution_is_made_from_its_parts() -> None:
    """By hand: a levelled line of two rises, 1.000 m and 2.003 m, between heights 0 and 3 m."""
    network = fga.Network("by hand")
    for name, z in (("A", 0.0), ("B", 1.0), ("C", 3.0)):
        network.add_point(name, (0.0, 0.0, z), fixed="xy" if name == "B" else "xyz")
    network.add(
        HeightDifference("A", "B", 1.0, sigma=0.001),
        HeightDifference("B", "C", 2.003, sigma=0.002),
    )
    equations = compile_network(network)
    state = equations.unknowns.start()
    # z = (1.000/1 + 0.997/4) / (1/1 + 1/4): the mean by weights.
    state["point"][1, 2] = z = 0.9994
    vtpv = ((z - 1.0) / 0.001) ** 2 + ((3.0 - z - 2.003) / 0.002) ** 2
    solution = Solution(
        network=network,
        equations=equations,
        state=state,
        start=equations.unknowns.start(),
        converged=True,
        reason="by hand",
        iterations=0,
        vtpv=vtpv,
        run=RunRecord(Solver.of(equations), np.zeros(equations.unknowns.n_columns)),
    )
    assert solution.redundancy == 1
    assert solution.sigma0 == pytest.approx(np.sqrt(1.8))
    assert solution.standard_deviations("B")[2] == pytest.approx(0.001 / np.sqrt(1.25))
    assert solution.normal().gradient == pytest.approx(np.zeros(3), abs=1e-9)
    assert solution.observations[0].residual == pytest.approx(-0.0006)
    found = fga.adjust(network)
    assert found.point("B") == pytest.approx(solution.point("B"), abs=1e-12)
    assert found.vtpv == pytest.approx(vtpv)


def test_normal_equations_serve_only_where_they_are_those_of_the_state() -> None:
    solution = fga.adjust(free_block())
    here = solution.normal()
    assert here is solution.run.linearised  # the way onto the inner constraints has made them
    same = replace(solution, variance="a-posteriori")
    assert same.normal() is here
    assert solution_at(solution, solution.state).normal() is here
    step = np.zeros(solution.equations.unknowns.n_columns)
    step[3] = 1e-3
    there = solution_at(solution, solution.equations.unknowns.retract(solution.state, step))
    assert there.normal() is not here
    expected = NormalEquations(Solver.of(there.equations), there.state)
    np.testing.assert_allclose(there.normal().gradient, expected.gradient, rtol=1e-9)
    assert np.abs(there.normal().gradient - here.gradient).max() > 1.0


# -- a user's factors -----------------------------------------------------------------------------


def with_factor(network: fga.Network) -> tuple[fga.Network, list[gtsam.NonlinearFactor]]:
    """Return a network, and a factor written in Python: the distance of two points."""
    keys = build_graph(network).keys
    a, b = keys.key("point", "P1"), keys.key("point", "P8")

    def error(_: object, values: gtsam.Values, jacobians: list[np.ndarray] | None) -> np.ndarray:
        d = values.atPoint3(b) - values.atPoint3(a)
        length = float(np.linalg.norm(d))
        if jacobians is not None:
            jacobians[0], jacobians[1] = -d[None] / length, d[None] / length
        return np.array([length - 6.5])

    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.01)
    return network, [gtsam.CustomFactor(noise, [a, b], error)]


@pytest.mark.parametrize("how", COPIES)
def test_the_rows_of_a_users_factors_are_part_of_the_data(how: str) -> None:
    network, factors = with_factor(small_block())
    solution = fga.adjust(network, extra_factors=factors)
    assert (solution.extra.n_rows, solution.converged) == (1, True)
    other = COPIES[how](solution)
    assert (other.extra.n_rows, other.redundancy) == (1, solution.redundancy)
    np.testing.assert_array_equal(other.point_covariances, solution.point_covariances)
    assert other.normal().gradient == pytest.approx(solution.normal().gradient)


def test_what_is_pickled_without_its_factors_says_what_it_cannot_do() -> None:
    network, factors = with_factor(free_block())
    solution = fga.adjust(network, extra_factors=factors)
    there = fga.s_transform(solution, ["P1", "P4", "P12"])
    for shared in (copy.copy(solution), copy.deepcopy(solution)):
        again = fga.s_transform(shared, ["P1", "P4", "P12"])
        np.testing.assert_allclose(again.point("P8"), there.point("P8"), atol=1e-9)
    alone = pickled(solution)
    np.testing.assert_array_equal(alone.covariance("P1", "P8"), solution.covariance("P1", "P8"))
    with pytest.raises(fga.InputError, match=r"left behind .* adjust again with extra_factors="):
        fga.s_transform(alone, ["P1", "P4", "P12"])
    assert pickled(alone).extra.n_rows == 1


def test_rows_of_factors_belong_to_one_state() -> None:
    network, factors = with_factor(small_block())
    equations = compile_network(network)
    state = fga.adjust(network).state
    extra = AddedFactors(tuple(factors)).at(equations, state)
    length = np.linalg.norm(np.subtract(*(state["point"][[7 + 2, 2]])))
    assert extra.rows[0].residual == pytest.approx([(length - 6.5) / 0.01])
    moved = {**state, "point": 1.1 * state["point"]}
    assert extra.at(equations, moved).rows[0].residual == pytest.approx(
        [(1.1 * length - 6.5) / 0.01]
    )
    assert AddedFactors().at(equations, state).rows == ()
    assert AddedFactors().n_rows == 0
    nothing = ExtraRows(np.zeros(0, dtype=np.intp), np.zeros((2, 0)), np.zeros(2))
    assert AddedFactors(rows=(nothing, nothing)).n_rows == 4


# -- starts ---------------------------------------------------------------------------------------


def test_a_start_carries_values_by_name_and_nothing_else() -> None:
    network = free_block()
    solution = fga.adjust(network)
    start = Start.of(solution)
    assert Start.of(start) is start
    by_values = fga.adjust(network, start=start)
    by_solution = fga.adjust(network, start=solution)
    assert by_values.iterations == by_solution.iterations
    np.testing.assert_array_equal(by_values.point("P3"), by_solution.point("P3"))
    # Inner constraints refer to x₀, wherever the iteration starts.
    np.testing.assert_array_equal(by_values.start["point"], solution.start["point"])


def test_values_of_another_network_are_found_by_name() -> None:
    network = small_block()
    solution = fga.adjust(network)
    fewer = fga.without(network, [o.id for o in solution.observations if o.kind == "direction"])
    again = fga.adjust(fewer, start=Start.of(solution))
    assert again.converged
    unknowns = compile_network(fewer).unknowns
    carried = Start.of(solution).for_unknowns(unknowns)
    assert carried is not None
    assert carried.unknowns is unknowns
    numbers = [unknowns["point"].number[n] for n in network.points]
    np.testing.assert_array_equal(carried.state["point"][numbers], solution.state["point"])
    np.testing.assert_array_equal(carried.origin["point"][numbers], solution.start["point"])


def test_a_start_that_lacks_values_is_none() -> None:
    network = small_block()
    start = Start.of(fga.adjust(network))
    more = network.copy()
    more.add_point("new")
    more.add(SlopeDistance("S1", "new", 10.0, sigma=0.01))
    assert start.for_unknowns(compile_network(more).unknowns) is None


def test_x0_is_that_of_the_start() -> None:
    """A free network starts 0.2 m off, and stays on the inner constraints of what is named x₀."""
    network = sights()
    first = fga.adjust(network)
    away = {**first.state, "point": first.state["point"] + 0.2}
    found = fga.adjust(network, start=Start(first.equations.unknowns, away, first.start))
    assert found.converged
    for name in network.points:
        assert found.point(name) == pytest.approx(first.point(name), abs=1e-6)


def test_what_only_further_computations_need_is_no_name_of_a_solution() -> None:
    """The record of the run has it, and nothing of it stands twice."""
    solution = fga.adjust(free_block())
    internal = {f.name for f in fields(solution.run)}
    assert {"solver", "constraint", "linearised"} <= internal
    assert not internal & set(dir(solution))
    assert not {"at", "normal_at", "forget", "datum_cross", "n_extra"} & set(dir(solution))
