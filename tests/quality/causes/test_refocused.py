"""A camera that was refocused between two photos of a block."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.photo_block import FOCAL, block

CHANGE = 0.15
"""Change of the principal distance, mm."""
CENTRE = (0.05, -0.08)
"""True principal point, mm."""


def refocused(seed: int, change: float) -> tuple[fga.Network, str]:
    """Return a block whose later photos have another principal distance, and the first of them."""
    network = block(seed)
    photo, point, xy, sigma = network.images.columns()
    photos, points = list(network.photos), list(network.points)
    first = 3 + seed % 3
    network.image_mask(np.zeros(len(photo), dtype=bool))
    for i, name in enumerate(photos):
        mine = photo == network.photo_number[name]
        scale = 1.0 + change / FOCAL * (i >= first)
        image = CENTRE + scale * (xy[mine] - CENTRE)
        names = [points[p] for p in point[mine].tolist()]
        network.add_image_points(name, names, image, sigma=sigma[mine])
    return network, photos[first]


MORE = pytest.mark.slow("ten more seeds of each block; short tests take the first ten of each")
SEEDS = [range(10), pytest.param(range(10, 20), marks=MORE)]


@pytest.mark.parametrize("seeds", SEEDS)
def test_the_photo_from_which_the_principal_distance_is_another_is_named(seeds: range) -> None:
    """Alone, or with the photos beside it between which nothing tells."""
    alone = 0
    for seed in seeds:
        network, name = refocused(seed, CHANGE)
        found = fga.causes(fga.reliability(fga.adjust(network)))
        text = f"the principal distance, another one from photo {name!r} on, of camera 'C'"
        first = found.most_probable
        own = found.undecided if first is None else (f"{first.cause} {first.where}",)
        assert text in own, seed
        alone += first is not None
        mine = next(c for c in found.found if f"{c.cause} {c.where}" == text)
        assert abs(mine.error[0] - CHANGE) < 4.0 * mine.sigma[0]
    assert alone >= 5


@pytest.mark.parametrize("seeds", SEEDS)
def test_without_a_change_nothing_is_named(seeds: range) -> None:
    for seed in seeds:
        network, _ = refocused(seed, 0.0)
        assert not fga.causes(fga.reliability(fga.adjust(network))).more_probable, seed
