"""The root of an elimination: a dense matrix that is eliminated, except for columns that are kept.

Columns that other parts of a network have too are kept, because only all parts together determine
them (Helmert 1880). With e for the eliminated columns and k for those that are kept,

    F_ee = L Lᵀ,   B = F_ke L⁻ᵀ,   S = F_kk − B Bᵀ,   s = y_k − B L⁻¹ y_e.

S and s are the reduced normal equations of the part. Once the solution x_k of all parts is known,
x_e = L⁻ᵀ(L⁻¹ y_e − Bᵀ x_k); and with their covariances Σ_kk and T = B L⁻¹,

    Σ_ke = −Σ_kk T,   Σ_ee = L⁻ᵀL⁻¹ − Tᵀ Σ_ke.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import blas, lapack

from ..types import Array, Index
from .singular import SingularError
from .triangular import lower_solve


class Root:
    """A dense symmetric matrix, factorised as far as it is eliminated."""

    _covariances: Array | None = None

    def __init__(self, matrix: Array, kept: Index, scale: Array) -> None:
        """Eliminate.

        Args:
            matrix: the lower triangle, (n, n).
            kept: columns that are kept, (m,).
            scale: factors of the kept columns, by which the matrix was scaled, (m,).

        Raises:
            SingularError: the matrix of the eliminated columns is not positive definite.
        """
        n = len(matrix)
        self.kept, self.scale = kept, scale
        eliminated = np.ones(n, dtype=bool)
        eliminated[kept] = False
        self.eliminated: Index = np.flatnonzero(eliminated)
        """Columns that are eliminated."""
        self.pivots = np.full(n, np.inf)
        """Pivots of the eliminated columns, infinite for the others, (n,)."""
        if not len(kept):
            self.own = cholesky(matrix)
            self.across, self.rest = np.zeros((0, n)), np.zeros((0, 0))
        else:
            whole = np.tril(matrix) + np.tril(matrix, -1).T
            e = self.eliminated
            self.own = cholesky(whole[np.ix_(e, e)])
            """L."""
            self.across = lower(self.own, whole[np.ix_(e, kept)]).T
            """B."""
            self.rest = whole[np.ix_(kept, kept)] - self.across @ self.across.T
        self.pivots[self.eliminated] = np.diag(self.own) ** 2

    @property
    def left(self) -> Array:
        """Reduced normal matrix S of the kept columns, (m, m), not scaled."""
        return np.asarray(self.rest / (self.scale[:, None] * self.scale))

    def close(self, covariances: Array) -> None:
        """Take in the covariances of the kept columns, (m, m), which all parts determine."""
        self._covariances = covariances / (self.scale[:, None] * self.scale)

    @property
    def covariances(self) -> Array:
        """Covariances of the kept columns, scaled.

        Raises:
            SingularError: they are not known.
        """
        if self._covariances is None:
            if len(self.kept):
                raise SingularError("the junctions with other parts have no covariances yet")
            return np.zeros((0, 0))
        return self._covariances

    def remaining(self, y: Array) -> Array:
        """Return s for y (n, r) in scaled columns; s (m, r) is not scaled."""
        half = lower(self.own, y[self.eliminated])
        return np.asarray((y[self.kept] - self.across @ half) / self.scale[:, None])

    def solve(self, y: Array, kept: Array | None) -> Array:
        """Return x for y (n, r), both in scaled columns.

        Args:
            y: right sides.
            kept: x at the kept columns, not scaled (m, r); none: Σ_kk s.
        """
        half = lower(self.own, y[self.eliminated])
        x = np.empty_like(y)
        if kept is not None:
            x[self.kept] = kept / self.scale[:, None]
        elif len(self.kept):
            x[self.kept] = self.covariances @ (y[self.kept] - self.across @ half)
        half -= self.across.T @ x[self.kept]
        x[self.eliminated] = lower(self.own, half, transposed=True)
        return x

    def inverse(self) -> Array:
        """Return the covariances of all columns, scaled, (n, n)."""
        own = inverse_of(self.own)
        if not len(self.kept):
            return own
        e, k = self.eliminated, self.kept
        out = np.empty((len(self.pivots),) * 2, order="F")
        t = self.across
        if t.size:
            t = blas.dtrsm(1.0, self.own, t, side=1, lower=1)
        between = -self.covariances @ t
        out[np.ix_(k, k)] = self.covariances
        out[np.ix_(k, e)], out[np.ix_(e, k)] = between, between.T
        out[np.ix_(e, e)] = own - t.T @ between
        return out


def cholesky(a: Array) -> Array:
    """Return L with L Lᵀ = a, of which the lower triangle is read.

    Raises:
        SingularError: the matrix is not positive definite.
    """
    if not len(a):
        return np.zeros((0, 0), order="F")
    root, info = lapack.dpotrf(a, lower=1, clean=1)
    if info != 0:
        raise SingularError(f"pivot {info} of the cameras' normal equations")
    return np.asarray(root)


def inverse_of(root: Array) -> Array:
    """Return L⁻ᵀL⁻¹."""
    if not len(root):
        return np.zeros((0, 0), order="F")
    inverse, _ = lapack.dpotri(root, lower=1)
    return np.asarray(np.tril(inverse) + np.tril(inverse, -1).T)


def lower(root: Array, b: Array, *, transposed: bool = False) -> Array:
    """Return L⁻¹ b, or L⁻ᵀ b; BLAS takes no empty arrays."""
    return lower_solve(root, b, transposed=transposed) if b.size else b.copy()
