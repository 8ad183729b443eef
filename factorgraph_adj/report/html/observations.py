"""Tables of scalar observations: all of them, control, and those with the largest test values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isfinite, log10

import numpy as np

from ...units import decimal
from ..adjusted import decimals_of, short_r
from ..context import Report
from ..layout import short
from ..reliability import PARTNERS
from ..rows import Row
from .language import Texts
from .sheets import NONE, Column, Head, Sheet, columns_of, sheet


def test_name(report: Report) -> str:
    """Return the symbol of the test values of a report."""
    return "τ" if report.pope else "w"


def observations(report: Report, t: Texts) -> Sheet | None:
    """Return all scalar observations, in the order of the rows of the adjustment."""
    rows = report.rows.all()
    columns = _columns(report, t, rows)
    return sheet("observations", t("observations.caption"), columns, notes=[t("observations.note")])


def control(report: Report, t: Texts) -> Sheet | None:
    """Return the coordinates that were given with a standard deviation, and how they fit."""
    numbers = [
        i
        for b in report.solution.equations.blocks
        if b.by_axis
        for i in range(b.rows.start, b.rows.stop)
    ]
    columns = _columns(report, t, report.rows.at(numbers))
    return sheet("control", t("control.caption"), columns)


def _columns(report: Report, t: Texts, rows: Sequence[Row]) -> list[Column]:
    places, size = decimals_of(rows), [r.scale.size for r in rows]
    observed, adjusted = [], []
    for row in rows:
        coarse, fine = places[row.scale.small]
        if row.scale.image:
            coarse = fine + round(-log10(row.scale.size))
        observed.append(row.scale.value(row.observed, coarse, turn=row.circular))
        adjusted.append(row.scale.value(row.adjusted, coarse, turn=row.circular))
    kinds = {k: t.kind(k) for k in {r.kind_name for r in rows}}
    small = list(zip(rows, size, strict=True))
    columns = [
        Column(t("col.kind"), [kinds[r.kind_name] for r in rows]),
        Column(t("col.observation"), [r.what for r in rows]),
        Column(t("col.id"), [r.own_id for r in rows]),
        Column(t("col.observed"), observed, True),
        Column(t("col.adjusted"), adjusted, True, t("help.adjusted")),
        Column(t("col.unit"), [r.scale.unit for r in rows]),
        Column("v", [short(r.residual / s) for r, s in small], True, t("help.v")),
        Column("σ", [short(r.sigma / s) for r, s in small], True, t("help.sigma")),
        Column(t("col.small_unit"), [r.scale.small for r in rows]),
        *_tests(report, t, rows),
        Column(t("col.source"), [r.source for r in rows]),
    ]
    return columns


def _tests(report: Report, t: Texts, rows: Sequence[Row]) -> list[Column]:
    """Return r, the test value, the estimated error and the smallest detectable one."""
    rel = report.reliability
    if rel is None:
        normalised = [decimal(r.residual / r.sigma, 2) for r in rows]
        return [Column("v/σ", normalised, True, t("help.normalised"))]
    n = [r.number for r in rows]
    sign, size = np.array([[r.sign, r.scale.size] for r in rows]).reshape(-1, 2).T
    values = (sign * report.tests[0][n]).tolist()
    errors = (sign * rel.estimated_errors[n] / size).tolist()
    return [
        Column("r", [short_r(v) for v in rel.redundancy_numbers[n].tolist()], True, t("help.r")),
        Column(
            test_name(report),
            [decimal(v, 2) if isfinite(v) else NONE for v in values],
            True,
            t("help.test"),
        ),
        Column(t("col.error"), [short(v) for v in errors], True, t("help.error")),
        Column("∇", [short(v) for v in (rel.mdb[n] / size).tolist()], True, t("help.mdb")),
    ]


def worst(report: Report, t: Texts) -> Sheet | None:
    """Return the observations with the largest test values, with what explains them.

    Where there is no reliability, those with the largest normalised residuals are returned.
    """
    rel, most = report.reliability, report.options.n_suspects
    if rel is None or not rel.controlled.any():
        size = np.abs(report.solution.observations.normalised)
        rows = report.rows.at(np.argsort(-size, kind="stable")[:most].tolist())
        partners: list[Sequence[tuple[int, float]]] = [() for _ in rows]
        caption = t("worst.residuals")
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
        key = "worst.above" if above else "worst.none"
        shown = len(rows)
        caption = t(key, n=above, shown=shown, name=test_name(report), critical=_two(critical))
    columns = _columns(report, t, rows)
    close = [_partners(report, t, r, p) for r, p in zip(rows, partners, strict=True)]
    columns.insert(-1, Column(t("col.partners"), close, help=t("help.partners")))
    columns.insert(
        -1, Column(t("col.cause"), _causes(report, rows), help=t("help.cause"), english=True)
    )
    return sheet("worst", caption, columns, order=t("order.test"))


def _two(value: float) -> str:
    return f"{value:.2f}" if isfinite(value) else NONE


def _partners(report: Report, t: Texts, row: Row, found: Sequence[tuple[int, float]]) -> str:
    """Return the observations from which an observation cannot be told, with correlations."""
    others = report.rows.at([number for number, _ in found[:PARTNERS]])
    named = [
        f"{t.kind(o.kind_name)} {o.what} ({row.sign * o.sign * rho:+.2f})"
        for o, (_, rho) in zip(others, found, strict=False)
    ]
    more = [f"… {len(found) - PARTNERS}"] if len(found) > PARTNERS else []
    return "; ".join([*named, *more])


def _causes(report: Report, rows: Iterable[Row]) -> list[str]:
    """Return the likeliest cause that each observation shares; empty where there is none."""
    found = () if report.causes is None else report.causes.likelier
    out = []
    for row in rows:
        mine = next((c for c in found if row.id in c.ids), None)
        out.append("" if mine is None else f"{mine.cause} {mine.where}")
    return out


def groups(report: Report, t: Texts) -> Sheet | None:
    """Return the groups of observations with their residuals and their redundancy."""
    rel, rows = report.reliability, []
    blocks = report.solution.equations.blocks
    plain = not report.solution.equations.clusters and all(b.whitener is None for b in blocks)
    for g in report.rows.groups():
        low, high = (short(s / g.scale.size) for s in g.sigma)
        own = [low if low == high else f"{low} … {high}", short(g.rms / g.scale.size)]
        cells = [t.kind(g.label), str(g.observations), str(g.scalars), g.scale.small]
        cells += own if g.scale.small else [NONE, NONE]
        vtpv = g.scalars * g.normalised_rms**2
        cells += [f"{g.normalised_rms:.2f}", f"{g.largest:.2f}", short(vtpv) if plain else NONE]
        if rel is not None:
            r = rel.redundancy_numbers[g.rows]
            total = float(r.sum())
            factor = short((vtpv / total) ** 0.5) if plain and total > 0.5 else NONE
            open_rows = int((~rel.controlled[g.rows] & ~report.stiff[g.rows]).sum())
            cells += [f"{total + 0.0:.2f}", f"{max(float(r.mean()), 0.0):.2f}"]
            cells += [f"{max(float(r.min()), 0.0):.2f}", str(open_rows), factor]
        rows.append(cells)
    heads: list[Head] = [
        (t("col.group"), False),
        (t("col.number"), True),
        (t("col.scalars"), True),
        (t("col.unit"), False),
        (t("col.sigma_given" if report.components is None else "col.sigma_estimated"), True),
        ("RMS v", True),
        ("RMS v/σ", True),
        ("max |v/σ|", True),
        ("vᵀPv", True),
    ]
    if rel is not None:
        heads += [
            ("Σr", True, t("help.r")),
            (t("col.mean_r"), True),
            (t("col.least_r"), True),
            (t("col.uncontrolled"), True, t("help.uncontrolled")),
            (t("col.factor"), True, t("help.factor")),
        ]
    return sheet("groups", t("groups.caption"), columns_of(heads, rows))


def components(report: Report, t: Texts) -> Sheet | None:
    """Return the estimated factors of the standard deviations of groups."""
    found = report.components
    if found is None:
        return None
    rows = []
    for c in found.components:
        low, high = c.interval()
        state = f"{c.state}; {c.note}" if c.note else str(c.state)
        cells = [t.kind(c.name.replace("_", " ")), str(c.n), f"{c.redundancy:.2f}", short(c.factor)]
        rows.append([*cells, short(c.sigma), f"{short(low)} … {short(high)}", state])
    heads: list[Head] = [
        (t("col.group"), False),
        (t("col.scalars"), True),
        ("Σr", True),
        (t("col.factor"), True, t("help.factor")),
        ("±", True),
        (t("col.interval"), True),
        (t("col.state"), False),
    ]
    ended = t("ended.yes" if found.converged else "ended.no")
    note = t("components.note", n=found.iterations, ended=ended)
    return sheet("components", t("components.caption"), columns_of(heads, rows), notes=[note])
