"""Closures of levelled loops and of loops of GNSS vectors.

The loops are those of a tree of shortest ways: each observation that is not in the tree closes one
with the ways of its ends. Their misclosures w have the standard deviation √(Σσ²) of their sums.

Lines from one given point to another are loops through the datum, which each given point is joined
with by its coordinates.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ...graph.equations import Equations
from ...observations import Observation
from ...observations.weights import LEVELLING, Along
from ...stochastic import StandardDeviation
from ...types import Array, Index
from .finding import CONTRADICTS, TIMES, Finding
from .given_units import LENGTHS

NAMED = 8
"""Largest number of observations of a loop that are named."""
WORST = 20
"""Largest number of misclosures that are listed."""


@dataclass(frozen=True)
class Edges:
    """Observed differences between points."""

    start: Index
    """Numbers of the points at which they start, (n,)."""
    end: Index
    """Numbers of the points at which they end, (n,)."""
    value: Array
    """Differences, metres, (n, d)."""
    variance: Array
    """Variances, (n, d)."""
    label: Sequence[str]
    """Readable names, (n,)."""


def loops(edges: Edges) -> Iterator[list[tuple[int, int]]]:
    """Iterate over closed loops: the edges of each, with +1, or −1 where one runs backwards."""
    n = int(max(edges.start.max(initial=-1), edges.end.max(initial=-1))) + 1
    beside: list[list[tuple[int, int, int]]] = [[] for _ in range(n)]
    ends = zip(edges.start.tolist(), edges.end.tolist(), strict=True)
    for number, (a, b) in enumerate(ends):
        beside[a].append((b, number, 1))
        beside[b].append((a, number, -1))
    depth = np.full(n, -1)
    above: list[tuple[int, int, int]] = [(-1, -1, 0)] * n
    used: set[int] = set()
    for root in range(n):
        if depth[root] >= 0 or not beside[root]:
            continue
        depth[root] = 0
        waiting = deque([root])
        while waiting:
            at = waiting.popleft()
            for other, number, sign in beside[at]:
                if depth[other] < 0:
                    depth[other] = depth[at] + 1
                    above[other] = (at, number, sign)
                    used.add(number)
                    waiting.append(other)
    for number, (a, b) in enumerate(zip(edges.start.tolist(), edges.end.tolist(), strict=True)):
        if number in used:
            continue
        loop = [(number, 1)]
        up, down = a, b  # back from b to a
        while up != down:
            if depth[down] >= depth[up]:
                parent, edge, sign = above[down]
                loop.append((edge, -sign))
                down = parent
            else:
                parent, edge, sign = above[up]
                loop.append((edge, sign))
                up = parent
        yield loop


def misclosures(edges: Edges, what: str, remedy: str, axes: Sequence[str]) -> Iterator[Finding]:
    """Iterate over the loops that do not close within the tolerance, the worst first."""
    found: list[tuple[float, Finding]] = []
    for loop in loops(edges):
        number = np.array([i for i, _ in loop])
        sign = np.array([s for _, s in loop], dtype=float)
        w = sign @ edges.value[number]
        limit = TIMES * np.sqrt(edges.variance[number].sum(axis=0))
        worst = int(np.argmax(np.abs(w) / limit))
        if abs(w[worst]) > limit[worst]:
            named = [edges.label[i] for i in number[:NAMED].tolist()]
            more = f" … ({len(loop)} in all)" if len(loop) > NAMED else ""
            axis = f" in {axes[worst]}" if axes[worst] else ""
            text = f"the loop of {len(loop)} {what} does not close{axis} ({', '.join(named)}{more})"
            size, most = 1e3 * float(w[worst]), 1e3 * float(limit[worst])
            found.append((abs(size) / most, Finding(text, remedy, size, most, "mm")))
    found.sort(key=lambda f: -f[0])
    for _, finding in found[:WORST]:
        yield finding


def closures(equations: Equations) -> Iterator[Finding]:
    """Iterate over levelled loops and loops of GNSS vectors that do not close."""
    for kind, axes, what in (
        ("height_difference", ("",), "height differences"),
        ("gnss_vector", ("x", "y", "z"), "GNSS vectors"),
    ):
        edges = _edges(equations, kind)
        if edges is not None:
            remedy = "look for a wrong reading, sign or name among them"
            yield from misclosures(edges, what, remedy, axes)


def lines_between_given(equations: Equations) -> Iterator[Finding]:
    """Iterate over levelled lines and chains of GNSS vectors that contradict given coordinates.

    They lead over new points from one given point to another; single readings are compared by
    `between_given`.
    """
    table = equations.unknowns["point"]
    sigma = np.where(table.free, table.sigma, 0.0)
    for kind, axes, what in (
        ("height_difference", (2,), "height differences"),
        ("gnss_vector", (0, 1, 2), "GNSS vectors"),
    ):
        edges = _edges(equations, kind)
        if edges is None:
            continue
        values, sigmas = table.values[:, list(axes)], sigma[:, list(axes)]
        used = np.unique([edges.start, edges.end])
        given = used[np.isfinite(values[used] + sigmas[used]).all(axis=1)]
        if len(given) < 2:
            continue
        # The datum is number 0, so that every way begins there.
        joined = Edges(
            np.concatenate([np.zeros(len(given), dtype=np.intp), edges.start + 1]),
            np.concatenate([given + 1, edges.end + 1]),
            np.concatenate([values[given], edges.value]),
            np.concatenate([np.square(sigmas[given]), edges.variance]),
            [*(repr(table.names[i]) for i in given.tolist()), *edges.label],
        )
        named = tuple("xyz") if len(axes) == 3 else ()
        yield from _contradicting(joined, len(given), what, named)


def _contradicting(edges: Edges, n_given: int, what: str, axes: Sequence[str]) -> Iterator[Finding]:
    """Iterate over the lines through the datum that do not fit, the worst first.

    Args:
        edges: observed differences after those that join the given points with the datum.
        n_given: number of given points.
        what: what the differences are.
        axes: names of the axes; none for heights.
    """
    found: list[tuple[float, Finding]] = []
    for loop in loops(edges):
        ends = [(i, s) for i, s in loop if i < n_given]
        readings = [(i, s) for i, s in loop if i >= n_given]
        if len(ends) != 2 or len(readings) < 2:
            continue
        # Along the line: from the end that the loop enters from the datum to the other.
        (first, s), (last, _) = sorted(ends, key=lambda e: -e[1])
        assert s == 1
        known = edges.value[last] - edges.value[first]
        led = sum((sign * edges.value[i] for i, sign in readings), np.zeros_like(known))
        limit = CONTRADICTS * np.sqrt(sum(edges.variance[i] for i, _ in loop))
        w = led - known
        worst = int(np.argmax(np.abs(w) / limit))
        if abs(w[worst]) <= limit[worst]:
            continue
        named = [edges.label[i] for i, _ in readings[:NAMED]]
        more = f" … ({len(readings)} in all)" if len(readings) > NAMED else ""
        axis = f" in {axes[worst]}" if axes else ""
        made, given = (", ".join(f"{x:.4f}" for x in v.tolist()) for v in (led, known))
        text = (
            f"{len(readings)} {what} lead from the given point {edges.label[first]} to "
            f"{edges.label[last]} and miss it{axis}: they make {made} m, the given coordinates "
            f"{given} m{_explained(led, known, limit)} ({', '.join(named)}{more})"
        )
        remedy = "look for a wrong reading, sign, unit or name, or wrong given coordinates"
        size, most = 1e3 * float(w[worst]), 1e3 * float(limit[worst])
        found.append((abs(size) / most, Finding(text, remedy, size, most, "mm")))
    found.sort(key=lambda f: -f[0])
    for _, finding in found[:WORST]:
        yield finding


def _explained(led: Array, known: Array, limit: Array) -> str:
    """Return what makes a line fit, in words; empty if nothing does."""
    tried = {"with the other sign": -led}
    tried |= {f"in {unit}": factor * led for unit, factor in LENGTHS.items() if factor != 1.0}
    if len(led) == 3:
        tried["with x and y exchanged"] = led[[1, 0, 2]]
    fits = [why for why, value in tried.items() if np.all(np.abs(value - known) <= limit)]
    return f", which fits {fits[0]}" if fits else ""


def of_line(o: Observation, start: Array, end: Array) -> float:
    """Return the standard deviation of a levelled line, metres; NaN if its length is not known."""
    sigma = o.sigma  # type: ignore[attr-defined]
    if not isinstance(sigma, StandardDeviation):
        return float(sigma)
    length = float(np.hypot(*(end - start)[:2]))
    stated = o.length_km  # type: ignore[attr-defined]
    return float(np.sqrt(LEVELLING.variance([sigma], Along(length, stated))[0]))


def _edges(equations: Equations, kind: str) -> Edges | None:
    """Return the observations of a kind reduced to the marks; none: there are none.

    Heights of antennas are reduced along the verticals at the given coordinates; a vector with
    such heights between points without coordinates is left out.
    """
    parts = []
    points = equations.unknowns["point"].values
    frame = equations.network.frame
    for block in equations.blocks:
        if block.kind != kind or block.prior:
            continue
        ends = [index for what, index in block.variables if what == "point"]
        value, fine = block.observed.copy(), np.ones(block.n, dtype=bool)
        for name, index, sign in zip(("instrument", "target"), ends, (1.0, -1.0), strict=True):
            height = block.constants.get(f"{name}_height", np.zeros(block.n))
            if block.dimension == 1:
                value[:, 0] += sign * height
            elif height.any():
                fine &= np.isfinite(points[index]).all(axis=1) | (height == 0)
                at = np.nan_to_num(points[index])
                basis = frame.basis(at[fine], np.zeros((int(fine.sum()), 2)))
                value[fine] += sign * height[fine, None] * basis.enu[:, 2]
        sigma = block.sigma.copy()
        for i, ident in enumerate(block.ids):
            o = equations.network.observations.get(ident)
            if block.dimension == 1 and o is not None:
                sigma[i] = of_line(o, points[ends[0][i]], points[ends[1][i]])
        fine &= np.isfinite(sigma).all(axis=1)  # without a length there is no tolerance
        rows = np.flatnonzero(fine)
        labels = [block.labels(int(i)) for i in rows]
        start, end = (index[rows] for index in ends)
        parts.append((start, end, value[rows], np.square(sigma[rows]), labels))
    if not parts:
        return None
    start, end, value, variance = (np.concatenate([p[i] for p in parts]) for i in range(4))
    return Edges(start, end, value, variance, [name for p in parts for name in p[4]])
