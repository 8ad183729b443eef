"""Layout of text reports: tables, paragraphs, lists, numbers by significant digits; JSON text.

`json.dumps` with an indent calls Python for every number; without one it does not. `json_text`
therefore writes lists and objects of numbers and texts alone without an indent, with a separator
that contains the line break and the indent.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from json import JSONEncoder, dumps
from math import floor, isfinite, log10, nan, sqrt
from textwrap import wrap
from typing import Any
from unicodedata import combining

import numpy as np

from ..types import Array
from ..units import decimal

SCALAR_TYPES = frozenset({str, float, int, bool, type(None)})
"""Types that are written without members of their own."""
LINE_WIDTH = 100
"""Width of a text report's heading and paragraphs, characters."""
NO_BREAK = "\u00a0"
"""Blank at which `paragraph` does not break a line."""


def json_text(value: Any, level: int = 0) -> str:
    """Return a value as ``json.dumps(value, indent=1, ensure_ascii=False)`` does.

    Args:
        value: objects with texts as keys, lists, tuples, texts, numbers, truth values, None.
        level: number of spaces before the end of the value.
    """
    if not isinstance(value, dict | list | tuple) or not value:
        return dumps(value, ensure_ascii=False)
    members = value.values() if isinstance(value, dict) else value
    inner, end = "\n" + " " * (level + 1), "\n" + " " * level
    if SCALAR_TYPES.issuperset(map(type, members)):
        flat = _encoder(level + 1).encode(value)
        return f"{flat[0]}{inner}{flat[1:-1]}{end}{flat[-1]}"
    if isinstance(value, dict):
        parts = (
            f"{dumps(k, ensure_ascii=False)}: {json_text(v, level + 1)}" for k, v in value.items()
        )
        return "{" + inner + f",{inner}".join(parts) + end + "}"
    return "[" + inner + f",{inner}".join(json_text(v, level + 1) for v in value) + end + "]"


@cache
def _encoder(level: int) -> JSONEncoder:
    """Return an encoder whose separator of members is a line break with an indent."""
    return JSONEncoder(ensure_ascii=False, separators=(",\n" + " " * level, ": "))


def finite_json(value: Any) -> Any:
    """Return a JSON value with null for numbers that are not finite, and 0 for −0."""
    if isinstance(value, dict):
        return {k: finite_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        types = set(map(type, value))
        if types == {float}:
            return [v + 0.0 if isfinite(v) else None for v in value]
        if float not in types and SCALAR_TYPES.issuperset(types):
            return list(value)
        return [finite_json(v) for v in value]
    if isinstance(value, float):
        return value + 0.0 if isfinite(value) else None
    return value


def title(text: str) -> list[str]:
    """Return a heading."""
    return [text, "-" * len(text)]


def table(
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    left: int = 1,
    notes: Sequence[str] = (),
) -> list[str]:
    """Return a table as lines; each column is as wide as its longest cell.

    Args:
        header: names of the columns.
        rows: cells, row by row.
        left: number of columns that are flush left; the others are flush right.
        notes: text under each row, empty for no text; either one for every row or none at all.
    """
    cells = [list(header), *(list(r) for r in rows)]
    widths = [max(_width(r[i]) for r in cells) for i in range(len(header))]
    lines = [
        "  ".join(
            c + " " * (w - _width(c)) if i < left else " " * (w - _width(c)) + c
            for i, (c, w) in enumerate(zip(r, widths, strict=True))
        )
        for r in cells
    ]
    out = [f"  {lines[0]}", "  " + "-" * (sum(widths) + 2 * len(widths) - 2)]
    for i, line in enumerate(lines[1:]):
        out.append(f"  {line}")
        if notes and notes[i]:
            out += paragraph(notes[i], indent=6)
    return out


def _width(text: str) -> int:
    """Return the width of a text in characters; combining accents have no width."""
    return len(text) if text.isascii() else sum(not combining(c) for c in text)


def paragraph(text: str, *, indent: int = 2) -> list[str]:
    """Return a text as lines of the report's width; names made by `unbroken` are not broken."""
    blank = " " * indent
    lines = wrap(
        text,
        LINE_WIDTH,
        initial_indent=blank,
        subsequent_indent=blank,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(NO_BREAK, " ") for line in lines]


def clipped(line: str, width: int = LINE_WIDTH) -> str:
    """Return a line that is at most so wide; an ellipsis stands for what is cut off."""
    if _width(line) <= width:
        return line
    kept = line
    while _width(kept) >= width:
        kept = kept[:-1]
    return f"{kept.rstrip()}…"


def unbroken(name: str) -> str:
    """Return a name whose blanks do not break, so that `paragraph` writes it on one line."""
    return name.replace(" ", NO_BREAK)


def without_empty_columns(
    header: Sequence[str], rows: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows without the columns that no row fills."""
    keep = [i for i in range(len(header)) if any(r[i] for r in rows)]
    return [header[i] for i in keep], [[r[i] for i in keep] for r in rows]


def exponent(value: float) -> int:
    """Return the power of ten of the first digit of a positive number."""
    return floor(log10(value))


def decimals(sizes: Iterable[float], *, default: int, most: int) -> int:
    """Return the number of decimals that shows the median of ``sizes`` with two digits."""
    positive = sorted(s for s in sizes if s > 0 and isfinite(s))
    if not positive:
        return default
    return min(max(1 - exponent(positive[len(positive) // 2]), 0), most)


def short(value: float) -> str:
    """Return a value with three significant digits; very large and small ones have exponents."""
    if value == 0 or not isfinite(value):
        return "0" if value == 0 else "–"
    size = exponent(abs(value))
    return f"{value:.2e}" if size > 8 or size < -4 else f"{value:.{max(2 - size, 0)}f}"


def with_sigma(value: float, sigma: float) -> str:
    """Return a value rounded to the second significant digit of its σ."""
    value += 0.0  # −0 is 0
    if not sigma > 0 or not isfinite(sigma):
        return f"{value:.7g}"
    last = exponent(sigma) - 1
    if value == 0 or exponent(abs(value)) > -4:
        return decimal(value, max(-last, 0)) if last > -12 else f"{value:.3e}"
    return f"{value:.{max(exponent(abs(value)) - last, 1)}e}"


def figure(value: float) -> str:
    """Return a derived figure with enough digits for further use; empty if not finite.

    >>> figure(-0.0), figure(float("nan"))
    ('0', '')
    """
    return f"{value + 0.0:.9g}" if isfinite(value) else ""


def figures(values: Array) -> list[str]:
    """Write derived figures, see `figure`."""
    if np.isfinite(values).all():
        return list(map("{:.9g}".format, (values + 0.0).tolist()))
    return [figure(v) for v in values.tolist()]


def percent(share: float) -> str:
    """Return a share as a percentage, with its significant digits."""
    return f"{100 * share:.6g} %"


def listed(names: Sequence[str], most: int) -> str:
    """Return at most ``most`` names as text; a shortened list states the total number."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} … ({len(names)} in all)"


def rms(values: Sequence[float]) -> float:
    """Return the root mean square; NaN for no values."""
    return sqrt(sum(v * v for v in values) / len(values)) if values else nan
