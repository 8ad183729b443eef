"""What a network is to achieve: targets, and what fails them.

Every target has figures, one for each of its items (points, or scalar observations), and a limit.
How far an item is from its target is measured by the logarithm of figure and limit, so that
figures of different kinds can be added up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from glob import escape
from typing import Literal, TypeAlias

import numpy as np

from ..errors import InputError, Problem
from ..quality.ellipses import FLAT, confidence_factor
from ..types import Array, Mask

LEAST = 1e-6
"""Redundancy number below which nothing controls an observation."""
MOST = 1e9
"""Figure of what is not controlled at all, relative to its limit."""


@dataclass(frozen=True)
class SemiAxis:
    """No semi-major axis of a point's confidence ellipse, or ellipsoid, is longer."""

    at_most: float
    """Metres."""
    confidence: float = 0.95
    """Probability of the region, σ0 known."""
    points: tuple[str, ...] = ("*",)
    """Names, or patterns with ``*`` and ``?``."""
    dimension: Literal[2, 3] = 2
    """Ellipse in the horizon, or ellipsoid."""


@dataclass(frozen=True)
class PointPrecision:
    """No standard deviation of a coordinate is larger."""

    at_most: float
    """Metres."""
    points: tuple[str, ...] = ("*",)
    """Names, or patterns."""
    axes: str = "xyz"
    """Which coordinates."""


@dataclass(frozen=True)
class RedundancyNumber:
    """No redundancy number is smaller."""

    at_least: float
    """From 0 to 1."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns; weighted unknowns by names such as ``point P1 x``."""


@dataclass(frozen=True)
class DetectableError:
    """No smallest detectable error is larger."""

    at_most: float
    """Multiples of the observation's own standard deviation."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns."""


@dataclass(frozen=True)
class UndetectedShift:
    """No error that may stay undetected moves a point by more: √(∇x² + ∇y² + ∇z²)."""

    at_most: float
    """Metres."""
    points: tuple[str, ...] = ("*",)
    """Names, or patterns."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns, of the observations that may be wrong."""


PointTarget: TypeAlias = SemiAxis | PointPrecision
RowTarget: TypeAlias = RedundancyNumber | DetectableError | UndetectedShift
Target: TypeAlias = PointTarget | RowTarget
TARGETS: dict[str, type[Target]] = {
    "semi_axis": SemiAxis,
    "point_precision": PointPrecision,
    "redundancy_number": RedundancyNumber,
    "detectable_error": DetectableError,
    "undetected_shift": UndetectedShift,
}
"""Kinds of targets, as files name them."""


@dataclass(frozen=True)
class Shortfall:
    """An item that fails a target."""

    target: Target
    """The target."""
    item: str
    """Name of the point, or label of the observation."""
    figure: float
    """What it has; infinite, or 0, where nothing controls it."""

    def __str__(self) -> str:
        """Say what fails, and by how much."""
        limit, sign = limit_of(self.target), "<" if at_least(self.target) else ">"
        return f"{self.item}: {describe(self.target)} {short(self.figure)} {sign} {short(limit)}"


def short(value: float) -> str:
    """Return a figure in three digits, rounding errors as zero."""
    return f"{value if abs(value) > 1e-12 else 0.0:.3g}"


def limit_of(target: Target) -> float:
    """Return the limit of a target."""
    return target.at_least if isinstance(target, RedundancyNumber) else target.at_most


def at_least(target: Target) -> bool:
    """Return whether figures are to be no smaller than the limit."""
    return isinstance(target, RedundancyNumber)


def describe(target: Target) -> str:
    """Return what the figures of a target are."""
    if isinstance(target, SemiAxis):
        region = "ellipse" if target.dimension == 2 else "ellipsoid"
        return f"{100 * target.confidence:g} % semi-axis of the {region} (m)"
    if isinstance(target, PointPrecision):
        return f"largest σ of {target.axes} (m)"
    if isinstance(target, RedundancyNumber):
        return "redundancy number"
    if isinstance(target, DetectableError):
        return "smallest detectable error (σ)"
    return "shift by an undetected error (m)"


def check_targets(targets: Iterable[Target], points: Sequence[str]) -> None:
    """Check limits and names.

    Raises:
        InputError: every limit that nothing can meet, every pattern that no point has.
    """
    problems = []
    for n, t in enumerate(targets):
        where = f"target {n + 1}, {describe(t)}"
        limit = limit_of(t)
        if not (np.isfinite(limit) and limit > 0):
            problems.append(Problem(f"its limit must be greater than zero, not {limit}", where))
        if isinstance(t, RedundancyNumber) and not 0 < limit < 1:
            problems.append(Problem(f"redundancy numbers lie between 0 and 1, not {limit}", where))
        if isinstance(t, SemiAxis) and not 0 < t.confidence < 1:
            problems.append(
                Problem(f"the confidence must lie in (0, 1), not {t.confidence}", where)
            )
        if isinstance(t, PointPrecision) and not (t.axes and set(t.axes) <= set("xyz")):
            problems.append(Problem(f"axes are letters of xyz, not {t.axes!r}", where))
        if not isinstance(t, RedundancyNumber | DetectableError):
            problems += [
                Problem(f"no point is named like {p!r}", where)
                for p in t.points
                if not any(fnmatchcase(name, p) for name in points)
            ]
    if problems:
        raise InputError(problems)


def matching(names: Sequence[str], patterns: Sequence[str]) -> Mask:
    """Return which names are like one of some patterns, (n,)."""
    return np.array([any(fnmatchcase(n, p) for p in patterns) for n in names], dtype=bool)


def for_points(target: Target, names: Sequence[str]) -> Target:
    """Return the target with its patterns written out for some points."""
    if isinstance(target, RedundancyNumber | DetectableError):
        return target
    chosen = matching(names, target.points)
    return replace(
        target, points=tuple(escape(n) for n, on in zip(names, chosen, strict=True) if on)
    )


def point_figures(target: PointTarget, blocks: Array, horizon: Array) -> Array:
    """Return the figures of points, (n,).

    Args:
        target: what is asked.
        blocks: covariances in the frame of the network, (n, 3, 3), metres².
        horizon: east and north of each point in the frame, (n, 2, 3).
    """
    if isinstance(target, PointPrecision):
        chosen = ["xyz".index(a) for a in target.axes]
        variances = np.einsum("nii->ni", blocks)[:, chosen]
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)).max(axis=1))
    k = target.dimension
    regions = blocks if k == 3 else horizon @ blocks @ np.swapaxes(horizon, 1, 2)
    values = np.linalg.eigvalsh(regions)
    # A held axis has no part in the region: that of the others is an interval, or an ellipse.
    free = np.sum(values > FLAT * values[:, -1:], axis=1)
    factors = np.array([0.0, *(confidence_factor(d, target.confidence) for d in range(1, k + 1))])
    return np.asarray(factors[free] * np.sqrt(np.maximum(values[:, -1], 0.0)))


def lacking(target: Target, figures: Array) -> Array:
    """Return how far figures are from their target: log of figure and limit, 0 where they meet it.

    Args:
        target: what is asked.
        figures: (n,); infinite, or 0, where nothing controls an item.
    """
    limit = limit_of(target)
    if at_least(target):
        return np.asarray(np.maximum(np.log(limit / np.maximum(figures, LEAST)), 0.0))
    ratio = np.where(np.isfinite(figures), figures / limit, MOST)
    return np.asarray(np.maximum(np.log(np.clip(ratio, 1e-300, MOST)), 0.0))
