"""Tables 6 to 8 of El-Hakim (1986): systematic errors of images left in the 52-photo block.

The paper states a radial distortion of up to 9 µm (a curve of the Wild Aviogon), or an affine film
deformation of up to 15 µm at the edges of the photo; 20 or 8 horizontal and 34 or 14 vertical
control points; 24 to 60 distances and 32 height differences on the edge. Its residuals below 1 µm
with the affine deformation show that the images had no other error. Its figures of the curve and
the layout are not legible. The following values are assumptions:

- The observations have no noise.
- The distortion is outwards up to 9 µm at 90 mm, zero near 125 mm and inwards up to 8 µm at 150 mm.
- The affine deformation is a shrinkage of 11 µm at 115 mm, which the flying height absorbs, and
  further 4 µm in x. If all 15 µm were in one axis, the residuals would be 2 µm instead of 0.3 to
  1 µm, and the errors of points 50 to 80 mm instead of the printed 12 and 21 mm.
- The 8 of the 20 horizontal control points are those nearest to the corners and the middles of the
  sides. The 14 of the 34 vertical ones are these 8 and 6 more, far from them and from one another.
- 32 points of the edge, as evenly spread as possible, form a closed polygon. With 28 and 24
  distances the polygon has gaps of one line; 60 distances also join every second point. The height
  differences follow the polygon.
- All these observations have σ = 5 mm. With 0.5 mm, as in the real blocks of the paper, the figures
  in X and Y change by less than 0.5 mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.quality.point_precision import check_points
from factorgraph_adj.simulation.disturbances import Errors
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.scene import MICROMETRE, perimeter, round_lines, spread
from factorgraph_adj.simulation.generate.terrestrial_additions import (
    DistanceMeter,
    Distances,
    HeightDifferences,
    Level,
)
from factorgraph_adj.simulation.spec import Spec, simulate
from factorgraph_adj.simulation.systematic_errors import AffineFilm, InImages, LensDistortion
from factorgraph_adj.types import Array
from factorgraph_adj.units import MILLIMETRE

from ..published_blocks.el_hakim_1986 import SIGMA_AERIAL_TERRESTRIAL, Line, aerial_1986_plan
from ..published_blocks.spec_parts import Aerial1986

Kind = Literal["radial", "affine"]
AVIOGON = LensDistortion(
    radii_mm=(30.0, 60.0, 90.0, 115.0, 135.0, 150.0), distortion_um=(3.0, 8.5, 9.0, 4.0, -4.0, -8.0)
)
"""Radial distortion of the simulated images."""
SHRINKAGE = LensDistortion(coefficients_um=(11.0,), radius_mm=115.0)
AFFINE = AffineFilm(scale_um=4.0, edge_mm=115.0)
"""Affine part of the film deformation; the shrinkage is the other part."""
SYSTEMATIC: dict[Kind, tuple[InImages, ...]] = {
    "radial": (AVIOGON,),
    "affine": (SHRINKAGE, AFFINE),
}
POLYGON = 32
"""Number of points of the polygon on the edge."""
_EIGHT = ((-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0))
"""Positions of the 8 horizontal control points from the middle of the block, in half sides."""


@dataclass(frozen=True)
class SystematicTest:
    """A row of table 6."""

    number: int
    """Number of the test in the table."""
    error: Kind
    """Kind of the systematic error that is left in the images."""
    horizontal: Literal[20, 8]
    """Number of horizontal control points."""
    vertical: Literal[34, 14]
    """Number of vertical control points."""
    distances: int
    height_differences: int
    printed: tuple[float, float, float, float, float]
    """Published residuals in x and y, µm, and errors of object points in X, Y, Z, mm."""

    @property
    def label(self) -> str:
        """Short description of the test."""
        terrestrial = [f"{self.distances} distances"] * (self.distances > 0)
        terrestrial += [f"{self.height_differences} heights"] * (self.height_differences > 0)
        what = ", ".join([f"{self.horizontal}/{self.vertical}", *terrestrial])
        return f"{self.number} {self.error} {what}"


TABLE_6 = {
    t.number: t
    for t in (
        SystematicTest(1, "radial", 20, 34, 0, 0, (2.0, 2.8, 9, 9, 61)),
        SystematicTest(2, "radial", 8, 34, 0, 0, (2.0, 2.8, 24, 13, 64)),
        SystematicTest(3, "radial", 8, 34, 32, 0, (2.0, 2.8, 8, 9, 62)),
        SystematicTest(4, "radial", 20, 34, 32, 0, (2.0, 2.8, 6, 9, 61)),
        SystematicTest(5, "radial", 8, 34, 60, 0, (2.0, 2.8, 8, 8, 62)),
        SystematicTest(6, "radial", 8, 34, 28, 0, (2.0, 2.8, 8, 9, 63)),
        SystematicTest(7, "radial", 8, 34, 24, 0, (2.0, 2.8, 9, 13, 63)),
        SystematicTest(8, "radial", 8, 14, 32, 32, (2.1, 2.8, 7, 10, 41)),
        SystematicTest(9, "affine", 20, 34, 0, 0, (0.8, 0.8, 10, 20, 2)),
        SystematicTest(10, "affine", 8, 34, 0, 0, (0.3, 0.3, 12, 21, 2)),
        SystematicTest(11, "affine", 8, 34, 32, 0, (0.3, 0.4, 14, 19, 3)),
        SystematicTest(12, "affine", 20, 34, 32, 0, (1.0, 0.9, 4, 20, 2)),
        SystematicTest(13, "affine", 8, 34, 60, 0, (0.6, 0.6, 13, 19, 4)),
        SystematicTest(14, "affine", 8, 14, 32, 32, (0.4, 0.4, 14, 19, 3)),
    )
}
"""Tests of table 6 by number, with the published figures."""

# Points 68 and 82 are on a short side of the block, 138, 149 and 165 on a long one.
Errors3 = tuple[float, float, float]
TABLE_7: dict[int, Mapping[str, Errors3]] = {
    2: {
        "68": (31, 34, 0),
        "82": (48, 21, 0),
        "138": (16, 6, 73),
        "149": (16, 20, 112),
        "165": (13, 22, 116),
    },
    3: {
        "68": (10, 1, 0),
        "82": (18, 3, 0),
        "138": (1, -5, 64),
        "149": (1, 3, 98),
        "165": (0, 7, 104),
    },
    8: {
        "68": (7, 1, 4),
        "82": (13, 2, 5),
        "138": (3, -19, 3),
        "149": (4, -25, 2),
        "165": (4, -25, 2),
    },
}
"""Published errors of points in X, Y, Z, mm, by test, with radial distortion."""
TABLE_8: dict[int, Mapping[str, Errors3]] = {
    10: {
        "68": (30, 5, 0),
        "82": (39, -1, 0),
        "138": (-6, -17, 1),
        "149": (-9, -34, -1),
        "165": (-7, -44, -4),
    },
    11: {
        "68": (25, 4, 0),
        "82": (47, 7, 0),
        "138": (4, -20, -2),
        "149": (5, -34, -7),
        "165": (6, -38, -4),
    },
    14: {
        "68": (26, 4, 4),
        "82": (49, 7, 5),
        "138": (3, -20, 3),
        "149": (5, -31, 2),
        "165": (5, -36, 2),
    },
}
"""Published errors of points in X, Y, Z, mm, by test, with affine deformation."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Control points and polygon on the edge, from which the tests choose."""

    horizontal: dict[int, tuple[str, ...]]
    """Horizontal control points, by their number in the test."""
    vertical: dict[int, tuple[str, ...]]
    """Vertical control points, by their number in the test."""
    polygon: tuple[str, ...]
    """Points of the polygon, in order."""
    along_x: tuple[str, ...]
    """Polygon points without horizontal control whose neighbours are joined within 30° of X."""
    along_y: tuple[str, ...]
    """Polygon points without horizontal control whose neighbours are joined within 30° of Y, on the
    short sides."""

    def lines(self, count: int) -> tuple[Line, ...]:
        """Return ``count`` lines of the polygon."""
        ring = self.polygon
        return tuple((ring[a], ring[b]) for a, b in round_lines(len(ring), count))


@cache
def layout(eight: tuple[tuple[float, float], ...] = _EIGHT) -> Layout:
    """Return the layout of control points and polygon.

    Args:
        eight: positions of the 8 horizontal control points from the middle of the block, in half
            sides; the nearest of the 20 points are taken.
    """
    plan = aerial_1986_plan()
    names = list(plan.points)
    xy = np.array([p.coordinates[:2] for p in plan.points.values()])
    held = np.array([p.fixed for p in plan.points.values()])
    middle, half = (xy.max(axis=0) + xy.min(axis=0)) / 2, np.ptp(xy, axis=0) / 2
    scaled = (xy - middle) / half
    twenty, vertical = np.flatnonzero(held[:, 0]), np.flatnonzero(held[:, 2])
    off = np.linalg.norm(half * (scaled[twenty, None] - np.array(eight)), axis=2)
    few = list(dict.fromkeys(twenty[np.argmin(off, axis=0)].tolist()))
    first = [vertical.tolist().index(i) for i in few]
    fourteen = vertical[spread(xy[vertical], 14, first)]
    ring = _evenly(xy, perimeter(xy), POLYGON)
    sides: tuple[list[str], list[str]] = ([], [])
    turned = zip(ring[-1:] + ring[:-1], ring, ring[1:] + ring[:1], strict=True)
    for before, here, after in turned:
        if not held[here, 0]:
            d = np.abs(xy[after] - xy[before])
            axis = int(np.argmax(d))
            # The edge of the grid is jagged.
            if d[1 - axis] < np.tan(np.pi / 6) * d[axis]:
                sides[axis].append(names[here])

    def named(index: Iterable[int]) -> tuple[str, ...]:
        return tuple(names[i] for i in index)

    return Layout(
        {20: named(twenty.tolist()), 8: named(few)},
        {34: named(vertical.tolist()), 14: named(fourteen.tolist())},
        named(ring),
        tuple(sides[0]),
        tuple(sides[1]),
    )


def _evenly(xy: Array, ring: list[int], count: int) -> list[int]:
    """Return members of a ring of points, about evenly spread along it."""
    there = xy[ring]
    step = np.linalg.norm(np.roll(there, -1, axis=0) - there, axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)[:-1]])
    wanted = np.arange(count) * step.sum() / count
    nearest = np.argmin(np.abs(along[None, :] - wanted[:, None]), axis=1)
    return [ring[i] for i in sorted(set(nearest.tolist()))]


def spec_of(test: SystematicTest, *, where: Layout | None = None) -> Spec:
    """Return the spec of a test, with the default layout or ``where``."""
    there = where or layout()
    sigma = SIGMA_AERIAL_TERRESTRIAL / MILLIMETRE
    parts: list[Aerial1986 | Distances | HeightDifferences] = [Aerial1986(own_control=False)]
    if test.distances:
        meter = DistanceMeter(sigma_mm=sigma, ppm=0.0)
        lines = there.lines(test.distances)
        parts.append(Distances(between="given", lines=lines, distance_meter=meter))
    if test.height_differences:
        level = Level(sigma_mm=sigma, mm_per_sqrt_km=0.0)
        lines = there.lines(test.height_differences)
        parts.append(HeightDifferences(between="given", lines=lines, level=level))
    control = Control(
        horizontal="named",
        vertical="named",
        horizontal_points=there.horizontal[test.horizontal],
        vertical_points=there.vertical[test.vertical],
    )
    errors = Errors(noise=False, systematic=SYSTEMATIC[test.error])
    return Spec(name=f"test {test.label}", parts=tuple(parts), control=control, errors=errors)


@dataclass(frozen=True)
class Effect:
    """Effect of a systematic error."""

    residuals: Array
    """RMS of the residuals of image coordinates in x and y, µm, (2,)."""
    rms: Array
    """RMS of the errors of all free coordinates in X, Y, Z, mm, (3,)."""
    errors: dict[str, Array]
    """Errors in X, Y, Z of each point with a free coordinate, mm, (3,); zero for held ones."""

    def of(self, points: tuple[str, ...]) -> Array:
        """Return the RMS of the errors of the given points in X, Y, Z, mm, (3,)."""
        return np.asarray(np.sqrt(np.mean([self.errors[p] ** 2 for p in points], axis=0)))


@cache
def effect(number: int, *, where: Layout | None = None) -> Effect:
    """Simulate and adjust a test of table 6."""
    solution = adjust(simulate(spec_of(TABLE_6[number], where=where)).network)
    checked = check_points(solution)
    images = next(b for b in solution.equations.blocks if b.kind == "image")
    v = images.evaluate(solution.network.frame, solution.state, jacobians=False).residual
    errors = np.nan_to_num(checked.differences) / MILLIMETRE
    return Effect(
        np.sqrt(np.mean(v**2, axis=0)) / MICROMETRE,
        checked.rms / MILLIMETRE,
        dict(zip(checked.names, errors, strict=True)),
    )
