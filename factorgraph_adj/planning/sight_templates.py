"""Templates of sights: the last observations of each kind from each station, and their equations.

A station is set up once it has read something, and the last observation of each kind from it is the
model of its further sights: standard deviation, set, instrument and heights are its own. The same
holds of levelled differences and GNSS positions of the whole network.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar, cast

import numpy as np

from ..errors import InputError
from ..graph.blocks import Block
from ..graph.equations import Equations, compile_rows
from ..graph.variables import DEFAULT, State
from ..graph.weights import sigma_at
from ..ledger.ledger import Ledger
from ..ledger.row_store import REMOVED
from ..linear_system.cofactor_columns import CofactorColumns, cofactor_columns
from ..linear_system.linear_system import LinearSystem
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..observations import Observation
from ..observations.base import Sight
from ..observations.positions import ControlPoint
from ..observations.registry import (
    CONTROL_QUANTITIES,
    KINDS,
    TOTAL_STATION_QUANTITIES,
    ObservationKind,
)
from ..solve.solution import Solution
from ..stochastic_model import StandardDeviation
from ..types import Array, Index

MAX_KEPT = 4
"""Number of choices of candidates whose rows are kept."""
SECOND_TARGETS = ("horizontal angle",)
"""Quantities that need a second target: a sight to a point alone has none."""
DIFFERENT = frozenset(("station", "target", "value", "id", "source"))
"""Fields in which further sights differ from their template."""


@dataclass(frozen=True, eq=False)
class Templates:
    """The last observations of what may be observed again."""

    sights: Mapping[str, Mapping[str, Sight]]
    """Of each kind by its name, for each station that is set up."""
    levelled: Sight | None
    """The last levelled height difference."""
    gnss: ControlPoint | None
    """The last observed coordinates of a point."""
    ends: tuple[tuple[str, str], ...]
    """Station and target of all sights so far, each pair once."""


class KeptRows(Protocol):
    """Rows of sights that may serve a later question."""

    def possible(self, places: Places) -> bool:
        """Return whether the same sights are possible now."""
        ...


Rows = TypeVar("Rows", bound=KeptRows)


class SightMemory:
    """The last observations of a ledger that grows, and their equations, between two queries."""

    def __init__(self) -> None:
        """Begin without any."""
        self._room: object = None
        self._seen, self._removed = 0, 0
        self._sights: dict[str, dict[str, Sight]] = {}
        self._ends: dict[tuple[str, str], None] = {}
        self._levelled: Sight | None = None
        self._gnss: ControlPoint | None = None
        self._compiled: list[tuple[Network, tuple[Observation, ...], Equations]] = []
        self._cofactors: tuple[LinearSystem, CofactorColumns] | None = None
        self._reach = np.nan
        self._kept: list[tuple[Equations, Hashable, Any]] = []

    def cofactors(self, system: LinearSystem, solution: Callable[[], Solution]) -> CofactorColumns:
        """Return the cofactors of a system, which are made once for it."""
        before = None if self._cofactors is None else self._cofactors[1]
        if before is None or self._cofactors is None or self._cofactors[0] is not system:
            self._cofactors = system, cofactor_columns(system, solution, before)
        return self._cofactors[1]

    def reach(self, longest: float, margin: float) -> float:
        """Return a reach that stays the same while the longest sight changes little, metres.

        Args:
            longest: length of the longest sight, metres.
            margin: part of it up to which the reach is longer.
        """
        if not longest <= self._reach <= longest * (1.0 + 2.0 * margin):
            self._reach = longest * (1.0 + margin)
        return self._reach

    def kept(self, places: Places, key: Hashable, make: Callable[[], Rows | None]) -> Rows | None:
        """Return the rows of a family of sights: those of an earlier question where they serve.

        Args:
            places: values and columns.
            key: what distinguishes the family among those of the same templates.
            make: evaluates the family.
        """
        mine = [k for k in self._kept if k[0] is places.equations and k[1] == key]
        others = [k for k in self._kept if k not in mine]
        rows: Rows | None = mine[0][2] if mine else None
        if rows is None or not rows.possible(places):
            rows = make()
        self._kept = [*others[1 - MAX_KEPT :], (places.equations, key, rows)]
        return rows

    def templates(self, ledger: Ledger) -> Templates:
        """Return the last observations of a ledger, of each kind from each station."""
        rows = ledger.rows
        removed = int((rows.status == REMOVED).sum())
        if self._room is not rows.room or rows.n < self._seen or removed != self._removed:
            self._seen = 0
            self._sights, self._ends, self._levelled, self._gnss = {}, {}, None, None
        new = np.arange(self._seen, rows.n)
        parts = {name: _part_of(record) for name, record in KINDS.items()}
        for _, unit in rows.units(new[rows.status[new] != REMOVED]):
            for o in unit.observations:
                part = parts.get(o.kind, "")
                if part == "sight":
                    assert isinstance(o, Sight)
                    own = self._sights.setdefault(o.station, {})
                    own[o.kind] = _unless_alike(own.get(o.kind), o)
                    self._ends[o.station, o.target] = None
                elif part == "levelled":
                    assert isinstance(o, Sight)
                    self._levelled = _unless_alike(self._levelled, o)
                elif part == "position":
                    self._gnss = cast("ControlPoint", o)
        self._room, self._seen, self._removed = rows.room, rows.n, removed
        return Templates(self._sights, self._levelled, self._gnss, tuple(self._ends))

    def compiled(self, network: Network, observations: Sequence[Observation]) -> Equations:
        """Return templates as equations of a network; their ids are numbers."""
        own = tuple(observations)
        now = list(map(id, own))
        for of, before, equations in self._compiled:
            if of is network and list(map(id, before)) == now:
                return equations
        whole = network.copy()
        for number, o in enumerate(own):
            whole.add(replace(o, id=str(number)))
        equations = compile_rows(whole)
        self._compiled = [*self._compiled[1 - MAX_KEPT :], (network, own, equations)]
        return equations


def _unless_alike(before: Sight | None, now: Sight) -> Sight:
    """Return a template: the one before where only reading, target, name and source differ."""
    if before is None or type(before) is not type(now):
        return now
    mine, other = vars(now), vars(before)
    return before if all(mine[k] == other[k] for k in mine if k not in DIFFERENT) else now


def _part_of(record: ObservationKind) -> str:
    """Return what observations of a kind are templates of: sight, levelled, position, nothing."""
    quantity, cls = record.quantity, record.observation
    if issubclass(cls, Sight):
        if quantity == "height difference":
            return "levelled"
        once = quantity in TOTAL_STATION_QUANTITIES and quantity not in SECOND_TARGETS
        return "sight" if once else ""
    return "position" if record.by_axis and quantity in CONTROL_QUANTITIES else ""


@dataclass(frozen=True, eq=False)
class Places:
    """Values and columns of all variables of the sights of a network."""

    equations: Equations
    """The templates, compiled; their ids are numbers."""
    state: State
    """Present values, NaN where they are not known."""
    cofactors: CofactorColumns
    """Cofactors of the network."""
    names: tuple[str, ...]
    """Names of the points."""
    n: int
    """Number of templates."""
    _of_kind: dict[VariableKind, Index] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        ledger: Ledger,
        system: LinearSystem,
        cofactors: CofactorColumns,
        observations: Sequence[Observation],
        memory: SightMemory,
    ) -> Places:
        """Compile observations with all points at the present estimates."""
        equations = memory.compiled(ledger.network, observations)
        unknowns = equations.unknowns
        state, moving = unknowns.start(), unknowns.moving()
        for other, values, _ in system.places():
            state = unknowns.carried(state, other, values, where=moving)
        state = system.carried(unknowns, state)
        held = system.datum_solution
        if held is not None:
            # Cofactors and open motions of a free network belong to the state of its datum.
            state = unknowns.carried(state, held.equations.unknowns, held.state, where=moving)
        names = tuple(unknowns["point"].names)
        return cls(equations, state, cofactors, names, len(observations))

    @property
    def columns(self) -> Index:
        """Columns of the points, −1: held, `UNKNOWN`, (n, 3)."""
        return self.of_kind("point")

    def of_kind(self, kind: VariableKind) -> Index:
        """Return the columns of all variables of a kind, −1: held, (n, k)."""
        if kind not in self._of_kind:
            table = self.equations.unknowns[kind]
            out = np.full(table.free.shape, -1, dtype=np.intp)
            free, width = np.flatnonzero(table.free.any(axis=1)), int(table.free.shape[1])
            names = [table.names[i] for i in free.tolist()]
            out[free] = self.cofactors.columns(kind, names, width)
            self._of_kind[kind] = np.where(table.free, out, -1)
        return self._of_kind[kind]

    def varies(self, kind: VariableKind) -> bool:
        """Return whether a variable of a kind is no constant."""
        return bool((self.of_kind(kind) != -1).any())

    @property
    def coordinates(self) -> Array:
        """Coordinates of the points, (n, 3) metres."""
        return self.state["point"]

    def longest(self, ends: Sequence[tuple[str, str]]) -> float:
        """Return the length of the longest of some sights, metres; infinite without any."""
        number = self.equations.unknowns["point"].number
        pairs = np.array([(number[a], number[b]) for a, b in ends], dtype=np.intp).reshape(-1, 2)
        way = self.coordinates[pairs[:, 1]] - self.coordinates[pairs[:, 0]]
        far = np.linalg.norm(way, axis=1)
        far = far[np.isfinite(far)]
        return float(far.max()) if len(far) else np.inf

    @cached_property
    def rows_of_templates(self) -> tuple[Index, Index]:
        """Block of each template, and its row there."""
        found = {
            ident: (number, i)
            for number, block in enumerate(self.equations.blocks)
            if not block.prior
            for i, ident in enumerate(block.ids)
        }
        every = [found[str(i)] for i in range(self.n)]
        both: Index = np.array(every, dtype=np.intp).reshape(-1, 2)
        return both[:, 0], both[:, 1]

    def tiled(self, numbers: Index, targets: Index, stations: Index | None = None) -> Block:
        """Return templates of one block to other points.

        Args:
            numbers: template of each sight, (m,).
            targets: point at which it ends, (m,).
            stations: point at which it begins; None: the station of the template.
        """
        of_block, row = self.rows_of_templates
        block = self.equations.blocks[int(of_block[numbers[0]])]
        rows = row[numbers]
        whole = block.by_role()
        ends = {"target": targets} if stations is None else {"target": targets, "station": stations}
        variables = []
        for (kind, index), attribute in zip(whole.variables, whole.named, strict=True):
            chosen = index[rows]
            if attribute in ends and kind == "point":
                chosen = ends[attribute]
            elif attribute in ends:
                table = self.equations.unknowns[kind]
                own = [table.number.get(n, table.number[DEFAULT]) for n in self.names]
                chosen = np.array(own, dtype=np.intp)[ends[attribute]]
            variables.append((kind, chosen))
        ids = [block.ids[i] for i in rows.tolist()]
        return replace(
            whole,
            variables=tuple(variables),
            observed=block.observed[rows],
            sigma=block.sigma[rows],
            ids=ids,
            labels=lambda i: block.labels(int(rows[i])),
            whitener=None,
            constants={k: v[rows] for k, v in block.constants.items()},
            axes=None,
        )

    def _weighed(self, block: Block, residual: Array) -> Block:
        """Return a block with the standard deviations of the lengths of its sights."""
        network = self.equations.network
        given = {i: network.observations[i] for i in dict.fromkeys(block.ids)}
        of_parts = {i for i, o in given.items() if isinstance(o.sigma, StandardDeviation)}  # type: ignore[attr-defined]
        some = np.array(
            [i for i, ident in enumerate(block.ids) if ident in of_parts], dtype=np.intp
        )
        if not len(some):
            return block
        # Some parts take the reading itself as the length.
        read = replace(block, observed=block.moved(residual)).select(some)
        sigma = block.sigma.copy()
        originals = [given[ident] for ident in read.ids]
        sigma[some, 0] = sigma_at(network.frame, read, originals, self.state)
        return replace(block, sigma=sigma)

    def partials(self, block: Block) -> tuple[Index, list[Array]]:
        """Return the rows of a block that have partials, and these, (k, 1, width) by each role."""
        rows, frame = np.arange(block.n), self.equations.network.frame
        while len(rows):
            own = block if len(rows) == block.n else block.select(rows)
            try:
                found = own.evaluate(frame, self.state)
            except InputError:  # sights straight up have no direction
                rows = np.delete(rows, own.degenerate(frame, self.state))
                continue
            own = self._weighed(own, found.residual)
            return rows, [own.whiten(a) for a in found.jacobians]
        return rows, []
