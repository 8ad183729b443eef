"""Summary of a listing of LINZ SNAP, and the same figures of an adjustment here."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import factorgraph_adj as fga
from factorgraph_adj.io.survey.snap import HELD_SIGMA_M
from factorgraph_adj.io.survey.snap_readings import ANGLES
from factorgraph_adj.observations import ControlPoint
from factorgraph_adj.units import ARCSEC

_FIGURES = {
    "observations": "Number of observations",
    "redundancy": "Degrees of freedom",
    "squares": "Sum of squared residuals",
    "unit_weight": "Standard error of unit weight",
}
BESIDE = "beside the network"
"""Point that a network without unknowns gets, with three coordinates that are observed: neither the
redundancy nor the sum of squares changes."""


@dataclass(frozen=True)
class Summary:
    """Figures of an adjustment."""

    observations: int
    """Number of observations."""
    redundancy: int
    """Degrees of freedom."""
    squares: float
    """Sum of squared residuals."""
    unit_weight: float
    """Standard error of unit weight."""


def read_summary(path: Path) -> Summary | None:
    """Return the summary of a listing; None for one without."""
    text = path.read_text(errors="replace")
    found = {n: re.search(rf"{heading}:\s+([\d.]+)", text) for n, heading in _FIGURES.items()}
    if None in found.values():
        return None
    n, r, squares, unit_weight = (float(m[1]) for m in found.values() if m is not None)
    return Summary(int(n), int(r), squares, unit_weight)


_TABLE = re.compile(r"DEFINITION OF PROBLEM\s+=+\n(.*?)(?:={20}|\Z)", re.DOTALL)


def read_stations(path: Path) -> dict[str, tuple[str, str, str]] | None:
    """Return how a listing adjusts stations, by code: F, H, V or 3, errors of floated ones."""
    found = _TABLE.search(path.read_text(errors="replace"))
    if found is None:
        return None
    out = {}
    for line in found[1].partition("have been rejected")[0].splitlines():
        words = line.split()
        if len(words) > 2 and words[1] in ("F", "H", "V", "3"):
            # A row number and a name follow the errors, where there are any.
            errors = words[2:4] if "Error" in found[1] and len(words) > 4 else ["-", "-"]
            out[words[0]] = (words[1], errors[0], errors[1])
    return out


def adjusted_stations(network: fga.Network) -> dict[str, tuple[str, str, str]]:
    """Return how a network adjusts stations, in the form of `read_stations`."""
    held: dict[str, str] = {}
    errors: dict[str, dict[str, str]] = {}
    for o in network.observations.values():
        if is_held(o):
            held[o.point] = o.axes
        elif isinstance(o, ControlPoint) and o.kind == ControlPoint.kind:
            errors.setdefault(o.point, {})[o.axes] = f"{o.sigma[0]:.3f}"
        elif isinstance(o, fga.CoordinateDifference):
            plan, height = (f"{o.sigma[i]:.3f}" for i in (0, -1))
            errors[o.target] = {"en": plan, "u": height}
    out = {}
    for name, p in network.points.items():
        how = "F" if all(p.fixed) else {"en": "V", "u": "H"}.get(held.get(name, ""), "3")
        own = errors.get(name, {})
        out[name] = (how, own.get("en", "-"), own.get("u", "-"))
    return out


KINDS_OF_CLASSES = {
    "SlopeDistance": ("SD", "DR"),
    "MeanHeightDistance": ("HD",),
    "EllipsoidDistance": ("ED", "MD"),
    "Direction": ("HA",),
    "GeodeticAzimuth": ("AZ", "PB"),
    "GyroAzimuth": ("AZ", "PB"),
    "ZenithAngle": ("ZD",),
    "EllipsoidHeightDifference": ("LV",),
    "AstronomicLatitude": ("LT",),
    "AstronomicLongitude": ("LN",),
    "EllipsoidHeight": ("OH", "EH"),
    "GnssVector": ("GB",),
    "GnssPosition": ("GX",),
    "FrameVector": ("GB",),
    "FrameCoordinate": ("GX",),
}
"""Types of SNAP by the name of a class of observations."""
_ROW = re.compile(
    r"^.*?\s(?P<kind>[A-Z]{2})(?P<rejected>\*?)\s+(?:\d+/\d\d/\d{4}\s+)?(?P<file>\S+\.\w+)\s+"
    r"(?P<line>\d+)\s.*?(?P<error>[\d.]+)\s*$",
    re.MULTILINE,
)
"""Row of a table of residuals with the columns of files and lines, and errors at its end."""


@dataclass(frozen=True)
class ListedError:
    """Standard error of a reading as a listing prints it."""

    kinds: tuple[str, ...]
    """Types that it may have."""
    error: float
    """Error in metres or radians; NaN of a vector."""
    half_digit: float = 0.0
    """Half of the last printed digit."""

    def is_that_of(self, other: ListedError) -> bool:
        """Return whether a reading is of the type and has the error, if it is a scalar."""
        if not set(self.kinds) & set(other.kinds):
            return False
        near = abs(self.error - other.error) <= 1.05 * self.half_digit
        return near or other.error != other.error


ListedErrors = dict[tuple[str, int], list[ListedError]]
"""Errors of the readings that take part, by file and line."""


def read_errors(path: Path) -> ListedErrors | None:
    """Return the errors of a listing, or of the table of observations beside it; None: no table."""
    table = path.with_name(f"{path.stem}-obs.csv")
    out: ListedErrors = {}
    if table.is_file():
        with table.open(newline="") as lines:
            for row in csv.DictReader(lines):
                if row["status"] == "use":
                    unit = 3600.0 * ARCSEC if row["obstype"] in ANGLES else 1.0
                    error = float(row["error"] or "nan") * unit
                    half = 0.5 * 10.0 ** -len(row["error"].partition(".")[2]) * unit
                    found = ListedError((row["obstype"],), error, half)
                    key = row["sourcefile"].replace("\\", "/").rpartition("/")[2]
                    out.setdefault((key, int(row["sourcelineno"])), []).append(found)
        return out
    begun = path.read_text(errors="replace").partition("OBSERVATION RESIDUALS")[2]
    for row in _ROW.finditer(begun):
        if row["rejected"]:
            continue
        vector = row["kind"] in ("GB", "GX")
        unit = ARCSEC if row["kind"] in ANGLES else 1.0
        digits = len(row["error"].partition(".")[2])
        error = float("nan") if vector else float(row["error"]) * unit
        found = ListedError((row["kind"],), error, 0.5 * 10.0**-digits * unit)
        out.setdefault((row["file"], int(row["line"])), []).append(found)
    return out or None


def errors_of(network: fga.Network) -> ListedErrors:
    """Return the errors of the readings of a network, in the form of `read_errors`."""
    out: ListedErrors = {}
    for o in network.observations.values():
        kinds = KINDS_OF_CLASSES.get(type(o).__name__)
        if kinds is None or is_held(o):
            continue
        file, _, line = (o.source or "").rpartition(":")
        sigma = getattr(o, "sigma", None)
        error = sigma if isinstance(sigma, float) else float("nan")
        out.setdefault((file, int(line)), []).append(ListedError(kinds, error))
    return out


def same_errors(listed: ListedErrors, found: ListedErrors) -> bool:
    """Return whether both have the same readings with the same errors."""
    return listed.keys() == found.keys() and all(
        len(listed[key]) == len(found[key])
        and all(any(one.is_that_of(other) for other in found[key]) for one in listed[key])
        for key in listed
    )


def is_held(observation: object) -> bool:
    """Return whether an observation holds plan or height of a fixed station, which SNAP has not."""
    sigma = getattr(observation, "sigma", None)
    return isinstance(observation, ControlPoint) and bool(sigma) and sigma[0] == HELD_SIGMA_M


def summary(network: fga.Network) -> Summary:
    """Return the figures of a network, adjusted where it has unknowns."""
    n = sum(len(o.component_names()) for o in network.observations.values() if not is_held(o))
    if all(all(p.fixed) for p in network.points.values()):
        network = network.copy()
        at = next(iter(network.points.values())).coordinates
        network.add_point(BESIDE, at)
        network.add(fga.GnssPosition(BESIDE, tuple(at), sigma=(1.0, 1.0, 1.0)))
    solution = fga.adjust(network)
    r = solution.redundancy
    return Summary(n, r, solution.vtpv, (solution.vtpv / r) ** 0.5 if r else 1.0)
