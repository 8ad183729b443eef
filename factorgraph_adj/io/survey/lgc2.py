"""Reader of inputs of LGC2 (CERN): frames, points and blocks of observations as a network.

Format: CERN, LGC2 user guide; what its documents leave open was found from its tests:

- Angles are gon, their σ cc; σ of lengths are mm, parts per million mm/km, added to them.
- A frame states translation, three rotations and a scale: X_parent = T + Rx(−ω) Ry(−φ) Rz(−κ) x,
  with the usual right-handed matrices: its rotations count clockwise. Free components follow.
- A ``*SCALE`` states σ, ppm, a correction (metres) that is added to the reading, its σ, and the σ
  of centring; it gives the offsets. ``*ECTH`` is positive to the left of the sight.
- A wire has a bearing, a slope, two offsets and a sag; what a sensor reads is in the x and z of its
  own frame, where the chord passes its plane y, with the sag added along the vertical.
- Printed σ are multiplied with the estimated σ of unit weight where its test fails at 95 %, as in
  ECTH, and are a priori where it passes, as in ECVE and ECSP.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ... import observations as o
from ...network.network import Network
from ...rotation import exp_rotation
from ...stochastic_model import StandardDeviation
from ...types import Array
from ...units import CC, GON, MILLIMETRE
from ..format_reader import NetworkReader, Reader, begins_with
from ..source import TextSource
from .lgc2_frames import Lgc2Builder, rotation_components
from .lgc2_input import InputWords, Lgc2Input, ObservationBlock, frame_rotation

MAX_WORDS_BY_KEYWORD = {
    **{"TSTN": 3, "ECTH": 4, "ECVE": 2, "OBSXYZ": 0, "INCLY": 1, "ROLLY": 1},
    **dict.fromkeys(("ANGL", "ZEND", "DIST", "DSPT", "UVEC", "UVD"), 2),
}
"""Largest number of words behind a keyword; of blocks at a station, with station and instrument."""
WIRE_ROLL_SIGMA_RAD = 1e-4
"""Standard deviation of the roll of a wire, radians, which has no effect."""
CONDITION_SIGMA_M = 1e-8
"""Standard deviation of conditions, metres."""


class Lgc2Observations:
    """Adds the blocks of an input to its network."""

    def __init__(self, builder: Lgc2Builder) -> None:
        """Take the builder, which has added frames and points."""
        self.builder = builder
        self.found = builder.found
        self.network = builder.network
        self.sets: dict[str, int] = {}
        self.readers: dict[str, Callable[[ObservationBlock], None]] = {
            "TSTN": self._station,
            "CAM": lambda block: None,
            "ANGL": self._directions,
            "ZEND": self._zeniths,
            "DIST": lambda b: self._distances(
                b.head.word(0, "station"), self._edm(b, 2, 4), b.rows
            ),
            "DSPT": lambda b: self._distances(b.head.word(0, "station"), self._edm(b, 0), b.rows),
            "ECTH": self._sight_planes,
            "ECSP": self._offsets,
            "ECVE": self._plumb_lines,
            "PDOR": self._bearings,
            "ECWS": self._water,
            "ECWI": self._wire,
            "UVEC": self._unit_vectors,
            "UVD": self._unit_vectors_and_distances,
            "INCLY": lambda b: self._inclined(o.FrameInclination, b),
            "ROLLY": lambda b: self._inclined(o.FrameRoll, b),
            "OBSXYZ": self._coordinates,
        }

    def add_all(self) -> None:
        """Add all blocks; problems are noted in the file, the first one of each block."""
        for block in self.found.blocks:
            with self.found.file.problems.collect(self.found.file.place(block.head.line)):
                most = MAX_WORDS_BY_KEYWORD.get(block.key)
                if most is not None and len(block.head.words) > most:
                    behind = " ".join(block.head.words[most:])
                    block.head.wrong(f"words behind *{block.key} are not read: {behind[:60]!r}")
                self.readers[block.key](block)

    # -- instruments and points -------------------------------------------------------------------

    def _rows_of(self, head: InputWords, name: str) -> list[InputWords]:
        rows = self.found.instruments.get(name)
        if rows is None:
            listed = ", ".join(list(self.found.instruments)[:12]) or "none"
            head.wrong(f"unknown instrument {name[:40]!r}; known: {listed}")
        return rows

    def _numbers(self, head: InputWords, name: str, count: int) -> list[float]:
        """Return the numbers in the line of an instrument."""
        return self._rows_of(head, name)[0].numbers(1, count)

    def _target(
        self, head: InputWords, begin: int, count: int, of: int | None = None
    ) -> list[float]:
        """Return numbers of the first target of the instrument of a block.

        Args:
            head: line of the block.
            begin: first of the numbers.
            count: how many they are.
            of: how many numbers of the target of a total station are standard deviations of its
                observations; those behind them (corrections, heights and their standard
                deviations, centring) must be 0, and so must the numbers of the total station.
                None: another instrument.
        """
        name = head.word(1, "the instrument")
        rows = self._rows_of(head, name)
        if len(rows) < 2:
            head.wrong(f"instrument {name[:40]!r} has no line of its target")
        if of is not None:
            self._only_zeros(rows[0], 2)
            self._only_zeros(rows[1], 1 + of)
        return rows[1].numbers(1 + begin, count)

    @staticmethod
    def _only_zeros(row: InputWords, begin: int) -> None:
        """Refuse numbers of an instrument that are not 0."""
        if any(row.numbers(begin, len(row.words) - begin)):
            row.wrong(
                f"{' '.join(row.words)[:60]!r}: heights, centring and corrections of instruments "
                f"and targets are not read; valid: 0 from word {begin + 1} on"
            )

    def _edm(self, block: ObservationBlock, begin: int, of: int | None = None) -> list[float]:
        return self._target(block.head, begin, 2, of)

    def _scale(self, head: InputWords, name: str) -> tuple[float, float]:
        """Return σ and correction of a scale, metres."""
        sigma, ppm, correction, other, centring = self._numbers(head, name, 5)
        if ppm or centring:
            head.wrong(f"scale {name}: ppm {ppm:g}, centring {centring:g}; only zeros are read")
        if other:
            head.wrong(f"scale {name}: σ of the correction {other:g}; only zeros are read")
        return sigma * MILLIMETRE, correction

    def _stated(self, row: InputWords, name: str) -> None:
        if name not in self.found.points:
            row.wrong(f"unknown point {name[:40]!r}")

    def _reading(self, row: InputWords, *, options: tuple[str, ...] = ()) -> tuple[str, float]:
        """Return target and value of a line."""
        name, value = row.word(0, "a point"), row.number(1, "the reading")
        self._stated(row, name)
        row.options(2, options)
        return name, value

    def _set(self, head: InputWords, station: str) -> str:
        if station not in self.sets:
            head.wrong(f"{station[:40]!r} is no station that is read")
        return str(self.sets[station])

    def _source(self, row: InputWords) -> str:
        return row.file.place(row.line)

    # -- total stations ----------------------------------------------------------------------------

    def _station(self, block: ObservationBlock) -> None:
        head, earth = block.head, self.builder.earth
        name = head.word(0, "station")
        self._stated(head, name)
        mode = head.word(2, "IHFIX")
        if block.node is not self.found.root or mode.upper() not in ("IHFIX", "HIFIX"):
            head.wrong(f"a station is read outside of frames and with IHFIX, not {mode[:20]!r}")
        self.sets[name] = self.sets.get(name, 0) + 1
        if earth.kind == "LEP":
            xi, eta = earth.deflections(self.builder.place(self.found.points[name]))
            self.network.set_vertical(name, xi=xi, eta=eta, fixed=True)

    def _directions(self, block: ObservationBlock) -> None:
        station = block.head.word(0, "station")
        (sigma,) = self._target(block.head, 0, 1, 4)
        for row in block.rows:
            target, value = self._reading(row)
            self.network.add(
                o.Direction(
                    station,
                    target,
                    value * GON,
                    sigma=sigma * CC,
                    set=self._set(block.head, station),
                    source=self._source(row),
                )
            )

    def _zeniths(self, block: ObservationBlock) -> None:
        station = block.head.word(0, "station")
        (sigma,) = self._target(block.head, 1, 1, 4)
        for row in block.rows:
            target, value = self._reading(row)
            self.network.add(
                o.ZenithAngle(
                    station, target, value * GON, sigma=sigma * CC, source=self._source(row)
                )
            )

    def _distances(
        self, station: str, parts: list[float], rows: list[InputWords], column: int = 1
    ) -> None:
        sigma = StandardDeviation(parts[0] * MILLIMETRE, ppm=parts[1], combine="linear")
        for row in rows:
            target, value = row.word(0, "a point"), row.number(column, "the distance")
            self._stated(row, target)
            row.options(column + 1, ())
            self.network.add(
                o.SlopeDistance(station, target, value, sigma=sigma, source=self._source(row))
            )

    # -- offsets -----------------------------------------------------------------------------------

    def _sight_planes(self, block: ObservationBlock) -> None:
        station, reading = block.head.word(0, "station"), block.head.number(2, "the direction")
        sigma, correction = self._scale(block.head, block.head.word(3, "the scale"))
        for row in block.rows:
            target, value = self._reading(row)
            self.network.add(
                o.SightPlaneOffset(
                    station,
                    target,
                    value + correction,
                    horizontal=reading * GON,
                    sigma=sigma,
                    set=self._set(block.head, station),
                    source=self._source(row),
                )
            )

    def _offsets(self, block: ObservationBlock) -> None:
        """Add offsets from a sight (five words), or from a line through two points (three)."""
        head = block.head
        if len(head.words) not in (3, 5):
            head.wrong("*ECSP has two points and a scale, or direction, zenith angle and a scale")
        at_sight = len(head.words) == 5
        sigma, correction = self._scale(head, head.words[-1])
        start, end = head.words[:2]
        for row in block.rows:
            target, value = self._reading(row, options=("OBSE",))
            given = row.options(2, ("OBSE",)).get("OBSE")
            s = (
                sigma
                if given is None
                else row.number(row.words.index("OBSE") + 1, "σ") * MILLIMETRE
            )
            if not at_sight:
                self.network.add(
                    o.LineOffset(
                        target, start, end, value + correction, sigma=s, source=self._source(row)
                    )
                )
                continue
            self.network.add(
                o.SightOffset(
                    start,
                    target,
                    value + correction,
                    horizontal=head.number(2) * GON,
                    zenith=head.number(3) * GON,
                    sigma=s,
                    set=self._set(head, start),
                    source=self._source(row),
                )
            )

    def _plumb_lines(self, block: ObservationBlock) -> None:
        line = block.head.word(1, "the point of the plumb line")
        self._stated(block.head, line)
        sigma, correction = self._scale(block.head, block.head.word(0, "the scale"))
        frame = f"plumb line {line}"
        if frame not in self.network.frames:
            self.network.add_frame(frame, free=(), origin=line, level=True)
        for row in block.rows:
            target, value = self._reading(row)
            self.network.add(
                o.PlumbOffset(
                    frame, target, value + correction, sigma=sigma, source=self._source(row)
                )
            )

    def _bearings(self, block: ObservationBlock) -> None:
        held = [n for n, p in self.found.points.items() if p.kind == "CALA"]
        if len(held) != 1:
            block.head.wrong(f"*PDOR needs one held point (*CALA), not {len(held)}")
        for row in [block.head] if block.head.words else block.rows:
            target, bearing = row.word(0, "a point"), row.number(1, "the bearing")
            self._stated(row, target)
            # The bearing is that of the plane X, Y, whatever the vertical.
            frame, turn = f"bearing of {target}", -bearing * GON
            at = self.builder.place(self.found.points[held[0]])
            self._turn_about(held[0], target, turn)
            self.network.add_frame(frame, free=(), values={"rz": turn}, origin=at.tolist())
            self.network.add(
                o.PlaneOffset(frame, target, 0.0, sigma=self.builder.tiny, source=self._source(row))
            )

    def _turn_about(self, held: str, target: str, turn: float) -> None:
        """Turn approximate coordinates about a point, so that the target lies on its bearing."""
        middle, there = (np.array(self.network.points[n].coordinates) for n in (held, target))
        d = there - middle
        by = turn + math.atan2(d[0], d[1])
        matrix = exp_rotation(np.array([[0.0, 0.0, by]]))[0]
        for name, p in self.network.points.items():
            x = np.array(p.coordinates, dtype=float)
            moved = tuple((middle + matrix @ (x - middle)).tolist())
            self.network.points[name] = replace(p, coordinates=moved)

    # -- water and wires ---------------------------------------------------------------------------

    def _water(self, block: ObservationBlock) -> None:
        head = block.head
        of_water, water = head.number(1, "the σ of the water"), head.word(3, "the water level")
        sigma, height, _ = self._numbers(head, head.words[0], 3)
        self.network.set_level(water)
        s = math.sqrt(sigma**2 + height**2 + of_water**2) * MILLIMETRE
        for row in block.rows:
            target, value = self._reading(row)
            up = self.found.points[target].node.to(None)[0][2, 2]
            self.network.add(
                self.builder.height(target, water, value, s, 1 if up > 0 else -1, self._source(row))
            )

    def _wire(self, block: ObservationBlock) -> None:
        head = block.head
        instrument, first = head.word(0, "the instrument"), head.word(3, "the first anchor")
        second, wire = head.word(4, "the second anchor"), head.word(6, "the wire")
        sag, of_wire = head.number(1, "the sag"), head.number(2, "the σ of the wire")
        options = head.words[7:]
        if set(options) - {"SAGFIX"}:
            head.wrong(f"options {' '.join(options)[:60]!r} of a wire are not read; valid: SAGFIX")
        x, z, centring_x, centring_z = self._numbers(head, instrument, 4)
        sigma = (
            math.hypot(x, centring_x, of_wire) * MILLIMETRE,
            math.hypot(z, centring_z, of_wire) * MILLIMETRE,
        )
        a, b = (self._on_wire(head, anchor, block.rows) for anchor in (first, second))
        self.network.add_frame(wire, free=("rx", "ry", "rz", "x", "z"), origin=a.tolist())
        self.network.add(o.FrameRoll(wire, first, 0.0, sigma=WIRE_ROLL_SIGMA_RAD))
        held = "SAGFIX" in options
        self.network.set_size(f"sag of {wire}", sag if held else None, fixed=held)
        length = float(np.linalg.norm(b - a))
        for row in block.rows:
            target = row.word(0, "a point")
            self._stated(row, target)
            row.options(3, ())
            body, mount = self.builder.mount(self.found.points[target].node)
            self.network.add(
                o.WireReadingOnBody(
                    wire,
                    target,
                    (row.number(1), row.number(2)),
                    body=body,
                    mount=mount,
                    sag=f"sag of {wire}",
                    length=length,
                    sigma=sigma,
                    source=self._source(row),
                )
            )

    def _on_wire(self, head: InputWords, anchor: str, rows: list[InputWords]) -> Array:
        """Return where a wire passes the sensor at one of its ends, (3,), by its readings."""
        self._stated(head, anchor)
        row = next((r for r in rows if r.words[0] == anchor), None)
        if row is None:
            head.wrong(f"the wire has no reading at its anchor {anchor[:40]!r}")
        point = self.found.points[anchor]
        r, _ = point.node.to(None)
        offset = [row.number(1), 0.0, row.number(2)]
        return np.asarray(self.builder.place(point) + r @ offset)

    # -- in frames ---------------------------------------------------------------------------------

    def _unit_vectors(self, block: ObservationBlock) -> None:
        station = block.head.word(0, "station")
        self._stated(block.head, station)
        a, b = self._target(block.head, 0, 2)
        frame, mount = self.builder.mount(self.found.points[station].node)
        for row in block.rows:
            target, x, y = row.word(0, "a point"), row.number(1), row.number(2)
            self._stated(row, target)
            self.network.add(
                o.UnitVector(
                    frame,
                    station,
                    target,
                    (x, y),
                    mount=mount,
                    sigma=(a * CC, b * CC),
                    source=self._source(row),
                )
            )

    def _unit_vectors_and_distances(self, block: ObservationBlock) -> None:
        self._unit_vectors(block)
        (sigma,) = self._target(block.head, 2, 1)
        self._distances(block.head.words[0], [sigma, 0.0], block.rows, column=4)

    def _inclined(
        self, kind: type[o.FrameInclination] | type[o.FrameRoll], block: ObservationBlock
    ) -> None:
        name = block.head.word(0, "the instrument")
        sigma, ppm, correction, other, reference, turn_sigma = self._numbers(block.head, name, 6)
        if ppm:
            block.head.wrong(f"inclinometer {name}: ppm {ppm:g}; only zero is read")
        if other or turn_sigma:
            what = f"σ of correction and reference {other:g} and {turn_sigma:g}"
            block.head.wrong(f"inclinometer {name}: {what}; only zeros are read")
        frame, r, _, _ = self.builder.body(block.node)
        for row in block.rows:
            target, value = self._reading(row, options=("AC", "RF"))
            stated = {
                k: row.number(row.words.index(k) + 1, k) for k in row.words[2::2] if k != "ID"
            }
            angle = (value - stated.get("AC", correction)) * GON
            rf = stated.get("RF", reference)
            mount = None
            turn = r @ frame_rotation(0.0, rf * GON, 0.0)
            if not np.allclose(turn, np.eye(3), atol=1e-15):
                mount = f"{name} at {rf} on {block.node.name}"
                self.network.set_mount(mount, values=rotation_components(turn))
            self.network.add(
                kind(frame, target, angle, mount=mount, sigma=sigma * CC, source=self._source(row))
            )

    def _coordinates(self, block: ObservationBlock) -> None:
        """Add coordinates in the frame of the block, metres, with σ in millimetres."""
        frame, r, t, _ = self.builder.body(block.node)
        for row in block.rows:
            target = row.word(0, "a point")
            self._stated(row, target)
            x, sigma = np.array(row.numbers(1, 6)).reshape(2, 3)
            row.options(7, ())
            covariance = r @ np.diag((sigma * MILLIMETRE) ** 2) @ r.T
            value = tuple((r @ x + t).tolist())
            self.network.add(
                o.FrameCoordinate(
                    frame, target, value, covariance=covariance, source=self._source(row)
                )
            )


def read_lgc2(path: str | Path, *, condition: float = CONDITION_SIGMA_M) -> Network:
    """Read an input of LGC2.

    The frame is the cartesian system of the input: plane (``*OLOC``), over a sphere (``*SPHE``) or
    over the ellipsoid with the geoid of 1985 (``*LEP``); the grid of the geoid of 2000 (``*RS2K``)
    is not here, and is refused. Points of ``*CALA`` are held, those of ``*POIN`` free; ``*VXY``,
    ``*VXZ``, ``*VZ`` hold the components that are not named. A frame with free components is one of
    the network, whose origin is a point ``NAME/origin``; what is held of its translation, and held
    points in it, are conditions. Read are ``*ANGL``, ``*ZEND``, ``*DIST``, ``*DSPT``,
    ``*ECTH``, ``*ECSP``, ``*ECVE``, ``*ECWI``, ``*ECWS``, ``*INCLY``, ``*ROLLY``, ``*UVEC``,
    ``*UVD``, ``*OBSXYZ`` and ``*PDOR`` with their instruments; ``*TITR``, ``*PREC``, ``*PUNC``,
    ``*FAUT``, ``*INSTR``, ``*V0`` and ``*END`` do not change a network.

    Args:
        path: the file.
        condition: standard deviation of conditions, metres. From coarse approximate values an
            adjustment may need softer conditions first, whose solution starts the next one.

    Raises:
        InputError: every problem of the file, each with its line: words that are not understood,
            unknown instruments, free frames in free frames, frames with a scale.
    """
    file = TextSource(path, code_page="cp1252")
    found = Lgc2Input(file)
    if not found.points:
        file.wrong(0, "has no points (*CALA, *POIN, *VXY, *VXZ, *VZ)")
    file.raise_all()
    builder = Lgc2Builder(found, condition)
    builder.frames_and_points()
    file.raise_all()
    Lgc2Observations(builder).add_all()
    file.problems.finish(builder.network)
    return builder.network


READER = Reader(
    "lgc2",
    (".lgc2", ".lgc"),
    "LGC2",
    NetworkReader(read_lgc2),
    recognises=begins_with(rb"(?:[ \t\r]*+(?:%[^\n]*+)?\n)*+[ \t]*+\*TITR\b"),
)
