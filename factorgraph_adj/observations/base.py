"""Base classes of observations: vectors, axes, sights, conditions; checks that all kinds share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import KW_ONLY, Field, dataclass, field, fields, replace
from functools import cache
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ..constructors import ChecksArguments
from ..control_characters import has_control_characters, why_refused
from ..entities import Key, parameter_key, parameter_name
from ..errors import InputError, Problem
from ..frames import Frame
from ..models.unknown_registry import ENTITIES, UNKNOWNS
from ..stochastic_model import PARTS, StandardDeviation, whitening
from ..types import Array
from .registry import KINDS, ObservationKind, Quantity, observation_kind

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
    """Return name of each field of a class, whether it holds text, and whether it may be None.

    The order is that of a call: fields by position, then by keyword, and last those of
    `Observation`, which dataclasses put first although the measured value matters most.
    """
    in_order = sorted(fields(kind), key=lambda f: (f.kw_only, f.name in _COMMON))
    return tuple((f.name, _is_text(f), "None" in str(f.type)) for f in in_order)


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
    id: str | None = field(default=None, kw_only=True)
    """Name of the observation in reports; None: the network numbers it."""
    source: str | None = field(default=None, kw_only=True)
    """File and line from which the observation was read."""

    def __init_subclass__(cls) -> None:
        """Give the class this representation; a dataclass keeps one that its class has."""
        cls.__repr__ = Observation.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """Return the call that makes the observation."""
        shown = ", ".join(f"{name}={getattr(self, name)!r}" for name, *_ in _fields(type(self)))
        return f"{type(self).__qualname__}({shown})"

    @property
    def record(self) -> ObservationKind:
        """Record of the kind; InputError if the kind is not registered."""
        return observation_kind(self.kind)

    @property
    def is_constraint(self) -> bool:
        """Whether it was stated of the object or of an instrument, and not measured."""
        return is_condition(self)

    @property
    def further(self) -> tuple[tuple[str, Key], ...]:
        """Kind and key of the unknowns that it depends on beside those of its record."""
        return ()

    def names(self) -> tuple[str, ...]:
        """Return the names by which reports and messages distinguish an observation from others.

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
        text = _name(self) if self.id is None else f"{_name(self)} (id {self.id})"
        return f"{self.source}: {text}" if self.source else text

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
        idle = [p for p in PARTS if p not in weight.parts and getattr(sigma, p)]
        if idle:
            self._fail(
                f"{', '.join(idle)} of sigma has no effect on a {self.kind.replace('_', ' ')}, "
                f"whose parts are constant, {', '.join(weight.parts)}"
            )

    def __post_init__(self) -> None:
        """Check the observation; InputError names the observation."""
        self._check()


_COMMON = frozenset(f.name for f in fields(Observation))
"""Names of the fields that every observation has."""


def joined_points(observations: Iterable[Observation]) -> set[str]:
    """Return the names of all points that observations join, see `Observation.points`."""
    return {name for observation in observations for name in observation.points()}


def of_quantities(observations: Iterable[Observation], *quantities: Quantity) -> Iterator[Any]:
    """Iterate over the observations of some quantities; their records name what they all have."""
    return (o for o in observations if o.record.quantity in quantities)


@dataclass(frozen=True)
class VectorObservation(Observation):
    """Base of observations of several components, with a σ for each of them or a covariance.

    A class states ``value`` and ``sigma`` with their units.
    """

    _: KW_ONLY
    covariance: Array | None = None
    """Covariance of the components, square units of the value; None if ``sigma`` is given."""

    def _check(self) -> None:
        super()._check()
        self._check_components()

    def _check_components(self) -> None:
        """Check the number of components of the value, its standard deviations and covariance."""
        size, value = len(self.component_names()), getattr(self, "value", None)
        if np.shape(value) != (size,):  # type: ignore[arg-type]  # what has no shape is refused
            self._fail(f"value must have {size} components, not {value}")
        checked_covariance(self, size)


@dataclass(frozen=True)
class AxesObservation(VectorObservation):
    """Base of observations of coordinates along some of the axes that the class may have."""

    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    _: KW_ONLY
    axes: str = "xyz"
    """Observed axes: some of the components of the class."""

    def component_names(self) -> tuple[str, ...]:
        """Return the observed axes."""
        return tuple(self.axes)

    def _check_components(self) -> None:
        given = set(self.axes)
        if not given or not given <= set(self.components) or len(given) < len(self.axes):
            valid = ", ".join(self.components)
            self._fail(f"axes must be some of {valid}, not {self.axes!r}")
        super()._check_components()


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


def is_condition(observation: object) -> bool:
    """Return whether an observation is a condition that no search for gross errors rejects."""
    return bool(getattr(observation, "condition", False))


@dataclass(frozen=True)
class Condition(Observation):
    """Base of relations of the object, which may be conditions."""

    _: KW_ONLY
    condition: bool = False
    """Whether `snoop` never rejects it."""

    def __post_init__(self) -> None:
        """Read the flag, which tables give as a number, and check the observation."""
        object.__setattr__(self, "condition", bool(self.condition))
        self._check()


def share_sigma(observation: Observation, size: int) -> None:
    """Let one standard deviation apply to all components of a vector observation."""
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
