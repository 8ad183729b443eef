"""Choice of the simulated points that become control, held or weighted, in plan and in height."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from ...errors import Problem, known, unknown_name
from ...network.network import Network
from ...observations import ControlPoint
from ...types import Array
from ...units import MILLIMETRE
from ..parameters import Parameters, number, path_of
from .scene import Scene, corners, perimeter, spread

Pattern = Literal["full", "perimeter", "corners", "none", "named"]
Axis = tuple[str, float]
"""Coordinates of one kind, ``xy`` or ``z``, and their standard deviation."""


@dataclass(frozen=True)
class Control(Parameters):
    """Control points by pattern, in plan and in height, held or weighted.

    Patterns: ``full`` all points, ``perimeter`` points on the edge, ``corners`` points nearest to
    the corners of the rectangle around all points, ``none``, ``named`` points of a list.
    """

    horizontal: Pattern = "corners"
    """Pattern of points with known X and Y."""
    vertical: Pattern = "corners"
    """Pattern of points with known Z."""
    horizontal_count: int | None = number(None, least=1)
    """Number of points used of the pattern: the corners first, then far from one another."""
    vertical_count: int | None = number(None, least=1)
    """Number of points used of the pattern of points with known Z."""
    horizontal_points: tuple[str, ...] = ()
    """Names of points with known X and Y, for ``named``."""
    vertical_points: tuple[str, ...] = ()
    """Names of points with known Z, for ``named``."""
    sigma_horizontal_mm: float = number(0.0, least=0)
    """Standard deviation of X and of Y, mm; 0: X and Y are held."""
    sigma_vertical_mm: float = number(0.0, least=0)
    """Standard deviation of Z, mm; 0: Z is held."""
    parts: tuple[int, ...] = number((), least=0)
    """Parts whose points may be control points; empty: all parts."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields."""
        found = []
        for axis in ("horizontal", "vertical"):
            named = getattr(self, axis) == "named"
            if named != bool(getattr(self, f"{axis}_points")):
                what = f"goes with {axis} = 'named', which needs it"
                found.append(Problem(what, path_of(where, f"{axis}_points")))
            if named and getattr(self, f"{axis}_count") is not None:
                what = f"goes with a pattern, not with {axis} = 'named', which takes all of a list"
                found.append(Problem(what, path_of(where, f"{axis}_count")))
        return found

    def apply(self, scene: Scene, where: str) -> list[Problem]:
        """Make points of the plan control points; on problems return them and change nothing."""
        problems = self._problems(scene, where)
        if problems:
            return problems
        names = [n for p in self.parts or range(len(scene.points)) for n in scene.points[p]]
        names = list(dict.fromkeys(names))
        if not names:
            what = "these parts have no points; valid: those that bring points of their own"
            return [Problem(what, path_of(where, "parts"))]
        problems = self._outside(names, where)
        xy = scene.coordinates(names)[:, :2]
        axes: dict[str, dict[str, float]] = {}
        for kind, axis, sigma in (
            ("horizontal", "xy", self.sigma_horizontal_mm),
            ("vertical", "z", self.sigma_vertical_mm),
        ):
            for name in self._chosen(kind, names, xy, where, problems):
                axes.setdefault(name, {})[axis] = sigma * MILLIMETRE
        if problems:
            return problems
        for name in names:
            if name in axes:
                _make_control(scene.plan, name, axes[name])
        return []

    def _outside(self, names: list[str], where: str) -> list[Problem]:
        """Return the problems of named points that are in other parts."""
        valid = set(names)
        return [
            Problem(
                f"point {name!r} is not in these parts; known: {known(names, meant=name)}",
                path_of(where, f"{axis}_points"),
            )
            for axis in ("horizontal", "vertical")
            for name in getattr(self, f"{axis}_points")
            if name not in valid
        ]

    def _problems(self, scene: Scene, where: str) -> list[Problem]:
        n = len(scene.points)
        found = [
            Problem(f"there is no part {p}; valid: 0 to {n - 1}", path_of(where, "parts"))
            for p in self.parts
            if p >= n
        ]
        for axis in ("horizontal", "vertical"):
            key = path_of(where, f"{axis}_points")
            found += [
                Problem(unknown_name("point", name, scene.plan.points), key)
                for name in getattr(self, f"{axis}_points")
                if name not in scene.plan.points
            ]
        return found

    def _chosen(
        self, kind: str, names: list[str], xy: Array, where: str, problems: list[Problem]
    ) -> list[str]:
        """Return the names of the control points of one kind; add to the list ``problems``."""
        pattern: Pattern = getattr(self, kind)
        if pattern == "named":
            return list(getattr(self, f"{kind}_points"))
        at_corners = corners(xy)
        number_of: list[int] = []
        if pattern == "full":
            number_of = list(range(len(names)))
        elif pattern == "perimeter":
            number_of = sorted({*perimeter(xy), *at_corners})
        elif pattern == "corners":
            number_of = at_corners
        count: int | None = getattr(self, f"{kind}_count")
        if count is not None and count > len(number_of):
            what = f"is {count}, but {pattern!r} has {len(number_of)} points; valid: up to that"
            problems.append(Problem(what, path_of(where, f"{kind}_count")))
        if count is not None and count < len(number_of):
            first = [number_of.index(i) for i in at_corners]
            number_of = [number_of[i] for i in spread(xy[number_of], count, first)]
        return [names[i] for i in number_of]


def _make_control(plan: Network, name: str, sigma: dict[str, float]) -> None:
    """Hold coordinates of a point, or observe them: ``xy`` and ``z`` with their σ, metres."""
    point = plan.points[name]
    held = [
        f or sigma.get("z" if a == "z" else "xy") == 0.0
        for f, a in zip(point.fixed, "xyz", strict=True)
    ]
    plan.points[name] = replace(point, fixed=(held[0], held[1], held[2]))
    axes = [a for part, s in sigma.items() if s > 0 for a in part]
    axes = [a for a in axes if not held["xyz".index(a)]]
    if axes:
        weights = tuple(sigma["z" if a == "z" else "xy"] for a in axes)
        value = tuple(point.coordinates["xyz".index(a)] for a in axes)
        plan.add(ControlPoint(name, value, axes="".join(axes), sigma=weights, id=f"control {name}"))
