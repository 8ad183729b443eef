"""Points, states and ellipsoids of the XML input of gama-g3."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...ellipsoid import ELLIPSOIDS
from ...errors import known
from ...network.network import Network
from ...observations import ControlPoint
from ...types import Array
from ...units import ARCSEC, parse_angle
from ..source import Field, Problems
from ..xml_files import Element
from ..xml_source import XmlSource

STATES = ("unused", "fixed", "free", "constr")
"""States of n, e and u."""
GAMA_ELLIPSOIDS = {
    "wgs84": "WGS84",
    "grs80": "GRS80",
    "grs67": "GRS67",
    "bessel": "Bessel1841",
    "hayford": "International1924",
    "international": "International1924",
    "krassovski": "Krassovsky1940",
    "airy": "Airy1830",
    "airy_mod": "AiryModified1849",
    "australian": "ANS",
    "clarke1866": "Clarke1866",
    "helmert": "Helmert1906",
    "wgs72": "WGS72",
}
"""Ellipsoids of the package by their identifiers in Gama."""
SAME_AXIS_M = 1e-3
"""Largest difference of axes of one ellipsoid, which sources round in different ways, metres."""
HELD_SIGMA_M = 1e-6
"""Standard deviation of fixed components of a point that is free in others, metres."""


@dataclass
class G3Point:
    """A point as the file describes it."""

    line: int
    name: str
    states: dict[str, str]
    """State of n, e and u."""
    xyz: Array
    """Coordinates, NaN where there are none."""
    geoid: float
    """Undulation; NaN: there is none."""
    deflections: tuple[float, float] = (0.0, 0.0)
    """ξ and η, radians."""
    where: str = ""
    """File and line."""

    @property
    def unused(self) -> bool:
        """Whether the file says that it takes no part."""
        return set(self.states.values()) == {"unused"}


class G3Points:
    """The points of a file."""

    def __init__(self, source: XmlSource) -> None:
        """Start without points, on WGS 84; points before any state are unused."""
        self.source = source
        self.problems: Problems = source.problems
        self.points: dict[str, G3Point] = {}
        self.faulty: set[str] = set()
        """Names of points with problems, which are no unknown points."""
        self.states = dict.fromkeys("neu", "unused")
        self.ellipsoid = ELLIPSOIDS["WGS84"]

    @property
    def constrained(self) -> bool:
        """Whether any point carries the datum of a free network."""
        return any("constr" in p.states.values() for p in self.points.values())

    def is_unused(self, name: str) -> bool:
        """Return whether the file says that a point is unused."""
        return name in self.points and self.points[name].unused

    def add_to(self, network: Network) -> None:
        """Add the points that are used to a network."""
        for point in self.points.values():
            self._add(network, point)

    def state_deflections(self, network: Network) -> None:
        """State the deflections of the points whose plumb lines observations of a network use."""
        used = {
            str(getattr(o, attribute))
            for o in network.observations.values()
            for kind, attribute in o.record.parameters
            if kind == "vertical"
        }
        for name, point in self.points.items():
            if name in used and any(point.deflections):
                xi, eta = point.deflections
                network.set_vertical(name, xi=xi, eta=eta, fixed=True)

    def names(self, element: Element, *tags: str) -> list[str]:
        """Return the names of points in children of an observation; unknown ones are noted."""
        names = [self.source.inside(element, tag).name() for tag in tags]
        for name in names:
            if name and name not in self.points and name not in self.faulty:
                can = known(self.points, meant=name)
                what = f"<{element.tag}> names the unknown point {name[:40]!r}; known: {can}"
                self.source.wrong(element.line, what)
        return names

    def geoid(self, element: Element, name: str) -> float:
        """Return the undulation at a point; a problem where it has none."""
        point = self.points.get(name)
        if point is None:
            return 0.0
        if math.isnan(point.geoid) and not point.unused:
            self.source.wrong(
                element.line, f"<{element.tag}> needs <geoid> of point {name!r}, in {point.where}"
            )
        return point.geoid

    def read_constants(self, element: Element) -> None:
        """Read the ellipsoid; other constants are checked."""
        for tag in ("apriori-standard-deviation", "confidence-level", "tol-abs"):
            self.source.inside(element, tag).number(default=1.0, above=0.0)
        for stated in element.all("ellipsoid"):
            name = self.source.inside(stated, "id")
            if not name.is_absent:
                found = name.choice(GAMA_ELLIPSOIDS)
                self.ellipsoid = ELLIPSOIDS[found] if found else self.ellipsoid
                continue
            a = self.source.inside(stated, "a").number(above=0.0)
            inverse = self.source.inside(stated, "inv-f")
            if inverse.is_absent:
                b = self.source.inside(stated, "b").number(above=0.0)
            else:
                b = a * (1.0 - 1.0 / inverse.number(above=1.0))
            self._of_axes(stated, a, b)

    def _of_axes(self, element: Element, a: float, b: float) -> None:
        if not math.isfinite(a + b):
            return
        for e in ELLIPSOIDS.values():
            other = e.a * (1.0 - e.flattening)
            if abs(e.a - a) < SAME_AXIS_M and abs(other - b) < SAME_AXIS_M:
                self.ellipsoid = e
                return
        valid = known(GAMA_ELLIPSOIDS, most=20)
        self.source.wrong(
            element.line, f"no ellipsoid has the axes {a:.3f} and {b:.3f} m; valid: {valid}"
        )

    def states_of(self, element: Element) -> dict[str, str]:
        """Return the states that an element gives to n, e or u."""
        return {e.tag: element.tag for e in element.children if e.tag in self.states}

    def read(self, element: Element) -> None:
        """Read a ``<point>``, or the state of points that follow."""
        if element.tag in STATES:
            self.states |= self.states_of(element)
            return
        before = self.problems.count
        name = self.source.inside(element, "id").name()
        states = dict(self.states)
        for inner in element.children:
            if inner.tag in STATES:
                states |= self.states_of(inner)
        xyz = self._coordinates(element)
        geoid = self.source.inside(element, "geoid").number(default=math.nan)
        self.source.inside(element, "height").number(default=0.0)
        db, dl = (
            ARCSEC * self.source.inside(element, tag).number(default=0.0) for tag in ("db", "dl")
        )
        if name in self.points:
            first = self.points[name].line
            self.source.wrong(element.line, f"point {name!r} stands in line {first} already")
        if len(set(states.values()) & {"constr", "free", "unused"}) > 1:
            text = ", ".join(f"{a} {s}" for a, s in states.items())
            self.source.wrong(
                element.line,
                f"point {name!r} has components of different states ({text}); valid: all of one "
                "state, or some fixed and the others free",
            )
        if states["n"] != states["e"]:
            self.source.wrong(element.line, f"n and e of point {name!r} must have one state")
        if self.problems.count > before:
            self.faulty.add(name)
            return
        latitude = self.ellipsoid.to_geodetic(xyz)[0] if np.isfinite(xyz).all() else 0.0
        vertical = (db, dl * math.cos(float(latitude)))
        where = self.source.place(element.line)
        self.points[name] = G3Point(element.line, name, states, xyz, geoid, vertical, where)

    def _coordinates(self, element: Element) -> Array:
        """Return X, Y, Z (3,) of a point, NaN where it has none or after a problem."""
        given = [[self.source.inside(element, t) for t in tags] for tags in ("xyz", "blh")]
        stated = [f for f in given if not all(x.is_absent for x in f)]
        if len(stated) > 1:
            self.source.wrong(element.line, "has both x, y, z and b, l, h")
        if not stated:
            return np.full(3, np.nan)
        if stated[0] is given[0]:
            return np.array([x.number() for x in stated[0]])
        latitude, longitude = (_degrees(f) for f in stated[0][:2])
        at = (np.array([latitude]), np.array([longitude]), np.array([stated[0][2].number()]))
        return np.asarray(self.ellipsoid.to_cartesian(*at)[0])

    def _add(self, network: Network, point: G3Point) -> None:
        if point.unused:
            return
        states = point.states
        fixed = "".join(a for a, s in states.items() if s == "fixed")
        if fixed and not np.isfinite(point.xyz).all():
            self.source.wrong(point.line, f"point {point.name!r} is fixed and has no coordinates")
            return
        self.source.attempt(
            point.line,
            network.add_point,
            point.name,
            point.xyz.tolist(),
            fixed="xyz" if len(fixed) == 3 else "",
            datum="constr" in states.values(),
        )
        if 0 < len(fixed) < 3 and point.name in network.points:
            held = ControlPoint(
                point.name,
                tuple(point.xyz.tolist()),
                axes=fixed,
                sigma=(HELD_SIGMA_M,) * len(fixed),
                source=point.where,
            )
            network.add(held)


def _degrees(field: Field) -> float:
    """Return an angle in degrees, minutes and seconds, such as 50-49-19.404, radians."""
    try:
        return parse_angle(str(field.value or ""), "dms")
    except ValueError as error:
        field.wrong(f"must be in degrees: {error}")
        return math.nan
