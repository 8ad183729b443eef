"""Coordinates of strips of models."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import Observation, checked_covariance


@dataclass(frozen=True)
class StripCoordinate(Observation):
    """Coordinates of a point in a strip that bends: X = value + polynomial(along, across).

    The value is on the ground: coordinates of the strip after its absolute orientation, in the
    axes of the network. See `Network.set_polynomial` and `factorgraph_adj.models.strip`.
    """

    kind: ClassVar[str] = "strip_coordinate"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    strip: str
    """The strip, which names its polynomial."""
    point: str
    """The point."""
    value: tuple[float, ...]
    """Coordinates of ``axes``, metres."""
    _: KW_ONLY
    along: float
    """Place along the strip from its middle, in the unit of its polynomial, such as kilometres."""
    across: float
    """Place across the strip, the same unit, to the left if axes of the network are right-handed
    and along points forward."""
    axes: str = "xyz"
    """Measured axes: xy, z or xyz, or single ones."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the axes, metres; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance of the axes, metres²; None if ``sigma`` is given."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if not self.strip:
            self._fail("strip must name a strip polynomial")
        axes = set(self.axes)
        if not axes or not axes <= set("xyz") or len(axes) < len(self.axes):
            self._fail(f"axes must be some of x, y, z, not {self.axes!r}")
        if np.shape(self.value) != (len(self.axes),):
            self._fail(f"value has {np.size(self.value)} components, axes {self.axes!r}")
        checked_covariance(self, len(self.axes))

    def component_names(self) -> tuple[str, ...]:
        """Return the measured axes."""
        return tuple(self.axes)
