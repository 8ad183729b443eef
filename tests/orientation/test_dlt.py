"""Direct linear transformation: calibration and pose of one photo from known points."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.rotation import log_rotation, world_R_camera
from factorgraph_adj.types import Array

# Six points and their image coordinates in the first view of the example of dltx (README at
# commit in data/dlt): millimetres and pixels.
POINTS = np.array(
    [[0, 0, 2550], [0, 0, 0], [0, 2632, 0], [4500, 0, 2550], [5000, 0, 0], [5660, 2620, 0]]
)
PIXELS = np.array(
    [[1810, 885], [1353, 786], [1362, 301], [455, 1010], [329, 832], [183, 180]], dtype=float
)


def photo(x: Array, *, c=(30.0, 30.0), at=(0.4, -0.7), shear=0.0) -> tuple[Array, Array, Array]:
    rotation = world_R_camera(0.2, -0.3, 1.1)
    centre = np.array([3.0, -2.0, 40.0])
    p = (x - centre) @ rotation
    tx, ty = p[:, 0] / p[:, 2], -p[:, 1] / p[:, 2]
    return np.stack([c[0] * tx + shear * c[1] * ty + at[0], c[1] * ty + at[1]], 1), rotation, centre


def cloud(seed: int, n: int) -> Array:
    return np.random.default_rng(seed).uniform(-8, 8, (n, 3))


@pytest.mark.parametrize("n", [6, 7, 30])
def test_exact_points_give_back_calibration_and_pose(n):
    x = cloud(1, n)
    xy, rotation, centre = photo(x, c=(30.0, 31.0), shear=0.01)
    found = fga.dlt(x, xy)
    assert found.principal_distance == pytest.approx((30.0, 31.0), rel=1e-7)
    assert found.principal_point == pytest.approx((0.4, -0.7), abs=1e-6)
    assert found.shear == pytest.approx(0.01, abs=1e-8)
    np.testing.assert_allclose(found.position, centre, atol=1e-6)
    assert np.linalg.norm(log_rotation((rotation.T @ found.rotation)[None])) < 1e-7
    np.testing.assert_allclose(found.image(x), xy, atol=1e-9)
    assert found.calibration["c"] == pytest.approx(np.sqrt(30 * 31), rel=1e-7)


def test_with_noise_no_other_coefficients_have_smaller_residuals():
    """SciPy minimises the same sum of squares over the eleven coefficients."""
    x = cloud(2, 25)
    xy = photo(x)[0] + np.random.default_rng(3).normal(0, 0.01, (25, 2))
    found = fga.dlt(x, xy)

    def misfit(scaled: Array) -> Array:
        p = np.append(scaled * found.coefficients, 1.0).reshape(3, 4)
        h = x @ p[:, :3].T + p[:, 3]
        return (h[:, :2] / h[:, 2:] - xy).ravel()

    best = least_squares(misfit, np.full(11, 1.0), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert (found.residuals**2).sum() == pytest.approx(2 * best.cost, rel=1e-8)


def test_the_example_of_dltx_is_reproduced_by_its_own_equations():
    """11 coefficients of 12 equations: the residuals are those of the example, below 3 pixels."""
    found = fga.dlt(POINTS, PIXELS)
    assert np.sqrt((found.residuals**2).mean()) < 3.0
    np.testing.assert_allclose(found.image(POINTS) - PIXELS, found.residuals, atol=1e-9)
    assert found.principal_distance[0] == pytest.approx(found.principal_distance[1], rel=0.01)


def test_the_calibration_starts_an_adjustment_that_ends_at_the_truth():
    x = cloud(4, 20)
    xy, _, centre = photo(x)
    found = fga.dlt(x, xy)
    network = fga.Network("calibration")
    network.add_camera(
        "camera",
        BrownLens(),
        found.calibration,
        free=("c", "x0", "y0"),
    )
    for i, at in enumerate(x):
        network.add_point(f"P{i}", at, fixed="xyz")
    network.add_photo("F", "camera", position=found.position, rotation=found.rotation)
    network.add_image_points("F", [f"P{i}" for i in range(20)], xy, sigma=0.005)
    solution = fga.adjust(network)
    assert solution.calibration("camera")["c"] == pytest.approx(30.0, rel=1e-6)
    np.testing.assert_allclose(solution.pose("F").position, centre, atol=1e-5)


@pytest.mark.parametrize(
    ("x", "xy", "why"),
    [
        (cloud(0, 5), np.zeros((5, 2)), "needs 6"),
        (cloud(0, 8) * [1, 1, 0], photo(cloud(0, 8) * [1, 1, 0])[0], "one plane"),
        (cloud(0, 8), photo(cloud(0, 8))[0] * [1, -1], "mirrored"),
        (cloud(0, 8), np.full((8, 2), np.nan), "finite"),
        (cloud(0, 8), np.zeros((7, 2)), r"\(n, 3\)"),
        (np.zeros((8, 3)), np.zeros((8, 2)), "one plane"),
    ],
)
def test_what_cannot_be_found_is_refused(x, xy, why):
    with pytest.raises(fga.InputError, match=why):
        fga.dlt(x, xy)
