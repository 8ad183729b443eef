"""Free networks of shapes and angles in which nothing has a length have no minimum."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.shapes import SHAPES
from tests.networks.on_shapes import MM, ON, places, posed

SIGMA = 1e-4


def seen(shape: str, seed: int) -> fga.Network:
    """Return points on a shape, intersected by horizontal and vertical circles alone."""
    rng = np.random.default_rng([seed, list(SHAPES).index(shape)])
    x = posed(places(shape, 14, rng), rng)
    middle = x.mean(axis=0)
    network = fga.Network(shape, datum="free")
    network.add_shape("S", shape, origin=(middle + np.array([2.0, 1, 3])).round().tolist())
    stations = middle + np.array([[19, 1, 2], [-3, 18, -4], [1, -15, 9.0]])
    at = {f"P{i}": p for i, p in enumerate(x)} | {f"T{i}": p for i, p in enumerate(stations)}
    for name, p in at.items():
        network.add_point(name, p + 2 * MM * rng.normal(size=3))
    for a in ("T0", "T1", "T2"):
        for b in at:
            if a == b:
                continue
            d = at[b] - at[a]
            across = float(np.arctan2(d[0], d[1])) + SIGMA * rng.normal()
            zenith = float(np.arccos(d[2] / np.linalg.norm(d))) + SIGMA * rng.normal()
            network.add(o.Direction(a, b, across % (2 * np.pi), sigma=SIGMA))
            network.add(o.ZenithAngle(a, b, zenith, sigma=SIGMA))
    for i in range(len(x)):
        network.add(ON[shape]("S", f"P{i}", sigma=MM))
    return network


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", range(2))
def test_what_only_shrinks_is_refused_in_words(shape, seed):
    with pytest.raises(fga.DatumError) as told:
        fga.adjust(seen(shape, seed))
    assert "nothing in the free network has a length" in str(told.value)
    assert f"14 on {shape}" in str(told.value)
    assert "a distance" in str(told.value)


@pytest.mark.parametrize("shape", SHAPES)
def test_one_distance_gives_it_a_size(shape):
    network = seen(shape, 1)
    p, q = (np.array(network.points[n].coordinates) for n in ("T0", "T1"))
    network.add(o.SlopeDistance("T0", "T1", float(np.linalg.norm(p - q)), sigma=MM))
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    assert solution.datum_defect == 4


def test_a_known_radius_gives_it_a_size():
    network = seen("sphere", 1)
    network.set_size("S", 2.0, fixed=True)
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    assert solution.datum_defect == 4


def test_the_sum_of_squares_only_falls_as_the_network_shrinks():
    """The law behind the refusal: of a network given a size, half as large, vᵀPv is smaller."""
    sums = []
    for size in (1.0, 0.5, 0.25):
        network = seen("plane", 0)
        p, q = (np.array(network.points[n].coordinates) for n in ("T0", "T1"))
        middle = np.mean([x.coordinates for x in network.points.values()], axis=0)
        for name, x in list(network.points.items()):
            y = middle + size * (np.array(x.coordinates) - middle)
            network.points[name] = type(x)(name, tuple(y.tolist()))
        length = size * float(np.linalg.norm(p - q))
        network.add(o.SlopeDistance("T0", "T1", length, sigma=1e-6))
        sums.append(fga.adjust(network).vtpv)
    assert sums[0] > sums[1] > sums[2]
