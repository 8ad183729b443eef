"""Section, tables and snooping.csv of data snooping: rejected, readmitted, unresolved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any

from ..quality.rejections import Rejected, RejectedPoint, Snooping, Unresolved
from ..units import significant
from .adjusted_observations import test_symbol
from .adjustment_report import Report
from .layout import listed, paragraph, table, title, unbroken
from .observation_rows import Row, identity_columns
from .reliability import MAX_INSEPARABLE_LISTED
from .tables import NO_FIGURE, READ, Column, Table, Unit, as_csv, as_text

MAX_READMITTED_NAMED = 12
"""Largest number of readmitted observations that are named."""


@dataclass(frozen=True)
class Finding:
    """An observation that data snooping rejected, readmitted, or could not resolve."""

    row: Row
    """Its row in the network before data snooping."""
    state: str
    """What became of it."""
    found: Any
    """The finding of data snooping; None where it has no figures."""
    whole: bool = False
    """Whether the row stands for the whole observation with all its components."""

    def figure(self, name: str) -> Any:
        """Return a figure or a text of the finding; None where it has none."""
        return getattr(self.found, name, None)

    def signed(self, name: str) -> float | None:
        """Return a figure of the finding in the axes of files."""
        value = self.figure(name)
        return None if value is None else self.row.sign * value


def snooping_section(report: Report) -> list[str]:
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
        *_rejected(report, found),
        *_others(found),
        *_points(report, found),
        *_unresolved(report, found),
    ]


def _how_many(found: Snooping) -> str:
    """Return how many observations were rejected before the rounds, and in them."""
    gone, back = (sum(getattr(r, a) for r in found.rounds) for a in ("set_aside", "readmitted"))
    now = _aside(found) + len(found.rejected_factors)
    before, last = now - (gone - back), max(r.number for r in found.rounds)
    rounds = f"in {last} round{'s' * (last != 1)}"
    if not before:
        return f"{_observations(now)} rejected {rounds}"
    more = f"{gone} more" if gone else "no others"
    return f"{_observations(before)} rejected before the first round, {more} {rounds}"


def _aside(found: Snooping) -> int:
    """Return how many observations are rejected, with the rays of points."""
    return len(found.rejected) + sum(len(p.rays) for p in found.rejected_points)


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
    header = ["round", "σ̂0", f"max |{name}|", "above critical", "rejected", "readmitted"]
    return [*table(header, shown), *note]


def rejected_table(report: Report, some: Sequence[Finding]) -> Table[Finding]:
    """Return the table of rejected observations, as the clean solution predicts them."""

    def final_error(f: Finding) -> str | None:
        return None if isfinite(f.found.final_error) else NO_FIGURE

    final_test = Column[Finding](
        title="final_tau" if report.pope else "final_w",
        value=lambda f: f.signed("final_test"),
        digits=2,
    )
    columns = [
        *_identity(),
        _round(report),
        *_test_and_error(report),
        Column(
            title="final_error",
            value=lambda f: f.signed("final_error"),
            unit=_fine,
            help="final_error",
            shown=final_error,
        ),
        Column(title="σ", value=lambda f: f.found.final_sigma, unit=_fine),
        final_test,
        *_unit_of_finding(),
        Column(
            title="partners",
            value=lambda f: "; ".join(
                f"{label} ({rho:+.2f})" for label, rho in f.found.inseparable
            ),
            help="partners",
            only=("html",),
        ),
        Column(title="partners", value=lambda f: _inseparable(f.found), below="", only=("text",)),
        Column(title="source", value=lambda f: f.row.source, only=("html",)),
    ]
    return Table("rejected", some, columns)


def unresolved_table(report: Report, some: Sequence[Unresolved]) -> Table[Finding]:
    """Return the table of observations above the critical value that stay in."""
    rows = report.rows.at([_row_of_component(report, u.id, u.component) for u in some])
    every = [Finding(row, "unresolved", u) for row, u in zip(rows, some, strict=True)]
    columns = [
        *_identity(),
        *_test_and_error(report),
        *_unit_of_finding(),
        Column(title="reason", value=lambda f: f.found.reason, below="", english=True, only=READ),
        Column(title="source", value=lambda f: f.row.source, only=("html",)),
    ]
    return Table("unresolved", every, columns)


def rejected_points_table(report: Report, some: Sequence[RejectedPoint]) -> Table[RejectedPoint]:
    """Return the table of points that were rejected with all their rays."""
    columns: list[Column[RejectedPoint]] = [
        Column(title="point", value="name"),
        Column(title="worst_ray", value="label"),
        Column(title="rays", value=lambda p: len(p.rays)),
        _round(report),
        Column(title=test_symbol(report), value="test", digits=2),
    ]
    return Table("points_aside", some, columns)


def _identity() -> list[Column[Finding]]:
    """Return the columns that identify an observation of data snooping."""
    return [
        Column(title="kind", value=lambda f: f.row.kind_name, translated=True),
        Column(title="what", value=lambda f: f.row.what, only=("text",)),
        Column(title="observation", value=lambda f: f.row.what, only=("html",)),
        Column(title="id", value=lambda f: f.row.own_id),
        Column(title="from", value=lambda f: f.row.source, only=("text",)),
    ]


def _round(report: Report) -> Column[Any]:
    """Return the round in which data snooping rejected, or what did before the first round."""
    assert report.snooping is not None
    start = report.snooping.at_the_start

    def shown(f: Any) -> str:
        return str(getattr(f, "found", f).round or start)

    return Column(
        title="round", value=lambda f: getattr(f, "found", f).round, shown=shown, translated=True
    )


def _test_and_error(report: Report) -> list[Column[Finding]]:
    return [
        Column(title=test_symbol(report), value=lambda f: f.signed("test"), digits=2, help="test"),
        Column(
            title="error",
            value=lambda f: f.signed("estimated_error"),
            unit=_fine,
            with_unit=True,
            help="error",
        ),
    ]


def _unit_of_finding() -> list[Column[Finding]]:
    return [Column(title="unit", value=lambda f: f.row.scale.small, only=("html",))]


def _fine(f: Finding) -> Unit:
    return f.row.scale.fine


def _rejected(report: Report, found: Snooping) -> list[str]:
    aside = report.set_aside
    if not found.rejected or aside is None:
        return []
    shown, cut = report.cut(list(found.rejected), "rejected observations", "snooping.csv")
    some = [Finding(aside.find(r.id, r.component), "rejected", r) for r in shown]
    legend = (
        "error: estimated, observed − true, when it was rejected; final error: observed − "
        "computed from the clean solution, with its σ without a gross error"
    )
    return ["", *as_text(rejected_table(report, some)), *cut, *paragraph(legend)]


def _inseparable(r: Rejected) -> str:
    if not r.inseparable:
        return ""
    named = [unbroken(f"{label} ({rho:+.2f})") for label, rho in r.inseparable]
    more = (
        f" and {len(named) - MAX_INSEPARABLE_LISTED} more"
        if len(named) > MAX_INSEPARABLE_LISTED
        else ""
    )
    return f"not distinguishable from: {', '.join(named[:MAX_INSEPARABLE_LISTED])}{more}"


def _others(found: Snooping) -> list[str]:
    """Return the sentences about readmitted observations."""
    out = []
    if found.readmitted:
        again = {r.id for r in found.rejected}
        names = [f"{i} (rejected again)" if i in again else i for i in found.readmitted]
        out += paragraph(
            "readmitted, since the clean solution agrees with them: "
            f"{listed(names, MAX_READMITTED_NAMED)}"
        )
    return out


def _points(report: Report, found: Snooping) -> list[str]:
    """Return points that were rejected with all their observations."""
    if not found.rejected_points:
        return []
    shown, note = report.cut(list(found.rejected_points), "points", "snooping.csv")
    words = "  points rejected with all their rays, which do not determine them without the worst"
    return ["", words, *as_text(rejected_points_table(report, shown)), *note]


def _unresolved(report: Report, found: Snooping) -> list[str]:
    if not found.unresolved:
        return []
    shown, note = report.cut(list(found.unresolved), "unresolved observations", "snooping.csv")
    words = "  UNRESOLVED: above the critical value, but they stay in"
    return ["", words, *as_text(unresolved_table(report, shown)), *note]


def _row_of_component(report: Report, ident: str, component: str) -> int:
    table = report.solution.observations
    rows: list[int] = report.solution.equations.find([ident])[0].tolist()
    return next((r for r in rows if table[r].component == component), rows[0])


# -- snooping.csv ---------------------------------------------------------------------------------


def findings(report: Report) -> list[Finding]:
    """Return what data snooping rejected, readmitted or could not resolve."""
    found, aside = report.snooping, report.set_aside
    if found is None or aside is None:
        return []
    gone = {r.id for r in found.rejected}
    again = [i for i in found.readmitted if i not in gone]
    return [
        *(Finding(aside.find(r.id, r.component), "rejected", r) for r in found.rejected),
        *(
            Finding(aside.find(ray, ""), "point rejected", replace(p, test=nan), whole=True)
            for p in found.rejected_points
            for ray in p.rays
        ),
        *(Finding(aside.find(i, ""), "readmitted", None, whole=True) for i in again),
        *(Finding(aside.find(u.id, u.component), "unresolved", u) for u in found.unresolved),
    ]


def snooping_csv(report: Report) -> str:
    """Return snooping.csv: observations that were rejected, readmitted or unresolved."""
    every = findings(report)
    rows = [f.row for f in every]
    cells = list(identity_columns(rows).items())
    place = {id(f): i for i, f in enumerate(every)}

    def cell(name: str, values: Sequence[str]) -> Column[Finding]:
        empty = name in ("component", "observed")
        return Column(
            title=name, value=lambda f: None if empty and f.whole else values[place[id(f)]]
        )

    def inseparable(f: Finding) -> str:
        return "; ".join(f"{label} ({rho:+.3f})" for label, rho in f.figure("inseparable") or ())

    columns = [
        *(cell(name, values) for name, values in cells),
        Column(title="sigma", value=lambda f: f.row.sigma, unit=_fine),
        Column(title="small_unit", value=lambda f: f.row.scale.small),
        Column(title="state", value="state"),
        Column(title="round", value=lambda f: f.figure("round")),
        Column(title="test_value", value=lambda f: f.signed("test")),
        Column(title="estimated_error", value=lambda f: f.signed("estimated_error"), unit=_fine),
        Column(title="final_error", value=lambda f: f.signed("final_error"), unit=_fine),
        Column(title="final_sigma", value=lambda f: f.figure("final_sigma"), unit=_fine),
        Column(title="final_test_value", value=lambda f: f.signed("final_test")),
        Column(title="not_told_apart_from", value=inseparable),
        Column(title="reason", value=lambda f: f.figure("reason")),
        Column(title="source", value=lambda f: f.row.source),
    ]
    return as_csv(Table("snooping", every, columns)) if every else ""
