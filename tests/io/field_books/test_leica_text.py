"""Text reports of Leica: sections of System 1200, the unit of their angles; points of TCR 705."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.units import GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, KNOWN, TARGET, Sight, sights

MM = 1e-3


def packed(angle: float) -> str:
    parts = round(math.degrees(angle) * 3600e4)
    minutes, seconds = divmod(parts, 60 * 10_000)
    return f"{minutes // 60}.{minutes % 60:02d}{seconds:06d}"


def section(title: str, columns: str, *rows: str) -> str:
    names = "   ".join(columns.split(","))
    return "\n".join([title, "-" * len(title), names, *rows]) + "\n\n"


def points(*rows: tuple[str, float, float, float], title: str = "Points") -> str:
    columns = "Point ID,E,N,H,Class,Point Code" + ",Line ID,Line Code" * (title == "Lines")
    line = "   Line1   RT" * (title == "Lines")
    return section(title, columns, *(f"{n}   {e}   {y}   {h}   MEAS{line}" for n, e, y, h in rows))


def measurements(*rows: Sight, unit: str = "dms") -> str:
    columns = "Point ID,Hz,V,SD,HD,dH,hr,Add. Const,atm/geom ppm"
    write = {"dms": packed, "gon": lambda a: f"{a / GON:.8f}"}[unit]
    return section(
        "TPS Measurements",
        columns,
        *(
            f"{s.target}   {write(s.direction)}   {write(s.zenith)}   {s.distance:.6f}   "
            f"{abs(s.distance * math.sin(s.zenith)):.6f}   1.234   {TARGET}   0.0344   0/   0"
            for s in rows
        ),
    )


STATION = section("TPS Station", "Station ID,E,N,H,hi", f"S   15.1   19.9   102.0   {HEIGHT}")


def report(body: str) -> str:
    plus = "+" * 40
    return (
        f"          System 1200 Data Export - File Begin\n{plus}\n\nJob\n---\nJob\t\t: SITE\n\n"
        f"{body}          System 1200 Data Export - File End\n{plus}\n"
    )


BOOK = report(points(*((n, *xyz) for n, xyz in KNOWN.items())) + STATION + measurements(*sights()))
TCR = """A site.
\x20
JOB      SITE
OPERATOR     AB
DATE 08/02/24
INS. NO.    1
INS. TYPE.    TCR705

SETUP SN      1000
IH     0.000

Orientation Station          0
- - - - - - - -
       100,    999.630,   1002.620,     98.406, WALL01 --------
       101,       1.00,       1.00,       1.00, WALL01 --------
       102,   1000.723,    997.323,     98.437, WALL01 --------

File End.
"""
EXAMPLE_FILES = {
    "leica_text": Example(
        "leica_text",
        {"book.txt": BOOK},
        "book.txt",
        {"fixed": "A,B,C", "refraction": None},
        unread=(
            r"Job|SITE|\+{9}",
            r"MEAS|1\.234|0\.0344|0/",  # classes, height differences, constants, ppm
        ),
        is_field_book=True,
    ),
    "leica_tcr705": Example(
        "leica_text",
        {"book.txt": TCR},
        "book.txt",
        places_only=True,
        unread=(
            r"A site|JOB|OPERATOR|DATE|INS\.|IH|Orientation|SETUP",
            r"WALL01|- -|\|word\|File End|\x20$",
            r"101,|qz7x 1 2 3\|$",  # a point without coordinates, titles
        ),
    ),
}


def read(folder, text: str, **options) -> fga.Network:
    (folder / "book.txt").write_text(text, encoding="utf-8")
    return fga.read(folder / "book.txt", **options)


def said(folder, text: str, **options) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(folder, text, format="leica_text", **options)
    return [str(p) for p in caught.value.problems]


@pytest.mark.parametrize(
    ("unit", "noun"), [("dms", "degrees, minutes and seconds (D.MMSS)"), ("gon", "gon")]
)
def test_the_unit_of_angles_is_that_which_makes_horizontal_distances(tmp_path, unit, noun):
    text = report(STATION + measurements(*sights(), unit=unit))
    network = read(tmp_path, text, faces="both")
    assert network.remarks == [
        f"angles are {noun}: HD is that of SD and V in all 6 sights in no other unit"
    ]
    first = next(o for o in network.observations.values() if o.kind == "direction")
    assert first.value == pytest.approx(sights()[0].direction, abs=1e-9)
    assert read(tmp_path, text, angles=unit, faces="both").observations == network.observations


def test_a_unit_that_is_open_must_be_stated(tmp_path):
    """At a zenith distance of 90.00 every unit of degrees gives the same horizontal distance."""
    flat = Sight("A", 1, 0.5, math.pi / 2, 30.0)
    text = report(STATION + measurements(flat))
    (found,) = said(tmp_path, text)
    assert found.endswith(
        "unit of angles is open: HD is that of SD and V in dms and deg; give angles=dms "
        "(--set angles=dms), deg or gon"
    )
    network = read(tmp_path, text, angles="dms")
    assert [o.value for o in network.observations.values() if o.kind == "zenith_angle"] == [
        math.pi / 2
    ]
    wrong = BOOK.replace(f"{sights()[0].distance:.6f}", "99.0")
    assert "HD is that of SD and V in none of dms, deg, gon" in said(tmp_path, wrong)[0]


def test_sections_may_come_again_and_lines_have_points(tmp_path):
    text = report(
        STATION + measurements(*sights()[:2]) + points(("L 1", 1.0, 2.0, 3.0), title="Lines")
        + measurements(sights()[2]) + STATION.replace("S  ", "T  ") + measurements(*sights())
    )  # fmt: skip
    network = read(tmp_path, text)
    assert network.points["L 1"].coordinates == (1.0, 2.0, 3.0)
    assert {o.station for o in network.observations.values()} == {"S", "T"}


def test_wrong_lines_of_a_report_are_all_named(tmp_path):
    for old, new, what in (
        (
            "TPS Station\n",
            "TPS Stations\n",
            "section 'TPS Stations' is unknown; valid: Job, Points",
        ),
        ("E   N   H   hi", "E   N   H", "section TPS Station has no column hi"),
        ("HD   dH", "HX   dH", "column of TPS Measurements 'HX' is unknown; valid: Point ID, Hz"),
        ("   1.234   ", "   ", "a row of TPS Measurements has 9 values, not 8"),
        (
            "Points\n------\n",
            "",
            "a line of Job must have a colon, not 'Point ID   E   N   H   Class",
        ),
        ("102.0   1.5", "102.0   high", "height of the instrument: 'high' is not a number"),
        ("Job\t\t:", "Job\t\t", "a line of Job must have a colon, not 'Job\\t\\t SITE'"),
        ("Data Export - File End", "", "the report has no line 'System 1200 Data Export - File"),
    ):
        assert old in BOOK
        found = said(tmp_path, BOOK.replace(old, new, 1))
        assert any(what in p for p in found), (what, found)
    found = said(tmp_path, BOOK.replace(STATION, ""))
    assert found[-1].endswith("6 sights from here have no station")


def test_points_of_tcr_705(tmp_path):
    network = read(tmp_path, TCR)
    assert {n: p.coordinates for n, p in network.points.items()} == {
        "100": (999.63, 1002.62, 98.406),
        "102": (1000.723, 997.323, 98.437),
    }
    (left,) = network.left_out
    assert str(left) == (
        "points: 1 left out, as the report has 1.00, 1.00, 1.00 for coordinates: 101; "
        "first in book.txt:15"
    )
    assert "'x' is neither a line of the set-up nor point" in said(
        tmp_path, TCR.replace("File", "x\nFile")
    )[0]  # fmt: skip
    assert "has no line 'File End.'" in said(tmp_path, TCR.replace("File End.", ""))[0]


def test_the_station_of_the_survey_comes_out_beside_its_coordinates(tmp_path):
    solution = fga.adjust(read(tmp_path, BOOK, fixed="A,B,C", refraction=None))
    assert np.allclose(solution.point("S"), (15.0, 20.0, 102.0), atol=MM)
