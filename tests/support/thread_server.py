"""An ASGI application on a port of this machine, served by a thread of the test."""

from __future__ import annotations

import socket
import threading
from abc import ABC, abstractmethod
from time import sleep
from typing import Any


class ThreadServer(ABC):
    """A server in a thread; it can be stopped and started again on the same port."""

    def __init__(self, port: int = 0) -> None:
        """Start to serve.

        Args:
            port: port; 0: a free one.
        """
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            self.port = probe.getsockname()[1]
        self.start()

    @abstractmethod
    def application(self) -> Any:
        """Return the application, when it is started."""

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://127.0.0.1:{self.port}/"

    def start(self) -> None:
        """Serve, and return when requests are answered."""
        import uvicorn

        config = uvicorn.Config(
            self.application(),
            host="127.0.0.1",
            port=self.port,
            log_level="critical",
            ws="none",
            timeout_graceful_shutdown=0,
        )
        self.server = uvicorn.Server(config)
        self.thread = threading.Thread(target=self.server.run, daemon=True)
        self.thread.start()
        while not self.server.started:
            assert self.thread.is_alive(), "the server did not start"
            sleep(0.01)

    def stop(self) -> None:
        """End all connections and the server."""
        self.server.should_exit = True
        self.thread.join()
