"""Points that an adjustment has driven to infinity, or to a projection centre.

A wrong image point makes rays that meet nowhere ahead of their cameras. vᵀPv may then fall without
end as their point moves away, or towards the projection centre of the wrong one, where it has every
direction: there is no minimum at a finite distance.
"""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State

FAR, NEAR = 1e3, 1e-3
"""Distances of a point from a photo, relative to the median of all image points, above and below
which it counts as infinitely far away, and as being at the projection centre."""
MAX_POINTS_IN_MESSAGE = 5
"""Largest number of points that a reason names of each."""


def points_without_place(equations: Equations, state: State) -> str:
    """Return in words which points have run to infinity or to a camera; empty: none has.

    Args:
        equations: the network.
        state: values of all variables where an iteration ended.
    """
    rays = []
    for block in equations.blocks:
        if block.lens is not None:
            photo, point = block.variables[0][1], block.variables[2][1]
            sight = state["point"][point] - state["pose"][photo, 9:]
            rays.append((photo, point, np.linalg.norm(sight, axis=1)))
    if not rays:
        return ""
    photo, point, distance = (np.concatenate(x) for x in zip(*rays, strict=True))
    ratio = distance / np.median(distance)
    nearest = np.full(len(state["point"]), np.inf)
    np.minimum.at(nearest, point, ratio)
    seen = np.isfinite(nearest)
    points, photos = equations.unknowns["point"].names, equations.unknowns["pose"].names
    far = [points[i] for i in np.flatnonzero(seen & (nearest > FAR)).tolist()]
    at = np.flatnonzero(ratio < NEAR)
    near = [
        f"{points[p]} at that of photo {photos[f]}"
        for p, f in zip(point[at].tolist(), photo[at].tolist(), strict=True)
    ]
    parts = []
    if far:
        parts.append(f"points at infinity: {_listed(far)}")
    if near:
        parts.append(f"points at projection centres: {_listed(near)}")
    if not parts:
        return ""
    return (
        f"{'; '.join(parts)}; their rays meet nowhere ahead of the cameras, so that vᵀPv has no "
        "minimum with them: data snooping (adjust --snoop, fga.snoop) finds wrong image points"
    )


def _listed(names: list[str]) -> str:
    more = len(names) - MAX_POINTS_IN_MESSAGE
    return ", ".join(names[:MAX_POINTS_IN_MESSAGE]) + (f" and {more} more" if more > 0 else "")
