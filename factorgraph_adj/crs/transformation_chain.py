"""Chain of grid, geodetic and datum coordinates, and back: projection, seven parameters, geoid.

The datum is that of a frame. One of the steps may be a similarity of seven parameters between two
geocentric systems.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from ..constructors import ChecksArguments
from ..ellipsoid import Ellipsoid
from ..errors import InputError
from ..types import Array, Mask
from ..units import ARCSEC
from . import proj
from .geoid import Geoid, GeoidValues, deflections

HEIGHT_ITERATIONS = 5
"""Iterations of the ellipsoidal height in the system of the grid; each one gains 5 digits."""
MAX_ZONES = 60
"""Largest number of a zone with which an easting begins."""
AREA_MARGIN_DEG = 10.0
"""Degrees outside of its area of use where coordinates cannot belong to a system."""


@dataclass(frozen=True)
class SevenParameters(metaclass=ChecksArguments):
    """X' = t + (1 + m) R X, with small rotations of the position vector.

    R = [[1, −r_z, r_y], [r_z, 1, −r_x], [−r_y, r_x, 1]] (EPSG method 1033, as ``+towgs84`` of
    PROJ). Lists with the coordinate frame rotation (method 1032) have the opposite signs of
    rotations. R is used as it stands, and its inverse is the inverse of the matrix.
    """

    tx: float
    """Shift in X, metres."""
    ty: float
    """Shift in Y, metres."""
    tz: float
    """Shift in Z, metres."""
    rx_arcsec: float = 0.0
    """Rotation about X, seconds of arc."""
    ry_arcsec: float = 0.0
    """Rotation about Y, seconds of arc."""
    rz_arcsec: float = 0.0
    """Rotation about Z, seconds of arc."""
    scale_ppm: float = 0.0
    """m, parts per million."""

    def __post_init__(self) -> None:
        """Check that all are numbers."""
        if not np.isfinite(np.array(astuple(self), dtype=float)).all():
            raise InputError(f"parameters of a similarity must be finite numbers, not {self}")

    @property
    def matrix(self) -> Array:
        """(1 + m) R, (3, 3)."""
        x, y, z = (v * ARCSEC for v in (self.rx_arcsec, self.ry_arcsec, self.rz_arcsec))
        turn = np.array([[1.0, -z, y], [z, 1.0, -x], [-y, x, 1.0]])
        return (1.0 + self.scale_ppm * 1e-6) * turn

    @property
    def shift(self) -> Array:
        """T, (3,) metres."""
        return np.array([self.tx, self.ty, self.tz])

    def forward(self, xyz: Array) -> Array:
        """Return coordinates in the target, (n, 3) metres."""
        return xyz @ self.matrix.T + self.shift

    def inverse(self, xyz: Array) -> Array:
        """Return coordinates in the source, (n, 3) metres."""
        return np.asarray(np.linalg.solve(self.matrix, (xyz - self.shift).T).T)


@dataclass(frozen=True, eq=False)
class TransformationChain:
    """Grid → geodetic coordinates of its own datum → those of the datum of the frame."""

    name: str
    """Name of the system."""
    source: Any
    """Geographic system with ellipsoidal heights of the grid."""
    datum: Any
    """Geographic system with ellipsoidal heights of the frame."""
    projection: proj.Operation
    """Grid coordinates to ``source``, heights passed on, or from the vertical system."""
    shift: proj.Operation | SevenParameters | None
    """``source`` to ``datum``; None: they are the same."""
    geoid: Geoid | None
    """Stated geoid, over the ellipsoid of ``datum``; None: heights are as ``projection`` makes
    them."""
    area: tuple[float, float, float, float] | None
    """West, south, east, north of the area of use, degrees; None: unknown."""
    own_heights: bool
    """Whether ``projection`` turns heights of a vertical system into ellipsoidal ones."""

    @classmethod
    def of(
        cls,
        crs: Any,
        *,
        geoid: Geoid | None,
        ellipsoidal: bool,
        datum: Any | None,
        parameters: SevenParameters | None,
    ) -> TransformationChain:
        """Return the chain of a system of pyproj.

        Raises:
            InputError: heights are not stated, axes or units are of another kind, or PROJ lacks an
                operation or its grid.
        """
        what = f"reference system {crs.name}"
        plan = crs.sub_crs_list[0] if crs.is_compound else crs
        bare = plan.source_crs if plan.is_bound else plan
        source = _geographic(bare)
        shift = _shift(plan, source, datum, parameters, what)
        target = source if datum is None else _geographic(datum)
        area = plan.area_of_use
        own = crs.is_compound and geoid is None
        if own and ellipsoidal:
            raise InputError(
                f"{what} has heights of {crs.sub_crs_list[1].name}: leave heights = 'ellipsoidal' "
                f"out, or give the plan system alone ({plan.name})"
            )
        if bare.is_projected:
            _refuse_axes(bare, what)
            told = ellipsoidal or geoid is not None or own or len(bare.axis_info) == 3
            if not told:
                raise InputError(
                    f"{what} does not tell what heights are: add a vertical system "
                    f"(EPSG:25832+7837), {proj.GEOID_HELP.removeprefix('give ')}"
                )
            first = crs if own and not plan.is_bound else bare.to_3d()
            if own and plan.is_bound:
                raise InputError(f"{what}: give geoid = PATH or a constant with +towgs84")
            projection = proj.operation(first, source, what=what)
        else:
            projection = proj.operation(source, source, what=what)
        return cls(
            str(crs.name),
            source,
            target,
            projection,
            shift,
            geoid,
            None if area is None else (area.west, area.south, area.east, area.north),
            own,
        )

    # -- conversions --------------------------------------------------------------------------

    def to_geodetic(self, grid: Array, names: Sequence[str] | None) -> tuple[Array, Array, Array]:
        """Return φ, λ (rad) and h (m) in the datum of the frame, of E, N, H (n, 3)."""
        if self.geoid is None:
            return self._shifted(self._unprojected(grid, names), names)
        # H + N is a height above the ellipsoid of the datum: that above the ellipsoid of the
        # grid is found by iteration; it enters the plan by some 1e-5 of its error alone.
        heights = grid[:, 2].copy()
        for _ in range(HEIGHT_ITERATIONS if self.shift is not None else 1):
            there = self._unprojected(np.column_stack([grid[:, :2], heights]), names)
            latitude, longitude, h = self._shifted(there, names)
            wanted = grid[:, 2] + self.geoid.at(latitude, longitude, names).undulation
            heights = heights + (wanted - h)
        return latitude, longitude, wanted

    def from_geodetic(
        self, latitude: Array, longitude: Array, height: Array, names: Sequence[str] | None
    ) -> Array:
        """Return E, N, H (n, 3) metres of φ, λ (rad) and h (m) in the datum of the frame."""
        there = np.column_stack([np.degrees(longitude), np.degrees(latitude), height])
        what = f"reference system {self.name}"
        if isinstance(self.shift, SevenParameters):
            xyz = self.shift.inverse(_cartesian(self.datum, there))
            there = _lonlat(self.source, xyz)
        elif self.shift is not None:
            there = _inverted(self.shift, there, what, names)
        out = proj.transformed(self.projection, there, what=what, inverse=True, names=names)
        if self.geoid is not None:
            out[:, 2] = height - self.geoid.at(latitude, longitude, names).undulation
        return out

    def plan_geodetic(
        self, grid: Array, names: Sequence[str] | None = None
    ) -> tuple[Array, Array, Array]:
        """Return φ, λ (rad) and roughly h (m), without the geoid: of places outside of it too."""
        if self.own_heights:
            return self.to_geodetic(grid, names)
        return self._shifted(self._unprojected(grid, names), names)

    def geoid_at(
        self, latitude: Array, longitude: Array, names: Sequence[str] | None
    ) -> GeoidValues:
        """Return undulation and deflections at places (rad) in the datum of the frame."""
        if self.geoid is not None:
            return self.geoid.at(latitude, longitude, names)
        zero = np.zeros(len(latitude))
        if not self.own_heights:
            return GeoidValues(zero, zero, zero)

        def undulation(phi: Array, lam: Array) -> Array:
            return -self.from_geodetic(phi, lam, zero, names)[:, 2]

        found = deflections(undulation, latitude, longitude, 1e-4)
        return GeoidValues(undulation(latitude, longitude), *found)

    def _unprojected(self, grid: Array, names: Sequence[str] | None) -> Array:
        """Return λ, φ (degrees) and h (m) of the system of the grid."""
        what = f"reference system {self.name}"

        def hint(i: int) -> str:
            return self._with_zone_number(grid[i])

        out = proj.transformed(self.projection, grid, what=what, names=names, hint=hint)
        proj.refuse_points(
            np.abs(out[:, 1]) > 90.0,
            lambda i: (
                f"is no place on the Earth in {self.name}: {proj.place_text(grid[i])}{hint(i)}"
            ),
            names,
        )
        proj.refuse_points(
            self._far(out),
            lambda i: (
                f"is far outside of the area of {self.name}: {proj.place_text(grid[i])} is at "
                f"latitude {out[i, 1]:.3f}°, longitude {out[i, 0]:.3f}°"
                + (hint(i) or "; are easting and northing exchanged, or is it another zone?")
            ),
            names,
        )
        return out

    def _far(self, there: Array) -> Mask:
        """Return which places, λ and φ in degrees, cannot belong to the system, (n,)."""
        if self.area is None:
            return np.zeros(len(there), dtype=bool)
        west, south, east, north = self.area
        x = np.remainder(there[:, 0] - west, 360.0)
        width = np.remainder(east - west, 360.0) or 360.0
        away = np.minimum(np.maximum(x - width, 0.0), np.abs(360.0 - x))
        return np.asarray(
            (away > AREA_MARGIN_DEG)
            | (there[:, 1] < south - AREA_MARGIN_DEG)
            | (there[:, 1] > north + AREA_MARGIN_DEG)
        )

    def _with_zone_number(self, place: Array) -> str:
        """Return that an easting begins with the number of a zone; empty if it does not.

        It does where the place lies in the area of the system without the millions.
        """
        number, east = divmod(float(place[0]), 1e6)
        if self.area is None or not 1 <= number <= MAX_ZONES:
            return ""
        try:
            there = proj.transformed(
                self.projection, np.array([[east, *place[1:]]]), what=self.name
            )
        except InputError:
            return ""
        if self._far(there)[0]:
            return ""
        return (
            f"; the easting begins with {number:.0f}, as with the number of a zone: leave it out "
            f"({east:.3f}), or is the system another one, such as Gauß-Krüger?"
        )

    def _shifted(self, there: Array, names: Sequence[str] | None) -> tuple[Array, Array, Array]:
        if isinstance(self.shift, SevenParameters):
            there = _lonlat(self.datum, self.shift.forward(_cartesian(self.source, there)))
        elif self.shift is not None:
            there = proj.transformed(
                self.shift, there, what=f"the datum of {self.name}", names=names
            )
        return np.radians(there[:, 1]), np.radians(there[:, 0]), there[:, 2].copy()


def _shift(
    plan: Any, source: Any, datum: Any | None, parameters: SevenParameters | None, what: str
) -> proj.Operation | SevenParameters | None:
    if datum is None:
        return None
    target = _geographic(datum)
    if parameters is not None:
        return parameters
    dynamic = [c.name for c in (source, target) if _dynamic(c)]
    if dynamic and source != target:
        raise InputError(
            f"{what}: {' and '.join(dynamic)} moves with the plates, so that it has coordinates at "
            "an epoch only: give the parameters of the similarity at your epoch"
        )
    if plan.is_bound:
        stated = list(plan.coordinate_operation.towgs84)
        if len(stated) not in (3, 7):
            raise InputError(f"{what} is bound by another operation than +towgs84: use parameters")
        return SevenParameters(*stated)
    return proj.operation(source, target, what=f"{what} to {datum.name}")


def _inverted(shift: proj.Operation, there: Array, what: str, names: Sequence[str] | None) -> Array:
    """Return the places that an operation leads to these ones.

    PROJ takes the transpose of a matrix of small rotations for its inverse, which is wrong by
    1 mm where they are 3 seconds: one step of correction brings it below 1e-8 m.
    """
    found = proj.transformed(shift, there, what=what, inverse=True, names=names)
    for _ in range(2):
        again = proj.transformed(shift, found, what=what, names=names)
        found = found + (there - again)
    return found


def _dynamic(crs: Any) -> bool:
    return crs.datum is not None and crs.datum.type_name.startswith("Dynamic")


def _geographic(crs: Any) -> Any:
    """Return the geographic system with ellipsoidal heights of a system."""
    plan = crs.sub_crs_list[0] if crs.is_compound else crs
    if plan.geodetic_crs is None:
        raise InputError(
            f"reference system {crs.name} is not tied to the Earth ({plan.type_name}); valid: "
            "projected, geographic and geocentric systems"
        )
    return plan.geodetic_crs.to_3d() if not plan.is_geocentric else _of_geocentric(plan)


def _of_geocentric(crs: Any) -> Any:
    package = proj.pyproj()
    return package.crs.GeographicCRS(
        name=crs.name,
        datum=crs.datum,
        ellipsoidal_cs=package.crs.coordinate_system.Ellipsoidal3DCS(),
    )


def _refuse_axes(plan: Any, what: str) -> None:
    """Refuse grids whose axes are not easting and northing, or that count in other units."""
    directions = sorted(a.direction for a in plan.axis_info[:2])
    if directions != ["east", "north"]:
        raise InputError(
            f"{what} has the axes {' and '.join(directions)}; valid: systems of easting and "
            "northing"
        )
    units = {a.unit_name for a in plan.axis_info if a.unit_conversion_factor != 1.0}
    if units:
        raise InputError(
            f"{what} counts in {' and '.join(sorted(units))}; coordinates are metres here: give "
            "the same grid in metres"
        )


def _ellipsoid(crs: Any) -> Ellipsoid:
    e = crs.ellipsoid
    return Ellipsoid(e.name, e.semi_major_metre, e.inverse_flattening)


def _cartesian(crs: Any, lonlat: Array) -> Array:
    latitude, longitude = np.radians(lonlat[:, 1]), np.radians(lonlat[:, 0])
    return _ellipsoid(crs).to_cartesian(latitude, longitude, lonlat[:, 2])


def _lonlat(crs: Any, xyz: Array) -> Array:
    latitude, longitude, height = _ellipsoid(crs).to_geodetic(xyz)
    return np.column_stack([np.degrees(longitude), np.degrees(latitude), height])
