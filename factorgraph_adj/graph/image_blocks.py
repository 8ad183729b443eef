"""Image coordinates of a network as blocks of arrays, one for each lens model."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..errors import InputError, Problem
from ..network import Network
from ..types import Index
from .blocks import Block
from .variables import Unknowns, calibration_name


class _ImageIds:
    """Ids of image points, made when they are asked for."""

    def __init__(self, network: Network, rows: Index, photo: Index, point: Index) -> None:
        self._photos, self._points = tuple(network.photos), tuple(network.points)
        self._own, self._sources = network.images.ids, network.images.sources
        self._rows, self._photo, self._point = rows, photo, point

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, i: int) -> str:
        own = self._own.get(int(self._rows[i]))
        return own or f"{self._photos[self._photo[i]]}/{self._points[self._point[i]]}"

    def label(self, i: int) -> str:
        source = self._sources.get(int(self._rows[i]))
        text = f"image {self._photos[self._photo[i]]} {self._points[self._point[i]]}"
        return f"{source}: {text}" if source else text


def image_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    """Image coordinates, photo by photo within a lens model."""
    photo, point, xy, sigma = network.images.columns()
    if not len(photo):
        return
    _refuse_duplicates(network, photo, point)
    calibration = np.array(
        [unknowns["calibration"].number[calibration_name(network, f)] for f in network.photos],
        dtype=np.intp,
    )
    lenses = [network.cameras[f.camera].lens for f in network.photos.values()]
    distinct = list(dict.fromkeys(lenses))
    lens_of_photo = np.array([distinct.index(lens) for lens in lenses])
    for number, lens in enumerate(distinct):
        rows = np.flatnonzero(lens_of_photo[photo] == number)
        if not len(rows):
            continue
        # Photo by photo: what is summed for each photo then lies together.
        rows = rows[np.argsort(photo[rows], kind="stable")]
        ids = _ImageIds(network, rows, photo[rows], point[rows])
        yield Block(
            "image",
            "image",
            (
                ("pose", photo[rows]),
                ("calibration", calibration[photo[rows]]),
                ("point", point[rows]),
            ),
            xy[rows],
            sigma[rows],
            ids,  # type: ignore[arg-type]
            ("x", "y"),
            ids.label,
            lens=lens,
        )


def _refuse_duplicates(network: Network, photo: Index, point: Index) -> None:
    code = np.sort(photo * len(network.points) + point)
    twice = np.unique(code[1:][code[1:] == code[:-1]])
    if len(twice):
        photos, points = tuple(network.photos), tuple(network.points)
        raise InputError(
            [
                Problem(
                    "the point is measured more than once in this photo",
                    f"image point {photos[c // len(points)]}/{points[c % len(points)]}",
                )
                for c in twice
            ]
        )
