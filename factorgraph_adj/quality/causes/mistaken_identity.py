"""Rejected readings that fit as another target, in the other face, or with ends or x, y exchanged.

Readings with very large errors distort an adjustment beyond its linear model. In the solution
without them each is computed again as if its target were another point, its ends were exchanged, it
were read in the other face, or the image axes were others. If all readings of a sight fit then,
this explains them. Where a list gave the height of a target by its name, the wrong name has brought
the wrong height: another point is tried with the heights that are recorded with its name, too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ...errors import AdjustmentError, InputError
from ...graph.equations import Equations
from ...observations import Observation
from ...observations.registry import CONTROL_QUANTITIES, TOTAL_STATION_QUANTITIES
from ...solve.solution import Solution
from ...types import Array, Index
from ..innovations import Innovations
from ..prediction import predict
from .evidence import VarianceFactor
from .readings import ONE_TARGET, TARGET_HEIGHT, Readings, most_recorded_heights

MAX_RENAMED_SIGHTS = 100
"""Largest number of sights for which other targets are tried, those that fit worst."""
MAX_TRIED_TARGETS = 5
"""Number of other targets that are tried for a sight: those that fit best."""
MAX_TRIED_HEIGHTS = 3
"""Largest number of recorded heights with which another target is tried: those most recorded."""
MAX_PREDICTION_VARIANCE_RATIO = 1e4
"""Largest ratio of the variance of a prediction to that of the reading: a point that the clean
solution hardly determines fits everything."""
MAX_TARGETS_OF_FRAME = 12
"""Largest number of targets of a frame of which two are tried as exchanged, those of which most
was rejected."""
EXCHANGED_TARGETS = "two targets, exchanged:"
"""Cause of two targets that fit as each other."""
WRONG_TARGET_NAME = "the name of the target"
"""Cause of a target that fits as another point."""
WITH_HEIGHT = ", with the height that goes with the name"
"""What is added where the height of the target is that of the wrong name as well."""


@dataclass(frozen=True)
class MistakenIdentity:
    """Readings that fit under another identity."""

    cause: str
    """What is wrong."""
    where: str
    """The place, and what is right."""
    ids: tuple[str, ...]
    """Ids of the readings."""
    before: float
    """T² / σ0² of the readings as they are, predicted from the clean solution."""
    after: float
    """T² / σ0² of the readings as they fit."""
    sight: tuple[str, str, str] | None = None
    """Station, target and the point that it is, of one sight."""
    moved: bool = False
    """Whether the height of the target is that of the wrong name as well."""
    same: tuple[str, ...] = ()
    """Other places, after which all readings would fit as well."""

    def judged_by(self, variance: float) -> MistakenIdentity:
        """Return it with T² divided by σ0²."""
        return replace(self, before=self.before / variance, after=self.after / variance)


def mistaken_identities(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> tuple[MistakenIdentity, ...]:
    """Search for the identities under which rejected observations fit.

    Args:
        equations: the network with them.
        clean: the solution without them.
        ids: their ids.
        alpha: probability with which a reading that is right does not fit.
        weight: σ0² of the clean solution.

    Returns:
        The matches, those that explain most first; T² for σ0 = 1.
    """
    network = equations.network
    aside = {i: network.observations[i] for i in ids if i in network.observations}
    if not aside:
        return ()
    readings = Readings.of(equations, Innovations(equations, clean).state)
    search = _Search(clean, network.observations, aside, weight.limit(1, alpha))
    found = [*search.sights(readings), *search.vectors(), *search.faces(), *search.places()]
    return tuple(sorted(merged_exchanges(found), key=lambda m: m.after - m.before))


class _Search:
    """The search among observations that were rejected."""

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
            found = predict(self.clean, [replace(o, id=None) for o in changed])
        except AdjustmentError:
            return np.nan
        fits = found.t2 <= self.critical * found.size
        return float(found.t2.sum()) if fits.all() else np.nan

    def _as_is(self, ids: Sequence[str]) -> float:
        try:
            found = predict(self.clean, [replace(self.every[i], id=None) for i in ids])
        except AdjustmentError:
            return np.inf
        return float(found.t2.sum())

    def _match(
        self, cause: str, where: str, ids: Sequence[str], changed: Sequence[Observation]
    ) -> MistakenIdentity | None:
        after = self._fit(changed)
        if np.isnan(after):
            return None
        return MistakenIdentity(cause, where, tuple(ids), self._as_is(ids), after)

    def sights(self, r: Readings) -> Iterator[MistakenIdentity]:
        """Iterate over sights to another point of the list."""
        r = r.of_quantities(ONE_TARGET)
        ids = [r.equations.id(int(row)) for row in r.row]
        aside = np.array([i in self.aside for i in ids], dtype=bool)
        ends = list(zip(r.station.tolist(), r.target.tolist(), strict=True))
        touched = {end for end, out in zip(ends, aside.tolist(), strict=True) if out}
        keep = np.array([end in touched for end in ends], dtype=bool)
        r, aside = r.only(keep), aside[keep]
        if not len(r.row):
            return
        names = r.equations.unknowns["point"].names
        recorded = self._recorded_heights()
        sigma = r.equations.sigmas()[r.row]
        # A reading that the clean solution does not determine has no other explanation.
        misfit = np.nan_to_num(np.square((r.computed - r.observed) / sigma))
        sights, group = np.unique(np.stack([r.station, r.target], 1), axis=0, return_inverse=True)
        group = group.ravel()
        worst = np.argsort(-np.bincount(group, misfit), kind="stable")[:MAX_RENAMED_SIGHTS]
        for number in worst.tolist():
            station, target = sights[number].tolist()
            rows = np.flatnonzero(group == number)
            # Where all readings of a kind have stayed in, either the target was the right one, or
            # they fit by chance: then all readings of the sight fit the other target.
            if set(r.quantity[rows[aside[rows]]].tolist()) == set(r.quantity[rows].tolist()):
                rows = rows[aside[rows]]
            # A single distance or zenith angle fits another point by chance.
            if len(rows) == 1 and r.quantity[rows[0]] not in ("direction", "azimuth"):
                continue
            own = [r.equations.id(int(row)) for row in r.row[rows]]
            part = r.only(rows)
            places, heights = _tried_targets(names, recorded, part.constant(TARGET_HEIGHT))
            change = r.only(np.tile(rows, len(places))).with_targets(
                np.repeat(places, len(rows)), heights.ravel()
            )
            left = (part.computed - part.observed)[None, :] + change.reshape(len(places), -1)
            size = np.square(left / sigma[rows]).sum(axis=1)
            best = np.argsort(size)[:MAX_TRIED_TARGETS]
            for b in best[
                size[best] < MAX_PREDICTION_VARIANCE_RATIO * self.critical * len(rows)
            ].tolist():
                right = names[int(places[b])]
                try:
                    changed = [
                        _read_to_target(self.every[i], right, h)
                        for i, h in zip(own, heights[b].tolist(), strict=True)
                    ]
                except InputError:  # the station itself
                    continue
                moved = bool(np.any(heights[b] != part.constant(TARGET_HEIGHT)))
                seen = f"{names[target]!r} seen from {names[station]!r}"
                where = f"{seen}, which is {right!r}{WITH_HEIGHT if moved else ''}"
                if found := self._match(WRONG_TARGET_NAME, where, own, changed):
                    sight = (names[station], names[target], right)
                    yield replace(found, sight=sight, moved=moved)
                    break

    def _recorded_heights(self) -> dict[str, tuple[float, ...]]:
        """Return the heights of targets by the name of the target, those most recorded first."""
        every = most_recorded_heights(
            (o.target, getattr(o, TARGET_HEIGHT))  # type: ignore[attr-defined]
            for o in self.every.values()
            if o.record.quantity in TOTAL_STATION_QUANTITIES and hasattr(o, TARGET_HEIGHT)
        )
        return {name: heights[:MAX_TRIED_HEIGHTS] for name, heights in every.items()}

    def vectors(self) -> Iterator[MistakenIdentity]:
        """Iterate over GNSS vectors with start and end, or x and y, exchanged, and positions."""
        o: Any
        for i, o in self.aside.items():
            ways: dict[str, tuple[float, ...]]
            if o.record.quantity == "vector":
                x, y, z = o.value
                where = f"of vector {o.station!r} – {o.target!r}"
                ways = {"start and end, exchanged,": (-x, -y, -z), "x and y, exchanged,": (y, x, z)}
            elif o.record.quantity in CONTROL_QUANTITIES and o.axes[:2] in ("xy", "en"):
                x, y, *rest = o.value
                where = f"of the position of {o.point!r}"
                ways = {"x and y, exchanged,": (y, x, *rest)}
            else:
                continue
            for cause, value in ways.items():
                other = replace(o, value=value)
                if found := self._match(cause, where, [i], [other]):
                    yield found
                    break

    def faces(self) -> Iterator[MistakenIdentity]:
        """Iterate over horizontal readings in the other face."""
        o: Any
        for i, o in self.aside.items():
            if o.record.quantity in ("direction", "azimuth"):
                other = replace(o, value=(o.value + np.pi) % (2 * np.pi))
                where = f"of the sight {o.station!r} – {o.target!r}"
                if found := self._match("the face of the circle", where, [i], [other]):
                    yield found

    def places(self) -> Iterator[MistakenIdentity]:
        """Iterate over two targets that are exchanged in a frame of its own, and over wrong names.

        All that was measured of both in the frame must fit the other one; all of a single target
        another point.
        """
        own: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        for i, o in self.every.items():
            if o.record.in_frame != "nothing" and len(o.record.points) == 1 and o.points():
                own[o.frames()[0]][o.points()[0]].append(i)
        for frame, targets in own.items():
            counts = {n: sum(i in self.aside for i in ids) for n, ids in targets.items()}
            touched = sorted((n for n, c in counts.items() if c), key=lambda n: -counts[n])
            done: set[str] = set()
            for a, b in combinations(sorted(touched[:MAX_TARGETS_OF_FRAME]), 2):
                if done & {a, b}:
                    continue
                ids = [*targets[a], *targets[b]]
                changed = [_to_place(self.every[i], {a: b, b: a}) for i in ids]
                where = f"{a!r} and {b!r} in frame {frame!r}"
                if found := self._match(EXCHANGED_TARGETS, where, ids, changed):
                    done |= {a, b}
                    yield found
            for a in touched[:MAX_TARGETS_OF_FRAME]:
                if a not in done:
                    yield from self._named(frame, a, targets[a])

    def _named(self, frame: str, a: str, ids: Sequence[str]) -> Iterator[MistakenIdentity]:
        """Iterate over the point that a target of a frame is, if all that was measured fits it."""
        if len(ids) < 2 and self.every[ids[0]].record.in_frame != "coordinates":
            return  # a single reading fits another point by chance
        fits = []
        for b in self.clean.network.points:
            if b != a:
                changed = [_to_place(self.every[i], {a: b}) for i in ids]
                where = f"{a!r} in frame {frame!r}, which is {b!r}"
                if found := self._match(WRONG_TARGET_NAME, where, ids, changed):
                    fits.append(found)
        yield from sorted(fits, key=lambda m: m.after)[:1]


def _to_place(o: Observation, names: Mapping[str, str]) -> Observation:
    """Return an observation in a frame as if it had been made to another target."""
    (attribute,) = o.record.points
    return replace(o, **{attribute: names[getattr(o, attribute)]})


def merged_exchanges(found: Sequence[MistakenIdentity]) -> Iterator[MistakenIdentity]:
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
        where += WITH_HEIGHT if m.moved or other.moved else ""
        before, after = m.before + other.before, m.after + other.after
        yield MistakenIdentity(EXCHANGED_TARGETS, where, (*m.ids, *other.ids), before, after)


def _tried_targets(
    names: Sequence[str], recorded: Mapping[str, tuple[float, ...]], own: Array
) -> tuple[Index, Array]:
    """Return the points that a sight is tried to, (k,), and heights of the target there, (k, m).

    Args:
        names: names of all points, (n,).
        recorded: heights that are recorded with each name.
        own: heights that are recorded with the readings of the sight, (m,).
    """
    places, heights = [*range(len(names))], [own] * len(names)
    for number, name in enumerate(names):
        for height in recorded.get(name, ()):
            if np.any(own != height):
                places.append(number)
                heights.append(np.full(len(own), height))
    return np.array(places, dtype=np.intp), np.array(heights).reshape(len(places), len(own))


def _read_to_target(o: Observation, target: str, height: float) -> Observation:
    """Return a reading as if it had been read to another target, at a height.

    Raises:
        InputError: the target is the station.
    """
    changes: dict[str, Any] = {"target": target}
    if hasattr(o, TARGET_HEIGHT):
        changes[TARGET_HEIGHT] = height
    return replace(o, **changes)
