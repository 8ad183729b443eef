"""Drafts of candidates, collected from a TOML file and its table of observations.

See `factorgraph_adj.planning.target_files`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..entities import Key, Parameter, Photo, Point, parameter_name
from ..errors import InputError, Problem, known, unknown_name
from ..io.csv_tables import FieldRow, read_table
from ..io.json_records import observation_of, photo_of, point_of, unknown_of
from ..io.observation_fields import NAME_FIELDS, ImageAxes
from ..io.observation_records import record_with_reading
from ..io.project import Project
from ..models.variables import VariableKind, unknown_kind
from ..observations import AnyObservation, Correlated
from ..simulation.given_values import with_defaults, without_values
from .candidates import Candidate, dependent, identified, with_candidates

CANDIDATE_KEYS = ("name", "cost", "points", "photos", "unknowns", "observations")


def tables(document: Mapping[str, Any], key: str, top: FieldRow) -> list[Mapping[str, Any]]:
    """Return the tables [[key]]; another value is noted as a problem and gives an empty list."""
    given = document.get(key, [])
    if not isinstance(given, list) or not all(isinstance(t, dict) for t in given):
        top.wrong(f"{key} must be a list of tables: write [[{key}]]")
        return []
    return given


@dataclass
class _Draft:
    """The parts of a candidate that have been read."""

    where: str
    """File and place that names the candidate first."""
    cost: float | None = None
    cost_from: str = ""
    """File and place that states the cost."""
    observations: list[AnyObservation] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    photos: list[Photo] = field(default_factory=list)
    unknowns: dict[VariableKind, dict[Key, Parameter]] = field(default_factory=dict)
    unread: set[str] = field(default_factory=set)
    """Keys with errors: points, photos, unknowns, observations."""


class Drafts:
    """Candidates by name, from both files."""

    def __init__(self, project: Project, problems: list[Problem]) -> None:
        self.network, self.context, self.problems = project.network, project.context, problems
        self.found: dict[str, _Draft] = {}

    def add_record(self, given: Mapping[str, Any], where: str) -> None:
        """Read a [[candidate]]."""
        row = FieldRow(given, where, self.problems)
        for key in given:
            if key not in CANDIDATE_KEYS:
                row.wrong(unknown_name("key", key, CANDIDATE_KEYS, most=40))
        name = row.text("name", required=True)
        if name in self.found:
            row.wrong(f"there are two of the name {name!r}")
        draft = _Draft(where)
        if name is not None:
            draft = self.found.setdefault(name, draft)
        self._take_cost(draft, given.get("cost"), row)
        readers: tuple[tuple[str, Callable[..., Point | Photo] | None], ...] = (
            ("points", point_of),
            ("photos", photo_of),
            ("observations", None),
        )
        for key, read in readers:
            before = len(self.problems)
            for n, record in enumerate(tables(given, key, row), 1):
                self._take(draft, key, read, record, f"{where}: {key} {n}")
            if len(self.problems) > before:
                draft.unread.add(key)
        for n, record in enumerate(tables(given, "unknowns", row), 1):
            self._take_unknown(draft, record, f"{where}: unknowns {n}")
        self._placed(draft, where)

    def add_table(self, path: Path) -> None:
        """Read a table of candidates."""
        table = read_table(path, self.problems)
        if table is None:
            return
        if "candidate" not in table.columns:
            self.problems.append(Problem("has no column candidate", table.name))
            return
        if not table.rows:
            self.problems.append(Problem("has a header, but no rows", table.name))
        for line, record in table.records():
            where = table.where(line)
            row = FieldRow(record, where, self.problems)
            name = row.text("candidate", required=True)
            draft = _Draft(where)
            if name is not None:
                row.of = f"candidate {name!r}"
                draft = self.found.setdefault(name, draft)
            self._take_cost(draft, record.get("cost"), row, text=True)
            rest = {k: v for k, v in record.items() if k not in ("candidate", "cost")}
            self._take(draft, "observations", None, rest, where)

    def candidates(self) -> tuple[Candidate, ...]:
        """Return the candidates; note errors within them and conflicts with the network."""
        out = []
        for name, d in self.found.items():
            if not d.observations and "observations" not in d.unread:
                self.problems.append(
                    Problem(
                        f"candidate {name!r} has no observations, neither here nor in a table of "
                        "candidates",
                        d.where,
                    )
                )
            cost = 1.0 if d.cost is None else d.cost
            parts = (tuple(d.points), tuple(d.photos))
            out.append(Candidate(name, tuple(d.observations), cost, *parts, unknowns=d.unknowns))
        fitting = self._named([c for c in out if not self.found[c.name].unread - {"observations"}])
        wrong = dependent(fitting, self.network)
        if not wrong:
            try:
                with_candidates(self.network, identified(fitting))
            except InputError as error:
                wrong += error.problems
        self.problems += [self._with_file(p) for p in wrong]
        return tuple(out)

    def _with_file(self, problem: Problem) -> Problem:
        """Return a problem of a candidate, with its file if the problem names none."""
        for name, d in self.found.items():
            file = d.where.partition(":")[0]
            if problem.where.startswith(f"candidate {name!r}") and file not in problem.where:
                return replace(problem, where=f"{d.where}: {problem.where}")
        return problem

    def _take_cost(
        self, draft: _Draft, given: object, row: FieldRow, *, text: bool = False
    ) -> None:
        if given is None:
            return
        try:
            # A cell of a table is text; a value in TOML must be a number.
            valid = str if text else (int, float)
            if isinstance(given, bool) or not isinstance(given, valid):
                raise ValueError
            cost = float(cast(str, given))
        except ValueError:
            row.wrong(f"cost must be a number, not {given!r}")
            return
        if not (np.isfinite(cost) and cost > 0):
            row.wrong(f"cost must be greater than zero, not {given}")
        elif draft.cost is None:
            draft.cost, draft.cost_from = cost, row.where
        elif draft.cost != cost:
            row.wrong(f"cost is {cost:g} here, but {draft.cost:g} in {draft.cost_from}")

    def _take(
        self,
        draft: _Draft,
        key: str,
        read: Callable[..., Point | Photo] | None,
        record: Mapping[str, Any],
        source: str,
    ) -> None:
        """Read a point, a photo or, without a function for it, an observation."""
        try:
            if read is None:
                record = record_with_reading(record)
                item = observation_of(record, context=self.context, source=source)
                draft.observations.append(item)
                return
            found = read(record, context=self.context, frame=self.network.frame, source=source)
        except InputError as error:
            self.problems.extend(error.problems)
            draft.unread.add(key)
            return
        if isinstance(found, Point):
            draft.points.append(found)
            return
        draft.photos.append(found)
        # The image points of the photo may be in the table.
        axes = self.context.cameras.get(found.camera, ImageAxes())
        images = {**self.context.images, found.name: axes}
        self.context = replace(self.context, images=images)

    def _take_unknown(self, draft: _Draft, record: Mapping[str, Any], source: str) -> None:
        """Read an unknown other than points and photos."""
        try:
            kind, key, found = unknown_of(record, context=self.context, source=source)
        except InputError as error:
            self.problems.extend(error.problems)
            draft.unread.add("unknowns")
            return
        there = draft.unknowns.setdefault(kind, {})
        where = f"{source}: {unknown_kind(kind).noun} {parameter_name(key)!r}"
        if key in there:
            self.problems.append(Problem("there are two of this name", where))
        of = unknown_kind(kind)
        lacking = without_values(of, with_defaults(of, found), where)
        if lacking is not None:
            self.problems.append(lacking)
            draft.unread.add("unknowns")
        there[key] = found

    def _placed(self, draft: _Draft, where: str) -> None:
        """Note new points and photos without a position."""
        for p in draft.points:
            missing = [a for a, v in zip("xyz", p.coordinates, strict=True) if not np.isfinite(v)]
            if missing:
                what = f"a plan needs its coordinates; {', '.join(missing)} missing"
                self.problems.append(Problem(what, f"{where}: point {p.name!r}"))
        for f in draft.photos:
            parts = {"position (x, y, z)": f.position, "rotation (omega, phi, kappa)": f.rotation}
            missing = [name for name, value in parts.items() if value is None]
            if missing:
                what = f"a plan needs its position and rotation; {' and '.join(missing)} missing"
                self.problems.append(Problem(what, f"{where}: photo {f.name!r}"))

    def _named(self, candidates: Iterable[Candidate]) -> list[Candidate]:
        """Drop observations of unknown points and photos; note each unknown name once."""
        old: dict[str, Iterable[str]] = {
            "point": self.network.points,
            "photo": self.network.photos,
        }
        there = {what: set(names) for what, names in old.items()}
        for d in self.found.values():
            there["point"] |= {p.name for p in d.points}
            there["photo"] |= {f.name for f in d.photos}
        out = []
        for c in candidates:
            lost: dict[tuple[str, str], list[str]] = {}
            kept = []
            for item in c.observations:
                nowhere = {(what, name) for what, name in _names(item) if name not in there[what]}
                for missing in nowhere:
                    lost.setdefault(missing, []).append(_source(item))
                if not nowhere:
                    kept.append(item)
            for (what, name), places in lost.items():
                times = f" in {len(places)} observations" if len(places) > 1 else ""
                text = (
                    f"unknown {what} {name!r}{times}; a new one stands among the {what}s of "
                    f"[[candidate]] name = {c.name!r} in the TOML file; known: "
                    f"{known(old[what], meant=name)}"
                )
                self.problems.append(Problem(text, f"{places[0]}: candidate {c.name!r}"))
            if kept:
                out.append(replace(c, observations=tuple(kept)))
        return out


def _names(item: AnyObservation) -> list[tuple[str, str]]:
    """Return kind (point or photo) and name of all entities that an observation names."""
    members: Sequence[Any] = item.observations if isinstance(item, Correlated) else (item,)
    return [
        ("photo" if key == "photo" else "point", getattr(o, key))
        for o in members
        for key in NAME_FIELDS
        if hasattr(o, key)
    ]


def _source(item: AnyObservation) -> str:
    first: Any = item.observations[0] if isinstance(item, Correlated) else item
    return str(first.source or "")
