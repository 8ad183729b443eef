"""What happens on the site: arrivals of every kind, decisions, nonsense, degenerate geometry.

Every event is a function of the site and of somebody who makes its choices: a seeded generator in
a long life of an adjustment (`tests.support.soak`), Hypothesis in `tests/incremental/test_soak.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np

from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.observations import (
    AnyObservation,
    ControlPoint,
    Correlated,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    ImagePoint,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from tests.networks.site import STATIONS, UNKNOWN, arriving
from tests.support.arrivals import ids_of
from tests.support.watched import Broken, Watched

BELIEVED = 0.1
"""Share of the wrong readings put in after all that stay; the others go at once."""
T = TypeVar("T")


class Choices(Protocol):
    """Somebody who decides what happens."""

    def whole(self, low: int, high: int) -> int:
        """Return a whole number, low ≤ n < high."""

    def real(self, low: float, high: float) -> float:
        """Return a number between two others."""

    def chance(self, probability: float) -> bool:
        """Return whether something happens that happens with this probability."""

    def error(self) -> float:
        """Return a gross error in units of about 1."""

    def fitting(self, what: Sequence[T], fits: Callable[[T], bool]) -> T | None:
        """Return one of those that fit; none where there is none, or none was found."""


def one_of(choose: Choices, what: Sequence[T]) -> T:
    return what[choose.whole(0, len(what))]


def some(site: Watched, choose: Choices, most: int, *, odd: bool = False) -> list[str]:
    """Return ids that are there."""
    names = sorted(site.odd & set(site.there)) if odd else list(site.there)
    if not names:
        return []
    k = choose.whole(1, most + 1)
    return list(dict.fromkeys(one_of(choose, names) for _ in range(k)))


def known_names(site: Watched) -> tuple[list[str], list[str]]:
    described = site.inc.described
    return list(described.points), list(described.photos)


def next_ones(site: Watched, choose: Choices, most: int) -> list[AnyObservation]:
    """Return observations of the day that are not there, and of things that are."""
    described = site.inc.described
    there = {**described.points, **described.photos}
    # What was rejected may come again; a group comes whole or not at all.
    rejected = {v.id for v in site.inc.rejected}
    taken = {i for i in site.there if i not in rejected}
    out: list[AnyObservation] = []

    def fits(item: AnyObservation) -> bool:
        together = isinstance(item, Correlated)
        members = item.observations if isinstance(item, Correlated) else (item,)
        if any(n not in there for o in members for n in o.names()):
            return False
        return not any(i in taken or (together and i in site.there) for i in ids_of(item))

    for _ in range(choose.whole(1, most + 1)):
        item = choose.fitting(site.pool, fits)
        if item is not None:
            out.append(item)
            taken.update(ids_of(item))
    return out


def arrival(site: Watched, choose: Choices) -> None:
    site.add(next_ones(site, choose, 3))


def removal(site: Watched, choose: Choices) -> None:
    ids = some(site, choose, 4)
    if ids:
        site.remove(ids)


def clean_up(site: Watched, choose: Choices) -> None:
    """Take out what is wrong, as somebody would who sees it."""
    ids = some(site, choose, 20, odd=True)
    if ids:
        site.remove(ids)


def gross_error(site: Watched, choose: Choices) -> None:
    wrong = [_altered(i, choose.error()) for i in next_ones(site, choose, 2)]
    if wrong:
        site.add(wrong, odd=True)


def whole_photo(site: Watched, choose: Choices) -> None:
    """A photo with all its rays, or a station with all its sights."""
    observe_all(site, one_of(choose, [*STATIONS, *site.inc.described.photos]))


def observe_all(site: Watched, name: str) -> None:
    """Add what a photo or a station sees and is not there, 24 observations at most."""
    chosen: list[AnyObservation] = []
    for item in site.pool:
        first = item.observations[0] if isinstance(item, Correlated) else item
        there = {**site.inc.described.points, **site.inc.described.photos}
        if isinstance(item, Correlated) or first.names()[0] != name:
            continue
        if set(first.names()) <= there.keys() and ids_of(item)[0] not in site.there:
            chosen.append(item)
    if chosen:
        site.add(chosen[:24])


def entity(site: Watched, choose: Choices) -> None:
    """A new point or photo, with its observations."""
    points, photos = [], []
    if site.coming_points and choose.chance(0.6):
        p = site.coming_points.pop()
        points = [Point(p.name, UNKNOWN)]
    elif site.coming_photos:
        photos = [arriving(site.coming_photos.pop())]
    else:
        return
    site.say(f"new {points} {photos}")
    site.inc.add(points=points, photos=photos)


def replacement(site: Watched, choose: Choices) -> None:
    ids = some(site, choose, 1)
    by_id = {ids_of(i)[0]: i for i in site.pool if not isinstance(i, Correlated)}
    if ids and ids[0] in by_id:
        new = by_id[ids[0]]
        odd = choose.chance(0.2)
        if odd:
            new = _altered(new, 0.05)
        site.say(f"replace {ids[0]} by {new}")
        site.inc.replace(ids[0], new)  # type: ignore[arg-type]
        (site.odd.add if odd else site.odd.discard)(ids[0])


def reweighting(site: Watched, choose: Choices) -> None:
    ids = some(site, choose, 3)
    if ids:
        factor = 2.0 ** choose.whole(-3, 4)
        site.say(f"reweight {ids} {factor}")
        site.inc.reweight(ids, factor)


def accepting(site: Watched, choose: Choices) -> None:
    found = [v.id for v in (*site.inc.suspects, *site.inc.rejected)]
    if found:
        ids = [one_of(choose, found)]
        site.say(f"accept {ids}")
        site.inc.accept(ids)
        if ids[0] in site.odd and not choose.chance(BELIEVED):
            site.remove(ids)


def discarding(site: Watched, choose: Choices) -> None:
    found = [v.id for v in site.inc.suspects]
    if found:
        ids = [one_of(choose, found)]
        site.say(f"discard {ids}")
        site.inc.discard(ids)


def snooping(site: Watched, choose: Choices) -> None:
    """Data snooping of what is there."""
    site.say("snoop")
    site.inc.snoop()


def asking(site: Watched, choose: Choices) -> None:
    """What is asked changes nothing."""
    site.ask()


def nonsense(site: Watched, choose: Choices) -> None:
    """Input that must be refused."""
    points, photos = known_names(site)
    p, q, f = points[3], points[4], photos[0]
    there = list(site.there) or ["nothing"]
    one = one_of(choose, there)
    good = next_ones(site, choose, 1)
    cases: list[Callable[[], object]] = [
        lambda: site.inc.add(SlopeDistance(p, "nobody", 1.0, sigma=0.01)),
        lambda: site.inc.add([*good, SlopeDistance("nobody", p, 1.0, sigma=0.01)]),
        lambda: site.inc.add(ImagePoint("nowhere", p, 0.0, 0.0, sigma=0.01)),
        lambda: site.inc.add(SlopeDistance(p, q, np.nan, sigma=0.01)),
        lambda: site.inc.add(SlopeDistance(p, q, -1.0, sigma=0.01)),
        lambda: site.inc.add(SlopeDistance(p, p, 1.0, sigma=0.01)),
        lambda: site.inc.add(Direction(p, q, 1.0, sigma=0.0)),
        lambda: site.inc.add(ImagePoint(f, p, np.inf, 0.0, sigma=0.01)),
        lambda: site.inc.add([*good, *good] or [ImagePoint(f, "", 0.0, 0.0, sigma=1.0)]),
        lambda: site.inc.add(
            [HeightDifference(p, q, 0.0, sigma=0.1, id=one if one[0] != "F" else "")] * 2
        ),
        lambda: site.inc.add(
            Correlated((HeightDifference(p, q, 0.0, sigma=0.1),), np.array([[-1.0]]))
        ),
        lambda: site.inc.add(points=[Point(p, UNKNOWN)]),
        lambda: site.inc.add(good, points=[Point("new", UNKNOWN), Point("new", UNKNOWN)]),
        lambda: site.inc.add(good, photos=[Photo("new", "no camera")]),
        lambda: site.inc.add(cameras=list(site.inc.described.cameras.values())),
        lambda: site.inc.remove([one, "nothing of this name"]),
        lambda: site.inc.replace("nothing", HeightDifference(p, q, 0.0, sigma=0.1)),
        lambda: site.inc.replace(one, HeightDifference(p, "nobody", 0.0, sigma=0.1)),
        lambda: site.inc.reweight([one], 0.0),
        lambda: site.inc.reweight([one], np.nan),
        lambda: site.inc.reweight(["nothing"], 2.0),
        lambda: site.inc.accept(["nothing"]),
        lambda: site.inc.discard(["nothing"]),
        lambda: site.inc.discard([v.id for v in site.inc.rejected] or ["nothing"]),
        lambda: site.inc.estimate("nobody"),
        lambda: site.inc.covariance(p, "nobody"),
    ]
    number = choose.whole(0, len(cases))
    site.say(f"nonsense {number}")
    cases[number]()
    raise Broken(f"event {site.n}: nonsense {number} was taken")


def degenerate(site: Watched, choose: Choices) -> None:
    """Geometry without an answer, or with one that says nothing."""
    ident = f"x{site.n}"
    points, photos = known_names(site)
    p, f = one_of(choose, points[3:]), one_of(choose, photos)
    value = choose.real(0.0, 6.0)
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
        lambda: image(site, choose, f, "far", 3.0),
        lambda: image(site, choose, f, "S1/above", 9.0),
        lambda: image(site, choose, f, p, 15.0),
        # Rays that hardly meet: two photos on one line with the point, or one ray only.
        lambda: image(site, choose, f, "thin", 0.01),
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
    made = cases[choose.whole(0, len(cases))]()
    site.add(made, odd=True)


def image(site: Watched, choose: Choices, photo: str, point: str, size: float) -> ImagePoint:
    x, y = choose.real(-size, size), choose.real(-size, size)
    return ImagePoint(photo, point, x, y, sigma=0.004)


def beyond_reason(site: Watched, choose: Choices) -> None:
    """Readings and weights that nobody has, and taking them out again."""
    ident = f"y{site.n}"
    points, _ = known_names(site)
    p, q = one_of(choose, points[3:]), one_of(choose, points[:3])
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
    site.add(cases[choose.whole(0, len(cases))](), odd=True)
    site.say("and take it out")
    site.remove([ident])


EVENTS: list[tuple[float, Callable[[Watched, Choices], None]]] = [
    (45.0, arrival),
    (22.0, removal),
    (5.0, gross_error),
    (6.0, clean_up),
    (2.0, whole_photo),
    (1.0, entity),
    (4.0, replacement),
    (4.0, reweighting),
    (2.0, accepting),
    (3.0, discarding),
    (0.2, snooping),
    (1.0, asking),
    (8.0, nonsense),
    (4.0, degenerate),
    (1.0, beyond_reason),
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
