"""Laws of reliability on every test network: real, textbook and simulated, fixed and free.

    Σ r = redundancy          r + e1 + e2 + e12 = 1          Σ e2 = rank A2
    0 ≤ r ≤ 1, e1 ≥ 0, e2 ≥ 0 without correlation; mean e2 = 1.5/n of a point with n rays alone

and r, w, τ, ∇, δ̄ do not depend on the datum of a free network, nor on the order of anything.

What is compared with the package is computed here from the whitened design matrix alone: e2 and
rank A2 by singular values of each connected part of the object points, e12 from its own formula.

Ladybug 49, whose minimum lies at infinity, has a test of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import gtsam
import numpy as np
import pytest
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

import factorgraph_adj as fga
from factorgraph_adj.factor_graph.network_graph import build_graph
from factorgraph_adj.io.photogrammetry.bundler import read_bal
from factorgraph_adj.observations import AnyObservation, Correlated
from factorgraph_adj.solve.datum_defects import Defect, minimal_datum
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array, Index, Mask
from tests.networks.adjusted import ADJUSTED, camcal_free, held_photos
from tests.networks.gama import FOLDER, solved
from tests.networks.simulated import NETWORKS, gnss
from tests.networks.small_block import small_block
from tests.support.dense import RANK, DenseReliability
from tests.support.places import data_dir

SUM = 1e-6
"""What Σ r may differ from the redundancy, and Σ e2 from the rank."""
ROUNDING = 1e-8
"""What double precision leaves of a single share."""
AT_REST = 1e-6
"""Part of σ by which two adjustments of one network may end apart; their tolerance is 1e-5, and
the last step squares what was left."""
CLOSER = 1e-7
"""Tolerance of blocks of photos whose shares are compared to `ROUNDING`: where points are far
away, r follows the last steps of the unknowns."""
DENSE = 1200
"""Rows up to which every row is compared with dense inverses."""
SAMPLE = 40
"""Rows that are compared in larger networks."""
T = TypeVar("T")


# -- networks -------------------------------------------------------------------------------------


LARGE = ("AICON", "Roma", "Ladybug, a cut")


def large(names: Iterable[str]) -> list[object]:
    """Return names of networks as parameters, the large ones marked."""
    mark = pytest.mark.slow(
        "thousands of observations, where sums gather rounding and rows are sampled instead of "
        "compared one and all"
    )
    return [pytest.param(name, marks=mark) if name in LARGE else name for name in names]


def extra_factor() -> fga.Solution:
    """The small block with two distances to a photo, as factors of GTSAM."""
    network = small_block(9)
    keys = build_graph(network).keys
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.01)
    pose, points = keys.key("pose", "F1"), [keys.key("point", n) for n in ("P1", "P6")]
    true = small_block_distances(network)
    factors = [
        gtsam.RangeFactor3D(pose, p, d + e, noise)
        for p, d, e in zip(points, true, (0.004, -0.007), strict=True)
    ]
    return fga.adjust(network, extra_factors=factors)


def small_block_distances(network: fga.Network) -> list[float]:
    solution = fga.adjust(network)
    centre = solution.pose("F1").position
    return [float(np.linalg.norm(solution.point(n) - centre)) for n in ("P1", "P6")]


def solution_of(name: str) -> fga.Solution:
    if name in FOLDER:
        return solved(name).solution
    return extra_factor() if name == "extra factors" else fga.adjust(ADJUSTED[name]())


# -- the whitened design matrix, and what comes from it alone -------------------------------------


def design(system: LinearisedEquations) -> csr_array:
    """Return the whitened A (rows, n_columns), rows of extra factors at the end."""
    rows, columns, values = [], [], []
    clustered = system.equations.in_cluster
    for place, lb in enumerate(system.blocks):
        single = np.ones(lb.block.n, dtype=bool)
        single[clustered.get(place, [])] = False
        d = lb.block.dimension
        for offset, a in zip(lb.offsets, lb.a, strict=True):
            if not len(a):
                continue
            on = np.flatnonzero(single & (offset >= 0))
            row = lb.block.first_row + on[:, None] * d + np.arange(d)
            column = offset[on, None] + np.arange(a.shape[2])
            rows.append(np.broadcast_to(row[:, :, None], a[on].shape).ravel())
            columns.append(np.broadcast_to(column[:, None, :], a[on].shape).ravel())
            values.append(a[on].ravel())
    dense = [
        (c.rows, *found)
        for c, found in zip(system.equations.clusters, system.cluster_rows(), strict=True)
    ]
    first = system.equations.n_rows
    for e in system.extra:
        dense.append((first + np.arange(len(e.a)), e.columns, e.a))
        first += len(e.a)
    for row, column, a in dense:
        rows.append(np.repeat(row, len(column)))
        columns.append(np.tile(column, len(row)))
        values.append(a.ravel())
    at = (np.concatenate(rows), np.concatenate(columns))
    out = coo_array((np.concatenate(values), at), shape=(first, system.unknowns.n_columns))
    found = csr_array(out)
    found.eliminate_zeros()
    return found


def leverage(a: csr_array) -> tuple[Array, int]:
    """Return diag(A N⁻ Aᵀ) (rows,) and the rank of A, by singular values of its connected parts."""
    n, m = a.shape
    coo = coo_array(a)
    edges = (np.ones(coo.nnz, dtype=np.int8), (coo.row, n + coo.col))
    label = connected_components(coo_array(edges, shape=(n + m,) * 2), directed=False)[1]
    _, label = np.unique(label, return_inverse=True)
    parts = int(label.max()) + 1

    def places(which: Array) -> tuple[Array, Array]:
        """Return the place of each node within its part, and the sizes of the parts."""
        size = np.bincount(which, minlength=parts)
        order = np.argsort(which, kind="stable")
        place = np.empty(len(which), dtype=np.intp)
        place[order] = np.arange(len(which)) - np.repeat(np.cumsum(size) - size, size)
        return place, size

    (row, height), (column, width) = places(label[:n]), places(label[n:])
    hat, rank = np.zeros(n), 0
    for h, w in np.unique(np.stack([height, width], 1), axis=0).tolist():
        if not h or not w:
            continue
        alike = (height == h) & (width == w)
        number = np.cumsum(alike) - 1
        on = alike[label[coo.row]]
        part = np.zeros((int(alike.sum()), h, w))
        r, c = coo.row[on], coo.col[on]
        part[number[label[r]], row[r], column[c]] = coo.data[on]
        length = np.linalg.norm(part, axis=1, keepdims=True)
        u, s, _ = np.linalg.svd(part / np.where(length > 0, length, 1.0), full_matrices=False)
        seen = s > RANK * s.max(axis=1, keepdims=True, initial=1e-300)
        rank += int(seen.sum())
        rows = np.flatnonzero(alike[label[:n]])
        of_row = np.sum(u**2 * seen[:, None, :], axis=2)
        hat[rows] = of_row[number[label[rows]], row[rows]]
    return hat, rank


@dataclass(frozen=True, eq=False)
class Case:
    solution: fga.Solution
    rel: fga.Reliability

    @classmethod
    def of(cls, solution: fga.Solution) -> Case:
        return cls(solution, fga.reliability(solution))

    @property
    def system(self) -> LinearisedEquations:
        return self.solution.normal().system

    @cached_property
    def uncorrelated(self) -> Mask:
        """Rows without any correlation, (n,)."""
        equations = self.solution.equations
        out = np.ones(equations.n_rows, dtype=bool)
        for block in equations.blocks:
            out[block.rows] = block.whitener is None
        for cluster in equations.clusters:
            out[cluster.rows] = False
        return out

    @cached_property
    def points(self) -> Mask:
        """Columns that are coordinates of object points, (n_columns,)."""
        unknowns = self.solution.equations.unknowns
        out = np.zeros(unknowns.n_columns, dtype=bool)
        first = unknowns["point"].offset
        out[first[first >= 0, None] + np.arange(3)] = True
        return out

    @cached_property
    def a(self) -> csr_array:
        return design(self.system)

    @cached_property
    def points_alone(self) -> tuple[Array, int]:
        """diag(A2 N22⁻ A2ᵀ) of the whitened rows, and the rank of A2."""
        a2 = csr_array(self.a.multiply(self.points[None, :]))
        a2.eliminate_zeros()
        return leverage(a2)

    @cached_property
    def rays(self) -> tuple[Index, Mask]:
        """Number of rays of each point, and whether it is free and nothing else observes it."""
        equations = self.solution.equations
        table = equations.unknowns["point"]
        rays = np.zeros(len(table.names), dtype=np.intp)
        alone = np.all(table.free, axis=1)
        for block in equations.blocks:
            for kind, index in block.variables:
                if kind == "point" and block.kind == "image":
                    rays += np.bincount(index, minlength=len(rays))
                elif kind == "point":
                    alone[index] = False
        for extra in self.system.extra:
            alone &= ~np.isin(table.offset, extra.columns)
        return rays, alone


@pytest.fixture(scope="module", params=large([*sorted(FOLDER), *ADJUSTED, "extra factors"]))
def case(request: pytest.FixtureRequest) -> Case:
    solution = solution_of(request.param)
    assert solution.converged, solution.reason
    return Case.of(solution)


# -- sums -----------------------------------------------------------------------------------------


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
def test_redundancy_numbers_sum_to_the_redundancy(case: Case) -> None:
    total = case.rel.redundancy_numbers.sum() + case.rel.redundancy_of_extra_factors
    assert total == pytest.approx(case.solution.redundancy, abs=SUM)


def test_what_goes_into_the_points_is_what_they_alone_absorb_and_sums_to_their_rank(
    case: Case,
) -> None:
    """E2 = diag(A2 N22⁻¹ A2ᵀP); Σ over all rows, those of extra factors too, is rank A2."""
    hat, rank = case.points_alone
    n = len(case.rel.e2)
    on = case.uncorrelated
    np.testing.assert_allclose(case.rel.e2[on], hat[:n][on], rtol=0, atol=ROUNDING)
    assert case.rel.e2.sum() + hat[n:].sum() == pytest.approx(rank, abs=SUM)


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
def test_every_error_goes_somewhere(case: Case) -> None:
    """R + e1 + e2 + e12 = 1, e12 = 2 A1 Q12 A2ᵀP + A2 (Q22 − N22⁻¹) A2ᵀP from its formula."""
    rel = case.rel
    if len(rel.w) <= DENSE and not case.system.extra:
        rows = np.arange(len(rel.w))
        e12 = DenseReliability.of(case.solution).e12
    else:
        assert case.uncorrelated.all()
        rng = np.random.default_rng(1)
        rows = rng.choice(len(rel.w), SAMPLE, replace=False)
        a = case.a[rows].toarray().T
        a1, a2 = a * ~case.points[:, None], a * case.points[:, None]
        q_a2 = case.solution.cofactor_times(a2)
        e12 = 2.0 * np.sum(a1 * q_a2, axis=0) + np.sum(a2 * q_a2, axis=0)
        e12 -= case.points_alone[0][rows]
    total = rel.redundancy_numbers[rows] + rel.e1[rows] + rel.e2[rows] + e12
    np.testing.assert_allclose(total, 1.0, rtol=0, atol=ROUNDING * max(1.0, np.abs(e12).max()))
    np.testing.assert_allclose(
        rel.e12[rows], e12, rtol=0, atol=ROUNDING * max(1.0, np.abs(e12).max())
    )


# -- bounds ---------------------------------------------------------------------------------------


def test_shares_lie_between_zero_and_one_without_correlation(case: Case) -> None:
    rel, on = case.rel, case.uncorrelated
    for share in (rel.redundancy_numbers[on], rel.e2[on]):
        assert np.all((share >= -ROUNDING) & (share <= 1.0 + ROUNDING))
    assert np.all(rel.e1[on] >= -ROUNDING)


def test_groups_with_correlation_have_redundancy_from_zero_to_their_size(case: Case) -> None:
    """Single components may leave 0 to 1, the trace of the whole group may not."""
    groups = case.rel.groups
    assert bool(groups) == (not case.uncorrelated.all())
    # Of a cluster there is a group for each observation in it, and one for the whole.
    correlated = [
        (block.first_row + block.dimension * i + np.arange(block.dimension))
        for block in case.solution.equations.blocks
        for i in range(block.n if block.whitener is not None else 0)
    ]
    clusters = [c.rows for c in case.solution.equations.clusters]
    inside = set(np.concatenate([*clusters, np.zeros(0, dtype=int)]).tolist())
    whole = [rows for rows in correlated if rows[0] not in inside] + clusters
    found = {tuple(g.rows.tolist()): g for g in groups}
    for rows in whole:
        group = found[tuple(rows.tolist())]
        r = case.rel.redundancy_numbers[rows].sum()
        assert -ROUNDING <= r <= len(rows) + ROUNDING
        assert group.redundancy == pytest.approx(r, abs=ROUNDING)
        assert r <= group.dof + ROUNDING * len(rows)


def test_uncontrolled_observations_have_no_test_and_no_limit(case: Case) -> None:
    rel = case.rel
    off = ~rel.controlled
    for values in (rel.w, rel.tau, rel.estimated_errors):
        assert np.all(np.isnan(values[off])) and np.all(np.isfinite(values[~off]))
    for values in (rel.mdb, rel.delta_bar):
        assert np.all(np.isinf(values[off])) and np.all(np.isfinite(values[~off]))
    on = case.uncorrelated
    assert np.all(np.abs(rel.redundancy_numbers[on & off]) <= 1e-6)


def test_a_point_of_n_rays_alone_takes_one_and_a_half_nth_of_an_error_on_average(
    case: Case,
) -> None:
    """Σ of e2 over its 2n coordinates is 3, whatever the geometry (El-Hakim 1986)."""
    rays, alone = case.rays
    total = np.zeros(len(rays))
    for block in case.solution.equations.blocks:
        if block.kind == "image":
            index = dict(block.variables)["point"]
            both = case.rel.e2[block.rows].reshape(-1, 2).sum(axis=1)
            total += np.bincount(index, weights=both, minlength=len(rays))
    on = alone & (rays > 0)
    if case.solution.network.n_image_points and not case.solution.network.observations:
        assert on.any()
    np.testing.assert_allclose(total[on] / (2 * rays[on]), 1.5 / rays[on], rtol=0, atol=ROUNDING)


# -- what the figures do not depend on ------------------------------------------------------------


def assert_same_figures(
    ours: fga.Reliability,
    theirs: fga.Reliability,
    rows: Index,
    names: Iterable[str] = ("redundancy_numbers", "e2"),
) -> None:
    """Compare r, e2, w, τ, ∇, δ̄ and estimated errors with those of the rows of another.

    A rounding of r makes half of it over r of w, τ and ∇; what is left to the minimum, in σ,
    enters w and the estimated error over √r.
    """
    for name in names:
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name)[rows], rtol=0, atol=ROUNDING, err_msg=name
        )
    on = ours.controlled
    np.testing.assert_array_equal(on, theirs.controlled[rows])
    share = np.clip(np.abs(ours.redundancy_numbers), 1e-6, 1.0)[on]
    step = AT_REST / np.sqrt(share)

    def close(name: str, relative: Array, absolute: Array | float) -> None:
        a, b = getattr(ours, name)[on], getattr(theirs, name)[rows][on]
        assert np.all(np.abs(a - b) <= relative * np.abs(b) + absolute), name

    close("w", ROUNDING / share, step)
    close("tau", ROUNDING / share + AT_REST, step / ours.solution.sigma0)
    close("mdb", ROUNDING / share, 0.0)
    close("estimated_errors", ROUNDING / share, step / np.sqrt(ours.precision[on]))
    a, b = ours.delta_bar[on] ** 2, theirs.delta_bar[rows][on] ** 2
    assert np.all(np.abs(a - b) <= 40 * ROUNDING / share * (1 + b))


def gnss_free() -> fga.Network:
    """The vectors alone: three defects, correlations, a cluster."""
    network = gnss()
    network.observations = {
        i: o for i, o in network.observations.items() if o.kind in ("gnss_vector", "slope_distance")
    }
    network.datum = "free"
    return network


FREE: dict[str, Callable[[], fga.Network]] = {
    **{
        f"Gama {n}": lambda n=n: solved(n).network
        for n in (
            "2020-barta-phase_0-1TK",
            "2020-barta-phase_0-2TK",
            "local_3d",
            "Hoepke_Distance_free",
            "LotherStrehle_Direction4",
            "Wolf_DistanceDirectionAngle_free",
        )
    },
    **{
        n: NETWORKS[n]
        for n in (
            "levelling, free",
            "total station, free",
            "total station, free, verticals",
            "combined block, free",
            "images, free",
        )
    },
    "gnss, free": gnss_free,
    "camcal, free": camcal_free,
    "AICON": ADJUSTED["AICON"],
    "Ladybug, a cut": ADJUSTED["Ladybug, a cut"],
}


def adjust_closely(network: fga.Network, start: fga.Solution) -> fga.Solution:
    tolerance = {"tolerance": CLOSER} if network.photos else {}
    return fga.adjust(network, start=start, **tolerance)


@pytest.fixture(scope="module", params=large(FREE))
def free(request: pytest.FixtureRequest) -> Case:
    network = FREE[request.param]()
    # Weights that depend on the lengths of sights belong to where an adjustment starts.
    solution = fga.adjust(network, start=fga.adjust(network))
    solution = adjust_closely(network, solution)
    assert solution.converged and solution.datum_defect
    return Case.of(solution)


def other_datum_points(solution: fga.Solution) -> fga.Network:
    """Return the network with half of its points as datum points, other ones than before."""
    network = solution.network.copy()
    names = [n for n, p in network.points.items() if not all(p.fixed)]
    before = {n for n in names if network.points[n].datum} or set(names)
    rng = np.random.default_rng(len(names))
    most = max(len(names) // 2, min(len(names) - 1, 4))
    chosen = set(rng.permutation(names)[:most].tolist())
    assert chosen != before
    network.points = {n: replace(p, datum=n in chosen) for n, p in network.points.items()}
    return network


def minimally_held(solution: fga.Solution) -> fga.Network:
    """Return the network with one coordinate held, where it is, for each defect."""
    network = solution.network.copy()
    unknowns = solution.equations.unknowns
    assert solution.datum is not None
    weighted = solution.datum.motions * np.sqrt(solution.normal().diagonal)[:, None]
    columns = unknowns.free & Case.of(solution).points
    held = set(minimal_datum(weighted, columns).tolist())
    assert len(held) == solution.datum_defect
    for number, (name, p) in enumerate(list(network.points.items())):
        first = unknowns["point"].offset[number]
        now = tuple(f or first + i in held for i, f in enumerate(p.fixed))
        if now != p.fixed:
            at = tuple(solution.point(name).tolist())
            network.points[name] = replace(p, fixed=now, coordinates=at)
    network.datum = "given"
    return network


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize("other", [other_datum_points, minimally_held])
def test_the_datum_of_a_free_network_does_not_matter(
    free: Case, other: Callable[[fga.Solution], fga.Network]
) -> None:
    """Other datum points, or one held coordinate for each defect instead of inner constraints."""
    again = adjust_closely(other(free.solution), free.solution)
    assert again.converged and again.redundancy == free.solution.redundancy
    theirs = fga.reliability(again)
    names = ("redundancy_numbers", "e2")[: 1 if other is minimally_held else 2]
    assert_same_figures(free.rel, theirs, np.arange(len(theirs.w)), names)
    for a, b in zip(free.rel.groups, theirs.groups, strict=True):
        assert (a.ids, a.dof) == (b.ids, b.dof)
        assert a.test == pytest.approx(b.test, rel=1e-6)
        assert a.external == pytest.approx(b.external, rel=1e-6)


def order(items: Iterable[T], rng: np.random.Generator) -> list[T]:
    listed = list(items)
    return [listed[i] for i in rng.permutation(len(listed))]


def shuffled(network: fga.Network, seed: int) -> fga.Network:
    """Return the same network, added in another order: points, photos, observations, clusters."""
    rng = np.random.default_rng(seed)
    out = fga.Network(network.name, frame=network.frame, datum=network.datum)
    for p in order(network.points.values(), rng):
        axes = "".join(a for a, held in zip("xyz", p.fixed, strict=True) if held)
        out.add_point(
            p.name, p.coordinates, fixed=axes, sigma=p.sigma, datum=p.datum, check=p.check
        )
    out.cameras = dict(order(network.cameras.items(), rng))
    for f in order(network.photos.values(), rng):
        out.add_photo(
            f.name,
            f.camera,
            position=f.position,
            rotation=f.rotation,
            fixed=f.fixed,
            sigma_position=f.sigma_position,
            sigma_attitude=f.sigma_attitude,
        )
    for name in ("orientations", "refractions", "verticals", "distance_meters"):
        setattr(out, name, dict(order(getattr(network, name).items(), rng)))
    named = {i: replace(o, id=i) for i, o in network.observations.items()}
    items: list[AnyObservation] = []
    for ids, covariance in network.clusters:
        places = rng.permutation(len(ids))
        size = len(covariance) // len(ids)
        at = (places[:, None] * size + np.arange(size)).ravel()
        items.append(
            Correlated(tuple(named.pop(ids[i]) for i in places), covariance[np.ix_(at, at)])
        )
    out.add(*order([*items, *named.values()], rng), *order(network.image_points(), rng))
    return out


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize(
    "name",
    [
        "gnss",
        "combined block",
        "combined block, free",
        "own cameras",
        "weighted photos",
        "geocentric block",
        "camcal, weighted",
        "Comp3D",
    ],
)
def test_the_order_of_points_photos_and_observations_does_not_matter(name: str) -> None:
    network = ADJUSTED[name]()
    other = shuffled(network, 7)
    ours, theirs = (fga.reliability(fga.adjust(n)) for n in (network, other))

    def keys(rel: fga.Reliability) -> list[tuple[str, str, str]]:
        return [(r.kind, r.id, r.component) for r in rel.solution.observations]

    place = {key: row for row, key in enumerate(keys(theirs))}
    assert len(place) == len(theirs.w)
    rows = np.array([place[key] for key in keys(ours)])
    assert np.any(rows != np.arange(len(rows)))
    assert_same_figures(ours, theirs, rows)


# -- points far away, and where there is no answer -------------------------------------------------


@pytest.mark.parametrize("bases", [1e4, 1e5, 1e6, 1e7])
def test_points_far_away_leave_the_sums_what_they_are(bases: float) -> None:
    """Rays that meet at up to 10⁷ bases: normal matrices have twice as many digits to lose.

    Well below 10⁶ bases points are eliminated by themselves, above by QR with everything else.
    """
    case = Case.of(fga.adjust(held_photos(2.0 * bases)))
    assert case.rel.redundancy_numbers.sum() == pytest.approx(12, abs=ROUNDING)
    assert case.rel.e2.sum() == pytest.approx(12, abs=ROUNDING)
    hat, rank = case.points_alone
    assert rank == 12
    np.testing.assert_allclose(case.rel.e2, hat, rtol=0, atol=ROUNDING)


@pytest.mark.slow(
    "sums of shares of which single ones are ±10²¹, in a block whose points run away; the shares "
    "of the other networks stay below 1"
)
def test_points_on_their_way_to_infinity_leave_the_sums_what_they_are() -> None:
    """Ladybug 49 comes not to rest (see test_bal): some rays meet at 10⁶ bases, or nowhere.

    Inner constraints over all its points rest on the farthest: e1 and e12 of some observations
    are ±4·10¹⁹ at the 25th iteration, and no rounding of them is left in r. At the 35th, where it
    ends, the points are farther away still, and the sum has 1.7e-6 of rounding.
    """
    ladybug = read_bal(data_dir("bal") / "problem-49-7776-pre.txt")
    solution = fga.adjust(ladybug, max_iterations=25)
    assert not solution.converged
    case = Case.of(solution)
    r, e2 = case.rel.redundancy_numbers, case.rel.e2
    assert r.sum() == pytest.approx(solution.redundancy, abs=SUM)
    for share in (r, e2):
        assert np.all((share >= -ROUNDING) & (share <= 1.0 + ROUNDING))
    assert e2.sum() == pytest.approx(3 * len(solution.network.points), abs=SUM)
    np.testing.assert_allclose(e2, case.points_alone[0], rtol=0, atol=ROUNDING)


def test_a_redundancy_that_the_figures_do_not_sum_to_is_refused() -> None:
    """Here a solution with a datum defect that its equations do not have."""
    solution = fga.adjust(held_photos())
    columns = np.arange(solution.equations.unknowns.n_columns)
    nothing, about = np.zeros((len(columns), 1)), (np.zeros(3), 1.0)
    shift = Defect(columns, nothing, np.eye(7, 1), about, np.ones(len(columns), dtype=bool))
    with pytest.raises(
        fga.AdjustmentError,
        match=r"redundancy numbers sum to 12, the redundancy is 13: the network is too weak",
    ):
        fga.reliability(replace(solution, defects=(shift,)))
