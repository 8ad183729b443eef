"""Simulated total station: sets in two faces of all targets, sent as GSI online over TCP.

Its true readings are those that the models of the package have for the points of a network, with
frame and refraction; index and collimation error, noise and faults are added. The same seed gives
the same lines. A `SimulatedObject` has the true places of the points at every time, and moves;
several total stations may observe one.
"""

from __future__ import annotations

import math
import selectors
import socket
import time as clock
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from threading import Event, RLock, Thread

import numpy as np

from ..errors import InputError, Problem, known
from ..io.field_books.accuracies import (
    DEFAULT_DIRECTION_MGON,
    DEFAULT_DISTANCE_MM,
    DEFAULT_ZENITH_MGON,
    Accuracies,
)
from ..network.network import Network
from ..observations import Direction, SlopeDistance, ZenithAngle
from ..simulation.measurement import measure
from ..types import Array
from ..units import ANGLE, LENGTH
from .simulated_faults import FAULTS, MOVES, Fault, fault

DAY_S = 86400.0
PILLAR_ACCURACIES = Accuracies(
    sigma_direction_mgon=0.3, sigma_zenith_mgon=0.3, sigma_distance_mm=0.6, ppm=1.0, centring_mm=0.0
)
"""Accuracies of a monitoring total station on a pillar, with forced centring."""
INDEX_SIGMA, COLLIMATION_SIGMA = 1.0 * ANGLE["mgon"], 1.0 * ANGLE["mgon"]
"""Standard deviations of the errors of a simulated instrument, constant during its life."""
GSI_SIZES = (8, 16)


class SimulatedObject:
    """Points with true places at every time."""

    def __init__(self, network: Network) -> None:
        """Start with the given places of a network as true ones."""
        self.network = network
        self.moves: list[Fault] = []
        self._lock = RLock()

    def move(self, of: Fault) -> None:
        """Let a point move as a fault ``displacement`` or ``creep`` says, from its begin on."""
        with self._lock:
            self.moves.append(of)

    def displacements(self, time: float) -> dict[str, Array]:
        """Return the displacements of the points that have moved, (3,) metres in the frame.

        Args:
            time: seconds since 1970 UTC.
        """
        out: dict[str, Array] = {}
        with self._lock:
            for m in self.moves:
                if m.begin <= time:
                    size = (time - m.begin) / DAY_S if m.word == "creep" else 1.0
                    by = size * np.array([m.values[name] for name in MOVES])
                    out[m.values["point"]] = out.get(m.values["point"], np.zeros(3)) + by
        return out

    def truth(self, time: float) -> dict[str, Array]:
        """Return the true places of all points, (3,) metres in the frame.

        Args:
            time: seconds since 1970 UTC.
        """
        moved = self.displacements(time)
        return {
            name: np.array(p.coordinates) + moved.get(name, 0.0)
            for name, p in self.network.points.items()
        }

    def readings(
        self, station: str, targets: tuple[str, ...], time: float, refraction: float = 0.0
    ) -> dict[str, tuple[float, float, float]]:
        """Return true direction and zenith angle (radians) and slope distance (metres) by target.

        Args:
            station: name of the point of the instrument.
            targets: names of the targets.
            time: when they are read, seconds since 1970 UTC.
            refraction: what is added to the coefficient of refraction of the network.
        """
        given, plan = self.network, Network(self.network.name, frame=self.network.frame)
        for name, xyz in self.truth(time).items():
            if name == station or name in targets:
                plan.add_point(name, xyz.tolist())
        stated = given.parameters.get("refraction", {})
        value = next(iter(stated.values())).values[0] if stated else 0.0
        if stated or refraction:
            plan.set_refraction(value=value + refraction, fixed=True)
        for t in targets:
            plan.add(
                Direction(station, t, 0.0, sigma=1e-6, set="1"),
                ZenithAngle(station, t, 1.0, sigma=1e-6),
                SlopeDistance(station, t, 1.0, sigma=1e-3),
            )
        true = measure(plan, seed=0, noise=False)
        values = [float(vars(o)["value"]) for o in true.observations.values()]
        return {
            t: (values[3 * i], values[3 * i + 1], values[3 * i + 2]) for i, t in enumerate(targets)
        }


def _distance_sigmas(constant: float, growing: float) -> tuple[float, float]:
    """Return σ of what is of one face in a distance, and of what both faces share.

    A reading has σ = a + b, with the constant a and the growing part b; the mean of two faces has
    a/√2 + b, as b is shared (`factorgraph_adj.reduce_faces`). Both follow from
    own² = 2 (a + b)² − 2 (a/√2 + b)² and shared² = (a + b)² − own².
    """
    single, mean = (constant + growing) ** 2, (constant / math.sqrt(2.0) + growing) ** 2
    own = 2.0 * (single - mean)
    return math.sqrt(own), math.sqrt(max(single - own, 0.0))


@dataclass(frozen=True)
class SimulatedLine:
    """A line, and when it was measured."""

    time: float
    """Simulated time, seconds since 1970 UTC."""
    text: bytes
    """Its bytes, without the end of the line."""


@dataclass
class SimulatedTotalStation:
    """A total station on a point of an object, which measures a set in two faces each ``interval``.

    Face 1 aims at the targets in their order, face 2 in reverse; the object stands still during a
    set, so that truth is that of its begin.

    Raises:
        InputError: all problems: unknown points, names that GSI cannot have, a set that takes
            longer than the interval.
    """

    of: SimulatedObject
    """What it observes."""
    station: str
    """Its point."""
    targets: tuple[str, ...]
    """Its targets, in the order of a set."""
    name: str = "ts1"
    """Name of the instrument."""
    seed: int = 0
    """Seed of the noise; instruments of other names have other noise."""
    accuracies: Accuracies = PILLAR_ACCURACIES
    """Noise of readings; ``None`` of a field is its default."""
    begin: float = 0.0
    """Simulated time of its first sight, seconds since 1970 UTC."""
    interval: float = 600.0
    """Seconds from the begin of a set to that of the next one."""
    sight_time: float = 8.0
    """Seconds from sight to sight."""
    gsi_size: int = 16
    """Characters of a word: 8 or 16."""
    faults: list[Fault] = field(default_factory=list)
    """Faults that were switched on, over or not."""
    now: float = 0.0
    """Simulated time of the last sight."""

    def __post_init__(self) -> None:
        """Check names, and draw the errors of the instrument."""
        points = self.of.network.points
        problems = [
            Problem(f"there is no point {n!r}; known: {known(points, meant=n)}")
            for n in (self.station, *self.targets)
            if n not in points
        ]
        for n in (self.station, *self.targets):
            if len(n) > self.gsi_size or n.startswith("0") or not n.isascii() or " " in n:
                what = f"GSI-{self.gsi_size} cannot have the name: at most {self.gsi_size} ASCII "
                problems.append(Problem(f"{what}characters, no blank, no zero at its begin", n))
        if self.gsi_size not in GSI_SIZES:
            problems.append(Problem(f"words of GSI have 8 or 16 characters, not {self.gsi_size}"))
        busy = 2 * len(self.targets) * self.sight_time
        if self.station in self.targets or not self.targets:
            problems.append(Problem("an instrument needs targets, and is none of them"))
        if busy > self.interval:
            what = f"a set takes {busy:.0f} s, more than the {self.interval:.0f} s from set to set"
            problems.append(Problem(what))
        if problems:
            raise InputError(problems)
        self._lock = RLock()
        self._random = np.random.default_rng([self.seed, *self.name.encode()])
        self.index, self.collimation = self._random.normal(
            0.0, (INDEX_SIGMA, COLLIMATION_SIGMA)
        ).tolist()
        self._block = 0
        self._of_set: dict[str, float] = {}
        """What both distances of a target in a set share, in its standard deviations."""
        self._true: tuple[object, dict[str, tuple[float, float, float]]] = (None, {})
        self.now = self.begin

    def switch_on(self, word: str, **fields: object) -> Fault:
        """Switch a fault on, see `factorgraph_adj.instruments.simulated_faults.FAULTS`.

        Raises:
            InputError: all problems.
        """
        found = fault(
            word,
            fields,
            now=self.now,
            begin=self.begin,
            targets=self.targets,
            points=tuple(self.of.network.points),
        )
        if FAULTS[word].moves:
            self.of.move(found)
        else:
            with self._lock:
                self.faults.append(found)
        return found

    # -- lines ------------------------------------------------------------------------------------

    def lines(self) -> Iterator[SimulatedLine]:
        """Yield the lines of set after set, without an end, in simulated time."""
        number = 0
        while True:
            start = self.begin + number * self.interval
            number += 1
            drawn = self._random.standard_normal(len(self.targets))
            self._of_set = dict(zip(self.targets, drawn.tolist(), strict=True))
            order = [(t, 1) for t in self.targets] + [(t, 2) for t in reversed(self.targets)]
            for i, (target, face) in enumerate(order):
                time = start + i * self.sight_time
                self.now = time
                if self._on("gap", time) is None:
                    yield from self._sight(target, face, time, start)

    def _on(self, word: str, time: float) -> Fault | None:
        """Return a fault of a word that lasts at a time."""
        with self._lock:
            return next((f for f in self.faults if f.word == word and f.is_on(time)), None)

    def _next(self, word: str, time: float, target: str | None = None) -> Fault | None:
        """Return a fault that concerns the next sight or line, and count that."""
        with self._lock:
            for f in self.faults:
                of = f.values.get("target")
                if f.word == word and f.left > 0 and f.begin <= time and of in (None, target):
                    f.left -= 1
                    return f
        return None

    def _true_readings(self, start: float, time: float) -> dict[str, tuple[float, float, float]]:
        """Return the true readings of all targets; the object stands still during a set."""
        extra = self._on("refraction", time)
        refraction = 0.0 if extra is None else float(extra.values["size"])
        moved = {n: tuple(d) for n, d in self.of.displacements(start).items()}
        if self._true[0] != (refraction, moved):
            found = self.of.readings(self.station, self.targets, start, refraction)
            self._true = ((refraction, moved), found)
        return self._true[1]

    def _sight(self, target: str, face: int, time: float, start: float) -> Iterator[SimulatedLine]:
        wrong = self._next("wrong-target", time, target)
        read = target if wrong is None else str(wrong.values["read"])
        hz, z, s = self._true_readings(start, time)[read]
        a, noise = self.accuracies, self._random.standard_normal(3)
        own, shared = _distance_sigmas(
            (a.sigma_distance_mm or DEFAULT_DISTANCE_MM) * LENGTH["mm"], 1e-6 * a.ppm * s
        )
        constant = (
            (a.sigma_direction_mgon or DEFAULT_DIRECTION_MGON) * ANGLE["mgon"],
            (a.sigma_zenith_mgon or DEFAULT_ZENITH_MGON) * ANGLE["mgon"],
            own,
        )
        second = face == 2
        values = {
            "direction": hz + (self.collimation if second else -self.collimation) / math.sin(z)
            + math.pi * second,
            "zenith": (2 * math.pi - z if second else z) + self.index,
            "distance": s + shared * self._of_set[target],
        }  # fmt: skip
        for (name, value), sigma, n in zip(values.items(), constant, noise, strict=True):
            values[name] = value + sigma * float(n)
        gross = self._next("gross-error", time, target)
        if gross is not None:
            unit = "size_mm" if gross.values["reading"] == "distance" else "size_mgon"
            values[gross.values["reading"]] += gross.values[unit]
        line = SimulatedLine(time, self._text(target, values, self._stamp(time)))
        if self._next("garbage", time) is not None:
            at = self._random.integers(0, len(line.text), 3)
            damaged = bytearray(line.text)
            for i in at:
                damaged[i] = int(self._random.integers(128, 256))
            line = replace(line, text=bytes(damaged))
        yield line
        if self._next("doubled", time) is not None:
            yield line

    def _stamp(self, time: float) -> float:
        """Return what the clock of the instrument shows."""
        with self._lock:
            jumps = [f for f in self.faults if f.word == "clock-jump" and f.begin <= time]
        return time + sum(float(f.values["jump"]) for f in jumps)

    def _text(self, target: str, values: Mapping[str, float], stamp: float) -> bytes:
        """Return a block of GSI."""
        self._block = self._block % 9999 + 1
        at = datetime.fromtimestamp(round(stamp, 3), UTC)
        milli = at.microsecond // 1000
        gon = ANGLE["gon"]
        hz = round(values["direction"] % (2 * math.pi) / gon * 1e5) % 40_000_000
        unit, parts = ("8", 1e5) if self.gsi_size == 16 else ("6", 1e4)
        words = [
            (f"11{self._block:04d}", target),
            ("18....", f"{at:%y%S}{milli:03d}0"),
            ("19....", f"{at:%m%d%H%M}"),
            ("21.322", f"{hz}"),
            ("22.322", f"{round(values['zenith'] / gon * 1e5)}"),
            (f"31..0{unit}", f"{round(values['distance'] * parts)}"),
            ("51....", "0" * (self.gsi_size - 4) + "+000"),
            ("87..10", "0"),
        ]
        star = "*" if self.gsi_size == 16 else ""
        texts = (f"{i}+{v.rjust(self.gsi_size, '0')}" for i, v in words)
        return (star + " ".join(texts) + " ").encode()

    # -- a port -----------------------------------------------------------------------------------

    @contextmanager
    def serve(
        self, port: int = 0, *, host: str = "127.0.0.1", speed: float = 1.0, sets: int | None = None
    ) -> Iterator[TotalStationServer]:
        """Send the lines to everybody who connects, in a thread, until the context ends.

        The simulated clock starts with the first connection.

        Args:
            port: TCP port; 0: a free one.
            host: address.
            speed: simulated seconds in a second.
            sets: number of sets after which nothing more is measured; None: no end.
        """
        server = TotalStationServer(self, host, port, speed, sets)
        server.start()
        try:
            yield server
        finally:
            server.stop()


class TotalStationServer:
    """TCP port of a simulated total station."""

    def __init__(
        self, of: SimulatedTotalStation, host: str, port: int, speed: float, sets: int | None
    ) -> None:
        """Listen, without measuring yet."""
        self.of, self.speed, self.sets = of, speed, sets
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            raise InputError(f"cannot listen on {host}:{port}: {error.strerror}") from None
        self.port: int = self._socket.getsockname()[1]
        self.sent: list[SimulatedLine] = []
        """Lines that were sent to somebody."""
        self.finished = Event()
        """Whether all ``sets`` were measured and sent."""
        self._stop, self._clients = Event(), list[socket.socket]()
        self._waiting: list[SimulatedLine] = []
        self._thread = Thread(target=self._run, daemon=True, name=f"simulated {of.name}")

    def start(self) -> None:
        """Begin to listen in a thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and all connections."""
        self._stop.set()
        self._thread.join()

    def drop_connections(self) -> None:
        """Close all connections; clients connect again."""
        for client in self._clients:
            with suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def _run(self) -> None:
        with self._socket, selectors.DefaultSelector() as selector:
            self._socket.setblocking(False)
            selector.register(self._socket, selectors.EVENT_READ)
            while not self._clients and not self._stop.is_set():
                self._accept(selector, 0.1)
            begun, last = clock.monotonic(), math.inf
            if self.sets is not None:
                last = self.of.begin + self.sets * self.of.interval
            for line in self.of.lines():
                if line.time >= last:
                    break
                due = begun + (line.time - self.of.begin) / self.speed
                while (left := due - clock.monotonic()) > 0 and not self._stop.is_set():
                    self._accept(selector, min(left, 0.1))
                if self._stop.is_set():
                    break
                self._accept(selector, 0.0)
                self._send(line)
            while self._waiting and not self._stop.is_set():
                self._accept(selector, 0.1)
                self._flush()
            self.finished.set()
            self._stop.wait()
            for client in self._clients:
                client.close()

    def _accept(self, selector: selectors.BaseSelector, seconds: float) -> None:
        if self._out():
            self._stop.wait(seconds)
            return
        if selector.select(seconds):
            with suppress(OSError):
                client, _ = self._socket.accept()
                client.settimeout(5.0)
                self._clients.append(client)

    def _out(self) -> bool:
        """Return whether the connection is out."""
        return self.of._on("outage", self.of.now) is not None

    def _send(self, line: SimulatedLine) -> None:
        self._waiting.append(line)
        if self._out():
            for client in self._clients:
                client.close()
            self._clients.clear()
        else:
            self._flush()

    def _flush(self) -> None:
        """Send what waits to everybody; without anybody it waits on."""
        while self._waiting and self._clients:
            line = self._waiting[0]
            for client in list(self._clients):
                try:
                    client.sendall(line.text + b"\r\n")
                except OSError:
                    client.close()
                    self._clients.remove(client)
            if self._clients:
                self.sent.append(self._waiting.pop(0))
