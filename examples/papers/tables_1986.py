"""Tables 1 to 5 of El-Hakim (1986): redundancy numbers, and the effect of an image error.

The blocks are those of `examples.published_blocks.el_hakim_1986`. The paper does not identify its
points A to H. The points here have the same properties: number of rays, r without distances, number
of distances, and position on the edge of the block.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Literal, NamedTuple

import numpy as np

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.observations import ControlPoint
from factorgraph_adj.quality.reliability import Reliability, reliability
from factorgraph_adj.simulation.measurement import Seed
from factorgraph_adj.types import Array

from ..published_blocks.el_hakim_1986 import (
    Line,
    edge_lines,
    simulate_aerial_1986,
    simulate_close_range_1986,
)

SEED: Seed = 1
"""Seed of the measuring errors; it has little effect on redundancy numbers."""
ERROR = 0.1
"""Error of an image coordinate in tables 3 and 5, mm."""

Block = Literal["aerial", "close range"]


class Averages(NamedTuple):
    """Averages over the image coordinates of all points with the same number of rays."""

    r_x: float
    r_y: float
    e2_x: float
    e2_y: float


TABLE_1: Mapping[Block, Mapping[int, Averages]] = {
    "aerial": {
        2: Averages(0.00, 0.40, 0.97, 0.53),
        3: Averages(0.33, 0.43, 0.67, 0.33),
        4: Averages(0.48, 0.55, 0.36, 0.39),
        5: Averages(0.54, 0.56, 0.28, 0.32),
        6: Averages(0.55, 0.57, 0.23, 0.27),
    },
    "close range": {
        2: Averages(0.00, 0.41, 0.95, 0.55),
        3: Averages(0.44, 0.37, 0.43, 0.57),
        4: Averages(0.52, 0.44, 0.31, 0.44),
    },
}
"""Published averages by number of rays, without the city block, which is a real one."""


class Case(NamedTuple):
    """An image coordinate with an error, and the distances measured to its point."""

    photo: str
    point: str
    component: str
    ends: tuple[str, ...]
    """Points at the other ends of the distances."""
    rays: int
    before: float
    """Published r without distances."""
    after: float
    """Published r with distances."""
    effect_before: tuple[float, float, float]
    """Published effect of 100 µm on X, Y, Z without distances, mm (table 3)."""
    effect_after: tuple[float, float, float]
    """Published effect with distances, mm."""

    @property
    def image(self) -> str:
        """Id of the image point."""
        return f"{self.photo}/{self.point}"

    @property
    def lines(self) -> tuple[Line, ...]:
        """The distances."""
        return tuple((self.point, end) for end in self.ends)

    def r(self, rel: Reliability) -> float:
        """Return the redundancy number."""
        return float(rel.redundancy_numbers[rel.row(self.image, self.component)])

    def r_of_every_ray(self, rel: Reliability) -> Array:
        """Return the redundancy numbers of the coordinate in all photos of the point."""
        photos = [i.photo for i in rel.solution.network.image_points() if i.point == self.point]
        return np.array([self._replace(photo=photo).r(rel) for photo in photos])

    def effect(self, rel: Reliability) -> Array:
        """Return the effect of 100 µm on X, Y, Z, mm."""
        moved = rel.effect_on(self.image, self.point, component=self.component, error=ERROR)
        return 1000 * np.asarray(moved)


# Distances: D along the edge; E to the two other sides of the floor; F to the next point of the
# edge, a corner and the adjacent side; G along the edge in both directions and to both other sides.
CLOSE_RANGE: Mapping[str, Case] = {
    "D": Case("1", "36", "x", ("26",), 2, 0.00, 0.13, (-9, -67, 31), (-4, -65, 32)),
    "E": Case("1", "46", "x", ("15", "75"), 2, 0.00, 0.71, (16, -33, -16), (2, -2, 3)),
    "F": Case("1", "56", "x", ("46", "75", "76"), 2, 0.00, 0.90, (-4, -56, 29), (0, 0, -2)),
    "G": Case("3", "41", "x", ("31", "51", "12", "72"), 2, 0.0, 0.77, (-22, -50, 25), (-2, 2, -1)),
    "H": Case("3", "14", "x", ("15", "71"), 4, 0.67, 0.90, (2, -3, 2), (0, 0, 0)),
}
"""Points of the close-range block; each gets its own distances."""
# A and B are on the long side; C is at the end of a strip on the short side.
AERIAL: Mapping[str, Case] = {
    "A": Case("1/5", "1501", "x", ("1301", "1701"), 3, 0.18, 0.53, (162, 170, 296), (14, 111, 257)),
    "B": Case("1/7", "1501", "y", ("1301", "1701"), 3, 0.43, 0.50, (92, 134, 41), (-12, 116, 49)),
    "C": Case("1/13", "3306", "x", ("3101", "3506"), 4, 0.56, 0.69, (127, 22, -55), (18, 3, -16)),
}
"""Points of the aerial block, which has distances along its whole edge."""
WITH_HEIGHTS = {"A": 0.66, "B": 0.50}
"""Published r with distances and two height differences (table 4)."""
EFFECT_WITH_HEIGHTS = {"A": (1.0, 1.0, 2.0), "B": (-10.0, 95.0, 2.0)}
"""Published effect of 100 µm with distances and height differences, mm (table 5)."""


@cache
def aerial(distances: bool = False, heights: bool = False) -> Reliability:
    """Return the reliability of the 52 photos, with terrestrial observations along the edge."""
    lines = edge_lines(simulate_aerial_1986(SEED).network)
    simulated = simulate_aerial_1986(
        SEED, distances=lines * distances, height_differences=lines * heights
    )
    return reliability(adjust(simulated.network))


@cache
def close_range(lines: tuple[Line, ...] = ()) -> Reliability:
    """Return the reliability of the 4 photos with distances."""
    return reliability(adjust(simulate_close_range_1986(SEED, distances=lines).network))


class ImageFigures(NamedTuple):
    """Figures of image points, one row for each image point of a point without control."""

    rays: Array
    point: Array
    r: Array
    e2: Array


@cache
def image_figures(block: Block) -> ImageFigures:
    """Return r and e2 in x and y, (n, 2), and number and rays of the point."""
    rel = aerial() if block == "aerial" else close_range()
    network, equations = rel.solution.network, rel.solution.equations
    images = next(b for b in equations.blocks if b.kind == "image")
    (point,) = (index for kind, index in images.variables if kind == "point")
    control = {o.point for o in network.observations.values() if isinstance(o, ControlPoint)}
    control |= {name for name, p in network.points.items() if any(p.fixed)}
    other = np.array([name not in control for name in network.points])[point]
    rays = np.bincount(point)[point]
    r, e2 = (a[images.rows].reshape(-1, 2) for a in (rel.redundancy_numbers, rel.e2))
    return ImageFigures(rays[other], point[other], r[other], e2[other])


def averages(block: Block, rays: int) -> Averages:
    """Return a row of table 1."""
    figures = image_figures(block)
    chosen = figures.rays == rays
    return Averages(*figures.r[chosen].mean(axis=0), *figures.e2[chosen].mean(axis=0))
