"""Trials of experiments: functions of a module that worker processes import without pytest."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import numpy as np

from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj import adjust
from factorgraph_adj.blas_threads import numbers_of_threads

NORMAL = {"bias": 0.3, "sigma": 2.0}
"""Mean and standard deviation of what `normal` draws."""


def normal(seed: int, size: int = 1) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    return {"offset": float(rng.normal(NORMAL["bias"], NORMAL["sigma"] / math.sqrt(size)))}


def other(seed: int, size: int = 1) -> dict[str, float]:
    return normal(seed, size)


def every_case(seed: int, kind: str, size: tuple[int, float]) -> dict[str, float]:
    """Figures of all kinds, sums that depend on BLAS, errors, and repetitions that take long."""
    rng = np.random.default_rng(seed)
    if kind == "slow":
        time.sleep(0.03)
    if kind == "fails" and seed % 3 == 0:
        raise ArithmeticError(f"no solution,\n«{seed}»")
    rows = rng.normal(size=(size[0], size[0]))
    x = np.linalg.solve(rows @ rows.T + min(size[1], 1e6) * np.eye(len(rows)), rows)
    figures = {"sum": float(x.sum()), "last": float(x[-1, -1])}
    if kind == "odd":
        figures |= {"nothing": math.nan, "low": -math.inf, "high": math.inf, "minus": -0.0}
    return figures


def threads(seed: int) -> dict[str, int]:
    """Report how many threads BLAS has."""
    return {str(i): n for i, n in enumerate(numbers_of_threads())}


def sometimes_ends(seed: int, ends: int) -> dict[str, float]:
    """End the process that runs it, with one seed."""
    if seed == ends:
        os._exit(7)
    return normal(seed)


def waits_for_another(seed: int, out: str, first: int) -> dict[str, float]:
    """Return nothing; with the first seed, only after the file of results has another line."""
    while seed == first and Path(out).read_bytes().count(b"\n") < 2:
        time.sleep(0.01)
    return {"nothing": 0.0}


def waits(seed: int) -> dict[str, float]:
    time.sleep(0.02)
    return normal(seed)


def check_heights(seed: int, distances: int) -> dict[str, float]:
    """Adjust the industry block and compare one of its points with the truth."""
    made = simulate_industry_block(seed, photos=4, distances=distances)
    solution = adjust(made.network)
    error = solution.point("P35") - made.truth.points["P35"]
    sigma = solution.standard_deviations("P35")
    return {"x": error[0] / sigma[0], "y": error[1] / sigma[1], "sigma x": sigma[0]}
