"""Simulated mistakes that `check` tells: ``python -m tests.benchmarks.checks [CASES [NETWORKS]]``.

Each case is a building site, or a hall that a scanner saw from three stations, with noise of its
own and one mistake at a random place. Prints of how many cases the mistake is told, and in how many
networks that were drawn by chance, without a mistake, any of these checks tells something.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, LevelHeight, SlopeDistance, ZenithAngle
from tests.benchmarks.causes import adjusted
from tests.field_mistakes.mistakes import polar
from tests.field_mistakes.projects import hall
from tests.networks.building_site import site
from tests.networks.random_small import random_network

CASES, NETWORKS = 100, 2000
GON_AS_DEGREES = 10.0 / 9.0
"""By how much readings in gon are too large where degrees are stated."""
FOOT = 0.3048
OFF = 0.5
"""Error of the height of a lake, metres."""


@dataclass(frozen=True)
class Told:
    """A network with a mistake."""

    network: Network
    part: str
    """What the sentence that tells it has in it."""
    length: str = "m"
    """Stated unit of lengths."""
    angle: str = "gon"
    """Stated unit of angles."""


def read_site(seed: int, change: Callable[[Any], Any], *, places: bool = True) -> Network:
    """Return a building site with changed readings.

    Args:
        seed: of everything drawn.
        change: returns a reading as it is taken.
        places: whether points that are not held have rough coordinates.
    """
    network, readings, _ = site(seed)
    if not places:
        network.points = {
            n: p if all(p.fixed) else replace(p, coordinates=(np.nan,) * 3)
            for n, p in network.points.items()
        }
    return adjusted(network, [change(o) for o in readings])


def scaled(kind: type, factor: float) -> Callable[[Any], Any]:
    """Return a change that multiplies readings of a kind."""
    return lambda o: replace(o, value=o.value * factor) if isinstance(o, kind) else o


def scans(seed: int, *, exchanged: bool, factor: float = 1.0, sights: bool = False) -> Told:
    """Return a hall, with two targets of a scan exchanged or with another unit of one scan."""
    rng = np.random.default_rng([seed, 20])
    project = hall(seed)
    scan = f"scan{rng.integers(1, 4)}"
    a, b = sorted(f"H{i}" for i in rng.choice(12, 2, replace=False).tolist())
    for row in project.rows("frame_coordinate", frame=scan):
        if exchanged:
            row["point"] = {a: b, b: a}.get(row["point"], row["point"])
        for axis in "xyz":
            row[axis] = repr(float(row[axis]) * factor)
    if sights:
        polar(project)
    with tempfile.TemporaryDirectory() as folder:
        path = project.write(Path(folder) / "hall")
        network = READERS.load(path, allow_outside=False).network
    names = sorted((a, b), key=list(network.points).index)
    part = " and ".join(f"point {n!r}" for n in names) + f" are exchanged in frame {scan!r}"
    return Told(network, part if exchanged else f"the places of frame {scan!r} fit")


def lake(seed: int) -> Told:
    """Return a building site with a lake whose held height is wrong."""
    network, readings, true = site(seed)
    network.set_level("lake", OFF, fixed=True)
    shore = [LevelHeight(n, "lake", float(true[n][2]), sigma=0.02) for n in ("T0", "T1", "T2")]
    return Told(adjusted(network, [*readings, *shore]), "level surface 'lake'")


def in_degrees(kind: type, part: str, *, places: bool = True) -> Callable[[int], Told]:
    """Return what makes sites with readings in gon where degrees are stated."""

    def make(seed: int) -> Told:
        network = read_site(seed, scaled(kind, GON_AS_DEGREES), places=places)
        return Told(network, part, angle="deg")

    return make


def in_feet(*, places: bool) -> Callable[[int], Told]:
    """Return what makes sites with distances in feet where metres are stated."""
    part = "slope distances fit" if places else "as long as these are apart with the factor 0.30"
    return lambda seed: Told(read_site(seed, scaled(SlopeDistance, 1 / FOOT), places=places), part)


MISTAKES: dict[str, Callable[[int], Told]] = {
    "directions in gon, degrees stated": in_degrees(Direction, "more than the full circle"),
    "zenith angles in gon, degrees stated": in_degrees(ZenithAngle, "as gon, not degrees"),
    "zenith angles in gon, coordinates of held points alone": in_degrees(
        ZenithAngle, "are in gon, not in degrees", places=False
    ),
    "distances in feet, metres stated": in_feet(places=True),
    "distances in feet, coordinates of held points alone": in_feet(places=False),
    "a scan in millimetres, metres stated": lambda seed: scans(seed, exchanged=False, factor=1e3),
    "two targets of a scan exchanged": lambda seed: scans(seed, exchanged=True),
    "two polar points of a scan exchanged": lambda seed: scans(seed, exchanged=True, sights=True),
    "height of a lake 0.5 m wrong": lake,
}
"""What makes networks with a mistake from a seed, by its name."""
PARTS = (
    *("more than the full circle", "are in gon", "are in degrees", "are in radians"),
    *(
        "stated to be level",
        "better with its",
        "times better as",
        "with the factor",
        "are exchanged in",
        "contradicts the given heights of",
    ),
)
"""What the sentences of these checks have in them."""


def told(case: Told) -> list[str]:
    """Return what is told of a network."""
    found = fga.preliminary(case.network, length=case.length, angle=case.angle)
    return [str(f) for f in found]


def falsely_told(network: Network) -> bool:
    """Return whether one of these checks tells something of a network without a mistake."""
    return any(p in text for text in told(Told(network, "")) for p in PARTS)


def plain_site(seed: int) -> Network:
    """Return a building site without a mistake."""
    return read_site(seed, lambda o: o)


def plain_hall(seed: int) -> Network:
    """Return a hall without a mistake."""
    return scans(seed, exchanged=False).network


def by_snooping(seed: int) -> bool:
    """Return whether data snooping names an exchange in a scan."""
    case = scans(seed, exchanged=True)
    causes = fga.snoop(case.network, alpha=0.001).causes
    place = case.part.replace("point ", "").replace(" are exchanged", "")
    right = set(place.replace(",", "").split())
    return bool(
        causes and causes.found and right == set(causes.found[0].where.replace(",", "").split())
    )


def main(cases: int = CASES, networks: int = NETWORKS) -> None:
    """Print the tables."""
    for name, make in MISTAKES.items():
        n = sum(any(case.part in text for text in told(case)) for case in map(make, range(cases)))
        print(f"{name}: told in {n} of {cases}", flush=True)
    n = sum(map(by_snooping, range(cases)))
    print(f"two targets of a scan exchanged, by snooping: first in {n} of {cases}", flush=True)
    for name, some in (("sites", plain_site), ("halls", plain_hall)):
        alarms = sum(falsely_told(some(seed)) for seed in range(cases))
        print(f"without a mistake: told in {alarms} of {cases} {name}", flush=True)
    drawn = alarms = 0
    for seed in range(networks):
        try:
            network = random_network(seed).whole
        except InputError:
            continue
        drawn += 1
        alarms += falsely_told(network)
    print(f"without a mistake: told in {alarms} of {drawn} networks")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
