"""The way of a free network onto its inner constraints, where its shape is far from that of x₀."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.variables import State
from factorgraph_adj.solve.datum_defects import FreeDatum, extent_of, find_defects
from factorgraph_adj.solve.inner_constraints import (
    datum_columns,
    displacement_from_start,
    moved_by_similarity,
    state_on_constraints,
)
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array
from tests.networks.free import FREE, adjusted
from tests.networks.trilateration import trilateration

EXACT = 1e-11
"""What rounding leaves, relative to the extent of the points."""
TURNING = [n for n in FREE if n not in ("levelling", "gnss")]


def bent(solution: fga.Solution, share: float, seed: int) -> State:
    """Return x₀ whose free coordinates differ from the solution by a share of the extent."""
    rng = np.random.default_rng(seed)
    state = dict(solution.state)
    free = solution.equations.unknowns["point"].free
    points = state["point"].copy()
    _, extent = extent_of(state)
    points += np.where(free, share * extent * rng.normal(size=points.shape), 0.0)
    state["point"] = points
    return state


def carried(
    solution: fga.Solution, away: float, start: State, names: tuple[str, ...], seed: int
) -> tuple[State, Array, State]:
    """Move the solution away and back; return where it is, G_Dᵀ(x − x₀)_D, and where it was."""
    equations = solution.equations
    rng = np.random.default_rng(seed)

    def defect_at(state: State):
        system = LinearisedEquations(equations, state)
        (defect,) = find_defects(system, state, system.diagonal(), free=True)
        return defect

    first = defect_at(solution.state)
    columns = datum_columns(equations, first.motions, names)
    _, extent = extent_of(solution.state)
    amounts = away * extent * rng.normal(size=first.size)
    there = moved_by_similarity(equations, solution.state, first, amounts)
    state = state_on_constraints(equations, there, start, defect_at(there), columns)
    datum = FreeDatum(defect_at(state).motions, columns)
    left = datum.project(displacement_from_start(equations, state, start))
    return state, datum.motions @ left, there


@pytest.mark.parametrize("name", FREE)
@pytest.mark.parametrize("share", [0.01, 0.3, 2.0])
def test_inner_constraints_are_met_whatever_the_shape_of_the_approximate_coordinates(name, share):
    if name in ("gnss", "total station", "total station, free verticals"):
        share *= 0.1  # horizons turn with the Earth's curvature, which is not a similarity
    solution = adjusted(name, 0)
    start = bent(solution, share, 1)
    state, left, _ = carried(solution, 0.3, start, FREE[name][3], 2)
    _, extent = extent_of(state)
    rounding = 1e-15 * float(np.abs(state["point"]).max())
    assert np.abs(left).max() < EXACT * extent + rounding


@pytest.mark.parametrize("seed", range(10))
def test_it_is_the_least_squares_similarity_of_all_points(seed):
    """The closed form: Umeyama 1991, equations 40 to 42."""
    solution = adjusted("images", 0)
    names = solution.equations.unknowns["point"].names
    start = bent(solution, 1.0, seed)
    state, _, there = carried(solution, 0.5, start, names, seed)
    p, wanted = there["point"], start["point"]
    q, r = p - p.mean(axis=0), wanted - wanted.mean(axis=0)
    u, d, vt = np.linalg.svd(r.T @ q)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = float(d @ sign) / float(np.sum(q * q))
    expected = wanted.mean(axis=0) + scale * q @ ((u * sign) @ vt).T
    _, extent = extent_of(solution.state)
    assert np.abs(state["point"] - expected).max() < EXACT * extent


def test_no_observation_notices_the_way():
    solution = adjusted("images", 0)
    state, _, _ = carried(solution, 0.5, bent(solution, 1.0, 3), FREE["images"][3], 3)
    v = solution.equations.residuals(state)
    assert np.abs(v - solution.equations.residuals(solution.state)).max() < 1e-7


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_rests_on_its_inner_constraints_as_near_as_its_coordinates_allow(seed):
    """A unit in the last place of 4 000 km is 2e-7 σ: steps below that are nothing but rounding."""
    held, _ = trilateration(seed)
    network = fga.Network("free", datum="free")
    for point in held.points.values():
        x, y, _ = point.coordinates
        network.add_point(point.name, (x + 2.0**22, y + 2.0**22, 0.0), fixed="z")
    network.add(*held.observations.values())
    near = fga.adjust(network)
    for tolerance in (1e-7, 1e-9, 1e-11):
        nearer = fga.adjust(network, tolerance=tolerance)
        assert nearer.converged, nearer.reason
        assert tolerance > 1e-8 or "coordinates have no more digits" in nearer.reason
        for name in network.points:
            sigma = near.standard_deviations(name)[:2]
            assert np.all(np.abs(nearer.point(name) - near.point(name))[:2] < 2e-5 * sigma)
            np.testing.assert_allclose(nearer.standard_deviations(name)[:2], sigma, rtol=1e-7)
