"""The end of an adjustment does not depend on the sense in which a shape begins."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj import IncrementalAdjustment, Network, adjust
from factorgraph_adj.observations import GnssVector, OnPlane, PlaneDistance
from factorgraph_adj.solve.shape_minimum import with_shape_reversed
from factorgraph_adj.types import Array

MM = 1e-3
HIGH = 3.0
"""Distance of floor and ceiling, metres."""


def on_site(points: dict[str, Array]) -> Network:
    """Return a network in which points are known by a vector each."""
    network = Network("senses")
    network.add_point("O", (0.0, 0.0, 0.0), fixed="xyz")
    rng = np.random.default_rng(4)
    for name, xyz in points.items():
        network.add_point(name)
        noisy = xyz + rng.normal(0.0, MM, 3)
        network.add(GnssVector("O", name, tuple(noisy), sigma=(MM,) * 3, id=f"v {name}"))
    return network


def room(distance: float) -> Network:
    """Return floor and ceiling and their distance, the sense of which is that of its sign."""
    corners = [(1.0, 1.0), (5.0, 1.0), (5.0, 4.0), (1.0, 4.0), (3.0, 2.0)]
    heights = {"floor": 1.0, "ceiling": 1.0 + HIGH}
    network = on_site(
        {f"{s} {i}": np.array([*c, z]) for s, z in heights.items() for i, c in enumerate(corners)}
    )
    for shape in heights:
        network.add_shape(shape, "plane", origin=(3.0, 2.5, heights[shape]))
        for i in range(len(corners)):
            network.add(OnPlane(shape, f"{shape} {i}", sigma=MM, id=f"on {shape} {i}"))
    network.add(PlaneDistance("floor", "ceiling", distance, sigma=2 * MM, id="high"))
    return network


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_distance_with_a_sense_turns_the_normal_that_fits_it(sign: float) -> None:
    """Zero or less has the sense of the normal: the floor's then points down, away from it."""
    solution = adjust(room(sign * HIGH))
    assert solution.vtpv < 3 * solution.redundancy
    up = solution.state["frame"][solution.equations.unknowns["frame"].number["floor"], 8]
    assert np.isclose(abs(up), 1.0, atol=0.01)
    if sign < 0:
        assert up < 0


@pytest.mark.parametrize("first", ["high", "last"])
def test_the_sense_does_not_depend_on_when_the_distance_arrives(first: str) -> None:
    network = room(-HIGH)
    every = list(network.observations.values())
    if first == "high":
        every = every[::-1]
    bare = room(-HIGH)
    bare.observations.clear()
    adjustment = IncrementalAdjustment(bare, policy="accept")
    for o in every:
        adjustment.add(o)
    adjustment.settle()
    assert len(adjustment) == len(every)
    assert np.isclose(adjustment.solution().vtpv, adjust(network).vtpv, rtol=1e-6)


def test_turned_twice_a_frame_is_as_it_was_and_once_a_plane_fits_as_well() -> None:
    solution = adjust(room(HIGH))
    once = with_shape_reversed(solution.state, 0)
    assert np.allclose(with_shape_reversed(once, 0)["frame"], solution.state["frame"], atol=1e-15)
    assert not np.allclose(once["frame"], solution.state["frame"])
    v = solution.equations.residuals(once)
    assert np.isclose(v @ v, solution.vtpv, rtol=1e-9)
