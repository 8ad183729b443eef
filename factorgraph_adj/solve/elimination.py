"""The layers of the elimination; they are made once for a network, before the first iteration.

Three layers, in the order of elimination:

1. ``points``: object points that only cameras see (and their own coordinates), in numpy;
2. ``tree``: everything else on the terrestrial side, by GTSAM;
3. ``border``: poses and calibrations of the cameras of layer 1, dense, by LAPACK.

GTSAM eliminates all unknowns where a network has no such points or the border would be too large.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import Unknowns
from ..models.variables import VariableKind
from ..types import Index, Mask

if TYPE_CHECKING:
    import gtsam

LARGEST_BORDER = 9000
"""Largest number of columns of a dense border: above it a sparse elimination needs less memory
and time."""


@dataclass
class Layers:
    """Columns of the three layers, and index lists that every iteration uses."""

    unknowns: Unknowns
    """The unknowns."""
    reduced: Mask
    """Points of the first layer, (number of points,)."""
    border: Index
    """Columns of the third layer, in the order of the border."""
    in_border: Index
    """Place of each column in the border, −1 elsewhere, (n_columns,)."""
    tree: tuple[tuple[VariableKind, int], ...]
    """Variables of the second layer."""
    ordering: gtsam.Ordering | None = None
    """Order of elimination of the second layer; none before it has been computed."""

    @cached_property
    def columns_at(self) -> dict[int, Index]:
        """Columns of each variable, by its first column."""
        return {k: np.arange(k, k + size) for k, size in self.unknowns.size_at.items()}

    @property
    def point_columns(self) -> Index:
        """Columns of the points of the first layer, (p, 3)."""
        first = self.unknowns["point"].offset[self.reduced]
        return np.asarray(first[:, None] + np.arange(3), dtype=np.intp)


def layers_of(equations: Equations, *, reduce_points: bool, touched: Mask) -> Layers:
    """Divide the unknowns into the three layers.

    Args:
        equations: the network.
        reduce_points: whether there is a first layer; false leaves all unknowns to GTSAM (QR, for
            systems of poor condition).
        touched: columns of factors that the user added; their points stay in the tree.
    """
    unknowns = equations.unknowns
    table = unknowns["point"]
    n = len(table.names)
    reduced = np.zeros(n, dtype=bool)
    images = [b for b in equations.blocks if b.kind == "image"]
    if reduce_points and images:
        for block in images:
            reduced[block.variables[2][1]] = True
        reduced &= table.offset >= 0
        for place, block in enumerate(equations.blocks):
            if block.kind == "image":
                continue
            alone = len(block.variables) == 1
            for kind, index in block.variables:
                if kind == "point":
                    if not alone:
                        reduced[index] = False
                    elif place in equations.in_cluster:
                        reduced[index[equations.in_cluster[place]]] = False
        if touched.any():
            on = np.flatnonzero(table.offset >= 0)
            reduced[on[touched[table.offset[on]]]] = False
    border = _border(unknowns, [_rays(b, reduced) for b in images])
    if len(border) > LARGEST_BORDER:
        return layers_of(equations, reduce_points=False, touched=touched)
    in_border = np.full(unknowns.n_columns, -1, dtype=np.intp)
    in_border[border] = np.arange(len(border))
    tree: list[tuple[VariableKind, int]] = []
    for kind in unknowns.tables:
        offset = unknowns[kind].offset
        inside = (offset >= 0) & (in_border[np.maximum(offset, 0)] < 0)
        if kind == "point":
            inside &= ~reduced
        tree += [(kind, number) for number in np.flatnonzero(inside).tolist()]
    return Layers(unknowns, reduced, border, in_border, tuple(tree))


def _rays(block: Block, reduced: Mask) -> tuple[Index, Index]:
    """Return photo and calibration of the rays to points of the first layer."""
    (_, photo), (_, calibration), (_, point) = block.variables
    keep = reduced[point]
    return photo[keep], calibration[keep]


def _border(unknowns: Unknowns, rays: list[tuple[Index, Index]]) -> Index:
    """Return the columns of photos, each followed by its own calibration, then shared calibrations.

    Args:
        unknowns: the unknowns.
        rays: numbers of photo and calibration of every ray to a point of the first layer, for
            each block.
    """
    of_photo: dict[int, int] = {}
    for photo, calibration in rays:
        numbers, first = np.unique(photo, return_index=True)
        of_photo |= dict(zip(numbers.tolist(), calibration[first].tolist(), strict=True))
    users = np.bincount(list(of_photo.values()) or [0])
    columns: list[Index] = [np.zeros(0, dtype=np.intp)]
    for number, camera in sorted(of_photo.items()):
        columns.append(unknowns.columns("pose", number))
        if users[camera] == 1:
            columns.append(unknowns.columns("calibration", camera))
    columns += [unknowns.columns("calibration", int(k)) for k in np.flatnonzero(users > 1)]
    return np.concatenate(columns)
