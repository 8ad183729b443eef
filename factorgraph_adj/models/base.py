"""`Linearised`, the result of every model; errors of degenerate geometry; wrapped angles."""

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
    """One array (n, d, k) for each variable with k tangent components; empty if not requested."""


class DegenerateError(AdjustmentError):
    """Rows of a model have degenerate geometry (S = 0, the azimuth of a vertical sight …)."""

    def __init__(self, rows: Index, why: str) -> None:
        self.rows = rows
        self.why = why
        super().__init__(why)


class NoDirectionError(DegenerateError):
    """Rows of a model have a value but no partials: a distance from a line, on the line itself."""


def require(valid: Mask, why: str, error: type[DegenerateError] = DegenerateError) -> None:
    """Raise ``error`` for the rows that are not ``valid``; NaN counts as not valid."""
    if not np.all(valid):
        raise error(np.flatnonzero(~valid), why)


def wrap(angle: Array) -> Array:
    """Wrap angles to (−π, π]."""
    return np.asarray(np.pi - (np.pi - angle) % (2 * np.pi))


def circular_mean(angle: Array) -> Array:
    """Return the direction of the sum of the unit vectors of angles (…, n), in (−π, π], (…)."""
    return np.asarray(np.arctan2(np.sin(angle).sum(axis=-1), np.cos(angle).sum(axis=-1)))


def within(angle: Array, period: float = 2 * np.pi) -> Array:
    """Wrap angles to [0, period); a rounding error below zero is zero."""
    wrapped = np.mod(angle, period)
    return np.where(wrapped < period, wrapped, 0.0)
