"""Regression networks of LINZ SNAP: .crd, .dat and the observation equations of its listings.

The listings give for each observation "value" = observed − computed, the negative of v, and
partials of the computed value by local coordinates of the stations. Their headings call these
coordinates north, east, height; the numbers are by east, north, height (a longitude depends
on the first of them, a latitude on the second).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from factorgraph_adj.frames import MEAN_EARTH_RADIUS, GeocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    ControlPoint,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.types import Array

FRAME = GeocentricFrame("International1924")
"""NZGD1949."""
RATIO = "ratio"
"""Distance meter whose scale is the unknown of distance ratios."""
NO_COUNTERPART = {
    "PB": "projection bearing: needs a map projection",
    "ED": "distance along the ellipsoid",
    "MD": "distance along the geoid",
}
"""Types of SNAP whose rows are not compared."""


def dms(degrees: str, minutes: str, seconds: str, hemisphere: str = "N") -> float:
    """Return radians."""
    angle = float(degrees) + float(minutes) / 60.0 + float(seconds) / 3600.0
    return float(np.radians(-angle if hemisphere in "SW" else angle))


def cartesian(latitude: float, longitude: float, height: float) -> Array:
    at = (np.array([v]) for v in (latitude, longitude, height))
    return np.asarray(FRAME.ellipsoid.to_cartesian(*at)[0])


def read_stations(path: Path) -> dict[str, Array]:
    """Return geocentric coordinates by code, of a .crd file with ellipsoidal heights."""
    stations = {}
    for line in path.read_text().splitlines():
        part = line.split()
        if len(part) > 9 and part[4] in "NS" and part[8] in "EW":
            stations[part[0]] = cartesian(dms(*part[1:5]), dms(*part[5:9]), float(part[9]))
    return stations


@dataclass(frozen=True)
class Row:
    """One observation as SNAP lists it."""

    ident: str
    """Number of the observation."""
    kind: str
    """SNAP's type: HA, AZ, SD …"""
    group: str
    """Number of its set: directions of one set share it."""
    observation: Observation | None
    """The observation here; none where there is no counterpart."""
    residual: Array
    """Observed − computed of each component."""
    by_station: dict[str, Array]
    """Partials of the computed components by east, north, height, (d, 3)."""
    by_implicit: float | None
    """Partial by the orientation of the set, or the scale (ppm) of distance ratios."""


def read_rows(folder: Path, stations: dict[str, Array]) -> list[Row]:
    """Return the observations of a listing with their equations at the start coordinates."""
    groups = json.loads((folder / "observations.json").read_text())
    listed = json.loads((folder / "obs_equation_1.json").read_text())
    named = [p.split(":")[0] for p in listed.get("parameters", [])]
    equations = {e["source"]["obsid"]: e for e in listed["obs_equations"]}
    rows = []
    for number, group in enumerate(groups):
        equation = equations[group["obs"][0]["obsid"]]
        first = 0
        for entry in group["obs"]:
            size = len(entry["value"])
            lines = equation["obs"][first : first + size]
            first += size
            by_station: dict[str, Array] = {}
            for i, line in enumerate(lines):
                for column, value in zip(line["columns"], line["values"], strict=True):
                    partials = by_station.setdefault(named[column - 1], np.zeros((size, 3)))
                    partials[i, (column - 1) % 3] = value
            make = _MAKE.get(entry["type"])
            rows.append(
                Row(
                    str(entry["obsid"]),
                    entry["type"],
                    str(number),
                    None if make is None else make(entry, str(number), stations),
                    np.array([line["value"] for line in lines]),
                    by_station,
                    lines[0].get("schreiber"),
                )
            )
    return rows


_ANY_SIGMA = 0.01
"""Standard deviations play no part in a row of the design matrix."""


def _sight(entry: dict, kind: Callable[..., Observation], angle: bool, **more: str) -> Observation:
    value = entry["value"][0]
    return kind(
        entry["from"],
        entry["to"],
        float(np.radians(value)) if angle else value,
        sigma=_ANY_SIGMA,
        instrument_height=entry["from_hgt"],
        target_height=entry["to_hgt"],
        id=str(entry["obsid"]),
        **more,
    )


def _height(entry: dict, stations: dict[str, Array]) -> Observation:
    """Height above the ellipsoid, less that of the instrument."""
    latitude, longitude, _ = FRAME.ellipsoid.to_geodetic(stations[entry["from"]])
    at = cartesian(latitude, longitude, entry["value"][0] - entry["from_hgt"])
    ident = str(entry["obsid"])
    return ControlPoint(entry["from"], tuple(at), axes="u", sigma=(_ANY_SIGMA,), id=ident)


def _astronomic(entry: dict, kind: type[AstronomicLatitude]) -> Observation:
    value = float(np.radians(entry["value"][0]))
    return kind(entry["from"], value, sigma=_ANY_SIGMA, id=str(entry["obsid"]))


_THREE = (_ANY_SIGMA,) * 3
_MAKE: dict[str, Callable[[dict, str, dict[str, Array]], Observation]] = {
    "HA": lambda e, group, s: _sight(e, Direction, True, set=group),
    "AZ": lambda e, group, s: _sight(e, Azimuth, True),
    "ZD": lambda e, group, s: _sight(e, ZenithAngle, True),
    "SD": lambda e, group, s: _sight(e, SlopeDistance, False),
    "DR": lambda e, group, s: _sight(e, SlopeDistance, False, instrument=RATIO),
    "HD": lambda e, group, s: _sight(e, HorizontalDistance, False),
    "LV": lambda e, group, s: _sight(e, HeightDifference, False),
    "LT": lambda e, group, s: _astronomic(e, AstronomicLatitude),
    "LN": lambda e, group, s: _astronomic(e, AstronomicLongitude),
    "EH": lambda e, group, s: _height(e, s),
    "OH": lambda e, group, s: _height(e, s),
    "GB": lambda e, group, s: GnssVector(
        e["from"], e["to"], tuple(e["value"]), sigma=_THREE, id=str(e["obsid"])
    ),
    "GX": lambda e, group, s: GnssPosition(
        e["from"], tuple(e["value"]), sigma=_THREE, id=str(e["obsid"])
    ),
}


def network_of(stations: dict[str, Array], rows: list[Row]) -> Network:
    """Return a network of the rows with everything free, deflections of the vertical too."""
    network = Network("snap", frame=FRAME)
    for name, at in stations.items():
        network.add_point(name, at)
        network.set_vertical(name)
    network.set_distance_meter(RATIO, free=["scale"])
    network.add(*(row.observation for row in rows if row.observation is not None))
    return network


def read_zenith_angles(folder: Path, *, radius: float = MEAN_EARTH_RADIUS) -> Network:
    """Return the zenith angles of ``testrc``: horizontal position held, three refractions.

    SNAP's coefficient k is Bomford's: the ray is refracted by k S/R, so κ = 2 k.
    """
    network = Network("testrc", frame=GeocentricFrame("International1924", radius=radius))
    fixed = ("1", "11")
    for name, at in read_stations(folder / "testrc.crd").items():
        network.add_point(name, at, fixed="xyz" if name in fixed else "")
        if name not in fixed:
            network.add(ControlPoint(name, tuple(at), axes="en", sigma=(1e-4, 1e-4)))
    network.set_refraction("DEFAULT", value=2 * 0.075, fixed=True)
    network.set_refraction("TEST", value=0.0)
    network.set_refraction("zero", value=0.0, fixed=True)
    group = "DEFAULT"
    for line in (folder / "testrc.dat").read_text().splitlines():
        part = line.split()
        if line.startswith("#refraction_coefficient"):
            group = part[1]
        elif len(part) == 6 and part[0].isdigit():
            sigma = dms("0", "0", part[5])
            angle = dms(*part[2:5])
            network.add(ZenithAngle(part[0], part[1], angle, sigma=sigma, refraction=group))
    return network


@dataclass(frozen=True)
class ListedResidual:
    """A line of the table of residuals; lengths in metres, angles in seconds of arc."""

    kind: str
    """SNAP's type."""
    stations: tuple[str, str]
    """From, to."""
    sigma: float
    """Of the observation."""
    sigma_adjusted: float
    """Of its adjusted value."""
    residual: float
    """Observed − computed."""
    sigma_residual: float
    """Of the residual."""
    standardised: float | None
    """|residual| / its σ; none where the observation is not controlled."""
    weak: bool
    """Whether it is flagged (@) for a redundancy below 0.10."""


def read_residuals(path: Path) -> list[ListedResidual]:
    """Return the table of residuals of ``testrc.lst``: zenith angles, distances, bearings."""
    table = path.read_text().split("OBSERVATION RESIDUALS")[1].split("ERROR SUMMARY")[0]
    out = []
    for line in table.splitlines():
        part = line.split()
        if len(part) < 9 or part[2] not in ("ZD", "ED", "PB"):
            continue
        width = 1 if part[2] == "ED" else 3
        sigma = float(part[3 + width])
        adjusted, residual, of_residual, size = part[4 + 2 * width : 8 + 2 * width]
        out.append(
            ListedResidual(
                part[2],
                (part[0], part[1]),
                sigma,
                float(adjusted),
                float(residual),
                float(of_residual),
                None if size == "-" else float(size),
                part[-1] == "@",
            )
        )
    return out


def radius_in_azimuth(network: Network) -> float:
    """Return Euler's radius of curvature in the azimuth of the sights, weighted by S²."""
    total = weights = 0.0
    for observation in network.observations.values():
        if getattr(observation, "refraction", None) != "TEST":
            continue
        a, b = (np.array(network.points[n].coordinates) for n in observation.names())
        east, north, _ = FRAME.basis(a[None], np.zeros((1, 2))).enu[0] @ (b - a)
        latitude, _, height = FRAME.ellipsoid.to_geodetic(a)
        m, n = FRAME.ellipsoid.radii(np.asarray(latitude))
        s2 = east**2 + north**2
        curvature = (north**2 / (m + height) + east**2 / (n + height)) / s2
        total, weights = total + s2 / curvature, weights + s2
    return float(total / weights)
