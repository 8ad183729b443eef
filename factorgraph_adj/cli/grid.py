"""Options of commands for coordinates of a grid: --crs, --geoid, --heights, --frame, --grid."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

from ..crs.system import ReferenceSystem
from ..errors import InputError, Problem
from ..frames import GeocentricFrame, LocalFrame, TopocentricFrame
from ..io.format_options import options_of, refuse_unknown
from ..io.project import Project
from ..io.readers import Reader
from ..network.from_grid import from_grid
from ..network.network import Network

OWN = ("crs", "frame", "sources")
"""Options of `from_grid` that are options of the command, or its own affair."""


def add_grid(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    grid = parser.add_argument_group(
        "coordinates of a grid",
        "of files that do not state their reference system; projects do in [crs]",
    )
    grid.add_argument(
        "--crs",
        metavar="SYSTEM",
        help="reference system of easting, northing, height, such as EPSG:25832+7837: the network "
        "is moved into a frame on the Earth, results come back in the grid. Of a network that is "
        "on the Earth already, the system of its results",
    )
    grid.add_argument(
        "--geoid",
        metavar="PATH|N",
        help="what heights are above: a grid (.gtx, .tif, .gsb), a table of points (.csv), or a "
        "constant undulation in metres",
    )
    grid.add_argument(
        "--heights", choices=("ellipsoidal",), help="heights are above the ellipsoid of the system"
    )
    grid.add_argument(
        "--frame",
        choices=("topocentric", "geocentric"),
        help="frame of the adjustment (topocentric)",
    )
    grid.add_argument(
        "--grid",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="azimuths=true|grid, vectors=geocentric|grid, horizontal_distances=measured|"
        "ellipsoid|grid, deflections=none|held|σ in radians, geoid_offset=σ in metres; may be "
        "repeated",
    )


def system_of(options: argparse.Namespace) -> ReferenceSystem | None:
    """Return the reference system of a command; None: none is stated.

    Raises:
        InputError: options of a grid stand without --crs.
    """
    geoid = options.geoid
    if options.crs is None:
        alone = [
            name
            for name, given in (
                ("--geoid", geoid),
                ("--heights", options.heights),
                ("--frame", options.frame),
                ("--grid", options.grid or None),
            )
            if given is not None
        ]
        if alone:
            raise InputError(f"{', '.join(alone)}: state the reference system too, --crs")
        return None
    if geoid is not None:
        try:
            geoid = float(geoid)
        except ValueError:
            geoid = str(geoid)
    return ReferenceSystem(options.crs, geoid, options.heights).checked()


def options_of_reader(
    reader: Reader, system: ReferenceSystem, grid: dict[str, Any], frame: str | None
) -> dict[str, Any]:
    """Return options of a reader that converts coordinates of a grid itself.

    Raises:
        InputError: the reader has no such option, or takes no other frame.
    """
    if frame == "geocentric":
        raise InputError(f"--frame geocentric: {reader.description} is read in a topocentric frame")
    refuse_unknown(
        grid, reader.options, doing=f"reading {reader.description} in a grid", where="--grid"
    )
    return {"crs": system, **grid}


def moved(
    project: Project,
    system: ReferenceSystem,
    grid: dict[str, Any],
    frame: str | None,
) -> Project:
    """Return a project whose network is on the Earth, with the reference system of its results.

    Args:
        project: the project as read.
        system: the reference system.
        grid: options of `from_grid`.
        frame: kind of the new frame; None: topocentric.

    Raises:
        InputError: the network states a reference system itself, is in another frame than is
            wanted, or as `from_grid`.
    """
    network: Network = project.network
    valid = [o for o in options_of(from_grid) if o not in OWN]
    refuse_unknown(grid, valid, doing="moving a grid to the Earth", where="--grid")
    if network.crs is not None and not isinstance(network.frame, LocalFrame):
        what = f"states its reference system itself ({network.crs.name}): leave --crs out"
        raise InputError(Problem(what, str(project.path)))
    if isinstance(network.frame, LocalFrame):
        made = from_grid(
            network,
            system,
            frame="geocentric" if frame == "geocentric" else "topocentric",
            sources=project.sources,
            **grid,
        )
        return replace(project, network=made)
    kind = {"topocentric": TopocentricFrame, "geocentric": GeocentricFrame}.get(frame or "")
    if grid or (kind is not None and not isinstance(network.frame, kind)):
        what = "is in a frame on the Earth already: --frame and --grid belong to grid coordinates"
        raise InputError(Problem(what, str(project.path)))
    system.refuse_other(network.frame)
    network.crs = system
    return project
