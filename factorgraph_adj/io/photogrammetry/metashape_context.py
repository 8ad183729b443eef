"""What every part of a Metashape chunk needs: accuracies, reference system, transformation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from ...crs.system import Heights
from ...errors import InputError
from ...types import Array
from ..xml_tree import Element
from .metashape_reference import Local, Reference, reference_of
from .metashape_source import Chunk, Place
from .reading import Reading, rotation_of

ACCURACY = {
    "tiepoints": 1.0,
    "projections": 0.1,
    "markers": 0.005,
    "cameras": 10.0,
    "scalebars": 0.001,
}
"""Metashape's own defaults: pixels of tie points and markers, metres of the others."""
ONE_OR_MORE = (("sxyz", (0, 1, 2)), ("sxy", (0, 1)), ("sx", (0,)), ("sy", (1,)), ("sz", (2,)))
"""Attributes of a reference that state standard deviations, and the axes that they belong to."""
SIZES = {"rotation": 9, "translation": 3, "scale": 1}
NOTHING = {"rotation": "1 0 0 0 1 0 0 0 1", "translation": "0 0 0", "scale": "1"}
"""Parts of a transformation, and what they are where they are absent."""


LARGEST = 1e12
"""Largest standard deviation of given coordinates, metres; larger ones are damage."""


@dataclass(frozen=True)
class Placed:
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
class Context:
    """A chunk while it is read."""

    source: Chunk
    """Its files."""
    reading: Reading
    """Where problems go."""
    overridden: Mapping[str, float]
    """Standard deviations that take the place of those of the chunk."""
    local: bool
    """Whether its reference system is taken as a local one."""
    geoid: str | float | None = None
    """Geoid of a system with heights."""
    heights: Heights | None = None
    """What heights are, where the system does not tell it."""
    accuracy: dict[str, float] = field(default_factory=dict)
    """Standard deviations of the chunk's settings and those that take their place."""
    reference: Reference = field(default_factory=Local)
    """Its reference system."""
    _placed: dict[str, Placed | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Read accuracies and reference system."""
        self.accuracy = self._accuracies()
        chunk = self.source.chunk
        element = chunk.element.first("reference")
        if element is not None and not self.local:
            given = [xyz for xyz in map(_coordinates, self._references()) if xyz is not None]
            places = np.array(given).reshape(-1, 3)
            where = chunk.where(element)
            self.reference = reference_of(
                element.text, places, where, geoid=self.geoid, heights=self.heights
            )

    def _accuracies(self) -> dict[str, float]:
        out = dict(ACCURACY)
        chunk = self.source.chunk
        for p in listed(chunk.element, "settings", "property"):
            name = p.attributes.get("name", "").removeprefix("accuracy_")
            if name in out:
                text, where = p.attributes.get("value"), chunk.where(p)
                value = self.reading.number(text, f"accuracy_{name}", where, positive=True)
                out[name] = out[name] if value is None else value
        for name, value in self.overridden.items():
            if name not in out or not (isinstance(value, int | float) and value > 0):
                what = f"accuracy {name!r} = {value!r}; valid: numbers > 0 for {', '.join(out)}"
                raise InputError(what)
        return out | dict(self.overridden)

    def _references(self) -> Iterator[Element]:
        """Iterate over the references of markers and cameras."""
        chunk = self.source.chunk.element
        for entry in (*listed(chunk, "markers", "marker"), *cameras_of(chunk)):
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
        xyz = self.reading.numbers(texts, 3, "reference", where)
        sigma = [self.accuracy[kind]] * 3
        for key, axes in ONE_OR_MORE if kind not in self.overridden else ():
            text = element.attributes.get(key)
            value = None
            if text is not None:
                value = self.reading.number(text, key, where, positive=True)
            for i in axes if value is not None else ():
                sigma[i] = float(value or 0.0)
        metres = self.reference.unit * np.array(sigma)
        if not metres.max() <= LARGEST:
            what = f"the accuracy of a reference must be at most {LARGEST:g} m"
            self.reading.wrong(f"{what}, not {metres.max():g} m", where)
            return None
        if xyz is None:
            return None
        place = np.array(xyz)
        axes_there = self.reference.axes(place)
        squares = np.square(metres)
        covariance = axes_there.T @ np.diag(squares) @ axes_there
        at = self.reference.points(place[None])[0]
        return (float(at[0]), float(at[1]), float(at[2])), 0.5 * (covariance + covariance.T)

    def placed(self, component: str | None) -> Placed | None:
        """Return the similarity of a component of the chunk to the frame; None if it is unknown."""
        key = component or ""
        if key not in self._placed:
            self._placed[key] = self._similarity(component)
        return self._placed[key]

    def _similarity(self, component: str | None) -> Placed | None:
        chunk = self.source.chunk
        element = chunk.element.first("transform")
        for c in listed(chunk.element, "components", "component"):
            inner = c.first("transform")
            if inner is not None and c.attributes.get("id") == component:
                element = inner
        if self.local or (element is None and chunk.element.first("reference") is not None):
            return None
        parts = {}
        for tag, size in SIZES.items():
            child = None if element is None else element.first(tag)
            text = NOTHING[tag] if child is None else child.text
            where = chunk.where(chunk.element if child is None else child)
            parts[tag] = self.reading.numbers(text.split(), size, f"<{tag}>", where)
        r, t, s = parts["rotation"], parts["translation"], parts["scale"]
        if r is None or t is None or s is None:
            return None
        turned = rotation_of(np.array(r).reshape(3, 3))
        if turned is None or not s[0] > 0:
            what = "the transformation of the chunk is no rotation and scale"
            self.reading.wrong(what, chunk.where(element or chunk.element))
            return None
        shift = self.reference.from_chunk(np.array([t]))[0]
        scale = self.reference.unit * s[0] * turned[1]
        return Placed(self.reference.turn @ turned[0], scale, shift)


def listed(element: Element, group: str, tag: str) -> Iterator[Element]:
    """Iterate over the elements of one name in a list, which may be absent."""
    found = element.first(group)
    return iter(()) if found is None else found.all(tag)


def cameras_of(chunk: Element) -> Iterator[Element]:
    """Iterate over the cameras of a chunk, with those in groups."""
    found = chunk.first("cameras")
    for child in () if found is None else found.children:
        if child.tag == "camera":
            yield child
        elif child.tag == "group":
            yield from child.all("camera")


FLAGS = ("enabled", "valid", "pinned")
"""Attributes that are true or false."""


def check_flags(place: Place, reading: Reading) -> None:
    """Note flags that are neither true nor false."""
    for element in place.element.walk():
        for name in FLAGS:
            word = element.attributes.get(name, "true")
            if word not in ("true", "false", "1", "0"):
                what = f"{name} of <{element.tag}> must be true or false, not {word[:20]!r}"
                reading.wrong(what, place.where(element))


def off(element: Element) -> bool:
    """Return whether an element is disabled."""
    return element.attributes.get("enabled", "true") in ("false", "0")


def _coordinates(element: Element) -> tuple[float, ...] | None:
    """Return the coordinates of a reference; None where they are missing or wrong."""
    texts = [element.attributes.get(a) for a in "xyz"]
    return Reading().numbers(texts, 3, "reference", "")
