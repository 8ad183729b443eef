"""Leverages A Q Aᵀ of all observations and clusters, of free networks too; A₂ N₂₂⁻¹ A₂ᵀ of points.

With whitened rows A of an observation, its hat matrix H = A Q Aᵀ needs only the joint covariance
of the observation's own variables. The selected inverse of the fronts gives it; the elimination
itself gives those of points that only cameras see: with U = L⁻¹A_pᵀ and M = W Σ_b of
the point (`ReducedPoints.joint`),

    Q_p Aᵀ = L⁻ᵀ (K U − Z),   H = A_b Σ_b A_bᵀ − UᵀZ − ZᵀU + UᵀK U,   K = I + W Σ_b Wᵀ,
    Z = M A_bᵀ.

El-Hakim (1986), eqs. 4 to 6, with X2 = object points and X1 = everything else, splits H:
e1 = A1 Q11 A1ᵀ (Q11 = ξ⁻¹), e2 = A2 N22⁻¹ A2ᵀ, e12 the rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..models.unknown_registry import VariableKind
from ..types import NO_ROWS, Array, Index, Mask
from .datum_defects import FreeDatum, minimal_datum
from .elimination_layers import RULE
from .factorisation import EliminationPlan, Factorisation, PreparedElimination
from .linearised_equations import LinearBlock, LinearisedEquations
from .linearised_rays import LinearRays
from .point_elimination import factorise_points
from .point_rays import PointRays
from .ray_leverages import first_layer_leverages, single_point_hats, spoke_leverages
from .reduced_system import Nodes

MAX_ELEMENTS_AT_ONCE = 8_000_000
"""Largest number of elements of joint covariances in memory at once."""
ONLY_POINTS: tuple[VariableKind, ...] = ("point",)
MIN_CANCELLING_SUM = 1e3
"""Value of Σ |a| σ over the unknowns of a whitened observation above which the sum A Q Aᵀ ≤ 1 loses
six digits and more by cancellation."""
MAX_MOTION_OUTSIDE_POINTS = 1e-9
"""Relative length of the part of a datum motion outside the points below which the motion counts
as moving points alone."""


@dataclass(frozen=True)
class BlockLeverage:
    """Leverages of the observations of a block, whitened; zero for members of clusters."""

    hat: Array
    """H = A Q Aᵀ of each observation, (n, d, d)."""
    others: Array
    """A1 Q11 A1ᵀ, the part of all unknowns but the points, (n, d, d)."""
    own: Array
    """Q_p Aᵀ for the coordinates of each observation's own points, (n, 3 × points, d); metres."""


@dataclass(frozen=True)
class ClusterLeverage:
    """Leverages of correlated rows across observations, or of a factor that the user added."""

    hat: Array
    """H, (k, k)."""
    others: Array
    """A1 Q11 A1ᵀ, (k, k)."""
    columns: Index
    """Columns that the rows touch, (m,)."""
    own: Array
    """Q Aᵀ for these columns, (m, k)."""


@dataclass(frozen=True)
class Leverages:
    """A Q Aᵀ of all observations."""

    blocks: tuple[BlockLeverage, ...]
    """Leverages of each block."""
    clusters: tuple[ClusterLeverage, ...]
    """Leverages of each cluster."""
    extra: tuple[ClusterLeverage, ...]
    """Leverages of each factor that the user added."""

    @property
    def hats(self) -> tuple[list[Array], list[Array]]:
        """Hat matrices H of the blocks and of the clusters."""
        return [b.hat for b in self.blocks], [c.hat for c in self.clusters]


def leverages(
    system: LinearisedEquations, factor: Factorisation, transform: STransform | None
) -> Leverages:
    """Compute A Q Aᵀ of all observations.

    Args:
        system: the linearised network.
        factor: its normal equations, factorised; with a minimal datum where it has a defect.
        transform: S-transformation onto the inner constraints of a free network. H does not
            depend on the datum; the parts of single unknowns do.
    """
    reduced = factor.ray_covariances()
    blocks = []
    parts = _split(system, reduced, factor)
    for place, lb in enumerate(system.blocks):
        out = _empty(lb)
        _, outer = parts[place]
        if len(outer):
            _from_fronts(lb, outer, factor, out)
        blocks.append(out)
    if factor.points is not None and reduced is not None:
        for found in first_layer_leverages(factor.points, reduced, factor.inverse):
            out = blocks[found.place]
            out.hat[found.rows] = found.hat
            out.others[found.rows] = found.others
            out.own[found.rows] = found.own
    clusters = _of_clusters(system, factor)
    extra = [_dense(e.columns, e.a, factor, system) for e in system.extra]
    if transform is not None:
        transform.blocks(system, blocks)
        clusters = [
            transform.dense(system, columns, a, c)
            for (columns, a), c in zip(system.cluster_rows(), clusters, strict=True)
        ]
        extra = [
            transform.dense(system, e.columns, e.a, c)
            for e, c in zip(system.extra, extra, strict=True)
        ]
    return Leverages(tuple(blocks), tuple(clusters), tuple(extra))


def point_leverages(
    system: LinearisedEquations, factor: Factorisation, datum: FreeDatum | None
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Return A2 N22⁻¹ A2ᵀ of every block (n, d, d), and of every cluster (k, k), whitened.

    N22 is the normal matrix of the object points with all other unknowns held. Where N22 is
    singular (a free network whose datum the other unknowns do not share), any generalised inverse
    gives the same A2 N22⁻¹ A2ᵀ.
    """
    only = system.only(ONLY_POINTS)
    parts = _split(system, None if factor.points is None else True, factor)
    blocks = []
    for lb in only.blocks:
        n, d = lb.block.observed.shape
        blocks.append(np.zeros((n, d, d)))
    alone = _points_alone(system, only, factor, datum)
    if alone is not None and alone.points is not None:
        # Points of the first layer are sighted from other points.
        joint = alone.ray_covariances()
        assert joint is not None
        for sight in spoke_leverages(alone.points, joint, alone.inverse):
            blocks[sight.place][sight.rows] = sight.hat
    elif factor.points is not None:
        # Without the terms that a minimal datum adds to the diagonal of a point.
        sums = factor.points.sums
        single, _ = factorise_points(sums, np.zeros(system.unknowns.n_columns))
        for place, rows, hat in single_point_hats(factor.points, single):
            blocks[place][rows] = hat
    for place, lb in enumerate(only.blocks):
        _, outer = parts[place]
        if len(outer) and alone is not None:
            scratch = _empty(lb)
            _from_fronts(lb, outer, alone, scratch)
            blocks[place][outer] = scratch.hat[outer]
    clusters = [np.zeros((len(c.rows),) * 2) for c in only.equations.clusters]
    for c in only.clusters:
        if alone is None:
            break
        for some in _chunks(np.arange(len(c.a)), max(1, c.a.shape[2] ** 2)):
            a = c.a[some]
            hat = a @ alone.joint(c.columns[some]) @ a.transpose(0, 2, 1)
            for i, number in enumerate(c.batch.numbers[some].tolist()):
                clusters[number] = hat[i]
    return tuple(blocks), tuple(clusters)


# -- covariances of the rows ----------------------------------------------------------------------


def _empty(lb: LinearBlock | LinearRays) -> BlockLeverage:
    n, d = lb.block.observed.shape
    points = sum(kind == "point" for kind, _ in lb.block.variables)
    return BlockLeverage(np.zeros((n, d, d)), np.zeros((n, d, d)), np.zeros((n, 3 * points, d)))


def _split(
    system: LinearisedEquations, reduced: object, factor: Factorisation
) -> list[tuple[Index, Index]]:
    """Return, for each block, its rows with points of the first layer and its other rows."""
    out = []
    clustered = system.equations.in_cluster
    for place, lb in enumerate(system.blocks):
        inner = np.zeros(lb.block.n, dtype=bool)
        if reduced is not None:
            for kind, index in lb.block.variables:
                if kind == "point":
                    inner |= factor.layers.reduced[index]
        outer = ~inner
        if place in clustered:
            outer[clustered[place]] = False
        out.append((np.flatnonzero(inner), np.flatnonzero(outer)))
    return out


def _from_fronts(
    lb: LinearBlock | LinearRays, rows: Index, factor: Factorisation, out: BlockLeverage
) -> None:
    """Fill in the rows whose variables are in the fronts."""
    first = lb.partials(rows[:1])
    slots = [j for j, a in enumerate(first) if len(a)]
    if not slots:
        return
    widths = [first[j].shape[2] for j in slots]
    kinds = np.repeat([lb.block.variables[j][0] == "point" for j in slots], widths)
    points = [j for j, (kind, _) in enumerate(lb.block.variables) if kind == "point"]
    ends = np.cumsum(widths)
    for chunk in _chunks(rows, int(ends[-1]) ** 2):
        columns = np.concatenate(
            [
                np.where(
                    lb.offsets[j][chunk, None] >= 0, lb.offsets[j][chunk, None] + np.arange(w), -1
                )
                for j, w in zip(slots, widths, strict=True)
            ],
            axis=1,
        )
        joint = factor.joint(columns)
        partials = lb.partials(chunk)
        a = np.concatenate([partials[j] for j in slots], axis=2)
        along = joint @ a.transpose(0, 2, 1)
        out.hat[chunk] = a @ along
        # Far from a minimum rounding may leave a variance below zero: that cancels, too.
        seen = np.abs(a) @ np.sqrt(np.abs(np.einsum("nkk->nk", joint)))[:, :, None]
        poor = np.flatnonzero(seen.max(axis=(1, 2)) > MIN_CANCELLING_SUM)
        for some in _chunks(poor, a.shape[1] * len(factor.nodes.columns)):
            out.hat[chunk[some]] = factor.squares(columns[some], a[some])
        if not kinds.all():
            a1 = a[:, :, ~kinds]
            out.others[chunk] = a1 @ joint[:, ~kinds][:, :, ~kinds] @ a1.transpose(0, 2, 1)
        for number, j in enumerate(points):
            if j in slots:
                i = slots.index(j)
                part = along[:, ends[i] - widths[i] : ends[i]]
                out.own[chunk, 3 * number : 3 * number + 3] = part


def _chunks(rows: Index, size: int) -> Iterator[Index]:
    step = max(1, MAX_ELEMENTS_AT_ONCE // size)
    for start in range(0, len(rows), step):
        yield rows[start : start + step]


def _of_clusters(system: LinearisedEquations, factor: Factorisation) -> list[ClusterLeverage]:
    """Return the leverages of every cluster, computed for all of one pattern at once."""
    out: dict[int, ClusterLeverage] = {}
    of_points = _of_points(system)
    for c in system.clusters:
        for some in _chunks(np.arange(len(c.a)), max(1, c.a.shape[2] ** 2)):
            columns, a = c.columns[some], c.a[some]
            joint = factor.joint(columns)
            own = joint @ a.transpose(0, 2, 1)
            hat = a @ own
            # A batch has one pattern: the same of its columns are those of points in all clusters.
            other = ~of_points[columns[0]]
            a1 = a[:, :, other]
            others = a1 @ joint[:, other][:, :, other] @ a1.transpose(0, 2, 1)
            for i, number in enumerate(c.batch.numbers[some].tolist()):
                out[number] = ClusterLeverage(hat[i], others[i], columns[i], own[i])
    return [out[number] for number in range(len(out))]


def _dense(
    columns: Index, a: Array, factor: Factorisation, system: LinearisedEquations
) -> ClusterLeverage:
    """Return the leverages of rows (k, m) over any number of columns (m,)."""
    joint = factor.joint(columns[None])[0]
    own = joint @ a.T
    other = ~_of_points(system)[columns]
    a1 = a[:, other]
    return ClusterLeverage(a @ own, a1 @ joint[np.ix_(other, other)] @ a1.T, columns, own)


def _of_points(system: LinearisedEquations) -> Mask:
    """Return which columns are coordinates of points, (n_columns,)."""
    out = np.zeros(system.unknowns.n_columns, dtype=bool)
    offset = system.unknowns["point"].offset
    out[offset[offset >= 0, None] + np.arange(3)] = True
    return out


# -- the points alone -----------------------------------------------------------------------------


def _points_alone(
    system: LinearisedEquations,
    only: LinearisedEquations,
    factor: Factorisation,
    datum: FreeDatum | None,
) -> Factorisation | None:
    """Return N22 of the points that are not in the first layer, factorised; None: there are none.

    Points of the first layer that are sighted from such points are in it.
    """
    layers = factor.layers
    unknowns = layers.unknowns
    offset = unknowns["point"].offset
    mine = np.flatnonzero((offset >= 0) & ~layers.reduced)
    if not len(mine):
        return None
    inside = np.zeros(unknowns.n_columns, dtype=bool)
    inside[offset[mine, None] + np.arange(3)] = True
    sighted = factor.points is not None and not factor.points.rays.photo_parts
    by_qr = layers.by_qr or (not sighted and len(mine) <= RULE.max_qr_variables)
    alone = replace(layers, in_fronts=inside, by_qr=by_qr, alone={}, kept=NO_ROWS)
    extra = np.zeros(unknowns.n_columns)
    if datum is not None:
        diagonal = only.diagonal()
        weighted = datum.motions * np.sqrt(system.diagonal())[:, None]
        points = _of_points(only)
        # Motions of the datum that move points alone.
        q, _ = np.linalg.qr(weighted)
        _, s, vt = np.linalg.svd(q[~points], full_matrices=True)
        still = np.ones(q.shape[1], dtype=bool)
        still[: len(s)] = s < MAX_MOTION_OUTSIDE_POINTS
        motions = q @ vt[still].T
        if motions.shape[1]:
            candidates = np.zeros(unknowns.n_columns, dtype=bool)
            candidates[offset[mine, None] + np.arange(3)] = True
            held = minimal_datum(motions, candidates & unknowns.free & (diagonal > 0))
            extra[held] = diagonal[held]
    nodes = Nodes(system.equations, alone)
    rays = PointRays(system.equations, nodes) if sighted else None
    joined = rays if rays is not None and rays.spokes is not None else None
    plan = EliminationPlan.joining(system.equations, nodes, joined)
    return PreparedElimination.of(only, plan).factorised(extra)


# -- free networks --------------------------------------------------------------------------------


@dataclass(frozen=True)
class STransform:
    """Q = S Q_min Sᵀ of a free network, S = I − B B_Dᵀ with B of `FreeDatum.basis`."""

    basis: Array
    """B (n_columns, d)."""
    cross: Array
    """F = Q_min B_D (n_columns, d)."""
    square: Array
    """E = B_Dᵀ F (d, d)."""

    def blocks(self, system: LinearisedEquations, blocks: list[BlockLeverage]) -> None:
        """Transform the parts of single unknowns of blocks, in place."""
        of_f = system.times(self.cross)
        others = system.only([k for k in system.unknowns.tables if k != "point"])
        g1, f1 = others.times(self.basis), others.times(self.cross)
        for lb, out in zip(system.blocks, blocks, strict=True):
            n, d = lb.block.observed.shape
            g, f, af = (x[lb.block.rows].reshape(n, d, -1) for x in (g1, f1, of_f))
            cross = f @ g.transpose(0, 2, 1)
            out.others[:] += (
                g @ self.square @ g.transpose(0, 2, 1) - cross - cross.transpose(0, 2, 1)
            )
            number = 0
            for (kind, _), offset in zip(lb.block.variables, lb.offsets, strict=True):
                if kind != "point":
                    continue
                on = np.flatnonzero(offset >= 0)
                moved = self.basis[offset[on, None] + np.arange(3)]
                out.own[on, 3 * number : 3 * number + 3] -= moved @ af[on].transpose(0, 2, 1)
                number += 1

    def dense(
        self, system: LinearisedEquations, columns: Index, a: Array, c: ClusterLeverage
    ) -> ClusterLeverage:
        """Return the transformed leverages of dense rows."""
        other = ~_of_points(system)[columns]
        g = a[:, other] @ self.basis[columns[other]]
        f = a[:, other] @ self.cross[columns[other]]
        others = c.others - f @ g.T - g @ f.T + g @ self.square @ g.T
        own = c.own - self.basis[columns] @ (a @ self.cross[columns]).T
        return ClusterLeverage(c.hat, others, c.columns, own)
