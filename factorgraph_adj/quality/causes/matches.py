"""Readings that do not fit, but would if they were something else: looked up in a clean solution.

Readings that are far off bend an adjustment so that its linear model says nothing of them. In the
solution without them each is computed again as if its target were another point, its ends were
exchanged, it were read in the other face, or the image axes were others. Where all readings of a
sight fit then, that is what happened.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import AdjustmentError, InputError
from ...graph.equations import Equations
from ...observations import Azimuth, Direction, GnssVector, Observation
from ...solve.solution import Solution
from ..distributions import chi2_quantile
from ..innovations import Innovations
from ..prediction import predict
from .hypotheses import SIGHTS
from .readings import Readings

MOST = 100
"""Largest number of sights for which other targets are looked for, those that fit worst."""
TRIED = 5
"""Number of other targets that are tried for a sight: those that fit best."""
WEAK = 1e4
"""Largest ratio of the variance of a prediction to that of the reading: a point that the clean
solution hardly determines fits everything."""


@dataclass(frozen=True)
class Match:
    """Readings that fit as something else."""

    cause: str
    """What is wrong."""
    where: str
    """The place, and what is right."""
    ids: tuple[str, ...]
    """Ids of the readings."""
    before: float
    """T² of the readings as they are, predicted from the clean solution."""
    after: float
    """T² of the readings as they fit."""
    sight: tuple[str, str, str] | None = None
    """Station, target and the point that it is, of one sight."""


def matches(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float
) -> tuple[Match, ...]:
    """Look for what observations that were set aside may be.

    Args:
        equations: the network with them.
        clean: the solution without them.
        ids: their ids.
        alpha: probability with which a reading that is right does not fit.
    """
    network = equations.network
    aside = {i: network.observations[i] for i in ids if i in network.observations}
    if not aside:
        return ()
    readings = Readings.of(equations, Innovations(equations, clean).state)
    search = _Search(clean, network.observations, aside, chi2_quantile(1.0 - alpha, 1))
    found = [*search.sights(readings), *search.vectors(), *search.faces()]
    return tuple(sorted(_both_ways(found), key=lambda m: m.after - m.before))


class _Search:
    """The search among observations that were set aside."""

    def __init__(
        self,
        clean: Solution,
        every: Mapping[str, Observation],
        aside: Mapping[str, Observation],
        critical: float,
    ) -> None:
        self.clean, self.every, self.aside, self.critical = clean, every, aside, critical

    def _fit(self, changed: Sequence[Observation]) -> float:
        """Return T² of readings, each predicted from the clean solution; NaN: one does not fit."""
        try:
            found = predict(self.clean, [replace(o, id=None) for o in changed])  # type: ignore[call-arg]
        except AdjustmentError:
            return np.nan
        fits = found.t2 <= self.critical * found.size
        return float(found.t2.sum()) if fits.all() else np.nan

    def _as_is(self, ids: Sequence[str]) -> float:
        try:
            found = predict(self.clean, [replace(self.every[i], id=None) for i in ids])  # type: ignore[call-arg]
        except AdjustmentError:
            return np.inf
        return float(found.t2.sum())

    def _match(
        self, cause: str, where: str, ids: Sequence[str], changed: Sequence[Observation]
    ) -> Match | None:
        after = self._fit(changed)
        if np.isnan(after):
            return None
        return Match(cause, where, tuple(ids), self._as_is(ids), after)

    def sights(self, r: Readings) -> Iterator[Match]:
        """Iterate over sights to another point of the list."""
        r = r.of_kinds(*(k for k in SIGHTS if k != "horizontal_angle"))
        ids = [r.equations.id(int(row)) for row in r.row]
        aside = np.array([i in self.aside for i in ids], dtype=bool)
        ends = list(zip(r.station.tolist(), r.target.tolist(), strict=True))
        touched = {end for end, out in zip(ends, aside.tolist(), strict=True) if out}
        keep = np.array([end in touched for end in ends], dtype=bool)
        r, aside = r.only(keep), aside[keep]
        if not len(r.row):
            return
        names = r.equations.unknowns["point"].names
        n = len(names)
        sigma = r.equations.sigmas()[r.row]
        # What the clean solution does not determine tells nothing of what it may be.
        misfit = np.nan_to_num(np.square((r.computed - r.observed) / sigma))
        sights, group = np.unique(np.stack([r.station, r.target], 1), axis=0, return_inverse=True)
        group = group.ravel()
        worst = np.argsort(-np.bincount(group, misfit), kind="stable")[:MOST]
        for number in worst.tolist():
            station, target = sights[number].tolist()
            rows = np.flatnonzero(group == number)
            # Where all readings of a kind have stayed in, either the target was the right one, or
            # they fit by chance: then all readings of the sight fit the other target.
            if set(r.kind[rows[aside[rows]]].tolist()) == set(r.kind[rows].tolist()):
                rows = rows[aside[rows]]
            # A single distance or zenith angle fits another point by chance.
            if len(rows) == 1 and r.kind[rows[0]] not in ("direction", "azimuth"):
                continue
            own = [r.equations.id(int(row)) for row in r.row[rows]]
            part, every = r.only(rows), np.tile(rows, n)
            change = r.only(every).with_targets(np.repeat(np.arange(n), len(rows)))
            left = (part.computed - part.observed)[None, :] + change.reshape(n, -1)
            size = np.square(left / sigma[rows]).sum(axis=1)
            best = np.argsort(size)[:TRIED]
            for b in best[size[best] < WEAK * self.critical * len(rows)].tolist():
                try:
                    changed = [replace(self.every[i], target=names[b]) for i in own]  # type: ignore[call-arg]
                except InputError:  # the station itself
                    continue
                seen = f"{names[target]!r} seen from {names[station]!r}"
                where = f"{seen}, which is {names[b]!r}"
                if found := self._match("the name of the target", where, own, changed):
                    yield replace(found, sight=(names[station], names[target], names[b]))
                    break

    def vectors(self) -> Iterator[Match]:
        """Iterate over GNSS vectors with start and end exchanged."""
        for i, o in self.aside.items():
            if isinstance(o, GnssVector):
                x, y, z = o.value
                other = replace(o, value=(-x, -y, -z))
                where = f"of vector {o.station!r} – {o.target!r}"
                if found := self._match("start and end, exchanged,", where, [i], [other]):
                    yield found

    def faces(self) -> Iterator[Match]:
        """Iterate over horizontal readings in the other face."""
        for i, o in self.aside.items():
            if isinstance(o, Direction | Azimuth):
                other = replace(o, value=(o.value + np.pi) % (2 * np.pi))
                where = f"of the sight {o.station!r} – {o.target!r}"
                if found := self._match("the face of the circle", where, [i], [other]):
                    yield found


def _both_ways(found: Sequence[Match]) -> Iterator[Match]:
    """Iterate over matches; two targets that are each other become one exchange."""
    sights = {m.sight: m for m in found if m.sight is not None}
    done: set[tuple[str, str, str]] = set()
    for m in found:
        if m.sight is None:
            yield m
            continue
        station, a, b = m.sight
        other = sights.get((station, b, a))
        if m.sight in done:
            continue
        if other is None:
            yield m
            continue
        done |= {(station, b, a)}
        a, b = sorted((a, b))
        where = f"{a!r} and {b!r} seen from {station!r}"
        before, after = m.before + other.before, m.after + other.after
        yield Match("two targets, exchanged:", where, (*m.ids, *other.ids), before, after)
