"""Sites served by ``factorgraph-adj serve`` as a process, which tests kill and start again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tests.support.places import ROOT
from tests.support.processes import HANGS


class SiteProcess:
    """A served site; it keeps its port when it is started again."""

    def __init__(self, folder: Path, *, port: int = 0, command: Sequence[str] = ()) -> None:
        """Take a site, which is not served yet.

        Args:
            folder: folder of the site.
            port: port; 0: a free one.
            command: what stands before the command, such as limits.
        """
        self.folder, self.port, self.command = folder, port, tuple(command)
        self.process: subprocess.Popen[str] | None = None
        self.log = folder / "service.log"

    @property
    def url(self) -> str:
        """Address, once it was served."""
        return f"http://127.0.0.1:{self.port}/"

    def begin(self) -> None:
        """Start the process, and do not wait for it."""
        arguments = ["serve", str(self.folder), "--no-browser", "--port", str(self.port)]
        # Without compiled modules every start would compile the package anew.
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        with self.log.open("a") as log:
            self.process = subprocess.Popen(
                [*self.command, sys.executable, "-m", "factorgraph_adj", *arguments],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if self.port == 0 else log,
                stderr=log,
                text=True,
            )

    def start(self) -> None:
        """Start the process, and wait until it answers."""
        self.begin()
        assert self.process is not None
        if self.process.stdout is not None:
            line = self.process.stdout.readline()
            assert ":" in line, self.log.read_text()
            self.port = int(line.rstrip("/\n").rpartition(":")[2])
        self.wait()

    def wait(self) -> None:
        """Wait until the site answers."""
        import httpx2

        until = time.monotonic() + HANGS
        with httpx2.Client(base_url=self.url, verify=False, timeout=10.0) as client:
            while time.monotonic() < until:
                running = self.process is not None and self.process.poll() is None
                assert running, self.log.read_text()
                try:
                    if client.get("api/v1/health").status_code == 200:
                        return
                except httpx2.TransportError:
                    time.sleep(0.05)
        raise AssertionError("the site does not answer")

    def kill(self) -> None:
        """Kill the process at once."""
        assert self.process is not None
        os.kill(self.process.pid, signal.SIGKILL)
        self._ended()

    def end(self) -> None:
        """Kill the process where it still runs."""
        if self.process is not None and self.process.poll() is None:
            self.kill()

    def stop(self) -> int:
        """Ask the process to end, and return its exit code."""
        assert self.process is not None
        self.process.terminate()
        return self._ended()

    def _ended(self) -> int:
        assert self.process is not None
        code = self.process.wait(HANGS)
        if self.process.stdout is not None:
            self.process.stdout.close()
        return code
