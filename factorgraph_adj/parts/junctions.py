"""Junctions of a network in parts: agreement of the parts, places in the root, records exchanged.

Junctions are the unknowns that several parts have. All messages can be pickled.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import InputError, Problem
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..solve.nested_dissection import BlockPattern, Front, dissect_parts
from ..solve.reduced_system import DenseNormals, NodePlaces, joined_node_pairs
from ..types import Array, Index, Keys, Mask

MAX_LISTED_TESTS = 20
"""Number of observations with the largest tests that a part reports, and a solution lists."""
MAX_DIFFERENCE_OF_EQUAL_VALUES = 1e-9
"""Largest difference between held or weighted values that parts give for the same unknown: metres
or radians, relative for other quantities, such as calibrations, whose numbers may be tiny."""


@dataclass(frozen=True)
class IterationState:
    """The point of the iteration that a task belongs to."""

    state: int
    """Number of the written state at which the observations are linearised."""
    weights: int = 0
    """Number of the written state whose lengths of sights give the standard deviations."""
    damping: float = 0.0
    """Share λ of the diagonal of N that is added to N."""


@dataclass(frozen=True)
class PartSurvey:
    """What a part has: enough to find the unknowns that several parts have."""

    keys: Keys
    """A 64-bit number for each variable, from its kind and name, (k,)."""
    frame: str
    """The frame of its coordinates."""
    free_network: bool
    """Whether the part asks for the datum of a free network."""
    digest: str
    """A digest of names, observed values and weights: a changed part is noticed."""


@dataclass(frozen=True, order=True)
class Variable:
    """Kind and name of a variable."""

    kind: VariableKind
    """Kind."""
    name: str
    """Name."""


@dataclass(frozen=True)
class SharedVariable:
    """A variable of a part that other parts have too."""

    variable: Variable
    """Kind and name."""
    components: tuple[str, ...]
    """Names of its components."""
    model: str
    """What its values belong to: the lens of a calibration, the calibration of a photo."""
    free: Mask
    """Whether each component is estimated, (k,)."""
    sigma: Array
    """Standard deviations of weighted components, infinite for others, (k,)."""
    given: Array
    """Given values in stored form, NaN where unknown."""
    stated: tuple[float, ...] = ()
    """Given values of the components, NaN where unknown, of a kind of which single rotations may be
    held: the stored rotation is not known before all three are."""
    moves: bool | None = None
    """Whether a photo with image points in the part has a motion during their readout; None: it has
    no image points there, or it is another variable."""


@dataclass(frozen=True)
class JunctionSetup:
    """What a part has to know about its junctions."""

    variables: tuple[Variable, ...]
    """The junctions of the part, in the order of the root."""
    start: tuple[Array, ...]
    """Start values of each junction in stored form, NaN where no part knows them yet."""
    foreign: tuple[bool, ...]
    """Whether the given value of a weighted junction counts as an observation in another part."""


@dataclass(frozen=True)
class PartStart:
    """How a part has divided its unknowns."""

    start: tuple[Array, ...]
    """Start values of each junction, in stored form; NaN where the part does not know them."""
    missing: tuple[tuple[str, str], ...] = ()
    """Where and why approximate values are missing; the part has not begun."""
    n_rows: int = 0
    """Number of scalar observations."""
    n_unknowns: int = 0
    """Number of free components that no other part has."""
    positions: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Place of each junction, (k, 3) metres."""
    spread: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether each junction touches everything in the part, such as a calibration, (k,)."""


@dataclass(frozen=True)
class ReducedEquations:
    """The normal equations of a part, reduced to its m free junction components."""

    normal: Array
    """Lower triangle of S, row by row, (m (m + 1) / 2,)."""
    right: Array
    """s, (m,)."""
    diagonal: Array
    """Diagonal of N before the elimination, (m,)."""
    vtpv: float
    """Value of vᵀPv of the part."""
    smallest: float
    """Smallest pivot of the interior, relative to its diagonal element of N; 0: singular."""
    rounding: float
    """δᵀ diag(N) δ of the part for the units δ in the last digits of its values."""


@dataclass(frozen=True)
class PartStep:
    """A part after a step."""

    vtpv: float
    """Value of vᵀPv of the part; infinite where a step is impossible."""
    downhill: float
    """Share −gᵀdx of the part, g of its own observations."""
    damped: float
    """Share dxᵀλD dx of the part."""


@dataclass(frozen=True)
class TestedObservation:
    """An observation with its test, for the list of the largest."""

    label: str
    """Readable name."""
    w: float
    """Test value."""
    redundancy: float
    """Redundancy number."""


@dataclass(frozen=True)
class PartQuality:
    """The quality of a part; its arrays are written to its folder."""

    redundancy: float
    """Sum of the redundancy numbers of its observations."""
    uncontrolled: int
    """Number of observations that no other controls."""
    largest: tuple[TestedObservation, ...]
    """Observations with the largest |w|, the largest first."""
    memory: int
    """Largest memory of the process so far, bytes; 0 where the system does not report it."""


@dataclass(frozen=True)
class PartError:
    """An error in a part, which the root raises together with those of other parts."""

    kind: str
    """Name of the class of the error."""
    lines: tuple[tuple[str, str], ...]
    """Where and what, for each problem."""
    defect: int = 0
    """Number of missing conditions."""
    unknowns: tuple[tuple[str, str], ...] = ()
    """Kind and name of the undetermined unknowns."""


def problem_in_part(name: str, where: str, what: str) -> Problem:
    """Return a problem of a part: its place begins with the name of the part."""
    return Problem(what, f"part {name!r}, {where}" if where else f"part {name!r}")


def packed_triangle(a: Array) -> Array:
    """Return the lower triangle of a symmetric matrix, row by row, (m (m + 1) / 2,)."""
    return np.ascontiguousarray(a[np.tril_indices(len(a))])


def unpacked_triangle(a: Array) -> Array:
    """Return the symmetric matrix of a lower triangle, row by row."""
    m = int((np.sqrt(8 * len(a) + 1) - 1) / 2)
    out = np.zeros((m, m))
    rows, columns = np.tril_indices(m)
    out[rows, columns] = out[columns, rows] = a
    return out


def shared_keys(surveyed: Sequence[PartSurvey], names: Sequence[str]) -> Keys:
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

    def __init__(self, shared: Sequence[Sequence[SharedVariable]], names: Sequence[str]) -> None:
        """Compare what the parts say of the unknowns that they have in common.

        Args:
            shared: the common variables of each part.
            names: names of the parts.

        Raises:
            InputError: parts differ in what they hold, weight or estimate; all are named.
        """
        owners: dict[Variable, list[tuple[int, SharedVariable]]] = {}
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

    def setups(self, start: Sequence[Array]) -> list[JunctionSetup]:
        """Return what each part has to know about its junctions.

        A given value of a weighted junction is an observation once, in the first part that gives
        it.

        Args:
            start: start value of each junction in stored form, NaN where unknown.
        """
        counted_in_part = []
        for v in self.variables:
            each = self._owners[v]
            weighted = [n for n, s in each if np.isfinite(s.sigma[s.free]).any()]
            counted_in_part.append(min(weighted, default=-1))
        return [
            JunctionSetup(
                tuple(self.variables[i] for i in of_part.tolist()),
                tuple(start[i] for i in of_part.tolist()),
                tuple(counted_in_part[i] not in (-1, number) for i in of_part.tolist()),
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


class RootPlaces(NodePlaces):
    """Places of the junctions in the root: one node for each, or the border."""

    def __init__(self, junctions: Junctions, begun: Sequence[PartStart]) -> None:
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
    def layout(self) -> tuple[BlockPattern, list[Front]]:
        """The blocks of the root and its fronts, which are the same in all iterations."""
        parts = [DenseNormals(c, np.zeros((0, 0))) for c in self._columns]
        return self.structure(joined_node_pairs(self, parts), lambda: self._positions)

    def _fronts(self, pattern: BlockPattern, positions: Array) -> list[Front]:
        """Return the fronts: all junctions of a part are joined."""
        return dissect_parts(pattern, positions, self._parts)


def _differences(
    v: Variable, each: Sequence[tuple[int, SharedVariable]], names: Sequence[str]
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
        elif {one.moves, other.moves} == {True, False}:
            moving, still = (names[number], names[other_number])[:: 1 if one.moves else -1]
            what = f"part {moving!r} states its motion during the readout, and part {still!r} none"
            out.append(Problem(f"{what}: state it in the same way in both", where))
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


def _listed(v: Variable, one: SharedVariable) -> str:
    """Return the values of an unknown in the form of an input."""
    values = one.stated or UNKNOWNS[v.kind].given(one.given[None])[0].tolist()
    return "(" + ", ".join(f"{x:.10g}" for x in values[: len(one.components)]) + ")"


def _same_values(v: Variable, one: SharedVariable, other: SharedVariable, which: Mask) -> bool:
    """Return whether two parts give some components (k,) of an unknown the same values."""
    kind = UNKNOWNS[v.kind]
    if one.stated and other.stated:
        a, b = (np.array(s.stated)[which] for s in (one, other))
        return bool(np.all(np.abs(a - b) <= MAX_DIFFERENCE_OF_EQUAL_VALUES))
    stored = np.flatnonzero(kind.in_stored_form(which[None])[0])
    a, b = one.given[stored], other.given[stored]
    metric = bool(kind.components) and all(
        c.quantity in ("length", "angle") for c in kind.components
    )
    scale = 1.0 if metric else np.maximum(np.abs(a), np.abs(b))
    return bool(np.all(np.abs(a - b) <= MAX_DIFFERENCE_OF_EQUAL_VALUES * scale))


def _same_weight(v: Variable, one: SharedVariable, other: SharedVariable) -> bool:
    """Return whether two parts give an unknown the same weighted values."""
    weighted = np.isfinite(one.sigma) & one.free
    return np.allclose(one.sigma[one.free], other.sigma[one.free], rtol=1e-12) and _same_values(
        v, one, other, weighted
    )
