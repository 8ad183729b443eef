"""Ids of observations: stated ones, photo/point of image points, and the next free number."""

from __future__ import annotations

from collections.abc import Iterable

from .base import Observation
from .image import ImagePoint

MAX_DIGITS = 18
"""Largest number of digits of an id that counts as a number: no count of observations has more."""


def identity(o: Observation) -> str | None:
    """Return the id of an observation; None where the network has to number it."""
    if o.id is None and isinstance(o, ImagePoint):
        return f"{o.photo}/{o.point}"
    return o.id


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
