"""What a network knows of the frame: coordinates of points and photos, attitudes, lengths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..approximate.vectors import known_attitudes
from ..graph.equations import Equations
from ..graph.variables import DEFAULT, State
from ..observations import (
    ControlPoint,
    GnssVector,
    PhotoBase,
    PhotoPosition,
    RelativePosition,
    SlopeDistance,
)
from ..types import Array


@dataclass(frozen=True, eq=False)
class Known:
    """Known coordinates and attitudes, NaN where unknown."""

    point: Array
    """Points, (points, 3), metres."""
    pose: Array
    """Stored poses, (photos, 12)."""

    def filled(self, state: State) -> Known:
        """Return the same with values of a state where nothing is known."""
        return Known(
            np.where(np.isnan(self.point), state["point"], self.point),
            np.where(np.isnan(self.pose), state["pose"], self.pose),
        )


@dataclass(frozen=True)
class Length:
    """A known length between two points or two photos."""

    between: str
    """``"point"`` or ``"pose"``."""
    ends: tuple[int, int]
    """Numbers of both ends."""
    value: float
    """Length, metres."""


def without_approximations(equations: Equations) -> Equations:
    """Return the network with no values of photos and points but held and weighted ones."""
    unknowns = equations.unknowns
    values, rough = unknowns.start(), unknowns.rough()
    for kind in ("point", "pose"):
        values[kind] = np.where(rough[kind], np.nan, values[kind])
    return replace(equations, unknowns=unknowns.starting_at(values))


def given(equations: Equations) -> Known:
    """Return what is given: coordinates of points and photos, control, positions and attitudes."""
    state, unknowns = equations.unknowns.start(), equations.unknowns
    point, pose = state["point"], state["pose"]
    for o in equations.network.observations.values():
        if isinstance(o, ControlPoint):
            row = unknowns["point"].number[o.point]
            horizontal = set(o.axes) <= set("enu")
            if horizontal and len(o.axes) < 3:
                continue  # no component of the frame alone
            for axis, value in zip("xyz" if horizontal else o.axes, o.value, strict=True):
                point[row, "xyz".index(axis)] = value
        elif isinstance(o, PhotoPosition):
            row = unknowns["pose"].number[o.photo]
            for axis, value in zip(o.axes, o.value, strict=True):
                i = 9 + "xyz".index(axis)
                pose[row, i] = value if np.isnan(pose[row, i]) else pose[row, i]
    known_attitudes(equations, pose)
    return Known(point, pose)


def lengths(equations: Equations) -> Iterator[Length]:
    """Iterate over known lengths: distances, GNSS vectors, and bases between photos, of rigs too.

    Horizontal distances are among them: the scale is where a fit begins.
    """
    unknowns = equations.unknowns
    mounts = unknowns["mount"]
    for o in equations.network.observations.values():
        if isinstance(o, SlopeDistance) and o.value > 0:
            number = unknowns["point"].number
            yield Length("point", (number[o.station], number[o.target]), float(o.value))
        elif isinstance(o, GnssVector):
            number, size = unknowns["point"].number, float(np.linalg.norm(o.value))
            if size > 0:
                yield Length("point", (number[o.station], number[o.target]), size)
        elif isinstance(o, PhotoBase) and o.value > 0:
            number = unknowns["pose"].number
            yield Length("pose", (number[o.photo], number[o.photo2]), float(o.value))
        elif isinstance(o, RelativePosition) and o.instrument is None:
            vector = np.array(o.value, dtype=float)
            if o.mount is not None:
                vector = vector + mounts.values[mounts.number[o.mount or DEFAULT], 9:12]
            size = float(np.linalg.norm(vector))
            if size > 0 and np.isfinite(size):
                number = unknowns["pose"].number
                yield Length("pose", (number[o.photo], number[o.photo2]), size)
