"""Targets and candidates in a TOML file.

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

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, cast

from ..errors import InputError, Problem, known, unknown_name
from ..files import inside
from ..io.csv_tables import FieldRow
from ..io.project import Project
from ..io.text_files import parse_toml, read_text
from ..units import LENGTH
from .candidates import Candidate
from .drafts import Drafts, tables
from .targets import TARGETS, DetectableError, RedundancyNumber, Target, check_targets

IN_MM = "at_most_mm"
"""Key for the limit of a length in millimetres."""


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
        _target(t, f"{path.name}: target {n}", problems)
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


def _target(given: Mapping[str, Any], where: str, problems: list[Problem]) -> Target | None:
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
