"""What is said of another minimum of the same observations."""

from __future__ import annotations

import numpy as np

from ..solve.solution import Solution


def describe_other_minimum(ours: Solution, theirs: Solution) -> str:
    """Return a sentence on the minimum ``theirs``, seen from ``ours``.

    It has both vᵀPv, and the point whose places in the two are farthest apart.
    """
    told = f"another minimum has vᵀPv {theirs.vtpv:.6g} instead of {ours.vtpv:.6g}"
    unknowns, there = ours.equations.unknowns["point"], theirs.equations.unknowns["point"]
    names = [n for n in unknowns.names if n in there.number]
    if names:
        apart = [float(np.linalg.norm(ours.point(n) - theirs.point(n))) for n in names]
        name = names[int(np.argmax(apart))]
        at = ", ".join(f"{x:.4f}" for x in theirs.point(name))
        told += f", with point {name!r} at {at}, {max(apart):.3g} m away"
    return told
