"""The scale of a part whose rotation and one place are known, by rays that leave the part.

A photo of the part is at C(s) = Y + s R (c − x), where x is the known place in the axes of the part
and Y in the frame. A ray R t of it that meets a known point P gives

    (P − C(s)) × R t = 0,

and one that meets a ray d from C' of a photo that stands, but is not of the part,

    d · ((C(s) − C') × R t) = 0:

both are linear in s.
"""

from __future__ import annotations

import numpy as np

from ..types import Array
from .growth import Growth
from .known import Known

STRONG = 0.3
"""Smallest lever of a ray, part of the largest one, with which it counts."""


def scales_by_rays(
    growth: Growth, known: Known, rotation: Array, place: tuple[Array, Array]
) -> list[float]:
    """Return scales of a part, one of each ray that tells it.

    Args:
        growth: the part.
        known: coordinates and attitudes, NaN where unknown.
        rotation: R, from the axes of the part to the frame.
        place: a place in the axes of the part, and in the frame, (3,) each.
    """
    v, (x, y) = growth.views, place
    rows = np.flatnonzero(growth.rays.usable & growth.posed[v.photo] & ~growth.placed[v.point])
    if not len(rows):
        return []
    pose = growth.pose[v.photo[rows]]
    ray = directions_of_rays(pose, growth.rays.tangent[rows]) @ rotation.T
    moved = (pose[:, 9:] - x) @ rotation.T
    there = np.isfinite(known.point[v.point[rows]]).all(axis=1)
    lever = np.cross(moved[there], ray[there])
    goal = np.cross(known.point[v.point[rows[there]]] - y, ray[there])
    out = _solved((lever * lever).sum(axis=1), (lever * goal).sum(axis=1))
    stands = np.isfinite(known.pose).all(axis=1) & ~growth.posed
    others = np.flatnonzero(growth.rays.usable & stands[v.photo])
    if not len(others):
        return out
    theirs = known.pose[v.photo[others]]
    d = directions_of_rays(theirs, growth.rays.tangent[others])
    order = np.argsort(v.point[others], kind="stable")
    first = np.searchsorted(v.point[others][order], v.point[rows])
    meets = np.append(v.point[others][order], -1)[first] == v.point[rows]
    one, other = np.flatnonzero(meets), order[first[meets]]
    normal = np.cross(ray[one], d[other])
    a = (normal * moved[one]).sum(axis=1)
    b = (normal * (theirs[other, 9:] - y)).sum(axis=1)
    return out + _solved(a * a, a * b)


def _solved(weight: Array, product: Array) -> list[float]:
    strong = weight > STRONG**2 * weight.max(initial=0.0)
    found = product[strong] / weight[strong]
    return [float(s) for s in found[found > 0.0]]


def directions_of_rays(pose: Array, tangent: Array) -> Array:
    """Return unit vectors of rays (n, 3), from stored poses (n, 12) and tangents x, y up (n, 2)."""
    r, t = pose[:, :9], tangent
    d = r[:, 0::3] * t[:, :1] - r[:, 1::3] * t[:, 1:] + r[:, 2::3]
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))
