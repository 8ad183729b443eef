"""Tables 1 and 2 of El-Hakim & Faig (1981): effect of terrestrial observations on a block.

**Table 1**, the ISP block, is only a picture in the paper's scan; the text says that terrestrial
observations improve a block with reduced control significantly. The block is that of
`examples.published_blocks.spec_parts.IspBlock`, over the ellipsoid. The following
values are assumptions:

- Full control is X, Y, Z of the 30 points of the edge, reduced control that of its four corners.
- Each layout has distances, directions, azimuths, vertical angles and levelled height differences
  along the same lines: layout 1 along all 30 lines of the edge, layout 2 along every second of
  them, layout 3 along a cross, the middle column and the middle row of points. Astronomic latitude
  and longitude are observed at four points of the edge, or at two ends of the cross.
- The check points are the 47 points inside the edge, which are never control.

**Table 2**: see `examples.published_blocks.industry_1981`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.quality.point_precision import check_points
from factorgraph_adj.simulation.generate.control import Control, Pattern
from factorgraph_adj.simulation.generate.scene import perimeter
from factorgraph_adj.simulation.generate.terrestrial_additions import (
    Additions,
    Astronomic,
    Azimuths,
    Directions,
    Distances,
    HeightDifferences,
    VerticalAngles,
)
from factorgraph_adj.simulation.measurement import Seed
from factorgraph_adj.simulation.spec import Approximate, Earth, Spec, design, simulate
from factorgraph_adj.statistical_tests import chi2_quantile
from factorgraph_adj.units import MILLIMETRE

from ..published_blocks.industry_1981 import simulate_industry_block
from ..published_blocks.spec_parts import IspBlock

IspCase = Literal["full", "reduced", "layout 1", "layout 2", "layout 3"]
ISP_CASES: tuple[IspCase, ...] = ("full", "reduced", "layout 1", "layout 2", "layout 3")
"""Cases: full control, reduced control, and reduced control with each layout of observations."""
EDGE = 30
"""Number of points, and of lines, on the edge of the block."""
COLUMNS, ROWS = 7, 11
"""Numbers of columns and rows of points in the block; the points are numbered by columns."""

IndustryCase = Literal["a", "b", "c", "d"]
INDUSTRY_CASES: Mapping[IndustryCase, Mapping[str, int | bool]] = {
    "a": {},
    "b": {"photos": 4, "terrestrial": False, "self_calibration": False},
    "c": {"photos": 4, "terrestrial": False},
    "d": {"terrestrial": False},
}
"""Data of each case: all data; 4 photos without and with self-calibration; 7 photos."""
IN_PLAN_95 = float(np.sqrt(chi2_quantile(0.95, 2)))
"""Semi-axes of a 95 % error ellipse divided by those of the standard ellipse."""


def isp_spec(case: IspCase) -> Spec:
    """Return the spec of a case of table 1."""
    everywhere: Pattern = "perimeter" if case == "full" else "corners"
    return Spec(
        name=f"ISP block, {case}",
        parts=(IspBlock(), *_terrestrial(case)),
        control=Control(horizontal=everywhere, vertical=everywhere, parts=(0,)),
        earth=Earth(frame="topocentric"),
        approximate=Approximate(points=2.0, centres=5.0, attitudes_deg=0.5),
    )


def isp_trial(seed: Seed, *, case: IspCase) -> dict[str, float]:
    """Simulate and adjust a case of table 1, as a trial of an experiment.

    Returns:
        RMS errors x, y, z of the check points, and RMS standard deviations sigma_x, sigma_y,
        sigma_z of the check points from the adjustment, mm.
    """
    solution = adjust(simulate(isp_spec(case), seed=seed).network)
    checked = check_points(solution)
    index = [checked.names.index(name) for name in isp_inside()]
    errors, sigmas = (
        np.sqrt(np.mean(a[index] ** 2, axis=0)) / MILLIMETRE
        for a in (checked.differences, checked.sigmas)
    )
    names = ("x", "y", "z", "sigma_x", "sigma_y", "sigma_z")
    return dict(zip(names, (*errors.tolist(), *sigmas.tolist()), strict=True))


def isp_inside() -> tuple[str, ...]:
    """Return the names of the points inside the edge of the ISP block."""
    block = design(Spec(parts=(IspBlock(),)))
    xy = np.array([p.coordinates[:2] for p in block.points.values()])
    edge = set(perimeter(xy))
    return tuple(name for i, name in enumerate(block.points) if i not in edge)


def _terrestrial(case: IspCase) -> tuple[Additions, ...]:
    """Return the terrestrial observations of a case."""
    kinds = (Distances, Directions, Azimuths, VerticalAngles, HeightDifferences)
    if case in ("full", "reduced"):
        return ()
    if case == "layout 3":
        cross = _cross()
        there = tuple(kind(parts=(0,), between="given", lines=cross) for kind in kinds)
        ends = (cross[0], cross[ROWS - 1])
        return (*there, Astronomic(parts=(0,), between="given", lines=ends))
    lines = EDGE if case == "layout 1" else EDGE // 2
    there = tuple(kind(parts=(0,), count=lines) for kind in kinds)
    return (*there, Astronomic(parts=(0,), count=4))


def _cross() -> tuple[tuple[str, str], ...]:
    """Return the lines of the middle column and row of points, column first."""
    column = [f"{ROWS * (COLUMNS // 2) + j + 1}" for j in range(ROWS)]
    row = [f"{ROWS * i + ROWS // 2 + 1}" for i in range(COLUMNS)]
    return (*pairwise(column), *pairwise(row))


@dataclass(frozen=True)
class IndustryFigures:
    """One row of table 2, mm."""

    discrepancy: float
    """RMS of adjusted − taped distances."""
    coordinate_error: float
    """``discrepancy`` / √2, as in the paper."""
    sigma: float
    """Mean standard deviation of the coordinates."""
    semi_major: float
    """Mean semi-major axis of the 95 % error ellipses in plan."""


def industry_figures(case: IndustryCase, *, seeds: int = 20) -> IndustryFigures:
    """Simulate and adjust a case of table 2 with seeds 0, 1 …, which are the same for all cases.

    Args:
        case: the case.
        seeds: number of repetitions over which the figures are averaged.
    """
    differences, sigmas, axes = [], [], []
    for seed in range(seeds):
        taped = simulate_industry_block(seed).network.observations.values()
        solution = adjust(simulate_industry_block(seed, **INDUSTRY_CASES[case]).network)  # type: ignore[arg-type]
        for o in taped:
            if isinstance(o, SlopeDistance):
                length = np.linalg.norm(solution.point(o.target) - solution.point(o.station))
                differences.append(length - o.value)
        for point in solution.network.points:
            covariance = solution.covariance(point)
            sigmas.append(np.sqrt(np.diag(covariance)))
            axes.append(IN_PLAN_95 * np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    rms = float(np.sqrt(np.mean(np.square(differences)))) / MILLIMETRE
    sigma, axis = (float(np.mean(a)) / MILLIMETRE for a in (sigmas, axes))
    return IndustryFigures(rms, rms / float(np.sqrt(2)), sigma, axis)
