"""The terminal view of a stream, looked at as text."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys

import pytest
from rich.cells import cell_len
from rich.console import Console

from factorgraph_adj.cli import command_line as cli
from factorgraph_adj.cli.live_view import MAX_LATENCIES_KEPT, MAX_VERDICTS_KEPT, LiveView, live_view
from tests.networks.projects import write
from tests.networks.yard import ARRIVALS, WRONG, YARD
from tests.support.processes import HANGS
from tests.support.told import open_stream


def told(tmp_path, *lines: object) -> LiveView:
    """Return a view that was fed with the answers to some lines."""
    stream = open_stream(tmp_path).stream
    view = LiveView()
    view.take(stream.ready())
    for number, line in enumerate(lines, start=1):
        view.take(stream.answer(line if isinstance(line, str) else json.dumps(line), number))
    return view


def picture(view: LiveView, width: int, height: int = 24) -> list[str]:
    """Return what a terminal shows."""
    console = Console(record=True, width=width, height=height, file=io.StringIO())
    console.print(view)
    return [line.rstrip() for line in console.export_text().splitlines()]


@pytest.mark.parametrize("full", [False, True])
def test_it_fits_every_terminal_and_keeps_its_height(tmp_path, full):
    sights = [{**ARRIVALS[3], "id": f"d{i} {'long ' * 40}"} for i in range(60)] if full else []
    view, empty = told(tmp_path / "1", *ARRIVALS, *sights), told(tmp_path / "2")
    for width in (40, 80, 109, 110, 120, 200):
        for height in (10, 24, 50):
            lines = picture(view, width, height)
            assert max(map(cell_len, lines)) <= width
            assert len(lines) == len(picture(empty, width, height)) <= max(height - 1, 16)


def test_it_begins_with_what_there_is(tmp_path):
    lines = picture(told(tmp_path), 80)
    assert lines[0] == "yard   0 lines"
    assert lines[1] == "0 in the graph   0 waiting   0 suspects   0 rejected"
    assert lines[-1] == "no observation has arrived yet"


def test_counts_verdicts_points_and_latency_are_shown(tmp_path):
    other = {**ARRIVALS[3], "id": "d", "target": "D"}
    view = told(
        tmp_path, *ARRIVALS, WRONG, {"do": "add", "points": [{"name": "D"}]}, other, "nonsense"
    )
    for width in (80, 120):
        text = "\n".join(picture(view, width))
        assert "yard   11 lines" in text
        assert "7 in the graph   1 waiting   1 suspect   0 rejected" in text
        assert "σ̂0 0.707   redundancy 3   last " in text
        rows = [line.split() for line in text.splitlines()]
        verdict = {r[4].rstrip(")"): r for r in rows if r[:1] == ["slope_distance"]}
        assert verdict["s3"][5:7][0] == "suspect"
        assert float(verdict["s3"][6]) > 20  # √(T²/critical)
        assert verdict["s1"][5] == "accepted"
        assert "waiting" in verdict["d"]
        assert "line 11  the line is not JSON" in text
        (point,) = [line for line in text.splitlines() if "C   " in line and "(" not in line[-45:]]
        assert all(0.2 < float(s) < 3 for s in point.split()[-3:])


def test_the_weakest_points_come_first_and_lost_ones_go():
    view = LiveView()
    answer = {"ok": True, "counts": {}, "verdicts": [], "entered": [], "seconds": 0.001}
    units = {"sigma_length": "mm"}
    view.take({"ready": True, "name": "", "units": units, "points": 9, "counts": {}})
    for name, sigma in (("A", 1.0), ("B", 3.0), ("C", 2.0), ("D", None)):
        point = {"name": name, **{f"sigma_{a}_mm": sigma for a in "xyz"}}
        view.take({**answer, "points": [point]})
    view.take({**answer, "points": [], "points_lost": ["D"]})
    lines = picture(view, 80)
    at = next(i for i, line in enumerate(lines) if line.startswith("weakest points"))
    assert lines[at].split() == ["weakest", "points", "σx", "mm", "σy", "mm", "σz", "mm"]
    assert [line.split()[:2] for line in lines[at + 1 : at + 4]] == [
        ["B", "3.0"],
        ["C", "2.0"],
        ["A", "1.0"],
    ]


def test_memory_does_not_grow_with_the_stream():
    view = LiveView()
    answer = {"ok": True, "counts": {}, "verdict": "accepted", "label": "x", "seconds": 1.0}
    for _ in range(3 * MAX_LATENCIES_KEPT):
        view.take(answer)
    assert (len(view._verdicts), len(view._seconds)) == (MAX_VERDICTS_KEPT, MAX_LATENCIES_KEPT)
    assert "maximum 1000 ms" in picture(view, 80)[-1]


def test_a_file_gets_the_last_picture_only(tmp_path):
    stream = io.StringIO()
    with live_view(stream) as view:
        view.take(open_stream(tmp_path).stream.ready())
    assert stream.getvalue().count("0 in the graph") == 1


class Terminal(io.TextIOWrapper):
    """A stream that says it is a terminal."""

    def __init__(self) -> None:
        super().__init__(io.BytesIO(), encoding="utf-8", write_through=True)

    def isatty(self) -> bool:
        return True

    def text(self) -> str:
        return plain(self.buffer.getvalue())


def plain(shown: bytes) -> str:
    """Return what a terminal was sent, without its colours."""
    return re.sub(r"\x1b\[[0-9;]*m", "", shown.decode("utf-8"))


@pytest.mark.parametrize("terminal", [True, False])
def test_lines_stay_in_a_pipe_and_give_way_on_a_terminal(
    tmp_path, monkeypatch, capsysbinary, terminal
):
    project = write(tmp_path, YARD)
    lines = "".join(json.dumps(a) + "\n" for a in ARRIVALS).encode()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines)))
    monkeypatch.setattr(sys, "stderr", shown := Terminal())
    monkeypatch.setenv("TERM", "xterm")
    if terminal:
        monkeypatch.setattr(sys, "stdout", out := Terminal())
    assert cli.main(["stream", str(project), "--live"]) == 0
    assert "7 in the graph" in shown.text()
    if terminal:
        assert out.text() == ""
    else:
        assert len(capsysbinary.readouterr().out.splitlines()) == 1 + len(ARRIVALS)


def test_without_rich_it_says_what_to_install_and_begins_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rich", None)
    journal = tmp_path / "journal.jsonl"
    project = write(tmp_path / "yard", YARD)
    assert cli.main(["stream", str(project), "--live", "--journal", str(journal)]) == 2
    assert "the live view needs rich: pip install 'factorgraph_adj[cli]'" in capsys.readouterr().err
    assert not journal.exists()


@pytest.mark.slow(
    "the command runs in a process of its own with signals, pipes or terminals; short "
    "tests call it in this process"
)
@pytest.mark.skipif(os.name == "nt", reason="a pseudo-terminal needs POSIX")
def test_a_real_terminal_shows_it_and_is_left_in_order(tmp_path):
    import pty

    project = write(tmp_path, YARD)
    lines = "".join(json.dumps(a) + "\n" for a in (*ARRIVALS, WRONG)).encode()
    master, slave = pty.openpty()
    with subprocess.Popen(
        [
            sys.executable,
            "-m",
            "factorgraph_adj.cli.command_line",
            "stream",
            str(project),
            "--live",
        ],
        stdin=subprocess.PIPE,
        stdout=slave,
        stderr=slave,
        env=os.environ | {"TERM": "xterm", "PYTHONIOENCODING": "utf-8"},
    ) as process:
        os.close(slave)
        process.stdin.write(lines)
        process.stdin.close()
        seen = b""
        while True:
            try:
                part = os.read(master, 65536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            seen += part
        assert process.wait(HANGS) == 0
    os.close(master)
    text = plain(seen)
    assert "1 suspect" in text
    assert '{"line"' not in text
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")  # the cursor is back
