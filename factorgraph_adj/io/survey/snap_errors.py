"""Standard errors of SNAP's readings, and covariances of its GNSS vectors and positions.

Format: LINZ, SNAP help, "Observation errors", "GPS error formats" and "Point coordinate error
formats", and ``snapdata.c``, ``gpscvr.c`` of the program (BSD-3).
"""

from __future__ import annotations

import math

import numpy as np

from ...errors import InputError
from ...stochastic_model import whitening
from ...types import Array
from .snap_coordinates import SnapStations
from .snap_data_commands import ERROR_COMMANDS, ERRORS_OF_KINDS
from .snap_readings import DEFAULT, SnapReading, SnapSet

LARGEST_ANGLE = 2.0
"""Largest error of an angle that a plumbing error makes, radians."""


def _between(reading: SnapReading, stations: SnapStations, *, level: bool) -> float:
    """Return the distance of the stations of a reading, metres, or that at their mean height."""
    a, b = stations.find(reading.station), stations.find(reading.target)
    assert a is not None and b is not None  # the reader looked for them
    d = np.array(b.xyz) - np.array(a.xyz)
    length = float(np.linalg.norm(d))
    return math.sqrt(max(length**2 - (b.height - a.height) ** 2, 0.0)) if level else length


def _plumbing(error: float, distance: float) -> float:
    """Return the angle of a plumbing error."""
    return error / distance if error < LARGEST_ANGLE * distance else LARGEST_ANGLE


def scalar_sigma(reading: SnapReading, found: SnapSet, stations: SnapStations) -> float:
    """Return the standard deviation of a reading, m or rad; NaN after a problem, which is noted."""
    if reading.errors is not None:
        return reading.errors[0] * reading.factor
    code = ERRORS_OF_KINDS[reading.kind]
    stated = reading.defaults.get(code)
    if not stated:
        command = next(c for c, value in ERROR_COMMANDS.items() if value == code)
        found.source.wrong(
            reading.line, f"the error of {reading.kind} is not stated; valid: #{command} before"
        )
        return math.nan
    part = {unit: values[0] for unit, values in stated.items()}
    if code == "ds":
        sigma = math.hypot(part.get("mm", 0.0), part.get("ppm", 0.0) * reading.values[0])
    elif code in ("ha", "az"):
        distance = _between(reading, stations, level=True) if "mm" in part else 1.0
        sigma = math.hypot(part.get("sec", 0.0), _plumbing(part.get("mm", 0.0), distance))
    elif code == "zd":
        distance, z = _between(reading, stations, level=False), reading.values[0]
        level = _plumbing(part.get("mmh", 0.0), distance) * math.cos(z)
        upright = _plumbing(part.get("mmv", 0.0), distance) * math.sin(z)
        sigma = math.sqrt(part.get("sec", 0.0) ** 2 + level**2 + upright**2)
    else:
        sigma = next(iter(part.values()))
    sigma *= reading.factor
    if not sigma > 0:
        found.source.wrong(reading.line, f"the error of {reading.kind} is not greater than zero")
        return math.nan
    return sigma


def _middle_horizon(stations: SnapStations, codes: tuple[str, ...]) -> Array:
    """Return east, north, up as rows (3, 3) where the normals of stations have their mean."""
    up = np.sum([stations.up(code) for code in codes], axis=0)
    up = up / np.linalg.norm(up)
    east = np.array([-up[1], up[0], 0.0]) / math.hypot(up[0], up[1])
    return np.array([east, np.cross(up, east), up])


def _default_block(
    stated: dict[str, tuple[float, ...]], length: float, axes: Array, fixed: str, relative: str
) -> Array:
    """Return a covariance (3, 3), geocentric, of errors in east, north, up."""
    zero = (0.0, 0.0, 0.0)
    variance = np.square(stated.get(fixed, zero)) + np.square(
        length * np.array(stated.get(relative, zero))
    )
    return np.asarray(axes.T @ np.diag(variance) @ axes)


def _default_vectors(readings: tuple[SnapReading, ...], stations: SnapStations) -> Array:
    """Return the covariance of vectors of a group: any two of its stations have the stated errors.

    That of the vectors 1 → 2 and 1 → 3 is (C₁₂ + C₁₃ − C₂₃)/2.
    """
    stated = dict(readings[0].defaults["gb"])
    n = len(readings)
    own = []
    for r in readings:
        axes = _middle_horizon(stations, (r.station, r.target))
        length = float(np.linalg.norm(r.values))
        own.append(_default_block(stated, length, axes, "mm", "ppm"))
    out = np.zeros((3 * n, 3 * n))
    for i, a in enumerate(readings):
        for j, b in enumerate(readings):
            block = own[i]
            if i != j:
                axes = _middle_horizon(stations, (a.target, b.target))
                length = float(np.linalg.norm(np.subtract(a.values, b.values)))
                other = _default_block(stated, length, axes, "mm", "ppm")
                block = 0.5 * (own[i] + own[j] - other)
            out[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
    return out


def _default_positions(readings: tuple[SnapReading, ...], stations: SnapStations) -> Array:
    """Return the covariance of positions: ``mm`` of each, ``mmr`` and ``ppmr`` between two."""
    stated = dict(readings[0].defaults["gx"])
    n = len(readings)
    out = np.zeros((3 * n, 3 * n))
    for i, a in enumerate(readings):
        axes = _middle_horizon(stations, (a.target or a.station,))
        for j, b in enumerate(readings[: i + 1]):
            if i == j:
                block = _default_block(stated, 0.0, axes, "mm", "")
            else:
                length = float(np.linalg.norm(np.subtract(a.values, b.values)))
                block = _default_block(stated, length, axes, "mmr", "ppmr")
            out[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
            out[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = block.T
    return out


def vector_covariance(found: SnapSet, kept: list[int], stations: SnapStations) -> Array | None:
    """Return the covariance of the readings of a set that take part; None after a problem.

    Errors in ``enu`` are those along east, north and up of the middle of the ends.

    Args:
        found: the set.
        kept: places of the readings that take part.
        stations: stations of the job.
    """
    readings = tuple(found.readings[i] for i in kept)
    out = _stated_covariance(found, kept, readings, stations)
    if out is None:
        return None
    factors = np.repeat([r.factor for r in readings], 3)
    out = out * np.outer(factors, factors) + _further_variances(readings, stations)
    try:
        whitening(out)
    except InputError as error:
        found.source.wrong(readings[0].line, f"the covariance of {found.kind}: {error}")
        return None
    return np.asarray(out)


def _further_variances(readings: tuple[SnapReading, ...], stations: SnapStations) -> Array:
    """Return the covariance (3n, 3n) of further errors: of each vector, and of all in common."""
    n = len(readings)
    first = readings[0]
    codes = (first.station,) if first.kind == "GB" else tuple(r.station for r in readings)
    joint = _in_horizon(first.joint_variance, _middle_horizon(stations, codes))
    out = np.asarray(np.kron(np.ones((n, n)), joint))
    for i, r in enumerate(readings):
        axes = _middle_horizon(stations, (r.target or r.station,))
        own = slice(3 * i, 3 * i + 3)
        out[own, own] += _in_horizon(r.own_variance, axes)
    return out


def _in_horizon(variances: tuple[float, float], axes: Array) -> Array:
    """Return the covariance (3, 3), geocentric, of variances of plan and height."""
    plan, height = variances
    return np.asarray(axes.T @ np.diag([plan, plan, height]) @ axes)


def _stated_covariance(
    found: SnapSet, kept: list[int], readings: tuple[SnapReading, ...], stations: SnapStations
) -> Array | None:
    """Return the covariance (3n, 3n) that the file states; None after a problem."""
    kind, first = found.kind, readings[0]
    rows = np.array([3 * i + k for i in kept for k in range(3)])
    matrix = None if found.matrix is None else found.matrix[np.ix_(rows, rows)]
    if found.error_type == DEFAULT:
        code = ERRORS_OF_KINDS[kind]
        if not first.defaults.get(code):
            command = "gps_enu_error" if code == "gb" else "gx_enu_error"
            found.source.wrong(
                first.line, f"the error of {kind} is not stated; valid: #{command} before"
            )
            return None
        made = _default_vectors if kind == "GB" else _default_positions
        return made(readings, stations)
    if found.error_type == "full":
        if matrix is not None:
            return np.asarray(matrix)
        xx, xy, yy, xz, yz, zz = first.errors or (math.nan,) * 6
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    sigmas = np.concatenate([np.array((r.errors or ())[:3]) for r in readings])
    if found.error_type in ("correlation", "enu_correlation"):
        if matrix is None:
            xy, xz, yz = (first.errors or ())[3:]
            matrix = np.array([[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]])
        out = np.asarray(matrix * np.outer(sigmas, sigmas))
    else:
        out = np.diag(np.square(sigmas))
    if found.error_type in ("enu", "enu_correlation"):
        for i, r in enumerate(readings):
            codes = (r.station, r.target) if kind == "GB" else (r.target or r.station,)
            axes = _middle_horizon(stations, codes)
            own = slice(3 * i, 3 * i + 3)
            out[own, own] = axes.T @ out[own, own] @ axes
    return out
