"""The options of an incremental adjustment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real
from typing import Literal, TypeAlias, get_args

from ..errors import InputError, Problem, known
from ..network.network import DatumChoice
from .command_input import MIN_SECONDS, is_seconds
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
    keep_seconds: float | None = None
    """Seconds, the last ones, whose arrivals are kept; none: all are."""

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
        if problems := [*problems, *self._problems_of_window()]:
            raise InputError(problems)

    def _problems_of_window(self) -> Iterator[Problem]:
        """Yield what is wrong with what is kept."""
        keep, seconds = self.keep, self.keep_seconds
        if keep is not None and (not isinstance(keep, int) or isinstance(keep, bool) or keep < 1):
            what = "a whole number of photos, 1 or more, or None: all are kept"
            yield Problem(f"keep must be {what}; not {keep!r}")
        if seconds is not None and not is_seconds(seconds, least=MIN_SECONDS):
            what = f"{MIN_SECONDS} or more, or None: everything is kept"
            yield Problem(f"keep_seconds must be {what}; not {seconds!r}")
        if keep is not None and seconds is not None:
            yield Problem("give either keep, a number of photos, or keep_seconds, not both")
        if self.forgets and self.datum == "free":
            what = "its datum is that of all datum points"
            yield Problem(f"keep: nothing of a free network can be retired, {what}")

    @property
    def forgets(self) -> bool:
        """Whether anything is retired by itself."""
        return self.keep is not None or self.keep_seconds is not None

    @property
    def failed(self) -> Outcome:
        """What becomes of an observation that fails its test."""
        return "rejected" if self.policy == "reject" else "suspect"
