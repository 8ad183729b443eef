"""Stiff ties: observations that were stated of the model, so stiff that nothing controls them.

A member of a rig is tied to its carrier by a relative pose with a play of a micrometre; a condition
between shapes may have as small a standard deviation. Their redundancy numbers are near zero, as
the tie gives way by r of any error in it. That is their purpose, and no weakness of a measurement.
"""

from __future__ import annotations

import numpy as np

from ..types import Mask
from .reliability import Reliability

STIFF = 1e-4
"""Redundancy number below which a stated observation counts as a stiff tie: an error of 10 µm in it
moves its residual by a nanometre."""


def stiff_ties(rel: Reliability) -> Mask:
    """Return which rows belong to stiff ties of the model, (n_rows,).

    An observation is one if it was stated and not measured, see `Observation.stated`, and none of
    its redundancy numbers reaches `STIFF`.
    """
    out = np.zeros(len(rel.redundancy_numbers), dtype=bool)
    observations = rel.solution.network.observations
    for block in rel.solution.equations.blocks:
        if block.prior or block.by_axis or not block.named:
            continue
        numbers = np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)
        for i in np.flatnonzero((rel.redundancy_numbers[numbers] < STIFF).all(axis=1)).tolist():
            found = observations.get(block.ids[i])
            out[numbers[i]] = found is not None and found.stated
    return out
