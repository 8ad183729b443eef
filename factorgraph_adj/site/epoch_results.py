"""Result of an epoch that has ended: figures, points, and the estimate that monitoring compares."""

from __future__ import annotations

from typing import Any

from ..errors import AdjustmentError
from ..service.stream import Stream


def epoch_result(stream: Stream, number: int, time: float) -> dict[str, Any]:
    """Return the result of an epoch as JSON.

    Args:
        stream: the settled adjustment.
        number: number of the epoch.
        time: its time, seconds UTC.
    """
    inc = stream.adjustment
    out: dict[str, Any] = {"counts": stream.answers.counts(), "time": time}
    out |= {"problem": "", "points": [], "doubts": list(inc.doubts)}
    try:
        solution = inc.solution()
    except AdjustmentError as error:
        return out | {"problem": str(error), "estimate": None}
    answer = stream.answers.solution(solution)
    out |= {name: answer[name] for name in ("converged", "reason", "sigma0", "redundancy")}
    return out | {"points": answer["points"], "estimate": None}
