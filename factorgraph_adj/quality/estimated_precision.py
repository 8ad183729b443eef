"""Standard deviations estimated from random samples, where there is no inverse.

With white noise z of the whitened observations, x = Q Aᵀ z has the covariance Q N Q = Q. The mean
of x² over k samples estimates a variance without bias, with the relative standard error √(2/k), so
that of a standard deviation is 1/√(2 k): the diagonal of an inverse from random vectors (Hutchinson
1990; Bekas, Kokiopoulou and Saad 2007). Each sample is one solution by conjugate gradients. The
points of the first layer have an exact part, L⁻ᵀL⁻¹ with the photos held, so that only what the
photos add is estimated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError, taking
from ..models.unknown_registry import VariableKind
from ..result_display import Rows, Shown
from ..solve.normal_equations import estimates_from_noise
from ..solve.solution import Solution
from ..types import Array

MAX_SAMPLES_AT_ONCE = 16
"""Largest number of samples that are solved for together."""


@dataclass(frozen=True, eq=False, repr=False)
class EstimatedPrecision(Shown):
    """Standard deviations that are ESTIMATES from random samples, not those of an inverse.

    They serve to judge precision, with `relative_error` as their own standard deviation. Tests,
    redundancy numbers and detectable errors need exact cofactors and cannot be made of them.
    """

    solution: Solution
    """The solution."""
    samples: int
    """Number k of samples."""
    variances: Array
    """Estimated variances of all unknowns, (n_columns,), scaled as those of the solution."""

    @property
    def relative_error(self) -> float:
        """Standard error of an estimated standard deviation, relative to it, at most: 1/√(2 k)."""
        return float(1.0 / np.sqrt(2.0 * self.samples))

    def of(self, kind: VariableKind, name: str) -> Array:
        """Return the estimated standard deviations of a variable, by its steps; 0: held.

        Raises:
            InputError: no such variable.
        """
        number = self.solution.number(kind, name)
        columns = self.solution.equations.unknowns.columns(kind, number)
        return np.asarray(np.sqrt(self.variances[columns]))

    @property
    def points(self) -> Mapping[str, Array]:
        """Estimated standard deviations of all points with unknowns by name, (3,) metres."""
        table = self.solution.equations.unknowns["point"]
        on = np.flatnonzero(table.offset >= 0)
        sigmas = np.sqrt(self.variances[table.offset[on, None] + np.arange(3)])
        return {table.names[i]: s for i, s in zip(on.tolist(), sigmas, strict=True)}

    def headline(self) -> str:
        """Return what it is in one line."""
        return (
            f"Standard deviations ESTIMATED from {self.samples} random samples, each with a "
            f"standard error of up to {100 * self.relative_error:.2g} %"
        )

    def first_rows(self) -> Rows:
        """Return the points with their estimated standard deviations, mm."""
        found = self.points
        cells = ([name, *(1e3 * s).tolist()] for name, s in found.items())
        header = ["point", "estimated σx, mm", "estimated σy, mm", "estimated σz, mm"]
        return Rows(header, cells, len(found))

    def __str__(self) -> str:
        """Return the head line and root mean squares of the points."""
        sigmas = np.array(list(self.points.values())).reshape(-1, 3)
        rms = 1e3 * np.sqrt(np.mean(sigmas**2, axis=0)) if len(sigmas) else np.zeros(3)
        figures = " ".join(f"{s:.3g}" for s in rms)
        return f"{self.headline()}\nroot mean square of the points in x, y, z: {figures} mm"


@taking(Solution)
@with_one_thread
def estimate_precision(
    solution: Solution, *, samples: int = 64, seed: int = 1
) -> EstimatedPrecision:
    """Estimate the standard deviations of all unknowns from random samples.

    Any solution with a given datum is taken; those by ``solver="conjugate-gradients"`` have no
    other standard deviations of all unknowns. ``solution.covariance`` and
    ``solution.variable_covariance`` of single ones are solved for, and are no estimates.

    Args:
        solution: result of `adjust`.
        samples: number of samples k; the standard error of an estimate is 1/√(2 k) of it.
        seed: seed of the samples.

    Raises:
        InputError: less than two samples, or a free network.
        SingularError: the normal equations are singular at the solution.
    """
    if samples < 2:
        raise InputError(f"{samples} samples estimate nothing; valid: 2 or more")
    if solution.datum is not None:
        raise InputError(
            "estimates of standard deviations need a given datum, and this is a free network; "
            "valid: its own covariances (solution.covariance)"
        )
    factor = solution.factor
    system, source = solution.normal().system, np.random.default_rng(seed)
    squares = np.zeros(solution.equations.unknowns.n_columns)
    columns = factor.layers.point_columns
    for first in range(0, samples, MAX_SAMPLES_AT_ONCE):
        x = estimates_from_noise(system, factor, min(MAX_SAMPLES_AT_ONCE, samples - first), source)
        if factor.points is not None:
            x[columns] = factor.points.followed(x)
        squares += np.sum(x**2, axis=1)
    variances = squares / samples
    if factor.points is not None:
        variances[columns] += factor.points.own_variances()
    variances[~solution.equations.unknowns.free] = 0.0
    return EstimatedPrecision(solution, samples, variances * solution.variance_factor)
