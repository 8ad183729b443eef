"""Estimates of epochs: they compare as their adjustments do, also after a way through JSON."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.epochs.congruence import compare_epochs
from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.epoch_estimates import EpochEstimate
from tests.loaders.gama import adjusted_epoch
from tests.loaders.hanna import read_hanna
from tests.networks.epochs import epoch, solved, solved_without, turned_vectors
from tests.support.places import data_dir


def stored(solution, number=1, **options):
    """Return the estimate of an adjustment as a database gives it back."""
    estimate = EpochEstimate.of(solution, number, 3600.0 * number, **options)
    return EpochEstimate.from_json(json.loads(json.dumps(estimate.to_json())))


def assert_same(one, two):
    """Check that two comparisons have the same figures."""
    assert one.stable == two.stable
    assert one.reference == two.reference
    assert one.roles.not_compared == two.roles.not_compared
    assert list(one.displacements) == list(two.displacements)
    for a, b in zip(one.displacements.values(), two.displacements.values(), strict=True):
        np.testing.assert_allclose(a.vector, b.vector, atol=1e-15)
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-12, atol=1e-24)
        assert a.test.value == pytest.approx(b.test.value, rel=1e-12)
        assert a.test.critical == b.test.critical
        assert a.detectable == pytest.approx(b.detectable, rel=1e-12)
    assert [s.test for s in one.steps] == [s.test for s in two.steps]
    assert one.scale == two.scale
    assert one.ratio == two.ratio
    assert str(one.scale_change) == str(two.scale_change)


@pytest.mark.parametrize("method", ["backward", "combinations", "robust"])
def test_free_epochs(method):
    one, two = solved(1), solved(2, {"B": (0.03, -0.02), "Q": (0.01, 0.0)})
    options = {"objects": ["P", "Q"], "method": method}
    expected = fga.congruence(one, two, **options)
    assert "B" in expected.moved
    found = compare_epochs(stored(one), stored(two, 2), **options)
    assert_same(found, expected)
    block = fga.block_motion(found, ["P", "Q"])
    assert block.values == pytest.approx(fga.block_motion(expected, ["P", "Q"]).values, abs=1e-14)


def test_held_epochs():
    first, second = (turned_vectors(turn, seed) for turn, seed in ((0.0, 1), (0.0, 2)))
    assert_same(compare_epochs(stored(first), stored(second, 2)), fga.congruence(first, second))


def test_held_coordinates_have_no_cofactors():
    """Their numbers would take the cofactors of the next unknowns."""
    found = stored(solved(1))
    held = np.flatnonzero(~found.free.ravel())
    assert len(held) and found.cofactors_of(found.components).shape == found.cofactors.shape
    for wrong in (held[:1], np.array([found.free.size])):
        with pytest.raises(InputError, match="no unknowns"):
            found.cofactors_of(wrong)
        with pytest.raises(InputError, match="no unknowns"):
            found.motions_of(wrong)


def test_kept_points_alone_are_compared_as_if_all_were_kept():
    one, two = solved(3), solved(4, {"Q": (0.02, 0.0)})
    every = compare_epochs(stored(one), stored(two), reference=["A", "B", "C"], objects=["Q"])
    kept = ["A", "B", "C", "Q", "not there"]
    few = compare_epochs(
        stored(one, points=kept), stored(two, points=kept), reference=["A", "B", "C"]
    )
    assert few.displacements["Q"].test == every.displacements["Q"].test
    with pytest.raises(InputError, match="epoch 1: has none of the points"):
        stored(one, points=["not there"])


def test_epochs_with_different_points():
    one, two = solved_without("D", 5), solved_without("Q", 6)
    expected = fga.congruence(one, two, objects=["P"])
    found = compare_epochs(stored(one), stored(two, 2), objects=["P"])
    assert found.roles.not_compared == {
        "Q": "in the first epoch alone",
        "D": "in the second epoch alone",
    }
    assert_same(found, expected)


@pytest.mark.published
def test_gama_through_estimates(tmp_path):
    first, second = (adjusted_epoch(n, tmp_path) for n in (1, 2))
    one, two = stored(first), stored(second, 2)
    assert set(one.held) >= {"A", "B", "C"}
    names = [n for n in one.names if n in two.names and n not in one.held]
    found = compare_epochs(one, two, reference=[], objects=names)
    assert_same(found, fga.congruence(first, second, reference=[], objects=names))
    assert len(names) == 7


@pytest.mark.published
def test_the_lock_through_its_estimate():
    lock = read_hanna(data_dir("hanna_lock") / "avdgem.out")
    solution = fga.adjust(lock.network)
    pairs = {n[1:]: n for n in ("0101", "0102", "0103", "0104")}
    both = stored(solution)
    assert (both.redundancy, both.motions.shape[1], both.datum) == (244, 3, "free")
    assert both.sigma0 == pytest.approx(1.02, abs=0.005)
    found = compare_epochs(both, pairs=pairs)
    assert_same(found, fga.congruence(solution, pairs=pairs))
    values = [found.displacements[n].test.value for n in pairs]
    assert values == pytest.approx([5.95, 71.06, 18.97, 8.96], rel=0.04)


def test_an_unfinished_adjustment_is_no_estimate():
    network = epoch(5)
    unfinished = fga.adjust(network, max_iterations=1)
    assert not unfinished.converged
    with pytest.raises(InputError, match="epoch 3: its adjustment is not converged"):
        EpochEstimate.of(unfinished, 3, 0.0)


def test_damaged_records_are_refused():
    record = EpochEstimate.of(solved(1), 1, 0.0).to_json()
    for name in record:
        with pytest.raises(InputError, match=f"it lacks {name}"):
            EpochEstimate.from_json({k: v for k, v in record.items() if k != name})
    with pytest.raises(InputError, match="no estimate of an epoch"):
        EpochEstimate.from_json(record | {"components": record["components"][1:]})
    with pytest.raises(InputError, match="no estimate of an epoch"):
        EpochEstimate.from_json(record | {"names": record["names"][1:]})
