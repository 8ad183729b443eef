"""Photos, and all photos of a camera or block, whose image coordinates fit with other axes.

With x and y exchanged, or one of them the wrong way, an image is a mirror image, and no exterior
orientation makes it fit. So most rays of the photo are rejected. Its points are known from the
other photos: the photo is oriented again, by resection, from the coordinates as they are and as
they would be with other axes, and the ray of each point is compared with the point and its σ.

All these axes mirror the image, and differ by a turn about the optical axis, which the orientation
absorbs. The principal point and the attitude from which the adjustment began decide between them;
without either, they are named together.

Where all images are mirrored, photos and points fit one another as a mirror image of the object,
distances too. What does not fit is what distinguishes the sides: levelling, control, directions. So
data snooping rejects most observations of such a kind, and the result is the wrong world; or so
much does not fit that nothing can be rejected. The network is then adjusted again from its
approximate values, with the images of all photos, or of those of one camera, as they would be with
other axes. If more of all rows fit than before, and nine of ten at least, the rejected ones among
them, the axes are wrong. Attitudes that are given must fit as well: levelling with the other sign
is a mirror image of the world, too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ...adjustment import adjust
from ...errors import AdjustmentError
from ...graph.blocks import Block
from ...graph.equations import Equations, compile_network
from ...graph.observation_selection import without
from ...models.image import MIRRORED, OTHER, Axes
from ...models.inverse_lens import directions
from ...network.network import DatumChoice, Network
from ...observations.base import joined_points
from ...solve.solution import Solution
from ...start.resection import resect
from ...types import Array, Index, Mask
from ..innovations import Innovations
from ..robust_estimation import robust_adjust
from .evidence import VarianceFactor
from .mistaken_identity import MistakenIdentity
from .separability import MIN_T2_DIFFERENCE

MAX_TESTED_PHOTOS = 20
"""Largest number of photos that are tested, those with the most rays rejected."""
MIN_RAYS_OF_PHOTO = 6
"""Smallest number of rays to known points from which a photo is oriented again."""
MIN_REJECTED_SHARE = 0.5
"""Smallest share of its rays rejected with which a photo is tested."""
MIN_FITTING_RAY_SHARE = 0.9
"""Smallest share of its rays that fit with the right axes; the others may be gross errors."""
MAX_ATTITUDE_DIFFERENCE_RAD = np.pi / 4
"""Largest angle between two attitudes that a turn of the axes by a right angle does not explain."""
MAX_AXES_ITERATIONS = 20
"""Largest number of iterations of an adjustment with other axes: with the right ones it is near its
minimum."""
MIN_PROMISING_SHARE = 0.5
"""Smallest share of the rows that fit with which the adjustment is made robust: some observations
may have gross errors besides."""


@dataclass(frozen=True)
class _Rays:
    """Rays of one photo to points that the clean solution knows."""

    photo: str
    """Name of the photo."""
    block: Block
    """Its image coordinates, (n, 2)."""
    ids: tuple[str, ...]
    """Ids of the rays."""
    points: tuple[str, ...]
    """Names of the points."""
    camera: str
    """Name of the camera."""
    calibration: Array
    """Calibration, (k,)."""
    lost: float
    """Share of its rays rejected."""


@dataclass(frozen=True)
class OrientedPhoto:
    """A photo oriented from some image coordinates."""

    cause: str
    """What would be wrong; empty: nothing."""
    rotation: Array
    """world_R_camera, (3, 3)."""
    position: Array
    """Projection centre, (3,) metres."""
    share: float
    """Share of the rays that fit."""
    t2: float
    """Square sum of the residuals of points and rays."""


def photos_with_other_axes(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> Iterator[MistakenIdentity]:
    """Iterate over photos that fit with other axes.

    Args:
        equations: the network with the observations that were rejected.
        clean: the solution without them.
        ids: their ids.
        alpha: probability with which a ray that is right does not fit.
        weight: σ0² of the clean solution.
    """
    critical = weight.limit(2, alpha)
    suspect = _suspect(equations, clean, ids)
    if suspect:
        clean = _without(equations, clean, suspect, ids)
        suspect = _suspect(equations, clean, ids)
    for rays in suspect:
        as_is = _oriented(clean, rays, "", rays.block.observed, critical)
        if as_is is not None and as_is.share >= MIN_FITTING_RAY_SHARE:
            continue  # only the orientation was wrong
        at = rays.calibration[1:3]
        tried = [
            _oriented(clean, rays, cause, axes(rays.block.observed, at), critical)
            for cause, axes in OTHER
        ]
        fit = [o for o in tried if o is not None and o.share >= MIN_FITTING_RAY_SHARE]
        if not fit:
            continue
        best = min(fit, key=lambda o: o.t2)
        same = [o for o in fit if o.t2 < best.t2 + MIN_T2_DIFFERENCE * weight.variance]
        cause = axes_by_attitude(same, equations.network.photos[rays.photo].rotation)
        where = f"of photo {rays.photo!r}"
        yield MistakenIdentity(
            cause, where, rays.ids, _misfit(equations, clean, rays, best), best.t2
        )


def axes_by_attitude(same: Sequence[OrientedPhoto], given: Array | None) -> str:
    """Return which of several axes that fit it is: those with the attitude that was given."""
    if len({o.cause for o in same}) > 1:
        same = [o for o in same if fits_attitude(o, given)] or same
    causes = {o.cause for o in same}
    return causes.pop() if len(causes) == 1 else MIRRORED


def fits_attitude(found: OrientedPhoto, given: Array | None) -> bool:
    """Return whether an orientation has the attitude that was given, or none was given."""
    if given is None or not np.isfinite(given).all():
        return True
    return _angle(found.rotation, given) < MAX_ATTITUDE_DIFFERENCE_RAD


def _angle(a: Array, b: Array) -> float:
    """Return the angle of the rotation from one attitude to another, radians."""
    return float(np.arccos(np.clip(0.5 * (np.trace(a.T @ b) - 1.0), -1.0, 1.0)))


def _without(
    equations: Equations, clean: Solution, suspect: Sequence[_Rays], ids: Sequence[str]
) -> Solution:
    """Return the solution without any ray of some photos; the clean one where there is none.

    Rays of a mirrored photo that fit by chance have stayed in, and bend the points that they touch,
    so that good rays were rejected. Those come back; points that the other photos do not determine
    are left out, and so is what else was observed of these photos.
    """
    unknowns = equations.unknowns
    photos = np.array([unknowns["pose"].number[rays.photo] for rays in suspect])
    aside, n = _aside(equations, ids), len(unknowns["point"].names)
    bent, counted = np.zeros(n, dtype=bool), np.zeros(n)
    gone: list[str] = []
    for block, lost in _images(equations, aside):
        by = dict(block.variables)
        bent[by["point"][~lost & np.isin(by["pose"], photos)]] = True
    for block, lost in _images(equations, aside):
        by = dict(block.variables)
        own = np.isin(by["pose"], photos)
        leave = own | (lost & ~bent[by["point"]])
        counted += np.bincount(by["point"][~leave], minlength=n)
        gone += [block.ids[int(i)] for i in np.flatnonzero(leave)]
    images = {
        block.ids[int(i)] for block, lost in _images(equations, aside) for i in lost.nonzero()[0]
    }
    gone += [i for i in ids if i not in images]
    observed = equations.network.observations
    left = {rays.photo for rays in suspect}
    gone += [i for i, o in observed.items() if not left.isdisjoint(o.photos())]
    lost_ids = set(gone)
    others = joined_points(o for i, o in observed.items() if i not in lost_ids)
    free: list[bool] = np.all(unknowns["point"].free, axis=1).tolist()
    few = [p for p, k, f in zip(unknowns["point"].names, counted, free, strict=True) if f and k < 2]
    few = [p for p in few if p not in others]
    datum: DatumChoice = "given" if clean.datum is None else "free"
    network = without(equations.network, list(dict.fromkeys(gone)), points=few)
    for rays in suspect:  # without a ray, a photo that is not held is not determined
        network.photos[rays.photo] = replace(
            network.photos[rays.photo],
            position=(0.0, 0.0, 0.0),
            rotation=np.eye(3),
            fixed=(True,) * 6,
            sigma_position=None,
            sigma_attitude=None,
        )
    with suppress(AdjustmentError):
        found = adjust(network, datum=datum, start=clean)
        if found.converged:
            return found
    return clean


def _aside(equations: Equations, ids: Sequence[str]) -> Mask:
    """Return which rows belong to observations, (n_rows,)."""
    out = np.zeros(equations.n_rows, dtype=bool)
    out[np.concatenate([np.zeros(0, dtype=np.intp), *equations.find(ids)])] = True
    return out


def _images(equations: Equations, rows: Mask) -> Iterator[tuple[Block, Mask]]:
    """Iterate over blocks of image coordinates, and which of their rays some rows belong to."""
    for block in equations.blocks:
        if block.lens is not None:
            yield block, rows[block.rows][:: block.dimension]


def _suspect(equations: Equations, clean: Solution, ids: Sequence[str]) -> list[_Rays]:
    """Return the photos of which most rays were rejected, those that lost most first."""
    state = Innovations(equations, clean).state
    known = np.all(np.isfinite(state["point"]), axis=1)
    every: list[_Rays] = []
    for block, gone in _images(equations, _aside(equations, ids)):
        by = dict(block.variables)
        n = len(equations.unknowns["pose"].names)
        share = np.bincount(by["pose"], gone, n) / np.maximum(np.bincount(by["pose"], None, n), 1)
        for photo in np.flatnonzero(share >= MIN_REJECTED_SHARE).tolist():
            own = np.flatnonzero((by["pose"] == photo) & known[by["point"]])
            calibration = state["calibration"][by["calibration"][own]]
            if len(own) >= MIN_RAYS_OF_PHOTO and np.isfinite(calibration[:, :3]).all():
                every.append(_rays(equations, block, own, float(share[photo]), calibration[0]))
    return sorted(every, key=lambda r: -r.lost)[:MAX_TESTED_PHOTOS]


def _rays(
    equations: Equations, block: Block, own: Index, share: float, calibration: Array
) -> _Rays:
    by = {kind: index[own] for kind, index in block.variables}
    photo = equations.unknowns["pose"].names[int(by["pose"][0])]
    names = equations.unknowns["point"].names
    return _Rays(
        photo,
        block.select(own),
        tuple(block.ids[int(i)] for i in own),
        tuple(names[int(p)] for p in by["point"]),
        equations.network.photos[photo].camera,
        calibration,
        share,
    )


def _misfit(equations: Equations, clean: Solution, rays: _Rays, best: OrientedPhoto) -> float:
    """Return the square sum of the rays as they are, from where the photo was taken."""
    state = Innovations(equations, clean).state
    number = equations.unknowns["pose"].number[rays.photo]
    poses = state["pose"].copy()
    poses[number] = np.concatenate([best.rotation.ravel(), best.position])
    state = {**state, "pose": poses}
    v = rays.block.evaluate(equations.network.frame, state, jacobians=False).residual
    return float(np.sum(np.square(v / rays.block.sigma)))


def _oriented(
    clean: Solution, rays: _Rays, cause: str, xy: Array, critical: float
) -> OrientedPhoto | None:
    """Return the photo, oriented from image coordinates; None: it has no orientation."""
    lens = rays.block.lens
    assert lens is not None
    if lens.takes == "places":
        return None
    xyz = np.array([clean.point(p) for p in rays.points])
    calibration = rays.calibration[: len(lens.names)]
    pose = resect(xyz, directions(lens, xy, calibration[None, :]))
    if pose is None:
        return None
    network = Network(frame=clean.network.frame)
    for name, at in zip(rays.points, xyz, strict=True):
        sigma = clean.standard_deviations(name)
        held = "".join(a for a, s in zip("xyz", sigma, strict=True) if not s > 0.0)
        network.add_point(name, at, fixed=held, sigma=[s if s > 0.0 else np.inf for s in sigma])
    k = len(calibration)
    network.cameras[rays.camera] = replace(
        clean.network.cameras[rays.camera],
        values=tuple(calibration.tolist()),
        fixed=(True,) * k,
        sigma=(np.inf,) * k,
        per_photo=False,
    )
    network.add_photo(rays.photo, rays.camera, position=tuple(pose[1].tolist()), rotation=pose[0])
    if rays.block.readout is not None and rays.photo in clean.network.of_kind("photo_motion"):
        motion = np.asarray(clean.unknown("photo_motion", rays.photo).values).tolist()
        network.set_unknown("photo_motion", rays.photo, motion, fixed=True)
    network.add_image_points(rays.photo, rays.points, xy, sigma=rays.block.sigma)
    with suppress(AdjustmentError):
        solution = adjust(network)
        (block,) = (b for b in solution.equations.blocks if b.lens is not None)
        v = solution.equations.residuals(solution.state)[block.rows].reshape(-1, 2)
        share = float(np.mean(np.sum(v * v, axis=1) <= critical))
        there = solution.pose(rays.photo)
        return OrientedPhoto(cause, there.rotation, there.position, share, solution.vtpv)
    return None


def mirrored_block(
    equations: Equations, clean: Solution, ids: Sequence[str], alpha: float, weight: VarianceFactor
) -> Iterator[MistakenIdentity]:
    """Iterate over the cameras, or all cameras at once, whose photos fit with other axes.

    Args:
        equations: the network with the observations that were rejected.
        clean: the solution without them.
        ids: ids of all that does not fit, rejected or not.
        alpha: probability with which a row that is right does not fit.
        weight: σ0² of the clean solution.
    """
    network = equations.network
    if not equations.images or not _most_of_a_kind(equations, ids):
        return
    critical = weight.limit(1, alpha)
    before = np.square(Innovations(equations, clean).residuals())
    least = max(MIN_FITTING_RAY_SHARE, float(np.mean(before <= critical)))
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
        same = [o for o in fit if o.t2 < best.t2 + MIN_T2_DIFFERENCE * weight.variance]
        cause = axes_by_attitude(same, given)
        rays = tuple(
            ident
            for block in equations.blocks
            if block.lens is not None
            for ident, camera in zip(block.ids, _cameras(equations, block), strict=True)
            if camera in cameras
        )
        yield MistakenIdentity(cause, where, rays, float(np.nansum(before)), best.t2)
        return


def _most_of_a_kind(equations: Equations, ids: Sequence[str]) -> bool:
    """Return whether most observations of a kind, or most rays of a camera, do not fit."""
    bad = set(ids)
    every, gone = Counter[str](), Counter[str]()
    for block in equations.blocks:
        kinds = [block.kind] * block.n if block.lens is None else _cameras(equations, block)
        every.update(kinds)
        gone.update(kind for kind, i in zip(kinds, block.ids, strict=True) if i in bad)
    return any(
        n >= MIN_RAYS_OF_PHOTO and n >= MIN_REJECTED_SHARE * every[kind] for kind, n in gone.items()
    )


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
) -> OrientedPhoto | None:
    """Return how a network fits with other axes of some cameras; None: it does not.

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
        solution = adjust(other, max_iterations=MAX_AXES_ITERATIONS)
        squares = _squares(equations, solution.state)
        if MIN_PROMISING_SHARE <= np.mean(squares <= critical) <= least and network.datum != "free":
            solution = robust_adjust(other, start=solution).solution
            squares = _squares(equations, solution.state)  # with the weights that were given
    except AdjustmentError:
        return None
    share = float(np.mean(squares <= critical))
    if not solution.converged or share <= least:
        return None
    if not (solution.state["calibration"][:, 0] > 0.0).all():
        return None  # a negative principal distance represents the other axis of the image
    pose = solution.state["pose"][equations.unknowns["pose"].number[photo]]
    return OrientedPhoto(cause, pose[:9].reshape(3, 3), pose[9:], share, float(np.sum(squares)))


def _turned(network: Network, cameras: set[str], axes: Axes) -> Network:
    """Return the network with other axes of the images of some cameras."""
    out = network.copy()
    f, _, xy, _ = network.images.columns()
    of_photo = [network.cameras[photo.camera] for photo in network.photos.values()]
    at = np.array([camera.values[1:3] for camera in of_photo])[f]
    mine: Mask = np.array([camera.name in cameras for camera in of_photo])[f]
    turned = np.where(mine[:, None], axes(xy, at), xy)
    out.images = out.images.with_columns(xy=turned)
    return out
