"""Networks of fisheye and panoramic photos, whose rays lead to all sides, from nothing."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import Lens, NoDistortion
from factorgraph_adj.models.ray_lens import (
    DivisionLens,
    EquirectangularLens,
    FisheyeLens,
    UnifiedLens,
)
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.report.plots.image_residuals import image_rows
from factorgraph_adj.report.plots.observation_lines import photo_outlines
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from factorgraph_adj.validate.network_structure import geometry_problems

SIGMA = 0.5
CASES: dict[str, tuple[Lens, dict[str, float], tuple[str, ...], float]] = {
    "fisheye": (
        FisheyeLens(),
        {"c": 500.0, "k1": 0.02, "k2": -0.004, "x0": 5.0, "y0": -3.0},
        ("c", "x0", "y0", "k1", "k2"),
        125.0,
    ),
    "division": (DivisionLens(), {"c": 500.0, "k1": -0.3}, ("c", "k1"), 120.0),
    "eucm": (
        UnifiedLens(),
        {"c": 500.0, "alpha": 0.55, "beta": 1.0},
        ("c", "alpha", "beta"),
        100.0,
    ),
    "equirectangular": (EquirectangularLens(), {"c": 4000 / (2 * np.pi)}, (), 180.0),
}
"""Lens, parameters, unknown ones, and the widest angle to the axis, degrees."""


def room(case: str, seed: int = 1) -> Network:
    """Return ten photos in a room of 10 × 8 × 4 m with points on all sides, as designed."""
    lens, values, free, widest = CASES[case]
    rng = np.random.default_rng(seed)
    network = Network(case)
    network.add_camera("camera", lens, values, free=free, unit="px")
    size = np.array([10.0, 8.0, 4.0])
    for i in range(60):
        at = rng.uniform(-0.5, 0.5, 3) * size
        side = i % 3
        at[side] = 0.5 * size[side] * (-1) ** (i // 3)
        network.add_point(f"P{i}", at, fixed="xyz" if i < 12 else "")
    for f in range(10):
        turn = exp_rotation(rng.normal(0.0, 1.5, (1, 3)))[0]
        at = rng.uniform(-0.3, 0.3, 3) * size
        network.add_photo(f"f{f}", "camera", position=at, rotation=turn)
        for name, point in network.points.items():
            ray = turn.T @ (np.array(point.coordinates) - at)
            if np.degrees(np.arccos(ray[2] / np.linalg.norm(ray))) < widest:
                network.add(ImagePoint(f"f{f}", name, 0.0, 0.0, sigma=SIGMA))
    return network


def forgotten(network: Network) -> Network:
    """Return the network without approximate values of photos and new points."""
    out = network.copy()
    for name, photo in network.photos.items():
        out.photos[name] = type(photo)(photo.name, photo.camera)
    for name, point in network.points.items():
        if not any(point.fixed):
            out.points[name] = type(point)(name, (np.nan,) * 3)
    return out


@pytest.mark.parametrize("case", CASES)
def test_photos_and_points_all_around_are_found_and_lie_within_their_covariance(case: str) -> None:
    truth = room(case)
    network = measure(truth, seed=2)
    solution = fga.adjust(forgotten(network))
    assert 0.9 < solution.sigma0 < 1.1
    chi2, n = 0.0, 0
    for name, point in truth.points.items():
        if not any(point.fixed):
            off = solution.point(name) - point.coordinates
            chi2 += off @ np.linalg.solve(solution.covariance(name), off)
            n += 3
    assert chi2 / n == pytest.approx(1.0, abs=0.45)
    assert behind(solution, network) > 0.1 * network.n_image_points


def behind(solution: fga.Solution, network: Network) -> int:
    """Return the number of image points at more than 90° to the axis."""
    count = 0
    for image in network.image_points():
        pose = solution.pose(image.photo)
        count += (pose.rotation.T @ (solution.point(image.point) - pose.position))[2] < 0
    return count


def test_reliability_and_checks_take_points_behind_the_camera() -> None:
    network = measure(room("fisheye"), seed=3)
    assert not list(geometry_problems(compile_network(network)))
    solution = fga.adjust(network)
    found = fga.reliability(solution)
    assert found.redundancy_numbers.sum() == pytest.approx(solution.redundancy, rel=1e-9)


def test_perspective_photo_still_refuses_points_behind_it() -> None:
    network = Network("a photo that looks away")
    network.add_camera("camera", NoDistortion(), {"c": 500.0}, unit="px")
    network.add_photo("f", "camera", position=(0, 0, 0), rotation=np.eye(3))
    for i, at in enumerate(((0.1, 0.2, -3.0), (0.5, -0.1, -2.0), (-0.4, 0.3, -4.0), (1, 1, -5.0))):
        network.add_point(f"P{i}", at, fixed="xyz")
        network.add(
            ImagePoint("f", f"P{i}", 500.0 * at[0] / at[2], -500.0 * at[1] / at[2], sigma=1)
        )
    with pytest.raises(InputError, match="behind"):
        fga.adjust(network)


@pytest.mark.parametrize("case", CASES)
def test_outline_of_a_wide_photo_follows_the_rays_to_its_corners(case: str) -> None:
    """Corners at 800 pixels: rays of the equidistant fisheye are there at 800/500 rad."""
    network = measure(room(case), seed=3)
    camera = network.cameras["camera"]
    network.cameras["camera"] = type(camera)(**{**vars(camera), "format": (1000.0, 600.0)})
    solution = fga.adjust(network)
    rays: Array = image_rows(solution).corner_rays("camera")
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-12)
    k = solution.state["calibration"][:1, : len(camera.lens.names)]
    v = camera.lens.seen(tuple(rays.T), np.zeros(4), np.zeros(4), k, jacobians=False).v
    np.testing.assert_allclose(np.abs(v[0]), 500.0, atol=1e-6)
    np.testing.assert_allclose(np.abs(v[1]), 300.0, atol=1e-6)
    assert photo_outlines(solution, image_rows(solution), 1.0).shape == (10, 11, 3)
