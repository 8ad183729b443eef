"""A real aerial block of IGN: 68 photos, 14 491 image measurements, delivered orientation.

The figures are those of an independent computation, FRAMES 6.1; those of the projection are printed
by IGN, NT/G 71. What can pass here only if everything is right: the projection and its scale in the
flying height, the geoid, the convergence of meridians, the curvature of the Earth.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.types import Array
from tests.loaders import lambert_93
from tests.loaders.borea import Block, read_borea
from tests.support.places import data_dir

pytestmark = pytest.mark.published

HALF_MM = 0.0006
"""Half the last printed digit of coordinates, and 0.1 mm for the altitude of the ground."""
MEDIAN = 0.0011
"""Half the last printed digit of medians, and 3 m of altitude of the ground, 0.0002 px each."""


@pytest.fixture(scope="module")
def block() -> Block:
    return read_borea(data_dir("borea"))


@pytest.fixture(scope="module")
def intersected(block: Block) -> fga.Solution:
    return fga.adjust(block.network(held=True))


def image_residuals(network: fga.Network, state: dict[str, Array] | None = None) -> Array:
    """Return residuals of the image coordinates, pixels, at a state or the given values."""
    equations = compile_network(network)
    image = next(b for b in equations.blocks if b.kind == "image")
    at = equations.unknowns.start() if state is None else state
    return image.evaluate(network.frame, at, jacobians=False).residual


def rms(v: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(v**2, axis=0)))


def test_the_projection_has_the_constants_that_ign_prints() -> None:
    constants = (lambert_93.EXPONENT, lambert_93.CONSTANT, lambert_93.POLE_NORTHING)
    printed = (0.7256077650, 11_754_255.426, 12_655_612.050)
    assert np.all(np.abs(np.subtract(constants, printed)) < (1e-10, 6e-4, 6e-4))


def test_scale_and_convergence_are_differences_of_the_projection() -> None:
    latitude, longitude = np.radians([42.5, 43.6, 49.0]), np.radians([-1.0, 4.6, 7.5])
    east, north = lambert_93.to_grid(latitude, longitude)
    back = lambert_93.from_grid(east, north)
    np.testing.assert_allclose(back, (latitude, longitude), rtol=0, atol=1e-15)
    step = 1e-6
    m, _ = lambert_93._GRS80.radii(latitude)
    moved = np.array(lambert_93.to_grid(latitude + step, longitude)) - (east, north)
    length = np.linalg.norm(moved, axis=0)
    np.testing.assert_allclose(length / (m * step), lambert_93.scale(latitude), rtol=1e-6)
    to_north = np.stack([*(moved / length), np.zeros(3)], axis=1)
    turned = np.einsum("nij,nj->ni", lambert_93.enu_from_grid(longitude), to_north)
    np.testing.assert_allclose(turned, np.tile([0.0, 1.0, 0.0], (3, 1)), rtol=0, atol=1e-6)
    assert lambert_93.scale(np.radians([44.0, 49.0])) == pytest.approx([1.0, 1.0], abs=1e-12)


def test_delivered_orientation_and_points(block: Block) -> None:
    network = block.network(points=block.points, held=True)
    at = block.network(points=block.control, held=True)
    for name, x in block.control.items():
        network.add_point(name, x)
        at.points[name] = network.points[name]
    v = np.concatenate([image_residuals(network), image_residuals(at)])
    assert (len(block.photos), len(v)) == (68, 14427)
    np.testing.assert_allclose(rms(v), [0.189, 0.207], rtol=0, atol=0.0006)
    np.testing.assert_allclose(np.median(np.abs(v), axis=0), [0.100, 0.080], rtol=0, atol=MEDIAN)
    assert np.abs(v).max() == pytest.approx(1.56, abs=0.006)


def test_rays_of_the_delivered_orientation_intersect(
    block: Block, intersected: fga.Solution
) -> None:
    network = intersected.as_network()
    assert len(network.points) == 3007
    v = image_residuals(network)
    np.testing.assert_allclose(rms(v), [0.148, 0.172], rtol=0, atol=0.0006)
    d = np.array([intersected.point(n) - x for n, x in block.points.items()])
    assert len(d) == 3005
    np.testing.assert_allclose(d.mean(axis=0), [0.000, -0.001, 0.003], rtol=0, atol=HALF_MM)
    np.testing.assert_allclose(rms(d), [0.005, 0.006, 0.017], rtol=0, atol=HALF_MM)


def test_intersected_control_points(block: Block, intersected: fga.Solution) -> None:
    printed = {"1003": (0.006, -0.023, 0.016), "1005": (0.052, 0.008, 0.054)}
    for name, expected in printed.items():
        d = intersected.point(name) - block.control[name]
        np.testing.assert_allclose(d, expected, rtol=0, atol=HALF_MM)


def test_without_the_projection_scale_heights_are_half_a_metre_wrong() -> None:
    block = read_borea(data_dir("borea"), projection_scale=False)
    found = fga.adjust(block.network(points=block.control, held=True))
    d = [found.point(n)[2] - x[2] for n, x in block.control.items()]
    np.testing.assert_allclose(d, [0.52, 0.59], rtol=0, atol=0.006)
