"""Nominal coordinates lie exactly on the lines from which offsets were measured."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import (
    HeightDifference,
    LineOffset,
    PlumbOffset,
    SightOffset,
    SlopeDistance,
)
from factorgraph_adj.types import Array
from tests.support.arrivals import bare, batch, chunks, difference

STATIONS = {
    "A": (0.0, 0.0, 0.0),
    "B": (20.0, 0.0, 0.0),
    "C": (0.0, 30.0, 0.0),
    "D": (20.0, 25.0, 6.0),
    "E": (10.0, -20.0, -4.0),
}
SIGMA = 1e-4
"""Standard deviation of an offset, metres."""


def beamline(seed: int, *, nominal: bool, offset: float = 0.05) -> tuple[fga.Network, Array]:
    """Points along a line, up to some centimetres off, with offsets from it and from a plumb line.

    Args:
        seed: of the true places and of the errors.
        nominal: whether points and the plumb line start exactly on the line; else near the truth.
        offset: standard deviation of the true offsets, metres.
    """
    network, rng = fga.Network("beamline"), np.random.default_rng(seed)
    for name, x in STATIONS.items():
        network.add_point(name, x, fixed="xyz")
    at = np.array([[4.0 + 3.0 * i, 0.0, 0.0] for i in range(4)])
    true = at + offset * rng.standard_normal((4, 3))
    plumb = at[0] + offset * rng.standard_normal(3) * [1.0, 1.0, 0.0]
    begin = at[0] if nominal else plumb + 1e-3
    values = {"x": float(begin[0]), "y": float(begin[1])}
    network.add_frame("plumb", free=("x", "y"), values=values, level=True)
    for s in "CE":  # which say on which side the plumb line is
        read = float(np.hypot(*(plumb - STATIONS[s])[:2]) + SIGMA * rng.standard_normal())
        network.add(PlumbOffset("plumb", s, read, sigma=SIGMA))
    for i, (start, x) in enumerate(zip(at, true, strict=True)):
        name = f"P{i}"
        network.add_point(name, start if nominal else x + 1e-3)
        for s in "CDE":
            d = float(np.linalg.norm(x - STATIONS[s]) + 1e-3 * rng.standard_normal())
            network.add(SlopeDistance(s, name, d, sigma=1e-3))
        h = float(x[2] + 1e-3 * rng.standard_normal())
        network.add(HeightDifference("A", name, h, sigma=1e-3))
        for kind, d in (("line", np.hypot(x[1], x[2])), ("plumb", np.hypot(*(x - plumb)[:2]))):
            read = abs(float(d + SIGMA * rng.standard_normal()))
            if kind == "line":
                network.add(LineOffset(name, "A", "B", read, sigma=SIGMA))
            else:
                network.add(PlumbOffset("plumb", name, read, sigma=SIGMA))
    return network, true


@pytest.mark.parametrize("seed", range(20))
def test_a_start_on_several_lines_ends_where_one_beside_them_ends(seed: int) -> None:
    on, true = beamline(seed, nominal=True)
    a, b = fga.adjust(on), fga.adjust(beamline(seed, nominal=False)[0])
    assert a.converged
    assert b.converged
    assert a.vtpv == pytest.approx(b.vtpv, rel=1e-6)
    for i, x in enumerate(true):
        np.testing.assert_allclose(a.point(f"P{i}"), b.point(f"P{i}"), atol=1e-7)
        assert np.linalg.norm(a.point(f"P{i}") - x) < 6e-3


def test_a_line_of_sight_through_the_nominal_place_is_adjusted() -> None:
    network = fga.Network("sight")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    places = {"P": (0.0, 10.0, 0.0), "Q": (-0.03, 25.0, 0.0)}
    for name, x in places.items():
        network.add_point(name, x, fixed="xyz")
        read = abs(x[0] - 1e-3 * x[1])  # the sight is turned by a milliradian
        network.add(SightOffset("A", name, read, horizontal=0.0, zenith=np.pi / 2, sigma=SIGMA))
    network.set_orientation("A", value=0.0)
    solution = fga.adjust(network)
    assert solution.converged
    assert abs(float(solution.orientation("A").values[0])) == pytest.approx(1e-3, rel=1e-2)


def test_arrivals_at_nominal_places_are_the_batch() -> None:
    network, _ = beamline(3, nominal=True)
    inc = fga.IncrementalAdjustment(bare(network))
    for chunk in chunks(network, None):
        inc.add(chunk)
    inc.settle()
    assert set(inc.solution().network.observations) == set(network.observations)
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-6


def test_an_offset_of_which_nothing_can_move_is_told() -> None:
    network = fga.Network("held")
    for name, x in {"A": (0.0, 0.0, 0.0), "B": (9.0, 0.0, 0.0), "P": (4.0, 0.0, 0.0)}.items():
        network.add_point(name, x, fixed="xyz")
    network.add_point("Q", (1.0, 2.0, 3.0))
    for s in "ABP":
        network.add(SlopeDistance(s, "Q", 4.0, sigma=1e-3))
    network.add(LineOffset("P", "A", "B", 0.01, sigma=SIGMA))
    with pytest.raises(InputError, match=r"line_offset P A B.*its offset has no direction"):
        fga.adjust(network)
