"""The nodes of the reduced system: which unknowns are eliminated together, and in which order.

A photo with the calibration that no other photo has is a node. Where the terrestrial side is
eliminated in dense fronts too (`Layers.in_fronts`), each of its points is a node, together with the
orientation unknowns and the vertical at the point; further ones, and those at held points, are
nodes of their own, and so are frames, sizes and levels, and drifts and mounts that few photos have,
if there are more than a few. What touches everything is the border: calibrations that several
photos share, distance meters, refraction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..graph.equations import Equations
from ..graph.variables import State, Variables
from ..models.variables import UNKNOWNS, VariableKind
from ..types import Array, Index, Mask
from .elimination import Layers, first_point
from .places import Places
from .stations import places_of

WIDEST = 8
"""Largest number of columns of the node of a point: its coordinates, and some unknowns at it."""


@dataclass(frozen=True)
class Camera:
    """A calibration that several photos share."""

    number: int
    """Number of the calibration."""
    side: slice
    """Its columns of the border: the parameters that are free in any calibration of its block."""


class Nodes(Places):
    """The places of unknowns in the reduced system."""

    def __init__(self, equations: Equations, layers: Layers) -> None:
        """Give every unknown of the third layer a place."""
        super().__init__(layers.unknowns.n_columns)
        self.layers = layers
        self._nodes: list[Index] = []
        self._positions: list[Index] = []
        self._columns: list[Index] = []
        self._border: list[Index] = [np.zeros(0, dtype=np.intp)]
        self._stands: list[Index] = []
        self._middles: list[dict[VariableKind, csr_array]] = []
        self._photos(equations)
        if layers.in_fronts:
            self._points(equations)
            self._alone(equations)
        node, position, column = (
            np.concatenate([np.zeros(0, dtype=np.intp), *x])
            for x in (self._nodes, self._positions, self._columns)
        )
        self._settle(node, position, column, np.concatenate(self._border), layers.kept)
        lost = np.flatnonzero(layers.cameras & layers.unknowns.free & (self.place_of < 0))
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
        free = unknowns.free & self.layers.cameras
        photos: dict[int, tuple[int, int] | None] = {}
        if self.layers.in_fronts:  # photos without rays are unknowns too
            on = np.flatnonzero(pose.offset >= 0)
            photos |= dict.fromkeys(on[self.layers.cameras[pose.offset[on]]].tolist())
        for place in equations.rays:
            (_, photo), (_, calibration), (_, point) = equations.blocks[place].variables
            keep = self.layers.reduced[point]
            if self.layers.in_fronts:
                keep = np.ones(len(point), dtype=bool)
            numbers, first = np.unique(photo[keep], return_index=True)
            cameras = calibration[keep][first]
            for f, k in zip(numbers.tolist(), cameras.tolist(), strict=True):
                photos[f] = (k, place)
        self.photos: Index = np.array(sorted(photos), dtype=np.intp)
        """Number of the photo of each of the first nodes."""
        self.node: dict[VariableKind, Index] = {"pose": np.full(len(pose.names), -1, dtype=np.intp)}
        """Node of each variable, by kind; −1: none."""
        self.node["pose"][self.photos] = np.arange(len(self.photos))
        self.cameras: list[Camera] = []
        self.camera_of: dict[int, int] = {}
        """Place of each shared calibration in ``cameras``."""
        self.n = len(self.photos)
        at = 0
        for node, f in enumerate(self.photos.tolist()):
            own = _free_columns(free, int(pose.offset[f]), np.arange(6))
            camera = photos[f]
            if camera is not None:
                k, place = camera
                chunks = equations.rays[place]
                of_lens = _free_columns(free, int(lens.offset[k]), chunks.lens_free)
                if k in chunks.alone:
                    own = np.concatenate([own, of_lens])
                elif k not in self.camera_of:
                    self.camera_of[k] = len(self.cameras)
                    self.cameras.append(Camera(k, slice(at, at + len(of_lens))))
                    self._border.append(of_lens)
                    at += len(of_lens)
            self._put(np.full(len(own), node), np.arange(len(own)), own)

    def _points(self, equations: Equations) -> None:
        """Give every terrestrial point a node; other unknowns stand there or in the border."""
        unknowns = self.layers.unknowns
        table = unknowns["point"]
        mine = np.flatnonzero((table.offset >= 0) & ~self.layers.reduced)
        mine = mine[self.layers.cameras[table.offset[mine]]]
        node = np.full(len(table.names), -1, dtype=np.intp)
        node[mine] = self.n + np.arange(len(mine))
        self.node["point"] = node
        self.n += len(mine)
        places = table.offset[mine, None] + np.arange(3)
        columns = np.where(unknowns.free[places], places, -1)
        self._put(np.repeat(node[mine], 3), np.tile(np.arange(3), len(mine)), columns.ravel())
        self._stands.append(mine)
        filled = np.full(self.n, 3, dtype=np.intp)
        placed = np.zeros(unknowns.n_columns + 1, dtype=bool)
        placed[np.concatenate(self._columns + self._border)] = True  # −1 is the last one
        for kind, other in unknowns.tables.items():
            on = np.flatnonzero(other.offset >= 0)
            on = on[self.layers.cameras[other.offset[on]]]
            if kind == "calibration":  # photos have brought those that are used
                every = np.arange(other.free.shape[1])
                columns = np.minimum(other.offset[on][:, None] + every, unknowns.n_columns - 1)
                has = every < other.size[on][:, None]
                on = on[~(placed[columns] & has).any(axis=1)]
            if kind in ("point", "pose") or not len(on):
                continue
            if UNKNOWNS[kind].at_point:
                self._at_points(other, on, places_of(equations, kind, on), node, filled)
                filled = np.concatenate([filled, np.full(self.n - len(filled), WIDEST)])
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
        start = np.where(at >= 0, filled[np.maximum(at, 0)] + rank * largest, 0)
        alone = (at < 0) | (start + largest > max(WIDEST, 3 + largest))
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
            on = numbers[self.layers.cameras[table.offset[numbers]]]
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

        A node without a point stands in the middle of the points that its observations join, or
        of their photos.
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
