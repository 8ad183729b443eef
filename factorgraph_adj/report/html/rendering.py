"""Frame of every HTML page: template, sections, packed scripts and data, input files, versions.

The scripts come from the installed packages: plotly.js (MIT) from ``plotly``, DataTables with
jQuery (MIT) from ``itables``. Templates and style sheet are in the folder ``template`` beside
this module.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import platform
from base64 import b64encode
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from importlib.resources import files as resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

from ...control_characters import escaped
from ...errors import InputError, Problem, system_reason
from ...version import __version__
from ..adjustment_report import Report
from ..catalogue import Texts
from ..layout import percent
from ..options import Run
from ..tables import NO_FIGURE, ROWS_PER_PAGE, Sheet, SheetColumn

MAX_FILES_LISTED = 200
"""Largest number of files of a folder that are listed."""


REPORT_PACKAGES = ("jinja2", "plotly", "itables")
"""Packages of the extra."""
REPORT_PACKAGES_MISSING = "the report needs {names}: pip install 'factorgraph_adj[report]'"
"""Message where some of them are not installed."""
COMPRESSION_LEVEL = 6
"""Level of compression of data; libraries, which stay the same, have the best one."""
ColumnHead: TypeAlias = tuple[str, bool] | tuple[str, bool, str]
"""Title of a column, whether it is numeric, and where needed its help."""
PAGE_SCRIPTS = ("base.js", "tables.js", "plan.js", "figures.js")
"""Scripts of a page, in the order in which they run."""


@dataclass(frozen=True)
class Libraries:
    """Packed scripts and styles."""

    plotly: str
    """plotly.js."""
    tables: str
    """DataTables with its extensions, a module of JavaScript."""
    style: str
    """Style sheet of DataTables."""


def require_report_packages() -> None:
    """Raise the packages that are not installed.

    Raises:
        InputError: some are not; the message says how to install them.
    """
    missing = [name for name in REPORT_PACKAGES if find_spec(name) is None]
    if missing:
        raise InputError(REPORT_PACKAGES_MISSING.format(names=", ".join(missing)))


@cache
def packed_libraries() -> Libraries:
    """Return the scripts of the installed packages, packed once in a process."""
    from plotly.offline import get_plotlyjs

    folder = files("itables") / "html"
    return Libraries(
        _packed(get_plotlyjs().encode(), 9),
        _packed((folder / "dt_bundle.js").read_bytes(), 9),
        _packed((folder / "dt_bundle.css").read_bytes(), 9),
    )


def packed_json(data: Any) -> str:
    """Return data as JSON, packed by gzip and written in base64, which needs no escaping."""
    text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return _packed(text.encode(), COMPRESSION_LEVEL)


def _packed(data: bytes, level: int) -> str:
    # No time stamp: the same report gives the same file.
    return b64encode(gzip.compress(data, level, mtime=0)).decode("ascii")


def filled_sheet(
    ident: str,
    caption: str,
    columns: Iterable[SheetColumn],
    *,
    notes: Sequence[str] = (),
    order: str = "",
) -> Sheet | None:
    """Return a table without the columns that no row fills; None for a table without rows."""
    kept = [c for c in columns if any(v not in ("", NO_FIGURE) for v in c.values)]
    if not kept:
        return None
    return Sheet(ident, caption, kept, tuple(n for n in notes if n), order)


def columns_from_rows(
    heads: Sequence[ColumnHead], rows: Sequence[Sequence[str]], *, english: Collection[str] = ()
) -> list[SheetColumn]:
    """Return columns from rows of cells.

    Args:
        heads: title, whether the column is numeric, and its help, of each column.
        rows: the cells, row by row.
        english: titles of the columns whose cells are words of the adjustment itself.
    """
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(heads)
    return [
        SheetColumn(head[0], values, head[1], head[2] if len(head) == 3 else "", head[0] in english)
        for head, values in zip(heads, cells, strict=True)
    ]


def input_files_sheet(paths: Sequence[str | Path], t: Texts) -> Sheet | None:
    """Return the input files with their sizes and SHA-256.

    Of a folder, the files in it and below are listed, those with a dot in front of their name
    excepted.

    Raises:
        InputError: a file cannot be read, all of them at once.
    """
    rows, problems, more = [], [], 0
    for path in paths:
        found = _below(Path(path))
        more += max(len(found) - MAX_FILES_LISTED, 0)
        for file in found[:MAX_FILES_LISTED]:
            try:
                with file.open("rb") as stream:
                    digest = hashlib.file_digest(stream, "sha256").hexdigest()
                rows.append([str(file), str(file.stat().st_size), digest])
            except OSError as error:
                problems.append(Problem(f"cannot be read: {system_reason(error)}", str(file)))
    if problems:
        raise InputError(problems)
    heads: list[ColumnHead] = [(t("col_file"), False), (t("col_bytes"), True), ("SHA-256", False)]
    note = t("files_more", n=more) if more else ""
    return filled_sheet("files", t("files_caption"), columns_from_rows(heads, rows), notes=[note])


def _below(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return sorted(
        p
        for p in path.rglob("*")
        if p.is_file() and not any(part.startswith(".") for part in p.relative_to(path).parts)
    )


def adjustment_provenance(report: Report, t: Texts) -> list[tuple[str, str]]:
    """Return what was run, with which options, and the versions of what computed it."""
    options = report.options
    tests = f"α0 = {percent(options.alpha)}, 1 − β = {percent(options.power)}"
    variance = t(f"variance_{report.solution.variance.replace('-', '_')}")
    return run_provenance(
        report.provenance.run, [("run_variance", variance), ("run_tests", tests)], t
    )


def run_provenance(run: Run, more: Sequence[tuple[str, str]], t: Texts) -> list[tuple[str, str]]:
    """Return program, run and versions.

    Args:
        run: the run.
        more: keys and texts of further lines.
        t: texts of the language.
    """
    parts = [
        ("run_program", f"factorgraph_adj {__version__}"),
        *((f"run_{name}", text) for name, text in asdict(run).items()),
        *more,
        ("run_versions", ", ".join(_versions())),
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


@dataclass(frozen=True)
class PageSection:
    """A part of the page with tables."""

    id: str
    """Name of the part in the page."""
    title: str
    """Its heading."""
    sheets: Sequence[Sheet]
    """Its tables."""
    empty: str = ""
    """What it says without a table; empty: the part is left out."""


def rendered_page(name: str, t: Texts, contents: Callable[[], Mapping[str, Any]]) -> str:
    """Return a page.

    Args:
        name: name of its template.
        t: texts of its language.
        contents: function that makes what the template fills in, called once it can be filled in.

    Raises:
        InputError: packages of the extra are missing, and what the function raises.
    """
    require_report_packages()
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    def text_of(name: str) -> str:
        return (resources(__package__) / "template" / name).read_text(encoding="utf-8")

    environment = Environment(
        loader=FunctionLoader(text_of),
        autoescape=True,
        finalize=lambda value: escaped(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name).render(
        t=t,
        language=t.language,
        program=f"factorgraph_adj {__version__}",
        style=text_of("style.css"),
        script="\n".join(text_of(name) for name in PAGE_SCRIPTS),
        libraries=packed_libraries(),
        page_rows=ROWS_PER_PAGE,
        none=NO_FIGURE,
        script_texts=t.script_texts(),
        **contents(),
    )


def capitalised(text: str) -> str:
    """Return a text with a capital letter at its beginning."""
    return text[:1].upper() + text[1:]
