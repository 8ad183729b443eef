"""Image points of a photo with each other's names, and two photos with each other's images.

An image point whose name is that of another lies where the other is computed, and the other where
it is. So each of the image points that do not fit is computed under the names of the others in its
photo.

Two photos may have the images of each other, as members of a rig at one moment. An orientation that
is free absorbs an exchange. Where other observations join the photos, as those of a rig, or where
orientations are given, the exchange contradicts them, and rays of all photos that they join are
rejected. So the network is adjusted again from its approximate values with the images of two such
photos exchanged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from ...adjustment import adjust
from ...errors import AdjustmentError, InputError
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...graph.variables import State
from ...network.network import Network
from ...solve.solution import Solution
from ...types import Array, Index, Mask
from ..innovations import Innovations
from .evidence import VarianceFactor
from .mistaken_identity import MistakenIdentity

MIN_MISFITTING_SHARE = 1.0 / 3.0
"""Smallest share of the rays of a photo that do not fit, with which it is tried."""
MAX_PHOTO_PAIRS = 15
"""Largest number of pairs that are tried, those of the photos with the most such rays."""
MAX_RAYS_OF_PHOTO_EXCHANGE = 50_000
"""Largest number of image points of a network in which pairs are tried, each by an adjustment."""
MIN_FIT_AFTER_EXCHANGE = 0.99
"""Smallest share of all rows that fit after the exchange."""
MAX_EXCHANGE_ITERATIONS = 30
"""Largest number of iterations of an adjustment: one of right photos needs fewer."""
MAX_COMPARED_NAMES = 40
"""Largest number of image points of a photo of which names are compared, those off most."""
MAX_EXCHANGED_MISFIT_RATIO = 0.1
"""Largest misfit of two image points under each other's names, relative to that under their own."""
MAX_CLEAN_MISFIT_RATIO = 5.0
"""Largest misfit of an image point under the right name, beside a solution without it, relative to
that which a right one has by chance: photo and point have a σ there, too."""
EXCHANGED_IMAGE_POINTS = "two image points, exchanged:"
"""Cause of two image points of a photo that fit as each other."""


def exchanged_photos(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> Iterator[MistakenIdentity]:
    """Iterate over two photos that fit with the images of each other.

    Args:
        equations: the network with the observations that were rejected.
        clean: the solution without them.
        ids: ids of all that does not fit, rejected or not.
        alpha: probability with which a row that is right does not fit.
        weight: σ0² of the clean solution.
    """
    if not 0 < equations.n_rays <= MAX_RAYS_OF_PHOTO_EXCHANGE:
        return
    network, critical = equations.network, weight.limit(1, alpha)
    suspects = _suspects(equations, set(ids))
    before = float(np.nansum(np.square(Innovations(equations, clean).residuals())))
    best: tuple[float, tuple[str, str]] | None = None
    for a, b in list(combinations(suspects, 2))[:MAX_PHOTO_PAIRS]:
        try:
            solution = adjust(
                _with_exchanged_photos(network, a, b), max_iterations=MAX_EXCHANGE_ITERATIONS
            )
        except AdjustmentError:
            continue
        squares = np.square(solution.equations.residuals(solution.state))
        if solution.converged and np.mean(squares <= critical) >= MIN_FIT_AFTER_EXCHANGE:
            best = min(best or (np.inf, (a, b)), (float(squares.sum()), (a, b)))
    if best is not None:
        after, pair = best
        a, b = sorted(pair)
        rays = ids_of_rays(equations, "pose", (a, b))
        yield MistakenIdentity(
            "the images of two photos, exchanged:", f"{a!r} and {b!r}", rays, before, after
        )


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
    found = [f for f, n in every.items() if f in joined and gone[f] >= MIN_MISFITTING_SHARE * n]
    return sorted(found, key=lambda f: -gone[f] / every[f])


def _with_exchanged_photos(network: Network, a: str, b: str) -> Network:
    """Return the network with the images of two photos exchanged."""
    out = network.copy()
    f, *_ = network.images.columns()
    i, j = (list(network.photos).index(n) for n in (a, b))
    other: Index = np.where(f == i, j, np.where(f == j, i, f))
    out.images = out.images.with_columns(photo=other)
    return out


@dataclass(frozen=True)
class ImagePointExchange:
    """Two image points of a photo that lie where the other is computed."""

    photo: str
    points: tuple[str, str]
    ids: tuple[str, str]
    before: float
    """Sum of the squares of their misfits under their own names, σ0 = 1."""
    after: float
    """The same under each other's names."""

    def __str__(self) -> str:
        """Return both names and the photo."""
        a, b = self.points
        return f"{a!r} and {b!r} in photo {self.photo!r}"


def exchanged_image_points(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> Iterator[MistakenIdentity]:
    """Iterate over image points that were rejected, and fit as each other.

    Args:
        equations: the network with the observations that were rejected.
        clean: the solution without them.
        ids: their ids.
        alpha: probability with which an image point that is right does not fit.
        weight: σ0² of the clean solution.
    """
    state, gone = Innovations(equations, clean).state, set(ids)
    critical = MAX_CLEAN_MISFIT_RATIO**2 * weight.limit(4, alpha)
    for e in image_point_exchanges(equations, state, lambda off: off > 0.0, gone):
        if e.after <= critical:
            yield MistakenIdentity(EXCHANGED_IMAGE_POINTS, str(e), e.ids, e.before, e.after)


def image_point_exchanges(
    equations: Equations,
    state: State,
    wrong: Callable[[Array], Mask],
    among: set[str] | None = None,
) -> Iterator[ImagePointExchange]:
    """Iterate over pairs of image points of a photo that lie where the other is computed.

    Args:
        equations: the equations of all image points.
        state: where photos and points are.
        wrong: returns which image points are compared by their misfits |v/σ|, (n,).
        among: ids of the image points that are compared; None: all.
    """
    names, photos = (equations.unknowns[kind].names for kind in ("point", "pose"))
    for block in blocks_of_images(equations):
        by = dict(block.variables)
        off = image_misfits(equations, block, state)
        chosen = wrong(off)
        if among is not None:
            chosen &= np.array([i in among for i in block.ids], dtype=bool)
        for photo in np.unique(by["pose"][chosen]).tolist():
            own = np.flatnonzero((by["pose"] == photo) & chosen)
            own = own[np.argsort(-off[own], kind="stable")][:MAX_COMPARED_NAMES]
            for (i, j), before, after in _exchanged_rays(equations, block, own, state):
                pairs = sorted((names[by["point"][k]], block.ids[k]) for k in (i, j))
                (a, first), (b, second) = pairs
                yield ImagePointExchange(photos[photo], (a, b), (first, second), before, after)


def blocks_of_images(equations: Equations) -> Iterator[Block]:
    """Iterate over the blocks of image coordinates."""
    return (block for block in equations.blocks if block.lens is not None)


def ids_of_rays(
    equations: Equations, kind: Literal["point", "pose"], names: Iterable[str]
) -> tuple[str, ...]:
    """Return the ids of all rays of some photos, or to some points."""
    numbers = [equations.unknowns[kind].number[n] for n in names]
    return tuple(
        block.ids[int(i)]
        for block in blocks_of_images(equations)
        for i in np.flatnonzero(np.isin(dict(block.variables)[kind], numbers))
    )


def image_misfits(equations: Equations, block: Block, state: State) -> Array:
    """Return |v/σ| of image points in a state, (n,).

    It is 0 where photo or point are not known, and everywhere if one of the points has no image.
    """
    out = np.zeros(block.n)
    finite = [np.isfinite(state[k][at]).any(axis=1) for k, at in block.variables]
    there = np.flatnonzero(np.logical_and.reduce(finite))
    if not len(there):
        return out
    some = block.select(there)
    with suppress(InputError), np.errstate(all="ignore"):
        found = some.evaluate(equations.network.frame, state, jacobians=False).residual
        out[there] = np.nan_to_num(np.linalg.norm(found / some.sigma, axis=1))
    return out


def _exchanged_rays(
    equations: Equations, block: Block, own: Index, state: State
) -> Iterator[tuple[tuple[int, int], float, float]]:
    """Iterate over pairs of rays, the best first, with the squares before and after."""
    n = len(own)
    ray, as_point = (k.ravel() for k in np.meshgrid(own, own, indexing="ij"))
    some = block.select(ray)
    point = dict(block.variables)["point"][as_point]
    variables = tuple((kind, point if kind == "point" else at) for kind, at in some.variables)
    off = image_misfits(equations, replace(some, variables=variables), state).reshape(n, n) ** 2
    before, after = np.add.outer(off.diagonal(), off.diagonal()), off + off.T
    left = set(range(n))
    fits = [
        p
        for p in combinations(range(n), 2)
        if after[p] <= MAX_EXCHANGED_MISFIT_RATIO**2 * before[p]
    ]
    for pair in sorted(fits, key=lambda p: float(after[p] / before[p])):
        if left.issuperset(pair):
            left -= set(pair)
            i, j = (int(own[k]) for k in pair)
            yield (i, j), float(before[pair]), float(after[pair])


def with_exchanged_names(network: Network, exchanged: Iterable[ImagePointExchange]) -> Network:
    """Return the network with the names of pairs of image points exchanged."""
    out = network.copy()
    f, p, *_ = network.images.columns()
    photos, points = list(network.photos), list(network.points)
    p = p.copy()
    for e in exchanged:
        a, b = (points.index(name) for name in e.points)
        mine = f == photos.index(e.photo)
        p[mine] = np.where(p[mine] == a, b, np.where(p[mine] == b, a, p[mine]))
    out.images = out.images.with_columns(point=p)
    return out
