"""Points behind cameras, pulled back to where their rays lead.

A start, or a step, may leave a point behind a camera that sees it. The formula of its image is then
still valid, but vᵀPv has no way back: the point would have to pass infinity or the focal plane. The
point is placed anew instead: where its rays meet, or on one of them at the depth of the other
points of that photo; whichever place lies ahead of most of its cameras, and nearest to its rays.
"""

from __future__ import annotations

import numpy as np

from ..approximate.rays import nearest_to_rays
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.image import in_front
from ..models.inverse import directions
from ..types import Array, Index, Mask


def pulled_back(equations: Equations, state: State, may_move: Mask) -> State:
    """Return a state with fewer points behind cameras; the same object if none can be moved.

    Args:
        equations: the network.
        state: values of all variables.
        may_move: which points only cameras see, (points,); the others are held by more.
    """
    rays = _rays_of_points_behind(equations, state, may_move)
    if rays is None:
        return state
    point, centre, ray, ahead, reach = rays
    points = state["point"].copy()
    changed = False
    for number in np.unique(point).tolist():
        own = np.flatnonzero(point == number)
        c, d, z = centre[own], ray[own], ahead[own]
        meeting = nearest_to_rays(c, d, np.zeros(len(own), dtype=np.intp), 1)[0]
        places = np.concatenate([points[number][None], c + reach[own, None] * d, meeting])
        places = places[np.isfinite(places).all(axis=1)]
        to = places[:, None] - c
        behind = np.sum(np.einsum("kni,ni->kn", to, z) <= 0.0, axis=1)
        along = np.einsum("kni,ni->kn", to, d)
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = np.nan_to_num(along / np.linalg.norm(to, axis=2), nan=-1.0)
        # Rays that miss by much count little: one of them may be a mismatch.
        misses = np.sum(np.sqrt(np.maximum(1.0 - cosine, 0.0)), axis=1)
        best = int(np.lexsort((misses, behind))[0])
        if behind[best] < behind[0]:
            points[number], changed = places[best], True
    return {**state, "point": points} if changed else state


def _rays_of_points_behind(
    equations: Equations, state: State, may_move: Mask
) -> tuple[Index, Array, Array, Array, Array] | None:
    """Return the rays of all points that lie behind one of their cameras; none: there are none.

    Returns:
        Point (n,), projection centre (n, 3), unit vector of the ray (n, 3), unit vector ahead of
        the camera (n, 3), and the median distance of the points ahead of the camera (n,).
    """
    found, depths = [], []
    behind = np.zeros(len(state["point"]), dtype=bool)
    for block in equations.blocks:
        if block.lens is None:
            continue
        photo, camera, point = (block.variables[k][1] for k in range(3))
        z = in_front(state["pose"][photo], state["point"][point], block.lens)
        behind[point[z <= 0]] = True
        found.append((block, photo, camera, point))
        depths.append((photo, z))
    behind &= may_move
    if not behind.any():
        return None
    every_photo, z = (np.concatenate(x) for x in zip(*depths, strict=True))
    usual = np.median(np.abs(z))
    reach = np.full(len(state["pose"]), usual)
    for i in np.unique(every_photo[z > 0]).tolist():
        reach[i] = np.median(z[(every_photo == i) & (z > 0)])
    parts = []
    for block, photo, camera, point in found:
        rows = np.flatnonzero(behind[point])
        if not len(rows):
            continue
        assert block.lens is not None
        calibration = state["calibration"][camera[rows], : len(block.lens.names)]
        seen = directions(block.lens, block.observed[rows], calibration)
        pose = state["pose"][photo[rows]]
        r = pose[:, :9].reshape(-1, 3, 3)
        ray = np.einsum("nij,nj->ni", r, seen)
        parts.append((point[rows], pose[:, 9:], ray, r[:, :, 2], reach[photo[rows]]))
    point, centre, ray, ahead, far = (np.concatenate(x) for x in zip(*parts, strict=True))
    usable = np.isfinite(ray).all(axis=1)
    return point[usable], centre[usable], ray[usable], ahead[usable], far[usable]
