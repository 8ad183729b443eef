"""The verdict of the report of two epochs: lights with the reason in words, and figures."""

from __future__ import annotations

import numpy as np

from ...quality.unit_weight import global_test
from ...units import LENGTH
from ..epochs.context import EpochsReport
from ..layout import listed, percent, short
from .language import Texts
from .verdict import NAMED, Light, Verdict


def epochs_verdict(report: EpochsReport, t: Texts) -> Verdict:
    """Return the verdict; it is red if the protocol calls the displacements doubtful."""
    lights = [
        _tested(report, t),
        *_unknowns_left_out(report, t),
        _ended(report, t),
        *_global(report, t),
        _ratio(report, t),
        _reference(report, t),
        _moved(report, t),
        *_detectable(report, t),
        *_blocks(report, t),
    ]
    n = len(report.found.moved)
    figures = _figures(report, t)
    if report.doubts:
        return Verdict("red", t("verdict.epochs.red"), lights, figures)
    if n:
        return Verdict("amber", t.number("verdict.epochs.amber", n), lights, figures)
    tested = len(report.found.stable) < len(report.found.displacements)
    words = "verdict.epochs.green" if tested else "verdict.epochs.shape"
    return Verdict("green", t(words), lights, figures)


def size(report: EpochsReport, metres: float) -> str:
    """Return a length in the unit of standard deviations."""
    unit = report.units.sigma_length
    return f"{short(metres / LENGTH[unit])} {unit}"


def _tested(report: EpochsReport, t: Texts) -> Light:
    """Say what the reference is, what was tested, and what was not."""
    found = report.found
    objects = [n for n in found.displacements if n not in found.reference]
    groups = {"reference": found.reference, "objects": objects, "held": list(found.roles.held)}
    groups |= {"not_compared": list(found.roles.not_compared)}
    parts = [
        t(f"light.tested.{group}", n=len(names), names=listed(names, NAMED))
        if names
        else t(f"light.tested.{group}.none")
        for group, names in groups.items()
    ]
    return Light("none", t("light.tested"), " ".join(p for p in parts if p))


def _unknowns_left_out(report: EpochsReport, t: Texts) -> list[Light]:
    return [
        Light("amber", t("light.unknowns_left_out"), t("light.unknowns_left_out.text"), said)
        for said in report.unknowns_left_out
    ]


def _ended(report: EpochsReport, t: Texts) -> Light:
    title, link = t("light.epochs.ended"), "table-adjustments"
    for s in report.found.solutions:
        if not s.converged:
            text = t("light.epochs.ended.no", name=s.network.name or t("unnamed"))
            return Light("red", title, text, s.reason, link)
    return Light("green", title, t("light.epochs.ended.yes"), link=link)


def _global(report: EpochsReport, t: Texts) -> list[Light]:
    """Judge each adjustment by its own global test; estimated σ̂0 of both bear a wrong one."""
    title, link = t("light.epochs.global"), "table-adjustments"
    tests = [(s.network.name or t("unnamed"), global_test(s)) for s in report.found.solutions]
    tests = [(name, test) for name, test in tests if test.redundancy > 0]
    if not tests:
        return []
    level = percent(1 - tests[0][1].alpha)
    wrong = [f"{name} (σ̂0 = {test.sigma0:.3f})" for name, test in tests if not test.accepted]
    if not wrong:
        sigma0 = ", ".join(f"{test.sigma0:.3f}" for _, test in tests)
        text = t("light.epochs.global.fine", level=level, sigma0=sigma0)
        return [Light("green", title, text, link=link)]
    known = np.isinf(report.found.scale.freedom)
    key = "light.epochs.global.known" if known else "light.epochs.global.wrong"
    text = t(key, level=level, names=", ".join(wrong))
    return [Light("red" if known else "amber", title, text, link=link)]


def _ratio(report: EpochsReport, t: Texts) -> Light:
    ratio, title, link = report.found.ratio, t("light.ratio"), "table-ratio"
    if ratio is None:
        return Light("none", title, t("light.ratio.none"))
    figures = {"ratio": f"{ratio.ratio:.2f}", "critical": f"{ratio.critical:.2f}"}
    if ratio.accepted:
        return Light("green", title, t("light.ratio.accepted", **figures), link=link)
    return Light("red", title, t("light.ratio.rejected", **figures), link=link)


def _reference(report: EpochsReport, t: Texts) -> Light:
    found, title, link = report.found, t("light.reference"), "table-steps"
    test = found.global_test
    if test is None:
        return Light("none", title, t("light.reference.none"))
    figures: dict[str, object] = {
        "n": len(found.reference),
        "value": f"{test.value:.2f}",
        "critical": f"{test.critical:.2f}",
    }
    if test.accepted:
        return Light("green", title, t("light.reference.kept", **figures), link=link)
    if not found.steps[-1].test.accepted:
        return Light("red", title, t("light.reference.lost", **figures), link=link)
    figures["left"] = listed([n for n in found.reference if n not in found.stable], NAMED)
    return Light("amber", title, t("light.reference.changed", **figures), link=link)


def _moved(report: EpochsReport, t: Texts) -> Light:
    found, title, link = report.found, t("light.moved"), "table-displacements"
    moved, alpha = found.moved, percent(found.alpha)
    if len(found.stable) == len(found.displacements):
        return Light("none", title, t("light.moved.untested"), link=link)
    if not moved:
        return Light("green", title, t("light.moved.none", alpha=alpha), link=link)
    largest = max(moved, key=lambda n: found.displacements[n].length)
    text = t.number(
        "light.moved.some",
        len(moved),
        alpha=alpha,
        names=listed(moved, NAMED),
        size=size(report, found.displacements[largest].length),
        largest=largest,
    )
    return Light("amber", title, text, link=link)


def _detectable(report: EpochsReport, t: Texts) -> list[Light]:
    loose = [x for x in report.found.displacements.values() if not x.stable]
    if not loose:
        return []
    best, worst = (pick(loose, key=lambda x: x.detectable) for pick in (min, max))
    text = t(
        "light.detectable.text",
        best=size(report, best.detectable),
        best_name=best.name,
        worst=size(report, worst.detectable),
        worst_name=worst.name,
        power=percent(report.found.power),
    )
    return [Light("none", t("light.detectable"), text, link="table-displacements")]


def _blocks(report: EpochsReport, t: Texts) -> list[Light]:
    out = []
    for b in report.blocks:
        figures = {"points": listed(b.points, NAMED), "model": t(f"model.{b.model}")}
        if b.fit is not None and not b.fit.accepted:
            text = t("light.blocks.unfit", **figures)
        elif b.motion.accepted:
            text = t("light.blocks.kept", **figures)
        else:
            text = t("light.blocks.moved", **figures)
        out.append(Light("none", t("light.blocks"), text, link="table-blocks"))
    return out


def _figures(report: EpochsReport, t: Texts) -> list[tuple[str, str]]:
    found = report.found
    freedom = found.scale.freedom
    return [
        (t("figure.compared"), str(len(found.displacements))),
        (t("figure.reference"), str(len(found.reference))),
        (t("figure.stable"), str(len(found.stable))),
        (t("figure.moved"), str(len(found.moved))),
        (t("figure.sigma_tests"), f"{float(np.sqrt(found.scale.variance)):.4f}"),
        (t("figure.freedom"), t("known") if np.isinf(freedom) else f"{freedom:.0f}"),
        ("α", percent(found.alpha)),
        ("1 − β", percent(found.power)),
    ]
