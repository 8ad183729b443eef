"""Sections of the protocol: observations set aside by data snooping, and estimated weights."""

from __future__ import annotations

from math import isfinite

import numpy as np

from ..quality.rejections import Rejected, Snooping
from ..quality.variance_components import VarianceComponent
from ..units import decimal, significant
from .context import Report
from .layout import listed, paragraph, percent, short, table, title, whole, without_empty
from .reliability import NAMES, PARTNERS, names_of
from .rows import kind_name

NAMED = 12
"""Largest number of readmitted observations that are named."""
CONFIDENCE = 0.95
"""Confidence of the intervals of variance components."""


def snooping(report: Report) -> list[str]:
    """Return rounds and set-aside observations with test values and errors, and why it ended."""
    found = report.snooping
    if found is None:
        return []
    name = "τ" if found.test == "pope" else "w"
    start = ", after a robust start" if any(r.number == 0 for r in found.rounds) else ""
    what = {"pope": "Pope's τ", "baarda": "Baarda's w"}[found.test]
    out = title(f"Data snooping ({what}, critical |{name}| {found.critical:.2f}{start})")
    out += paragraph(f"{_how_many(found)}; {found.reason}")
    if _aside(found) or found.readmitted:
        out += ["", *_rounds(report, found, name)]
    return [
        *out,
        *_rejected(report, found, name),
        *_others(found),
        *_points(report, found, name),
        *_unresolved(report, found, name),
    ]


def _how_many(found: Snooping) -> str:
    """Return how many observations were set aside before the rounds, and in them."""
    gone, back = (sum(getattr(r, a) for r in found.rounds) for a in ("set_aside", "readmitted"))
    now = _aside(found) + len(found.factors_set_aside)
    before, last = now - (gone - back), max(r.number for r in found.rounds)
    rounds = f"in {last} round{'s' * (last != 1)}"
    if not before:
        return f"{_observations(now)} set aside {rounds}"
    more = f"{gone} more" if gone else "no others"
    return f"{_observations(before)} set aside before the first round, {more} {rounds}"


def _aside(found: Snooping) -> int:
    """Return how many observations are set aside, with the rays of points."""
    return len(found.rejected) + sum(len(p.rays) for p in found.points_set_aside)


def _observations(n: int) -> str:
    return f"{n} observation{'s' * (n != 1)}" if n else "nothing"


def _rounds(report: Report, found: Snooping, name: str) -> list[str]:
    rows = [
        [
            str(r.number or found.at_the_start),
            significant(r.sigma0, 4),
            f"{r.largest:.2f}",
            str(r.suspects),
            str(r.set_aside or "–"),
            str(r.readmitted or "–"),
        ]
        for r in found.rounds
    ]
    shown, note = report.cut(rows, "rounds", "results.json")
    header = ["round", "σ̂0", f"max |{name}|", "above critical", "set aside", "readmitted"]
    return [*table(header, shown), *note]


def _rejected(report: Report, found: Snooping, name: str) -> list[str]:
    aside = report.set_aside
    if not found.rejected or aside is None:
        return []
    rows, notes = [], []
    shown, cut = report.cut(list(found.rejected), "observations set aside", "snooping.csv")
    for r in shown:
        row = aside.find(r.id, r.component)
        unit = row.scale.size
        rows.append(
            [
                *names_of(row),
                str(r.round or found.at_the_start),
                decimal(row.sign * r.test, 2),
                f"{short(row.sign * r.estimated_error / unit)} {row.scale.small}".strip(),
                *_final(r, unit, row.sign),
            ]
        )
        notes.append(_inseparable(r))
    header = [*NAMES, "round", name, "error", "final error", "σ", f"final {name}"]
    header, rows = without_empty(header, rows)
    left = header.index("round")
    legend = (
        "error: estimated, observed − true, when it was set aside; final error: observed − "
        "computed from the clean solution, with its σ without a gross error"
    )
    return ["", *table(header, rows, left=left, notes=notes), *cut, *paragraph(legend)]


def _final(r: Rejected, unit: float, sign: float) -> list[str]:
    if not isfinite(r.final_error):
        return ["–", "", ""]
    error, sigma = sign * r.final_error / unit, r.final_sigma / unit
    return [short(error), short(sigma), decimal(sign * r.final_test, 2)]


def _inseparable(r: Rejected) -> str:
    if not r.inseparable:
        return ""
    named = [whole(f"{label} ({rho:+.2f})") for label, rho in r.inseparable]
    more = f" and {len(named) - PARTNERS} more" if len(named) > PARTNERS else ""
    return f"not to be told apart from: {', '.join(named[:PARTNERS])}{more}"


def _others(found: Snooping) -> list[str]:
    """Return the sentences about readmitted observations."""
    out = []
    if found.readmitted:
        again = {r.id for r in found.rejected}
        names = [f"{i} (rejected again)" if i in again else i for i in found.readmitted]
        out += paragraph(
            f"readmitted, since the clean solution agrees with them: {listed(names, NAMED)}"
        )
    return out


def _points(report: Report, found: Snooping, name: str) -> list[str]:
    """Return points that were set aside with all their observations."""
    if not found.points_set_aside:
        return []
    shown, note = report.cut(list(found.points_set_aside), "points", "snooping.csv")
    rows = [
        [p.name, p.label, str(len(p.rays)), str(p.round or found.at_the_start), f"{p.test:.2f}"]
        for p in shown
    ]
    out = [
        "",
        "  points set aside with all their rays, which do not determine them without the worst",
    ]
    return [*out, *table(["point", "worst ray", "rays", "round", name], rows, left=2), *note]


def _unresolved(report: Report, found: Snooping, name: str) -> list[str]:
    if not found.unresolved:
        return []
    shown, note = report.cut(list(found.unresolved), "unresolved observations", "snooping.csv")
    rows = []
    for u in shown:
        row = report.rows.at([_row(report, u.id, u.component)])[0]
        error = short(row.sign * u.estimated_error / row.scale.size)
        rows.append(
            [*names_of(row), decimal(row.sign * u.test, 2), f"{error} {row.scale.small}".strip()]
        )
    header, rows = without_empty([*NAMES, name, "error"], rows)
    out = ["", "  UNRESOLVED: above the critical value, but they stay in"]
    return [
        *out,
        *table(header, rows, left=len(header) - 2, notes=[u.reason for u in shown]),
        *note,
    ]


def _row(report: Report, ident: str, component: str) -> int:
    table = report.solution.observations
    rows: list[int] = report.solution.equations.find([ident])[0].tolist()
    return next((r for r in rows if table[r].component == component), rows[0])


def components(report: Report) -> list[str]:
    """Return estimated factors of the standard deviations of groups of observations."""
    found = report.components
    if found is None:
        return []
    kinds = {b.kind for b in report.solution.equations.blocks}
    rows = [_component(c, kind=c.name in kinds) for c in found.components]
    header = ["group", "scalars", "r", "factor of σ", "±", f"{percent(CONFIDENCE)} interval", ""]
    notes = [c.note for c in found.components]
    ended = "converged" if found.converged else "NOT CONVERGED"
    words = (
        f"{found.iterations} adjustments, {ended}: {found.reason}; the figures below have the "
        "estimated σ, which make σ̂0 about 1"
    )
    if not found.exact:
        words += "; redundancies and ± from stochastic traces, to a few per cent"
    return [*title("Variance components"), *table(header, rows, notes=notes), *paragraph(words)]


def _component(c: VarianceComponent, *, kind: bool) -> list[str]:
    low, high = c.interval(confidence=CONFIDENCE)
    interval = f"{low:.3f} … {high:.3f}" if c.estimated and np.isfinite(high) else "–"
    sigma = short(c.sigma) if c.estimated and np.isfinite(c.sigma) else "–"
    name = kind_name(c.name) if kind else c.name
    return [name, str(c.n), f"{c.redundancy:.2f}", f"{c.factor:.3f}", sigma, interval, c.state]
