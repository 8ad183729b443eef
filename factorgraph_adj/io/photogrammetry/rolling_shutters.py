"""Motions of photos during the readout, as files state them, and what readers make of them.

Files state how far a camera moves and turns while a rolling shutter reads its sensor, not how fast,
since image points tell no time: a shift in metres and a turn in radians, from the middle row to the
last one (half the readout) or from the first row to the last one (the whole readout), where the
first row is the upper one. With the readout time T the motion of a photo is v = shift/T and
ω = turn/T of the whole readout, with the other sign if the last row is read first; its pose is that
of the middle row, see `models.rolling_shutter`.

A motion that is read or estimated is a weighted unknown: the a priori value of the shift during the
whole readout is that of the file, or zero, with a standard deviation of one metre unless another is
stated, so that it decides only what image points do not determine. It is free where too few
positions determine scale and orientation of the network: a weight about zero would shrink the
network, and shifts turn with it.

With `estimate`, turns are unknown with ± ``sigma_turn`` (0.01 rad). With `half readout` and
`whole readout` they are held if no photo of the file turns, as in OPF; ``sigma_turn=0`` holds them
in every case.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

import numpy as np

from ...errors import InputError, known
from ...models.rolling_shutter import TOWARDS, UNKNOWN_READOUT, Towards
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition, PointDirection
from ...types import Array
from ..source import LeftOutReason, Problems

RollingShutter: TypeAlias = Literal[
    "refuse", "half readout", "whole readout", "estimate", "leave out"
]
"""What becomes of the motions of photos during the readout:

``refuse``: a file with motions is an error.
``half readout``, ``whole readout``: the motion in the file covers half or all of the readout; it is
the a priori value of an estimated motion.
``estimate``: as these, with a priori value zero.
``leave out``: no motion; the pose is that of the middle row.
"""
READOUT_PARTS = {"half readout": 2.0, "whole readout": 1.0}
"""Shift and turn of the whole readout by those of the part that a file states."""
ALONG_ROWS: Mapping[Towards, float] = MappingProxyType({"down": 1.0, "up": -1.0})
"""Sides to which rows are read one after the other, and the sign of times from the first row."""
MOTIONS_LEFT_OUT = LeftOutReason(
    "motions of photos during the readout", "rolling_shutter='leave out' keeps the poses alone"
)
SHIFTS, TURNS = ("x_t", "y_t", "z_t"), ("rx_t", "ry_t", "rz_t")
"""Names of the components of a motion."""
SIGMA_TURN = 0.01
"""Standard deviation of the turn during the readout, radians: 0.3 rad/s for 33 ms."""


@dataclass(frozen=True)
class ShutterOptions:
    """Options of readers about rolling shutters."""

    choice: RollingShutter
    """What becomes of motions."""
    readout: float | None = None
    """Readout time of the whole sensor, seconds; None: unknown, 1 s stands for it."""
    readout_towards: Towards = "down"
    """Side of the image to which the readout proceeds."""
    sigma_shift: float = 1.0
    """Standard deviation of the shift during the whole readout, metres."""
    sigma_turn: float | None = None
    """Standard deviation of the turn during it, radians; 0: held; None: `SIGMA_TURN`, or held where
    motions of the file are taken and no photo turns."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            InputError: a word that is none, or a number that is not greater than zero.
        """
        for name, word, words in (
            ("rolling_shutter", self.choice, get_args(RollingShutter)),
            ("readout_towards", self.readout_towards, TOWARDS),
        ):
            if word not in words:
                raise InputError(f"unknown {name} {word!r}; valid: {known(words, meant=word)}")
        for name, least in (("readout", "> 0"), ("sigma_shift", "> 0"), ("sigma_turn", "≥ 0")):
            value = getattr(self, name)
            right = value is None or (math.isfinite(value) and value >= 0)
            if not right or (value == 0 and least == "> 0"):
                raise InputError(f"{name} must be {least}, not {value}")

    @property
    def models_motions(self) -> bool:
        """Whether photos get motions."""
        return self.choice == "estimate" or self.choice in READOUT_PARTS

    @property
    def seconds(self) -> float:
        """Readout time, seconds; 1 s where it is unknown: motions are those of the readout."""
        return UNKNOWN_READOUT if self.readout is None else self.readout


@dataclass
class ShutterMotions:
    """Motions of the photos of a file while it is read."""

    options: ShutterOptions
    """What becomes of them."""
    network: Network
    """Network of the photos."""
    problems: Problems
    """Where problems go."""
    unsaid: str = ""
    """What the format does not say about its motions."""
    read_by_row: list[str] = field(default_factory=list)
    """Cameras of which the file says that they have a rolling shutter."""
    stated: dict[str, Array] = field(default_factory=dict)
    """Shift and turn, (6,), of the photos of which the file states a motion."""
    first: str = ""
    """Place of the first of them."""

    def add(self, photo: str, where: str, shift: Array, turn: Array) -> None:
        """Take the motion that a file states of a photo of the network.

        Args:
            photo: name of the photo.
            where: its place.
            shift: shift of the part of the readout that the file means, (3,) metres, network axes.
            turn: turn of it about the axes of the camera, x right, y down, z forward, (3,) radians.
        """
        self.first = self.first or where
        self.stated[photo] = np.concatenate([shift, turn])
        if self.options.choice == "leave out":
            self.problems.leave_out(MOTIONS_LEFT_OUT, photo, where)

    def finish(self) -> None:
        """State readouts and motions; refuse those of unknown meaning; remark what was assumed.

        To be called when the network has all its observations: those of positions
        decide whether velocities have weights.
        """
        choice = self.options.choice
        if self.stated and choice == "refuse":
            what = (
                f"photo {next(iter(self.stated))!r} moves during the readout of a rolling shutter "
                f"(photos that move: {len(self.stated)}); {self.unsaid}; valid: "
                "rolling_shutter='estimate' (the adjustment finds the motions), 'half readout' or "
                "'whole readout' (the motion of the file is that from the middle row, or from the "
                "first one, to the last one), 'leave out' (no motion: photos are exposed at one "
                "moment)"
            )
            self.problems.wrong(what, self.first)
        if self.read_by_row and not self.stated and choice != "estimate":
            names = known(self.read_by_row)
            self.problems.remarks.append(
                f"cameras with a rolling shutter whose photos have no motion: {names}; "
                "rolling_shutter='estimate' lets the adjustment find it"
            )
        if choice in READOUT_PARTS and self.stated:
            sign = ALONG_ROWS.get(self.options.readout_towards)
            if sign is None:
                what = "motions of the file are those from row to row; valid: readout_towards="
                self.problems.wrong(what + " or ".join(map(repr, ALONG_ROWS)), self.first)
                return
            factor = sign * READOUT_PARTS[choice]
            self._state({p: factor * m for p, m in self.stated.items()})
        elif choice == "estimate":
            photos = self.network.photos
            rolling = {photos[p].camera for p in self.stated} | set(self.read_by_row)
            self._state(
                {n: np.zeros(6) for n, p in photos.items() if p.camera in rolling or not rolling}
            )

    def _state(self, motions: Mapping[str, Array]) -> None:
        """State shift and turn of the whole readout, (6,) by photo, and the readout of cameras."""
        if not motions:
            return
        network, options, seconds = self.network, self.options, self.options.seconds
        for name in {network.photos[p].camera for p in motions}:
            network.cameras[name] = replace(
                network.cameras[name], readout=seconds, readout_towards=options.readout_towards
            )
        zero = options.choice == "estimate"
        settled = self._datum_is_known()
        deviations = dict.fromkeys(SHIFTS, options.sigma_shift / seconds) if settled else {}
        turning = self._sigma_turn()
        if turning:
            deviations |= dict.fromkeys(TURNS, turning / seconds)
        held = () if turning else TURNS
        for photo, whole in motions.items():
            network.set_unknown(
                "photo_motion", photo, (whole / seconds).tolist(), fixed=held, sigma=deviations
            )
        begins = "zero" if zero else f"that of the file ({options.choice})"
        weight = f" ± {options.sigma_shift:g} m"
        if not settled:
            weight = ", free, as scale or orientation of the network may be open"
        turned = f"± {turning:g} rad" if turning else "held"
        said = (
            f"photos that move during the readout: {len(motions)}; shift of the readout: "
            f"{begins}{weight}, turn: {turned}"
        )
        if options.readout is None:
            said += "; its time is unknown: motions are those of the whole readout (1 s)"
        self.problems.remarks.append(said)

    def _datum_is_known(self) -> bool:
        """Return whether three positions, or two and a direction, state scale and orientation.

        A distance alone does not do: rows of velocities that are not zero change with a turn, so
        that weights about zero would take part in the datum of a free network.
        """
        positions = self._positions()
        return positions >= 3 or (positions == 2 and self._has_direction())

    def _positions(self) -> int:
        """Return how many photos, and points in photos, have observed positions."""
        observations = self.network.observations.values()
        points = {o.point for o in observations if isinstance(o, ControlPoint)} & self._seen()
        return len(points) + len({o.photo for o in observations if isinstance(o, PhotoPosition)})

    def _has_direction(self) -> bool:
        """Return whether the direction between two points in photos is observed."""
        seen, observations = self._seen(), self.network.observations.values()
        return any(
            isinstance(o, PointDirection) and seen.issuperset(o.points()) for o in observations
        )

    def _seen(self) -> set[str]:
        """Return the points that photos see."""
        names = list(self.network.points)
        return {names[i] for i in set(self.network.images.columns()[1].tolist())}

    def _sigma_turn(self) -> float:
        """Return the standard deviation of the turn during the readout, radians; 0: held."""
        if self.options.sigma_turn is not None:
            return self.options.sigma_turn
        turns = self.options.choice == "estimate" or any(m[3:].any() for m in self.stated.values())
        return SIGMA_TURN if turns else 0.0
