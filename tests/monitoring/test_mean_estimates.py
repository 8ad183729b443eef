"""The mean of epochs: that of one adjustment of all their readings, and independent innovations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.epochs.congruence import compare_epochs
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.monitoring.epoch_estimates import EpochEstimate
from factorgraph_adj.monitoring.mean_estimates import MeanEstimate, mean_estimate
from tests.networks.epochs import PLACES, epoch, solved, solved_without


def estimates(solutions):
    return [EpochEstimate.of(s, i, 60.0 * i) for i, s in enumerate(solutions)]


def together(networks, datum):
    """Return one adjustment of the readings of several epochs."""
    network = fga.Network("all", datum=datum)
    for n in networks[0].points.values():
        network.points[n.name] = n
    for i, one in enumerate(networks):
        for o in one.observations.values():
            own = {"set": str(i)} if o.kind == "direction" else {}
            network.add(replace(o, id=None, **own))
    return fga.adjust(network)


@pytest.mark.parametrize("datum", ["free", "given"])
def test_the_mean_is_the_adjustment_of_all_readings(datum):
    networks = [epoch(seed, datum=datum) for seed in range(4)]
    expected = EpochEstimate.of(together(networks, datum), 0, 90.0)
    found = mean_estimate(estimates([fga.adjust(n) for n in networks]))
    assert found.names == expected.names
    # What is not linear differs by 1 mm · 2 mm / 300 m.
    np.testing.assert_allclose(found.coordinates, expected.coordinates, atol=3e-8)
    np.testing.assert_allclose(found.cofactors, expected.cofactors, rtol=1e-4, atol=1e-10)
    assert found.redundancy == expected.redundancy
    assert found.vtpv == pytest.approx(expected.vtpv, rel=1e-4)
    assert found.motions.shape == expected.motions.shape
    assert (found.time, found.n_observations) == (90.0, expected.n_observations)
    assert found.held == expected.held


def test_epochs_may_lack_points():
    one, two, three = estimates([solved_without("D", 1), solved_without("Q", 2), solved(3)])
    found = mean_estimate([one, two, three])
    assert set(found.names) == set(PLACES)
    assert found.names[-1] == "D"
    compared = compare_epochs(found, three, objects=["P", "Q"])
    assert set(compared.displacements) == set(PLACES)
    # The order of epochs has no part in what the mean says of another epoch.
    again = compare_epochs(mean_estimate([three, one, two]), three, objects=["P", "Q"])
    for name, x in compared.displacements.items():
        assert again.displacements[name].vector == pytest.approx(x.vector, abs=1e-8)
        assert again.displacements[name].test.value == pytest.approx(x.test.value, rel=1e-3)


def test_innovations_have_their_covariance_and_do_not_depend_on_each_other():
    """300 innovations of a point that kept its place: uᵀu ~ χ²(2), no correlation in time."""
    (first,) = estimates([solved(1)])
    values, vectors = np.linalg.eigh(first.cofactors)
    root = vectors * np.sqrt(values.clip(0.0))
    rng, u = np.random.default_rng(4), []
    for _ in range(30):
        mean, own = MeanEstimate(), []
        for i in range(11):
            x = first.coordinates.copy()
            x[first.free] += root @ rng.standard_normal(len(values))
            e = replace(first, number=i, coordinates=x)
            if len(mean):
                found = compare_epochs(
                    mean.estimate(), e, objects=["P", "Q"], variance="a-priori", alpha=1e-9
                )
                d = found.displacements["P"]
                own.append(np.linalg.solve(np.linalg.cholesky(d.covariance[:2, :2]), d.vector[:2]))
            mean.add(e)
        u.append(own)
    u = np.array(u)
    assert np.mean(u**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / u.size))
    for lag in (1, 2, 5):
        products = u[:, lag:] * u[:, :-lag]
        assert abs(products.mean()) < 4 / np.sqrt(products.size)


def test_wrong_epochs_are_refused():
    one, two = estimates([solved(1), solved(2)])
    with pytest.raises(InputError, match="epoch 1: its frame is"):
        mean_estimate([one, replace(two, frame=GeocentricFrame())])
    held = EpochEstimate.of(fga.adjust(epoch(3, datum="given")), 7, 0.0)
    with pytest.raises(InputError, match="epoch 7, point 'A': is held in some epochs"):
        mean_estimate([one, held])
    with pytest.raises(InputError, match="no epochs"):
        MeanEstimate().estimate()


@pytest.mark.parametrize("turn", [0.1, 2.0])
def test_a_free_network_may_lie_turned(turn):
    """An epoch with arbitrary coordinates, turned with its cofactors and motions, says the same."""
    one, two = estimates([solved(1), solved(2)])
    c, s = np.cos(turn), np.sin(turn)
    r = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    every = np.kron(np.eye(len(two.names)), r)[np.ix_(two.components, two.components)]
    turned = replace(
        two,
        coordinates=two.coordinates @ r.T,
        cofactors=every @ two.cofactors @ every.T,
        motions=every @ two.motions,
    )
    expected, found = mean_estimate([one, two]), mean_estimate([one, turned])
    np.testing.assert_allclose(found.coordinates, expected.coordinates, atol=1e-8)
    np.testing.assert_allclose(found.cofactors, expected.cofactors, rtol=1e-4, atol=1e-11)
    assert found.vtpv == pytest.approx(expected.vtpv, rel=1e-5)
