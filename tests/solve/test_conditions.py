"""Adjustments with shapes and relations: free networks, arrivals, plans, reports, bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.models.shapes import SHAPES
from factorgraph_adj.report.plots.figure_files import save_plots
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.solve.inner_constraints import moved_by_similarity
from tests.networks import on_shapes
from tests.networks.on_shapes import MM, ON, places, posed
from tests.support.studies import cases

PERCENT = 0.01


# -- free networks --------------------------------------------------------------------------------


def braced(shape: str, *, datum: str = "free") -> fga.Network:
    """Return points on a shape that are joined by distances alone."""
    rng = np.random.default_rng([3, list(SHAPES).index(shape)])
    x = posed(places(shape, 10, rng), rng)
    stations = x.mean(axis=0) + np.array([[9, 1, 2], [-3, 8, -4], [1, -5, 9.0], [-7, -6, -3]])
    network = fga.Network(shape, datum=datum)  # type: ignore[arg-type]
    network.add_shape(
        "S", shape, origin=(x.mean(axis=0) + np.array([2.0, 1.0, 3.0])).round().tolist()
    )
    places_ = {f"P{i}": at for i, at in enumerate(x)} | {
        f"T{i}": at for i, at in enumerate(stations)
    }
    for name, at in places_.items():
        network.add_point(name, at + 2 * MM * rng.normal(size=3))
    names = list(places_)
    for i, a in enumerate(names):
        for b in names[max(i + 1, 10) :]:
            length = float(np.linalg.norm(places_[a] - places_[b])) + MM * rng.normal()
            network.add(o.SlopeDistance(a, b, length, sigma=MM))
    for i in range(10):
        network.add(ON[shape]("S", f"P{i}", sigma=MM))
    return network


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("shape", SHAPES)
def test_shapes_move_with_a_free_network(shape):
    """Six defects, of which shapes notice nothing; the sum of squares is that of any datum."""
    network = braced(shape)
    free = fga.adjust(network)
    assert free.converged
    (defect,) = free.defects
    assert defect.size == 6
    held = braced(shape, datum="given")
    for name, fixed in (
        ("T0", (True,) * 3),
        ("T1", (True, True, False)),
        ("T2", (True, False, False)),
    ):
        held.points[name] = replace(held.points[name], fixed=fixed)
    solution = fga.adjust(held)
    assert solution.vtpv == pytest.approx(free.vtpv, rel=1e-8)
    assert solution.redundancy == free.redundancy


@pytest.mark.parametrize("seed", range(3))
def test_parallel_axes_move_with_a_free_network(seed):
    """Two residuals that turn about a normal with the object notice nothing of the turn."""
    network = braced("plane")
    rng = np.random.default_rng(seed)
    for i, x in network.observations.items():
        if isinstance(x, o.SlopeDistance):
            network.observations[i] = replace(x, value=x.value + 20 * MM * rng.normal())
    network.add_shape("half", "plane", origin=network.frames["S"].constants[:3])
    for i in range(5):
        network.add(o.OnPlane("half", f"P{i}", sigma=MM))
    network.add(o.ParallelAxes("S", "half", sigma=1e-4))
    solution = fga.adjust(network)
    assert solution.converged
    (defect,) = solution.defects
    assert defect.size == 6


@pytest.mark.parametrize("shape", SHAPES)
def test_a_finite_motion_leaves_the_residuals_of_shapes(shape):
    free = fga.adjust(braced(shape))
    (defect,) = free.defects
    moved = moved_by_similarity(
        free.equations, free.state, defect, np.array([3.0, -2.0, 1.0, 4.0, 2.0, -3.0])
    )
    block = next(b for b in free.equations.blocks if b.kind == f"on_{shape}")
    frame = free.network.frame
    before, after = (block.evaluate(frame, s).residual for s in (free.state, moved))
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-9)
    assert np.abs(moved["point"] - free.state["point"]).max() > 0.1


# -- arrivals -------------------------------------------------------------------------------------


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("shape", SHAPES)
def test_points_on_shapes_arrive_and_leave_as_in_the_batch_adjustment(shape, tmp_path):
    network = measure(on_shapes.plan(shape), seed=6)
    late = {i: x for i, x in network.observations.items() if i in ("on 3", "on 7")}
    begun = network.copy()
    begun.observations = {i: x for i, x in network.observations.items() if i not in late}
    inc = fga.IncrementalAdjustment(begun, journal=tmp_path / "day.jsonl")
    for ident, x in late.items():
        inc.add(observation_from_record(json.loads(json.dumps(observation_record(x, id=ident)))))
    assert_same(inc.solution(), fga.adjust(network))
    inc.remove("on 3")
    assert_same(inc.solution(), fga.adjust(fga.without(network, ["on 3"])))
    before = inc.solution()
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert_same(again.solution(), before)


def assert_same(a: fga.Solution, b: fga.Solution) -> None:
    """Points agree to a percent of their standard deviations."""
    for name in b.network.points:
        off = np.abs(a.point(name) - b.point(name))
        assert (off <= PERCENT * b.standard_deviations(name) + 1e-12).all()
    assert a.vtpv == pytest.approx(b.vtpv, rel=1e-3, abs=1e-6)


def test_relations_and_edges_arrive():
    for plan in (on_shapes.room(), fga.adjust(on_shapes.edges()).as_network()):
        network = measure(plan, seed=1)
        late = [i for i, x in network.observations.items() if x.kind not in ("gnss_position",)][-9:]
        begun = fga.without(network, late)
        inc = fga.IncrementalAdjustment(begun)
        for ident in late:
            inc.add(replace(network.observations[ident], id=ident))
        assert inc.solution().vtpv == pytest.approx(fga.adjust(network).vtpv, rel=1e-3, abs=1e-6)


# -- reports --------------------------------------------------------------------------------------


WITH_SHAPES = {**{s: partial(on_shapes.plan, s) for s in SHAPES}, "edges": on_shapes.edges}
WITH_SHAPES["room"] = on_shapes.room


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", WITH_SHAPES)
def test_reports_take_shapes_and_relations(name):
    network = WITH_SHAPES[name]()
    text = fga.text_report(fga.adjust(network))
    assert "Shapes" in text
    for kind in {x.kind for x in network.observations.values()}:
        assert kind.replace("_", " ") in text or kind in text


@pytest.mark.slow("pictures of networks with shapes; short tests draw networks of points")
@pytest.mark.parametrize("name", cases(WITH_SHAPES, ["room", "edges", "torus"]))
def test_plots_take_shapes_and_relations(name, tmp_path):
    assert save_plots(fga.adjust(WITH_SHAPES[name]()), tmp_path)


# -- relations ------------------------------------------------------------------------------------


def test_pairs_begin_with_the_point_that_they_share():
    for pair in (("A", "B", "B", "C"), ("B", "A", "B", "C"), ("A", "B", "C", "B")):
        found = o.EqualDistance(*pair, 0.3, sigma=1.0, ratio=2.0)
        assert (found.station, found.station2, found.value, found.ratio) == ("B", None, 0.3, 2.0)
    x = {"A": (0.0, 0.0, 1.0), "B": (5.0, 0.0, 3.0), "C": (9.0, 1.0, 3.5), "D": (9.0, 3.0, 2.0)}
    network = fga.Network("heights")
    for name, at in x.items():
        network.add_point(name, at, fixed="xyz" if name != "D" else "xy")
    z = {name: at[2] for name, at in x.items()}
    network.add(o.HeightDifference("A", "D", 1.0, sigma=1.0))
    for a, b, c, d in (
        ("A", "B", "B", "C"),
        ("A", "B", "C", "A"),
        ("B", "A", "C", "A"),
        ("A", "B", "A", "C"),
    ):
        value = (z[b] - z[a]) - 0.5 * (z[d] - z[c])
        network.add(o.EqualHeightDifference(a, b, c, d, value, sigma=1.0, ratio=0.5))
    np.testing.assert_allclose(fga.adjust(network).observations.residuals, 0.0, atol=1e-12)


def test_equal_distances_place_a_point_in_the_middle():
    network = fga.Network("middle")
    for name, at in (("A", (0.0, 0.0, 0.0)), ("B", (10.0, 0.0, 0.0))):
        network.add_point(name, at, fixed="xyz")
    network.add_point("M", (4.0, 0.0, 0.0), fixed="yz")
    network.add(o.EqualDistance("A", "M", "M", "B", sigma=1e-3))
    assert fga.adjust(network).point("M")[0] == pytest.approx(5.0, abs=1e-9)
    network.observations.clear()
    network.add(o.EqualDistance("A", "M", "M", "B", sigma=1e-3, ratio=1.5))
    assert fga.adjust(network).point("M")[0] == pytest.approx(6.0, abs=1e-9)


def test_the_angle_of_axes_has_no_sense():
    for angle in (0.3, np.pi / 2):
        network = fga.Network("two lines")
        for name, turn in (("a", 0.0), ("b", 0.35 if angle < 1 else np.pi / 2 + 0.02)):
            network.add_shape(name, "line", origin=(0, 0, 0), values={"rx": 0.1, "ry": 0.2 + turn})
            for i, s in enumerate((-2.0, -1.0, 1.0, 2.0)):
                axis = np.array([np.sin(turn), 0.0, np.cos(turn)]) * (-1 if name == "b" else 1)
                network.add_point(f"{name}{i}", s * axis, sigma=0.01)
                network.add(o.OnLine(name, f"{name}{i}", sigma=0.01))
        network.add(o.AxisAngle("a", "b", angle, sigma=1e-6))
        solution = fga.adjust(on_shapes.without_shapes(network))
        a, b = (solution.state["frame"][i, 2:9:3] for i in (0, 1))
        assert np.arccos(abs(a @ b)) == pytest.approx(angle, abs=1e-4)


# -- bad input ------------------------------------------------------------------------------------

WRONG = {
    "a vector that is zero": (
        lambda: o.PointDirection("A", "B", 0.0, 0.0, 0.0, sigma=1.0),
        "ux, uy, uz must be a vector that is not zero",
    ),
    "a distance for a line": (
        lambda: o.OnLine("edge", "A", 0.0, sigma=1.0),  # type: ignore[arg-type]
        "value must have 2 components, not 0.0",
    ),
    "no standard deviation of a line": (lambda: o.OnLine("edge", "A"), "sigma or covariance"),
    "a negative standard deviation": (
        lambda: o.OnPlane("floor", "A", sigma=-1.0),
        "sigma must be greater than zero",
    ),
    "axes that are none": (
        lambda: o.CoordinateDifference("A", "B", (0.0,), axes="e", sigma=1.0),
        "axes must be some of x, y, z, not 'e'",
    ),
    "the same pair twice": (
        lambda: o.EqualDistance("A", "B", "B", "A", sigma=1.0),
        "both pairs are the same two points",
    ),
    "a point joined to itself": (
        lambda: o.EqualDistance("A", "A", "B", "C", sigma=1.0),
        "cannot join a point to itself",
    ),
    "a shape and itself": (
        lambda: o.ParallelAxes("floor", "floor", sigma=1.0),
        "shape and shape2 must name two frames",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told(name):
    make, told = WRONG[name]
    with pytest.raises(fga.InputError) as error:
        make()
    assert told in str(error.value)


def test_an_unknown_shape_or_frame_or_size_is_told_with_what_is_there():
    network = fga.Network("wrong")
    network.add_point("A", (0.0, 0.0, 0.0))
    with pytest.raises(fga.InputError, match=r"unknown shape 'cilinder'; valid: .*cylinder"):
        network.add_shape("tank", "cilinder", origin=(0, 0, 0))
    network.add_shape("tank", "cylinder", origin=(0, 0, 0))
    with pytest.raises(fga.InputError, match=r"unknown frame 'tnak'; .*tank"):
        network.add(o.OnCylinder("tnak", "A", sigma=1.0))
    with pytest.raises(fga.InputError, match=r"unknown size 'pipe'; .*tank"):
        network.add(o.OnCylinder("tank", "A", sigma=1.0, radius="pipe"))
    with pytest.raises(fga.InputError, match="duplicate name of a frame"):
        network.add_shape("tank", "plane", origin=(0, 0, 0))


def test_a_wrong_table_is_told_with_file_and_line(tmp_path):
    fga.write_project(on_shapes.plan("cylinder"), tmp_path / "project.toml")
    table = tmp_path / "observations.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    number = next(i for i, line in enumerate(lines) if line.startswith("on_cylinder"))
    lines[number] = lines[number].replace("P0", "P00")
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(
        fga.InputError, match=rf"observations.csv:{number + 1}: .*unknown point 'P00'"
    ):
        fga.read_project(tmp_path)
