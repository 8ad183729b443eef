"""CustomFactors of GTSAM: observations, held components; checks of shape and finiteness.

GTSAM does not check the output of a callback: a Jacobian that is unset, not two-dimensional or of
a wrong number of rows ends the process, and a NaN stops an optimiser without a message. Therefore
this module checks shapes and finiteness first. A callback holds only its observations and keys,
because a reference to its factor or graph would never be freed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import gtsam
import numpy as np

from ..errors import AdjustmentError
from ..frames import Frame
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..rotation import right_jacobian_inverse
from ..types import Array, Index, Mask
from .blocks import Block
from .keys import KeyMap, stored_row, to_gtsam
from .variables import State, Unknowns

Evaluation: TypeAlias = tuple[Array, list[Array]]
"""Residual (m,) and its partials (m, k) by each variable, GTSAM's tangent."""


def guarded(
    noise: gtsam.noiseModel.Base,
    keys: Sequence[int],
    sizes: Sequence[int],
    evaluate: Callable[[gtsam.Values, bool], Evaluation],
    label: Callable[[], str],
) -> gtsam.CustomFactor:
    """Return a CustomFactor whose residuals and partials are checked before GTSAM gets them.

    Args:
        noise: noise model; its dimension is the number of residuals.
        keys: keys of the variables.
        sizes: size of the tangent of each variable.
        evaluate: (values, whether to compute partials) → residuals and partials.
        label: function that returns the name of the factor for an error.
    """
    rows = noise.dim()

    def callback(
        this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        residual, partials = evaluate(values, jacobians is not None)
        if residual.shape != (rows,) or not np.isfinite(residual).all():
            raise AdjustmentError(f"{label()}: residual {residual} must be {rows} finite numbers")
        if jacobians is None:
            return residual
        for slot, size in enumerate(sizes):
            block = partials[slot]
            if block.shape != (rows, size) or not np.isfinite(block).all():
                raise AdjustmentError(
                    f"{label()}: partials by {gtsam.DefaultKeyFormatter(keys[slot])} must be "
                    f"{rows} × {size} finite numbers: {block}"
                )
        for slot, block in enumerate(partials):
            jacobians[slot] = np.ascontiguousarray(block, dtype=float)
        return residual

    return gtsam.CustomFactor(noise, list(keys), callback)


class Part(NamedTuple):
    """Observations of one block in a factor."""

    block: Block
    """The block, with all its observations."""
    chosen: Index
    """Numbers of the observations of the factor, (n,)."""
    rows: Index
    """Rows of the factor for the components of these observations, (n, d)."""


def observation_factor(
    frame: Frame,
    unknowns: Unknowns,
    state: State,
    parts: Sequence[Part],
    noise: gtsam.noiseModel.Base,
    keys: KeyMap,
) -> gtsam.CustomFactor:
    """Return the factor of one observation, or of observations with a joint covariance.

    The residuals come from the models that every other caller uses.

    Args:
        frame: frame of the network.
        unknowns: the variables; those without columns are constants.
        state: values of the constants.
        parts: the observations.
        noise: noise model of all rows.
        keys: keys of the variables.
    """
    evaluate = _Observations(frame, unknowns, state, parts, keys)
    return guarded(noise, evaluate.keys, evaluate.sizes, evaluate, evaluate.label)


class _Observations:
    """Residuals and partials of a few observations, from arrays of their variables only.

    The arrays are made at the first evaluation, so that a large graph is built quickly.
    """

    __slots__ = (
        *("_frame", "_given", "_held", "_local", "_parts", "_scales", "_variables"),
        *("keys", "sizes"),
    )

    def __init__(
        self,
        frame: Frame,
        unknowns: Unknowns,
        state: State,
        parts: Sequence[Part],
        keys: KeyMap,
    ) -> None:
        self._frame = frame
        self._given = state
        self._parts = parts
        self._local: _Local | None = None
        self._variables: list[tuple[VariableKind, int]] = []
        self._scales: list[Array | None] = []
        self._held: list[Mask | None] = []
        self.keys: list[int] = []
        self.sizes: list[int] = []
        for part in parts:
            for kind, index in part.block.variables:
                table = unknowns[kind]
                for number in index[part.chosen].tolist():
                    key = keys.at(kind, number)
                    if table.offset[number] >= 0 and key not in self.keys:
                        self.keys.append(key)
                        self.sizes.append(int(table.size[number]))
                        self._variables.append((kind, number))
                        self._scales.append(unknowns.graph_scale(kind, number))
                        free = table.free[number, : table.size[number]]
                        self._held.append(None if free.all() else ~free)
        if not self.keys:
            # An observation between constants: GTSAM's Dogleg takes no factor without a key.
            any_kind, first = next(unknowns.active())
            self.keys.append(keys.at(any_kind, first))
            self.sizes.append(int(unknowns[any_kind].size[first]))

    def __call__(self, values: gtsam.Values, jacobians: bool) -> Evaluation:
        local = self._local
        if local is None:
            local = self._local = _Local.of(self._given, self._parts, self._variables)
        for slot, (kind, here) in enumerate(local.variables):
            row = stored_row(values, kind, self.keys[slot], self._scales[slot])
            local.state[kind][here, : len(row)] = row
        total = sum(part.rows.size for part in self._parts)
        residual = np.empty(total)
        partials = [np.zeros((total, size)) for size in self.sizes] if jacobians else []
        for part, block in zip(self._parts, local.blocks, strict=True):
            v, by_variable = block.evaluate(self._frame, local.state, jacobians=jacobians)
            residual[part.rows] = v
            if not jacobians:
                continue
            for (kind, index), by in zip(block.variables, by_variable, strict=True):
                for i, here in enumerate(index.tolist()):
                    place = local.slots.get((kind, here))
                    if place is not None:
                        partials[place][part.rows[i]] += by[i][:, : self.sizes[place]]
        if jacobians:
            for slot, (kind, here) in enumerate(local.variables):
                held, row = self._held[slot], local.state[kind][here]
                if held is not None:
                    partials[slot][:, held] = 0.0
                partials[slot] = to_gtsam(kind, partials[slot], row, self._scales[slot])
        return residual, partials

    def label(self) -> str:
        """Name the observations."""
        return ", ".join(part.block.labels(int(i)) for part in self._parts for i in part.chosen)


class _Local(NamedTuple):
    """The variables of one factor as a state of their own."""

    blocks: list[Block]
    """The chosen observations of each part, with renumbered variables."""
    state: State
    """Values of these variables and constants only."""
    variables: list[tuple[VariableKind, int]]
    """Kind and new number of the variable behind each key."""
    slots: dict[tuple[VariableKind, int], int]
    """Place of the key of a variable; constants have no entry."""

    @staticmethod
    def of(
        state: State, parts: Sequence[Part], keyed: Sequence[tuple[VariableKind, int]]
    ) -> _Local:
        """Renumber the variables of ``parts`` and copy their values."""
        numbers: dict[VariableKind, dict[int, int]] = {}
        blocks = []
        for part in parts:
            chosen = part.block.select(part.chosen)
            variables = []
            for kind, index in chosen.variables:
                seen = numbers.setdefault(kind, {})
                anew = [seen.setdefault(i, len(seen)) for i in index.tolist()]
                variables.append((kind, np.array(anew, dtype=np.intp)))
            blocks.append(replace(chosen, variables=tuple(variables)))
        here = [(kind, numbers[kind][number]) for kind, number in keyed]
        return _Local(
            blocks,
            {kind: state[kind][list(seen)] for kind, seen in numbers.items()},
            here,
            {variable: slot for slot, variable in enumerate(here)},
        )


def held_factor(
    unknowns: Unknowns,
    state: State,
    kind: VariableKind,
    number: int,
    sigma: float,
    keys: KeyMap,
) -> gtsam.CustomFactor:
    """Return the factor that keeps the held components of a partly held variable.

    Partials of observations by held components are zero, so that nothing pulls at them: the factor
    is no hard constraint, with which GTSAM's marginal covariances are wrong.

    Args:
        unknowns: the variables.
        state: the held values.
        kind: kind of the variable.
        number: its number.
        sigma: standard deviation of the held components in the graph.
        keys: keys of the variables.
    """
    table, scale = unknowns[kind], unknowns.graph_scale(kind, number)
    size = int(table.size[number])
    which = np.flatnonzero(~table.free[number, :size])
    key = keys.at(kind, number)
    held = state[kind][number].copy()
    by = np.ones(len(which)) if scale is None else 1.0 / scale[which]

    def evaluate(values: gtsam.Values, jacobians: bool) -> Evaluation:
        row = stored_row(values, kind, key, scale)
        residual = UNKNOWNS[kind].local(held[None, : len(row)], row[None])[0]
        partials = np.eye(size)
        if UNKNOWNS[kind].rotates:
            partials[:3, :3] = right_jacobian_inverse(residual[None, :3])[0]
        return residual[which] * by, [to_gtsam(kind, partials, row, scale)[which] * by[:, None]]

    return guarded(
        gtsam.noiseModel.Isotropic.Sigma(len(which), sigma),
        [key],
        [size],
        evaluate,
        lambda: f"held components of {kind} {table.names[number]!r}",
    )
