"""What is told where images cannot be oriented, or not together."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.types import Array
from tests.networks.image_blocks import CAMERA, look_at, ring


def seen(rotations: Array, centres: Array, points: Array, *, y_down: tuple[int, ...] = ()):
    """Return photos of points, some of them with y downwards."""
    rng = np.random.default_rng(0)
    network = fga.Network("told", datum="free")
    network.add_camera(CAMERA, NoDistortion(), {"c": 28.0}, format=(36.0, 24.0))
    names = [f"P{i}" for i in range(len(points))]
    for name in names:
        network.add_point(name)
    for f, (r, at) in enumerate(zip(rotations, centres, strict=True)):
        p = (points - at) @ r
        xy = 28.0 * np.stack([p[:, 0] / p[:, 2], -p[:, 1] / p[:, 2]], 1)
        xy += rng.normal(0, 0.003, xy.shape)
        xy[:, 1] *= -1.0 if f in y_down else 1.0
        network.add_photo(f"F{f}", CAMERA)
        network.add_image_points(f"F{f}", names, xy, sigma=0.003)
    return network


def masked(keep) -> fga.Network:
    network = ring(1, photos=5, control=0).network
    photo, point, _, _ = network.images.columns()
    network.image_mask(keep(photo, point))
    return network


def test_one_photo():
    network = masked(lambda photo, point: photo == 0)
    with pytest.raises(fga.ApproximationError, match="only one photo has usable image points"):
        fga.adjust(network)


def test_a_principal_distance_in_another_unit():
    """Metres with image points in millimetres: no ray is in front of the camera."""
    network = ring(1, photos=5, control=0).network
    camera = network.cameras[CAMERA]
    values = (camera.values[0] / 1e5, *camera.values[1:])
    network.cameras[CAMERA] = replace(camera, values=values)
    with pytest.raises(fga.ApproximationError, match="image points in 5 photos have rays beside"):
        fga.adjust(network)


def test_photos_without_common_points():
    network = masked(lambda photo, point: point // 32 == photo)
    with pytest.raises(fga.ApproximationError, match="at most 0 points in common"):
        fga.adjust(network)


def test_photos_from_one_place():
    block = ring(1, photos=5, control=0)
    turns = [look_at(block.centres[0], np.full(3, 0.1 * i)) for i in range(5)]
    network = seen(np.array(turns), np.array([block.centres[0]] * 5), block.points)
    with pytest.raises(fga.ApproximationError, match="taken from one place"):
        fga.adjust(network)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_held_principal_distance_that_is_wrong(factor):
    network = ring(1, photos=6, control=0).network
    camera = network.cameras[CAMERA]
    network.cameras[CAMERA] = replace(camera, values=(28.0 * factor, *camera.values[1:]))
    said = " ".join(fga.orient(network).sentences())
    assert "do not fit it" in said
    assert re.search(rf"a principal distance of about 28(\.\d)?, not {28 * factor:g}:", said)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
def test_photos_whose_y_counts_downwards():
    block = ring(1, photos=8, control=0)
    network = seen(block.rotations, block.centres, block.points, y_down=(2, 5))
    (_, told) = fga.orient(network).doubts
    assert "does y count downwards?" in told and told.endswith("F2, F5.")


def test_points_in_a_plane_and_two_photos_are_enough():
    block = ring(1, photos=6, control=0)
    flat = block.points * [1.0, 1.0, 0.0]
    solution = fga.adjust(seen(block.rotations, block.centres, flat))
    assert 0.9 < solution.sigma0 < 1.1
    assert not fga.orient(masked(lambda photo, point: photo < 6)).doubts
