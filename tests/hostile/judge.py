"""What a command made of a damaged input, in a process of its own with limits."""

from __future__ import annotations

import importlib
import os
import pkgutil
import resource
import signal
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from tests.support.dense import Dense

SECONDS = 60.0
"""Longest processor time of a command: the time of a clock depends on what else runs."""
MEGABYTES = 1000.0
"""Largest memory of a command."""
AT_REST = 1e-3
"""Largest step relative to σ, by an independent dense step, of a result that is called right."""
LONGEST = 200_000
"""Largest number of characters of a message: all that a command says, or one answer of a stream."""
SECRET = "root:"
"""What stands in /etc/passwd, and must not stand in any output."""


@dataclass(frozen=True)
class Outcome:
    """What became of one input."""

    code: int
    """Exit code; negative: the number of the signal that ended it."""
    output: str
    """Both streams."""
    seconds: float
    """Processor time."""
    megabytes: float
    """Memory beyond that of the process at its start."""
    longest: int = 0
    """Number of characters of its longest message."""
    wrong: str = ""
    """What is wrong with a result; empty: nothing."""

    @property
    def fault(self) -> str:
        """What must not happen; empty: nothing of it did."""
        if self.code < 0:
            return f"ended by signal {-self.code}"
        if "Traceback" in self.output or self.code == 3:
            return "traceback or fault of the program"
        if SECRET in self.output:
            return "shows a file outside its folder"
        if self.seconds > SECONDS:
            return f"took {self.seconds:.0f} s"
        if self.megabytes > MEGABYTES:
            return f"took {self.megabytes:.0f} MB"
        if self.code == 2 and not self.output.strip():
            return "refused without a word"
        if self.longest > LONGEST:
            return f"told {self.longest} characters"
        return self.wrong


def run(arguments: Sequence[str], piped: Path | None) -> Outcome:
    """Run a command in a process of its own."""
    import_package()
    with tempfile.TemporaryFile() as out:
        child = os.fork()
        if not child:
            _child(arguments, piped, out.fileno())
        _, status, used = os.wait4(child, 0)
        seconds = used.ru_utime + used.ru_stime
        out.seek(0)
        text = out.read(2_000_000).decode("utf-8", "replace")
    code = os.waitstatus_to_exitcode(status)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    messages = [text] if piped is None else text.splitlines()
    longest = max((len(m) for m in messages), default=0)
    return Outcome(code, text, seconds, max(0.0, used.ru_maxrss / 1024.0 - before), longest)


@cache
def import_package() -> None:
    """Import the modules that commands import, which else every forked process does anew."""
    for module in pkgutil.walk_packages(fga.__path__, f"{fga.__name__}."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)


def _child(arguments: Sequence[str], piped: Path | None, out: int) -> None:
    """Run a command and leave the process."""
    code = 70
    try:
        os.dup2(out, 1)
        os.dup2(out, 2)
        source = os.open(os.devnull if piped is None else piped, os.O_RDONLY)
        os.dup2(source, 0)
        sys.stdin = os.fdopen(0, "r", encoding="utf-8", errors="surrogateescape", closefd=False)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
        signal.alarm(int(10 * SECONDS))
        code = main(list(arguments))
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 2
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)


def checked(outcome: Outcome, path: Path) -> Outcome:
    """Check a result that the command called right: it is a minimum of what was read."""
    if outcome.code != 0:
        return outcome
    network = fga.read(path)
    solution = fga.adjust(network)
    if not solution.converged:
        return _with(outcome, "exit code 0 of an adjustment that did not converge")
    here = Dense.at(solution.equations, solution.state)
    if solution.datum is None:
        step, *_ = np.linalg.lstsq(here.design, -here.residual, rcond=1e-12)
        bound = float(np.linalg.norm(here.design @ step))
        scale = max(1.0, float(np.linalg.norm(here.residual)) * 1e-6)
        if not bound < AT_REST * scale:
            return _with(outcome, f"is {bound:.2g} σ from the minimum of what was read")
    return outcome


def _with(outcome: Outcome, wrong: str) -> Outcome:
    from dataclasses import replace

    return replace(outcome, wrong=wrong)
