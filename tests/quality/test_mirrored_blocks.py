"""Blocks of which all images are mirrored end as another world, and the cause is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import CAMERA, simulate_industry_block
from factorgraph_adj.models.image import ALONG_Y, EXCHANGED
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HeightDifference
from factorgraph_adj.types import Array
from tests.support.studies import cases

REJECTED = 0.6
"""Part of the levelling that contradicts a mirror image."""


def with_images(network: Network, xy: Array) -> Network:
    """Return a network with other image coordinates."""
    out = network.copy()
    f, p, _, sigma = network.images.columns()
    out.image_mask(np.zeros(len(f), dtype=bool))
    points, photos = list(network.points), list(network.photos)
    for number, photo in enumerate(photos):
        mine = f == number
        names = [points[i] for i in p[mine].tolist()]
        out.add_image_points(photo, names, xy[mine], sigma=sigma[mine])
    return out


def levelled(network: Network) -> list[str]:
    """Return the ids of height differences."""
    return [i for i, o in network.observations.items() if isinstance(o, HeightDifference)]


@pytest.fixture(scope="module")
def block() -> Network:
    """Return the industry block: photos, distances, a third of the levelling.

    What snooping has to reject, one by one, is the levelling.
    """
    network = simulate_industry_block(seed=2, photos=4, distances=50).network
    # With residuals of measured coordinates the search finds a mirror image that everything fits.
    for name, camera in network.cameras.items():
        network.cameras[name] = replace(camera, lens=camera.lens.in_ideal_coordinates)
    lines = levelled(network)
    return fga.without(network, sorted(set(lines) - set(lines[::3])))


def told(network: Network) -> tuple[fga.Snooping, list[str]]:
    """Return the snooping of a network, and the causes that it tells."""
    found = fga.snoop(network)
    return found, [] if found.causes is None else [
        f"{c.cause} {c.where}" for c in found.causes.more_probable
    ]


@pytest.mark.slow(
    "whole blocks with turned image axes are named; short tests of causes take single photos"
)
@pytest.mark.parametrize("cause", cases([ALONG_Y, EXCHANGED], [EXCHANGED]))
def test_the_axes_of_all_photos_are_named(block: Network, cause: str) -> None:
    xy = block.images.columns()[2]
    turned = xy * [1.0, -1.0] if cause == ALONG_Y else xy[:, ::-1]
    found, causes = told(with_images(block, turned))
    # Levelling: without it the mirror image of the hall fits.
    assert len(found.rejected) > REJECTED * len(levelled(block))
    assert causes[0] == f"{cause} of all photos"
    assert found.causes is not None and len(found.causes.found[0].ids) == block.n_image_points


@pytest.mark.slow(
    "whole blocks with turned image axes are named; short tests of causes take single photos"
)
def test_the_photos_of_one_camera_are_named(block: Network) -> None:
    network = block.copy()
    network.cameras["other"] = replace(network.cameras[CAMERA], name="other")
    names = list(network.photos)
    mine = names[1::2]
    for name in mine:
        network.photos[name] = replace(network.photos[name], camera="other")
    f, _, xy, _ = network.images.columns()
    flipped = np.isin(f, [names.index(n) for n in mine])
    _, causes = told(with_images(network, np.where(flipped[:, None], xy * [1.0, -1.0], xy)))
    assert causes[0] == "the direction of y of all photos of camera 'other'"


@pytest.mark.slow(
    "whole blocks with turned image axes are named; short tests of causes take single photos"
)
def test_levelling_with_the_other_sign_is_not_the_axes(block: Network) -> None:
    """A mirror image of the world too; the attitudes that were given fit as they are."""
    network = block.copy()
    for ident, o in network.observations.items():
        if isinstance(o, HeightDifference):
            network.observations[ident] = replace(o, value=-o.value)
    found, causes = told(network)
    assert len(found.rejected) > REJECTED * len(levelled(block))
    assert not any("of all photos" in c for c in causes)


def test_nothing_is_told_of_the_block_as_it_is(block: Network) -> None:
    assert not told(block)[1]
