"""Misclosures of loops and of lines between given points, levelled or by GNSS, with reasons.

The loops are those of a tree of shortest ways: each observation that is not in the tree closes one
with the ways of its ends. Their misclosures w have the standard deviation √(Σσ²) of their sums.

Lines from one given point to another are loops through the datum, which each given point is joined
with by its coordinates.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..crs.reference_system import ReferenceSystem
from ..errors import known
from ..graph.equations import Equations
from ..observations import Observation
from ..observations.variances import LEVELLING, Along
from ..statistical_tests import TOLERANCE_IN_SIGMAS
from ..stochastic_model import StandardDeviation
from ..types import Array, Index
from .findings import (
    CONTRADICTION_FACTOR,
    Finding,
    exchanged_components,
    mistyped_coordinates,
    other_signs,
    reading_covariance,
)
from .reference_frames import other_zone_text
from .wrong_units import TRIED_LENGTH_UNITS

MAX_OBSERVATIONS_OF_LOOP = 8
"""Largest number of observations of a loop that are named."""
MAX_LISTED_MISCLOSURES = 20
"""Largest number of misclosures that are listed."""
MAX_EXPLANATIONS = 2
"""Largest number of readings, or points, of which one alone explains a misclosure: where more do,
none is named."""


@dataclass(frozen=True)
class ObservedDifferences:
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
    turn: Array
    """Rotation from the axes of the differences to those of the network, (d, d)."""


def closed_loops(start: Index, end: Index) -> Iterator[list[tuple[int, int]]]:
    """Iterate over closed loops: the edges of each, with +1, or −1 where one runs backwards.

    Args:
        start: numbers of the points at which edges start, (n,).
        end: numbers of the points at which they end, (n,).
    """
    n = int(max(start.max(initial=-1), end.max(initial=-1))) + 1
    beside: list[list[tuple[int, int, int]]] = [[] for _ in range(n)]
    ends = zip(start.tolist(), end.tolist(), strict=True)
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
    for number, (a, b) in enumerate(zip(start.tolist(), end.tolist(), strict=True)):
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


def misclosures(
    edges: ObservedDifferences, what: str, remedy: str, axes: Sequence[str]
) -> Iterator[Finding]:
    """Iterate over the loops that do not close within the tolerance, the worst first."""
    found: list[tuple[float, Finding]] = []
    for loop in closed_loops(edges.start, edges.end):
        number = np.array([i for i, _ in loop])
        sign = np.array([s for _, s in loop], dtype=float)
        w = sign @ edges.value[number]
        limit = TOLERANCE_IN_SIGMAS * np.sqrt(edges.variance[number].sum(axis=0))
        worst = int(np.argmax(np.abs(w) / limit))
        if abs(w[worst]) > limit[worst]:
            named = known((edges.label[i] for i, _ in loop), most=MAX_OBSERVATIONS_OF_LOOP)
            axis = f" in {axes[worst]}" if axes[worst] else ""
            why = _explaining_reading(edges, loop, w, limit)
            text = f"the loop of {len(loop)} {what} does not close{axis}{why and f', which {why}'}"
            text += f" ({named})"
            size, most = 1e3 * float(w[worst]), 1e3 * float(limit[worst])
            finding = Finding(text, remedy, size, most, "mm", cause=why)
            found.append((abs(size) / most, finding))
    yield from _worst_first(found)


def open_loops(equations: Equations) -> Iterator[Finding]:
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
    `contradicting_readings`.
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
        joined = ObservedDifferences(
            np.concatenate([np.zeros(len(given), dtype=np.intp), edges.start + 1]),
            np.concatenate([given + 1, edges.end + 1]),
            np.concatenate([values[given] @ edges.turn, edges.value]),
            np.concatenate(
                [np.square(sigmas[given]) @ np.square(edges.turn), edges.variance],
            ),
            [*(repr(table.names[i]) for i in given.tolist()), *edges.label],
            edges.turn,
        )
        named = tuple("xyz") if len(axes) == 3 else ()
        yield from _contradicting(joined, len(given), what, named, equations.network.crs)


def _contradicting(
    edges: ObservedDifferences,
    n_given: int,
    what: str,
    axes: Sequence[str],
    crs: ReferenceSystem | None,
) -> Iterator[Finding]:
    """Iterate over the lines through the datum that do not fit, the worst first.

    Args:
        edges: observed differences after those that join the given points with the datum.
        n_given: number of given points.
        what: what the differences are.
        axes: names of the axes; none for heights.
        crs: reference system of the given coordinates; none: it is not known.
    """
    found: list[tuple[float, Finding]] = []
    for loop in closed_loops(edges.start, edges.end):
        ends = [(i, s) for i, s in loop if i < n_given]
        readings = [(i, s) for i, s in loop if i >= n_given]
        if len(ends) != 2 or len(readings) < 2:
            continue
        # Along the line: from the end that the loop enters from the datum to the other.
        (first, s), (last, _) = sorted(ends, key=lambda e: -e[1])
        assert s == 1
        stated = edges.value[last] - edges.value[first]
        led = sum((sign * edges.value[i] for i, sign in readings), np.zeros_like(stated))
        limit = CONTRADICTION_FACTOR * np.sqrt(sum(edges.variance[i] for i, _ in loop))
        w = led - stated
        worst = int(np.argmax(np.abs(w) / limit))
        if abs(w[worst]) <= limit[worst]:
            continue
        named = known((edges.label[i] for i, _ in readings), most=MAX_OBSERVATIONS_OF_LOOP)
        axis = f" in {axes[worst]}" if axes else ""
        made, given = (", ".join(f"{x:.4f}" for x in v.tolist()) for v in (led, stated))
        why = _explained(led, stated, limit) or _explaining_reading(edges, readings, w, limit)
        why = why or (_mistyped_height(edges, first, last, w, limit) if not axes else "")
        text = (
            f"{len(readings)} {what} lead from the given point {edges.label[first]} to "
            f"{edges.label[last]} and miss it{axis}: they make {made} m, the given coordinates "
            f"{given} m{why and f', which {why}'} ({named})"
        )
        remedy = "look for a wrong reading, sign, unit or name, or wrong given coordinates"
        remedy += other_zone_text(crs, abs(float(w[worst]))) if axes else ""
        size, most = 1e3 * float(w[worst]), 1e3 * float(limit[worst])
        finding = Finding(text, remedy, size, most, "mm", cause=why)
        found.append((abs(size) / most, finding))
    yield from _worst_first(found)


def _worst_first(found: Sequence[tuple[float, Finding]]) -> Iterator[Finding]:
    """Iterate over findings, the largest first; of those with one cause over the first."""
    ordered = [finding for _, finding in sorted(found, key=lambda f: -f[0])]
    number = Counter(f.cause for f in ordered if f.cause)
    told: set[str] = set()
    kept = []
    for finding in ordered:
        if finding.cause in told:
            continue
        told |= {finding.cause} - {""}
        if (more := number[finding.cause] - 1) > 0:
            also = f"; the same explains {more} more misclosure{'s' * (more > 1)}"
            finding = replace(finding, what=finding.what + also)
        kept.append(finding)
    yield from kept[:MAX_LISTED_MISCLOSURES]


def _explained(led: Array, known: Array, limit: Array) -> str:
    """Return what makes a line fit as a whole, in words; empty if nothing does."""
    for why, value in _possible_differences(led):
        if np.all(np.abs(value - known) <= limit):
            return f"fits {why}"
    return ""


def _possible_differences(value: Array) -> Iterator[tuple[str, Array]]:
    """Iterate over what a difference may be instead, (d,), with a reason."""
    yield from other_signs(value)
    yield from ((f"in {unit}", f * value) for unit, f in TRIED_LENGTH_UNITS.items() if f != 1.0)
    yield from exchanged_components(value)


def _explaining_reading(
    edges: ObservedDifferences, loop: Sequence[tuple[int, int]], w: Array, limit: Array
) -> str:
    """Return which reading alone explains a misclosure w (d,), in words; empty if none does."""
    found = []
    for i, sign in loop:
        value = edges.value[i]
        fits = (
            why
            for why, v in _possible_differences(value)
            if np.all(np.abs(w + sign * (v - value)) < limit)
        )
        if (why := next(fits, None)) is not None:
            found.append(f"{edges.label[i]} {why}")
    if not 0 < len(found) <= MAX_EXPLANATIONS:
        return ""
    return f"{' or '.join(found)} explains"


def _mistyped_height(
    edges: ObservedDifferences, first: int, last: int, w: Array, limit: Array
) -> str:
    """Return which given height explains the miss w (1,) of a line, in words; empty if none does.

    Args:
        edges: the differences, those that join given points with the datum too.
        first: number of the given point where the line begins.
        last: number of that where it ends.
        w: line − given difference, metres.
        limit: its tolerance.
    """
    found = []
    for point, sign in ((first, 1.0), (last, -1.0)):
        given = float(edges.value[point][0])
        for why, z in mistyped_coordinates(given):
            if abs(float(w[0]) + sign * (z - given)) < float(limit[0]):
                found.append(f"the height {given:g} m of point {edges.label[point]} {why}")
    if not 0 < len(found) <= MAX_EXPLANATIONS:
        return ""
    return f"{' or '.join(found)} explains"


def line_sigma(o: Observation, start: Array, end: Array) -> float:
    """Return the standard deviation of a levelled line, metres; NaN if its length is not known."""
    sigma = o.sigma  # type: ignore[attr-defined]
    if not isinstance(sigma, StandardDeviation):
        return float(sigma)
    length = float(np.hypot(*(end - start)[:2]))
    stated = o.length_km  # type: ignore[attr-defined]
    return float(np.sqrt(LEVELLING.variance([sigma], Along(length, stated))[0]))


def _edges(equations: Equations, kind: str) -> ObservedDifferences | None:
    """Return the observations of a kind reduced to the marks; none: there are none.

    Heights of antennas are reduced along the verticals at the given coordinates; a vector with
    such heights between points without coordinates is left out. Vectors that were read along other
    axes than those of the network are turned into those of the first.
    """
    parts = []
    points = equations.unknowns["point"].values
    frame, axes = equations.network.frame, equations.network.axes_of_files
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
        covariance = reading_covariance(block)
        for i, ident in enumerate(block.ids):
            o = equations.network.observations.get(ident)
            if block.dimension == 1 and o is not None:
                covariance[i] = line_sigma(o, points[ends[0][i]], points[ends[1][i]]) ** 2
        # Without a length there is no tolerance.
        fine &= np.isfinite(covariance).all(axis=(1, 2))
        rows = np.flatnonzero(fine)
        labels = [block.labels(int(i)) for i in rows]
        start, end = (index[rows] for index in ends)
        turn = next((axes[i] for i in block.ids if i in axes), None)
        parts.append((start, end, value[rows], covariance[rows], labels, turn))
    if not parts:
        return None
    start, end, value, covariance = (np.concatenate([p[i] for p in parts]) for i in range(4))
    turn = next((p[5] for p in parts if p[5] is not None), np.eye(value.shape[1]))
    variance = np.einsum("ji,njk,ki->ni", turn, covariance, turn)
    labels = [name for p in parts for name in p[4]]
    return ObservedDifferences(start, end, value @ turn, variance, labels, turn)
