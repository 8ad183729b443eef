"""Sections of the protocol: observations station by station, and weighted coordinates."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite, sqrt

import numpy as np

from ..graph.blocks import Block
from ..units import decimal
from .context import Report
from .layout import decimals, paragraph, short, table, title, without_empty
from .rows import Row

# -- station by station ---------------------------------------------------------------------------


ROUNDING = 1e-9
"""Redundancy number below which there is nothing but rounding."""


def observations(report: Report) -> list[str]:
    """Return observed values, corrections and adjusted values, station by station."""
    numbers = _by_station(report)
    if not numbers:
        return []
    some, note = report.cut(numbers, "adjusted observations", "observations.csv")
    shown = report.rows.at(some)
    places = decimals_of(shown)
    widths = [max(len(u) for u in x) for x in zip(*map(_units, shown), strict=True)]
    name = "τ" if report.pope else "w"
    cells, last = [], ""
    for row in shown:
        station, *targets = row.names
        coarse, fine = places[row.scale.small]
        unit, small = f"{row.scale.unit:{widths[0]}}", f"{row.scale.small:{widths[1]}}"
        cells.append(
            [
                station if station != last else "",
                " ".join(targets),
                row.with_component(row.kind_name),
                f"{row.scale.value(row.observed, coarse, turn=row.circular)} {unit}",
                f"{decimal(row.residual / row.scale.size, fine)} {small}",
                row.scale.value(row.adjusted, coarse, turn=row.circular),
                short(row.sigma / row.scale.size),
                *_tests(report, row),
            ]
        )
        last = station
    first = "station, frame" if any(r.frame for r in shown) else "station"
    header = [first, "target", "observation", "observed", "v", "adjusted", "σ", "r", name, "∇"]
    header, cells = without_empty(header, cells)
    words = "v = adjusted − observed; σ a priori, in the unit of v"
    if "∇" in header:
        words += ", as is ∇, the smallest detectable error"
    if any(text.endswith("*") for c in cells for text in c):
        words += f"; *: |{name}| above its critical value {report.tests[1]:.2f}"
    if any(b.kind == "image" for b in report.solution.equations.blocks):
        words += f"; image coordinates: {report.where('observations.csv')}"
    return [
        *title("Adjusted observations, station by station"),
        *table(header, cells, left=3),
        *note,
        *paragraph(words),
    ]


def _tests(report: Report, row: Row) -> list[str]:
    """Return r, the test value, and the smallest detectable error; empty where there are none."""
    rel, (values, critical) = report.reliability, report.tests
    if rel is None:
        return ["", "", ""]
    r, test = float(rel.redundancy_numbers[row.number]), row.sign * float(values[row.number])
    if not isfinite(test):
        return [short_r(r), "", ""]
    mark = " *" if abs(test) > critical else ""
    return [short_r(r), decimal(test, 2) + mark, short(float(rel.mdb[row.number]) / row.scale.size)]


def lists_every_row(report: Report) -> bool:
    """Return whether the list of observations shows every scalar observation of the network."""
    blocks, most = report.solution.equations.blocks, report.options.most
    return len(report.rows) <= most and all(_between_points(b) for b in blocks)


def short_r(r: float) -> str:
    """Write a redundancy number with two decimals, small ones with three digits."""
    return decimal(r, 2) if r >= 0.1 or r < ROUNDING else short(r)


def _units(row: Row) -> tuple[str, str]:
    return row.scale.unit, row.scale.small


def _by_station(report: Report) -> list[int]:
    """Return the rows of observations between points, by station in order of appearance."""
    rows: dict[str, list[int]] = {}
    for block in report.solution.equations.blocks:
        if _between_points(block):
            for i, row in enumerate(range(block.rows.start, block.rows.stop)):
                rows.setdefault(block.ids[i // block.dimension], []).append(row)
    stations: dict[str, list[int]] = {}
    for ident, observation in report.network.observations.items():
        if ident in rows:
            stations.setdefault(observation.names()[0], []).extend(rows[ident])
    return [row for group in stations.values() for row in group]


def _between_points(block: Block) -> bool:
    return not block.prior and block.kind != "image" and not block.by_axis


def decimals_of(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
    """Return by small unit the decimals of values and of v: two digits of the smallest σ."""
    sizes: dict[str, list[float]] = {}
    whole: dict[str, int] = {}
    for row in rows:
        sizes.setdefault(row.scale.small, []).append(row.sigma / row.scale.size)
        whole[row.scale.small] = row.scale.further_decimals
    out = {}
    for unit, sigmas in sizes.items():
        fine = decimals([min(sigmas)], default=2, most=5)
        out[unit] = min(max(fine + whole[unit], 0), 12), fine
    return out


# -- weighted coordinates -------------------------------------------------------------------------


def weighted_coordinates(report: Report) -> list[str]:
    """Return given coordinates with σ: their corrections, and σ before and after."""
    found = [
        (number, sigma)
        for block in report.solution.equations.blocks
        if block.by_axis
        for number, sigma in enumerate(_sigma_after(report, block), start=block.first_row)
    ]
    if not found:
        return []
    some, note = report.cut(found, "weighted coordinates", "observations.csv")
    rows = report.rows.at(number for number, _ in some)
    shown = [(row, sigma) for row, (_, sigma) in zip(rows, some, strict=True)]
    places = decimals_of(row for row, _ in shown)
    values, _ = report.tests
    name = "τ" if report.pope else "w"
    cells = []
    for row, sigma in shown:
        coarse, fine = places[row.scale.small]
        # Along east, north and up the given value is the origin: only its correction has a number.
        local = row.component in ("e", "n", "u")
        test = float(values[row.number]) if len(values) else np.nan
        cells.append(
            [
                *_place(row),
                "" if local else row.scale.value(row.observed, coarse),
                decimal(row.residual / row.scale.size, fine),
                "" if local else row.scale.value(row.adjusted, coarse),
                short(row.sigma / row.scale.size),
                short(sigma / row.scale.size),
                decimal(test, 2) if isfinite(test) else "",
            ]
        )
    unit, small = report.units.length, report.units.sigma_length
    header = ["point", "", f"given [{unit}]", f"correction [{small}]", f"adjusted [{unit}]"]
    header += [f"σ given [{small}]", f"σ adjusted [{small}]", name]
    header, cells = without_empty(header, cells)
    out = title("Weighted coordinates: corrections adjusted − given, σ before and after")
    return [*out, *table(header, cells, left=2 if header[1] == "" else 1), *note]


def _sigma_after(report: Report, block: Block) -> list[float]:
    """Return σ of the adjusted points along the axes of a block's rows, metres."""
    axis = block.constants["axis"]
    covariance = report.solution.point_covariances[block.variables[0][1]]
    variance = np.einsum("ni,nij,nj->n", axis, covariance, axis)
    return [sqrt(max(v, 0.0)) for v in variance.tolist()]


def _place(row: Row) -> list[str]:
    """Return point and component of a weighted coordinate, which may be an observation."""
    if row.names:
        return [row.names[0], f"{row.component} ({row.kind_name})"]
    name = row.id.removeprefix("point ").removesuffix(f" {row.component}")
    return [name, row.component]
