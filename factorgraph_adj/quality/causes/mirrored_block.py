"""Blocks of which every image has other axes: they end as a mirror image of the world.

Where all images are mirrored, photos and points fit one another as a mirror image of the object,
distances too. What does not fit is what tells the sides apart: levelling, control, directions. So
data snooping sets aside most observations of such a kind, and the result is the wrong world; or so
much does not fit that nothing can be set aside.

The network is then adjusted again from its approximate values, with the images of all photos, or of
those of one camera, as they would be with other axes. If more of all rows fit than before, and nine
of ten at least, those set aside among them, the axes are wrong. Attitudes that are given must fit
as well: levelling with the other sign is a mirror image of the world, too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from ...errors import AdjustmentError
from ...graph.blocks import Block
from ...graph.equations import Equations, compile_network
from ...models.image_axes import OTHER, Axes
from ...network.network import Network
from ...solve.batch import adjust
from ...solve.solution import Solution
from ...types import Array, Mask
from ..innovations import Innovations
from ..robust import robust_adjust
from .evidence import VarianceFactor
from .matches import Match
from .photos import FIT, GONE, LEAST, Oriented, fits_attitude, told_apart
from .separable import SAME

MOST_ITERATIONS = 20
"""Largest number of iterations of an adjustment with other axes: with the right ones it is near its
minimum."""
PROMISING = 0.5
"""Smallest share of the rows that fit with which the adjustment is made robust: some observations
may have gross errors besides."""


def mirrored_block(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> Iterator[Match]:
    """Iterate over cameras, or tell of all of them, whose photos all fit with other axes.

    Args:
        equations: the network with the observations that were set aside.
        clean: the solution without them.
        ids: ids of all that does not fit, set aside or not.
        alpha: probability with which a row that is right does not fit.
        weight: σ0² of the clean solution.
    """
    network = equations.network
    if not equations.rays or not _most_of_a_kind(equations, ids):
        return
    critical = weight.limit(1, alpha)
    before = np.square(Innovations(equations, clean).residuals())
    least = max(FIT, float(np.mean(before <= critical)))
    used = {photo.camera for photo in network.photos.values()}
    choices: list[tuple[str, set[str]]] = [("of all photos", used)]
    if len(used) > 1:
        choices += [(f"of all photos of camera {camera!r}", {camera}) for camera in sorted(used)]
    for where, cameras in choices:
        photo = next(name for name, p in network.photos.items() if p.camera in cameras)
        given = network.photos[photo].rotation
        fit = []
        for cause, axes in OTHER:
            found = _with_axes(network, cameras, photo, cause, axes, critical, least)
            if found is not None and fits_attitude(found, given):
                fit.append(found)
        if not fit:
            continue
        best = min(fit, key=lambda o: o.t2)
        same = [o for o in fit if o.t2 < best.t2 + SAME * weight.variance]
        cause = told_apart(same, given)
        rays = tuple(
            ident
            for block in equations.blocks
            if block.lens is not None
            for ident, camera in zip(block.ids, _cameras(equations, block), strict=True)
            if camera in cameras
        )
        yield Match(cause, where, rays, float(np.nansum(before)), best.t2)
        return


def _most_of_a_kind(equations: Equations, ids: Sequence[str]) -> bool:
    """Return whether most observations of a kind, or most rays of a camera, do not fit."""
    bad = set(ids)
    every, gone = Counter[str](), Counter[str]()
    for block in equations.blocks:
        kinds = [block.kind] * block.n if block.lens is None else _cameras(equations, block)
        every.update(kinds)
        gone.update(kind for kind, i in zip(kinds, block.ids, strict=True) if i in bad)
    return any(n >= LEAST and n >= GONE * every[kind] for kind, n in gone.items())


def _cameras(equations: Equations, block: Block) -> list[str]:
    """Return the camera of each ray of a block, (n,)."""
    photos = equations.network.photos
    used = [photos[name].camera for name in equations.unknowns["pose"].names]
    return [used[f] for f in block.variables[0][1].tolist()]


def _squares(equations: Equations, state: dict[str, Array]) -> Array:
    """Return the squares of the whitened residuals, without what the state does not determine."""
    v = equations.residuals(state)
    return np.asarray(np.square(v[np.isfinite(v)]))


def _with_axes(
    network: Network,
    cameras: set[str],
    photo: str,
    cause: str,
    axes: Axes,
    critical: float,
    least: float,
) -> Oriented | None:
    """Return how a network fits with other axes of some cameras; none: it does not.

    Args:
        network: the network.
        cameras: names of the cameras.
        photo: the photo whose orientation is returned.
        cause: what is wrong with the axes.
        axes: what they make of coordinates.
        critical: critical value of the square of a row.
        least: share of the rows that must fit, at least.
    """
    other = _turned(network, cameras, axes)
    equations = compile_network(other)
    try:
        solution = adjust(other, max_iterations=MOST_ITERATIONS)
        squares = _squares(equations, solution.state)
        if PROMISING <= np.mean(squares <= critical) <= least and network.datum != "free":
            solution = robust_adjust(other, start=solution).solution
            squares = _squares(equations, solution.state)  # with the weights that were given
    except AdjustmentError:
        return None
    share = float(np.mean(squares <= critical))
    if not solution.converged or share <= least:
        return None
    if not (solution.state["calibration"][:, 0] > 0.0).all():
        return None  # a negative principal distance stands for the other axis of the image
    pose = solution.state["pose"][equations.unknowns["pose"].number[photo]]
    return Oriented(cause, pose[:9].reshape(3, 3), pose[9:], share, float(np.sum(squares)))


def _turned(network: Network, cameras: set[str], axes: Axes) -> Network:
    """Return the network with other axes of the images of some cameras."""
    out = network.copy()
    f, p, xy, sigma = network.images.columns()
    of_photo = [network.cameras[photo.camera] for photo in network.photos.values()]
    at = np.array([camera.values[1:3] for camera in of_photo])[f]
    mine: Mask = np.array([camera.name in cameras for camera in of_photo])[f]
    turned = np.where(mine[:, None], axes(xy, at), xy)
    out.images.photo, out.images.point = [f], [p]
    out.images.xy, out.images.sigma = [turned], [sigma]
    return out
