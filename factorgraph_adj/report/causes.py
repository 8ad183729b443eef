"""Sections of the protocol: likely causes of misfits, and tests of given values that are held."""

from __future__ import annotations

from ..models.variables import UNKNOWNS
from ..quality.causes.cause import Cause
from ..quality.causes.evidence import VarianceFactor
from ..quality.causes.given import GivenValue
from ..quality.causes.hypotheses import Size
from ..quality.causes.search import EXCHANGES
from ..units import decimal
from .context import Report
from .layout import NO_BREAK, listed, paragraph, percent, short, table, title

MOST = 3
"""Largest number of causes that are listed, those that explain as much as these apart."""
NAMED = 6
"""Largest number of observations of a cause that are named."""


def unit_of(report: Report, size: Size) -> tuple[float, str]:
    """Return the unit of the size of an error, SI, and its name."""
    if size == "length":
        return report.small, report.units.sigma_length
    if size in ("angle", "turn"):
        return report.radian, report.units.sigma_angle
    return {"ppm": (1.0, "ppm"), "ratio": (0.01, "%")}.get(size, (1.0, ""))


def causes(report: Report) -> list[str]:
    """Return the likeliest causes of misfits that several observations share."""
    found = report.causes
    if found is None:
        return []
    undecided = [line for text in found.nothing_tells for line in paragraph(text)]
    if not found.likelier:
        heading = title("An error, but nothing tells in which reading")
        return [*heading, *undecided] if undecided else []
    shown = found.likelier[:MOST]
    out = title("Likely causes, each of which explains more than any single reading")
    for i, cause in enumerate(shown, start=1):
        out += paragraph(f"{i}. {sentence(report, cause)}")
        out += paragraph(f"shared by {_members(cause)}", indent=5) if cause.ids else []
    more = len(found.likelier) - len(shown)
    if more:
        out.append(f"  … {more} more explain less")
    out += undecided
    legend = (
        f"of {found.tested} hypotheses, each tested with α0 = {percent(found.alpha)}; T²: by how "
        "much less vᵀPv would be; size: observed, recorded or given − true, of centring instrument "
        "or target − mark. One of them may be right: put the first right, and adjust again"
    )
    if report.snooping is None and all(c.sizes for c in found.found):
        legend += f"; {EXCHANGES}"
    return [*out, *paragraph(legend)]


def exchanges_untested(report: Report) -> list[str]:
    """Return a hint at exchanges, where they were not tested and may be behind the result.

    They may where the adjustment has no minimum, or where the likeliest cause would have to be
    larger than such an error is.
    """
    found = report.causes
    if report.snooping is not None or (found is not None and not all(c.sizes for c in found.found)):
        return []
    if not report.solution.converged:
        return [f"gross errors may keep an adjustment from a minimum; {EXCHANGES}"]
    if not report.bent:
        return []
    return [f"its size is not that of such an error: readings may be exchanged; {EXCHANGES}"]


def sentence(report: Report, cause: Cause) -> str:
    """Return a cause with its size and its test."""
    return cause.said(lambda size: unit_of(report, size), short, space=NO_BREAK)


def likeliest(report: Report) -> str:
    """Return the cause that explains most, with what is left, or between what nothing tells.

    Empty if no cause explains more than single readings.
    """
    found = report.causes
    if found is None:
        return ""
    if found.likeliest is None:
        return next(iter(found.nothing_tells), "")
    return found.said_likeliest(lambda cause: sentence(report, cause))


def _members(cause: Cause) -> str:
    n = len(cause.ids)
    return f"{n} observation{'s' * (n != 1)}: {listed(cause.ids, NAMED)}"


def given(report: Report) -> list[str]:
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
        rows += [_row(report, v, i) for i in range(len(v.components))]
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


def _row(report: Report, v: GivenValue, i: int) -> list[str]:
    one = v.apart[i]
    unit, symbol = unit_of(report, v.sizes[i])
    name = f"{UNKNOWNS[v.kind].title} {v.name}" if i == 0 else ""
    whole = f"{v.together.t2:.2f}" if i == 0 and v.together.dof else ""
    if not one.dof:
        return [name, v.components[i], "–", "–", "–", whole]
    figures = [f"{short(one.error[0] / unit)} {symbol}".strip(), short(one.sigma[0] / unit)]
    return [name, v.components[i], *figures, decimal(float(v.w[i]), 2), whole]
