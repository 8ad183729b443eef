"""Readings whose points and photos all have given coordinates, and how well they fit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from ...errors import InputError
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...types import Array, Index

BETTER = 5.0
"""How many times better another reading of a group must fit to be told."""
LEAST = 4
"""Smallest number of readings of a group."""


def given_rows(
    equations: Equations, kind: str, *, whole: bool = False
) -> Iterator[tuple[Block, Index]]:
    """Iterate over the blocks of a kind, and the rows whose points have given coordinates.

    Blocks with fewer than `LEAST` of them are left out.

    Args:
        equations: the network.
        kind: kind of the observations.
        whole: whether all other unknowns of a row must have a value as well.
    """
    state = equations.unknowns.start()
    for block in equations.blocks:
        if block.kind != kind or block.prior:
            continue
        fine = np.ones(block.n, dtype=bool)
        for what, index in block.variables:
            if whole or what in ("point", "pose"):
                fine &= np.isfinite(state[what][index]).all(axis=1)
        rows = np.flatnonzero(fine)
        if len(rows) >= LEAST:
            yield block, rows


def computed_values(equations: Equations, block: Block, rows: Index) -> tuple[Array, Array]:
    """Return observed and computed values of rows, (k, d); observed ones where there is no answer.

    Points may coincide in rough coordinates, and sights be vertical.
    """
    state = {k: np.nan_to_num(v) for k, v in equations.unknowns.start().items()}
    part, frame = block.select(rows), equations.network.frame
    try:
        v = part.evaluate(frame, state, jacobians=False).residual
    except InputError:
        v = np.zeros_like(part.observed)
        for i in range(part.n):
            with suppress(InputError):
                one = part.select(np.array([i]))
                v[i] = one.evaluate(frame, state, jacobians=False).residual[0]
    return part.observed, v + part.observed


def median(misfit: Array) -> float:
    """Return the median of the sizes of misfits."""
    return float(np.median(np.abs(misfit)))


def own_covariance(block: Block) -> Array:
    """Return the covariances of readings, (k, d, d)."""
    if block.whitener is not None:
        inverse = np.linalg.inv(block.whitener)
        return np.asarray(np.einsum("nij,nkj->nik", inverse, inverse))
    return np.asarray(np.einsum("ni,ij->nij", np.square(block.sigma), np.eye(block.dimension)))
