"""`ImagePoint`; ids of observations of every kind, and the next number that is free in them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from .base import Observation


@dataclass(frozen=True)
class ImagePoint(Observation):
    """Image coordinates of a point in a photo, units of the camera, x right, y up. Eq. 1."""

    kind: ClassVar[str] = "image"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    point: str
    """The point."""
    x: float
    """Measured x, image units."""
    y: float
    """Measured y, image units."""
    _: KW_ONLY
    sigma: tuple[float, float] | float
    """Standard deviations of x and y, or one for both, image units."""


def identity(o: Observation) -> str | None:
    """Return the id of an observation; None where the network has to number it."""
    if o.id is None and isinstance(o, ImagePoint):
        return f"{o.photo}/{o.point}"
    return o.id


MAX_DIGITS = 18
"""Largest number of digits of an id that counts as a number: no count of observations has more."""


def number_beyond(ids: Iterable[str], first: int = 1) -> int:
    """Return the least number, from a first one on, that is beyond those among some ids."""
    numbers = (int(i) + 1 for i in ids if i.isdecimal() and len(i) <= MAX_DIGITS)
    return max(first, max(numbers, default=first))


def named(o: Observation, ident: str) -> Observation:
    """Return the observation with its id; image points keep photo/point as theirs."""
    if isinstance(o, ImagePoint) and ident == f"{o.photo}/{o.point}":
        return o
    if o.id == ident:
        return o
    other = object.__new__(type(o))  # all else has been checked when it was made
    vars(other).update(vars(o), id=ident)
    return other
