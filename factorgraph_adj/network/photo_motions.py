"""Motions of photos in a network: which photos can have one, and who has to know of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ..entities import Camera, Parameter, Photo
from ..errors import InputError, Problem
from ..models.unknown_registry import VariableKind, unknown_kind
from .construction import required


class PhotoMotions:
    """Part of a network: what its photos have of their own besides a pose, such as a motion."""

    photos: dict[str, Photo]
    """Photos by name."""
    cameras: dict[str, Camera]
    """Cameras by name."""
    parameters: dict[VariableKind, dict[Any, Parameter]]
    """Unknowns by kind and name."""

    def of_photo(self, photo: str) -> tuple[tuple[VariableKind, str], ...]:
        """Return kind and name of the stated unknowns of a photo, such as its motion."""
        kinds = (
            k for k, own in self.parameters.items() if unknown_kind(k).in_photo and photo in own
        )
        return tuple((k, photo) for k in kinds)

    def check_readout(self, photo: str, where: str) -> None:
        """Refuse a photo that is not there, or whose camera reads all rows at the same time.

        Readers report a photo without a camera themselves.
        """
        required(photo, self.photos, "photo", where)
        camera = self.photos[photo].camera
        if camera in self.cameras and self.cameras[camera].times() is None:
            what = (
                f"camera {camera!r} has no readout time, so that no image point tells the motion: "
                "state readout and format of the camera, or no motion"
            )
            raise InputError(Problem(what, where))

    def refuse_motions(self, photos: Iterable[str], what: str) -> None:
        """Refuse photos that have a motion; ``what`` needs one pose for all rows of a photo."""
        moving = [f for f in photos if self.of_photo(f)]
        if moving:
            reason = (
                f"{what} takes the rows of a photo as exposed at the same time, and has no motion "
                "of a photo during its readout; network.of_kind('photo_motion') has the motions"
            )
            raise InputError(Problem(reason, f"photo {f!r}") for f in moving)
