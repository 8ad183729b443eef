"""Angles in a wrong unit, told without given coordinates: by the circle, and by level sights.

No instrument reads more than a full circle. Zenith angles of most sights are near those of level
ones, and the readings of both faces, or forth and back, have sums that only the right unit has.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ...network.network import Network
from ...observations import KINDS, Observation
from ...types import Array, Mask
from ...units import ANGLE, TURN, decimal_angle, format_angle
from .finding import Finding
from .given_rows import BETTER

ROUNDING = 1e-9
"""Share of a circle that a reading may lie beyond it by rounding: 400 gon is a valid reading."""
OTHERS = ("gon", "deg", "mgon", "arcmin", "cc", "arcsec", "mrad", "rad")
"""Units in which a reading beyond the circle may have been meant, the likeliest first."""
PLAIN = ("gon", "deg", "rad")
"""Units of circles of instruments."""
SUMS = 2
"""Smallest number of sums of two readings that tell a unit."""
SIGHTS = 6
"""Smallest number of sights that tell a unit because they are nearly level."""
MOST = 0.9
"""Share of readings that must be nearer to what is right in another unit."""
NOUNS = {"deg": "degrees", "rad": "radians"}
"""Names of units in sentences, where they differ."""


def beyond_circle(network: Network, unit: str) -> Iterator[Finding]:
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
        if largest <= TURN * (1.0 + ROUNDING):
            continue
        number = largest / ANGLE[stated]
        fits = [u for u in OTHERS if number <= TURN / ANGLE[u] * (1.0 + ROUNDING)]
        meant = f"valid in {_noun(fits[0])} (0 to {_circle(fits[0])})" if fits else ""
        yield Finding(
            f"{o.label()}: {format_angle(largest, unit, 4)} {_noun(unit)} is more than the full "
            f"circle of {full:g} {_noun(stated)}, which no instrument reads",
            f"{f'it is {meant}: ' if meant else ''}state the unit in which it was read, or look "
            "for a wrong digit",
        )


def level_sights(network: Network, unit: str, compared: frozenset[str]) -> Iterator[Finding]:
    """Iterate over kinds whose level sights read what is level in another unit.

    Sums of both faces, and of sights forth and back, decide where there are some. Where there are
    none, at least `SIGHTS` readings must lie `BETTER` times nearer to the level of the other unit.

    Args:
        network: the network.
        unit: unit of angles in its files.
        compared: kinds of which given coordinates tell.
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
        summed = len(sums) >= SUMS
        if not summed and len(values) < SIGHTS:
            continue
        off: dict[str, Array] = {}
        for u in (*PLAIN, stated):
            factor = ANGLE[u] / ANGLE[stated]
            folded = np.where(second, TURN - factor * values, factor * values) / level
            off[u] = np.abs((factor * sums if summed else folded) - 1.0)
        best = min(off, key=lambda u: float(np.median(off[u])))
        nearer = float(np.mean(off[best] < off[stated]))
        if float(np.median(off[best])) * BETTER < float(np.median(off[stated])) and nearer > MOST:
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
    return NOUNS.get(unit, unit)


def _circle(unit: str) -> str:
    return f"{TURN / ANGLE[unit]:.10g}"
