"""Change of axes from a grid to a frame on the Earth: options, places, rotations, partials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ...crs.grid_places import grid_places
from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem
from ...frames import Frame, GeocentricFrame, LocalFrame, TopocentricFrame
from ...types import Array

HELD = 1e-5
"""Standard deviation (m) of components that are held in the grid and are no component of the
frame: a height, or easting and northing without the height."""
OFFSET = "geoid"
"""Name of the level surface whose height is the offset of the geoid."""

Azimuths: TypeAlias = Literal["true", "grid"]
"""What azimuths count from: geodetic or astronomic north, or grid north."""
Vectors: TypeAlias = Literal["geocentric", "grid"]
"""Axes of GNSS vectors: X, Y, Z of the Earth, or easting, northing, height."""
Distances: TypeAlias = Literal["measured", "ellipsoid", "sea_level", "grid"]
"""Where horizontal distances are: at the height of the points, on the ellipsoid, on the geoid, or
in the grid."""
Deflections: TypeAlias = "Literal['none', 'held'] | float"
"""Deflections of the vertical: none, those of the geoid held, or weighted with this σ (rad)."""


@dataclass(frozen=True)
class GridOptions:
    """What the coordinates of a grid do not determine."""

    deflections: Deflections = "none"
    """Deflections at stations."""
    geoid_offset: float | None = None
    """σ (m) of an unknown offset of the geoid that all heights share; infinite: free; None: 0."""
    azimuths: Azimuths | Mapping[str, Azimuths] | None = None
    """What azimuths count from, all of them or by id; None: a network with azimuths is refused."""
    vectors: Vectors | None = None
    """Axes of GNSS vectors; None: a network with such is refused."""
    horizontal_distances: Distances | Mapping[str, Distances] = "measured"
    """Where horizontal distances are, all of them or by id."""

    def of(self, ident: str) -> GridOptions:
        """Return the options of one observation."""
        azimuths, distances = self.azimuths, self.horizontal_distances
        if isinstance(azimuths, Mapping):
            azimuths = azimuths.get(ident)
        if isinstance(distances, Mapping):
            distances = distances.get(ident, "measured")
        return replace(self, azimuths=azimuths, horizontal_distances=distances)


@dataclass(frozen=True, eq=False)
class Moved:
    """Places in the new frame; rows of NaN where a place has no coordinates."""

    xyz: Array
    """Coordinates in the frame, (n, 3) metres."""
    turn: Array
    """Rotations frame_R_grid from the axes of the network in the grid, (n, 3, 3)."""
    partials: Array
    """∂X/∂x by coordinates of the network in the grid, (n, 3, 3): with the scale of the grid."""
    horizon: Array
    """Rows east, north, up in the frame, (n, 3, 3)."""
    convergence: Array
    """γ, azimuth of grid north, (n,) radians."""
    scale: Array
    """Scale of the projection, (n,)."""
    combined: Array
    """Combined factor, (n,)."""
    undulation: Array
    """N, (n,) metres."""
    grid: Array
    """Easting, northing, height, (n, 3) metres."""

    def __len__(self) -> int:
        """Return the number of places."""
        return len(self.xyz)

    def there(self, row: int) -> bool:
        """Return whether a place has coordinates."""
        return bool(np.isfinite(self.xyz[row]).all())


@dataclass(frozen=True, eq=False)
class GridMove:
    """The change from a local frame, whose axes are those of a grid, to a frame on the Earth."""

    system: ReferenceSystem
    """Reference system of the coordinates."""
    old: LocalFrame
    """Frame of the network in the grid."""
    new: GeocentricFrame | TopocentricFrame
    """Frame on the Earth."""
    options: GridOptions = field(default_factory=GridOptions)
    """What the coordinates do not determine."""

    @cached_property
    def axes(self) -> Array:
        """Rows easting, northing, height in the axes of the old frame, (3, 3)."""
        return np.vstack([self.old.east_north, [0.0, 0.0, 1.0]])

    @property
    def from_earth(self) -> Array:
        """Rotation from the axes of the Earth X, Y, Z to those of the new frame, (3, 3)."""
        new = self.new
        return new.axes_in_geocentric if isinstance(new, TopocentricFrame) else np.eye(3)

    @property
    def level(self) -> bool:
        """Whether the undulation is the same everywhere: a constant, or heights are ellipsoidal."""
        return not isinstance(self.system.geoid, str) and not self.system.chain.own_heights

    def grid(self, xyz: Array) -> Array:
        """Return E, N, H, (n, 3) metres, of coordinates in the old frame."""
        return np.asarray(xyz, dtype=float).reshape(-1, 3) @ self.axes.T

    def photos(self, xyz: Array, names: Sequence[str]) -> Moved:
        """Return the places of photos as `places`; messages say that they are photos."""
        try:
            return self.places(xyz, names)
        except InputError as error:
            found = (Problem(p.what, p.where.replace("point", "photo", 1)) for p in error.problems)
            raise InputError(found) from None

    def places(self, xyz: Array, names: Sequence[str] | None = None) -> Moved:
        """Return places of the old frame, (n, 3) metres, in the new one; NaN stays NaN.

        Args:
            xyz: coordinates in the old frame; rows with NaN give NaN.
            names: names of the places, for messages and for a geoid of named points.

        Raises:
            InputError: places outside of the grid or of the geoid, all of them.
        """
        grid = self.grid(xyz)
        known = np.flatnonzero(np.isfinite(grid).all(axis=1)).tolist()
        labels = None if names is None else [names[i] for i in known]
        n = len(grid)
        empty = np.full((n, 3, 3), np.nan)
        out = Moved(
            xyz=np.full((n, 3), np.nan),
            turn=empty.copy(),
            partials=empty.copy(),
            horizon=empty.copy(),
            convergence=np.full(n, np.nan),
            scale=np.full(n, np.nan),
            combined=np.full(n, np.nan),
            undulation=np.full(n, np.nan),
            grid=grid,
        )
        if not known:
            return out
        at = self.system.to_frame(self.new, grid[known], labels)
        found = grid_places(self.system, self.new, at, names=labels)
        enu = self.new.basis(at, np.zeros((len(at), 2))).enu
        cosine, sine = np.cos(found.convergence), np.sin(found.convergence)
        enu_R_grid = np.zeros((len(at), 3, 3))
        # Grid east has the azimuth 90° + γ, grid north γ.
        enu_R_grid[:, 0, 0], enu_R_grid[:, 0, 1] = cosine, sine
        enu_R_grid[:, 1, 0], enu_R_grid[:, 1, 1] = -sine, cosine
        enu_R_grid[:, 2, 2] = 1.0
        out.xyz[known] = at
        out.turn[known] = enu.transpose(0, 2, 1) @ enu_R_grid @ self.axes
        out.partials[known] = np.linalg.solve(
            found.jacobians, np.broadcast_to(self.axes, enu.shape)
        )
        out.horizon[known] = enu
        out.convergence[known] = found.convergence
        out.scale[known] = found.scale
        out.combined[known] = found.combined
        out.undulation[known] = found.undulation
        return out


def no_place(where: str) -> Problem:
    """Return that something needs a place to be turned at."""
    what = (
        "needs approximate coordinates: the direction of grid north and of the vertical, and the "
        "geoid, depend on the place"
    )
    return Problem(what, where)


def new_frame(
    system: ReferenceSystem, grid: Array, stated: Frame | Literal["topocentric", "geocentric"]
) -> GeocentricFrame | TopocentricFrame | None:
    """Return the frame on the Earth; None if a local one is stated.

    Args:
        system: reference system of the coordinates.
        grid: E, N, H of the points, (n, 3) metres.
        stated: a frame, or the kind of a frame: a topocentric one has its origin in the middle.
    """
    if isinstance(stated, LocalFrame):
        return None
    if stated == "geocentric":
        return system.geocentric_frame()
    if stated == "topocentric":
        return system.frame_at(grid)
    assert not isinstance(stated, str)
    return stated
