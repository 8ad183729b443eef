"""One Gauss-Newton step, and the state after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from ..types import Array

S = TypeVar("S")
"""A state: the values themselves, or what tells where they are."""


class Factorised(Protocol):
    """A factorised system, such as `factorgraph_adj.solve.factor.Factor`."""

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
    """Bound √(dxᵀ (N + λD) dx): without damping, every unknown and every function of the unknowns
    moves by at most this multiple of its own standard deviation."""

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
class Attempt(Generic[S]):
    """A step and the state after it."""

    step: Step
    """The step."""
    state: S | None
    """The state after the step; none: the step takes cameras past their points."""
    vtpv: float
    """Value of vᵀPv after the step; infinite where it cannot be computed."""
