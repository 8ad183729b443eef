"""Places of the unknowns in the reduced system: nodes of equal width, a border, dense rows.

A photo with the calibration that no other photo has is a node. So is each point outside the first
layer, together with the orientation unknowns and the vertical at the point; further ones, and those
at held points, are nodes of their own, and so are frames, sizes and levels, and drifts and mounts
that few photos have, if there are more than a few. What touches everything is the border:
calibrations that several photos share, distance meters, refraction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..graph.equations import Equations
from ..graph.image_blocks import POSE
from ..graph.variables import State, Variables
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..types import NO_ROWS, Array, Index, Mask
from .block_matrix import BlockMatrix, ElementPlaces
from .elimination_layers import RULE, Layers, first_point
from .nested_dissection import BlockPattern, Front, dissect
from .unnoticed_motions import stations_of


@dataclass(frozen=True)
class ScatteredColumns:
    """Places in the reduced system of the normal matrices of sets of columns."""

    pattern: BlockPattern
    """The blocks of the reduced system."""
    columns: Index
    """The sets, (m, w)."""
    elements: Index
    """Flat numbers of the elements (m, w, w) that have a place, (k,)."""
    places: ElementPlaces
    """Their places."""


class NodePlaces:
    """Nodes of some columns each, padded to equal width, and a border of full columns."""

    n: int = 0
    """Number of nodes."""
    width: int = 1
    """Number of columns of a node."""
    side: int = 0
    """Number of columns of the border."""
    leaves: Index = NO_ROWS
    """Nodes that are fronts of their own."""

    def __init__(self, n_columns: int) -> None:
        """Begin without any place for some number of columns."""
        self._n_columns = n_columns
        self._structure: tuple[Index, BlockPattern, list[Front]] | None = None
        self._scattered: list[ScatteredColumns] = []

    def _settle(
        self, node: Index, position: Index, column: Index, border: Index, kept: Index
    ) -> None:
        """Put columns into their places.

        Args:
            node: node of each place that is not in the border, (k,).
            position: place in its node, (k,).
            column: column at the place, −1 for held ones, (k,).
            border: column at each place of the border, −1 for held ones.
            kept: columns that are not eliminated, (m,).
        """
        self.width = max(int(position.max(initial=-1)) + 1, 1)
        columns = np.full((self.n, self.width), -1, dtype=np.intp)
        columns[node, position] = column
        self.side = len(border)
        self.columns: Index = np.concatenate([columns.ravel(), border])
        """Column at each place, −1 for held components and padding."""
        self.place_of: Index = np.full(self._n_columns, -1, dtype=np.intp)
        """Place of each column, −1 for others."""
        on = self.columns >= 0
        self.place_of[self.columns[on]] = np.flatnonzero(on)
        self.held: Mask = ~on
        """Places that are held or padding."""
        self.kept: Index = self.place_of[kept]
        """Places that are not eliminated, (m,)."""

    def structure(
        self, pairs: Index, positions: Callable[[], Array]
    ) -> tuple[BlockPattern, list[Front]]:
        """Return the blocks of the reduced system and its fronts; they are made once.

        Args:
            pairs: pairs of nodes with a block, the first one smaller, n a + b each, (p,).
            positions: returns where the nodes are, (n, 3), metres.
        """
        if self._structure is not None and self._structure[0] is pairs:
            return self._structure[1:]
        codes = np.unique(pairs)
        if self._structure is None or not np.array_equal(np.unique(self._structure[0]), codes):
            first, second = np.divmod(codes, max(self.n, 1))
            pattern = BlockPattern(self.n, self.width, self.side, first, second)
            self._structure = (pairs, pattern, self._fronts(pattern, positions()))
        return self._structure[1:]

    def _fronts(self, pattern: BlockPattern, positions: Array) -> list[Front]:
        """Return the fronts, with what is kept in the root."""
        last = np.unique(self.kept[self.kept < self.n * self.width] // self.width)
        return dissect(pattern, positions, last, self.leaves)

    def pairs_of(self, columns: Index) -> Index:
        """Return the pairs of nodes that sets of columns (m, w) join, n a + b each."""
        place = self.place_of[columns]
        node = np.where((place >= 0) & (place < self.n * self.width), place // self.width, -1)
        first, second = node[:, :, None], node[:, None, :]
        return np.unique((first * self.n + second)[(first >= 0) & (first < second)])

    def add_normals(self, matrix: BlockMatrix, columns: Index, normal: Array) -> None:
        """Add normal matrices (m, w, w) of sets of columns (m, w), in place.

        Iterations add to the same places: they are found once for each array of columns.
        """
        known = [s for s in self._scattered if s.pattern is matrix.pattern]
        found = next((s for s in known if s.columns is columns), None)
        if found is None:
            place = self.place_of[columns]
            rows, others = np.broadcast_arrays(place[:, :, None], place[:, None, :])
            on = np.flatnonzero((rows >= 0) & (others >= 0))
            places = matrix.places_of(rows.ravel()[on], others.ravel()[on])
            found = ScatteredColumns(matrix.pattern, columns, on, places)
            self._scattered = [*known, found]
        found.places.add(matrix, normal.ravel()[found.elements])

    def add_diagonal(self, matrix: BlockMatrix, extra: Array) -> None:
        """Add terms (n_columns,) to the diagonal, in place."""
        added = np.where(self.held, 0.0, extra[np.maximum(self.columns, 0)])
        n, w = self.n, self.width
        i, j = np.arange(w), np.arange(self.side)
        matrix.diagonal[:, i, i] += added[: n * w].reshape(n, w)
        matrix.corner[j, j] += added[n * w :]

    def hold(self, matrix: BlockMatrix) -> None:
        """Give held places a one on the diagonal and zeros elsewhere, in place."""
        if not self.held.any():
            return
        n, w = self.n, self.width
        free = (~self.held).astype(float)
        nodes, border = free[: n * w].reshape(n, w), free[n * w :]
        first, second = matrix.pattern.first, matrix.pattern.second
        matrix.diagonal *= nodes[:, :, None] * nodes[:, None, :]
        matrix.pairs *= nodes[first][:, :, None] * nodes[second][:, None, :]
        matrix.side *= nodes[:, :, None] * border
        matrix.corner *= border[:, None] * border
        i, j = np.arange(w), np.arange(self.side)
        matrix.diagonal[:, i, i] += 1.0 - nodes
        matrix.corner[j, j] += 1.0 - border


@dataclass(frozen=True)
class SharedCalibration:
    """A calibration that several photos share."""

    number: int
    """Number of the calibration."""
    side: slice
    """Its columns of the border: the parameters that are free in any calibration of its block."""


class Nodes(NodePlaces):
    """The places of unknowns in the reduced system."""

    def __init__(self, equations: Equations, layers: Layers) -> None:
        """Give every unknown of the second layer a place."""
        super().__init__(layers.unknowns.n_columns)
        self.layers = layers
        self._nodes: list[Index] = []
        self._positions: list[Index] = []
        self._columns: list[Index] = []
        self._border: list[Index] = [np.zeros(0, dtype=np.intp)]
        self._stands: list[Index] = []
        self._middles: list[dict[VariableKind, csr_array]] = []
        self._photos(equations)
        self._points(equations)
        self._alone(equations)
        node, position, column = (
            np.concatenate([np.zeros(0, dtype=np.intp), *x])
            for x in (self._nodes, self._positions, self._columns)
        )
        self._settle(node, position, column, np.concatenate(self._border), layers.kept)
        lost = np.flatnonzero(layers.in_fronts & layers.unknowns.free & (self.place_of < 0))
        if len(lost):
            kind, name, component = layers.unknowns.describe(int(lost[0]))
            raise AssertionError(f"{kind} {name!r} {component} has no place: please report this")

    def _put(self, node: Index, position: Index, column: Index) -> None:
        """Put columns at positions in nodes, (k,) each."""
        self._nodes.append(node)
        self._positions.append(position)
        self._columns.append(column)

    def _photos(self, equations: Equations) -> None:
        """Give every photo a node and every shared calibration columns of the border."""
        unknowns = self.layers.unknowns
        pose, lens = unknowns["pose"], unknowns["calibration"]
        free = unknowns.free & self.layers.in_fronts
        photos: dict[int, tuple[int, int] | None] = {}
        motions: dict[int, int] = {}
        on = np.flatnonzero(pose.offset >= 0)  # photos without rays are unknowns too
        photos |= dict.fromkeys(on[self.layers.in_fronts[pose.offset[on]]].tolist())
        for place in equations.rays:
            (_, photo), (_, calibration), _, *moving = equations.blocks[place].variables
            numbers, first = np.unique(photo, return_index=True)
            for _, motion in moving:
                motions |= zip(numbers.tolist(), motion[first].tolist(), strict=True)
            cameras = calibration[first]
            for f, k in zip(numbers.tolist(), cameras.tolist(), strict=True):
                photos[f] = (k, place)
        self.photos: Index = np.array(sorted(photos), dtype=np.intp)
        """Number of the photo of each of the first nodes."""
        self.node: dict[VariableKind, Index] = {"pose": np.full(len(pose.names), -1, dtype=np.intp)}
        """Node of each variable, by kind; −1: none."""
        self.node["pose"][self.photos] = np.arange(len(self.photos))
        self.cameras: list[SharedCalibration] = []
        self.camera_of: dict[int, int] = {}
        """Place of each shared calibration in ``cameras``."""
        self.n = len(self.photos)
        at = 0
        for node, f in enumerate(self.photos.tolist()):
            own = _free_columns(free, int(pose.offset[f]), np.arange(POSE))
            if f in motions:
                moved = int(unknowns["photo_motion"].offset[motions[f]])
                size = int(unknowns["photo_motion"].size[motions[f]])
                own = np.concatenate([own, _free_columns(free, moved, np.arange(size))])
            camera = photos[f]
            if camera is not None:
                k, place = camera
                chunks = equations.rays[place]
                of_lens = _free_columns(free, int(lens.offset[k]), chunks.lens_free)
                if k in chunks.alone:
                    own = np.concatenate([own, of_lens])
                elif k not in self.camera_of:
                    self.camera_of[k] = len(self.cameras)
                    self.cameras.append(SharedCalibration(k, slice(at, at + len(of_lens))))
                    self._border.append(of_lens)
                    at += len(of_lens)
            self._put(np.full(len(own), node), np.arange(len(own)), own)

    def _points(self, equations: Equations) -> None:
        """Give every point a node; other unknowns are there or in the border."""
        unknowns = self.layers.unknowns
        table = unknowns["point"]
        mine = np.flatnonzero((table.offset >= 0) & ~self.layers.reduced)
        mine = mine[self.layers.in_fronts[table.offset[mine]]]
        node = np.full(len(table.names), -1, dtype=np.intp)
        node[mine] = self.n + np.arange(len(mine))
        self.leaves = node[self.layers.leaves]
        self.leaves = self.leaves[self.leaves >= 0]
        self.node["point"] = node
        self.n += len(mine)
        places = table.offset[mine, None] + np.arange(3)
        columns = np.where(unknowns.free[places], places, -1)
        self._put(np.repeat(node[mine], 3), np.tile(np.arange(3), len(mine)), columns.ravel())
        self._stands.append(mine)
        filled = np.full(self.n, 3, dtype=np.intp)
        placed = np.zeros(unknowns.n_columns + 1, dtype=bool)
        placed[np.concatenate(self._columns + self._border)] = True  # −1 is the last one
        for kind in unknowns.placed:
            other = unknowns[kind]
            on = np.flatnonzero(other.offset >= 0)
            on = on[self.layers.in_fronts[other.offset[on]]]
            if kind == "calibration" or UNKNOWNS[kind].in_photo:  # photos have brought those used
                every = np.arange(other.free.shape[1])
                columns = np.minimum(other.offset[on][:, None] + every, unknowns.n_columns - 1)
                has = every < other.size[on][:, None]
                on = on[~(placed[columns] & has).any(axis=1)]
            if kind in ("point", "pose") or not len(on):
                continue
            if UNKNOWNS[kind].at_point:
                self._at_points(other, on, stations_of(equations, kind, on), node, filled)
                filled = np.concatenate(
                    [filled, np.full(self.n - len(filled), RULE.max_point_node_columns)]
                )
                continue
            on = np.setdiff1d(on, self.layers.alone.get(kind, ()))
            for number in on.tolist():
                size = np.arange(other.size[number])
                self._border.append(_free_columns(unknowns.free, int(other.offset[number]), size))

    def _at_points(
        self, table: Variables, on: Index, points: Index, node: Index, filled: Index
    ) -> None:
        """Put variables into the nodes of their points, or into nodes of their own.

        Every node has the width of the widest one: a station with hundreds of sets of directions
        must not make all others as wide. Held points have no node.

        Args:
            table: the variables of one kind.
            on: numbers of the variables, (k,).
            points: number of the point of each, (k,).
            node: node of each point, −1: none.
            filled: number of columns of each node, changed in place.
        """
        order = np.argsort(points, kind="stable")
        on, points = on[order], points[order]
        largest = int(table.size[on].max(initial=0))
        at = node[points]
        rank = np.arange(len(points)) - np.searchsorted(points, points)
        start = np.zeros(len(at), dtype=np.intp)
        start[at >= 0] = filled[at[at >= 0]] + (rank * largest)[at >= 0]
        alone = (at < 0) | (start + largest > max(RULE.max_point_node_columns, 3 + largest))
        start[alone] = 0
        at = np.where(alone, self.n + np.cumsum(alone) - 1, at)
        np.add.at(filled, at[~alone], largest)
        self.n += int(alone.sum())
        self._stands.append(points[alone])
        free = self.layers.unknowns.free
        for c in range(largest):
            has = c < table.size[on]
            column = table.offset[on[has]] + c
            self._put(at[has], start[has] + c, np.where(free[column], column, -1))

    def _alone(self, equations: Equations) -> None:
        """Give the variables that are nodes alone their nodes, in the middle of what they meet."""
        free = self.layers.unknowns.free
        for kind, numbers in self.layers.alone.items():
            table = self.layers.unknowns[kind]
            on = numbers[self.layers.in_fronts[table.offset[numbers]]]
            if not len(on):
                continue
            for i, number in enumerate(on.tolist()):
                own = table.offset[number] + np.arange(table.size[number])
                own = own[free[own]]
                self._put(np.full(len(own), self.n + i), np.arange(len(own)), own)
            self.n += len(on)
            self._middles.append(_around(equations, kind, on))

    def places(self, kind: VariableKind, numbers: Index) -> Index:
        """Return the place of every component of some variables (m, k); −1: held, or none."""
        table = self.layers.unknowns[kind]
        offset = table.offset[numbers][:, None] + np.arange(table.free.shape[1])
        has = (table.offset[numbers] >= 0)[:, None]
        has = has & (np.arange(table.free.shape[1]) < table.size[numbers][:, None])
        return np.where(has, self.place_of[np.where(has, offset, 0)], -1)

    def positions(self, state: State) -> Array:
        """Return the projection centres and points of the nodes, (n, 3) metres.

        A node without a point is in the middle of the points that its observations join, or of
        their photos.
        """
        at = {"point": state["point"], "pose": state["pose"][:, 9:]}
        middles = []
        for incidence in self._middles:
            sums = sum(times @ at[kind] for kind, times in incidence.items())
            count = sum(times.sum(axis=1) for times in incidence.values())
            middles.append(sums / np.maximum(count, 1.0)[:, None])
        centres = at["pose"][self.photos]
        return np.concatenate([centres, *(at["point"][p] for p in self._stands), *middles])


def _around(
    equations: Equations, kind: VariableKind, numbers: Index
) -> dict[VariableKind, csr_array]:
    """Return how often variables of a kind meet each point, and each photo where there is none.

    Args:
        equations: the network.
        kind: kind of the variables.
        numbers: their numbers, (k,).

    Returns:
        A matrix (k, number of points) and one (k, number of photos).
    """
    table = equations.unknowns[kind]
    local = np.full(len(table.names), -1, dtype=np.intp)
    local[numbers] = np.arange(len(numbers))
    out = {
        other: csr_array((len(numbers), len(equations.unknowns[other].names)))
        for other in ("point", "pose")
    }
    for block in equations.blocks:
        target = first_point(block)
        if target is None:
            photos = (j for j, (what, _) in enumerate(block.variables) if what == "pose")
            target = next(photos, None)
        if target is None:
            continue
        other, met = block.variables[target]
        for what, index in block.variables:
            if what == kind:
                on = np.flatnonzero(local[index] >= 0)
                places = (local[index[on]], met[on])
                times = csr_array((np.ones(len(on)), places), shape=out[other].shape)
                out[other] = out[other] + times
    return out


def _free_columns(free: Mask, offset: int, components: Index) -> Index:
    """Return the columns of components of a variable; −1 for held ones."""
    if offset < 0:
        return np.full(len(components), -1, dtype=np.intp)
    columns = offset + components
    return np.where(free[columns], columns, -1).astype(np.intp)


@dataclass(frozen=True)
class DenseNormals:
    """Normal equations of rows that join any number of columns."""

    columns: Index
    """The columns, (m,)."""
    normal: Array
    """Their normal matrix, (m, m)."""

    def touched(self, nodes: NodePlaces) -> Index:
        """Return the nodes that the columns belong to."""
        place = nodes.place_of[self.columns]
        inside = (place >= 0) & (place < nodes.n * nodes.width)
        return np.unique(place[inside] // nodes.width)

    def add_to(self, nodes: NodePlaces, matrix: BlockMatrix) -> None:
        """Add the normal matrix to the reduced system."""
        w, inner = nodes.width, nodes.n * nodes.width
        place = nodes.place_of[self.columns]
        on = place >= 0
        place, normal = place[on], self.normal[np.ix_(on, on)]
        own = self.touched(nodes)
        k = len(own)
        at = np.where(
            place < inner,
            w * np.searchsorted(own, place // w) + place % w,
            w * k + place - inner,
        )
        whole = np.zeros((w * k + nodes.side,) * 2)
        whole[np.ix_(at, at)] = normal
        blocks = whole[: w * k, : w * k].reshape(k, w, k, w)
        d = np.arange(k)
        matrix.diagonal[own] += blocks[d, :, d, :]
        i, j = np.triu_indices(k, 1)
        if len(i):
            matrix.pairs[matrix.find(own[i], own[j])] += blocks[i, :, j, :]
        matrix.side[own] += whole[: w * k, w * k :].reshape(k, w, nodes.side)
        matrix.corner += whole[w * k :, w * k :]


def joined_node_pairs(nodes: NodePlaces, dense: Sequence[DenseNormals]) -> Index:
    """Return the pairs of nodes that dense rows join, n a + b each, (k,)."""
    code = [np.zeros(0, dtype=np.intp)]
    for r in dense:
        own = r.touched(nodes)
        i, j = np.triu_indices(len(own), 1)
        code.append(own[i] * nodes.n + own[j])
    return np.unique(np.concatenate(code))
