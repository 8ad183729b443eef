"""Covariances of weak free blocks: right, or refused.

Photos on short bases leave the shape of a block hardly determined, and a minimal datum of
coordinates of its points hardly holds it. The reference is the dense pseudo-inverse on the same
inner constraints (`dense.Dense.cofactor`), from singular values of A: it keeps the square of the
digits that normal equations keep.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import SingularError
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import HeightDifference, ImagePoint
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.solve.datum_defects import minimal_datum
from factorgraph_adj.solve.factorisation import Factorisation
from factorgraph_adj.solve.normal_equations import (
    FIRST_PROBES,
    MAX_CLEAN_PROBE_ERROR,
    MAX_PROBE_ERROR,
    MAX_SIGMA_ENLARGEMENT,
    NOISE_SAMPLES,
    NormalEquations,
    choose_minimal_datum,
    estimates_from_noise,
    probed_variance_error,
)
from factorgraph_adj.types import Array
from tests.networks.small_block import small_block
from tests.support.dense import Dense

LONG = pytest.mark.slow("minimal data of many networks; short tests take one")

WRONG = 1e-3
"""Relative error of a standard deviation that must not be given out."""
NEARLY_EXACT = 1e-5
"""Relative error of standard deviations in the blocks that were worst: condition 10³ to 10⁵."""
CANCELLED = (7, 87, 197, 366, 484)
"""Blocks with a point far away in which a standard deviation of a point or a photo was off by
0.07 % to 51 %: the S-transformation of its block cancelled."""
BADLY_HELD = (100123, 100450, 100758, 100816)
"""Blocks in which one was off by 0.08 % to 2 %: the minimal datum held next to nothing."""


def far_point(seed: int) -> fga.Network:
    """Return photos side by side above a patch of points, of which one may be far below."""
    rng = np.random.default_rng(seed)
    n_photos, n_points = int(rng.integers(2, 6)), int(rng.integers(6, 16))
    distance = 10.0
    base = distance * 10.0 ** rng.uniform(-3.5, -0.7)
    depth = min(distance * 10.0 ** rng.uniform(-2.0, 0.0), 6.0)
    width = distance * 10.0 ** rng.uniform(-1.0, -0.3)
    at = rng.uniform(-1, 1, (n_points, 3)) * [width, width, depth / 2]
    if rng.random() < 0.3:
        at[0, 2] = -distance * 10.0 ** rng.uniform(0, 2)
        at[0, :2] *= -at[0, 2] / distance
    network = fga.Network(f"weak {seed}", datum="free")
    for i, x in enumerate(at):
        network.add_point(f"P{i}", tuple(x))
    calibrated = rng.random() < 0.1 and n_photos > 3
    network.add_camera("cam", BrownLens(), {"c": 28.0}, free=("c",) if calibrated else ())
    for i in range(n_photos):
        centre = np.array([0, 0, distance])
        centre = centre + rng.normal(size=3) * base * [1, 1, rng.choice([0.1, 1.0])]
        turn = exp_rotation(rng.normal(size=3) * [0.02, 0.02, 1.0])
        rotation = look_at(centre, np.zeros(3)) @ turn
        network.add_photo(f"F{i}", "cam", position=tuple(centre), rotation=rotation)
        for name in network.points:
            if not (n_photos > 2 and rng.random() < 0.15):
                network.add(ImagePoint(f"F{i}", name, 0.0, 0.0, sigma=0.004))
    return measure(network, seed=seed)


def flat_heap(seed: int) -> fga.Network:
    """Return photos from one side of a heap of points of any proportions, with any precision."""
    rng = np.random.default_rng(seed)
    n_photos, n_points = int(rng.integers(2, 7)), int(rng.integers(6, 16))
    extent = 10.0 ** rng.uniform(-2.0, 0.7, 3)
    at = rng.normal(size=(n_points, 3)) * extent
    near = rng.random(n_points) < rng.choice([0.0, 0.5])
    at[near] *= 10.0 ** rng.uniform(-3, 0)
    network = fga.Network(f"weak {seed}", datum="free")
    for i, x in enumerate(at):
        network.add_point(f"P{i}", tuple(x))
    network.add_camera("cam", BrownLens(), {"c": 28.0})
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    distance = 10.0 ** rng.uniform(1.0, 2.0)
    base = distance * 10.0 ** rng.uniform(-4.0, -0.5)
    missing = rng.choice([0.0, 0.1, 0.25])
    for i in range(n_photos):
        away = 10.0 ** rng.uniform(0, 1) if rng.random() < 0.1 else 1.0
        centre = axis * distance * away + base * rng.normal(size=3)
        target = rng.normal(size=3) * 0.1
        turn = exp_rotation(rng.normal(size=3) * [0.02, 0.02, 1.0])
        rotation = look_at(centre, target) @ turn
        network.add_photo(f"F{i}", "cam", position=tuple(centre), rotation=rotation)
        for name in network.points:
            if rng.random() >= missing:
                sigma = float(10.0 ** rng.uniform(-4, -2)) if seed % 2 else 0.002
                network.add(ImagePoint(f"F{i}", name, 0.0, 0.0, sigma=sigma))
    return measure(network, seed=seed)


def weak_block(seed: int) -> fga.Network:
    """Return a random weak block by its number: heaps from 100 000 on."""
    return flat_heap(seed) if seed >= 100_000 else far_point(seed)


def on_three_near_points(network: fga.Network) -> fga.Network:
    """Return the network with three neighbours as datum points."""
    at = {name: np.array(p.coordinates) for name, p in network.points.items()}
    middle = at["P1"]
    for name in sorted(at, key=lambda n: float(np.linalg.norm(at[n] - middle)))[:3]:
        network.points[name] = replace(network.points[name], datum=True)
    return network


def reference(solution: fga.Solution) -> Array:
    """Return Q on the inner constraints of the solution, (n_columns, n_columns)."""
    assert solution.datum is not None
    dense = Dense.at(solution.equations, solution.state)
    return dense.cofactor(solution.datum.columns)


def held_by_rays(solution: fga.Solution) -> Array:
    """Return a minimal datum of the datum points' coordinates that the most rays determine.

    It looks at the diagonal of N alone: at what is known of a coordinate if all else is held.
    """
    assert solution.datum is not None
    diagonal = solution.normal().diagonal
    weighted = solution.datum.motions * np.sqrt(diagonal)[:, None]
    held = minimal_datum(weighted, solution.datum.columns)
    constraint = np.zeros(len(diagonal))
    constraint[held] = diagonal[held]
    return constraint


def worst(solution: fga.Solution) -> float:
    """Return the largest relative error of a standard deviation, however it is asked for."""
    wanted = np.sqrt(np.diag(reference(solution)))
    unknowns = solution.equations.unknowns
    points = unknowns["point"].offset[:, None] + np.arange(3)
    every = np.sqrt(np.einsum("pii->pi", solution.point_covariances))
    single = np.array([solution.standard_deviations(n) for n in unknowns["point"].names])
    poses = unknowns["pose"].offset[:, None] + np.arange(6)
    photos = np.array([solution.pose(n).sigmas for n in unknowns["pose"].names])
    solved = np.sqrt(np.diag(solution.cofactor_times(np.eye(unknowns.n_columns))))
    free = unknowns.free
    return max(
        float(np.abs(every / wanted[points] - 1.0).max()),
        float(np.abs(single / wanted[points] - 1.0).max()),
        float(np.abs(photos / wanted[poses] - 1.0).max()),
        float(np.abs(solved[free] / wanted[free] - 1.0).max()),
    )


# -- right ----------------------------------------------------------------------------------------


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("seed", [*CANCELLED, *BADLY_HELD])
def test_standard_deviations_of_the_worst_blocks_are_those_of_the_dense_inverse(seed):
    solution = fga.adjust(weak_block(seed))
    assert solution.converged
    assert worst(solution) < NEARLY_EXACT


@pytest.mark.parametrize("seed", [22, 35, 37, 39, 54, 100022])
def test_they_are_so_on_three_near_datum_points_too(seed):
    solution = fga.adjust(on_three_near_points(weak_block(seed)))
    assert solution.converged
    assert worst(solution) < NEARLY_EXACT


@pytest.mark.slow(
    "random blocks, of which a few are weak in a way that nobody thought of; the other tests have "
    "the seeds that were wrong once"
)
def test_no_standard_deviation_of_random_weak_blocks_is_wrong_without_a_word():
    given = 0
    for seed in (*range(24), *range(100_000, 100_024)):
        try:
            solution = fga.adjust(weak_block(seed), max_iterations=30)
            if not solution.converged:
                continue
            assert worst(solution) < WRONG, seed
        except fga.AdjustmentError:
            continue
        given += 1
    assert given > 15  # the others do not converge, or are not determined


@pytest.mark.parametrize("seed", [197, 366, 100123, 100758])
def test_the_covariance_is_a_reflexive_inverse_on_its_inner_constraints(seed):
    """N Q N = N, Q N Q = Q and G_Dᵀ Q = 0, in units of the standard deviations."""
    solution = fga.adjust(weak_block(seed))
    assert solution.datum is not None
    design = Dense.at(solution.equations, solution.state).design
    q = solution.cofactor_times(np.eye(design.shape[1]))
    sigma = np.sqrt(np.diag(q))
    hat = design @ q @ design.T
    assert np.abs(hat @ design - design).max() < NEARLY_EXACT * np.abs(design).max()
    assert np.abs((q @ design.T @ design @ q - q) / np.outer(sigma, sigma)).max() < NEARLY_EXACT
    left = solution.datum.masked.T @ (q / sigma)
    terms = np.abs(solution.datum.masked).T @ sigma
    assert np.all(np.abs(left) < 1e-9 * terms[:, None])


# -- the minimal datum ----------------------------------------------------------------------------


@LONG
@pytest.mark.parametrize("seed", [*CANCELLED, *BADLY_HELD])
def test_a_well_chosen_minimal_datum_enlarges_no_standard_deviation_much(seed):
    solution = fga.adjust(weak_block(seed))
    poor = held_by_rays(solution)
    normal, datum = solution.normal(), solution.datum
    assert datum is not None

    def enlarged(constraint: Array) -> float:
        steps = estimates_from_noise(normal.system, normal.factorise(constraint), NOISE_SAMPLES)
        return choose_minimal_datum(datum, steps, normal.diagonal)[1]

    better = normal.better_minimal_datum(poor, datum)
    assert np.count_nonzero(better) == solution.datum_defect
    assert enlarged(better) < 0.3 * enlarged(poor)
    assert enlarged(poor) > 10.0 * MAX_SIGMA_ENLARGEMENT
    again = normal.better_minimal_datum(better, datum)
    assert enlarged(again) < 2.0 * enlarged(better)


def test_a_minimal_datum_that_holds_well_is_kept():
    solution = fga.adjust(held_levels())
    normal, datum = solution.normal(), solution.datum
    assert datum is not None
    assert normal.better_minimal_datum(solution.run.constraint, datum) is solution.run.constraint


def held_levels() -> fga.Network:
    """Return a free levelling network of five points, each measured against each."""
    network = fga.Network("levels", datum="free")
    heights = dict(zip("ABCDE", (10.0, 12.5, 11.0, 15.2, 9.1), strict=True))
    for name, z in heights.items():
        network.add_point(name, (0.0, 0.0, z), fixed="xy")
    for a, b in combinations(heights, 2):
        network.add(HeightDifference(a, b, heights[b] - heights[a], sigma=0.001))
    return network


def test_a_strong_block_is_exact():
    block = small_block()
    network = fga.Network("images", datum="free")
    for p in block.points.values():
        if p.name.startswith("P"):
            network.add_point(p.name, p.coordinates)
    network.cameras.update(block.cameras)
    for photo in block.photos.values():
        at = photo.position
        network.add_photo(photo.name, photo.camera, position=at, rotation=photo.rotation)
    network.add(*block.image_points())
    solution = fga.adjust(network)
    assert solution.factor.uncertainty < 1e-9
    assert worst(solution) < 1e-9


# -- the guard ------------------------------------------------------------------------------------


def test_poor_pivots_of_a_badly_held_datum_turn_to_qr():
    """Border (3e-10) and points (8e-5) pass their thresholds: only together they are too poor."""
    solution = fga.adjust(weak_block(100123))
    normal = solution.normal()
    columns = solution.equations.unknowns.columns
    number = solution.equations.unknowns["point"].number
    held = [
        *columns("point", number["P0"]),
        columns("point", number["P3"])[2],
        *columns("point", number["P9"]),
    ]
    constraint = np.zeros(len(normal.diagonal))
    shown = []
    for weight in 10.0 ** np.linspace(-2.0, 2.0, 9):  # rounding differs, no estimate does
        constraint[held] = weight * normal.diagonal[held]
        poor = normal.factorise(constraint, exact=True)
        assert not normal.solver.qr_everywhere
        shown.append((probed_variance_error(normal.system, poor), weight))
    worst_shown, weight = max(shown)
    assert worst_shown > 2.0 * MAX_PROBE_ERROR
    constraint[held] = weight * normal.diagonal[held]
    better = normal.for_covariances(constraint)  # without a word on inner constraints
    assert normal.solver.qr_everywhere
    assert better.uncertainty < 1e-2 * MAX_PROBE_ERROR


def damaged(monkeypatch: pytest.MonkeyPatch, by: float) -> None:
    """Let every factorisation be wrong by a factor on one column of the cameras' root."""
    whole = Factorisation.__init__

    def wrong(self: Factorisation, *args: Any, **kwargs: Any) -> None:
        whole(self, *args, **kwargs)
        first = [*self.fronts.own[:1], *self.fronts.across[:1]]
        for root in first or [self.fronts.root.own]:
            root[:, 0] *= 1.0 + by

    monkeypatch.setattr(Factorisation, "__init__", wrong)


ASKED = {
    "covariance": lambda s: s.covariance("P2"),
    "covariance of two": lambda s: s.covariance("P2", "P5"),
    "point_covariances": lambda s: s.point_covariances,
    "standard_deviations": lambda s: s.standard_deviations("P3"),
    "pose": lambda s: s.pose("F1"),
    "calibration": lambda s: s.calibration("D3"),
    "error_ellipse": lambda s: fga.error_ellipse(s, "P3"),
    "distance_precision": lambda s: fga.distance_precision(s, "P1", "P2"),
    "reliability": fga.reliability,
}


@pytest.mark.parametrize("name", ASKED)
def test_a_wrong_factorisation_gives_no_covariance(monkeypatch, name):
    solution = fga.adjust(small_block())
    damaged(monkeypatch, WRONG)
    with pytest.raises(fga.AdjustmentError, match=r"no covariances: .* weakest are \w+ '"):
        ASKED[name](solution)


def test_the_refusal_is_a_singular_system_to_its_callers(monkeypatch):
    solution = fga.adjust(small_block())
    damaged(monkeypatch, WRONG)
    with pytest.raises(SingularError):
        _ = solution.factor


@pytest.mark.parametrize("by", [1e-6, 1e-4, 1e-2])
def test_probes_show_an_error_of_the_size_that_it_has(monkeypatch, by):
    solution = fga.adjust(small_block())
    normal = solution.normal()
    assert probed_variance_error(normal.system, solution.factor) < MAX_CLEAN_PROBE_ERROR
    damaged(monkeypatch, by)
    again = NormalEquations(normal.solver, solution.state)
    found = probed_variance_error(again.system, again.factorise(solution.run.constraint))
    assert 0.1 * by < found < 20.0 * by


def test_probes_are_two_solutions_for_all_covariances():
    solution = fga.adjust(small_block())
    sides: list[int] = []
    whole = Factorisation.solve

    def counted(self: Factorisation, y: Array) -> Array:
        sides.append(y.shape[1])
        return whole(self, y)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Factorisation, "solve", counted)
        for name in solution.network.points:
            solution.standard_deviations(name)
    assert sides == [FIRST_PROBES, FIRST_PROBES]
    assert 0.0 < solution.factor.uncertainty < 1e-9
