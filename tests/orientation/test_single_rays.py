"""A part is placed by rays to known points of which each is seen once."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.orientation.robust_similarity import similarity_from_sights
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array

LONG = pytest.mark.slow(
    "twenty seeded similarities from single rays; "
    "short tests find one in each place where blocks begin"
)

HEIGHT = 60.0


def sights(rng: np.random.Generator, n: int, relief: float) -> tuple[Array, Array, Array]:
    """Return projection centres, unit vectors of rays and known points, (n, 3) each."""
    known = rng.uniform(-1, 1, (n, 3)) * [50.0, 50.0, relief]
    centre = np.column_stack([rng.uniform(-30, 30, (n, 2)), HEIGHT + rng.normal(0, 2, n)])
    ray = known - centre
    return centre, ray / np.linalg.norm(ray, axis=1, keepdims=True), known


@LONG
@pytest.mark.parametrize("relief", [0.0, 5.0])
@pytest.mark.parametrize(("n", "wrong"), [(4, 0), (5, 0), (8, 0), (13, 2), (20, 3)])
@pytest.mark.parametrize("scale", [0.01, 40.0])
def test_four_rays_or_more_find_any_similarity(n: int, wrong: int, scale: float, relief: float):
    """Of 13 rays two are wrong, of 20 three; flat ground tells as much as relief."""
    rng = np.random.default_rng([n, int(relief)])
    centre, ray, known = sights(rng, n, relief)
    ray[:wrong] = [0.0, 0.0, -1.0] + rng.uniform(-0.5, 0.5, (wrong, 3)) * [1.0, 1.0, 0.0]
    ray += rng.normal(0, 1e-6, ray.shape)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    r, t = exp_rotation(rng.normal(0, 2, 3)), rng.normal(0, 1000, 3)
    found = similarity_from_sights((centre - t) @ r / scale, ray @ r, known)
    assert found is not None
    assert np.abs(found.of((centre - t) @ r / scale) - centre).max() < (0.01 if wrong else 0.003)
