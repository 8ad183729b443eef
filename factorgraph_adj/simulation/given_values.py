"""Values that a plan takes where its network gives none, and what it refuses without values.

Shapes follow from the points on them. A component whose value is of no consequence, or has a
natural choice, takes `Component.planned`: orientations of sets and constants of gyrotheodolites are
0, and so is the offset of a frame about an origin that was stated. Everything else must be given:
the partials, and with them the expected precision, depend on it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from ..approximate.shapes import on_shapes, place_shapes
from ..block_orientation.begin import start_of, without_poses
from ..errors import AdjustmentError, InputError, Problem
from ..graph.equations import compile_network
from ..models.variables import UNKNOWNS, UnknownKind
from ..network.entities import Parameter, parameter_name
from ..network.network import Network
from ..solve.adjusted import with_values
from ..types import Array

HINT = "state them, or plan with as_network() of an adjustment that found them"


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
    if not without_poses(network) or not network.images.columns()[2].any():
        return network
    equations = compile_network(network)
    try:
        start = start_of(equations, network.datum, None)
    except AdjustmentError:
        return network
    return with_values(network, equations.unknowns, start.state)


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
    if not on_shapes(equations):
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
