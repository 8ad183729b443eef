"""Trends of a collocation: the functions A x of the places that are no signal.

With places p (n, d), centred and divided by a scale, and c components at each of them:

    none          nothing
    mean          a constant of each component                    c unknowns
    plane         a constant and d slopes of each component       c (d + 1); affine in plan
    similarity    shift, turn and scale of two components in plan, a constant of a third one
                  4 or 5; Helmert's transformation

Ordinary kriging has the trend ``mean``, universal kriging with linear drift ``plane``, simple
kriging ``none``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, known
from ..types import Array


def _of_each_component(columns: Array, components: int) -> Array:
    """Return columns (n, k) as design of each component alone, (n, c, c k)."""
    n, k = columns.shape
    out = np.zeros((n, components, components, k))
    for i in range(components):
        out[:, i, i] = columns
    return out.reshape(n, components, components * k)


def _mean(q: Array, components: int) -> Array:
    return _of_each_component(np.ones((len(q), 1)), components)


def _plane(q: Array, components: int) -> Array:
    return _of_each_component(np.column_stack([np.ones(len(q)), q]), components)


def _similarity(q: Array, components: int) -> Array:
    if components not in (2, 3) or q.shape[1] < 2:
        raise InputError(
            "the trend similarity is of two components in plan, and a third one, at places with x "
            f"and y; these have {components} components and {q.shape[1]} coordinates"
        )
    x, y = q[:, 0], q[:, 1]
    out = np.zeros((len(q), components, 4 + (components == 3)))
    out[:, 0, 0], out[:, 0, 2], out[:, 0, 3] = 1.0, x, -y
    out[:, 1, 1], out[:, 1, 2], out[:, 1, 3] = 1.0, y, x
    if components == 3:
        out[:, 2, 4] = 1.0
    return out


def _none(q: Array, components: int) -> Array:
    return np.zeros((len(q), components, 0))


TRENDS: dict[str, Callable[[Array, int], Array]] = {
    "none": _none,
    "mean": _mean,
    "plane": _plane,
    "similarity": _similarity,
}
"""Design of each trend of centred and scaled places and a number of components, (n, c, u)."""


@dataclass(frozen=True)
class Trend:
    """A trend with the centre and the scale of its places."""

    kind: str
    """Its name in `TRENDS`."""
    components: int
    """Number c of components."""
    centre: Array
    """Mean of the places, (d,)."""
    scale: float
    """Largest distance of a coordinate from the mean, at least a positive number."""

    @classmethod
    def of(cls, kind: str, places: Array, components: int) -> Trend:
        """Return the trend of places (n, d).

        Raises:
            InputError: the kind is unknown.
        """
        if kind not in TRENDS:
            raise InputError(f"trend {kind!r} is unknown; valid: {known(TRENDS, most=len(TRENDS))}")
        centre = places.mean(axis=0)
        scale = float(np.abs(places - centre).max(initial=0.0))
        return cls(kind, components, centre, scale if scale > 0 else 1.0)

    def design(self, places: Array) -> Array:
        """Return the design A at places (m, d), (m, c, u)."""
        return TRENDS[self.kind]((places - self.centre) / self.scale, self.components)
