"""Options of a report (units, rows, α, confidence); provenance (run, snooping, variances)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias, get_args

from ..errors import InputError
from ..io.numbers import Units
from ..network.network import Network
from ..quality.error_ellipses import confidence_factor
from ..quality.point_precision import Place
from ..quality.rejections import Snooping
from ..quality.reliability import check_probabilities
from ..quality.variance_components import VarianceComponents
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST

Test: TypeAlias = Literal["baarda", "pope"]
"""Test values of a report: w (baarda), or τ = w/σ̂0 (pope)."""


@dataclass(frozen=True)
class ReportOptions:
    """Options of a report.

    Raises:
        InputError: a probability is outside (0, 1), α0 ≥ power, or the test is unknown.
    """

    units: Units = field(default_factory=Units)
    """Units of coordinates, angles and their standard deviations."""
    most: int = 60
    """Largest number of rows of a list; a note states the number of omitted rows."""
    n_suspects: int = 15
    """Number of observations with the largest test values that are listed."""
    tables: str = ""
    """Folder of the CSV tables; the notes about omitted rows refer to it."""
    alpha: float = ALPHA_OF_OBSERVATION
    """Probability α0 of a false alarm of one test."""
    power: float = POWER_OF_TEST
    """Probability with which the test finds an error of the smallest detectable size."""
    test: Test | None = None
    """Test values that are shown; None: τ if σ are a posteriori, otherwise w."""
    confidence: float | None = None
    """Probability of error ellipses of points and ellipsoids of projection centres; None omits
    both."""
    relative: Sequence[tuple[Place, Place]] | Literal["observed"] | None = None
    """Pairs of places whose adjusted distance, azimuth, rise and relative error ellipse are listed;
    ``observed``: all pairs that observations join; None omits the list."""

    survey: float | tuple[float, float] | None = None
    """σ of the survey of the check points, metres, as for `positional_accuracy`; None: unknown."""

    protection_risk: float | None = None
    """Integrity risk of protection levels of points, see `protection_levels`; None omits them."""
    faults: Literal[1, 2] = 2
    """Number of readings with gross errors up to which these levels hold."""

    def __post_init__(self) -> None:
        """Check probabilities and test."""
        check_probabilities(self.alpha, self.power)
        if self.protection_risk is not None and not 0 < self.protection_risk < 1:
            raise InputError(
                f"the risk of protection levels must lie between 0 and 1: {self.protection_risk}"
            )
        confidence_factor(2, self.confidence)
        if self.test is not None and self.test not in get_args(Test):
            valid = ", ".join(get_args(Test))
            raise InputError(f"unknown test {self.test!r}; valid: {valid}, or none")


@dataclass(frozen=True)
class Run:
    """What a text report says of the run that it comes from; empty texts are left out."""

    file: str = ""
    """The file or folder that was adjusted, as it was named."""
    date: str = ""
    """Date and time; the library looks at no clock, so that the same call gives the same text."""
    options: str = ""
    """Options of the run, in words or as they were typed."""
    subject: str = ""
    """What was adjusted, such as an epoch of a site; it stands in the heading for the network."""


@dataclass(frozen=True)
class LeftOutReading:
    """A reading that is not in an adjustment: rejected by a test or a person, or waiting."""

    label: str
    """Readable name with its id."""
    state: str
    """``rejected``, ``suspect`` or ``waiting``."""
    why: str
    """Why it is out, in words."""

    def __str__(self) -> str:
        return f"left out ({self.state}): {self.label}" + f": {self.why}" * bool(self.why)


@dataclass(frozen=True)
class Provenance:
    """The run and the earlier steps that a solution comes from."""

    snooping: Snooping | None = None
    """Data snooping that gave the solution or the network that was adjusted."""
    original: Network | None = None
    """The network with all observations, before data snooping."""
    components: VarianceComponents | None = None
    """Variance components that determined the weights of the solution."""
    run: Run = field(default_factory=Run)
    """File, date and options of the run."""
    left_out: Sequence[LeftOutReading] = ()
    """Readings that an incremental adjustment has left out."""

    def with_snooping(self, found: Snooping) -> Provenance:
        """Return the provenance of the solution of data snooping."""
        original = self.original
        if original is None and found.whole is not None:
            original = found.whole.network
        return replace(self, snooping=found, original=original)
