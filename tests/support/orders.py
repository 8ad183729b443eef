"""Whether the end depends on the order of arrivals, or on what arrives together.

`study` lets the same observations arrive in several ways: handed over with the network, one by
one in a few orders, in groups, and with a part of them handed over at the start. In the end the
same observations must be in, and settled the results must be those of the batch adjustment.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from traceback import extract_tb
from types import FrameType
from typing import NoReturn

import numpy as np

from factorgraph_adj import IncrementalAdjustment, Solution, adjust
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.observations import AnyObservation
from tests.networks.random_small import Drawn, handed_over, random_network
from tests.support.arrivals import batch, difference, ids_of, variables

AT_REST = 1e-6
"""Largest deviation of a settled state, relative to σ."""
COMPARABLE = (1e-9, 1e-7)
"""Tolerances of the batch adjustment; weaker networks have none to compare with."""
ROUNDING = 10.0
"""Multiple of the difference of two batch adjustments below which a difference is rounding."""
LONGEST = 120.0
"""Processor time, seconds, after which the arrival of a network in one way hangs."""
LARGEST_GROUP = 8
"""Observations that arrive together, at most."""


@dataclass(frozen=True)
class Way:
    """A way in which observations arrive."""

    name: str
    first: tuple[AnyObservation, ...]
    """Observations that are handed over with the network."""
    groups: tuple[tuple[AnyObservation, ...], ...]
    """What arrives together, in order."""


def ways(drawn: Drawn, orders: int) -> Iterator[Way]:
    """Iterate over ways in which the observations of a network arrive.

    Args:
        drawn: the network.
        orders: number of random orders, of random groupings, and of random parts at the start.
    """
    every = drawn.items
    yield Way("whole", every, ())
    yield Way("together", (), (every,))
    yield Way("file", (), tuple((o,) for o in every))
    for k in range(orders):
        rng = np.random.default_rng([drawn.seed, 3, k])
        mixed = [every[i] for i in rng.permutation(len(every))]
        yield Way(f"order {k}", (), tuple((o,) for o in mixed))
        mixed = [every[i] for i in rng.permutation(len(every))]
        yield Way(f"groups {k}", (), tuple(_cut(mixed, rng)))
        mixed = [every[i] for i in rng.permutation(len(every))]
        n = int(rng.integers(1, len(every)))
        yield Way(f"part {k}", tuple(mixed[:n]), tuple((o,) for o in mixed[n:]))


def _cut(
    some: Sequence[AnyObservation], rng: np.random.Generator
) -> Iterator[tuple[AnyObservation, ...]]:
    at = 0
    while at < len(some):
        n = int(rng.integers(1, LARGEST_GROUP + 1))
        yield tuple(some[at : at + n])
        at += n


@dataclass(frozen=True)
class End:
    """Where observations came to that arrived in one way."""

    way: Way
    adjustment: IncrementalAdjustment | None
    """Settled; none: it ended in an error."""
    before: frozenset[str]
    """Ids of what was in before it settled."""
    error: str = ""
    """The error, and where it was raised."""

    @cached_property
    def inside(self) -> frozenset[str]:
        """Ids of what is in."""
        return frozenset() if self.adjustment is None else inside(self.adjustment)

    @cached_property
    def solution(self) -> Solution | None:
        """The solution; none: nothing is in."""
        if self.adjustment is None or not len(self.adjustment):
            return None
        return self.adjustment.solution()


def inside(adjustment: IncrementalAdjustment) -> frozenset[str]:
    """Return the ids of the observations in the graph."""
    network = adjustment.network()
    rays = (i for o in network.image_points() for i in ids_of(o))
    return frozenset(network.observations).union(rays)


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise a TimeoutError in what takes more processor time; in the main thread only."""

    def late(number: int, frame: FrameType | None) -> NoReturn:
        del number, frame
        raise TimeoutError(f"hangs: {seconds:g} s of processor time")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def arrive(drawn: Drawn, way: Way, policy: Policy = "accept") -> End:
    """Let observations arrive in one way, and settle."""
    try:
        with limited(LONGEST):
            return _arrived(drawn, way, policy)
    except Exception as error:  # each is a finding
        frames = extract_tb(error.__traceback__)[-2:]
        where = " < ".join(f"{f.name} ({f.filename.rpartition('/')[2]})" for f in frames[::-1])
        return End(way, None, frozenset(), f"{type(error).__name__}: {error} in {where}")


def _arrived(drawn: Drawn, way: Way, policy: Policy) -> End:
    network = handed_over(drawn.bare, way.first)
    adjustment = IncrementalAdjustment(network, policy=policy)
    for group in way.groups:
        adjustment.add(group)
    _check_all_there(drawn, adjustment)
    before = inside(adjustment)
    adjustment.settle()
    _check_all_there(drawn, adjustment)
    return End(way, adjustment, before)


def _check_all_there(drawn: Drawn, adjustment: IncrementalAdjustment) -> None:
    """Every observation is in, waits, is suspect or rejected."""
    there = [w.id for w in adjustment.waiting]
    there += [v.id for v in (*adjustment.suspects, *adjustment.rejected)]
    there += inside(adjustment)
    expected = sorted(i for item in drawn.items for i in ids_of(item))
    assert sorted(there) == expected, "an observation is nowhere, or in two places"
    assert all(w.lacks for w in adjustment.waiting), "what waits does not say why"


@dataclass(frozen=True)
class Finding:
    """Something that is not as it should be at the end of one way."""

    seed: int
    way: str
    what: str
    """``error``, ``inside``, ``inside before settling``, ``batch``, ``no minimum``, ``unknowns`` or
    ``another minimum``; ``weak`` where no batch adjustment is exact enough to compare with."""
    told: str

    def __str__(self) -> str:
        """Return a line."""
        return f"network {self.seed}, {self.way}: {self.what}: {self.told}"


@dataclass(frozen=True)
class Study:
    """What one network came to in all ways."""

    findings: tuple[Finding, ...]
    from_batch: float
    """Largest difference from the batch adjustment, relative to σ."""
    between: float
    """Largest difference between ways in which the same observations are in, relative to σ."""
    n_inside: int
    """Observations that are in, of those handed over."""
    n_observations: int


def study(drawn: Drawn, *, orders: int = 1) -> Study:
    """Let a network arrive in several ways, and compare the ends."""
    found: list[Finding] = []

    def add(end: End, what: str, told: str) -> None:
        found.append(Finding(drawn.seed, end.way.name, what, told))

    ends = [arrive(drawn, way) for way in ways(drawn, orders)]
    for end in ends:
        if end.error:
            add(end, "error", end.error)
    ends = [e for e in ends if not e.error]
    every = len([i for item in drawn.items for i in ids_of(item)])
    if not ends:
        return Study(tuple(found), 0.0, 0.0, 0, every)
    most = max(ends, key=lambda e: len(e.inside))
    from_batch = between = 0.0
    for end in ends:
        missing = sorted(most.inside - end.inside)
        if end.inside != most.inside:
            told = (
                f"without {', '.join(missing)}, which {most.way.name} has; {_lacks(end, missing)}"
            )
            add(end, "inside", told)
        elif end.before != most.inside:
            missing = sorted(most.inside - end.before)
            add(end, "inside before settling", f"without {', '.join(missing)}")
        if end.solution is None:
            continue
        try:
            off = _from_batch(end)
        except AdjustmentError as error:
            add(end, "batch", f"{type(error).__name__}: {error}")
            continue
        if isinstance(off, tuple):
            add(end, *off)
            continue
        from_batch = max(from_batch, off)
        if not off <= AT_REST:
            add(end, "batch", f"{off:.1e} σ from the batch adjustment")
        if end is not most and end.inside == most.inside and most.solution is not None:
            ours, theirs = (set(variables(e.solution)) for e in (end, most) if e.solution)
            if ours != theirs:
                told = ", ".join(" ".join(v) for v in sorted(ours ^ theirs))
                add(end, "unknowns", f"only here or only in {most.way.name}: {told}")
            apart = difference(end.solution, most.solution, shared=True, shapes=False).largest
            if apart > AT_REST:
                add(end, "another minimum", f"{apart:.1e} σ from {most.way.name}")
            else:
                between = max(between, apart)
    return Study(tuple(found), from_batch, between, len(most.inside), every)


def errors(seed: int) -> list[Finding]:
    """Let a network with gross errors arrive one by one in a random order; only errors count."""
    drawn = random_network(seed, gross=True)
    rng = np.random.default_rng([seed, 5])
    policy: Policy = ("flag", "reject", "accept")[seed % 3]
    groups = tuple((drawn.items[i],) for i in rng.permutation(len(drawn.items)))
    end = arrive(drawn, Way(f"gross errors, {policy}", (), groups), policy)
    return [Finding(seed, end.way.name, "error", end.error)] if end.error else []


def _lacks(end: End, ids: Sequence[str]) -> str:
    """Return what observations that wait lack, each reason once."""
    assert end.adjustment is not None
    return "; ".join(dict.fromkeys(w.lacks for w in end.adjustment.waiting if w.id in ids))


def _from_batch(end: End) -> float | tuple[str, str]:
    """Return the difference from the batch adjustment; or why there is none to compare with."""
    assert end.adjustment is not None and end.solution is not None
    theirs = batch(end.adjustment, tolerances=COMPARABLE)
    if not theirs.converged:
        return "weak", f"the batch adjustment does not come to rest: {theirs.reason}"
    if not end.solution.converged:
        told = f"the batch adjustment comes to rest, the state does not: {end.solution.reason}"
        return "no minimum", told
    off = difference(end.solution, theirs, shared=True).largest
    if off > AT_REST:
        anew = adjust(end.adjustment.network(), tolerance=COMPARABLE[-1])
        floor = difference(anew, theirs, shared=True).largest if anew.converged else np.inf
        if off <= ROUNDING * floor:
            return "weak", f"two batch adjustments are {floor:.1e} σ from each other"
    return off
