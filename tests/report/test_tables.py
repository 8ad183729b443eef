"""A table is written once: what a column says, every rendering says."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.report import adjusted_photos, adjusted_points, unknowns
from factorgraph_adj.report.adjusted_observations import (
    ObservationColumns,
    observation_frame,
    observations_csv,
)
from factorgraph_adj.report.adjusted_photos import AdjustedPhoto, photos_table
from factorgraph_adj.report.adjusted_points import AdjustedPoint, points_table
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.catalogue import Texts
from factorgraph_adj.report.html.page import adjustment_html
from factorgraph_adj.report.observation_rows import ReportRows
from factorgraph_adj.report.results_json import results_text
from factorgraph_adj.report.tables import (
    ArrayRows,
    Column,
    FiguresByNumber,
    Table,
    Unit,
    as_csv,
    as_frame,
    as_html,
    as_json,
    as_json_by_name,
    as_json_columns,
    as_text,
    unit_of,
)
from factorgraph_adj.report.text import text_report
from factorgraph_adj.report.unknowns import unknowns_table
from tests.networks.exchanged_day import day
from tests.networks.pixel_block import pixel_block
from tests.networks.small_block import small_block
from tests.networks.trilateration import trilateration
from tests.support.described import assert_only_added
from tests.support.pages import data_of
from tests.support.printed import row, section

MM = Unit("mm", 1e-3)


def test_a_figure_of_quality_that_is_added_appears_in_every_rendering(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The column is that of CONTRIBUTING: inner reliability, ∇/σ."""
    before = ObservationColumns.figures

    def with_inner_reliability(self: ObservationColumns) -> list[Column]:
        rel = self.report.reliability
        assert rel is not None
        inner = rel.mdb / rel.solution.equations.sigmas()
        value = lambda row: inner[row.number]  # noqa: E731
        return [*before(self), Column(title="∇/σ", key="inner_reliability", value=value, digits=3)]

    monkeypatch.setattr(ObservationColumns, "figures", with_inner_reliability)
    solution = fga.adjust(trilateration(1, points=6)[0])
    report, rel = Report(solution), fga.reliability(solution)
    expected = rel.delta0 / np.sqrt(rel.redundancy_numbers)
    read = [f"{v:.3f}" for v in expected]

    text = text_report(solution)
    listing = text[text.index("Adjusted observations") :].splitlines()[2:]
    assert listing[0].split()[-1] == "∇/σ"
    assert {line.split()[-1] for line in listing[2 : 2 + len(read)]} == set(read)

    page = adjustment_html(report)
    assert ">∇/σ</th>" in page
    assert read in data_of(page, "sheet-observations")["columns"]

    header, *rows = observations_csv(report).splitlines()
    at = header.split(",").index("inner_reliability")
    assert [float(r.split(",")[at]) for r in rows] == pytest.approx(expected)

    results = json.loads(results_text(report))
    assert_only_added(results, "inner_reliability")
    assert results["observations"]["inner_reliability"] == pytest.approx(expected)

    table = rel.table()
    assert table["inner_reliability"] == pytest.approx(expected)
    assert "<th>inner_reliability</th>" in table._repr_html_()
    assert "<th>inner_reliability</th>" in rel._repr_html_()


def test_a_figure_of_points_that_is_added_appears_in_every_rendering(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The column is the mean standard deviation of a coordinate, the Helmert point error / √3."""
    before = adjusted_points.point_columns

    def with_mean_error(report: Report, rows: Sequence[AdjustedPoint]) -> list[Column]:
        mean = np.sqrt(np.trace(report.solution.point_covariances, axis1=1, axis2=2) / 3)
        value = lambda row: mean[row.number]  # noqa: E731
        added = Column(title="σP", key="mean_error", value=value, unit=MM, digits=4)
        return [*before(report, rows), added]

    monkeypatch.setattr(adjusted_points, "point_columns", with_mean_error)
    solution = fga.adjust(trilateration(1, points=6)[0])
    report = Report(solution)
    sigmas = [solution.standard_deviations(n) for n in solution.network.points]
    expected = np.sqrt(np.mean(np.square(sigmas), axis=1))
    read = [f"{v / 1e-3:.4f}" for v in expected]

    text = text_report(solution)
    listing = text[text.index("Adjusted coordinates") :].splitlines()[2:]
    assert listing[0].split()[-2:] == ["σP", "[mm]"]
    assert [line.split()[-1] for line in listing[2 : 2 + len(read)]] == read

    page = adjustment_html(report)
    assert ">σP [mm]</th>" in page
    assert read in data_of(page, "sheet-points")["columns"]

    header, *rows = as_csv(points_table(report)).splitlines()
    at = header.split(",").index("mean_error")
    assert [float(r.split(",")[at]) for r in rows] == pytest.approx(expected / 1e-3)

    results = json.loads(results_text(report))
    assert_only_added(results, "mean_error")
    assert [p["mean_error"] for p in results["points"].values()] == pytest.approx(expected)

    table = solution.point_table()
    assert table["mean_error"] == pytest.approx(expected)
    assert "<th>mean_error</th>" in table._repr_html_()


def test_a_figure_of_photos_that_is_added_appears_in_every_rendering(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The column is the mean standard deviation of a coordinate of the projection centre."""
    before = adjusted_photos.photo_columns

    def mean(report: Report, name: str) -> float:
        return float(np.sqrt(np.trace(report.solution.pose_covariance(name)[3:, 3:]) / 3))

    def with_mean_error(report: Report) -> list[Column]:
        value = lambda row: mean(report, row.name)  # noqa: E731
        added = Column(title="σP", key="mean_error", value=value, unit=MM, digits=4)
        return [*before(report), added]

    monkeypatch.setattr(adjusted_photos, "photo_columns", with_mean_error)
    solution = fga.adjust(small_block())
    report = Report(solution)
    sigmas = [solution.pose(n).sigmas[3:] for n in solution.network.photos]
    expected = np.sqrt(np.mean(np.square(sigmas), axis=1))
    read = [f"{v / 1e-3:.4f}" for v in expected]

    text = text_report(solution)
    listing = text[text.index("Photos\n------") :].splitlines()[2:]
    assert listing[0].split()[-2:] == ["σP", "[mm]"]
    # Below each line stand the standard deviations of its figures.
    assert [line.split()[-1] for line in listing[2 : 2 + 2 * len(read) : 2]] == read

    page = adjustment_html(report)
    assert ">σP [mm]</th>" in page
    assert read in data_of(page, "sheet-photos")["columns"]

    header, *rows = as_csv(photos_table(report)).splitlines()
    at = header.split(",").index("mean_error")
    assert [float(r.split(",")[at]) for r in rows] == pytest.approx(expected / 1e-3)

    results = json.loads(results_text(report))
    assert_only_added(results, "mean_error")
    assert [p["mean_error"] for p in results["photos"].values()] == pytest.approx(expected)
    assert solution.photo_table()["mean_error"] == pytest.approx(expected)


def test_a_figure_of_unknowns_that_is_added_appears_in_every_rendering(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The column is the relative standard deviation of a parameter, in per mille."""
    before = unknowns.unknown_columns

    def with_relative_sigma(report: Report) -> list[Column]:
        value = lambda u: u.sigma / abs(u.value) if u.value else None  # noqa: E731
        per_mille = Unit("‰", 1e-3)
        added = Column(title="σ/x", key="relative_sigma", value=value, unit=per_mille, digits=4)
        return [*before(report), added]

    monkeypatch.setattr(unknowns, "unknown_columns", with_relative_sigma)
    network = small_block()
    network.set_distance_meter("EDM", scale=2e-6, free=["scale"])
    for name, o in network.observations.items():
        if o.kind == "slope_distance":
            network.observations[name] = replace(o, instrument="EDM")
    solution = fga.adjust(network)
    report = Report(solution)
    focal, scale = solution.calibration("D3"), solution.unknown("edm", "EDM")
    expected = {
        ("calibration", "D3", "c"): focal.sigma("c") / abs(focal["c"]),
        ("edm", "EDM", "scale"): scale.sigma("scale") / abs(scale["scale"]),
    }
    read = [f"{v / 1e-3:.4f}" for v in expected.values()]

    text = text_report(solution)
    assert row(text, "Calibration of D3", "c")[-1] == read[0]
    (of_edm,) = (words for words in section(text, "Distance meters") if "scale" in words)
    assert of_edm[-1] == read[1]

    page = adjustment_html(report)
    assert page.count(">σ/x [‰]</th>") == 2
    for sheet, cell in zip(("sheet-calibration-0", "sheet-others"), read, strict=True):
        assert cell in data_of(page, sheet)["columns"][-1]

    header, *rows = as_csv(unknowns_table(report)).splitlines()
    cells = [dict(zip(header.split(","), r.split(","), strict=True)) for r in rows]
    for label, figure in expected.items():
        (found,) = (c for c in cells if (c["kind"], c["name"], c["component"]) == label)
        assert float(found["relative_sigma"]) == pytest.approx(figure / 1e-3)

    written = json.loads(results_text(report))
    assert_only_added(written, "relative_sigma")
    of_camera = written["calibrations"]["D3"]
    at = of_camera["parameters"].index("c")
    (scale_written,) = (u for u in written["others"] if u["component"] == "scale")
    figures = [of_camera["relative_sigma"][at], scale_written["relative_sigma"]]
    assert figures == pytest.approx(list(expected.values()))

    table = solution.unknown_table()
    labels = list(zip(table["kind"], table["name"], table["component"], strict=True))
    for label, figure in expected.items():
        assert table["relative_sigma"][labels.index(label)] == pytest.approx(figure)
    assert "<th>relative_sigma</th>" in table._repr_html_()


def test_a_page_of_a_solution_without_a_covariance_has_coordinates_alone() -> None:
    solution = fga.adjust(day(3).network)
    page = adjustment_html(Report(solution))
    assert Report(solution).singular
    assert ">x [m]</th>" in page
    assert ">σx [mm]</th>" not in page
    names = data_of(page, "sheet-points")["columns"][0]
    assert names == list(solution.network.points)


@pytest.mark.parametrize(
    "network",
    [
        trilateration(1, points=6)[0],
        pixel_block(),
    ],
    ids=["distances", "images"],
)
def test_a_frame_of_all_observations_is_that_of_its_rows_without_an_object_for_each(
    network: fga.Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    rel = fga.reliability(fga.adjust(network))
    by_row = observation_frame(rel, range(len(rel.w)))
    made = Mock(side_effect=AssertionError("a row was made"))
    monkeypatch.setattr(ReportRows, "_of_block", made)
    frame = rel.table()
    assert list(frame) == list(by_row)
    for name in frame:
        assert frame[name].dtype == by_row[name].dtype
        if frame[name].dtype == object:
            assert frame[name].tolist() == by_row[name].tolist()
        else:
            assert frame[name].tobytes() == by_row[name].tobytes()


@pytest.mark.parametrize("row", [AdjustedPoint, AdjustedPhoto])
def test_frames_of_points_and_photos_need_no_object_for_each(
    row: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    solution = fga.adjust(small_block())
    made = Mock(side_effect=AssertionError("a row was made"))
    monkeypatch.setattr(row, "__init__", made)
    assert solution.point_table()["name"].tolist() == list(solution.network.points)
    assert solution.photo_table()["camera"].tolist() == ["D3"] * len(solution.network.photos)


def test_a_frame_of_observations_does_not_compute_what_it_does_not_have() -> None:
    rel = fga.reliability(fga.adjust(trilateration(1, points=6)[0]))
    rel.table()
    assert "e2" not in vars(rel)
    assert "e2" in observations_csv(Report(rel.solution, known=rel)).splitlines()[0].split(",")
    assert "e2" in vars(rel)


def test_cells_of_rows_are_their_array() -> None:
    rows = numbered_rows([2, 0])
    figures = np.array([1.0, 2.0, -0.0])
    plain, signed = FiguresByNumber(figures), FiguresByNumber(lambda: figures, signed=True)
    for value in (plain, signed):
        column = Column[Any](title="w", value=value)
        assert column.array(rows).tobytes() == np.array([column.of(r) for r in rows]).tobytes()
    fields = {"number": np.array([2, 0]), "sign": np.array([-1.0, 1.0])}
    lazy = ArrayRows(fields, lambda: rows)
    other = Column[Any](title="n", value=lambda row: row.number + 1)
    assert other.array(lazy).tolist() == [3, 1]
    assert Column[Any](title="s", value="sign").array(lazy).tolist() == [-1.0, 1.0]
    assert len(lazy) == 2
    assert lazy[0] is rows[0]


def numbered_rows(numbers: list[int]) -> list[SimpleNamespace]:
    """Rows with a number, of which the first has an axis that points the other way."""
    return [SimpleNamespace(number=n, sign=1.0 if i else -1.0) for i, n in enumerate(numbers)]


def points() -> Table[dict[str, object]]:
    """Two points, one of which is held."""
    return Table(
        "points",
        [{"name": "A", "x": 1.5, "s": 0.0, "n": 3}, {"name": "B", "x": -0.0, "s": 0.0123, "n": 0}],
        [
            Column(title="point", key="name", value="name"),
            Column(title="x", value="x", unit=Unit("m"), digits=2, exact=True),
            Column(
                title="σx",
                key="sigma_x_mm",
                frame_key="sigma_x",
                value="s",
                unit=MM,
                digits=1,
                shown=lambda row: None if row["s"] else "held",
            ),
            Column(title="number", value="n"),
            Column(title="reason", value=lambda row: None),
        ],
    )


def test_objects_by_name_lack_what_does_not_exist() -> None:
    assert as_json_by_name(points())["A"] == {"x": 1.5, "sigma_x_mm": 0.0, "number": 3}


def test_resolved_figures_of_csv_have_no_zeros_at_their_end() -> None:
    values = [0.25, 1 / 3, np.pi]
    for unit, cells in (
        (unit_of("mm"), ["250", "333.33333", "3141.59265"]),
        (unit_of("dms"), ["14-19-26.20156", "19-05-54.93542", "180-00-0"]),
    ):
        made = Column[float](title="x", value=lambda row: row, unit=unit, resolved=5)
        assert [made.written(v) for v in values] == cells


def test_degrees_minutes_seconds_are_no_numbers_on_a_page() -> None:
    for unit, numeric in (("dms", False), ("deg", True)):
        made = as_html(
            Table("points", [0.1], [Column(title="x", value=lambda row: row, unit=unit_of(unit))]),
            Texts("en"),
        )
        assert made is not None
        assert made.columns[0].numeric is numeric


def test_text_has_units_in_headings_and_no_empty_column() -> None:
    assert as_text(points()) == [
        "  point  x [m]  σx [mm]  number",
        "  -----------------------------",
        "  A       1.50     held       3",
        "  B       0.00     12.3       0",
    ]


def test_csv_keeps_the_digits_that_text_rounds() -> None:
    assert as_csv(points()).splitlines() == ["name,x,sigma_x_mm,number", "A,1.5,0,3", "B,0,12.3,0"]


def test_further_tables_of_csv_fill_the_columns_of_the_first() -> None:
    more = Table("more", [7], [Column(title="number", value=lambda row: row)])
    assert as_csv(points(), more).splitlines()[-1] == ",,,7"


def test_json_and_frames_have_the_units_of_the_solution() -> None:
    assert as_json(points())[1] == {
        "name": "B", "x": -0.0, "sigma_x_mm": 0.0123, "number": 0, "reason": None
    }  # fmt: skip
    assert as_json_columns(points())["x"] == [1.5, -0.0]
    frame = as_frame(points())
    assert list(frame) == ["name", "x", "sigma_x", "number", "reason"]
    assert frame["sigma_x"].tolist() == [0.0, 0.0123]
    assert frame["name"].dtype == object


def test_a_page_has_its_language_and_drops_empty_columns() -> None:
    made = as_html(points(), Texts("de"))
    assert made is not None
    assert [c.title for c in made.columns] == ["Punkt", "x [m]", "σx [mm]", "Anzahl"]
    assert [c.numeric for c in made.columns] == [False, True, True, True]
    assert as_html(Table("points", [], points().columns), Texts("en")) is None


def test_figures_of_a_page_align_at_their_decimal_points() -> None:
    values = [1.5, 12.25, 3.0]
    column = Column(title="x", value=lambda row: row, shown=lambda row: f"{row:g}", digits=2)
    made = as_html(Table("points", values, [column]), Texts("en"))
    assert made is not None
    cells = made.columns[0].values
    assert list(cells) == ["1.5", "12.25", "3"]
    # A blank has the width of a digit, another one that of the point.
    assert [made.columns[0].pad(c) for c in cells] == ["\u2007", "", "\u2008\u2007\u2007"]
    assert {len(c.partition(".")[2]) + len(made.columns[0].pad(c)) for c in cells[:2]} == {2}


def test_cells_below_others_make_a_second_line_and_sentences_a_paragraph() -> None:
    made = Table(
        "photos",
        [1.0, 2.0],
        [
            Column(title="X0", value=lambda row: row, digits=1),
            Column(title="σ X0", value=lambda row: row / 10 if row > 1 else None, below="X0"),
            Column(title="why", value=lambda row: "held" if row < 2 else "", below=""),
        ],
    )
    assert as_text(made)[2:] == ["    1.0", "      held", "    2.0", "  0.200"]


@pytest.mark.parametrize(
    ("unit", "value", "text"),
    [
        (unit_of("gon"), np.pi, "200.000"),
        (unit_of("dms"), np.pi / 180, "1-00-00.000"),
        (unit_of("gon", turn=True), -np.pi / 2, "300.000"),
        (unit_of("mm"), 0.0015, "1.500"),
        (Unit("px"), 3.25, "3.250"),
    ],
)
def test_units_write_figures(unit: Unit, value: float, text: str) -> None:
    assert unit.shown(value, 3) == text
