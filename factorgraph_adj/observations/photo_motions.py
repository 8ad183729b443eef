"""Motions of photos from their neighbours: what a platform did between two exposures."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

from ..models import photo_motions
from .base import VectorObservation
from .registry import ObservationKind


@dataclass(frozen=True)
class _BetweenPhotos(VectorObservation):
    """Base of what the motion of a photo has to do with the poses of its neighbours."""

    moving_photo: str
    """Photo whose motion it is: one between A and B, at the end of a strip A or B itself."""
    before: str
    """Photo A, exposed first."""
    after: str
    """Photo B, exposed last."""
    value: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Observed difference, SI; 0: uniform motion."""
    _: KW_ONLY
    interval: float = field(metadata={"quantity": "number"})
    """Time Δt from A to B in the unit of the camera's readout time: seconds, which need the true
    readout time. Where ``readout=1.0`` stands for an unknown one, seconds are wrong by the factor
    1/T."""

    def _check(self) -> None:
        super()._check()
        if self.before == self.after:
            self._fail("before and after are the same: a motion is between two photos")
        if not self.interval > 0:
            self._fail(f"the interval must be greater than zero, not {self.interval}")


@dataclass(frozen=True)
class PhotoShift(_BetweenPhotos):
    """Predicted less actual displacement between two exposures, v Δt − (X_B − X_A); metres.

    Difference between the displacement that the velocity of a photo predicts, v Δt, and the
    displacement from photo A to photo B, X_B − X_A; metres, axes of the network. Its value is 0 for
    uniform motion; sigma says by how much the flight may differ from it. Use it to tie the motion
    during the readout to the neighbouring exposures.
    """

    kind: ClassVar[str] = "photo_shift"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres; None if ``covariance`` is given."""


@dataclass(frozen=True)
class PhotoTurn(_BetweenPhotos):
    """Predicted less actual rotation between two exposures, ω Δt − Log(R_A' R_B); radians.

    Difference between the rotation that the angular velocity of a photo predicts, ω Δt, and the
    rotation from photo A to photo B. Its value is 0 for uniform motion; sigma says by how much the
    flight may differ from it. The axes are those of the camera, x right, y down, z forward: ry and
    rz have the opposite sign to those of `RelativeRotation`, whose axes are x right, y up, z
    backwards.
    """

    kind: ClassVar[str] = "photo_turn"
    components: ClassVar[tuple[str, ...]] = ("rx", "ry", "rz")
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, radians; None if ``covariance`` is given."""


_VARIABLES = (("pose", "before"), ("pose", "after"), ("photo_motion", "moving_photo"))
KINDS_IN_MODULE = (
    ObservationKind(
        PhotoShift,
        _VARIABLES,
        photo_motions.photo_shift,
        ("interval",),
        linear=True,
        titles={"de": "Verschiebung zwischen Nachbarbildern"},
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
