"""Image residuals as arrays: test values, mean photos, worst photos; drawing of their vectors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...graph.variables import calibration_name
from ...models.inverse_lens import directions
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...statistical_tests import chi2_quantile, normal_quantile
from ...types import Array, Index, Mask
from ..observation_rows import image_scale
from .style import BLACK, BLUE, VERMILLION, draw_scale_key, factor_text, readable_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ALPHA_OF_MARKS = 0.001
"""Probability of a false mark, for figures without a reliability that states it."""
MAX_GROWTH_ON_A_SIDE = 0.25
"""Largest part of a picture's size that it grows by on a side at a time, so that a gross error does
not make all else small."""
MARGIN_BEYOND_ARROW = 0.01
"""Blank beyond the tip of an arrow, in the larger side of the picture."""


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
        points, and for models of places. Rays of models of tangents have the depth 1 and ignore
        distortion.
        """
        network = self.solution.network
        name = next((f.name for f in network.photos.values() if f.camera == camera), None)
        corners = network.cameras[camera].corners() or self.areas.get(camera)
        lens = network.cameras[camera].lens
        if corners is None or name is None or lens.takes == "places":
            low, high = np.array([-0.5, -0.5]), np.array([0.5, 0.5])
        else:
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
    blocks = [b for b in solution.equations.blocks if b.image]
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
        test > chi2_quantile(1 - ALPHA_OF_MARKS, 2),
    )


def cells_along_longer_side(own: ImageRows, corners: tuple[Array, Array]) -> int:
    """Return the number of cells along the longer side, 3 to 12, for about ten points in each."""
    width, height = np.maximum(corners[1] - corners[0], 1e-12).tolist()
    ratio = max(width, height) / min(width, height)
    return int(np.clip(np.sqrt(len(own.row) / 10 * ratio), 3, 12))


@dataclass(frozen=True, eq=False)
class ImageTests:
    """Test values that mark suspects."""

    values: Array
    """Test value of each scalar row."""
    limit: float
    name: str

    @property
    def what(self) -> str:
        """Criterion of the marked points."""
        return f"|{self.name}| > {self.limit:.2f} in x or y"

    def largest(self, own: ImageRows) -> Array:
        """Return the larger test value of the two components, (n,)."""
        both: Array = self.values[own.row[:, None] + [0, 1]]
        return np.asarray(np.max(np.abs(both), axis=1))

    def rms(self, own: ImageRows) -> float:
        """Return the root mean square of the test values of both components."""
        return float(np.sqrt(np.mean(self.values[own.row[:, None] + [0, 1]] ** 2)))


def image_tests(solution: Solution, reliability: Reliability | None) -> ImageTests:
    """Return w with a reliability, else v/σ; InputError for a reliability of another solution."""
    if reliability is None:
        limit = normal_quantile(1 - ALPHA_OF_MARKS / 2)
        return ImageTests(solution.observations.normalised, limit, "v/σ")
    if reliability.solution is not solution:
        raise InputError("the reliability belongs to another solution than the one to be drawn")
    return ImageTests(np.nan_to_num(reliability.w), reliability.critical_w, "w")


def worst_photos(rows: ImageRows, tests: ImageTests, most: int) -> list[str]:
    """Return the ``most`` photos with the largest RMS of tests; up to ``most``, all in order."""
    names = list(rows.solution.network.photos)
    if len(names) <= most:
        return names
    square = np.sum(tests.values[rows.row[:, None] + [0, 1]] ** 2, axis=1)
    n = np.bincount(rows.photo, minlength=len(names))
    rms = np.bincount(rows.photo, square, minlength=len(names)) / np.maximum(n, 1)
    return [names[i] for i in np.argsort(-rms, kind="stable")[:most].tolist()]


def figure_size(corners: tuple[Array, Array]) -> tuple[float, float]:
    """Return width and height of a figure for an image format, inches."""
    width, height = np.maximum(corners[1] - corners[0], 1e-12).tolist()
    across = float(np.clip(7.0 * width / height, 4.5, 8.5))
    return across + 0.7, float(np.clip(across * height / width, 3.0, 8.0)) + 1.2


def set_image_limits(axes: Axes, own: ImageRows, corners: tuple[Array, Array], photo: str) -> str:
    """Set limits to an area, mark the principal point; return the unit."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    low, high = corners
    margin = 0.06 * max(float(np.max(high - low)), 1e-9)
    for spine in axes.spines.values():
        spine.set_visible(True)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(float(low[0]) - margin, float(high[0]) + margin)
    axes.set_ylim(float(low[1]) - margin, float(high[1]) + margin)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6))
    axes.ticklabel_format(useOffset=False, style="plain")
    network = own.solution.network
    camera = network.cameras[network.photos[photo].camera]
    if camera.y_down_in_files:
        # The picture has its top above; the numbers beside it are those of the files.
        axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{0.0 - y:g}"))
    _, x0, y0 = own.principal_point(photo).tolist()
    axes.plot([x0], [y0], "+", color=BLACK, ms=9.0, mew=0.8, zorder=2, gid="principal point")
    return camera.unit


def vector_factor(parts: list[ImageRows], corners: tuple[Array, Array]) -> float:
    """Return an exaggeration, 1, 2 or 5 times a power of ten, that keeps most vectors apart."""
    size = np.concatenate([np.hypot(*p.residual.T) for p in parts])
    typical = float(np.quantile(size, 0.9))
    if not typical > 0:
        return 1.0
    extent = np.maximum(corners[1] - corners[0], 1e-12)
    between = np.sqrt(float(np.prod(extent)) / max(len(p.row) for p in parts))
    return readable_number(min(1.5 * float(between), 0.12 * float(extent.max())) / typical)


def draw_vectors(
    axes: Axes, own: ImageRows, factor: float, tests: ImageTests, *, fine: bool = False
) -> Mask:
    """Draw the residuals of a photo; return the mask of suspects."""
    bad = tests.largest(own) > tests.limit
    fine = fine or len(own.row) > 500
    for mask, colour, label in ((~bad, BLUE, "residuals"), (bad, VERMILLION, "suspects")):
        draw_arrows(axes, own.xy[mask], own.residual[mask], factor, colour, label, fine=fine)
        x, y = own.xy[mask].T
        axes.scatter(x, y, s=1.5 if fine else 5.0, c=colour, lw=0, zorder=3)
    return np.asarray(bad)


def draw_arrows(
    axes: Axes,
    at: Array,
    vectors: Array,
    factor: float,
    colour: str,
    label: str,
    *,
    fine: bool = False,
) -> None:
    """Draw vectors (n, 2) times ``factor`` from positions (n, 2), image units, with their tips."""
    if len(at):
        widen_limits(axes, at + factor * vectors)
        axes.quiver(
            *at.T,
            *(factor * vectors).T,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            units="inches",
            width=0.006 if fine else 0.011,
            minlength=0.0,
            color=colour,
            label=label,
            zorder=3,
        )


def widen_limits(axes: Axes, places: Array) -> None:
    """Widen limits for places (n, 2), by at most `MAX_GROWTH_ON_A_SIDE` of the size a time."""
    left, right, bottom, top = (*axes.get_xlim(), *axes.get_ylim())
    low, high = np.array([left, bottom]), np.array([right, top])
    room = MAX_GROWTH_ON_A_SIDE * (high - low)
    pad = MARGIN_BEYOND_ARROW * float(np.max(high - low))
    low = np.minimum(low, np.maximum(places.min(axis=0) - pad, low - room))
    high = np.maximum(high, np.minimum(places.max(axis=0) + pad, high + room))
    axes.set_xlim(float(low[0]), float(high[0]))
    axes.set_ylim(float(low[1]), float(high[1]))


def draw_vector_key(
    axes: Axes, own: ImageRows, corners: tuple[Array, Array], factor: float, *, above: bool
) -> None:
    """Draw the scale of the vectors."""
    network = own.solution.network
    camera = network.photos[list(network.photos)[own.photo[0]]].camera
    scale = image_scale(network.cameras[camera])
    size = readable_number(0.14 * float(np.max(np.maximum(corners[1] - corners[0], 1e-9))) / factor)
    label = f"{size / scale.size:.6g} {scale.small.replace('um', 'µm')} ({factor_text(factor)})"
    draw_scale_key(axes, size * factor, label, above=above)


def residual_summary(own: ImageRows, bad: Mask, tests: ImageTests, aside: int) -> str:
    """Return a line with the numbers of points and suspects, and the size of the test values."""
    n, found = len(own.row), int(bad.sum())
    text = (
        f"{n} point{'s' * (n != 1)}, RMS {tests.name} {tests.rms(own):.2f}, "
        f"{found} suspect{'s' * (found != 1)}"
    )
    return f"{text}, {aside} rejected" if aside else text
