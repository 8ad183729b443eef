"""results.json: everything that an adjustment found, for programs."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from ..io.atomic import write_files
from ..report.context import Report
from ..report.summary import results_text
from ..solve.solution import Solution
from .layers import report_of


def write_results(result: Solution | Report, path: str | Path) -> None:
    """Write a solution as results.json, the file that ``adjust --out`` writes too.

    Numbers have the digits that bring float64 back, in metres, radians and image units; ``null`` is
    a number that is not known. `results_schema` describes every member.

    Args:
        result: the result of `adjust`, or its report with data snooping.
        path: the file, such as ``results.json``.

    Raises:
        InputError: the file cannot be written.
    """
    file = Path(path)
    write_files(file.parent, {file.name: results_text(report_of(result))})


def results_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of results.json; its version is ``format`` of the file."""
    text = (files("factorgraph_adj.report") / "results.schema.json").read_text(encoding="utf-8")
    return dict(json.loads(text))
