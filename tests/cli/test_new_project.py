"""The command new makes a project of field files, says what it assumed, and asks in a terminal."""

from __future__ import annotations

import sys

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.cli.new_project import USUAL_ACCURACIES
from factorgraph_adj.io.field_books.accuracies import DEFAULT_ACCURACIES, Accuracies
from factorgraph_adj.stochastic_model import StandardDeviation
from tests.io.field_books import field_files
from tests.support.same import assert_same_network

FIXED = ",".join(field_files.KNOWN)


@pytest.fixture
def book(tmp_path):
    path = tmp_path / "book.gsi"
    path.write_text(field_files.gsi(), encoding="utf-8")
    return path


def test_the_project_is_the_network_of_the_files(tmp_path, book, capsys):
    site = tmp_path / "site"
    assert main(["new", str(site), str(book), "--set", f"fixed={FIXED}", "--yes"]) == 0
    assert_same_network(fga.read(site), fga.read(book, fixed=FIXED))
    said = capsys.readouterr().out
    assert f"held: {FIXED.replace(',', ', ')}" in said
    assert "no problems found" in said
    assert said.rstrip().endswith(f"next: factorgraph-adj adjust {site}")
    text = (site / "project.toml").read_text(encoding="utf-8")
    assert text.startswith("# Project of factorgraph-adj, made from book.gsi (Leica GSI")
    for name, (usual, _, kinds) in USUAL_ACCURACIES.items():
        if "height_difference" in kinds:
            assert name not in text
            continue
        assert f"#   {name} = {usual}  " in text
        assert f"assumed: {name} = {usual} (" in said


def test_what_is_stated_is_not_assumed(tmp_path, book, capsys):
    given = ["--set", "sigma_direction_mgon=0.3", "--set", "book.gsi:ppm=1"]
    arguments = ["new", str(tmp_path / "site"), str(book), *given[:2], "--yes"]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "sigma_direction_mgon" not in said
    assert "assumed: ppm" in said
    assert "nothing is held: the network is free; --set fixed=A,B" in said


def test_the_centring_of_readings_in_both_faces_is_zero_unless_stated(tmp_path, book, capsys):
    """As `Accuracies.centring` has it."""
    assert main(["new", str(tmp_path / "site"), str(book), "--set", "faces=both", "--yes"]) == 0
    assert "assumed: centring_mm = 0.0 (" in capsys.readouterr().out
    assert Accuracies(faces="both").centring == 0.0
    assert "#   centring_mm = 0.0  " in (tmp_path / "site" / "project.toml").read_text()


def test_usual_values_are_those_of_the_readers():
    """Of None in the class, its properties know the usual value."""
    a = DEFAULT_ACCURACIES
    for name, (usual, *_) in USUAL_ACCURACIES.items():
        stated = getattr(a, name)
        if stated is not None:
            assert stated == usual
    direction, distance = a.direction(None), a.distance(None)
    assert isinstance(direction, StandardDeviation)
    assert direction.constant == pytest.approx(usual_value("sigma_direction_mgon") * fga.GON / 1000)
    assert distance.constant == usual_value("sigma_distance_mm") / 1000
    assert a.centring == usual_value("centring_mm") / 1000


def usual_value(name):
    return USUAL_ACCURACIES[name][0]


def test_a_terminal_is_asked(tmp_path, book, monkeypatch, capsys):
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    asked = []

    def answer(question):
        asked.append(question)
        if question.startswith("points held"):
            return FIXED
        return "0.5" if "direction" in question else ""

    monkeypatch.setattr("builtins.input", answer)
    assert main(["new", str(tmp_path / "site"), str(book)]) == 0
    expected = fga.read(book, fixed=FIXED, sigma_direction_mgon=0.5)
    assert_same_network(fga.read(tmp_path / "site"), expected)
    assert len(asked) == len(USUAL_ACCURACIES) + 1
    assert "assumed: sigma_direction_mgon" not in capsys.readouterr().out


def test_a_project_is_not_overwritten_and_problems_write_nothing(tmp_path, book, capsys):
    site = tmp_path / "site"
    assert main(["new", str(site), str(tmp_path / "none.gsi")]) == 2
    assert main(["new", str(site), str(book), "--set", "fixed=nobody"]) == 2
    assert "there is no point 'nobody'" in capsys.readouterr().err
    assert not site.exists()
    assert main(["new", str(site), str(book), "--yes"]) == 0
    before = (site / "project.toml").read_bytes()
    assert main(["new", str(site), str(book), "--set", "ppm=9"]) == 2
    assert "is there already: name another folder" in capsys.readouterr().err
    assert (site / "project.toml").read_bytes() == before
    assert main(["new", str(book), str(book)]) == 2
    assert "is a file; valid: a folder that is made" in capsys.readouterr().err


def test_only_what_the_network_needs_is_assumed_and_control_of_a_list_stays(tmp_path, capsys):
    """A levelled table and a list of heights: bench marks are held in height alone."""
    (tmp_path / "lev.csv").write_text("von;bis;dH;Länge (km)\nA;B;1,2;0,31\nB;A;-1,2;0,28\n")
    (tmp_path / "h.csv").write_text("Punkt;Höhe;fest\nA;100,000;z\n")
    guess = ["--set", "mapping=guess"]
    files = [str(tmp_path / "lev.csv"), str(tmp_path / "h.csv")]
    assert main(["new", str(tmp_path / "site"), *files, *guess, "--yes"]) == 0
    said = capsys.readouterr().out
    assert "  held: A\n" in said
    assert [w for w in USUAL_ACCURACIES if f"assumed: {w} " in said] == ["sigma_levelling_mm"]
    network = fga.read(tmp_path / "site")
    assert network.points["A"].held == "xyz" and network.points["B"].held == "xy"
    assert fga.adjust(network).point("B")[2] == pytest.approx(101.2)
