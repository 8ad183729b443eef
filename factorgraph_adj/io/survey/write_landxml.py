"""Writer of points as LandXML 1.2."""

from __future__ import annotations

import math
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...network.network import Network
from ..atomic import write_files
from ..numbers import write

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2">
  <Units>
    <Metric linearUnit="meter" areaUnit="squareMeter" volumeUnit="cubicMeter" \
temperatureUnit="celsius" pressureUnit="milliBars" angularUnit="grads" directionUnit="grads"/>
  </Units>
  <Application name="factorgraph_adj"/>
  <CgPoints>
"""
TAIL = """  </CgPoints>
</LandXML>
"""


def write_landxml(network: Network, path: str | Path, *, points_only: bool = False) -> None:
    """Write the points of a network as ``<CgPoint>`` of LandXML 1.2, north first, metres.

    Held points have the code ``control``.

    Args:
        network: the network; that of an adjustment is `Solution.as_network`.
        path: the file.
        points_only: whether observations, photos and standard deviations may be left out, which
            the writer does not write; otherwise a network that has any is refused.

    Raises:
        InputError: all that the file cannot hold: a geocentric frame, left-handed or other axes
            than en and ne, points without east and north, names that XML cannot hold, and what
            ``points_only`` is about. Nothing is written then.
    """
    frame, problems = network.frame, []
    if not isinstance(frame, LocalFrame) or frame.axes not in ("en", "ne"):
        problems.append(Problem("LandXML takes a local frame with axes en or ne", network.name))
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
        known = [k for k in (north, east, 2) if not math.isnan(p.coordinates[k])]
        if north not in known or east not in known:
            problems.append(
                Problem("has no east and north: write the adjusted network", f"point {p.name!r}")
            )
            continue
        if not p.name.isprintable():
            problems.append(Problem("has a name that XML cannot hold", f"point {p.name!r}"))
        held = ' code="control"' if any(p.fixed) else ""
        text = " ".join(write(p.coordinates[k]) for k in known)
        lines.append(f"    <CgPoint name={quoteattr(p.name)}{held}>{text}</CgPoint>\n")
    if problems:
        raise InputError(problems)
    target = Path(path)
    write_files(target.parent, {target.name: HEAD + "".join(lines) + TAIL})
