"""LGC2: its input files, and inputs that stand as strings in the headers of its tests.

What was found about LGC2, from its documents, code and results:

- Angles are gon, their σ cc; σ of lengths are mm, parts per million mm/km, added to them.
- A frame states translation, three rotations and a scale: X_parent = T + Rx(−ω) Ry(−φ) Rz(−κ) x,
  with the usual right-handed matrices: its rotations count clockwise. Free components follow.
- The earth is a plane (``*OLOC``), a sphere (``*SPHE``, R = 6371 km, through Z = 2000.00079 m
  below the point P0) or an ellipsoid with the paraboloid of 1985 as geoid (``*LEP``): X and Y are
  those of the cartesian system, the third coordinate outside of frames is a height H. A point
  ``*VXY`` keeps this height. ``*RS2K``, the geoid of 2000, is a grid that is not here: refused.
- A ``*SCALE`` states σ, ppm, a correction (metres) that is added to the reading, its σ, and the σ
  of centring; it gives the offsets.
- ``*ECTH`` is positive to the left of the sight; ``*ECSP`` at a station is ECDIR.
- A wire has a bearing, a slope, two offsets and a sag; what a sensor reads is in the x and z of its
  own frame, where the chord passes its plane y, with the sag added along the vertical.
- Printed σ are multiplied with the estimated σ of unit weight where its test fails at 95 %, as in
  ECTH, and are a priori where it passes, as in ECVE and ECSP.

A frame with free components is a frame here whose origin is a point; components of the translation
that are held, and coordinates of its points, are conditions with `TINY` as σ. A free rotation about
the origin of a free frame joins it. Everything that is not understood is refused.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from factorgraph_adj import observations as o
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.stochastic import StandardDeviation
from factorgraph_adj.types import Array
from factorgraph_adj.units import GON

TINY = 1e-8
"""σ of conditions, metres."""
CC = GON * 1e-4
MM = 1e-3
P0 = np.array([2000.0, 2097.79265, 2433.66])
"""Origin of the cartesian system at CERN, metres."""
_GRS80 = (6378137.0, 0.0066943800229)
_LATITUDE, _HEIGHT, _AZIMUTH_OF_Y = 51.3692 * GON, 433.65921, 37.77864 * GON
SPHERE = 6_371_000.0
"""Radius of the sphere, metres."""
TOP = float(P0[2]) - _HEIGHT
"""Z of sphere and ellipsoid below P0, metres: 2000.00079."""
_PARABOLOID = (0.614, -0.106, 48.219 * GON - 38.90742 * GON)
"""Second derivatives, 10⁻⁵/km, and bearing of the axes of the geoid of 1985."""
_IGNORED = {"PREC", "PUNC", "FAUT", "END", "V0"}
_POINTS = {"CALA": "xyz", "POIN": "", "VXY": "z", "VXZ": "y", "VZ": "xy"}
_FREE = ("TX", "TY", "TZ", "RX", "RY", "RZ")


class NotUnderstoodError(ValueError):
    """An input has something that this reader does not know."""


def texts(path: Path) -> dict[str, str]:
    """Return the inputs in a C++ header by name."""
    source = path.read_text(encoding="latin-1")
    found = {}
    for match in re.finditer(r"char const \*const (\w+) =\s*(.*?)\s*;\s*\n", source, re.DOTALL):
        name, body = match.groups()
        raw = re.fullmatch(r'R"\((.*)\)"', body, re.DOTALL)
        body = re.sub(r"(?m)^\s*//.*$|/\*.*?\*/", "", body)
        parts = re.findall(r'"((?:[^"\\]|\\.)*)"', body)
        text = raw[1] if raw else "".join(parts).replace("\\n", "\n").replace("\\t", "\t")
        found[name] = text
    return found


def turned(omega: float, phi: float, kappa: float) -> Array:
    """Return the matrix (3, 3) of a frame, child → parent, from angles in radians."""
    x, y, z = exp_rotation(np.diag([-omega, -phi, -kappa]))
    return np.asarray(x @ y @ z)


# -- the earth ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Earth:
    """An earth model: heights over it, and the frame of the network that comes near."""

    kind: str
    """OLOC, SPHE or LEP."""

    def surface(self, x: Array) -> tuple[float, float, float]:
        """Return radius, Z of the top, and undulation at a place (3,)."""
        if self.kind == "SPHE":
            return SPHERE, TOP, 0.0
        dx, dy = (x - P0)[:2]
        a, e2 = _GRS80
        azimuth = math.atan2(dx, dy) + _AZIMUTH_OF_Y
        n = a / math.sqrt(1.0 - e2 * math.sin(_LATITUDE) ** 2)
        rho = n / (1.0 + e2 / (1.0 - e2) * (math.cos(_LATITUDE) * math.cos(azimuth)) ** 2)
        p, q, bearing = _PARABOLOID
        c, s = math.cos(bearing), math.sin(bearing)
        xp, yp = 1e-3 * (dx * c - dy * s), 1e-3 * (dx * s + dy * c)
        return rho, TOP, 0.01 * (p / 2 * xp * xp + q / 2 * yp * yp)

    def height(self, x: Array) -> float:
        """Return the height H of a place (3,)."""
        if self.kind == "OLOC":
            return float(x[2])
        radius, top, undulation = self.surface(x)
        d = math.hypot(*(x - P0)[:2])
        return math.hypot(d, radius + x[2] - top) - radius - undulation

    def place(self, x: float, y: float, height: float) -> Array:
        """Return the cartesian coordinates (3,) of X, Y and H."""
        out = np.array([x, y, height])
        if self.kind != "OLOC":
            radius, top, undulation = self.surface(out)
            d = math.hypot(*(out - P0)[:2])
            out[2] = top - radius + math.sqrt((radius + height + undulation) ** 2 - d * d)
        return out

    def deflections(self, x: Array) -> tuple[float, float]:
        """Return ξ, η at a place (3,): how the geoid falls towards Y and X, radians."""
        step = 10.0
        rise = [
            (self.surface(x + d)[2] - self.surface(x - d)[2]) / (2 * step)
            for d in step * np.eye(3)[:2]
        ]
        return -rise[1], -rise[0]

    def frame(self, near: Array) -> LocalFrame:
        """Return the frame of the network for places near ``near``."""
        if self.kind == "OLOC":
            return LocalFrame()
        radius, top, _ = self.surface(near)
        return LocalFrame(
            curvature=True, radius=radius + float(near[2]) - top, origin=(*P0[:2].tolist(), top)
        )


# -- frames ---------------------------------------------------------------------------------------


@dataclass
class Node:
    """A frame of the input, or its root."""

    name: str
    parent: Node | None
    rotation: Array
    translation: Array
    free: tuple[str, ...] = ()

    @property
    def joined(self) -> bool:
        """Whether it is but a further rotation of the free frame around it."""
        p = self.parent
        rotates = bool(self.free) and all(f.startswith("R") for f in self.free)
        return bool(rotates and p is not None and p.free and not self.translation.any())

    def body(self) -> Node | None:
        """Return the free frame to which it is fixed; None: it is fixed to the root."""
        if self.joined:
            return self
        if self.free:
            return self
        return None if self.parent is None else self.parent.body()

    def to(self, other: Node | None) -> tuple[Array, Array]:
        """Return rotation and translation from here to an outer frame; None: the root."""
        if self is other or self.parent is None:
            return np.eye(3), np.zeros(3)
        r, t = self.parent.to(other)
        return r @ self.rotation, r @ self.translation + t


@dataclass
class _Reader:
    """The state of reading an input."""

    lines: list[tuple[int, list[str]]]
    earth: Earth = field(default_factory=lambda: Earth("OLOC"))
    root: Node = field(default_factory=lambda: Node("ROOT", None, np.eye(3), np.zeros(3)))
    instruments: dict[str, list[list[str]]] = field(default_factory=dict)
    points: dict[str, tuple[Node, Array, str]] = field(default_factory=dict)
    nodes: list[Node] = field(default_factory=list)
    readings: list[tuple[str, list[str], Node, list[list[str]]]] = field(default_factory=list)

    def read(self) -> None:
        """Read frames, points, instruments and the lines of observations."""
        node, section, block = self.root, "", []
        station: list[str] = []
        for number, tokens in self.lines:
            key = tokens[0].lstrip("*").upper()
            if not tokens[0].startswith("*"):
                block.append(tokens)
                if section in _POINTS:
                    self._point(node, section, tokens, number)
                continue
            block, section = [], key
            if key in ("OLOC", "SPHE", "LEP"):
                self.earth = Earth(key)
            elif key == "FRAME":
                node = self._frame(node, tokens)
            elif key == "ENDFRAME":
                assert node.parent is not None
                node = node.parent
            elif key in ("POLAR", "EDM", "SCALE", "CAMD", "HLSR", "WPSR", "INCL"):
                self.instruments[tokens[1]] = block
                block.append(tokens[1:])
            elif key in ("TSTN", "CAM"):
                station = tokens[1:]
                self.readings.append((key, station, node, []))
            elif key in (
                *("ANGL", "ZEND", "DIST", "ECTH", "UVEC", "UVD"),
                *("ECVE", "ECSP", "ECHO", "DSPT", "ECWI", "ECWS", "INCLY", "ROLLY"),
                *("OBSXYZ", "PDOR"),
            ):
                at_station = key in ("ANGL", "ZEND", "DIST", "ECTH", "UVEC", "UVD")
                at_station |= key == "ECSP" and len(tokens) == 4 and _is_number(tokens[1])
                rest = [*station[:2], *tokens[1:]] if at_station else tokens[1:]
                self.readings.append((key, rest, node, block))
                if key == "V0":
                    continue
            elif key == "V0":
                self.readings.append((key, [], node, []))
            elif key not in _IGNORED and key not in _POINTS and key not in ("TITR", "INSTR"):
                raise NotUnderstoodError(f"line {number}: *{key} is not understood")

    def _frame(self, parent: Node, tokens: list[str]) -> Node:
        t = [float(v) for v in tokens[2:8]]
        scale, free = float(tokens[8]), tuple(f.upper() for f in tokens[9:])
        if scale != 1.0 or not set(free) <= set(_FREE):
            raise NotUnderstoodError(f"frame {tokens[1]}: scale {scale}, free {free}")
        angles = [a * GON for a in t[3:]]
        node = Node(tokens[1], parent, turned(*angles), np.array(t[:3]), free)
        self.nodes.append(node)
        return node

    def _point(self, node: Node, section: str, tokens: list[str], number: int) -> None:
        if len(tokens) < 4:
            raise NotUnderstoodError(f"line {number}: a point has a name and three coordinates")
        x = np.array([float(v) for v in tokens[1:4]])
        if node is self.root:
            x = self.earth.place(*x.tolist())
        elif section not in ("CALA", "POIN"):
            raise NotUnderstoodError(f"line {number}: *{section} in a frame")
        self.points[tokens[0]] = (node, x, section)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read(text: str, *, tiny: float = TINY) -> Network:
    """Return the network of an input, with conditions of the standard deviation ``tiny``."""
    lines = []
    title = False
    for number, line in enumerate(text.splitlines(), 1):
        line = line.split("%")[0].strip()
        if title and not line.startswith("*"):
            continue
        title = line.upper().startswith("*TITR")
        if line and not title:
            tokens = re.sub(r"^\*\s+", "*", line).split()
            if "$" in line:
                tokens = line.split("$")[0].split()
            lines.append((number, tokens))
    if any(t[0].upper() == "*RS2K" for _, t in lines):
        raise NotUnderstoodError("*RS2K: the grid of the geoid of 2000 is not here")
    found = _Reader(lines)
    found.read()
    return _Builder(found, tiny).network


class _Builder:
    """Makes the network of what was read."""

    def __init__(self, found: _Reader, tiny: float) -> None:
        self.found = found
        self.tiny = tiny
        self.earth = found.earth
        places = [self.place(name) for name in found.points]
        self.network = Network("LGC2", frame=self.earth.frame(np.mean(places, axis=0)))
        self.sets: dict[str, int] = {}
        for node in found.nodes:
            if node.free:
                self._check(node)
        for node in found.nodes:
            inner = [n for n in found.nodes if n.joined and n.parent is node]
            if node.free and not node.joined:
                self._free(node, inner)
        for name in found.points:
            self._point(name)
        for key, rest, node, lines in found.readings:
            getattr(self, f"_{key.lower()}")(rest, node, lines)

    def place(self, name: str) -> Array:
        """Return the given or approximate place of a point, (3,)."""
        node, x, _ = self.found.points[name]
        r, t = node.to(None)
        return np.asarray(r @ x + t)

    # -- frames and points

    def _check(self, node: Node) -> None:
        outer = None if node.parent is None else node.parent.body()
        if outer is not None and not node.joined:
            raise NotUnderstoodError(f"frame {node.name} is free in the free frame {outer.name}")

    def _free(self, node: Node, inner: list[Node]) -> None:
        """State a free frame, whose origin is a point, with what is held of its translation."""
        assert node.parent is not None
        r, t = node.parent.to(None)
        rotation = r @ node.rotation
        free = [f for n in (node, *inner) for f in n.free]
        if len(inner) > 1:
            raise NotUnderstoodError(f"frame {node.name} has {len(inner)} free frames in it")
        turns = [f.lower() for f in free if f.startswith("R")]
        if inner:
            rotation = rotation @ inner[0].rotation
            if set(turns) != {"rx", "ry", "rz"}:
                raise NotUnderstoodError(f"frames {node.name} and in it: rotations {turns}")
        elif 1 < len(turns) < 3:
            raise NotUnderstoodError(f"frame {node.name}: two rotations {turns} are free")
        elif turns in (["rx"], ["ry"]) and not self._simple(node, turns[0]):
            raise NotUnderstoodError(f"frame {node.name}: {turns[0]} is not about its own axis")
        origin = f"{node.name}/origin"
        held = [a for a in "xyz" if f"T{a.upper()}" not in free]
        at = r @ node.translation + t
        in_root = node.parent is self.found.root
        fixed = "xyz" if len(held) == 3 else "".join(held) if in_root else ""
        self.network.add_point(origin, at, fixed=fixed)
        vector = log_rotation(rotation[None])[0]
        values = dict(zip(("rx", "ry", "rz"), vector.tolist(), strict=True))
        body = inner[0] if inner else node
        self.network.add_frame(body.name, free=turns, values=values, origin=origin)
        if held and not fixed:
            value = tuple(float(node.translation["xyz".index(a)]) for a in held)
            sigma = (self.tiny,) * len(held)
            name = self.held(node.parent)
            axes = "".join(held)
            self.network.add(o.FrameCoordinate(name, origin, value, axes=axes, sigma=sigma))

    @staticmethod
    def _simple(node: Node, turn: str) -> bool:
        """Return whether a rotation that others follow is about the own axis of the frame."""
        axis = "xyz".index(turn[1])
        return bool(np.isclose(abs(node.rotation[axis, axis]), 1.0, atol=1e-15))

    def held(self, node: Node) -> str:
        """Return the name of the held frame with the axes of a node that is fixed to the root."""
        name = f"{node.name} (held)"
        if name not in self.network.frames:
            r, t = node.to(None)
            vector = log_rotation(r[None])[0]
            values = dict(zip(("rx", "ry", "rz"), vector.tolist(), strict=True))
            self.network.add_frame(name, free=(), values=values, origin=t.tolist())
        return name

    def body(self, node: Node) -> tuple[str, Array, Array, str]:
        """Return frame, rotation and translation into it, and name of the node's body."""
        around = node.body()
        if around is None:
            return self.held(node), np.eye(3), np.zeros(3), ""
        inner = [n for n in self.found.nodes if n.joined and n.parent is around]
        if inner and node is not inner[0] and node.body() is not inner[0]:
            raise NotUnderstoodError(f"{node.name} is fixed to the outer one of two free frames")
        return around.name, *node.to(around), around.name

    def mount(self, node: Node) -> tuple[str, str | None]:
        """Return the body of a node, and the mount with the axes of the node on it."""
        frame, r, _, body = self.body(node)
        if not body or np.allclose(r, np.eye(3), atol=1e-15):
            return frame, None
        if node.name not in self.network.mounts:
            vector = log_rotation(r[None])[0]
            values = dict(zip(("rx", "ry", "rz"), vector.tolist(), strict=True))
            self.network.set_mount(node.name, values=values)
        return frame, node.name

    def _point(self, name: str) -> None:
        node, x, section = self.found.points[name]
        at = self.place(name)
        fixed_to_root = node.body() is None
        keeps_height = section in ("VXY",) and self.earth.kind != "OLOC"
        fixed = _POINTS[section] if fixed_to_root and not keeps_height else ""
        self.network.add_point(name, at, fixed=fixed)
        if keeps_height:
            level = f"H of {name}"
            self.network.set_level(level, self.earth.height(at), fixed=True)
            self.network.add(self._height(name, level, 0.0, self.tiny))
        if section == "CALA" and not fixed_to_root:
            frame, r, t, _ = self.body(node)
            value = tuple((r @ x + t).tolist())
            self.network.add(o.FrameCoordinate(frame, name, value, sigma=(self.tiny,) * 3))

    def _height(self, name: str, level: str, value: float, sigma: float, side: int = 1) -> object:
        """Return a reading of the level over the earth model at a point."""
        at = self.network.points[name].coordinates
        x = np.array(at, dtype=float)
        undulation = 0.0
        if self.earth.kind != "OLOC":
            frame = self.network.frame
            assert isinstance(frame, LocalFrame)
            d2 = float(np.sum((x - np.array(frame.origin))[:2] ** 2))
            undulation = float(x[2]) + d2 / (2 * frame.radius) - self.earth.height(x)
        return o.HydrostaticReading(
            name, level, value, sigma=sigma, side=side, undulation=undulation
        )

    # -- observations

    def _numbers(self, instrument: str, row: int = 0) -> list[float]:
        rows = self.found.instruments[instrument]
        return [float(v) for v in rows[row][1:] if _is_number(v)]

    def _tstn(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        if node is not self.found.root or rest[2].upper() not in ("IHFIX", "HIFIX"):
            raise NotUnderstoodError(f"station {' '.join(rest)} in {node.name}")
        self.sets[rest[0]] = self.sets.get(rest[0], 0) + 1
        if self.earth.kind == "LEP":
            xi, eta = self.earth.deflections(self.place(rest[0]))
            self.network.set_vertical(rest[0], xi=xi, eta=eta, fixed=True)

    def _cam(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        pass

    def _v0(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        pass

    def _target(self, instrument: str) -> list[float]:
        return self._numbers(instrument, 1)

    def _angl(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        sigma = self._target(rest[1])[0] * CC
        for target, value in lines:
            self._direction(rest[0], target, float(value) * GON, sigma)

    def _direction(self, station: str, target: str, value: float, sigma: float) -> None:
        name = str(self.sets[station])
        self.network.add(o.Direction(station, target, value, sigma=sigma, set=name))

    def _zend(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        sigma = self._target(rest[1])[1] * CC
        for target, value in lines:
            self.network.add(o.ZenithAngle(rest[0], target, float(value) * GON, sigma=sigma))

    def _dist(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        self._distances(rest[0], self._target(rest[1])[2:4], lines)

    def _dspt(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        self._distances(rest[0], self._target(rest[1])[:2], lines)

    def _distances(self, station: str, parts: list[float], lines: list[list[str]]) -> None:
        sigma = StandardDeviation(parts[0] * MM, ppm=parts[1], combine="linear")
        for target, value in lines:
            self.network.add(o.SlopeDistance(station, target, float(value), sigma=sigma))

    def _scale(self, instrument: str) -> tuple[float, float]:
        """Return σ and correction of a scale, metres."""
        sigma, ppm, correction, _, centring = self._numbers(instrument)
        if ppm or centring:
            raise NotUnderstoodError(f"scale {instrument}: ppm {ppm}, centring {centring}")
        return sigma * MM, correction

    def _ecth(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        station, _, reading, scale = rest
        sigma, correction = self._scale(scale)
        for target, value in lines:
            self.network.add(
                o.SightPlaneOffset(
                    station,
                    target,
                    float(value) + correction,
                    horizontal=float(reading) * GON,
                    sigma=sigma,
                    set=str(self.sets[station]),
                )
            )

    def _ecsp(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        if len(rest) == 5:
            station, _, reading, zenith, scale = rest
        else:
            start, end, scale = rest
        sigma, correction = self._scale(scale)
        for target, value, *options in lines:
            s = float(options[1]) * MM if options[:1] == ["OBSE"] else sigma
            offset = float(value) + correction
            if len(rest) != 5:
                self.network.add(o.LineOffset(target, start, end, offset, sigma=s))
                continue
            self.network.add(
                o.SightOffset(
                    station,
                    target,
                    offset,
                    horizontal=float(reading) * GON,
                    zenith=float(zenith) * GON,
                    sigma=s,
                    set=str(self.sets[station]),
                )
            )

    def _ecve(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        scale, line = rest
        sigma, correction = self._scale(scale)
        frame = f"plumb line {line}"
        if frame not in self.network.frames:
            self.network.add_frame(frame, free=(), origin=line, level=True)
        for target, value in lines:
            offset = float(value) + correction
            self.network.add(o.PlumbOffset(frame, target, offset, sigma=sigma))

    def _pdor(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        (cala,) = (n for n, (_, _, s) in self.found.points.items() if s == "CALA")
        for target, bearing in [rest] if rest else lines:
            # The bearing is that of the plane X, Y, whatever the vertical.
            frame = f"bearing of {target}"
            turn = -float(bearing) * GON
            at = self.place(cala)
            self._turn_about(cala, target, turn)
            self.network.add_frame(frame, free=(), values={"rz": turn}, origin=at.tolist())
            self.network.add(o.PlaneOffset(frame, target, 0.0, sigma=self.tiny))

    def _turn_about(self, cala: str, target: str, turn: float) -> None:
        """Turn approximate coordinates about a point, so that the target lies on its bearing."""
        middle, there = (np.array(self.network.points[n].coordinates) for n in (cala, target))
        d = there - middle
        by = turn + math.atan2(d[0], d[1])
        matrix = exp_rotation(np.array([[0.0, 0.0, by]]))[0]
        for name, p in self.network.points.items():
            x = np.array(p.coordinates, dtype=float)
            moved = tuple((middle + matrix @ (x - middle)).tolist())
            self.network.points[name] = replace(p, coordinates=moved)

    def _ecws(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        instrument, of_water, _, water = rest
        sigma, height, _ = self._numbers(instrument)
        self.network.set_level(water)
        s = math.sqrt(sigma**2 + height**2 + float(of_water) ** 2) * MM
        for target, value, *options in lines:
            if options and options[0] not in ("ID",):
                raise NotUnderstoodError(f"{target}: options {options}")
            up = self.found.points[target][0].to(None)[0][2, 2]
            side = 1 if up > 0 else -1
            self.network.add(self._height(target, water, float(value), s, side))  # type: ignore[arg-type]

    def _ecwi(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        instrument, sag, of_wire, first, second, _, wire, *options = rest
        if set(options) - {"SAGFIX"}:
            raise NotUnderstoodError(f"wire {wire}: options {options}")
        x, z, centring_x, centring_z = self._numbers(instrument)
        sigma = tuple(
            math.hypot(a, b, float(of_wire)) * MM for a, b in ((x, centring_x), (z, centring_z))
        )
        a, b = (self._on_wire(anchor, lines) for anchor in (first, second))
        self.network.add_frame(wire, free=("rx", "ry", "rz", "x", "z"), origin=a.tolist())
        self.network.add(o.FrameRoll(wire, first, 0.0, sigma=1e-4))  # its roll has no effect
        held = "SAGFIX" in options
        self.network.set_size(f"sag of {wire}", float(sag) if held else None, fixed=held)
        length = float(np.linalg.norm(b - a))
        for target, dx, dz, *more in lines:
            if more and more[0] != "ID":
                raise NotUnderstoodError(f"{target}: options {more}")
            body, mount = self.mount(self.found.points[target][0])
            self.network.add(
                o.WireReadingOnBody(
                    wire,
                    target,
                    (float(dx), float(dz)),
                    body=body,
                    mount=mount,
                    sag=f"sag of {wire}",
                    length=length,
                    sigma=sigma,
                )
            )

    def _on_wire(self, anchor: str, lines: list[list[str]]) -> Array:
        """Return where a wire passes the sensor at one of its ends, (3,), by its readings."""
        dx, dz = next((float(v[1]), float(v[2])) for v in lines if v[0] == anchor)
        r, _ = self.found.points[anchor][0].to(None)
        return np.asarray(self.place(anchor) + r @ [dx, 0.0, dz])

    def _uvec(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        station, instrument = rest[:2]
        s = [v * CC for v in self._target(instrument)[:2]]
        frame, mount = self.mount(self.found.points[station][0])
        for target, x, y, *_ in lines:
            value = (float(x), float(y))
            self.network.add(
                o.UnitVector(frame, station, target, value, mount=mount, sigma=(s[0], s[1]))
            )

    def _uvd(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        self._uvec(rest, node, lines)
        sigma = [self._target(rest[1])[2], 0.0]
        self._distances(rest[0], sigma, [[line[0], line[4]] for line in lines])

    def _inclined(self, kind: type, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        sigma, ppm, correction, _, reference, _ = self._numbers(rest[0])
        frame, r, _, _ = self.body(node)
        for target, value, *options in lines:
            stated = dict(zip(options[::2], options[1::2], strict=True))
            if ppm or set(stated) - {"AC", "RF", "ID"}:
                raise NotUnderstoodError(f"{target}: ppm {ppm}, options {options}")
            angle = (float(value) - float(stated.get("AC", correction))) * GON
            rf = float(stated.get("RF", reference))
            mount = None
            turn = r @ turned(0.0, rf * GON, 0.0)
            if not np.allclose(turn, np.eye(3), atol=1e-15):
                mount = f"{rest[0]} at {rf} on {node.name}"
                vector = log_rotation(turn[None])[0]
                values = dict(zip(("rx", "ry", "rz"), vector.tolist(), strict=True))
                self.network.set_mount(mount, values=values)
            self.network.add(kind(frame, target, angle, mount=mount, sigma=sigma * CC))

    def _incly(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        self._inclined(o.FrameInclination, rest, node, lines)

    def _rolly(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        self._inclined(o.FrameRoll, rest, node, lines)

    def _obsxyz(self, rest: list[str], node: Node, lines: list[list[str]]) -> None:
        frame, r, t, _ = self.body(node)
        for target, *numbers in lines:
            x, sigma = np.array([float(v) for v in numbers[:6]]).reshape(2, 3)
            covariance = r @ np.diag(sigma**2) @ r.T
            value = tuple((r @ x + t).tolist())
            self.network.add(o.FrameCoordinate(frame, target, value, covariance=covariance))
