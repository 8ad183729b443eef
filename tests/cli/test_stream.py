"""The command `stream`: a pipe that answers line by line and ends cleanly whatever happens."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from factorgraph_adj.cli import command_line as cli
from factorgraph_adj.cli import stream as cli_stream
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.io.project_writer import network_files
from factorgraph_adj.service.requests import MAX_LINE_BYTES
from tests.networks.projects import FILES, write
from tests.networks.projects import POINTS as MEASURED
from tests.networks.yard import ARRIVALS, POINTS, WRONG, YARD
from tests.support.processes import HANGS

POSIX = pytest.mark.skipif(os.name == "nt", reason="signals of another process need POSIX")


@pytest.fixture
def yard(tmp_path) -> Path:
    """A project whose observations are still to come."""
    return write(tmp_path / "yard", YARD)


class Pipe:
    """The command at the other end of two pipes."""

    def __init__(self, *arguments: object) -> None:
        command = [
            sys.executable,
            "-m",
            "factorgraph_adj.cli.command_line",
            "stream",
            *map(str, arguments),
        ]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def read(self) -> dict:
        """Return the next answer."""
        return json.loads(self.process.stdout.readline())

    def ask(self, fields: object) -> dict:
        """Write a line; return its answer, which must come before anything else is written."""
        line = fields if isinstance(fields, bytes) else json.dumps(fields).encode("utf-8")
        self.process.stdin.write(line + b"\n")
        self.process.stdin.flush()
        return self.read()


@contextmanager
def pipe(*arguments: object) -> Iterator[Pipe]:
    """Run the command; it is ended if the test fails."""
    opened = Pipe(*arguments)
    try:
        yield opened
    finally:
        if opened.process.poll() is None:
            opened.process.kill()
        for stream in (opened.process.stdin, opened.process.stdout, opened.process.stderr):
            stream.close()
        opened.process.wait()


@pytest.fixture
def here(monkeypatch, capsysbinary):
    """Run the command in this process, with text as its standard input."""

    def run(*arguments: object, lines: bytes = b"") -> tuple[int, list[dict], str]:
        source = io.TextIOWrapper(io.BytesIO(lines), encoding="ascii")
        monkeypatch.setattr(sys, "stdin", source)
        try:
            code = cli.main(["stream", *map(str, arguments)])
        except SystemExit as stop:  # argparse
            code = stop.code
        out, err = capsysbinary.readouterr()
        return code, [json.loads(line) for line in out.splitlines()], err.decode("utf-8")

    return run


def lines_of(*lines: dict | str) -> bytes:
    """Return lines of JSON."""
    texts = [line if isinstance(line, str) else json.dumps(line) for line in lines]
    return "".join(f"{t}\n" for t in texts).encode("utf-8")


# -- a pipe ---------------------------------------------------------------------------------------


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
def test_each_line_is_answered_before_the_next_one_is_written(yard):
    with pipe(yard) as p:
        assert p.read()["ready"] is True
        verdicts = [p.ask(line)["verdict"] for line in ARRIVALS]
        assert verdicts[-1] == "accepted"
        assert p.ask(WRONG)["verdict"] == "suspect"
        assert p.ask(b"\xff\xfe")["ok"] is False
        answer = p.ask({"do": "estimate", "point": "C"})
        assert (answer["line"], answer["ok"]) == (len(ARRIVALS) + 3, True)
        p.process.stdin.close()
        assert p.process.wait(HANGS) == 0
        assert (p.process.stdout.read(), p.process.stderr.read()) == (b"", b"")


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
def test_stop_ends_it_while_the_pipe_is_open(yard):
    with pipe(yard) as p:
        p.read()
        assert p.ask({"do": "stop"})["ok"] is True
        assert p.process.wait(HANGS) == 0


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@POSIX
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_signal_ends_it_while_it_waits_for_a_line(yard, number, code):
    with pipe(yard) as p:
        p.read()
        p.ask(ARRIVALS[0])
        p.process.send_signal(number)
        assert p.process.wait(HANGS) == code
        assert (p.process.stdout.read(), p.process.stderr.read()) == (b"", b"")


SLOW = """
import os, signal, sys
from factorgraph_adj.cli import command_line as cli
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
real = IncrementalAdjustment.add
def add(self, *arguments, **more):
    for number in map(int, os.environ["SIGNALS"].split()):
        os.kill(os.getpid(), number)
    return real(self, *arguments, **more)
IncrementalAdjustment.add = add
sys.exit(cli.main(sys.argv[1:]))
"""
"""The command, which gets signals in the middle of each arrival."""


def slow(*arguments: object, signals: str, lines: bytes) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-c", SLOW, "stream", *map(str, arguments)],
        input=lines,
        capture_output=True,
        timeout=HANGS,
        check=False,
        env=os.environ | {"SIGNALS": signals},
    )


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@POSIX
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_the_line_in_hand_is_finished_answered_and_recorded(yard, tmp_path, number, code):
    journal = tmp_path / "journal.jsonl"
    ran = slow(*(yard, "--journal", journal), signals=f"{int(number)}", lines=lines_of(*ARRIVALS))
    assert (ran.returncode, ran.stderr) == (code, b"")
    ready, first = map(json.loads, ran.stdout.splitlines())
    assert ready["ready"] is True
    assert (first["id"], first["verdict"]) == ("r1", "accepted")
    assert len(IncrementalAdjustment.resume(journal)) == 1


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@POSIX
def test_a_second_interruption_does_not_wait_for_the_line(yard):
    twice = f"{int(signal.SIGINT)} {int(signal.SIGINT)}"
    ran = slow(yard, signals=twice, lines=lines_of(*ARRIVALS))
    assert ran.returncode == 130
    assert ran.stderr == b"interrupted in the middle of a line\n"
    assert len(ran.stdout.splitlines()) == 1


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@POSIX
def test_a_reader_that_goes_away_ends_it_with_the_journal_written(yard, tmp_path):
    journal = tmp_path / "journal.jsonl"
    with pipe(yard, "--journal", journal) as p:
        p.read()
        p.process.stdout.close()
        p.process.stdin.write(lines_of(*ARRIVALS))
        p.process.stdin.close()
        assert p.process.wait(HANGS) == 0
        assert p.process.stderr.read() == b""
    assert len(IncrementalAdjustment.resume(journal)) == 1


# -- lines ----------------------------------------------------------------------------------------


def test_every_line_gets_one_answer_with_its_number(yard, here):
    lines = [json.dumps(ARRIVALS[0]), "", "no", "[]", json.dumps({"do": "waiting"})]
    code, answers, err = here(yard, lines="\n".join(lines).encode("utf-8"))
    assert (code, err) == (0, "")
    assert [a.get("line") for a in answers] == [None, 1, 2, 3, 4, 5]
    assert [a.get("ok") for a in answers] == [None, True, False, False, False, True]


def test_names_are_utf_8_in_both_directions_whatever_the_terminal_is(tmp_path, here):
    project = write(tmp_path, YARD | {"points.csv": POINTS.replace("C,", "Köbis α,")})
    line = json.dumps({**ARRIVALS[3], "target": "Köbis α"}, ensure_ascii=False)
    code, answers, _ = here(project, lines=b"\xef\xbb\xbf" + line.encode("utf-8"))
    assert code == 0
    assert answers[1]["verdict"] == "waiting"
    assert "Köbis α" in answers[1]["label"]


def test_nothing_after_stop_is_read(yard, here):
    code, answers, _ = here(yard, lines=lines_of({"do": "stop"}, *ARRIVALS))
    assert code == 0
    assert [a.get("do") for a in answers] == [None, "stop"]


def test_a_line_without_an_end_does_not_fill_the_memory(yard, here, monkeypatch):
    for module in (cli_stream, sys.modules["factorgraph_adj.service.requests"]):
        monkeypatch.setattr(module, "MAX_LINE_BYTES", 1000)
    assert MAX_LINE_BYTES > 1000
    good = json.dumps(ARRIVALS[0])
    fits = good + " " * (999 - len(good))  # and the end of the line
    long = "x" * 12_345
    code, answers, _ = here(yard, lines=f"{long}\n{fits}\n{long}".encode())
    assert code == 0
    assert [a.get("ok") for a in answers[1:]] == [False, True, False]
    assert "longer than" in answers[1]["error"][0]["what"]


def test_standard_input_that_cannot_be_read_ends_with_2(yard, monkeypatch, capsys):
    class Broken(io.RawIOBase):
        def readable(self) -> bool:
            return True

        def readinto(self, room: bytearray) -> int:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BufferedReader(Broken())))
    assert cli.main(["stream", str(yard)]) == 2
    assert "standard input: cannot be read: input/output error" in capsys.readouterr().err


# -- options --------------------------------------------------------------------------------------


def test_policy_alpha_and_power_are_those_of_the_options(yard, here):
    code, answers, _ = here(
        *(yard, "--policy", "reject", "--alpha", "0.05", "--power", "0.9"),
        lines=lines_of(*ARRIVALS, WRONG, {"do": "reliability"}),
    )
    assert code == 0
    assert [answers[0][n] for n in ("policy", "alpha", "power")] == ["reject", 0.05, 0.9]
    assert answers[-2]["verdict"] == "rejected"
    assert answers[-2]["critical"] == pytest.approx(3.841459, abs=1e-6)
    assert (answers[-1]["alpha"], answers[-1]["power"]) == (0.05, 0.9)


def test_a_network_that_is_measured_already_goes_on(tmp_path, here):
    points = MEASURED.replace("5.01,8,1,", "5.01,8,1,xy").replace("F,5,5,3,", "F,5,5,3,")
    code, answers, err = here(
        write(tmp_path, FILES, points=points), lines=lines_of({"do": "solution"})
    )
    assert (code, err) == (0, "")
    assert answers[0]["observations"] > 0
    assert answers[1]["ok"] is True


def test_a_free_network_can_be_asked_for(tmp_path, here):
    free = write(tmp_path, YARD | {"points.csv": POINTS.replace(",xyz", ",")})
    given = here(free, lines=lines_of(*ARRIVALS, {"do": "solution"}))[1][-1]
    assert given["ok"] is False
    answers = here(free, "--datum", "free", lines=lines_of(*ARRIVALS, {"do": "solution"}))[1]
    assert answers[-1]["ok"] is True
    assert answers[-1]["datum_defect"] > 0


def test_what_came_in_the_last_seconds_is_kept(tmp_path, here):
    project = write(tmp_path, YARD | {"points.csv": POINTS + "D,,,,\n"})
    later = [{**o, "id": f"{o['id']} D", "target": "D"} for o in ARRIVALS[1:4]]
    lines = lines_of(
        {"do": "add", "observations": list(ARRIVALS), "time": 0.0},
        {"do": "add", "observations": later, "time": 100.0},
        {**ARRIVALS[6], "id": "h2"},
        {"do": "add", "observations": [{**later[2], "id": "s4 D"}], "time": 50.0},
        {"do": "add", "observations": [{**later[2], "id": "s4 D"}]},
    )
    answers = here(project, "--keep", "60s", lines=lines)[1]
    assert [a["ok"] for a in answers[1:]] == [True, True, False, False, True]
    assert "point 'C' was retired" in answers[3]["error"][0]["what"]
    assert "must not be before that of an earlier one" in answers[4]["error"][0]["what"]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--resume",), "--resume needs --journal FILE"),
        (("--alpha", "0.9"), "--alpha 0.9 must be less than --power 0.8"),
        (("--alpha", "2"), "'2' is not a probability between 0 and 1"),
        (("--policy", "guess"), "invalid choice: 'guess'"),
        (("--keep", "soon"), "'soon' is neither a number of photos (60) nor of seconds (60s)"),
        (("--keep", "0"), "keep must be a whole number of photos, 1 or more"),
        (("--keep", "0s"), "keep_seconds must be 0.001 or more"),
        (("--journal", "nowhere/at/all.jsonl"), "nowhere/at/all.jsonl: cannot be opened"),
        (("--journal", "none.jsonl", "--resume"), "none.jsonl: cannot be opened: no such file"),
    ],
)
def test_bad_options_end_with_2_and_no_line(yard, here, monkeypatch, options, expected):
    monkeypatch.chdir(yard.parent)
    code, answers, err = here(yard, *options)
    assert (code, answers) == (2, [])
    assert expected in err


def test_a_bad_project_ends_with_2_a_list_and_no_journal(tmp_path, here):
    bad = write(tmp_path, YARD | {"points.csv": POINTS.replace("80,", "8o,")})
    code, answers, err = here(bad, "--journal", tmp_path / "journal.jsonl")
    assert (code, answers) == (2, [])
    assert "points.csv:3: point 'B': x: '8o' is not a number" in err
    assert not (tmp_path / "journal.jsonl").exists()


# -- the journal ----------------------------------------------------------------------------------


def test_a_stream_goes_on_from_its_journal_as_if_it_had_not_ended(yard, tmp_path, here):
    journal, whole = tmp_path / "journal.jsonl", tmp_path / "whole.jsonl"
    half = [*ARRIVALS[:5], WRONG, {**ARRIVALS[4], "id": "w", "target": "D"}]
    rest = [*ARRIVALS[5:], {"do": "accept", "ids": "s3"}, {"do": "solution"}]
    extra = {"do": "add", "points": [{"name": "D"}]}
    assert here(yard, "--journal", journal, lines=lines_of(extra, *half))[0] == 0
    code, answers, err = here(yard, "--journal", journal, "--resume", lines=lines_of(*rest))
    assert (code, err) == (0, "")
    ready = answers[0]
    assert (ready["resumed"], ready["observations"]) == ("", 5)
    assert (ready["counts"]["suspects"], ready["counts"]["waiting"]) == (1, 1)
    assert [w["id"] for w in ready["waiting"]] == ["w"]
    at_once = here(yard, "--journal", whole, lines=lines_of(extra, *half, *rest))[1]
    for now, then in zip(answers[-1]["points"], at_once[-1]["points"], strict=True):
        assert list(now) == list(then)
        for axis in "xyz":
            sigma = max(now[f"sigma_{axis}_mm"], 1e-6) / 1000
            assert abs(now[axis] - then[axis]) < 0.02 * sigma
    resumed, straight = (IncrementalAdjustment.resume(j) for j in (journal, whole))
    observations = "observations.csv"
    assert (
        network_files(resumed.network())[observations]
        == network_files(straight.network())[observations]
    )


def test_photos_that_arrived_keep_the_axes_of_their_camera(tmp_path, here):
    flipped = FILES["project.toml"].replace('unit = "mm"', 'unit = "mm"\ny_axis = "down"')
    project = write(tmp_path, FILES | {"project.toml": flipped})
    journal = tmp_path / "journal.jsonl"
    ray = {"kind": "image", "photo": "Q", "point": "C", "x": 1, "y": 2}
    photo = {"do": "add", "photos": [{"name": "Q"}]}
    assert here(project, "--journal", journal, lines=lines_of(photo, ray))[1][-1]["ok"]
    again = lines_of({**ray, "point": "D"}, {"do": "suspects"})
    code, answers, _ = here(project, "--journal", journal, "--resume", lines=again)
    assert (code, [a.get("ok", True) for a in answers]) == (0, [True] * 3)
    resumed = IncrementalAdjustment.resume(journal)
    for point in "CD":
        image = resumed.observation(f"Q/{point}")
        assert (image.x, image.y, image.sigma) == (1.0, -2.0, (0.005, 0.005))


def test_suspects_are_told_as_before_after_resuming(yard, tmp_path, here):
    journal = tmp_path / "journal.jsonl"
    asked = lines_of({"do": "suspects"})
    before = here(yard, "--journal", journal, lines=lines_of(*ARRIVALS, WRONG) + asked)[1][-1]
    after = here(yard, "--journal", journal, "--resume", lines=asked)[1][-1]
    assert after["suspects"] == before["suspects"] != []


def test_a_torn_last_line_is_told_and_left_out(yard, tmp_path, here):
    journal = tmp_path / "journal.jsonl"
    here(yard, "--journal", journal, lines=lines_of(*ARRIVALS[:3]))
    with journal.open("ab") as stream:
        stream.write(b'{"do": "add", "observ')
    code, answers, _ = here(yard, "--journal", journal, "--resume")
    assert code == 0
    assert "the last line was torn and is left out" in answers[0]["resumed"]
    assert answers[0]["observations"] + len(answers[0]["waiting"]) == 3


def test_a_journal_that_has_something_is_not_written_over(yard, tmp_path, here):
    journal = tmp_path / "journal.jsonl"
    here(yard, "--journal", journal, lines=lines_of(*ARRIVALS[:2]))
    before = journal.read_bytes()
    code, answers, err = here(yard, "--journal", journal)
    assert (code, answers) == (2, [])
    assert "resume this journal, or choose another name" in err
    assert journal.read_bytes() == before


def test_a_journal_of_another_project_or_with_other_options_is_refused(yard, tmp_path, here):
    journal = tmp_path / "journal.jsonl"
    here(yard, "--journal", journal, lines=lines_of(*ARRIVALS[:2]))
    other = write(tmp_path / "other", YARD | {"points.csv": POINTS + "E,,,,\n"})
    code, _, err = here(
        *(other, "--journal", journal, "--resume"),
        *("--policy", "reject", "--alpha", "0.01", "--datum", "free"),
    )
    assert code == 2
    assert "the journal has no point 'E': it is not one of this project" in err
    code, _, told = here(yard, "--journal", journal, "--resume", "--keep", "60")
    assert code == 2
    assert "--keep 60: the journal was begun with None" in told
    for stated in ("--policy reject", "--alpha 0.01", "--datum free"):
        assert f"{stated}: the journal was begun with" in err
    same = here(
        *(yard, "--journal", journal, "--resume"),
        *("--policy", "flag", "--alpha", "0.001", "--datum", "given"),
    )
    assert same[0] == 0


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
def test_two_streams_cannot_share_a_journal(yard, tmp_path, here):
    journal = tmp_path / "journal.jsonl"
    with pipe(yard, "--journal", journal) as p:
        p.read()
        p.ask(ARRIVALS[0])
        code, _, err = here(yard, "--journal", journal, "--resume")
        assert code == 2
        assert "is in use already" in err
