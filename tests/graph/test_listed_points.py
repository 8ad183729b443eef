"""Points that only a list has: no unknowns, kept and named; what is meant to take part is none."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.graph.listed_points import listed_points, with_listed_points_apart
from factorgraph_adj.validate.network_structure import check
from tests.networks.small_block import small_block

SIGMA = 0.002
CORNERS = {"A": (0.0, 0.0, 0.0), "B": (100.0, 0.0, 0.0), "C": (50.0, 80.0, 0.0)}
SAID = "2 listed points have no observation: they stay as listed, not adjusted: L1, L2"


def trilaterated(*, listed: bool, datum: str = "given") -> fga.Network:
    """Return a plane point by distances, with two points of a list beside them."""
    network, rng = fga.Network("list", datum=datum), np.random.default_rng(5)
    if listed:
        network.add_point("L1", (500.0, 500.0, 0.0), fixed="z")
    for name, xyz in CORNERS.items():
        network.add_point(name, xyz, fixed="xyz" if datum == "given" else "z")
    network.add_point("P", (40.0, 30.0, 0.0), fixed="z")
    if listed:
        network.add_point("L2")  # a name alone
    for name, xyz in CORNERS.items():
        for _ in range(3):
            length = float(np.linalg.norm(np.subtract((40.0, 30.0, 0.0), xyz)))
            value = length + rng.normal(0.0, SIGMA)
            network.add(fga.SlopeDistance("P", name, value, sigma=SIGMA))
    if datum == "free":
        for one, two in ("AB", "BC", "CA"):
            length = float(np.linalg.norm(np.subtract(CORNERS[one], CORNERS[two])))
            network.add(fga.SlopeDistance(one, two, length, sigma=SIGMA))
    return network


@pytest.mark.parametrize("datum", ["given", "free"])
def test_a_list_beside_the_network_changes_no_figure(datum) -> None:
    with_list, alone = (fga.adjust(trilaterated(listed=x, datum=datum)) for x in (True, False))
    assert list(with_list.network.listed_points) == ["L1", "L2"]
    assert with_list.n_unknowns == alone.n_unknowns
    assert with_list.redundancy == alone.redundancy
    assert with_list.vtpv == pytest.approx(alone.vtpv, rel=1e-12)
    for name in alone.network.points:
        np.testing.assert_allclose(with_list.point(name), alone.point(name), atol=1e-12)
        np.testing.assert_allclose(
            with_list.covariance(name), alone.covariance(name), rtol=1e-9, atol=1e-18
        )


def test_the_network_given_stays_as_it_is_and_a_network_without_a_list_is_itself() -> None:
    network = trilaterated(listed=True)
    fga.adjust(network)
    assert {"L1", "L2"} <= network.points.keys()
    assert not network.listed_points
    without = trilaterated(listed=False)
    assert with_listed_points_apart(without) is without


def test_check_has_no_problem_and_reports_name_the_points(tmp_path, capsys) -> None:
    network = trilaterated(listed=True)
    assert check(network) == ()
    fga.write_project(network, tmp_path / "p" / "project.toml")
    assert main(["check", str(tmp_path / "p")]) == 0
    assert f"note: {SAID}" in capsys.readouterr().out
    arguments = ["--out", str(tmp_path / "out"), "--report", str(tmp_path / "page.html")]
    assert main(["adjust", str(tmp_path / "p"), *arguments]) == 0
    printed = capsys.readouterr()
    assert SAID in printed.err
    assert SAID in " ".join(printed.out.split())
    assert SAID in " ".join((tmp_path / "out" / "report.txt").read_text("utf-8").split())
    assert "2 points of a list have no observation" in (tmp_path / "page.html").read_text("utf-8")
    record = json.loads((tmp_path / "out" / "results.json").read_text("utf-8"))
    assert SAID in record["notes"]
    assert main(["plan", str(tmp_path / "p")]) == 0  # L2 lacks the coordinates of planned points
    assert SAID in " ".join(capsys.readouterr().out.split())


def test_a_project_and_a_solution_that_are_written_have_the_list(tmp_path) -> None:
    solution = fga.adjust(trilaterated(listed=True))
    fga.write_project(solution.network, tmp_path / "p" / "project.toml")
    again = fga.read_project(tmp_path / "p")
    assert {"L1", "L2"} <= again.points.keys()
    assert again.points["L1"].coordinates == (500.0, 500.0, 0.0)
    solution.save(tmp_path / "s.npz")
    read = fga.load_solution(tmp_path / "s.npz")
    assert list(read.network.listed_points) == ["L1", "L2"]
    np.testing.assert_array_equal(read.point("P"), solution.point("P"))
    joined = fga.join([solution.network])
    assert {"L1", "L2"} <= joined.points.keys()


def test_points_that_are_meant_to_take_part_are_not_listed() -> None:
    network = trilaterated(listed=True)
    network.add_point("datum", (1.0, 2.0, 0.0), datum=True)
    network.add_point("weighted", (1.0, 2.0, 0.0), sigma=0.01)
    network.add_point("held", (1.0, 2.0, 0.0), fixed="xyz")
    network.add_point("station", (1.0, 2.0, 0.0))
    network.set_vertical("station", xi=1e-5)
    assert listed_points(network) == ["L1", "L2"]
    said = [str(p) for p in check(network)]
    assert any(s.startswith("points 'datum', 'station': no observation") for s in said), said


def test_an_observed_point_that_is_not_determined_stays_a_problem() -> None:
    network = trilaterated(listed=True)
    network.add(fga.SlopeDistance("P", "L1", 700.0, sigma=SIGMA))
    assert any("'L1'" in str(p) for p in check(network))
    with pytest.raises(fga.AdjustmentError, match="not determined"):
        fga.adjust(network)


def test_data_snooping_robust_adjustment_and_plans_take_the_list(tmp_path) -> None:
    network = trilaterated(listed=True)
    assert list(fga.snoop(network).network.listed_points) == ["L1", "L2"]
    assert list(fga.robust_adjust(network).solution.network.listed_points) == ["L1", "L2"]
    plan = fga.plan(network)
    assert list(plan.network.listed_points) == ["L1", "L2"]


def test_points_of_photos_are_not_listed_and_images_keep_their_points() -> None:
    block = small_block()
    plain = fga.adjust(block)
    block = small_block()
    block.add_point("list", (1.0, 2.0, 3.0))
    names = list(block.points)
    assert listed_points(block) == ["list"]
    solution = fga.adjust(block)
    assert list(solution.network.points) == names[:-1]
    assert solution.vtpv == pytest.approx(plain.vtpv, rel=1e-9)


def test_all_points_on_a_list_is_nothing_to_adjust() -> None:
    network = fga.Network()
    network.add_point("L1", (0.0, 0.0, 0.0))
    with pytest.raises(fga.InputError, match="nothing to adjust"):
        fga.adjust(network)
