"""Adjusted observations: text by station, weighted coordinates, and tables of all rows.

The tables observations.csv and snooping.csv have a row for each scalar observation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite, sqrt

import numpy as np

from ..graph.blocks import Block
from ..io.csv_tables import write_columns
from ..quality.reliability import Reliability
from ..types import Array
from ..units import decimal
from .adjusted_coordinates import figure
from .adjustment_report import Report
from .layout import decimals, paragraph, short, table, title, without_empty_columns
from .observation_rows import Row, identity_columns
from .rejected_observations import RejectedObservations

# -- station by station ---------------------------------------------------------------------------


ROUNDING_OF_REDUNDANCY = 1e-9
"""Redundancy number below which there is nothing but rounding."""


def adjusted_observations_section(report: Report) -> list[str]:
    """Return observed values, corrections and adjusted values, station by station."""
    numbers = _by_station(report)
    if not numbers:
        return []
    some, note = report.cut(numbers, "adjusted observations", "observations.csv")
    shown = report.rows.at(some)
    places = decimals_by_unit(shown)
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
    header, cells = without_empty_columns(header, cells)
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
        return [redundancy_text(r), "", ""]
    mark = " *" if abs(test) > critical else ""
    return [
        redundancy_text(r),
        decimal(test, 2) + mark,
        short(float(rel.mdb[row.number]) / row.scale.size),
    ]


def lists_every_observation(report: Report) -> bool:
    """Return whether the list of observations shows every scalar observation of the network."""
    blocks, most = report.solution.equations.blocks, report.options.most
    return len(report.rows) <= most and all(_between_points(b) for b in blocks)


def redundancy_text(r: float) -> str:
    """Write a redundancy number with two decimals, small ones with three digits."""
    return decimal(r, 2) if r >= 0.1 or r < ROUNDING_OF_REDUNDANCY else short(r)


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


def decimals_by_unit(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
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


def weighted_coordinates_section(report: Report) -> list[str]:
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
    places = decimals_by_unit(row for row, _ in shown)
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
    header, cells = without_empty_columns(header, cells)
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


def observations_table(report: Report) -> str:
    """Return observations.csv: all figures of each observation; set-aside ones are at the end."""
    rows = list(report.rows.all())
    columns = dict(report.rows.identities)
    residuals, sigmas = report.solution.observations.residuals, report.solution.observations.sigmas
    columns |= _residuals(rows, _signs(rows) * residuals, sigmas)
    if report.reliability is not None:
        columns |= _reliability(report, report.reliability, rows)
    aside = report.set_aside
    if report.snooping is not None:
        columns["set_aside"] = ["no"] * len(rows)
    columns["source"] = [r.source for r in rows]
    if aside is not None:
        more = _set_aside(aside)
        n = len(aside.numbers)
        columns = {c: [*v, *more.get(c, [""] * n)] for c, v in columns.items()}
    return write_columns(columns)


def _residuals(rows: Sequence[Row], residuals: Array, sigmas: Array) -> dict[str, list[str]]:
    size = _sizes(rows)
    return {
        "residual": figures(residuals / size),
        "adjusted": [_adjusted(r) for r in rows],
        "sigma": figures(sigmas / size),
        "small_unit": [r.scale.small for r in rows],
        "normalised": figures(residuals / sigmas),
    }


def _reliability(report: Report, rel: Reliability, rows: Sequence[Row]) -> dict[str, list[str]]:
    size, sign = _sizes(rows), _signs(rows)
    effect = rel.largest_effect / report.small
    return {
        "redundancy_number": figures(rel.redundancy_numbers),
        "e1": figures(rel.e1),
        "e2": figures(rel.e2),
        "e12": figures(rel.e12),
        "w": figures(sign * rel.w),
        "tau": figures(sign * rel.tau),
        "mdb": figures(rel.mdb / size),
        "delta_bar": figures(rel.delta_bar),
        f"largest_effect_{report.units.sigma_length}": figures(effect),
        "estimated_error": figures(sign * rel.estimated_errors / size),
        "controlled": yes_or_no(rel.controlled),
    }


def _set_aside(aside: RejectedObservations) -> dict[str, list[str]]:
    """Return the columns of the set-aside observations, predicted by the clean solution."""
    rows = aside.rows.at(aside.numbers.tolist())
    size, sign = _sizes(rows), _signs(rows)
    columns = identity_columns(rows)
    innovation = sign * aside.innovation
    columns |= _residuals(rows, innovation, np.array([r.sigma for r in rows]))
    return columns | {
        "redundancy_number": figures(aside.redundancy_numbers),
        "w": figures(sign * aside.w),
        "estimated_error": figures(-innovation / size),
        "controlled": yes_or_no(np.isfinite(aside.w)),
        "set_aside": ["yes"] * len(rows),
        "source": [r.source for r in rows],
    }


def snooping_table(report: Report) -> str:
    """Return snooping.csv: observations that were set aside, readmitted or unresolved."""
    found, aside = report.snooping, report.set_aside
    if found is None or aside is None:
        return ""
    records: list[tuple[Row, dict[str, str]]] = []
    for r in found.rejected:
        row = aside.find(r.id, r.component)
        size = row.sign * row.scale.size
        records.append(
            (
                row,
                {
                    "state": "set aside",
                    "round": str(r.round),
                    "test_value": figure(row.sign * r.test),
                    "estimated_error": figure(r.estimated_error / size),
                    "final_error": figure(r.final_error / size),
                    "final_sigma": figure(r.final_sigma / row.scale.size),
                    "final_test_value": figure(row.sign * r.final_test),
                    "not_told_apart_from": "; ".join(
                        f"{label} ({rho:+.3f})" for label, rho in r.inseparable
                    ),
                },
            )
        )
    for p in found.points_set_aside:
        for ray in p.rays:
            fields = {"state": "point set aside", "round": str(p.round), "reason": p.reason}
            records.append((aside.find(ray, ""), fields))
    rejected = {r.id for r in found.rejected}
    for ident in found.readmitted:
        if ident not in rejected:
            records.append((aside.find(ident, ""), {"state": "readmitted"}))
    for u in found.unresolved:
        row = aside.find(u.id, u.component)
        fields = {
            "state": "unresolved",
            "test_value": figure(row.sign * u.test),
            "estimated_error": figure(row.sign * u.estimated_error / row.scale.size),
            "reason": u.reason,
        }
        records.append((row, fields))
    rows = [row for row, _ in records]
    whole = ("point set aside", "readmitted")
    columns = identity_columns(rows)
    for i, (_, fields) in enumerate(records):
        if fields["state"] in whole:
            # The row stands for the whole observation with all its components.
            columns["component"][i] = columns["observed"][i] = ""
    columns["sigma"] = [figure(r.sigma / r.scale.size) for r in rows]
    columns["small_unit"] = [r.scale.small for r in rows]
    for name in (
        *("state", "round", "test_value", "estimated_error", "final_error", "final_sigma"),
        *("final_test_value", "not_told_apart_from", "reason"),
    ):
        columns[name] = [fields.get(name, "") for _, fields in records]
    columns["source"] = [r.source for r in rows]
    return write_columns(columns)


def _sizes(rows: Sequence[Row]) -> Array:
    return np.array([r.scale.size for r in rows], dtype=float)


def _adjusted(row: Row) -> str:
    """Return observed + v; empty where it is not known."""
    return row.scale.exact(row.adjusted) if np.isfinite(row.residual) else ""


def _signs(rows: Sequence[Row]) -> Array:
    return np.array([r.sign for r in rows], dtype=float)


def figures(values: Array) -> list[str]:
    """Write derived figures with enough digits for further use; empty if not finite."""
    if np.isfinite(values).all():
        return list(map("{:.9g}".format, (values + 0.0).tolist()))
    return [figure(v) for v in values.tolist()]


def yes_or_no(values: Iterable[bool]) -> list[str]:
    """Write yes or no for each value."""
    return ["yes" if v else "no" for v in values]
