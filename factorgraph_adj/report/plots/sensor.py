"""The format of a sensor, the part of it that image points cover, and the legend of photos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...network.entities import Camera
from ...types import Array
from .aside import CROSS
from .style import BLACK, BLUE, GREY, PALE, VERMILLION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NO_FORMAT = "frame: area of the image points, since the camera states no format"


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


def coverage(xy: Array, corners: tuple[Array, Array]) -> Coverage:
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
    found = coverage(xy, corners)
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
        aside: number of image points set aside in these photos; None: not asked for.
        format: whether the format of the sensor is drawn.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def dash(colour: str, label: str) -> Line2D:
        return Line2D([], [], color=colour, lw=1.5, label=label)

    handles = [dash(BLUE, vectors), dash(VERMILLION, marked)]
    handles.append(Line2D([], [], ls="", marker="+", ms=8.0, color=BLACK, label="principal point"))
    if aside:
        label = f"set aside, as predicted ({aside})"
        handles.append(Line2D([], [], **CROSS | {"ls": ":"}, ms=6.0, label=label))
    if format:
        handles.append(Line2D([], [], color=BLACK, lw=1.0, label="format of the sensor"))
        patch = Patch(facecolor=PALE, alpha=0.5, label="convex hull of the image points")
        every = [*handles, patch]
    else:
        every = [*handles, Line2D([], [], color=GREY, lw=1.0, label=NO_FORMAT)]
    columns = 1 if figure.get_figwidth() < 6 else 2 if figure.get_figwidth() < 9 else 3
    figure.legend(handles=every, loc="outside lower left", ncols=columns)
