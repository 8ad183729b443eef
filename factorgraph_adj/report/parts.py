"""The protocol and the tables of a network that was adjusted in parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..control_characters import escaped
from ..errors import known
from ..io.atomic import write_files
from ..io.numbers import Units
from ..io.tables import write_columns
from ..models.variables import UNKNOWNS
from ..parts.result import PartResult, PartsSolution
from ..quality.unit_weight import global_test
from ..units import decimal
from . import axes
from .doubts import unknowns_left_out
from .layout import WIDTH, paragraph, table, title
from .observation_tables import figures
from .options import Run
from .rows import ReportRows, exact
from .text import run_lines

LISTED = 20
"""Largest number of repeated observations that a protocol lists."""
MEGABYTE = 1e6
"""Bytes of a megabyte."""
MILLIMETRE = 1e-3
"""Metres of a millimetre."""


def parts_protocol(solution: PartsSolution, run: Run | None = None) -> str:
    """Return the protocol of an adjustment in parts: the whole, its parts, the largest tests."""
    sections = (
        _whole(solution, run or Run()),
        [line for said in unknowns_left_out(solution) for line in paragraph(said)],
        _repeated(solution),
        _parts(solution),
        _tests(solution),
    )
    lines = [line.rstrip() for section in sections if section for line in [*section, ""]]
    return escaped("\n".join(lines[:-1]) + "\n")


def write_parts(solution: PartsSolution, folder: str | Path, run: Run | None = None) -> None:
    """Write protocol.txt, points.csv, unknowns.csv and observations.csv; an error writes none.

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
        _add(unknowns, _unknowns(name, part, seen))
        _add(points, _points(name, part, seen))
        _add(observations, _observations(name, part))
    write_files(
        folder,
        {
            "protocol.txt": parts_protocol(solution, run),
            "points.csv": write_columns(points),
            "unknowns.csv": write_columns(unknowns) if unknowns["name"] else None,
            "observations.csv": write_columns(observations),
        },
    )


# -- protocol -------------------------------------------------------------------------------------


def _whole(s: PartsSolution, run: Run) -> list[str]:
    test = global_test(s)
    kinds = ", ".join(
        f"{n} {UNKNOWNS[kind].noun}{'s' * (n != 1)}" for kind, n in s.junctions.by_kind().items()
    )
    ended = "converged" if s.converged else "NOT CONVERGED"
    largest = max(p.memory for p in s.quality.parts)
    name = s.name or known((job.part.name for job in s.jobs), most=4)
    out = [
        f"Adjustment of {name} in {len(s.jobs)} part{'s' * (len(s.jobs) != 1)}",
        "=" * WIDTH,
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
        out.append("  σ̂0                    no redundancy: no observation checks another")
    else:
        verdict = "accepted" if test.accepted else "REJECTED"
        out += [
            f"  σ̂0                    {test.sigma0:.5f} (a priori 1)",
            f"  global test           {verdict}: χ², two-sided, {100 * (1 - test.alpha):.0f} %, "
            f"{test.lower:.4f} ≤ σ̂0 ≤ {test.upper:.4f}",
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
    rows = [[part, label] for part, label in s.repeated[:LISTED]]
    more = len(s.repeated) - LISTED
    return [
        *title("Observations that several parts have"),
        *table(["part", "observation"], rows, left=2),
        *([f"  … and {more} more"] if more > 0 else []),
        *paragraph(note),
    ]


def _parts(s: PartsSolution) -> list[str]:
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


def _tests(s: PartsSolution) -> list[str]:
    rows = [
        [part, t.label, decimal(t.w, 2), decimal(t.redundancy, 2)] for part, t in s.largest_tests
    ]
    return [*title("Largest test values"), *table(["part", "observation", "w", "r"], rows)]


# -- tables ---------------------------------------------------------------------------------------


def _add(columns: dict[str, list[str]], more: dict[str, list[str]]) -> None:
    for name, texts in more.items():
        columns.setdefault(name, []).extend(texts)


def _points(name: str, part: PartResult, seen: set[str]) -> dict[str, list[str]]:
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


def _unknowns(name: str, part: PartResult, seen: set[str]) -> dict[str, list[str]]:
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
            sign = axes.signs(part.equations.network, kind, t.names[number], names)
            values = values if sign is None else sign * values
            for c, component in enumerate(names):
                value = exact(float(values[c]))
                rows.append((kind, t.names[number], component, value, f"{sigma[c]:.6g}"))
    columns = ("kind", "name", "component", "value", "sigma")
    found = {c: [row[i] for row in rows] for i, c in enumerate(columns)}
    return {"part": [name] * len(rows), **found}


def _observations(name: str, part: PartResult) -> dict[str, list[str]]:
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
