"""Photos with given orientation: image axes and rotations that fit better otherwise.

The rays of a photo are compared with the directions to its points, as they are and as they would
be with other axes, with a principal point on the other side, or with a transposed rotation. The
principal point counts: coordinates in pixels begin at a corner, so that a wrong direction of y
looks different according to the sign with which y0 was given.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ...approximate.image_axes import ray_misfits
from ...errors import known
from ...graph.equations import Equations
from ...models.image_axes import ALONG_X, ALONG_Y, EXCHANGED, OTHER
from ...types import Array
from .finding import Finding
from .given_rows import BETTER, LEAST, given_rows, median

TRANSPOSED = "transposed"
OTHER_SIDE = "the other side"
TOLD: Mapping[str, tuple[str, str]] = {
    ALONG_Y: (
        "with the image y axis the other way",
        "state y_axis, and y0 in the direction of y; of some photos alone, change the sign of y",
    ),
    ALONG_X: ("with the image x axis the other way", "change the sign of x, or its origin"),
    EXCHANGED: ("with x and y of the image exchanged", "exchange the columns x and y"),
    TRANSPOSED: ("with transposed rotation matrices", "turn the matrices"),
    OTHER_SIDE: (
        "with the other sign of y0",
        "give y0 in the direction of y, as y_axis says: y0 as given lies outside the image",
    ),
}
"""What may be wrong with photos, and what to do."""


def photo_axes(equations: Equations) -> Iterator[Finding]:
    """Iterate over photos whose rotations, or image axes, fit the given orientation otherwise."""
    for block, rows in given_rows(equations, "image"):
        assert block.lens is not None
        poses = equations.unknowns["pose"].values
        (_, photo), (_, camera), (_, point) = ((k, i[rows]) for k, i in block.variables)
        calibration = equations.unknowns["calibration"].values[camera][:, : len(block.lens.names)]
        away = equations.unknowns["point"].values[point] - poses[photo, 9:]
        rotation = poses[photo, :9].reshape(-1, 3, 3)
        xy, at = block.observed[rows], calibration[:, 1:3]

        now = ray_misfits(block.lens, calibration, xy, rotation, away)
        otherwise: list[tuple[str, Array]] = []
        for cause, axes in OTHER:
            other = axes(xy, at)
            otherwise.append((cause, ray_misfits(block.lens, calibration, other, rotation, away)))
        turned = np.swapaxes(rotation, 1, 2)
        otherwise.append((TRANSPOSED, ray_misfits(block.lens, calibration, xy, turned, away)))
        moved = calibration * np.where(np.arange(calibration.shape[1]) == 2, -1.0, 1.0)
        across = ray_misfits(block.lens, moved, xy, rotation, away)

        better: dict[str, list[tuple[int, float]]] = {}
        order = np.argsort(photo, kind="stable")
        numbers, first = np.unique(photo[order], return_index=True)
        for number, own in zip(numbers.tolist(), np.split(order, first[1:]), strict=True):
            if len(own) < LEAST:
                continue
            left = [(median(found[own]), how) for how, found in otherwise]
            if _outside(xy[own, 1], at[own, 1]):
                left.append((median(across[own]), OTHER_SIDE))
            best, how = min(left)
            if best * BETTER < median(now[own]):
                better.setdefault(how, []).append((number, median(now[own]) / max(best, 1e-12)))
        names = equations.unknowns["pose"].names
        for how, found in better.items():
            what, remedy = TOLD[how]
            every = "s" if len(found) > 1 else ""
            times = float(np.median([t for _, t in found]))
            yield Finding(
                f"the rays of {len(found)} photo{every} with given orientation fit "
                f"{times:.0f} times better {what}: {known([names[i] for i, _ in found])}",
                remedy,
            )


def _outside(y: Array, y0: Array) -> bool:
    """Return whether a principal point lies outside the image, and would not with another sign."""
    low, high = float(y.min()), float(y.max())
    middle = float(np.median(y0))
    return not low <= middle <= high and low <= -middle <= high
