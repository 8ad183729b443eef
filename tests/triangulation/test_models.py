"""Relative orientations and independent models against the bundle of the same photos."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import PhotoPosition
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.independent_models import (
    as_models,
    pairs_of_strips,
    relative_model,
)
from factorgraph_adj.types import Array
from tests.loaders.tsaiyoung import Strip, read_strip
from tests.networks.deformed_models import deformed_block
from tests.networks.strip import network_of_photos
from tests.networks.strip_of_photos import measured_strip, strip_plan, units
from tests.support.dense import Dense
from tests.support.places import data_dir

LONG = pytest.mark.slow("frequencies in simulated strips of models; short tests adjust one")

TIGHT = 1e-8
"""Bound on the last step, so that differences are those of the methods."""
LINEARISATION = 0.005
"""Share of a standard deviation that second-order terms of the relative orientation leave."""


def differences(a: fga.Solution, b: fga.Solution) -> tuple[Array, Array]:
    """Return by how much points differ, in their σ, and by how much their σ differ."""
    free = [p for p in a.network.points if p in b.network.points and a.covariance(p).any()]
    sigma = {p: b.standard_deviations(p) for p in free}
    moved = [(a.point(p) - b.point(p)) / sigma[p] for p in free]
    return np.array(moved), np.array([a.standard_deviations(p) / sigma[p] - 1 for p in free])


@pytest.mark.parametrize(("size", "overlap"), [(2, 0.85), (3, 0.8), (6, 0.8)])
def test_models_with_all_their_rays_are_the_bundle(size: int, overlap: float) -> None:
    """Pairs, triplets, one unit: points, their σ, vᵀPv and redundancy are those of the bundle."""
    chosen = units(6, size)
    network = measured_strip(strip_plan(overlap=overlap, whole=chosen), seed=3)
    bundle = fga.adjust(network, tolerance=TIGHT)
    block = as_models(network, chosen)
    solution = fga.adjust(block.network, tolerance=TIGHT)
    moved, sigma = differences(solution, bundle)
    assert np.abs(moved).max() < LINEARISATION
    assert np.abs(sigma).max() < LINEARISATION
    parts = [m.solution for m in block.models]
    assert solution.redundancy + sum(s.redundancy for s in parts) == bundle.redundancy
    vtpv = solution.vtpv + sum(s.vtpv for s in parts)
    assert vtpv == pytest.approx(bundle.vtpv, rel=LINEARISATION)


def test_what_is_left_is_linearisation() -> None:
    """Differences in σ fall with the errors themselves: they are of second order."""
    chosen = units(6, 2)
    found = []
    for factor in (1.0, 0.1):
        plan = strip_plan(overlap=0.85, whole=chosen)
        plan.images.sigma = [factor * s for s in plan.images.sigma]
        network = measured_strip(plan, seed=3)
        solution = fga.adjust(as_models(network, chosen).network, tolerance=TIGHT)
        moved, _ = differences(solution, fga.adjust(network, tolerance=TIGHT))
        found.append(float(np.abs(moved).max()))
    assert found[1] == pytest.approx(0.1 * found[0], rel=0.3)


def test_the_datum_of_a_model_is_of_no_influence() -> None:
    """The variance of the motions of a model is taken by its frame."""
    chosen = units(4, 2)
    network = measured_strip(strip_plan(4, overlap=0.85, whole=chosen), seed=1)
    block = as_models(network, chosen)
    first = fga.adjust(block.network, tolerance=TIGHT)
    other = block.network.copy()
    other.clusters = [
        (ids, c + 50 * m.variance * m.motions @ m.motions.T)
        for (ids, c), m in zip(block.network.clusters, block.models, strict=True)
    ]
    second = fga.adjust(other, tolerance=TIGHT)
    assert second.vtpv == pytest.approx(first.vtpv, rel=1e-4)  # a second-order rest
    moved, sigma = differences(second, first)
    assert np.abs(moved).max() < 1e-3
    assert np.abs(sigma).max() < 1e-4


def test_the_covariance_of_a_model_is_that_of_its_scatter() -> None:
    """Coordinates without motions of the whole, over many measurements of one pair."""
    plan = strip_plan(2, overlap=0.6)
    true = relative_model(measure(plan, seed=0, noise=False), ("0", "1"))
    places = np.array([*true.points.values(), *true.centres.values()]).ravel()
    basis, values, _ = np.linalg.svd(true.root, full_matrices=False)
    on = values > 1e-6 * values[0]
    whitened = []
    for seed in range(40):
        m = relative_model(measure(plan, seed=seed), ("0", "1"))
        error = np.array([*m.points.values(), *m.centres.values()]).ravel() - places
        error -= true.motions @ (true.motions.T @ error)
        whitened.append(basis[:, on].T @ error / values[on])
    z = np.array(whitened)
    # Of n unit normal numbers the mean square has σ = √(2/n).
    assert np.mean(z**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / z.size))
    assert np.sum(on) == len(true.root) - 7


def test_models_that_share_a_photo_use_its_rays_twice() -> None:
    """With their joint covariance they are nearly the bundle; in practice they promise too much.

    What the block of practice is worth is B Σ Bᵀ with its estimator B and the true covariance Σ of
    its model coordinates.
    """
    plan = strip_plan(7, overlap=0.8, rows=3)
    noiseless = measure(plan, seed=0, noise=False)
    bundle = fga.adjust(noiseless)
    joint = as_models(noiseless, joint=True).network
    practice = fga.adjust(as_models(noiseless).network)
    equations = practice.equations
    rows = np.concatenate([c.rows for c in equations.clusters])
    weights = np.zeros((equations.n_rows,) * 2)
    for c in equations.clusters:
        weights[np.ix_(c.rows, c.rows)] = c.whitener
    dense = Dense.at(equations, practice.state)
    q = dense.cofactor(np.zeros(len(dense.free), dtype=bool))[np.ix_(dense.free, dense.free)]
    estimator = (q @ dense.design.T @ weights)[:, rows]
    covariance = np.zeros((len(dense.free),) * 2)
    ((_, of_models),) = joint.clusters
    covariance[np.ix_(dense.free, dense.free)] = estimator @ of_models @ estimator.T
    free = [p for p in bundle.network.points if bundle.covariance(p).any()]

    def mean(variances: Array) -> Array:
        return np.asarray(np.sqrt(np.mean(variances, axis=0)))

    by_bundle, by_joint, told = (
        mean(np.array([np.diag(s.covariance(p)) for p in free]))
        for s in (bundle, fga.adjust(joint), practice)
    )
    points = equations.unknowns["point"]
    columns = np.array([points.offset[points.number[p]] + np.arange(3) for p in free])
    worth = mean(np.diag(covariance)[columns])
    np.testing.assert_allclose(by_joint, by_bundle, rtol=5e-4)  # 1.0001 of it
    np.testing.assert_array_less(by_bundle, by_joint)
    np.testing.assert_array_less(1.01 * by_bundle, worth)  # 1.01 to 1.02
    np.testing.assert_array_less(1.02 * told, worth)  # 1.03 to 1.06


def test_a_wrong_model_point_is_found() -> None:
    chosen = units(6, 3)
    network = measured_strip(strip_plan(whole=chosen), seed=5)
    block = as_models(network, chosen).network
    solution = fga.adjust(block)
    rel = fga.reliability(solution)
    # The best controlled coordinate with an error of three times what is found in 80 %.
    row = int(np.argmin(rel.mdb))
    ident = solution.observations.ids[row]
    axis = int(np.flatnonzero(np.array(solution.observations.ids) == ident).tolist().index(row))
    wrong = block.observations[ident]
    value = np.array(wrong.value)
    value[axis] += 3 * rel.mdb[row]
    block.observations[ident] = replace(wrong, value=tuple(value.tolist()))
    assert ident in [r.id for r in fga.snoop(block).rejected]


@pytest.fixture(scope="module")
def strip() -> Strip:
    return read_strip(data_dir("tsaiyoung_strip"))


@pytest.mark.published
def test_the_real_strip(strip: Strip) -> None:
    """σ0 of the relative orientations and of the bundle, µm (FRAMES 6.2)."""
    network = network_of_photos(strip)
    models = [relative_model(network, pair) for pair in pairs_of_strips(network)]
    assert [m.solution.redundancy for m in models] == [10, 3, 6]
    sigma0 = [m.solution.sigma0 for m in models]
    np.testing.assert_allclose(sigma0, [1.97, 2.93, 3.40], rtol=0, atol=0.0051)
    bundle = fga.adjust(network)
    assert (bundle.n_observations, bundle.n_unknowns) == (124, 96)
    assert bundle.sigma0 == pytest.approx(4.353, abs=0.0005)


def test_a_block_of_models_counts_as_the_strip_does() -> None:
    network = measured_strip(strip_plan(4, overlap=0.6), seed=2)
    block = as_models(network)
    assert [m.name for m in block.models] == ["0-1", "1-2", "2-3"]
    assert [row[0] for row in block.first_rows().cells] == ["0-1", "1-2", "2-3"]
    solution = fga.adjust(block.network)
    assert solution.converged
    assert fga.reliability(solution).redundancy_numbers.sum() == pytest.approx(
        solution.redundancy, abs=1e-6
    )
    without = as_models(network, centres=False)
    assert not without.network.photos
    assert fga.adjust(without.network).redundancy < solution.redundancy


def test_bad_units_are_named() -> None:
    network = measured_strip(strip_plan(4, overlap=0.6), seed=2)
    with pytest.raises(fga.InputError, match="unknown photo '9'; known: 0, 1, 2, 3"):
        relative_model(network, ("0", "9"))
    with pytest.raises(fga.InputError, match="different photos, two or more"):
        relative_model(network, ("0", "0"))
    with pytest.raises(fga.InputError, match="model '0-3': photo '0' shares 0 points"):
        relative_model(network, ("0", "3"))
    with pytest.raises(fga.InputError, match="two units have the same photos"):
        as_models(network, [("0", "1"), ("0", "1")])
    network.add(PhotoPosition("1", (0.0, 0.0, 0.0), sigma=(1, 1, 1), lever_arm=(0.1, 0.0, 0.0)))
    with pytest.raises(fga.InputError, match="a lever arm needs the attitude"):
        as_models(network)


def test_photos_from_one_place_give_no_model() -> None:
    network = measured_strip(strip_plan(2, overlap=0.6), seed=2)
    at = network.photos["0"].position
    network.photos["1"] = replace(network.photos["1"], position=at)
    with pytest.raises(fga.InputError, match="its projection centres are one place"):
        relative_model(network, ("0", "1"))


@LONG
def test_a_model_point_with_a_detectable_error_is_found_as_often_as_predicted() -> None:
    """Error of one ∇ in one model coordinate: in 80 % of the measurements its test value tells."""
    plan = deformed_block(weighted=())
    true = fga.adjust(measure(plan, seed=0, noise=False))
    rel = fga.reliability(true)
    ids = true.observations.ids
    row = next(i for i, n in enumerate(ids) if plan.observations[n].point == "2-1")
    first = ids.index(ids[row])
    found, trials = 0, 80
    for seed in range(trials):
        network = measure(plan, seed=seed)
        o = network.observations[ids[row]]
        value = np.array(o.value)
        value[row - first] += rel.mdb[row]
        network.observations[ids[row]] = replace(o, value=tuple(value.tolist()))
        tested = fga.reliability(fga.adjust(network, start=true))
        found += abs(tested.w[row]) > tested.critical_w
    # σ of a frequency of 0.8 in 80 trials is 0.045.
    assert found / trials == pytest.approx(0.8, abs=3.3 * 0.045)


def test_points_on_a_line_orient_no_photos() -> None:
    """Below the line of flight rays say nothing of the roll of the photos: it is named."""
    plan = strip_plan(2, overlap=0.6, rows=5)
    for name, p in list(plan.points.items()):
        x, _, _ = p.coordinates
        plan.points[name] = replace(p, coordinates=(x, 0.0, 0.0), fixed=(False,) * 3)
    for f in plan.photos.values():
        x, _, z = f.position
        plan.photos[f.name] = replace(f, position=(x, 0.0, z), rotation=np.diag([1.0, -1.0, -1.0]))
    with pytest.raises((fga.DatumError, fga.AdjustmentError)):
        relative_model(measure(plan, seed=0, noise=False), ("0", "1"))
