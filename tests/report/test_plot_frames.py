"""What plans show of frames: instruments with their sights, shapes, wires; and their precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.quality.error_ellipses import solution_confidence_factor
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.solution import Solution
from tests.networks import on_shapes
from tests.networks.alignment import LENGTH, SENSORS, WIRES, measured, tunnel

pytest.importorskip("matplotlib")

from matplotlib.collections import Collection, EllipseCollection, LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

from factorgraph_adj.report.plots import plot_network, set_aside
from factorgraph_adj.report.plots.drawing_plane import FramePlaces

LONG = pytest.mark.slow(
    "pictures of instruments above and below their points; short tests draw every figure once"
)

VIEWS = {"above": (0, 1), "south": (0, 2), "east": (1, 2)}
"""Coordinates that a view shows in a frame with X east, Y north."""
ROUNDING = 1e-9
SAGITTA = 0.002
"""Height of an arc of 5° over its chord relative to the radius, doubled: circles are polygons."""
TEN_MICRONS = 1e-5


def texts(figure: Figure) -> str:
    return "\n".join(t.get_text() for t in figure.findobj(Text)).replace("\n  ", " ")


def outline(figure: Figure, name: str) -> list[np.ndarray]:
    """Return the lines of the shapes of a sort."""
    (found,) = (c for c in figure.findobj(LineCollection) if c.get_gid() == f"outline: {name}")
    return [np.asarray(s) for s in found.get_segments()]


def instruments(figure: Figure) -> np.ndarray:
    (found,) = (c for c in figure.findobj(PathCollection) if c.get_gid() == "instruments")
    return np.asarray(found.get_offsets())


def labelled(figure: Figure, start: str, sort: type[Collection]) -> list[Collection]:
    drawn = figure.axes[0].collections  # without those of the legend
    return [c for c in drawn if isinstance(c, sort) and str(c.get_label()).startswith(start)]


# -- instruments --------------------------------------------------------------------------------

STANDS = {"T1": (15.0, 5.0, 1.0), "T2": (6.0, -3.0, 1.4)}


def scanned(*, at_point: bool) -> fga.Network:
    """Return eight points, four of them held, and two instruments that sight all of them.

    Args:
        at_point: whether the origin of their frames is a point, which is free; otherwise it is a
            constant that is half a metre off, and the offset is free.
    """
    network = fga.Network("hall")
    rng = np.random.default_rng(3)
    for i in range(8):
        xyz = rng.uniform((0, 0, 0), (20, 12, 6))
        network.add_point(f"P{i}", xyz, fixed="xyz" if i < 4 else "")
    for number, (name, at) in enumerate(STANDS.items()):
        turns = {"rx": 0.1, "ry": -0.05, "rz": 2.0 - number}
        if at_point:
            network.add_point(f"S{name}", at)
            network.add_frame(name, free=list(turns), values=turns, origin=f"S{name}")
        else:
            network.add_frame(name, origin=np.add(at, (0.3, -0.2, 0.4)).tolist())
        for i in range(8):
            if i == 7 and number:
                continue
            network.add(
                o.FrameDirection(name, f"P{i}", 0.0, sigma=2e-5, id=f"{name} P{i} r"),
                o.FrameZenith(name, f"P{i}", 1.0, sigma=2e-5, id=f"{name} P{i} z"),
                o.FrameDistance(name, f"P{i}", 1.0, sigma=5e-4, id=f"{name} P{i} d"),
            )
    return network


@pytest.fixture(scope="module")
def pillars() -> Solution:
    """Instruments over free points."""
    return fga.adjust(measure(scanned(at_point=True), seed=1))


@pytest.fixture(scope="module")
def hall(pillars) -> Solution:
    """Instruments anywhere, with the same readings."""
    network = scanned(at_point=False)
    for key, reading in pillars.network.observations.items():
        network.observations[key] = reading
    return fga.adjust(network)


def test_instruments_stand_where_their_distances_meet(hall):
    plan = instruments(plot_network(hall))
    height = instruments(plot_network(hall, view="south"))[:, 1]
    at = dict(zip(STANDS, np.column_stack([plan, height]), strict=True))
    for reading in hall.network.observations.values():
        if isinstance(reading, o.FrameDistance):
            found = np.linalg.norm(hall.point(reading.point) - at[reading.frame])
            assert found == pytest.approx(reading.value, abs=4 * 5e-4)
    for name, true in STANDS.items():
        np.testing.assert_allclose(at[name], true, atol=0.003)


def test_every_sight_is_a_line_from_the_instrument_and_drawn_once(hall):
    figure = plot_network(hall)
    (lines,) = labelled(figure, "frame direction", LineCollection)
    assert "frame direction, frame zenith, frame distance (15)" in texts(figure)
    expected = {
        (*np.round(at, 9), *np.round(hall.point(f"P{i}")[:2], 9))
        for number, at in enumerate(instruments(figure))
        for i in range(8 - number)
    }
    drawn = set()
    for a, b in lines.get_segments():
        drawn |= {(*np.round(b, 9), *np.round(a, 9)), (*np.round(a, 9), *np.round(b, 9))}
    assert len(lines.get_segments()) == 15
    assert expected <= drawn


@LONG
@pytest.mark.parametrize("view", VIEWS)
def test_the_ellipse_of_an_instrument_is_that_of_a_point_under_it(hall, pillars, view):
    """Both networks have the same unknowns: a free point, or a free offset from a constant."""
    own = plot_network(hall, view=view, factor=1000.0)
    (drawn,) = labelled(own, "error ellipse of an instrument", EllipseCollection)
    other = plot_network(pillars, view=view, factor=1000.0)
    (points,) = labelled(other, "error ellipse of a point", EllipseCollection)
    names = [n for n in pillars.network.points if not all(pillars.network.points[n].fixed)]
    under = [names.index(f"S{name}") for name in STANDS]
    for get in ("get_widths", "get_heights"):
        expected = getattr(points, get)()[under]
        np.testing.assert_allclose(getattr(drawn, get)(), expected, rtol=1e-4)
    np.testing.assert_allclose(
        drawn.get_offsets(), np.asarray(points.get_offsets())[under], atol=TEN_MICRONS
    )


def test_an_instrument_over_a_point_marks_the_point_as_a_station(hall, pillars):
    at_points, anywhere = texts(plot_network(pillars)), texts(plot_network(hall))
    assert "instrument station (2)" in at_points
    assert "instrument in a frame of its own" not in at_points
    assert "instrument station" not in anywhere
    assert "instrument in a frame of its own (2)" in anywhere


def test_instruments_are_named_where_they_stand(hall):
    figure = plot_network(hall)
    names = [t for t in figure.findobj(Text) if t.get_gid() == "name of an instrument"]
    assert [t.get_text() for t in names] == list(STANDS)
    np.testing.assert_allclose([t.xy for t in names], instruments(figure), rtol=ROUNDING)


def test_what_an_instrument_read_wrong_is_a_dotted_line_from_it(hall):
    network = hall.network.copy()
    key = "T2 P5 d"
    network.observations[key] = replace(
        network.observations[key], value=network.observations[key].value + 0.05
    )
    solution = fga.adjust(fga.without(network, [key]))
    figure = plot_network(solution, aside=set_aside(solution, [key], network))
    (cross,) = (c for c in figure.findobj(LineCollection) if c.get_gid() == "rejected")
    expected = [instruments(figure)[1], solution.point("P5")[:2]]
    np.testing.assert_allclose(cross.get_segments(), [expected], rtol=ROUNDING)
    assert "without a place here" not in texts(figure)


# -- shapes -------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=list(SHAPES))
def shape(request) -> tuple[str, Solution]:
    return request.param, fga.adjust(on_shapes.measured(request.param, 1))


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@pytest.mark.parametrize("view", VIEWS)
def test_an_outline_holds_the_points_of_its_shape(shape, view):
    name, solution = shape
    figure = plot_network(solution, view=view)
    assert f"{name} (1)" in texts(figure)
    lines = np.concatenate(outline(figure, name))
    points = solution.state["point"][:, VIEWS[view]]
    slack = 0.01 + SAGITTA * np.ptp(lines, axis=0).max()  # the form is kept to a millimetre or so
    corners = ConvexHull(np.concatenate([lines + d for d in slack * _turns()]))
    assert (points @ corners.equations[:, :2].T + corners.equations[:, 2] <= 0).all()


def _turns() -> np.ndarray:
    turn = np.linspace(0, 2 * np.pi, 12)
    return np.column_stack([np.cos(turn), np.sin(turn)])


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("name", ["circle", "sphere", "torus"])
def test_the_outline_of_a_closed_shape_is_as_large_as_the_shape(name, view):
    """The hull of its lines is that of thousands of places on it, by another formula."""
    solution = fga.adjust(on_shapes.measured(name, 1))
    rng = np.random.default_rng(1)
    if name == "sphere":
        q = rng.normal(size=(20000, 3))
        q *= solution.unknown("size", "S").values / np.linalg.norm(q, axis=1, keepdims=True)
    else:
        q = on_shapes.places(name, 20000, rng)
    seen = FramePlaces(solution).places(0, q)[:, VIEWS[view]]
    area = ConvexHull(np.concatenate(outline(plot_network(solution, view=view), name))).volume
    assert area == pytest.approx(ConvexHull(seen).volume, rel=0.01)


def test_a_plane_is_the_hull_of_its_points_and_from_its_side_a_trace():
    network = fga.Network("floor")
    network.add_shape("floor", "plane", origin=(3.0, 2.0, 0.0))
    corners = [(0, 0, 0), (6, 0, 0), (6, 4, 0), (0, 4, 0), (3, 1, 0)]
    for i, at in enumerate(corners):
        network.add_point(f"P{i}", at)
        network.add(o.GnssPosition(f"P{i}", at, sigma=(0.001,) * 3))
        network.add(o.OnPlane("floor", f"P{i}", sigma=0.001))
    solution = fga.adjust(network)
    (above,) = outline(plot_network(solution), "plane")
    found = {(round(x, 6) + 0.0, round(y, 6) + 0.0) for x, y in above}
    assert found == {(float(x), float(y)) for x, y, _ in corners[:4]}
    np.testing.assert_allclose(above[0], above[-1])
    (trace,) = outline(plot_network(solution, view="south"), "plane")
    assert (np.ptp(trace[:, 0]), np.ptp(trace[:, 1])) == pytest.approx((6.0, 0.0), abs=1e-9)


def test_a_line_reaches_from_its_first_to_its_last_point():
    solution = fga.adjust(on_shapes.measured("line", 1))
    (drawn,) = outline(plot_network(solution), "line")
    x = solution.state["point"][:, :2]
    along = np.argsort(x[:, 0])
    ends = np.sort(drawn, axis=0), np.sort(x[along[[0, -1]]], axis=0)
    np.testing.assert_allclose(*ends, atol=0.005)


def test_a_short_arc_of_a_large_circle_does_not_shrink_its_points():
    network = fga.Network("rail")
    network.add_shape("rail", "circle", origin=(0.0, 0.0, 0.0))
    for i, turn in enumerate(np.linspace(-0.05, 0.05, 9)):
        at = (500 * np.cos(turn) - 500, 500 * np.sin(turn), 0.0)
        network.add_point(f"P{i}", at)
        network.add(o.GnssPosition(f"P{i}", at, sigma=(0.001,) * 3))
        network.add(o.OnCircle("rail", f"P{i}", sigma=0.001))
    figure = plot_network(fga.adjust(network))
    assert np.ptp(figure.axes[0].get_ylim()) < 100.0
    assert np.ptp(np.concatenate(outline(figure, "circle"))[:, 1]) == pytest.approx(1000, rel=0.01)


def test_the_centre_of_a_sphere_has_the_ellipse_of_its_frame():
    solution = fga.adjust(on_shapes.measured("sphere", 1))
    figure = plot_network(solution, factor=100.0)
    (drawn,) = labelled(figure, "error ellipse of the centre of a sphere", EllipseCollection)
    # The rotations of a sphere are held at zero: the offset is in the axes of the network.
    plan = solution.variable_covariance(("frame", "S"))[3:5, 3:5]
    semi = np.sqrt(np.linalg.eigvalsh(plan)[::-1]) * solution_confidence_factor(solution, 2, 0.95)
    np.testing.assert_allclose(drawn.get_widths(), [200 * semi[0]], rtol=1e-6)
    np.testing.assert_allclose(drawn.get_heights(), [200 * semi[1]], rtol=1e-6)


# -- wires --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wires() -> Solution:
    return fga.adjust(measured(tunnel()))


def test_a_wire_hangs_where_its_sensors_read_it(wires):
    """A sensor is level and across the wire: its readings lead from the sensor to the wire."""
    plan, side = (plot_network(wires, view=v) for v in ("above", "east"))
    assert f"stretched wire ({len(WIRES)})" in texts(plan)
    above, east = outline(plan, "stretched wire"), outline(side, "stretched wire")
    readings = [r for r in wires.network.observations.values() if isinstance(r, o.WireReading)]
    assert len(readings) == SENSORS * len(WIRES)
    for number, name in enumerate(WIRES):
        for r in (r for r in readings if r.frame == name):
            x, y, z = wires.point(r.point)
            across = np.interp(y, above[number][:, 1], above[number][:, 0]) - x
            height = np.interp(y, *east[number].T) - z
            # Readings are good to 10 µm; the wire leans by a thousandth against the sensors.
            np.testing.assert_allclose([across, height], r.value, atol=5 * TEN_MICRONS)
        middle = np.interp(LENGTH / 2, *east[number].T)
        chord = np.mean([east[number][0, 1], east[number][-1, 1]])
        assert chord - middle == pytest.approx(WIRES[name][2], abs=2e-4)


def test_the_ends_of_a_wire_have_the_precision_of_its_frame(wires):
    """Across, an end at y is at x + z ry − y rz, as the wire leans little: a hand computation."""
    figure = plot_network(wires, factor=1000.0)
    (drawn,) = labelled(figure, "error ellipse of the end of a wire", EllipseCollection)
    k = solution_confidence_factor(wires, 2, 0.95)  # y moves a little too, with z: the wire slopes
    expected = []
    for name in WIRES:
        sigma = wires.variable_covariance(("frame", name))
        for far in (0.0, LENGTH):
            by = np.array([0.0, WIRES[name][1], -far, 1.0, 0.0, 0.0, 0.0])
            expected.append(2000.0 * k * np.sqrt(by @ sigma @ by))
    np.testing.assert_allclose(drawn.get_widths(), expected, rtol=2e-3)
    assert (drawn.get_heights() < 0.01 * drawn.get_widths()).all()


def test_a_point_that_is_free_in_one_direction_has_an_interval_and_the_legend_says_so(wires):
    figure = plot_network(wires)
    (drawn,) = labelled(figure, "interval of a point", EllipseCollection)
    assert (drawn.get_heights() < 1e-3 * drawn.get_widths()).all()
    assert "interval of a point, which is free in one direction" in texts(figure)
    assert "error ellipse of a point" not in texts(figure)


# -- names and networks without points ----------------------------------------------------------


def test_photos_without_any_point_have_a_plan():
    """Edges that photos alone observe have no points; once the figure said that it was empty."""
    solution = fga.adjust(on_shapes.edges())
    figure = plot_network(solution)
    (photos,) = labelled(figure, "photo and what it looks at", PathCollection)
    centres = [solution.pose(name).position[:2] for name in solution.network.photos]
    np.testing.assert_allclose(photos.get_offsets(), centres, rtol=ROUNDING)
    (drawn,) = labelled(figure, "error ellipse of a projection centre", EllipseCollection)
    assert len(drawn.get_widths()) == len(centres)


def test_all_of_two_hundred_points_with_room_are_named():
    """Once 150 names were tried, and one side of a block of photos had none."""
    network = fga.Network("grid")
    for i in range(200):
        network.add_point(f"{i}", (100.0 * (i % 20), 100.0 * (i // 20), 0.0))
        xyz = network.points[f"{i}"].coordinates
        network.add(o.GnssPosition(f"{i}", xyz, sigma=(0.01,) * 3))
    figure = plot_network(fga.adjust(network))
    names = [t for t in figure.findobj(Text) if t.get_gid() == "name of a point"]
    assert len(names) > 190
