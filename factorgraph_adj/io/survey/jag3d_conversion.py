"""Conversion of points and accuracies of JAG3D; what is wrong is collected."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...network.network import Network
from ...stochastic import StandardDeviation
from .jag3d_model import Deflection, Group, PointRow, Reduction, Row

SHORTEST = 1e-6
"""Shortest length for which σ is computed, metres; JAG3D takes shorter ones for unstated."""


class Conversion:
    """A network that is made of rows of JAG3D, and the problems found so far."""

    def __init__(
        self, name: str, reduction: Reduction, point_sigma: float, problems: list[Problem]
    ) -> None:
        """Start with an empty network.

        Args:
            name: its name.
            reduction: reductions that JAG3D applies.
            point_sigma: σ of stochastic points that state none, metres.
            problems: problems found so far, to which others are added.
        """
        self.network = Network(name, frame=LocalFrame(radius=reduction.radius))
        self.reduction = reduction
        self.point_sigma = point_sigma
        self.problems = problems
        self.rows: dict[str, PointRow] = {}
        """Rows of points by name."""
        self.deflected: set[str] = set()
        """Names of the points with a deflection of the vertical."""

    def refuse(self, what: str, source: str) -> None:
        """Note a problem."""
        self.problems.append(Problem(what, source))

    def attempt(self, source: str, make: Callable[[], object]) -> None:
        """Call a function, and note the problems of its InputError."""
        try:
            make()
        except InputError as error:
            for p in error.problems:
                where = p.where.removeprefix(source).removeprefix(": ")
                self.refuse(f"{where}: {p.what}" if where else p.what, source)

    # -- points -----------------------------------------------------------------------------------

    def add_points(self, points: Sequence[PointRow]) -> None:
        """Add the points; datum points make the network a free one."""
        free = any(p.status == "datum" for p in points)
        if free:
            self.network.datum = "free"
        for row in points:
            if row.name in self.rows:
                first = self.rows[row.name].source
                self.refuse(f"point {row.name!r} stands in {first} already", row.source)
                continue
            self.rows[row.name] = row
            if free and row.status in ("reference", "stochastic"):
                what = (
                    f"{row.status} point {row.name!r} beside datum points, next to which JAG3D "
                    "leaves such points and their observations out: give the points of one of "
                    "the two kinds"
                )
                self.refuse(what, row.source)
                continue
            self.attempt(row.source, lambda row=row: self._add_point(row))  # type: ignore[misc]

    def _add_point(self, row: PointRow) -> None:
        y, x, z = row.yxz
        held = {1: "xy", 2: "z", 3: ""}[row.dimension]
        unknown = [axis not in held for axis in "xyz"]
        if row.dimension == 1 and (math.isnan(x) or math.isnan(y)):
            y = x = 0.0
        if row.dimension == 2 and math.isnan(z):
            z = 0.0
        sigma: tuple[float, ...] | None = None
        if row.status == "stochastic":
            stated = [self.point_sigma if not s > 0 else s for s in row.sigma]
            sigma = tuple(s if u else math.inf for s, u in zip(stated, unknown, strict=True))
        self.network.add_point(
            row.name,
            (y, x, z),
            fixed="xyz" if row.status == "reference" else held,
            sigma=sigma,
            datum=row.status == "datum",
        )

    def add_deflections(self, deflections: Sequence[Deflection]) -> None:
        """State deflections of the vertical."""
        for d in deflections:
            if d.name not in self.network.points:
                continue  # JAG3D ignores deflections of points that do not take part
            self.deflected.add(d.name)
            ry, rx = d.yx
            sigma = None if d.sigma is None else (d.sigma[0], d.sigma[1])
            self.attempt(
                d.source,
                lambda d=d, rx=rx, ry=ry, sigma=sigma: self.network.set_vertical(  # type: ignore[misc]
                    d.name, xi=-ry, eta=rx, sigma=sigma, fixed=sigma is None and not d.free
                ),
            )

    # -- standard deviations ----------------------------------------------------------------------

    def length(self, row: Row, *, plan: bool) -> float:
        """Return the length for σ, metres: the stated one, or that of the coordinates."""
        if row.distance > SHORTEST:
            return row.distance
        ends = [self.rows[name] for name in (row.start, row.end)]
        start, end = (np.array(p.yxz) for p in ends)
        if any(p.dimension == 1 and not np.any(np.nan_to_num(p.yxz[:2])) for p in ends):
            start, end = start * math.nan, end
        d = end - start + (0.0, 0.0, row.th - row.ih)
        size = math.hypot(d[0], d[1]) if plan else float(np.linalg.norm(d))
        if not size > SHORTEST:
            what = (
                "its σ depends on its length, which neither the row nor coordinates of its points "
                "state: write a σ or the length at the end of the row"
            )
            raise InputError(Problem(what, row.source))
        return size

    def of_length(self, group: Group, row: Row) -> float | StandardDeviation:
        """Return σ of a distance."""
        if row.sigma[0] > 0:
            return row.sigma[0]
        a, b, c = group.uncertainty
        if b == 0.0 and not row.distance > SHORTEST:
            return StandardDeviation(a, ppm=1e6 * c, combine="quadratic") if c > 0 else a
        d = row.distance if row.distance > SHORTEST else row.value[0]
        return along(group, d)

    def of_angle(self, group: Group, row: Row, *, plan: bool) -> float | StandardDeviation:
        """Return σ of a direction or zenith angle."""
        if row.sigma[0] > 0:
            return row.sigma[0]
        a, b, c = group.uncertainty
        if b == c == 0.0:
            return a
        if b == 0.0 and not row.distance > SHORTEST:
            return StandardDeviation(a, centring_target=c, combine="quadratic")
        d = self.length(row, plan=plan)
        return math.sqrt(a * a + b * b / d + c * c / (d * d))


def along(group: Group, d: float) -> float:
    """Return σ of a length d, metres."""
    a, b, c = group.uncertainty
    return math.sqrt(a * a + b * b * d / 1000.0 + (c * d) ** 2)
