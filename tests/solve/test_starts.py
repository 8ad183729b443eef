"""Poor starts: ours against scipy's trf and GTSAM's Levenberg-Marquardt with native factors.

``python -m tests.benchmarks.starts`` compares 500 blocks; these are a few of each sort.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.solve.minimum import LOWER_MINIMUM_NOTE, adjust_from_start
from factorgraph_adj.start.start_values import Start, approximate_start
from tests.benchmarks.starts import Compared, centres_off, compare
from tests.networks.poor_starts import WRONG, poor_start, right_pixels
from tests.support.other_solvers import cost, native

LONG = pytest.mark.slow(
    "poor starts of whole blocks against other solvers; short tests take small networks"
)

WEAK = "weak control, 40° and half as large"
NOISY = "poses with 30° and 20 % noise"
COMPARED = (
    "principal distance off by half",
    NOISY,
    WEAK,
    "pose graphs without initial values",
)


@pytest.mark.slow("three solvers on blocks of every sort; short tests look at our result alone")
@pytest.mark.parametrize("sort", COMPARED)
def test_no_other_solver_reaches_a_lower_cost(sort: str) -> None:
    if sort == NOISY:  # better starts than these come from the images
        pytest.importorskip("poselib")
    found = Compared()
    for number in range(2):
        compare(poor_start(sort, number), number, found)
    assert found.lowest["ours"] == found.converged == 2
    assert not found.refused and not found.silent


@LONG
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


@LONG
def test_a_bad_fit_that_was_reached_from_afar_says_that_a_lower_minimum_may_exist() -> None:
    good, bad = poor_start(WEAK, 0), poor_start(WEAK, 0)
    at = np.array(bad.photos["F0"].position) + np.array([300.0, 0.0, 0.0])
    bad.add(fga.PhotoPosition("F0", tuple(at.tolist()), sigma=(1.0, 1.0, 1.0)))
    solution = fga.adjust(bad)
    assert solution.converged
    assert solution.vtpv > 10.0 * solution.redundancy
    assert LOWER_MINIMUM_NOTE in solution.reason
    solution = fga.adjust(good)
    assert solution.converged
    assert LOWER_MINIMUM_NOTE not in solution.reason
    near = fga.adjust(bad, start=fga.adjust(bad))
    assert near.converged and LOWER_MINIMUM_NOTE not in near.reason


@LONG
@pytest.mark.parametrize("number", range(2))
def test_wrong_pixels_have_no_minimum_and_the_reason_names_their_points(number: int) -> None:
    """Of these blocks 15 % of the image points are anywhere; snooping finds what is right."""
    network = poor_start(WRONG, number)
    plain = fga.adjust(network)
    assert not plain.converged
    assert "points at infinity: P" in plain.reason or "projection centres: P" in plain.reason
    assert "adjust --snoop" in plain.reason


@LONG
def test_data_snooping_of_given_poses_finds_wrong_pixels() -> None:
    pytest.importorskip("poselib")
    right = fga.adjust(right_pixels(0))
    found = fga.snoop(poor_start(WRONG, 0)).solution
    assert right.converged and found.converged
    assert centres_off(found.state, right) < 5.0


def spoiled(start: Start) -> Start:
    """Return a start from which nothing converges: all photos look up, from far away."""
    pose = start.state["pose"].copy()
    pose[:, 9:] += [0.0, 0.0, -500.0]
    return replace(start, state={**start.state, "pose": pose})


def test_the_given_values_are_tried_where_the_start_that_replaced_them_fails() -> None:
    network = poor_start("principal distance off by half", 1)
    equations = compile_network(network)
    good = approximate_start(equations, network.datum, None)
    expected = adjust_from_start(equations, good, free=False)
    most = expected.iterations
    bad = replace(spoiled(good), words=("Elsewhere.",), instead_of=good.state)
    found = adjust_from_start(equations, bad, free=False, max_iterations=most)
    assert found.converged and found.vtpv == expected.vtpv
    assert found.begun[0] == "Elsewhere."
    assert "repeated from the given poses and coordinates" in found.begun[1]
    fine = replace(good, words=("Elsewhere.",), instead_of=bad.state)
    assert adjust_from_start(equations, fine, free=False).begun == ("Elsewhere.",)
    neither = adjust_from_start(equations, fine, free=False, max_iterations=1)
    assert not neither.converged
    assert "did not converge either" in neither.begun[1]
