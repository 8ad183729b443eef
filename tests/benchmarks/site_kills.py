"""Kill a served site at N random moments: ``python -m tests.benchmarks.site_kills 500 [SEED]``.

Three sender processes post from their outboxes and are killed now and then too, a follower takes
the events, a browser has the page open. Afterwards everything that was acknowledged is there once,
the chains of the journals are whole, the estimates of all epochs are those of batch adjustments,
and the page has the last events and rows of the service, each once; see
`tests.support.site_kills`. ``--postgresql`` takes a database of a PostgreSQL server that it starts;
``--minutes`` ends the kills after a time, ``--folder`` leaves the site there for a look at it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.support.site_kills import Campaign, assert_nothing_is_lost_or_doubled, campaign
from tests.support.sites import storing_in

TOLD_EVERY = 25
"""Number of kills between two lines about them."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kills", type=int, nargs="?", default=500)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--postgresql", action="store_true")
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    until = time.time() + 60.0 * options.minutes if options.minutes else 0.0
    store = "postgresql" if options.postgresql else "sqlite"
    begun = time.monotonic()

    def tell(found: Campaign) -> None:
        if found.kills % TOLD_EVERY == 0:
            print(f"{found.kills} kills, {len(found.put)} readings", flush=True)

    with storing_in(store), tempfile.TemporaryDirectory() as made:
        folder = options.folder or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        options_of_run = {"kills": options.kills, "seed": options.seed, "until": until}
        found = campaign(folder, **options_of_run, page=True, told=tell)
        assert_nothing_is_lost_or_doubled(folder, found)
    print(
        f"{found.kills} kills of the site and {found.sender_kills} of senders in "
        f"{time.monotonic() - begun:.0f} s on {store}: {len(found.put)} readings, each there once, "
        f"{len(found.repeated)} of them sent again as their first answer was lost; "
        f"{len(found.numbers)} events followed without gap; the page has the last "
        f"{len(found.page['events'])} and {len(found.page['rows'])} rows, each once; restart "
        f"{np.median(found.restarts):.2f} s (median)"
    )


if __name__ == "__main__":
    main()
