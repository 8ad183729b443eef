"""Conjugate gradients find the minimum of the direct solution, and have no inverse to give away."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import AdjustmentError, DatumError, InputError, SingularError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, HeightDifference, SlopeDistance
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.solve import machine_limits
from factorgraph_adj.solve.conjugate_gradients import (
    MAX_CLUSTER_NODES,
    ConjugateGradients,
    visibility_clusters,
)
from factorgraph_adj.solve.factorisation import EliminationPlan, Factorisation, PreparedElimination
from factorgraph_adj.solve.normal_equations import Solver
from tests.networks.small_block import small_block

MINIMUM = 1e-6
"""Distance of the two minima in σ: the tolerance of both adjustments is smaller."""
SOLVED = 1e-6
"""Relative error of a solution whose residual is 10⁻⁸ of the first one."""


def aerial(photos: int = 24, seed: int = 1) -> Network:
    return simulate_aerial_block(seed, image_points=40 * photos, points_per_photo=40).network


def with_terrestrial(seed: int = 1) -> Network:
    """Return a block whose points are partly tied by distances and height differences."""
    network = aerial(12, seed)
    at = fga.adjust(network)
    rng, names = np.random.default_rng(seed), list(network.points)
    for a, b in zip(names[:40:4], names[1:41:4], strict=True):
        between = at.point(b) - at.point(a)
        length = float(np.linalg.norm(between)) + rng.normal(0.0, 0.005)
        network.add(SlopeDistance(a, b, length, sigma=0.005))
        network.add(HeightDifference(a, b, between[2] + rng.normal(0.0, 0.002), sigma=0.002))
    return network


def ring(photos: int = 20, points: int = 60) -> Network:
    """Return photos around an object that all see all of its points."""
    rng = np.random.default_rng(photos)
    truth = rng.uniform(-5.0, 5.0, (points, 3))
    network = Network("photos around an object")
    names = [f"P{i}" for i in range(points)]
    network.add_camera("camera", BrownLens(), {"c": 24.0})
    network.add_points(names, truth + rng.normal(0.0, 0.005, truth.shape))
    for i in range(6):
        value = truth[i] + rng.normal(0.0, 0.001, 3)
        network.add(ControlPoint(names[i], tuple(value), sigma=(0.001, 0.001, 0.001)))
    for k in range(photos):
        turn = 2.0 * np.pi * k / photos
        centre = np.array([25.0 * np.cos(turn), 25.0 * np.sin(turn), 4.0 * np.sin(3.0 * turn)])
        rotation = look_at(centre, np.zeros(3))
        d = (truth - centre) @ rotation
        xy = 24.0 * d[:, :2] / d[:, 2:] * [1.0, -1.0] + rng.normal(0.0, 0.002, (points, 2))
        near = centre + rng.normal(0.0, 0.01, 3)
        network.add_photo(str(k), "camera", position=tuple(near), rotation=rotation)
        network.add_image_points(str(k), names, xy, sigma=0.002)
    return network


def apart(direct: fga.Solution, other: fga.Solution) -> float:
    """Return the largest difference of points in their σ."""
    variances = np.diagonal(direct.point_covariances, axis1=1, axis2=2)
    on = variances > 0.0
    gap = np.abs(direct.state["point"] - other.state["point"])
    return float((gap[on] / np.sqrt(variances[on])).max())


@pytest.mark.parametrize("make", [aerial, ring, small_block, with_terrestrial])
def test_the_minimum_is_that_of_the_direct_solution(make) -> None:
    network = make()
    direct = fga.adjust(network, tolerance=1e-7)
    found = fga.adjust(network, tolerance=1e-7, solver="conjugate-gradients")
    assert found.converged and found.run.solver.iterative
    assert found.vtpv == pytest.approx(direct.vtpv, rel=1e-11)
    assert apart(direct, found) < MINIMUM
    for name in list(network.points)[:3]:
        own = direct.covariance(name)
        size = np.sqrt(np.outer(np.diag(own), np.diag(own))) + 1e-300
        assert (np.abs(found.covariance(name) - own) / size).max() < SOLVED
    photo = next(iter(network.photos))
    own = direct.pose_covariance(photo)
    size = np.sqrt(np.outer(np.diag(own), np.diag(own)))
    assert (np.abs(found.pose_covariance(photo) - own) / size).max() < SOLVED


@pytest.mark.parametrize("seed", [1, 2])
def test_poor_starts_are_damped_to_the_same_minimum(seed: int) -> None:
    network = aerial(6, seed)
    rng = np.random.default_rng(seed)
    for name, point in network.points.items():
        moved = point.coordinates + rng.normal(0.0, 10.0, 3)
        network.points[name] = replace(point, coordinates=tuple(moved))
    direct, found = (
        fga.adjust(network, solver=solver) for solver in ("direct", "conjugate-gradients")
    )
    assert direct.converged and found.converged
    assert apart(direct, found) < 1e-4  # the tolerance of the iteration is 10⁻⁵ σ


def factorised(network: Network, size: int | None) -> tuple[Factorisation, np.ndarray]:
    """Return N of a network, by gradients with clusters of a size (None: direct), and a scale."""
    solution = fga.adjust(network)
    equations, system = solution.equations, solution.normal().system
    layers = solution.run.solver.layers
    plan = (
        EliminationPlan.of(equations, layers)
        if size is None
        else EliminationPlan.by_gradients(equations, layers, size)
    )
    none = np.zeros(equations.unknowns.n_columns)
    return PreparedElimination.of(system, plan).factorised(none), solution.normal().diagonal


@pytest.mark.parametrize("make", [aerial, with_terrestrial])
def test_solutions_are_those_of_the_fronts_with_any_clusters(make) -> None:
    network = make()
    direct, diagonal = factorised(network, None)
    y = np.random.default_rng(3).standard_normal((len(diagonal), 3)) * np.sqrt(diagonal)[:, None]
    wanted, counts = direct.solve(y), {}
    for size in (1, 4, MAX_CLUSTER_NODES):
        other, _ = factorised(network, size)
        assert isinstance(other.fronts, ConjugateGradients)
        found = other.solve(y)
        error = np.einsum("ij,ij->j", found - wanted, y)
        assert np.abs(error / np.einsum("ij,ij->j", wanted, y)).max() < SOLVED
        counts[size] = other.fronts.gradients
    assert counts[MAX_CLUSTER_NODES] < counts[4] < counts[1]


def test_the_product_is_that_of_the_reduced_matrix() -> None:
    """S is symmetric, and its inverse by the fronts undoes it."""
    network = aerial(8)
    (gradients, _), (direct, _) = factorised(network, 1), factorised(network, None)
    operator, fronts = gradients.fronts, direct.fronts
    assert isinstance(operator, ConjugateGradients)
    n = len(operator.diagonal)
    s = operator.times(np.eye(n)[:, operator.free[:, 0] > 0.0])[operator.free[:, 0] > 0.0]
    assert np.abs(s - s.T).max() < 1e-12 * np.abs(s).max()
    y = np.zeros((n, 2))
    y[operator.free[:, 0] > 0.0] = np.random.default_rng(1).standard_normal((len(s), 2))
    x = fronts.solve(y)
    assert operator.times(x) == pytest.approx(y, abs=1e-6)


def test_clusters_have_every_node_once_and_common_points() -> None:
    network = aerial(40)
    solver = Solver.by_gradients(compile_network(network))
    clusters = solver.plan.clusters
    assert sorted(np.concatenate(clusters).tolist()) == list(range(solver.plan.nodes.n))
    assert max(map(len, clusters)) == MAX_CLUSTER_NODES
    rays = solver.plan.rays
    assert rays is not None and not len(rays.left)
    seen = [set(rays.point_of_ray[rays.of_node(i)].tolist()) for i in range(rays.places.n)]
    for cluster in clusters:
        for node in cluster.tolist():
            others = set().union(*(seen[i] for i in cluster.tolist() if i != node))
            assert len(cluster) == 1 or seen[node] & others
    assert all(len(c) == 1 for c in visibility_clusters(rays, 1))


def test_estimates_have_the_standard_error_that_they_state() -> None:
    network = aerial(10)
    direct = fga.adjust(network)
    found = fga.adjust(network, solver="conjugate-gradients")
    exact = np.sqrt(np.diagonal(direct.point_covariances, axis1=1, axis2=2))
    estimated = fga.estimate_precision(found, samples=100)
    sigmas = np.array([estimated.points[n] for n in direct.equations.unknowns["point"].names])
    ratio = sigmas[exact > 0.0] / exact[exact > 0.0]
    assert estimated.relative_error == pytest.approx(0.0707, abs=1e-4)
    assert np.sqrt(np.mean((ratio - 1.0) ** 2)) < 1.3 * estimated.relative_error
    pose = np.concatenate([estimated.of("pose", p) for p in network.photos])
    own = np.concatenate([np.sqrt(np.diag(direct.pose_covariance(p))) for p in network.photos])
    assert np.sqrt(np.mean((pose / own - 1.0) ** 2)) < 1.5 * estimated.relative_error
    assert "ESTIMATED" in str(estimated) and "ESTIMATED" in repr(estimated)
    assert "7.1 %" in str(estimated)


def test_what_needs_an_inverse_is_refused_with_the_reason(tmp_path: Path) -> None:
    found = fga.adjust(aerial(6), solver="conjugate-gradients")
    with pytest.raises(SingularError, match=r"conjugate gradients.*estimate_precision"):
        _ = found.point_covariances
    with pytest.raises(AdjustmentError, match=r"no reliability: .*conjugate gradients"):
        fga.reliability(found)
    text = fga.text_report(found)
    assert "precision             none: the normal equations were solved by conjugate" in text
    assert "Nothing controls" not in found.summary()
    fga.write_results(found, tmp_path / "results.json")
    data = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    point, photo = (next(iter(data[kind].values())) for kind in ("points", "photos"))
    assert set(point) == {"xyz"} and "position" in photo
    assert not any("sigma" in key for key in (*point, *photo))
    fga.write_report(found, tmp_path / "page.html")


def test_the_command_solves_and_writes_values_without_precision(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fga.write_project(aerial(6), tmp_path / "project.toml")
    gradients = ["--solver", "conjugate-gradients"]
    where = str(tmp_path / "out")
    assert main(["adjust", str(tmp_path), *gradients, "--quiet", "--out", where]) in (0, 1)
    header = (tmp_path / "out" / "points.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "x" in header.split(",") and "sigma" not in header
    header = (tmp_path / "out" / "photos.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "omega" in header and "sigma" not in header
    capsys.readouterr()
    assert main(["adjust", str(tmp_path), *gradients, "--snoop", "--ellipses", "0.95"]) == 2
    said = capsys.readouterr().err
    assert "--snoop needs covariances" in said and "--ellipses needs covariances" in said


def test_options_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="unknown solver 'gradients'; valid"):
        fga.adjust(aerial(4), solver="gradients")  # type: ignore[call-overload]
    with pytest.raises(InputError, match="need a given datum"):
        fga.adjust(aerial(4), datum="free", solver="conjugate-gradients")
    level = Network("levels")
    level.add_point("A", (0, 0, 0), fixed="xyz")
    level.add_point("B", (9, 0, 1), fixed="xy")
    level.add(HeightDifference("A", "B", 1.0, sigma=0.001))
    with pytest.raises(InputError, match="that only photos see, and network 'levels' has none"):
        fga.adjust(level, solver="conjugate-gradients")


def test_a_datum_defect_is_found_without_pivots() -> None:
    network = aerial(6)
    rest = fga.without(network, list(network.observations))
    with pytest.raises(DatumError) as direct:
        fga.adjust(rest)
    with pytest.raises(DatumError) as other:
        fga.adjust(rest, solver="conjugate-gradients")
    assert direct.value.defect == other.value.defect == 7


def test_too_little_memory_proposes_gradients(monkeypatch: pytest.MonkeyPatch) -> None:
    network = ring(160, 20)
    equations = compile_network(network)
    state = equations.unknowns.start()
    monkeypatch.setattr(machine_limits, "MIN_BYTES_CHECKED", 0.0)
    plan = Solver.of(equations).plan
    whole = machine_limits.estimate_memory(plan, equations, state).adjustment
    less = machine_limits.estimate_memory(plan, equations, state, iterative=True).adjustment
    own = machine_limits.estimate_memory(Solver.by_gradients(equations).plan, equations, state)
    assert less == own.adjustment
    monkeypatch.setattr(machine_limits, "free_memory_bytes", lambda: 1.0)
    with pytest.raises(InputError, match=r"pairs of rays .* or solve by conjugate gradients"):
        fga.adjust(network)
    monkeypatch.setattr(machine_limits, "refuse_too_many_pairs", lambda equations: None)
    assert less < whole
    for free, proposed in ((1.0, False), (0.5 * (whole + less), True)):
        monkeypatch.setattr(machine_limits, "free_memory_bytes", lambda free=free: free)
        with pytest.raises(InputError) as found:
            machine_limits.refuse_too_large(plan, equations, state)
        assert ("conjugate gradients" in str(found.value)) == proposed
