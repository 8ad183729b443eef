"""Report, table and results.json of two epochs say what the comparison found."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.report import epochs_report
from factorgraph_adj.report.epochs_report import (
    EpochsReport,
    displacements_table,
    render_congruence,
)
from factorgraph_adj.report.html.epochs_page import epochs_html
from factorgraph_adj.report.results_json import epochs_results_text
from factorgraph_adj.report.tables import Column, as_csv
from tests.networks import moved
from tests.support.described import assert_described, assert_only_added
from tests.support.pages import data_of

jsonschema = pytest.importorskip("jsonschema")


def strained():
    found, motion = moved.strained()
    return EpochsReport(found, (motion,))


CASES = {
    "plan": lambda: EpochsReport(moved.in_plan(), (moved.block(),)),
    "strain": strained,
    "joint": lambda: EpochsReport(moved.joint()),
    "kept": lambda: EpochsReport(moved.kept()),
    "few": lambda: EpochsReport(moved.few()),
    "doubtful": lambda: EpochsReport(moved.doubtful()),
    "heights": lambda: EpochsReport(moved.heights()),
    "space": lambda: EpochsReport(moved.in_space()),
    "geocentric": lambda: EpochsReport(moved.in_space(geocentric=True)),
}


@pytest.mark.parametrize("name", CASES)
def test_results_are_as_their_schema_says(name):
    schema = fga.results_schema("epochs")
    jsonschema.Draft202012Validator.check_schema(schema)
    report = CASES[name]()
    found = json.loads(epochs_results_text(report))
    assert_described(found, "epochs")
    assert (found["$schema"], found["format"]) == (schema["$id"], 1)
    assert [x["moved"] for x in found["displacements"]] == [
        x.moved for x in report.found.displacements.values()
    ]
    for x in found["displacements"]:
        own = report.found.displacement(x["name"])
        assert x["vector"] == own.vector.tolist()
        assert x["test"]["value"] == own.test.value
        assert x["detectable"] == (own.detectable if np.isfinite(own.detectable) else None)
    assert [b["points"] for b in found["blocks"]] == [list(b.points) for b in report.blocks]
    second = {"B": "B2", "P": "P2", "Q": "Q2"} if name == "joint" else {}
    assert [x["name_later"] for x in found["displacements"]] == [
        second.get(n, n) for n in report.names
    ]
    assert bool(found["doubts"]) == (not report.found.fine)


def test_an_unknown_schema_is_refused():
    with pytest.raises(InputError, match="valid: adjustment, epochs"):
        fga.results_schema("epoch")


def test_the_table_has_the_ellipses_of_the_comparison():
    report = CASES["plan"]()
    rows = list(csv.DictReader(io.StringIO(as_csv(displacements_table(report)))))
    assert [r["name"] for r in rows] == report.names
    for row, e in zip(rows, report.found.ellipses(confidence=0.95), strict=True):
        x = report.found.displacement(row["name"])
        assert float(row["dx_mm"]) == pytest.approx(1e3 * x.vector[0], rel=1e-12, abs=1e-12)
        assert float(row["detectable_mm"]) == pytest.approx(1e3 * x.detectable, rel=1e-12)
        assert float(row["test_value"]) == x.test.value
        assert float(row["ellipse_major_mm"]) == pytest.approx(1e3 * e.semi_axes[0], rel=1e-12)
        assert float(row["ellipse_azimuth_gon"]) == pytest.approx(e.azimuth * 200 / np.pi)
        assert float(row["confidence"]) == 0.95


def test_standard_ellipses_have_no_confidence_in_the_table():
    report = EpochsReport(moved.in_plan(), confidence=None)
    assert "confidence" not in as_csv(displacements_table(report)).splitlines()[0].split(",")


def test_a_figure_of_displacements_that_is_added_appears_in_every_rendering(monkeypatch):
    """The column is the displacement over the smallest one that is detected."""
    before = epochs_report.displacement_columns

    def with_ratio(report):
        value = lambda x: x.length / x.detectable  # noqa: E731
        return [*before(report), Column(title="d/∇", key="ratio", value=value, digits=4)]

    monkeypatch.setattr(epochs_report, "displacement_columns", with_ratio)
    report = EpochsReport(moved.in_plan())
    expected = [x.length / x.detectable for x in report.found.displacements.values()]
    read = [f"{v:.4f}" for v in expected]
    text = render_congruence(report.found)
    lines = text[text.index("Displacements") :].split("\n\n")[1].splitlines()
    assert [line.split()[-1] for line in lines] == ["d/∇", lines[1].strip(), *read]
    assert read in data_of(epochs_html(report), "sheet-displacements")["columns"]
    header, *rows = as_csv(displacements_table(report)).splitlines()
    at = header.split(",").index("ratio")
    assert [float(r.split(",")[at]) for r in rows] == pytest.approx(expected)
    results = json.loads(epochs_results_text(report))
    assert_only_added(results, "ratio", "epochs")
    assert [x["ratio"] for x in results["displacements"]] == pytest.approx(expected)
    assert report.found.table()["ratio"] == pytest.approx(expected)


def test_a_displacement_in_plan_is_significant_outside_of_its_ellipse():
    for found in (moved.in_plan(), moved.kept(), moved.doubtful()):
        for x, e in zip(found.displacements.values(), found.ellipses(), strict=True):
            turn = np.array([np.sin(e.azimuth), np.cos(e.azimuth)])
            along, across = x.vector[:2] @ turn, x.vector[0] * turn[1] - x.vector[1] * turn[0]
            size = (along / e.semi_axes[0]) ** 2 + (across / e.semi_axes[1]) ** 2
            assert size == pytest.approx(x.test.value / x.test.critical, rel=1e-9)
            assert (size > 1) == x.moved


def test_ellipses_lie_in_the_horizon_of_their_points():
    """In a geocentric frame they are those of the same vectors in a local one, turned."""
    found = moved.in_space(geocentric=True)
    (e,) = (e for e in found.ellipses() if e.a == "P")
    x = found.displacement("P")
    enu = found.network.frame.basis(x.place[None], np.zeros((1, 2))).enu[0]
    values = np.linalg.eigvalsh((enu @ x.covariance @ enu.T)[:2, :2])
    assert np.array(e.semi_axes) == pytest.approx(e.factor * np.sqrt(values[::-1]), rel=1e-9)


def test_axes_of_the_frame_turn_the_azimuth():
    """With x to the north, the azimuth of the same ellipse counts from north too."""
    found = moved.in_plan()
    (e,) = (e for e in found.ellipses() if e.a == "B")
    turned = []
    for solution in found.solutions:
        plain = solution.network
        network = fga.Network(plain.name, frame=fga.LocalFrame(axes="ne"), datum="free")
        for n, p in plain.points.items():
            east, north, up = p.coordinates
            network.add_point(n, (north, east, up), fixed="z")
        network.add(*plain.observations.values())
        turned.append(fga.adjust(network))
    other = fga.congruence(*turned, objects=["P", "Q"], variance="a-priori")
    (same,) = (e for e in other.ellipses() if e.a == "B")
    assert same.semi_axes == pytest.approx(e.semi_axes, rel=1e-6)
    assert same.azimuth == pytest.approx(e.azimuth, abs=1e-5)
    assert other.displacement("B").vector[[1, 0]] == pytest.approx(
        found.displacement("B").vector[:2], abs=1e-7
    )


def test_grid_coordinates_of_thousands_of_kilometres_are_compared_alike():
    """The alignment of free epochs came to no rest where coordinates are rounded to 1 nm."""
    here, there = moved.in_plan(), moved.with_system(known=False)
    for n, x in here.displacements.items():
        assert there.displacement(n).vector == pytest.approx(x.vector, abs=1e-7)
        assert there.displacement(n).test.value == pytest.approx(x.test.value, rel=1e-4, abs=1e-4)


def test_the_report_lists_blocks_and_strains():
    text = render_congruence(moved.in_plan(), blocks=[moved.block()])
    b = moved.block()
    assert "P, Q: the block moved, rigid" in text
    assert (
        f"tx [mm]  {1000 * b['tx']:8.3g}".split()
        == [w for line in text.splitlines() if line.strip().startswith("tx") for w in line.split()][
            :3
        ]
    )
    found, motion = moved.strained()
    told = " ".join(render_congruence(found, blocks=[motion]).split())
    for strain in motion.principal_strains()[0]:
        assert f"{1e6 * strain:.1f} ppm along" in told
    assert "have no redundancy to test" in told
    assert fga.text_report(moved.in_plan()) == render_congruence(moved.in_plan())
