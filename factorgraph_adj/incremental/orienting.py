"""Photos that arrive without poses: what orients them, and when it is worth trying.

Resection from known points and what observes a pose come first, as approximate values. Photos for
which these do not suffice are oriented from image points, against photos that stand and among
themselves, as a block is; the part takes its place in the frame from the known photos and points
that it touches. What cannot be oriented waits.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
from scipy import sparse

from ..block_orientation.begin import block_of
from ..block_orientation.block_start import BlockStart
from ..block_orientation.pairs import LEAST_COMMON
from ..errors import ApproximationError, Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..network.network import DatumChoice, Network
from ..types import Mask

DISAGREES = "fewer than two of its image points agree with the photos that were oriented"
"""What a point lacks."""
MISMATCH = "it does not agree with the block that its photo was oriented in"
"""Why an image point waits until its point is known."""


def oriented_block(
    equations: Equations, datum: DatumChoice, state: State, problems: list[Problem]
) -> BlockStart | None:
    """Return the block of photos that were oriented from their image points.

    Args:
        equations: a local network; known variables are held.
        datum: ``free`` for the beginning of a free network.
        state: approximate values as far as they were found, NaN elsewhere.
        problems: what has none.

    Returns:
        None: no photo without a pose has `LEAST_COMMON` points in common with another one, or none
        could be oriented.
    """
    lost: Mask = np.asarray(np.isnan(state["pose"]).any(axis=1))
    if not lost.any() or not _common(equations.network, lost):
        return None
    names = equations.unknowns["pose"].names
    error = ApproximationError(problems, photos=[names[i] for i in np.flatnonzero(lost)])
    with suppress(ApproximationError):
        return block_of(equations, datum, error, whole=False)
    return None


def _common(network: Network, lost: Mask) -> bool:
    """Return whether a photo without a pose has enough points in common with any other."""
    photo, point, _, _ = network.images.columns()
    if not len(photo):
        return False
    ones = np.ones(len(photo), dtype=np.int64)
    table = sparse.csr_array((ones, (photo, point)), shape=(len(lost), len(network.points)))
    common = (table[lost] @ table.T).tocoo()
    own = np.flatnonzero(lost)[common.row] == common.col
    return bool((common.data[~own] >= LEAST_COMMON).any())


def how_oriented(local: Network, block: BlockStart | None) -> Mapping[str, str]:
    """Return in words how the photos of a local network that enter were oriented.

    Args:
        local: the local network, in which known photos and points are held.
        block: the block that was oriented from image points; none: no photo was.
    """
    out: dict[str, str] = {}
    of_block = {} if block is None else {f: p for p in block.parts for f in p.photos}
    photo, point, _, _ = local.images.columns()
    held = np.array([all(p.fixed) for p in local.points.values()], dtype=bool)
    known = np.bincount(photo[held[point]], minlength=len(local.photos)) if len(photo) else ()
    for number, (name, f) in enumerate(local.photos.items()):
        if f.rotation is not None:
            continue
        part = of_block.get(name)
        if part is not None:
            standing = sum(local.photos[o].rotation is not None for o in part.photos)
            among = f"{len(part.photos)} photos" + (f", {standing} of which stood" * bool(standing))
            out[name] = (
                f"from image points among {among}: start pair {part.start[0]}, {part.start[1]}; "
                f"{part.datum}"
            )
        elif len(known) and known[number] >= 3:
            out[name] = f"by resection from {known[number]} known points"
        else:
            out[name] = "by approximate values of what entered with it"
    return out
