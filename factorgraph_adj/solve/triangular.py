"""Triangular solves directly by BLAS.

``scipy.linalg.solve_triangular`` calls LAPACK's trtrs, which wakes the threads of the library even
for blocks of three; on a busy machine each call then costs milliseconds.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import blas

from ..types import Array


def upper_solve(r: Array, b: Array) -> Array:
    """Return R⁻¹ b for upper triangular R (n, n) and b (n, k)."""
    return np.asarray(blas.dtrsm(1.0, r, b, lower=0))


def upper_transposed_solve(r: Array, b: Array) -> Array:
    """Return R⁻ᵀ b for upper triangular R (n, n) and b (n, k)."""
    return np.asarray(blas.dtrsm(1.0, r, b, lower=0, trans_a=1))


def lower_solve(root: Array, b: Array, *, transposed: bool = False) -> Array:
    """Return L⁻¹ b or L⁻ᵀ b for lower triangular L (n, n) and b (n, k)."""
    return np.asarray(blas.dtrsm(1.0, root, b, lower=1, trans_a=int(transposed)))
