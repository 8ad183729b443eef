"""Fiducial marks and crosses of a réseau: what a scanner or comparator measured of the film."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

from ..models import film_lens
from .base import VectorObservation
from .registry import ObservationKind


@dataclass(frozen=True)
class FiducialMark(VectorObservation):
    """Measured coordinates of a fiducial mark, or of a réseau cross, in a photo on film.

    It observes the interior orientation of its photo, the parameters of `FilmLens`: the camera has
    this lens model and, as a rule, a calibration for each photo (``per_photo``). x points right and
    y up, in units of the camera as those of `ImagePoint`, which come from the same measurement.
    """

    kind: ClassVar[str] = "fiducial_mark"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    mark: str
    """Name of the mark, as in the calibration certificate."""
    value: tuple[float, float]
    """Measured coordinates, image units."""
    _: KW_ONLY
    film_x: float = field(metadata={"quantity": "number"})
    """Calibrated coordinate x of the mark from the principal point, film units."""
    film_y: float = field(metadata={"quantity": "number"})
    """Calibrated coordinate y of the mark from the principal point, film units."""
    sigma: tuple[float, float] | None = None
    """Standard deviations, image units, with that of the calibrated coordinates; None if
    ``covariance`` is given."""

    def names(self) -> tuple[str, ...]:
        """Return the photo and the mark."""
        return (*super().names(), self.mark)


KINDS_IN_MODULE = (
    ObservationKind(
        FiducialMark,
        (("calibration", "photo"),),
        film_lens.fiducial_mark,
        ("film_x", "film_y"),
        unit="image",
        linear=True,
        choices=("mark",),
        quantity="mark of a film",
        titles={"de": "Rahmenmarke"},
    ),
)
"""The records."""
