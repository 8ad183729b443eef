"""Writer of GVX 1.0: marks and GNSS vectors."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import GnssVector
from ...types import Array
from ...version import __version__
from ..atomic import write_files
from ..written import Refused


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
    refused = Refused("GVX")
    if not isinstance(network.frame, GeocentricFrame):
        refused.add("GVX needs a network in a geocentric frame")
    refused.parts(network, unknowns=())
    frame = network.frame if isinstance(network.frame, GeocentricFrame) else GeocentricFrame()
    points = []
    for name, p in network.points.items():
        where = f"point {name!r}"
        if not np.isfinite(p.coordinates).all():
            refused.add("GVX needs approximate coordinates: write the adjusted network", where)
            continue
        if any(p.fixed) or p.sigma is not None:
            refused.add("GVX has no held or weighted marks: read it, then hold them", where)
        if name != name.strip():
            refused.add("a name has no blanks at its ends", where)
        points += _point(name, np.array(p.coordinates), frame, reference_system_id, epoch)
    vectors = []
    joint = {
        m: covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        for members, covariance in network.clusters
        for i, m in enumerate(members)
    }
    for ident, o in network.observations.items():
        if not isinstance(o, GnssVector):
            refused.add(f"GVX has no {o.kind.replace('_', ' ')}, only GNSS vectors", o.label())
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
