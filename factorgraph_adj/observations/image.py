"""Image points: measured coordinates of a point in a photo, with their standard deviations."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from .base import Observation


@dataclass(frozen=True)
class ImagePoint(Observation):
    """Image coordinates of a point in a photo, units of the camera, x right, y up. Eq. 1."""

    kind: ClassVar[str] = "image"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    point: str
    """The point."""
    x: float
    """Measured x, image units."""
    y: float
    """Measured y, image units."""
    _: KW_ONLY
    sigma: tuple[float, float] | float
    """Standard deviations of x and y, or one for both, image units."""
    correlation: float = 0.0
    """Correlation ρ = σ_xy / (σ_x σ_y) of x and y, between −1 and 1."""

    def _check(self) -> None:
        super()._check()
        if not abs(self.correlation) < 1:
            self._fail(f"correlation must be between −1 and 1, not {self.correlation!r}")
