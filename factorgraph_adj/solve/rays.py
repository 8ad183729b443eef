"""Index lists of the rays to object points that only cameras see; a network makes them once.

Each photo with such rays is a node of the reduced system: its six components, and those of its
calibration if no other photo has it. Calibrations that several photos share are the border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..graph.image_chunks import RAYS, ImageChunks, PointSums, RayPartials
from ..types import Array, Index, Mask
from .dissection import Front, Pattern, dissect
from .elimination import Layers
from .fronts import BlockMatrix
from .linear import LinearSystem
from .linear_rays import LinearRays


@dataclass(frozen=True)
class RayPart:
    """The rays of one chunk to points of the first layer."""

    place: int
    """Place of the block in the network."""
    number: int
    """Number of the chunk in the block."""
    chosen: Index | None
    """Numbers of the rays in the chunk, (m,); none: all of them."""
    rows: slice
    """Numbers of the rays among those of all parts."""
    runs: tuple[tuple[int, int, int], ...]
    """Node, first ray and end of each run of rays of one photo."""
    points: Index
    """Number of the point of each ray in the first layer, (m,)."""
    sums: PointSums
    """Sums over the rays to the same point."""
    camera: int
    """Place of the calibration that all rays share; −1: each photo has its own."""

    def partials(self, system: LinearSystem) -> Array:
        """Return the partials of the rays, (6 + k, 2, m), see `RayPartials`."""
        block = system.blocks[self.place]
        assert isinstance(block, LinearRays)
        found: RayPartials = block.parts[self.number]
        return found.a if self.chosen is None else found.a[:, :, self.chosen]


@dataclass(frozen=True)
class Camera:
    """A calibration that several photos share."""

    number: int
    """Number of the calibration."""
    side: slice
    """Its columns of the border: the parameters that are free in any calibration of its block."""


class Rays:
    """Rays to the points of the first layer, nodes and pairs of nodes."""

    def __init__(self, equations: Equations, layers: Layers) -> None:
        """Sort the rays."""
        self.layers = layers
        self.n_points = int(layers.reduced.sum())
        self._nodes(equations)
        self._parts(equations)
        self._pairs()
        self.coordinate_places = [
            i
            for i, b in enumerate(equations.blocks)
            if b.kind != "image" and len(b.variables) == 1 and b.variables[0][0] == "point"
        ]
        self._structure: tuple[bytes, Pattern, list[Front]] | None = None

    # -- nodes ------------------------------------------------------------------------------------

    def _nodes(self, equations: Equations) -> None:
        """Give every photo a node and every shared calibration columns of the border."""
        unknowns = self.layers.unknowns
        pose, lens = unknowns["pose"], unknowns["calibration"]
        photos: dict[int, tuple[int, ImageChunks]] = {}
        for place, chunks in equations.rays.items():
            (_, photo), (_, calibration), (_, point) = equations.blocks[place].variables
            keep = self.layers.reduced[point]
            numbers, first = np.unique(photo[keep], return_index=True)
            cameras = calibration[keep][first]
            for f, k in zip(numbers.tolist(), cameras.tolist(), strict=True):
                photos[f] = (k, chunks)
        self.photos: Index = np.array(sorted(photos), dtype=np.intp)
        """Number of the photo of each node."""
        self.node: Index = np.full(len(pose.names), -1, dtype=np.intp)
        """Node of each photo."""
        self.node[self.photos] = np.arange(len(self.photos))
        alone = {f for f, (k, chunks) in photos.items() if k in chunks.alone}
        own = max((len(photos[f][1].lens_free) for f in alone), default=0)
        self.width = 6 + own
        self.cameras: list[Camera] = []
        columns = np.full((len(photos), self.width), -1, dtype=np.intp)
        border: list[Index] = []
        camera_of: dict[int, int] = {}
        at = 0
        for i, f in enumerate(self.photos.tolist()):
            k, chunks = photos[f]
            columns[i, :6] = _free_columns(unknowns.free, int(pose.offset[f]), np.arange(6))
            of_lens = _free_columns(unknowns.free, int(lens.offset[k]), chunks.lens_free)
            if f in alone:
                columns[i, 6 : 6 + len(of_lens)] = of_lens
            elif k not in camera_of:
                camera_of[k] = len(self.cameras)
                self.cameras.append(Camera(k, slice(at, at + len(of_lens))))
                border.append(of_lens)
                at += len(of_lens)
        self.side = at
        self.camera_of = camera_of
        self.columns: Index = np.concatenate([columns.ravel(), *border])
        """Unknown at each place of the reduced system, −1 for held components and padding."""
        self.place_of: Index = np.full(unknowns.n_columns, -1, dtype=np.intp)
        """Place of each unknown in the reduced system, −1 for others."""
        on = self.columns >= 0
        self.place_of[self.columns[on]] = np.flatnonzero(on)
        self.held: Mask = ~on

    def _parts(self, equations: Equations) -> None:
        """Choose the rays of each chunk."""
        local = np.cumsum(self.layers.reduced) - 1
        ones = np.ones(RAYS)
        self.parts: list[RayPart] = []
        first = 0
        points, nodes = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.int32)]
        for place, chunks in equations.rays.items():
            number = equations.blocks[place].variables[2][1]
            for i, chunk in enumerate(chunks.chunks):
                keep = self.layers.reduced[number[chunk.rows]]
                m = int(keep.sum())
                if not m:
                    continue
                everything = m == len(keep)
                chosen: Index | None = None if everything else np.flatnonzero(keep)
                before = np.concatenate([[0], np.cumsum(keep)])
                runs = tuple(
                    (int(self.node[f]), int(before[start]), int(before[stop]))
                    for f, start, stop in chunk.parts
                    if before[stop] > before[start]
                )
                point = local[number[chunk.rows]][keep]
                self.parts.append(
                    RayPart(
                        place,
                        i,
                        chosen,
                        slice(first, first + m),
                        runs,
                        point,
                        PointSums.of(point, ones),
                        self.camera_of.get(chunk.calibration, -1),
                    )
                )
                points.append(point.astype(np.int32))
                nodes += [np.full(t - s, node, dtype=np.int32) for node, s, t in runs]
                first += m
        self.n_rays = first
        self.points: Index = np.concatenate(points)
        """Number of the point of each ray, (n_rays,)."""
        self.nodes: Index = np.concatenate(nodes)
        """Node of each ray, (n_rays,)."""

    # -- pairs of nodes ---------------------------------------------------------------------------

    def _pairs(self) -> None:
        """List, for every pair of nodes, the rays to their common points."""
        order = np.argsort(self.points, kind="stable").astype(np.int32)
        counts = np.bincount(self.points, minlength=self.n_points)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        left, right = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
        for n in np.unique(counts[counts > 1]):
            rays = order[first[counts == n][:, None] + np.arange(n)]
            i, j = np.triu_indices(int(n), 1)
            left.append(rays[:, i].ravel())
            right.append(rays[:, j].ravel())
        a, b = np.concatenate(left), np.concatenate(right)
        # Rays lie in the order of their parts, which need not be that of their nodes.
        swapped = self.nodes[a] > self.nodes[b]
        a, b = np.where(swapped, b, a), np.where(swapped, a, b)
        n_nodes = len(self.photos)
        code = self.nodes[a].astype(np.int64) * n_nodes + self.nodes[b]
        by_pair = np.argsort(code, kind="stable")
        code, self.left, self.right = code[by_pair], a[by_pair], b[by_pair]
        cuts: Index = np.flatnonzero(np.diff(code, prepend=-1))
        self.pair_first, self.pair_second = code[cuts] // n_nodes, code[cuts] % n_nodes
        self.pair_stops = np.append(cuts[1:], len(code))[: len(cuts)]
        self.pair_starts = cuts
        self.of_first = np.searchsorted(self.pair_first, np.arange(n_nodes + 1))
        """Pairs of each first node: those from its place to the next one."""

    def structure(self, more: Index, positions: Array) -> tuple[Pattern, list[Front]]:
        """Return the blocks of the reduced system and its fronts; they are made once.

        Args:
            more: pairs of nodes that other eliminated unknowns join, (k, 2).
            positions: projection centres of the nodes, (n, 3), metres.
        """
        n = len(self.photos)
        if self._structure is None or self._structure[0] != more.tobytes():
            code = self.pair_first * n + self.pair_second
            code = np.unique(np.concatenate([code, more[:, 0] * n + more[:, 1]]))
            pattern = Pattern(n, self.width, self.side, code // n, code % n)
            self._structure = (more.tobytes(), pattern, dissect(pattern, positions))
        return self._structure[1:]

    def hold(self, matrix: BlockMatrix) -> None:
        """Give held places a one on the diagonal and zeros elsewhere, in place."""
        if not self.held.any():
            return
        n, w = len(self.photos), self.width
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


def _free_columns(free: Mask, offset: int, components: Index) -> Index:
    """Return the columns of components of a variable; −1 for held ones."""
    if offset < 0:
        return np.full(len(components), -1, dtype=np.intp)
    columns = offset + components
    return np.where(free[columns], columns, -1).astype(np.intp)
