"""Places in frames of a solution: instruments, and what lies in frames, with their precision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...graph.blocks import Block
from ...models.axes import Axis, axis_of
from ...models.sub_frame import split_frame
from ...models.variables import VariableKind
from ...observations.registry import KINDS, ObservationKind
from ...solve.singular import SingularError
from ...solve.solution import Solution
from ...types import Array, Index

ORIGIN = ".origin"
"""End of the names of variables that stand at the origin of a frame."""


def record_of(block: Block) -> ObservationKind | None:
    """Return the record of the observations of a block; None for given values."""
    return None if block.prior or not block.named else KINDS.get(block.kind)


def variables_of(block: Block) -> dict[tuple[VariableKind, str], Index]:
    """Return the numbers of the variables of a block, by kind and attribute."""
    pairs = zip(block.arguments, block.named, strict=True)
    return {(kind, attribute): numbers for (kind, numbers), attribute in pairs}


def points_of(block: Block) -> Index:
    """Return the first point of each observation that is not the origin of its frame, (n,)."""
    return next(
        i for (k, a), i in variables_of(block).items() if k == "point" and not a.endswith(ORIGIN)
    )


@dataclass(frozen=True, eq=False)
class FramePlaces:
    """Frames of a solution."""

    solution: Solution
    """The solution."""

    def axes(self, frame: int, q: Array, *, axis: int = 2) -> Axis:
        """Return the places X of coordinates q (k, 3) in a frame as `Axis.zero`, and its axis.

        X = O + Eᵀ e^ℓ R (q + c): q is the zero place of the frame with the offset q + c.
        """
        state, k = self.solution.state, len(q)
        stored = np.repeat(state["frame"][frame][None], k, axis=0)
        stored[:, 9:12] += q
        point, vertical = self._at(frame)
        return axis_of(
            self.solution.network.frame,
            stored,
            None if point is None else np.repeat(state["point"][point][None], k, axis=0),
            None if vertical is None else np.repeat(state["vertical"][vertical][None], k, axis=0),
            axis=axis,
        )

    def places(self, frame: int, q: Array) -> Array:
        """Return the places (k, 3) of coordinates q (k, 3) in a frame, metres."""
        return self.axes(frame, q).zero

    def coordinates(self, frame: int, places: Array) -> Array:
        """Return the coordinates q (k, 3) of places (k, 3) in a frame."""
        ln_scale = split_frame(self.solution.state["frame"][frame][None]).ln_scale
        away = places - self.places(frame, np.zeros((1, 3)))
        return np.asarray(np.exp(-ln_scale[0]) * away @ self.rotation(frame))

    def rotation(self, frame: int) -> Array:
        """Return the unit vectors of the axes of a frame in those of the network, as columns."""
        zero = np.zeros((1, 3))
        return np.stack([self.axes(frame, zero, axis=i).d[0] for i in range(3)], axis=1)

    def up(self, frame: int, near: Array) -> Array:
        """Return the vertical of a frame in its axes, (3,): that at its origin if it is level.

        Other frames take that of a place ``near`` (3,), as their origin may be anywhere.
        """
        stored = self.solution.state["frame"][frame]
        point, vertical = self._at(frame)
        at = stored[13:16] if point is None else self.solution.state["point"][point]
        angles = np.zeros(2) if vertical is None else self.solution.state["vertical"][vertical]
        at = at if stored[16] else near
        up = self.solution.network.frame.basis(at[None], angles[None]).enu[0, 2]
        return np.asarray(up @ self.rotation(frame))

    def covariances(self, frame: int, q: Array) -> Array:
        """Return the covariances (k, 3, 3) of places q of a frame, metres²."""
        names = self.solution.equations.unknowns
        point, vertical = self._at(frame)
        found = self.axes(frame, q)
        parts = [(("frame", names["frame"].names[frame]), found.zero_by[0])]
        if point is not None:
            parts.append((("point", names["point"].names[point]), found.zero_by[1]))
        if vertical is not None:
            parts.append((("vertical", names["vertical"].names[vertical]), found.zero_by[2]))
        out = np.zeros((len(q), 3, 3))
        for a, by_a in parts:
            for b, by_b in parts:
                block = self.solution.variable_covariance(a, None if a == b else b)
                out += by_a @ block @ by_b.transpose(0, 2, 1)
        return out

    def _at(self, frame: int) -> tuple[int | None, int | None]:
        """Return the numbers of the point and of the vertical at the origin of a frame."""
        point, vertical = (self._origins[kind][frame] for kind in ("point", "vertical"))
        return (None if point < 0 else int(point)), (None if vertical < 0 else int(vertical))

    @cached_property
    def _origins(self) -> dict[VariableKind, Index]:
        """Numbers of the points and verticals at the origins of the frames; −1: none."""
        n = len(self.solution.state["frame"])
        out = {kind: np.full(n, -1, dtype=np.intp) for kind in ("point", "vertical")}
        for block in self.solution.equations.blocks:
            if record_of(block) is None:
                continue
            variables = variables_of(block)
            for (kind, attribute), numbers in variables.items():
                own = attribute.removesuffix(ORIGIN)
                if own != attribute and ("frame", own) in variables:
                    out[kind][variables["frame", own]] = numbers
        return out

    @cached_property
    def instruments(self) -> Index:
        """Numbers of the frames in whose zero an instrument is set up, not over a point."""
        found: list[Index] = []
        for block in self.solution.equations.blocks:
            sighting = instrument_of(block)
            if sighting is not None and sighting[0] == "frame":
                found.append(sighting[1])
        return np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *found]))

    @cached_property
    def instrument_covariances(self) -> Array | None:
        """Covariances of the instruments, (f, 3, 3); None without regular normal equations."""
        zero = np.zeros((1, 3))
        try:
            found = [self.covariances(f, zero)[0] for f in self.instruments.tolist()]
        except SingularError:
            return None
        return np.array(found).reshape(-1, 3, 3)


def instrument_of(block: Block) -> tuple[VariableKind, Index] | None:
    """Return where the instruments of a block stand: over points, or in frames of their own.

    A frame whose origin is a point has its instrument over that point (forced centring).
    """
    record = record_of(block)
    if record is None or not record.instrument:
        return None
    variables = variables_of(block)
    for kind, attribute in (
        ("point", record.instrument),
        ("point", record.instrument + ORIGIN),
        ("frame", record.instrument),
    ):
        if (kind, attribute) in variables:
            return kind, variables[kind, attribute]
    return None
