"""Precision maps against the adjustment itself, numerical partials and repeated adjustments."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.image import image
from factorgraph_adj.quality.precision_maps import MOST_POINTS_AT_ONCE, neighbours
from factorgraph_adj.quality.visible_rays import Visibility
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from tests.benchmarks.precision_maps import repeated, simulated_cloud
from tests.networks.photo_files import photo_block

REPETITIONS = 60


@cache
def block():
    """Return a small aerial block, adjusted."""
    return fga.adjust(simulate_aerial_block(1, image_points=900, points_per_photo=90).network)


def seen_in(solution):
    """Return which photos measured which points, (points, photos)."""
    photos, points = list(solution.network.photos), list(solution.network.points)
    out = np.zeros((len(points), len(photos)), dtype=bool)
    photo, point, *_ = solution.network.images.columns()
    out[point, photo] = True
    return out


def test_a_point_with_the_rays_of_a_tie_point_has_its_covariance():
    s = block()
    free = [not any(n in o.names() for o in s.network.observations.values()) for n in s.network.points] \
        if hasattr(next(iter(s.network.observations.values())), "names") else None
    measured = seen_in(s)
    found = fga.precision_map(s, s.state["point"], visible=measured)
    tie = fga.precision_map(s)
    assert np.array_equal(tie.covariances, s.point_covariances)
    assert np.array_equal(tie.photos, measured.sum(axis=1))
    same = found.photos == tie.photos
    assert same.sum() > 0.9 * len(same)
    ratio = found.covariances[same] / tie.covariances[same]
    print(np.abs(ratio-1).max(axis=(1,2)), free)
