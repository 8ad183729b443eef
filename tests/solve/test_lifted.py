"""Cofactors in the coordinates of the reduced system, against the dense inverse of N."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from factorgraph_adj.solve.linear_base import SIGMA_SAMPLES, ReducedCofactors
from factorgraph_adj.types import Array, Index
from tests.networks.eliminated import CHOLESKY, ELIMINATED, FIRST_LAYER, QR, eliminated


class Coordinates:
    """The coordinates of a solution, with slots for half of its points."""

    def __init__(self, name: str) -> None:
        case = eliminated(name)
        self.dense, self.points, self.rounding = case.dense, case.points, case.rounding
        self.n = len(case.dense.free)
        self.others = case.others
        self.lifted = ReducedCofactors(case.solution)
        chosen = np.random.default_rng(3).permutation(len(self.points))
        chosen = chosen[: (len(self.points) + 1) // 2]
        self.slots = {int(point): slot for slot, point in enumerate(chosen)}
        self.slotted: Index = np.concatenate([self.others, self.points[chosen].ravel()])
        """Columns of the reduced system and of all points with slots."""

    def functions(self, seed: int, among: Index, k: int = 3) -> tuple[Index, Array]:
        """Return k functions of a dozen of some columns, whose variances are about one."""
        rng = np.random.default_rng(seed)
        columns = rng.permutation(among)[:12]
        return columns, rng.normal(size=(k, len(columns))) / self.dense.sigma[columns]

    def gradient(self, seed: int) -> Array:
        """Return a gradient whose step is about σ, zero for held components."""
        g = np.random.default_rng(seed).normal(size=self.n) / self.dense.sigma
        return np.where(self.dense.free, g, 0.0)


@cache
def coordinates(name: str) -> Coordinates:
    return Coordinates(name)


every_case = pytest.mark.parametrize("name", ELIMINATED)


def test_the_networks_have_every_sort_of_elimination():
    cases = {name: eliminated(name) for name in ELIMINATED}
    factors = {name: c.factor for name, c in cases.items()}
    assert tuple(n for n, f in factors.items() if f.points is not None) == FIRST_LAYER
    assert not factors["mixed"].layers.by_qr
    assert factors["mixed" + QR].layers.leaves.any()
    assert factors["terrestrial"].layers.by_qr
    assert not factors["terrestrial" + CHOLESKY].layers.by_qr
    assert all(c.solution.datum is not None for n, c in cases.items() if n.endswith("free"))
    held = cases["mixed, held height"]
    assert not held.dense.free[held.points].all()


@every_case
def test_coordinates_are_the_columns_of_the_reduced_system_and_three_for_each_slot(name):
    c = coordinates(name)
    assert np.array_equal(c.lifted.columns, c.others)
    assert np.array_equal(c.lifted.place[c.others], np.arange(len(c.others)))
    assert (c.lifted.place[c.points] == -1).all()
    assert c.lifted.size == len(c.others) + 3 * c.lifted.slots
    assert (c.lifted.slots > 0) == (len(c.points) > 0)


@every_case
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_functions_have_the_cofactors_of_the_dense_inverse(name, seed):
    """Functions of anything: of points with a slot, of points without, of all other unknowns."""
    c = coordinates(name)
    columns, a = c.functions(seed, np.arange(c.n))
    f = c.lifted.expand(columns, a, c.slots)
    found = f.b @ c.lifted.times(f.at, f.b)[f.at] + f.own
    expected = a @ c.dense.q[np.ix_(columns, columns)] @ a.T
    assert np.abs(found - expected).max() < c.rounding * np.diag(expected).max()
    assert len(np.unique(f.at)) == len(f.at)


@every_case
def test_slots_tie_functions_of_the_same_points(name):
    """Cofactors between two sets of functions, of which every point has a slot."""
    c = coordinates(name)
    columns, a = c.functions(5, c.slotted)
    others, b = c.functions(6, c.slotted)
    others[:4], b[:, :4] = columns[:4], a[:, :4]
    others, first = np.unique(others, return_index=True)
    b = b[:, first]
    f, g = (c.lifted.expand(*x, c.slots) for x in ((columns, a), (others, b)))
    found = f.b @ c.lifted.times(g.at, g.b)[f.at]
    expected = a @ c.dense.q[np.ix_(columns, others)] @ b.T
    sizes = [np.diag(x @ c.dense.q[np.ix_(y, y)] @ x.T) for x, y in ((a, columns), (b, others))]
    assert np.all(np.abs(found - expected) < c.rounding * np.sqrt(np.outer(*sizes)))
    assert not f.own.any()


@every_case
def test_all_unknowns_follow_from_the_coordinates(name):
    """``unknowns`` of Q Fᵀ in coordinates are the columns Q Fᵀ of the dense inverse."""
    c = coordinates(name)
    columns, a = c.functions(7, c.slotted, k=1)
    f = c.lifted.expand(columns, a, c.slots)
    found = c.lifted.unknowns(c.lifted.times(f.at, f.b)[:, 0], c.slots)
    expected = c.dense.q[:, columns] @ a[0]
    size = np.sqrt(a[0] @ expected[columns])
    assert np.abs((found - expected) / c.dense.sigma).max() < c.rounding * size


@every_case
def test_the_gradient_by_coordinates_leads_to_the_same_step(name):
    """Q g of all but the points without a slot, whose own part e has no coordinates."""
    c = coordinates(name)
    g = c.gradient(8)
    by = c.lifted.gradient(g, c.slots)
    step = c.lifted.times(np.arange(c.lifted.size), by[None])[:, 0]
    found = c.lifted.unknowns(step, c.slots)
    expected = c.dense.q @ g
    error = (found - expected)[c.slotted] / c.dense.sigma[c.slotted]
    assert np.abs(error).max() < c.rounding * np.sqrt(g @ expected)


@every_case
def test_gradient_and_unknowns_are_adjoint(name):
    """gᵀ x(z) = (gradient by z)ᵀ z for every movement z of the coordinates of free components."""
    c = coordinates(name)
    rng = np.random.default_rng(9)
    g, r = c.gradient(9), len(c.others)
    z = np.zeros(c.lifted.size)
    z[:r] = (np.where(c.dense.free, c.dense.sigma, 0.0) * rng.normal(size=c.n))[c.others]
    z[r : r + 3 * len(c.slots)] = rng.normal(size=3 * len(c.slots))
    by, x = c.lifted.gradient(g, c.slots), c.lifted.unknowns(z, c.slots)
    scale = np.abs(g) @ np.abs(x) + np.abs(by) @ np.abs(z)
    assert abs(g @ x - by @ z) < c.rounding * scale
    assert not by[r + 3 * len(c.slots) :].any()


@pytest.mark.parametrize("name", FIRST_LAYER)
def test_points_are_found_by_their_columns(name):
    c = coordinates(name)
    chosen = np.arange(len(c.points))[::2]
    columns = np.concatenate([c.others[:2], c.points[chosen, 1], c.points[chosen, 2]])
    assert c.lifted.touched(columns) == chosen.tolist()
    assert c.lifted.touched(c.others) == []


def test_without_a_first_layer_no_point_is_touched():
    c = coordinates("terrestrial")
    assert c.lifted.touched(np.arange(c.n)) == []


@every_case
def test_standard_deviations_are_estimated_to_about_a_fifth(name):
    """A root mean square of sixteen normal numbers scatters by 1/√32 of itself: 0.18.

    In a free network they are those of the minimal datum: Q N Q, zero for what it holds.
    """
    c = coordinates(name)
    x = c.dense.q @ c.dense.a.T
    expected = np.sqrt(np.einsum("ij,ij->i", x, x))
    moves = expected > 1e-4 * c.dense.sigma
    ratio = c.lifted.sigma[moves] / expected[moves]
    assert np.sqrt(np.mean((ratio - 1.0) ** 2)) < 1.5 / np.sqrt(2 * SIGMA_SAMPLES)
    assert ratio.min() > 0.3 and ratio.max() < 2.0
    assert np.all(c.lifted.sigma[~moves] < 2e-4 * c.dense.sigma[~moves])
