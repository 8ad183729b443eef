"""Solutions in files: everything comes back, and damage is named."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.solve.solution import Solution
from tests.networks.arriving import CASES

NETWORKS = (
    "combined block",
    "combined block, free",
    "total station, free, verticals",
    "gnss",
    "mikhail-7.4-cov",
    "camcal, weighted",
    "weighted photos",
    "own cameras",
    "Comp3D, deflections",
    "geocentric block",
    "levelling, free",
)


def same(a: Solution, b: Solution) -> None:
    """Compare all figures of two solutions."""
    assert repr(a) == repr(b) and a.reason == b.reason and a.iterations == b.iterations
    for kind, values in a.state.items():
        assert np.array_equal(values, b.state[kind], equal_nan=True)
    assert np.array_equal(a.equations.sigmas(), b.equations.sigmas())
    variances = a.point_covariances
    scale = np.abs(variances).max(initial=1e-300)
    assert np.abs(b.point_covariances - variances).max(initial=0.0) <= 1e-9 * scale
    one, other = fga.reliability(a), fga.reliability(b)
    for figure in ("redundancy_numbers", "w", "mdb", "estimated_errors", "e1"):
        x, y = getattr(one, figure), getattr(other, figure)
        assert np.allclose(x, y, rtol=1e-6, atol=1e-8, equal_nan=True), figure


@pytest.mark.slow(
    "hundreds of damaged files are read or refused; short tests read and refuse single ones"
)
@pytest.mark.parametrize("name", NETWORKS)
def test_a_solution_comes_back_with_its_reliability(name, tmp_path):
    solution = fga.adjust(CASES[name].make())
    solution.save(tmp_path / "found.npz")
    same(solution, fga.load_solution(tmp_path / "found.npz"))


@pytest.mark.parametrize("name", ["combined block, free", "gnss", "weighted photos"])
@pytest.mark.parametrize("way", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_a_solution_can_be_copied_and_pickled(name, way):
    solution = fga.adjust(CASES[name].make())
    same(solution, way(solution))


def test_weights_and_a_posteriori_figures_come_back(tmp_path):
    network = CASES["combined block"].make()
    plain = fga.adjust(network)
    rng = np.random.default_rng(1)
    weights = rng.uniform(0.5, 2.0, plain.equations.n_rows)
    solution = fga.adjust(network, weights=weights, variance="a-posteriori")
    solution.save(tmp_path / "found.npz")
    loaded = fga.load_solution(tmp_path / "found.npz")
    same(solution, loaded)
    assert loaded.variance_factor == solution.variance_factor != 1.0


def test_a_loaded_free_network_goes_on(tmp_path):
    solution = fga.adjust(CASES["combined block, free"].make())
    solution.save(tmp_path / "found.npz")
    loaded = fga.load_solution(tmp_path / "found.npz")
    again = fga.adjust(loaded.network, start=loaded)
    for kind, values in solution.state.items():
        assert again.state[kind] == pytest.approx(values, abs=1e-7, nan_ok=True)
    found = fga.snoop(loaded.network, start=loaded)
    assert found.solution.redundancy == solution.redundancy


def test_a_file_that_is_there_stays_after_an_error(tmp_path):
    solution = fga.adjust(CASES["gnss"].make())
    file = tmp_path / "found.npz"
    solution.save(file)
    before = file.read_bytes()
    with pytest.raises(fga.InputError, match="s_transform has no file"):
        points = list(solution.network.points)
        fga.s_transform(solution, points[:3]).save(file)
    assert file.read_bytes() == before


def test_damage_is_named(tmp_path):
    solution = fga.adjust(CASES["gnss"].make())
    file = tmp_path / "found.npz"
    solution.save(file)
    whole = file.read_bytes()
    for content in (b"", b"no archive", whole[:-200], whole[: len(whole) // 2]):
        file.write_bytes(content)
        with pytest.raises(fga.InputError, match=r"found\.npz"):
            fga.load_solution(file)
    np.savez(file, header=np.frombuffer(b'{"what": "something"}', dtype=np.uint8))
    with pytest.raises(fga.InputError, match="is no file of a solution"):
        fga.load_solution(file)
    text = b'{"what": "factorgraph_adj solution", "format": 99}'
    np.savez(file, header=np.frombuffer(text, dtype=np.uint8))
    with pytest.raises(fga.InputError, match="is of format 99; this program reads format 1"):
        fga.load_solution(file)
    with pytest.raises(fga.InputError, match="cannot be read"):
        fga.load_solution(tmp_path / "none.npz")


def test_an_adjusted_network_has_adjusted_values(tmp_path):
    for name in ("own cameras", "2020-barta-phase_1-2TK", "camcal, model 3"):
        network = CASES[name].make()
        solution = fga.adjust(network)
        found = solution.as_network()
        for point in found.points.values():
            assert point.coordinates == tuple(solution.point(point.name).tolist())
            assert point.fixed == network.points[point.name].fixed
        again = fga.adjust(found, start=None)
        assert again.vtpv <= solution.vtpv * (1.0 + 1e-6)
        fga.write_project(found, tmp_path / "project.toml")
        back = fga.read_project(tmp_path / "project.toml")
        assert list(back.points.values()) == list(found.points.values())


def test_covariances_of_several_points():
    solution = fga.adjust(CASES["combined block"].make())
    names = ["P1", "P5", "P7"]
    whole = solution.covariance(names)
    assert whole.shape == (9, 9) and np.abs(whole - whole.T).max() < 1e-9 * whole.max()
    assert whole[:3, 6:] == pytest.approx(solution.covariance("P1", "P7"))
    assert solution.covariance("P1", names) == pytest.approx(whole[:3])
    assert solution.covariance(names, ["P5"]) == pytest.approx(whole[:, 3:6])
