"""Reliability of every observation against dense inverses, and its laws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.experiment.aerial_block import simulate_aerial_block
from factorgraph_adj.experiment.geocentric_block import simulate_geocentric_block
from factorgraph_adj.experiment.industry_block import simulate_industry_block
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    GnssPosition,
    GnssVector,
    HeightDifference,
    SlopeDistance,
)
from tests.networks.small_block import small_block
from tests.solve.test_solution import total_station
from tests.support.dense import DenseReliability

ROUNDING = 1e-8
"""What double precision leaves of a redundancy number in networks of this size."""


def levelling(datum: str = "given") -> fga.Network:
    """A levelled net; free, or with one held bench mark."""
    network = fga.Network("levelling", datum=datum)  # type: ignore[arg-type]
    heights = {"A": 100.0, "B": 103.2, "C": 99.1, "D": 101.7, "E": 98.0}
    for name, z in heights.items():
        held = "xyz" if datum == "given" and name == "A" else "xy"
        network.add_point(name, (0.0, 0.0, z + 0.01), fixed=held)
    lines = ["AB", "BC", "CD", "DA", "AC", "DE"]
    errors = [0.4, -0.3, 0.1, 0.5, -0.6, 0.2]
    for (a, b), error in zip(lines, errors, strict=True):
        network.add(
            HeightDifference(a, b, heights[b] - heights[a] + 1e-3 * error, sigma=1e-3, id=a + b)
        )
    return network


def gnss() -> fga.Network:
    """Vectors with covariances, a cluster of two, a position, control with a covariance."""
    rng = np.random.default_rng(5)
    network = fga.Network("gnss")
    at = {n: 100.0 * rng.normal(size=3) for n in "ABCDE"}
    for name, x in at.items():
        network.add_point(name, x + 0.05 * rng.normal(size=3))

    def covariance(n: int) -> np.ndarray:
        root = 1e-3 * rng.normal(size=(n, n))
        return root @ root.T + 1e-6 * np.eye(n)

    def vector(a: str, b: str) -> tuple[float, float, float]:
        x, y, z = (at[b] - at[a] + 1e-3 * rng.normal(size=3)).tolist()
        return x, y, z

    for a, b in ("AB", "BC", "CD", "DA", "AC"):
        network.add(GnssVector(a, b, vector(a, b), covariance=covariance(3)))
    pair = (GnssVector("B", "D", vector("B", "D"), id="v1", sigma=(1.0, 1.0, 1.0)),)
    pair += (GnssVector("B", "E", vector("B", "E"), id="v2", sigma=(1.0, 1.0, 1.0)),)
    network.add(Correlated(pair, covariance(6)))
    network.add(SlopeDistance("A", "E", float(np.linalg.norm(at["E"] - at["A"])), sigma=1e-3))
    known = tuple((at["A"] + 1e-3 * rng.normal(size=3)).tolist())
    network.add(ControlPoint("A", known, covariance=covariance(3)))
    plan = tuple(at["C"][:2].tolist())
    network.add(ControlPoint("C", plan, axes="xy", sigma=(0.002, 0.003)))
    network.add(GnssPosition("D", tuple(at["D"].tolist()), covariance=covariance(3)))
    return network


def free_block() -> fga.Network:
    """The small block without anything that holds it."""
    network = small_block(4)
    network.points = {
        n: replace(p, fixed=(False,) * 3, sigma=None) for n, p in network.points.items()
    }
    network.datum = "free"
    return network


def free_images() -> fga.Network:
    """Photos and points alone: seven defects."""
    network = simulate_aerial_block(3, image_points=240, points_per_photo=40).network
    network.observations = {}
    network.datum = "free"
    return network


def own_cameras() -> fga.Network:
    """Every photo with a calibration of its own, with priors."""
    network = small_block(6)
    camera = network.cameras["D3"]
    network.cameras = {}
    network.add_camera(
        "D3",
        BrownLens(),
        camera.values,
        sigma={"c": 0.05, "x0": 0.05, "y0": 0.05, "k1": 1e-5},
        per_photo=True,
    )
    return network


def weighted_photos() -> fga.Network:
    network = small_block(7)
    network.photos = {
        n: replace(p, sigma_position=(0.01,) * 3, sigma_attitude=1e-3)
        for n, p in network.photos.items()
    }
    return network


def held_photo() -> fga.Network:
    network = small_block(8)
    solution = fga.adjust(network)
    pose = solution.pose("F1")
    network.photos["F1"] = replace(
        network.photos["F1"],
        position=tuple(pose.position.tolist()),
        rotation=pose.rotation,
        fixed=(True,) * 6,
    )
    return network


NETWORKS: dict[str, Callable[[], fga.Network]] = {
    "levelling, held": levelling,
    "levelling, free": lambda: levelling("free"),
    "total station, free": lambda: total_station(1, coarse=0.1),
    "total station, free, verticals": lambda: total_station(2, coarse=0.1, verticals=True),
    "gnss": gnss,
    "combined block": small_block,
    "combined block, free": free_block,
    "images, free": free_images,
    "own cameras": own_cameras,
    "weighted photos": weighted_photos,
    "held photo": held_photo,
    "aerial block": lambda: simulate_aerial_block(2, image_points=240, points_per_photo=40).network,
    "industry block": lambda: simulate_industry_block(3).network,
    "geocentric block": lambda: simulate_geocentric_block(3).network,
}


@pytest.fixture(scope="module", params=list(NETWORKS))
def solution(request: pytest.FixtureRequest) -> fga.Solution:
    found = fga.adjust(NETWORKS[request.param]())
    assert found.converged, found.reason
    return found


@pytest.fixture(scope="module")
def dense(solution: fga.Solution) -> DenseReliability:
    return DenseReliability.of(solution)


@pytest.fixture(scope="module")
def rel(solution: fga.Solution):
    return fga.reliability(solution)


def test_redundancy_numbers_and_their_parts_are_those_of_dense_inverses(rel, dense) -> None:
    np.testing.assert_allclose(
        rel.redundancy_numbers, dense.redundancy_numbers, rtol=0, atol=ROUNDING
    )
    for name in ("e1", "e2", "e12"):
        np.testing.assert_allclose(
            getattr(rel, name),
            getattr(dense, name),
            rtol=ROUNDING,
            atol=ROUNDING * max(1.0, np.abs(dense.e1).max()),
            err_msg=name,
        )


def test_tests_and_detectable_errors_are_those_of_dense_inverses(rel, dense) -> None:
    on = rel.controlled
    precision = np.diag(dense.precision)
    assert np.all(on == (precision > 1e-6 * (precision + dense.lost)))
    root = np.sqrt(precision[on])
    w = dense.weighted[on] / root
    # A rounding of r moves w and ∇ by half of it over r, and the error by all of it.
    rounding = ROUNDING * (precision[on] + dense.lost[on]) / precision[on]

    def close(ours: np.ndarray, theirs: np.ndarray, scale: np.ndarray) -> None:
        assert np.all(np.abs(ours - theirs) <= rounding * scale)

    close(rel.w[on], w, np.abs(w) + 1.0)
    close(rel.mdb[on] * root, np.full(len(root), rel.delta0), np.full(len(root), 10.0))
    expected = rel.delta0 * np.sqrt(np.maximum(dense.lost[on], 0)) / root
    assert np.all(np.abs(rel.delta_bar[on] ** 2 - expected**2) <= 40 * rounding * (1 + expected**2))
    close(rel.estimated_errors[on] * root, -w, np.abs(w) + 1.0)
    assert np.all(np.isinf(rel.mdb[~on])) and np.all(np.isnan(rel.w[~on]))


def test_the_effect_on_any_unknown_is_that_of_the_dense_inverse(rel, dense, solution) -> None:
    unknowns = solution.equations.unknowns
    scale = np.sqrt(np.maximum(np.einsum("ij,ij->i", dense.effects, dense.effects), 1e-300))
    rng = np.random.default_rng(1)
    for row in rng.choice(np.flatnonzero(rel.controlled), 6).tolist():
        for effect in rel.effect_on(row):
            columns = unknowns.columns(effect.kind, unknowns[effect.kind].number[effect.name])
            expected = dense.effects[columns, row] * rel.mdb[row]
            np.testing.assert_allclose(
                effect.values, expected, rtol=0, atol=1e-7 * (scale[columns] * rel.mdb[row]).max()
            )


def test_the_largest_effect_is_that_on_the_own_points(rel, dense, solution) -> None:
    unknowns = solution.equations.unknowns
    row = 0
    for block in solution.equations.blocks:
        for i in range(block.n):
            columns = [
                unknowns.columns("point", int(index[i]))
                for kind, index in block.variables
                if kind == "point"
            ]
            own = np.concatenate([*columns, np.zeros(0, dtype=int)]).astype(int)
            for _ in range(block.dimension):
                if len(own) and rel.controlled[row]:
                    expected = np.abs(dense.effects[own, row]).max() * rel.mdb[row]
                    assert rel.largest_effect[row] == pytest.approx(expected, rel=1e-6, abs=1e-12)
                elif not len(own):
                    assert np.isnan(rel.largest_effect[row])
                row += 1


def test_correlations_of_test_values_are_those_of_the_dense_inverse(rel, dense) -> None:
    rows = np.argsort(-np.where(rel.controlled, np.abs(rel.w), 0.0))[:8]
    rows = rows[rel.controlled[rows]]
    m = dense.precision[np.ix_(rows, rows)]
    d = np.sqrt(np.diag(m))
    np.testing.assert_allclose(rel.correlation(rows), m / np.outer(d, d), rtol=0, atol=1e-6)
