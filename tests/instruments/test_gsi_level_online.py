"""A digital level on line: set-ups become height differences between named points."""

import math

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import Instrument, ReceivedLine, read_instruments
from factorgraph_adj.instruments.grammars import grammar_record
from factorgraph_adj.instruments.gsi_level_online import GsiLevelOnline
from factorgraph_adj.io.field_books.gsi import read_gsi

BF, BFFB = "410001+?......1", "410001+?......2"
RESULTS = "110009+{:0>8} 573..8-00000300 574..8+00006000 83..08+09912345"


def reading(point, word, metres, length=30.0):
    value = f"{round(abs(metres) * 1e5):08d}"
    sign = "-" if metres < 0 else "+"
    distance = f" 32...8+{round(length * 1e5):08d}" if length else ""
    return f"110002+{point:0>8}{distance} {word}.28{sign}{value}"


def setup(back, fore, a, b, length=30.0):
    return [reading(back, "331", a, length), reading(fore, "332", b, length)]


def taken(grammar, texts):
    out = []
    for number, text in enumerate(texts, 1):
        for found in grammar.read(ReceivedLine(text.encode(), 0.0, number)):
            out += [(number, o) for o in found.observations]
    return out


def test_a_set_up_is_observed_with_its_results():
    lines = [BF, *setup("A", "B", 1.5, 1.2), RESULTS.format("B"), *setup("B", "C", 0.9, 1.4)]
    ((number, o),) = taken(GsiLevelOnline(sigma_levelling_mm=0.3), lines)
    assert number == 4  # the line with the results
    assert (o.kind, o.station, o.target) == ("height_difference", "A", "B")
    assert (o.value, o.length_km) == pytest.approx((0.3, 0.06))
    assert o.sigma.per_sqrt_km == pytest.approx(0.3e-3)


def test_without_results_the_next_set_up_or_line_completes_it():
    lines = [BF, *setup("A", "B", 1.5, 1.2), *setup("B", "C", 0.9, 1.4), BF]
    found = [(n, o.station, o.target) for n, o in taken(GsiLevelOnline(), lines)]
    assert found == [(4, "A", "B"), (6, "B", "C")]


def test_two_readings_of_each_staff_are_means():
    lines = [
        BFFB,
        reading("A", "331", 1.50),
        reading("B", "332", 1.20),
        reading("B", "336", 1.22),
        reading("A", "335", 1.54),
        RESULTS.format("B"),
    ]
    ((_, o),) = taken(GsiLevelOnline(), lines)
    assert o.value == pytest.approx(1.52 - 1.21)


def test_turning_points_are_no_points():
    lines = [
        BF,
        *setup("A", "0", 1.5, 1.2, 20.0),
        *setup("0", "0", 1.1, 1.7, 0.0),
        *setup("0", "B", 2.0, 1.9, 25.0),
        RESULTS.format("B"),
    ]
    ((_, o),) = taken(GsiLevelOnline(), lines)
    assert (o.station, o.target) == ("A", "B")
    assert o.value == pytest.approx(0.3 - 0.6 + 0.1)
    assert o.length_km == pytest.approx(0.04 + 0.06 + 0.05)


def test_a_reading_that_comes_again_replaces_the_one_before():
    lines = [
        BF,
        reading("A", "331", 1.5),
        reading("A", "331", 1.6),
        reading("B", "332", 1.2),
        RESULTS.format("B"),
    ]
    ((_, o),) = taken(GsiLevelOnline(), lines)
    assert o.value == pytest.approx(0.4)


def test_the_reader_of_files_has_the_same(tmp_path):
    lines = [
        BF,
        *setup("A", "B", 1.5, 1.2),
        RESULTS.format("B"),
        *setup("B", "C", 0.9, 1.4),
        reading("D", "333", 1.0),
        RESULTS.format("C"),
        BF,
    ]
    (tmp_path / "x.gsi").write_text("\n".join([*lines[:-1], ""]))
    of_file = read_gsi(tmp_path / "x.gsi").observations.values()
    online = [o for _, o in taken(GsiLevelOnline(), lines)]
    shown = [
        sorted((o.station, o.target, round(o.value, 9), o.length_km) for o in found)
        for found in (of_file, online)
    ]
    assert shown[0] == shown[1]
    assert len(shown[0]) == 3


def test_a_wrong_line_changes_nothing():
    grammar = GsiLevelOnline()
    assert taken(grammar, [BF, reading("A", "331", 1.5)]) == []
    for wrong, message in (
        ("rubbish", "not a word of GSI"),
        ("110002+0000000B 332.28+0012", "not a word of GSI"),
        ("110002+0000000B 21.322+16901313", "no reading of a staff"),
        ("21.322+16901313", "must begin with word 11 or 41"),
        (reading("C", "333", 1.0).replace("333", "999"), "word 99 cannot stand"),
    ):
        with pytest.raises(InputError, match=message):
            taken(grammar, [wrong])
    ((_, o),) = taken(grammar, [reading("B", "332", 1.2), RESULTS.format("B")])
    assert o.value == pytest.approx(0.3)


def test_a_line_that_lacks_a_foresight_is_told_and_the_next_begins():
    grammar = GsiLevelOnline()
    taken(grammar, [BF, reading("A", "331", 1.5)])
    with pytest.raises(InputError, match="ends with a backsight alone"):
        taken(grammar, [BF])
    found = taken(grammar, [*setup("K", "L", 1.0, 1.25), RESULTS.format("L")])
    assert [(o.station, o.target) for _, o in found] == [("K", "L")]
    assert found[0][1].value == pytest.approx(-0.25)


def test_gsi_16_and_other_units():
    lines = [
        "*410001+?..............1",
        "*110002+000000000000000A 32...0+0000000000030000 331.08+0000000000150000",
        "*110003+000000000000000B 32...0+0000000000030000 332.08+0000000000120000",
        "*110004+000000000000000B 574..8+0000000000006000",
    ]
    ((_, o),) = taken(GsiLevelOnline(), lines)
    assert (o.value, o.length_km) == pytest.approx((0.3, 0.06))


def test_a_level_is_an_instrument_of_a_site():
    table = {
        "name": "dna",
        "network": "dam",
        "source": "serial:/dev/ttyUSB0",
        "grammar": "gsi-level",
        "sigma_levelling_mm": 0.3,
        "rename": {"A": "B1"},
    }
    (settings,) = read_instruments([table], where="site.toml")
    instrument = Instrument(settings)
    posted = []
    for i, text in enumerate([BF, *setup("A", "B", 1.5, 1.2), RESULTS.format("B")]):
        posted += instrument.take(ReceivedLine(text.encode(), 1.8e9 + i, i + 1))
    (record,) = posted[0].record["observations"]
    assert (record["station"], record["target"]) == ("B1", "B")
    assert math.isclose(float(record["value"]), 0.3)
    assert instrument.health.counts["refused"] == 0
    assert grammar_record("gsi-level").make is GsiLevelOnline
