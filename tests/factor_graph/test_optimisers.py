"""GTSAM's optimisers, marginals and iSAM2 with their defaults reach what `adjust` reaches."""

from __future__ import annotations

import contextlib
import io
import runpy

import gtsam
import pytest

import factorgraph_adj as fga
from tests.networks.every_kind import LENSES_USED
from tests.networks.lens_blocks import lens_block
from tests.support.optimisers import OPTIMISERS, covariances_differ, distance, isam2
from tests.support.places import EXAMPLES

LONG = pytest.mark.slow(
    "every lens and every network of the examples; short tests take one lens and one project"
)
FEW = ("brown", "fisheye")
STOPS = 0.01
"""Largest distance, in σ, at which GTSAM's default tolerances stop."""
SLOW = {"harmonic": 0.05}
"""The same of lenses whose iterations creep."""
SAME = 1e-6


def solved(network: fga.Network) -> fga.Solution:
    return fga.adjust(network, tolerance=1e-9)


# Photos of a line scanner that stand still see nothing of y.
LENSES = [pytest.param(n, marks=() if n in FEW else LONG) for n in LENSES_USED if n != "line"]


@pytest.mark.parametrize("lens", LENSES)
def test_optimisers_with_default_parameters_end_at_our_minimum(lens: str) -> None:
    network = lens_block(lens)
    solution = solved(network)
    assert solution.converged
    built = fga.build_graph(network)
    for name, optimiser in OPTIMISERS.items():
        values = optimiser(built).optimize()
        assert distance(solution, built, values) < SLOW.get(lens, STOPS), name


@pytest.mark.parametrize("lens", LENSES)
def test_small_tolerances_and_isam2_reach_our_minimum_from_the_start_values(lens: str) -> None:
    network = lens_block(lens)
    solution, built = solved(network), fga.build_graph(network)
    for optimiser, params, bound in (
        (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams(), SAME),
        # They stop where the rounding of vᵀPv hides what a step brings.
        (gtsam.DoglegOptimizer, gtsam.DoglegParams(), 10 * SAME),
        (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams(), 10 * SAME),
    ):
        params.setRelativeErrorTol(1e-15)
        params.setAbsoluteErrorTol(1e-13)
        values = optimiser(built.graph, built.values, params).optimize()
        assert distance(solution, built, values) < bound
    assert distance(solution, built, isam2(built)) < SAME


@pytest.mark.parametrize("lens", LENSES)
def test_at_our_solution_they_stay_and_marginals_are_our_covariances(lens: str) -> None:
    solution = solved(lens_block(lens))
    built = fga.build_graph(solution.network, state=solution.state)
    for optimiser in OPTIMISERS.values():
        assert distance(solution, built, optimiser(built).optimize()) < SAME
    assert covariances_differ(solution, built, built.values) < SAME


# -- the examples ---------------------------------------------------------------------------------

LARGE = 2_000
"""Number of factors beyond which GTSAM's copies of all values take too long for a test."""
RIGID = 1e-5
"""Largest difference of covariances where rigid ties weigh less than they should."""
READ = 10.0
"""σ̂0 of a network of readings; designs without readings have more."""


def networks_of(script: str) -> dict[str, fga.Network]:
    """Return the networks with readings that a script leaves in its variables, by their names."""
    with contextlib.redirect_stdout(io.StringIO()), pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", [script])
        found = runpy.run_path(str(EXAMPLES / f"{script}.py"), run_name="__main__")
    return {
        name: x
        for name, x in found.items()
        if isinstance(x, fga.Network) and (x.observations or x.n_image_points)
    }


SCRIPTS = sorted(p.stem for p in EXAMPLES.glob("gallery_*.py"))


@LONG
@pytest.mark.parametrize("script", SCRIPTS)
def test_every_network_of_the_examples_ends_at_our_minimum(script: str) -> None:
    for name, network in networks_of(script).items():
        try:
            solution = solved(network)
        except fga.DatumError:
            continue  # a design, or a part of what is adjusted
        if not solution.converged or not solution.sigma0 < READ:
            continue
        built = fga.build_graph(network)
        if built.graph.size() > LARGE:
            continue
        for which, optimiser in OPTIMISERS.items():
            done = optimiser(built)
            values = done.optimize()
            assert 2.0 * done.error() == pytest.approx(solution.vtpv, rel=1e-4), (name, which)
            if solution.datum is None:  # the inner constraints of a graph are those at its start
                assert distance(solution, built, values) < STOPS, (name, which)
        again = fga.build_graph(solution.network, state=solution.state)
        bound = RIGID if network.mounts else SAME
        assert covariances_differ(solution, again, again.values) < bound, name


def test_the_project_of_the_examples_ends_at_our_minimum() -> None:
    network = fga.read_project(EXAMPLES / "industry_block")
    solution, built = solved(network), fga.build_graph(network)
    for optimiser in OPTIMISERS.values():
        assert distance(solution, built, optimiser(built).optimize()) < STOPS
