"""Verdict of an HTML page on an adjustment or two epochs: lights with reasons, main figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ...quality.point_precision import check_points
from ...quality.reliability import point_redundancy
from ...statistical_tests import global_test
from ...units import LENGTH
from ..adjusted_observations import redundancy_text, test_symbol
from ..adjustment_report import Report
from ..catalogue import Texts
from ..doubtful_results import (
    doubts_of_network,
    doubts_of_solution,
    exceeded_by_chance,
    unknowns_left_out,
)
from ..epochs_report import EpochsReport
from ..layout import listed, percent, short
from ..misfit_causes import all_doubts
from ..reliability import MIN_REDUNDANCY_OF_CONTROL, hardly_controlled

LightColour: TypeAlias = Literal["green", "amber", "red", "none"]
"""State of a light; ``none``: nothing to judge."""
MAX_NAMES_IN_LIGHT = 8
"""Largest number of names in a sentence."""


@dataclass(frozen=True)
class Light:
    """One thing that was judged."""

    colour: LightColour
    """State."""
    title: str
    """What was judged."""
    text: str
    """Why it has this state, with the figures."""
    told: str = ""
    """A sentence of the adjustment itself, which is English in every language."""
    link: str = ""
    """Name of the part of the page with more about it."""
    noted: bool = False
    """Whether a note of the text report says the same."""

    @property
    def sentence(self) -> str:
        """`told` with a capital where it begins a sentence; names and symbols stay as they are."""
        word = self.told.partition(" ")[0]
        begins = not self.text or self.text.endswith(".")
        plain = word.isascii() and word.isalpha() and len(word) > 1
        return self.told[0].upper() + self.told[1:] if begins and plain else self.told


@dataclass(frozen=True)
class Verdict:
    """What a reader needs first."""

    colour: LightColour
    """State of the whole."""
    text: str
    """What it means."""
    lights: Sequence[Light]
    """The lights."""
    figures: Sequence[tuple[str, str]]
    """Name and value of the main figures."""


def adjustment_verdict(report: Report, t: Texts) -> Verdict:
    """Return the verdict; it is red if the text report calls the result doubtful."""
    lights = [
        _ended(report, t),
        _datum(report, t),
        _global(report, t),
        _tests(report, t),
        *_snooping(report, t),
        *_left_out(report, t),
        *_cause(report, t),
        _controlled(report, t),
        *_of_network(report, t),
        *_unknowns_left_out(unknowns_left_out(report.network), t),
        *_listed(report, t),
        *_parameters(report, t),
        *_check(report, t),
    ]
    states = {light.colour for light in lights}
    colour: LightColour = "red" if all_doubts(report) or "red" in states else "green"
    colour = "amber" if colour == "green" and "amber" in states else colour
    reserved = sum(light.colour == "amber" for light in lights)
    words = verdict_words(colour, t, too_good=reserved == 1 and _too_good(report))
    return Verdict(colour, words, lights, _figures(report, t))


def verdict_words(colour: LightColour, t: Texts, *, too_good: bool) -> str:
    """Return what the state of an adjustment means.

    Args:
        colour: the state.
        t: texts of the language.
        too_good: whether its only reservation is that readings fit better than their σ say.
    """
    return t("verdict_too_good" if colour == "amber" and too_good else f"verdict_{colour}")


def _too_good(report: Report) -> bool:
    """Return whether σ̂0 lies below its bounds; fitted weights leave nothing to test."""
    return report.components is None and global_test(report.solution).too_good


def _ended(report: Report, t: Texts) -> Light:
    s = report.solution
    if not s.converged:
        text = t.number("light_ended_no", s.iterations)
        return Light("red", t("light_ended"), text, s.reason)
    text = t.number("light_ended_yes", s.iterations)
    if s.second_places:
        told = "; ".join(s.second_places)
        return Light("red", t("light_ended"), f"{text} {t('light_second')}", told)
    return Light("green", t("light_ended"), text)


def _datum(report: Report, t: Texts) -> Light:
    s, link = report.solution, "inputs"
    if s.datum is None:
        return Light("green", t("light_datum"), t("light_datum_given"), link=link)
    flagged = sum(p.datum for p in report.network.points.values())
    over = t.number("light_datum_some", flagged) if flagged else t("light_datum_all")
    text = t("light_datum_free", d=s.datum_defect, over=over)
    return Light("green", t("light_datum"), text, link=link)


def _global(report: Report, t: Texts) -> Light:
    test, title = global_test(report.solution), t("light_global")
    if test.redundancy <= 0:
        return Light("amber", title, t("light_global_none"), link="groups")
    if report.components is not None:
        text = t("light_global_components", sigma0=f"{test.sigma0:.4f}")
        return Light("none", title, text, link="groups")
    figures = {
        "sigma0": f"{test.sigma0:.4f}",
        "lower": f"{test.lower:.4f}",
        "upper": f"{test.upper:.4f}",
        "level": percent(1 - test.alpha),
    }
    if test.accepted:
        return Light("green", title, t("light_global_accepted", **figures), link="groups")
    if test.too_good:
        text = t("light_global_small", **figures)
        return Light("amber", title, text, link="groups", noted=True)
    return Light("red", title, t("light_global_large", **figures), link="groups")


def _tests(report: Report, t: Texts) -> Light:
    title, link = t("light_tests"), "worst"
    if report.reliability is None:
        return Light("amber", title, t("light_tests_none"), report.no_reliability, link)
    values, critical = report.tests
    tested = int(np.isfinite(values).sum())
    if not tested:
        return Light("amber", title, t("light_tests_nothing"), link=link)
    figures = {"name": test_symbol(report), "critical": f"{critical:.2f}"}
    figures["alpha"] = percent(report.options.alpha)
    above = int(np.sum(np.abs(values) > critical))
    if not above:
        return Light("green", title, t("light_tests_fine", **figures), link=link)
    text = t.number("light_tests_above", above, **figures)
    expected = report.options.alpha * tested
    chance = exceeded_by_chance(values, critical, report.options.alpha, report.redundancy_of_tau)
    if expected >= 1 or chance:
        n = f"{expected:.0f}" if expected >= 1 else f"{expected:.1g}"
        text += " " + t("light_tests_chance", n=n)
    return Light("green" if chance else "red", title, text, link=link)


def _snooping(report: Report, t: Texts) -> list[Light]:
    found = report.snooping
    if found is None:
        return []
    title, n = t("light_aside"), len(found.rejected_ids)
    left = len(found.unresolved)
    if left:
        text = t.number("light_unresolved", left) + " " + t.number("light_aside_some", n)
        return [Light("red", title, text, found.reason, "table-unresolved")]
    if n:
        text = t.number("light_aside_some", n)
        return [Light("amber", title, text, found.reason, "table-rejected")]
    return [Light("green", title, t("light_aside_none"))]


def _left_out(report: Report, t: Texts) -> list[Light]:
    n = len(report.provenance.left_out)
    text = t.number("light_left_out_text", n)
    return [Light("amber", t("light_left_out"), text, link="table-left_out")] if n else []


def _cause(report: Report, t: Texts) -> list[Light]:
    found = report.causes
    if found is None:
        return []
    if undecided := found.undecided_sentences:
        link = "table-causes" if found.more_probable else ""
        return [Light("red", t("light_cause"), t("light_cause_text_none"), undecided[0], link)]
    if (c := found.most_probable) is None:
        return []
    text = t.number("light_cause_text", len(found.more_probable))
    if not found.alone(c):
        text = t("light_cause_several")
    return [
        Light(
            "red",
            t("light_cause"),
            text,
            f"{c.cause} {c.where}{found.consequence(c)}",
            "table-causes",
        )
    ]


def _controlled(report: Report, t: Texts) -> Light:
    rel, title = report.reliability, t("light_controlled")
    if rel is None or report.solution.redundancy <= 0:
        unknown = report.solution.redundancy > 0
        what = "light_controlled_unknown" if unknown else "light_controlled_nothing"
        return Light("amber", title, t(what), link="groups")
    n = int((~rel.controlled & ~report.stiff).sum())
    if not n:
        least = max(float(rel.redundancy_numbers[~report.stiff].min(initial=1.0)), 0.0)
        shown = redundancy_text(least)
        if hardly := len(hardly_controlled(report, rel)):
            limit = f"{MIN_REDUNDANCY_OF_CONTROL:g}"
            text = t.number("light_controlled_hardly", hardly, limit=limit, least=shown)
            return Light("amber", title, text, link="groups")
        return Light("green", title, t("light_controlled_all", least=shown), link="groups")
    text = t.number("light_controlled_some", n)
    counts = point_redundancy(rel)
    lonely = np.flatnonzero((counts.rows > 0) & (counts.uncontrolled == counts.rows))
    names = report.solution.equations.unknowns["point"].names
    if len(lonely):
        text += " " + t(
            "light_controlled_points", names=listed([names[i] for i in lonely], MAX_NAMES_IN_LIGHT)
        )
    return Light("amber", title, text, link="groups")


def _of_network(report: Report, t: Texts) -> list[Light]:
    """Return doubts for which no other light stands, as the adjustment words them."""
    told = {
        *doubts_of_solution(report.solution),
        *report.above_critical,
        *report.more_probable,
        *report.doubtful_check_points,
    }
    rest = [d for d in report.doubts if d not in told]
    assert set(doubts_of_network(report.network)) <= set(rest) | told
    return [Light("red", t("light_input"), t("light_input_text"), d, "inputs") for d in rest]


def _listed(report: Report, t: Texts) -> list[Light]:
    """Return how many points only a list has."""
    names = list(report.network.listed_points)
    if not names:
        return []
    text = t.number("light_listed_text", len(names), names=listed(names, MAX_NAMES_IN_LIGHT))
    return [Light("none", t("light_listed"), text)]


def _unknowns_left_out(sentences: Sequence[str], t: Texts) -> list[Light]:
    title, text = t("light_unknowns_left_out"), t("light_unknowns_left_out_text")
    return [Light("amber", title, text, said) for said in sentences]


def _parameters(report: Report, t: Texts) -> list[Light]:
    found = report.significance
    if found is None or not found.parameters:
        return []
    title, n = t("light_parameters"), len(found.overparametrised)
    if not n:
        return [Light("green", title, t("light_parameters_fine", limit=f"{found.limit:g}"))]
    told = "; ".join(found.overparametrised[:3])
    text = t.number("light_parameters_some", n, limit=f"{found.limit:g}")
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
    text = t.number("light_check_text", len(found.names), **figures)
    doubts = report.doubtful_check_points
    colour: LightColour = "red" if doubts else "none"
    return [Light(colour, t("light_check"), text, "; ".join(doubts), "table-check")]


def _figures(report: Report, t: Texts) -> list[tuple[str, str]]:
    s, test, network = report.solution, global_test(report.solution), report.network
    out = [
        (t("figure_points"), str(len(network.points))),
        (t("figure_photos"), str(len(network.photos)) if network.photos else ""),
        (t("figure_n"), str(s.n_observations)),
        (t("figure_u"), str(s.n_unknowns)),
        (t("figure_d"), str(s.datum_defect)),
        (t("figure_r"), str(s.redundancy)),
        ("σ̂0", f"{test.sigma0:.5f}" if test.redundancy > 0 else "–"),
        ("vᵀPv", f"{s.vtpv:.6g}"),
        (t("figure_iterations"), str(s.iterations)),
        (t("figure_variance"), t(f"variance_{s.variance.replace('-', '_')}")),
    ]
    rel = report.reliability
    if rel is not None and s.redundancy > 0:
        total = float(rel.redundancy_numbers.sum()) + rel.redundancy_of_extra_factors
        out.insert(6, (t("figure_sum_r"), f"{total:.3f}"))
    return [(name, value) for name, value in out if value]


def epochs_verdict(report: EpochsReport, t: Texts) -> Verdict:
    """Return the verdict; it is red if the text report calls the displacements doubtful."""
    lights = [
        _tested(report, t),
        *_unknowns_left_out(report.unknowns_left_out, t),
        _epochs_ended(report, t),
        *_epochs_global_tests(report, t),
        _ratio(report, t),
        _reference(report, t),
        _moved(report, t),
        *_detectable(report, t),
        *_blocks(report, t),
    ]
    n = len(report.found.moved)
    figures = _epochs_figures(report, t)
    if report.doubts:
        return Verdict("red", t("verdict_epochs_red"), lights, figures)
    if n:
        return Verdict("amber", t.number("verdict_epochs_amber", n), lights, figures)
    tested = len(report.found.stable) < len(report.found.displacements)
    words = "verdict_epochs_green" if tested else "verdict_epochs_shape"
    return Verdict("green", t(words), lights, figures)


def sigma_length_text(report: EpochsReport, metres: float) -> str:
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
        t(f"light_tested_{group}", n=len(names), names=listed(names, MAX_NAMES_IN_LIGHT))
        if names
        else t(f"light_tested_{group}_none")
        for group, names in groups.items()
    ]
    return Light("none", t("light_tested"), " ".join(p for p in parts if p))


def _epochs_ended(report: EpochsReport, t: Texts) -> Light:
    title, link = t("light_epochs_ended"), "table-adjustments"
    for s in report.found.solutions:
        if not s.converged:
            text = t("light_epochs_ended_no", name=s.network.name or t("unnamed"))
            return Light("red", title, text, s.reason, link)
    return Light("green", title, t("light_epochs_ended_yes"), link=link)


def _epochs_global_tests(report: EpochsReport, t: Texts) -> list[Light]:
    """Judge each adjustment by its own global test; estimated σ̂0 of both bear a wrong one."""
    title, link = t("light_epochs_global"), "table-adjustments"
    tests = [(s.network.name or t("unnamed"), global_test(s)) for s in report.found.solutions]
    tests = [(name, test) for name, test in tests if test.redundancy > 0]
    if not tests:
        return []
    level = percent(1 - tests[0][1].alpha)
    wrong = [
        t(f"light_epochs_{test.outcome}", name=name, sigma0=f"{test.sigma0:.3f}")
        for name, test in tests
        if not test.accepted
    ]
    if not wrong:
        sigma0 = ", ".join(f"{test.sigma0:.3f}" for _, test in tests)
        text = t("light_epochs_global_fine", level=level, sigma0=sigma0)
        return [Light("green", title, text, link=link)]
    known = np.isinf(report.found.scale.freedom)
    key = "light_epochs_global_known" if known else "light_epochs_global_wrong"
    text = t(key, level=level, names=", ".join(wrong))
    return [Light("red" if known else "amber", title, text, link=link)]


def _ratio(report: EpochsReport, t: Texts) -> Light:
    ratio, title, link = report.found.ratio, t("light_ratio"), "table-ratio"
    if ratio is None:
        return Light("none", title, t("light_ratio_none"))
    figures = {"ratio": f"{ratio.ratio:.2f}", "critical": f"{ratio.critical:.2f}"}
    if ratio.accepted:
        return Light("green", title, t("light_ratio_accepted", **figures), link=link)
    return Light("red", title, t("light_ratio_rejected", **figures), link=link)


def _reference(report: EpochsReport, t: Texts) -> Light:
    found, title, link = report.found, t("light_reference"), "table-steps"
    test = found.global_test
    if test is None:
        return Light("none", title, t("light_reference_none"))
    figures: dict[str, object] = {
        "n": len(found.reference),
        "value": f"{test.value:.2f}",
        "critical": f"{test.critical:.2f}",
    }
    if test.accepted:
        return Light("green", title, t("light_reference_kept", **figures), link=link)
    if not found.steps[-1].test.accepted:
        return Light("red", title, t("light_reference_lost", **figures), link=link)
    figures["left"] = listed(
        [n for n in found.reference if n not in found.stable], MAX_NAMES_IN_LIGHT
    )
    return Light("amber", title, t("light_reference_changed", **figures), link=link)


def _moved(report: EpochsReport, t: Texts) -> Light:
    found, title, link = report.found, t("light_moved"), "table-displacements"
    moved, alpha = found.moved, percent(found.alpha)
    if len(found.stable) == len(found.displacements):
        return Light("none", title, t("light_moved_untested"), link=link)
    if not moved:
        return Light("green", title, t("light_moved_none", alpha=alpha), link=link)
    largest = max(moved, key=lambda n: found.displacements[n].length)
    text = t.number(
        "light_moved_some",
        len(moved),
        alpha=alpha,
        names=listed(moved, MAX_NAMES_IN_LIGHT),
        size=sigma_length_text(report, found.displacements[largest].length),
        largest=largest,
    )
    return Light("amber", title, text, link=link)


def _detectable(report: EpochsReport, t: Texts) -> list[Light]:
    loose = [x for x in report.found.displacements.values() if not x.stable]
    if not loose:
        return []
    best, worst = (pick(loose, key=lambda x: x.detectable) for pick in (min, max))
    text = t(
        "light_detectable_text",
        best=sigma_length_text(report, best.detectable),
        best_name=best.name,
        worst=sigma_length_text(report, worst.detectable),
        worst_name=worst.name,
        power=percent(report.found.power),
    )
    return [Light("none", t("light_detectable"), text, link="table-displacements")]


def _blocks(report: EpochsReport, t: Texts) -> list[Light]:
    out = []
    for b in report.blocks:
        figures = {"points": listed(b.points, MAX_NAMES_IN_LIGHT), "model": t(f"model_{b.model}")}
        if b.fit is not None and not b.fit.accepted:
            text = t("light_blocks_unfit", **figures)
        elif b.motion.accepted:
            text = t("light_blocks_kept", **figures)
        else:
            text = t("light_blocks_moved", **figures)
        out.append(Light("none", t("light_blocks"), text, link="table-blocks"))
    return out


def _epochs_figures(report: EpochsReport, t: Texts) -> list[tuple[str, str]]:
    found = report.found
    freedom = found.scale.freedom
    return [
        (t("figure_compared"), str(len(found.displacements))),
        (t("figure_reference"), str(len(found.reference))),
        (t("figure_stable"), str(len(found.stable))),
        (t("figure_moved"), str(len(found.moved))),
        (t("figure_sigma_tests"), f"{float(np.sqrt(found.scale.variance)):.4f}"),
        (t("figure_freedom"), t("known") if np.isinf(freedom) else f"{freedom:.0f}"),
        ("α", percent(found.alpha)),
        ("1 − β", percent(found.power)),
    ]
