"""Targets and candidates in a TOML file.

    [[target]]
    kind = "semi_axis"                  # and at_most or at_least, points, observations …
    at_most = 0.0015                    # metres
    points = ["P*"]

    [[candidate]]
    name = "photo from the gallery"
    cost = 5
    photos = [{name = "F9", camera = "C", X0 = 1.0, …}]            # columns of photos.csv
    observations = [{kind = "image", photo = "F9", point = "P1", sigma_um = 3}]

    [files]
    candidates = "candidates.csv"       # columns of observations.csv, and candidate and cost

Rows of the table that name the same candidate are made together; the cost stands in one of them,
or in all. Readings are not needed.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, cast

from ..entities import Photo, Point
from ..errors import InputError, Problem
from ..io.json_records import observation_of, photo_of, point_of
from ..io.project import Project
from ..io.records import with_reading
from ..io.tables import Row, read_table
from ..observations import AnyObservation
from .candidates import Candidate
from .targets import TARGETS, Target


@dataclass(frozen=True, eq=False)
class Wishes:
    """What a file says."""

    targets: tuple[Target, ...]
    """Targets."""
    candidates: tuple[Candidate, ...]
    """Candidates."""


def read_wishes(path: str | Path, project: Project) -> Wishes:
    """Read targets and candidates.

    Args:
        path: the file.
        project: has the units, default standard deviations and frame.

    Raises:
        InputError: everything that is wrong with it, by file and key, or file and line.
    """
    path = Path(path)
    problems: list[Problem] = []
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(Problem(f"cannot be read: {error.strerror}", str(path))) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(Problem(f"is not TOML: {error}", path.name)) from None
    top = Row(document, path.name, problems)
    for key in document:
        if key not in ("target", "candidate", "files"):
            top.wrong(f"unknown key {key!r}; known: target, candidate, files")
    targets = [
        _target(t, f"{path.name}: target {n}", problems)
        for n, t in enumerate(_tables(document, "target", top), 1)
    ]
    found = [
        _candidate(c, f"{path.name}: candidate {n}", project, problems)
        for n, c in enumerate(_tables(document, "candidate", top), 1)
    ]
    files = document.get("files", {})
    if isinstance(files, dict) and "candidates" in files:
        found += _table(path.parent / str(files["candidates"]), project, problems)
    if problems:
        raise InputError(problems)
    return Wishes(
        tuple(t for t in targets if t is not None), tuple(c for c in found if c is not None)
    )


def _tables(document: Mapping[str, Any], key: str, top: Row) -> list[Mapping[str, Any]]:
    given = document.get(key, [])
    if not isinstance(given, list) or not all(isinstance(t, dict) for t in given):
        top.wrong(f"{key} must be a list of tables: write [[{key}]]")
        return []
    return given


def _target(given: Mapping[str, Any], where: str, problems: list[Problem]) -> Target | None:
    kind = given.get("kind")
    if kind not in TARGETS:
        problems.append(Problem(f"unknown kind {kind!r}; valid: {', '.join(TARGETS)}", where))
        return None
    cls = TARGETS[cast(str, kind)]
    known = {f.name: f for f in fields(cls)}
    before = len(problems)
    arguments: dict[str, Any] = {}
    for key, value in given.items():
        if key == "kind":
            continue
        if key not in known:
            problems.append(Problem(f"unknown key {key!r}; known: {', '.join(known)}", where))
        elif key in ("points", "observations"):
            names = [value] if isinstance(value, str) else value
            if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
                problems.append(Problem(f"{key} must be a list of names or patterns", where))
            else:
                arguments[key] = tuple(names)
        elif key == "axes":
            arguments[key] = str(value)
        elif isinstance(value, bool) or not isinstance(value, int | float):
            problems.append(Problem(f"{key} must be a number, not {value!r}", where))
        else:
            arguments[key] = value if key == "dimension" else float(value)
    problems += [
        Problem(f"{f.name} is missing", where)
        for f in known.values()
        if f.default is MISSING and f.name not in given
    ]
    if arguments.get("dimension", 2) not in (2, 3):
        problems.append(Problem("dimension must be 2 or 3", where))
    return cls(**arguments) if len(problems) == before else None


def _candidate(
    given: Mapping[str, Any], where: str, project: Project, problems: list[Problem]
) -> Candidate | None:
    known = ("name", "cost", "points", "photos", "observations")
    row = Row(given, where, problems)
    for key in given:
        if key not in known:
            row.wrong(f"unknown key {key!r}; known: {', '.join(known)}")
    name = row.text("name", required=True)
    cost = given.get("cost", 1.0)
    if isinstance(cost, bool) or not isinstance(cost, int | float):
        row.wrong(f"cost must be a number, not {cost!r}")
        return None
    network, context = project.network, project.context
    frame = network.frame
    parts: dict[str, list[Any]] = {"points": [], "photos": [], "observations": []}
    for key, out in parts.items():
        for n, record in enumerate(_tables(given, key, row), 1):
            source = f"{where}: {key} {n}"
            try:
                if key == "points":
                    out.append(point_of(record, context=context, frame=frame, source=source))
                elif key == "photos":
                    out.append(photo_of(record, context=context, frame=frame, source=source))
                else:
                    out.append(_observation(record, project, source))
            except InputError as error:
                problems.extend(error.problems)
    if row.failed or name is None:
        return None
    return Candidate(
        name,
        tuple(cast(list[AnyObservation], parts["observations"])),
        float(cost),
        tuple(cast(list[Point], parts["points"])),
        tuple(cast(list[Photo], parts["photos"])),
    )


def _observation(record: Mapping[str, Any], project: Project, source: str) -> AnyObservation:
    return observation_of(with_reading(record), context=project.context, source=source)


def _table(path: Path, project: Project, problems: list[Problem]) -> list[Candidate]:
    """Read a table of candidates."""
    table = read_table(path, problems)
    if table is None:
        return []
    if "candidate" not in table.columns:
        problems.append(Problem("has no column candidate", table.name))
        return []
    found: dict[str, list[AnyObservation]] = {}
    costs: dict[str, float] = {}
    for line, record in table.records():
        row = Row(record, table.where(line), problems)
        name = row.text("candidate", required=True)
        if "cost" in record and name is not None:
            try:
                cost = float(record["cost"])
            except ValueError:
                row.wrong(f"cost must be a number, not {record['cost']!r}")
                continue
            if costs.setdefault(name, cost) != cost:
                row.wrong(f"candidate {name!r} costs {costs[name]:g} above")
        if row.failed or name is None:
            continue
        rest = {k: v for k, v in record.items() if k not in ("candidate", "cost")}
        try:
            found.setdefault(name, []).append(_observation(rest, project, table.where(line)))
        except InputError as error:
            problems.extend(error.problems)
    return [Candidate(n, tuple(o), costs.get(n, 1.0)) for n, o in found.items()]
