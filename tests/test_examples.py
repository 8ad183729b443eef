"""Every example is run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from factorgraph_adj.cli.main import main
from tests.support.places import EXAMPLES
from tests.support.processes import HANGS

README = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")
SHOWN = dict(re.findall(r"^\| \[(gallery_\S+\.py)\].*\| `(.*)` \|$", README, re.MULTILINE))
"""A line of the output of each script of the gallery, as the README shows it."""
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
PROJECTS = sorted(EXAMPLES.glob("*/project.toml"))


def run(script: Path, *arguments: str) -> str:
    """Run a script as a user does and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), *arguments],
        capture_output=True,
        encoding="utf-8",
        env=os.environ | {"PYTHONIOENCODING": "utf-8"},
        timeout=HANGS,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_every_script_runs_and_prints_what_the_readme_shows(script: Path, tmp_path: Path) -> None:
    arguments = [str(tmp_path)] if script.stem.startswith("make_") else []
    printed = " ".join(run(script, *arguments).split())
    assert printed
    if script.stem.startswith("gallery_"):
        assert " ".join(SHOWN[script.name].split()) in printed


def test_the_gallery_is_short_and_its_pictures_are_there() -> None:
    gallery = [p for p in SCRIPTS if p.stem.startswith("gallery_")]
    assert len(gallery) == len(SHOWN) == 8
    for script in gallery:
        assert len(script.read_text(encoding="utf-8").splitlines()) < 80
    pictures = re.findall(r"!\[[^]]+\]\((examples/pictures/[^)]+)\)", README)
    assert len(pictures) >= 8
    assert all((EXAMPLES.parent / p).is_file() for p in pictures)


@pytest.mark.parametrize("project", PROJECTS, ids=lambda p: p.parent.name)
def test_every_project_is_adjusted_by_the_command(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(project)]) == 0
    assert main(["adjust", str(project), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "converged" in printed
    assert (tmp_path / "out" / "solution.json").is_file()


def test_there_is_the_industry_block_as_script_and_as_project() -> None:
    assert EXAMPLES / "industry_block.py" in SCRIPTS
    assert EXAMPLES / "industry_block" / "project.toml" in PROJECTS


def test_the_project_on_disk_is_what_its_script_writes(tmp_path: Path) -> None:
    run(EXAMPLES / "make_industry_block.py", str(tmp_path))
    written = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    kept = {p.name: p.read_bytes() for p in (EXAMPLES / "industry_block").iterdir()}
    assert written == kept


def test_the_combined_block_of_the_readme_is_better_than_photos_alone() -> None:
    """The last two lines of the example: half the σ, and errors that match it."""
    lines = run(EXAMPLES / "industry_block.py").splitlines()[-2:]
    (sigma, rms), (sigma_alone, rms_alone) = (
        [float(w) for w in line.replace(",", "").split() if w.replace(".", "").isdigit()]
        for line in lines
    )
    assert sigma < 0.6 * sigma_alone
    assert rms < 2 * sigma
    assert rms < rms_alone


def test_the_measured_day_catches_its_three_gross_errors_on_arrival_and_nothing_else(
    tmp_path: Path,
) -> None:
    """The batch has them last of all, with others that they spoil above the critical value."""
    pytest.importorskip("matplotlib")
    picture = tmp_path / "growth.png"
    text = run(EXAMPLES / "measured_day.py", "--plot", str(picture))
    planted, day, batch = text.split("\n\n")[:3]
    made = [line.split()[:3] for line in planted.splitlines()[1:]]
    assert [kind for kind, *_ in made] == ["direction", "slope_distance", "image"]
    rejected = [line for line in day.splitlines() if "rejected" in line]
    assert [line.split(": ")[1].split()[:3] for line in rejected] == made
    sizes = [float(line.split("error ")[1].split()[0]) for line in rejected]
    sigmas = [float(line.split("± ")[1].split()[0]) for line in rejected]
    for size, sigma, true in zip(sizes, sigmas, (60.0, 10.0, 0.08), strict=True):
        assert abs(size - true) < 3 * sigma + 0.005
    found = [line.split() for line in batch.splitlines()[1:]]
    large = [words[2:5] for words in found if abs(float(words[1])) > 3.29]
    assert all(m in large for m in made)
    assert len(large) > 3
    assert picture.stat().st_size > 10_000
