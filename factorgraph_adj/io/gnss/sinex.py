"""Reader and writer of SINEX: station coordinates at an epoch, covariance without constraints.

A SINEX file is a solution. Its stations become points, and their coordinates observed positions
(`GnssPosition`) with one joint covariance, so that other observations can be added to them. Where
the file states the constraints under which it was made, they are removed again:

    Σ⁻¹ = Σ_estimate⁻¹ − Σ_apriori⁻¹,    Σ⁻¹ x = Σ_estimate⁻¹ x_estimate − Σ_apriori⁻¹ x_apriori

(SINEX 2.02, appendix; both matrices contain the variance factor of the solution).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from ...errors import InputError, Problem, taking
from ...frames import EARTH_SCALE_M, Frame, GeocentricFrame, TopocentricFrame
from ...network.network import Network
from ...observations import ControlPoint, Correlated, GnssPosition
from ...solve.solution import Solution
from ...types import Array, Index
from ..file_transaction import write_files
from ..format_reader import NetworkReader, Reader, begins_with
from ..source import LeftOutReason
from .sinex_blocks import METRES_PER_UNIT, SinexFile, SinexMatrix, SinexParameter

STATION_COORDINATES = ("STAX", "STAY", "STAZ")
STATION_VELOCITIES = ("VELX", "VELY", "VELZ")
MIN_EIGENVALUE_RATIO = 1e-9
"""Smallest ratio of the smallest eigenvalue of a covariance, or of an information matrix, in units
of its diagonal, to the largest one, from which the matrix is positive definite."""
MAX_EPOCH_DIFFERENCE_YEARS = 1.0 / 365.0
"""Largest difference of reference epochs of one set of coordinates, years."""

PARAMETERS_NO_COORDINATE = LeftOutReason("parameters", "coordinates of stations alone are read")
_CODE = re.compile(r"[!-~]{1,4}", re.ASCII)
_AGENCY = re.compile(r"[A-Z0-9]{3}", re.ASCII)


def read_sinex(
    path: str | Path,
    *,
    apriori: Literal["remove", "keep"] = "remove",
    correlations: Literal["full", "none"] = "full",
    epoch: float | None = None,
    ellipsoid: str = "GRS80",
) -> Network:
    """Read the stations of a SINEX file as observed positions with their covariance.

    The frame is geocentric. A station is named by its code; where a code has several points or
    solutions, by code, point and solution: ``ALIC_A_2``. Covariances are those of the file: they
    contain its variance factor. Parameters that are no coordinates of stations (troposphere,
    rotation of the Earth, …) keep their effect on the covariance of the coordinates and leave the
    network. Blocks about sites, receivers and statistics, and comments, are not used; antenna
    heights and eccentricities are applied in the coordinates of such files already.

    Args:
        path: the file.
        apriori: whether the constraints of SOLUTION/APRIORI and SOLUTION/MATRIX_APRIORI are
            removed, where the file has them. The stations then have the coordinates and the
            covariance that the measurements alone give: far less certain, since GNSS places a
            regional network in a global frame by such constraints only. "keep": estimates and
            their covariance, as the file states them.
        correlations: "none": the standard deviations of SOLUTION/ESTIMATE, without correlations,
            for files without matrices.
        epoch: year, such as 2020.0, to which the velocities of the file move the coordinates. None:
            coordinates at the reference epoch of the file.
        ellipsoid: name of the ellipsoid for the normals of the frame.

    Raises:
        InputError: every problem of the file, each with its line: an unknown block, numbers that
            are none, missing coordinates or matrices, matrices that are not positive definite.
    """
    file = SinexFile(path)
    estimate = file.parameters["ESTIMATE"]
    if not estimate:
        file.wrong(0, "has no SOLUTION/ESTIMATE: normal equations without a solution are not read")
    _check_indices(file, estimate)
    file.raise_all()
    value, covariance = _constrained_solution(file, apriori, correlations)
    file.raise_all()
    names, rows = _stations(file, estimate)
    file.raise_all()
    value, covariance = _at_epoch(file, estimate, rows, value, covariance, epoch)
    file.raise_all()
    network = Network(Path(path).stem, frame=GeocentricFrame(ellipsoid))
    used = {int(i) for r in rows for i in (r if epoch is not None else r[:3])}
    for p in estimate.values():
        if p.index - 1 not in used:
            file.leave_out(p.line, PARAMETERS_NO_COORDINATE, p.kind)
    members = []
    for i, name in enumerate(names):
        line = estimate[int(rows[i][0]) + 1].line
        own = slice(3 * i, 3 * i + 3)
        at = tuple(value[own].tolist())
        file.attempt(line, network.add_point, name, at)
        made = file.attempt(
            line, GnssPosition, name, at, covariance=covariance[own, own], source=file.place(line)
        )
        if made is not None:
            members.append(made)
    file.raise_all()
    matrix = file.matrices.get("ESTIMATE")
    line = matrix.line if matrix else 0
    whole = file.attempt(line, Correlated, tuple(members), covariance)
    if whole is not None:
        file.attempt(line, network.add, whole)
    file.problems.finish(network)
    return network


def _check_indices(file: SinexFile, estimate: dict[int, SinexParameter]) -> None:
    n = len(estimate)
    if estimate and max(estimate) != n:
        first = next(i for i in range(1, n + 1) if i not in estimate)
        what = f"SOLUTION/ESTIMATE has no parameter {first}, but parameter {max(estimate)}"
        file.wrong(estimate[max(estimate)].line, what)
    for p in file.parameters["APRIORI"].values():
        other = estimate.get(p.index)
        if other is None or (other.kind, other.site) != (p.kind, p.site):
            file.wrong(p.line, f"a-priori parameter {p.index} is not that of SOLUTION/ESTIMATE")
    for name, matrix in file.matrices.items():
        if matrix.rows and max(max(matrix.rows), max(matrix.columns)) > n:
            what = f"SOLUTION/MATRIX_{name} has elements of parameters beyond the {n} estimated"
            file.wrong(matrix.line, what)
        at = Counter(
            (max(i, j), min(i, j)) for i, j in zip(matrix.rows, matrix.columns, strict=True)
        )
        twice = next((k for k, count in at.items() if count > 1), None)
        if twice is not None:
            file.wrong(matrix.line, f"SOLUTION/MATRIX_{name} has element {twice} twice")


def _constrained_solution(file: SinexFile, apriori: str, correlations: str) -> tuple[Array, Array]:
    """Return values (n,) and covariance (n, n) of all parameters, in the units of the file."""
    estimate = file.parameters["ESTIMATE"]
    n = len(estimate)
    value = np.array([estimate[i].value for i in range(1, n + 1)])
    sigma = np.array([estimate[i].sigma for i in range(1, n + 1)])
    if correlations == "none":
        for i in np.flatnonzero(sigma <= 0) + 1:
            file.wrong(estimate[int(i)].line, "has no standard deviation")
        return value, np.diag(sigma**2)
    matrix = file.matrices.get("ESTIMATE")
    if matrix is None:
        what = "has no SOLUTION/MATRIX_ESTIMATE; correlations='none' reads standard deviations only"
        file.wrong(0, what)
        return value, np.eye(n)
    covariance = _covariance(file, matrix, n, "ESTIMATE")
    for i in np.flatnonzero(np.diag(covariance) <= 0) + 1:
        what = "has no variance: parameters that the solution holds are not read"
        file.wrong(estimate[int(i)].line, what)
    if apriori == "keep" or "APRIORI" not in file.matrices or file.problems.count:
        return value, covariance
    return _without_apriori(file, value, covariance)


def _covariance(file: SinexFile, matrix: SinexMatrix, n: int, name: str) -> Array:
    """Return the covariance (n, n) of a matrix of any kind; unused parameters have zeros."""
    full = matrix.full(n)
    diagonal = np.diag(full).copy()
    used = diagonal != 0
    if not used.any() or (diagonal < 0).any() or np.abs(full[~used]).any():
        file.wrong(matrix.line, f"SOLUTION/MATRIX_{name} needs a diagonal of numbers > 0")
        return np.eye(n)
    part = full[np.ix_(used, used)]
    scale = np.sqrt(np.diag(part))
    if matrix.kind == "CORR":
        part = part.copy()
        scale = np.diag(part).copy()
        np.fill_diagonal(part, 1.0)
    else:
        with np.errstate(all="ignore"):
            part = np.asarray(part / np.outer(scale, scale), dtype=float)
    if not np.isfinite(part).all() or not _is_positive_definite(part):
        what = f"SOLUTION/MATRIX_{name} {matrix.kind} is not positive definite"
        file.wrong(matrix.line, f"{what}: elements are missing, or correlations are beyond ±1")
        return np.eye(n)
    if matrix.kind == "INFO":
        part, scale = np.asarray(np.linalg.inv(part), dtype=float), 1.0 / scale
    out = np.zeros((n, n))
    out[np.ix_(used, used)] = part * np.outer(scale, scale)
    return out


def _is_positive_definite(scaled: Array) -> bool:
    """Return whether a matrix with a diagonal of ones is positive definite."""
    eigenvalues = np.linalg.eigvalsh(scaled)
    return bool(eigenvalues[0] > 1e-13 * eigenvalues[-1])


def _without_apriori(file: SinexFile, value: Array, covariance: Array) -> tuple[Array, Array]:
    """Return values and covariance without the constraints of the file."""
    matrix = file.matrices["APRIORI"]
    constraint = _covariance(file, matrix, len(value), "APRIORI")
    used = np.diag(constraint) > 0
    given = file.parameters["APRIORI"]
    lacking = [int(i) + 1 for i in np.flatnonzero(used) if int(i) + 1 not in given]
    if lacking:
        what = f"SOLUTION/MATRIX_APRIORI has parameter {lacking[0]}, SOLUTION/APRIORI has not"
        file.wrong(matrix.line, what)
    if file.problems.count:
        return value, covariance
    prior = np.zeros_like(constraint)
    prior[np.ix_(used, used)] = np.linalg.inv(constraint[np.ix_(used, used)])
    information = np.linalg.inv(covariance) - prior
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = "; apriori='keep' reads the solution with its constraints"
    if (scale <= 0).any():
        file.wrong(matrix.line, f"the constraints tell more than the solution{shown}")
        return value, covariance
    scaled = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < MIN_EIGENVALUE_RATIO:
        what = "without its constraints the solution does not determine all coordinates"
        file.wrong(matrix.line, f"{what}{shown}")
        return value, covariance
    # The difference from the estimates is small: no digits are lost in the coordinates.
    shift = np.zeros(len(value))
    for i in np.flatnonzero(used):
        shift[i] = value[i] - given[int(i) + 1].value
    free = np.linalg.inv(scaled) / np.outer(scale, scale)
    free = (free + free.T) / 2.0
    return value + free @ (prior @ shift), free


def _stations(
    file: SinexFile, estimate: dict[int, SinexParameter]
) -> tuple[list[str], list[Index]]:
    """Return the names of the stations and the rows (3,) of their coordinates."""
    sites: dict[tuple[str, str, str], dict[str, int]] = {}
    for p in estimate.values():
        if p.kind not in (*STATION_COORDINATES, *STATION_VELOCITIES):
            continue
        if p.unit not in METRES_PER_UNIT:
            file.wrong(p.line, f"the unit of {p.kind} must be m or m/y, not {p.unit!r}")
        found = sites.setdefault(p.site, {})
        if p.kind in found:
            file.wrong(p.line, f"{p.kind} of {' '.join(p.site)} stands in the file twice")
        found[p.kind] = p.index - 1
    sites = {s: found for s, found in sites.items() if any(a in found for a in STATION_COORDINATES)}
    if not sites:
        file.wrong(0, "has no coordinates of stations (STAX, STAY, STAZ)")
    codes = Counter(site[0] for site in sites)
    names, rows = [], []
    for site, found in sites.items():
        missing = [a for a in STATION_COORDINATES if a not in found]
        if missing:
            line = estimate[next(iter(found.values())) + 1].line
            file.wrong(line, f"station {site[0]} has no {', '.join(missing)}")
            continue
        names.append(site[0] if codes[site[0]] == 1 else "_".join(site))
        rows.append(
            np.array([found[a] for a in (*STATION_COORDINATES, *STATION_VELOCITIES) if a in found])
        )
    return names, rows


def _at_epoch(
    file: SinexFile,
    estimate: dict[int, SinexParameter],
    rows: list[Index],
    value: Array,
    covariance: Array,
    epoch: float | None,
) -> tuple[Array, Array]:
    """Return coordinates (3 n,) and their covariance, moved to an epoch by x + v (t − t₀)."""
    epochs = [estimate[int(r[0]) + 1].epoch for r in rows]
    by = np.zeros((3 * len(rows), len(value)))
    for i, r in enumerate(rows):
        line = estimate[int(r[0]) + 1].line
        by[3 * i + np.arange(3), r[:3]] = 1.0
        if epoch is None:
            if (
                not math.isnan(epochs[i])
                and abs(epochs[i] - epochs[0]) > MAX_EPOCH_DIFFERENCE_YEARS
            ):
                what = f"the coordinates are of {epochs[i]:.2f}, those of the first station of"
                file.wrong(line, f"{what} {epochs[0]:.2f}; epoch= moves all to one year")
            continue
        if len(r) != 6 or math.isnan(epochs[i]):
            file.wrong(line, f"has no velocity or no epoch with which it can move to {epoch}")
            continue
        by[3 * i + np.arange(3), r[3:]] = epoch - epochs[i]
    return by @ value, by @ covariance @ by.T


@taking(Network | Solution)
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
    turn = (frame.to_geocentric(EARTH_SCALE_M * np.eye(3)) - zero).T / EARTH_SCALE_M
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


READER = Reader(
    "sinex",
    (".snx",),
    "SINEX",
    NetworkReader(read_sinex),
    recognises=begins_with(rb"\s*%=SNX"),
)
