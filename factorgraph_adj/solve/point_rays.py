"""Rays to the points of the first layer: index lists, and sums of their partials.

A network makes the index lists once; the sums belong to a linearisation. The photos are nodes of
the reduced system, see `factorgraph_adj.solve.reduced_system`. Spokes to other nodes follow the
rays, see `factorgraph_adj.solve.node_rows`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..graph.equations import Equations
from ..graph.image_blocks import RAYS, PointSums, stable_order
from ..types import Array, Index
from .linearised_equations import LinearisedEquations
from .linearised_rays import POINT_PARTIALS, LinearRays, add_components, photo_products
from .node_rows import SpokeRows, Spokes, add_to_points, find_spokes
from .reduced_system import Nodes


@dataclass(frozen=True)
class RayPart(Spokes):
    """The rays of one chunk to points of the first layer."""

    place: int
    """Place of the block in the network."""
    number: int
    """Number of the chunk in the block."""
    chosen: Index | None
    """Numbers of the rays in the chunk, (m,); None: all of them."""
    in_block: Index | slice
    """Numbers of the rays in the block."""
    camera: int
    """Place of the calibration that all rays share; −1: each photo has its own."""

    def of(self, system: LinearisedEquations) -> LinearRays:
        """Return the block of the rays."""
        block = system.blocks[self.place]
        assert isinstance(block, LinearRays)
        return block

    def own(self, system: LinearisedEquations) -> int:
        """Return the number of partials by what is the photo's own, its pose and its motion."""
        return self.of(system).chunks.own

    def partials(self, system: LinearisedEquations) -> Array:
        """Return the partials of the rays, (own + k, 2, m), see `RayPartials`."""
        return self._rows(system)[:-1]

    def _rows(self, system: LinearisedEquations) -> Array:
        """Return [A v] of the rays, (own + k + 1, 2, m)."""
        rows = self.of(system).parts[self.number].rows
        return rows if self.chosen is None else rows[:, :, self.chosen]

    def products(self, system: LinearisedEquations) -> Sequence[Array]:
        """Return [A v]ᵀ[A v] (own + k + 1, own + k + 1) of each run."""
        if self.chosen is None:
            return self.of(system).photos[self.number]
        return photo_products(self._rows(system), [(start, stop) for _, start, stop in self.runs])

    def cross(self, system: LinearisedEquations) -> Array:
        """Return JᵀA of each point with the parameters of the lens, (u, 3, k)."""
        a = self.partials(system)
        own = self.own(system)
        k = len(a) - own
        products = np.empty((3 * k, a.shape[2]))
        for i, j in enumerate(a[POINT_PARTIALS]):
            for c in range(k):
                add_components(j, a[own + c], products[i * k + c])
        found = self.sums.incidence @ np.ascontiguousarray(products.T)
        return -found.reshape(len(found), 3, k)  # partials by the point have the opposite sign


class PointRays:
    """Rays to the points of the first layer, nodes and pairs of nodes."""

    def __init__(self, equations: Equations, nodes: Nodes, *, paired: bool = True) -> None:
        """Sort the rays.

        Args:
            equations: the network.
            nodes: places of the photos in the reduced system.
            paired: whether pairs of nodes are listed; their number grows with the square of the
                rays to a point.
        """
        self.places, self.layers = nodes, nodes.layers
        """Places of the photos in the reduced system."""
        self.n_points = int(nodes.layers.reduced.sum())
        self.width = nodes.width
        """Number of columns of a node."""
        self.cameras = nodes.cameras
        """Calibrations that several photos share."""
        points, of_ray = self._parts(equations)
        spokes, spoke_rows, of_spoke = find_spokes(equations, nodes, self.n_rays)
        self.spoke_rows: list[SpokeRows] = spoke_rows
        """Observations of points of the first layer that are no images."""
        ends = [c.side.stop for c in nodes.cameras]
        ends += [int(at.max()) + 1 for rows in spoke_rows for _, at in rows.border if at.size]
        self.side = max(ends, default=0)
        """Number of the first columns of the border, in which are all that rays and spokes touch,
        such as shared calibrations."""
        self.parts: list[Spokes] = [*self.photo_parts]
        """All parts, spokes last."""
        if spokes is not None:
            self.parts.append(spokes)
            self.n_rays += len(spokes.points)
            points = np.concatenate([points, spokes.points.astype(np.int32)])
        self.spokes = spokes
        """Spokes; None: there are none."""
        self.node_of_ray = np.concatenate([of_ray, of_spoke.astype(np.int32)])
        """Node of every ray and spoke, (n_rays,)."""
        self.point_of_ray = points
        """Point of the first layer of every ray and spoke, (n_rays,)."""
        self._pairs(points, self.node_of_ray, paired=paired)

    def _parts(self, equations: Equations) -> tuple[Index, Index]:
        """Choose the rays of each chunk; return point and node of every ray, (n_rays,) each."""
        local = np.cumsum(self.layers.reduced) - 1
        node_of = self.places.node["pose"]
        ones = np.ones(RAYS)
        self.photo_parts: list[RayPart] = []
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
                    (int(node_of[f]), int(before[start]), int(before[stop]))
                    for f, start, stop in chunk.parts
                    if before[stop] > before[start]
                )
                point = local[number[chunk.rows]][keep]
                self.photo_parts.append(
                    RayPart(
                        slice(first, first + m),
                        runs,
                        point,
                        PointSums.of(point, self.n_points, ones),
                        place,
                        i,
                        chosen,
                        chunk.rows if chosen is None else chosen + chunk.rows.start,
                        self.places.camera_of.get(chunk.calibration, -1),
                    )
                )
                points.append(point.astype(np.int32))
                nodes += [np.full(t - s, node, dtype=np.int32) for node, s, t in runs]
                first += m
        self.n_rays = first
        """Number of rays and spokes."""
        return np.concatenate(points), np.concatenate(nodes)

    # -- pairs of nodes ---------------------------------------------------------------------------

    def _pairs(self, points: Index, nodes: Index, *, paired: bool) -> None:
        """List, for every pair of nodes, the rays to their common points.

        Args:
            points: number of the point of each ray, (n_rays,).
            nodes: node of each ray, (n_rays,).
            paired: whether there are any.
        """
        order = stable_order(points, self.n_points).astype(np.int32)
        counts = np.bincount(points, minlength=self.n_points)
        self._by_point, self._first = order, np.concatenate([[0], np.cumsum(counts)])
        first = self._first[:-1]
        left, right = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
        for n in np.unique(counts[counts > 1]) if paired else ():
            rays = order[first[counts == n][:, None] + np.arange(n)]
            i, j = np.triu_indices(int(n), 1)
            left.append(rays[:, i].ravel())
            right.append(rays[:, j].ravel())
        a, b = np.concatenate(left), np.concatenate(right)
        # Rays lie in the order of their parts, which need not be that of their nodes.
        swapped = nodes[a] > nodes[b]
        a, b = np.where(swapped, b, a), np.where(swapped, a, b)
        n_nodes = self.places.n
        code = nodes[a].astype(np.int64) * n_nodes + nodes[b]
        by_pair = stable_order(code, n_nodes**2)
        code, self.left, self.right = code[by_pair], a[by_pair], b[by_pair]
        cuts: Index = np.flatnonzero(np.diff(code, prepend=-1))
        self.pair_first, self.pair_second = code[cuts] // n_nodes, code[cuts] % n_nodes
        self.pair_stops = np.append(cuts[1:], len(code))[: len(cuts)]
        self.pair_starts = cuts
        self.of_first = np.searchsorted(self.pair_first, np.arange(n_nodes + 1))
        """Pairs of each first node: those from its place to the next one."""

    def of_point(self, point: int) -> Index:
        """Return the numbers of the rays to a point of the first layer."""
        return np.asarray(self._by_point[self._first[point] : self._first[point + 1]], np.intp)

    @cached_property
    def _by_node(self) -> tuple[Index, Index]:
        """Rays in the order of their nodes, and the first of each node there."""
        order = stable_order(self.node_of_ray, self.places.n)
        counts = np.bincount(self.node_of_ray, minlength=self.places.n)
        return order, np.concatenate([[0], np.cumsum(counts)])

    def of_node(self, node: int) -> Index:
        """Return the numbers of the rays of a node."""
        order, first = self._by_node
        return np.asarray(order[first[node] : first[node + 1]], np.intp)

    @property
    def pair_codes(self) -> Index:
        """Pairs of nodes with common points, n a + b each, (p,)."""
        return np.asarray(self.pair_first * self.places.n + self.pair_second, dtype=np.intp)

    def by_first(self) -> Iterator[tuple[list[tuple[int, int, int]], slice]]:
        """Iterate over the first nodes of pairs.

        Yields:
            Number of each pair of the node, with the first and the end of its rays counted from the
            first ray of the node; and all these rays in ``left`` and ``right``.
        """
        starts, stops = self.pair_starts.tolist(), self.pair_stops.tolist()
        for first, last in pairwise(self.of_first.tolist()):
            if first < last:
                start = starts[first]
                pairs = [(i, starts[i] - start, stops[i] - start) for i in range(first, last)]
                yield pairs, slice(start, stops[last - 1])


class RaySums:
    """Products of partials, summed over the rays of each node and of each point."""

    def __init__(self, rays: PointRays, system: LinearisedEquations) -> None:
        """Sum the products of one linearisation."""
        self.rays, self.system = rays, system
        n, p = rays.places.n, rays.n_points
        chunks = [system.equations.rays[x.place] for x in rays.photo_parts]
        largest = max((c.own + len(c.lens_free) for c in chunks), default=0)
        self.nodes = np.zeros((n, largest, largest))
        """AᵀA of each node with the photo's own and the parameters of the lens,
        (n, own + k, own + k); empty without photos."""
        self.points = np.zeros((6, p))
        """JᵀJ of each point, (6, p)."""
        self.cross = np.zeros((p, 3, rays.side))
        """JᵀA of each point with the shared calibrations, (p, 3, border)."""
        for block in system.blocks:
            if isinstance(block, LinearRays):
                self.points += block.points[:6, rays.layers.reduced]
        for part in rays.photo_parts:
            for (node, _, _), product in zip(part.runs, part.products(system), strict=True):
                width = len(product) - 1
                self.nodes[node, :width, :width] += product[:width, :width]
            if part.camera >= 0:
                side = rays.cameras[part.camera].side
                self.cross[part.sums.points, :, side] += part.cross(system)
        for rows in rays.spoke_rows:
            add_to_points(rows, rows.arrays(system), self.points, self.cross)
