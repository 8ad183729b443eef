"""Networks in parts tell what whole ones do: points at a second place, and what was left out."""

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.parts.whole_network import adjust_cut
from factorgraph_adj.report.doubtful_results import doubts_of_solution
from factorgraph_adj.report.result_files import parts_report
from tests.networks.well_determined import seen_once, well_determined


def trilaterations(*, mirror: bool):
    """Two fields of points; one point of the first has two distances, or a third."""
    rng = np.random.default_rng(3)
    network = fga.Network("two fields")
    for east, field in ((0.0, "L"), (500.0, "R")):
        for i, (x, y) in enumerate([(0, 0), (100, 0), (100, 80), (0, 80)]):
            network.add_point(f"{field}{i}", (east + x, y, 0.0), fixed="xyz")
        network.add_point(f"{field}P", (east + 40.0, 30.0, 0.0), fixed="z")
        for i in range(4):
            distance(network, f"{field}{i}", f"{field}P", rng)
    network.add_point("M", (50.0, 20.0, 0.0), fixed="z")
    for station in ("L0", "L1", *(() if mirror else ("L2",))):
        distance(network, station, "M", rng)
    distance(network, "LP", "RP", rng)
    return network


def distance(network, a, b, rng):
    d = np.subtract(network.points[a].coordinates, network.points[b].coordinates)
    value = float(np.linalg.norm(d) + rng.normal(0, 0.002))
    network.add(fga.HorizontalDistance(a, b, value, sigma=0.002))


def region(name):
    return "right" if name.startswith("R") else "left"


def test_a_point_with_a_mirror_place_is_told_as_in_the_whole_network():
    network = trilaterations(mirror=True)
    whole = fga.adjust(network)
    parts = adjust_cut(network, region, client=None, folder=None, variance="a-priori")
    assert len(parts.jobs) == 2
    assert parts.second_places == whole.second_places != ()
    assert "point 'M' fits equally well at" in parts.second_places[0]
    assert doubts_of_solution(parts) == list(whole.second_places)
    assert "point 'M' fits equally well" in parts_report(parts)


def test_a_third_distance_leaves_nothing_to_tell():
    network = trilaterations(mirror=False)
    parts = adjust_cut(network, region, client=None, folder=None, variance="a-priori")
    assert parts.second_places == ()


def test_what_is_not_determined_is_left_out_of_parts_too(tmp_path, capsys):
    network = well_determined()
    seen_once(network, np.random.default_rng(1))
    with pytest.raises(fga.AdjustmentError):
        adjust_cut(network, 2, client=None, folder=None, variance="a-priori")
    parts = adjust_cut(
        network, 2, client=None, folder=None, variance="a-priori", leave_out_undetermined=True
    )
    whole = fga.adjust(network, leave_out_undetermined=True)
    assert list(parts.unknowns_left_out) == whole.network.unknowns_left_out
    assert parts.vtpv == pytest.approx(whole.vtpv, rel=1e-9)
    fga.write_project(network, tmp_path / "loose" / "project.toml")
    command = ["adjust", str(tmp_path / "loose"), "--parts", "2", "--leave-out-undetermined"]
    assert main(command) == 0
    output = capsys.readouterr()
    told = "1 unknown left out with 1 observation: point X"
    assert told in output.err
    assert told in output.out
