"""The plan of displacements draws what the comparison found."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.report.epochs_report import EpochsReport
from factorgraph_adj.report.plots import plot_displacements
from factorgraph_adj.report.plots.displacements import EpochsDrawing
from tests.networks import moved

pytest.importorskip("matplotlib")

from matplotlib.collections import EllipseCollection, PathCollection
from matplotlib.quiver import Quiver


def parts(figure, kind):
    return [c for c in figure.axes[0].collections if isinstance(c, kind)]


def test_vectors_and_ellipses_have_one_factor():
    found = moved.in_plan()
    figure = plot_displacements(found, factor=1500.0, blocks=[moved.block()])
    arrows, rings = parts(figure, Quiver), parts(figure, EllipseCollection)
    groups = [[x for x in found.displacements.values() if x.moved is m] for m in (False, True)]
    ellipses = {e.a: e for e in found.ellipses()}
    for arrow, ring, own in zip(arrows, rings, groups, strict=True):
        vectors = np.array([x.vector[:2] for x in own])
        assert np.stack([arrow.U, arrow.V], axis=1) == pytest.approx(1500 * vectors, rel=1e-9)
        places = np.array([x.place[:2] for x in own])
        assert pytest.approx(places, rel=1e-12) == arrow.XY
        assert ring.get_offsets() == pytest.approx(places + 1500 * vectors, rel=1e-9)
        major = [ellipses[x.name].semi_axes[0] for x in own]
        assert 2 * ring._widths == pytest.approx(2 * 1500 * np.array(major), rel=1e-9)
        assert ring._angles == pytest.approx(
            [np.pi / 2 - ellipses[x.name].azimuth for x in own], rel=1e-9
        )


def test_the_legend_counts_each_kind():
    figure = plot_displacements(moved.in_plan(), blocks=[moved.block()])
    said = [" ".join(t.get_text().split()) for t in figure.legends[0].get_texts()]
    for expected in (
        "block and its common motion (1)",
        "displacement, not significant, with its ellipse (4)",
        "significant displacement, with its ellipse (3)",
        "stable reference point (4)",
        "reference point that is not stable (1)",
        "point that moved (2)",
    ):
        assert expected in said
    assert "3 of 7 points moved; ellipses 95 %" in figure.axes[0].get_title(loc="left")


def test_second_places_of_one_adjustment_are_no_further_points():
    figure = plot_displacements(moved.joint())
    said = [" ".join(t.get_text().split()) for t in figure.legends[0].get_texts()]
    assert "point that is not compared (4)" in said  # A, C, D, E carry the datum
    assert "point that moved (3)" in said


def test_the_factor_makes_displacements_visible_and_stands_on_the_key():
    plan = EpochsDrawing(EpochsReport(moved.in_plan()))
    reach = plan.factor * np.quantile(plan.sizes, 0.9)
    assert 0.04 < reach / plan.extent <= 0.121
    assert plan.fits.all()
    low, high = plan.reach
    ends = plan.at + plan.factor * plan.vectors
    assert (ends >= low).all() and (ends <= high).all()


def test_a_block_is_drawn_where_its_motion_takes_it():
    plan = EpochsDrawing(EpochsReport(moved.in_plan(), (moved.block(),)))
    ((at, shift),) = plan.outlines
    b, mean = moved.block(), moved.block().centre[:2]
    turn = np.array([[0, -b["rz"]], [b["rz"], 0]])
    expected = np.array([b["tx"], b["ty"]]) + (at - mean) @ turn.T
    assert shift == pytest.approx(expected, abs=1e-12)
    assert at[0].tolist() == at[-1].tolist()


def test_heights_stand_in_a_diagram():
    for found in (moved.heights(), moved.in_space()):
        figure = plot_displacements(found)
        _, below = figure.axes
        assert below.get_ylabel() == "rise [mm]"
        lines = [line for line in below.lines if line.get_marker() == "o"]
        shown = dict(np.concatenate([line.get_xydata() for line in lines]).tolist())
        rises = [1000 * x.vector[2] for x in found.displacements.values()]
        assert [shown[i] for i in range(len(rises))] == pytest.approx(rises, rel=1e-9)
    arrows = parts(plot_displacements(moved.heights(), factor=100.0), Quiver)
    up = np.concatenate([a.V for a in arrows])
    assert np.sort(up) == pytest.approx(
        np.sort([100 * x.vector[2] for x in moved.heights().displacements.values()]), rel=1e-9
    )


def test_heights_without_a_plan_are_drawn_one_beside_the_other():
    figure = plot_displacements(moved.heights(plan=False))
    (axes,) = figure.axes
    marks = np.concatenate([np.asarray(c.get_offsets()) for c in parts(figure, PathCollection)])
    x = [1000 * v.vector[2] for v in moved.heights(plan=False).displacements.values()]
    assert marks[np.argsort(marks[:, 0]), 1] == pytest.approx(x, rel=1e-9)
    assert [t.get_text() for t in axes.get_xticklabels()] == list("ABCDEPQ")


def test_a_doubtful_comparison_says_so():
    figure = plot_displacements(moved.doubtful())
    assert "DOUBTFUL RESULT: the variances of the epochs do not agree" in figure.get_suptitle()
    assert "DOUBTFUL" not in plot_displacements(moved.kept()).get_suptitle()


def test_a_geocentric_comparison_is_drawn_in_its_horizon():
    figure = plot_displacements(moved.in_space(geocentric=True))
    assert "horizon at" in figure.get_supxlabel()
    plan = EpochsDrawing(EpochsReport(moved.in_space(geocentric=True)))
    x = moved.in_space(geocentric=True).displacement("P")
    assert np.hypot(
        np.linalg.norm(plan.vectors[plan.report.names.index("P")]),
        plan.rises[plan.report.names.index("P")],
    ) == pytest.approx(x.length, rel=1e-9)


def test_a_huge_displacement_is_named_and_not_drawn():
    found = fga.congruence(
        *(fga.adjust(s.network) for s in moved.in_plan().solutions), objects=["P", "Q"]
    )
    figure = plot_displacements(found, factor=1e6)
    assert "too large to be drawn" in figure.get_supxlabel()


def test_wrong_options_are_refused():
    with pytest.raises(InputError, match="between 0 and 1"):
        plot_displacements(moved.kept(), confidence=95)
    with pytest.raises(InputError, match="factor must be"):
        plot_displacements(moved.kept(), factor=0.0)
