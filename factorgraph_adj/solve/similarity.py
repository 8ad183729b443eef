"""Finite similarity transformations of a part of a network along the motions of its datum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..models.sub_frame import split_frame
from ..models.variables import ROTATION
from ..rotation import exp_rotation
from ..types import Array, Index, Mask
from .datum import Defect, in_part
from .stations import places_of


def transform(equations: Equations, state: State, defect: Defect, amounts: Array) -> State:
    """Move the part of a defect by a finite similarity transformation.

    Points and projection centres: X ← c + e^s R (X − c) + t; attitudes turn with R, and arms of
    mounts grow by e^s. Orientation unknowns, verticals and scales of distance meters follow
    linearly; the next step of the adjustment corrects their second-order terms, and those of
    motions that do not commute.

    Args:
        equations: the network.
        state: the values before the motion.
        defect: the motions that may be used, at ``state``.
        amounts: amount of each motion, (d,).
    """
    centre, size = defect.about
    motion = defect.mixture @ amounts
    moved = equations.unknowns.retract(state, defect.motions @ amounts)
    rotation = exp_rotation(motion[3:6] / size)
    factor = np.exp(motion[6] / size)
    inside = np.zeros(equations.unknowns.n_columns, dtype=bool)
    inside[defect.part] = True

    def place(x: Array) -> Array:
        return np.asarray(centre + factor * (x - centre) @ rotation.T + motion[:3])

    table = equations.unknowns["point"]
    on = in_part(table, inside)
    points = np.where(on[:, None] & table.free, place(state["point"]), moved["point"])
    table = equations.unknowns["pose"]
    on = in_part(table, inside) & table.free.all(axis=1)
    poses = moved["pose"].copy()
    turned = rotation @ state["pose"][on, :9].reshape(-1, 3, 3)
    poses[on, :9] = turned.reshape(-1, 9)
    poses[on, 9:] = place(state["pose"][on, 9:])
    table = equations.unknowns["frame"]
    numbers = np.flatnonzero(in_part(table, inside))
    frames = moved["frame"].copy()
    origins = places_of(equations, "frame", numbers)
    alone = numbers[(origins < 0) & (split_frame(state["frame"][numbers]).level == 0)]
    frames[alone] = _moved_frames(
        state["frame"][alone], table.free[alone], rotation, motion[6] / size, place
    )
    mounts, numbers = moved["mount"].copy(), _with_arms(equations, defect)
    mounts[numbers, ROTATION:] = factor * state["mount"][numbers, ROTATION:]
    return {**moved, "point": points, "pose": poses, "frame": frames, "mount": mounts}


def _with_arms(equations: Equations, defect: Defect) -> Index:
    """Return the mounts whose arms a defect scales: rigid ones allow no error of second order."""
    table = equations.unknowns["mount"]
    free = in_part(table, defect.inside) & table.free[:, 3:].all(axis=1)
    return np.flatnonzero(free)


def _moved_frames(
    frames: Array,
    free: Mask,
    rotation: Array,
    ln_scale: float,
    place: Callable[[Array], Array],
) -> Array:
    """Return frames with constant origins moved by a similarity: what they measure stays.

    R' = Q R, ℓ' = ℓ + ln m; the place with q = 0, O + e^ℓ R c, moves as a point does. R stays where
    it is held altogether, as that of a sphere, and ℓ where it is held.

    Args:
        frames: stored frames, (n, 17).
        free: free components, (n, 7).
        rotation: Q, (3, 3).
        ln_scale: ln m.
        place: the similarity of places (n, 3).
    """
    turned, offset, scale, origin, _ = split_frame(frames)
    out = frames.copy()
    with np.errstate(over="ignore"):  # a frame that has run to infinity stays there
        to_object = np.exp(scale)[:, None, None] * turned
    zero = place(origin + np.einsum("nij,nj->ni", to_object, offset))
    turns: Mask = np.any(free[:, :3], axis=1)
    after = np.where(turns[:, None, None], rotation @ turned, turned)
    out[:, :9] = after.reshape(-1, 9)
    out[:, 12] = scale + np.where(free[:, 6], ln_scale, 0.0)
    away = np.exp(-out[:, 12])[:, None, None] * after.transpose(0, 2, 1)
    out[:, 9:12] = np.einsum("nij,nj->ni", away, zero - origin)
    return out
