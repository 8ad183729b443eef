"""Steps along curved valleys, points that are pulled back, and ends of creeping iterations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.ray_lens import EquirectangularLens
from factorgraph_adj.solve.adjustment_run import AdjustmentRun
from factorgraph_adj.solve.convergence import iteration_limit_reason
from factorgraph_adj.solve.feasible_states import is_behind_camera, with_points_pulled_ahead
from factorgraph_adj.solve.gauss_newton import step_from
from factorgraph_adj.solve.gauss_newton_steps import Step
from factorgraph_adj.solve.step_refinements import accelerated_movement
from factorgraph_adj.types import Array
from tests.networks.poor_starts import SORTS, poor_start
from tests.networks.small_block import small_block

LONG = pytest.mark.slow("repeated adjustments from poor starts; short tests take one")

WEAK = "weak control, 40° and half as large"


def run_at_start(network: fga.Network) -> AdjustmentRun:
    """Return a run at the start values."""
    equations = compile_network(network)
    state = equations.unknowns.start()
    return AdjustmentRun.at(equations, state, state, free=False)


def test_an_accelerated_step_removes_the_second_order_part_of_the_residuals() -> None:
    """What is left along x(t) = x + t dx + t² a in the columns of A decreases as t³, not as t²."""
    run = run_at_start(poor_start(WEAK, 0))
    normal = run.normal_at(run.state)
    damped = 1e-3 * normal.eased
    factor = normal.factorise(damped)
    full = Step.of(factor, normal.gradient, damped)
    left = []
    for t in (0.02, 0.01):
        step = replace(full, movement=t * full.movement)
        movement = accelerated_movement(run, normal, factor, step)
        assert movement is not None
        amounts = []
        for m in (step.movement, movement):
            moved = run.whitened(run.equations.unknowns.retract(run.state, m))
            linear = (
                normal.system.every_residual + normal.system.times(step.movement[:, None])[:, 0]
            )
            remainder = normal.system.transposed((moved - linear)[:, None])[:, 0]
            amounts.append(float(np.sqrt(remainder @ factor.solve(remainder[:, None])[:, 0])))
        left.append(amounts)
    (plain, curved), (half_plain, half_curved) = left
    assert plain / half_plain == pytest.approx(4.0, rel=0.2)
    assert curved < 0.2 * plain and half_curved < 0.2 * half_plain


def test_a_linear_network_has_nothing_to_accelerate() -> None:
    network = fga.Network("levels")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (0, 0, 3.0), fixed="xy")
    network.add(fga.HeightDifference("A", "B", 1.0, sigma=0.001))
    run = run_at_start(network)
    normal = run.normal_at(run.state)
    step = step_from(run, normal)
    assert step is not None
    movement = accelerated_movement(run, normal, normal.factorise(run.constraint), step)
    assert movement == pytest.approx(step.movement)


@pytest.mark.parametrize("number", range(4))
def test_a_weakly_placed_block_comes_to_rest_in_few_iterations(number: int) -> None:
    """Without acceleration none of them does in 100."""
    found = fga.adjust(poor_start(WEAK, number))
    assert found.converged, found.reason
    assert found.iterations <= 40


def test_points_behind_their_cameras_at_the_start_are_pulled_back() -> None:
    network = small_block()
    solution = fga.adjust(network)
    equations, state = solution.equations, solution.state
    reduced = solution.run.solver.layers.reduced
    moved = np.flatnonzero(reduced)
    assert len(moved) > 1
    points = state["point"].copy()
    points[moved] += [0.0, 0.0, 40.0]
    wrong = {**state, "point": points}
    assert is_behind_camera(equations, wrong).any()
    back = with_points_pulled_ahead(equations, wrong, reduced)
    assert not is_behind_camera(equations, back).any()
    others = np.setdiff1d(np.arange(len(points)), moved)
    assert np.array_equal(back["point"][others], state["point"][others])
    assert np.abs(back["point"][moved] - state["point"][moved]).max() < 1.0
    assert with_points_pulled_ahead(equations, state, reduced) is state


def seen_by_two(point: tuple[float, float, float], images: Array) -> fga.Network:
    """Return two photos that see a point: a frame camera along +z, and a panorama along −z."""
    out = fga.Network("two cameras")
    out.add_camera("frame", NoDistortion(), {"c": 1000.0}, unit="px")
    out.add_camera("panorama", EquirectangularLens(), {"c": 1000.0}, unit="px")
    ahead = np.eye(3)  # camera axes x right, y down, z forward
    out.add_photo("F1", "frame", position=(0, 0, 0), rotation=ahead)
    out.add_photo("F2", "panorama", position=(4.0, 1.0, 5.0), rotation=np.diag([1.0, -1.0, -1.0]))
    out.add_point("P", point)
    for photo, image in zip(("F1", "F2"), images, strict=True):
        out.add_image_points(photo, ["P"], [image], sigma=0.5)
    return out


def test_a_place_behind_the_plane_of_a_panorama_is_ahead_of_it() -> None:
    """By planes both places would lie behind one camera, and the point would stay where it is."""
    true = (1.0, 2.0, 10.0)
    at_true = compile_network(seen_by_two(true, np.zeros((2, 2))))
    images = at_true.residuals(at_true.unknowns.start(), whitened=False).reshape(2, 2)
    equations = compile_network(seen_by_two((1.0, 2.0, -30.0), images))
    back = with_points_pulled_ahead(equations, equations.unknowns.start(), np.array([True]))
    assert back["point"][0] == pytest.approx(true, abs=1e-6)


def test_nothing_undetermined_is_reported_far_from_the_minimum() -> None:
    """The block is determined; where its start is singular, the iteration goes on."""
    found = fga.adjust(poor_start("poses with 30° and 20 % noise", 2))
    assert found.converged, found.reason
    assert found.sigma0 < 1.5


def test_the_reason_says_how_steps_shrink_and_how_many_more_are_needed() -> None:
    bounds = [0.5 * 0.8**k for k in range(30)]
    reason = iteration_limit_reason(30, bounds, 1e-5)
    needed = next(k for k in range(1000) if bounds[-1] * 0.8**k <= 1e-5)
    assert "0.8 times as long" in reason
    assert f"about {needed} more iterations are needed (max_iterations)" in reason
    assert "hardly shrank" in iteration_limit_reason(30, [0.3] * 30, 1e-5)
    assert "hardly shrank" in iteration_limit_reason(30, [0.3 * 1.01**k for k in range(30)], 1e-5)
    few = iteration_limit_reason(3, [1.0, 0.5, 0.25], 1e-5)
    assert few == "stopped after 3 iterations: the last step was 0.25 σ"


@LONG
@pytest.mark.parametrize("sort", [s for s in SORTS if "BAL" not in s])
def test_a_poor_start_is_the_same_each_time(sort: str) -> None:
    first, second = (compile_network(poor_start(sort, 1)) for _ in range(2))
    for kind, values in first.unknowns.start().items():
        assert np.array_equal(values, second.unknowns.start()[kind], equal_nan=True)
    assert np.array_equal(first.sigmas(), second.sigmas())
