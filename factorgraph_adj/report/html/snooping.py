"""Tables of data snooping, and of given values and shared causes that were tested."""

from __future__ import annotations

from math import isfinite

from ...models.variables import UNKNOWNS
from ...quality.rejections import Snooping
from ...units import decimal
from ..causes import unit_of
from ..context import Report
from ..layout import listed, short
from .language import Texts
from .observations import test_name
from .sheets import NONE, Head, Sheet, columns_of, sheet

NAMED = 6
"""Largest number of observations of a cause that are named."""


def _start(found: Snooping, t: Texts) -> str:
    """Return what set observations aside before the first round."""
    return t("robust") if found.at_the_start == "robust" else t("before")


def rejected(report: Report, t: Texts) -> Sheet | None:
    """Return the observations that were set aside, as the clean solution predicts them."""
    found, aside = report.snooping, report.set_aside
    if found is None or aside is None:
        return None
    rows = []
    for r in found.rejected:
        row = aside.find(r.id, r.component)
        unit, small = row.scale.size, row.scale.small
        final = [NONE, NONE, NONE]
        if isfinite(r.final_error):
            error, sigma = row.sign * r.final_error / unit, r.final_sigma / unit
            final = [short(error), short(sigma), decimal(row.sign * r.final_test, 2)]
        close = "; ".join(f"{label} ({rho:+.2f})" for label, rho in r.inseparable)
        cells = [t.kind(row.kind_name), row.what, row.own_id, str(r.round or _start(found, t))]
        cells += [decimal(row.sign * r.test, 2), short(row.sign * r.estimated_error / unit)]
        rows.append([*cells, *final, small, close, row.source])
    name = test_name(report)
    heads: list[Head] = [
        (t("col.kind"), False),
        (t("col.observation"), False),
        (t("col.id"), False),
        (t("col.round"), True),
        (name, True, t("help.test")),
        (t("col.error"), True, t("help.error")),
        (t("col.final_error"), True, t("help.final_error")),
        ("σ", True),
        (f"{t('col.final')} {name}", True),
        (t("col.unit"), False),
        (t("col.partners"), False, t("help.partners")),
        (t("col.source"), False),
    ]
    notes = []
    if found.readmitted:
        notes.append(t("readmitted", names=listed(found.readmitted, 2 * NAMED)))
    return sheet("rejected", t("rejected.caption"), columns_of(heads, rows), notes=notes)


def points_aside(report: Report, t: Texts) -> Sheet | None:
    """Return the points that were set aside with all their rays."""
    found = report.snooping
    if found is None:
        return None
    rows = [
        [p.name, p.label, str(len(p.rays)), str(p.round or _start(found, t)), f"{p.test:.2f}"]
        for p in found.points_set_aside
    ]
    heads: list[Head] = [
        (t("col.point"), False),
        (t("col.worst_ray"), False),
        (t("col.rays"), True),
        (t("col.round"), True),
        (test_name(report), True),
    ]
    return sheet("points-aside", t("points_aside.caption"), columns_of(heads, rows))


def unresolved(report: Report, t: Texts) -> Sheet | None:
    """Return the observations above the critical value that stay in the adjustment."""
    found = report.snooping
    if found is None:
        return None
    rows, unit = [], report.solution.observations
    for u in found.unresolved:
        numbers: list[int] = report.solution.equations.find([u.id])[0].tolist()
        number = next((i for i in numbers if unit[i].component == u.component), numbers[0])
        row = report.rows.at([number])[0]
        error = short(row.sign * u.estimated_error / row.scale.size)
        cells = [t.kind(row.kind_name), row.what, row.own_id, decimal(row.sign * u.test, 2)]
        rows.append([*cells, error, row.scale.small, u.reason, row.source])
    heads: list[Head] = [
        (t("col.kind"), False),
        (t("col.observation"), False),
        (t("col.id"), False),
        (test_name(report), True, t("help.test")),
        (t("col.error"), True, t("help.error")),
        (t("col.unit"), False),
        (t("col.reason"), False),
        (t("col.source"), False),
    ]
    return sheet(
        "unresolved", t("unresolved.caption"), columns_of(heads, rows, english=[t("col.reason")])
    )


def given(report: Report, t: Texts) -> Sheet | None:
    """Return the tests of given values that are held."""
    rows = []
    for v in report.given:
        whole = f"{v.together.t2:.2f}" if v.together.dof else NONE
        for i, (component, one) in enumerate(zip(v.components, v.apart, strict=True)):
            unit, symbol = unit_of(report, v.sizes[i])
            figures = [NONE, NONE, NONE]
            if one.dof:
                error, sigma = float(one.error[0]) / unit, float(one.sigma[0]) / unit
                figures = [short(error), short(sigma), decimal(float(v.w[i]), 2)]
            rows.append([t.kind(UNKNOWNS[v.kind].title), v.name, component, *figures[:2], symbol])
            rows[-1] += [figures[2], whole]
    heads: list[Head] = [
        (t("col.kind"), False),
        (t("col.name"), False),
        (t("col.parameter"), False),
        (t("col.error"), True, t("help.given")),
        ("σ", True),
        (t("col.unit"), False),
        ("w", True),
        ("T²", True, t("help.t2")),
    ]
    return sheet("given", t("given.caption"), columns_of(heads, rows))


def causes(report: Report, t: Texts) -> Sheet | None:
    """Return the causes that explain more than any single reading, the likeliest first."""
    found = report.causes
    if found is None:
        return None
    rows = []
    for c in found.likelier:
        sizes = []
        for name, size, error, sigma, alone in c.estimates:
            unit, symbol = unit_of(report, size)
            shown = f"{name} {short(error / unit)} ± {short(sigma / unit)} {symbol}"
            sizes.append(shown.strip() + (" if it alone is wrong" * alone))
        cells = [f"{c.cause} {c.where}", "; ".join(sizes), f"{c.t2:.1f}", str(c.dof)]
        rows.append([*cells, f"{c.critical:.1f}", str(len(c.ids)), listed(c.ids, NAMED)])
    heads: list[Head] = [
        (t("col.cause"), False),
        (t("col.size"), False, t("help.cause_size")),
        ("T²", True, t("help.t2")),
        (t("col.dof"), True),
        (t("col.critical"), True),
        (t("col.shared"), True),
        (t("col.observations"), False),
    ]
    note = t("causes.note", n=found.tested)
    caption = t("causes.caption")
    said = columns_of(heads, rows, english=[t("col.cause"), t("col.size")])
    return sheet("causes", caption, said, notes=[note], order=t("order.cause"))
