"""Small networks drawn by chance: every kind of observation and unknown, in a few frames.

A seed draws points (held, weighted, observed, with approximate coordinates or without any),
photos, cameras, distance meters, refraction groups, verticals and sets of directions, each held,
weighted or free, and 10 to 30 readings between them. Whether the readings determine all of it is
left to chance: what they do not determine is the part that waits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from factorgraph_adj import Network
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.models.lens import BrownLens, NoDistortion
from factorgraph_adj.network.network import DatumChoice
from factorgraph_adj.observations import (
    AnyObservation,
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    ControlPoint,
    Correlated,
    Direction,
    FrameCoordinate,
    GnssPosition,
    GnssVector,
    GyroAzimuth,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    ImagePoint,
    LevelHeight,
    Observation,
    PhotoPosition,
    PhotoSight,
    PhotoTilt,
    ProfileHeight,
    SlopeDistance,
    StripCoordinate,
    VerticalAngle,
    ZenithAngle,
)
from factorgraph_adj.rotation import TURN_ABOUT_X
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.networks.every_kind import EXAMPLES, FRAMES, add_examples
from tests.networks.random_more import add_more, without_sense
from tests.support.arrivals import bare, items

MM = 1e-3
FOCAL = 28.0
"""Principal distance, mm."""
SIGMA_IMAGE = 0.004
"""Of image coordinates, mm."""
SCANNED = 0.25
"""Share of the networks with a frame of its own."""
STRIPS = 0.12
"""Share of the networks with a strip that bends."""
FLOODED = 0.2
"""Share of the networks with surfaces of water and pressure, and instruments that go with them."""
BY_EXAMPLE = 0.2
"""Share of the networks with the kinds that `every_kind` has examples of."""
FEWEST, MOST = 10, 30
"""Number of readings."""
SIDE, HEIGHT, APART = 60.0, 20.0, 6.0
"""Size of the site, and distance between points at least, metres."""
ASTRAY = 0.05
"""Standard deviation of approximate coordinates, metres."""
GROSS = 0.3
"""Part of the readings of a network with gross errors that have one, at most."""
T = TypeVar("T")


@dataclass(frozen=True)
class Drawn:
    """A network that was drawn."""

    seed: int
    bare: Network
    """All that is described, without observations."""
    items: tuple[AnyObservation, ...]
    """Its observations and correlated groups."""

    @property
    def whole(self) -> Network:
        """The network with all its observations."""
        return handed_over(self.bare, self.items)


def handed_over(described: Network, some: Sequence[AnyObservation]) -> Network:
    """Return a network with some observations."""
    out = described.copy()
    out.add(*some)
    return out


def random_network(seed: int, *, gross: bool = False, more: bool = True) -> Drawn:
    """Draw a network.

    Args:
        seed: of everything.
        gross: whether some readings have gross errors.
        more: whether shares of the networks have strips, surfaces, and what `random_more` adds;
            nothing else depends on it.
    """
    draw = _Draw(seed, more)
    plan = draw.plan()
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=ASTRAY, centres=ASTRAY, attitudes=1e-3
    )
    described = draw.described(bare(network))
    arriving = [without_sense(o) for o in items(network)]
    if gross:
        arriving = [draw.spoiled(item, described) for item in arriving]
    return Drawn(seed, described, tuple(arriving))


def _with_error(item: AnyObservation, by: float) -> AnyObservation:
    """Return an observation with an error; angles between 0 and π stay so.

    Raises:
        InputError: the reading is out of its range.
    """
    if isinstance(item, ImagePoint):
        return replace(item, x=item.x + by)
    value: Any = item.value  # type: ignore[union-attr]
    if isinstance(value, tuple):
        return replace(item, value=(value[0] + by, *value[1:]))  # type: ignore[call-arg]
    value = abs(value + by)
    if isinstance(item, ZenithAngle):
        value %= math.pi
    return replace(item, value=value)  # type: ignore[call-arg]


class _Draw:
    """One network in the making."""

    def __init__(self, seed: int, more: bool = True) -> None:
        self.seed, self.more = seed, more
        self.rng = np.random.default_rng([seed, 1797])
        self.unknown: set[str] = set()
        """Points and photos without approximate values."""
        self.stated: set[tuple[str, str]] = set()
        """Sets of directions whose orientation is held or weighted."""

    def chance(self, probability: float) -> bool:
        return float(self.rng.random()) < probability

    def some(self, what: Sequence[str], n: int) -> list[str]:
        return [str(x) for x in self.rng.choice(list(what), n, replace=False)]

    def one(self, what: Sequence[T], weights: Sequence[float] | None = None) -> T:
        p = None if weights is None else np.array(weights) / np.sum(weights)
        return what[int(self.rng.choice(len(what), p=p))]

    # -- what is described --------------------------------------------------------------------

    def plan(self) -> Network:
        """Return the network with its true values and its observations."""
        names = ("flat", "left-handed", "curved", "topocentric", "geocentric")
        self.frame, self.origin = FRAMES[self.one(names, (6, 0.5, 0.5, 1.5, 1.5))]
        self.axes = self.frame.basis(self.origin[None], np.zeros((1, 2))).enu[0]
        self.datum: DatumChoice = "free" if self.chance(0.25) else "given"
        self.network = Network("random", frame=self.frame, datum=self.datum)
        self._points()
        self._photos()
        self._instruments()
        self._observations()
        self._scan()
        if self.more:
            self._strip()
            self._surfaces()
            if not self.frame.left_handed:
                middle = self._place(np.array([SIDE, SIDE, HEIGHT]) / 2)
                add_more(self.network, self.axes, middle, self.seed)
            self._examples()
        return self.network

    def _strip(self) -> None:
        """Let some points be those of a strip, in some networks with a given datum."""
        rng = np.random.default_rng([self.seed, 1980])  # other draws stay what they were
        if rng.random() > STRIPS or self.datum == "free":
            return
        points = list(self.network.points)
        seen = rng.permutation(points)[: int(rng.integers(3, 7))].tolist()
        values = dict(zip(("a0", "b0", "z"), rng.normal(0.0, 0.5, 3).tolist(), strict=True))
        plan = int(rng.integers(0, 2))
        self.network.set_polynomial("strip", plan=plan, height=("z",), values=values)
        for name in seen:
            along, across = rng.normal(0.0, 1.0, 2).tolist()
            self.network.add(
                StripCoordinate(
                    "strip", name, (0.0,) * 3, along=along, across=across, sigma=(0.01,) * 3
                )
            )

    def _scan(self) -> None:
        """Let an instrument measure some points in a frame of its own, in some networks."""
        rng = np.random.default_rng([self.seed, 1981])  # other draws stay what they were
        if rng.random() > SCANNED or self.frame.left_handed:
            return
        points = list(self.network.points)
        seen = rng.permutation(points)[: int(rng.integers(3, 7))].tolist()
        values = dict(zip("xyz", rng.normal(0.0, 5.0, 3).tolist(), strict=True))
        values |= dict(zip(("rx", "ry", "rz"), rng.normal(0.0, 1.0, 3).tolist(), strict=True))
        scale = ["ln_scale"] if rng.random() < 0.3 else []
        origin = tuple(np.round(self.origin).tolist())
        free = ["rx", "ry", "rz", "x", "y", "z", *scale]
        self.network.add_frame("scan", free=free, values=values, origin=origin)
        for name in seen:
            self.network.add(FrameCoordinate("scan", name, (0.0,) * 3, sigma=(0.003,) * 3))

    def _surfaces(self) -> None:
        """Let a lake, a barometer, a gyrotheodolite and clinometers tell of some networks."""
        rng = np.random.default_rng([self.seed, 1957])  # other draws stay what they were
        if rng.random() > FLOODED:
            return
        held = self.datum == "given" and rng.random() < 0.5
        network, points = self.network, list(self.network.points)
        network.set_level("lake", 5.0, fixed=bool(held))
        network.set_profile("barometer", free=["height"], values={"height": -40.0})
        network.set_gyro("gyro", 0.3, fixed=bool(held))
        for name in rng.permutation(points)[:3].tolist():
            network.add(LevelHeight(name, "lake", sigma=5 * MM))
        for name in rng.permutation(points)[:3].tolist():
            network.add(ProfileHeight(name, 0.0, profile="barometer", sigma=0.05))
        for _ in range(2):
            a, b = rng.permutation(points)[:2].tolist()
            network.add(GyroAzimuth(a, b, 0.0, gyro="gyro", sigma=5 * ARCSEC))
        for name, photo in network.photos.items():
            if rng.random() < 0.5:
                continue
            assert photo.rotation is not None
            up = self.axes[2]
            seen = tuple((TURN_ABOUT_X @ photo.rotation.T @ up).tolist())
            network.add(
                PhotoTilt(name, (0.0,), axes="x", sigma=(1e-3,)),
                PhotoSight(name, tuple(up.tolist()), seen, sigma=(1e-3, 1e-3)),
                ProfileHeight(None, 0.0, photo=name, profile="barometer", sigma=0.05),
            )

    def _examples(self) -> None:
        """Let kinds that have an example observe points and photos of some networks."""
        rng = np.random.default_rng([self.seed, 1905])  # other draws stay what they were
        if rng.random() > BY_EXAMPLE or not EXAMPLES:
            return
        points, photos = (list(x) for x in (self.network.points, self.network.photos))
        seen = [rng.permutation(x).tolist() for x in (points, photos)]
        add_examples(self.network, *seen)

    def _points(self) -> None:
        at: list[Array] = []
        n_control, n_new = int(self.rng.integers(2, 5)), int(self.rng.integers(1, 5))
        while len(at) < n_control + n_new:
            new = self.rng.uniform(0.0, 1.0, 3) * [SIDE, SIDE, HEIGHT]
            if all(np.linalg.norm(new - old) > APART for old in at):
                at.append(new)
        self.offset: dict[str, Array] = {}
        self.control: list[str] = []
        self.given: list[str] = []
        for i, enu in enumerate(at):
            name = f"C{i}" if i < n_control else f"P{i - n_control}"
            self.offset[name] = enu
            options = self._hold(name) if i < n_control else {}
            # Approximate coordinates are the datum of a free network.
            if not options and self.chance(0.35) and self.datum == "given":
                self.unknown.add(name)
            self.network.add_point(name, self._place(enu), **options)
        if self.datum == "free" and self.chance(0.3):
            for name in self.some(list(self.offset), 3):
                p = self.network.points[name]
                self.network.points[name] = replace(p, datum=True)

    def _hold(self, name: str) -> dict[str, Any]:
        """Return how a point with given coordinates is held."""
        if self.datum == "free":
            return {}
        how = self.one(("held", "weighted", "observed", "height", "plane"), (6, 1.5, 1.5, 0.5, 0.5))
        if how == "observed":
            self.control.append(name)
            return {}
        if how == "weighted":
            return {"sigma": 5 * MM}
        return {"fixed": {"held": "xyz", "height": "z", "plane": "xy"}[how]}

    def _place(self, enu: Array) -> Array:
        """Return coordinates in the frame."""
        return np.asarray(self.origin + self.axes.T @ enu)

    def _photos(self) -> None:
        n = 0 if self.frame.left_handed else self.one((0, 1, 2, 3), (5, 1, 2, 2))
        if n == 0:
            return
        how = self.one(("held", "free", "weighted"), (5, 1, 2))
        lens = BrownLens() if self.chance(0.3) else NoDistortion()
        self.network.add_camera(
            "cam",
            lens,
            {"c": FOCAL, "x0": 0.03, "y0": -0.02},
            free=("c",) if how == "free" else (),
            sigma={"c": 0.02, "x0": 0.01, "y0": 0.01} if how == "weighted" else None,
            per_photo=how == "free" and self.chance(0.3),
        )
        middle = np.array([SIDE / 2, SIDE / 2, HEIGHT / 2])
        for i in range(n):
            turn = self.rng.uniform(0, 2 * np.pi)
            offset = [70 * np.cos(turn), 70 * np.sin(turn), float(self.rng.uniform(5, 40))]
            centre = middle + np.array(offset)
            options: dict[str, Any] = {}
            held = self.one(("free", "held", "weighted"), (5, 1, 1))
            if held == "weighted":
                options = {"sigma_position": 0.05, "sigma_attitude": 1e-3}
            elif held == "held" and self.datum == "given":
                options = {"fixed": True}
            elif self.chance(0.4):
                self.unknown.add(f"F{i}")
            self.network.add_photo(
                f"F{i}",
                "cam",
                position=self._place(centre),
                rotation=self.axes.T @ look_at(centre, middle),
                **options,
            )

    def _instruments(self) -> None:
        how = self.one(("free", "scale", "zero", "weighted", "held"))
        free = {"free": ("scale", "zero"), "scale": ("scale",), "zero": ("zero",)}.get(how, ())
        sigmas = {"sigma_scale": 1e-5, "sigma_zero": 2 * MM} if how == "weighted" else {}
        self.network.set_distance_meter("edm", scale=2e-5, zero=3 * MM, free=free, **sigmas)
        how = self.one(("free", "weighted", "held"))
        self.network.set_refraction(
            "air", value=0.13, sigma=0.05 if how == "weighted" else None, fixed=how == "held"
        )
        for name in self.some(list(self.offset), 2):
            if self.chance(0.25):
                sigma = self.one((None, 3 * ARCSEC))
                self.network.set_vertical(name, xi=8 * ARCSEC, eta=-5 * ARCSEC, sigma=sigma)

    def described(self, network: Network) -> Network:
        """Return what is given of it: without the values that are not known."""
        for name in self.unknown:
            if name in network.points:
                p = network.points[name]
                network.points[name] = replace(p, coordinates=(np.nan,) * 3)
            else:
                f = network.photos[name]
                network.photos[name] = replace(f, position=None, rotation=None)
        for key in list(network.orientations):
            if key not in self.stated and self.chance(0.8):
                del network.orientations[key]
        for key, p in network.levels.items():  # found from points
            network.levels[key] = p if p.fixed[0] else replace(p, values=(np.nan,))
        for key, p in network.frames.items():  # found from common points
            free = [i < 6 and not held for i, held in enumerate(p.fixed)]
            values = tuple(np.nan if f else v for f, v in zip(free, p.values, strict=True))
            network.frames[key] = replace(p, values=values)
        for kind in ("size", "angle"):  # found from the points of shapes
            for key, p in network.of_kind(kind).items():
                network.of_kind(kind)[key] = replace(p, values=(np.nan,))
        return network

    # -- what is observed ---------------------------------------------------------------------

    def _observations(self) -> None:
        # Most readings are taken from a few stations, as on a site.
        self.stations = self.some(list(self.offset), min(len(self.offset), self.one((1, 2, 3))))
        ways: dict[Callable[[], list[Observation]], float] = {
            self._sight: 8,
            self._whole_sight: 3,
            self._levelled: 1.5,
            self._by_gnss: 1.5,
            self._angle: 1,
        }
        if not isinstance(self.frame, LocalFrame):
            ways[self._astronomic] = 0.7
        if self.network.photos:
            ways |= {self._ray: 9, self._antenna: 0.7}
        n = int(self.rng.integers(FEWEST, MOST + 1))
        readings: list[Observation] = [self._control(name) for name in self.control]
        seen: set[tuple[str, str]] = set()
        for _ in range(10 * n):
            if len(readings) >= n:
                break
            for o in self.one(list(ways), list(ways.values()))():
                if isinstance(o, ImagePoint):
                    if (o.photo, o.point) in seen:
                        continue
                    seen.add((o.photo, o.point))
                readings.append(o)
        named = [
            o if isinstance(o, ImagePoint) else replace(o, id=f"{i} {o.kind}")  # type: ignore[call-arg]
            for i, o in enumerate(readings)
        ]
        for o in named:
            if isinstance(o, Direction):
                self._set_of(o)
        self.network.add(*self._grouped(named))

    def _set_of(self, o: Direction) -> None:
        """State the orientation of a set of directions."""
        if (o.station, o.set) in self.network.orientations:
            return
        how = self.one(("free", "weighted", "held"), (8, 1, 1))
        if how != "free":
            self.stated.add((o.station, o.set))
        self.network.set_orientation(
            o.station,
            set=o.set,
            value=0.3,
            sigma=10 * ARCSEC if how == "weighted" else None,
            fixed=how == "held",
        )

    def _grouped(self, readings: list[Observation]) -> list[AnyObservation]:
        """Return readings with some of them in correlated groups."""
        out: list[AnyObservation] = []
        left = list(readings)
        while left:
            o = left.pop(0)
            others = [i for i, x in enumerate(left) if _can_join(x)]
            if not _can_join(o) or not others or not self.chance(0.1):
                out.append(o)
                continue
            members = [o, left.pop(self.one(others))]
            sigma = np.concatenate([_sigmas(m) for m in members])
            rho = 0.4 + 0.6 * np.eye(len(sigma))
            out.append(Correlated(tuple(members), rho * np.outer(sigma, sigma)))
        return out

    def _pair(self) -> tuple[str, str]:
        a = self.one(self.stations) if self.chance(0.8) else self.one(list(self.offset))
        b = self.one([n for n in self.offset if n != a])
        return (b, a) if self.chance(0.15) else (a, b)

    def _heights(self) -> dict[str, float]:
        return {"instrument_height": 1.5, "target_height": 0.3} if self.chance(0.3) else {}

    def _sight(self) -> list[Observation]:
        a, b = self._pair()
        kind = self.one("shvzrra")
        meter = "edm" if self.chance(0.5) else None
        air = "air" if self.chance(0.5) else None
        heights = self._heights()
        angle, length = 5 * ARCSEC, 2 * MM
        if kind == "s":
            return [SlopeDistance(a, b, 1.0, sigma=length, instrument=meter, **heights)]
        if kind == "h":
            return [HorizontalDistance(a, b, 1.0, sigma=length, instrument=meter, **heights)]
        if kind == "v":
            return [VerticalAngle(a, b, 0.0, sigma=angle, refraction=air, **heights)]
        if kind == "z":
            return [ZenithAngle(a, b, 1.5, sigma=angle, refraction=air, **heights)]
        if kind == "a":
            return [Azimuth(a, b, 0.0, sigma=angle, **heights)]
        return [Direction(a, b, 0.0, sigma=angle, set=self.one("12", (3, 1)), **heights)]

    def _whole_sight(self) -> list[Observation]:
        """Return direction, zenith angle and slope distance of one sight."""
        a, b = self._pair()
        return [
            Direction(a, b, 0.0, sigma=5 * ARCSEC),
            ZenithAngle(a, b, 1.5, sigma=5 * ARCSEC),
            SlopeDistance(a, b, 1.0, sigma=2 * MM),
        ]

    def _levelled(self) -> list[Observation]:
        return [HeightDifference(*self._pair(), 0.0, sigma=1 * MM)]

    def _angle(self) -> list[Observation]:
        a, b = self._pair()
        c = self.one([n for n in self.offset if n not in (a, b)])
        return [HorizontalAngle(a, b, c, 0.0, sigma=5 * ARCSEC)]

    def _by_gnss(self) -> list[Observation]:
        c = MM**2 * np.array([[9.0, 2.0, -1.0], [2.0, 8.0, 1.5], [-1.0, 1.5, 20.0]])
        a, b = self._pair()
        if self.chance(0.7):
            return [GnssVector(a, b, (0.0,) * 3, covariance=c)]
        return [GnssPosition(a, tuple(self._place(self.offset[a])), covariance=4 * c)]

    def _control(self, name: str) -> Observation:
        at = self._place(self.offset[name])
        how = self.one(("xyz", "enu", "z", "u"), (4, 2, 1, 1))
        value = at["xyz".index(how) :][:1] if how == "z" else at
        return ControlPoint(name, tuple(value.tolist()), axes=how, sigma=(4 * MM,) * len(how))

    def _astronomic(self) -> list[Observation]:
        kind = self.one((AstronomicLatitude, AstronomicLongitude))
        return [kind(self.one(self.stations), 0.0, sigma=2 * ARCSEC)]

    def _ray(self) -> list[Observation]:
        photo = self.one(list(self.network.photos))
        n = min(len(self.offset), self.one((1, 2, 4)))
        rho = 0.6 if self.seed % 4 == 3 else 0.0
        return [
            ImagePoint(photo, p, 0.0, 0.0, sigma=SIGMA_IMAGE, correlation=rho)
            for p in self.some(list(self.offset), n)
        ]

    def _antenna(self) -> list[Observation]:
        photo = self.one(list(self.network.photos))
        lever = (0.1, -0.05, 0.2)
        return [PhotoPosition(photo, (0.0,) * 3, sigma=(0.02,) * 3, lever_arm=lever)]

    def spoiled(self, item: AnyObservation, network: Network) -> AnyObservation:
        """Return an observation, with a gross error if chance says so."""
        if isinstance(item, Correlated) or not self.chance(self.rng.uniform(0.0, GROSS)):
            return item
        by = float(self.one((-1, 1)) * 10 ** self.rng.uniform(-2.0, 1.0))
        try:
            return _with_error(item, by)
        except InputError:  # no instrument gives such a reading
            return item


def _can_join(o: Observation) -> bool:
    return not isinstance(o, ImagePoint) and not getattr(o, "local", False)


def _sigmas(o: Observation) -> Array:
    """Return the standard deviations of the components of an observation."""
    covariance = getattr(o, "covariance", None)
    if covariance is not None:
        return np.sqrt(np.diag(covariance))
    return np.atleast_1d(np.asarray(o.sigma, dtype=float))  # type: ignore[attr-defined]
