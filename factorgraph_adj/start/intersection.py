"""Points where lines and circles, or spheres, meet; start of a free network of slope distances.

By intersection, plane resection and distances: directions and distances from known points, and
directions and angles at the point itself, give lines and circles in plan (loci) on which an unknown
point lies; their intersections are its possible positions, and the one with the smallest capped
misfit of all loci is taken if no other fits nearly as well. Three slope distances from known points
intersect in space; with a known plan they give the height.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ..models.base import circular_mean, wrap
from ..types import Array
from .polar_points import known_bearings
from .search_state import SearchState

MAX_LOCI_OF_POINT = 16
"""Largest number of lines and circles of one point that are intersected by pairs."""
MAX_RELATIVE_MISFIT = 0.1
"""Misfit relative to the size of the figure that counts as a blunder; larger misfits are capped."""
SAME_POSITION_RATIO = 0.02
"""Distance relative to the size of the figure up to which two positions count as one."""
MIN_MISFIT_RATIO = 3.0
"""Smallest ratio of the misfits of the second best and the best position of a sure decision."""
MIN_COMPARED_MISFIT = 1e-4
"""Misfit relative to the size of the figure below which misfits are not compared."""
GOOD_CROSSING_SINE = 0.3
"""Smallest sine of the crossing angle of an intersection that is used at once."""
MIN_CROSSING_SINE = 0.005
"""Smallest sine of the crossing angle at which loci determine a point."""
MAX_SPHERES_OF_POINT = 8
"""Largest number of distances of one point that are intersected by threes."""
MAX_START_TRIANGLE_POINTS = 20
"""Largest number of points whose triangles may start a network."""


@dataclass
class Loci:
    """Lines and circles of one point in plan, from known points."""

    rays: list[tuple[float, float, float]] = field(default_factory=list)
    """East and north of a known point, and bearing from it, radians."""
    lengths: list[tuple[float, float, float]] = field(default_factory=list)
    """East and north of a known point, and distance from it, metres."""
    rounds: list[tuple[Array, Array]] = field(default_factory=list)
    """Directions observed at the point itself to known points without common orientation: plan
    of the points (k, 2), directions (k,); an angle is a round of two."""
    coordinates: list[tuple[int, float]] = field(default_factory=list)
    """Known east (0) or north (1), metres."""

    @property
    def count(self) -> int:
        """Number of independent conditions."""
        return (
            len(self.rays)
            + len(self.lengths)
            + len(self.coordinates)
            + sum(len(a) - 1 for _, a in self.rounds)
        )

    def anchors(self) -> Array:
        """Return the known points of the loci, (m, 2)."""
        parts = [np.array([r[:2] for r in (*self.rays, *self.lengths)]).reshape(-1, 2)]
        parts += [p for p, _ in self.rounds]
        return np.concatenate(parts)


@dataclass(frozen=True)
class Crossing:
    """A position at which two loci meet."""

    plan: Array
    """East and north, metres, (2,)."""
    misfit: float
    """Mean of the capped misfits of all loci, relative to the size of the figure."""
    crossing: float
    """Sine of the angle at which the loci cross."""


def crossings(loci: Loci, size: float) -> list[Crossing]:
    """Return the positions where two loci meet, the best fitting first, each once.

    Args:
        loci: lines and circles.
        size: size of the figure, metres.
    """
    shapes = _shapes(loci)
    found: list[tuple[Array, float]] = []
    for a, b in combinations(shapes[:MAX_LOCI_OF_POINT], 2):
        found += _meet(a, b, size)
    if not found:
        return []
    plan = np.array([p for p, _ in found])
    misfit = loci_misfits(loci, plan, size)
    listed = sorted(
        (Crossing(p, float(m), c) for (p, c), m in zip(found, misfit, strict=True)),
        key=lambda c: (round(c.misfit, 9), -c.crossing),
    )
    distinct: list[Crossing] = []
    for c in listed:
        for i, d in enumerate(distinct):
            if np.hypot(*(c.plan - d.plan)) <= SAME_POSITION_RATIO * size:
                if (
                    c.misfit <= MIN_MISFIT_RATIO * d.misfit + MIN_COMPARED_MISFIT
                    and c.crossing > d.crossing
                ):
                    distinct[i] = Crossing(d.plan, d.misfit, c.crossing)
                break
        else:
            distinct.append(c)
    return distinct


def loci_misfits(loci: Loci, plan: Array, size: float) -> Array:
    """Return the mean capped misfit of all loci at positions (k, 2), relative to ``size``."""
    parts: list[Array] = []
    for e, n, angle in loci.rays:
        d = plan - (e, n)
        along = d[:, 0] * np.sin(angle) + d[:, 1] * np.cos(angle)
        across = d[:, 0] * np.cos(angle) - d[:, 1] * np.sin(angle)
        parts.append(np.where(along > 0, np.abs(across), size))
    for e, n, length in loci.lengths:
        parts.append(np.abs(np.hypot(plan[:, 0] - e, plan[:, 1] - n) - length))
    for component, value in loci.coordinates:
        parts.append(np.abs(plan[:, component] - value))
    for points, directions in loci.rounds:
        d = points[None] - plan[:, None]
        distance = np.hypot(d[..., 0], d[..., 1])
        turned = np.arctan2(d[..., 0], d[..., 1]) - directions
        # k directions with one orientation are k − 1 conditions.
        off = np.abs(wrap(turned - circular_mean(turned)[:, None])) * distance
        off = np.where(distance > 1e-6 * size, off, size)
        parts += list(np.sort(off, axis=1)[:, 1:].T)
    return np.asarray(np.mean([np.minimum(p / size, MAX_RELATIVE_MISFIT) for p in parts], axis=0))


def _shapes(loci: Loci) -> list[tuple[str, Array, Array | float]]:
    shapes: list[tuple[str, Array, Array | float]] = [
        ("circle", np.array([e, n]), length) for e, n, length in loci.lengths
    ]
    shapes += [("ray", np.array([e, n]), np.array([np.sin(a), np.cos(a)])) for e, n, a in loci.rays]
    for component, value in loci.coordinates:
        start, along = np.zeros(2), np.zeros(2)
        start[component], along[1 - component] = value, 1.0
        shapes.append(("line", start, along))
    for points, directions in loci.rounds:
        k = len(points)
        half = max(k // 2, 1)
        for i in range(k - 1 if k > 2 else 1):
            circle = inscribed_circle(
                points[i], points[(i + half) % k], float(directions[(i + half) % k] - directions[i])
            )
            if circle is not None:
                shapes.append(("circle", *circle))
    if len(shapes) > MAX_LOCI_OF_POINT:
        shapes = [shapes[i] for i in np.linspace(0, len(shapes) - 1, MAX_LOCI_OF_POINT).astype(int)]
    return shapes


def inscribed_circle(a: Array, b: Array, angle: float) -> tuple[Array, float] | None:
    """Return centre and radius of the circle from which A and B appear under a clockwise angle.

    The centre lies ½ |AB| cot(angle) to the right of the line from A to B; none: A, B and the
    point lie on one line.
    """
    c = b - a
    if abs(np.sin(angle)) < 1e-3 or np.hypot(*c) == 0.0:
        return None
    centre = (a + b) / 2 + 0.5 / np.tan(angle) * np.array([c[1], -c[0]])
    return centre, float(np.hypot(*c) / (2 * abs(np.sin(angle))))


def _meet(
    a: tuple[str, Array, Array | float], b: tuple[str, Array, Array | float], size: float
) -> list[tuple[Array, float]]:
    """Return the positions where two loci meet, and the sines of their crossing angles."""
    if a[0] != "circle" and b[0] != "circle":
        u, v = np.asarray(a[2]), np.asarray(b[2])
        sine = float(u[0] * v[1] - u[1] * v[0])
        if abs(sine) < 1e-4:
            return []
        w = b[1] - a[1]
        s = (w[0] * v[1] - w[1] * v[0]) / sine
        t = (w[0] * u[1] - w[1] * u[0]) / sine
        if (a[0] == "ray" and s <= 0) or (b[0] == "ray" and t <= 0):
            return []
        return [(a[1] + s * u, abs(sine))]
    if a[0] != "circle":
        a, b = b, a
    centre, radius = a[1], float(a[2])
    if radius <= 0:
        return []
    if b[0] != "circle":
        u = np.asarray(b[2])
        w = centre - b[1]
        foot = float(w @ u)
        gap = abs(float(w[0] * u[1] - w[1] * u[0]))
        if gap > radius + 0.05 * size:
            return []
        half = float(np.sqrt(max((radius - gap) * (radius + gap), 0.0)))
        starts = {foot - half, foot + half}
        return [(b[1] + s * u, half / radius) for s in starts if s > 0 or b[0] == "line"]
    other, second = b[1], float(b[2])
    c = other - centre
    d = float(np.hypot(*c))
    if d < 1e-9 * size or d > radius + second + 0.05 * size:
        return []
    if abs(radius - second) > d + 0.05 * size:
        return []
    along = (d * d + (radius - second) * (radius + second)) / (2 * d)
    across = float(np.sqrt(max((radius - along) * (radius + along), 0.0)))
    u = c / d
    sine = d * across / (radius * second) if second > 0 else 0.0
    return [
        (centre + along * u + sign * across * np.array([-u[1], u[0]]), sine)
        for sign in ((1.0, -1.0) if across > 0 else (1.0,))
    ]


def loci_of_points(progress: SearchState) -> dict[int, Loci]:
    """Return the loci of every point unknown in plan, from known points."""
    s, plan = progress.survey, progress.plan
    placed = progress.placed
    if placed.all():
        return {}
    loci: defaultdict[int, Loci] = defaultdict(Loci)
    r = known_bearings(progress)
    for i, j, angle in zip(r.known.tolist(), r.unknown.tolist(), r.bearing.tolist(), strict=True):
        loci[j].rays.append((plan[i, 0], plan[i, 1], angle))
    e = s.edges
    length = progress.lengths()
    for near, far in ((e.a, e.b), (e.b, e.a)):
        rows = np.flatnonzero(placed[near] & ~placed[far] & np.isfinite(length))
        for i, j, v in zip(near[rows].tolist(), far[rows].tolist(), length[rows], strict=True):
            loci[j].lengths.append((plan[i, 0], plan[i, 1], float(v)))
    d = s.directions
    rows = np.flatnonzero(
        ~placed[d.station] & placed[d.target] & np.isnan(progress.orientation[d.third])
    )
    rows = rows[np.lexsort((d.value[rows], d.third[rows]))]
    groups, first = np.unique(d.third[rows], return_index=True)
    for own in np.split(rows, first[1:]) if len(groups) else []:
        if len(own) > 1:
            loci[int(d.station[own[0]])].rounds.append((plan[d.target[own], :2], d.value[own]))
    a = s.angles
    rows = np.flatnonzero(~placed[a.station] & placed[a.target] & placed[a.third])
    for i, j, k, v in zip(
        a.station[rows], a.target[rows], a.third[rows], a.value[rows], strict=True
    ):
        loci[int(i)].rounds.append((plan[[j, k], :2], np.array([0.0, v])))
    for p, known in loci.items():
        for c in (0, 1):
            if np.isfinite(plan[p, c]):
                known.coordinates.append((c, float(plan[p, c])))
    return loci


def figure_size(own: Loci) -> float:
    """Return the size of the figure of a point and its known points, metres."""
    anchors = own.anchors()
    spread = float(np.ptp(anchors, axis=0).max()) if len(anchors) else 0.0
    reach = max((length for *_, length in own.lengths), default=0.0)
    return max(spread, reach, 1e-6)


def unique_crossing(own: Loci, found: list[Crossing]) -> Crossing | None:
    """Return the best candidate; none: the second best fits nearly as well."""
    if not found:
        return None
    best = found[0]
    if len(found) > 1 and found[1].misfit < MIN_MISFIT_RATIO * best.misfit + MIN_COMPARED_MISFIT:
        return None
    return best


def intersect_in_plan(progress: SearchState, *, crossing: float) -> bool:
    """Fill points that two or more loci determine uniquely.

    Args:
        progress: is filled.
        crossing: smallest sine of the angle at which the loci cross.

    Returns:
        Whether any point was found.
    """
    found_any = False
    for p, own in loci_of_points(progress).items():
        if own.count < 2:
            continue
        best = unique_crossing(own, crossings(own, figure_size(own)))
        if best is not None and best.crossing >= crossing:
            found_any |= progress.set_plan(np.array([p]), best.plan[None])
    return found_any


def ambiguous_positions(progress: SearchState) -> list[tuple[int, list[Array]]]:
    """Return points with two positions that fit equally well, points with most loci first."""
    out: list[tuple[int, int, list[Array]]] = []
    for p, own in loci_of_points(progress).items():
        if own.count < 2:
            continue
        found = [c for c in crossings(own, figure_size(own)) if c.crossing >= MIN_CROSSING_SINE]
        if not found:
            continue
        limit = MIN_MISFIT_RATIO * found[0].misfit + MIN_COMPARED_MISFIT
        fitting = [c.plan for c in found if c.misfit <= limit]
        if len(fitting) == 2:
            out.append((-own.count, p, fitting))
    return [(p, fitting) for _, p, fitting in sorted(out, key=lambda o: o[:2])]


def contradiction_misfits(progress: SearchState) -> Array:
    """Return the misfits of the best positions of points with three or more loci."""
    found = []
    for own in loci_of_points(progress).values():
        if own.count >= 3:
            options = crossings(own, figure_size(own))
            found.append(options[0].misfit if options else MAX_RELATIVE_MISFIT)
    return np.array(found)


def three_spheres(centre: Array, radius: Array) -> list[Array]:
    """Return the two points (3,) at given distances from three points; empty: these lie on a line.

    Args:
        centre: the three points, (3, 3), metres.
        radius: the distances, (3,), metres. Spheres that narrowly miss each other give one point.
    """
    e1 = centre[1] - centre[0]
    d = float(np.linalg.norm(e1))
    if d == 0.0:
        return []
    e1 = e1 / d
    w = centre[2] - centre[0]
    i = float(w @ e1)
    e2 = w - i * e1
    j = float(np.linalg.norm(e2))
    if j < 1e-3 * d:
        return []
    e2 = e2 / j
    x = (radius[0] ** 2 - radius[1] ** 2 + d * d) / (2 * d)
    y = (radius[0] ** 2 - radius[2] ** 2 + i * i + j * j) / (2 * j) - i / j * x
    z2 = radius[0] ** 2 - x * x - y * y
    if z2 < -((0.1 * radius[0]) ** 2):
        return []
    z = float(np.sqrt(max(z2, 0.0)))
    foot = centre[0] + x * e1 + y * e2
    e3 = np.cross(e1, e2)
    return [foot + z * e3, foot - z * e3] if z > 0 else [foot]


def intersect_spheres(progress: SearchState) -> bool:
    """Fill points that three or more slope distances from complete points determine uniquely.

    A known height decides between two positions, or replaces a distance.

    Returns:
        Whether any point was found.
    """
    found_any = False
    for p, found in positions_in_space(progress):
        if len(found) == 1:
            found_any |= _place(progress, p, found[0])
    return found_any


def _place(progress: SearchState, p: int, xyz: Array) -> bool:
    at = progress.horizon.to_plan(xyz[None])
    placed = progress.set_plan(np.array([p]), at[:, :2])
    return progress.set_height(np.array([p]), at[:, 2]) or placed


def positions_in_space(progress: SearchState) -> list[tuple[int, list[Array]]]:
    """Return points with slope distances to complete points, and the positions that fit best.

    Positions (3,) are in the frame, metres. A point has several if they fit equally well.
    """
    e = progress.survey.edges
    complete = progress.complete
    usable = np.flatnonzero(np.isfinite(e.slope) & (complete[e.a] != complete[e.b]))
    far = np.where(complete[e.a[usable]], e.b[usable], e.a[usable])
    out = []
    for p in np.unique(far).tolist():
        rows = usable[far == p]
        near = np.where(e.a[rows] == p, e.b[rows], e.a[rows])
        centre = progress.horizon.from_plan(progress.plan[near])
        radius = e.slope[rows]
        found = _best(progress, p, _options(progress, p, centre, radius), centre, radius)
        if found:
            out.append((p, found))
    return out


def _options(progress: SearchState, p: int, centre: Array, radius: Array) -> list[Array]:
    """Return the positions where three spheres meet, or spheres and a known plan, (3,) each."""
    if progress.placed[p]:
        plan = progress.plan[p]
        near = progress.horizon.to_plan(centre)
        up = np.sqrt(np.maximum(radius**2 - np.sum((near[:, :2] - plan[:2]) ** 2, axis=1), 0.0))
        heights = np.concatenate([near[:, 2] + up, near[:, 2] - up])
        at = np.column_stack([np.tile(plan[:2], (len(heights), 1)), heights])
        return list(progress.horizon.from_plan(at))
    chosen = range(min(len(radius), MAX_SPHERES_OF_POINT))
    return [
        at
        for three in combinations(chosen, 3)
        for at in three_spheres(centre[list(three)], radius[list(three)])
    ]


def _best(
    progress: SearchState, p: int, options: list[Array], centre: Array, radius: Array
) -> list[Array]:
    """Return the options that fit best, each position once."""
    if not options:
        return []
    at = np.array(options)
    size = float(radius.max())
    off = np.abs(np.linalg.norm(at[:, None] - centre[None], axis=2) - radius) / size
    plan = progress.horizon.to_plan(at)
    known = np.isfinite(progress.plan[p])
    off = np.concatenate([off, np.abs(plan[:, known] - progress.plan[p, known]) / size], axis=1)
    misfit = np.minimum(off, MAX_RELATIVE_MISFIT).mean(axis=1)
    limit = MIN_MISFIT_RATIO * misfit.min() + MIN_COMPARED_MISFIT
    distinct: list[Array] = []
    for i in np.argsort(misfit, kind="stable"):
        new = all(np.linalg.norm(at[i] - d) > SAME_POSITION_RATIO * size for d in distinct)
        if new and (misfit[i] < limit or not distinct):
            distinct.append(at[i])
    return distinct


def start_from_slope_distances(progress: SearchState) -> bool:
    """Start a free network of slope distances only: a triangle, and a fourth point above it.

    Returns:
        Whether the network was started.
    """
    e = progress.survey.edges
    if np.isfinite(progress.plan).any() or not np.isfinite(e.slope).any():
        return False
    length: dict[int, dict[int, float]] = {}
    for a, b, s in zip(e.a.tolist(), e.b.tolist(), e.slope.tolist(), strict=True):
        if np.isfinite(s):
            length.setdefault(a, {})[b] = length.setdefault(b, {})[a] = s
    best: tuple[int, float, tuple[int, int, int]] | None = None
    for a in sorted(length, key=lambda k: -len(length[k]))[:MAX_START_TRIANGLE_POINTS]:
        for b, c in combinations(length[a], 2):
            if c in length[b]:
                shared = len(length[a].keys() & length[b].keys() & length[c].keys())
                sides = (length[a][b], length[a][c], length[b][c])
                size = _sine(*sides)
                if best is None or (min(shared, 1), size) > best[:2]:
                    best = (min(shared, 1), size, (a, b, c))
    if best is None:
        return False
    a, b, c = best[2]
    ab, ac, bc = length[a][b], length[a][c], length[b][c]
    north = (ab**2 + ac**2 - bc**2) / (2 * ab)
    east = float(np.sqrt(max(ac**2 - north**2, 0.0)))
    progress.plan[[a, b, c]] = [[0.0, 0.0, 0.0], [0.0, ab, 0.0], [east, north, 0.0]]
    for p, found in positions_in_space(progress):
        if len(found) == 2:
            _place(progress, p, max(found, key=lambda at: float(at[2])))
            break
    return True


def _sine(ab: float, ac: float, bc: float) -> float:
    """Return the sine of the angle at A of a triangle; 0 if the sides form no triangle."""
    cosine = (ab**2 + ac**2 - bc**2) / (2 * ab * ac)
    return float(np.sqrt(max(1.0 - cosine**2, 0.0)))
