"""What figures mark: doubts, what was rejected, suspects, formats of sensors, names left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import industry_block_plan, simulate_industry_block
from factorgraph_adj.errors import Doubt, InputError
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.planning.plan import plan
from tests.networks.simulated import levelling
from tests.networks.small_block import small_block
from tests.support.shifted import shift_first_distance, shift_image

pytest.importorskip("matplotlib")

from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.quiver import Quiver
from matplotlib.text import Text

from factorgraph_adj.report.plots import (
    plot_growth,
    plot_mean_photo,
    plot_network,
    plot_photo_residuals,
    plot_photos,
    plot_qq,
    plot_redundancy,
    plot_w,
    save_plots,
    set_aside,
)
from factorgraph_adj.report.plots.observation_lines import observation_places, rejected_image_points
from factorgraph_adj.report.plots.photo_figures import sensor_coverage
from factorgraph_adj.report.plots.reliability_figures import histogram_edges

LONG = pytest.mark.slow(
    "pictures that are drawn for one question each; short tests draw every figure once"
)

GROSS = {"F2/P5": 0.16, "F1/P3": -0.2}
"""Gross errors in x of image points, mm: 40 and 50 σ."""


def spoilt() -> fga.Network:
    """Return the small block with two gross errors in images and one in a distance."""
    network = small_block()
    for ident, error in GROSS.items():
        shift_image(network, ident, error)
    shift_first_distance(network, 0.3)
    return network


def with_format(network: fga.Network, **format) -> fga.Network:
    """Return the network with a format of its camera D3."""
    network.cameras["D3"] = replace(network.cameras["D3"], **format)
    return network


@pytest.fixture(scope="module")
def doubtful():
    solution = fga.adjust(spoilt())
    return solution, fga.reliability(solution)


@pytest.fixture(scope="module")
def clean():
    network = spoilt()
    found = fga.snoop(network)
    assert {*GROSS} <= set(found.rejected_ids) and len(found.rejected_ids) == 3
    return found, set_aside(found.solution, found.rejected_ids, network)


def texts(figure: Figure) -> str:
    return "\n".join(t.get_text() for t in figure.findobj(Text))


def marked(figure: Figure, gid: str, kind: type) -> list:
    return [each for each in figure.findobj(kind) if each.get_gid() == gid]


# -- doubts ---------------------------------------------------------------------------------------


def figures_of(solution, rel) -> dict[str, Figure]:
    return {
        "network": plot_network(solution),
        "network by name": plot_network(solution=solution),
        "w": plot_w(rel),
        "qq": plot_qq(rel),
        "redundancy": plot_redundancy(rel=rel),
        "photo": plot_photo_residuals(solution, "F1"),
        "photos": plot_photos(solution, reliability=rel),
        "mean photo": plot_mean_photo(solution, "D3"),
        "growth": plot_growth(["a"], {"P": np.ones(1)}, solution=solution),
    }


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
def test_every_figure_says_in_its_title_that_its_result_is_doubtful(doubtful, clean):
    for name, figure in figures_of(*doubtful).items():
        assert "DOUBTFUL RESULT: global test failed" in figure.get_suptitle(), name
        assert figure.get_suptitle().count("DOUBTFUL") == 1
    for name, figure in figures_of(clean[0].solution, clean[0].reliability).items():
        assert "DOUBTFUL" not in figure.get_suptitle(), name


@LONG
def test_figures_say_what_faces_do_not_agree_and_the_most_probable_cause(
    clean, tmp_path, monkeypatch
):
    network = clean[0].solution.network.copy()
    network.doubts.append(Doubt("its two faces give index 9 mgon", "target 'T'"))
    solution = fga.adjust(network)
    title = plot_network(solution).get_suptitle().replace("\n", " ")
    assert title.startswith("DOUBTFUL RESULT: 1 doubt about the two faces of targets, the first: ")
    drawn = []
    monkeypatch.setattr(
        "factorgraph_adj.report.plots.figure_files._bytes",
        lambda figure, format: drawn.append(figure) or b"",
    )
    save_plots(solution, tmp_path, cause="most probable cause: it")
    titles = [figure.get_suptitle() for figure in drawn]
    assert len(titles) > 4 and all(t.endswith("\nmost probable cause: it") for t in titles)


@LONG
def test_arrows_and_counts_lie_within_the_picture():
    network = simulate_industry_block(seed=2).network
    network.cameras["P31"] = replace(network.cameras["P31"], format=None)
    solution = fga.adjust(network)
    figures = [plot_photo_residuals(solution, name) for name in network.photos]
    for figure in (*figures, plot_photos(solution), plot_mean_photo(solution, "P31", cells=3)):
        figure.draw_without_rendering()
        for axes in figure.axes:
            low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
            for arrows in axes.findobj(Quiver):
                tips = arrows.get_offsets() + np.column_stack([arrows.U, arrows.V])
                assert np.all((tips > low) & (tips < high))
            for count in marked(axes, "number of points", Text):
                box = count.get_window_extent()
                assert axes.get_window_extent().y0 <= box.y0


@LONG
def test_figures_that_know_the_test_values_count_those_above_the_critical_value(doubtful):
    solution, rel = doubtful
    n = int(np.nansum(np.abs(rel.w) > rel.critical_w))
    for figure in (plot_w(rel), plot_network(solution, reliability=rel)):
        title = figure.get_suptitle().replace("\n", " ")
        assert f"{n} test values above the critical |w| 3.29" in title


@LONG
def test_a_title_of_doubts_does_not_run_into_the_legend(doubtful):
    for figure in (plot_network(doubtful[0]), plot_qq(doubtful[1]), plot_w(doubtful[1])):
        figure.draw_without_rendering()
        title = next(t for t in figure.texts if "DOUBTFUL" in t.get_text())
        (legend,) = figure.legends
        assert title.get_window_extent().x1 <= legend.get_window_extent().x0


def test_figures_instead_of_missing_test_values_are_doubtful_too(doubtful, tmp_path, monkeypatch):
    def weak(solution):
        raise fga.AdjustmentError("too weak")

    monkeypatch.setattr("factorgraph_adj.report.plots.figure_files.compute_reliability", weak)
    drawn = {}
    monkeypatch.setattr(
        "factorgraph_adj.report.plots.figure_files._bytes",
        lambda figure, format: drawn.setdefault(len(drawn), figure) and b"",
    )
    save_plots(doubtful[0], tmp_path)
    assert len(drawn) > 4
    assert all("DOUBTFUL RESULT" in figure.get_suptitle() for figure in drawn.values())


def test_ellipses_of_a_doubtful_result_are_dashed_and_the_legend_says_so(doubtful, clean):
    for solution, dashed in ((doubtful[0], True), (clean[0].solution, False)):
        figure = plot_network(solution)
        found = figure.findobj(EllipseCollection)
        assert found
        assert all((e.get_linestyles()[0][1] is not None) == dashed for e in found)
        text = texts(figure).replace("\n  ", " ")
        assert ("error ellipse of a point, of a doubtful result" in text) == dashed


def test_intervals_of_a_doubtful_network_of_heights_are_dashed_too():
    network = levelling()
    ident = next(iter(network.observations))
    o = network.observations[ident]
    network.observations[ident] = o.with_reading([o.value + 0.2], network.frame)
    figure = plot_network(fga.adjust(network))
    text = texts(figure).replace("\n  ", " ")
    assert "interval of a height (±), of a doubtful result" in text
    assert "DOUBTFUL RESULT" in figure.get_suptitle()


def test_a_design_is_not_doubtful_since_its_readings_are_computed():
    figure = plot_network(plan(industry_block_plan()).solution)
    assert "DOUBTFUL" not in texts(figure)
    assert "computed readings" in texts(figure)


# -- rejected ------------------------------------------------------------------------------------


def test_the_plan_crosses_the_lines_of_what_was_set_aside_and_counts_them(clean):
    found, aside = clean
    figure = plot_network(found.solution, aside=aside)
    assert "rejected (3)" in texts(figure)
    (lines,) = marked(figure, "rejected", LineCollection)
    ends = {frozenset(map(tuple, np.round(s, 6).tolist())) for s in lines.get_segments()}
    state, unknowns = found.solution.state, found.solution.equations.unknowns
    distance = next(i for i in found.rejected_ids if i not in GROSS)
    a, b = aside.find(distance, "").names
    expected = {frozenset(tuple(np.round(point(found, n)[:2], 6)) for n in (a, b))}
    for ray in GROSS:
        photo, name = ray.split("/")
        centre = state["pose"][unknowns["pose"].number[photo], 9:11]
        both = (np.round(centre, 6), np.round(point(found, name)[:2], 6))
        expected.add(frozenset(tuple(map(float, at)) for at in both))
    assert ends == expected
    assert "rejected" not in texts(plot_network(found.solution))


def point(found, name: str) -> np.ndarray:
    table = found.solution.equations.unknowns["point"]
    return found.solution.state["point"][table.number[name]]


def test_what_has_no_place_in_the_plan_is_counted_in_its_legend(clean):
    found, aside = clean
    equations = aside.rows.equations
    drawn = {"point": found.solution.state["point"][:, :2].copy()}
    table = found.solution.equations.unknowns["point"]
    drawn["point"][table.number["P5"]] = np.nan
    drawn["pose"] = found.solution.state["pose"][:, 9:11]
    places = observation_places(equations, aside.numbers, found.solution, drawn)
    assert (len(places.lines), places.lost) == (2, 1)


def test_suspects_are_marked_in_the_plan_if_test_values_are_given(doubtful):
    solution, rel = doubtful
    rows = np.flatnonzero(np.abs(np.nan_to_num(rel.w)) > rel.critical_w)
    n = len(np.unique(solution.equations.observation_of_row[rows]))
    assert f"|w| > 3.29 ({n})" in texts(plot_network(solution, reliability=rel))
    other = fga.reliability(fga.adjust(small_block()))
    with pytest.raises(InputError, match="belongs to another solution"):
        plot_network(solution, reliability=other)


def test_photos_cross_image_points_that_were_set_aside(clean):
    found, aside = clean
    images = rejected_image_points(aside)
    assert {f"{f}/{p}" for f, own in images.items() for p in own.points} == {*GROSS}
    row = aside.rows.equations.find(["F2/P5"])[0]
    v = aside.innovation[np.isin(aside.numbers, row)]
    np.testing.assert_array_equal(images["F2"].innovation, v[None])
    # Computed − observed of an error of +0.16 mm.
    assert v[0] == pytest.approx(-0.16, abs=0.03)
    figure = plot_photo_residuals(found.solution, "F2", aside=aside)
    (vector,) = marked(figure, "rejected", LineCollection)[0].get_segments()
    np.testing.assert_allclose(vector[0], images["F2"].xy[0])
    assert "1 rejected" in texts(figure) and "rejected, as predicted (1)" in texts(figure)
    named = [
        t.get_text() for t in figure.findobj(Text) if t.get_gid() == "name of a point rejected"
    ]
    assert named == ["P5"]
    assert "rejected, as predicted (2)" in texts(plot_photos(found.solution, aside=aside))


def test_the_histogram_puts_what_was_set_aside_upon_its_bars(clean):
    found, aside = clean
    figure = plot_w(found.reliability, aside=aside)
    used, upon = figure.axes[0].containers
    assert sum(bar.get_height() for bar in upon) == np.sum(np.isfinite(aside.w))
    top = {round(bar.get_x(), 9): bar.get_height() for bar in used}
    assert all(bar.get_y() == top[round(bar.get_x(), 9)] for bar in upon)
    assert "rejected, as predicted (3)" in texts(figure)
    assert "3 rejected: not shown" in texts(plot_qq(found.reliability, aside=aside))


@pytest.mark.parametrize("n", [1, 10, 150, 10_000, 10**7])
@pytest.mark.parametrize("critical", [1.96, 3.29, 4.5])
def test_the_critical_values_are_edges_of_bars(n, critical):
    edges = histogram_edges(n, critical)
    assert critical in edges and -critical in edges
    np.testing.assert_allclose(np.diff(edges), edges[1] - edges[0])
    assert edges[-1] >= max(5.0, critical + 1.0) - 1e-12
    assert len(edges) <= 2 * 61 + 1


def test_bars_beyond_the_critical_values_have_suspects_only_and_their_own_colour(doubtful):
    rel = doubtful[1]
    figure = plot_w(rel)
    bars = figure.axes[0].containers[0]
    colours = {bar.get_facecolor() for bar in bars if abs(bar.get_x() + 1e-9) < rel.critical_w}
    beyond = [bar for bar in bars if bar.get_facecolor() not in colours]
    n = int(np.nansum(np.abs(rel.w) > rel.critical_w))
    assert sum(bar.get_height() for bar in beyond) == n
    assert f"suspects ({n})" in texts(figure)


def test_suspects_of_the_qq_plot_are_named_with_their_ids(doubtful):
    solution, rel = doubtful
    figure = plot_qq(rel, most=30)
    names = {t.get_text() for t in figure.findobj(Text) if t.get_gid() == "name of a suspect"}
    suspects = rel.suspects(30, critical=rel.critical_w)
    ids = solution.observations.ids
    distances = {ids[s.row] for s in suspects if "slope_distance" in s.label}
    assert distances
    assert all(any(n.startswith(f"{i}: slope distance ") for n in names) for i in distances)


# -- formats --------------------------------------------------------------------------------------


def test_coverage_is_the_share_of_the_hull_and_counts_points_outside():
    corners = np.array([0.0, 0.0]), np.array([4.0, 2.0])
    square = np.array([[1.0, 0.5], [2.0, 0.5], [2.0, 1.5], [1.0, 1.5], [1.5, 1.0]])
    assert sensor_coverage(square, corners).share == pytest.approx(1 / 8)
    assert sensor_coverage(square + 5.0, corners).outside == 5
    assert sensor_coverage(square + 5.0, corners).share == 0.0
    line = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 1.0]])
    assert sensor_coverage(line, corners).share == 0.0
    assert sensor_coverage(np.concatenate([square, [[9.0, 9.0]]]), corners).share == pytest.approx(
        1 / 8
    )
    whole = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    assert "100 % of the format" in str(sensor_coverage(whole, corners))


def test_photos_show_the_format_of_the_sensor_and_how_much_of_it_is_covered():
    solution = fga.adjust(simulate_industry_block(2).network)
    name = next(iter(solution.network.photos))
    for figure in (
        plot_photo_residuals(solution, name),
        plot_photos(solution, [name]),
        plot_mean_photo(solution, "P31"),
    ):
        (edge,) = marked(figure, "format", Rectangle)
        assert (*edge.get_xy(), edge.get_width(), edge.get_height()) == (-60, -45, 120, 90)
        assert len(marked(figure, "hull", Polygon)) == 1
        assert "% of the format" in texts(figure)
        (axes,) = figure.axes
        assert axes.get_xlim()[0] < -60 and axes.get_ylim()[1] > 45


def test_without_a_format_the_figures_say_that_the_frame_is_the_area_of_the_points():
    figure = plot_photo_residuals(fga.adjust(small_block()), "F1")
    assert "the camera states no format" in texts(figure)
    assert not marked(figure, "format", Rectangle)


@LONG
def test_points_outside_the_format_are_told():
    """A format with the origin at the wrong place, as pixels have it."""
    network = with_format(small_block(), format=(36.0, 24.0), origin="upper left")
    figure = plot_photos(fga.adjust(network))
    assert "points OUTSIDE it" in texts(figure)
    network = with_format(small_block(), format=(360.0, 240.0), origin="centre")
    assert "points OUTSIDE it" not in texts(plot_photos(fga.adjust(network)))


# -- names ----------------------------------------------------------------------------------------


def test_photos_are_named_in_the_plan():
    solution = fga.adjust(simulate_industry_block(2).network)
    figure = plot_network(solution)
    names = {t.get_text() for t in figure.findobj(Text) if t.get_gid() == "name of a photo"}
    assert names == set(solution.network.photos)


@LONG
def test_the_legend_counts_the_names_that_found_no_room():
    network = small_block()
    solution = fga.adjust(network)
    for figure, everything in (
        (plot_network(solution), len(network.points) + len(network.photos)),
        (plot_network(fga.adjust(crowded())), 40 + 2),
    ):
        found = [t for t in figure.findobj(Text) if str(t.get_gid()).startswith("name of a p")]
        left = everything - len(found)
        text = texts(figure)
        assert f"{left} name{'s' * (left != 1)} left out for want of room" in text or not left
        assert ("left out" in text) == (left > 0)
    assert left > 10
    assert "left out" not in texts(plot_network(fga.adjust(crowded()), labels=False))


def crowded() -> fga.Network:
    """Return 40 points in a metre, between two known ones a kilometre apart."""
    network = fga.Network("crowded")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (1000.0, 0.0, 0.0), fixed="xyz")
    for i in range(40):
        at = np.array([500.0 + 0.1 * i, 400.0 + 0.1 * (i % 3), 0.0])
        network.add_point(f"P{i}", at, fixed="z")
        for known, x in (("A", 0.0), ("B", 1000.0)):
            reach = float(np.hypot(at[0] - x, at[1]))
            network.add(SlopeDistance(known, f"P{i}", reach, sigma=0.01))
    return network
