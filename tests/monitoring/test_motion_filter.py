"""The motion filter against a dense batch adjustment of all its epochs."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.motion_filter import (
    ALPHA_OF_MODEL,
    DAY_S,
    Motion,
    MotionModel,
    smoothed,
)

TIMES = np.array([0.3, 0.5, 1.7, 1.9, 4.0, 6.5]) * DAY_S
START = -0.4 * DAY_S


def wiener(kind, noise, t):
    """Return the covariance of s at times since the start, and with the final velocity (n, n)."""
    first, last = np.minimum.outer(t, t), np.maximum.outer(t, t)
    if kind == "random walk":
        return (1e-3 * noise) ** 2 / DAY_S * first
    density = (1e-3 * noise / DAY_S) ** 2 / DAY_S
    return density * (first**2 * last / 2 - first**3 / 6)


def batch(model, b, r, y):
    """Return the mean and covariance of s, v, b at the last time, from all epochs at once."""
    t, n, k = TIMES - START, len(TIMES), b.shape[0]
    start = (1e-3 * model.start_velocity / DAY_S) ** 2 if model.kind == "velocity" else 0.0
    noise = model.noise if model.kind != "static" else 0.0
    of_s = start * np.outer(t, t) + (wiener(model.kind, noise, t) if noise else 0.0)
    density = (1e-3 * noise / DAY_S) ** 2 / DAY_S if model.kind == "velocity" else 0.0
    of_v = np.full(1, start + density * t[-1])
    v_with_s = start * t + density * (t**2 / 2)
    eye = np.eye(k)
    cov_y = np.kron(of_s, eye) + np.kron(np.ones((n, n)), b)
    for i in range(n):
        cov_y[i * k : (i + 1) * k, i * k : (i + 1) * k] += r[i]
    cross = np.vstack([np.kron(of_s[-1], eye), np.kron(v_with_s, eye), np.tile(b, (1, n))])
    prior = np.zeros((3 * k, 3 * k))
    prior[:k, :k] = of_s[-1, -1] * eye
    prior[k : 2 * k, k : 2 * k] = of_v[0] * eye
    prior[:k, k : 2 * k] = prior[k : 2 * k, :k] = v_with_s[-1] * eye
    prior[2 * k :, 2 * k :] = b
    gain = np.linalg.solve(cov_y, cross.T).T
    # What a point that keeps its place makes of the estimates: errors of epochs and reference.
    of_errors = np.kron(np.ones((n, n)), b)
    for i in range(n):
        of_errors[i * k : (i + 1) * k, i * k : (i + 1) * k] += r[i]
    b_with_y = np.zeros_like(cross)
    b_with_y[2 * k :] = cross[2 * k :]
    static = gain @ of_errors @ gain.T - gain @ b_with_y.T - b_with_y @ gain.T
    static[2 * k :, 2 * k :] += b
    return gain @ y.ravel(), prior - gain @ cross.T, static


MODELS = {
    "line": MotionModel(),
    "velocity with noise": MotionModel(noise=0.4, start_velocity=3.0),
    "random walk": MotionModel("random walk", noise=0.8),
    "static": MotionModel("static"),
}


def problem(model, seed=1):
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((len(TIMES) + 1, 3, 3)) * 1e-3
    q = half @ half.transpose(0, 2, 1) + 1e-7 * np.eye(3)
    b, r = q[0], q[1:]
    y = 2e-3 * rng.standard_normal((len(TIMES), 3))
    states = [Motion.at(START, b, model)]
    for t, d, c in zip(TIMES, y, r, strict=True):
        states.append(states[-1].updated(t, d, c))
    return b, r, y, states


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_filter_is_the_batch_adjustment(model):
    b, r, y, states = problem(model)
    mean, covariance, static = batch(model, b, r, y)
    scale = np.repeat([1e-3, 1e-3 / DAY_S, 1e-3], 3)
    last = states[-1]
    np.testing.assert_allclose(last.mean / scale, mean / scale, atol=1e-7)
    both = np.outer(scale, scale)
    np.testing.assert_allclose(last.covariance / both, covariance / both, atol=1e-6)
    np.testing.assert_allclose(last.static_covariance / both, static / both, atol=1e-6)


def test_a_line_through_all_epochs():
    """Without noise and with a free velocity: weighted least squares of v, with y₀ = 0."""
    b, r, y, states = problem(MotionModel(start_velocity=1e4))
    t = np.append(0.0, TIMES - START)
    a = np.kron(np.stack([np.ones(len(t)), t], axis=1), np.eye(3))
    weight = np.zeros((3 * len(t), 3 * len(t)))
    for i, q in enumerate((b, *r)):
        weight[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = np.linalg.inv(q)
    cov = np.linalg.inv(a.T @ weight @ a)
    x = cov @ a.T @ weight @ np.append(np.zeros(3), y.ravel())
    last = states[-1]
    # Relative to the σ of an epoch, 1 mm; σ of the free velocity is 10 m a day.
    assert last.velocity * DAY_S == pytest.approx(x[3:] * DAY_S, abs=1e-8)
    per_day = DAY_S**2
    for found in (last.velocity_covariance, last.static_velocity_covariance):
        np.testing.assert_allclose(found * per_day, cov[3:, 3:] * per_day, rtol=1e-4, atol=1e-13)
    assert last.velocity_test() == pytest.approx(
        x[3:] @ np.linalg.solve(cov[3:, 3:], x[3:]), rel=1e-4
    )


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_smoothed_states_end_where_the_filter_does_and_scatter_less(model):
    states = problem(model)[3][1:]
    found = smoothed(states)
    assert found[-1][0] == pytest.approx(states[-1].mean)
    for (_, p), state in zip(found, states, strict=True):
        assert (np.diag(p) <= np.diag(state.covariance) * (1 + 1e-9)).all()
    # The error of the reference is one number: all epochs say the same of it in the end.
    for mean, _ in found:
        assert mean[6:] == pytest.approx(found[-1][0][6:], abs=1e-9)


def test_innovations_have_their_size():
    rng = np.random.default_rng(5)
    model, r = MotionModel(noise=0.3), 1e-6 * np.eye(3)
    p, fits, sums = [], [], []
    for _ in range(400):
        # The truth follows the model: its own noise, the error of the reference, a velocity.
        s, v = np.zeros(3), 1e-3 * model.start_velocity / DAY_S * rng.standard_normal(3)
        b, state = 0.5e-3 * rng.standard_normal(3), Motion.at(0.0, 0.25e-6 * np.eye(3), model)
        for i in range(1, 6):
            _, q = model.noise_of(DAY_S)
            e = np.linalg.cholesky(q[:2, :2]) @ rng.standard_normal((2, 3))
            s, v = s + DAY_S * v + e[0], v + e[1]
            y = s + b + 1e-3 * rng.standard_normal(3)
            state = state.updated(i * DAY_S, y, r)
            p.append(state.innovation_test)
        fits.append(state.fits)
        sums.append(state.model_test / state.n_innovations)
    # The mean of N values of χ²/15 has σ √(2/15/N).
    assert np.mean(sums) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 15 / len(sums)))
    assert np.mean(fits) > 1.0 - ALPHA_OF_MODEL - 4 * np.sqrt(ALPHA_OF_MODEL / len(fits))
    assert np.mean(p) == pytest.approx(0.5, abs=4 / np.sqrt(12 * len(p)))
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=4 * np.sqrt(0.0475 / len(p)))


def test_a_jump_is_no_velocity():
    """A point that sank once by 8 mm has a velocity in the filter, which says that it is none."""
    rng = np.random.default_rng(8)
    for jump, creep in ((0.0, 0.0), (0.0, 2e-3), (-8e-3, 0.0)):
        state = Motion.at(0.0, 1e-8 * np.eye(3), MotionModel())
        found = []
        for i in range(1, 60):
            y = (jump * (i > 6) + creep * i) * np.array([0.0, 0.0, 1.0])
            state = state.updated(i * DAY_S, y + 1e-4 * rng.standard_normal(3), 1e-8 * np.eye(3))
            found.append(state.fits)
        assert state.n_innovations == 3 * 59
        assert found[:6] == [True] * 6
        assert found[6:] == [not jump] * 53
        assert Motion.from_json(state.to_json(), state.model).fits == (not jump)


def test_wrong_motions_are_refused():
    with pytest.raises(InputError, match="unknown motion 'circle'"):
        MotionModel("circle")
    with pytest.raises(InputError, match="process noise"):
        MotionModel(noise=-1.0)
    state = Motion.at(10.0, np.eye(3), MotionModel())
    with pytest.raises(InputError, match="go on in time"):
        state.updated(9.0, np.zeros(3), np.eye(3))


def test_a_velocity_since_the_reference_is_answered_at_first_in_part():
    """The prior holds the first estimates at 0: without errors they are the response times v."""
    model, v = MotionModel(start_velocity=2.0), np.array([3e-8, -1e-8])
    sigma, state = 1e-6 * np.array([[4.0, 1.0], [1.0, 2.0]]), None
    state = Motion.at(0.0, sigma, model)
    for i in range(1, 200):
        time = 3600.0 * i
        state = state.updated(time, v * time, sigma)
        response = state.response[2:4]
        assert state.velocity == pytest.approx(response @ v, rel=1e-6)
        if i == 1:
            # T = yᵀ (B + R)⁻¹ y: the velocity that it sees is that of the first displacement.
            assert np.abs(response).max() < 0.01
            seen = 2.0 * sigma / time**2
            assert state.steady_velocity_covariance == pytest.approx(seen, rel=1e-6)
    assert response == pytest.approx(np.eye(2), abs=0.02)
