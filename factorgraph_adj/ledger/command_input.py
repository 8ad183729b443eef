"""Checked input of the commands of an incremental adjustment: options, observations, times, ids.

Options, observations, factors, names and times that are wrong are refused, all of them at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from numbers import Real
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, get_args

from ..entities import Camera, Photo, Point, parameter_name
from ..errors import InputError, Problem, known
from ..graph.dependence import Variable
from ..graph.user_factors import MakesFactor
from ..network.additions import UnknownsGiven, unknowns_by_kind
from ..network.network import DatumChoice
from ..observations import AnyObservation, Correlated, Observation
from .verdicts import Outcome, Policy

TICKS_PER_SECOND = 1_000_000
"""Resolution of the times of arrivals."""
MIN_SECONDS = 1e-3
"""Shortest time for which arrivals can be kept, seconds."""
MAX_SECONDS = 1e11
"""Latest time of an arrival, seconds: more than three thousand years."""
POLICIES = ("accept", "flag", "reject")
DATUMS = get_args(DatumChoice)
Thing = TypeVar("Thing")
"""An argument of a command, one or several of which are given."""
Engine: TypeAlias = Literal["auto", "isam2", "fronts"]
"""Engine that holds the linear system."""
ENGINES = get_args(Engine)


def is_seconds(value: object, *, least: float = 0.0) -> bool:
    """Return whether a value is a number of seconds, from ``least`` to `MAX_SECONDS`."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    return isfinite(value) and least <= float(value) <= MAX_SECONDS


def checked(time: object, latest: float | None) -> float:
    """Return the time of an arrival, in seconds.

    Args:
        time: the time.
        latest: that of the latest arrival; None: no other stated one.

    Raises:
        InputError: it is not a time, or before the latest arrival.
    """
    if not isinstance(time, Real) or not is_seconds(time):
        what = f"the time of an arrival must be from 0 to {MAX_SECONDS:g} seconds"
        raise InputError(f"{what}; not {time!r}")
    if latest is not None and time < latest:
        what = f"the time of an arrival, {time!r} s, must not be before that of an earlier one"
        raise InputError(f"{what}, {latest!r} s")
    return float(time)


def ticks(seconds: float) -> int:
    """Return a time as a number of ticks."""
    return round(TICKS_PER_SECOND * seconds)


class Input(NamedTuple):
    """Everything given to an adjustment at once."""

    observations: list[AnyObservation]
    """Observations."""
    points: list[Point]
    """New points."""
    photos: list[Photo]
    """New photos."""
    cameras: list[Camera]
    """New cameras."""
    unknowns: UnknownsGiven
    """New unknowns of other kinds, by kind and key."""
    factors: dict[str, MakesFactor]
    """Functions that make factors, by name."""

    def refuse_factors(self) -> None:
        """Refuse what a journal cannot hold.

        Raises:
            InputError: there are factors.
        """
        if self.factors:
            raise InputError(
                "this adjustment keeps a journal, which cannot hold a factor: register a kind of "
                "observation (register_observation), or do without the journal"
            )

    @property
    def describes(self) -> bool:
        """Whether there is anything besides observations and factors."""
        return bool(self.points or self.photos or self.cameras or self.unknowns)

    @property
    def variables(self) -> list[Variable]:
        """Kind and name of everything that is described."""
        return [
            *(("point", p.name) for p in self.points),
            *(("pose", f.name) for f in self.photos),
            *(("calibration", c.name) for c in self.cameras),
            *((k, parameter_name(key)) for k, given in self.unknowns.items() for key in given),
        ]

    @classmethod
    def of(
        cls,
        observations: object,
        points: object,
        photos: object,
        cameras: object,
        unknowns: object,
        factors: Mapping[str, MakesFactor] | None,
    ) -> Input:
        """Return the arguments as lists; factors by name.

        Raises:
            InputError: all arguments of another type.
        """
        noun = "observation: see factorgraph_adj.observations"
        return cls(
            listed(observations, noun, Observation, Correlated),
            listed(points, "fga.Point", Point),
            listed(photos, "fga.Photo", Photo),
            listed(cameras, "fga.Camera", Camera),
            unknowns_by_kind(unknowns),
            _by_name(factors),
        )


def _by_name(factors: object) -> dict[str, MakesFactor]:
    """Return functions that make factors, by name.

    Raises:
        InputError: they have no names.
    """
    if factors is None:
        return {}
    if not isinstance(factors, Mapping) or not all(n and isinstance(n, str) for n in factors):
        raise InputError("give factors by name: factors={'name': lambda key: …}")
    return dict(factors)


def listed(given: object, noun: str, *kinds: type[Thing]) -> list[Thing]:
    """Return one thing, or several, as a list.

    Args:
        given: the things.
        noun: what each of them should be, for messages.
        kinds: what each of them may be.

    Raises:
        InputError: everything that is something else.
    """
    several = isinstance(given, Iterable) and not isinstance(given, str)
    items: list[Any] = list(given) if several else [given]  # type: ignore[call-overload]
    problems = [Problem(f"is no {noun}", repr(i)[:80]) for i in items if not isinstance(i, kinds)]
    if problems:
        raise InputError(problems)
    return items


def ids_in(given: str | Iterable[str]) -> list[str]:
    """Return ids as a list.

    Raises:
        InputError: all ids that are not texts.
    """
    return listed(given, "id: an id is a text", str)


@dataclass(frozen=True)
class Options:
    """The options of an incremental adjustment."""

    policy: Policy
    """Treatment of an observation beyond the critical value."""
    alpha: float
    """Probability of a false alarm of one test."""
    accuracy: float
    """Largest deviation from the batch adjustment, relative to σ."""
    datum: DatumChoice
    """Datum of the network."""
    engine: Engine = "auto"
    """Engine that holds the linear system: iSAM2, fronts, or the one that suits the network."""
    keep: int | None = None
    """Number of the latest photos that are kept; None: all are."""
    keep_seconds: float | None = None
    """Seconds before the latest arrival whose arrivals are kept; None: all are."""

    def __post_init__(self) -> None:
        """Refuse invalid options, all together."""
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
        """Yield the problems of the retirement window."""
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
        """Whether anything is retired automatically."""
        return self.keep is not None or self.keep_seconds is not None

    @property
    def failed(self) -> Outcome:
        """Outcome of an observation that fails its test."""
        return "rejected" if self.policy == "reject" else "suspect"
