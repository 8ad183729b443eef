"""Datum defects in words: parts without a datum, missing motions, axes through known points.

Two known points, or several on a line, leave a block free to turn about their line. A rotation

    δX = t + ω × (X − c)

about the centre c of the motions leaves the points of an axis in their places if t is
perpendicular to ω; the message names those points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import known as known_names
from ..graph.variables import State, Unknowns
from ..models.unknown_registry import UNKNOWNS
from ..types import Array, Index
from .datum_defects import Defect, in_part

MAX_AXIS_DISTANCE = 1e-6
"""Largest distance from an axis at which a place counts as one on it, relative to the mean distance
of the points from their centre: rounding of coordinates is far below, other points are far off."""
MAX_SHIFT_ALONG_AXIS = 1e-6
"""Largest shift along an axis, relative to the rotation, that counts as rounding."""


def describe_defects(
    unknowns: Unknowns, defects: Sequence[Defect], state: State | None = None
) -> list[str]:
    """Return one line for each part without a datum, and what moves or rests in it.

    Args:
        unknowns: the unknowns.
        defects: the datum defects.
        state: the state at which they were found; none: axes are not looked for.
    """
    lines = []
    if len(defects) > 1:
        lines.append(f"the network falls into {len(defects)} unconnected parts without datum")
    for d in defects:
        found = dict.fromkeys(_names_in(unknowns, d.part))
        some = ", ".join(list(found)[:6]) + (" …" if len(found) > 6 else "")
        whole = len(found) == len(_names_in(unknowns, np.arange(unknowns.n_columns)))
        which = "" if whole else f" of the part with {some}"
        lines.append(f"datum defect {d.size}{which}: missing {', '.join(d.names())}")
        resting = [] if state is None else names_on_axis(unknowns, d, state)
        if len(resting) > 1:
            lines.append(
                f"it can turn about the line of {known_names(resting)}: control, or the position "
                "of a photo, away from this line determines the rotation"
            )
        if taken := _takers(unknowns, d):
            lines.append(f"observed coordinates do not hold it: free shift of {known_names(taken)}")
    return lines


def names_on_axis(unknowns: Unknowns, defect: Defect, state: State) -> list[str]:
    """Return points and photos that rest where a defect is one rotation; none: it is another."""
    if defect.size != 1:
        return []
    shift, turn, scale = np.split(defect.mixture[:, 0], [3, 6])
    length = float(np.linalg.norm(turn))
    centre, size = defect.about
    if abs(float(scale[0])) > MAX_SHIFT_ALONG_AXIS * length or length == 0.0:
        return []
    if abs(float(shift @ turn)) > MAX_SHIFT_ALONG_AXIS * length**2:
        return []
    out = []
    for kind, places in _places(state).items():
        # The mixture has radians times the mean distance, so that this is a distance.
        moved = shift + np.cross(turn, (places - centre) / size)
        away = np.linalg.norm(moved, axis=1) / length
        rests = np.flatnonzero(away < MAX_AXIS_DISTANCE).tolist()
        noun = UNKNOWNS[kind].noun
        out += [f"{noun} {unknowns[kind].names[i]!r}" for i in rests]
    return out


def _places(state: State) -> Mapping[str, Array]:
    """Return places (n, 3) of points and photos by their kind."""
    return {"point": state["point"], "pose": state["pose"].reshape(-1, 12)[:, 9:]}


def _takers(unknowns: Unknowns, defect: Defect) -> list[str]:
    """Return the unknown shifts that absorb the information of observed coordinates on a defect."""
    found = []
    for kind, number in unknowns.active():
        record = UNKNOWNS[kind]
        columns = unknowns.columns(kind, number)
        if record.shifts and np.abs(defect.motions[columns]).max() > 0:
            found.append(f"{record.noun} {unknowns[kind].names[number]!r}")
    return found


def _names_in(unknowns: Unknowns, columns: Index) -> list[str]:
    inside = np.zeros(unknowns.n_columns, dtype=bool)
    inside[columns] = True
    out = []
    for kind in ("point", "pose"):
        table = unknowns[kind]
        on = np.flatnonzero(in_part(table, inside))
        out += [table.names[i] if kind == "point" else f"photo {table.names[i]}" for i in on]
    return out
