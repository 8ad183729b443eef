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
