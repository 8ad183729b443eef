"""Sources of lines: files that grow, TCP connections, serial ports.

A source is an iterator that yields a `ReceivedLine`, or None about every `POLL_S` seconds in
which nothing came, until its stop event is set; it says the state of its connection in a `Health`.
Lines end with CR, LF or both; blank ones are passed over. A line of more than `MAX_LINE_BYTES`, and
a line that the end of a connection cuts, is refused. `SOURCES` has the schemes of ``source`` in
[[instrument]].
"""

from __future__ import annotations

import re
import selectors
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from threading import Event
from typing import Any, ClassVar, Protocol
from urllib.parse import parse_qsl, urlsplit

from ..errors import InputError, known, similar, system_reason
from .health import Health
from .readings import ReceivedLine

POLL_S = 0.2
"""Seconds after which a source that has nothing looks again, or yields None."""
MAX_LINE_BYTES = 4096
"""Largest length of a line, bytes: the longest GSI-16 block has less than 1000."""
CONNECT_TIMEOUT_S = 5.0
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 60.0
"""Seconds before a connection is tried again: the first, doubled each time, and the longest."""
CHUNK_BYTES = 65536
_END = re.compile(rb"[\r\n]")


class LineSource(Protocol):
    """Where the lines of an instrument come from.

    One that has ``keeps_lines = True`` keeps those after the last that was asked for, also when the
    program ends.
    """

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield lines, or None where nothing came, until ``stop`` is set."""


class LineSplitter:
    """Bytes as they come, cut into lines."""

    def __init__(self, health: Health) -> None:
        """Start with nothing."""
        self.health = health
        self.rest = b""
        self._skipping = False

    def lines(self, chunk: bytes) -> Iterator[bytes]:
        """Yield the lines that a chunk completes, without blank ones."""
        *whole, self.rest = _END.split(self.rest + chunk)
        for line in whole:
            if self._skipping:
                self._skipping = False
            elif len(line) > MAX_LINE_BYTES:
                self._too_long(line)
            elif line.strip(b" \t\0"):
                yield line
        if len(self.rest) > MAX_LINE_BYTES:
            if not self._skipping:
                self._too_long(self.rest)
            self.rest, self._skipping = b"", True

    def cut(self) -> None:
        """Refuse what has come of a line that does not go on."""
        if self.rest.strip(b" \t\0") and not self._skipping:
            what = f"the connection ended inside the line {shown(self.rest)}"
            self.health.tell("refused", what, time.time())
        self.rest, self._skipping = b"", False

    def _too_long(self, line: bytes) -> None:
        what = f"a line has more than {MAX_LINE_BYTES} bytes: {shown(line)}"
        self.health.tell("refused", what, time.time())


def shown(line: bytes) -> str:
    """Return a line for a message, at most 60 characters of it."""
    text = line[:60].decode("ascii", errors="backslashreplace")
    return repr(text) + " …" * (len(line) > 60)


@dataclass
class FileSource:
    """A file that another program appends to.

    Where it is rotated or truncated, it is read from its beginning, which `Health` counts.

    Every start reads the file from its beginning: requests of postings make that a line is
    observed once. A file that is not there yet is waited for.
    """

    keeps_lines: ClassVar[bool] = True
    path: Path
    """The file."""
    follow: bool = True
    """Whether to wait for more at its end."""

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield the lines; the last one without an end counts when its end comes."""
        splitter, number = LineSplitter(health), 0
        stream, at = None, (0, 0)
        try:
            while not stop.is_set():
                try:
                    status = self.path.stat()
                except OSError as error:
                    if stream is None:
                        health.set_state("connecting")
                        health.trouble(f"{self.path.name}: {system_reason(error)}", time.time())
                        if not self.follow:
                            return
                    yield None
                    stop.wait(POLL_S)
                    continue
                if stream is not None and (status.st_dev, status.st_ino) != at:
                    for text in self._read(stream, splitter):  # what was written before
                        number += 1
                        yield self._line(text, number)
                    self._begin_again("another file has its name now", splitter, health)
                    stream.close()
                    stream, number = None, 0
                if stream is not None and status.st_size < stream.tell():
                    self._begin_again("it is shorter than it was", splitter, health)
                    stream.seek(0)
                    number = 0
                if stream is None:
                    stream, at = self.path.open("rb"), (status.st_dev, status.st_ino)
                    health.set_state("receiving")
                    health.count("connections")
                before = number
                for text in self._read(stream, splitter):
                    number += 1
                    yield self._line(text, number)
                if number == before:
                    if not self.follow:
                        if splitter.rest:  # the last line of a whole file may lack its end
                            yield from (
                                self._line(text, number + 1) for text in splitter.lines(b"\n")
                            )
                        return
                    yield None
                    stop.wait(POLL_S)
        finally:
            if stream is not None:
                stream.close()

    def _read(self, stream: Any, splitter: LineSplitter) -> Iterator[bytes]:
        while chunk := stream.read(CHUNK_BYTES):
            yield from splitter.lines(chunk)

    def _line(self, text: bytes, number: int) -> ReceivedLine:
        return ReceivedLine(text, time.time(), number, place=f"line {number}")

    def _begin_again(self, why: str, splitter: LineSplitter, health: Health) -> None:
        splitter.cut()
        what = f"{self.path.name} is read from its beginning: {why}"
        health.tell("restarts_of_file", what, time.time(), problem=False)


class _Delays:
    """Growing seconds between attempts."""

    def __init__(self, first: float, longest: float) -> None:
        self.first, self.longest, self.next = first, longest, first

    def wait(self, stop: Event) -> Iterator[None]:
        """Wait, and yield None about every `POLL_S` seconds."""
        until, self.next = time.monotonic() + self.next, min(2 * self.next, self.longest)
        while not stop.is_set() and (left := until - time.monotonic()) > 0:
            stop.wait(min(left, POLL_S))
            yield None

    def reset(self) -> None:
        """Begin with the first delay again."""
        self.next = self.first


@dataclass
class TcpSource:
    """A TCP port that an instrument or a converter of a serial port opens; it is connected to."""

    host: str
    """Name or address of the other end."""
    port: int
    """Its TCP port."""
    first_delay: float = FIRST_DELAY_S
    """Seconds before the second attempt to connect; later ones wait twice as long each."""
    longest_delay: float = LONGEST_DELAY_S
    """Longest time between two attempts, seconds."""

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield the lines; a connection that ends or fails is made again."""
        delays, number = _Delays(self.first_delay, self.longest_delay), 0
        while not stop.is_set():
            health.set_state("connecting")
            try:
                connection = socket.create_connection((self.host, self.port), CONNECT_TIMEOUT_S)
            except OSError as error:
                what = f"no connection to {self.host}:{self.port}: {system_reason(error)}"
                health.trouble(what, time.time())
                yield from delays.wait(stop)
                continue
            health.set_state("receiving")
            health.count("connections")
            with connection:
                keep_alive(connection)
                for found in _of_connection(connection, stop, health):
                    if found is None:
                        yield None
                    else:
                        delays.reset()
                        number += 1
                        yield ReceivedLine(found, time.time(), number)
            if not stop.is_set():
                yield from delays.wait(stop)


def keep_alive(connection: socket.socket) -> None:
    """Let the system find out within two minutes that the other end is gone."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 60), ("TCP_KEEPINTVL", 15), ("TCP_KEEPCNT", 4)):
        if hasattr(socket, name):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _of_connection(
    connection: socket.socket, stop: Event, health: Health
) -> Iterator[bytes | None]:
    """Yield the lines of a connection until it ends."""
    splitter = LineSplitter(health)
    connection.settimeout(POLL_S)
    while not stop.is_set():
        try:
            chunk = connection.recv(CHUNK_BYTES)
        except TimeoutError:
            yield None
            continue
        except OSError as error:
            health.trouble(f"the connection failed: {system_reason(error)}", time.time())
            break
        if not chunk:
            health.trouble("the instrument closed the connection", time.time())
            break
        yield from splitter.lines(chunk)
    splitter.cut()


@dataclass
class TcpServerSource:
    """A TCP port to which instruments connect, several at a time."""

    host: str
    """Address of this machine on which it listens."""
    port: int
    """TCP port; 0: a free one, see ``bound``."""
    bound: int = 0
    """The port that listens; 0 before."""

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield the lines of all connections."""
        delays, number = _Delays(FIRST_DELAY_S, LONGEST_DELAY_S), 0
        while not stop.is_set():
            health.set_state("connecting")
            try:
                server = socket.create_server((self.host, self.port))
            except OSError as error:
                what = f"cannot listen on {self.host}:{self.port}: {system_reason(error)}"
                health.trouble(what, time.time())
                yield from delays.wait(stop)
                continue
            self.bound = server.getsockname()[1]
            with server, selectors.DefaultSelector() as selector:
                server.setblocking(False)
                selector.register(server, selectors.EVENT_READ)
                open_connections: dict[socket.socket, LineSplitter] = {}
                try:
                    while not stop.is_set():
                        ready = selector.select(POLL_S)
                        if not ready:
                            yield None
                        for key, _ in ready:
                            at = key.fileobj
                            assert isinstance(at, socket.socket)
                            if at is server:
                                self._accept(server, selector, open_connections, health)
                                continue
                            for text in self._take(at, selector, open_connections, health):
                                number += 1
                                yield ReceivedLine(text, time.time(), number)
                finally:
                    for connection in open_connections:
                        connection.close()

    def _accept(
        self,
        server: socket.socket,
        selector: selectors.BaseSelector,
        all_open: dict[socket.socket, LineSplitter],
        health: Health,
    ) -> None:
        with suppress(OSError):
            connection, _ = server.accept()
            connection.setblocking(False)
            keep_alive(connection)
            selector.register(connection, selectors.EVENT_READ)
            all_open[connection] = LineSplitter(health)
            health.count("connections")
            health.set_state("receiving")

    def _take(
        self,
        connection: socket.socket,
        selector: selectors.BaseSelector,
        all_open: dict[socket.socket, LineSplitter],
        health: Health,
    ) -> Iterator[bytes]:
        chunk = b""
        try:
            chunk = connection.recv(CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            health.trouble(f"a connection failed: {system_reason(error)}", time.time())
        if chunk:
            yield from all_open[connection].lines(chunk)
            return
        all_open.pop(connection).cut()
        selector.unregister(connection)
        connection.close()
        if not all_open:
            health.trouble("the instrument closed the connection", time.time())
            health.set_state("connecting")


@dataclass
class SerialSource:
    """A serial port; a port that disappears (a cable is pulled) is opened again."""

    port: str
    """Device, or a URL of pyserial."""
    baud: int = 9600
    """Bits per second."""
    bits: int = 8
    """Data bits of a character: 7 or 8."""
    parity: str = "N"
    """N none, E even, O odd."""
    stop_bits: float = 1
    """Stop bits of a character: 1, 1.5 or 2."""

    def lines(self, stop: Event, health: Health) -> Iterator[ReceivedLine | None]:
        """Yield the lines.

        Raises:
            InputError: the extra is not installed.
        """
        try:
            import serial
        except ImportError:
            raise InputError(
                'serial ports need pyserial: pip install "factorgraph_adj[instruments]"'
            ) from None
        delays, number = _Delays(FIRST_DELAY_S, LONGEST_DELAY_S), 0
        while not stop.is_set():
            health.set_state("connecting")
            splitter = LineSplitter(health)
            try:
                port = serial.serial_for_url(
                    self.port, self.baud, self.bits, self.parity, self.stop_bits, timeout=POLL_S
                )
                with port:
                    health.set_state("receiving")
                    health.count("connections")
                    while not stop.is_set():
                        chunk = port.read(port.in_waiting or 1)
                        if not chunk:
                            yield None
                        for text in splitter.lines(chunk):
                            delays.reset()
                            number += 1
                            yield ReceivedLine(text, time.time(), number)
            except (serial.SerialException, OSError) as error:
                health.trouble(f"{self.port}: {error}", time.time())
            splitter.cut()
            yield from delays.wait(stop)


# -- source = "…" ---------------------------------------------------------------------------------


def _file(rest: str, folder: Path) -> FileSource:
    if not rest:
        raise InputError("the name of the file is missing: file:PATH")
    return FileSource(folder / rest)


def _address(rest: str) -> tuple[str, int]:
    parts = urlsplit(f"tcp:{rest}")
    try:
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or port is None or parts.path or parts.query:
        raise InputError(
            f"{rest!r} is no address; valid: tcp://HOST:PORT, such as tcp://10.0.0.5:4001"
        )
    return host, port


def _serial(rest: str, folder: Path) -> SerialSource:
    name, _, query = rest.partition("?")
    given, valid = dict(parse_qsl(query)), ("baud", "bits", "parity", "stop_bits")
    problems = [] if name else ["the device is missing: serial:/dev/ttyUSB0?baud=19200"]
    for key in given:
        if key not in valid:
            problems.append(f"unknown setting {key!r}; valid: {known(valid, meant=key)}")
    numbers: dict[str, tuple[float, ...]] = {
        "baud": (*(300 * 2**i for i in range(8)), 57600, 115200, 230400),
        "bits": (7, 8),
        "stop_bits": (1, 1.5, 2),
    }
    out: dict[str, Any] = {}
    for key, allowed in numbers.items():
        text = given.get(key, "")
        if text and text not in (words := [f"{a:g}" if a < 1e5 else str(a) for a in allowed]):
            problems.append(f"{key} must be one of {', '.join(words)}, not {text!r}")
        elif text:
            out[key] = float(text) if key == "stop_bits" else int(text)
    if "parity" in given and given["parity"] not in ("N", "E", "O"):
        problems.append(f"parity must be N, E or O, not {given['parity']!r}")
    elif "parity" in given:
        out["parity"] = given["parity"]
    if problems:
        raise InputError("; ".join(problems))
    return SerialSource(name, **out)


SOURCES: dict[str, Callable[[str, Path], LineSource] | tuple[str, str]] = {
    "file": _file,
    "tcp": lambda rest, folder: TcpSource(*_address(rest)),
    "tcp-listen": lambda rest, folder: TcpServerSource(*_address(rest)),
    "serial": _serial,
    "mqtt": ("mqtt", "mqtt_source"),
    "mqtts": ("mqtt", "mqtts_source"),
    "rosbag": ("ros_bags", "rosbag_source"),
}
"""Sources by scheme: what makes one of the text after the colon and the folder of the site file,
or the module beside this one and its function that does."""


SOURCE_FORMS = {
    "tcp": "tcp://HOST:PORT",
    "tcp-listen": "tcp-listen://HOST:PORT",
    "serial": "serial:DEVICE?baud=9600",
    "file": "file:NAME",
    "mqtt": "mqtt://HOST/TOPIC",
    "mqtts": "mqtts://HOST/TOPIC",
    "rosbag": "rosbag:NAME",
}
"""Forms of the sources, by scheme, for messages."""
_PLAIN_ADDRESS = re.compile(r"[\w.-]+:[0-9]+|\[[0-9a-fA-F:]+\]:[0-9]+")


def line_source(text: str, folder: Path = Path()) -> LineSource:
    """Return the source of ``source = "…"``.

    Args:
        text: scheme, colon, and the rest: ``tcp://host:port``, ``file:readings.gsi``.
        folder: folder of the site file, to which names of files are relative.

    Raises:
        InputError: the scheme is unknown, or the rest is wrong.
    """
    scheme, colon, rest = text.partition(":")
    if not colon or scheme not in SOURCES:
        plain = f"tcp://{text}" if _PLAIN_ADDRESS.fullmatch(text) else ""
        plain = plain or (f"file:{text}" if (folder / text).is_file() else "")
        meant = f"; did you mean {plain!r}?" if plain else similar(scheme, SOURCES) * bool(colon)
        forms = known(SOURCE_FORMS.values())
        raise InputError(f"unknown source {text!r}; valid: {forms}{meant}")
    make = SOURCES[scheme]
    if isinstance(make, tuple):
        make = getattr(import_module(f".{make[0]}", __package__), make[1])
    assert callable(make)
    found: LineSource = make(rest, folder)
    return found
