"""Coordinates of two epochs: their differences d, cofactors of d, and what no observation tells.

d = x₂ − x₁ and Q_d = Q₁ + Q₂; where both epochs stand in one adjustment, with the first and the
second place of a point as two points, Q_d = Q₁₁ + Q₂₂ − Q₁₂ − Q₂₁. The motions G that the
observations of either epoch leave open (the datum defects of free networks) move d as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, Problem, known
from ..rotation import exp_rotation
from ..solve.solution import Solution
from ..types import Array, Index, Mask

SPURIOUS = 1e-6
"""Relative size of a motion of d below which it is rounding."""
MOST_ALIGNMENTS = 50
"""Largest number of steps in which the second epoch is moved onto the first."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences of coordinates between two epochs, k coordinates of each of n points."""

    names: tuple[str, ...]
    """Names of the points in the first epoch."""
    later: tuple[str, ...]
    """Their names in the second epoch."""
    axes: str
    """The coordinates that are compared: those of ``xyz`` that are free in both epochs."""
    places: Array
    """Coordinates of the first epoch, (n, 3) metres."""
    d: Array
    """Differences second − first, (n k,) metres, the coordinates of a point together."""
    cofactor: Array
    """Q_d (n k, n k), metres²: covariance for σ0 = 1."""
    motions: Array
    """G (n k, g): motions of d that the observations leave open, orthonormal."""
    vtpv: tuple[float, ...]
    """vᵀPv of each adjustment: of two epochs, or of both in one."""
    redundancy: tuple[int, ...]
    """Redundancy of each adjustment."""

    def rows(self, names: Sequence[str]) -> Index:
        """Return the rows of d of some points, in the order of the names."""
        number = {n: i for i, n in enumerate(self.names)}
        k = len(self.axes)
        at = np.array([number[n] for n in names], dtype=np.intp)
        return (at[:, None] * k + np.arange(k)).ravel()


def between(
    first: Solution,
    second: Solution,
    pairs: Mapping[str, str],
    *,
    onto: Sequence[str] | None = None,
) -> Differences:
    """Return the differences of two adjustments.

    The second epoch is moved onto the first. What the open motions G are to first order is then
    left of it: a rotation ε of points at the distance r from each other, which displaced points
    cause, changes their differences by r ε²/2.

    Args:
        first: solution of the first epoch.
        second: solution of the second epoch.
        pairs: names in the second epoch by names in the first.
        onto: points by which the second epoch is moved; None: all of them.

    Raises:
        InputError: points are unknown, or held, or points do not have the same free coordinates;
            the frames differ; the second epoch cannot be moved onto the first.
    """
    if first.network.frame != second.network.frame:
        raise InputError(
            f"the epochs have different frames: {first.network.frame} and {second.network.frame}; "
            "adjust both in one"
        )
    one, two = _places(first, tuple(pairs)), _places(second, tuple(pairs.values()))
    axes, free = _axes((one, two), pairs)
    mixture = _basis(np.hstack([one.mixture(free), two.mixture(free)]))
    # Grid coordinates of thousands of kilometres are rounded more than the alignment is.
    origin = one.coordinates.mean(axis=0)
    there = one.coordinates - origin
    part = None if onto is None else np.isin(one.names, list(onto))
    moved, turn = aligned(two.coordinates - origin, there, mixture, part)
    turns = np.kron(np.eye(len(one.names)), turn[np.ix_(free, free)])
    return Differences(
        tuple(pairs),
        tuple(pairs.values()),
        axes,
        one.coordinates,
        (moved - there)[:, free].ravel(),
        one.cofactor(free) + turns @ two.cofactor(free) @ turns.T,
        _basis(_seven(one.coordinates)[:, free].reshape(-1, 7) @ mixture),
        (first.vtpv, second.vtpv),
        (first.redundancy, second.redundancy),
    )


def within(solution: Solution, pairs: Mapping[str, str]) -> Differences:
    """Return the differences of pairs of points of one adjustment of both epochs.

    Args:
        solution: the adjustment, in which a point that may have moved stands twice.
        pairs: names of the second places by names of the first.

    Raises:
        InputError: as `between`.
    """
    one, two = _places(solution, tuple(pairs)), _places(solution, tuple(pairs.values()))
    axes, free = _axes((one, two), pairs)
    d = (two.coordinates - one.coordinates)[:, free].ravel()
    a, b = one.columns[:, free].ravel(), two.columns[:, free].ravel()
    both = _cofactor(solution, np.concatenate([a, b]))
    n = len(a)
    cofactor = both[:n, :n] + both[n:, n:] - both[:n, n:] - both[n:, :n]
    g = two.motions(free) - one.motions(free)
    size = max(float(np.linalg.norm(two.motions(free))), 1.0)
    # A motion of the whole object turns the differences too, by far less than it moves points.
    open_ones = g[:, np.linalg.norm(g, axis=0) > 1e-2 * size] if g.size else g
    return Differences(
        tuple(pairs),
        tuple(pairs.values()),
        axes,
        one.coordinates,
        d,
        (cofactor + cofactor.T) / 2.0,
        _basis(open_ones),
        (solution.vtpv,),
        (solution.redundancy,),
    )


@dataclass(frozen=True, eq=False)
class _Places:
    """Points of one epoch."""

    solution: Solution
    names: tuple[str, ...]
    coordinates: Array
    columns: Index
    """Columns of the coordinates, (n, 3); −1 for held points."""
    free: Mask
    """Flags of free coordinates, (n, 3)."""

    def cofactor(self, free: Mask) -> Array:
        """Return Q of the free coordinates (3,) of all points."""
        return _cofactor(self.solution, self.columns[:, free].ravel())

    def motions(self, free: Mask) -> Array:
        """Return how the datum defects move the free coordinates, (n k, d)."""
        rows = self.columns[:, free].ravel()
        parts = [defect.motions[rows] for defect in self.solution.defects]
        return np.hstack([np.zeros((len(rows), 0)), *parts])

    def mixture(self, free: Mask) -> Array:
        """Return the datum defects as mixtures of the seven motions of `_seven`, (7, d)."""
        seven = _seven(self.coordinates)[:, free].reshape(-1, 7)
        scale = np.maximum(np.linalg.norm(seven, axis=0), 1e-300)
        # The motions that move nothing here, such as a rotation about x of a network in plan,
        # have no part in a mixture.
        seven = np.where(scale > SPURIOUS * scale.max(), seven, 0.0)
        return np.asarray(np.linalg.lstsq(seven, self.motions(free), rcond=SPURIOUS)[0])


def _places(solution: Solution, names: tuple[str, ...]) -> _Places:
    table = solution.equations.unknowns["point"]
    wrong = [n for n in names if n not in table.number]
    if wrong:
        raise InputError(
            Problem(f"unknown point; known: {known(table.names, meant=n)}", f"point {n!r}")
            for n in wrong
        )
    at = np.array([table.number[n] for n in names], dtype=np.intp)
    columns = np.where(table.offset[at, None] >= 0, table.offset[at, None] + np.arange(3), -1)
    return _Places(
        solution,
        names,
        np.array(solution.state["point"][at]),
        columns,
        table.free[at] & (columns >= 0),
    )


def _axes(epochs: tuple[_Places, _Places], pairs: Mapping[str, str]) -> tuple[str, Mask]:
    """Return the coordinates that are free for every point in both epochs.

    Raises:
        InputError: points are held, or differ in what is free.
    """
    free = epochs[0].free & epochs[1].free
    held = [n for n, f in zip(pairs, free, strict=True) if not f.any()]
    if held:
        raise InputError(
            Problem(
                "is held in an epoch: it cannot be seen to move; a point that both epochs hold is "
                "part of the reference without being named",
                f"point {n!r}",
            )
            for n in held
        )
    if len(free) == 0:
        raise InputError("no points to compare: the epochs have no free points in common")
    common: Mask = np.asarray(free.all(axis=0))
    other = [n for n, f in zip(pairs, free, strict=True) if (f != common).any()]
    if other:
        words = {
            n: "".join(a for a, f in zip("xyz", free[i], strict=True) if f)
            for i, n in enumerate(pairs)
            if n in other
        }
        raise InputError(
            Problem(
                f"has {words[n]} free, others have not: compare points of the same coordinates",
                f"point {n!r}",
            )
            for n in other
        )
    return "".join(a for a, f in zip("xyz", common, strict=True) if f), common


def _cofactor(solution: Solution, columns: Index) -> Array:
    unit = np.zeros((solution.equations.unknowns.n_columns, len(columns)))
    unit[columns, np.arange(len(columns))] = 1.0
    q = solution.cofactor_times(unit)[columns]
    return np.asarray((q + q.T) / 2.0)


def _basis(g: Array) -> Array:
    """Return an orthonormal basis of motions, (n, rank)."""
    if g.shape[1] == 0:
        return g
    g = g / np.maximum(np.linalg.norm(g, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(g, full_matrices=False)
    return np.asarray(u[:, s > SPURIOUS * s[0]])


def _seven(x: Array) -> Array:
    """Return how seven motions move points x (n, 3): shifts, rotations about x, y, z, and scale.

    Rotations and scale are about the mean place, and move points by 1 m at the largest distance
    from it; (n, 3, 7).
    """
    r = x - x.mean(axis=0)
    size = max(float(np.linalg.norm(r, axis=1).max()), 1e-300)
    turns = np.stack([np.cross(axis, r) for axis in np.eye(3)], axis=2) / size
    shifts = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    return np.concatenate([shifts, turns, (r / size)[:, :, None]], axis=2)


def aligned(x: Array, onto: Array, mixture: Array, part: Mask | None = None) -> tuple[Array, Array]:
    """Move points onto others by a similarity of some motions, so that Σ |Δ|² is least.

    Args:
        x: the points, (n, 3).
        onto: where they shall go, (n, 3).
        mixture: the motions that may be used, mixtures of the seven of `_seven`, (7, g).
        part: points that count in the sum, (n,); None: all of them.

    Returns:
        The moved points (n, 3), and the rotation with scale (3, 3) that turned them.

    Raises:
        InputError: the iteration does not come to rest.
    """
    total = np.eye(3)
    if mixture.shape[1] == 0:
        return x, total
    counted = np.ones(len(x), dtype=bool) if part is None else part
    for _ in range(MOST_ALIGNMENTS):
        size = max(float(np.linalg.norm(x - x.mean(axis=0), axis=1).max()), 1e-300)
        g = _seven(x)[counted].reshape(-1, 7) @ mixture
        t = mixture @ np.linalg.lstsq(g, (onto - x)[counted].ravel(), rcond=SPURIOUS)[0]
        turn = np.exp(t[6] / size) * exp_rotation(t[3:6] / size)
        centre = x.mean(axis=0)
        x = (x - centre) @ turn.T + centre + t[:3]
        total = turn @ total
        if np.abs(t).max() < 1e-12 * size:
            return x, total
    raise InputError(
        "the second epoch cannot be moved onto the first: are the points the same, with the same "
        "names? Adjust the second epoch with start=first"
    )
