"""``--leave-out-undetermined`` of the commands: what is left out is named, the rest as without."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli import adjustment as command
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.planning.targets import PointPrecision
from tests.networks.epochs import epoch
from tests.networks.well_determined import PLACES, distance, seen_once, well_determined

OPTION = "--leave-out-undetermined"


def project_of(network, folder):
    fga.write_project(network, folder / "project.toml")
    return str(folder)


@pytest.fixture
def loose(tmp_path):
    network = well_determined()
    seen_once(network, np.random.default_rng(1))
    return project_of(network, tmp_path / "loose")


def test_the_command_adjusts_once_and_keeps_the_result(loose, tmp_path, monkeypatch):
    kept = []
    original = command.adjust

    def counted(network, **options):
        solution = original(network, **options)
        kept.append(solution)
        return solution

    monkeypatch.setattr(command, "adjust", counted)
    assert main(["adjust", loose, OPTION, "--quiet", "--out", str(tmp_path / "out")]) == 0
    (solution,) = kept
    results = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert results["vtpv"] == solution.vtpv


@pytest.mark.parametrize("how", [["--snoop"], ["--robust", "huber"]])
def test_gross_errors_are_searched_for_in_the_determined_part(how, tmp_path, capsys):
    network = well_determined()
    seen_once(network, np.random.default_rng(1))
    network.add(fga.SlopeDistance("C", "P", 58.35, sigma=0.002, id="wrong"))
    project = project_of(network, tmp_path / "wrong")
    main(["adjust", project, OPTION, *how])
    told = capsys.readouterr().err
    assert "1 unknown left out with 1 observation: point X" in told
    assert "1 observation rejected" in told


def test_problems_of_other_kinds_are_still_refused(tmp_path, capsys):
    network, rng = fga.Network("no datum"), np.random.default_rng(2)
    for name in "ABCDX":
        network.add_point(name, PLACES[name])
    for pair in ("AB", "AC", "AD", "BC", "BD", "CD"):
        distance(network, *pair, rng)
    assert main(["adjust", project_of(network, tmp_path / "p"), OPTION]) == 2
    assert "no datum: nothing holds x, y, z" in capsys.readouterr().err


def test_a_plan_leaves_out_what_is_not_determined(loose, tmp_path, capsys):
    assert main(["plan", loose]) == 2
    assert OPTION in capsys.readouterr().err
    assert main(["plan", loose, OPTION]) == 0
    printed = capsys.readouterr()
    said = "1 unknown left out with 1 observation: point X"
    assert said in printed.err
    assert said in printed.out
    network, alone = fga.read_project(loose), fga.plan(well_determined())
    found = fga.plan(network, leave_out_undetermined=True)
    assert "1 undetermined unknown left out" in found.headline()
    for name in "PQ":
        expected = alone.solution.standard_deviations(name)
        assert found.solution.standard_deviations(name) == pytest.approx(expected, rel=1e-6)


def test_a_target_of_points_that_were_left_out_is_not_met_in_silence(loose):
    network = fga.read_project(loose)
    with pytest.raises(fga.InputError, match="X"):
        fga.plan(network, PointPrecision(1.0, points=("X",)), leave_out_undetermined=True)


def test_two_epochs_name_in_every_output_what_was_left_out(tmp_path, capsys):
    pytest.importorskip("jsonschema")
    first, second = epoch(20), epoch(21)
    for network in (first, second):
        network.add_point("X", (50.0, 50.0, 0.0), fixed="z")
        network.add(fga.HorizontalDistance("A", "X", 70.0, sigma=0.002))
    second.add_point("Y", (60.0, 50.0, 0.0), fixed="z")
    second.add(fga.HorizontalDistance("A", "Y", 78.0, sigma=0.002))
    first.add_point("Y", (60.0, 50.0, 0.0), fixed="z")
    for station in "ABC":
        length = float(np.hypot(*(np.array(first.points[station].coordinates) - (60, 50, 0))[:2]))
        first.add(fga.HorizontalDistance(station, "Y", length, sigma=0.002))
    projects = [project_of(first, tmp_path / "1"), project_of(second, tmp_path / "2")]
    assert main(["compare", *projects]) == 2
    assert OPTION in capsys.readouterr().err
    out, page = tmp_path / "out", tmp_path / "epochs.html"
    written = ["--out", str(out), "--report", str(page)]
    assert main(["compare", *projects, OPTION, *written]) == 0
    printed = capsys.readouterr()
    for said in ("first epoch: 1 unknown left out", "second epoch: 2 unknowns left out"):
        assert said in printed.err
        assert said in printed.out
        assert said in page.read_text(encoding="utf-8")
    assert "NOT compared, left out of the first epoch as undetermined: 1 point, X." in printed.out
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    named = [[x["name"] for x in a["unknowns_left_out"]] for a in results["adjustments"]]
    assert named == [["X"], ["Y", "X"]]
    reasons = {x["name"]: x["reason"] for x in results["not_compared"]}
    assert reasons["Y"] == "left out of the second epoch as undetermined"


CANDIDATES = """
[[target]]
kind = "point_precision"
at_most_mm = 1.5
points = ["P"]

[[candidate]]
name = "again"
cost = 1
observations = [{kind = "slope_distance", station = "A", target = "P", sigma_mm = 0.5}]
"""


def test_a_proposal_leaves_out_what_the_design_does_not_determine(loose, tmp_path, capsys):
    wishes = tmp_path / "wishes.toml"
    wishes.write_text(CANDIDATES, encoding="utf-8")
    assert main(["propose", loose, str(wishes)]) == 2
    assert "X" in capsys.readouterr().err
    code = main(["propose", loose, str(wishes), OPTION])
    told = capsys.readouterr()
    assert code in (0, 1)
    assert "1 unknown left out with 1 observation: point X" in told.err

    network = well_determined()
    seen_once(network, np.random.default_rng(1))
    target = PointPrecision(1.0, points=("P",))
    found = fga.propose(network, [], target, leave_out_undetermined=True)
    assert [x.name for x in found.plan.network.unknowns_left_out] == ["X"]
    with pytest.raises(InputError):  # it names nothing of what is left
        target = PointPrecision(1.0, points=("X",))
        fga.propose(network, [], target, leave_out_undetermined=True)
