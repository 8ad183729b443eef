"""Helmert blocks: a network in parts has the result of the whole."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS, VariableKind
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import FrameCoordinate, HeightDifference, SlopeDistance
from factorgraph_adj.parts import loaded_part
from factorgraph_adj.parts.part_files import RunFolder
from factorgraph_adj.parts.whole_network import Regions, cut_network
from factorgraph_adj.report.result_files import parts_report
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.types import Array
from tests.benchmarks.grids import simulate_grid, simulate_mixed
from tests.networks import shapes, simulated
from tests.networks.frames import network_of_frames
from tests.networks.rolling_drone import flown, measured
from tests.networks.small_block import small_block
from tests.support.places import data_dir

LONG = pytest.mark.slow(
    "runs in several processes with their files, "
    "of which short tests take the refusals at the beginning"
)

CLOSE = 1e-9
"""Difference of estimates relative to σ that counts as equal."""
ROUNDED = 1e-8
"""The same of covariances: normal equations of weak calibrations leave ten digits of them."""


def way(kind: VariableKind, a: Array, b: Array) -> Array:
    """Return the step from one value of a variable in stored form to another."""
    if not UNKNOWNS[kind].rotates:
        k = min(len(a), len(b))
        return a[:k] - b[:k]
    turn = b[:9].reshape(3, 3).T @ a[:9].reshape(3, 3)
    return np.concatenate([log_rotation(turn[None])[0], a[9:] - b[9:]])


def equal_to_the_whole(
    network: Network, regions: Regions, folder: Path, tolerance: float = 1e-10
) -> fga.PartsSolution:
    """Adjust a network in parts and as a whole, and compare everything."""
    whole = fga.adjust(network, tolerance=tolerance)
    rel = fga.reliability(whole)
    parts = cut_network(network, regions, RunFolder(folder))
    found = fga.adjust_parts(parts, folder=folder, tolerance=tolerance)
    assert found.converged
    assert (found.n_observations, found.n_unknowns) == (whole.n_observations, whole.n_unknowns)
    assert found.sigma0 == pytest.approx(whole.sigma0, rel=1e-9)
    assert found.sum_of_redundancy_numbers == pytest.approx(whole.redundancy, abs=1e-6)
    residuals = whole.equations.residuals(whole.state, whitened=False)
    seen = np.zeros(len(rel.redundancy_numbers), dtype=int)
    for _, part in found.results():
        mine, theirs = part.equations.unknowns, whole.equations.unknowns
        for kind, table in mine.tables.items():
            for number, name in enumerate(table.names):
                other = theirs[kind].number[name]
                k = int(table.size[number])
                covariance = whole.variable_covariance((kind, name))
                sigma = np.sqrt(np.diag(covariance))
                safe = np.where(sigma > 0, sigma, 1.0)
                difference = part.covariances[kind][number, :k, :k] - covariance
                assert np.abs(difference / np.outer(safe, safe)).max() < ROUNDED, (kind, name)
                moved = way(kind, part.state[kind][number], whole.state[kind][other])[:k]
                assert np.abs(moved[sigma > 0] / sigma[sigma > 0]).max(initial=0.0) < CLOSE
                assert (moved[sigma == 0] == 0).all()
        v = part.residuals()
        for block in part.equations.blocks:
            by_id: dict[str, list[int]] = {}
            for row in range(block.rows.start, block.rows.stop):
                by_id.setdefault(part.equations.id(row), []).append(row)
            for ident, rows in by_id.items():
                (at,) = whole.equations.find([ident])
                seen[at] += 1
                np.testing.assert_allclose(
                    part.redundancy_numbers[rows], rel.redundancy_numbers[at], rtol=0, atol=1e-9
                )
                np.testing.assert_allclose(part.w[rows], rel.w[at], rtol=0, atol=1e-7)
                sigma = whole.equations.sigmas()[at]
                difference = v[rows] - residuals[at]
                assert np.abs(difference / sigma).max() < 1e-8
    assert (seen == 1).all()
    return found


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
@pytest.mark.parametrize("parts", [1, 2, 5])
def test_total_stations_cut_by_nested_dissection(tmp_path, parts):
    found = equal_to_the_whole(simulate_grid(1, points=100).network, parts, tmp_path)
    assert len(found.jobs) == parts


@LONG
def test_photos_over_total_stations_share_a_calibration_and_points(tmp_path):
    found = equal_to_the_whole(simulate_mixed(1, points=400, photos=30).network, 3, tmp_path)
    assert set(found.junctions.by_kind()) >= {"calibration", "pose", "point"}


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
@pytest.mark.parametrize("shape", [shapes.ring, shapes.corridor, shapes.tied, shapes.unordered])
def test_blocks_that_are_not_strips(tmp_path, shape):
    found = equal_to_the_whole(shape(1), 3, tmp_path)
    # No division pays where everything sees everything.
    assert len(found.jobs) == (1 if shape is shapes.unordered else 3)
    assert ("pose" in found.junctions.by_kind()) == (len(found.jobs) > 1)


@pytest.mark.slow(
    "networks in parts on a cluster of processes; short tests adjust parts in this process"
)
@pytest.mark.parametrize(
    "make",
    [
        small_block,
        simulated.levelling,
        simulated.gnss,
        simulated.own_cameras,
        simulated.weighted_photos,
        simulated.held_photo,
    ],
)
def test_simulated_networks(tmp_path, make):
    equal_to_the_whole(make(), 2, tmp_path)


@LONG
@pytest.mark.parametrize("parts", [3, 6])
def test_the_gnss_network_of_dynadjust(tmp_path, parts):
    """Clusters of vectors with full covariances: every cluster belongs to one part."""
    network = fga.read_dynaml(data_dir("dynadjust_gnss") / "gnss-networkstn.xml")
    found = equal_to_the_whole(network, parts, tmp_path, tolerance=1e-8)
    assert len(found.jobs) == parts


@LONG
def test_regions_of_the_user(tmp_path):
    network = simulate_grid(3, points=64).network
    middle = np.median([p.coordinates[0] for p in network.points.values()])
    east = {
        p.name: "east" if p.coordinates[0] > middle else "west" for p in network.points.values()
    }
    found = equal_to_the_whole(network, east, tmp_path)
    assert [job.part.name for job in found.jobs] == ["east", "west"]
    with pytest.raises(fga.InputError, match=r"point '\S+': it has no region; known: west"):
        cut_network(network, dict.fromkeys(list(network.points)[1:], "west"), RunFolder(tmp_path))


# -- parts that the user has -----------------------------------------------------------------------


def part_of(name: str, network: Network) -> fga.Part:
    return fga.Part(name, partial(Network.copy, network))


def levelled(name: str, points: dict[str, str], lines: str, noise: int = 0) -> Network:
    """Return a levelling network; ``points`` says which are fixed, or weighted with "w"."""
    heights = {p: 100.0 + 3.7 * i for i, p in enumerate("ABCDEFGH")}
    rng = np.random.default_rng(len(lines) + noise)
    network = Network(name)
    for p, state in points.items():
        sigma = (np.inf, np.inf, 0.002) if state == "w" else None
        fixed = "xyz" if state == "fixed" else "xy"
        network.add_point(p, (0.0, 0.0, heights[p]), fixed=fixed, sigma=sigma)
    for line in lines.split():
        a, b = line
        value = heights[b] - heights[a] + 1e-3 * rng.normal()
        network.add(HeightDifference(a, b, value, sigma=1e-3, id=f"{name} {line}"))
    return network


def together(name: str, *networks: Network) -> Network:
    """Return one network with everything of several."""
    out = Network(name)
    for network in networks:
        for point in network.points.values():
            if point.name not in out.points:
                fixed = "".join(a for a, f in zip("xyz", point.fixed, strict=True) if f)
                out.add_point(point.name, point.coordinates, fixed=fixed, sigma=point.sigma)
        out.add(*network.observations.values())
    return out


def same_heights(found: fga.PartsSolution, whole: fga.Solution, names: str) -> None:
    for name in names:
        assert found.point(name)[2] == pytest.approx(whole.point(name)[2], abs=1e-11)
        variance = whole.covariance(name)[2, 2]
        assert found.covariance(name)[2, 2] == pytest.approx(variance, rel=1e-9, abs=1e-20)


@LONG
def test_a_part_that_is_singular_by_itself_and_a_junction_that_one_part_determines():
    # North has no bench mark, and E only a weight of zero there: E is levelled in the south alone.
    south = levelled("south", {"A": "fixed", "B": "", "C": "", "E": ""}, "AB BC CA CE BE")
    north = levelled("north", {"B": "", "C": "", "D": "", "E": ""}, "BD DC")
    north.add(SlopeDistance("B", "D", 8.0, sigma=10.0))
    south.points["E"] = replace(south.points["E"], coordinates=(5.0, 0.0, 114.8))
    north.points["E"] = south.points["E"]
    with pytest.raises(fga.DatumError):
        fga.adjust(north)
    found = fga.adjust_parts([part_of("south", south), part_of("north", north)])
    whole = fga.adjust(together("all", south, north))
    assert found.vtpv == pytest.approx(whole.vtpv, rel=1e-9)
    assert found.redundancy == whole.redundancy
    assert found.sum_of_redundancy_numbers == pytest.approx(whole.redundancy, abs=1e-9)
    same_heights(found, whole, "ABCDE")


@LONG
def test_a_weighted_junction_counts_once():
    south = levelled("south", {"A": "w", "B": "w", "C": ""}, "AB BC CA")
    north = levelled("north", {"B": "w", "C": "", "D": ""}, "BD DC")
    found = fga.adjust_parts([part_of("south", south), part_of("north", north)])
    whole = fga.adjust(together("all", south, north))
    assert (found.n_observations, found.redundancy) == (7, 3)
    assert found.vtpv == pytest.approx(whole.vtpv, rel=1e-9)
    same_heights(found, whole, "ABCD")
    assert fga.adjust_parts([part_of("all", south)]).n_observations == 5


def test_everything_that_parts_state_differently_is_named_at_once():
    south = levelled("south", {"A": "fixed", "B": "", "C": "w", "D": "fixed"}, "AB BC CA CD")
    north = levelled("north", {"B": "fixed", "C": "w", "D": "fixed"}, "BD DC")
    north.points["C"] = replace(north.points["C"], sigma=(np.inf, np.inf, 0.003))
    north.points["D"] = replace(north.points["D"], coordinates=(0.0, 0.0, 111.2))
    with pytest.raises(fga.InputError) as error:
        fga.adjust_parts([part_of("south", south), part_of("north", north)])
    assert str(error.value).splitlines() == [
        "point 'B': part 'north' holds component z, and part 'south' estimates it: state it in the "
        "same way in both",
        "point 'C': its weighted values or standard deviations differ in parts 'south' and "
        "'north': they count once, so state them equally",
        "point 'D': it is held at different values in parts 'south' and 'north': (0, 0, 111.1) and "
        "(0, 0, 111.2)",
    ]


@LONG
def test_an_observation_that_two_parts_have_is_reported():
    south = levelled("south", {"A": "fixed", "B": "", "C": ""}, "AB BC CA")
    north = levelled("north", {"B": "", "C": "", "D": ""}, "BD DC")
    assert fga.adjust_parts([part_of("south", south), part_of("north", north)]).repeated == ()
    north.add(replace(south.observations["south BC"], id="again"))
    found = fga.adjust_parts([part_of("south", south), part_of("north", north)])
    assert found.repeated == (
        ("south", "height_difference B C (id south BC)"),
        ("north", "height_difference B C (id again)"),
    )
    text = parts_report(found)
    assert "Observations that several parts have" in text
    assert "  north  height_difference B C (id again)" in text


def test_frames_and_free_networks_are_refused():
    south = levelled("south", {"A": "fixed", "B": ""}, "AB")
    north = levelled("north", {"A": "fixed", "B": ""}, "AB")
    north.frame = fga.LocalFrame(axes="ne")
    with pytest.raises(fga.InputError, match=r"part 'north': its frame .* differs from .*'south'"):
        fga.adjust_parts([part_of("south", south), part_of("north", north)])
    north.frame, north.datum = south.frame, "free"
    with pytest.raises(fga.InputError, match="part 'north': a network in parts needs a given"):
        fga.adjust_parts([part_of("south", south), part_of("north", north)])


def test_what_is_no_part_is_refused(tmp_path):
    south = levelled("south", {"A": "fixed", "B": ""}, "AB")
    with pytest.raises(fga.InputError, match="project's file or folder, or `Part`, not Network"):
        fga.adjust_parts([south])
    with pytest.raises(fga.InputError, match="part 'a': its load must be a function"):
        fga.adjust_parts([fga.Part("a", south)])
    with pytest.raises(
        fga.InputError, match=r"part 'a': the function .* must return a Network, not 4"
    ):
        fga.adjust_parts([fga.Part("a", lambda: 42)])
    with pytest.raises(fga.InputError, match="part 'a': the function that reads it fails: ZeroDiv"):
        fga.adjust_parts([fga.Part("a", lambda: 1 / 0)])
    (tmp_path / "file").touch()
    with pytest.raises(fga.InputError, match="the folder of the run cannot be made"):
        fga.adjust_parts([part_of("south", south)], folder=tmp_path / "file" / "inside")


@LONG
def test_a_damaged_file_of_a_run_is_named(tmp_path):
    south = levelled("south", {"A": "fixed", "B": ""}, "AB BA")
    found = fga.adjust_parts([part_of("south", south)], folder=tmp_path)
    path = tmp_path / "part-0000" / f"state-{found.state}.npz"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(fga.InputError, match=rf"{path.name}: is damaged: give an empty folder"):
        fga.adjust_parts([part_of("south", south)], folder=tmp_path)


def test_names_of_parts_differ():
    south = levelled("south", {"A": "fixed", "B": ""}, "AB")
    with pytest.raises(fga.InputError, match="part 'a': parts 1 and 2 have this name"):
        fga.adjust_parts([part_of("a", south), part_of("a", south)])
    with pytest.raises(fga.InputError, match="there are no parts"):
        fga.adjust_parts([])


def test_errors_of_all_parts_come_together(tmp_path):
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "project.toml").write_text(f'name = "{name}"\nwhat = 1\n')
    with pytest.raises(fga.InputError) as error:
        fga.adjust_parts([tmp_path / "one", tmp_path / "two" / "project.toml"])
    assert "part 'one'" in str(error.value)
    assert "part 'two'" in str(error.value)


def test_undetermined_unknowns_are_named_with_their_part():
    south = levelled("south", {"A": "fixed", "B": "", "C": ""}, "AB BC")
    north = levelled("north", {"B": "", "C": "", "D": "", "E": ""}, "BC DE")
    with pytest.raises(fga.DatumError, match=r"part 'north': .*\n.*of the part with D, E") as error:
        fga.adjust_parts([part_of("south", south), part_of("north", north)])
    assert "'south'" not in str(error.value)


def test_junctions_that_no_part_determines_are_named():
    south = levelled("south", {"A": "", "B": "", "C": ""}, "AB BC CA")
    north = levelled("north", {"B": "", "C": "", "D": ""}, "BD DC")
    with pytest.raises(fga.DatumError, match=r"1 combination of their junctions (.|\n)*'B' z"):
        fga.adjust_parts([part_of("south", south), part_of("north", north)])


@LONG
def test_junctions_of_a_large_root_that_no_part_determines(monkeypatch):
    monkeypatch.setattr("factorgraph_adj.parts.iteration.MAX_SEARCHED_COLUMNS", 1)
    south = levelled("south", {"A": "", "B": "", "C": ""}, "AB BC CA")
    north = levelled("north", {"B": "", "C": "", "D": ""}, "BD DC")
    with pytest.raises(fga.DatumError, match="leave their junctions undetermined: give control"):
        fga.adjust_parts([part_of("south", south), part_of("north", north)])


def test_undetermined_unknowns_are_named_without_an_iteration():
    north = levelled("north", {"B": "", "D": ""}, "BD")
    with pytest.raises(fga.DatumError, match="part 'north': the network is not determined"):
        fga.adjust_parts([part_of("north", north)], max_iterations=0)


def test_a_worker_that_does_not_reach_the_folder_is_told(tmp_path):
    parts = cut_network(simulated.levelling(), 2, RunFolder(tmp_path))
    (tmp_path / "part-0001" / "network.npz").unlink()
    with pytest.raises(fga.InputError, match=r"part '2', \S+: is missing: every worker must reach"):
        fga.adjust_parts(parts)


# -- interruption -------------------------------------------------------------------------------


class Stopped(Exception):
    """Stands for what kills a run."""


def stop(iteration: int, *_: float) -> None:
    if iteration == 2:
        raise Stopped


@LONG
def test_a_killed_run_resumes_with_the_same_result_to_the_last_bit(tmp_path):
    network = simulate_mixed(1, points=400, photos=30).network
    folders = [RunFolder(tmp_path / name) for name in ("whole", "killed")]
    whole, killed = (cut_network(network, 3, folder) for folder in folders)
    straight = fga.adjust_parts(whole, folder=folders[0].path)
    with pytest.raises(Stopped):
        fga.adjust_parts(killed, folder=folders[1].path, progress=stop)
    iterations: list[int] = []
    resumed = fga.adjust_parts(
        killed, folder=folders[1].path, progress=lambda i, *_: iterations.append(i)
    )
    assert iterations == list(range(3, straight.iterations + 1))
    assert resumed.vtpv == straight.vtpv
    for (_, a), (_, b) in zip(straight.results(), resumed.results(), strict=True):
        for kind in a.state:
            np.testing.assert_array_equal(a.state[kind], b.state[kind])
        np.testing.assert_array_equal(a.redundancy_numbers, b.redundancy_numbers)


@LONG
def test_a_run_that_has_ended_is_not_iterated_again(tmp_path):
    network = simulate_grid(1, points=64).network
    parts = cut_network(network, 2, RunFolder(tmp_path))
    first = fga.adjust_parts(parts, folder=tmp_path)
    calls: list[int] = []
    again = fga.adjust_parts(
        parts, folder=tmp_path, max_iterations=1, progress=lambda i, *_: calls.append(i)
    )
    assert not calls
    assert (again.converged, again.reason) == (True, first.reason)
    assert (again.iterations, again.vtpv) == (first.iterations, first.vtpv)
    closer = fga.adjust_parts(parts, folder=tmp_path, tolerance=1e-9)
    assert closer.converged
    assert closer.iterations > first.iterations


@LONG
def test_a_folder_of_another_run_is_refused(tmp_path):
    south = levelled("south", {"A": "fixed", "B": ""}, "AB BA")
    fga.adjust_parts([part_of("south", south)], folder=tmp_path)
    other = levelled("south", {"A": "fixed", "B": ""}, "AB")
    with pytest.raises(fga.InputError, match="the folder belongs to a run with other parts"):
        fga.adjust_parts([part_of("south", other)], folder=tmp_path)
    fga.adjust_parts([part_of("south", south)], folder=tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(fga.InputError, match="not the progress of a run"):
        fga.adjust_parts([part_of("south", south)], folder=tmp_path)


@LONG
def test_a_solution_refuses_the_results_of_a_later_run(tmp_path):
    south = [part_of("south", levelled("south", {"A": "fixed", "B": ""}, "AB BA"))]
    first = fga.adjust_parts(south, folder=tmp_path)
    assert first.point("B")[2] == pytest.approx(103.7, abs=0.01)
    later = fga.adjust_parts(south, folder=tmp_path, variance="a-posteriori")
    assert later.covariance("B")[2, 2] > 0.0
    with pytest.raises(fga.InputError, match=r"part 'south', .*: a later run has written"):
        first.part("south")


@LONG
def test_the_state_of_the_weights_stays_however_often_a_run_goes_on(tmp_path, monkeypatch):
    """Here two states before the last are kept, and nobody is ever near enough."""
    monkeypatch.setattr(loaded_part, "KEPT_STATES", 2)
    line = Network("line")
    line.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    line.add_point("B", (70.0, 0.0, 0.0), fixed="y")
    for d in (0.0, 0.01):
        line.add(SlopeDistance("A", "B", 100.0 + d, sigma=0.001))
        line.add(HeightDifference("A", "B", d, sigma=StandardDeviation(per_sqrt_km=0.1)))
    for tolerance in (1e-5, 1e-30):
        found = fga.adjust_parts([part_of("line", line)], folder=tmp_path, tolerance=tolerance)
    assert found.state == found.weights > 0
    kept = {p.stem for p in tmp_path.rglob("state-*")}
    assert f"state-{found.weights}" in kept and f"state-{found.weights + 1}" not in kept
    assert f"state-{found.weights + 3}" in kept
    assert found.point("B")[0] == pytest.approx(fga.adjust(line).point("B")[0], abs=1e-7)


def test_a_temporary_folder_disappears_with_the_solution():
    south = levelled("south", {"A": "fixed", "B": ""}, "AB")
    found = fga.adjust_parts([part_of("south", south)])
    path = found.jobs[0].folder.path
    assert path.exists()
    del found
    assert not path.exists()


# -- approximate values --------------------------------------------------------------------------


def without_heights(network: Network, names: str) -> Network:
    for name in names:
        network.points[name] = replace(network.points[name], coordinates=(0.0, 0.0, np.nan))
    return network


@LONG
def test_approximate_values_of_junctions_come_from_any_part():
    south = levelled("south", {"A": "fixed", "B": "", "C": ""}, "AB BC CA")
    north = levelled("north", {"B": "", "C": "", "D": ""}, "BD DC")
    parts = [without_heights(north, "BCD"), without_heights(south, "BC")]
    found = fga.adjust_parts([part_of(n.name, n) for n in parts])
    whole = fga.adjust(together("all", south, north))
    same_heights(found, whole, "ABCD")


def test_missing_approximate_values_are_named_with_their_part():
    south = levelled("south", {"A": "fixed", "B": ""}, "AB")
    north = without_heights(levelled("north", {"B": "", "D": "", "E": ""}, "DE"), "DE")
    with pytest.raises(fga.ApproximationError, match=r"part 'north', .*D") as error:
        fga.adjust_parts([part_of("south", south), part_of("north", north)])
    assert "'south'" not in str(error.value)


@LONG
def test_a_point_of_one_part_leaves_the_plane_of_its_stations(tmp_path):
    """Slope distances alone: vᵀPv has no gradient across the plane, and a weak weight held it."""
    network = Network("two halves")
    for half in range(2):
        corners = [(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)]
        for i, (x, y) in enumerate(corners):
            network.add_point(f"S{half}{i}", (x + 500 * half, y, 10.0), fixed="xyz")
        e, n = 40.0 + 500 * half, 55.0
        network.add_point(f"P{half}", (e, n, 10.0), sigma=(np.inf, np.inf, 1000.0))
        for i, (x, y) in enumerate(corners):
            d = float(np.sqrt((x + 500 * half - e) ** 2 + (y - n) ** 2 + 12.0**2))
            network.add(SlopeDistance(f"S{half}{i}", f"P{half}", d + 1e-4 * (-1) ** i, sigma=0.001))
    network.add_point("J", (250.0, 50.0, 10.0), sigma=(1.0, 1.0, 1.0))
    network.add(HeightDifference("P0", "J", 0.0, sigma=10.0))
    network.add(HeightDifference("P1", "J", 0.0, sigma=10.0))
    regions = {n: "a" if n.startswith(("S0", "P0")) else "b" for n in network.points}
    parts = cut_network(network, regions, RunFolder(tmp_path))
    found = fga.adjust_parts(parts, folder=tmp_path)
    assert found.converged
    assert found.vtpv < 10.0
    for half in range(2):
        at = found.point(f"P{half}")
        assert abs(at[2] - 10.0) == pytest.approx(12.0, abs=0.01)
    assert len(found.second_places) == 2  # above and below, at the same distances
    assert all("fits equally well at" in told for told in found.second_places)


@LONG
@pytest.mark.parametrize("regions", [2, 3, lambda name: "even" if int(name[1:]) % 2 else "odd"])
def test_frames_in_several_parts(regions, tmp_path):
    """Their turns are found: of a held tilt and an unknown turn no rotation is known before."""
    sorts = ("model", "levelled tripod", "scan", "plan", "nearly levelled scan")
    network = network_of_frames(5, sorts)
    network.datum = "given"
    for name in ("P0", "P1", "P2"):
        network.points[name] = replace(network.points[name], fixed=(True,) * 3)
    equal_to_the_whole(network, regions, tmp_path)


@LONG
@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"origin": "T"}, r"frame 'f': it has the origin point 'S' in one and .* point 'T' in"),
        ({"level": True}, r"frame 'f': it has the origin point 'S' in one and .* and is level in"),
        ({"origin": (1, 2, 3)}, r"frame 'f': it has the origin point 'S' .*the origin \(1, 2, 3\)"),
        ({"values": {"z": 0.1}}, r"frame 'f': it is held at different values .*nan.*0\.1"),
    ],
)
def test_frames_that_parts_state_differently_are_refused(stated, message):
    networks = []
    for own in ({}, stated):
        network = Network("half")
        for name, at in (("A", (0, 0, 0)), ("B", (20, 0, 2)), ("C", (18, 15, 0))):
            network.add_point(name, at, fixed="xyz")
            network.add_point({"A": "S", "B": "T", "C": "U"}[name], at)
        network.add_frame("f", **{"free": ["rz"], "origin": "S", **own})
        for name in "ABC":
            network.add(FrameCoordinate("f", name, (0.0, 0.0, 0.0), sigma=(0.01,) * 3))
        networks.append(network)
    with pytest.raises(fga.InputError, match=message):
        fga.adjust_parts([part_of("south", networks[0]), part_of("north", networks[1])])


def test_photos_that_move_are_cut_by_nested_dissection(tmp_path):
    network = measured(flown(6, 1, 400), 1)
    for photo in ("F0", "F5"):  # strips are weak at their ends
        network.set_unknown("photo_motion", photo, sigma=(10.0, 10.0, 10.0, 0.1, 0.1, 0.1))
    for kind in (fga.PhotoShift, fga.PhotoTurn):
        network.add(kind("F2", "F1", "F3", interval=8.0, sigma=(8.0,) * 3))
    found = equal_to_the_whole(network, 2, tmp_path)
    assert len(found.jobs) == 2


def test_the_motion_of_a_photo_may_be_tied_in_another_part(tmp_path):
    network = measured(flown(6, 1, 400), 1)
    network.add(fga.PhotoShift("F1", "F0", "F2", interval=8.0, sigma=(8.0,) * 3))
    names = [*network.points, *network.photos]
    regions = dict.fromkeys(names, "east") | {"F1": "west"}
    parts = cut_network(network, regions, RunFolder(tmp_path / "p"))
    assert len(parts) == 2
    found = fga.adjust_parts(parts, folder=tmp_path / "r")
    assert found.vtpv == pytest.approx(fga.adjust(network).vtpv, rel=1e-9)


def strips_of_one_photo():
    """Return two parts, each with half of the image points of a photo that moves."""
    parts = []
    for half in (0, 1):
        network = measured(flown(3, 1, 120), 1)
        network.image_mask(np.arange(network.n_image_points) % 2 == half)
        for ident in [*network.observations][half::2]:
            del network.observations[ident]
        parts.append(network)
    return parts


def test_a_photo_that_moves_in_one_part_moves_in_the_other():
    one, two = strips_of_one_photo()
    del two.of_kind("photo_motion")["F1"]
    said = r"photo 'F1': part 'one' states its motion during the readout, and part 'two' none"
    with pytest.raises(fga.InputError, match=said):
        fga.adjust_parts([part_of("one", one), part_of("two", two)])
    with pytest.raises(fga.InputError, match=said):
        fga.adjust_parts([part_of("two", two), part_of("one", one)])
    one, two = strips_of_one_photo()
    two.cameras["camera"] = replace(two.cameras["camera"], readout=0.02)
    with pytest.raises(fga.InputError, match=r"read down in 0\.03 s in one and .* in 0\.02 s in"):
        fga.adjust_parts([part_of("one", one), part_of("two", two)])
