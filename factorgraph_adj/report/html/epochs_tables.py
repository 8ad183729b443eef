"""Tables of the report of two epochs."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

from ...epochs.blocks import BlockMotion
from ...epochs.hypotheses import Test
from ...quality.unit_weight import global_test
from ...units import ANGLE, LENGTH, decimal, decimal_angle
from ..epochs.context import EpochsReport
from ..epochs.text import PARAMETER_UNITS
from ..layout import listed, percent, short
from .language import Texts
from .sheets import NONE, Head, Sheet, columns_of, sheet

NAMED = 30
"""Largest number of names in a cell."""


def adjustments(report: EpochsReport, t: Texts) -> Sheet | None:
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
                f"{test.sigma0:.4f}" if known else NONE,
                f"{test.lower:.4f} – {test.upper:.4f}" if known else NONE,
                f"{s.vtpv:.6g}",
            ]
        )
    heads: list[Head] = [
        (t("col.epoch"), False),
        (t("figure.n"), True),
        (t("figure.u"), True),
        (t("figure.d"), True),
        (t("figure.r"), True),
        ("σ̂0", True),
        ("σ̂0 (χ²)", True),
        ("vᵀPv", True),
    ]
    return sheet("adjustments", t("adjustments.caption"), columns_of(heads, rows))


def ratio(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the test of the ratio of the variances."""
    found = report.found.ratio
    if found is None:
        return None
    row = [f"{found.ratio:.3f}", f"{found.critical:.3f}", t("yes" if found.accepted else "no")]
    heads: list[Head] = [
        (t("col.larger"), True),
        (t("col.critical"), True),
        (t("col.fits"), False),
    ]
    return sheet("ratio", t("ratio.caption"), columns_of(heads, [row]))


def steps(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the congruence tests of the reference points, step by step."""
    found, left = report.found, 0
    rows = []
    for i, step in enumerate(found.steps):
        left += len(step.left) - len(step.back)
        rows.append(
            [
                str(i),
                listed(step.left, NAMED) or NONE,
                listed(step.back, NAMED) or NONE,
                str(len(found.reference) - left),
                *_test(step.test),
                t("yes" if step.test.accepted else "no") if step.test.freedom[0] else NONE,
            ]
        )
    heads: list[Head] = [
        (t("col.step"), True),
        (t("col.left"), False),
        (t("col.back"), False),
        (t("col.tested"), True),
        *_test_heads("T", t),
        (t("col.fits"), False),
    ]
    notes = [t("steps.note")]
    return sheet("steps", t("steps.caption"), columns_of(heads, rows), notes=notes)


def _or_infinite(value: float) -> str:
    return decimal(value, 2) if isfinite(value) else "∞"


def displacements(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the displacements with their tests and ellipses."""
    found, unit = report.found, report.units.sigma_length
    size, angle = LENGTH[unit], decimal_angle(report.units.angle)
    at = ["xyz".index(a) for a in found.differences.axes]
    rows = []
    every = zip(found.displacements.values(), report.states, report.ellipses, strict=True)
    for x, state, e in every:
        flat = e.semi_axes[0] > 0
        axes = (short(v / size) for v in e.semi_axes)
        rows.append(
            [
                x.name,
                t(f"state.{state}"),
                *(decimal(float(x.vector[i]) / size, 2) for i in at),
                *(_or_infinite(float(x.sigmas[i]) / size) for i in at),
                decimal(x.length / size, 2),
                *_test(x.test),
                NONE if x.stable else t("yes" if x.moved else "no"),
                _or_infinite(x.detectable / size),
                *(axes if flat else (NONE, NONE)),
                decimal(e.azimuth / ANGLE[angle], 1) if flat else NONE,
            ]
        )
    heads: list[Head] = [
        (t("col.point"), False),
        (t("col.state"), False),
        *((f"d{'xyz'[i]} [{unit}]", True, t("help.displacement")) for i in at),
        *((f"σ d{'xyz'[i]} [{unit}]", True, t("help.sigma_d")) for i in at),
        (f"{t('col.length')} [{unit}]", True),
        *_test_heads("T", t),
        (t("col.moved"), False),
        (f"{t('col.detectable')} [{unit}]", True, t("help.detectable")),
        (f"a [{unit}]", True, t("help.ellipse_d")),
        (f"b [{unit}]", True, t("help.ellipse_d")),
        (f"{t('col.azimuth')} [{angle}]", True, t("help.ellipse_d")),
    ]
    level = report.confidence
    note = (
        t("displacements.note_standard")
        if level is None
        else t("displacements.note", level=percent(level))
    )
    caption = t("displacements.caption")
    return sheet("displacements", caption, columns_of(heads, rows), notes=[note])


def blocks(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the tests of the common motions."""
    rows = []
    for b in report.blocks:
        fit = [NONE, NONE, NONE]
        if b.fit is not None:
            words = t("yes" if b.fit.accepted else "no")
            fit = [f"{b.fit.value:.2f}", f"{b.fit.critical:.2f}", words]
        rows.append(
            [
                listed(b.points, NAMED),
                t(f"model.{b.model}"),
                f"{b.motion.value:.2f}",
                f"{b.motion.critical:.2f}",
                t("no" if b.motion.accepted else "yes"),
                *fit,
            ]
        )
    heads: list[Head] = [
        (t("col.points"), False),
        (t("col.model"), False),
        (t("col.motion"), True, t("help.t_epochs")),
        (t("col.critical"), True),
        (t("col.moved"), False),
        (t("col.fit"), True, t("help.t_epochs")),
        (t("col.critical"), True),
        (t("col.fits"), False),
    ]
    return sheet("blocks", t("blocks.caption"), columns_of(heads, rows))


def motions(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the parameters of the common motions."""
    rows = []
    for b in report.blocks:
        for name, value, sigma in zip(b.names, b.values.tolist(), b.sigmas.tolist(), strict=True):
            unit, factor = PARAMETER_UNITS[name[0]]
            figures = [short(factor * value), short(factor * sigma), unit]
            rows.append([_block(b, t), name, *figures])
    heads: list[Head] = [
        (t("col.block"), False),
        (t("col.parameter"), False),
        (t("col.value"), True),
        ("σ", True),
        (t("col.unit"), False),
    ]
    return sheet("motions", t("motions.caption"), columns_of(heads, rows))


def strains(report: EpochsReport, t: Texts) -> Sheet | None:
    """Return the principal strains of affine motions."""
    rows = []
    for b in report.blocks:
        if b.model == "affine":
            values, axes = b.principal_strains()
            for value, axis in zip(values.tolist(), axes.tolist(), strict=True):
                direction = " ".join(f"{v:.4f}" for v in axis)
                rows.append([_block(b, t), f"{1e6 * value:.2f}", direction])
    heads: list[Head] = [
        (t("col.block"), False),
        (f"{t('col.strain')} [ppm]", True),
        (t("col.axis"), False),
    ]
    return sheet("strains", t("strains.caption"), columns_of(heads, rows))


def _block(b: BlockMotion, t: Texts) -> str:
    return f"{listed(b.points, NAMED)} ({t(f'model.{b.model}')})"


def _test(test: Test) -> Sequence[str]:
    p = "< 0.0001" if test.p_value < 1e-4 else f"{test.p_value:.4f}"
    return f"{test.value:.2f}", f"{test.critical:.2f}", str(test.freedom[0]), p


def _test_heads(name: str, t: Texts) -> list[Head]:
    return [
        (name, True, t("help.t_epochs")),
        (t("col.critical"), True),
        (t("col.dof"), True),
        ("p", True, t("help.p")),
    ]
