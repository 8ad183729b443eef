"""Streams of arrivals: what is there at the beginning, and what arrives, step by step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import gtsam
import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint, Observation
from factorgraph_adj.types import Array, Mask
from tests.networks.dbat import read_roma
from tests.support.places import ROOT

from .grids import simulate_grid, simulate_mixed
from .roma import FIRST
from .worker import ROMA

RAYS = 4
"""Image points are held back from points with as many rays at least, so that none is lost."""
SINGLE = 100
"""Number of single observations that arrive."""
REFRACTION = 0.2
"""Standard deviation of the coefficient of refraction of a survey that grows."""

PlaceOf: TypeAlias = Callable[[str], tuple[Array, Array]]
"""Returns the rotation world_R_camera and the centre of a photo, by name."""


@dataclass(frozen=True)
class Native:
    """What GTSAM alone is given instead of observations: its own factors."""

    factors: tuple[gtsam.NonlinearFactor, ...]
    """The factors."""
    start: Callable[[gtsam.ISAM2], gtsam.Values]
    """Returns values of what is new, from the estimates of before."""
    key: int
    """Key of the variable whose covariance is asked for."""


@dataclass(frozen=True)
class Step:
    """What arrives together."""

    observations: tuple[Observation, ...]
    """Observations, with ids."""
    asked: tuple[str, str]
    """Kind and name of the variable whose estimate and σ are asked for after it."""
    points: tuple[Point, ...] = ()
    """New points."""
    photos: Callable[[PlaceOf], tuple[Photo, ...]] = lambda _: ()
    """Returns new photos, with start values from the estimates of before."""
    native: Native | None = None
    """Native factors; none: GTSAM alone takes those of `build_graph`."""


@dataclass(frozen=True)
class Stream:
    """What is there at the beginning, and what arrives."""

    begin: Network
    """The network at the beginning."""
    steps: Sequence[Step]
    """What arrives, in order."""
    start: fga.Solution | None = None
    """Where everything is at the beginning; none: start values are found."""
    native: tuple[gtsam.NonlinearFactor, ...] = field(default=())
    """Native factors of the beginning, on the key 0."""
    photos_arrive: bool = False
    """Whether photos arrive with their rays."""


def ident(o: Observation) -> str:
    """Return the id of an observation."""
    return f"{o.photo}/{o.point}" if isinstance(o, ImagePoint) else str(o.id)


def single(network: Network, count: int = SINGLE) -> Stream:
    """Let some observations of a network arrive one by one.

    Args:
        network: all of it.
        count: how many arrive, drawn at random.
    """
    rng = np.random.default_rng(4)
    _, point, _, _ = network.images.columns()
    rays = np.bincount(point, minlength=len(network.points))
    image = list(network.image_points())
    possible: list[Observation] = [
        *(replace(o, id=i) for i, o in network.observations.items()),  # type: ignore[call-arg]
        *(o for o, p in zip(image, point.tolist(), strict=True) if rays[p] >= RAYS),
    ]
    count = min(count, len(possible) // 4)
    chosen = [possible[i] for i in rng.choice(len(possible), count, replace=False)]
    begin, gone = network.copy(), {ident(o) for o in chosen}
    begin.observations = {i: o for i, o in network.observations.items() if i not in gone}
    stays: Mask = np.array([ident(o) not in gone for o in image], dtype=bool)
    begin.image_mask(stays)
    return Stream(begin, [Step((o,), ("point", _a_point(network, o))) for o in chosen])


def _a_point(network: Network, o: Observation) -> str:
    """Return a point of an observation that is not held."""
    names = [n for n in o.points() if n and not all(network.points[n].fixed)]
    return names[-1]


def stations(points: int, count: int | None = None) -> Stream:
    """Let the stations of a grid arrive, each with its set of directions and its new points.

    The first half of the stations is there at the beginning, with a held point and a held azimuth
    among its points, and a weighted coefficient of refraction.

    Args:
        points: number of points of the whole grid.
        count: how many stations arrive; none: all others.
    """
    network, side = simulate_grid(1, points=points).network, round(points**0.5)
    for name, held in ((f"{side - 1}-0", ""), (f"0-{side - 1}", "x")):
        flags = tuple(c in held for c in "xyz")
        network.points[name] = replace(network.points[name], fixed=flags)
    network.set_refraction(value=0.0, sigma=REFRACTION)
    by_station: dict[str, list[Observation]] = {}
    for i, o in network.observations.items():
        by_station.setdefault(o.station, []).append(replace(o, id=i))  # type: ignore
    order = list(by_station)
    half = len(order) // 2
    late = order[half:] if count is None else order[half : half + count]
    begin = network.copy()
    begin.observations = {ident(o): o for name in order[:half] for o in by_station[name]}
    for name in order[half:]:  # sets that have not arrived are not there
        begin.orientations.pop((name, "1"), None)
    return Stream(begin, [Step(tuple(by_station[n]), ("point", n)) for n in late])


def photos(network: Network, first: int, *, start: fga.Solution | None = None) -> Stream:
    """Let photos arrive, each with all its rays.

    Args:
        network: all of it.
        first: number of photos that are there at the beginning.
        start: where everything is at the beginning.
    """
    photo, _, _, _ = network.images.columns()
    begin, rows = network.copy(), list(network.image_points())
    begin.image_mask(photo < first)
    steps = []
    for k, name in enumerate(network.photos):
        if k >= first:
            mine = tuple(rows[i] for i in np.flatnonzero(photo == k).tolist())
            steps.append(Step(mine, ("pose", name)))
    return Stream(begin, steps, start=start, photos_arrive=True)


def industry() -> Stream:
    """Let the last half of the photos of the industry block arrive."""
    network = fga.read_project(ROOT / "examples" / "industry_block")
    return photos(network, len(network.photos) // 2)


def roma() -> Stream:
    """Let the photos of Roma arrive in file order, after those that hold the datum."""
    network = read_roma(ROMA)
    return photos(network, FIRST, start=fga.adjust(network))


def flown_over(points: int, first: int = 60) -> Stream:
    """Let photos of 120 arrive over a grid of total stations."""
    return photos(simulate_mixed(1, points=points).network, first)


def single_mixed(points: int) -> Stream:
    """Let observations arrive in a grid of total stations and 120 photos over it."""
    return single(simulate_mixed(1, points=points).network)
