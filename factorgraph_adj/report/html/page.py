"""The page of the HTML report: its parts in the order in which a reader needs them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..context import Report
from ..layout import listed
from ..text import render
from . import inputs, observations, places, snooping, statistics, unknowns
from .language import Language, Texts
from .libraries import packed
from .plan import Plan
from .rendering import Section, capital, rendered
from .scene import scene
from .verdict import verdict

SYMBOLS = ("v", "sigma", "r", "test", "error", "mdb", "ellipse", "partners")
"""Symbols that the page explains."""
NAMED = 8
"""Largest number of names in a sentence."""


def html(report: Report, *, language: Language = "en", files: Sequence[str | Path] = ()) -> str:
    """Return the page of a report.

    Raises:
        InputError: as `write_report`.
    """
    t = Texts(language)
    return rendered("page.html.j2", t, lambda: contents(report, t, files))


def contents(report: Report, t: Texts, files: Sequence[str | Path]) -> dict[str, Any]:
    """Return what the template fills in."""
    plan = Plan(report, t)
    view, drawn = scene(plan), plan.data()
    numbers = statistics.statistics(report, t)
    means = statistics.mean_photos(report, t)
    calibrations, n_calibrations = unknowns.calibrations(report, t)
    sections = {
        "groups": _section(
            "groups", t, observations.groups, observations.components, report=report
        ),
        "worst": _section("worst", t, observations.worst, snooping.causes, report=report),
        "aside": _section(
            "aside",
            t,
            snooping.rejected,
            snooping.points_aside,
            snooping.unresolved,
            snooping.given,
            report=report,
        ),
        "points": _section("points", t, places.points, report=report),
        "control": _section(
            "control", t, observations.control, places.check_points, places.lines, report=report
        ),
        "photos": _section("photos", t, places.photos, report=report),
        "unknowns": _section(
            "unknowns", t, unknowns.orientations, unknowns.shapes, unknowns.others, report=report
        ),
        "observations": _section("observations", t, observations.observations, report=report),
    }
    anchors = {ident for ident, section in sections.items() if section.sheets}
    anchors |= {f"table-{s.id}" for section in sections.values() for s in section.sheets}
    anchors |= {"inputs", *(("cameras",) if calibrations else ())}
    listed_files = inputs.files(files, t)
    every = [s for section in sections.values() for s in section.sheets]
    every += [c.sheet for c in calibrations]
    every += [listed_files] if listed_files else []
    data: dict[str, Any] = {f"sheet-{s.id}": packed(s.data) for s in every}
    data["plan"] = packed(drawn)
    if view is not None:
        data["scene"] = packed(view)
    if numbers is not None:
        data["statistics"] = packed(numbers)
    if means:
        data["mean-photos"] = packed(means)
    return {
        "title": t("title", name=report.network.name or t("unnamed")),
        "date": report.provenance.run.date,
        "verdict": verdict(report, t),
        "symbols": SYMBOLS,
        "plan_click": t("plan.click"),
        "plan_text": _plan_text(plan, t),
        "plan_note": capital(plan.words(plan.plane.note)),
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
        "run": inputs.run(report, t),
        "files": listed_files,
        "protocol": render(report),
        "data": data,
    }


def _section(ident: str, t: Texts, *makers: Any, report: Report) -> Section:
    """Return a part of the page with the tables that there are."""
    found = [made for make in makers if (made := make(report, t)) is not None]
    return Section(ident, t(f"section.{ident}"), found)


def _plan_text(plan: Plan, t: Texts) -> list[str]:
    """Return the plan in words, for those who do not see it, and what it leaves out."""
    report, points = plan.report, len(plan.points)
    out = [t.number("plan.text", points, photos=len(plan.centres))]
    p = plan.precision
    if p is None:
        out.append(t("plan.singular"))
    elif plan.without_plan:
        if p.height.any():
            worst = int(p.height.argmax())
            size = f"{float(p.height[worst]) / report.small:.3g} {report.units.sigma_length}"
            out.append(t("plan.heights", name=list(report.network.points)[worst], size=size))
    elif len(p.semi) and p.semi[:, 0].any():
        worst = int(p.semi[:, 0].argmax())
        size = f"{float(p.semi[worst, 0]) / report.small:.3g} {report.units.sigma_length}"
        out.append(t("plan.ellipses", name=list(report.network.points)[worst], size=size))
    else:
        out.append(t("plan.held"))
    lost = plan.too_large()
    if lost:
        out.append(t("plan.too_large", names=listed(lost, NAMED)))
    if plan.schematic:
        out.append(t("plan.schematic"))
    return out


def _scene_text(plan: Plan, view: dict[str, Any], t: Texts) -> str:
    rays = view["rays"]
    text = t("scene.text", points=len(plan.points), photos=len(plan.centres))
    if rays["shown"] < rays["all"]:
        text += " " + t("scene.rays", shown=rays["shown"], all=rays["all"])
    return f"{text} {t('scene.flat')}" if view["flat"] else text


def _statistics_text(report: Report, numbers: dict[str, Any], t: Texts) -> dict[str, str]:
    rel = report.reliability
    assert rel is not None
    values, critical = report.tests
    size = [abs(v) for v in numbers["sorted"]]
    above = int((abs(values) > critical).sum())
    r = rel.redundancy_numbers
    return {
        "histogram": t("histogram.text", name=numbers["test"], n=numbers["n"], above=above),
        "quantiles": t("quantiles.text", name=numbers["test"], largest=f"{max(size):.2f}"),
        "redundancy": t(
            "redundancy.text",
            mean=f"{max(float(r.mean()), 0.0):.2f}",
            weak=int((r < 0.1).sum()),
            n=len(r),
        ),
    }
