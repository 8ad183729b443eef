"""Points in front of their cameras: steps keep them in front, and solutions are checked for it."""

from __future__ import annotations

import numpy as np

from ..errors import InputError, Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Mask


def behind(equations: Equations, state: State) -> Mask:
    """Return whether each image point has its object point behind the camera, block by block."""
    out = [np.zeros(0, dtype=bool)]
    out += [chunks.depths(state) <= 0 for chunks in equations.rays.values()]
    return np.concatenate(out)


def before_the_cameras(equations: Equations, state: State, moved: State) -> State | None:
    """Hold points that a step would take from the front of a camera to behind it.

    Such a step passes the focal plane or infinity, where vᵀPv does not descend continuously.

    Args:
        equations: the network.
        state: the state before the step.
        moved: the state after the step.

    Returns:
        The state after the step; none: the cameras themselves pass points.
    """
    now = behind(equations, moved)
    if not now.any():
        return moved
    passes = now & ~behind(equations, state)
    if not passes.any():
        return moved
    point = np.concatenate([b.variables[2][1] for b in equations.blocks if b.kind == "image"])
    held = np.unique(point[passes])
    points = moved["point"].copy()
    points[held] = state["point"][held]
    kept: State = {**moved, "point": points}
    still = behind(equations, kept) & ~behind(equations, state)
    return None if still.any() else kept


def refuse_points_behind(equations: Equations, state: State) -> None:
    """Raise an error that names image points whose object point lies behind the camera."""
    problems = []
    for place, chunks in equations.rays.items():
        block = equations.blocks[place]
        photo = block.variables[0][1]
        wrong = chunks.depths(state) <= 0
        for number in np.unique(photo[wrong]).tolist():
            rows = np.flatnonzero(photo == number)
            name = equations.unknowns["pose"].names[number]
            if wrong[rows].all():
                problems.append(
                    Problem(
                        f"all {len(rows)} points lie behind it: is its attitude, or the direction"
                        " of the camera's axes, as it should be?",
                        f"photo {name!r}",
                    )
                )
                continue
            problems += [
                Problem("the adjusted point lies behind the camera", block.labels(int(i)))
                for i in rows[wrong[rows]]
            ]
    if problems:
        raise InputError(problems)
