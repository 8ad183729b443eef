"""Readings from stations to targets as rows: values, partials, to other targets; target heights."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from ...errors import InputError
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...graph.variables import State
from ...models.base import wrap
from ...observations import observation_kind
from ...observations.registry import TOTAL_STATION_QUANTITIES, Quantity
from ...types import Array, Index, Mask

HEIGHT_STEP_M = 0.005
"""Step of the central differences by heights of instruments and targets, metres."""
TARGET_HEIGHT = "target_height"
"""Name of the height of the target, of models and of observations."""
ONE_TARGET = TOTAL_STATION_QUANTITIES - {"horizontal angle"}
"""Quantities of readings to one target with a total station."""


_Target = TypeVar("_Target", int, str)


@dataclass(frozen=True)
class Readings:
    """Scalar rows of all observations with a station and a target; arrays (m,)."""

    equations: Equations
    """The observation equations."""
    state: State
    """Values of all variables."""
    row: Index
    """Number of the scalar row."""
    block: Index
    """Place of the block."""
    number: Index
    """Number of the observation in its block."""
    component: Index
    """Number of the component in the observation."""
    quantity: Array
    """Quantity of the observation, text, see `factorgraph_adj.observations.registry.Quantity`."""
    station: Index
    """Number of the station."""
    target: Index
    """Number of the target."""

    @classmethod
    def of(cls, equations: Equations, state: State) -> Readings:
        """Return the readings of a network."""
        parts: list[tuple[Index, ...]] = []
        quantities: list[str] = []
        for here, block in enumerate(equations.blocks):
            at = station_and_target(block)
            if at is None:
                continue
            n, d = block.observed.shape
            number, component = (x.ravel() for x in np.mgrid[:n, :d])
            parts.append(
                (
                    np.arange(block.rows.start, block.rows.stop),
                    np.full(n * d, here),
                    number,
                    component,
                    block.arguments[at[0]][1][number],
                    block.arguments[at[1]][1][number],
                )
            )
            quantities += [block.quantity] * (n * d)
        if not parts:
            none = np.zeros(0, dtype=np.intp)
            return cls(equations, state, none, none, none, none, np.array([], str), none, none)
        row, place, number, component, station, target = (
            np.concatenate(x) for x in zip(*parts, strict=True)
        )
        return cls(
            equations, state, row, place, number, component, np.array(quantities), station, target
        )

    def only(self, keep: Mask | Index) -> Readings:
        """Return some of the rows, in that order."""
        arrays = ("row", "block", "number", "component", "quantity", "station", "target")
        return replace(self, **{a: getattr(self, a)[keep] for a in arrays})

    def of_quantities(self, quantities: Collection[Quantity]) -> Readings:
        """Return the rows of some quantities."""
        return self.only(np.isin(self.quantity, list(quantities)))

    def parts(self) -> Iterator[tuple[Block, Index]]:
        """Iterate over the blocks with rows, and the places of their rows, (k,)."""
        for place in np.unique(self.block).tolist():
            yield self.equations.blocks[place], np.flatnonzero(self.block == place)

    def constant(self, name: str) -> Array:
        """Return a constant of the model at each row; 0 where a kind does not have it."""
        out = np.zeros(len(self.row))
        for block, at in self.parts():
            if name in block.constants:
                out[at] = block.constants[name][self.number[at]]
        return out

    def variable(self, kind: str) -> Index:
        """Return the number of the variable of a kind that each row touches; −1: none."""
        out = np.full(len(self.row), -1, dtype=np.intp)
        for block, at in self.parts():
            for what, index in block.variables:
                if what == kind:
                    out[at] = index[self.number[at]]
        return out

    @cached_property
    def computed(self) -> Array:
        """Computed values f(x); angles as near to the observed ones as they can be; NaN: none."""
        out = np.empty(len(self.row))
        for block, at in self.parts():
            v = self._residuals(block.select(self.number[at]))
            out[at] = v[np.arange(len(at)), self.component[at]] + self.observed[at]
        return out

    @cached_property
    def observed(self) -> Array:
        """Observed values l."""
        out = np.empty(len(self.row))
        for block, at in self.parts():
            out[at] = block.observed[self.number[at], self.component[at]]
        return out

    def _residuals(self, block: Block) -> Array:
        """Return residuals (n, d); NaN where a value is unknown or the geometry is degenerate."""
        out = np.full(block.observed.shape, np.nan)
        fine = np.ones(block.n, dtype=bool)
        for kind, index in block.variables:
            fine &= np.isfinite(self.state[kind][index]).all(axis=1)
        frame, rows = self.equations.network.frame, np.flatnonzero(fine)
        if not len(rows):
            return out
        try:
            out[rows] = block.select(rows).evaluate(frame, self.state, jacobians=False).residual
        except InputError:  # some are degenerate: one by one
            for row in rows:
                with suppress(InputError):
                    one = block.select(np.array([row]))
                    out[row] = one.evaluate(frame, self.state, jacobians=False).residual[0]
        return out

    def by_constant(self, name: str) -> Array:
        """Return ∂f by a constant of the model, by central differences."""
        out, frame = np.zeros(len(self.row)), self.equations.network.frame
        for block, at in self.parts():
            if name not in block.constants:
                continue
            ends = []
            for step in (HEIGHT_STEP_M, -HEIGHT_STEP_M):
                moved = {**block.constants, name: block.constants[name] + step}
                ends.append(replace(block, constants=moved).evaluate(frame, self.state).residual)
            change = _difference(block, *ends) / (2 * HEIGHT_STEP_M)
            out[at] = change[self.number[at], self.component[at]]
        return out

    def by_unknown(self, kind: str) -> Array:
        """Return ∂f by the first component of a kind of unknown of the model; 0: it has none."""
        out, frame = np.zeros(len(self.row)), self.equations.network.frame
        for block, at in self.parts():
            one = block.by_role()
            for place, (what, _) in enumerate(one.variables):
                if what == kind:
                    partials = one.evaluate(frame, self.state).jacobians[place][:, :, 0]
                    out[at] += partials[self.number[at], self.component[at]]
        return out

    def by_end(self, end: str) -> Array:
        """Return ∂f by the position of the station or the target, east and north, (m, 2)."""
        out, frame = np.zeros((len(self.row), 2)), self.equations.network.frame
        for block, at in self.parts():
            ends = station_and_target(block)
            assert ends is not None
            which = ends[0 if end == "station" else 1]
            index = block.arguments[which][1]
            basis = frame.basis(self.state["point"][index], np.zeros((block.n, 2)))
            jacobian = block.by_role().evaluate(frame, self.state).jacobians[which]
            change = np.einsum("ndi,nji->ndj", jacobian, basis.enu[:, :2])
            out[at] = change[self.number[at], self.component[at]]
        return out

    def with_targets(self, targets: Index, heights: Array) -> Array:
        """Return f − f(x) of the rows if they had been read to other targets; NaN: degenerate.

        Angles are changes of at most half a circle.

        Args:
            targets: numbers of the other targets, (m,).
            heights: heights of the targets there, (m,) metres; without effect on kinds that have
                none.
        """
        out = np.full(len(self.row), np.nan)
        for block, at in self.parts():
            ends = station_and_target(block)
            assert ends is not None
            part = block.select(self.number[at]).by_role()
            before = self._residuals(part)
            variables = list(part.variables)
            old = variables[ends[1]][1]
            vertical = vertical_place(block, ends[1])
            variables[ends[1]] = ("point", targets[at])
            if vertical is not None:
                names = self.equations.unknowns["point"].names
                of = self.equations.unknowns["vertical"].number
                new = [of.get(names[t], of.get("", 0)) for t in targets[at].tolist()]
                variables[vertical] = ("vertical", np.array(new, dtype=np.intp))
            constants = dict(part.constants)
            if TARGET_HEIGHT in constants:
                constants[TARGET_HEIGHT] = heights[at]
            other = replace(part, variables=tuple(variables), constants=constants)
            fine = (targets[at] != self.station[at]) & (targets[at] != old)
            fine &= np.isfinite(self.state["point"][targets[at]]).all(axis=1)
            if not fine.any():
                continue
            rows = np.flatnonzero(fine)
            change = _difference(block, self._residuals(other.select(rows)), before[rows])
            out[at[rows]] = change[np.arange(len(rows)), self.component[at[rows]]]
        return out


def station_and_target(block: Block) -> tuple[int, int] | None:
    """Return the places of station and target among the variables; None: it has none."""
    if block.prior or block.lens is not None or block.model is None or block.by_axis:
        return None
    named = observation_kind(block.kind).variables
    places = {a: j for j, (kind, a) in enumerate(named) if kind == "point"}
    if "station" not in places or "target" not in places:
        return None
    return places["station"], places["target"]


def vertical_place(block: Block, end: int) -> int | None:
    """Return the place of the vertical at one of the ends."""
    named = observation_kind(block.kind).variables
    attribute = named[end][1]
    found = [j for j, (kind, a) in enumerate(named) if kind == "vertical" and a == attribute]
    return found[0] if found else None


def _difference(block: Block, a: Array, b: Array) -> Array:
    """Return a − b; of angles the shorter way round."""
    change = a - b
    if block.unit == "rad":
        change = wrap(change)
    return np.asarray(change)


def most_recorded_heights(
    recorded: Iterable[tuple[_Target, float]],
) -> dict[_Target, tuple[float, ...]]:
    """Return the heights that are recorded with each target, those most recorded first."""
    counts: dict[_Target, Counter[float]] = defaultdict(Counter)
    for target, height in recorded:
        counts[target][height] += 1
    return {t: tuple(h for h, _ in c.most_common()) for t, c in counts.items()}
