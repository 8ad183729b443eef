"""Inline options of STAR*NET data: they change the conventions of the lines that follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from ...errors import known
from .star_net_lines import StarNetValues
from .star_net_options import STAR_NET_LINEAR_UNITS

PRINTING_OPTIONS = ("LOSTSTATIONS", "PTOLERANCE", "ELLIPSE", "RELATIVE")
"""Inline options that change only what STAR*NET prints."""
REFUSED_OPTIONS = {
    "ELEVATION": "elevation_of_project in options",
    "ELLIPSOID": "positions on the ellipsoid are not read",
    "MAPMODE": "bearings in traverse lines are not read; use B and D lines",
    "COPY": "copies of points are not read; rename the points",
}
"""Inline options that are not built, and why."""
GRID_OPTIONS, LOCAL_OPTIONS = ("GRID", "MEASURED"), ("SCALE",)
"""Inline options of projects in a grid, and of local ones."""
SORTS_OF_VALUES = ("BEARINGS", "AZIMUTHS", "DISTANCES", "ANGLES", "DIRECTIONS")
"""Words of .GRID and .MEASURE."""
MAX_SCALE = 2.0
"""Largest factor of horizontal lengths; those of projections and heights are near 1."""


def apply_inline_option(values: StarNetValues, line: int, words: list[str]) -> str | None:
    """Apply an inline option; return its full name, or None if it is refused.

    Options may be abbreviated as far as they differ from others.
    """
    name, every = words[0][1:].upper(), (*APPLIED_OPTIONS, *PRINTING_OPTIONS, *REFUSED_OPTIONS)
    found = [o for o in every if o == name] or [o for o in every if name and o.startswith(name)]
    if len(found) > 1:
        values.source.wrong(line, f"inline option {words[0]!r} could be {' or '.join(found)}")
        return None
    if not found:
        valid = known((*APPLIED_OPTIONS, *PRINTING_OPTIONS), meant=name, most=40)
        values.source.wrong(line, f"inline option {words[0]!r} is unknown; valid: {valid}")
        return None
    option = found[0]
    if option in REFUSED_OPTIONS:
        values.source.wrong(
            line, f"inline option .{option} is not built: {REFUSED_OPTIONS[option]}"
        )
        return None
    if option in APPLIED_OPTIONS:
        APPLIED_OPTIONS[option](values, line, words[1:])
    return option


def _apply_nothing(values: StarNetValues, line: int, given: list[str]) -> None:
    """Change no convention: what reads the lines applies the option."""


def _only_word(values: StarNetValues, line: int, given: list[str]) -> str | None:
    """Return the word of an option that takes one; None: it has none. More than one are wrong."""
    if len(given) > 1:
        values.source.wrong(line, f"the option takes one word, not {' '.join(given)[:40]!r}")
    return given[0] if given else None


def _apply_2d(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.dimension = "2D"


def _apply_3d(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.dimension = "3D"


def _apply_units(values: StarNetValues, line: int, given: list[str]) -> None:
    now, project = values.now, values.project()
    if not given:
        now.linear, now.angular = project.linear, project.angular
    for said in given:
        word = said.lower()
        fitting = [n for n in STAR_NET_LINEAR_UNITS if n.startswith(word)]
        linear = word if word in STAR_NET_LINEAR_UNITS else fitting[0] if fitting else ""
        sizes = {STAR_NET_LINEAR_UNITS[n] for n in fitting}
        if word.upper() in ("DMS", "GONS"):
            now.angular = word.upper()
        elif linear and (linear == word or len(sizes) == 1):
            now.linear = linear
        else:
            valid = "Meters, FeetUS, FeetInt, DMS, GONS"
            values.source.wrong(line, f".UNITS {said[:40]}: valid: {valid}")


def _apply_order(values: StarNetValues, line: int, given: list[str]) -> None:
    now, project = values.now, values.project()
    if not given:
        now.order, now.stations = project.order, project.stations
    for said in given:
        stations = {"ATFROMTO": "AtFromTo", "FROMATTO": "FromAtTo"}.get(said.upper())
        if said.upper() in ("NE", "EN"):
            now.order = said.upper()
        elif stations is not None:
            now.stations = stations
        else:
            values.source.wrong(line, f".ORDER {said}: valid: NE, EN, AtFromTo, FromAtTo")


def _is_on(values: StarNetValues, line: int, option: str, given: list[str]) -> bool | None:
    """Return whether an option is ON or OFF; None without a word, and after a problem."""
    word = " ".join(given).upper()
    field = values.source.field(line, word, option)
    return field.choice({"ON": True, "OFF": False}, default=None)


def _apply_delta(values: StarNetValues, line: int, given: list[str]) -> None:
    on = _is_on(values, line, ".DELTA", given)
    stated = values.project().distances
    values.now.distances = stated if on is None else "horizontal" if on else "slope"


def _apply_centring(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.add_centring = bool(_is_on(values, line, ".ADDCENTERING", given))


def _apply_separator(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.separator = given[0] if given and len(given[0]) == 1 else "-"


def _apply_multiplier(values: StarNetValues, line: int, given: list[str]) -> None:
    field = values.source.field(line, _only_word(values, line, given), ".MULTIPLIER")
    number = field.number(above=0.0, default=1.0)
    values.now.multiplier = 1.0 if math.isnan(number) else number


def _apply_refraction(values: StarNetValues, line: int, given: list[str]) -> None:
    field = values.source.field(line, _only_word(values, line, given), ".REFRACTION")
    number = field.number_or_none()
    values.now.refraction = values.project().refraction if number is None else number


def _apply_scale(values: StarNetValues, line: int, given: list[str]) -> None:
    field = values.source.field(line, _only_word(values, line, given), ".SCALE")
    number = field.number(above=0.0, largest=MAX_SCALE, default=values.stated.scale)
    values.now.scale = 1.0 if math.isnan(number) else number


def _apply_grid(values: StarNetValues, line: int, given: list[str]) -> None:
    """Apply .GRID: the named sorts of values count from grid north, or are in the grid."""
    for what, place in _sorts_of_values(values, line, ".GRID", given):
        if place:
            values.source.wrong(line, f".GRID {what}={place}: valid without =")
        elif what == "BEARINGS":
            values.now.bearings = "grid"
        else:
            values.now.lengths = "grid"


def _apply_measured(values: StarNetValues, line: int, given: list[str]) -> None:
    """Apply .MEASURED: the named sorts of values are as measured, or on the ellipsoid."""
    for what, place in _sorts_of_values(values, line, ".MEASURE", given):
        if what == "BEARINGS" and not place:
            values.now.bearings = "true"
        elif what == "DISTANCES" and "GROUND".startswith(place):
            values.now.lengths = "measured"
        elif what == "DISTANCES" and "ELLIPSOIDAL".startswith(place):
            values.now.lengths = "ellipsoid"
        else:
            values.source.wrong(line, f".MEASURE {what}={place}: valid: DIST=GROUND, =ELLIPSOIDAL")


def _sorts_of_values(
    values: StarNetValues, line: int, option: str, given: list[str]
) -> Iterator[tuple[str, str]]:
    """Yield the sorts of values that .GRID and .MEASURE name, and the text behind =."""
    if not given:
        values.source.wrong(line, f"{option} takes BEARINGS or DISTANCES")
    for word in given:
        name, _, place = word.upper().partition("=")
        found = [s for s in SORTS_OF_VALUES if s.startswith(name) and name]
        if len(found) != 1 or found[0] in ("ANGLES", "DIRECTIONS"):
            what = f"{option} {word[:30]}: valid: BEARINGS, DISTANCES"
            more = "; directions and angles are as measured, t − T is not added"
            values.source.wrong(line, what + more * bool(found))
            continue
        yield "BEARINGS" if found[0] == "AZIMUTHS" else found[0], place


def _apply_alias(values: StarNetValues, line: int, given: list[str]) -> None:
    """Apply .ALIAS A=B …, PREFIX or SUFFIX with the end and its replacement, OFF."""
    word = given[0].upper() if given else ""
    pairs = [w.split("=") for w in given]
    if word in ("OFF", "CLEAR", "RESET") and len(given) == 1:
        values.aliases.clear()
        values.changed_ends.clear()
    elif word in ("PREFIX", "SUFFIX") and len(given) == 3:
        values.changed_ends.append((word, given[1], given[2]))
    elif pairs and all(len(p) == 2 and all(p) for p in pairs):
        values.aliases |= dict(pairs)
    else:
        shown = " ".join(given)[:40]
        valid = "OTHER=NAME …, PREFIX OTHER NAME, SUFFIX OTHER NAME, OFF"
        values.source.wrong(line, f".ALIAS {shown}: valid: {valid}")


def _apply_include(values: StarNetValues, line: int, given: list[str]) -> None:
    """Refuse .INCLUDE without a file; the reader of the lines reads the file of the others."""
    values.source.wrong(line, ".INCLUDE takes the name of a file")


def _apply_longitude(values: StarNetValues, line: int, given: list[str]) -> None:
    stated = values.project().longitude
    signs = {"": stated, "POS": "west positive", "NEG": "east positive"}
    said = "".join(given).upper()[:3]
    if said not in signs:
        values.source.wrong(line, f".LONGITUDE {' '.join(given)}: valid: POS (west), NEG (west)")
    values.now.longitude = signs.get(said, stated)


def _apply_level_weight(values: StarNetValues, line: int, given: list[str]) -> None:
    level = values.source.field(line, _only_word(values, line, given), ".LWEIGHT")
    number = level.number(above=0.0, default=math.nan)
    if number > 0:
        values.options = replace(values.options, level=number)


def _apply_instrument(values: StarNetValues, line: int, given: list[str]) -> None:
    """Apply the standard errors of an instrument; without a name those of the project."""
    level = values.options.level  # .LWEIGHT holds on
    library = {str(n).upper(): errors for n, errors in values.stated.instruments.items()}
    name = _only_word(values, line, given)
    errors = {} if name is None else library.get(name.upper())
    if name is not None and errors is None:
        what = f".INSTRUMENT {name[:30]}: its standard errors are in the project of STAR*NET"
        valid = known(list(values.stated.instruments), meant=name) or "none"
        values.source.wrong(line, f"{what}: state them in options, instruments; stated: {valid}")
        return
    changed: dict[str, Any] = {"level": level, **(errors or {})}
    values.options = replace(values.stated, **changed)


APPLIED_OPTIONS: dict[str, Callable[[StarNetValues, int, list[str]], None]] = {
    "UNITS": _apply_units,
    "ORDER": _apply_order,
    "DELTA": _apply_delta,
    "REFRACTION": _apply_refraction,
    "SEPARATOR": _apply_separator,
    "MULTIPLIER": _apply_multiplier,
    "ADDCENTERING": _apply_centring,
    "2D": _apply_2d,
    "3D": _apply_3d,
    "DATA": _apply_nothing,
    "LWEIGHT": _apply_level_weight,
    "INSTRUMENT": _apply_instrument,
    "LONGITUDE": _apply_longitude,
    "GPS": _apply_nothing,
    "SCALE": _apply_scale,
    "GRID": _apply_grid,
    "MEASURED": _apply_measured,
    "ALIAS": _apply_alias,
    "INCLUDE": _apply_include,
}
"""Inline options that change what is read, and the functions that apply them."""
