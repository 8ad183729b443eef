"""Wrong units of readings: by given coordinates, by the full circle, and by level sights.

The factor of a unit is that by which the values as they were read become right. Where lengths fit
with a factor f, either they have a unit f times as large as the stated one, or the coordinates one
that is f times smaller: nothing but the sizes of numbers distinguishes the two.

Without given coordinates, angles show their unit: no instrument reads more than a full circle.
Zenith angles of most sights are near those of level ones, and the readings of both faces, or forth
and back, have sums that only the right unit has.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..graph.equations import Equations
from ..models.base import wrap
from ..network.network import Network
from ..observations import KINDS, Observation
from ..types import Array, Mask
from ..units import (
    ANGLE,
    FOOT,
    LENGTH,
    TURN,
    US_SURVEY_FOOT,
    decimal_angle,
    format_angle,
    significant,
)
from .findings import MIN_FIT_IMPROVEMENT, Finding, computed_values, given_rows, median_size

CIRCLE_ROUNDING = 1e-9
"""Share of a circle that a reading may lie beyond it by rounding: 400 gon is a valid reading."""
TRIED_ANGLE_UNITS = ("gon", "deg", "mgon", "arcmin", "cc", "arcsec", "mrad", "rad")
"""Units in which a reading beyond the circle may have been meant, the most probable first."""
INSTRUMENT_ANGLE_UNITS = ("gon", "deg", "rad")
"""Units of circles of instruments."""
MIN_READING_SUMS = 2
"""Smallest number of sums of two readings that determine a unit."""
MIN_LEVEL_SIGHTS = 6
"""Smallest number of sights that determine a unit because they are nearly level."""
MIN_NEARER_SHARE = 0.9
"""Share of readings that must be nearer to what is right in another unit."""
UNIT_FACTOR_ROUNDING = 1e-9
"""Relative difference of factors that are the same."""
TRIED_LENGTH_UNITS: Mapping[str, float] = {
    "feet": FOOT,
    "US survey feet": US_SURVEY_FOOT,
    "metres": 1.0,
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "kilometres": 1e3,
}
"""Units of lengths that are tried, metres."""
ANGLE_UNIT_NAMES: Mapping[str, str] = {"deg": "degrees", "gon": "gon", "rad": "radians"}
"""Units of angles that are tried, and their names."""


def angles_beyond_circle(network: Network, unit: str) -> Iterator[Finding]:
    """Iterate over angles of any kind that lie beyond the full circle.

    Args:
        network: the network.
        unit: unit of angles in its files.
    """
    stated = decimal_angle(unit)
    full = TURN / ANGLE[stated]
    for o in network.observations.values():
        record = KINDS.get(o.kind)
        if record is None or record.unit != "rad":
            continue
        value: Any = o.value  # type: ignore[attr-defined]
        largest = float(np.max(np.abs(value)))
        if largest <= TURN * (1.0 + CIRCLE_ROUNDING):
            continue
        if not o.source:  # its value is as a program gave it, in radians
            yield _beyond_circle_in_radians(o, np.ravel(value), largest)
            continue
        number = largest / ANGLE[stated]
        fits = [u for u in TRIED_ANGLE_UNITS if number <= TURN / ANGLE[u] * (1.0 + CIRCLE_ROUNDING)]
        meant = f"valid in {_noun(fits[0])} (0 to {_circle(fits[0])})" if fits else ""
        yield Finding(
            f"{o.label()}: {format_angle(largest, unit, 4)} {_noun(unit)} is more than the full "
            f"circle of {full:g} {_noun(stated)}, which no instrument reads",
            f"{f'it is {meant}: ' if meant else ''}state the unit in which it was read, or look "
            "for a wrong digit",
        )


def _beyond_circle_in_radians(o: Observation, values: Array, largest: float) -> Finding:
    """Return the finding of an angle beyond the full circle that no file states."""
    given = f"{values[int(np.argmax(np.abs(values)))]:.10g}"
    if largest <= TURN / ANGLE["deg"] * (1.0 + CIRCLE_ROUNDING):
        meant = "it looks like gon or degrees: multiply it by fga.GON, or use math.radians"
    elif largest <= TURN / ANGLE["gon"] * (1.0 + CIRCLE_ROUNDING):
        meant = "it looks like gon: multiply it by fga.GON"
    else:
        meant = "convert it (gon: multiply by fga.GON; degrees: math.radians)"
    return Finding(
        f"{o.label()}: an angle in radians is expected; {given} is more than the full circle of "
        f"{TURN:.4f}, which no instrument reads",
        f"{meant}, or look for a wrong digit",
    )


def level_sights(network: Network, unit: str, compared: frozenset[str]) -> Iterator[Finding]:
    """Iterate over kinds whose level sights read what is level in another unit.

    Sums of both faces, and of sights forth and back, decide where there are some. Where there are
    none, at least `MIN_LEVEL_SIGHTS` readings must lie `MIN_FIT_IMPROVEMENT` times nearer to the
    level of the other unit.

    Args:
        network: the network.
        unit: unit of angles in its files.
        compared: kinds of which given coordinates determine the unit.
    """
    stated = decimal_angle(unit)
    own: dict[str, list[Observation]] = defaultdict(list)
    for o in network.observations.values():
        record = KINDS.get(o.kind)
        if record is not None and record.level_reading is not None and o.kind not in compared:
            own[o.kind].append(o)
    for kind, some in own.items():
        level = KINDS[kind].level_reading
        assert level is not None
        sums = _sums(some)
        values: Array = np.array([_value(o) for o in some])
        second: Mask = np.array([getattr(o, "face", 1) == 2 for o in some])
        summed = len(sums) >= MIN_READING_SUMS
        if not summed and len(values) < MIN_LEVEL_SIGHTS:
            continue
        off: dict[str, Array] = {}
        for u in (*INSTRUMENT_ANGLE_UNITS, stated):
            factor = ANGLE[u] / ANGLE[stated]
            folded = np.where(second, TURN - factor * values, factor * values) / level
            off[u] = np.abs((factor * sums if summed else folded) - 1.0)
        best = min(off, key=lambda u: float(np.median(off[u])))
        nearer = float(np.mean(off[best] < off[stated]))
        if (
            float(np.median(off[best])) * MIN_FIT_IMPROVEMENT < float(np.median(off[stated]))
            and nearer > MIN_NEARER_SHARE
        ):
            plain = level / ANGLE[best]
            why = (
                f"{len(sums)} sums of both faces, or of sights forth and back, fit"
                if summed
                else f"they lie near {plain:.4g}, which is level"
            )
            yield Finding(
                f"the values of {len(some)} {kind.replace('_', ' ')}s are in {_noun(best)}, not "
                f"in {_noun(stated)}: {why} in {_noun(best)}, the first {some[0].label()}",
                f"state their unit; in {_noun(stated)} a level sight reads "
                f"{level / ANGLE[stated]:.4g}",
                ids=tuple(i for i, o in network.observations.items() if o.kind == kind),
            )


def _sums(some: Sequence[Observation]) -> Array:
    """Return sums of two readings in those of right ones: both faces 2π, forth and back π."""
    first: dict[tuple[object, ...], float] = {}
    for o in some:
        if getattr(o, "face", 1) == 1:
            first.setdefault(o.names(), float(o.value))  # type: ignore[attr-defined]
    out = []
    for o in some:
        names, value = o.names(), _value(o)
        if getattr(o, "face", 1) == 2:
            if names in first:
                out.append((value + first[names]) / TURN)
        elif len(o.points()) > 1 and names < names[::-1] and names[::-1] in first:
            out.append((value + first[names[::-1]]) / (TURN / 2.0))
    return np.array(out)


def _value(o: Observation) -> float:
    """Return the reading of an angle."""
    return float(o.value)  # type: ignore[attr-defined]


def _noun(unit: str) -> str:
    return ANGLE_UNIT_NAMES.get(unit, unit)


def _circle(unit: str) -> str:
    return f"{TURN / ANGLE[unit]:.10g}"


def length_factors(stated: str) -> dict[str, float]:
    """Return factors of lengths by what they mean.

    Args:
        stated: unit of lengths in the files.
    """
    size = LENGTH[stated]
    other = {
        n: f for n, f in TRIED_LENGTH_UNITS.items() if abs(f - size) > UNIT_FACTOR_ROUNDING * size
    }
    out = {n: f / size for n, f in other.items()}
    for name, f in other.items():
        same = [n for n, g in out.items() if abs(g * f / size - 1.0) < UNIT_FACTOR_ROUNDING]
        if not same:
            out[f"they stand, with the coordinates in {name}"] = size / f
    return out


def wrong_units(equations: Equations, length: str, angle: str) -> Iterator[Finding]:
    """Iterate over kinds of observations whose values fit in another unit.

    Args:
        equations: the network.
        length: unit of lengths in the files.
        angle: unit of angles in the files.
    """
    plain = decimal_angle(angle)
    stated = ANGLE_UNIT_NAMES.get(plain, plain)
    angles = {
        f"{noun}, not {stated}": ANGLE[u] / ANGLE[plain]
        for u, noun in ANGLE_UNIT_NAMES.items()
        if u != plain
    }
    lengths = length_factors(length)
    for kind in dict.fromkeys(b.kind for b in equations.blocks):
        record = KINDS.get(kind)
        # Readings of rotations have no unit that one factor changes.
        if record is None or record.moved is not None or record.unit not in ("m", "rad"):
            continue
        factors = lengths if record.unit == "m" else angles
        for block, rows in given_rows(equations, kind, whole=True):
            observed, computed = computed_values(equations, block, rows)

            turns = record.circular
            now = _misfit(1.0, observed, computed, turns)
            left = {u: _misfit(f, observed, computed, turns) for u, f in factors.items()}
            unit = min(left, key=lambda u: left[u])
            # Values near zero fit everything: the unit must explain the computed values.
            if not left[unit] * MIN_FIT_IMPROVEMENT < min(now, median_size(computed)):
                continue
            times = f"{now / max(left[unit], 1e-12):.0f} times better as {unit}"
            remedy = "state their unit"
            if record.unit == "m":
                remedy += f", or that of the coordinates ({length} is stated): " + _factor(
                    factors[unit]
                )
            yield Finding(
                f"the values of {len(rows)} {kind.replace('_', ' ')}s fit the given "
                f"coordinates {times}",
                remedy,
                ids=tuple(block.ids[int(i)] for i in rows),
            )


def _misfit(factor: float, observed: Array, computed: Array, turns: bool) -> float:
    """Return the median misfit of values times a factor; angles of the circle the shorter way."""
    v = factor * observed - computed
    return median_size(wrap(v) if turns else v)


def _factor(factor: float) -> str:
    return f"the factor is {significant(factor, 4)}"


def compared_kinds(equations: Equations) -> frozenset[str]:
    """Return the kinds of which given coordinates determine the unit."""
    kinds = dict.fromkeys(b.kind for b in equations.blocks)
    return frozenset(k for k in kinds if any(True for _ in given_rows(equations, k, whole=True)))
