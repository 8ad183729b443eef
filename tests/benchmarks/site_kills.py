"""Kill a served site at N random moments: ``python -m tests.benchmarks.site_kills 500 [SEED]``.

Three senders post from their outboxes, a follower takes the events. Afterwards everything that was
acknowledged is there once, the chains of the journals are whole, and the estimates of all epochs
are those of batch adjustments; see `tests.support.site_kills`. ``--postgresql`` takes a database of
a PostgreSQL server that it starts.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.support.site_kills import assert_nothing_is_lost_or_doubled, campaign
from tests.support.sites import storing_in


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kills", type=int, nargs="?", default=500)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--postgresql", action="store_true")
    options = parser.parse_args()
    store = "postgresql" if options.postgresql else "sqlite"
    begun = time.monotonic()
    with storing_in(store), tempfile.TemporaryDirectory() as folder:
        found = campaign(Path(folder), kills=options.kills, seed=options.seed)
        assert_nothing_is_lost_or_doubled(Path(folder), found)
    print(
        f"{found.kills} kills in {time.monotonic() - begun:.0f} s on {store}: "
        f"{len(found.put)} readings acknowledged, each there once; {len(found.numbers)} events "
        f"followed without gap; restart {np.median(found.restarts):.2f} s (median)"
    )


if __name__ == "__main__":
    main()
