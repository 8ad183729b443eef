"""Senders that post single readings to a served site: ``python -m tests.benchmarks.site_load``.

``site_load [--senders 20] [--rate 50] [--seconds 20] [--list 1] [--shared] [--command]`` serves
the yard as a process. Each sender has a connection and a token of its own and posts readings of a
levelled difference, each with a request of its own, ``--list`` of them in one HTTP request, in turn
with their answers. A reading that is due while an answer is awaited is posted after it; latency
counts from when it was due. What is refused with 429 or 503 is sent again after what
``Retry-After`` says. Afterwards everything that was acknowledged is there once. ``--shared`` gives
all senders one token, whose limit of requests then holds for all of them. With ``--command`` each
sender is a process ``factorgraph-adj send`` with an outbox on the disk, into which its readings are
piped one by one.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from factorgraph_adj.cli.site_sending import TOKEN_VARIABLE
from factorgraph_adj.site.access import Access
from factorgraph_adj.site.database import Database
from tests.networks.yard import ARRIVALS
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import ADDRESS, database_of, site_of, yard_of

BEGIN = 1_700_002_800.0
"""Time of the first reading, seconds UTC."""
COMMANDS_START = 1.0
"""Time that each command has to start before readings are due, seconds."""
NOISE = 0.0004
"""Standard deviation of the readings, metres."""


@dataclass
class Load:
    """What senders saw."""

    seconds: float = 0.0
    """From the first reading that was due to the last answer."""
    offered: int = 0
    """Readings that were sent."""
    cpu: float = 0.0
    """CPU time of the service meanwhile, seconds."""
    cpu_of_senders: float = 0.0
    """CPU time of the commands that sent, from their start, seconds."""
    latencies: list[float] = field(default_factory=list)
    """From when each reading was due to its acknowledgement, seconds."""
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


class Command:
    """One sender as a process ``factorgraph-adj send``."""

    def __init__(self, url: str, token: str, outbox: Path) -> None:
        command = [sys.executable, "-m", "factorgraph_adj", "send", url, "yard"]
        self.process = subprocess.Popen(
            [*command, "--outbox", str(outbox)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | {TOKEN_VARIABLE: token},
            text=True,
        )

    def write(self, posting: Mapping[str, object]) -> None:
        """Send a line."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(posting) + "\n")
        self.process.stdin.flush()

    def answers(self) -> Iterator[dict]:
        """Iterate over the answers as they come."""
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            yield from map(json.loads, lines)

    def end(self) -> None:
        """Say that nothing more comes."""
        assert self.process.stdin is not None
        self.process.stdin.close()


class Sender:
    """One sender with its connection; an empty token: the site needs none."""

    def __init__(self, port: int, token: str) -> None:
        self.headers = {"Content-Type": "application/json"}
        if token:
            self.headers["Authorization"] = f"Bearer {token}"
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
    command: bool = False,
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
        command: whether senders are processes ``factorgraph-adj send``.
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
    commands = [
        Command(site.url, tokens[k % len(tokens)], folder / f"outbox{k}.sqlite")
        for k in range(senders if command else 0)
    ]
    time.sleep(COMMANDS_START * len(commands))
    begun, before = time.monotonic() + 0.2, cpu_seconds(site.process.pid)

    def reading(number: int, n: int, i: int, own: np.random.Generator) -> dict[str, object]:
        name = f"l{number}-{n}-{i}"
        value = round(1.4996 + float(own.normal(0.0, NOISE)), 6)
        out = {"kind": "height_difference", "station": "A", "target": "C", "value": value}
        return out | {"id": name, "time": BEGIN + n, "request": name}

    def noted(due: float, ident: object, answer: dict, status: int = 200) -> None:
        with lock:
            out.latencies.append(time.monotonic() - due)
            out.acknowledged[str(ident)] += 1
            if status != 200 or not answer["ok"] or answer.get("repeated"):
                out.wrong.append(answer)

    def pipe(number: int) -> None:
        own = np.random.default_rng((seed, number))
        offset = own.uniform(0.0, 1.0 / rate)
        for n in range(int(seconds * rate)):
            time.sleep(max(0.0, begun + offset + n / rate - time.monotonic()))
            commands[number].write(reading(number, n, 0, own))
        commands[number].end()

    def receive(number: int) -> None:
        offset = np.random.default_rng((seed, number)).uniform(0.0, 1.0 / rate)
        for answer in commands[number].answers():
            n = int(answer["id"].split("-")[1])
            noted(begun + offset + n / rate, answer["id"], answer)

    def send(number: int) -> None:
        own = np.random.default_rng((seed, number))
        sender = Sender(site.port, tokens[number % len(tokens)])
        offset = own.uniform(0.0, together / rate)
        for n in range(int(seconds * rate / together)):
            due = begun + offset + n * together / rate
            postings = [reading(number, n, i, own) for i in range(together)]
            time.sleep(max(0.0, due - time.monotonic()))
            while True:
                status, wait, said = sender.post(postings)
                if status not in (429, 503):
                    break
                with lock:
                    out.refused[status] += 1
                time.sleep(wait)
            answers = said if isinstance(said, list) else [said]
            for posting, answer in zip(postings, answers, strict=True):
                noted(due, posting["id"], answer, status)
        sender.connection.close()

    work = (pipe, receive) if command else (send,)
    threads = [threading.Thread(target=do, args=(k,)) for k in range(senders) for do in work]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    out.seconds = time.monotonic() - begun
    each = 1 if command else together
    out.offered = senders * int(seconds * rate / each) * each
    out.cpu = cpu_seconds(site.process.pid) - before
    for sending in commands:
        assert sending.process.wait(HANGS) == 0
    times = os.times()
    out.cpu_of_senders = times.children_user + times.children_system
    site.stop()
    return out


def assert_everything_is_there_once(folder: Path, found: Load) -> None:
    """Compare the site with what was acknowledged."""
    assert not found.wrong, found.wrong[:3]
    assert set(found.acknowledged.values()) == {1} and len(found.acknowledged) == found.offered
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
    parser.add_argument("--command", action="store_true")
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
            command=options.command,
        )
        assert_everything_is_there_once(folder, found)
    number, ms = len(found.latencies), 1e3 * np.array(found.latencies)
    how = "piped to the command send" if options.command else f"{options.list} in a request"
    print(
        f"{options.senders} senders, {options.rate:g} readings/s each, {how}:"
        f" {number} acknowledged in {found.seconds:.1f} s = {number / found.seconds:.0f}/s, each "
        f"there once\n  latency from when it was due: median {np.median(ms):.0f} ms, 99 % "
        f"{np.quantile(ms, 0.99):.0f} ms, maximum {ms.max():.0f} ms\n  refused and sent again: "
        f"{dict(found.refused) or 'none'}; CPU of the service {found.cpu:.1f} s, "
        f"{1e3 * found.cpu / number:.2f} ms a reading"
        + (
            f", of the commands {found.cpu_of_senders:.1f} s with their start"
            if options.command
            else ""
        )
    )


if __name__ == "__main__":
    main()
