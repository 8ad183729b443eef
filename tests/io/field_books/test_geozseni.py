"""Field book of GeoZseni: readings of both faces, means where there is one face alone."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.geozseni import READER
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, TARGET, sights

STATION = "AP,S,,{:.3f},2010.11.13.,book.gsi,,,,\n"


def packed(angle: float) -> str:
    """Return an angle as packed degrees with a millionth of a second."""
    total = round(math.degrees(angle) * 3600 * 10**6)
    seconds, rest = divmod(total, 10**6)
    minutes, s = divmod(seconds, 60)
    degrees, m = divmod(minutes, 60)
    return f"{degrees:03d}.{m:02d}{s:02d}{rest:06d}"


def geozseni() -> str:
    """Return the sights of the survey of all field books; the format has no coordinates."""
    rows = ["GJK,2\n", "\n", STATION.format(HEIGHT)]
    found = sights()
    for one, two in zip(found[:3], found[3:], strict=True):
        circles = [
            f"{packed(a)},{packed(b)},"
            for a, b in ((one.direction, two.direction), (one.zenith, two.zenith))
        ]
        lengths = f"{one.distance:.6f},{two.distance:.6f},{one.distance:.6f}"
        rows.append(f"AM,{one.target},,{TARGET},{','.join(circles)},{lengths}\n")
    rows.append(f"RM,20,654,{TARGET},,,{packed(1.0)},,,{packed(1.5)},,,20.5\n")
    return "".join(rows)


EXAMPLE_FILES = {
    "geozseni": Example("geozseni", {"book.gjk": geozseni()}, "book.gjk", unread=(r"\|AP,",))
}


def book(tmp_path, text: str, **options: object) -> fga.Network:
    """Return the network of a text."""
    path = tmp_path / "b.gjk"
    path.write_text(text, encoding="utf-8")
    return fga.read(path, format="geozseni", **options)


def test_both_faces_are_reduced_and_their_means_are_not_read(tmp_path):
    network = book(tmp_path, geozseni())
    both = book(tmp_path, geozseni(), faces="both")
    assert (len(network.observations), len(both.observations)) == (12, 18)  # distances are means
    of = {(o.target, o.kind): o for o in network.observations.values()}
    assert (of["A", "direction"].instrument_height, of["A", "direction"].target_height) == (
        HEIGHT,
        TARGET,
    )
    spoiled = geozseni().replace(",,,20.5", ",,,30.5")  # the mean of a sight without faces
    assert of["20", "slope_distance"].value == 20.5
    changed = {(o.target, o.kind): o for o in book(tmp_path, spoiled).observations.values()}
    assert changed["20", "slope_distance"].value == 30.5


def test_means_alone_are_readings_of_one_face(tmp_path):
    text = "GJK,2\nAP,1,,1.5,,,,,,\nRM,2,,1.3,,,009.4438,,,089.5601,,,174.578\n"
    of = {o.kind: o.value for o in book(tmp_path, text).observations.values()}
    assert of["direction"] == pytest.approx(math.radians(9 + 44 / 60 + 38 / 3600))
    assert of["zenith_angle"] == pytest.approx(math.radians(89 + 56 / 60 + 1 / 3600))
    assert of["slope_distance"] == 174.578


def test_sixty_seconds_are_a_minute_more(tmp_path):
    """The program rounds seconds after it has separated minutes: 334.1560 is 334° 16′."""
    text = "GJK,2\nAP,1,,1.5,,,,,,\nRM,2,,1.3,,,334.1560,,,089.5960,,,10\n"
    of = {o.kind: o.value for o in book(tmp_path, text).observations.values()}
    assert of["direction"] == pytest.approx(math.radians(334 + 16 / 60))
    assert of["zenith_angle"] == pytest.approx(math.radians(90))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("GJK,3\n", "b.gjk:1: 'GJK,3' must be GJK,2, the version, in the first line alone"),
        ("GJK,2\nXM,1\n", "b.gjk:2: record 'XM' is unknown; valid: AP, AM, RM"),
        ("GJK,2\nAP,1\nRM,2,,,,,1.6000\n", "b.gjk:3: horizontal reading: '1.6000' has 60"),
        ("GJK,2\nRM,2,,,,,1.0000\n", "b.gjk:2: 1 sight from here has no station"),
    ],
)
def test_wrong_records_are_refused_with_their_line(tmp_path, text, said):
    with pytest.raises(InputError) as refused:
        book(tmp_path, text)
    assert said in str(refused.value)


def test_the_book_is_recognised_by_its_version(tmp_path):
    path = tmp_path / "book.txt"
    path.write_text(geozseni(), encoding="utf-8")
    assert READER.recognises is not None and READER.recognises(path)
    path.write_text("AR GEODIMETER 510\nFN B.& Co.\nDT 1995.06.15.\n", encoding="utf-8")
    assert not READER.recognises(path)


def test_held_points_need_coordinates(tmp_path):
    with pytest.raises(InputError, match="the file has no coordinates of point 'A'"):
        book(tmp_path, geozseni(), **HELD)
