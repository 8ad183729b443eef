"""Poor starts: ours against scipy's trf and GTSAM's Levenberg-Marquardt with native factors.

``python -m tests.benchmarks.starts`` compares 500 blocks; these are a few of each sort.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.solve.minimum import LOWER_MINIMUM_POSSIBLE
from tests.benchmarks.starts import Compared, compare
from tests.networks.poor_starts import poor_start
from tests.support.other_solvers import cost, native

WEAK = "weak control, 40° and half as large"
NOISY = "poses with 30° and 20 % noise"
COMPARED = (
    "principal distance off by half",
    NOISY,
    WEAK,
    "pose graphs without initial values",
)


@pytest.mark.parametrize("sort", COMPARED)
def test_no_other_solver_reaches_a_lower_cost(sort: str) -> None:
    if sort == NOISY:  # better starts than these come from the images
        pytest.importorskip("poselib")
    found = Compared()
    for number in range(2):
        compare(poor_start(sort, number), number, found)
    assert found.lowest["ours"] == found.converged == 2
    assert not found.refused and not found.silent


def test_a_minimum_that_gauss_newton_leads_away_from_is_carried_to_the_datum_points() -> None:
    """Newton's steps come to rest there; Gauss-Newton's on the way to the datum points grew."""
    found = Compared()
    compare(poor_start("parts of BAL Ladybug 49", 44), 44, found)
    assert found.lowest["ours"] == found.converged == 1


def test_native_factors_have_the_cost_of_our_observations() -> None:
    """½ vᵀPv at the solution, where all points lie ahead of the cameras."""
    solution = fga.adjust(poor_start("principal distance off by half", 0))
    graph, values = native(solution.equations, solution.state)
    assert 2.0 * graph.error(values) == pytest.approx(solution.vtpv, rel=1e-9)
    assert cost(solution.equations, solution.state) == pytest.approx(solution.vtpv, rel=1e-12)


def test_a_bad_fit_that_was_reached_from_afar_says_that_a_lower_minimum_may_exist() -> None:
    good, bad = poor_start(WEAK, 0), poor_start(WEAK, 0)
    at = np.array(bad.photos["F0"].position) + np.array([300.0, 0.0, 0.0])
    bad.add(fga.PhotoPosition("F0", tuple(at.tolist()), sigma=(1.0, 1.0, 1.0)))
    solution = fga.adjust(bad)
    assert solution.converged
    assert solution.vtpv > 10.0 * solution.redundancy
    assert LOWER_MINIMUM_POSSIBLE in solution.reason
    solution = fga.adjust(good)
    assert solution.converged
    assert LOWER_MINIMUM_POSSIBLE not in solution.reason
    near = fga.adjust(bad, start=fga.adjust(bad))
    assert near.converged and LOWER_MINIMUM_POSSIBLE not in near.reason
