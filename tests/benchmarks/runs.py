"""A study of the industry block, computed in several ways: how long, and is it the same table?

``python -m tests.benchmarks.runs WAY REPETITIONS FILE`` is one of them.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj import adjust
from factorgraph_adj.blas_threads import VARIABLES
from factorgraph_adj.experiment.runs import Experiment, run
from tests.support.places import ROOT

WAYS = {"1 process": 1, "2 processes": 2, "Dask, 2 workers": 0}
"""Processes of each way; none: a local cluster."""
REPETITIONS = 2_000
SEED = 1981


@dataclass(frozen=True)
class Ran:
    """What one way took, and what it gave."""

    seconds: float
    """From before processes or cluster begin."""
    digest: str
    """SHA-256 of the table."""
    rows: int
    failed: int
    summary: str


def industry(seed: int) -> dict[str, float]:
    """Adjust the whole block of table 2, case a, and compare all points with the truth."""
    made = simulate_industry_block(seed)
    solution = adjust(made.network)
    errors = np.array([solution.point(p) - made.truth.points[p] for p in made.truth.points])
    rms = np.sqrt(np.mean(errors**2, axis=0))
    figures = dict(zip(("rms X", "rms Y", "rms Z"), rms.tolist(), strict=True))
    return figures | {"sigma0": solution.sigma0, "iterations": solution.iterations}


def measure(way: str, repetitions: int, file: str) -> Ran:
    """Run the study, or what is left of it."""
    began = time.perf_counter()
    experiment = Experiment("industry block", industry, seed=SEED)
    with ExitStack() as stack:
        client = None
        if not WAYS[way]:
            from distributed import Client, LocalCluster

            made = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0")
            client = stack.enter_context(Client(stack.enter_context(made)))
        processes = WAYS[way] or 1
        results = run(experiment, repetitions, out=file, processes=processes, client=client)
        seconds = time.perf_counter() - began
    digest = hashlib.sha256(results.table().encode()).hexdigest()
    failed = len(results.failed)
    return Ran(seconds, digest, len(results.rows), failed, str(results.summary()))


def benchmark(cores: set[int], repetitions: int = REPETITIONS) -> None:
    """Print how long each way took, and whether all tables are the same."""
    digests = set()
    print(f"  {'':28}{'s':>8}{'ms/rep.':>9}{'faster':>8}{'failed':>8}  table", flush=True)
    first = None
    with TemporaryDirectory() as folder:
        for number, way in enumerate(WAYS):
            ran = _finish(cores, way, repetitions, Path(folder) / str(number))
            first = first or ran
            digests.add(ran.digest)
            _show(way, ran, repetitions, first.seconds / ran.seconds)
        for number, way in enumerate(WAYS):
            file = Path(folder) / f"{number} killed"
            kept = _kill_half_way(cores, way, repetitions, file)
            ran = _finish(cores, way, repetitions, file)
            digests.add(ran.digest)
            _show(f"{way}, {kept} kept", ran, repetitions - kept, None)
    print(f"  {'one and the same table' if len(digests) == 1 else 'TABLES DIFFER'}")
    if first:
        print("\n".join(f"  {line}" for line in first.summary.splitlines()))


def _show(name: str, ran: Ran, repetitions: int, faster: float | None) -> None:
    text = "" if faster is None else f"{faster:.2f}"
    print(
        f"  {name:28}{ran.seconds:8.1f}{1e3 * ran.seconds / max(repetitions, 1):9.1f}{text:>8}"
        f"{ran.failed:8d}  {ran.digest[:16]}",
        flush=True,
    )


def _start(cores: set[int], way: str, repetitions: int, file: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.benchmarks.runs", way, str(repetitions), str(file)]
    return subprocess.Popen(
        command,
        cwd=ROOT,
        env=os.environ | dict.fromkeys(VARIABLES, "1"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )


def _finish(cores: set[int], way: str, repetitions: int, file: Path) -> Ran:
    process = _start(cores, way, repetitions, file)
    out, errors = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{way} failed:\n{errors}")
    return Ran(**json.loads(out.splitlines()[-1]))


def _kill_half_way(cores: set[int], way: str, repetitions: int, file: Path) -> int:
    """Kill a run when half of its repetitions are in the file; return how many are."""
    process = _start(cores, way, repetitions, file)
    while process.poll() is None and _lines(file) - 1 < repetitions // 2:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return _lines(file) - 1


def _lines(file: Path) -> int:
    return file.read_bytes().count(b"\n") if file.exists() else 0


if __name__ == "__main__":
    print(json.dumps(asdict(measure(sys.argv[1], int(sys.argv[2]), sys.argv[3]))))
