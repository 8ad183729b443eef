"""HTML tables: observations, control, groups, variance components, tests, rejected, causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from ...quality.rejections import Rejected
from ..adjusted_observations import observation_table, test_symbol
from ..adjustment_report import Report
from ..catalogue import Texts
from ..data_snooping import findings, rejected_points_table, rejected_table, unresolved_table
from ..layout import listed, short
from ..left_out_readings import left_out_table
from ..misfit_causes import (
    MAX_IDS_OF_CAUSE,
    causes_table,
    given_values_table,
    variance_components_table,
)
from ..observation_rows import Row
from ..reliability import MAX_INSEPARABLE_LISTED
from ..tables import NO_FIGURE, Column, Sheet, Table, as_html
from .rendering import ColumnHead, columns_from_rows, filled_sheet


def observations_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return all scalar observations, in the order of the rows of the adjustment."""
    return as_html(observation_table(report), t, notes=[t("observations_note")])


def control_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the coordinates that were given with a standard deviation, and how they fit."""
    blocks = (b for b in report.solution.equations.blocks if b.by_axis)
    rows = report.rows.at(i for b in blocks for i in range(b.rows.start, b.rows.stop))
    return as_html(replace(observation_table(report, rows), name="control"), t)


def worst_observations_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the observations with the largest test values, with what explains them.

    Where there is no reliability, those with the largest normalised residuals are returned.
    """
    rel, most = report.reliability, report.options.n_suspects
    if rel is None or not rel.controlled.any():
        size = np.abs(report.solution.observations.normalised)
        rows = report.rows.at(np.argsort(-size, kind="stable")[:most].tolist())
        partners: list[Sequence[tuple[int, float]]] = [() for _ in rows]
        caption = t("worst_residuals")
    else:
        scale = report.solution.sigma0 if report.pope else 1.0
        values, critical = report.tests
        above = int(np.sum(np.abs(values) > critical))
        found = rel.suspects(min(most, above), critical=critical * scale) if above else ()
        numbers = [s.row for s in found]
        partners = [s.inseparable for s in found]
        if not above:
            size = np.where(np.isfinite(values), np.abs(values), 0.0)
            order = np.argsort(-size, kind="stable")[: min(most, int(rel.controlled.sum()))]
            numbers = order.tolist()
            partners = [() for _ in numbers]
        rows = report.rows.at(numbers)
        key = "worst_above" if above else "worst_none"
        shown = len(rows)
        caption = t(key, n=above, shown=shown, name=test_symbol(report), critical=_two(critical))
    close = {r.number: p for r, p in zip(rows, partners, strict=True)}
    made = observation_table(report, rows)
    named = Column[Row](
        title="partners",
        value=lambda row: _partners(report, t, row, close[row.number]),
        help="partners",
    )
    cause = Column[Row](
        title="cause", value=lambda row: _cause(report, row), help="cause", english=True
    )
    columns = (*made.columns[:-1], named, cause, made.columns[-1])
    return as_html(Table("worst", rows, columns), t, caption=caption, order=t("order_test"))


def _two(value: float) -> str:
    return f"{value:.2f}" if isfinite(value) else NO_FIGURE


def _partners(report: Report, t: Texts, row: Row, found: Sequence[tuple[int, float]]) -> str:
    """Return the observations not distinguishable from an observation, with correlations."""
    others = report.rows.at([number for number, _ in found[:MAX_INSEPARABLE_LISTED]])
    named = [
        f"{t.kind(o.kind_name)} {o.what} ({row.sign * o.sign * rho:+.2f})"
        for o, (_, rho) in zip(others, found, strict=False)
    ]
    more = (
        [f"… {len(found) - MAX_INSEPARABLE_LISTED}"] if len(found) > MAX_INSEPARABLE_LISTED else []
    )
    return "; ".join([*named, *more])


def _cause(report: Report, row: Row) -> str:
    """Return the most probable cause that an observation shares; empty where there is none."""
    found = () if report.causes is None else report.causes.more_probable
    mine = next((c for c in found if row.id in c.ids), None)
    return "" if mine is None else f"{mine.cause} {mine.where}"


def observation_groups_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the groups of observations with their residuals and their redundancy."""
    rel, rows = report.reliability, []
    blocks = report.solution.equations.blocks
    plain = not report.solution.equations.clusters and all(b.whitener is None for b in blocks)
    for g in report.rows.groups():
        low, high = (short(s / g.scale.size) for s in g.sigma)
        own = [low if low == high else f"{low} … {high}", short(g.rms / g.scale.size)]
        cells = [t.kind(g.label), str(g.observations), str(g.scalars), g.scale.small]
        cells += own if g.scale.small else [NO_FIGURE, NO_FIGURE]
        vtpv = g.scalars * g.normalised_rms**2
        cells += [
            f"{g.normalised_rms:.2f}",
            f"{g.largest:.2f}",
            short(vtpv) if plain else NO_FIGURE,
        ]
        if rel is not None:
            r = rel.redundancy_numbers[g.rows]
            total = float(r.sum())
            factor = short((vtpv / total) ** 0.5) if plain and total > 0.5 else NO_FIGURE
            open_rows = int((~rel.controlled[g.rows] & ~report.stiff[g.rows]).sum())
            cells += [f"{total + 0.0:.2f}", f"{max(float(r.mean()), 0.0):.2f}"]
            cells += [f"{max(float(r.min()), 0.0):.2f}", str(open_rows), factor]
        rows.append(cells)
    heads: list[ColumnHead] = [
        (t("col_group"), False),
        (t("col_number"), True),
        (t("col_scalars"), True),
        (t("col_unit"), False),
        (t("col_sigma_given" if report.components is None else "col_sigma_estimated"), True),
        ("RMS v", True),
        ("RMS v/σ", True),
        ("max |v/σ|", True),
        ("vᵀPv", True),
    ]
    if rel is not None:
        heads += [
            ("Σr", True, t("help_r")),
            (t("col_mean_r"), True),
            (t("col_least_r"), True),
            (t("col_uncontrolled"), True, t("help_uncontrolled")),
            (t("col_factor"), True, t("help_factor")),
        ]
    return filled_sheet("groups", t("groups_caption"), columns_from_rows(heads, rows))


def variance_components_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the estimated factors of the standard deviations of groups."""
    found = report.components
    if found is None:
        return None
    ended = t("ended_yes" if found.converged else "ended_no")
    note = t("components_note", n=found.iterations, ended=ended)
    return as_html(variance_components_table(report, found), t, notes=[note])


def rejected_observations_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the observations that were rejected, as the clean solution predicts them."""
    found = report.snooping
    if found is None:
        return None
    notes = []
    if found.readmitted:
        notes.append(t("readmitted", names=listed(found.readmitted, 2 * MAX_IDS_OF_CAUSE)))
    every = [f for f in findings(report) if isinstance(f.found, Rejected)]
    return as_html(rejected_table(report, every), t, notes=notes)


def rejected_points_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the points that were rejected with all their rays."""
    found = report.snooping
    return (
        None if found is None else as_html(rejected_points_table(report, found.rejected_points), t)
    )


def left_out_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the readings that an incremental adjustment has left out."""
    return as_html(left_out_table(report), t)


def unresolved_observations_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the observations above the critical value that stay in the adjustment."""
    found = report.snooping
    return None if found is None else as_html(unresolved_table(report, found.unresolved), t)


def given_values_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the tests of given values that are held."""
    return as_html(given_values_table(report, report.given), t)


def causes_sheet(report: Report, t: Texts) -> Sheet | None:
    """Return the causes that explain more than any single reading, the most probable first."""
    found = report.causes
    if found is None:
        return None
    note = t("causes_note", n=found.tested)
    made = causes_table(report, found.more_probable)
    return as_html(made, t, notes=[note], order=t("order_cause"))
