"""Observations in iSAM2: at any time, and at rest, they are those of the batch adjustment."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.factor_graph.linear_isam2 import MAX_TURNS, IndeterminateError, LinearISAM2
from factorgraph_adj.factor_graph.row_arrays import Arriving
from factorgraph_adj.graph.equations import compile_rows
from factorgraph_adj.observations import AnyObservation, Correlated, HeightDifference, SlopeDistance
from factorgraph_adj.quality.group_tests import critical_t2
from tests.networks.random_small import random_network
from tests.networks.small_block import small_block

SEEDS = (1, 2, 3, 6, 21, 29, 52, 54, 56, 76, 87)
"""Random networks that are determined: of all kinds, with groups, photos, frames and drifts."""


@cache
def adjusted(seed: int) -> fga.Solution:
    drawn = random_network(seed, more=seed % 3 == 0)
    network = drawn.bare.copy()
    network.add(*drawn.items)
    return fga.adjust(network, datum="given", tolerance=1e-8)


def whole(solution: fga.Solution) -> LinearISAM2:
    tree = LinearISAM2(solution.network.frame)
    tree.enter([Arriving(solution.equations, solution.state)])
    return tree


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tree_has_the_covariances_and_the_sum_of_squares_of_the_batch(seed: int) -> None:
    solution = adjusted(seed)
    tree = whole(solution)
    assert tree.follow() == 0
    assert tree.vtpv == pytest.approx(solution.vtpv, rel=1e-9, abs=1e-9)
    unknowns = solution.equations.unknowns
    for kind, number in unknowns.active():
        table = unknowns[kind]
        free = table.free[number, : table.size[number]]
        variable = (kind, table.names[number])
        batch = solution.variable_covariance(variable)[np.ix_(free, free)]
        sigma = np.sqrt(np.diag(batch))
        difference = (tree.covariance(variable) - batch) / np.outer(sigma, sigma)
        assert np.abs(difference).max() < 1e-8, variable


@pytest.mark.parametrize("seed", SEEDS[:4])
def test_moved_values_come_back_to_the_minimum(seed: int) -> None:
    solution = adjusted(seed)
    unknowns = solution.equations.unknowns
    rng = np.random.default_rng(seed)
    weight = np.sqrt(np.maximum(solution.normal().diagonal, 1e-300))
    step = np.where(unknowns.free, 3.0 * rng.normal(size=unknowns.n_columns) / weight, 0.0)
    tree = LinearISAM2(solution.network.frame)
    tree.enter([Arriving(solution.equations, unknowns.retract(solution.state, step))])
    tree.settle()
    for name in solution.network.points:
        sigma = solution.standard_deviations(name)
        moved = np.abs(tree.value("point", name) - solution.point(name))
        # Weights that depend on lengths are at rest to 10⁻⁷ in the batch.
        assert (moved <= 1e-5 * sigma + 1e-9).all(), name


@pytest.mark.parametrize("seed", SEEDS)
def test_the_missed_gradient_is_that_of_rows_evaluated_where_the_tree_is(seed: int) -> None:
    """The linear rows of a tree have none, as it is at their minimum; groups are whitened."""
    solution = adjusted(seed)
    unknowns = solution.equations.unknowns
    rng = np.random.default_rng(seed)
    weight = np.sqrt(np.maximum(solution.normal().diagonal, 1e-300))
    step = np.where(unknowns.free, 30.0 * rng.normal(size=unknowns.n_columns) / weight, 0.0)
    tree = LinearISAM2(solution.network.frame)
    tree.enter([Arriving(solution.equations, unknowns.retract(solution.state, step))])
    before = tree.mark()
    tree._measure_gaps(np.ones(tree._delta.n, dtype=bool), tree._bounds)
    there = LinearISAM2(solution.network.frame)
    there.enter([Arriving(solution.equations, tree.state())])
    rows = there._stacked(np.flatnonzero(there._inside.values))
    missed, scale = tree._gradient_errors()[0][rows.columns], np.sqrt((rows.a**2).sum(axis=0))
    apart = float(np.abs((missed - rows.a.T @ rows.v) / scale).max())
    assert apart <= 1e-9 * np.abs(missed / scale).max()
    tree.restore(before)
    assert not tree._gradient_errors()[0].any()


def levels(n: int) -> fga.Network:
    """Return a line of held and free bench marks without observations."""
    network = fga.Network("levels")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    for i in range(n):
        network.add_point(f"P{i}", (10.0 * i, 0.0, 0.1), fixed="xy")
    return network


def arriving(network: fga.Network, *observations: AnyObservation) -> Arriving:
    """Return observations with what a network says of their points."""
    part = fga.Network(network.name, frame=network.frame)
    single = [m for o in observations for m in getattr(o, "observations", (o,))]
    for o in single:
        for name in o.names():
            if name not in part.points:
                point = network.points[name]
                fixed = "".join(c for c, f in zip("xyz", point.fixed, strict=True) if f)
                part.add_point(name, point.coordinates, fixed=fixed)
    part.add(*observations)
    equations = compile_rows(part)
    return Arriving(equations, equations.unknowns.start())


def test_an_arrival_is_tested_as_in_the_batch_and_leaves_again() -> None:
    network = levels(2)
    first = [HeightDifference("A", "P0", 1.0, sigma=0.001, id="a")]
    first += [HeightDifference("P0", "P1", 0.5, sigma=0.001, id="b")]
    tree = LinearISAM2(network.frame)
    tree.enter([arriving(network, *first)])
    before = float(tree.value("point", "P1")[2])
    wrong = HeightDifference("A", "P1", 1.510, sigma=0.001, id="wrong")
    units = tree.enter([arriving(network, wrong)])
    t2, dof = tree.joint_covariance(units).tested().statistics()
    network.add(*first, wrong)
    batch = fga.reliability(fga.adjust(network))
    assert t2[0] == pytest.approx(batch.w[2] ** 2, rel=1e-9)
    assert t2[0] > critical_t2(0.001, int(dof[0]))
    tree.leave(units)
    assert float(tree.value("point", "P1")[2]) == pytest.approx(before, abs=1e-12)
    sigma = np.sqrt(tree.covariance(("point", "P1"))[0, 0])
    assert sigma == pytest.approx(0.001 * np.sqrt(2), rel=1e-9)


def test_what_is_not_determined_leaves_the_tree_as_it_was() -> None:
    network = levels(3)
    tree = LinearISAM2(network.frame)
    tree.enter([arriving(network, HeightDifference("A", "P0", 1.0, sigma=0.001))])
    loose = HeightDifference("P1", "P2", 0.3, sigma=0.001)
    mark = tree.mark()
    with pytest.raises(IndeterminateError):
        tree.enter([arriving(network, loose)])
    tree.restore(mark)
    assert set(tree.tables["point"].number) == {"A", "P0"}
    tie = HeightDifference("P0", "P1", 0.2, sigma=0.001)
    tree.enter([arriving(network, loose, tie)])
    assert float(tree.value("point", "P2")[2]) == pytest.approx(1.5, abs=1e-9)


def test_a_survey_that_grows_is_the_batch_at_every_arrival() -> None:
    """Distances to new points whose start values are decimetres off."""
    rng = np.random.default_rng(4)
    network = fga.Network("growing")
    truth = {f"K{i}": at for i, at in enumerate(rng.uniform(0, 80, (4, 3)))}
    for name, at in truth.items():
        network.add_point(name, at, fixed="xyz")
    tree, everything = LinearISAM2(network.frame), []
    for step in range(6):
        name, at = f"P{step}", rng.uniform(0, 80, 3)
        network.add_point(name, at + rng.normal(0, 0.2, 3))
        near = list(truth)[-5:]
        truth[name] = at
        new = [
            SlopeDistance(n, name, float(np.linalg.norm(at - truth[n])) + e, sigma=0.002)
            for n, e in zip(near, rng.normal(0, 0.002, len(near)), strict=True)
        ]
        everything += new
        tree.enter([arriving(network, *new)])
        tree.follow()
        part = network.copy()
        part.add(*everything)
        batch = fga.adjust(part, tolerance=1e-9)
        for p in [p for p in truth if p[0] == "P"]:
            sigma = batch.standard_deviations(p)
            moved = np.abs(tree.value("point", p) - batch.point(p))
            assert (moved < 1e-2 * sigma).all()
            own = np.sqrt(np.diag(tree.covariance(("point", p))))
            assert np.abs(own / sigma - 1.0).max() < 1e-2
    tree.settle()
    moved = np.abs(tree.value("point", "P5") - batch.point("P5"))
    assert (moved < 1e-6 * batch.standard_deviations("P5")).all()


@pytest.mark.parametrize("longer", [0.02, -0.02])
def test_steps_that_shrink_slowly_are_extrapolated(longer: float) -> None:
    """Two distances nearly across a direction contradict a third, which is along it.

    Each Gauss-Newton step then leaves two thirds of the way, or goes too far by as much.
    """
    network = fga.Network("across")
    for name, at in {"A": (-10, 0, 0), "B": (10, 0, 0), "C": (0, 50, 0)}.items():
        network.add_point(name, at, fixed="xyz")
    network.add_point("P", (0.0, 1.2, 0.0), fixed="z")
    across = float(np.hypot(10.0, 0.5)) + longer
    readings = (
        SlopeDistance("A", "P", across, sigma=0.01),
        SlopeDistance("B", "P", across, sigma=0.01),
        SlopeDistance("C", "P", 49.5 + 100 * longer, sigma=0.316),
    )
    network.add(*readings)
    tree = LinearISAM2(network.frame)
    tree.enter([arriving(network, *readings)])
    assert tree.follow() < MAX_TURNS
    assert tree.settle() < MAX_TURNS
    batch = fga.adjust(network, tolerance=1e-9)
    moved = np.abs(tree.value("point", "P") - batch.point("P"))
    assert (moved <= 1e-6 * batch.standard_deviations("P")).all()


def test_rows_are_evaluated_anew_only_where_something_moved() -> None:
    solution = fga.adjust(small_block())
    tree = whole(solution)
    tree.follow()
    assert tree.relinearised == 0


@pytest.mark.parametrize("what", ["row", "anew", "new point", "leaves", "lost"])
def test_a_mark_brings_the_tree_back(what: str) -> None:
    """Whatever was done since."""
    network = levels(4)
    tree = LinearISAM2(network.frame)
    first = [HeightDifference("A", "P0", 1.0, sigma=0.001, id="a")]
    first += [HeightDifference("P0", "P1", 0.5, sigma=0.001, id="b")]
    first += [HeightDifference("A", "P1", 1.501, sigma=0.001, id="c")]
    tree.enter([arriving(network, *first)])
    before = float(tree.value("point", "P1")[2]), tree.covariance(("point", "P1"))
    mark = tree.mark()
    unit = tree.enter([arriving(network, HeightDifference("A", "P1", 1.7, sigma=0.001, id="d"))])
    if what == "anew":
        tree._relinearise(unit, np.zeros(tree._delta.n))
    elif what == "new point":
        tree.enter([arriving(network, HeightDifference("A", "P2", 2.0, sigma=0.001, id="e"))])
    elif what == "leaves":
        tree.leave(np.array([tree.unit["c"]]))
    elif what == "lost":
        with pytest.raises(IndeterminateError):
            tree.enter([arriving(network, HeightDifference("P2", "P3", 0.1, sigma=0.001))])
    tree.restore(mark)
    assert tree.version == mark.version
    assert set(tree.unit) == {"a", "b", "c"} and tree.n_rows == 3 and tree.n_unknowns == 2
    assert float(tree.value("point", "P1")[2]) == pytest.approx(before[0], abs=1e-12)
    assert tree.covariance(("point", "P1")) == pytest.approx(before[1], rel=1e-9)
    # It goes on from there.
    again = tree.enter([arriving(network, HeightDifference("A", "P1", 1.5, sigma=0.001, id="d"))])
    network.add(*first, HeightDifference("A", "P1", 1.5, sigma=0.001, id="d"))
    batch = fga.adjust(known_part(network))
    assert float(tree.value("point", "P1")[2]) == pytest.approx(batch.point("P1")[2], abs=1e-9)
    assert tree.joint_covariance(again).tested().statistics()[0] == pytest.approx(
        fga.reliability(batch).w[3] ** 2, rel=1e-9
    )


def test_a_tree_that_is_lost_for_good_keeps_its_values(monkeypatch: pytest.MonkeyPatch) -> None:
    network = levels(3)
    tree = LinearISAM2(network.frame)
    tree.enter([arriving(network, HeightDifference("A", "P0", 1.0, sigma=0.001, id="a"))])
    mark = tree.mark()
    with pytest.raises(IndeterminateError):
        tree.enter([arriving(network, HeightDifference("P1", "P2", 0.3, sigma=0.001))])
    monkeypatch.setattr(LinearISAM2, "_plant", lambda _: None)
    tree.restore(mark)
    assert tree.lost and tree.version == mark.version
    assert float(tree.value("point", "P0")[2]) == pytest.approx(1.0, abs=1e-12)
    with pytest.raises(IndeterminateError):
        tree.covariance(("point", "P0"))


def known_part(network: fga.Network) -> fga.Network:
    """Return a network without points that nothing observes."""
    part = fga.Network(network.name, frame=network.frame)
    touched = {n for o in network.observations.values() for n in o.names()}
    for name, point in network.points.items():
        if name in touched:
            fixed = "".join(c for c, f in zip("xyz", point.fixed, strict=True) if f)
            part.add_point(name, point.coordinates, fixed=fixed)
    part.add(*network.observations.values())
    return part


def test_the_diagonal_of_the_normal_matrix_counts_correlated_groups_whitened() -> None:
    network = levels(3)
    rises = [HeightDifference("A", "P0", 1.0, sigma=0.001, id="a")]
    rises += [HeightDifference("P0", "P1", 0.5, sigma=0.001, id="b")]
    rises += [HeightDifference("A", "P1", 1.5, sigma=0.001, id="c")]
    covariance = 1e-6 * (0.2 * np.eye(3) + 0.8)
    tree = LinearISAM2(network.frame)
    units = tree.enter([arriving(network, Correlated(rises, covariance))])
    a = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, 1.0]])
    normal = a.T @ np.linalg.inv(covariance) @ a
    columns = [int(tree.columns("point", name)[2]) for name in ("P0", "P1")]
    assert tree.weight(np.array(columns)) == pytest.approx(np.sqrt(np.diag(normal)), rel=1e-12)
    tree._relinearise(units, np.zeros(tree._delta.n))
    assert tree.weight(np.array(columns)) == pytest.approx(np.sqrt(np.diag(normal)), rel=1e-12)
