"""Residual vectors in an image: their test, exaggeration and drawing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...quality.distributions import normal_quantile
from ...quality.reliability import Reliability
from ...solve.solution import Solution
from ...types import Array, Mask
from ..rows import image_scale
from .image_rows import ALPHA, ImageRows
from .style import BLACK, BLUE, VERMILLION, multiple, readable, scale_key

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROOM = 0.25
"""Largest part of a picture's size that it grows by on a side at a time, so that a gross error does
not make all else small."""
PAD = 0.01
"""Blank beyond the tip of an arrow, in the larger side of the picture."""


@dataclass(frozen=True, eq=False)
class Tests:
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


def tests_of(solution: Solution, reliability: Reliability | None) -> Tests:
    """Return w with a reliability, else v/σ; InputError for a reliability of another solution."""
    if reliability is None:
        limit = normal_quantile(1 - ALPHA / 2)
        return Tests(solution.observations.normalised, limit, "v/σ")
    if reliability.solution is not solution:
        raise InputError("the reliability belongs to another solution than the one to be drawn")
    return Tests(np.nan_to_num(reliability.w), reliability.critical_w, "w")


def worst_photos(rows: ImageRows, tests: Tests, most: int) -> list[str]:
    """Return the ``most`` photos with the largest RMS of tests; up to ``most``, all in order."""
    names = list(rows.solution.network.photos)
    if len(names) <= most:
        return names
    square = np.sum(tests.values[rows.row[:, None] + [0, 1]] ** 2, axis=1)
    n = np.bincount(rows.photo, minlength=len(names))
    rms = np.bincount(rows.photo, square, minlength=len(names)) / np.maximum(n, 1)
    return [names[i] for i in np.argsort(-rms, kind="stable")[:most].tolist()]


def size_of(corners: tuple[Array, Array]) -> tuple[float, float]:
    """Return width and height of a figure for an image format, inches."""
    width, height = np.maximum(corners[1] - corners[0], 1e-12).tolist()
    across = float(np.clip(7.0 * width / height, 4.5, 8.5))
    return across + 0.7, float(np.clip(across * height / width, 3.0, 8.0)) + 1.2


def set_format(axes: Axes, own: ImageRows, corners: tuple[Array, Array], photo: str) -> str:
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


def factor_for(parts: list[ImageRows], corners: tuple[Array, Array]) -> float:
    """Return an exaggeration, 1, 2 or 5 times a power of ten, that keeps most vectors apart."""
    size = np.concatenate([np.hypot(*p.residual.T) for p in parts])
    typical = float(np.quantile(size, 0.9))
    if not typical > 0:
        return 1.0
    extent = np.maximum(corners[1] - corners[0], 1e-12)
    between = np.sqrt(float(np.prod(extent)) / max(len(p.row) for p in parts))
    return readable(min(1.5 * float(between), 0.12 * float(extent.max())) / typical)


def draw_vectors(
    axes: Axes, own: ImageRows, factor: float, tests: Tests, *, fine: bool = False
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
        make_room(axes, at + factor * vectors)
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


def make_room(axes: Axes, places: Array) -> None:
    """Widen the limits of a picture for places (n, 2), by at most `ROOM` of its size a time."""
    left, right, bottom, top = (*axes.get_xlim(), *axes.get_ylim())
    low, high = np.array([left, bottom]), np.array([right, top])
    room = ROOM * (high - low)
    pad = PAD * float(np.max(high - low))
    low = np.minimum(low, np.maximum(places.min(axis=0) - pad, low - room))
    high = np.maximum(high, np.minimum(places.max(axis=0) + pad, high + room))
    axes.set_xlim(float(low[0]), float(high[0]))
    axes.set_ylim(float(low[1]), float(high[1]))


def draw_key(
    axes: Axes, own: ImageRows, corners: tuple[Array, Array], factor: float, *, above: bool
) -> None:
    """Draw the scale of the vectors."""
    network = own.solution.network
    camera = network.photos[list(network.photos)[own.photo[0]]].camera
    scale = image_scale(network.cameras[camera])
    size = readable(0.14 * float(np.max(np.maximum(corners[1] - corners[0], 1e-9))) / factor)
    label = f"{size / scale.size:.6g} {scale.small.replace('um', 'µm')} ({multiple(factor)})"
    scale_key(axes, size * factor, label, above=above)


def summary(own: ImageRows, bad: Mask, tests: Tests, aside: int) -> str:
    """Return a line with the numbers of points and suspects, and the size of the test values."""
    n, found = len(own.row), int(bad.sum())
    text = (
        f"{n} point{'s' * (n != 1)}, RMS {tests.name} {tests.rms(own):.2f}, "
        f"{found} suspect{'s' * (found != 1)}"
    )
    return f"{text}, {aside} set aside" if aside else text
