"""What a network observes of places in frames of their own, one row for each place in a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..models.frame_sights import place_of_sight
from ..models.terrestrial import direction_in_face_one, zenith_in_face_one
from ..models.variables import UNKNOWNS
from ..observations import KINDS
from ..stochastic import StandardDeviation
from ..types import Array, Index, Mask

SIGHTED = ("direction", "zenith", "distance")
"""What sights tell of a place, in the order of the columns of `Sights.value`."""


@dataclass(frozen=True)
class Sights:
    """Places that instruments sight in their frames, each once in a frame."""

    frame: Index
    """Number of the frame, (n,)."""
    point: Index
    """Number of the point, (n,)."""
    value: Array
    """Direction, zenith angle and distance, NaN where one was not observed, (n, 3)."""
    sigma: Array
    """Their standard deviations, (n, 3)."""

    @property
    def whole(self) -> Mask:
        """Places of which direction, zenith angle and distance are known, (n,)."""
        return np.asarray(np.isfinite(self.value).all(axis=1))

    @cached_property
    def unit(self) -> Array:
        """Unit vectors in the axes of the frames, NaN without direction or zenith angle, (n, 3)."""
        direction, zenith, _ = self.value.T
        return place_of_sight(direction, zenith, np.ones(len(direction)))

    @cached_property
    def q(self) -> Array:
        """Places in the frames, unit of the frame; NaN where not all three are known, (n, 3)."""
        return place_of_sight(*self.value.T)

    @property
    def spread(self) -> Array:
        """Root mean square of the standard deviations of ``q`` along its three axes, (n,)."""
        _, zenith, distance = self.value.T
        across = self.sigma * np.stack(
            [np.abs(distance * np.sin(zenith)), distance, np.ones(len(zenith))], axis=1
        )
        return np.asarray(np.sqrt(np.mean(across**2, axis=1)))


@dataclass(frozen=True)
class InFrames:
    """Places that are observed in frames, one row for each."""

    frame: Index
    """Number of the frame, (n,)."""
    point: Index
    """Number of the point, −1: a photo, (n,)."""
    photo: Index
    """Number of the photo, −1: a point, (n,)."""
    q: Array
    """Observed coordinates, unit of the frame; NaN for axes that were not observed, (n, 3)."""
    given: Array
    """Given values of the components of every frame, NaN where they are to be found, (f, 7)."""
    free: Mask
    """Whether each component of every frame is free, (f, 7)."""
    origin: Index
    """Number of the point at the origin of every frame, −1: it is a constant, (f,)."""
    sights: Sights
    """Sights; those of which all is known stand in ``q`` too."""


def read_frames(equations: Equations) -> InFrames:
    """Return the places that a network observes in frames."""
    table, network = equations.unknowns["frame"], equations.network
    stated = network.frames.values()
    given = np.array([p.values for p in stated], dtype=float).reshape(-1, UNKNOWNS["frame"].size)
    number = equations.unknowns["point"].number
    origin = np.array([number.get(p.origin, -1) for p in stated], dtype=np.intp)
    every: list[tuple[Index, Index, Index, Array]] = []
    for block in equations.blocks:
        if block.prior or _told(block) != "coordinates":
            continue
        index = dict(block.variables[:2])
        nowhere = np.full(block.n, -1, dtype=np.intp)
        q = np.full((block.n, 3), np.nan)
        q[:, ["xyz".index(a) for a in block.components]] = block.observed
        every.append((index["frame"], index.get("point", nowhere), index.get("pose", nowhere), q))
    sights = read_sights(equations)
    on = np.flatnonzero(sights.whole)
    every.append((sights.frame[on], sights.point[on], np.full(len(on), -1), sights.q[on]))
    frame, point, photo, q = (np.concatenate(c) for c in zip(*every, strict=True))
    return InFrames(frame, point, photo, q, given, table.free, origin, sights)


def read_sights(equations: Equations) -> Sights:
    """Return the sights of a network in frames; of repeated ones the first."""
    n_points = max(len(equations.unknowns["point"].names), 1)
    found: list[_Told] = []
    for block in equations.blocks:
        what = _told(block)
        if block.prior or what not in SIGHTED:
            continue
        (_, frame), (_, point) = block.variables[:2]
        value = _in_face_one(equations, block, what)
        code, first = np.unique(frame * n_points + point, return_index=True)
        found.append(_Told(block, SIGHTED.index(what), code, first, value[first]))
    if not found:
        nothing = np.zeros(0, dtype=np.intp)
        return Sights(nothing, nothing, np.zeros((0, 3)), np.zeros((0, 3)))
    every = np.unique(np.concatenate([t.code for t in found]))
    values, sigmas = np.full((2, len(every), 3), np.nan)
    for told in reversed(found):  # the first of several blocks is written last
        values[np.searchsorted(every, told.code), told.column] = told.value
    q = place_of_sight(*values.T)
    for told in reversed(found):
        row = np.searchsorted(every, told.code)
        sigmas[row, told.column] = _sigmas(equations, told, q[row])
    frame, point = np.divmod(every, n_points)
    return Sights(frame.astype(np.intp), point.astype(np.intp), values, sigmas)


@dataclass(frozen=True)
class _Told:
    """What a block of sights tells, each place once."""

    block: Block
    column: int
    """Column of `Sights.value`."""
    code: Index
    """Frame and point as one number, (m,)."""
    rows: Index
    """Numbers of the observations, (m,)."""
    value: Array
    """Values in face 1, (m,)."""


@dataclass(frozen=True)
class _Sighted:
    """Lengths on which the variances of sights depend, from the sights themselves."""

    observed: Array
    """Observed values, (m,)."""
    q: Array
    """Targets in their frames, (m, 3)."""

    def sight(self, target: str = "target") -> Array:
        """Return the lines from the instruments, (m, 3)."""
        return self.q

    def number(self, attribute: str) -> Array:
        """Return no number: sights have none."""
        return np.full(len(self.q), np.nan)


def _sigmas(equations: Equations, told: _Told, q: Array) -> Array:
    """Return the standard deviations of sights to targets q (m, 3), NaN where q is not known."""
    block = told.block
    out = np.array(block.sigma[told.rows, 0])
    weight = KINDS[block.kind].weight
    observations = equations.network.observations
    stated = [observations[block.ids[i]].sigma for i in told.rows.tolist()]  # type: ignore[attr-defined]
    parts = np.array([isinstance(s, StandardDeviation) for s in stated], dtype=bool)
    if weight is None or not parts.any():
        return out
    rows = np.flatnonzero(parts)
    geometry = _Sighted(told.value[rows], q[rows])
    out[rows] = np.sqrt(weight.variance([stated[i] for i in rows.tolist()], geometry))
    return out


def _told(block: Block) -> str:
    """Return what a block tells of places in frames."""
    record = KINDS.get(block.kind)
    return "nothing" if record is None else record.tells


def _in_face_one(equations: Equations, block: Block, what: str) -> Array:
    """Return readings as in face 1, those of distance meters with known constants corrected."""
    value = block.observed[:, 0]
    if what == "distance":
        kind, number = block.variables[-1]
        scale, zero = equations.unknowns[kind].values[number].T
        return np.asarray((value - zero) / (1.0 + scale))
    face = block.constants["face"]
    convert = direction_in_face_one if what == "direction" else zenith_in_face_one
    return convert(value, face)
