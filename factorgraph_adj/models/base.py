"""What every model returns, and how it reports geometry that has no answer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..types import Array, Index, Mask


class Linearised(NamedTuple):
    """Residuals of n observations of one kind, and their partials."""

    residual: Array
    """v = computed − observed, (n, d)."""
    jacobians: tuple[Array, ...]
    """One (n, d, k) array for each variable, tangent k; empty where not asked for."""


class DegenerateError(AdjustmentError):
    """Rows of a model whose geometry has no answer (S = 0, a vertical azimuth …)."""

    def __init__(self, rows: Index, why: str) -> None:
        self.rows = rows
        self.why = why
        super().__init__(why)


def require(valid: Mask, why: str) -> None:
    """Raise DegenerateError for the rows that are not ``valid``; NaN counts as not valid."""
    if not np.all(valid):
        raise DegenerateError(np.flatnonzero(~valid), why)


def wrap(angle: Array) -> Array:
    """Wrap angles to (−π, π]."""
    return np.asarray(np.pi - (np.pi - angle) % (2 * np.pi))
