"""Approximate values of frames, and of places that only frames know."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import FrameCoordinate, HeightDifference
from factorgraph_adj.start.approximate_values import approximate
from tests.networks.every_kind import FRAMES
from tests.networks.frames import network_of_frames

PLACES = {
    "A": (0, 0, 10), "B": (100, 0, 11), "C": (100, 80, 12), "D": (0, 80, 9), "E": (50, 40, 10),
    "F": (60, 20, 14), "G": (200, 10, 13), "H": (210, 70, 8),
}  # fmt: skip
CENTIMETRE = 1e-2


def plans(*, heights: bool) -> fga.Network:
    """Return two plans of different scale that are joined, the An-block; A and B are known."""
    network = fga.Network("An-block")
    for name, (x, y, z) in PLACES.items():
        held = "xyz" if name in "AB" else "z" if heights else ""
        at = (x, y, z) if name in "AB" else (np.nan, np.nan, z) if heights else None
        network.add_point(name, at, fixed=held)
    rng = np.random.default_rng(4)
    for frame, turn, scale, names in (("m1", 0.5, 2e-3, "ABCDEF"), ("m2", -1.0, 1e-3, "BCFGH")):
        network.add_frame(frame, free=("rz", "x", "y", "ln_scale"), origin=(50, 40, 0), level=True)
        c, s = np.cos(turn), np.sin(turn)
        for name in names:
            q = (np.array(PLACES[name][:2]) - [30, 20]) @ [[c, -s], [s, c]] / scale
            q += rng.normal(0, CENTIMETRE / scale, 2)
            sigma = (CENTIMETRE / scale,) * 2
            network.add(FrameCoordinate(frame, name, tuple(q.tolist()), axes="xy", sigma=sigma))
    return network


def levelled(network: fga.Network) -> fga.Network:
    for a, b in pairwise(PLACES):
        network.add(HeightDifference(a, b, PLACES[b][2] - PLACES[a][2], sigma=0.001))
    return network


@pytest.mark.parametrize(
    "network", [plans(heights=True), levelled(plans(heights=False))], ids=["held", "levelled"]
)
def test_plans_are_joined_by_points_that_only_they_know(network):
    solution = fga.adjust(network)
    assert solution.converged
    for name, xyz in PLACES.items():
        np.testing.assert_allclose(solution.point(name), xyz, rtol=0, atol=10 * CENTIMETRE)


def test_heights_in_a_system_of_their_own():
    network = plans(heights=False)
    network.add_frame("heights", free=["z"])
    for name, (_, _, z) in PLACES.items():
        network.add(FrameCoordinate("heights", name, (z - 3.0,), axes="z", sigma=(0.001,)))
    solution = fga.adjust(network)
    for name, xyz in PLACES.items():
        np.testing.assert_allclose(solution.point(name)[2], xyz[2], rtol=0, atol=5e-3)
    assert solution.unknown("frame", "heights")["z"] == pytest.approx(3.0, abs=5e-3)


@pytest.mark.parametrize("frame_name", FRAMES)
def test_a_frame_of_another_unit_starts_where_its_places_are(frame_name):
    """Scale, rotation and offset belong together; a model has up to 65 % more metres in a unit."""
    network = network_of_frames(11, ("model", "levelled model"), frame_name=frame_name)
    for name, point in list(network.points.items())[:4]:
        network.points[name] = fga.Point(name, point.coordinates, (True,) * 3)
    network.datum = "given"
    equations = compile_network(network)
    start = approximate(equations)["frame"]
    solution = fga.adjust(network)
    for name, begun in zip(network.frames, start, strict=True):
        found = solution.unknown("frame", name)
        assert begun[12] == pytest.approx(found["ln_scale"], abs=1e-3)
    assert solution.iterations <= 3


def test_points_that_only_lost_frames_know_are_told_so():
    network = plans(heights=True)
    for ident, o in list(network.observations.items()):
        if o.frame == "m1" and o.point == "B":
            del network.observations[ident]
    with pytest.raises(fga.ApproximationError, match="joined to frames alone that are not reached"):
        fga.adjust(network)


def test_an_offset_along_an_axis_that_nothing_observes_is_named():
    network = plans(heights=True)
    del network.frames["m2"]
    network.add_frame("m2", free=("rz", "x", "y", "z", "ln_scale"), level=True)
    with pytest.raises(fga.ApproximationError, match=r"frame m2: none of its .* along z: hold"):
        fga.adjust(network)


def test_a_frame_in_which_nothing_is_observed_is_told_so():
    network = plans(heights=True)
    network.add_frame("idle")
    with pytest.raises(fga.ApproximationError, match="frame idle: nothing is observed in it"):
        fga.adjust(network)
