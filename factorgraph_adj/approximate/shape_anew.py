"""One shape fitted anew to its points, whatever its present values are."""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..models.variables import UNKNOWNS
from .shapes import Fit, every_part


def shape_anew(equations: Equations, state: State, f: int) -> State | None:
    """Return a state with the free components and sizes of one shape from its points alone.

    Args:
        equations: the network.
        state: its values.
        f: number of the frame of the shape.

    Returns:
        The state; none where no shape was found.
    """
    parts = [part for number, part in every_part(equations) if number == f]
    table = equations.unknowns["frame"]
    given = np.where(table.free[f], np.nan, UNKNOWNS["frame"].given(state["frame"][f][None])[0])
    lost = sizes_of(equations, f)
    anew = {**state, "frame": state["frame"].copy()}
    anew["frame"][f, :13] = np.nan
    for kind, number in lost:
        anew[kind] = anew[kind].copy()
        anew[kind][number] = np.nan
    with np.errstate(all="ignore"):  # trials may be anything
        what = Fit(equations, anew, f, parts, lost, given).run()
    found = not what and np.isfinite(anew["frame"][f]).all()
    return anew if found else None


def sizes_of(equations: Equations, f: int) -> list[tuple[str, int]]:
    """Return kind and number of the free sizes of a shape, by the number of its frame."""
    parts = (part for number, part in every_part(equations) if number == f)
    keys = dict.fromkeys((k, int(i)) for p in parts for k, n in p.sizes for i in np.unique(n))
    return [(k, i) for k, i in keys if equations.unknowns[k].free[i].any()]
