"""Rules of times, doubled and late lines, gaps: each as its sentence says."""

from __future__ import annotations

import pytest

from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.health import Health
from factorgraph_adj.instruments.message_rules import InstrumentClock, MessageGaps, RepeatedLines
from factorgraph_adj.instruments.readings import Sight

BEGIN = 1_790_000_000.0


def clock(offset=0.0, tolerance=5.0):
    return InstrumentClock(Health("ts1"), offset=offset, tolerance=tolerance)


def times(of, pairs):
    return [of.time(BEGIN + s, BEGIN + r) - BEGIN for s, r in pairs]


def test_the_smallest_delay_is_the_offset():
    of = clock()
    assert times(of, [(0, 2.0), (10, 10.4), (20, 23.0)]) == pytest.approx([2.0, 10.4, 20.4])
    assert of.health.clock_offset == pytest.approx(0.4)
    assert of.health.counts["clock_jumps"] == 0


def test_a_stamp_of_the_future_is_a_jump_forward():
    of = clock()
    found = times(of, [(0, 0.2), (10, 10.2), (3620, 20.2), (3630, 30.2)])
    assert found == pytest.approx([0.2, 10.2, 20.2, 30.2])
    (event,) = of.health.events
    assert event.what == "the clock of the instrument jumped forward by 3600.0 s"


def test_three_stamps_that_agree_are_a_jump_back():
    of = clock()
    found = times(of, [(0, 0), (10, 10), (-580, 20), (-570, 30), (-560, 40), (-550, 50)])
    assert found == pytest.approx([0, 10, -580, -570, 40, 50])
    assert of.health.counts["clock_jumps"] == 1


def test_an_outage_is_no_jump_and_its_lines_keep_their_times():
    of = clock()
    stamps = [10.0 * i for i in range(60)]
    pairs = [(0, 0.1)] + [(s, 86_400 + 0.01 * i) for i, s in enumerate(stamps)]
    pairs += [(86_410, 86_410.1), (86_420, 86_420.1)]
    found = times(of, pairs)
    assert found[1:61] == pytest.approx([s + 0.1 for s in stamps])
    assert found[61:] == pytest.approx([86_410.1, 86_420.1])
    assert of.health.counts["clock_jumps"] == 0


def line(text, received, number=1, place=""):
    return ReceivedLine(text.encode(), BEGIN + received, number, place=place)


@pytest.mark.parametrize(
    "identity, place, pauses, doubled",
    [
        ("0012", "", [0, 3600], [False, True]),
        ("", "", [0, 1, 1], [False, True, True]),
        ("", "", [0, 60], [False, False]),
        ("", "line 7", [0, 0], [False, False]),
        ("0012", "line 7", [0, 0], [False, True]),
    ],
)
def test_doubled_lines(identity, place, pauses, doubled):
    rule, at, found = RepeatedLines(2.0), 0.0, []
    reading = Sight(target="A", identity=identity)
    for pause in pauses:
        at += pause
        found.append(rule.is_doubled(line("x", at, place=place), [reading]))
    assert found == doubled


def test_gaps_are_counted_once_and_told_twice():
    health = Health("ts1", state="receiving")
    gaps = MessageGaps(health, 60.0)
    for at in (0, 30, 60):
        gaps.message(BEGIN + at)
    for at in (90, 130, 160, 190):
        gaps.pause(BEGIN + at)
    assert health.state == "silent" and health.counts["gaps"] == 1
    gaps.message(BEGIN + 200)
    assert health.state == "receiving" and health.counts["gaps"] == 1
    assert [e.what.split()[0] for e in health.events] == ["no", "messages"]


SIGHT = (
    "11{n:04d}+0000000A 18....+26{s:02d}0000 19....+092114{m:02d} 21.322+1234{n:04d} "
    "22.322+09876543 31...0+00051234 "
)


def instrument(**keys):
    table = {"name": "ts1", "network": "dam", "source": "file:x.gsi", "grammar": "gsi-online"}
    table |= {"station": "P", "targets": ["A"], "faces": 1}
    return Instrument(read_instruments([{**table, **keys}], where="site.toml")[0])


def test_a_repeated_line_has_the_request_that_it_had():
    """Also after a restart, and when the line comes at another time."""
    text = SIGHT.format(n=7, s=31, m=20)
    first, second = instrument(), instrument()
    (a,) = first.take(line(text, 420.0))
    (b,) = second.take(line(text, 990.0, number=4))
    assert a.request == b.request
    assert [r["set"] for r in a.record["observations"] if "set" in r] == [
        "ts1 2026-09-21T14:20:31Z"
    ]
    assert first.take(line(text, 425.0)) == []
    assert first.health.counts["doubled"] == 1


def test_lines_of_a_file_have_the_request_of_their_place():
    text = "11....+0000000A 21.322+12345678 22.322+09876543 31...0+00051234 "
    (a,) = instrument().take(line(text, 0.0, place="line 3"))
    (b,) = instrument().take(line(text, 900.0, place="line 3"))
    (c,) = instrument().take(line(text, 900.0, place="line 4"))
    assert a.request == b.request != c.request


def test_late_lines_keep_their_times_and_are_told():
    of = instrument()
    received = [11.0, 21.0, 7200.0, 7200.1, 7260.0]
    stamps = [(0, 0), (0, 10), (1, 0), (1, 10), (61, 10)]
    out = []
    for n, (r, (m, s)) in enumerate(zip(received, stamps, strict=True)):
        # 14:14:00 is 41 s after BEGIN, 14:13:19
        hour, minute = divmod(14 + m, 60)
        text = SIGHT.format(n=n, s=s, m=minute).replace("092114", f"0921{14 + hour:02d}")
        out += of.take(line(text, r + 40.0, number=n))
    assert [p.time - BEGIN for p in out][2:4] == pytest.approx([100.0, 110.0], abs=2.0)
    assert of.health.counts["late"] >= 2
    assert "late by 7" in "".join(e.what for e in of.health.events)
