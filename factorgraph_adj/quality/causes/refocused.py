"""A principal distance that changed on the way: a camera was refocused between two photos.

All photos from one on, in the order of the network, have the principal distance c + ∇. The column
of ∇ is ∂f/∂c of their image coordinates.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_array, csc_array

from ...errors import InputError
from ...graph.equations import Equations
from ...graph.variables import State
from ...types import Array, Index
from .hypotheses import Hypotheses

LEAST = 2
"""Smallest number of photos before and after the change: that of one is not told from its place."""
MAX_ENTRIES = 2_000_000
"""Largest number of image points times photos of a camera with which a change is looked for."""
C = "c"
"""Name of the principal distance among the components of a calibration."""


def refocused(equations: Equations, state: State) -> Iterator[Hypotheses]:
    """Iterate over cameras, with a change of the principal distance at each of their photos.

    Args:
        equations: the observation equations.
        state: values of all variables.
    """
    unknowns = equations.unknowns
    for row, photo, camera, by_c in _rays(equations, state):
        for number in np.unique(camera).tolist():
            at = np.flatnonzero(camera == number)
            seen, place = np.unique(photo[at], return_inverse=True)
            starts = np.arange(LEAST, len(seen) - LEAST + 1)
            if not len(starts) or len(at) * len(seen) > MAX_ENTRIES:
                continue
            ray, change = np.nonzero(place.ravel()[:, None] >= starts)
            rows, values = row[at[ray]], by_c[at[ray]]
            column = np.broadcast_to(change[:, None], rows.shape)
            entries = coo_array(
                (values.ravel(), (rows.ravel(), column.ravel())),
                shape=(equations.n_rows, len(starts)),
            )
            name = unknowns["calibration"].names[number]
            where = tuple(
                f"from photo {unknowns['pose'].names[p]!r} on, of camera {name!r}"
                for p in seen[starts].tolist()
            )
            cause = "the principal distance, another one"
            yield Hypotheses(cause, ("image",), (), where, csc_array(entries), rank=2)


def _rays(equations: Equations, state: State) -> Iterator[tuple[Index, Index, Index, Array]]:
    """Iterate over blocks of image points with a principal distance.

    Yields rows (n, 2), numbers of the photos and of the calibrations (n,), and ∂f/∂c (n, 2).
    """
    for block in equations.blocks:
        if block.lens is None or C not in block.lens.names:
            continue
        kinds = [kind for kind, _ in block.variables]
        try:
            found = block.evaluate(equations.network.frame, state)
        except InputError:
            continue
        by_c = found.jacobians[kinds.index("calibration")][:, :, block.lens.names.index(C)]
        rows = np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)
        photo, camera = (block.variables[kinds.index(k)][1] for k in ("pose", "calibration"))
        yield rows, photo, camera, by_c
