"""Field books of Zeiss and Trimble: four layouts of one survey, stationings, levels, damage."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance
from factorgraph_adj.units import FOOT, GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, STATION, TARGET, sights
from tests.support.places import data_dir

TENTH_MM = 1e-4


@dataclass(frozen=True)
class Line:
    """A line of a recorder in any layout."""

    values: tuple[tuple[str, str, str], ...] = ()
    """Types, numbers and units."""
    text: str = ""
    code: str = ""
    name: str = ""


def coordinates(name: str, xyz: Iterable[float], code: str = "") -> Line:
    """Return the line of a point with coordinates."""
    x, y, z = (f"{v:.3f}" for v in xyz)
    return Line((("Y", x, "m"), ("X", y, "m"), ("Z", z, "m")), code=code, name=name)


def survey() -> list[Line]:
    """Return the lines of the small survey, gon."""
    lines = [coordinates(n, xyz) for n, xyz in KNOWN.items()]
    lines.append(coordinates("S", STATION, "S"))
    lines.append(Line(text="POLAR"))
    lines.append(Line((("th", f"{TARGET:.3f}", "m"), ("ih", f"{HEIGHT:.3f}", "m")), text="INPUT"))
    for s in sights():
        hz, v = (f"{a / GON:.6f}" for a in (s.direction, s.zenith))
        values = (("SD", f"{s.distance:.5f}", "m"), ("Hz", hz, "gon"), ("V1", v, "gon"))
        lines.append(Line(values, name=s.target))
    return lines


def barred(values: Iterable[tuple[str, str, str]], width: int) -> str:
    """Return three values between strokes."""
    out = [f"{t:2} {n:>{width}} {u:4}|" for t, n, u in values]
    return "".join(out + [" " * (width + 8) + "|"] * (3 - len(out)))


def m5(lines: Iterable[Line]) -> str:
    """Return lines as M5, of an instrument with the markings of delivery."""
    out = []
    for i, line in enumerate(lines, start=1):
        info = line.text.ljust(27) if line.text else f"{line.code:>15}{line.name:>12}"
        block = "TI " if line.text else "PI1"
        out.append(f"For M5|Adr {i:05d}|{block} {info}|{barred(line.values, 14)} ")
    return "\r\n".join([*out, "END".ljust(119)]) + "\r\n"


def r_layout(lines: Iterable[Line], number: int) -> str:
    """Return lines as R4 or R5."""
    out = []
    for i, line in enumerate(lines, start=1):
        info = f"TR {line.text:7}" if line.text else f"KR {line.code:3}{line.name:>4}"
        address = f"Adr {i:04d}|" if number == 5 else ""
        out.append(f"For R{number}|{address}{info}|{barred(line.values, 11)}")
    return "\n".join([*out, "END"]) + "\n"


def rec500(lines: Iterable[Line]) -> str:
    """Return lines as REC 500, which has no units."""
    out = []
    for i, line in enumerate(lines, start=1):
        info = line.text.ljust(27) if line.text else f"{line.name:>19}{line.code:5}   "
        values = "".join(
            f"{t:2}{n:>{w}} " for (t, n, _), w in zip(line.values, (12, 13, 11), strict=False)
        )
        out.append(f"   {i:04d} {info} {values}".ljust(80))
    return "\n".join([*out, "END"]) + "\n"


def levelled(*rows: str) -> str:
    """Return lines of a level as M5, of rows such as ``12 Rb 1.5 20.1``, ``12 Z 100`` and texts."""
    out = []
    for i, row in enumerate(rows, start=1):
        words = row.split()
        kinds = ("Rb", "Rf", "Rz", "Z", "Lr", "Lv", "Sh")
        at = next((n for n, w in enumerate(words) if w in kinds), None)
        if at is None:
            out.append(f"For M5|Adr {i:5d}|TO  {row:27}|{barred((), 14)} ")
            continue
        name = words[0] if at else ""
        values = [(words[at], words[at + 1], "m")]
        values += [("HD", words[at + 2], "m")] if len(words) > at + 2 else []
        out.append(f"For M5|Adr {i:5d}|KD1 {name:>8}      07:47:275   3|{barred(values, 14)} ")
    return "\n".join(out) + "\n"


LEVELLED = levelled(
    "NIVEL.DAT",
    "Start-Line        BFFB    3",
    "A Z 100.00000",
    "A Rb 1.52300 25.340",
    "1 Rf 1.21100 24.870",
    "1 Rf 1.21120 24.870",
    "A Rb 1.52320 25.360",
    "1 Z 100.31200",
    "1 Rb 0.98750 30.120",
    "1 Rb 0.98770 30.120",
    "Measurement repeated",
    "B Rf 1.88420 29.650",
    "B Rf 1.88420 29.650",
    "1 Rb 0.98750 30.120",
    "Intermediate sight.",
    "C Rz 2.10500 12.300",
    "End-Line",
    "B Sh -0.58440",
)
EXAMPLE_FILES = {
    "m5": Example("zeiss", {"book.m5": m5(survey())}, "book.m5", HELD, is_field_book=True),
    "zeiss r5": Example(
        "zeiss", {"book.r5": r_layout(survey(), 5)}, "book.r5", HELD, is_field_book=True
    ),
    "zeiss r4": Example(
        "zeiss", {"book.r4": r_layout(survey(), 4)}, "book.r4", HELD, is_field_book=True
    ),
    "rec 500": Example(
        "zeiss", {"book.rec": rec500(survey())}, "book.rec", {**HELD, "angle_unit": "gon"}
    ),
    "m5 level": Example("zeiss", {"line.dat": LEVELLED}, "line.dat", {"fixed": "A"}),
}


def read(tmp_path, text: str, name: str = "book.m5", **options) -> fga.Network:
    """Read a text."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return fga.read(path, format="zeiss", **options)


def test_one_survey_in_four_layouts_is_one_network(tmp_path):
    """Places differ, and REC 500 says in a remark that its lengths are metres."""
    texts = {"M5": m5, "R5": lambda s: r_layout(s, 5), "R4": lambda s: r_layout(s, 4)}
    networks = [read(tmp_path, make(survey())) for make in texts.values()]
    networks.append(read(tmp_path, rec500(survey()), angle_unit="gon"))
    first = networks[0]
    for other in networks[1:]:
        assert [(p.name, tuple(p.xyz)) for p in other.points.values()] == [
            (p.name, tuple(p.xyz)) for p in first.points.values()
        ]
        for a, b in zip(first.observations.values(), other.observations.values(), strict=True):
            assert (a.kind, a.value, a.points) == (b.kind, b.value, b.points)
    assert [len(n.remarks) for n in networks] == [0, 0, 0, 1]
    assert "lengths are read as metres; length_unit" in networks[3].remarks[0]
