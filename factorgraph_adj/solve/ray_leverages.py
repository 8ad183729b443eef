"""Leverages of the rays, sights and coordinates of points of the first layer.

With U = L⁻¹Jₚᵀ of an observation's point, and M = W Σ of the point (`ReducedPoints.joint`),

    Q_p Aᵀ = L⁻ᵀ (K U − Z),   H = A_b Σ A_bᵀ − UᵀZ − ZᵀU + UᵀK U,   K = I + W Σ Wᵀ,   Z = M A_bᵀ,

where A_b are the partials by the unknowns of the reduced system.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..types import Array, Index
from .block_matrix import BlockMatrix
from .linearised_rays import POINT_PARTIALS, PointCholesky, symmetric_matrices
from .node_rows import SpokeRows
from .point_elimination import RayCovariances, ReducedPoints
from .point_rays import RayPart

SPOKE_ROWS_AT_ONCE = 20_000
"""Largest number of observations whose products are in memory at once."""


class PartLeverage(NamedTuple):
    """Leverages of some observations of a block."""

    place: int
    """Place of the block in the network."""
    rows: Index | slice
    """Numbers of the observations in the block."""
    hat: Array
    """H = A Q Aᵀ, (m, d, d)."""
    others: Array
    """A_1 Σ A_1ᵀ, the part of all unknowns but points, (m, d, d)."""
    own: Array
    """Q_p Aᵀ for the coordinates of each observation's points, (m, 3 × points, d)."""


def first_layer_leverages(
    points: ReducedPoints, joint: RayCovariances, inverse: BlockMatrix
) -> Iterator[PartLeverage]:
    """Iterate over the leverages of all observations of points of the first layer.

    Args:
        points: the first layer.
        joint: its joint covariances with the other layers.
        inverse: covariances of the other layers.
    """
    yield from _ray_leverages(points, joint, inverse)
    yield from spoke_leverages(points, joint, inverse)


def _ray_leverages(
    points: ReducedPoints, joint: RayCovariances, inverse: BlockMatrix
) -> Iterator[PartLeverage]:
    """Iterate over the leverages of the rays of every part; see `first_layer_leverages`."""
    rays, system = points.rays, points.system
    for part in rays.photo_parts:
        a = part.partials(system)
        m = a.shape[2]
        own = part.own(system)
        width = own if part.camera >= 0 else len(a)
        of_rays = np.ascontiguousarray(joint.rays[part.rows].transpose(1, 2, 0))
        z = np.empty((3, 2, m))
        for axis in range(3):
            np.einsum("km,krm->rm", of_rays[axis, :width], a[:width], out=z[axis])
        side = slice(0, 0)
        if part.camera >= 0:
            side = rays.cameras[part.camera].side
            of_points = np.take(joint.shared[:, :, side], part.points, axis=0)
            for axis in range(3):
                z[axis] += np.einsum("mk,krm->rm", of_points[:, axis], a[own:])
        others = _others(part, a, inverse, width, side)
        u = points.cholesky.lower(-a[POINT_PARTIALS], part.points)
        k = np.take(joint.inner, part.points, axis=1)
        ku = np.stack(
            [
                k[0] * u[0] + k[1] * u[1] + k[2] * u[2],
                k[1] * u[0] + k[3] * u[1] + k[4] * u[2],
                k[2] * u[0] + k[4] * u[1] + k[5] * u[2],
            ]
        )
        ku -= z
        hat = others.copy()
        for i in range(2):
            for j in range(2):
                value = u[:, i] * ku[:, j] - z[:, i] * u[:, j]
                hat[:, i, j] += value[0] + value[1] + value[2]
        by_points = points.cholesky.upper(ku, part.points).transpose(2, 0, 1)
        yield PartLeverage(part.place, part.in_block, hat, others, by_points)


def _others(part: RayPart, a: Array, inverse: BlockMatrix, width: int, side: slice) -> Array:
    """Return A_c Σ A_cᵀ of the rays of a part, (m, 2, 2)."""
    out = np.empty((a.shape[2], 2, 2))
    size = side.stop - side.start
    sigma = np.empty((width + size,) * 2)
    sigma[width:, width:] = inverse.corner[side, side]
    for node, start, stop in part.runs:
        sigma[:width, :width] = inverse.diagonal[node, :width, :width]
        sigma[:width, width:] = inverse.side[node, :width, side]
        sigma[width:, :width] = sigma[:width, width:].T
        x, y = a[: width + size, 0, start:stop], a[: width + size, 1, start:stop]
        sx, sy = sigma @ x, sigma @ y
        out[start:stop, 0, 0] = np.einsum("km,km->m", x, sx)
        out[start:stop, 1, 0] = out[start:stop, 0, 1] = np.einsum("km,km->m", x, sy)
        out[start:stop, 1, 1] = np.einsum("km,km->m", y, sy)
    return out


def single_point_hats(
    points: ReducedPoints, alone: PointCholesky
) -> Iterator[tuple[int, Index | slice, Array]]:
    """Iterate over place of the block, rows and JₚN⁻¹Jₚᵀ (m, d, d) of all observations of points.

    Args:
        points: the first layer.
        alone: factors of the normal matrices N of the points.
    """
    for part in points.rays.photo_parts:
        u = alone.lower(part.partials(points.system)[POINT_PARTIALS], part.points)
        hat = np.empty((u.shape[2], 2, 2))
        for i in range(2):
            for j in range(i, 2):
                hat[:, i, j] = hat[:, j, i] = np.einsum("km,km->m", u[:, i], u[:, j])
        yield part.place, part.in_block, hat
    for sights in points.rays.spoke_rows:
        of_target = sights.arrays(points.system)[sights.target]
        u = alone.lower(of_target.transpose(2, 1, 0), sights.points)
        yield sights.place, sights.rows, np.einsum("kim,kjm->mij", u, u)


def spoke_leverages(
    points: ReducedPoints, joint: RayCovariances, inverse: BlockMatrix
) -> Iterator[PartLeverage]:
    """Iterate over the leverages of sights and coordinates; see `first_layer_leverages`."""
    rays = points.rays
    of_spokes = joint.rays[slice(0, 0) if rays.spokes is None else rays.spokes.rows]
    for sights in rays.spoke_rows:
        arrays = sights.arrays(points.system)
        for start in range(0, len(sights.rows), SPOKE_ROWS_AT_ONCE):
            part = slice(start, start + SPOKE_ROWS_AT_ONCE)
            some = tuple(a[part] if len(a) else a for a in arrays)
            a, sigma, m = _around(sights, part, some, joint, inverse, of_spokes)
            at = sights.points[part]
            u = points.cholesky.lower(some[sights.target].transpose(2, 1, 0), at)
            across = a.transpose(0, 2, 1)
            along = sigma @ across
            z = m @ across
            k = symmetric_matrices(np.take(joint.inner, at, axis=1))
            ku = np.einsum("mij,jdm->idm", k, u) - z.transpose(1, 2, 0)
            hat = a @ along + np.einsum("kim,kjm->mij", u, ku)
            u = np.ascontiguousarray(u.transpose(2, 0, 1))
            hat -= z.transpose(0, 2, 1) @ u
            of_point = points.cholesky.upper(ku, at)
            variables = points.system.blocks[sights.place].block.variables
            stations = [j for j, (kind, _) in enumerate(variables) if kind == "point"]
            moved = along - m.transpose(0, 2, 1) @ u  # Q_b Aᵀ
            own = [
                of_point.transpose(2, 0, 1)
                if j == sights.target
                else _of_variable(sights, part, j, moved, inverse.pattern.width)
                for j in stations
            ]
            a1 = _without_points(sights, part, some, a, stations, inverse.pattern.width)
            yield PartLeverage(
                sights.place,
                sights.rows[part],
                hat,
                a1 @ (sigma @ a1.transpose(0, 2, 1)),
                np.concatenate(own, axis=1),
            )


def _of_variable(sights: SpokeRows, part: slice, variable: int, moved: Array, width: int) -> Array:
    """Return the rows (m, 3, d) of a variable among those of all nodes; zero if it is held."""
    n, _, d = moved.shape
    out = np.zeros((n, 3, d))
    for number, slot in enumerate(sights.slots):
        for j, position in slot.variables:
            if j == variable:
                here = position[part]
                for c in range(3):
                    on = np.flatnonzero(here[:, c] >= 0)
                    out[on, c] = moved[on, number * width + here[on, c]]
    return out


def _without_points(
    sights: SpokeRows,
    part: slice,
    arrays: tuple[Array, ...],
    a: Array,
    stations: list[int],
    width: int,
) -> Array:
    """Return A_b with zeros for the coordinates of points, (m, d, c)."""
    held = [j for slot in sights.slots for j, _ in slot.variables if j in stations]
    if not held:
        return a
    out = a.copy()
    for number, slot in enumerate(sights.slots):
        own = slot.without(stations).some(part).partials(arrays, width)
        out[:, :, number * width : (number + 1) * width] = own
    return out


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
