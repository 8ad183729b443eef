"""The command: exit codes, output files, and errors that are lists, never tracebacks."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from factorgraph_adj.cli import adjustment as cli_adjust
from factorgraph_adj.cli import command_line as cli
from factorgraph_adj.io.project_writer import write_project
from tests.networks.projects import OBSERVATIONS, POINTS, PROJECT, write
from tests.networks.small_block import small_block
from tests.support.command import FILES, Terminal, contents
from tests.support.places import data_dir
from tests.support.processes import HANGS

TEXT = {"encoding": "utf-8", "capture_output": True, "timeout": HANGS, "check": False}


def run(*arguments: object, **more: object) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "factorgraph_adj.cli.command_line", *map(str, arguments)]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8"}
    return subprocess.run(command, env=environment, **(TEXT | more))


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> Path:
    """The small block as a project."""
    path = tmp_path_factory.mktemp("block") / "project.toml"
    write_project(small_block(), path)
    return path


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
def test_a_good_project_ends_with_0_report_and_files(block, tmp_path):
    result = run("adjust", block, "--full", "--out", tmp_path / "out")
    assert (result.returncode, result.stderr) == (0, "")
    assert set(contents(tmp_path / "out")) == FILES
    assert result.stdout == (tmp_path / "out" / "report.txt").read_text(encoding="utf-8")
    assert "global test           accepted" in result.stdout
    assert json.loads((tmp_path / "out" / "results.json").read_bytes())["converged"] is True


def test_without_out_nothing_is_written(block, tmp_path, monkeypatch, here):
    monkeypatch.chdir(tmp_path)
    result = here("adjust", block)
    assert result.returncode == 0
    assert "the table points.csv (option --out)" not in result.stdout
    assert list(tmp_path.iterdir()) == []
    assert set(contents(block.parent)) == {
        *("project.toml", "points.csv", "photos.csv", "images.csv", "observations.csv"),
    }


def test_a_failed_global_test_ends_with_1_and_a_full_report(tmp_path, here):
    result = here("adjust", write(tmp_path), "--out", tmp_path / "out")
    assert result.returncode == 1
    assert "REJECTED" in result.stdout
    assert result.stderr.startswith("global test failed: σ̂0 = ")
    assert "report.txt" in contents(tmp_path / "out")


def test_an_adjustment_that_does_not_converge_ends_with_1(block, here):
    result = here("adjust", block, "--max-iterations", 1, "--quiet")
    assert result.returncode == 1
    assert result.stdout.startswith("doubtful result; σ̂0 ")
    assert len(result.stdout.splitlines()) == 1
    assert result.stderr.startswith("not converged: stopped after 1 iterations: the last step")


def test_bad_input_ends_with_2_a_list_and_no_output(tmp_path, here):
    path = write(
        tmp_path,
        points=POINTS.replace("C,5.01,8,1,", "C,5.01,8,?,"),
        observations=OBSERVATIONS.replace("2,B,C,9.487", "1,B,X,9.487"),
    )
    result = here("adjust", path, "--out", tmp_path / "out")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.splitlines() == [
        "2 problems:",
        "  points.csv:4: point 'C': z: '?' is not a number",
        "  observations.csv:3: slope_distance B X (id 1): unknown point 'X'; "
        "known: A, B, C, D, E, F",
    ]
    assert not (tmp_path / "out").exists()


def test_check_finds_the_same_problems_as_adjust(tmp_path, here):
    head, *rows = POINTS.replace(",xyz", ",").splitlines()
    path = write(tmp_path, points="\n".join([f"{head},datum", *rows, "G,1,2,3,,yes", ""]))
    checked, adjusted = here("check", path), here("adjust", path)
    assert (checked.returncode, adjusted.returncode) == (2, 2)
    assert checked.stderr == adjusted.stderr
    assert "points.csv:8: point 'G': no observation" in checked.stderr
    assert "no datum" in checked.stderr


def test_check_of_a_good_project_says_what_it_has(block, here):
    result = here("check", block.parent)
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout == (
        "small block: no problems found in 14 points, 4 photos, 48 image points and 48 other "
        "observations; approximate values are there\n"
    )


def test_a_free_network_can_be_asked_for(tmp_path, here):
    points = POINTS.replace(",xyz", ",")
    path = write(tmp_path, points=points)
    assert here("adjust", path, "--quiet").returncode == 2
    result = here("adjust", path, "--datum", "free", "--full")
    assert "free network: inner constraints" in result.stdout


def test_a_posteriori_precision_can_be_asked_for(block, here):
    result = here("adjust", block, "--variance", "a-posteriori", "--full")
    assert "a posteriori: multiplied by" in result.stdout


def test_what_the_observations_do_not_determine_ends_with_2(tmp_path, here):
    files = {
        "project.toml": 'name = "swing"\n[sigma.slope_distance]\nsigma_mm = 1\n',
        "points.csv": "name,x,y,z,fixed\nA,0,0,0,xyz\nB,9,0,0,\nC,5,5,0,\nD,5,3,4,\n",
        "observations.csv": "kind,station,target,value\n"
        + "".join(
            f"slope_distance,{a},{b},7\n"
            for a, b in ("AB", "AC", "AD", "BC", "BD", "CD", "BA", "CA", "DA")
        ),
    }
    result = here("adjust", write(tmp_path, files), "--out", tmp_path / "out")
    assert result.returncode == 2
    assert "datum defect 3: missing" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nowhere.toml", "nowhere.toml: no such file or folder"),
        ("list.xls", "list.xls: is of no known kind: text that begins with 'x'"),
    ],
)
def test_a_file_that_is_no_project_ends_with_2(tmp_path, name, expected, here):
    (tmp_path / "list.xls").write_text("x", encoding="utf-8")
    result = here("check", tmp_path / name)
    assert result.returncode == 2
    assert expected in result.stderr


def test_unknown_options_end_with_2(block, here):
    result = here("adjust", block, "--max-iterations", "0")
    assert result.returncode == 2
    assert "'0' is not a whole number from 1" in result.stderr


def test_gama_and_bundler_files_are_projects_too(tmp_path, here):
    gama = data_dir("gama_3d_networks") / "local_3d.gkf"
    assert here("adjust", gama, "--out", tmp_path).returncode == 0
    assert "points.csv" in contents(tmp_path)
    bundle = data_dir("bal") / "problem-49-7776-pre-shrink-1800.txt"
    assert "49 photos" in here("check", bundle).stdout


def test_output_that_is_no_folder_is_refused_before_adjusting(block, tmp_path, here):
    (tmp_path / "out").write_text("mine", encoding="utf-8")
    result = here("adjust", block, "--out", tmp_path / "out")
    assert (result.returncode, result.stdout) == (2, "")
    assert "out: --out must be a folder" in result.stderr
    assert (tmp_path / "out").read_text(encoding="utf-8") == "mine"


def test_a_second_run_replaces_the_files_of_the_first(block, tmp_path, here):
    assert here("adjust", block, "--out", tmp_path, "--quiet", "--date", "none").returncode == 0
    first = contents(tmp_path)
    (tmp_path / "points.csv").write_text("old", encoding="utf-8")
    assert here("adjust", block, "--out", tmp_path, "--quiet", "--date", "none").returncode == 0
    assert contents(tmp_path) == first


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_writing_that_fails_half_way_keeps_the_old_files(
    block, tmp_path, monkeypatch, capsys, error
):
    assert cli.main(["adjust", str(block), "--out", str(tmp_path), "--quiet"]) == 0
    for file in tmp_path.iterdir():
        file.write_text(f"old {file.name}", encoding="utf-8")
    before = contents(tmp_path)
    moved = []

    def fail_on_the_fourth(source, target, real=os.replace):
        moved.append(target)
        if len(moved) == 4:
            raise error
        real(source, target)

    monkeypatch.setattr("factorgraph_adj.io.file_transaction.os.replace", fail_on_the_fourth)
    code = cli.main(["adjust", str(block), "--out", str(tmp_path), "--quiet"])
    assert code == (130 if error is KeyboardInterrupt else 2)
    assert contents(tmp_path) == before
    assert len(capsys.readouterr().err.splitlines()) in (1, 2)


def test_an_interrupted_first_run_leaves_no_folder(block, tmp_path, monkeypatch, capsys):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("factorgraph_adj.io.file_transaction._move", interrupt)
    assert cli.main(["adjust", str(block), "--out", str(tmp_path / "out")]) == 130
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr() == ("", "interrupted: nothing was written\n")


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@pytest.mark.skipif(os.name == "nt", reason="SIGINT of another process needs POSIX")
def test_ctrl_c_ends_with_130_and_writes_nothing(block, tmp_path):
    waits = (
        "import sys\n"
        "from factorgraph_adj.cli import adjustment as command\n"
        "from factorgraph_adj.cli.command_line import main\n"
        "real = command.adjust\n"
        "def slow(network, *, progress, **options):\n"
        "    def wait(*figures):\n"
        "        print('ready', flush=True)\n"
        "        sys.stdin.read()\n"
        "    return real(network, progress=wait, **options)\n"
        "command.adjust = slow\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command = [sys.executable, "-c", waits, "adjust", str(block), "--out", str(tmp_path / "out")]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=HANGS)
    assert (process.returncode, out) == (130, "")
    assert err == "interrupted: nothing was written\n"
    assert not (tmp_path / "out").exists()


def test_a_fault_of_the_program_is_no_traceback(block, monkeypatch, capsys):
    def broken(*_, **__):
        raise ZeroDivisionError("by hand")

    monkeypatch.setattr(cli_adjust, "adjust", broken)
    assert cli.main(["adjust", str(block)]) == 3
    error = capsys.readouterr().err
    assert error.startswith("factorgraph-adj failed: ZeroDivisionError: by hand\n")
    monkeypatch.setenv("FACTORGRAPH_ADJ_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli.main(["adjust", str(block)])


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
def test_a_reader_that_stops_early_is_no_fault(block):
    command = f"{sys.executable} -m factorgraph_adj.cli.command_line adjust {block} | head -1"
    result = subprocess.run(command, shell=True, **TEXT)
    assert result.stdout == "Adjustment of small block\n"
    assert result.stderr == ""


@pytest.mark.parametrize("rich", [True, False])
def test_a_terminal_gets_progress_with_and_without_rich(block, monkeypatch, capsys, rich):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    if not rich:
        monkeypatch.setitem(sys.modules, "rich.console", None)
    assert cli.main(["adjust", str(block), "--quiet"]) == 0
    assert "vᵀPv" in terminal.getvalue() or rich
    assert terminal.getvalue() != ""


def test_problems_that_repeat_are_summed_up(tmp_path, here):
    rows = "".join(f"slope_distance,a{i},A,B,one,,\n" for i in range(250))
    folder = write(tmp_path, observations=OBSERVATIONS + rows)
    first = OBSERVATIONS.count("\n") + 1
    lines = here("check", folder).stderr.splitlines()
    assert lines[0] == "250 problems:"
    assert len(lines) == 5
    assert lines[-1] == (
        f"  and 247 more of this kind: observations.csv, lines {first + 3} to {first + 249}"
    )
    every = here("check", folder, "--all").stderr.splitlines()
    assert len(every) == 251
    assert f"observations.csv:{first + 249}:" in every[-1]


def test_names_of_problems_that_repeat_are_listed(tmp_path, here):
    rows = "".join(f"slope_distance,a{i},A,B,X{i % 20},,\n" for i in range(60))
    lines = here("check", write(tmp_path, observations=OBSERVATIONS + rows)).stderr.splitlines()
    assert lines[0] == "60 problems:"
    assert len(lines) == 5
    assert (
        "and 57 more of this kind ('X3', 'X4', 'X5', 'X6', 'X7', 'X8', … (20 in all))" in lines[-1]
    )


def test_problems_of_very_many_kinds_are_cut(tmp_path, here):
    words = [f"slope{chr(97 + i // 20)}{chr(97 + i % 20)}" for i in range(250)]
    header = "kind,id,station,target,value,sigma_mm," + ",".join(words)
    rows = header + "\nslope_distance,1,A,B,1,1," + "," * 249 + "\n"
    result = here("check", write(tmp_path, observations=rows))
    assert len(result.stderr.splitlines()) <= 202


def test_a_project_without_cameras_needs_no_photos(tmp_path, here):
    project = PROJECT[: PROJECT.index("[[camera]]")] + PROJECT[PROJECT.index("[sigma.slope") :]
    observations = OBSERVATIONS + "zenith_angle,15,A,E,94.0,,1\nzenith_angle,16,A,F,70.0,,1\n"
    observations += "direction,17,A,E,36,,1\ndirection,18,A,F,17,,1\n"
    files = {"project.toml": project, "points.csv": POINTS, "observations.csv": observations}
    result = here("adjust", write(tmp_path, files))
    assert result.returncode in (0, 1)
    assert "Photos" not in result.stdout
