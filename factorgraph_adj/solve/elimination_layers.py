"""The layers of the elimination; a network makes them once, before the first iteration.

Three layers, in the order of elimination:

1. ``points``: object points that only cameras see (and their own coordinates), in numpy; in dense
   fronts also points that only cameras and instruments in frames of their own see;
2. ``tree``: everything else on the terrestrial side, by GTSAM;
3. poses and calibrations of the cameras of layer 1, in dense fronts, by LAPACK.

In large networks the third layer takes the second one in. GTSAM eliminates all unknowns where a
small network has no points of the first layer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import Unknowns
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind
from ..types import Index, Mask

if TYPE_CHECKING:
    import gtsam

MAX_TREE_VARIABLES = 1000
"""Number of variables above which the terrestrial side is eliminated in dense fronts by Cholesky.
GTSAM's QR keeps twice the digits; in large networks its cost for each variable counts."""
MAX_TREE_VARIABLES_BESIDE_CAMERAS = 30
"""The same number beside photos: GTSAM's QR leaves a dense matrix over their unknowns, whose making
takes longer than all fronts."""
MAX_PHOTOS_JOINED = 30
"""Largest number of photos that an unknown at no point, such as the mount of a rig, may join in
GTSAM's elimination, which leaves a dense matrix over them."""
MAX_SPREAD_VARIABLES = 60
"""Largest number of variables at no point, such as distance meters, for which this is done: they
are full columns of the reduced system."""
MAX_PLACED_IN_BORDER = 8
"""Largest number of frames, sizes and levels that are full columns too; more of them are nodes,
whose width all nodes then have. The same number for drifts and mounts of a few photos."""
MAX_PHOTO_NODE_COMPONENTS = 9
"""Largest number of components of an unknown of a few photos that is a node: a shift with linear
and quadratic terms."""


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
    alone: Mapping[VariableKind, Index] = field(default_factory=dict)
    """Numbers of the variables at no point that are nodes, and not columns that touch everything:
    frames, sizes and levels, and what only a few photos have, such as the drift of a strip."""
    kept: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Columns that are not eliminated, because other parts of the network have them too, (m,)."""
    ordering: gtsam.Ordering | None = None
    """Order of elimination of the second layer; none before it has been computed."""

    @property
    def has_cameras(self) -> bool:
        """Whether there is a third layer."""
        return bool(self.cameras.any())

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
    images = [b for b in equations.blocks if b.image]
    if reduce_points and images:
        for block in images:
            reduced[block.variables[2][1]] = True
        reduced &= table.offset >= 0
        for place, block in enumerate(equations.blocks):
            if block.image:
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
    largest = (
        min(MAX_TREE_VARIABLES, MAX_TREE_VARIABLES_BESIDE_CAMERAS)
        if cameras.any()
        else MAX_TREE_VARIABLES
    )
    # Rows beside the observations join what they touch as if it were a part of the tree.
    size = len(tree) + int(touched.sum()) // UNKNOWNS["pose"].size
    placed = sum(is_placed(kind) for kind, _ in tree)
    many_placed = placed > MAX_PLACED_IN_BORDER
    large = size > largest or _joined(equations, cameras, tree) > MAX_PHOTOS_JOINED
    nodes = _of_few_photos(equations, tree)
    if many_placed:
        nodes |= _numbers(tree, is_placed)
    large &= _spread(tree) - sum(len(numbers) for numbers in nodes.values()) <= MAX_SPREAD_VARIABLES
    if kept is not None or (reduce_points and large):
        if many_placed and reduce_points:
            reduced = _seen_in_frames(equations, touched)
        every = np.ones(unknowns.n_columns, dtype=bool)
        first = table.offset[reduced]
        every[(first[:, None] + np.arange(3)).ravel()] = False
        if kept is None:
            kept = np.zeros(0, dtype=np.intp)
        return Layers(unknowns, reduced, every, (), in_fronts=True, alone=nodes, kept=kept)
    return Layers(unknowns, reduced, cameras, tuple(tree))


def _seen_in_frames(equations: Equations, touched: Mask) -> Mask:
    """Return the points that only cameras and instruments in frames see, (number of points,).

    No observation joins two of them: points at the origins of frames are in the other layers. With
    photos, a point that is sighted from a free one is so too, as leverages of points alone
    (`factorgraph_adj.solve.leverages.point_leverages`) then have no photos between them.
    """
    photos = any(block.lens is not None for block in equations.blocks)
    table = equations.unknowns["point"]
    seen = np.zeros(len(table.names), dtype=bool)
    joined = table.offset < 0
    for place, block in enumerate(equations.blocks):
        points = [index for kind, index in block.variables if kind == "point"]
        if not points:
            continue
        target, *others = points
        clustered = equations.in_cluster.get(place)
        if clustered is not None:
            joined[target[clustered]] = True
        if len(block.variables) == 1:
            continue
        if block.lens is None and "frame" not in block.named:
            for index in points:
                joined[index] = True
            continue
        seen[target] = True
        for index in others:
            joined[index] = True
            if photos:
                joined[target[table.offset[index] >= 0]] = True
    on = np.flatnonzero(table.offset >= 0)
    joined[on[touched[table.offset[on]]]] = True
    return np.asarray(seen & ~joined)


def rows_outside_first_layer(equations: Equations, layers: Layers, place: int) -> Index:
    """Return the observations of a block that are in no cluster and touch the other layers.

    Image points and coordinates of points of layer 1 are in no sum of the others; what joins such
    a point with other unknowns is.

    Args:
        equations: the network.
        layers: the layers.
        place: place of the block in the network.
    """
    block = equations.blocks[place]
    keep = np.ones(block.n, dtype=bool)
    if place in equations.in_cluster:
        keep[equations.in_cluster[place]] = False
    if block.lens is not None or len(block.variables) == 1:
        for kind, index in block.variables:
            if kind == "point":
                keep &= ~layers.reduced[index]
    return np.flatnonzero(keep)


def _joined(equations: Equations, cameras: Mask, tree: Sequence[tuple[VariableKind, int]]) -> int:
    """Return the largest number of photos that one unknown of a tree at no point joins."""
    offset = equations.unknowns["pose"].offset
    photos = (offset >= 0) & cameras[np.maximum(offset, 0)]
    most = 0
    for kind, numbers in _numbers(tree, _stands_nowhere).items():
        every = _photos_of(equations, kind)
        every = every[photos[every[:, 1]] & np.isin(every[:, 0], numbers)]
        most = max(most, int(np.bincount(every[:, 0]).max(initial=0)))
    return most


def _of_few_photos(
    equations: Equations, tree: Sequence[tuple[VariableKind, int]]
) -> dict[VariableKind, Index]:
    """Return numbers of the variables that a few photos have, and no points; none if they are few.

    Frames, sizes and levels are none of them.
    """
    out: dict[VariableKind, Index] = {}
    for kind, numbers in _numbers(tree, lambda k: _stands_nowhere(k) and not is_placed(k)).items():
        size = equations.unknowns[kind].size
        met = _photos_of(equations, kind)
        photos = np.bincount(met[:, 0], minlength=len(size))
        few = (photos > 0) & (photos <= MAX_PHOTOS_JOINED) & (size <= MAX_PHOTO_NODE_COMPONENTS)
        for block in equations.blocks:
            if any(what == "point" for what, _ in block.variables):
                for what, index in block.variables:
                    if what == kind:
                        few[index[index >= 0]] = False
        out[kind] = numbers[few[numbers]]
    return out if sum(len(numbers) for numbers in out.values()) > MAX_PLACED_IN_BORDER else {}


def _numbers(
    tree: Sequence[tuple[VariableKind, int]], belongs: Callable[[VariableKind], bool]
) -> dict[VariableKind, Index]:
    """Return the numbers of the variables of some kinds in a tree, by kind."""
    out: dict[VariableKind, list[int]] = {}
    for kind, number in tree:
        if belongs(kind):
            out.setdefault(kind, []).append(number)
    return {kind: np.array(numbers, dtype=np.intp) for kind, numbers in out.items()}


def _photos_of(equations: Equations, kind: VariableKind) -> Index:
    """Return the pairs of a variable of a kind and a photo that observations join, (m, 2)."""
    n = max(len(equations.unknowns["pose"].names), 1)
    codes = [np.zeros(0, dtype=np.intp)]
    for block in equations.blocks:
        own = [index for what, index in block.variables if what == kind]
        photos = [index for what, index in block.variables if what == "pose"]
        codes += [a[on] * n + b[on] for a in own for b in photos for on in ((a >= 0) & (b >= 0),)]
    return np.stack(np.divmod(np.unique(np.concatenate(codes)), n), axis=1).astype(np.intp)


def _stands_nowhere(kind: VariableKind) -> bool:
    """Return whether unknowns of a kind stand neither at a point nor in a photo."""
    return kind not in ("point", "pose", "calibration") and not UNKNOWNS[kind].at_point


def first_point(block: Block) -> int | None:
    """Return the place of the first point among the variables of a block; none: there is none.

    It is the one that may be in the first layer.
    """
    return next((j for j, (kind, _) in enumerate(block.variables) if kind == "point"), None)


def is_placed(kind: VariableKind) -> bool:
    """Return whether unknowns of a kind, such as frames, may be nodes without a point."""
    record = UNKNOWNS[kind]
    return record.late == 1 and kind not in ENTITIES and not record.at_point


def _spread(tree: Sequence[tuple[VariableKind, int]]) -> int:
    """Return how many variables of a tree stand neither at a point nor in a photo."""
    return sum(_stands_nowhere(kind) for kind, _ in tree)
