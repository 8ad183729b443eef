"""Motions of a whole network that rows leave undetermined; how unknowns of many stations follow.

Some rows change with a motion of the whole network and nevertheless determine nothing of it:

- residuals across an axis, and weighted deflections of the vertical, turn with the object;
- lengths that should be zero, such as conditions of shapes, shrink with it. Where all else are
  angles, a smaller network has smaller residuals in metres: vᵀPv has no minimum at a finite size;
- the convergence of meridians determines a turn, but often too imprecisely to count.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..entities import parameter_name
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..models.datum_motions import Motions
from ..models.rolling_shutter import MOTION, VELOCITY
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..observations import KINDS
from ..types import Array, Index, Mask
from .linearised_equations import LinearisedEquations

MAX_SIGMA_RAD = 0.01
"""Largest standard deviation, radians, of a turn of the network that counts as determined by the
convergence of meridians, or by distances from lines that are not zero: a turn that is known less
well is no longer linear. By convergence, the distance from the pole is known to the same share."""
MIN_TURN_COSINE = 0.7
"""Cosine of the angle between a rotation and the vertical from which it is a turn about it."""


def zero_length_blocks(system: LinearisedEquations) -> Iterator[tuple[Block, Mask]]:
    """Yield blocks of lengths, and which of their observations (n,) are lengths of zero.

    Weighted velocities of photos are among them: displacements in a second.
    """
    for block in system.equations.blocks:
        zero = ~np.any(block.observed, axis=1)
        if block.prior:
            if block.variables[0][0] != "photo_motion":
                continue
            zero &= block.constants["which"] % MOTION < VELOCITY
        elif block.unit != "m" or block.fixes != "nothing":
            continue
        if zero.any():
            yield block, zero


def without_shrinking(system: LinearisedEquations, noticed: Array, scale: Array) -> Array:
    """Return the sensitivity of rows without the shrinking of lengths that should be zero.

    Such a length grows with the object: A g is v times the change of ln scale.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
        scale: change of ln scale in each motion, (d,).
    """
    out = noticed.copy()
    for block, zero in zero_length_blocks(system):
        rows = np.arange(block.rows.start, block.rows.stop)[np.repeat(zero, block.dimension)]
        out[rows] -= system.residual[rows][:, None] * scale
    return out


def stations_of(equations: Equations, kind: VariableKind, on: Index) -> Index:
    """Return the number of the point of each variable; −1: at no point."""
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


def mean_motions(
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


def offsets_from_axes(equations: Equations, kind: VariableKind) -> Array:
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


def undirected_motions(
    noticed: Array, among: Array, radians: Array, up: Array | None, limits: tuple[float, float]
) -> Array:
    """Return the motions among some that rows do not determine well enough to count.

    The sensitivity to a turn counts above the upper limit, where the standard deviation of the turn
    is `MAX_SIGMA_RAD` at most: convergence of meridians makes azimuths of unknown constant
    sensitive to a turn about the vertical, and a distance from a line that is not zero is sensitive
    to a turn about the line. Where a turn about the vertical counts, so does the sensitivity of
    convergence to the distance from the pole, above the lower limit.

    Args:
        noticed: sensitivity of the rows to each motion, relative to σ, (rows, n).
        among: combinations of the motions, orthonormal, (n, d).
        radians: rotation vectors of the motions, (3, n).
        up: the vertical, (3,); None: no turn about it is distinguished.
        limits: lower and upper limit.
    """
    seen = noticed @ among
    _, values, right = np.linalg.svd(seen, full_matrices=len(seen) < seen.shape[1])
    padded = np.zeros(seen.shape[1])
    padded[: len(values)] = values
    turns = radians @ among @ right.T
    above = padded > limits[1]
    counts = above & (np.linalg.norm(turns, axis=0) <= MAX_SIGMA_RAD * padded)
    if up is not None and not np.any(above & ~counts):
        upright = np.abs(up @ turns) > MIN_TURN_COSINE * np.linalg.norm(turns, axis=0)
        if np.any(counts & upright):
            counts |= padded > limits[0]
    return np.asarray(among @ right[~counts].T)


def unnoticed_motions(noticed: Array, among: Array, threshold: float) -> Array:
    """Return the motions among some to which the sensitivity of rows is below a threshold.

    Args:
        noticed: sensitivity of the rows to each motion, (rows, n).
        among: combinations of the motions, orthonormal, (n, d).
        threshold: limit.
    """
    seen = noticed @ among
    # With fewer rows than motions, the other motions are unnoticed too.
    _, values, right = np.linalg.svd(seen, full_matrices=len(seen) < seen.shape[1])
    padded = np.zeros(seen.shape[1])
    padded[: len(values)] = values
    return np.asarray(among @ right[padded < threshold].T)


def independent_motions(motions: Array, length: Array) -> Mask:
    """Return which motions (n, 7) move something that those before them do not move likewise.

    Where only heights of one point are free, its shift in z represents rotations and scale too.
    """
    real = length > 1e-12 * max(float(length.max()), np.finfo(float).tiny)
    basis = np.zeros((len(motions), 0))
    for i in np.flatnonzero(real):
        rest = motions[:, i] / length[i]
        for _ in range(2):  # once more, or rounding leaves a part in the basis
            rest = rest - basis @ (basis.T @ rest)
        size = float(np.linalg.norm(rest))
        real[i] = size > 1e-9
        if real[i]:
            basis = np.column_stack([basis, rest / size])
    return real


def without_turns_about_axes(system: LinearisedEquations, noticed: Array) -> Array:
    """Return the sensitivity of rows without turns of residuals across an axis about it.

    The frame of a line is held about its axis, so that its two residuals v turn with the object: A
    g has the part (−v₂, v₁) times the turn. It does not determine the turn, as vᵀPv stays, if both
    distances have one weight, and hardly otherwise: v is of the size of σ. So do the two
    inclinations of an axis parallel to that of a shape.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
    """
    out = noticed
    for block in system.equations.blocks:
        record = KINDS.get(block.kind)
        if record is None or not record.turns or block.whitener is not None:
            continue
        v = system.residual[block.rows].reshape(-1, 2)
        ratio = block.sigma[:, 1] / block.sigma[:, 0]
        w = np.column_stack([-v[:, 1] * ratio, v[:, 0] / ratio])
        if out is noticed:
            out = noticed.copy()
        rows = out[block.rows].reshape(block.n, 2, -1)
        shape = block.variables[0][1]
        for f in np.unique(shape).tolist():
            own = np.flatnonzero(shape == f)
            square = float(np.sum(w[own] ** 2))
            if square > 0:
                turn = np.einsum("ni,nid->d", w[own], rows[own]) / square
                rows[own] -= w[own][:, :, None] * turn
        out[block.rows] = rows.reshape(2 * block.n, -1)
    return out


def rows_across_axes(system: LinearisedEquations) -> Mask:
    """Return which rows, extra rows last, are residuals in two directions across an axis."""
    out = np.zeros(len(system.every_residual), dtype=bool)
    for block in system.equations.blocks:
        record = KINDS.get(block.kind)
        out[block.rows] = record is not None and record.turns
    return out


def without_turned_deflections(
    system: LinearisedEquations, noticed: Array, radians: Array
) -> Array:
    """Return the sensitivity of rows without turns of weighted deflections about the vertical.

    A deflection (ξ, η) turns with the object about the vertical. Where it is expected to be zero,
    both components with one σ, only its size counts, which stays: A g has the part ω (η, −ξ)/σ, and
    vᵀPv is independent of the turn ω.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
        radians: rotation vectors of the motions G, (3, d).
    """
    out = noticed
    state, frame = system.state, system.equations.network.frame
    for block in system.equations.blocks:
        kind, numbers = block.variables[0]
        if not block.prior or not UNKNOWNS[kind].across:
            continue
        which = block.constants["which"].astype(int)
        at = stations_of(system.equations, kind, numbers)
        enu = frame.basis(state["point"][at], np.zeros((len(at), 2))).enu
        turn = np.linalg.det(enu)[:, None] * (enu[:, 2] @ radians)
        for number in np.unique(numbers).tolist():
            own = np.flatnonzero(numbers == number)
            sigma = block.sigma[own, 0]
            if len(own) < 2 or np.any(block.observed[own]) or sigma[0] != sigma[1]:
                continue
            xi, eta = state[kind][number]
            rows = np.arange(block.rows.start, block.rows.stop)[own]
            moved = np.array([eta, -xi])[which[own]]
            if out is noticed:
                out = noticed.copy()
            out[rows] -= (moved / sigma)[:, None] * turn[own]
    return out
