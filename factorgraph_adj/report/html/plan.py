"""Plan and 3-D view of the HTML page as data: points, ellipses, sights, photos, shapes, suspects.

Lengths are metres in the drawing plane of `plots.drawing_plane`. The regions of confidence are
those of `plots.error_ellipses`; the page exaggerates them by one factor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import Any

import numpy as np

from ...frames import GeocentricFrame
from ...quality.error_ellipses import FIXED_AXIS_VARIANCE_RATIO
from ...quality.reliability import point_redundancy
from ...statistical_tests import CONFIDENCE_OF_REGION
from ...types import Array, Index
from ..adjusted_coordinates import place_name
from ..adjusted_observations import test_symbol
from ..adjustment_report import Report
from ..catalogue import Texts
from ..layout import percent
from ..plots.drawing_plane import DrawingPlane, drawing_plane_of, places_of_window
from ..plots.error_ellipses import (
    MAX_ELLIPSE_SIZE,
    ConfidenceRegions,
    confidence_regions,
    visible_factor,
)
from ..plots.image_residuals import image_rows
from ..plots.network_plan import frame_contents, order_along_lines
from ..plots.observation_lines import lines_by_kinds, observation_places, photo_outlines
from ..plots.point_symbols import plan_window
from ..plots.style import factor_text, length_text, readable_number
from .estimates import POINT_STATES, largest_tests, point_states

MAX_DOUBTS_MARKED = 300
"""Largest number of observations in doubt that are marked, those with the largest tests first."""
AXIS_WORDS = ("east of the centre", "north of the centre", "east", "north", "up", "horizon at")
"""Words in the names of axes and in the note of a drawing plane, the longer ones first."""
COINCIDENT_EXTENT_ON_PAGE_M = 1e-6
"""Largest extent, metres, at which points count as coincident; the plan then shows 2 m."""
MAX_RAYS_DRAWN = 4000
"""Largest number of image rays that are drawn, evenly spread over all."""
MAX_SIGHTS_DRAWN = 20_000
"""Largest number of sights between points that are drawn, evenly spread over all."""
MIN_HEIGHT_SHARE = 0.1
"""Heights of a network whose extent is a smaller part of the plan's are exaggerated in the view."""


@dataclass(frozen=True, eq=False)
class PlanDrawing:
    """The drawing of a network, and what the page needs to draw it."""

    report: Report
    """The report."""
    t: Texts
    """Words of its language."""

    @cached_property
    def xyz(self) -> Array:
        """Coordinates of the points, (n, 3) metres."""
        return np.nan_to_num(self.report.solution.state["point"])

    @cached_property
    def plane(self) -> DrawingPlane:
        """Drawing plane of the network."""
        centres = self.report.solution.state["pose"][:, 9:]
        everything = self.xyz if len(self.xyz) else centres
        return drawing_plane_of(self.report.network.frame, everything)

    @cached_property
    def without_plan(self) -> bool:
        """Whether no plan coordinate is unknown, so that intervals of heights are drawn."""
        solution = self.report.solution
        free = solution.equations.unknowns["point"].free
        geocentric = isinstance(solution.network.frame, GeocentricFrame)
        return bool(not geocentric and len(free) and not free[:, :2].any())

    @cached_property
    def schematic(self) -> bool:
        """Whether points have heights only; they are drawn side by side then."""
        flat = len(self.xyz) and not np.ptp(self.xyz[:, :2], axis=0).any()
        return bool(self.without_plan and not self.report.network.photos and flat)

    @cached_property
    def points(self) -> Array:
        """Places of points, (n, 2)."""
        if self.schematic:
            return np.stack([order_along_lines(self.report.solution), self.xyz[:, 2]], 1).astype(
                float
            )
        return self.plane.coordinates(self.xyz)[:, :2]

    @cached_property
    def centres(self) -> Array:
        """Places of projection centres, (m, 2)."""
        return self.plane.coordinates(self.report.solution.state["pose"][:, 9:])[:, :2]

    @property
    def confidence(self) -> float:
        """Probability of the ellipses."""
        return self.report.options.confidence or CONFIDENCE_OF_REGION

    @cached_property
    def precision(self) -> ConfidenceRegions | None:
        """Regions of confidence; None where there are no covariances."""
        if self.report.singular:
            return None
        solution, doubtful = self.report.solution, bool(self.report.doubts)
        bars = self.without_plan
        return confidence_regions(solution, self.plane, self.confidence, None, bars, doubtful)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower left and upper right corner of the drawing."""
        found = frame_contents(self.report.solution, self.plane)
        places = np.concatenate([self.points, found.instruments])
        if not self.schematic:
            places = np.concatenate([places, self.centres])
        if not len(places):
            return np.zeros(2), np.ones(2)
        low, high, _ = plan_window(places)
        if not self.schematic:
            reach = places_of_window(np.stack([low, high]), found.shapes)
            low, high = reach.min(axis=0), reach.max(axis=0)
        if float(np.max(high - low)) < COINCIDENT_EXTENT_ON_PAGE_M:
            return low - 1.0, high + 1.0
        return low, high

    @cached_property
    def factor(self) -> float:
        """Exaggeration of the regions."""
        sizes = np.zeros(0) if self.precision is None else self.precision.positive_sizes
        if not len(sizes):
            return 1.0
        typical = float(np.median(sizes))
        if self.schematic:
            return readable_number(0.06 * (float(np.ptp(self.points[:, 1])) or 1.0) / typical)
        return visible_factor(
            typical, self.points if len(self.points) else self.centres, self.limits
        )

    def words(self, text: str) -> str:
        """Return the name of an axis, or the note of the plane, in the language of the report."""
        return axis_words(text, self.t)

    def data(self) -> dict[str, Any]:
        """Return what the script of the page draws."""
        low, high = self.limits
        found = frame_contents(self.report.solution, self.plane)
        names = self.report.solution.equations.unknowns["frame"].names
        standing = [names[f] for f in found.frames.instruments.tolist()]
        x, y, _ = self.plane.names
        return {
            "axes": ["", "Z"] if self.schematic else [self.words(x), self.words(y)],
            "schematic": self.schematic,
            "limits": [low.tolist(), high.tolist()],
            "factor": self.factor,
            "multiple": factor_text(self.factor),
            "doubtful": bool(self.report.doubts),
            "level": percent(self.confidence),
            "test": test_symbol(self.report),
            "points": self._points(),
            "states": [self.t(f"state_{key}") for key in POINT_STATES],
            "lines": self._lines(found.frames.instruments),
            "photos": self._photos(),
            "shapes": [
                {"name": self.t.kind(s.name), "lines": [rounded_xy(line) for line in s.lines]}
                for s in ([] if self.schematic else found.shapes)
            ],
            "instruments": {"names": standing, "xy": rounded_xy(found.instruments)},
            "relative": self._relative(),
            "doubts": self._doubts(found.frames.instruments, found.instruments),
            "aside": self._aside(found.frames.instruments, found.instruments),
        }

    def _points(self) -> dict[str, Any]:
        report, n = self.report, len(self.points)
        out: dict[str, Any] = {
            "names": list(report.network.points),
            "xy": rounded_xy(self.points),
            "state": [POINT_STATES.index(s) for s in point_states(report)],
            "test": rounded_or_none(largest_tests(report)),
            "ellipses": self._ellipses(),
            "height": [0.0] * n
            if self.precision is None
            else rounded_or_none(self.precision.height),
        }
        if report.reliability is not None:
            out["r"] = rounded_or_none(point_redundancy(report.reliability).mean)
        return out

    def _ellipses(self) -> list[list[float | None]]:
        """Return semi-axes and direction, (3, n); zero for one too large to be drawn."""
        p = self.precision
        if p is None or self.without_plan:
            return [[0.0] * len(self.points)] * 3
        extent = float(np.max(self.limits[1] - self.limits[0]))
        fits = p.semi[:, 0] * self.factor <= MAX_ELLIPSE_SIZE * extent
        flat = p.semi[:, 1] ** 2 <= FIXED_AXIS_VARIANCE_RATIO * p.semi[:, 0] ** 2
        b = np.where(flat, 0.0, p.semi[:, 1])
        return [rounded_or_none(np.where(fits, v, 0.0)) for v in (p.semi[:, 0], b, p.direction)]

    def too_large(self) -> list[str]:
        """Return points whose ellipses are too large to be drawn, with their sizes."""
        p = self.precision
        if p is None or self.without_plan:
            return []
        extent = float(np.max(self.limits[1] - self.limits[0]))
        lost = np.flatnonzero(p.semi[:, 0] * self.factor > MAX_ELLIPSE_SIZE * extent)
        lost = lost[np.argsort(-p.semi[lost, 0], kind="stable")]
        names = list(self.report.network.points)
        return [f"{names[i]} ({length_text(float(p.semi[i, 0]))})" for i in lost.tolist()]

    def _lines(self, instruments: Index) -> list[dict[str, Any]]:
        return [
            {
                "kinds": ", ".join(self.t.kind(k.replace("_", " ")) for k in kinds),
                "ends": ends.T.tolist(),
            }
            for kinds, ends in lines_by_kinds(self.report.solution, instruments)
        ]

    def _photos(self) -> dict[str, Any]:
        solution, n = self.report.solution, len(self.centres)
        if self.schematic or not n:
            return {"names": [], "xy": [[], []], "shapes": []}
        extent = float(np.max(self.limits[1] - self.limits[0]))
        size = 0.07 * extent / max(1.0, np.sqrt(n / 30))
        shapes = photo_outlines(solution, image_rows(solution), size)
        outlines = self.plane.coordinates(shapes.reshape(-1, 3))[:, :2].reshape(n, -1, 2)
        return {
            "names": list(self.report.network.photos),
            "xy": rounded_xy(self.centres),
            "shapes": [rounded_xy(one) for one in outlines],
        }

    def _relative(self) -> dict[str, Any]:
        """Return relative ellipses at the middle of their lines."""
        found = [] if self.schematic else list(self.report.lines)
        centres = np.array([x.ellipse.centre for x in found]).reshape(-1, 3)
        at = self.plane.coordinates(centres)[:, :2]
        a, b, turned = (
            np.array([[*x.ellipse.semi_axes, pi / 2 - x.ellipse.azimuth] for x in found])
            .reshape(-1, 3)
            .T
        )
        extent = float(np.max(self.limits[1] - self.limits[0]))
        a = np.where(a * self.factor <= MAX_ELLIPSE_SIZE * extent, a, 0.0)
        names = [f"{place_name(x.a)} – {place_name(x.b)}" for x in found]
        return {
            "names": names,
            "xy": rounded_xy(at),
            "ellipses": [rounded_or_none(v) for v in (a, b, turned)],
        }

    def _drawn(self, instruments: Index, at: Array) -> dict[Any, Array]:
        standing = np.full((len(self.report.solution.state["frame"]), 2), np.nan)
        standing[instruments] = at
        return {"point": self.points, "pose": self.centres, "frame": standing}

    def _doubts(self, instruments: Index, at: Array) -> list[dict[str, Any]]:
        """Return the observations above the critical value, each with its place and its row."""
        values, critical = self.report.tests
        size = np.where(np.isfinite(values), np.abs(values), 0.0)
        rows = np.flatnonzero(size > critical)
        rows = rows[np.argsort(-size[rows], kind="stable")][:MAX_DOUBTS_MARKED]
        equations, drawn = self.report.solution.equations, self._drawn(instruments, at)
        out = []
        for row in self.report.rows.at(rows.tolist()):
            one = observation_places(equations, np.array([row.number]), self.report.solution, drawn)
            value = row.sign * float(values[row.number])
            text = (
                f"{self.t.kind(row.kind_name)} {row.what}: {test_symbol(self.report)} {value:.2f}"
            )
            lines, points = [rounded_xy(line) for line in one.lines], rounded_xy(one.points)
            out.append({"row": row.number, "text": text, "lines": lines, "points": points})
        return out

    def _aside(self, instruments: Index, at: Array) -> list[dict[str, Any]]:
        """Return the observations that were rejected, each with its place."""
        aside = self.report.set_aside
        if aside is None:
            return []
        out: list[dict[str, Any]] = []
        drawn = self._drawn(instruments, at)
        seen: set[str] = set()
        for row in aside.rows.at(aside.numbers.tolist()):
            if row.id in seen or len(out) == MAX_DOUBTS_MARKED:
                continue
            seen.add(row.id)
            numbers = np.array([row.number])
            one = observation_places(aside.rows.equations, numbers, self.report.solution, drawn)
            text = f"{self.t.kind(row.kind_name)} {row.what}"
            lines, points = [rounded_xy(line) for line in one.lines], rounded_xy(one.points)
            out.append({"id": row.id, "text": text, "lines": lines, "points": points})
        return out


def axis_words(text: str, t: Texts) -> str:
    """Return the name of an axis, or the note of a drawing plane, in a language."""
    for word in AXIS_WORDS:
        if word in text:
            return text.replace(word, t.kind(word))
    return text


def rounded_xy(places: Array) -> list[list[float]]:
    """Return places (k, 2) as the lists of x and y, to a tenth of a millimetre."""
    x, y = np.round(np.asarray(places, dtype=float).reshape(-1, 2), 4).T.tolist()
    return [x, y]


def rounded_or_none(values: Array) -> list[float | None]:
    """Return numbers with four significant digits; None for one that is not finite."""
    return [float(f"{v:.4g}") if np.isfinite(v) else None for v in values.tolist()]


def scene_data(plan: PlanDrawing) -> dict[str, Any] | None:
    """Return points, photos and sights in three dimensions; None where there is only one."""
    if plan.schematic or len(plan.points) + len(plan.centres) < 2:
        return None
    solution = plan.report.solution
    points = plan.plane.coordinates(plan.xyz)
    centres = plan.plane.coordinates(solution.state["pose"][:, 9:])
    extent = np.ptp(np.concatenate([points, centres]), axis=0)
    if not extent[2] > 1e-9 * max(float(extent.max()), 1e-9):
        return None
    found = frame_contents(solution, plan.plane)
    standing = np.zeros((1, 3))
    instruments = [found.frames.places(f, standing)[0] for f in found.frames.instruments.tolist()]
    at = np.concatenate([points, plan.plane.coordinates(np.array(instruments).reshape(-1, 3))])
    return {
        "names": list(plan.report.network.points),
        "axes": [plan.words(a) for a in plan.plane.names],
        "flat": bool(extent[2] < MIN_HEIGHT_SHARE * float(extent[:2].max())),
        "points": _lists(points),
        "lines": _sights(plan, at, found.frames.instruments),
        "rays": _rays(plan, points, centres),
        "photos": _photos(plan, extent),
    }


def _sights(plan: PlanDrawing, at: Array, instruments: Index) -> list[dict[str, Any]]:
    groups = lines_by_kinds(plan.report.solution, instruments)
    stride = _stride(sum(len(ends) for _, ends in groups), MAX_SIGHTS_DRAWN)
    out = []
    for kinds, ends in groups:
        out.append({"kinds": plan.t.kinds(kinds), "xyz": _segments(at[ends[::stride]])})
    return out


def _rays(plan: PlanDrawing, points: Array, centres: Array) -> dict[str, Any]:
    rows = image_rows(plan.report.solution)
    stride = _stride(len(rows.row), MAX_RAYS_DRAWN)
    ends = np.stack([centres[rows.photo[::stride]], points[rows.point[::stride]]], axis=1)
    return {"all": len(rows.row), "shown": len(ends), "xyz": _segments(ends)}


def _photos(plan: PlanDrawing, extent: Array) -> dict[str, Any]:
    solution, n = plan.report.solution, len(plan.centres)
    if not n:
        return {"names": [], "xyz": [[], [], []], "shapes": [[], [], []]}
    size = 0.07 * float(extent.max()) / max(1.0, np.sqrt(n / 30))
    shapes = photo_outlines(solution, image_rows(solution), size)
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
