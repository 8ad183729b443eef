"""Text sections of likely causes of misfits, tests of held values, variance components; doubts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite
from typing import Any, TypeAlias

import numpy as np

from ..models.unknown_registry import UNKNOWNS
from ..quality.causes.cause_search import EXCHANGES_NOTE
from ..quality.causes.evidence import Cause, VarianceFactor
from ..quality.causes.shared_error_tests import GivenValue, SharedErrorTest
from ..quality.causes.shared_errors import ErrorQuantity
from ..quality.variance_components import VarianceComponent, VarianceComponents
from ..types import Array
from .adjustment_report import Report
from .doubtful_results import doubts_of_provenance
from .layout import NO_BREAK, listed, paragraph, percent, short, title
from .observation_rows import kind_name
from .tables import NO_FIGURE, NUMBER, READ, Column, Table, Unit, as_text

MAX_CAUSES_LISTED = 3
"""Largest number of causes that are listed, those that explain as much as these apart."""
MAX_IDS_OF_CAUSE = 6
"""Largest number of observations of a cause that are named."""
GivenComponent: TypeAlias = tuple[GivenValue, int]
"""A given value, and the number of one of its held components: a row of tables."""
CONFIDENCE_OF_COMPONENTS = 0.95
"""Confidence of the intervals of variance components."""


def unit_of_error(report: Report, size: ErrorQuantity) -> Unit:
    """Return the unit in which the size of an error is shown."""
    if size == "length":
        return Unit(report.units.sigma_length, report.small)
    if size in ("angle", "turn"):
        return Unit(report.units.sigma_angle, report.radian)
    return {"ppm": Unit("ppm"), "ratio": Unit("%", 0.01)}.get(size, NUMBER)


# -- causes ---------------------------------------------------------------------------------------


def causes_table(report: Report, causes: Sequence[Cause]) -> Table[Cause]:
    """Return the table of causes, each of which explains more than any single reading."""

    def sizes(c: Cause) -> str:
        out = []
        for name, size, error, sigma, alone in c.estimates:
            unit = unit_of_error(report, size)
            shown = f"{name} {short(error / unit.size)} ± {short(sigma / unit.size)} {unit.name}"
            out.append(shown.strip() + (" if it alone is wrong" * alone))
        return "; ".join(out)

    def record(key: str, name: str) -> Column[Cause]:
        return Column(
            title=key, value=lambda c: np.asarray(getattr(c, name)).tolist(), only=("json",)
        )

    def named(c: Cause) -> str:
        return listed(c.ids, MAX_IDS_OF_CAUSE)

    columns: list[Column[Cause]] = [
        Column(title="cause", value=lambda c: f"{c.cause} {c.where}", english=True, only=READ),
        Column(title="size", value=sizes, help="cause_size", english=True, only=READ),
        *(record(name, name) for name in ("cause", "where", "components")),
        record("quantities", "sizes"),
        *(record(name, name) for name in ("error", "sigma")),
        Column(title="T²", key="t2", value="t2", digits=1, help="t2"),
        Column(title="dof", value="dof"),
        Column(title="critical", value="critical", digits=1),
        Column(title="shared", value=lambda c: len(c.ids), only=READ),
        Column(title="observations", value=named, only=READ),
        record("ids", "ids"),
    ]
    return Table("causes", causes, columns)


def causes_section(report: Report) -> list[str]:
    """Return the most probable causes of misfits that several observations share."""
    found = report.causes
    if found is None:
        return []
    undecided = [line for text in found.undecided_sentences for line in paragraph(text)]
    if not found.more_probable:
        heading = title("An error, but the observations do not determine in which reading")
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

    def unit(size: ErrorQuantity) -> tuple[float, str]:
        found = unit_of_error(report, size)
        return found.size, found.name

    return cause.said(unit, short, space=NO_BREAK)


def most_probable_cause(report: Report) -> str:
    """Return the cause that explains most, with what is left, or indistinguishable errors.

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


# -- given values ---------------------------------------------------------------------------------


def given_values_table(report: Report, values: Sequence[GivenValue]) -> Table[GivenComponent]:
    """Return the table of tests of given values that are held, one row for each component."""

    def apart(figures: Callable[[SharedErrorTest], Array]) -> Callable[[GivenComponent], Any]:
        """Return a function of the test of the component alone; None where there is none."""

        def figure(row: GivenComponent) -> float | None:
            test = row[0].apart[row[1]]
            return float(figures(test)[0]) if test.dof else None

        return figure

    def unit(row: GivenComponent) -> Unit:
        return unit_of_error(report, row[0].sizes[row[1]])

    def w(row: GivenComponent) -> float | None:
        return float(row[0].w[row[1]]) if row[0].apart[row[1]].dof else None

    def t2(row: GivenComponent) -> float | None:
        return float(row[0].together.t2) if row[0].together.dof else None

    def title_of(row: GivenComponent) -> str:
        return UNKNOWNS[row[0].kind].title

    error, sigma = apart(lambda test: test.error), apart(lambda test: test.sigma)
    columns: list[Column[GivenComponent]] = [
        Column(title="kind", value=title_of, translated=True, only=READ),
        Column(title="kind", value=lambda row: row[0].kind, only=("csv",)),
        Column(title="name", value=lambda row: row[0].name),
        Column(title="parameter", key="component", value=lambda row: row[0].components[row[1]]),
        Column(title="error", value=error, unit=unit, with_unit=True, help="given"),
        Column(title="σ", key="sigma", value=sigma, unit=unit),
        Column(title="unit", value=lambda row: unit(row).name, only=("html", "csv")),
        Column(title="w", value=w, digits=2),
        Column(title="T²", key="t2_together", value=t2, digits=2, help="t2"),
        Column(title="dof_together", value=lambda row: row[0].together.dof, only=("csv",)),
    ]
    return Table("given", [(v, i) for v in values for i in range(len(v.components))], columns)


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
    made = given_values_table(report, order[: report.options.n_suspects])
    rows, note = report.cut(list(made.rows), "held values", "given_values.csv")
    text = (
        "each tested as if it had been given with σ → ∞; error: given − true, if it alone is "
        "wrong; T²: of all components together; "
        f"{len(above)} of {len(every)} do not fit, all in {where}"
    )
    if report.pope:
        text += "; σ0² by F: for each from what vᵀPv would be with it as an unknown"
    heading = title(f"Given values that are held, T² critical (α0 = {percent(rel.alpha)})")
    return [*heading, *as_text(replace(made, rows=rows)), *note, *paragraph(text)]


def _limit(report: Report, v: GivenValue) -> float:
    """Return T² of a given value, σ0 = 1, that good values exceed with the probability α0."""
    assert report.reliability is not None
    error = v.together
    weight = VarianceFactor.left_by(
        report.solution, estimated=report.pope, t2=error.t2, dof=error.dof
    )
    return weight.limit(error.dof, report.reliability.alpha)


# -- variance components --------------------------------------------------------------------------


def variance_components_table(
    report: Report, found: VarianceComponents
) -> Table[VarianceComponent]:
    """Return the table of estimated factors of the standard deviations of groups."""
    kinds = {b.kind for b in report.solution.equations.blocks}

    def name(c: VarianceComponent) -> str:
        return kind_name(c.name) if c.name in kinds else c.name

    def limit(i: int) -> Callable[[VarianceComponent], float]:
        return lambda c: c.interval(confidence=CONFIDENCE_OF_COMPONENTS)[i]

    def interval(c: VarianceComponent) -> str:
        low, high = c.interval(confidence=CONFIDENCE_OF_COMPONENTS)
        return f"{low:.3f} … {high:.3f}" if c.estimated and isfinite(high) else NO_FIGURE

    def sigma(c: VarianceComponent) -> str:
        return short(c.sigma) if c.estimated and isfinite(c.sigma) else NO_FIGURE

    columns: list[Column[VarianceComponent]] = [
        Column(title="group", value=name, only=READ, translated=True),
        Column(title="group", value="name", only=("csv",)),
        Column(title="scalars", value="n"),
        Column(title="Σr", key="redundancy", value="redundancy", digits=2),
        Column(title="factor", value="factor", digits=3, help="factor"),
        Column(title="±", key="sigma_factor", value="sigma", shown=sigma),
        Column(title="freedom", value="freedom", only=("csv",)),
        Column(title="p_value", value="p_value", only=("csv",)),
        Column(title="lower_95", value=limit(0), only=("csv",)),
        Column(title="upper_95", value=limit(1), only=("csv",)),
        Column(title="interval", value=limit(1), shown=interval, only=READ),
        Column(title="state", value="state", translated=True),
        Column(title="note", value="note", below="", english=True, only=(*READ, "csv")),
    ]
    return Table("components", found.components, columns)


def variance_components_section(report: Report) -> list[str]:
    """Return estimated factors of the standard deviations of groups of observations."""
    found = report.components
    if found is None:
        return []
    ended = "converged" if found.converged else "NOT CONVERGED"
    words = (
        f"{found.iterations} adjustments, {ended}: {found.reason}; the figures below have the "
        "estimated σ, which make σ̂0 about 1"
    )
    if not found.exact:
        words += "; redundancies and ± from stochastic traces, to a few per cent"
    made = as_text(variance_components_table(report, found))
    return [*title("Variance components"), *made, *paragraph(words)]
