"""Parallel projection: the limit of central projection, what is held, starts, blunders, files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import ImageLine, PhotoRange
from factorgraph_adj.simulation.measurement import disturb, measure
from tests.networks.microscope import SCALE, microscope
from tests.support.arrivals import (
    assert_any_order_ends_at_the_batch,
)
from tests.support.scatter import (
    assert_estimates_scatter_as_their_covariance_says,
    assert_the_variance_of_unit_weight_follows_its_distribution,
    few,
)

MICROMETRE = 1e-6


def test_parallel_projection_is_the_limit_of_a_telephoto_lens() -> None:
    """From 10 m the rays to an object of 40 µm deviate by 2·10⁻⁶ from parallel ones."""
    away = 10.0
    parallel = measure(microscope(), seed=3)
    central = parallel.copy()
    camera = parallel.cameras["SEM"]
    values = dict(zip(camera.lens.names, camera.values, strict=True)) | {"c": SCALE * away}
    sigma = {n: s for n, s in zip(camera.lens.names, camera.sigma, strict=True) if s < np.inf}
    del central.cameras["SEM"]
    central.add_camera("SEM", BrownLens(), values, free=("c",), sigma=sigma, unit="px")
    for f in parallel.photos.values():
        at = np.array(parallel.points["P0"].coordinates) - away * f.rotation[:, 2]
        central.photos[f.name] = replace(f, position=tuple(at), fixed=(False,) * 6)
        central.add(PhotoRange("P0", f.name, away, sigma=1e-9 * away))
    ours, theirs = fga.adjust(parallel), fga.adjust(central)
    for name in parallel.points:
        np.testing.assert_allclose(ours.point(name), theirs.point(name), atol=1e-4 * MICROMETRE)
        mine, other = ours.standard_deviations(name), theirs.standard_deviations(name)
        np.testing.assert_allclose(mine, other, rtol=1e-3)
    np.testing.assert_allclose(ours.vtpv, theirs.vtpv, rtol=1e-4)


def test_coordinate_along_the_viewing_axis_is_held_and_the_report_says_so() -> None:
    network = microscope()
    assert all(f.fixed == (*(False,) * 5, True) for f in network.photos.values())
    (said,) = network.remarks
    assert "z of its photos is held" in said
    report = fga.text_report(fga.adjust(measure(network, seed=1)))
    assert said in report
    free = network.copy()
    for f in free.photos.values():
        free.photos[f.name] = replace(f, fixed=(False,) * 6)
    with pytest.raises(fga.AdjustmentError, match="photo 'T0'"):
        fga.adjust(measure(free, seed=1), start=None)


def test_photo_without_an_approximate_pose_is_refused() -> None:
    network = microscope()
    with pytest.raises(fga.InputError, match="no rays, by which a resection"):
        network.add_photo("T9", "SEM", position=(0.0, 0.0, 0.0))


def test_line_in_a_parallel_projection_is_refused() -> None:
    network = measure(microscope(), seed=1)
    network.add_frame("edge", free=("rx",), origin=(0.0, 0.0, 0.0))
    network.add(ImageLine("T0", "edge", 5.0, 3.0, sigma=0.3))
    with pytest.raises(fga.InputError, match="'parallel' has no projection centre"):
        fga.adjust(network)


@pytest.mark.parametrize("unit", [1.0, MICROMETRE])
def test_points_without_coordinates_are_found_in_metres_and_in_micrometres(unit: float) -> None:
    measured = measure(microscope(unit), seed=2)
    expected = fga.adjust(measured)
    size = MICROMETRE / unit
    rough = disturb(measured, seed=2, points=size, centres=size, attitudes=0.01)
    for p in list(rough.points.values()):
        if not any(p.fixed):
            rough.points[p.name] = replace(p, coordinates=(np.nan,) * 3)
    found = fga.adjust(rough)
    for name in rough.points:
        np.testing.assert_allclose(found.point(name), expected.point(name), atol=1e-6 * size)


def test_blunder_in_an_image_is_found() -> None:
    network = measure(microscope(), seed=4)
    network.images.xy[0][7] += (0.0, 9.0)
    photo, point, *_ = network.images.columns()
    where = f"T{photo[7]}/P{point[7]}"
    found = fga.snoop(network)
    assert [r.id for r in found.rejected] == [where]


def test_estimates_scatter_as_their_covariance_says() -> None:
    found = few("image, parallel projection")
    assert_estimates_scatter_as_their_covariance_says(found)
    assert_the_variance_of_unit_weight_follows_its_distribution(found)


def test_project_comes_back(tmp_path) -> None:
    network = measure(microscope(MICROMETRE), seed=5)
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path / "project.toml")
    assert again.cameras == network.cameras
    assert [f.fixed for f in again.photos.values()] == [f.fixed for f in network.photos.values()]
    np.testing.assert_allclose(fga.adjust(again).vtpv, fga.adjust(network).vtpv, rtol=1e-6)


def test_arrivals_in_any_order_end_at_the_adjustment_of_all() -> None:
    assert_any_order_ends_at_the_batch(measure(microscope(MICROMETRE), seed=6))
