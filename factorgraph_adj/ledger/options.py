"""The options of an incremental adjustment."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Literal, TypeAlias, get_args

from ..errors import InputError, Problem, known
from ..network.network import DatumChoice
from .verdicts import Outcome, Policy

POLICIES = ("accept", "flag", "reject")
DATUMS = get_args(DatumChoice)
Engine: TypeAlias = Literal["auto", "isam2", "fronts"]
"""What carries the arrivals."""
ENGINES = get_args(Engine)


@dataclass(frozen=True)
class Options:
    """The options of an incremental adjustment."""

    policy: Policy
    """What becomes of an observation beyond the critical value."""
    alpha: float
    """Probability of a false alarm of one test."""
    accuracy: float
    """Largest deviation from the batch adjustment, relative to σ."""
    datum: DatumChoice
    """Datum of the network."""
    engine: Engine = "auto"
    """What carries the arrivals: iSAM2, fronts, or what suits the network."""
    keep: int | None = None
    """Number of photos that are kept, the last ones; none: all are."""

    def __post_init__(self) -> None:
        """Refuse options that make no sense, all together."""
        problems = []
        if self.policy not in POLICIES:
            valid = known(POLICIES, meant=self.policy)
            problems.append(Problem(f"unknown policy {self.policy!r}; valid: {valid}"))
        if not isinstance(self.alpha, Real) or not 0 < self.alpha < 1:
            problems.append(Problem(f"alpha must be between 0 and 1, not {self.alpha!r}"))
        if not isinstance(self.accuracy, Real) or not 0 < self.accuracy <= 0.1:
            problems.append(Problem(f"accuracy must be in (0, 0.1], not {self.accuracy!r}"))
        if self.datum not in DATUMS:
            problems.append(
                Problem(f"unknown datum {self.datum!r}; valid: {known(DATUMS, meant=self.datum)}")
            )
        if self.engine not in ENGINES:
            valid = known(ENGINES, meant=self.engine)
            problems.append(Problem(f"unknown engine {self.engine!r}; valid: {valid}"))
        if self.keep is not None:
            if not isinstance(self.keep, int) or isinstance(self.keep, bool) or self.keep < 1:
                what = "a whole number of photos, 1 or more, or None: all are kept"
                problems.append(Problem(f"keep must be {what}; not {self.keep!r}"))
            elif self.datum == "free":
                what = "its datum is that of all datum points"
                problems.append(Problem(f"keep: nothing of a free network can be retired, {what}"))
        if problems:
            raise InputError(problems)

    @property
    def failed(self) -> Outcome:
        """What becomes of an observation that fails its test."""
        return "rejected" if self.policy == "reject" else "suspect"
