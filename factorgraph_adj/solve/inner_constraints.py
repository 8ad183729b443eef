"""Free network moved onto inner constraints; covariances on datum points where a datum is given.

The iteration keeps a minimal datum; finite similarity transformations, which no observation
notices, then move a converged solution onto the inner constraints G_Dᵀ (x − x₀)_D = 0 over any
datum points. Covariances can refer to datum points although the datum itself is given.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..models.rolling_shutter import MOTION as PER_POWER
from ..models.rolling_shutter import VELOCITY
from ..models.similarity import fit_similarity
from ..models.sub_frame import split_frame
from ..models.unknown_registry import ROTATION, UNKNOWNS, VariableKind
from ..rotation import exp_rotation, log_rotation
from ..types import Array, Index, Mask
from .convergence import STOPPING
from .datum_defects import MOTION_NAMES, Defect, FreeDatum, find_defects, in_part
from .gauss_newton_steps import Step
from .normal_equations import NormalEquations
from .unnoticed_motions import stations_of


@dataclass(frozen=True, eq=False)
class ReferenceDatum:
    """Datum points to which covariances refer although the datum itself is given."""

    points: tuple[str, ...]
    """Names of the datum points."""
    motions: tuple[str, ...]
    """Names of the motions that are removed; mixtures are named by their main part."""
    datum: FreeDatum
    """G and the datum coordinates among all components, including held ones."""
    unknowns: Unknowns
    """Layout of all components, including held ones."""
    cross: Array
    """F = Q B_D (components, d), see `FreeDatum.basis`; zero for held components."""
    square: Array
    """E = B_DᵀF (d, d)."""

    def transformed(
        self, block: Array, a: tuple[VariableKind, str], b: tuple[VariableKind, str]
    ) -> Array:
        """S-transform the cofactors (k, l) between two variables, by kind and name."""
        return self.datum.transformed(block, self._parts(*a), self._parts(*b), self.square)

    def transformed_points(self, blocks: Array) -> Array:
        """S-transform the cofactors (n, 3, 3) of all points."""
        offset = self.unknowns["point"].offset
        out = blocks.copy()
        on = np.flatnonzero(offset >= 0)
        columns = offset[on, None] + np.arange(3)
        both = self.datum.basis[columns], self.cross[columns]
        out[on] = self.datum.transformed(blocks[on], both, both, self.square)
        return out

    def _parts(self, kind: VariableKind, name: str) -> tuple[Array, Array]:
        """Return B and F of a variable, (k, d) each."""
        table = self.unknowns[kind]
        number = table.number[name]
        columns = self.unknowns.columns(kind, number)
        if not len(columns):
            nothing = np.zeros((int(table.size[number]), len(self.square)))
            return nothing, nothing
        return self.datum.basis[columns], self.cross[columns]


def moved_by_similarity(
    equations: Equations, state: State, defect: Defect, amounts: Array
) -> State:
    """Move the part of a defect by a finite similarity transformation.

    Points and projection centres: X ← c + e^s R (X − c) + t; attitudes turn with R, arms of mounts
    grow by e^s, and velocities of photos turn and grow: v ← e^s R v. Orientation unknowns,
    verticals and scales of distance meters follow linearly; the next step of the adjustment
    corrects their second-order terms, and those of motions that do not commute.

    Args:
        equations: the network.
        state: the values before the motion.
        defect: the motions that may be used, at ``state``.
        amounts: amount of each motion, (d,).
    """
    centre, size = defect.about
    motion = defect.mixture @ amounts
    moved = equations.unknowns.retract(state, defect.motions @ amounts)
    rotation = exp_rotation(motion[3:6] / size)
    factor = np.exp(motion[6] / size)
    inside = np.zeros(equations.unknowns.n_columns, dtype=bool)
    inside[defect.part] = True

    def place(x: Array) -> Array:
        return np.asarray(centre + factor * (x - centre) @ rotation.T + motion[:3])

    table = equations.unknowns["point"]
    on = in_part(table, inside)
    points = np.where(on[:, None] & table.free, place(state["point"]), moved["point"])
    table = equations.unknowns["pose"]
    on = in_part(table, inside) & table.free.all(axis=1)
    poses = moved["pose"].copy()
    turned = rotation @ state["pose"][on, :9].reshape(-1, 3, 3)
    poses[on, :9] = turned.reshape(-1, 9)
    poses[on, 9:] = place(state["pose"][on, 9:])
    table = equations.unknowns["frame"]
    numbers = np.flatnonzero(in_part(table, inside))
    frames = moved["frame"].copy()
    origins = stations_of(equations, "frame", numbers)
    alone = numbers[(origins < 0) & (split_frame(state["frame"][numbers]).level == 0)]
    frames[alone] = _moved_frames(
        state["frame"][alone], table.free[alone], rotation, motion[6] / size, place
    )
    mounts, numbers = moved["mount"].copy(), _with_arms(equations, defect)
    mounts[numbers, ROTATION:] = factor * state["mount"][numbers, ROTATION:]
    table = equations.unknowns["photo_motion"]
    motions = moved["photo_motion"].copy()
    for first in range(0, motions.shape[1], PER_POWER):
        own = slice(first, first + VELOCITY)
        on = in_part(table, defect.inside) & table.free[:, own].all(axis=1)
        motions[on, own] = factor * state["photo_motion"][on, own] @ rotation.T
    found = {"point": points, "pose": poses, "frame": frames, "mount": mounts}
    return {**moved, **found, "photo_motion": motions}


def _with_arms(equations: Equations, defect: Defect) -> Index:
    """Return the mounts whose arms a defect scales: rigid ones allow no error of second order."""
    table = equations.unknowns["mount"]
    free = in_part(table, defect.inside) & table.free[:, 3:].all(axis=1)
    return np.flatnonzero(free)


def _moved_frames(
    frames: Array,
    free: Mask,
    rotation: Array,
    ln_scale: float,
    place: Callable[[Array], Array],
) -> Array:
    """Return frames with constant origins moved by a similarity: what they measure stays.

    R' = Q R, ℓ' = ℓ + ln m; the place with q = 0, O + e^ℓ R c, moves as a point does. R stays where
    it is held altogether, as that of a sphere, and ℓ where it is held.

    Args:
        frames: stored frames, (n, 17).
        free: free components, (n, 7).
        rotation: Q, (3, 3).
        ln_scale: ln m.
        place: the similarity of places (n, 3).
    """
    turned, offset, scale, origin, _ = split_frame(frames)
    out = frames.copy()
    with np.errstate(over="ignore"):  # a frame that has run to infinity stays there
        to_object = np.exp(scale)[:, None, None] * turned
    zero = place(origin + np.einsum("nij,nj->ni", to_object, offset))
    turns: Mask = np.any(free[:, :3], axis=1)
    after = np.where(turns[:, None, None], rotation @ turned, turned)
    out[:, :9] = after.reshape(-1, 9)
    out[:, 12] = scale + np.where(free[:, 6], ln_scale, 0.0)
    away = np.exp(-out[:, 12])[:, None, None] * after.transpose(0, 2, 1)
    out[:, 9:12] = np.einsum("nij,nj->ni", away, zero - origin)
    return out


@dataclass(frozen=True)
class MotionRule:
    """Bounds of the motions that carry a free network onto its inner constraints."""

    transformations: int = 20
    """Largest number of motions of a whole solution; two or three suffice as a rule."""
    steps: int = 100
    """Largest number of steps of one motion; two or three suffice as a rule."""
    far: float = 0.5
    """Largest rotation, radians, and logarithm of the scale, of one step: over larger steps second
    derivatives predict the minimum of |x − x₀|² badly."""
    negligible: float = 1e-9
    """Relative decrease of |x − x₀|² that rounding of |x − x₀|² may hide."""
    shrinking: float = 0.5
    """Ratio of a step to the last one above which steps do not converge any more, where rounding
    may hide what they bring."""
    halvings: int = 30
    """Largest number of times that a step which does not descend is halved."""
    near: float = 1e-4
    """Step relative to σ up to which a step that does not shrink may be rounding."""
    blurred: float = 1e-12
    """Largest predicted decrease of vᵀPv, relative to 1 + vᵀPv, of a step that counts as rounding;
    as `StoppingRule.rounding`."""
    again: float = 2.0
    """Largest ratio of a later step to a step that was rounding, for the later one to count as
    rounding too."""
    carried: float = 1e-12
    """Largest remaining motion, relative to the coordinates, of a solution on its constraints: a
    few units of the last digit."""
    noticed: float = 1e-2
    """Largest growth of vᵀPv, relative to 1 + vᵀPv, by the whole way: observations may notice a
    datum defect a little, such as a turn in a frame whose verticals converge."""


MOTION = MotionRule()
"""The bounds of all motions."""


def datum_columns(
    equations: Equations, motions: Array, points: Collection[str] | None = None
) -> Mask:
    """Return the coordinates (n_columns,) that carry the datum.

    Args:
        equations: the network.
        motions: G of the defect, (n_columns, d).
        points: names of the datum points; None: the points with the datum flag, or all points if
            no point has the flag.

    Raises:
        DatumError: the datum points are too few, or lie on one line.
    """
    unknowns, network = equations.unknowns, equations.network
    chosen = np.zeros(unknowns.n_columns, dtype=bool)
    table = unknowns["point"]
    if points is None:
        flagged = np.array([p.datum for p in network.points.values()], dtype=bool)
        wanted = flagged if flagged.any() else np.ones(len(flagged), dtype=bool)
    else:
        names = set(points)
        wanted = np.array([n in names for n in table.names], dtype=bool)
    on = (table.offset >= 0) & wanted
    for axis in range(3):
        chosen[table.offset[on] + axis] = True
    chosen &= unknowns.free
    if int(np.linalg.matrix_rank(motions[chosen])) < motions.shape[1]:
        what = "flag" if points is None else "name"
        raise DatumError(
            f"the datum points ({int(on.sum())}) cannot carry a datum with "
            f"{motions.shape[1]} defects: {what} more points, not on one line",
            defect=motions.shape[1],
            names=[n for n, o in zip(table.names, on, strict=True) if o][:12],
        )
    return chosen


def displacement_from_start(equations: Equations, state: State, start: State) -> Array:
    """Return x − x₀ of the points, (n_columns,), zero for all other unknowns."""
    table = equations.unknowns["point"]
    on = np.flatnonzero(table.offset >= 0)
    out = np.zeros(equations.unknowns.n_columns)
    columns = table.offset[on, None] + np.arange(3)
    out[columns] = state["point"][on] - start["point"][on]
    out[~equations.unknowns.free] = 0.0
    return out


def state_on_constraints(
    equations: Equations, state: State, start: State, defect: Defect, columns: Mask
) -> State:
    """Move a network so that |x − x₀|² over the datum points is least.

    At the minimum G_Dᵀ (x − x₀)_D = 0, as G holds the derivatives of x by the motions. The method
    is Newton's, damped so that it descends; its second derivatives of the points matter where the
    network has another shape than x₀. Photos alone begin with the similarity that is best in closed
    form: points that ran to infinity would let Newton's method creep.

    Args:
        equations: the network.
        state: the values before the motion.
        start: x₀.
        defect: the motions that may be used, at ``state``.
        columns: coordinates of the datum points, (n_columns,).
    """

    def offset(at: State) -> Array:
        return np.where(columns, displacement_from_start(equations, at, start), 0.0)

    columns = columns & defect.inside
    best = _similarity(equations, state, start, defect, columns)
    if best is not None and not is_negligible_motion(defect.motions @ best, state):
        state = moved_by_similarity(equations, state, defect, best)
        defect = defect.at(equations, state)
    r = offset(state)
    size, last = defect.about[1], np.inf
    for _ in range(MOTION.steps):
        g = defect.motions[columns]
        gradient = g.T @ r[columns]
        second = defect.mixture.T @ _bend(equations, state, r, defect) @ defect.mixture
        # In the norm of GᵀG; negative eigenvalues are made positive, so that the step descends.
        try:
            root = np.linalg.cholesky(g.T @ g)
        except np.linalg.LinAlgError:
            n = int(columns.sum())
            what = f"the {n} datum coordinates cannot carry the datum where the iteration took them"
            raise DatumError(what, defect=g.shape[1]) from None
        half = np.linalg.solve(root, np.linalg.solve(root, second).T)
        values, vectors = np.linalg.eigh(np.eye(len(half)) + 0.5 * (half + half.T))
        along = vectors.T @ np.linalg.solve(root, gradient) / np.maximum(np.abs(values), 0.01)
        amounts = -np.linalg.solve(root.T, vectors @ along)
        motion = defect.motions @ amounts
        if is_negligible_motion(motion, state):
            break
        turn = float(np.linalg.norm((defect.mixture @ amounts)[3:])) / size
        amounts /= max(1.0, turn / MOTION.far)
        before = float(r @ r)
        certain = -float(gradient @ amounts) > MOTION.negligible * before
        way = float(np.abs(motion).max())
        if not certain and way > MOTION.shrinking * last:
            break  # points that run to infinity leave nothing but rounding
        last = way
        for _ in range(MOTION.halvings):
            moved = moved_by_similarity(equations, state, defect, amounts)
            r = offset(moved)
            if not certain or float(r @ r) < before:
                break
            amounts = 0.5 * amounts
        state = moved
        defect = defect.at(equations, state)
    return state


def _similarity(
    equations: Equations, state: State, start: State, defect: Defect, columns: Mask
) -> Array | None:
    """Return the amounts of the similarity that makes |x − x₀|² least; None: it may not be used.

    The similarity is used where the network has all seven defects, where every datum point has all
    its coordinates, and where only points, photos, their velocities, and frames move.
    """
    unknowns = equations.unknowns
    moved = {k for k, _ in unknowns.active() if UNKNOWNS[k].motions is not None}
    if defect.size < len(MOTION_NAMES) or moved - {"point", "pose", "frame", "photo_motion"}:
        return None
    table = unknowns["point"]
    on = np.flatnonzero(table.offset >= 0)
    chosen = columns[table.offset[on, None] + np.arange(3)]
    if not np.array_equal(chosen.any(axis=1), chosen.all(axis=1)):
        return None
    numbers = on[chosen.all(axis=1)]
    centre, size = defect.about
    by = fit_similarity(state["point"][numbers] - centre, start["point"][numbers] - centre)
    if not by.scale > 0:
        return None
    turn = log_rotation(by.rotation[None])[0]
    motion = np.concatenate([by.shift, size * turn, [size * np.log(by.scale)]])
    return np.asarray(np.linalg.solve(defect.mixture, motion))


def is_negligible_motion(motion: Array, state: State) -> bool:
    """Return whether a motion (n_columns,) is zero to working precision."""
    extent = 1.0 + float(np.abs(state["point"]).max())
    return float(np.abs(motion).max()) < MOTION.carried * extent


def _bend(equations: Equations, state: State, r: Array, defect: Defect) -> Array:
    """Return Σ r ∂²X/∂(seven motions)² of the points, (7, 7).

    X = c + e^s R q, q = X − c: rotations rᵀ(ω × (ω × q)), rotation and scale rᵀ(ω × q),
    scale rᵀq.
    """
    centre, size = defect.about
    table = equations.unknowns["point"]
    on = np.flatnonzero(table.offset >= 0)
    rows = r[table.offset[on, None] + np.arange(3)]
    q = state["point"][on] - centre
    s = rows.T @ q
    out = np.zeros((7, 7))
    out[3:6, 3:6] = 0.5 * (s + s.T) - np.trace(s) * np.eye(3)
    out[3:6, 6] = out[6, 3:6] = np.cross(q, rows).sum(axis=0)
    out[6, 6] = np.trace(s)
    return out / size**2


def held_gradient(normal: NormalEquations, defects: tuple[Defect, ...], constraint: Array) -> Array:
    """Return AᵀPv with the forces that a minimal datum exerts on what it holds, (n_columns,).

    Observations may be a little sensitive to a datum defect, such as a turn by the convergence of
    meridians. A term on the diagonal of N does not hold the network against them: every step would
    follow them a little, and none would be the last. The forces f on the held columns make Gᵀ (AᵀPv
    − f) = 0, so that the network stays where it is held. Where no observation is sensitive to the
    defect they are zero.

    Args:
        normal: the normal equations at a state.
        defects: the datum defect.
        constraint: terms that the minimal datum adds to the diagonal of N, (n_columns,).
    """
    held = np.flatnonzero(constraint)
    if len(defects) != 1 or not len(held):
        return normal.gradient
    motions = defects[0].at(normal.system.equations, normal.state).motions
    out = normal.gradient.copy()
    out[held] -= np.linalg.lstsq(motions[held].T, motions.T @ out, rcond=None)[0]
    return out


@dataclass(frozen=True)
class NetworkOnConstraints:
    """A free network after its motion onto the inner constraints."""

    state: State
    """Values of all variables."""
    normal: NormalEquations | None
    """Normal equations at the state; None: they have not been made."""
    defects: tuple[Defect, ...]
    """Datum defect at the state, or the last one on the way."""
    datum: FreeDatum
    """The inner constraints."""
    at_rest: bool
    """Whether the network has converged, on the constraints."""
    left: float = 0.0
    """Bound of the step from the state relative to σ, where the network has converged."""


def network_on_constraints(
    equations: Equations,
    state: State,
    start: State,
    datum: FreeDatum,
    defects: tuple[Defect, ...],
    *,
    normal_at: Callable[[State], NormalEquations],
    step: Callable[[NormalEquations], Step | None],
    tolerance: float,
    at_rest: bool,
    free: bool = True,
) -> NetworkOnConstraints:
    """Move a solution onto inner constraints.

    The motions of the defect are renewed at every state, as inner constraints and covariances
    belong to the motions at the solution.

    Args:
        equations: the network.
        state: a solution on any minimal datum.
        start: x₀, to which the constraints refer.
        datum: the constraints; their columns are kept.
        defects: the defect at ``state``.
        normal_at: function that makes the normal equations at a state.
        step: function that returns a step of the adjustment; None: the system is singular.
        tolerance: bound of the step relative to σ at which a state has converged.
        at_rest: whether ``state`` has converged, or as far as rounding allows; steps that do not
            shrink, or that are below the resolution of the coordinates, are then accepted as
            rounding. A state that has not converged may have points on their way to infinity: it is
            moved once.
        free: as in `find_defects`.
    """
    enough, left = tolerance, 0.0
    before, last, lowest = state, np.inf, np.inf
    for _ in range(MOTION.transformations if at_rest else 1):
        normal = normal_at(state)
        found = find_defects(normal.system, state, normal.diagonal, free=free)
        if len(found) != 1 or found[0].size != datum.motions.shape[1]:
            return NetworkOnConstraints(state, normal, defects, datum, False)
        defects = tuple(found)
        datum = FreeDatum(found[0].motions, datum.columns)
        if at_rest:
            next_step = step(normal)
            if next_step is not None:
                left = next_step.bound
                if left > max(enough, normal.resolution):
                    vtpv = normal.system.vtpv
                    blurred = last < MOTION.near and last**2 < MOTION.blurred * (1.0 + vtpv)
                    # Gauss-Newton leads away from a minimum at which second derivatives matter.
                    away = vtpv > lowest and left > last
                    if away or (blurred and left > STOPPING.shrinking * last):
                        state, enough = before, MOTION.again * last  # it was as good
                    else:
                        before, last, lowest = state, left, vtpv
                        state = equations.unknowns.retract(state, next_step.movement)
                    continue
                last = lowest = np.inf
        amounts = datum.project(displacement_from_start(equations, state, start))
        if is_negligible_motion(datum.motions @ amounts, state):
            return NetworkOnConstraints(state, normal, defects, datum, at_rest, left)
        moved = state_on_constraints(equations, state, start, found[0], datum.columns)
        if moved is state:  # the remaining motion is rounding of the motion's own equations
            return NetworkOnConstraints(state, normal, defects, datum, at_rest, left)
        state = moved
    return NetworkOnConstraints(state, None, defects, datum, False)
