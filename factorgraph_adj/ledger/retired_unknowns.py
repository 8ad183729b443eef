"""Archive of retired unknowns: their last estimates and observations, and messages that name them.

It has the last estimate and covariance of every retired unknown, by name, and the observations of
them, as a line of the journal that adds them again. It is deleted with the adjustment: the journal
has the same, and fills another archive when it is resumed.
"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ..entities import FREE_ORIENTATION, Key, Photo, Point, parameter_name
from ..errors import Problem, known
from ..graph.dependence import Variable
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import Observation
from ..solve.added_factors import Prior
from ..solve.marginalisation import NO_MISSED_STEP, MissedStep
from ..types import Array

TABLES = """
CREATE TABLE retirement (number INTEGER PRIMARY KEY, moment TEXT, line BLOB);
CREATE TABLE unknown (kind TEXT, name TEXT, number INTEGER, value BLOB, covariance BLOB,
    PRIMARY KEY (kind, name)) WITHOUT ROWID;
CREATE TABLE observation (id TEXT PRIMARY KEY, number INTEGER) WITHOUT ROWID;
CREATE INDEX of_unknowns ON unknown (number);
CREATE INDEX of_observations ON observation (number);
"""
TAKES_BACK = "settle(all=True) takes everything back"


class LastEstimate(NamedTuple):
    """Estimate of an unknown at its retirement."""

    kind: VariableKind
    """Its kind."""
    name: str
    """Its name."""
    moment: str
    """When it was retired, in words."""
    value: Array | None
    """Its value as in a state; None: it was not determined."""
    covariance: Array | None
    """Covariance of its components, σ0 = 1; None: it was not determined."""


class Archive:
    """The retired unknowns and observations of one adjustment."""

    def __init__(self) -> None:
        """Begin an empty archive."""
        # An empty name is that of a temporary file, which is deleted with the connection.
        self._database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
        self._database.executescript(TABLES)

    @property
    def size(self) -> int:
        """Size of the database, bytes."""
        pages, size = (
            self._database.execute(f"PRAGMA {what}").fetchone()[0]
            for what in ("page_count", "page_size")
        )
        return int(pages * size)

    def put(
        self,
        number: int,
        moment: str,
        unknowns: Iterable[LastEstimate],
        ids: Collection[str],
        line: Mapping[str, Any],
    ) -> None:
        """Store what is retired; records from this number on are deleted.

        Args:
            number: number of the retirement.
            moment: moment of the retirement, in words.
            unknowns: the unknowns.
            ids: ids of their observations, without image points that have no ids of their own.
            line: the line that adds all of it again.
        """
        run = self._database.execute
        run("BEGIN")
        try:
            for table in ("retirement", "unknown", "observation"):
                run(f"DELETE FROM {table} WHERE number >= ?", (number,))
            packed = zlib.compress(json.dumps(line).encode(), 1)
            run("INSERT INTO retirement VALUES (?, ?, ?)", (number, moment, packed))
            self._database.executemany(
                "INSERT INTO unknown VALUES (?, ?, ?, ?, ?)",
                (
                    (u.kind, u.name, number, _packed(u.value), _packed(u.covariance))
                    for u in unknowns
                ),
            )
            self._database.executemany(
                "INSERT INTO observation VALUES (?, ?)", ((i, number) for i in ids)
            )
        except BaseException:
            run("ROLLBACK")
            raise
        run("COMMIT")

    def find(self, variable: Variable, upto: int) -> LastEstimate | None:
        """Return the estimate of an unknown at its retirement; None where it was not retired.

        Args:
            variable: the unknown.
            upto: number of the last retirement that counts.
        """
        row = self._database.execute(
            "SELECT moment, value, covariance FROM unknown JOIN retirement USING (number) "
            "WHERE kind = ? AND name = ? AND number <= ?",
            (*variable, upto),
        ).fetchone()
        if row is None:
            return None
        value, covariance = (None if x is None else np.frombuffer(x) for x in row[1:])
        if covariance is not None:
            covariance = covariance.reshape(2 * (round(len(covariance) ** 0.5),))
        return LastEstimate(*variable, row[0], value, covariance)

    def moment_of(self, ident: str, upto: int) -> str:
        """Return when an observation with its own id was retired; empty: it was not."""
        row = self._database.execute(
            "SELECT moment FROM observation JOIN retirement USING (number) "
            "WHERE id = ? AND number <= ?",
            (ident, upto),
        ).fetchone()
        return "" if row is None else str(row[0])

    def lines(self, upto: int) -> Iterator[dict[str, Any]]:
        """Iterate over the lines that add everything again, the last retirement first.

        Retired observations may name unknowns that remained then and were retired later.
        """
        for (line,) in self._database.execute(
            "SELECT line FROM retirement WHERE number <= ? ORDER BY number DESC", (upto,)
        ):
            yield json.loads(zlib.decompress(line))

    def determined(self, upto: int) -> Iterator[tuple[Variable, Array]]:
        """Iterate over the retired unknowns that were determined, with their last values."""
        for kind, name, value in self._database.execute(
            "SELECT kind, name, value FROM unknown WHERE number <= ? AND value NOT NULL", (upto,)
        ):
            yield (kind, name), np.frombuffer(value)


def _packed(x: Array | None) -> bytes | None:
    return None if x is None else np.ascontiguousarray(x, dtype=float).tobytes()


@dataclass(frozen=True, eq=False)
class Retired:
    """Everything that was retired."""

    prior: Prior
    """Information of the retired observations on the unknowns that remain."""
    archive: Archive = field(default_factory=Archive)
    """Archive of the retired unknowns and observations."""
    number: int = 0
    """Number of retirements."""
    points: int = 0
    """Number of retired points."""
    photos: int = 0
    """Number of retired photos."""
    observations: int = 0
    """Number of observations that were in the graph."""
    held_points: tuple[str, ...] = ()
    """Names of those of these points whose coordinates were all held."""
    found: tuple[tuple[VariableKind, Key], ...] = ()
    """Unknowns of the prior that nobody has to state, such as orientations."""
    missed: MissedStep = NO_MISSED_STEP
    """Deviation of the linear rows."""

    def last_estimate(self, variable: Variable) -> LastEstimate | None:
        """Return the estimate of an unknown at its retirement; None: it was not retired."""
        return self.archive.find(variable, self.number)

    def retirement_note(self, variable: Variable) -> str:
        """Return that an unknown was retired, and what to do; empty where it was not."""
        found = self.last_estimate(variable)
        return "" if found is None else f"was retired {found.moment}; {TAKES_BACK}"

    def of_id(self, ident: str) -> str:
        """Return that an observation was retired, and what to do; empty where it was not."""
        if moment := self.archive.moment_of(ident, self.number):
            return f"was retired {moment}; {TAKES_BACK}"
        at = ident.find("/")
        while at >= 0:
            both: tuple[Variable, ...] = ("pose", ident[:at]), ("point", ident[at + 1 :])
            for variable in both:
                if note := self.retirement_note(variable):
                    return f"{UNKNOWNS[variable[0]].noun} {variable[1]!r} {note}"
            at = ident.find("/", at + 1)
        return ""

    def named_by(self, o: Observation, network: Network) -> list[Problem]:
        """Return the problems of an observation that names a retired unknown, or has a retired id.

        Args:
            o: the observation.
            network: the network that remains.
        """
        variables: list[Variable] = [("point", n) for n in o.points() if n not in network.points]
        variables += [("pose", name) for name in o.photos() if name not in network.photos]
        variables += [
            (kind, parameter_name(key))
            for kind, key in o.parameters()
            if UNKNOWNS[kind].absent == "found"
        ]
        out = []
        for variable in dict.fromkeys(variables):
            if note := self.retirement_note(variable):
                what = f"{UNKNOWNS[variable[0]].noun} {variable[1]!r} {note}"
                out.append(Problem(f"{what}, and then this observation can be added", o.label()))
        ident = o.id
        if not out and ident is not None and (moment := self.archive.moment_of(ident, self.number)):
            what = f"duplicate id {ident!r}: the observation with it was retired {moment}"
            out.append(Problem(f"{what}; give the new one another id", o.label()))
        return out

    def named_again(self, points: Iterable[Point], photos: Iterable[Photo]) -> list[Problem]:
        """Return the problems of new points or photos with names of retired ones."""
        new: list[Variable] = [("point", p.name) for p in points]
        new += [("pose", f.name) for f in photos]
        return [
            Problem(
                f"one of this name {note}; or give the new one another name", f"{noun} {name!r}"
            )
            for kind, name in new
            for noun in (UNKNOWNS[kind].noun,)
            if (note := self.retirement_note((kind, name)))
        ]

    def state_found(self, network: Network) -> None:
        """State the unknowns of the prior that nobody has to state."""
        for kind, key in self.found:
            network.of_kind(kind).setdefault(key, FREE_ORIENTATION)

    def __str__(self) -> str:
        """Return the numbers of retired points, photos and observations, and the held points."""
        held = f" (held: {known(self.held_points)})" if self.held_points else ""
        return (
            f"{self.observations} observations with {self.points} points{held} and {self.photos} "
            "photos are retired"
        )
