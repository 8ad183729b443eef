"""Summary of an adjustment, whole or in parts: one screen of text, or one line with the verdict.

The verdict has the words of the text report and of the HTML page. Lists get the rows that the
verdict leaves; what is cut off is in the text report.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..control_characters import escaped
from ..errors import known
from ..parts.solution import PartsSolution
from ..quality.rejections import Rejected, RejectedPoint, Snooping
from ..quality.reliability import Reliability
from ..solve.solution import Solution
from ..statistical_tests import AdjustmentFigures, global_test
from ..units import decimal
from .adjusted_observations import ObservationColumns, redundancy_text, test_symbol
from .adjustment_report import Report
from .catalogue import Texts
from .doubtful_results import (
    doubts_of_solution,
    exceeded_by_chance,
    notes_of_solution,
    unknowns_left_out,
)
from .html.verdict import LightColour, adjustment_verdict, verdict_words
from .layout import LINE_WIDTH, clipped, paragraph, percent, short, table
from .observation_rows import Row
from .options import Provenance
from .tables import Column, text_cells
from .text import NO_REDUNDANCY, doubt_lines, global_test_text, note_lines

MAX_LINES = 24
"""Lines of a screen: those of a terminal that nobody has enlarged."""
MAX_VERDICT_LINES = 5
"""Largest number of lines of the verdict; more would leave no row for the readings."""
MAX_ROWS = 5
"""Largest number of readings, and of points, that are listed."""
MAX_LABEL = 60
"""Largest width of the name of a reading, which leaves room for its figures."""
MAX_REJECTED = 5
"""Largest number of rejected observations that are named."""
REJECTED = "  rejected     "
"""Beginning of the line of the first rejected observation."""
WORDS = Texts("en")
"""Words of the verdict."""
REST = (
    "all of it: --full, in Python fga.text_report(solution); tables: --out DIR; "
    "page: --report FILE.html"
)
"""Where the rest of the result is."""
REST_OF_PARTS = "all of it: --full; tables: --out DIR"
"""Where the rest of the result of an adjustment in parts is."""
ScreenList = tuple[list[str], list[str], list[list[str]]]
"""Lines above a list, its header and its rows; without rows the lines are alone."""
R_LEGEND = "r: redundancy number, the share of an error that its residual shows"
MDB_LEGEND = "∇: smallest error that the test detects"
ERROR_LEGEND = (
    "error: estimated error of the reading (observed − true; w: adjusted − observed), by the test"
)
GOOD_LIGHT: LightColour = "green"


def summary(solution: Solution) -> str:
    """Return the result of an adjustment on one screen of 24 lines × 100 columns.

    It has the verdict, σ̂0 with the global test, counts, the readings with the largest test values,
    the points with the largest standard deviations, and where the rest is. The last line does not
    end, as `print` ends it.
    """
    return render_summary(Report(solution)).rstrip("\n")


def snooping_summary(found: Snooping) -> str:
    """Return the result of data snooping on one screen, see `summary`."""
    report = Report(found.solution, provenance=Provenance().with_snooping(found))
    return render_summary(report).rstrip("\n")


def render_summary(report: Report) -> str:
    """Return the screen of a report, see `summary`."""
    s, network = report.solution, report.network
    counts = f"{_count(len(network.points), 'point')}"
    if network.photos:
        counts += f", {_count(len(network.photos), 'photo')}"
    head = [
        *_verdict(report),
        *_sigma0(s, fitted=report.components is not None),
        _counts(s, counts),
    ]
    lists = [_readings(report), _points(report)]
    left = MAX_LINES - _fixed_lines(head, lists) - sum(min(len(rows), 2) for *_, rows in lists)
    return _screen(network.name, [*head, *_rejected(report, max(left, 1))], lists, REST)


def verdict_line(report: Report) -> str:
    """Return the verdict and σ̂0 in one line."""
    return _line(adjustment_verdict(report, WORDS).text, report.solution)


def doubts_of_parts(solution: PartsSolution) -> list[str]:
    """Return why the result of an adjustment in parts may be wrong."""
    found = doubts_of_solution(solution)
    if n := len(solution.repeated):
        found.append(f"{n} observations agree with one of another part: is it the same one?")
    return found


def parts_summary(solution: PartsSolution) -> str:
    """Return the result of an adjustment in parts on one screen, without points."""
    doubts = doubts_of_parts(solution)
    notes = [*unknowns_left_out(solution), *notes_of_solution(solution)]
    verdict = f"DOUBTFUL RESULT: {'; '.join(doubts)}" if doubts else _words_of_parts(solution)
    head = [
        *_within([*paragraph(verdict), *(line for note in notes for line in paragraph(note))]),
        *_sigma0(solution),
        _counts(solution, _count(len(solution.jobs), "part")),
    ]
    rows = [
        [_shortened(f"{part}: {t.label}"), decimal(t.w, 2), redundancy_text(t.redundancy)]
        for part, t in solution.largest_tests[:MAX_ROWS]
    ]
    name = solution.name or known((job.part.name for job in solution.jobs), most=4)
    readings = ["", "Worst readings", *paragraph(f"{_w('w')}; {R_LEGEND}")]
    return _screen(name, head, [(readings, ["reading", "w", "r"], rows)], REST_OF_PARTS)


def parts_verdict_line(solution: PartsSolution) -> str:
    """Return the verdict on an adjustment in parts and σ̂0 in one line."""
    return _line(_words_of_parts(solution), solution)


# -- parts of the screen --------------------------------------------------------------------------


def _w(symbol: str) -> str:
    scale = "" if symbol == "w" else ", with σ̂0"
    return f"{symbol}: test value, the residual divided by its σ{scale}"


def _screen(name: str, head: Sequence[str], lists: Sequence[ScreenList], rest: str) -> str:
    """Return the lines of a screen; lists share what the other lines leave."""
    left = MAX_LINES - _fixed_lines(head, lists)
    out = [f"Adjustment of {name or 'a network without a name'}", *head]
    for i, (above, header, rows) in enumerate(lists):
        later = [len(r) for _, _, r in lists[i + 1 :]]
        half = -(-left // (len(later) + 1))
        n = min(len(rows), max(half, left - sum(later), 1))
        left -= n
        out += above
        if rows:
            heading, _, *shown = table(header, rows[:n])
            out += [heading, *shown]
    out.append(rest)
    return "".join(f"{clipped(escaped(line.rstrip()))}\n" for line in out)


def _fixed_lines(head: Sequence[str], lists: Sequence[ScreenList]) -> int:
    """Return the number of lines of a screen without the rows of its lists."""
    return 2 + len(head) + sum(len(above) + bool(rows) for above, _, rows in lists)


def _verdict(report: Report) -> list[str]:
    """Return the verdict with its reasons, and what is striking."""
    found, notes = adjustment_verdict(report, WORDS), note_lines(report)
    doubts = doubt_lines(report)
    if not doubts:
        said = " ".join(notes)
        reasons = [
            f"{light.title}: {f'{light.text} {light.sentence}'.strip().rstrip('.')}"
            for light in found.lights
            if light.colour == found.colour != GOOD_LIGHT
            and not light.noted
            and (not light.told or light.told not in said)
        ]
        doubts = paragraph(": ".join([found.text, *(["; ".join(reasons)] if reasons else [])]))
    return _within([line for line in (*doubts, *notes) if line])


def _within(lines: list[str]) -> list[str]:
    """Return the first lines of a verdict, the last of which says that it goes on."""
    if len(lines) <= MAX_VERDICT_LINES:
        return lines
    last = lines[MAX_VERDICT_LINES - 1][: LINE_WIDTH - 2]
    return [*lines[: MAX_VERDICT_LINES - 1], f"{last} …"]


def _sigma0(solution: AdjustmentFigures, *, fitted: bool = False) -> list[str]:
    test = global_test(solution)
    if test.redundancy <= 0:
        return [f"  σ̂0           {NO_REDUNDANCY}"]
    freedom = _count(test.redundancy, "degree") + " of freedom"
    reference = "fitted" if fitted else "a priori 1"
    return [
        f"  σ̂0           {test.sigma0:.5f}, the standard deviation of unit weight ({reference}); "
        f"{freedom}",
        f"  global test  {global_test_text(test, fitted=fitted)}",
    ]


def _line(verdict: str, solution: AdjustmentFigures) -> str:
    test = global_test(solution)
    if test.redundancy <= 0:
        return f"{verdict}; {NO_REDUNDANCY}\n"
    return f"{verdict}; σ̂0 {test.sigma0:.5f}, {_count(test.redundancy, 'degree')} of freedom\n"


def _counts(s: Solution | PartsSolution, network: str) -> str:
    ended = "converged" if s.converged else "NOT CONVERGED"
    figures = f"{_count(s.n_observations, 'observation')}, {_count(s.n_unknowns, 'unknown')}"
    defect = (
        f", datum defect {s.datum_defect}" if isinstance(s, Solution) and s.datum_defect else ""
    )
    return (
        f"  counts       {figures}{defect}; {network}; {_count(s.iterations, 'iteration')}, {ended}"
    )


def _rejected(report: Report, most: int) -> list[str]:
    """Return the observations that data snooping rejected, with their errors, in so many lines.

    The first line has their number; a point rejected with all its rays is one line. Where lines
    are few, the last one has the names of the rest, as many as it holds.
    """
    found = report.snooping
    if found is None or not (n := len(found.rejected_ids)):
        return []
    count = _count(n, "observation")
    shown, total = min(MAX_REJECTED, most), len(found.rejected) + len(found.rejected_points)
    if total > shown > 1:
        shown -= 1  # the last line has the names of the rest
    lines = [_rejected_reading(report, r) for r in found.rejected[:shown]]
    lines += [(_rejected_rays(p), "") for p in found.rejected_points[: max(shown - len(lines), 0)]]
    if total > len(lines) and len(lines) < min(MAX_REJECTED, most):
        names = [_rejected_name(report, r) for r in found.rejected[len(lines) :]]
        left = len(lines) - len(found.rejected)
        names += [_rejected_rays(p) for p in found.rejected_points[max(left, 0) :]]
        lines.append((f"and {len(names)} more: {'; '.join(names)}", ""))
    elif rest := total - len(lines):
        count += f", {rest} of them not listed" if found.rejected else ""
    starts = [f"{REJECTED}{count}: ", *[" " * len(REJECTED)] * (len(lines) - 1)]
    return [
        start + clipped(escaped(name), LINE_WIDTH - len(start) - len(error)) + error
        for start, (name, error) in zip(starts, lines, strict=True)
    ]


def _rejected_rays(found: RejectedPoint) -> str:
    return f"{_count(len(found.rays), 'ray')} of point {found.name}"


def _rejected_name(report: Report, found: Rejected) -> str:
    aside = report.set_aside
    return found.label if aside is None else _label(aside.find(found.id, found.component))


def _rejected_reading(report: Report, found: Rejected) -> tuple[str, str]:
    """Return the name of a rejected observation with its source, and its error with σ."""
    aside = report.set_aside
    if aside is None:
        return found.label, ""
    row = aside.find(found.id, found.component)
    source = f", {row.source}" if row.source else ""
    fine, error = row.scale.fine, found.estimated_error
    by = ""
    if np.isfinite(found.final_error):
        error = found.final_error
        by = f" ± {fine.shown(found.final_sigma, None)}"
    size = fine.shown(row.sign * error, None)
    return f"{_label(row)}{source}", f", error {size}{by} {fine.name}".rstrip()


def _readings(report: Report) -> ScreenList:
    """Return the readings with the largest test values."""
    rel = report.reliability
    if rel is None:
        return ["", *paragraph(report.no_reliability)[:2]], [], []
    values, critical = report.tests
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    order = [i for i in np.argsort(-size, kind="stable")[:MAX_ROWS].tolist() if size[i] >= 0]
    if report.solution.redundancy <= 0 or not order:
        return [], [], []
    shown, columns = report.rows.at(order), _reading_columns(report, rel)
    symbol, above = test_symbol(report), int(np.sum(size > critical))
    legend = (
        f"{_w(symbol)} (*: above the critical |{symbol}| {critical:.2f}); {R_LEGEND}; {MDB_LEGEND}"
    )
    lines = [
        "",
        "Worst readings",
        *paragraph("; ".join([legend, *[ERROR_LEGEND] * (above > 0)])),
    ]
    lines += _caution(report, above)
    cells = zip(*(text_cells(c, shown) for c in columns), strict=True)
    header = [c.heading(WORDS) + ("  " if c.title == symbol else "") for c in columns]
    return lines, header, list(map(list, cells))


def _reading_columns(report: Report, rel: Reliability) -> list[Column[Row]]:
    """Return the columns of the worst readings; errors have a size where one is critical."""
    values, critical = report.tests
    of = ObservationColumns(report, ())
    starred, test = of.test().shown, replace(of.test(), shown=None)
    assert starred is not None
    columns = [
        Column[Row](title="reading", value=lambda row: _shortened(_label(row))),
        replace(test, shown=lambda row: starred(row) or f"{test.read(row)}  "),
        of.redundancy_number(rel),
        of.detectable(rel, with_unit=True),
    ]
    if np.any(np.abs(values) > critical):
        columns.append(of.error(rel, with_unit=True))
    return columns


def _caution(report: Report, above: int) -> list[str]:
    """Return what readings above the critical value mean: chance, or errors one by one."""
    if not above:
        return []
    values, critical = report.tests
    alpha, tested = report.options.alpha, int(np.isfinite(values).sum())
    chance = exceeded_by_chance(values, critical, alpha, report.redundancy_of_tau)
    if chance:
        n = alpha * tested
        about = f"{n:.0f}" if n >= 1 else f"{n:.1g}"
        return paragraph(
            f"*: of {tested} good readings, chance puts about {about} above the critical value at "
            f"this level (α0 = {percent(alpha)})"
        )
    more = "" if report.snooping is not None else "; --snoop goes on from there"
    which = (
        "the reading marked * may be wrong"
        if above == 1
        else (
            f"of {above} marked *, only the test of the first is reliable: the others may be "
            "large because of it"
        )
    )
    return paragraph(f"{which}{more}")


def _label(row: Row) -> str:
    """Return the name of a reading, with its id where that is another."""
    number = f" (id {row.own_id})" if row.own_id else ""
    return f"{row.kind_name} {row.what}{number}"


def _points(report: Report) -> ScreenList:
    """Return the points with the largest standard deviations."""
    if report.singular:
        return [], [], []
    sigma = dict(zip(report.network.points, report.sigmas.tolist(), strict=True))
    free = [name for name, s in sigma.items() if any(s)]
    worst = sorted(free, key=lambda name: -float(np.linalg.norm(sigma[name])))[:MAX_ROWS]
    unit = report.units.sigma_length
    rows = [
        [_shortened(name), *(short(s / report.small) if s else "held" for s in sigma[name])]
        for name in worst
    ]
    if not rows:
        return _poses(report)
    how = report.solution.variance.replace("-", " ")
    above = ["", f"Weakest points (σ: standard deviation of a coordinate, {how})"]
    return above, ["point", *(f"σ{axis} [{unit}]" for axis in "xyz")], rows


def _poses(report: Report) -> ScreenList:
    """Return the photos with the largest standard deviations, of a network without points."""
    poses = {name: p for name, p in report.poses.items() if report.free("pose", name)}
    worst = sorted(poses, key=lambda name: -float(np.linalg.norm(poses[name].sigma_position)))
    small, angle = report.units.sigma_length, report.units.sigma_angle
    rows = []
    for name in worst[:MAX_ROWS]:
        place = [short(s / report.small) if s else "held" for s in poses[name].sigma_position]
        turn = max(poses[name].sigma_rotations)
        rows.append([_shortened(name), *place, short(turn / report.radian) if turn else "held"])
    if not rows:
        return [], [], []
    how = report.solution.variance.replace("-", " ")
    above = [
        "",
        f"Weakest poses (σ: standard deviations of the place and of the weakest rotation, {how})",
    ]
    head = ["photo", *(f"σ{axis}0 [{small}]" for axis in "XYZ"), f"σ rotation [{angle}]"]
    return above, head, rows


def _colour_of_parts(solution: PartsSolution) -> LightColour:
    if doubts_of_parts(solution):
        return "red"
    notes = [*unknowns_left_out(solution), *notes_of_solution(solution)]
    return "amber" if notes or solution.redundancy <= 0 else GOOD_LIGHT


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}{'s' * (n != 1)}"


def _shortened(name: str) -> str:
    return clipped(escaped(name), MAX_LABEL)


def _words_of_parts(solution: PartsSolution) -> str:
    too_good = global_test(solution).too_good and not unknowns_left_out(solution)
    return verdict_words(_colour_of_parts(solution), WORDS, too_good=too_good)
