"""Writer of DynaML of DynAdjust: stations and measurements in one file.

Format: ICSM, DynAdjust User's Guide, DynaML.xsd 1.0.2 (2020).
"""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import escape

import numpy as np

from ...errors import taking
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    ControlPoint,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    Observation,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ...observations.ellipsoidal_observations import (
    CHORD,
    EllipsoidDistance,
    EllipsoidHeight,
    EllipsoidHeightDifference,
    GeodeticAzimuth,
)
from ...types import Array
from ...units import ARCSEC
from ..file_transaction import write_files
from ..format_limits import Refusals
from .dynadjust_measurements import LENGTH_TYPES
from .dynaml import MEMBER_TAGS

MAX_STATION_NAME_CHARACTERS = 30
"""Largest number of characters of the name of a station in DynAdjust."""
MEASUREMENT_TYPES: dict[type[Observation], str] = {
    SlopeDistance: "S",
    ZenithAngle: "V",
    VerticalAngle: "Z",
    GeodeticAzimuth: "B",
    Azimuth: "K",
    HeightDifference: "L",
    EllipsoidHeightDifference: "L",
    HorizontalAngle: "A",
    AstronomicLatitude: "I",
    AstronomicLongitude: "J",
}
"""Types of single measurements."""
ARCSEC_RESOLUTION = Decimal("1e-9")
"""Last digit of written seconds of arc: 5·10⁻¹⁵ rad."""
_DATE = re.compile(r"\d{2}\.\d{2}\.\d{4}", re.ASCII)


@taking(Network)
def write_dynaml(
    network: Network,
    path: str | Path,
    *,
    reference_frame: str = "GDA2020",
    epoch: str = "01.01.2020",
    heights: Literal["refuse", "ellipsoidal"] = "refuse",
) -> None:
    """Write a network as DynaML of DynAdjust, stations and measurements in one file.

    Stations are written as geocentric X, Y, Z with the constraints ``CCC`` (held) or ``FFF``. The
    inverse of `read_dynaml`, whose table lists the kinds that are written; lengths have 15
    significant digits, angles 10⁻⁹ seconds.

    Args:
        network: network in a geocentric frame.
        path: the file.
        reference_frame: name of the reference frame of stations and measurements.
        epoch: epoch of the reference frame, dd.mm.yyyy.
        heights: "ellipsoidal": height differences are written as type L, whose heights DynAdjust
            takes as orthometric unless it has no geoid.

    Raises:
        InputError: everything that DynaML cannot express. No file has changed.
    """
    refused = Refusals("DynaML")
    if not isinstance(network.frame, GeocentricFrame):
        refused.wrong("DynaML needs a network in a geocentric frame", network.name)
    if not _DATE.fullmatch(epoch):
        refused.wrong(f"epoch must be dd.mm.yyyy, not {epoch!r}", network.name)
    refused.parts(network)
    lines = [
        '<?xml version="1.0"?>',
        f'<DnaXmlFormat type="Combined File" referenceframe="{escape(reference_frame)}" '
        f'epoch="{escape(epoch)}">',
        *_stations(network, refused),
    ]
    clustered = {i for members, _ in network.clusters for i in members}
    of_sets: dict[tuple[str, str], list[Direction]] = {}
    for ident, o in network.observations.items():
        if ident in clustered:
            continue
        if isinstance(o, Direction):
            refused.nothing_of(o, "instrument_height", "target_height", "collimation_error", "face")
            of_sets.setdefault((o.station, o.set), []).append(o)
            continue
        if isinstance(o, ControlPoint) and o.local:
            lines += _components(o, network, refused)
            continue
        lines += _single(o, refused, heights, reference_frame, epoch)
    for (station, _), directions in of_sets.items():
        lines += _set(station, directions, refused)
    for members, covariance in network.clusters:
        group = [network.observations[m] for m in members]
        lines += _cluster(group, covariance, refused, reference_frame, epoch)
    refused.raise_all()
    target = Path(path)
    text = "\n".join([*lines, "</DnaXmlFormat>"]) + "\n"
    write_files(target.parent, {target.name: text})


def _stations(network: Network, refused: Refusals) -> list[str]:
    lines = []
    for name, p in network.points.items():
        where = f"point {name!r}"
        if name != name.strip() or len(name) > MAX_STATION_NAME_CHARACTERS:
            refused.wrong(
                f"a name has up to {MAX_STATION_NAME_CHARACTERS} characters, no blanks at ends",
                where,
            )
        if p.sigma is not None:
            refused.wrong("DynaML has no weighted stations: observe their position (Y)", where)
        if any(p.fixed) and not all(p.fixed):
            refused.wrong(f"DynaML cannot hold {p.held} of X, Y, Z alone", where)
        if not np.isfinite(p.coordinates).all():
            refused.wrong("DynaML needs approximate coordinates: write the adjusted network", where)
        x, y, z = (repr(float(v)) for v in p.coordinates)
        lines += [
            "  <DnaStation>",
            f"    <Name>{escape(name)}</Name>",
            f"    <Constraints>{'CCC' if all(p.fixed) else 'FFF'}</Constraints>",
            "    <Type>XYZ</Type>",
            f"    <StationCoord><Name>{escape(name)}</Name><XAxis>{x}</XAxis>"
            f"<YAxis>{y}</YAxis><Height>{z}</Height></StationCoord>",
            "  </DnaStation>",
        ]
    return lines


def packed_angle(angle: float) -> str:
    """Return an angle, radians, as degrees, minutes and seconds in ddd.mmssss.

    >>> import math
    >>> packed_angle(-math.radians(36 + 33 / 60 + 48.25 / 3600))
    '-36.334825'
    """
    total = Decimal(repr(abs(float(np.degrees(angle)) * 3600.0))).quantize(ARCSEC_RESOLUTION)
    degrees, rest = divmod(total, 3600)
    minutes, seconds = divmod(rest, 60)
    digits = f"{seconds:012.9f}".replace(".", "").rstrip("0").ljust(2, "0")
    return f"{'-' if angle < 0 else ''}{int(degrees)}.{int(minutes):02d}{digits}"


def _measurement(kind: str, inside: list[str]) -> list[str]:
    return [
        "  <DnaMeasurement>",
        f"    <Type>{kind}</Type>",
        "    <Ignore/>",
        *(f"    {line}" for line in inside),
        "  </DnaMeasurement>",
    ]


def _single(o: Observation, refused: Refusals, heights: str, frame: str, epoch: str) -> list[str]:
    if isinstance(o, GnssVector) or (isinstance(o, ControlPoint) and o.axes == "xyz"):
        own = np.diag(np.array(o.sigma) ** 2) if o.covariance is None else o.covariance
        return _cluster([o], own, refused, frame, epoch)
    kind = _type_of(o)
    if kind is None:
        what = f"DynaML has no {o.kind.replace('_', ' ')}"
        refused.wrong(what + (f" of {o.axes}" if isinstance(o, ControlPoint) else ""), o.label())
        return []
    surfaces = [getattr(o, f"{end}_surface", 0.0) for end in ("station", "target")]
    if kind == "L" and heights == "refuse" and not any(surfaces):
        refused.wrong("type L is orthometric; heights='ellipsoidal' writes it", o.label())
    refused.nothing_of(
        o, "instrument", "refraction", "index_error", "target2_height", "face", "length_km"
    )
    if kind in "AIJ":
        refused.nothing_of(o, "instrument_height", "target_height")
    lengths = kind in LENGTH_TYPES
    value, sigma = float(o.value), refused.sigma(o)  # type: ignore[attr-defined]
    tags = ("First", "Second", "Third")
    inside = [f"<{t}>{escape(n)}</{t}>" for t, n in zip(tags, o.points(), strict=False)]
    inside += [
        f"<Value>{value!r}</Value>" if lengths else f"<Value>{packed_angle(value)}</Value>",
        f"<StdDev>{sigma if lengths else sigma / ARCSEC!r}</StdDev>",
    ]
    if kind in "SVZLBK":
        hi, ht = (float(getattr(o, f"{end}_height")) for end in ("instrument", "target"))
        inside += [f"<InstHeight>{hi!r}</InstHeight>", f"<TargHeight>{ht!r}</TargHeight>"]
    return _measurement(kind, inside)


def _type_of(o: Observation) -> str | None:
    """Return the type of a single measurement; None if there is none."""
    if isinstance(o, EllipsoidHeight):
        return "H" if o.surface else "R"
    if isinstance(o, EllipsoidDistance):
        at_sea = o.station_surface != 0.0 or o.target_surface != 0.0
        if o.line == CHORD:
            return None if at_sea else "C"
        return "M" if at_sea else "E"
    return MEASUREMENT_TYPES.get(type(o))


def _components(o: ControlPoint, network: Network, refused: Refusals) -> list[str]:
    """Return P, Q and R: latitude, longitude and ellipsoidal height of a position."""
    covariance = None if o.covariance is None else np.asarray(o.covariance)
    if covariance is not None and np.any(covariance - np.diag(np.diag(covariance))):
        refused.wrong("DynaML has no correlations of latitude, longitude and height", o.label())
        return []
    frame = network.frame
    if not isinstance(frame, GeocentricFrame):
        return []
    sigmas = o.sigma if covariance is None else np.sqrt(np.diag(covariance)).tolist()
    latitude, longitude, height = (
        float(v) for v in frame.ellipsoid.to_geodetic(np.array(o.value, dtype=float))
    )
    m, n = (float(v) for v in frame.ellipsoid.radii(np.array(latitude)))
    written = {
        "n": ("P", packed_angle(latitude), ARCSEC * (m + height)),
        "e": ("Q", packed_angle(longitude), ARCSEC * (n + height) * np.cos(latitude)),
        "u": ("R", repr(height), 1.0),
    }
    lines = []
    for axis, sigma in zip(o.axes, sigmas or (), strict=True):
        kind, value, unit = written[axis]
        inside = [
            f"<First>{escape(o.point)}</First>",
            f"<Value>{value}</Value>",
            f"<StdDev>{float(sigma / unit)!r}</StdDev>",
        ]
        lines += _measurement(kind, inside)
    return lines


def _set(station: str, directions: list[Direction], refused: Refusals) -> list[str]:
    first, *others = directions
    inside = [
        f"<First>{escape(station)}</First>",
        f"<Second>{escape(first.target)}</Second>",
        f"<Value>{packed_angle(first.value % (2 * np.pi))}</Value>",
        f"<StdDev>{refused.sigma(first) / ARCSEC!r}</StdDev>",
        f"<Total>{len(others)}</Total>",
    ]
    inside += [
        f"<Directions><Ignore/><Target>{escape(o.target)}</Target>"
        f"<Value>{packed_angle(o.value % (2 * np.pi))}</Value>"
        f"<StdDev>{refused.sigma(o) / ARCSEC!r}</StdDev></Directions>"
        for o in others
    ]
    return _measurement("D", inside)


def _cluster(
    group: list[Observation], covariance: Array, refused: Refusals, frame: str, epoch: str
) -> list[str]:
    """Return G, X or Y of vectors or positions with a joint covariance."""
    vectors = [o for o in group if isinstance(o, GnssVector)]
    positions = [o for o in group if isinstance(o, ControlPoint) and o.axes == "xyz"]
    if len(group) not in (len(vectors), len(positions)):
        what = "DynaML has joint covariances of GNSS vectors, or of positions x, y, z, only"
        refused.wrong(what, group[0].label())
        return []
    for o in vectors:
        refused.nothing_of(o, "instrument_height", "target_height")
    kind = "Y" if positions else "G" if len(group) == 1 else "X"
    tag, cross = MEMBER_TAGS[bool(positions)]
    inside = [
        f"<ReferenceFrame>{escape(frame)}</ReferenceFrame>",
        f"<Epoch>{escape(epoch)}</Epoch>",
        "<Vscale>1</Vscale><Pscale>1</Pscale><Lscale>1</Lscale><Hscale>1</Hscale>",
    ]
    if positions:
        inside.append("<Coords>XYZ</Coords>")
    if kind != "G":
        inside.append(f"<Total>{len(group)}</Total>")
    members: list[GnssVector | ControlPoint] = [*vectors, *positions]
    for i, member in enumerate(members):
        inside += [
            f"<{t}>{escape(n)}</{t}>"
            for t, n in zip(("First", "Second"), member.points(), strict=False)
        ]
        x, y, z = (float(v) for v in member.value)
        inside += [f"<{tag}>", f"  <X>{x!r}</X><Y>{y!r}</Y><Z>{z!r}</Z>"]
        inside.append("  " + "".join(
            f"<Sigma{a}{b}>{float(covariance[3 * i + j, 3 * i + k])!r}</Sigma{a}{b}>"
            for j, a in enumerate("XYZ") for k, b in enumerate("XYZ") if k >= j
        ))  # fmt: skip
        for other in range(i + 1, len(group)):
            block = covariance[3 * i : 3 * i + 3, 3 * other : 3 * other + 3]
            cells = "".join(
                f"<m{j + 1}{k + 1}>{float(block[j, k])!r}</m{j + 1}{k + 1}>"
                for j in range(3)
                for k in range(3)
            )
            inside.append(f"  <{cross}>{cells}</{cross}>")
        inside.append(f"</{tag}>")
    return _measurement(kind, inside)
