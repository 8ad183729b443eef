"""A site on which observations come and go by chance, nonsense and degenerate geometry among them.

`Soak` plays seeded events against an `IncrementalAdjustment` and keeps a list of its own of what
must be there: after every event each observation is in the graph, waiting, suspect or rejected,
and after every error everything is as it was.

As a program: ``python -m tests.support.soak EVENTS [SEED]`` prints a line at every thousandth
event.
"""

from __future__ import annotations

import gc
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from factorgraph_adj import AdjustmentError, IncrementalAdjustment, Network
from factorgraph_adj.experiment.simulate import look_at, measure
from factorgraph_adj.incremental.verdicts import Policy
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.entities import Photo, Point
from factorgraph_adj.observations import (
    AnyObservation,
    ControlPoint,
    Correlated,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    ImagePoint,
    Observation,
    PhotoPosition,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.stochastic import StandardDeviation
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.support.arrivals import batch, difference, ids_of, items

UNKNOWN = (np.nan, np.nan, np.nan)
CONTROL = {"A": (0.0, 0.0, 0.0), "B": (60.0, 5.0, 1.0), "C": (20.0, 50.0, -1.0)}
STATIONS = {"S1": (10.0, 8.0, 1.0), "S2": (45.0, 12.0, 0.5), "S3": (30.0, 40.0, 2.0)}
LATER = 6
"""Points and photos of the site from this number on arrive during the day."""
NOISE = 1e-3
"""Metres, of distances."""
ROUNDING = 1e-9
"""Of coordinates, relative or metres,"""
STILL = 1e-3
"""or relative to σ: of networks that are hardly determined."""
BELIEVED = 0.1
"""Part of the wrong readings put in after all that stay; the others go at once."""
OTHERS = {
    "A/twin": CONTROL["A"],
    "A/above": (0.0, 0.0, 30.0),
    "S1/above": (10.03, 8.0, 30.0),
    "far": (1e5, 0.0, 0.0),
    "thin": UNKNOWN,
    "unused": UNKNOWN,
}
"""Points of the degenerate cases: at the place of A, exactly above it, steeply above S1 (nearer to
its vertical than some σ there is no answer for the batch either), seen in one direction only."""


def _targets() -> dict[str, tuple[float, float, float]]:
    rng = np.random.default_rng(1986)
    at = rng.uniform([5.0, 5.0, -2.0], [55.0, 45.0, 6.0], (14, 3))
    return {f"P{i}": tuple(row) for i, row in enumerate(at.tolist())}


def _centres() -> dict[str, tuple[float, float, float]]:
    turns = np.arange(8) * np.pi / 4
    at = [(30 + 35 * np.cos(t), 25 + 30 * np.sin(t), 14.0 + np.cos(3 * t)) for t in turns]
    return {f"F{i}": (float(x), float(y), float(z)) for i, (x, y, z) in enumerate(at)}


def plan() -> Network:
    """Return the site with its true values, and everything that can be observed on it, twice."""
    network = Network("site")
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz")
    for name, at in (STATIONS | _targets()).items():
        network.add_point(name, at)
    network.add_camera("cam", BrownLens(), {"c": 28.0, "k1": 1e-4}, free=("c",), sigma={"x0": 0.01})
    for name, centre in _centres().items():
        rotation = look_at(np.array(centre), np.array([30.0, 25.0, 1.0]))
        network.add_photo(name, "cam", position=centre, rotation=rotation)
    network.set_distance_meter("edm", scale=1e-5, zero=0.002, sigma_scale=1e-5, sigma_zero=0.003)
    network.set_refraction("air", value=0.13, sigma=0.05)
    network.set_vertical("S2", xi=3 * ARCSEC, eta=-2 * ARCSEC, sigma=5 * ARCSEC)
    for name in STATIONS:
        for number in "12":
            network.set_orientation(name, set=number, value=0.4)
    for repeat in "ab":
        _observe(network, repeat)
    return network


def _observe(network: Network, repeat: str) -> None:
    angle = StandardDeviation(5 * ARCSEC, centring_target=0.0003)
    every = [*CONTROL, *STATIONS, *_targets()]
    for s in STATIONS:
        for n, t in enumerate(x for x in every if x != s):
            name, heights = f"{s}-{t}-{repeat}", {"instrument_height": 1.5, "target_height": 0.2}
            number = "1" if repeat == "a" else "2"
            network.add(
                Direction(s, t, 0.0, sigma=angle, set=number, id=f"r{name}", **heights),
                ZenithAngle(
                    s, t, 1.5, sigma=8 * ARCSEC, refraction="air", id=f"z{name}", **heights
                ),
                SlopeDistance(
                    s,
                    t,
                    1.0,
                    sigma=StandardDeviation(NOISE, ppm=2.0),
                    instrument="edm",
                    id=f"d{name}",
                    **heights,
                ),
            )
            if n % 4 == 0:
                network.add(HorizontalAngle(s, "B", t, 0.0, sigma=5 * ARCSEC, id=f"w{name}")) if (
                    t not in ("B", s)
                ) else None
    for n, (a, b) in enumerate(permutations([*CONTROL, *_targets()], 2)):
        if n % 7 == 0:
            network.add(HeightDifference(a, b, 0.0, sigma=0.0008, id=f"h{a}-{b}-{repeat}"))
    c = 1e-6 * np.array([[4.0, 1.0, -0.5], [1.0, 3.0, 0.7], [-0.5, 0.7, 9.0]])
    for n, t in enumerate(_targets()):
        if n % 3 == 0:
            network.add(
                GnssVector("A", t, (0.0, 0.0, 0.0), covariance=c, id=f"v{t}-{repeat}"),
                ControlPoint(t, (0.0, 0.0), axes="xz", sigma=(0.004, 0.005), id=f"k{t}-{repeat}"),
                GnssPosition(t, (0.0, 0.0, 0.0), covariance=4 * c, id=f"g{t}-{repeat}"),
            )
        if n % 4 == 1:
            pair = (
                GnssVector("B", t, (0.0,) * 3, sigma=(0.002,) * 3, id=f"v1{t}-{repeat}"),
                HeightDifference("C", t, 0.0, sigma=0.002, id=f"v2{t}-{repeat}"),
            )
            rho = np.full((4, 4), 0.3) + 0.7 * np.eye(4)
            network.add(Correlated(pair, 4e-6 * rho))
    for f in _centres():
        lever = (0.1, -0.05, 0.1)
        network.add(
            PhotoPosition(f, (0.0,) * 3, sigma=(0.02,) * 3, lever_arm=lever, id=f"q{f}-{repeat}")
        )
        if repeat == "a":
            photo = network.photos[f]
            assert photo.rotation is not None
            for p in every:
                seen = photo.rotation.T @ np.subtract(network.points[p].coordinates, photo.position)
                if seen[2] > 5.0 and max(abs(seen[:2])) < 0.6 * seen[2]:
                    network.add(ImagePoint(f, p, 0.0, 0.0, sigma=0.004))


def empty_site(measured: Network) -> Network:
    """Return what is there in the morning: some points and photos, no observation."""
    out = Network("site")
    for name, p in measured.points.items():
        if name in CONTROL:
            out.add_point(name, p.coordinates, fixed="xyz")
        elif name in STATIONS or int(name[1:]) < LATER:
            known = name in STATIONS or int(name[1:]) % 2
            near = tuple(round(x, 1) for x in p.coordinates)
            out.add_point(name, near if known else UNKNOWN)
    for name, at in OTHERS.items():
        out.add_point(name, at, fixed="" if at is UNKNOWN else "xyz")
    out.cameras = dict(measured.cameras)
    for name, f in measured.photos.items():
        if int(name[1:]) < LATER:
            out.photos[name] = _arriving(f)
            out._photo_number[name] = len(out._photo_number)
    for kind in ("distance_meters", "refractions", "verticals"):
        getattr(out, kind).update(getattr(measured, kind))
    return out


def _arriving(photo: Photo) -> Photo:
    """Return the photo as it comes: without orientation, every other with a rough one."""
    if int(photo.name[1:]) % 2:
        return Photo(photo.name, photo.camera)
    assert photo.position is not None
    x, y, z = photo.position
    return replace(photo, position=(round(x), round(y), round(z)))


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


@dataclass
class Soak:
    """Seeded events, one after the other."""

    seed: int
    policy: Policy = "flag"
    most: int = 350
    """Observations that are there at a time, about."""
    done: Counter[str] = field(default_factory=Counter)
    """Events, errors among them, by what they were."""
    checked: list[Checked] = field(default_factory=list)
    trace: Callable[[str], None] | None = None
    """Called with a description of every event."""
    extreme: bool = True
    """Whether weights and readings beyond reason are among the events."""

    def __post_init__(self) -> None:
        """Measure the site, and begin in the morning."""
        self.rng = np.random.default_rng(self.seed)
        self.measured = measure(plan(), seed=self.seed)
        self.pool = items(self.measured)
        self.inc = IncrementalAdjustment(empty_site(self.measured), policy=self.policy)
        self.there: dict[str, int] = {}
        """Ids that must be somewhere, by the group that they arrived with."""
        self.odd: set[str] = set()
        """Those that are not what was measured."""
        self.coming_points = [p for n, p in self.measured.points.items() if self._later(n)]
        self.coming_photos = [f for n, f in self.measured.photos.items() if self._later(n)]
        self.n = 0
        self._groups = 0

    def _later(self, name: str) -> bool:
        return name[0] in "PF" and int(name[1:]) >= LATER

    # -- one event ----------------------------------------------------------------------------

    def step(self) -> None:
        """Play one event, and check that what must be there is there."""
        self.n += 1
        events = EVENTS if self.extreme else EVENTS[:-1]
        weights = np.array([w for w, _ in events])
        if len(self.there) > self.most:  # more goes than comes
            weights[0], weights[1] = weights[1], weights[0]
        _, event = events[int(self.rng.choice(len(events), p=weights / weights.sum()))]
        name = event.__name__.strip("_")
        before = self.state()
        points = self.estimates(before["known"])
        try:
            event(self)
        except AdjustmentError as error:
            self.done[f"{name}: {type(error).__name__}"] += 1
            if not str(error):
                raise Broken(f"event {self.n}: {name}: an error without words") from error
            if (after := self.state()) != before:
                raise Broken(f"event {self.n}: {name}: {_changed(before, after)}") from error
            self._check_points(name, points, before["known"])
        else:
            self.done[name] += 1
        self._check_ids(name)

    def state(self) -> dict[str, Any]:
        """Return what there is."""
        inc = self.inc
        described = inc.described
        register = inc._engine.register
        found = [n for n in described.points if register.known("point", n)]
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

    def _check_ids(self, event: str) -> None:
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
        if inc._engine.empty:
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
        self.checked.append(found)
        gc.collect()
        return found

    # -- helpers ------------------------------------------------------------------------------

    def say(self, text: str) -> None:
        if self.trace is not None:
            self.trace(f"{self.n}: {text}")

    def draw(self, names: Sequence[str]) -> str:
        return names[int(self.rng.integers(len(names)))]

    def some(self, most: int, *, odd: bool = False) -> list[str]:
        """Return ids that are there."""
        names = sorted(self.odd & set(self.there)) if odd else list(self.there)
        if not names:
            return []
        k = int(self.rng.integers(1, most + 1))
        return list(dict.fromkeys(self.draw(names) for _ in range(k)))

    def add(self, what: AnyObservation | list[AnyObservation], *, odd: bool = False) -> None:
        """Add, and note what is there now."""
        listed = what if isinstance(what, list) else [what]
        self.say(f"add {listed}")
        arrival = self.inc.add(what)
        given = [i for item in listed for i in ids_of(item)]
        if [v.id for v in arrival.verdicts[: len(given)]] != given:
            raise Broken(f"event {self.n}: verdicts of {[v.id for v in arrival.verdicts]}")
        for item in listed:
            self._groups += 1
            self.there.update(dict.fromkeys(ids_of(item), self._groups))
            (self.odd.update if odd else self.odd.difference_update)(ids_of(item))

    def known_names(self) -> tuple[list[str], list[str]]:
        described = self.inc.described
        return list(described.points), list(described.photos)

    def next_ones(self, most: int) -> list[AnyObservation]:
        """Return observations of the day that are not there, and of things that are."""
        described = self.inc.described
        out: list[AnyObservation] = []
        for _ in range(int(self.rng.integers(1, most + 1))):
            for _ in range(50):
                item = self.pool[int(self.rng.integers(len(self.pool)))]
                members = item.observations if isinstance(item, Correlated) else (item,)
                names = {n for o in members for n in o.names()}
                there = {**described.points, **described.photos}
                rejected = {v.id for v in self.inc.rejected}
                if names <= there.keys() and not any(
                    (i in self.there and i not in rejected)
                    or i in {j for o in out for j in ids_of(o)}
                    for i in ids_of(item)
                ):
                    if isinstance(item, Correlated) and any(i in self.there for i in ids_of(item)):
                        continue
                    out.append(item)
                    break
        return out

    # -- events -------------------------------------------------------------------------------

    def _arrival(self) -> None:
        self.add(self.next_ones(3))

    def _removal(self) -> None:
        ids = self.some(4)
        if ids:
            self.remove(ids)

    def remove(self, ids: list[str]) -> None:
        self.say(f"remove {ids}")
        self.inc.remove(ids)
        for i in ids:
            self.there.pop(i, None)
            self.odd.discard(i)

    def _clean_up(self) -> None:
        """Take out what is wrong, as somebody would who sees it."""
        ids = self.some(20, odd=True)
        if ids:
            self.remove(ids)

    def _gross_error(self) -> None:
        wrong = [_altered(i, float(self.rng.normal(0.0, 1.0))) for i in self.next_ones(2)]
        if wrong:
            self.add(wrong, odd=True)

    def _whole_photo(self) -> None:
        """A photo with all its rays, or a station with all its sights."""
        name = self.draw([*STATIONS, *self.inc.described.photos])
        chosen: list[AnyObservation] = []
        for item in self.pool:
            first = item.observations[0] if isinstance(item, Correlated) else item
            there = {**self.inc.described.points, **self.inc.described.photos}
            if isinstance(item, Correlated) or first.names()[0] != name:
                continue
            if set(first.names()) <= there.keys() and ids_of(item)[0] not in self.there:
                chosen.append(item)
        if chosen:
            self.add(chosen[:24])

    def _entity(self) -> None:
        """A new point or photo, with its observations."""
        points, photos = [], []
        if self.coming_points and self.rng.random() < 0.6:
            p = self.coming_points.pop()
            points = [Point(p.name, UNKNOWN)]
        elif self.coming_photos:
            photos = [_arriving(self.coming_photos.pop())]
        else:
            return
        self.say(f"new {points} {photos}")
        self.inc.add(points=points, photos=photos)

    def _replacement(self) -> None:
        ids = self.some(1)
        by_id = {ids_of(i)[0]: i for i in self.pool if not isinstance(i, Correlated)}
        if ids and ids[0] in by_id:
            new = by_id[ids[0]]
            odd = self.rng.random() < 0.2
            if odd:
                new = _altered(new, 0.05)
            self.say(f"replace {ids[0]} by {new}")
            self.inc.replace(ids[0], new)  # type: ignore[arg-type]
            (self.odd.add if odd else self.odd.discard)(ids[0])

    def _reweighting(self) -> None:
        ids = self.some(3)
        if ids:
            factor = float(2.0 ** self.rng.integers(-3, 4))
            self.say(f"reweight {ids} {factor}")
            self.inc.reweight(ids, factor)

    def _accepting(self) -> None:
        found = [v.id for v in (*self.inc.suspects, *self.inc.rejected)]
        if found:
            ids = [self.draw(found)]
            self.say(f"accept {ids}")
            self.inc.accept(ids)
            if ids[0] in self.odd and self.rng.random() > BELIEVED:
                self.remove(ids)

    def _discarding(self) -> None:
        found = [v.id for v in self.inc.suspects]
        if found:
            ids = [self.draw(found)]
            self.say(f"discard {ids}")
            self.inc.discard(ids)

    def _snooping(self) -> None:
        self.say("snoop")
        self.inc.snoop()

    def _asking(self) -> None:
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

    def _nonsense(self) -> None:
        """Input that must be refused."""
        points, photos = self.known_names()
        p, q, f = points[3], points[4], photos[0]
        there = list(self.there) or ["nothing"]
        one = self.draw(there)
        good = self.next_ones(1)
        cases: list[Callable[[], object]] = [
            lambda: self.inc.add(SlopeDistance(p, "nobody", 1.0, sigma=0.01)),
            lambda: self.inc.add([*good, SlopeDistance("nobody", p, 1.0, sigma=0.01)]),
            lambda: self.inc.add(ImagePoint("nowhere", p, 0.0, 0.0, sigma=0.01)),
            lambda: self.inc.add(SlopeDistance(p, q, np.nan, sigma=0.01)),
            lambda: self.inc.add(SlopeDistance(p, q, -1.0, sigma=0.01)),
            lambda: self.inc.add(SlopeDistance(p, p, 1.0, sigma=0.01)),
            lambda: self.inc.add(Direction(p, q, 1.0, sigma=0.0)),
            lambda: self.inc.add(ImagePoint(f, p, np.inf, 0.0, sigma=0.01)),
            lambda: self.inc.add([*good, *good] or [ImagePoint(f, "", 0.0, 0.0, sigma=1.0)]),
            lambda: self.inc.add(
                [HeightDifference(p, q, 0.0, sigma=0.1, id=one if one[0] != "F" else "")] * 2
            ),
            lambda: self.inc.add(
                Correlated((HeightDifference(p, q, 0.0, sigma=0.1),), np.array([[-1.0]]))
            ),
            lambda: self.inc.add(points=[Point(p, UNKNOWN)]),
            lambda: self.inc.add(good, points=[Point("new", UNKNOWN), Point("new", UNKNOWN)]),
            lambda: self.inc.add(good, photos=[Photo("new", "no camera")]),
            lambda: self.inc.add(cameras=list(self.inc.described.cameras.values())),
            lambda: self.inc.remove([one, "nothing of this name"]),
            lambda: self.inc.replace("nothing", HeightDifference(p, q, 0.0, sigma=0.1)),
            lambda: self.inc.replace(one, HeightDifference(p, "nobody", 0.0, sigma=0.1)),
            lambda: self.inc.reweight([one], 0.0),
            lambda: self.inc.reweight([one], np.nan),
            lambda: self.inc.reweight(["nothing"], 2.0),
            lambda: self.inc.accept(["nothing"]),
            lambda: self.inc.discard(["nothing"]),
            lambda: self.inc.discard([v.id for v in self.inc.rejected] or ["nothing"]),
            lambda: self.inc.estimate("nobody"),
            lambda: self.inc.covariance(p, "nobody"),
        ]
        number = int(self.rng.integers(len(cases)))
        self.say(f"nonsense {number}")
        cases[number]()
        raise Broken(f"event {self.n}: nonsense {number} was taken")

    def _degenerate(self) -> None:
        """Geometry without an answer, or with one that says nothing."""
        self._groups += 1
        ident = f"x{self.n}"
        points, photos = self.known_names()
        p, f = self.draw(points[3:]), self.draw(photos)
        value = float(self.rng.uniform(0.0, 6.0))
        cases: list[Callable[[], AnyObservation | list[AnyObservation]]] = [
            # The same point twice.
            lambda: SlopeDistance("A", "A/twin", 0.0, sigma=0.01, id=ident),
            lambda: Direction("A", "A/twin", value, sigma=1e-5, id=ident),
            lambda: ZenithAngle("A", "A/twin", 1.0, sigma=1e-5, id=ident),
            lambda: HorizontalAngle("A", "B", "A/twin", value, sigma=1e-5, id=ident),
            lambda: GnssVector("A", "A/twin", (0.0,) * 3, sigma=(0.01,) * 3, id=ident),
            lambda: SlopeDistance(p, "A/twin", 0.0, sigma=0.001, id=ident),
            # Vertical and steep sights.
            lambda: Direction("A", "A/above", value, sigma=1e-5, id=ident),
            lambda: ZenithAngle("A", "A/above", 0.0, sigma=1e-5, id=ident),
            lambda: HorizontalAngle("A", "B", "A/above", value, sigma=1e-5, id=ident),
            lambda: Direction("S1", "S1/above", value, sigma=1e-5, id=ident),
            lambda: ZenithAngle("S1", "S1/above", 0.001, sigma=1e-3, id=ident),
            lambda: HorizontalAngle("S1", "A", "S1/above", value, sigma=1e-5, id=ident),
            # Behind the camera, and on its horizon.
            lambda: self._image(f, "far", 3.0),
            lambda: self._image(f, "S1/above", 9.0),
            lambda: self._image(f, p, 15.0),
            # Rays that hardly meet: two photos on one line with the point, or one ray only.
            lambda: self._image(f, "thin", 0.01),
            lambda: Direction("S1", "thin", value, sigma=1e-5, id=ident),
            lambda: Direction("S1", "far", value, sigma=1e-5, id=ident),
            lambda: [
                Direction("S1", "thin", value, sigma=1e-5, id=ident),
                Direction("S1", "thin", value, sigma=1e-5, id=f"{ident}.2", set="2"),
                ZenithAngle("S1", "thin", 1.5, sigma=1e-5, id=f"{ident}.3"),
            ],
            lambda: [
                SlopeDistance("A", "thin", 1.0, sigma=1e-3, id=ident),
                SlopeDistance("B", "thin", 1.0, sigma=1e-3, id=f"{ident}.2"),
                SlopeDistance("C", "thin", 1.0, sigma=1e-3, id=f"{ident}.3"),
            ],
            lambda: HeightDifference(p, "unused", 1.0, sigma=0.001, id=ident),
            lambda: Direction(p, "A", value, sigma=1e-5, set=ident, id=ident),
        ]
        made = cases[int(self.rng.integers(len(cases)))]()
        self.add(made, odd=True)

    def _image(self, photo: str, point: str, size: float) -> ImagePoint:
        x, y = self.rng.uniform(-size, size, 2).tolist()
        return ImagePoint(photo, point, x, y, sigma=0.004)

    def _beyond_reason(self) -> None:
        """Readings and weights that nobody has, and taking them out again."""
        ident = f"y{self.n}"
        points, _ = self.known_names()
        p, q = self.draw(points[3:]), self.draw(points[:3])
        if p == q:
            return
        cases: list[Callable[[], AnyObservation]] = [
            lambda: SlopeDistance(p, q, 1e15, sigma=0.01, id=ident),
            lambda: SlopeDistance(p, q, 1e9, sigma=1e6, id=ident),
            lambda: HeightDifference(p, q, 1e12, sigma=1e-3, id=ident),
            lambda: HeightDifference(p, q, 1.0, sigma=1e9, id=ident),
            lambda: HeightDifference(p, q, 1.0, sigma=1e-9, id=ident),
            lambda: (
                Direction("S1", p, 1e6, sigma=1e-5, id=ident)
                if p != "S1"
                else Direction("S1", q, 1e6, sigma=1e-5, id=ident)
            ),
            lambda: ControlPoint(p, (1e8, 0.0, 0.0), sigma=(1e-3,) * 3, id=ident),
            lambda: GnssVector(p, q, (1e12, 0.0, 0.0), sigma=(1.0,) * 3, id=ident),
        ]
        self.add(cases[int(self.rng.integers(len(cases)))](), odd=True)
        self.say("and take it out")
        self.remove([ident])


EVENTS: list[tuple[float, Callable[[Soak], None]]] = [
    (45.0, Soak._arrival),
    (22.0, Soak._removal),
    (5.0, Soak._gross_error),
    (6.0, Soak._clean_up),
    (2.0, Soak._whole_photo),
    (1.0, Soak._entity),
    (4.0, Soak._replacement),
    (4.0, Soak._reweighting),
    (2.0, Soak._accepting),
    (3.0, Soak._discarding),
    (0.2, Soak._snooping),
    (1.0, Soak._asking),
    (8.0, Soak._nonsense),
    (4.0, Soak._degenerate),
    (1.0, Soak._beyond_reason),
]
"""Weight and kind of every event."""


def _altered(item: AnyObservation, by: float) -> AnyObservation:
    """Return an observation with a gross error."""
    if isinstance(item, Correlated):
        first, *rest = item.observations
        return Correlated((_wrong(first, by), *rest), item.covariance)
    return _wrong(item, by)  # type: ignore[return-value]


def _wrong(o: Observation, by: float) -> Observation:
    if isinstance(o, ImagePoint):
        return replace(o, x=o.x + by)
    value: Any = o.value  # type: ignore[attr-defined]
    if isinstance(value, tuple):
        return replace(o, value=(value[0] + by, *value[1:]))  # type: ignore[call-arg]
    return replace(o, value=value + by)  # type: ignore[call-arg]


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


# -- as a program ---------------------------------------------------------------------------------

EVERY = 1000
"""Events between two comparisons."""


def resident() -> float:
    """Return the resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def main(events: int, seed: int = 1) -> None:
    """Play events, compare with the batch at every thousandth, and print."""
    soak = Soak(seed)
    begin = perf_counter()
    print(
        f"  {'events':>8}{'in graph':>10}{'wait':>6}{'x / σ':>10}{'σ':>10}"
        f"{'settled x':>11}{'σ':>10}{'MB':>7}{'s':>8}"
    )
    for _ in range(events):
        soak.step()
        if soak.n % EVERY == 0:
            c = soak.compare()
            print(
                f"  {c.event:8d}{c.observations:10d}{soak.inc.n_waiting:6d}{c.estimates:10.1e}"
                f"{c.sigmas:10.1e}{c.settled_estimates:11.1e}{c.settled_sigmas:10.1e}"
                f"{resident():7.0f}{perf_counter() - begin:8.0f}",
                flush=True,
            )
    print("  " + ", ".join(f"{k} {n}" for k, n in sorted(soak.done.items())))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
