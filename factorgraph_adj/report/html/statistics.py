"""Data of the statistical figures: histogram of tests, their quantiles, redundancy, mean photos."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from ..context import Report
from ..plots.image_rows import cells_for, image_rows, mean_photo
from ..plots.style import length, multiple, readable
from .language import Texts
from .observations import test_name

BINS = 41
"""Number of bars of a histogram of test values."""
REACH = 6.0
"""Largest |w| with a bar of its own; the outermost bars hold what lies beyond."""
MOST = 1000
"""Largest number of points of a quantile plot between its ends."""
ENDS = 200
"""Number of smallest and of largest values that are all shown."""
LEAST = 0.1
"""Smallest number of points in a cell with a vector, as a fraction of the average."""


def statistics(report: Report, t: Texts) -> dict[str, Any] | None:
    """Return histogram, quantiles and redundancy numbers; None without reliability."""
    rel = report.reliability
    if rel is None or not rel.controlled.any():
        return None
    values, critical = report.tests
    tested = np.isfinite(values) & rel.controlled
    sign = report.rows.signs()
    found = {}
    groups = report.rows.groups()
    edges = np.linspace(-REACH, REACH, BINS + 1)
    for g in groups:
        own = (sign * values)[g.rows][tested[g.rows]]
        if len(own):
            counts = np.histogram(np.clip(own, -REACH, REACH), edges)[0]
            found[t.kind(g.label)] = counts.tolist()
    everything = np.sort((sign * values)[tested])
    n = len(everything)
    middle = np.linspace(0, n - 1, MOST).round().astype(np.intp)
    ends = np.arange(min(n, ENDS))
    shown = np.unique(np.concatenate([ends, middle, n - 1 - ends]))
    return {
        "test": test_name(report),
        "critical": critical if np.isfinite(critical) else None,
        "n": n,
        "centres": ((edges[1:] + edges[:-1]) / 2).tolist(),
        "histogram": found,
        "normal": np.round(n * np.diff(ndtr(edges)), 3).tolist(),
        "quantiles": np.round(ndtri((shown + 0.5) / n), 4).tolist(),
        "sorted": np.round(everything[shown], 4).tolist(),
        "redundancy": {
            t.kind(g.label): np.histogram(
                np.clip(rel.redundancy_numbers[g.rows], 0.0, 1.0), np.linspace(0, 1, 21)
            )[0].tolist()
            for g in groups
        },
    }


def mean_photos(report: Report, t: Texts) -> list[dict[str, Any]]:
    """Return the mean residuals in the cells of the image of each camera with image points."""
    rows = image_rows(report.solution)
    out = []
    for name, corners in rows.areas.items():
        camera, own = report.network.cameras[name], rows.of_camera(name)
        mean = mean_photo(own, corners, cells_for(own, corners))
        enough = mean.count >= LEAST * mean.count.mean()
        size = np.hypot(*mean.residual[enough].T)
        side = float(mean.x_edges[1] - mean.x_edges[0])
        typical = float(np.quantile(size, 0.9))
        factor = readable(0.8 * side / typical) if typical > 0 else 1.0
        down = -1.0 if camera.y_down_in_files else 1.0
        ends = mean.centre[enough] + factor * mean.residual[enough]
        y = mean.centre[enough, 1]
        significant = mean.significant[enough]
        key = f"{typical:.2g} {camera.unit}" if camera.unit != "m" else length(typical)
        out.append(
            {
                "camera": name,
                "unit": camera.unit,
                "down": bool(down < 0),
                "from": [mean.centre[enough, 0].tolist(), (down * y).tolist()],
                "to": [ends[:, 0].tolist(), (down * ends[:, 1]).tolist()],
                "count": mean.count[enough].tolist(),
                "significant": significant.tolist(),
                "multiple": multiple(factor),
                "text": t(
                    "mean_photo.text",
                    camera=name,
                    n=len(own.row),
                    cells=int(enough.sum()),
                    red=int(significant.sum()),
                    factor=multiple(factor),
                    typical=key,
                ),
            }
        )
    return out
