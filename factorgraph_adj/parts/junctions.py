"""The junctions of a network in parts: the unknowns that several parts have."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ..errors import InputError, Problem
from ..models.variables import UNKNOWNS, VariableKind
from ..solve.dissection import Front, Pattern, dissect_parts
from ..solve.places import Places
from ..solve.remainder import Remainder, joined
from ..types import Array, Index, Keys, Mask
from .messages import Begun, Setup, Shared, Surveyed, Variable

EQUAL = 1e-9
"""Largest difference between held or weighted values that parts give for the same unknown: metres
or radians, relative for other quantities, such as calibrations, whose numbers may be tiny."""


def shared_keys(surveyed: Sequence[Surveyed], names: Sequence[str]) -> Keys:
    """Return the keys that several parts have, sorted.

    Args:
        surveyed: what each part has.
        names: names of the parts.

    Raises:
        InputError: parts have different frames, or ask for the datum of a free network.
    """
    problems = [
        Problem(
            "a network in parts needs a given datum: hold or weight some coordinates, and "
            'remove datum = "free"',
            f"part {name!r}",
        )
        for name, part in zip(names, surveyed, strict=True)
        if part.free_network
    ]
    problems += [
        Problem(
            f"its frame {part.frame} differs from {surveyed[0].frame} of part {names[0]!r}: all "
            "parts must have the same frame",
            f"part {name!r}",
        )
        for name, part in zip(names, surveyed, strict=True)
        if part.frame != surveyed[0].frame
    ]
    if problems:
        raise InputError(problems)
    keys, counts = np.unique(np.concatenate([s.keys for s in surveyed]), return_counts=True)
    return keys[counts > 1]


class Junctions:
    """All junctions, their free components as columns of the root, and who has them."""

    def __init__(self, shared: Sequence[Sequence[Shared]], names: Sequence[str]) -> None:
        """Compare what the parts say of the unknowns that they have in common.

        Args:
            shared: the common variables of each part.
            names: names of the parts.

        Raises:
            InputError: parts differ in what they hold, weight or estimate; all are named.
        """
        owners: dict[Variable, list[tuple[int, Shared]]] = {}
        for number, of_part in enumerate(shared):
            for s in of_part:
                owners.setdefault(s.variable, []).append((number, s))
        owners = {v: each for v, each in owners.items() if len(each) > 1}
        problems = []
        for v, each in owners.items():
            problems += _differences(v, each, names)
        if problems:
            raise InputError(problems)
        found = sorted(v for v, each in owners.items() if each[0][1].free.any())
        self.variables: tuple[Variable, ...] = tuple(found)
        """The junctions."""
        self.free: list[Mask] = [owners[v][0][1].free for v in found]
        """Free components of each junction."""
        self.components = [owners[v][0][1].components for v in found]
        """Names of the components of each junction."""
        sizes = np.array([int(f.sum()) for f in self.free], dtype=np.intp)
        self.first: Index = np.cumsum(sizes) - sizes
        """First column of each junction."""
        self.n_columns = int(sizes.sum())
        """Number of free components of all junctions."""
        place = {v: i for i, v in enumerate(found)}
        self.of_part: list[Index] = [
            np.array(sorted(place[s.variable] for s in p if s.variable in place), dtype=np.intp)
            for p in shared
        ]
        """Numbers of the junctions of each part."""
        self.columns: list[Index] = [
            np.concatenate(
                [np.zeros(0, dtype=np.intp)]
                + [self.first[i] + np.arange(sizes[i]) for i in of_part.tolist()]
            )
            for of_part in self.of_part
        ]
        """Columns of each part."""
        self._owners = owners

    def given(self) -> list[Array]:
        """Return the given value of each junction from the first part that gives one."""
        out = []
        for v in self.variables:
            values = [s.given for _, s in self._owners[v]]
            out.append(next((x for x in values if np.isfinite(x).all()), values[0]))
        return out

    def setups(self, start: Sequence[Array]) -> list[Setup]:
        """Return what each part has to know about its junctions.

        A given value of a weighted junction is an observation once, in the first part that gives
        it.

        Args:
            start: start value of each junction in stored form, NaN where unknown.
        """
        counts_in = []
        for v in self.variables:
            each = self._owners[v]
            weighted = [n for n, s in each if np.isfinite(s.sigma[s.free]).any()]
            counts_in.append(min(weighted, default=-1))
        return [
            Setup(
                tuple(self.variables[i] for i in of_part.tolist()),
                tuple(start[i] for i in of_part.tolist()),
                tuple(counts_in[i] not in (-1, number) for i in of_part.tolist()),
            )
            for number, of_part in enumerate(self.of_part)
        ]

    def name(self, column: int) -> str:
        """Return a readable name of a column."""
        i = int(np.searchsorted(self.first, column, side="right")) - 1
        component = int(np.flatnonzero(self.free[i])[column - self.first[i]])
        v = self.variables[i]
        return f"{UNKNOWNS[v.kind].noun} {v.name!r} {self.components[i][component]}".strip()

    def by_kind(self) -> dict[VariableKind, int]:
        """Return the number of junctions of each kind."""
        out: dict[VariableKind, int] = {}
        for v in self.variables:
            out[v.kind] = out.get(v.kind, 0) + 1
        return out


class RootPlaces(Places):
    """Places of the junctions in the root: one node for each, or the border."""

    def __init__(self, junctions: Junctions, begun: Sequence[Begun]) -> None:
        """Give every column a place.

        A junction that touches everything in a part, such as a calibration, is in the border.
        """
        super().__init__(junctions.n_columns)
        n = len(junctions.variables)
        spread = np.zeros(n, dtype=bool)
        positions = np.zeros((n, 3))
        for of_part, part in zip(junctions.of_part, begun, strict=True):
            spread[of_part] |= part.spread
            positions[of_part] = part.positions
        on = np.flatnonzero(~spread)
        self.n = len(on)
        node = np.cumsum(~spread) - 1
        sizes = np.diff(np.append(junctions.first, junctions.n_columns))
        of_column = np.repeat(np.arange(n), sizes)
        column = np.arange(junctions.n_columns)
        inner = ~spread[of_column]
        nothing = np.zeros(0, dtype=np.intp)
        position = column - junctions.first[of_column] if n else nothing
        self._settle(
            node[of_column][inner], position[inner], column[inner], column[~inner], nothing
        )
        self._positions = positions[on]
        self._parts = [node[p[~spread[p]]] for p in junctions.of_part]
        self._columns = junctions.columns

    @cached_property
    def layout(self) -> tuple[Pattern, list[Front]]:
        """The blocks of the root and its fronts, which are the same in all iterations."""
        parts = [Remainder(c, np.zeros((0, 0))) for c in self._columns]
        return self.structure(joined(self, parts), self._positions)

    def _fronts(self, pattern: Pattern, positions: Array) -> list[Front]:
        """Return the fronts: all junctions of a part are joined."""
        return dissect_parts(pattern, positions, self._parts)


def _differences(
    v: Variable, each: Sequence[tuple[int, Shared]], names: Sequence[str]
) -> list[Problem]:
    """Return in what parts differ about a common unknown."""
    where = f"{UNKNOWNS[v.kind].noun} {v.name!r}"
    number, one = each[0]
    out = []
    for other_number, other in each[1:]:
        both = f"in parts {names[number]!r} and {names[other_number]!r}"
        if one.model != other.model:
            what = f"it has {one.model} in one and {other.model} in the other {both}"
            out.append(
                Problem(f"{what}: state it in the same way, or give one another name", where)
            )
        elif one.components != other.components:
            out.append(Problem(f"it has different components {both}", where))
        elif not np.array_equal(one.free, other.free):
            differ = one.components[int(np.flatnonzero(one.free != other.free)[0])]
            holds, estimates = names[number], names[other_number]
            if one.free[one.components.index(differ)]:
                holds, estimates = estimates, holds
            what = f"part {holds!r} holds component {differ}, and part {estimates!r} estimates it"
            out.append(Problem(f"{what}: state it in the same way in both", where))
        elif not _same_values(v, one, other, ~one.free):
            values = " and ".join(_listed(v, s) for s in (one, other))
            out.append(Problem(f"it is held at different values {both}: {values}", where))
        else:
            a, b = (np.isfinite(s.sigma) & s.free for s in (one, other))
            if a.any() and b.any() and not _same_weight(v, one, other):
                what = f"its weighted values or standard deviations differ {both}"
                out.append(Problem(f"{what}: they count once, so state them equally", where))
    return out


def _listed(v: Variable, one: Shared) -> str:
    """Return the values of an unknown in the form of an input."""
    values = one.stated or UNKNOWNS[v.kind].given(one.given[None])[0].tolist()
    return "(" + ", ".join(f"{x:.10g}" for x in values[: len(one.components)]) + ")"


def _same_values(v: Variable, one: Shared, other: Shared, which: Mask) -> bool:
    """Return whether two parts give some components (k,) of an unknown the same values."""
    kind = UNKNOWNS[v.kind]
    if one.stated and other.stated:
        a, b = (np.array(s.stated)[which] for s in (one, other))
        return bool(np.all(np.abs(a - b) <= EQUAL))
    stored = np.flatnonzero(kind.in_stored_form(which[None])[0])
    a, b = one.given[stored], other.given[stored]
    metric = bool(kind.components) and all(
        c.quantity in ("length", "angle") for c in kind.components
    )
    scale = 1.0 if metric else np.maximum(np.abs(a), np.abs(b))
    return bool(np.all(np.abs(a - b) <= EQUAL * scale))


def _same_weight(v: Variable, one: Shared, other: Shared) -> bool:
    """Return whether two parts give an unknown the same weighted values."""
    weighted = np.isfinite(one.sigma) & one.free
    return np.allclose(one.sigma[one.free], other.sigma[one.free], rtol=1e-12) and _same_values(
        v, one, other, weighted
    )
