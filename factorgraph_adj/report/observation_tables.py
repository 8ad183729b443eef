"""Tables with a row for each scalar observation: observations.csv, snooping.csv."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..io.tables import write_columns
from ..quality.reliability import Reliability
from ..types import Array
from .context import Report
from .precision import figure
from .rows import Row, identities
from .set_aside import SetAside


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
        "controlled": yes(rel.controlled),
    }


def _set_aside(aside: SetAside) -> dict[str, list[str]]:
    """Return the columns of the set-aside observations, predicted by the clean solution."""
    rows = aside.rows.at(aside.numbers.tolist())
    size, sign = _sizes(rows), _signs(rows)
    columns = identities(rows)
    innovation = sign * aside.innovation
    columns |= _residuals(rows, innovation, np.array([r.sigma for r in rows]))
    return columns | {
        "redundancy_number": figures(aside.redundancy_numbers),
        "w": figures(sign * aside.w),
        "estimated_error": figures(-innovation / size),
        "controlled": yes(np.isfinite(aside.w)),
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
    columns = identities(rows)
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


def yes(values: Iterable[bool]) -> list[str]:
    """Write yes or no for each value."""
    return ["yes" if v else "no" for v in values]
