"""Precision maps against repeated adjustments, and the time that large clouds take.

    python -m tests.benchmarks.precision_maps [REPETITIONS [POINTS]]

An aerial block with control, GNSS positions and a self-calibrating camera is measured anew and
adjusted REPETITIONS times (1 000); in each, the points of a cloud are measured anew in the photos
that see them, and intersected with the poses and the calibration of that adjustment. POINTS
(1 000 000) is the size of the cloud for the times.
"""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.image import image
from factorgraph_adj.quality.visible_rays import Visibility
from factorgraph_adj.simulation.simulated_blocks import (
    AERIAL_CAMERA,
    SIGMA_IMAGE_MM,
    simulate_aerial_block,
)
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array

INTERSECTION_STEPS = 4


class Repeated(NamedTuple):
    """Errors of repeated adjustments."""

    tie: Array
    """Errors of the tie points, (repetitions, points, 3), metres."""
    dense: Array
    """Errors of the points of the cloud, (repetitions, points, 3), metres."""


def simulated_cloud(solution: Solution, n: int, seed: int) -> Array:
    """Return n points on a smooth ground under the middle of a block, (n, 3), metres."""
    rng = np.random.default_rng([seed, n])
    centres = np.array([p.position for p in solution.as_network().photos.values()])
    xy = rng.uniform(centres[:, :2].min(axis=0), centres[:, :2].max(axis=0), (n, 2))
    z = 10.0 * np.sin(xy[:, 0] / 60.0) * np.cos(xy[:, 1] / 45.0)
    return np.column_stack([xy, z])


def repeated(solution: Solution, cloud: Array, repetitions: int, seed: int) -> Repeated:
    """Measure and adjust a block again and again, and intersect the points of a cloud in each.

    The values of the solution are the truth.
    """
    plan = solution.as_network()
    rays = Visibility(solution).rays(cloud)
    frame, lens = plan.frame, plan.cameras[AERIAL_CAMERA].lens
    truth = solution.state["point"]

    def computed(state: dict[str, Array], points: Array, xy: Array) -> tuple[Array, Array]:
        found = image(
            frame,
            state["pose"][rays.photo],
            state["calibration"][rays.calibration],
            points[rays.point],
            observed=xy,
            lens=lens,
        )
        return found.residual, found.jacobians[2]

    n = len(rays.point)
    true_xy, _ = computed(dict(solution.state), cloud, np.zeros((n, 2)))
    tie = np.empty((repetitions, len(truth), 3))
    dense = np.empty((repetitions, len(cloud), 3))
    for i in range(repetitions):
        adjusted = fga.adjust(fga.measure(plan, seed=seed + i))
        tie[i] = adjusted.state["point"] - truth
        rng = np.random.default_rng([seed, i])
        xy = true_xy + SIGMA_IMAGE_MM * rng.standard_normal((n, 2))
        x = cloud.copy()
        for _ in range(INTERSECTION_STEPS):
            v, b = computed(dict(adjusted.state), x, xy)
            normal, right = np.zeros((len(x), 3, 3)), np.zeros((len(x), 3))
            np.add.at(normal, rays.point, np.einsum("nri,nrj->nij", b, b))
            np.add.at(right, rays.point, np.einsum("nri,nr->ni", b, v))
            x -= np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        dense[i] = x - cloud
    return Repeated(tie, dense)


def ratios(errors: Array, sigmas: Array) -> Array:
    """Return root mean square errors (points, 3) over predicted standard deviations."""
    return np.sqrt(np.mean(errors**2, axis=0)) / sigmas


def main(repetitions: int = 1000, points: int = 1_000_000) -> None:
    """Print both comparisons."""
    solution = fga.adjust(simulate_aerial_block(1, image_points=2000, points_per_photo=100).network)
    cloud = simulated_cloud(solution, 1000, 1)
    cloud = cloud[fga.precision_map(solution, cloud).determined]
    started = time.perf_counter()
    solution = fga.adjust(solution.network)
    found = fga.precision_map(solution, cloud)
    tie = fga.precision_map(solution)
    own = time.perf_counter() - started
    started = time.perf_counter()
    errors = repeated(solution, cloud, repetitions, 1)
    theirs = time.perf_counter() - started
    print(f"{len(solution.network.photos)} photos, {len(tie.points)} tie points, {len(cloud)} more")
    print(f"{repetitions} repetitions {theirs:.1f} s, adjustment and both maps {own:.2f} s")
    for name, e, m in (("tie points", errors.tie, tie), ("further points", errors.dense, found)):
        r = ratios(e, m.sigmas)
        rms = np.sqrt(np.mean(r**2, axis=0))
        print(f"{name}: σ repeated/σ of the map, rms of all points in x, y, z {rms.round(4)}")
    large = simulated_cloud(solution, points, 2)
    for nodes in (None, points // 50):
        started = time.perf_counter()
        mapped = fga.precision_map(solution, large, nodes=nodes)
        print(f"{time.perf_counter() - started:.1f} s: {mapped}")
        if mapped.error is not None:
            print(mapped.error)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
