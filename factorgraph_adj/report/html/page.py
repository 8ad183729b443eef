"""HTML page of an adjustment: all sections, data of statistical figures; writing of HTML files.

The data of the statistical figures are histograms of test values, their quantiles, redundancy
numbers, and mean photos.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from ...epochs.block_motion import BlockMotion
from ...epochs.comparison_result import Congruence
from ...errors import InputError, taking
from ...io.file_transaction import write_files
from ...solve.solution import Solution
from ...statistical_tests import CONFIDENCE_OF_REGION
from ..adjusted_observations import test_symbol
from ..adjustment_report import Report
from ..catalogue import Language, Texts
from ..epochs_report import EpochsReport
from ..layout import listed
from ..options import Provenance, ReportOptions
from ..plots.image_residuals import cells_along_longer_side, image_rows, mean_photo
from ..plots.style import factor_text, length_text, readable_number
from ..text import render_text
from . import estimates, observations, rendering
from .epochs_page import epochs_html
from .plan import PlanDrawing, scene_data
from .rendering import PageSection, capitalised, packed_json, rendered_page
from .verdict import adjustment_verdict

HISTOGRAM_BARS_ON_PAGE = 41
"""Number of bars of a histogram of test values."""
MAX_TEST_VALUE_WITH_BAR = 6.0
"""Largest |w| with a bar of its own; the outermost bars hold what lies beyond."""
MAX_QUANTILE_POINTS = 1000
"""Largest number of points of a quantile plot between its ends."""
EXTREME_VALUES_SHOWN = 200
"""Number of smallest and of largest values that are all shown."""
MIN_SHARE_OF_POINTS_ON_PAGE = 0.1
"""Smallest number of points in a cell with a vector, as a fraction of the average."""
MAX_NAMES_IN_PLAN_TEXT = 8
"""Largest number of names in a sentence."""
SYMBOLS_OF_PAGE = ("v", "sigma", "r", "test", "error", "mdb", "ellipse", "partners")
"""Symbols that the page explains."""


def test_statistics(report: Report, t: Texts) -> dict[str, Any] | None:
    """Return histogram, quantiles and redundancy numbers; None without reliability."""
    rel = report.reliability
    if rel is None or not rel.controlled.any():
        return None
    values, critical = report.tests
    tested = np.isfinite(values) & rel.controlled
    sign = report.rows.signs()
    found = {}
    groups = report.rows.groups()
    edges = np.linspace(
        -MAX_TEST_VALUE_WITH_BAR, MAX_TEST_VALUE_WITH_BAR, HISTOGRAM_BARS_ON_PAGE + 1
    )
    for g in groups:
        own = (sign * values)[g.rows][tested[g.rows]]
        if len(own):
            counts = np.histogram(
                np.clip(own, -MAX_TEST_VALUE_WITH_BAR, MAX_TEST_VALUE_WITH_BAR), edges
            )[0]
            found[t.kind(g.label)] = counts.tolist()
    everything = np.sort((sign * values)[tested])
    n = len(everything)
    middle = np.linspace(0, n - 1, MAX_QUANTILE_POINTS).round().astype(np.intp)
    ends = np.arange(min(n, EXTREME_VALUES_SHOWN))
    shown = np.unique(np.concatenate([ends, middle, n - 1 - ends]))
    return {
        "test": test_symbol(report),
        "critical": critical if np.isfinite(critical) else None,
        "n": n,
        "centres": ((edges[1:] + edges[:-1]) / 2).tolist(),
        "histogram": found,
        "normal": np.round(n * np.diff(ndtr(edges)), 3).tolist(),
        "quantiles": np.round(ndtri((shown + 0.5) / n), 4).tolist(),
        "sorted": np.round(everything[shown], 4).tolist(),
        "redundancy": {
            t.kind(g.label): np.histogram(
                np.clip(rel.redundancy_numbers[g.rows], 0.0, 1.0), np.linspace(0, 1, 21)
            )[0].tolist()
            for g in groups
        },
    }


def mean_photo_data(report: Report, t: Texts) -> list[dict[str, Any]]:
    """Return the mean residuals in the cells of the image of each camera with image points."""
    rows = image_rows(report.solution)
    out = []
    for name, corners in rows.areas.items():
        camera, own = report.network.cameras[name], rows.of_camera(name)
        mean = mean_photo(own, corners, cells_along_longer_side(own, corners))
        enough = mean.count >= MIN_SHARE_OF_POINTS_ON_PAGE * mean.count.mean()
        size = np.hypot(*mean.residual[enough].T)
        side = float(mean.x_edges[1] - mean.x_edges[0])
        typical = float(np.quantile(size, 0.9))
        factor = readable_number(0.8 * side / typical) if typical > 0 else 1.0
        down = -1.0 if camera.y_down_in_files else 1.0
        ends = mean.centre[enough] + factor * mean.residual[enough]
        y = mean.centre[enough, 1]
        significant = mean.significant[enough]
        key = f"{typical:.2g} {camera.unit}" if camera.unit != "m" else length_text(typical)
        out.append(
            {
                "camera": name,
                "unit": camera.unit,
                "down": bool(down < 0),
                "from": [mean.centre[enough, 0].tolist(), (down * y).tolist()],
                "to": [ends[:, 0].tolist(), (down * ends[:, 1]).tolist()],
                "count": mean.count[enough].tolist(),
                "significant": significant.tolist(),
                "multiple": factor_text(factor),
                "text": t(
                    "mean_photo_text",
                    camera=name,
                    n=len(own.row),
                    cells=int(enough.sum()),
                    red=int(significant.sum()),
                    factor=factor_text(factor),
                    typical=key,
                ),
            }
        )
    return out


def adjustment_html(
    report: Report, *, language: Language = "en", files: Sequence[str | Path] = ()
) -> str:
    """Return the page of a report.

    Raises:
        InputError: as `write_report`.
    """
    t = Texts(language)
    return rendered_page("page.html.j2", t, lambda: contents(report, t, files))


def contents(report: Report, t: Texts, files: Sequence[str | Path]) -> dict[str, Any]:
    """Return what the template fills in."""
    plan = PlanDrawing(report, t)
    view, drawn = scene_data(plan), plan.data()
    numbers = test_statistics(report, t)
    means = mean_photo_data(report, t)
    calibrations, n_calibrations = estimates.calibration_sheets(report, t)
    sections = {
        "groups": _section(
            "groups",
            t,
            observations.observation_groups_sheet,
            observations.variance_components_sheet,
            report=report,
        ),
        "worst": _section(
            "worst",
            t,
            observations.worst_observations_sheet,
            observations.causes_sheet,
            report=report,
        ),
        "aside": _section(
            "aside",
            t,
            observations.rejected_observations_sheet,
            observations.rejected_points_sheet,
            observations.left_out_sheet,
            observations.unresolved_observations_sheet,
            observations.given_values_sheet,
            report=report,
        ),
        "points": _section("points", t, estimates.points_sheet, report=report),
        "control": _section(
            "control",
            t,
            observations.control_sheet,
            estimates.check_points_sheet,
            estimates.lines_sheet,
            report=report,
        ),
        "photos": _section("photos", t, estimates.photos_sheet, report=report),
        "unknowns": _section(
            "unknowns",
            t,
            estimates.orientations_sheet,
            estimates.shapes_sheet,
            estimates.other_unknowns_sheet,
            report=report,
        ),
        "observations": _section("observations", t, observations.observations_sheet, report=report),
    }
    anchors = {ident for ident, section in sections.items() if section.sheets}
    anchors |= {f"table-{s.id}" for section in sections.values() for s in section.sheets}
    anchors |= {"inputs", *(("cameras",) if calibrations else ())}
    listed_files = rendering.input_files_sheet(files, t)
    every = [s for section in sections.values() for s in section.sheets]
    every += [c.sheet for c in calibrations]
    every += [listed_files] if listed_files else []
    data: dict[str, Any] = {f"sheet-{s.id}": packed_json(s.data) for s in every}
    data["plan"] = packed_json(drawn)
    if view is not None:
        data["scene"] = packed_json(view)
    if numbers is not None:
        data["statistics"] = packed_json(numbers)
    if means:
        data["mean-photos"] = packed_json(means)
    return {
        "title": t("title", name=report.subject or t("unnamed")),
        "date": report.provenance.run.date,
        "verdict": adjustment_verdict(report, t),
        "symbols": SYMBOLS_OF_PAGE,
        "plan_click": t("plan_click"),
        "plan_text": _plan_text(plan, t),
        "plan_note": capitalised(plan.words(plan.plane.note)),
        "has_plan": bool(len(plan.points) + len(plan.centres)),
        "has_r": report.reliability is not None,
        "scene_text": None if view is None else _scene_text(plan, view, t),
        "sections": sections,
        "anchors": anchors,
        "calibrations": calibrations,
        "more_calibrations": max(n_calibrations - len(calibrations), 0),
        "means": [{"camera": m["camera"], "text": m["text"]} for m in means],
        "statistics": numbers,
        "statistics_text": None if numbers is None else _statistics_text(report, numbers, t),
        "run": rendering.adjustment_provenance(report, t),
        "files": listed_files,
        "text_report": render_text(report),
        "data": data,
    }


def _section(ident: str, t: Texts, *makers: Any, report: Report) -> PageSection:
    """Return a part of the page with the tables that there are."""
    found = [made for make in makers if (made := make(report, t)) is not None]
    return PageSection(ident, t(f"section_{ident}"), found)


def _plan_text(plan: PlanDrawing, t: Texts) -> list[str]:
    """Return the plan in words, for those who do not see it, and what it leaves out."""
    report, points = plan.report, len(plan.points)
    out = [t.number("plan_text", points, photos=len(plan.centres))]
    p = plan.precision
    if p is None:
        iterative = report.solution.run.solver.iterative
        out.append(t("plan_iterative" if iterative else "plan_singular"))
    elif plan.without_plan:
        if p.height.any():
            worst = int(p.height.argmax())
            size = f"{float(p.height[worst]) / report.small:.3g} {report.units.sigma_length}"
            out.append(t("plan_heights", name=list(report.network.points)[worst], size=size))
    elif len(p.semi) and p.semi[:, 0].any():
        worst = int(p.semi[:, 0].argmax())
        size = f"{float(p.semi[worst, 0]) / report.small:.3g} {report.units.sigma_length}"
        out.append(t("plan_ellipses", name=list(report.network.points)[worst], size=size))
    else:
        out.append(t("plan_held"))
    lost = plan.too_large()
    if lost:
        out.append(t("plan_too_large", names=listed(lost, MAX_NAMES_IN_PLAN_TEXT)))
    if plan.schematic:
        out.append(t("plan_schematic"))
    return out


def _scene_text(plan: PlanDrawing, view: dict[str, Any], t: Texts) -> str:
    rays = view["rays"]
    text = t("scene_text", points=len(plan.points), photos=len(plan.centres))
    if rays["shown"] < rays["all"]:
        text += " " + t("scene_rays", shown=rays["shown"], all=rays["all"])
    return f"{text} {t('scene_flat')}" if view["flat"] else text


def _statistics_text(report: Report, numbers: dict[str, Any], t: Texts) -> dict[str, str]:
    rel = report.reliability
    assert rel is not None
    values, critical = report.tests
    size = [abs(v) for v in numbers["sorted"]]
    above = int((abs(values) > critical).sum())
    r = rel.redundancy_numbers
    return {
        "histogram": t("histogram_text", name=numbers["test"], n=numbers["n"], above=above),
        "quantiles": t("quantiles_text", name=numbers["test"], largest=f"{max(size):.2f}"),
        "redundancy": t(
            "redundancy_text",
            mean=f"{max(float(r.mean()), 0.0):.2f}",
            weak=int((r < 0.1).sum()),
            n=len(r),
        ),
    }


@taking(Solution | Congruence)
def write_report(
    solution: Solution | Congruence,
    path: str | Path,
    *,
    language: Language = "en",
    options: ReportOptions | None = None,
    provenance: Provenance | None = None,
    files: Sequence[str | Path] = (),
    blocks: Sequence[BlockMotion] = (),
) -> None:
    """Write the report of an adjustment, or of two epochs, as one HTML file.

    The extra ``report`` is required. The file opens in a browser by a double click and asks for
    nothing from the network. It has: the verdict with its reasons; the plan, with error ellipses
    and with the observations that are in doubt, and a view in three dimensions; groups of
    observations; the worst observations and those that were rejected; points, control and check
    points, photos, calibrations and other unknowns; all observations; the distribution of test
    values and of redundancy; input files, versions, options, and the text report. Tables sort,
    filter and export CSV.

    Of two epochs it has: the verdict; the plan of the displacements with their ellipses; the
    displacements with test values and smallest detectable ones; the congruence tests of the
    reference points; common motions and strains; the adjustments with the ratio of their variances.

    The same arguments give the same file: it has a date only if ``provenance`` has one.

    Args:
        solution: the result of `adjust`, or of `congruence`.
        path: the file, such as ``report.html``; one that is there is replaced.
        language: ``en`` or ``de``. Sentences of the adjustment itself, such as the reason why an
            iteration ended and the name of a likely cause, are English in both.
        options: units, probabilities, tests, ellipses and lines, as for `text_report`. Without a
            confidence, the plan shows ellipses of 95 % and the tables none. Of two epochs units and
            confidence count.
        provenance: data snooping or variance components that the solution comes from, and the run.
        files: input files and folders, which the report lists with their SHA-256.
        blocks: common motions of points of two epochs.

    Raises:
        InputError: the extra is not installed, the language is unknown, an input file cannot be
            read, blocks are given for one adjustment, or the file cannot be written; an earlier one
            has not changed then.
    """
    if isinstance(solution, Congruence):
        stated = options or ReportOptions()
        level = CONFIDENCE_OF_REGION if stated.confidence is None else stated.confidence
        run = provenance or Provenance()
        epochs = EpochsReport(solution, tuple(blocks), run, level, stated.units)
        write_html(epochs, path, language=language, files=files)
        return
    if blocks:
        raise InputError("blocks belong to the report of two epochs, of a result of congruence")
    report = Report(solution, options or ReportOptions(), provenance or Provenance())
    write_html(report, path, language=language, files=files)


def write_html(
    report: Report | EpochsReport,
    path: str | Path,
    *,
    language: Language = "en",
    files: Sequence[str | Path] = (),
) -> None:
    """Write a report as an HTML file, see `write_report`."""
    target = Path(path)
    if isinstance(report, EpochsReport):
        text = epochs_html(report, language=language, files=files)
    else:
        text = adjustment_html(report, language=language, files=files)
    write_files(target.parent, {target.name: text})
