"""Field book of FOIF: half seconds, stations without coordinates, derived coordinates."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.foif import HALF_SECOND, READER
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, sights

HEAD = " BOOK,6,6,9,10,23,15,38,53,0,0,6,0,10012,190,95,7,1,8,0,0,"
TIME = "1,9,10,23,15,38,25,"
RESULTS = "0.0000,0.0000,0.0000"
"""Coordinates of a sight in a file whose station has none."""


def foif() -> str:
    """Return the survey of all field books."""
    rows = [HEAD]
    rows += [f"B,{n},------,{y:.4f},{x:.4f},{z:.4f},0,{TIME}" for n, (x, y, z) in KNOWN.items()]
    rows += [f"A,S,0.0000,0.0000,0.0000,{HEIGHT:.4f},{TIME}", "D,S,A,512737,0,1,0,0,0," + TIME]
    for s in sights():
        circles = f"{s.direction / HALF_SECOND:.4f},{s.zenith / HALF_SECOND:.4f}"
        level, rise = s.distance * abs(math.sin(s.zenith)), s.distance * math.cos(s.zenith)
        lengths = f"{level:.4f},{s.distance:.6f},{rise:.4f},{TARGET:.4f}"
        rows += [f"U,{s.target},0,------,1,0,", f"F,{s.target},{circles},{lengths},{RESULTS},0,"]
    return "\r\n".join(rows) + "\r\n"


EXAMPLE_FILES = {
    "foif": Example(
        "foif",
        lambda _: {"book.mes": foif()},
        "book.mes",
        HELD,
        # First line, orientations, marks, ends of records.
        unread=(r"\|BOOK", r"\|[DU],", r"\|word\|"),
        is_field_book=True,
    )
}


def book(tmp_path, *rows: str, **options: object) -> fga.Network:
    """Return the network of records behind the first line."""
    path = tmp_path / "b.mes"
    path.write_text("\r\n".join((HEAD, *rows)) + "\r\n", encoding="ascii")
    return fga.read(path, format="foif", **options)


def test_readings_give_the_coordinates_of_the_instrument(tmp_path):
    """The first sight of 0407A2.mes of GeoEasy, whose coordinates are reproduced to 0.1 mm."""
    rows = [
        "A,AP6,205241.2990,603361.0280,115.0920,1.6450," + TIME,
        "F,KP4,1785782,652838,42.9758,42.9787,-0.5039,1.5550,205225.2176,603321.1745,114.6781,0,1,",
    ]
    network = book(tmp_path, *rows, fixed="AP6")
    network.set_orientation("AP6", set="1", value=0.0, fixed=True)
    found = fga.adjust(network).point("KP4")
    assert found == pytest.approx((603321.1745, 205225.2176, 114.6781), abs=1.5e-4)


def test_a_station_at_the_origin_is_unknown_and_a_default_reference_is_none(tmp_path):
    rows = [
        "B,DEFAULT,------,0.0000,0.0000,0.0000,1," + TIME,
        "A,S,0.0000,0.0000,0.0000,1.5," + TIME,
        "F,P,0,648000,10.0000,0.0000,0.0000,1.5,1.0,2.0,3.0,0,",
    ]
    network = book(tmp_path, *rows)
    assert set(network.points) == {"S", "P"}
    assert all(math.isnan(c) for p in network.points.values() for c in p.coordinates)
    assert {o.kind for o in network.observations.values()} == {"direction", "zenith_angle"}


def test_the_reading_to_a_reference_counts_where_no_sight_has_one(tmp_path):
    rows = [
        "A,S,0.0000,0.0000,0.0000,1.5," + TIME,
        "B,A,------,1.0000,2.0000,3.0000,0," + TIME,
        "C,A,512737,643092,42.9746,42.9776,0.5112,1.6450,13.8,40.6,0.4,0," + TIME,
        "C,DEFAULT,512737,643092,0.0000,0.0000,0.0000,0.0000,0.0,0.0,0.0,1," + TIME,
        "F,P,522743,643094,42.9746,42.9776,0.5112,1.6450,13.8,40.6,0.4,0," + TIME,
    ]
    alone = book(tmp_path, *rows)
    of = {o.target: o.value for o in alone.observations.values() if o.kind == "direction"}
    assert of == {"P": 522743 * HALF_SECOND, "A": 512737 * HALF_SECOND}
    network = book(tmp_path, *rows, rows[-1].replace("P,522743", "A,512743"))
    assert [(r.names, r.count, r.where) for r in network.left_out] == [(("A",), 1, "b.mes:4")]
    of = {o.target: o.value for o in network.observations.values() if o.kind == "direction"}
    assert of["A"] == 512743 * HALF_SECOND


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("X,P,1", "record 'X' is unknown; valid: A, C, B, F, H, G, D, E, U"),
        ("A,S,0.0,0.0,0.0", "height of the instrument is missing"),
        ("F,P,1,2,3,x,5,6,7,8,9", "slope distance: 'x' is not a number"),
        ("F,P,1,2,3,4,5,6,7,8,9", "1 sight from here has no station"),
    ],
)
def test_wrong_records_are_refused_with_their_line(tmp_path, row, said):
    with pytest.raises(InputError) as refused:
        book(tmp_path, row)
    assert f"b.mes:2: {said}" in str(refused.value)


def test_the_first_line_begins_with_a_blank(tmp_path):
    path = tmp_path / "b.mes"
    path.write_text(foif().lstrip(), encoding="ascii")
    with pytest.raises(InputError, match=r"b\.mes:1: the first line must begin with a blank"):
        fga.read(path, format="foif")


def test_the_book_is_recognised_whatever_the_suffix(tmp_path):
    path = tmp_path / "book.txt"
    path.write_text(foif(), encoding="ascii")
    assert READER.recognises is not None and READER.recognises(path)
    for other in (foif().lstrip(), " a,1,2,3\nA,1\n", ""):
        path.write_text(other, encoding="ascii")
        assert not READER.recognises(path)
