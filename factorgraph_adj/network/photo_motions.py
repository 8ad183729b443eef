"""Motions of photos in a network: which photos can have one, and motions along a strip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from ..entities import Camera, Parameter, Photo, sigmas
from ..errors import InputError, Problem
from ..models.rolling_shutter import MOTION, Readout
from ..models.unknown_registry import VariableKind, unknown_kind
from ..observations.photo_motions import PhotoShift, PhotoTurn
from .construction import problems_of_times, required

KIND = "photo_motion"
"""Kind of unknowns of motions."""


class PhotoMotions:
    """Part of a network: what its photos have of their own besides a pose, such as a motion."""

    photos: dict[str, Photo]
    """Photos by name."""
    cameras: dict[str, Camera]
    """Cameras by name."""
    parameters: dict[VariableKind, dict[Any, Parameter]]
    """Unknowns by kind and name."""
    add: Any
    """Adds observations, see `Network.add`."""
    of_kind: Any
    """Returns the stated unknowns of a kind by key."""
    set_unknown: Any
    """States an unknown of any kind."""

    def add_strip_motions(
        self,
        times: Mapping[str, float],
        *,
        sigma_velocity: float | Sequence[float],
        sigma_rate: float | Sequence[float],
    ) -> list[str]:
        """Tie the motions of the photos of a strip to their neighbours; return the ids of the ties.

        The velocity of a photo is that from the photo before it to the photo after it, and so is
        its turn; at the ends of the strip the photo itself is one of both. Each photo gets a
        `PhotoShift` and a `PhotoTurn`, and a free motion if it has none yet. Call it for each
        strip: between strips the platform turns round.

        Args:
            times: time of exposure of each photo of the strip, in any order, in the unit of the
                camera's readout time: seconds, which need the true readout time.
            sigma_velocity: standard deviation of the difference of a velocity from that between the
                neighbours, m/s: one, or three along the axes of the network.
            sigma_rate: the same of the turn, rad/s: one, or three about the axes of the camera.

        Raises:
            InputError: fewer than two photos, one that is unknown or whose camera has no readout
                time, times that are equal or not finite, standard deviations that are not greater
                than zero. All photos are named, and nothing is added.
        """
        where = "motions of a strip"
        problems = problems_of_times(times, self.photos, where)
        velocity = sigmas(sigma_velocity, 3, f"sigma_velocity of the {where}")
        rate = sigmas(sigma_rate, 3, f"sigma_rate of the {where}")
        if len(times) < 2:
            problems.append(Problem(f"a strip has two photos or more, not {len(times)}", where))
        if problems:
            raise InputError(problems)
        order = sorted(times, key=lambda f: times[f])
        for f, after in pairwise(order):
            if times[f] == times[after]:
                what = f"has the time of photo {after!r}, {times[f]!r} s: photos of a strip differ"
                problems.append(Problem(what, f"photo {f!r}"))
        for f in order:
            try:
                self.check_readout(f, f"motion of photo {f!r}")
            except InputError as error:
                problems += error.problems
        if problems:
            raise InputError(problems)
        ties = []
        for i, f in enumerate(order):
            first, last = order[max(i - 1, 0)], order[min(i + 1, len(order) - 1)]
            interval = float(times[last] - times[first])
            for kind, given in ((PhotoShift, velocity), (PhotoTurn, rate)):
                x, y, z = (s * interval for s in given)
                ties.append(kind(f, first, last, interval=interval, sigma=(x, y, z)))
        for f in order:
            if f not in self.of_kind(KIND):
                self.set_unknown(KIND, f)
        return list(self.add(*ties))

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

    def readouts(self) -> dict[str, Readout]:
        """Return the times of the rows of the cameras whose photos move, by camera.

        Raises:
            InputError: photos that are not there, cameras without a readout time, and photos of one
                camera whose motions differ in their highest power, as they share its equations.
        """
        out: dict[str, Readout] = {}
        first: dict[str, str] = {}
        problems = []
        for photo, motion in self.of_kind(KIND).items():
            where = f"motion of photo {photo!r}"
            self.check_readout(photo, where)
            camera = self.photos[photo].camera
            readout, size = self.cameras[camera].times(), len(motion.values)
            assert readout is not None
            powers, rest = divmod(size, MOTION)
            if rest:
                what = f"it has {size} components, and {MOTION} for each power of t are needed"
                problems.append(Problem(what, where))
            known = out.setdefault(camera, replace(readout, components=size))
            if known.components != size and not rest:
                what = (
                    f"it has powers of t up to {powers}, and that of photo {first[camera]!r} of "
                    f"the same camera up to {known.components // MOTION}: state as many of both"
                )
                problems.append(Problem(what, where))
            first.setdefault(camera, photo)
        if problems:
            raise InputError(problems)
        return out

    def refuse_motions(self, photos: Iterable[str], what: str) -> None:
        """Refuse photos that have a motion; ``what`` needs one pose for all rows of a photo."""
        moving = [f for f in photos if self.of_photo(f)]
        if moving:
            reason = (
                f"{what} takes the rows of a photo as exposed at the same time, and has no motion "
                "of a photo during its readout; network.of_kind('photo_motion') has the motions"
            )
            raise InputError(Problem(reason, f"photo {f!r}") for f in moving)
