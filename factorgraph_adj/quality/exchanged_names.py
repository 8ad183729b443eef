"""Exchanged names of targets, looked up before data snooping where an adjustment is far off.

A few exchanged names bend an adjustment until its largest residuals are those of good readings.
What is far off in a robust estimate, or at the approximate values, may be wrong; what is right is
found beside the rest, without it (`causes.exchanged_targets`). Then data snooping begins without
the exchanged sights.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import AdjustmentError
from ..graph.equations import compile_network
from ..network.network import Network
from ..network.selection import without
from ..solve.batch import adjust
from ..solve.solution import Solution
from ..solve.start import Start
from ..types import Array
from .causes.exchanged_targets import Exchange, exchanged_targets
from .causes.hypotheses import SIGHTS
from .causes.separable import FARTHEST
from .distributions import normal_quantile
from .far_off import approximate_values
from .robust import robust_adjust

ENOUGH = 8
"""Number of adjustments of the robust estimate: readings that are far off show long before the
weights of all others have converged."""
PART = 0.01
"""Part of the largest test value from which on readings are suspects at first: what such readings
have bent is less far off, and what else does not fit shows without them."""


def sights_far_off(solution: Solution) -> bool:
    """Return whether several readings of sights are so far off that names may be exchanged.

    σ0 is 1, also where it is estimated: exchanges bend every residual, so that no estimate is one
    of good readings. Where the stated σ are far too small, names are looked up in vain.

    Args:
        solution: the adjustment of everything, or where it ended.
    """
    v = np.nan_to_num(solution.equations.residuals(solution.state))
    far = 0
    for block in solution.equations.blocks:
        if block.kind in SIGHTS:
            far += int(np.sum(np.abs(v[block.rows]) > FARTHEST))
    return far > 1


def _sigma0(normalised: Array, estimated: bool) -> float:
    """Return σ0 of normalised residuals or test values (n,): 1, or that of their median.

    Where half of them are zero, nothing tells of σ0, and it is 1.
    """
    middle = float(np.median(np.abs(normalised))) if estimated and len(normalised) else 0.0
    return middle / normal_quantile(0.75) if middle > 0.0 else 1.0


def exchanged_names(
    network: Network, solution: Solution, alpha: float, *, estimated: bool = False
) -> tuple[Exchange, ...]:
    """Return the exchanges of names that explain why readings are far off, if there are any.

    Args:
        network: the whole network.
        solution: its adjustment, or where it ended.
        alpha: probability with which readings of the right names do not fit.
        estimated: whether σ0 is estimated; otherwise it is 1.
    """
    if solution.datum is not None or network.datum == "free":
        return ()  # there is no robust estimator of free networks
    equations = compile_network(network)  # those of the estimate have other weights
    with suppress(AdjustmentError):
        robust = robust_adjust(
            network, start=approximate_values(solution), from_start=True, max_iterations=ENOUGH
        )
        size = np.abs(np.nan_to_num(robust.test_values))
        limit = max(
            _sigma0(size, estimated) * normal_quantile(1.0 - 0.5 * alpha),
            PART * float(size.max(initial=0.0)),
        )
        bad = {equations.id(int(row)) for row in np.flatnonzero(size > limit)}
        found = exchanged_targets(equations, robust.solution, bad, alpha, estimated=estimated)
        if found:
            return found
    # Several exchanges among few targets bend the estimate, too.
    first = replace(solution, state=solution.start)
    bad = _far_off_at_first(solution)
    return exchanged_targets(equations, first, bad, alpha, estimated=estimated)


def _far_off_at_first(solution: Solution) -> set[str]:
    """Return the readings that are far off at the approximate values, which nothing has bent yet.

    Set-ups without approximate coordinates are joined by what most of their targets agree on, so
    that the others are far off there. Nothing is said of coordinates that are all rough.
    """
    size = np.abs(np.nan_to_num(solution.equations.residuals(solution.start)))
    limit = max(FARTHEST, PART * float(size.max(initial=0.0)))
    return {solution.equations.id(int(row)) for row in np.flatnonzero(size > limit)}


def _with_another(network: Network, ids: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ids without those of targets that nothing else observes, which stay."""
    wrong, rest = set(ids), set[str]()
    for ident, o in network.observations.items():
        if ident not in wrong:
            rest.update(o.points())
    rest.update(ray.point for ray in network.image_points())
    return tuple(i for i in ids if rest.issuperset(network.observations[i].points()))


def start_beside(
    network: Network, found: tuple[Exchange, ...], options: dict[str, Any]
) -> Start | None:
    """Return the start of data snooping without exchanged sights; none: they determine something.

    Args:
        network: the whole network.
        found: the exchanges.
        options: options of the adjustment.
    """
    ids = _with_another(network, tuple(dict.fromkeys(i for e in found for i in e.match.ids)))
    there = network.copy()
    for e in found:
        for name, at in e.points.items():
            there.points[name] = replace(there.points[name], coordinates=tuple(at.tolist()))
    try:
        clean = adjust(without(there, ids), start=found[0].core, **options)
    except AdjustmentError:
        return None
    if not clean.converged:
        return None
    start = replace(Start.of(clean), doubtful=ids)
    whole = compile_network(there).unknowns
    return None if start.carried_to(whole) is None else start
