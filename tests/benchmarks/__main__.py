"""Run benchmarks: ``python -m tests.benchmarks [NAME …] [--cores N] [--rounds N] [--largest N]``.

Some names take arguments, which follow them: ``python -m tests.benchmarks thousand 300 1000 soak``.

roma      Roma against pycolmap (extra ``bench``), alternating, and our memory; with an argument
          ORDER [PHOTOS]: photo by photo in an incremental adjustment, against a warm adjust with
          reliability. ORDER is ``file``, the seed of a random order, or ``all``: all 90 561 rays
          are there, and photos are taken out and come back
ladybug   Ladybug 49 of Bundle Adjustment in the Large against pycolmap
both      a simulated block of 200 photos and 200 000 image points against pycolmap
growth    simulated aerial blocks of 10 000 to 1 000 000 image points with 70/40 and 80/60 per cent
          overlap, and the exponents with which time and memory grow
grids     simulated terrestrial networks of 100 to 10 000 points, and their exponents
tied      2 000 photos that 300 total stations tie together, against independent solutions of
          sparse normal equations (three minutes)
soak      20 000 arrivals and removals, nonsense among them, on an incremental adjustment; any
          other number: python -m tests.support.soak EVENTS
thousand  [PHOTOS [RAYS]]: photos and single observations that arrive in an aerial block of 1 000
          photos with 1 000 rays each; aims: 3 GB, 5 s for a photo, 0.3 s for an observation
hour      [SECONDS [cpu] [gross] [keep=N] [rays=N]]: the stream of a survey vehicle for an hour, a
          photo with 500 rays every second; whether the incremental adjustment keeps up (an hour or
          longer). With cpu in CPU seconds, with gross 0.5 per cent of the rays are grossly wrong,
          with keep the last N photos are kept
vehicle_day is a command of its own, python -m tests.benchmarks.vehicle_day: a day of that vehicle,
          86 400 photos with few rays, of which the last ones are kept (an hour)
retirement is a command of its own, python -m tests.benchmarks.retirement: that vehicle with few
          rays, its last photos kept, against the batch adjustment of everything
runs      2 000 repetitions of the industry block in 1 and 2 processes and on a local Dask cluster
          (extra ``cluster``), then killed half-way and resumed (half an hour)
proposals 1 000 candidates for the industry block, against planning anew with each of them
equality  every test network arriving one by one in four orders, with removals, against the batch
orders    5 000 random small networks, each in several orders and groupings, and with gross errors:
          errors, differences in what is in, differences in σ (hours; ``orders 100`` takes minutes)
verdicts  test values, T², redundancy numbers and innovations of arriving observations against
          `predict` on the batch: at moments of 200 random networks (``verdicts 50``: of 50), and of
          every test network
arrivals  is a command of its own, python -m tests.benchmarks.arrivals: CPU time of an arrival in
          each engine, in an earlier version, and in GTSAM alone
components is a command of its own, python -m tests.benchmarks.components: factors of simulated
          blocks against their truth and their law (about 15 minutes)
beginning is a command of its own, python -m tests.benchmarks.beginning: incremental adjustments
          that begin with networks of which much is not determined, against their determined part
starts    is a command of its own, python -m tests.benchmarks.starts: poor starts against scipy's
          trf and GTSAM's Levenberg-Marquardt
studies   is a command of its own, python -m tests.benchmarks.studies: cases of tests that tests
          leave out (hours)
coverage  is a command of its own, python -m tests.benchmarks.coverage: which lines of functions the
          short tests run, in the package and in each module
precision_maps is a command of its own, python -m tests.benchmarks.precision_maps: precision maps
          against 1 000 repeated adjustments, and their time for a million points
reading   is a command of its own, python -m tests.benchmarks.reading: large files of each format
record    fixed works beside a fixed work of numpy and pycolmap; a row for each is appended to
          tests/benchmarks/record.csv. It runs only where it is named.

Quality: reliability of every observation (with e1, e2, e12) and the covariance of every point;
for pycolmap the covariances of points, poses and cameras.

Every run is a process of its own on the same cores, without variables that set numbers of threads,
as a user starts it. Ceres gets a thread for each core; our computations give BLAS one themselves.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from factorgraph_adj.blas_threads import VARIABLES
from tests.support.places import ROOT

from . import record as records
from . import runs as study
from .blocks import OVERLAPS
from .growth import GRIDS, GROWTH, exponent
from .worker import LADYBUG, ROMA, Measured

BOTH = 200_000
"""Image points of the simulated block that pycolmap is given too."""
TIED = (2_000, 300)
"""Photos and total stations of the tied block."""
EVENTS = 20_000
TAKE_ARGUMENTS = ("roma", "thousand", "hour", "orders", "verdicts")
"""Benchmarks whose names may be followed by arguments."""
LONGEST = 1800
"""Seconds after which a run is given up."""
AT_ONCE = 25
"""Random networks of one process."""
LONGEST_EQUALITY = 3 * 3600
"""The same for one network arriving in one order: Roma arrives for more than an hour."""


def without_variables() -> dict[str, str]:
    """Return the environment without numbers of threads, as a user has it."""
    return {name: value for name, value in os.environ.items() if name not in VARIABLES}


def run(cores: set[int], job: str, *arguments: int | str) -> Measured | None:
    """Run a job on ``cores``; none if it failed or took too long, which is printed."""
    found = launch(cores, "worker", job, *map(str, arguments))
    return None if found is None else Measured(**found)


def launch(
    cores: set[int], module: str, *arguments: str, longest: int = LONGEST
) -> dict[str, Any] | None:
    """Return what a module of this package prints at its end, run on ``cores``."""
    command = [sys.executable, "-m", f"tests.benchmarks.{module}", *arguments]
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=without_variables(),
            capture_output=True,
            text=True,
            timeout=longest,
            check=False,
            preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )
    except subprocess.TimeoutExpired:
        print(f"  {' '.join(arguments)}: given up after {longest} s")
        return None
    if done.returncode:
        print(f"  {' '.join(arguments)} failed:\n{done.stderr}")
        return None
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def against_colmap(
    cores: set[int], rounds: int, job: str, *, data: Path | None = None, size: int = 0
) -> None:
    """Alternate between us and pycolmap; print every run, medians and ratio."""
    if data is not None and not data.exists():
        print(f"  skipped: {data} is not there (set FACTORGRAPH_ADJ_DATA)")
        return
    jobs = [job]
    if find_spec("pycolmap") is None:
        print("  pycolmap is not installed (extra bench): our figures only")
    else:
        jobs.append(f"{job}-colmap")
    taken: dict[str, list[Measured]] = {j: [] for j in jobs}
    for _ in range(rounds):
        for j in jobs:
            if (measured := run(cores, j, size)) is not None:
                taken[j].append(measured)
    print(
        f"  {'':16}{'CPU s':>8}{'quality':>9}{'together':>10}{'s':>8}{'quality':>9}{'iter.':>7}"
        f"{'√vᵀPv':>11}  medians; all CPU s; why it ended"
    )
    for j, runs in taken.items():
        if runs:
            figures = ("cpu", "quality_cpu", "together", "seconds", "quality")
            cpu, quality_cpu, together, seconds, quality = (_median(runs, f) for f in figures)
            every = " ".join(f"{m.cpu:.2f}" for m in runs)
            print(
                f"  {j:16}{cpu:8.3f}{quality_cpu:9.3f}{together:10.3f}{seconds:8.3f}{quality:9.3f}"
                f"{runs[0].iterations:7d}{runs[0].vtpv ** 0.5:11.4f}  {every}; {runs[0].how}"
            )
    if taken[job]:
        print(f"  peak memory of our process: {max(m.megabytes for m in taken[job]):.0f} MB")
    if all(taken.values()) and len(taken) == 2:
        rows = {
            "CPU time of the adjustment": "cpu",
            "CPU time of quality": "quality_cpu",
            "CPU time of both together": "together",
            "time of the adjustment on the clock": "seconds",
        }
        for name, figure in rows.items():
            a, b = (_median(runs, figure) for runs in taken.values())
            print(f"  ours / pycolmap, {name}: {a / b:.2f}")


def _median(runs: Sequence[Measured], what: str) -> float:
    return statistics.median(getattr(m, what) for m in runs)


def table(cores: set[int], job: str, sizes: Sequence[int], what: str) -> None:
    """Print one line for each size, and the exponents of growth."""
    print(
        f"  {what:>12}{'scalar obs.':>13}{'unknowns':>10}{'made s':>9}{'iter.':>7}{'s/iter.':>9}"
        f"{'total s':>9}{'CPU s':>9}{'MB':>7}{'σ̂0':>8}{'quality s':>11}{'CPU s':>9}"
        f"{'MB':>7}{'Σr − r':>10}"
    )
    measured: dict[int, Measured] = {}
    for size in sizes:
        m = run(cores, job, size)
        if m is not None:
            measured[size] = m
            print(
                f"  {size:12d}{m.observations:13d}{m.unknowns:10d}{m.prepared:9.2f}"
                f"{m.iterations:7d}{m.seconds / m.iterations:9.3f}{m.seconds:9.2f}"
                f"{m.cpu:9.2f}{m.megabytes:7.0f}{m.sigma0:8.4f}{m.quality:11.2f}"
                f"{m.quality_cpu:9.2f}{m.quality_megabytes:7.0f}{m.sum_r:10.1e}",
                flush=True,
            )
    if len(measured) >= 2:
        rows: dict[str, Callable[[Measured], float]] = {
            "CPU s/iteration": lambda m: m.cpu / m.iterations,
            "CPU s of quality": lambda m: m.quality_cpu,
            "MB beyond the idle process": lambda m: m.quality_megabytes - m.idle,
        }
        found = (
            f"{name} {exponent(list(measured), [figure(m) for m in measured.values()]):.2f}"
            for name, figure in rows.items()
        )
        print(f"  exponents of growth with {what}: {', '.join(found)}")


def growth(cores: set[int], largest: int) -> None:
    """Print a table for each overlap."""
    for overlap in OVERLAPS:
        print(f"  overlap {overlap}")
        table(cores, f"aerial {overlap}", [n for n in GROWTH if n <= largest], "image points")


def tied(cores: set[int]) -> None:
    """Print what photos and total stations take, and how far they are from other solutions."""
    found = launch(cores, "tied", *map(str, TIED))
    if found is None:
        return
    m = Measured(**found["measured"])
    print(
        f"  {TIED[0]} photos, {TIED[1]} stations: {m.observations} scalar observations, "
        f"{m.unknowns} unknowns\n"
        f"  adjustment {m.seconds:.2f} s ({m.cpu:.2f} s CPU), {m.iterations} iterations, {m.how}\n"
        f"  quality {m.quality:.2f} s ({m.quality_cpu:.2f} s CPU); "
        f"{m.megabytes:.0f} MB, {m.quality_megabytes:.0f} MB with it; "
        f"Σr − r {m.sum_r:.1e}\n"
        f"  {found['fronts']} fronts, the largest of {found['largest_front']} nodes of "
        f"{found['width']} columns\n"
        f"  independent solutions: covariances differ by {found['covariances']:.1e} of their σσ, "
        f"redundancy numbers by {found['redundancy_numbers']:.1e}"
    )


def equality(cores: set[int]) -> None:
    """Print one line for each network in each order: largest differences from the batch."""
    from .equality import Equality, networks  # needs pytest and all the test networks

    print(
        f"  {'':40}{'order':>6}{'moments':>8}"
        f"{'x/σ':>9}{'σ':>9}{'r':>9}{'settled':>10}{'σ':>9}{'r':>9}{'of 1':>8}"
        f"{'no batch':>9}{'wait':>5}{'s':>7}"
    )
    for name, orders in networks():
        for order in orders:
            arrives = "file" if order is None else str(order)
            found = launch(cores, "equality", name, arrives, longest=LONGEST_EQUALITY)
            if found is None:
                continue
            m = Equality(**found)
            cells = "".join(f"{x:9.0e}" for x in m.arriving)
            settled = f"{m.settled[0]:10.0e}" + "".join(f"{x:9.0e}" for x in m.settled[1:])
            print(
                f"  {name:40}{arrives:>6}{m.moments:8d}{cells}"
                f"{settled}{m.promise:8.2f}{m.without:9d}{m.waiting:5d}{m.seconds:7.1f}",
                flush=True,
            )


def chunks(
    cores: set[int], module: str, first: Sequence[str], networks: int
) -> Iterator[dict[str, Any]]:
    """Iterate over what a module prints for random networks, `AT_ONCE` on each core.

    Args:
        cores: each has a process of its own.
        module: takes the first seed and a number of networks.
        first: arguments before these.
        networks: number of all of them.
    """
    idle = list(cores)

    def one(seed: int) -> dict[str, Any] | None:
        core = idle.pop()
        try:
            n = min(AT_ONCE, networks - seed)
            return launch({core}, module, *first, str(seed), str(n))
        finally:
            idle.append(core)

    with ThreadPoolExecutor(len(cores)) as pool:
        yield from (f for f in pool.map(one, range(0, networks, AT_ONCE)) if f is not None)


def orders(cores: set[int], networks: int = 5_000) -> None:
    """Print whether the end depends on the order of arrivals; every finding on a line."""
    from .orders import Orders

    counts: Counter[str] = Counter()
    done = observations = inside = 0
    from_batch = between = seconds = 0.0
    for found in chunks(cores, "orders", (), networks):
        m = Orders(**found)
        counts += Counter(m.counts)
        done, observations, inside = (
            done + m.networks,
            observations + m.observations,
            inside + m.inside,
        )
        from_batch, between = max(from_batch, m.from_batch), max(between, m.between)
        seconds += m.seconds
        for line in m.findings:
            print(f"  {line}", flush=True)
    print(
        f"  {done} networks, {inside} of {observations} observations are in in the end, "
        f"{seconds:.0f} s\n"
        f"  {', '.join(f'{what}: {n}' for what, n in sorted(counts.items())) or 'no differences'}\n"
        f"  settled: largest difference from the batch {from_batch:.1e} σ, "
        f"between orders {between:.1e} σ"
    )


def verdicts(cores: set[int], networks: int = 200) -> None:
    """Print how far verdicts are from predictions of the batch adjustment."""
    from .equality import networks as test_networks
    from .verdicts import FIGURES, Verdicts

    print(f"  {'':40}{'moments':>8}" + "".join(f"{n:>11}" for n in FIGURES) + f"{'> 1e-3':>8}")

    def show(name: str, found: Sequence[dict[str, Any]]) -> None:
        every = [Verdicts(**f) for f in found]
        cells = "".join(f"{max(getattr(m, n) for m in every):11.1e}" for n in FIGURES)
        beyond = [line for m in every for line in (*m.errors, *m.beyond)]
        moments = sum(m.moments for m in every)
        print(f"  {name:40}{moments:8d}{cells}{len(beyond):8d}", flush=True)
        for line in beyond:
            print(f"    {line}")

    if found := list(chunks(cores, "verdicts", ("random",), networks)):
        show(f"{networks} random networks", found)
    for name, _ in test_networks():
        one = launch(cores, "verdicts", "network", name, "1", longest=LONGEST_EQUALITY)
        if one is not None:
            show(name, [one])


def soak(cores: set[int]) -> None:
    """Let observations come and go, see ``tests/support/soak.py``."""
    command = [sys.executable, "-m", "tests.support.soak", str(EVENTS)]
    subprocess.run(
        command,
        env=without_variables(),
        check=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )


def arriving(
    cores: set[int], module: str, arguments: Sequence[str], *, data: Path | None = None
) -> None:
    """Run a module of this package that prints while it runs."""
    if data is not None and not data.exists():
        print(f"  skipped: {data} is not there (set FACTORGRAPH_ADJ_DATA)")
        return
    command = [sys.executable, "-m", f"tests.benchmarks.{module}", *arguments]
    subprocess.run(
        command,
        cwd=ROOT,
        env=without_variables(),
        check=True,
        preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )


def proposals(cores: set[int], rounds: int) -> None:
    """Print how long it takes to look at candidates."""
    found = launch(cores, "proposals", str(rounds))
    if found is not None:
        together, anew = (statistics.median(found[k]) for k in ("round", "anew"))
        n = found["candidates"]
        print(
            f"{n} candidates: a round {together:.2f} s, anew {n * anew:.0f} s "
            f"({found['ratio']:.0f} times), lack differs by {found['difference']:.0e}; "
            f"{found['steps']} steps {found['whole']:.1f} s"
        )


def record(cores: set[int], rounds: int) -> None:
    """Measure the works of the record, and append a row for each to its table."""
    colmap = find_spec("pycolmap") is not None
    if not colmap:
        print("  pycolmap is not installed (extra bench): no ratio to it")
    print(
        f"  {'':14}{'iter.':>6}{'calls':>6}{'front':>7}{'fronts':>7}{'MB of partials':>15}"
        f"{'CPU s':>8}{'/ numpy':>9}{'/ pycolmap':>11}{'quality':>9}{'MB':>7}"
    )
    version, day = records.version(), date.today().isoformat()
    for work in records.WORKS.values():
        if work.missing:
            print(f"  {work.name:14} skipped: {work.data} is not there (set FACTORGRAPH_ADJ_DATA)")
            continue
        row = _measured(cores, rounds, work, version, day, colmap=colmap)
        if row is None:
            continue
        records.append([row])
        other = "–" if row.ratio_to_pycolmap is None else f"{row.ratio_to_pycolmap:.2f}"
        print(
            f"  {row.work:14}{row.iterations:6d}{row.calls:6d}{row.largest_front:7d}"
            f"{row.fronts:7d}{row.bytes_of_partials / 1e6:15.2f}{row.cpu_s:8.3f}"
            f"{row.ratio_to_numpy:9.3f}{other:>11}{row.quality_cpu_s:9.3f}{row.megabytes:7.0f}",
            flush=True,
        )


def _measured(
    cores: set[int], rounds: int, work: records.Work, version: str, day: str, *, colmap: bool
) -> records.Row | None:
    """Return the row of one work; none: one of its runs failed."""
    figures = launch(cores, "record", "figures", work.name)
    if figures is None:
        return None
    ours: list[Measured] = []
    theirs: list[Measured] = []
    yardstick: list[float] = []
    for _ in range(rounds):
        measured, fixed = run(cores, *work.job), launch(cores, "record", "numpy")
        if measured is None or fixed is None:
            return None
        ours.append(measured)
        yardstick.append(fixed["cpu"])
        if colmap and work.colmap is not None and (other := run(cores, work.colmap)) is not None:
            theirs.append(other)
    cpu = _median(ours, "cpu")
    return records.Row(
        version=version,
        date=day,
        work=work.name,
        **figures,
        cpu_s=cpu,
        ratio_to_numpy=cpu / statistics.median(yardstick),
        ratio_to_pycolmap=cpu / _median(theirs, "cpu") if theirs else None,
        quality_cpu_s=_median(ours, "quality_cpu"),
        megabytes=max(m.quality_megabytes for m in ours),
    )


def with_arguments(words: Sequence[str], known: Collection[str]) -> dict[str, list[str]]:
    """Return the arguments of each benchmark that is named.

    Args:
        words: names, each followed by its arguments.
        known: names of all benchmarks.
    """
    out: dict[str, list[str]] = defaultdict(list)
    taking: str | None = None
    for word in words:
        if taking is None or word in known:
            out[word] = []
            taking = word if word in TAKE_ARGUMENTS else None
        else:
            out[taking].append(word)
    return out


def main() -> None:
    """Run what the command line asks for."""
    benchmarks: dict[str, Callable[[set[int], int], None]] = {
        "roma": lambda cores, rounds: (
            arriving(cores, "roma", given["roma"], data=ROMA)
            if given["roma"]
            else against_colmap(cores, rounds, "roma", data=ROMA)
        ),
        "ladybug": lambda cores, rounds: against_colmap(cores, rounds, "ladybug", data=LADYBUG),
        "both": lambda cores, rounds: against_colmap(cores, rounds, "both", size=BOTH),
        "growth": lambda cores, _: growth(cores, options.largest),
        "grids": lambda cores, _: table(
            cores, "grid", [n for n in GRIDS if n <= options.largest], "points"
        ),
        "tied": lambda cores, _: tied(cores),
        "soak": lambda cores, _: soak(cores),
        "thousand": lambda cores, _: arriving(cores, "thousand", given["thousand"]),
        "hour": lambda cores, _: arriving(cores, "hour", given["hour"]),
        "runs": lambda cores, _: study.benchmark(cores),
        "proposals": proposals,
        "equality": lambda cores, _: equality(cores),
        "orders": lambda cores, _: orders(cores, *map(int, given["orders"])),
        "verdicts": lambda cores, _: verdicts(cores, *map(int, given["verdicts"])),
        "record": record,
    }
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(benchmarks))
    parser.add_argument("--cores", type=int, help="how many cores; all that are free by default")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each program")
    parser.add_argument(
        "--largest", type=int, default=max(GROWTH), help="largest size of growth and grids"
    )
    options = parser.parse_args()
    given = with_arguments(options.names, benchmarks)
    unknown = [n for n in given if n not in benchmarks]
    if unknown:
        parser.error(f"unknown benchmark {', '.join(unknown)}; known: {', '.join(benchmarks)}")
    available = sorted(os.sched_getaffinity(0))
    cores = set(available[: options.cores or len(available)])
    print(f"{len(cores)} of {os.cpu_count()} cores, {platform.machine()}, {_versions()}")
    for name in list(given) or [n for n in benchmarks if n != "record"]:
        print(f"\n{name}", flush=True)
        benchmarks[name](cores, options.rounds)


def _versions() -> str:
    listed = [f"Python {platform.python_version()}"]
    for package in ("gtsam", "numpy", "scipy", "pycolmap"):
        try:
            listed.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            listed.append(f"no {package}")
    return ", ".join(listed)


if __name__ == "__main__":
    main()
