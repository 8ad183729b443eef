"""Check points: adjusted coordinates against known ones that the adjustment did not use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..shown import Rows, Shown
from ..solve.solution import Solution
from ..types import Array


@dataclass(frozen=True, repr=False)
class CheckPoints(Shown):
    """Differences at the check points; NaN where a coordinate is not known."""

    names: tuple[str, ...]
    """Names of the points, n."""
    differences: Array
    """Adjusted − known coordinates, (n, 3) metres."""
    sigmas: Array
    """Standard deviations of the adjusted coordinates, (n, 3) metres; zero where held."""

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
    return CheckPoints(tuple(p.name for p in points), found - known, sigmas)


def _by_axis(values: Array) -> Array:
    """Return the mean of the finite values of each column; NaN for a column of NaN."""
    on = np.isfinite(values)
    total, count = np.where(on, values, 0.0).sum(axis=0), on.sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(3, np.nan), where=count > 0))
