"""The verdict of the HTML report: lights with the reason in words, and the main figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ...quality.check_points import check_points
from ...quality.unit_weight import global_test
from ..context import Report
from ..doubts import (
    by_chance,
    doubts_about,
    of_network,
    unknowns_left_out,
)
from ..layout import listed, percent
from ..weakest import point_redundancy
from .language import Texts
from .observations import test_name

Colour: TypeAlias = Literal["green", "amber", "red", "none"]
"""State of a light; ``none``: nothing to judge."""
NAMED = 8
"""Largest number of names in a sentence."""


@dataclass(frozen=True)
class Light:
    """One thing that was judged."""

    colour: Colour
    """State."""
    title: str
    """What was judged."""
    text: str
    """Why it has this state, with the figures."""
    told: str = ""
    """A sentence of the adjustment itself, which is English in every language."""
    link: str = ""
    """Name of the part of the page with more about it."""


@dataclass(frozen=True)
class Verdict:
    """What a reader needs first."""

    colour: Colour
    """State of the whole."""
    text: str
    """What it means."""
    lights: Sequence[Light]
    """The lights."""
    figures: Sequence[tuple[str, str]]
    """Name and value of the main figures."""


def verdict(report: Report, t: Texts) -> Verdict:
    """Return the verdict; it is red if the protocol calls the result doubtful."""
    lights = [
        _ended(report, t),
        _datum(report, t),
        _global(report, t),
        _tests(report, t),
        *_snooping(report, t),
        *_cause(report, t),
        _controlled(report, t),
        *_of_network(report, t),
        *_unknowns_left_out(report, t),
        *_parameters(report, t),
        *_check(report, t),
    ]
    states = {light.colour for light in lights}
    colour: Colour = "red" if report.doubts or "red" in states else "green"
    colour = "amber" if colour == "green" and "amber" in states else colour
    return Verdict(colour, t(f"verdict.{colour}"), lights, _figures(report, t))


def _ended(report: Report, t: Texts) -> Light:
    s = report.solution
    if not s.converged:
        text = t.number("light.ended.no", s.iterations)
        return Light("red", t("light.ended"), text, s.reason)
    text = t.number("light.ended.yes", s.iterations)
    if s.second_places:
        told = "; ".join(s.second_places)
        return Light("red", t("light.ended"), f"{text} {t('light.second')}", told)
    return Light("green", t("light.ended"), text)


def _datum(report: Report, t: Texts) -> Light:
    s, link = report.solution, "inputs"
    if s.datum is None:
        return Light("green", t("light.datum"), t("light.datum.given"), link=link)
    flagged = sum(p.datum for p in report.network.points.values())
    over = t.number("light.datum.some", flagged) if flagged else t("light.datum.all")
    text = t("light.datum.free", d=s.datum_defect, over=over)
    return Light("green", t("light.datum"), text, link=link)


def _global(report: Report, t: Texts) -> Light:
    test, title = global_test(report.solution), t("light.global")
    if test.redundancy <= 0:
        return Light("amber", title, t("light.global.none"), link="groups")
    if report.components is not None:
        text = t("light.global.components", sigma0=f"{test.sigma0:.4f}")
        return Light("none", title, text, link="groups")
    figures = {
        "sigma0": f"{test.sigma0:.4f}",
        "lower": f"{test.lower:.4f}",
        "upper": f"{test.upper:.4f}",
        "level": percent(1 - test.alpha),
    }
    if test.accepted:
        return Light("green", title, t("light.global.accepted", **figures), link="groups")
    if test.too_good:
        return Light("amber", title, t("light.global.small", **figures), link="groups")
    return Light("red", title, t("light.global.large", **figures), link="groups")


def _tests(report: Report, t: Texts) -> Light:
    title, link = t("light.tests"), "worst"
    if report.reliability is None:
        return Light("amber", title, t("light.tests.none"), report.no_reliability, link)
    values, critical = report.tests
    tested = int(np.isfinite(values).sum())
    if not tested:
        return Light("amber", title, t("light.tests.nothing"), link=link)
    figures = {"name": test_name(report), "critical": f"{critical:.2f}"}
    figures["alpha"] = percent(report.options.alpha)
    above = int(np.sum(np.abs(values) > critical))
    if not above:
        return Light("green", title, t("light.tests.fine", **figures), link=link)
    text = t.number("light.tests.above", above, **figures)
    expected = report.options.alpha * tested
    chance = by_chance(values, critical, report.options.alpha, report.redundancy_of_tau)
    if expected >= 1 or chance:
        n = f"{expected:.0f}" if expected >= 1 else f"{expected:.1g}"
        text += " " + t("light.tests.chance", n=n)
    return Light("green" if chance else "red", title, text, link=link)


def _snooping(report: Report, t: Texts) -> list[Light]:
    found = report.snooping
    if found is None:
        return []
    title, n = t("light.aside"), len(found.ids_set_aside)
    left = len(found.unresolved)
    if left:
        text = t.number("light.unresolved", left) + " " + t.number("light.aside.some", n)
        return [Light("red", title, text, found.reason, "table-unresolved")]
    if n:
        return [
            Light("amber", title, t.number("light.aside.some", n), found.reason, "table-rejected")
        ]
    return [Light("green", title, t("light.aside.none"))]


def _cause(report: Report, t: Texts) -> list[Light]:
    found = report.causes
    if found is None:
        return []
    if undecided := found.nothing_tells:
        link = "table-causes" if found.likelier else ""
        return [Light("red", t("light.cause"), t("light.cause.text.none"), undecided[0], link)]
    if (c := found.likeliest) is None:
        return []
    text = t.number("light.cause.text", len(found.likelier))
    if not found.alone(c):
        text = t("light.cause.several")
    return [
        Light(
            "red",
            t("light.cause"),
            text,
            f"{c.cause} {c.where}{found.consequence(c)}",
            "table-causes",
        )
    ]


def _controlled(report: Report, t: Texts) -> Light:
    rel, title = report.reliability, t("light.controlled")
    if rel is None or report.solution.redundancy <= 0:
        return Light("amber", title, t("light.controlled.nothing"), link="groups")
    n = int((~rel.controlled & ~report.stiff).sum())
    if not n:
        least = max(float(rel.redundancy_numbers[~report.stiff].min(initial=1.0)), 0.0)
        return Light("green", title, t("light.controlled.all", least=f"{least:.2f}"), link="groups")
    text = t.number("light.controlled.some", n)
    counts = point_redundancy(rel)
    lonely = np.flatnonzero((counts.rows > 0) & (counts.uncontrolled == counts.rows))
    names = report.solution.equations.unknowns["point"].names
    if len(lonely):
        text += " " + t("light.controlled.points", names=listed([names[i] for i in lonely], NAMED))
    return Light("amber", title, text, link="groups")


def _of_network(report: Report, t: Texts) -> list[Light]:
    """Return doubts for which no other light stands, as the adjustment words them."""
    told = {
        *doubts_about(report.solution),
        *report.above_critical,
        *report.likelier,
        *report.at_check_points,
    }
    rest = [d for d in report.doubts if d not in told]
    assert set(of_network(report.network)) <= set(rest) | told
    return [Light("red", t("light.input"), t("light.input.text"), d, "inputs") for d in rest]


def _unknowns_left_out(report: Report, t: Texts) -> list[Light]:
    return [
        Light("amber", t("light.unknowns_left_out"), t("light.unknowns_left_out.text"), said)
        for said in unknowns_left_out(report.network)
    ]


def _parameters(report: Report, t: Texts) -> list[Light]:
    found = report.significance
    if found is None or not found.parameters:
        return []
    title, n = t("light.parameters"), len(found.overparametrised)
    if not n:
        return [Light("green", title, t("light.parameters.fine", limit=f"{found.limit:g}"))]
    told = "; ".join(found.overparametrised[:3])
    text = t.number("light.parameters.some", n, limit=f"{found.limit:g}")
    return [Light("amber", title, text, told, "cameras" if report.network.photos else "unknowns")]


def _check(report: Report, t: Texts) -> list[Light]:
    if report.singular:
        return []
    found = check_points(report.solution)
    if not found.names:
        return []
    rms, expected = (
        ", ".join(f"{v:.2f}" if np.isfinite(v) else "–" for v in (x / report.small).tolist())
        for x in (found.rms, found.rms_sigma)
    )
    figures = {"rms": rms, "expected": expected, "unit": report.units.sigma_length}
    text = t.number("light.check.text", len(found.names), **figures)
    doubts = report.at_check_points
    colour: Colour = "red" if doubts else "none"
    return [Light(colour, t("light.check"), text, "; ".join(doubts), "table-check")]


def _figures(report: Report, t: Texts) -> list[tuple[str, str]]:
    s, test, network = report.solution, global_test(report.solution), report.network
    out = [
        (t("figure.points"), str(len(network.points))),
        (t("figure.photos"), str(len(network.photos)) if network.photos else ""),
        (t("figure.n"), str(s.n_observations)),
        (t("figure.u"), str(s.n_unknowns)),
        (t("figure.d"), str(s.datum_defect)),
        (t("figure.r"), str(s.redundancy)),
        ("σ̂0", f"{test.sigma0:.5f}" if test.redundancy > 0 else "–"),
        ("vᵀPv", f"{s.vtpv:.6g}"),
        (t("figure.iterations"), str(s.iterations)),
        (t("figure.variance"), t(f"variance.{s.variance}")),
    ]
    rel = report.reliability
    if rel is not None and s.redundancy > 0:
        total = float(rel.redundancy_numbers.sum()) + rel.redundancy_of_extra_factors
        out.insert(6, (t("figure.sum_r"), f"{total:.3f}"))
    return [(name, value) for name, value in out if value]
