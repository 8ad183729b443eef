"""Sources: files that grow, rotate and shrink; ports that fail; what cuts a line."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from threading import Event, Thread

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments.health import Health
from factorgraph_adj.instruments.line_sources import (
    MAX_LINE_BYTES,
    FileSource,
    LineSplitter,
    SerialSource,
    TcpServerSource,
    TcpSource,
    line_source,
)


class Listening:
    """A source in a thread, and what it has yielded."""

    def __init__(self, source):
        self.source, self.health = source, Health("test")
        self.found, self.stop = [], Event()
        self.thread = Thread(target=self._run, daemon=True)

    def _run(self):
        for line in self.source.lines(self.stop, self.health):
            if line is not None:
                self.found.append(line)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.stop.set()
        self.thread.join(10)
        assert not self.thread.is_alive()

    def texts(self, number):
        """Wait for so many lines; return the texts of all."""
        end = time.monotonic() + 10
        while len(self.found) < number and time.monotonic() < end:
            time.sleep(0.01)
        return [line.text.decode() for line in self.found]

    def until(self, condition):
        end = time.monotonic() + 10
        while not condition() and time.monotonic() < end:
            time.sleep(0.01)
        assert condition()


def test_a_file_is_read_while_it_grows(tmp_path: Path):
    path = tmp_path / "a.gsi"
    with Listening(FileSource(path)) as of:
        of.until(lambda: of.health.state == "connecting")
        assert "no such file" in of.health.problem
        with path.open("w") as stream:
            for text in ("one\r\n", "two\n", "thr", "ee\r", "\n\n", "four\n"):
                stream.write(text)
                stream.flush()
                time.sleep(0.02)
        assert of.texts(4) == ["one", "two", "three", "four"]
        assert [line.place for line in of.found] == [f"line {i}" for i in range(1, 5)]
    assert of.health.counts["restarts_of_file"] == 0


def test_a_file_that_is_rotated_or_truncated_is_read_again(tmp_path: Path):
    path = tmp_path / "a.gsi"
    path.write_text("one\ntwo\n")
    with Listening(FileSource(path)) as of:
        assert of.texts(2) == ["one", "two"]
        with path.open("a") as stream:
            stream.write("three\n")
        path.rename(tmp_path / "a.1")
        path.write_text("four\n")
        assert of.texts(4) == ["one", "two", "three", "four"]
        path.write_text("5\n")
        assert of.texts(5)[4] == "5"
        said = [e.what for e in of.health.events]
    assert said == [
        "a.gsi is read from its beginning: another file has its name now",
        "a.gsi is read from its beginning: it is shorter than it was",
    ]


def test_a_whole_file_has_its_last_line_without_an_end(tmp_path: Path):
    path = tmp_path / "a.gsi"
    path.write_text("one\ntwo")
    source = FileSource(path, follow=False)
    assert [x.text for x in source.lines(Event(), Health("t")) if x] == [b"one", b"two"]


def test_a_connection_is_made_again_with_growing_delays():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    source = TcpSource("127.0.0.1", port, first_delay=0.05, longest_delay=0.2)
    with Listening(source) as of:
        of.until(lambda: of.health.problem != "")
        assert f"no connection to 127.0.0.1:{port}" in of.health.problem
        with socket.create_server(("127.0.0.1", port)) as server:
            for texts in ([b"a\r\nb", b"\r\nhalf"], [b"c\nd\n"]):
                client, _ = server.accept()
                for text in texts:
                    client.sendall(text)
                of.texts(2)
                client.close()
            assert of.texts(4) == ["a", "b", "c", "d"]
            of.until(lambda: "closed the connection" in of.health.problem)
    assert of.health.counts["connections"] >= 2
    assert of.health.counts["refused"] == 1
    assert "ended inside the line 'half'" in of.health.events[0].what


def test_several_instruments_connect_to_a_port_that_listens():
    source = TcpServerSource("127.0.0.1", 0)
    with Listening(source) as of:
        of.until(lambda: source.bound != 0)
        clients = [socket.create_connection(("127.0.0.1", source.bound)) for _ in range(2)]
        clients[0].sendall(b"a1\na")
        of.texts(1)
        clients[1].sendall(b"b1\n")
        of.texts(2)
        clients[0].sendall(b"2\n")
        assert of.texts(3) == ["a1", "b1", "a2"]
        for client in clients:
            client.close()
        of.until(lambda: of.health.state == "connecting")
    assert of.health.counts["connections"] == 2


def test_a_serial_port_is_read():
    """The loop of pyserial sends back what it is sent."""
    serial = pytest.importorskip("serial")
    ports = []

    def opened(url, *arguments, **options):
        ports.append(_open(url, *arguments, **options))
        return ports[-1]

    _open, serial.serial_for_url = serial.serial_for_url, opened
    try:
        with Listening(SerialSource("loop://", baud=19200)) as of:
            of.until(lambda: bool(ports))
            ports[0].write(b"one\r\ntw")
            of.texts(1)
            ports[0].write(b"o\r\n")
            assert of.texts(2) == ["one", "two"]
    finally:
        serial.serial_for_url = _open
    assert of.health.state == "receiving"


def test_a_serial_port_that_is_not_there_is_told(tmp_path):
    pytest.importorskip("serial")
    with Listening(SerialSource(str(tmp_path / "ttyX"))) as of:
        of.until(lambda: "ttyX" in of.health.problem)
        assert of.health.state == "connecting"


def test_a_line_that_is_too_long_is_refused_and_the_next_one_read():
    health = Health("t")
    splitter = LineSplitter(health)
    found = []
    for chunk in (b"a\n" + b"x" * MAX_LINE_BYTES, b"yyyy", b"z" * 3 * MAX_LINE_BYTES, b"\nb\n"):
        found += splitter.lines(chunk)
    assert found == [b"a", b"b"]
    assert health.counts["refused"] == 1
    assert len(splitter.rest) == 0


@pytest.mark.parametrize(
    "text, why",
    [
        ("tcp://host", "no address"),
        ("tcp://host:99999", "no address"),
        ("file:", "name of the file"),
        ("serial:?baud=9600", "device is missing"),
        ("serial:/dev/x?baud=9601&parity=X&speed=1", "baud must be.*|parity must"),
        ("http://x", "unknown source"),
        ("tcp", "unknown source"),
    ],
)
def test_wrong_sources_are_refused(text, why):
    with pytest.raises(InputError, match=why):
        line_source(text)


def test_sources_are_made_of_their_texts(tmp_path: Path):
    assert line_source("tcp://10.0.0.5:4001") == TcpSource("10.0.0.5", 4001)
    assert line_source("tcp://[::1]:4001") == TcpSource("::1", 4001)
    assert line_source("file:a.gsi", tmp_path) == FileSource(tmp_path / "a.gsi")
    assert line_source("serial:/dev/ttyUSB0?baud=19200&parity=E&bits=7") == SerialSource(
        "/dev/ttyUSB0", baud=19200, parity="E", bits=7
    )
