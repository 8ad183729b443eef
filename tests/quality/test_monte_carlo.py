"""Does an error of the predicted size get found as often as predicted, and do what was predicted?

The close-range block of 1986 with control, images, distances and levelling: 306 observations,
redundancy 156. Trials in their thousands are linear: residuals are linear functions of the errors
as far as the observation equations are, v = −R e, with a dense R at the true values which shares
no line with the solver. The smallest detectable errors, redundancy numbers, critical values and
effects under test are the library's. Real adjustments, with noise of their own, then show the
same test values and the predicted shifts.

Bounds of counts are two-sided binomial ones at `CONFIDENCE` for the whole family of counts that
a test looks at; seeds are fixed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from examples.published_blocks.el_hakim_1986 import simulate_close_range_1986
from factorgraph_adj.entities import ImageTable
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.reliability import Reliability, reliability
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.simulation.measurement import Truth
from factorgraph_adj.types import Array
from tests.support.differences import whitened_system

CONFIDENCE = 0.999
TRIALS = 1000
FALSE_ALARM_TRIALS = 100_000
REAL = 40
"""Adjustments with noise and an error, and as many without the error."""
ALPHA, POWER = 0.001, 0.80
CURVATURE = 1e-3
"""What is not linear in the observation equations, relative to a shift: points move by up to 1 cm
over distances of 10 m, and noise turns the design matrix by less."""
CURVATURE_OF_W = 0.02
"""The same of a test value: errors up to 13 σ, test values up to 10."""

DISTANCES = (
    ("36", "26"), ("46", "15"), ("46", "75"), ("56", "75"), ("56", "76"), ("41", "31"),
    ("41", "12"), ("41", "72"), ("14", "71"), ("23", "53"), ("53", "62"), ("62", "23"),
)  # fmt: skip
LEVELLED = (
    ("11", "21"), ("21", "31"), ("31", "41"), ("41", "51"), ("51", "61"), ("61", "71"),
    ("71", "72"), ("72", "74"), ("74", "76"), ("76", "44"), ("44", "16"), ("16", "11"),
)  # fmt: skip
SPOILT = (
    # Kind, what, component: every kind, images of points with two to four rays, r 0.10 to 0.76.
    ("image", "1/46", "x"),
    ("image", "2/56", "y"),
    ("image", "3/14", "x"),
    ("image", "1/33", "y"),
    ("slope_distance", "23-53", None),
    ("slope_distance", "46-15", None),
    ("height_difference", "41-51", None),
    ("height_difference", "76-44", None),
    ("control", "11", "z"),
    ("control", "76", "x"),
)


REAL_NETWORKS = pytest.mark.slow(
    "adjusts real networks many times; the trials with linear observations are compared with the "
    "same formulas at once"
)


def simulated(seed: int) -> tuple[Network, Truth]:
    """Return the block with its measurements, and what is true."""
    block = simulate_close_range_1986(seed, distances=DISTANCES, height_differences=LEVELLED)
    return block.network, block.truth


def row_of(rel: Reliability, kind: str, where: str, component: str | None) -> int:
    """Return the row of an observation by what it is."""
    network = rel.solution.network
    if kind == "image":
        return rel.row(where, component)
    for ident, o in network.observations.items():
        points = getattr(o, "point", None) or f"{o.station}-{o.target}"
        if o.kind == kind and points == where:
            return rel.row(ident, component)
    raise KeyError(where)


@cache
def base() -> Reliability:
    return reliability(fga.adjust(simulated(1)[0]), alpha=ALPHA, power=POWER)


@cache
def spoilt() -> list[int]:
    return [row_of(base(), *s) for s in SPOILT]


class Linear(NamedTuple):
    """The block at its true values: v = −residual · errors."""

    residual: Array
    """R = I − A Q AᵀP (n, n)."""
    sigmas: Array


def true_state(network: Network, truth: Truth):
    """Return the true values of the unknowns."""
    at = fga.Network(network.name)
    at.__dict__.update(network.__dict__)
    at.points = {
        name: replace(p, coordinates=tuple(truth.points[name].tolist()))
        for name, p in network.points.items()
    }
    at.photos = dict(truth.photos)
    return compile_network(at).unknowns.start()


@cache
def linear() -> Linear:
    network, truth = simulated(1)
    equations = compile_network(network)
    a, _ = whitened_system(equations, true_state(network, truth))
    free = equations.unknowns.free
    a = a[:, free]
    q, _ = np.linalg.qr(a / np.linalg.norm(a, axis=0))
    residual = np.eye(len(a)) - q @ q.T
    sigmas = equations.sigmas()
    return Linear(residual * sigmas[:, None] / sigmas, sigmas)


class Trial(NamedTuple):
    """A real adjustment with an error and without it, from the same noise."""

    row: int
    """The spoilt observation."""
    error: float
    """Its error, SI or image units."""
    clean: Reliability
    spoilt: Reliability
    noise: Array
    """Errors of all observations but for that one's, (n,)."""


@cache
def trials() -> list[Trial]:
    """Adjust `REAL` blocks with noise of their own; errors in turn, of either sign."""
    out = []
    for k in range(REAL):
        row = spoilt()[k % len(SPOILT)]
        error = float(base().mdb[row]) * (-1) ** (k // len(SPOILT))
        network, truth = simulated(100 + k)
        equations = compile_network(network)
        noise = -equations.residuals(true_state(network, truth), whitened=False)
        clean = reliability(fga.adjust(network))
        out.append(Trial(row, error, clean, with_error(network, row, error), noise))
    return out


def with_error(network: Network, row: int, error: float) -> Reliability:
    """Adjust a network whose observation in a row is wrong by an error."""
    record = base().solution.observations[row]
    wrong = fga.Network(network.name)
    wrong.__dict__.update(network.__dict__)
    if record.kind == "image":
        photo, point, xy, sigma = network.images.copy().columns()
        first = next(
            i for i, p in enumerate(network.image_points()) if f"{p.photo}/{p.point}" == record.id
        )
        moved = xy.copy()
        moved[first, "xy".index(record.component)] += error
        wrong.images = ImageTable()
        wrong.images.append(photo, point, moved, sigma)
    else:
        o = network.observations[record.id]
        value = np.atleast_1d(o.value).astype(float)
        value["xyz".index(record.component) if record.component else 0] += error
        given = tuple(value.tolist()) if record.component else float(value[0])
        wrong.observations = dict(network.observations)
        wrong.observations[record.id] = replace(o, value=given)
    return reliability(fga.adjust(wrong))


def bounds(count: int, probability: float, *, figures: int) -> tuple[float, float]:
    """Return between which counts each of several binomial ones lies."""
    tail = (1 - CONFIDENCE) / 2 / figures
    return stats.binom.ppf(tail, count, probability), stats.binom.isf(tail, count, probability)


def noise(count: int, seed: int) -> Array:
    """Return errors (n, count) in units of the observations."""
    sigmas = linear().sigmas
    return np.random.default_rng(seed).normal(size=(len(sigmas), count)) * sigmas[:, None]


def w_of(errors: Array, rows: list[int]) -> Array:
    """Return w (rows, trials) of errors (n, trials), with the library's redundancy numbers."""
    v = -linear().residual[rows] @ errors
    return v / (linear().sigmas[rows] * np.sqrt(base().redundancy_numbers[rows]))[:, None]


def test_the_block_mixes_images_distances_and_levelling():
    kinds = set(base().solution.observations.kinds)
    assert kinds == {"image", "slope_distance", "height_difference", "control"}
    r = base().redundancy_numbers[spoilt()]
    assert 0.1 < r.min() < 0.2 < 0.7 < r.max() < 0.9


@pytest.mark.parametrize("sign", [1, -1])
def test_errors_of_the_smallest_detectable_size_are_found_in_four_of_five_trials(sign):
    """Bounds for 1000 trials, 20 counts, 99.9 %: 747 to 850."""
    rows = spoilt()
    low, high = bounds(TRIALS, POWER, figures=2 * len(rows))
    for k, row in enumerate(rows):
        errors = noise(TRIALS, seed=1000 + k)
        errors[row] += sign * base().mdb[row]
        found = int(np.sum(np.abs(w_of(errors, [row])) > base().critical_w))
        assert low <= found <= high, f"{SPOILT[k]}: {found} of {TRIALS}"


def test_without_errors_one_of_a_thousand_tests_is_a_false_alarm():
    """Bounds for 100 000 trials of one observation, 10 counts, 99.9 %: 64 to 141."""
    rows = spoilt()
    alarms = np.zeros(len(rows))
    chunk = 5000
    for k in range(FALSE_ALARM_TRIALS // chunk):
        w = w_of(noise(chunk, seed=5000 + k), rows)
        alarms += np.sum(np.abs(w) > base().critical_w, axis=1)
    low, high = bounds(FALSE_ALARM_TRIALS, ALPHA, figures=len(rows))
    assert np.all((low <= alarms) & (alarms <= high)), alarms


def test_the_power_chosen_is_the_power_had():
    """With α0 = 1 % and power 90 % as with the customary 0.1 % and 80 %."""
    other = reliability(base().solution, alpha=0.01, power=0.90)
    rows = spoilt()
    low, high = bounds(TRIALS, 0.90, figures=len(rows))
    for k, row in enumerate(rows):
        errors = noise(TRIALS, seed=2000 + k)
        errors[row] += other.mdb[row]
        found = int(np.sum(np.abs(w_of(errors, [row])) > other.critical_w))
        assert low <= found <= high, f"{SPOILT[k]}: {found} of {TRIALS}"


@REAL_NETWORKS
def test_real_adjustments_have_the_test_values_of_the_linear_trials():
    """All test values of every adjustment, with and without the error."""
    rows = np.flatnonzero(base().redundancy_numbers > 0.05).tolist()
    for trial in trials():
        errors = trial.noise[:, None].copy()
        clean = w_of(errors, rows)[:, 0]
        errors[trial.row] += trial.error
        wrong = w_of(errors, rows)[:, 0]
        np.testing.assert_allclose(trial.clean.w[rows], clean, atol=CURVATURE_OF_W)
        np.testing.assert_allclose(trial.spoilt.w[rows], wrong, atol=CURVATURE_OF_W)


@REAL_NETWORKS
def test_real_adjustments_find_four_of_five_and_give_few_false_alarms():
    """Bounds for 40 adjustments at 99.9 %: 22 to 39 found, at most 2 false alarms."""
    found = sum(abs(t.spoilt.w[t.row]) > base().critical_w for t in trials())
    low, high = bounds(REAL, POWER, figures=2)
    assert low <= found <= high
    alarms = sum(abs(t.clean.w[t.row]) > base().critical_w for t in trials())
    assert alarms <= bounds(REAL, ALPHA, figures=2)[1]


@REAL_NETWORKS
def test_the_estimated_error_is_the_error_and_what_noise_adds():
    """Estimated error − error has the standard deviation 1/√(P Q_vv P)_ii = mdb/δ0."""
    normalised = [
        (t.spoilt.estimated_errors[t.row] - t.error) / (t.spoilt.mdb[t.row] / t.spoilt.delta0)
        for t in trials()
    ]
    low, high = stats.chi2.ppf([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], REAL)
    assert low < np.sum(np.square(normalised)) < high


def shift(trial: Trial) -> dict[tuple[str, str], Array]:
    """Return how far every variable of an adjustment moved by the error."""
    clean, wrong = trial.clean.solution, trial.spoilt.solution
    unknowns = clean.equations.unknowns
    moved = {}
    for kind, number in unknowns.active():
        name = unknowns[kind].names[number]
        a, b = clean.state[kind][number], wrong.state[kind][number]
        if kind == "pose":
            turn = log_rotation((a[:9].reshape(3, 3).T @ b[:9].reshape(3, 3))[None])[0]
            moved[kind, name] = np.concatenate([turn, b[9:] - a[9:]])
        else:
            moved[kind, name] = b - a
    return moved


@REAL_NETWORKS
def test_the_predicted_effect_is_the_observed_shift_of_every_unknown():
    """Compared with δ̄ σ of each component: the most that the error could have done to it."""
    sigmas = {
        (e.kind, e.name): np.sqrt(np.diag(base().solution.variable_covariance((e.kind, e.name))))
        for e in base().effect_on(0)
    }
    for trial in trials():
        observed = shift(trial)
        predicted = base().effect_on(trial.row, error=trial.error)
        assert {(e.kind, e.name) for e in predicted} == set(observed)
        bar = base().delta_bar[trial.row]
        for e in predicted:
            off = np.abs(observed[e.kind, e.name] - e.values) / (bar * sigmas[e.kind, e.name])
            assert off.max() < CURVATURE, f"{SPOILT[spoilt().index(trial.row)]}: {e.name}"


@REAL_NETWORKS
@pytest.mark.parametrize("kind", ["height_difference", "slope_distance", "control", "image"])
def test_an_error_moves_projection_centres_and_far_points_as_predicted(kind):
    """The largest shift of a projection centre, and of a point that was not measured to.

    Predicted by the adjustment with the same noise; what is left is the curvature on the way.
    """
    for trial in trials():
        record = base().solution.observations[trial.row]
        if record.kind != kind:
            continue
        observed = shift(trial)
        effects = trial.clean.effect_on(trial.row, error=trial.error)
        predicted = {(e.kind, e.name): e.values for e in effects}
        for of in ("pose", "point"):
            name = max(
                (n for k, n in predicted if k == of and n not in own_points(record.id)),
                key=lambda n: np.abs(predicted[of, n][-3:]).max(),
            )
            size = np.abs(predicted[of, name][-3:]).max()
            np.testing.assert_allclose(
                observed[of, name][-3:], predicted[of, name][-3:], atol=10 * CURVATURE * size
            )


def own_points(ident: str) -> set[str]:
    """Return the points that an observation touches."""
    o = base().solution.network.observations.get(ident)
    if o is None:
        return {ident.split("/")[1]}
    return {getattr(o, name) for name in ("point", "station", "target") if hasattr(o, name)}


def test_an_error_twice_as_large_has_twice_the_effect_and_is_always_found():
    row = spoilt()[0]
    once, twice = (base().effect_on(row, ("pose", "1"), error=k * base().mdb[row]) for k in (1, 2))
    np.testing.assert_allclose(twice, 2 * np.asarray(once))
    np.testing.assert_allclose(once, base().effect_on(row, ("pose", "1")))
    network, _ = simulated(1)
    assert abs(with_error(network, row, 3 * base().mdb[row]).w[row]) > base().critical_w
