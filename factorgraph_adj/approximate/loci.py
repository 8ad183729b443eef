"""Lines and circles in plan on which an unknown point lies, and their intersections."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ..models.base import wrap
from ..types import Array

MOST_LOCI = 16
"""Largest number of lines and circles of one point that are intersected by pairs."""
CAP = 0.1
"""Misfit relative to the size of the figure that counts as a blunder; larger misfits are capped."""
SAME = 0.02
"""Distance relative to the size of the figure up to which two positions count as one."""
SURE = 3.0
"""Smallest ratio of the misfits of the second best and the best position of a sure decision."""
NOISE = 1e-4
"""Misfit relative to the size of the figure below which misfits are not compared."""


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
    for a, b in combinations(shapes[:MOST_LOCI], 2):
        found += _meet(a, b, size)
    if not found:
        return []
    plan = np.array([p for p, _ in found])
    misfit = misfits(loci, plan, size)
    listed = sorted(
        (Crossing(p, float(m), c) for (p, c), m in zip(found, misfit, strict=True)),
        key=lambda c: (round(c.misfit, 9), -c.crossing),
    )
    distinct: list[Crossing] = []
    for c in listed:
        for i, d in enumerate(distinct):
            if np.hypot(*(c.plan - d.plan)) <= SAME * size:
                if c.misfit <= SURE * d.misfit + NOISE and c.crossing > d.crossing:
                    distinct[i] = Crossing(d.plan, d.misfit, c.crossing)
                break
        else:
            distinct.append(c)
    return distinct


def misfits(loci: Loci, plan: Array, size: float) -> Array:
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
        mean = np.arctan2(np.sin(turned).mean(axis=1), np.cos(turned).mean(axis=1))
        # k directions with one orientation are k − 1 conditions.
        off = np.abs(wrap(turned - mean[:, None])) * distance
        off = np.where(distance > 1e-6 * size, off, size)
        parts += list(np.sort(off, axis=1)[:, 1:].T)
    return np.asarray(np.mean([np.minimum(p / size, CAP) for p in parts], axis=0))


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
    if len(shapes) > MOST_LOCI:
        shapes = [shapes[i] for i in np.linspace(0, len(shapes) - 1, MOST_LOCI).astype(int)]
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
