"""Reader of SINEX: coordinates of GNSS stations with their full covariance.

A SINEX file is a solution. Its stations become points, and their coordinates observed positions
(`GnssPosition`) with one joint covariance, so that other observations can be added to them. Where
the file states the constraints under which it was made, they are removed again:

    Σ⁻¹ = Σ_estimate⁻¹ − Σ_apriori⁻¹,    Σ⁻¹ x = Σ_estimate⁻¹ x_estimate − Σ_apriori⁻¹ x_apriori

(SINEX 2.02, appendix; both matrices contain the variance factor of the solution).
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Literal

import numpy as np

from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import Correlated, GnssPosition
from ...types import Array, Index
from ..left_out import Reason
from .sinex_file import METRES, SinexFile, SinexMatrix, SinexParameter

AXES = ("STAX", "STAY", "STAZ")
VELOCITIES = ("VELX", "VELY", "VELZ")
LEAST_INFORMATION = 1e-9
"""Smallest ratio of the smallest eigenvalue of a covariance, or of an information matrix, in units
of its diagonal, to the largest one, from which the matrix is positive definite."""
SAME_EPOCH = 1.0 / 365.0
"""Largest difference of reference epochs of one set of coordinates, years."""

NO_COORDINATE = Reason("parameters", "coordinates of stations alone are read")


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
        file.add(0, "has no SOLUTION/ESTIMATE: normal equations without a solution are not read")
    _check_indices(file, estimate)
    file.raise_all()
    value, covariance = _solved(file, apriori, correlations)
    file.raise_all()
    names, rows = _stations(file, estimate)
    file.raise_all()
    value, covariance = _at_epoch(file, estimate, rows, value, covariance, epoch)
    file.raise_all()
    network = Network(Path(path).stem, frame=GeocentricFrame(ellipsoid))
    used = {int(i) for r in rows for i in (r if epoch is not None else r[:3])}
    for p in estimate.values():
        if p.index - 1 not in used:
            file.leave_out(p.line, NO_COORDINATE, p.kind)
    network.left_out += file.left.told().values()
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
    file.raise_all()
    return network


def _check_indices(file: SinexFile, estimate: dict[int, SinexParameter]) -> None:
    n = len(estimate)
    if estimate and max(estimate) != n:
        first = next(i for i in range(1, n + 1) if i not in estimate)
        what = f"SOLUTION/ESTIMATE has no parameter {first}, but parameter {max(estimate)}"
        file.add(estimate[max(estimate)].line, what)
    for p in file.parameters["APRIORI"].values():
        other = estimate.get(p.index)
        if other is None or (other.kind, other.site) != (p.kind, p.site):
            file.add(p.line, f"a-priori parameter {p.index} is not that of SOLUTION/ESTIMATE")
    for name, matrix in file.matrices.items():
        if matrix.rows and max(max(matrix.rows), max(matrix.columns)) > n:
            what = f"SOLUTION/MATRIX_{name} has elements of parameters beyond the {n} estimated"
            file.add(matrix.line, what)
        at = Counter(
            (max(i, j), min(i, j)) for i, j in zip(matrix.rows, matrix.columns, strict=True)
        )
        twice = next((k for k, count in at.items() if count > 1), None)
        if twice is not None:
            file.add(matrix.line, f"SOLUTION/MATRIX_{name} has element {twice} twice")


def _solved(file: SinexFile, apriori: str, correlations: str) -> tuple[Array, Array]:
    """Return values (n,) and covariance (n, n) of all parameters, in the units of the file."""
    estimate = file.parameters["ESTIMATE"]
    n = len(estimate)
    value = np.array([estimate[i].value for i in range(1, n + 1)])
    sigma = np.array([estimate[i].sigma for i in range(1, n + 1)])
    if correlations == "none":
        for i in np.flatnonzero(sigma <= 0) + 1:
            file.add(estimate[int(i)].line, "has no standard deviation")
        return value, np.diag(sigma**2)
    matrix = file.matrices.get("ESTIMATE")
    if matrix is None:
        what = "has no SOLUTION/MATRIX_ESTIMATE; correlations='none' reads standard deviations only"
        file.add(0, what)
        return value, np.eye(n)
    covariance = _covariance(file, matrix, n, "ESTIMATE")
    for i in np.flatnonzero(np.diag(covariance) <= 0) + 1:
        what = "has no variance: parameters that the solution holds are not read"
        file.add(estimate[int(i)].line, what)
    if apriori == "keep" or "APRIORI" not in file.matrices or file.problems:
        return value, covariance
    return _without_apriori(file, value, covariance)


def _covariance(file: SinexFile, matrix: SinexMatrix, n: int, name: str) -> Array:
    """Return the covariance (n, n) of a matrix of any kind; unused parameters have zeros."""
    full = matrix.full(n)
    diagonal = np.diag(full).copy()
    used = diagonal != 0
    if not used.any() or (diagonal < 0).any() or np.abs(full[~used]).any():
        file.add(matrix.line, f"SOLUTION/MATRIX_{name} needs a diagonal of numbers > 0")
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
    if not np.isfinite(part).all() or not _definite(part):
        what = f"SOLUTION/MATRIX_{name} {matrix.kind} is not positive definite"
        file.add(matrix.line, f"{what}: elements are missing, or correlations are beyond ±1")
        return np.eye(n)
    if matrix.kind == "INFO":
        part, scale = np.asarray(np.linalg.inv(part), dtype=float), 1.0 / scale
    out = np.zeros((n, n))
    out[np.ix_(used, used)] = part * np.outer(scale, scale)
    return out


def _definite(scaled: Array) -> bool:
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
        file.add(matrix.line, what)
    if file.problems:
        return value, covariance
    prior = np.zeros_like(constraint)
    prior[np.ix_(used, used)] = np.linalg.inv(constraint[np.ix_(used, used)])
    information = np.linalg.inv(covariance) - prior
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = "; apriori='keep' reads the solution with its constraints"
    if (scale <= 0).any():
        file.add(matrix.line, f"the constraints tell more than the solution{shown}")
        return value, covariance
    scaled = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < LEAST_INFORMATION:
        what = "without its constraints the solution does not determine all coordinates"
        file.add(matrix.line, f"{what}{shown}")
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
        if p.kind not in (*AXES, *VELOCITIES):
            continue
        if p.unit not in METRES:
            file.add(p.line, f"the unit of {p.kind} must be m or m/y, not {p.unit!r}")
        found = sites.setdefault(p.site, {})
        if p.kind in found:
            file.add(p.line, f"{p.kind} of {' '.join(p.site)} stands in the file twice")
        found[p.kind] = p.index - 1
    sites = {s: found for s, found in sites.items() if any(a in found for a in AXES)}
    if not sites:
        file.add(0, "has no coordinates of stations (STAX, STAY, STAZ)")
    codes = Counter(site[0] for site in sites)
    names, rows = [], []
    for site, found in sites.items():
        missing = [a for a in AXES if a not in found]
        if missing:
            line = estimate[next(iter(found.values())) + 1].line
            file.add(line, f"station {site[0]} has no {', '.join(missing)}")
            continue
        names.append(site[0] if codes[site[0]] == 1 else "_".join(site))
        rows.append(np.array([found[a] for a in (*AXES, *VELOCITIES) if a in found]))
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
            if not math.isnan(epochs[i]) and abs(epochs[i] - epochs[0]) > SAME_EPOCH:
                what = f"the coordinates are of {epochs[i]:.2f}, those of the first station of"
                file.add(line, f"{what} {epochs[0]:.2f}; epoch= moves all to one year")
            continue
        if len(r) != 6 or math.isnan(epochs[i]):
            file.add(line, f"has no velocity or no epoch with which it can move to {epoch}")
            continue
        by[3 * i + np.arange(3), r[3:]] = epoch - epochs[i]
    return by @ value, by @ covariance @ by.T
