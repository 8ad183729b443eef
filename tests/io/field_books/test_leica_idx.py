"""Leica IDX: sections, rows by their columns, coordinates that the instrument has computed."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.leica_idx import READER
from factorgraph_adj.units import GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, KNOWN, TARGET, left_out_but_notes, sights


def packed(angle: float) -> str:
    """Return an angle as D.MMSSssss."""
    parts = round(math.degrees(angle) * 3600e4)
    minutes, seconds = divmod(parts, 60 * 10_000)
    return f"{minutes // 60}.{minutes % 60:02d}{seconds:06d}"


def points(*rows: str) -> str:
    names = "\n\t\t".join(rows)
    return (
        "DATABASE\n\tPOINTS(PointNo, PointID, East, North, Elevation, Code, Date, CLASS)\n"
        f"\t\t{names}\n\t\tANNOTATIONS(PointNo, PointID, Annotation)\n"
        '\t\t\t500004,\t"A",\t"0";\n\t\tEND ANNOTATIONS\n\tEND POINTS\nEND DATABASE\n'
    )


def point(name: str, xyz, state: str) -> str:
    east, north, up = (f"{v:.6f}" if v is not None else " " for v in xyz)
    return f'5000,\t"{name}",\t{east},\t{north},\t{up},\t"",\t21-09-2024/08:45:47.0\t,\t{state};'


def setup(name: str = "S", height: float = HEIGHT) -> str:
    return (
        f'\tSETUP\n\t\tSTN_NO\t7\n\t\tSTN_ID\t"{name}"\n\t\tINST_HT\t{height:.6f};\n\tEND SETUP\n'
    )


def slope(rows: list[tuple[str, str, str, float]], height: float = TARGET) -> str:
    said = "".join(
        f'\t\t9,\t"{n}",\t1,\t{hz},\t{v},\t{s:.6f},\t{height:.6f},\t21-09-2024/08:46:49.0,'
        "\t-0.000000,\t107,\t00001100;\n"
        for n, hz, v, s in rows
    )
    columns = "TgtNo, TgtID, CfgNo, Hz, Vz, SDist, RefHt, Date, Ppm, ApplType, Flags"
    return f"\tSLOPE({columns})\n{said}\tEND SLOPE\n"


def book(body: str = "", *, angular: str = "DMS", database: str | None = None) -> str:
    if database is None:
        database = points(*(point(n, xyz, "FIX") for n, xyz in KNOWN.items()))
    if not body:
        rows = [(s.target, packed(s.direction), packed(s.zenith), s.distance) for s in sights()]
        body = setup() + slope(rows)
    return (
        'HEADER\n\tVERSION 1.20\t\n\tSYSTEM\t"0"\n\tUNITS\n\t\tANGULAR '
        f"{angular}\n\t\tLINEAR  METRE\n\t\tTEMP    CELSIUS\n\tEND UNITS\n\tPROJECT\n"
        '\t\tNAME\t"SITE"\n\tEND PROJECT\nEND HEADER\n'
        + database
        + 'THEODOLITE\n\tINSTRUMENTS(Name, TheoNo, EDMNo, V_TYPE)\n\t\t"TCR",\t6,\t0,\tZENITH;\n'
        "\tEND INSTRUMENTS\n" + body + "END THEODOLITE\n"
    )


EXAMPLE_FILES = {
    "leica_idx": Example(
        "leica_idx",
        {"book.idx": book()},
        "book.idx",
        {"fixed": "A,B,C", "refraction": None},
        unread=(
            r"VERSION|SYSTEM|TEMP|NAME|PROJECT|STN_NO",  # header and numbers of stations
            r'\|"TCR"|"0";|500004,|ANNOTATIONS\(',  # instrument, remarks
            r"-\d\d-2024/|-0\.000000|\|9,|\|1,|\|107,|\|00001100;|\|5000,|\|\"\",",
        ),
        is_field_book=True,
    ),
}


def read(folder, text: str, **options) -> fga.Network:
    (folder / "book.idx").write_text(text, encoding="utf-8")
    return fga.read(folder / "book.idx", **options)


def said(folder, text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(folder, text)
    return [str(p) for p in caught.value.problems]


def test_units_are_those_of_the_header(tmp_path):
    for unit, text, value in (
        ("DMS", "139.021130", math.radians(139 + 2 / 60 + 11.3 / 3600)),
        ("GON", "139.021130", 139.02113 * GON),
    ):
        body = setup() + slope([("T", text, "90.000000", 50.0)])
        network = read(tmp_path, book(body, angular=unit))
        first = next(iter(network.observations.values()))
        assert first.value == pytest.approx(value, abs=1e-12)
    found = said(tmp_path, book(angular="MIL"))
    assert found[0] == "book.idx:4: unit ANGULAR 'MIL' is unknown; valid: DMS, GON"


def test_distances_of_0_and_sights_to_the_station_itself(tmp_path):
    body = setup() + slope([("T", "1.0", "90.0", 0.0), ("S", "2.0", "90.0", 7.0)])
    network = read(tmp_path, book(body, database=""))
    assert [o.kind for o in network.observations.values()] == ["direction", "zenith_angle"]
    (left,) = network.left_out
    assert str(left).startswith(
        "sights: 1 left out, as their target has the name of the station: S; first in book.idx:"
    )


@pytest.mark.parametrize("station", [(0.0, 0.0, 0.0), (10.0, 20.0, 3.0)])
def test_coordinates_from_stations_without_any_are_left_out(tmp_path, station):
    database = points(
        point("T", (11.5, 12.4, -0.2), "MEAS"),
        point("T", (None, None, None), "MEAS"),
        point("K", (5.0, 6.0, None), "FIX"),
        point("S", station, "FIX"),
    )
    body = setup() + slope([("T", "1.0", "90.0", 17.0)])
    network = read(tmp_path, book(body, database=database))
    known = {n: p.coordinates for n, p in network.points.items()}
    assert known["K"][:2] == (5.0, 6.0)
    if any(station):
        assert known["T"] == (11.5, 12.4, -0.2) and known["S"] == station
        assert not left_out_but_notes(network)
    else:
        assert math.isnan(known["T"][0]) and math.isnan(known["S"][0])
        (left,) = left_out_but_notes(network)
        assert (left.count, left.names) == (1, ("T",))


def test_wrong_lines_are_all_named(tmp_path):
    text = book()
    for old, new, what in (
        ("\tEND SLOPE\n", "", "END THEODOLITE in section 'SLOPE'"),
        ("\tEND SETUP\n", "", "END THEODOLITE in section 'SETUP'"),
        ("INST_HT", "INSTHT", "keyword of SETUP 'INSTHT' is unknown; valid: STN_NO"),
        ("INST_HT\t1.5", "INST_HT\thigh", "height of the instrument: 'high00000' is not a number"),
        ("\tSLOPE(", "\tSLOPES(", "section 'SLOPES' is unknown; valid: HEADER, UNITS"),
        ("Hz, Vz", "Hx, Vz", "column of SLOPE 'Hx' is unknown; valid: TgtID, Hz"),
        ("\t0,\tZENITH;", "\t0,\tNADIR;", "V_TYPE 'NADIR' is unknown; valid: ZENITH"),
        (",\t00001100;\n", ",\t00001100\n", "a row of SLOPE must end with ;"),
        (",\t107,", ",", "a row of SLOPE has 11 values, not 10"),
        ("\t\tANGULAR DMS\n", "", "unit ANGULAR is missing; valid: DMS, GON"),
        ('"S"', '"S" x', "value of STN_ID must be one word, or stand in quotation marks"),
        ("ANGULAR DMS", "ANGULAR DMS\n\t\tANGULAR GON", "keyword 'ANGULAR' stands twice"),
    ):
        assert old in text
        assert any(what in p for p in said(tmp_path, text.replace(old, new, 1))), what
    without = text[text.index("DATABASE") :]
    assert any("sights need the unit of angles: ANGULAR" in p for p in said(tmp_path, without))
    cut = text[: text.index("\tEND SLOPE")]
    assert any("section SLOPE has no END SLOPE" in p for p in said(tmp_path, cut))


def test_a_list_of_coordinates_has_no_header(tmp_path):
    text = points(point("1, a", (6_535_026.39, 6_042_802.38, 0.0), "FIX"))
    network = read(tmp_path, text)
    assert network.points["1, a"].coordinates == (6_535_026.39, 6_042_802.38, 0.0)
    assert READER.recognises is not None and READER.recognises(tmp_path / "book.idx")
