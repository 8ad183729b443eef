"""Text sections of reliability: redundancy by kind, weakest observations and points, largest tests.

The points that undetected errors move most are found without all effects on all points: the
largest effect of an observation on any point bounds its effect on each.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from ..quality.error_effects import row_place, unit_error_shifts
from ..quality.group_tests import GroupReliability
from ..quality.reliability import Reliability, point_redundancy
from ..statistical_tests import global_test
from ..types import Index, Mask
from ..units import decimal, significant
from .adjusted_observations import lists_every_observation, redundancy_text
from .adjustment_report import Report
from .layout import listed, paragraph, percent, short, table, title, unbroken, without_empty_columns
from .observation_rows import Row, RowGroup

OBSERVATIONS_PER_SOLVE = 8
"""Number of observations whose effects are computed in one solve."""
MAX_WEAKEST_LISTED = 5
"""Number of weakest observations and of weakest points that are listed."""
MIN_REDUNDANCY_OF_CONTROL = 0.01
"""Redundancy number below which an observation is controlled in name only: German practice calls
observations below 1 % not controlled, as their smallest detectable errors exceed 41 σ."""
MAX_NAMES_IN_SENTENCE = 8
"""Largest number of names in a sentence."""
MAX_INSEPARABLE_LISTED = 4
"""Largest number of observations listed as inseparable from a suspect."""
IDENTITY_HEADER = ("kind", "what", "id", "from")
"""Header of the columns that identify an observation."""


@dataclass(frozen=True)
class WeakPoint:
    """A point and the undetected error that moves the point most."""

    name: str
    """Name of the point."""
    effect: float
    """Largest shift of the point by a smallest detectable error, metres: length of the vector."""
    row: int
    """Scalar row of the observation with this error."""


def weakest_points(rel: Reliability, most: int) -> list[WeakPoint]:
    """Return the points that smallest detectable errors of controlled observations move most.

    An observation's ``largest_effect`` bounds its effect on each of its points. Observations are
    taken in decreasing order of this bound, until enough points have larger effects than the
    bound of the remaining observations.
    """
    solution = rel.solution
    offset = solution.equations.unknowns["point"].offset
    names = solution.equations.unknowns["point"].names
    bound = np.where(rel.controlled, np.nan_to_num(rel.largest_effect, posinf=0.0), 0.0)
    order = np.argsort(-bound, kind="stable")
    order = order[bound[order] > 0]
    best: dict[int, tuple[float, int]] = {}
    for start in range(0, len(order), OBSERVATIONS_PER_SOLVE):
        rows = order[start : start + OBSERVATIONS_PER_SOLVE]
        left = bound[rows[0]] * (1.0 + 1e-9)
        if sum(size >= left for size, _ in best.values()) >= most:
            break
        moved = unit_error_shifts(solution, rows) * rel.mdb[rows]
        for j, row in enumerate(rows.tolist()):
            place = row_place(solution.equations, row)
            for kind, index in place.block.variables:
                point = int(index[place.observation])
                if kind == "point" and offset[point] >= 0:
                    size = float(np.linalg.norm(moved[offset[point] : offset[point] + 3, j]))
                    if size > best.get(point, (0.0, 0))[0]:
                        best[point] = size, row
    ranked = sorted(best.items(), key=lambda item: -item[1][0])[:most]
    return [WeakPoint(names[p], size, row) for p, (size, row) in ranked]


def reliability_section(report: Report) -> list[str]:
    """Return redundancy numbers by kind, and the uncontrolled observations."""
    rel = report.reliability
    if rel is None:
        return [*title("Reliability"), *paragraph(report.no_reliability)]
    if report.solution.redundancy <= 0:
        return []
    limits = f"α0 = {percent(rel.alpha)}, power {percent(rel.power)}: δ0 = {rel.delta0:.2f}"
    groups = report.rows.groups()
    uncontrolled = ~rel.controlled & ~report.stiff
    rows = [_of_group(rel, g, uncontrolled) for g in groups]
    extra = report.solution.extra.n_rows
    if extra:
        r = rel.redundancy_of_extra_factors
        rows.append(["further factors", str(extra), f"{r:.2f}", "", f"{r / extra:.2f}", "", "", ""])
    if len(rows) > 1:
        numbers = rel.redundancy_numbers
        total = numbers.sum() + rel.redundancy_of_extra_factors
        n = len(numbers) + extra
        low, high = _two(numbers.min()), _two(numbers.max())
        free = _count(uncontrolled)
        rows.append(["all", str(n), f"{total:.2f}", low, f"{total / n:.2f}", high, "", free])
    header = ["kind", "scalars", "Σr", "min r", "mean r", "max r", "median ∇", "uncontrolled"]
    out = [*title(f"Reliability ({limits})"), *table(header, rows), *_words(report, rel)]
    return out


def _of_group(rel: Reliability, group: RowGroup, uncontrolled: Mask) -> list[str]:
    r, mdb = rel.redundancy_numbers[group.rows], rel.mdb[group.rows]
    finite = mdb[np.isfinite(mdb)]
    middle = ""
    if len(finite) and group.scale.small:
        middle = f"{short(float(np.median(finite)) / group.scale.size)} {group.scale.small}"
    figures = [_two(x) for x in (r.sum(), r.min(), r.mean(), r.max())]
    return [group.label, str(group.scalars), *figures, middle, _count(uncontrolled[group.rows])]


def _two(r: float) -> str:
    """Write a redundancy number; a rounding error below zero gives 0."""
    return f"{r + 0.0 if abs(r) >= 0.005 else 0.0:.2f}"


def _count(rows: Mask) -> str:
    return str(int(rows.sum()) or "–")


def hardly_controlled(report: Report, rel: Reliability) -> Index:
    """Return the rows with redundancy numbers that control in name only, by their size."""
    r = rel.redundancy_numbers
    rows = np.flatnonzero(rel.controlled & ~report.stiff & (r < MIN_REDUNDANCY_OF_CONTROL))
    return rows[np.argsort(r[rows], kind="stable")]


def _words(report: Report, rel: Reliability) -> list[str]:
    """Return sentences that explain the figures."""
    out = []
    if not report.solution.converged:
        out.append("not converged: these figures belong to the state where the iteration stopped")
    if report.solution.redundancy == 1:
        out.append(
            "one redundant observation: an error would show, but not which observation it is in"
        )
    numbers = np.flatnonzero(~rel.controlled & ~report.stiff)
    if len(numbers):
        shown = [
            unbroken(f"{r.kind_name} {r.what}")
            for r in report.rows.at(numbers[:MAX_NAMES_IN_SENTENCE])
        ]
        more = f" … ({len(numbers)} in all, see {report.where('observations.csv')})"
        out.append(
            "controlled by no other observation, so that no error of theirs shows: "
            + ", ".join(shown)
            + (more if len(numbers) > MAX_NAMES_IN_SENTENCE else "")
        )
        points = point_redundancy(rel)
        lonely = np.flatnonzero((points.rows > 0) & (points.uncontrolled == points.rows))
        names = report.solution.equations.unknowns["point"].names
        if len(lonely):
            named = listed([names[i] for i in lonely], MAX_NAMES_IN_SENTENCE)
            out.append(f"points with no controlled observation: {named}")
    hardly = hardly_controlled(report, rel)
    if len(hardly):
        shown = [
            unbroken(f"{row.kind_name} {row.what}")
            + f" {redundancy_text(float(rel.redundancy_numbers[i]))}"
            for row, i in zip(
                report.rows.at(hardly[:MAX_NAMES_IN_SENTENCE]), hardly.tolist(), strict=False
            )
        ]
        out.append(
            f"hardly controlled, r < {MIN_REDUNDANCY_OF_CONTROL:g} ({len(hardly)} scalar "
            f"observation{'s' * (len(hardly) > 1)}): smallest detectable errors above "
            f"{rel.delta0 / MIN_REDUNDANCY_OF_CONTROL**0.5:.0f} σ; smallest r: " + ", ".join(shown)
        )
    if report.stiff.any():
        out.append(_ties(report, rel))
    return [line for text in out for line in paragraph(text)]


def _ties(report: Report, rel: Reliability) -> str:
    """Return a sentence about the stiff ties, which the lists of weak observations leave out."""
    rows = report.rows.at(np.flatnonzero(report.stiff))
    kinds = ", ".join(sorted({r.kind_name for r in rows}))
    largest = short(float(np.abs(rel.redundancy_numbers[report.stiff]).max()))
    return (
        f"{len({r.id for r in rows})} stiff ties ({kinds}; r up to {largest}) are not listed as "
        "weak or uncontrolled: they were stated of the model and not measured; a larger σ (of a "
        "member of a rig: more play) lets an error in them show where others see the same"
    )


def weakest_section(report: Report) -> list[str]:
    """Return controlled observations with the smallest r; points that hidden errors move most."""
    rel = report.reliability
    if rel is None or report.solution.redundancy <= 0 or not rel.controlled.any():
        return []
    points = _weakest_points(report, rel)
    few = int(rel.controlled.sum()) <= report.options.n_suspects
    shown = rel.controlled & ~report.stiff
    if not shown.any() or (few and not _above(report)):
        return points  # the lists of test values contain all observations with their r
    r = np.where(shown, rel.redundancy_numbers, np.inf)
    order = np.argsort(r, kind="stable")[: min(MAX_WEAKEST_LISTED, int(shown.sum()))]
    unit = report.units.sigma_length
    rows = []
    for row in report.rows.at(order.tolist()):
        i = row.number
        rows.append(
            [
                *identity_cells(row),
                short(rel.redundancy_numbers[i]),
                f"{short(rel.mdb[i] / row.scale.size)} {row.scale.small}".strip(),
                short(rel.delta_bar[i]),
                _length(rel.largest_effect[i], report),
            ]
        )
    header = [*IDENTITY_HEADER, "r", "∇", "δ̄", f"effect [{unit}]"]
    header, rows = without_empty_columns(header, rows)
    left = len(header) - 3 - (header[-1].startswith("effect"))
    out = title(
        "Weakest observations (∇: smallest detectable error; effect: shift of their points)"
    )
    out += table(header, rows, left=left)
    return [*out, "", *points] if points else out


def _weakest_points(report: Report, rel: Reliability) -> list[str]:
    found = weakest_points(rel, MAX_WEAKEST_LISTED)
    if not found:
        return []
    points, number = point_redundancy(rel), report.solution.equations.unknowns["point"].number
    mean = points.mean
    rows = []
    for p, row in zip(found, report.rows.at([p.row for p in found]), strict=True):
        i = number[p.name]
        rows.append(
            [
                p.name,
                str(points.rows[i]),
                f"{mean[i]:.2f}",
                str(points.uncontrolled[i] or "–"),
                _length(p.effect, report),
                f"{row.kind_name} {row.what}",
            ]
        )
    header = ["point", "scalars", "mean r", "uncontrolled"]
    header += [f"effect [{report.units.sigma_length}]", "of ∇ in"]
    heading = title("Weakest points (largest effect of an error that just escapes detection)")
    return [*heading, *table(header, rows)]


def identity_cells(row: Row) -> list[str]:
    """Return the cells under `IDENTITY_HEADER`."""
    return [row.kind_name, row.what, row.own_id, row.source]


def _length(metres: float, report: Report) -> str:
    return short(metres / report.small) if isfinite(metres) else ""


# -- suspects -------------------------------------------------------------------------------------


def suspects_section(report: Report) -> list[str]:
    """Return the largest test values with estimated errors and inseparable observations."""
    rel = report.reliability
    if rel is None:
        return largest_residuals_section(report)
    if report.solution.redundancy <= 0 or not rel.controlled.any():
        return []
    values, critical = report.tests
    size = np.where(np.isfinite(values), np.abs(values), 0.0)
    above = _above(report)
    if not above and lists_every_observation(report):
        row = report.rows.at([int(np.argmax(size))])[0]
        test = decimal(row.sign * float(values[row.number]), 2)
        words = f"all stand above; the largest is {test}, of {row.kind_name} {row.what}"
        out = [*title(_none_above(report)), *paragraph(words)]
        return [*out, *_caution(report, above), *_groups(report, rel)]
    scale = report.solution.sigma0 if report.pope else 1.0
    name = "τ" if report.pope else "w"
    notes: list[str] = []
    most = min(report.options.n_suspects, int(rel.controlled.sum()))
    if above:
        most = min(most, above)
        found = rel.suspects(most, critical=critical * scale)
        rows = report.rows.at([s.row for s in found])
        notes = [_inseparable(report, r, s.inseparable) for r, s in zip(rows, found, strict=True)]
    else:
        order = np.argsort(-size, kind="stable")[:most]
        rows = report.rows.at(order.tolist())
    cells = []
    for row in rows:
        i, unit = row.number, row.scale.size
        cells.append(
            [
                *identity_cells(row),
                f"{short(row.residual / unit)} {row.scale.small}".strip(),
                short(row.sigma / unit),
                redundancy_text(float(rel.redundancy_numbers[i])),
                decimal(row.sign * values[i], 2),
                short(row.sign * rel.estimated_errors[i] / unit),
                short(rel.mdb[i] / unit),
            ]
        )
    header = [*IDENTITY_HEADER, "v", "σ", "r", name, "error", "detectable"]
    header, cells = without_empty_columns(header, cells)
    limit = f"{critical:.2f}" if isfinite(critical) else "–"
    heading = f"Suspects: |{name}| above {limit} (α0 = {percent(rel.alpha)})"
    if not above:
        heading = _none_above(report)
    out = [*title(heading), *table(header, cells, left=len(header) - 6, notes=notes)]
    if above > most:
        out.append(f"  … {above - most} more above the critical value")
    out += paragraph(
        "v = computed − observed; error: estimated, observed − true, if it alone is wrong; "
        f"detectable: smallest one; all {len(report.solution.observations)} in "
        f"{report.where('observations.csv')}"
    )
    return [*out, *_caution(report, above), *_groups(report, rel)]


def _none_above(report: Report) -> str:
    """Return the heading of test values none of which is critical."""
    name, critical = "τ" if report.pope else "w", report.tests[1]
    limit = f"{critical:.2f}" if isfinite(critical) else "–"
    return f"Largest test values: none above the critical |{name}| = {limit}"


def _above(report: Report) -> int:
    """Return the number of test values above the critical value; NaN does not count."""
    values, critical = report.tests
    return int(np.sum(np.abs(values) > critical))


def _inseparable(report: Report, row: Row, partners: tuple[tuple[int, float], ...]) -> str:
    """Return a sentence about the observations that are inseparable from an observation."""
    if not partners:
        return ""
    rows = report.rows.at([row for row, _ in partners[:MAX_INSEPARABLE_LISTED]])
    named = [
        unbroken(f"{r.kind_name} {r.what} ({row.sign * r.sign * rho:+.2f})")
        for r, (_, rho) in zip(rows, partners, strict=False)
    ]
    more = (
        f" and {len(partners) - MAX_INSEPARABLE_LISTED} more"
        if len(partners) > MAX_INSEPARABLE_LISTED
        else ""
    )
    return f"not distinguishable from: {', '.join(named)}{more}"


def _caution(report: Report, above: int) -> list[str]:
    """Return a caution about the tests that follows from σ̂0."""
    test = global_test(report.solution)
    if test.accepted or report.pope:
        return []
    if test.too_good:
        return paragraph(
            f"σ̂0 = {test.sigma0:.3g}: w refers to the stated σ, which are too large, so that "
            "errors may pass; τ (--test pope) refers to σ̂0"
        )
    if not above:
        return []
    return paragraph(
        f"σ̂0 = {significant(test.sigma0, 4)}: one gross error makes other test values large "
        "too, only the first is to be trusted (--snoop goes on from there); if all σ are stated "
        "too small, all are large (--test pope, --variance-components)"
    )


def _groups(report: Report, rel: Reliability) -> list[str]:
    """Return correlated observations that fail their test as a group."""
    equations = report.solution.equations
    correlated = equations.clusters or any(b.whitener is not None for b in equations.blocks)
    if report.pope or not correlated:
        return []
    failed = [g for g in rel.groups if g.dof and g.test > g.critical]
    if not failed:
        n = len(rel.groups)
        return [f"  {n} correlated groups tested as such: T of none above its critical value"]
    failed.sort(key=lambda g: -g.test / g.critical)
    shown = [
        [
            _members(report, g),
            str(g.dof),
            decimal(g.redundancy, 2),
            f"{g.test:.2f}",
            f"{g.critical:.2f}",
        ]
        for g in failed[: report.options.n_suspects]
    ]
    out = ["", *title("Correlated groups whose test T is above its critical value (χ²)")]
    out += table(["observations", "d", "Σr", "T", "critical"], shown)
    if len(failed) > len(shown):
        out.append(f"  … {len(failed) - len(shown)} more")
    return out


def _members(report: Report, group: GroupReliability) -> str:
    """Return the names of the observations of a group."""
    if len(group.ids) > 1:
        return f"cluster of {listed(group.ids, 4)}"
    row = report.rows.at([int(group.rows[0])])[0]
    return f"{row.kind_name} {' '.join(row.names) or row.id}"


def largest_residuals_section(report: Report) -> list[str]:
    """Return the largest normalised residuals, for solutions without test values."""
    size = np.abs(report.solution.observations.normalised)
    order = np.argsort(-size, kind="stable")[: report.options.n_suspects].tolist()
    rows = [
        [
            *identity_cells(r),
            f"{short(r.residual / r.scale.size)} {r.scale.small}".strip(),
            short(r.sigma / r.scale.size),
            decimal(r.residual / r.sigma, 2),
        ]
        for r in report.rows.at(order)
    ]
    if not rows:
        return []
    header, rows = without_empty_columns([*IDENTITY_HEADER, "v", "σ", "v/σ"], rows)
    return [
        *title("Largest normalised residuals (v = computed − observed)"),
        *table(header, rows, left=len(header) - 3),
        f"  all {len(report.solution.observations)} in {report.where('observations.csv')}",
    ]
