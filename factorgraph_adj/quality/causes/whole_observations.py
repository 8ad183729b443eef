"""Observations of several components that are wrong as a whole: GNSS positions, vectors, rays.

A gross error of a position is one of x, y and z together. The test values w of its components each
tell of a part of it, while a cause of two components that its other readings share, such as the
centring of a target there, may explain more than any of them. So a cause is compared with whole
observations too: C chooses the rows of one, see `columns`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csc_array

from ...types import Array
from ..reliability import Reliability
from .columns import explain, whitening
from .evidence import VarianceFactor, evidence

MOST = 50
"""Largest number of observations that are tested as a whole: those with the largest Σ w²."""


class WholeObservation(NamedTuple):
    """How likely the observation of several components is that explains most."""

    evidence: float = 0.0
    """Its evidence; 0: there is none."""
    likelihood: float = 0.0
    """The same as if T² were of one unknown, see `Cause.likelihood`."""


NO_OBSERVATION = WholeObservation()
"""There is no observation of several components, or nothing tells of one."""


def best_whole_observation(rel: Reliability, w: Array, *, estimated: bool) -> WholeObservation:
    """Return how likely an error of a whole observation is, of the one that explains most.

    Args:
        rel: the reliability.
        w: test values for σ0 = 1, (n,); 0 where nothing controls a row.
        estimated: whether σ0 is estimated.
    """
    solution = rel.solution
    equations = solution.equations
    number = equations.observation_of_row
    observed = np.zeros(len(number), dtype=bool)
    for block in equations.blocks:
        observed[block.rows] = not block.prior
    several = (np.bincount(number[observed], minlength=int(number.max()) + 1) > 1)[number]
    rows = np.flatnonzero(observed & several)
    if not len(rows):
        return NO_OBSERVATION
    size = np.bincount(number[rows], np.square(w[rows]))
    worst = [i for i in np.argsort(-size, kind="stable")[:MOST].tolist() if size[i] > 0.0]
    parts = [rows[number[rows] == i] for i in worst]
    if not parts:
        return NO_OBSERVATION
    chosen = np.concatenate(parts)
    first = np.cumsum([0, *map(len, parts)])
    ones = coo_array(
        (np.ones(len(chosen)), (chosen, np.arange(len(chosen)))), shape=(len(number), len(chosen))
    )
    columns = csc_array(whitening(equations) @ csc_array(ones))
    groups = [np.arange(a, b) for a, b in pairwise(first.tolist())]
    out = NO_OBSERVATION
    for found in explain(solution, columns, groups):
        if found.dof:
            weight = VarianceFactor.left_by(
                solution, estimated=estimated, t2=found.t2, dof=found.dof
            )
            t2 = found.t2 / weight.variance
            one = WholeObservation(*(evidence(t2, q, weight.freedom) for q in (found.dof, 1)))
            out = max(out, one)
    return out
