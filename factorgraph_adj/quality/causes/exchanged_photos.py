"""Two photos with the images of each other, as members of a rig at one moment.

An orientation that is free absorbs an exchange. Where other observations join the photos, as those
of a rig, or where orientations are given, the exchange contradicts them, and rays of all photos
that they join are set aside. So the network is adjusted again from its approximate values with the
images of two such photos exchanged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from ...errors import AdjustmentError
from ...graph.equations import Equations
from ...network.network import Network
from ...solve.batch import adjust
from ...solve.solution import Solution
from ...types import Index
from ..innovations import Innovations
from .evidence import VarianceFactor
from .matches import Match

GONE = 1.0 / 3.0
"""Smallest share of the rays of a photo that do not fit, with which it is tried."""
MOST = 15
"""Largest number of pairs that are tried, those of the photos with the most such rays."""
MOST_RAYS = 50_000
"""Largest number of image points of a network in which pairs are tried, each by an adjustment."""
FIT = 0.99
"""Smallest share of all rows that fit after the exchange."""
MOST_ITERATIONS = 30
"""Largest number of iterations of an adjustment: one of right photos needs fewer."""


def exchanged_photos(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> Iterator[Match]:
    """Iterate over two photos that fit with the images of each other.

    Args:
        equations: the network with the observations that were set aside.
        clean: the solution without them.
        ids: ids of all that does not fit, set aside or not.
        alpha: probability with which a row that is right does not fit.
        weight: σ0² of the clean solution.
    """
    if not 0 < equations.n_rays <= MOST_RAYS:
        return
    network, critical = equations.network, weight.limit(1, alpha)
    suspects = _suspects(equations, set(ids))
    before = float(np.nansum(np.square(Innovations(equations, clean).residuals())))
    best: tuple[float, tuple[str, str]] | None = None
    for a, b in list(combinations(suspects, 2))[:MOST]:
        try:
            solution = adjust(_exchanged(network, a, b), max_iterations=MOST_ITERATIONS)
        except AdjustmentError:
            continue
        squares = np.square(solution.equations.residuals(solution.state))
        if solution.converged and np.mean(squares <= critical) >= FIT:
            best = min(best or (np.inf, (a, b)), (float(squares.sum()), (a, b)))
    if best is not None:
        after, pair = best
        a, b = sorted(pair)
        rays = _rays(equations, {a, b})
        yield Match("the images of two photos, exchanged:", f"{a!r} and {b!r}", rays, before, after)


def _suspects(equations: Equations, bad: set[str]) -> list[str]:
    """Return the photos that something beside rays concerns, with many rays that do not fit.

    Those with the largest share come first.
    """
    network = equations.network
    joined = {p for o in network.observations.values() for p in o.photos()}
    joined |= {n for n, p in network.photos.items() if any(p.fixed)}
    every, gone = Counter[str](), Counter[str]()
    names = equations.unknowns["pose"].names
    for block in equations.blocks:
        if block.lens is not None:
            of = [names[f] for f in dict(block.variables)["pose"].tolist()]
            every.update(of)
            gone.update(f for f, i in zip(of, block.ids, strict=True) if i in bad)
    found = [f for f, n in every.items() if f in joined and gone[f] >= GONE * n]
    return sorted(found, key=lambda f: -gone[f] / every[f])


def _rays(equations: Equations, photos: set[str]) -> tuple[str, ...]:
    """Return the ids of all rays of photos."""
    names = equations.unknowns["pose"].names
    return tuple(
        ident
        for block in equations.blocks
        if block.lens is not None
        for f, ident in zip(dict(block.variables)["pose"].tolist(), block.ids, strict=True)
        if names[f] in photos
    )


def _exchanged(network: Network, a: str, b: str) -> Network:
    """Return the network with the images of two photos exchanged."""
    out = network.copy()
    f, p, xy, sigma = network.images.columns()
    i, j = (list(network.photos).index(n) for n in (a, b))
    other: Index = np.where(f == i, j, np.where(f == j, i, f))
    out.images.photo, out.images.point = [other], [p]
    out.images.xy, out.images.sigma = [xy], [sigma]
    return out
