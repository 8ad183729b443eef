"""The report and the tables say what the solution says, in the units of the project."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from factorgraph_adj import observations as o
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import GeocentricFrame, TopocentricFrame
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.report import layout
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import ReportOptions
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.report.text import text_report
from factorgraph_adj.rotation import (
    angles_by_rotation,
    exp_rotation,
    omega_phi_kappa,
    world_R_camera,
)
from factorgraph_adj.statistical_tests import global_test
from factorgraph_adj.units import ANGLE
from tests.networks.small_block import CHECKED, box, plan, small_block
from tests.support.printed import assert_printed, cells, row, section


@cache
def solution():
    """Adjust the small block once."""
    return adjust(small_block())


def test_the_report_says_how_many_of_what():
    text = text_report(solution())
    assert "Adjustment of small block" in text
    assert re.search(r"points +14 \(1 held, 1 held in part, 1 weighted, 3 with check", text)
    assert re.search(r"cameras +D3 \(brown\)", text)
    expected = {"direction": 14, "slope": 14, "zenith": 14, "height": 6, "image": 48}
    for words in section(text, "Observations"):
        if words[0] in expected:
            assert str(expected[words[0]]) in words
    assert row(text, "Observations", "image")[1:3] == ["48", "96"]


def test_the_figures_of_the_adjustment_are_those_of_the_solution():
    s = solution()
    text = text_report(s)
    assert f"observations n        {s.n_observations}" in text
    assert f"unknowns u            {s.n_unknowns}" in text
    assert f"redundancy n − u + d  {s.redundancy}" in text
    assert f"{s.iterations}, converged: {s.reason}" in text
    assert f"{s.sigma0:.5f} (a priori 1)" in text


def test_the_global_test_is_two_sided_at_95_percent():
    s = solution()
    test = global_test(s)
    assert test.lower**2 * s.redundancy == pytest.approx(chi2.ppf(0.025, s.redundancy))
    assert test.upper**2 * s.redundancy == pytest.approx(chi2.ppf(0.975, s.redundancy))
    assert test.accepted
    assert test.sigma0 == pytest.approx(s.sigma0)
    assert (
        f"accepted: χ², two-sided, 95 %, {test.lower:.4f} ≤ σ̂0 ≤ {test.upper:.4f}" in text_report(s)
    )


@pytest.mark.parametrize(
    ("factor", "word", "hint"),
    [
        (4.0, "readings better than stated", "no sign of a gross error"),
        (0.25, "REJECTED", "blunders, systematic errors"),
    ],
)
def test_wrong_weights_are_named_with_a_hint(factor, word, hint):
    network = small_block()
    table = network.images
    table.sigma = [s * factor for s in table.sigma]
    text = text_report(adjust(network))
    assert f"global test           {word}: χ²" in text
    assert hint in text


def test_without_redundancy_there_is_nothing_to_test():
    network = Network("one distance")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (9, 0, 0), fixed="yz")
    network.add(o.SlopeDistance("A", "B", 10.0, sigma=0.01))
    s = adjust(network)
    assert global_test(s).accepted
    assert "no redundancy" in text_report(s)


def test_a_confidence_that_is_none_is_refused():
    with pytest.raises(InputError, match="between 0 and 1, not 95"):
        global_test(solution(), alpha=95)


def test_coordinates_stand_with_their_standard_deviations():
    s, text = solution(), text_report(solution())
    for name in box():
        found = cells(text, "Adjusted coordinates", name)
        for axis, value in zip("xyz", s.point(name), strict=True):
            assert_printed(found[axis], value)
        for axis, value in zip("xyz", s.standard_deviations(name) * 1000, strict=True):
            assert_printed(found[f"σ{axis}"], value)
    held = cells(text, "Adjusted coordinates", "S1")
    assert [held[f"σ{axis}"] for axis in "xyz"] == ["held"] * 3
    assert cells(text, "Adjusted coordinates", "S2")["σx"] == "held"


def test_coordinates_stand_in_the_units_of_the_project():
    s = solution()
    text = text_report(s, ReportOptions(units=Units(length="mm", sigma_length="um")))
    words = row(text, "Adjusted coordinates", "P1")
    assert_printed(words[1], s.point("P1")[0] * 1e3)
    assert_printed(words[4], s.standard_deviations("P1")[0] * 1e6)


def test_the_weakest_point_is_named():
    s = solution()
    total = {n: np.linalg.norm(s.standard_deviations(n)) for n in box()}
    worst = max(total, key=total.get)
    assert f"weakest point {worst}: {1000 * total[worst]:.2f} mm" in text_report(s)


def test_check_points_have_differences_and_their_rms():
    s, text = solution(), text_report(solution())
    differences = np.array([s.point(n) - np.array(box()[n]) for n in CHECKED]) * 1000
    for name, d in zip(CHECKED, differences, strict=True):
        for word, value in zip(row(text, "Check points", name)[1:], d, strict=True):
            assert_printed(word, value)
    rms = np.sqrt(np.mean(differences**2, axis=0))
    for word, value in zip(row(text, "Check points", "RMS")[1:], rms, strict=True):
        assert_printed(word, value)


def test_photos_stand_with_angles_and_their_standard_deviations():
    s, text = solution(), text_report(solution())
    rows = section(text, "Photos")
    place = next(i for i, words in enumerate(rows) if words[0] == "F2")
    pose = s.pose("F2")
    values = [*pose.position, *(pose.omega_phi_kappa / ANGLE["gon"])]
    assert rows[place][1] == "12"
    for word, value in zip(rows[place][3:], values, strict=True):
        assert_printed(word, value)
    sigma = rows[place + 1][-6:]
    for word, value in zip(sigma[:3], pose.sigmas[3:] * 1000, strict=True):
        assert_printed(word, value)


@pytest.mark.parametrize("angles", [(0.3, -0.7, 2.1), (-3.0, 1.2, 0.0), (0.0, 0.0, 0.0)])
def test_standard_deviations_of_angles_follow_from_those_of_rotations(angles):
    rotation, step = world_R_camera(*angles), 1e-6
    numeric = np.empty((3, 3))
    for i, axis in enumerate(np.eye(3)):
        ahead = omega_phi_kappa(rotation @ exp_rotation(step * axis))
        behind = omega_phi_kappa(rotation @ exp_rotation(-step * axis))
        numeric[:, i] = (np.array(ahead) - np.array(behind)) / (2 * step)
    assert np.allclose(angles_by_rotation(rotation), numeric, rtol=0, atol=1e-8)


def test_angles_straight_sideways_have_no_standard_deviations():
    assert np.isnan(angles_by_rotation(world_R_camera(0.1, np.pi / 2, 0.2))).all()


def test_the_calibration_stands_with_strong_correlations():
    s, text = solution(), text_report(solution())
    estimate = s.calibration("D3")
    words = row(text, "Calibration of D3", "c")
    assert_printed(words[1], estimate["c"])
    assert_printed(words[2], estimate.sigma("c"))
    assert row(text, "Calibration of D3", "k2")[4] == "weighted"
    i, j = (estimate.names.index(n) for n in ("k1", "k2"))
    assert abs(estimate.correlation[i, j]) > 0.8
    assert f"k1–k2 {estimate.correlation[i, j]:+.2f}" in text


def test_orientation_unknowns_stand_with_their_standard_deviations():
    e = solution().orientation("S2")
    text = text_report(solution(), ReportOptions(units=Units(angle="deg")))
    words = row(text, "Orientation unknowns", "S2")
    assert_printed(words[2], e.values[0] / ANGLE["deg"])
    assert_printed(words[3], e.sigmas[0] / ANGLE["arcsec"])


def test_the_largest_test_values_lead_their_list():
    s = solution()
    size = np.abs(reliability(s).w)
    rows = section(text_report(s), "Largest test values: none above the critical |w| = 3.29")[2:]
    printed = [abs(float(words[-3])) for words in rows if words[-1][-1].isdigit()]
    assert len(printed) == 15
    assert printed == sorted(printed, reverse=True)
    assert_printed(f"{printed[0]:.2f}", size.max())


def test_refraction_verticals_and_meters_stand_together():
    network = plan()
    network.set_refraction(value=0.13, sigma=0.05)
    network.set_refraction("held", fixed=True)
    network.set_vertical("S1", xi=1e-5, eta=0.0, sigma=2e-5)
    network.set_distance_meter("EDM", zero=0.001, sigma_zero=0.0005)
    for ident, found in list(network.observations.items()):
        if isinstance(found, o.SlopeDistance):
            network.observations[ident] = replace(found, instrument="EDM")
    from factorgraph_adj.simulation.measurement import measure

    s = adjust(measure(network, seed=3))
    rows = section(text_report(s), "Refraction, verticals, distance meters")

    def figures(label: str) -> list[str]:
        """Return what stands behind a label."""
        names = label.split()
        return next(w[len(names) :] for w in rows if w[: len(names)] == names)

    meter = s.distance_meter("EDM")
    assert_printed(figures("refraction κ")[0], s.refraction()["kappa"])
    given = s.network.refractions[""].values[0]
    t = (s.refraction()["kappa"] - given) / s.refraction().sigma("kappa")
    assert_printed(figures("refraction κ")[2], t)
    assert figures("refraction κ")[3] == "weighted"
    assert figures("refraction held κ")[1:] == ["held"]
    xi = s.vertical("S1")
    assert_printed(figures("vertical of S1 ξ [mgon]")[0], xi["xi"] / ANGLE["mgon"])
    assert_printed(figures("vertical of S1 ξ [mgon]")[1], xi.sigma("xi") / ANGLE["mgon"])
    assert figures("distance meter EDM scale [ppm]")[1:] == ["held"]
    assert_printed(figures("distance meter EDM zero constant [mm]")[0], meter["zero"] * 1000)


def test_a_free_network_says_what_it_leaves_free():
    network = small_block()
    for name, p in network.points.items():
        network.points[name] = replace(p, fixed=(False,) * 3, sigma=None)
    text = text_report(adjust(network, datum="free"))
    assert "free network: inner constraints over all points; free shift x y z, rotation z" in text
    assert "datum defect d        4" in text


def test_an_adjustment_that_stops_early_says_so():
    s = adjust(small_block(), max_iterations=1)
    assert "1, NOT CONVERGED: stopped after 1 iterations" in text_report(s)


def test_a_solution_without_a_covariance_is_reported_without_precision(tmp_path, monkeypatch):
    from factorgraph_adj.errors import SingularError
    from factorgraph_adj.solve.solution import Solution

    def singular(*_):
        raise SingularError("a pivot vanished")

    s = adjust(small_block(), max_iterations=1)
    monkeypatch.setattr(Solution, "variable_covariance", singular)
    text = text_report(s)
    assert "precision             none: the normal equations are singular" in text
    assert "Adjusted coordinates" not in text
    write_solution(s, tmp_path)
    assert {f.name for f in tmp_path.iterdir()} == {
        *("report.txt", "results.json", "observations.csv"),
    }


def test_a_posteriori_precision_is_named():
    s = adjust(small_block(), variance="a-posteriori")
    assert f"a posteriori: multiplied by σ̂0 = {s.sigma0:.5f}" in text_report(s)


def test_long_lists_are_cut_with_a_note_of_what_is_left_out():
    text = text_report(solution(), ReportOptions(most=3))
    assert "… 11 more points in the table points.csv (option --out)" in text
    assert "… 1 more photos in the table photos.csv (option --out)" in text
    assert len(text.splitlines()) < len(text_report(solution()).splitlines())
    assert "in results/points.csv" in text_report(
        solution(), ReportOptions(most=3, tables="results")
    )


def test_frames_are_described():
    for frame, words in (
        (GeocentricFrame("WGS84"), "geocentric, ellipsoid WGS84"),
        (TopocentricFrame(0.5, 0.1), "topocentric (east, north, up) at 28-38-52.4031"),
    ):
        network = Network(frame=frame)
        start = (6_378_137.0, 0.0, 0.0) if isinstance(frame, GeocentricFrame) else (0.0, 0.0, 0.0)
        network.add_point("A", start, fixed="xyz")
        network.add_point("B", (start[0] + 9.0, 0.0, 0.0), fixed="yz")
        network.add(o.SlopeDistance("A", "B", 10.0, sigma=0.01))
        assert words in text_report(adjust(network))


def test_no_line_of_the_report_ends_in_blanks():
    assert not any(line != line.rstrip() for line in text_report(solution()).splitlines())


# -- numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0, "0"),
        (1234.5, "1234"),
        (12.345, "12.3"),
        (37.69e6, "37690000"),
        (0.012345, "0.0123"),
        (1e-7, "1.00e-07"),
    ],
)
def test_short_numbers_have_three_digits(value, expected):
    assert layout.short(value) == expected


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (27.98152, 0.02475, "27.982"),
        (1.1227e-4, 2.07e-5, "1.12e-04"),
        (0.0, 1e-3, "0.0000"),
        (123456.0, 320.0, "123456"),
        (5.5, 0.0, "5.5"),
    ],
)
def test_values_end_where_their_standard_deviation_ends(value, sigma, expected):
    assert layout.with_sigma(value, sigma) == expected


# -- tables ---------------------------------------------------------------------------------------


def read(path):
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_tables_hold_every_figure(tmp_path):
    s = solution()
    write_solution(s, tmp_path / "out")
    points = {r["name"]: r for r in read(tmp_path / "out" / "points.csv")}
    assert list(points) == list(s.network.points)
    assert [float(points["P1"][a]) for a in "xyz"] == s.point("P1").tolist()
    covariance = s.covariance("P1") * 1e6
    assert float(points["P1"]["covariance_xy_mm2"]) == pytest.approx(covariance[0, 1], rel=1e-8)
    assert float(points["P1"]["sigma_x_mm"]) == pytest.approx(covariance[0, 0] ** 0.5, rel=1e-8)
    observations = read(tmp_path / "out" / "observations.csv")
    assert len(observations) == s.n_observations
    normalised = [float(r["normalised"]) for r in observations]
    assert np.allclose(normalised, s.observations.normalised, rtol=1e-7, atol=0)
    unknowns = {(r["kind"], r["component"]): r for r in read(tmp_path / "out" / "unknowns.csv")}
    assert float(unknowns["calibration", "k1"]["value"]) == s.calibration("D3")["k1"]
    photos = read(tmp_path / "out" / "photos.csv")
    assert [r["image_points"] for r in photos] == ["12"] * 4


def test_results_json_is_in_metres_and_radians(tmp_path):
    s = solution()
    write_solution(s, tmp_path, ReportOptions(units=Units(length="mm", angle="deg")))
    found = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert found["points"]["P1"]["xyz"] == s.point("P1").tolist()
    assert found["points"]["P1"]["sigma"] == s.standard_deviations("P1").tolist()
    assert found["sigma0"] == s.sigma0
    assert found["global_test"]["accepted"] is True
    assert found["photos"]["F1"]["omega_phi_kappa"] == s.pose("F1").omega_phi_kappa.tolist()
    assert found["calibrations"]["D3"]["values"] == s.calibration("D3").values.tolist()


def test_results_json_has_no_nan(tmp_path):
    network = Network("one distance")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (9, 0, 0), fixed="yz")
    network.add(o.SlopeDistance("A", "B", 10.0, sigma=0.01))
    write_solution(adjust(network), tmp_path)
    text = (tmp_path / "results.json").read_text(encoding="utf-8")
    assert json.loads(text)["sigma0"] is None
    assert "NaN" not in text
    assert "Infinity" not in text


def test_rows_of_control_name_their_axis():
    network = small_block()
    network.add(
        o.ControlPoint("P5", tuple(box()["P5"][i] for i in (2, 0)), axes="zx", sigma=(0.01, 0.02)),
        o.GnssPosition("P6", box()["P6"], sigma=(0.01, 0.02, 0.03)),
    )
    s = adjust(network)
    rows = list(Report(s).rows.all())
    axes = {
        kind: [r.component for r in rows if r.kind == kind and r.names]
        for kind in ("control", "gnss_position")
    }
    assert axes == {"control": ["z", "x"], "gnss_position": ["x", "y", "z"]}
    assert [r.component for r in s.observations] == [r.component for r in rows]
    weighted = [r for r in rows if r.kind == "control" and not r.names]
    assert [(r.id, r.component, r.what) for r in weighted] == [
        ("point S2 y", "y", "point S2 y"),
        ("point S2 z", "z", "point S2 z"),
    ]


def test_pixels_stay_pixels():
    network = small_block()
    camera = network.cameras["D3"]
    network.cameras["D3"] = replace(camera, unit="px")
    groups = {g.label: g for g in Report(adjust(network)).rows.groups()}
    assert groups["image"].scale.small == "px"
    assert groups["image"].sigma == (0.004, 0.004)


def test_few_cameras_are_groups_of_their_own_and_many_are_one(monkeypatch):
    network = small_block()
    camera = network.cameras["D3"]
    for i, (name, photo) in enumerate(list(network.photos.items())):
        network.cameras[f"D{i}"] = replace(camera, name=f"D{i}", fixed=(True,) * 10)
        network.photos[name] = replace(photo, camera=f"D{i}")

    def images():
        return [g.label for g in Report(found).rows.groups() if g.label.startswith("image")]

    found = adjust(network)
    assert images() == [f"image, D{i}" for i in range(4)]
    monkeypatch.setattr("factorgraph_adj.report.observation_rows.MAX_CAMERAS_GROUPED_APART", 3)
    assert images() == ["image, mm"]


def test_the_precision_of_what_has_not_converged_is_marked() -> None:
    begun = adjust(small_block(), max_iterations=1)
    assert not begun.converged
    assert text_report(begun).count("not converged: standard deviations belong to the place") == 2
    assert "standard deviations belong to the place" not in text_report(solution())
