"""Adjusted points and photos in the grid of the reference system, with covariances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..columns import Columns
from ..crs.places import GridPlaces, Wgs84Places, grid_places, wgs84_places
from ..crs.system import ReferenceSystem
from ..errors import InputError
from ..graph.equations import Equations
from ..graph.variables import State
from ..network.network import Network
from ..shown import FIRST, Rows, Shown
from ..types import Array

NO_SYSTEM = (
    "the network has no reference system: state one, such as Network(crs='EPSG:25832+7837'), or "
    "[crs] in project.toml"
)


class Adjusted(Protocol):
    """What grid coordinates are taken from."""

    @property
    def network(self) -> Network:
        """The network."""
        ...

    @property
    def equations(self) -> Equations:
        """Its observation equations."""
        ...

    @property
    def state(self) -> State:
        """Values of all variables."""
        ...

    @property
    def point_covariances(self) -> Array:
        """Covariances of all points, (n, 3, 3)."""
        ...


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
        for i, a in enumerate(("easting", "northing", "height")):
            out[a] = p.coordinates[:, i].copy()
        for i, a in enumerate(("easting", "northing", "height")):
            out[f"sigma_{a}"] = sigma[:, i]
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
        return Rows(("point", "easting", "northing", "height"), rows, len(self.names))


def system_of(network: Network) -> ReferenceSystem:
    """Return the reference system of a network; InputError if it has none."""
    if network.crs is None:
        raise InputError(NO_SYSTEM)
    return network.crs


def grid_coordinates(solution: Adjusted) -> GridCoordinates:
    """Return the adjusted points in the grid of the network's reference system.

    The covariance of E, N, H is J Σ Jᵀ with the partials J of the projection and of the height
    above the geoid; that of the geoid itself enters where it is an unknown, see `from_grid`.

    Args:
        solution: an adjusted network.

    Raises:
        InputError: the network has no reference system or one without a grid, pyproj or a geoid
            is missing, or a point is outside of the geoid.
    """
    system = system_of(solution.network)
    names = tuple(solution.equations.unknowns["point"].names)
    places = grid_places(
        system,
        solution.network.frame,
        solution.state["point"],
        solution.point_covariances,
        names,
    )
    return GridCoordinates(system, names, places)


def wgs84_coordinates(solution: Adjusted) -> Wgs84Places:
    """Return the adjusted points in WGS 84, in the order of the network's points, for maps.

    Raises:
        InputError: the network has no reference system, pyproj is missing, or PROJ knows no
            operation to WGS 84.
    """
    network = solution.network
    return wgs84_places(
        system_of(network), network.frame, solution.state["point"], solution.point_covariances
    )
