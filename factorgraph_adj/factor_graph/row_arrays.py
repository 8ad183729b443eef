"""Rows of one sort in arrays that grow: their observations, evaluation and linear forms."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..frames import Frame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..graph.weights import of_parts, sigma_at
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import Observation
from ..types import Array, Index, Mask

CAPACITY = 64
"""First number of places of arrays that grow."""
Sort: TypeAlias = tuple[object, ...]
"""What blocks have in common whose rows can be evaluated together."""


class WholeBlockError(Exception):
    """Rows can be evaluated only as the block in which they came."""


class Grown:
    """An array whose first axis grows."""

    def __init__(self, *shape: int, dtype: DTypeLike = float, fill: float = 0.0) -> None:
        """Begin without rows.

        Args:
            shape: shape of one row.
            dtype: type of the numbers.
            fill: value of columns that are added.
        """
        self._fill = fill
        self._all: NDArray[Any] = np.full((CAPACITY, *shape), fill, dtype=dtype)
        self.n = 0

    @property
    def values(self) -> NDArray[Any]:
        """The array, (n, …); a view."""
        return self._all[: self.n]

    def extend(self, more: NDArray[Any]) -> Index:
        """Append rows, and return their numbers."""
        end = self.n + len(more)
        if end > len(self._all):
            bigger = np.full(
                (max(end, 2 * len(self._all)), *self._all.shape[1:]), self._fill, self._all.dtype
            )
            bigger[: self.n] = self.values
            self._all = bigger
        self._all[self.n : end] = more
        numbers = np.arange(self.n, end)
        self.n = end
        return numbers

    def put_back(self, before: NDArray[Any]) -> None:
        """Take the values of a copy, and drop what came since."""
        self.cut(len(before))
        self.values[:] = before

    def cut(self, n: int) -> None:
        """Drop all rows but the first n."""
        self._all[n : self.n] = self._fill
        self.n = min(n, self.n)

    def widen(self, width: int) -> None:
        """Append columns to arrays of rows, (n, width)."""
        if (more := width - self._all.shape[1]) > 0:
            new = np.full((len(self._all), more), self._fill, self._all.dtype)
            self._all = np.concatenate([self._all, new], axis=1)


def sort_of(block: Block) -> Sort:
    """Return the key by which blocks can be evaluated together."""
    kinds = tuple(kind for kind, _ in block.variables)
    widths = tuple(sorted(block.widths.items()))
    return (
        block.kind,
        kinds,
        block.roles,
        widths,
        block.dimension,
        block.prior,
        block.whitener is None,
        block.lens,
        block.readout,
        block.model if block.prior else _options(block.model),
        tuple((k, v.shape[1:]) for k, v in sorted(block.constants.items())),
    )


def _options(model: object) -> tuple[object, ...]:
    """Return what a model is given for all observations of a block: axes, or lens and readout."""
    if not isinstance(model, partial):
        return ()
    given = tuple(sorted(model.keywords.items()))
    return (given, *model.args[1:], *_options(model.func), *map(_options, model.args[:1]))


class Rows:
    """Observations of one sort, with their linear forms v + A δ."""

    def __init__(self, block: Block) -> None:
        """Begin without rows, like a block."""
        self._like = block
        self.kinds: tuple[VariableKind, ...] = tuple(kind for kind, _ in block.variables)
        d, slots = block.dimension, len(self.kinds)
        self.index = Grown(slots, dtype=np.intp)
        """Numbers of the variables of each observation, (n, slots)."""
        self.unit = Grown(dtype=np.intp)
        """Unit of each observation."""
        self.v = Grown(d)
        """Residuals at θ, whitened unless the observation is one of a correlated group, (n, d)."""
        self.a: list[Grown] = []
        """Partials by the variable of each slot, (n, d, size)."""
        self.curvature: list[Grown] = []
        """See `LinearRows._measure_curvatures`, for each slot, (n, size); NaN: not measured yet."""
        self.gradient_error: list[Grown] = []
        """Contribution of each observation to the error of the gradient of linear rows, see
        `LinearRows._measure_gaps`, for each slot, (n, size)."""
        self._observed, self._sigma = Grown(d), Grown(d)
        self._whitener = None if block.whitener is None else Grown(d, d)
        self._constants = {
            k: Grown(*v.shape[1:], dtype=v.dtype) for k, v in block.constants.items()
        }
        self.joint = Grown(dtype=bool)
        """Whether an observation is one of a correlated group, which is whitened as a whole."""
        self._ids: list[str] = []
        self._labels: list[tuple[int, Callable[[int], str]]] = []
        """First row of each block that was appended, and the names of its rows."""
        self._of_parts: dict[int, Observation] = {}
        """Observations whose standard deviations have parts that depend on lengths, by number."""

    def extend(
        self,
        block: Block,
        numbers: Sequence[Index],
        units: Index,
        joint: Mask,
        network: Network,
    ) -> Index:
        """Append observations, and return their numbers.

        Args:
            block: the observations.
            numbers: numbers of their variables in the tables of values, for each slot, (n,).
            units: unit of each observation.
            joint: whether each is one of a correlated group.
            network: the network of which they are a block.
        """
        rows = self.index.extend(np.stack(numbers, axis=1))
        self.unit.extend(units)
        self.joint.extend(joint)
        self.v.extend(np.zeros(block.observed.shape))
        for a in self.a:
            a.extend(np.zeros((block.n, *a.values.shape[1:])))
        for b in self.curvature:
            b.extend(np.full((block.n, b.values.shape[1]), np.nan))
        for m in self.gradient_error:
            m.extend(np.zeros((block.n, m.values.shape[1])))
        self._observed.extend(block.observed)
        self._sigma.extend(block.sigma)
        if self._whitener is not None:
            assert block.whitener is not None
            self._whitener.extend(block.whitener)
        for k, v in self._constants.items():
            v.extend(block.constants[k])
        self._ids += block.ids
        self._labels.append((int(rows[0]), block.labels))
        for i in of_parts(network, block).tolist():
            self._of_parts[int(rows[i])] = network.observations[block.ids[i]]
        return rows

    def cut(self, n: int) -> None:
        """Drop all observations but the first n."""
        numeric = (self.index, self.unit, self.v, self._observed, self._sigma, self.joint)
        own = () if self._whitener is None else (self._whitener,)
        for each in (*numeric, *own, *self.a, *self.curvature, *self.gradient_error):
            each.cut(n)
        for each in self._constants.values():
            each.cut(n)
        del self._ids[n:]
        while self._labels and self._labels[-1][0] >= n:
            self._labels.pop()
        self._of_parts = {row: o for row, o in self._of_parts.items() if row < n}

    def block(self, rows: Index) -> Block:
        """Return some observations, whose variables are numbered as in the tables of values."""
        own = rows.tolist()
        index = self.index.values[rows]
        return replace(
            self._like,
            variables=tuple((kind, index[:, j]) for j, kind in enumerate(self.kinds)),
            observed=self._observed.values[rows],
            sigma=self._sigma.values[rows],
            ids=[self._ids[i] for i in own],
            labels=lambda i: self._label(own[i]),
            whitener=None if self._whitener is None else self._whitener.values[rows],
            constants={k: v.values[rows] for k, v in self._constants.items()},
            axes=None,
            first_row=0,
        )

    def _label(self, row: int) -> str:
        first, labels = self._labels[bisect_right(self._labels, row, key=itemgetter(0)) - 1]
        return labels(row - first)

    def weight(self, rows: Index) -> Array:
        """Return 1/σ of some observations when they arrived, (k, d)."""
        return np.asarray(1.0 / self._sigma.values[rows])

    def linearise(self, rows: Index, frame: Frame, theta: State) -> None:
        """Evaluate some observations and their partials at θ.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        v, partials = self.evaluated(rows, frame, theta)
        if not self.a:
            self.a = [Grown(*a.shape[1:]) for a in partials]
            for a in self.a:
                a.extend(np.zeros((self.v.n, *a.values.shape[1:])))
            self.curvature = [Grown(a.shape[2]) for a in partials]
            for b in self.curvature:
                b.extend(np.full((self.v.n, b.values.shape[1]), np.nan))
            self.gradient_error = [Grown(a.shape[2]) for a in partials]
            for m in self.gradient_error:
                m.extend(np.zeros((self.v.n, m.values.shape[1])))
        self.v.values[rows] = v
        for mine, new in zip(self.a, partials, strict=True):
            mine.values[rows] = new

    def _weighed(self, block: Block, rows: Index, frame: Frame, state: State) -> Block:
        """Return observations with the standard deviations for the lengths at a state."""
        own = [i for i, row in enumerate(rows.tolist()) if row in self._of_parts]
        if not own:
            return block
        observations = [self._of_parts[row] for row in rows[own].tolist()]
        sigma = block.sigma.copy()
        sigma[own, 0] = sigma_at(frame, block.select(np.array(own)), observations, state)
        return replace(block, sigma=sigma)

    def evaluated(self, rows: Index, frame: Frame, state: State) -> tuple[Array, list[Array]]:
        """Return residuals (k, d) and partials by the variable of each slot, whitened as `v`.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        return self._of_block(self.block(rows), rows, frame, state)

    def displaced(
        self, rows: Index, frame: Frame, theta: State, steps: Sequence[Array]
    ) -> Iterator[tuple[int, int, list[Array]]]:
        """Iterate over partials after a step of one component of one variable of each observation.

        All are evaluated at once, with a value of its own for each variable of each observation.

        Args:
            rows: the observations.
            frame: frame of the coordinates.
            theta: values of all variables.
            steps: lengths of the steps of the components of the variable of each slot, 0 for those
                that are held, (k, size of the tangent).

        Yields:
            Slot, component, and partials by the variable of each slot, (k, d, size).

        Raises:
            InputError: names observations whose geometry has no answer after a step.
            WholeBlockError: factors of a user are not evaluated row by row.
        """
        n = len(rows)
        which = [(j, int(c)) for j, h in enumerate(steps) for c in np.flatnonzero(h.any(axis=0))]
        if not n or not which:
            return
        values: dict[VariableKind, list[Array]] = {kind: [] for kind in self.kinds}
        variables: list[tuple[VariableKind, Index]] = []
        for j, (kind, h) in enumerate(zip(self.kinds, steps, strict=True)):
            step = np.zeros((len(which), n, h.shape[1]))
            for number, (slot, component) in enumerate(which):
                if slot == j:
                    step[number, :, component] = h[:, component]
            here = np.tile(theta[kind][self.index.values[rows, j]], (len(which), 1))
            moved = UNKNOWNS[kind].retract(here, step.reshape(len(here), -1))
            first = sum(len(v) for v in values[kind])
            values[kind].append(moved)
            variables.append((kind, first + np.arange(len(moved))))
        every = np.tile(rows, len(which))
        state = {kind: np.concatenate(v) for kind, v in values.items()}
        block = replace(self.block(every), variables=tuple(variables))
        partials = self._of_block(block, every, frame, state)[1]
        if any(len(a) != len(every) for a in partials):
            raise WholeBlockError
        for number, (slot, component) in enumerate(which):
            yield slot, component, [a[number * n : (number + 1) * n] for a in partials]

    def _of_block(
        self, block: Block, rows: Index, frame: Frame, state: State
    ) -> tuple[Array, list[Array]]:
        """Return residuals and partials of observations as a block, see `evaluated`."""
        block = self._weighed(block, rows, frame, state)
        found = block.evaluate(frame, state)
        alone = ~self.joint.values[rows]
        partials = [_whitened(block, j, alone) for j in found.jacobians]
        return _whitened(block, found.residual, alone), partials


def _whitened(block: Block, a: Array, alone: Mask) -> Array:
    whitened = block.whiten(a)
    if alone.all():
        return whitened
    return np.where(alone.reshape(-1, *(1,) * (a.ndim - 1)), whitened, a)


@dataclass(eq=False)
class Mark:
    """A tree before something is done to it, and what was replaced in it since then."""

    version: int
    """Its version."""
    counts: dict[VariableKind, int]
    """Number of variables of each kind."""
    of_units: tuple[Array, ...]
    """Whether each unit is in, and its gap."""
    of_keys: tuple[Array, ...]
    """Which keys have rows."""
    of_columns: tuple[Array, ...]
    """δ, δ at the last look, diagonal of N and bound of each column."""
    loosened: float
    """Largest factor by which standard deviations had grown since rows were measured."""
    units: list[Index] = field(default_factory=list)
    """Units whose rows were evaluated anew."""
    replaced: list[tuple[Grown, Index, Array]] = field(default_factory=list)
    """Values by row that were replaced: where, numbers of the rows, and values before."""
    theta: list[tuple[VariableKind, Index, Array]] = field(default_factory=list)
    """Kind and numbers of variables, with their points of linearisation before."""


class Arriving(NamedTuple):
    """Observations that arrive, compiled together."""

    equations: Equations
    """The observations, and what they touch."""
    state: State
    """Values of variables that are new; those that are known stay where they are."""
