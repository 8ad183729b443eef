"""The journal after a crash: the state before or after what was in hand, never a third one."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from factorgraph_adj import IncrementalAdjustment, Network
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.json_records import network_files
from factorgraph_adj.ledger.command_input import Engine
from tests.support.arrivals import batch, difference
from tests.support.places import ROOT
from tests.support.playing import day, morning
from tests.support.processes import HANGS
from tests.support.studies import cases

SEED = 1986
A_FEW, MANY = 8, 25
"""Processes that are killed: of a few most die while they compute, of many some as they write."""
SEVERAL = pytest.mark.parametrize("killed", cases([A_FEW, MANY], [A_FEW]))
WITHIN = 0.01
"""Promise of an adjustment that is not at rest, relative to σ."""
AT_REST = 1e-6
ROUNDING = 1e-9
"""Of figures of different runs, relative or absolute."""


# -- states ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class State:
    """What counts of an adjustment."""

    files: dict[str, str]
    """The network as it stands."""
    described: tuple[tuple[str, ...], ...]
    """Names of points, photos and cameras."""
    waiting: tuple[str, ...]
    suspects: tuple[Any, ...]
    rejected: tuple[Any, ...]


def _left_out(verdicts: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return what verdicts of suspects or rejected observations say, figures to the bit."""
    return tuple(
        (
            *(v.id, v.kind, v.label, v.verdict, v.components, v.dof, v.points),
            *(repr(x) for x in (v.t2, v.critical)),
            *(None if a is None else repr(a.tolist()) for a in (v.innovation, v.sigma, v.w)),
        )
        for v in sorted(verdicts, key=lambda v: v.id)
    )


def state_of(inc: IncrementalAdjustment) -> State:
    d = inc.described
    return State(
        network_files(inc.network()),
        tuple(tuple(t) for t in (d.points, d.photos, d.cameras)),
        tuple(sorted(w.id for w in inc.waiting)),
        _left_out(inc.suspects),
        _left_out(inc.rejected),
    )


@dataclass(frozen=True)
class Moment:
    """A state of an undisturbed day, and its estimates."""

    state: State
    estimates: dict[str, tuple[np.ndarray, np.ndarray]]
    """Coordinates and standard deviations of every point that is determined."""
    settled: dict[str, tuple[np.ndarray, np.ndarray]]
    """The same of the batch adjustment."""


def points_of(inc: IncrementalAdjustment) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    out = {}
    for name in inc.described.points:
        try:
            out[name] = inc.estimate(name), inc.standard_deviations(name)
        except InputError:
            continue
    return out


def moment_of(inc: IncrementalAdjustment) -> Moment:
    settled = {}
    if len(inc):
        solution = batch(inc)
        settled = {
            n: (solution.point(n), solution.standard_deviations(n)) for n in solution.network.points
        }
    return Moment(state_of(inc), points_of(inc), settled)


OTHER: dict[Engine, Engine] = {"isam2": "fronts", "fronts": "isam2"}
"""The other engine of each."""


@cache
def undisturbed(engine: Engine) -> tuple[tuple[Moment, ...], tuple[bytes, ...]]:
    """Return the states of the day, the first before anything has arrived, and its journals.

    Start values that are found depend on the engine.
    """
    moments, journals = [], []
    with TemporaryDirectory() as folder:
        path = Path(folder, "day.jsonl")
        inc = IncrementalAdjustment(morning(), journal=path, engine=engine)
        for step in (None, *day()):
            if step is not None:
                step(inc)
            moments.append(moment_of(inc))
            journals.append(path.read_bytes())
    return tuple(moments), tuple(journals)


def assert_is(inc: IncrementalAdjustment, moment: Moment, *, exact: bool = False) -> None:
    """The adjustment is at this moment of the day, and at rest.

    Figures of the same run are the same to the bit; another run may round differently.
    """
    state = state_of(inc)
    if exact:
        assert state == moment.state
    assert same(state, moment.state)
    found = points_of(inc)
    assert found.keys() == moment.estimates.keys()
    for name, (at, sigma) in found.items():
        for expected, limit in ((moment.estimates, WITHIN), (moment.settled, AT_REST)):
            if name not in expected:  # held, and nothing observes it
                continue
            there, deviation = expected[name]
            free = deviation > 1e-9
            assert np.all(np.abs(at - there)[free] <= limit * deviation[free]), name
            assert np.allclose(sigma[free], deviation[free], rtol=limit, atol=0), name


def same(a: Any, b: Any) -> bool:
    """Return whether two states are the same, numbers to rounding."""
    if isinstance(a, State):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(State))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, str):
        words, others = (_WORD.split(t) for t in (a, b))
        return len(words) == len(others) and all(map(_same_word, words, others))
    return a is b or _near(a, b)


_WORD = re.compile(r"[,\n =\[\]]")


def _same_word(a: str, b: str) -> bool:
    if a == b:
        return True
    try:
        return _near(float(a), float(b))
    except ValueError:
        return False


def _near(a: Any, b: Any) -> bool:
    return bool(np.allclose(a, b, rtol=ROUNDING, atol=ROUNDING, equal_nan=True))


def resumed(journal: Path, engine: Engine | None = None) -> IncrementalAdjustment:
    """Resume from a copy of a journal, in its own engine or in another one."""
    number = len(list(journal.parent.iterdir()))
    copy = journal.with_name(f"{journal.stem}, copy {number}{journal.suffix}")
    copy.write_bytes(journal.read_bytes())
    return IncrementalAdjustment.resume(copy, engine=engine)


# -- killed processes -----------------------------------------------------------------------------


class Player:
    """Processes that play the day."""

    def __init__(self) -> None:
        self.server = subprocess.Popen(
            [sys.executable, "-m", "tests.support.playing"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        self.lines: list[str] = []

    def _line(self) -> str:
        assert self.server.stdout is not None
        line = self.server.stdout.readline()
        assert line, "the player is gone"
        return line.strip()

    def kill_at(
        self, journal: Path, engine: Engine, *, steps: int, after: float, first: int = 0
    ) -> int:
        """Let a process play from a step on; kill it; return how many steps it had finished.

        Args:
            journal: of the process.
            engine: that carries its arrivals.
            steps: how many finished steps are waited for,
            after: and for how many seconds from then on.
            first: the step it begins with.
        """
        assert self.server.stdin is not None
        order = {"journal": str(journal), "from": first, "engine": engine}
        self.server.stdin.write(json.dumps(order) + "\n")
        pid = int(self._line().removeprefix("pid "))
        done = 0
        while done < steps:
            assert self._line() == "done"
            done += 1
        time.sleep(after)
        os.kill(pid, signal.SIGKILL)
        while (line := self._line()) == "done":
            done += 1
        assert line == f"end {signal.SIGKILL.value}"
        return done

    def close(self) -> None:
        assert self.server.stdin is not None and self.server.stdout is not None
        self.server.stdin.close()
        self.server.wait(HANGS)
        self.server.stdout.close()


@contextmanager
def player() -> Iterator[Player]:
    found = Player()
    try:
        yield found
    finally:
        found.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
@pytest.mark.slow(
    "kills processes between any two steps and while they write; days of many crashes go through "
    "most of these moments too"
)
@SEVERAL
def test_a_process_killed_at_any_moment_has_lost_nothing_but_what_was_in_hand(
    tmp_path, engine, killed
):
    """Each is killed some steps and some milliseconds into a day of its own.

    Every other journal resumes under the other engine.
    """
    moments, _ = undisturbed(engine)
    rng = np.random.default_rng(SEED)
    n = len(moments) - 1
    lasted = rng.permutation(np.linspace(0, n - 3, killed).astype(int)).tolist()
    delays = rng.uniform(0.0, 0.03, killed).tolist()
    late = 0
    with player() as playing:
        for number, (steps, after) in enumerate(zip(lasted, delays, strict=True)):
            journal = tmp_path / f"{number}.jsonl"
            done = playing.kill_at(journal, engine, steps=steps, after=after)
            if not journal.exists() or not journal.stat().st_size:
                assert not done  # killed before there was a journal
                continue
            inc = resumed(journal, OTHER[engine] if number % 2 else None)
            state = state_of(inc)
            at = done + 1 if done < n and not same(state, moments[done].state) else done
            late += at > done
            assert_is(inc, moments[at])
    # Most are killed while they think, some after the line was written.
    assert killed == A_FEW or late < killed


@pytest.mark.slow("a day with many crashes ends as one without; short tests interrupt once")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked")
@SEVERAL
def test_days_of_many_crashes_end_as_one_without(tmp_path, engine, killed):
    """Each process goes on where the last one was killed, from the same journal.

    The engines of the processes are drawn by chance. How many a day has depends on the machine:
    there are as many days as it takes.
    """
    moments, _ = undisturbed(engine)
    rng = np.random.default_rng(SEED + 1)
    crashes = 0
    with player() as playing:
        while crashes < killed:
            journal, first = tmp_path / f"{crashes}.jsonl", 0
            while first < len(moments) - 6:
                steps = int(rng.integers(1, 6))
                after = float(rng.uniform(0.0, 0.02))
                own = engine if rng.random() < 0.5 else OTHER[engine]
                first += playing.kill_at(journal, own, steps=steps, after=after, first=first)
                crashes += 1
                ids = ids_there(resumed(journal))
                if ids != ids_of_state(moments[first]) and first < len(moments) - 1:
                    first += 1
                assert ids == ids_of_state(moments[first])
            assert_day_ends(journal, first, moments[-1])


def assert_day_ends(journal: Path, first: int, last: Moment) -> None:
    """Compare the rest of a day with one that nothing disturbed."""
    inc = IncrementalAdjustment.resume(journal)
    for step in day()[first:]:
        step(inc)
    inc.settle()
    assert ids_there(inc) == ids_of_state(last)
    for name, (at, sigma) in last.settled.items():
        free = sigma > 1e-9
        # Approximate values were found from estimates at rest, which the weights of centring and
        # of lengths notice; nothing else differs.
        assert np.all(np.abs(inc.estimate(name) - at)[free] <= 1e-4 * sigma[free]), name


def ids_there(inc: IncrementalAdjustment) -> tuple[tuple[str, ...], ...]:
    return ids_of_state(Moment(state_of(inc), {}, {}))


def ids_of_state(moment: Moment) -> tuple[tuple[str, ...], ...]:
    s = moment.state
    found = []
    for name, text in s.files.items():
        if name.startswith(("observations", "images", "clusters")):
            found += [",".join(line.split(",")[:4]) for line in text.splitlines()]
    return (
        tuple(found),
        s.waiting,
        tuple(x[0] for x in s.suspects),
        tuple(x[0] for x in s.rejected),
    )


# -- without processes ----------------------------------------------------------------------------


@pytest.mark.slow(
    "resumes after every one of the steps, to the bit; short tests resume after some of them"
)
def test_every_step_of_the_day_is_resumed(tmp_path, engine):
    """After arrivals, removals, replacements, other weights, decisions, snooping: all of them.

    Every other journal resumes under the other engine.
    """
    for number, (moment, data) in enumerate(zip(*undisturbed(engine), strict=True)):
        path = tmp_path / f"{number}.jsonl"
        path.write_bytes(data)
        inc = IncrementalAdjustment.resume(path, engine=OTHER[engine] if number % 2 else None)
        assert inc.resumed == ""
        assert_is(inc, moment, exact=True)


@pytest.mark.slow("a day with many crashes ends as one without; short tests interrupt once")
def test_a_torn_last_line_is_reported_and_left_out(tmp_path, engine):
    """However much of it is there; the journal goes on on a line of its own."""
    moments, journals = undisturbed(engine)
    rng = np.random.default_rng(SEED)
    for number in range(1, len(journals), 4):
        before, after = journals[number - 1], journals[number]
        if before == after:
            continue
        cut = int(rng.integers(len(before) + 1, len(after) - 1))
        path = tmp_path / f"{number}.jsonl"
        path.write_bytes(after[:cut])
        inc = IncrementalAdjustment.resume(path)
        line = before.count(b"\n") + 1
        assert inc.resumed.startswith(f"{path}:{line}: the last line was torn and is left out")
        assert_is(inc, moments[number - 1], exact=True)
        assert path.read_bytes() == before
        day()[number - 1](inc)
        twice = resumed(path)
        assert twice.resumed == ""
        assert ids_there(twice) == ids_of_state(moments[number])


def test_a_line_without_its_end_counts(tmp_path):
    """A whole object is a whole entry: it was recorded."""
    path = tmp_path / "day.jsonl"
    first = IncrementalAdjustment(morning(), journal=path)
    for step in day()[:20]:
        step(first)
    moment = moment_of(first)
    cut = tmp_path / "cut.jsonl"
    cut.write_bytes(path.read_bytes().removesuffix(b"\n"))
    inc = IncrementalAdjustment.resume(cut)
    assert inc.resumed == ""
    assert_is(inc, moment, exact=True)


def test_a_journal_goes_on_under_either_engine(tmp_path, engine):
    """What is in, waits or was left out is the same; the next arrival is carried by the other."""
    path, half = tmp_path / "day.jsonl", 20
    first = IncrementalAdjustment(morning(), journal=path)
    for step in day()[:half]:
        step(first)
    assert first.engine == engine
    moment, other = moment_of(first), resumed(path, OTHER[engine])
    assert_is(other, moment, exact=True)
    for step in day()[half : half + 5]:
        step(other)
        step(first)
    assert other.engine == OTHER[engine]
    assert ids_there(other) == ids_there(first)
    assert difference(other.solution(), batch(first)).estimates < WITHIN


def test_an_engine_that_there_is_not_is_refused(tmp_path):
    path = tmp_path / "day.jsonl"
    IncrementalAdjustment(morning(), journal=path)
    with pytest.raises(InputError, match="unknown engine 'trees'"):
        IncrementalAdjustment.resume(path, engine="trees")  # type: ignore[arg-type]


def test_what_the_network_had_at_the_start_is_resumed_too(tmp_path):
    """Observations of the network are in the header, those that wait among them."""
    network = morning()
    first = IncrementalAdjustment(network)
    for step in day()[:12]:
        step(first)
    began: Network = first.network()
    path = tmp_path / "day.jsonl"
    inc = IncrementalAdjustment(began, journal=path)
    there = state_of(inc)
    again = resumed(path)
    assert state_of(again) == there
    assert difference(again.solution(), batch(inc)).estimates < AT_REST


def test_what_is_refused_leaves_no_line(tmp_path):
    path = tmp_path / "day.jsonl"
    inc = IncrementalAdjustment(morning(), journal=path)
    for step in day()[:6]:
        step(inc)
    before = path.read_bytes()
    for wrong in (
        lambda: inc.remove("nobody"),
        lambda: inc.accept("rS1-A-a"),
        lambda: inc.reweight("rS1-A-a", 0.0),
        lambda: day()[0](inc),
        lambda: inc.add(points=[next(iter(inc.described.points.values()))]),
    ):
        with pytest.raises(InputError):
            wrong()
        assert path.read_bytes() == before
