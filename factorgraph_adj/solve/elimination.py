"""The layers of the elimination; they are made once for a network, before the first iteration.

Three layers, in the order of elimination:

1. ``points``: object points that only cameras see (and their own coordinates), in numpy;
2. ``tree``: everything else on the terrestrial side, by GTSAM;
3. poses and calibrations of the cameras of layer 1, in dense fronts, by LAPACK.

In large networks the third layer takes the second one in. GTSAM eliminates all unknowns where a
small network has no points of the first layer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import Unknowns
from ..models.variables import UNKNOWNS, VariableKind
from ..types import Index, Mask

if TYPE_CHECKING:
    import gtsam


LARGEST_TREE = 1000
"""Number of variables above which the terrestrial side is eliminated in dense fronts by Cholesky.
GTSAM's QR keeps twice the digits; in large networks its cost for each variable counts."""
LARGEST_TREE_BESIDE_CAMERAS = 30
"""The same number beside photos: GTSAM's QR leaves a dense matrix over their unknowns, whose making
takes longer than all fronts."""
MOST_JOINED = 8
"""Number of photos that one variable at no point may join before its elimination by GTSAM, which
leaves a dense matrix over all of them, takes longer than a full column of the reduced system."""
MOST_SPREAD = 60
"""Largest number of variables at no point, such as distance meters, for which this is done: they
are full columns of the reduced system."""


@dataclass
class Layers:
    """Columns of the three layers, and index lists that every iteration uses."""

    unknowns: Unknowns
    """The unknowns."""
    reduced: Mask
    """Points of the first layer, (number of points,)."""
    cameras: Mask
    """Columns of the third layer, (n_columns,)."""
    tree: tuple[tuple[VariableKind, int], ...]
    """Variables of the second layer."""
    in_fronts: bool = False
    """Whether the terrestrial side is in the third layer too, and the second one is empty."""
    kept: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Columns that are not eliminated, because other parts of the network have them too, (m,)."""
    ordering: gtsam.Ordering | None = None
    """Order of elimination of the second layer; none before it has been computed."""

    @property
    def has_cameras(self) -> bool:
        """Whether there is a third layer."""
        return bool(self.cameras.any())

    @cached_property
    def columns_at(self) -> dict[int, Index]:
        """Columns of each variable, by its first column."""
        return {k: np.arange(k, k + size) for k, size in self.unknowns.size_at.items()}

    @cached_property
    def point_columns(self) -> Index:
        """Columns of the points of the first layer, (p, 3)."""
        first = self.unknowns["point"].offset[self.reduced]
        return np.asarray(first[:, None] + np.arange(3), dtype=np.intp)


def layers_of(
    equations: Equations, *, reduce_points: bool, touched: Mask, kept: Index | None = None
) -> Layers:
    """Divide the unknowns into the three layers.

    Args:
        equations: the network.
        reduce_points: whether there is a first layer; false leaves all unknowns to GTSAM (QR, for
            systems of poor condition).
        touched: columns of factors that the user added; their points stay in the tree.
        kept: columns that are not eliminated, because other parts of the network have them too;
            everything but the first layer is then in the third one. None: all are eliminated.
    """
    if kept is not None:
        touched = touched.copy()
        touched[kept] = True
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
    cameras = np.zeros(unknowns.n_columns, dtype=bool)
    for block in images:
        (_, photo), (_, calibration), (_, point) = block.variables
        keep = reduced[point]
        for kind, numbers in (("pose", photo), ("calibration", calibration)):
            for number in np.unique(numbers[keep]).tolist():
                cameras[unknowns.columns(kind, number)] = True
    tree: list[tuple[VariableKind, int]] = []
    for kind in unknowns.tables:
        offset = unknowns[kind].offset
        inside = (offset >= 0) & ~cameras[np.maximum(offset, 0)]
        if kind == "point":
            inside &= ~reduced
        tree += [(kind, number) for number in np.flatnonzero(inside).tolist()]
    largest = min(LARGEST_TREE, LARGEST_TREE_BESIDE_CAMERAS) if cameras.any() else LARGEST_TREE
    # Rows beside the observations join what they touch as if it were a part of the tree.
    size = len(tree) + int(touched.sum()) // UNKNOWNS["pose"].size
    large = size > largest and len(_spread(tree)) <= MOST_SPREAD
    large = large or _joined(equations, _spread(tree), cameras) > MOST_JOINED
    if kept is not None or (reduce_points and large):
        every = np.ones(unknowns.n_columns, dtype=bool)
        first = table.offset[reduced]
        every[(first[:, None] + np.arange(3)).ravel()] = False
        if kept is None:
            kept = np.zeros(0, dtype=np.intp)
        return Layers(unknowns, reduced, every, (), in_fronts=True, kept=kept)
    return Layers(unknowns, reduced, cameras, tuple(tree))


def outside(equations: Equations, layers: Layers, place: int) -> Index:
    """Return the observations of a block that are in no cluster and have no point of layer 1.

    Args:
        equations: the network.
        layers: the layers.
        place: place of the block in the network.
    """
    block = equations.blocks[place]
    keep = np.ones(block.n, dtype=bool)
    if place in equations.in_cluster:
        keep[equations.in_cluster[place]] = False
    for kind, index in block.variables:
        if kind == "point":
            keep &= ~layers.reduced[index]
    return np.flatnonzero(keep)


def _spread(tree: Sequence[tuple[VariableKind, int]]) -> list[tuple[VariableKind, int]]:
    """Return the variables of a tree that stand neither at a point nor in a photo."""
    placed = ("point", "pose", "calibration")
    return [v for v in tree if v[0] not in placed and not UNKNOWNS[v[0]].at_point]


def _joined(equations: Equations, spread: Sequence[tuple[VariableKind, int]], cameras: Mask) -> int:
    """Return with how many photos of the third layer one variable shares observations, at most.

    Args:
        equations: the network.
        spread: variables of the tree at no point.
        cameras: columns of the third layer, (n_columns,).
    """
    kinds = {kind for kind, _ in spread}
    poses = equations.unknowns["pose"]
    inside = (poses.offset >= 0) & cameras[np.maximum(poses.offset, 0)]
    pairs: dict[VariableKind, list[Index]] = {kind: [] for kind in kinds}
    for block in equations.blocks:
        photos = [index for kind, index in block.variables if kind == "pose"]
        for kind, index in block.variables:
            if kind in kinds:
                own = equations.unknowns[kind].offset[index] >= 0
                for photo in photos:
                    on = own & inside[photo]
                    pairs[kind].append(index[on] * len(inside) + photo[on])
    most = 0
    for found in pairs.values():
        if found:
            codes = np.unique(np.concatenate(found))
            most = max(most, int(np.bincount(codes // max(len(inside), 1)).max(initial=0)))
    return most
