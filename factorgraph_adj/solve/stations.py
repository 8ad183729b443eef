"""The points at which unknowns stand, and the motions of unknowns that many stations share."""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..models.motions import Motions
from ..models.variables import UNKNOWNS, VariableKind
from ..network.entities import parameter_name
from ..observations import KINDS
from ..types import Array, Index


def places_of(equations: Equations, kind: VariableKind, on: Index) -> Index:
    """Return the number of the point at which each variable stands; −1: at no point."""
    unknowns = equations.unknowns
    if UNKNOWNS[kind].constants:
        stated = equations.network.of_kind(kind)
        origins = [stated[unknowns[kind].names[i]].origin for i in on.tolist()]
        return np.array([unknowns["point"].number.get(n, -1) for n in origins], dtype=np.intp)
    if not UNKNOWNS[kind].at_point:
        return np.full(len(on), -1, dtype=np.intp)
    point_of = {
        parameter_name(key): key if isinstance(key, str) else key[0]
        for key in equations.network.of_kind(kind)
    }
    names = [point_of[unknowns[kind].names[i]] for i in on.tolist()]
    return np.array([unknowns["point"].number[n] for n in names], dtype=np.intp)


def by_stations(
    equations: Equations, motions: Motions, kind: VariableKind, values: Array, on: Index
) -> Array:
    """Return the motions (len(on), k, 7) of unknowns that many stations share.

    They are the means over the observations of what the motions would be at each station, by the
    weights of the observations: the best that an unknown can do to keep them as they are.

    Args:
        equations: the network.
        motions: the seven motions.
        kind: kind of the unknowns.
        values: values of all unknowns of the kind, (n, s).
        on: numbers of the unknowns.
    """
    move = UNKNOWNS[kind].motions
    assert move is not None
    total = np.zeros((len(values), UNKNOWNS[kind].size, 7))
    weight = np.zeros(len(values))
    for block in equations.blocks:
        own = [index for what, index in block.variables if what == kind]
        stations = [index for what, index in block.variables if what == "point"]
        if block.prior or not own or not stations:
            continue
        p = block.sigma[:, 0] ** -2.0
        moved = move(motions, values[own[0]], stations[0])
        np.add.at(total, own[0], p[:, None, None] * moved)
        np.add.at(weight, own[0], p)
    return np.asarray(total[on] / np.where(weight[on] > 0.0, weight[on], 1.0)[:, None, None])


def still_places(equations: Equations, kind: VariableKind) -> Array:
    """Return the mean distances from their axes of what is observed on shapes, (n, 3) metres.

    Args:
        equations: the network.
        kind: kind of the frames of shapes.
    """
    n = len(equations.unknowns[kind].names)
    total, weight = np.zeros((n, 3)), np.zeros((n, 3))
    for block in equations.blocks:
        record = KINDS.get(block.kind)
        if record is None or not record.turns or block.unit != "m":
            continue
        shape = next(index for what, index in block.variables if what == kind)
        p = block.sigma**-2.0
        np.add.at(total[:, :2], shape, p * block.observed)
        np.add.at(weight[:, :2], shape, p)
    return np.asarray(total / np.where(weight > 0.0, weight, 1.0))
