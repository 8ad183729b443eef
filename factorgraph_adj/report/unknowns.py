"""Sections of calibrations, inseparable parameters, orientations, refraction, other unknowns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal

from ..entities import Camera, Parameter, parameter_name
from ..graph.variables import camera_of_calibration
from ..models.unknown_registry import UNKNOWNS, Quantity, VariableKind, parameter_kinds
from ..quality.parameter_significance import TestedParameter
from ..units import ANGLE, decimal, decimal_angle
from .adjustment_report import Report
from .layout import paragraph, percent, short, table, title, with_sigma
from .tables import Column, Table, Unit, as_text, unit_of

MAX_WARNINGS_LISTED = 10
"""Largest number of listed warnings."""
_USUAL = {"refraction": "refraction", "vertical": "verticals", "edm": "distance meters"}
"""Kinds that the heading of their table names first, and in what words."""
_APART = ("frame",)
"""Kinds with a table of their own in the protocol."""
_PER = ("", "/t", "/t²")
"""What stands behind the unit of a component that observations multiply by a power of t."""
STRONG_CORRELATION = 0.8
"""Smallest absolute correlation of calibration parameters that is reported as strong."""
MAX_COMPONENTS_HELD_SHOWN = 2
"""Number of components of an unknown up to which those that are held at zero are shown."""


def calibrations_section(report: Report) -> list[str]:
    """Return each calibration with standard deviations and strong correlations."""
    names, few = list(report.calibrations), max(1, report.options.most // 10)
    out: list[str] = []
    for name in names[:few]:
        camera = camera_of_calibration(report.network, name)
        out += ["", *_calibration(report, name, camera)]
    if len(names) > few:
        out += ["", f"  … {len(names) - few} more calibrations in {report.where('unknowns.csv')}"]
    return out[1:]


def _calibration(report: Report, name: str, camera: Camera) -> list[str]:
    estimate, rows = report.calibrations[name], []
    for i, parameter in enumerate(estimate.names):
        value, sigma = float(estimate.values[i]), float(estimate.sigmas[i])
        if not camera.fixed[i]:
            t, verdict = _verdict(report.tested("calibration", name, parameter))
            rows.append([parameter, with_sigma(value, sigma), f"{sigma:.2g}", t, verdict])
        elif value != 0.0 or i < 3:
            rows.append([parameter, f"{value + 0.0:.8g}", "held", "", ""])
    free = [i for i, held in enumerate(camera.fixed) if not held]
    strong = [
        f"{estimate.names[i]}–{estimate.names[j]} {estimate.correlation[i, j]:+.2f}"
        for k, i in enumerate(free)
        for j in free[k + 1 :]
        if abs(estimate.correlation[i, j]) >= STRONG_CORRELATION
    ]
    out = title(f"Calibration of {name} (lens model {camera.lens.kind}; image unit {camera.unit})")
    tested = any(r[3] for r in rows)
    header = ["parameter", "value", "σ", *(["t"] if tested else []), ""]
    out += table(header, rows if tested else [[*r[:3], r[4]] for r in rows])
    if len(free) > 1:
        out.append(f"  correlations from {STRONG_CORRELATION}: {', '.join(strong) or 'none'}")
    if tested:
        out.append(_meaning(report))
    return out


def _verdict(tested: TestedParameter | None) -> tuple[str, str]:
    """Return t and its verdict; empty for principal distance and point without a given σ."""
    if tested is None or not (tested.additional or tested.weighted):
        return "", ""
    if tested.weighted:
        words = "weighted, differs from what was given" if tested.significant else "weighted"
    else:
        words = "significant" if tested.significant else "not significant"
    return decimal(tested.t, 2), words


def _meaning(report: Report) -> str:
    found = report.significance
    assert found is not None
    return (
        f"  t against 0, or what was given if weighted: significant from {found.critical:.2f} "
        f"({percent(1 - found.alpha)})"
    )


def overparametrised_section(report: Report) -> list[str]:
    """Return warnings about inseparable parameters."""
    found = report.significance
    if found is None or not found.overparametrised:
        return []
    sentences = found.overparametrised
    out = title(f"Overparametrised: not distinguishable, correlations from {found.limit:g}")
    for sentence in sentences[:MAX_WARNINGS_LISTED]:
        out += paragraph(sentence)
    if len(sentences) > MAX_WARNINGS_LISTED:
        out.append(
            f"  … {len(sentences) - MAX_WARNINGS_LISTED} more in {report.where('results.json')}"
        )
    return out


@dataclass(frozen=True)
class OrientationUnknown:
    """Orientation unknown of a set of directions as a row of tables."""

    station: str
    """Station."""
    set: str
    """Set of directions."""
    value: float
    """Estimate, radians."""
    sigma: float
    """Standard deviation, radians."""
    held: bool
    """Whether it was held."""


def orientations_table(report: Report) -> Table[OrientationUnknown]:
    """Return the table of the orientation unknowns of the sets of directions."""
    units, rows = report.units, []
    digits = {"dms": 2, "deg": 6, "rad": 8, "mgon": 2, "cc": 1, "arcsec": 2}.get(units.angle, 5)
    for station, chosen in report.network.orientations:
        e = report.solution.orientation(station, chosen)
        held = not report.free("orientation", f"{station}/{chosen}")
        figures = float(e.values[0]), float(e.sigmas[0])
        rows.append(OrientationUnknown(station, chosen, *figures, held))
    columns: list[Column[OrientationUnknown]] = [
        Column(title="station", value="station"),
        Column(title="set", value="set"),
        Column(
            title="orientation",
            key="value",
            value="value",
            unit=unit_of(units.angle, turn=True),
            digits=digits,
        ),
        Column(
            title="σ",
            key="sigma",
            value="sigma",
            unit=Unit(units.sigma_angle, report.radian),
            shown=lambda row: "held" if row.held else None,
            translated=True,
        ),
    ]
    return Table("orientations", rows, columns)


def orientations_section(report: Report) -> list[str]:
    """Return the section of orientation unknowns of the sets of directions."""
    made = orientations_table(report)
    if not made.rows:
        return []
    rows, note = report.cut(list(made.rows), "orientation unknowns", "unknowns.csv")
    return [*title("Orientation unknowns"), *as_text(replace(made, rows=rows)), *note]


@dataclass(frozen=True)
class UnknownComponent:
    """One component of an unknown such as refraction, a vertical or a distance meter."""

    kind: VariableKind
    """Kind of the unknown."""
    name: str
    """Name of the unknown; empty for the refraction of the network."""
    component: str
    """Component, named as in the state."""
    sign: str
    """Symbol of the component in surveying."""
    unit: str
    """Unit in which the component is shown."""
    size: float
    """Size of ``unit`` in SI."""
    value: float
    """Estimate, SI."""
    sigma: float
    """Standard deviation, SI."""
    power: int
    """Power of the unit of time by which ``unit`` is divided."""
    state: Literal["held", "weighted", "free"]
    """Whether the component was held, weighted or free."""


def unknown_components(report: Report) -> Iterator[UnknownComponent]:
    """Iterate over the components of all parameters but orientation unknowns.

    Those that are coordinates or rotations of any size are in the unit of observed values.
    """
    network, solution, units = report.network, report.solution, report.units
    shown: dict[Quantity, tuple[str, float]] = {
        "angle": (units.sigma_angle, report.radian),
        "length": (units.sigma_length, report.small),
        "ppm": ("ppm", 1e-6),
        "number": ("", 1.0),
    }
    angle = decimal_angle(units.angle)
    whole: dict[Quantity, tuple[str, float]] = {
        **shown,
        "angle": (angle, ANGLE[angle]),
        "length": (units.length, report.metre),
    }
    for kind in parameter_kinds():
        if kind.name == "orientation":
            continue  # orientation unknowns have a table of their own
        for key, parameter in network.of_kind(kind.name).items():
            name = parameter_name(key)
            e = solution.unknown(kind.name, name)
            for i, component in enumerate(kind.components[: len(parameter.values)]):
                unit, size = (whole if component.whole else shown)[component.quantity]
                yield UnknownComponent(
                    kind.name,
                    name,
                    component.name,
                    component.sign or component.name,
                    unit,
                    size,
                    float(e.values[i]),
                    float(e.sigmas[i]),
                    component.power,
                    _state(parameter, i),
                )


def _state(parameter: Parameter, i: int) -> Literal["held", "weighted", "free"]:
    if parameter.fixed[i]:
        return "held"
    return "weighted" if isfinite(parameter.sigma[i]) else "free"


def other_unknowns_section(report: Report) -> list[str]:
    """Return refraction, deflections of the vertical, distance meters and further kinds."""
    rows, shown_ones = [], []
    of_shapes = {(size.kind, size.name) for one in report.shapes for size in one.sizes}
    found = [
        u
        for u in unknown_components(report)
        if u.kind not in _APART and (u.kind, u.name) not in of_shapes
    ]
    for u in found:
        if u.state == "held" and u.value == 0 and UNKNOWNS[u.kind].size > MAX_COMPONENTS_HELD_SHOWN:
            continue
        shown_ones.append(u)
        value, sigma = u.value / u.size, u.sigma / u.size
        # A held turn keeps its component of the rotation vector only where the others are held.
        still = u.state == "held" and sigma == 0
        shown = f"{value + 0.0:.5g}" if still else with_sigma(value, sigma)
        label = f"{u.sign} [{u.unit}{_PER[u.power]}]" if u.unit else u.sign
        what = f"{UNKNOWNS[u.kind].title} {u.name}".strip()
        test = _verdict(report.tested(u.kind, u.name, u.component))
        rows.append([what, label, shown, "held" if still else short(sigma), *test])
    if not rows:
        return []
    shown_rows, note = report.cut(rows, "unknowns", "unknowns.csv")
    usual = [words for kind, words in _USUAL.items() if any(u.kind == kind for u in shown_ones)]
    further = {UNKNOWNS[u.kind].title for u in shown_ones if u.kind not in _USUAL}
    kinds = ", ".join([*usual, *sorted(further)])
    heading = title(kinds[:1].upper() + kinds[1:])
    header = ["unknown", "", "value", "σ", "t", ""]
    if not any(r[4] for r in rows):
        header, shown_rows = header[:4], [r[:4] for r in shown_rows]
    else:
        note = [*note, _meaning(report)]
    if any(u.power for u in shown_ones):
        note = [*note, "  t of units: the time or place along a strip, in the unit of observations"]
    return [*heading, *table(header, shown_rows, left=2), *note]
