"""Writer of Metashape: sensors, poses, markers, scale bars as .xml that File > Import reads."""

from __future__ import annotations

from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

import numpy as np

from ...entities import Camera
from ...errors import InputError, Problem, taking
from ...frames import LocalFrame
from ...network.network import Network
from ...observations import ControlPoint, PhotoPosition, SlopeDistance
from ..file_transaction import write_files
from ..format_limits import Refusals, calibration_values, common_value, numbers_text, pixel_format
from .metashape_cameras import LOST_PARAMETERS, calibration_parameters, sensor_type

METASHAPE_LOCAL_WKT = (
    'LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],'
    'UNIT["metre",1,AUTHORITY["EPSG","9001"]]]'
)
"""Metashape's local system in metres."""
METASHAPE_PARAMETER_NAMES = {"c": "f", "x0": "cx", "y0": "cy"}
"""Metashape's names of parameters that differ from ours."""


@taking(Network)
def write_metashape(
    network: Network,
    path: str | Path,
    *,
    content: Literal["everything", "cameras"] = "everything",
) -> None:
    """Write a network as an .xml of Metashape's cameras and markers.

    Poses are written in the coordinates of the network, in a local reference system in metres.
    Points are markers: control points with an enabled reference, check points with a disabled
    one, the others without. Approximate coordinates of the others are no part of the format.
    Observed projection centres are references of cameras, slope distances are scale bars, and
    one standard deviation of all image points is the accuracy of projections.

    Args:
        network: the network; that of an adjustment is `Solution.as_network`.
        path: the .xml file.
        content: "cameras" writes calibrations and poses alone, whatever else the network has but
            motions of photos; readout times are left out.

    Raises:
        InputError: the format cannot express something of the network (all is listed), or the
            file cannot be written; no file has changed.
    """
    refusals = Refusals("Metashape")
    full = content == "everything"
    numbers = {name: i for i, name in enumerate(network.photos)}
    markers = {name: i for i, name in enumerate(network.points)} if full else {}
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<document version="1.2.0">']
    lines.append(f'  <chunk label={quoteattr(network.name or "Chunk 1")} enabled="true">')
    if full:
        kinds = (ControlPoint.kind, PhotoPosition.kind, SlopeDistance.kind)
        refusals.observations(network, kinds, "content='cameras' writes cameras alone")
        refusals.points(network)
        refusals.photos(network)
        refusals.cameras(network)
        if network.frame != LocalFrame():
            refusals.refuse("a frame that is not local, with X east; use content='cameras'")
    else:
        refusals.motions(network)
    lines += _sensors(network, refusals)
    lines += _cameras(network, refusals, numbers, full)
    if full:
        lines += _markers(network, refusals, markers)
        lines += _scale_bars(network, refusals, markers)
        lines += _locations(network, numbers, markers)
        lines += _settings(network, refusals)
    lines += [f"    <reference>{METASHAPE_LOCAL_WKT}</reference>", "    <transform>"]
    lines += ["      <rotation>1 0 0 0 1 0 0 0 1</rotation>"]
    lines += ["      <translation>0 0 0</translation>", "      <scale>1</scale>"]
    lines += ["    </transform>", "  </chunk>", "</document>"]
    refusals.raise_all()
    target = Path(path)
    try:
        encoded = ("\n".join(lines) + "\n").encode("utf-8")
    except UnicodeEncodeError as error:
        raise InputError(Problem(f"a name cannot be written: {error}", str(path))) from None
    write_files(target.parent, {target.name: encoded})


def _free(camera: Camera) -> list[str]:
    return [
        METASHAPE_PARAMETER_NAMES.get(n, n)
        for n, f in zip(camera.lens.names, camera.fixed, strict=True)
        if not f
    ]


def _sensors(network: Network, refusals: Refusals) -> list[str]:
    """Return the sensors; the parameters that are free are in the settings of the chunk."""
    lines = [f'    <sensors next_id="{len(network.cameras)}">']
    flags = {tuple(sorted(_free(c))) for c in network.cameras.values()} - {()}
    if len(flags) > 1:
        refusals.refuse("cameras with different free calibration parameters")
    for i, (name, camera) in enumerate(network.cameras.items()):
        where = f"camera {name!r}"
        size = pixel_format(camera)
        values = None
        if size is None:
            refusals.refuse(
                "image coordinates but pixels of a known format, from the upper left corner", where
            )
        else:
            values = calibration_parameters(camera.lens, calibration_values(camera), size)
            lost = LOST_PARAMETERS.get(type(camera.lens), ())
            held = dict(zip(camera.lens.names, camera.fixed, strict=True))
            if values is None or not all(held[n] for n in lost):
                kinds = ", ".join(
                    k.kind + (f" with {' = '.join(n)} = 0, held" if n else "")
                    for k, n in LOST_PARAMETERS.items()
                )
                refusals.refuse(f"the lens model {camera.lens.kind!r}; valid: {kinds}", where)
        w, h = size or (0.0, 0.0)
        resolution = f'<resolution width="{w:.12g}" height="{h:.12g}"/>'
        lines += [
            f'      <sensor id="{i}" label={quoteattr(name)} type="{sensor_type(camera.lens)}">',
            f"        {resolution}",
            f'        <property name="fixed" value="{"false" if _free(camera) else "true"}"/>',
            f'        <calibration type="{sensor_type(camera.lens)}" class="adjusted">',
            f"          {resolution}",
            *(f"          <{n}>{v!r}</{n}>" for n, v in (values or {}).items()),
            "        </calibration>",
            "      </sensor>",
        ]
    lines.append("    </sensors>")
    if flags:
        said = " ".join(next(iter(flags)))
        lines += ["    <meta>", f'      <property name="optimize/fit_flags" value="{said}"/>']
        lines += ["    </meta>"]
    return lines


def _cameras(
    network: Network, refusals: Refusals, numbers: dict[str, int], full: bool
) -> list[str]:
    sensors = {name: i for i, name in enumerate(network.cameras)}
    observed = {}
    for o in network.observations.values() if full else ():
        if isinstance(o, PhotoPosition):
            plain = o.axes == "xyz" and not any(o.lever_arm) and not o.mount and not o.drift
            if not plain or _sigmas(o) is None or o.photo in observed:
                what = "a position but one x, y, z with σ for each photo, of its projection centre"
                refusals.refuse(what, o.label())
            else:
                observed[o.photo] = o
    lines = [f'    <cameras next_id="{len(numbers)}" next_group_id="0">']
    for name, i in numbers.items():
        photo = network.photos[name]
        sensor = sensors[photo.camera]
        lines.append(
            f'      <camera id="{i}" sensor_id="{sensor}" label={quoteattr(name)} enabled="true">'
        )
        if photo.position is not None and photo.rotation is not None:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = photo.rotation, photo.position
            lines.append(f"        <transform>{numbers_text(matrix)}</transform>")
        if name in observed:
            lines.append(_reference(observed[name].value, _sigmas(observed[name]), True))
        lines.append("      </camera>")
    return [*lines, "    </cameras>"]


def _sigmas(o: ControlPoint | PhotoPosition) -> tuple[float, ...] | None:
    """Return σ of each coordinate; None where coordinates are correlated."""
    if o.covariance is None:
        return o.sigma
    variances = np.diag(o.covariance)
    if not np.array_equal(o.covariance, np.diag(variances)):
        return None
    return tuple(np.sqrt(variances).tolist())


def _reference(value: tuple[float, ...], sigma: tuple[float, ...] | None, enabled: bool) -> str:
    said = " ".join(f'{a}="{v!r}"' for a, v in zip("xyz", map(float, value), strict=True))
    for a, v in zip("xyz", map(float, sigma or ()), strict=False):
        said += f' s{a}="{v!r}"'
    return f'        <reference {said} enabled="{str(enabled).lower()}"/>'


def _markers(network: Network, refusals: Refusals, markers: dict[str, int]) -> list[str]:
    control: dict[str, ControlPoint] = {}
    for o in network.observations.values():
        if isinstance(o, ControlPoint):
            if o.axes != "xyz" or _sigmas(o) is None or o.point in control:
                refusals.refuse("control but one X, Y, Z with σ for each point", o.label())
            control[o.point] = o
    lines = [f'    <markers next_id="{len(markers)}">']
    for name, i in markers.items():
        lines.append(f'      <marker id="{i}" label={quoteattr(name)}>')
        check = network.points[name].check
        if name in control and control[name].axes == "xyz":
            lines.append(_reference(control[name].value, _sigmas(control[name]), True))
        elif check is not None and not np.isnan(check).any():
            lines.append(_reference(check, None, False))
        lines.append("      </marker>")
    return [*lines, "    </markers>"]


def _scale_bars(network: Network, refusals: Refusals, markers: dict[str, int]) -> list[str]:
    lines = ["    <scalebars>"]
    for i, o in enumerate(network.observations.values()):
        if o.kind != SlopeDistance.kind or not isinstance(o, SlopeDistance):
            continue
        if not isinstance(o.sigma, float) or _set_up(o):
            refusals.refuse("a distance but one between points with a plain σ", o.label())
            continue
        ends = f'start_marker_id="{markers[o.station]}" end_marker_id="{markers[o.target]}"'
        lines += [
            f'      <scalebar id="{i}" {ends}>',
            f'        <reference distance="{o.value!r}" accuracy="{o.sigma!r}" enabled="true"/>',
            "      </scalebar>",
        ]
    return [*lines, "    </scalebars>"]


def _set_up(o: SlopeDistance) -> bool:
    """Return whether a distance has heights of instruments and targets, or a distance meter."""
    return bool(o.instrument_height or o.target_height or o.instrument is not None)


def _locations(network: Network, numbers: dict[str, int], markers: dict[str, int]) -> list[str]:
    photo, point, xy, _ = network.images.columns()
    lines = ['    <frames next_id="1">', '      <frame id="0">', "        <markers>"]
    order = np.argsort(point, kind="stable")
    last = -1
    for row in order.tolist():
        if point[row] != last:
            lines += [] if last < 0 else ["          </marker>"]
            last = int(point[row])
            lines.append(f'          <marker marker_id="{last}">')
        x, y = float(xy[row, 0]), -float(xy[row, 1])
        at = f'camera_id="{photo[row]}" pinned="true" x="{x!r}" y="{y!r}"'
        lines.append(f"            <location {at}/>")
    lines += [] if last < 0 else ["          </marker>"]
    return [*lines, "        </markers>", "      </frame>", "    </frames>"]


def _settings(network: Network, refusals: Refusals) -> list[str]:
    sigma = network.images.columns()[3]
    if not len(sigma):
        return []
    same = common_value(sigma.ravel())
    if same is None:
        refusals.refuse("image points with different standard deviations; use content='cameras'")
    return [
        "    <settings>",
        f'      <property name="accuracy_projections" value="{same!r}"/>',
        "    </settings>",
    ]
