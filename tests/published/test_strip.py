"""A real strip of four photos as independent models: relative orientations, then frames.

The figures are those of an independent computation; the repository has no result to compare with.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.loaders.tsaiyoung import read_strip
from tests.networks.strip import block_of_models, relatively_oriented
from tests.support.places import data_dir

pytestmark = pytest.mark.published

HALF_MM = 0.501e-3
"""Half the last printed digit of the check points."""


@pytest.fixture(scope="module")
def strip():
    return read_strip(data_dir("tsaiyoung_strip"))


@pytest.fixture(scope="module")
def models(strip):
    return tuple(relatively_oriented(pair) for pair in strip.pairs)


def test_relative_orientations(models):
    assert [m.redundancy for m in models] == [10, 3, 6]
    sigma0 = [m.sigma0 for m in models]
    np.testing.assert_allclose(sigma0, [1.97, 2.93, 3.40], rtol=0, atol=0.0051)


def test_simultaneous_models_with_projection_centres(strip, models):
    """Seven unknowns a model; four control points; no model, photo or tie point has a start."""
    solution = fga.adjust(block_of_models(strip, models))
    assert solution.converged
    assert (solution.n_observations, solution.n_unknowns, solution.redundancy) == (120, 105, 15)
    assert solution.sigma0 == pytest.approx(1.821, abs=0.0005)
    printed = {
        "1118": (0.148, 0.116, -0.477),
        "1202": (0.102, 0.069, -0.302),
        "1203": (0.030, -0.001, -0.241),
        "1204": (0.037, -0.026, 0.073),
        "1207": (0.029, 0.011, 0.240),
    }
    for name, expected in printed.items():
        error = solution.point(name) - strip.check[name]
        np.testing.assert_allclose(error, expected, rtol=0, atol=HALF_MM)
    assert fga.reliability(solution).redundancy_numbers.sum() == pytest.approx(15, abs=1e-6)


def test_the_order_of_the_models_does_not_matter(strip, models):
    """The middle one last, so that the outer ones have nothing in common with what is there."""
    one = fga.adjust(block_of_models(strip, models), tolerance=1e-8)
    other = fga.adjust(block_of_models(strip, (models[2], models[0], models[1])), tolerance=1e-8)
    assert other.vtpv == pytest.approx(one.vtpv, rel=1e-9)
    for name in one.network.points:
        np.testing.assert_allclose(one.point(name), other.point(name), rtol=0, atol=1e-6)
