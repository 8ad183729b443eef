"""Result of an epoch that has ended: figures, points, and the estimate that monitoring compares."""

from __future__ import annotations

from typing import Any

from ..errors import AdjustmentError
from ..monitoring.epoch_estimates import EpochEstimate
from ..quality.observation_groups import observation_groups
from ..quality.reliability import Reliability
from ..service.answers import rounded_figure
from ..service.stream import Stream
from ..statistical_tests import AdjustmentFigures, global_test
from .epoch_search import rejection_doubts

MIN_REDUNDANCY = 1e-3
"""Redundancy of a kind below which its observations say nothing about their precision."""


def epoch_result(stream: Stream, number: int, time: float) -> dict[str, Any]:
    """Return the result of an epoch as JSON.

    Args:
        stream: the settled adjustment.
        number: number of the epoch.
        time: its time, seconds UTC.
    """
    inc = stream.adjustment
    out: dict[str, Any] = {"counts": stream.answers.counts(), "time": time}
    out |= {"problem": "", "points": [], "doubts": [*inc.doubts, *rejection_doubts(inc)]}
    out["counts"]["doubts"] = len(out["doubts"])
    try:
        solution = inc.solution()
    except AdjustmentError as error:
        return out | {"problem": str(error), "estimate": None}
    answer = stream.answers.solution(solution)
    out |= {name: answer[name] for name in ("converged", "reason", "sigma0", "redundancy")}
    out["sigma0_limits"] = sigma0_limits(solution)
    out |= {"points": answer["points"], "estimate": None}
    out["groups"] = group_figures(inc.reliability(power=stream.power))
    try:
        estimate = EpochEstimate.of(solution, number, time)
    except AdjustmentError as error:
        return out | {"problem": str(error)}
    return out | {"estimate": estimate.to_json()}


def sigma0_limits(adjustment: AdjustmentFigures) -> list[float] | None:
    """Return the bounds of σ̂0 within which the global test accepts; None without redundancy."""
    if adjustment.redundancy <= 0:
        return None
    test = global_test(adjustment)
    return [test.lower, test.upper]


def group_figures(found: Reliability) -> list[dict[str, Any]]:
    """Return σ̂ of the observations of each kind from this epoch alone, in their stated σ.

    s = √(Σ ṽ² / Σ r) over the rows of the kind, with weighted residuals ṽ: the first step of the
    estimation of variance components. ``component`` is s, null where nothing is redundant.
    """
    solution = found.solution
    groups = observation_groups(solution, "kind")
    v = solution.equations.residuals(solution.state)[: len(groups.of_row)]
    out = []
    for number, name in enumerate(groups.names):
        rows = groups.of_row == number
        redundancy = float(found.redundancy_numbers[rows].sum())
        ratio = float(v[rows] @ v[rows]) / redundancy if redundancy > MIN_REDUNDANCY else None
        figures: dict[str, Any] = {"name": name, "n": int(rows.sum())}
        figures |= {"redundancy": rounded_figure(redundancy)}
        figures["component"] = None if ratio is None else rounded_figure(ratio**0.5)
        out.append(figures)
    return out
