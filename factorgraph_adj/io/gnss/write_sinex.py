"""Writer of SINEX: coordinates of points with their full covariance."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ...errors import InputError, Problem
from ...frames import Frame, GeocentricFrame, TopocentricFrame
from ...network.network import Network
from ...observations import ControlPoint
from ...solve.solution import Solution
from ...types import Array
from ..atomic import write_files

EARTH = 2.0**23
"""Metres, a power of two near the radius of the Earth: differences of this size keep all digits."""
_CODE = re.compile(r"[!-~]{1,4}", re.ASCII)
_AGENCY = re.compile(r"[A-Z0-9]{3}", re.ASCII)


def write_sinex(
    network: Network | Solution, path: str | Path, *, agency: str = "XXX", epoch: float = 2000.0
) -> None:
    """Write coordinates of points with their covariance as SINEX 2.02.

    Of a `Solution` these are the adjusted coordinates of all points that are not held, with the
    covariance of the solution. Of a network these are its observed positions (`ControlPoint` and
    `GnssPosition` of x, y, z), one of each point, with their joint covariance: what `read_sinex`
    returns. Values have 15 significant digits and covariances 14; there is no a-priori block.

    Args:
        network: solution, or network that has only positions observed.
        path: the file.
        agency: three letters for the agency that makes the file.
        epoch: reference epoch of the coordinates, years.

    Raises:
        InputError: the frame is neither geocentric nor topocentric, a code of a station has more
            than four characters, something of the network is not a position. All problems are
            listed, and no file has changed.
    """
    problems: list[Problem] = []
    if not _AGENCY.fullmatch(agency):
        problems.append(Problem(f"agency must be three letters or digits, not {agency!r}"))
    if not 1951.0 <= epoch < 2051.0:
        problems.append(Problem(f"epoch must be a year from 1951 to 2050, not {epoch}"))
    frame = (network.network if isinstance(network, Solution) else network).frame
    if not isinstance(frame, GeocentricFrame | TopocentricFrame):
        what = "SINEX has geocentric coordinates: the frame must be geocentric or topocentric"
        raise InputError([*problems, Problem(what)])
    of = _of_solution if isinstance(network, Solution) else _of_network
    names, xyz, covariance = of(network, problems)  # type: ignore[arg-type]
    for name in names:
        if not _CODE.fullmatch(name):
            what = "code of a station must be one to four characters without blanks"
            problems.append(Problem(what, f"point {name!r}"))
    if problems:
        raise InputError(problems)
    xyz, covariance = _geocentric(frame, xyz, covariance)
    target = Path(path)
    write_files(target.parent, {target.name: _text(names, xyz, covariance, agency, epoch)})


def _of_solution(solution: Solution, problems: list[Problem]) -> tuple[list[str], Array, Array]:
    names = [n for n, p in solution.network.points.items() if not all(p.fixed)]
    partly = [n for n in names if (solution.standard_deviations(n) <= 0).any()]
    for name in partly:
        problems.append(Problem("is held in part: its covariance is singular", f"point {name!r}"))
    if not names:
        problems.append(Problem("has no point that is not held"))
        return [], np.zeros((0, 3)), np.zeros((0, 0))
    xyz = np.array([solution.point(n) for n in names])
    return names, xyz, solution.covariance(names)


def _of_network(network: Network, problems: list[Problem]) -> tuple[list[str], Array, Array]:
    ids, names, at, blocks = [], [], [], []
    for ident, o in network.observations.items():
        where = o.label()
        if not isinstance(o, ControlPoint) or o.axes != "xyz":
            what = f"{o.kind} is not an observed position; write the solution of the network"
            problems.append(Problem(what, where))
        elif o.point in names:
            problems.append(Problem(f"second position of point {o.point!r}", where))
        else:
            ids.append(ident)
            names.append(o.point)
            at.append(o.value)
            blocks.append(np.diag(np.array(o.sigma) ** 2) if o.covariance is None else o.covariance)
    for what, found in (("photos", network.photos), ("image points", network.n_image_points)):
        if found:
            problems.append(Problem(f"SINEX has no {what}"))
    for name, p in network.points.items():
        if name not in names:
            problems.append(Problem("has no observed position", f"point {name!r}"))
        if any(p.fixed) or p.sigma is not None:
            problems.append(Problem("is held or weighted, not observed", f"point {name!r}"))
    if problems:
        return names, np.zeros((0, 3)), np.zeros((0, 0))
    covariance = np.zeros((3 * len(names), 3 * len(names)))
    for i, block in enumerate(blocks):
        covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    for members, joint in network.clusters:
        rows = np.concatenate([3 * ids.index(m) + np.arange(3) for m in members])
        covariance[np.ix_(rows, rows)] = joint
    return names, np.array(at, dtype=float), covariance


def _geocentric(frame: Frame, xyz: Array, covariance: Array) -> tuple[Array, Array]:
    if not isinstance(frame, TopocentricFrame):
        return xyz, covariance
    zero = frame.to_geocentric(np.zeros((1, 3)))
    turn = (frame.to_geocentric(EARTH * np.eye(3)) - zero).T / EARTH
    every = np.kron(np.eye(len(xyz)), turn)
    return frame.to_geocentric(xyz), every @ covariance @ every.T


def _time(year: float) -> str:
    whole = int(year)
    days = 366 if whole % 4 == 0 and (whole % 100 != 0 or whole % 400 == 0) else 365
    seconds = round((year - whole) * days * 86400.0)
    day, second = divmod(min(seconds, days * 86400 - 1), 86400)
    return f"{whole % 100:02d}:{day + 1:03d}:{second:05d}"


def _text(names: list[str], xyz: Array, covariance: Array, agency: str, epoch: float) -> str:
    now, at = datetime.now(UTC), _time(epoch)
    made = f"{now:%y}:{now:%j}:{now.hour * 3600 + now.minute * 60 + now.second:05d}"
    n = 3 * len(names)
    lines = [
        f"%=SNX 2.02 {agency} {made} {agency} {at} {at} C {n:05d} 0 S",
        "*" + "-" * 79,
        "+SITE/ID",
        "*CODE PT __DOMES__ T _STATION DESCRIPTION__ APPROX_LON_ APPROX_LAT_ _APP_H_",
        *(_site(name, x) for name, x in zip(names, xyz, strict=True)),
        "-SITE/ID",
        "+SOLUTION/ESTIMATE",
        "*INDEX TYPE__ CODE PT SOLN _REF_EPOCH__ UNIT S __ESTIMATED VALUE____ _STD_DEV___",
    ]
    for i, name in enumerate(names):
        for k, axis in enumerate("XYZ"):
            row = 3 * i + k
            sigma = float(np.sqrt(covariance[row, row]))
            lines.append(
                f" {row + 1:5d} STA{axis}   {name:<4s}  A    1 {at} m    2 "
                f"{xyz[i, k]:21.14E} {sigma:11.5E}"
            )
    lines += ["-SOLUTION/ESTIMATE", "+SOLUTION/MATRIX_ESTIMATE L COVA"]
    lines.append("*PARA1 PARA2 ____PARA2+0__________ ____PARA2+1__________ ____PARA2+2__________")
    for row in range(n):
        for column in range(0, row + 1, 3):
            part = covariance[row, column : min(column + 3, row + 1)]
            lines.append(f" {row + 1:5d} {column + 1:5d} " + " ".join(f"{v:21.14E}" for v in part))
    lines += ["-SOLUTION/MATRIX_ESTIMATE L COVA", "%ENDSNX"]
    return "\n".join(lines) + "\n"


def _site(name: str, xyz: Array) -> str:
    latitude, longitude, height = (float(v) for v in GeocentricFrame().ellipsoid.to_geodetic(xyz))

    def sexagesimal(angle: float) -> str:
        tenths = round(abs(np.degrees(angle)) * 36000.0)
        sign = -1 if angle < 0 else 1
        degrees, minutes, seconds = tenths // 36000, tenths // 600 % 60, tenths % 600 / 10.0
        whole = f"{sign * degrees:3d}" if degrees or sign > 0 else " -0"
        return f"{whole} {minutes:2d} {seconds:4.1f}"

    east = sexagesimal(longitude % (2 * np.pi))
    return f" {name:<4s}  A           P {name:<22s} {east} {sexagesimal(latitude)} {height:7.1f}"
