"""Writer of points as LandXML 1.2."""

from __future__ import annotations

import math
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ...crs.system import ReferenceSystem
from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...network.network import Network
from ..atomic import write_files
from ..numbers import write
from .grid_points import grid_points

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">
  <Units>
    <Metric linearUnit="meter" areaUnit="squareMeter" volumeUnit="cubicMeter" \
temperatureUnit="celsius" pressureUnit="milliBars" angularUnit="grads" directionUnit="grads"/>
  </Units>
{coordinate_system}  <Application name="factorgraph_adj"/>
  <CgPoints>
"""
TAIL = """  </CgPoints>
</LandXML>
"""


def write_landxml(network: Network, path: str | Path, *, points_only: bool = False) -> None:
    """Write the points of a network as ``<CgPoint>`` of LandXML 1.2, north first, metres.

    Held points have the code ``control``. A network on the Earth with a reference system is written
    in its grid, whose name and EPSG code the file states.

    Args:
        network: the network; that of an adjustment is `Solution.as_network`.
        path: the file.
        points_only: whether observations, photos and standard deviations may be left out, which
            the writer does not write; otherwise a network that has any is refused.

    Raises:
        InputError: all that the file cannot hold: a geocentric or topocentric frame without the
            reference system of a grid, left-handed or other axes
            than en and ne, points without east and north, names that XML cannot hold, and what
            ``points_only`` is about. Nothing is written then.
    """
    frame, problems = network.frame, []
    grid = grid_points(network)
    if grid is None and (not isinstance(frame, LocalFrame) or frame.axes not in ("en", "ne")):
        what = "LandXML takes a local frame with axes en or ne, or the reference system of a grid"
        problems.append(Problem(what, network.name))
    count = len(network.observations) + network.n_image_points + len(network.photos)
    if count and not points_only:
        what = (
            f"{count} observations and photos are not written as LandXML: give points_only=true "
            "(on the command line --with points_only=true)"
        )
        problems.append(Problem(what, network.name))
    east, north = (0, 1) if getattr(frame, "axes", "en") == "en" else (1, 0)
    lines = []
    for p in network.points.values():
        at = p.coordinates if grid is None else tuple(grid.coordinates[p.name].tolist())
        known = [k for k in (north, east, 2) if not math.isnan(at[k])]
        if north not in known or east not in known:
            problems.append(
                Problem("has no east and north: write the adjusted network", f"point {p.name!r}")
            )
            continue
        if not p.name.isprintable():
            problems.append(Problem("has a name that XML cannot hold", f"point {p.name!r}"))
        held = ' code="control"' if any(p.fixed) else ""
        text = " ".join(write(at[k]) for k in known)
        lines.append(f"    <CgPoint name={quoteattr(p.name)}{held}>{text}</CgPoint>\n")
    if problems:
        raise InputError(problems)
    target = Path(path)
    head = HEAD.replace("{coordinate_system}", "" if grid is None else _stated(grid.system))
    write_files(target.parent, {target.name: head + "".join(lines) + TAIL})


def _stated(system: ReferenceSystem) -> str:
    """Return the element of a reference system."""
    code = "" if system.epsg is None else f' epsgCode="{system.epsg}"'
    name, vertical = quoteattr(system.name), quoteattr(system.vertical)
    return f"  <CoordinateSystem name={name}{code} verticalDatum={vertical}/>\n"
