"""Command ``simulate-instrument``: a site that it writes maps its lines to its network."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
import tomllib
from pathlib import Path
from threading import Event, Thread

import factorgraph_adj as fga
from factorgraph_adj.cli import instrument_simulation
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.instruments import Instrument, read_instruments
from factorgraph_adj.site.alarm_tables import read_alarms
from tests.support.places import ROOT


def simulated(arguments, folder, **options):
    command = [sys.executable, "-m", "factorgraph_adj", "simulate-instrument", *arguments]
    return subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


def test_a_site_that_it_writes_receives_its_sets(tmp_path: Path):
    arguments = ["--demo", "tunnel", "--port", "0", "--speed", "3000", "--sets", "3"]
    arguments += ["--write", "site", "--truth", "truth.jsonl"]
    arguments += ["--fault", "displacement point=T2.3 dz_mm=-8 at=9min"]
    process = simulated(arguments, tmp_path)
    try:
        said = [process.stdout.readline()]
        while not said[-1].startswith("ts1 on S1"):
            said.append(process.stdout.readline())
            assert said[-1], process.stderr.read()
        document = tomllib.loads((tmp_path / "site" / "site.toml").read_text())
        assert fga.read_project(tmp_path / "site").points["R1"].fixed == (True, True, True)
        (settings,) = read_instruments(
            document["instrument"], where="site.toml", folder=tmp_path / "site"
        )
        assert settings.clock == "stated"
        (network,) = document["network"]
        (alarm,) = read_alarms(document["alarm"], where="site.toml", networks=["tunnel"])
        assert alarm.rule.test == "displacement" and alarm.rule.false_alarms_per_month == 0.1
        assert list(alarm.rule.points) == network["objects"] and "T2.3" in alarm.rule.points
        postings, stop = [], Event()
        instrument = Instrument(settings)
        thread = Thread(target=instrument.run, args=(postings.append, stop))
        thread.start()
        process.stdin.write("nonsense\ngross-error target=T1.1 reading=zenith size_mgon=30\n")
        process.stdin.flush()
        assert process.wait(60) == 0
        stop.set()
        thread.join(10)
    finally:
        process.kill()
        output, errors = process.communicate()
    assert len(postings) == 3
    assert "unknown fault 'nonsense'" in errors
    assert "ts1 set 3" in output
    lines = (tmp_path / "truth.jsonl").read_text().splitlines()
    truth = [json.loads(line)["points"] for line in lines]
    assert [round(t["T2.3"][2] - truth[0]["T2.3"][2], 4) for t in truth] == [0, -0.008, -0.008]


def test_wrong_arguments_are_refused(capsys):
    assert main(["simulate-instrument"]) == 2
    assert "give PROJECT or --demo" in capsys.readouterr().err
    assert main(["simulate-instrument", "--demo", "dam", "--fault", "gap length=1"]) == 2
    assert "duration" in capsys.readouterr().err
    assert main(["simulate-instrument", "--demo", "dam", "--station", "D1"]) == 2
    assert "for PROJECT" in capsys.readouterr().err


def test_a_terminal_is_not_read_in_the_background(monkeypatch):
    # A system stops a command that reads its terminal behind "&", and its instrument with it.
    ours, terminal = pty.openpty()
    os.write(ours, b"nonsense\n")
    with open(terminal, encoding="utf-8") as source:
        monkeypatch.setattr(instrument_simulation.sys, "stdin", source)
        monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp() + 1)
        assert instrument_simulation._take_faults([])
        assert source.readline() == "nonsense\n"  # it was not taken
    os.close(ours)
