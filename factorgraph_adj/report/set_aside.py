"""What data snooping set aside, as the clean solution predicts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..graph.equations import compile_network
from ..io.numbers import Units
from ..network.network import Network
from ..quality.prediction import Predictor
from ..quality.rejections import Snooping
from ..solve.solution import Solution
from ..types import Array, Index
from .rows import ReportRows, Row


@dataclass(frozen=True, eq=False)
class SetAside:
    """Scalar observations that were set aside; arrays (k,), NaN where nothing predicts them."""

    rows: ReportRows
    """All rows of the network before, with innovations as residuals of those."""
    numbers: Index
    """Which of them were set aside."""
    innovation: Array
    """Computed − observed, SI or image units."""
    sigma: Array
    """Standard deviations of the innovations, a-priori σ0 = 1."""
    w: Array
    """What their test values would be."""
    redundancy_numbers: Array
    """What their redundancy numbers would be."""

    def find(self, ident: str, component: str) -> Row:
        """Return the row of an observation of the network before."""
        numbers = self.rows.equations.find([ident])[0].tolist()
        rows = self.rows.at(numbers)
        return next((r for r in rows if r.component == component), rows[0])


def set_aside(solution: Solution, snooping: Snooping, original: Network, units: Units) -> SetAside:
    """Predict what was set aside.

    Args:
        solution: the clean solution.
        snooping: says what was set aside.
        original: the network before.
        units: for the rows.
    """
    equations = compile_network(original)
    ids = [r.id for r in snooping.rejected]
    ids += [ray for p in snooping.points_set_aside for ray in p.rays]
    numbers = np.concatenate([np.zeros(0, dtype=np.intp), *equations.find(ids)])
    numbers = np.unique(numbers)
    figures = _predicted(solution, Predictor(equations, solution), numbers)
    residuals = np.full(equations.n_rows, np.nan)
    residuals[numbers] = figures[0]
    return SetAside(ReportRows(equations, residuals, units), numbers, *figures)


def _predicted(solution: Solution, predictor: Predictor, numbers: Index) -> Sequence[Array]:
    """Return innovations, their σ, w and r (k,) of rows; NaN where they are not determined."""
    out = [np.full(len(numbers), np.nan) for _ in range(4)]
    observation = predictor.equations.observation_of_row[numbers]
    lost = np.unique(observation[~predictor.known(numbers)])
    on = ~np.isin(observation, lost)
    if on.any():
        try:
            found = predictor.predict(numbers[on])
        except InputError:  # such as a point that is now behind its camera
            return out
        figures = (found.innovation, found.sigma, found.w, found.redundancy_numbers)
        for column, values in zip(out, figures, strict=True):
            column[on] = values
    return out
