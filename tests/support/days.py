"""Random days: observations come, together and alone, some of them wrong, and leave again.

A day is played on a small network that was drawn by chance, of every kind of observation, or on a
part of the site of total stations, GNSS, levels and photos. At some moments, and before and after
`settle`, its state is compared with the batch adjustment of the same observations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from factorgraph_adj import (
    AdjustmentError,
    IncrementalAdjustment,
    InputError,
    Network,
    Solution,
    adjust,
)
from factorgraph_adj.incremental.arrival import Arrival
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.observations import AnyObservation, Correlated, ImagePoint
from factorgraph_adj.solve.minimum import NOT_ON_INNER_CONSTRAINTS
from factorgraph_adj.start.start_values import Start
from tests.networks.random_small import random_network
from tests.networks.site import STATIONS
from tests.support.arrivals import bare, batch, deviations, difference, ids_of
from tests.support.two_engines import Recorded
from tests.support.watched import measured_site

PROMISE = 1e-2
"""Largest deviation from the batch adjustment at any time, relative to σ."""
AT_REST = 1e-6
"""The same after `settle`."""
APART = 3.0
"""Distance, relative to σ, from which the batch adjustment is at another place."""
ROUNDING = 10.0
"""Multiple of the difference of two batch adjustments below which a difference is rounding."""
PLACES = 3
"""Batch adjustments from other starts that measure rounding."""
LOWER = 1e-6
"""Part of vᵀPv, and amount of it, by which another minimum is lower."""
POLICIES: tuple[Policy, ...] = ("flag", "reject", "accept")
TOGETHER = 8
"""Largest number of observations that arrive together."""
MOMENTS = 3
"""Comparisons during a day."""
WRONG = 0.04
"""Share of the readings that have a gross error, of 10 to 10 000 σ and a few of less."""
LEAVES, CHANGES, DECIDED = 0.15, 0.05, 0.1
"""Probabilities that something leaves, is reweighted, is decided after an arrival."""
ON_SITE, WITH_MORE = 2, 3
"""One of so many days is on the site; of the others, one of so many has what `random_more` adds."""
MOST = 60
"""Observations of a day."""


@dataclass(frozen=True)
class Compared:
    """A state and the batch adjustment of the same observations."""

    seed: int
    when: str
    estimates: float = 0.0
    """Largest difference of an estimate, relative to its σ."""
    sigmas: float = 0.0
    """Largest relative difference of a σ."""
    rounding: float = 0.0
    """The same between two batch adjustments from different starts, where this was too large."""
    lower: float = 0.0
    """By how much vᵀPv of another minimum is lower, which the batch adjustment finds by itself."""
    told: bool = False
    """Whether the state tells of another minimum."""
    unlike: str = ""
    """Why there is nothing to compare with."""

    @property
    def largest(self) -> float:
        """The larger difference."""
        return max(self.estimates, self.sigmas)

    @property
    def settled(self) -> bool:
        """Whether the state was at rest."""
        return self.when in ("settled", "resumed")

    @property
    def outside(self) -> bool:
        """Whether the promise is broken."""
        return self.beyond and not self.elsewhere

    @property
    def beyond(self) -> bool:
        """Whether the state differs from the batch adjustment by more than was promised."""
        promise = AT_REST if self.settled else PROMISE
        return not self.largest <= max(promise, ROUNDING * self.rounding)

    @property
    def elsewhere(self) -> bool:
        """Whether the batch adjustment is at another place, of which the state tells."""
        return self.told and self.estimates > APART

    def __str__(self) -> str:
        """Return a line."""
        return (
            f"day {self.seed}, {self.when}: x {self.estimates:.1e} σ {self.sigmas:.1e} "
            f"rounding {self.rounding:.1e} lower {self.lower:.3g}{' (told)' * self.told} "
            f"{self.unlike}"
        )


@cache
def _site(seed: int) -> tuple[Network, tuple[AnyObservation, ...]]:
    return measured_site(seed)


def drawn(seed: int) -> tuple[Network, list[AnyObservation]]:
    """Return what is described on a day, and its observations."""
    if seed % ON_SITE:
        network = random_network(seed, more=seed // ON_SITE % WITH_MORE == 0)
        return network.bare, list(network.items[:MOST])
    rng = np.random.default_rng([seed, 11])
    measured, pool = _site(seed // ON_SITE % 5)
    there = {*rng.permutation(list(STATIONS))[:2].tolist(), "A", "B", "C"}
    targets = [n for n in measured.points if n[0] == "P"]
    there |= {*rng.permutation(targets)[: rng.integers(3, 7)].tolist()}
    there |= {*rng.permutation(list(measured.photos))[: rng.integers(2, 5)].tolist()}
    possible = [i for i in pool if {n for o in _members(i) for n in o.names()} <= there]
    chosen = rng.permutation(len(possible))[: rng.integers(25, MOST)]
    network = bare(measured)
    for name in [n for n in network.points if n not in there]:
        del network.points[name]
    network.point_number = {n: i for i, n in enumerate(network.points)}
    network.photos = {n: f for n, f in network.photos.items() if n in there}
    network.photo_number = {n: i for i, n in enumerate(network.photos)}
    for name, point in network.points.items():
        if not all(point.fixed):
            near = tuple((np.array(point.coordinates) + rng.normal(0.0, 0.3, 3)).tolist())
            network.points[name] = replace(point, coordinates=near)
    network.orientations = {k: o for k, o in network.orientations.items() if k[0] in there}
    network.verticals = {k: o for k, o in network.verticals.items() if k in there}
    return network, [possible[i] for i in chosen]


def _members(item: AnyObservation) -> Sequence[Any]:
    return item.observations if isinstance(item, Correlated) else (item,)


def _wrong(item: AnyObservation, rng: np.random.Generator) -> AnyObservation:
    """Return an observation with an error that is drawn by chance, of a size that is read at all.

    A distance is never negative, say.
    """
    size = 10.0 ** rng.uniform(0.5, 4.0) * rng.choice((-1.0, 1.0))
    while True:
        try:
            return _with_error(item, size)
        except InputError:
            size /= 10.0


def _with_error(item: AnyObservation, size: float) -> AnyObservation:
    """Return an observation with an error of a number of σ in its first value."""
    first, *rest = _members(item)
    if isinstance(first, ImagePoint):
        sigma = float(np.max(first.sigma))
        new: Any = replace(first, x=first.x + min(size * sigma, 3.0))
    else:
        covariance = getattr(first, "covariance", None)
        own = getattr(first, "sigma", None)
        if covariance is not None:
            sigma = float(np.sqrt(covariance[0, 0]))
        else:
            sigma = float(np.max(np.asarray(getattr(own, "constant", own), dtype=float)))
        if isinstance(first.value, tuple):
            new = replace(first, value=(first.value[0] + size * sigma, *first.value[1:]))
        else:
            new = replace(first, value=first.value + size * sigma)
    return Correlated((new, *rest), item.covariance) if isinstance(item, Correlated) else new


def play(
    seed: int, engine: Engine = "auto", arrivals: list[Arrival] | None = None
) -> Iterator[Compared]:
    """Play a day, and compare.

    Args:
        seed: of the day.
        engine: what carries it.
        arrivals: to which is added what each command came to.
    """
    described, every = drawn(seed)
    rng = np.random.default_rng([seed, 7])
    inc = Recorded(described, policy=POLICIES[seed % len(POLICIES)], engine=engine)
    if arrivals is not None:
        inc.arrivals = arrivals
    groups = list(_cut([every[i] for i in rng.permutation(len(every))], rng))
    stops = set((rng.permutation(len(groups))[:MOMENTS]).tolist())
    there: dict[str, AnyObservation] = {}
    for number, group in enumerate(groups):
        coming = [_wrong(i, rng) if rng.random() < WRONG else i for i in group]
        _tried(lambda coming=coming: inc.add(coming), inc)
        here = _there(inc)
        there |= {ids_of(i)[0]: i for i in coming if ids_of(i)[0] in here}
        _something_else(inc, there, rng)
        if number in stops and len(inc):
            yield compare(inc, seed, f"after {number + 1} of {len(groups)}")
    if not len(inc):
        return
    yield compare(inc, seed, "in the evening")
    inc.settle()
    if len(inc):
        yield compare(inc, seed, "settled")


def _something_else(
    inc: IncrementalAdjustment, there: dict[str, AnyObservation], rng: np.random.Generator
) -> None:
    """Take observations out, some of which come back, change weights, decide on suspects."""
    here = _there(inc)
    if rng.random() < LEAVES and here:
        ids = [here[i] for i in rng.permutation(len(here))[: rng.integers(1, 4)]]
        _tried(lambda: inc.remove(ids), inc)
        gone = set(here) - set(_there(inc))
        back = [o for i, o in there.items() if gone.issuperset(ids_of(o))]
        if back and rng.random() < 0.6:
            _tried(lambda: inc.add(back), inc)
    if rng.random() < CHANGES and (here := _there(inc)):
        one, factor = here[int(rng.integers(len(here)))], 2.0 ** int(rng.integers(-3, 4))
        _tried(lambda: inc.reweight([one], factor), inc)
    suspects = [v.id for v in inc.suspects]
    if suspects and rng.random() < DECIDED:
        one = suspects[int(rng.integers(len(suspects)))]
        decide = inc.accept if rng.random() < 0.5 else inc.discard
        _tried(lambda: decide([one]), inc)


def _tried(event: Any, inc: IncrementalAdjustment) -> None:
    """Let something happen that may be refused, which changes nothing then."""
    before = _there(inc)
    try:
        event()
    except AdjustmentError:
        assert sorted(_there(inc)) == sorted(before)


def _there(inc: IncrementalAdjustment) -> list[str]:
    network = inc.described
    out = [*network.observations, *(i for o in network.image_points() for i in ids_of(o))]
    out += [w.id for w in inc.waiting]
    return out + [v.id for v in (*inc.suspects, *inc.rejected)]


def _cut(
    some: Sequence[AnyObservation], rng: np.random.Generator
) -> Iterator[list[AnyObservation]]:
    at = 0
    while at < len(some):
        n = 1 if rng.random() < 0.7 else int(rng.integers(2, TOGETHER + 1))
        yield list(some[at : at + n])
        at += n


def compare(inc: IncrementalAdjustment, seed: int, when: str) -> Compared:
    """Compare a state with the batch adjustment of the same observations."""
    out = Compared(seed, when)
    try:
        ours = inc.solution()
    except AdjustmentError as error:
        return replace(out, unlike=f"no solution: {error}")
    if not ours.converged:
        return replace(out, unlike=f"told: {ours.reason}")
    try:
        theirs = batch(inc)
    except AdjustmentError as error:
        return replace(out, unlike=f"no batch adjustment: {error}")
    if not theirs.converged:
        return replace(out, unlike=f"no batch adjustment: {theirs.reason}")
    out = replace(out, told=bool(ours.second_places))
    found = difference(ours, theirs, shared=True)
    estimates, sigmas = found.estimates, found.sigmas
    for name in inc.network().points:  # what is asked for directly
        if theirs.equations.unknowns["point"].offset[theirs.number("point", name)] >= 0:
            free, sigma = deviations(theirs, "point", name)
            if free.any():
                moved = np.abs(inc.estimate(name) - theirs.point(name))[free] / sigma[free]
                own = inc.standard_deviations(name)[free] / sigma[free]
                estimates = max(estimates, float(moved.max()))
                sigmas = max(sigmas, float(np.abs(own - 1.0).max()))
    out = replace(out, estimates=estimates, sigmas=sigmas)
    if out.outside:
        out = replace(out, rounding=max(_apart_from(start, theirs) for start in _near(theirs)))
    try:
        anew = adjust(inc.network())
    except AdjustmentError:
        return out
    if anew.converged:
        less = theirs.vtpv - anew.vtpv
        if less > LOWER * (1.0 + theirs.vtpv):
            out = replace(out, lower=less)
    return out


def _near(solution: Solution) -> Iterator[Start]:
    """Return places some thousandths of a σ from a minimum, from which others end in it again."""
    unknowns, rng = solution.equations.unknowns, np.random.default_rng(5)
    diagonal = solution.normal().diagonal
    each = np.where(unknowns.free & (diagonal > 0), 1e-3 / np.sqrt(np.fmax(diagonal, 1e-300)), 0.0)
    for _ in range(PLACES):
        state = unknowns.retract(solution.state, each * rng.normal(size=unknowns.n_columns))
        yield Start(unknowns, state, solution.start)


def _apart_from(start: Start, theirs: Solution) -> float:
    """Return how far a batch adjustment from another start is from one at the same minimum."""
    with suppress(AdjustmentError):
        again = adjust(theirs.equations.network, start=start, tolerance=1e-9)
        rests = (
            again.converged or again.reason == NOT_ON_INNER_CONSTRAINTS
        )  # which rounding may hide, too
        # The same minimum, whose vᵀPv has rounding too.
        if rests and abs(again.vtpv - theirs.vtpv) <= LOWER * (1.0 + theirs.vtpv):
            return difference(again, theirs, shared=True).largest
    return 0.0
