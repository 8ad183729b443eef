"""Simulated sites: a dam and a tunnel, with points, pillars and targets, and their files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..frames import LocalFrame
from ..io.file_transaction import write_files
from ..io.project_writer import network_files
from ..network.network import Network
from .simulated_total_station import SimulatedObject, SimulatedTotalStation


@dataclass(frozen=True)
class SimulatedSite:
    """A network of points without observations, and what its instruments see."""

    network: Network
    """Points with their true places; reference points are held."""
    sights: Mapping[str, tuple[str, ...]]
    """Targets by station, in the order of a set."""
    objects: tuple[str, ...]
    """Points that may move."""

    def total_stations(self, of: SimulatedObject, **options: object) -> list[SimulatedTotalStation]:
        """Return an instrument on each station, ts1 and so on."""
        return [
            SimulatedTotalStation(of, station, targets, name=f"ts{i}", **options)  # type: ignore[arg-type]
            for i, (station, targets) in enumerate(self.sights.items(), 1)
        ]


def dam() -> SimulatedSite:
    """Return a dam of 12 points, seen from three pillars, with four reference points on rock.

    The crest is an arc of 160 m radius, with points 24 m apart; every second point is 18 m below
    it. Pillars stand 120 m to 150 m downstream; they are free, and the reference points held.
    """
    network = _network("dam")
    objects = []
    for i in range(12):
        angle = math.radians(8.6 * (i - 5.5))
        name, z = f"D{i + 1}", 520.0 - 18.0 * (i % 2)
        network.add_point(name, (160.0 * math.sin(angle), 160.0 * math.cos(angle), z))
        objects.append(name)
    pillars = {"P1": (-95.0, -15.0, 486.0), "P2": (2.0, -40.0, 481.5), "P3": (101.0, -8.0, 489.2)}
    rock = {
        "R1": (-190.0, 95.0, 531.0),
        "R2": (-165.0, -90.0, 497.0),
        "R3": (178.0, -84.0, 501.0),
        "R4": (195.0, 102.0, 528.5),
    }
    _add(network, pillars, "")
    _add(network, rock, "xyz")
    sights = {p: (*rock, *(q for q in pillars if q != p), *objects) for p in pillars}
    return SimulatedSite(network, sights, tuple(objects))


def tunnel() -> SimulatedSite:
    """Return 40 m of a tunnel: four profiles of five points, a total station on a bracket.

    Four reference points are behind it, and one at the face; the station is free.
    """
    network = _network("tunnel")
    objects = []
    for section in range(4):
        for i, angle in enumerate((-10.0, 35.0, 90.0, 145.0, 190.0), 1):
            a, name = math.radians(angle), f"T{section + 1}.{i}"
            x, z = 5.2 * math.cos(a), 101.5 + 4.8 * math.sin(a)
            network.add_point(name, (x, 25.0 + 10.0 * section, z))
            objects.append(name)
    _add(network, {"S1": (4.1, 8.0, 102.3)}, "")
    behind = {
        "R1": (-4.6, -42.0, 101.0),
        "R2": (4.7, -38.5, 103.4),
        "R3": (-4.4, -25.0, 104.0),
        "R4": (0.4, -31.0, 106.1),
    }
    _add(network, behind, "xyz")
    return SimulatedSite(network, {"S1": (*behind, *objects)}, tuple(objects))


SITES = {"dam": dam, "tunnel": tunnel}
"""Sites of ``--demo``."""


def _network(name: str) -> Network:
    network = Network(name, frame=LocalFrame(), datum="given")
    network.set_refraction(value=0.13 - 1.0, fixed=True)  # κ = k − 1: curvature and refraction
    return network


def _add(network: Network, points: Mapping[str, tuple[float, float, float]], fixed: str) -> None:
    for name, xyz in points.items():
        network.add_point(name, xyz, fixed=fixed)


def instrument_table(
    of: SimulatedTotalStation, *, port: int, network: str, speed: float, host: str = "127.0.0.1"
) -> str:
    """Return the table [[instrument]] that maps a simulated total station to a network."""
    a = of.accuracies
    targets = ", ".join(f'"{t}"' for t in of.targets)
    # At speed, its clock does not agree with the receipt of its lines.
    clock = "instrument" if speed == 1.0 else "stated"
    played = "" if speed == 1.0 else '# [[network]] has clock = "readings", as its time is played\n'
    return f"""[[instrument]]
name = "{of.name}"
network = "{network}"
source = "tcp://{host}:{port}"
grammar = "gsi-online"
station = "{of.station}"
targets = [{targets}]
keep_lines = "{of.name}.lines"
{played}clock = "{clock}"
[instrument.accuracies]
sigma_direction_mgon = {a.sigma_direction_mgon}
sigma_zenith_mgon = {a.sigma_zenith_mgon}
sigma_distance_mm = {a.sigma_distance_mm}
ppm = {a.ppm}
centring_mm = {a.centring_mm}
"""


def write_site(
    folder: Path,
    site: SimulatedSite,
    stations: Sequence[SimulatedTotalStation],
    ports: Sequence[int],
    *,
    speed: float,
) -> list[Path]:
    """Write project and site file of a simulated site; return their paths.

    The site has epochs of an hour and an alarm for displacements of its objects, false once in ten
    months.

    Raises:
        InputError: a file cannot be written.
    """
    name = site.network.name
    files = dict(network_files(site.network))
    objects = ", ".join(f'"{n}"' for n in site.objects)
    tables = "\n".join(
        instrument_table(s, port=p, network=name, speed=speed)
        for s, p in zip(stations, ports, strict=True)
    )
    alarm = f"""[[alarm]]
name = "objects"
network = "{name}"
test = "displacement"
points = [{objects}]
false_alarms_per_month = 0.1

"""
    played = "" if speed == 1.0 else 'clock = "readings"\n'
    files["site.toml"] = f"""[site]
name = "{name}"
database = "site.sqlite"

[[network]]
name = "{name}"
project = "project.toml"
epochs = "1 h"
{played}objects = [{objects}]

{alarm if objects else ""}{tables}"""
    folder.mkdir(parents=True, exist_ok=True)
    write_files(folder, files)
    return [folder / f for f in files]
