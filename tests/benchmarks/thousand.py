"""Arrivals in a large block: ``python -m tests.benchmarks.thousand [PHOTOS] [RAYS]``.

A simulated aerial block is adjusted and handed to an incremental adjustment. Then photos arrive
one by one with their rays, half of them at the end of the last strip, where they bring new points,
the others in the middle of the block, where nearly all points are known. GNSS positions of these
photos, levelled differences and tape distances between known points, and control points follow one
by one. All seconds are CPU seconds.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.graph.observation_selection import filtered
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    ControlPoint,
    HeightDifference,
    ImagePoint,
    Observation,
    PhotoPosition,
    SlopeDistance,
)
from factorgraph_adj.simulation.simulated_blocks import SIGMA_CONTROL, simulate_aerial_block

from .timing import Spread, peak

PHOTOS, RAYS = 1000, 1000
"""Photos of the block and rays of each photo."""
ARRIVING = 10
"""Photos that arrive."""
SINGLE = 30
"""Single observations of each of three kinds: tape distances, height differences, control."""
SIGMA_TAPE, SIGMA_LEVELLED = 5e-3, 2e-3
"""Standard deviations, metres."""
NEAR = 40.0
"""Largest distance between the points of a tape distance or a height difference, metres."""


@dataclass(frozen=True)
class ArrivingPhoto:
    """A photo on its way."""

    photo: Photo
    """The photo with approximate orientation."""
    points: tuple[Point, ...]
    """Points that no photo before it has, without coordinates."""
    rays: tuple[ImagePoint, ...]
    """Its image points."""


@dataclass(frozen=True)
class Scene:
    """A block, and what arrives in it."""

    block: Network
    """What is there first."""
    adjusted: Network
    """The same without the rays of points that are seen once: what the batch adjusts."""
    photos: tuple[ArrivingPhoto, ...]
    """Photos in the order of their arrival."""
    single: tuple[Observation, ...]
    """Observations that arrive one by one after the photos."""


def scene(photos: int, rays: int, *, arriving: int = ARRIVING, single: int = SINGLE) -> Scene:
    """Simulate a block and what arrives in it.

    Args:
        photos: photos of the block.
        rays: rays of each photo, about.
        arriving: photos that arrive.
        single: single observations of each kind.
    """
    made = simulate_aerial_block(1, image_points=(photos + arriving) * rays, points_per_photo=rays)
    whole, truth = made.network, made.truth
    names, points = list(whole.photos), list(whole.points)
    last = len(names) - arriving // 2
    middle = len(names) // 2
    late = [*range(last, len(names)), *range(middle, middle + arriving - arriving // 2)]
    photo, point, xy, sigma = whole.images.columns()
    block = whole.copy()
    there = ~np.isin(photo, late)
    block.image_mask(there)
    seen = np.bincount(point[there], minlength=len(points))
    gnss = {o.photo: o for o in whole.observations.values() if isinstance(o, PhotoPosition)}
    positions = [gnss[names[k]] for k in late]
    block = _without(
        block, [names[k] for k in late], [points[k] for k in np.flatnonzero(seen == 0)]
    )
    adjusted = block.copy()
    adjusted.image_mask(_often(adjusted))
    alone = [n for n, k in zip(points, seen.tolist(), strict=True) if k == 1]
    adjusted = _without(adjusted, [], alone)
    known = {points[k] for k in np.flatnonzero(seen)}
    coming = []
    for k in late:
        rows = np.flatnonzero(photo == k)
        mine = tuple(
            ImagePoint(names[k], points[p], x, y, sigma=s)
            for p, (x, y), s in zip(
                point[rows].tolist(), xy[rows].tolist(), sigma[rows].tolist(), strict=True
            )
        )
        new = tuple(Point(o.point, (np.nan,) * 3) for o in mine if o.point not in known)
        known |= {p.name for p in new}
        coming.append(ArrivingPhoto(whole.photos[names[k]], new, mine))
    sure = [points[k] for k in np.flatnonzero(seen >= 3)]
    others = _single(np.random.default_rng([photos, rays]), sure, truth.points, single)
    return Scene(block, adjusted, tuple(coming), (*positions, *others))


def _often(network: Network) -> np.ndarray:
    """Return which rays are of points with two rays at least."""
    _, point, _, _ = network.images.columns()
    return np.bincount(point)[point] >= 2


def _without(network: Network, photos: Sequence[str], points: Sequence[str]) -> Network:
    """Return a network without photos and points that have no rays."""
    gone = {("pose", n) for n in photos} | {("point", n) for n in points}
    out = filtered(network, lambda kind, name: (kind, name) not in gone)
    lost = {*photos, *points}
    out.observations = {
        i: o
        for i, o in network.observations.items()
        if not lost & {getattr(o, "photo", None), *o.points()}
    }
    return out


def _single(
    rng: np.random.Generator, names: Sequence[str], true: dict[str, np.ndarray], n: int
) -> list[Observation]:
    """Return single observations of three kinds, mixed."""
    ground = np.array([true[p] for p in names])
    out: list[Observation] = []
    for i in range(n):
        a = int(rng.integers(len(names)))
        away = np.linalg.norm(ground - ground[a], axis=1)
        near = np.flatnonzero((away > 1.0) & (away < NEAR))
        b, c = (int(k) for k in rng.choice(near, 2, replace=False))
        tape = away[b] + rng.normal(0.0, SIGMA_TAPE)
        out.append(SlopeDistance(names[a], names[b], tape, sigma=SIGMA_TAPE, id=f"tape {i}"))
        rise = ground[c, 2] - ground[a, 2] + rng.normal(0.0, SIGMA_LEVELLED)
        out.append(
            HeightDifference(names[a], names[c], rise, sigma=SIGMA_LEVELLED, id=f"levelled {i}")
        )
        at = ground[b] + rng.normal(0.0, SIGMA_CONTROL)
        out.append(ControlPoint(names[b], tuple(at.tolist()), sigma=SIGMA_CONTROL, id=f"gcp {i}"))
    return out


@dataclass(frozen=True)
class Times:
    """What the arrivals took."""

    adjust: float
    """Seconds of the batch adjustment before."""
    begin: float
    """Seconds to begin."""
    photos: tuple[float, ...]
    """Seconds of each photo."""
    single: tuple[float, ...]
    """Seconds of each single observation."""
    megabytes: tuple[float, float, float, float]
    """Peak memory after the simulation, the batch, the beginning, and the arrivals."""


def measure(given: Scene, *, told: bool = True) -> Times:
    """Let everything of a scene arrive.

    Args:
        given: the scene.
        told: whether a line is printed for each step.
    """
    memory = [peak()]

    def tell(line: str) -> None:
        if told:
            print(f"  {line}", flush=True)

    def clock(begin: float) -> float:
        return process_time() - begin

    n = given.block.n_image_points
    tell(f"{len(given.block.photos)} photos, {n} rays, {len(given.block.points)} points")
    begin = process_time()
    solution = fga.adjust(given.adjusted)
    adjusted = clock(begin)
    memory.append(peak())
    tell(f"batch {adjusted:.1f} s, σ̂0 {solution.sigma0:.4f}, {memory[-1]:.0f} MB")
    begin = process_time()
    inc = fga.IncrementalAdjustment(given.block, start=solution)
    begun = clock(begin)
    del solution
    memory.append(peak())
    tell(f"begins in {begun:.1f} s: {len(inc)} in, {inc.n_waiting} wait, {memory[-1]:.0f} MB")
    photos, single = [], []
    for coming in given.photos:
        begin = process_time()
        inc.add(coming.rays, points=coming.points, photos=[coming.photo])
        photos.append(clock(begin))
        tell(
            f"{coming.photo.name}: {len(coming.rays)} rays, {len(coming.points)} new points, "
            f"{photos[-1]:.2f} s; {len(inc)} in, {inc.n_waiting} wait, "
            f"{len(inc.suspects)} suspects"
        )
    for observation in given.single:
        begin = process_time()
        inc.add(observation)
        single.append(clock(begin))
    memory.append(peak())
    kinds = dict.fromkeys(o.kind for o in given.single)
    for kind in kinds:
        mine = [t for t, o in zip(single, given.single, strict=True) if o.kind == kind]
        tell(f"{kind}: {Spread.of(mine)}")
    tell(f"{len(inc)} in, {inc.n_waiting} wait, {len(inc.suspects)} suspects")
    times = Times(adjusted, begun, tuple(photos), tuple(single), tuple(memory))  # type: ignore[arg-type]
    tell(f"photos: {Spread.of(times.photos)}")
    tell(f"single observations: {Spread.of(times.single)}")
    tell(f"peak memory {memory[-1]:.0f} MB")
    return times


if __name__ == "__main__":
    arguments = [*map(int, sys.argv[1:])]
    measure(scene(*(arguments + [PHOTOS, RAYS][len(arguments) :])))
