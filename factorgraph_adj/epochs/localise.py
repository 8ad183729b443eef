"""Which reference points moved: backward from all, by combinations, or from a robust start.

- backward (Pelzer 1971, Niemeier 2008): while the congruence test of the points that are left
  rejects, the point leaves whose hypothesis has the largest test value.
- combinations (Velsink 2015, Nowel 2020): the smallest set of points leaves without which the test
  accepts; of sets of one size that with the smallest Ω of the others. Points that moved together
  do not smear over those that did not, as they can one by one.
- robust: the similarity transformation of the open motions that minimises Σ |d_i| over the points
  (iteratively weighted, Chen 1983) tells which displacements are significant; these points leave
  at first, and come back where the test of all that are left accepts with them.

Where the datum of both epochs leaves no motion open, all reference points may leave: what held
points, or observations of coordinates, tell of the displacements is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..errors import DatumError, InputError, known
from ..types import Array
from .differences import Differences
from .hypotheses import Scale, Test, moved, rank, spanning, weight

Method: TypeAlias = Literal["backward", "combinations", "robust"]
"""How the points that moved are found."""

MOST_COMBINATIONS = 20_000
"""Largest number of sets of one size that are tried; a larger number is searched backward."""
ROBUST_ITERATIONS = 100
"""Largest number of iterations of the robust transformation."""
ROBUST_STEP = 1e-10
"""Change of the differences, metres, at which the robust transformation ends."""


@dataclass(frozen=True)
class Step:
    """One step of the search: what left, and the test of what is left."""

    left: tuple[str, ...]
    """Points that left the reference in this step; empty for the first test of all."""
    back: tuple[str, ...]
    """Points that came back in this step."""
    test: Test
    """Congruence test of the points that are still in the reference."""


@dataclass(frozen=True)
class Found:
    """Result of a search."""

    stable: tuple[str, ...]
    """Points that are left in the reference."""
    steps: tuple[Step, ...]
    """The steps of the search."""


def localise(
    found: Differences, names: Sequence[str], scale: Scale, *, alpha: float, method: Method
) -> Found:
    """Find the reference points that moved.

    Args:
        found: the differences of the epochs.
        names: the reference points.
        scale: variance of unit weight.
        alpha: probability of a false alarm of each test.
        method: how to search.

    Raises:
        InputError: an unknown method.
        DatumError: the points do not determine the open motions.
    """
    if method not in get_args(Method):
        raise InputError(f"unknown method {method!r}; valid: {known(get_args(Method))}")
    search = _Search(found, tuple(names), scale, alpha)
    if not search.testable(search.names):
        raise DatumError(
            f"{len(search.names)} reference points have no shape to test: take more of them",
            defect=rank(found.motions),
        )
    first = search.test(search.names)
    steps = [Step((), (), first)]
    if first.accepted:
        return Found(search.names, tuple(steps))
    if method == "robust":
        stable = search.robust(steps)
    elif method == "combinations":
        stable = search.combined(steps)
    else:
        stable = search.backward(search.names, steps)
    return Found(stable, tuple(steps))


class _Search:
    """The search for stable points among the reference points of two epochs."""

    def __init__(
        self, found: Differences, names: tuple[str, ...], scale: Scale, alpha: float
    ) -> None:
        self.found, self.names, self.scale, self.alpha = found, names, scale, alpha
        self.k = len(found.axes)

    def _of(self, names: Sequence[str]) -> tuple[Array, Array, Array]:
        """Return d, W and G of some points alone."""
        rows = self.found.rows(names)
        g = spanning(self.found.motions[rows])
        w = weight(self.found.cofactor[np.ix_(rows, rows)], g)
        return self.found.d[rows], w, g

    def test(self, names: Sequence[str]) -> Test:
        """Return the congruence test of some points; no points have nothing to reject."""
        if not names:
            return self.scale.test(0.0, 0, self.alpha)
        d, w, g = self._of(names)
        h = len(d) - rank(g)
        return self.scale.test(float(d @ w @ d), h, self.alpha)

    def testable(self, names: Sequence[str]) -> bool:
        """Return whether the shape of some points is overdetermined, and holds all motions.

        Where no motion is open, the datum of both epochs is left when all points have moved.
        """
        if not names:
            return rank(self.found.motions) == 0
        g = self.found.motions[self.found.rows(names)]
        every = rank(self.found.motions[self.found.rows(self.names)])
        return len(g) - rank(g) > 0 and rank(g) == every

    def backward(self, names: tuple[str, ...], steps: list[Step]) -> tuple[str, ...]:
        """Take one point after the other, that with the largest test value."""
        while True:
            d, w, _ = self._of(names)
            gains = [
                moved(w, d, np.arange(i * self.k, (i + 1) * self.k))[2]
                if self.testable(names[:i] + names[i + 1 :])
                else -np.inf
                for i in range(len(names))
            ]
            worst = int(np.argmax(gains))
            if not np.isfinite(gains[worst]):
                return names
            left = names[worst]
            names = names[:worst] + names[worst + 1 :]
            test = self.test(names)
            steps.append(Step((left,), (), test))
            if test.accepted:
                return names

    def combined(self, steps: list[Step]) -> tuple[str, ...]:
        """Take the smallest set of points without which the others did not change their shape."""
        d, w, _ = self._of(self.names)
        n = len(self.names)
        for size in range(1, n + 1):
            if comb(n, size) > MOST_COMBINATIONS:
                return self.backward(self.names, steps)
            best: tuple[float, tuple[int, ...]] | None = None
            for some in combinations(range(n), size):
                rest = [m for i, m in enumerate(self.names) if i not in some]
                if not self.testable(rest):
                    continue
                rows = (np.array(some)[:, None] * self.k + np.arange(self.k)).ravel()
                gain = moved(w, d, rows)[2]
                if best is None or gain > best[0]:
                    best = gain, some
            if best is None:
                break
            left = tuple(self.names[i] for i in best[1])
            stable = tuple(m for m in self.names if m not in left)
            test = self.test(stable)
            if test.accepted:
                steps.append(Step(left, (), test))
                return stable
        return self.backward(self.names, steps)

    def robust(self, steps: list[Step]) -> tuple[str, ...]:
        """Take what the robust transformation tells, then let come back what fits."""
        moves, q = robust_differences(self.found, self.names)
        values = []
        for i in range(len(self.names)):
            rows = slice(i * self.k, (i + 1) * self.k)
            values.append(float(moves[rows] @ np.linalg.pinv(q[rows, rows]) @ moves[rows]))
        limit = self.k * self.scale.variance * self.scale.quantile(1.0 - self.alpha, self.k)
        order = np.argsort(values)[::-1]
        left: list[str] = []
        for i in order.tolist():
            rest = [n for n in self.names if n not in left and n != self.names[i]]
            if values[i] <= limit or not self.testable(rest):
                break
            left.append(self.names[i])
        stable = tuple(n for n in self.names if n not in left)
        test = self.test(stable)
        steps.append(Step(tuple(left), (), test))
        if not test.accepted:
            return self.backward(stable, steps)
        for name in reversed(left):
            wider = tuple(n for n in self.names if n in stable or n == name)
            test = self.test(wider)
            if test.accepted:
                stable = wider
                steps.append(Step((), (name,), test))
        return stable


def robust_differences(found: Differences, names: Sequence[str]) -> tuple[Array, Array]:
    """Return differences after the robust transformation, and their cofactors.

    The motions t of G minimise Σ |d_i − (G t)_i| over points i: t = (GᵀPG)⁻¹GᵀPd with the weights
    P = 1/(|d_i − (G t)_i| + ε), ε = 10⁻³ of the median σ.

    Args:
        found: the differences of two epochs.
        names: the points.
    """
    rows = found.rows(names)
    d, q, g = found.d[rows], found.cofactor[np.ix_(rows, rows)], spanning(found.motions[rows])
    if g.shape[1] == 0:
        return d, q
    k = len(found.axes)
    least = 1e-3 * float(np.sqrt(np.median(np.diag(q))))
    p = np.ones(len(d))
    moves = np.full(len(d), np.inf)
    s = np.eye(len(d))
    for _ in range(ROBUST_ITERATIONS):
        pg = p[:, None] * g
        s = np.eye(len(d)) - g @ np.linalg.solve(g.T @ pg, pg.T)
        new = s @ d
        size = np.linalg.norm(new.reshape(-1, k), axis=1)
        p = np.repeat(1.0 / (size + least), k)
        p /= p.max()
        change = float(np.abs(new - moves).max())
        moves = new
        if change < ROBUST_STEP:
            break
    return moves, s @ q @ s.T
