"""The conclusions of the papers of 1981 and 1986, on our simulation.

Figures beside printed ones: the scripts ``examples/table_*.py``. Neither paper prints coordinates;
what a test asks is the tendency, and the size with the margin that it states. Tables 1 to 5 of
1986 in detail: `test_tables_1986`; table 2 of 1981:
`tests/examples/test_industry_block.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from examples.papers import tables_1981, tables_1986
from examples.papers.comparison import Comparison, compared
from examples.papers.systematic_errors_1986 import TABLE_6, Layout, effect, layout, spec_of
from examples.papers.tables_1981 import ISP_CASES, isp_inside, isp_trial
from examples.papers.tables_1986 import AERIAL, CLOSE_RANGE, aerial, close_range
from factorgraph_adj.errors import InputError
from factorgraph_adj.experiment.runs import Experiment, run
from factorgraph_adj.experiment.summary import Summary

LONG = pytest.mark.slow("every row of the tables; short tests take the first of them")

REPETITIONS = 3
LAYOUTS = ("layout 1", "layout 2", "layout 3")
CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))
THIRDS = ((-1 / 3, -1), (1 / 3, -1), (1 / 3, 1), (-1 / 3, 1))
OTHER_LAYOUTS = {
    "corners and thirds of the long sides": (*CORNERS, *THIRDS),
    "pairs near the corners": (*CORNERS, *((2 * x, y) for x, y in THIRDS)),
    "the short sides": (*CORNERS, *((x, y / 2) for x, y in CORNERS)),
    "thirds and middles": (*THIRDS, (0, -1), (0, 1), (-1, 0), (1, 0)),
}
"""Where the 8 horizontal control points might be instead, in half sides of the block."""


ISP = pytest.mark.slow(
    "adjusts the ISP block in all cases of the paper; layouts and check points have short tests"
)


@pytest.fixture(scope="module")
def isp() -> Summary:
    experiment = Experiment("ISP block", isp_trial, {"case": ISP_CASES}, seed=1981)
    return run(experiment, REPETITIONS).summary()


# -- 1981: terrestrial observations replace control ----------------------------------------------


@ISP
@pytest.mark.parametrize("case", LAYOUTS)
def test_terrestrial_observations_replace_control_of_the_isp_block(isp: Summary, case: str) -> None:
    """With four control points left, errors come down to less than 2.2 times those of full control.

    Reduced control alone has 3 times these errors in X and Y, 60 times in Z. What the adjustment
    itself says of the precision falls by the same.
    """
    for prefix in ("", "sigma_"):
        for axis, gain in (("x", 1.8), ("y", 1.5), ("z", 20.0)):
            figure = prefix + axis
            full, reduced, with_terrestrial = (
                isp.of(figure, case=c).rms for c in ("full", "reduced", case)
            )
            assert with_terrestrial < 2.2 * full
            assert with_terrestrial < reduced / gain


@ISP
def test_the_gain_depends_on_number_and_distribution(isp: Summary) -> None:
    """The paper's other finding. All lines of the edge give what control of all its points does.

    Half of them give less everywhere; a cross through the middle holds heights better and X
    worse than half of the edge does.
    """
    sigma = {c: np.array([isp.of(f"sigma_{a}", case=c).rms for a in "xyz"]) for c in ISP_CASES}
    np.testing.assert_allclose(sigma["layout 1"], sigma["full"], rtol=0.05)
    assert np.all(sigma["layout 2"] > 1.3 * sigma["layout 1"])
    assert sigma["layout 3"][2] < 0.85 * sigma["layout 2"][2]
    assert sigma["layout 3"][0] > 1.1 * sigma["layout 2"][0]


def test_the_check_points_are_the_same_47_in_every_case() -> None:
    inside = isp_inside()
    assert len(inside) == 47
    for case in ISP_CASES:
        plan = tables_1981.design(tables_1981.isp_spec(case))
        assert not any(any(plan.points[name].fixed) for name in inside)
        assert sum(all(p.fixed) for p in plan.points.values()) == (30 if case == "full" else 4)


# -- 1986: gross errors --------------------------------------------------------------------------


@pytest.mark.parametrize("name", "EFG")
def test_two_or_more_distances_lift_a_two_ray_point_to_07_to_09(name: str) -> None:
    """Printed 0.00 → 0.71, 0.90, 0.77; ours 0.73, 0.83, 0.76; margin 0.02 at either end."""
    case = CLOSE_RANGE[name]
    assert case.r(close_range()) < 0.02
    assert 0.68 < case.r(close_range(case.lines)) < 0.92


def test_distances_lift_every_weak_point_and_one_alone_does_not() -> None:
    """Table 2: after two distances or more r is 0.5 to 0.9; ours 0.47 to 0.83."""
    for name, case in (AERIAL | CLOSE_RANGE).items():
        in_air = name in AERIAL
        rel = aerial(distances=True) if in_air else close_range(case.lines)
        assert case.r(rel) < 0.2 if name == "D" else 0.45 < case.r(rel) < 0.92


def test_nine_tenths_of_an_image_error_go_along_the_distance_and_heights_take_the_rest_in_z() -> (
    None
):
    """Conclusion of 1986: 90 % in X with distances in X, 10 to 35 % in Y; Z with heights.

    Case A, error in x. Ours: 97 % in X, 43 % in Y; 99 % in Z with height differences. An error in y
    (case B) is left in Y but for 5 %, and leaves Z with height differences too.
    """
    stages = (aerial(), aerial(distances=True), aerial(True, True))
    photos, distances, heights = (np.abs(AERIAL["A"].effect(rel)) for rel in stages)
    removed = 1 - distances / photos
    assert removed[0] > 0.9
    assert 0.1 < removed[1] < 0.5
    assert removed[2] < 0.5
    assert 1 - heights[2] / photos[2] > 0.95
    photos, distances, heights = (np.abs(AERIAL["B"].effect(rel)) for rel in stages)
    assert distances[1] > 0.85 * photos[1]
    assert 1 - heights[2] / photos[2] > 0.95


# -- 1986: systematic errors ---------------------------------------------------------------------


@LONG
@pytest.mark.parametrize("number", TABLE_6)
def test_sizes_are_those_of_table_6(number: int) -> None:
    """Residuals within 0.4 µm, horizontal errors within 8 mm, Z of radial distortion within 14 mm.

    Z of the affine deformation is printed as 2 to 4 mm; ours is 8 to 20 mm: it depends on its
    make-up (see the module), of which nothing is printed but 15 µm.
    """
    printed, found = np.array(TABLE_6[number].printed), effect(number)
    assert np.all(np.abs(found.residuals - printed[:2]) < 0.41)
    assert np.all(np.abs(found.rms - printed[2:])[:2] < 8.0)
    margin = 14.0 if TABLE_6[number].error == "radial" else 18.0
    assert abs(found.rms[2] - printed[4]) < margin


def test_distances_do_not_show_systematic_errors_in_the_residuals() -> None:
    """Radial: 2.0 and 2.8 µm in every test, ours 1.8 and 2.4; affine: below 1 µm."""
    for number, test in TABLE_6.items():
        v = effect(number).residuals
        if test.error == "radial":
            np.testing.assert_allclose(v, effect(1).residuals, atol=0.1)
        else:
            assert np.all(v < 1.0)


def test_the_effect_of_radial_distortion_in_x_falls_with_32_distances() -> None:
    """Printed 24 → 8 mm, by 3; ours 20.6 → 10.4, by 2.0 over all points.

    It falls by 4 at the points that distances in X reach (printed, table 7: 16, 16, 13 → 1, 1,
    0). The factor over all points is a matter of where the 8 control points are, which cannot be
    read: 1.4 to 2.6 in the layouts of the next test; neither another curve, nor σ 0.5 mm, nor a
    polygon through all control points makes it 3. Y and Z hardly change, as printed.
    """
    alone, with_distances = effect(2), effect(3)
    ratio = alone.rms / with_distances.rms
    assert 1.8 < ratio[0] < 3.2
    assert np.all((ratio > 0.95) & (ratio < 1.5), where=[False, True, True])
    there = layout()
    assert alone.of(there.along_x)[0] > 3.0 * with_distances.of(there.along_x)[0]
    assert alone.of(there.along_y)[1] > 1.5 * with_distances.of(there.along_y)[1]


def test_distances_replace_horizontal_control() -> None:
    """Eight control points and 32 distances against 20: printed 8 9 against 9 9 mm.

    Ours: 10.4 15.4 against 8.1 14.7 mm, 20.6 16.7 without distances. Additional control does not
    improve the combined adjustment much: by 3 mm in X at most, printed 2.
    """
    twenty, eight, combined, both = (effect(n).rms[:2] for n in (1, 2, 3, 4))
    assert np.all(combined < 1.35 * twenty)
    assert combined[0] < 0.6 * eight[0]
    assert np.all(combined - both < 3.5)


def test_gaps_in_the_polygon_do_no_harm_and_60_distances_little_good() -> None:
    """28 distances as good as 32 in all coordinates; printed 8 9 63 and 8 9 62 mm."""
    np.testing.assert_allclose(effect(6).rms, effect(3).rms, atol=1.0)
    np.testing.assert_allclose(effect(5).rms, effect(3).rms, atol=2.5)
    assert effect(7).rms[0] > effect(6).rms[0]


def test_heights_remove_z_where_they_are_measured() -> None:
    """Table 7: 73 to 116 mm → 2 to 5 mm. Over all points 62 → 41 mm printed, ours hardly less.

    Ours has its 14 vertical control points in the corners, on the sides and in the middle; the
    error in Z inside the block, 50 mm, is not that of its edge.
    """
    there = layout()
    on_edge = there.along_x + there.along_y
    assert effect(3).of(on_edge)[2] > 20.0
    assert effect(8).of(on_edge)[2] < 5.0
    assert effect(8).rms[2] < effect(3).rms[2]


def test_the_effect_of_affine_deformation_is_not_removed() -> None:
    """Printed 12 21 → 14 19 mm, as the error is across the distances; ours 12 22 → 8 21.

    In plan by 10 % (printed 2 %), against 30 % of radial distortion (printed 56 %). Most of it is
    across the edge, where distances along it do nothing. X, which is printed to rise by 2 mm, falls
    by 4 in ours, by less of its size than with radial distortion.
    """
    before, after = effect(10), effect(11)
    assert np.linalg.norm(after.rms[:2]) > 0.85 * np.linalg.norm(before.rms[:2])
    assert np.linalg.norm(effect(3).rms[:2]) < 0.75 * np.linalg.norm(effect(2).rms[:2])
    assert before.rms[0] / after.rms[0] < 0.8 * effect(2).rms[0] / effect(3).rms[0]
    assert after.rms[1] > 0.9 * before.rms[1]
    across = layout().along_x
    assert before.of(across)[1] > 2 * before.of(across)[0]
    assert after.of(across)[1] > 0.9 * before.of(across)[1]


@LONG
@pytest.mark.parametrize("name", OTHER_LAYOUTS)
def test_where_the_8_control_points_are_decides_how_much_distances_help(name: str) -> None:
    """The factors in X of radial and affine in other layouts of the control.

    Radial always improves, by 1.4 to 2.6; affine by 1.1, less than radial, with pairs near the
    corners (16.9 22.0 → 15.4 20.2 mm: as printed), but by 1.5 to 3.7 where control is weak along
    the strips or in the corners: there the second conclusion of the paper would not hold.
    """
    where = layout(OTHER_LAYOUTS[name])
    assert len(set(where.horizontal[8])) == 8
    radial, affine = (
        effect(a, where=where).rms[0] / effect(b, where=where).rms[0] for a, b in ((2, 3), (10, 11))
    )
    assert 1.3 < radial < 3.0
    if name == "pairs near the corners":
        assert affine < 1.2 < 1.5 < radial
    else:
        assert affine > 1.3


def test_the_layout_is_what_the_tests_of_table_6_say() -> None:
    there: Layout = layout()
    assert [len(there.horizontal[n]) for n in (20, 8)] == [20, 8]
    assert [len(there.vertical[n]) for n in (34, 14)] == [34, 14]
    assert set(there.horizontal[8]) <= set(there.vertical[14]) <= set(there.vertical[34])
    assert len(there.polygon) == 32
    for count in (24, 28, 32, 60):
        assert len(set(there.lines(count))) == count
    made = tables_1981.design(spec_of(TABLE_6[8]))
    kinds = [o.kind for o in made.observations.values()]
    assert kinds.count("slope_distance") == kinds.count("height_difference") == 32


# -- printed beside ours -------------------------------------------------------------------------


def test_a_comparison_shows_printed_figures_before_ours_and_says_where_there_are_none() -> None:
    rows = (compared("a", (1.0, 2.0), (1.25, -0.001)), compared("b", (float("nan"), 3.0), (4, 5)))
    text = str(Comparison("a table", ("X", "Y"), rows, note="chosen"))
    lines = [line.split() for line in text.splitlines()]
    assert ["X", "ours", "Y", "ours"] in lines
    assert ["a", "1.00", "1.25", "2.00", "0.00"] in lines
    assert ["b", "–", "4.00", "3.00", "5.00"] in lines
    assert lines[-1] == ["chosen"]
    alone = str(Comparison("a table", ("X",), (compared("a", None, [1.0]),)))
    assert "ours" not in alone


def test_a_comparison_refuses_a_row_of_another_length() -> None:
    with pytest.raises(InputError, match="row 'a' of 'a table' has 2 printed and 1 own"):
        Comparison("a table", ("X",), (compared("a", (1.0, 2.0), (1.0,)),))


def test_a_comparison_is_drawn_with_a_bar_for_each_figure() -> None:
    pytest.importorskip("matplotlib")
    from examples.papers.comparison_plot import plot_comparison

    averages = tables_1986.TABLE_1["aerial"]
    rows = tuple(compared(f"{n}", row, row) for n, row in averages.items())
    figure = plot_comparison([Comparison("table 1", ("a", "b", "c", "d"), rows)])
    bars = [patch for axes in figure.subfigs[0].axes for patch in axes.patches]
    assert len(bars) == 2 * 4 * len(averages)
    widths = sorted(bar.get_width() for bar in bars)
    assert widths == sorted(2 * [f for row in averages.values() for f in row])
