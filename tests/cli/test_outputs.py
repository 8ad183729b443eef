"""No command writes over a file that it read, and outputs of one run are written all or none."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.main import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.atomic import PREFIX, one_transaction, write_files
from tests.networks.epochs import epoch


@pytest.fixture
def project(tmp_path):
    fga.write_project(epoch(1, datum="given"), tmp_path / "p" / "project.toml")
    fga.write_project(epoch(2, datum="given"), tmp_path / "q" / "project.toml")
    return tmp_path / "p"


def content(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    "command",
    [
        ["adjust", "p", "--out", "p"],
        ["adjust", "p/project.toml", "--out", "p"],
        ["adjust", "p", "--out", "q/../p", "--export", "new.json"],
        ["adjust", "p", "--export", "p/project.toml"],
        ["adjust", "p", "--export", "dxf:p/points.csv"],
        ["adjust", "p", "q", "--out", "q"],
        ["compare", "p", "q", "--export", "dxf:p/points.csv"],
        ["convert", "p", "p/project.toml"],
        ["convert", "p", "link/project.toml"],
        ["join", "p", "q", "q/project.toml"],
    ],
)
def test_no_command_writes_over_what_it_read(project, command, monkeypatch, capsys):
    monkeypatch.chdir(project.parent)
    Path("link").symlink_to("p", target_is_directory=True)
    before = content(project.parent)
    assert main(command) == 2
    assert content(project.parent) == before
    assert "was read, and would be written over" in capsys.readouterr().err


def test_the_message_names_every_file_that_would_be_replaced(project, capsys):
    assert main(["adjust", str(project), "--out", str(project)]) == 2
    said = capsys.readouterr().err
    for name in ("points.csv", "observations.csv"):
        assert f"{project / name}: was read, and would be written over" in said


def test_a_folder_below_the_project_is_written_again_and_again(project):
    for _ in range(2):
        assert main(["adjust", str(project), "--out", str(project / "result"), "--quiet"]) in (0, 1)


def test_outputs_of_a_transaction_are_all_written_or_none(tmp_path):
    for name in ("a", "b"):
        write_files(tmp_path / name, {"x.txt": "old"})
    with pytest.raises(RuntimeError), one_transaction():
        write_files(tmp_path / "a", {"x.txt": "new"})
        raise RuntimeError
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InputError), one_transaction():
        write_files(tmp_path / "a", {"x.txt": "new"})
        write_files(tmp_path / "new" / "one", {"x.txt": "new"})
        write_files(tmp_path / "file", {"x.txt": "new"})
    assert {p.read_text() for p in tmp_path.rglob("x.txt")} == {"old"}
    assert not (tmp_path / "new").exists()
    with one_transaction():
        write_files(tmp_path / "a", {"x.txt": "new"})
        write_files(tmp_path / "b", {"x.txt": "new"})
    assert {p.read_text() for p in tmp_path.rglob("x.txt")} == {"new"}


KILLED = """
import os, sys
from factorgraph_adj.io import atomic
calls = 0
def dying(call):
    def counted(*given):
        global calls
        calls += 1
        if calls > int(sys.argv[1]):
            os._exit(9)
        return call(*given)
    return counted
atomic.os.fsync = dying(os.fsync)
with atomic.one_transaction():
    for name in "abc":
        atomic.write_files(os.path.join(sys.argv[2], name), {"x.txt": "new"})
"""


@pytest.mark.parametrize("calls", range(4))
def test_a_killed_process_leaves_the_old_files_and_the_next_one_cleans_up(tmp_path, calls):
    """The process ends while it writes its first, second or third file, or not at all."""
    for name in "abc":
        write_files(tmp_path / name, {"x.txt": "old"})
    ran = [sys.executable, "-c", KILLED, str(calls), str(tmp_path)]
    done = subprocess.run(ran, env=dict(os.environ), check=False)
    assert done.returncode == (9 if calls < 3 else 0)
    left = {p.read_text() for p in tmp_path.glob("?/x.txt")}
    assert left == ({"old"} if calls < 3 else {"new"})
    for name in "abc":
        write_files(tmp_path / name, {"y.txt": "next"})
    assert not list(tmp_path.rglob(f"{PREFIX}*"))
