"""Observations with a joint covariance; positions, attitudes correlated in time (Gauss-Markov)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..constructors import ChecksArguments
from ..errors import InputError, Problem
from ..stochastic_model import whitening
from ..types import Array
from .base import Observation
from .image import ImagePoint

AnyObservation: TypeAlias = "Observation | Correlated"
"""An observation, or several observations with a joint covariance."""


@dataclass(frozen=True)
class Correlated(metaclass=ChecksArguments):
    """Observations with one joint covariance (GNSS clusters, control, points of a photo)."""

    observations: tuple[Observation, ...]
    """Observations of any kinds; image points with image points only, of one photo or several."""
    covariance: Array
    """Covariance of all scalar components in the order of ``observations``, in their units (of
    image points in units of their images). It takes the place of what they state themselves."""

    def __post_init__(self) -> None:
        """Check sizes and that the covariance is positive definite."""
        size = sum(len(o.component_names()) for o in self.observations)
        where = " + ".join(o.label() for o in self.observations[:3])
        images = [isinstance(o, ImagePoint) for o in self.observations]
        if any(images) and not all(images):
            what = "image points are correlated with image points only; give the others apart"
            raise InputError(Problem(what, where))
        if np.shape(self.covariance) != (size, size):
            raise InputError(
                Problem(
                    f"covariance must be {size} × {size}, not {np.shape(self.covariance)}", where
                )
            )
        try:
            whitening(self.covariance)
        except InputError as error:
            raise InputError(Problem(str(error), where)) from None


def gauss_markov(
    observations: Sequence[Observation],
    times: Sequence[float],
    *,
    correlation_time: float,
    white: float = 0.0,
) -> Correlated:
    """Return vector observations of a strip with errors that are correlated in time; FRAMES F7.7.

        Σ_ij = exp(−|t_i − t_j| / T) L_i L_jᵀ,   Σ_i = L_i L_iᵀ

    with the covariance Σ_i that observation i states. Neighbours err alike: as long as T is not
    short beside the time between exposures, a strip has a common error like a shift, which its
    number of exposures does not reduce.

    Args:
        observations: observed positions or attitudes of the strip, with as many components each.
        times: their times t, in the unit of T.
        correlation_time: T, at which the correlation is 1/e; some minutes for GNSS.
        white: standard deviation of an uncorrelated error in each component besides, SI.

    Raises:
        InputError: numbers of observations and times differ, T is not positive, an observation is
            no vector, or times are equal and there is no white error.
    """
    t = np.asarray(times, dtype=float)
    if t.shape != (len(observations),) or not np.isfinite(t).all():
        raise InputError(f"give a time for each of {len(observations)} observations, not {times!r}")
    if not correlation_time > 0:
        raise InputError(f"correlation_time must be greater than zero, not {correlation_time}")
    if not white >= 0:
        raise InputError(f"white must be zero or greater, not {white}")
    roots = []
    for o in observations:
        covariance: Array | None = getattr(o, "covariance", None)
        sigma: tuple[float, ...] = getattr(o, "sigma", None) or ()
        if not o.record.takes_covariance:
            raise InputError(f"{o.label()}: a {o.kind} is no vector with a covariance")
        full = np.diag(np.array(sigma) ** 2) if covariance is None else np.asarray(covariance)
        roots.append(np.linalg.cholesky(full))
    if len({len(r) for r in roots}) > 1:
        raise InputError("the observations must have the same number of components")
    stacked = np.concatenate(roots)
    d = len(roots[0])
    rho = np.exp(-np.abs(t[:, None] - t) / correlation_time)
    joint = np.kron(rho, np.ones((d, d))) * (stacked @ stacked.T)
    joint += white**2 * np.eye(len(joint))
    return Correlated(tuple(observations), joint)
