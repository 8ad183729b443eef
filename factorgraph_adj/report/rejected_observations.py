"""Rejected observations against the solution without them: innovations, σ, w, r of each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..graph.equations import compile_network
from ..graph.weights import weighed_where_known
from ..io.numbers import Units
from ..network.network import Network
from ..quality.prediction import Predictor
from ..solve.solution import Solution
from ..types import Array, Index
from .observation_rows import ReportRows, Row


@dataclass(frozen=True, eq=False)
class RejectedObservations:
    """Scalar observations that were rejected; arrays (k,), NaN where no prediction is possible."""

    rows: ReportRows
    """All rows of the original network; residuals are innovations, NaN for other rows."""
    numbers: Index
    """Numbers of the set-aside rows, (k,)."""
    innovation: Array
    """Computed − observed, SI or image units."""
    sigma: Array
    """Standard deviations of the innovations, a-priori σ0 = 1."""
    w: Array
    """Test values that the observations would have in the adjustment."""
    redundancy_numbers: Array
    """Redundancy numbers that the observations would have in the adjustment."""

    @property
    def count(self) -> int:
        """Number of observations."""
        return len(np.unique(self.rows.equations.observation_of_row[self.numbers]))

    def find(self, ident: str, component: str) -> Row:
        """Return the row of an observation of the original network."""
        numbers = self.rows.equations.find([ident])[0].tolist()
        rows = self.rows.at(numbers)
        return next((r for r in rows if r.component == component), rows[0])


def set_aside(
    solution: Solution, ids: Sequence[str], original: Network, units: Units | None = None
) -> RejectedObservations:
    """Predict observations that were rejected.

    Args:
        solution: the solution without them.
        ids: their ids; `Snooping.rejected_ids` has those of data snooping.
        original: the network with them: the one before data snooping.
        units: units of the rows; metres, gon and degrees by default.
    """
    equations = compile_network(original)
    numbers = np.concatenate([np.zeros(0, dtype=np.intp), *equations.find(list(ids))])
    numbers = np.unique(numbers)
    predictor = Predictor(equations, solution)
    figures = _predicted(solution, predictor, numbers)
    state = predictor.innovations.state
    blocks = tuple(weighed_where_known(original, b, state) for b in equations.blocks)
    equations = replace(equations, blocks=blocks)
    residuals = np.full(equations.n_rows, np.nan)
    residuals[numbers] = figures[0]
    return RejectedObservations(
        ReportRows(equations, residuals, units or Units()), numbers, *figures
    )


def _predicted(solution: Solution, predictor: Predictor, numbers: Index) -> Sequence[Array]:
    """Return innovations, their σ, w and r (k,) of rows; NaN where they are not determined."""
    out = [np.full(len(numbers), np.nan) for _ in range(4)]
    observation = predictor.equations.observation_of_row[numbers]
    lost = np.unique(observation[~predictor.known(numbers)])
    on = ~np.isin(observation, lost)
    if on.any():
        try:
            found = predictor.predict(numbers[on])
        except InputError:  # for example, a point is now behind its camera
            return out
        figures = (found.innovation, found.sigma, found.w, found.redundancy_numbers)
        for column, values in zip(out, figures, strict=True):
            column[on] = values
    return out
