"""Standard deviations against arrivals: what is drawn is what was given."""

from __future__ import annotations

import io

import numpy as np
import pytest

from factorgraph_adj.errors import InputError

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from factorgraph_adj.report.plots import plot_growth

ARRIVALS = ["levelling", "station A", "photo 1", "photo 2"]
SIGMAS = {
    "P1": np.array([np.nan, 2e-3, 1e-3, 0.8e-3]),
    "P2": np.array([np.nan, np.inf, 3e-3, 0.81e-3]),
}


def rendered(figure: Figure) -> bytes:
    """Draw a figure, which shows whatever is wrong with it."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=60)
    return stream.getvalue()


def curve(figure: Figure, name: str) -> np.ndarray:
    """Return σ of the steps of a curve, (n arrivals,)."""
    line = next(li for li in figure.axes[0].get_lines() if li.get_label() == name)
    assert np.array_equal(np.asarray(line.get_xdata()), np.arange(len(ARRIVALS) + 1) + 0.5)
    return np.asarray(line.get_ydata(), dtype=float)


def test_every_curve_has_the_standard_deviations_from_where_its_point_is_determined() -> None:
    figure = plot_growth(ARRIVALS, SIGMAS)
    for name, sigma in SIGMAS.items():
        shown = curve(figure, name)
        known = np.isfinite(sigma)
        assert np.array_equal(np.isnan(shown[:-1]), ~known)
        assert np.array_equal(shown[:-1][known], sigma[known])
        assert shown[-1] == sigma[-1]
    assert figure.axes[0].get_yscale() == "log"
    assert rendered(figure)


def test_arrivals_gross_errors_and_last_standard_deviations_are_written() -> None:
    figure = plot_growth(ARRIVALS, SIGMAS, caught={2: "direction A P1"})
    axes = figure.axes[0]
    assert [t.get_text() for t in axes.get_xticklabels()] == ARRIVALS
    texts = {t.get_text(): t for t in axes.texts}
    assert set(texts) == {"1", "P1  800 µm", "P2  810 µm"}
    assert texts["1"].xy[0] == 3  # under the third arrival
    assert axes.get_xlabel() == "gross errors caught: 1 direction A P1"
    assert rendered(figure)


def test_names_at_the_ends_of_curves_that_meet_are_apart() -> None:
    sigmas = {f"P{i}": np.array([1e-3, 5e-4 * (1 + 1e-6 * i)]) for i in range(6)}
    sigmas["far"] = np.array([1e-2, 1e-2])
    axes = plot_growth(["a", "b"], sigmas).axes[0]
    heights = sorted(t.get_position()[1] for t in axes.texts)
    assert np.diff(heights).min() > 0.04


def test_very_many_arrivals_are_not_all_named() -> None:
    n = 1000
    names = [f"photo {i}" for i in range(n)]
    figure = plot_growth(names, {"P": np.geomspace(1.0, 1e-3, n)})
    assert len(figure.axes[0].get_xticklabels()) <= 40
    assert rendered(figure)


def test_points_that_are_never_determined_are_left_out() -> None:
    figure = plot_growth(ARRIVALS, SIGMAS | {"P9": np.full(4, np.nan)})
    assert "P9" not in {line.get_label() for line in figure.axes[0].get_lines()}
    nothing = plot_growth(ARRIVALS, {"P9": np.full(4, np.inf)})
    assert "No point is determined" in nothing.axes[0].texts[0].get_text()


def test_all_that_does_not_fit_the_arrivals_is_named_at_once() -> None:
    with pytest.raises(InputError) as error:
        plot_growth(ARRIVALS, {"P1": np.ones(3)}, caught={7: "what"})
    assert "'P1'" in str(error.value)
    assert "arrival 7" in str(error.value)
