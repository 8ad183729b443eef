"""An adjustment of the site that is watched: what must be there is there, errors change nothing."""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from factorgraph_adj import AdjustmentError, IncrementalAdjustment, Network
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.observations import AnyObservation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.networks.site import LATER, empty_site, plan
from tests.support.arrivals import batch, difference, ids_of, items

ROUNDING = 1e-9
"""Largest change of a coordinate by rounding, relative or in metres."""
STILL = 1e-3
"""Largest change by rounding in a network that is hardly determined, relative to σ."""
PROMISE = 1e-2
"""Largest deviation from the batch adjustment at any time, relative to σ."""
AT_REST = 1e-6
"""Largest deviation from the batch adjustment after `settle`, relative to σ."""


@dataclass
class Checked:
    """A comparison with the batch adjustment of the same observations."""

    event: int
    """After how many events."""
    observations: int
    """In the graph."""
    estimates: float
    """Largest deviation of an estimate, relative to σ."""
    sigmas: float
    """Largest relative deviation of a σ."""
    settled_estimates: float
    """The same, after `settle`."""
    settled_sigmas: float


class Broken(AssertionError):
    """The adjustment did what it must not do."""


@cache
def measured_site(seed: int) -> tuple[Network, tuple[AnyObservation, ...]]:
    """Return the site, measured, and its observations."""
    measured = measure(plan(), seed=seed)
    return measured, tuple(items(measured))


class Watched:
    """An adjustment that begins in the morning, and a list of what must be in it."""

    def __init__(self, seed: int, policy: Policy = "flag", journal: Path | None = None) -> None:
        """Begin.

        Args:
            seed: seed of the errors of the observations.
            policy: what becomes of an arrival that fails its test.
            journal: new file of the journal; none: without.
        """
        self.measured, self.pool = measured_site(seed)
        self.journal = journal
        self.inc = IncrementalAdjustment(empty_site(self.measured), policy=policy, journal=journal)
        self.there: dict[str, None] = {}
        """Ids that must be somewhere, in the order of arrival."""
        self.odd: set[str] = set()
        """Those that are not what was measured."""
        self.coming_points: list[Point] = [
            p for n, p in self.measured.points.items() if self._later(n)
        ]
        self.coming_photos: list[Photo] = [
            f for n, f in self.measured.photos.items() if self._later(n)
        ]
        self.n = 0
        """Number of events so far."""
        self.done: Counter[str] = Counter()
        """Events, errors among them, by what they were."""
        self.trace: Callable[[str], None] | None = None
        """Called with a description of every event."""

    def _later(self, name: str) -> bool:
        return name[0] in "PF" and int(name[1:]) >= LATER

    # -- one event ----------------------------------------------------------------------------

    def play(self, name: str, event: Callable[[], None]) -> None:
        """Play one event, and check that what must be there is there."""
        self.n += 1
        before = self.state()
        points = self.estimates(before["known"])
        try:
            event()
        except AdjustmentError as error:
            self.done[f"{name}: {type(error).__name__}"] += 1
            if not str(error):
                raise Broken(f"event {self.n}: {name}: an error without words") from error
            if (after := self.state()) != before:
                raise Broken(f"event {self.n}: {name}: {_changed(before, after)}") from error
            self._check_points(name, points, before["known"])
        else:
            self.done[name] += 1
        self.check_ids(name)

    def state(self) -> dict[str, Any]:
        """Return what there is."""
        inc = self.inc
        described = inc.described
        found = [n for n in described.points if inc.determined(n)]
        inside = [*described.observations, *(ids_of(i)[0] for i in described.image_points())]
        return {
            "in the graph": tuple(inside),
            "waiting": tuple(w.id for w in inc.waiting),
            "suspects": tuple(v.id for v in inc.suspects),
            "rejected": tuple(v.id for v in inc.rejected),
            "points": tuple(described.points),
            "photos": tuple(described.photos),
            "cameras": tuple(described.cameras),
            "rows": inc.n_observations,
            "redundancy": inc.redundancy,
            "known": tuple(found),
        }

    def estimates(self, names: Sequence[str]) -> Array:
        """Return the coordinates of points."""
        return np.array([self.inc.estimate(n) for n in names]).reshape(-1, 3)

    def _check_points(self, event: str, before: Array, names: Sequence[str]) -> None:
        """Estimates are as before, to rounding: the latest rows may have gone into the tree."""
        off = np.abs(self.estimates(names) - before)
        moved = off > ROUNDING * np.maximum(1.0, np.abs(before))
        for i in np.flatnonzero(moved.any(axis=1)).tolist():
            sigma = self.inc.standard_deviations(names[i])
            if np.any(off[i] > STILL * sigma + ROUNDING):
                raise Broken(f"event {self.n}: {event}: {names[i]} moved by {off[i]}, σ {sigma}")

    def check_ids(self, event: str) -> None:
        s = self.state()
        found = [*s["in the graph"], *s["waiting"], *s["suspects"], *s["rejected"]]
        if len(found) != len(set(found)):
            twice = [i for i, k in Counter(found).items() if k > 1]
            raise Broken(f"event {self.n}: {event}: twice there: {twice[:5]}")
        if set(found) != set(self.there):
            lost, more = set(self.there) - set(found), set(found) - set(self.there)
            raise Broken(f"event {self.n}: {event}: lost {lost}, unexpected {more}")
        if any(not w.lacks for w in self.inc.waiting):
            raise Broken(f"event {self.n}: {event}: something waits and does not say why")
        if s["redundancy"] < 0:
            raise Broken(f"event {self.n}: {event}: redundancy {s['redundancy']}")

    def compare(self) -> Checked:
        """Compare with the batch adjustment, before and after `settle`.

        Where readings that are wrong leave the batch without an answer, the solution must say so,
        and be right again as soon as they are taken out.
        """
        inc = self.inc
        if not inc.n_observations:
            return Checked(self.n, len(inc), 0.0, 0.0, 0.0, 0.0)
        try:
            reference = batch(inc)
            if not reference.converged:
                raise AdjustmentError(reference.reason)
        except AdjustmentError as error:
            self.done[f"no answer: {type(error).__name__}"] += 1
            self.say(f"the batch has no answer: {error}")
            if inc.solution().converged:
                raise Broken(f"event {self.n}: a solution where the batch has none") from error
            if not self.odd & set(self.there):
                raise Broken(f"event {self.n}: no answer, and nothing is wrong") from error
            self.remove(sorted(self.odd & set(self.there)))
            return self.compare()
        before = difference(inc.solution(), reference)
        inc.settle()
        after = difference(inc.solution(), batch(inc))
        found = Checked(
            self.n, len(inc), before.estimates, before.sigmas, after.estimates, after.sigmas
        )
        gc.collect()
        return found

    def assert_as_batch(self) -> None:
        """The solution is that of the batch, before and after `settle`."""
        found = self.compare()
        assert max(found.estimates, found.sigmas) < PROMISE, found
        assert max(found.settled_estimates, found.settled_sigmas) < AT_REST, found

    def say(self, text: str) -> None:
        if self.trace is not None:
            self.trace(f"{self.n}: {text}")

    def add(self, what: AnyObservation | list[AnyObservation], *, odd: bool = False) -> None:
        """Add, and note what is there now."""
        listed = what if isinstance(what, list) else [what]
        self.say(f"add {listed}")
        arrival = self.inc.add(what)
        given = [i for item in listed for i in ids_of(item)]
        if [v.id for v in arrival.verdicts[: len(given)]] != given:
            raise Broken(f"event {self.n}: verdicts of {[v.id for v in arrival.verdicts]}")
        for item in listed:
            self.there.update(dict.fromkeys(ids_of(item)))
            (self.odd.update if odd else self.odd.difference_update)(ids_of(item))

    def remove(self, ids: list[str]) -> None:
        self.say(f"remove {ids}")
        self.inc.remove(ids)
        for i in ids:
            self.there.pop(i, None)
            self.odd.discard(i)

    def ask(self) -> None:
        """What is asked changes nothing; reliability may linearise anew."""
        before = self.state()
        names = before["known"]
        points = self.estimates(names)
        self.say("ask")
        solution = self.inc.solution()
        assert len(solution.point_covariances)
        for name in names:
            assert np.all(self.inc.standard_deviations(name) >= 0)
        self._check_points("asking", points, names)
        self.inc.reliability()
        after = self.state()
        if after != before:
            raise Broken(f"event {self.n}: asking: {_changed(before, after)}")

    def resume(self) -> None:
        """Go on from the journal, as after a crash: all is as it was, estimates are at rest."""
        # Whether a held point is answered for that nothing observes (any more) is not recorded.
        held = {n for n, p in self.inc.described.points.items() if all(p.fixed)}
        before = self.state()
        names = tuple(n for n in before["known"] if n not in held)
        before["known"] = names
        points = self.estimates(names)
        sigmas = np.array([self.inc.standard_deviations(n) for n in names]).reshape(-1, 3)
        solution = self.inc.solution() if self.inc.n_observations else None
        sound = solution is not None and solution.converged
        self.say("resume")
        assert self.journal is not None
        del self.inc  # the journal is in use until then
        gc.collect()
        self.inc = IncrementalAdjustment.resume(self.journal)
        after = self.state()
        after["known"] = tuple(n for n in after["known"] if n not in held)
        if any(_sorted(after[k]) != _sorted(v) for k, v in before.items()):
            raise Broken(f"event {self.n}: resuming: {_changed(before, after)}")
        moved = np.abs(self.estimates(names) - points) - PROMISE * sigmas
        if sound and np.any(moved > ROUNDING * np.maximum(1.0, np.abs(points))):
            # A zenith angle and two coordinates leave two places, of which either is right.
            again = self.inc.solution()
            if again.vtpv != pytest.approx(solution.vtpv, rel=1e-6):
                raise Broken(f"event {self.n}: resuming moved points")


def _sorted(value: Any) -> Any:
    return sorted(value) if isinstance(value, tuple) else value


def _changed(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Say what differs."""
    out = []
    for k, old in before.items():
        if old != after[k]:
            new = after[k]
            if isinstance(old, tuple):
                out.append(f"{k}: gone {set(old) - set(new)}, new {set(new) - set(old)}")
            else:
                out.append(f"{k}: {old} → {new}")
    return "changed: " + "; ".join(out)[:600]
