"""Lines of recorders of Zeiss and Trimble: M5, R5, R4 and REC 500 as records of one form.

A line has an address, an information of 27 characters (R4 and R5: 7) about a point or with a text,
and three values with types and, but for REC 500, units. What differs between the four stands in the
table `LAYOUTS`. Sources: Trimble M3 Total Station User Guide, C192E, appendix B (columns of M5, its
markings, types, units and lines that are recorded); the real files that `zeiss` names (R4, R5, REC
500).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from ...units import ANGLE, FOOT, GON
from ..format_options import option_text
from ..numbers import PACKED_DEGREES
from ..source import Field, LeftOutReason, TextSource
from .field_records import Scales, read_angle, read_length, read_name, read_number

ERRONEOUS_RECORDS = LeftOutReason("records", "the instrument marks them as erroneous")
LENGTH_UNITS = {"m": 1.0, "ft": FOOT}
"""Metres in units of lengths; ft is the international foot."""
ANGLE_UNITS: dict[str, float | str] = {
    "gon": GON,
    "grd": GON,
    "deg": ANGLE["deg"],
    "dms": PACKED_DEGREES,
    "mil": math.pi / 3200,
}
"""Units of angles: radians, or degrees packed with minutes and seconds."""
OTHER_UNITS = dict.fromkeys(("c", "f", "hpa", "torr", "inhg", "mmhg", ""), 1.0)
"""Units of what is not needed."""

U = TypeVar("U")
_LENGTHS = "SD HD h ih th X Y Z N_ E_ Z_ x y z n e PC A R Rb Rf Rz sR Sh Db Df Sr Sv Z0"
_DIFFERENCES = "dx dy dz dl dq dr dc O"
_ANGLES = "Hz V1 V2 V3 Om i c SZ SK"
_NUMBERS = "T_ P m 04 05 06 20 21 22"
_TEXTS = "01 02 03"
VALUE_TYPES: dict[str, Callable[[Field, Scales], Any]] = {
    **dict.fromkeys(f"{_LENGTHS} {_DIFFERENCES}".split(), read_length),
    **dict.fromkeys(_ANGLES.split(), read_angle),
    **dict.fromkeys(_NUMBERS.split(), read_number),
    **dict.fromkeys(_TEXTS.split(), read_name),
}
"""Function that reads a value, by its type."""
OTHER_NAMES = {"D": "SD", "E": "HD", "Lr": "Rb", "Lv": "Rf", "Lz": "Rz", "L": "R", "sL": "sR"}
"""Older and German names of types."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_VALUE = re.compile(r"(\S{1,2})\s+(\S.*)")
_NUMBER_AND_UNIT = re.compile(rf"({_NUMBER})\s*([A-Za-z]*)")
_THREE = r"(?P<values>[^|]*\|[^|]*\|[^|]*)\|"
_UNITLESS = re.compile(rf"([A-Za-z]\S?)\s+(?:({_NUMBER})(?=\s|$)|(\S+))\s*")


@dataclass(frozen=True)
class ZeissValue:
    """A value of a record."""

    type: str
    text: str
    unit: str | None
    """Unit in small letters; None: the layout has none."""


@dataclass(frozen=True)
class ZeissRecord:
    """A line."""

    line: int
    block: str
    """Type of the information: PI, KR point; KD, KN point of a level; TI, TR, TO text; empty: the
    layout does not say."""
    info: str
    """The information, with all blanks."""
    values: tuple[ZeissValue, ...]

    @property
    def text(self) -> str:
        """The information without blanks at its ends."""
        return self.info.strip()


@dataclass(frozen=True)
class PointColumns:
    """Columns of code and point number in the information of a point."""

    code: slice
    number: slice


@dataclass(frozen=True)
class ZeissLayout:
    """Layout of the lines of one format."""

    name: str
    beginning: re.Pattern[str]
    """Beginning of a line, which tells the layout but for REC 500."""
    line: re.Pattern[str]
    """A line: ``block``, ``info``, ``values``, ``error``."""
    valid: str
    """A line in words."""
    point: PointColumns | None
    """Columns of code and number; None: settings of the instrument determine them."""


CODE_THEN_NUMBER = PointColumns(slice(10, 15), slice(15, 27))
"""Columns of M5 of a Trimble M3 as it is delivered."""
NUMBER_THEN_CODE = PointColumns(code=slice(19, 24), number=slice(0, 19))
"""Columns of REC 500, and of M5 of an Elta."""
LAYOUTS = (
    ZeissLayout(
        "M5",
        re.compile(r"For[ _]M5\|Adr\s+\d+\s*\|[A-Z]{2}"),
        re.compile(
            rf"For[ _]M5\|Adr\s+\d+\s*\|(?P<block>[A-Z]{{2}})[0-9 ] (?P<info>[^|]{{27}})\|{_THREE}"
            r"(?P<error>[Ee]?)\s*"
        ),
        "'For M5', an address, an information of 27 characters, and three values, with | between",
        None,
    ),
    ZeissLayout(
        "R5",
        re.compile(r"For[ _]R5\|Adr\s+\d+\s*\|[A-Z]{2}"),
        re.compile(rf"For[ _]R5\|Adr\s+\d+\|(?P<block>KR|TR) (?P<info>[^|]{{7}})\|{_THREE}\s*"),
        "'For R5', an address, KR or TR with 7 characters, and three values, with | between",
        PointColumns(slice(0, 3), slice(3, 7)),
    ),
    ZeissLayout(
        "R4",
        re.compile(r"For[ _]R4\|(KR|TR) "),
        re.compile(rf"For[ _]R4\|(?P<block>KR|TR) (?P<info>[^|]{{7}})\|{_THREE}\s*"),
        "'For R4', KR or TR with 7 characters, and three values, with | between",
        PointColumns(slice(0, 3), slice(3, 7)),
    ),
    ZeissLayout(
        "REC 500",
        re.compile(r"[ ]{3}[ 0-9]{3}[0-9] "),
        re.compile(r"[ ]{3}[ 0-9]{3}[0-9] (?P<info>[ -~]{1,28})(?P<values>.*)"),
        "an address in columns 4-7, an information in 9-36, and values behind them",
        NUMBER_THEN_CODE,
    ),
)
"""Layouts, the most usual one first."""


def layout_of(lines: list[str]) -> ZeissLayout | None:
    """Return the layout of the first lines of a file; None: they are of no recorder of Zeiss.

    REC 500, which has no word of its own, needs two lines of its form, one of them with a value or
    with a text that begins a stationing or a levelled line.
    """
    filled = [line.rstrip() for line in lines if line.strip()][:20]
    for layout in LAYOUTS[:3]:
        if filled and layout.beginning.match(filled[0]):
            return layout
    rec = LAYOUTS[3]
    found = [m for line in filled if (m := rec.line.fullmatch(line))]
    typical = re.compile(
        rf"(OR\.COOR|POLAR|INPUT|Start-Line|Curva)\b|.{{28}}\s?({'|'.join(VALUE_TYPES)})\s+{_NUMBER}"
    )
    is_rec = len(found) == len(filled) - sum(line == "END" for line in filled) >= 2
    if is_rec and any(typical.match(m["info"].ljust(28) + m["values"]) for m in found):
        return rec
    return None


def zeiss_records(source: TextSource, layout: ZeissLayout) -> Iterator[ZeissRecord]:
    """Yield the records of a file; a line of another form is wrong."""
    for number, line in source.filled():
        if line.strip() == "END":
            continue
        found = layout.line.fullmatch(line.rstrip("\x1a"))
        if found is None:
            source.wrong(number, f"is no line of {layout.name}: {layout.valid}")
            continue
        parts = found.groupdict()
        info = parts["info"].ljust(28) if layout.point is NUMBER_THEN_CODE else parts["info"]
        if parts.get("error") or "#####" in info:
            source.leave_out(number, ERRONEOUS_RECORDS, info.strip())
            continue
        blocks = parts["values"].split("|")
        if layout is LAYOUTS[3]:
            values = _values_without_units(source, number, parts["values"])
        else:
            values = [v for b in blocks if (v := _value(source, number, b)) is not None]
        yield ZeissRecord(number, parts.get("block") or "", info, tuple(values))


def _value(source: TextSource, line: int, block: str) -> ZeissValue | None:
    """Return the value of a block; None: it is blank or wrong."""
    if not block.strip():
        return None
    found = _VALUE.fullmatch(block.strip())
    if found is None:
        what = f"value {block.strip()[:40]!r} must be a type of two characters and a value"
        source.wrong(line, what)
        return None
    type_ = _type(source, line, found[1])
    number = _NUMBER_AND_UNIT.fullmatch(found[2])
    if type_ is None:
        return None
    if VALUE_TYPES[type_] is read_name:
        return ZeissValue(type_, found[2], "")
    text, _, unit = (number[1], "", number[2]) if number else found[2].partition(" ")
    return ZeissValue(type_, text, unit.strip().lower())


def _values_without_units(source: TextSource, line: int, text: str) -> list[ZeissValue]:
    """Return the values behind the information of REC 500."""
    out, rest = [], text.strip()
    while rest:
        found = _UNITLESS.match(rest)
        if found is None:
            source.wrong(line, f"{rest[:40]!r} must be types and values, such as X 23.926")
            break
        type_ = _type(source, line, found[1])
        if type_ is not None:
            out.append(ZeissValue(type_, found[2] or found[3], None))
        rest = rest[found.end() :]
    return out


def _type(source: TextSource, line: int, word: str) -> str | None:
    names = {**{t: t for t in VALUE_TYPES}, **OTHER_NAMES}
    return source.field(line, word, "type of a value").choice(names)


@dataclass
class ZeissUnits:
    """Units of a file."""

    source: TextSource
    length: str | None
    """Unit of lengths of a file that states none."""
    angle: str | None
    """Unit of angles of a file that states none."""
    asked: bool = False
    """Whether a problem has named the option for angles."""

    def read(self, record: ZeissRecord) -> dict[str, float]:
        """Return the values of a record by type, SI units; texts are not among them."""
        out: dict[str, float] = {}
        for value in record.values:
            if value.type in out:
                self.source.wrong(record.line, f"type {value.type!r} of a value stands twice")
            read = VALUE_TYPES[value.type]
            field = self.source.field(record.line, value.text, f"value {value.type}")
            if read is read_name:
                continue
            if read is read_length:
                scale = self._unit(record.line, value, LENGTH_UNITS, self.length or "m")
                out[value.type] = read(field, Scales(length=scale or 1.0))
            elif read is read_angle:
                out[value.type] = self._angle(record.line, value, field)
            else:
                self._unit(record.line, value, OTHER_UNITS, "")
                out[value.type] = read(field, Scales())
        return out

    def _angle(self, line: int, value: ZeissValue, field: Field) -> float:
        if value.unit is None and self.angle is None:
            if value.type not in ("Hz", "V1", "V2", "V3"):
                return field.number()  # the orientation is needed with circles alone
            if not self.asked:
                what = f"the file has no unit of angles: give {option_text('angle_unit', 'gon')}"
                self.source.wrong(line, f"{what}, or deg, dms, mil")
            self.asked = True
            return math.nan
        unit = self._unit(line, value, ANGLE_UNITS, self.angle or "gon")
        return math.nan if unit is None else read_angle(field, Scales(angle=unit))

    def _unit(self, line: int, value: ZeissValue, units: dict[str, U], stated: str) -> U | None:
        unit = stated if value.unit is None else value.unit
        return self.source.field(line, unit, f"unit of value {value.type}").choice(units)
