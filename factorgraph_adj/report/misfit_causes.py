"""Text sections of likely causes of misfits, tests of held values, variance components; doubts."""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite

from ..models.unknown_registry import UNKNOWNS
from ..quality.causes.cause_search import EXCHANGES_NOTE
from ..quality.causes.evidence import Cause, VarianceFactor
from ..quality.causes.shared_error_tests import GivenValue
from ..quality.causes.shared_errors import ErrorQuantity
from ..quality.variance_components import VarianceComponent, VarianceComponents
from ..units import decimal
from .adjustment_report import Report
from .doubtful_results import doubts_of_provenance
from .layout import NO_BREAK, listed, paragraph, percent, short, table, title
from .observation_rows import kind_name
from .tables import NO_FIGURE, READ, Column, Table, as_text

MAX_CAUSES_LISTED = 3
"""Largest number of causes that are listed, those that explain as much as these apart."""
MAX_IDS_OF_CAUSE = 6
"""Largest number of observations of a cause that are named."""
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
    return cause.said(lambda size: unit_of_error(report, size), short, space=NO_BREAK)


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
