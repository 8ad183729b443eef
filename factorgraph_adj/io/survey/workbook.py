"""Sheets of an Excel workbook (`.xlsx`) as rows of texts, by openpyxl (the extra ``xlsx``)."""

from __future__ import annotations

import datetime
from pathlib import Path
from types import ModuleType

from ...errors import InputError, Problem, known
from ..format_options import option_text

WORKBOOK_SUFFIXES = (".xlsx", ".xlsm")


def is_workbook(path: Path) -> bool:
    """Return whether a file has the suffix of a workbook."""
    return path.suffix.lower() in WORKBOOK_SUFFIXES


def _openpyxl(name: str) -> ModuleType:
    try:
        import openpyxl
    except ImportError:
        what = 'reading a workbook needs openpyxl: pip install "factorgraph_adj[xlsx]"; or save '
        raise InputError(Problem(f"{what}the sheet as .csv", name)) from None
    module: ModuleType = openpyxl
    return module


def sheet_rows(path: Path, sheet: str | None = None) -> list[tuple[int, list[str]]]:
    """Return number and cells of the rows of a sheet, without those that are empty.

    A formula has the value that the program computed last. Numbers are as short as they can be, so
    that a point 101 is ``101``; dates and hours are as in ISO 8601.

    Args:
        path: the workbook.
        sheet: name of the sheet; None: its only one.

    Raises:
        InputError: the file is no workbook, has no such sheet, or several and none is named.
    """
    openpyxl = _openpyxl(path.name)
    try:
        book = openpyxl.load_workbook(path, data_only=True, read_only=True)
        names = list(book.sheetnames)
        if sheet is None and len(names) == 1:
            sheet = names[0]
        rows = None
        if sheet in names:
            rows = [
                (i, [_text(cell) for cell in row])
                for i, row in enumerate(book[sheet].iter_rows(values_only=True), start=1)
            ]
        book.close()
    except Exception as error:  # of a damaged file openpyxl raises what its parts raise
        what = f"cannot be read as a workbook of Excel: {type(error).__name__}"
        raise InputError(Problem(what, path.name)) from None
    if rows is None and sheet is None:
        what = f"has {len(names)} sheets, {known(names)}; state {option_text('sheet', 'NAME')}"
        raise InputError(Problem(what, path.name))
    if rows is None:
        what = f"has no sheet {sheet!r}; valid: {known(names, meant=sheet or '')}"
        raise InputError(Problem(what, path.name))
    return [(i, cells) for i, cells in rows if any(cells)]


def _text(cell: object) -> str:
    """Return the text of a cell."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return repr(int(cell)) if cell.is_integer() and abs(cell) < 1e15 else repr(cell)
    if isinstance(cell, datetime.datetime | datetime.date | datetime.time):
        return cell.isoformat()
    return str(cell).strip()
