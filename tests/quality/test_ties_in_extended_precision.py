"""Reliability of the ties of rigid mounts, against QR with 64 bits of mantissa."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.network.composite_unknowns import RIGID
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.networks.rigs import PARTS, rig
from tests.support.dense import Dense
from tests.support.elimination_rules import everything_by_qr

LOST = {RIGID: 2e-6, (1e-6, 1e-5): 1e-9, (1e-5, 1e-4): 1e-11}
"""What rounding may leave of r and e1 by the play of a mount: the square of the ratio between the
stiffness of a tie and the precision of a photo takes away digits."""

LARGE = 10.0
"""Times as much of e1, which is up to 15 for images beside free mounts; 4·10⁻⁶ was found."""

pytestmark = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="this machine has no extended precision"
)


def triangle(a: Array) -> Array:
    """Return R of A = QR by Householder reflections, in the precision of A."""
    a = a.copy()
    for k in range(a.shape[1]):
        u = a[k:, k].copy()
        u[0] += np.copysign(np.sqrt(u @ u), u[0])
        u /= np.sqrt(u @ u)
        a[k:, k:] -= 2 * np.outer(u, u @ a[k:, k:])
    return np.triu(a[: a.shape[1]])


def inverse(r: Array) -> Array:
    """Return the inverse of an upper triangle, by substitution."""
    out = np.zeros_like(r)
    for j in range(len(r)):
        out[j, j] = 1 / r[j, j]
        for i in range(j - 1, -1, -1):
            out[i, j] = -(r[i, i + 1 : j + 1] @ out[i + 1 : j + 1, j]) / r[i, i]
    return out


def extended(solution: fga.Solution) -> tuple[Array, Array]:
    """Return r and e1 of every row, without correlations."""
    dense = Dense.at(solution.equations, solution.state)
    a = dense.design.astype(np.longdouble)
    a /= np.sqrt(np.sum(a * a, axis=0))
    root = inverse(triangle(a))
    points = np.zeros(len(dense.free), dtype=bool)
    for first in solution.equations.unknowns["point"].offset:
        points[first : first + 3] |= first >= 0
    others = np.where(points[dense.free], 0, a)
    return 1 - np.sum((a @ root) ** 2, axis=1), np.sum((others @ root) ** 2, axis=1)


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("play", LOST)
@pytest.mark.parametrize("free", [(), PARTS])
@pytest.mark.parametrize("by_qr", [False, True])
@pytest.mark.parametrize("seed", [1, 2])
def test_r_and_e1_are_those_of_extended_precision(play, free, by_qr, seed):
    with everything_by_qr() if by_qr else nullcontext():
        solution = fga.adjust(measure(rig(4, free=free, play=play), seed=seed), tolerance=1e-8)
        found = fga.reliability(solution)
    assert solution.run.solver.layers.by_qr == by_qr
    r, e1 = extended(solution)
    np.testing.assert_allclose(found.redundancy_numbers, r.astype(float), atol=LOST[play], rtol=0)
    close = LARGE * LOST[play]
    np.testing.assert_allclose(found.e1, e1.astype(float), atol=close, rtol=close)
