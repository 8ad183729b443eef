"""Groups of observations: by kind, camera, photo or instrument, or defined by the user."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import numpy as np
from scipy.sparse import csr_array

from ..errors import InputError, Problem, known
from ..graph.blocks import Block
from ..models.variables import UNKNOWNS
from ..network.network import Network
from ..observations import observation_kind
from ..solve.observation_table import ObservationRecord
from ..solve.solution import Solution
from ..types import Array, Index

Rule: TypeAlias = Literal["kind", "camera", "photo", "instrument", "frame"]
"""Rule for groups. "kind" groups all observations by kind; "camera" and "photo" group image
coordinates by camera or photo; "instrument" groups observations by the instrument that they name
and image coordinates by camera; "frame" groups observations in frames by kind and frame, which
gives each scanner or tracker a component for directions, zenith angles and distances. All other
observations are grouped by kind."""
Groups: TypeAlias = Rule | Mapping[str, Sequence[str]] | Callable[[ObservationRecord], str | None]
"""A rule, a mapping from group to ids, or a function from a scalar observation to its group."""

CORRELATED = 1e-12
"""Correlation above which two components must be in the same group."""


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


def observation_groups(solution: Solution, groups: Groups) -> ObservationGroups:
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
    elif groups in get_args(Rule):
        names: list[str | None] = []
        for block in solution.equations.blocks:
            own = _by_rule(solution.network, block, groups)
            names += [name for name in own for _ in range(block.dimension)]
        found = _numbered(names)
    else:
        raise InputError(
            f"unknown groups {groups!r}; valid: a mapping from group to ids, a function of an "
            f"observation, or one of {known(get_args(Rule), meant=groups)}"
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
    if block.kind == "image" and rule != "kind":
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
        related = np.abs(covariance) > CORRELATED * sigma[:, :, None] * sigma[:, None, :]
        related[in_cluster.get(place, np.zeros(0, dtype=np.intp))] = False
        group = of_row[block.rows].reshape(-1, block.dimension)
        split = related & (group[:, :, None] != group[:, None, :])
        for i in np.flatnonzero(split.any(axis=(1, 2))).tolist():
            a, b = np.argwhere(split[i])[0].tolist()
            first = block.first_row + i * block.dimension
            refuse(first + a, first + b)
    if problems:
        raise InputError(problems)
