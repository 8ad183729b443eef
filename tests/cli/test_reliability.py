"""The command: gross errors, weights, ellipses, figures; options and exit codes."""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from factorgraph_adj.cli import adjustment as cli_adjust
from factorgraph_adj.cli import command_line as cli
from factorgraph_adj.io.project_writer import write_project
from factorgraph_adj.quality.rejections import Unresolved
from tests.networks.small_block import blundered, small_block
from tests.support.command import FILES, Terminal, contents
from tests.support.places import data_dir

LONG = pytest.mark.slow(
    "options that reach data snooping and its report; short tests print the tables"
)

TWO_ASIDE = "2 observations rejected, the first: observations.csv:4: slope_distance S1 P1 (id 3)\n"


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> Path:
    """The small block as a project."""
    path = tmp_path_factory.mktemp("block") / "project.toml"
    write_project(small_block(), path)
    return path


@pytest.fixture(scope="module")
def wrong(tmp_path_factory) -> Path:
    """The small block with two gross errors as a project."""
    path = tmp_path_factory.mktemp("wrong") / "project.toml"
    write_project(blundered(), path)
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_version_is_that_of_the_package(here):
    from importlib.metadata import version

    result = here("--version")
    assert result.returncode == 0
    assert result.stdout == f"factorgraph-adj {version('factorgraph_adj')}\n"


# -- gross errors ---------------------------------------------------------------------------------


def test_gross_errors_without_snooping_fail_the_global_test(wrong, here):
    result = here("adjust", wrong, "--full")
    assert result.returncode == 1
    assert "Suspects: |w| above 3.29" in result.stdout
    assert "--snoop" in result.stdout
    assert "global test failed" in result.stderr


def test_snooping_sets_them_aside_and_ends_with_0(wrong, tmp_path, here):
    result = here("adjust", wrong, "--full", "--snoop", "--out", tmp_path)
    assert (result.returncode, result.stderr) == (0, TWO_ASIDE)
    assert "2 observations rejected in" in result.stdout
    assert "global test           accepted" in result.stdout
    assert set(contents(tmp_path)) == FILES | {"snooping.csv"}
    rows = rows_of(tmp_path / "snooping.csv")
    assert [r["state"] for r in rows] == ["rejected"] * 2
    assert all(r["source"] for r in rows)
    aside = [r for r in rows_of(tmp_path / "observations.csv") if r["set_aside"] == "yes"]
    assert {r["id"] for r in aside} == {r["id"] for r in rows}
    found = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert len(found["snooping"]["rejected"]) == 2


def test_nothing_to_set_aside_says_nothing_on_stderr(block, here):
    result = here("adjust", block, "--full", "--snoop")
    assert (result.returncode, result.stderr) == (0, "")
    assert "nothing rejected in 1 round" in result.stdout


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@pytest.mark.parametrize("estimator", ["huber", "danish", "igg3", "tukey"])
def test_a_robust_start_implies_snooping(wrong, estimator, here):
    result = here("adjust", wrong, "--full", "--robust", estimator)
    assert (result.returncode, result.stderr) == (0, TWO_ASIDE)
    assert "after a robust start" in result.stdout
    assert "  robust  " in result.stdout


@LONG
def test_alpha_test_and_power_reach_snooping_and_report(wrong, here):
    result = here("adjust", wrong, "--full", "--snoop", "--alpha", 0.0001, "--power", 0.9)
    assert "critical |w| 3.89" in result.stdout
    assert "Reliability (α0 = 0.01 %, power 90 %: δ0 = 5.17)" in result.stdout
    result = here("adjust", wrong, "--full", "--snoop", "--test", "pope")
    assert "Data snooping (Pope's τ, critical |τ|" in result.stdout
    assert "none above the critical |τ|" in result.stdout
    result = here("adjust", wrong, "--full", "--snoop", "--variance", "a-posteriori")
    assert "Pope's τ" in result.stdout
    assert "a posteriori: multiplied by" in result.stdout
    assert "Suspects: |τ| above" in here("adjust", wrong, "--full", "--test", "pope").stdout


def test_sidak_shares_alpha_among_all_tests(block, here):
    result = here("adjust", block, "--full", "--snoop", "--alpha", 0.05, "--sidak")
    n = 147
    alpha = 1 - 0.95 ** (1 / n)
    assert f"α0 = {100 * alpha:.6g} %" in result.stdout


def test_what_cannot_be_set_aside_ends_with_1(block, monkeypatch, here):
    real = cli_adjust.snoop

    def unresolved(*arguments, **options):
        found = real(*arguments, **options)
        first = found.solution.observations[0]
        left = Unresolved(first.id, first.kind, "?", first.component, 4.0, 0.01, "by hand")
        return replace(found, unresolved=(left,))

    monkeypatch.setattr(cli_adjust, "snoop", unresolved)
    result = here("adjust", block, "--full", "--snoop")
    assert result.returncode == 1
    assert "UNRESOLVED" in result.stdout
    assert result.stderr == "1 observation above the critical value could not be rejected\n"


def test_published_gross_errors_are_found_by_the_command(here, tmp_path):
    """Ghilani, example 21.1: distance 3-4, then the angle at 103 from 102 to 1."""
    result = here(
        "adjust", data_dir("krumm_textbook") / "Ghilani21_1.gkf", "--snoop", "--out", tmp_path
    )
    assert (result.returncode, result.stderr) == (
        0,
        f"{TWO_ASIDE.partition(',')[0]}, the first: Ghilani21_1.gkf:44: horizontal_distance 3 4\n",
    )
    rows = rows_of(tmp_path / "snooping.csv")
    assert [(r["station"], r["target"], r.get("target2", "")) for r in rows] == [
        ("3", "4", ""),
        ("103", "102", "1"),
    ]
    assert abs(float(rows[0]["test_value"])) == pytest.approx(1802.59, abs=0.005)
    assert abs(float(rows[1]["test_value"])) == pytest.approx(110.40, abs=0.005)


# -- weights, ellipses, lists ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "group"),
    [((), "image"), (("camera",), "camera D3"), (("instrument",), "camera D3")],
)
def test_variance_components_have_a_section_and_a_table(block, tmp_path, here, arguments, group):
    result = here("adjust", block, "--full", "--variance-components", *arguments, "--out", tmp_path)
    assert result.returncode == 0
    assert "Variance components" in result.stdout
    assert "σ estimated" in result.stdout
    assert set(contents(tmp_path)) == FILES | {"variance_components.csv"}
    groups = [r["group"] for r in rows_of(tmp_path / "variance_components.csv")]
    assert group in groups


def test_variance_components_come_after_snooping(wrong, here):
    result = here("adjust", wrong, "--full", "--snoop", "--variance-components")
    assert (result.returncode, result.stderr) == (0, TWO_ASIDE)
    assert result.stdout.index("Data snooping") < result.stdout.index("Variance components")


def test_variance_components_that_do_not_come_to_rest_end_with_1(block, monkeypatch, here):
    real = cli_adjust.estimate_variance_components
    monkeypatch.setattr(
        cli_adjust,
        "estimate_variance_components",
        lambda *a, **k: real(*a, **(k | {"max_iterations": 1})),
    )
    result = here("adjust", block, "--variance-components", "--quiet")
    assert result.returncode == 1
    assert "variance components not converged: stopped after 1 adjustments" in result.stderr


def test_ellipses_stand_in_report_and_tables(block, tmp_path, here):
    result = here("adjust", block, "--full", "--ellipses", 0.95, "--out", tmp_path)
    assert "95 % error ellipses" in result.stdout
    assert "Projection centres: 95 % error ellipsoids" in result.stdout
    assert rows_of(tmp_path / "points.csv")[0]["confidence"] == "0.95"
    assert "ellipse" not in here("adjust", block, "--full").stdout


def test_rows_is_the_length_of_the_list_of_test_values_too(block, here):
    def listed(*options: object) -> int:
        text = here("adjust", block, "--full", *options).stdout.partition("Largest test values")[2]
        return sum(line.startswith("  image") or line[2:3] in "dshz" for line in text.splitlines())

    assert listed("--rows", 4) < listed() < listed("--rows", 30)


# -- bad options ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--alpha", "0"), "'0' is not a probability between 0 and 1, such as 0.95"),
        (("--alpha", "five"), "'five' is not a probability"),
        (("--power", "1"), "'1' is not a probability"),
        (("--ellipses", "95"), "'95' is not a probability"),
        (("--ellipses", "nan"), "'nan' is not a probability"),
        (("--alpha", "0.9"), "--alpha 0.9 must be less than --power 0.8"),
        (("--sidak",), "--sidak belongs to --snoop"),
        (("--test", "tau"), "invalid choice: 'tau'"),
        (("--robust", "median"), "invalid choice: 'median'"),
        (("--variance-components", "stations"), "invalid choice: 'stations'"),
    ],
)
def test_bad_options_end_with_2_and_say_why(block, here, options, message):
    result = here("adjust", block, "--full", *options)
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr


def test_bad_options_are_found_before_anything_is_read(here):
    result = here("adjust", "nowhere.toml", "--alpha", 0.9, "--sidak")
    assert result.stderr.splitlines() == [
        "2 problems:",
        "  --alpha 0.9 must be less than --power 0.8",
        "  --sidak belongs to --snoop",
    ]


# -- plot -----------------------------------------------------------------------------------------


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@pytest.mark.parametrize("kind", ["png", "svg"])
def test_figures_are_written_and_named(block, tmp_path, here, kind):
    pytest.importorskip("matplotlib")
    result = here("plot", block, "--out", tmp_path, "--format", kind)
    assert (result.returncode, result.stderr) == (0, "")
    files = [Path(line) for line in result.stdout.splitlines()]
    assert tmp_path / f"network.{kind}" in files
    assert {f.name for f in files} == {f.name for f in tmp_path.iterdir()}
    assert all(f.stat().st_size > 1000 for f in files)


def test_figures_are_those_of_the_clean_network_where_that_is_asked_for(
    wrong, tmp_path, here, monkeypatch
):
    pytest.importorskip("matplotlib")
    seen = {}

    def save(solution, folder, **options):
        seen.update(options, n=solution.n_observations)
        return [Path(folder) / "network.png"]

    monkeypatch.setattr("factorgraph_adj.report.plots.save_plots", save)
    result = here("plot", wrong, "--out", tmp_path, "--snoop", "--ellipses", 0.5)
    assert (result.returncode, result.stderr) == (0, TWO_ASIDE)
    assert seen["n"] == 147 - 3  # a distance, an image point
    assert seen["confidence"] == 0.5
    assert seen["reliability"] is not None


def test_without_matplotlib_plot_says_what_to_install(block, tmp_path, here, monkeypatch):
    monkeypatch.setattr(cli_adjust, "find_spec", lambda name: None)
    result = here("plot", block, "--out", tmp_path / "out")
    assert (result.returncode, result.stdout) == (2, "")
    assert 'plots need matplotlib, which is not installed: pip install "factorgraph_adj[plot]"' in (
        result.stderr
    )
    assert not (tmp_path / "out").exists()


def test_plot_needs_a_folder_and_a_format_it_knows(block, tmp_path, here):
    assert here("plot", block).returncode == 2
    result = here("plot", block, "--out", tmp_path, "--format", "bmp")
    assert result.returncode == 2
    assert "invalid choice: 'bmp'" in result.stderr
    (tmp_path / "file").write_text("x", encoding="utf-8")
    result = here("plot", block, "--out", tmp_path / "file")
    assert "--out must be a folder" in result.stderr


def test_a_terminal_sees_the_rounds(wrong, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setitem(sys.modules, "rich.console", None)
    assert cli.main(["adjust", str(wrong), "--quiet", "--snoop"]) == 0
    assert "round 1: " in terminal.getvalue()
