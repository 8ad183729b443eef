"""Coordinates and covariances of points, and poses of photos, from a state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from ..errors import InputError, Problem, known
from ..graph.dependence import Variable
from ..network.entities import Photo, Point
from ..solve.estimates import PoseEstimate
from ..solve.solution import Solution
from ..types import Array
from .flow import State


def estimate(state: State, name: str, solution: Callable[[], Solution]) -> Array:
    """Return the coordinates of a point, (3,) metres.

    Args:
        state: the state.
        name: the point.
        solution: returns the whole solution, which a free network takes.

    Raises:
        InputError: no such point, or it is not determined yet.
    """
    _require(state, name)
    system = state.system
    value = None if system is None else system.value("point", name)
    if value is None:
        return np.array(state.ledger.network.points[name].coordinates)
    free = system is not None and system.is_free
    return solution().point(name) if free else value


def covariance(state: State, a: str, b: str, solution: Callable[[], Solution]) -> Array:
    """Return the covariance between two points, (3, 3) metres²; σ0 = 1.

    Args:
        state: the state.
        a: a point.
        b: a point; it may be the same.
        solution: returns the whole solution, which a free network takes.

    Raises:
        InputError: no such point, or it is not determined yet.
    """
    for name in (a, b):
        _require(state, name)
    system, out = state.system, np.zeros((3, 3))
    if system is None or not all(system.known("point", n) for n in (a, b)):
        return out
    if system.is_free:
        return solution().covariance(a, b)
    found = system.cofactors(("point", a), ("point", b))
    out[: found.shape[0], : found.shape[1]] = found
    return out


def pose(state: State, photo: str, solution: Callable[[], Solution]) -> PoseEstimate:
    """Return the exterior orientation of a photo.

    Args:
        state: the state.
        photo: the photo.
        solution: returns the whole solution, which a free network takes.

    Raises:
        InputError: no such photo, or it is not determined yet.
    """
    _require(state, photo, "pose")
    system = state.system
    stored = None if system is None else system.value("pose", photo)
    if system is None or stored is None or system.is_free:
        return solution().pose(photo)
    of_photo: Variable = ("pose", photo)
    sigmas = np.sqrt(np.maximum(np.diag(system.cofactors(of_photo, of_photo)), 0.0))
    return PoseEstimate(stored[9:].copy(), stored[:9].reshape(3, 3).copy(), sigmas)


def _require(state: State, name: str, kind: Literal["point", "pose"] = "point") -> None:
    """Refuse a point, or a photo, that is not there, or not determined."""
    network, system = state.ledger.network, state.system
    described: Mapping[str, Point | Photo]
    noun, described = ("point", network.points) if kind == "point" else ("photo", network.photos)
    retired = state.ledger.retired
    if name not in described and retired is not None and (told := retired.told((kind, name))):
        what = (
            f"{told}, and last_estimate({name!r}{', kind=' + repr(kind) if kind == 'pose' else ''})"
        )
        raise InputError(Problem(f"{what} returns what was known of it then", f"{noun} {name!r}"))
    if name not in described:
        text = f"unknown {noun} {name!r}; known: {known(described, meant=name)}"
        raise InputError(text)
    if (system is None or not system.known(kind, name)) and not all(described[name].fixed):
        lacks = state.ledger.lacks.get((kind, name), "no observation has determined it yet")
        raise InputError(Problem(f"is not determined: {lacks}", f"{noun} {name!r}"))
