"""Reports of collocation: known and corrected points as text and tables, grids of cameras."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..collocation.image_corrections import CorrectedBundle
from ..collocation.point_corrections import PointCorrections
from ..io.numbers import Units
from ..quality.reliability import noncentrality
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..types import Array
from .layout import paragraph, title
from .tables import ENGLISH, Column, FiguresByNumber, Table, as_text, unit_of

SHORT = {"east": "e", "north": "n", "up": "u"}
"""Components in headings."""


@dataclass(frozen=True)
class CorrectedPoint:
    """A corrected point as a row of tables."""

    number: int
    """Its number."""
    name: str
    """Its name."""


@dataclass(frozen=True)
class KnownComponent:
    """A component of a known point as a row of tables."""

    number: int
    """Its number among all components of all known points."""
    name: str
    """Name of the point."""
    component: str
    """Component: east, north, up."""


@dataclass(frozen=True)
class CorrectionsReport:
    """Corrections with the units in which they are reported."""

    found: PointCorrections
    """The corrections."""
    units: Units = field(default_factory=Units)
    """Units."""


def corrected_points_table(report: CorrectionsReport) -> Table[CorrectedPoint]:
    """Return the table of all points: coordinates, corrections along east, north, up, σ."""
    found, units = report.found, report.units
    rows = [CorrectedPoint(i, name) for i, name in enumerate(found.names)]
    metre, small = unit_of(units.length), unit_of(units.sigma_length)

    def figure(heading: str, key: str, values: Array) -> Column[CorrectedPoint]:
        return Column(
            title=heading,
            key=key,
            value=FiguresByNumber(values),
            unit=small,
            digits=2,
            suffix=True,
            short_heading=True,
        )

    columns: list[Column[CorrectedPoint]] = [Column(title="point", key="name", value="name")]
    columns += [
        Column(
            title=a,
            value=FiguresByNumber(found.coordinates[:, i]),
            unit=metre,
            digits=4,
            exact=True,
            short_heading=True,
        )
        for i, a in enumerate("xyz")
        if a != "z" or found.coordinates[:, i].any()  # points of a plan have z = 0
    ]
    for heading, key, values in (
        ("d{}", "d{}", found.prediction.values),
        ("σ d{}", "sigma_d{}", found.prediction.sigmas),
        ("σ {}", "sigma_{}", found.sigmas),
    ):
        columns += [
            figure(heading.format(SHORT[c]), key.format(SHORT[c]), values[:, i])
            for i, c in enumerate(SHORT)
            if c in found.components
        ]
    return Table("corrections", rows, columns)


def known_points_table(report: CorrectionsReport) -> Table[KnownComponent]:
    """Return the table of known points: residual, signal, noise, reliability of each component."""
    found, small = report.found.collocation, unit_of(report.units.sigma_length)
    n, c = found.observed.shape
    names = report.found.components
    rows = [
        KnownComponent(i * c + k, found.names[i], names[k])
        for i in range(n)
        for k in range(c)
        if np.isfinite(found.observed[i, k])
    ]
    delta0 = noncentrality(ALPHA_OF_OBSERVATION, POWER_OF_TEST)

    def length(heading: str, key: str, values: Array) -> Column[KnownComponent]:
        return Column(
            title=heading,
            key=key,
            value=FiguresByNumber(values.ravel()),
            unit=small,
            digits=2,
            suffix=True,
            short_heading=True,
        )

    def number(heading: str, key: str, values: Array) -> Column[KnownComponent]:
        return Column(title=heading, key=key, value=FiguresByNumber(values.ravel()), digits=2)

    return Table(
        "known_points",
        rows,
        [
            Column(title="point", key="name", value="name"),
            Column(title="component", value="component"),
            length("residual", "residual", found.observed),
            length("signal", "signal", found.signal),
            length("noise", "noise", found.noise),
            number("r", "redundancy", found.redundancy_numbers),
            number("r signal", "redundancy_signal", found.signal_redundancy_numbers),
            length("left out", "leave_one_out", found.leave_one_out),
            length("σ left out", "sigma_leave_one_out", found.leave_one_out_sigmas),
            number("w", "w", found.test_values),
            length("detectable", "detectable", found.minimal_detectable_bias(delta0)),
        ],
    )


def render_corrections(report: CorrectionsReport, *, most: int | None = None) -> str:
    """Return the text report of corrections.

    Args:
        report: the corrections and their units.
        most: number of rows of the table of points; None: all.
    """
    found, c = report.found, report.found.collocation
    u = report.units
    lines = title("Collocation of residuals at known points")
    for estimate, test, some in zip(
        found.estimates, found.tests, (("east", "north"), ("up",)), strict=True
    ):
        on = [k for k in some if k in found.components]
        if not on:
            continue
        function = c.functions[found.components.index(on[0])]
        said = "no signal" if function is None else function.text("m")
        how = "stated" if estimate is None else "estimated by restricted likelihood"
        if estimate is not None and np.ndim(estimate.noise) == 0:
            how += f", together with the noise, σ {float(estimate.noise):.4g} m"
        lines += paragraph(f"{', '.join(on)}: covariance function {said}, {how}.")
        if test is not None:
            lines += paragraph(f"{test.headline()}.")
    lines += paragraph(
        f"Trend {c.trend.kind}; {len(c.names)} known points, redundancy {c.redundancy}, "
        f"σ̂0 {c.sigma0:.3f} of signal and noise together."
    )
    for remark in found.remarks:
        lines += paragraph(f"ATTENTION: {remark}.")
    known = known_points_table(report)
    lines += ["", *title("Known points"), *as_text(known, ENGLISH)]
    lines += paragraph(
        f"residual: known − adjusted; signal and noise: its filtered parts; left out: residual "
        "minus its prediction from all others; w: the same in its σ; detectable: smallest gross "
        f"error that the test finds; {u.sigma_length}."
    )
    table = corrected_points_table(report)
    shown = table if most is None else Table(table.name, table.rows[:most], table.columns)
    lines += ["", *title("Corrected points"), *as_text(shown, ENGLISH)]
    if len(shown.rows) < len(table.rows):
        lines += paragraph(f"{len(shown.rows)} of {len(table.rows)} points.")
    lines += paragraph(
        f"x, y, z: corrected, {u.length}; de, dn, du: corrections along east, north, up with their "
        f"σ, then σ of the corrected coordinates with that of the adjustment, {u.sigma_length}."
    )
    return "\n".join(lines) + "\n"


def render_image_corrections(found: CorrectedBundle) -> str:
    """Return the text report of bundles with correction grids."""
    lines = title("Collocation of image residuals")
    for number, (solution, corrections) in enumerate(
        zip(found.solutions, found.rounds, strict=False), start=1
    ):
        lines += paragraph(f"Bundle {number}: σ̂0 {solution.sigma0:.4f}.")
        for name, c in corrections.cameras.items():
            unit = solution.network.cameras[name].unit
            function = c.collocation.functions[0]
            said = "no signal" if function is None else function.text(unit)
            lines += paragraph(
                f"Camera {name}: covariance function {said}; corrections of "
                f"{len(c.lens.x)} × {len(c.lens.y)} nodes by up to {c.largest:.3g} {unit}, their "
                f"σ up to {c.sigmas.max():.3g} {unit}. {c.test.headline()}."
            )
        for remark in corrections.remarks:
            lines += paragraph(f"{remark}.")
    if len(found.solutions) > len(found.rounds):
        last = found.solutions[-1]
        lines += paragraph(f"Bundle {len(found.solutions)}: σ̂0 {last.sigma0:.4f}.")
    return "\n".join(lines) + "\n"
