"""Reference system (EPSG, WKT, PROJ; geoid) of a network: grid coordinates to frames and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np

from ..ellipsoid import ELLIPSOIDS, Ellipsoid
from ..errors import InputError, Problem, known
from ..frames import Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from ..types import Array
from . import proj
from .geoid import Geoid, GeoidValues, geoid
from .transformation_chain import SevenParameters, TransformationChain

Heights = Literal["ellipsoidal"]
"""What heights are, where neither the system nor a geoid determines it."""
MAX_AXIS_DIFFERENCE_M, MAX_FLATTENING_DIFFERENCE = 1e-4, 1e-8
"""Largest differences of the semi-major axis (m) and of 1/f of ellipsoids that are the same."""


@dataclass(frozen=True)
class ReferenceSystem:
    """A reference system, such as UTM with heights above a geoid.

    Coordinates of a network are adjusted in a geocentric or topocentric frame, where neither the
    scale of a projection nor the curvature of the Earth is neglected; the reference system leads
    from grid coordinates (easting E, northing N, height H, metres) into such a frame and back:

        E, N → φ, λ (projection),  h = H + N_geoid(φ, λ),  (φ, λ, h) → X

    Example:
        >>> ReferenceSystem("EPSG:25832", heights="ellipsoidal").name
        'ETRS89 / UTM zone 32N'
    """

    definition: str
    """EPSG code such as ``EPSG:25832+7837`` (plan + heights), PROJ string, or WKT."""
    geoid: str | float | None = None
    """Path of a geoid (see `factorgraph_adj.crs.geoid`), or a constant undulation, metres; None:
    PROJ's own geoid of the vertical system. It belongs to the ellipsoid of ``datum``."""
    heights: Heights | None = None
    """``ellipsoidal``: heights are above the ellipsoid of the system."""
    datum: str | None = None
    """Geodetic system of the frame, such as ``EPSG:4258`` (ETRS89), where it is not that of the
    grid; None: that of the grid."""
    parameters: SevenParameters | None = None
    """Similarity from the geodetic system of the grid to ``datum``; None: PROJ's best operation,
    or the ``+towgs84`` of a PROJ string."""

    def __post_init__(self) -> None:
        """Check the options; the names of systems are checked where they are used first."""
        if not isinstance(self.definition, str) or not self.definition.strip():
            raise InputError(f"a reference system is a text, not {self.definition!r}")
        if self.heights not in (None, *get_args(Heights)):
            valid = known(get_args(Heights), meant=str(self.heights))
            raise InputError(f"unknown heights {self.heights!r}; valid: {valid}")
        if self.heights == "ellipsoidal" and self.geoid is not None:
            raise InputError("heights are either ellipsoidal or above a geoid: give one of both")
        if isinstance(self.geoid, bool) or not isinstance(self.geoid, str | float | int | None):
            raise InputError(f"geoid must be a path or a number of metres, not {self.geoid!r}")
        if isinstance(self.geoid, float | int) and not math.isfinite(self.geoid):
            raise InputError(f"a constant geoid must be finite, not {self.geoid!r}")
        if self.parameters is not None and self.datum is None:
            raise InputError("parameters lead to a datum: state it, such as datum = 'EPSG:4258'")

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields for copies and pickles, without what PROJ made of them."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    # -- what it is ---------------------------------------------------------------------------

    @property
    def crs(self) -> Any:
        """The system as an object of pyproj."""
        return proj.crs(self.definition)

    @property
    def name(self) -> str:
        """Name of the system."""
        return str(self.crs.name)

    @cached_property
    def plan(self) -> Any:
        """The system of the plan coordinates alone, an object of pyproj."""
        return self.crs.sub_crs_list[0] if self.crs.is_compound else self.crs

    @property
    def projected(self) -> bool:
        """Whether it has grid coordinates; otherwise it is geographic or geocentric."""
        plan = self.plan.source_crs if self.plan.is_bound else self.plan
        return bool(plan.is_projected)

    @property
    def epsg(self) -> int | None:
        """EPSG code of the plan system; None if it has none."""
        found = self.plan.to_epsg()
        return None if found is None else int(found)

    @property
    def wkt(self) -> str:
        """Definition of the plan system as WKT 2."""
        return str(self.plan.to_wkt())

    @property
    def wkt1(self) -> str:
        """Definition of the plan system as WKT 1 of GDAL, or as WKT 2 if it has no WKT 1."""
        from pyproj.exceptions import CRSError

        try:
            return str(self.plan.to_wkt("WKT1_GDAL"))
        except CRSError:
            return self.wkt

    @property
    def vertical(self) -> str:
        """What the heights are above, in words."""
        if self.crs.is_compound:
            return str(self.crs.sub_crs_list[1].name)
        if self.geoid is not None:
            return f"geoid {self.geoid}" if isinstance(self.geoid, str) else "geoid (constant)"
        return f"ellipsoid {self.ellipsoid.name}"

    @cached_property
    def ellipsoid(self) -> Ellipsoid:
        """Ellipsoid of the frame.

        Raises:
            InputError: it has no name here, see `factorgraph_adj.ellipsoid.ELLIPSOIDS`.
        """
        found = self.chain.datum.ellipsoid
        a, inverse = found.semi_major_metre, found.inverse_flattening
        for e in ELLIPSOIDS.values():
            if (
                abs(e.a - a) < MAX_AXIS_DIFFERENCE_M
                and abs(e.inverse_flattening - inverse) < MAX_FLATTENING_DIFFERENCE
            ):
                return e
        raise InputError(
            f"reference system {self.name}: its ellipsoid {found.name} (a = {a}, 1/f = {inverse}) "
            f"is none of {known(ELLIPSOIDS, most=40)}; give a datum with one of them"
        )

    @cached_property
    def chain(self) -> TransformationChain:
        """The steps from grid coordinates to geodetic ones.

        Raises:
            InputError: pyproj is missing, PROJ does not know the system, heights are not stated, or
                a grid is missing.
        """
        return TransformationChain.of(
            self.crs,
            geoid=self._geoid,
            ellipsoidal=self.heights == "ellipsoidal",
            datum=None if self.datum is None else proj.crs(self.datum),
            parameters=self.parameters,
        )

    @cached_property
    def _geoid(self) -> Geoid | None:
        return None if self.geoid is None else geoid(self.geoid)

    def checked(self) -> ReferenceSystem:
        """Return the system after everything about it is found: names, grids, the ellipsoid.

        Raises:
            InputError: as `chain` and `ellipsoid`.
        """
        _ = self.chain, self.ellipsoid
        return self

    # -- conversions --------------------------------------------------------------------------

    def to_geodetic(
        self, grid: Array, names: Sequence[str] | None = None
    ) -> tuple[Array, Array, Array]:
        """Return φ, λ (n,) radians and ellipsoidal height (n,) metres in the datum of the frame.

        Args:
            grid: E, N, H, (n, 3) metres; a row with NaN gives NaN.
            names: names of the points, for messages.

        Raises:
            InputError: the system has no grid, or a point is outside of it or of the geoid.
        """
        return self._projecting.to_geodetic(np.asarray(grid, dtype=float), names)

    def from_geodetic(
        self,
        latitude: Array,
        longitude: Array,
        height: Array,
        names: Sequence[str] | None = None,
    ) -> Array:
        """Return E, N, H, (n, 3) metres, of φ, λ (rad) and ellipsoidal heights (m)."""
        return self._projecting.from_geodetic(latitude, longitude, height, names)

    def to_frame(self, frame: Frame, grid: Array, names: Sequence[str] | None = None) -> Array:
        """Return coordinates (n, 3) in a frame of grid coordinates (n, 3), metres.

        A local frame has grid coordinates itself.
        """
        if isinstance(frame, LocalFrame):
            return np.array(grid, dtype=float) @ _local_axes(frame)
        self.refuse_other(frame)
        xyz = self.ellipsoid.to_cartesian(*self.to_geodetic(grid, names))
        return frame.from_geocentric(xyz) if isinstance(frame, TopocentricFrame) else xyz

    def from_frame(self, frame: Frame, xyz: Array, names: Sequence[str] | None = None) -> Array:
        """Return grid coordinates (n, 3) of coordinates (n, 3) in a frame, metres."""
        if isinstance(frame, LocalFrame):
            return np.array(xyz, dtype=float) @ _local_axes(frame).T
        return self.from_geodetic(*self.geodetic(frame, xyz), names)

    def geodetic(self, frame: Frame, xyz: Array) -> tuple[Array, Array, Array]:
        """Return φ, λ (rad) and ellipsoidal height (m), in the datum, of places in a frame."""
        if isinstance(frame, LocalFrame):
            return self.to_geodetic(np.asarray(xyz, dtype=float) @ _local_axes(frame).T)
        self.refuse_other(frame)
        found = frame.geodetic(np.asarray(xyz, dtype=float))
        assert found is not None
        return found

    def refuse_outside(self, grid: Array, names: Sequence[str]) -> None:
        """Refuse places that are outside of the system, all of them by name.

        Args:
            grid: E, N, H, (n, 3) metres; rows without E and N take no part.
            names: names of the places.
        """
        at = np.asarray(grid, dtype=float).reshape(-1, 3)
        rows = np.flatnonzero(np.isfinite(at[:, :2]).all(axis=1)).tolist()
        if rows:
            self._projecting.plan_geodetic(np.nan_to_num(at[rows]), [names[i] for i in rows])

    def frame_at(self, grid: Array) -> TopocentricFrame:
        """Return the topocentric frame in the middle of grid coordinates (n, 3), metres.

        Rows with NaN take no part. Its origin is rounded to 1e-6 degrees, and is on the ellipsoid
        at the mean height, rounded to a metre.
        """
        at = np.asarray(grid, dtype=float).reshape(-1, 3)
        at = at[np.isfinite(at).all(axis=1)]
        if not len(at):
            raise InputError(
                "no point has easting, northing and height: the origin of a topocentric frame "
                "cannot be found; state a frame"
            )
        middle = (at.min(axis=0) + at.max(axis=0))[None] / 2.0
        latitude, longitude, height = (float(v[0]) for v in self._projecting.plan_geodetic(middle))
        phi, lam = (math.radians(round(math.degrees(v), 6)) for v in (latitude, longitude))
        return TopocentricFrame(phi, lam, float(round(height)), self.ellipsoid.name)

    def geocentric_frame(self) -> GeocentricFrame:
        """Return the geocentric frame of its datum."""
        return GeocentricFrame(self.ellipsoid.name)

    def geoid_at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None = None
    ) -> GeoidValues:
        """Return undulation and deflections at places (rad); 0 where heights are ellipsoidal."""
        return self._projecting.geoid_at(latitude, longitude, names)

    def refuse_other(self, frame: GeocentricFrame | TopocentricFrame) -> None:
        """Refuse a frame on another ellipsoid than that of the system."""
        if frame.ellipsoid_name != self.ellipsoid.name:
            raise InputError(
                Problem(
                    f"has the ellipsoid {frame.ellipsoid_name}, and the reference system "
                    f"{self.name} has {self.ellipsoid.name}",
                    "frame",
                )
            )

    @property
    def _projecting(self) -> TransformationChain:
        """The chain of a system with grid coordinates."""
        if not self.projected:
            raise InputError(
                f"reference system {self.name} has no grid coordinates (easting, northing); valid: "
                "a projected one, such as EPSG:25832+7837"
            )
        return self.chain


def _local_axes(frame: LocalFrame) -> Array:
    """Return the rows east, north, up of a local frame, (3, 3): E, N, H @ rows = x, y, z."""
    return np.vstack([frame.east_north, [0.0, 0.0, 1.0]])


def reference_system(stated: ReferenceSystem | str) -> ReferenceSystem:
    """Return a reference system: itself, or that of a definition."""
    return stated if isinstance(stated, ReferenceSystem) else ReferenceSystem(stated)


def ellipsoidal(system: ReferenceSystem) -> ReferenceSystem:
    """Return the system of the same plan coordinates with ellipsoidal heights."""
    return replace(system, definition=system.plan.to_wkt(), geoid=None, heights="ellipsoidal")
