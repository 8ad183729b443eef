"""results.json has every figure with all digits, as its schema says."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import LeftOut
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import Provenance, ReportOptions, Run
from factorgraph_adj.report.result_files import write_solution
from tests.networks.mapped import geocentric, in_plane, in_utm
from tests.networks.small_block import blundered, images_only
from tests.support.described import assert_described


def free():
    network = images_only()
    network.datum = "free"
    return network


def snooped():
    network = blundered()
    found = fga.snoop(network)
    options = ReportOptions(confidence=0.95, relative="observed")
    run = Run("block.toml", "2026-03-01 01:30 +0200", "--snoop")
    return Report(found.solution, options, Provenance(found, network, run=run))


def components():
    found = fga.estimate_variance_components(in_plane().network)
    return Report(found.solution, ReportOptions(), Provenance(components=found))


def one_distance():
    network = fga.Network("one distance")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (9, 0, 0), fixed="yz")
    network.add(fga.SlopeDistance("A", "B", 10.0, sigma=0.01))
    return fga.adjust(network)


RESULTS = {
    "block": in_plane,
    "utm": in_utm,
    "a posteriori": lambda: fga.adjust(in_plane().network, variance="a-posteriori"),
    "geocentric": lambda: fga.adjust(geocentric()),
    "free": lambda: fga.adjust(free()),
    "snooped": snooped,
    "components": components,
    "no redundancy": one_distance,
    "one iteration": lambda: fga.adjust(in_plane().network, max_iterations=1),
}


def written(result, folder):
    fga.write_results(result, folder / "results.json")
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def test_the_schema_is_one():
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(fga.results_schema())


def test_a_result_says_where_it_began_what_was_left_out_and_what_is_striking(tmp_path):
    """A reader left a row out, a start was replaced, and back readings repeat the forth ones."""
    jsonschema = pytest.importorskip("jsonschema")
    network = fga.Network("striking")
    for i in range(5):
        network.add_point(f"P{i}", (0.0, 0.0, 1.0 * i), fixed="xyz" if i == 0 else "xy")
    for i in range(5):
        j = (i + 1) % 5
        rise = round(1.0 * (j - i) + 0.0003 * (-1) ** i, 4)
        for a, b, value in ((i, j, rise), (j, i, -rise)):
            network.add(fga.HeightDifference(f"P{a}", f"P{b}", value, sigma=0.001))
    row = LeftOut("rows", "they have no value", ("P4",), 1, of=11, where="levels.csv:7")
    network.left_out.append(row)
    solution = replace(fga.adjust(network), begun=("began from other values",))
    found = written(solution, tmp_path)
    jsonschema.validate(found, fga.results_schema())
    assert found["start"] == ["began from other values"]
    assert found["left_out"] == [str(row)]
    assert any("forth and back" in note for note in found["notes"])
    for key in ("start", "left_out", "notes"):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(found | {key: "one text"}, fga.results_schema())


@pytest.mark.parametrize("name", RESULTS)
def test_results_are_as_the_schema_says(name, tmp_path):
    found = written(RESULTS[name](), tmp_path)
    assert_described(found)
    assert found["$schema"] == fga.results_schema()["$id"]
    assert found["format"] == fga.results_schema()["properties"]["format"]["const"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda r: r.pop("sigma0"),
        lambda r: r.update(format=1),
        lambda r: r.update(further=1),
        lambda r: r["points"]["P1"].update(xyz=[1.0, 2.0]),
        lambda r: r["observations"].pop("residual"),
        lambda r: r["photos"]["F1"].update(position="there"),
    ],
)
def test_the_schema_refuses_what_is_not_of_the_format(spoil, tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    found = written(in_plane(), tmp_path)
    spoil(found)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(found, fga.results_schema())


def test_every_number_comes_back_to_the_bit(tmp_path):
    s = in_plane()
    rel = fga.reliability(s)
    found = written(s, tmp_path)
    for i, (name, p) in enumerate(found["points"].items()):
        assert p["xyz"] == s.point(name).tolist()
        upper = s.point_covariances[i][np.triu_indices(3)]
        assert p["covariance"] == upper.tolist()
    o = found["observations"]
    assert o["residual"] == s.observations.residuals.tolist()
    assert o["sigma"] == s.observations.sigmas.tolist()
    assert o["redundancy_number"] == rel.redundancy_numbers.tolist()
    assert len({len(column) for column in o.values()}) == 1
    v = np.array(o["residual"]) / np.array(o["sigma"])
    assert float(v @ v) == pytest.approx(found["vtpv"], rel=1e-9), "nothing is left out"


def test_the_frame_and_the_reference_system_are_told(tmp_path):
    found = written(in_utm(), tmp_path)
    assert found["frame"] == "topocentric"
    assert found["frame_parameters"]["latitude"] == in_utm().network.frame.latitude
    assert found["reference_system"] == {"definition": "EPSG:25832", "heights": "ellipsoidal"}
    assert "reference_system" not in written(in_plane(), tmp_path)


def test_adjust_out_writes_the_same_file(tmp_path):
    report = snooped()
    write_solution(report.solution, tmp_path / "out", report.options, report.provenance)
    fga.write_results(report, tmp_path / "alone.json")
    there = (tmp_path / "out" / "results.json").read_text(encoding="utf-8")
    alone = (tmp_path / "alone.json").read_text(encoding="utf-8")
    assert there == alone
    assert [f.name for f in (tmp_path / "out").glob("*.json")] == ["results.json"]


def test_ellipses_stand_at_their_points(tmp_path):
    found = written(snooped(), tmp_path)
    s = snooped().solution
    e = fga.error_ellipse(s, "P7")
    shown = found["points"]["P7"]["ellipse"]
    assert shown["semi_axes"] == pytest.approx(e.semi_axes, rel=1e-9)
    assert shown["confidence"] == 0.95
