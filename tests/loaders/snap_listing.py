"""Summary of a listing of LINZ SNAP, and the same figures of an adjustment here."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import factorgraph_adj as fga
from factorgraph_adj.io.survey.snap import HELD_SIGMA_M
from factorgraph_adj.observations import ControlPoint

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
