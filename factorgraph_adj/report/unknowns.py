"""Calibrations, orientations, refraction, other unknowns: tables, sections; inseparable parameters.

`unknown_columns` has the figures of every unknown but points and photos: a figure that is added
there appears in the text, the page, unknowns.csv, results.json and the data frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isfinite, nan
from typing import Any, Literal, TypeAlias

from ..columns import Columns
from ..entities import Camera, Parameter, parameter_name
from ..graph.variables import camera_of_calibration
from ..models.lens import Lens
from ..models.unknown_registry import UNKNOWNS, Quantity, VariableKind, parameter_kinds
from ..quality.derived_quantities import place_of_frame
from ..quality.parameter_significance import TestedParameter
from ..solve.estimates import unknown_arrays
from ..solve.solution import Solution
from ..units import ANGLE, decimal_angle
from .adjustment_report import Report
from .frames_and_shapes import measured_frames
from .layout import paragraph, percent, title, with_sigma
from .tables import DATA, NUMBER, READ, ArrayRows, Column, Table, Unit, as_frame, as_text, unit_of

MAX_WARNINGS_LISTED = 10
"""Largest number of listed warnings."""
_USUAL = {"refraction": "refraction", "vertical": "verticals", "edm": "distance meters"}
"""Kinds that the heading of their table names first, and in what words."""
_APART = ("frame",)
"""Kinds with a table of their own in the text report."""
_POWERS = ("", "", "²")
"""What stands behind the unit of time of a component that observations multiply by a power of t."""
STRONG_CORRELATION = 0.8
"""Smallest absolute correlation of calibration parameters that is reported as strong."""
MAX_COMPONENTS_HELD_SHOWN = 2
"""Number of components of an unknown up to which those that are held at zero are shown."""
NUMBER_OF_INTERIOR_ORIENTATION = 3
"""Number of parameters, c, x0, y0, that tables of calibrations have even where they are zero."""

State: TypeAlias = Literal["held", "weighted", "free", "computed"]
"""What a component of an unknown is; computed: it follows from other unknowns."""


# -- components -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class UnknownComponent:
    """One component of an unknown besides points and photos, as a row of tables."""

    kind: VariableKind
    """Kind of the unknown."""
    name: str
    """Name of the unknown; empty for the refraction of the network."""
    component: str
    """Component, named as in the state."""
    value: float
    """Estimate, SI or image units."""
    sigma: float
    """Standard deviation, SI or image units."""
    held: bool
    """Whether the component was held."""
    state: State = "free"
    """What the component is."""
    unit: Unit = NUMBER
    """Unit in which the component is shown."""
    sign: str = ""
    """Symbol of the component in surveying."""
    given: float = nan
    """Value that was given."""
    power: int = 0
    """Power of the unit of time by which ``unit`` is divided."""
    time: str = "t"
    """Unit of time; t: that of the observations."""

    @property
    def unit_name(self) -> str:
        """Name of the unit with that of time: m/s."""
        return self.unit.name + (f"/{self.time}{_POWERS[self.power]}" if self.power else "")

    @property
    def known(self) -> bool:
        """Whether the component has no standard deviation.

        A held turn keeps its component of the rotation vector only where the others are held.
        """
        return self.held and self.sigma == 0


def _state(given: Parameter | Camera, i: int) -> State:
    if given.fixed[i]:
        return "held"
    return "weighted" if isfinite(given.sigma[i]) else "free"


def calibration_components(report: Report, name: str) -> list[UnknownComponent]:
    """Return the parameters of a calibration."""
    camera, e = camera_of_calibration(report.network, name), report.calibrations[name]
    return [
        UnknownComponent(
            "calibration",
            name,
            parameter,
            float(e.values[i]),
            float(e.sigmas[i]),
            camera.fixed[i],
            _state(camera, i),
            Unit(camera.unit),
            parameter,
            float(camera.values[i]),
        )
        for i, parameter in enumerate(e.names)
    ]


def unknown_components(report: Report) -> Iterator[UnknownComponent]:
    """Iterate over the components of all parameters but calibrations and orientation unknowns.

    Those that are coordinates or rotations of any size are in the unit of observed values.
    """
    network, solution, units = report.network, report.solution, report.units
    shown: dict[Quantity, Unit] = {
        "angle": Unit(units.sigma_angle, report.radian),
        "length": Unit(units.sigma_length, report.small),
        "ppm": Unit("ppm", 1e-6),
        "number": NUMBER,
    }
    angle = decimal_angle(units.angle)
    whole = {
        **shown,
        "angle": Unit(angle, ANGLE[angle]),
        "length": Unit(units.length, report.metre),
    }
    for kind in parameter_kinds():
        if kind.name == "orientation":
            continue  # orientation unknowns have a table of their own
        for key, parameter in network.of_kind(kind.name).items():
            name = parameter_name(key)
            e = solution.unknown(kind.name, name)
            for i, component in enumerate(kind.components[: len(parameter.values)]):
                yield UnknownComponent(
                    kind.name,
                    name,
                    component.name,
                    float(e.values[i]),
                    float(e.sigmas[i]),
                    parameter.fixed[i],
                    _state(parameter, i),
                    (whole if component.whole or component.circular else shown)[component.quantity],
                    component.sign or component.name,
                    parameter.values[i],
                    component.power,
                    component.time,
                )


def _orientation_components(report: Report) -> Iterator[UnknownComponent]:
    for (station, chosen), given in report.network.orientations.items():
        e = report.solution.orientation(station, chosen)
        yield UnknownComponent(
            "orientation",
            f"{station}/{chosen}",
            "orientation",
            float(e.values[0]),
            float(e.sigmas[0]),
            given.fixed[0],
            _state(given, 0),
            Unit("rad"),
        )


def _frame_places(report: Report) -> Iterator[UnknownComponent]:
    """Iterate over the coordinates of the places of frames in the network."""
    metre = Unit(report.units.length, report.metre)
    for name in measured_frames(report):
        place = place_of_frame(report.solution, name)
        for component, value, sigma in zip(place.names, place.values, place.sigmas, strict=True):
            state: State = "computed" if sigma > 0 else "held"
            figures = float(value), float(sigma)
            yield UnknownComponent("frame", name, component, *figures, not sigma > 0, state, metre)


# -- tables ---------------------------------------------------------------------------------------


def unknown_columns(report: Report) -> list[Column[UnknownComponent]]:
    """Return the columns of values, standard deviations and tests of unknowns."""

    def tested(u: UnknownComponent) -> TestedParameter | None:
        return report.tested(u.kind, u.name, u.component)

    def of_test(name: str) -> Callable[[UnknownComponent], float | bool | None]:
        return lambda u: getattr(tested(u), name, None)

    def read(name: str) -> Callable[[UnknownComponent], Any]:
        """Return a function for readers: c, x0, y0 without a given σ are compared with nothing."""

        def figure(u: UnknownComponent) -> Any:
            found = tested(u)
            told = found is not None and (found.additional or found.weighted)
            return getattr(found, name) if told else None

        return figure

    def verdict(u: UnknownComponent) -> str | None:
        words = {True: "significant", False: "not significant", None: None}
        return words[read("significant")(u)]

    def value(u: UnknownComponent) -> str:
        shown, sigma = u.value / u.unit.size, u.sigma / u.unit.size
        return f"{shown + 0.0:.8g}" if u.known else with_sigma(shown, sigma)

    state = Column[UnknownComponent](title="state", value="state", translated=True)
    return [
        Column(title="value", value="value", unit=_unit, shown=value, exact=True),
        Column(
            title="σ",
            key="sigma",
            value="sigma",
            unit=_unit,
            shown=lambda u: "held" if u.known else None,
            translated=True,
        ),
        Column(title="unit", value="unit_name", only=("html", "csv")),
        replace(state, only=("html", "csv")),
        Column(title="t", value=of_test("t"), only=("csv",)),
        Column(title="t", value=read("t"), digits=2, help="t", only=READ),
        replace(state, only=("text",), shown=lambda u: u.state if u.state == "weighted" else ""),
        Column(title="verdict", value=verdict, translated=True, only=READ),
        Column(title="significant", value=of_test("significant"), only=("csv",)),
        Column(title="held", value="held", only=("frame",)),
    ]


def _unit(u: UnknownComponent) -> Unit:
    return u.unit


def _named_columns(report: Report) -> list[Column[UnknownComponent]]:
    """Return the columns of tables with unknowns of several names."""

    def label(u: UnknownComponent) -> str:
        return f"{u.sign} [{u.unit_name}]" if u.unit.name else u.sign

    return [
        Column(title="unknown", value=_title, only=("text",)),
        Column(title="", value=label, only=("text",)),
        Column(
            title="kind",
            value=lambda u: UNKNOWNS[u.kind].title,
            translated=True,
            only=("html",),
        ),
        Column(title="kind", value="kind", only=DATA),
        Column(title="name", value="name", only=("html", *DATA)),
        Column(title="component", value="component", only=DATA),
        Column(title="parameter", value="sign", only=("html",)),
        *unknown_columns(report),
    ]


def _title(u: UnknownComponent) -> str:
    return f"{UNKNOWNS[u.kind].title} {u.name}".strip()


def others_table(report: Report) -> Table[UnknownComponent]:
    """Return the table of all unknowns but points, photos, calibrations and orientations."""
    return Table("others", list(unknown_components(report)), _named_columns(report))


def unknowns_table(report: Report) -> Table[UnknownComponent]:
    """Return the table of all unknowns but points and photos, and of the places of frames."""
    calibrations = [u for name in report.calibrations for u in calibration_components(report, name)]
    further = (*_orientation_components(report), *unknown_components(report))
    rows = [*calibrations, *further, *_frame_places(report)]
    return Table("unknowns", rows, _named_columns(report))


def unknown_frame(solution: Solution) -> Columns:
    """Return all unknowns but points and photos as arrays, in the axes of the network."""
    rows = ArrayRows.of(UnknownComponent, **unknown_arrays(solution))
    return as_frame(Table("unknowns", rows, _named_columns(Report(solution))))


def calibration_table(report: Report, name: str) -> Table[UnknownComponent]:
    """Return the table of a calibration."""

    def change(u: UnknownComponent) -> float | None:
        known = u.held or not u.sigma > 0
        return None if known else (u.value - u.given) / u.sigma

    value, sigma, _, *others = unknown_columns(report)
    moved = Column[UnknownComponent](
        title="change", value=change, digits=1, help="change", only=("html",)
    )
    parameter = Column[UnknownComponent](title="parameter", key="parameters", value="component")
    # One unit is that of the image; objects of JSON have lists.
    columns = [parameter, replace(value, key="values"), sigma, moved, *others]
    return Table("calibration", calibration_components(report, name), columns)


def without_absent(made: Table[UnknownComponent], lens: Lens) -> Table[UnknownComponent]:
    """Return a calibration without distortions held at zero, and held ones as they were given."""
    rows = [
        u
        for i, u in enumerate(made.rows)
        if not u.held
        or i < NUMBER_OF_INTERIOR_ORIENTATION
        or (u.value != 0 and u.component not in lens.given)
    ]
    return replace(made, rows=rows)


# -- sections -------------------------------------------------------------------------------------


def calibrations_section(report: Report) -> list[str]:
    """Return each calibration with standard deviations and strong correlations."""
    names, few = list(report.calibrations), max(1, report.options.most // 10)
    out: list[str] = []
    for name in names[:few]:
        out += ["", *_calibration(report, name)]
    if len(names) > few:
        out += ["", f"  … {len(names) - few} more calibrations in {report.where('unknowns.csv')}"]
    return out[1:]


def _calibration(report: Report, name: str) -> list[str]:
    estimate, camera = report.calibrations[name], camera_of_calibration(report.network, name)
    free = [i for i, held in enumerate(camera.fixed) if not held]
    strong = [
        f"{estimate.names[i]}–{estimate.names[j]} {estimate.correlation[i, j]:+.2f}"
        for k, i in enumerate(free)
        for j in free[k + 1 :]
        if abs(estimate.correlation[i, j]) >= STRONG_CORRELATION
    ]
    out = title(f"Calibration of {name} (lens model {camera.lens.kind}; image unit {camera.unit})")
    shown = as_text(without_absent(calibration_table(report, name), camera.lens))
    out += shown
    if len(free) > 1:
        out.append(f"  correlations from {STRONG_CORRELATION}: {', '.join(strong) or 'none'}")
    return [*out, *_meaning(report, shown)]


def _meaning(report: Report, shown: list[str]) -> list[str]:
    """Return what t and its verdict are, if the lines of a table show them."""
    found = report.significance
    if found is None or "verdict" not in shown[0]:
        return []
    return [
        f"  t against 0, or what was given if weighted: significant from {found.critical:.2f} "
        f"({percent(1 - found.alpha)})"
    ]


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


def other_unknowns_section(report: Report) -> list[str]:
    """Return refraction, deflections of the vertical, distance meters and further kinds."""
    of_shapes = {(size.kind, size.name) for one in report.shapes for size in one.sizes}

    def listed(u: UnknownComponent) -> bool:
        absent = u.held and u.value == 0 and UNKNOWNS[u.kind].size > MAX_COMPONENTS_HELD_SHOWN
        return u.kind not in _APART and (u.kind, u.name) not in of_shapes and not absent

    made = others_table(report)
    rows = [u for u in made.rows if listed(u)]
    if not rows:
        return []
    some, note = report.cut(rows, "unknowns", "unknowns.csv")
    usual = [words for kind, words in _USUAL.items() if any(u.kind == kind for u in rows)]
    further = {UNKNOWNS[u.kind].title for u in rows if u.kind not in _USUAL}
    kinds = ", ".join([*usual, *sorted(further)])
    shown = as_text(replace(made, rows=some))
    note = [*note, *_meaning(report, shown)]
    if any(u.power and u.time == "t" for u in rows):
        note = [*note, "  t of units: the time or place along a strip, in the unit of observations"]
    return [*title(kinds[:1].upper() + kinds[1:]), *shown, *note]
