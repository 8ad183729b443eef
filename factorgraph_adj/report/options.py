"""How a solution is to be shown, and what it comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

from ..errors import InputError
from ..io.numbers import Units
from ..network.network import Network
from ..quality.ellipses import confidence_factor
from ..quality.levels import ALPHA, POWER
from ..quality.rejections import Snooping
from ..quality.reliability import check_probabilities
from ..quality.variance_components import VarianceComponents

Test: TypeAlias = Literal["baarda", "pope"]
"""Which test values are shown: w, or τ = w/σ̂0."""


@dataclass(frozen=True)
class ReportOptions:
    """How a solution is shown.

    Raises:
        InputError: probabilities outside (0, 1), α0 ≥ power, a test that there is not.
    """

    units: Units = field(default_factory=Units)
    """Units of coordinates, angles and their standard deviations."""
    most: int = 60
    """Number of rows after which a list is cut, with a note of what is left out."""
    n_suspects: int = 15
    """Number of observations with the largest test values that are listed."""
    tables: str = ""
    """Folder where the CSV tables lie, for those notes."""
    alpha: float = ALPHA
    """Probability α0 of a false alarm of one test."""
    power: float = POWER
    """Probability with which an error of the smallest detectable size is found."""
    test: Test | None = None
    """Which test values are shown; none: τ where σ are a posteriori, else w."""
    confidence: float | None = None
    """Probability of error ellipses of points and ellipsoids of projection centres; none: neither
    are shown."""

    def __post_init__(self) -> None:
        """Check probabilities and test."""
        check_probabilities(self.alpha, self.power)
        confidence_factor(2, self.confidence)
        if self.test is not None and self.test not in get_args(Test):
            valid = ", ".join(get_args(Test))
            raise InputError(f"unknown test {self.test!r}; valid: {valid}, or none")


@dataclass(frozen=True)
class Provenance:
    """What a solution comes from."""

    snooping: Snooping | None = None
    """Data snooping that found it, or whose network was adjusted."""
    original: Network | None = None
    """The network before anything was set aside."""
    components: VarianceComponents | None = None
    """Variance components that its weights come from."""
