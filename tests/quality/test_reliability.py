"""Reliability of every observation against dense inverses, and its laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from tests.benchmarks.eliminations import levelling
from tests.networks.simulated import NETWORKS
from tests.support.dense import DenseReliability
from tests.support.elimination_rules import rule

ROUNDING = 1e-8
"""What double precision leaves of a redundancy number in networks of this size."""


@pytest.fixture(scope="module", params=list(NETWORKS))
def solution(request: pytest.FixtureRequest) -> fga.Solution:
    found = fga.adjust(NETWORKS[request.param]())
    assert found.converged, found.reason
    return found


@pytest.fixture(scope="module")
def dense(solution: fga.Solution) -> DenseReliability:
    return DenseReliability.of(solution)


@pytest.fixture(scope="module")
def rel(solution: fga.Solution):
    return fga.reliability(solution)


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
def test_redundancy_numbers_and_their_parts_are_those_of_dense_inverses(rel, dense) -> None:
    np.testing.assert_allclose(
        rel.redundancy_numbers, dense.redundancy_numbers, rtol=0, atol=ROUNDING
    )
    for name in ("e1", "e2", "e12"):
        np.testing.assert_allclose(
            getattr(rel, name),
            getattr(dense, name),
            rtol=ROUNDING,
            atol=ROUNDING * max(1.0, np.abs(dense.e1).max()),
            err_msg=name,
        )


def test_tests_and_detectable_errors_are_those_of_dense_inverses(rel, dense) -> None:
    on = rel.controlled
    precision = np.diag(dense.precision)
    assert np.all(on == (precision > 1e-6 * (precision + dense.lost)))
    root = np.sqrt(precision[on])
    w = dense.weighted[on] / root
    # A rounding of r moves w and ∇ by half of it over r, and the error by all of it.
    rounding = ROUNDING * (precision[on] + dense.lost[on]) / precision[on]

    def close(ours: np.ndarray, theirs: np.ndarray, scale: np.ndarray) -> None:
        assert np.all(np.abs(ours - theirs) <= rounding * scale)

    close(rel.w[on], w, np.abs(w) + 1.0)
    close(rel.mdb[on] * root, np.full(len(root), rel.delta0), np.full(len(root), 10.0))
    expected = rel.delta0 * np.sqrt(np.maximum(dense.lost[on], 0)) / root
    assert np.all(np.abs(rel.delta_bar[on] ** 2 - expected**2) <= 40 * rounding * (1 + expected**2))
    close(rel.estimated_errors[on] * root, -w, np.abs(w) + 1.0)
    assert np.all(np.isinf(rel.mdb[~on])) and np.all(np.isnan(rel.w[~on]))


def test_the_effect_on_any_unknown_is_that_of_the_dense_inverse(rel, dense, solution) -> None:
    unknowns = solution.equations.unknowns
    scale = np.sqrt(np.maximum(np.einsum("ij,ij->i", dense.effects, dense.effects), 1e-300))
    rng = np.random.default_rng(1)
    for row in rng.choice(np.flatnonzero(rel.controlled), 6).tolist():
        for effect in rel.effect_on(row):
            columns = unknowns.columns(effect.kind, unknowns[effect.kind].number[effect.name])
            expected = dense.effects[columns, row] * rel.mdb[row]
            np.testing.assert_allclose(
                effect.values, expected, rtol=0, atol=1e-7 * (scale[columns] * rel.mdb[row]).max()
            )


def test_the_largest_effect_is_that_on_the_own_points(rel, dense, solution) -> None:
    unknowns = solution.equations.unknowns
    row = 0
    for block in solution.equations.blocks:
        for i in range(block.n):
            columns = [
                unknowns.columns("point", int(index[i]))
                for kind, index in block.variables
                if kind == "point"
            ]
            columns = [c for c in columns if len(c)]
            for _ in range(block.dimension):
                if columns and rel.controlled[row]:
                    lengths = [np.linalg.norm(dense.effects[c, row]) for c in columns]
                    expected = max(lengths) * rel.mdb[row]
                    assert rel.largest_effect[row] == pytest.approx(expected, rel=1e-6, abs=1e-12)
                elif not columns:
                    assert np.isnan(rel.largest_effect[row])
                row += 1


def test_correlations_of_test_values_are_those_of_the_dense_inverse(rel, dense) -> None:
    rows = np.argsort(-np.where(rel.controlled, np.abs(rel.w), 0.0))[:8]
    rows = rows[rel.controlled[rows]]
    m = dense.precision[np.ix_(rows, rows)]
    d = np.sqrt(np.diag(m))
    np.testing.assert_allclose(rel.correlation(rows), m / np.outer(d, d), rtol=0, atol=1e-6)


def on_one_height(sigma: float, times: int) -> fga.Network:
    """Return a levelling net of 1 mm whose height is observed a number of times, with a σ."""
    network = levelling(36)
    first = network.points["0"]
    assert first.coordinates is not None
    network.points["0"] = replace(first, fixed=(True, True, False))
    for i in range(times):
        at = (first.coordinates[2],)
        network.add(fga.ControlPoint("0", at, axes="z", sigma=(sigma,), id=f"height {i}"))
    return network


@pytest.mark.parametrize("sigma", [1.0, 20.0, 50.0])
def test_rounding_of_normal_equations_controls_nothing(sigma: float) -> None:
    """The only height of a net: rounding gives it r of up to 1.4·10⁻⁵, and ∇ was 1000 σ."""
    with rule(max_qr_variables=0):
        alone, twice = (fga.reliability(fga.adjust(on_one_height(sigma, n))) for n in (1, 2))
    row = alone.row("height 0")
    assert not alone.controlled[row]
    assert np.isnan(alone.w[row])
    assert np.isinf(alone.mdb[row])
    row = twice.row("height 0")
    assert twice.redundancy_numbers[row] == pytest.approx(0.5, abs=1e-4)
    assert twice.controlled[row]


def test_rounding_of_normal_equations_controls_no_group() -> None:
    """A net of vectors that hangs on one point with a covariance."""
    rng = np.random.default_rng(1)
    plan = fga.Network("vectors")
    for i in range(14):
        plan.add_point(f"{i}", tuple(rng.uniform(0.0, 500.0, 3).tolist()))
    for i, step in ((i, step) for i in range(14) for step in (1, 2, 5)):
        pair = f"{i}", f"{(i + step) % 14}"
        plan.add(fga.GnssVector(*pair, (0.0, 0.0, 0.0), covariance=1e-6 * (np.eye(3) + 0.5)))
    at = plan.points["0"].coordinates
    assert at is not None
    covariance = 900.0 * (1.4 * np.eye(3) - 0.4)
    plan.add(fga.ControlPoint("0", at, covariance=covariance, id="given"))
    with rule(max_qr_variables=0):
        found = fga.reliability(fga.adjust(measure(plan, seed=1)))
    (group,) = (g for g in found.groups if g.ids == ("given",))
    assert group.dof == 0
