"""Observations other than rays: sums by nodes of the reduced system; spokes of first-layer points.

Each observation touches a few nodes, and columns of the border. Which nodes, and where the partials
by each variable are in them, is found once for a network (`NodeRows`); a linearisation then sums
the products of whole blocks at once (`NodeRows.add_to`).

A spoke is a pair of a point of the first layer and a node, such as the frame of an instrument that
sights the point. All observations of a pair share it, so that W of a spoke is a sum over them; in
all else a spoke is what a ray is, see `factorgraph_adj.solve.point_rays`. Which observations belong
to which spokes is found once for a network.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.image_blocks import PointSums
from ..types import Array, Index, Mask
from .block_matrix import BlockMatrix
from .elimination_layers import first_point, rows_outside_first_layer
from .linearised_equations import LinearBlock, LinearisedEquations
from .reduced_system import Nodes


@dataclass(frozen=True)
class NodeSlot:
    """One node of each observation of a block, with the variables in it."""

    node: Index
    """Node of each observation, −1 where it is none, (m,)."""
    variables: tuple[tuple[int, Index], ...]
    """Place of the variable in the block, and the position of its components in the node, (m, k);
    −1: held."""

    def some(self, part: slice) -> NodeSlot:
        """Return the nodes of some of the observations."""
        return NodeSlot(
            self.node[part], tuple((j, position[part]) for j, position in self.variables)
        )

    def without(self, variables: Collection[int]) -> NodeSlot:
        """Return the same nodes without some of their variables."""
        return NodeSlot(self.node, tuple(v for v in self.variables if v[0] not in variables))

    def partials(self, arrays: tuple[Array, ...], width: int) -> Array:
        """Return the partials by all columns of the node, (m, d, width)."""
        d = next(a.shape[1] for a in arrays if len(a))
        out = np.zeros((len(self.node), d, width))
        rows = np.arange(len(self.node))
        for j, position in self.variables:
            if not len(arrays[j]):
                continue
            for c in range(arrays[j].shape[2]):
                low, high = int(position[:, c].min()), int(position[:, c].max())
                if low == high:  # the usual case: all are at the same position
                    if low >= 0:
                        out[:, :, low] = arrays[j][:, :, c]
                    continue
                on = position[:, c] >= 0
                out[rows[on], :, position[on, c]] = arrays[j][on, :, c]
        return out


def node_slots_of(
    nodes: Nodes, block: Block, rows: Index
) -> tuple[tuple[NodeSlot, ...], tuple[tuple[int, Index], ...]]:
    """Return the nodes of observations, and the places of their variables in the border.

    Args:
        nodes: places of the unknowns; variables without a place are left out.
        block: a block of observations.
        rows: numbers of the observations in it, (m,).
    """
    inner = nodes.n * nodes.width
    slots: list[tuple[Index, list[tuple[int, Index]]]] = []
    border: list[tuple[int, Index]] = []
    for j, (kind, index) in enumerate(block.variables):
        places = nodes.places(kind, index[rows])
        at_border = places >= inner
        if at_border.any():
            border.append((j, np.where(at_border, places - inner, -1)))
        here = (places >= 0) & ~at_border
        if not here.any():
            continue
        node = np.where(here, places // nodes.width, -1).max(axis=1)
        position = np.where(here, places % nodes.width, -1)
        for own, inside in slots:
            if np.array_equal(own, node):
                inside.append((j, position))
                break
        else:
            slots.append((node, [(j, position)]))
    return tuple(NodeSlot(node, tuple(inside)) for node, inside in slots), tuple(border)


@dataclass(frozen=True)
class NodePairSums:
    """Sums over the observations of a block that touch the same pair of nodes."""

    slots: tuple[int, int]
    """The two slots."""
    rows: Index
    """Observations that touch both, (m,)."""
    swapped: Mask
    """Whether the node of the first slot comes second, (m,)."""
    codes: Index
    """Pairs of nodes, n a + b each; a = b for a single node, (q,)."""
    pair: Index
    """Place of the pair of each observation in ``codes``, (m,)."""

    @cached_property
    def incidence(self) -> csr_array:
        """One for each observation in the row of its pair, (q, m)."""
        m = len(self.rows)
        return csr_array((np.ones(m), (self.pair, np.arange(m))), shape=(len(self.codes), m))


@dataclass(frozen=True)
class BlockRows:
    """Observations of one block, with the nodes and the columns of the border that they touch."""

    place: int
    """Place of the block in the network."""
    rows: Index
    """Numbers of the observations in the block, (m,)."""
    slots: tuple[NodeSlot, ...]
    """Their nodes."""
    border: tuple[tuple[int, Index], ...]
    """Place of each variable in the block, and those of its components in the border, (m, k); −1:
    held."""

    def arrays(self, system: LinearisedEquations) -> tuple[Array, ...]:
        """Return the whitened partials by each variable, (m, d, k)."""
        lb = system.blocks[self.place]
        if len(self.rows) == lb.block.n and isinstance(lb, LinearBlock):
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


@dataclass(frozen=True)
class PairRows(BlockRows):
    """Observations whose products are summed in the blocks of the reduced system."""

    products: tuple[NodePairSums, ...]
    """Pairs of nodes that they join, single nodes among them."""


class NodeRows:
    """Observations of unknowns outside the first layer; a network makes them once."""

    def __init__(self, equations: Equations, nodes: Nodes) -> None:
        """Find the places of all variables."""
        self.nodes = nodes
        self.blocks: list[PairRows] = []
        for place, block in enumerate(equations.blocks):
            rows = rows_outside_first_layer(equations, nodes.layers, place)
            if len(rows):
                slots, border = node_slots_of(self.nodes, block, rows)
                products = tuple(self._products(slots))
                self.blocks.append(PairRows(place, rows, slots, border, products))

    def _products(self, slots: tuple[NodeSlot, ...]) -> list[NodePairSums]:
        out = []
        n = max(self.nodes.n, 1)
        for s, one in enumerate(slots):
            for t, other in enumerate(slots[: s + 1]):
                rows = np.flatnonzero((one.node >= 0) & (other.node >= 0))
                if not len(rows):
                    continue
                a, b = one.node[rows], other.node[rows]
                swapped = a > b
                codes, pair = np.unique(
                    np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True
                )
                out.append(NodePairSums((s, t), rows, swapped, codes.astype(np.intp), pair))
        return out

    @property
    def pair_codes(self) -> Index:
        """Pairs of different nodes that observations join, n a + b each, (p,)."""
        n = max(self.nodes.n, 1)
        nothing = np.zeros(0, dtype=np.intp)
        codes = np.unique(
            np.concatenate([nothing, *(p.codes for b in self.blocks for p in b.products)])
        )
        return np.asarray(codes[codes // n != codes % n], dtype=np.intp)

    def add_to(self, matrix: BlockMatrix, system: LinearisedEquations) -> None:
        """Add AᵀA of all observations to the reduced system, in place."""
        for block in self.blocks:
            self._add(matrix, block.arrays(system), block)

    def _add(self, matrix: BlockMatrix, arrays: tuple[Array, ...], block: PairRows) -> None:
        if not any(len(a) for a in arrays):
            return
        n, w = max(self.nodes.n, 1), self.nodes.width
        of_slot = [slot.partials(arrays, w) for slot in block.slots]
        for product in block.products:
            s, t = product.slots
            one, other = of_slot[s], of_slot[t]
            if len(product.rows) < len(one):
                one, other = one[product.rows], other[product.rows]
            if s != t and product.swapped.any():
                swap = product.swapped[:, None, None]
                one, other = np.where(swap, other, one), np.where(swap, one, other)
            squares = (one.transpose(0, 2, 1) @ other).reshape(len(one), w * w)
            sums = (product.incidence @ squares).reshape(-1, w, w)
            first, second = np.divmod(product.codes, n)
            same = first == second
            if same.any():
                own = sums[same]
                matrix.diagonal[first[same]] += own if s == t else own + own.transpose(0, 2, 1)
            if not same.all():
                matrix.pairs[matrix.find(first[~same], second[~same])] += sums[~same]
        self._add_border(matrix, arrays, block, of_slot)

    def _add_border(
        self, matrix: BlockMatrix, arrays: tuple[Array, ...], block: PairRows, of_slot: list[Array]
    ) -> None:
        columns = block.border_columns(arrays)
        for number, (at, a) in enumerate(columns):
            on = np.flatnonzero(at >= 0)
            for slot, partials in zip(block.slots, of_slot, strict=True):
                both = on[slot.node[on] >= 0]
                value = np.einsum("mdi,md->mi", partials[both], a[both])
                for i in range(value.shape[1]):
                    np.add.at(matrix.side[:, i], (slot.node[both], at[both]), value[:, i])
            for other_at, other in columns[: number + 1]:
                both = on[other_at[on] >= 0]
                value = np.sum(a[both] * other[both], axis=1)
                np.add.at(matrix.corner, (at[both], other_at[both]), value)
                if other is not a:
                    np.add.at(matrix.corner, (other_at[both], at[both]), value)


@dataclass(frozen=True)
class Spokes:
    """Pairs of a point of the first layer and a node, in the order of their nodes."""

    rows: slice
    """Numbers of the spokes among all rays and spokes."""
    runs: tuple[tuple[int, int, int], ...]
    """Node, first spoke and end of each run of spokes of one node."""
    points: Index
    """Number of the point of each spoke in the first layer, (m,)."""
    sums: PointSums
    """Sums over the spokes of the same point."""


@dataclass(frozen=True)
class SpokeRows(BlockRows):
    """Observations of points of the first layer that are no images.

    Observed coordinates of such points are among them: they touch no node.
    """

    target: int
    """Place of the point among the variables."""
    points: Index
    """Number of the point of each in the first layer, (m,)."""
    of_points: csr_array
    """One for each observation in the row of its point, (p, m)."""
    spokes: tuple[Index, ...]
    """Number of the spoke of each observation, for each slot, −1 where it is none, (m,)."""
    of_spokes: tuple[csr_array, ...]
    """One for each observation in the row of its spoke, for each slot, (n_spokes, m)."""


def find_spokes(
    equations: Equations, nodes: Nodes, first: int
) -> tuple[Spokes | None, list[SpokeRows], Index]:
    """Find the spokes of a network.

    Args:
        equations: the network.
        nodes: places of the unknowns in the reduced system.
        first: number of rays, which come before the spokes.

    Returns:
        The spokes, None if there are none; the observations of points of the first layer that are
        no images; and the node of each spoke, (n_spokes,).
    """
    layers = nodes.layers
    local = np.cumsum(layers.reduced) - 1
    n_points = int(layers.reduced.sum())
    found: list[tuple[BlockRows, int, Index]] = []
    for place, block in enumerate(equations.blocks):
        target = first_point(block)
        if block.lens is not None or target is None:
            continue
        number = block.variables[target][1]
        rows = np.flatnonzero(layers.reduced[number])
        if len(rows):
            sights = BlockRows(place, rows, *node_slots_of(nodes, block, rows))
            found.append((sights, target, local[number[rows]]))
    codes = [
        np.where(slot.node >= 0, slot.node * n_points + points, -1)
        for sights, _, points in found
        for slot in sights.slots
    ]
    every = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *codes]))
    every = every[every >= 0]
    made = []
    for sights, target, points in found:
        m = len(sights.rows)
        own, incidences = [], []
        for slot in sights.slots:
            on = slot.node >= 0
            spoke = np.searchsorted(every, slot.node * n_points + points)
            spoke = np.where(on, np.minimum(spoke, len(every) - 1), -1)
            own.append(spoke)
            at = np.flatnonzero(on)
            incidences.append(csr_array((np.ones(len(at)), (spoke[at], at)), shape=(len(every), m)))
        of_points = csr_array((np.ones(m), (points, np.arange(m))), shape=(n_points, m))
        made.append(
            SpokeRows(
                sights.place,
                sights.rows,
                sights.slots,
                sights.border,
                target,
                points,
                of_points,
                tuple(own),
                tuple(incidences),
            )
        )
    node, point = np.divmod(every, max(n_points, 1))
    if not len(every):
        return None, made, node
    starts = np.flatnonzero(np.diff(node, prepend=-1))
    stops = np.append(starts[1:], len(node))
    runs = tuple(zip(node[starts].tolist(), starts.tolist(), stops.tolist(), strict=True))
    sums = PointSums.of(point, n_points, np.ones(len(point)))
    return Spokes(slice(first, first + len(every)), runs, point, sums), made, node


def add_to_points(rows: SpokeRows, arrays: tuple[Array, ...], out: Array, cross: Array) -> None:
    """Add JᵀJ to the normal matrices of points, and JᵀA of the border to their cross products.

    Args:
        rows: the observations.
        arrays: their partials.
        out: elements of the normal matrices, (6, p), see `linearised_rays`.
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
