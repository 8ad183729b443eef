"""Command ``send``: JSON lines of a file or of standard input become postings to a site."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

from ..errors import InputError, Problem, system_reason
from .messages import EXIT_DOUBTFUL, EXIT_FINE, FURTHER_EXIT_CODES

TOKEN_VARIABLE = "FACTORGRAPH_ADJ_TOKEN"
"""Variable of the environment with the token, which a list of processes does not show."""
LINES_AT_ONCE = 100
"""Lines of a file that are sent in one request."""


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
    from ..site.outbox import Outbox

    refused, lines = 0, Counted()
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
        outbox = None if options.outbox is None else Outbox(options.outbox)
        if outbox is not None:
            stack.callback(outbox.close)

        def told(record: dict[str, Any], answer: dict[str, Any]) -> None:
            nonlocal refused
            refused += not answer["ok"]
            if not answer["ok"] or not options.quiet:
                print(json.dumps(answer, ensure_ascii=False), flush=True)

        for batch in _batches(source, options.file, lines):
            if outbox is None:
                answers = client.post_all(options.network, batch)
                for record, answer in zip(batch, answers, strict=True):
                    told(record, answer)
                continue
            outbox.put(options.network, *batch)
            try:
                client.send(outbox, answered=lambda k, a: told(k.record, a), patience=0.0)
            except ServiceAway:
                continue  # it is on the disk; the end of the input tries longer
        if outbox is not None:
            try:
                client.send(outbox, answered=lambda k, a: told(k.record, a))
            except ServiceAway as away:
                print(f"{away}; {len(outbox)} postings wait in {outbox.path}", file=sys.stderr)
                return EXIT_DOUBTFUL
    print(f"{lines.number} lines sent, {refused} refused", file=sys.stderr)
    return EXIT_DOUBTFUL if refused else EXIT_FINE


class Counted:
    """Number of lines that were read."""

    number = 0


def _batches(source: IO[str], name: str, lines: Counted) -> Iterator[list[dict[str, Any]]]:
    """Yield postings; those of a file many at once, those of a pipe or terminal one by one."""
    batch: list[dict[str, Any]] = []
    most = 1 if name == "-" else LINES_AT_ONCE
    for number, line in enumerate(source, 1):
        if not line.strip():
            continue
        where = f"{'standard input' if name == '-' else name}:{number}"
        try:
            record = json.loads(line)
        except ValueError as error:
            raise InputError(Problem(f"is no JSON ({error})", where)) from None
        if not isinstance(record, dict):
            raise InputError(Problem('is no JSON object: {"kind": …} or {"do": …}', where))
        lines.number += 1
        batch.append(record)
        if len(batch) == most:
            yield batch
            batch = []
    if batch:
        yield batch


def _source(name: str) -> IO[str]:
    if name == "-":
        return os.fdopen(os.dup(sys.stdin.fileno()), encoding="utf-8")
    try:
        return Path(name).open(encoding="utf-8")
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
