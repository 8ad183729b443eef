"""Relative orientation by PoseLib and by pycolmap, compared on pairs of published blocks.

    python -m tests.benchmarks.five_points

Pairs of photos with 20 common points or more are oriented by either library from the same rays with
the same limit, once as they are and once with a fifth of the points exchanged. The truth is the
adjusted block. A direction of the base within 5° and a rotation within 1° count as right.
"""

from __future__ import annotations

import time

import numpy as np
import pycolmap

import factorgraph_adj as fga
from factorgraph_adj.orientation.block_input import Views
from factorgraph_adj.orientation.robust_poses import relative_pose
from factorgraph_adj.rotation import log_rotation
from factorgraph_adj.types import Array
from tests.networks.aicon import read_aicon
from tests.networks.dbat import read_roma, read_sxb
from tests.support.places import data_dir

FOCAL = 1000.0
MAX_CHOSEN_OF_PAIRS = 150


def by_pycolmap(first: Array, second: Array, limit: float) -> tuple[Array, Array] | None:
    """Return rotation and base of the second photo in the axes of the first."""
    camera = pycolmap.Camera(
        model="SIMPLE_PINHOLE", width=4000, height=4000, params=[FOCAL, 0.0, 0.0]
    )
    options = pycolmap.RANSACOptions()
    options.max_error = FOCAL * limit
    found = pycolmap.estimate_essential_matrix(
        FOCAL * first * [1, -1], FOCAL * second * [1, -1], camera, camera, options
    )
    if found is None:
        return None
    pose = found["cam2_from_cam1"]
    rotation = pose.rotation.matrix().T
    return rotation, -rotation @ pose.translation


def by_poselib(first: Array, second: Array, limit: float) -> tuple[Array, Array] | None:
    """Return the same from the library's own call."""
    found = relative_pose(first, second, wide=limit, least=limit)
    return None if found is None else (found.rotation, found.base)


def compare(name: str, network: fga.Network) -> None:
    """Print shares of right pairs, medians of errors and times."""
    solution = fga.adjust(network)
    views = Views.of(solution.as_network())
    rays = views.rays(views.calibrations())
    pose = solution.state["pose"]
    table = views.table(np.ones(views.n, dtype=bool))
    common = (table @ table.T).tocoo()
    upper = np.flatnonzero((common.row < common.col) & (common.data >= 20))
    rng = np.random.default_rng(1)
    if len(upper) > MAX_CHOSEN_OF_PAIRS:
        upper = rng.choice(upper, MAX_CHOSEN_OF_PAIRS, replace=False)
    for exchanged in (0.0, 0.2):
        for title, orient in (("PoseLib", by_poselib), ("pycolmap", by_pycolmap)):
            rng = np.random.default_rng(2)
            right, turns, bends, seconds = 0, [], [], 0.0
            for a, b in zip(common.row[upper], common.col[upper], strict=True):
                rows = [np.flatnonzero(views.photo == f) for f in (a, b)]
                _, i, j = np.intersect1d(*(views.point[r] for r in rows), return_indices=True)
                first, second = rays.tangent[rows[0][i]], rays.tangent[rows[1][j]].copy()
                bad = rng.random(len(first)) < exchanged
                second[bad] = rng.permutation(second[bad])
                limit = 5.0 * float(np.median(rays.unit))
                began = time.perf_counter()
                found = orient(first, second, limit)
                seconds += time.perf_counter() - began
                if found is None:
                    continue
                ra, rb = (pose[f, :9].reshape(3, 3) for f in (a, b))
                base = ra.T @ (pose[b, 9:] - pose[a, 9:])
                turn = float(np.linalg.norm(log_rotation(((ra.T @ rb).T @ found[0])[None])))
                cosine = base @ found[1] / (np.linalg.norm(base) * np.linalg.norm(found[1]))
                bend = float(np.arccos(np.clip(cosine, -1, 1)))
                turns.append(turn)
                bends.append(bend)
                right += turn < np.radians(1) and bend < np.radians(5)
            print(
                f"{name:8} {exchanged:3.0%} exchanged  {title:8}  right {right} of {len(upper)}, "
                f"median rotation {np.degrees(np.median(turns)):.4f}°, base "
                f"{np.degrees(np.median(bends)):.3f}°, {1000 * seconds / len(upper):.1f} ms a pair",
                flush=True,
            )


if __name__ == "__main__":
    compare("sxb", read_sxb(data_dir("dbat_sxb")))
    compare("aicon", read_aicon(data_dir("aicon_jaicov")))
    compare("roma", read_roma(data_dir("dbat_roma")))
