"""A ray to a point behind the camera is left out alone, and the rest of its photo enters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.simulation.measurement import measure
from tests.support.arrivals import batch, difference

BEHIND = "photo/behind"


def seen() -> tuple[fga.Network, list[ImagePoint]]:
    """Return control points without observations, and their rays in one photo of unknown pose."""
    network = fga.Network("one point behind")
    network.add_camera("camera", BrownForwardLens(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    network.add_photo("photo", "camera", position=(0, 0, 20), rotation=down)
    rng = np.random.default_rng(4)
    for i in range(12):
        at = (*rng.uniform(-6, 6, 2), rng.uniform(-3, 3))
        network.add_point(f"G{i}", at, fixed="xyz")
        network.add(ImagePoint("photo", f"G{i}", 0, 0, sigma=0.001))
    measured = measure(network, seed=1)
    rays = list(measured.image_points())
    bare = measured.copy()
    bare.image_mask(np.zeros(len(rays), dtype=bool))
    bare.add_point("behind", (1.0, 2.0, 40.0), fixed="xyz")
    return bare, rays


@pytest.mark.parametrize(("policy", "outcome"), [("flag", "suspect"), ("reject", "rejected")])
def test_it_is_left_out_and_the_photo_enters(policy: Policy, outcome: str) -> None:
    """With the photo's first rays nothing else says where the photo is."""
    network, rays = seen()
    wild = replace(rays[0], point="behind", x=3.0, y=-2.0)
    inc = fga.IncrementalAdjustment(network, policy=policy)
    arrival = inc.add([*rays[:6], wild, *rays[6:]])
    told = {v.id: v.verdict for v in arrival.verdicts}
    assert told.pop(BEHIND) == outcome
    assert set(told.values()) == {"accepted"}
    assert len(inc) == len(rays)
    inc.settle()
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-6


def test_where_everything_is_accepted_the_solution_names_it() -> None:
    """The batch adjustment refuses it with the same words."""
    network, rays = seen()
    wild = replace(rays[0], point="behind", x=3.0, y=-2.0)
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add([*rays, wild])
    assert len(inc) == len(rays) + 1
    solution = inc.solution()
    assert not solution.converged
    with pytest.raises(fga.InputError, match="behind") as caught:
        fga.adjust(inc.network())
    assert solution.reason == str(caught.value)
    inc.remove(BEHIND)
    assert inc.solution().converged
