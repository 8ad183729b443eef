"""Coordinates, orientations and poses found so far in the search for approximate values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..types import Array, Index, Mask
from .horizon import Horizon
from .survey import Survey


@dataclass
class Progress:
    """Coordinates, orientations and poses, NaN until found; the steps of the search fill them."""

    survey: Survey
    """Terrestrial observations."""
    horizon: Horizon
    """Transformation between the frame and plan and height."""
    plan: Array
    """East, north, height, metres, (n, 3)."""
    orientation: Array
    """Orientation unknowns, and behind them the constants of gyrotheodolites at each of their
    stations, radians, (m,)."""
    pose: Array
    """Poses of photos, (f, 12)."""
    frame: Array
    """Frames, (k, 17)."""
    mount: Array
    """Mounts, (m, 12)."""
    surface: Array
    """Heights of level surfaces and surfaces of pressure, metres, (l,)."""

    def copy(self) -> Progress:
        """Return an independent copy, for a trial."""
        return replace(
            self,
            plan=self.plan.copy(),
            orientation=self.orientation.copy(),
            pose=self.pose.copy(),
            frame=self.frame.copy(),
            mount=self.mount.copy(),
            surface=self.surface.copy(),
        )

    @property
    def placed(self) -> Mask:
        """Points known in plan, (n,)."""
        return np.asarray(np.isfinite(self.plan[:, 0]) & np.isfinite(self.plan[:, 1]))

    @property
    def complete(self) -> Mask:
        """Points known in plan and height, (n,)."""
        return np.asarray(np.isfinite(self.plan).all(axis=1))

    def set_plan(self, point: Index, plan: Array) -> bool:
        """Fill unknown east and north (n, 2) of points; return whether any was filled."""
        new = np.isnan(self.plan[point, :2]) & np.isfinite(plan)
        values = self.plan[point, :2]
        values[new] = plan[new]
        self.plan[point, :2] = values
        return bool(new.any())

    def set_height(self, point: Index, height: Array) -> bool:
        """Fill unknown heights (n,) of points; return whether any was filled."""
        new = np.isnan(self.plan[point, 2]) & np.isfinite(height)
        self.plan[point[new], 2] = height[new]
        return bool(new.any())

    def lengths(self) -> Array:
        """Return the horizontal length of every edge, metres; NaN where it is unknown.

        A slope distance without zenith angle is reduced by the height difference, from known
        heights or levelling.
        """
        e = self.survey.edges
        rise = self.plan[e.b, 2] - self.plan[e.a, 2]
        rise = np.where(np.isfinite(rise), rise, e.rise) + e.slope_rise
        rise = np.abs(rise)  # the difference of squares as factors, as squares may overflow
        reduced = np.sqrt(np.maximum(e.slope - rise, 0.0)) * np.sqrt(e.slope + rise)
        return np.where(np.isfinite(e.level), e.level, reduced)
