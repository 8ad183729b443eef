"""Field book of GeoProfi: columns, target heights that count until the next, code page 852."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.geoprofi import READER
from tests.hostile.examples import Example

HEAD = "AR GEODIMETER 510 méröállomás\nFN B.& Co.\nDT 1995.06.15.\n"


def station(name: str, height: str = "1.520", code: str = "") -> str:
    """Return the record of a station."""
    return f"AP {name:<12} {code:<10}{height:>7} =========\n"


def sight(letters: str, name: str, hz: str, v: str, distance: str = "", code: str = "") -> str:
    """Return the record of a sight."""
    return f"{letters} {name:<12} {code:<10} {hz:>8} {v:>9}{distance:>10}\n"


def geoprofi() -> str:
    """Return a quadrangle of three stations."""
    return (
        HEAD
        + station("103", code="KO")
        + "JM 2.000\n"
        + sight("KE", "104", "273.5304", "89.4814", "50.000")
        + sight("KE", "105", "3.1000", "90.1000", "40.000")
        + "JM  0.370\n"
        + sight("RP", "1000", "300.0000", "91.0000", "30.000", "FA")
        + station("104", "1.600")
        + sight("KE", "103", "10.0000", "90.0000")
        + sight("RP", "1000", "60.0000", "90.3000", "25.000")
    )


EXAMPLE_FILES = {
    "geoprofi": Example(
        "geoprofi",
        {"book.mjk": geoprofi()},
        "book.mjk",
        # Instrument, surveyor, date, codes of points, the end of the record of a station.
        unread=(r"\|(AR|FN|DT) ", r"\|value\|(KO|FA|=+)\|", r"\|word\| qz7x\|AP"),
    )
}


def book(tmp_path, text: str, **options: object) -> fga.Network:
    """Return the network of a text."""
    path = tmp_path / "b.mjk"
    path.write_bytes(text.encode("cp852"))
    return fga.read(path, format="geoprofi", **options)


def test_angles_are_packed_degrees_and_a_target_height_counts_until_the_next(tmp_path):
    network = book(tmp_path, geoprofi())
    of = {(o.station, o.target, o.kind): o for o in network.observations.values()}
    first = of["103", "104", "direction"]
    assert first.value == pytest.approx(math.radians(273 + 53 / 60 + 4 / 3600))
    assert of["103", "104", "zenith_angle"].value == pytest.approx(
        math.radians(89 + 48 / 60 + 14 / 3600)
    )
    assert of["103", "104", "slope_distance"].value == 50.0
    assert (first.instrument_height, first.target_height) == (1.52, 2.0)
    assert of["103", "1000", "direction"].target_height == 0.37
    assert of["104", "1000", "direction"].target_height == 0.37  # the station does not end it
    assert ("104", "103", "slope_distance") not in of
    assert network.remarks == ["1 line is not UTF-8: read as if in cp852; first in b.mjk:1"]


def test_an_empty_target_height_is_none(tmp_path):
    text = HEAD + station("1") + "JM 2.000\nJM\n" + sight("RP", "2", "0.0000", "90.0000")
    assert {o.target_height for o in book(tmp_path, text).observations.values()} == {0.0}


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("XX 1\n", "record 'XX' is unknown; valid: AP, JM, KE, RP, MT, AR, FN, DT"),
        (sight("RP", "2", "1.6000", "90.0000"), "horizontal reading: '1.6000' has 60 or more"),
        (sight("RP", "2", "273.5304", "90.0000").replace("273", " 273"), "column 36 must be blank"),
        (sight("RP", "2345678901234", "10.0000", "90.0000"), "column 16 must be blank, not '4'"),
    ],
)  # fmt: skip
def test_wrong_records_are_refused_with_their_line(tmp_path, row, said):
    with pytest.raises(InputError) as refused:
        book(tmp_path, HEAD + station("1") + row)
    assert f"b.mjk:5: {said}" in str(refused.value)


def test_the_book_is_recognised_whatever_the_suffix(tmp_path):
    path = tmp_path / "book.txt"
    path.write_bytes(geoprofi().replace("\n", "\r\n").encode("cp852"))
    assert READER.recognises is not None and READER.recognises(path)
    for other in (HEAD, "AP 1\nRP 2\n", ""):
        path.write_bytes(other.encode("cp852"))
        assert not READER.recognises(path)
