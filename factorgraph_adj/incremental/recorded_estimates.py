"""What a journal has of estimates, so that `resume` begins where everything was.

A line has the estimates of unknowns that became known with it, and of points that readings have
moved to their other sides. Once more observations have changed than unknowns are known, when the
adjustment settles and when something is retired, a line has all estimates: these take less room
than the observations. Every line has vᵀPv, with which `resumption` compares what it reaches.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..graph.dependence import Variable
from ..ledger.candidates import Candidates, NothingKnown
from ..ledger.ledger import Ledger
from ..ledger.row_store import REMOVED
from ..linear_system.linear_system import LinearSystem
from ..models.variables import ROTATION, UNKNOWNS
from ..types import NO_ROWS, Array, Index
from .worklist import IncrementalState

Estimates: TypeAlias = dict[Variable, Array]
"""Values of unknowns, as in a state."""
MAX_ORTHOGONALITY_ERROR = 1e-6
"""Largest deviation of R Rᵀ from I of a rotation in a journal."""


class RecordedLine(NamedTuple):
    """What the next line says of estimates."""

    estimates: Estimates
    """The estimates."""
    vtpv: float
    """VᵀPv; NaN where there is none."""
    lost: set[Variable]
    """Unknowns that are not known any more."""
    changed: int
    """Number of observations that will have changed since a line had all estimates."""

    def fields(self) -> dict[str, Any]:
        """Return the fields of the line."""
        out: dict[str, Any] = {}
        for (kind, name), value in self.estimates.items():
            out.setdefault("estimates", {}).setdefault(kind, {})[name] = value.tolist()
        return out | ({"vtpv": self.vtpv} if math.isfinite(self.vtpv) else {})


class RecordedEstimates:
    """Which estimates a journal has."""

    def __init__(self) -> None:
        """Begin with a journal that has none."""
        self._known: set[Variable] = set()
        self._changed = 0

    def next_line(
        self, before: Ledger, after: IncrementalState, *, everything: bool = False
    ) -> RecordedLine:
        """Return what the next line says; `written` takes it over.

        Args:
            before: the ledger of the line before.
            after: the state.
            everything: whether the line has all estimates in any case.
        """
        ledger, system = after.ledger, after.system
        if system is None:
            return RecordedLine({}, np.nan, self._known, 0)
        rows = NO_ROWS if everything else _changed(before, ledger)
        changed = self._changed + len(rows)
        if everything or changed > len(self._known):
            found = all_estimates(system)
            return RecordedLine(found, system.vtpv, self._known - found.keys(), 0)
        touched = {*Candidates(ledger, NothingKnown(), rows).links.variables}
        lost = {v for v in touched & self._known if not system.known(*v)}
        wanted = touched - self._known
        if ledger.sides != before.sides:
            wanted |= {("point", side.point) for side in ledger.sides.values()}
        return RecordedLine(_estimates(system, wanted), system.vtpv, lost, changed)

    def written(self, line: RecordedLine) -> None:
        """Take over what a line says that has been written."""
        self._known -= {*line.lost}
        self._known |= line.estimates.keys()
        self._changed = line.changed


def _changed(before: Ledger, after: Ledger) -> Index:
    """Return the rows of which something else has become."""
    was = np.full(after.rows.n, REMOVED, dtype=np.int8)
    was[: before.rows.n] = before.rows.status
    return np.flatnonzero(was != after.rows.status)


def read_estimates(line: Mapping[str, Any]) -> Estimates:
    """Return the estimates of a line.

    Raises:
        ValueError: rotations are none, or vᵀPv is no number.
        TypeError, AttributeError: these are no estimates.
    """
    out: Estimates = {}
    for kind, values in line.get("estimates", {}).items():
        for name, given in values.items():
            value: Array = np.array(given, dtype=float)
            if value.ndim != 1 or not np.isfinite(value).all():
                raise ValueError(f"{given!r:.40} is no estimate of {name!r}")
            if UNKNOWNS[kind].rotates:
                r = value[:ROTATION].reshape(3, 3)
                if not np.abs(r @ r.T - np.eye(3)).max() < MAX_ORTHOGONALITY_ERROR:
                    raise ValueError(f"the estimate of {name!r} has no rotation")
            out[kind, name] = value
    if not math.isfinite(line.get("vtpv", 0.0)):
        raise ValueError("vtpv is no number")
    return out


def all_estimates(system: LinearSystem) -> Estimates:
    """Return the estimates of all known unknowns."""
    out: Estimates = {}
    constant: set[Variable] = set()
    for unknowns, state, _ in system.places():
        for kind, table in unknowns.tables.items():
            every = zip(table.names, state[kind], table.offset.tolist(), strict=True)
            for name, value, offset in every:
                if offset >= 0:
                    out[kind, name] = value
                else:
                    constant.add((kind, name))
    others = ((kind, name) for kind in UNKNOWNS for name in system.names(kind))
    return out | _estimates(system, {*others} - out.keys() - constant)


def _estimates(system: LinearSystem, variables: Iterable[Variable]) -> Estimates:
    """Return the estimates of those of some unknowns that are known."""
    found = {v: system.value(*v) for v in variables}
    return {v: x for v, x in found.items() if x is not None and np.isfinite(x).all()}
