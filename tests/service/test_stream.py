"""The stream: one JSON object in, one out; whatever is wrong with a line changes nothing."""

from __future__ import annotations

import json
import random
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.io.observation_fields import RecordContext
from factorgraph_adj.io.observation_records import observation_record
from factorgraph_adj.io.project import load_project
from factorgraph_adj.io.project_writer import network_files
from factorgraph_adj.observations import ZenithAngle
from factorgraph_adj.service import stream
from factorgraph_adj.service.requests import MAX_LINE_BYTES
from factorgraph_adj.service.stream import STREAM_COMMANDS, Stream
from factorgraph_adj.units import ANGLE
from tests.networks.projects import FILES, write
from tests.networks.small_block import SIGMA_MM, small_block
from tests.networks.yard import ARRIVALS, POINTS, PROJECT, WRONG, YARD
from tests.support.told import Told, open_stream, state

MGON = ANGLE["mgon"]
COORDINATES = ("x", "y", "z")


@pytest.fixture
def empty(tmp_path) -> Told:
    """A stream whose points wait for observations."""
    return open_stream(tmp_path / "yard")


@pytest.fixture
def yard(empty) -> Told:
    """The same when everything has arrived."""
    empty(*ARRIVALS)
    return empty


# -- observations ---------------------------------------------------------------------------------


def test_the_first_line_says_what_there_is_and_in_which_units(empty):
    first = empty.stream.ready()
    json.dumps(first, allow_nan=False)
    assert (first["ready"], first["name"], first["policy"], first["alpha"]) == (
        *(True, "yard", "flag", 0.001),
    )
    assert (first["observations"], first["photos"], first["waiting"]) == (0, 0, [])
    assert first["units"] == {
        "length": "m",
        "angle": "gon",
        "sigma_length": "mm",
        "sigma_angle": "mgon",
    }
    assert first["counts"] == {
        **dict.fromkeys(("observations", "waiting", "suspects", "rejected", "doubts"), 0),
        "redundancy": 0,
        "sigma0": None,
    }


def test_an_observation_that_determines_nothing_yet_waits_and_says_for_what(empty):
    answer = empty(ARRIVALS[1])
    assert (answer["id"], answer["kind"], answer["verdict"]) == ("r2", "direction", "waiting")
    assert "'C'" in answer["lacks"]
    assert [w["id"] for w in answer["waiting"]] == ["r2"]
    assert answer["waiting"][0]["lacks"] == answer["lacks"]
    assert answer["counts"]["waiting"] == 1
    assert "w" not in answer


def test_what_waited_enters_with_the_observation_that_it_lacked(empty):
    empty(*ARRIVALS[:3])
    answer = empty(ARRIVALS[3])
    assert answer["verdict"] == "accepted"
    assert answer["controlled"] is False
    assert (answer["test"], answer["critical"]) == (None, None)
    assert [v["id"] for v in answer["entered"]] == ["r2", "z1"]
    assert answer["waiting"] == []
    (gain,) = answer["gains"]
    assert gain["point"] == "C"
    assert gain["before_x_mm"] is None
    assert gain["after_x_mm"] > 0


def test_a_verdict_is_that_of_the_library_in_the_units_of_the_project(yard, tmp_path):
    project = load_project(write(tmp_path / "again", YARD))
    inc = IncrementalAdjustment(project.network)
    other = Told(Stream(inc, context=project.context))
    other(*ARRIVALS)
    answer = yard({**ARRIVALS[2], "id": "z3", "value": 98.3637})
    gon = ANGLE["gon"]
    given = ZenithAngle("A", "C", 98.3637 * gon, sigma=MGON, id="z3")
    (verdict,) = inc.add(given).verdicts
    assert answer["verdict"] == verdict.verdict == "accepted"
    assert answer["small_unit"] == "mgon"
    assert answer["innovation"] == pytest.approx((verdict.innovation / MGON).tolist(), rel=1e-8)
    assert answer["innovation_sigma"] == pytest.approx((verdict.sigma / MGON).tolist(), rel=1e-8)
    assert answer["w"] == pytest.approx(verdict.w.tolist(), rel=1e-8)
    assert answer["redundancy_number"] == pytest.approx(verdict.redundancy_numbers.tolist())
    assert (answer["test"], answer["t2"]) == pytest.approx((verdict.test, verdict.t2), rel=1e-8)
    assert (answer["dof"], answer["critical"]) == (1, pytest.approx(10.827566, abs=1e-6))
    (point,) = answer["points"]
    assert [point[a] for a in COORDINATES] == inc.estimate("C").tolist()
    sigma = 1000 * inc.standard_deviations("C")
    assert [point[f"sigma_{a}_mm"] for a in COORDINATES] == pytest.approx(sigma.tolist())


def test_lengths_angles_and_sigmas_have_the_units_of_the_project(tmp_path):
    units = '[units]\nlength = "mm"\nangle = "dms"\nsigma_length = "um"\nsigma_angle = "cc"\n'
    told = open_stream(
        tmp_path, {"project.toml": PROJECT + units, "points.csv": POINTS.replace("80,0,", "8e4,0,")}
    )
    metres = open_stream(tmp_path / "metres")
    told.raw(json.dumps(ARRIVALS[0] | {"value": "0-0-0"}))
    told.raw(json.dumps(ARRIVALS[1] | {"value": 334.4035, "unit": "gon"}))
    told.raw(json.dumps(ARRIVALS[2] | {"value": 98.3621, "unit": "gon"}))
    answer = told(ARRIVALS[3] | {"value": 58326.8})
    metres(*ARRIVALS[:4])
    (point,) = answer["points"]
    # Heights of A and B are 100 mm and 101 mm here.
    expected = 1000 * (metres.inc.estimate("C") - [0, 0, 100]) + [0, 0, 100]
    assert [point[a] for a in COORDINATES] == pytest.approx(expected.tolist(), rel=1e-6)
    assert point["sigma_z_um"] == pytest.approx(1e6 * told.inc.standard_deviations("C")[2])


def test_a_gross_error_is_a_suspect_and_moves_nothing(yard):
    before = yard.inc.estimate("C")
    answer = yard(WRONG)
    assert answer["verdict"] == "suspect"
    assert answer["test"] > 1
    assert answer["innovation"] == [pytest.approx(-186, abs=2)]
    assert answer["points"] == []
    assert answer["counts"]["suspects"] == 1
    np.testing.assert_array_equal(yard.inc.estimate("C"), before)


def test_a_reading_beyond_all_bounds_is_no_more_than_a_suspect(yard):
    answer = yard({**SIGHT, "value": 1e300, "unit": "km"})
    assert answer["verdict"] == "suspect"
    assert answer["t2"] is None  # infinite


def test_policies_accept_and_reject_are_those_of_the_library(tmp_path):
    rejecting = open_stream(tmp_path / "1", policy="reject")
    accepting = open_stream(tmp_path / "2", policy="accept")
    for told, verdict, place in (
        (rejecting, "rejected", "rejected"),
        (accepting, "accepted", "observations"),
    ):
        counts = told(*ARRIVALS)["counts"]
        answer = told(WRONG)
        assert answer["verdict"] == verdict
        assert answer["test"] > 1
        assert answer["counts"][place] == counts[place] + 1


# -- commands -------------------------------------------------------------------------------------


def test_every_command_is_documented_in_the_protocol():
    for name, command in STREAM_COMMANDS.items():
        assert f"``{name}``" in stream.__doc__
        for field in command.fields:
            assert f"``{field}``" in stream.__doc__


def test_the_solution_is_that_of_the_batch(yard):
    yard(do="settle")
    answer = yard(do="solution")
    batch = fga.adjust(yard.inc.network())
    assert answer["converged"] is True
    assert answer["redundancy"] == batch.redundancy == 3
    assert answer["vtpv"] == pytest.approx(batch.vtpv, rel=1e-6)
    assert answer["sigma0"] == pytest.approx(batch.sigma0, rel=1e-6)
    points = {p["name"]: p for p in answer["points"]}
    assert list(points) == ["A", "B", "C"]
    sigma = batch.standard_deviations("C")
    at = np.array([points["C"][a] for a in COORDINATES])
    assert np.all(np.abs(at - batch.point("C")) < 1e-6 * sigma)
    assert [points["C"][f"sigma_{a}_mm"] for a in COORDINATES] == pytest.approx(
        (1000 * sigma).tolist(), rel=1e-6
    )


def test_what_is_retired_is_taken_back(yard):
    before = yard(do="estimate", point="C")
    rows = yard.inc.n_observations
    answer = yard(do="retire", points=["C"])
    assert answer["ok"] and answer["points_retired"] == 1 and answer["photos_retired"] == 0
    assert answer["observations_retired"] > 0
    assert answer["held_points_retired"] == []
    refused = yard.raw(json.dumps({"do": "estimate", "point": "C"}))
    assert "settle(all=True) takes everything back" in refused["error"][0]["what"]
    assert not yard.raw(json.dumps({"do": "settle", "all": "some"}))["ok"]
    assert yard(do="settle", all=True)["ok"] and yard.inc.retired is None
    assert yard.inc.n_observations == rows
    after = yard(do="estimate", point="C")
    assert [after[a] for a in COORDINATES] == pytest.approx(
        [before[a] for a in COORDINATES], abs=1e-6
    )


def test_estimate_tells_a_point(yard):
    answer = yard(do="estimate", point="C")
    assert answer["name"] == "C"
    assert [answer[a] for a in COORDINATES] == yard.inc.estimate("C").tolist()
    held = yard(do="estimate", point="A")
    assert [held[a] for a in COORDINATES] == [0, 0, 100]
    assert held["sigma_x_mm"] == 0


def test_reliability_sums_to_the_redundancy_and_names_the_weakest(yard):
    answer = yard(do="reliability", most=3)
    rel = yard.inc.reliability()
    assert answer["sum"] == pytest.approx(answer["redundancy"], abs=1e-3)
    assert answer["redundancy"] == yard.inc.redundancy
    assert answer["power"] == 0.8
    r = [row["redundancy_number"] for row in answer["weakest"]]
    assert r == pytest.approx(np.sort(rel.redundancy_numbers)[:3].tolist(), rel=1e-6)
    assert {row["kind"] for row in answer["largest_mdb"]} == {a["kind"] for a in ARRIVALS}
    height = next(row for row in answer["largest_mdb"] if row["id"] == "h1")
    assert height["small_unit"] == "mm"
    assert height["mdb"] == pytest.approx(1000 * rel.mdb[rel.row("h1")], rel=1e-6)
    assert answer["uncontrolled"] == []
    assert answer["suspects"] == []
    wider = yard(do="reliability", alpha=0.01, power=0.9)
    assert (wider["alpha"], wider["power"]) == (0.01, 0.9)
    assert wider["critical_w"] < answer["critical_w"]


def test_reliability_names_what_nothing_controls(empty):
    empty(*ARRIVALS[:4])
    answer = empty(do="reliability")
    assert [row["id"] for row in answer["uncontrolled"]] == ["r1", "r2", "z1", "s1"]
    assert answer["weakest"] == answer["largest_mdb"] == []


def test_suspects_wait_for_a_decision_and_can_be_accepted(yard):
    yard(WRONG)
    (suspect,) = yard(do="suspects")["suspects"]
    assert (suspect["id"], suspect["verdict"]) == ("s3", "suspect")
    answer = yard(do="accept", ids=["s3"])
    assert [(v["id"], v["verdict"]) for v in answer["verdicts"]] == [("s3", "accepted")]
    assert [p["name"] for p in answer["points"]] == ["C"]
    assert yard(do="suspects")["suspects"] == []
    assert yard.inc.network().observations["s3"].value == 70.9


def test_suspects_can_be_thrown_out_and_taken_back(yard):
    yard(WRONG)
    answer = yard(do="discard", ids="s3")
    assert (answer["counts"]["suspects"], answer["counts"]["rejected"]) == (0, 1)
    (rejected,) = yard(do="rejected")["rejected"]
    assert rejected["id"] == "s3"
    assert yard(do="accept", ids="s3")["counts"]["rejected"] == 0


def test_decisions_are_revoked_one_after_the_other(yard):
    """An accepted reading that is discarded is rejected, and can be had back."""
    (suspect,) = (yard(WRONG), yard(do="suspects"))[1]["suspects"]
    yard(do="accept", ids="s3")
    answer = yard(do="discard", ids="s3")
    assert [(v["id"], v["verdict"], v["cause"]) for v in answer["verdicts"]] == [
        ("s3", "rejected", "discarded")
    ]
    assert [p["name"] for p in answer["points"]] == ["C"]
    answer = yard(do="revoke", ids=["s3"])
    assert [v["verdict"] for v in answer["verdicts"]] == ["accepted"]
    assert answer["counts"]["rejected"] == 0 and "s3" in yard.inc.network().observations
    yard(do="revoke", ids=["s3"])
    assert yard(do="suspects")["suspects"] == [suspect]


def test_snooping_sets_aside_what_was_accepted_against_its_test(yard):
    yard(WRONG)
    yard(do="accept", ids="s3")
    answer = yard(do="snoop")
    (found,) = answer["set_aside"]
    assert (found["id"], found["kind"], found["round"]) == ("s3", "slope_distance", 1)
    assert abs(found["test_value"]) > answer["critical"]
    assert [v["id"] for v in yard(do="rejected")["rejected"]] == ["s3"]


def test_causes_of_misfits_are_told_with_suspects_among_the_readings(yard):
    answer = yard(do="causes")
    assert (answer["most_probable"], answer["causes"]) == (None, []), "nothing misfits"
    yard(WRONG)
    answer = yard(do="causes")
    assert answer["ok"] and yard.inc.suspects
    found = yard.inc.causes()
    assert [c["cause"] for c in answer["causes"]] == [c.cause for c in found.found]
    assert answer["undecided"] == list(found.undecided)
    assert all(
        len(c["error"]) == len(c["sigma"]) and c["t2"] > c["critical"] for c in answer["causes"]
    )


def test_next_sights_are_told_in_the_units_of_the_project(yard):
    answer = yard(do="next_sights", points="C", most=3)
    found = yard.inc.next_sights("C", most=3)
    assert answer["examined"] == found.examined
    assert [s["sentence"] for s in answer["sights"]] == [str(s) for s in found.sights]
    best, own = answer["sights"][0], found.sights[0]
    assert best["figures"][0]["before_mm"] == pytest.approx(1e3 * own.figures[0].before)
    assert best["figures"][0]["after_mm"] == pytest.approx(1e3 * own.figures[0].after)
    assert best["figures"][0]["what"] == "position error"
    assert answer["figures"][0]["now_mm"] == pytest.approx(1e3 * own.figures[0].before)
    assert best["kinds"] == [o.kind for o in own.candidate.observations]
    wish = {"kind": "redundancy_number", "at_least": 0.9, "observations": ["s1"]}
    answer = yard(do="next_sights", targets=[wish], stations=["A"], singly=True, reach=100)
    assert {s["station"] for s in answer["sights"]} == {"A"}
    assert all(f["after"] > f["before"] for s in answer["sights"] for f in s["figures"])
    two = yard(do="next_sights", points=["C"], sequence=True, most=2)["sights"]
    first, second = (s["figures"][0] for s in two)
    assert second["before_mm"] == pytest.approx(first["after_mm"])


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({}, "give points"),
        ({"points": "Q"}, "no point is named like"),
        ({"points": "C", "most": 1.5}, "whole number"),
        ({"points": "C", "stations": "C"}, "no station that is set up"),
        ({"targets": [{"kind": "size"}]}, "unknown kind 'size'"),
        ({"points": "C", "reach": 0}, "reach"),
    ],
)
def test_faulty_questions_for_sights_are_refused(yard, fields, what):
    problems = yard.refused({"do": "next_sights", **fields})
    assert any(what in p["what"] for p in problems)


@pytest.mark.parametrize(
    ("kind", "meant"), [("slope_distance", "sigma_mm"), ("zenith_angle", "sigma_mgon")]
)
def test_a_standard_deviation_without_a_unit_is_asked_for_in_that_of_the_first_line(
    empty, kind, meant
):
    line = {"kind": kind, "station": "A", "target": "C", "value": 12.3, "sigma": 2}
    (problem,) = empty.refused(line)
    assert problem["what"].startswith("unknown column 'sigma': its unit ends its name (")
    assert problem["what"].endswith(f"did you mean '{meant}'?")


def test_a_weighted_coordinate_cannot_be_reweighted_and_it_is_said_what_can(empty, tmp_path):
    network = fga.Network("weighted")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("C", (10.0, 0.0, 0.0), fixed="yz", sigma=(0.01, np.inf, np.inf))
    inc = IncrementalAdjustment(network)
    with pytest.raises(fga.InputError, match="weighted point C x: is a given value with its own σ"):
        inc.reweight("point C x", 2.0)


def test_removing_the_last_support_of_a_point_makes_it_wait_again(empty):
    empty(*ARRIVALS[:4])
    answer = empty(do="remove", ids=["s1"])
    assert answer["verdicts"] == []
    assert answer["points"] == []
    assert answer["points_lost"] == ["C"]
    assert set(answer["waits_again"]) == {"r2", "z1"}
    assert {w["id"] for w in answer["waiting"]} == {"r2", "z1"}
    assert {w["id"] for w in empty(do="waiting")["waiting"]} == {"r2", "z1"}
    back = empty({**ARRIVALS[3], "id": "s1"})
    assert {v["id"] for v in back["entered"]} == {"r2", "z1"}


def test_removing_one_of_many_tells_the_points_it_touched(yard):
    answer = yard(do="remove", ids="s2")
    (point,) = answer["points"]
    assert [point[a] for a in COORDINATES] == yard.inc.estimate("C").tolist()
    assert answer["points_lost"] == []
    assert answer["counts"]["observations"] == len(ARRIVALS) - 1


def test_an_observation_can_be_replaced_and_reweighted(yard):
    new = {k: v for k, v in ARRIVALS[4].items() if k != "id"}
    answer = yard(do="replace", id="s2", observation={**new, "value": 70.7155})
    assert [(v["id"], v["verdict"]) for v in answer["verdicts"]] == [("s2", "accepted")]
    assert yard.inc.network().observations["s2"].value == 70.7155
    answer = yard(do="reweight", ids=["s1", "s2"], factor=4)
    assert {p["name"] for p in answer["points"]} == {"C"}
    network = yard.inc.network()
    for name in ("s1", "s2"):
        assert network.observations[name].sigma == pytest.approx(0.001)


def test_what_is_written_reads_back_as_the_network(yard, tmp_path):
    answer = yard(do="write", project=str(tmp_path / "out"))
    assert answer["project"] == str(tmp_path / "out" / "project.toml")
    assert network_files(fga.read_project(tmp_path / "out")) == network_files(yard.inc.network())
    answer = yard(do="write", project=str(tmp_path / "other" / "site.toml"))
    assert (tmp_path / "other" / "site.toml").is_file()


def test_no_project_is_replaced_unless_that_is_asked_for(yard, tmp_path):
    """What is written holds only what is determined, without the defaults of the project."""
    (tmp_path / "out").mkdir()
    points = tmp_path / "out" / "points.csv"
    points.write_text("mine\n")
    write = {"do": "write", "project": str(tmp_path / "out")}
    (error,) = yard.refused(write)
    assert "points.csv" in error["what"]
    assert "overwrite" in error["what"]
    assert error["where"] == str(tmp_path / "out" / "project.toml")
    assert [f.name for f in (tmp_path / "out").iterdir()] == ["points.csv"]
    assert points.read_text() == "mine\n"
    (error,) = yard.refused(write | {"overwrite": "yes"})
    assert "true or false" in error["what"]
    yard(write | {"overwrite": True})
    assert network_files(fga.read_project(tmp_path / "out")) == network_files(yard.inc.network())


def test_a_point_that_never_was_determined_is_not_lost(empty):
    """And nothing is told of a reading that is gone."""
    empty(ARRIVALS[1])
    answer = empty(do="remove", ids="r2")
    assert answer["points_lost"] == []
    assert answer["waiting"] == []
    (error,) = empty.refused({"do": "estimate", "point": "C"})
    assert "no observation has determined it yet" in error["what"]


def test_stop_is_answered_and_noted(yard):
    assert not yard.stream.stopped
    assert yard(do="stop")["do"] == "stop"
    assert yard.stream.stopped


def test_many_arrive_together_with_points_of_their_own(empty):
    sights = [{**a, "target": "D", "id": a["id"] + "d"} for a in ARRIVALS[1:]]
    answer = empty(
        do="add", points=[{"name": "D"}], observations=[ARRIVALS[0], *ARRIVALS[1:], *sights]
    )
    verdicts = [(v["id"], v["verdict"]) for v in answer["verdicts"]]
    assert verdicts == [(a["id"], "accepted") for a in (*ARRIVALS, *sights)]
    assert {p["name"] for p in answer["points"]} == {"C", "D"}


def test_correlated_observations_arrive_as_one_record(yard):
    covariance = [[4e-6, 1e-6], [1e-6, 4e-6]]
    members = [
        {"kind": "slope_distance", "station": "A", "target": "C", "value": 58.3268, "id": "k1"},
        {"kind": "slope_distance", "station": "B", "target": "C", "value": 70.7141, "id": "k2"},
    ]
    answer = yard({"kind": "correlated", "observations": members, "covariance_si": covariance})
    assert [(v["id"], v["verdict"]) for v in answer["verdicts"]] == [
        ("k1", "accepted"),
        ("k2", "accepted"),
    ]
    assert answer["verdicts"][0]["dof"] == 2


# -- photos ---------------------------------------------------------------------------------------


def test_a_photo_arrives_with_its_image_points(tmp_path):
    network = small_block()
    images = list(network.image_points())
    last = list(network.photos)[-1]
    network.image_mask(np.array([i.photo != last for i in images]))
    photo = network.photos.pop(last)
    del network.photo_number[last]
    told = Told(Stream(IncrementalAdjustment(network)))
    rays = [{**observation_record(i), "id": ""} for i in images if i.photo == last]
    first = told(do="add", photos=[{"name": last, "camera": photo.camera}])
    assert first["verdicts"] == []
    answer = told(do="add", observations=rays[:2])
    assert {v["verdict"] for v in answer["verdicts"]} == {"waiting"}
    answer = told(do="add", observations=rays[2:])
    assert {v["verdict"] for v in answer["verdicts"]} == {"accepted"}
    assert len(answer["entered"]) == 2
    verdict = answer["verdicts"][0]
    assert (verdict["components"], verdict["small_unit"]) == (["x", "y"], "um")
    assert verdict["innovation_sigma"][0] > 1000 * SIGMA_MM
    pose = told(do="estimate", photo=last)
    found = told.inc.pose(last)
    assert [pose[a] for a in COORDINATES] == found.position.tolist()
    turned = [pose[a] * ANGLE["gon"] for a in ("omega", "phi", "kappa")]
    assert turned == pytest.approx(found.omega_phi_kappa.tolist(), abs=1e-12)
    assert pose["sigma_rx_mgon"] == pytest.approx(found.sigmas[0] / MGON)
    camera = told(do="estimate", camera="D3")
    assert camera["unit"] == "mm"
    assert camera["parameters"]["c"] == pytest.approx(told.inc.calibration("D3")["c"])
    whole = told(do="solution")
    assert [p["name"] for p in whole["photos"]] == list(told.inc.network().photos)
    assert [c["name"] for c in whole["calibrations"]] == ["D3"]


def test_a_camera_arrives_with_its_photos_and_its_direction_of_y(tmp_path):
    told = Told(Stream(IncrementalAdjustment(small_block())))
    camera = {"name": "new", "unit": "px", "lens": "none", "parameters": {"c": 3000}}
    told(do="add", cameras=[camera], photos=[{"name": "N", "camera": "new"}])
    ray = {"kind": "image", "photo": "N", "point": "P1", "x": 10, "y": -20, "sigma_px": 0.3}
    assert told(ray)["verdict"] == "waiting"
    assert told.inc.observation("N/P1").y == -20
    down = {**camera, "name": "other", "y_axis": "down"}
    told(do="add", cameras=[down], photos=[{"name": "O", "camera": "other"}])
    assert told({**ray, "photo": "O"})["verdict"] == "waiting"
    assert told.inc.observation("O/P1").y == 20
    assert told.inc.network().cameras["other"].y_down_in_files
    (problem,) = told.refused({"do": "add", "cameras": [{**camera, "name": "X", "sigma_px": 1}]})
    assert "sigma_px can only be stated in a project" in problem["what"]


def test_a_frame_arrives_with_what_is_measured_in_it():
    told = Told(Stream(IncrementalAdjustment(small_block())))
    scan = {"kind": "frame", "name": "scan", "free": "rx ry rz x y z", "origin_x": 1.0}
    scan |= {"origin_y": 2.0, "origin_z": 0.5}
    seen = {"kind": "frame_coordinate", "frame": "scan", "sigma_mm": 2.0}
    rays = [{**seen, "point": f"P{i}", "x": 0.1 * i, "y": 0.2, "z": 0.3} for i in (1, 2)]
    answer = told(do="add", unknowns=[scan], observations=rays)
    assert [v["verdict"] for v in answer["verdicts"]] == ["waiting"] * 2
    for given, what in (
        ([scan], "frame 'scan': is stated already"),
        ([{**scan, "name": "two"}] * 2, "unknowns: frame 'two' stands twice"),
        ([{"kind": "fame"}], "unknown kind 'fame'"),
        ([{**scan, "name": "x", "colour": 1}], "unknown field 'colour'"),
        ([{**scan, "name": "y", "origin": "nobody"}], "not both"),
    ):
        problems = told.refused({"do": "add", "unknowns": given})
        assert any(what in f"{p['where']}: {p['what']}" for p in problems), problems


def test_image_coordinates_of_a_project_stand_as_its_files_say(tmp_path):
    flipped = FILES["project.toml"].replace('unit = "mm"', 'unit = "mm"\ny_axis = "down"')
    files = FILES | {"project.toml": flipped, "images.csv": "photo,point,x,y\n"}
    told = open_stream(tmp_path, files)
    # σ of the camera, y down; the photo is one of the project or one that arrives.
    told(do="add", photos=[{"name": "Q"}])
    for photo in ("P", "Q"):
        told({"kind": "image", "photo": photo, "point": "C", "x": 1, "y": 2})
        image = told.inc.observation(f"{photo}/C")
        assert (image.y, image.sigma) == (-2.0, (0.005, 0.005))


# -- errors ---------------------------------------------------------------------------------------

BAD = {
    "": "the line is empty",
    "   \t": "the line is empty",
    "nonsense": "the line is not JSON",
    '{"kind": "slope_distance", "station": "A"': "the line is not JSON",
    '{"kind": "slope_distance"} {}': "the line is not JSON",
    "[1, 2]": "must be one JSON object {…}, not [1, 2]",
    '"text"': "must be one JSON object {…}, not 'text'",
    "12": "must be one JSON object",
    "null": "must be one JSON object",
    "{}": "neither an observation (kind) nor a command (do)",
    '{"value": 3}': "fields: value",
    "[" * 100_000: "nested too deeply",
    '{"value": ' + "9" * 5000 + "}": "JSON that can be read: Exceeds the limit",
    '{"kind": "direction", "kind": "azimuth"}': "'kind' stands twice",
    '{"kind": "direction", "station": "\\ud800"}': "half a character",
    b'{"kind": "direction", "station": "\xff"}': "not UTF-8 text (byte 35)",
}


@pytest.mark.parametrize("line", BAD, ids=lambda line: repr(line[:30]))
def test_a_line_that_is_no_object_is_refused(yard, line):
    (problem,) = yard.refused(line)
    assert BAD[line] in problem["what"]


def test_a_line_that_is_too_long_is_refused(empty):
    (problem,) = empty.refused(b" " * (MAX_LINE_BYTES + 1))
    assert problem["what"] == "the line is longer than 64 MB"


SIGHT = {"kind": "slope_distance", "station": "A", "target": "C", "value": 58.33}


@pytest.mark.slow("every damaged or bad line is answered; short tests send one of each sort")
@pytest.mark.parametrize(
    ("fields", "where", "what"),
    [
        ({"kind": "distance"}, "distance A C", "unknown kind 'distance'; valid: slope_distance"),
        ({"kind": 3}, "3 A C", "unknown kind '3'"),
        ({"kind": ["slope_distance"]}, "", "kind must be text"),
        ({"target": "X"}, "slope_distance A X", "unknown point 'X'; known: A, B, C"),
        ({"target": None}, "slope_distance A", "target is missing"),
        ({"target": "A"}, "slope_distance A A", "cannot join a point to itself"),
        ({"target": ["C"]}, "slope_distance A ['C']", "target must be text"),
        ({"value": "12,3"}, "slope_distance A C", "'12,3' is not a number; write a decimal point"),
        ({"value": None}, "slope_distance A C", "value is missing"),
        ({"value": True}, "slope_distance A C", "True is not a number"),
        ({"value": float("nan")}, "slope_distance A C", "'nan' is not a finite number"),
        ({"value": float("inf")}, "slope_distance A C", "'inf' is not a finite number"),
        ({"value": -5}, "slope_distance A C", "a distance cannot be negative"),
        ({"value": {"x": 1}}, "slope_distance A C", "is not a number"),
        ({"sigma_mm": 0}, "slope_distance A C", "must be greater than zero"),
        ({"sigma_mm": float("nan")}, "slope_distance A C", "not a finite number"),
        ({"sigma_mgon": 1}, "slope_distance A C", "does not apply to slope_distance"),
        ({"vlaue": 1}, "slope_distance A C", "did you mean 'value'?"),
        ({"unit": "furlong"}, "slope_distance A C", "unknown unit 'furlong'; valid: m"),
        (
            {"id": "\0"},
            "slope_distance A C (id \0)",
            "a name cannot have control characters: \\x00",
        ),
        ({"id": "s1"}, "slope_distance A C (id s1)", "duplicate id 's1'"),
        ({"instrument": "T2"}, "slope_distance A C", "unknown distance meter 'T2'"),
        ({"kind": "image", "photo": "1"}, "image A C 1", "unknown photo '1'; known: none"),
    ],
    ids=str,
)
def test_a_bad_observation_is_refused_and_named(yard, fields, where, what):
    problem = yard.refused({**SIGHT, **fields})[0]
    assert what in problem["what"]
    assert problem["where"] == where


def test_all_that_is_wrong_with_a_line_is_told_at_once(yard):
    problems = yard.refused(
        {
            "do": "add",
            "points": [{"name": "D", "x": "1o"}, {"name": ""}, 5],
            "photos": [{"camera": "none"}],
            "cameras": "P31",
            "observations": [SIGHT, {**SIGHT, "value": "?"}],
            "remarks": 1,
        }
    )
    assert [p["where"] for p in problems] == [
        *("add", "add", "photo 1: photo", "point 1: point 'D'", "point 2: point", "point 3"),
        "observation 2: slope_distance A C",
    ]
    assert problems[0]["what"].startswith("unknown field 'remarks'; it takes: observations")
    assert problems[1]["what"] == "cameras must be a list of records, not 'P31'"
    assert problems[5]["what"] == "point 3 must be an object {…}, not 5"


@pytest.mark.slow("every damaged or bad line is answered; short tests send one of each sort")
@pytest.mark.parametrize(
    ("command", "what"),
    [
        ({"do": "dance"}, "unknown command 'dance'; valid: add, solution, estimate"),
        ({"do": None}, "unknown command None"),
        ({"do": ["stop"]}, "unknown command ['stop']"),
        ({"do": "stop", "now": True}, "unknown field 'now'; it takes: no further fields"),
        ({"do": "solution", "point": "C"}, "unknown field 'point'"),
        ({"do": "add"}, "nothing to add"),
        ({"do": "add", "observations": []}, "nothing to add"),
        ({"do": "add", "points": [{"name": "A"}]}, "duplicate name of a point"),
        ({"do": "add", "photos": [{"name": "1", "camera": "X"}]}, "unknown camera 'X'"),
        ({"do": "add", "cameras": [{"name": "X"}]}, "parameters is missing"),
        ({"do": "estimate"}, "give one of point, photo, camera"),
        ({"do": "estimate", "point": "A", "photo": "1"}, "give one of point, photo, camera"),
        ({"do": "estimate", "point": "X"}, "unknown point 'X'; known: A, B, C"),
        ({"do": "estimate", "photo": "X"}, "'X'"),
        ({"do": "estimate", "camera": "X"}, "'X'"),
        ({"do": "reliability", "alpha": 2}, "must lie between 0 and 1"),
        ({"do": "reliability", "power": "much"}, "power: 'much' is not a number"),
        ({"do": "remove"}, "ids is missing"),
        ({"do": "remove", "ids": []}, "ids is empty"),
        ({"do": "remove", "ids": ["s1", "X"]}, "unknown observation"),
        ({"do": "remove", "ids": [1.5]}, "ids must be a list of ids, or one id, not [1.5]"),
        ({"do": "remove", "ids": {"s1": 1}}, "ids must be a list of ids"),
        ({"do": "accept", "ids": "s1"}, "is neither suspect nor rejected"),
        ({"do": "discard", "ids": ["X"]}, "unknown observation"),
        ({"do": "revoke", "ids": ["s1"]}, "no decision by hand about it stands"),
        ({"do": "revoke", "ids": ["X"]}, "unknown observation"),
        ({"do": "replace", "id": "s1"}, "observation is missing"),
        ({"do": "replace", "observation": SIGHT}, "id is missing"),
        ({"do": "replace", "id": "X", "observation": SIGHT}, "unknown observation"),
        ({"do": "replace", "id": "s1", "observation": 5}, "observation must be an object"),
        ({"do": "replace", "id": "s1", "observation": {**SIGHT, "target": "X"}}, "unknown point"),
        ({"do": "reweight", "ids": "s1"}, "factor is missing"),
        ({"do": "reweight", "ids": "s1", "factor": 0}, "factor must be greater than zero"),
        ({"do": "reweight", "ids": "X", "factor": 2}, "unknown observation"),
        ({"do": "write"}, "project is missing"),
    ],
    ids=lambda value: json.dumps(value) if isinstance(value, dict) else "",
)
def test_a_bad_command_is_refused_with_what_would_be_valid(yard, command, what):
    assert what in yard.refused(command)[0]["what"]
    assert not yard.stream.stopped


def test_names_that_no_file_can_hold_are_refused(yard):
    correlated = {"kind": "correlated", "observations": [{**SIGHT, "id": "a\nb"}]}
    blanks, control = "has blanks or line breaks at its ends", "cannot have control characters"
    for line, why in (
        ({"do": "add", "points": [{"name": " D"}]}, blanks),
        ({"do": "add", "points": [{"name": "D\x1b[2J"}]}, control),
        ({"do": "add", "observations": [{**SIGHT, "kind": "direction", "set": "1\n"}]}, blanks),
        ({**correlated, "covariance_si": [[1]]}, control),
    ):
        assert why in yard.refused(line)[0]["what"]


def test_what_is_not_determined_has_no_estimate(empty):
    (problem,) = empty.refused({"do": "estimate", "point": "C"})
    assert "is not determined" in problem["what"]
    assert "nothing is determined yet" in empty.refused({"do": "solution"})[0]["what"]


def test_a_fault_of_the_program_is_an_answer_and_the_stream_goes_on(yard, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError("by hand")

    monkeypatch.setattr(IncrementalAdjustment, "add", broken)
    (problem,) = yard.refused(SIGHT)
    assert "fault of the program, not of the line: ZeroDivisionError: by hand" in problem["what"]
    monkeypatch.undo()
    assert yard(SIGHT)["verdict"] == "accepted"
    monkeypatch.setattr(IncrementalAdjustment, "add", broken)
    monkeypatch.setenv("FACTORGRAPH_ADJ_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        yard.raw(json.dumps(SIGHT))


def test_very_many_problems_and_very_long_ones_are_cut(yard):
    problems = yard.refused({"do": "add", "observations": [{**SIGHT, "value": "x" * 5000}] * 150})
    assert len(problems) == 101
    assert problems[-1]["what"] == "… and 50 more"
    assert max(len(p["what"]) for p in problems) < 700


def damaged(line: str, chance: random.Random) -> bytes:
    """Return a line with bytes that were lost, doubled, swapped or changed."""
    data = bytearray(line.encode("utf-8"))
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(data))
        what = chance.randrange(5)
        if what == 0:
            del data[at : at + chance.randint(1, 9)]
        elif what == 1:
            data[at] = chance.randrange(256)
        elif what == 2:
            data[at:at] = data[at : at + chance.randint(1, 9)]
        elif what == 3:
            del data[at:]
        else:
            other = chance.randrange(len(data))
            data[at], data[other] = data[other], data[at]
        data = data or bytearray(b"{")
    return bytes(data)


@pytest.mark.slow("every damaged or bad line is answered; short tests send one of each sort")
def test_damaged_lines_get_an_answer_and_change_nothing_unless_they_are_sound(yard):
    """300 lines, seeded: refused ones leave every bit, others are what the library takes."""
    chance = random.Random(4)
    lines = [*ARRIVALS, WRONG, {"do": "remove", "ids": ["s9"]}, {"do": "estimate", "point": "C"}]
    refused = 0
    for i in range(300):
        line = json.dumps(
            {**chance.choice(lines), "id": f"n{i}"} if i % 3 else chance.choice(lines)
        )
        before = state(yard.inc)
        answer = yard.raw(damaged(line, chance))
        if not answer["ok"]:
            refused += 1
            assert all(
                p["what"] and "fault of the program" not in p["what"] for p in answer["error"]
            )
            assert state(yard.inc) == before
    assert refused > 200
    assert yard(do="solution")["converged"]


def test_an_answer_names_no_more_of_what_waits_than_can_be_read(tmp_path):
    names = [f"P{i}" for i in range(30)]
    told = open_stream(
        tmp_path, YARD | {"points.csv": POINTS + "".join(f"{n},,,,\n" for n in names)}
    )
    for name in names:
        answer = told({**SIGHT, "target": name})
    assert answer["counts"]["waiting"] == 30
    assert len(answer["waiting"]) == 20
    assert answer["waiting"][0]["label"].startswith("slope_distance A P29")
    assert len(told(do="waiting")["waiting"]) == 30


def test_a_network_that_is_no_project_takes_units_from_its_cameras():
    network = small_block()
    own = Stream(IncrementalAdjustment(network), context=RecordContext(Units(length="cm")))
    assert own.context.cameras["D3"].unit == "mm"
    assert set(own.context.images) == set(network.photos)
    answer = Told(own)(do="estimate", point="P1")
    assert answer["x"] == pytest.approx(100 * own.adjustment.estimate("P1")[0])


def test_verdicts_have_y_as_the_files_have_it():
    """A reading 0.1 mm too low on the photo is told with the sign of its files."""
    found = []
    for sign in (1, -1):
        network = small_block()
        network.cameras["D3"] = replace(network.cameras["D3"], y_down_in_files=sign < 0)
        left = next(network.image_points())
        told = Told(
            Stream(IncrementalAdjustment(fga.without(network, [f"{left.photo}/{left.point}"])))
        )
        ray = {"kind": "image", "photo": left.photo, "point": left.point, "sigma_mm": 0.004}
        verdict = told(ray | {"x": left.x, "y": sign * (left.y - 0.1)})
        found.append((verdict["innovation"], verdict["w"]))
        y0 = told(do="estimate", camera="D3")["parameters"]["y0"]
        assert y0 == pytest.approx(sign * told.inc.calibration("D3")["y0"])
    (v, w), (v_down, w_down) = found
    assert (v_down[0], w_down[0]) == pytest.approx((v[0], w[0]), rel=1e-6)
    assert (v_down[1], w_down[1]) == pytest.approx((-v[1], -w[1]), rel=1e-6)
    assert v[1] > 50, "computed − observed, µm"
