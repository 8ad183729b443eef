"""Misclosures of traverses: of their angles, and of their coordinates.

A traverse runs along legs whose distance is measured, between held points or round back to where it
began; at each station between, the angle from one leg to the next is measured. From the azimuth α
of its first leg, the angles β and the horizontal distances d,

    α_{i+1} = α_i + π + β_i,   x_{i+1} = x_i + d_i sin α_i,   y_{i+1} = y_i + d_i cos α_i

up to the last point, and to the azimuth at its end. A traverse whose ends have no azimuth must be
as long, from end to end, as the held points are apart. Their standard deviations follow from those
of the angles and the distances. Approximate coordinates take no part, but held heights reduce slope
distances to the horizontal where no zenith angle does.

The places are found as surveyors find them: with a wrong angle, the coordinates computed from
either end agree at its station; with a wrong distance, the misclosure runs along its leg.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...frames import LocalFrame
from ...models.base import wrap
from ...network.network import Network
from ...types import Array
from .closures import WORST, loops
from .finding import TIMES, Finding
from .legs import Measured, Survey

STARTS = 200
"""Largest number of held points from which traverses are looked for."""
TIMES_PLANE = float(np.sqrt(-2.0 * np.log(0.001)))
"""Tolerance of a misclosure in the plane, in semi-axes of its ellipse: exceeded by chance once in
1000, as `TIMES` is by a single value."""
NAMED = 8
"""Largest number of points of a traverse that are named."""
MGON = np.pi / 200e3
"""Milligon, radians."""


@dataclass(frozen=True)
class Traverse:
    """A traverse: a way along legs, with the angles between them."""

    survey: Survey
    """Where its readings are."""
    points: tuple[str, ...]
    """Its points, (n + 1,); the last is the first one if it is closed."""

    @property
    def closed(self) -> bool:
        """Whether it ends where it began, and is tested without held points."""
        return self.points[0] == self.points[-1]

    def start(self) -> Measured | None:
        """Return the azimuth of the first leg; 0 of a closed traverse."""
        if self.closed:
            return Measured(0.0, 0.0)
        return self.survey.azimuth(self.points[0], self.points[1])

    def angular(self) -> tuple[float, float] | None:
        """Return the angular misclosure and its standard deviation, radians; none: no test."""
        first, angles = self.start(), self._angles()
        if self.closed:
            last = self.survey.angle(self.points[0], self.points[-2], self.points[1])
        else:
            # The azimuth back along the last leg, from a held point at the end.
            back = self.survey.azimuth(self.points[-1], self.points[-2])
            last = None if back is None else Measured(-back.value, back.variance)
        if first is None or last is None:
            return None
        parts = [first, *angles, last]
        total = sum(m.value for m in parts) + np.pi * (len(angles) + 1)
        sigma = np.sqrt(sum(m.variance for m in parts))
        return float(wrap(np.array(total))), float(sigma)

    def _angles(self) -> list[Measured]:
        """Return the angles between its legs, (n − 1,)."""
        found = []
        for a, at, b in zip(self.points, self.points[1:], self.points[2:], strict=False):
            angle = self.survey.angle(at, a, b)
            assert angle is not None
            found.append(angle)
        return found

    def computed(self) -> tuple[Array, Array, Array]:
        """Return coordinates (n + 1, 2) from its first point, azimuths (n,), and Σ of the last.

        Without an azimuth at its start it begins towards north, and only its length has a meaning.
        """
        first = self.start() or Measured(0.0, 0.0)
        angles = self._angles()
        legs = [self.survey.legs[a][b] for a, b in pairwise(self.points)]
        azimuth = first.value + np.cumsum([0.0, *(a.value + np.pi for a in angles)])
        along = np.column_stack([np.sin(azimuth), np.cos(azimuth)])
        begin = np.zeros(2) if self.closed else self.survey.held[self.points[0]]
        lengths = np.array([d.value for d in legs])
        x = begin + np.vstack([np.zeros(2), np.cumsum(lengths[:, None] * along, axis=0)])
        arm = (x[-1] - x[:-1]) @ np.array([[0.0, -1.0], [1.0, 0.0]])  # ∂x/∂α = y, ∂y/∂α = −x
        turns = np.array([first.variance, *(a.variance for a in angles)])
        stretch = np.array([d.variance for d in legs])
        covariance = (arm.T * turns) @ arm + (along.T * stretch) @ along
        return x, azimuth, covariance

    def linear(self) -> tuple[Array, Array, bool] | None:
        """Return the misclosure (2,), its Σ, and whether it has a direction; none: no test.

        Without an azimuth it is the difference of lengths, in the direction of the traverse.
        """
        x, _, covariance = self.computed()
        if self.closed:
            return x[-1], covariance, True
        end = self.survey.held[self.points[-1]]
        if self.start() is not None:
            return x[-1] - end, covariance, True
        begin = self.survey.held[self.points[0]]
        there, length = x[-1] - begin, float(np.hypot(*(end - begin)))
        reached = float(np.hypot(*there))
        if not reached:
            return None
        return there * (1.0 - length / reached), covariance, False

    def backwards(self) -> Traverse:
        """Return it from its end."""
        return Traverse(self.survey, self.points[::-1])

    def __str__(self) -> str:
        """Return its points."""
        shown = [repr(p) for p in self.points]
        if len(shown) > NAMED:
            shown = [*shown[: NAMED - 2], "…", *shown[-2:]]
        return f"the traverse {' – '.join(shown)} ({len(self.points) - 1} legs)"


def traverses(network: Network) -> Iterator[Finding]:
    """Iterate over traverses that do not close within the tolerance, the worst first."""
    if not isinstance(network.frame, LocalFrame):
        return
    survey = Survey.of(network)
    found: list[tuple[float, Finding]] = []
    for t in [*between_held(survey), *_polygons(survey)]:
        finding = _tested(t)
        if finding is not None:
            found.append((abs(finding.size) / finding.tolerance, finding))
    found.sort(key=lambda f: -f[0])
    for _, finding in found[:WORST]:
        yield finding


def between_held(survey: Survey) -> Iterator[Traverse]:
    """Iterate over the shortest traverses between held points."""
    order = {name: i for i, name in enumerate(survey.held)}
    for begin in [name for name in survey.held if name in survey.legs][:STARTS]:
        above: dict[str, str] = {begin: ""}
        waiting = deque([begin])
        while waiting:
            at = waiting.popleft()
            for other in survey.legs[at]:
                if other in above or (at != begin and not survey.angle(at, above[at], other)):
                    continue
                above[other] = at
                if other not in survey.held:
                    waiting.append(other)
                elif at != begin and order[other] > order[begin]:
                    way = [other]
                    while way[-1] != begin:
                        way.append(above[way[-1]])
                    t = Traverse(survey, tuple(way[::-1]))
                    yield t if t.start() is not None else t.backwards()


def _polygons(survey: Survey) -> Iterator[Traverse]:
    """Iterate over traverses that close, all of whose angles are measured."""
    names = [name for name in survey.legs if name in survey.angles]
    number = {name: i for i, name in enumerate(names)}
    ends = [(a, b) for a in names for b in survey.legs[a] if number[a] < number.get(b, -1)]
    start, end = (np.array([number[e[i]] for e in ends], dtype=np.intp) for i in range(2))
    for loop in loops(start, end):
        way = _way([ends[i] for i, _ in loop])
        turns = zip(way, way[1:], [*way[2:], way[1]], strict=False)
        if len(loop) > 2 and all(survey.angle(at, a, b) for a, at, b in turns):
            yield Traverse(survey, tuple(way))


def _way(legs: Sequence[tuple[str, str]]) -> list[str]:
    """Return the points along legs that close, the first one again at the end."""
    left = list(legs[1:])
    out = list(legs[0])
    while left:
        following = next(leg for leg in left if out[-1] in leg)
        left.remove(following)
        out.append(following[1] if following[0] == out[-1] else following[0])
    return out


def _tested(t: Traverse) -> Finding | None:
    """Return what does not close; none: all is within the tolerance."""
    angular = t.angular()
    if angular is not None and abs(angular[0]) > TIMES * angular[1]:
        return Finding(
            f"the angles of {t} do not close",
            _where_angle(t) + "look for a wrong direction or name, or at the held points",
            angular[0] / MGON,
            TIMES * angular[1] / MGON,
            "mgon",
        )
    linear = t.linear()
    if linear is None:
        return None
    w, covariance, directed = linear
    size = float(np.hypot(*w))
    if not size:
        return None
    if directed:  # the ellipse of Σ, in the direction of w
        limit = TIMES_PLANE * size / float(np.sqrt(w @ np.linalg.solve(covariance, w)))
    else:
        limit = TIMES * float(np.sqrt(w @ covariance @ w)) / size
    if size <= limit:
        return None
    what = "does not close" if directed else "is not as long as its ends are apart"
    return Finding(
        f"{t} {what}",
        (_where_leg(t, w) if directed else "")
        + "look for a wrong distance, height of instrument or name, or at the held points",
        1e3 * size,
        1e3 * limit,
        "mm",
    )


def _where_angle(t: Traverse) -> str:
    """Return at which station a wrong angle explains everything; empty: at none or at several."""
    if t.closed:
        return ""
    forth, back = t.computed()[0], t.backwards().computed()[0][::-1]
    apart = np.hypot(*(forth - back).T)
    best = int(np.argmin(apart))
    others = np.delete(apart, best)
    if apart[best] * 5.0 < others.min():
        return f"a wrong angle at {t.points[best]!r} explains it; "
    return ""


def _where_leg(t: Traverse, w: Array) -> str:
    """Return the legs of which one wrong distance explains everything; empty: none, or most."""
    _, azimuth, covariance = t.computed()
    across = np.column_stack([np.cos(azimuth), -np.sin(azimuth)])
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", across, covariance, across))
    fits = np.flatnonzero(np.abs(across @ w) < TIMES * sigma).tolist()
    if not fits or 2 * len(fits) > len(azimuth):
        return ""
    legs = " or ".join(f"{t.points[i]!r} – {t.points[i + 1]!r}" for i in fits)
    return f"a wrong distance {legs} explains it; "
