"""Motions of photos from their neighbours: what a platform did between two exposures."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

from ..models import photo_motions
from .base import VectorObservation
from .registry import ObservationKind


@dataclass(frozen=True)
class _BetweenPhotos(VectorObservation):
    """Base of what the motion of a photo has to do with the poses of its neighbours.

    At the end of a strip the photo itself is the first or the last of the two.
    """

    photo: str
    """Photo A, exposed first."""
    photo2: str
    """Photo B, exposed last."""
    motion: str
    """Photo whose motion it is: one of both, or one between them."""
    value: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Difference of the motion from that of the neighbours over the interval, SI."""
    _: KW_ONLY
    interval: float = field(metadata={"quantity": "number"})
    """Time from A to B, in the unit of the camera's readout, seconds."""

    def _check(self) -> None:
        super()._check()
        if self.photo == self.photo2:
            self._fail("photo and photo2 are the same: a motion is between two photos")
        if not self.interval > 0:
            self._fail(f"the interval must be greater than zero, not {self.interval}")


@dataclass(frozen=True)
class PhotoShift(_BetweenPhotos):
    """Way of a photo at its velocity less that between its neighbours: v Δt − (X_B − X_A)."""

    kind: ClassVar[str] = "photo_shift"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres; None if ``covariance`` is given."""


@dataclass(frozen=True)
class PhotoTurn(_BetweenPhotos):
    """Turn of a photo at its rate less that between its neighbours: ω Δt − Log(R_A' R_B).

    The axes are those of the camera: x right, y down, z forward.
    """

    kind: ClassVar[str] = "photo_turn"
    components: ClassVar[tuple[str, ...]] = ("rx", "ry", "rz")
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, radians; None if ``covariance`` is given."""


_VARIABLES = (("pose", "photo"), ("pose", "photo2"), ("photo_motion", "motion"))
KINDS_IN_MODULE = (
    ObservationKind(
        PhotoShift,
        _VARIABLES,
        photo_motions.photo_shift,
        ("interval",),
        linear=True,
        titles={"de": "Weg zwischen Nachbarbildern"},
    ),
    ObservationKind(
        PhotoTurn,
        _VARIABLES,
        photo_motions.photo_turn,
        ("interval",),
        unit="rad",
        titles={"de": "Drehung zwischen Nachbarbildern"},
    ),
)
"""The records."""
