"""Index lists of the rays to object points that only cameras see; a network makes them once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..types import Array, Index
from .elimination import Layers


@dataclass(frozen=True)
class Participant:
    """A photo (with its own calibration) or a shared calibration in the reduced system."""

    rows: slice
    """Rays of the photo, or points of the shared calibration, in the order of their arrays."""
    columns: Index
    """Columns of the participant's block in the border; −1 for held components."""

    @property
    def run(self) -> slice | None:
        """The columns as a slice; none: they are not consecutive."""
        n = int(np.sum(self.columns >= 0))
        first = int(self.columns[0])
        if first < 0 or not np.array_equal(self.columns[:n], np.arange(first, first + n)):
            return None
        return slice(first, first + n)


class Rays:
    """Index lists of the rays to the points of the first layer; a network makes them once."""

    def __init__(self, equations: Equations, layers: Layers) -> None:
        """Sort the rays by photo, calibration and point."""
        self.layers = layers
        unknowns = layers.unknowns
        local = np.cumsum(layers.reduced) - 1
        self.n_points = int(layers.reduced.sum())
        self.places = [i for i, b in enumerate(equations.blocks) if b.kind == "image"]
        self.selected: list[Index | slice] = []
        self.sizes: list[int] = []
        photo, calibration, point = [], [], []
        for place in self.places:
            (_, f), (_, k), (_, p) = equations.blocks[place].variables
            keep = layers.reduced[p]
            rows: Index | slice = slice(None) if keep.all() else np.flatnonzero(keep)
            self.selected.append(rows)
            self.sizes.append(int(keep.sum()))
            photo.append(f[rows])
            calibration.append(k[rows])
            point.append(local[p[rows]])
        self.photo = np.concatenate(photo)
        self.calibration = np.concatenate(calibration)
        self.point = np.concatenate(point)

        # Rays of one photo lie together; each photo is one participant. A calibration that only
        # one photo uses joins this photo; shared calibrations are participants of their own.
        starts = np.flatnonzero(np.r_[True, self.photo[1:] != self.photo[:-1]])
        stops = np.r_[starts[1:], len(self.photo)]
        pose, lens = unknowns["pose"], unknowns["calibration"]
        of_photo = self.calibration[starts]
        users = np.bincount(of_photo, minlength=len(lens.names))
        own = users[of_photo] == 1
        self.has_own = own
        self.width = 6 + (lens.free.shape[1] if own.any() else 0)
        self.shared = np.flatnonzero((users > 1) & (lens.offset >= 0))
        self.photos: list[Participant] = []
        for start, stop, alone in zip(starts, stops, own, strict=True):
            columns = np.full(self.width, -1, dtype=np.intp)
            f, k = self.photo[start], self.calibration[start]
            if pose.offset[f] >= 0:
                columns[:6] = layers.in_border[pose.offset[f] + np.arange(6)]
            if alone and lens.offset[k] >= 0:
                size = lens.size[k]
                columns[6 : 6 + size] = layers.in_border[lens.offset[k] + np.arange(size)]
            self.photos.append(Participant(slice(int(start), int(stop)), columns))
        self.runs = [p.run for p in self.photos]
        self.ray_photo = np.repeat(np.arange(len(starts)), stops - starts)
        self.own_rays = np.flatnonzero(own[self.ray_photo])
        self._find_shared(layers)
        self._find_pairs()
        self.coordinate_places = [
            i
            for i, b in enumerate(equations.blocks)
            if b.kind != "image" and len(b.variables) == 1 and b.variables[0][0] == "point"
        ]

    def _find_shared(self, layers: Layers) -> None:
        """Find the points and rays of each calibration that several photos share."""
        lens = layers.unknowns["calibration"]
        self.shared_rays: list[Index | slice] = []
        self.shared_points: list[Index] = []
        self.shared_place: list[Index] = []
        self.shared_columns: list[Index] = []
        for k in self.shared:
            rays: Index | slice = np.flatnonzero(self.calibration == k)
            points, place = np.unique(self.point[rays], return_inverse=True)
            if len(place) == len(self.point):
                rays = slice(None)
            self.shared_rays.append(rays)
            self.shared_points.append(points)
            self.shared_place.append(place.astype(np.intp))
            self.shared_columns.append(layers.in_border[lens.offset[k] + np.arange(lens.size[k])])

    def _find_pairs(self) -> None:
        """List, for every pair of photos, the rays to their common points."""
        order = np.argsort(self.point, kind="stable").astype(np.int32)
        counts = np.bincount(self.point, minlength=self.n_points)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        left, right = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
        for n in np.unique(counts[counts > 1]):
            rays = order[first[counts == n][:, None] + np.arange(n)]
            i, j = np.triu_indices(int(n), 1)
            left.append(rays[:, i].ravel())
            right.append(rays[:, j].ravel())
        a, b = np.concatenate(left), np.concatenate(right)
        n_photos = len(self.photos)
        code = self.ray_photo[a].astype(np.int64) * n_photos + self.ray_photo[b]
        by_pair = np.argsort(code, kind="stable")
        code, a, b = code[by_pair], a[by_pair], b[by_pair]
        cuts: Index = np.flatnonzero(np.diff(code, prepend=-1))
        stops = np.append(cuts[1:], len(code))[: len(cuts)]
        self.left, self.right = a, b
        self.pairs = [
            (int(code[s]) // n_photos, int(code[s]) % n_photos, int(s), int(t))
            for s, t in zip(cuts, stops, strict=True)
        ]


def joined(parts: list[Array], rays: Rays) -> Array:
    """Join partials of several image blocks; partials by held variables are zero."""
    width = max(p.shape[2] for p in parts)
    chosen = []
    for part, rows, size in zip(parts, rays.selected, rays.sizes, strict=True):
        if not len(part):
            chosen.append(np.zeros((size, 2, width)))
            continue
        part = part[rows]
        if part.shape[2] < width:
            part = np.concatenate(
                [part, np.zeros((*part.shape[:2], width - part.shape[2]))], axis=2
            )
        chosen.append(part)
    return chosen[0] if len(chosen) == 1 else np.concatenate(chosen)
