"""Figures of image residuals of one photo, of several, or mean ones of a camera; sensor coverage.

The sensor is drawn with its format and with the part of it that image points cover.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from ...entities import Camera
from ...errors import InputError, known
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...types import Array
from ..rejected_observations import RejectedObservations
from .image_residuals import (
    cells_along_longer_side,
    draw_arrows,
    draw_vector_key,
    draw_vectors,
    figure_size,
    image_rows,
    image_tests,
    mean_photo,
    residual_summary,
    set_image_limits,
    vector_factor,
    widen_limits,
    worst_photos,
)
from .observation_lines import (
    REJECTED_LOOK,
    RejectedImagePoints,
    draw_rejected_image_points,
    rejected_image_points,
)
from .style import (
    BLACK,
    BLUE,
    GREY,
    PALE,
    VERMILLION,
    checked_positive,
    empty_figure,
    in_package_style,
    new_figure,
    readable_number,
    shortened,
    write_headline,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_FORMAT_LABEL = "frame: area of the image points, since the camera states no format"
MIN_SHARE_OF_POINTS_IN_CELL = 0.1
"""Smallest number of points in a cell with a vector, as a fraction of the average."""
MAX_CELLS_NUMBERED = 400
"""Largest number of cells in a mean photo that shows the number of points of each cell."""
SIGN_OF_RESIDUALS = "v = computed − observed"
NO_REJECTED_IMAGE_POINTS = RejectedImagePoints((), np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class Coverage:
    """Part of a sensor that image points cover."""

    share: float
    """Area of the convex hull of the points on the sensor, divided by the area of the sensor."""
    outside: int
    """Number of points outside the sensor: its format, origin or y axis is wrong, or they are."""
    hull: Array
    """Corners of the hull, (m, 2) image units; empty for points on one line."""

    def __str__(self) -> str:
        """Describe the coverage."""
        text = f"hull {100 * self.share:.0f} % of the format"
        return f"{text}, {self.outside} points OUTSIDE it" if self.outside else text


def sensor_coverage(xy: Array, corners: tuple[Array, Array]) -> Coverage:
    """Return the part of a sensor that is covered by points (n, 2), both in image units."""
    from scipy.spatial import ConvexHull, QhullError  # it takes long to import

    low, high = corners
    inside = np.all((xy >= low) & (xy <= high), axis=1)
    outside = int(np.sum(~inside))
    if inside.sum() < 3:
        return Coverage(0.0, outside, np.zeros((0, 2)))
    try:
        found = ConvexHull(xy[inside])
    except QhullError:  # all points lie on one line
        return Coverage(0.0, outside, np.zeros((0, 2)))
    # In two dimensions the volume of a hull is its area.
    share = float(found.volume / np.prod(high - low))
    return Coverage(share, outside, xy[inside][found.vertices])


def draw_sensor(axes: Axes, camera: Camera, xy: Array, *, fine: bool = False) -> Coverage | None:
    """Draw the edge of the sensor and the hull of image points; None without a format."""
    from matplotlib.patches import Polygon, Rectangle

    corners = camera.corners()
    if corners is None:
        return None
    low, high = corners
    width = 0.8 if fine else 1.2
    edge: dict[str, Any] = {
        "fill": False,
        "edgecolor": BLACK,
        "lw": width,
        "zorder": 1,
        "gid": "format",
    }
    axes.add_patch(Rectangle((float(low[0]), float(low[1])), *(high - low).tolist(), **edge))
    found = sensor_coverage(xy, corners)
    if len(found.hull):
        look: dict[str, Any] = {
            "facecolor": PALE,
            "alpha": 0.35,
            "lw": 0,
            "zorder": 0.2,
            "gid": "hull",
        }
        axes.add_patch(Polygon(found.hull, **look))
    for spine in axes.spines.values():
        spine.set_color(PALE)
    return found


def photo_legend(
    figure: Figure, vectors: str, marked: str, *, aside: int | None, format: bool
) -> None:
    """Draw the legend of photos below a figure.

    Args:
        figure: the figure.
        vectors: meaning of blue vectors.
        marked: meaning of red vectors.
        aside: number of image points rejected in these photos; None: not asked for.
        format: whether the format of the sensor is drawn.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def dash(colour: str, label: str) -> Line2D:
        return Line2D([], [], color=colour, lw=1.5, label=label)

    handles = [dash(BLUE, vectors), dash(VERMILLION, marked)]
    handles.append(Line2D([], [], ls="", marker="+", ms=8.0, color=BLACK, label="principal point"))
    if aside:
        label = f"rejected, as predicted ({aside})"
        handles.append(Line2D([], [], **REJECTED_LOOK | {"ls": ":"}, ms=6.0, label=label))
    if format:
        handles.append(Line2D([], [], color=BLACK, lw=1.0, label="format of the sensor"))
        patch = Patch(facecolor=PALE, alpha=0.5, label="convex hull of the image points")
        every = [*handles, patch]
    else:
        every = [*handles, Line2D([], [], color=GREY, lw=1.0, label=NO_FORMAT_LABEL)]
    columns = 1 if figure.get_figwidth() < 6 else 2 if figure.get_figwidth() < 9 else 3
    figure.legend(handles=every, loc="outside lower left", ncols=columns)


@in_package_style
def plot_photo_residuals(
    solution: Solution,
    photo: str,
    *,
    reliability: Reliability | None = None,
    aside: RejectedObservations | None = None,
    factor: float | None = None,
    names: int = 10,
) -> Figure:
    """Draw the residuals v = computed − observed of a photo at its image points.

    If the camera states its format, the edge of the sensor is drawn, and the title states the
    part of it that the convex hull of the image points covers.

    Args:
        solution: the result of `adjust`.
        photo: name of the photo.
        reliability: reliability of the same solution; points with |w| above its critical value
            are marked. Without a reliability, points with |v/σ| > 3.29 are marked.
        aside: observations that were rejected, see `set_aside`; crosses mark them.
        factor: exaggeration of the vectors; by default neighbouring vectors do not overlap.
        names: number of marked points that are named, worst first.

    Returns:
        A figure, axes in image units, x right, y up, with y numbered as in the files of the
        camera; if the photo has no image coordinates, it shows a message.

    Raises:
        InputError: the photo is unknown, the reliability is of another solution, the factor is
            not positive, or matplotlib is not installed.
    """
    from matplotlib.patheffects import withStroke

    own = image_rows(solution).of_photo(photo)
    title = f"{solution.network.name or 'network'}, {_photo(photo)}"
    tests = image_tests(solution, reliability)
    if not len(own.row):
        return empty_figure(title, f"Photo {photo} has no image coordinates.")
    camera = solution.network.photos[photo].camera
    corners = image_rows(solution).areas[camera]
    crossed = rejected_image_points(aside).get(photo, NO_REJECTED_IMAGE_POINTS)
    used = vector_factor([own], corners) if factor is None else checked_positive(factor, "factor")
    figure = new_figure(*figure_size(corners))
    axes = figure.add_subplot()
    unit = set_image_limits(axes, own, corners, photo)
    covered = draw_sensor(axes, solution.network.cameras[camera], own.xy)
    bad = draw_vectors(axes, own, used, tests)
    draw_rejected_image_points(axes, crossed, used, fine=False)
    worst = np.flatnonzero(bad)[np.argsort(-tests.largest(own)[bad], kind="stable")][:names]
    outline = [withStroke(linewidth=2.0, foreground="white")]
    point_names = solution.equations.unknowns["point"].names
    marked = [(point_names[own.point[i]], own.xy[i], "suspect") for i in worst.tolist()]
    marked += [
        (name, at, "point rejected")
        for name, at in zip(crossed.points[:names], crossed.xy, strict=False)
    ]
    for name, at, what in marked:
        axes.annotate(
            shortened(name, 20), at, (4.0, 4.0), textcoords="offset points", fontsize=7.5,
            gid=f"name of a {what}", path_effects=outline, in_layout=False,
        )  # fmt: skip
    draw_vector_key(axes, own, corners, used, above=True)
    below = residual_summary(own, bad, tests, len(crossed.points))
    write_headline(
        axes,
        title,
        below if covered is None else f"{below}\n{covered}",
        width=figure_size(corners)[0] - 2.4,
    )
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    aside_here = len(crossed.points)
    photo_legend(
        figure, SIGN_OF_RESIDUALS, tests.what, aside=aside_here, format=covered is not None
    )
    return figure


@in_package_style
def plot_photos(
    solution: Solution,
    photos: Sequence[str] | None = None,
    *,
    reliability: Reliability | None = None,
    aside: RejectedObservations | None = None,
    most: int = 12,
) -> Figure:
    """Draw the residuals of several photos on one sheet.

    The exaggeration is the same for all photos of a camera.

    Args:
        solution: the result of `adjust`.
        photos: names of photos; by default the ``most`` photos with the largest RMS of w, or all
            photos if they are not more. The title states the choice.
        reliability: reliability of the same solution; without it, v/σ replaces w.
        aside: observations that were rejected, see `set_aside`; crosses mark them.
        most: largest number of photos if no names are given.

    Returns:
        A figure; without image coordinates, it shows a message.

    Raises:
        InputError: a photo is unknown, the reliability is of another solution, or matplotlib is
            not installed.
    """
    rows = image_rows(solution)
    title = solution.network.name or "network"
    tests = image_tests(solution, reliability)
    every = list(solution.network.photos)
    missing = [name for name in photos or () if name not in solution.network.photos]
    if missing:
        raise InputError(f"unknown photo {missing[0]!r}; known: {known(every)}")
    chosen = list(photos) if photos is not None else worst_photos(rows, tests, most)
    if not len(rows.row) or not chosen:
        return empty_figure(title, "No image coordinates take part in the adjustment.")
    if photos is not None:
        below = f"{len(chosen)} of {len(every)} photos"
    elif len(chosen) == len(every):
        below = f"all {len(every)} photos"
    else:
        below = f"the {len(chosen)} of {len(every)} photos with the largest RMS {tests.name}"
    columns = min(4, ceil(np.sqrt(len(chosen))))
    lines = ceil(len(chosen) / columns)
    # The ratio width / height follows the image formats; its limits leave room for text.
    formats = np.array([high - low for low, high in rows.areas.values()])
    ratio = float(np.clip(np.median(formats[:, 0] / np.maximum(formats[:, 1], 1e-12)), 0.5, 2.0))
    width, height = (3.1, 3.1 / ratio) if ratio > 1 else (max(3.1 * ratio, 2.7), 3.1)
    figure = new_figure(0.3 + width * columns, 1.1 + (height + 0.95) * lines)
    cameras = {name: solution.network.photos[name].camera for name in chosen}
    parts = {name: rows.of_photo(name) for name in chosen}
    crosses = rejected_image_points(aside)
    framed = False
    for i, name in enumerate(chosen):
        axes = figure.add_subplot(lines, columns, i + 1)
        own, camera = parts[name], cameras[name]
        if not len(own.row):
            axes.set_axis_off()
            write_headline(axes, _photo(name), "no image coordinates")
            continue
        corners = rows.areas[camera]
        together = [p for n, p in parts.items() if cameras[n] == camera and len(p.row)]
        factor = vector_factor(together, corners)
        set_image_limits(axes, own, corners, name)
        axes.set_xticks([])
        axes.set_yticks([])
        covered = draw_sensor(axes, solution.network.cameras[camera], own.xy, fine=True)
        framed = framed or covered is not None
        crossed = crosses.get(name, NO_REJECTED_IMAGE_POINTS)
        bad = draw_vectors(axes, own, factor, tests, fine=True)
        draw_rejected_image_points(axes, crossed, factor, fine=True)
        draw_vector_key(axes, own, corners, factor, above=False)
        about = residual_summary(own, bad, tests, len(crossed.points))
        about = about if covered is None else f"{about}\n{covered}"
        axes.set_title(f"{_photo(name)}\n{about}", fontsize=8.0)
    figure.suptitle(
        f"{shortened(title)}: image residuals of {below}", x=0.01, ha="left", fontsize=10.0
    )
    aside_here = sum(len(crosses[name].points) for name in chosen if name in crosses)
    photo_legend(figure, SIGN_OF_RESIDUALS, tests.what, aside=aside_here, format=framed)
    return figure


def _photo(name: str) -> str:
    """Return the title of a photo."""
    return shortened(name if name.lower().startswith("photo") else f"photo {name}", 36)


@in_package_style
def plot_mean_photo(
    solution: Solution,
    camera: str,
    *,
    reliability: Reliability | None = None,
    cells: int | None = None,
    factor: float | None = None,
) -> Figure:
    """Draw the mean residuals of all photos of a camera in the cells of an image grid.

    A pattern of vectors is a systematic error that the calibration does not describe. Red
    vectors differ significantly from zero: n Σ (v̄/σ)² of the two components exceeds
    χ²(99.9 %; 2). The test is conservative, as residuals scatter less than observations. Cells
    with less than a tenth of the average number of points have no vector.

    Args:
        solution: the result of `adjust`.
        camera: name of the camera.
        reliability: reliability of the same solution, for the doubts in the title.
        cells: number of cells along the longer side; by default 3 to 12, for an average of about
            10 points in each cell.
        factor: exaggeration of the vectors; by default the vectors fill their cells.

    Returns:
        A figure, axes in image units; if the camera has no image points, it shows a message.

    Raises:
        InputError: the camera is unknown, ``cells`` < 1, the factor is ≤ 0, or matplotlib is not
            installed.
    """
    cameras = solution.network.cameras
    if camera not in cameras:
        raise InputError(f"unknown camera {camera!r}; known: {known(cameras)}")
    if cells is not None and cells < 1:
        raise InputError(f"cells must be at least 1, not {cells}")
    rows = image_rows(solution)
    title = f"{solution.network.name or 'network'}, mean photo of {camera}"
    if camera not in rows.areas:
        return empty_figure(title, f"Camera {camera} has no image coordinates.")
    own, corners = rows.of_camera(camera), rows.areas[camera]
    mean = mean_photo(own, corners, cells or cells_along_longer_side(own, corners))
    enough = mean.count >= MIN_SHARE_OF_POINTS_IN_CELL * mean.count.mean()
    figure = new_figure(*figure_size(corners))
    axes = figure.add_subplot()
    photo = next(f.name for f in solution.network.photos.values() if f.camera == camera)
    unit = set_image_limits(axes, own, corners, photo)
    covered = draw_sensor(axes, cameras[camera], own.xy)
    axes.set_axisbelow(True)
    x, y = mean.x_edges, mean.y_edges
    widen_limits(axes, np.array([(x[0], y[0]), (x[-1], y[-1])]))
    axes.vlines(x, y[0], y[-1], color=PALE, lw=0.6, zorder=0)
    axes.hlines(y, x[0], x[-1], color=PALE, lw=0.6, zorder=0)
    size = np.hypot(*mean.residual[enough].T)
    side = float(mean.x_edges[1] - mean.x_edges[0])
    if factor is None:
        typical = float(np.quantile(size, 0.9))
        used = readable_number(0.8 * side / typical) if typical > 0 else 1.0
    else:
        used = checked_positive(factor, "factor")
    for mask, colour, label in (
        (enough & ~mean.significant, BLUE, "mean vectors"),
        (enough & mean.significant, VERMILLION, "mean vectors that differ from zero"),
    ):
        draw_arrows(axes, mean.centre[mask], mean.residual[mask], used, colour, label)
    if len(mean.count) <= MAX_CELLS_NUMBERED:
        corner = mean.centre - 0.46 * side
        for at, n in zip(corner.tolist(), mean.count.tolist(), strict=True):
            axes.text(
                at[0], at[1], str(n), fontsize=6.0, color=GREY, zorder=1, gid="number of points"
            )
    draw_vector_key(axes, own, corners, used, above=True)
    photos = len(np.unique(own.photo))
    red = int(np.sum(mean.significant & enough))
    below = (
        f"{photos} photo{'s' * (photos != 1)}, {len(own.row)} points; "
        f"{red} of {int(enough.sum())} cells differ from zero (red)"
    )
    write_headline(
        axes,
        title,
        below if covered is None else f"{below}\n{covered}",
        width=figure_size(corners)[0] - 2.4,
    )
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    photo_legend(
        figure,
        f"mean of {SIGN_OF_RESIDUALS}; small numbers: points in the cell",
        f"mean that differs from zero ({red})",
        aside=None,
        format=covered is not None,
    )
    return figure
