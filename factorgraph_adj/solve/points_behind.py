"""Points behind cameras, pulled back to where their rays lead.

A start, or a step, may leave a point behind a camera that sees it. The formula of its image is then
still valid, but vᵀPv has no way back: the point would have to pass infinity or the focal plane. The
point is placed anew instead: where its rays meet, or on one of them at the depth of the other
points of that photo; whichever place lies ahead of most of its cameras, and nearest to its rays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..approximate.rays import nearest_to_rays
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.image import in_front
from ..models.inverse import directions
from ..models.lens import Lens
from ..types import Array, Index, Mask


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays of points that lie behind one of their cameras."""

    point: Index
    """Number of the point, (n,)."""
    pose: Array
    """Stored pose of the photo, (n, 12)."""
    direction: Array
    """Unit vector of the ray, (n, 3)."""
    reach: Array
    """Median distance of the points ahead of the camera, metres, (n,)."""
    lens: tuple[Lens, ...]
    """Lens of each ray."""

    @classmethod
    def joined(cls, parts: Sequence[_Rays]) -> _Rays:
        """Return the rays of several blocks whose directions are known."""
        point, pose, direction, reach = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("point", "pose", "direction", "reach")
        )
        lenses = tuple(lens for part in parts for lens in part.lens)
        known = np.flatnonzero(np.isfinite(direction).all(axis=1))
        return cls(point, pose, direction, reach, lenses).some(known)

    def some(self, rows: Index) -> _Rays:
        """Return some of the rays."""
        lenses = tuple(self.lens[i] for i in rows.tolist())
        return _Rays(
            self.point[rows], self.pose[rows], self.direction[rows], self.reach[rows], lenses
        )

    def by_point(self) -> Iterator[_Rays]:
        """Iterate over the rays of each point."""
        order = np.argsort(self.point, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(self.point[order])) + 1):
            if len(rows):
                yield self.some(rows)

    def n_behind(self, places: Array) -> Array:
        """Return the number of cameras that do not have a place ahead of them, of places (k, 3)."""
        out = np.zeros(len(places))
        for pose, lens in zip(self.pose, self.lens, strict=True):
            out += in_front(np.tile(pose, (len(places), 1)), places, lens) <= 0.0
        return out


def pulled_ahead(equations: Equations, state: State, may_move: Mask) -> State:
    """Return a state with fewer points behind cameras; the same object if none can be moved.

    Args:
        equations: the network.
        state: values of all variables.
        may_move: which points only cameras see, (points,); the others are held by more.
    """
    every = _rays_of_points_behind(equations, state, may_move)
    if every is None:
        return state
    points = state["point"].copy()
    changed = False
    for rays in every.by_point():
        number = int(rays.point[0])
        c, d = rays.pose[:, 9:], rays.direction
        meeting = nearest_to_rays(c, d, np.zeros(len(d), dtype=np.intp), 1)[0]
        places = np.concatenate([points[number][None], c + rays.reach[:, None] * d, meeting])
        places = places[np.isfinite(places).all(axis=1)]
        behind = rays.n_behind(places)
        to = places[:, None] - c
        along = np.einsum("kni,ni->kn", to, d)
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine = np.nan_to_num(along / np.linalg.norm(to, axis=2), nan=-1.0)
        # Rays that miss by much count little: one of them may be a mismatch.
        misses = np.sum(np.sqrt(np.maximum(1.0 - cosine, 0.0)), axis=1)
        best = int(np.lexsort((misses, behind))[0])
        if behind[best] < behind[0]:
            points[number], changed = places[best], True
    return {**state, "point": points} if changed else state


def _rays_of_points_behind(equations: Equations, state: State, may_move: Mask) -> _Rays | None:
    """Return the rays of all points that lie behind one of their cameras; none: there are none."""
    found, depths = [], []
    behind = np.zeros(len(state["point"]), dtype=bool)
    for place, chunks in equations.rays.items():
        block = equations.blocks[place]
        photo, camera, point = (block.variables[k][1] for k in range(3))
        z = chunks.depths(state)
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
        ray = np.einsum("nij,nj->ni", pose[:, :9].reshape(-1, 3, 3), seen)
        lenses = (block.lens,) * len(rows)
        parts.append(_Rays(point[rows], pose, ray, reach[photo[rows]], lenses))
    return _Rays.joined(parts)
