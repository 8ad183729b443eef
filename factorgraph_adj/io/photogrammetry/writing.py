"""What writers share: everything of a network that a format cannot express, told at once."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from ...errors import InputError, Problem
from ...network.entities import Camera
from ...network.network import Network
from ...types import Array

MOST_PROBLEMS = 30
"""Largest number of listed problems."""


@dataclass
class Refusals:
    """What a format cannot express."""

    format: str
    """Name of the format, for messages."""
    problems: list[Problem] = field(default_factory=list)
    """What was found so far."""

    def refuse(self, what: str, where: str = "") -> None:
        """Add a problem."""
        self.problems.append(Problem(f"{self.format} cannot express {what}", where))

    def observations(self, network: Network, kinds: Collection[str], hint: str = "") -> None:
        """Refuse observations of other kinds than some, correlations among them, and unknowns."""
        for ident, o in network.observations.items():
            if o.kind not in kinds:
                what = f"a {o.kind.replace('_', ' ')}"
                self.refuse(f"{what}{'; ' + hint if hint else ''}", o.label() or ident)
        if network.clusters:
            self.refuse("observations that are correlated with others")

    def points(self, network: Network, *, fixed: bool = False) -> None:
        """Refuse held points, unless ``fixed``, and weighted ones."""
        for name, p in network.points.items():
            if any(p.fixed) and not fixed:
                self.refuse("held coordinates: observe them as a control point", f"point {name!r}")
            if p.sigma is not None:
                self.refuse("a weight on coordinates; use a control point", f"point {name!r}")

    def photos(self, network: Network) -> None:
        """Refuse held and weighted poses."""
        for name, photo in network.photos.items():
            if any(photo.fixed):
                self.refuse("a held pose", f"photo {name!r}")
            if photo.sigma_position is not None or photo.sigma_attitude is not None:
                self.refuse("a weighted pose", f"photo {name!r}")

    def cameras(self, network: Network) -> None:
        """Refuse weighted calibrations and those of single photos."""
        for name, camera in network.cameras.items():
            where = f"camera {name!r}"
            if np.isfinite(camera.sigma).any():
                self.refuse("weighted calibration parameters", where)
            if camera.per_photo:
                self.refuse("a calibration for each photo", where)

    def finish(self) -> None:
        """Raise all problems.

        Raises:
            InputError: there is any.
        """
        if self.problems:
            rest = len(self.problems) - MOST_PROBLEMS
            more = [Problem(f"and {rest} more that it cannot express")] if rest > 0 else []
            raise InputError(self.problems[:MOST_PROBLEMS] + more)


def one(values: Iterable[float]) -> float | None:
    """Return the only value, to 12 digits, of some; None if they differ or there are none."""
    found = np.array(list(values))
    if not len(found) or np.ptp(found) > 1e-12 * np.abs(found).max():
        return None
    return float(found[0])


def calibration(camera: Camera) -> dict[str, float]:
    """Return the calibration of a camera by name."""
    return dict(zip(camera.lens.names, camera.values, strict=True))


def in_pixels(camera: Camera) -> tuple[float, float] | None:
    """Return the size of the sensor if image coordinates count pixels from the upper left corner.

    None where they do not, or where the size is unknown.
    """
    if camera.unit != "px" or camera.format is None or camera.origin != "upper left":
        return None
    return camera.format


def text(values: Array | Iterable[float]) -> str:
    """Return numbers with all digits, separated by blanks."""
    return " ".join(repr(float(v)) for v in np.asarray(values, dtype=float).ravel())
