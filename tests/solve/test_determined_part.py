"""What the observations do not determine is left out with all that hangs on it, and named."""

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import adjustment
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.io.project import read_project
from factorgraph_adj.io.solution_file import load_solution, save_solution
from factorgraph_adj.models.lens import BrownLens
from tests.field_mistakes.site import site
from tests.networks.well_determined import PLACES, distance, rise, seen_once, well_determined


def a_chain(network, rng):
    """Z is determined only as long as X and Y are."""
    for name in "XYZ":
        network.add_point(name, PLACES[name])
    for a, b in ("PX", "XY", "YZ", "XZ"):
        distance(network, a, b, rng)
    rise(network, "P", "Y")
    return {"X", "Y", "Z"}


def a_part_of_its_own(network, rng):
    for name in "XYZ":
        network.add_point(name, PLACES[name])
    for a, b in ("XY", "YZ", "XZ"):
        distance(network, a, b, rng)
        rise(network, a, b)
    return {"X", "Y", "Z"}


def without_coordinates(network, rng):
    for name in "XY":
        network.add_point(name)
    distance(network, "X", "Y", rng)
    return {"X", "Y"}


def a_set_of_directions(network, rng):
    """A set to one known point and one that is seen once."""
    network.add_point("X")
    network.add(fga.Direction("P", "A", 1.0, sigma=1e-5, set="s"))
    network.add(fga.Direction("P", "X", 2.0, sigma=1e-5, set="s"))
    return {"X"}


LOOSE = [
    seen_once,
    a_chain,
    a_part_of_its_own,
    without_coordinates,
    a_set_of_directions,
]


@pytest.mark.parametrize("loosen", LOOSE)
def test_what_is_loose_is_left_out_and_the_rest_stays_as_it_is_without_it(loosen):
    alone, network = fga.adjust(well_determined()), well_determined()
    lost = loosen(network, np.random.default_rng(1))
    before = list(network.observations)
    with pytest.raises(fga.AdjustmentError, match="--leave-out-undetermined"):
        fga.adjust(network)
    solution = fga.adjust(network, leave_out_undetermined=True)
    assert {x.name for x in solution.network.unknowns_left_out if x.kind == "point"} == lost
    assert solution.converged
    for name in "PQ":
        assert solution.point(name) == pytest.approx(alone.point(name), abs=1e-8)
    gone = {i for x in solution.network.unknowns_left_out for i in x.ids}
    assert gone | set(solution.network.observations) == set(before)
    assert list(network.observations) == before


def test_what_was_never_observed_is_listed_and_what_lost_its_observations_is_left_out():
    network = well_determined()
    network.add_point("listed", PLACES["X"])
    for name in "XY":
        network.add_point(name)
    distance(network, "X", "Y", np.random.default_rng(1))
    rest = fga.adjust(network, leave_out_undetermined=True).network
    assert list(rest.listed_points) == ["listed"]
    assert {x.name for x in rest.unknowns_left_out} == {"X", "Y"}


def test_a_determined_network_is_returned_itself():
    network = well_determined()
    assert fga.determined_part(network) is network


def test_a_photo_with_too_few_points_is_left_out_with_its_camera_and_the_points_it_alone_sees():
    network = well_determined()
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    network.add_photo("1", "camera", position=(40, 40, 60), omega_phi_kappa=(0, 0, 0))
    network.add_point("X", PLACES["X"])
    network.add_image_points("1", ["P", "X"], [(0.0, 8.0), (-25.0, 40.0)], sigma=0.005)
    rest = fga.determined_part(network)
    assert {(x.kind, x.name) for x in rest.unknowns_left_out} == {("pose", "1"), ("point", "X")}
    assert not rest.photos
    assert not rest.cameras
    assert rest.n_image_points == 0
    assert fga.adjust(rest).converged


def test_coefficients_are_not_left_out_nor_what_they_leave_open():
    network = fga.Network("one distance by a meter of unknown scale")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("P", (100, 0, 0), fixed="yz")
    network.set_distance_meter("m", free=("scale",))
    network.add(fga.SlopeDistance("A", "P", 100.0, sigma=0.002, instrument="m"))
    with pytest.raises(fga.DatumError):
        fga.determined_part(network)


def test_a_network_without_datum_keeps_its_error():
    network, rng = fga.Network("no datum"), np.random.default_rng(2)
    for name in "ABCD":
        network.add_point(name, PLACES[name])
    for pair in ("AB", "AC", "AD", "BC", "BD", "CD"):
        distance(network, *pair, rng)
    with pytest.raises(fga.DatumError, match="datum defect 6"):
        fga.determined_part(network)
    assert fga.determined_part(network, datum="free") is network


def test_snooping_and_robust_estimates_take_the_determined_part():
    network = well_determined()
    seen_once(network, np.random.default_rng(1))
    network.add(fga.SlopeDistance("C", "P", 58.35, sigma=0.002, id="wrong"))
    rest = fga.determined_part(network)
    found = fga.snoop(rest)
    assert found.rejected_ids == ("wrong",)
    assert [x.name for x in found.solution.network.unknowns_left_out] == ["X"]
    robust = fga.robust_adjust(rest)
    assert [x.name for x in robust.solution.network.unknowns_left_out] == ["X"]


def test_weights_of_all_observations_are_refused():
    network = well_determined()
    with pytest.raises(fga.InputError, match="weights"):
        fga.adjust(network, leave_out_undetermined=True, weights=np.ones(8))


def test_every_output_names_what_was_left_out(tmp_path, capsys):
    network = well_determined()
    seen_once(network, np.random.default_rng(1))
    project, out, page = tmp_path / "project", tmp_path / "out", tmp_path / "report.html"
    project.mkdir()
    fga.write_project(network, project / "project.toml")
    assert main(["adjust", str(project)]) != 0
    assert "--leave-out-undetermined" in capsys.readouterr().err
    options = ["--full", "--leave-out-undetermined", "--out", str(out), "--report", str(page)]
    assert main(["adjust", str(project), *options]) == 0
    printed = capsys.readouterr()
    said = "1 unknown left out with 1 observation: point X"
    assert said in printed.err
    assert said in printed.out
    assert printed.out.index(said) < printed.out.index("Observations")
    assert said in (out / "report.txt").read_text(encoding="utf-8")
    assert said in page.read_text(encoding="utf-8")
    (record,) = json.loads((out / "results.json").read_text(encoding="utf-8"))["unknowns_left_out"]
    assert (record["kind"], record["name"]) == ("point", "X")
    table = (out / "unknowns_left_out.csv").read_text(encoding="utf-8")
    assert table.splitlines()[1].startswith("point,X,")


def test_a_saved_solution_keeps_what_was_left_out(tmp_path):
    network = well_determined()
    a_chain(network, np.random.default_rng(1))
    solution = fga.adjust(network, leave_out_undetermined=True)
    save_solution(solution, tmp_path / "s.npz")
    assert (
        load_solution(tmp_path / "s.npz").network.unknowns_left_out
        == solution.network.unknowns_left_out
    )


@pytest.mark.parametrize("lost", [False, True])
def test_what_is_determined_is_adjusted_once(lost, tmp_path, monkeypatch) -> None:
    network = read_project(site().write(tmp_path / "site"))
    if lost:
        network.add_point("Z")
    iterations = []
    original = adjustment.adjust_from_start

    def counted(*given, **named):
        found = original(*given, **named)
        iterations.append(found.iterations)
        return found

    monkeypatch.setattr(adjustment, "adjust_from_start", counted)
    solution = adjustment.adjust(network, leave_out_undetermined=True, variance="a-posteriori")
    assert iterations == [solution.iterations]
    assert solution.variance == "a-posteriori"
    assert list(solution.network.listed_points) == (["Z"] if lost else [])
    assert solution.network.unknowns_left_out == []
