"""A path with NUL is bad input of every option that takes a path, and no fault of the program."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest

from factorgraph_adj.cli.command_line import main
from tests.support.places import EXAMPLES

PROJECT = str(EXAMPLES / "industry_block")


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", f"{PROJECT}\0"),
        ("adjust", PROJECT, "--out", "{}/out\0"),
        ("adjust", PROJECT, "--report", "{}/report\0.html"),
        ("adjust", PROJECT, "--export", "{}/points\0.geojson"),
        ("adjust", PROJECT, "--parts", "2", "--folder", "{}/parts\0"),
        ("convert", PROJECT, "{}/network\0.gkf"),
        ("plot", PROJECT, "--out", "{}/plots\0"),
        ("compare", PROJECT, PROJECT, "--out", "{}/epochs\0"),
        ("stream", PROJECT, "--journal", "{}/journal\0.jsonl"),
        ("stream", PROJECT, "--journal", "{}/journal\0.jsonl", "--resume"),
    ],
)
def test_a_path_with_nul_is_bad_input(arguments, tmp_path: Path, capsys, monkeypatch) -> None:
    nothing = tmp_path / "nothing"
    nothing.touch()
    with nothing.open(encoding="utf-8") as empty:
        monkeypatch.setattr("sys.stdin", empty)
        assert main([a.format(tmp_path) for a in arguments]) == 2
    told = capsys.readouterr().err
    assert "fault of the program" not in told
    assert "\0" not in told
    assert sorted(p.name for p in tmp_path.iterdir()) == ["nothing"]


@pytest.mark.parametrize("setting", ["=", "a", "=1", "encoding=undefined", "x=1", "mapping"])
def test_odd_settings_are_bad_input(setting: str, capsys) -> None:
    assert main(["check", PROJECT, "--set", setting]) == 2
    assert "fault of the program" not in capsys.readouterr().err


def test_the_stream_answers_a_path_with_nul(capsys, monkeypatch) -> None:
    asked = {"do": "write", "project": "/tmp/x\0y"}
    lines = io.BytesIO(json.dumps(asked).encode("utf-8") + b"\n")
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(lines, encoding="utf-8"))
    assert main(["stream", PROJECT]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert not answer["ok"] and "\\x00" in answer["error"][0]["what"]
