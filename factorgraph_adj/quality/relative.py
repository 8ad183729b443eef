"""Covariances of points and projection centres, and of differences between any two of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem
from ..solve.solution import Solution
from ..types import Array

Place: TypeAlias = str | tuple[Literal["point", "pose"], str]
"""Name of a point; or ``("pose", name)`` for the projection centre of a photo."""


def variable(place: Place) -> tuple[Literal["point", "pose"], str]:
    """Return kind and name of a place.

    Raises:
        InputError: it is neither a name nor a kind and a name.
    """
    if isinstance(place, str):
        return "point", place
    if isinstance(place, tuple) and len(place) == 2 and place[0] in ("point", "pose"):
        return place
    raise InputError(
        f"a place must be the name of a point, or ('pose', name of a photo), not {place!r}"
    )


def describe(place: Place) -> str:
    """Return a readable name of a place."""
    kind, name = variable(place)
    return f"point {name!r}" if kind == "point" else f"photo {name!r}"


def position(solution: Solution, place: Place) -> Array:
    """Return the adjusted coordinates of a point or projection centre, (3,) metres."""
    kind, name = variable(place)
    return np.array(solution.state[kind][solution.number(kind, name)][-3:])


def covariance(solution: Solution, a: Place, b: Place | None = None) -> Array:
    """Return the covariance of a place, or of the difference b − a of two, (3, 3) metres².

    For a difference Σ = Σ_aa + Σ_bb − Σ_ab − Σ_ba, in which shifts of the datum cancel.

    Raises:
        InputError: unknown names, or two identical places.
    """
    own = _block(solution, a, a)
    if b is None:
        return own
    if variable(a) == variable(b):
        raise InputError(Problem("a difference needs two places", describe(a)))
    cross = _block(solution, a, b)
    return np.asarray(own + _block(solution, b, b) - cross - cross.T)


def covariances(solution: Solution, places: Sequence[Place]) -> Array:
    """Return the covariances of many places at once, (n, 3, 3) metres².

    The covariances come from the selected inverse, without further solutions of the equations.

    Raises:
        InputError: unknown names, all at once.
    """
    problems: list[Problem] = []
    out = np.zeros((len(places), 3, 3))
    for i, place in enumerate(places):
        try:
            kind, name = variable(place)
            number = solution.number(kind, name)
        except InputError as error:
            problems += error.problems
            continue
        if not problems:
            at_once = kind == "point"
            out[i] = (
                solution.point_covariances[number] if at_once else _block(solution, place, place)
            )
    if problems:
        raise InputError(problems)
    return out


def _block(solution: Solution, a: Place, b: Place) -> Array:
    """Return the covariance between two places, (3, 3): X0, Y0, Z0 for a photo."""
    kind, name = variable(a)
    if variable(b) == (kind, name):
        return solution.variable_covariance((kind, name))[-3:, -3:]
    return solution.variable_covariance((kind, name), variable(b))[-3:, -3:]


@dataclass(frozen=True)
class DistancePrecision:
    """The adjusted slope distance between two places and its precision."""

    a: Place
    """First place."""
    b: Place
    """Second place."""
    distance: float
    """Slope distance D, metres."""
    sigma: float
    """Standard deviation σ_D, metres; zero between held places."""

    @property
    def ratio(self) -> float:
        """N = D/σ_D of the relative precision 1 : N; infinite between held places."""
        return self.distance / self.sigma if self.sigma > 0 else float("inf")

    @property
    def ppm(self) -> float:
        """σ_D/D in parts per million."""
        return 1e6 * self.sigma / self.distance


@with_one_thread
def distance_precision(solution: Solution, a: Place, b: Place) -> DistancePrecision:
    """Return the precision of the slope distance between two points or projection centres.

    σ_D² = dᵀ Σ_Δ d / D², d = X_b − X_a, Σ_Δ the covariance of d with its cross-covariances.
    The distance is taken between the marks, without heights of instrument and target. In a free
    network σ_D is independent of the datum, unless the datum defect includes the scale.

    Args:
        solution: an adjusted network.
        a: name of a point, or ``("pose", name)`` for a projection centre.
        b: second place, as ``a``.

    Raises:
        InputError: unknown names, two identical places, or two places that coincide.
    """
    d = position(solution, b) - position(solution, a)
    distance, sigma = length_and_sigma(d, covariance(solution, a, b))
    if distance == 0.0:
        raise InputError(Problem(f"has the coordinates of {describe(b)}: no distance", describe(a)))
    return DistancePrecision(a, b, distance, sigma)


def length_and_sigma(d: Array, variance: Array) -> tuple[float, float]:
    """Return |d| and √(dᵀ Σ d)/|d| of a difference (3,) with the covariance Σ (3, 3).

    The standard deviation is NaN for d = 0.
    """
    length = float(np.linalg.norm(d))
    if length == 0.0:
        return 0.0, float("nan")
    along = d / length
    return length, max(float(along @ variance @ along), 0.0) ** 0.5
