"""No command writes over a file that it read, and outputs of one run are written all or none."""

from __future__ import annotations

import io
import json
import os
import socket
import sqlite3
import subprocess
import sys
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.files import keeping_inputs, read_bytes
from factorgraph_adj.io.file_transaction import one_transaction, write_files
from factorgraph_adj.io.journal import Journal
from factorgraph_adj.io.transaction_folders import (
    LIST,
    MOVE_MARK,
    OLD_FILES,
    WRITING_PREFIX,
    UnfinishedError,
)
from tests.networks.epochs import epoch

LONG = pytest.mark.slow(
    "a process killed at each step of its outputs; short tests let single steps fail"
)


@pytest.fixture
def project(tmp_path):
    fga.write_project(epoch(1, datum="given"), tmp_path / "p" / "project.toml")
    fga.write_project(epoch(2, datum="given"), tmp_path / "q" / "project.toml")
    return tmp_path / "p"


WISHES = """[[target]]
kind = "semi_axis"
at_most_mm = 1000
[[candidate]]
name = "a tape"
observations = [{kind = "slope_distance", station = "A", target = "C", sigma_mm = 1}]
"""
MODEL = {
    "cameras.txt": "1 SIMPLE_PINHOLE 100 80 100 50 40\n",
    "images.txt": """7 1 0 0 0 0 0 0 1 a.jpg
50 40 3 60.5 40 4 10 10 -1
2 0 1 0 0 0 0 10 1 c.jpg
50 40 3 40 40.5 4
""",
    "points3D.txt": "3 0 0 5 255 0 0 0.1 7 0 2 0\n4 0.5 0 5 0 0 0 0.2 7 1 2 1\n",
}


@pytest.fixture
def others(project):
    """More inputs: a project with a table elsewhere, wishes, and a COLMAP model with a database."""
    folder = project.parent
    for name in ("wide", "wishes", "block"):
        (folder / name).mkdir()
    for name in ("project.toml", "observations.csv"):
        text = (project / name).read_text()
        (folder / "wide" / name).write_text(text.replace('"points.csv"', '"../p/points.csv"'))
    (folder / "wishes" / "project.toml").write_text(WISHES)
    for name, text in MODEL.items():
        (folder / "block" / name).write_text(text)
    with closing(sqlite3.connect(folder / "block.db")) as database, database:
        database.execute("CREATE TABLE images (image_id, name)")
        database.execute("CREATE TABLE keypoints (image_id, rows, cols, data)")
        for number, name, rows in ((7, "a.jpg", 3), (2, "c.jpg", 2)):
            data = np.ones((rows, 4), dtype="<f4").tobytes()
            database.execute("INSERT INTO images VALUES (?, ?)", (number, name))
            database.execute("INSERT INTO keypoints VALUES (?, ?, 4, ?)", (number, rows, data))
    (folder / "block.db-wal").touch()  # empty, as a program leaves it that has the database open
    return folder


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


SCALES = ("adjust", "block", "--set", "sigma_by_scale=block.db")


@pytest.mark.parametrize(
    "command",
    [
        ["propose", "p", "wishes/project.toml", "--out", "wishes"],
        ["propose", "wide", "wishes/project.toml", "--out", "p/new.toml", "--allow-outside"],
        ["adjust", "wide", "--out", "p", "--allow-outside"],
        [*SCALES, "--export", "ply:block.db"],
        [*SCALES, "--export", "ply:block.db-wal"],
        [*SCALES, "--out", "block", "--export", "ply:block/points3D.txt"],
    ],
)
def test_no_command_writes_over_other_inputs(others, command, monkeypatch, capsys):
    monkeypatch.chdir(others)
    before = content(others)
    assert main(command) == 2
    assert content(others) == before
    said = capsys.readouterr()
    assert "was read, and would be written over" in said.err
    assert said.out == ""  # before anything is computed


def streamed(monkeypatch, *command, lines):
    """Run the stream with lines on standard input; return the exit code."""
    given = io.TextIOWrapper(io.BytesIO("".join(f"{json.dumps(x)}\n" for x in lines).encode()))
    monkeypatch.setattr(sys, "stdin", given)
    return main(["stream", *command])


@pytest.mark.parametrize("resume", [[], ["--resume"]], ids=["begun", "resumed"])
def test_a_stream_writes_over_neither_its_journal_nor_its_project(
    project, resume, monkeypatch, capfd
):
    """The journal has a name that a table of the project that is written has."""
    monkeypatch.chdir(project.parent)
    journal = ["p", "--journal", "points.csv"]
    if resume:
        assert streamed(monkeypatch, *journal, lines=[]) == 0
    before = content(project)
    lines = [{"do": "write", "project": name, "overwrite": True} for name in (".", "p", "new")]
    assert streamed(monkeypatch, *journal, *resume, lines=lines) == 0
    assert content(project) == before
    assert Path("points.csv").read_text().startswith('{"journal"')
    answers = [json.loads(line) for line in capfd.readouterr().out.splitlines()][-3:]
    for answer in answers[:2]:
        assert "was read, and would be written over" in answer["error"][0]["what"]
    assert answers[2]["ok"]


def test_a_journal_does_not_begin_in_a_file_that_was_read(tmp_path):
    path = tmp_path / "empty.csv"
    path.touch()
    with keeping_inputs():
        read_bytes(path)
        with pytest.raises(InputError, match="was read, and would be written over"):
            Journal.create(path, {})
    assert path.read_bytes() == b""


@pytest.mark.parametrize(
    "command",
    [
        ["compare", "p", "q", "--out", "p"],
        ["compare", "p", "q", "--plot", "p/points.csv"],
        ["compare", "p", "q", "--report", "p/points.csv"],
        ["adjust", "p", "--report", "p/points.csv"],
        ["adjust", "p", "--parts", "2", "--out", "p"],
        ["adjust", "p", "--parts", "2", "--folder", "p"],
        ["plot", "p", "--out", "p/points.csv"],
        ["plot", "p", "--out", "p"],
        ["stream", "p", "--journal", "p/project.toml"],
        ["stream", "p", "--journal", "p/points.csv"],
    ],
)
def test_no_command_changes_what_it_read_whatever_else_it_writes(project, command, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(project.parent)
    before = content(project.parent)
    assert main(command) in (0, 1, 2)
    after = content(project.parent)
    assert {name: after.get(name) for name in before} == before


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


OUTPUT = {"check": True, "capture_output": True, "text": True}


STEPS = ("fsync", "link", "replace", "unlink", "mkdir")
"""Calls of the system before which a process is killed."""


def killed_before(step, run):
    """Run a function in a process that ends without a word before a call; return its exit code."""
    process = os.fork()
    if process:
        return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    calls = 0

    def dying(call):
        def counted(*given, **options):
            nonlocal calls
            calls += 1
            if calls > step:
                os._exit(9)
            return call(*given, **options)

        return counted

    for name in STEPS:
        setattr(os, name, dying(getattr(os, name)))
    try:
        run()
    finally:
        os._exit(0)


def change(folder, fail=False):
    """Replace, remove and add files in three folders at once."""
    try:
        with one_transaction():
            for name in "abc":
                write_files(folder / name, {"x.txt": "new", "gone.txt": None, "more.txt": "new"})
            if fail:
                place = os.replace

                def refused(source, target):
                    if Path(target).parent.name == "c" and Path(source).parent.name != ".old":
                        raise OSError(28, "no space left", str(target))
                    return place(source, target)

                os.replace = refused
    except InputError:
        pass


def state(folder, name):
    there = {p.name: p.read_text() for p in (folder / name).glob("*.txt")}
    there.pop("next.txt", None)
    return there


@LONG
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the process is killed in a fork")
@pytest.mark.parametrize("fail", [False, True], ids=["moves", "moves that fail"])
def test_a_process_killed_at_any_step_leaves_all_old_or_all_new_files_to_the_next(
    tmp_path, fail, monkeypatch
):
    """The next one that writes into any folder puts the old files back in all of them."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # slow, and no matter of a kill
    old, new = {"x.txt": "old", "gone.txt": "old"}, {"x.txt": "new", "more.txt": "new"}
    found, step, code = [], 0, 9
    while code:
        folder = tmp_path / str(step)
        for name in "abc":
            write_files(folder / name, old)
        code = killed_before(step, partial(change, folder, fail))
        write_files(folder / "abc"[step % 3], {"next.txt": "next"})
        states = [state(folder, name) for name in "abc"]
        assert states in ([old] * 3, [new] * 3), step
        found.append(states[0] == new)
        for name in "abc":
            write_files(folder / name, {"next.txt": "next"})
        assert not list(folder.rglob(f"{WRITING_PREFIX}*")), step
        step += 1
    assert step > 30
    assert found == sorted(found) if not fail else not found[-1]


def test_a_list_of_moves_from_elsewhere_moves_nothing_outside_its_folder(tmp_path):
    """A folder that somebody sent is no way to remove or replace other files."""
    write_files(tmp_path / "home", {"key.txt": "mine"})
    done = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], **OUTPUT)
    sent = tmp_path / "sent" / f"{WRITING_PREFIX}{socket.gethostname()}-{done.stdout.strip()}-x"
    for first, name in (
        (sent, "../../home/key.txt"),
        (sent, ".."),
        (sent, "key.txt"),
        (tmp_path / "home", "key.txt"),
    ):
        change = {"name": name, "new": None, "existed": True}
        sent.mkdir(parents=True, exist_ok=True)
        (sent / MOVE_MARK).touch()
        (sent / OLD_FILES).mkdir(exist_ok=True)
        (sent / OLD_FILES / "key.txt").write_text("theirs")
        listed = {"first": str(first), "all": [str(sent), str(tmp_path / "home")]}
        (sent / LIST).write_text(json.dumps(listed | {"changes": [change]}))
        with pytest.raises(UnfinishedError):
            write_files(tmp_path / "sent", {"y.txt": "next"})
        assert content(tmp_path / "home") == {Path("key.txt"): b"mine"}
        assert not (tmp_path / "sent" / "y.txt").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("adjust", "P", "--report", "taken/page.html"),
        ("adjust", "P", "--out", "taken/out"),
        ("adjust", "P", "--export", "taken/deep/next.toml"),
        ("adjust", "P", "--export", "dxf:taken/plan"),
        ("adjust", "P", "--parts", "2", "--out", "taken/out"),
        ("plot", "P", "--out", "taken/out"),
        ("compare", "P", "P", "--report", "taken/page.html"),
        ("compare", "P", "P", "--plot", "taken/plan.png"),
        ("compare", "P", "P", "--out", "taken/out"),
        ("compare", "P", "P", "--export", "taken/moved.dxf"),
    ],
)
def test_a_file_in_place_of_a_folder_is_told_before_the_computation(
    tmp_path, monkeypatch, capsys, arguments
):
    """The project is not even read: it does not exist."""
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("a file", encoding="utf-8")
    assert main(list(arguments)) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    output = arguments[-1].removeprefix("dxf:")
    said = f"  {output}: cannot be written: taken is a file, not a folder\n"
    assert printed.err == f"1 problem:\n{said}"


def test_a_folder_without_permission_is_told_before_the_computation(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("closed").mkdir()
    monkeypatch.setattr("factorgraph_adj.files.os.access", lambda *_: False)
    assert main(["adjust", "P", "--report", "closed/sub/page.html"]) == 2
    said = "closed/sub/page.html: cannot be written: no permission to write in closed"
    assert said in capsys.readouterr().err


def test_missing_folders_are_made(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outputs = ["--report", "a/b/page.html", "--out", "c/d", "--export", "e/f/next.toml"]
    main(["adjust", str(project), *outputs])
    for made in ("a/b/page.html", "c/d/report.txt", "e/f/next.toml"):
        assert Path(made).exists()
