"""Protection levels in reports: text, page, CSV and results.json; the option of the command."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import jsonschema
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Write a levelling loop with a spur that nothing controls."""
    network = fga.Network("a loop and a spur")
    network.add_point("A", (0, 0, 100.0), fixed="xyz")
    for name, z in (("B", 101.0), ("C", 102.0), ("S", 103.0)):
        network.add_point(name, (0, 0, z), fixed="xy")
    for a, b, dz in (
        *(("A", "B", 1.0), ("B", "C", 1.0), ("A", "C", 2.0), ("C", "S", 1.0)),
        *(("A", "B", 1.0002), ("A", "C", 2.0001)),
    ):
        network.add(fga.HeightDifference(a, b, dz, sigma=1e-3))
    fga.write_project(network, tmp_path / "loop" / "project.toml")
    return tmp_path / "loop"


def test_all_renderings_have_the_levels(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, page = tmp_path / "out", tmp_path / "page.html"
    risk = ["--protection-levels", "0.01", "--faults", "1"]
    written = ["--out", str(out), "--report", str(page), "--language", "de"]
    assert main(["adjust", str(project), "--full", *risk, *written]) == 0
    levels = fga.protection_levels(fga.adjust(fga.read_project(project)), risk=0.01, faults=1)
    text = capsys.readouterr().out
    text = text[text.index("Adjusted coordinates") :]
    height = f"{1e3 * levels.level('B', 'vertical'):.2f}"
    line = next(x for x in text.splitlines() if x.split()[:1] == ["B"])
    assert height in line.split()
    line = next(x for x in text.splitlines() if x.split()[:1] == ["S"])
    assert line.endswith("∞")
    assert "with one gross error of any sizes" in " ".join(text.split())
    assert "largest L: S, ∞, by errors of" in " ".join(text.split())
    with (out / "points.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    written_mm = float(rows["B"]["protection_vertical_mm"])
    assert written_mm == pytest.approx(1e3 * levels.level("B", "vertical"), rel=1e-6)
    assert rows["S"]["protection_space_mm"] == ""
    assert rows["S"]["protection_weakest"] == "4"
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    jsonschema.validate(results, fga.results_schema())
    found = results["points"]["S"]["protection"]
    assert found["space"] is None
    assert found["weakest"] == ["4"]
    assert found["accepted"]
    assert "Schutzniveau" in page.read_text(encoding="utf-8")


def test_reports_that_do_not_ask_have_none(project: Path, tmp_path: Path) -> None:
    assert main(["adjust", str(project), "--quiet", "--out", str(tmp_path / "out")]) == 0
    assert "protection" not in (tmp_path / "out" / "points.csv").read_text(encoding="utf-8")
    assert "protection" not in (tmp_path / "out" / "results.json").read_text(encoding="utf-8")


def test_after_snooping_the_report_says_so(
    project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["adjust", str(project), "--full", "--snoop", "--protection-levels", "0.01"]) == 0
    assert "whatever data snooping rejects" in " ".join(capsys.readouterr().out.split())


def test_an_estimated_sigma0_is_refused_before_anything_is_written(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["adjust", str(project), "--variance", "a-posteriori", "--out", str(tmp_path / "o")]
    assert main([*command, "--protection-levels", "0.01"]) != 0
    assert "no protection levels with an estimated σ0" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
