"""Frames from places observed in them, points from known frames; places and sights as arrays.

What a network observes in frames of their own has one row for each place in a frame. A frame with
common places is a similarity between coordinates q in the frame and places X: with y = E (X − O), y
= e^ℓ R (q + c). Rotation and scale follow from the places reduced to their means (Kabsch; Umeyama
1991, eqs. 34 to 43); where two rotations are held, the turn about the third axis follows from the
plane across it, about z from the plan alone. Components that are given or held are kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..models.sub_frame import from_frame, horizons, place_of_sight, split_frame
from ..models.unknown_registry import ROTATION, UNKNOWNS
from ..observations import KINDS
from ..rotation import exp_rotation, nearest_rotation
from ..stochastic_model import StandardDeviation
from ..types import Array, Index, Mask
from .search_state import SearchState
from .terrestrial_readings import directions_read, zeniths_read

SIGHT_COMPONENTS = ("direction", "zenith", "distance")
"""What sights state about a place, in the order of the columns of `Sights.value`."""
MIN_UPRIGHT_COSINE = 0.99
"""Smallest cosine of the tilt of a frame of which plan and height are found each alone."""
MIN_EXTENT_RATIO_OF_PLACES = 1e-3
"""Smallest ratio of extents, across and along, at which places fix a rotation in space."""


@dataclass(frozen=True)
class Sights:
    """Places that instruments sight in their frames, each once in a frame."""

    frame: Index
    """Number of the frame, (n,)."""
    point: Index
    """Number of the point, (n,)."""
    value: Array
    """Direction, zenith angle and distance, NaN where one was not observed, (n, 3)."""
    sigma: Array
    """Their standard deviations, (n, 3)."""

    @property
    def whole(self) -> Mask:
        """Places of which direction, zenith angle and distance are known, (n,)."""
        return np.asarray(np.isfinite(self.value).all(axis=1))

    @cached_property
    def unit(self) -> Array:
        """Unit vectors in the axes of the frames, NaN without direction or zenith angle, (n, 3)."""
        direction, zenith, _ = self.value.T
        return place_of_sight(direction, zenith, np.ones(len(direction)))

    @cached_property
    def q(self) -> Array:
        """Places in the frames, unit of the frame; NaN where not all three are known, (n, 3)."""
        return place_of_sight(*self.value.T)

    @property
    def spread(self) -> Array:
        """Root mean square of the standard deviations of ``q`` along its three axes, (n,)."""
        _, zenith, distance = self.value.T
        across = self.sigma * np.stack(
            [np.abs(distance * np.sin(zenith)), distance, np.ones(len(zenith))], axis=1
        )
        return np.asarray(np.sqrt(np.mean(across**2, axis=1)))


@dataclass(frozen=True)
class FramePlaces:
    """Places that are observed in frames, one row for each."""

    frame: Index
    """Number of the frame, (n,)."""
    point: Index
    """Number of the point, −1: a photo, (n,)."""
    photo: Index
    """Number of the photo, −1: a point, (n,)."""
    q: Array
    """Observed coordinates, unit of the frame; NaN for axes that were not observed, (n, 3)."""
    given: Array
    """Given values of the components of every frame, NaN where they are to be found, (f, 7)."""
    free: Mask
    """Whether each component of every frame is free, (f, 7)."""
    origin: Index
    """Number of the point at the origin of every frame, −1: it is a constant, (f,)."""
    sights: Sights
    """Sights; those of which all is known stand in ``q`` too."""


def read_frame_places(equations: Equations) -> FramePlaces:
    """Return the places that a network observes in frames."""
    table, network = equations.unknowns["frame"], equations.network
    stated = network.frames.values()
    given = np.array([p.values for p in stated], dtype=float).reshape(-1, UNKNOWNS["frame"].size)
    number = equations.unknowns["point"].number
    origin = np.array([number.get(p.origin, -1) for p in stated], dtype=np.intp)
    every: list[tuple[Index, Index, Index, Array]] = []
    for block in equations.blocks:
        if block.prior or _observed_component(block) != "coordinates":
            continue
        index = dict(block.variables[:2])
        nowhere = np.full(block.n, -1, dtype=np.intp)
        q = np.full((block.n, 3), np.nan)
        q[:, ["xyz".index(a) for a in block.components]] = block.observed
        every.append((index["frame"], index.get("point", nowhere), index.get("pose", nowhere), q))
    sights = read_sights(equations)
    on = np.flatnonzero(sights.whole)
    every.append((sights.frame[on], sights.point[on], np.full(len(on), -1), sights.q[on]))
    frame, point, photo, q = (np.concatenate(c) for c in zip(*every, strict=True))
    return FramePlaces(frame, point, photo, q, given, table.free, origin, sights)


def read_sights(equations: Equations) -> Sights:
    """Return the sights of a network in frames; of repeated ones the first."""
    n_points = max(len(equations.unknowns["point"].names), 1)
    found: list[_SightBlock] = []
    for block in equations.blocks:
        what = _observed_component(block)
        if block.prior or what not in SIGHT_COMPONENTS:
            continue
        (_, frame), (_, point) = block.variables[:2]
        value = _in_face_one(equations, block, what)
        code, first = np.unique(frame * n_points + point, return_index=True)
        found.append(_SightBlock(block, SIGHT_COMPONENTS.index(what), code, first, value[first]))
    if not found:
        nothing = np.zeros(0, dtype=np.intp)
        return Sights(nothing, nothing, np.zeros((0, 3)), np.zeros((0, 3)))
    every = np.unique(np.concatenate([t.code for t in found]))
    values, sigmas = np.full((2, len(every), 3), np.nan)
    for told in reversed(found):  # the first of several blocks is written last
        values[np.searchsorted(every, told.code), told.column] = told.value
    q = place_of_sight(*values.T)
    for told in reversed(found):
        row = np.searchsorted(every, told.code)
        sigmas[row, told.column] = _sigmas(equations, told, q[row])
    frame, point = np.divmod(every, n_points)
    return Sights(frame.astype(np.intp), point.astype(np.intp), values, sigmas)


@dataclass(frozen=True)
class _SightBlock:
    """What a block of sights tells, each place once."""

    block: Block
    column: int
    """Column of `Sights.value`."""
    code: Index
    """Frame and point as one number, (m,)."""
    rows: Index
    """Numbers of the observations, (m,)."""
    value: Array
    """Values in face 1, (m,)."""


@dataclass(frozen=True)
class _SightGeometry:
    """Lengths on which the variances of sights depend, from the sights themselves."""

    observed: Array
    """Observed values, (m,)."""
    q: Array
    """Targets in their frames, (m, 3)."""

    def sight(self, target: str = "target") -> Array:
        """Return the lines from the instruments, (m, 3)."""
        return self.q

    def number(self, attribute: str) -> Array:
        """Return no number: sights have none."""
        return np.full(len(self.q), np.nan)


def _sigmas(equations: Equations, told: _SightBlock, q: Array) -> Array:
    """Return the standard deviations of sights to targets q (m, 3), NaN where q is not known."""
    block = told.block
    out = np.array(block.sigma[told.rows, 0])
    weight = KINDS[block.kind].weight
    observations = equations.network.observations
    stated = [observations[block.ids[i]].sigma for i in told.rows.tolist()]  # type: ignore[attr-defined]
    parts = np.array([isinstance(s, StandardDeviation) for s in stated], dtype=bool)
    if weight is None or not parts.any():
        return out
    rows = np.flatnonzero(parts)
    geometry = _SightGeometry(told.value[rows], q[rows])
    out[rows] = np.sqrt(weight.variance([stated[i] for i in rows.tolist()], geometry))
    return out


def _observed_component(block: Block) -> str:
    """Return what a block states about places in frames."""
    record = KINDS.get(block.kind)
    return "nothing" if record is None else record.in_frame


def _in_face_one(equations: Equations, block: Block, quantity: str) -> Array:
    """Return readings as in face 1, those of distance meters with known constants corrected."""
    value = block.observed[:, 0]
    if quantity == "distance":
        kind, number = block.variables[-1]
        scale, zero = equations.unknowns[kind].values[number].T
        return np.asarray((value - zero) / (1.0 + scale))
    return directions_read(block) if quantity == "direction" else zeniths_read(block)


def place_frames(progress: SearchState, seen: FramePlaces) -> bool:
    """Fill frames from the places that are known in them; return whether any was filled."""
    filled = False
    missing: Mask = np.any(np.isnan(progress.frame), axis=1)
    if not missing.any():
        return False
    rows = np.flatnonzero(missing[seen.frame])
    x = _places(progress, seen, rows)
    known = np.isfinite(x[:, :2]).all(axis=1)
    order = np.argsort(seen.frame[rows[known]], kind="stable")
    rows, x = rows[known][order], x[known][order]
    if not len(rows):
        return False
    frames, first = np.unique(seen.frame[rows], return_index=True)
    for f, own, there in zip(
        frames.tolist(), np.split(rows, first[1:]), np.split(x, first[1:]), strict=True
    ):
        origin = _origin(progress, seen, f)
        given = seen.given[f].copy()
        at = origin
        if at is None:  # an origin that is not known either follows with the offset
            at, given[3:6] = there.mean(axis=0), np.nan
        horizon = frame_horizon(progress, f, at)
        d = there - at
        y = np.nan_to_num(d) @ horizon.T
        y[np.isnan(d[:, 2]), 2] = np.nan
        found = _fitted(y, seen.q[own], given, seen.free[f])
        if found is None:
            continue
        if origin is None:
            offset = np.nan_to_num(seen.given[f, 3:6])
            _set_origin(progress, int(seen.origin[f]), at, found, offset, horizon)
            found[9:12] = offset
        progress.frame[f, : len(found)] = found
        filled = True
    return filled


def frame_horizon(progress: SearchState, f: int, at: Array) -> Array:
    """Return E (3, 3) of a frame with the origin ``at`` (3,)."""
    basis = progress.horizon.frame.basis(at[None], np.zeros((1, 2)))
    return np.asarray(horizons(basis, progress.frame[f, 16:])[0])


def _set_origin(
    progress: SearchState, point: int, at: Array, found: Array, offset: Array, horizon: Array
) -> None:
    """Fill the point at the origin of a frame: O = at + Eᵀ e^ℓ R (c' − c).

    Args:
        progress: what was found so far.
        point: number of the point.
        at: the place from which the frame was fitted, (3,).
        found: the frame with the offset c' from there, without constants.
        offset: c, the offset from the point, (3,).
        horizon: E, (3, 3).
    """
    shift = np.exp(found[12]) * found[:9].reshape(3, 3) @ (found[9:12] - offset)
    plan = progress.horizon.to_plan((at + horizon.T @ shift)[None])
    progress.set_plan(np.array([point]), plan[:, :2])
    progress.set_height(np.array([point]), plan[:, 2])


def fill_points_from_frames(progress: SearchState, seen: FramePlaces) -> bool:
    """Fill points from frames that are known; return whether any was.

    Of upright frames the plan and the height of a place are filled each alone.
    """
    known: Mask = np.all(np.isfinite(progress.frame), axis=1)
    origins = frame_origins(progress, seen)
    known &= np.isfinite(origins).all(axis=1)
    open_point = (seen.point >= 0) & ~progress.complete[seen.point]
    rows = np.flatnonzero(known[seen.frame] & open_point)
    if not len(rows):
        return False
    origin = origins[seen.frame[rows]]
    stored = progress.frame[seen.frame[rows]]
    basis = progress.horizon.frame.basis(origin, np.zeros((len(rows), 2)))
    horizon = horizons(basis, stored[:, 16])
    there = np.isfinite(seen.q[rows])
    # What was not observed is that of the origin, which is of no consequence for the rest.
    x = from_frame(stored, np.where(there, seen.q[rows], -stored[:, 9:12]), origin, horizon)
    axes = horizon.transpose(0, 2, 1) @ split_frame(stored).rotation
    upright = np.einsum("ni,ni->n", basis.enu[:, 2], axes[:, :, 2]) > MIN_UPRIGHT_COSINE
    plan, point, whole = progress.horizon.to_plan(x), seen.point[rows], there.all(axis=1)
    planned = np.flatnonzero(whole | (upright & there[:, :2].all(axis=1)))
    raised = np.flatnonzero(whole | (upright & there[:, 2]))
    planned_at, mean = _median_places(point[planned], plan[planned, :2])
    raised_at, height = _median_places(point[raised], plan[raised, 2:])
    return progress.set_plan(planned_at, mean) | progress.set_height(raised_at, height[:, 0])


def _median_places(point: Index, x: Array) -> tuple[Index, Array]:
    """Return each of several points once, (k,), and the median of its places, (k, d).

    A place that one of three frames has wrong, because its name was confused, is not the median.

    Args:
        point: numbers of points, (n,).
        x: their places, each from another frame, (n, d).
    """
    points, group = np.unique(point, return_inverse=True)
    out = np.array([np.median(x[group == g], axis=0) for g in range(len(points))])
    return points, out.reshape(len(points), x.shape[1])


def frame_origins(progress: SearchState, seen: FramePlaces) -> Array:
    """Return O of every frame, (f, 3); NaN while its point is not known."""
    out = progress.frame[:, 13:16].copy()
    at_point = np.flatnonzero(seen.origin >= 0)
    out[at_point] = progress.horizon.from_plan(progress.plan[seen.origin[at_point]])
    return out


def _origin(progress: SearchState, seen: FramePlaces, f: int) -> Array | None:
    """Return O of a frame; none while its point is not known."""
    if seen.origin[f] < 0:
        return np.asarray(progress.frame[f, 13:16])
    at = progress.horizon.from_plan(progress.plan[seen.origin[f]][None])[0]
    return at if np.isfinite(at).all() else None


def _places(progress: SearchState, seen: FramePlaces, rows: Index) -> Array:
    """Return the places of rows, (n, 3); NaN where they are not known."""
    points = progress.horizon.from_plan(progress.plan[seen.point[rows]])
    if not len(progress.pose):
        return points
    centres = progress.pose[seen.photo[rows], ROTATION:]
    return np.where((seen.point[rows] >= 0)[:, None], points, centres)


def _fitted(y: Array, q: Array, given: Array, free: Mask) -> Array | None:
    """Return the stored frame, without constants, that carries q (n, 3) to y (n, 3).

    Args:
        y: places from the origin, in its horizon if the frame is level; NaN in unknown heights.
        q: coordinates in the frame, NaN for axes that were not observed.
        given: given components, NaN where they are to be found, (7,).
        free: free components, (7,).
    """
    found = _fitted_along(y, q, given, free, [0, 1, 2])
    if found is not None or not np.cos(np.hypot(*given[:2])) > MIN_UPRIGHT_COSINE:
        return found
    plan = _fitted_along(y, q, np.where(np.arange(7) == 5, 0.0, given), free, [0, 1])
    if plan is None:
        return _fitted_along(y, q, given, free, [2])
    plan[11] = given[5]
    if np.isnan(given[5]):
        rise = (y @ plan[:9].reshape(3, 3))[:, 2] * np.exp(-plan[12]) - q[:, 2]
        if not np.isfinite(rise).any():
            return None
        plan[11] = np.nanmean(rise)
    return plan


def _fitted_along(y: Array, q: Array, given: Array, free: Mask, axes: list[int]) -> Array | None:
    """Return the stored frame as `_fitted` from some axes; none if they do not fix all of it."""
    turns, shifts = np.isnan(given[:3]), np.isnan(given[3:6])
    sound = np.isfinite(y[:, axes]).all(axis=1) & np.isfinite(q[:, axes]).all(axis=1)
    y, q = y[sound], q[sound]
    offset = np.where(shifts, 0.0, given[3:6])
    others = [i for i in range(3) if i not in axes]
    if not len(y) or shifts[others].any() or (turns.any() and not {0, 1} <= set(axes)):
        return None
    # Where no offset is to be found, the origin is one more place that is common.
    whole = shifts[axes].any()
    y[:, others] = 0.0
    middle = y.mean(axis=0) if whole else np.zeros(3)
    centre = np.nan_to_num(q.mean(axis=0)) if whole else -offset
    a, b = np.nan_to_num(q - centre), np.nan_to_num(y - middle)
    a[:, others] = 0.0
    rotation = _turn(a, b, given, axes)
    if rotation is None:
        return None
    ln_scale = float(given[6])
    if free[6]:
        size = float(np.sum(a[:, axes] ** 2))
        scale = float(np.sum((b @ rotation)[:, axes] * a[:, axes])) / size if size else 0.0
        if not scale > 0:
            return None
        ln_scale = float(np.log(scale))
    found = np.exp(-ln_scale) * (middle @ rotation) - centre
    offset = np.where(shifts, found, offset)
    return np.concatenate([rotation.ravel(), offset, [ln_scale]])


def _turn(a: Array, b: Array, given: Array, axes: list[int]) -> Array | None:
    """Return R with b ≈ e^ℓ R a, both (n, 3); none where the places do not fix it."""
    turns = np.isnan(given[:3])
    if not turns.any():
        return np.asarray(exp_rotation(given[None, :3])[0])
    if turns.sum() == 1:
        # R = R_tilt R_k(κ): the turn about the axis k comes first, in the plane across it.
        k = int(np.argmax(turns))
        tilt = exp_rotation(np.where(turns, 0.0, given[:3])[None])[0]
        c = b @ tilt
        i, j = (k + 1) % 3, (k + 2) % 3
        sine = float(np.sum(a[:, i] * c[:, j] - a[:, j] * c[:, i]))
        cosine = float(np.sum(a[:, i] * c[:, i] + a[:, j] * c[:, j]))
        if not np.hypot(sine, cosine) > 0:
            return None
        turn = exp_rotation(np.eye(3)[[k]] * np.arctan2(sine, cosine))[0]
        return np.asarray(tilt @ turn)
    moment = b.T @ a
    values = np.linalg.svd(moment, compute_uv=False)
    if not values[1] > MIN_EXTENT_RATIO_OF_PLACES**2 * values[0] or len(a) < 2:
        return None
    return nearest_rotation(moment)
