"""Values that a plan takes where none are given, or asks for; points that it cannot determine.

Shapes follow from the points on them. A component whose value is of no consequence, or has a
natural choice, takes `Component.planned`: orientations of sets and constants of gyrotheodolites are
0, and so is the offset of a frame about an origin that was stated. Everything else must be given:
the partials, and with them the expected precision, depend on it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_array

from ..entities import Parameter, parameter_name
from ..errors import AdjustmentError, InputError, Problem
from ..graph.equations import Equations, compile_network, compile_rows
from ..models.unknown_registry import UNKNOWNS, UnknownKind
from ..network.network import Network
from ..orientation.choice_of_start import choose_start, has_photos_without_pose
from ..solve.estimates import network_with_values
from ..start.shape_fit import frames_of_shapes, place_shapes
from ..types import Array, Index, Mask

RAYS = 2
"""Number of image rays that determine a point."""
NULL = 1e-11
"""Smallest eigenvalue of the N of a determined point. N is scaled to a unit diagonal before the
orientation unknowns are eliminated."""
HINT = "state them, or plan with as_network() of an adjustment that found them"


def undetermined_points(network: Network) -> list[str]:
    """Return the points with free coordinates that are not determined.

    A point is not determined if it would be undetermined even with all other points, photos and
    instruments known: N of its free coordinates, at most 3 × 3, is singular after elimination of
    the orientations of the sets of directions to and from the point. Two image rays determine a
    point, and so does one ray with a known height; a known height alone is not sufficient.

    Args:
        network: a network with values near the true ones everywhere.
    """
    if not network.points:
        return []
    equations = compile_rows(network)
    points = equations.unknowns["point"]
    _, of_ray, _, _ = network.images.columns()
    rays = np.bincount(of_ray, minlength=len(points.names))
    asked = points.free.any(axis=1) & (rays < RAYS)
    if not asked.any():
        return []
    normals, taken = _normals(equations, asked)
    return [
        points.names[i]
        for i in np.flatnonzero(asked).tolist()
        if _is_singular(normals[i], taken[i], points.free[i])
    ]


def _normals(equations: Equations, asked: Mask) -> tuple[Array, Array]:
    """Return N of each point, all else known, and its loss to orientations, (n, 3, 3) each."""
    state = equations.unknowns.start()
    # Orientations cancel in measured directions; an unknown orientation may have any value.
    state["orientation"] = np.nan_to_num(state["orientation"])
    sets = equations.unknowns["orientation"]
    loose = (sets.free & np.isinf(sets.sigma))[:, 0]
    normals, taken = np.zeros((2, len(asked), 3, 3))
    of_sets = np.zeros(len(sets.names))
    number: list[Index] = []
    column: list[Index] = []
    coupled: list[Array] = []
    for block in equations.blocks:
        on = [i for i, (kind, _) in enumerate(block.variables) if kind == "point"]
        turns = [i for i, (kind, _) in enumerate(block.variables) if kind == "orientation"]
        if turns:
            chosen = block
        else:
            touched = [asked[block.variables[i][1]] for i in on]
            if not touched:
                continue
            chosen = block.select(np.flatnonzero(np.any(touched, axis=0)))
        if not chosen.n:
            continue
        jacobians = chosen.evaluate(equations.network.frame, state).jacobians
        by_point = [(chosen.variables[i][1], chosen.whiten(jacobians[i])) for i in on]
        for index, a in by_point:
            np.add.at(normals, index, np.einsum("nda,ndb->nab", a, a))
        for i in turns:
            of_set, b = chosen.variables[i][1], chosen.whiten(jacobians[i])[:, :, 0]
            np.add.at(of_sets, of_set, np.sum(b * b, axis=1))
            for index, a in by_point:
                number.append(index)
                column.append(of_set)
                coupled.append(np.einsum("nda,nd->na", a, b))
    if coupled and loose.any():
        share = np.divide(1.0, of_sets, where=loose & (of_sets > 0), out=np.zeros(len(of_sets)))
        at = (np.concatenate(number), np.concatenate(column))
        values = np.concatenate(coupled)
        shape = (len(asked), len(of_sets))
        by_axis = [csr_array((values[:, axis], at), shape=shape) for axis in range(3)]
        for i, j in np.ndindex(3, 3):
            taken[:, i, j] = by_axis[i].multiply(by_axis[j]) @ share
    return normals, taken


def _is_singular(normal: Array, taken: Array, free: Mask) -> bool:
    """Return whether N less its loss ``taken`` (3, 3) is singular in the free coordinates."""
    scale = np.sqrt(np.diag(normal)[free])
    if np.any(scale == 0.0):
        return True
    own = (normal - taken)[np.ix_(free, free)] / np.outer(scale, scale)
    return bool(np.linalg.eigvalsh(own)[0] < NULL)


def with_given_values(network: Network) -> Network:
    """Return the network with values of all its unknowns.

    Values that are given stay as they are. Photos that were taken already, and have no pose, are
    oriented from their image points, as `adjust` does.

    Raises:
        InputError: every point without coordinates, every photo without position or rotation,
            every shape that its points do not determine, and every other unknown without a value
            that it needs.
    """
    network = _oriented(network)
    problems = [
        Problem("a plan needs its coordinates", f"point {name!r}")
        for name, p in network.points.items()
        if not np.isfinite(p.coordinates).all()
    ]
    problems += [
        Problem("a plan needs its position and rotation", f"photo {name!r}")
        for name, f in network.photos.items()
        if f.position is None or f.rotation is None
    ]
    if not any(_open(p) for given in network.parameters.values() for p in given.values()):
        if problems:
            raise InputError(problems)
        return network
    found, of_shapes = _with_shapes(network)
    problems += of_shapes
    shapes = {p.where for p in of_shapes}
    parameters = {}
    for kind, given in found.parameters.items():
        record = UNKNOWNS[kind]
        parameters[kind] = {key: with_defaults(record, p) for key, p in given.items()}
        for key, p in parameters[kind].items():
            name = repr(parameter_name(key))
            wrong = without_values(record, p, f"{record.noun} {name}")
            if wrong is not None and f"shape {name}" not in shapes:
                problems.append(wrong)
    if problems:
        raise InputError(problems)
    found.parameters = parameters
    return found


def _oriented(network: Network) -> Network:
    """Return the network with poses and points from image points; unchanged if that fails."""
    if not has_photos_without_pose(network) or not network.images.columns()[2].any():
        return network
    equations = compile_network(network)
    try:
        start = choose_start(equations, network.datum, None)
    except AdjustmentError:
        return network
    return network_with_values(network, equations.unknowns, start.state)


def with_defaults(kind: UnknownKind, given: Parameter) -> Parameter:
    """Return an unknown with the values that a plan takes for missing components.

    Of a kind with an origin they are taken only where the origin was stated.
    """
    if not _open(given):
        return given
    if kind.constants and not given.origin and not any(given.constants[:-1]):
        return given
    pairs = zip(given.values, kind.components, strict=False)
    return replace(given, values=tuple(c.planned if np.isnan(v) else v for v, c in pairs))


def without_values(kind: UnknownKind, given: Parameter, where: str) -> Problem | None:
    """Return the problem of an unknown with missing components; None: none is missing."""
    names = kind.names(len(given.values))
    missing = [n for n, v in zip(names, given.values, strict=True) if np.isnan(v)]
    if not missing:
        return None
    return Problem(f"a plan needs its values; {', '.join(missing)} missing: {HINT}", where)


def _open(given: Parameter) -> bool:
    """Return whether a component has no value."""
    return bool(np.isnan(given.values).any())


def _with_shapes(network: Network) -> tuple[Network, list[Problem]]:
    """Return the network with the shapes and sizes that follow from points; problems of others."""
    equations = compile_network(network)
    if not frames_of_shapes(equations):
        return copy(network), []
    unknowns, state = equations.unknowns, equations.unknowns.start()
    problems = place_shapes(equations, state)
    out = copy(network)
    out.parameters = {}
    for kind, given in network.parameters.items():
        record, number = UNKNOWNS[kind], unknowns[kind].number
        out.parameters[kind] = {
            key: _filled(record, p, state[kind][number[parameter_name(key)]])
            for key, p in given.items()
        }
    return out, problems


def _filled(kind: UnknownKind, given: Parameter, stored: Array) -> Parameter:
    """Return an unknown with its missing components from a stored value, if that is complete."""
    if not _open(given) or np.isnan(stored).any():
        return given
    values, size = np.array(given.values), len(given.values)
    missing = np.isnan(values)
    if kind.rotates and missing[:3].any():
        missing[:3] = True  # one rotation vector
    found = kind.given(stored[None])[0, :size]
    return replace(given, values=tuple(np.where(missing, found, values).tolist()))
