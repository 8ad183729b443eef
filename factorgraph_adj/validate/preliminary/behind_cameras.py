"""Image points whose object points lie behind the camera, by given coordinates and poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...approximate.image_axes import known_points
from ...errors import known
from ...graph.equations import Equations
from ...models.image import in_front
from .finding import Finding
from .given_rows import given_rows


def behind_cameras(equations: Equations) -> Iterator[Finding]:
    """Find points behind cameras among others that lie in front.

    Where most rays of known points, or of the others, have their points behind the cameras, poses
    and points are those of a reconstruction in axes of its own, which the adjustment moves.
    """
    state = equations.unknowns.start()
    known_ = known_points(equations.network)
    for block, rows in given_rows(equations, "image"):
        assert block.lens is not None
        photo, point = block.variables[0][1][rows], block.variables[2][1][rows]
        depth = in_front(state["pose"][photo], state["point"][point], block.lens)
        for own in (known_[point], ~known_[point]):
            behind = np.flatnonzero(own & (depth < 0))
            if not 0 < len(behind) <= own.sum() / 2:
                continue
            names = [f"{block.labels(int(rows[i]))} ({-depth[i]:.3g} m)" for i in behind]
            yield Finding(
                f"the points of {len(behind)} image points lie behind the camera, by the given "
                f"coordinates and orientation: {known(names)}",
                "correct them, or leave approximate ones out",
            )
