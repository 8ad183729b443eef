"""Two image points of a photo with each other's names.

An image point whose name is that of another lies where the other is computed, and the other where
it is. So each of the image points that do not fit is computed under the names of the others in its
photo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...errors import InputError
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...graph.variables import State
from ...network.network import Network
from ...solve.solution import Solution
from ...types import Array, Index, Mask
from ..innovations import Innovations
from .evidence import VarianceFactor
from .matches import Match

MOST_NAMES = 40
"""Largest number of image points of a photo of which names are compared, those off most."""
OTHER = 0.1
"""Largest misfit of two image points under each other's names, relative to that under their own."""
BESIDE = 5.0
"""Largest misfit of an image point under the right name, beside a solution without it, relative to
that which a right one has by chance: photo and point have a σ there, too."""
IMAGE_NAMES = "two image points, exchanged:"
"""Cause of two image points of a photo that fit as each other."""


@dataclass(frozen=True)
class ExchangedInPhoto:
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
) -> Iterator[Match]:
    """Iterate over image points that were set aside, and fit as each other.

    Args:
        equations: the network with the observations that were set aside.
        clean: the solution without them.
        ids: their ids.
        alpha: probability with which an image point that is right does not fit.
        weight: σ0² of the clean solution.
    """
    state, gone = Innovations(equations, clean).state, set(ids)
    critical = BESIDE**2 * weight.limit(4, alpha)
    for e in exchanged_in_photos(equations, state, lambda off: off > 0.0, gone):
        if e.after <= critical:
            yield Match(IMAGE_NAMES, str(e), e.ids, e.before, e.after)


def exchanged_in_photos(
    equations: Equations,
    state: State,
    wrong: Callable[[Array], Mask],
    among: set[str] | None = None,
) -> Iterator[ExchangedInPhoto]:
    """Iterate over pairs of image points of a photo that lie where the other is computed.

    Args:
        equations: the equations of all image points.
        state: where photos and points are.
        wrong: returns which image points are compared by their misfits |v/σ|, (n,).
        among: ids of the image points that are compared; none: all.
    """
    names, photos = (equations.unknowns[kind].names for kind in ("point", "pose"))
    for block in image_blocks(equations):
        by = dict(block.variables)
        off = misfits(equations, block, state)
        chosen = wrong(off)
        if among is not None:
            chosen &= np.array([i in among for i in block.ids], dtype=bool)
        for photo in np.unique(by["pose"][chosen]).tolist():
            own = np.flatnonzero((by["pose"] == photo) & chosen)
            own = own[np.argsort(-off[own], kind="stable")][:MOST_NAMES]
            for (i, j), before, after in _as_each_other(equations, block, own, state):
                pairs = sorted((names[by["point"][k]], block.ids[k]) for k in (i, j))
                (a, first), (b, second) = pairs
                yield ExchangedInPhoto(photos[photo], (a, b), (first, second), before, after)


def image_blocks(equations: Equations) -> Iterator[Block]:
    """Iterate over the blocks of image coordinates."""
    return (block for block in equations.blocks if block.lens is not None)


def misfits(equations: Equations, block: Block, state: State) -> Array:
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


def _as_each_other(
    equations: Equations, block: Block, own: Index, state: State
) -> Iterator[tuple[tuple[int, int], float, float]]:
    """Iterate over pairs of rays, the best first, with the squares before and after."""
    n = len(own)
    ray, as_point = (k.ravel() for k in np.meshgrid(own, own, indexing="ij"))
    some = block.select(ray)
    point = dict(block.variables)["point"][as_point]
    variables = tuple((kind, point if kind == "point" else at) for kind, at in some.variables)
    off = misfits(equations, replace(some, variables=variables), state).reshape(n, n) ** 2
    before, after = np.add.outer(off.diagonal(), off.diagonal()), off + off.T
    left = set(range(n))
    fits = [p for p in combinations(range(n), 2) if after[p] <= OTHER**2 * before[p]]
    for pair in sorted(fits, key=lambda p: float(after[p] / before[p])):
        if left.issuperset(pair):
            left -= set(pair)
            i, j = (int(own[k]) for k in pair)
            yield (i, j), float(before[pair]), float(after[pair])


def with_exchanged(network: Network, exchanged: Iterable[ExchangedInPhoto]) -> Network:
    """Return the network with the names of pairs of image points exchanged."""
    out = network.copy()
    f, p, xy, sigma = network.images.columns()
    photos, points = list(network.photos), list(network.points)
    p = p.copy()
    for e in exchanged:
        a, b = (points.index(name) for name in e.points)
        mine = f == photos.index(e.photo)
        p[mine] = np.where(p[mine] == a, b, np.where(p[mine] == b, a, p[mine]))
    out.images.photo, out.images.point = [f], [p]
    out.images.xy, out.images.sigma = [xy], [sigma]
    return out
