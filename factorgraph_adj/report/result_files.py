"""Result files of a solution: text report, results.json, CSV; text and CSV of one in parts.

The names of the columns, or a column beside the value, state the units of CSV tables.
results.json has metres, radians and image units throughout.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..control_characters import escaped
from ..errors import known
from ..io.csv_tables import write_columns
from ..io.file_transaction import write_files
from ..io.numbers import Units
from ..models.unknown_registry import UNKNOWNS
from ..parts.solution import PartResult, PartsSolution
from ..solve.solution import Solution
from ..statistical_tests import global_test
from ..units import MILLIMETRE, decimal
from . import image_axes
from .adjusted_coordinates import lines_table
from .adjusted_observations import observations_csv
from .adjusted_photos import photos_table
from .adjusted_points import has_values, points_table
from .adjustment_report import Report
from .data_snooping import snooping_csv
from .doubtful_results import unknowns_left_out
from .frames_and_shapes import shapes_table
from .layout import LINE_WIDTH, figures, paragraph, table, title
from .misfit_causes import given_values_table, variance_components_table
from .observation_rows import ReportRows, all_digits
from .options import Provenance, ReportOptions, Run
from .results_json import results_text
from .tables import as_csv
from .text import NO_REDUNDANCY, global_test_text, render_text, run_lines
from .unknowns import unknowns_table

MAX_REPEATED_LISTED = 20
"""Largest number of repeated observations that a text report lists."""
MEGABYTE = 1e6
"""Bytes of a megabyte."""
RESULT_FILES = (
    *("report.txt", "results.json", "observations.csv", "points.csv", "unknowns.csv"),
    *("photos.csv", "shapes.csv", "relative.csv", "snooping.csv", "unknowns_left_out.csv"),
    *("variance_components.csv", "given_values.csv"),
)
"""Files of a solution; those that it has no content for are removed."""


def parts_report(solution: PartsSolution, run: Run | None = None) -> str:
    """Return the text report of an adjustment in parts: the whole, its parts, the largest tests."""
    sections = (
        _whole_network(solution, run or Run()),
        [line for said in unknowns_left_out(solution) for line in paragraph(said)],
        _repeated(solution),
        _part_rows(solution),
        _part_tests(solution),
    )
    lines = [line.rstrip() for section in sections if section for line in [*section, ""]]
    return escaped("\n".join(lines[:-1]) + "\n")


def write_parts(solution: PartsSolution, folder: str | Path, run: Run | None = None) -> None:
    """Write report.txt, points.csv, unknowns.csv and observations.csv; an error writes none.

    Args:
        solution: the result of `adjust_parts`.
        folder: the folder; it is created if missing.
        run: file, date and options of the run.

    Raises:
        InputError: the folder cannot be written to; no file has changed.
    """
    points: dict[str, list[str]] = {}
    unknowns: dict[str, list[str]] = {}
    observations: dict[str, list[str]] = {}
    seen: set[str] = set()
    for name, part in solution.results():
        _add(unknowns, _part_unknowns(name, part, seen))
        _add(points, _part_points(name, part, seen))
        _add(observations, _part_observations(name, part))
    write_files(
        folder,
        {
            "report.txt": parts_report(solution, run),
            "points.csv": write_columns(points),
            "unknowns.csv": write_columns(unknowns) if unknowns["name"] else None,
            "observations.csv": write_columns(observations),
        },
    )


# -- text report ----------------------------------------------------------------------------------


def _whole_network(s: PartsSolution, run: Run) -> list[str]:
    test = global_test(s)
    kinds = ", ".join(
        f"{n} {UNKNOWNS[kind].noun}{'s' * (n != 1)}" for kind, n in s.junctions.by_kind().items()
    )
    ended = "converged" if s.converged else "NOT CONVERGED"
    largest = max(p.memory for p in s.quality.parts)
    name = s.name or known((job.part.name for job in s.jobs), most=4)
    out = [
        f"Adjustment of {name} in {len(s.jobs)} part{'s' * (len(s.jobs) != 1)}",
        "=" * LINE_WIDTH,
        *run_lines(run, width=22),
        f"  observations n        {s.n_observations}",
        f"  unknowns u            {s.n_unknowns}",
        f"  redundancy n − u      {s.redundancy}; redundancy numbers sum to "
        f"{s.sum_of_redundancy_numbers:.6f}",
        f"  junctions             {kinds or 'none'}; {s.junctions.n_columns} components",
        f"  iterations            {s.iterations}, {ended}: {s.reason}",
        "  second places         "
        + ("; ".join(s.second_places) or "none found; points that parts share are not examined"),
        f"  vᵀPv                  {s.vtpv:.6g}",
    ]
    if test.redundancy <= 0:
        out.append(f"  σ̂0                    {NO_REDUNDANCY}")
    else:
        out += [
            f"  σ̂0                    {test.sigma0:.5f} (a priori 1)",
            f"  global test           {global_test_text(test)}",
        ]
    scaled = s.quality.totals.variance_factor
    how = "a priori" if scaled == 1.0 else f"a posteriori: multiplied by {scaled**0.5:.5f}"
    return [
        *out,
        f"  precision             all σ of unknowns are {how}",
        f"  traffic               {s.received / MEGABYTE:.1f} MB from the parts, "
        f"{s.sent / MEGABYTE:.1f} MB to them",
        *([f"  memory of a process   {largest / MEGABYTE:.0f} MB at most"] if largest else []),
    ]


def _repeated(s: PartsSolution) -> list[str]:
    if not s.repeated:
        return []
    note = "They agree in unknowns and all digits. Each counts: leave out what is the same."
    rows = [[part, label] for part, label in s.repeated[:MAX_REPEATED_LISTED]]
    more = len(s.repeated) - MAX_REPEATED_LISTED
    return [
        *title("Observations that several parts have"),
        *table(["part", "observation"], rows, left=2),
        *([f"  … and {more} more"] if more > 0 else []),
        *paragraph(note),
    ]


def _part_rows(s: PartsSolution) -> list[str]:
    rows = [
        [
            job.part.name,
            str(b.n_rows),
            str(b.n_unknowns),
            str(len(columns)),
            f"{q.redundancy:.3f}",
            str(q.uncontrolled),
            f"{max((abs(t.w) for t in q.largest), default=0.0):.2f}",
        ]
        for job, b, columns, q in zip(
            s.jobs, s.begun, s.junctions.columns, s.quality.parts, strict=True
        )
    ]
    header = ["part", "scalars", "own u", "junction u", "Σr", "not controlled", "max |w|"]
    return [*title("Parts"), *table(header, rows)]


def _part_tests(s: PartsSolution) -> list[str]:
    rows = [
        [part, t.label, decimal(t.w, 2), decimal(t.redundancy, 2)] for part, t in s.largest_tests
    ]
    return [*title("Largest test values"), *table(["part", "observation", "w", "r"], rows)]


# -- tables ---------------------------------------------------------------------------------------


def _add(columns: dict[str, list[str]], more: dict[str, list[str]]) -> None:
    for name, texts in more.items():
        columns.setdefault(name, []).extend(texts)


def _part_points(name: str, part: PartResult, seen: set[str]) -> dict[str, list[str]]:
    """Return the points of a part that no earlier part has."""
    names = part.equations.unknowns["point"].names
    on = [i for i, n in enumerate(names) if n not in seen]
    seen.update(names)
    x = part.state["point"][on]
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", part.covariances["point"][on]), 0.0))
    return {
        "part": [name] * len(on),
        "name": [names[i] for i in on],
        **{a: [decimal(v, 6) for v in x[:, i].tolist()] for i, a in enumerate("xyz")},
        **{f"sigma_{a}_mm": figures(sigma[:, i] / MILLIMETRE) for i, a in enumerate("xyz")},
    }


def _part_unknowns(name: str, part: PartResult, seen: set[str]) -> dict[str, list[str]]:
    """Return the other unknowns of a part that no earlier part has, SI or image units."""
    rows: list[tuple[str, str, str, str, str]] = []
    tables = part.equations.unknowns
    for kind, t in tables.tables.items():
        if kind == "point":
            continue
        for number in np.flatnonzero(t.offset >= 0).tolist():
            label = f"{kind} {t.names[number]}"
            if label in seen:
                continue
            seen.add(label)
            e = part.unknown(kind, number)
            names, values, sigma = e.names, e.values, e.sigmas
            sign = image_axes.signs_in_files(part.equations.network, kind, t.names[number], names)
            values = values if sign is None else sign * values
            for c, component in enumerate(names):
                value = all_digits(float(values[c]))
                rows.append((kind, t.names[number], component, value, f"{sigma[c]:.6g}"))
    columns = ("kind", "name", "component", "value", "sigma")
    found = {c: [row[i] for row in rows] for i, c in enumerate(columns)}
    return {"part": [name] * len(rows), **found}


def _part_observations(name: str, part: PartResult) -> dict[str, list[str]]:
    """Return the observations of a part, SI and image units."""
    ids: list[str] = []
    labels: list[str] = []
    components: list[str] = []
    kinds: list[str] = []
    units: list[str] = []
    for block in part.equations.blocks:
        d = block.dimension
        ids += [block.ids[i] for i in range(block.n) for _ in range(d)]
        labels += [block.labels(i) for i in range(block.n) for _ in range(d)]
        components += [block.component(i, c) for i in range(block.n) for c in range(d)]
        kinds += [block.kind] * (block.n * d)
        units += [block.unit] * (block.n * d)
    residuals = part.residuals()
    sign = ReportRows(part.equations, residuals, Units()).signs()
    return {
        "part": [name] * len(ids),
        "id": ids,
        "observation": labels,
        "kind": kinds,
        "component": components,
        "unit": units,
        "residual": figures(sign * residuals),
        "sigma": figures(part.equations.sigmas()),
        "redundancy_number": figures(part.redundancy_numbers),
        "w": figures(sign * part.w),
        "smallest_detectable": figures(part.mdb),
        "estimated_error": figures(sign * part.estimated_errors),
    }


def write_solution(
    solution: Solution,
    folder: str | Path,
    options: ReportOptions | None = None,
    provenance: Provenance | None = None,
) -> None:
    """Write report.txt, results.json and the CSV tables into a folder; an error writes none.

    The tables have a header line with units in the names of the columns, such as ``sigma_x_mm``:
    coordinates in metres or the unit of the project, angles in its unit of angles. Numbers are
    written with the digits that bring the double precision back, so that they can be read as data;
    latitudes, longitudes and heights, which are computed from X Y Z, to 10 nm. The
    text report rounds. `reference/command` lists every file and its columns. `adjust --out` writes
    the same files.

    Args:
        solution: the result of `adjust`.
        folder: the folder; it is created if missing, and files of an earlier solution are replaced.
        options: as for `text_report`; the folder of the tables is set to ``folder``.
        provenance: as for `text_report`.

    Raises:
        InputError: the folder cannot be written to; no file has changed.
    """
    there = replace(options or ReportOptions(), tables=str(folder))
    write_tables(Report(solution, there, provenance or Provenance()), folder)


def write_tables(report: Report, folder: str | Path) -> None:
    """Write the files of a report, see `write_solution`."""
    files: dict[str, str | None] = dict.fromkeys(RESULT_FILES)
    files |= {
        "report.txt": render_text(report),
        "results.json": results_text(report),
        "observations.csv": observations_csv(report),
        "shapes.csv": as_csv(shapes_table(report)) if report.shapes else None,
        "relative.csv": as_csv(lines_table(report)) if report.lines else None,
        "snooping.csv": snooping_csv(report) or None,
        "unknowns_left_out.csv": _left_out_table(report)
        if report.network.unknowns_left_out
        else None,
        "given_values.csv": as_csv(given_values_table(report, report.given))
        if report.given
        else None,
    }
    if report.components is not None:
        found = variance_components_table(report, report.components)
        files["variance_components.csv"] = as_csv(found)
    if has_values(report):
        files["points.csv"] = as_csv(points_table(report))
        files["unknowns.csv"] = as_csv(unknowns_table(report))
        if report.network.photos:
            files["photos.csv"] = as_csv(photos_table(report))
    write_files(folder, files)


# -- CSV ------------------------------------------------------------------------------------------


def _left_out_table(report: Report) -> str:
    gone = report.network.unknowns_left_out
    columns = {name: [getattr(x, name) for x in gone] for name in ("kind", "name", "why")}
    return write_columns(columns | {"observations": [" ".join(x.ids) for x in gone]})
