"""Targets and candidates in files, and the commands that read them."""

from __future__ import annotations

import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli import design as cli_plan
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import Problem
from factorgraph_adj.experiment import runs
from factorgraph_adj.io.project import load_project
from factorgraph_adj.planning import target_files
from factorgraph_adj.planning.target_files import Wishes, read_wishes
from factorgraph_adj.planning.targets import PointPrecision, SemiAxis, UndetectedShift
from tests.support.places import EXAMPLES

PROJECT = """name = "dam"
[files]
points = "points.csv"
observations = "observations.csv"
[[camera]]
name = "C"
parameters.c = 24.0
"""
POINTS = """name,x,y,z,fixed
A,0,0,0,xyz
B,100,0,0,xyz
P1,40,60,5,
P2,70,50,8,
"""
OBSERVATIONS = """kind,station,target,sigma_mm
slope_distance,A,P1,1
slope_distance,B,P1,1
height_difference,A,P1,1
slope_distance,A,P2,1
slope_distance,B,P2,1
height_difference,B,P2,1
"""
TARGET = """[[target]]
kind = "semi_axis"
at_most_mm = 2.2
"""
TABLE = '[files]\ncandidates = "more.csv"\n'
TAPE = """[[candidate]]
name = "tape"
cost = 2
observations = [{kind = "slope_distance", station = "P1", target = "P2", sigma_mm = 0.5}]
"""
SET_UP = '[[candidate]]\nname = "set-up C"\npoints = [{name = "C", x = 50, y = 120, z = 0}]\n'
SIGHTS = """candidate,cost,kind,station,target,sigma_mm
set-up C,5,slope_distance,C,A,1
set-up C,,slope_distance,C,B,1
set-up C,,slope_distance,C,P1,1
set-up C,,slope_distance,C,P2,1
set-up C,,height_difference,A,C,1
tape,2,slope_distance,P1,P2,0.5
"""
Wrong = Callable[..., list[str]]
Ran = tuple[int, str, str]


@pytest.fixture
def dam(tmp_path: Path) -> Path:
    (tmp_path / "project.toml").write_text(PROJECT)
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "observations.csv").write_text(OBSERVATIONS)
    return tmp_path


@pytest.fixture
def wishes(dam: Path) -> Callable[..., Wishes]:
    """Read a file of wishes, with a table beside it."""

    def read(text: str, table: str = "") -> Wishes:
        (dam / "wishes.toml").write_text(text)
        (dam / "more.csv").write_text(table)
        return read_wishes(dam / "wishes.toml", load_project(dam, readings=False))

    return read


@pytest.fixture
def wrong(wishes: Callable[..., Wishes]) -> Wrong:
    """Return what is wrong with a file of wishes."""

    def read(text: str, table: str = "") -> list[str]:
        with pytest.raises(fga.InputError) as error:
            wishes(text, table)
        return [str(p) for p in error.value.problems]

    return read


@pytest.fixture
def command(dam: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Run a command on the project; return its exit code and what it says."""

    def run(name: str, text: str = "", table: str = "", *more: str) -> Ran:
        (dam / "wishes.toml").write_text(text)
        (dam / "more.csv").write_text(table)
        target = [str(dam / "wishes.toml")] if text else []
        if name == "plan" and text:
            target = ["--targets", *target]
        code = main([name, str(dam), *target, *more])
        return code, *capsys.readouterr()

    return run


# -- targets -----------------------------------------------------------------------------------


def test_a_limit_of_a_length_may_be_stated_in_millimetres(wishes: Callable[..., Wishes]) -> None:
    kinds = ("semi_axis", "point_precision", "undetected_shift")
    text = "".join(f'[[target]]\nkind = "{k}"\nat_most_mm = 1.5\n' for k in kinds)
    classes = (SemiAxis, PointPrecision, UndetectedShift)
    assert wishes(text).targets == tuple(c(0.0015) for c in classes)


def test_millimetres_are_refused_beside_metres_and_where_a_limit_is_no_length(wrong: Wrong) -> None:
    both, sigmas, none = wrong(
        '[[target]]\nkind = "semi_axis"\nat_most = 0.001\nat_most_mm = 1\n'
        '[[target]]\nkind = "detectable_error"\nat_most = 9.0\nat_most_mm = 1\n'
        '[[target]]\nkind = "semi_axis"\n'
    )
    assert both == "wishes.toml: target 1: give only one of at_most (metres) and at_most_mm"
    assert sigmas.startswith("wishes.toml: target 2: unknown key 'at_most_mm'; known: at_most, ")
    assert none == "wishes.toml: target 3: at_most is missing: metres, or at_most_mm"


def test_the_example_of_the_docstring_is_read(wishes: Callable[..., Wishes]) -> None:
    example = "\n".join(
        line[4:] for line in str(target_files.__doc__).splitlines() if line.startswith("    ")
    )
    table = SIGHTS.replace("set-up C", "set-up S3").replace(",C", ",S3")
    found = wishes(example.replace("candidates.csv", "more.csv"), table)
    photo, set_up, tape = found.candidates
    assert found.targets == (SemiAxis(0.0015, points=("P*",)),)
    assert [f.name for f in photo.photos] == ["F9"]
    assert [p.name for p in set_up.points] == ["S3"]
    assert [len(c.observations) for c in (photo, set_up, tape)] == [1, 5, 1]


# -- candidates --------------------------------------------------------------------------------


def test_a_candidate_takes_its_sights_from_the_table(wishes: Callable[..., Wishes]) -> None:
    set_up, tape = wishes(TARGET + SET_UP + TABLE, SIGHTS).candidates
    assert (set_up.name, set_up.cost, len(set_up.observations)) == ("set-up C", 5.0, 5)
    assert [p.name for p in set_up.points] == ["C"]
    assert (tape.name, tape.cost, len(tape.observations)) == ("tape", 2.0, 1)


def test_image_points_of_a_new_photo_stand_in_the_table_in_units_of_its_camera(
    dam: Path, wishes: Callable[..., Wishes]
) -> None:
    camera = PROJECT.replace('name = "C"', 'name = "C"\nunit = "px"').replace("24.0", "4000.0")
    (dam / "project.toml").write_text(camera)
    photo = (
        '[[candidate]]\nname = "photo"\nphotos = [{name = "F", camera = "C", x = 50, y = -40, '
        "z = 3, omega = 100, phi = 0, kappa = 0}]\n"
    )
    table = "candidate,kind,photo,point,sigma_px\nphoto,image,F,P1,0.3\nphoto,image,F,P2,0.3\n"
    (found,) = wishes(TARGET + photo + TABLE, table).candidates
    assert [o.sigma for o in found.observations] == [(0.3, 0.3)] * 2  # type: ignore[union-attr]


def test_a_new_point_in_a_table_is_told_once_with_where_it_goes(wrong: Wrong) -> None:
    (found,) = wrong(TARGET + TABLE, SIGHTS)
    assert found.startswith(
        "more.csv:2: candidate 'set-up C': unknown point 'C' in 5 observations; a new one stands "
    )
    assert "among the points of [[candidate]] name = 'set-up C' in the TOML file; known: A" in found


def test_costs_are_told_by_file_line_and_candidate_with_everything_else(wrong: Wrong) -> None:
    table = SIGHTS.replace("tape,2", "tape,-2").replace("C,,slope_distance,C,B", "C,6,height,C,B")
    text = 'kind = "slope_distance", station = "A", target = "P9", sigma_mm = 1'
    found = wrong(
        '[[target]]\nkind = "semi_axis"\nat_most_mm = 2\npoints = "Q*"\n'
        + SET_UP
        + f'[[candidate]]\nname = "free"\ncost = 0\nobservations = [{{{text}}}]\n'
        + '[[candidate]]\nname = "dear"\ncost = "2 h"\n'
        + TABLE,
        table,
    )
    for part in (
        "wishes.toml: candidate 2: cost must be greater than zero, not 0",
        "wishes.toml: candidate 2: observations 1: candidate 'free': unknown point 'P9'",
        "wishes.toml: candidate 3: cost must be a number, not '2 h'",
        "wishes.toml: candidate 3: candidate 'dear' has no observations",
        "wishes.toml: target 1, 95 % semi-axis of the ellipse (m): no point is named like 'Q*'",
        "more.csv:3: candidate 'set-up C': cost is 6 here, but 5 in more.csv:2",
        "more.csv:3: height C B: unknown kind 'height'",
        "more.csv:7: candidate 'tape': cost must be greater than zero, not -2",
    ):
        assert any(p.startswith(part) for p in found), (part, found)
    assert len(found) == 8


def test_what_is_new_and_stands_nowhere_is_told_by_file_and_candidate(wrong: Wrong) -> None:
    photo = 'photos = [{name = "F", camera = "C", x = 1, y = 2, z = 3}]\n'
    found = wrong(
        TARGET + SET_UP.replace(", z = 0", "") + photo + TAPE.replace("tape", "b") + TABLE, SIGHTS
    )
    assert found == [
        "wishes.toml: candidate 1: point 'C': a plan needs its coordinates; z missing",
        "wishes.toml: candidate 1: photo 'F': a plan needs its position and rotation; rotation "
        "(omega, phi, kappa) missing",
    ]


LAKE = """[[candidate]]
name = "lake"
unknowns = [{kind = "level", name = "lake", value_m = 6.5}]
observations = [
    {kind = "level_height", point = "P1", level = "lake", sigma_mm = 1},
    {kind = "level_height", point = "P2", level = "lake", sigma_mm = 1},
]
"""


def test_a_candidate_brings_unknowns_of_its_own(wishes: Callable[..., Wishes], dam: Path) -> None:
    (lake,) = wishes(TARGET + LAKE).candidates
    assert lake.unknowns["level"]["lake"].values == (6.5,)
    assert lake.brings == {("level", "lake")}
    loose = LAKE.replace("value_m = 6.5", "value_mm = 6500, sigma_mm = 5")
    (weighted,) = wishes(TARGET + loose).candidates
    assert weighted.unknowns["level"]["lake"].sigma == pytest.approx((0.005,))
    network = load_project(dam, readings=False).network
    before = fga.plan(network).solution.standard_deviations("P1")[2]
    proposal = fga.propose(network, [lake], PointPrecision(0.99 * before, axes="z", points=("P1",)))
    assert proposal.names == ("lake",)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('kind = "level"', 'kind = "levels"', "unknown kind 'levels'; valid: "),
        ('kind = "level", ', "", "kind of unknowns is missing; valid: "),
        ('name = "lake", v', "v", "level surface: name is missing"),
        ("value_m = 6.5", "height_m = 6.5", "level surface: unknown field 'height_m'"),
        (", value_m = 6.5", "", "level surface 'lake': a plan needs its values"),
        ("value_m = 6.5", "value_m = 'x'", "level surface 'lake': value_m"),
    ],
)
def test_a_bad_unknown_of_a_candidate_is_named(wrong: Wrong, old: str, new: str, told: str) -> None:
    (found,) = wrong(TARGET + LAKE.replace(old, new, 1))
    assert found.startswith("wishes.toml: candidate 1: unknowns 1: ")
    assert told in found


def test_unknowns_that_are_there_twice_are_refused(wrong: Wrong) -> None:
    twice = LAKE.replace("6.5}]", '6.5}, {kind = "level", name = "lake", value_m = 7}]')
    (found,) = wrong(TARGET + twice)
    assert found == (
        "wishes.toml: candidate 1: unknowns 2: level surface 'lake': there are two of this name"
    )


def test_two_candidates_of_one_name_are_refused(wrong: Wrong) -> None:
    (found,) = wrong(TARGET + TAPE + TAPE)
    assert found == "wishes.toml: candidate 2: there are two of the name 'tape'"


def test_a_photo_of_an_unknown_camera_is_told_with_its_file(wrong: Wrong) -> None:
    photo = (
        'photos = [{name = "F", camera = "D", x = 1, y = 2, z = 3, omega = 0, phi = 0, kappa = 0}]'
    )
    (found,) = wrong(TARGET + TAPE + photo)
    assert found.startswith("wishes.toml: candidate 1: candidate 'tape', ")
    assert "unknown camera 'D'" in found


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ('[files]\ncandidate = "more.csv"\n', "unknown key 'candidate' in [files]; known: cand"),
        ("[files]\ncandidates = 3\n", "candidates in [files] must be the name of a file, not 3"),
        ('files = "more.csv"\n', "files must be a table: write [files]"),
    ],
)
def test_the_table_of_candidates_is_named_rightly_or_told(
    wrong: Wrong, table: str, told: str
) -> None:
    (found,) = wrong(table + TARGET if table.startswith("files") else TARGET + table)
    assert found.startswith(f"wishes.toml: {told}")


def test_a_table_without_rows_is_named(wrong: Wrong) -> None:
    header = SIGHTS.splitlines()[0] + "\n"
    assert wrong(TARGET + TABLE, header) == ["more.csv: has a header, but no rows"]


# -- commands ----------------------------------------------------------------------------------


def test_plan_states_every_length_in_millimetres(command: Callable[..., Ran]) -> None:
    code, out, _ = command("plan", TARGET)
    lines = out.splitlines()
    assert code == 1
    (head,) = (n for n, line in enumerate(lines) if line.lstrip().startswith("point"))
    assert lines[head].split("  ")[-1] == "95 % semi-axis, mm"
    assert [f"σ{a}, mm" in lines[head] for a in "XYZ"] == [True] * 3
    table = {w[0]: float(w[-1]) for line in lines[head + 1 : head + 3] if (w := line.split())}
    assert "  target: 95 % semi-axis of the ellipse ≤ 2.2 mm: 2 fail" in lines
    listed = {w[0].rstrip(":"): w[1:] for line in lines[-2:] if (w := line.split())}
    assert set(listed) == set(table) == {"P1", "P2"}
    for name, (figure, unit) in listed.items():
        assert unit == "mm"
        assert float(figure) == pytest.approx(table[name], abs=0.006)


def test_plan_needs_targets_where_it_is_told_to_check_some(command: Callable[..., Ran]) -> None:
    code, _, err = command("plan", TAPE)
    assert code == 2
    assert "has no [[target]]" in err


def test_targets_that_cannot_be_met_end_with_1_and_what_can_be_had(
    command: Callable[..., Ran],
) -> None:
    code, out, err = command("propose", TARGET.replace("2.2", "0.1") + TAPE)
    assert (code, err) == (1, "")
    assert "cannot be met. The best that can be had, with the only candidate, cost 2:" in out
    best = command("propose", TARGET.replace("2.2", "0.1") + SET_UP + TABLE, SIGHTS)[1]
    assert "with all 2 candidates together, cost 7:" in best

    def figures(text: str) -> list[float]:
        return sorted(float(line.split()[1]) for line in text.splitlines()[-2:])

    assert all(a < b for a, b in zip(figures(best), figures(out), strict=True))
    assert command("propose", TARGET.replace("2.2", "-1") + TAPE)[0] == 2


@pytest.mark.parametrize(
    ("where", "code"), [("candidate 'tape'", 2), ("", 2), ("P1", 1), ("P2: semi-axis 3 > 2", 1)]
)
def test_only_what_is_wrong_with_points_and_observations_counts_as_unmet(
    command: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch, where: str, code: int
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise fga.InputError(Problem("is wrong", where))

    monkeypatch.setattr(cli_plan, "propose", refuse)
    found, out, err = command("propose", TARGET.replace("2.2", "2.1") + TAPE)
    assert found == code
    assert ("The targets cannot be met" in out) == (code == 1)
    assert ("is wrong" in err) == (code == 2)


def test_a_proposal_is_written_as_a_project_that_meets_its_targets(
    dam: Path, command: Callable[..., Ran]
) -> None:
    text = TARGET + 'points = "P*"\n' + SET_UP + TABLE
    code, out, _ = command("propose", text, SIGHTS, "--out", str(dam / "new"))
    assert code == 0
    assert str(dam / "new" / "project.toml") in out
    proposed = load_project(dam / "new").network
    assert len(proposed.observations) > len(OBSERVATIONS.splitlines()) - 1
    # The same file goes with the design that has what was proposed.
    assert main(["plan", str(dam / "new"), "--targets", str(dam / "wishes.toml")]) == 0
    assert main(["check", str(dam / "new")]) == 0


def test_a_proposal_does_not_take_the_place_of_the_design(
    dam: Path, command: Callable[..., Ran]
) -> None:
    before = {p.name: p.read_bytes() for p in dam.glob("[po]*")}
    for out in (dam, dam / "proposed.toml"):
        code, _, err = command("propose", TARGET + SET_UP + TABLE, SIGHTS, "--out", str(out))
        assert code == 2
        assert "--out must be in another folder than the design" in err
    assert {p.name: p.read_bytes() for p in dam.glob("[po]*")} == before


def test_check_hints_at_plan_where_only_readings_are_missing(
    dam: Path, command: Callable[..., Ran]
) -> None:
    code, _, err = command("check")
    assert code == 2
    assert "value is missing" in err
    assert "a design needs no readings for `factorgraph-adj plan`" in err
    assert "`factorgraph-adj serve` and `factorgraph-adj stream` take readings" in err
    read = OBSERVATIONS.replace("mm\n", "mm,value\n").replace(",1\n", ",1,70\n")
    (dam / "observations.csv").write_text(read.replace("B,P2,1,", "B,P2,0,"))
    code, _, err = command("check")
    assert code == 2
    assert "plan" not in err


@pytest.mark.parametrize("name", ["plan", "propose"])
def test_help_tells_the_exit_codes(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([name, "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "exit codes: 0 " in text
    assert "; 2 bad input" in text


@pytest.mark.slow(
    "whole proposals are compared with the cheapest ones; short tests take single steps of a plan"
)
def test_the_package_is_run_as_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "factorgraph_adj", "--help"],
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 0
    assert done.stdout.startswith("usage: factorgraph-adj ")


@pytest.mark.slow(
    "whole proposals are compared with the cheapest ones; short tests take single steps of a plan"
)
@pytest.mark.parametrize(
    "name", ["gallery_4_epochs", "gallery_6_planning", "gallery_7_monte_carlo"]
)
def test_the_gallery_draws_its_pictures_with_a_title(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    figure = pytest.importorskip("matplotlib.figure")
    saved: list[Any] = []
    repeat = runs.run
    monkeypatch.setattr(figure.Figure, "savefig", lambda f, path, **_: saved.append((f, path)))
    script, file = EXAMPLES / f"{name}.py", str(tmp_path / "picture.png")
    monkeypatch.setattr(sys, "argv", [str(script), "--plot", file])
    # Fewer repetitions than the script shows.
    monkeypatch.setattr(runs, "run", lambda e, n, **more: repeat(e, min(n, 4), **more))
    runpy.run_path(str(script), run_name="__main__")
    ((drawn, path),) = saved
    assert path == file
    axes = drawn.axes[0]
    assert any(axes.get_title(loc) for loc in ("left", "center", "right"))
    if name == "gallery_4_epochs":
        assert len(axes.containers) == 5
        assert all(c.has_yerr for c in axes.containers)
    else:
        assert f"\n{file}: " in capsys.readouterr().out
    if name == "gallery_6_planning":
        assert "up" in axes.get_ylabel()


# -- a whole file --------------------------------------------------------------------------------

WISHES = """
[[target]]
kind = "semi_axis"
at_most = 0.0022
[[candidate]]
name = "set-up C"
cost = 5
points = [{name = "C", x = 50, y = 120, z = 0}]
observations = [
  {kind = "slope_distance", station = "C", target = "A", sigma_mm = 1.0},
  {kind = "slope_distance", station = "C", target = "B", sigma_mm = 1.0},
  {kind = "slope_distance", station = "C", target = "P1", sigma_mm = 1.0},
  {kind = "slope_distance", station = "C", target = "P2", sigma_mm = 1.0},
  {kind = "height_difference", station = "A", target = "C", sigma_mm = 1.0},
]
[files]
candidates = "more.csv"
"""
MORE = """candidate,cost,kind,station,target,sigma_mm
tape,2,slope_distance,P1,P2,0.5
level,3,height_difference,B,P1,1
level,3,height_difference,P1,P2,1
"""


@pytest.fixture
def wished(dam: Path) -> Path:
    (dam / "wishes.toml").write_text(WISHES)
    (dam / "more.csv").write_text(MORE)
    return dam


def test_the_command_plans_without_readings(
    wished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", str(wished), "--targets", str(wished / "wishes.toml")]) == 1
    out = capsys.readouterr().out
    assert "6 observations, 6 unknowns, redundancy 0" in out
    assert "2 fail" in out
    assert main(["adjust", str(wished)]) == 2, "an adjustment needs them"


def test_the_command_proposes(wished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["propose", str(wished), str(wished / "wishes.toml")])
    out = capsys.readouterr().out
    assert code == 0, out
    assert "To be added, cost" in out
    assert ": met" in out


def test_the_command_tells_everything_that_is_wrong_with_a_file(
    wished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (wished / "wishes.toml").write_text(
        '[[target]]\nkind = "beauty"\n[[target]]\nkind = "semi_axis"\nat_mots = 1\n'
        '[[candidate]]\nname = "x"\nobservations = [{kind = "slope_distance", station = "A"}]\n'
        '[files]\ncandidates = "more.csv"\n'
    )
    (wished / "more.csv").write_text(
        MORE.replace("level,3,height_difference,P1", "level,4,height,P1")
    )
    assert main(["propose", str(wished), str(wished / "wishes.toml")]) == 2
    err = capsys.readouterr().err
    for part in ("'beauty'", "'at_mots'", "at_most is missing", "target is missing", "more.csv:4"):
        assert part in err
