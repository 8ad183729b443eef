"""Command ``simulate-instrument``: simulated total stations on TCP ports, with faults to switch on.

Standard input takes faults while it runs, one a line. The command ends after ``--sets`` sets, on
SIGTERM, and on Ctrl-C with exit code 130.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from ..errors import InputError, Problem, counted, system_reason
from ..files import note_written, refuse_replacing
from ..instruments.instrument_settings import duration
from ..instruments.message_rules import iso
from ..instruments.simulated_faults import FAULTS, parse_fault
from ..instruments.simulated_sites import SITES, SimulatedSite, instrument_table, write_site
from ..instruments.simulated_total_station import (
    GSI_SIZES,
    SimulatedObject,
    SimulatedTotalStation,
    TotalStationServer,
)
from .input import add_reading, read_input
from .messages import EXIT_FINE, EXIT_INTERRUPTED, print_problems

POLL_S = 0.2
FIRST_PORT = 4001
"""Default port of the first instrument."""


def add_simulate_instrument(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = (
        "Simulate total stations that measure sets in two faces of all targets, and send them as\n"
        "GSI online to everybody who connects to their TCP ports. Their clocks start with the\n"
        "first connection. Points of the network have their true places."
    )
    usual = "\n".join(
        f"  {word} {' '.join(f'{n}=…' for n in (*kind.needed, *kind.usual))}\n    {kind.what}"
        for word, kind in FAULTS.items()
    )
    parser.epilog = (
        "faults (--fault, or a line of standard input, with ts2 before it for one instrument):\n"
        f"{usual}\n  at=TIME (2h, 10min) begins it so long after the start; without it, at once"
    )
    parser.add_argument("project", metavar="PROJECT", nargs="?", help="points: file or folder")
    parser.add_argument("--demo", choices=SITES, help="instead of PROJECT: a built-in site")
    parser.add_argument(
        "--station",
        action="append",
        default=[],
        metavar="POINT",
        help="point of an instrument of PROJECT; may be repeated",
    )
    parser.add_argument(
        "--targets", metavar="A,B", help="targets in the order of a set; default: all other points"
    )
    parser.add_argument(
        "--port",
        type=int,
        default=FIRST_PORT,
        metavar="PORT",
        help=f"TCP port of the first instrument, others have the next ones ({FIRST_PORT}); 0: free",
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at (127.0.0.1)")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="simulated seconds in each second (1)"
    )
    parser.add_argument(
        "--interval", type=_duration, default=600.0, metavar="TIME", help="from set to set (10 min)"
    )
    sight = parser.add_argument("--sight-time", type=_duration, default=8.0, metavar="TIME")
    sight.help = "from sight to sight (8 s)"
    parser.add_argument("--sets", type=int, metavar="N", help="end after so many sets")
    parser.add_argument("--seed", type=int, default=0, help="seed of noise and damage (0)")
    parser.add_argument("--gsi", type=int, choices=GSI_SIZES, default=16, help="format (16)")
    parser.add_argument(
        "--fault", action="append", default=[], metavar="FAULT", help="a fault, see below"
    )
    parser.add_argument(
        "--write", metavar="FOLDER", help="write project.toml and site.toml for `serve`"
    )
    parser.add_argument(
        "--truth", metavar="FILE", help="write the true places at each set as JSON lines"
    )
    add_reading(parser)
    parser.set_defaults(run=_simulate)


def _duration(text: str) -> float:
    try:
        return duration(float(text) if text.replace(".", "", 1).isdigit() else text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _simulate(options: argparse.Namespace) -> int:
    site = _site(options)
    if not options.speed > 0:
        raise InputError(Problem(f"must be a number > 0, not {options.speed:g}", "--speed"))
    of = SimulatedObject(site.network)
    stations = site.total_stations(
        of,
        seed=options.seed,
        begin=float(round(time.time())),
        interval=options.interval,
        sight_time=options.sight_time,
        gsi_size=options.gsi,
    )
    for text in options.fault:
        _switch_on(stations, text)
    stopped: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    try:
        with ExitStack() as stack:
            servers = [
                stack.enter_context(
                    s.serve(
                        options.port and options.port + i,
                        host=options.host,
                        speed=options.speed,
                        sets=options.sets,
                    )
                )
                for i, s in enumerate(stations)
            ]
            _print_begin(options, site, stations, servers)
            truth = None if options.truth is None else stack.enter_context(_opened(options.truth))
            return _attend(stations, servers, stopped, truth)
    finally:
        signal.signal(signal.SIGTERM, before)


def _opened(name: str) -> IO[str]:
    """Return the file of true places."""
    path = Path(name)
    refuse_replacing([path])
    try:
        stream = path.open("w", encoding="utf-8")
    except OSError as error:
        raise InputError(Problem(system_reason(error), name)) from None
    note_written([path])
    return stream


def _site(options: argparse.Namespace) -> SimulatedSite:
    """Return the site of the options."""
    if (options.project is None) == (options.demo is None):
        raise InputError(f"give PROJECT or --demo; valid: {', '.join(SITES)}")
    if options.demo is not None:
        if options.station or options.targets:
            raise InputError("--station and --targets are for PROJECT: a demo has its own")
        return SITES[options.demo]()
    network = read_input(options).network
    if not options.station:
        raise InputError(Problem("name a point for each instrument", "--station"))
    chosen = [n.strip() for n in options.targets.split(",")] if options.targets else None
    sights = {s: tuple(n for n in (chosen or network.points) if n != s) for s in options.station}
    movable = tuple(n for n, p in network.points.items() if not all(p.fixed))
    return SimulatedSite(network, sights, movable)


def _print_begin(
    options: argparse.Namespace,
    site: SimulatedSite,
    stations: Sequence[SimulatedTotalStation],
    servers: Sequence[TotalStationServer],
) -> None:
    """Print where the instruments are, and how a site maps them."""
    if options.write is not None:
        ports = [s.port for s in servers]
        for path in write_site(Path(options.write), site, stations, ports, speed=options.speed):
            print(f"written: {path}")
    for s, server in zip(stations, servers, strict=True):
        print(
            f"{s.name} on {s.station}: tcp://{options.host}:{server.port}, "
            f"{counted(len(s.targets), 'target')}"
        )
        if options.write is None:
            network = site.network.name
            print(instrument_table(s, port=server.port, network=network, speed=options.speed))
    sys.stdout.flush()


def _attend(
    stations: Sequence[SimulatedTotalStation],
    servers: Sequence[TotalStationServer],
    stopped: list[int],
    truth: IO[str] | None,
) -> int:
    """Take faults and print the sets until the end."""
    told = [0] * len(stations)
    listening = True
    try:
        ended = False
        while not stopped and not ended:
            ended = all(s.finished.is_set() for s in servers)
            if listening:
                listening = _take_faults(stations)
            else:
                time.sleep(POLL_S)
            for i, (s, server) in enumerate(zip(stations, servers, strict=True)):
                begun = int((s.now - s.begin) // s.interval) + 1 if server.sent else 0
                while told[i] < min(begun, server.sets or begun):
                    _tell_set(s, told[i], truth)
                    told[i] += 1
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    time.sleep(POLL_S)  # clients read what was sent last
    return EXIT_FINE


def _tell_set(s: SimulatedTotalStation, number: int, truth: IO[str] | None) -> None:
    """Print that a set begins, and write the true places."""
    at = s.begin + number * s.interval
    print(f"{iso(at)} {s.name} set {number + 1}", flush=True)
    if truth is not None:
        places = {n: [round(float(v), 6) for v in xyz] for n, xyz in s.of.truth(at).items()}
        print(
            json.dumps({"time": at, "instrument": s.name, "points": places}), file=truth, flush=True
        )


def _take_faults(stations: Sequence[SimulatedTotalStation]) -> bool:
    """Take the faults of standard input; return whether more may come."""
    if _in_background():
        time.sleep(POLL_S)
        return True
    try:
        ready, _, _ = select.select([sys.stdin], [], [], POLL_S)
    except (OSError, ValueError):  # no input that can be waited for
        return False
    if not ready:
        return True
    line = sys.stdin.readline()
    if not line:
        return False
    if line.strip():
        try:
            _switch_on(stations, line)
        except InputError as error:
            print_problems(error.problems)
    return True


def _in_background() -> bool:
    """Return whether standard input is a terminal that stops who reads it in the background."""
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp()
    except (OSError, ValueError):  # no terminal
        return False


def _switch_on(stations: Sequence[SimulatedTotalStation], text: str) -> None:
    """Switch a fault on; the first word may name an instrument."""
    first, _, rest = text.strip().partition(" ")
    named = [s for s in stations if s.name == first]
    word, fields = parse_fault(rest if named else text)
    for s in named or stations:
        if named or not (word in FAULTS and FAULTS[word].moves) or s is stations[0]:
            s.switch_on(word, **fields)
