"""Reference of a Metashape chunk: system, transformation, accuracies, what is switched off.

`ChunkReference` converts coordinates of a chunk to those of a network.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ...crs.reference_system import Heights, ReferenceSystem
from ...ellipsoid import ELLIPSOIDS
from ...errors import InputError, Problem
from ...frames import Frame, LocalFrame, TopocentricFrame
from ...types import Array
from ..format_options import option_text
from ..source import Problems, is_unread
from ..xml_files import Element
from .block_source import rotation_and_scale, wkt_unit_length
from .metashape_files import ElementPlace, MetashapeChunk

DIRECTION_STEP_M = 10.0
"""Distance over which directions of a grid are taken, metres."""
MAX_FLATTENING_DIFFERENCE = 1e-6
"""Largest difference of 1/f of ellipsoids that are the same, printed with few digits."""
MAX_GIVEN_SIGMA_M = 1e12
"""Largest standard deviation of given coordinates, metres; larger ones are damage."""
METASHAPE_ACCURACIES = {
    "tiepoints": 1.0,
    "projections": 0.1,
    "markers": 0.005,
    "cameras": 10.0,
    "scalebars": 0.001,
}
"""Metashape's own defaults: pixels of tie points and markers, metres of the others."""
SIGMA_ATTRIBUTES = (("sxyz", (0, 1, 2)), ("sxy", (0, 1)), ("sx", (0,)), ("sy", (1,)), ("sz", (2,)))
"""Attributes of a reference that state standard deviations, and the axes that they belong to."""
TRANSFORMATION_SIZES = {"rotation": 9, "translation": 3, "scale": 1}
NEUTRAL_TRANSFORMATION = {"rotation": "1 0 0 0 1 0 0 0 1", "translation": "0 0 0", "scale": "1"}
"""Parts of a transformation, and what they are where they are absent."""
FLAG_ATTRIBUTES = ("enabled", "valid", "pinned")
"""Attributes that are true or false."""


class ChunkReference(Protocol):
    """Coordinates of a chunk as those of a network."""

    @property
    def frame(self) -> Frame:
        """Frame of the network."""

    @property
    def unit(self) -> float:
        """Length of the unit of lengths, metres."""

    def points(self, given: Array) -> Array:
        """Return coordinates (n, 3) in the frame of given ones (n, 3)."""

    def from_chunk(self, world: Array) -> Array:
        """Return coordinates (n, 3) in the frame of what the chunk's transformation gives."""

    def axes(self, given: Array) -> Array:
        """Return the axes of the given standard deviations at a place, rows in the frame (3, 3)."""

    @property
    def turn(self) -> Array:
        """Rotation (3, 3) from what the chunk's transformation gives to the frame."""


@dataclass(frozen=True)
class Local:
    """A local system in metres or another unit; the transformation leads to the same system."""

    unit: float = 1.0
    """Length of the unit, metres."""
    frame: Frame = field(default_factory=LocalFrame)
    """The frame."""

    def points(self, given: Array) -> Array:
        """Return given coordinates in metres."""
        return self.unit * given

    def from_chunk(self, world: Array) -> Array:
        """Return coordinates of the chunk's world in metres."""
        return self.unit * world

    def axes(self, given: Array) -> Array:
        """Return the axes of the system."""
        return np.eye(3)

    @property
    def turn(self) -> Array:
        """The axes are the same."""
        return np.eye(3)


@dataclass(frozen=True)
class Geographic:
    """Longitude, latitude (degrees), ellipsoidal height (m) or geocentric coordinates.

    The transformation of the chunk leads to geocentric coordinates. The network has a topocentric
    frame whose origin is the middle of what is given.
    """

    frame: TopocentricFrame
    """The frame."""
    geocentric: bool = False
    """Whether given coordinates are geocentric."""
    unit: float = 1.0
    """Length of the unit of heights and geocentric coordinates, metres."""

    def _geocentric(self, given: Array) -> Array:
        if self.geocentric:
            return given
        ellipsoid = self.frame.geocentric.ellipsoid
        longitude, latitude = np.deg2rad(given[:, 0]), np.deg2rad(given[:, 1])
        return ellipsoid.to_cartesian(latitude, longitude, given[:, 2])

    def points(self, given: Array) -> Array:
        """Return topocentric coordinates."""
        return self.frame.from_geocentric(self._geocentric(given))

    def from_chunk(self, world: Array) -> Array:
        """Return topocentric coordinates of geocentric ones."""
        return self.frame.from_geocentric(world)

    def axes(self, given: Array) -> Array:
        """Return east, north, up at a place, or the geocentric axes."""
        if self.geocentric:
            return self.turn.T
        at = self.points(given[None])
        return np.asarray(self.frame.basis(at, np.zeros((1, 2))).enu[0])

    @property
    def turn(self) -> Array:
        """Rotation from geocentric axes to east, north, up of the origin."""
        return _geocentric_turn(self.frame)


@dataclass(frozen=True)
class Grid:
    """Easting, northing and height of a projected system.

    The transformation of the chunk leads to geocentric coordinates of the datum of the system.
    The network has a topocentric frame in the middle of what is given.
    """

    system: ReferenceSystem
    """The system."""
    frame: TopocentricFrame
    """The frame."""
    unit: float = 1.0
    """Length of the unit of coordinates, metres."""

    def points(self, given: Array) -> Array:
        """Return topocentric coordinates."""
        return self.system.to_frame(self.frame, given)

    def from_chunk(self, world: Array) -> Array:
        """Return topocentric coordinates of geocentric ones."""
        return self.frame.from_geocentric(world)

    def axes(self, given: Array) -> Array:
        """Return the directions of grid east, grid north and up at a place."""
        steps = np.vstack([np.zeros((1, 3)), DIRECTION_STEP_M * np.eye(3)])
        at = self.points(given + steps)
        along = at[1:] - at[0]
        along[0] -= along[0] @ along[2] * along[2] / (along[2] @ along[2])
        u, _, vt = np.linalg.svd(along / np.linalg.norm(along, axis=1, keepdims=True))
        return np.asarray(u @ vt)

    @property
    def turn(self) -> Array:
        """Rotation from geocentric axes to east, north, up of the origin."""
        return _geocentric_turn(self.frame)


def _geocentric_turn(frame: TopocentricFrame) -> Array:
    zero = frame.from_geocentric(np.zeros((1, 3)))
    return np.asarray((frame.from_geocentric(np.eye(3)) - zero).T)


def chunk_reference(
    wkt: str,
    given: Array,
    where: str,
    *,
    geoid: str | float | None = None,
    heights: Heights | None = None,
) -> ChunkReference:
    """Return the reference system that a chunk states in WKT.

    Args:
        wkt: the text; empty: a local system in metres.
        given: coordinates in the system, (n, 3), whose middle becomes the origin of a frame.
        where: file and line.
        geoid: geoid of a system with heights, see `ReferenceSystem`.
        heights: "ellipsoidal" where the heights of a system with heights are that.

    Raises:
        InputError: the system is none of those that can be read.
    """
    text = wkt.strip()
    kind = text.split("[", 1)[0].strip().upper()
    if kind in ("", "LOCAL_CS", "ENGCRS"):
        return Local(wkt_unit_length(text))
    if kind in ("GEOGCS", "GEOGCRS", "GEOCCS", "GEODCRS"):
        name = _ellipsoid(text)
        if name is None:
            known = ", ".join(ELLIPSOIDS)
            raise InputError(Problem(f"its ellipsoid is unknown; known: {known}", where))
        first = TopocentricFrame(0.0, 0.0, 0.0, name)
        middle = given.mean(axis=0) if len(given) else np.zeros(3)
        if kind == "GEOCCS":
            lat, lon, h = first.geocentric.ellipsoid.to_geodetic(middle[None])
            origin = float(lat[0]), float(lon[0]), float(h[0])
        else:
            longitude = _mean_longitude(given[:, 0])
            origin = float(np.deg2rad(middle[1])), math.radians(longitude), float(middle[2])
        if not abs(origin[0]) <= np.pi / 2:
            raise InputError(Problem(f"latitude {middle[1]:g}° is none", where))
        return Geographic(TopocentricFrame(*origin, name), kind == "GEOCCS")
    try:
        if heights is None and geoid is None and kind in ("PROJCS", "PROJCRS"):
            heights = "ellipsoidal"
        system = ReferenceSystem(text, geoid, heights).checked()
        if not system.projected:
            what = (
                f"its system {system.name!r} ({kind}) cannot be converted; valid: a projected one"
            )
            raise InputError(what)
        return Grid(system, system.frame_at(given))
    except InputError as error:
        hint = f"{option_text('crs', 'local')} takes the coordinates as they are"
        raise InputError([Problem(f"{p.what}; {hint}", where) for p in error.problems]) from None


def _mean_longitude(longitude: Array) -> float:
    """Return the mean of longitudes, degrees, also of those on both sides of the antimeridian."""
    if not len(longitude):
        return 0.0
    from_first = np.remainder(longitude - longitude[0] + 180.0, 360.0) - 180.0
    mean = float(longitude[0] + from_first.mean())
    return (mean + 180.0) % 360.0 - 180.0


def _ellipsoid(text: str) -> str | None:
    """Return the name of an ellipsoid by its numbers in WKT."""
    upper = text.upper()
    at = max(upper.find("SPHEROID["), upper.find("ELLIPSOID["))
    fields = text[at:].split("]", 1)[0].split(",")
    try:
        a, inverse = float(fields[1]), float(fields[2])
    except (IndexError, ValueError):
        return None
    for name, e in ELLIPSOIDS.items():
        if abs(e.a - a) < 1e-3 and abs(e.inverse_flattening - inverse) < MAX_FLATTENING_DIFFERENCE:
            return name
    return None


@dataclass(frozen=True)
class ChunkPlacement:
    """Similarity from the coordinates of a chunk to the frame of the network."""

    rotation: Array
    """Rotation, (3, 3)."""
    scale: float
    """Scale, metres per unit of the chunk."""
    shift: Array
    """Place of the origin of the chunk, (3,) metres."""

    def points(self, local: Array) -> Array:
        """Return coordinates in the frame, (n, 3), of those in the chunk, (n, 3)."""
        # Coordinates of damaged files that overflow are refused where they go into the network.
        with np.errstate(over="ignore", invalid="ignore"):
            return np.asarray(self.shift + self.scale * (local @ self.rotation.T))


@dataclass
class ChunkContext:
    """A chunk while it is read."""

    source: MetashapeChunk
    """Its files."""
    problems: Problems
    """Where problems go."""
    overridden: Mapping[str, float]
    """Standard deviations that take the place of those of the chunk."""
    local: bool
    """Whether its reference system is taken as a local one."""
    geoid: str | float | None = None
    """Geoid of a system with heights."""
    heights: Heights | None = None
    """What heights are, where the system does not state it."""
    accuracy: dict[str, float] = field(default_factory=dict)
    """Standard deviations of the chunk's settings and those that take their place."""
    reference: ChunkReference = field(default_factory=Local)
    """Its reference system."""
    _placed: dict[str, ChunkPlacement | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Read accuracies and reference system."""
        self.accuracy = self._accuracies()
        chunk = self.source.chunk
        element = chunk.element.first("reference")
        if element is not None and not self.local:
            given = [xyz for xyz in map(_coordinates, self._references()) if not is_unread(xyz)]
            places = np.array(given).reshape(-1, 3)
            where = chunk.where(element)
            self.reference = chunk_reference(
                element.text, places, where, geoid=self.geoid, heights=self.heights
            )

    def _accuracies(self) -> dict[str, float]:
        out = dict(METASHAPE_ACCURACIES)
        chunk = self.source.chunk
        for p in listed_elements(chunk.element, "settings", "property"):
            name = p.attributes.get("name", "").removeprefix("accuracy_")
            if name in out:
                text, where = p.attributes.get("value"), chunk.where(p)
                value = self.problems.field(text, f"accuracy_{name}", where).number(above=0.0)
                out[name] = out[name] if is_unread(value) else value
        for name, value in self.overridden.items():
            if name not in out or not (isinstance(value, int | float) and value > 0):
                what = f"accuracy {name!r} = {value!r}; valid: numbers > 0 for {', '.join(out)}"
                raise InputError(what)
        return out | dict(self.overridden)

    def _references(self) -> Iterator[Element]:
        """Iterate over the references of markers and cameras."""
        chunk = self.source.chunk.element
        for entry in (*listed_elements(chunk, "markers", "marker"), *chunk_cameras(chunk)):
            found = entry.first("reference")
            if found is not None:
                yield found

    def given(
        self, element: Element, kind: str, where: str
    ) -> tuple[tuple[float, float, float], Array] | None:
        """Return coordinates and covariance (3, 3) of a reference in the frame of the network.

        Args:
            element: the element ``<reference>``.
            kind: markers or cameras.
            where: file and line.
        """
        texts = [element.attributes.get(a) for a in "xyz"]
        xyz = self.problems.field(texts, "reference", where).numbers(3)
        sigma = [self.accuracy[kind]] * 3
        for key, axes in SIGMA_ATTRIBUTES if kind not in self.overridden else ():
            given = self.problems.field(element.attributes.get(key), key, where)
            value = math.nan if given.is_absent else given.number(above=0.0)
            for i in () if is_unread(value) else axes:
                sigma[i] = value
        metres = self.reference.unit * np.array(sigma)
        if not metres.max() <= MAX_GIVEN_SIGMA_M:
            what = f"the accuracy of a reference must be at most {MAX_GIVEN_SIGMA_M:g} m"
            self.problems.wrong(f"{what}, not {metres.max():g} m", where)
            return None
        if is_unread(xyz):
            return None
        place = np.array(xyz)
        axes_there = self.reference.axes(place)
        squares = np.square(metres)
        covariance = axes_there.T @ np.diag(squares) @ axes_there
        at = self.reference.points(place[None])[0]
        return (float(at[0]), float(at[1]), float(at[2])), 0.5 * (covariance + covariance.T)

    def placed(self, component: str | None) -> ChunkPlacement | None:
        """Return the similarity of a component of the chunk to the frame; None if it is unknown."""
        key = component or ""
        if key not in self._placed:
            self._placed[key] = self._similarity(component)
        return self._placed[key]

    def _similarity(self, component: str | None) -> ChunkPlacement | None:
        chunk = self.source.chunk
        element = chunk.element.first("transform")
        for c in listed_elements(chunk.element, "components", "component"):
            inner = c.first("transform")
            if inner is not None and c.attributes.get("id") == component:
                element = inner
        if self.local or (element is None and chunk.element.first("reference") is not None):
            return None
        parts = {}
        for tag, size in TRANSFORMATION_SIZES.items():
            child = None if element is None else element.first(tag)
            text = NEUTRAL_TRANSFORMATION[tag] if child is None else child.text
            where = chunk.where(chunk.element if child is None else child)
            parts[tag] = self.problems.field(text.split(), f"<{tag}>", where).numbers(size)
        r, t, s = parts["rotation"], parts["translation"], parts["scale"]
        if is_unread(r, t, s):
            return None
        turned = rotation_and_scale(np.array(r).reshape(3, 3))
        if turned is None or not s[0] > 0:
            what = "the transformation of the chunk is no rotation and scale"
            self.problems.wrong(what, chunk.where(element or chunk.element))
            return None
        shift = self.reference.from_chunk(np.array([t]))[0]
        scale = self.reference.unit * s[0] * turned[1]
        return ChunkPlacement(self.reference.turn @ turned[0], scale, shift)


def listed_elements(element: Element, group: str, tag: str) -> Iterator[Element]:
    """Iterate over the elements of one name in a list, which may be absent."""
    found = element.first(group)
    return iter(()) if found is None else found.all(tag)


def chunk_cameras(chunk: Element) -> Iterator[Element]:
    """Iterate over the cameras of a chunk, with those in groups."""
    found = chunk.first("cameras")
    for child in () if found is None else found.children:
        if child.tag == "camera":
            yield child
        elif child.tag == "group":
            yield from child.all("camera")


def check_flags(place: ElementPlace, problems: Problems) -> None:
    """Note flags that are neither true nor false."""
    for element in place.element.walk():
        for name in FLAG_ATTRIBUTES:
            word = element.attributes.get(name, "true")
            if word not in ("true", "false", "1", "0"):
                what = f"{name} of <{element.tag}> must be true or false, not {word[:20]!r}"
                problems.wrong(what, place.where(element))


def is_disabled(element: Element) -> bool:
    """Return whether an element is disabled."""
    return element.attributes.get("enabled", "true") in ("false", "0")


def _coordinates(element: Element) -> tuple[float, ...]:
    """Return the coordinates of a reference; NaN where they are missing or wrong."""
    texts = [element.attributes.get(a) for a in "xyz"]
    return Problems().field(texts, "reference", "").numbers(3)
