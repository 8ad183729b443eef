"""The parts of the iteration alone: a step, its damping, its judgement, sides of cameras, ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.blocks import Block
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.variables import State
from factorgraph_adj.models.base import Linearised
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import HeightDifference, ImagePoint
from factorgraph_adj.solve.adjustment_run import (
    AdjustmentRun,
    drift_reason,
    raise_overflow,
    refuse_undetermined,
)
from factorgraph_adj.solve.convergence import (
    STOPPING,
    Judgement,
    SmallestStep,
    StepRecord,
    convergence_reason,
    is_hidden_by_rounding,
    no_higher,
    no_worse,
)
from factorgraph_adj.solve.feasible_states import (
    describe_points_behind,
    is_behind_camera,
    refuse_points_behind,
    with_points_held_in_front,
)
from factorgraph_adj.solve.gauss_newton import iterate, step_from
from factorgraph_adj.solve.gauss_newton_steps import DAMPING, Attempt, Damping, Step
from factorgraph_adj.start.start_values import approximate_start
from factorgraph_adj.types import Array
from tests.benchmarks.grids import simulate_grid
from tests.networks.small_block import small_block

SOMEWHERE: State = {"point": np.zeros((1, 3))}


class Inverse:
    """N + λD as its dense inverse."""

    def __init__(self, n: Array) -> None:
        self.q = np.linalg.inv(n)

    def solve(self, y: Array) -> Array:
        return np.asarray(self.q @ y)


# -- a step ----------------------------------------------------------------------------------------


def test_a_step_predicts_what_a_parabola_does() -> None:
    """VᵀPv of linear observations is a parabola: the prediction comes true, damped or not."""
    rng = np.random.default_rng(1)
    a, v = rng.normal(size=(9, 4)), rng.normal(size=9)
    n, gradient = a.T @ a, a.T @ v
    for damping in (0.0, 1e-3, 10.0):
        damped = damping * np.diag(n)
        step = Step.of(Inverse(n + np.diag(damped)), gradient, damped)
        after = v + a @ step.movement
        assert step.decrease == pytest.approx(float(v @ v - after @ after))
        squared = step.movement @ (n + np.diag(damped)) @ step.movement
        assert step.bound == pytest.approx(np.sqrt(squared))
    assert Step.of(Inverse(n), gradient).decrease == pytest.approx(
        Step.of(Inverse(n), gradient).bound ** 2
    )


def test_no_function_moves_further_than_the_bound_relative_to_its_sigma() -> None:
    rng = np.random.default_rng(2)
    a, v = rng.normal(size=(9, 4)) @ np.diag([1.0, 1e3, 1e-3, 10.0]), rng.normal(size=9)
    q = np.linalg.inv(a.T @ a)
    step = Step.of(Inverse(a.T @ a), a.T @ v)
    f = rng.normal(size=(500, 4)) / np.array([1.0, 1e3, 1e-3, 10.0])
    moved = np.abs(f @ step.movement) / np.sqrt(np.einsum("ij,jk,ik->i", f, q, f))
    assert moved.max() <= step.bound
    worst = step.movement @ np.linalg.inv(q)
    reached = abs(worst @ step.movement) / np.sqrt(worst @ q @ worst)
    assert reached == pytest.approx(step.bound)


# -- damping ---------------------------------------------------------------------------------------


def test_damping_begins_small_and_grows_faster_and_faster() -> None:
    values = []
    damping = Damping()
    for _ in range(5):
        damping = damping.harder()
        values.append(damping.value)
    assert values == pytest.approx(DAMPING.first * np.array([1.0, 4.0, 32.0, 512.0, 16384.0]))


def test_damping_ends_where_there_is_no_way_on() -> None:
    damping, failures = Damping(), 0
    while not damping.hopeless:
        damping, failures = damping.harder(), failures + 1
    assert failures < 15
    assert not Damping(DAMPING.most).hopeless


def test_an_undamped_step_that_succeeds_is_followed_by_an_undamped_one() -> None:
    assert Damping().relaxed(1.0, 0.5) == Damping(0.0, DAMPING.least)


@pytest.mark.parametrize(("gain", "factor"), [(1.0, 0.1), (0.5, 1.0), (1e-3, 1.994), (3.0, 0.1)])
def test_damping_is_relaxed_by_what_a_step_brought(gain: float, factor: float) -> None:
    """1 − (2ρ − 1)³, and no less than a tenth (Nielsen 1999); more than predicted is as much."""
    relaxed = Damping(1e-2, 1e-4, 64.0).relaxed(gain, 0.5)
    assert relaxed.value == pytest.approx(1e-2 * factor, rel=1e-3)
    assert (relaxed.resume, relaxed.growth) == (1e-4, DAMPING.growth)


def test_near_the_minimum_steps_are_undamped_and_damping_resumes_where_it_was() -> None:
    relaxed = Damping(1e-2).relaxed(0.5, 0.9 * DAMPING.near)
    assert relaxed == Damping(0.0, 1e-2)
    assert relaxed.harder().value == 1e-2
    assert Damping(2 * DAMPING.least).relaxed(1.0, 0.5) == Damping(0.0, DAMPING.least)


# -- judgement -------------------------------------------------------------------------------------


def attempt(bound: float, before: float, after: float, *, decrease: float | None = None) -> Attempt:
    """Return a step of some bound; undamped ones predict the square of the bound."""
    predicted = bound**2 if decrease is None else decrease
    state = None if np.isinf(after) else SOMEWHERE
    assert before > 0
    return Attempt(Step(np.zeros(3), predicted, bound), state, after)


def test_a_step_that_brings_what_it_promises_is_taken() -> None:
    judged = StepRecord(1e-5).judge(attempt(3.0, 100.0, 91.0), 100.0, damped=False)
    assert judged == Judgement(1.0, 3.0, small=False, accepted=True, done=False)


@pytest.mark.parametrize("after", [100.0, 99.992, np.inf])
def test_a_step_that_brings_next_to_nothing_is_not(after: float) -> None:
    judged = StepRecord(1e-5).judge(attempt(3.0, 100.0, after), 100.0, damped=False)
    assert judged.gain < STOPPING.worthwhile
    assert not judged.accepted
    assert not judged.small


def test_a_small_undamped_step_is_the_last() -> None:
    stop = StepRecord(1e-5)
    judged = stop.judge(attempt(0.9e-5, 100.0, 100.0), 100.0, damped=False)
    assert (judged.small, judged.accepted, judged.done) == (True, True, True)
    assert judged.left == 0.9e-5
    damped = stop.judge(attempt(0.9e-5, 100.0, 100.0), 100.0, damped=True)
    assert not damped.done


def test_fast_convergence_says_what_is_left_after_a_step() -> None:
    """0.1 and then 0.001: what is left is 1e-5, but not after an extrapolation, nor from far."""
    stop = StepRecord(1.1e-5, last=0.1)
    last = attempt(1e-3, 100.0, 100.0 - 1e-6)
    judged = stop.judge(last, 100.0, damped=False)
    assert judged.left == pytest.approx(1e-5)
    assert (judged.done, judged.expected) == (False, True), "the next step verifies it"
    for other in (replace(stop, plain=False), replace(stop, last=np.inf)):
        judged = other.judge(last, 100.0, damped=False)
        assert (judged.left, judged.expected) == (1e-3, False)
    for rate in (0.2, 0.5, 0.8):  # a geometric series
        judged = replace(stop, last=1e-3 / rate).judge(last, 100.0, damped=False)
        assert judged.left == pytest.approx(1e-3 * sum(rate**k for k in range(1, 200)))
    far = StepRecord(10.0, last=1e3).judge(
        attempt(STOPPING.close, 100.0, 99.0), 100.0, damped=False
    )
    assert far.left == STOPPING.close


def test_what_is_expected_to_be_at_rest_is_looked_at() -> None:
    """The step from there is not taken where it confirms it, and counts where it does not."""
    stop = replace(StepRecord(1e-5, last=0.01), expecting=True)
    confirmed = stop.judge(attempt(5e-6, 100.0, 100.0), 100.0, damped=False)
    assert (confirmed.arrived, confirmed.done) == (True, True)
    assert confirmed.left == pytest.approx(5e-6, rel=1e-3)
    refuted = stop.judge(attempt(2e-3, 100.0, 100.0 - 4e-6), 100.0, damped=False)
    assert (refuted.arrived, refuted.done, refuted.accepted) == (False, False, True)
    assert not stop.judge(attempt(5e-6, 100.0, 100.0), 100.0, damped=True).arrived


def test_below_the_resolution_of_the_coordinates_steps_are_rounding() -> None:
    """A state that is at rest stays: the next one may be further away. Few steps are in vain."""
    stop = replace(StepRecord(1e-5, last=1.0), resolution=1e-3)
    assert stop.judge(attempt(5e-6, 100.0, 100.0), 100.0, damped=False).arrived
    for _ in range(1 + STOPPING.in_vain // STOPPING.rounded):
        assert not stop.rest.exhausted
        short = attempt(5e-4, 100.0, 100.0)
        judged = stop.judge(short, 100.0, damped=False)
        assert (judged.small, judged.accepted, judged.done) == (True, True, False)
        stop = stop.noted(short, judged, 100.0, SOMEWHERE)
    assert stop.rest.exhausted
    assert stop.near_enough(5e-4, 1.0)
    assert not stop.near_enough(2e-3, 1.0)


def test_a_step_that_makes_it_worse_is_not_the_last() -> None:
    judged = StepRecord(1e-5).judge(attempt(0.9e-5, 100.0, 100.1), 100.0, damped=False)
    assert not judged.small
    assert not judged.accepted


def test_where_vtpv_cannot_tell_steps_are_taken_and_not_the_last() -> None:
    """A step of 10⁻⁴ σ predicts 10⁻⁸ of vᵀPv = 10⁵."""
    judged = StepRecord(1e-5).judge(attempt(1e-4, 1e5, 1e5 * (1 + 1e-10)), 1e5, damped=False)
    assert (judged.small, judged.accepted, judged.done) == (True, True, False)
    assert (
        not StepRecord(1e-5).judge(attempt(1e-4, 1e5, 1e5 * (1 + 1e-8)), 1e5, damped=False).accepted
    )


def test_what_vtpv_can_tell() -> None:
    assert is_hidden_by_rounding(1e-4, 1e-8, 1e5)
    assert not is_hidden_by_rounding(1e-4, 1e-8, 1e3)
    assert not is_hidden_by_rounding(STOPPING.still, 1e-8, 1e5)
    assert no_worse(100.0 + 1e-5, 100.0)
    assert not no_worse(100.0 + 1e-3, 100.0)
    assert not no_worse(np.nan, 100.0)
    assert not no_worse(np.inf, 100.0)
    assert no_higher(1e5 * (1 + 0.9e-9), 1e5)
    assert not no_higher(1e5 * (1 + 1.1e-9), 1e5)


# -- when to stop ----------------------------------------------------------------------------------


def test_the_smallest_step_counts_once_steps_do_not_shrink_any_more() -> None:
    states: list[State] = [{"point": np.full((1, 3), float(i))} for i in range(20)]
    rest = SmallestStep()
    bounds = [1e-3, 1e-4, 2e-5, 1.9e-5, *(3e-5 for _ in range(9))]
    for bound, state in zip(bounds, states, strict=False):
        assert not rest.exhausted
        rest = rest.with_step(bound, state, 0.0)
    # 1.9e-5 is the smallest, though no progress beside 2e-5.
    assert rest.exhausted
    assert rest.bound == 1.9e-5
    assert rest.state is states[3]


def test_steps_that_shrink_again_are_not_in_vain() -> None:
    rest = SmallestStep()
    for bound in (1e-3, *([1e-3] * 9), 0.7e-3):
        rest = rest.with_step(bound, SOMEWHERE, 0.0)
    assert (rest.in_vain, rest.bound) == (0, 0.7e-3)


def test_a_decrease_that_vtpv_can_tell_begins_anew() -> None:
    stop = StepRecord(1e-5, rest=SmallestStep(1e-4, SOMEWHERE, 9))
    hidden = attempt(1e-4, 1e5, 1e5)
    judged = stop.judge(hidden, 1e5, damped=False)
    assert stop.noted(hidden, judged, 1e5, SOMEWHERE).rest.exhausted
    seen = attempt(1e-4, 1e5, 1e5 - 1.0)
    judged = stop.judge(seen, 1e5, damped=False)
    assert stop.noted(seen, judged, 1e5, SOMEWHERE).rest.in_vain == 0
    # The last step of all is none of them.
    done = attempt(1e-6, 1e5, 1e5)
    judged = stop.judge(done, 1e5, damped=False)
    assert stop.noted(done, judged, 1e5, SOMEWHERE).rest == stop.rest


def test_steps_without_progress_are_counted_in_a_row() -> None:
    stop = StepRecord(1e-5, last=2.0)
    for _ in range(STOPPING.patience):
        assert not stop.in_vain
        stop = stop.moved(2.0, 100.0, 100.0 - 1e-5, plain=True)
    assert stop.in_vain
    assert stop.moved(2.0, 100.0, 99.0, plain=True).slow == 0
    assert stop.moved(1.5, 100.0, 100.0, plain=True).slow == 0, "steps that shrink are progress"


def test_an_extrapolation_pays_where_steps_shrink_slowly() -> None:
    assert StepRecord(1e-5, last=1.0).slows_down(0.5)
    assert not StepRecord(1e-5, last=1.0).slows_down(0.05)
    assert not StepRecord(1e-5).slows_down(1e9), "of a first step nothing is known"


def test_an_undamped_step_is_near_enough_by_either_criterion() -> None:
    stop = StepRecord(1e-5)
    assert stop.near_enough(0.9e-5, 1.0)
    assert stop.near_enough(1e-4, 1e5)
    assert not stop.near_enough(1e-4, 1.0)
    assert not stop.near_enough(np.inf, 1e30)


def test_reasons_say_which_criterion_it_was() -> None:
    assert convergence_reason(1e-6, 1e-5) == (
        "no unknown is further than 1e-05 of its σ from the minimum"
    )
    assert convergence_reason(2e-4, 1e-5) == (
        "vᵀPv is at its resolution; no unknown is further than 0.0002 of its σ from the minimum"
    )
    assert convergence_reason(2e-4, 1e-5, 1e-3) == (
        "the coordinates have no more digits; no unknown is further than 0.0002 of its σ "
        "from the minimum"
    )


# -- sides of cameras ------------------------------------------------------------------------------


def one_photo() -> tuple[fga.Network, State]:
    """Return a photo that looks down from 20 m on P (0 m) and Q (25 m, behind it)."""
    network = fga.Network("one photo")
    network.add_camera("camera", NoDistortion(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    network.add_photo("f", "camera", position=(0.0, 0.0, 20.0), rotation=down)
    for name, z in (("P", 0.0), ("Q", 25.0)):
        network.add_point(name, (1.0, 2.0, z))
        network.add(ImagePoint("f", name, 0.0, 0.0, sigma=0.01))
    return network, compile_network(network).unknowns.start()


def test_points_that_a_step_takes_past_a_camera_stay_where_they_were() -> None:
    network, state = one_photo()
    equations = compile_network(network)
    assert is_behind_camera(equations, state).tolist() == [False, True]
    points = state["point"] + [[0.5, 0.0, 21.0], [0.5, 0.0, 1.0]]
    kept = with_points_held_in_front(equations, state, {**state, "point": points})
    assert kept is not None
    np.testing.assert_array_equal(kept["point"][0], state["point"][0])
    # The other one was behind already.
    np.testing.assert_array_equal(kept["point"][1], points[1])
    fine = {**state, "point": state["point"] + 0.1}
    assert with_points_held_in_front(equations, state, fine) is fine


def test_a_camera_that_passes_its_points_has_no_state() -> None:
    network, state = one_photo()
    equations = compile_network(network)
    pose = state["pose"].copy()
    pose[0, 11] = -1.0
    assert with_points_held_in_front(equations, state, {**state, "pose": pose}) is None


@pytest.mark.parametrize(("part", "kept"), [(0.6, True), (0.4, False), (-1.0, False), (9.0, True)])
def test_a_step_leaves_half_of_a_principal_distance(part: float, kept: bool) -> None:
    network, state = one_photo()
    moved = {**state, "calibration": state["calibration"] * [part, 1.0, 1.0]}
    found = with_points_held_in_front(compile_network(network), state, moved)
    assert (found is moved) is kept
    assert kept or found is None


def test_an_iteration_says_which_points_it_has_taken_behind_cameras() -> None:
    network, state = one_photo()
    equations = compile_network(network)
    assert describe_points_behind(equations, state, state) == ""
    far = {**state, "point": state["point"] + [0.0, 0.0, 30.0]}
    assert describe_points_behind(equations, state, far) == (
        "the point of image f P ended behind the camera, which saw it at the start"
    )
    assert describe_points_behind(equations, far, state) == ""


def test_points_behind_their_camera_are_refused_by_name() -> None:
    network, state = one_photo()
    equations = compile_network(network)
    with pytest.raises(fga.InputError, match="image f Q: the adjusted point lies behind"):
        refuse_points_behind(equations, state)
    low = {**state, "point": state["point"] + [0.0, 0.0, 30.0]}
    with pytest.raises(fga.InputError, match=r"photo 'f': all 2 points lie behind it"):
        refuse_points_behind(equations, low)
    refuse_points_behind(equations, {**state, "point": state["point"] * [1.0, 1.0, 0.0]})


# -- the loop --------------------------------------------------------------------------------------


def begun(network: fga.Network) -> AdjustmentRun:
    equations = compile_network(network)
    start = approximate_start(equations, network.datum, None)
    weighted = equations.weighted_at(start.state)
    return AdjustmentRun.at(weighted, start.state, start.origin, free=network.datum == "free")


def test_a_linear_network_is_at_rest_after_one_step_and_another_to_know_it() -> None:
    network = fga.Network("line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (0.0, 0.0, 5.0), fixed="xy")
    network.add(HeightDifference("A", "B", 1.0, sigma=0.001))
    network.add(HeightDifference("A", "B", 1.002, sigma=0.001))
    told: list[tuple[int, float, float]] = []
    run = begun(network)
    ended = iterate(
        run, tolerance=1e-5, max_iterations=9, progress=lambda *figures: told.append(figures)
    )
    assert (ended.iterations, ended.converged) == (2, True)
    assert ended.reason == convergence_reason(0.0, 1e-5)
    assert ended.vtpv == pytest.approx(2.0)
    assert run.state["point"][1, 2] == pytest.approx(1.001)
    assert [i for i, _, _ in told] == [1, 2]
    assert told[0][2] == pytest.approx(3.999 * np.sqrt(2) / 0.001)
    step = step_from(run, run.normal_at(run.state))
    assert step is not None
    assert step.bound < 1e-5


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_residuals_that_are_not_finite_are_named_with_their_observations() -> None:
    network = fga.Network("line")
    for name, z in (("A", 0.0), ("B", 5.0), ("C", 7.0)):
        network.add_point(name, (0.0, 0.0, z), fixed="xyz" if name == "A" else "xy")
        if name != "A":
            network.add(HeightDifference("A", name, z, sigma=0.001))
    run = begun(network)
    run.state = {
        **run.state,
        "point": run.state["point"] + [[0.0] * 3, [0.0, 0.0, np.inf], [0] * 3],
    }
    with pytest.raises(fga.InputError) as caught:
        raise_overflow(run)
    assert str(caught.value) == "height_difference A B: its residual is not a finite number"


def test_unknowns_that_drift_are_named() -> None:
    run = begun(small_block())
    assert drift_reason(run, 2.0).endswith("(by up to 2 σ): some of them are nearly undetermined")
    run.drifting = (("point", "P9"), ("pose", "F1"))
    assert drift_reason(run, 0.5).endswith("are nearly undetermined: point 'P9', photo 'F1'")
    run.drifting = tuple(("point", f"P{i}") for i in range(1, 13))
    assert " more" in drift_reason(run, 0.5)


def test_a_pivot_that_is_poor_without_reason_is_let_pass() -> None:
    """A small pivot is only the occasion to look: this network has no motion of its own."""
    run = begun(small_block())
    refuse_undetermined(run, run.normal_at(run.state))


def test_a_system_that_cannot_be_factorised_names_what_is_undetermined() -> None:
    network = fga.Network("line")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    for name in "BC":
        network.add_point(name, (0.0, 0.0, 5.0), fixed="xy")
    network.add(HeightDifference("B", "C", 0.0, sigma=0.001))
    run = begun(network)
    # Both heights lie in one plumb line, so that rotations and scale could stand for the shift.
    with pytest.raises(fga.DatumError, match="datum defect 1: missing shift in z\n"):
        refuse_undetermined(run, run.normal_at(run.state))


def test_an_iteration_that_may_take_no_steps_has_gone_nowhere() -> None:
    run = begun(small_block())
    before = run.state
    ended = iterate(run, tolerance=1e-5, max_iterations=0)
    assert (ended.iterations, ended.converged) == (0, False)
    assert ended.vtpv == run.vtpv(before) < np.inf
    assert ended.reason == "stopped after 0 iterations: the last step was inf σ"
    assert run.state is before


def test_an_iteration_goes_on_where_another_ended() -> None:
    """All that three steps leave behind is where the run is."""
    whole, parts = begun(small_block()), begun(small_block())
    at_once = iterate(whole, tolerance=1e-9, max_iterations=50)
    assert at_once.converged
    first = iterate(parts, tolerance=1e-9, max_iterations=3)
    assert (first.iterations, first.converged) == (3, False)
    rest = iterate(parts, tolerance=1e-9, max_iterations=50)
    assert rest.converged
    assert parts.state["point"] == pytest.approx(whole.state["point"], abs=1e-9)
    assert rest.vtpv == pytest.approx(at_once.vtpv, rel=1e-12)


def test_the_reason_counts_the_iterations_of_all_weights() -> None:
    """Weights that depend on lengths are computed again: their iterations add up."""
    network = small_block()
    run = begun(network)
    ended = iterate(run, tolerance=1e-30, max_iterations=1, earlier=7)
    assert "stopped after 8 iterations" in ended.reason


# -- one evaluation for each state -----------------------------------------------------------------


def test_the_evaluation_of_an_accepted_step_is_the_next_linearisation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each block without rays is evaluated at the start and after each step, and no more."""
    run = begun(simulate_grid(1, points=100).network)
    evaluated: list[str] = []
    plain = Block.evaluate

    def evaluate(block: Block, *arguments: Any, **named: Any) -> Linearised:
        evaluated.append(block.kind)
        return plain(block, *arguments, **named)

    monkeypatch.setattr(Block, "evaluate", evaluate)
    ended = iterate(run, tolerance=1e-5, max_iterations=50)
    assert ended.converged
    kinds = [block.kind for block in run.equations.blocks]
    assert sorted(evaluated) == sorted(kinds * (ended.iterations + 1))


def test_a_linearisation_from_an_evaluation_is_that_of_its_state() -> None:
    """To the last bit; the evaluation of another state is not used, and none is used twice."""
    network = small_block()
    run, other = begun(network), begun(network)
    moved = {kind: values + 1e-4 * (kind == "point") for kind, values in run.state.items()}
    for state in (run.state, moved):
        run.vtpv(moved)
        found, wanted = run.normal_at(state), other.normal_at(state)
        assert run.last is None
        np.testing.assert_array_equal(found.system.residual, wanted.system.residual)
        for a, b in zip(found.system.blocks, wanted.system.blocks, strict=True):
            for x, y in zip(a.a, b.a, strict=True):
                np.testing.assert_array_equal(x, y)
