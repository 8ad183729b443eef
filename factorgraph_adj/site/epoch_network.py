"""Network with which an epoch begins: that of the project without readings, at the last places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..graph.observation_selection import without
from ..incremental.adjustment import IncrementalAdjustment
from ..network.network import Network


def network_of_epoch(project: Network, last: IncrementalAdjustment | None) -> Network:
    """Return the network of a new epoch.

    It has the points, cameras, given datum and weighted unknowns of the project, and none of its
    readings. Free points begin where the epoch before had them; points and cameras that arrived
    then stay. Given values of held and weighted coordinates do not change, as they are
    observations.

    Args:
        project: the network of the project.
        last: the epoch before; None: there was none.
    """
    out = without(project, list(project.observations))
    if out.n_image_points:
        out.image_mask(np.zeros(out.n_image_points, dtype=bool))
    if last is None:
        return out
    described = last.entities
    for name, camera in described.cameras.items():
        out.cameras.setdefault(name, camera)
    for name, point in described.points.items():
        mine = out.points.get(name, point)
        place = last.estimate(name) if last.determined(name) else np.array(point.coordinates)
        free = ~np.array(mine.fixed)
        if mine.sigma is not None:
            free &= ~np.isfinite(mine.sigma)
        place = np.where(free, place, mine.coordinates)
        x, y, z = (float(v) for v in place)
        out.points[name] = replace(mine, coordinates=(x, y, z))
    return out
