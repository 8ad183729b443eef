"""Cholesky of symmetric block matrices in dense fronts: solution, inverse blocks, reduced root.

Each front of `factorgraph_adj.solve.nested_dissection` is a dense matrix in LAPACK: with the
columns that it eliminates (o) and the columns that remain (b, the later nodes and the border of
full columns),

    F_oo = L Lᵀ,   B = F_bo L⁻ᵀ,   the parent takes in F_bb − B Bᵀ.

The selected inverse runs from the root to the leaves (Takahashi), with T = B L⁻¹:

    Σ_bo = −Σ_bb T,   Σ_oo = L⁻ᵀL⁻¹ − Tᵀ Σ_bo.

The last front and the border are the root, a dense matrix that may keep columns that other parts of
a network have too, because only all parts together determine them (Helmert 1880). With e for the
eliminated columns and k for those that are kept,

    F_ee = L Lᵀ,   B = F_ke L⁻ᵀ,   S = F_kk − B Bᵀ,   s = y_k − B L⁻¹ y_e.

S and s are the reduced normal equations of the part. Once the solution x_k of all parts is known,
x_e = L⁻ᵀ(L⁻¹ y_e − Bᵀ x_k); and with their covariances Σ_kk and T = B L⁻¹,

    Σ_ke = −Σ_kk T,   Σ_ee = L⁻ᵀL⁻¹ − Tᵀ Σ_ke.

Triangular solves call BLAS directly: ``scipy.linalg.solve_triangular`` calls LAPACK's trtrs, which
wakes the threads of the library even for blocks of three; on a busy machine each call then costs
milliseconds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import blas, lapack

from ..errors import SingularError
from ..types import Array, Index
from .block_matrix import BlockMatrix
from .nested_dissection import BlockPattern, Front


def solve_lower(root: Array, b: Array, *, transposed: bool = False) -> Array:
    """Return L⁻¹ b or L⁻ᵀ b for lower triangular L (n, n) and b (n, k); BLAS takes no empty b."""
    if not b.size:
        return b.copy()
    return np.asarray(blas.dtrsm(1.0, root, b, lower=1, trans_a=int(transposed)))


class RootFront:
    """A dense symmetric matrix, factorised as far as it is eliminated."""

    _covariances: Array | None = None

    def __init__(self, own: Array, across: Array, rest: Array, kept: Index, scale: Array) -> None:
        """Take the parts of a factor.

        Args:
            own: L, (e, e).
            across: B, (m, e).
            rest: F_kk − B Bᵀ, (m, m).
            kept: columns that are kept, (m,).
            scale: factors of the kept columns, by which the matrix was scaled, (m,).
        """
        self.own, self.across, self.rest = own, across, rest
        self.kept, self.scale = kept, scale
        eliminated = np.ones(len(own) + len(kept), dtype=bool)
        eliminated[kept] = False
        self.eliminated: Index = np.flatnonzero(eliminated)
        """Columns that are eliminated."""
        self.pivots = np.full(len(eliminated), np.inf)
        """Pivots of the eliminated columns, infinite for the others, (n,)."""
        self.pivots[self.eliminated] = np.diag(own) ** 2

    @classmethod
    def whole(cls, own: Array) -> RootFront:
        """Return a front that keeps no columns, from its factor L."""
        none = np.zeros(0, dtype=np.intp)
        return cls(own, np.zeros((0, len(own))), np.zeros((0, 0)), none, np.zeros(0))

    @classmethod
    def of(cls, matrix: Array, kept: Index, scale: Array) -> RootFront:
        """Eliminate.

        Args:
            matrix: the lower triangle, (n, n).
            kept: columns that are kept, (m,).
            scale: factors of the kept columns, by which the matrix was scaled, (m,).

        Raises:
            SingularError: the matrix of the eliminated columns is not positive definite.
        """
        if not len(kept):
            return cls.whole(cholesky_lower(matrix))
        whole = np.tril(matrix) + np.tril(matrix, -1).T
        e = np.setdiff1d(np.arange(len(matrix)), kept)
        own = cholesky_lower(whole[np.ix_(e, e)])
        across = solve_lower(own, whole[np.ix_(e, kept)]).T
        rest = whole[np.ix_(kept, kept)] - across @ across.T
        return cls(own, across, rest, kept, scale)

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
        half = solve_lower(self.own, y[self.eliminated])
        return np.asarray((y[self.kept] - self.across @ half) / self.scale[:, None])

    def solve(self, y: Array, kept: Array | None) -> Array:
        """Return x for y (n, r), both in scaled columns.

        Args:
            y: right sides.
            kept: x at the kept columns, not scaled (m, r); None: Σ_kk s.
        """
        half = solve_lower(self.own, y[self.eliminated])
        x = np.empty_like(y)
        if kept is not None:
            x[self.kept] = kept / self.scale[:, None]
        elif len(self.kept):
            x[self.kept] = self.covariances @ (y[self.kept] - self.across @ half)
        half -= self.across.T @ x[self.kept]
        x[self.eliminated] = solve_lower(self.own, half, transposed=True)
        return x

    def inverse(self) -> Array:
        """Return the covariances of all columns, scaled, (n, n)."""
        own = inverse_from_cholesky(self.own)
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


def cholesky_lower(a: Array) -> Array:
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


def inverse_from_cholesky(root: Array) -> Array:
    """Return L⁻ᵀL⁻¹."""
    if not len(root):
        return np.zeros((0, 0), order="F")
    inverse, _ = lapack.dpotri(root, lower=1)
    return np.asarray(np.tril(inverse) + np.tril(inverse, -1).T)


class Fronts:
    """The factor of a symmetric matrix in blocks, scaled to a unit diagonal."""

    def __init__(
        self,
        fronts: list[Front],
        pattern: BlockPattern,
        diagonal: Array,
        factors: Sequence[tuple[Array, Array]],
        root: RootFront,
    ) -> None:
        """Take the factors of all fronts.

        Args:
            fronts: the fronts in the order of elimination; the last one has no border.
            pattern: the blocks.
            diagonal: diagonal of the matrix, (n w + k,).
            factors: L (o, o) and B (b, o) of each front below the root.
            root: the last front with the border.
        """
        self.fronts, self.pattern = fronts, pattern
        self._below = fronts[:-1]
        self.scale = _unit_scale(diagonal)
        self.own: list[Array] = [own for own, _ in factors]
        """L of each front below the root, (o, o)."""
        self.across: list[Array] = [across for _, across in factors]
        """B of each front below the root, (b, o)."""
        self.last = fronts[-1] if fronts else None
        """The front of the root; None: there are no nodes."""
        self.root_places = _root_places(fronts, pattern)
        """Place of each column of the root."""
        self.root = root
        """The root."""
        self.pivots = np.empty(len(diagonal))
        """Pivots relative to the diagonal of the matrix, (n w + k,); infinite at kept places."""
        for front, own in zip(self._below, self.own, strict=True):
            self.pivots[_places(front, pattern)] = np.diag(own) ** 2
        self.pivots[self.root_places] = root.pivots
        self.diagonal = diagonal
        """Diagonal of the matrix, (n w + k,)."""

    @classmethod
    def of(cls, fronts: list[Front], matrix: BlockMatrix, kept: Index | None = None) -> Fronts:
        """Factorise by Cholesky.

        Args:
            fronts: the fronts in the order of elimination; the last one has no border.
            matrix: the matrix.
            kept: places (m,) in the last front and the border that are not eliminated; None: the
                whole matrix is factorised.

        Raises:
            SingularError: the matrix is not positive definite.
        """
        pattern, diagonal = matrix.pattern, matrix.diagonals
        scale = _unit_scale(diagonal)
        with np.errstate(over="ignore", invalid="ignore"):  # coordinates may have diverged
            m = matrix.scaled(scale)
        every = (m.diagonal, m.pairs, m.side, m.corner)
        if not all(np.isfinite(x).all() for x in every):
            raise SingularError("the cameras' normal equations have no pivots")
        factors: list[tuple[Array, Array]] = []
        waiting: dict[int, Array] = {}
        for front in fronts[:-1]:
            f = _assembled(front, m, waiting)
            k = pattern.width * len(front.own)
            own = cholesky_lower(f[:k, :k])
            across = blas.dtrsm(1.0, own, f[k:, :k], side=1, lower=1, trans_a=1)
            rest = np.array(f[k:, k:], order="F")
            if len(rest) and k:
                rest = blas.dsyrk(-1.0, across, beta=1.0, c=rest, lower=1, overwrite_c=1)
            waiting[id(front)] = rest
            factors.append((own, across))
        f = m.corner
        if fronts:
            f = _assembled(fronts[-1], m, waiting)
            inner = pattern.width * len(fronts[-1].own)
            f[inner:, inner:] += m.corner
        kept = np.zeros(0, dtype=np.intp) if kept is None else kept
        place = np.full(len(diagonal), -1, dtype=np.intp)
        at = _root_places(fronts, pattern)
        place[at] = np.arange(len(at))
        return cls(fronts, pattern, diagonal, factors, RootFront.of(f, place[kept], scale[kept]))

    def _forward(self, y: Array) -> Array:
        """Eliminate the columns below the root from a right side (n w + k, r)."""
        n, w = self.pattern.n, self.pattern.width
        r = y.shape[1]
        x = y * self.scale[:, None]
        nodes, border = x[: n * w].reshape(n, w, r), x[n * w :]
        for front, own, across in zip(self._below, self.own, self.across, strict=True):
            k = len(front.own)
            part = solve_lower(own, nodes[front.own].reshape(w * k, r))
            moved = across @ part
            end = w * len(front.border)
            nodes[front.border] -= moved[:end].reshape(len(front.border), w, r)
            border -= moved[end:]
            nodes[front.own] = part.reshape(k, w, r)
        return np.asarray(x)

    def half(self, y: Array) -> Array:
        """Return L⁻¹ y (n w + k, r) of M = L Lᵀ without kept places: yᵀM⁻¹y = |L⁻¹y|²."""
        x = self._forward(y)
        x[self.root_places] = solve_lower(self.root.own, x[self.root_places])
        return x

    def remaining(self, y: Array) -> Array:
        """Return what the elimination of y (n w + k, r) leaves at the kept places, (m, r)."""
        return self.root.remaining(self._forward(y)[self.root_places])

    def solve(self, y: Array, kept: Array | None = None) -> Array:
        """Return M⁻¹ y for y (n w + k, r).

        Args:
            y: right sides.
            kept: solution at the kept places, (m, r); None: it follows from their covariances.
        """
        n, w = self.pattern.n, self.pattern.width
        r = y.shape[1]
        x = self._forward(y)
        x[self.root_places] = self.root.solve(x[self.root_places], kept)
        nodes, border = x[: n * w].reshape(n, w, r), x[n * w :]
        for front, own, across in zip(
            reversed(self._below), reversed(self.own), reversed(self.across), strict=True
        ):
            k, end = len(front.own), w * len(front.border)
            later = np.concatenate([nodes[front.border].reshape(end, r), border])
            part = nodes[front.own].reshape(w * k, r) - across.T @ later
            nodes[front.own] = solve_lower(own, part, transposed=True).reshape(k, w, r)
        return np.asarray(x * self.scale[:, None])

    def inverse(self) -> BlockMatrix:
        """Return the inverse at the blocks of the pattern."""
        n, w, side = self.pattern.n, self.pattern.width, self.pattern.side
        z = self.root.inverse()
        inner = len(z) - side
        out = BlockMatrix(
            self.pattern,
            np.empty((n, w, w)),
            np.empty((len(self.pattern.first), w, w)),
            np.empty((n, w, side)),
            z[inner:, inner:],
        )
        joint: dict[int, Array] = {}
        if self.last is not None:
            self._spread(self.last, z, out, joint)
        for front, own, across in zip(
            reversed(self._below), reversed(self.own), reversed(self.across), strict=True
        ):
            p, k = front.size, w * len(front.own)
            z = np.empty((w * p + side,) * 2, order="F")
            z[k:, k:] = joint.pop(id(front))
            inverse = inverse_from_cholesky(own)
            if len(across) and k:
                t = blas.dtrsm(1.0, own, across, side=1, lower=1)
                between = blas.dsymm(-1.0, np.asfortranarray(z[k:, k:]), t, lower=1)
                inverse -= t.T @ between
                z[k:, :k], z[:k, k:] = between, between.T
            z[:k, :k] = inverse
            self._spread(front, z, out, joint)
        return out.scaled(self.scale)

    def _spread(self, front: Front, z: Array, out: BlockMatrix, joint: dict[int, Array]) -> None:
        """Put the inverse of a front into the blocks of the pattern, and before its children."""
        w, side, p = self.pattern.width, self.pattern.side, front.size
        k = w * len(front.own)
        blocks = _blocks(z, p, w)
        d = np.arange(len(front.own))
        out.diagonal[front.own] = blocks[d, :, d, :]
        found = blocks[front.rows, :, front.columns, :]
        out.pairs[front.blocks] = np.where(
            front.transposed[:, None, None], found.transpose(0, 2, 1), found
        )
        out.side[front.own] = z[w * p :, :k].T.reshape(len(d), w, side)
        for child in front.children:
            runs = _runs(child, w, side, p)
            part = np.empty((w * len(child.border) + side,) * 2, order="F")
            for a, b, to in runs:
                for a2, b2, to2 in runs:
                    part[a:b, a2:b2] = z[to : to + b - a, to2 : to2 + b2 - a2]
            joint[id(child)] = part


def _unit_scale(diagonal: Array) -> Array:
    """Return the factors of columns that make a diagonal one.

    A kept place may have a diagonal of zero: only other parts observe it.
    """
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def _places(front: Front, pattern: BlockPattern) -> Index:
    """Return the places of the columns that a front eliminates."""
    w = pattern.width
    return np.asarray((w * front.own[:, None] + np.arange(w)).ravel(), dtype=np.intp)


def _root_places(fronts: Sequence[Front], pattern: BlockPattern) -> Index:
    """Return the places of the columns of the root: those of the last front, and the border."""
    border = pattern.n * pattern.width + np.arange(pattern.side)
    last = (_places(front, pattern) for front in fronts[-1:])
    return np.concatenate([*last, border]).astype(np.intp)


def _assembled(front: Front, m: BlockMatrix, waiting: dict[int, Array]) -> Array:
    """Return the lower triangle of a front with what its children leave."""
    w, side = m.pattern.width, m.pattern.side
    p = front.size
    f = np.zeros((w * p + side,) * 2, order="F")
    blocks = _blocks(f, p, w)
    between = m.pairs[front.blocks]
    between = np.where(front.transposed[:, None, None], between.transpose(0, 2, 1), between)
    blocks[front.rows, :, front.columns, :] = between
    d = np.arange(len(front.own))
    blocks[d, :, d, :] = m.diagonal[front.own]
    f[w * p :, : w * len(d)] = m.side[front.own].reshape(w * len(d), side).T
    for child in front.children:
        rest = waiting.pop(id(child))
        runs = _runs(child, w, side, p)
        for number, (a, b, t) in enumerate(runs):
            for a2, b2, t2 in runs[: number + 1]:
                f[t : t + b - a, t2 : t2 + b2 - a2] += rest[a:b, a2:b2]
    return f


def _blocks(f: Array, p: int, w: int) -> Array:
    """Return a view (p, w, p, w) of the first p w rows and columns of a matrix."""
    r, c = f.strides
    return np.lib.stride_tricks.as_strided(f, (p, w, p, w), (w * r, r, w * c, c))


def _runs(child: Front, w: int, side: int, size: int) -> list[tuple[int, int, int]]:
    """Return first and end row in the rest of a child, and the first row in its parent."""
    end = w * len(child.border)
    runs = [(w * a, w * b, w * t) for a, b, t in child.in_parent]
    return [*runs, (end, end + side, w * size)]
