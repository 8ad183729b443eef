"""Predicting observations that a solution has not seen."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    ControlPoint,
    Direction,
    HeightDifference,
    ImagePoint,
    SlopeDistance,
)
from factorgraph_adj.quality.prediction import Predictor, predict
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.simulation.simulated_blocks import simulate_geocentric_block
from factorgraph_adj.solve.solution import Solution
from tests.networks.small_block import small_block
from tests.support.dense import Dense

LINEAR = 2e-3
"""Part by which a test value differs where one observation of many moves the solution: the
equations are linearised elsewhere."""


@cache
def quarry() -> tuple[Network, Solution]:
    network = simulate_geocentric_block(5).network
    return network, adjust(network)


def of_each_kind() -> list[str]:
    """Return an observation of each kind, both of the correlated pair, and weighted unknowns."""
    network, solution = quarry()
    table = solution.observations
    first = dict(zip(reversed(table.kinds), reversed(table.ids), strict=True))
    return [*first.values(), *network.clusters[0][0]]


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("ident", of_each_kind())
def test_a_test_value_is_that_of_the_adjustment_with_the_observation(ident):
    """For every component of every kind: w and T², without that adjustment being made.

    T² is the growth of vᵀPv, to first order.
    """
    network, full = quarry()
    rel = reliability(full)
    rows = full.equations.find([ident])[0]
    less = adjust(without(network, [ident]), start=full)
    p = predict(less, network, ids=[ident])
    assert p.ids == (ident,)
    assert p.w == pytest.approx(rel.w[rows], rel=LINEAR, abs=LINEAR)
    # Standard deviations that depend on lengths are those of the start of each adjustment.
    again = adjust(network, start=less)
    assert p.t2[0] == pytest.approx(again.vtpv - less.vtpv, rel=LINEAR, abs=LINEAR)
    if ident not in network.clusters[0][0]:
        assert p.redundancy_numbers == pytest.approx(rel.redundancy_numbers[rows], abs=LINEAR)


def test_innovations_and_their_precision_are_those_of_dense_matrices():
    """σ² + A Q Aᵀ with Q and A of the same columns, one observation of each kind at once."""
    network, full = quarry()
    ids = of_each_kind()[:-2]
    less = adjust(without(network, ids), start=full)
    p = predict(less, network, ids=ids)
    q = Dense.at(less.equations, less.state).cofactor(np.zeros(0, dtype=bool))
    predictor = Predictor(p.equations, less)
    linear = predictor.innovations.linearise(p.rows)
    a = linear.a.toarray()
    expected = np.sqrt(np.diag(linear.covariance.toarray() + a @ q @ a.T))
    assert p.sigma == pytest.approx(expected, rel=1e-6)
    # The linearisation itself: what a step of the solution does to the innovations.
    step = np.random.default_rng(1).normal(size=len(q)) * np.sqrt(np.diag(q)) * 1e-2
    moved = less.equations.unknowns.retract(less.state, step)
    state = p.equations.unknowns.carried(
        p.equations.unknowns.start(),
        less.equations.unknowns,
        moved,
        where={k: np.ones(v.shape, dtype=bool) for k, v in predictor.innovations.state.items()},
    )
    later = p.equations.residuals(state, whitened=False)[p.rows]
    assert (later - p.innovation) / p.sigma == pytest.approx((a @ step) / p.sigma, abs=1e-5)


def test_what_the_network_has_more_is_predicted_by_default():
    network = small_block(4)
    gone = ["F1/P3", "F2/P5", "5", "40"]
    p = predict(adjust(without(network, gone)), network)
    assert set(p.ids) == set(gone)
    assert p.size.sum() == len(p.rows) == 6
    assert p.largest == pytest.approx(
        [np.abs(p.w[p.components(i)]).max() for i in range(len(p.ids))]
    )


def test_observations_need_not_be_of_a_network():
    network = small_block(4)
    solution = adjust(network)
    length = float(np.linalg.norm(solution.point("P1") - solution.point("P6")))
    p = predict(
        solution,
        [
            SlopeDistance("P1", "P6", length - 0.003, sigma=0.001),
            HeightDifference("P1", "P6", 1.0, sigma=0.001, id="dh"),
            ImagePoint("F1", "S1", 0.0, 0.0, sigma=0.004),
        ],
    )
    assert p.ids == ("48", "dh", "F1/S1")
    assert p.innovation[0] == pytest.approx(0.003, abs=1e-12)
    assert p.w[0] == pytest.approx(p.innovation[0] / p.sigma[0])
    assert p.redundancy_numbers[0] == pytest.approx(0.001**2 / p.sigma[0] ** 2)


def test_a_set_aside_member_of_a_group_is_predicted_from_its_partner_too():
    """Two heights of one point with correlated errors: the second repeats the first's error."""
    network = Network()
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (5.0, 0.0, 1.0), fixed="xy")
    variance, rho = 0.01**2, 0.9
    from factorgraph_adj.observations import Correlated

    pair = [HeightDifference("A", "B", h, sigma=0.01, id=i) for h, i in ((1.02, "a"), (1.03, "b"))]
    network.add(Correlated(tuple(pair), variance * np.array([[1.0, rho], [rho, 1.0]])))
    network.add(HeightDifference("A", "B", 1.0, sigma=0.01, id="c"))
    p = predict(adjust(without(network, ["b"])), network)
    # Height 1.01 with variance ½; b − 0.9 a has expectation 0.1 h and variance 1 − 0.9².
    assert p.innovation == pytest.approx([0.1 * 1.01 - (1.03 - rho * 1.02)])
    assert p.sigma == pytest.approx([np.sqrt(variance * (1 - rho**2 + 0.1**2 / 2))])


def test_a_free_network_predicts_coordinates_in_its_inner_constraints():
    """The covariance of a coordinate depends on the datum, that of a distance does not."""
    network = small_block(4)
    points = {n: p for n, p in network.points.items() if n.startswith("P")}
    free = Network(datum="free")
    for name, p in points.items():
        free.add_point(name, p.coordinates, datum=name < "P5")
    names = list(points)
    rng = np.random.default_rng(2)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            d = np.linalg.norm(np.subtract(points[a].coordinates, points[b].coordinates))
            free.add(SlopeDistance(a, b, d + rng.normal(0, 1e-3), sigma=1e-3))
    s = adjust(free)
    at = tuple(s.point("P2").tolist())
    p = predict(
        s,
        [
            ControlPoint("P2", at, sigma=(1e-3,) * 3, id="xyz"),
            SlopeDistance("P1", "P2", 1.0, sigma=1e-9, id="s"),
        ],
    )
    where = {i: p.components(n) for n, i in enumerate(p.ids)}
    expected = np.sqrt(np.diag(s.covariance("P2")) + 1e-6)
    assert p.sigma[where["xyz"]] == pytest.approx(expected, rel=1e-9)
    e = np.array(at) - s.point("P1")
    e /= np.linalg.norm(e)
    joint = s.covariance("P1") + s.covariance("P2") - s.covariance("P1", "P2")
    joint -= s.covariance("P2", "P1")
    assert p.sigma[where["s"]] == pytest.approx([np.sqrt(e @ joint @ e)], rel=1e-9)


def test_what_the_solution_does_not_know_is_named():
    network = small_block(4)
    solution = adjust(without(network, ["F1/P3"], points=["P12"]))
    with pytest.raises(InputError) as error:
        predict(solution, network, ids=["F1/P12", "F1/P3", "F2/P12"])
    assert len(error.value.problems) == 2
    assert "point 'P12' is not in the solution" in str(error.value)
    with pytest.raises(InputError, match="orientation of set 'S1/new' is not in the solution"):
        predict(solution, [Direction("S1", "P1", 0.0, sigma=1.0, set="new")])
    with pytest.raises(InputError, match="observation 'nobody'"):
        predict(solution, network, ids=["nobody", "F1/P3"])


def test_many_observations_are_predicted_piece_by_piece(monkeypatch):
    network = small_block(4)
    ids = [f"F{i}/P{j}" for i in (1, 2, 3, 4) for j in (1, 2, 4, 7, 8)]
    solution = adjust(without(network, ids))
    whole = predict(solution, network, ids=ids)
    monkeypatch.setattr("factorgraph_adj.quality.prediction.MAX_RIGHT_SIDE_ELEMENTS", 300)
    parts = predict(solution, network, ids=ids)
    for name in ("sigma", "w", "redundancy_numbers", "t2"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-12)


@pytest.mark.parametrize("error", [0.0, 0.5])
def test_a_point_that_went_is_intersected_from_its_rays(error):
    """vᵀD⁻¹v of the intersection is the growth of vᵀPv by the point and its rays."""
    network = small_block(4)
    _, point, xy, _ = network.images.columns()
    on = np.flatnonzero(point == list(network.points).index("P9"))  # only images see it
    xy = xy.copy()
    xy[on[0], 1] += error * 0.004
    network.images.xy = [xy]
    less = adjust(without(network, [], points=["P9"]))
    full = adjust(network, start=less)
    equations = compile_network(network)
    rows = np.sort(np.concatenate(equations.find([f"F{i}/P9" for i in (1, 2, 3, 4)])))
    found = Predictor(equations, less).intersect("P9", np.array([0.0, 0.0, 1.0]), rows)
    assert found.dof == 5
    assert found.t2 == pytest.approx(full.vtpv - less.vtpv, rel=LINEAR, abs=LINEAR)
    assert found.coordinates == pytest.approx(full.point("P9"), abs=1e-3 * 0.001)


def test_points_that_are_intersected_together_are_those_one_by_one():
    """A point without a place is lost, and its neighbours are not."""
    network = small_block(4)
    seen = network.images.columns()[1]
    names = list(network.points)
    gone = [n for n in names if (seen == names.index(n)).sum() > 1][-4:]
    less = adjust(without(network, [], points=gone))
    equations = compile_network(network)
    predictor = Predictor(equations, less)
    photos = list(network.photos)
    photo, point, *_ = network.images.columns()
    wanted = {}
    for n in gone:
        ids = [f"{photos[f]}/{n}" for f in photo[point == names.index(n)].tolist()]
        rows = np.sort(np.concatenate(equations.find(ids)))
        wanted[n] = np.array(network.points[n].coordinates) + 0.01, rows
    lost = dict(wanted) | {gone[0]: (np.full(3, np.nan), wanted[gone[0]][1])}
    together, others = predictor.intersections(wanted), predictor.intersections(lost)
    assert list(together) == gone and others[gone[0]] is None
    for n, (start, rows) in wanted.items():
        alone = predictor.intersect(n, start, rows)
        for found in (together[n], *([others[n]] if n != gone[0] else [])):
            assert found.coordinates == pytest.approx(alone.coordinates, abs=1e-9)
            assert found.t2 == pytest.approx(alone.t2, rel=1e-9)
            assert found.dof == alone.dof


def test_rows_of_observations_are_found_by_id():
    equations = compile_network(small_block(4))
    ids = [equations.id(r) for r in range(equations.n_rows)]
    number = equations.observation_of_row
    assert np.array_equal(np.unique(number), np.arange(number.max() + 1))
    for ident, rows in zip(
        dict.fromkeys(ids), equations.find(list(dict.fromkeys(ids))), strict=True
    ):
        assert [ids[r] for r in rows] == [ident] * len(rows)
        assert len(set(number[rows])) == 1
        assert ids.count(ident) == len(rows)
    assert equations.find(["nobody"])[0].size == 0
