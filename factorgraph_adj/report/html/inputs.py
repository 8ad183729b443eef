"""What a report says of its origin: input files with hashes, versions, options."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ...errors import InputError, Problem, system_reason
from ...version import __version__
from ..context import Report
from ..layout import percent
from ..options import Run
from .language import Texts
from .sheets import Head, Sheet, columns_of, sheet

MOST_FILES = 200
"""Largest number of files of a folder that are listed."""


def files(paths: Sequence[str | Path], t: Texts) -> Sheet | None:
    """Return the input files with their sizes and SHA-256.

    Of a folder, the files in it and below are listed, those with a dot in front of their name
    excepted.

    Raises:
        InputError: a file cannot be read, all of them at once.
    """
    rows, problems, more = [], [], 0
    for path in paths:
        found = _below(Path(path))
        more += max(len(found) - MOST_FILES, 0)
        for file in found[:MOST_FILES]:
            try:
                with file.open("rb") as stream:
                    digest = hashlib.file_digest(stream, "sha256").hexdigest()
                rows.append([str(file), str(file.stat().st_size), digest])
            except OSError as error:
                problems.append(Problem(f"cannot be read: {system_reason(error)}", str(file)))
    if problems:
        raise InputError(problems)
    heads: list[Head] = [(t("col.file"), False), (t("col.bytes"), True), ("SHA-256", False)]
    note = t("files.more", n=more) if more else ""
    return sheet("files", t("files.caption"), columns_of(heads, rows), notes=[note])


def _below(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return sorted(
        p
        for p in path.rglob("*")
        if p.is_file() and not any(part.startswith(".") for part in p.relative_to(path).parts)
    )


def run(report: Report, t: Texts) -> list[tuple[str, str]]:
    """Return what was run, with which options, and the versions of what computed it."""
    options = report.options
    tests = f"α0 = {percent(options.alpha)}, 1 − β = {percent(options.power)}"
    variance = t(f"variance.{report.solution.variance}")
    return run_of(report.provenance.run, [("run.variance", variance), ("run.tests", tests)], t)


def run_of(run: Run, more: Sequence[tuple[str, str]], t: Texts) -> list[tuple[str, str]]:
    """Return program, run and versions.

    Args:
        run: the run.
        more: keys and texts of what else is told.
        t: texts of the language.
    """
    parts = [
        ("run.program", f"factorgraph_adj {__version__}"),
        *((f"run.{name}", text) for name, text in asdict(run).items()),
        *more,
        ("run.versions", ", ".join(_versions())),
    ]
    return [(t(key), text) for key, text in parts if text]


def _versions() -> list[str]:
    out = [f"Python {platform.python_version()}"]
    for name in ("numpy", "scipy", "gtsam", "plotly", "itables", "jinja2"):
        try:
            out.append(f"{name} {version(name)}")
        except PackageNotFoundError:  # built from source, without metadata
            out.append(name)
    return out
