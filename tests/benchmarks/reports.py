"""HTML reports at four sizes: ``python -m tests.benchmarks.reports [NAME …]``.

For each network: rows, size of the file, CPU seconds to make it, and in Chromium the CPU seconds of
the page until the plan can be read and until the table of all observations can be sorted after
that, and the seconds by the clock until the 3-D view stands, which software draws here. The least
of `ROUNDS`, since other work only adds to them.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block

from ..networks.dbat import read_roma
from ..networks.reported import three_points
from ..support.pages import chromium, opened
from ..support.places import EXAMPLES
from .worker import ROMA

ROUNDS = 5
NETWORKS: dict[str, Callable[[], Network]] = {
    "three points": three_points,
    "industry block": lambda: fga.read_project(EXAMPLES / "industry_block"),
    "1000 photos": lambda: (
        simulate_aerial_block(1, image_points=30_000, points_per_photo=30).network
    ),
    "Roma": lambda: read_roma(ROMA),
}


def in_browser(file: Path) -> tuple[float, float, float]:
    """Return the seconds to the plan, to a living table of observations, and to the 3-D view."""
    with chromium() as browser, opened(browser, file) as found:
        found.page.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
        plan = found.seconds()
        found.ready()
        before = found.seconds()
        found.alive("observations")
        table = found.seconds() - before
        begun, scene = perf_counter(), 0.0
        if found.page.locator("#scene-show").count():
            found.page.locator("#scene-show").click()
            found.page.wait_for_selector("#scene[data-made]", timeout=120_000)
            scene = perf_counter() - begun
        return plan, table, scene


def main(names: list[str]) -> None:
    """Print the table."""
    print(f"{'':16}{'points':>8}{'photos':>8}{'rows':>9}{'MB':>7}", end="")
    print(f"{'made s':>8}{'plan s':>8}{'table s':>9}{'3-D s':>7}")
    for name in names or list(NETWORKS):
        solution = fga.adjust(NETWORKS[name]())
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "report.html"
            begun = process_time()
            fga.write_report(solution, file)
            made = process_time() - begun
            taken = [in_browser(file) for _ in range(ROUNDS)]
            size = file.stat().st_size / 1e6
        plan, table, scene = (min(t) for t in zip(*taken, strict=True))
        counts = f"{len(solution.network.points):8}{len(solution.network.photos):8}"
        figures = f"{solution.n_observations:9}{size:7.1f}{made:8.1f}{plan:8.1f}{table:9.1f}"
        print(f"{name:16}{counts}{figures}{scene:7.1f}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
