"""Other weights for an adjusted network: the structure is kept, the result is that of `adjust`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import gtsam
import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.factor_graph.network_graph import build_graph
from factorgraph_adj.solve.factorisation import EliminationPlan
from factorgraph_adj.solve.gauss_newton_steps import Step
from factorgraph_adj.solve.given_state import solution_after_step
from factorgraph_adj.solve.minimum import readjust
from factorgraph_adj.types import Array
from tests.networks.adjusted import ADJUSTED
from tests.networks.small_block import small_block
from tests.support.elimination_rules import everything_by_qr

LARGE = ("AICON", "Roma", "Ladybug, a cut")
"""Networks that show no more than the others, in more time."""
NAMES = [name for name in ADJUSTED if name not in LARGE]
MOST = 1e-4
"""Largest difference of an estimate relative to its σ: ten times the tolerance of `adjust`."""


def weights_of(n: int, *, clusters: list[Array] = [], seed: int = 1) -> Array:  # noqa: B006
    """Return factors from ½ to 2 of the weights of n rows, one for each cluster."""
    weights = np.exp(np.random.default_rng(seed).uniform(-0.7, 0.7, n))
    for rows in clusters:
        weights[rows] = weights[rows[0]]
    return weights


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", NAMES)
def test_adjusting_again_with_other_weights_is_adjusting(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    solution = adjust(ADJUSTED[name]())
    if not solution.converged:
        pytest.skip("it has no minimum")
    weights = weights_of(
        solution.equations.n_rows, clusters=[c.rows for c in solution.equations.clusters]
    )
    expected = adjust(solution.network, start=solution, weights=weights)
    made = 0
    of = EliminationPlan.of.__func__  # type: ignore[attr-defined]

    def counted(cls: type[EliminationPlan], *args: object) -> EliminationPlan:
        nonlocal made
        made += 1
        return of(cls, *args)

    monkeypatch.setattr(EliminationPlan, "of", classmethod(counted))
    once = readjust(solution, weights)
    twice = readjust(readjust(solution, 1.0 / weights), weights)
    assert made == 0
    for found in (once, twice):
        assert found.converged == expected.converged
        assert found.vtpv == pytest.approx(expected.vtpv, rel=1e-8, abs=1e-8)
        assert found.redundancy == expected.redundancy
        sigma = np.sqrt(np.einsum("pii->pi", expected.point_covariances))
        moved = np.abs(found.state["point"] - expected.state["point"])
        assert np.all(moved <= MOST * sigma + 1e-11 * (1.0 + np.abs(expected.state["point"])))
        np.testing.assert_allclose(
            found.equations.sigmas(), expected.equations.sigmas(), rtol=1e-7, atol=0
        )


@pytest.mark.parametrize("kind", [nullcontext, everything_by_qr])
def test_a_step_with_other_weights_leads_to_their_minimum(
    kind: Callable[[], AbstractContextManager[None]],
) -> None:
    with kind():
        solution = adjust(small_block(seed=2))
    weights = weights_of(solution.equations.n_rows)
    here = solution_after_step(solution, np.zeros(solution.equations.unknowns.n_columns), weights)
    assert not here.converged
    assert here.run.solver.plan is solution.run.solver.plan
    far = Step.of(here.factor, here.normal().gradient)
    there = solution_after_step(here, far.movement, weights)
    near = Step.of(there.factor, there.normal().gradient)
    assert near.bound < 0.05 * far.bound
    again = solution_after_step(there, near.movement, weights)
    expected = adjust(solution.network, start=solution, weights=weights)
    # Lengths of sights, on which some weights depend, have moved by 1e-7.
    assert again.vtpv == pytest.approx(expected.vtpv, rel=1e-6)


def test_factors_of_the_user_take_part_in_steps_and_are_missed_after_pickling() -> None:
    import pickle

    network = small_block()
    k = build_graph(network).keys
    line = (k.key("point", "P1"), k.key("point", "P12"))
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.0005)
    a, b = network.points["P1"].coordinates, network.points["P12"].coordinates
    length = float(np.linalg.norm(np.subtract(a, b)))
    factor = gtsam.RangeFactor3(*line, length, noise)
    solution = adjust(network, extra_factors=[factor])
    weights = weights_of(solution.equations.n_rows)
    expected = adjust(network, weights=weights, extra_factors=[factor])
    assert readjust(solution, weights).vtpv == pytest.approx(expected.vtpv, rel=1e-8)
    with pytest.raises(InputError, match="extra_factors="):
        readjust(pickle.loads(pickle.dumps(solution)), weights)
