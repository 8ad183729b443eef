"""Lengths of levelled lines that contradict the places of their ends: metres for kilometres."""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State

FAR = 100.0
"""Ratio of the stated length to the distance of the ends, or its inverse, from which it is doubted:
no line is shorter than the straight one, and none takes a hundred times the way."""
APART = 1.0
"""Smallest horizontal distance of ends that is compared, metres."""


def wrong_line_lengths(equations: Equations, state: State) -> list[str]:
    """Return doubts about stated lengths of levelled lines.

    Args:
        equations: the network.
        state: coordinates of all points, adjusted or approximate.
    """
    out = []
    for block in equations.blocks:
        ends = [index for kind, index in block.variables if kind == "point"]
        if block.prior or len(ends) < 2:
            continue
        found = (equations.network.observations.get(i) for i in block.ids)
        stated = np.array([getattr(o, "length_km", None) or np.nan for o in found], dtype=float)
        rows = np.flatnonzero(np.isfinite(stated))
        if not len(rows):
            continue
        start, end = (state["point"][index[rows]] for index in ends[:2])
        enu = equations.network.frame.basis(start, np.zeros((len(rows), 2))).enu
        apart = np.hypot(*np.einsum("nij,nj->in", enu, end - start)[:2])
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(apart > APART, 1e3 * stated[rows] / apart, np.nan)
        wrong = np.flatnonzero((ratio > FAR) | (ratio < 1.0 / FAR))
        if not len(wrong):
            continue
        first = int(wrong[0])
        length, way = float(stated[rows[first]]), float(apart[first])
        unit = "metres" if ratio[first] > FAR else "thousands of kilometres"
        many = f"of {len(wrong)} lines" if len(wrong) > 1 else "of a line"
        out.append(
            f"the lengths {many} contradict the places of their ends, the first "
            f"{block.labels(int(rows[first]))}: {length:g} km between points {way:.1f} m apart; "
            f"are they in {unit}? The weights of these lines depend on them"
        )
    return out
