"""A photo at the wrong place that its first image points leave open is doubted."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.rotation import exp_rotation


def day(seed: int, turn: float, shift: float) -> fga.IncrementalAdjustment:
    """Return a day on which twelve right image points of one photo have come one by one."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(-20, 20, (12, 2)), rng.uniform(0, 5, 12)])
    centre = np.array([0.0, 0.0, 60.0])
    network = fga.Network("one photo")
    network.add_camera("camera", NoDistortion(), {"c": 50.0})
    for i, x in enumerate(places):
        network.add_point(f"P{i}", tuple(x), fixed="xyz")
    axis, way = rng.standard_normal((2, 3))
    network.add_photo(
        "photo",
        "camera",
        position=tuple(centre + shift * way / np.linalg.norm(way)),
        rotation=exp_rotation(np.radians(turn) * axis / np.linalg.norm(axis)),
        sigma_position=1e3,
        sigma_attitude=3.0,
    )
    inc = fga.IncrementalAdjustment(network)
    for i, x in enumerate(places):
        d = x - centre
        at = -50.0 * d[:2] / d[2] + 0.005 * rng.standard_normal(2)
        inc.add(ImagePoint("photo", f"P{i}", float(at[0]), float(at[1]), sigma=0.005))
    return inc


def test_a_photo_that_most_image_points_contradict_is_doubted():
    inc = day(3, 2.0, 1.0)
    assert len(inc.suspects) == 9
    (doubt,) = inc.doubts
    assert doubt.startswith("9 of 12 image points of photo 'photo' are suspects")
    assert doubt in inc.solution().second_places


def test_a_photo_at_its_place_is_not():
    inc = day(4, 2.0, 1.0)
    assert len(inc) == 12
    assert not inc.doubts
