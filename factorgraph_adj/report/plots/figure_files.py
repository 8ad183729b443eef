"""Figure files .png, .svg or .pdf: every figure of an adjustment into a folder, or a single one."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from ...errors import AdjustmentError, InputError
from ...io.file_transaction import write_files
from ...quality.reliability import Reliability
from ...quality.reliability import reliability as compute_reliability
from ...solve.solution import Solution
from ...statistical_tests import CONFIDENCE_OF_REGION
from ..rejected_observations import RejectedObservations
from .image_residuals import image_rows, image_tests
from .network_plan import plot_network
from .photo_figures import plot_mean_photo, plot_photos
from .reliability_figures import plot_qq, plot_redundancy, plot_w
from .style import empty_figure, in_package_style, write_cause

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FigureFormat: TypeAlias = Literal["png", "svg", "pdf"]
FIGURE_FORMATS = ("png", "svg", "pdf")


@in_package_style
def save_plots(
    solution: Solution,
    folder: str | Path,
    *,
    reliability: Reliability | None = None,
    aside: RejectedObservations | None = None,
    format: FigureFormat = "png",
    confidence: float = CONFIDENCE_OF_REGION,
    photos: int = 12,
    cause: str = "",
) -> list[Path]:
    """Write all figures of an adjustment into a folder, or none on an error.

    The figures are ``network`` (plan with error ellipses), ``w`` (histogram), ``qq`` and
    ``redundancy``; with images also ``photos`` (residuals of the photos with the largest RMS of
    w, in small blocks of all photos) and ``mean_photo`` for each camera with two photos or more
    (``mean_photo_NAME`` for several cameras). Other files in the folder stay unchanged.

    Args:
        solution: the result of `adjust`.
        folder: the folder; it is created if missing.
        reliability: reliability of the same solution; by default it is computed.
        aside: observations that were rejected, see `set_aside`.
        format: format of the files.
        confidence: probability of the error ellipses.
        photos: largest number of photos in the figure ``photos``.
        cause: most probable cause of misfits, which is written over figures of a doubtful result.

    Returns:
        The files, in this order.

    Raises:
        InputError: the format is unknown, an option is invalid, the folder cannot be written
            to, or matplotlib is not installed. No file is written then.
    """
    if format not in FIGURE_FORMATS:
        raise InputError(f"unknown format {format!r}; valid: {', '.join(FIGURE_FORMATS)}")
    if photos < 1:
        raise InputError(f"photos must be at least 1, not {photos}")
    image_tests(solution, reliability)  # refuses the reliability of another solution
    rel, why = reliability, ""
    try:
        rel = compute_reliability(solution) if rel is None else rel
    except AdjustmentError as error:  # the iteration stopped early, or the network is too weak
        why = str(error)
    plan = plot_network(solution, confidence=confidence, reliability=rel, aside=aside)
    figures = {"network": plan}
    if rel is None:
        figures |= {key: _instead(solution, why) for key in ("w", "qq", "redundancy")}
    else:
        figures |= {"w": plot_w(rel, aside=aside), "qq": plot_qq(rel, aside=aside)}
        figures["redundancy"] = plot_redundancy(rel)
    rows = image_rows(solution)
    if len(rows.row):
        figures["photos"] = plot_photos(solution, reliability=rel, aside=aside, most=photos)
        cameras = list(solution.network.cameras)
        many = [
            c for i, c in enumerate(cameras) if len(np.unique(rows.photo[rows.camera == i])) > 1
        ]
        for camera, key in zip(many, _names(many), strict=True):
            figures[key] = plot_mean_photo(solution, camera, reliability=rel)
    for figure in figures.values():
        write_cause(figure, cause)
    files = {f"{key}.{format}": _bytes(figure, format) for key, figure in figures.items()}
    write_files(folder, files)
    return [Path(folder) / file for file in files]


@in_package_style
def _instead(solution: Solution, why: str) -> Figure:
    """Return a figure that says why there are no test values."""
    return empty_figure(solution.network.name or "network", why)


def _names(cameras: list[str]) -> list[str]:
    """Return file names of mean photos, valid on every system and all different."""
    if len(cameras) == 1:
        return ["mean_photo"]
    safe = [re.sub(r"[^\w.-]+", "_", c) for c in cameras]
    if len({s.lower() for s in safe}) < len(safe):
        safe = [f"{i}_{s}" for i, s in enumerate(safe, start=1)]
    return [f"mean_photo_{s}" for s in safe]


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as .png, .svg or .pdf; equal figures give equal files.

    Raises:
        InputError: another suffix, or the file cannot be written.
    """
    file = Path(path)
    format = file.suffix.lower().removeprefix(".")
    if format not in FIGURE_FORMATS:
        raise InputError(f"unknown format {format!r}; valid: {', '.join(FIGURE_FORMATS)}")
    write_files(file.parent, {file.name: _bytes(figure, format)})  # type: ignore[arg-type]


def _bytes(figure: Figure, format: FigureFormat) -> bytes:
    """Return the content of a figure's file; equal figures give equal bytes."""
    import matplotlib

    date = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(format)
    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "factorgraph_adj"}):
        figure.savefig(stream, format=format, dpi=150, metadata=date)
    return stream.getvalue()
