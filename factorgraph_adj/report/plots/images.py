"""Image residuals as vectors: in one photo, in several, and in the mean photo of a camera."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError, known
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ..set_aside import SetAside
from .aside import ImagesAside, draw_images_aside, images_aside
from .image_rows import cells_for, image_rows, mean_photo
from .sensor import draw_sensor, photo_legend
from .style import (
    BLUE,
    GREY,
    PALE,
    VERMILLION,
    drawn,
    headline,
    new_figure,
    nothing,
    positive,
    readable,
    shortened,
)
from .vectors import (
    draw_arrows,
    draw_key,
    draw_vectors,
    factor_for,
    make_room,
    set_format,
    size_of,
    summary,
    tests_of,
    worst_photos,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST = 0.1
"""Smallest number of points in a cell with a vector, as a fraction of the average."""
MOST_NUMBERS = 400
"""Largest number of cells in a mean photo that shows the number of points of each cell."""
SIGN = "v = computed − observed"
NONE_ASIDE = ImagesAside((), np.zeros((0, 2)), np.zeros((0, 2)))


@drawn
def plot_photo_residuals(
    solution: Solution,
    photo: str,
    *,
    reliability: Reliability | None = None,
    aside: SetAside | None = None,
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
        aside: observations that were set aside, see `set_aside`; crosses mark them.
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
    tests = tests_of(solution, reliability)
    if not len(own.row):
        return nothing(title, f"Photo {photo} has no image coordinates.")
    camera = solution.network.photos[photo].camera
    corners = image_rows(solution).areas[camera]
    crossed = images_aside(aside).get(photo, NONE_ASIDE)
    used = factor_for([own], corners) if factor is None else positive(factor, "factor")
    figure = new_figure(*size_of(corners))
    axes = figure.add_subplot()
    unit = set_format(axes, own, corners, photo)
    covered = draw_sensor(axes, solution.network.cameras[camera], own.xy)
    bad = draw_vectors(axes, own, used, tests)
    draw_images_aside(axes, crossed, used, fine=False)
    worst = np.flatnonzero(bad)[np.argsort(-tests.largest(own)[bad], kind="stable")][:names]
    outline = [withStroke(linewidth=2.0, foreground="white")]
    point_names = solution.equations.unknowns["point"].names
    marked = [(point_names[own.point[i]], own.xy[i], "suspect") for i in worst.tolist()]
    marked += [
        (name, at, "point set aside")
        for name, at in zip(crossed.points[:names], crossed.xy, strict=False)
    ]
    for name, at, what in marked:
        axes.annotate(
            shortened(name, 20), at, (4.0, 4.0), textcoords="offset points", fontsize=7.5,
            gid=f"name of a {what}", path_effects=outline, in_layout=False,
        )  # fmt: skip
    draw_key(axes, own, corners, used, above=True)
    below = summary(own, bad, tests, len(crossed.points))
    headline(
        axes,
        title,
        below if covered is None else f"{below}\n{covered}",
        width=size_of(corners)[0] - 2.4,
    )
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    aside_here = len(crossed.points)
    photo_legend(figure, SIGN, tests.what, aside=aside_here, format=covered is not None)
    return figure


@drawn
def plot_photos(
    solution: Solution,
    photos: Sequence[str] | None = None,
    *,
    reliability: Reliability | None = None,
    aside: SetAside | None = None,
    most: int = 12,
) -> Figure:
    """Draw the residuals of several photos on one sheet.

    The exaggeration is the same for all photos of a camera.

    Args:
        solution: the result of `adjust`.
        photos: names of photos; by default the ``most`` photos with the largest RMS of w, or all
            photos if they are not more. The title states the choice.
        reliability: reliability of the same solution; without it, v/σ replaces w.
        aside: observations that were set aside, see `set_aside`; crosses mark them.
        most: largest number of photos if no names are given.

    Returns:
        A figure; without image coordinates, it shows a message.

    Raises:
        InputError: a photo is unknown, the reliability is of another solution, or matplotlib is
            not installed.
    """
    rows = image_rows(solution)
    title = solution.network.name or "network"
    tests = tests_of(solution, reliability)
    every = list(solution.network.photos)
    missing = [name for name in photos or () if name not in solution.network.photos]
    if missing:
        raise InputError(f"unknown photo {missing[0]!r}; known: {known(every)}")
    chosen = list(photos) if photos is not None else worst_photos(rows, tests, most)
    if not len(rows.row) or not chosen:
        return nothing(title, "No image coordinates take part in the adjustment.")
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
    crosses = images_aside(aside)
    framed = False
    for i, name in enumerate(chosen):
        axes = figure.add_subplot(lines, columns, i + 1)
        own, camera = parts[name], cameras[name]
        if not len(own.row):
            axes.set_axis_off()
            headline(axes, _photo(name), "no image coordinates")
            continue
        corners = rows.areas[camera]
        together = [p for n, p in parts.items() if cameras[n] == camera and len(p.row)]
        factor = factor_for(together, corners)
        set_format(axes, own, corners, name)
        axes.set_xticks([])
        axes.set_yticks([])
        covered = draw_sensor(axes, solution.network.cameras[camera], own.xy, fine=True)
        framed = framed or covered is not None
        crossed = crosses.get(name, NONE_ASIDE)
        bad = draw_vectors(axes, own, factor, tests, fine=True)
        draw_images_aside(axes, crossed, factor, fine=True)
        draw_key(axes, own, corners, factor, above=False)
        about = summary(own, bad, tests, len(crossed.points))
        about = about if covered is None else f"{about}\n{covered}"
        axes.set_title(f"{_photo(name)}\n{about}", fontsize=8.0)
    figure.suptitle(
        f"{shortened(title)}: image residuals of {below}", x=0.01, ha="left", fontsize=10.0
    )
    aside_here = sum(len(crosses[name].points) for name in chosen if name in crosses)
    photo_legend(figure, SIGN, tests.what, aside=aside_here, format=framed)
    return figure


def _photo(name: str) -> str:
    """Return the title of a photo."""
    return shortened(name if name.lower().startswith("photo") else f"photo {name}", 36)


@drawn
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
        return nothing(title, f"Camera {camera} has no image coordinates.")
    own, corners = rows.of_camera(camera), rows.areas[camera]
    mean = mean_photo(own, corners, cells or cells_for(own, corners))
    enough = mean.count >= LEAST * mean.count.mean()
    figure = new_figure(*size_of(corners))
    axes = figure.add_subplot()
    photo = next(f.name for f in solution.network.photos.values() if f.camera == camera)
    unit = set_format(axes, own, corners, photo)
    covered = draw_sensor(axes, cameras[camera], own.xy)
    axes.set_axisbelow(True)
    x, y = mean.x_edges, mean.y_edges
    make_room(axes, np.array([(x[0], y[0]), (x[-1], y[-1])]))
    axes.vlines(x, y[0], y[-1], color=PALE, lw=0.6, zorder=0)
    axes.hlines(y, x[0], x[-1], color=PALE, lw=0.6, zorder=0)
    size = np.hypot(*mean.residual[enough].T)
    side = float(mean.x_edges[1] - mean.x_edges[0])
    if factor is None:
        typical = float(np.quantile(size, 0.9))
        used = readable(0.8 * side / typical) if typical > 0 else 1.0
    else:
        used = positive(factor, "factor")
    for mask, colour, label in (
        (enough & ~mean.significant, BLUE, "mean vectors"),
        (enough & mean.significant, VERMILLION, "mean vectors that differ from zero"),
    ):
        draw_arrows(axes, mean.centre[mask], mean.residual[mask], used, colour, label)
    if len(mean.count) <= MOST_NUMBERS:
        corner = mean.centre - 0.46 * side
        for at, n in zip(corner.tolist(), mean.count.tolist(), strict=True):
            axes.text(
                at[0], at[1], str(n), fontsize=6.0, color=GREY, zorder=1, gid="number of points"
            )
    draw_key(axes, own, corners, used, above=True)
    photos = len(np.unique(own.photo))
    red = int(np.sum(mean.significant & enough))
    below = (
        f"{photos} photo{'s' * (photos != 1)}, {len(own.row)} points; "
        f"{red} of {int(enough.sum())} cells differ from zero (red)"
    )
    headline(
        axes,
        title,
        below if covered is None else f"{below}\n{covered}",
        width=size_of(corners)[0] - 2.4,
    )
    axes.set_xlabel(f"x [{unit}]")
    axes.set_ylabel(f"y [{unit}]")
    photo_legend(
        figure,
        f"mean of {SIGN}; small numbers: points in the cell",
        f"mean that differs from zero ({red})",
        aside=None,
        format=covered is not None,
    )
    return figure
