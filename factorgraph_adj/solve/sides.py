"""Points in front of their cameras: steps keep them in front, and solutions are checked for it.

Steps keep the sign of principal distances, too, and take no more than half of one: with c = 0 all
image points are at the principal point, which is a minimum of its own, and beyond it images are
mirrored.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError, Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Mask

MOST_SHORTENED = 0.5
"""Largest part of a principal distance that a step may take."""


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
        The state after the step; none: the cameras themselves pass points, or shorten too much.
    """
    if not _keeps_principal_distances(equations, state, moved):
        return None
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


def _keeps_principal_distances(equations: Equations, state: State, moved: State) -> bool:
    """Return whether a step leaves enough of each principal distance."""
    unknowns, before = equations.unknowns, state["calibration"]
    if not (equations.rays and before.size):
        return True
    ratio = moved["calibration"][:, 0] / np.where(before[:, 0] == 0.0, np.nan, before[:, 0])
    shorter = np.flatnonzero(ratio < 1.0 - MOST_SHORTENED).tolist()
    return not any(unknowns.component_names("calibration", i)[0] == "c" for i in shorter)


def ended_behind(equations: Equations, start: State, state: State) -> str:
    """Say which points an iteration has taken behind cameras that saw them; empty: none.

    Args:
        equations: the network.
        start: the state in which it began.
        state: the state in which it ended.
    """
    labels = []
    for place, chunks in equations.rays.items():
        passed = np.flatnonzero((chunks.depths(state) <= 0) & (chunks.depths(start) > 0))
        labels += [equations.blocks[place].labels(i) for i in passed[:1].tolist()] * len(passed)
    if not labels:
        return ""
    if len(labels) == 1:
        return f"the point of {labels[0]} ended behind the camera, which saw it at the start"
    what = (
        f"the points of {len(labels)} image points ended behind cameras that saw them at the start"
    )
    return f"{what}, such as {labels[0]}"


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
