"""Every example is run."""

from __future__ import annotations

import contextlib
import io
import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from factorgraph_adj.cli.command_line import main
from tests.support.places import EXAMPLES, ROOT
from tests.support.processes import HANGS

SHOWN = {
    "gallery_1_distances": "1 1105.3150 2290.1222 1.88 1.76 6.65 × 4.90 57.3",
    "gallery_2_directions": "refraction κ 0.168 ± 0.014 (true: 0.17)",
    "gallery_3_combined": "and photos 1291 1041 0.971 0.29 0.30 0.17 0.30 0.30 0.22",
    "gallery_4_epochs": "rejected s4: B-W5@4: error 6.8 mm, w -6.4",
    "gallery_epochs_dam": "D3 5.72 9.28 ± 0.43 | 5.72 9.28 ± 0.43 mm moved",
    "gallery_5_reliability": "round 1: r 2-3 w -9.7, error +13.3 ± 1.3 mgon (made: +12.0 mgon)",
    "gallery_6_planning": "station S3 40 min, then lacking 0.00",
    "gallery_stretched_wire": "rejected: wire 3",
    "gallery_camera_rig": "rejected: 3 right on 3 position, error 5.0 mm, w -5.5",
    "gallery_colmap": "arm z: 28.36 ± 1.31 mm (true: 30)",
    "gallery_7_monte_carlo": "150 distances instead of 35: 0.403 ± 0.043 mm less",
    "gallery_images_alone": "mismatches: 87, named: 87, others: 0",
    "gallery_9_parts": "Σr of office 2: 72.12 of 153 observations",
    "gallery_tank": "the axis of the wall leans by 2.32 mm/m against the floor (true: 2.24)",
    "gallery_independent_models": "pairs, film unknown 710 345 1.50 5.3 9.6 17.6",
    "gallery_gnss_ins_block": "missing shift in x, shift in y, shift in z observed coordinates do "
    "not hold it: free shift of drift 'strip 0', drift 'strip 1', drift 'strip 2'",
    "gallery_grid_coordinates": "E 250 km, scale +368 ppm: c 99.9651 ± 0.0018 100.0002 ± 0.0018",
    "gallery_two_faces": "rejected: zenith_angle S C, error 8.1 mgon, w -7.5 doubts that are "
    "left: 0",
    "gallery_shapes_in_plan": "radius of the ball: 0.9994 ± 0.0003 m",
    "gallery_trackers": "frame_direction in T2: σ × 3.50 ± 0.47",
    "gallery_statoscope_and_lake": "rejected: profile_height 22 (id statoscope 22), error 5.5 m, "
    "w -16.0",
    "gallery_8_gtsam": "P σx, mm 1.192026 1.192026",
}
"""A line of the output of each script of the gallery."""
SCRIPTS = sorted(p for p in EXAMPLES.glob("*.py") if p.stem != "__init__")
ALONE = (
    "gallery_grid_coordinates",
    "gallery_8_gtsam",
    "gallery_9_parts",
    "gallery_epochs_dam",
    "gallery_shapes_in_plan",
    "gallery_tank",
    "gallery_trackers",
    "gallery_statoscope_and_lake",
    "gallery_two_faces",
    "industry_block",
    "make_industry_block",
)
"""Scripts that run in a process of their own, as a user runs them."""
QUICK = ("gallery_two_faces", "make_industry_block")
"""Scripts that run and draw in the short tests."""
LONG = pytest.mark.slow(
    "the scripts that compute tables and pictures for many; what they call has tests of its own, "
    "and the quick ones show that scripts run and draw at all"
)
SHOWN_BELOW = ("measured_day",)
"""Scripts that another test runs and looks at."""
PROJECTS = sorted(EXAMPLES.glob("*/project.toml"))


def run(script: Path, *arguments: str) -> str:
    """Run a script in a process of its own, as a user does, and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", f"examples.{script.stem}", *arguments],
        capture_output=True,
        encoding="utf-8",
        env=os.environ | {"PYTHONIOENCODING": "utf-8"},
        timeout=HANGS,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_here(script: Path, *arguments: str) -> str:
    """Run a script in this process, which has imported what it needs; return what it prints."""
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
        patch.setattr(sys, "argv", [str(script), *arguments])
        runpy.run_path(str(script), run_name="__main__")
    return out.getvalue()


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(s, marks=() if s.stem in QUICK else LONG)
        for s in SCRIPTS
        if s.stem not in SHOWN_BELOW
    ],
    ids=lambda p: p.stem,
)
def test_every_script_runs_and_draws_its_picture(script: Path, tmp_path: Path) -> None:
    """The documentation shows what they print and draw."""
    draws = '"--plot"' in script.read_text(encoding="utf-8")
    picture = tmp_path / "picture.png"
    arguments = ["--plot", str(picture)] if draws else []
    if script.stem.startswith("make_"):
        arguments = [str(tmp_path)]
    if draws:
        pytest.importorskip("matplotlib")
    run_it = run if script.stem in ALONE else run_here
    printed = " ".join(run_it(script, *arguments).split())
    assert printed
    assert SHOWN.get(script.stem, "") in printed
    assert not draws or picture.stat().st_size > 5_000


def test_the_gallery_is_short_and_has_titles() -> None:
    gallery = [p for p in SCRIPTS if p.stem.startswith("gallery_")]
    assert {p.stem for p in gallery} == set(SHOWN)
    for script in gallery:
        lines = script.read_text(encoding="utf-8").splitlines()
        assert len(lines) < 80
        assert lines[1] == "=" * len(lines[0].removeprefix('"""'))


@pytest.mark.parametrize("project", PROJECTS, ids=lambda p: p.parent.name)
def test_every_project_is_adjusted_by_the_command(
    project: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check", str(project)]) == 0
    assert main(["adjust", str(project), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "converged" in printed
    assert (tmp_path / "out" / "results.json").is_file()


def test_there_is_the_industry_block_as_script_and_as_project() -> None:
    assert EXAMPLES / "industry_block.py" in SCRIPTS
    assert EXAMPLES / "industry_block" / "project.toml" in PROJECTS


def test_the_project_on_disk_is_what_its_script_writes(tmp_path: Path) -> None:
    run_here(EXAMPLES / "make_industry_block.py", str(tmp_path))
    written = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    kept = {p.name: p.read_bytes() for p in (EXAMPLES / "industry_block").iterdir()}
    assert written == kept


def test_the_combined_block_of_the_readme_is_better_than_photos_alone() -> None:
    """The last two lines of the example: half the σ, and errors that match it."""
    lines = run_here(EXAMPLES / "industry_block.py").splitlines()[-2:]
    (sigma, rms), (sigma_alone, rms_alone) = (
        [float(w) for w in line.replace(",", "").split() if w.replace(".", "").isdigit()]
        for line in lines
    )
    assert sigma < 0.6 * sigma_alone
    assert rms < 2 * sigma
    assert rms < rms_alone


@pytest.mark.slow("a day of real readings; the loader of the day has a short test of its own")
def test_the_measured_day_catches_its_three_gross_errors_on_arrival_and_nothing_else(
    tmp_path: Path,
) -> None:
    """The batch has them last of all, with others that they spoil above the critical value."""
    pytest.importorskip("matplotlib")
    picture = tmp_path / "growth.png"
    text = run_here(EXAMPLES / "measured_day.py", "--plot", str(picture))
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
