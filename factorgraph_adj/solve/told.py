"""Motions of a network of which some observations tell nothing, or nothing that counts."""

from __future__ import annotations

import numpy as np

from ..types import Array, Mask

DIRECTED = 0.01
"""Standard deviation, radians, of a turn of the network up to which it counts as told by
convergence of meridians, or by distances from lines that are not zero: a turn that is known less
well is no longer linear. By convergence, the distance from the pole is known to the same part."""
UPRIGHT = 0.7
"""Cosine of the angle between a rotation and the vertical from which it is a turn about it."""


def undirected(
    noticed: Array, among: Array, radians: Array, up: Array | None, limits: tuple[float, float]
) -> Array:
    """Return the motions among some of which rows say nothing that counts.

    What tells a turn counts above the upper limit, where the standard deviation of the turn is
    `DIRECTED` at most: convergence of meridians tells a turn about the vertical to azimuths of
    unknown constant, and a distance from a line that is not zero a turn about the line. Where a
    turn about the vertical counts, so does what convergence tells of the distance from the pole,
    above the lower limit.

    Args:
        noticed: what the rows notice of each motion, relative to σ, (rows, n).
        among: combinations of the motions, orthonormal, (n, d).
        radians: rotation vectors of the motions, (3, n).
        up: the vertical, (3,); None: no turn about it is told apart.
        limits: lower and upper limit.
    """
    told = noticed @ among
    _, values, right = np.linalg.svd(told, full_matrices=len(told) < told.shape[1])
    padded = np.zeros(told.shape[1])
    padded[: len(values)] = values
    turns = radians @ among @ right.T
    above = padded > limits[1]
    counts = above & (np.linalg.norm(turns, axis=0) <= DIRECTED * padded)
    if up is not None and not np.any(above & ~counts):
        upright = np.abs(up @ turns) > UPRIGHT * np.linalg.norm(turns, axis=0)
        if np.any(counts & upright):
            counts |= padded > limits[0]
    return np.asarray(among @ right[~counts].T)


def untold(noticed: Array, among: Array, threshold: float) -> Array:
    """Return the motions among some of which rows notice less than a threshold.

    Args:
        noticed: what the rows notice of each motion, (rows, n).
        among: combinations of the motions, orthonormal, (n, d).
        threshold: limit.
    """
    told = noticed @ among
    # With fewer rows than motions, the other motions are unnoticed too.
    _, values, right = np.linalg.svd(told, full_matrices=len(told) < told.shape[1])
    padded = np.zeros(told.shape[1])
    padded[: len(values)] = values
    return np.asarray(among @ right[padded < threshold].T)


def independent(motions: Array, length: Array) -> Mask:
    """Return which motions (n, 7) move something that those before them do not move likewise.

    Where only heights of one point are free, its shift in z stands for rotations and scale too.
    """
    real = length > 1e-12 * max(float(length.max()), np.finfo(float).tiny)
    basis = np.zeros((len(motions), 0))
    for i in np.flatnonzero(real):
        rest = motions[:, i] / length[i]
        for _ in range(2):  # once more, or rounding leaves a part in the basis
            rest = rest - basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        real[i] = size > 1e-9
        if real[i]:
            basis = np.column_stack([basis, rest / size])
    return real
