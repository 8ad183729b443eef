"""HTML page of a comparison of two epochs: tables of tests, displacements, block motions; plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...epochs.block_motion import BlockMotion
from ...epochs.comparison_result import Displacement
from ...epochs.congruence_tests import HypothesisTest
from ...statistical_tests import global_test
from ...types import Array
from ..catalogue import Language, Texts
from ..epochs_report import (
    EPOCH_POINT_STATES,
    PARAMETER_UNITS,
    EpochsReport,
    displacements_table,
    render_congruence,
)
from ..layout import listed, percent, short
from ..plots.displacements import EpochsDrawing
from ..plots.observation_lines import lines_by_kinds
from ..plots.style import factor_text
from ..tables import NO_FIGURE, Column, Sheet, as_html
from . import rendering
from .plan import axis_words, rounded_or_none, rounded_xy
from .rendering import (
    ColumnHead,
    PageSection,
    capitalised,
    columns_from_rows,
    filled_sheet,
    packed_json,
    rendered_page,
)
from .verdict import epochs_verdict, sigma_length_text

MAX_NAMES_IN_CELL = 30
"""Largest number of names in a cell."""
MAX_NAMES_IN_EPOCHS_PLAN_TEXT = 8
"""Largest number of names in a sentence."""
SYMBOLS_OF_EPOCHS_PAGE = ("displacement", "sigma_d", "t_epochs", "p", "detectable", "ellipse_d")
"""Symbols that the page explains."""
EPOCH_POINT_MARKERS = (
    {"symbol": "triangle-up", "size": 11, "color": "held"},
    {"symbol": "triangle-up-open", "size": 12, "color": "doubt"},
    {"symbol": "circle", "size": 8, "color": "doubt"},
    {"symbol": "circle", "size": 6, "color": "point"},
)
"""Markers of the states, in the order of `EPOCH_POINT_STATES`; colours are names of the style
sheet."""


def adjustments_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the adjustments that were compared."""
    rows = []
    for s in report.found.solutions:
        test = global_test(s)
        known = test.redundancy > 0
        rows.append(
            [
                s.network.name or t("unnamed"),
                str(s.n_observations),
                str(s.n_unknowns),
                str(s.datum_defect),
                str(s.redundancy),
                f"{test.sigma0:.4f}" if known else NO_FIGURE,
                f"{test.lower:.4f} – {test.upper:.4f}" if known else NO_FIGURE,
                f"{s.vtpv:.6g}",
            ]
        )
    heads: list[ColumnHead] = [
        (t("col_epoch"), False),
        (t("figure_n"), True),
        (t("figure_u"), True),
        (t("figure_d"), True),
        (t("figure_r"), True),
        ("σ̂0", True),
        ("σ̂0 (χ²)", True),
        ("vᵀPv", True),
    ]
    return filled_sheet("adjustments", t("adjustments_caption"), columns_from_rows(heads, rows))


def variance_ratio_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the test of the ratio of the variances."""
    found = report.found.ratio
    if found is None:
        return None
    row = [f"{found.ratio:.3f}", f"{found.critical:.3f}", t("yes" if found.accepted else "no")]
    heads: list[ColumnHead] = [
        (t("col_larger"), True),
        (t("col_critical"), True),
        (t("col_fits"), False),
    ]
    return filled_sheet("ratio", t("ratio_caption"), columns_from_rows(heads, [row]))


def congruence_tests_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the congruence tests of the reference points, step by step."""
    found, left = report.found, 0
    rows = []
    for i, step in enumerate(found.steps):
        left += len(step.left) - len(step.back)
        rows.append(
            [
                str(i),
                listed(step.left, MAX_NAMES_IN_CELL) or NO_FIGURE,
                listed(step.back, MAX_NAMES_IN_CELL) or NO_FIGURE,
                str(len(found.reference) - left),
                *_test(step.test),
                t("yes" if step.test.accepted else "no") if step.test.freedom[0] else NO_FIGURE,
            ]
        )
    heads: list[ColumnHead] = [
        (t("col_step"), True),
        (t("col_left"), False),
        (t("col_back"), False),
        (t("col_tested"), True),
        *_test_heads("T", t),
        (t("col_fits"), False),
    ]
    notes = [t("steps_note")]
    return filled_sheet("steps", t("steps_caption"), columns_from_rows(heads, rows), notes=notes)


def displacements_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the displacements with their tests and ellipses."""
    made = displacements_table(report)
    words = {n: t(f"state_{s}") for n, s in zip(report.names, report.states, strict=True)}
    state = Column[Displacement](title="state", value=lambda x: words[x.name])
    level = report.confidence
    note = (
        t("displacements_note_standard")
        if level is None
        else t("displacements_note", level=percent(level))
    )
    columns = [made.columns[0], state, *made.columns[1:]]
    return as_html(replace(made, columns=columns), t, notes=[note])


def block_tests_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the tests of the common motions."""
    rows = []
    for b in report.blocks:
        fit = [NO_FIGURE, NO_FIGURE, NO_FIGURE]
        if b.fit is not None:
            words = t("yes" if b.fit.accepted else "no")
            fit = [f"{b.fit.value:.2f}", f"{b.fit.critical:.2f}", words]
        rows.append(
            [
                listed(b.points, MAX_NAMES_IN_CELL),
                t(f"model_{b.model}"),
                f"{b.motion.value:.2f}",
                f"{b.motion.critical:.2f}",
                t("no" if b.motion.accepted else "yes"),
                *fit,
            ]
        )
    heads: list[ColumnHead] = [
        (t("col_points"), False),
        (t("col_model"), False),
        (t("col_motion"), True, t("help_t_epochs")),
        (t("col_critical"), True),
        (t("col_moved"), False),
        (t("col_fit"), True, t("help_t_epochs")),
        (t("col_critical"), True),
        (t("col_fits"), False),
    ]
    return filled_sheet("blocks", t("blocks_caption"), columns_from_rows(heads, rows))


def block_motions_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the parameters of the common motions."""
    rows = []
    for b in report.blocks:
        for name, value, sigma in zip(b.names, b.values.tolist(), b.sigmas.tolist(), strict=True):
            unit, factor = PARAMETER_UNITS[name[0]]
            figures = [short(factor * value), short(factor * sigma), unit]
            rows.append([_block(b, t), name, *figures])
    heads: list[ColumnHead] = [
        (t("col_block"), False),
        (t("col_parameter"), False),
        (t("col_value"), True),
        ("σ", True),
        (t("col_unit"), False),
    ]
    return filled_sheet("motions", t("motions_caption"), columns_from_rows(heads, rows))


def strains_sheet(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the principal strains of affine motions."""
    rows = []
    for b in report.blocks:
        if b.model == "affine":
            values, axes = b.principal_strains()
            for value, axis in zip(values.tolist(), axes.tolist(), strict=True):
                direction = " ".join(f"{v:.4f}" for v in axis)
                rows.append([_block(b, t), f"{1e6 * value:.2f}", direction])
    heads: list[ColumnHead] = [
        (t("col_block"), False),
        (f"{t('col_strain')} [ppm]", True),
        (t("col_axis"), False),
    ]
    return filled_sheet("strains", t("strains_caption"), columns_from_rows(heads, rows))


def _block(b: BlockMotion, t: Texts) -> str:
    return f"{listed(b.points, MAX_NAMES_IN_CELL)} ({t(f'model_{b.model}')})"


def _test(test: HypothesisTest) -> Sequence[str]:
    p = "< 0.0001" if test.p_value < 1e-4 else f"{test.p_value:.4f}"
    return f"{test.value:.2f}", f"{test.critical:.2f}", str(test.freedom[0]), p


def _test_heads(name: str, t: Texts) -> list[ColumnHead]:
    return [
        (name, True, t("help_t_epochs")),
        (t("col_critical"), True),
        (t("col_dof"), True),
        ("p", True, t("help_p")),
    ]


def epochs_html(
    report: EpochsReport, *, language: Language = "en", files: Sequence[str | Path] = ()
) -> str:
    """Return the page of a comparison of two epochs.

    Raises:
        InputError: as `write_report`.
    """
    t = Texts(language)
    return rendered_page("two_epochs.html.j2", t, lambda: contents(report, t, files))


def contents(report: EpochsReport, t: Texts, files: Sequence[str | Path]) -> dict[str, Any]:
    """Return what the template fills in."""
    plan = EpochsDrawing(report)
    makers = {
        "displacements": (displacements_sheet,),
        "reference": (congruence_tests_sheet,),
        "blocks": (block_tests_sheet, block_motions_sheet, strains_sheet),
        "variances": (adjustments_sheet, variance_ratio_sheet),
    }
    sections = {
        ident: PageSection(
            ident,
            t(f"section_{ident}"),
            [made for make in own if (made := make(report, t)) is not None],
        )
        for ident, own in makers.items()
    }
    listed_files = rendering.input_files_sheet(files, t)
    every = [s for section in sections.values() for s in section.sheets]
    anchors = {f"table-{s.id}" for s in every} | {"inputs"}
    every += [listed_files] if listed_files else []
    data: dict[str, Any] = {f"sheet-{s.id}": packed_json(s.data) for s in every}
    data["plan"] = packed_json(plan_data(plan, t))
    names = [s.network.name or t("unnamed") for s in report.found.solutions]
    return {
        "title": t("epochs_title", names=t("epochs_arrow").join(names)),
        "date": report.provenance.run.date,
        "verdict": epochs_verdict(report, t),
        "has_plan": True,
        "symbols": SYMBOLS_OF_EPOCHS_PAGE,
        "plan_click": t("epochs_plan_click"),
        "plan_text": _plan_text(plan, t),
        "plan_note": capitalised(axis_words(plan.plane.note, t)),
        "sections": sections,
        "anchors": anchors,
        "run": _run(report, t),
        "files": listed_files,
        "text_report": render_congruence(report.found, blocks=report.blocks),
        "data": data,
    }


def plan_data(plan: EpochsDrawing, t: Texts) -> dict[str, Any]:
    """Return what the script of the page draws; see `factorgraph_adj.report.html.plan`."""
    report, found = plan.report, plan.report.found
    at, factor, limits = plan.at, plan.factor, plan.limits
    if plan.schematic:
        # Heights without a plan stand side by side, at their displacements in true size.
        at = np.column_stack([np.arange(len(at)), np.zeros(len(at))]).astype(float)
        reach = 1.2 * float(np.max(np.abs(plan.rises) + plan.intervals, initial=1e-3))
        limits, factor = (np.array([-1.0, -reach]), np.array([float(len(at)), reach])), 1.0
    moved = [x.moved for x in found.displacements.values()]
    a, b, turn = np.where(plan.fits[:, None], plan.ellipses, 0.0).T
    drawn = np.where(plan.fits[:, None], plan.vectors, 0.0)
    names = plan.plane.names
    return {
        "axes": ["", ""] if plan.schematic else [axis_words(n, t) for n in names[:2]],
        "schematic": plan.schematic,
        "limits": [limits[0].tolist(), limits[1].tolist()],
        "factor": factor,
        "multiple": factor_text(factor),
        "doubtful": bool(report.doubts),
        "level": "σ" if report.confidence is None else percent(report.confidence),
        "test": "T",
        "sheet": "displacements",
        "marks": EPOCH_POINT_MARKERS,
        "points": {
            "names": report.names,
            "xy": rounded_xy(at),
            "state": [EPOCH_POINT_STATES.index(s) for s in report.states],
            "ellipses": [
                rounded_or_none(v) for v in ((a, b, turn) if plan.flat else (0 * a, 0 * a, turn))
            ],
            "height": [0.0] * len(at) if plan.flat else rounded_or_none(a),
            "vectors": [rounded_or_none(v) for v in drawn.T],
            "moved": moved,
            "told": _told(report, t),
        },
        "states": [t(f"state_{key}") for key in EPOCH_POINT_STATES],
        "lines": [] if plan.schematic else _lines(plan, t),
        "photos": {"names": [], "xy": [[], []], "shapes": []},
        "shapes": [] if plan.schematic else _shapes(plan, t),
        "instruments": {"names": [], "xy": rounded_xy(_others(plan))},
        "relative": {"names": [], "xy": [[], []], "ellipses": [[], [], []]},
        "doubts": [],
        "aside": [],
    }


def _told(report: EpochsReport, t: Texts) -> list[list[str]]:
    """Return lines that a point of the plan shows when it is pointed at."""
    return [
        [
            f"{t('col_length')} {sigma_length_text(report, x.length)}",
            f"T {short(x.test.value)} {'≤' if x.test.accepted else '>'} {x.test.critical:.2f}",
            f"{t('col_detectable')} {sigma_length_text(report, x.detectable)}",
        ]
        for x in report.found.displacements.values()
    ]


def _others(plan: EpochsDrawing) -> Array:
    """Return the places at which observed lines of the first epoch end, behind the points."""
    return plan.others if not plan.schematic else np.zeros((0, 2))


def _lines(plan: EpochsDrawing, t: Texts) -> list[dict[str, Any]]:
    """Return observed lines of the first epoch; their ends are counted behind the points."""
    return [
        {
            "kinds": ", ".join(t.kind(k.replace("_", " ")) for k in kinds),
            "ends": (ends + len(plan.at)).T.tolist(),
        }
        for kinds, ends in lines_by_kinds(plan.report.found.solutions[0])
    ]


def _shapes(plan: EpochsDrawing, t: Texts) -> list[dict[str, Any]]:
    """Return the outlines of blocks, and where their motion takes them."""
    out = []
    for at, moved in plan.outlines:
        out.append({"name": t("epochs_block"), "lines": [rounded_xy(at)]})
        line = rounded_xy(at + plan.factor * moved)
        out.append({"name": t("epochs_block_moved"), "lines": [line], "dash": "dash"})
    return out


def _plan_text(plan: EpochsDrawing, t: Texts) -> list[str]:
    report = plan.report
    out = [t.number("epochs_plan", len(plan.at))]
    level = "σ" if report.confidence is None else percent(report.confidence)
    out.append(t("epochs_plan_regions" if plan.flat else "epochs_plan_heights", level=level))
    lost = [report.names[i] for i in np.flatnonzero(~plan.fits).tolist()]
    if lost:
        out.append(t("plan_too_large", names=listed(lost, MAX_NAMES_IN_EPOCHS_PLAN_TEXT)))
    return out


def _run(report: EpochsReport, t: Texts) -> list[tuple[str, str]]:
    found = report.found
    tests = t("run_epochs_tests", alpha=percent(found.alpha), power=percent(found.power))
    return rendering.run_provenance(report.provenance.run, [("run_tests", tests)], t)
