"""Next sights in a grid of total stations: ``python -m tests.benchmarks.next_sights [POINTS]``.

All sights that are possible now: from some stations to every point, and from every station within
reach. For each engine, CPU seconds of the first question, of the same again (medians), and of one
after each of some arrivals.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from statistics import median
from time import process_time
from typing import Any

import factorgraph_adj as fga
from factorgraph_adj.observations import SlopeDistance

from .grids import simulate_grid

POINTS, REPEATED, ARRIVING = 1000, 7, 9
STATIONS = (3, 20)
"""Numbers of stations from which every point is a target."""
FAR = 1e6


def seconds(inc: fga.IncrementalAdjustment, name: str, options: Mapping[str, Any]) -> float:
    """Return the CPU seconds of a question."""
    begun = process_time()
    inc.next_sights(name, **options)
    return process_time() - begun


def main() -> None:
    """Print the table."""
    points = int(sys.argv[1]) if len(sys.argv) > 1 else POINTS
    network = simulate_grid(1, points=points).network
    names, solution = list(network.points), fga.adjust(network)
    target = names[len(names) // 2]
    readings = [o for o in network.observations.values() if isinstance(o, SlopeDistance)]
    questions: dict[str, dict[str, Any]] = {
        f"{n} stations, all points": {
            "stations": tuple(names[:: len(names) // n][:n]),
            "reach": FAR,
        }
        for n in STATIONS
    }
    questions["all stations, neighbours"] = {}
    print(f"{'engine':8}{'candidates':28}{'number':>8}{'first':>8}{'again':>8}{'arrival':>9}")
    for engine in ("fronts", "isam2"):
        for label, options in questions.items():
            inc = fga.IncrementalAdjustment(network, engine=engine, start=solution)  # type: ignore[arg-type]
            first = seconds(inc, target, options)
            again = median(seconds(inc, target, options) for _ in range(REPEATED))
            after = []
            for i in range(ARRIVING):
                o = readings[17 * i]
                inc.add(replace(o, id=f"again {i}", value=o.value + 1e-4 * i))
                after.append(seconds(inc, target, options))
            number = inc.next_sights(target, **options).examined
            print(
                f"{engine:8}{label:28}{number:8}{first:8.3f}{again:8.3f}{median(after):9.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
