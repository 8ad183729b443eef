"""Points of a ``.gkf`` file: coordinates, held components, datum components."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from ..errors import known
from ..network.network import Network
from .gama_source import GamaSource
from .left_out import Reason, RowsLeftOut
from .xml_tree import Element

Status: TypeAlias = Literal["fixed", "free", "constrained"]
COMPONENTS = ("xy", "XY", "z", "Z", "xyz", "XYZ", "xyZ", "XYz")
"""Values of ``fix`` and ``adj``."""

NEITHER_FIX_NOR_ADJ = Reason("points", "the file neither fixes nor adjusts them")


@dataclass
class _Point:
    """A point as all ``<point>`` elements of its name describe it together."""

    element: Element
    values: dict[str, float] = field(default_factory=dict)
    status: dict[str, Status] = field(default_factory=dict)
    observed: dict[str, float] = field(default_factory=dict)
    """Coordinates stated in ``<coordinates>`` only."""


class GamaPoints:
    """All points of the file."""

    def __init__(self, source: GamaSource) -> None:
        """Start without points."""
        self.source = source
        self._points: dict[str, _Point] = {}

    @property
    def constrained(self) -> bool:
        """Whether any component carries the datum of a free network."""
        return any("constrained" in p.status.values() for p in self._points.values())

    def read(self, section: Element) -> None:
        """Read the points of a ``<points-observations>``, including its ``<coordinates>``."""
        for element in section.all("point"):
            self._read(element, observed=False)
        for group in section.all("coordinates"):
            for element in group.all("point"):
                self._read(element, observed=True)

    def _read(self, element: Element, *, observed: bool) -> None:
        name = self.source.name(element, "id")
        if not name:
            return
        point = self._points.setdefault(name, _Point(element))
        if ("x" in element.attributes) != ("y" in element.attributes):
            self.source.add(element, f"point {name!r} needs both x and y, or neither")
        values = point.observed if observed else point.values
        for axis in "xyz":
            if axis in element.attributes:
                value = self.source.number(element, axis)
                if not observed and abs(values.get(axis, value) - value) > 0:
                    self.source.add(
                        element,
                        f"{axis} of point {name!r}: {value} here, {values[axis]} in line "
                        f"{point.element.line}",
                    )
                values[axis] = value
        status = self._status(element)
        other = [a for a in status if point.status.get(a, status[a]) != status[a]]
        if other:
            self.source.add(
                element,
                f"{', '.join(other)} of point {name!r}: {status[other[0]]} here, "
                f"{point.status[other[0]]} in line {point.element.line}",
            )
        point.status |= status

    def _status(self, element: Element) -> dict[str, Status]:
        out: dict[str, Status] = {}
        for attribute in ("adj", "fix"):  # read second, fix overrides adj
            text = element.attributes.get(attribute, "")
            if not text:
                continue
            if text not in COMPONENTS:
                self.source.add(
                    element,
                    f"{attribute}={text!r} is unknown; valid: {known(COMPONENTS, meant=text)}",
                )
                continue
            for letter in text:
                if attribute == "fix":
                    out[letter.lower()] = "fixed"
                else:
                    out[letter.lower()] = "constrained" if letter.isupper() else "free"
        return out

    def require(
        self, element: Element, name: str, *, plan: bool = False, height: bool = False
    ) -> None:
        """Note a problem unless a point has the components that an observation needs."""
        if not name:
            return
        point = self._points.get(name)
        if point is None:
            self.source.add(
                element,
                f"<{element.tag}> names the unknown point {name!r}; known: "
                f"{known(self._points, meant=name)}",
            )
            return
        missing = [
            what
            for what, asked, axis in (("x, y", plan, "x"), ("z", height, "z"))
            if asked and axis not in point.status
        ]
        if missing:
            self.source.add(
                element,
                f"<{element.tag}> needs {', '.join(missing)} of point {name!r}, which line "
                f"{point.element.line} neither fixes nor adjusts: give fix or adj there, or "
                "take the observation out",
            )

    def add_to(self, network: Network) -> None:
        """Add the points that take part in the adjustment to the network."""
        left = RowsLeftOut()
        for name, point in self._points.items():
            if not point.status:
                left.add(NEITHER_FIX_NOR_ADJ, name, self.source.place(point.element))
                continue
            values = point.observed | point.values
            free = [a for a in "xyz" if point.status.get(a, "fixed") != "fixed"]
            constrained = [a for a in free if point.status[a] == "constrained"]
            empty = [a for a, s in point.status.items() if s == "fixed" and a not in values]
            if empty:
                self.source.add(
                    point.element, f"{', '.join(empty)} of point {name!r}: fixed at no value"
                )
            if constrained and constrained != free:
                self.source.add(
                    point.element,
                    f"{', '.join(free)} of point {name!r} are unknown, but only "
                    f"{', '.join(constrained)} carry the datum: a datum point carries it with "
                    "all its unknown components",
                )
            xyz = [values.get(a, math.nan if a in free else 0.0) for a in "xyz"]
            if self.source.problems:
                continue
            network.add_point(
                name,
                xyz,
                fixed="".join(a for a in "xyz" if a not in free),
                datum=bool(constrained),
            )
        network.left_out += left.told().values()
