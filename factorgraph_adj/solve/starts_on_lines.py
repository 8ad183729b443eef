"""Starts that lie exactly on a line from which an offset was measured.

The distance from a line has a value on the line, zero, but no partials there: every direction
across the line is the same. Nominal coordinates are just that. A start is moved aside by some
micrometres, and an adjustment with little weight on such offsets brings it to the side where the
other observations have it.
"""

from __future__ import annotations

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..observations import KINDS
from ..types import Index, Mask

SIGMA_OF_MOVE = 1e-6
"""Standard deviation of a move, metres or radians: a thousand times the resolution of a geocentric
coordinate, and far below what offsets measure."""
LIGHT_WEIGHT = 1e-6
"""Factor on the weights of offsets without a direction, while others bring the start to a side."""
MOST_BESIDE = 20
"""Largest number of iterations for that."""
MOST_MOVES = 4
"""Largest number of moves; more do not help where all that is free stays on the line."""


def beside_lines(equations: Equations, state: State) -> State:
    """Return the state with unknowns moved off the lines that offsets were measured from.

    Of each offset without a direction its points are moved, and where none is free, or that is not
    enough, all of its unknowns. Where nothing is free the state stays, and its evaluation says so.
    """
    blocks = _one_sided(equations)
    rng, frame = np.random.default_rng(1), equations.network.frame
    for moves in range(MOST_MOVES):
        columns = [
            _moving(equations.unknowns, block, rows, every=moves > 0)
            for block in blocks
            if len(rows := block.without_direction(frame, state))
        ]
        if not columns:
            break
        own = np.unique(np.concatenate(columns))
        step = np.zeros(equations.unknowns.n_columns)
        step[own] = SIGMA_OF_MOVE * rng.standard_normal(len(own))
        state = equations.unknowns.retract(state, step)
    return state


def rows_on_lines(equations: Equations, state: State) -> Mask:
    """Return the rows of offsets that have no direction, (n_rows,)."""
    out = np.zeros(equations.n_rows, dtype=bool)
    for block in _one_sided(equations):
        rows = block.without_direction(equations.network.frame, state)
        out[block.first_row + block.dimension * rows] = True
    return out


def _one_sided(equations: Equations) -> list[Block]:
    return [b for b in equations.blocks if b.kind in KINDS and KINDS[b.kind].one_sided]


def _moving(unknowns: Unknowns, block: Block, rows: Index, *, every: bool) -> Index:
    """Return free columns of some observations: of their points, or of ``every`` unknown."""
    out: list[Index] = [np.zeros(0, dtype=np.intp)]
    for row in rows.tolist():
        own = [(kind, unknowns.columns(kind, int(index[row]))) for kind, index in block.variables]
        free = [(kind, columns[unknowns.free[columns]]) for kind, columns in own]
        points = [columns for kind, columns in free if kind == "point" and len(columns)]
        out += points if points and not every else [columns for _, columns in free]
    return np.concatenate(out)
