"""Values found so far in the search, in plan and height, and the horizon to which they refer.

Approximate values are computed separately in plan (east, north) and height, because many
observations determine only one of them. In a local frame they are X, Y, Z in another order; in
geocentric and topocentric frames they are east and north in the horizon of one place, and the
ellipsoidal height. At a distance d from this place the plan has relative errors of about (d/R)²,
which an adjustment removes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..frames import AXES, Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from ..types import Array, Index, Mask
from .terrestrial_readings import Survey


class Horizon:
    """Transforms frame coordinates to east, north, height and back; components may be NaN."""

    def __init__(self, frame: Frame, place: Array) -> None:
        """Place the horizon.

        Args:
            frame: the frame of the network.
            place: a place in the middle of the network, (3,), metres; not used in a local frame.
        """
        self.frame = frame
        self.curvature = 1.0 / frame.radius
        """1/R, 1/metres, if heights follow the curved Earth, otherwise 0."""
        self._local: TopocentricFrame | None = None
        if isinstance(frame, LocalFrame):
            first, second = AXES[frame.axes[0]], AXES[frame.axes[1]]
            # Number of the axis that shows east and north, and its sign.
            self._east = (0, first[0]) if first[0] else (1, second[0])
            self._north = (0, first[1]) if first[1] else (1, second[1])
            if not frame.curvature:
                self.curvature = 0.0
        elif isinstance(frame, TopocentricFrame):
            self._local = frame
        else:
            at = frame.ellipsoid.to_geodetic(place[None])
            self._local = TopocentricFrame(
                float(at[0][0]), float(at[1][0]), 0.0, frame.ellipsoid_name, frame.radius
            )

    @property
    def by_component(self) -> bool:
        """Whether each frame coordinate is a coordinate of the plan or the height."""
        return not isinstance(self.frame, GeocentricFrame)

    def to_plan(self, xyz: Array) -> Array:
        """Return east, north, height (n, 3), metres, of frame coordinates (n, 3)."""
        if self._local is None:
            assert isinstance(self.frame, LocalFrame)
            (i, si), (j, sj) = self._east, self._north
            plan = np.stack([si * xyz[:, i], sj * xyz[:, j], xyz[:, 2]], 1)
            plan[:, 2] += self._drop(plan)
            return plan
        geocentric = self._geocentric(xyz)
        if isinstance(self.frame, TopocentricFrame):
            plan = xyz.copy()
        else:
            plan = self._local.from_geocentric(geocentric)
        plan[:, 2] = self._local.geocentric.ellipsoid.to_geodetic(geocentric)[2]
        return plan

    def from_plan(self, plan: Array) -> Array:
        """Return frame coordinates (n, 3), metres, of east, north, height (n, 3)."""
        if self._local is None:
            xyz = plan.copy()
            (i, si), (j, sj) = self._east, self._north
            xyz[:, i], xyz[:, j] = si * plan[:, 0], sj * plan[:, 1]
            xyz[:, 2] -= self._drop(plan)
            return xyz
        enu = plan.copy()
        enu[:, 2] -= (plan[:, 0] ** 2 + plan[:, 1] ** 2) * self.curvature / 2
        for _ in range(4):
            geocentric = self._local.to_geocentric(enu)
            height = self._local.geocentric.ellipsoid.to_geodetic(geocentric)[2]
            enu[:, 2] += plan[:, 2] - height
        geocentric = self._local.to_geocentric(enu)
        return enu if isinstance(self.frame, TopocentricFrame) else geocentric

    def _geocentric(self, xyz: Array) -> Array:
        if isinstance(self.frame, TopocentricFrame):
            return self.frame.to_geocentric(xyz)
        return xyz

    def _drop(self, plan: Array) -> Array:
        """Return the drop d²/2R of the level surface below the plane; 0 where plan is unknown."""
        if self.curvature == 0.0:
            return np.zeros(len(plan))
        assert isinstance(self.frame, LocalFrame)
        (i, si), (j, sj) = self._east, self._north
        origin = self.frame.origin
        e, n = plan[:, 0] - si * origin[i], plan[:, 1] - sj * origin[j]
        return np.asarray(np.nan_to_num((e * e + n * n) * self.curvature / 2))

    def convergence(self, plan: Array) -> Array:
        """Return γ (n,), radians: bearing in plan = azimuth at the station + γ."""
        if self._local is None and self.curvature == 0.0:
            return np.zeros(len(plan))
        xyz = self.from_plan(np.nan_to_num(plan))
        north = self.frame.basis(xyz, np.zeros((len(plan), 2))).enu[:, 1]
        if self._local is None:
            (i, si), (j, sj) = self._east, self._north
            return np.asarray(np.arctan2(si * north[:, i], sj * north[:, j]))
        if not isinstance(self.frame, TopocentricFrame):
            north = self._local.from_geocentric(
                self._local.to_geocentric(np.zeros_like(north)) + north
            )
        return np.asarray(np.arctan2(north[:, 0], north[:, 1]))


def horizon_place(frame: Frame, xyz: Array, latitude: float, longitude: float) -> Array:
    """Return a place (3,) for the horizon: the median of known points, otherwise Φ, Λ (rad)."""
    known = xyz[np.isfinite(xyz).all(axis=1)]
    if len(known) or isinstance(frame, LocalFrame):
        return np.asarray(np.median(known, axis=0)) if len(known) else np.zeros(3)
    if isinstance(frame, TopocentricFrame):
        return np.zeros(3)
    at = np.array([latitude]), np.array([longitude]), np.zeros(1)
    return np.asarray(frame.ellipsoid.to_cartesian(*at)[0])


@dataclass
class SearchState:
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

    def copy(self) -> SearchState:
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
