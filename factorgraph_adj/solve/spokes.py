"""Spokes: points of the first layer and the nodes that observations other than images join them to.

A spoke is a pair of a point and a node, such as the frame of an instrument that sights the point.
All observations of a pair share it, so that W of a spoke is a sum over them; in all else a spoke is
what a ray is, see `factorgraph_adj.solve.rays`. Which observations belong to which spokes is found
once for a network.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..graph.equations import Equations
from ..graph.image_chunks import PointSums
from ..types import Array, Index
from .elimination import first_point
from .linear import LinearisedEquations
from .node_sums import Slot, slots_of
from .nodes import Nodes

AT_ONCE = 20_000
"""Largest number of observations whose products are in memory at once."""


@dataclass(frozen=True)
class Spokes:
    """Spokes in the order of their nodes; the interface of `factorgraph_adj.solve.rays.RayPart`."""

    rows: slice
    """Numbers of the spokes among all rays and spokes."""
    runs: tuple[tuple[int, int, int], ...]
    """Node, first spoke and end of each run of spokes of one node."""
    points: Index
    """Number of the point of each spoke in the first layer, (m,)."""
    sums: PointSums
    """Sums over the spokes of the same point."""
    camera: int = -1
    """No calibration is shared."""


@dataclass(frozen=True)
class SpokeRows:
    """Observations of one block that join points of the first layer with nodes."""

    place: int
    """Place of the block in the network."""
    target: int
    """Place of the point among the variables."""
    rows: Index
    """Numbers of the observations in the block, (m,)."""
    points: Index
    """Number of the point of each in the first layer, (m,)."""
    of_points: csr_array
    """One for each observation in the row of its point, (p, m)."""
    slots: tuple[Slot, ...]
    """Their nodes."""
    spokes: tuple[Index, ...]
    """Number of the spoke of each observation, for each slot, −1 where it is none, (m,)."""
    of_spokes: tuple[csr_array, ...]
    """One for each observation in the row of its spoke, for each slot, (n_spokes, m)."""
    border: tuple[tuple[int, Index], ...]
    """Place of each variable, and those of its components in the border, (m, k); −1: held."""

    def arrays(self, system: LinearisedEquations) -> tuple[Array, ...]:
        """Return the whitened partials by each variable, (m, d, k)."""
        lb = system.blocks[self.place]
        if len(self.rows) == lb.block.n:
            return lb.a
        return lb.partials(self.rows)

    def border_columns(self, arrays: tuple[Array, ...]) -> list[tuple[Index, Array]]:
        """Return places in the border (m,) and partials (m, d) of every column there."""
        return [
            (places[:, c], arrays[j][:, :, c])
            for j, places in self.border
            if len(arrays[j])
            for c in range(arrays[j].shape[2])
        ]


def find_spokes(
    equations: Equations, nodes: Nodes, first: int
) -> tuple[Spokes | None, list[SpokeRows], Index]:
    """Find the spokes of a network.

    Args:
        equations: the network.
        nodes: places of the unknowns in the reduced system.
        first: number of rays, which come before the spokes.

    Returns:
        The spokes, none if there are none; the observations of points of the first layer that are
        no images; and the node of each spoke, (n_spokes,).
    """
    layers = nodes.layers
    local = np.cumsum(layers.reduced) - 1
    n_points, n_nodes = int(layers.reduced.sum()), max(nodes.n, 1)
    found: list[tuple[int, int, Index, Index, tuple[Slot, ...], tuple[tuple[int, Index], ...]]] = []
    for place, block in enumerate(equations.blocks):
        target = first_point(block)
        if block.lens is not None or target is None or len(block.variables) == 1:
            continue
        number = block.variables[target][1]
        rows = np.flatnonzero(layers.reduced[number])
        if len(rows):
            variables = tuple((kind, index[rows]) for kind, index in block.variables)
            slots, border = slots_of(nodes, variables)
            found.append((place, target, rows, local[number[rows]], slots, border))
    codes = [
        np.where(slot.node >= 0, slot.node * n_points + points, -1)
        for _, _, _, points, slots, _ in found
        for slot in slots
    ]
    every = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *codes]))
    every = every[every >= 0]
    made = []
    for place, target, rows, points, slots, border in found:
        own, incidences = [], []
        for slot in slots:
            on = slot.node >= 0
            spoke = np.searchsorted(every, slot.node * n_points + points)
            spoke = np.where(on, np.minimum(spoke, len(every) - 1), -1)
            own.append(spoke)
            at = np.flatnonzero(on)
            incidences.append(
                csr_array((np.ones(len(at)), (spoke[at], at)), shape=(len(every), len(rows)))
            )
        shape = (n_points, len(rows))
        of_points = csr_array((np.ones(len(rows)), (points, np.arange(len(rows)))), shape=shape)
        made.append(
            SpokeRows(
                *(place, target, rows, points, of_points, slots),
                *(tuple(own), tuple(incidences), border),
            )
        )
    node, point = np.divmod(every, max(n_points, 1))
    if not len(every):
        return None, made, node
    starts = np.flatnonzero(np.diff(node, prepend=-1))
    stops = np.append(starts[1:], len(node))
    runs = tuple(zip(node[starts].tolist(), starts.tolist(), stops.tolist(), strict=True))
    sums = PointSums.of(point, n_points, np.ones(len(point)))
    assert n_nodes > int(node.max())
    return Spokes(slice(first, first + len(every)), runs, point, sums), made, node


def add_to_points(rows: SpokeRows, arrays: tuple[Array, ...], out: Array, cross: Array) -> None:
    """Add JᵀJ to the normal matrices of points, and JᵀA of the border to their cross products.

    Args:
        rows: the observations.
        arrays: their partials.
        out: elements of the normal matrices, (6, p), see `point_cholesky`.
        cross: cross products with the border, (p, 3, border).
    """
    j = arrays[rows.target]
    products = np.stack(
        [np.einsum("md,md->m", j[:, :, a], j[:, :, b]) for a in range(3) for b in range(a, 3)], 1
    )
    out += (rows.of_points @ products).T
    for at, a in rows.border_columns(arrays):
        value = np.einsum("mda,md->ma", j, a)
        on = np.flatnonzero(at >= 0)
        for axis in range(3):
            np.add.at(cross[:, axis], (rows.points[on], at[on]), value[on, axis])


def add_to_spokes(rows: SpokeRows, arrays: tuple[Array, ...], u: Array, w: Array) -> None:
    """Add W = L⁻¹JᵀA of the observations to that of their spokes.

    Args:
        rows: the observations.
        arrays: their partials.
        u: L⁻¹Jᵀ, (3, d, m).
        w: W of all spokes, (n_spokes, 3, width).
    """
    width = w.shape[2]
    across = np.ascontiguousarray(u.transpose(2, 0, 1))
    for slot, incidence in zip(rows.slots, rows.of_spokes, strict=True):
        products = across @ slot.partials(arrays, width)
        w += (incidence @ products.reshape(len(products), 3 * width)).reshape(w.shape)
