"""What a survey vehicle and a total station send while it drives along a road, simulated.

A camera that looks forward takes a photo every second. Its rays are those of natural points at
facades, poles and kerbs, each tracked through 5 to 10 consecutive photos. An INS gives weighted
attitudes, a GNSS receiver positions 0.2 s after each photo. Every minute a total station with a
backsight measures points of the scene, and one target that no photo has. The events are made while
they are read, so that an hour takes no memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.models.image import image
from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Direction,
    ImagePoint,
    Observation,
    PhotoPosition,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.types import Array

SPEED = 5.0
"""Speed of the vehicle, m/s; a photo every second, so this is the base too."""
CAMERA = "front"
CALIBRATION = {"c": 5.01, "x0": 0.012, "y0": -0.008, "k1": 8e-4, "k2": -1e-5}
"""True calibration, mm."""
SIGMA_CALIBRATION = {"c": 2e-3, "x0": 2e-3, "y0": 2e-3, "k1": 1e-5, "k2": 5e-7}
"""Standard deviations of the calibration that is given, mm."""
SENSOR = (8.45, 7.07)
"""Width and height of the sensor, mm: 2448 × 2048 pixels."""
PIXEL = 3.45e-3
"""Side of a pixel, mm."""
SIGMA_IMAGE = 0.4 * PIXEL
"""Standard deviation of image coordinates, mm."""
SIGMA_GNSS = (0.03, 0.03, 0.05)
"""Standard deviations of GNSS positions, X, Y, Z, metres."""
LEVER_ARM = (0.1, 0.9, 0.4)
"""Vector from the projection centre to the antenna, metres."""
LATE = 0.2
"""Time from a photo to its GNSS position, seconds."""
APPROXIMATE = 0.3
"""Standard deviation of approximate positions of photos, metres."""
SIGMA_ATTITUDE = float(np.deg2rad(0.1))
"""Standard deviation of the attitudes of the INS, radians."""
FARTHEST = 60.0
"""Largest distance ahead at which a point is found, metres."""
TRACK = (5, 10)
"""Smallest and largest number of consecutive photos that see a point."""
MEAN_TRACK = 7.4
"""Mean number of them."""
BLOCK = 60
"""Seconds for which points are made together."""
STATION_EVERY, SIGHTS, SIGHT_EVERY = 60.0, 6, 4.0
"""Seconds between two set-ups of the total station, sights of each, and seconds between these."""
SIGMA_ANGLE = float(np.deg2rad(15.0 / 3600.0))
"""Standard deviation of directions and zenith angles to natural points, radians."""
SIGMA_DISTANCE = 5e-3
"""Standard deviation of slope distances to natural points, metres."""


@dataclass(frozen=True)
class Event:
    """What arrives at one time."""

    time: float
    """Time stamp, seconds."""
    observations: tuple[Observation, ...]
    """What was observed."""
    points: tuple[Point, ...] = ()
    """Points that are new."""
    photos: tuple[Photo, ...] = ()
    """Photos that are new."""


@dataclass
class Drive:
    """A drive; read its events once."""

    seconds: float
    """Duration."""
    rays: int = 500
    """Rays of each photo, about."""
    seed: int = 1
    """Seed of everything."""
    gross: float = 0.0
    """Part of the rays that belong to another point: off by 5 to 50 pixels."""
    wrong: set[str] = field(default_factory=set)
    """Ids of these rays."""
    true: dict[str, Array] = field(default_factory=dict)
    """True projection centres of the photos so far, by name, (3,) metres."""

    def network(self) -> Network:
        """Return the network before anything has arrived: a camera with weighted calibration."""
        rng = np.random.default_rng([self.seed, 0])
        out = Network("survey vehicle, simulated")
        given = {k: v + rng.normal(0.0, SIGMA_CALIBRATION[k]) for k, v in CALIBRATION.items()}
        out.add_camera(CAMERA, BrownForwardLens(), given, sigma=SIGMA_CALIBRATION)
        return out

    def events(self) -> Iterator[Event]:
        """Iterate over the events in the order of their time stamps."""
        rng = np.random.default_rng([self.seed, 1])
        n = int(self.seconds)
        # The last photos see points that later ones would have seen too.
        poses = [_pose(SPEED * k, rng) for k in range(n + TRACK[1])]
        seen: dict[int, list[_Seen]] = {}
        named: set[int] = set()
        ground: dict[int, Array] = {}
        late: list[Event] = []
        made = 0
        for k in range(n):
            while made * BLOCK * SPEED < SPEED * k + FARTHEST + SPEED:
                for photo, found in self._block(made, poses):
                    seen.setdefault(photo, []).append(found)
                    ground.update(zip(found.numbers.tolist(), found.ground, strict=True))
                made += 1
            yield from _until(late, float(k))
            photo, taken = self._photo(k, poses[k], rng), seen.pop(k, [])
            observations: list[Observation] = []
            new: list[Point] = []
            for part in taken:
                for number, (x, y) in zip(part.numbers.tolist(), part.xy.tolist(), strict=True):
                    observations.append(
                        ImagePoint(photo.name, f"p{number}", x, y, sigma=SIGMA_IMAGE)
                    )
                    if number not in named:
                        named.add(number)
                        new.append(Point(f"p{number}", (np.nan,) * 3))
            yield Event(float(k), tuple(observations), tuple(new), (photo,))
            late.append(self._gnss(k, poses[k], rng))
            here = [int(i) for part in taken for i in part.numbers if int(i) in named]
            if k and k % STATION_EVERY == STATION_EVERY // 3 and here:
                late += self._set_up(k, here, ground, rng)
            late.sort(key=lambda e: e.time)
            for number in [i for i in ground if i < 1000 * 1000 * (made - 3)]:
                del ground[number]
                named.discard(number)
        yield from _until(late, float(n))

    # -- photos -------------------------------------------------------------------------------

    def _photo(self, k: int, pose: _Pose, rng: np.random.Generator) -> Photo:
        name = f"photo {k}"
        self.true[name] = pose.at
        return Photo(
            name,
            CAMERA,
            position=_triple(pose.at + rng.normal(0.0, APPROXIMATE, 3)),
            rotation=pose.rotation @ exp_rotation(rng.normal(0.0, SIGMA_ATTITUDE, 3)),
            sigma_attitude=SIGMA_ATTITUDE,
        )

    @staticmethod
    def _gnss(k: int, pose: _Pose, rng: np.random.Generator) -> Event:
        antenna = pose.at + pose.rotation @ (np.array(LEVER_ARM) * [1.0, -1.0, -1.0])
        observed = antenna + rng.normal(0.0, SIGMA_GNSS)
        position = PhotoPosition(
            f"photo {k}", _triple(observed), sigma=SIGMA_GNSS, lever_arm=LEVER_ARM, id=f"gnss {k}"
        )
        return Event(k + LATE, (position,))

    def _block(self, made: int, poses: Sequence[_Pose]) -> Iterator[tuple[int, _Seen]]:
        """Make the points along a part of the road; iterate over photos with what they see."""
        rng = np.random.default_rng([self.seed, 2, made])
        n = round(self.rays / MEAN_TRACK * BLOCK)
        along = (made + np.sort(rng.uniform(0.0, 1.0, n))) * BLOCK * SPEED
        side = rng.choice([-1.0, 1.0], n)
        facade = rng.random(n) < 0.75
        across = side * np.where(facade, rng.uniform(6.0, 14.0, n), rng.uniform(2.0, 6.0, n))
        above = np.where(facade, rng.uniform(0.0, 11.0, n), rng.uniform(0.0, 0.15, n))
        road, ahead = _road(along)
        normal = np.stack([ahead[:, 1], -ahead[:, 0], np.zeros(n)], 1)
        ground = road + across[:, None] * normal + above[:, None] * [0.0, 0.0, 1.0]
        numbers = 1000 * 1000 * made + np.arange(n)
        first = np.floor(along / SPEED).astype(int)
        most = int(FARTHEST / SPEED) + 2
        nearest = np.full(n, -1)
        length = rng.integers(TRACK[0], TRACK[1] + 1, n)
        rows: dict[int, tuple[Array, Array]] = {}
        for back in range(most):
            photo = first - back
            for k in np.unique(photo[(photo >= 0) & (photo < len(poses))]).tolist():
                at = np.flatnonzero(photo == k)
                xy, visible = _projected(poses[k], ground[at])
                there = at[visible]
                nearest[there] = np.where(nearest[there] < 0, back, nearest[there])
                keep = visible & (back - nearest[at] < length[at])
                if keep.any():
                    old = rows.get(k)
                    new = at[keep], xy[keep]
                    rows[k] = (
                        new
                        if old is None
                        else tuple(  # type: ignore[assignment]
                            np.concatenate(pair) for pair in zip(old, new, strict=True)
                        )
                    )
        for k in sorted(rows):
            at, xy = rows[k]
            measured = xy + rng.normal(0.0, SIGMA_IMAGE, xy.shape)
            for i in np.flatnonzero(rng.random(len(at)) < self.gross).tolist():
                turn, off = rng.uniform(0.0, 2 * np.pi), rng.uniform(5.0, 50.0) * PIXEL
                measured[i] += off * np.array([np.cos(turn), np.sin(turn)])
                self.wrong.add(f"photo {k}/p{numbers[at[i]]}")
            yield k, _Seen(numbers[at], measured, ground[at])

    # -- total station ------------------------------------------------------------------------

    def _set_up(
        self, k: int, here: Sequence[int], ground: dict[int, Array], rng: np.random.Generator
    ) -> list[Event]:
        """Return the observations of a total station at the side of the road ahead."""
        road, ahead = _road(np.array([SPEED * k + 15.0]))
        station = road[0] + [0.0, 0.0, 1.6] + 3.0 * np.array([ahead[0, 1], -ahead[0, 0], 0.0])
        back = station + 80.0 * ahead[0] + [0.0, 0.0, 1.0]
        name, set_ = f"station {k}", f"{k}"
        fixed = (True,) * 3
        target = station + np.append(rng.uniform(-20.0, 20.0, 2), 1.0)
        where = {f"backsight {k}": back, f"target {k}": target}
        where |= {
            f"p{i}": ground[i]
            for i in rng.choice(np.array(here), min(SIGHTS, len(here)), replace=False).tolist()
        }
        orientation = rng.uniform(0.0, 2 * np.pi)
        out = []
        for number, (point, at) in enumerate(where.items()):
            d = at - station
            length = float(np.linalg.norm(d))
            reading = (np.arctan2(d[0], d[1]) - orientation) % (2 * np.pi)
            direction = Direction(
                name,
                point,
                float(reading + rng.normal(0.0, SIGMA_ANGLE)) % (2 * np.pi),
                sigma=SIGMA_ANGLE,
                set=set_,
            )
            zenith = float(np.arccos(d[2] / length) + rng.normal(0.0, SIGMA_ANGLE))
            distance = length + rng.normal(0.0, SIGMA_DISTANCE)
            new: tuple[Point, ...] = ()
            if not number:
                new = (Point(name, _triple(station), fixed), Point(point, _triple(back), fixed))
            elif point.startswith("target"):
                new = (Point(point, (np.nan,) * 3),)
            sights = (
                direction,
                ZenithAngle(name, point, zenith, sigma=SIGMA_ANGLE),
                SlopeDistance(name, point, distance, sigma=SIGMA_DISTANCE),
            )
            out.append(Event(k + 0.5 + SIGHT_EVERY * number, sights, new))
        return out


@dataclass(frozen=True)
class _Pose:
    """Where the camera truly is."""

    at: Array
    """Projection centre, (3,) metres."""
    rotation: Array
    """world_R_camera, (3, 3)."""


@dataclass(frozen=True)
class _Seen:
    """Points on a photo."""

    numbers: Array
    """Their numbers, (n,)."""
    xy: Array
    """Their measured coordinates, (n, 2) mm."""
    ground: Array
    """Their true coordinates, (n, 3) metres."""


def _road(along: Array) -> tuple[Array, Array]:
    """Return points (n, 3) of the road, which bends, and its direction, (n, 3)."""
    s = np.asarray(along, dtype=float)
    y = s
    x = 30.0 * np.sin(s / 80.0) + 200.0 * np.sin(s / 1500.0)
    slope = 30.0 / 80.0 * np.cos(s / 80.0) + 200.0 / 1500.0 * np.cos(s / 1500.0)
    z = 3.0 * np.sin(s / 300.0)
    ahead = np.stack([slope, np.ones_like(s), 0.01 * np.cos(s / 300.0)], 1)
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    return np.stack([x, y, z], 1), ahead


def _pose(along: float, rng: np.random.Generator) -> _Pose:
    road, ahead = _road(np.array([along]))
    at = road[0] + [0.0, 0.0, 2.2] + rng.normal(0.0, [0.3, 0.3, 0.02])
    shaken = exp_rotation(rng.normal(0.0, np.deg2rad(0.8), 3))
    return _Pose(at, look_at(at, at + ahead[0]) @ shaken)


def _projected(pose: _Pose, ground: Array) -> tuple[Array, Array]:
    """Return image coordinates (n, 2) mm without errors, and which points are on the photo."""
    d = (ground - pose.at) @ pose.rotation
    half = np.array(SENSOR) / 2
    front = (d[:, 2] > 3.0) & (d[:, 2] < FARTHEST)
    t = np.abs(d[:, :2]) / np.maximum(d[:, 2:], 1.0)
    front &= np.all(t < 0.99 * half / CALIBRATION["c"], axis=1)
    stored = np.concatenate([pose.rotation.ravel(), pose.at])[None].repeat(len(ground), 0)
    lens = BrownForwardLens()
    k = np.array([CALIBRATION.get(n, 0.0) for n in lens.names])[None]
    away = np.where(front[:, None], ground, pose.at + 10.0 * pose.rotation[:, 2])
    xy = image(
        LocalFrame(),
        stored,
        k,
        away,
        observed=np.zeros((len(ground), 2)),
        lens=lens,
        jacobians=False,
    ).residual
    return xy, front & np.all(np.abs(xy) < half, axis=1)


def _triple(at: Array) -> tuple[float, float, float]:
    x, y, z = at.tolist()
    return x, y, z


def _until(late: list[Event], time: float) -> Iterator[Event]:
    """Iterate over the events before a time, and take them out."""
    while late and late[0].time < time:
        yield late.pop(0)
