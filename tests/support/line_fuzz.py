"""Damaged and hostile lines through the TCP sources of a served site: it stays up and tells them.

Each grammar has an instrument, which connects to a port of this process and gets whole, damaged and
random lines in pieces of random length. Then a flood follows: bytes without an end of line, and
lines faster than they can be read.
"""

from __future__ import annotations

import json
import random
import re
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2

from factorgraph_adj.instruments.line_sources import MAX_LINE_BYTES
from tests.support.damaged_lines import LINES, damaged
from tests.support.memory import resident_bytes
from tests.support.processes import HANGS
from tests.support.site_processes import SiteProcess
from tests.support.sites import until, yard_site

WHOLE_SHARE = 0.2
"""Share of lines that are not damaged."""
MAX_GROWTH = 64 << 20
"""Most memory that a flood may cost, bytes."""
HOSTILE = (
    b"\0" * 40,
    b"\xff\xfe\x80" * 9,
    "µ≈ŠŸ".encode("utf-16"),
    b"A" * MAX_LINE_BYTES,
    b"A" * (MAX_LINE_BYTES + 1),
    b"$" * 200_000,
    b"[" * 4000,
    b"{" + b'"a":{' * 600,
    b"9" * 4000,
    b"%R1P,0,0:0," + b"1e999," * 20,
    b"\x1b[2J\x07",
)
"""Lines that no instrument sends."""


class Feeder:
    """A port to which an instrument of the site connects, and what it gets there."""

    def __init__(self) -> None:
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.listening.getsockname()[1])
        self.connection: socket.socket | None = None

    def send(self, data: bytes, rng: random.Random) -> None:
        """Send bytes in pieces of random length."""
        if self.connection is None:
            self.listening.settimeout(HANGS)
            self.connection, _ = self.listening.accept()
        at = 0
        while at < len(data):
            length = rng.choice((1, 7, 80, 1460, 65536))
            self.connection.sendall(data[at : at + length])
            at += length

    def close(self) -> None:
        """End."""
        for end in (self.connection, self.listening):
            if end is not None:
                end.close()


@dataclass
class Fuzzed:
    """What happened."""

    lines: int = 0
    """Number of lines that were sent, without those of floods."""
    refused: int = 0
    """Number of those that were refused."""
    postings: int = 0
    """Number of postings of observations that came of the others."""
    flooded: int = 0
    """Number of bytes of the floods."""
    growth: int = 0
    """Memory that the floods cost the site, bytes."""


def instrument_tables(ports: dict[str, int]) -> str:
    """Return tables [[instrument]] of all grammars that connect to ports."""
    out = []
    for word, port in ports.items():
        keys = {"name": word, "network": "yard", "source": f"tcp://127.0.0.1:{port}"}
        keys |= {"grammar": word, "silent_after": "1 d", **LINES[word][1]}
        out += ["[[instrument]]", *(f"{k} = {_toml(v)}" for k, v in keys.items())]
    return "\n".join([*out, ""])


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{k}" = {_toml(v)}' for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def spoiled_lines(word: str, number: int, rng: random.Random) -> Iterator[bytes]:
    """Yield lines of a grammar with their ends: whole, damaged, or of another world."""
    made = 0
    while made < number:
        for text in LINES[word][0](rng.randrange(800)):
            if rng.random() < WHOLE_SHARE:
                line = text.encode()
            elif rng.random() < 0.05:
                line = rng.choice((*HOSTILE, rng.randbytes(rng.randrange(300))))
            else:
                line = damaged(rng, text)
            yield line + rng.choice((b"\n", b"\r\n", b"\r"))
            made += 1


def expected(data: bytes) -> tuple[int, int]:
    """Return how many lines bytes have that are read, and how many that are too long."""
    lines = [x for x in re.split(rb"[\r\n]", data) if x.strip(b" \t\0")]
    long = sum(len(x) > MAX_LINE_BYTES for x in lines)
    return len(lines) - long, long


@contextmanager
def fed_site(folder: Path) -> Iterator[tuple[SiteProcess, dict[str, Feeder]]]:
    """Give a served site with an instrument of each grammar, and what feeds them."""
    feeders = {word: Feeder() for word in LINES}
    more = instrument_tables({word: f.port for word, f in feeders.items()})
    site = SiteProcess(yard_site(folder, epochs="1 d", more=more))
    try:
        site.start()
        yield site, feeders
    finally:
        site.end()
        for feeder in feeders.values():
            feeder.close()


def fuzz_lines(folder: Path, *, lines: int, flood: int, seed: int) -> Fuzzed:
    """Send lines and floods to a served site, and check that it stays up and tells what it refuses.

    Args:
        folder: folder of the site, which is made there.
        lines: number of lines to each instrument.
        flood: number of bytes of each flood to each instrument.
        seed: of all of it.
    """
    out = Fuzzed()
    with fed_site(folder) as (site, feeders):

        def health() -> dict[str, dict[str, Any]]:
            found = httpx2.get(f"{site.url}api/v1/instruments", timeout=HANGS)
            assert found.status_code == 200
            return {h["name"]: h for h in found.json()}

        def feed(parts: dict[str, bytes]) -> None:
            threads = [
                threading.Thread(target=feeders[w].send, args=(p, random.Random(f"{seed} {w}")))
                for w, p in parts.items()
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()

        sent = {
            word: b"".join(spoiled_lines(word, lines, random.Random(f"{seed} {word}")))
            for word in feeders
        }
        feed(sent)
        counts = {word: expected(data) for word, data in sent.items()}
        until(lambda: all(h["lines"] >= counts[n][0] for n, h in health().items()), HANGS)
        for name, found in health().items():
            read, long = counts[name]
            assert found["lines"] == read, name
            assert long < found["refused"] <= read + long, name
            assert found["postings"] > 0, name
            assert any(e["count"] == "refused" for e in found["events"]), name
            _assert_no_fault(found)
            out.lines += read + long
            out.refused += found["refused"]
            out.postings += found["postings"]
        assert site.process is not None
        before = resident_bytes(site.process.pid)
        rng = random.Random(seed)
        endless, short = (
            b"7" * flood,
            b"".join(rng.randbytes(7).hex().encode() + b"\n" for _ in range(flood // 15)),
        )
        for data in (endless, b"\n" + short):
            feed(dict.fromkeys(feeders, data))
            out.flooded += len(feeders) * len(data)
        want = {n: counts[n][0] + flood // 15 for n in feeders}
        until(lambda: all(h["lines"] >= want[n] for n, h in health().items()), HANGS)
        out.growth = resident_bytes(site.process.pid) - before
        assert out.growth < MAX_GROWTH
        for name, found in health().items():
            assert found["lines"] == want[name] and found["connections"] == 1, name
            _assert_no_fault(found)
        # After all of it a whole line is an observation again.
        postings = {n: h["postings"] for n, h in health().items()}
        whole = {w: "\n".join([*LINES[w][0](900), *LINES[w][0](901), ""]).encode() for w in feeders}
        feed(whole)
        until(lambda: all(h["postings"] > postings[n] for n, h in health().items()), HANGS)
        assert httpx2.get(f"{site.url}api/v1/health", timeout=HANGS).json()["ok"]
        assert "Traceback" not in site.log.read_text()
    return out


def _assert_no_fault(found: dict[str, Any]) -> None:
    said = [found["problem"], *(e["what"] for e in found["events"])]
    assert not [s for s in said if "fault of the program" in s], said
