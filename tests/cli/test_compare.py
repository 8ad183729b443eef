"""``compare``: files, exit codes, and what is refused before anything is read."""

from __future__ import annotations

import json

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from tests.networks import moved
from tests.networks.epochs import epoch
from tests.support.pages import data_of


@pytest.fixture(scope="module")
def epochs(tmp_path_factory):
    """The projects of two epochs: in the second one B, P and Q have moved."""
    folder = tmp_path_factory.mktemp("epochs")
    fga.write_project(epoch(20), folder / "first" / "project.toml")
    fga.write_project(epoch(21, moved.SHIFTS), folder / "second" / "project.toml")
    return [str(folder / "first"), str(folder / "second")]


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
def test_everything_is_written_by_one_run(epochs, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    files = {n: tmp_path / n for n in ("moved.png", "moved.html", "moved.gpkg", "moved.json")}
    options = ["--objects", "P,Q", "--block", "P,Q", "--date", "today", "--known-variance"]
    options += ["--plot", str(files["moved.png"]), "--report", str(files["moved.html"])]
    options += ["--export", str(files["moved.gpkg"]), "--export", str(files["moved.json"])]
    assert main(["compare", *epochs, *options, "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert said == (tmp_path / "out" / "epochs.txt").read_text(encoding="utf-8")
    assert "P, Q: the block moved, rigid" in said
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "epochs.txt",
        "displacements.csv",
        "results.json",
    }
    assert all(f.stat().st_size > 5000 for f in files.values())
    results = json.loads(files["moved.json"].read_text(encoding="utf-8"))
    assert results == json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    assert results["stable"] == list(moved.in_plan().stable)
    assert results["run"]["date"] == "today"
    for x in results["displacements"]:
        # The projects have observations with the digits of their files.
        own = moved.in_plan().displacement(x["name"])
        assert x["vector"] == pytest.approx(own.vector.tolist(), abs=2e-5)
    page = files["moved.html"].read_text(encoding="utf-8")
    listed = data_of(page, "sheet-files")["columns"][0]
    assert sum(f.endswith("observations.csv") for f in listed) == 2
    assert "--known-variance" in page


def test_the_exit_code_tells_doubt(epochs, tmp_path, capsys):
    fga.write_project(epoch(22, scale=3.0), tmp_path / "third" / "project.toml")
    assert main(["compare", epochs[0], str(tmp_path / "third")]) == 1
    assert "DO NOT AGREE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--language", "de"], "--language belongs to --report"),
        (["--report", "."], "--report must be a file, not a folder"),
        (["--plot", "moved.gif"], "valid: .png, .svg, .pdf"),
        (["--plot", "."], "--plot must be a file, not a folder"),
        (["--alpha", "0.9"], "--alpha 0.9 must be less than --power 0.8"),
        (["--export", "moved.ply"], "no displacements of two epochs"),
        (["--export", "moved.kml"], "the network has no reference system"),
        (["--export", "moved.gpkg", "--with", "binary=true"], "no exported format has the option"),
        (["--block", "A,X"], "point 'X'"),
        (["--block", "P"], "P does not determine the 3 parameters of a motion, rigid (tx, ty, rz)"),
        (["--block", "rigit:P,Q"], "unknown model 'rigit'; valid: rigid, similarity, affine"),
        (["--report", "moved.pdf"], "--report has no valid suffix; valid: .html"),
        (["--block", "affine:"], "points of a block must be a list of names"),
    ],
)
def test_wrong_options_are_refused_in_words(epochs, options, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", *epochs, "--objects", "P,Q", *options]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
