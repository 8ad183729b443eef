"""Lines that are not posted when the program ends are posted after the next start, once."""

from __future__ import annotations

from contextlib import suppress
from threading import Event, Thread

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.line_log import LineLog
from factorgraph_adj.instruments.simulated_sites import tunnel
from factorgraph_adj.instruments.simulated_total_station import SimulatedObject

BEGIN = 1_790_000_000.0


class Killed(BaseException):
    """The end of a process."""


class Lines:
    """A live source that ends a process after some lines."""

    def __init__(self, lines, kill=None):
        self.of, self.kill = lines, kill

    def lines(self, stop, health):
        for n, line in enumerate(self.of):
            if n == self.kill:
                raise Killed
            yield line
        stop.set()
        yield None


@pytest.fixture(scope="module")
def received():
    site = tunnel()
    (station,) = site.total_stations(SimulatedObject(site.network), begin=BEGIN, seed=4)
    out = [ReceivedLine(b"*11....+00000000000000S1 88..10+0000000000002500 ", BEGIN - 9.0, 0)]
    for n, line in enumerate(station.lines(), 1):
        if line.time >= BEGIN + 3 * station.interval:
            return out, station
        out.append(ReceivedLine(line.text, line.time + 0.3, n))


def instrument(station, folder, lines, kill=None):
    table = {"name": "ts1", "network": "tunnel", "source": "tcp://127.0.0.1:9"}
    table |= {"grammar": "gsi-online", "keep_lines": "ts1.lines"}
    table |= {"targets": list(station.targets)}
    (settings,) = read_instruments([table], where="site.toml", folder=folder)
    return Instrument(settings, source=Lines(lines, kill))


def run(of):
    posted = []
    with suppress(Killed):
        of.run(posted.append, Event())
    return posted


@pytest.mark.parametrize("kill", [1, 2, 30, 48, 49, 50, 97, 120, 145])
def test_every_set_is_posted_once_wherever_the_process_ends(received, tmp_path, kill):
    lines, station = received
    (tmp_path / "whole").mkdir()
    whole = run(instrument(station, tmp_path / "whole", lines))
    first = run(instrument(station, tmp_path, lines, kill))
    second = run(instrument(station, tmp_path, lines[kill:]))
    assert len(whole) == 3
    assert [p.record for p in (*first, *second)] == [p.record for p in whole]
    assert [p.request for p in (*first, *second)] == [p.request for p in whole]
    assert LineLog(tmp_path / "ts1.lines").path.read_text().count("\n") == 1  # its station


def test_what_the_network_did_not_take_is_posted_after_the_next_start(received, tmp_path):
    lines, station = received
    of, tried = instrument(station, tmp_path, lines), []

    def away(posting):
        tried.append(posting.request)
        raise ConnectionError("the database is away")

    of.run(away, Event())
    posted = run(instrument(station, tmp_path, []))
    assert len(posted) == 3 and tried[0] == posted[0].request


def test_a_set_in_a_file_that_is_not_whole_is_not_posted_at_the_end(received, tmp_path):
    """Its lines come again after the next start, with those that complete it."""
    lines, station = received
    path = tmp_path / "ts1.gsi"
    path.write_bytes(b"".join(x.text + b"\n" for x in lines[:70]))
    table = {"name": "ts1", "network": "tunnel", "source": "file:ts1.gsi"}
    table |= {"grammar": "gsi-online", "targets": list(station.targets)}
    (settings,) = read_instruments([table], where="site.toml", folder=tmp_path)
    posted = [[], []]
    for number, expected in ((70, 1), (len(lines), 3)):
        path.write_bytes(b"".join(x.text + b"\n" for x in lines[:number]))
        of, stop, found = Instrument(settings), Event(), posted[number > 70]
        thread = Thread(target=of.run, args=(found.append, stop))
        thread.start()
        for _ in range(500):
            if of.health.counts["lines"] == number and len(found) >= expected:
                break
            stop.wait(0.02)
        stop.set()
        thread.join(10)
        assert len(found) == expected
    assert posted[0][0].request == posted[1][0].request
    assert len({p.request for p in posted[1]}) == 3


def test_a_run_after_a_fault_of_the_program_loses_and_doubles_nothing(received, tmp_path):
    lines, station = received
    of, posted = instrument(station, tmp_path, lines, 100), []
    with suppress(Killed):
        of.run(posted.append, Event())
    of.source = Lines(lines[100:])
    of.run(posted.append, Event())
    whole = tmp_path / "whole"
    whole.mkdir()
    assert [p.record for p in posted] == [p.record for p in run(instrument(station, whole, lines))]
    assert of.health.counts["doubled"] == 0


def test_a_line_that_was_cut_is_passed_over_and_another_file_refused(tmp_path):
    log = LineLog(tmp_path / "a.lines")
    line = ReceivedLine(bytes(range(256)).replace(b"\n", b""), 12.5, 7, channel="x")
    log.append(line)
    with log.path.open("a") as stream:
        stream.write('[12.5, 8, "x", "half')
    again = LineLog(log.path)
    assert list(again.lines()) == [line]
    again.append(line)
    assert list(LineLog(log.path).lines()) == [line, line]
    again.keep([])
    assert list(LineLog(log.path).lines()) == []
    log.path.write_text("name,x\nA,1\n")
    with pytest.raises(InputError, match=r"a\.lines:1: is no line of a log"):
        list(LineLog(log.path).lines())


def test_a_disk_that_takes_nothing_is_told(received, tmp_path):
    lines, station = received
    of = instrument(station, tmp_path / "absent", lines)
    assert len(run(of)) == 3
    assert of.health.counts["not_kept"] == len(lines)
    assert "no such file or folder" in of.health.problem


@pytest.mark.parametrize("other", ["a.lines", "./a.lines"])
def test_two_instruments_have_no_log_together(tmp_path, other):
    table = {"network": "n", "source": "tcp://127.0.0.1:9", "grammar": "gsi-online"}
    kept = {"ts1": "a.lines", "ts2": other}
    tables = [{**table, "name": name, "keep_lines": file} for name, file in kept.items()]
    with pytest.raises(InputError, match="that of another instrument"):
        read_instruments(tables, where="site.toml")
