"""Reader of targets and candidates from a TOML file and its table of observations.

    [[target]]
    kind = "semi_axis"                  # and at_most or at_least, points, observations …
    at_most_mm = 1.5                    # or at_most = 0.0015, metres
    points = ["P*"]

    [[candidate]]
    name = "photo from the gallery"
    cost = 5
    observations = [{kind = "image", photo = "F9", point = "P1", sigma_um = 3}]
    [[candidate.photos]]                # columns of photos.csv
    name = "F9"
    camera = "C"
    x = 12.0
    y = -8.5
    z = 4.2
    omega = 95.0
    phi = 10.0
    kappa = 0.0

    [[candidate]]
    name = "set-up S3"                  # its sights stand in the table
    points = [{name = "S3", x = 40.0, y = -50.0, z = 1.5}]         # columns of points.csv

    [files]
    candidates = "candidates.csv"       # columns of observations.csv, and candidate and cost

Rows of the table that name the same candidate belong together, with the entries of a
``[[candidate]]`` of that name; one of these places, or several, states the cost. New points and
photos are given only in the TOML file. Readings are optional.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..entities import Key, Parameter, Photo, Point, parameter_name
from ..errors import InputError, Problem, known, unknown_name
from ..files import inside
from ..io.csv_tables import FieldRow, read_table
from ..io.json_records import observation_of, photo_of, point_of, unknown_of
from ..io.observation_fields import NAME_FIELDS, ImageAxes
from ..io.observation_records import record_with_reading
from ..io.project import Project
from ..io.text_files import parse_toml, read_text
from ..models.unknown_registry import VariableKind, unknown_kind
from ..observations import AnyObservation, Correlated
from ..simulation.planned_values import with_defaults, without_values
from ..units import LENGTH
from .candidates import Candidate, dependent, identified, with_candidates
from .targets import TARGETS, DetectableError, RedundancyNumber, Target, check_targets

CANDIDATE_KEYS = ("name", "cost", "points", "photos", "unknowns", "observations")
IN_MM = "at_most_mm"
"""Key for the limit of a length in millimetres."""


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


@dataclass(frozen=True, eq=False)
class Wishes:
    """Content of a file."""

    targets: tuple[Target, ...]
    """Targets of the design."""
    candidates: tuple[Candidate, ...]
    """Candidates for additions."""


def read_wishes(path: str | Path, project: Project, *, candidates: bool = True) -> Wishes:
    """Read targets and candidates.

    Args:
        path: the file.
        project: the project with units, default standard deviations and frame, and with the
            points, photos and cameras that observations name.
        candidates: whether to read the candidates. Without them the file is also valid for a
            design that contains some of them already.

    Raises:
        InputError: all errors of the file, by file and key, or file and line.
    """
    path = Path(path)
    problems: list[Problem] = []
    document = parse_toml(read_text(path), path.name)
    top = FieldRow(document, path.name, problems)
    for key in document:
        if key not in ("target", "candidate", "files"):
            top.wrong(unknown_name("key", key, ("target", "candidate", "files")))
    targets = [
        target_of(t, f"{path.name}: target {n}", problems)
        for n, t in enumerate(tables(document, "target", top), 1)
    ]
    drafts = Drafts(project, problems)
    table = _table_file(document, top)
    if candidates:
        for n, c in enumerate(tables(document, "candidate", top), 1):
            drafts.add_record(c, f"{path.name}: candidate {n}")
        if table is not None:
            try:
                drafts.add_table(inside(path.parent, table, f"{path.name}: files"))
            except InputError as error:
                problems += error.problems
    good = tuple(t for t in targets if t is not None)
    if len(good) == len(targets):
        try:
            check_targets(good, list(project.network.points))
        except InputError as error:
            problems += [Problem(p.what, f"{path.name}: {p.where}") for p in error.problems]
    found = drafts.candidates()
    if problems:
        raise InputError(problems)
    return Wishes(good, found)


def _table_file(document: Mapping[str, Any], top: FieldRow) -> str | None:
    """Return the name of the table of candidates; None without a table."""
    given = document.get("files", {})
    if not isinstance(given, dict):
        top.wrong("files must be a table: write [files]")
        return None
    for key in given:
        if key != "candidates":
            top.wrong(f"unknown key {key!r} in [files]; known: {known(('candidates',), meant=key)}")
    name = given.get("candidates")
    if name is not None and not isinstance(name, str):
        top.wrong(f"candidates in [files] must be the name of a file, not {name!r}")
        return None
    return name


def target_of(given: Mapping[str, Any], where: str, problems: list[Problem]) -> Target | None:
    """Return the target of a record, noting its problems; None where it has any.

    Args:
        given: ``kind``, a key of `factorgraph_adj.planning.targets.TARGETS`, and its fields; of
            lengths ``at_most`` in metres or ``at_most_mm``.
        where: place of the record, for messages.
        problems: takes what is wrong.
    """
    kind = given.get("kind")
    if kind not in TARGETS:
        what = "kind is missing" if kind is None else f"unknown kind {kind!r}"
        problems.append(Problem(f"{what}; valid: {known(TARGETS, meant=kind, most=40)}", where))
        return None
    cls = TARGETS[cast(str, kind)]
    valid = {f.name: f for f in fields(cls)}
    length = not issubclass(cls, RedundancyNumber | DetectableError)
    offered = [n for f in valid for n in ((f, IN_MM) if length and f == "at_most" else (f,))]
    before = len(problems)
    arguments: dict[str, Any] = {}
    for key, value in given.items():
        if key == "kind":
            continue
        if key not in offered:
            problems.append(Problem(unknown_name("key", key, offered, most=40), where))
        elif key in ("points", "observations", "reference"):
            names = [value] if isinstance(value, str) else value
            if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
                problems.append(Problem(f"{key} must be a list of names or patterns", where))
            else:
                arguments[key] = tuple(names)
        elif key == "axes":
            arguments[key] = str(value)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            problems.append(Problem(f"{key} must be a number, not {value!r}", where))
        elif key == IN_MM:
            arguments["at_most"] = float(value) * LENGTH["mm"]
        else:
            arguments[key] = value if key == "dimension" else float(value)
    if IN_MM in offered and IN_MM in given and "at_most" in given:
        problems.append(Problem(f"give only one of at_most (metres) and {IN_MM}", where))
    stated = {*given, *(("at_most",) if IN_MM in given else ())}
    problems += [
        Problem(
            f"{f.name} is missing" + (f": metres, or {IN_MM}" if f"{f.name}_mm" in offered else ""),
            where,
        )
        for f in valid.values()
        if f.default is MISSING and f.name not in stated
    ]
    if arguments.get("dimension", 2) not in (2, 3):
        problems.append(Problem("dimension must be 2 or 3", where))
    return cls(**arguments) if len(problems) == before else None
