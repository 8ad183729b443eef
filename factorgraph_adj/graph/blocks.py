"""Blocks: observations of one kind as arrays of values, weights and variables; evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from ..errors import InputError, Problem
from ..frames import Frame
from ..models.base import DegenerateError, Linearised, NoDirectionError
from ..models.image import image
from ..models.lens import Lens
from ..models.rolling_shutter import Readout
from ..models.unknown_registry import VariableKind
from ..observations import KINDS, Observation, Unit, observation_kind
from ..observations.registry import Quantity
from ..types import Array, Index
from .variables import State

Fixes: TypeAlias = Literal["nothing", "direction", "coordinates", "attitude", "horizon", "place"]
"""Information of observations about the position of a network."""


@dataclass(frozen=True)
class ObservationLabels:
    """Readable names of observations, made on demand."""

    observations: Sequence[Observation]
    """The observations."""

    def __call__(self, i: int) -> str:
        """Return the name of observation i."""
        return self.observations[i].label()


@dataclass(frozen=True)
class SomeLabels:
    """Readable names of some rows of a block."""

    labels: Callable[[int], str]
    """Names of all rows."""
    rows: Index
    """Numbers of the selected rows."""

    def __call__(self, i: int) -> str:
        """Return the name of selected row i."""
        return self.labels(int(self.rows[i]))


@dataclass(frozen=True)
class Block:
    """n observations of one kind with d components each."""

    kind: str
    """Kind, as in reports."""
    unit: Unit
    """Unit of the values."""
    variables: tuple[tuple[VariableKind, Index], ...]
    """Kind and numbers (n,) of each variable, no variable twice in one observation; in the order
    in which the model takes them."""
    observed: Array
    """Observed values (n, d)."""
    sigma: Array
    """Standard deviations (n, d)."""
    ids: Sequence[str]
    """Ids of the observations."""
    components: tuple[str, ...]
    """Names of the d components."""
    labels: Callable[[int], str]
    """Readable name of row i, for messages."""
    whitener: Array | None = None
    """W (n, d, d) with W Σ Wᵀ = I for correlated components, else None."""
    model: Callable[..., Linearised] | None = None
    """The model; None for image coordinates."""
    lens: Lens | None = None
    """The lens model of image coordinates."""
    readout: Readout | None = None
    """The times of the rows of image coordinates, if their photos have a motion, which is then the
    fourth variable."""
    constants: dict[str, Array] = field(default_factory=dict)
    """Further arguments of the model, arrays over the rows."""
    prior: bool = False
    """Whether the observations are given values of weighted unknowns."""
    fixes: Fixes = "nothing"
    """Information about the position of the network, as in `ObservationKind.fixes`, or about
    attitudes of photos or the horizons of frames."""
    by_axis: bool = False
    """Whether several rows of the block may belong to one observation, one for each axis."""
    axes: Sequence[str] | None = None
    """Name of the component of each row, (n,), for single components with different names."""
    roles: tuple[int, ...] = ()
    """Place among ``variables`` of each argument of the model, where a variable is in several
    roles: the point of a target that is the origin of its frame too. Empty: one role for each."""
    named: tuple[str, ...] = ()
    """Attribute of the observations that names each argument of the model; empty for blocks of no
    kind."""
    widths: dict[int, int] = field(default_factory=dict)
    """Number of components that the model takes, by place of the argument, for kinds with
    different sizes."""
    composed: Callable[..., Array] | None = None
    """How readings are moved where they do not add, see `ObservationKind.moved`."""
    first_row: int = 0
    """Number of the first scalar row among all rows of the network."""

    @property
    def n(self) -> int:
        """Number of observations."""
        return len(self.observed)

    @property
    def dimension(self) -> int:
        """Number of components d."""
        return int(self.observed.shape[1])

    @property
    def curved(self) -> bool:
        """Whether partials by points depend on where these are."""
        return self.lens is not None or (not self.prior and observation_kind(self.kind).curved)

    @property
    def image(self) -> bool:
        """Whether the observations are image coordinates of points, which a lens model computes."""
        return self.lens is not None

    @property
    def quantity(self) -> Quantity:
        """Quantity of the observations; given values of unknowns have another one than readings."""
        record = KINDS.get(self.kind)
        return "other" if record is None or self.prior else record.quantity

    @property
    def arguments(self) -> tuple[tuple[VariableKind, Index], ...]:
        """Kind and numbers (n,) of each argument of the model, in the order of its roles."""
        return tuple(self.variables[i] for i in self.roles) if self.roles else self.variables

    def by_role(self) -> Block:
        """Return the block with a variable for each role, so that one role can be given another.

        A variable may then be there twice; the partials are those of its roles.
        """
        return replace(self, variables=self.arguments, roles=())

    @property
    def rows(self) -> slice:
        """Scalar rows of this block among all rows of the network."""
        return slice(self.first_row, self.first_row + self.observed.size)

    def component(self, i: int, number: int) -> str:
        """Return the name of a component of observation i; empty for a scalar."""
        return self.components[number] if self.axes is None else self.axes[i]

    def select(self, rows: Index) -> Block:
        """Return a block of some of the observations."""
        chosen = np.asarray(rows)
        return replace(
            self,
            variables=tuple((k, index[chosen]) for k, index in self.variables),
            observed=self.observed[chosen],
            sigma=self.sigma[chosen],
            ids=[self.ids[i] for i in chosen],
            labels=SomeLabels(self.labels, chosen),
            whitener=None if self.whitener is None else self.whitener[chosen],
            constants={k: v[chosen] for k, v in self.constants.items()},
            axes=None if self.axes is None else [self.axes[i] for i in chosen],
        )

    def copies(self, n: int, sizes: Mapping[VariableKind, int]) -> Block:
        """Return the observations n times, each time with variables of their own.

        Args:
            n: number of copies.
            sizes: number of variables of each kind, by which those of a copy come after those of
                the copy before.
        """
        copy, row = np.divmod(np.arange(n * self.n), self.n)
        out = self.select(row)
        variables = tuple((kind, index + sizes[kind] * copy) for kind, index in out.variables)
        return replace(out, variables=variables)

    def moved(self, change: Array) -> Array:
        """Return the observed values (n, d) moved by changes of the computed values (n, d)."""
        if self.composed is None:
            return self.observed + change
        return self.composed(self.observed, change, **self.constants)

    def evaluate(self, frame: Frame, state: State, *, jacobians: bool = True) -> Linearised:
        """Return raw residuals (n, d) and partials (n, d, k) by each of ``variables``.

        The partials by a variable in several roles are the sum of those by its roles.

        Raises:
            InputError: observations have degenerate geometry; the message names all of them.
        """
        try:
            return self._linearised(frame, state, jacobians=jacobians)
        except DegenerateError as error:
            raise InputError(
                [Problem(error.why, self.labels(int(i))) for i in error.rows]
            ) from None

    def without_direction(self, frame: Frame, state: State) -> Index:
        """Return the rows that have a value and no partials, (k,): offsets from a line, on it."""
        try:
            self._linearised(frame, state)
        except NoDirectionError as error:
            return error.rows
        except DegenerateError:  # has no value either, and is told where it is evaluated
            pass
        return np.zeros(0, dtype=np.intp)

    def degenerate(self, frame: Frame, state: State) -> Index:
        """Return rows of degenerate geometry, (k,); what is left without them may have others."""
        try:
            self._linearised(frame, state)
        except DegenerateError as error:
            return error.rows
        return np.zeros(0, dtype=np.intp)

    def _linearised(self, frame: Frame, state: State, *, jacobians: bool = True) -> Linearised:
        """Return residuals and partials.

        Raises:
            DegenerateError: rows have degenerate geometry.
        """
        values = [state[kind][index] for kind, index in self.variables]
        if self.lens is not None:
            k = len(self.lens.names)
            if len(state["calibration"]) == 1:  # one camera: no copy for each row
                values[1] = state["calibration"]
            values[1] = values[1][:, :k]
            if self.readout is not None:
                values[3] = values[3][:, : self.readout.components]
            return image(
                frame,
                *values,
                observed=self.observed,
                lens=self.lens,
                readout=self.readout,
                jacobians=jacobians,
            )
        assert self.model is not None
        if self.roles:
            values = [values[i] for i in self.roles]
        for j, width in self.widths.items():
            values[j] = values[j][:, :width]
        found = self.model(frame, *values, observed=self.observed, **self.constants)
        return self._by_variable(found) if self.roles else found

    def _by_variable(self, found: Linearised) -> Linearised:
        """Return partials by variables, given those by roles."""
        sums: dict[int, Array] = {}
        for i, by_role in zip(self.roles, found.jacobians, strict=True):
            sums[i] = sums[i] + by_role if i in sums else by_role
        return Linearised(found.residual, tuple(sums[i] for i in range(len(self.variables))))

    def whiten(self, a: Array) -> Array:
        """Divide residuals (n, d) or partials (n, d, k) by the standard deviations."""
        if self.whitener is not None:
            if a.ndim == 2:
                return np.asarray(np.einsum("nij,nj->ni", self.whitener, a))
            return np.asarray(self.whitener @ a)
        if self.equal_sigma:
            return np.asarray(a * (1.0 / self.sigma[0, 0]))
        scale = 1.0 / self.sigma
        return np.asarray(a * (scale if a.ndim == 2 else scale[:, :, None]))

    @cached_property
    def equal_sigma(self) -> bool:
        """Whether all standard deviations are equal."""
        return bool(np.all(self.sigma == self.sigma[0, 0]))
