"""Results of thousands of networks, to the last bit: ``python -m tests.benchmarks.results_record``.

``write FILE [SHARE]`` adjusts seeded and published networks of all sorts, tests them, lets days of
observations arrive on both engines, and writes what came out: a line of JSON for each network.
SHARE is the part of each sort that is taken; 1 without it. ``compare BEFORE AFTER`` prints for
each quantity how many networks have other values, the largest differences, and where; it ends with
status 1 where anything differs.

What changes no result is checked with it: write before and after, and compare. Bits depend on the
machine and on versions of numpy and gtsam, so that files of one environment are compared.
"""

from __future__ import annotations

import gzip
import json
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.incremental.arrival import Arrival
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.simulation.measurement import disturb, measure
from tests.networks import (
    arriving,
    building_site,
    exchanged_day,
    facade,
    frames,
    hall,
    image_blocks,
    instruments,
    lens_blocks,
    mistaken,
    odometry,
    on_shapes,
    photo_block,
    poor_starts,
    random_small,
    rigs,
    simulated,
    small,
    strip_of_photos,
    three_frames,
)
from tests.networks.every_kind import LENSES_USED
from tests.support.days import drawn, play

MAX_SNOOPED_ROWS = 400
"""Number of observations up to which gross errors are searched for."""
SHOWN = 5
"""Networks that are named for each quantity with other values."""


@dataclass
class Results:
    """What came out of one network."""

    name: str
    values: dict[str, list[float]] = field(default_factory=dict)
    """Numbers by quantity."""
    texts: dict[str, list[str]] = field(default_factory=dict)
    """Names, verdicts and messages by quantity."""

    def add_table(self, prefix: str, table: Any) -> None:
        """Add the columns of a table, each as a quantity."""
        for title in table:
            column = np.asarray(table[title])
            if column.dtype.kind in "fiub":
                self.values[f"{prefix}.{title}"] = column.astype(float).ravel().tolist()
            else:
                self.texts[f"{prefix}.{title}"] = [str(x) for x in column.tolist()]


def adjusted(name: str, network: Network) -> Results:
    """Return the results of the batch adjustment, its reliability, and of data snooping."""
    out = Results(name)
    try:
        solution = fga.adjust(network)
    except fga.AdjustmentError as error:
        out.texts["error"] = [str(error)]
        return out
    out.texts["reason"] = [solution.reason]
    out.values["sums"] = [solution.vtpv, solution.sigma0, float(solution.redundancy)]
    try:
        out.add_table("points", solution.point_table())
        out.add_table("photos", solution.photo_table())
        out.add_table("unknowns", solution.unknown_table())
        if not solution.converged:
            return out
        out.add_table("reliability", reliability(solution).table())
        if solution.n_observations <= MAX_SNOOPED_ROWS:
            snooping = fga.snoop(network)
            out.texts["rejected"] = [f"{r.id} {r.round}" for r in snooping.rejected]
            out.texts["unresolved"] = [f"{r.id} {r.reason}" for r in snooping.unresolved]
            out.values["rejected"] = [x for r in snooping.rejected for x in (r.test, r.final_test)]
            found = () if snooping.causes is None else snooping.causes.found
            out.texts["causes"] = [f"{c.cause} {c.where}" for c in found]
            out.values["causes"] = [x for c in found for x in (c.t2, c.evidence)]
    except fga.AdjustmentError as error:
        out.texts["error of quality"] = [str(error)]
    return out


def arrived(name: str, seed: int, engine: Any) -> Results:
    """Return verdicts and comparisons with the batch of one day on one engine."""
    out, arrivals = Results(name), list[Arrival]()
    compared = list(play(seed, engine, arrivals))
    verdicts = [v for a in arrivals for v in a.verdicts]
    out.texts["verdicts"] = [f"{v.id} {v.verdict}" for v in verdicts]
    out.values["tests"] = [float(v.test) for v in verdicts]
    out.values["compared"] = [x for c in compared for x in (c.estimates, c.sigmas)]
    return out


def _networks() -> dict[str, tuple[int, Callable[[int], Network]]]:
    """Return the sorts of seeded networks: how many there are, and what makes one."""

    def of_day(seed: int) -> Network:
        return random_small.handed_over(*drawn(seed))

    def of_site(seed: int) -> Network:
        network, readings, _ = building_site.site(seed)
        network.add(*readings)
        return network

    def gross(seed: int) -> Network:
        return random_small.random_network(seed, gross=True).whole

    def of_room(seed: int) -> Network:
        return instruments.room_of(seed, list(instruments.INSTRUMENTS)[seed % 3 :][:3])

    def shape(seed: int) -> Network:
        return on_shapes.measured(list(on_shapes.ON)[seed % len(on_shapes.ON)], seed)

    def lens(seed: int) -> Network:
        return lens_blocks.lens_block(list(LENSES_USED)[seed % len(LENSES_USED)], seed)

    def path(seed: int) -> Network:
        return disturb(measure(odometry.odometry(), seed=seed), seed=seed, centres=0.05)

    def rig(seed: int) -> Network:
        return disturb(measure(rigs.rig(), seed=seed), seed=seed, points=0.01)

    def framed(seed: int) -> Network:
        names = list(frames.SORTS)
        return frames.network_of_frames(seed, (names[seed % len(names)], names[-1 - seed % 4]))

    def poor(seed: int) -> Network:
        return poor_starts.poor_start(next(iter(poor_starts.SORTS)), seed)

    def strip(seed: int) -> Network:
        return strip_of_photos.measured_strip(strip_of_photos.strip_plan(), seed)

    return {
        "random": (800, lambda seed: random_small.random_network(seed).whole),
        "random with gross errors": (400, gross),
        "day": (600, of_day),
        "building site": (120, of_site),
        "exchanged": (120, lambda seed: exchanged_day.day(seed).network),
        "levelling with a wrong scale": (40, partial(mistaken.levelling, scale=1.001)),
        "azimuths with a turn": (40, partial(mistaken.azimuths, turn=1e-3)),
        "small": (90, small.small),
        "facade": (10, facade.facade),
        "hall": (10, hall.hall),
        "instruments": (20, of_room),
        "three frames": (10, lambda seed: three_frames.three_frames(seed)),
        "shape": (30, shape),
        "lens": (2 * len(LENSES_USED), lens),
        "photos": (10, photo_block.block),
        "ring of photos": (6, lambda s: image_blocks.images_alone(image_blocks.ring(s).network)),
        "odometry": (20, path),
        "rig": (4, rig),
        "strip": (4, strip),
        "frames": (20, framed),
        "moved by a similarity": (20, poor),
    }


def _published() -> Iterator[tuple[str, Callable[[], Network]]]:
    yield from ((f"published {n}", make) for n, make in arriving.NETWORKS.items())
    for make in (simulated.levelling, simulated.gnss, simulated.free_block, simulated.free_images):
        yield f"simulated {make.__name__}", make
    for make in (simulated.own_cameras, simulated.weighted_photos, simulated.held_photo):
        yield f"simulated {make.__name__}", make


DAYS_PLAYED = 100
"""Days that are played on each engine."""


def results(share: float = 1.0) -> Iterator[Results]:
    """Return the results of all networks, one after the other.

    Args:
        share: part of each sort that is taken.
    """
    for sort, (number, make) in _networks().items():
        for seed in range(round(share * number)):
            yield adjusted(f"{sort} {seed}", make(seed))
    if share == 1.0:
        for name, build in _published():
            yield adjusted(name, build())
    for seed in range(round(share * DAYS_PLAYED)):
        for engine in ("isam2", "fronts"):
            yield arrived(f"day {seed} on {engine}", seed, engine)


def write(path: Path, share: float = 1.0) -> int:
    """Write all results; return their number."""
    n = 0
    with gzip.open(path, "wt", encoding="utf-8") as out:
        for r in results(share):
            out.write(json.dumps(vars(r)) + "\n")
            n += 1
    return n


def _read(path: Path) -> dict[str, Results]:
    with gzip.open(path, "rt", encoding="utf-8") as lines:
        read = (Results(**json.loads(line)) for line in lines)
        return {r.name: r for r in read}


def difference(a: list[float], b: list[float]) -> float:
    """Return the largest difference relative to the largest number; 0: equal to the last bit."""
    if len(a) != len(b):
        return float("inf")
    x, y = np.array(a), np.array(b)
    if np.array_equal(x, y, equal_nan=True):
        return 0.0
    size = float(np.nanmax(np.abs(x), initial=0.0)) or 1.0
    apart = np.where(np.isnan(x) & np.isnan(y), 0.0, np.abs(x - y))
    return float("inf") if np.isnan(apart).any() else float(apart.max()) / size


def compare(before: Path, after: Path) -> list[str]:
    """Return a line for each quantity that differs, and for networks that only one file has."""
    a, b = _read(before), _read(after)
    lines = [f"only in one file: {name}" for name in sorted(set(a) ^ set(b))]
    other: dict[str, list[tuple[float, str]]] = defaultdict(list)
    for name in a.keys() & b.keys():
        for what in a[name].values.keys() | b[name].values.keys():
            d = difference(a[name].values.get(what, []), b[name].values.get(what, []))
            if d > 0:
                other[what].append((d, name))
        for what in a[name].texts.keys() | b[name].texts.keys():
            if a[name].texts.get(what) != b[name].texts.get(what):
                other[what].append((float("inf"), name))
    for what, found in sorted(other.items()):
        found.sort(reverse=True)
        worst = "; ".join(f"{name}: {d:.1e}" for d, name in found[:SHOWN])
        lines.append(f"{what}: {len(found)} of {len(a)} networks differ ({worst})")
    return lines


def main() -> None:
    """Write a record, or compare two."""
    match sys.argv[1:]:
        case ["write", file, *share]:
            n = write(Path(file), float(share[0]) if share else 1.0)
            print(f"{n} networks")
        case ["compare", before, after]:
            lines = compare(Path(before), Path(after))
            print("\n".join(lines) if lines else "all results are equal to the last bit")
            sys.exit(bool(lines))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
