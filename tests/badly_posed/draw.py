"""Badly posed small networks, drawn by chance.

Each family has one weakness that its seed makes mild or severe: short bases, rays that are nearly
parallel, points nearly in a line, weights that differ by many orders of magnitude, σ near the
resolution of the coordinates. Some networks have a gross error, some have a defect by construction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from factorgraph_adj import Network
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    ImagePoint,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.types import Array
from tests.networks.random_small import handed_over
from tests.support.arrivals import bare, items

FOCAL = 30.0
"""Principal distance, mm."""
MOON = np.array([4.0e6, 8.0e5, 4.8e6])
"""Somewhere on the Earth, geocentric, metres."""


@dataclass(frozen=True)
class Drawn:
    """A network that was drawn."""

    seed: int
    family: str
    network: Network
    defect: bool
    """Whether its observations do not determine all unknowns, by construction."""
    gross: bool
    """Whether one of its readings has a gross error."""


class Draw:
    """One network in the making."""

    def __init__(self, seed: int) -> None:
        """Begin with a seed of everything."""
        self.rng = np.random.default_rng([seed, 20_261_123])
        self.network = Network("badly posed")
        self.readings: list[Observation] = []
        self.defect = False
        self.astray = 0.0
        """Errors of approximate coordinates, metres."""
        self.turned = 0.0
        """Errors of approximate attitudes, radians."""
        self.given: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {}
        """Points that are given elsewhere than where they are measured, with σ, metres."""

    def chance(self, probability: float) -> bool:
        """Return true with a probability."""
        return float(self.rng.random()) < probability

    def between(self, low: float, high: float) -> float:
        """Return a number of which the logarithm is uniform."""
        return float(10 ** self.rng.uniform(np.log10(low), np.log10(high)))

    def point(self, name: str, at: Array, **how: Any) -> None:
        """Add a point at its true place."""
        self.network.add_point(name, tuple(np.asarray(at, dtype=float).tolist()), **how)

    def offset(self) -> Array:
        """Return the origin of the coordinates: mostly near, sometimes those of a country."""
        return np.array([0.0, 0.0, 0.0] if self.chance(0.6) else [4.5e5, 5.4e6, 200.0])

    # -- families ---------------------------------------------------------------------------------

    def bundle(self) -> None:
        """Photos on a base that may be very short, a free network or with weighted control."""
        rng, origin = self.rng, self.offset()
        depth, base = 20.0, self.between(2e-3, 20.0)
        n_photos, n_points = int(rng.integers(2, 5)), int(rng.integers(6, 13))
        self._camera(free=("c",) if self.chance(0.2) else ())
        given = not self.chance(0.4)
        self.network.datum = "given" if given else "free"
        sigma = self.between(1e-6, 1e-2)
        for i in range(n_points):
            at = origin + rng.uniform(-1, 1, 3) * [6.0, 6.0, 6.0]
            self.point(f"P{i}", at, **({"sigma": sigma} if given and i < 4 else {}))
        for i in range(n_photos):
            centre = origin + np.array([i * base, -depth, rng.uniform(-0.3, 0.3)])
            self._photo(f"F{i}", centre, origin)
        self._rays(noise=self.between(1e-6, 1e-2))
        self.astray, self.turned = min(0.02, 0.05 * base), 1e-4

    def resection(self) -> None:
        """One photo of a few points that may be nearly in a line, far away or close together."""
        rng, origin = self.rng, self.offset()
        narrow, depth = self.between(1e-3, 10.0), self.between(5.0, 2000.0)
        self._camera()
        direction = rng.standard_normal(3)
        for i in range(int(rng.integers(3, 7))):
            at = origin + rng.uniform(-3, 3) * direction + narrow * rng.standard_normal(3)
            self.point(f"P{i}", at, fixed="xyz")
        self._photo("F0", origin + depth * np.array([0.3, -1.0, 0.1]), origin)
        self._rays(noise=self.between(1e-6, 1e-2))
        self.astray, self.turned = 1e-3 * depth, 1e-4

    def rays(self) -> None:
        """Points far from held photos, so that their rays are nearly parallel."""
        rng, origin = self.rng, self.offset()
        base, depth = self.between(0.01, 5.0), self.between(5.0, 500.0)
        self._camera()
        for i in range(int(rng.integers(1, 5))):
            self.point(f"P{i}", origin + depth * np.array([*rng.uniform(-0.2, 0.2, 2), 0.0]))
        for i in range(int(rng.integers(2, 4))):
            centre = origin + np.array([i * base, -depth, rng.uniform(-0.1, 0.1) * base])
            self._photo(f"F{i}", centre, origin, fixed=True)
        self._rays(noise=self.between(1e-7, 1e-2))
        self.astray = 0.02 * depth
        if self.chance(0.15):  # a point with one ray
            self.readings = [
                o
                for o in self.readings
                if not (o.point == "P0" and o.photo != "F0")  # type: ignore[attr-defined]
            ]
            self.defect = True

    def levelling(self) -> None:
        """Height differences with weights of many orders of magnitude."""
        rng = self.rng
        n, height = int(rng.integers(3, 9)), float(rng.choice([0.0, 100.0, 4000.0]))
        for i in range(n):
            at = [0.0, 10.0 * i, height + float(rng.uniform(-20, 20))]
            self.point(f"P{i}", np.array(at), fixed="xyz" if i == 0 else "xy")
        # The point of a defect is joined to others by nothing.
        alone = int(rng.integers(1, n)) if n > 4 and self.chance(0.2) else None
        some = [i for i in range(n) if i != alone]
        edges = list(pairwise(some))
        edges += [tuple(rng.choice(some, 2, replace=False).tolist()) for _ in range(n)]
        if alone is not None:
            self.defect = True
            if self.chance(0.5) and n > 5:  # a part of two points
                other = some.pop()
                edges = [e for e in edges if other not in e]
                edges.append((alone, other))
        weakest = self.between(1e-3, 1e5)
        smallest = self.between(1e-10, 1e-3)
        for a, b in edges:
            sigma = smallest * float(10 ** rng.uniform(0.0, max(np.log10(weakest), 0.1)))
            self.readings.append(HeightDifference(f"P{a}", f"P{b}", 0.0, sigma=sigma))
        self.astray = 0.1

    def distances(self) -> None:
        """New points from distances to control that may be nearly in a line."""
        rng, origin = self.rng, self.offset()
        flat = self.chance(0.5)
        narrow = self.between(1e-3, 100.0)
        n, new = int(rng.integers(3, 6)), int(rng.integers(1, 4))
        for i in range(n):
            at = [100.0 * i, *(narrow * rng.standard_normal(2))]
            self.point(f"C{i}", origin + at, fixed="xyz")
        for i in range(new):
            at = rng.uniform([-100.0, -80.0, -60.0], [500.0, 80.0, 60.0])
            self.point(f"P{i}", origin + at, fixed="z" if flat else "")
        kind = HorizontalDistance if flat else SlopeDistance
        meter = self.chance(0.2)
        if meter:
            self.network.set_distance_meter("edm", free=("zero",))
        sigma: Any = self.between(1e-8, 1e-2)
        if self.chance(0.4):
            sigma = StandardDeviation(constant=sigma, ppm=self.between(1e-3, 1e3))
        used = n
        if self.chance(0.15):  # fewer distances than coordinates
            used, self.defect = (1 if flat else 2), True
        for i in range(new):
            for j in range(used):
                self._distance(kind, f"C{j}", f"P{i}", sigma, meter)
        if not self.defect:
            for i in range(1, new):
                self._distance(kind, "P0", f"P{i}", sigma, meter)
        self.astray = 1.0

    def _distance(self, kind: Any, a: str, b: str, sigma: Any, meter: bool) -> None:
        self.readings.append(kind(a, b, 1.0, sigma=sigma, instrument="edm" if meter else None))

    def mixed(self) -> None:
        """Stations with directions, zenith angles and distances, in slim triangles."""
        rng, origin = self.rng, self.offset()
        slim = self.between(0.05, 50.0)
        n = int(rng.integers(4, 8))
        given = not self.chance(0.3)
        self.network.datum = "given" if given else "free"
        for i in range(n):
            across, up = rng.standard_normal(2)
            at = origin + np.array([60.0 * i, slim * across, 3.0 * up])
            self.point(f"P{i}", at, **({"fixed": "xyz"} if given and i < 2 else {}))
        angle, length = self.between(1e-8, 1e-4), self.between(1e-7, 1e-2)
        distance: Any = length
        if self.chance(0.3):
            distance = StandardDeviation(constant=length, ppm=self.between(0.1, 100.0))
        for i in range(int(rng.integers(2, n + 1))):
            for j in range(n):
                if i == j or self.chance(0.15):
                    continue
                a, b = f"P{i}", f"P{j}"
                self.readings.append(Direction(a, b, 0.0, sigma=angle))
                self.readings.append(ZenithAngle(a, b, 1.5, sigma=angle))
                if self.chance(0.7):
                    self.readings.append(SlopeDistance(a, b, 1.0, sigma=distance))
            self.network.set_orientation(f"P{i}", value=float(rng.uniform(0, 6)))
        if self.chance(0.3):
            self.readings.append(HorizontalAngle("P0", "P1", "P2", 0.0, sigma=angle))
        if self.chance(0.3) and given:
            self.readings.append(Azimuth("P0", f"P{n - 1}", 0.0, sigma=angle))
        self.astray = 0.02 * min(slim, 5.0)

    def geocentric(self) -> None:
        """GNSS vectors and distances with coordinates of 6000 km."""
        rng = self.rng
        self.network = Network("badly posed", frame=GeocentricFrame())
        n = int(rng.integers(3, 7))
        given = not self.chance(0.4)
        self.network.datum = "given" if given else "free"
        at = [MOON + rng.uniform(-500, 500, 3) for _ in range(n)]
        for i in range(n):
            self.point(f"P{i}", at[i], **({"fixed": "xyz"} if given and i == 0 else {}))
        smallest = self.between(1e-7, 1e-2)
        edges = [(i, i + 1) for i in range(n - 1)]
        edges += [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(n)]
        for a, b in edges:
            c = np.diag((smallest * 10 ** rng.uniform(0, 1, 3)) ** 2)
            self.readings.append(GnssVector(f"P{a}", f"P{b}", (0.0,) * 3, covariance=c))
            if self.chance(0.5):
                sigma = smallest * float(10 ** rng.uniform(-1, 1))
                self.readings.append(SlopeDistance(f"P{a}", f"P{b}", 1.0, sigma=sigma))
        self.astray = 1.0

    def symmetric(self) -> None:
        """Slope distances from stations of one height, to points that begin there or nearby."""
        rng, origin = self.rng, self.offset()
        n = int(rng.integers(4, 7))
        for i in range(n):
            turn = 2.0 * np.pi * i / n
            at = np.array([80.0 * np.cos(turn), 80.0 * np.sin(turn), 0.0])
            self.point(f"C{i}", origin + at, fixed="xyz")
        weak = (np.inf, np.inf, self.between(1e2, 1e5))
        sigma = self.between(1e-5, 1e-2)
        true = []
        for i in range(int(rng.integers(1, 4))):
            at = origin + np.array([*rng.uniform(-40.0, 40.0, 2), self.between(1e-2, 50.0)])
            true.append(at)
            self.point(f"P{i}", at)
            for j in range(n):
                self._distance(SlopeDistance, f"C{j}", f"P{i}", sigma, meter=False)
        self.given = {
            f"P{i}": ((*at[:2].tolist(), float(origin[2])), weak) for i, at in enumerate(true)
        }

    # -- parts ------------------------------------------------------------------------------------

    def _camera(self, free: tuple[str, ...] = ()) -> None:
        values = {"c": FOCAL, "x0": 0.02, "y0": -0.03}
        self.network.add_camera("cam", NoDistortion(), values, free=free)

    def _photo(self, name: str, centre: Array, to: Array, **how: Any) -> None:
        self.network.add_photo(name, "cam", position=centre, rotation=look_at(centre, to), **how)

    def _rays(self, noise: float) -> None:
        for f in self.network.photos:
            for p in self.network.points:
                self.readings.append(ImagePoint(f, p, 0.0, 0.0, sigma=noise))

    def spoiled(self, network: Network) -> Network:
        """Return a network with a gross error in one of its readings."""
        size = float(self.rng.choice([-1.0, 1.0]) * self.between(10.0, 1e4))
        readings = items(network)
        chosen = int(self.rng.integers(len(readings)))
        readings[chosen] = _wrong(readings[chosen], size)
        return handed_over(bare(network), readings)


def _wrong(o: Any, size: float) -> Observation:
    """Return a reading with an error of some size in units of its σ."""
    if isinstance(o, ImagePoint):
        return replace(o, x=o.x + size * float(np.max(o.sigma)))
    if isinstance(o, GnssVector):
        sigma = float(np.sqrt(np.asarray(o.covariance)[0, 0]))
        return replace(o, value=(o.value[0] + size * sigma, *o.value[1:]))
    sigma = o.sigma.constant if isinstance(o.sigma, StandardDeviation) else o.sigma
    value = o.value + size * sigma
    if isinstance(o, SlopeDistance | HorizontalDistance):
        value = abs(value)
    elif isinstance(o, ZenithAngle):
        value = abs(value) % np.pi
    return replace(o, value=value)  # type: ignore[no-any-return]


FAMILIES: dict[str, Callable[[Draw], None]] = {
    "bundle": Draw.bundle,
    "resection": Draw.resection,
    "rays": Draw.rays,
    "levelling": Draw.levelling,
    "distances": Draw.distances,
    "mixed": Draw.mixed,
    "geocentric": Draw.geocentric,
    "symmetric": Draw.symmetric,
}
"""The families, drawn in turn."""


def badly_posed(seed: int) -> Drawn:
    """Draw a network."""
    names = list(FAMILIES)
    family = names[seed % len(names)]
    draw = Draw(seed)
    FAMILIES[family](draw)
    draw.network.add(*draw.readings)
    measured = measure(draw.network, seed=seed)
    gross = draw.chance(0.15)
    if gross:
        measured = draw.spoiled(measured)
    measured = disturb(
        measured, seed=seed, points=draw.astray, centres=draw.astray, attitudes=draw.turned
    )
    for name, (at, sigma) in draw.given.items():
        point = measured.points[name]
        measured.points[name] = replace(point, coordinates=at, sigma=sigma)
    return Drawn(seed, family, measured, draw.defect, gross)
