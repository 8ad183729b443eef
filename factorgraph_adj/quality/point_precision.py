"""Covariances of places and of differences, precision of distances, and check points.

Check points compare adjusted coordinates with known ones that the adjustment did not use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem, taking
from ..frames import Frame
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..types import Array

Place: TypeAlias = str | tuple[Literal["point", "pose"], str]
"""Name of a point; or ``("pose", name)`` for the projection centre of a photo."""


MAX_SHARE_OF_UNKNOWN = 0.02
"""Largest share of a difference without value in another direction that is left out: verticals at
two ends of 100 km."""


@dataclass(frozen=True, repr=False)
class CheckPoints(Shown):
    """Differences at the check points; NaN where a coordinate is not known."""

    names: tuple[str, ...]
    """Names of the points, n."""
    differences: Array
    """Adjusted − known coordinates, (n, 3) metres."""
    sigmas: Array
    """Standard deviations of the adjusted coordinates, (n, 3) metres; zero where held."""
    east_north_up: Array
    """The differences along east, north and up at each point, (n, 3) metres."""

    def headline(self) -> str:
        """Return how many points were compared, and their RMS differences."""
        return f"CheckPoints: {len(self.names)} points, RMS of x, y, z {self.rms} m"

    def first_rows(self) -> Rows:
        """Return the differences, adjusted − given, metres."""
        return Rows(
            ("point", "x", "y", "z"),
            ((name, *map(float, d)) for name, d in zip(self.names, self.differences, strict=True)),
            len(self.names),
        )

    @property
    def normalised(self) -> Array:
        """Differences over the standard deviations of the adjusted coordinates, (n, 3).

        The known coordinates are taken as errorless. Held and unknown coordinates give NaN.
        """
        safe = np.where(self.sigmas > 0, self.sigmas, np.nan)
        return np.asarray(self.differences / safe)

    @property
    def counts(self) -> tuple[int, int, int]:
        """Number of known coordinates of each axis."""
        x, y, z = np.isfinite(self.differences).sum(axis=0).tolist()
        return x, y, z

    @property
    def rms(self) -> Array:
        """Root mean square of the differences of each axis, (3,) metres; NaN without any."""
        return _by_axis(self.differences**2) ** 0.5

    @property
    def mean(self) -> Array:
        """Mean difference of each axis, (3,) metres; NaN without any."""
        return _by_axis(self.differences)

    @property
    def rms_sigma(self) -> Array:
        """Root mean square of the standard deviations at known coordinates, (3,) metres.

        This is the expected value of `rms`.
        """
        return _by_axis(np.where(np.isfinite(self.differences), self.sigmas, np.nan) ** 2) ** 0.5


@taking(Solution)
@with_one_thread
def check_points(solution: Solution) -> CheckPoints:
    """Compare adjusted coordinates with those given as ``check`` of a point.

    Differences are adjusted − known, in the axes of the frame. Known coordinates are taken as
    errorless, so the standard deviations are those of the adjusted coordinates. In a free network
    the differences and the standard deviations refer to the datum of the network.
    """
    points = [p for p in solution.network.points.values() if p.check is not None]
    numbers = [solution.number("point", p.name) for p in points]
    known = np.array([p.check for p in points], dtype=float).reshape(-1, 3)
    sigmas = np.array([solution.standard_deviations(p.name) for p in points]).reshape(-1, 3)
    found = solution.state["point"][np.array(numbers, dtype=np.intp)]
    differences = found - known
    turned = along_horizon(solution.network.frame, found, differences)
    return CheckPoints(tuple(p.name for p in points), differences, sigmas, turned)


def along_horizon(frame: Frame, at: Array, differences: Array) -> Array:
    """Return differences in the axes of a frame along east, north and up at each place, (n, 3).

    Args:
        frame: the frame.
        at: places, (n, 3).
        differences: differences of coordinates, (n, 3), NaN where unknown: a component to which an
            unknown one contributes is NaN.
    """
    enu = frame.basis(at, np.zeros((len(at), 2))).enu
    turned = np.einsum("nij,nj->ni", enu, np.where(np.isnan(differences), 0.0, differences))
    # Up at a point of a topocentric frame leans from that of its origin by its distance / R.
    unknown = np.isnan(differences)[:, None, :] & (np.abs(enu) > MAX_SHARE_OF_UNKNOWN)
    turned[unknown.any(axis=2)] = np.nan
    return np.asarray(turned)


def _by_axis(values: Array) -> Array:
    """Return the mean of the finite values of each column; NaN for a column of NaN."""
    on = np.isfinite(values)
    total, count = np.where(on, values, 0.0).sum(axis=0), on.sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(3, np.nan), where=count > 0))


def place_variable(place: Place) -> tuple[Literal["point", "pose"], str]:
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


def place_text(place: Place) -> str:
    """Return a readable name of a place."""
    kind, name = place_variable(place)
    return f"point {name!r}" if kind == "point" else f"photo {name!r}"


def place_position(solution: Solution, place: Place) -> Array:
    """Return the adjusted coordinates of a point or projection centre, (3,) metres."""
    kind, name = place_variable(place)
    return np.array(solution.state[kind][solution.number(kind, name)][-3:])


def place_covariance(solution: Solution, a: Place, b: Place | None = None) -> Array:
    """Return the covariance of a place, or of the difference b − a of two, (3, 3) metres².

    For a difference Σ = Σ_aa + Σ_bb − Σ_ab − Σ_ba, in which shifts of the datum cancel.

    Raises:
        InputError: unknown names, or two identical places.
    """
    own = _block(solution, a, a)
    if b is None:
        return own
    if place_variable(a) == place_variable(b):
        raise InputError(Problem("a difference needs two places", place_text(a)))
    cross = _block(solution, a, b)
    return np.asarray(own + _block(solution, b, b) - cross - cross.T)


def place_covariances(solution: Solution, places: Sequence[Place]) -> Array:
    """Return the covariances of many places at once, (n, 3, 3) metres².

    The covariances come from the selected inverse, without further solutions of the equations.

    Raises:
        InputError: unknown names, all at once.
    """
    problems: list[Problem] = []
    out = np.zeros((len(places), 3, 3))
    for i, place in enumerate(places):
        try:
            kind, name = place_variable(place)
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
    kind, name = place_variable(a)
    if place_variable(b) == (kind, name):
        return solution.variable_covariance((kind, name))[-3:, -3:]
    return solution.variable_covariance((kind, name), place_variable(b))[-3:, -3:]


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


@taking(Solution)
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
    d = place_position(solution, b) - place_position(solution, a)
    distance, sigma = length_and_sigma(d, place_covariance(solution, a, b))
    if distance == 0.0:
        raise InputError(
            Problem(f"has the coordinates of {place_text(b)}: no distance", place_text(a))
        )
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
