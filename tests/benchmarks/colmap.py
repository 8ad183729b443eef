"""The same bundle block for pycolmap: its Ceres bundle adjustment as a yardstick.

COLMAP's RADIAL camera has f, cx, cy, k1, k2 from ideal to measured coordinates. A block with
another lens model starts from equivalent values and has as many unknowns; its cost is then not
the same, its work is. Image coordinates are divided by their σ, so that ½ vᵀPv is the cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import numpy as np

from factorgraph_adj.entities import Camera
from factorgraph_adj.models.lens import NormalisedLens
from factorgraph_adj.network.network import Network

FUNCTION_TOLERANCE = 1e-6
"""Ceres' own default; pycolmap's (0) makes it iterate longer."""


@dataclass(frozen=True)
class Solved:
    """What pycolmap did."""

    seconds: float
    cpu: float
    """Seconds of all its threads."""
    iterations: int
    vtpv: float
    start: float
    """vᵀPv at the start."""
    how: str
    """Termination type and linear solver."""
    covariance: float
    """Seconds for the covariances of all points, poses and cameras."""
    covariance_cpu: float
    """The same in seconds of all its threads."""


def solve(network: Network, *, threads: int, principal_point: bool) -> Solved:
    """Adjust the image coordinates of ``network`` with pycolmap; all other observations are left.

    Args:
        network: photos with approximate orientation, points with approximate coordinates.
        threads: number of threads.
        principal_point: whether it is unknown; c, k1, k2 are.
    """
    import pycolmap

    reconstruction, images = _reconstruction(pycolmap, network)
    config = pycolmap.BundleAdjustmentConfig()
    for number in images:
        config.add_image(number)
    for number, photo in zip(images, network.photos.values(), strict=True):
        # Scale stays open: holding two cameras makes Ceres crawl (100 iterations for Roma, not 7).
        if all(photo.fixed):
            config.set_constant_rig_from_world_pose(number)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_principal_point = principal_point
    options.ceres.solver_options.num_threads = threads
    options.ceres.solver_options.function_tolerance = FUNCTION_TOLERANCE
    options.ceres.min_num_residuals_for_cpu_multi_threading = 0
    begin, cpu = perf_counter(), process_time()
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, reconstruction)
    done = adjuster.solve().ceres_summary
    seconds, cpu = perf_counter() - begin, process_time() - cpu
    begin, again = perf_counter(), process_time()
    found = pycolmap.estimate_ba_covariance(
        pycolmap.BACovarianceOptions(), reconstruction, adjuster
    )
    covariance = perf_counter() - begin if found is not None else float("nan")
    return Solved(
        seconds,
        cpu,
        done.num_successful_steps + done.num_unsuccessful_steps - 1,
        2 * done.final_cost,
        2 * done.initial_cost,
        f"{done.termination_type.name}, {done.linear_solver_type_used.name}",
        covariance,
        process_time() - again,
    )


def _reconstruction(pycolmap: Any, network: Network) -> tuple[Any, list[int]]:
    """Return the block as a reconstruction, and the numbers of its images."""
    reconstruction = pycolmap.Reconstruction()
    photo, point, xy, sigma = network.images.columns()
    unit = float(sigma[0, 0])
    number = {name: i for i, name in enumerate(network.cameras, 1)}
    for name, camera in network.cameras.items():
        reconstruction.add_camera_with_trivial_rig(
            pycolmap.Camera(
                model="RADIAL",
                width=1,
                height=1,
                params=_parameters(camera, unit),
                camera_id=number[name],
            )
        )
    order = np.argsort(photo, kind="stable")
    first = np.searchsorted(photo[order], np.arange(len(network.photos) + 1))
    tracks = [pycolmap.Track() for _ in network.points]
    images = []
    for i, (name, taken) in enumerate(network.photos.items()):
        rows = order[first[i] : first[i + 1]]
        measured = xy[rows] / unit * [1.0, -1.0]
        image = pycolmap.Image(
            name=name, keypoints=measured, camera_id=number[taken.camera], image_id=i + 1
        )
        assert taken.rotation is not None
        turn = taken.rotation.T
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), -turn @ np.array(taken.position))
        reconstruction.add_image_with_trivial_frame(image, pose)
        for k, p in enumerate(point[rows].tolist()):
            tracks[p].add_element(i + 1, k)
        images.append(i + 1)
    for track, at in zip(tracks, network.points.values(), strict=True):
        if track.length() >= 2:
            reconstruction.add_point3D(np.array(at.coordinates), track)
    return reconstruction, images


def _parameters(camera: Camera, unit: float) -> list[float]:
    """Return f, cx, cy, k1, k2 in units of σ; y down."""
    value = dict(zip(camera.lens.names, camera.values, strict=True))
    c, k1, k2 = value["c"], value["k1"], value["k2"]
    if not isinstance(camera.lens, NormalisedLens):
        # Measured → ideal or forward in mm: the correction is subtracted, k_i r^2i to first order.
        k1, k2 = -k1 * c**2, -k2 * c**4
    return [c / unit, value["x0"] / unit, -value["y0"] / unit, k1, k2]
