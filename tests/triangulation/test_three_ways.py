"""One block three ways: as photos, as independent models, and as sights in polar sub-frames.

A photo is a theodolite whose y axis looks down the axis of the camera and whose z axis is the top
of the image: direction atan(x/c), zenith angle π/2 − atan(y/√(c² + x²)).
"""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.triangulation.independent_models import as_models
from tests.networks.strip_of_photos import (
    FOCAL,
    SIGMA_IMAGE,
    as_sights,
    measured_strip,
    strip_plan,
    units,
)


def test_photos_models_and_polar_sub_frames_are_one_block() -> None:
    """Sights differ by 5·10⁻⁵ σ, models by 6·10⁻⁴ σ: what is quadratic in the errors of each."""
    chosen = units(6, 3)
    photos = measured_strip(strip_plan(whole=chosen), seed=3)
    bundle = fga.adjust(photos, tolerance=1e-8)
    models = fga.adjust(as_models(photos, chosen).network, tolerance=1e-8)
    sights = fga.adjust(as_sights(photos, FOCAL, SIGMA_IMAGE), tolerance=1e-8)
    assert (sights.n_observations, sights.n_unknowns) == (bundle.n_observations, bundle.n_unknowns)
    free = [p for p in bundle.network.points if bundle.covariance(p).any()]
    sigma = {p: bundle.standard_deviations(p) for p in free}
    for other, most in ((sights, 1e-3), (models, 5e-3)):
        off = [np.abs(other.point(p) - bundle.point(p)) / sigma[p] for p in free]
        assert np.max(off) < most
        ratio = [other.standard_deviations(p) / sigma[p] for p in free]
        np.testing.assert_allclose(ratio, 1.0, rtol=0, atol=most)
