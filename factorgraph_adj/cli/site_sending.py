"""Command ``send``: JSON lines of a file or of standard input become postings to a site."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from io import FileIO
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from ..errors import AdjustmentError, InputError, Problem, counted, system_reason
from .messages import EXIT_DOUBTFUL, EXIT_FINE, FURTHER_EXIT_CODES

if TYPE_CHECKING:
    from ..site.outbox import Outbox

TOKEN_VARIABLE = "FACTORGRAPH_ADJ_TOKEN"
"""Variable of the environment with the token, which a list of processes does not show."""
CHUNK = 1 << 16
"""Largest number of bytes that are read at once."""
MAX_IN_MEMORY = 1000
"""Number of postings without a file of an outbox beyond which reading waits for answers."""
WAIT_SECONDS = 0.02
"""How long it waits before it looks again, seconds."""


def add_send(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.epilog = (
        "exit codes: 0 everything was acknowledged; 1 some postings were refused, or, with "
        f"--outbox, wait there because the site is away; {FURTHER_EXIT_CODES}"
    )
    parser.add_argument("url", metavar="URL", help="address of the site, http://HOST:PORT/")
    parser.add_argument("network", metavar="NETWORK", help="name of the network")
    parser.add_argument(
        "file", metavar="FILE", nargs="?", default="-", help="JSON lines; - is standard input"
    )
    parser.add_argument(
        "--token-file",
        metavar="FILE",
        help=f"file with the token; without it, the variable {TOKEN_VARIABLE}",
    )
    parser.add_argument(
        "--outbox",
        metavar="FILE",
        help="keep every line in this file until the site has acknowledged it; what is left of an "
        "earlier run is sent first",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=120.0,
        metavar="SECONDS",
        help="how long the site may be away before the command gives up (%(default)g)",
    )
    parser.add_argument("--certificate", metavar="FILE", help="certificates to trust (PEM)")
    parser.add_argument("--quiet", action="store_true", help="print refused postings alone")
    parser.set_defaults(run=_send)


def _send(options: argparse.Namespace) -> int:
    from ..site.client import Client, ServiceAway
    from ..site.outbox import IN_MEMORY, Kept, Outbox

    acknowledged = refused = 0

    def told(kept: Kept, answer: dict[str, Any]) -> None:
        nonlocal acknowledged, refused
        acknowledged += 1
        refused += not answer["ok"]
        if not answer["ok"] or not options.quiet:
            print(json.dumps(answer, ensure_ascii=False), flush=True)

    with ExitStack() as stack:
        client = stack.enter_context(
            Client(
                options.url,
                token=_token(options.token_file),
                patience=options.patience,
                certificate=options.certificate,
            )
        )
        source = stack.enter_context(_source(options.file))
        outbox = Outbox(IN_MEMORY if options.outbox is None else options.outbox)
        stack.callback(outbox.close)
        lines = SentLines(source, options.file, outbox, options.network)
        stack.callback(lines.stop)
        lines.start()
        try:
            client.forward(outbox, lines.ended, answered=told)
            if lines.problem is not None:
                raise lines.problem
        except AdjustmentError as error:
            done = f"{counted(acknowledged, 'posting')} sent, {refused} refused"
            done = done if acknowledged else "nothing was acknowledged by the site"
            print(done, file=sys.stderr)
            if not isinstance(error, ServiceAway) or not outbox.on_disk:
                raise
            kept = counted(len(outbox), "posting")
            print(f"{error}; {kept} kept in {outbox.path}", file=sys.stderr)
            return EXIT_DOUBTFUL
    print(f"{counted(lines.number, 'line')} sent, {refused} refused", file=sys.stderr)
    return EXIT_DOUBTFUL if refused else EXIT_FINE


class SentLines(Thread):
    """Puts lines into an outbox as they come, while others are sent."""

    def __init__(self, source: FileIO, name: str, outbox: Outbox, network: str) -> None:
        """Take the lines; nothing is read yet."""
        super().__init__(name="lines", daemon=True)
        self._source, self._outbox, self._network = source, outbox, network
        self._place = "standard input" if name == "-" else name
        self._stopped = Event()
        self.number = 0
        """Number of postings so far."""
        self.problem: AdjustmentError | None = None
        """Why no more are read."""
        self.ended = Event()
        """Set when nothing more comes."""

    def stop(self) -> None:
        """Read no further."""
        self._stopped.set()

    def run(self) -> None:
        """Read until the end, or a line that cannot be sent; those before it are sent."""
        try:
            for records in filter(None, self._records()):
                self._outbox.put(self._network, *records)
                self.number += len(records)
                while not self._outbox.on_disk and len(self._outbox) > MAX_IN_MEMORY:
                    if self._stopped.wait(WAIT_SECONDS):
                        return
        except AdjustmentError as problem:
            self.problem = problem
        except (OSError, ValueError) as error:
            self.problem = InputError(Problem(str(error), self._place))
        finally:
            self.ended.set()
            self._outbox.wake()

    def _records(self) -> Iterator[list[dict[str, Any]]]:
        """Yield postings, those together that have come together."""
        number, begun = 0, []  # parts of a line whose end has not come
        while chunk := self._source.read(CHUNK):
            begun.append(chunk)
            if b"\n" in chunk:
                *lines, rest = b"".join(begun).split(b"\n")
                yield from self._parsed(lines, number)
                number, begun = number + len(lines), [rest]
        yield from self._parsed([b"".join(begun)], number)

    def _parsed(self, lines: list[bytes], before: int) -> Iterator[list[dict[str, Any]]]:
        """Yield the postings of lines; a faulty line is told after those before it."""
        out: list[dict[str, Any]] = []
        for number, line in enumerate(lines, before + 1):
            try:
                out += [_posting(line, f"{self._place}:{number}")] if line.strip() else []
            except InputError:
                yield out
                raise
        yield out


def _posting(line: bytes, where: str) -> dict[str, Any]:
    try:
        record = json.loads(line)
    except ValueError as error:
        raise InputError(Problem(f"is no JSON ({error})", where)) from None
    if not isinstance(record, dict):
        raise InputError(Problem('is no JSON object: {"kind": …} or {"do": …}', where))
    return record


def _source(name: str) -> FileIO:
    """Open a file, or standard input, whose reads return what is there."""
    if name == "-":
        return FileIO(os.dup(sys.stdin.fileno()))
    try:
        return FileIO(name)
    except OSError as error:
        raise InputError(Problem(system_reason(error), name)) from None


def _token(path: str | None) -> str | None:
    """Return the token of a file, or of the environment."""
    if path is None:
        return os.environ.get(TOKEN_VARIABLE) or None
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError as error:
        raise InputError(Problem(system_reason(error), path)) from None
