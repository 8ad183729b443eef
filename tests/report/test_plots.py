"""Figures: what is drawn is what was computed, and every picture can be drawn headless."""

from __future__ import annotations

import io
import itertools
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.errors import SingularError
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import ControlPoint, SlopeDistance
from factorgraph_adj.quality.error_ellipses import error_ellipses, height_intervals
from factorgraph_adj.report.plots import (
    plot_mean_photo,
    plot_network,
    plot_photo_residuals,
    plot_photos,
    plot_qq,
    plot_redundancy,
    plot_w,
    save_plots,
)
from factorgraph_adj.report.plots.image_residuals import image_rows
from factorgraph_adj.report.plots.network_plan import order_along_lines
from factorgraph_adj.report.plots.observation_lines import lines_by_kinds
from factorgraph_adj.report.plots.point_symbols import plan_window
from factorgraph_adj.report.plots.reliability_figures import spread_places
from factorgraph_adj.report.plots.style import exaggeration_text, length_text, readable_number
from factorgraph_adj.simulation.simulated_blocks import (
    simulate_aerial_block,
    simulate_geocentric_block,
)
from factorgraph_adj.solve.solution import Solution
from tests.networks.simulated import NETWORKS, gnss, levelling
from tests.networks.small_block import CHECKED, SIGHTED, small_block
from tests.support.places import ROOT
from tests.support.shifted import shift_image

pytest.importorskip("matplotlib")

from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.offsetbox import AnchoredOffsetbox, TextArea
from matplotlib.quiver import Quiver
from matplotlib.text import Text

LONG = pytest.mark.slow(
    "pictures that are drawn for one question each; short tests draw every figure once"
)

ROUNDING = 1e-9
"""Of figures that are copied or scaled once, relative."""
TILT = 1e-3
"""Relative change of an ellipse between horizons of points that are less than a km apart."""


def one_point() -> fga.Network:
    network = fga.Network("one point")
    network.add_point("A", (10.0, 20.0, 5.0))
    covariance = 1e-6 * np.array([[4.0, 2.0, 0.0], [2.0, 3.0, 0.0], [0.0, 0.0, 9.0]])
    network.add(ControlPoint("A", (10.0, 20.0, 5.0), covariance=covariance))
    return network


def levelling_with_plan() -> fga.Network:
    network = levelling()
    rng = np.random.default_rng(1)
    for name, p in network.points.items():
        x, y = rng.uniform(0, 500, 2).tolist()
        network.points[name] = replace(p, coordinates=(x, y, p.coordinates[2]))
    return network


def with_blunder() -> fga.Network:
    """The small block with an error of 40 σ in x of one image point."""
    network = small_block()
    shift_image(network, "F2/P5", 0.16)
    return network


PICTURES = {
    "combined block": small_block,
    "industry block": lambda: simulate_industry_block(2).network,
    "geocentric block": lambda: simulate_geocentric_block(3).network,
    "levelling": levelling,
    "levelling with plan": levelling_with_plan,
    "gnss": gnss,
    "free images": NETWORKS["images, free"],
    "own cameras": NETWORKS["own cameras"],
    "one point": one_point,
}


@pytest.fixture(scope="module")
def solution() -> Solution:
    return fga.adjust(small_block())


@pytest.fixture(scope="module")
def rel(solution):
    return fga.reliability(solution)


@pytest.fixture(scope="module")
def blunder():
    solution = fga.adjust(with_blunder())
    return solution, fga.reliability(solution)


def texts(figure: Figure) -> str:
    """Everything that is written on a figure."""
    return "\n".join(t.get_text() for t in figure.findobj(Text))


def ellipses(figure: Figure) -> list[EllipseCollection]:
    return figure.findobj(EllipseCollection)


def written(figure: Figure, gid: str) -> list[Text]:
    return [t for t in figure.findobj(Text) if t.get_gid() == gid]


def scale_key(figure: Figure) -> tuple[np.ndarray, str]:
    """Ends of the bar of the scale key, data units, and its label."""
    box = figure.findobj(AnchoredOffsetbox)[0]
    bar = next(line for line in box.findobj(Line2D) if line.get_gid() == "scale key")
    return np.asarray(bar.get_xydata()), box.findobj(TextArea)[0].get_text()


def rendered(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=40)
    return stream.getvalue()


# -- every network ------------------------------------------------------------------------------


DRAWN_QUICKLY = ("one point", "levelling with plan", "combined block")
DRAWN = [
    name
    if name in DRAWN_QUICKLY
    else pytest.param(
        name,
        marks=pytest.mark.slow(
            "networks of other dimensions, frames and sizes, of which a figure may have too few "
            "points, no photos or an axis of no length"
        ),
    )
    for name in PICTURES
]


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@pytest.mark.parametrize("name", DRAWN)
def test_every_figure_of_every_network_can_be_drawn(name):
    solution = fga.adjust(PICTURES[name]())
    rel = fga.reliability(solution)
    figures = [plot_network(solution), plot_w(rel), plot_qq(rel), plot_redundancy(rel)]
    for photo in list(solution.network.photos)[:1]:
        figures.append(plot_photo_residuals(solution, photo, reliability=rel))
        figures.append(plot_mean_photo(solution, solution.network.photos[photo].camera))
    for figure in figures:
        assert isinstance(figure, Figure)
        assert rendered(figure).startswith(b"\x89PNG")
        assert solution.network.name[:16] in texts(figure)


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_no_state_of_pyplot_and_no_setting_of_the_user_is_touched(solution, rel):
    import matplotlib

    with matplotlib.rc_context({"font.size": 31.0, "axes.titlelocation": "right"}):
        before = dict(matplotlib.rcParams)
        figure = plot_network(solution)
        assert dict(matplotlib.rcParams) == before
    assert max(t.get_fontsize() for t in figure.findobj(Text) if t.get_text()) < 12
    code = """
import sys
from factorgraph_adj import adjust, reliability
from tests.networks.small_block import small_block
from factorgraph_adj.report.plots import plot_network, plot_w
assert "matplotlib" not in sys.modules
solution = adjust(small_block())
plot_network(solution), plot_w(reliability(solution))
assert "matplotlib.pyplot" not in sys.modules
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert ran.returncode == 0, ran.stderr


def test_without_matplotlib_the_error_says_what_to_install(solution, rel, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for draw in (
        lambda: plot_network(solution),
        lambda: plot_w(rel),
        lambda: plot_qq(rel),
        lambda: plot_redundancy(rel),
        lambda: plot_photo_residuals(solution, "F1"),
        lambda: plot_photos(solution),
        lambda: plot_mean_photo(solution, "D3"),
        lambda: save_plots(solution, tmp_path / "plots"),
    ):
        with pytest.raises(fga.InputError, match=r'pip install "factorgraph_adj\[plot\]"'):
            draw()
    assert not (tmp_path / "plots").exists()


def test_names_are_written_as_they_are_whatever_signs_they_have():
    network = fga.Network("$x_1$ \\frac 測量")
    network.add_point("$A$", (0, 0, 0), fixed="xyz")
    network.add_point("_B_{", (10, 0, 0), fixed="yz")
    network.add(SlopeDistance("$A$", "_B_{", 10.02, sigma=0.01))
    figure = plot_network(fga.adjust(network))
    assert {"$A$", "_B_{"} <= {t.get_text() for t in written(figure, "name of a point")}
    assert "$x_1$ \\frac 測量" in texts(figure)
    with pytest.warns(UserWarning, match="Glyph"):  # the font of matplotlib has no 測
        rendered(figure)


# -- the network --------------------------------------------------------------------------------


def test_ellipses_are_the_error_ellipses_times_the_factor(solution):
    for confidence, variance in ((0.95, "a-priori"), (0.39, "a-posteriori")):
        found = fga.adjust(solution.network, variance=variance)
        figure = plot_network(found, confidence=confidence, factor=50.0)
        expected = error_ellipses(found, confidence=confidence)
        moving = [e for e in expected if e.semi_axes[0] > 0]
        drawn, of_photos = ellipses(figure)
        assert len(drawn.get_widths()) == len(moving) == 13
        for i, ellipse in enumerate(moving):
            half = [drawn.get_widths()[i] / 2, drawn.get_heights()[i] / 2]
            np.testing.assert_allclose(
                half, 50.0 * np.array(ellipse.semi_axes), rtol=1e-6, atol=1e-9
            )
            azimuth = np.radians(90.0 - drawn.get_angles()[i])
            assert np.sin(azimuth - ellipse.azimuth) == pytest.approx(0.0, abs=1e-6)
            np.testing.assert_allclose(drawn.get_offsets()[i], ellipse.centre[:2], rtol=ROUNDING)
        places = [("pose", name) for name in found.network.photos]
        for i, ellipse in enumerate(error_ellipses(found, places, confidence=confidence)):
            width = 100.0 * ellipse.semi_axes[0]
            assert of_photos.get_widths()[i] == pytest.approx(width, rel=1e-6)
        scale = "σ0 a priori" if variance == "a-priori" else "σ̂0 a posteriori"
        assert f"confidence {100 * confidence:g} %, {scale}" in texts(figure)


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@pytest.mark.parametrize("name", ["combined block", "industry block", "geocentric block", "gnss"])
def test_the_scale_key_is_its_length_times_the_factor(name):
    solution = fga.adjust(PICTURES[name]())
    figure = plot_network(solution)
    (left, right), label = scale_key(figure)
    size, unit, _, sign, factor = label.replace("\u202f", "").replace(",", "").split()
    metres = float(size) * {"µm": 1e-6, "mm": 1e-3, "m": 1.0, "km": 1e3}[unit]
    times = float(factor) if sign == "×" else 1 / float(factor)
    assert right[0] - left[0] == pytest.approx(metres * times, rel=1e-6)
    semi = {e.a: e.semi_axes[0] for e in error_ellipses(solution)}
    largest = max(semi.values())
    assert ellipses(figure)[0].get_widths().max() == pytest.approx(2 * times * largest, rel=TILT)
    assert times == readable_number(times)


@LONG
def test_axes_that_point_elsewhere_give_the_same_plan():
    """X north and Y east, left-handed, and X west, Y south are the network with X east."""
    at = {"A": (0.0, 0.0, 1.0), "B": (100.0, 10.0, 2.0), "C": (40.0, 70.0, 3.0)}
    turned = {
        "en": lambda e, n: (e, n),
        "ne": lambda e, n: (n, e),
        "ws": lambda e, n: (-e, -n),
        "es": lambda e, n: (e, -n),
    }
    pictures = []
    for axes, turn in turned.items():
        network = fga.Network(axes, frame=fga.LocalFrame(axes=axes))
        for name, (e, n, u) in at.items():
            network.add_point(name, (*turn(e, n), u), fixed="z" if name == "C" else "xyz")
        for a, b, change in (("A", "C", 0.001), ("B", "C", -0.002)):
            distance = float(np.linalg.norm(np.subtract(at[a], at[b]))) + change
            network.add(SlopeDistance(a, b, distance, sigma=0.002))
        figure = plot_network(fga.adjust(network))
        drawn = ellipses(figure)[0]
        pictures.append(
            (
                np.concatenate([drawn.get_offsets()[0], drawn.get_widths(), drawn.get_heights()]),
                np.cos(2 * np.radians(drawn.get_angles())),
                figure.axes[0].get_xlabel(),
                figure.axes[0].get_ylabel(),
            )
        )
    first = pictures[0]
    for other in pictures[1:]:
        np.testing.assert_allclose(other[0], first[0], rtol=1e-6)
        np.testing.assert_allclose(other[1], first[1], atol=1e-6)
    assert [p[2:] for p in pictures] == [
        ("X (east) [m]", "Y (north) [m]"),
        ("Y (east) [m]", "X (north) [m]"),
        ("−X (east) [m]", "−Y (north) [m]"),
        ("X (east) [m]", "−Y (north) [m]"),
    ]


@LONG
def test_a_geocentric_network_is_seen_in_its_own_horizon():
    solution = fga.adjust(PICTURES["geocentric block"]())
    figure = plot_network(solution)
    drawn = ellipses(figure)[0]
    expected = error_ellipses(solution)
    np.testing.assert_allclose(
        drawn.get_widths() / drawn.get_widths()[0],
        np.array([e.semi_axes[0] for e in expected]) / expected[0].semi_axes[0],
        rtol=TILT,
    )
    # Distances in the plan are horizontal ones.
    a, b = drawn.get_offsets()[:2]
    up = solution.network.frame.basis(expected[0].centre[None], np.zeros((1, 2))).enu[0, 2]
    d = expected[1].centre - expected[0].centre
    assert np.hypot(*(b - a)) == pytest.approx(np.linalg.norm(d - up * (d @ up)), rel=1e-3)
    assert "horizon at 47." in texts(figure)
    assert "east of the centre [m]" in texts(figure)


def test_seen_from_the_south_heights_are_up(solution):
    figure = plot_network(solution, view="south", factor=100.0)
    drawn = ellipses(figure)[0]
    names = [n for n in solution.network.points if n != "S1"]
    expected = np.array([solution.point(n)[[0, 2]] for n in names])
    np.testing.assert_allclose(drawn.get_offsets(), expected, rtol=ROUNDING)
    values = [np.linalg.eigvalsh(solution.covariance(n)[np.ix_([0, 2], [0, 2])]) for n in names]
    low, high = np.array(values).T
    # χ²(95 %) of 2, and of 1 for S2, whose x is held.
    quantile = np.where(low > 1e-12 * high, 5.991464547107979, 3.841458820694124)
    assert np.sum(quantile < 5) == 1
    expected = np.sqrt(quantile * high)
    np.testing.assert_allclose(drawn.get_widths() / 200.0, expected, rtol=1e-6)
    assert figure.axes[0].get_ylabel() == "Z (up) [m]"


def test_lines_are_drawn_once_and_told_apart_by_all_kinds_on_them(solution):
    groups = dict(lines_by_kinds(solution))
    sighted = groups[("direction", "zenith_angle", "slope_distance")]
    names = solution.equations.unknowns["point"].names
    assert {frozenset(names[i] for i in ends) for ends in sighted.tolist()} == {
        frozenset((s, t)) for s in ("S1", "S2") for t in SIGHTED
    }
    assert len(groups[("height_difference",)]) == 6
    legend = plot_network(solution).legends[0]
    labels = [t.get_text().replace("\n  ", " ") for t in legend.get_texts()]
    assert "direction, zenith angle, slope distance (14)" in labels
    assert "height difference (6)" in labels


@LONG
def test_points_are_marked_as_what_they_are(solution):
    labels = {t.get_text() for t in plot_network(solution).legends[0].get_texts()}
    assert {
        "held point (1)",
        "point held in part (1)",
        "free point (12)",
        "instrument station (2)",
        f"check point ({len(CHECKED)})",
        "photo and what it looks at (4)",
    } <= labels
    network = NETWORKS["combined block, free"]()
    for name in ("P1", "P2", "P5", "P10"):
        network.points[name] = replace(network.points[name], datum=True)
    free = plot_network(fga.adjust(network))
    assert "datum point (4)" in {t.get_text() for t in free.legends[0].get_texts()}
    assert "free network" in texts(free)


def test_photos_look_at_the_object(solution):
    """The outline of a photo opens towards the middle of the block."""
    figure = plot_network(solution)
    outlines = next(c for c in figure.findobj(LineCollection) if c.get_gid() == "photos")
    for photo, outline in zip(solution.network.photos, outlines.get_segments(), strict=True):
        centre = solution.pose(photo).position[:2]
        np.testing.assert_allclose(outline[0], centre, rtol=ROUNDING)
        ahead = outline[[1, 2, 3, 4]].mean(axis=0) - centre
        assert ahead @ -centre > 0.98 * np.linalg.norm(ahead) * np.linalg.norm(centre)


def test_a_network_of_heights_without_plan_shows_heights_and_their_intervals():
    solution = fga.adjust(levelling())
    figure = plot_network(solution, factor=500.0)
    axes = figure.axes[0]
    assert axes.get_ylabel() == "height Z [m]" and "schematic" in axes.get_xlabel()
    bars = next(
        c for c in axes.collections if str(c.get_label()).startswith("interval of a height")
    )
    intervals = [i for i in height_intervals(solution) if i.sigma > 0]
    segments = np.array(bars.get_segments())
    assert len(segments) == len(intervals) == 4
    heights = [solution.point(i.a)[2] for i in intervals]
    np.testing.assert_allclose(segments[:, :, 1].mean(axis=1), heights, rtol=ROUNDING)
    half = 500.0 * np.array([i.half_width for i in intervals])
    np.testing.assert_allclose(np.ptp(segments[:, :, 1], axis=1) / 2, half, rtol=1e-6)
    (low, high), label = scale_key(figure)
    assert label == f"{length_text((high[1] - low[1]) / 500.0)}, exaggerated × 500"
    places = order_along_lines(solution)
    assert sorted(places.tolist()) == list(range(5))


def test_a_network_of_heights_with_plan_coordinates_is_a_plan_with_bars():
    solution = fga.adjust(levelling_with_plan())
    figure = plot_network(solution, factor=1e4)
    assert figure.axes[0].get_xlabel() == "X (east) [m]"
    assert not ellipses(figure)
    bars = next(
        c
        for c in figure.axes[0].collections
        if str(c.get_label()).startswith("interval of a height")
    )
    half = [1e4 * i.half_width for i in height_intervals(solution) if i.sigma > 0]
    np.testing.assert_allclose([np.ptp(s[:, 1]) / 2 for s in bars.get_segments()], half, rtol=1e-6)


@LONG
def test_names_lie_neither_upon_one_another_nor_upon_points():
    solution = fga.adjust(simulate_industry_block(2).network)
    figure = plot_network(solution)
    figure.draw_without_rendering()
    names = written(figure, "name of a point")
    assert len(names) > 60
    boxes = [name.get_tightbbox().extents for name in names]
    height = 3.0  # pixels of a line of text that letters do not use
    for a, b in itertools.combinations(boxes, 2):
        apart = a[2] <= b[0] or b[2] <= a[0] or a[3] - height <= b[1] or b[3] - height <= a[1]
        assert apart
    points = figure.axes[0].transData.transform(solution.state["point"][:, :2])
    for x0, y0, x1, y1 in boxes:
        x, y = points.T
        assert not np.any((x > x0) & (x < x1) & (y > y0 + height) & (y < y1 - height))


def test_a_network_of_thousands_of_points_names_its_control_only():
    block = simulate_aerial_block(3, image_points=5000, points_per_photo=100)
    solution = fga.adjust(block.network)
    assert len(solution.network.points) > 1000
    figure = plot_network(solution)
    control = {o.point for o in solution.network.observations.values() if o.kind == "control"}
    names = {t.get_text() for t in written(figure, "name of a point")}
    assert names and names <= control
    assert len(ellipses(figure)[0].get_widths()) == len(solution.network.points)
    assert not written(plot_network(solution, labels=False), "name of a point")


def test_points_far_away_from_all_others_are_left_outside_and_counted():
    rng = np.random.default_rng(1)
    at = rng.uniform(0, 10, (300, 2))
    low, high, outside = plan_window(at)
    assert outside == 0 and np.all(low < at.min(axis=0)) and np.all(high > at.max(axis=0))
    at[7] = 1e6, -1e6
    low, high, outside = plan_window(at)
    assert outside == 1 and np.all(high - low < 12)


def test_an_iteration_that_stopped_half_way_has_a_plan_without_ellipses(monkeypatch, tmp_path):
    def singular(self: Solution) -> None:
        raise SingularError("singular")

    solution = fga.adjust(small_block(2))
    monkeypatch.setattr(Solution, "point_covariances", property(singular))
    figure = plot_network(solution)
    assert "no ellipses: the normal equations are singular" in texts(figure)
    assert not ellipses(figure)


# -- statistics ---------------------------------------------------------------------------------


def bars(figure: Figure) -> np.ndarray:
    return np.array([p.get_height() for p in figure.axes[0].containers[0]])


def test_the_histogram_counts_every_controlled_observation(rel, blunder):
    for each in (rel, blunder[1]):
        figure = plot_w(each)
        n = int(each.controlled.sum())
        assert bars(figure).sum() == n
        curve = figure.axes[0].lines[0].get_xydata()
        width = figure.axes[0].containers[0][0].get_width()
        assert np.trapezoid(curve[:, 1], curve[:, 0]) == pytest.approx(n * width, rel=1e-5)
        at = {float(line.get_xdata()[0]) for line in figure.axes[0].lines[1:]}
        assert at == {each.critical_w, -each.critical_w}
        beyond = int(np.sum(np.abs(each.w[each.controlled]) > each.critical_w))
        assert f"|w| > 3.29: {beyond}, expected" in texts(figure)
        assert f"{n} controlled observations" in texts(figure)


def test_what_lies_beyond_the_histogram_is_in_its_outer_bars_and_said(blunder):
    _, rel = blunder
    largest = np.nanmax(np.abs(rel.w))
    assert largest > 5
    figure = plot_w(rel)
    assert f"largest |w| {largest:.1f}" in texts(figure)
    last = figure.axes[0].containers[0][-1]
    inner, limit = last.get_x(), last.get_x() + last.get_width()
    beyond = int(np.sum(np.abs(rel.w[rel.controlled]) > limit))
    assert limit >= 5
    assert beyond > 0 and f"{beyond} beyond ±{limit:.2f}" in texts(figure)
    outer = np.sum(np.abs(rel.w[rel.controlled]) >= inner)
    assert bars(figure)[-1] + bars(figure)[0] == outer


def test_points_of_the_qq_plot_are_ordered_values_over_normal_quantiles(rel):
    figure = plot_qq(rel)
    found = np.concatenate(
        [
            line.get_xydata()
            for line in figure.axes[0].lines
            if str(line.get_label()).startswith(("w (", "suspects ("))
        ]
    )
    n = int(rel.controlled.sum())
    np.testing.assert_array_equal(found[:, 1], np.sort(rel.w[rel.controlled]))
    np.testing.assert_allclose(found[:, 0], norm.ppf((np.arange(n) + 0.5) / n), rtol=ROUNDING)
    assert f"{n} controlled observations" in texts(figure)
    assert f"{len(rel.w) - n} not controlled: no w" in texts(figure)


def test_the_largest_suspects_are_named(blunder):
    solution, rel = blunder
    names = [t.get_text() for t in written(plot_qq(rel, most=3), "name of a suspect")]
    suspects = rel.suspects(3, critical=rel.critical_w)
    assert len(names) == len(suspects) == 3
    assert "image F2/P5 x" in names
    assert f"the 3 largest of {int(np.nansum(np.abs(rel.w) > rel.critical_w))} suspects" in texts(
        plot_qq(rel, most=3)
    )
    largest = solution.observations[suspects[0].row]
    assert f"image {largest.id} {largest.component}" == "image F2/P5 x"


@LONG
def test_gross_errors_do_not_flatten_the_others():
    network = small_block()
    _, _, xy, _ = network.images.columns()
    xy[5] += 10.0
    rel = fga.reliability(fga.adjust(network))
    assert np.nanmax(np.abs(rel.w)) > 50
    assert plot_qq(rel).axes[0].get_yscale() == "symlog"
    rendered(plot_qq(rel))


def test_redundancy_numbers_are_shown_by_kind_and_component(rel, solution):
    figure = plot_redundancy(rel)
    axes = figure.axes[0]
    labels = [t.get_text() for t in axes.get_yticklabels()]
    assert {"direction", "zenith angle", "slope distance", "image x", "image y"} <= set(labels)
    strips = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(strips) == len(labels)
    drawn = np.concatenate([s.get_xdata() for s in strips])
    np.testing.assert_allclose(np.sort(drawn), np.sort(rel.redundancy_numbers), rtol=ROUNDING)
    block = next(b for b in solution.equations.blocks if b.kind == "image")
    r = rel.redundancy_numbers[block.rows].reshape(-1, 2)
    for c, label in enumerate(("image x", "image y")):
        np.testing.assert_array_equal(strips[labels.index(label)].get_xdata(), r[:, c])
        assert f"48, mean {r[:, c].mean():.2f}, min {r[:, c].min():.2f}" in texts(figure)
    assert f"Σr = {solution.redundancy:.2f}" in texts(figure)


def test_cameras_are_apart_in_the_redundancy_plot():
    network = small_block()
    network.cameras["other"] = replace(network.cameras["D3"], name="other")
    network.photos["F4"] = replace(network.photos["F4"], camera="other")
    rel = fga.reliability(fga.adjust(network))
    labels = {t.get_text() for t in plot_redundancy(rel).axes[0].get_yticklabels()}
    assert {"image, D3 x", "image, D3 y", "image, other x", "image, other y"} <= labels


def test_a_network_that_nothing_controls_says_so():
    rel = fga.reliability(fga.adjust(one_point()))
    for draw in (plot_w, plot_qq):
        assert "No observation is controlled by others" in texts(draw(rel)).replace("\n", " ")
    figure = plot_redundancy(rel)
    assert "1, mean 0.00, min 0.00; 1 uncontrolled" in texts(figure)


def test_names_are_spread_upwards_and_not_beyond_the_end():
    np.testing.assert_array_equal(
        spread_places(np.array([1.0, 2.0, 9.0]), 3.0, 20.0), [1.0, 4.0, 9.0]
    )
    np.testing.assert_array_equal(
        spread_places(np.array([8.0, 8.0, 9.0]), 3.0, 10.0), [4.0, 7.0, 10.0]
    )
    assert len(spread_places(np.zeros(0), 3.0, 10.0)) == 0


# -- images -------------------------------------------------------------------------------------


def arrows(figure: Figure) -> dict[str, np.ndarray]:
    """Position and vector of every arrow, data units, by label."""
    return {str(q.get_label()): np.column_stack([q.XY, q.U, q.V]) for q in figure.findobj(Quiver)}


def test_vectors_are_the_residuals_of_the_photo_times_the_factor(solution, rel):
    figure = plot_photo_residuals(solution, "F3", reliability=rel, factor=300.0)
    drawn = arrows(figure)["residuals"]
    records = [o for o in solution.observations if o.id.startswith("F3/")]
    xy = np.array([o.observed for o in records]).reshape(-1, 2)
    v = np.array([o.residual for o in records]).reshape(-1, 2)
    np.testing.assert_allclose(drawn[:, :2], xy, rtol=ROUNDING)
    np.testing.assert_allclose(drawn[:, 2:], 300.0 * v, rtol=ROUNDING)
    (left, right), label = scale_key(figure)
    size = float(label.split()[0])
    assert label == f"{size:g} µm (× 300)"
    assert right[0] - left[0] == pytest.approx(300.0 * size * 1e-3, rel=1e-9)
    assert figure.axes[0].get_xlabel() == "x [mm]"
    rms = np.sqrt(np.mean(rel.w[[rel.row(o.id, o.component) for o in records]] ** 2))
    assert f"12 points, RMS w {rms:.2f}, 0 suspects" in texts(figure)


def test_suspects_of_a_photo_are_marked_and_named(blunder):
    solution, rel = blunder
    figure = plot_photo_residuals(solution, "F2", reliability=rel)
    marked = arrows(figure)["suspects"]
    at = solution.network.images.columns()[2]
    w = np.nan_to_num(rel.w)
    ids = solution.observations.ids
    expected = {i for i, x in zip(ids, w, strict=True) if i.startswith("F2/") and abs(x) > 3.2905}
    assert len(marked) == len(expected) and "F2/P5" in expected
    names = {t.get_text() for t in written(figure, "name of a suspect")}
    assert names == {i.removeprefix("F2/") for i in expected}
    assert len(at) == 48
    # Without reliability v/σ takes its place, which is never larger in size.
    plain = plot_photo_residuals(solution, "F2")
    assert "|v/σ| > 3.29" in texts(plain)
    assert len(arrows(plain).get("suspects", [])) <= len(marked)


def test_the_mean_photo_holds_the_means_of_its_cells():
    solution = fga.adjust(simulate_industry_block(2).network)
    rows = image_rows(solution)
    figure = plot_mean_photo(solution, "P31", cells=6, factor=100.0)
    drawn = np.concatenate(list(arrows(figure).values()))
    low, high = solution.network.cameras["P31"].corners()
    side = np.max(high - low) / 6
    counts = 0
    for x, y, u, v in drawn.tolist():
        own = np.all(np.abs(rows.xy - [x, y]) <= side / 2 + 1e-9, axis=1)
        np.testing.assert_allclose([u, v], 100.0 * rows.residual[own].mean(axis=0), rtol=1e-9)
        counts += int(own.sum())
    numbers = [int(t.get_text()) for t in written(figure, "number of points")]
    assert sum(numbers) == len(rows.row) == 400
    unknowns_left_out = sum(n for n in numbers if n < 0.1 * np.mean(numbers))
    assert counts == 400 - unknowns_left_out


def test_a_pattern_that_the_calibration_does_not_describe_shows_in_the_mean_photo():
    def significant(size: float) -> int:
        network = simulate_aerial_block(2, image_points=4000, points_per_photo=100).network
        _, _, xy, sigma = network.images.columns()
        waves = 3 * np.pi * xy / np.max(np.abs(xy), axis=0)
        xy[:, 0] += size * sigma[:, 0] * np.sin(waves[:, 0]) * np.cos(waves[:, 1])
        text = texts(plot_mean_photo(fga.adjust(network), next(iter(network.cameras))))
        return int(text.split(" points; ")[1].split()[0])

    assert significant(0.0) <= 2
    assert significant(2.0) > 10


def test_the_worst_photos_are_on_the_sheet_and_the_title_says_which(solution, rel, blunder):
    every = plot_photos(solution, reliability=rel)
    assert "all 4 photos" in texts(every) and len(every.axes) == 4
    found, its = blunder
    one = plot_photos(found, reliability=its, most=1)
    assert "the 1 of 4 photos with the largest RMS w" in texts(one)
    assert [a.get_title("left").split("\n")[0] for a in one.axes] == ["photo F2"]
    named = plot_photos(found, ["F4", "F1"])
    titles = [a.get_title("left").split("\n")[0] for a in named.axes]
    assert titles == ["photo F4", "photo F1"]
    assert "2 of 4 photos" in texts(named)


@LONG
def test_photos_and_cameras_without_image_points_say_so():
    network = small_block()
    network.add_camera("spare", BrownLens(), {"c": 28.0})
    network.add_photo("G", "spare", position=(0, 0, 9), rotation=np.diag([1.0, -1, -1]))
    network.photos["G"] = replace(network.photos["G"], fixed=(True,) * 6)
    solution = fga.adjust(network)
    assert "Photo G has no image coordinates" in texts(plot_photo_residuals(solution, "G"))
    assert "Camera spare has no image coordinates" in texts(plot_mean_photo(solution, "spare"))
    sheet = plot_photos(solution)
    assert "no image coordinates" in texts(sheet)
    rendered(sheet)
    rendered(plot_network(solution))
    levelled = fga.adjust(levelling())
    assert "No image coordinates take part" in texts(plot_photos(levelled))


# -- errors and files ---------------------------------------------------------------------------


def test_what_cannot_be_drawn_is_an_error_that_says_what_would_be_valid(solution, tmp_path):
    other = fga.reliability(fga.adjust(small_block(2)))
    for draw, message in (
        (lambda: plot_network(solution, view="left"), "valid: above, south, east"),
        (lambda: plot_network(solution, confidence=95), "between 0 and 1"),
        (lambda: plot_network(solution, factor=0.0), "greater than zero"),
        (lambda: plot_photo_residuals(solution, "F9"), "unknown photo 'F9'; known: F1, F2"),
        (lambda: plot_photo_residuals(solution, "F1", factor=-1.0), "greater than zero"),
        (lambda: plot_photos(solution, ["F1", "X"]), "unknown photo 'X'; known: F1, F2"),
        (lambda: plot_mean_photo(solution, "D4"), "unknown camera 'D4'; known: D3"),
        (lambda: plot_mean_photo(solution, "D3", cells=0), "at least 1"),
        (lambda: plot_photos(solution, reliability=other), "another solution"),
        (lambda: save_plots(solution, tmp_path / "a", reliability=other), "another solution"),
        (lambda: save_plots(solution, tmp_path / "a", format="gif"), "valid: png, svg, pdf"),
        (lambda: save_plots(solution, tmp_path / "a", photos=0), "at least 1"),
    ):
        with pytest.raises(fga.InputError, match=message):
            draw()
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(
    "format",
    [
        pytest.param(
            "png",
            marks=pytest.mark.slow(
                "the same figures in pixels; the file of another format shows the order"
            ),
        ),
        "svg",
        pytest.param(
            "pdf",
            marks=pytest.mark.slow(
                "the same figures for print; the file of another format shows the order"
            ),
        ),
    ],
)
def test_all_figures_are_written_the_same_each_time(solution, rel, tmp_path, format):
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[format]
    files = save_plots(solution, tmp_path / "a", reliability=rel, format=format)
    names = ["network", "w", "qq", "redundancy", "photos", "mean_photo"]
    assert files == [tmp_path / "a" / f"{name}.{format}" for name in names]
    again = save_plots(solution, tmp_path / "b", reliability=rel, format=format)
    for first, second in zip(files, again, strict=True):
        assert first.read_bytes().startswith(start)
        assert first.read_bytes() == second.read_bytes()


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_each_of_several_cameras_has_a_mean_photo_and_a_file_of_its_own(tmp_path):
    network = small_block()
    for name in ("a/b", "A b"):
        network.cameras[name] = replace(network.cameras["D3"], name=name)
    for photo, camera in (("F1", "a/b"), ("F2", "a/b"), ("F3", "A b"), ("F4", "A b")):
        network.photos[photo] = replace(network.photos[photo], camera=camera)
    del network.cameras["D3"]
    files = save_plots(fga.adjust(network), tmp_path)
    assert [f.name for f in files[-2:]] == ["mean_photo_1_a_b.png", "mean_photo_2_A_b.png"]


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_if_one_figure_cannot_be_written_all_files_stay_as_they_were(
    solution, rel, tmp_path, monkeypatch
):
    (tmp_path / "network.png").write_bytes(b"old")
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    moved = []

    def fail(source: object, target: object) -> None:
        moved.append(target)
        if len(moved) == 3:
            raise OSError(28, "No space left on device", str(target))
        original(source, target)

    original = os.replace
    monkeypatch.setattr("factorgraph_adj.io.file_transaction.os.replace", fail)
    with pytest.raises(fga.InputError, match="no space left"):
        save_plots(solution, tmp_path, reliability=rel)
    assert {f.name for f in tmp_path.iterdir()} == {"network.png", "mine.txt"}
    assert (tmp_path / "network.png").read_bytes() == b"old"


def test_without_reliability_its_figures_say_why(solution, tmp_path, monkeypatch):
    def weak(solution: Solution) -> None:
        raise fga.AdjustmentError("no reliability: the network is too weak to compute it")

    monkeypatch.setattr("factorgraph_adj.report.plots.figure_files.compute_reliability", weak)
    files = save_plots(solution, tmp_path, format="svg")
    assert [f.stem for f in files][1:4] == ["w", "qq", "redundancy"]
    sizes = [f.stat().st_size for f in files]
    assert max(sizes[1:4]) < min(sizes[0], sizes[4])


# -- numbers that people read -------------------------------------------------------------------


def test_factors_and_lengths_are_readable():
    values = {999.0: 500.0, 1000.0: 1000.0, 0.3: 0.2, 0.049: 0.02, 7e-7: 5e-7, 1e-3: 1e-3}
    for value, expected in values.items():
        assert readable_number(value) == pytest.approx(expected, rel=1e-12)
    assert exaggeration_text(2000.0) == "exaggerated × 2\u202f000"
    assert exaggeration_text(1.0) == "in true size"
    assert exaggeration_text(0.2) == "reduced ÷ 5"
    assert [length_text(x) for x in (2e-9, 5e-6, 2e-3, 0.5, 1.0, 20e3)] == [
        "2 nm",
        "5 µm",
        "2 mm",
        "500 mm",
        "1 m",
        "20 km",
    ]
