"""What tables and grid coordinates are taken from: an adjusted network, whole or in parts."""

from __future__ import annotations

from typing import Protocol

from ..graph.equations import Equations
from ..graph.variables import State
from ..network.network import Network
from ..types import Array


class Estimated(Protocol):
    """A network with adjusted values and the covariances of its points."""

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


class EstimatedPhotos(Estimated, Protocol):
    """The same with the covariances of its photos."""

    def pose_covariance(self, photo: str) -> Array:
        """Return the covariance of a photo, (6, 6)."""
        ...
