"""A day of arrivals and commands of every kind, and a process that plays it and may be killed.

Run as a program it reads orders from standard input, one in a line,
``{"journal": …, "from": …, "engine": …}``, forks a process for each that plays the day from a step
on, and tells ``pid …``, ``done`` after every finished step, and in the end ``end …`` with the
status of the process. Where the journal exists, the process goes on with it, in its own engine. As
the parent has everything imported, a process begins at once.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from factorgraph_adj import IncrementalAdjustment, Network
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.observations import AnyObservation, Correlated, HeightDifference, Observation
from factorgraph_adj.simulation.measurement import measure
from tests.networks.site import CONTROL, UNKNOWN, plan
from tests.support.arrivals import ids_of, items

Step = Callable[[IncrementalAdjustment], object]
FIRST = ("S1", "S2", "P0", "P1", "P2", "P3")
"""New points that are there from the beginning."""


@cache
def site() -> tuple[Network, dict[str, AnyObservation]]:
    """Return the measured site, and its observations by their (first) ids."""
    measured = measure(plan(), seed=7)
    return measured, {ids_of(i)[0]: i for i in items(measured)}


def morning() -> Network:
    """Return held points, some new ones, and what is known of other unknowns; no camera."""
    measured, _ = site()
    network = Network("a day on the site")
    for name in (*CONTROL, *FIRST):
        held = "xyz" if name in CONTROL else ""
        network.add_point(name, measured.points[name].coordinates if held else None, fixed=held)
    for kind in ("distance_meters", "refractions"):
        getattr(network, kind).update(getattr(measured, kind))
    return network


def _wrong(ident: str, by: float) -> Observation:
    o: Any = site()[1][ident]
    return replace(o, value=o.value + by)  # type: ignore[no-any-return]


def day() -> list[Step]:
    """Return the steps of the day, each of them one transaction."""
    return [*_survey(), *_decisions(), *_photos(), *_evening()]


def _add(*ids: str, **new: Any) -> Step:
    observations = [site()[1][i] for i in ids]
    return lambda inc: inc.add(observations, **new)


def _survey() -> Iterator[Step]:
    """Stations one after the other; the first sights wait until their station is determined."""
    for station in ("S1", "S2"):
        for target in (*CONTROL, *FIRST):
            if target != station:
                own = f"{station}-{target}-a"
                yield _add(f"r{own}")
                yield _add(f"z{own}", f"d{own}")
    for a, b in (("P0", "C"), ("P1", "P2"), ("P3", "B")):
        found = [i for i in site()[1] if i.startswith(f"h{a}-{b}-")]
        if found:
            yield _add(found[0])
    yield _add("v1P1-a")  # a correlated pair
    new = [Point("P4", UNKNOWN), Point("S3", UNKNOWN)]
    yield _add("dS1-P4-a", "rS1-P4-a", points=new)
    yield _add("zS1-P4-a")
    yield _add("rS3-A-a", "rS3-B-a", "rS3-C-a", "dS3-A-a", "dS3-B-a", "zS3-A-a", "zS3-B-a")
    for target in ("P0", "P2", "P4", "S1"):
        own = f"S3-{target}-a"
        yield _add(f"r{own}", f"z{own}", f"d{own}")


def _decisions() -> Iterator[Step]:
    """Suspects, accepted and discarded; taking out, replacing, other weights."""
    yield lambda inc: inc.add(_wrong("dS1-P0-b", 0.1))
    yield lambda inc: inc.add([_wrong("zS1-P1-b", 0.01), _wrong("dS2-P2-b", -0.2)])
    yield lambda inc: inc.discard("zS1-P1-b")
    yield lambda inc: inc.accept("dS2-P2-b")
    yield lambda inc: inc.remove("dS2-P2-b")
    yield _add("zS1-P1-b")  # measured again
    yield lambda inc: inc.replace("dS1-P0-b", site()[1]["dS1-P0-b"])  # type: ignore[arg-type]
    yield lambda inc: inc.reweight(["dS1-P1-a", "zS1-P2-a"], 0.25)
    yield lambda inc: inc.reweight("v1P1-a", 2.0)
    yield lambda inc: inc.remove("v2P1-a")  # the rest of the pair stays
    yield _add("v1P5-a", points=[Point("P5", UNKNOWN)])  # a pair determines a point
    yield lambda inc: inc.remove(["dS1-P4-a", "rS1-P4-a"])
    yield lambda inc: inc.remove(_of(inc, "P4")[:2])  # it waits again
    yield _add("dS1-P4-a", "rS1-P4-a")
    yield lambda inc: inc.add(_wrong("zS2-P3-b", 0.02))
    yield lambda inc: inc.accept("zS2-P3-b")
    yield lambda inc: inc.snoop()
    yield lambda inc: inc.add(_loose())
    yield lambda inc: inc.remove("loose 1")


def _of(inc: IncrementalAdjustment, point: str) -> list[str]:
    """Return the ids of the sights to a point in the graph."""
    return [i for i, o in inc.network().observations.items() if point in o.names()]


def _loose() -> Correlated:
    """Return a pair that waits, as nothing else determines its point."""
    pair = (
        HeightDifference("A", "P5", 1.0, sigma=0.01, id="loose 1"),
        HeightDifference("B", "P5", 1.0, sigma=0.01, id="loose 2"),
    )
    return Correlated(pair, 1e-4 * np.array([[1.0, 0.5], [0.5, 1.0]]))


def _photos() -> Iterator[Step]:
    """A camera, photos with and without orientation, their rays."""
    measured, by_id = site()
    there = ("S1", "S2", "S3", "P0", "P1", "P2")
    yield _add(cameras=list(measured.cameras.values()))
    for name in ("F0", "F1", "F2"):
        photo = measured.photos[name]
        if name != "F0":
            photo = Photo(name, "cam")
        rays = [f"{name}/{p}" for p in (*CONTROL, *there) if f"{name}/{p}" in by_id]
        yield _add(*rays[:2], photos=[photo])
        yield _add(f"q{name}-a")
        yield _add(*rays[2:5])
        for ray in rays[5:]:
            yield _add(ray)


def _evening() -> Iterator[Step]:
    yield lambda inc: inc.remove("F0/A")
    yield lambda inc: inc.reweight(["F0/C", "F1/A"], 0.5)
    yield _add("F0/A")
    yield lambda inc: inc.settle()
    for target in ("A", "B", "P0", "P1", "P2", "P3"):
        yield _add(f"rS2-{target}-b", f"zS2-{target}-b") if target != "P3" else _add("rS2-P3-b")


def play(journal: str, first: int, engine: Engine, *, tell: Callable[[], None]) -> None:
    """Play the day from a step on."""
    if Path(journal).exists():
        inc = IncrementalAdjustment.resume(journal, engine=engine)
    else:
        inc = IncrementalAdjustment(morning(), journal=journal, engine=engine)
    for step in day()[first:]:
        step(inc)
        tell()


def main() -> None:
    """Fork a process for each order."""
    day()  # what is imported and measured once is there for all
    for line in sys.stdin:
        order = json.loads(line)
        pid = os.fork()
        if not pid:
            os.write(1, f"pid {os.getpid()}\n".encode())
            begin = order["journal"], order["from"], order["engine"]
            play(*begin, tell=lambda: os.write(1, b"done\n") and None)
            os.read(0, 1)  # through with the day before it is killed; nothing comes before its end
            os._exit(0)
        _, status = os.waitpid(pid, 0)
        os.write(1, f"end {status}\n".encode())


if __name__ == "__main__":
    main()
