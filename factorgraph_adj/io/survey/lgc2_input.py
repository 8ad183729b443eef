"""Input of LGC2 as read: frames, points, instruments, blocks of observations; Earth model.

The Earth is a plane, a sphere, or an ellipsoid with the paraboloid of 1985 as geoid. X and Y are
those of the cartesian system of CERN; the third coordinate of points outside of frames is a height
H over the model. The sphere has R = 6371 km and passes through Z = 2000.00079 m below the origin
(`CERN_ORIGIN`), where the ellipsoid has its top too.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import NoReturn

import numpy as np

from ...errors import InputError, Problem, known
from ...frames import LocalFrame
from ...rotation import exp_rotation
from ...types import Array
from ...units import GON
from ..numbers import NUMBER_PATTERN
from ..source import Problems, TextSource

CERN_ORIGIN = np.array([2000.0, 2097.79265, 2433.66])
"""Origin of the cartesian system at CERN, metres."""
_GRS80 = (6378137.0, 0.0066943800229)
"""Semi-major axis, metres, and first eccentricity squared."""
_LATITUDE, _HEIGHT, _AZIMUTH_OF_Y = 51.3692 * GON, 433.65921, 37.77864 * GON
"""Latitude (radians) and height (metres) of P0, azimuth of the Y axis there (radians)."""
SPHERE_RADIUS_M = 6_371_000.0
"""Radius of the sphere, metres."""
MODEL_TOP_Z_M = float(CERN_ORIGIN[2]) - _HEIGHT
"""Z of sphere and ellipsoid below P0, metres: 2000.00079."""
_PARABOLOID = (0.614, -0.106, 48.219 * GON - 38.90742 * GON)
"""Second derivatives, 10⁻⁵/km, and bearing of the axes of the geoid of 1985."""
IGNORED_KEYWORDS = ("PREC", "PUNC", "FAUT", "END", "V0", "INSTR")
"""Keywords of printing and of program control: they do not change the network."""
POINT_KEYWORDS = {"CALA": "xyz", "POIN": "", "VXY": "z", "VXZ": "y", "VZ": "xy"}
"""Components that are held, by the keyword of the block of points."""
INSTRUMENT_KEYWORDS = ("POLAR", "EDM", "SCALE", "CAMD", "HLSR", "WPSR", "INCL")
STATION_BLOCKS = ("ANGL", "ZEND", "DIST", "ECTH", "UVEC", "UVD")
"""Blocks of a station, whose name and instrument are in the block of the station."""
SINGLE_BLOCKS = ("ECVE", "ECSP", "DSPT", "ECWI", "ECWS", "INCLY", "ROLLY", "OBSXYZ", "PDOR")
STATION_KEYWORDS = ("TSTN", "CAM")
KEYWORDS_WITHOUT_WORDS = ("OLOC", "SPHE", "LEP", "ENDFRAME", "INSTR", "V0", "END")
"""Keywords with nothing behind them in their line."""
KEYWORDS_WITHOUT_LINES = (
    *("OLOC", "SPHE", "LEP", "FRAME", "ENDFRAME", *IGNORED_KEYWORDS, *STATION_KEYWORDS),
    *("SCALE", "HLSR", "WPSR", "INCL"),
)
"""Keywords with no lines below them, among them instruments without targets."""
FRAME_COMPONENTS = ("TX", "TY", "TZ", "RX", "RY", "RZ")
"""Components of a frame that may be free."""
MAX_FRAME_DEPTH = 50
"""Largest depth of frames in frames."""


@dataclass(frozen=True)
class EarthModel:
    """An earth model: heights over it, and the frame of the network that comes near."""

    kind: str
    """Word of the file: OLOC (plane), SPHE (sphere) or LEP (ellipsoid with geoid)."""

    def surface(self, x: Array) -> tuple[float, float, float]:
        """Return radius, Z of the top, and undulation at a place (3,)."""
        if self.kind == "SPHE":
            return SPHERE_RADIUS_M, MODEL_TOP_Z_M, 0.0
        dx, dy = (x - CERN_ORIGIN)[:2]
        a, e2 = _GRS80
        azimuth = math.atan2(dx, dy) + _AZIMUTH_OF_Y
        n = a / math.sqrt(1.0 - e2 * math.sin(_LATITUDE) ** 2)
        rho = n / (1.0 + e2 / (1.0 - e2) * (math.cos(_LATITUDE) * math.cos(azimuth)) ** 2)
        p, q, bearing = _PARABOLOID
        c, s = math.cos(bearing), math.sin(bearing)
        xp, yp = 1e-3 * (dx * c - dy * s), 1e-3 * (dx * s + dy * c)
        return rho, MODEL_TOP_Z_M, 0.01 * (p / 2 * xp * xp + q / 2 * yp * yp)

    def height(self, x: Array) -> float:
        """Return the height H of a place (3,)."""
        if self.kind == "OLOC":
            return float(x[2])
        radius, top, undulation = self.surface(x)
        d = math.hypot(*(x - CERN_ORIGIN)[:2])
        return math.hypot(d, radius + x[2] - top) - radius - undulation

    def place(self, x: float, y: float, height: float) -> Array:
        """Return the cartesian coordinates (3,) of X, Y and H; NaN beyond the horizon."""
        out = np.array([x, y, height])
        if self.kind != "OLOC":
            radius, top, undulation = self.surface(out)
            d = math.hypot(*(out - CERN_ORIGIN)[:2])
            square = (radius + height + undulation) ** 2 - d * d
            out[2] = top - radius + math.sqrt(square) if square > 0 else math.nan
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
            curvature=True,
            radius=radius + float(near[2]) - top,
            origin=(*CERN_ORIGIN[:2].tolist(), top),
        )


class InputWords:
    """The words of a line, or a part of them; every method raises InputError with the line."""

    def __init__(self, file: TextSource, line: int, words: list[str]) -> None:
        """Take the words of a line."""
        self.file = file
        self.line = line
        self.words = words

    def wrong(self, what: str) -> NoReturn:
        """Raise a problem of the line."""
        raise InputError(Problem(what, self.file.place(self.line)))

    def word(self, at: int, name: str) -> str:
        """Return a word."""
        if at >= len(self.words):
            self.wrong(f"needs {name} as word {at + 1}, but has {len(self.words)} words")
        return self.words[at]

    def number(self, at: int, name: str = "a number") -> float:
        """Return a word as a number."""
        problems = Problems()
        value = problems.field(self.word(at, name), name, self.file.place(self.line)).number()
        problems.raise_all()
        return value

    def numbers(self, begin: int, count: int, name: str = "a number") -> list[float]:
        """Return consecutive words as numbers."""
        return [self.number(i, name) for i in range(begin, begin + count)]

    def options(self, begin: int, valid: tuple[str, ...]) -> dict[str, str]:
        """Return the options behind the words of a reading, word and value each; ID is a name."""
        rest = self.words[begin:]
        found = dict(zip(rest[::2], rest[1::2], strict=False))
        unknown = [k for k in found if k not in (*valid, "ID")]
        if unknown or len(rest) % 2:
            self.wrong(
                f"options {' '.join(rest)[:60]!r} are not read; valid: {known((*valid, 'ID'))}"
            )
        return found

    def behind(self, begin: int) -> InputWords:
        """Return the row without its first words."""
        return InputWords(self.file, self.line, self.words[begin:])


@dataclass
class FrameNode:
    """A frame of the input, or its root."""

    name: str
    """Name."""
    parent: FrameNode | None
    """The frame in which it is stated; None: it is the root."""
    rotation: Array
    """Rotation (3, 3) from the frame to its parent."""
    translation: Array
    """Its origin in the parent, (3,), metres."""
    free: tuple[str, ...] = ()
    """Components that are free, of `FRAME_COMPONENTS`."""
    row: InputWords | None = None
    """Its place in the file."""

    @property
    def joined(self) -> bool:
        """Whether it is but a further rotation of the free frame around it."""
        p = self.parent
        rotates = bool(self.free) and all(f.startswith("R") for f in self.free)
        return bool(rotates and p is not None and p.free and not self.translation.any())

    def body(self) -> FrameNode | None:
        """Return the free frame to which it is fixed; None: it is fixed to the root."""
        if self.free:
            return self
        return None if self.parent is None else self.parent.body()

    def to(self, other: FrameNode | None) -> tuple[Array, Array]:
        """Return rotation and translation from here to an outer frame; None: the root."""
        if self is other or self.parent is None:
            return np.eye(3), np.zeros(3)
        r, t = self.parent.to(other)
        return r @ self.rotation, r @ self.translation + t

    def wrong(self, what: str) -> NoReturn:
        """Raise a problem of the line of the frame."""
        where = "" if self.row is None else self.row.file.place(self.row.line)
        raise InputError(Problem(f"frame {self.name}: {what}", where))


@dataclass(frozen=True)
class ObservationBlock:
    """A block of observations."""

    key: str
    """Keyword, without asterisk."""
    head: InputWords
    """Words behind the keyword; of blocks at a station, its name and instrument before them."""
    node: FrameNode
    """The frame that contains it."""
    rows: list[InputWords]
    """Its lines."""


@dataclass(frozen=True)
class StatedPoint:
    """A point of the input."""

    node: FrameNode
    """The frame that contains it."""
    at: Array
    """Coordinates in that frame, (3,), metres; those of the root are cartesian."""
    kind: str
    """Keyword of its block, of `POINT_KEYWORDS`."""
    row: InputWords
    """Its place in the file."""


def frame_rotation(omega: float, phi: float, kappa: float) -> Array:
    """Return Rx(−ω) Ry(−φ) Rz(−κ), (3, 3), from a frame to its parent; angles in radians."""
    x, y, z = exp_rotation(np.diag([-omega, -phi, -kappa]))
    return np.asarray(x @ y @ z)


@dataclass
class Lgc2Input:
    """Everything that an input says."""

    file: TextSource
    """The file."""
    earth: EarthModel = field(default_factory=lambda: EarthModel("OLOC"))
    """Model of the earth."""
    root: FrameNode = field(default_factory=lambda: FrameNode("ROOT", None, np.eye(3), np.zeros(3)))
    """The root of the frames."""
    nodes: list[FrameNode] = field(default_factory=list)
    """Frames, outer ones before inner ones."""
    points: dict[str, StatedPoint] = field(default_factory=dict)
    """Points by name."""
    instruments: dict[str, list[InputWords]] = field(default_factory=dict)
    """Instruments by name: the words behind the keyword, then the lines of their targets."""
    blocks: list[ObservationBlock] = field(default_factory=list)
    """Blocks of observations."""

    def __post_init__(self) -> None:
        """Read the lines; problems are noted in the file."""
        self._node = self.root
        self._section = ""
        self._rows: list[InputWords] = []
        self._station = InputWords(self.file, 0, [])
        self._depth = 0
        for row in self._lines():
            try:
                if row.words[0].startswith("*"):
                    self._keyword(row)
                else:
                    self._rows.append(row)
                    if self._section in POINT_KEYWORDS:
                        self._point(row)
                    elif self._section in ("", *KEYWORDS_WITHOUT_LINES):
                        before = self._section or "WORD"
                        row.wrong(f"the line does not belong to *{before} before it")
            except InputError as error:
                self.file.problems.extend(error.problems)
        if self._node is not self.root:
            line = 0 if self._node.row is None else self._node.row.line
            self.file.wrong(line, f"frame {self._node.name} has no *ENDFRAME")

    def _lines(self) -> list[InputWords]:
        """Return the lines that say something: without comments (%, $) and the title."""
        rows = []
        title = False
        for number, text in self.file.numbered():
            line = text.split("%")[0].split("$")[0].strip()
            if title and not line.startswith("*"):
                continue
            title = line.upper().startswith("*TITR")
            words = re.sub(r"^\*\s+", "*", line).split()
            if words and not title:
                rows.append(InputWords(self.file, number, words))
        return rows

    def _keyword(self, row: InputWords) -> None:
        key = row.words[0].lstrip("*").upper()
        rest = row.behind(1)
        if rest.words and (key in KEYWORDS_WITHOUT_WORDS or key in POINT_KEYWORDS):
            row.wrong(f"words behind *{key} are not read: {' '.join(rest.words)[:60]!r}")
        rows: list[InputWords] = []
        self._rows, self._section = rows, key
        if key in ("OLOC", "SPHE", "LEP"):
            self.earth = EarthModel(key)
        elif key == "RS2K":
            row.wrong("*RS2K: the grid of the geoid of 2000 is not here; valid: *OLOC, *SPHE, *LEP")
        elif key == "FRAME":
            self._node = self._frame(rest)
        elif key == "ENDFRAME":
            if self._node.parent is None:
                row.wrong("*ENDFRAME ends no frame")
            self._node = self._node.parent
        elif key in INSTRUMENT_KEYWORDS:
            name = rest.word(0, "the name of the instrument")
            if name in self.instruments:
                row.wrong(f"instrument {name[:40]!r} stands there already")
            rows.append(rest)
            self.instruments[name] = rows
        elif key in STATION_KEYWORDS:
            self._station = rest
            self.blocks.append(ObservationBlock(key, rest, self._node, rows))
        elif key in STATION_BLOCKS or key in SINGLE_BLOCKS:
            at_station = key in STATION_BLOCKS
            if key == "ECSP" and len(rest.words) == 3:
                at_station = NUMBER_PATTERN.fullmatch(rest.words[0]) is not None
            if at_station:
                if len(self._station.words) < 2:
                    row.wrong(f"*{key} needs a station with an instrument before it")
                rest = InputWords(self.file, row.line, [*self._station.words[:2], *rest.words])
            self.blocks.append(ObservationBlock(key, rest, self._node, rows))
        elif key not in IGNORED_KEYWORDS and key not in POINT_KEYWORDS:
            valid = known(
                (
                    *POINT_KEYWORDS,
                    *INSTRUMENT_KEYWORDS,
                    *STATION_KEYWORDS,
                    *STATION_BLOCKS,
                    *SINGLE_BLOCKS,
                ),
                meant=key,
                most=60,
            )
            row.wrong(f"*{key[:20]} is not understood; valid: {valid}")

    def _frame(self, row: InputWords) -> FrameNode:
        name = row.word(0, "the name of the frame")
        self._depth += 1
        # A frame that is wrong is kept, so that its *ENDFRAME ends it.
        node = FrameNode(name, self._node, np.eye(3), np.zeros(3), (), row)
        if name in [n.name for n in self.nodes] or name == self.root.name:
            self.file.wrong(row.line, f"second frame {name[:40]!r}")
        depth, outer = 0, self._node
        while outer.parent is not None:
            depth, outer = depth + 1, outer.parent
        if depth > MAX_FRAME_DEPTH:
            row.wrong(f"frames are nested deeper than {MAX_FRAME_DEPTH}")
        try:
            t, scale = row.numbers(1, 6), row.number(7, "the scale")
            free = tuple(f.upper() for f in row.words[8:])
            if scale != 1.0 or not set(free) <= set(FRAME_COMPONENTS):
                row.wrong(f"frame {name}: scale {scale:g}, free {' '.join(free)[:40]}: valid are "
                          f"a scale of 1 and some of {', '.join(FRAME_COMPONENTS)}")  # fmt: skip
            node.rotation = frame_rotation(*(a * GON for a in t[3:]))
            node.translation, node.free = np.array(t[:3]), free
        except InputError as error:
            self.file.problems.extend(error.problems)
        self.nodes.append(node)
        return node

    def _point(self, row: InputWords) -> None:
        name = row.words[0]
        if len(row.words) < 4:
            row.wrong("a point has a name and three coordinates")
        x = np.array(row.numbers(1, 3, "a coordinate"))
        row.options(4, ())
        if name in self.points:
            row.wrong(f"point {name[:40]!r} stands in line {self.points[name].row.line} already")
        if self._node is self.root:
            x = self.earth.place(*x.tolist())
        elif self._section not in ("CALA", "POIN"):
            row.wrong(f"*{self._section} in a frame; valid there: *CALA, *POIN")
        if not np.isfinite(x).all():
            row.wrong("the place is not near the earth")
        self.points[name] = StatedPoint(self._node, x, self._section, row)
