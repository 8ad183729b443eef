"""Frames in the report and in the tables."""

from __future__ import annotations

import csv
import io
from functools import cache

import numpy as np
import pytest

from factorgraph_adj import adjust, read_project, text_report, write_project
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.network.network import Network
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.rotation import exp_rotation, log_rotation
from tests.networks.three_frames import FRAMES, MIDDLE, three_frames

GON = np.pi / 200
"""Radians."""
FOUR_PLACES = 0.5e-4
"""Half a unit of the last decimal of a value with four."""


@cache
def solution():
    return adjust(three_frames())


def section(text: str, heading: str) -> list[str]:
    """Return the lines of a section of a report."""
    lines = text.splitlines()
    start = lines.index(heading)
    return lines[start : lines.index("", start) if "" in lines[start:] else None]


def cells(line: str) -> list[str]:
    return [c.strip() for c in line.split("  ") if c.strip()]


def of_frame(text: str, name: str) -> tuple[list[str], list[str], list[str]]:
    """Return the lines of a frame: where it is, its values, their σ."""
    lines = text[text.index("\nFrames\n") :].splitlines()
    at = [i for i, line in enumerate(lines) if line.startswith(f"  {name} ")][:2]
    return cells(lines[at[0]]), cells(lines[at[1]]), cells(lines[at[1] + 1])


def test_a_frame_stands_with_its_origin_its_places_and_its_residuals() -> None:
    s = solution()
    text = text_report(s)
    ids = s.observations.ids
    for name, origin, level in (
        ("scan", "15 10 4", "no"),
        ("model", "15 10 4", "no"),
        ("station", "point T", "yes"),
    ):
        of = [s.network.observations[i].frames() == (name,) for i in ids]
        own = s.observations.residuals[of]
        words, _, _ = of_frame(text, name)
        assert words[:4] == [name, origin, level, "8"]
        assert float(words[4]) == pytest.approx(1e3 * np.sqrt(np.mean(own**2)), rel=5e-3)


def test_rotation_offset_and_scale_are_in_gon_metres_and_as_a_factor() -> None:
    s = solution()
    text = text_report(s)
    for name in ("scan", "model", "station"):
        _, values, _ = of_frame(text, name)
        e = s.unknown("frame", name)
        omega, phi, kappa = (GON * float(v) for v in values[1:4])
        turns = [exp_rotation(np.eye(3)[i] * a) for i, a in enumerate((omega, phi, kappa))]
        off = log_rotation(exp_rotation(e.values[None, :3])[0].T @ turns[0] @ turns[1] @ turns[2])
        assert np.abs(off).max() < 2 * FOUR_PLACES * GON
        assert np.array(values[4:7], dtype=float) == pytest.approx(e.values[3:6], abs=5e-3)
    assert of_frame(text, "scan")[1][7] == "1"
    assert float(of_frame(text, "model")[1][7]) == pytest.approx(
        np.exp(s.unknown("frame", "model")["ln_scale"]), abs=1e-6
    )


def test_what_is_held_and_weighted_is_told_under_the_values() -> None:
    text = text_report(solution())
    assert of_frame(text, "station")[2][1:3] == ["held", "held"]
    assert of_frame(text, "station")[2][4:] == ["held"] * 4
    assert of_frame(text, "scan")[2][7] == "held"
    network = three_frames()
    del network.frames["scan"]
    network.add_frame("scan", origin=MIDDLE.tolist(), sigma={"ln_scale": 1e-4})
    words = of_frame(text_report(adjust(network)), "scan")
    assert float(words[1][7]) == pytest.approx(1.0, abs=3e-4)
    assert words[2][7].endswith("(w)")


def test_the_angles_of_a_frame_have_standard_deviations_of_their_own() -> None:
    """Those about the axes of the frame, turned by ∂(ω, φ, κ)/∂θ from central differences."""
    s = solution()
    rotation = exp_rotation(s.unknown("frame", "model").values[None, :3])[0]

    def angles(r: np.ndarray) -> np.ndarray:
        return np.array(
            [np.arctan2(-r[1, 2], r[2, 2]), np.arcsin(r[0, 2]), np.arctan2(-r[0, 1], r[0, 0])]
        )

    h = 1e-6
    turn = np.stack(
        [
            (angles(rotation @ exp_rotation(h * a)) - angles(rotation @ exp_rotation(-h * a)))
            / (2 * h)
            for a in np.eye(3)
        ],
        axis=1,
    )
    covariance = s.variable_covariance(("frame", "model"))[:3, :3]
    expected = np.sqrt(np.diag(turn @ covariance @ turn.T)) / GON * 1e3
    found = np.array(of_frame(text_report(s), "model")[2][1:4], dtype=float)
    assert found == pytest.approx(expected, rel=5e-3)


def test_observations_stand_under_their_frame_and_name_it() -> None:
    text = text_report(solution(), ReportOptions(most=100))
    lines = section(text, "Adjusted observations, station by station")[2:]
    firsts = [line[2:10].strip() for line in lines if line.startswith("  ")]
    assert [f for f in firsts if f in FRAMES] == list(FRAMES)
    assert solution().network.observations["1"].label() == "frame_coordinate scan P0"
    assert "frame coordinate  model P4 z" in text


def test_the_heading_of_other_unknowns_is_not_theirs() -> None:
    assert "distance meters, frame" not in text_report(solution())


def test_the_tables_have_gon_and_metres_and_the_frame_of_each_observation(tmp_path) -> None:
    s = solution()
    write_solution(s, tmp_path)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "unknowns.csv").read_text("utf-8"))))
    found = {(r["name"], r["component"]): r for r in rows if r["kind"] == "frame"}
    e = s.unknown("frame", "model")
    for i, component in enumerate(e.names):
        row = found["model", component]
        size = {"gon": GON, "m": 1.0, "": 1.0}[row["unit"]]
        assert float(row["value"]) * size == pytest.approx(e.values[i], rel=1e-14)
        assert float(row["sigma"]) * size == pytest.approx(e.sigmas[i], rel=1e-8)
        assert row["state"] == "free"
    assert found["station", "rx"]["state"] == "held"
    rows = list(csv.DictReader(io.StringIO((tmp_path / "observations.csv").read_text("utf-8"))))
    assert [(r["frame"], r.get("station", ""), r["point"], r["component"]) for r in rows[:2]] == [
        ("scan", "", "P0", "x"),
        ("scan", "", "P0", "y"),
    ]
    table = s.unknown_table()
    of_model = (table["kind"] == "frame") & (table["name"] == "model")
    assert table["value"][of_model] == pytest.approx(e.values, abs=0)


@pytest.mark.parametrize("angle", ["gon", "deg", "dms"])
def test_the_adjusted_network_is_written_and_is_at_rest_when_it_is_read(angle, tmp_path) -> None:
    s = solution()
    write_project(s.as_network(), tmp_path / "project.toml", units=Units(angle=angle))
    header = (tmp_path / "frames.csv").read_text("utf-8").splitlines()[0]
    assert f"rx_{'deg' if angle == 'dms' else angle}" in header
    again: Network = read_project(tmp_path)
    for name, frame in s.as_network().frames.items():
        assert again.frames[name] == frame
    after = adjust(again)
    assert after.iterations <= 1
    assert after.vtpv == pytest.approx(s.vtpv, rel=1e-9)
