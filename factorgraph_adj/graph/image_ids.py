"""Ids of image points, made on demand, and their look-up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..network.network import Network
from ..types import Index


class ImageIds:
    """Ids of image points, made on demand."""

    def __init__(self, network: Network, rows: Index, photo: Index, point: Index) -> None:
        self._photos, self._points = tuple(network.photos), tuple(network.points)
        self._own, self._sources = network.images.ids, network.images.sources
        self.rows, self._photo, self._point = rows, photo, point

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, i: int) -> str:
        own = self._own.get(int(self.rows[i]))
        return own or f"{self._photos[self._photo[i]]}/{self._points[self._point[i]]}"

    def label(self, i: int) -> str:
        """Return a readable name of image point i, with its source."""
        source = self.source(i)
        text = f"image {self._photos[self._photo[i]]} {self._points[self._point[i]]}"
        return f"{source}: {text}" if source else text

    def source(self, i: int) -> str:
        """Return file and line of image point i; empty if it was not read from a file."""
        return self._sources.get(int(self.rows[i])) or ""

    def positions(self, ids: Sequence[str]) -> Index:
        """Return the rows (n,) of the block with these ids, −1 for ids of no row."""
        place = {int(row): i for i, row in enumerate(self.rows)} if self._own else {}
        own = {name: place[row] for row, name in self._own.items() if row in place}
        return find_images(self._photo, self._point, self._photos, self._points, own, ids)


def find_images(
    photo: Index,
    point: Index,
    photos: Sequence[str],
    points: Sequence[str],
    own: Mapping[str, int],
    ids: Sequence[str],
) -> Index:
    """Return the rows of image points by id, (n,); −1 for ids of no row.

    Args:
        photo: number of the photo of each row.
        point: number of the point of each row.
        photos: names of all photos.
        points: names of all points.
        own: rows with an id of their own, by id.
        ids: ids to find: own ids, or photo/point.
    """
    code = photo * len(points) + point
    order = np.argsort(code, kind="stable")
    photo_number = {name: i for i, name in enumerate(photos)}
    point_number = {name: i for i, name in enumerate(points)}
    out = np.array([own.get(ident, -1) for ident in ids], dtype=np.intp)
    wanted: list[tuple[int, int]] = []
    for i in np.flatnonzero(out < 0).tolist():
        # Names may contain a slash.
        at = ids[i].find("/")
        while at >= 0:
            f, p = photo_number.get(ids[i][:at]), point_number.get(ids[i][at + 1 :])
            if f is not None and p is not None:
                wanted.append((i, f * len(points) + p))
            at = ids[i].find("/", at + 1)
    if wanted and len(code):
        places, codes = np.array(wanted, dtype=np.intp).T
        found = np.minimum(np.searchsorted(code, codes, sorter=order), len(code) - 1)
        rows = order[found]
        hit = code[rows] == codes
        out[places[hit]] = rows[hit]
    return out
