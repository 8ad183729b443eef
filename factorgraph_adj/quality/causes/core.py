"""What is left of a network without the points of readings that do not fit: its core.

Points of readings that do not fit (the suspects) leave the network, and what is left is adjusted.
Stations, and points that place the network, stay without the sights that do not fit.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ...errors import AdjustmentError
from ...graph.equations import Equations
from ...network.network import Network
from ...network.selection import without
from ...solve.batch import adjust
from ...solve.solution import Solution
from ...types import Mask
from ..reliability import Reliability, reliability
from .evidence import VarianceFactor
from .separable import FARTHEST
from .set_ups import SetUp, Sight

MOST_SUSPECTS = 40
"""Largest number of points that may leave the network: exchanges are few."""
MOST_CORES = 5
"""Largest number of times that points leave the core, since its readings do not fit."""
SHARE = 0.4
"""Part of the largest test value of the core from which on readings leave it together."""


@dataclass(frozen=True, eq=False)
class Core:
    """The adjustment of what does not concern the suspects."""

    solution: Solution
    reliability: Reliability
    suspects: frozenset[int]
    """Points of readings that do not fit, by number in the whole network."""
    weight: VarianceFactor
    """σ0² by which readings beside it are judged."""

    @classmethod
    def of(
        cls,
        equations: Equations,
        solution: Solution,
        bad: Collection[str],
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
        *,
        estimated: bool,
    ) -> Core | None:
        """Return the core; none: it is not determined, or everything is suspect.

        A wrong name may agree better with a point than what places it. So of suspects that place
        the network this alone stays, where the network is determined without their sights.

        Args:
            equations: the whole network.
            solution: an adjustment of it, or of a part, for approximate values.
            bad: ids of the readings that do not fit there.
            sights: the sights of every set-up.
            alpha: probability with which a reading that is right does not fit.
            estimated: whether σ0 is that of the core; otherwise it is 1.
        """
        for placing in (True, False):
            out = cls._of(equations, solution, bad, sights, alpha, estimated, placing=placing)
            if out is not None:
                return out
        return None

    @classmethod
    def _of(
        cls,
        equations: Equations,
        solution: Solution,
        bad: Collection[str],
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
        estimated: bool,
        *,
        placing: bool,
    ) -> Core | None:
        fixing = _placing(equations)
        aside = set(bad)
        out: Core | None = None
        for _ in range(MOST_CORES):
            suspects, ids = _suspects(sights, aside)
            if not suspects or len(suspects) > MOST_SUSPECTS:
                return out
            names = equations.unknowns["point"].names
            leave = [names[p] for p in suspects & may_leave(equations, sights)]
            gone = ids | aside
            if placing:
                alone = suspects & fixing.keys()
                gone |= {
                    i for own in sights.values() for p in alone & own.keys() for i in own[p].ids
                }
                gone -= {i for p in alone for i in fixing[p]}
            try:
                network = without(equations.network, gone, points=leave)
                rel = reliability(_adjusted(network, solution), alpha=alpha)
            except AdjustmentError:
                return out
            core = rel.solution
            if not core.converged:
                return out
            weight = VarianceFactor.left_by(core, estimated=estimated)
            out = cls(core, rel, frozenset(suspects), weight)
            values, critical = (rel.tau, rel.critical_tau) if estimated else (rel.w, rel.critical_w)
            w = np.nan_to_num(np.abs(values))
            if not w.max(initial=0.0) > critical:
                break
            worst = np.flatnonzero(w >= max(critical, SHARE * float(w.max())))
            aside |= {core.equations.id(int(row)) for row in worst}
        return out


def _adjusted(network: Network, start: Solution) -> Solution:
    """Return the adjustment of a part; from its own approximate values, if they lead further down.

    What has bent the whole may have bent the start.
    """
    out = adjust(network, start=start)
    if out.converged and out.vtpv < FARTHEST**2:
        return out
    with suppress(AdjustmentError):
        other = adjust(network)
        if other.converged and not (out.converged and out.vtpv <= other.vtpv):
            return other
    return out


def _suspects(
    sights: Mapping[SetUp, Mapping[int, Sight]], bad: Collection[str]
) -> tuple[set[int], set[str]]:
    """Return the targets of readings that do not fit, and all that was read in these sights."""
    points: set[int] = set()
    ids: set[str] = set()
    for targets in sights.values():
        for target, sight in targets.items():
            if not set(bad).isdisjoint(sight.ids):
                points.add(target)
                ids.update(sight.ids)
    return points, ids


def may_leave(equations: Equations, sights: Mapping[SetUp, Mapping[int, Sight]]) -> set[int]:
    """Return the points without which a network still has its stations and its datum."""
    stations = {s.station for s in sights}
    return (
        set(range(len(equations.unknowns["point"].names))) - stations - _placing(equations).keys()
    )


def _placing(equations: Equations) -> dict[int, set[str]]:
    """Return the points that place the network, with the ids of the observations that do."""
    free: Mask = np.array(equations.unknowns["point"].free.all(axis=1))
    out: dict[int, set[str]] = {p: set() for p in np.flatnonzero(~free).tolist()}
    for block in equations.blocks:
        if block.fixes == "coordinates":
            for kind, index in block.variables:
                if kind == "point":
                    for p, ident in zip(index.tolist(), block.ids, strict=True):
                        out.setdefault(p, set()).add(ident)
    return out


def uncontrolled(
    equations: Equations, core: Core, sights: Mapping[SetUp, Mapping[int, Sight]]
) -> frozenset[int]:
    """Return the targets of the core of whose readings nothing tells."""
    own, number = core.solution.equations, equations.unknowns["point"].number
    controlled: set[int] = set()
    for block in own.blocks:
        rows = core.reliability.controlled[block.rows].reshape(block.n, block.dimension)
        for kind, index in block.variables:
            if kind == "point":
                names = own.unknowns["point"].names
                fine = index[rows.any(axis=1)]
                controlled |= {number[names[p]] for p in np.unique(fine).tolist()}
    targets = {t for own_targets in sights.values() for t in own_targets}
    return frozenset(targets - controlled)
