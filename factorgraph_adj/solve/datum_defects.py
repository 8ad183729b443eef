"""Motions of a network, datum defects of connected parts, minimal datum, S-transformation.

A similarity transformation of the object moves every variable in a known way (`generators`). The
combinations g of its seven motions that no observation notices, A g = 0, are the datum defects.
They are computed from the linearised observations, for each connected part.

A free network is solved with a minimal datum (one held component for each defect, chosen by
pivoting), and transformed to inner constraints over the datum points by an S-transformation:

    G_Dᵀ (x − x₀)_D = 0          Q = S Q_min Sᵀ,  S = I − G (G_DᵀG_D)⁻¹ G_Dᵀ

with G at the solution (`factorgraph_adj.solve.inner_constraints`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import numpy as np
from scipy.linalg import null_space, qr, solve_triangular
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..frames import LocalFrame
from ..graph.equations import Equations
from ..graph.variables import State, Variables
from ..models.datum_motions import Motions
from ..models.positions import heights
from ..models.unknown_registry import UNKNOWNS
from ..types import Array, Index, Mask
from .linearised_equations import LinearisedEquations
from .rigid_mounts import eased_ties
from .unnoticed_motions import (
    independent_motions,
    mean_motions,
    offsets_from_axes,
    rows_across_axes,
    stations_of,
    undirected_motions,
    unnoticed_motions,
    without_shrinking,
    without_turned_deflections,
    without_turns_about_axes,
)

Motion: TypeAlias = Literal[
    "shift in x",
    "shift in y",
    "shift in z",
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "scale",
]
"""The motions of a similarity transformation."""
MOTION_NAMES: tuple[str, ...] = get_args(Motion)
SHIFT_MOTIONS, ROTATION_MOTIONS, SCALE_MOTION = (0, 1, 2), (3, 4, 5), (6,)
MAX_ROUNDED_PART = 1e-6
"""Part of a motion in a defect below which it counts as rounding."""
MAX_UNNOTICED = 1e-9
"""Ratio |A g| / |√diag(N) g| below which a motion g counts as unnoticed; the ratio is 1 if the
unknowns are independent."""
MAX_UNNOTICED_FREE = 1e-7
"""Least ratio as `MAX_UNNOTICED` where a free network is requested; see `unnoticed_ratio`."""
MAX_UNNOTICED_BY_AZIMUTH = 3e-6
"""The same for azimuths on the curved Earth: geocentric coordinates round smaller ratios."""
CONVERGENCE_FACTOR = 10.0
"""Factor on D/R: largest sensitivity of azimuths to a shift along the Earth, by the convergence of
meridians, relative to that to a rotation: tan φ up to latitudes of 84°."""
SAGITTA_FACTOR = 4.0
"""Factor on D/R: largest sensitivity of heights above a surface to a scale, by the curvature of the
surface, relative to that to tilts: the sagitta d²/2R of a distance d up to 8 D."""
EARTH_E2 = 6.7e-3
"""Ratio of the sensitivity to a motion by the change of the vertical along an ellipsoid to the
sensitivity without an equal change on a sphere: the square of the Earth's eccentricity."""
Extent: TypeAlias = tuple[Array, float]
"""Centre (3,) of rotations and scale, and the mean distance from it, metres."""


def generators(equations: Equations, state: State, about: Extent | None = None) -> Array:
    """Return how seven motions of the object move the unknowns.

    Columns: shifts along x, y, z (1 m), rotations about axes through the centre of the points
    and scale about it (1 m at the mean distance of the points).

    Args:
        equations: the network.
        state: values of its variables.
        about: centre and mean distance; None: those of the points.

    Returns:
        G, (n_columns, 7).
    """
    unknowns = equations.unknowns
    motions = motions_of(equations, state, about)
    g = np.zeros((unknowns.n_columns, 7))
    for kind, table in unknowns.tables.items():
        record = UNKNOWNS[kind]
        on = np.flatnonzero(table.offset >= 0)
        if record.motions is not None and len(on):
            if record.at_stations:
                moved = mean_motions(equations, motions, kind, state[kind], on)
            else:
                moved = record.motions(motions, state[kind][on], stations_of(equations, kind, on))
            if record.held_motions is not None:
                moved = record.held_motions(
                    state[kind][on], moved, ~table.free[on], offsets_from_axes(equations, kind)[on]
                )
            for j in range(moved.shape[1]):
                has = j < table.size[on]
                g[table.offset[on[has]] + j] = moved[has, j]
    g[~unknowns.free] = 0.0
    return g


def motions_of(equations: Equations, state: State, about: Extent | None = None) -> Motions:
    """Return the seven motions of a network about a centre; None: the centre of the points."""
    unknowns = equations.unknowns
    centre, size = extent_of(state) if about is None else about
    verticals = unknowns["vertical"]
    which = np.array([verticals.number.get(n, 0) for n in unknowns["point"].names], dtype=np.intp)
    free: Mask = np.any(verticals.free, axis=1)
    return Motions(
        centre,
        size,
        equations.network.frame,
        state["point"],
        state["vertical"][which],
        free[which],
    )


def extent_of(state: State) -> Extent:
    """Return the centre of the points, and the root mean square of their distances from it.

    A network without points has the centre of its photos and distance 1.
    """
    points = state["point"]
    centre = points.mean(axis=0) if len(points) else state["pose"][:, 9:].mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1)))) if len(points) else 1.0
    return centre, size or 1.0


def connected_parts(equations: Equations) -> Index:
    """Return the connected part (n_columns,) of each column, by observations of geometry.

    Calibrations, refraction and distance meters do not connect: they carry no datum.
    """
    unknowns = equations.unknowns
    n = unknowns.n_columns
    left, right = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    for table in unknowns.tables.values():
        on = table.offset >= 0
        for j in range(1, table.free.shape[1]):
            has = on & (j < table.size)
            left.append(table.offset[has])
            right.append(table.offset[has] + j)
    for block in equations.blocks:
        offsets = [
            unknowns[kind].offset[index]
            for kind, index in block.variables
            if UNKNOWNS[kind].connects
        ]
        for i, a in enumerate(offsets):
            for b in offsets[i + 1 :]:
                both = (a >= 0) & (b >= 0)
                left.append(a[both])
                right.append(b[both])
    a, b = np.concatenate(left), np.concatenate(right)
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.intp)


def in_part(table: Variables, inside: Mask) -> Mask:
    """Return which variables have a column ``inside`` (n_columns,); held components have none."""
    out = np.zeros(len(table.offset), dtype=bool)
    for j in range(table.free.shape[1]):
        on = (table.offset >= 0) & (j < table.size)
        out[on] |= inside[table.offset[on] + j]
    return out


@dataclass(frozen=True)
class Defect:
    """Motions of one connected part that no observation notices."""

    part: Index
    """Columns of the part."""
    motions: Array
    """Unnoticed motions G (n_columns, d), zero outside the part."""
    mixture: Array
    """Coefficients of the unnoticed motions in the seven motions, (7, d)."""
    about: Extent
    """Centre and mean distance of the seven motions."""
    inside: Mask
    """Columns that the motions move, (n_columns,): those of the part, and the columns of shared
    variables if the network has one part."""

    @property
    def size(self) -> int:
        """Number of defects d."""
        return int(self.motions.shape[1])

    def at(self, equations: Equations, state: State) -> Defect:
        """Return the same motions at another state."""
        g = generators(equations, state, self.about)
        return replace(self, motions=np.where(self.inside[:, None], g, 0.0) @ self.mixture)

    def names(self) -> list[str]:
        """Return the plain motions in the defect, in the order of `MOTION_NAMES`.

        A rotation about a held point is a rotation and a shift of the centre; it is named as the
        rotation. Only what contains no rotation is named as a shift or a scale.
        """
        left = np.linalg.qr(self.mixture)[0]
        named: list[int] = []
        for some in (SHIFT_MOTIONS, ROTATION_MOTIONS, (*SCALE_MOTION, *SHIFT_MOTIONS)):
            if not left.shape[1]:
                break  # every motion has its name
            if some is SHIFT_MOTIONS:  # those that are in the defect without any other motion
                found = [i for i in some if np.linalg.norm(left[i]) > 1.0 - MAX_ROUNDED_PART]
            else:
                rows = [i for i in some if i not in named]
                r, order = qr(left[rows].T, mode="r", pivoting=True)
                rank = int(np.sum(np.abs(np.diag(r)) > MAX_ROUNDED_PART))
                found = [rows[i] for i in order[:rank].tolist()]
            if found:  # what is left has no part in the motions that have a name now
                left = left @ null_space(left[found])
            named += found
        return [MOTION_NAMES[i] for i in sorted(named)]


def find_defects(
    system: LinearisedEquations,
    state: State,
    diagonal: Array,
    *,
    free: bool,
    shrinking: bool = False,
) -> list[Defect]:
    """Return the datum defects of each connected part.

    Args:
        system: the linearised network.
        state: the state at which it was linearised.
        diagonal: diagonal of N, (n_columns,).
        free: whether a free network is requested.
        shrinking: whether a scale is unnoticed by residuals that only shrink with it.
    """
    unknowns = system.unknowns
    about = extent_of(state)
    g = generators(system.equations, state, about)
    label = connected_parts(system.equations)
    observed = diagonal > 0
    geometric = np.zeros(unknowns.n_columns, dtype=bool)
    for kind in ("point", "pose"):
        table = unknowns[kind]
        for i in np.flatnonzero(table.offset >= 0):
            geometric[table.offset[i] : table.offset[i] + table.size[i]] = True
    label = np.where(observed & unknowns.free, label, -1)
    connecting = np.concatenate(
        [
            np.full(int(table.size[table.offset >= 0].sum()), UNKNOWNS[kind].connects)
            for kind, table in unknowns.tables.items()
        ]
    )
    shared = ~geometric & ~connecting & unknowns.free & observed
    out = []
    ratio = unnoticed_ratio(system.equations, about, free=free)
    found = np.unique(label[geometric & (label >= 0)])
    for part in found:
        inside = (label == part) | (shared & (len(found) == 1))
        part_g = np.where(inside[:, None], g, 0.0)
        defect = _unnoticed(system, part_g, diagonal, ratio, about[1], shrinking=shrinking)
        if defect is not None:
            columns = np.flatnonzero(label == part)
            out.append(Defect(columns, part_g @ defect, defect, about, inside))
    return out


def unnoticed_ratio(equations: Equations, about: Extent, *, free: bool) -> float:
    """Return the ratio |A g| / |√diag(N) g| below which a motion g is a datum defect.

    A free network on the curved Earth may be shifted along it with all its verticals: on a sphere
    no observation is sensitive to that, and on the ellipsoid only by the square of its eccentricity
    times size / R. This determines the position only to within hundreds of metres or more; in a
    free network it is a defect, as on a plane. Observations of places (control, GNSS positions,
    astronomic ones, weighted values) and a user's factors count from `MAX_UNNOTICED_FREE` on,
    however weak they are beside the sights. So do azimuths, from `MAX_UNNOTICED_BY_AZIMUTH` on, for
    the direction of the network, but not for its latitude, by the convergence of meridians. Heights
    above surfaces do not count for scale, by the curvature of these (`SAGITTA_FACTOR`), nor do
    levelled frames with constant origins: their horizons differ by their distances / R, and do not
    turn with it.

    Args:
        equations: the network.
        about: centre of its points, and their mean distance from it, metres.
        free: whether a free network is requested.
    """
    centre, size = about
    if not free:
        return MAX_UNNOTICED
    if _flat(equations):
        return MAX_UNNOTICED_FREE
    stated = equations.network.frames.values()
    origins = [p.constants[:3] for p in stated if p.constants[3] and not p.origin]
    apart = [2.0 * float(np.linalg.norm(np.array(o) - centre)) for o in origins]
    return max(MAX_UNNOTICED_FREE, max([EARTH_E2 * size, *apart]) / equations.network.frame.radius)


def _unnoticed(
    system: LinearisedEquations,
    g: Array,
    diagonal: Array,
    threshold: float,
    size: float,
    *,
    shrinking: bool,
) -> Array | None:
    """Return the mixtures (7, d) of motions that no observation notices.

    Args:
        system: the linearised network.
        g: motions, (n_columns, 7).
        diagonal: diagonal of N, (n_columns,).
        threshold: limit of what is noticed, see `unnoticed_ratio`.
        size: mean distance of the points from their centre, metres.
        shrinking: as in `find_defects`.
    """
    diagonal, ease = eased_ties(system, diagonal)
    weighted = np.sqrt(diagonal)[:, None] * g
    length = np.linalg.norm(weighted, axis=0)
    real = independent_motions(weighted, length)
    if not real.any():
        return None
    # An orthonormal basis of the motions in the norm of the diagonal of N.
    _, s, vt = np.linalg.svd(weighted[:, real] / length[real], full_matrices=False)
    keep = s > 1e-9 * s[0]
    basis = (vt[keep].T / s[keep]) / length[real][:, None]
    among = g[:, real] @ basis
    radians = np.zeros((3, basis.shape[1]))
    turning = np.flatnonzero(real[3:6])
    radians[turning] = basis[np.cumsum(real)[3 + turning] - 1] / size
    changes = without_turns_about_axes(system, system.times(among))
    changes = without_turned_deflections(system, changes, radians)
    if shrinking:
        scale = basis[-1] / size if real[6] else np.zeros(basis.shape[1])
        changes = without_shrinking(system, changes, scale)
    noticed = ease[:, None] * changes
    every = np.eye(basis.shape[1])
    across = rows_across_axes(system)
    if across.any():
        every = unnoticed_motions(np.where(across[:, None], 0.0, noticed), every, threshold)
        every = undirected_motions(noticed[across], every, radians, None, (threshold, threshold))
        noticed = np.where(across[:, None], 0.0, noticed)
    if threshold < MAX_UNNOTICED_FREE or _flat(system.equations):
        null = unnoticed_motions(noticed, every, threshold)
    else:
        rows = _Rows.of(system)
        null = unnoticed_motions(np.where(rows.limited[:, None], 0.0, noticed), every, threshold)
        # Rows that determine the position count, however weak they are beside all others.
        null = unnoticed_motions(noticed[rows.places], null, MAX_UNNOTICED_FREE)
        # Sensitivity of azimuths and heights if their own unknowns did not move.
        held = noticed
        if rows.own.any():
            held = ease[:, None] * system.times(np.where(rows.own[:, None], 0.0, among))
        on_earth = size / system.equations.network.frame.radius
        middle_point = extent_of(system.state)[0][None]
        up = heights(system.equations.network.frame, middle_point)[1][0]
        # Azimuths come last: tilts from surfaces would mix with turns that they determine less.
        for which, factor, least in (
            (rows.surfaces, SAGITTA_FACTOR, threshold),
            (rows.azimuths & ~rows.constant, CONVERGENCE_FACTOR, MAX_UNNOTICED_BY_AZIMUTH),
            (rows.azimuths & rows.constant, CONVERGENCE_FACTOR, MAX_UNNOTICED_BY_AZIMUTH),
        ):
            sensitivity = held[which] @ null
            most = float(np.linalg.norm(sensitivity, 2)) if sensitivity.size else 0.0
            limit = max(least, factor * on_earth * most)
            if np.any(which & rows.constant & rows.azimuths):
                null = undirected_motions(noticed[which], null, radians, up, (least, limit))
            else:
                null = unnoticed_motions(noticed[which], null, limit)
    if null.shape[1] == 0:
        return None
    mixture = np.zeros((7, null.shape[1]))
    mixture[real] = basis @ null
    return np.asarray(mixture / np.linalg.norm(mixture, axis=0))


@dataclass(frozen=True)
class _Rows:
    """Sensitivity of rows to the position of a network on the curved Earth, extra rows last."""

    places: Mask
    """Whether they may determine the position: all but sights, heights and weighted tilts."""
    azimuths: Mask
    """Whether they are azimuths."""
    constant: Mask
    """Whether an unknown constant, or the unknown height of a surface, belongs to the row."""
    surfaces: Mask
    """Whether they are heights above level surfaces or surfaces of pressure."""
    own: Mask
    """Columns, (n_columns,), of the constants of azimuths and of the surfaces."""

    @property
    def limited(self) -> Mask:
        """Rows whose limits follow from their sensitivity if the own unknowns did not move."""
        return self.azimuths | self.surfaces

    @classmethod
    def of(cls, system: LinearisedEquations) -> _Rows:
        """Return the rows of a linearised network."""
        places = np.ones(len(system.every_residual), dtype=bool)
        azimuths, surfaces = np.zeros_like(places), np.zeros_like(places)
        constant = np.zeros_like(places)
        own = np.zeros(system.unknowns.n_columns, dtype=bool)
        for block in system.equations.blocks:
            sights = block.fixes in ("nothing", "direction") and not block.prior
            if sights or block.fixes == "horizon":
                places[block.rows] = False
            if block.prior:
                continue
            azimuths[block.rows] = block.fixes == "direction"
            standing = [(k, i) for k, i in block.variables if UNKNOWNS[k].on_earth]
            surfaces[block.rows] = bool(standing) and block.fixes == "nothing"
            for kind, index in standing:
                table = system.unknowns[kind]
                constant[block.rows] |= np.repeat(table.offset[index] >= 0, block.dimension)
                offset = table.offset[np.unique(index)]
                for j in range(table.free.shape[1]):
                    own[offset[offset >= 0] + j] = True
        return cls(places, azimuths, constant, surfaces, own)


def _flat(equations: Equations) -> bool:
    """Return whether a network is on a plane."""
    frame = equations.network.frame
    return isinstance(frame, LocalFrame) and not frame.curvature


def minimal_datum(motions: Array, datum: Mask) -> Index:
    """Choose one column to hold for each unnoticed motion, so that all motions are removed.

    Args:
        motions: G (n_columns, d), rows scaled by the precision of the observations, so that
            well-observed points are chosen.
        datum: columns to choose from, (n_columns,).
    """
    candidates = np.flatnonzero(datum & np.any(motions != 0, axis=1))
    _, _, order = qr(motions[candidates].T, mode="economic", pivoting=True)
    return np.asarray(candidates[order[: motions.shape[1]]], dtype=np.intp)


@dataclass(frozen=True)
class FreeDatum:
    """Inner constraints over datum points."""

    motions: Array
    """G, unnoticed motions (n_columns, d)."""
    columns: Mask
    """Coordinates of the datum points among the columns, (n_columns,)."""

    @cached_property
    def basis(self) -> Array:
        """B = G R⁻¹ (n_columns, d): the same motions with B_DᵀB_D = I.

        Cofactors are transformed with B, as the terms of a transformation with G lose many digits
        where columns of G_D are nearly parallel (one datum point lies far away).
        """
        r = np.linalg.qr(self.motions[self.columns], mode="r")
        return np.asarray(solve_triangular(r, self.motions.T, trans="T").T)

    @cached_property
    def masked(self) -> Array:
        """B_D, zero outside the datum points, (n_columns, d)."""
        return np.where(self.columns[:, None], self.basis, 0.0)

    def project(self, moved: Array) -> Array:
        """Return t such that G_Dᵀ (moved + G t)_D = 0, for moved = x − x₀ (n_columns,)."""
        on = self.motions[self.columns]
        return np.asarray(-np.linalg.inv(on.T @ on) @ (on.T @ moved[self.columns]))

    def transformed(
        self, block: Array, a: tuple[Array, Array], b: tuple[Array, Array], square: Array
    ) -> Array:
        """S-transform a block of cofactors Q_ab onto the inner constraints.

        Q_ab − B_a F_bᵀ − F_a B_bᵀ + B_a E B_bᵀ with F = Q B_D, E = B_DᵀF.

        Args:
            block: Q_ab, (..., k, l).
            a: B and F of its rows, (..., k, d) each.
            b: B and F of its columns, (..., l, d) each.
            square: E, (d, d).
        """
        gb = np.swapaxes(b[0], -1, -2)
        return np.asarray(block - a[0] @ np.swapaxes(b[1], -1, -2) - a[1] @ gb + a[0] @ square @ gb)
