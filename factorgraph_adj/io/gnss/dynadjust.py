"""Reader of DynAdjust's own files: stations (.stn) and measurements (.msr) in fixed columns.

Grammar: DynAdjust User's Guide, appendix B, and the tables of columns in its reader,
include/io/dnaiodnatypes.hpp (icsm-au/DynAdjust, Apache-2.0): versions 1.00, 3.00 and 3.01, which
the first line states: ``!#=DNA 3.01 STN  12.12.2018  GDA94  01.01.1994  149``. A file without that
line is of version 1.00.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ...network.network import Network
from ..format_reader import NetworkReader, Reader
from ..source import Problems
from ..text_files import file_beginning
from .dynadjust_columns import HEADER, dynadjust_records, has_stations
from .dynadjust_measurements import network_of

PARTNERS = {".stn": ".msr", ".msr": ".stn"}
NO_STATIONS_MESSAGE = (
    "has no stations: read the file of the stations (.stn), which takes the measurements (.msr) "
    "of the same name beside it or as the option measurements"
)


def read_dynadjust(
    stations: str | Path,
    *,
    measurements: str | Path | None = None,
    reference_frames: Literal["transform", "by GDA94", "as is"] = "transform",
    heights: Literal["refuse", "ellipsoidal"] = "refuse",
    geoid: str | float | None = None,
    driver: bool = False,
    ellipsoid: str = "GRS80",
) -> Network:
    """Read stations and measurements of DynAdjust in fixed columns (.stn, .msr).

    The records are those of DynaML, and `read_dynaml` says what becomes of them: types of
    coordinates and measurements, constraints, scales and units. Angles are degrees, minutes and
    seconds in columns of their own; I, J, P and Q are packed, as latitudes and longitudes of
    stations: ddd.mmssss. A ``*`` in the second column switches a measurement off, and in the first
    begins a comment. Text between the columns of a record is an error: a number that is not in its
    columns would lose digits.

    Date and count of the header, descriptions, and identifiers of measurements and clusters are not
    read.

    Tried on the networks gnss, urban (GDA94 and GDA2020), dsg, skye and apr of DynAdjust, and on
    the driver files of its simulator.

    Args:
        stations: file of the stations.
        measurements: file of the measurements. None: that of the same name with the suffix .msr.
        reference_frames: see `read_dynaml`.
        heights: see `read_dynaml`.
        geoid: see `read_dynaml`.
        driver: whether measurements have stations alone, see `read_dynaml`.
        ellipsoid: name of the ellipsoid.

    Raises:
        InputError: every problem of the files, each with its line.
    """
    first = Path(stations)
    problems = Problems()
    paths = [first] if measurements is None else [first, Path(measurements)]
    if measurements is None:
        other = first.with_suffix(PARTNERS.get(first.suffix.lower(), first.suffix))
        if other != first and other.is_file():
            paths.append(other)
    files = [dynadjust_records(path, problems, driver=driver) for path in paths]
    return network_of(
        files,
        first.stem,
        problems,
        reference_frames=reference_frames,
        heights=heights,
        geoid=geoid,
        driver=driver,
        ellipsoid=ellipsoid,
        no_stations=NO_STATIONS_MESSAGE,
    )


def recognise_dynadjust(path: Path) -> bool:
    """Return whether a file begins as one of stations or measurements does."""
    text = file_beginning(path).decode("latin-1")
    return HEADER.match(text) is not None or has_stations(text.splitlines()[:-1])


READER = Reader(
    "dynadjust",
    (".stn", ".msr"),
    "DynAdjust, fixed columns",
    NetworkReader(read_dynadjust),
    recognises=recognise_dynadjust,
)
