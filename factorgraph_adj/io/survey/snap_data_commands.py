"""Commands of SNAP's observation files: what lines hold, default errors, classifications, dates.

Format: LINZ, SNAP help, "Data definition commands", and ``snapdata.c`` of the program (BSD-3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Literal, TypeAlias

from ...units import ARCSEC
from ..source import Field, LeftOutReason, TextSource, is_unread
from .snap_lines import parsed_date

OTHER_KIND_NAMES = {"GPS": "GB", "DS": "SD", "VA": "ZD"}
"""Other codes of kinds of readings."""
KINDS = (
    *("SD", "HD", "ED", "MD", "DR", "HA", "ZD", "AZ", "PB"),
    *("LV", "LT", "LN", "OH", "EH", "GB", "GX"),
)
"""Kinds of readings."""
POINT_KINDS = frozenset(("LT", "LN", "OH", "EH", "GX"))
"""Kinds of one station."""
VECTOR_KINDS = frozenset(("GB", "GX"))
"""Kinds of three components."""
GROUPED_KINDS = frozenset(("HA", "DR"))
"""Kinds that are always in groups."""
DISTANCES, BEARINGS = ("SD", "HD", "ED", "MD", "DR"), ("AZ", "PB")
DISTANCE_SCALE, REFRACTION, BEARING_ERROR, REFERENCE_FRAME = (
    "distance_scale_code",
    "refraction_coef_code",
    "bearing_error_code",
    "ref_frame_code",
)
"""Classifications that parameters have unless the job states others."""
CLASS_ITEMS = {
    "distance_scale_error": DISTANCE_SCALE,
    "refraction_coefficient": REFRACTION,
    "bearing_orientation_error": BEARING_ERROR,
    "reference_frame": REFERENCE_FRAME,
}
"""Classification by the item or command that states it."""
CLASSES_OF_KINDS = {
    DISTANCE_SCALE: DISTANCES,
    REFRACTION: ("ZD",),
    BEARING_ERROR: BEARINGS,
    REFERENCE_FRAME: ("GB", "GX"),
}
"""Kinds of readings that have these classifications."""
ITEMS = ("value", "error", "date", "time", "id", *CLASS_ITEMS)
"""Items of a reading that every file may have."""
NOTES_AND_IDS = LeftOutReason("dates without a use", "no command of the job asks for them")
Angles: TypeAlias = Literal["dms", "hp", "deg"]
_MM = 1e-3
_PPM = 1e-6
ERROR_UNITS: dict[str, dict[str, tuple[int, float]]] = {
    "ds": {"mm": (1, _MM), "ppm": (1, _PPM)},
    "ha": {"sec": (1, ARCSEC), "mm": (1, _MM)},
    "az": {"sec": (1, ARCSEC), "mm": (1, _MM)},
    "zd": {"sec": (1, ARCSEC), "mmh": (1, _MM), "mmv": (1, _MM)},
    "lv": {"mm": (1, _MM)},
    "lt": {"sec": (1, ARCSEC)},
    "ln": {"sec": (1, ARCSEC)},
    "oh": {"mm": (1, _MM)},
    "eh": {"mm": (1, _MM)},
    "gb": {"mm": (3, _MM), "ppm": (3, _PPM)},
    "gx": {"mm": (3, _MM), "mmr": (3, _MM), "ppmr": (3, _PPM)},
}
"""Units of the default errors with the number of values before each, and their size."""
ERROR_COMMANDS = {
    **{f"{code}_error": code for code in ERROR_UNITS if code not in ("gb", "gx")},
    "gps_enu_error": "gb",
    "gb_enu_error": "gb",
    "gx_enu_error": "gx",
}
"""Default errors by their command."""
ERRORS_OF_KINDS = {
    **dict.fromkeys(DISTANCES, "ds"),
    **dict.fromkeys(BEARINGS, "az"),
    **{code.upper(): code for code in ("ha", "zd", "lv", "lt", "ln", "oh", "eh", "gb", "gx")},
}
"""Default errors of each kind of reading."""
ANGLE_COMMANDS: dict[str, Angles] = {
    "dms_angles": "dms",
    "hp_angles": "hp",
    "deg_angles": "deg",
}
REFUSED = {
    "systematic_error": "parameters of systematic errors with stated influences have no counterpart"
}
"""Commands that are refused, with the reason."""
_VALID = (
    *("data", "date", "time", "classification", "classify", "projection", "note", "end_set"),
    *("gps_error_type", *CLASS_ITEMS, *ANGLE_COMMANDS, *ERROR_COMMANDS),
)

SnapErrors: TypeAlias = Mapping[str, Mapping[str, tuple[float, ...]]]
"""Default errors: by code and unit, SI."""


@dataclass(frozen=True)
class DataDefinition:
    """What the lines behind ``#data`` hold."""

    kinds: tuple[tuple[str, tuple[str, ...]], ...]
    """Kinds of readings with the items of each, in order; empty: the definition is wrong."""
    leading: tuple[str, ...] = ()
    """Items before the first kind: date and time."""
    grouped: bool = False
    """Whether a station stands on a line of its own."""
    heights: bool = True
    """Whether a height stands behind each station."""
    needs_end: bool = False
    """Whether ``#end_set`` and a matrix end each group."""

    @property
    def point(self) -> bool:
        """Whether readings have one station."""
        return any(kind in POINT_KINDS for kind, _ in self.kinds)

    @property
    def vectors(self) -> bool:
        """Whether readings have three components."""
        return any(kind in VECTOR_KINDS for kind, _ in self.kinds)

    @property
    def states_errors(self) -> bool:
        """Whether errors are items of the readings."""
        return any("error" in items for _, items in self.kinds)


@dataclass(frozen=True)
class SnapDataState:
    """What the commands of a file have stated so far."""

    definition: DataDefinition | None = None
    """What lines hold; None before ``#data``."""
    angles: Angles = "dms"
    """How angles are written."""
    error_type: str = "full"
    """Form of the errors of vectors."""
    upper: bool = False
    """Whether matrices are upper triangles."""
    date: datetime | None = None
    """Date of the readings."""
    projection: str = ""
    """Code of the projection of bearings."""
    errors: SnapErrors = field(default_factory=dict)
    """Default errors."""
    names: frozenset[str] = frozenset()
    """Names of classifications that are stated."""
    classes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Values of classifications by kind of reading and name."""


def kind_of(word: str) -> str:
    """Return the kind of reading that a word is; empty if none."""
    code = word.upper()
    code = OTHER_KIND_NAMES.get(code, code)
    return code if code in KINDS else ""


def data_command(
    source: TextSource, line: int, name: str, rest: str, state: SnapDataState
) -> SnapDataState:
    """Return the state after a command; what is wrong is noted.

    Args:
        source: the file.
        line: number of the line.
        name: name of the command, in small letters.
        rest: text behind it.
        state: state before it.
    """
    words = rest.split()
    if name in REFUSED:
        source.wrong(line, f"#{name} is not read: {REFUSED[name]}")
        return state
    if name == "data":
        return replace(state, definition=_definition(source, line, words, state))
    if name in ERROR_COMMANDS:
        code = ERROR_COMMANDS[name]
        given = source.field(line, rest, f"#{name}")
        found = stated_errors(given, words, ERROR_UNITS[code])
        return replace(state, errors={**state.errors, code: found})
    if name in ANGLE_COMMANDS:
        only_words(source, line, name, words, 0)
        return replace(state, angles=ANGLE_COMMANDS[name])
    if name == "date":
        found_date = parsed_date(rest)
        if found_date is None and rest.lower() != "unknown":
            source.wrong(line, f"date {rest[:40]!r} is none; valid: unknown, or 13 Jan 2008")
        return replace(state, date=found_date)
    if name == "gps_error_type":
        valid = ("full", "correlation", "diagonal", "enu")
        kinds = [w.lower() for w in words if w.lower() not in ("upper", "lower")]
        form = source.field(line, " ".join(kinds), "#gps_error_type").word(valid)
        upper = "upper" in rest.lower().split()
        return replace(state, error_type=form or state.error_type, upper=upper)
    if name in ("projection", "classification", *CLASS_ITEMS):
        only_words(source, line, name, words, 1)
        value = source.field(line, words[0] if words else None, f"#{name}").name()
        if name == "projection":
            return replace(state, projection=value)
        if name == "classification":
            return replace(state, names=state.names | {value.lower()})
        cls = CLASS_ITEMS[name]
        return _classified(state, CLASSES_OF_KINDS[cls], cls, value)
    if name == "classify":
        return _classify(source, line, words, state)
    if name == "time":
        return state
    source.field(line, name, "command #").word(_VALID)
    return state


def only_words(source: TextSource, line: int, name: str, words: list[str], number: int) -> None:
    """Refuse more words behind a command than it takes."""
    if len(words) > number:
        takes = f"takes {number} word" if number else "takes no words"
        source.wrong(line, f"#{name} {takes}, not {' '.join(words)[:40]!r}")


def _classified(
    state: SnapDataState, kinds: tuple[str, ...], name: str, value: str
) -> SnapDataState:
    """Return the state in which kinds of readings have the value of a classification."""
    changed = {k: {**state.classes.get(k, {}), name: value} for k in kinds}
    return replace(state, classes={**state.classes, **changed}, names=state.names | {name})


def _classify(
    source: TextSource, line: int, words: list[str], state: SnapDataState
) -> SnapDataState:
    """Return the state after ``#classify [HA/SD] NAME VALUE``."""
    kinds: tuple[str, ...] = KINDS
    if len(words) > 2:
        found = [kind_of(w) for w in words.pop(0).split("/")]
        if "" in found:
            source.wrong(line, f"#classify: kinds of data must be some of {', '.join(KINDS)}")
            return state
        kinds = tuple(found)
    if len(words) != 2:
        source.wrong(line, "#classify needs kinds of data (or none), a classification, its value")
        return state
    return _classified(state, kinds, words[0].lower(), words[1])


def stated_errors(
    given: Field, words: Sequence[str], units: Mapping[str, tuple[int, float]]
) -> dict[str, tuple[float, ...]]:
    """Return errors by unit of ``10 mm 2 ppm``, SI; what is wrong is noted.

    Args:
        given: the field of all words, which problems name.
        words: numbers and units, one by one.
        units: number of values before each unit, and its size.
    """
    out: dict[str, tuple[float, ...]] = {}
    values: list[str] = []
    for word in words:
        if word.lower() not in units:
            values.append(word)
            continue
        unit = word.lower()
        size, scale = units[unit]
        if unit in out:
            given.wrong(f"has the unit {unit} twice")
        elif len(values) != size:
            given.wrong(f"needs {size} values before {unit}, not {len(values)}")
        else:
            fields = (Field(v, given.what, given.where, given.problems) for v in values)
            numbers = tuple(f.number(scale=scale, least=0.0) for f in fields)
            if not is_unread(*numbers):
                out[unit] = numbers
        values = []
    if values or not words:
        valid = " ".join(f"{'# ' * size}{unit}" for unit, (size, _) in units.items())
        given.wrong(f"must be {valid}, and not end in {' '.join(values)[:40]!r}")
    return out


def _definition(
    source: TextSource, line: int, words: list[str], state: SnapDataState
) -> DataDefinition:
    """Return what lines hold by ``#data``."""
    wrong = DataDefinition(())
    grouped, heights = False, True
    leading: list[str] = []
    kinds: list[tuple[str, list[str]]] = []
    for word in words:
        low = word.lower()
        kind = kind_of(word)
        if low == "grouped":
            grouped = True
        elif low == "no_heights":
            heights = False
        elif kind:
            kinds.append((kind, []))
        elif low in ("date", "time"):
            (kinds[-1][1] if kinds else leading).append(low)
        elif kinds and (low in ITEMS or low in state.names):
            if low in kinds[-1][1]:
                source.wrong(line, f"#data has the item {low} of {kinds[-1][0]} twice")
                return wrong
            kinds[-1][1].append(low)
        else:
            valid = sorted({*KINDS, *ITEMS, *state.names, "grouped", "no_heights"})
            source.field(line, word, "item of #data").word(valid)
            return wrong
    if not kinds:
        source.wrong(line, f"#data needs a kind of data: {', '.join(KINDS)}")
        return wrong
    classes = {(k in VECTOR_KINDS, k in POINT_KINDS) for k, _ in kinds}
    if len(classes) > 1 or (len(kinds) > 1 and kinds[0][0] in VECTOR_KINDS):
        together = ", ".join(k for k, _ in kinds)
        source.wrong(line, f"#data cannot have {together} in one line: give each its own #data")
        return wrong
    vectors = kinds[0][0] in VECTOR_KINDS
    point = kinds[0][0] in POINT_KINDS
    grouped = (grouped or any(k in GROUPED_KINDS for k, _ in kinds)) and (vectors or not point)
    stated = any("error" in items for _, items in kinds)
    matrix = vectors and grouped and stated and state.error_type in ("full", "correlation")
    complete = tuple(
        (k, tuple(items) if "value" in items else ("value", *items)) for k, items in kinds
    )
    return DataDefinition(complete, tuple(leading), grouped, heights, matrix)
