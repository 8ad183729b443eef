"""Adjusted points and photos in the map grid, with precision and tables; points in WGS 84."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..columns import Columns
from ..crs.grid_places import GridPlaces, Wgs84Places, grid_places, wgs84_places
from ..crs.reference_system import ReferenceSystem
from ..errors import InputError
from ..frames import LocalFrame
from ..network.grid.model_coordinates import refuse_model_coordinates
from ..network.network import Network
from ..result_display import FIRST, Rows, Shown
from ..rotation import angles_by_rotation, omega_phi_kappa
from ..types import Array
from .estimates import EstimatedNetwork, EstimatedNetworkWithPhotos

GRID_COORDINATE_NAMES = ("easting", "northing", "height")
NO_REFERENCE_SYSTEM = (
    "the network has no reference system: state one, such as Network(crs='EPSG:25832+7837'), "
    "[crs] in project.toml, or --crs"
)


@dataclass(frozen=True, eq=False, repr=False)
class GridCoordinates(Shown):
    """Adjusted points in the grid of a reference system."""

    system: ReferenceSystem
    """The reference system."""
    names: tuple[str, ...]
    """Names of the n points."""
    places: GridPlaces
    """Coordinates, covariances, convergence and scale."""

    @property
    def coordinates(self) -> Array:
        """Easting, northing, height, (n, 3) metres."""
        return self.places.coordinates

    @property
    def covariances(self) -> Array:
        """Covariances of E, N, H of each point, (n, 3, 3) metres²."""
        return self.places.covariances

    def point(self, name: str) -> Array:
        """Return E, N, H of a point, (3,) metres."""
        return np.array(self.coordinates[self.names.index(name)])

    def table(self) -> Columns:
        """Return name, easting, northing, height, σ, convergence (rad) and factors as columns."""
        p = self.places
        sigma = p.sigma
        out: dict[str, np.ndarray[Any, Any]] = {"name": np.array(self.names, dtype=object)}
        out |= {a: p.coordinates[:, i].copy() for i, a in enumerate(GRID_COORDINATE_NAMES)}
        out |= {f"sigma_{a}": sigma[:, i] for i, a in enumerate(GRID_COORDINATE_NAMES)}
        out |= {"undulation": p.undulation, "convergence": p.convergence}
        out |= {"scale": p.scale, "combined": p.combined}
        return Columns("points in the grid", out)

    def headline(self) -> str:
        """Return the system and what heights are above."""
        return f"{len(self.names)} points in {self.system.name}, heights: {self.system.vertical}"

    def first_rows(self) -> Rows:
        """Return the first points, metres."""
        rows = (
            (n, *map(float, c)) for n, c in zip(self.names, self.coordinates[:FIRST], strict=False)
        )
        return Rows(("point", *GRID_COORDINATE_NAMES), rows, len(self.names))


def reference_system_of(network: Network) -> ReferenceSystem:
    """Return the reference system of a network.

    Raises:
        InputError: it has none, or its coordinates are those of a model
            (`refuse_model_coordinates`).
    """
    if network.crs is None:
        raise InputError(NO_REFERENCE_SYSTEM)
    refuse_model_coordinates(network, network.crs)
    return network.crs


def grid_coordinates(solution: EstimatedNetwork) -> GridCoordinates:
    """Return the adjusted points in the grid of the network's reference system.

    The covariance of E, N, H is J Σ Jᵀ with the partials J of the projection and of the height
    above the geoid; that of the geoid itself enters where it is an unknown, see `from_grid`.

    Args:
        solution: an adjusted network.

    Raises:
        InputError: the network has no reference system or one without a grid, pyproj or a geoid
            is missing, or a point is outside of the geoid.
    """
    system = reference_system_of(solution.network)
    names = tuple(solution.equations.unknowns["point"].names)
    places = grid_places(
        system,
        solution.network.frame,
        solution.state["point"],
        solution.point_covariances,
        names,
    )
    return GridCoordinates(system, names, places)


def wgs84_coordinates(solution: EstimatedNetwork) -> Wgs84Places:
    """Return the adjusted points in WGS 84, in the order of the network's points, for maps.

    Raises:
        InputError: the network has no reference system, pyproj is missing, or PROJ knows no
            operation to WGS 84.
    """
    network = solution.network
    return wgs84_places(
        reference_system_of(network),
        network.frame,
        solution.state["point"],
        solution.point_covariances,
    )


@dataclass(frozen=True, eq=False, repr=False)
class GridPhotos(Shown):
    """Adjusted photos in the grid of a reference system."""

    system: ReferenceSystem
    """The reference system."""
    names: tuple[str, ...]
    """Names of the n photos."""
    places: GridPlaces
    """Projection centres: coordinates, covariances, convergence and scale."""
    angles: Array
    """ω, φ, κ from easting, northing and the vertical at the photo, (n, 3) radians."""
    sigma_angles: Array
    """Their standard deviations, (n, 3) radians; NaN at φ = ±π/2."""

    def table(self) -> Columns:
        """Return name, easting, northing, height, ω, φ, κ and their σ as columns."""
        p = self.places
        out: dict[str, np.ndarray[Any, Any]] = {"name": np.array(self.names, dtype=object)}
        out |= {a: p.coordinates[:, i].copy() for i, a in enumerate(GRID_COORDINATE_NAMES)}
        out |= {a: self.angles[:, i] for i, a in enumerate(("omega", "phi", "kappa"))}
        out |= {f"sigma_{a}": p.sigma[:, i] for i, a in enumerate(GRID_COORDINATE_NAMES)}
        about = enumerate(("omega", "phi", "kappa"))
        out |= {f"sigma_{a}": self.sigma_angles[:, i] for i, a in about}
        return Columns("photos in the grid", out)

    def headline(self) -> str:
        """Return the system and what heights are above."""
        return f"{len(self.names)} photos in {self.system.name}, heights: {self.system.vertical}"

    def first_rows(self) -> Rows:
        """Return the first projection centres, metres."""
        first = zip(self.names, self.places.coordinates[:FIRST], strict=False)
        rows = ((n, *map(float, c)) for n, c in first)
        return Rows(("photo", *GRID_COORDINATE_NAMES), rows, len(self.names))


def grid_photos(solution: EstimatedNetworkWithPhotos) -> GridPhotos:
    """Return the adjusted photos in the grid: centres, and ω, φ, κ from the axes of the grid.

    R_grid = Cᵀ E R with the rows E east, north, up at the photo and the turn C by the convergence.

    Raises:
        InputError: as `grid_coordinates`.
    """
    system, frame = reference_system_of(solution.network), solution.network.frame
    table = solution.equations.unknowns["pose"]
    names = tuple(solution.network.photos)
    stored = solution.state["pose"][[table.number[n] for n in names]].reshape(-1, 12)
    covariances = np.array([solution.pose_covariance(n) for n in names]).reshape(-1, 6, 6)
    places = grid_places(system, frame, stored[:, 9:], covariances[:, 3:, 3:], names)
    if isinstance(frame, LocalFrame):
        axes = np.broadcast_to(np.vstack([frame.east_north, [0.0, 0.0, 1.0]]), (len(names), 3, 3))
    else:
        c, s = np.cos(places.convergence), np.sin(places.convergence)
        grid_R_enu = np.zeros((len(names), 3, 3))
        grid_R_enu[:, 0, 0], grid_R_enu[:, 0, 1] = c, -s
        grid_R_enu[:, 1, 0], grid_R_enu[:, 1, 1] = s, c
        grid_R_enu[:, 2, 2] = 1.0
        axes = grid_R_enu @ frame.basis(stored[:, 9:], np.zeros((len(names), 2))).enu
    turned = axes @ stored[:, :9].reshape(-1, 3, 3)
    angles = np.array([omega_phi_kappa(r) for r in turned]).reshape(-1, 3)
    by = np.array([angles_by_rotation(r) for r in turned]).reshape(-1, 3, 3)
    variances = np.einsum("nij,njk,nik->ni", by, covariances[:, :3, :3], by)
    return GridPhotos(system, names, places, angles, np.sqrt(np.maximum(variances, 0.0)))
