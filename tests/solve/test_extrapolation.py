"""Where Gauss-Newton leaves the same share of the way at each step: extrapolation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.variables import State
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import HorizontalDistance, ImagePoint
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.results_json import results_record
from factorgraph_adj.report.text import text_report
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.adjustment_run import AdjustmentRun
from factorgraph_adj.solve.convergence import STOPPING, StepRecord
from factorgraph_adj.solve.gauss_newton_steps import NO_EXTRAPOLATIONS, Extrapolation


def test_a_linear_iteration_with_few_slow_directions_ends_at_once() -> None:
    """f(x) = (M − I)(x − x*): with k shares besides 0 the movement k + 1 steps later ends at x*."""
    rng = np.random.default_rng(4)
    q, _ = np.linalg.qr(rng.standard_normal((8, 8)))
    m = q @ np.diag([0.97, 0.9, -0.8, 0, 0, 0, 0, 0]) @ q.T
    target, x = rng.standard_normal(8), rng.standard_normal(8)
    a = np.diag([1.0, 10.0, 100.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    beyond = Extrapolation()
    for _ in range(6):
        step = m @ (x - target) - (x - target)
        movement = beyond.beyond(step, lambda dx: a @ dx)
        movement = step if movement is None else movement
        beyond.moved(movement)
        x = x + movement
    assert np.abs(x - target).max() < 1e-9
    assert np.linalg.norm(np.linalg.matrix_power(m, 6) @ target) > 0.5 * np.linalg.norm(
        q[:, 0] * (q[:, 0] @ target)
    ), "and without it is far away"


def test_nothing_is_known_after_it_was_cleared() -> None:
    """The steps before belong to another iteration."""
    beyond = Extrapolation()
    for step in np.eye(3):
        beyond.beyond(step, lambda dx: dx)
        beyond.moved(step)
    beyond.clear()
    beyond.moved(np.ones(3))
    assert beyond.beyond(np.ones(3), lambda dx: dx) is None


def short_base(seed: int) -> fga.Network:
    """Return two photos on a base of 1/100 of the depth, image points with 30 µm, 60 points."""
    network = fga.Network("short base")
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    held = (False, False, False, True, False, False)
    network.add_photo("left", "camera", position=(0, 0, 20), rotation=down, fixed=True)
    network.add_photo("right", "camera", position=(0.2, 0, 20), rotation=down, fixed=held)
    rng = np.random.default_rng(2)
    for i in range(60):
        network.add_point(f"P{i}", (*rng.uniform(-8, 8, 2), 20 - rng.uniform(15, 30)))
        network.add(*(ImagePoint(f, f"P{i}", 0, 0, sigma=0.03) for f in ("left", "right")))
    return measure(network, seed=seed)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_short_base_comes_to_rest(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In half the iterations, or less, and at the same minimum."""
    network = short_base(seed)
    found = fga.adjust(network, tolerance=1e-7, max_iterations=500)
    assert found.converged
    with monkeypatch.context() as patch:
        patch.setattr(Extrapolation, "beyond", lambda *_: None)
        plain = fga.adjust(network, tolerance=1e-7, max_iterations=500)
    assert plain.converged
    assert found.iterations <= 0.6 * plain.iterations
    assert found.vtpv == pytest.approx(plain.vtpv, rel=1e-12)
    sigma = np.sqrt(np.diag(found.covariance("P0")))
    assert np.max(np.abs(found.point("P0") - plain.point("P0")) / sigma) < 1e-5
    assert plain.extrapolated == NO_EXTRAPOLATIONS and not str(plain.extrapolated)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_solution_says_what_extrapolations_gained(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gain is that over the step alone, which is evaluated right before the extrapolation."""
    plain = AdjustmentRun.vtpv
    evaluated: list[float] = []
    taken: list[float] = []

    def vtpv(run: AdjustmentRun, state: State) -> float:
        evaluated.append(plain(run, state))
        return evaluated[-1]

    def progress(iteration: int, after: float, bound: float) -> None:
        """Note an extrapolation: a lower second value of an iteration with a small step."""
        if bound < STOPPING.still and len(evaluated) == 2 and after == evaluated[1]:
            taken.append(evaluated[0] - after)
        evaluated.clear()

    monkeypatch.setattr(AdjustmentRun, "vtpv", vtpv)
    solution = fga.adjust(short_base(seed), progress=progress)
    found = solution.extrapolated
    assert found.count == len(taken) > 0
    assert found.gained == pytest.approx(sum(taken)) and found.gained > 0.0
    assert found.count < solution.iterations
    assert f"  extrapolations        {found}\n" in text_report(solution)
    assert results_record(Report(solution))["extrapolated"]["count"] == found.count


def test_what_was_gained_is_one_sentence() -> None:
    once = NO_EXTRAPOLATIONS.with_one(2.5)
    assert str(once) == "1 extrapolation of steps lowered vᵀPv by 2.5 more than the steps alone"
    twice = once.with_one(-1e-9)
    assert str(twice) == "2 extrapolations of steps lowered vᵀPv by 2.5 more than the steps alone"


def test_a_solution_without_extrapolations_does_not_mention_them() -> None:
    solution = fga.adjust(blundered_distances(1, 1e-3, (0.01,)))
    assert not solution.extrapolated.count
    assert "extrapolation" not in text_report(solution)
    assert "extrapolated" not in results_record(Report(solution))


def test_extrapolations_without_progress_end_after_half_the_patience() -> None:
    """Steps of the same size below 1 σ that leave vᵀPv where it is."""
    stop = StepRecord(1e-5).moved(0.5, 100.0, 100.0, plain=True)
    taken = 0
    while not stop.in_vain:
        stop = stop.moved(0.5, 100.0, 100.0, plain=False)
        taken += 1
    assert taken == STOPPING.patience // 2


OFFSET = 5.0
"""Distance of a point from its base, metres: where it is at the minimum."""


def blundered_distances(seed: int, sigma: float, ratios: Sequence[float]) -> fga.Network:
    """Return points on the bisector of a base of 100 m, each with two distances too long alike.

    y of the point is known beside them from a third, with r chosen so that Gauss-Newton leaves
    ρ = N⁻¹ Σ (v/σ²) ∂²v/∂y² of the way at each step, and so that the minimum stays at y = OFFSET.
    """
    rng = np.random.default_rng(seed)
    network = fga.Network("blundered distances")
    length = np.hypot(50.0, OFFSET)
    slope = OFFSET / length
    weight = 2.0 * slope**2 + 0.01
    for i, ratio in enumerate(ratios):
        x0 = 1000.0 * i
        residual = ratio * weight * length / (2.0 * (1.0 - slope**2))
        network.add_point(f"A{i}", (x0, 0, 0), fixed="xyz")
        network.add_point(f"B{i}", (x0 + 100, 0, 0), fixed="xyz")
        network.add_point(f"C{i}", (x0 + 50, -100, 0), fixed="xyz")
        x = x0 + 50 + rng.normal() * 7.0 * sigma
        y = OFFSET + rng.normal() * 10.0 * sigma / np.sqrt(weight)
        network.add_point(f"P{i}", (x, y, 0), fixed="z")
        third = 100.0 + OFFSET - 200.0 * slope * residual
        network.add(
            HorizontalDistance(f"A{i}", f"P{i}", length + residual, sigma=sigma),
            HorizontalDistance(f"B{i}", f"P{i}", length + residual, sigma=sigma),
            HorizontalDistance(f"C{i}", f"P{i}", third, sigma=10.0 * sigma),
        )
    return network


@pytest.mark.parametrize(
    ("seed", "sigma", "ratios"),
    [
        (18, 1e-3, np.linspace(0.95, 0.87, 9)),
        (2, 2e-5, (0.99, 0.95, 0.8, 0.2, 0.5)),
        (5, 1e-4, (0.97, 0.9, 0.5, 0.1)),
    ],
)
def test_large_residuals_do_not_hide_how_far_the_minimum_is(
    seed: int, sigma: float, ratios: Sequence[float]
) -> None:
    """vᵀPv of 1e7 to 1e10 cannot tell steps of 1e-3 σ, which leave 20 and more of their size."""
    solution = fga.adjust(blundered_distances(seed, sigma, ratios))
    assert solution.converged and solution.vtpv > 1e7
    for i in range(len(ratios)):
        deviation = solution.standard_deviations(f"P{i}")[1]
        assert abs(solution.point(f"P{i}")[1] - OFFSET) < 1e-3 * deviation
