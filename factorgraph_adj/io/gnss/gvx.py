"""Reader and writer of GVX 1.0, the GNSS Vector Exchange Format of the NGS: vectors and marks.

Format of the National Geodetic Survey: D. Gillins, I. Sellars, GNSS Vector Exchange File Format
(GVX), Narrative Description of GVX Data Types and Elements, version 1.0 (2021).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ...errors import known, taking
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import Correlated, GnssVector, Observation
from ...types import Array
from ...version import __version__
from ..field_books.field_book import name_list
from ..file_transaction import write_files
from ..format_limits import Refusals
from ..format_reader import NetworkReader, Reader, beginning_has
from ..source import is_unread
from ..xml_files import Element
from ..xml_source import XmlSource

GVX_CHILDREN = (
    *("SOURCE_DATA", "PROJECT_INFORMATION", "REFERENCE_SYSTEM", "EQUIPMENT", "SURVEY_SETUP"),
    *("POINT", "GNSS_VECTOR", "SESSION"),
)
"""Elements of the file; the first five describe the survey, and only REFERENCE_SYSTEM is read."""
METRE_WORDS = ("meter", "meters", "metre", "metres", "m")
MAX_MARK_DISTANCE_M = 100.0
"""Largest distance of the coordinates of two occupations of a mark, metres."""


@dataclass(frozen=True)
class GvxVector:
    """A vector of the file."""

    id: str
    """Its ID."""
    observation: GnssVector
    """The vector."""
    sigma: Array
    """Standard deviations (3,), metres."""
    line: int
    """Line of the file."""


def read_gvx(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    correlations: Literal["sessions", "vectors"] = "sessions",
    ellipsoid: str = "GRS80",
) -> Network:
    """Read the marks and vectors of a GVX file.

    The frame is geocentric. A ``<POINT>`` is the occupation of a mark: points of one ``<NAME>`` are
    one point of the network, whose approximate coordinates are those of its first occupation;
    marks that ``fixed`` names are held at them, otherwise hold or weight those that carry the
    datum. Vectors are from mark to mark, so that
    antenna heights are not applied again; their covariance is made of the standard deviations and
    correlations of ``<CORRELATION_MATRIX>``. Vectors of a ``<SESSION>`` have the correlations of
    its ``<CCM_BLOCK>``: nine numbers, row by row, rows being the components of the vector
    ``VECTOR_ID_ROW``. Equipment, set-ups, times and quality figures are not used.

    Args:
        path: the file.
        fixed: names of marks that are held at their coordinates, in a text separated by commas.
        correlations: "vectors": leave out the correlations between vectors.
        ellipsoid: name of the ellipsoid for the normals of the frame.

    Raises:
        InputError: every problem of the file, each with its line: another version, reference
            systems that differ, points and vectors that are missing or occur twice, other
            units than metres, covariances that are not positive definite.
    """
    file = XmlSource(path, "GVX")
    version = file.root.attributes.get("VERSION", "")
    if version != "1.0":
        file.wrong(file.root.line, f"VERSION must be 1.0, not {version[:20]!r}")
    file.refuse_children(file.root, {"GVX": GVX_CHILDREN})
    network = Network(file.path.stem, frame=GeocentricFrame(ellipsoid))
    marks = _marks(file, network)
    vectors = _vectors(file, marks)
    if not vectors:
        file.wrong(0, "has no <GNSS_VECTOR>")
    _hold(file, network, name_list(fixed))
    groups = _sessions(file, vectors) if correlations == "sessions" else []
    file.raise_all()
    grouped = {v for group, _ in groups for v in group}
    for v in vectors.values():
        if v.id not in grouped:
            file.attempt(v.line, network.add, v.observation)
    for ids, covariance in groups:
        members: tuple[Observation, ...] = tuple(vectors[i].observation for i in ids)
        joint = file.attempt(vectors[ids[0]].line, Correlated, members, covariance)
        if joint is not None:
            file.attempt(vectors[ids[0]].line, network.add, joint)
    file.raise_all()
    return network


def _hold(file: XmlSource, network: Network, names: Iterable[str]) -> None:
    """Hold marks at their coordinates."""
    for name in names:
        if name in network.points:
            network.points[name] = replace(network.points[name], fixed=(True, True, True))
            network.datum = "given"
        else:
            what = f"fixed: there is no mark {name!r}; known: {known(network.points, meant=name)}"
            file.wrong(file.root.line, what)


def _descendant(element: Element, tag: str) -> Element | None:
    """Return the first descendant of a name; writers differ in its parent."""
    return next((e for e in element.walk() if e.tag == tag), None)


def _marks(file: XmlSource, network: Network) -> dict[str, str]:
    """Add points of the network; return the name of the mark of each ID."""
    systems: dict[str, int] = {}
    for system in file.root.all("REFERENCE_SYSTEM"):
        unit = next(iter(system.all("LINEAR_UNIT")), None)
        name = "" if unit is None else file.inside(unit, "NAME").name("")
        if name and name.lower() not in METRE_WORDS:
            file.wrong(system.line, f"the linear unit must be metres, not {name[:20]!r}")
    marks: dict[str, str] = {}
    for element in file.root.all("POINT"):
        before = file.problems.count
        ident, name = file.inside(element, "ID").name(), file.inside(element, "NAME").name()
        coordinates = file.child(element, "COORDINATES")
        if coordinates is None or file.problems.count > before:
            continue
        systems.setdefault(file.inside(coordinates, "REFERENCE_SYSTEM_ID").name("?"), element.line)
        xyz = _coordinates(file, coordinates, network)
        if ident in marks:
            file.wrong(element.line, f"second point with the ID {ident[:40]!r}")
        if file.problems.count > before:
            continue
        marks[ident] = name
        there = network.points.get(name)
        if there is None:
            file.attempt(element.line, network.add_point, name, xyz.tolist())
            continue
        distance = float(np.linalg.norm(xyz - np.array(there.coordinates)))
        if distance > MAX_MARK_DISTANCE_M:
            what = f"mark {name[:40]!r} is {distance:.0f} m from its first occupation"
            file.wrong(element.line, f"{what}: two marks have one name")
    if len(systems) > 1:
        line = max(systems.values())
        file.wrong(line, f"points are in several reference systems: {known(systems)}")
    if not marks and not file.problems.count:
        file.wrong(0, "has no <POINT>")
    return marks


def _coordinates(file: XmlSource, element: Element, network: Network) -> Array:
    geocentric = next(element.all("GEOCENTRIC_COORDINATES"), None)
    if geocentric is not None and file.inside(geocentric, "X").name(""):
        return np.array([file.inside(geocentric, a).number() for a in "XYZ"])
    geodetic = file.child(element, "GEODETIC_COORDINATES")
    if geodetic is None:
        return np.full(3, math.nan)
    latitude, longitude = (
        np.radians(file.inside(geodetic, a).number()) for a in ("LATITUDE", "LONGITUDE")
    )
    height = file.inside(geodetic, "ELLIPSOIDAL_HEIGHT").number()
    if abs(latitude) > math.pi / 2:
        file.wrong(geodetic.line, "the latitude must be from -90 to 90 degrees")
    frame = network.frame
    assert isinstance(frame, GeocentricFrame)
    angles = (np.array([latitude]), np.array([longitude]), np.array([height]))
    return np.asarray(frame.ellipsoid.to_cartesian(*angles)[0])


def _vectors(file: XmlSource, marks: dict[str, str]) -> dict[str, GvxVector]:
    vectors: dict[str, GvxVector] = {}
    for element in file.root.all("GNSS_VECTOR"):
        before = file.problems.count
        ident = file.inside(element, "ID").name()
        ends = [file.inside(element, f"{e}_POINT_ID").name() for e in ("INITIAL", "TERMINAL")]
        for end in ends:
            if end and end not in marks:
                what = known(marks, meant=end)
                file.wrong(element.line, f"unknown point ID {end[:40]!r}; known: {what}")
        if ident in vectors:
            file.wrong(element.line, f"second vector with the ID {ident[:40]!r}")
        deltas, matrix = (
            _descendant(element, "ECEF_DELTAS"),
            _descendant(element, "CORRELATION_MATRIX"),
        )
        if deltas is None or matrix is None:
            file.wrong(element.line, "<GNSS_VECTOR> needs <ECEF_DELTAS> and <CORRELATION_MATRIX>")
            continue
        value = tuple(file.inside(deltas, f"D{a}").number() for a in "XYZ")
        sigma = np.array([file.inside(matrix, f"SD{a}").sigma() for a in "XYZ"])
        xy, xz, yz = (file.inside(matrix, f"P{a}").number() for a in ("XY", "XZ", "YZ"))
        if file.problems.count > before:
            continue
        covariance = np.array([[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]])
        covariance *= np.outer(sigma, sigma)
        made = file.attempt(
            element.line,
            GnssVector,
            *(marks[e] for e in ends),
            value,
            covariance=covariance,
            id=ident,
            source=file.place(element.line),
        )
        if made is not None:
            vectors[ident] = GvxVector(ident, made, sigma, element.line)
    return vectors


def _sessions(file: XmlSource, vectors: dict[str, GvxVector]) -> list[tuple[list[str], Array]]:
    """Return the vectors of sessions and their joint covariances."""
    groups: list[tuple[list[str], Array]] = []
    taken: set[str] = set()
    for session in file.root.all("SESSION"):
        blocks: dict[tuple[str, str], Array] = {}
        for block in (e for e in session.walk() if e.tag == "CCM_BLOCK"):
            names = [block.attributes.get(f"VECTOR_ID_{a}", "") for a in ("ROW", "COL")]
            unknown = [n for n in names if n not in vectors]
            text = file.inside(block, "CORRELATIONS").name().replace(",", " ")
            found = file.field(block.line, text, "<CORRELATIONS>").numbers(9)
            if unknown:
                what = known(vectors, meant=unknown[0])
                file.wrong(block.line, f"unknown vector ID {unknown[0][:40]!r}; known: {what}")
            elif any(abs(v) > 1.0 for v in found):
                file.wrong(block.line, "<CORRELATIONS> needs nine numbers from -1 to 1")
            elif is_unread(found):
                continue
            elif names[0] == names[1] or tuple(names) in blocks or tuple(names[::-1]) in blocks:
                file.wrong(block.line, f"second correlations of {' and '.join(names)[:80]}")
            else:
                blocks[names[0], names[1]] = np.reshape(found, (3, 3))
        named = {n for pair in blocks for n in pair}
        ids = [n for n in vectors if n in named]
        total = session.attributes.get("TOTAL_VECTORS", "")
        if total and (not total.isascii() or not total.isdigit() or int(total[:9]) < len(ids)):
            what = f"TOTAL_VECTORS is {total[:20]!r}, but its correlations are of {len(ids)}"
            file.wrong(session.line, what)
        if taken & set(ids):
            file.wrong(
                session.line, f"vector {sorted(taken & set(ids))[0][:40]!r} is in two sessions"
            )
        taken |= set(ids)
        if not ids:
            continue
        covariance = np.zeros((3 * len(ids), 3 * len(ids)))
        for i, a in enumerate(ids):
            covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = vectors[a].observation.covariance
        for (a, b), correlation in blocks.items():
            i, j = 3 * ids.index(a), 3 * ids.index(b)
            part = correlation * np.outer(vectors[a].sigma, vectors[b].sigma)
            covariance[i : i + 3, j : j + 3] = part
            covariance[j : j + 3, i : i + 3] = part.T
        groups.append((ids, covariance))
    return groups


@taking(Network)
def write_gvx(
    network: Network,
    path: str | Path,
    *,
    reference_system_id: int = 0,
    reference_system: str = "unknown",
    epoch: float = 2010.0,
) -> None:
    """Write the GNSS vectors of a network and the marks at their ends as GVX 1.0.

    Every mark is one ``<POINT>`` with its name as ID; vectors with a joint covariance are a
    ``<SESSION>``. Numbers have 17 digits. What the format asks for and a network does not have
    (receivers, times, orbits) is written as "unknown" or left empty; OPUS Projects wants it filled.

    Args:
        network: network in a geocentric frame that has only GNSS vectors.
        path: the file.
        reference_system_id: number of the reference system in the ISO Geodetic Registry, such as
            126 for NAD 83(2011).
        reference_system: its name.
        epoch: epoch of the coordinates, years.

    Raises:
        InputError: everything that GVX cannot express. No file has changed.
    """
    refused = Refusals("GVX")
    if not isinstance(network.frame, GeocentricFrame):
        refused.wrong("GVX needs a network in a geocentric frame", network.name)
    refused.parts(network, unknowns=())
    frame = network.frame if isinstance(network.frame, GeocentricFrame) else GeocentricFrame()
    points = []
    for name, p in network.points.items():
        where = f"point {name!r}"
        if not np.isfinite(p.coordinates).all():
            refused.wrong("GVX needs approximate coordinates: write the adjusted network", where)
            continue
        if any(p.fixed) or p.sigma is not None:
            refused.wrong("GVX has no held or weighted marks: read it, then hold them", where)
        if name != name.strip():
            refused.wrong("a name has no blanks at its ends", where)
        points += _point(name, np.array(p.coordinates), frame, reference_system_id, epoch)
    vectors = []
    joint = {
        m: covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        for members, covariance in network.clusters
        for i, m in enumerate(members)
    }
    for ident, o in network.observations.items():
        if not isinstance(o, GnssVector):
            refused.wrong(f"GVX has no {o.kind.replace('_', ' ')}, only GNSS vectors", o.label())
            continue
        refused.nothing_of(o, "instrument_height", "target_height")
        vectors += _vector(ident, o, joint.get(ident))
    refused.raise_all()
    sessions = []
    for number, (members, covariance) in enumerate(network.clusters, 1):
        sessions += _session(number, members, covariance)
    now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S.00}"
    head = [
        '<?xml version="1.0" encoding="utf-8"?>',
        '<GVX VERSION="1.0">',
        f"  <SOURCE_DATA><NAME>{escape(network.name or 'network')}</NAME>"
        f"<CREATED_DATE>{now}</CREATED_DATE><APPLICATION><NAME>factorgraph_adj</NAME>"
        f"<VERSION>{__version__}</VERSION></APPLICATION></SOURCE_DATA>",
        f"  <REFERENCE_SYSTEM><ID>{reference_system_id}</ID>"
        f"<NAME>{escape(reference_system)}</NAME><LINEAR_UNIT><NAME>meter</NAME></LINEAR_UNIT>"
        "<ANGULAR_UNIT><NAME>degree</NAME></ANGULAR_UNIT></REFERENCE_SYSTEM>",
        "  <EQUIPMENT><ID>unknown</ID></EQUIPMENT>",
        "  <SURVEY_SETUP><ID>unknown</ID></SURVEY_SETUP>",
    ]
    target = Path(path)
    text = "\n".join([*head, *points, *vectors, *sessions, "</GVX>"]) + "\n"
    write_files(target.parent, {target.name: text})


def _point(name: str, xyz: Array, frame: GeocentricFrame, system: int, epoch: float) -> list[str]:
    latitude, longitude, height = (float(v) for v in frame.ellipsoid.to_geodetic(xyz))
    x, y, z = (repr(float(v)) for v in xyz)
    return [
        f"  <POINT><ID>{escape(name)}</ID><NAME>{escape(name)}</NAME>"
        "<EQUIPMENT_ID>unknown</EQUIPMENT_ID><ARP_HEIGHT>0</ARP_HEIGHT>"
        "<POINT_TYPE>unknown</POINT_TYPE>",
        f"    <COORDINATES><REFERENCE_SYSTEM_ID>{system}</REFERENCE_SYSTEM_ID>"
        f"<EPOCH>{epoch!r}</EPOCH>",
        f"      <GEODETIC_COORDINATES><LATITUDE>{np.degrees(latitude):.12f}</LATITUDE>"
        f"<LONGITUDE>{np.degrees(longitude):.12f}</LONGITUDE>"
        f"<ELLIPSOIDAL_HEIGHT>{height:.6f}</ELLIPSOIDAL_HEIGHT></GEODETIC_COORDINATES>",
        f"      <GEOCENTRIC_COORDINATES><X>{x}</X><Y>{y}</Y><Z>{z}</Z></GEOCENTRIC_COORDINATES>",
        "    </COORDINATES></POINT>",
    ]


def _vector(ident: str, o: GnssVector, joint: Array | None) -> list[str]:
    own = np.diag(np.array(o.sigma) ** 2) if o.covariance is None else np.asarray(o.covariance)
    covariance = own if joint is None else joint
    sigma = np.sqrt(np.diag(covariance))
    p = covariance / np.outer(sigma, sigma)
    deltas = "".join(f"<D{a}>{float(v)!r}</D{a}>" for a, v in zip("XYZ", o.value, strict=True))
    sigmas = "".join(f"<SD{a}>{float(v)!r}</SD{a}>" for a, v in zip("XYZ", sigma, strict=True))
    correlations = "".join(
        f"<P{a}>{float(p[i, j])!r}</P{a}>" for a, i, j in (("XY", 0, 1), ("XZ", 0, 2), ("YZ", 1, 2))
    )
    return [
        f"  <GNSS_VECTOR><ID>{escape(ident)}</ID>"
        f"<INITIAL_POINT_ID>{escape(o.station)}</INITIAL_POINT_ID>"
        f"<TERMINAL_POINT_ID>{escape(o.target)}</TERMINAL_POINT_ID>"
        "<SURVEY_SETUP_ID>unknown</SURVEY_SETUP_ID>",
        f"    <ECEF_DELTAS>{deltas}</ECEF_DELTAS>",
        f"    <CORRELATION_MATRIX>{sigmas}{correlations}</CORRELATION_MATRIX></GNSS_VECTOR>",
    ]


def _session(number: int, members: tuple[str, ...], covariance: Array) -> list[str]:
    sigma = np.sqrt(np.diag(covariance))
    p = covariance / np.outer(sigma, sigma)
    n = len(members)
    lines = [
        f'  <SESSION ID="{number}" TOTAL_VECTORS="{n}"><CROSS_CORRELATION_MATRIX ORDER="{3 * n}">'
    ]
    for i in range(n):
        for j in range(i):
            block = p[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
            cells = ",".join(repr(float(v)) for v in block.ravel())
            lines.append(
                f"    <CCM_BLOCK VECTOR_ID_ROW={quoteattr(members[i])} "
                f"VECTOR_ID_COL={quoteattr(members[j])}>"
                f"<CORRELATIONS>{cells}</CORRELATIONS></CCM_BLOCK>"
            )
    lines.append("  </CROSS_CORRELATION_MATRIX></SESSION>")
    return lines


READER = Reader(
    "gvx",
    (".gvx", ".xml"),
    "GNSS Vector Exchange",
    NetworkReader(read_gvx),
    recognises=beginning_has(b"<GVX"),
)
