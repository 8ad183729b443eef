"""An instrument as a whole: posts again what failed, survives any line, keeps no memory."""

from __future__ import annotations

import random
from threading import Event, Thread

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments import instrument as module
from factorgraph_adj.instruments.simulated_sites import tunnel
from factorgraph_adj.instruments.simulated_total_station import SimulatedObject

BEGIN = 1_790_000_000.0


def lines(sets, seed=0, **fault):
    site = tunnel()
    (station,) = site.total_stations(SimulatedObject(site.network), begin=BEGIN, seed=seed)
    if fault:
        station.switch_on("gross-error", at=0, **fault)
    out = []
    for line in station.lines():
        if line.time >= BEGIN + sets * station.interval:
            return out, station
        out.append(line)


def instrument(source="file:x", **keys):
    table = {"name": "ts1", "network": "tunnel", "source": source, "grammar": "gsi-online"}
    table |= {"station": "S1", "clock": "stated", **keys}
    return read_instruments([table], where="site.toml")[0]


class Lines:
    """A source of lines that are there."""

    def __init__(self, found):
        self.found = found

    def lines(self, stop, health):
        for n, line in enumerate(self.found, 1):
            yield ReceivedLine(line.text, line.time, n)
        while not stop.is_set():
            yield None
            stop.wait(0.01)


def test_postings_that_failed_are_posted_again_in_their_order(monkeypatch):
    monkeypatch.setattr(module, "RETRY_S", 0.02)
    found, station = lines(3)
    of = Instrument(instrument(targets=list(station.targets)), source=Lines(found))
    posted, tried, stop = [], [], Event()

    def post(posting):
        tried.append(posting.request)
        if len(tried) in (1, 2):
            raise ConnectionError("the database is away")
        if len(tried) == 4:
            raise InputError("unknown point")
        posted.append(posting.request)
        if len(posted) == 2:
            stop.set()

    of.run(post, stop)
    first, second, third = dict.fromkeys(tried)
    assert tried == [first, first, first, second, third]
    assert posted == [first, third]
    assert of.health.counts["not_posted"] == 2 and of.health.counts["refused_postings"] == 1
    assert of.health.state == "stopped"


def test_events_have_times_of_receipt():
    """Also where the clock of the instrument is played at speed, hours ahead."""
    found, station = lines(2, target="T1.2", reading="distance", size_mm=25)
    of = Instrument(instrument(targets=list(station.targets)))
    received = [BEGIN - 7200.0 + 0.01 * n for n in range(len(found))]
    for n, (line, at) in enumerate(zip(found, received, strict=True), 1):
        of.take(ReceivedLine(line.text, at, n))
    (doubt,) = [e for e in of.health.events if e.count == "doubtful_faces"]
    assert doubt.time in received
    assert of.health.problem_time in received


def test_without_targets_a_set_ends_with_the_next():
    found, station = lines(3)
    of, out = Instrument(instrument()), []
    for n, line in enumerate(found, 1):
        out += of.take(ReceivedLine(line.text, line.time, n))
    assert [p.lines for p in out] == [tuple(range(1, 49)), tuple(range(49, 97))]
    out += of.finish()
    named = Instrument(instrument(targets=list(station.targets)))
    expected = [
        p
        for n, line in enumerate(found, 1)
        for p in named.take(ReceivedLine(line.text, line.time, n))
    ]
    assert [p.record for p in out] == [p.record for p in expected]


def test_a_pause_ends_a_set_that_lacks_a_face():
    found, station = lines(1)
    of = Instrument(instrument(targets=list(station.targets), set_pause="1 min"))
    for n, line in enumerate(found[:-3], 1):
        assert of.take(ReceivedLine(line.text, line.time, n)) == []
    last = found[-4].time
    assert of.pause(last + 59) == []
    (posting,) = of.pause(last + 61)
    assert len(posting.record["observations"]) == 3 * len(station.targets)
    late = [p for line in found[-3:] for p in of.take(ReceivedLine(line.text, last + 70, 99))]
    assert late == [] and len(of.finish()[0].record["observations"]) == 9


def test_no_line_stops_an_instrument():
    """Each byte of a line changed: it is refused, or read as another reading; nothing is raised."""
    found, station = lines(1)
    draw = random.Random(5)
    of = Instrument(instrument(targets=list(station.targets)))
    number = 0
    for line in found * 6:
        text = bytearray(line.text)
        for _ in range(draw.randrange(4)):
            at = draw.randrange(len(text))
            text[at : at + draw.randrange(3)] = bytes(draw.choices(range(256), k=draw.randrange(3)))
        number += 1
        of.take(ReceivedLine(bytes(text), line.time + number, number))
    of.finish()
    counts = of.health.counts
    assert counts["lines"] == number
    assert 20 < counts["refused"] < number


def test_memory_does_not_grow_with_sets():
    found, station = lines(2)
    of = Instrument(instrument(targets=list(station.targets)))
    size = []
    for turn in range(30):
        for n, line in enumerate(found):
            text = line.text.replace(b"*11", b"*11", 1)[:5] + line.text[5:]
            of.take(ReceivedLine(text + b"71....+%016d " % turn, line.time + 1200 * turn, n))
        size.append((len(of.sets.sets), of.sets._book is None))
    assert of.health.counts["postings"] == 60
    assert set(size) == {(0, True)}
    assert len(of.health.events) <= 200


@pytest.mark.parametrize("sets", [2])
def test_a_restart_in_the_middle_posts_whole_sets_once(sets):
    """The file is read again from its beginning: what was posted has the requests that it had."""
    found, station = lines(sets)
    keys = {"targets": list(station.targets)}
    first, again = Instrument(instrument(**keys)), Instrument(instrument(**keys))
    a = [p for n, x in enumerate(found[:70], 1) for p in first.take(kept(x, n, 0.0))]
    b = [p for n, x in enumerate(found, 1) for p in again.take(kept(x, n, 9000.0))]
    assert [p.request for p in a] == [p.request for p in b][:1]
    assert len(b) == sets


def kept(line, number, later):
    return ReceivedLine(line.text, line.time + later, number, place=f"line {number}")


def test_a_thread_ends_within_a_second():
    of, stop = Instrument(instrument(source="tcp://127.0.0.1:9")), Event()
    thread = Thread(target=of.run, args=(lambda posting: None, stop))
    thread.start()
    stop.wait(0.1)
    stop.set()
    thread.join(1.0)
    assert not thread.is_alive()
