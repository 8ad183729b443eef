"""Points of a network as writers of survey files have them: in the grid, or as they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...crs.places import GridPlaces, grid_places
from ...crs.system import ReferenceSystem
from ...frames import LocalFrame
from ...network.network import Network
from ...types import Array


@dataclass(frozen=True, eq=False)
class GridPoints:
    """Points of a network on the Earth in its grid."""

    network: Network
    """The network."""
    system: ReferenceSystem
    """Its reference system."""

    @cached_property
    def coordinates(self) -> dict[str, Array]:
        """Easting, northing, height by point, (3,) metres; NaN of points without coordinates."""
        out = {name: np.full(3, np.nan) for name in self.network.points}
        names = list(self._known)
        if names:
            xyz = np.array(list(self._known.values()))
            found = self.system.from_frame(self.network.frame, xyz, names)
            out |= dict(zip(names, found, strict=True))
        return out

    @cached_property
    def places(self) -> GridPlaces | None:
        """Convergence, undulation and partials of the points with coordinates; None: no such."""
        if not self._known:
            return None
        xyz = np.array(list(self._known.values()))
        return grid_places(self.system, self.network.frame, xyz, names=list(self._known))

    @cached_property
    def rows(self) -> dict[str, int]:
        """Rows of ``places`` by point."""
        return {name: row for row, name in enumerate(self._known)}

    @cached_property
    def _known(self) -> dict[str, Array]:
        every = {n: np.array(p.coordinates, dtype=float) for n, p in self.network.points.items()}
        return {n: xyz for n, xyz in every.items() if np.isfinite(xyz).all()}


def grid_points(network: Network) -> GridPoints | None:
    """Return the points of a network in its grid; None: it has its own coordinates alone.

    That is so of a network in a local frame, and of one without the reference system of a grid.

    Raises:
        InputError: pyproj is missing, or PROJ does not know the system.
    """
    system = network.crs
    if isinstance(network.frame, LocalFrame) or system is None or not system.projected:
        return None
    return GridPoints(network, system)
