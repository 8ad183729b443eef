"""A sender with an outbox as a process that may be killed.

Its readings are determined by a seed and their number, and each has its id as its request: a sender
that was killed between its outbox and its own list puts the same reading in again. While the site
is away it goes on to measure, as an instrument does. Lists in the folder tell what happened:
``put`` (ids on the disk of the outbox), ``acknowledged`` (with each answer), ``repeated`` (the site
had the reading already, and its first answer was lost) and ``refused``. When the file ``enough`` is
there, it empties its outbox and ends.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from factorgraph_adj.site.client import Client, ServiceAway
from factorgraph_adj.site.outbox import Kept, Outbox
from tests.support.processes import HANGS

BEGIN = 1_700_002_800.0
"""Begin of the first epoch, seconds UTC: a full hour."""
STEP = 40.0
"""Time between two readings of a sender, seconds: ninety in an epoch."""
LATE_SHARE = 0.02
"""Share of readings that come an epoch too late."""
NOISE = 0.0004
"""Standard deviation of the readings, metres."""
LONGEST_WAIT = 0.4
"""Longest time between two tries, seconds: a site is posted to as soon as it is back."""
LISTS = ("put", "acknowledged", "repeated", "refused")
"""Names of the lists."""
ENOUGH = "enough"
"""File whose presence ends all senders of its folder."""


def reading(seed: int, sender: int, n: int) -> dict[str, Any]:
    """Return a reading of a sender, which is the same whenever it is made."""
    own, ident = np.random.default_rng((seed, sender, n)), f"k{sender}-{n}"
    at = BEGIN + 2.0 + n * STEP
    if own.random() < LATE_SHARE:
        at = max(BEGIN + 2.0, at - 3600.0)
    value = round(1.4996 + float(own.normal(0.0, NOISE)), 6)
    rise = {"kind": "height_difference", "station": "A", "target": "C", "value": value}
    return {**rise, "id": ident, "time": at, "request": ident}


def listed(folder: Path, name: str, sender: int) -> list[str]:
    """Return the whole lines of a list of a sender that are not empty; a kill may tear the last."""
    path = folder / f"{name}{sender}.txt"
    lines = path.read_text().split("\n")[:-1] if path.exists() else []
    return [line for line in lines if line]


def main(url: str, folder: Path, sender: int, seed: int, pause: float) -> None:
    """Send until there is enough."""
    files = {n: (folder / f"{n}{sender}.txt").open("a") for n in LISTS}

    def note(name: str, text: str) -> None:
        files[name].write(f"{text}\n")
        files[name].flush()

    def answered(kept: Kept, answer: dict[str, Any]) -> None:
        note("acknowledged", kept.record["id"])
        if answer.get("repeated"):
            note("repeated", kept.record["id"])
        if not answer["ok"]:
            note("refused", json.dumps(answer))

    # A torn line is of a reading that is in the outbox: it is put in again, on a line of its own.
    n = len(listed(folder, "put", sender))
    for file in files.values():
        file.write("\n")
    outbox = Outbox(folder / f"outbox{sender}.sqlite")
    with Client(url, longest_wait=LONGEST_WAIT) as client:
        while True:
            enough = (folder / ENOUGH).exists()
            if not enough:
                n += 1
                record = reading(seed, sender, n)
                outbox.put("yard", record)
                note("put", record["id"])
            with suppress(ServiceAway):
                client.send(outbox, answered=answered, patience=HANGS if enough else LONGEST_WAIT)
            if enough and not len(outbox):
                return
            time.sleep(pause)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]))
