"""Field books of Topcon in the string GTS-6: blocks, check sums, units, heights behind targets."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.units import FOOT, GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, TARGET, sights

TENTH_MM = 1e-4


def target(name: str, hz: float, zenith: float, distance: float, *, unit: str = "g") -> str:
    """Return a target; degrees or gon, metres."""
    numbers = []
    for angle in (zenith, hz):
        if unit == "g":
            numbers.append(f"{round(angle / GON * 1e4):07d}")
        else:
            seconds = round(math.degrees(angle) * 3600)
            numbers.append(f"{seconds // 3600:03d}{seconds // 60 % 60:02d}{seconds % 60:02d}")
    flat = distance * abs(math.sin(zenith))
    readings = f"?+{round(distance * 1e3):08d}m{numbers[0]}+{numbers[1]}{unit}"
    return f"_+{name}_ {readings}+{round(flat * 1e3):08d}t60+00+00103_*CODE_,{TARGET:.3f}"


def string(name: str = "S", *, unit: str = "g") -> str:
    """Return the small survey."""
    shots = "".join(
        target(s.target, s.direction, s.zenith, s.distance, unit=unit) for s in sights()
    )
    return f"_'{name}_(CODE_){HEIGHT:.3f}{shots}"


def blocks(text: str) -> str:
    """Return a string as blocks with their check sums."""
    out = []
    for i in range(0, len(text), 128):
        body = text[i : i + 128].ljust(128) + str(i // 128 % 10)
        check = 0
        for character in body:
            check ^= ord(character)
        out.append(f"\x02{body}{check:03d}\x03")
    return "\n".join([*out, "\x04"]) + "\n"


EXAMPLE_FILES = {
    "topcon gts6": Example(
        "topcon_gts6",
        {"book.210": string() + "   \n"},
        "book.210",
        unread=(r"\|value\|.*CODE",),
    ),
    "topcon gts6 blocks": Example("topcon_gts6", {"book.gt6": blocks(string())}, "book.gt6"),
}


def read(tmp_path, text: str, **options) -> fga.Network:
    """Read a text."""
    path = tmp_path / "book.210"
    path.write_bytes(text.encode())
    return fga.read(path, format="topcon_gts6", **options)


def test_blocks_are_the_string_that_they_cut(tmp_path):
    one, other = read(tmp_path, string()), read(tmp_path, blocks(string()))
    assert [o.value for o in one.observations.values()] == [
        o.value for o in other.observations.values()
    ]
    kinds = [o.kind for o in one.observations.values()]
    assert [kinds.count(k) for k in ("direction", "zenith_angle", "slope_distance")] == [3, 3, 3]
    first = next(iter(one.observations.values()))
    assert (first.instrument_height, first.target_height) == (HEIGHT, TARGET)
    sources = {o.source for o in other.observations.values()}
    assert {s.split(":")[1] for s in sources} == {"1", "2"}  # of the first face


@pytest.mark.parametrize("unit", ["g", "d"])
def test_angles_are_gon_or_degrees_minutes_and_seconds(tmp_path, unit):
    network = read(tmp_path, string(unit=unit), faces="both")
    found = [o.value for o in network.observations.values() if o.kind == "direction"]
    step = 1e-4 * GON if unit == "g" else math.radians(1 / 3600)
    true = sorted(s.direction for s in sights())
    assert sorted(found) == pytest.approx(true, abs=0.51 * step)


def test_a_height_of_a_target_stands_behind_it(tmp_path):
    """The last record of a real file: topcon_gts_229 of Total Open Station, gon and metres."""
    text = "_'_(_)1.540_+1_ ?+00043575m0970930+1317260g+00043530t**+00+00111_*_,1.500"
    text += "_+2_ ?+00064702m0968990+1360970g+00064625t**+00+00099_*_,1.600_"
    network = read(tmp_path, text, station="S")
    found = {
        (o.points(), round(o.value, 6), o.target_height) for o in network.observations.values()
    }
    assert (("S", "1"), 43.575, 1.5) in found
    assert (("S", "2"), 64.702, 1.6) in found
    assert {o.instrument_height for o in network.observations.values()} == {1.54}
    assert not network.remarks
    unnamed = read(tmp_path, text)
    assert "whose station is called 'station'" in unnamed.remarks[0]


def test_angles_alone_and_feet(tmp_path):
    text = "_'S_(_)5.000_+A_ <0900000+0300000d60+00_*_,1.000"
    text += "_+B_ ?+00100000f0900000+0600000d+00100000t60+00+00100_*_,1.000_"
    network = read(tmp_path, text)
    values = [(o.kind, o.points()[1], o.value) for o in network.observations.values()]
    assert ("slope_distance", "B", pytest.approx(100 * FOOT)) in values
    assert [v[0] for v in values if v[1] == "A"] == ["direction", "zenith_angle"]


def test_a_sight_of_a_station_to_itself_is_left_out(tmp_path):
    text = string() + target("S", 1.0, 1.5, 20.0)
    network = read(tmp_path, text)
    assert [left.names for left in network.left_out] == [("S",)]
    assert len(network.observations) == 9


def test_lines_between_blocks_are_refused(tmp_path):
    text = blocks(string()).replace("\n", "\nremark\n", 1)
    with pytest.raises(InputError, match=r"book\.210:2: 'remark' is no block"):
        read(tmp_path, text)


def test_horizontal_distances_and_check_sums_must_be_right(tmp_path):
    wrong = string().replace("t60", "5t60", 1).replace("+0", "+", 1)
    at = wrong.index("t60")
    wrong = string()[: at - 3] + "999" + string()[at:]
    with pytest.raises(InputError, match=r"book\.210:1: target 'A': the horizontal distance"):
        read(tmp_path, wrong)
    damaged = blocks(string()).replace("1.600", "1.700", 1)
    with pytest.raises(InputError, match=r"book\.210:1: the check sum of the block is \d{3}; its"):
        read(tmp_path, damaged)
    short = blocks(string()).replace("CODE_,1.600", "CODE_,1.6", 1)
    with pytest.raises(InputError, match=r"book\.210:1: a block must have 128 characters"):
        read(tmp_path, short)


def test_all_problems_are_listed(tmp_path):
    text = string().replace("_*CODE_,1.600", "", 1) + "_+X_ W+0001_+Y_ 17_'T_(_)x"
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    said = "\n".join(str(p) for p in caught.value.problems)
    for what in (
        "target 'A': code and height (_*CODE_,HEIGHT) are missing",
        "_+X_ W+0001_+Y_ 17_",
        'book.210:1: "_+Y_ 17_',
        "height of the instrument: 'x' is not a number",
    ):
        assert what in said


def test_recognition_asks_for_a_station_and_a_target(tmp_path):
    reader = READERS.named("topcon_gts6")
    texts = ((string(), 1), (blocks(string()), 1), ("_'S_(_)1.5 text", 0), ("_+1_ ?+1", 0), ("", 0))
    for i, (text, is_one) in enumerate(texts):
        path = tmp_path / f"{i}"
        path.write_bytes(text.encode())
        assert reader.recognises(path) == bool(is_one), i


def test_the_survey_is_that_of_the_readings(tmp_path):
    """Free network: distances between the known points, to the millimetres of the string."""
    solution = fga.adjust(read(tmp_path, string(), refraction=None))
    a, b = solution.point("A"), solution.point("B")
    assert math.dist(a, b) == pytest.approx(math.hypot(60, 10, 1), abs=0.003)
