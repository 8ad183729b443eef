"""The order of the elimination: what most observations touch comes last, and fills nothing."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import PhotoRange, RelativePosition, RelativeRotation
from factorgraph_adj.solve.nested_dissection import MAX_LEAF_NODES

POSES = 60
BEACONS = {"near": (10.0, 40.0, 0.0), "far": (50.0, -45.0, 0.0)}
MOST_IN_A_FRONT = MAX_LEAF_NODES + 4
"""Poses of a leaf, one of each neighbour, and two points; with poses last all were one front."""


def drive() -> Network:
    """Return a drive in plan with odometry, and ranges to two beacons from every pose."""
    network = Network("drive")
    network.add_camera("K", NoDistortion(), {"c": 1.0})
    for name, at in BEACONS.items():
        network.add_point(name, at, fixed="z")
    for k in range(POSES):
        at = np.array([float(k), 0.0, 0.0])
        network.add_photo(f"x{k}", "K", position=tuple(at), rotation=np.eye(3), fixed=k == 0)
        if k:
            pair = f"x{k - 1}", f"x{k}"
            network.add(
                RelativeRotation(*pair, (0.0, 0.0, 0.0), sigma=(1e-3,) * 3),
                RelativePosition(*pair, (1.0, 0.0, 0.0), sigma=(1e-2,) * 3),
            )
        for name, there in BEACONS.items():
            far = float(np.linalg.norm(np.array(there) - at))
            network.add(PhotoRange(name, f"x{k}", far, sigma=0.1))
    return network


def test_points_that_many_poses_observe_do_not_join_them_all() -> None:
    fronts = fga.adjust(drive()).factor.fronts.fronts
    assert len(fronts) > 2
    assert max(f.size for f in fronts) <= MOST_IN_A_FRONT
