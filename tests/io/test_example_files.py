"""Example networks come as they were published, adjust by their command, and end whole or not."""

from __future__ import annotations

import hashlib
import shlex
from dataclasses import replace
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.io import example_files
from factorgraph_adj.io.example_files import EXAMPLE_NETWORKS, fetch_example


@pytest.mark.parametrize("name", [n for n, e in EXAMPLE_NETWORKS.items() if not e.fetched])
def test_an_example_is_read_as_its_command_says(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert main(["fetch-example", name]) == 0
    command = EXAMPLE_NETWORKS[name].command
    assert f"next: cd {name} && factorgraph-adj {command}" in capsys.readouterr().out
    text = (tmp_path / name / "README.txt").read_text(encoding="utf-8")
    assert command in text and EXAMPLE_NETWORKS[name].licence in text
    monkeypatch.chdir(tmp_path / name)
    arguments = shlex.split(command)
    assert arguments[0] == "adjust"
    assert main(["check", *arguments[1:]]) in (0, 1)
    assert main(arguments) in (0, 1)


def test_a_list_without_a_name(capsys):
    assert main(["fetch-example"]) == 0
    said = capsys.readouterr().out.splitlines()
    for line, e in zip(said, EXAMPLE_NETWORKS.values(), strict=True):
        needs = "; needs the network" if e.fetched else ""
        assert line == f"{e.name}: {e.description} ({e.licence}{needs})"


@pytest.fixture
def server(tmp_path):
    folder = tmp_path / "server"
    folder.mkdir()
    (folder / "a.stn").write_bytes(b"stations")

    class Quiet(SimpleHTTPRequestHandler):
        def __init__(self, *arguments):
            super().__init__(*arguments, directory=str(folder))

        def log_message(self, *arguments):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as http:
        Thread(target=http.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{http.server_address[1]}/"
        http.shutdown()


def test_files_of_a_server_are_those_that_were_published(tmp_path, monkeypatch, server):
    sha = hashlib.sha256(b"stations").hexdigest()
    right = replace(
        EXAMPLE_NETWORKS["gnss-victoria"], name="right", fetched={f"{server}a.stn": sha}
    )
    other = replace(right, name="other", fetched={f"{server}a.stn": "0" * 64})
    absent = replace(right, name="absent", fetched={f"{server}b.stn": sha})
    gone = replace(right, name="gone", fetched={"http://127.0.0.1:9/c.stn": sha})
    examples = {e.name: e for e in (right, other, absent, gone)}
    monkeypatch.setattr(example_files, "EXAMPLE_NETWORKS", examples)
    folder = fetch_example("right", tmp_path / "new" / "right")
    assert (folder / "a.stn").read_bytes() == b"stations"
    for name, match in (
        ("other", "is not the file that was published: its SHA-256 differs"),
        ("absent", "cannot be fetched: "),
        ("gone", "cannot be fetched: "),
    ):
        with pytest.raises(fga.InputError, match=match):
            fetch_example(name, tmp_path / name)
        assert not (tmp_path / name).exists()
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["right"]


def test_a_folder_with_files_is_left_alone(tmp_path):
    (tmp_path / "here").mkdir()
    assert fetch_example("level-loop", tmp_path / "here") == tmp_path / "here"
    before = sorted(p.name for p in (tmp_path / "here").iterdir())
    with pytest.raises(fga.InputError, match="is there already: name another folder"):
        fetch_example("total-station", tmp_path / "here")
    assert sorted(p.name for p in (tmp_path / "here").iterdir()) == before
    with pytest.raises(fga.InputError, match="there is no example 'level_loop'; valid: level-loop"):
        fetch_example("level_loop", tmp_path / "x")
    (tmp_path / "file").write_text("")
    with pytest.raises(fga.InputError, match="not a folder"):
        fetch_example("level-loop", tmp_path / "file" / "x")
