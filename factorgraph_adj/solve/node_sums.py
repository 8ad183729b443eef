"""Normal equations of the terrestrial side in the blocks of the reduced system.

Each observation touches a few nodes, and columns of the border. Which nodes, and where the partials
by each variable stand in them, is found once for a network (`NodeRows`); a linearisation then sums
the products of whole blocks at once (`NodeRows.add_to`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..graph.equations import Equations
from ..models.variables import VariableKind
from ..types import Array, Index, Mask
from .elimination import outside
from .fronts import BlockMatrix
from .linear import LinearisedEquations
from .linear_block import LinearBlock
from .linear_rays import LinearRays
from .nodes import Nodes


@dataclass(frozen=True)
class Slot:
    """One node of each observation of a block, with the variables that stand in it."""

    node: Index
    """Node of each observation, −1 where it is none, (m,)."""
    variables: tuple[tuple[int, Index], ...]
    """Place of the variable in the block, and the position of its components in the node, (m, k);
    −1: held."""

    def some(self, part: slice) -> Slot:
        """Return the nodes of some of the observations."""
        return Slot(self.node[part], tuple((j, position[part]) for j, position in self.variables))

    def without(self, variables: Collection[int]) -> Slot:
        """Return the same nodes without some of the variables that stand in them."""
        return Slot(self.node, tuple(v for v in self.variables if v[0] not in variables))

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
                if low == high:  # the usual case: all stand at the same position
                    if low >= 0:
                        out[:, :, low] = arrays[j][:, :, c]
                    continue
                on = position[:, c] >= 0
                out[rows[on], :, position[on, c]] = arrays[j][on, :, c]
        return out


def slots_of(
    nodes: Nodes, variables: tuple[tuple[VariableKind, Index], ...]
) -> tuple[tuple[Slot, ...], tuple[tuple[int, Index], ...]]:
    """Return the nodes of observations, and the places of their variables in the border.

    Args:
        nodes: places of the unknowns.
        variables: kind and numbers (m,) of each variable; those without a place are left out.
    """
    inner = nodes.n * nodes.width
    slots: list[tuple[Index, list[tuple[int, Index]]]] = []
    border: list[tuple[int, Index]] = []
    for j, (kind, index) in enumerate(variables):
        places = nodes.places(kind, index)
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
    return tuple(Slot(node, tuple(inside)) for node, inside in slots), tuple(border)


@dataclass(frozen=True)
class Product:
    """Sums over the observations of a block that touch the same pair of nodes."""

    slots: tuple[int, int]
    """The two slots."""
    rows: Index
    """Observations that touch both, (m,)."""
    swapped: Mask
    """Whether the node of the first slot comes second, (m,)."""
    codes: Index
    """Pairs of nodes, n a + b each; a = b for a single node, (q,)."""
    incidence: csr_array
    """One for each observation in the row of its pair, (q, m)."""


@dataclass(frozen=True)
class BlockRows:
    """The observations of one block."""

    place: int
    """Place of the block in the network."""
    rows: Index
    """Observations that are summed here, (m,)."""
    slots: tuple[Slot, ...]
    """Their nodes."""
    border: tuple[tuple[int, Index], ...]
    """Place of each variable in the block, and those of its components in the border, (m, k)."""
    products: tuple[Product, ...]
    """Pairs of nodes that they join, single nodes among them."""


class NodeRows:
    """Observations of unknowns outside the first layer; a network makes them once."""

    def __init__(self, equations: Equations, nodes: Nodes) -> None:
        """Find the places of all variables."""
        self.nodes = nodes
        self.blocks: list[BlockRows] = []
        for place, block in enumerate(equations.blocks):
            rows = outside(equations, nodes.layers, place)
            if len(rows):
                variables = tuple((kind, index[rows]) for kind, index in block.variables)
                self.blocks.append(self._block(place, rows, variables))

    def _block(
        self, place: int, rows: Index, variables: tuple[tuple[VariableKind, Index], ...]
    ) -> BlockRows:
        slots, border = slots_of(self.nodes, variables)
        return BlockRows(place, rows, slots, border, tuple(self._products(slots)))

    def _products(self, slots: tuple[Slot, ...]) -> list[Product]:
        out = []
        n = max(self.nodes.n, 1)
        for s, one in enumerate(slots):
            for t, other in enumerate(slots[: s + 1]):
                rows = np.flatnonzero((one.node >= 0) & (other.node >= 0))
                if not len(rows):
                    continue
                a, b = one.node[rows], other.node[rows]
                swapped = a > b
                codes, row = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True)
                incidence = csr_array(
                    (np.ones(len(rows)), (row, np.arange(len(rows)))),
                    shape=(len(codes), len(rows)),
                )
                out.append(Product((s, t), rows, swapped, codes.astype(np.intp), incidence))
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
            self._add(matrix, system.blocks[block.place], block)

    def _add(self, matrix: BlockMatrix, lb: LinearBlock | LinearRays, block: BlockRows) -> None:
        arrays = lb.partials(block.rows)
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
        self, matrix: BlockMatrix, arrays: tuple[Array, ...], block: BlockRows, of_slot: list[Array]
    ) -> None:
        columns = [
            (places[:, c], arrays[j][:, :, c])
            for j, places in block.border
            if len(arrays[j])
            for c in range(arrays[j].shape[2])
        ]
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
