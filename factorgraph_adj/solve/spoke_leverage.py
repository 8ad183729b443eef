"""Leverages of the observations of points of the first layer that are no images.

As `factorgraph_adj.solve.ray_leverage` has them, with U = L⁻¹Jₚᵀ, Z = M A_bᵀ and K = I + W Σ Wᵀ:

    Q_p Aᵀ = L⁻ᵀ (K U − Z),   H = A_b Σ A_bᵀ − UᵀZ − ZᵀU + UᵀK U.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..types import Array, Index
from .fronts import BlockMatrix
from .point_cholesky import PointCholesky, square
from .reduction import RayCovariances, ReducedPoints
from .spokes import AT_ONCE, SpokeRows


class SpokeLeverage(NamedTuple):
    """Leverages of some observations of a block."""

    place: int
    """Place of the block in the network."""
    rows: Index
    """Numbers of the observations in the block, (m,)."""
    hat: Array
    """H = A Q Aᵀ, (m, d, d)."""
    others: Array
    """A_b Σ A_bᵀ, the part of all unknowns but the point, (m, d, d)."""
    own: Array
    """Q_p Aᵀ for the coordinates of the point of the first layer, (m, 3, d)."""


def spoke_leverages(
    points: ReducedPoints, joint: RayCovariances, inverse: BlockMatrix
) -> Iterator[SpokeLeverage]:
    """Iterate over the leverages of the observations, some of a block at once.

    Args:
        points: the first layer.
        joint: its joint covariances with the other layers.
        inverse: covariances of the other layers.
    """
    rays = points.rays
    of_spokes = joint.rays[slice(0, 0) if rays.spokes is None else rays.spokes.rows]
    for sights in rays.spoke_rows:
        arrays = sights.arrays(points.system)
        for start in range(0, len(sights.rows), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            some = tuple(a[part] if len(a) else a for a in arrays)
            a, sigma, m = _around(sights, part, some, joint, inverse, of_spokes)
            at = sights.points[part]
            u = points.cholesky.lower(some[sights.target].transpose(2, 1, 0), at)
            u = np.ascontiguousarray(u.transpose(2, 0, 1))
            across = a.transpose(0, 2, 1)
            others = a @ (sigma @ across)
            z = m @ across
            ku = square(np.take(joint.inner, at, axis=1)) @ u - z
            hat = others + u.transpose(0, 2, 1) @ ku - z.transpose(0, 2, 1) @ u
            own = points.cholesky.upper(np.ascontiguousarray(ku.transpose(1, 2, 0)), at)
            rows = sights.rows[part]
            yield SpokeLeverage(sights.place, rows, hat, others, own.transpose(2, 0, 1))


def _around(
    sights: SpokeRows,
    part: slice,
    arrays: tuple[Array, ...],
    joint: RayCovariances,
    inverse: BlockMatrix,
    of_spokes: Array,
) -> tuple[Array, Array, Array]:
    """Return A_b (m, d, c), Σ (m, c, c) and M (m, 3, c) over nodes and border of observations."""
    w, n_nodes = inverse.pattern.width, inverse.pattern.n
    at = sights.points[part]
    partials: list[Array] = []
    products: list[Array] = []
    places: list[Index] = []
    for slot, spokes in zip(sights.slots, sights.spokes, strict=True):
        node, spoke = slot.node[part], spokes[part]
        partials.append(slot.some(part).partials(arrays, w))
        products.append(np.where((spoke >= 0)[:, None, None], of_spokes[spoke], 0.0))
        places.append(np.where(node[:, None] >= 0, w * node[:, None] + np.arange(w), -1))
    for j, of_variable in sights.border:
        for c in range(arrays[j].shape[2] if len(arrays[j]) else 0):
            column = of_variable[part, c]
            partials.append(arrays[j][:, :, c : c + 1])
            products.append(joint.shared[at, :, column][:, :, None] * (column >= 0)[:, None, None])
            places.append(np.where(column >= 0, n_nodes * w + column, -1)[:, None])
    d = arrays[sights.target].shape[1]
    if not partials:
        return np.zeros((len(at), d, 0)), np.zeros((len(at), 0, 0)), np.zeros((len(at), 3, 0))
    a, m = np.concatenate(partials, axis=2), np.concatenate(products, axis=2)
    if len(partials) == 1 and len(sights.slots) == 1:
        node = sights.slots[0].node[part]
        sigma = inverse.diagonal[node] * (node >= 0)[:, None, None]
        return a, sigma, m
    place = np.concatenate(places, axis=1)
    size = place.shape[1]
    one, other = np.triu_indices(size)
    has = (place[:, one] >= 0) & (place[:, other] >= 0)
    sigma = np.zeros((len(at), size, size))
    elements = np.zeros(has.shape)
    elements[has] = inverse.at(place[:, one][has], place[:, other][has])
    sigma[:, one, other] = sigma[:, other, one] = elements
    return a, sigma, m


def spoke_hats(points: ReducedPoints, alone: PointCholesky) -> Iterator[tuple[int, Index, Array]]:
    """Iterate over place of the block, rows and JₚN⁻¹Jₚᵀ (m, d, d) of the observations.

    Args:
        points: the first layer.
        alone: factors of the normal matrices N of the points.
    """
    for sights in points.rays.spoke_rows:
        j = sights.arrays(points.system)[sights.target]
        u = alone.lower(j.transpose(2, 1, 0), sights.points)
        yield sights.place, sights.rows, np.einsum("kim,kjm->mij", u, u)
