"""Precision maps: covariances of tie points, and of any further points that the photos see.

A further point X is intersected from the photos that see it; its rays are not in the adjustment.
With whitened partials B by X and A by poses and calibrations u of all its rays,

    N = BᵀB,   C = BᵀA,   Σ_X = σ² (N⁻¹ + N⁻¹ C Q_uu Cᵀ N⁻¹),

where Q_uu has the cofactors of the block and σ² is its variance factor. The first part is the
intersection, the second one the block. Points are taken in groups of neighbours, so that few photos
are concerned at once and the products are dense.

James, Robson & Smith (2017), 3-D uncertainty-based topographic change detection with
structure-from-motion photogrammetry, Earth Surf. Process. Landforms 42, 1769-1788, find the same by
repeated adjustments with noise; M3C2-PM compares two clouds by these maps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ..blas_threads import with_one_thread
from ..errors import InputError, taking
from ..models.unknown_registry import VariableKind
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..types import Array, Index, Mask
from .visible_rays import ViewingLimit, Visibility, VisibleRays, visibility_mask

MOST_POINTS_AT_ONCE = 1000
"""Largest number of points of a group of neighbours."""
MAX_RIGHT_SIDE_ELEMENTS = 5_000_000
"""Maximum number of elements of the dense right-hand sides that are solved at once."""
LEAST_PIVOT = 1e-12
"""Smallest ratio of the eigenvalues of N at which a point counts as determined: 10⁻⁶ of an angle
between its rays."""
NEIGHBOURS = 4
"""Nodes between which variances are interpolated."""
COMPARED_POINTS = 1000
"""Largest number of points at which interpolated values are compared with computed ones."""


@dataclass(frozen=True)
class InterpolationError:
    """Interpolated σ against computed ones, at points that are no nodes."""

    n: int
    """Number of points that were compared."""
    rms: float
    """Root mean square of σ_interpolated/σ_computed − 1, all components together."""
    largest: float
    """Largest absolute value."""


@dataclass(frozen=True, eq=False, repr=False)
class PrecisionMap(Shown):
    """Points with their covariances."""

    points: Array
    """Coordinates in the frame of the network, (n, 3), metres."""
    covariances: Array
    """Covariances, (n, 3, 3), metres²; NaN where the photos do not determine the point."""
    photos: Index
    """Number of photos that see each point, (n,); of interpolated points that at the next node."""
    nodes: int | None = None
    """Number of points for which the covariance is computed, the others are interpolated; None: it
    is computed for all points."""
    error: InterpolationError | None = None
    """Error of interpolated standard deviations; None: nothing is interpolated."""

    @property
    def sigmas(self) -> Array:
        """Standard deviations along x, y, z, (n, 3), metres."""
        return np.asarray(np.sqrt(np.einsum("nii->ni", self.covariances)))

    @property
    def determined(self) -> Mask:
        """Which points have a covariance, (n,)."""
        return np.asarray(~np.isnan(self.covariances).any(axis=(1, 2)))

    def headline(self) -> str:
        """Return the number of points and the medians of their standard deviations."""
        known = self.determined
        out = f"PrecisionMap: {len(known)} points"
        if known.any():
            x, y, z = (1000.0 * np.median(self.sigmas[known], axis=0)).tolist()
            out += f", median σ {x:.2f} {y:.2f} {z:.2f} mm"
        if not known.all():
            out += f", {int((~known).sum())} not determined"
        if self.error is not None:
            out += f", interpolated from {self.nodes} nodes with {100 * self.error.rms:.1f} % (rms)"
        return out

    def first_rows(self) -> Rows:
        """Return the points with their standard deviations, metres."""
        return Rows(
            ("x", "y", "z", "σx", "σy", "σz", "photos"),
            (
                (*x.tolist(), *s.tolist(), int(n))
                for x, s, n in zip(self.points, self.sigmas, self.photos, strict=True)
            ),
            len(self.points),
        )


@taking(Solution)
@with_one_thread
def precision_map(
    solution: Solution,
    points: Array | None = None,
    *,
    sigma: float | None = None,
    matching_factor: float = 1.0,
    visible: Mask | None = None,
    normals: Array | None = None,
    largest_angle: float | None = None,
    nodes: int | None = None,
) -> PrecisionMap:
    """Return the covariances of points: of the tie points, or of any points of a dense cloud.

    A dense point is taken as intersected from all photos that see it: in front of the photo, its
    image within the format (without a format: within the reach of the camera's image points). The
    covariance of all poses and calibrations is carried over to it, with all correlations. In a free
    network, covariances refer to the datum of inner constraints. Errors of neighbouring points are
    correlated; the map gives one 3×3 covariance (m²) for each point and no correlations between
    points.

    Args:
        solution: the adjusted block.
        points: coordinates in the frame of the network, (n, 3), metres; None: the adjusted points
            with the covariances of the adjustment.
        sigma: standard deviation of an image coordinate of a dense point, image units; None: the
            median of the image points of each camera. It is scaled by σ̂0 as covariances are.
        matching_factor: factor on these standard deviations, for the precision of dense matching.
        visible: which photos see which points, (n, m), where it is known from a surface; columns in
            the order of ``network.photos``. None: nothing hides a point.
        normals: outward normals of the surface, (n, 3), of any length.
        largest_angle: largest angle between the normal and the ray, radians.
        nodes: number of points for which the covariance is computed; the others are interpolated
            between the nearest of these. None: it is computed for all points.

    Raises:
        InputError: points is not an (n, 3) array of finite numbers, another argument does not fit
            it or is out of range, a camera has neither a format nor image points, or photos have
            a motion during their readout.
        AdjustmentError: there are no covariances.
    """
    if points is None:
        given = {
            "sigma": sigma,
            "visible": visible,
            "normals": normals,
            "largest_angle": largest_angle,
            "nodes": nodes,
        }
        stated = [name for name, value in given.items() if value is not None]
        if stated or matching_factor != 1.0:
            raise InputError(
                f"{', '.join(stated or ['matching_factor'])}: only for further points; the "
                "adjusted points have the covariances of the adjustment"
            )
        return _of_adjusted_points(solution)
    solution.network.refuse_motions(solution.network.photos, "a precision map of further points")
    x = _places("points", points)
    for name, value in (("sigma", sigma), ("matching_factor", matching_factor)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} must be greater than zero, not {value!r}")
    if nodes is not None and nodes < NEIGHBOURS:
        raise InputError(f"nodes must be {NEIGHBOURS} or more, not {nodes!r}")
    seen = visibility_mask(visible, len(x), list(solution.network.photos))
    cloud = _Cloud(
        solution,
        x,
        Visibility(solution, sigma, matching_factor),
        seen,
        _limit(normals, largest_angle, len(x)),
    )
    if nodes is None or nodes >= len(x):
        return PrecisionMap(x, *cloud.computed(np.arange(len(x))))
    return _interpolated(cloud, nodes)


def _of_adjusted_points(solution: Solution) -> PrecisionMap:
    rays = np.zeros(len(solution.network.points), dtype=np.intp)
    for block in solution.equations.blocks:
        if block.image:
            rays += np.bincount(block.variables[2][1], minlength=len(rays))
    return PrecisionMap(solution.state["point"].copy(), solution.point_covariances.copy(), rays)


def _places(what: str, values: Array, n: int | None = None) -> Array:
    """Return finite coordinates (n, 3).

    Raises:
        InputError: the values are something else.
    """
    try:
        out = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what} is not an (n, 3) array of finite numbers") from None
    if out.ndim != 2 or out.shape[1] != 3 or (n is not None and len(out) != n):
        size = "n" if n is None else n
        raise InputError(
            f"{what} is not an ({size}, 3) array of finite numbers: its shape is {out.shape}"
        )
    if not np.isfinite(out).all():
        bad = np.flatnonzero(~np.isfinite(out).all(axis=1))
        raise InputError(f"{what}: {len(bad)} rows are not finite, the first is row {bad[0]}")
    return out


def _limit(normals: Array | None, angle: float | None, n: int) -> ViewingLimit | None:
    if normals is None and angle is None:
        return None
    if normals is None or angle is None:
        raise InputError("normals and largest_angle belong together: state both or none")
    if not 0.0 < angle <= np.pi / 2.0:
        raise InputError(f"largest_angle must be greater than 0 and at most π/2, not {angle!r}")
    out = _places("normals", normals, n)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    if not (length > 0.0).all():
        raise InputError(f"normals: {int((length == 0.0).sum())} rows are zero")
    return ViewingLimit(out / length, angle)


class _Cloud:
    """Further points of a block."""

    def __init__(
        self,
        solution: Solution,
        points: Array,
        visibility: Visibility,
        visible: Mask | None,
        limit: ViewingLimit | None,
    ) -> None:
        self.points, self.visibility, self.visible, self.limit = points, visibility, visible, limit
        self.factor = solution.variance_factor
        self.covariance = _BlockCovariance(solution)

    def computed(self, chosen: Index) -> tuple[Array, Index]:
        """Return covariances (m, 3, 3) of chosen points, and their numbers of photos (m,)."""
        out = np.full((len(chosen), 3, 3), np.nan)
        counts = np.zeros(len(chosen), dtype=np.intp)
        for group in neighbours(self.points[chosen], MOST_POINTS_AT_ONCE):
            at = chosen[group]
            limit = self.limit and ViewingLimit(self.limit.normals[at], self.limit.angle)
            visible = None if self.visible is None else self.visible[at]
            rays = self.visibility.rays(self.points[at], visible, limit)
            counts[group] = np.bincount(rays.point, minlength=len(group))
            out[group] = self._intersected(rays, len(group))
        return out, counts

    def _intersected(self, rays: VisibleRays, m: int) -> Array:
        """Return the covariances of the points of some rays, (m, 3, 3)."""
        n = len(rays.point)
        ones = np.ones(n)
        b = rays.by_point.transpose(0, 2, 1)
        of_point = csr_array((ones, (rays.point, np.arange(n))), shape=(m, n))
        normal = _sums(of_point, b @ rays.by_point).reshape(m, 3, 3)
        values, vectors = np.linalg.eigh(normal)
        good = values[:, 0] > LEAST_PIVOT * values[:, 2]
        inverse = np.zeros((m, 3, 3))
        root = vectors[good] / np.sqrt(values[good, None, :])
        inverse[good] = root @ root.transpose(0, 2, 1)
        photos, photo = np.unique(rays.photo, return_inverse=True)
        lenses, lens = np.unique(rays.calibration, return_inverse=True)
        by_pose = np.zeros((m, len(photos), 3, 6))
        by_pose[rays.point, photo] = b @ rays.by_pose  # a photo sees a point once
        k = rays.by_calibration.shape[2]
        place = rays.point * len(lenses) + lens
        of_lens = csr_array((ones, (place, np.arange(n))), shape=(m * len(lenses), n))
        by_lens = _sums(of_lens, b @ rays.by_calibration).reshape(m, len(lenses), 3, k)
        c = np.concatenate(
            [a.transpose(0, 2, 1, 3).reshape(m, 3, -1) for a in (by_pose, by_lens)], axis=2
        )
        g = inverse @ c
        q = self.covariance.of(photos, lenses)
        moved = (g.reshape(3 * m, -1) @ q).reshape(g.shape)
        out = self.factor * inverse + moved @ g.transpose(0, 2, 1)
        out = (out + out.transpose(0, 2, 1)) / 2.0
        out[~good] = np.nan
        return np.asarray(out)


class _BlockCovariance:
    """Joint covariance of all poses and calibrations; zero for held components."""

    def __init__(self, solution: Solution) -> None:
        names = list(solution.network.photos)
        pose = solution.equations.unknowns["pose"]
        lens = solution.equations.unknowns["calibration"]
        self.n_photos, self.width = len(names), lens.free.shape[1]
        poses = np.array([pose.number[n] for n in names], dtype=np.intp)
        variables: list[tuple[VariableKind, str]] = [("pose", n) for n in names]
        variables += [("calibration", n) for n in lens.names]
        size = 6 * len(names) + self.width * len(lens.names)
        self.whole = np.zeros((size, size))
        if solution.reference is not None:
            # A change of the datum acts on blocks.
            self._by_blocks(solution, variables)
            return
        columns = np.full(size, -1, dtype=np.intp)
        for table, numbers, first, width in (
            (pose, poses, 0, 6),
            (lens, np.arange(len(lens.names)), 6 * len(names), self.width),
        ):
            at = table.offset[numbers, None] + np.arange(width)
            there = table.has_column[numbers] & table.free[numbers]
            columns[first : first + there.size] = np.where(there, at, -1).ravel()
        place = np.flatnonzero(columns >= 0)
        columns = columns[place]
        total = solution.equations.unknowns.n_columns
        step = max(1, MAX_RIGHT_SIDE_ELEMENTS // max(1, total))
        for first in range(0, len(columns), step):
            part = columns[first : first + step]
            unit = np.zeros((total, len(part)))
            unit[part, np.arange(len(part))] = solution.variance_factor
            self.whole[np.ix_(place, place[first : first + step])] = solution.cofactor_times(unit)[
                columns
            ]
        self.whole = (self.whole + self.whole.T) / 2.0

    def _by_blocks(self, solution: Solution, variables: list[tuple[VariableKind, str]]) -> None:
        starts = [self._start(i) for i in range(len(variables))]
        for i, a in enumerate(variables):
            for j, b in enumerate(variables[: i + 1]):
                found = solution.variable_covariance(a, b)
                rows = slice(starts[i], starts[i] + found.shape[0])
                columns = slice(starts[j], starts[j] + found.shape[1])
                self.whole[rows, columns], self.whole[columns, rows] = found, found.T

    def _start(self, variable: int) -> int:
        after = variable - self.n_photos
        return 6 * variable if after < 0 else 6 * self.n_photos + self.width * after

    def of(self, photos: Index, lenses: Index) -> Array:
        """Return the covariance of some photos and calibrations, by their numbers."""
        of_photos = 6 * photos[:, None] + np.arange(6)
        of_lenses = 6 * self.n_photos + self.width * lenses[:, None] + np.arange(self.width)
        at = np.concatenate([of_photos.ravel(), of_lenses.ravel()])
        return np.asarray(self.whole[np.ix_(at, at)])


def _sums(of: csr_array, products: Array) -> Array:
    """Return sums of matrices (n, r, c) over rays, by the incidence of rays, (k, r c)."""
    return np.asarray(of @ products.reshape(len(products), products.shape[1] * products.shape[2]))


def neighbours(points: Array, most: int) -> Iterator[Index]:
    """Yield the numbers of points in groups of neighbours, halved across their longest side."""
    stack = [np.arange(len(points))] if len(points) else []
    while stack:
        group = stack.pop()
        if len(group) <= most:
            yield group
            continue
        x = points[group]
        side = int(np.argmax(x.max(axis=0) - x.min(axis=0)))
        order = np.argpartition(x[:, side], len(group) // 2)
        stack += [group[order[len(group) // 2 :]], group[order[: len(group) // 2]]]


def _interpolated(cloud: _Cloud, nodes: int) -> PrecisionMap:
    """Return the map of a cloud from one node for each group of neighbours."""
    x = cloud.points
    n = len(x)
    groups = list(neighbours(x, -(-n // nodes)))
    chosen = np.array(
        [g[np.argmin(np.linalg.norm(x[g] - x[g].mean(axis=0), axis=1))] for g in groups]
    )
    found, counts = cloud.computed(chosen)
    known = ~np.isnan(found).any(axis=(1, 2))
    if int(known.sum()) < NEIGHBOURS:
        raise InputError(
            f"{int(known.sum())} of {len(chosen)} nodes are seen by two photos: nothing to "
            "interpolate between"
        )
    tree = KDTree(x[chosen])
    distance, near = (np.asarray(found_there) for found_there in tree.query(x, k=NEIGHBOURS))
    # Weights that sum up to one keep covariances positive; a node that is not determined leaves
    # its neighbourhood undetermined.
    weight = 1.0 / np.maximum(distance, 1e-12 * (distance[:, -1:] + 1e-300)) ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    out = np.zeros((n, 3, 3))
    for j in range(NEIGHBOURS):
        out += weight[:, j, None, None] * found[near[:, j]]
    out[chosen] = found
    others = np.setdiff1d(np.arange(n), chosen)
    step = max(1, len(others) // COMPARED_POINTS)
    compared = others[::step][:COMPARED_POINTS]
    truth = np.sqrt(np.einsum("nii->ni", cloud.computed(compared)[0]))
    ratio = np.sqrt(np.einsum("nii->ni", out[compared])) / truth - 1.0
    ratio = ratio[~np.isnan(ratio).any(axis=1)]
    error = InterpolationError(
        len(ratio),
        float(np.sqrt(np.mean(ratio**2))) if len(ratio) else np.nan,
        float(np.abs(ratio).max(initial=0.0)) if len(ratio) else np.nan,
    )
    return PrecisionMap(x, out, counts[near[:, 0]], len(chosen), error)
