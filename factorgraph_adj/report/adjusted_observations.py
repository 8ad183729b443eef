"""Table of all observations, as text by station, CSV and arrays; section of weighted coordinates.

`observation_table` is the one table of observations: its listing station by station, the pages,
observations.csv, results.json and data frames are renderings of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from math import isfinite, log10, sqrt
from typing import Any

import numpy as np

from ..columns import Columns
from ..graph.blocks import Block
from ..quality.reliability import Reliability
from ..units import decimal
from .adjustment_report import Report
from .layout import decimals, paragraph, short, title
from .observation_rows import POINT_COLUMNS, Row, identity_columns
from .rejected_observations import RejectedObservations
from .tables import DATA, ArrayRows, Column, FiguresByNumber, Table, Unit, as_csv, as_frame, as_text

ROUNDING_OF_REDUNDANCY = 1e-9
"""Redundancy number below which there is nothing but rounding."""


def test_symbol(report: Report) -> str:
    """Return the symbol of the test values of a report."""
    return "τ" if report.pope else "w"


# -- the table of observations --------------------------------------------------------------------


def observation_table(report: Report, rows: Sequence[Row] | None = None) -> Table[Row]:
    """Return the table of observations; a column that is added here appears in every rendering.

    Args:
        report: the report.
        rows: rows of the solution, in their order; None: all.
    """
    chosen = report.rows.all() if rows is None else rows
    of = ObservationColumns(report, chosen)
    return Table("observations", chosen, (*of.station_by_station(), *of.every_rendering()))


class ObservationColumns:
    """Columns of scalar observations, from which every table of them is made."""

    def __init__(self, report: Report, rows: Sequence[Row]) -> None:
        """Refer to rows of the report, which determine the decimals."""
        self.report = report
        self.rows = rows

    # What follows from all rows together waits until a rendering asks for it.

    @cached_property
    def _places(self) -> dict[str, tuple[int, int]]:
        return decimals_by_unit(self.rows)

    @cached_property
    def _begun(self) -> set[int]:
        """Numbers of the rows at which a station begins."""
        before = [None, *self.rows][:-1]
        return {
            row.number
            for row, last in zip(self.rows, before, strict=True)
            if last is None or row.names[:1] != last.names[:1]
        }

    @cached_property
    def _identities(self) -> dict[str, dict[int, str]]:
        """The columns that identify the rows, by the number of the row."""
        numbers = [row.number for row in self.rows]
        cells = identity_columns(self.rows)
        return {n: dict(zip(numbers, v, strict=True)) for n, v in cells.items()}

    def every_rendering(self) -> list[Column[Row]]:
        """Return the columns of all renderings; text has those of `station_by_station` before."""
        found = [*self.identity(), *self.values(), *self.figures()]
        if self.report.snooping is not None:
            found.append(Column(title="set_aside", value=lambda row: False, only=("csv",)))
        source = Column[Row](title="source", value=_source, only=("html", "csv", "json"))
        return [*found, source]

    def station_by_station(self) -> list[Column[Row]]:
        """Return the identity of observations between points in text, each station once."""
        station = "station_frame" if any(r.frame for r in self.rows) else "station"

        def first(row: Row) -> str:
            return row.names[0] if row.names and row.number in self._begun else ""

        return [
            Column(title=station, value=first, only=("text",)),
            Column(title="target", value=lambda row: " ".join(row.names[1:]), only=("text",)),
            Column(
                title="observation",
                value=lambda row: row.with_component(row.kind_name),
                only=("text",),
            ),
        ]

    def identity(self) -> list[Column[Row]]:
        """Return kind, name and id as a page has them, and the columns of tables of a project."""

        def place(name: str) -> Callable[[Row], str]:
            return lambda row: self._identities[name][row.number]

        written: dict[str, str | Callable[[Row], str]]
        written = {"id": "id", "kind": "kind", **{n: place(n) for n in POINT_COLUMNS}}
        written |= {n: n for n in ("photo", "frame", "component")}
        framed = ("id", "kind", "component")
        return [
            Column(title="observation", value="what", only=("html",)),
            Column(title="kind", value="kind_name", only=("html",), translated=True),
            Column(title="id", value="own_id", only=("html",)),
            *(
                Column(title=n, value=v, only=DATA if n in framed else ("csv", "json"))
                for n, v in written.items()
            ),
        ]

    def values(self) -> list[Column[Row]]:
        """Return observed and adjusted values, residuals and standard deviations."""
        return [
            Column(
                title="observed",
                value="observed",
                unit=_whole,
                digits=self._coarse,
                exact=True,
                with_unit=True,
                only=("text", "html", "csv", "json"),
            ),
            Column(title="unit", value=lambda row: row.scale.unit, only=("html", "csv")),
            self.residual(digits=self._fine, with_unit=True, only=("text",)),
            self.residual(only=("html", *DATA)),
            Column(
                title="adjusted",
                value="adjusted",
                unit=_whole,
                digits=self._coarse,
                help="adjusted",
                exact=True,
                only=("text", "html", "csv", "json"),
            ),
            self.sigma(),
            Column(title="small_unit", value=lambda row: row.scale.small, only=("html", "csv")),
            Column(
                title="v/σ",
                key="normalised",
                value=lambda row: row.residual / row.sigma,
                digits=2,
                help="normalised",
                only=("html", "csv") if self.report.reliability is None else ("csv",),
            ),
        ]

    def residual(self, **options: Any) -> Column[Row]:
        """Return v."""
        return Column(title="v", key="residual", value="residual", unit=_fine, help="v", **options)

    def sigma(self) -> Column[Row]:
        """Return σ a priori."""
        return Column(title="σ", key="sigma", value="sigma", unit=_fine, help="sigma")

    def figures(self) -> list[Column[Row]]:
        """Return the figures of quality; none without reliability."""
        rel, report = self.report.reliability, self.report
        if rel is None:
            return []
        shares = (("e1", rel.e1), ("e2", lambda: rel.e2), ("e12", lambda: rel.e12))
        small = report.units.sigma_length
        largest = Column[Row](
            title="effect",
            key="largest_effect",
            suffix=True,
            value=FiguresByNumber(rel.largest_effect),
            unit=Unit(small, report.small),
            only=("csv", "frame"),
        )
        controlled = Column[Row](
            title="controlled", value=FiguresByNumber(rel.controlled), only=DATA
        )
        return [
            self.redundancy_number(rel),
            *(Column(title=n, value=FiguresByNumber(v), only=("csv",)) for n, v in shares),
            replace(self.test(), only=("text",)),
            replace(self.test(), shown=None, only=("html",)),
            Column(title="w", value=FiguresByNumber(rel.w, signed=True), only=DATA),
            Column(title="τ", key="tau", value=FiguresByNumber(rel.tau, signed=True), only=DATA),
            self.detectable(rel),
            Column(
                title="δ̄",
                key="delta_bar",
                value=FiguresByNumber(rel.delta_bar),
                only=("csv", "frame"),
            ),
            largest,
            replace(self.error(rel), only=("html", *DATA)),
            controlled,
        ]

    def redundancy_number(self, rel: Reliability) -> Column[Row]:
        """Return r."""
        value = FiguresByNumber(rel.redundancy_numbers)
        return Column(
            title="r",
            key="redundancy_number",
            frame_key="r",
            value=value,
            shown=lambda row: redundancy_text(value(row)),
            digits=2,
            help="r",
        )

    def test(self) -> Column[Row]:
        """Return the test value of the report; a star stands at critical ones."""
        values, critical = self.report.tests
        value = FiguresByNumber(values, signed=True)

        def starred(row: Row) -> str | None:
            found = value(row)
            return f"{decimal(found, 2)} *" if abs(found) > critical else None

        symbol = test_symbol(self.report)
        return Column(title=symbol, value=value, digits=2, shown=starred, help="test")

    def detectable(self, rel: Reliability, **options: Any) -> Column[Row]:
        """Return ∇, the smallest detectable error; none of what cannot be tested."""
        tests = self.report.tests[0]

        def shown(row: Row) -> str | None:
            return None if isfinite(tests[row.number]) else ""

        value = FiguresByNumber(rel.mdb)
        return Column(
            title="∇", key="mdb", value=value, unit=_fine, shown=shown, help="mdb", **options
        )

    def error(self, rel: Reliability, **options: Any) -> Column[Row]:
        """Return the estimated error."""
        return Column(
            title="error",
            key="estimated_error",
            value=FiguresByNumber(rel.estimated_errors, signed=True),
            unit=_fine,
            help="error",
            **options,
        )

    def _coarse(self, row: Row) -> int:
        """Return the decimals of a value."""
        coarse, fine = self._places[row.scale.small]
        return fine + round(-log10(row.scale.size)) if row.scale.image else coarse

    def _fine(self, row: Row) -> int:
        """Return the decimals of v."""
        return self._places[row.scale.small][1]


def _whole(row: Row) -> Unit:
    return row.scale.whole(turn=row.circular)


def _fine(row: Row) -> Unit:
    return row.scale.fine


def _source(row: Row) -> str:
    return row.source


def observations_csv(report: Report) -> str:
    """Return observations.csv: all figures of each observation; rejected ones are at the end."""
    made, aside = observation_table(report), report.set_aside
    return as_csv(made) if aside is None else as_csv(made, _rejected_table(aside))


def observation_frame(rel: Reliability, numbers: Sequence[int] | None = None) -> Columns:
    """Return the figures of observations as arrays, SI or image units, in the network's axes.

    Args:
        rel: the reliability of a solution.
        numbers: numbers of rows; None: all.
    """
    report = Report(rel.solution, known=rel)
    rows: Sequence[Row]
    if numbers is None:
        table = rel.solution.observations
        text = {"id": table.ids, "kind": table.kinds, "component": table.components}
        fields = {n: np.array(v, dtype=object) for n, v in text.items()}
        fields |= {"residual": table.residuals.copy(), "sigma": table.sigmas.copy()}
        fields |= {"number": np.arange(len(table)), "sign": np.ones(len(table))}
        rows = ArrayRows(fields, lambda: [_in_network(r) for r in report.rows.all()])
    else:
        rows = [_in_network(r) for r in report.rows.at(numbers)]
    return as_frame(Table("observations", rows, ObservationColumns(report, rows).every_rendering()))


def _in_network(row: Row) -> Row:
    """Return a row in the axes of the network."""
    if row.sign == 1.0:
        return row
    observed, residual = row.sign * row.observed, row.sign * row.residual
    return replace(row, observed=observed, residual=residual, sign=1.0)


def _rejected_table(aside: RejectedObservations) -> Table[Row]:
    """Return the rejected observations, which the clean solution predicts."""
    rows = aside.rows.at(aside.numbers.tolist())
    place = {row.number: i for i, row in enumerate(rows)}
    cells = identity_columns(rows)

    def at(values: Any, of: Callable[[Row], float] = lambda row: 1.0) -> Callable[[Row], Any]:
        every = values.tolist()
        return lambda row: of(row) * every[place[row.number]]

    def sign(row: Row) -> float:
        return row.sign

    innovation = at(aside.innovation, sign)
    known = {"value": "adjusted", "unit": _whole, "exact": True}
    columns: list[Column[Row]] = [
        *(
            Column(title=n, value=lambda row, v=v: v[place[row.number]])  # type: ignore[misc]
            for n, v in cells.items()
        ),
        Column(title="residual", value=innovation, unit=_fine),
        Column(title="adjusted", **known),  # type: ignore[arg-type]
        Column(title="sigma", value="sigma", unit=_fine),
        Column(title="small_unit", value=lambda row: row.scale.small),
        Column(title="normalised", value=lambda row: innovation(row) / row.sigma),
        Column(title="redundancy_number", value=at(aside.redundancy_numbers)),
        Column(title="w", value=at(aside.w, sign)),
        Column(title="estimated_error", value=lambda row: -innovation(row), unit=_fine),
        Column(title="controlled", value=lambda row: isfinite(aside.w[place[row.number]])),
        Column(title="set_aside", value=lambda row: True),
        Column(title="source", value=_source),
    ]
    return Table("rejected", rows, columns)


# -- station by station ---------------------------------------------------------------------------


def adjusted_observations_section(report: Report) -> list[str]:
    """Return observed values, corrections and adjusted values, station by station."""
    numbers = _by_station(report)
    if not numbers:
        return []
    some, note = report.cut(numbers, "adjusted observations", "observations.csv")
    made = observation_table(report, report.rows.at(some))
    name = test_symbol(report)
    words = "v = adjusted − observed; σ a priori, in the unit of v"
    shown = as_text(made)
    if report.reliability is not None and "∇" in shown[0]:
        words += ", as is ∇, the smallest detectable error"
    if any("*" in line for line in shown):
        words += f"; *: |{name}| above its critical value {report.tests[1]:.2f}"
    if any(b.image for b in report.solution.equations.blocks):
        words += f"; image coordinates: {report.where('observations.csv')}"
    heading = title("Adjusted observations, station by station")
    return [*heading, *shown, *note, *paragraph(words)]


def lists_every_observation(report: Report) -> bool:
    """Return whether the list of observations shows every scalar observation of the network."""
    blocks, most = report.solution.equations.blocks, report.options.most
    return len(report.rows) <= most and all(_between_points(b) for b in blocks)


def redundancy_text(r: float) -> str:
    """Write a redundancy number with two decimals, small ones with three digits."""
    return decimal(r, 2) if r >= 0.1 or r < ROUNDING_OF_REDUNDANCY else short(r)


def _by_station(report: Report) -> list[int]:
    """Return the rows of observations between points, by station in order of appearance."""
    rows: dict[str, list[int]] = {}
    for block in report.solution.equations.blocks:
        if _between_points(block):
            for i, row in enumerate(range(block.rows.start, block.rows.stop)):
                rows.setdefault(block.ids[i // block.dimension], []).append(row)
    stations: dict[str, list[int]] = {}
    for ident, observation in report.network.observations.items():
        if ident in rows:
            stations.setdefault(observation.names()[0], []).extend(rows[ident])
    return [row for group in stations.values() for row in group]


def _between_points(block: Block) -> bool:
    return not block.prior and not block.image and not block.by_axis


def decimals_by_unit(rows: Iterable[Row]) -> dict[str, tuple[int, int]]:
    """Return by small unit the decimals of values and of v: two digits of the smallest σ."""
    sizes: dict[str, list[float]] = {}
    whole: dict[str, int] = {}
    for row in rows:
        sizes.setdefault(row.scale.small, []).append(row.sigma / row.scale.size)
        whole[row.scale.small] = row.scale.further_decimals
    out = {}
    for unit, sigmas in sizes.items():
        fine = decimals([min(sigmas)], default=2, most=5)
        out[unit] = min(max(fine + whole[unit], 0), 12), fine
    return out


# -- weighted coordinates -------------------------------------------------------------------------


def weighted_coordinates_section(report: Report) -> list[str]:
    """Return given coordinates with σ: their corrections, and σ before and after."""
    found = {
        number: sigma
        for block in report.solution.equations.blocks
        if block.by_axis
        for number, sigma in enumerate(_sigma_after(report, block), start=block.first_row)
    }
    if not found:
        return []
    some, note = report.cut(list(found), "weighted coordinates", "observations.csv")
    rows = report.rows.at(some)
    length, small = (
        Unit(report.units.length, report.metre),
        Unit(report.units.sigma_length, report.small),
    )
    of = ObservationColumns(report, rows)

    def local(row: Row) -> str | None:
        # Along east, north and up the given value is the origin: only its correction has a number.
        return "" if row.component in ("e", "n", "u") else None

    given = {"unit": length, "digits": of._coarse, "shown": local}
    columns: list[Column[Row]] = [
        Column(title="point", value=lambda row: _place(row)[0]),
        Column(title="", value=lambda row: _place(row)[1]),
        Column(title="given", value="observed", **given),  # type: ignore[arg-type]
        Column(title="correction", value="residual", unit=small, digits=of._fine),
        Column(title="adjusted", value="adjusted", **given),  # type: ignore[arg-type]
        Column(title="σ given", value="sigma", unit=small),
        Column(title="σ adjusted", value=lambda row: found[row.number], unit=small),
    ]
    if report.reliability is not None:
        columns.append(replace(of.test(), shown=None))
    out = title("Weighted coordinates: corrections adjusted − given, σ before and after")
    return [*out, *as_text(Table("control", rows, columns)), *note]


def _sigma_after(report: Report, block: Block) -> list[float]:
    """Return σ of the adjusted points along the axes of a block's rows, metres."""
    axis = block.constants["axis"]
    covariance = report.solution.point_covariances[block.variables[0][1]]
    variance = np.einsum("ni,nij,nj->n", axis, covariance, axis)
    return [sqrt(max(v, 0.0)) for v in variance.tolist()]


def _place(row: Row) -> list[str]:
    """Return point and component of a weighted coordinate, which may be an observation."""
    if row.names:
        return [row.names[0], f"{row.component} ({row.kind_name})"]
    name = row.id.removeprefix("point ").removesuffix(f" {row.component}")
    return [name, row.component]
