"""Writer of data files of STAR*NET."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...models.variables import UNKNOWNS
from ...network.entities import Point
from ...network.network import Network
from ...observations import (
    Azimuth,
    Direction,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ..atomic import write_files
from ..numbers import write
from .sigmas import sigmas_of

SEPARATORS = "-:|~+"
"""Characters that may join names, in the order of preference."""
INSTRUMENTS = ("instrument", "index_error", "collimation_error")
"""Attributes of observations that name unknowns of instruments."""
SPECIAL = "#'‘\"&!*?"
"""Characters that mean something else in a line."""
Lines: TypeAlias = "dict[str, list[str]]"


def write_star_net(network: Network, path: str | Path) -> None:
    """Write a data file of STAR*NET (``.dat``), with a standard error in every line.

    Coordinates are metres in the order EN, angles gons, standard errors metres and milligons; the
    file says so (.UNITS, .ORDER, .DELTA, .REFRACTION). Read it in a project of 3D adjustment.
    Points without coordinates have no C line. Standard deviations with ppm or centring are written
    as they are at the coordinates of the network, given or approximate ones that its observations
    determine; an adjusted one is `Solution.as_network`.

    Args:
        network: the network.
        path: the file.

    Raises:
        InputError: everything that the format cannot express, all at once: another frame than a
            local one with axes en or ne and no curvature, a free datum, cameras and photos,
            correlations, kinds of observations other than directions, angles, azimuths, distances,
            zenith angles and height differences, unknowns of instruments, refraction that is not
            held, names with characters of the format. Nothing is written then.
    """
    target = Path(path)
    writer = _Writer(network)
    text = writer.text()
    if writer.problems:
        raise InputError(writer.problems)
    write_files(target.parent, {target.name: text})


class _Writer:
    def __init__(self, network: Network) -> None:
        self.network = network
        self.problems: list[Problem] = []
        self.separator = "-"

    def refuse(self, what: str, where: str = "") -> None:
        self.problems.append(Problem(f"STAR*NET cannot hold {what}", where))

    def text(self) -> str:
        """Return the file; what it cannot hold is noted."""
        network = self.network
        frame = network.frame
        if not isinstance(frame, LocalFrame) or frame.curvature or frame.axes not in ("en", "ne"):
            self.refuse("this frame: it takes a flat local one with axes en or ne", network.name)
        if network.datum == "free":
            self.refuse("a free network: hold or weight coordinates", network.name)
        for many, noun in ((network.cameras, "cameras"), (network.photos, "photos")):
            if many:
                self.refuse(f"{noun} ({len(many)})", network.name)
        if network.clusters:
            self.refuse(f"correlated observations ({len(network.clusters)} clusters)", network.name)
        self._unknowns()
        self._names()
        head = [
            f"# {' '.join(network.name.split())}",
            "# 3D adjustment; metres, gons; standard errors in metres and milligons",
            ".3D",
            ".UNITS Meters GONS",
            ".ORDER EN AtFromTo",
        ]
        if self.separator != "-":
            head.append(f".SEPARATOR {self.separator}")
        body = [line for p in network.points.values() for line in self._point(p)]
        return "\n".join([*head, *body, *self._observations()]) + "\n"

    def _unknowns(self) -> None:
        for kind, table in self.network.parameters.items():
            for key, unknown in table.items():
                where = f"{UNKNOWNS[kind].noun} {key!r}"
                if kind == "refraction":
                    if not unknown.fixed[0]:
                        self.refuse("an unknown coefficient of refraction: hold it", where)
                elif kind != "orientation" or unknown.fixed[0] or math.isfinite(unknown.sigma[0]):
                    self.refuse("a stated unknown of this kind", where)

    def _names(self) -> None:
        names = list(self.network.points)
        for name in names:
            odd = [c for c in name if c in SPECIAL or c.isspace() or not c.isprintable()]
            if odd or name.startswith("."):
                self.refuse(f"a name with {odd[0] if odd else '.'!r}", f"point {name!r}")
        free = [s for s in SEPARATORS if not any(s in n for n in names)]
        if free:
            self.separator = free[0]
        elif names:
            self.refuse(f"names of which some have each of {SEPARATORS}", self.network.name)

    def _point(self, p: Point) -> list[str]:
        if p.datum or p.check is not None:
            self.refuse("datum and check points", f"point {p.name!r}")
        east, north = (0, 1) if getattr(self.network.frame, "axes", "en") == "en" else (1, 0)
        order = (east, north, 2)
        known = [not math.isnan(v) for v in p.coordinates]
        sigma = p.sigma or (math.inf,) * 3

        def error(k: int) -> str:
            if p.fixed[k]:
                return "!"
            return write(sigma[k]) if math.isfinite(sigma[k]) else "*"

        if all(known):
            values = [write(p.coordinates[k]) for k in order]
            return [" ".join(["C", p.name, *values, *(error(k) for k in order)])]
        if known == [True, True, False]:
            values = [write(p.coordinates[k]) for k in order[:2]]
            return [".2D", " ".join(["C", p.name, *values, *(error(k) for k in order[:2])]), ".3D"]
        if known == [False, False, True]:
            return [f"E {p.name} {write(p.coordinates[2])} {error(2)}"]
        if any(known):
            self.refuse("a single horizontal coordinate", f"point {p.name!r}")
        return []

    # -- observations -----------------------------------------------------------------------------

    def _observations(self) -> list[str]:
        sets: Lines = {}
        lines: list[str] = []
        mode, refraction = "", math.nan
        kinds = [o for o in self.network.observations.values() if type(o) in _FORMS]
        for o in self.network.observations.values():
            if type(o) not in _FORMS:
                self.refuse(f"a {o.kind.replace('_', ' ')}", o.label())
            elif any(getattr(o, a, None) for a in INSTRUMENTS):
                self.refuse("unknowns of instruments", o.label())
            elif getattr(o, "face", 1) != 1 and isinstance(o, Direction):
                self.refuse("directions of the second face", o.label())
        if self.problems or not kinds:
            return []
        sigmas = sigmas_of(self.network)
        for ident, o in self.network.observations.items():
            sigma = sigmas[ident]
            if math.isnan(sigma):
                what = "a σ that depends on unknown coordinates: write the adjusted network"
                self.refuse(what, o.label())
                continue
            wanted, words = _FORMS[type(o)](o, self.separator, sigma)
            if isinstance(o, Direction):
                sets.setdefault(f"{o.station}\n{o.set}", []).append(words)
                continue
            if wanted and wanted != mode:
                mode = wanted
                lines.append(f".DELTA {wanted}")
            if isinstance(o, ZenithAngle):
                coefficient = self._coefficient(o)
                if coefficient != refraction:
                    refraction = coefficient
                    lines.append(f".REFRACTION {write(coefficient)}")
            lines.append(words)
        for key, of_set in sets.items():
            lines += [f"DB {key.partition(chr(10))[0]}", *of_set, "DE"]
        return lines

    def _coefficient(self, o: ZenithAngle) -> float:
        """Return STAR*NET's coefficient c of the group: κ = 2 c − 1."""
        group = self.network.refractions.get(o.refraction or "")
        kappa = 0.0 if group is None else group.values[0]
        return (kappa + 1.0) / 2.0


def _ends(o: Observation, separator: str) -> str:
    return f"{o.station}{separator}{o.target}"  # type: ignore[attr-defined]


def _heights(o: Observation) -> str:
    hi, ht = o.instrument_height, o.target_height  # type: ignore[attr-defined]
    return f" {write(hi)}/{write(ht)}" if hi or ht else ""


def _slope(o: SlopeDistance, s: str, sigma: float) -> tuple[str, str]:
    return "OFF", f"D {_ends(o, s)} {write(o.value)} {write(sigma)}{_heights(o)}"


def _horizontal(o: HorizontalDistance, s: str, sigma: float) -> tuple[str, str]:
    return "ON", f"D {_ends(o, s)} {write(o.value)} {write(sigma)}"


def _zenith(o: ZenithAngle, s: str, sigma: float) -> tuple[str, str]:
    value, error = write(o.in_face_one, "gon"), write(sigma, "mgon")
    return "OFF", f"V {_ends(o, s)} {value} {error}{_heights(o)}"


def _difference(o: HeightDifference, s: str, sigma: float) -> tuple[str, str]:
    if o.length_km is not None and not _heights(o):
        length = write(1000.0 * o.length_km)
        return "", f"L {_ends(o, s)} {write(o.value)} {length} {write(sigma)}"
    return "ON", f"V {_ends(o, s)} {write(o.value)} {write(sigma)}{_heights(o)}"


def _azimuth(o: Azimuth, s: str, sigma: float) -> tuple[str, str]:
    return "", f"B {_ends(o, s)} {write(o.value, 'gon')} {write(sigma, 'mgon')}"


def _angle(o: HorizontalAngle, s: str, sigma: float) -> tuple[str, str]:
    names = s.join((o.station, o.target, o.target2))
    return "", f"A {names} {write(o.value, 'gon')} {write(sigma, 'mgon')}"


def _direction(o: Direction, s: str, sigma: float) -> tuple[str, str]:
    return "", f"DN {o.target} {write(o.value, 'gon')} {write(sigma, 'mgon')}"


_FORMS: dict[type, Callable[..., tuple[str, str]]] = {
    SlopeDistance: _slope,
    HorizontalDistance: _horizontal,
    ZenithAngle: _zenith,
    HeightDifference: _difference,
    Azimuth: _azimuth,
    HorizontalAngle: _angle,
    Direction: _direction,
}
"""Mode of .DELTA, where a line has one, and the line of each kind of observation."""
