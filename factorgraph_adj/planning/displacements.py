"""The smallest displacement between two epochs of one design that a test will find.

Both epochs are measured as the design says, so that differences of coordinates have Q_d = 2 Q. A
point is tested against the reference points, which are taken as stable, by the test of
`factorgraph_adj.epochs.congruence` with known σ0: with Q_∇ of its displacement (k, k)

    ∇ = √(λ(α, β, k) · largest eigenvalue of Q_∇)

is found with the probability 1 − β in the direction in which it is hardest to find; λ is the
noncentrality of χ² with k degrees of freedom. k counts the free coordinates of the point: 1 for a
height, 2 in plan, 3 in space.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..epochs.hypotheses import Scale, rank, spanning, weight
from ..errors import InputError, Problem
from ..solve.solution import Solution
from ..types import Array, Index
from .patterns import matching
from .targets import DetectableDisplacement, describe


@dataclass(frozen=True, eq=False)
class DisplacementItems:
    """The points to which a target applies, and their reference points."""

    target: DetectableDisplacement
    """The target."""
    names: tuple[str, ...]
    """Names of the m points."""
    columns: Index
    """Columns of the free coordinates of the reference points, and then of the points, (n,)."""
    owner: Index
    """Number of the point of each of these columns; −1 for reference points, (n,)."""
    motions: Array
    """Motions that the observations leave open, (n, g)."""

    @cached_property
    def noncentralities(self) -> dict[int, float]:
        """Noncentrality λ of the test of a point by its number of free coordinates."""
        known, counts = Scale(1.0, float("inf")), np.bincount(self.owner[self.owner >= 0])
        alpha, power = self.target.alpha, self.target.power
        return {k: known.noncentrality(alpha, power, k) for k in np.unique(counts).tolist()}

    def figures(self, q: Array) -> Array:
        """Return the smallest detectable displacements of the points, (m,) metres.

        Args:
            q: cofactors of the columns, (n, n).

        Raises:
            InputError: coordinates depend on each other beyond the open motions.
        """
        if not len(self.names):
            return np.zeros(0)
        w = weight(2.0 * q, self.motions)
        loose = self.owner >= 0
        moved = np.linalg.inv(w[np.ix_(loose, loose)])
        own = self.owner[loose]
        out = np.zeros(len(self.names))
        for i in range(len(self.names)):
            at = own == i
            largest = float(np.linalg.eigvalsh(moved[np.ix_(at, at)])[-1])
            out[i] = np.sqrt(self.noncentralities[int(at.sum())] * max(largest, 0.0))
        return out


def displacement_items(solution: Solution, target: DetectableDisplacement) -> DisplacementItems:
    """Return the points of a target and their reference points, in the columns of a solution.

    Raises:
        InputError: points are held; observations leave motions open, and the reference points do
            not determine them.
    """
    table = solution.equations.unknowns["point"]
    names = list(table.names)
    on = matching(names, target.points)
    free = table.free & (table.offset >= 0)[:, None]
    held = [n for n, o, f in zip(names, on, free, strict=True) if o and not f.any()]
    if held:
        raise InputError(
            Problem(f"is held: it cannot be seen to move; {describe(target)}", f"point {n!r}")
            for n in held
        )
    stable = matching(names, target.reference) & ~on & free.any(axis=1)
    order = [*np.flatnonzero(stable).tolist(), *np.flatnonzero(on).tolist()]
    columns, owner = [], []
    for number in order:
        own = table.offset[number] + np.flatnonzero(free[number])
        columns += own.tolist()
        owner += [-1 if stable[number] else order.index(number) - int(stable.sum())] * len(own)
    at = np.array(columns, dtype=np.intp)
    motions = [np.zeros((len(at), 0)), *(d.motions[at] for d in solution.defects)]
    g = spanning(np.hstack(motions))
    if g.shape[1] and not stable.any():
        raise InputError(
            Problem(
                "the observations leave motions of the whole open, and the target has no reference "
                "points: name some in reference, and others in points",
                describe(target),
            )
        )
    left = g.shape[1] - rank(g[np.array(owner) < 0])
    if left:
        raise InputError(
            Problem(
                f"it has not enough reference points: they leave {left} of {g.shape[1]} motions of "
                "the whole open; name more of them",
                describe(target),
            )
        )
    points = tuple(names[i] for i in np.flatnonzero(on).tolist())
    return DisplacementItems(target, points, at, np.array(owner, dtype=np.intp), g)


def cofactors_at(solution: Solution, columns: Index) -> Array:
    """Return the cofactors of some columns, (n, n)."""
    unit = np.zeros((solution.equations.unknowns.n_columns, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    q = solution.cofactor_times(unit)[columns]
    return np.asarray((q + q.T) / 2.0)
