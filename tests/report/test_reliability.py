"""What report and tables say of reliability, gross errors, weights and error ellipses."""

from __future__ import annotations

import csv
import json
import os
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import AdjustmentError, InputError
from factorgraph_adj.io.csv_tables import write_columns
from factorgraph_adj.io.file_transaction import write_files
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.error_ellipses import error_ellipse, error_ellipsoid, height_interval
from factorgraph_adj.quality.parameter_significance import significance
from factorgraph_adj.quality.rejections import RejectedPoint, Round, Unresolved
from factorgraph_adj.quality.reliability import point_redundancy
from factorgraph_adj.quality.snooping import snoop
from factorgraph_adj.quality.variance_components import estimate_variance_components
from factorgraph_adj.report import layout
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import Provenance, ReportOptions
from factorgraph_adj.report.reliability import weakest_points
from factorgraph_adj.report.result_files import write_solution, write_tables
from factorgraph_adj.report.text import render_text, text_report
from factorgraph_adj.units import ANGLE
from tests.networks.exchanged_day import day
from tests.networks.simulated import NETWORKS, gnss, levelling
from tests.networks.small_block import blundered, box, small_block
from tests.support.printed import assert_printed, cells, row, section

LONG = pytest.mark.slow("tables after many rejections; short tests print those of few")

NINE_DIGITS = 1e-8
"""What a table's figures are rounded to, relative."""


@cache
def solution():
    return adjust(small_block())


@cache
def snooped():
    return snoop(blundered())


@cache
def weighted():
    return estimate_variance_components(small_block())


def points_of(s) -> list[set[str]]:
    """Return the names of the points that each scalar row touches."""
    names = s.equations.unknowns["point"].names
    out = []
    for block in s.equations.blocks:
        touched = [index for kind, index in block.variables if kind == "point"]
        for i in range(block.n):
            out += [{names[index[i]] for index in touched}] * block.dimension
    return out


def words_of(text: str, heading: str) -> str:
    """Return a section as one line of words."""
    return " ".join(" ".join(words) for words in section(text, heading))


def read(path):
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def numbers(rows, column: str) -> np.ndarray:
    """Return a column as numbers; NaN where it is empty."""
    return np.array([float(r.get(column) or "nan") for r in rows])


def assert_column(rows, column: str, values) -> None:
    """A column holds the values, and nothing where they are not finite."""
    values = np.asarray(values, dtype=float)
    expected = np.where(np.isfinite(values), values, np.nan)
    np.testing.assert_allclose(numbers(rows, column), expected, rtol=NINE_DIGITS, atol=1e-300)


# -- redundancy by kind ---------------------------------------------------------------------------


def test_redundancy_numbers_stand_by_kind():
    s = solution()
    rel, text = fga.reliability(s), text_report(s)
    assert "Reliability (α0 = 0.1 %, power 80 %: δ0 = 4.13)" in text
    kinds = np.array(s.observations.kinds)
    for kind in ("direction", "slope_distance", "height_difference", "image"):
        r = rel.redundancy_numbers[kinds == kind]
        label = kind.split("_")
        words = next(w for w in section(text, "Reliability") if w[: len(label)] == label)
        figures = words[len(label) :]
        assert figures[0] == str(len(r))
        for word, value in zip(figures[1:5], (r.sum(), r.min(), r.mean(), r.max()), strict=True):
            assert_printed(word, value)
        size = {"direction": ANGLE["mgon"], "image": 1e-3}.get(kind, 1e-3)
        median = float(np.median(rel.mdb[kinds == kind])) / size
        assert float(figures[5]) == pytest.approx(median, rel=0.5e-2)
        assert figures[7] == "–"
    total = row(text, "Reliability", "all")
    assert total[1] == str(s.n_observations)
    assert_printed(total[2], s.redundancy)


def test_probabilities_are_the_user_s():
    text = text_report(solution(), ReportOptions(alpha=0.05, power=0.9))
    rel = fga.reliability(solution(), alpha=0.05, power=0.9)
    assert f"Reliability (α0 = 5 %, power 90 %: δ0 = {rel.delta0:.2f})" in text
    assert f"|w| above {rel.critical_w:.2f}" in text


def test_probabilities_that_are_none_are_refused():
    with pytest.raises(InputError, match="between 0 and 1, alpha below power"):
        ReportOptions(alpha=2.0)
    with pytest.raises(InputError, match="confidence must lie between 0 and 1"):
        ReportOptions(confidence=95)
    with pytest.raises(InputError, match="unknown test 'w'; valid: baarda, pope, or none"):
        ReportOptions(test="w")


def test_what_nothing_controls_is_named():
    """E hangs on one levelled line."""
    text = text_report(adjust(levelling()))
    words = words_of(text, "Reliability")
    assert "so that no error of theirs shows: height difference D E" in words
    assert "points with no controlled observation: E" in words
    assert row(text, "Reliability", "height")[-1] == "1"


def test_many_uncontrolled_observations_are_cut_with_their_number():
    network = levelling()
    for i in range(12):
        network.add_point(f"S{i}", (0, 0, 0), fixed="xy")
        network.add(o.HeightDifference("A", f"S{i}", 1.0, sigma=0.001))
    words = words_of(text_report(adjust(network)), "Reliability")
    assert "… (13 in all, see the table observations.csv (option --out))" in words
    assert "points with no controlled observation: E, S0, S1, S2, S3, S4, S5, S6 … (13 in all)" in (
        words
    )


def test_factors_of_the_user_have_their_redundancy():
    import gtsam

    network = small_block()
    keys = fga.build_graph(network).keys
    ends = keys.key("point", "P1"), keys.key("point", "P2")
    distance = float(np.linalg.norm(np.subtract(box()["P1"], box()["P2"])))
    taped = gtsam.RangeFactor3(*ends, distance, gtsam.noiseModel.Isotropic.Sigma(1, 0.0005))
    s = fga.adjust(network, extra_factors=[taped])
    extra = fga.reliability(s).redundancy_of_extra_factors
    words = row(text_report(s), "Reliability", "further")
    assert words[2] == "1"
    assert_printed(words[3], extra)


# -- weakest --------------------------------------------------------------------------------------


def test_the_weakest_observations_stand_with_what_they_can_hide():
    s = solution()
    rel = fga.reliability(s)
    rows = section(text_report(s), "Weakest observations")[2:7]
    worst = np.argsort(rel.redundancy_numbers, kind="stable")[:5]
    for words, r in zip(rows, Report(s).rows.at(worst.tolist()), strict=True):
        i = r.number
        if np.isfinite(rel.largest_effect[i]):
            assert float(words.pop()) == pytest.approx(1000 * rel.largest_effect[i], rel=0.5e-2)
        assert float(words.pop()) == pytest.approx(rel.delta_bar[i], rel=0.5e-2)
        if r.scale.small:
            assert words.pop() == r.scale.small
        assert float(words.pop()) == pytest.approx(rel.mdb[i] / r.scale.size, rel=0.5e-2)
        assert float(words.pop()) == pytest.approx(rel.redundancy_numbers[i], rel=0.5e-2)
        assert " ".join(words).startswith(f"{r.kind_name} {r.what}")


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@pytest.mark.parametrize("name", list(NETWORKS))
def test_the_weakest_points_are_those_of_all_effects_of_all_observations(name):
    """Against every effect of every controlled observation on every point."""
    s = adjust(NETWORKS[name]())
    rel = fga.reliability(s)
    rows = np.flatnonzero(rel.controlled & (np.nan_to_num(rel.largest_effect) > 0))
    if len(rows) > 400:  # all points that the 400 largest move come before the others
        rows = rows[np.argsort(-rel.largest_effect[rows])][:400]
    worst: dict[str, float] = {}
    touched = points_of(s)
    for i in rows.tolist():
        effects = rel.effect_on(i, sorted(touched[i]))
        for e in effects:
            worst[e.name] = max(worst.get(e.name, 0.0), float(np.linalg.norm(e.values)))
    expected = sorted((e for e in worst.values() if e > 0), reverse=True)[:5]
    found = weakest_points(rel, 5)
    np.testing.assert_allclose([p.effect for p in found], expected, rtol=1e-6)
    for p in found:
        moved = rel.effect_on(p.row, p.name)
        assert np.linalg.norm(moved) == pytest.approx(p.effect, rel=1e-6)


def test_every_point_counts_its_observations():
    s = solution()
    found, rel = point_redundancy(fga.reliability(s)), fga.reliability(s)
    names = s.equations.unknowns["point"].names
    touched = points_of(s)
    for i, name in enumerate(names):
        mine = [k for k, points in enumerate(touched) if name in points]
        assert found.rows[i] == len(mine)
        assert found.redundancy[i] == pytest.approx(rel.redundancy_numbers[mine].sum())
        assert found.mean[i] == pytest.approx(rel.redundancy_numbers[mine].mean())
        assert found.uncontrolled[i] == 0


def test_mean_redundancy_of_points_is_none_without_observations_and_not_negative():
    """E hangs on one line, whose r is 0 but for rounding; F has no observation."""
    network = levelling()
    network.add_point("F", (0, 0, 0), fixed="xyz")
    s = adjust(network)
    found = point_redundancy(fga.reliability(s))
    number = s.equations.unknowns["point"].number
    assert 0.0 <= found.mean[number["E"]] < 1e-9
    assert np.isnan(found.mean[number["F"]])
    below = replace(found, redundancy=np.full(len(found.rows), -1e-17))
    assert set(below.mean[found.rows > 0].tolist()) == {0.0}


def test_a_small_network_lists_each_observation_once():
    """All of them stand in the list by stations, with their r and test values."""
    text = text_report(adjust(levelling()))
    assert "Weakest observations" not in text
    assert len(section(text, "Adjusted observations")) == 2 + 6 + 1
    assert text.count("-4.1003") == 1
    assert len(section(text, "Largest test values")) == 1
    assert "Weakest points" in text


# -- suspects -------------------------------------------------------------------------------------


def test_suspects_stand_with_estimated_and_detectable_errors():
    s = adjust(blundered())
    rel, text = fga.reliability(s), text_report(s)
    above = int(np.sum(np.abs(rel.w) > rel.critical_w))
    assert above >= 2
    rows = section(text, "Suspects: |w| above 3.29 (α0 = 0.1 %)")
    order = np.argsort(-np.abs(rel.w))
    for words, i in zip([rows[2], rows[3]], order.tolist(), strict=False):
        r = Report(s).rows.at([i])[0]
        v, unit, sigma, redundancy, w, error, detectable = words[-7:]
        size = r.scale.size
        assert unit == r.scale.small
        assert float(v) == pytest.approx(r.residual / size, rel=0.5e-2)
        assert float(sigma) == pytest.approx(r.sigma / size, rel=0.5e-2)
        assert_printed(redundancy, rel.redundancy_numbers[i])
        assert_printed(w, rel.w[i])
        assert float(error) == pytest.approx(rel.estimated_errors[i] / size, rel=0.5e-2)
        assert float(detectable) == pytest.approx(rel.mdb[i] / size, rel=0.5e-2)


def test_a_suspect_names_what_it_is_not_to_be_told_apart_from():
    """B is between two levelled lines only: an error of one is an error of the other."""
    network = levelling()
    network.observations["AB"] = replace(network.observations["AB"], value=3.25)
    s = adjust(network)
    rows = section(text_report(s), "Suspects")
    texts = [" ".join(words) for words in rows]
    note = texts[1 + next(i for i, t in enumerate(texts) if t.startswith("height difference A B"))]
    assert note.startswith("not distinguishable from: height difference B C (+1.00)")


def test_without_a_suspect_nothing_is_said_to_be_inseparable():
    text = text_report(adjust(levelling()))
    assert "none above the critical |w| = 3.29" in text
    assert "distinguishable" not in text


def test_test_values_of_an_a_posteriori_adjustment_are_tau():
    s = adjust(small_block(), variance="a-posteriori")
    rel = fga.reliability(s)
    text = text_report(s)
    assert f"none above the critical |τ| = {rel.critical_tau:.2f}" in text
    rows = section(text, "Largest test values")
    assert_printed(rows[2][-3].lstrip("-"), np.abs(rel.tau).max())
    assert "|w|" in text_report(s, ReportOptions(test="baarda"))
    assert "|τ|" in text_report(solution(), ReportOptions(test="pope"))


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (4.0, "w refers to the stated σ, which are too large"),
        (0.1, "one gross error makes other test values large too"),
    ],
)
def test_a_sigma0_that_makes_test_values_meaningless_is_said(factor, words):
    network = small_block()
    network.images.sigma = [s * factor for s in network.images.sigma]
    s = adjust(network)
    assert words in " ".join(text_report(s).split())
    assert words not in " ".join(text_report(s, ReportOptions(test="pope")).split())


def test_the_number_of_suspects_that_are_left_out_is_said():
    network = small_block()
    network.images.sigma = [s * 0.1 for s in network.images.sigma]
    s = adjust(network)
    rel = fga.reliability(s)
    above = int(np.sum(np.abs(rel.w) > rel.critical_w))
    assert above > 20
    assert f"… {above - 15} more above the critical value" in text_report(s)
    assert f"… {above - 4} more above the critical value" in render_text(
        Report(s, ReportOptions(n_suspects=4))
    )


def test_correlated_groups_are_tested_as_such():
    network = gnss()
    fine = text_report(adjust(network))
    assert re.search(r"\d+ correlated groups tested as such: T of none above", fine)
    name = next(i for i, x in network.observations.items() if x.names() == ("A", "C"))
    vector = network.observations[name]
    x, y, z = vector.value
    network.observations[name] = replace(vector, value=(x + 0.1, y, z))
    s = adjust(network)
    worst = max(fga.reliability(s).groups, key=lambda g: g.test / g.critical)
    rows = section(text_report(s), "Correlated groups whose test T is above")
    assert " ".join(rows[2][:4]) == "gnss vector A C"
    assert rows[2][4] == str(worst.dof)
    assert_printed(rows[2][6], worst.test)
    assert_printed(rows[2][7], worst.critical)


# -- where there is nothing to say ----------------------------------------------------------------


def short_chain(more: int) -> Network:
    """Return one levelled height, and more observations of it."""
    network = Network("chain")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (0, 0, 1), fixed="xy")
    for i in range(1 + more):
        network.add(o.HeightDifference("A", "B", 1.0 + 1e-4 * i, sigma=0.001))
    return network


def test_without_redundancy_there_is_no_reliability():
    text = text_report(adjust(short_chain(0)))
    assert "no redundancy: no observation checks another" in text
    for heading in ("Reliability", "Weakest", "Suspects", "Largest"):
        assert heading not in text


def test_one_redundant_observation_can_find_but_not_locate():
    text = text_report(adjust(short_chain(1)))
    assert "an error would show, but not which observation it is in" in words_of(
        text, "Reliability"
    )


def test_reliability_of_an_unfinished_adjustment_says_so():
    text = text_report(adjust(small_block(), max_iterations=1))
    assert "not converged: these figures belong to the state where the iteration" in text


def test_why_there_is_no_reliability_is_said(monkeypatch, tmp_path):
    def weak(*_, **__):
        raise AdjustmentError("no reliability: the network is too weak to compute them")

    monkeypatch.setattr("factorgraph_adj.report.adjustment_report.reliability", weak)
    text = text_report(solution())
    assert words_of(text, "Reliability") == (
        "no reliability: the network is too weak to compute them"
    )
    rows = section(text, "Largest normalised residuals")
    largest = np.abs(solution().observations.normalised).max()
    assert_printed(rows[2][-1].lstrip("-"), largest)
    write_solution(solution(), tmp_path)
    observations = read(tmp_path / "observations.csv")
    assert len(observations) == solution().n_observations
    assert "redundancy_number" not in observations[0]
    found = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert found["reliability"] == {
        "reason": "no reliability: the network is too weak to compute them"
    }


# -- error ellipses -------------------------------------------------------------------------------


@pytest.mark.parametrize("variance", ["a-priori", "a-posteriori"])
def test_ellipses_stand_beside_coordinates_where_they_are_asked_for(variance):
    s = adjust(small_block(), variance=variance)
    assert "azimuth" not in text_report(s)
    text = text_report(s, ReportOptions(confidence=0.95))
    for name in ("P1", "P7"):
        e = error_ellipse(s, name)
        found = cells(text, "Adjusted coordinates", name)
        assert_printed(found["a"], 1000 * e.semi_axes[0])
        assert_printed(found["b"], 1000 * e.semi_axes[1])
        assert_printed(found["azimuth a"], e.azimuth / ANGLE["gon"])
    assert f"95 % error ellipses in the horizon, {e.factor:.3f} × standard ellipse" in text
    held = cells(text, "Adjusted coordinates", "S1")
    assert [held[k] for k in ("σz", "a", "b", "azimuth a")] == ["held", "", "", ""]


def test_azimuths_follow_the_unit_of_angles():
    s = solution()
    azimuth = error_ellipse(s, "P1").azimuth
    text = text_report(s, ReportOptions(confidence=0.9, units=Units(angle="dms")))
    word = cells(text, "Adjusted coordinates", "P1")["azimuth a"]
    degrees, minutes, seconds = (int(part) for part in word.split("-"))
    assert degrees + minutes / 60 + seconds / 3600 == pytest.approx(np.degrees(azimuth), abs=2e-4)
    text = text_report(s, ReportOptions(confidence=0.9, units=Units(angle="cc")))
    word = cells(text, "Adjusted coordinates", "P1")["azimuth a"]
    assert float(word) == pytest.approx(azimuth / ANGLE["cc"], abs=500)


def test_heights_alone_have_intervals():
    s = adjust(levelling())
    text = text_report(s, ReportOptions(confidence=0.99))
    interval = height_interval(s, "C", confidence=0.99)
    assert_printed(cells(text, "Adjusted coordinates", "C")["± z"], 1000 * interval.half_width)
    assert "± z: 99 % interval, 2.576 σ" in text
    assert "ellips" not in text


def test_projection_centres_have_ellipsoids():
    s = solution()
    text = text_report(s, ReportOptions(confidence=0.95))
    heading = "Projection centres: 95 % error ellipsoids, 2.795 × standard ellipsoid"
    e = error_ellipsoid(s, ("pose", "F2"))
    words = row(text, heading, "F2")
    figures = zip(e.semi_axes, e.azimuths, e.dips, strict=True)
    for i, (size, azimuth, dip) in enumerate(figures):
        assert_printed(words[1 + 3 * i], 1000 * size)
        assert_printed(words[2 + 3 * i], azimuth / ANGLE["gon"])
        assert_printed(words[3 + 3 * i], dip / ANGLE["gon"])


def test_tables_have_ellipses_with_their_confidence(tmp_path):
    s = solution()
    write_solution(s, tmp_path, ReportOptions(confidence=0.95, units=Units(angle="dms")))
    for r in read(tmp_path / "points.csv"):
        e = error_ellipse(s, r["name"])
        assert r["confidence"] == "0.95"
        assert_column([r], "ellipse_major_mm", [1000 * e.semi_axes[0]])
        assert_column([r], "ellipse_minor_mm", [1000 * e.semi_axes[1]])
        assert_column([r], "ellipse_azimuth_deg", [np.degrees(e.azimuth)])
        half = height_interval(s, r["name"]).half_width
        assert_column([r], "height_half_width_mm", [1000 * half])
    for r in read(tmp_path / "photos.csv"):
        ellipsoid = error_ellipsoid(s, ("pose", r["name"]))
        for i in range(3):
            assert_column([r], f"ellipsoid_axis{i + 1}_mm", [1000 * ellipsoid.semi_axes[i]])
            assert_column([r], f"ellipsoid_azimuth{i + 1}_deg", [np.degrees(ellipsoid.azimuths[i])])
            assert_column([r], f"ellipsoid_dip{i + 1}_deg", [np.degrees(ellipsoid.dips[i])])


def test_tables_without_a_confidence_have_no_ellipses(tmp_path):
    write_solution(solution(), tmp_path)
    for name in ("points", "photos"):
        assert not any("ellips" in c for c in read(tmp_path / f"{name}.csv")[0])


# -- tests of parameters --------------------------------------------------------------------------


def test_calibrations_stand_with_their_tests():
    s = solution()
    text, test = text_report(s), significance(s)
    k1, k2 = test["D3", "k1"], test["D3", "k2"]
    words = row(text, "Calibration of D3", "k1")
    assert_printed(words[3], k1.t)
    assert words[4:] == (["significant"] if k1.significant else ["not", "significant"])
    words = row(text, "Calibration of D3", "k2")
    assert_printed(words[3], k2.t)
    assert words[4] == "weighted"
    assert len(row(text, "Calibration of D3", "c")) == 3
    assert "significant from 1.96 (95 %)" in text


def test_overparametrised_cameras_are_warned_of_by_name():
    network = small_block()
    camera = network.cameras["D3"]
    free = ("c", "x0", "y0", "k1", "k2", "k3")
    held = tuple(n not in free for n in camera.lens.names)
    network.cameras["D3"] = replace(camera, fixed=held, sigma=(np.inf,) * len(held))
    s = adjust(network)
    sentences = significance(s).overparametrised
    assert any("k2 of camera 'D3' and k3" in t for t in sentences)
    words = words_of(text_report(s), "Overparametrised")
    assert all(t in words for t in sentences[:10])
    assert "Overparametrised" not in text_report(adjust(levelling()))


def test_the_table_of_unknowns_has_the_tests(tmp_path):
    s = solution()
    write_solution(s, tmp_path)
    test = significance(s)
    rows = {(r["name"], r["component"]): r for r in read(tmp_path / "unknowns.csv")}
    for p in test.parameters:
        r = rows[p.name, p.component]
        assert_column([r], "t", [p.t])
        assert r["significant"] == ("yes" if p.significant else "no")
    assert rows["D3", "p1"]["t"] == ""


# -- tables ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["combined block", "gnss", "levelling, held", "held photo"])
def test_the_table_of_observations_holds_every_figure(name, tmp_path):
    s = adjust(NETWORKS[name]())
    rel = fga.reliability(s, alpha=0.01, power=0.9)
    write_solution(s, tmp_path, ReportOptions(alpha=0.01, power=0.9))
    rows = read(tmp_path / "observations.csv")
    size = np.array([r.scale.size for r in Report(s).rows.all()])
    for column, values in {
        "redundancy_number": rel.redundancy_numbers,
        "e1": rel.e1,
        "e2": rel.e2,
        "e12": rel.e12,
        "w": rel.w,
        "tau": rel.tau,
        "mdb": rel.mdb / size,
        "delta_bar": rel.delta_bar,
        "largest_effect_mm": np.where(rel.controlled, rel.largest_effect * 1000, np.nan),
        "estimated_error": rel.estimated_errors / size,
        "residual": s.observations.residuals / size,
    }.items():
        assert_column(rows, column, values)
    assert [r["controlled"] for r in rows] == ["yes" if c else "no" for c in rel.controlled]
    assert [r.get("component", "") for r in rows] == [x.component for x in s.observations]
    assert "set_aside" not in rows[0]


def test_the_solution_as_json_sums_reliability_up(tmp_path):
    s = adjust(blundered())
    rel = fga.reliability(s)
    write_solution(s, tmp_path)
    found = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["reliability"]
    assert found["redundancy_number"]["sum"] == pytest.approx(s.redundancy)
    assert found["redundancy_number"]["minimum"] == rel.redundancy_numbers.min()
    assert found["above_critical"] == int(np.sum(np.abs(rel.w) > rel.critical_w))
    assert found["suspects"][0]["test_value"] == rel.suspects(1)[0].value
    assert sum(g["sum"] for g in found["observations"]) == pytest.approx(s.redundancy)


# -- data snooping --------------------------------------------------------------------------------


def test_what_was_set_aside_stands_with_its_errors():
    k = snooped()
    assert len(k.rejected) == 2
    text = text_report(k.solution, provenance=Provenance(snooping=k, original=blundered()))
    assert f"2 observations rejected in {k.rounds[-1].number} rounds; {k.reason[:20]}" in text
    assert "Data snooping (Baarda's w, critical |w| 3.29)" in text
    lines = [" ".join(w) for w in section(text, "Data snooping")]
    rounds = text.partition("  round ")[2].splitlines()[2 : 2 + len(k.rounds)]
    for line, r in zip(rounds, k.rounds, strict=True):
        words = line.split()
        assert words[0] == str(r.number)
        assert_printed(words[2], r.largest)
        assert words[3:] == [str(r.suspects), str(r.set_aside or "–"), str(r.readmitted or "–")]
    assert lines
    rows = Report(k.solution, provenance=Provenance(snooping=k, original=blundered())).set_aside
    for r in k.rejected:
        line = next(
            x.split()
            for x in text.splitlines()
            if rows.find(r.id, r.component).what in x and "final" not in x
        )
        size = rows.find(r.id, r.component).scale.size
        number, test, error, unit, final, sigma, last = line[-7:]
        assert number == str(r.round)
        assert_printed(test, r.test)
        assert float(error) == pytest.approx(r.estimated_error / size, rel=0.5e-2)
        assert unit in ("mm", "um")
        assert float(final) == pytest.approx(r.final_error / size, rel=0.5e-2)
        assert float(sigma) == pytest.approx(r.final_sigma / size, rel=0.5e-2)
        assert_printed(last, r.final_test)


def test_a_clean_network_says_in_one_line_that_nothing_was_set_aside():
    network = small_block()
    k = snoop(network)
    assert not k.rejected
    words = section(
        text_report(k.solution, provenance=Provenance(snooping=k, original=network)),
        "Data snooping",
    )
    assert " ".join(words[0]).startswith("nothing rejected in 1 round; ")
    assert len(words) <= 2


@LONG
def test_what_was_set_aside_before_the_first_round_is_counted():
    """Data snooping begins without exchanged sights: "nothing rejected" would be untrue."""
    network = day(1, most=25).network
    k = snoop(network)
    n = len(k.rejected)
    assert n
    assert all(r.round == 0 for r in k.rejected)
    text = text_report(k.solution, provenance=Provenance(snooping=k, original=network))
    words = section(text, "Data snooping")
    told = f"{n} observations rejected before the first round, no others in 1 round; "
    assert " ".join(words[0]).startswith(told)
    assert "robust" not in text.partition("Data snooping")[2]


def test_every_outcome_of_snooping_is_told():
    k = snooped()
    left = k.solution.observations[0]
    k = replace(
        k,
        readmitted=("F1/P3", k.rejected[0].id),
        rejected_points=(RejectedPoint("P9", ("F1/P9",), "image F1 P9 x", 7.5, 2, "no way"),),
        unresolved=(
            Unresolved(left.id, left.kind, "?", left.component, 5.5, 0.003, "needed by all"),
        ),
        rounds=(Round(0, 2.0, 9.0, 3, 2, 0), *k.rounds),
    )
    text = text_report(k.solution, provenance=Provenance(snooping=k, original=blundered()))
    assert "after a robust start" in text
    assert f"agrees with them: F1/P3, {k.rejected[0].id} (rejected again)" in text
    after = text.partition("points rejected with all their rays")[2].splitlines()
    assert after[3].split() == ["P9", "image", "F1", "P9", "x", "1", "2", "7.50"]
    after = text.partition("UNRESOLVED: above the critical value, but they stay in")[2]
    assert after.splitlines()[3].split()[-3] == "5.50"
    assert after.splitlines()[4].strip() == "needed by all"


def test_what_was_set_aside_has_rows_in_the_table_of_observations(tmp_path):
    k = snooped()
    write_solution(k.solution, tmp_path, provenance=Provenance(snooping=k, original=blundered()))
    rows = read(tmp_path / "observations.csv")
    n = k.solution.n_observations
    assert [r["set_aside"] for r in rows[:n]] == ["no"] * n
    assert len(rows) == adjust(blundered()).n_observations
    aside = {(r["id"], r["component"]): r for r in rows[n:]}
    assert {r["set_aside"] for r in aside.values()} == {"yes"}
    for r in k.rejected:
        found = aside[r.id, r.component]
        assert_column([found], "estimated_error", [r.final_error / 1e-3])
        assert_column([found], "residual", [-r.final_error / 1e-3])
        assert_column([found], "w", [r.final_test])


def test_snooping_has_a_table_of_its_own(tmp_path):
    k = snooped()
    write_solution(k.solution, tmp_path, provenance=Provenance(snooping=k, original=blundered()))
    rows = read(tmp_path / "snooping.csv")
    assert [(r["id"], r["state"]) for r in rows] == [(r.id, "rejected") for r in k.rejected]
    for r, x in zip(rows, k.rejected, strict=True):
        assert_column([r], "test_value", [x.test])
        assert_column([r], "estimated_error", [x.estimated_error / 1e-3])
        assert_column([r], "final_error", [x.final_error / 1e-3])
        assert_column([r], "final_sigma", [x.final_sigma / 1e-3])
        assert r["round"] == str(x.round)
    found = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["snooping"]
    assert [r["id"] for r in found["rejected"]] == [r.id for r in k.rejected]
    assert found["reason"] == k.reason


def test_all_states_of_snooping_stand_in_its_table(tmp_path):
    k = snooped()
    left = k.solution.observations[0]
    unresolved = Unresolved(left.id, left.kind, "?", left.component, 5.5, 0.003, "needed")
    k = replace(
        k,
        readmitted=("F1/P3", k.rejected[0].id),
        rejected_points=(RejectedPoint("P9", ("F1/P9",), "image F1 P9 x", 7.5, 2, "no way"),),
        unresolved=(unresolved,),
    )
    report = Report(k.solution, provenance=Provenance(snooping=k, original=blundered()))
    write_tables(report, tmp_path)
    states = [(r["id"], r["state"]) for r in read(tmp_path / "snooping.csv")]
    assert states[len(k.rejected) :] == [
        ("F1/P9", "point rejected"),
        ("F1/P3", "readmitted"),
        (left.id, "unresolved"),
    ]


def test_tables_of_an_earlier_run_do_not_stay(tmp_path):
    k = snooped()
    write_solution(k.solution, tmp_path, provenance=Provenance(snooping=k, original=blundered()))
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    assert (tmp_path / "snooping.csv").exists()
    write_solution(solution(), tmp_path)
    assert not (tmp_path / "snooping.csv").exists()
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "mine"


# -- variance components --------------------------------------------------------------------------


def test_variance_components_stand_with_their_uncertainty(tmp_path):
    found = weighted()
    text = text_report(found.solution, provenance=Provenance(components=found))
    assert "σ estimated" in text
    for c in found.components:
        label = c.name.split("_")
        words = next(w for w in section(text, "Variance components") if w[: len(label)] == label)
        figures = words[len(label) :]
        assert figures[0] == str(c.n)
        assert_printed(figures[1], c.redundancy)
        assert_printed(figures[2], c.factor)
        if c.estimated:
            assert float(figures[3]) == pytest.approx(c.sigma, rel=0.5e-2)
            assert_printed(figures[4], c.interval()[0])
            assert_printed(figures[6], c.interval()[1])
    assert found.reason in " ".join(text.split())
    write_solution(found.solution, tmp_path, provenance=Provenance(components=found))
    rows = read(tmp_path / "variance_components.csv")
    assert [r["group"] for r in rows] == [c.name for c in found.components]
    assert_column(rows, "factor", [c.factor for c in found.components])
    assert_column(rows, "sigma_factor", [c.sigma for c in found.components])
    assert_column(rows, "redundancy", [c.redundancy for c in found.components])
    summary = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert [c["name"] for c in summary["variance_components"]["components"]] == [
        c.name for c in found.components
    ]


# -- layout ---------------------------------------------------------------------------------------


def test_accents_take_no_column():
    lines = layout.table(["a", "σ̂0"], [["x", "1.25"], ["y", "δ̄"]])
    assert lines[0] == "  a    σ̂0"
    assert lines[1] == "  " + "-" * 7
    assert lines[3] == "  y     δ̄"


def test_notes_stand_under_their_rows():
    lines = layout.table(["a"], [["x"], ["y"]], notes=["", "of y"])
    assert lines[2:] == ["  x", "  y", "      of y"]


def test_the_report_of_a_healthy_small_network_is_short():
    lines = text_report(adjust(levelling())).splitlines()
    assert len(lines) < 75
    assert max(map(len, lines)) <= 110


@pytest.mark.slow(
    "every figure and page of every network is drawn or read; short tests take one report"
)
@pytest.mark.parametrize("name", list(NETWORKS))
def test_no_line_ends_in_blanks_and_no_figure_is_nan(name):
    network = NETWORKS[name]()
    k = snoop(network)
    text = text_report(
        k.solution, ReportOptions(confidence=0.95), Provenance(snooping=k, original=network)
    )
    assert not any(line != line.rstrip() for line in text.splitlines())
    assert not re.search(r"\b(nan|inf|None)\b", text)


# -- files ----------------------------------------------------------------------------------------


def test_cells_that_need_quotes_get_them():
    names = ["plain", "a,b", 'say "x"', "#1", "a#1", "semi;colon", "tab\t"]
    text = write_columns({"name": names, "empty": [""] * 7, "n": ["1"] * 7})
    assert text.splitlines()[0] == "name,n"
    assert [r["name"] for r in csv.DictReader(text.splitlines())] == names
    assert '"#1",1' in text
    assert "\na#1,1" in text


def test_files_that_are_not_to_be_there_come_back_if_writing_fails(tmp_path, monkeypatch):
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(f"old {name}", encoding="utf-8")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        real = os.replace

        def replace_once(source, target):
            if target.name == "b.csv" and "old" not in str(source.parent.name):
                raise KeyboardInterrupt
            real(source, target)

        patch.setattr("factorgraph_adj.io.file_transaction.os.replace", replace_once)
        write_files(tmp_path, {"a.csv": None, "b.csv": "new"})
    assert {f.name: f.read_text(encoding="utf-8") for f in tmp_path.iterdir()} == {
        "a.csv": "old a.csv",
        "b.csv": "old b.csv",
    }
    write_files(tmp_path, {"a.csv": None, "b.csv": "new", "c.csv": None})
    assert [f.name for f in tmp_path.iterdir()] == ["b.csv"]
