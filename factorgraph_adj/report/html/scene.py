"""Data of the 3-D view: points, photos and sights."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...types import Array, Index
from ..plots.image_rows import image_rows
from ..plots.network import in_frames_of
from ..plots.sights import lines_by_kinds, photo_shapes
from .plan import Plan

MOST_RAYS = 4000
"""Largest number of image rays that are drawn, evenly spread over all."""
MOST_LINES = 20_000
"""Largest number of sights between points that are drawn, evenly spread over all."""
FLAT = 0.1
"""Heights of a network whose extent is a smaller part of the plan's are exaggerated in the view."""


def scene(plan: Plan) -> dict[str, Any] | None:
    """Return points, photos and sights in three dimensions; None where there is only one."""
    if plan.schematic or len(plan.points) + len(plan.centres) < 2:
        return None
    solution = plan.report.solution
    points = plan.plane.coordinates(plan.xyz)
    centres = plan.plane.coordinates(solution.state["pose"][:, 9:])
    extent = np.ptp(np.concatenate([points, centres]), axis=0)
    if not extent[2] > 1e-9 * max(float(extent.max()), 1e-9):
        return None
    found = in_frames_of(solution, plan.plane)
    standing = np.zeros((1, 3))
    instruments = [found.frames.places(f, standing)[0] for f in found.frames.instruments.tolist()]
    at = np.concatenate([points, plan.plane.coordinates(np.array(instruments).reshape(-1, 3))])
    return {
        "names": list(plan.report.network.points),
        "axes": [plan.words(a) for a in plan.plane.names],
        "flat": bool(extent[2] < FLAT * float(extent[:2].max())),
        "points": _lists(points),
        "lines": _sights(plan, at, found.frames.instruments),
        "rays": _rays(plan, points, centres),
        "photos": _photos(plan, extent),
    }


def _sights(plan: Plan, at: Array, instruments: Index) -> list[dict[str, Any]]:
    groups = lines_by_kinds(plan.report.solution, instruments)
    stride = _stride(sum(len(ends) for _, ends in groups), MOST_LINES)
    out = []
    for kinds, ends in groups:
        out.append({"kinds": plan.t.kinds(kinds), "xyz": _segments(at[ends[::stride]])})
    return out


def _rays(plan: Plan, points: Array, centres: Array) -> dict[str, Any]:
    rows = image_rows(plan.report.solution)
    stride = _stride(len(rows.row), MOST_RAYS)
    ends = np.stack([centres[rows.photo[::stride]], points[rows.point[::stride]]], axis=1)
    return {"all": len(rows.row), "shown": len(ends), "xyz": _segments(ends)}


def _photos(plan: Plan, extent: Array) -> dict[str, Any]:
    solution, n = plan.report.solution, len(plan.centres)
    if not n:
        return {"names": [], "xyz": [[], [], []], "shapes": [[], [], []]}
    size = 0.07 * float(extent.max()) / max(1.0, np.sqrt(n / 30))
    shapes = photo_shapes(solution, image_rows(solution), size)
    flat = plan.plane.coordinates(shapes.reshape(-1, 3)).reshape(n, -1, 3)
    return {
        "names": list(plan.report.network.photos),
        "xyz": _lists(plan.plane.coordinates(solution.state["pose"][:, 9:])),
        "shapes": _segments(flat),
    }


def _stride(n: int, most: int) -> int:
    return max(-(-n // most), 1)


def _lists(places: Array) -> list[list[float]]:
    """Return places (n, 3) as the lists of their coordinates."""
    x, y, z = np.round(places.reshape(-1, 3), 4).T.tolist()
    return [x, y, z]


def _segments(lines: Array) -> list[list[float | None]]:
    """Return lines (n, k, 3) as three lists, with None after each line."""
    n, k = lines.shape[:2]
    out: list[list[float | None]] = []
    for axis in range(3):
        ends = np.full((n, k + 1), np.nan)
        ends[:, :k] = np.round(lines[:, :, axis], 4)
        out.append([None if v != v else v for v in ends.ravel().tolist()])
    return out
