"""GSI online: the same lines as a file and as a stream give the same observations."""

from __future__ import annotations

from collections import Counter
from threading import Event

import pytest

import factorgraph_adj as fga
from factorgraph_adj.instruments import Instrument, ReceivedLine, Sight, read_instruments
from factorgraph_adj.instruments.gsi_online import GsiOnline
from factorgraph_adj.instruments.line_sources import FileSource
from factorgraph_adj.io.observation_records import observation_from_record
from tests.support.places import data_dir

STATION = "11....+00000000P1 "


def gsi_word(index, value, size=8, info="..", unit="0"):
    digits = f"{abs(value):0{size}d}" if isinstance(value, int) else value.rjust(size, "0")
    sign = "-" if isinstance(value, int) and value < 0 else "+"
    return (
        f"{index}..{info[0]}{unit}{sign}{digits}" if len(index) == 2 else f"{index}{info}{digits}"
    )


def block(name, *words):
    return " ".join([f"11....+{name.rjust(8, '0')}", *words]) + " "


def sight(name, hz, v, s, height=None):
    """Return a block: gon, gon, metres."""
    words = [gsi_word("21", round(hz * 1e5), unit="2"), gsi_word("22", round(v * 1e5), unit="2")]
    words.append(gsi_word("31", round(s * 1e4), unit="6"))
    words += [] if height is None else [gsi_word("87", round(height * 1e3))]
    return block(name, *words)


def two_faces(targets, set_ups=1, index=0.0021, collimation=0.0013, height=1.2):
    """Return the sights of rounds in two faces: A1 B1 … B2 A2."""
    lines = []
    for n in range(set_ups):
        turned = 0.3 * n
        first = [(t, hz + turned, z, s) for t, (hz, z, s) in targets.items()]
        for t, hz, z, s in first:
            lines.append(sight(t, (hz - collimation) % 400, z + index, s, height))
        for t, hz, z, s in reversed(first):
            second = (hz + 200 + collimation) % 400
            lines.append(sight(t, second, 400 - z + index, s + 0.0003, height))
    return lines


TARGETS = {"A": (12.3456, 98.7654, 51.2345), "B": (112.5, 101.0, 80.1), "C": (377.2, 99.5, 33.3)}
BEGIN = block("P1", gsi_word("84", 100_000), gsi_word("85", 200_000), gsi_word("86", 10_000),
              gsi_word("88", 1_534))  # fmt: skip


def instrument(**keys):
    table = {"name": "ts1", "network": "dam", "source": "file:x.gsi", "grammar": "gsi-online"}
    (settings,) = read_instruments([{**table, **keys}], where="site.toml")
    return Instrument(settings)


def taken(of, lines, begin=1_790_000_000.0, step=10.0):
    """Return the postings of lines that come every ten seconds, and those at their end."""
    out = []
    for number, text in enumerate(lines, 1):
        line = ReceivedLine(text.encode(), begin + step * number, number)
        out += of.take(line)
    return out + of.finish()


def observations(postings):
    return [observation_from_record(r) for p in postings for r in p.record["observations"]]


def compared(observation):
    """Return what of an observation does not depend on names of sets and files."""
    leave = ("set", "source", "id")
    return {k: v for k, v in vars(observation).items() if k not in leave} | {
        "kind": observation.kind
    }


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_sets_are_those_of_the_reader_of_files(tmp_path, rounds):
    lines = [BEGIN, *two_faces(TARGETS, rounds)]
    (tmp_path / "book.gsi").write_text("\n".join(lines) + "\n")
    network = fga.read(tmp_path / "book.gsi")
    of = instrument(targets=["A", "B", "C"])
    postings = taken(of, lines)
    assert len(postings) == rounds
    found = observations(postings)
    assert [compared(o) for o in found] == [compared(o) for o in network.observations.values()]
    assert len({o.set for o in found if o.kind == "direction"}) == rounds
    assert of.health.counts["refused"] == 0


def test_a_face_that_is_missing_is_reduced_as_in_a_file(tmp_path):
    lines = [BEGIN, *two_faces(TARGETS)[:-1]]
    (tmp_path / "book.gsi").write_text("\n".join(lines) + "\n")
    network = fga.read(tmp_path / "book.gsi")
    found = observations(taken(instrument(targets=["A", "B", "C"]), lines))
    assert [compared(o) for o in found] == [compared(o) for o in network.observations.values()]


def test_station_and_height_come_from_the_mapping_where_no_line_has_them():
    lines = two_faces(TARGETS, height=None)
    keys = {
        "station": "P9",
        "instrument_height": 0.25,
        "target_heights": {"default": 0.1, "B": 0.2},
    }
    found = observations(taken(instrument(**keys, rename={"A": "crest 1"}), lines))
    assert {o.station for o in found} == {"P9"}
    assert {o.instrument_height for o in found} == {0.25}
    assert {o.target: o.target_height for o in found} == {"crest 1": 0.1, "B": 0.2, "C": 0.1}


def test_sights_without_any_station_are_refused_and_told():
    of = instrument()
    assert taken(of, two_faces(TARGETS)) == []
    assert of.health.counts["refused"] == 6
    assert "station = NAME" in of.health.problem


def test_gsi_16_time_number_and_ppm_are_read():
    line = (
        "*110023+000000000000D101 18....+0000000026310000 19....+0000000011290214 "
        "21.322+0000000001234567 22.322+0000000009876543 31..06+0000000000512345 "
        "51....+000000000017+000 87..10+0000000000001200 "
    )
    (found,) = GsiOnline().read(ReceivedLine(line.encode(), 0.0, 1))
    assert isinstance(found, Sight)
    assert found.target == "D101"
    assert found.applied_ppm == 17.0
    assert found.identity.startswith("0023")
    assert found.stamped == 1795918471.0  # 2026-11-29T02:14:31Z
    assert found.distance == 51.2345


@pytest.mark.parametrize(
    "text, why",
    [
        ("%R1P,0,0:0", "not a word of GSI"),
        ("11....+0000000A 21.322+1234x678 ", "whole number"),
        ("11....+0000000A 21.322+123456", "not a word of GSI"),  # the end of the line is lost
        ("11....+0000000A 21.327+12345678 ", "unit"),
        ("11....+0000000A 332...+00123456 ", "staff"),
        ("21.322+12345678 ", "must begin with word 11 or 41"),
        ("11....+0000000A 18....+26990000 19....+11290214 21.322+12345678 ", "no time"),
        ("\x00\xff\xfe garbage", "not a word of GSI"),
    ],
)
def test_what_is_not_gsi_is_refused_with_the_reason(text, why):
    of = instrument(station="P")
    assert of.take(ReceivedLine(text.encode("latin-1"), 10.0, 7)) == []
    assert of.health.counts["refused"] == 1
    assert why in of.health.problem and "line 7" in of.health.problem


@pytest.mark.parametrize(
    "name, keys, doubled",
    [
        ("RILIEVO.gsi", {"station": "S"}, 0),
        ("leica_gsi16_gurob.gsi", {"station": "S"}, 23),
        ("geoeasy_network.GSI", {"station_code": "21"}, 0),
    ],
)
def test_real_files_come_as_streams_with_the_observations_of_the_reader(name, keys, doubled):
    """Files of Total Open Station and GeoEasy; 23 blocks of one of them stand in it twice."""
    path = data_dir("field_files") / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    network = fga.read(path, **keys)
    of = instrument(**keys)
    of.source = FileSource(path, follow=False)
    found = observations(p for p in of.postings(Event()) if p is not None)
    assert of.health.counts["refused"] == 0
    assert of.health.counts["doubled"] == doubled
    file = Counter(repr(sorted(compared(o).items())) for o in network.observations.values())
    stream = Counter(repr(sorted(compared(o).items())) for o in found)
    assert stream - file == Counter()
    assert (file - stream).total() == 3 * doubled


def per_target(lines):
    """Return the sights of a set in the order A1 A2 B1 B2 …."""
    n = len(lines) // 2
    return [line for i in range(n) for line in (lines[i], lines[2 * n - 1 - i])]


@pytest.mark.parametrize("order", [list, per_target])
@pytest.mark.parametrize("hidden, pause", [(0, 400.0), *((i, 10.0) for i in range(1, 6))])
@pytest.mark.parametrize("named", [True, False])
def test_a_hidden_prism_mixes_no_faces_of_two_sets(order, hidden, pause, named):
    """Sets after one that lacks a sight are as they are without it.

    Where the first sight is hidden, the pause before the next set alone tells that its first sight
    is another.
    """
    keys = {"targets": ["A", "B", "C"]} if named else {}
    sets = [  # the orientation of each set tells it
        order(two_faces({t: (hz + i, z, s) for t, (hz, z, s) in TARGETS.items()})) for i in range(4)
    ]
    lacking = [line for i, line in enumerate(sets[1]) if i != hidden]
    of, postings, at = instrument(**keys), [], 1.79e9
    for lines in ([BEGIN, *sets[0]], lacking, sets[2], sets[3]):
        at += pause
        for text in lines:
            at += 10.0
            postings += of.take(ReceivedLine(text.encode(), at, 1))
    postings += of.finish()
    assert len(postings) == 4
    for i, posting in enumerate(postings):
        alone = taken(instrument(**keys), [BEGIN, *(lacking if i == 1 else sets[i])])
        found, expected = observations([posting]), observations(alone)
        assert [compared(o) for o in found] == [compared(o) for o in expected]


def test_repeated_readings_are_rounds_of_one_pass(tmp_path):
    lines = [line for line in two_faces(TARGETS) for _ in range(2)]
    lines = [BEGIN, *(f"11{n:04d}{line[6:]}" for n, line in enumerate(lines))]
    (tmp_path / "book.gsi").write_text("\n".join(lines) + "\n")
    network = fga.read(tmp_path / "book.gsi")
    of = instrument(targets=["A", "B", "C"], readings=2)
    postings = taken(of, lines)
    assert len(postings) == 2
    found = observations(postings)
    assert [compared(o) for o in found] == [compared(o) for o in network.observations.values()]
