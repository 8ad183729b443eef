"""A block of photos as independent models: relative orientations, then frames.

Rays are used by their unit alone; control, positions of photos and terrestrial observations are
used by the block. A block of models is equivalent to the bundle block, to what linearisation
leaves, where each photo belongs to one unit and all its rays are in it (FRAMES F2; Ayeni's method
24): coordinates with their covariance then hold everything that the rays say of the points.

Models that share a photo use its rays twice. Their coordinates are correlated,

    Σ_ab = R_a R_bᵀ,    R = T K Σ_l^½ over the shared rays,

which ``joint`` takes into account. What is lost then is the attitude of the shared photo and the
residuals of the relative orientations, which are correlated with the other model: in a strip of
seven photos with an overlap of 80 per cent σ of points grow by 0.01 per cent. Without ``joint``, as
in practice, points lose 1 to 2 per cent against the bundle, and their standard deviations are told
3 to 6 per cent too small. A point in four photos of a strip has eight image coordinates and nine
model coordinates in three models: the joint covariance is singular, and gets a small independent
part, `RIDGE`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem
from ..graph.variables import State
from ..models.variables import UNKNOWNS
from ..network.entities import ImageTable
from ..network.network import Network
from ..network.selection import without
from ..observations import Correlated, PhotoPosition
from ..rotation import log_rotation
from ..shown import Rows, Shown
from ..types import Array
from .relative import FACING_DOWN, LEAST_POINTS, RelativeModel, relative_model, start_values

SEVEN = UNKNOWNS["frame"].names()
"""Components of a frame, all of which are free for a model."""
LEAST_SHARED = LEAST_POINTS + 1
"""Smallest number of common points of two photos that follow one another in a strip."""
RIDGE = 1e-3
"""Independent part of a joint covariance: σ relative to the mean σ of a coordinate."""


@dataclass(frozen=True, repr=False, eq=False)
class ModelBlock(Shown):
    """A block of independent models."""

    network: Network
    """The network of frames: points, projection centres, control and other observations."""
    models: tuple[RelativeModel, ...]
    """The relative orientations."""

    def headline(self) -> str:
        """Return the numbers of models and points."""
        return f"ModelBlock: {len(self.models)} models, {len(self.network.points)} points"

    def first_rows(self) -> Rows:
        """Return photos, points, redundancy and σ̂0 of the relative orientations."""
        rows = (
            (
                m.name,
                len(m.photos),
                len(m.points),
                m.solution.redundancy,
                m.solution.sigma0 if m.solution.redundancy else np.nan,
            )
            for m in self.models
        )
        return Rows(("model", "photos", "points", "r", "σ̂0"), rows, len(self.models))


def pairs_of_strips(network: Network) -> tuple[tuple[str, str], ...]:
    """Return the pairs of photos that follow one another and share enough points for a model."""
    photo, point, *_ = network.images.columns()
    seen = [set(point[photo == i].tolist()) for i in range(len(network.photos))]
    named = list(network.photos)
    both = pairwise(range(len(named)))
    return tuple((named[i], named[j]) for i, j in both if len(seen[i] & seen[j]) >= LEAST_SHARED)


def photos_of_strips(network: Network) -> list[list[str]]:
    """Return the photos of each strip in order."""
    strips: list[list[str]] = []
    for a, b in pairs_of_strips(network):
        if strips and strips[-1][-1] == a:
            strips[-1].append(b)
        else:
            strips.append([a, b])
    return strips


@with_one_thread
def as_models(
    network: Network,
    units: Sequence[Sequence[str]] | None = None,
    *,
    centres: bool = True,
    joint: bool = False,
) -> ModelBlock:
    """Turn a block of photos into independent models with frames of their own.

    Args:
        network: the block; its poses are the start values, its calibrations are held.
        units: the photos of each model; by default `pairs_of_strips`. Photos in no unit are lost.
        centres: whether projection centres are coordinates of the models. Without them the photos
            leave the network, together with all observations of them.
        joint: whether models that share photos have one covariance; it is dense.

    Returns:
        The block, whose frames have seven free components and origins in the middle of their
        points. Points that no model has, and no other observation, are left out.

    Raises:
        InputError: no units, a relative orientation that fails, or positions of photos with a
            lever arm: models say nothing of the attitudes of photos.
    """
    chosen = pairs_of_strips(network) if units is None else [tuple(u) for u in units]
    if not chosen:
        what = f"no two photos that follow one another share {LEAST_SHARED} points; give units"
        raise InputError(Problem(what, f"network {network.name!r}"))
    state = start_values(network)
    models = tuple(relative_model(network, unit, state=state) for unit in chosen)
    out = _without_rays(network, models, state, centres=centres)
    place = {p: np.array(state["point"][network.point_number[p]]) for p in network.points}
    for m in models:
        if m.name in out.frames:
            raise InputError(Problem("two units have the same photos", f"model {m.name!r}"))
        known = np.array([place[p] for p in m.points])
        middle = np.nanmean(known, axis=0)
        first = state["pose"][network.photo_number[m.photos[0]]]
        values = _start(first, middle)
        out.add_frame(m.name, free=SEVEN, values=values, origin=middle.tolist())
    if joint:
        out.add(_joint(models, centres=centres))
    else:
        out.add(*(m.observations(centres=centres) for m in models))
    return ModelBlock(out, models)


def _start(pose: Array, origin: Array) -> dict[str, float]:
    """Return components of the frame of a model whose first photo has an approximate pose (12,)."""
    rotation = pose[:9].reshape(3, 3) @ FACING_DOWN.T
    turn = log_rotation(rotation[None])[0]
    offset = (pose[9:] - origin) @ rotation
    return dict(zip(SEVEN, (*turn.tolist(), *offset.tolist(), 0.0), strict=True))


def _without_rays(
    network: Network, models: tuple[RelativeModel, ...], state: State, *, centres: bool
) -> Network:
    """Return the network with photos as places without images, or without photos."""
    used = {f for m in models for f in m.photos}
    kept = used if centres else set()
    gone = [i for i, o in network.observations.items() if not kept.issuperset(o.photos())]
    out = without(network, gone)
    out.images = ImageTable()
    out.photos = {}
    for name, f in network.photos.items():
        if name not in kept:
            continue
        pose = state["pose"][network.photo_number[name]]
        if f.sigma_attitude is not None:
            f = replace(f, sigma_attitude=None)
        rotation = pose[:9].reshape(3, 3)
        held = (True, True, True, *f.fixed[3:])
        position = tuple(pose[9:].tolist())
        out.photos[name] = replace(f, position=position, rotation=rotation, fixed=held)
    out.photo_number = {n: i for i, n in enumerate(out.photos)}
    cameras = {f.camera for f in out.photos.values()}
    out.cameras = {
        n: replace(c, fixed=(True,) * len(c.values), sigma=(np.inf,) * len(c.values))
        for n, c in network.cameras.items()
        if n in cameras
    }
    for o in out.observations.values():
        if isinstance(o, PhotoPosition) and np.any(o.lever_arm):
            what = "a lever arm needs the attitude of its photo, which models do not give"
            raise InputError(Problem(what, o.label()))
    seen = {p for m in models for p in m.points}
    seen |= {p for o in out.observations.values() for p in o.points()}
    seen |= {f.origin for f in network.frames.values()}
    return without(out, (), points=[p for p in out.points if p not in seen])


def _joint(models: tuple[RelativeModel, ...], *, centres: bool) -> Correlated:
    """Return the coordinates of all models as one group with their joint covariance."""
    groups = [m.observations(centres=centres) for m in models]
    first = np.cumsum([0, *(len(g.covariance) for g in groups)])
    covariance = np.zeros((int(first[-1]),) * 2)
    roots = [m.root[: len(g.covariance)] for m, g in zip(models, groups, strict=True)]
    for i, a in enumerate(models):
        own = slice(first[i], first[i + 1])
        small = RIDGE**2 * a.variance * np.eye(first[i + 1] - first[i])
        covariance[own, own] = groups[i].covariance + small
        for j, b in enumerate(models[:i]):
            other = slice(first[j], first[j + 1])
            across = _across(a, b, roots[i], roots[j])
            covariance[own, other], covariance[other, own] = across, across.T
    return Correlated(tuple(o for g in groups for o in g.observations), covariance)


def _across(a: RelativeModel, b: RelativeModel, root_a: Array, root_b: Array) -> Array:
    """Return the covariance between two models from the rays that both use."""
    _, in_a, in_b = np.intersect1d(a.rays, b.rays, return_indices=True)
    columns_a, columns_b = (2 * rows[:, None] + np.arange(2) for rows in (in_a, in_b))
    return np.asarray(root_a[:, columns_a.ravel()] @ root_b[:, columns_b.ravel()].T)
