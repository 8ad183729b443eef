"""Units of readings that fit given coordinates better than those that are stated.

The factor of a unit is that by which the values as they were taken become right. Where lengths fit
with a factor f, either they have a unit f times as large as the stated one, or the coordinates one
that is f times smaller: nothing but the sizes of numbers tells which.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ...graph.equations import Equations
from ...models.base import wrap
from ...observations import KINDS
from ...types import Array
from ...units import ANGLE, LENGTH, decimal_angle, significant
from .finding import Finding
from .given_rows import BETTER, computed_values, given_rows, median

LENGTHS: Mapping[str, float] = {
    "feet": 0.3048,
    "US survey feet": 1200.0 / 3937.0,
    "metres": 1.0,
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "kilometres": 1e3,
}
"""Units of lengths that are tried, metres."""
NOUNS: Mapping[str, str] = {"deg": "degrees", "gon": "gon", "rad": "radians"}
"""Units of angles that are tried, and their names."""
SAME_FACTOR = 1e-9
"""Relative difference of factors that are the same."""


def length_factors(stated: str) -> dict[str, float]:
    """Return factors of lengths by what they mean.

    Args:
        stated: unit of lengths in the files.
    """
    size = LENGTH[stated]
    other = {n: f for n, f in LENGTHS.items() if abs(f - size) > SAME_FACTOR * size}
    out = {n: f / size for n, f in other.items()}
    for name, f in other.items():
        same = [n for n, g in out.items() if abs(g * f / size - 1.0) < SAME_FACTOR]
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
    stated = NOUNS.get(plain, plain)
    angles = {
        f"{noun}, not {stated}": ANGLE[u] / ANGLE[plain] for u, noun in NOUNS.items() if u != plain
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
            if not left[unit] * BETTER < min(now, median(computed)):
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
    return median(wrap(v) if turns else v)


def _factor(factor: float) -> str:
    return f"the factor is {significant(factor, 4)}"


def compared_kinds(equations: Equations) -> frozenset[str]:
    """Return the kinds of which given coordinates tell the unit."""
    kinds = dict.fromkeys(b.kind for b in equations.blocks)
    return frozenset(k for k in kinds if any(True for _ in given_rows(equations, k, whole=True)))
