"""Heights from surfaces that many points share, and azimuths of gyrotheodolites.

The height of a point is that of its surface plus a known number; a surface is known from a point
of known height. Azimuths of a gyrotheodolite are directions whose orientation, the constant of the
instrument, is that of all its stations.
"""

from __future__ import annotations

import numpy as np

from .progress import Progress
from .survey import group_angle, group_median


def above_surfaces(progress: Progress) -> bool:
    """Fill surfaces from points of known height, and heights of points from known surfaces."""
    s, found = progress.survey.above, False
    while True:
        height = progress.plan[s.point, 2]
        known = np.isfinite(height) & np.isnan(progress.surface[s.surface])
        if known.any():
            new = group_median(s.surface[known], (height - s.above)[known], len(progress.surface))
            progress.surface = np.where(np.isnan(progress.surface), new, progress.surface)
        up = progress.surface[s.surface] + s.above
        rows = np.isnan(height) & np.isfinite(up)
        if not rows.any():
            return found
        points = np.unique(s.point[rows])
        place = np.searchsorted(points, s.point[rows])
        found |= progress.set_height(points, group_median(place, up[rows], len(points)))


def start_surface(progress: Progress) -> bool:
    """Set a surface to the height 0 if a free network has no known height."""
    s = progress.survey.above
    if not len(s.surface) or np.isfinite(progress.plan[:, 2]).any():
        return False
    progress.surface[s.surface[0]] = 0.0
    return above_surfaces(progress)


def share_gyros(progress: Progress) -> bool:
    """Give the constants of gyrotheodolites that one station found to all other stations."""
    gyro = progress.survey.gyro
    own = progress.orientation[len(progress.orientation) - len(gyro) :]
    known = np.isfinite(own)
    if known.all() or not known.any():
        return False
    found = group_angle(gyro[known], own[known], int(gyro.max()) + 1)[gyro]
    new = ~known & np.isfinite(found)
    own[new] = found[new]
    return bool(new.any())
