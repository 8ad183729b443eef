"""Elimination layers: points only cameras (or instruments in frames) see, the rest; Cholesky or QR.

Two layers, in the order of elimination:

1. object points that only cameras see (and their own coordinates), in numpy; where many frames are
   unknowns, also points that only cameras and instruments in frames of their own see;
2. everything else, in dense fronts by LAPACK.

Where the first layer is empty and the network is not large, the fronts are factorised by QR of the
observations (`factorgraph_adj.solve.qr_fronts`), which keeps twice the digits of normal equations;
so is any network whose normal equations turn out to be too poor. There the points of the first
layer are fronts of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import Unknowns
from ..models.unknown_registry import ENTITIES, UNKNOWNS, VariableKind
from ..types import NO_ROWS, Index, Mask


@dataclass(frozen=True)
class EliminationRule:
    """Sizes that choose how a network is eliminated.

    ``python -m tests.benchmarks.eliminations`` measures what depends on the machine; its figures
    are in docs/benchmarks.md.
    """

    max_qr_variables: int = 1000
    """Largest number of variables of a network without a first layer that is factorised by QR: it
    costs about ten milliseconds more than Cholesky there, for twice the digits."""
    max_placed_in_border: int = 8
    """Largest number of frames, sizes and levels that are full columns of the border; more of them
    are nodes, whose width all nodes then have. The same number for drifts and mounts of a few
    photos."""
    max_photos_joined: int = 30
    """Largest number of photos that the node of an unknown at no point, such as the mount of a rig,
    may join: a node that joins more makes larger fronts than a column of the border."""
    max_photo_node_components: int = 9
    """Largest number of components of an unknown of a few photos that is a node: a shift with
    linear and quadratic terms."""
    max_point_node_columns: int = 8
    """Largest number of columns of the node of a point: its coordinates, and some unknowns at
    it."""


RULE = EliminationRule()
"""The rule."""


@dataclass
class Layers:
    """Columns of the layers, and index lists that every iteration uses."""

    unknowns: Unknowns
    """The unknowns."""
    reduced: Mask
    """Points of the first layer, (number of points,)."""
    in_fronts: Mask
    """Columns of the second layer, (n_columns,)."""
    by_qr: bool
    """Whether the fronts are factorised by QR; the first layer is then empty."""
    leaves: Mask
    """Points that are fronts of their own, (number of points,); only with QR."""
    touched: Mask
    """Columns of factors that the user added, (n_columns,); their points are in no first layer."""
    alone: Mapping[VariableKind, Index] = field(default_factory=dict)
    """Numbers of the variables at no point that are nodes, and not columns that touch everything:
    frames, sizes and levels, and what only a few photos have, such as the drift of a strip."""
    kept: Index = field(default_factory=lambda: NO_ROWS)
    """Columns that are not eliminated, because other parts of the network have them too, (m,)."""

    @cached_property
    def point_columns(self) -> Index:
        """Columns of the points of the first layer, (p, 3)."""
        first = self.unknowns["point"].offset[self.reduced]
        return np.asarray(first[:, None] + np.arange(3), dtype=np.intp)


def layers_of(
    equations: Equations, *, reduce_points: bool, touched: Mask, kept: Index | None = None
) -> Layers:
    """Divide the unknowns into the layers.

    Args:
        equations: the network.
        reduce_points: whether there is a first layer; false factorises everything by QR, for
            systems of poor condition.
        touched: columns of factors that the user added; their points are in no first layer.
        kept: columns that are not eliminated, because other parts of the network have them too;
            the fronts are then factorised by Cholesky. None: all are eliminated.
    """
    if kept is not None:
        touched = touched.copy()
        touched[kept] = True
    unknowns = equations.unknowns
    offset = unknowns["point"].offset
    reduced = _seen_by_cameras(equations, touched)
    variables = list(unknowns.active())
    # Rows beside the observations join what they touch as if they were variables.
    size = len(variables) + int(touched.sum()) // UNKNOWNS["pose"].size
    small = kept is None and not reduced.any() and size <= RULE.max_qr_variables
    by_qr = small or not reduce_points
    nodes = _of_few_photos(equations, variables)
    if sum(is_placed(kind) for kind, _ in variables) > RULE.max_placed_in_border:
        nodes |= _numbers(variables, is_placed)
        if not by_qr:
            reduced = _seen_in_frames(equations, touched)
    none = np.zeros(len(reduced), dtype=bool)
    reduced, leaves = (none, reduced) if by_qr else (reduced, none)
    inside = np.ones(unknowns.n_columns, dtype=bool)
    inside[(offset[reduced][:, None] + np.arange(3)).ravel()] = False
    kept = NO_ROWS if kept is None else kept
    return Layers(unknowns, reduced, inside, by_qr, leaves, touched, nodes, kept)


def _seen_by_cameras(equations: Equations, touched: Mask) -> Mask:
    """Return the points that only cameras see, (number of points,)."""
    table = equations.unknowns["point"]
    seen = np.zeros(len(table.names), dtype=bool)
    for place in equations.rays:
        seen[equations.blocks[place].variables[2][1]] = True
    seen &= table.offset >= 0
    if not seen.any():
        return seen
    for place, block in enumerate(equations.blocks):
        if place in equations.rays:
            continue
        alone = len(block.variables) == 1
        for kind, index in block.variables:
            if kind == "point":
                if not alone:
                    seen[index] = False
                elif place in equations.in_cluster:
                    seen[index[equations.in_cluster[place]]] = False
    if touched.any():
        on = np.flatnonzero(table.offset >= 0)
        seen[on[touched[table.offset[on]]]] = False
    return seen


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
        few = (
            (photos > 0)
            & (photos <= RULE.max_photos_joined)
            & (size <= RULE.max_photo_node_components)
        )
        for block in equations.blocks:
            if any(what == "point" for what, _ in block.variables):
                for what, index in block.variables:
                    if what == kind:
                        few[index[index >= 0]] = False
        out[kind] = numbers[few[numbers]]
    return out if sum(len(numbers) for numbers in out.values()) > RULE.max_placed_in_border else {}


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
    """Return whether unknowns of a kind are neither at a point nor in a photo."""
    record = UNKNOWNS[kind]
    return kind not in ENTITIES and not record.at_point and not record.in_photo


def first_point(block: Block) -> int | None:
    """Return the place of the first point among the variables of a block; None: there is none.

    It is the one that may be in the first layer.
    """
    return next((j for j, (kind, _) in enumerate(block.variables) if kind == "point"), None)


def is_placed(kind: VariableKind) -> bool:
    """Return whether unknowns of a kind, such as frames, may be nodes without a point."""
    return UNKNOWNS[kind].late == 1 and _stands_nowhere(kind)
