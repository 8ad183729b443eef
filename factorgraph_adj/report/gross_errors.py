"""Data snooping, likely causes of misfits, given values, and variance components."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any

import numpy as np

from ..models.variables import UNKNOWNS
from ..quality.causes.cause_search import EXCHANGES_NOTE
from ..quality.causes.evidence import Cause, VarianceFactor
from ..quality.causes.shared_error_tests import GivenValue
from ..quality.causes.shared_errors import ErrorQuantity
from ..quality.rejections import Rejected, Snooping
from ..quality.variance_components import VarianceComponent
from ..units import decimal, significant
from .adjustment_report import Report
from .doubtful_results import doubts_of_provenance
from .layout import (
    NO_BREAK,
    listed,
    paragraph,
    percent,
    short,
    table,
    title,
    unbroken,
    without_empty_columns,
)
from .observation_rows import Row, identity_columns, kind_name
from .reliability import IDENTITY_HEADER, MAX_INSEPARABLE_LISTED, identity_cells
from .tables import Column, Table, Unit, as_csv

MAX_CAUSES_LISTED = 3
"""Largest number of causes that are listed, those that explain as much as these apart."""
MAX_IDS_OF_CAUSE = 6
"""Largest number of observations of a cause that are named."""
MAX_READMITTED_NAMED = 12
"""Largest number of readmitted observations that are named."""
CONFIDENCE_OF_COMPONENTS = 0.95
"""Confidence of the intervals of variance components."""


def unit_of_error(report: Report, size: ErrorQuantity) -> tuple[float, str]:
    """Return the unit of the size of an error, SI, and its name."""
    if size == "length":
        return report.small, report.units.sigma_length
    if size in ("angle", "turn"):
        return report.radian, report.units.sigma_angle
    return {"ppm": (1.0, "ppm"), "ratio": (0.01, "%")}.get(size, (1.0, ""))


def causes_section(report: Report) -> list[str]:
    """Return the most probable causes of misfits that several observations share."""
    found = report.causes
    if found is None:
        return []
    undecided = [line for text in found.undecided_sentences for line in paragraph(text)]
    if not found.more_probable:
        heading = title("An error, but nothing tells in which reading")
        return [*heading, *undecided] if undecided else []
    shown = found.more_probable[:MAX_CAUSES_LISTED]
    out = title("Likely causes, each of which explains more than any single reading")
    for i, cause in enumerate(shown, start=1):
        out += paragraph(f"{i}. {cause_sentence(report, cause)}")
        out += paragraph(f"shared by {_members(cause)}", indent=5) if cause.ids else []
    more = len(found.more_probable) - len(shown)
    if more:
        out.append(f"  … {more} more explain less")
    out += undecided
    legend = (
        f"of {found.tested} hypotheses, each tested with α0 = {percent(found.alpha)}; T²: by how "
        "much less vᵀPv would be; size: observed, recorded or given − true, of centring instrument "
        "or target − mark. One of them may be right: put the first right, and adjust again"
    )
    if report.snooping is None and all(c.sizes for c in found.found):
        legend += f"; {EXCHANGES_NOTE}"
    return [*out, *paragraph(legend)]


def all_doubts(report: Report) -> list[str]:
    """Return why the result may be wrong, with what snooping and variance components left open."""
    return [*report.doubts, *doubts_of_provenance(report.snooping, report.components)]


def exchange_hints(report: Report) -> list[str]:
    """Return a hint at exchanges, where they were not tested and may be behind the result.

    They may where the adjustment has no minimum, or where the most probable cause would have to be
    larger than such an error is.
    """
    found = report.causes
    if report.snooping is not None or (found is not None and not all(c.sizes for c in found.found)):
        return []
    if not report.solution.converged:
        return [f"gross errors may keep an adjustment from a minimum; {EXCHANGES_NOTE}"]
    if not report.bent:
        return []
    return [f"its size is not that of such an error: readings may be exchanged; {EXCHANGES_NOTE}"]


def cause_sentence(report: Report, cause: Cause) -> str:
    """Return a cause with its size and its test."""
    return cause.said(lambda size: unit_of_error(report, size), short, space=NO_BREAK)


def most_probable_cause(report: Report) -> str:
    """Return the cause that explains most, with what is left, or between what nothing tells.

    Empty if no cause explains more than single readings.
    """
    found = report.causes
    if found is None:
        return ""
    if found.most_probable is None:
        return next(iter(found.undecided_sentences), "")
    return found.most_probable_text(lambda cause: cause_sentence(report, cause))


def _members(cause: Cause) -> str:
    n = len(cause.ids)
    return f"{n} observation{'s' * (n != 1)}: {listed(cause.ids, MAX_IDS_OF_CAUSE)}"


def given_values_section(report: Report) -> list[str]:
    """Return the held values with the largest test values; one sentence if all of them fit."""
    every = report.given
    if not every:
        return []
    rel = report.reliability
    assert rel is not None
    where = report.where("given_values.csv")
    above = [v for v in every if v.together.dof and v.together.t2 > _limit(report, v)]
    if not above:
        n, tested = len(every), sum(v.together.dof > 0 for v in every)
        some = f"{tested} fit{'s' * (tested == 1)}, nothing tests the other {n - tested}"
        none, every_one = (
            ("nothing tests it", "it fits") if n == 1 else ("nothing tests them", "all fit")
        )
        fit = {n: every_one, 0: none}.get(tested, some)
        text = f"{n} given value{'s' * (n != 1)} held, tested as if free: {fit}; see {where}"
        return paragraph(text)
    order = sorted(above, key=lambda v: -v.together.t2 / v.together.dof)
    rows = []
    for v in order[: report.options.n_suspects]:
        rows += [_given_value_row(report, v, i) for i in range(len(v.components))]
    shown, note = report.cut(rows, "held values", "given_values.csv")
    header = ["given value", "component", "error", "σ", "w", "T² of all"]
    text = (
        "each tested as if it had been given with σ → ∞; error: given − true, if it alone is "
        f"wrong; {len(above)} of {len(every)} do not fit, all in {where}"
    )
    if report.pope:
        text += "; σ0² by F: for each from what vᵀPv would be with it as an unknown"
    heading = title(f"Given values that are held, T² critical (α0 = {percent(rel.alpha)})")
    return [*heading, *table(header, shown, left=2), *note, *paragraph(text)]


def _limit(report: Report, v: GivenValue) -> float:
    """Return T² of a given value, σ0 = 1, that good values exceed with the probability α0."""
    assert report.reliability is not None
    error = v.together
    weight = VarianceFactor.left_by(
        report.solution, estimated=report.pope, t2=error.t2, dof=error.dof
    )
    return weight.limit(error.dof, report.reliability.alpha)


def _given_value_row(report: Report, v: GivenValue, i: int) -> list[str]:
    one = v.apart[i]
    unit, symbol = unit_of_error(report, v.sizes[i])
    name = f"{UNKNOWNS[v.kind].title} {v.name}" if i == 0 else ""
    whole = f"{v.together.t2:.2f}" if i == 0 and v.together.dof else ""
    if not one.dof:
        return [name, v.components[i], "–", "–", "–", whole]
    figures = [f"{short(one.error[0] / unit)} {symbol}".strip(), short(one.sigma[0] / unit)]
    return [name, v.components[i], *figures, decimal(float(v.w[i]), 2), whole]


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
        *_rejected(report, found, name),
        *_others(found),
        *_points(report, found, name),
        *_unresolved(report, found, name),
    ]


def _how_many(found: Snooping) -> str:
    """Return how many observations were set aside before the rounds, and in them."""
    gone, back = (sum(getattr(r, a) for r in found.rounds) for a in ("set_aside", "readmitted"))
    now = _aside(found) + len(found.rejected_factors)
    before, last = now - (gone - back), max(r.number for r in found.rounds)
    rounds = f"in {last} round{'s' * (last != 1)}"
    if not before:
        return f"{_observations(now)} set aside {rounds}"
    more = f"{gone} more" if gone else "no others"
    return f"{_observations(before)} set aside before the first round, {more} {rounds}"


def _aside(found: Snooping) -> int:
    """Return how many observations are set aside, with the rays of points."""
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
                *identity_cells(row),
                str(r.round or found.at_the_start),
                decimal(row.sign * r.test, 2),
                f"{short(row.sign * r.estimated_error / unit)} {row.scale.small}".strip(),
                *_final(r, unit, row.sign),
            ]
        )
        notes.append(_inseparable(r))
    header = [*IDENTITY_HEADER, "round", name, "error", "final error", "σ", f"final {name}"]
    header, rows = without_empty_columns(header, rows)
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
    named = [unbroken(f"{label} ({rho:+.2f})") for label, rho in r.inseparable]
    more = (
        f" and {len(named) - MAX_INSEPARABLE_LISTED} more"
        if len(named) > MAX_INSEPARABLE_LISTED
        else ""
    )
    return f"not to be told apart from: {', '.join(named[:MAX_INSEPARABLE_LISTED])}{more}"


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


def _points(report: Report, found: Snooping, name: str) -> list[str]:
    """Return points that were set aside with all their observations."""
    if not found.rejected_points:
        return []
    shown, note = report.cut(list(found.rejected_points), "points", "snooping.csv")
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
        row = report.rows.at([_row_of_component(report, u.id, u.component)])[0]
        error = short(row.sign * u.estimated_error / row.scale.size)
        rows.append(
            [
                *identity_cells(row),
                decimal(row.sign * u.test, 2),
                f"{error} {row.scale.small}".strip(),
            ]
        )
    header, rows = without_empty_columns([*IDENTITY_HEADER, name, "error"], rows)
    out = ["", "  UNRESOLVED: above the critical value, but they stay in"]
    return [
        *out,
        *table(header, rows, left=len(header) - 2, notes=[u.reason for u in shown]),
        *note,
    ]


def _row_of_component(report: Report, ident: str, component: str) -> int:
    table = report.solution.observations
    rows: list[int] = report.solution.equations.find([ident])[0].tolist()
    return next((r for r in rows if table[r].component == component), rows[0])


def variance_components_section(report: Report) -> list[str]:
    """Return estimated factors of the standard deviations of groups of observations."""
    found = report.components
    if found is None:
        return []
    kinds = {b.kind for b in report.solution.equations.blocks}
    rows = [_component(c, kind=c.name in kinds) for c in found.components]
    header = [
        "group",
        "scalars",
        "r",
        "factor of σ",
        "±",
        f"{percent(CONFIDENCE_OF_COMPONENTS)} interval",
        "",
    ]
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
    low, high = c.interval(confidence=CONFIDENCE_OF_COMPONENTS)
    interval = f"{low:.3f} … {high:.3f}" if c.estimated and np.isfinite(high) else "–"
    sigma = short(c.sigma) if c.estimated and np.isfinite(c.sigma) else "–"
    name = kind_name(c.name) if kind else c.name
    return [name, str(c.n), f"{c.redundancy:.2f}", f"{c.factor:.3f}", sigma, interval, c.state]


# -- snooping.csv ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Finding:
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


def _findings(report: Report) -> list[_Finding]:
    found, aside = report.snooping, report.set_aside
    if found is None or aside is None:
        return []
    gone = {r.id for r in found.rejected}
    again = [i for i in found.readmitted if i not in gone]
    return [
        *(_Finding(aside.find(r.id, r.component), "set aside", r) for r in found.rejected),
        *(
            _Finding(aside.find(ray, ""), "point set aside", replace(p, test=nan), whole=True)
            for p in found.rejected_points
            for ray in p.rays
        ),
        *(_Finding(aside.find(i, ""), "readmitted", None, whole=True) for i in again),
        *(_Finding(aside.find(u.id, u.component), "unresolved", u) for u in found.unresolved),
    ]


def snooping_csv(report: Report) -> str:
    """Return snooping.csv: observations that were rejected, readmitted or unresolved."""
    every = _findings(report)
    rows = [f.row for f in every]
    cells = list(identity_columns(rows).items())
    place = {id(f): i for i, f in enumerate(every)}

    def fine(f: _Finding) -> Unit:
        return f.row.scale.fine

    def cell(name: str, values: Sequence[str]) -> Column[_Finding]:
        empty = name in ("component", "observed")
        return Column(
            title=name, value=lambda f: None if empty and f.whole else values[place[id(f)]]
        )

    def inseparable(f: _Finding) -> str:
        return "; ".join(f"{label} ({rho:+.3f})" for label, rho in f.figure("inseparable") or ())

    columns = [
        *(cell(name, values) for name, values in cells),
        Column(title="sigma", value=lambda f: f.row.sigma, unit=fine),
        Column(title="small_unit", value=lambda f: f.row.scale.small),
        Column(title="state", value="state"),
        Column(title="round", value=lambda f: f.figure("round")),
        Column(title="test_value", value=lambda f: f.signed("test")),
        Column(title="estimated_error", value=lambda f: f.signed("estimated_error"), unit=fine),
        Column(title="final_error", value=lambda f: f.signed("final_error"), unit=fine),
        Column(title="final_sigma", value=lambda f: f.figure("final_sigma"), unit=fine),
        Column(title="final_test_value", value=lambda f: f.signed("final_test")),
        Column(title="not_told_apart_from", value=inseparable),
        Column(title="reason", value=lambda f: f.figure("reason")),
        Column(title="source", value=lambda f: f.row.source),
    ]
    return as_csv(Table("snooping", every, columns)) if every else ""
