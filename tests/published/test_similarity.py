"""Similarity transformations: Wolf and DeWitt, DeWitt's program, Grafarend and Awange."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.similarity import (
    SEVEN_POINTS,
    WOLF_DEWITT,
    WOLF_DEWITT_SIGMA,
    both_observed,
    inverted,
    only_targets_observed,
    similarity_of,
)
from tests.support.places import data_dir

pytestmark = pytest.mark.published

HALF = 0.5000001
"""Half a unit of the last printed digit, and what its decimal fraction lacks."""


def degrees(d: int, minutes: int, seconds: float) -> float:
    return d + minutes / 60 + seconds / 3600


def targets_observed(pairs):
    """Return the solution with residuals in X, and the similarity from x to X."""
    solution = fga.adjust(only_targets_observed(pairs), tolerance=1e-9)
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns) == (3 * len(pairs), 7)
    return solution, inverted(similarity_of(solution, "X"))


def test_both_sets_observed_give_the_scale_of_wolf_and_dewitt():
    """One frame is free, the other is that of the network; points and rotation have no start."""
    solution = fga.adjust(both_observed(WOLF_DEWITT, WOLF_DEWITT_SIGMA), tolerance=1e-9)
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns) == (24, 19)
    found = similarity_of(solution, "x")
    assert found.scale == pytest.approx(0.9499549354, abs=2 * HALF * 1e-10)  # cut off
    expected = (degrees(2, 16, 59.90), -degrees(0, 33, 5.59), degrees(224, 32, 11.56))
    error = (found.omega_phi_kappa - expected) * 3600
    np.testing.assert_allclose(error, 0, atol=HALF * 1e-2)
    np.testing.assert_allclose(
        found.shift, [10233.8542, 6549.9641, 720.8663], rtol=0, atol=HALF * 1e-4
    )


def test_observed_targets_are_weighted_points_of_the_network():
    """Coordinates in a frame that is the network's are prior values of the points."""
    frames = fga.adjust(both_observed(WOLF_DEWITT, WOLF_DEWITT_SIGMA), tolerance=1e-9)
    network = both_observed(WOLF_DEWITT, WOLF_DEWITT_SIGMA)
    for ident, o in list(network.observations.items()):
        if o.frame == "X":
            del network.observations[ident], network.points[o.point]
            network.add_point(o.point, o.value, sigma=o.sigma)
    del network.frames["X"]
    priors = fga.adjust(network, tolerance=1e-9)
    assert priors.sigma0 == pytest.approx(frames.sigma0, rel=1e-10)
    for name in network.points:
        np.testing.assert_allclose(priors.point(name), frames.point(name), rtol=0, atol=1e-9)


def test_targets_of_equal_weight_give_the_scale_of_wolf_and_dewitt():
    solution, found = targets_observed(WOLF_DEWITT)
    assert found.scale == pytest.approx(0.9499569402, abs=HALF * 1e-10)
    assert solution.sigma0 == pytest.approx(0.061189, abs=HALF * 1e-6)


def test_the_sample_of_dewitts_program():
    file = data_dir("similarity") / "samples" / "3DCONF_sample.dat"
    rows = [line.split() for line in file.read_text(encoding="utf-8").splitlines()]
    pairs = np.array([[float(w) for w in row[1:]] for row in rows if len(row) == 7])
    assert len(pairs) == 6
    solution, found = targets_observed(pairs)
    assert found.scale == pytest.approx(0.9967398632, abs=HALF * 1e-10)
    assert solution.sigma0 == pytest.approx(0.247549, abs=HALF * 1e-6)
    np.testing.assert_allclose(
        found.shift, [219.6204, 3.6870, -0.0599], rtol=0, atol=1.1 * HALF * 1e-4
    )


def test_a_datum_transformation_over_seven_points():
    """Grafarend and Awange (2003). Geocentric coordinates have 1 nm, their shifts 10⁻⁵ m."""
    solution, found = targets_observed(SEVEN_POINTS)
    assert found.scale == pytest.approx(1.0000055825, abs=HALF * 1e-10)
    assert solution.sigma0 == pytest.approx(0.0772, abs=HALF * 1e-4)
    np.testing.assert_allclose(
        found.shift, [641.8804, 68.6553, 416.3982], rtol=0, atol=1.1 * HALF * 1e-4
    )
    turn = found.rotation - np.eye(3)
    arcsec = np.degrees([turn[2, 1], turn[0, 2], turn[1, 0]]) * 3600
    np.testing.assert_allclose(arcsec, [0.9985, -0.8937, -0.9931], rtol=0, atol=HALF * 1e-4)
