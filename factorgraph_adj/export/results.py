"""results.json: everything that an adjustment found, for programs."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from ..errors import InputError, known
from ..io.atomic import write_files
from ..report.epochs.context import EpochsReport
from ..report.epochs.results import epochs_text
from ..report.summary import results_text
from .layers import Result, report_of


def write_results(result: Result, path: str | Path) -> None:
    """Write a result as results.json, the file that ``--out`` of the command writes too.

    Numbers have the digits that bring float64 back, in metres, radians and image units; ``null`` is
    a number that is not known. `results_schema` describes every member.

    Args:
        result: the result of `adjust`, or its report with data snooping; or of `congruence`, or its
            report with blocks.
        path: the file, such as ``results.json``.

    Raises:
        InputError: the file cannot be written.
    """
    file, report = Path(path), report_of(result)
    text = epochs_text(report) if isinstance(report, EpochsReport) else results_text(report)
    write_files(file.parent, {file.name: text})


def results_schema(of: Literal["adjustment", "epochs"] = "adjustment") -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of results.json; its version is ``format`` of the file.

    Args:
        of: whether the file is that of an adjustment, or of a comparison of two epochs.

    Raises:
        InputError: another word.
    """
    names = {"adjustment": "results.schema.json", "epochs": "epochs.schema.json"}
    if of not in names:
        raise InputError(f"there is no schema of {of!r}; valid: {known(names)}")
    text = (files("factorgraph_adj.report") / names[of]).read_text(encoding="utf-8")
    return dict(json.loads(text))
