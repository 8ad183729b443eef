"""Base classes of observations, and the checks that all kinds share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, Field, dataclass, fields, replace
from functools import cache
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ..constructors import ChecksArguments
from ..control_characters import has_control_characters, why_refused
from ..entities import Key, parameter_key, parameter_name
from ..errors import InputError, Problem
from ..frames import Frame
from ..models.variables import ENTITIES, UNKNOWNS
from ..stochastic_model import PARTS, StandardDeviation, whitening
from ..types import Array
from .registry import KINDS, ObservationKind, observation_kind

Sigma: TypeAlias = "float | StandardDeviation"


def _finite(value: Any) -> bool:
    """Return whether all numbers are finite; scalars, the usual case, need no array."""
    if isinstance(value, float | int):
        return math.isfinite(value)
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.dtype.kind in "iuf" and bool(np.all(np.isfinite(array)))


def _positive(value: Any) -> bool:
    """Return whether all numbers are > 0; `_finite` checks for NaN."""
    if isinstance(value, float | int):
        return not value <= 0
    return not np.any(np.asarray(value, dtype=float) <= 0)


def _is_text(f: Field[Any]) -> bool:
    """Return whether a field holds text; postponed annotations are compared as strings."""
    return f.type in (str, "str", "str | None") or str(f.type) == "str | None"


@cache
def _fields(kind: type[Observation]) -> tuple[tuple[str, bool, bool], ...]:
    """Return name of each field of a class, whether it holds text, and whether it may be None."""
    return tuple((f.name, _is_text(f), "None" in str(f.type)) for f in fields(kind))


def _name(observation: Observation) -> str:
    parts = [observation.kind, *(str(n) for n in observation.names())]
    return " ".join(parts)


@dataclass(frozen=True)
class Observation(metaclass=ChecksArguments):
    """Base of every kind of observation."""

    kind: ClassVar[str] = ""
    """Name of the kind, as in the ``kind`` column of tables."""
    components: ClassVar[tuple[str, ...]] = ("",)
    """Names of the scalar components; `component_names` gives those of one observation."""
    nonnegative: ClassVar[bool] = False
    """Whether a negative value is refused."""

    @property
    def record(self) -> ObservationKind:
        """Record of the kind; InputError if the kind is not registered."""
        return observation_kind(self.kind)

    @property
    def stated(self) -> bool:
        """Whether it was stated of the object or of an instrument, and not measured."""
        return is_condition(self)

    @property
    def further(self) -> tuple[tuple[str, Key], ...]:
        """Kind and key of the unknowns that it depends on beside those of its record."""
        return ()

    def names(self) -> tuple[str, ...]:
        """Return the names by which reports and messages tell an observation from others.

        They are its frame, if it was measured in one, the points and photos that it joins, and all
        names of `further`.
        """
        own = self._stated((*self.record.frames, *self.record.named))
        return own + tuple(parameter_name(key) for _, key in self.further)

    def frames(self) -> tuple[str, ...]:
        """Return the names of the frames of their own in which the observation was measured."""
        return self._stated(self.record.frames)

    def points(self) -> tuple[str, ...]:
        """Return the names of the points that the observation joins."""
        own = self._stated(self.record.points)
        return own + tuple(str(name) for kind, name in self.further if kind == "point")

    def photos(self) -> tuple[str, ...]:
        """Return the names of the photos that the observation joins."""
        own = self._stated(self.record.photos)
        return own + tuple(str(name) for kind, name in self.further if kind == "pose")

    def parameters(self) -> tuple[tuple[str, Key], ...]:
        """Return kind and key of every parameter that the observation may depend on."""
        own = ((k, parameter_key(UNKNOWNS[k], a, self)) for k, a in self.record.parameters)
        return (*own, *((k, key) for k, key in self.further if k not in ENTITIES))

    def found_parameters(self) -> tuple[tuple[str, Key], ...]:
        """Return those of its parameters that nobody has to state, such as orientations."""
        further = self.further and ((k, key) for k, key in self.further if k not in ENTITIES)
        return (
            *[(k, parameter_key(UNKNOWNS[k], a, self)) for k, a in self.record.found],
            *[(k, key) for k, key in further if UNKNOWNS[k].absent == "found"],
        )

    def _stated(self, attributes: Sequence[str]) -> tuple[str, ...]:
        """Return the names in some attributes, without those that name nothing."""
        return tuple(n for a in attributes if (n := getattr(self, a)) is not None)

    def component_names(self) -> tuple[str, ...]:
        """Return the names of the scalar components; a scalar has one empty name."""
        return self.components

    def with_reading(self, values: Sequence[float], frame: Frame) -> Observation:
        """Return the observation with another reading.

        Args:
            values: the reading, one number for each component; angles of the whole circle are
                taken modulo 2π.
            frame: frame of the network.
        """
        if len(self.components) > 1:
            return replace(self, value=tuple(values))  # type: ignore[call-arg]
        value = values[0] % (2 * np.pi) if self.record.circular else values[0]
        return replace(self, value=value)  # type: ignore[call-arg]

    def label(self) -> str:
        """Return a readable name for messages: source, kind, points and id."""
        ident, source = getattr(self, "id", None), getattr(self, "source", None)
        text = _name(self) if ident is None else f"{_name(self)} (id {ident})"
        return f"{source}: {text}" if source else text

    def _fail(self, what: str) -> None:
        raise InputError(Problem(what, self.label()))

    def _check(self) -> None:
        """Check values, standard deviations and names."""
        for name, text, optional in _fields(type(self)):
            value = getattr(self, name)
            if text:
                if not isinstance(value, str) and (value is not None or not optional):
                    self._fail(f"{name} must be text, not {value!r}")
                elif value is not None and name != "source" and has_control_characters(value):
                    self._fail(f"{name}: {why_refused(value)}")
                continue
            if isinstance(value, StandardDeviation):
                self._check_parts(value)
                continue
            if value is None and optional:
                continue
            if not _finite(value):
                shown = repr(value) if isinstance(value, str) else value
                self._fail(f"{name} must be a finite number, not {shown}")
            if name == "sigma" and not _positive(value):
                self._fail(f"sigma must be greater than zero, not {value}")
        if self.nonnegative and getattr(self, "value", 0.0) < 0:
            self._fail(f"a distance cannot be negative: {getattr(self, 'value', None)}")
        if "" in self.names():
            self._fail("names must be non-empty text, not ''")
        points = self.points()
        if len(set(points)) < len(points):
            self._fail("an observation cannot join a point to itself")

    def _check_parts(self, sigma: StandardDeviation) -> None:
        """Refuse parts of a standard deviation that have no effect on the observation."""
        record = KINDS.get(self.kind)
        weight = None if record is None else record.weight
        if weight is None:
            return
        idle = [p for p in PARTS if p not in weight.parts and getattr(sigma, p) != 0]
        if idle:
            self._fail(
                f"{', '.join(idle)} of sigma has no effect on a {self.kind.replace('_', ' ')}, "
                f"whose parts are constant, {', '.join(weight.parts)}"
            )

    def __post_init__(self) -> None:
        """Check the observation; InputError names the observation."""
        self._check()


@dataclass(frozen=True)
class Sight(Observation):
    """Base of observations from a station to a target."""

    station: str
    """Point of the instrument, i."""
    target: str
    """Point of the target, j."""
    value: float
    """Observed value, metres or radians."""
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation, unit of the value."""
    instrument_height: float = 0.0
    """Height of the instrument above its point along the vertical, metres."""
    target_height: float = 0.0
    """Height of the target above its point along the vertical, metres."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""


def is_condition(observation: object) -> bool:
    """Return whether an observation is a condition that no search for gross errors sets aside."""
    return bool(getattr(observation, "condition", False))


@dataclass(frozen=True)
class Condition(Observation):
    """Base of observations with a flag ``condition``: whether `snoop` never sets them aside."""

    def __post_init__(self) -> None:
        """Read the flag, which tables give as a number, and check the observation."""
        object.__setattr__(self, "condition", bool(getattr(self, "condition", False)))
        self._check()


def share_sigma(observation: Observation, size: int) -> None:
    """Let one standard deviation stand for all components of a vector observation."""
    sigma = getattr(observation, "sigma", None)
    if isinstance(sigma, int | float):
        object.__setattr__(observation, "sigma", (float(sigma),) * size)


def checked_covariance(observation: Observation, size: int) -> Array | None:
    """Check ``covariance`` and ``sigma`` of a vector observation; return the covariance."""
    sigma = getattr(observation, "sigma", None)
    covariance = getattr(observation, "covariance", None)
    if (sigma is None) == (covariance is None):
        observation._fail("give either sigma or covariance")
    if covariance is None:
        if np.shape(np.asarray(sigma)) != (size,):
            observation._fail(f"sigma must be {size} standard deviations, not {sigma!r}")
        return None
    matrix = np.asarray(covariance, dtype=float)
    if matrix.shape != (size, size):
        observation._fail(f"covariance must be {size} × {size}, not {matrix.shape}")
    try:
        whitening(matrix)
    except InputError as error:
        observation._fail(str(error))
    return matrix
