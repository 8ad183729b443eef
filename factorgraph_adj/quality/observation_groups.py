"""Groups of observations: square sums, redundancies, information on their variances.

Groups are those of a kind, camera, photo or instrument, or are defined by the user.

With whitened observation equations v = A dx + l, R = I − A Q Aᵀ projects errors to residuals.
For disjoint groups g with one variance each,

    q_g  = v_gᵀv_g                      weighted square sum of the residuals, E(q_g) = r_g,
    r_g  = tr R_gg                      redundancy of the group, Σ r_g = redundancy,
    S_gh = tr(R_gh R_hg) = ‖R_gh‖²_F    with Σ_h S_gh = r_g, for R is idempotent:

S is the matrix of Helmert's equations S σ² = q, and cov(ln σ̂²) = 2 S⁻¹ (Koch 1999, § 3.6;
Förstner 1979; Amiri-Simkooei 2007, with N_gh = ½ tr(Q_g W Q_h W), W = P Q_vv P). The residuals
give

    B_gh = v_gᵀR_gh v_h,   E(B) = S,   ∂(r − q)/∂ln σ² = 2 B − S + diag(r − q),

where B is the average information of Gilmour, Thompson & Cullis (1995, Biometrics 51, 1440–1450).

The residuals at the minimum of the linearised equations are R v for the residuals v at any state
near the minimum: the figures are those of the minimum after one Gauss-Newton step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import numpy as np
from scipy.sparse import csr_array

from ..errors import InputError, Problem, known
from ..graph.blocks import Block
from ..models.unknown_registry import UNKNOWNS
from ..network.network import Network
from ..observations import observation_kind
from ..solve.estimates import ObservationRecord
from ..solve.linearised_equations import LinearisedEquations
from ..solve.solution import Solution
from ..types import Array, Index
from .reliability import reliability

GroupRule: TypeAlias = Literal["kind", "camera", "photo", "instrument", "frame"]
"""Rule for groups. "kind" groups all observations by kind; "camera" and "photo" group image
coordinates by camera or photo; "instrument" groups observations by the instrument that they name
and image coordinates by camera; "frame" groups observations in frames by kind and frame, which
gives each scanner or tracker a component for directions, zenith angles and distances. All other
observations are grouped by kind."""
GroupChoice: TypeAlias = (
    GroupRule | Mapping[str, Sequence[str]] | Callable[[ObservationRecord], str | None]
)
"""A rule, a mapping from group to ids, or a function from a scalar observation to its group."""

MIN_ROW_CORRELATION = 1e-12
"""Correlation above which two components must be in the same group."""
EXACT_ROWS = 2000
"""Scalar observations up to which R is computed as a whole."""
MAX_WEIGHT_LOG_CHANGE = 0.1
"""Largest change of ln f² since the probes with which S still gives standard deviations: the
elements of S beside its diagonal change by this part of their value, the diagonal follows r."""
PROJECTED_COLUMNS_AT_ONCE = 16
"""Number of columns that are projected at once."""
MAX_PROBES_OF_ITERATION, PROBES_OF_RESULT = 2, 64
"""Numbers of random sign vectors in larger networks: at most `MAX_PROBES_OF_ITERATION` for each
group during the iteration, `PROBES_OF_RESULT` for all groups together at its end, but at least one
for each group."""


@dataclass(frozen=True, eq=False)
class ObservationGroups:
    """The group of every scalar observation."""

    names: tuple[str, ...]
    """Names of the groups, in the given order or in the order of their first observation."""
    of_row: Index
    """Number of the group of every row, −1 for rows without a group, (n_rows,)."""

    @property
    def sizes(self) -> Index:
        """Number of scalar observations in each group."""
        return np.bincount(self.of_row[self.of_row >= 0], minlength=len(self.names))

    @cached_property
    def _members(self) -> csr_array:
        """Incidence matrix (k + 1, n) of groups and rows; the last row: rows without a group."""
        k, n = len(self.names), len(self.of_row)
        group = np.where(self.of_row < 0, k, self.of_row)
        return csr_array((np.ones(n), (group, np.arange(n))), shape=(k + 1, n))

    def sums(self, values: Array) -> Array:
        """Return sums of values (n_rows, ...) over each group, then over rows without a group."""
        return np.asarray(self._members @ values)


def observation_groups(solution: Solution, groups: GroupChoice) -> ObservationGroups:
    """Return the group of every scalar observation of a solution.

    Args:
        solution: an adjustment.
        groups: a rule, ids by group, or a function of an `ObservationRecord`. Observations that
            are not listed, or for which the function returns None, have no group.

    Raises:
        InputError: an unknown rule or id, an observation in two groups, a group without
            observations, correlated observations in different groups: by name, all at once.
    """
    if callable(groups):
        found = _numbered([groups(o) for o in solution.observations])
    elif isinstance(groups, Mapping):
        if not groups:
            raise InputError("there are no groups")
        found = _by_id(solution, groups)
    elif groups in get_args(GroupRule):
        names: list[str | None] = []
        for block in solution.equations.blocks:
            own = _by_rule(solution.network, block, groups)
            names += [name for name in own for _ in range(block.dimension)]
        found = _numbered(names)
    else:
        raise InputError(
            f"unknown groups {groups!r}; valid: a mapping from group to ids, a function of an "
            f"observation, or one of {known(get_args(GroupRule), meant=groups)}"
        )
    _refuse_split(solution, found)
    return found


def _numbered(names: Sequence[str | None]) -> ObservationGroups:
    """Return groups from the name of each row's group."""
    wrong = {repr(n) for n in names if n is not None and not isinstance(n, str)}
    if wrong:
        raise InputError(
            "a group must be text, or none for observations without a group, not "
            + known(sorted(wrong))
        )
    distinct = [n for n in dict.fromkeys(names) if n is not None]
    if not distinct:
        raise InputError("no observation is in any group")
    number: dict[str | None, int] = {n: i for i, n in enumerate(distinct)}
    number[None] = -1
    return ObservationGroups(tuple(distinct), np.array([number[n] for n in names], dtype=np.intp))


def _by_rule(network: Network, block: Block, rule: str) -> Sequence[str]:
    """Return the group of each observation of a block, (n,)."""
    if rule == "frame":
        if "frame" not in block.named:
            return [block.kind] * block.n
        frames = list(network.frames)
        number = block.arguments[block.named.index("frame")][1]
        return [f"{block.kind} in {frames[i]}" for i in number.tolist()]
    if block.image and rule != "kind":
        photos = list(network.photos.values())
        of_photo = [f"photo {f.name}" if rule == "photo" else f"camera {f.camera}" for f in photos]
        return [of_photo[i] for i in block.variables[0][1].tolist()]
    if rule == "instrument" and not block.prior and block.lens is None:
        named = [a for k, a in observation_kind(block.kind).parameters if UNKNOWNS[k].instrument]
        if not named:
            return [block.kind] * block.n
        instruments = [getattr(network.observations[i], named[0]) for i in block.ids]
        return [block.kind if i is None else f"instrument {i}" for i in instruments]
    return [block.kind] * block.n


def _by_id(solution: Solution, groups: Mapping[str, Sequence[str]]) -> ObservationGroups:
    problems = []
    group_of: dict[str, int] = {}
    names = tuple(groups)
    for number, (group, ids) in enumerate(groups.items()):
        if isinstance(ids, str):
            what = f"give a list of ids, not the text {ids!r}"
            problems.append(Problem(what, f"group {group!r}"))
            continue
        if not len(ids):
            problems.append(Problem("it has no observations", f"group {group!r}"))
        for ident in dict.fromkeys(ids):
            other = names[group_of.setdefault(ident, number)]
            if other != group:
                what = f"it is in the groups {other!r} and {group!r}"
                problems.append(Problem(what, f"observation {ident!r}"))
    rows = solution.equations.find(list(group_of))
    unknown = [ident for ident, found in zip(group_of, rows, strict=True) if not len(found)]
    if unknown:
        every = dict.fromkeys(solution.observations.ids)
        there = known(every, meant=unknown[0])
        problems.append(Problem(f"unknown observations {known(unknown)}; known: {there}"))
    if problems:
        raise InputError(problems)
    of_row = np.full(solution.equations.n_rows, -1, dtype=np.intp)
    of_row[np.concatenate(rows)] = np.repeat(list(group_of.values()), [len(r) for r in rows])
    return ObservationGroups(names, of_row)


def _refuse_split(solution: Solution, groups: ObservationGroups) -> None:
    """Raise an error that names correlated observations in different groups."""
    equations, of_row = solution.equations, groups.of_row
    problems = []

    def refuse(a: int, b: int) -> None:
        """Note that the correlated rows a and b are in different groups."""
        mine, other = (
            repr(groups.names[of_row[r]]) if of_row[r] >= 0 else "no group" for r in (a, b)
        )
        problems.append(
            Problem(
                f"it is in {mine}, but {equations.label(b)}, which is correlated with it, in "
                f"{other}: one factor holds for a covariance; put them into one group",
                equations.label(a),
            )
        )

    for cluster in equations.clusters:
        different = cluster.rows[of_row[cluster.rows] != of_row[cluster.rows[0]]]
        if len(different):
            refuse(int(cluster.rows[0]), int(different[0]))
    in_cluster = equations.in_cluster
    for place, block in enumerate(equations.blocks):
        if block.whitener is None:
            continue
        root = np.linalg.inv(block.whitener)
        covariance = root @ root.transpose(0, 2, 1)
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        related = np.abs(covariance) > MIN_ROW_CORRELATION * sigma[:, :, None] * sigma[:, None, :]
        related[in_cluster.get(place, np.zeros(0, dtype=np.intp))] = False
        group = of_row[block.rows].reshape(-1, block.dimension)
        split = related & (group[:, :, None] != group[:, None, :])
        for i in np.flatnonzero(split.any(axis=(1, 2))).tolist():
            a, b = np.argwhere(split[i])[0].tolist()
            first = block.first_row + i * block.dimension
            refuse(first + a, first + b)
    if problems:
        raise InputError(problems)


@dataclass(frozen=True)
class ProbedInformation:
    """An estimate of S from random probes."""

    s: Array
    """The estimate, (k + 1, k + 1); the last row and column are for rows without a group."""
    probes: int
    """Number of probes of each group."""
    logarithms: Array
    """Logarithms of the weights of the rows at that time, relative to the network's, (n,)."""


@dataclass(frozen=True, eq=False)
class GroupRedundancy:
    """Square sums, redundancies and S of k groups at the minimum next to one linearisation."""

    squares: Array
    """q (k,)."""
    redundancy: Array
    """r (k,)."""
    information: Array
    """S (k, k)."""
    exact: bool
    """Whether S is exact, or estimated from random probes."""
    movement: Array
    """Step to the minimum, (n_columns,)."""
    residuals: Array
    """Whitened residuals R v at the minimum, (n_rows,)."""
    groups: ObservationGroups
    """Group of each row; rows of factors that the user added are at the end."""
    project: Callable[[Array], Array]
    """Function that returns R Z (n_rows, m) for Z (n_rows, m)."""
    probed: ProbedInformation | None = None
    """The probes; None: S is exact, or diag(r)."""

    @property
    def unprobed(self) -> bool:
        """Whether S is only diag(r)."""
        return not self.exact and self.probed is None

    def average_times(self, x: Array) -> Array:
        """Return B x (k,) for x (k,)."""
        v, k = self.residuals, len(self.squares)
        of_row = np.append(x, 0.0)[self.groups.of_row]
        return self.groups.sums(v * self.project((v * of_row)[:, None])[:, 0])[:k]

    @cached_property
    def average(self) -> Array:
        """B (k, k)."""
        return np.stack([self.average_times(x) for x in np.eye(len(self.squares))], axis=1)


def group_redundancy(
    solution: Solution,
    groups: ObservationGroups,
    *,
    seed: int = 0,
    exact: bool | None = None,
    earlier: GroupRedundancy | None = None,
    probe: bool = False,
) -> GroupRedundancy:
    """Return q, r and S of groups of observations, and B; correlated observations share a group.

    With up to `EXACT_ROWS` observations the figures are computed from R itself. In larger networks
    r is the sum of the redundancy numbers, and S is estimated by stochastic traces (Hutchinson
    1990): with independent random signs z_g over the rows of group g, E‖(R z_g)_h‖² = S_gh. The
    diagonal element, usually by far the largest of its row, follows from r:
    S_gg = r_g − Σ_{h≠g} S_gh. This makes it nearly exact. Without probes S is diag(r), which makes
    Förstner's iteration of Helmert's equations; for one group of all rows it is exact.

    Args:
        solution: an adjustment, or a step of one.
        groups: the group of each observation.
        seed: seed of the random signs.
        exact: whether S is computed exactly; None: up to `EXACT_ROWS` observations.
        earlier: figures with other weights, whose probes serve again: what one group has in
            another hardly changes, and r, q and B are those of the solution.
        probe: whether S is estimated in a large network if ``earlier`` has no probes.
    """
    k = len(groups.names)
    system = solution.normal().system
    every = _with_extra(groups, system)
    if exact is None:
        exact = len(every.of_row) <= EXACT_ROWS
    v = np.concatenate([system.residual, *(e.residual for e in system.extra)])
    x = solution.factor.solve(system.transposed(v[:, None]))
    residuals = v - system.times(x)[:, 0]
    squares = every.sums(np.square(residuals))[:k]
    if exact:
        a = system.times(np.eye(system.unknowns.n_columns))
        projector = np.eye(len(a)) - a @ solution.factor.solve(a.T)
        redundancy = every.sums(np.diag(projector))[:k]
        half = every.sums(np.square(projector))
        s = every.sums(np.ascontiguousarray(half.T))[:k, :k]
        return GroupRedundancy(
            squares, redundancy, s, True, -x[:, 0], residuals, every, projector.__matmul__
        )
    redundancy = groups.sums(reliability(solution).redundancy_numbers)[:k]
    out = GroupRedundancy(
        squares,
        redundancy,
        np.diag(redundancy),
        k == 1 and not np.any(every.of_row),
        -x[:, 0],
        residuals,
        every,
        lambda z: _project(solution, z),
    )
    probed = None if earlier is None else earlier.probed
    if probed is None:
        if out.exact or not probe:
            return out
        probed = _by_probes(out, solution, seed, min(MAX_PROBES_OF_ITERATION, _number_of_probes(k)))
    return replace(out, information=_completed(probed.s, redundancy), probed=probed)


def sharpened_redundancy(
    at: GroupRedundancy, solution: Solution, groups: ObservationGroups, *, seed: int = 0
) -> GroupRedundancy:
    """Return the figures with an S exact enough for standard deviations.

    Probes of the iteration serve if they are enough, and the weights have hardly changed since.
    """
    if at.exact:
        return at
    probed, enough = at.probed, _number_of_probes(len(groups.names))
    if probed is not None and probed.probes >= enough:
        change = np.abs(_logarithms(solution) - probed.logarithms).max(initial=0.0)
        if change <= MAX_WEIGHT_LOG_CHANGE:
            return at
    probed = _by_probes(at, solution, seed, enough)
    return replace(at, information=_completed(probed.s, at.redundancy), probed=probed)


def _number_of_probes(k: int) -> int:
    """Return the number of probes of each of k groups for standard deviations."""
    return max(1, PROBES_OF_RESULT // k)


def _logarithms(solution: Solution) -> Array:
    """Return the logarithms of the weights of all rows, relative to the network's, (n,)."""
    if solution.weights is None:
        return np.zeros(solution.equations.n_rows)
    return np.log(solution.weights)


def _with_extra(groups: ObservationGroups, system: LinearisedEquations) -> ObservationGroups:
    """Append the rows of factors that the user added; these rows are in no group."""
    added = sum(len(e.a) for e in system.extra)
    return replace(groups, of_row=np.append(groups.of_row, np.full(added, -1, dtype=np.intp)))


def _completed(s: Array, redundancy: Array) -> Array:
    """Return S (k, k) from its estimate (k + 1, k + 1) and r.

    If mainly other groups check a group, its diagonal element is a small difference between r and
    the rest of the row; then the estimate from the probes is more accurate.
    """
    k = len(redundancy)
    beside = s - np.diag(np.diag(s))
    rest = redundancy - beside[:k].sum(axis=1)
    diagonal = np.where(rest > redundancy / 4.0, rest, np.diag(s)[:k])
    return np.asarray(beside[:k, :k] + np.diag(diagonal))


def _project(solution: Solution, z: Array) -> Array:
    """Return R Z (rows, m)."""
    system = solution.normal().system
    out = np.empty_like(z)
    for first in range(0, z.shape[1], PROJECTED_COLUMNS_AT_ONCE):
        part = slice(first, first + PROJECTED_COLUMNS_AT_ONCE)
        x = solution.factor.solve(system.transposed(z[:, part]))
        out[:, part] = z[:, part] - system.times(x)
    return out


def _by_probes(
    at: GroupRedundancy, solution: Solution, seed: int, probes: int
) -> ProbedInformation:
    """Return an estimate of S."""
    rng, of_row = np.random.default_rng(seed), at.groups.of_row
    k = len(at.redundancy)
    out = np.zeros((k + 1, k + 1))
    of_group = [np.flatnonzero(of_row == number) for number in range(k)]
    every = [number for number in range(k) for _ in range(probes)]
    for first in range(
        0, len(every), PROJECTED_COLUMNS_AT_ONCE
    ):  # many groups have few probes each
        chosen = every[first : first + PROJECTED_COLUMNS_AT_ONCE]
        z = np.zeros((len(of_row), len(chosen)))
        for column, number in enumerate(chosen):
            z[of_group[number], column] = rng.choice([-1.0, 1.0], len(of_group[number]))
        np.add.at(out, chosen, at.groups.sums(np.square(at.project(z))).T / probes)
    # S_gh and S_hg estimate the same element; rows without a group, at the end, have no probes.
    out[:k, :k] = (out[:k, :k] + out[:k, :k].T) / 2.0
    return ProbedInformation(out, probes, _logarithms(solution))
