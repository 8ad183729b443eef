"""One step of Gauss and Newton, and where it leads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..graph.variables import State
from ..types import Array


class Factorised(Protocol):
    """What solves a system, such as `factorgraph_adj.solve.factor.Factor`."""

    def solve(self, y: Array) -> Array:
        """Return Q y for y (n, k)."""
        ...


@dataclass(frozen=True, eq=False)
class Step:
    """The solution dx of (N + λD) dx = −AᵀPv."""

    movement: Array
    """dx, (n_columns,)."""
    decrease: float
    """Decrease of vᵀPv that the linear model predicts."""
    bound: float
    """√(dxᵀ (N + λD) dx): without damping no unknown, and no function of them, moves further
    relative to its own standard deviation."""

    @classmethod
    def of(cls, factor: Factorised, gradient: Array, damped: Array | float = 0.0) -> Step:
        """Solve for a step.

        Args:
            factor: N + λD, factorised.
            gradient: AᵀPv, (n_columns,).
            damped: the diagonal of λD, (n_columns,).
        """
        dx = factor.solve(-gradient[:, None])[:, 0]
        decrease = float(-gradient @ dx + dx @ (damped * dx))
        return cls(dx, decrease, float(np.sqrt(max(float(-gradient @ dx), 0.0))))


@dataclass(frozen=True, eq=False)
class Attempt:
    """Where a step leads."""

    step: Step
    """The step."""
    state: State | None
    """The state after it; none where it has no answer, or takes cameras past their points."""
    vtpv: float
    """VᵀPv there; infinite where there is no state."""
