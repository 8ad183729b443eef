"""Reader of jobs of SNAP, the adjustment program of Land Information New Zealand.

Format: LINZ, SNAP help (``src/help``) and the source of the program, github.com/linz/snap,
BSD-3-Clause.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Literal

from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import ControlPoint, CoordinateDifference
from ..format_reader import NetworkReader, Reader
from ..source import ROWS_SWITCHED_OFF, LeftOutReason, Problems
from ..text_files import file_beginning
from .snap_adjusted_stations import (
    HEIGHT,
    PLAN,
    AdjustedStation,
    colocate,
    located_stations,
    rejected_stations,
    settle,
)
from .snap_commands import ANTENNA, CENTROID_ERROR, OFFSET_ERROR
from .snap_data_commands import POINT_KINDS, VECTOR_KINDS
from .snap_job import ObservationStatement, SnapJob
from .snap_job_files import read_job
from .snap_observations import SnapObservations, refraction_radius
from .snap_readings import SnapReading, SnapSet
from .snap_recoding import Colocation, with_station

HELD_SIGMA_M = 1e-6
"""Standard deviation of plan or height of a station that is fixed in these alone, metres."""
REJECTED_STATIONS = LeftOutReason("observations of rejected stations", "the job rejects them")
UNLOCATED = LeftOutReason(
    "stations and their observations",
    "the observations do not locate them, and SNAP rejects them automatically",
)
UNOBSERVED = LeftOutReason("stations", "the job adjusts them, and no observation concerns them")
MISSING_STATIONS = LeftOutReason(
    "observations of stations without coordinates", "the job ignores missing stations"
)
PARTS_OF_AXES = {PLAN: "en", HEIGHT: "u"}


def read_snap(path: str | Path, *, deformation: Literal["refuse", "none"] = "refuse") -> Network:
    """Read a job of SNAP: the command file (``.snp``) with all files that it names.

    The network is geocentric, on the ellipsoid of the coordinate file.

    | type | observation |
    | --- | --- |
    | SD, DR | `SlopeDistance`; each group of DR has an unknown scale |
    | HD | `MeanHeightDistance` |
    | ED, MD | `EllipsoidDistance`: the arc on the ellipsoid, at the mean height of the geoid |
    | HA | `Direction`, a group is a set |
    | AZ | `GeodeticAzimuth` |
    | PB | `GeodeticAzimuth`, with the difference from the bearing of the projection at the
      approximate coordinates (it changes by 0.02″ for 1 m) |
    | ZD | `ZenithAngle` |
    | LV | `EllipsoidHeightDifference` between heights above the geoid |
    | LT, LN | `AstronomicLatitude`, `AstronomicLongitude`; those of SNAP are geodetic, and get the
      deflection |
    | OH, EH | `EllipsoidHeight`, above the geoid and the ellipsoid |
    | GB, GX | `GnssVector`, `GnssPosition`, of a group with a joint covariance |

    Coordinates may be latitude and longitude, X, Y, Z, or those of a projection of New Zealand
    (`factorgraph_adj.io.survey.snap_systems.SNAP_SYSTEMS`); heights are above the geoid or the
    ellipsoid, with geoid heights and deflections of the file. Without an option a height is above
    the ellipsoid, as in the program, unless the code has a vertical datum.

    Stations are free, fixed (in plan or height alone by positions with 1 µm) or floated (observed
    where they stand); those that the observations do not locate are left out by the rule of SNAP.
    Scale errors are distance meters, orientation errors that are calculated are `GyroAzimuth`
    constants E = −error, a coefficient of refraction k of Bomford is κ = 2k with one radius of the
    Earth, the mean of Euler's radii of the sights. A reference frame with known parameters is
    applied to its observations; one whose translation, scale or rotation is unknown is a frame of
    the network (`FrameCoordinate`, `FrameVector`), and so is the translation of a set of GX.

    Recoded stations are new ones at the place of the old, and with an uncertainty both are at one
    place by a `CoordinateDifference`.
    ``*``, ``reject`` and ``ignore`` leave observations out; ``data_check`` fixes all stations.
    Lengths are metres; angles degrees, minutes and seconds, packed or decimal degrees by the
    commands of the file, and their errors seconds or degrees.

    A data file in SINEX is a set of GX with the constraints of its solution. Stations and
    observations may be delimited text (``csv``) with a format definition (``.dtf``) beside them or
    beside the job: columns, options of the command, tables, defaults, errors of instruments.

    Readings of stations that move, by offsets in time or a grid of velocities (``deformation
    type=velocity``), are reduced to the coordinates at their dates, which they need.

    Not read, and refused by name: deformation models of LINZ, geoid grids, systematic errors,
    reference frames with unknown single components or rates.

    Args:
        path: the command file.
        deformation: what to do where a deformation model applies, by default that of NZGD2000:
            "refuse"; or "none": take observations as of the epoch of the coordinates, but for
            offsets of stations.

    Raises:
        InputError: every problem of the files, each with its line.
    """
    problems = Problems()
    job = read_job(Path(path), problems, deformed=deformation == "refuse")
    if deformation == "none":
        job.displacements.velocities = None
    _refuse_recoded_offsets(job)
    problems.raise_all()
    assert job.stations is not None  # its absence is a problem
    chosen = list(_chosen_sets(job))
    problems.raise_all()
    states = rejected_stations(job)
    taking = list(_taking_part(job, chosen, states))
    located = located_stations(r for s, kept in taking for r in (s.readings[i] for i in kept))
    together = job.recodings.colocations(set(located))
    colocate(together, states, located)
    settle(job, states, located)
    problems.raise_all()
    readings = [r for s, kept in taking for r in (s.readings[i] for i in kept)]
    radius = refraction_radius(readings, job.stations, job.parameters)
    frame = GeocentricFrame(job.stations.system.ellipsoid_name, radius=radius)
    free = job.mode == "free"
    system = job.stations.system
    crs = system.reference_system if system.form == "projection" else None
    network = Network(Path(path).stem, frame=frame, datum="free" if free else "given", crs=crs)
    observed = set(located)
    _add_stations(job, states, observed, network)
    maker = SnapObservations(network, job.stations, job.parameters, job.ratios)
    maker.use_datum = job.use_datum
    maker.displacements = job.displacements
    maker.take_frames(readings)
    for found, kept in taking:
        remaining = []
        for i in kept:
            codes = _codes(found.readings[i])
            lost = [c for c in codes if states[c].unlocated]
            if lost:
                found.source.leave_out(found.readings[i].line, UNLOCATED, lost[0])
            else:
                remaining.append(i)
        maker.add(found, remaining)
    _add_colocations(job, together, states, network)
    problems.finish(network)
    return network


def _refuse_recoded_offsets(job: SnapJob) -> None:
    """Refuse that a station with offsets is recoded: which of both codes has them is unknown."""
    for code in job.displacements.offsets:
        if code in job.recodings.by_code:
            job.source.wrong(0, f"station {code!r} has offsets and is recoded: give one of both")


def _add_colocations(
    job: SnapJob, found: list[Colocation], states: dict[str, AdjustedStation], network: Network
) -> None:
    """Add that stations are at the same place, where the one that is recoded is adjusted."""
    assert job.stations is not None
    for c in found:
        own, other = (job.stations.by_code[n] for n in (c.code, c.other))
        axes = {"xy": PLAN, "z": HEIGHT}
        kept = "".join(a for a, part in axes.items() if part in states[c.code].adjusted)
        if not kept or not {own.code, other.code} <= set(network.points):
            continue
        sigma = tuple({"x": c.errors[0], "y": c.errors[0], "z": c.errors[1]}[a] for a in kept)
        network.add(
            CoordinateDifference(
                other.code, own.code, (0.0,) * len(kept), axes=kept, horizon=True, sigma=sigma
            )
        )


def _codes(reading: SnapReading) -> list[str]:
    """Return the codes of a reading in capital letters."""
    return [c.upper() for c in (reading.station, reading.target) if c]


def _chosen_sets(job: SnapJob) -> Iterator[SnapSet]:
    """Yield the sets of all files with new codes, factors and rejections of the job."""
    stations = job.stations
    assert stations is not None
    for file in job.files:
        for found in file.sets:
            readings = []
            for reading in found.readings:
                recoded = _recoded(job, reading, found, file.recodings)
                if recoded is not None:
                    readings.append(replace(recoded, factor=recoded.factor * file.factor))
            if not readings:
                continue
            of_set: dict[int, float] = {}
            joint: dict[int, tuple[float, float]] = {}
            out = []
            for reading in readings:
                chosen = reading
                for number, statement in enumerate(job.observation_statements):
                    if not statement.test.holds(reading, file.name):
                        continue
                    if statement.by_set:
                        of_set[number] = statement.factor
                    elif _is_joint(reading, statement):
                        joint[number] = statement.factor**2, statement.vertical**2
                    else:
                        chosen = _modified(chosen, statement)
                out.append(chosen)
            factor = prod(of_set.values())
            plan, height = (sum(v[i] for v in joint.values()) for i in (0, 1))
            changed = (
                replace(r, factor=r.factor * factor, joint_variance=(plan, height)) for r in out
            )
            yield replace(found, readings=tuple(changed))


def _is_joint(reading: SnapReading, statement: ObservationStatement) -> bool:
    """Return whether a further error is one of all vectors of the set of a reading.

    It is that of the centroid of positions, or of the station from which vectors start.
    """
    if statement.command == CENTROID_ERROR:
        return reading.kind in VECTOR_KINDS
    begins = reading.kind in VECTOR_KINDS and reading.kind not in POINT_KINDS
    return statement.command == OFFSET_ERROR and begins and statement.test.ends(reading)[0]


def _modified(reading: SnapReading, statement: ObservationStatement) -> SnapReading:
    """Return a reading after a command that concerns it."""
    if statement.command == "reweight_observations":
        return replace(reading, factor=reading.factor * statement.factor)
    if statement.command == ANTENNA:
        if reading.kind not in VECTOR_KINDS:
            return reading
        of_ends = zip(
            (reading.instrument_height, reading.target_height),
            statement.test.ends(reading),
            strict=True,
        )
        instrument, target = (h + statement.factor if chosen else h for h, chosen in of_ends)
        return replace(reading, instrument_height=instrument, target_height=target)
    if statement.command == OFFSET_ERROR:
        place = statement.test.ends(reading)[0 if reading.kind in POINT_KINDS else 1]
        if reading.kind not in VECTOR_KINDS or not place:
            return reading
        plan, height = reading.own_variance
        more = plan + statement.factor**2, height + statement.vertical**2
        return replace(reading, own_variance=more)
    if statement.command == CENTROID_ERROR:
        return reading
    if statement.command == "calculate_gx_translation":
        return replace(reading, translated=statement.factor > 0)
    if statement.command == "use_distance_ratios_as_distances":
        return replace(reading, ratio=statement.factor == 0)
    return replace(reading, rejected=True)


def _recoded(job: SnapJob, reading: SnapReading, found: SnapSet, own: object) -> SnapReading | None:
    """Return a reading with the codes that recodings give; rejected where its station is out."""
    stations = job.stations
    assert stations is not None
    codes: list[str] = []
    rejected = reading.rejected
    for code in (reading.station, reading.target):
        new = code
        for recodings in (own, job.recodings):
            if not new or recodings is None:
                continue
            old = new
            new, out = recodings.new_code(old, reading.date)  # type: ignore[attr-defined]
            rejected |= out
            if not new:
                rejected = True
                new = ""
                break
            with_station(stations, new, old)
        codes.append(new)
        if code and not new:
            found.source.leave_out(reading.line, REJECTED_STATIONS, code)
            return replace(reading, rejected=True)
    for code in codes:
        if code and stations.find(code) is None:
            if job.ignore_all_missing or code.upper() in job.ignored_codes:
                found.source.leave_out(reading.line, MISSING_STATIONS, code)
                return replace(reading, rejected=True)
            found.source.wrong(
                reading.line,
                f"station {code[:40]!r} is not in the coordinate file; valid: its codes, or the "
                "command ignore_missing_stations",
            )
            return None
    return replace(reading, station=codes[0], target=codes[1], rejected=rejected)


def _taking_part(
    job: SnapJob, sets: list[SnapSet], states: dict[str, AdjustedStation]
) -> Iterator[tuple[SnapSet, list[int]]]:
    """Yield sets with the places of the readings that take part; leave out the others."""
    assert job.stations is not None
    for found in sets:
        kept = []
        for i, reading in enumerate(found.readings):
            codes = _codes(reading)
            name = f"{reading.kind} {' '.join(codes)}"
            if reading.rejected:
                found.source.leave_out(reading.line, ROWS_SWITCHED_OFF, name)
            elif any(states[c].rejected for c in codes):
                found.source.leave_out(reading.line, REJECTED_STATIONS, name)
            else:
                kept.append(i)
        if kept:
            yield found, kept


def _add_stations(
    job: SnapJob, states: dict[str, AdjustedStation], observed: set[str], network: Network
) -> None:
    """Add the stations that take part, with what holds them."""
    assert job.stations is not None
    for code, station in job.stations.by_code.items():
        state = states[code]
        if code in job.stations.recoded and code not in observed:
            continue
        if state.rejected or state.unlocated:
            why = REJECTED_STATIONS if state.rejected else UNLOCATED
            if state.unlocated and code not in observed:
                why = UNOBSERVED
            job.source.problems.leave_out(why, station.code, station.place)
            continue
        held = not state.adjusted
        made = job.source.problems.attempt(
            station.place,
            network.add_point,
            station.code,
            station.xyz,
            fixed="xyz" if held else "",
        )
        del made
        if station.xi or station.eta:
            network.set_vertical(station.code, xi=station.xi, eta=station.eta, fixed=True)
        if held:
            continue
        for part, axes in PARTS_OF_AXES.items():
            sigma = HELD_SIGMA_M if part not in state.adjusted else state.floated.get(part)
            if sigma is not None:
                network.add(
                    ControlPoint(
                        station.code,
                        station.xyz,
                        axes=axes,
                        sigma=(sigma,) * len(axes),
                        source=station.place,
                    )
                )


_OF_JOB = re.compile(
    rb"^[ \t]*(coordinate_file|data_file|mode|include)[ \t]+\S", re.IGNORECASE | re.MULTILINE
)


def is_snap_job(path: Path) -> bool:
    """Return whether a file is a command file: its first lines name files and the mode of a job."""
    return len({m.lower() for m in _OF_JOB.findall(file_beginning(path))}) > 1


READER = Reader(
    "snap", (".snp",), "job of LINZ SNAP", NetworkReader(read_snap), recognises=is_snap_job
)
