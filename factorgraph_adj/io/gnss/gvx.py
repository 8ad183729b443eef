"""Reader of GVX 1.0, the GNSS Vector Exchange Format of the National Geodetic Survey.

Format: D. Gillins, I. Sellars, GNSS Vector Exchange File Format (GVX), Narrative Description of GVX
Data Types and Elements, version 1.0 (2021).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import known
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import Correlated, GnssVector, Observation
from ...types import Array
from ..xml_source import XmlSource
from ..xml_tree import Element

CHILDREN = (
    *("SOURCE_DATA", "PROJECT_INFORMATION", "REFERENCE_SYSTEM", "EQUIPMENT", "SURVEY_SETUP"),
    *("POINT", "GNSS_VECTOR", "SESSION"),
)
"""Elements of the file; the first five describe the survey, and only REFERENCE_SYSTEM is read."""
METRES = ("meter", "meters", "metre", "metres", "m")
SAME_MARK = 100.0
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
    correlations: Literal["sessions", "vectors"] = "sessions",
    ellipsoid: str = "GRS80",
) -> Network:
    """Read the marks and vectors of a GVX file.

    The frame is geocentric. A ``<POINT>`` is the occupation of a mark: points of one ``<NAME>`` are
    one point of the network, whose approximate coordinates are those of its first occupation. No
    mark is held: hold or weight those that carry the datum. Vectors are from mark to mark, so that
    antenna heights are not applied again; their covariance is made of the standard deviations and
    correlations of ``<CORRELATION_MATRIX>``. Vectors of a ``<SESSION>`` have the correlations of
    its ``<CCM_BLOCK>``: nine numbers, row by row, rows being the components of the vector
    ``VECTOR_ID_ROW``. Equipment, set-ups, times and quality figures are not used.

    Args:
        path: the file.
        correlations: "vectors": leave out the correlations between vectors.
        ellipsoid: name of the ellipsoid for the normals of the frame.

    Raises:
        InputError: every problem of the file, each with its line: another version, reference
            systems that differ, points and vectors that are missing or stand there twice, other
            units than metres, covariances that are not positive definite.
    """
    file = XmlSource(path, "GVX")
    version = file.root.attributes.get("VERSION", "")
    if version != "1.0":
        file.add(file.root.line, f"VERSION must be 1.0, not {version[:20]!r}")
    file.refuse_children(file.root, {"GVX": CHILDREN})
    network = Network(file.path.stem, frame=GeocentricFrame(ellipsoid))
    marks = _marks(file, network)
    vectors = _vectors(file, marks)
    if not vectors:
        file.add(0, "has no <GNSS_VECTOR>")
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


def _found(element: Element, tag: str) -> Element | None:
    """Return the first descendant of a name; writers differ in what it stands in."""
    return next((e for e in element.walk() if e.tag == tag), None)


def _marks(file: XmlSource, network: Network) -> dict[str, str]:
    """Add points of the network; return the name of the mark of each ID."""
    systems: dict[str, int] = {}
    for system in file.root.all("REFERENCE_SYSTEM"):
        unit = next(iter(system.all("LINEAR_UNIT")), None)
        name = "" if unit is None else file.text(unit, "NAME", "")
        if name and name.lower() not in METRES:
            file.add(system.line, f"the linear unit must be metres, not {name[:20]!r}")
    marks: dict[str, str] = {}
    for element in file.root.all("POINT"):
        before = len(file.problems)
        ident, name = file.text(element, "ID"), file.text(element, "NAME")
        coordinates = file.child(element, "COORDINATES")
        if coordinates is None or len(file.problems) > before:
            continue
        systems.setdefault(file.text(coordinates, "REFERENCE_SYSTEM_ID", "?"), element.line)
        xyz = _coordinates(file, coordinates, network)
        if ident in marks:
            file.add(element.line, f"second point with the ID {ident[:40]!r}")
        if len(file.problems) > before:
            continue
        marks[ident] = name
        there = network.points.get(name)
        if there is None:
            file.attempt(element.line, network.add_point, name, xyz.tolist())
            continue
        distance = float(np.linalg.norm(xyz - np.array(there.coordinates)))
        if distance > SAME_MARK:
            what = f"mark {name[:40]!r} is {distance:.0f} m from its first occupation"
            file.add(element.line, f"{what}: two marks have one name")
    if len(systems) > 1:
        line = max(systems.values())
        file.add(line, f"points are in several reference systems: {known(systems)}")
    if not marks and not file.problems:
        file.add(0, "has no <POINT>")
    return marks


def _coordinates(file: XmlSource, element: Element, network: Network) -> Array:
    geocentric = next(element.all("GEOCENTRIC_COORDINATES"), None)
    if geocentric is not None and file.text(geocentric, "X", ""):
        return np.array([file.value(geocentric, a) for a in "XYZ"])
    geodetic = file.child(element, "GEODETIC_COORDINATES")
    if geodetic is None:
        return np.full(3, math.nan)
    latitude, longitude = (np.radians(file.value(geodetic, a)) for a in ("LATITUDE", "LONGITUDE"))
    height = file.value(geodetic, "ELLIPSOIDAL_HEIGHT")
    if abs(latitude) > math.pi / 2:
        file.add(geodetic.line, "the latitude must be from -90 to 90 degrees")
    frame = network.frame
    assert isinstance(frame, GeocentricFrame)
    angles = (np.array([latitude]), np.array([longitude]), np.array([height]))
    return np.asarray(frame.ellipsoid.to_cartesian(*angles)[0])


def _vectors(file: XmlSource, marks: dict[str, str]) -> dict[str, GvxVector]:
    vectors: dict[str, GvxVector] = {}
    for element in file.root.all("GNSS_VECTOR"):
        before = len(file.problems)
        ident = file.text(element, "ID")
        ends = [file.text(element, f"{e}_POINT_ID") for e in ("INITIAL", "TERMINAL")]
        for end in ends:
            if end and end not in marks:
                what = known(marks, meant=end)
                file.add(element.line, f"unknown point ID {end[:40]!r}; known: {what}")
        if ident in vectors:
            file.add(element.line, f"second vector with the ID {ident[:40]!r}")
        deltas, matrix = _found(element, "ECEF_DELTAS"), _found(element, "CORRELATION_MATRIX")
        if deltas is None or matrix is None:
            file.add(element.line, "<GNSS_VECTOR> needs <ECEF_DELTAS> and <CORRELATION_MATRIX>")
            continue
        value = tuple(file.value(deltas, f"D{a}") for a in "XYZ")
        sigma = np.array([file.value(matrix, f"SD{a}", positive=True) for a in "XYZ"])
        xy, xz, yz = (file.value(matrix, f"P{a}") for a in ("XY", "XZ", "YZ"))
        if len(file.problems) > before:
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
            text = file.text(block, "CORRELATIONS")
            found = [file.number(block.line, "a correlation", t) for t in text.split(",")]
            if unknown:
                what = known(vectors, meant=unknown[0])
                file.add(block.line, f"unknown vector ID {unknown[0][:40]!r}; known: {what}")
            elif len(found) != 9 or any(not abs(v) <= 1.0 for v in found):
                file.add(block.line, "<CORRELATIONS> needs nine numbers from -1 to 1")
            elif names[0] == names[1] or tuple(names) in blocks or tuple(names[::-1]) in blocks:
                file.add(block.line, f"second correlations of {' and '.join(names)[:80]}")
            else:
                blocks[names[0], names[1]] = np.reshape(found, (3, 3))
        named = {n for pair in blocks for n in pair}
        ids = [n for n in vectors if n in named]
        total = session.attributes.get("TOTAL_VECTORS", "")
        if total and (not total.isascii() or not total.isdigit() or int(total[:9]) < len(ids)):
            what = f"TOTAL_VECTORS is {total[:20]!r}, but its correlations are of {len(ids)}"
            file.add(session.line, what)
        if taken & set(ids):
            file.add(
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
