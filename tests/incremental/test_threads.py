"""Several threads use one adjustment: nothing is lost, and every answer is of one state."""

from __future__ import annotations

import inspect
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Thread

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental.adjustment import IncrementalAdjustment
from factorgraph_adj.incremental.state_queries import StateQueries
from factorgraph_adj.io.journal import Journal
from factorgraph_adj.observations import HeightDifference, SlopeDistance
from factorgraph_adj.service.stream import Stream
from tests.support.processes import HANGS

LONG = pytest.mark.slow("hundreds of readings from several threads; short tests give single ones")

POINTS, READINGS, THREADS = 5, 50, 8


@pytest.fixture(autouse=True)
def threads_take_turns_often():
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def levels(journal=None) -> IncrementalAdjustment:
    net = fga.Network("levels")
    net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    for n in range(POINTS):
        net.add_point(f"P{n}", (1.0, float(n), 0.1 * n), fixed="xy")
    return IncrementalAdjustment(net, journal=journal)


def reading(n: int) -> HeightDifference:
    rng = np.random.default_rng(n)
    dh = 0.1 * (n % POINTS) + 0.001 * rng.standard_normal()
    return HeightDifference("A", f"P{n % POINTS}", dh, sigma=0.001, id=f"h{n}")


@LONG
def test_what_was_accepted_from_several_threads_is_there(tmp_path):
    inc = levels(tmp_path / "day.jsonl")
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda n: inc.add(reading(n)).verdicts[0].verdict, range(READINGS)))
    assert found == ["accepted"] * READINGS
    assert len(inc) == READINGS
    assert sorted(inc.network().observations) == sorted(f"h{n}" for n in range(READINGS))
    assert inc.redundancy == READINGS - POINTS
    alone = levels()
    for n in range(READINGS):
        alone.add(reading(n))
    alone.settle()
    inc.settle()
    for n in range(POINTS):
        assert inc.estimate(f"P{n}") == pytest.approx(alone.estimate(f"P{n}"), abs=1e-9)
    inc = None  # which lets go of the journal
    again = IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert len(again) == READINGS
    del again


def test_ids_that_the_adjustment_gives_are_given_once():
    inc = levels()
    with ThreadPoolExecutor(THREADS) as pool:
        arrivals = pool.map(
            lambda n: inc.add(
                HeightDifference("A", f"P{n % POINTS}", 0.1 * (n % POINTS), sigma=1.0)
            ),
            range(READINGS),
        )
        ids = [v.id for a in arrivals for v in a.verdicts]
    assert len(set(ids)) == READINGS == len(inc)


@LONG
def test_a_stream_answers_each_line_of_several_threads():
    stream = Stream(levels())
    lines = [
        json.dumps(
            {"kind": "slope_distance", "station": "A", "target": f"P{n % POINTS}", "value": 1.5}
            | {"sigma_mm": 9000, "id": f"d{n}"}
        )
        for n in range(READINGS)
    ]
    with ThreadPoolExecutor(THREADS) as pool:
        answers = list(pool.map(stream.answer, lines, range(1, READINGS + 1)))
    assert all(a["ok"] for a in answers)
    counts = sorted(a["counts"]["observations"] + a["counts"]["waiting"] for a in answers)
    assert len(counts) == READINGS
    assert len(stream.adjustment) + stream.adjustment.n_waiting == READINGS


ALONE = {"policy", "alpha", "keep", "resume"}
"""What never changes, and what makes an adjustment."""


class Waits(Exception):
    """A thread waits for the lock, which another one holds."""


class Held:
    """A lock that another thread holds: who asks for it waits."""

    def __enter__(self) -> None:
        raise Waits

    def __exit__(self, *_: object) -> None:
        """Nobody has it to give back."""


def test_every_public_member_waits_for_the_lock():
    members = [
        (name, member.fget if isinstance(member, property) else member)
        for name, member in {**vars(StateQueries), **vars(IncrementalAdjustment)}.items()
        if (not name.startswith("_") or name in ("__len__", "__repr__")) and name not in ALONE
    ]
    assert len(members) > 25
    for name, function in members:
        assert inspect.isfunction(function), name
        inc = levels()
        inc._lock = Held()
        needed = [
            p
            for p in list(inspect.signature(function).parameters.values())[1:]
            if p.default is p.empty and p.kind is p.POSITIONAL_OR_KEYWORD
        ]
        with pytest.raises(Waits):
            function(inc, *("P0" for _ in needed))


def test_a_refused_arrival_lets_the_lock_go(tmp_path):
    inc = levels(tmp_path / "day.jsonl")
    inc.add(reading(0))
    with pytest.raises(fga.InputError):
        inc.add(SlopeDistance("A", "nobody", 1.0, sigma=0.01))
    done = Event()
    other = Thread(target=lambda: (inc.add(reading(5)), done.set()))
    other.start()
    other.join(HANGS)
    assert done.is_set()
    assert len(inc) == 2
    assert isinstance(inc._journal, Journal)
