"""Corrections from control and check points, and signals as variables: equal where theory says."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.collocation.collocation import collocate
from factorgraph_adj.collocation.point_corrections import known_residuals, point_corrections
from factorgraph_adj.collocation.signal_variables import with_signals
from tests.benchmarks.collocation import coverage
from tests.networks.deformed_heights import NOISE, SIGNAL, levelled


def test_signal_variables_are_control_with_their_covariance_and_predicted_by_the_formula() -> None:
    """Way 1 of F16: signals as variables. Way 2: Correlated with C + D, and ŝ_p = C_ps C̄⁻¹ w."""
    network, where, _ = levelled(rise_sigma=0.004)
    at_once = fga.adjust(with_signals(network, covariance=None, height=SIGNAL, points=["P1", "P7"]))
    control = [o for o in network.observations.values() if isinstance(o, fga.ControlPoint)]
    numbers = [int(o.point[1:]) for o in control]
    full = SIGNAL.between(where[numbers]) + NOISE**2 * np.eye(len(control))
    ids = [i for i, o in network.observations.items() if isinstance(o, fga.ControlPoint)]
    other = fga.without(network, ids)
    other.add(fga.Correlated(tuple(control), full))
    solution = fga.adjust(other)
    heights = np.array([solution.point(f"P{i}")[2] for i in range(30)])
    again = np.array([at_once.point(f"P{i}")[2] for i in range(30)])
    np.testing.assert_allclose(again, heights, rtol=0, atol=1e-9)
    left = np.array([o.value[0] for o in control]) - heights[numbers]
    to_new = SIGNAL.between(where[[1, 7]], where[numbers]) @ np.linalg.inv(full)
    predicted = heights[[1, 7]] + to_new @ left
    found = np.array([at_once.point(p)[2] for p in ("P1+s", "P7+s")])
    np.testing.assert_allclose(found, predicted, rtol=0, atol=1e-9)
    # Σ(X̂_p + ŝ_p − s_p): C_pp − C_ps C̄⁻¹ C_sp, and F Q Fᵀ with F = δ_p − C_ps C̄⁻¹ A.
    names = [f"P{i}" for i in range(30)]
    q = np.array([[solution.covariance([a], [b])[2, 2] for b in names] for a in names])
    f = np.zeros((2, 30))
    f[[0, 1], [1, 7]] = 1.0
    f[:, numbers] -= to_new
    errors = SIGNAL.between(where[[1, 7]]) - to_new @ SIGNAL.between(where[numbers], where[[1, 7]])
    errors += f @ q @ f.T
    for i, p in enumerate(("P1+s", "P7+s")):
        assert at_once.standard_deviations(p)[2] == pytest.approx(np.sqrt(errors[i, i]), rel=1e-6)


def test_two_steps_are_one_where_control_only_places_the_block() -> None:
    """Residuals of an adjustment, their collocation with a mean, and signals in the graph."""
    network, where, _ = levelled()
    corrected = point_corrections(fga.adjust(network), covariance=None, height=SIGNAL, trend="mean")
    every = list(network.points)
    at_once = fga.adjust(with_signals(network, covariance=None, height=SIGNAL, points=every))
    z = np.array([at_once.point(p + "+s")[2] for p in every])
    sigma = np.array([at_once.standard_deviations(p + "+s")[2] for p in every])
    # The rises have 10 µm each, and up to 29 of them are between a point and control.
    np.testing.assert_allclose(corrected.coordinates[:, 2], z, rtol=0, atol=2e-5)
    np.testing.assert_allclose(corrected.prediction.sigmas[:, 2], sigma, rtol=0, atol=2e-5)
    own = collocate(
        where[::2],
        known_residuals(fga.adjust(network)).values[:, 2],
        covariance=SIGNAL,
        noise=NOISE,
    )
    np.testing.assert_allclose(
        corrected.prediction.values[:, 2], own.predict(where).values[:, 0], rtol=0, atol=1e-9
    )


def test_corrections_come_nearer_to_the_truth_and_their_sigmas_cover() -> None:
    """Twelve blocks of the study `tests/benchmarks/collocation.py`, which runs 200."""
    found = coverage(range(12))
    before = found["not corrected"]
    for way in ("true function", "estimated function", "signals as variables"):
        assert found[way].rms < 0.75 * before.rms
        assert 0.6 < found[way].mean_square < 2.2
        assert found[way].covered > 0.85
    assert before.covered < 0.3


def test_check_points_correct_and_a_block_without_signal_is_left_alone() -> None:
    network = fga.Network("no signal")
    rng = np.random.default_rng(3)
    for i, (x, y, z) in enumerate(rng.uniform(0.0, 500.0, (12, 3))):
        check = (x, y, z + 0.05 + rng.normal(scale=0.01))
        network.add_point(f"P{i}", (x, y, z), fixed="" if i else "xyz", check=check)
        if i:
            vector = np.array(network.points[f"P{i}"].coordinates) - np.array(
                network.points["P0"].coordinates
            )
            network.add(fga.GnssVector("P0", f"P{i}", tuple(vector), sigma=(0.01, 0.01, 0.01)))
    solution = fga.adjust(network)
    with pytest.raises(fga.InputError, match="heights: the values have no signal"):
        point_corrections(
            solution, covariance=None, height="gaussian", trend="mean", use="check", noise=0.01
        )
    stated = point_corrections(
        solution, covariance=None, height=SIGNAL, trend="mean", use="check", noise=0.01
    )
    assert any("no signal" in r for r in stated.remarks)
    mean = np.mean(known_residuals(solution, "check").values[:, 2])
    assert stated.collocation.coefficients[0] == pytest.approx(mean, abs=0.02)
    with pytest.raises(fga.InputError, match="no control has residuals"):
        point_corrections(solution)


def test_corrections_of_a_geocentric_network_are_along_its_horizons() -> None:
    """All check points lie 5 cm above the block: the mean is that, and the frame is geocentric."""
    origin = fga.TopocentricFrame(np.deg2rad(48.0), np.deg2rad(11.0), 500.0)
    network = fga.Network("geocentric", frame=fga.GeocentricFrame())
    rng = np.random.default_rng(8)
    at = origin.to_geocentric(np.column_stack([rng.uniform(-800.0, 800.0, (9, 2)), np.zeros(9)]))
    up = network.frame.basis(at, np.zeros((9, 2))).enu[:, 2]
    for i, x in enumerate(at):
        network.add_point(f"P{i}", x, fixed="" if i else "xyz", check=x + 0.05 * up[i])
        if i:
            network.add(fga.GnssVector("P0", f"P{i}", tuple(x - at[0]), sigma=(0.01, 0.01, 0.01)))
    found = point_corrections(
        fga.adjust(network), covariance=SIGNAL, trend="mean", use="check", noise=0.01
    )
    np.testing.assert_allclose(found.coordinates, at + 0.05 * up, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.prediction.values, [[0.0, 0.0, 0.05]] * 9, atol=1e-6)


def test_what_is_wrong_with_signals_is_said() -> None:
    network, _, _ = levelled()
    with pytest.raises(fga.InputError, match="there is no signal"):
        with_signals(network, covariance=None, height=None)
    with pytest.raises(fga.InputError, match="unknown point 'Q'"):
        with_signals(network, covariance=None, height=SIGNAL, points=["Q"])
    with pytest.raises(fga.InputError, match="no control in x, y"):
        other = network.copy()
        for name, p in other.points.items():
            other.points[name] = fga.Point(name, p.coordinates)
        with_signals(other, covariance=SIGNAL, height=None)


def _known_checks(noise: float, *, seed: int = 5) -> fga.Solution:
    """Return 40 weighted points whose check coordinates have a signal and noise."""
    network = fga.Network("checks")
    rng = np.random.default_rng(seed)
    where = rng.uniform(0.0, 1500.0, (40, 2))
    off = rng.multivariate_normal(np.zeros(40), SIGNAL.between(where), size=2, method="eigh").T
    off += rng.normal(scale=noise, size=off.shape)
    for i, (at, d) in enumerate(zip(where, off, strict=True)):
        check = (*(at + d), np.nan)
        network.add_point(f"P{i}", (*at, 0.0), fixed="z", sigma=(0.01, 0.01, np.inf), check=check)
    return fga.adjust(network)


def test_noise_of_check_points_is_estimated_or_demanded() -> None:
    solution = _known_checks(0.015)
    found = point_corrections(solution, use="check")
    estimate = found.estimates[0]
    assert estimate is not None and found.estimates[1] is None
    own = found.collocation
    assert float(estimate.noise) == pytest.approx(0.015, rel=0.3)
    assert own.sigma0 == pytest.approx(1.0, abs=1e-3) and own.redundancy_numbers.min() > 0.05
    assert found.remarks == () and found.components == ("east", "north")
    with pytest.raises(fga.InputError, match="no σ of check coordinates is known: state the noise"):
        point_corrections(solution, use="check", covariance=SIGNAL)


def test_sigmas_in_a_wrong_unit_are_told_or_refused() -> None:
    solution = _known_checks(0.008)
    stated = fga.CovarianceFunction("gaussian", 1e3 * SIGNAL.sigma, SIGNAL.length)
    for function, noise in ((stated, 0.008), (SIGNAL, 8.0)):
        wrong = point_corrections(solution, use="check", covariance=function, noise=noise)
        assert any("where 1 is expected" in r and "in metres" in r for r in wrong.remarks)
    right = point_corrections(solution, use="check", covariance=SIGNAL, noise=0.008)
    assert right.remarks == ()
    with pytest.raises(fga.InputError, match="plan: the stated noise, 8 m, is far larger than"):
        point_corrections(solution, use="check", noise=8.0)


def test_signals_that_are_too_alike_are_refused_with_a_remedy() -> None:
    rng = np.random.default_rng(1)
    network = fga.Network("control of an area as large as L")
    for i, (x, y) in enumerate(rng.uniform(0.0, 1000.0, (50, 2))):
        network.add_point(f"P{i}", (x, y, 0.0), sigma=(0.01,) * 3)
    smooth = fga.CovarianceFunction("gaussian", 0.02, 1000.0)
    with pytest.raises(fga.InputError, match=r"so alike .* matern52, a shorter length"):
        fga.with_signals(network, covariance=smooth)
    rough = fga.CovarianceFunction("matern52", 0.02, 1000.0)
    assert "P0+s" in fga.with_signals(network, covariance=rough).points
