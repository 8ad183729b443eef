"""Senders that post single readings to a served site: ``python -m tests.benchmarks.site_load``.

``site_load [--senders 20] [--rate 50] [--seconds 20] [--list 1] [--shared]`` serves the yard as a
process. Each sender has a connection and a token of its own and posts readings of a levelled
difference, each with a request of its own, ``--list`` of them in one HTTP request, in turn with
their answers. A reading that is due while an answer is awaited is posted after it; latency counts
from when it was due. What is refused with 429 or 503 is sent again after what ``Retry-After``
says. Afterwards everything that was acknowledged is there once. ``--shared`` gives all senders one
token, whose limit of requests then holds for all of them.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from factorgraph_adj.site.access import Access
from factorgraph_adj.site.database import Database
from tests.networks.yard import ARRIVALS
from tests.support.site_processes import SiteProcess
from tests.support.sites import ADDRESS, database_of, site_of, yard_of

BEGIN = 1_700_002_800.0
"""Time of the first reading, seconds UTC."""
NOISE = 0.0004
"""Standard deviation of the readings, metres."""


@dataclass
class Load:
    """What senders saw."""

    seconds: float = 0.0
    """From the first reading that was due to the last answer."""
    cpu: float = 0.0
    """CPU time of the service meanwhile, seconds."""
    latencies: list[float] = field(default_factory=list)
    """From when each reading was due to its acknowledgement, seconds."""
    services: list[float] = field(default_factory=list)
    """From when each request was sent to its answer, seconds."""
    acknowledged: Counter[str] = field(default_factory=Counter)
    """How often the answer to each reading came."""
    refused: Counter[int] = field(default_factory=Counter)
    """Requests that were refused, and sent again, by their status."""
    wrong: list[object] = field(default_factory=list)
    """Answers that no reading should get."""


def cpu_seconds(process: int) -> float:
    """Return the CPU time of a process."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(process: int) -> float:
    """Return the resident memory of a process, MB."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096 / 2**20


class Sender:
    """One sender with its connection."""

    def __init__(self, port: int, token: str) -> None:
        self.headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
        self.connection = http.client.HTTPConnection("127.0.0.1", port, timeout=300.0)

    def post(self, postings: list[dict]) -> tuple[int, float, object]:
        """Return status, what ``Retry-After`` says, and the answer."""
        body = json.dumps(postings if len(postings) > 1 else postings[0])
        self.connection.request("POST", f"{ADDRESS}/postings", body, self.headers)
        response = self.connection.getresponse()
        said = json.loads(response.read())
        wait = float(response.headers.get("Retry-After", 0))
        return response.status, wait, said


def load(
    folder: Path,
    *,
    senders: int,
    rate: float,
    seconds: float,
    together: int = 1,
    shared: bool = False,
    seed: int = 1,
) -> Load:
    """Serve the yard in a folder, let senders post, and return what they saw.

    Args:
        folder: folder of the site, which is made there.
        senders: number of senders.
        rate: readings of each in a second.
        seconds: time in which readings are due.
        together: readings in one HTTP request.
        shared: whether all senders have one token.
        seed: of the readings.
    """
    database = Database(database_of(folder))
    access = Access(database)
    names = ["all"] if shared else [f"s{k}" for k in range(senders)]
    tokens = [access.add(name, "instrument") for name in names]
    database.close()
    site, out, lock = SiteProcess(folder), Load(), threading.Lock()
    site.start()
    assert site.process is not None
    first = Sender(site.port, tokens[0])
    for record in ARRIVALS:
        status, _, said = first.post([{**record, "time": BEGIN}])
        assert status == 200, said
    first.connection.close()
    begun, before = time.monotonic() + 0.2, cpu_seconds(site.process.pid)

    def send(number: int) -> None:
        own = np.random.default_rng((seed, number))
        sender = Sender(site.port, tokens[number % len(tokens)])
        offset = own.uniform(0.0, together / rate)
        for n in range(int(seconds * rate / together)):
            due = begun + offset + n * together / rate
            postings = [
                {
                    "kind": "height_difference",
                    "station": "A",
                    "target": "C",
                    "value": round(1.4996 + float(own.normal(0.0, NOISE)), 6),
                    "id": f"l{number}-{n}-{i}",
                    "time": BEGIN + n,
                    "request": f"l{number}-{n}-{i}",
                }
                for i in range(together)
            ]
            time.sleep(max(0.0, due - time.monotonic()))
            while True:
                sent = time.monotonic()
                status, wait, said = sender.post(postings)
                if status not in (429, 503):
                    break
                with lock:
                    out.refused[status] += 1
                time.sleep(wait)
            now = time.monotonic()
            answers = said if isinstance(said, list) else [said]
            with lock:
                out.services.append(now - sent)
                out.latencies += [now - due] * together
                for posting, answer in zip(postings, answers, strict=True):
                    out.acknowledged[posting["id"]] += 1
                    if status != 200 or not answer["ok"] or answer.get("repeated"):
                        out.wrong.append(answer)
        sender.connection.close()

    threads = [threading.Thread(target=send, args=(k,)) for k in range(senders)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    out.seconds = time.monotonic() - begun
    out.cpu = cpu_seconds(site.process.pid) - before
    site.stop()
    return out


def assert_everything_is_there_once(folder: Path, found: Load) -> None:
    """Compare the site with what was acknowledged."""
    assert not found.wrong, found.wrong[:3]
    assert set(found.acknowledged.values()) == {1}
    sent = {str(r["id"]) for r in ARRIVALS} | set(found.acknowledged)
    with site_of(folder) as site, yard_of(site).reading() as epoch:
        inc = epoch.stream.adjustment
        there = Counter([*inc.network().observations])
        there.update(v.id for v in (*inc.waiting, *inc.suspects, *inc.rejected))
    assert set(there) == sent and set(there.values()) == {1}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--senders", type=int, default=20)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--list", type=int, default=1)
    parser.add_argument("--shared", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = load(
            folder,
            senders=options.senders,
            rate=options.rate,
            seconds=options.seconds,
            together=options.list,
            shared=options.shared,
        )
        assert_everything_is_there_once(folder, found)
    number, ms = len(found.latencies), 1e3 * np.array(found.latencies)
    print(
        f"{options.senders} senders, {options.rate:g} readings/s each, {options.list} in a request:"
        f" {number} acknowledged in {found.seconds:.1f} s = {number / found.seconds:.0f}/s, each "
        f"there once\n  latency from when it was due: median {np.median(ms):.0f} ms, 99 % "
        f"{np.quantile(ms, 0.99):.0f} ms, maximum {ms.max():.0f} ms; from request to answer "
        f"{1e3 * np.median(found.services):.0f} ms (median)\n  refused and sent again: "
        f"{dict(found.refused) or 'none'}; CPU of the service {found.cpu:.1f} s, "
        f"{1e3 * found.cpu / number:.1f} ms a reading"
    )


if __name__ == "__main__":
    main()
