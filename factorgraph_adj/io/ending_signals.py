"""Signals that would end the process wait while files are moved into place."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
"""Signals that end a process which does not handle them."""


@contextmanager
def ending_signals_held() -> Iterator[None]:
    """Let the signals of `ENDING` take effect only at the end of the context.

    Signals that the program handles in its own way, or ignores, are left to it; so are all of
    them in threads, to which Python hands no signals. After an error SIGINT has no further
    effect: the error ends what was to be interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        came.append(number)

    before = {}
    failed = True
    try:
        for number in ENDING:
            handler = signal.getsignal(number)
            if handler in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = handler
                signal.signal(number, hold)
        yield
        failed = False
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(came):
            if not (failed and number == signal.SIGINT):
                signal.raise_signal(number)
