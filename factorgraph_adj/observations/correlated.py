"""Observations with one joint covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..constructors import ChecksArguments
from ..errors import InputError, Problem
from ..stochastic import whitening
from ..types import Array
from .base import Observation
from .image import ImagePoint


@dataclass(frozen=True)
class Correlated(metaclass=ChecksArguments):
    """Observations with one joint covariance (GNSS clusters, control with covariance)."""

    observations: tuple[Observation, ...]
    """Observations of any kinds except image coordinates."""
    covariance: Array
    """Covariance of all scalar components in the order of ``observations``, in their units."""

    def __post_init__(self) -> None:
        """Check sizes and that the covariance is positive definite."""
        size = sum(len(o.component_names()) for o in self.observations)
        where = " + ".join(o.label() for o in self.observations[:3])
        if any(isinstance(o, ImagePoint) for o in self.observations):
            raise InputError(Problem("image coordinates cannot be in a correlated group", where))
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


AnyObservation: TypeAlias = "Observation | Correlated"
"""An observation, or several observations with a joint covariance."""
