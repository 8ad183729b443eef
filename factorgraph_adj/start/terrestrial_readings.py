"""Terrestrial readings and heights above level or pressure surfaces as arrays; medians by group.

Directions, angles, distances, zenith angles, height differences and vectors stand by station and
target; heights above level surfaces and surfaces of pressure stand by point and surface.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..frames import MEAN_EARTH_RADIUS, GeocentricFrame
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..models.base import wrap
from ..models.sub_frame import horizons
from ..models.terrestrial_observations import direction_in_face_one, zenith_in_face_one
from ..observations.registry import Quantity
from ..types import Array, Index, Mask


@dataclass(frozen=True)
class SurfaceHeights:
    """Heights of points above surfaces, the heights of which may be unknown."""

    point: Index
    """Numbers of the points, (n,)."""
    surface: Index
    """Number of the surface of each, among those of all kinds, (n,)."""
    above: Array
    """Height of the point above the surface, metres, (n,)."""
    height: Array
    """Heights of the surfaces, metres; NaN where they are not given, (k,)."""


def _above_level(block: Block, levels: Array) -> Array:
    c = block.constants
    return np.asarray(block.observed[:, 0] + c["slope"] * c["along"] + c["geoid"])


def _above_profile(block: Block, profiles: Array) -> Array:
    """Return the reading in metres of height, and what the surface rises along the profile."""
    own, t = np.nan_to_num(profiles[block.variables[-1][1]]), block.constants["time"]
    return np.asarray(block.observed[:, 0] / (1.0 + own[:, 3]) + own[:, 1] * t + own[:, 2] * t**2)


_HEIGHTS_ABOVE: dict[Quantity, tuple[str, Callable[[Block, Array], Array]]] = {
    "height above a level": ("level", _above_level),
    "height in a profile": ("profile", _above_profile),
}
"""Kind of the surface, and the heights above it, by the quantity of observations."""


def read_surface_heights(equations: Equations) -> SurfaceHeights:
    """Read the heights of points above surfaces; a free height of a surface is not given."""
    none, nobody = np.zeros(0), np.zeros(0, dtype=np.intp)
    points, surfaces, above, height = [nobody], [nobody], [none], [none]
    for quantity, (kind, value) in _HEIGHTS_ABOVE.items():
        table, first = equations.unknowns[kind], sum(len(h) for h in height)
        for block in equations.blocks:
            if block.quantity == quantity and block.variables[0][0] == "point":
                points.append(block.variables[0][1])
                surfaces.append(first + block.variables[-1][1])
                above.append(value(block, table.values))
        loose = table.free[:, 0] & np.isinf(table.sigma[:, 0])
        height.append(np.where(loose, np.nan, table.values[:, 0]))
    return SurfaceHeights(
        np.concatenate(points),
        np.concatenate(surfaces),
        np.concatenate(above),
        np.concatenate(height),
    )


def group_median(group: Index, value: Array, size: int) -> Array:
    """Return the median of ``value`` (n,) in each of ``size`` groups; NaN for empty groups."""
    out = np.full(size, np.nan)
    if not len(group):
        return out
    order = np.lexsort((value, group))
    g, v = group[order], value[order]
    first = np.flatnonzero(np.concatenate([[True], g[1:] != g[:-1]]))
    count = np.diff(np.append(first, len(g)))
    out[g[first]] = 0.5 * (v[first + (count - 1) // 2] + v[first + count // 2])
    return out


def group_angle(group: Index, angle: Array, size: int) -> Array:
    """Return the median of angles in each group about their circular mean, continuous at ±π."""
    s = np.bincount(group, np.sin(angle), size)
    c = np.bincount(group, np.cos(angle), size)
    mean = np.arctan2(s, c)
    return mean + group_median(group, wrap(angle - mean[group]), size)


def median_angle(angles: Array) -> float:
    """Return the median of angles (n,) about their circular mean, continuous at ±π."""
    return float(group_angle(np.zeros(len(angles), dtype=np.intp), angles, 1)[0])


@dataclass(frozen=True)
class StationObservations:
    """Observations of one kind from stations to targets."""

    station: Index
    """Numbers of the stations, (n,)."""
    target: Index
    """Numbers of the targets, (n,)."""
    value: Array
    """Values, metres or radians, (n,); GNSS vectors (n, 3)."""
    rise: Array
    """Target height minus instrument height, metres, (n,)."""
    third: Index
    """Number of the orientation (directions) or of the second target (angles), (n,)."""

    @property
    def n(self) -> int:
        """Number of observations."""
        return len(self.station)


def _as_read(block: Block) -> Array:
    return block.observed[:, 0]


def directions_read(block: Block) -> Array:
    """Return directions as in face 1."""
    return direction_in_face_one(block.observed[:, 0], block.constants["face"])


def zeniths_read(block: Block) -> Array:
    """Return zenith angles as in face 1."""
    return zenith_in_face_one(block.observed[:, 0], block.constants["face"])


def _vector(block: Block) -> Array:
    return block.observed


def _join(
    blocks: Iterable[Block],
    third: int | None = None,
    *,
    value: Callable[[Block], Array] = _as_read,
) -> StationObservations:
    """Join blocks; ``third`` is the place of a further variable, ``value`` gives the values."""
    found = list(blocks)
    if not found:
        none = np.zeros(0, dtype=np.intp)
        nothing = np.zeros((0, 3)) if value is _vector else np.zeros(0)
        return StationObservations(none, none, nothing, np.zeros(0), none)

    def column(place: int) -> Index:
        return np.concatenate([b.variables[place][1] for b in found])

    station = column(0)
    return StationObservations(
        station,
        column(2),
        np.concatenate([value(b) for b in found]),
        np.concatenate(
            [b.constants["target_height"] - b.constants["instrument_height"] for b in found]
        ),
        np.zeros_like(station) if third is None else column(third),
    )


def _length(block: Block, values: Array) -> Array:
    """Return lengths corrected for scale and zero constant of their distance meter."""
    edm = values[block.variables[4][1]]
    return np.asarray((block.observed[:, 0] - edm[:, 1]) / (1.0 + edm[:, 0]))


@dataclass(frozen=True)
class Edges:
    """Pairs of points with a length or a height difference between them, each pair once."""

    a: Index
    """Number of the first point, a < b, (n,)."""
    b: Index
    """Number of the second point, (n,)."""
    key: Index
    """a·(number of points) + b, ascending, (n,)."""
    slope: Array
    """Slope distance, metres; NaN: none, (n,)."""
    slope_rise: Array
    """Target height minus instrument height, from a to b, metres, (n,)."""
    level: Array
    """Horizontal distance, observed or from slope distance and zenith angle, metres; NaN: none,
    (n,)."""
    rise: Array
    """H_b − H_a by levelling, or by slope distance and zenith angle, metres; NaN: none, (n,)."""


@dataclass(frozen=True)
class Survey:
    """All terrestrial observations of a network."""

    n_points: int
    """Number of points."""
    directions: StationObservations
    """Horizontal directions and azimuths of gyrotheodolites; third: the orientation."""
    gyro: Index
    """Number of the gyrotheodolite of each orientation behind those of sets of directions: one for
    each of its stations, (k,)."""
    azimuths: StationObservations
    """Azimuths."""
    angles: StationObservations
    """Horizontal angles; third: the second target."""
    zeniths: StationObservations
    """Zenith angles."""
    slopes: StationObservations
    """Slope distances."""
    levels: StationObservations
    """Horizontal distances."""
    steps: StationObservations
    """Levelled height differences."""
    vectors: StationObservations
    """GNSS vectors."""
    plan_steps: StationObservations
    """Differences of the two plan coordinates alone, as vectors (n, 3) with any height."""
    of_vectors: frozenset[int]
    """Numbers of the frames in which vectors are observed."""
    edges: Edges
    """Lengths and height differences by pairs of points."""
    above: SurfaceHeights
    """Heights above level surfaces and surfaces of pressure."""

    def edge(self, i: Index, j: Index) -> tuple[Index, Index]:
        """Return for pairs (n,) the rows that have an edge, and the edges' numbers."""
        key = np.minimum(i, j) * self.n_points + np.maximum(i, j)
        if not len(self.edges.key):
            none = np.zeros(0, dtype=np.intp)
            return none, none
        place = np.minimum(np.searchsorted(self.edges.key, key), len(self.edges.key) - 1)
        rows = np.flatnonzero(self.edges.key[place] == key)
        return rows, place[rows]


def read_survey(equations: Equations, curvature: float) -> Survey:
    """Read the terrestrial observations into arrays; ``curvature`` is 1/R or 0, 1/metres."""
    read: dict[Quantity, list[Block]] = defaultdict(list)
    for block in equations.blocks:
        read[block.quantity].append(block)
    edm = equations.unknowns["edm"].values
    n = len(equations.network.points)

    def lengths(quantity: Quantity) -> StationObservations:
        found = read[quantity]
        joined = _join(found)
        if not found:
            return joined
        return StationObservations(
            joined.station,
            joined.target,
            np.concatenate([_length(b, edm) for b in found]),
            joined.rise,
            joined.third,
        )

    up = _join(read["vertical angle"])
    zenith = _join(read["zenith angle"], value=zeniths_read)
    zeniths = StationObservations(
        np.concatenate([zenith.station, up.station]),
        np.concatenate([zenith.target, up.target]),
        np.concatenate([zenith.value, np.pi / 2 - up.value]),
        np.concatenate([zenith.rise, up.rise]),
        np.concatenate([zenith.third, up.third]),
    )
    slopes, levels = lengths("slope distance"), lengths("horizontal distance")
    steps = _join(read["height difference"])
    sets = len(equations.unknowns["orientation"].names)
    directions, gyro = _with_gyros(
        _join(read["direction"], 4, value=directions_read),
        _join(read["gyro azimuth"], 4),
        sets,
    )
    return Survey(
        n,
        directions,
        gyro,
        _join(read["azimuth"]),
        _join(read["horizontal angle"], 4),
        zeniths,
        slopes,
        levels,
        steps,
        _with_differences(
            _both(
                _join(read["vector"], value=_vector),
                _frame_vectors(read["vector in a frame"], equations),
            ),
            read["coordinate difference"],
            equations,
        ),
        _plan_differences(read["coordinate difference"], equations),
        frozenset(n for b in read["vector in a frame"] for n in b.variables[0][1].tolist()),
        _edges(n, slopes, levels, zeniths, steps, curvature),
        read_surface_heights(equations),
    )


def _with_differences(
    vectors: StationObservations, blocks: Sequence[Block], equations: Equations
) -> StationObservations:
    """Join differences of all three coordinates to vectors.

    Those in a horizon are turned by that of their station, or of the middle of the given points.
    """
    given = equations.unknowns["point"].values
    known: Mask = np.all(np.isfinite(given), axis=1)
    middle = given[known].mean(axis=0) if known.any() else np.zeros(3)
    station, target, value = [vectors.station], [vectors.target], [vectors.value]
    for block in blocks:
        if block.dimension < 3 or not known.any():
            continue
        own = block.variables[0][1]
        at = np.where(known[own, None], given[own], middle)
        basis = equations.network.frame.basis(at, np.zeros((block.n, 2)))
        e = horizons(basis, block.constants["horizon"])
        order = np.argsort(["xyz".index(a) for a in block.components])
        d = block.observed[:, order]
        station.append(own)
        target.append(block.variables[2][1])
        value.append(np.einsum("nji,nj->ni", e, d))
    n = sum(len(s) for s in station)
    nothing = np.zeros(n - vectors.n)
    return StationObservations(
        np.concatenate(station),
        np.concatenate(target),
        np.concatenate(value),
        np.concatenate([vectors.rise, nothing]),
        np.concatenate([vectors.third, nothing.astype(np.intp)]),
    )


def _both(a: StationObservations, b: StationObservations) -> StationObservations:
    return StationObservations(
        np.concatenate([a.station, b.station]),
        np.concatenate([a.target, b.target]),
        np.concatenate([a.value, b.value]),
        np.concatenate([a.rise, b.rise]),
        np.concatenate([a.third, b.third]),
    )


def _frame_vectors(blocks: Sequence[Block], equations: Equations) -> StationObservations:
    """Return vectors in frames along the axes of the network, with the start values of these.

    A rotation or scale without a start value counts as none. Vectors in the horizon of an unknown
    station are left out.
    """
    out = _join([], value=_vector)
    given = equations.unknowns["point"].values
    for block in blocks:
        (_, number), (_, station), (_, target) = block.variables
        stored = equations.unknowns["frame"].values[number]
        rotation = stored[:, :9].reshape(-1, 3, 3)
        rotation = np.where(np.isfinite(rotation), rotation, np.eye(3))
        scale = np.exp(np.nan_to_num(stored[:, 12]))[:, None]
        at = given[station]
        there = (stored[:, 16] == 0) | np.isfinite(at).all(axis=1)
        place = np.where(np.isfinite(at), at, [MEAN_EARTH_RADIUS, 0.0, 0.0])
        basis = equations.network.frame.basis(place, np.zeros((block.n, 2)))
        e = horizons(basis, stored[:, 16])
        value = scale * np.einsum("nji,njk,nk->ni", e, rotation, block.observed)
        rows = np.flatnonzero(there)
        zero = np.zeros(len(rows))
        found = StationObservations(
            station[rows], target[rows], value[rows], zero, np.zeros(len(rows), dtype=np.intp)
        )
        out = _both(out, found)
    return out


def _plan_differences(blocks: Sequence[Block], equations: Equations) -> StationObservations:
    """Return differences of x and y of which that of z is not observed, together or apart.

    Those in axes of a geocentric frame are no differences in plan.
    """
    frame = equations.network.frame
    given = equations.unknowns["point"].values
    known: Mask = np.all(np.isfinite(given), axis=1)
    found: dict[tuple[int, int, bool], Array] = {}
    for block in blocks:
        if block.dimension == 3 or not known.any():
            continue
        level = block.constants["horizon"] > 0
        for row in np.flatnonzero(level | (not isinstance(frame, GeocentricFrame))).tolist():
            ends = (int(block.variables[0][1][row]), int(block.variables[2][1][row]))
            d = found.setdefault((*ends, bool(level[row])), np.full(3, np.nan))
            for axis, value in zip(block.components, block.observed[row], strict=True):
                d["xyz".index(axis)] = value
    whole = {k: d for k, d in found.items() if np.isfinite(d[:2]).all()}
    if not whole:
        return _join([], value=_vector)
    station, target, level = (np.array(column) for column in zip(*whole, strict=True))
    middle = given[known].mean(axis=0)
    at = np.where(known[station, None], given[station], middle)
    e = horizons(frame.basis(at, np.zeros((len(at), 2))), level.astype(float))
    value = np.einsum("nji,nj->ni", e, np.nan_to_num(list(whole.values())))
    zero = np.zeros(len(station))
    return StationObservations(station, target, value, zero, zero.astype(np.intp))


def _with_gyros(
    directions: StationObservations, gyros: StationObservations, sets: int
) -> tuple[StationObservations, Index]:
    """Join azimuths of gyrotheodolites to directions, as one more set at each station.

    Args:
        directions: horizontal directions.
        gyros: azimuths; third: the gyrotheodolite.
        sets: number of sets of directions.

    Returns:
        All of them, and the gyrotheodolite of each additional set.
    """
    pairs, place = np.unique(
        np.stack([gyros.station, gyros.third], axis=1), axis=0, return_inverse=True
    )
    third = np.concatenate([directions.third, sets + place.ravel()]).astype(np.intp)
    joined = StationObservations(
        np.concatenate([directions.station, gyros.station]),
        np.concatenate([directions.target, gyros.target]),
        np.concatenate([directions.value, gyros.value]),
        np.concatenate([directions.rise, gyros.rise]),
        third,
    )
    return joined, np.asarray(pairs[:, 1], dtype=np.intp)


def _edges(
    n: int,
    slopes: StationObservations,
    levels: StationObservations,
    zeniths: StationObservations,
    steps: StationObservations,
    curvature: float,
) -> Edges:
    groups = (slopes, levels, steps)
    i = np.concatenate([g.station for g in groups])
    j = np.concatenate([g.target for g in groups])
    key = np.unique(np.minimum(i, j) * n + np.maximum(i, j))
    m = len(key)

    def place(g: StationObservations) -> tuple[Index, Array]:
        """Return the edge of each observation and +1 where it points from a to b, else −1."""
        at = np.searchsorted(
            key, np.minimum(g.station, g.target) * n + np.maximum(g.station, g.target)
        )
        return at, np.where(g.station < g.target, 1.0, -1.0)

    at, sign = place(slopes)
    slope = group_median(at, slopes.value, m)
    slope_rise = group_median(at, sign * slopes.rise, m)
    at, _ = place(levels)
    level = group_median(at, levels.value, m)
    rise = np.full(m, np.nan)
    if zeniths.n and m:
        at, sign = place(zeniths)
        at = np.minimum(at, m - 1)
        pair = np.minimum(zeniths.station, zeniths.target) * n + np.maximum(
            zeniths.station, zeniths.target
        )
        rows = np.flatnonzero((key[at] == pair) & (np.isfinite(slope[at]) | np.isfinite(level[at])))
        at, sign, z = at[rows], sign[rows], zeniths.value[rows]
        s = np.where(np.isfinite(slope[at]), slope[at], level[at] / np.maximum(np.sin(z), 1e-3))
        along = s * np.sin(z)
        height = s * np.cos(z) + along * along * curvature / 2 - zeniths.rise[rows]
        by_slope = np.isfinite(slope[at])
        trig = group_median(at[by_slope], along[by_slope], m)
        level = np.where(np.isnan(level), trig, level)
        rise = group_median(at, sign * height, m)
    at, sign = place(steps)
    levelled = group_median(at, sign * (steps.value - steps.rise), m)
    rise = np.where(np.isnan(levelled), rise, levelled)
    return Edges(key // max(n, 1), key % max(n, 1), key, slope, slope_rise, level, rise)
