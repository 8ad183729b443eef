"""Accuracy at check points: published figures, formulas by hand, and random errors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.accuracy.positional_accuracy import check_points_needed, circular_95


def heights(n, mean, s):
    """Return n height differences with a mean and a standard deviation of n − 1."""
    z = np.random.default_rng(n).normal(size=n)
    z = mean + s * (z - z.mean()) / z.std(ddof=1)
    return np.column_stack([np.full((n, 2), np.nan), z])


@pytest.mark.parametrize(
    ("n", "mean", "s", "rmse", "accuracy"),
    [
        # USGS, LA_Barataria_2013, VA.txt: fundamental vertical accuracy and forested points.
        (51, -0.00533333349535, 0.0577205913534, 0.0574002119585, 0.112504415439),
        (6, 0.0448333347837, 0.0714154522031, 0.0791212, 1.96 * 0.0791212),
    ],
)
def test_figures_of_a_published_report_agree(n, mean, s, rmse, accuracy):
    """Mean and s of n − 1 determine RMSE of n: which denominator each has is thereby tested."""
    found = fga.positional_accuracy(heights(n, mean, s))
    assert found.counts == (0, 0, n)
    assert found.rmse[2] == pytest.approx(rmse, abs=2e-8)
    assert found.nssda[1] == pytest.approx(accuracy, abs=4e-8)
    assert math.isnan(found.rmse_horizontal)


def test_survey_error_of_the_check_points_counts_in_quadrature():
    """ASPRS edition 2, 7.11: RMSE_H² = RMSE_H1² + RMSE_H2² and so on, by hand."""
    d = np.array([[0.03, 0.0, 0.06], [-0.03, 0.04, -0.06], [0.03, -0.04, 0.06], [0.03, 0.0, 0.06]])
    found = fga.positional_accuracy(d, survey=(0.02, 0.04), names="abcd")
    fit = math.sqrt(0.03**2 + 0.04**2 / 2)
    assert found.rmse_fit == pytest.approx((fit, 0.06))
    assert found.rmse_horizontal == pytest.approx(math.hypot(fit, 0.02))
    assert found.rmse_vertical == pytest.approx(math.hypot(0.06, 0.04))
    assert found.rmse_3d == pytest.approx(math.sqrt(fit**2 + 0.02**2 + 0.06**2 + 0.04**2))
    one = fga.positional_accuracy(d, survey=0.02)
    assert one.survey == pytest.approx((0.02 * math.sqrt(2), 0.02))
    assert found.names == ("a", "b", "c", "d")


def test_skewness_and_kurtosis_are_those_of_scipy():
    d = np.random.default_rng(5).gamma(2.0, size=(17, 3))
    found = fga.positional_accuracy(d)
    assert found.skewness == pytest.approx(stats.skew(d, axis=0, bias=False))
    assert found.kurtosis == pytest.approx(stats.kurtosis(d, axis=0, bias=False))


def test_percentile_is_interpolated_by_rank():
    """ASPRS: rank P/100 (N − 1) + 1 of the ordered |d|: of 1 to 21 at 95 %: rank 20."""
    d = np.full((21, 3), np.nan)
    d[:, 2] = (-1.0) ** np.arange(21) * np.arange(1, 22)
    assert fga.positional_accuracy(d).percentile_95 == pytest.approx(20.0)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.3, 0.59])
def test_the_radius_of_unequal_axes_holds_95_percent(ratio):
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 400_000)) * [[0.02], [0.02 * ratio]]
    inside = np.mean(np.hypot(x, y) <= circular_95(0.02, 0.02 * ratio))
    assert inside == pytest.approx(0.95, abs=0.0015)


def test_the_circular_formula_of_nssda():
    """Equal axes: 1.7308 RMSE_r, as the standard prints it."""
    assert circular_95(0.1, 0.1) == pytest.approx(1.7308 * math.hypot(0.1, 0.1), rel=1e-4)
    assert circular_95(0.1, 0.07) == pytest.approx(2.4477 * 0.085)
    assert circular_95(0.0, 0.0) == 0.0


def test_number_of_check_points_by_area():
    """ASPRS edition 2, table C.1."""
    expected = {None: 30, 500: 30, 1000: 30, 1001: 40, 2000: 40, 5500: 80, 10_000: 120, 5e4: 120}
    assert {area: check_points_needed(area) for area in expected} == expected


def test_remarks_name_what_is_missing():
    few = fga.positional_accuracy(heights(25, 0.0, 0.01))
    assert few.remarks() == (
        "25 check points are fewer than the 30 of ASPRS edition 2",
        "the survey error of the check points is not stated: it counts as 0",
    )
    poor = fga.positional_accuracy(heights(40, 0.0, 0.01), survey=(0.0, 0.02))
    assert poor.remarks(2500.0)[0] == "40 check points are fewer than the 50 of ASPRS edition 2"
    assert "more than half of the vertical RMSE" in poor.remarks()[-1]


def test_check_points_of_an_adjustment():
    network = fga.Network("a")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("P", (1, 2, 3), check=(1.01, 2.02, 2.99))
    network.add(fga.ControlPoint("P", (1.0, 2.0, 3.0), sigma=(0.01, 0.01, 0.01)))
    found = fga.positional_accuracy(fga.adjust(network))
    assert found.differences == pytest.approx(np.array([[-0.01, -0.02, 0.01]]))
    said = found.statement()
    assert "Tested with 1 check points" in said
    assert "RMSE_H 0.0224 m, RMSE_V 0.0100 m" in said


def one_point(frame: fga.GeocentricFrame, at, known) -> fga.Solution:
    """Return a network of one observed point with known coordinates."""
    network = fga.Network("one point", frame=frame)
    network.add_point("P", tuple(at), check=tuple(known))
    network.add(fga.ControlPoint("P", tuple(at), sigma=(0.01, 0.01, 0.01)))
    return fga.adjust(network)


@pytest.mark.parametrize("kind", ["geocentric", "topocentric", "local ne"])
def test_horizontal_and_vertical_are_those_at_the_point(kind):
    """A product 3 cm east, 4 cm north, 12 cm above the truth, in frames with other axes."""
    enu = np.array([0.03, 0.04, 0.12])
    phi, lam = math.radians(-33.0), math.radians(151.0)
    sp, cp, sl, cl = math.sin(phi), math.cos(phi), math.sin(lam), math.cos(lam)
    rows = np.array([[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
    globe = fga.GeocentricFrame("GRS80")
    at = globe.ellipsoid.to_cartesian(np.array([phi]), np.array([lam]), np.array([90.0]))[0]
    if kind == "geocentric":
        frame, there, difference = globe, at, rows.T @ enu
    elif kind == "topocentric":  # 1.5° away: a vertical leans, and the height has a share in y
        frame = fga.TopocentricFrame(phi - math.radians(1.5), lam, 0.0, "GRS80")
        there = frame.from_geocentric(at[None])[0]
        difference = frame.from_geocentric((at + rows.T @ enu)[None])[0] - there
        assert abs(difference[1] - 0.04) > 0.003
    else:
        frame, there = fga.LocalFrame(axes="ne"), np.array([5.0, 6.0, 7.0])
        difference = enu[[1, 0, 2]]
    solution = one_point(frame, there, there - difference)
    found = fga.positional_accuracy(solution)
    assert found.differences[0] == pytest.approx(enu, abs=1e-8)
    assert found.rmse_horizontal == pytest.approx(0.05, abs=1e-8)
    assert found.rmse_vertical == pytest.approx(0.12, abs=1e-8)
    assert fga.check_points(solution).differences[0] == pytest.approx(difference, abs=1e-8)


def test_a_known_place_in_plan_has_no_vertical_accuracy():
    """Its unknown height has a share of 1e-4 in north at 600 m, which is left out."""
    frame = fga.TopocentricFrame(0.8, 0.2, 400.0, "WGS84")
    solution = one_point(frame, (100.0, 600.0, 5.0), (100.02, 600.0, math.nan))
    found = fga.positional_accuracy(solution)
    assert found.counts == (1, 1, 0)
    assert found.rmse_horizontal == pytest.approx(0.02, rel=1e-6)
    geocentric = one_point(fga.GeocentricFrame("WGS84"), (4e6, 1e6, 4.8e6), (4e6, 1e6, math.nan))
    assert fga.positional_accuracy(geocentric).counts == (1, 0, 0)  # east is across Z


@pytest.mark.parametrize(
    ("given", "options", "match"),
    [
        (np.zeros((3, 2)), {}, r"differences must be \(n, 3\), not \(3, 2\)"),
        (np.full((3, 3), np.nan), {}, "no coordinate of a check point is known"),
        (np.array([[1.0, math.inf, 0.0]]), {}, "a difference is infinite"),
        (np.zeros((3, 3)), {"survey": -1.0}, "survey must be σ ≥ 0"),
        (np.zeros((3, 3)), {"survey": (1.0, 2.0, 3.0)}, "survey must be σ ≥ 0"),
    ],
)
def test_what_is_no_difference_is_refused(given, options, match):
    with pytest.raises(fga.InputError, match=match):
        fga.positional_accuracy(given, **options)
