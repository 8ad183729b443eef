"""The id of an observation: its own, or that of its image point."""

from __future__ import annotations

from .base import Observation
from .image import ImagePoint


def identity(o: Observation) -> str | None:
    """Return the id of an observation; none where the network has to number it."""
    own: str | None = getattr(o, "id", None)
    if own is None and isinstance(o, ImagePoint):
        return f"{o.photo}/{o.point}"
    return own


def named(o: Observation, ident: str) -> Observation:
    """Return the observation with its id; image points keep photo/point as theirs."""
    if isinstance(o, ImagePoint) and ident == f"{o.photo}/{o.point}":
        return o
    if getattr(o, "id", None) == ident:
        return o
    other = object.__new__(type(o))  # all else has been checked when it was made
    vars(other).update(vars(o), id=ident)
    return other
