"""Photos of a rolling shutter are retired with their motions, and motions come before points."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import PhotoShift
from tests.networks.rolling_drone import flown, measured

GONE = ("F0", "F1")


def strip() -> Network:
    network = measured(flown(6, 1, 200), 1)
    network.add(PhotoShift("F1", "F0", "F2", interval=8.0, sigma=(8.0, 8.0, 8.0)))
    return network


def unseen_later(network: Network) -> list[str]:
    """Return the points that only the photos see that are to be retired."""
    photo, point, _, _ = network.images.columns()
    names, points = list(network.photos), list(network.points)
    later = {p for f, p in zip(photo.tolist(), point.tolist(), strict=True) if names[f] not in GONE}
    return [name for i, name in enumerate(points) if i not in later]


def assert_rest_is_of_the_batch(graph: fga.IncrementalAdjustment, batch: fga.Solution) -> None:
    found = graph.solution()
    for photo in found.network.photos:
        mine, whole = (s.unknown("photo_motion", photo) for s in (found, batch))
        sigma = np.array(whole.sigmas)
        assert np.abs((np.array(mine.values) - whole.values) / sigma).max() < 1e-3
        np.testing.assert_allclose(mine.sigmas, sigma, rtol=1e-3)


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_motions_are_retired_with_their_photos(
    engine: Literal["isam2", "fronts"], tmp_path: Path
) -> None:
    network = strip()
    batch = fga.adjust(network)
    graph = fga.IncrementalAdjustment(network, engine=engine, journal=tmp_path / "j")
    graph.retire(photos=GONE, points=unseen_later(network))
    rest = graph.solution().network
    assert [*rest.of_kind("photo_motion")] == [*rest.photos] == ["F2", "F3", "F4", "F5"]
    assert_rest_is_of_the_batch(graph, batch)
    said = PhotoShift("F1", "F2", "F3", interval=4.0, sigma=(1.0, 1.0, 1.0))
    with pytest.raises(fga.InputError, match="photo 'F1'"):
        graph.add(said)
    del graph  # releases the journal
    resumed = fga.IncrementalAdjustment.resume(tmp_path / "j")
    assert_rest_is_of_the_batch(resumed, batch)
    resumed.settle(all=True)
    again = resumed.solution()
    assert {*again.network.of_kind("photo_motion")} == {*network.photos}
    assert again.vtpv == pytest.approx(batch.vtpv, rel=1e-6)
    assert_rest_is_of_the_batch(resumed, batch)


def test_a_motion_comes_before_the_image_points_of_its_photo() -> None:
    network = strip()
    del network.observations[[*network.observations][-1]]
    motion = network.of_kind("photo_motion").pop("F1")
    graph = fga.IncrementalAdjustment(network)
    with pytest.raises(
        fga.InputError, match=r"motion of photo 'F1': observation 'F1/P\d+' depends"
    ):
        graph.add((), unknowns={"photo_motion": {"F1": motion}})
