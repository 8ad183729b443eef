"""Adjustments of badly posed networks, judged by Newton's steps in extended precision."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.errors import AdjustmentError, InputError

from .draw import badly_posed
from .exact import nearest

WITHIN = 2.0
"""The stated bound holds within this factor."""


@dataclass(frozen=True)
class Judged:
    """What became of a network."""

    seed: int
    family: str
    told: str
    """``refused``, ``not converged`` or ``converged``."""
    reason: str
    """What the library says."""
    stated: float = np.nan
    """Distance from the minimum that the library promises, in units of σ."""
    way: float = np.nan
    """Distance by Newton's steps, √(dxᵀN dx)."""
    unknown: float = np.nan
    """Largest distance of one unknown, relative to its own σ."""
    fault: str = ""
    """What is wrong."""


def judged(seed: int) -> Judged:
    """Adjust a network and judge the result."""
    drawn = badly_posed(seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            solution = fga.adjust(drawn.network)
    except (AdjustmentError, InputError) as error:
        return Judged(seed, drawn.family, "refused", str(error).split("\n")[0])
    if not solution.converged:
        return Judged(seed, drawn.family, "not converged", solution.reason)
    true = nearest(solution)
    fault = ""
    expected = solution.datum_defect
    # A point that nothing observes is no defect: it is set apart and told.
    if drawn.defect and not expected and not solution.network.listed_points:
        fault = "a defect by construction is called converged"
    elif true.defect != expected:
        fault = f"{true.defect} columns are not determined, {expected} are filled by the datum"
    elif true.curvature <= 0.0:
        fault = f"not a minimum: curvature {true.curvature:.2g}"
    elif not true.found:
        fault = "no minimum near it"
    elif true.unknown > WITHIN * solution.within:
        fault = f"{true.unknown:.2g} σ from the minimum, {solution.within:.2g} are stated"
    return Judged(
        seed,
        drawn.family,
        "converged",
        solution.reason,
        solution.within,
        true.way,
        true.unknown,
        fault,
    )


def campaign(first: int, n: int) -> Iterator[Judged]:
    """Judge networks one by one."""
    for seed in range(first, first + n):
        yield judged(seed)
