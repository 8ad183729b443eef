"""`ObservationKind`, the record of a kind of observations, its registration; sets of quantities.

A kind consists of a frozen dataclass (the observed values), a model function (the computed values)
and the record `ObservationKind` that joins the two. `register_observation` adds a kind. The batch
adjustment, the graph, reliability, the incremental adjustment, tables, records, plans and
simulations then treat the new kind like a built-in kind.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, Problem, known
from ..models.base import Linearised
from ..models.shape_outlines import Outline
from ..models.unknown_registry import ENTITIES, UNKNOWNS
from ..stochastic_model import PARTS
from ..types import Array
from .variances import Weight

_NAME = re.compile(r"[a-z][a-z0-9]*")

Unit: TypeAlias = Literal["m", "rad", "image", "mixed"]
"""Unit of observed values: metres, radians, image units, or a unit for each component (mixed)."""
Quantity: TypeAlias = Literal[
    "other",
    "direction",
    "azimuth",
    "gyro azimuth",
    "horizontal angle",
    "zenith angle",
    "vertical angle",
    "slope distance",
    "horizontal distance",
    "height difference",
    "vector",
    "vector in a frame",
    "coordinate difference",
    "coordinates",
    "GNSS coordinates",
    "coordinates of a photo",
    "coordinates in a strip",
    "attitude of a photo",
    "point of a line in a photo",
    "mark of a film",
    "image of a point through an interface",
    "distance of photos",
    "relative rotation",
    "relative position",
    "height above a level",
    "height in a profile",
]
"""Quantity that an observation has in the axes of a network, whatever its instrument is."""
DISTANCE_QUANTITIES: frozenset[Quantity] = frozenset(("slope distance", "horizontal distance"))
"""Distances of two points."""
INCLINATION_QUANTITIES: frozenset[Quantity] = frozenset(("zenith angle", "vertical angle"))
"""Angles in the vertical plane of a sight."""
PLAN_QUANTITIES: frozenset[Quantity] = frozenset(
    ("direction", "horizontal angle", "azimuth", "gyro azimuth", "horizontal distance")
)
"""Quantities that say nothing of heights, except by the geometry of steep sights."""
PLANE_ADVICE = "make the network plane where heights are not wanted (dimension = 2)"
"""What to do where heights are missing; ``dimension`` is a key of projects and mappings, and an
option of formats that need it."""
SIGHT_QUANTITIES: frozenset[Quantity] = frozenset(
    (
        *DISTANCE_QUANTITIES,
        *INCLINATION_QUANTITIES,
        "direction",
        "azimuth",
        "gyro azimuth",
        "horizontal angle",
        "height difference",
        "vector",
    )
)
"""Quantities of a station and a target, each with a height above its point."""
CONTROL_QUANTITIES: frozenset[Quantity] = frozenset(("coordinates", "GNSS coordinates"))
"""Coordinates of a point in the axes of the network."""
POSITION_QUANTITIES: frozenset[Quantity] = CONTROL_QUANTITIES | {"coordinates of a photo"}
"""Coordinates of a point or a photo in the axes of the network."""
_ENDS = tuple((kind, end) for end in ("station", "target") for kind in ("point", "vertical"))
_AFTER_ENDS: dict[str, str] = {
    "direction": "orientation",
    "gyro azimuth": "gyro",
    "horizontal angle": "point",
    "slope distance": "edm",
    "horizontal distance": "edm",
}
"""Kind of the unknown that follows both ends of a sight, by its quantity."""
_HEIGHTS = ("instrument_height", "target_height")
_READ_BY_QUANTITY: dict[str, tuple[str, ...]] = {
    "direction": (*_HEIGHTS, "set", "face"),
    "zenith angle": (*_HEIGHTS, "face", "in_face_one", "index_error", "refraction"),
    "vertical angle": (*_HEIGHTS, "refraction"),
    "slope distance": (*_HEIGHTS, "instrument"),
    "horizontal distance": (*_HEIGHTS, "instrument"),
    "horizontal angle": (*_HEIGHTS, "target2"),
    **dict.fromkeys(("azimuth", "gyro azimuth", "height difference", "vector"), _HEIGHTS),
    **dict.fromkeys(CONTROL_QUANTITIES, ("point", "axes", "local")),
    "coordinates of a photo": ("photo", "axes", "lever_arm"),
    "coordinates in a strip": ("point", "axes"),
    "attitude of a photo": ("photo", "mount", "object_R_body"),
    "point of a line in a photo": ("photo", "line", "x", "y"),
    "mark of a film": ("photo", "value", "film_x", "film_y"),
    "image of a point through an interface": ("photo", "point", "value"),
    "distance of photos": ("photo", "photo2"),
    "relative position": ("photo", "photo2", "mount", "instrument"),
}
"""Attributes that approximate values and checks read of an observation, by its quantity."""
TOTAL_STATION_QUANTITIES: frozenset[Quantity] = frozenset(
    (*DISTANCE_QUANTITIES, *INCLINATION_QUANTITIES, "direction", "azimuth", "horizontal angle")
)
"""Quantities that a total station reads."""
KINDS: dict[str, ObservationKind] = {}
"""Registered kinds of observations by name."""
IN_MEMORY: dict[str, ObservationKind] = {}
"""Kinds whose observations no file, record or journal can hold, by name."""


@dataclass(frozen=True)
class Follower:
    """A variable of a kind that an observation may place: the member of a rig, by its carrier."""

    place: int
    """Place of the variable among the variables of the kind."""
    carrier: int
    """Place of the variable of the same kind that it follows."""
    placed: Callable[..., Array]
    """(residuals v (n, d), *stored values, observed=…) → stored values (n, s) of the variable with
    which the model gives v."""


@dataclass(frozen=True)
class ObservationKind:
    """Record of a kind of observation."""

    observation: type[Any]
    """Class derived from `Observation`. Its ``kind`` is the name of the kind; its fields are the
    columns of tables."""
    variables: tuple[tuple[str, str], ...]
    """Kind of each unknown of the model, and the attribute that names the unknown, in order. An
    attribute that is None names nothing: the model gets None. ``frame.origin`` is the point at the
    origin of the frame that the attribute ``frame`` names, if its origin is a point."""
    model: Callable[..., Linearised] | None
    """(frame, *variables, observed=…, constants…) → residuals and partials; None for image
    coordinates and for single coordinates of a point, whose rows the graph builds itself."""
    constants: tuple[str, ...] = ()
    """Attributes of the observation that the model takes as arrays: fields, or properties that
    follow from them."""
    unit: Unit = "m"
    """Unit of the observed value."""
    weight: Weight | None = None
    """Variance as a function of the parts of a `StandardDeviation`; None if the class takes plain
    numbers only."""
    linear: bool = False
    """Whether residuals are linear in the coordinates of the points in a flat frame, while other
    unknowns are held: the partials by the points are the same wherever these are."""
    circular: bool = False
    """Whether the value is an angle of the full circle, from 0 to 2π."""
    fixes: Literal["nothing", "direction", "coordinates", "attitude", "place"] = "nothing"
    """Information about the position of the network: nothing, its direction from north,
    coordinates in the frame of the network, or a place on the Earth (astronomic latitude,
    longitude)."""
    quantity: Quantity = "other"
    """Quantity in the axes of the network. Approximate values, checks before an adjustment, and
    causes of gross errors take observations by it; an adjustment needs it not at all."""
    in_frame: Literal["nothing", "coordinates", "direction", "zenith", "distance"] = "nothing"
    """Quantity of its point in a frame of its own, for approximate values and for checks."""
    by_axis: bool = False
    """Whether an observation has one row for each of its known coordinates, ``axes``."""
    in_image_table: bool = False
    """Whether a network holds its observations in columns, because there are many: image points,
    whose names are photo/point, whose axes are those of the camera and whose rows are rays."""
    level_reading: float | None = None
    """Reading of a level sight, radians, of an angle whose sights are nearly level as a rule; None
    for other kinds. It reveals a wrong unit."""
    choices: tuple[str, ...] = ()
    """Attributes of text that choose among forms of the observation, such as an angle."""
    moved: Callable[..., Array] | None = None
    """(observed (n, d), change (n, d), constants…) → the readings whose residuals are larger by
    −change; None: the sum. Readings of rotations do not add."""
    follower: Follower | None = None
    """Variable that steps keep with its carrier, however small the standard deviations are."""
    shape: str = ""
    """Shape that its first frame is, a key of `factorgraph_adj.models.shapes.SHAPES`; empty: it
    says nothing of a shape."""
    turns: bool = False
    """Whether its two values are counted along two axes of its first frame, and turn about the
    third with the object while the frame is held about it, as the distances from a line do."""
    one_sided: bool = False
    """Whether its value is a distance from a line, the same on every side: it has no partials on
    the line itself, where a start is moved aside."""
    instrument: str = ""
    """Attribute with the place of its instrument: over a point, or in the zero of a
    frame of its own; empty if it needs no such setup, as a tape or a level."""
    part_of: str = ""
    """Noun of the reading of which it is a part, together with correlated observations of other
    kinds between the same places: they have one test, and are rejected together. Empty: it is a
    reading itself."""
    outline: Outline | None = None
    """How plans draw what its first frame is, from the points that it has: a shape, a wire."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """Its name in reports by language, such as ``de``, where no catalogue of texts has it."""

    @property
    def name(self) -> str:
        """Name of the kind."""
        return str(self.observation.kind)

    @cached_property
    def named(self) -> tuple[str, ...]:
        """Attributes that name points and photos, in the order of the variables, each once."""
        each = (a for kind, a in self.variables if kind in ENTITIES and "." not in a)
        return tuple(dict.fromkeys(each))

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """Attributes that name frames of their own, each once."""
        return tuple(a for kind, a in self.variables if kind == "frame")

    @cached_property
    def points(self) -> tuple[str, ...]:
        """Attributes that name points, each once."""
        return tuple(a for a in self.named if ("point", a) in self.variables)

    @cached_property
    def photos(self) -> tuple[str, ...]:
        """Attributes that name photos, whose pose or camera is observed, each once."""
        return tuple(a for a in self.named if ("point", a) not in self.variables)

    @cached_property
    def parameters(self) -> tuple[tuple[str, str], ...]:
        """Kind and attribute of the unknowns that a network states as parameters."""
        return tuple((k, a) for k, a in self.variables if k not in ENTITIES and "." not in a)

    @cached_property
    def found(self) -> tuple[tuple[str, str], ...]:
        """Those of `parameters` that nobody has to state, such as orientations."""
        return tuple((k, a) for k, a in self.parameters if UNKNOWNS[k].absent == "found")

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """Attributes that name only parameters, such as ``set``, each once."""
        return tuple(dict.fromkeys(a for _, a in self.parameters if a not in self.named))

    @cached_property
    def attributes(self) -> frozenset[str]:
        """Names of all attributes of the class."""
        return frozenset(f.name for f in fields(self.observation))

    @cached_property
    def optional(self) -> frozenset[str]:
        """Names of the attributes that have a default."""
        return frozenset(
            f.name
            for f in fields(self.observation)
            if f.default is not MISSING or f.default_factory is not MISSING
        )

    @cached_property
    def may_lack(self) -> frozenset[str]:
        """Names of the attributes that may be None."""
        return frozenset(f.name for f in fields(self.observation) if "None" in str(f.type))

    @cached_property
    def defaults(self) -> dict[str, Any]:
        """Plain defaults of attributes, by name."""
        return {f.name: f.default for f in fields(self.observation) if f.default is not MISSING}

    def with_errors(self, o: Any, readings: Array, errors: Array) -> Array:
        """Return the readings (d,) of an observation with errors (d,)."""
        if self.moved is None:
            return readings + errors
        constants = {c: np.array([getattr(o, c)], dtype=float) for c in self.constants}
        return np.asarray(self.moved(readings[None], errors[None], **constants)[0])

    @property
    def curved(self) -> bool:
        """Whether the kind joins several points and the partials depend on their positions."""
        return not self.linear and sum(kind in ("point", "frame") for kind, _ in self.variables) > 1

    @property
    def takes_covariance(self) -> bool:
        """Whether an observation has a σ for each component, or a covariance."""
        return "covariance" in self.attributes

    @property
    def takes_parts(self) -> bool:
        """Whether the standard deviation of the class may have several parts."""
        found = next((f for f in fields(self.observation) if f.name == "sigma"), None)
        text = "" if found is None else str(found.type)
        return "Sigma" in text or "StandardDeviation" in text

    def problems(self) -> list[str]:
        """Return all errors in the record itself."""
        if not is_dataclass(self.observation) or not hasattr(self.observation, "components"):
            return ["its class must be a frozen dataclass derived from Observation"]
        found = [*self._problems_of_attributes(), *self._problems_of_model()]
        if not self.name:
            found.append("its class has no name of a kind: set the class attribute kind")
        if self.takes_parts and self.weight is None:
            found.append(
                "its standard deviation may have parts (ppm, centring …), so that weight must say "
                "how they make a variance"
            )
        if self.weight is not None and not self.takes_parts:
            found.append("it has a weight, but its class takes no parts of a standard deviation")
        if self.weight is not None and not set(self.weight.parts) <= set(PARTS):
            found.append(f"parts of its weight must be some of {', '.join(PARTS)}")
        if self.unit not in ("m", "rad", "image", "mixed"):
            found.append(f"its unit must be m, rad, image or mixed, not {self.unit!r}")
        if self.quantity not in get_args(Quantity):
            valid = known(get_args(Quantity), meant=self.quantity)
            found.append(f"unknown quantity {self.quantity!r}; valid: {valid}")
        if self.circular and self.unit != "rad":
            found.append("it is circular, so that its unit must be rad")
        if self.quantity in SIGHT_QUANTITIES:
            found += self._problems_of_sight()
        lacking = [
            a
            for a in _READ_BY_QUANTITY.get(self.quantity, ())
            if not hasattr(self.observation, a) and a not in self.attributes
        ]
        if lacking:
            found.append(
                f"its quantity {self.quantity!r} needs the attributes {', '.join(lacking)}"
            )
        return found + self._problems_of_drawing()

    def _problems_of_sight(self) -> list[str]:
        """Approximate values read unknowns of a sight by their places."""
        found, what = [], f"its quantity is {self.quantity!r}, so that"
        if self.variables[: len(_ENDS)] != _ENDS:
            found.append(f"{what} its variables must begin with {', '.join(map(str, _ENDS))}")
        after = _AFTER_ENDS.get(self.quantity)
        if after is not None and [k for k, _ in self.variables[len(_ENDS) :]][:1] != [after]:
            found.append(f"{what} a variable of kind {after!r} must follow both ends")
        return found

    def _problems_of_drawing(self) -> list[str]:
        found, names = [], {a for _, a in self.variables}
        if self.instrument and self.instrument not in (*self.points, *self.frames):
            found.append(
                f"its instrument {self.instrument!r} must be an attribute that names a point or a "
                "frame"
            )
        if self.outline is not None:
            found += [
                f"its class has no attribute {a!r} for its outline"
                for a in self.outline.takes
                if a not in names and a not in self.constants
            ]
            if not self.frames or not self.points:
                found.append("it has an outline, so that it must name a frame and a point")
        return found

    def _problems_of_attributes(self) -> list[str]:
        have, found = self.attributes, []
        if not self.variables:
            found.append("its variables are missing")
        for kind, attribute in self.variables:
            if kind not in UNKNOWNS:
                found.append(
                    f"unknown kind of unknowns {kind!r}; valid: {known(UNKNOWNS, meant=kind)}"
                )
            if attribute.partition(".")[0] not in have:
                found.append(f"its class has no attribute {attribute!r} for the kind {kind!r}")
        for constant in self.constants:
            if constant not in have and not _computed(self.observation, constant):
                found.append(f"its class has no attribute {constant!r} for a constant")
        found += [
            f"its class has no attribute {c!r} for a choice" for c in self.choices if c not in have
        ]
        needs = ["sigma"] if self.model is None else ["value", "sigma"]
        several = len(self.observation.components) > 1
        if several and self.model is not None:
            needs.append("covariance")
            if not all(_NAME.fullmatch(c) for c in self.observation.components):
                found.append("names of its components are columns: lower-case letters and digits")
        found += [f"its class has no attribute {n!r}" for n in needs if n not in have]
        return found

    def _problems_of_model(self) -> list[str]:
        if self.model is None:
            return []
        if not callable(self.model):
            return [f"its model must be a function, not {self.model!r}"]
        wanted = {"observed", *self.constants, *({"axes"} & self.attributes)}
        wanted |= {"lens"} if "calibration" in dict(self.variables) else set()
        takes = inspect.signature(self.model).parameters
        if any(p.kind is p.VAR_KEYWORD for p in takes.values()):
            return []
        by_name = {n for n, p in takes.items() if p.kind is p.KEYWORD_ONLY}
        found = [f"its model has no keyword {n!r}" for n in sorted(wanted - by_name)]
        required = {n for n in by_name if takes[n].default is inspect.Parameter.empty}
        found += [
            f"its model needs the keyword {n!r}, which is no constant of the kind"
            for n in sorted(required - wanted)
        ]
        places = [p for p in takes.values() if p.kind is p.POSITIONAL_OR_KEYWORD]
        if len(places) != 1 + len(self.variables):
            found.append(
                f"its model must take the frame and {len(self.variables)} variables by position, "
                f"not {len(places)} arguments"
            )
        return found


def _computed(observation: type[Any], name: str) -> bool:
    """Return whether a class computes an attribute from its fields."""
    return isinstance(getattr(observation, name, None), property)


def register_in_memory(kind: ObservationKind) -> None:
    """Add a kind whose observations are in memory alone; its name is not valid in files."""
    IN_MEMORY[kind.name] = kind


def register_observation(kind: ObservationKind) -> ObservationKind:
    """Add a kind of observation.

    Args:
        kind: record of the kind.

    Returns:
        The record.

    Raises:
        InputError: the record has errors, or the name is registered already; all are listed.
    """
    found = kind.problems()
    name: Any = getattr(kind.observation, "kind", kind.observation)
    if name in KINDS or name in IN_MEMORY:
        found.append("a kind of this name is registered already")
    if found:
        raise InputError([Problem(what, f"kind of observation {name!r}") for what in found])
    KINDS[kind.name] = kind
    return kind


def in_image_table(kind: str) -> bool:
    """Return whether a network holds a kind in columns; kinds of unknowns are none."""
    record = KINDS.get(kind)
    return record is not None and record.in_image_table


def observation_kind(name: str) -> ObservationKind:
    """Return the record of a kind; InputError if no kind has this name."""
    found = KINDS.get(name) or IN_MEMORY.get(name)
    if found is None:
        raise InputError(
            f"unknown kind of observation {name!r}; valid: {known(KINDS, most=80, meant=name)}"
        )
    return found
