"""Search for points that the observations of a network cannot determine."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from ..graph.equations import Equations, compile_rows
from ..network.network import Network
from ..types import Array, Index, Mask

RAYS = 2
"""Number of image rays that determine a point."""
NULL = 1e-11
"""Smallest eigenvalue of the N of a determined point. N is scaled to a unit diagonal before the
orientation unknowns are eliminated."""


def undetermined_points(network: Network) -> list[str]:
    """Return the points with free coordinates that are not determined.

    A point is not determined if it would be undetermined even with all other points, photos and
    instruments known: N of its free coordinates, at most 3 × 3, is singular after elimination of
    the orientations of the sets of directions to and from the point. Two image rays determine a
    point, and so does one ray with a known height; a known height alone is not sufficient.

    Args:
        network: a network with values near the true ones everywhere.
    """
    if not network.points:
        return []
    equations = compile_rows(network)
    points = equations.unknowns["point"]
    _, of_ray, _, _ = network.images.columns()
    rays = np.bincount(of_ray, minlength=len(points.names))
    asked = points.free.any(axis=1) & (rays < RAYS)
    if not asked.any():
        return []
    normals, taken = _normals(equations, asked)
    return [
        points.names[i]
        for i in np.flatnonzero(asked).tolist()
        if _is_singular(normals[i], taken[i], points.free[i])
    ]


def _normals(equations: Equations, asked: Mask) -> tuple[Array, Array]:
    """Return N of each point, all else known, and its loss to orientations, (n, 3, 3) each."""
    state = equations.unknowns.start()
    # Orientations cancel in measured directions; an unknown orientation may have any value.
    state["orientation"] = np.nan_to_num(state["orientation"])
    sets = equations.unknowns["orientation"]
    loose = (sets.free & np.isinf(sets.sigma))[:, 0]
    normals, taken = np.zeros((2, len(asked), 3, 3))
    of_sets = np.zeros(len(sets.names))
    number: list[Index] = []
    column: list[Index] = []
    coupled: list[Array] = []
    for block in equations.blocks:
        on = [i for i, (kind, _) in enumerate(block.variables) if kind == "point"]
        turns = [i for i, (kind, _) in enumerate(block.variables) if kind == "orientation"]
        if turns:
            chosen = block
        else:
            touched = [asked[block.variables[i][1]] for i in on]
            if not touched:
                continue
            chosen = block.select(np.flatnonzero(np.any(touched, axis=0)))
        if not chosen.n:
            continue
        jacobians = chosen.evaluate(equations.network.frame, state).jacobians
        by_point = [(chosen.variables[i][1], chosen.whiten(jacobians[i])) for i in on]
        for index, a in by_point:
            np.add.at(normals, index, np.einsum("nda,ndb->nab", a, a))
        for i in turns:
            of_set, b = chosen.variables[i][1], chosen.whiten(jacobians[i])[:, :, 0]
            np.add.at(of_sets, of_set, np.sum(b * b, axis=1))
            for index, a in by_point:
                number.append(index)
                column.append(of_set)
                coupled.append(np.einsum("nda,nd->na", a, b))
    if coupled and loose.any():
        share = np.divide(1.0, of_sets, where=loose & (of_sets > 0), out=np.zeros(len(of_sets)))
        at = (np.concatenate(number), np.concatenate(column))
        values = np.concatenate(coupled)
        shape = (len(asked), len(of_sets))
        by_axis = [csr_array((values[:, axis], at), shape=shape) for axis in range(3)]
        for i, j in np.ndindex(3, 3):
            taken[:, i, j] = by_axis[i].multiply(by_axis[j]) @ share
    return normals, taken


def _is_singular(normal: Array, taken: Array, free: Mask) -> bool:
    """Return whether N less its loss ``taken`` (3, 3) is singular in the free coordinates."""
    scale = np.sqrt(np.diag(normal)[free])
    if np.any(scale == 0.0):
        return True
    own = (normal - taken)[np.ix_(free, free)] / np.outer(scale, scale)
    return bool(np.linalg.eigvalsh(own)[0] < NULL)
