"""Low-rank update of a solved system: rows join, leave, constrain; new unknowns; tests of rows.

N is the normal matrix of the system and Q = N⁻¹. The whitened rows B (k, n) have signs s: rows join
(+1), leave (−1), or are constraints without error (0), of infinite weight. With S = diag(s),

    N' = N + Bᵀ S B                     of rows that join or leave
    G  = Q Bᵀ,   D = S + B Q Bᵀ
    Q' = Q − G D⁻¹ Gᵀ                   (Sherman & Morrison 1950, Woodbury 1950)
    dx = −G D⁻¹ v                       step from the minimum without the change to that with it
    Δ(vᵀPv) = vᵀ D⁻¹ v

v are the whitened residuals B x − l of the rows, computed − observed, at the minimum without the
change. Only D, whose size is the number of rows, is factorised.

Rows u of the update are tested against all other observations, including the other rows of the
update. For rows that joined, M_u = (D⁻¹)_uu and e_u = (D⁻¹ v)_u; for rows that left,
M_u⁻¹ = −(D⁻¹)_uu and e_u = −M_u (D⁻¹ v)_u:

    d_u = M_u⁻¹ e_u      innovation, computed from all others − observed; its covariance is M_u⁻¹
    T² = e_uᵀ M_u⁻¹ e_u  χ² with rank(M_u) degrees of freedom
    w_i = e_i / √M_ii    test value of one component
    r_i = M_ii           redundancy number that the row has, or had

D is factorised in two parts. The rows that join come first: their part D₊ = I + B₊ Q B₊ᵀ is
positive definite for every Q, and has a Cholesky factor. The Schur complement of the other rows is
E = D₋ − Cᵀ D₊⁻¹ C, which is factorised by its eigenvalues. For rows that leave, −E = M is their
redundancy matrix after all others joined. By Haynsworth's inertia additivity N' is positive
definite exactly if M is: an eigenvalue zero of M belongs to a combination of the unknowns that
the leaving rows alone determine.

New unknowns b, which the system does not have, border it: rows that join may touch them with the
partials C (k, m), and nothing else is known of b. With λ the whitened residuals of the rows times
their signs, dx = −G λ, D λ = v + C b and Cᵀ λ = 0, therefore

    P  = D⁻¹ − D⁻¹ C N_b⁻¹ Cᵀ D⁻¹      with  N_b = Cᵀ D⁻¹ C,   which takes the place of D⁻¹
    K  = N_b⁻¹ Cᵀ D⁻¹
    λ  = P v,   db = −K v
    Q'_xx = Q − G P Gᵀ,   Q'_xb = −G Kᵀ,   Q'_bb = N_b⁻¹ = K D Kᵀ

With D₊ = L Lᵀ and the orthogonal factors L⁻¹ C = (Q₁ Q₂) (R 0)ᵀ, the rows Q₂ᵀ L⁻¹ say nothing of b
and everything of x, and R⁻¹ Q₁ᵀ L⁻¹ is K of them alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import solve_triangular

from ..types import Array, Index, Mask
from .gauss_newton_steps import Factorised
from .growing_matrix import GrowingMatrix


@dataclass(frozen=True)
class UpdateLimits:
    """Limits within which a low-rank update is as good as a new solution."""

    least_left: float = 1e-6
    """Smallest eigenvalue of E, relative to its scale, that counts as different from zero.

    Along smaller eigenvalues, standard deviations would grow a thousandfold and more when rows
    leave; the value is that of `factorgraph_adj.quality.group_tests.MIN_CONTROLLED_SHARE`.
    """
    most_gained: float = 1e9
    """Largest factor by which rows that join may reduce a variance.

    Q' is a difference that loses nine of the sixteen digits of double precision.
    """


UPDATE_LIMITS = UpdateLimits()
"""The limits of `Update.trusted`."""


class Cofactors(Protocol):
    """Cofactors Q of a system, in any representation."""

    @property
    def size(self) -> int:
        """Number of unknowns n."""
        ...

    def times(self, at: Index, b: Array) -> Array:
        """Return Q Bᵀ (n, k) of rows that touch the columns ``at`` (m,) with ``b`` (k, m)."""
        ...


@dataclass(frozen=True, eq=False)
class DenseCofactors:
    """Q as a matrix, of unknowns or of any functions of unknowns."""

    q: Array
    """Q, (n, n)."""

    @property
    def size(self) -> int:
        """Number of unknowns n."""
        return len(self.q)

    def times(self, at: Index, b: Array) -> Array:
        """Return Q Bᵀ; see `Cofactors`."""
        return np.asarray(self.q[:, at] @ b.T)


@dataclass(frozen=True, eq=False)
class SolvedCofactors:
    """Q as the solution of a factorised system."""

    factor: Factorised
    """The factorised system."""
    size: int
    """Number of unknowns n."""

    def times(self, at: Index, b: Array) -> Array:
        """Return Q Bᵀ; see `Cofactors`."""
        y = np.zeros((self.size, len(b)))
        y[at] = b.T
        return self.factor.solve(y)


class InnovationTests(NamedTuple):
    """Test statistics of observations that other observations predict; σ0 = 1."""

    t2: Array
    """T² of all components together, (...)."""
    w: Array
    """Test value of each component, (..., k)."""
    redundancy_numbers: Array
    """Redundancy number of each component, (..., k)."""


def innovation_statistics(innovation: Array, covariance: Array, own: Array) -> InnovationTests:
    """Test observations against a solution from other observations.

    With d = f(x̂) − l, D = Σ + A Q Aᵀ and M = D⁻¹: T² = dᵀMd, w_i = (Md)_i/√M_ii, r_i = (ΣM)_ii.

    Args:
        innovation: d, (..., k).
        covariance: D, (..., k, k), regular.
        own: Σ of the observations alone, (..., k, k).
    """
    return _statistics(innovation, np.asarray(np.linalg.inv(covariance), dtype=float), own)


def _statistics(d: Array, m: Array, own: Array) -> InnovationTests:
    """Return the statistics of innovations d with M; see `statistics`."""
    e = np.einsum("...ij,...j->...i", m, d)
    precision = np.einsum("...ii->...i", m)
    w = e / np.sqrt(np.where(precision > 0, precision, np.nan))
    r = np.einsum("...ij,...ji->...i", own, m)
    return InnovationTests(np.sum(d * e, axis=-1), w, r)


def covariance_whitener(d: Array) -> Array:
    """Return W (k, k), lower triangular, with W D Wᵀ = I, for a regular covariance matrix D."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(d)))


class BorderedInverse(NamedTuple):
    """P = Z diag(σ) Zᵀ, or D⁻¹ where there are no new unknowns, without null directions."""

    z: Array
    """Z, (k, rank of P)."""
    sigma: Array
    """±1, (rank of P,)."""
    k: Array
    """K, (m, k)."""
    condition: float
    """As `Update.condition`."""
    gained: float
    """As `Update.gained`."""
    determined: float
    """As `Update.determined`."""


class _Split(NamedTuple):
    """Functions of the system's unknowns and of new ones."""

    at: Index
    """Columns of the system that they touch, (m,)."""
    b: Array
    """The functions by these, (j, m)."""
    along: Array
    """F G, (j, k)."""
    new: Index
    """Numbers of the new unknowns that they touch, (n,)."""
    of_new: Array
    """The functions by these, (j, n)."""


@dataclass(frozen=True, eq=False)
class Update:
    """A system with rows that joined, left or are constraints; an immutable value.

    `Update.of` makes an update without rows; `with_rows` returns an update with further rows.
    Columns of new unknowns follow the n columns of the system. Functions F (j, n) of the unknowns
    of the system are given as F G (j, k).
    """

    base: Cofactors
    """Q."""
    columns: GrowingMatrix
    """G, see `spread`."""
    inner: Array
    """D = S + B Q Bᵀ, (k, k)."""
    signs: Array
    """S, (k,)."""
    residuals: Array
    """v, (k,); zero if only cofactors are needed."""
    border: Array
    """C, (k, m)."""

    @classmethod
    def of(cls, base: Cofactors | Array) -> Update:
        """Return a system without any change; a matrix is taken as Q."""
        if isinstance(base, np.ndarray):
            base = DenseCofactors(base)
        nothing, square = np.zeros(0), np.zeros((0, 0))
        return cls(base, GrowingMatrix(base.size), square, nothing, nothing, square)

    def with_unknowns(self, number: int) -> Update:
        """Return the system with more new unknowns, which rows have to determine."""
        more = np.zeros((len(self.signs), number))
        return replace(self, border=np.concatenate([self.border, more], axis=1))

    def with_rows(
        self, at: Index, b: Array, v: Array | None = None, *, sign: float = 1.0
    ) -> Update:
        """Return the system with more rows.

        The cost is that of one solution with Q; earlier rows are not solved again.

        Args:
            at: columns that the rows touch, each once, (m,).
            b: whitened partials by these columns, (k, m).
            v: whitened residuals at the minimum of the system given to `of`, and the values of the
                new unknowns, (k,); None: zero.
            sign: 1 joins, −1 leaves, 0 is a constraint without error; only rows that join may
                touch new unknowns.
        """
        inner = at < self.base.size
        border = np.zeros((len(b), self.border.shape[1]))
        border[:, at[~inner] - self.base.size] = b[:, ~inner]
        at, b = at[inner], b[:, inner]
        g = self.base.times(at, b)
        cross = self.spread[at].T @ b.T
        own = sign * np.eye(len(b)) + b @ g[at]
        return Update(
            self.base,
            self.columns.with_columns(g),
            np.block([[self.inner, cross], [cross.T, own]]),
            np.append(self.signs, np.full(len(b), sign)),
            np.append(self.residuals, np.zeros(len(b)) if v is None else v),
            np.concatenate([self.border, border]),
        )

    def only(self, rows: Index) -> Update:
        """Return the system with some of the rows, as if the others had never been there."""
        inner = self.inner[np.ix_(rows, rows)]
        signs, residuals, border = self.signs[rows], self.residuals[rows], self.border[rows]
        columns = GrowingMatrix(self.base.size).with_columns(self.spread[:, rows])
        return Update(self.base, columns, inner, signs, residuals, border)

    @property
    def spread(self) -> Array:
        """G = Q Bᵀ, (n, k)."""
        return self.columns.array

    # -- the change -----------------------------------------------------------------------------

    @cached_property
    def parts(self) -> BorderedInverse:
        """Factors of P, and K."""
        return _inverse(self.inner, self.signs, self.border)

    @property
    def condition(self) -> float:
        """Smallest relative eigenvalue of E for rows that leave or are constraints; ≤ 1.

        For rows that leave, it is the smallest eigenvalue of M = −E, the share of the redundancy
        that remains: 1 if no row leaves, 0 or less if a combination of unknowns becomes
        undetermined. For constraints, it is that of B Q Bᵀ relative to the largest.
        """
        return self.parts.condition

    @property
    def gained(self) -> float:
        """The largest factor by which a variance along a row that joins is reduced, ≥ 1."""
        return self.parts.gained

    @property
    def determined(self) -> float:
        """Smallest eigenvalue of N_b where each new unknown has the weight 1 alone, or 1."""
        return self.parts.determined

    @property
    def trusted(self) -> bool:
        """Whether figures of the update are as good as those of a new solution; see `Limits`."""
        least = min(self.condition, self.determined)
        return least > UPDATE_LIMITS.least_left and self.gained <= UPDATE_LIMITS.most_gained

    @cached_property
    def inverse(self) -> Array:
        """P, or D⁻¹ without new unknowns, (k, k); the pseudo-inverse if D has null directions."""
        z, sigma = self.parts[:2]
        return np.asarray((z * sigma) @ z.T)

    @cached_property
    def weights(self) -> Array:
        """P v, (k,)."""
        return self._weights(self.residuals[:, None])[:, 0]

    def moved(self, at: Index, b: Array) -> Array:
        """Return the movement (j,) of functions that touch the columns ``at`` with ``b`` (j, m)."""
        f = self._split(at, b)
        of_new = self.parts.k @ self.residuals
        return -np.asarray(f.along @ self.weights + f.of_new @ of_new[f.new])

    def gain(self, at: Index, b: Array) -> Array:
        """Return G P and K of functions that touch the columns ``at`` with ``b`` (j, m): (j, k).

        The functions move by minus this times v; of rows that joined it is Q' Bᵀ.
        """
        f = self._split(at, b)
        return np.asarray(f.along @ self.inverse + f.of_new @ self.parts.k[f.new])

    def loss(self, f: Array, g: Array | None = None) -> Array:
        """Return the decrease F G P (F' G)ᵀ of cofactors between functions, (..., i, j).

        Args:
            f: F G of functions F, (..., i, k).
            g: F' G of other functions F', (..., j, k); None: F' = F.
        """
        z, sigma = self.parts[:2]
        half = f @ z
        other = half if g is None else g @ z
        return np.asarray((half * sigma) @ np.swapaxes(other, -1, -2))

    def losses(self, f: Array, g: Array | None = None) -> Array:
        """Return the diagonal of `loss`, (..., i)."""
        z, sigma = self.parts[:2]
        half = f @ z
        other = half if g is None else g @ z
        return np.asarray((half * other) @ sigma)

    # -- the system with the change -------------------------------------------------------------

    def times(self, at: Index, b: Array) -> Array:
        """Return Q' Bᵀ (n, j) of rows that touch the columns ``at`` with ``b`` (j, m).

        This function lets an update be the base of another update.
        """
        f = self._split(at, b)
        along = f.along.T
        of_new = self.parts.k[f.new].T @ f.of_new.T
        out = -self.spread @ (self._weights(along) + of_new)
        if len(f.at):
            out += self.base.times(f.at, f.b)
        return np.concatenate([out, self.parts.k @ (self.inner @ of_new - along)])

    def between(self, at: Index, b: Array, other: Index, c: Array) -> Array:
        """Return the cofactors B Q' Cᵀ (i, j) of functions.

        Args:
            at: columns that B touches, each once, (m,).
            b: B by these, (i, m).
            other: columns that C touches, (n,).
            c: C by these, (j, n).
        """
        f, g = self._split(at, b), self._split(other, c)
        k = self.parts.k
        of_f, of_g = f.of_new @ k[f.new], g.of_new @ k[g.new]
        out = of_f @ self.inner @ of_g.T - self.loss(f.along, g.along)
        out -= f.along @ of_g.T + of_f @ g.along.T
        if len(f.at) and len(g.at):
            out += f.b @ self.base.times(g.at, g.b)[f.at]
        return np.asarray(out)

    def _split(self, at: Index, b: Array) -> _Split:
        """Divide functions into those of the system and those of new unknowns."""
        inner = at < self.base.size
        of_base, mine = at[inner], b[:, inner]
        new, of_new = at[~inner] - self.base.size, b[:, ~inner]
        return _Split(of_base, mine, mine @ self.spread[of_base], new, of_new)

    def _weights(self, y: Array) -> Array:
        """Return P y (k, j) for y (k, j)."""
        z, sigma = self.parts[:2]
        return np.asarray(z @ (sigma[:, None] * (z.T @ y)))

    @property
    def size(self) -> int:
        """Number of unknowns n + m."""
        return self.base.size + int(self.border.shape[1])

    def solve(self, y: Array) -> Array:
        """Return Q' y for y (n, j)."""
        return self.times(np.arange(self.size), np.ascontiguousarray(y.T))

    def variance(self, at: Index, f: Array) -> Array:
        """Return F Q' Fᵀ (j, j) of functions F that touch the columns ``at`` with ``f`` (j, m)."""
        return self.between(at, f, at, f)

    @cached_property
    def step(self) -> Array:
        """Movement dx and db of the unknowns, (n + m,)."""
        return -np.append(self.spread @ self.weights, self.parts.k @ self.residuals)

    @property
    def vtpv(self) -> float:
        """Change of vᵀPv."""
        z, sigma = self.parts[:2]
        return float(np.square(z.T @ self.residuals) @ sigma)

    def test(self, rows: Index | Mask | None = None) -> tuple[InnovationTests, int]:
        """Test rows of the update against all other observations.

        Args:
            rows: the rows to test among the k rows, all of one sign, +1 or −1; None: all.

        Returns:
            The statistics, and the degrees of freedom of T². The test value of a row that no
            other observation controls is NaN.
        """
        u = np.arange(len(self.signs)) if rows is None else np.arange(len(self.signs))[rows]
        sign = self.signs[u]
        if not len(u) or not sign[0] or np.any(sign != sign[0]):
            raise ValueError("rows that are tested together must all join, or all leave")
        z, sigma = self.parts[:2]
        whole = (z[u] * sigma) @ z[u].T
        share = z[u] @ (sigma * (z.T @ self.residuals))
        values, vectors = np.linalg.eigh(sign[0] * whole)
        on = values > UPDATE_LIMITS.least_left
        inverse = (vectors[:, on] / values[on]) @ vectors[:, on].T
        # D⁻¹ has M of rows that joined, and M⁻¹, the innovation's covariance, of rows that left.
        d, m = (inverse @ share, whole) if sign[0] > 0 else (-share, inverse)
        t2, w, r = _statistics(d, m, np.eye(len(u)))
        return InnovationTests(t2, np.where(r > UPDATE_LIMITS.least_left, w, np.nan), r), int(
            on.sum()
        )


def _inverse(d: Array, signs: Array, border: Array) -> BorderedInverse:
    """Factorise P, the rows that join first."""
    first, rest = np.flatnonzero(signs > 0), np.flatnonzero(signs <= 0)
    own, of_new = np.zeros((0, 0)), np.zeros((border.shape[1], len(first)))
    gained, determined = 1.0, 1.0
    if len(first):
        own = covariance_whitener(d[np.ix_(first, first)])
        gained = float(np.diag(d)[first].max())
    if border.shape[1]:
        own, of_new, determined = _bordered(own, border[first])
    z = np.zeros((len(d), len(own)))
    z[first] = own.T
    sigma, condition = np.ones(len(own)), 1.0
    if len(rest):
        c = own @ d[np.ix_(first, rest)]
        e = d[np.ix_(rest, rest)] - c.T @ c
        values, vectors = np.linalg.eigh(0.5 * (e + e.T))
        leaving = int(np.sum(signs < 0))
        before = float((np.diag(d) - signs)[rest].max())
        scale = max(before, float(np.abs(values).max()), 1.0 if leaving else 0.0)
        left = np.append(-values[:leaving], values[leaving:]).min()
        on = np.abs(values) > UPDATE_LIMITS.least_left * scale
        half = vectors[:, on] / np.sqrt(np.abs(values[on]))
        more = np.zeros((len(d), half.shape[1]))
        more[rest] = half
        more[first] = -own.T @ (c @ half)
        z = np.concatenate([z, more], axis=1)
        sigma = np.append(sigma, np.sign(values[on]))
        condition = float(left / scale) if scale > 0 else 0.0
    # D λ = v + C b of the rows that join, with λ = P v.
    k = np.zeros((border.shape[1], len(d)))
    k[:, first] = of_new
    if len(rest) and len(k):
        k -= ((of_new @ d[first]) @ z * sigma) @ z.T
    return BorderedInverse(z, sigma, k, condition, gained, determined)


def _bordered(own: Array, border: Array) -> tuple[Array, Array, float]:
    """Return what rows that join say without new unknowns, of these alone, and `determined`.

    Args:
        own: L⁻¹, (k, k).
        border: C, (k, m).
    """
    m = border.shape[1]
    weight = np.linalg.norm(border, axis=0)
    least = 0.0
    if len(own) >= m and weight.all():
        q, r = np.linalg.qr(own @ (border / weight), mode="complete")
        least = float(np.linalg.svd(r[:m], compute_uv=False)[-1]) ** 2
    if not least > 0.0:
        return own[:0], np.zeros((m, len(own))), 0.0
    of_new = solve_triangular(r[:m], q[:, :m].T @ own) / weight[:, None]
    return np.asarray(q[:, m:].T @ own), np.asarray(of_new), least
