"""Relatively oriented models; their coordinates, with covariance, in a block in place of the rays.

The unit of two or more photos is a bundle without control: the first photo is held, and the largest
component of the longest base (FRAMES F17.3). Its model has the photogrammetric axes of the first
photo (x right, y up, z back), its origin at the projection centre of that photo and the scale of
the approximate base.

Seven motions of a model are arbitrary. They are taken out of its covariance and come back with the
mean variance of the model, which makes it regular:

    Σ = T K Σ_l Kᵀ Tᵀ + s² Q Qᵀ        T = I − Q Qᵀ        s² = tr(T K Σ_l Kᵀ Tᵀ) / (3 m − 7)

K (3 m, rows) holds the partials of the m places by the image coordinates, Q an orthonormal basis of
the seven motions. A frame with seven free components takes what s² adds: coordinates of points,
residuals and vᵀPv do not depend on s².

Rays are used by their unit alone; control, positions of photos and terrestrial observations are
used by the block. A block of models is equivalent to the bundle block, to what linearisation
leaves, where each photo belongs to one unit and all its rays are in it (FRAMES F2; Ayeni's method
24): coordinates with their covariance then hold everything that the rays say of the points.

Models that share a photo use its rays twice. Their coordinates are correlated,

    Σ_ab = R_a R_bᵀ,    R = T K Σ_l^½ over the shared rays,

which ``joint`` takes into account. What is lost then is the attitude of the shared photo and the
residuals of the relative orientations, which are correlated with the other model: in a strip of
seven photos with an overlap of 80 per cent σ of points grow by 0.01 per cent. Without ``joint``, as
in practice, points lose 1 to 2 per cent against the bundle, and their stated standard deviations
are 3 to 6 per cent too small. A point in four photos of a strip has eight image coordinates and
nine model coordinates in three models: the joint covariance is singular, and gets a small
independent part, `RELATIVE_RIDGE_SIGMA`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np
from scipy.linalg import solve_triangular

from ..adjustment import adjust
from ..blas_threads import with_one_thread
from ..entities import ImageTable
from ..errors import InputError, Problem, taking, unknown_name
from ..graph.equations import compile_network
from ..graph.observation_selection import without
from ..graph.variables import State
from ..models.unknown_registry import UNKNOWNS
from ..network.network import Network
from ..observations import Correlated, FrameCoordinate
from ..observations.base import joined_points, of_quantities
from ..result_display import Rows, Shown
from ..rotation import log_rotation, skew, world_R_camera
from ..solve.solution import Solution
from ..start.approximate_values import partial_approximation
from ..types import Array, Index

MIN_POINTS_OF_MODEL = 5
"""Smallest number of points that orient two photos relatively."""
MODEL_STEP_TOLERANCE = 1e-8
"""Bound on the last step of an unknown of a relative orientation, relative to its σ."""
FACING_DOWN = world_R_camera(0.0, 0.0, 0.0)
"""Rotation from the axes of a camera to its photogrammetric axes."""
RELATIVE_RIDGE_SIGMA = 1e-3
"""Independent part of a joint covariance: σ relative to the mean σ of a coordinate."""
FRAME_COMPONENTS = UNKNOWNS["frame"].names()
"""Components of a frame, all of which are free for a model."""
MIN_STRIP_POINTS = MIN_POINTS_OF_MODEL + 1
"""Smallest number of common points of two photos that follow one another in a strip."""


@dataclass(frozen=True, repr=False, eq=False)
class RelativeModel(Shown):
    """A model: coordinates of points and projection centres in a frame of their own."""

    name: str
    """Name of the model, and of its frame."""
    photos: tuple[str, ...]
    """Photos of the unit; the first one is held."""
    points: Mapping[str, Array]
    """Model coordinates (3,) by point, metres by the approximate base."""
    centres: Mapping[str, Array]
    """Model coordinates (3,) of the projection centres by photo."""
    solution: Solution
    """Adjustment of the relative orientation."""
    root: Array
    """T K Σ_l^½, (3 m, rows): effect of one standard deviation of each image coordinate on the
    points and then the projection centres, without motions of the whole model."""
    motions: Array
    """Q, (3 m, 7): orthonormal motions of the whole model."""
    rays: Index
    """Row of the image table of the network from which each image coordinate came, (rows / 2,)."""

    def headline(self) -> str:
        """Return photos, number of points, redundancy and σ̂0."""
        s = self.solution
        said = f"{len(self.photos)} photos, {len(self.points)} points"
        if not s.redundancy:
            return f"RelativeModel {self.name!r}: {said}, redundancy 0"
        return f"RelativeModel {self.name!r}: {said}, redundancy {s.redundancy}, σ̂0 {s.sigma0:.3f}"

    def first_rows(self) -> Rows:
        """Return the coordinates of the points."""
        rows = ((name, *map(float, x)) for name, x in self.points.items())
        return Rows(("point", "x", "y", "z"), rows, len(self.points))

    @property
    def variance(self) -> float:
        """s², the mean variance of a coordinate without motions of the whole, metres²."""
        rank: int = len(self.root) - self.motions.shape[1]
        return float(np.sum(self.root**2)) / rank

    @property
    def covariance(self) -> Array:
        """Covariance of all coordinates, points before projection centres, (3 m, 3 m) metres²."""
        q = self.motions
        return np.asarray(self.root @ self.root.T + self.variance * (q @ q.T))

    def coordinates(self) -> tuple[FrameCoordinate, ...]:
        """Return the coordinates as observations, each with its own part of the covariance."""
        places = [*self.points.items(), *self.centres.items()]
        covariance, found = self.covariance, []
        for i, (place, x) in enumerate(places):
            own = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            point, photo = (place, None) if i < len(self.points) else (None, place)
            value = tuple(x.tolist())
            found.append(FrameCoordinate(self.name, point, value, photo=photo, covariance=own))
        return tuple(found)

    def observations(self, *, centres: bool = True) -> Correlated:
        """Return the coordinates as a group with their full covariance.

        Args:
            centres: whether the projection centres belong to the group.
        """
        every = self.coordinates()
        keep = len(every) if centres else len(self.points)
        return Correlated(every[:keep], self.covariance[: 3 * keep, : 3 * keep])


@taking(Network)
@with_one_thread
def relative_model(
    network: Network,
    photos: Sequence[str],
    *,
    name: str | None = None,
    state: State | None = None,
) -> RelativeModel:
    """Orient photos relatively by their rays alone.

    Control, terrestrial observations and weights of the network take no part. Calibrations are
    held at their given values. Points with two rays or more in these photos take part.

    Args:
        network: network with the image points; its poses are the start values.
        photos: two photos or more (a pair, a triplet …).
        name: name of the model and of its frame; by default the photos joined by ``-``.
        state: start values of the network; None: they are computed where they are not given.

    Raises:
        InputError: an unknown photo, one with a motion during its readout, too few common points,
            or projection centres in one place.
        DatumError: the points do not determine the orientation, as if they lie on one line.
    """
    chosen = tuple(photos)
    called = name or "-".join(chosen)
    where = f"model {called!r}"
    unknown = [f for f in chosen if f not in network.photos]
    if unknown:
        raise InputError(Problem(unknown_name("photo", unknown[0], network.photos), where))
    if len(set(chosen)) < len(chosen) or len(chosen) < 2:
        raise InputError(
            Problem(f"a model needs different photos, two or more, not {chosen}", where)
        )
    network.refuse_motions(chosen, "a relative orientation")
    begin = start_values(network) if state is None else state
    unit, rays = _unit_bundle(network, chosen, begin, called)
    solution = adjust(unit, tolerance=MODEL_STEP_TOLERANCE)
    points = {p: solution.point(p) for p in unit.points}
    centres = {f: np.asarray(solution.pose(f).position) for f in chosen}
    places = np.array([*points.values(), *centres.values()])
    motions = _motions(places)
    root = _effects(solution, unit, chosen)
    root -= motions @ (motions.T @ root)
    return RelativeModel(called, chosen, points, centres, solution, root, motions, rays)


def start_values(network: Network) -> State:
    """Return given values of a network, and approximate values where none are given."""
    return partial_approximation(compile_network(network))[0]


def _unit_bundle(
    network: Network, photos: tuple[str, ...], state: State, name: str
) -> tuple[Network, Index]:
    """Return the bundle of some photos in the axes of the first, and the rows of its rays."""
    where = f"model {name!r}"
    numbers = np.array([network.photo_number[f] for f in photos])
    photo, point, xy, sigma = network.images.columns()
    rows = np.flatnonzero(np.isin(photo, numbers))
    # A point that was measured twice in one photo has one ray.
    pairs = np.unique(np.stack([photo[rows], point[rows]]), axis=1)[1]
    seen, count = np.unique(pairs, return_counts=True)
    rows = rows[np.isin(point[rows], seen[count >= 2])]
    order = np.concatenate([rows[photo[rows] == i] for i in numbers])
    common = len(np.unique(point[order]))
    shared = {f: int(np.sum(photo[order] == i)) for f, i in zip(photos, numbers, strict=True)}
    least = min(photos, key=lambda f: shared[f])
    if shared[least] < MIN_POINTS_OF_MODEL or 2 * len(order) < 3 * common + 6 * len(photos) - 7:
        what = f"photo {least!r} shares {shared[least]} points with the others; "
        raise InputError(
            Problem(f"{what}a relative orientation needs {MIN_POINTS_OF_MODEL}", where)
        )
    poses = state["pose"][numbers]
    if np.isnan(poses).any():
        lost = photos[int(np.flatnonzero(np.isnan(poses).any(axis=1))[0])]
        raise InputError(Problem(f"photo {lost!r} has no approximate pose", where))
    to_model = FACING_DOWN @ poses[0, :9].reshape(3, 3).T
    centres = (poses[:, 9:] - poses[0, 9:]) @ to_model.T
    base = int(np.argmax(np.linalg.norm(centres, axis=1)))
    if not np.abs(centres[base]).max() > 0:
        raise InputError(Problem("its projection centres are one place", where))
    unit = Network(name)
    for camera in dict.fromkeys(network.photos[f].camera for f in photos):
        stated = network.cameras[camera]
        held, free = (True,) * len(stated.values), (np.inf,) * len(stated.values)
        unit.cameras[camera] = replace(stated, fixed=held, sigma=free)
    names = list(network.points)
    for number in np.unique(point[order]).tolist():
        at = (state["point"][number] - poses[0, 9:]) @ to_model.T
        unit.add_point(names[number], at.tolist() if np.isfinite(at).all() else None)
    for i, f in enumerate(photos):
        largest = int(np.argmax(np.abs(centres[base])))
        held = tuple(i == base and a == largest for a in range(3))
        unit.add_photo(
            f,
            network.photos[f].camera,
            position=centres[i].tolist(),
            rotation=to_model @ poses[i, :9].reshape(3, 3),
            fixed=True if i == 0 else (False, False, False, *held),
        )
        mine = order[photo[order] == numbers[i]]
        of_points = [names[p] for p in point[mine]]
        rho = network.images.correlation[mine]
        unit.add_image_points(f, of_points, xy[mine], sigma=sigma[mine], correlation=rho)
    return unit, order


def _motions(places: Array) -> Array:
    """Return an orthonormal basis (3 m, 7) of shifts, rotations and the scale of places (m, 3)."""
    d = places - places.mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum(d**2, axis=1)))) or 1.0
    shifts = np.tile(np.eye(3), (len(d), 1, 1))
    every = np.concatenate([shifts, -skew(d) / size, d[:, :, None] / size], axis=2)
    return np.linalg.qr(every.reshape(-1, 7))[0]


def _effects(solution: Solution, unit: Network, photos: tuple[str, ...]) -> Array:
    """Return K Σ_l^½ (3 m, rows), the rows in the order of the image table."""
    equations = solution.equations
    unknowns, frame = equations.unknowns, equations.network.frame
    design = np.zeros((2 * unit.n_image_points, unknowns.n_columns))
    for block in equations.blocks:
        partials = block.evaluate(frame, solution.state).jacobians
        # Blocks have the rows of the table by lens model.
        rows = 2 * np.asarray(cast(Any, block.ids).rows)[:, None] + np.arange(2)
        for (kind, index), part in zip(block.variables, partials, strict=True):
            first = unknowns[kind].offset[index]
            on = np.flatnonzero(first >= 0)
            columns = first[on, None] + np.arange(part.shape[2])
            weighted = part[on] / block.sigma[on][:, :, None]
            np.add.at(design, (rows[on][:, :, None], columns[:, None, :]), weighted)
    free = unknowns.free
    active = design[:, free]
    scale = np.linalg.norm(active, axis=0)
    left, upper = np.linalg.qr(active / scale)
    by_rays = np.zeros((unknowns.n_columns, len(design)))
    by_rays[free] = solve_triangular(upper, left.T) / scale[:, None]
    taken: list[Array] = []
    for name in unit.points:
        taken.append(by_rays[unknowns.columns("point", unknowns["point"].number[name])])
    for name in photos:
        columns = unknowns.columns("pose", unknowns["pose"].number[name])
        own = by_rays[columns[3:]] if len(columns) else np.zeros((3, len(design)))
        taken.append(own)
    return np.concatenate(taken)


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
    return tuple(
        (named[i], named[j]) for i, j in both if len(seen[i] & seen[j]) >= MIN_STRIP_POINTS
    )


def photos_of_strips(network: Network) -> list[list[str]]:
    """Return the photos of each strip in order."""
    strips: list[list[str]] = []
    for a, b in pairs_of_strips(network):
        if strips and strips[-1][-1] == a:
            strips[-1].append(b)
        else:
            strips.append([a, b])
    return strips


@taking(Network)
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
        what = f"no two photos that follow one another share {MIN_STRIP_POINTS} points; give units"
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
        out.add_frame(m.name, free=FRAME_COMPONENTS, values=values, origin=middle.tolist())
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
    return dict(zip(FRAME_COMPONENTS, (*turn.tolist(), *offset.tolist(), 0.0), strict=True))


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
    for o in of_quantities(out.observations.values(), "coordinates of a photo"):
        if np.any(o.lever_arm):
            what = "a lever arm needs the attitude of its photo, which models do not give"
            raise InputError(Problem(what, o.label()))
    seen = {p for m in models for p in m.points}
    seen |= joined_points(out.observations.values())
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
        small = RELATIVE_RIDGE_SIGMA**2 * a.variance * np.eye(first[i + 1] - first[i])
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
