"""Principal distances that are tried: by control, by pairs, by the format."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens, NoDistortion
from factorgraph_adj.orientation.block_input import Views
from factorgraph_adj.orientation.unknown_calibration import (
    TRIED_DISTANCE_FACTORS,
    PrincipalDistances,
)
from tests.networks.image_blocks import CAMERA, HALF, ImageBlock, aerial, ring
from tests.support.studies import cases


def distances(block: ImageBlock, *, known: bool = False, stated=None) -> PrincipalDistances:
    points = np.array(
        [p.coordinates for p in (block.truth if known else block.network).points.values()]
    )
    return PrincipalDistances(Views.of(block.network), stated or {}, points)


@pytest.mark.parametrize("seed", range(3))
def test_pairs_of_convergent_photos_tell_the_principal_distance(seed):
    found = list(distances(ring(seed, guess=60.0)).others())
    assert len(found) == 1 + len(TRIED_DISTANCE_FACTORS)
    assert found[0][0][0] == pytest.approx(28.0, rel=0.03)


def test_known_points_tell_it_better_and_come_first():
    found = list(distances(ring(0, guess=60.0), known=True).others())
    assert len(found) == 2 + len(TRIED_DISTANCE_FACTORS)
    assert found[0][0][0] == pytest.approx(28.0, rel=2e-3)


def test_multiples_of_the_longer_side_are_tried_then():
    found = [c[0][0] for c in distances(aerial(0, guess=60.0)).others()]
    assert found[-len(TRIED_DISTANCE_FACTORS) :] == pytest.approx(
        [2 * HALF[0] * f for f in TRIED_DISTANCE_FACTORS]
    )


def test_without_a_format_the_image_points_tell_the_side():
    block = ring(0, guess=60.0)
    camera = block.network.cameras[CAMERA]
    block.network.cameras[CAMERA] = replace(camera, format=None)
    found = [c[0][0] for c in distances(block).others()]
    span = np.ptp(block.network.images.columns()[2], axis=0).max()
    assert found[-len(TRIED_DISTANCE_FACTORS) :] == pytest.approx(
        [span * f for f in TRIED_DISTANCE_FACTORS]
    )


def test_a_held_principal_distance_is_not_changed():
    given = distances(ring(0))
    assert given.guessed == ()
    assert list(given.others()) == []


def test_stated_ones_are_tried_in_their_order_and_nothing_else():
    given = distances(ring(0, guess=60.0), stated={CAMERA: [50.0, 35.0, 28.0]})
    assert [c[0][0] for c in (given.first(), *given.others())] == [50.0, 35.0, 28.0]


def test_a_camera_without_a_principal_distance_begins_at_a_multiple_of_its_format():
    network = fga.Network("no EXIF")
    network.add_camera("a", BrownLens(), {}, free=["c"], format=(36.0, 24.0))
    assert network.cameras["a"].values[0] == pytest.approx(1.2 * 36.0)
    for options in ({"free": ["c"]}, {"format": (36.0, 24.0)}):
        with pytest.raises(fga.InputError, match="may be left out if it is free and the format"):
            network.add_camera("b", BrownLens(), {}, **options)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("seed", cases(range(3), [0]))
def test_a_block_finds_the_principal_distance_that_nobody_knows(seed, tmp_path):
    block = ring(seed, photos=8, control=0, guess=28.0)
    fga.write_project(block.network, tmp_path / "ring" / "project.toml")
    file = tmp_path / "ring" / "project.toml"
    text = file.read_text()
    given = "c = { value = 28.0, free = true }"
    assert given in text
    file.write_text(text.replace(given, "c = { free = true }"))
    network = fga.read_project(tmp_path / "ring")
    assert network.cameras[CAMERA].values[0] == pytest.approx(43.2)
    solution = fga.adjust(network)
    assert solution.vtpv == pytest.approx(fga.adjust(block.truth).vtpv, rel=1e-9)
    assert "was found by a search" in " ".join(solution.begun)


def test_image_points_that_are_all_equal_end_in_a_message() -> None:
    """They cover nothing, by which pairs of photos were divided."""
    network = fga.Network("nothing measured yet")
    network.add_camera("C", NoDistortion(), {"c": 30.0}, free=["c"])
    for i in range(8):
        network.add_point(f"P{i}", (float(i), float(i * i % 5), 0.1 * i))
    for photo in ("f1", "f2"):
        network.add_photo(photo, "C")
        network.add_image_points(photo, list(network.points), np.zeros((8, 2)), sigma=0.01)
    with pytest.raises(fga.AdjustmentError):
        fga.adjust(network)
