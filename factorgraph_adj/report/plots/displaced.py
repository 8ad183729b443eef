"""What moved, as it is drawn: displacements, ellipses and blocks in a plan, and one factor for all.

The plan is that of the network of the first epoch, see `factorgraph_adj.report.plots.plan`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from ...quality.ellipses import confidence_factor
from ...types import Array, Mask
from ..epochs.context import EpochsReport
from .marks import window
from .plan import DrawingPlane, plan_of
from .style import readable

TALLEST = 0.12
"""Size of a large displacement, or ellipse, in the larger side of the plan."""
LARGE = 0.9
"""Share of the displacements that are not larger than a large one."""
TOO_LARGE = 0.5
"""Size from which a displacement, or an ellipse, is not drawn, in the larger side of the plan."""


@dataclass(frozen=True, eq=False)
class EpochsDrawing:
    """Places, displacements and ellipses in the drawing plane of the first epoch."""

    report: EpochsReport
    """The comparison."""
    chosen: float | None = None
    """Factor of exaggeration; None: a round number that makes the displacements visible."""

    @cached_property
    def every(self) -> Array:
        """Coordinates of all points of the first network, (m, 3) metres."""
        return np.nan_to_num(self.report.found.solutions[0].state["point"])

    @cached_property
    def plane(self) -> DrawingPlane:
        """Drawing plane."""
        return plan_of(self.report.network.frame, self.every)

    @cached_property
    def others(self) -> Array:
        """Places of all points of the first network, (m, 2)."""
        return self.plane.coordinates(self.every)[:, :2]

    @cached_property
    def at(self) -> Array:
        """Places of the compared points, (n, 2)."""
        return self.plane.coordinates(self.report.places)[:, :2]

    @property
    def flat(self) -> bool:
        """Whether displacements are horizontal, or have a horizontal part."""
        return self.report.found.differences.axes != "z"

    @property
    def tall(self) -> bool:
        """Whether displacements have a vertical part."""
        return "z" in self.report.found.differences.axes

    @cached_property
    def schematic(self) -> bool:
        """Whether there is no plan: heights alone, of points without plan coordinates."""
        return not self.flat and not np.ptp(self.at, axis=0).any()

    @cached_property
    def vectors(self) -> Array:
        """Displacements in the drawing, (n, 2) metres; heights alone point up and down."""
        local = self.report.vectors @ self.plane.axes.T
        if self.flat:
            return np.asarray(local[:, :2])
        return np.column_stack([np.zeros(len(local)), local[:, 2]])

    @cached_property
    def rises(self) -> Array:
        """Vertical displacements, (n,) metres."""
        return np.asarray((self.report.vectors @ self.plane.axes.T)[:, 2])

    @cached_property
    def intervals(self) -> Array:
        """Half intervals of vertical displacements, (n,) metres."""
        found = self.report.found
        freedom = None if np.isinf(found.scale.freedom) else int(found.scale.freedom)
        k = confidence_factor(1, self.report.confidence, redundancy=freedom)
        every = np.array([x.covariance for x in found.displacements.values()]).reshape(-1, 3, 3)
        up = self.plane.axes[2]
        return np.asarray(k * np.sqrt(np.maximum(np.einsum("i,nij,j->n", up, every, up), 0.0)))

    @cached_property
    def ellipses(self) -> Array:
        """Semi-axes, and direction of the first one from right to up, (n, 3).

        Heights alone have an interval, which is upright.
        """
        if not self.flat:
            upright = np.full(len(self.at), pi / 2)
            return np.column_stack([self.intervals, np.zeros(len(self.at)), upright])
        every = [(*e.semi_axes, pi / 2 - e.azimuth) for e in self.report.ellipses]
        return np.array(every).reshape(-1, 3)

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lower left and upper right corner of the plan."""
        low, high, _ = window(np.concatenate([self.at, self.others]))
        if float(np.max(high - low)) < 1e-6:
            return low - 1.0, high + 1.0
        return low, high

    @property
    def extent(self) -> float:
        """Larger side of the plan, metres."""
        low, high = self.limits
        return float(np.max(high - low))

    @cached_property
    def sizes(self) -> Array:
        """Larger one of displacement and semi-major axis of each point, (n,) metres."""
        return np.asarray(np.maximum(np.linalg.norm(self.vectors, axis=1), self.ellipses[:, 0]))

    @cached_property
    def factor(self) -> float:
        """Exaggeration of displacements and ellipses: one factor, so that they can be compared."""
        if self.chosen is not None:
            return self.chosen
        sizes = self.sizes[self.sizes > 0]
        if not len(sizes):
            return 1.0
        large = float(np.quantile(sizes, LARGE))
        return readable(TALLEST * self.extent / large)

    @cached_property
    def fits(self) -> Mask:
        """Which displacements are small enough to be drawn, (n,)."""
        return np.asarray(self.factor * self.sizes <= TOO_LARGE * self.extent)

    @cached_property
    def reach(self) -> tuple[Array, Array]:
        """Corners of the plan with all displacements and ellipses that are drawn."""
        low, high = self.limits
        ends = (self.at + self.factor * self.vectors)[self.fits]
        size = 1.1 * self.factor * self.ellipses[self.fits, :1]
        every = np.concatenate([[low, high], ends - size, ends + size])
        return every.min(axis=0), every.max(axis=0)

    @cached_property
    def outlines(self) -> list[tuple[Array, Array]]:
        """Each block as a closed line through its points, and how its motion moves this line.

        Two arrays (m, 2) for each block: places, and displacements in metres.
        """
        axes = ["xyz".index(a) for a in self.report.found.differences.axes]
        out = []
        for b in self.report.blocks:
            here = [self.report.names.index(n) for n in b.points]
            model = np.zeros((len(here), 3))
            model[:, axes] = self.report.vectors[np.ix_(here, axes)] - b.residuals
            moved = model @ self.plane.axes.T
            moved = moved[:, :2] if self.flat else np.column_stack([0.0 * moved[:, 2], moved[:, 2]])
            at = self.at[here]
            around = np.arctan2(*(at - at.mean(axis=0)).T[::-1])
            order = np.argsort(around, kind="stable")
            order = np.append(order, order[:1])
            out.append((at[order], moved[order]))
        return out
