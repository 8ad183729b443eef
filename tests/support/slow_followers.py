"""A follower of server-sent events that reads nothing until it is asked to."""

from __future__ import annotations

import socket

RECEIVE_BYTES = 4096
"""Buffer of what has come and was not read."""


class SlowFollower:
    """A connection to ``/api/v1/events`` of a site without tokens on this machine."""

    def __init__(self, port: int, *, after: int = 0) -> None:
        """Ask for events, and read nothing.

        Args:
            port: port of the site.
            after: number of the last event that is known.
        """
        self._socket = socket.socket()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        self._socket.connect(("127.0.0.1", port))
        lines = [f"GET /api/v1/events?after={after} HTTP/1.1", "Host: 127.0.0.1", "", ""]
        self._socket.sendall("\r\n".join(lines).encode())
        self._rest = b""
        self.numbers: list[int] = []
        """Numbers of the events that were read."""
        self.lost = 0
        """How often the site said that events were missed."""

    def read(self, until: int, seconds: float) -> None:
        """Read until an event came.

        Args:
            until: its number.
            seconds: time after which reading ends without it, between two pieces.

        Raises:
            TimeoutError: nothing came for so long.
        """
        self._socket.settimeout(seconds)
        while not self.numbers or self.numbers[-1] < until:
            piece = self._socket.recv(1 << 20)
            if not piece:
                raise ConnectionError("the site has closed the connection")
            *lines, self._rest = (self._rest + piece).split(b"\n")
            self.numbers += [int(line[4:]) for line in lines if line.startswith(b"id: ")]
            self.lost += lines.count(b"event: hello")

    def close(self) -> None:
        """End the connection."""
        self._socket.close()
