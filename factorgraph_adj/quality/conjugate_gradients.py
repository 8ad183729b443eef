"""Conjugate gradients for a matrix that is known by its products (Hestenes & Stiefel 1952)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..types import Array


def conjugate_gradients(
    times: Callable[[Array], Array],
    preconditioner: Array,
    right: Array,
    *,
    relative: float,
    least: float,
) -> Array | None:
    """Solve M x = b in at most k steps; return x (k,).

    Args:
        times: function that returns M p (k,) for p (k,), with M symmetric.
        preconditioner: an approximation C of M⁻¹, symmetric and positive semidefinite, (k, k); the
            solution is in its range.
        right: b, (k,).
        relative: length √(sᵀCs) of the residual s = b − M x, relative to that of b, at which the
            equations count as solved.
        least: smallest curvature pᵀMp along a direction p, relative to its expectation pᵀC⁻¹p.

    Returns:
        The solution; none, if the curvature along a direction is smaller.
    """
    x, left = np.zeros_like(right), right
    along, expected = preconditioner @ left, left
    first = square = float(left @ along)
    for _ in range(len(right)):
        if square <= relative**2 * first:
            break
        turned = times(along)
        curvature = float(along @ turned)
        if curvature < least * float(along @ expected):
            return None
        x = x + square / curvature * along
        left = left - square / curvature * turned
        ahead = preconditioner @ left
        before, square = square, float(left @ ahead)
        along, expected = ahead + square / before * along, left + square / before * expected
    return x
