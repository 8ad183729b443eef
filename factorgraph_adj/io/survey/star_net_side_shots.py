"""Side shots of STAR*NET data: points that one SS line each gives, after the adjustment.

A side shot bears on no other point. Every SS line therefore makes a point of its own, with as many
observations as coordinates: it has no redundancy, so that an adjustment gives it exactly the place
and the covariance that follow from the adjusted station, backsight and readings, and gives all
others what it would without it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from ...observations import Observation
from .star_net_points import StarNetPoint, StarNetPoints


@dataclass(frozen=True)
class SideShot:
    """An SS line."""

    line: int
    """Its line."""
    target: str
    """Name of the point in the line."""
    observations: tuple[Observation, ...]
    """What it observes."""

    def named(self, name: str) -> list[Observation]:
        """Return its observations to a point of another name."""
        if name == self.target:
            return list(self.observations)
        ends = ("target", "target2")
        return [
            replace(o, **{e: name for e in ends if getattr(o, e, None) == self.target})
            for o in self.observations
        ]


def placed_side_shots(
    shots: Iterable[SideShot], points: StarNetPoints, others: Iterable[Observation]
) -> list[Observation]:
    """Add a point for each side shot; return the observations of them all.

    The point has its name in the line. Where other lines observe, hold or weight that point, or
    another side shot gave it, a number is added (``X.2``): a side shot checks nothing.
    """
    taken = {name for o in others for name in o.points()}
    taken |= {n for n, p in points.points.items() if any(s < float("inf") for s in p.sigmas)}
    shots = list(shots)
    named = {s.target for s in shots}
    out: list[Observation] = []
    for shot in shots:
        name, number = shot.target, 1
        while name in taken or (number > 1 and (name in points.points or name in named)):
            number += 1
            name = f"{shot.target}.{number}"
        taken.add(name)
        point = points.points.setdefault(name, StarNetPoint(shot.line))
        point.side_shot = True
        out += shot.named(name)
    return out
