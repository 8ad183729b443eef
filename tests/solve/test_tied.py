"""Photos that total stations tie together, against dense algebra and sparse normal equations."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.benchmarks.blocks import SIGHTS, simulate_tied
from tests.benchmarks.tied import differences, sparse_rows
from tests.support.elimination_rules import everything_by_qr

STATIONS = 10


@pytest.fixture(scope="module", params=[False, True], ids=["by Cholesky", "by QR"])
def solution(request: pytest.FixtureRequest) -> Iterator[fga.Solution]:
    """Return 80 photos and 10 stations, eliminated in either way."""
    network = simulate_tied(2, photos=80, stations=STATIONS, points_per_photo=30)
    with everything_by_qr() if request.param else nullcontext():
        found = fga.adjust(network)
        assert found.converged and found.run.solver.qr_everywhere == request.param
        assert found.run.solver.layers.by_qr == request.param
        yield found


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
def test_covariances_and_redundancy_numbers_are_those_of_dense_qr(solution: fga.Solution) -> None:
    """Covariances to 1e-6 of σσ, redundancy numbers to 1e-8, and their sum is the redundancy."""
    system = solution.normal().system
    unknowns = solution.equations.unknowns
    free = np.flatnonzero(unknowns.free)
    a = sparse_rows(system).toarray()
    np.testing.assert_array_equal(a[:, free], system.times(np.eye(unknowns.n_columns))[:, free])
    scale = 1.0 / np.linalg.norm(a[:, free], axis=0)
    orthogonal, r = np.linalg.qr(a[:, free] * scale)
    half = scale[:, None] * np.linalg.solve(r, np.eye(len(r)))
    q = np.zeros((unknowns.n_columns,) * 2)
    q[np.ix_(free, free)] = half @ half.T
    rel = fga.reliability(solution)
    hat = np.einsum("ij,ij->i", orthogonal, orthogonal)
    np.testing.assert_allclose(rel.redundancy_numbers, 1.0 - hat, atol=1e-8)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-7)
    sigma = np.sqrt(np.diag(q))
    for kind in ("point", "pose", "orientation", "calibration"):
        for number in np.flatnonzero(unknowns[kind].offset >= 0).tolist():
            columns = unknowns.columns(kind, number)
            found = solution.variable_covariance((kind, unknowns[kind].names[number]))
            s = np.where(sigma[columns] > 0, sigma[columns], 1.0)
            off = np.abs(found - q[np.ix_(columns, columns)]) / np.outer(s, s)
            assert off.max() < 1e-6, (kind, number)


def test_they_are_those_of_sparse_normal_equations(solution: fga.Solution) -> None:
    """As in the study of 300 stations and 2 000 photos (`python -m tests.benchmarks tied`)."""
    covariances, redundancy_numbers = differences(fga.reliability(solution), seed=1)
    assert covariances < 1e-6
    assert redundancy_numbers < 1e-8


def test_each_station_ties_more_photos_than_any_of_its_points(solution: fga.Solution) -> None:
    """The photos that see its points are more than twice those that see any one of them."""
    network = solution.network
    photo, point, _, _ = network.images.columns()
    number = {name: i for i, name in enumerate(network.points)}
    for station in (f"station {i}" for i in range(STATIONS)):
        sighted = [
            number[o.target]
            for o in network.observations.values()
            if isinstance(o, fga.observations.SlopeDistance) and o.station == station
        ]
        assert len(sighted) == SIGHTS
        seen_in = [set(photo[point == p].tolist()) for p in sighted]
        assert len(set().union(*seen_in)) > 2 * max(map(len, seen_in))
