"""CPU time of an arrival in each engine: ``python -m tests.benchmarks.arrivals [STREAM …]``.

A stream is a name, with a size where it has one: ``single:1024``, ``stations:400``,
``sphere2500:1000``, ``victoria``; without any, all of them play (hours). Those who play it are
processes that alternate, arrival by arrival:

before        another version of this library, whose folder ``--before`` names; it plays `FIRST`
              arrivals, poses `FIRST_POSES`
isam2, fronts the engines of `IncrementalAdjustment`, with verdicts, an estimate and its σ
gtsam         iSAM2 alone with its default parameters, and the covariance of what is new; poses are
              native factors, networks those of `build_graph`
gtsam 0.01    the same, relinearised beyond 0.01 at each update
batch         a warm adjustment with reliability, of photos

One table has medians, 95 %, and the largest of CPU milliseconds, and below each stream the aims.
With ``--promise N`` the engines are compared with the batch adjustment at N moments, and settled.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from select import select
from typing import Any

import numpy as np

from tests.support.places import ROOT

from .players import PLAYERS, STREAMS

GRIDS = ("100", "400", "1024", "10000")
EVERY = (
    *(f"single:{n}" for n in GRIDS),
    *(f"stations:{n}" for n in GRIDS),
    "sphere2500",
    "w10000",
    "victoria",
    "plaza:1",
    "plaza:2",
    "single-mixed:1024",
    "photos:1024",
    "industry",
    "roma",
)
"""All streams of the table."""
ENGINES = ("isam2", "fronts")
"""The engines of this library."""
POSES = ("sphere2500", "w10000", "victoria", "plaza")
"""Streams of poses."""
FIRST, FIRST_POSES = 20, 300
"""Arrivals that the version of before takes."""
WINDOW = 100
"""Poses over whose median engines are compared with iSAM2 alone."""
PROMISED, SETTLED = 1e-2, 1e-6
"""Largest differences from the batch: at any time, and settled; in σ, and relative to it."""
SET_ASIDE = ("PYTHONPATH", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables of the environment that nobody sets who uses the library."""
BOOT = """
import sys
sys.path.insert(0, sys.argv[1])
import factorgraph_adj
sys.path[0] = sys.argv[2]
from tests.benchmarks.players import main
main(sys.argv[3:])
"""
"""Takes the library of one folder, and the tests of another."""


class GivenUp(Exception):
    """A player has failed, or takes too long."""


class Process:
    """A player in a process of its own."""

    def __init__(self, name: str, stream: str, library: Path, longest: float) -> None:
        """Start it.

        Args:
            name: who plays.
            stream: what.
            library: folder of the library.
            longest: seconds on the clock after which an answer is not waited for.
        """
        command = [sys.executable, "-c", BOOT, str(library), str(ROOT), stream, name]
        self.name, self._longest = name, longest
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=ROOT.parent,
            env={k: v for k, v in os.environ.items() if k not in SET_ASIDE},
            text=True,
        )

    def ask(self, order: str = "") -> dict[str, Any]:
        """Return the answer to an order; without one, what it says first.

        Raises:
            GivenUp: there is none.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        if order:
            try:
                self._process.stdin.write(f"{order}\n")
                self._process.stdin.flush()
            except BrokenPipeError:
                raise GivenUp(self._why()) from None
        if not select([self._process.stdout], [], [], self._longest)[0]:
            raise GivenUp(f"no answer within {self._longest:.0f} s")
        line = self._process.stdout.readline()
        if not line:
            raise GivenUp(self._why())
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _why(self) -> str:
        assert self._process.stderr is not None
        status = self._process.wait()
        lines = self._process.stderr.read().strip().splitlines() or [f"status {status}"]
        named = [line for line in lines if "Error" in line]
        return (named or lines)[-1].strip()

    def end(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()


@dataclass
class Played:
    """What a player took for a stream."""

    begun: float = float("nan")
    """CPU seconds of the beginning."""
    seconds: list[float] = field(default_factory=list)
    """CPU seconds of each arrival."""
    suspects: int = 0
    """Observations that were suspect when they arrived."""
    waiting: int = 0
    """Observations that wait in the end."""
    fallen: int = 0
    """Arrivals after which iSAM2 was not in use, after the first."""
    moments: list[dict[str, Any]] = field(default_factory=list)
    """Differences from the batch."""
    settled: dict[str, Any] | None = None
    """The same after settling."""
    ended: str = ""
    """Why it ended early."""

    @property
    def figures(self) -> tuple[float, float, float]:
        """Median, 95 % and the largest, milliseconds."""
        if not self.seconds:
            return (float("nan"),) * 3
        middle, high, most = 1e3 * np.quantile(self.seconds, [0.5, 0.95, 1.0])
        return float(middle), float(high), float(most)


@dataclass(frozen=True)
class Options:
    """How streams are played."""

    before: Path | None = None
    """Folder of another version of this library."""
    arrivals: int | None = None
    """Largest number of arrivals; none: all."""
    promise: int = 0
    """Number of comparisons with the batch."""
    budget: float = 600.0
    """CPU seconds after which a player is given up."""
    players: tuple[str, ...] = PLAYERS
    """Who plays."""


def play(stream: str, options: Options) -> dict[str, Played]:
    """Let all players take a stream, alternating.

    Args:
        stream: name and size.
        options: how.
    """
    chosen = [p for p in options.players if p != "before" or options.before is not None]
    out = {name: Played() for name in chosen}
    playing: dict[str, Process] = {}

    def ask(name: str, order: str = "") -> dict[str, Any] | None:
        """Return the answer of a player; none: it has ended."""
        if name not in playing:
            return None
        try:
            return playing[name].ask(order)
        except GivenUp as error:
            out[name].ended = str(error)
        playing.pop(name).end()
        return None

    steps = 0
    for name in chosen:
        library = options.before if name == "before" and options.before else ROOT
        playing[name] = Process(name, stream, library.resolve(), options.budget)
        told = ask(name)
        if told is not None and name in told["players"]:
            steps = told["steps"]
        elif told is not None:  # it has no part in such a stream
            playing.pop(name).end()
            del out[name]
    chosen = list(out)
    for name in chosen:
        if (answer := ask(name, "begin")) is not None:
            out[name].begun = answer["cpu"]
    steps = steps if options.arrivals is None else min(steps, options.arrivals)
    first = FIRST_POSES if _kind(stream) in POSES else FIRST
    moments = set(np.linspace(0, steps - 1, options.promise + 1).astype(int)[1:].tolist())
    for step in range(steps):
        for name in chosen:
            if name == "before" and step == first:
                playing.pop(name).end() if name in playing else None
            if (answer := ask(name, "take")) is None:
                continue
            mine = out[name]
            mine.seconds.append(answer["cpu"])
            mine.suspects += answer.get("suspect", 0)
            mine.waiting = answer.get("waiting", 0)
            mine.fallen += step > 0 and answer.get("system") == "System"
            compares = step in moments and name in ENGINES
            if compares and (found := ask(name, f"compare {step}")) is not None:
                mine.moments.append({"step": step, **found})
            if sum(mine.seconds) > options.budget and step + 1 < steps:
                mine.ended = f"{step + 1} of {steps}: {options.budget:.0f} CPU s"
                playing.pop(name).end()
    for name in ENGINES if options.promise else ():
        if ask(name, "settle") is not None:
            out[name].settled = ask(name, "compare 0")
    for process in playing.values():
        process.end()
    return out


def _kind(stream: str) -> str:
    return stream.partition(":")[0]


def table(stream: str, played: dict[str, Played]) -> list[str]:
    """Return the lines of a stream."""
    lines = []
    for name, p in played.items():
        middle, high, most = p.figures
        notes = [f"{p.suspects} suspect"] if p.suspects else []
        notes += [f"{p.waiting} wait"] if p.waiting else []
        notes += [f"fronts after {p.fallen}"] if p.fallen and name == "isam2" else []
        notes += [p.ended] if p.ended else []
        lines.append(
            f"{stream:18}{name:12}{len(p.seconds):6d}{p.begun:9.2f}"
            f"{middle:10.2f}{high:10.2f}{most:10.2f}  {'; '.join(notes)}"
        )
    return [*lines, *(f"    {line}" for line in (*aims(stream, played), *promises(played)))]


def aims(stream: str, played: dict[str, Played]) -> list[str]:
    """Return the aims of a stream beside what was reached, one in a line."""
    kind, _, size = stream.partition(":")
    out = []
    for name in (n for n in ENGINES if n in played):
        mine = played[name].seconds
        before = played["before"].seconds if "before" in played else []
        if before and kind.startswith("single"):
            out.append(_aim(name, "of before", _ratio(mine, before), 1.0))
        if before and kind == "stations":
            out.append(
                _aim(name, "of before", _ratio(mine, before), 1 / 8 if size == "100" else 0.1)
            )
        alone = played["gtsam 0.01"].seconds if "gtsam 0.01" in played else []
        if alone and kind in POSES:
            ratios = by_hundreds(mine, alone)
            if ratios:
                told = " ".join(f"{r:.1f}" for r in ratios)
                out.append(_aim(name, "of gtsam 0.01, most", max(ratios), 5.0))
                out.append(f"{name:8}of gtsam 0.01, each hundred: {told}")
        batch = played["batch"].seconds if "batch" in played else []
        if batch:
            out.append(_aim(name, "of adjust and reliability", _ratio(mine, batch), 1.5))
    return out


def by_hundreds(mine: Sequence[float], alone: Sequence[float]) -> list[float]:
    """Return the ratio of the medians of each hundred poses."""
    n = min(len(mine), len(alone)) // WINDOW
    return [
        float(np.median(mine[k * WINDOW : (k + 1) * WINDOW]))
        / float(np.median(alone[k * WINDOW : (k + 1) * WINDOW]))
        for k in range(n)
    ]


def _ratio(mine: Sequence[float], others: Sequence[float]) -> float:
    """Return the ratio of the medians of the arrivals that both took."""
    n = min(len(mine), len(others))
    return float(np.median(mine[:n]) / np.median(others[:n])) if n else float("nan")


def _aim(name: str, of: str, reached: float, most: float) -> str:
    met = "met" if reached <= most else "NOT met"
    return f"{name:8}{of}: {reached:.3g}, at most {most:.3g}: {met}"


def promises(played: dict[str, Played]) -> list[str]:
    """Return how far engines were from the batch, one in a line."""
    out = []
    for name in (n for n in ENGINES if n in played and played[n].moments):
        found, settled = played[name].moments, played[name].settled
        for what, unit in (("estimates", "σ of a component"), ("sigmas", "of a σ")):
            far = max(found, key=lambda m: m[what])
            kept = "kept" if far[what] <= PROMISED else "BROKEN"
            where = f"arrival {far['step'] + 1}" + (f", {far['worst']}" if far["worst"] else "")
            after = "" if settled is None else f"; settled {settled[what]:.1e}"
            if settled is not None and settled[what] > SETTLED:
                kept = "BROKEN"
            out.append(
                f"{name:8}{len(found)} moments: at most {far[what]:.1e} {unit} ({where})"
                f"{after}: {kept}"
            )
    return out


HEAD = f"{'stream':18}{'who':12}{'n':>6}{'begin s':>9}{'median ms':>10}{'95 %':>10}{'max':>10}"


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.arrivals",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("streams", nargs="*", metavar="STREAM", help=", ".join(EVERY))
    parser.add_argument("--before", type=Path, help="folder of another version of this library")
    parser.add_argument("--arrivals", type=int, help="largest number of arrivals of a stream")
    parser.add_argument("--promise", type=int, default=0, help="comparisons with the batch")
    parser.add_argument(
        "--budget", type=float, default=600.0, help="CPU seconds of a player for a stream"
    )
    parser.add_argument("--players", nargs="+", choices=PLAYERS, default=PLAYERS)
    given = parser.parse_args(arguments)
    unknown = [s for s in given.streams if _kind(s) not in STREAMS]
    if unknown:
        parser.error(f"unknown stream {', '.join(unknown)}; known: {', '.join(STREAMS)}")
    options = Options(
        given.before, given.arrivals, given.promise, given.budget, tuple(given.players)
    )
    print(HEAD)
    for stream in given.streams or EVERY:
        print("\n".join(table(stream, play(stream, options))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
