"""Command ``stream``: answers of `service.stream` in a pipe, resumption from a journal, signals.

Every input line gives one output line, which is flushed. The command ends with exit code 0 at the
end of input, on ``{"do": "stop"}``, on SIGTERM and when the reader of the answers closes the pipe;
on SIGINT it ends with 130. The current line is finished and answered first; a second SIGINT ends
the command at once.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib.util import find_spec
from types import FrameType
from typing import IO, Any, get_args

from ..errors import InputError, Problem, system_reason
from ..incremental.adjustment import IncrementalAdjustment
from ..io.project import Project
from ..ledger.verdicts import Policy
from ..service.requests import MAX_LINE_BYTES
from ..service.stream import Stream
from ..service.stream import __doc__ as protocol
from .input import add_project, read_input
from .live_view import RICH_MISSING, LiveView, live_view
from .messages import EXIT_FINE, EXIT_INTERRUPTED
from .options import add_probabilities

DEFAULT_ALPHA = 0.001
"""Default probability of a false alarm of one test."""


def add_stream(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.epilog, parser.formatter_class = protocol, argparse.RawDescriptionHelpFormatter
    add_project(parser)
    parser.add_argument(
        "--journal", metavar="FILE", help="record every arrival here before it counts"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with the journal; of PROJECT only units and defaults of records are used",
    )
    parser.add_argument(
        "--policy",
        choices=get_args(Policy),
        help="treatment of observations beyond the critical value (flag: they are left out "
        "as suspects)",
    )
    parser.add_argument("--datum", choices=("given", "free"), help="instead of the project's")
    parser.add_argument(
        "--keep",
        type=retention_window,
        metavar="N",
        help="keep the last N photos, or with N s (60s) what came in the last seconds: points, "
        "photos and orientations that nothing later touches are retired, so that time and memory "
        "of an arrival stay the same however long the stream is",
    )
    add_probabilities(parser)
    parser.set_defaults(alpha=None)  # a resumed journal states its own α
    parser.add_argument(
        "--live",
        action="store_true",
        help="show counts, verdicts, weakest points and latency on the terminal",
    )
    parser.set_defaults(run=_stream, ends_with_reader=True)


def retention_window(text: str) -> int | float:
    """Return what is kept: a number of photos, or seconds as a floating-point number."""
    digits = text.strip()
    try:
        return float(digits[:-1]) if digits.endswith("s") else int(digits)
    except ValueError:
        what = f"{text!r} is neither a number of photos (60) nor of seconds (60s)"
        raise argparse.ArgumentTypeError(what) from None


def _stream(options: argparse.Namespace) -> int:
    with _signals() as stop:
        stream = _start(options)
        stop.started = True
        try:
            with _view(options) as view:
                silent = view is not None and sys.stdout.isatty()
                _converse(stream, stop, None if silent else sys.stdout.buffer, view)
        except KeyboardInterrupt:
            print("interrupted in the middle of a line", file=sys.stderr)
            return EXIT_INTERRUPTED
        for doubt in stream.adjustment.doubts:
            print(doubt, file=sys.stderr)
        return EXIT_INTERRUPTED if stop.received == signal.SIGINT else EXIT_FINE


def _converse(
    stream: Stream, stop: _Signals, target: IO[bytes] | None, view: LiveView | None
) -> None:
    """Answer the lines one after the other until the end."""
    _hand_out(stream.ready(), target, view)
    for number, line in enumerate(stop.lines(sys.stdin.buffer), start=1):
        _hand_out(stream.answer(line, number), target, view)
        if stream.stopped:
            return


def _view(options: argparse.Namespace) -> AbstractContextManager[LiveView | None]:
    return live_view(sys.stderr) if options.live else nullcontext()


def _start(options: argparse.Namespace) -> Stream:
    """Read the project; begin a stream, or resume the stream of a journal."""
    problems = []
    if options.resume and options.journal is None:
        problems.append(Problem("--resume needs --journal FILE"))
    alpha = DEFAULT_ALPHA if options.alpha is None else options.alpha
    if alpha >= options.power:
        problems.append(Problem(f"--alpha {alpha:g} must be less than --power {options.power:g}"))
    if problems:
        raise InputError(problems)
    if options.live and find_spec("rich") is None:
        raise InputError(RICH_MISSING)
    project = read_input(options)
    if options.resume:
        crs = project.network.crs
        own = [crs.geoid] if crs is not None and isinstance(crs.geoid, str) else []
        adjustment = IncrementalAdjustment.resume(
            options.journal, geoids=own, allow_outside=options.allow_outside
        )
        _same(adjustment, project, options)
    else:
        adjustment = IncrementalAdjustment(
            project.network,
            policy=options.policy or "flag",
            alpha=alpha,
            datum=options.datum,
            keep=options.keep if isinstance(options.keep, int) else None,
            keep_seconds=options.keep if isinstance(options.keep, float) else None,
            journal=options.journal,
        )
    return Stream(adjustment, context=project.context, power=options.power)


def _same(adjustment: IncrementalAdjustment, project: Project, options: argparse.Namespace) -> None:
    """Refuse a journal of another project, as its units would be wrong, or with other options.

    Raises:
        InputError: the journal lacks parts of the project or states other options.
    """
    ours, theirs, retired = adjustment.described, project.network, adjustment.retired

    def is_retired(variable: tuple[str, str]) -> bool:
        return retired is not None and retired.last_estimate(variable) is not None

    problems = [
        Problem(
            f"the journal has no {what} {missing[0]!r}: it is not one of this project",
            str(project.path),
        )
        for what, kind, here, there in (
            ("point", "point", ours.points, theirs.points),
            ("photo", "pose", ours.photos, theirs.photos),
            ("camera", "", ours.cameras, theirs.cameras),
        )
        if (missing := [n for n in there if n not in here and not is_retired((kind, n))])
    ]
    for name, asked, begun in (
        ("--policy", options.policy, adjustment.policy),
        ("--alpha", options.alpha, adjustment.alpha),
        ("--datum", options.datum, ours.datum),
        ("--keep", options.keep, adjustment.keep),
    ):
        if asked not in (None, begun):
            what = f"{name} {asked}: the journal was begun with {begun}, which cannot be changed"
            problems.append(Problem(what))
    if problems:
        raise InputError(problems)


def _hand_out(answer: Mapping[str, Any], target: IO[bytes] | None, view: LiveView | None) -> None:
    """Write an answer to the output and show it in the live view."""
    if view is not None:
        view.take(answer)
    if target is not None:
        target.write(json.dumps(answer, ensure_ascii=False).encode("utf-8") + b"\n")
        target.flush()


class _Stopped(Exception):
    """A signal arrived while the command waited for a line."""


class _Signals:
    """Stop on a signal: at once while waiting for a line, otherwise after the answer."""

    def __init__(self) -> None:
        self.received: int | None = None
        """Number of the first signal; None before any signal."""
        self.started = False
        """Whether the stream has started; before the start, SIGINT ends the command at once."""
        self._waiting = False

    def take(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if number == signal.SIGINT and (self.received is not None or not self.started):
            raise KeyboardInterrupt
        self.received = self.received or number
        if self._waiting:
            self._waiting = False
            raise _Stopped

    def lines(self, source: IO[bytes]) -> Iterator[bytes]:
        """Iterate over lines until the end of input or a signal to stop.

        Raises:
            InputError: standard input cannot be read.
        """
        while True:
            try:
                self._waiting = True
                line = _line(source) if self.received is None else b""
                self._waiting = False
            except _Stopped:
                return
            except OSError as error:
                problem = Problem(f"cannot be read: {system_reason(error)}", "standard input")
                raise InputError(problem) from None
            if not line:
                return
            yield line


def _line(source: IO[bytes]) -> bytes:
    """Return the next line; a line that is too long is cut to one byte above the limit."""
    line = source.readline(MAX_LINE_BYTES + 1)
    if len(line) > MAX_LINE_BYTES and not line.endswith(b"\n"):
        while (rest := source.readline(MAX_LINE_BYTES)) and not rest.endswith(b"\n"):
            pass
    return line


@contextmanager
def _signals() -> Iterator[_Signals]:
    """Handle SIGTERM and SIGINT inside the context; restore the former handlers at its end."""
    taken = _Signals()
    if threading.current_thread() is not threading.main_thread():
        yield taken  # Python allows signal handlers in the main thread only
        return
    before = {n: signal.signal(n, taken.take) for n in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield taken
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
