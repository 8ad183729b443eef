"""Points that the adjustment has put at one another's given coordinates.

Where two names are exchanged in all readings, nothing contradicts: the network fits, and each point
is where the other one is. Only approximate coordinates that were given can tell.
"""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array, Index

MOVED = 10.0
"""Smallest movement of such a point, and distance between two of them, relative to the median of
the movements of all points from their given coordinates."""
NEAR = 0.1
"""Largest distance of a point from the other's given coordinates, relative to its movement."""
FEWEST = 5
"""Smallest number of points with given coordinates whose median says how good these are."""
MOST = 1000
"""Largest number of points that moved far and are compared with one another."""


def exchanged_places(equations: Equations, state: State) -> tuple[str, ...]:
    """Return a sentence for each ring of points that lie at one another's given coordinates.

    Point p lies at the given coordinates of q if |x_p − x_q⁰| ≤ `NEAR` |x_p − x_p⁰|.

    Args:
        equations: the network.
        state: where the adjustment has ended.
    """
    table = equations.unknowns["point"]
    loose = table.free.all(axis=1) & ~np.isfinite(table.sigma).any(axis=1)
    known = np.flatnonzero(loose & np.isfinite(table.values).all(axis=1))
    if len(known) < FEWEST:
        return ()
    given, at = table.values[known], state["point"][known]
    moved = np.linalg.norm(at - given, axis=1)
    least = MOVED * float(np.median(moved))
    far = np.flatnonzero(moved > least)
    if not 2 <= len(far) <= MOST:
        return ()
    apart = np.linalg.norm(at[far][:, None] - given[far], axis=2)
    nearest = apart.argmin(axis=1)
    close = apart[np.arange(len(far)), nearest] <= NEAR * moved[far]
    names = [table.names[i] for i in known[far].tolist()]
    return tuple(_sentence([names[i] for i in ring]) for ring in _rings(nearest, close))


def _rings(nearest: Index, close: Array) -> list[list[int]]:
    """Return the rings p → nearest(p) → … → p of two and more."""
    out: list[list[int]] = []
    seen: set[int] = set()
    for first in range(len(nearest)):
        ring, here = [], first
        while close[here] and here not in ring:
            ring.append(here)
            here = int(nearest[here])
        if len(ring) > 1 and here == first and not seen & set(ring):
            out.append(ring)
        seen |= set(ring)
    return out


def _sentence(names: list[str]) -> str:
    ring = f"{', '.join(map(repr, names[:-1]))} and {names[-1]!r}"
    return (
        f"points {ring} lie at one another's given coordinates: their names may be exchanged in "
        "all readings"
    )
