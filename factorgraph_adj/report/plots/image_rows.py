"""Image residuals of a solution as arrays, by photo or as means over the image of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...graph.variables import calibration_name
from ...models.inverse import directions
from ...quality.distributions import chi2_quantile
from ...solve.solution import Solution
from ...types import Array, Index, Mask

ALPHA = 0.001
"""Probability of a false mark, for figures without a reliability that states it."""


@dataclass(frozen=True, eq=False)
class ImageRows:
    """Image points of a solution, n of them."""

    solution: Solution
    """Solution of the image points."""
    photo: Index
    """Number of the photo, (n,)."""
    point: Index
    """Number of the point, (n,)."""
    row: Index
    """Scalar row of x, (n,); the row of y is the next."""
    xy: Array
    """Measured coordinates (n, 2), image units."""
    residual: Array
    """v = computed − observed (n, 2), image units."""
    sigma: Array
    """Standard deviations (n, 2), image units."""

    def select(self, chosen: Mask) -> ImageRows:
        """Return the chosen image points."""
        rows = (self.photo, self.point, self.row, self.xy, self.residual, self.sigma)
        return ImageRows(self.solution, *(each[chosen] for each in rows))  # type: ignore[arg-type]

    @cached_property
    def camera(self) -> Index:
        """Number of the camera, (n,)."""
        network = self.solution.network
        number = {name: i for i, name in enumerate(network.cameras)}
        by_photo = np.array([number[f.camera] for f in network.photos.values()], dtype=np.intp)
        return np.asarray(by_photo[self.photo])

    def of_camera(self, camera: str) -> ImageRows:
        """Return the image points of one camera."""
        return self.select(self.camera == list(self.solution.network.cameras).index(camera))

    def of_photo(self, photo: str) -> ImageRows:
        """Return the image points of one photo."""
        return self.select(self.photo == self.solution.number("pose", photo))

    @cached_property
    def areas(self) -> dict[str, tuple[Array, Array]]:
        """Lower left and upper right corner of sensor and image points, by camera, image units.

        A camera without a stated format has the area of its points, one without points no area.
        """
        out = {}
        for i, (name, camera) in enumerate(self.solution.network.cameras.items()):
            own = self.xy[self.camera == i]
            if len(own):
                every = np.concatenate([own, *(corner[None] for corner in camera.corners() or ())])
                out[name] = every.min(axis=0), every.max(axis=0)
        return out

    def principal_point(self, photo: str) -> Array:
        """Return (c, x0, y0) of a photo, image units."""
        number = self.solution.number("calibration", calibration_name(self.solution.network, photo))
        return np.asarray(self.solution.state["calibration"][number, :3])

    def corner_rays(self, camera: str) -> Array:
        """Return rays to the corners of the sensor in the axes of the camera, (4, 3).

        Without a stated format these are the corners of the measured area; tangents of ± ½ without
        points. Rays of models of tangents have the depth 1 and ignore distortion.
        """
        network = self.solution.network
        name = next((f.name for f in network.photos.values() if f.camera == camera), None)
        corners = network.cameras[camera].corners() or self.areas.get(camera)
        if corners is None or name is None:
            low, high = np.array([-0.5, -0.5]), np.array([0.5, 0.5])
        else:
            lens = network.cameras[camera].lens
            if lens.takes == "rays":
                number = self.solution.number("calibration", calibration_name(network, name))
                k = self.solution.state["calibration"][None, number, : len(lens.names)]
                return directions(lens, _around(*corners), k)
            c, *middle = self.principal_point(name).tolist()
            low, high = ((corner - middle) / c for corner in corners)
        t = _around(low, high)
        # y of image coordinates points up, y of the camera's axes points down.
        return np.column_stack([t[:, 0], -t[:, 1], np.ones(4)])


def _around(low: Array, high: Array) -> Array:
    """Return the corners of a rectangle, counter-clockwise from the lower left one, (4, 2)."""
    return np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])


def image_rows(solution: Solution) -> ImageRows:
    """Return the image points of a solution."""
    blocks = [b for b in solution.equations.blocks if b.kind == "image"]
    none = np.zeros(0, dtype=np.intp)
    empty = np.zeros((0, 2))
    v = solution.observations.residuals
    return ImageRows(
        solution,
        np.concatenate([none, *(b.variables[0][1] for b in blocks)]),
        np.concatenate([none, *(b.variables[2][1] for b in blocks)]),
        np.concatenate([none, *(b.first_row + 2 * np.arange(b.n) for b in blocks)]),
        np.concatenate([empty, *(b.observed for b in blocks)]),
        np.concatenate([empty, *(v[b.rows].reshape(-1, 2) for b in blocks)]),
        np.concatenate([empty, *(b.sigma for b in blocks)]),
    )


@dataclass(frozen=True, eq=False)
class MeanPhoto:
    """Mean residuals of the m cells that contain points."""

    x_edges: Array
    """Edges of the columns, image units."""
    y_edges: Array
    """Edges of the rows, image units."""
    centre: Array
    """Centres of the cells, (m, 2)."""
    residual: Array
    """Mean v, (m, 2) image units."""
    count: Array
    """Number of points in each cell, (m,)."""
    significant: Mask
    """Whether the mean differs from zero, (m,)."""


def mean_photo(own: ImageRows, corners: tuple[Array, Array], cells: int) -> MeanPhoto:
    """Return mean residuals over a grid of square cells, ``cells`` along the longer side."""
    low, high = corners
    extent = np.maximum(high - low, 1e-12)
    side = float(extent.max()) / cells
    n = np.maximum(np.ceil(extent / side - 1e-9).astype(np.intp), 1)
    start = (low + high) / 2 - n * side / 2
    place = np.clip(((own.xy - start) / side).astype(np.intp), 0, n - 1)
    code, index = np.unique(place[:, 0] * n[1] + place[:, 1], return_inverse=True)
    count = np.bincount(index).astype(float)

    def mean(values: Array) -> Array:
        sums = [np.bincount(index, values[:, k]) for k in (0, 1)]
        return np.asarray(np.stack(sums, 1) / count[:, None])

    residual = mean(own.residual)
    test = count * np.sum(residual**2 / mean(own.sigma**2), axis=1)
    return MeanPhoto(
        start[0] + side * np.arange(n[0] + 1),
        start[1] + side * np.arange(n[1] + 1),
        start + side * (np.stack([code // n[1], code % n[1]], 1) + 0.5),
        residual,
        count.astype(np.intp),
        test > chi2_quantile(1 - ALPHA, 2),
    )


def cells_for(own: ImageRows, corners: tuple[Array, Array]) -> int:
    """Return the number of cells along the longer side, 3 to 12, for about ten points in each."""
    width, height = np.maximum(corners[1] - corners[0], 1e-12).tolist()
    ratio = max(width, height) / min(width, height)
    return int(np.clip(np.sqrt(len(own.row) / 10 * ratio), 3, 12))
