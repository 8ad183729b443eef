"""The page of the report of two epochs: verdict, plan of the displacements, tables, and origin."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...types import Array
from ..epochs.context import STATES, EpochsReport
from ..epochs.text import render_congruence
from ..layout import listed, percent, short
from ..plots.displaced import EpochsDrawing
from ..plots.sights import lines_by_kinds
from ..plots.style import multiple
from . import epochs_tables, inputs
from .epochs_verdict import epochs_verdict, size
from .language import Language, Texts
from .libraries import packed
from .plan import flat, rounded, words
from .rendering import Section, capital, rendered

SYMBOLS = ("displacement", "sigma_d", "t_epochs", "p", "detectable", "ellipse_d")
"""Symbols that the page explains."""
MARKS = (
    {"symbol": "triangle-up", "size": 11, "color": "held"},
    {"symbol": "triangle-up-open", "size": 12, "color": "doubt"},
    {"symbol": "circle", "size": 8, "color": "doubt"},
    {"symbol": "circle", "size": 6, "color": "point"},
)
"""Markers of the states, in the order of `STATES`; colours are names of the style sheet."""
NAMED = 8
"""Largest number of names in a sentence."""


def epochs_html(
    report: EpochsReport, *, language: Language = "en", files: Sequence[str | Path] = ()
) -> str:
    """Return the page of a comparison of two epochs.

    Raises:
        InputError: as `write_report`.
    """
    t = Texts(language)
    return rendered("two_epochs.html.j2", t, lambda: contents(report, t, files))


def contents(report: EpochsReport, t: Texts, files: Sequence[str | Path]) -> dict[str, Any]:
    """Return what the template fills in."""
    plan = EpochsDrawing(report)
    makers = {
        "displacements": (epochs_tables.displacements,),
        "reference": (epochs_tables.steps,),
        "blocks": (epochs_tables.blocks, epochs_tables.motions, epochs_tables.strains),
        "variances": (epochs_tables.adjustments, epochs_tables.ratio),
    }
    sections = {
        ident: Section(
            ident,
            t(f"section.{ident}"),
            [made for make in own if (made := make(report, t)) is not None],
        )
        for ident, own in makers.items()
    }
    listed_files = inputs.files(files, t)
    every = [s for section in sections.values() for s in section.sheets]
    anchors = {f"table-{s.id}" for s in every} | {"inputs"}
    every += [listed_files] if listed_files else []
    data: dict[str, Any] = {f"sheet-{s.id}": packed(s.data) for s in every}
    data["plan"] = packed(plan_data(plan, t))
    names = [s.network.name or t("unnamed") for s in report.found.solutions]
    return {
        "title": t("epochs.title", names=t("epochs.arrow").join(names)),
        "date": report.provenance.run.date,
        "verdict": epochs_verdict(report, t),
        "has_plan": True,
        "symbols": SYMBOLS,
        "plan_click": t("epochs.plan.click"),
        "plan_text": _plan_text(plan, t),
        "plan_note": capital(words(plan.plane.note, t)),
        "sections": sections,
        "anchors": anchors,
        "run": _run(report, t),
        "files": listed_files,
        "protocol": render_congruence(report.found, blocks=report.blocks),
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
        "axes": ["", ""] if plan.schematic else [words(n, t) for n in names[:2]],
        "schematic": plan.schematic,
        "limits": [limits[0].tolist(), limits[1].tolist()],
        "factor": factor,
        "multiple": multiple(factor),
        "doubtful": bool(report.doubts),
        "level": "σ" if report.confidence is None else percent(report.confidence),
        "test": "T",
        "sheet": "displacements",
        "marks": MARKS,
        "points": {
            "names": report.names,
            "xy": flat(at),
            "state": [STATES.index(s) for s in report.states],
            "ellipses": [rounded(v) for v in ((a, b, turn) if plan.flat else (0 * a, 0 * a, turn))],
            "height": [0.0] * len(at) if plan.flat else rounded(a),
            "vectors": [rounded(v) for v in drawn.T],
            "moved": moved,
            "told": _told(report, t),
        },
        "states": [t(f"state.{key}") for key in STATES],
        "lines": [] if plan.schematic else _lines(plan, t),
        "photos": {"names": [], "xy": [[], []], "shapes": []},
        "shapes": [] if plan.schematic else _shapes(plan, t),
        "instruments": {"names": [], "xy": flat(_others(plan))},
        "relative": {"names": [], "xy": [[], []], "ellipses": [[], [], []]},
        "doubts": [],
        "aside": [],
    }


def _told(report: EpochsReport, t: Texts) -> list[list[str]]:
    """Return lines that a point of the plan shows when it is pointed at."""
    return [
        [
            f"{t('col.length')} {size(report, x.length)}",
            f"T {short(x.test.value)} {'≤' if x.test.accepted else '>'} {x.test.critical:.2f}",
            f"{t('col.detectable')} {size(report, x.detectable)}",
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
        out.append({"name": t("epochs.block"), "lines": [flat(at)]})
        line = flat(at + plan.factor * moved)
        out.append({"name": t("epochs.block_moved"), "lines": [line], "dash": "dash"})
    return out


def _plan_text(plan: EpochsDrawing, t: Texts) -> list[str]:
    report = plan.report
    out = [t.number("epochs.plan", len(plan.at))]
    level = "σ" if report.confidence is None else percent(report.confidence)
    out.append(t("epochs.plan.regions" if plan.flat else "epochs.plan.heights", level=level))
    lost = [report.names[i] for i in np.flatnonzero(~plan.fits).tolist()]
    if lost:
        out.append(t("plan.too_large", names=listed(lost, NAMED)))
    return out


def _run(report: EpochsReport, t: Texts) -> list[tuple[str, str]]:
    found = report.found
    tests = t("run.epochs_tests", alpha=percent(found.alpha), power=percent(found.power))
    return inputs.run_of(report.provenance.run, [("run.tests", tests)], t)
