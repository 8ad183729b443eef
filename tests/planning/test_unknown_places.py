"""Plans of networks with unknowns that have no values: derived, taken, or refused by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.observations import (
    FrameDirection,
    FrameDistance,
    FrameZenith,
    LevelHeight,
    OnCylinder,
    OnPlane,
    SlopeDistance,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.simulation.planned_values import with_given_values
from factorgraph_adj.units import CC

ROTATION = {"rx": -0.15, "ry": 0.3, "rz": -2.1}
POINTS = {"A": (0, 0, 0), "B": (30, 0, 2), "C": (28, 25, 6), "D": (2, 22, 1), "P": (15, 12, 4)}
TENTH_MM = 1e-4


def hall(values: Mapping[str, float], **frame: object) -> fga.Network:
    """Return control points and one new point, sighted by an instrument in a frame of its own."""
    network = fga.Network("hall")
    for name, xyz in POINTS.items():
        network.add_point(name, xyz, fixed="" if name == "P" else "xyz")
    network.add_frame("LT", values=values, **frame)  # type: ignore[arg-type]
    for p in POINTS:
        network.add(
            FrameDirection("LT", p, 0.0, sigma=3 * CC),
            FrameZenith("LT", p, 1.0, sigma=6 * CC),
            FrameDistance("LT", p, 1.0, sigma=2e-5),
        )
    return network


def at(place: tuple[float, float, float]) -> dict[str, float]:
    """Return the values of a frame at a place."""
    rotation = exp_rotation(np.array([list(ROTATION.values())]))[0]
    return {**ROTATION, **dict(zip("xyz", (rotation.T @ np.array(place)).tolist(), strict=True))}


@pytest.mark.parametrize("take", [fga.plan, lambda n: measure(n, seed=1)])
@pytest.mark.parametrize(
    ("values", "missing"),
    [({}, "rx, ry, rz, x, y, z"), (ROTATION, "x, y, z"), ({"x": 1, "y": 2, "z": 3}, "rx, ry, rz")],
)
def test_a_frame_of_unknown_place_is_refused_by_name(
    take: Callable[[fga.Network], object], values: dict[str, float], missing: str
) -> None:
    with pytest.raises(fga.InputError) as error:
        take(hall(values))
    (problem,) = error.value.problems
    assert problem.where == "frame 'LT'"
    assert f"a plan needs its values; {missing} missing" in problem.what


def test_frames_are_refused_together_with_points() -> None:
    network = hall({})
    network.points.pop("P")
    network.add_point("P")
    with pytest.raises(fga.InputError) as error:
        fga.plan(network)
    assert [p.where for p in error.value.problems] == ["point 'P'", "frame 'LT'"]


def test_a_rotation_that_is_stated_counts_about_a_stated_origin() -> None:
    """The offset is zero there, and the rotation is not lost with it."""
    place = (12.0, 3.0, 1.5)
    found = with_given_values(hall(ROTATION, origin=place))
    assert found.frames["LT"].values == (*ROTATION.values(), 0.0, 0.0, 0.0, 0.0)
    told = fga.plan(hall({**ROTATION, "x": 0.0, "y": 0.0, "z": 0.0}, origin=place))
    taken = fga.plan(hall(ROTATION, origin=place))
    np.testing.assert_array_equal(
        taken.solution.standard_deviations("P"), told.solution.standard_deviations("P")
    )


def test_a_plan_has_the_precision_of_the_adjustment_of_what_is_read() -> None:
    network = hall(at((12.0, 3.0, 1.5)))
    read = measure(network, seed=4)
    free = read.copy()
    free.frames.clear()
    free.add_frame("LT")
    expected = fga.plan(network).solution.standard_deviations("P")
    np.testing.assert_allclose(fga.adjust(free).standard_deviations("P"), expected, rtol=1e-3)
    elsewhere = fga.plan(hall(at((3.0, 2.0, 9.0)))).solution.standard_deviations("P")
    assert not np.allclose(elsewhere, expected, rtol=0.05)


def pipe(values: Mapping[str, float] | None = None, radius: float | None = None) -> fga.Network:
    """Return points on a pipe and on its flat end, with distances from control."""
    network = fga.Network("pipe")
    for name, xyz in (("A", (0, 0, 0)), ("B", (9, 0, 0)), ("C", (0, 9, 1)), ("D", (5, 5, 6))):
        network.add_point(name, xyz, fixed="xyz")
    network.add_shape("pipe", "cylinder", origin=(3.0, 3.0, 2.0), values=values)
    network.add_shape("end", "plane", origin=(3.0, 3.0, 2.0))
    if radius is not None:
        network.set_size("pipe", radius)
    for i, turn in enumerate(np.linspace(0.0, 6.0, 12).tolist()):
        x, y = 3.2 + 0.5 * np.cos(turn), 2.9 + 0.5 * np.sin(turn)
        network.add_point(f"P{i}", (x, y, 1.0 + i % 3))
        network.add(OnCylinder("pipe", f"P{i}", sigma=1e-3))
        if i % 3 == 0:
            network.add(OnPlane("end", f"P{i}", sigma=1e-3))
        for a in "ABCD":
            network.add(SlopeDistance(a, f"P{i}", 1.0, sigma=1e-3))
    return network


def test_shapes_follow_from_their_points() -> None:
    found = fga.plan(pipe()).network
    *turn, x, y, z, _ = found.frames["pipe"].values
    axis = exp_rotation(np.array(turn)) @ (x, y, z)
    np.testing.assert_allclose(axis[:2], (0.2, -0.1), atol=TENTH_MM)
    assert found.sizes["pipe"].values[0] == pytest.approx(0.5, abs=TENTH_MM)
    assert found.frames["end"].values[5] == pytest.approx(-1.0, abs=TENTH_MM)
    stated = pipe({"rx": 0.0, "ry": 0.0, "x": 0.2, "y": -0.1}, 0.5)
    derived, told = (fga.plan(n).solution.standard_deviations("P5") for n in (pipe(), stated))
    np.testing.assert_allclose(derived, told, rtol=1e-6)


def test_a_shape_that_its_points_leave_open_is_refused_once() -> None:
    network = fga.Network("edge")
    for i in range(3):
        network.add_point(f"P{i}", (float(i), 0.0, 0.0), sigma=1e-3)
    network.add_shape("floor", "plane", origin=(0.5, 0.0, 0.0))
    network.add(*(OnPlane("floor", f"P{i}", sigma=1e-3) for i in range(3)))
    with pytest.raises(fga.InputError, match="shape 'floor': its 3 known points leave") as error:
        fga.plan(network)
    assert len(error.value.problems) == 1


def test_a_level_surface_needs_its_height() -> None:
    network = fga.Network("lake")
    network.add_point("A", (0, 0, 6.4), sigma=0.01)
    network.set_level("lake")
    network.add(LevelHeight("A", "lake", sigma=1e-3))
    with pytest.raises(fga.InputError, match="'lake': a plan needs its values; height missing"):
        fga.plan(network)


HEADER = "name,free,level,rx_rad,ry_rad,rz_rad"
FRAMES = f"{HEADER}\nOTHER,rotation offset,,0,0,0\nLT,rotation offset,,,,\n"


@pytest.mark.parametrize("command", ["plan", "propose"])
def test_the_commands_tell_file_and_line(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network = hall({})
    fga.write_project(network, tmp_path / "project.toml")
    (tmp_path / "frames.csv").write_text(FRAMES)
    points = (tmp_path / "points.csv").read_text().splitlines()
    (tmp_path / "points.csv").write_text("\n".join([*points[:5], "P,,,,"]) + "\n")
    wishes = tmp_path / "wishes.toml"
    wishes.write_text(
        '[[target]]\nkind = "semi_axis"\nat_most_mm = 1\n[[candidate]]\nname = "tape"\nobservations'
        ' = [{kind = "slope_distance", station = "A", target = "P", sigma_mm = 0.5}]\n'
    )
    more = [str(wishes)] if command == "propose" else []
    assert main([command, str(tmp_path), *more]) == 2
    told = capsys.readouterr().err
    assert "points.csv:6: point 'P': a plan needs its coordinates" in told
    assert "frames.csv:3: frame 'LT': a plan needs its values; rx, ry, rz, x, y, z" in told
