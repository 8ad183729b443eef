"""Readings that mislead data snooping: exchanged names, a second start, and the likely causes.

A reading that belongs to another point, or was read in the other face, distorts the adjustment of
everything so much that the largest test values are those of good readings, and data snooping
rejects these. At the approximate values such a reading has a very large misfit all the same, and
the good ones do not. The search is therefore made a second time from there, and the simpler of the
two results counts.

A few exchanged names of targets do the same. Readings with very large misfits in a robust estimate,
or at the approximate values, may be wrong; the right names are found by a fit to the rest of the
network (`causes.exchanged_targets`). Then data snooping begins without the exchanged sights.

An adjustment alone, without data snooping, is examined in the same order: exchanged names where
sights have very large misfits, mistakes that distort a block where rows of a block have; then every
cause that has a size is tested, see `causes.cause_search`.
"""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ..adjustment import adjust
from ..errors import AdjustmentError
from ..graph.equations import compile_network
from ..graph.observation_selection import without
from ..network.network import Network
from ..observations import KINDS
from ..observations.base import joined_points
from ..observations.registry import TOTAL_STATION_QUANTITIES
from ..solve.solution import Solution
from ..start.start_values import Start
from ..statistical_tests import global_test, normal_quantile
from ..types import Array
from .causes.block_mistakes import block_mistakes
from .causes.cause_search import Causes, causes, exchanges_as_causes
from .causes.exchanged_targets import TargetExchange, exchanged_targets
from .causes.mistaken_identity import MistakenIdentity
from .causes.readings import Readings
from .causes.separability import MAX_LINEAR_TEST_VALUE
from .rejections import Snooping
from .reliability import Reliability
from .robust_estimation import robust_adjust
from .snooping_search import SnoopingSearch

MAX_ROBUST_ADJUSTMENTS = 8
"""Number of adjustments of the robust estimate: very large errors show long before the weights of
all others have converged."""
MIN_SUSPECT_SHARE = 0.01
"""Share of the largest test value from which readings are suspects at first: readings that such
suspects have distorted have smaller misfits, and other errors show without them."""
SightEnd = tuple[str, int]
"""An end of a sight: the kind of the unknown, and its number."""


def is_misled(search: SnoopingSearch, found: Snooping) -> bool:
    """Return whether readings with very large errors may have misled a search.

    A single reading with a very large error, with which everything else fits, is one gross error.
    Readings that fit under another identity, as a whole, are an exchange. The search is misled if
    readings with very large errors stay, or if several that share a point were rejected. Image
    points do not count: a block of photos has no minimum near poor approximate values.

    Args:
        search: the search, at its end.
        found: its result.
    """
    stays = {u.id for u in found.unresolved if abs(u.test) > MAX_LINEAR_TEST_VALUE}
    gone = {
        r.id
        for r in found.rejected
        if any(abs(c.test) > MAX_LINEAR_TEST_VALUE for c in search.components[r.id])
    }
    if not stays and len(gone) < 2:
        return False
    ends = _ends(search)
    if not stays.isdisjoint(ends):
        return True
    explained = {ident for match in search.matches() for ident in match.ids}
    points = Counter(end for ident in gone - explained if ident in ends for end in ends[ident])
    return any(n > 1 for n in points.values())


def _ends(search: SnoopingSearch) -> dict[str, frozenset[SightEnd]]:
    """Return what readings join, by id: the station and the target, or the frame and the place."""
    equations = search.equations
    r = Readings.of(equations, search.solution.state)
    ids = (equations.id(int(row)) for row in r.row)
    ends = zip(r.station.tolist(), r.target.tolist(), strict=True)
    out: dict[str, frozenset[SightEnd]] = {
        ident: frozenset({("point", a), ("point", b)})
        for ident, (a, b) in zip(ids, ends, strict=True)
    }
    for block in equations.blocks:
        record = KINDS.get(block.kind)
        if block.prior or record is None or record.in_frame == "nothing":
            continue
        (_, frame), (what, place) = block.variables[:2]
        pairs = zip(block.ids, frame.tolist(), place.tolist(), strict=True)
        out |= {i: frozenset({("frame", f), (str(what), p)}) for i, f, p in pairs}
    return out


def start_at_approximate_values(solution: Solution) -> Start:
    """Return the values from which an adjustment began, as the start of another."""
    return Start(solution.equations.unknowns, solution.start, solution.start)


def simpler_result(
    one: SnoopingSearch, a: Snooping, other: SnoopingSearch, b: Snooping
) -> Snooping:
    """Return the result that takes less to explain, the first of two that take as much.

    What takes less is, in this order: fewer observations that do not fit and stay, fewer sights
    with readings rejected, fewer observations rejected.

    Args:
        one: the first search, at its end.
        a: its result.
        other: the second search, at its end.
        b: its result.
    """
    return b if _effort(other, b) < _effort(one, a) else a


def _effort(search: SnoopingSearch, found: Snooping) -> tuple[int, int, int]:
    ends = _ends(search)
    aside = search.ids_aside()
    sights = {ends.get(ident, ident) for ident in aside}
    return len(found.unresolved), len(sights), len(aside)


def has_far_off_sights(solution: Solution) -> bool:
    """Return whether several sights have such large errors that names may be exchanged.

    σ0 is 1, also where it is estimated: exchanges distort every residual, so that no estimate is
    one of good readings. Where the stated σ are far too small, other names are tried in vain.

    Args:
        solution: the adjustment of everything, or where it ended.
    """
    v = np.nan_to_num(solution.equations.residuals(solution.state))
    far = 0
    for block in solution.equations.blocks:
        if block.quantity in TOTAL_STATION_QUANTITIES:
            far += int(np.sum(np.abs(v[block.rows]) > MAX_LINEAR_TEST_VALUE))
    return far > 1


def _sigma0(normalised: Array, estimated: bool) -> float:
    """Return σ0 of normalised residuals or test values (n,): 1, or that of their median.

    Where half of them are zero, they do not determine σ0, and it is 1.
    """
    middle = float(np.median(np.abs(normalised))) if estimated and len(normalised) else 0.0
    return middle / normal_quantile(0.75) if middle > 0.0 else 1.0


def exchanged_names(
    network: Network, solution: Solution, alpha: float, *, estimated: bool = False
) -> tuple[TargetExchange, ...]:
    """Return the exchanges of names that explain readings with very large errors, if there are any.

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
            network,
            start=start_at_approximate_values(solution),
            from_start=True,
            max_iterations=MAX_ROBUST_ADJUSTMENTS,
        )
        size = np.abs(np.nan_to_num(robust.test_values))
        limit = max(
            _sigma0(size, estimated) * normal_quantile(1.0 - 0.5 * alpha),
            MIN_SUSPECT_SHARE * float(size.max(initial=0.0)),
        )
        bad = {equations.id(int(row)) for row in np.flatnonzero(size > limit)}
        found = exchanged_targets(equations, robust.solution, bad, alpha, estimated=estimated)
        if found:
            return found
    # Several exchanges among few targets distort the estimate, too.
    first = replace(solution, state=solution.start)
    bad = _far_off_at_first(solution)
    return exchanged_targets(equations, first, bad, alpha, estimated=estimated)


def _far_off_at_first(solution: Solution) -> set[str]:
    """Return the readings with very large misfits at the approximate values, before any adjustment.

    Set-ups without approximate coordinates are joined by the coordinates on which most of their
    targets agree, so that the others have large misfits. Coordinates that are all rough are not
    examined.
    """
    size = np.abs(np.nan_to_num(solution.equations.residuals(solution.start)))
    limit = max(MAX_LINEAR_TEST_VALUE, MIN_SUSPECT_SHARE * float(size.max(initial=0.0)))
    return {solution.equations.id(int(row)) for row in np.flatnonzero(size > limit)}


def _ids_with_other_observations(network: Network, ids: tuple[str, ...]) -> tuple[str, ...]:
    """Return the ids without those of targets that nothing else observes, which stay."""
    wrong = set(ids)
    rest = joined_points(o for i, o in network.observations.items() if i not in wrong)
    rest.update(ray.point for ray in network.image_points())
    return tuple(i for i in ids if rest.issuperset(network.observations[i].points()))


def start_without_exchanges(
    network: Network, found: tuple[TargetExchange, ...], options: dict[str, Any]
) -> Start | None:
    """Return the start of data snooping without exchanged sights; None: they determine something.

    Args:
        network: the whole network.
        found: the exchanges.
        options: options of the adjustment.
    """
    ids = _ids_with_other_observations(
        network, tuple(dict.fromkeys(i for e in found for i in e.match.ids))
    )
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
    return None if start.for_unknowns(whole) is None else start


def likely_causes(
    solution: Solution, rel: Reliability | None, *, alpha: float, estimated: bool
) -> Causes | None:
    """Return the causes of misfits that several observations share; None where nothing misfits.

    Where σ0 is known, nothing misfits if no test value is critical and the global test is accepted.
    Pope's τ cannot exceed √r: what several observations share may show in none of them, so that
    with an estimated σ0 every cause is tested.

    Args:
        solution: the adjustment, or where it ended.
        rel: its reliability; None: it has none, and only exchanges are examined.
        alpha: probability of a false alarm of one test.
        estimated: whether σ0 is estimated; otherwise it is 1.
    """
    matches = _matches(solution, alpha, estimated)
    if rel is None or not solution.converged:
        return exchanges_as_causes(solution, matches, alpha) if matches else None
    test = global_test(solution)
    fits = test.accepted or test.too_good
    if not estimated and fits and not np.nanmax(np.abs(rel.w), initial=0.0) > rel.critical_w:
        return None
    return causes(rel, matches, estimated=estimated)


def _matches(solution: Solution, alpha: float, estimated: bool) -> list[MistakenIdentity]:
    """Return exchanged names of targets, and mistakes that distort a block."""
    found = [m.match for m in block_mistakes(solution, alpha, estimated=estimated)]
    if has_far_off_sights(solution):
        every = exchanged_names(solution.network, solution, alpha, estimated=estimated)
        found += [e.match for e in every]
    return found
