"""Reader of survey measurements of MMVII: observations (.obs) and ground points.

A line of observations has code, station, target, value, σ, in metres and gons; * begins a comment.
A line of ground points has 0 (free) or 1 (given), name, X, Y, Z: what MMVII imports with
``ImportGCP FILE ANXYZ … AddInfoFree=0``.

Source: MicMac (GitHub: micmacIGN/micmac), MMVII/src/Topo/ctopodata.cpp (InsertCompObsFile, addObs).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError, Problem
from ...frames import Frame, LocalFrame, TopocentricFrame
from ...network.network import Network
from ...observations import (
    ControlPoint,
    CoordinateDifference,
    Direction,
    HeightDifference,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ...units import GON, LENGTH
from ..format_reader import NetworkReader, Reader
from ..source import ROWS_SWITCHED_OFF, Problems, TextSource, is_unread
from ..text_files import file_beginning

ORIENTATION_STATUS_LINES = ("#FIX", "#VERT", "#BASC", "#NEW")
"""Lines on the orientation of the stations that follow."""
MMVII_REFRACTION = 0.12
"""Coefficient of refraction of MMVII in frames with the curvature of the Earth."""
DISTANCE_CODE, HEIGHT_CODE, DIRECTION_CODE, ZENITH_CODE, OPEN_DIRECTION_CODE = (
    "3",
    "4",
    "5",
    "6",
    "7",
)
AXIS_BY_CODE = {"14": "x", "15": "y", "16": "z"}
"""Axes of coordinate differences by code."""


def read_mmvii(
    path: str | Path,
    *,
    points: str | Path | None = None,
    sigma_mm: float = 1.0,
    approximate: bool = True,
    latitude: float | None = None,
    longitude: float = 0.0,
) -> Network:
    """Read a survey of MMVII.

    | code | observation |
    | --- | --- |
    | 3 | `SlopeDistance` |
    | 4 | `HeightDifference` |
    | 5, 7 | `Direction`; 7 begins a set, and so does the first direction of a station |
    | 6 | `ZenithAngle` |
    | 14, 15, 16 | `CoordinateDifference` to the east, north and up, of stations after ``#FIX`` |

    After ``#VERT``, and at the begin, the orientation of a station is unknown; after ``#FIX`` it is
    0, held; ``#NEW`` begins new stations. A negative σ switches a line off, as in MMVII. Words
    behind σ, which MMVII passes over, are refused.

    Args:
        path: observations (.obs).
        points: ground points; None: coords.txt, or the name of the observations with .cor, beside
            them.
        sigma_mm: σ of the coordinates of given points, mm (``Sigma=`` of ImportGCP).
        approximate: whether coordinates of free points are approximate values; otherwise they are
            computed.
        latitude: latitude of the origin of the coordinates, degrees: a local tangent frame (RTL)
            on WGS 84, with a refraction of 0.12. None: a flat frame without refraction.
        longitude: its longitude, degrees.

    Raises:
        InputError: every problem of both files with file and line: unknown codes, points and words,
            stations without a vertical (``#BASC``), coordinate differences of others than fixed
            stations.
    """
    source = Path(path)
    given = Path(points) if points is not None else _point_files(source)
    if not (isinstance(sigma_mm, int | float) and 0 < sigma_mm < 1e6):
        raise InputError(Problem(f"must be a number > 0, not {sigma_mm!r}", "sigma_mm"))
    network = Network(source.stem, frame=_frame(latitude, longitude))
    if latitude is not None:
        network.set_refraction(value=MMVII_REFRACTION, fixed=True)
    problems = Problems()
    lines = TextSource(given, problems, code_page="cp1252")
    for number, words in _words(lines):
        _point(network, lines, number, words, sigma_mm * LENGTH["mm"], approximate)
    _Observations(network, TextSource(source, problems, code_page="cp1252")).read()
    if not problems.count and not network.points:
        lines.wrong(0, "has no points")
    problems.finish(network)
    return network


def is_mmvii(path: Path) -> bool:
    """Tell whether observations have a line on the orientation of stations."""
    head = file_beginning(path).decode("latin-1")
    return any(line.strip() in ORIENTATION_STATUS_LINES for line in head.splitlines())


def _point_files(source: Path) -> Path:
    for path in (source.with_name("coords.txt"), source.with_suffix(".cor")):
        if path.is_file():
            return path
    what = "has neither coords.txt nor a .cor file beside it: name the points with points="
    raise InputError(Problem(what, source.name))


def _frame(latitude: float | None, longitude: float) -> Frame:
    if latitude is None:
        return LocalFrame()
    if not (-90 <= latitude <= 90 and -360 <= longitude <= 360):
        where = f"latitude {latitude}, longitude {longitude}"
        raise InputError(f"{where}: must be from -90 to 90 and from -360 to 360 degrees")
    return TopocentricFrame(math.radians(latitude), math.radians(longitude), 0.0, "WGS84")


def _words(lines: TextSource) -> list[tuple[int, list[str]]]:
    found = ((n, line.partition("*")[0].split()) for n, line in lines.numbered())
    return [(n, words) for n, words in found if words]


def _point(
    network: Network,
    lines: TextSource,
    number: int,
    words: list[str],
    sigma: float,
    approximate: bool,
) -> None:
    if len(words) != 5 or words[0] not in ("0", "1"):
        lines.wrong(number, "a point has 0 (free) or 1 (given), name, X, Y, Z")
        return
    fields = (lines.field(number, w, axis) for axis, w in zip("XYZ", words[2:], strict=True))
    xyz = [f.number() for f in fields]
    if is_unread(*xyz):
        return
    name, at = words[1], (xyz[0], xyz[1], xyz[2])
    fixed = words[0] == "1"

    def add() -> None:
        network.add_point(name, at if fixed or approximate else None)
        if fixed:
            place = lines.place(number)
            network.add(ControlPoint(name, at, sigma=(sigma,) * 3, source=place))

    lines.attempt(number, add)


@dataclass
class _Observations:
    network: Network
    lines: TextSource
    status: str = "#VERT"

    def __post_init__(self) -> None:
        self.sets: dict[str, str] = {}
        self.count: dict[str, int] = {}

    def read(self) -> None:
        for number, words in _words(self.lines):
            if words[0].startswith("#"):
                self._status(number, words)
            elif len(words) != 5:
                what = (
                    "an observation has code, station, target, value, σ; MMVII does not read "
                    "what stands behind them"
                )
                self.lines.wrong(number, what)
            else:
                self._observe(number, words)

    def _status(self, number: int, words: list[str]) -> None:
        if words[0] not in ORIENTATION_STATUS_LINES or len(words) > 1:
            valid = ", ".join(ORIENTATION_STATUS_LINES)
            self.lines.wrong(number, f"{' '.join(words)[:40]!r} is not known; valid: {valid}")
            return
        self.sets.clear()
        if words[0] != "#NEW":
            self.status = words[0]
        if self.status == "#BASC":
            what = "stations without a vertical (#BASC) cannot be read: use frames of Comp3D"
            self.lines.wrong(number, what)

    def _observe(self, number: int, words: list[str]) -> None:
        code, station, target = words[:3]
        if code not in (
            DISTANCE_CODE,
            HEIGHT_CODE,
            DIRECTION_CODE,
            ZENITH_CODE,
            OPEN_DIRECTION_CODE,
            *AXIS_BY_CODE,
        ):
            what = f"unknown code {code[:20]!r}; valid: 3, 4, 5, 6, 7, 14, 15, 16"
            self.lines.wrong(number, what)
            return
        value = self.lines.field(number, words[3], "value").number()
        sigma = self.lines.field(number, words[4], "σ").number()
        if is_unread(value, sigma) or self.status == "#BASC":
            return
        if sigma < 0:
            self.lines.leave_out(number, ROWS_SWITCHED_OFF, " ".join(words[:3]))
            return
        if code in AXIS_BY_CODE and self.status != "#FIX":
            what = f"a coordinate difference in the instrument (code {code}) needs #FIX before it"
            self.lines.wrong(number, what)
            return
        self._set(code, station)
        self.lines.attempt(
            number,
            lambda: self.network.add(self._made(code, station, target, value, sigma, number)),
        )

    def _set(self, code: str, station: str) -> None:
        """Begin a set of directions where the code or a new station does."""
        if code == OPEN_DIRECTION_CODE or (code == DIRECTION_CODE and station not in self.sets):
            self.count[station] = self.count.get(station, 0) + 1
            self.sets[station] = name = str(self.count[station])
            if self.status == "#FIX" and station in self.network.points:
                self.network.set_orientation(station, set=name, value=0.0, fixed=True)

    def _made(
        self, code: str, station: str, target: str, value: float, sigma: float, number: int
    ) -> Observation:
        source = self.lines.place(number)
        if code == DISTANCE_CODE:
            return SlopeDistance(station, target, value, sigma=sigma, source=source)
        if code == HEIGHT_CODE:
            return HeightDifference(station, target, value, sigma=sigma, source=source)
        if code in AXIS_BY_CODE:
            axis = AXIS_BY_CODE[code]
            return CoordinateDifference(
                station, target, (value,), axes=axis, sigma=sigma, horizon=True, source=source
            )
        angle, s = value * GON, sigma * GON
        if code == ZENITH_CODE:
            return ZenithAngle(station, target, angle, sigma=s, source=source)
        name = self.sets[station]
        return Direction(station, target, angle, sigma=s, set=name, source=source)


READER = Reader(
    "mmvii",
    (".obs",),
    "survey of MMVII",
    NetworkReader(read_mmvii),
    recognises=is_mmvii,
)
