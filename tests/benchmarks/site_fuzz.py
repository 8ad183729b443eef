"""Requests and lines at random to a site: ``python -m tests.benchmarks.site_fuzz [--examples N]``.

``--postgresql`` asks a site whose database is of a PostgreSQL server that it starts.

Half of the examples are requests to all routes of the API by its OpenAPI document, of callers with
all roles and without one, with what the document allows and what it does not; see
`tests.support.api_fuzz`. The other half are lines, whole, damaged and hostile, that a served site
reads by TCP with the grammars of all instruments, and floods after them; see
`tests.support.line_fuzz`. It ends with 1 where an answer was of 500 or more or not as the document
says; a site that fails under lines ends it at once.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
from tests.networks.yard import ARRIVALS
from tests.support.api_fuzz import ApiFuzz
from tests.support.damaged_lines import LINES
from tests.support.line_fuzz import fuzz_lines
from tests.support.sites import storing_in, yard_of, yard_site


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--examples", type=int, default=20_000)
    parser.add_argument("--flood", type=int, default=20_000_000, help="bytes of each flood")
    parser.add_argument("--postgresql", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    begun = time.monotonic()
    store = "postgresql" if options.postgresql else "sqlite"
    with storing_in(store), tempfile.TemporaryDirectory() as folder:
        site = Site(read_site(yard_site(Path(folder))))
        site.start()
        try:
            for record in ARRIVALS:
                assert yard_of(site).submit(record).result(60)["ok"]
            asked = ApiFuzz(site, seed=options.seed).ask(options.examples // 2)
            assert site.health()["ok"]
        finally:
            site.stop()
    print(
        f"{asked.routes.total()} requests to {len(asked.routes)} routes in "
        f"{time.monotonic() - begun:.0f} s: {len(asked.faults)} faults; statuses "
        f"{dict(sorted(asked.statuses.items()))}; callers {dict(asked.roles)}",
        flush=True,
    )
    for fault, number in asked.faults.most_common():
        print(number, *fault)
    begun, each = time.monotonic(), -(-options.examples // 2 // len(LINES))
    with tempfile.TemporaryDirectory() as folder:
        found = fuzz_lines(Path(folder), lines=each, flood=options.flood, seed=options.seed)
    print(
        f"{found.lines} lines of {len(LINES)} grammars in {time.monotonic() - begun:.0f} s: "
        f"{found.refused} refused and told, {found.postings} postings; floods of "
        f"{found.flooded / 1e6:.0f} MB cost {found.growth / 1e6:.1f} MB of memory; the site "
        "answers, and takes whole lines of each grammar"
    )
    return 1 if asked.faults else 0


if __name__ == "__main__":
    sys.exit(main())
