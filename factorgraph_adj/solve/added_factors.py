"""Linear rows of users' factors at a state, and of priors on unknowns from a solved network.

A user's factors are linearised at a state; a `Prior` is the information of a solved network on some
of its unknowns, without the observations of some points.

A section of a network is adjusted again: unknowns T of the reduced system, points P that only
cameras see, all observations of P, and later observations. All other information on T is in the
solved network. With its cofactors Q_TT = L Lᵀ, and with N and g of the observations of P, reduced
to T,

    S = N_TT − N_TP N_PP⁻¹ N_PT,   h = g_T − N_TP N_PP⁻¹ g_P,

all other observations have the normal matrix and, as the gradient of all is zero, the gradient

    H = Q_TT⁻¹ − S = L⁻ᵀ (I − Lᵀ S L) L⁻¹,   −h.

With I − Lᵀ S L = V diag(μ) Vᵀ they are rows R d + z of the movement d of T from the solution:

    R = μ^½ Vᵀ L⁻¹,   z = −μ^−½ Vᵀ Lᵀ h.

A direction with μ = 0 is determined by the observations of P alone. The sum vᵀPv of the section is
that of the whole network except for a constant; the estimates and cofactors of the section are
those of the whole network, where the other observations are linearised at the solution.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import gtsam
import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import bsr_array, csr_array

from ..errors import InputError
from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.keys import KeyMap
from ..graph.partials_check import refuse_wrong_partials
from ..graph.user_factors import MakesFactor, linearise_extra, made, name_of
from ..graph.variables import State, Unknowns
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..rotation import right_jacobian_inverse
from ..types import Array, Index
from .linearised_equations import ExtraRows
from .normal_equations import NormalEquations

MIN_PRIOR_EIGENVALUE = 1e-8
"""Smallest μ that counts as different from zero."""


@dataclass(frozen=True, eq=False)
class AddedFactors:
    """A user's factors, linearised at one state.

    GTSAM cannot pickle factors of every type, for instance factors written in Python. A pickled
    `AddedFactors` keeps only the rows at its state. A solution with these rows has all its
    estimates, covariances and reliability figures. The rows cannot be linearised at another state:
    after pickling, `s_transform` cannot move a free network with such factors to other datum
    points. Copies share the factors.
    """

    factors: tuple[gtsam.NonlinearFactor, ...] | None = ()
    """The factors; None after pickling."""
    rows: tuple[ExtraRows, ...] = ()
    """Rows of the factors."""
    names: tuple[str, ...] = ()
    """Names of the factors; empty: their numbers from 1, and their types."""
    keyed: Unknowns | None = None
    """The unknowns that their keys belong to; None: those of the network that is adjusted first."""
    apart: int = 0
    """Number of further rows that count in the redundancy, and that no unknown changes."""

    @classmethod
    def of(cls, given: ExtraFactors, network: Network) -> AddedFactors:
        """Return factors that a user gives: in order, or by name; given rows are kept as is.

        Args:
            given: factors, or functions by name that make them.
            network: network whose unknowns the keys belong to.

        Raises:
            InputError: names that are not texts, or an object that is not a factor.
        """
        if isinstance(given, AddedFactors):
            return given
        if isinstance(given, gtsam.NonlinearFactor):
            raise InputError("give factors in a list, [factor], or by name, {'name': factor}")
        if not isinstance(given, Mapping):
            return cls(tuple(_checked(given)))
        if wrong := [name for name in given if not isinstance(name, str)]:
            raise InputError(f"names of factors must be texts, not {wrong[0]!r}")
        found: dict[str, object] = dict(given)
        makers = {name: f for name, f in given.items() if callable(f)}
        if makers:
            keys = KeyMap(Unknowns(network))
            found |= {name: made(name, make, keys) for name, make in makers.items()}
        return cls(tuple(_checked(found.values())), names=tuple(given))

    def named(self) -> dict[str, gtsam.NonlinearFactor]:
        """Return the factors by their names.

        Raises:
            InputError: the factors were lost in pickling.
        """
        factors = self.given()
        names = self.names or [name_of(n, f) for n, f in enumerate(factors, start=1)]
        return dict(zip(names, factors, strict=True))

    def without(self, names: Collection[str]) -> AddedFactors:
        """Return the factors without some of them, by their names; rows are left out."""
        left = {name: f for name, f in self.named().items() if name not in names}
        return AddedFactors(tuple(left.values()), (), tuple(left), self.keyed)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.apart + sum(len(e.residual) for e in self.rows)

    def at(self, equations: Equations, state: State) -> AddedFactors:
        """Return the same factors, linearised at another state.

        Raises:
            InputError: the factors were lost in pickling; or as `linearise_extra`.
        """
        factors = self.given()
        if not factors:
            return self
        keyed = equations.unknowns if self.keyed is None else self.keyed
        found = linearise_extra(self.named(), equations, state, keyed)
        rows = tuple(ExtraRows(columns, a, r, name) for name, columns, a, r in found)
        return AddedFactors(factors, rows, self.names, keyed)

    def refuse_wrong_partials(self, equations: Equations, state: State) -> None:
        """Compare the partials of the factors with differences, see `refuse_wrong_partials`.

        Raises:
            InputError: the partial of each factor that is most wrong; or as `at`.
        """
        if self.given():
            keys = None if self.keyed is None else KeyMap(self.keyed)
            refuse_wrong_partials(self.named(), equations, state, keys)

    def given(self) -> tuple[gtsam.NonlinearFactor, ...]:
        """Return the factors.

        Raises:
            InputError: the factors were lost in pickling.
        """
        if self.factors is None:
            raise InputError(
                "the factors that were added to this adjustment were left behind when its solution "
                "was pickled: their rows are those of the solution, and cannot be had at another "
                "state; adjust again with extra_factors="
            )
        return self.factors

    def __deepcopy__(self, memo: dict[int, Any]) -> AddedFactors:
        """Return a copy with copied rows and the same factors."""
        return AddedFactors(
            self.factors, deepcopy(self.rows, memo), self.names, self.keyed, self.apart
        )

    def __copy__(self) -> AddedFactors:
        """Return the object itself, as it is immutable."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return the rows for pickling, without the factors."""
        kept = {"rows": self.rows, "names": self.names, "keyed": None, "apart": self.apart}
        return {"factors": None if self.factors else (), **kept}


def _checked(given: Iterable[object]) -> list[gtsam.NonlinearFactor]:
    """Return factors unchanged.

    Raises:
        InputError: one of them is not a factor.
    """
    out: list[gtsam.NonlinearFactor] = []
    for f in given:
        if not isinstance(f, gtsam.NonlinearFactor):
            kind = type(f).__name__
            raise InputError(f"factors must be a `gtsam.NonlinearFactor` each, not {kind}")
        out.append(f)
    return out


ExtraFactors: TypeAlias = (
    Sequence[gtsam.NonlinearFactor]
    | Mapping[str, gtsam.NonlinearFactor | MakesFactor]
    | AddedFactors
)
"""Factors of a user: in order, or by name, or functions by name that make them; or with the
unknowns that their keys belong to."""
NO_ADDED_FACTORS = AddedFactors()
"""No rows beside the observations."""


class UnknownGroup(NamedTuple):
    """The unknowns of one kind that a prior is about."""

    kind: VariableKind
    """The kind."""
    names: tuple[str, ...]
    """Their names."""
    reference: Array
    """Their values at the solution, as in a state, (n, stored)."""
    columns: Index
    """Columns of R of each, −1 beyond the size of one, (n, components)."""


@dataclass(frozen=True, eq=False)
class Prior(AddedFactors):
    """Rows R d + z of the movement of unknowns from the solution of a network."""

    groups: tuple[UnknownGroup, ...] = ()
    """The unknowns."""
    r: Array | None = None
    """R, (k, m)."""
    z: Array | None = None
    """z, (k,)."""
    name: str = ""
    """Name of the rows."""

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.apart + (0 if self.z is None else len(self.z))

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The unknowns."""
        return tuple((group.kind, name) for group in self.groups for name in group.names)

    def references(self) -> dict[Variable, Array]:
        """Return the reference values of each unknown, as in a state."""
        return {
            (group.kind, name): value
            for group in self.groups
            for name, value in zip(group.names, group.reference, strict=True)
        }

    def __deepcopy__(self, memo: dict[int, Any]) -> Prior:
        """Return the rows themselves, as they are immutable."""
        return self

    def __getstate__(self) -> dict[str, Any]:
        """Return everything for pickling: there are no factors that GTSAM would have to pickle."""
        return dict(self.__dict__)

    def at(self, equations: Equations, state: State) -> Prior:
        """Return the same rows, linearised at another state of a network with the unknowns."""
        assert self.r is not None and self.z is not None
        d = self.movement(equations, state)
        a = self.r.copy()
        columns = np.empty(len(d), dtype=np.intp)
        for group in self.groups:
            table = equations.unknowns[group.kind]
            numbers = np.array([table.number[n] for n in group.names], dtype=np.intp)
            on = group.columns >= 0
            first = table.offset[numbers][:, None] + np.arange(on.shape[1])
            columns[group.columns[on]] = first[on]
            if UNKNOWNS[group.kind].rotates:
                places = group.columns[:, :3]
                turned = right_jacobian_inverse(d[places])  # d = Log(R₀ᵀR)
                a[:, places] = np.einsum("kni,nij->knj", a[:, places], turned)
        a[:, ~equations.unknowns.free[columns]] = 0.0
        return replace(self, rows=(ExtraRows(columns, a, self.r @ d + self.z, self.name),))

    def movement(self, equations: Equations, state: State) -> Array:
        """Return the movement d of the unknowns from the solution, (m,)."""
        assert self.r is not None
        d = np.zeros(self.r.shape[1])
        for group in self.groups:
            table = equations.unknowns[group.kind]
            numbers = np.array([table.number[n] for n in group.names], dtype=np.intp)
            # Tables of calibrations are as wide as the largest one of their network.
            width = min(group.reference.shape[1], state[group.kind].shape[1])
            there = state[group.kind][numbers, :width]
            step = UNKNOWNS[group.kind].local(group.reference[:, :width], there)
            on = group.columns >= 0
            d[group.columns[on]] = step[:, : on.shape[1]][on]
        return d


class MarginalPrior(NamedTuple):
    """Prior on T, see the module."""

    prior: Prior
    """The rows."""
    root: Array
    """L, (m, m), with ones for held components."""
    vtpv: float
    """Sum of squares of the prior's residuals, and of those of the observations of P, at the
    solution."""
    redundancy: int
    """Number of the same rows less the number of free unknowns among T and P."""
    n_rows: int
    """Number of the same rows."""


def marginal_prior(
    normal: NormalEquations, columns: Index, cofactors: Array, points: Index, rows: Index
) -> MarginalPrior | None:
    """Return the prior on unknowns of a solved network without the observations of points.

    None: the rows touch another unknown, or T or P is not determined to working precision.

    Args:
        normal: its normal equations at the solution.
        columns: columns of T, all columns of each unknown, (m,).
        cofactors: Q_TT, (m, m).
        points: columns of the points P, (p, 3).
        rows: all rows that touch P; they touch no unknown beside P and T, (k,).
    """
    system, unknowns = normal.system, normal.system.unknowns
    on = np.flatnonzero(unknowns.free[columns])
    sigma = np.sqrt(np.diag(cofactors)[on])
    try:
        root = cholesky(cofactors[np.ix_(on, on)] / np.outer(sigma, sigma), lower=True)
    except np.linalg.LinAlgError:
        return None
    a = system.sparse(rows)
    if len(np.setdiff1d(a.indices, np.concatenate([columns, points.ravel()]))):
        return None
    v = system.residual[rows]
    try:
        s, h = _reduced(a, v, columns[on], points, unknowns.free[points])
    except np.linalg.LinAlgError:
        return None
    half = root.T * sigma
    m = np.eye(len(on)) - half @ (s @ half.T)
    mu, vectors = np.linalg.eigh(0.5 * (m + m.T))
    weight = np.sqrt(mu[mu > MIN_PRIOR_EIGENVALUE])
    vectors = vectors[:, mu > MIN_PRIOR_EIGENVALUE]
    r = np.zeros((len(weight), len(columns)))
    r[:, on] = weight[:, None] * solve_triangular(root, vectors, trans=1, lower=True).T / sigma
    z = -(vectors.T @ (half @ h)) / weight
    whole = np.eye(len(columns))
    whole[np.ix_(on, on)] = sigma[:, None] * root
    n = len(z) + len(rows)
    known = len(on) + int(unknowns.free[points].sum())
    prior = Prior(groups=unknown_groups_of(normal, columns), r=r, z=z)
    return MarginalPrior(prior, whole, float(z @ z + v @ v), n - known, n)


def _reduced(
    a: csr_array, v: Array, columns: Index, points: Index, free: Array
) -> tuple[csr_array, Array]:
    """Return S (m, m) and h (m,) of rows, reduced to T; see the module."""
    own = a[:, columns]
    if not len(points):
        return csr_array(own.T @ own), np.asarray(own.T @ v)
    of_points = a[:, points.ravel()]
    n = (of_points.T @ of_points).tobsr((3, 3))
    assert len(n.indices) == len(points)  # no row touches two points
    blocks = n.data + np.where(free, 0.0, 1.0)[:, :, None] * np.eye(3)
    inverse = np.linalg.inv(np.linalg.cholesky(blocks))
    ends = np.arange(len(points) + 1)
    half = _blocks(inverse, ends)
    cross = csr_array(half @ (of_points.T @ own))
    gradient = half @ (of_points.T @ v)
    s = csr_array(own.T @ own - cross.T @ cross)
    return s, np.asarray(own.T @ v - cross.T @ gradient)


def _blocks(blocks: Array, ends: Index) -> csr_array:
    """Return a block diagonal matrix of blocks (p, 3, 3)."""
    return csr_array(bsr_array((blocks, ends[:-1], ends)))


def unknown_groups_of(normal: NormalEquations, columns: Index) -> tuple[UnknownGroup, ...]:
    """Return the unknowns of columns."""
    place = np.full(normal.system.unknowns.n_columns, -1, dtype=np.intp)
    place[columns] = np.arange(len(columns))
    out: list[UnknownGroup] = []
    for kind, table in normal.system.unknowns.tables.items():
        numbers = np.flatnonzero(table.offset >= 0)
        numbers = numbers[place[table.offset[numbers]] >= 0]
        if not len(numbers):
            continue
        width = int(table.size[numbers].max())
        at = table.offset[numbers][:, None] + np.arange(width)
        inside = np.arange(width) < table.size[numbers][:, None]
        own = np.where(inside, place[np.where(inside, at, 0)], -1)
        names = tuple(table.names[i] for i in numbers.tolist())
        out.append(UnknownGroup(kind, names, normal.state[kind][numbers], own))
    return tuple(out)
