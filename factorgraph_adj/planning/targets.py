"""What a network is to achieve: targets, and what fails them.

Every target has figures, one for each of its items (points, or scalar observations), and a limit.
How far an item is from its target is measured by the logarithm of figure and limit, so that
figures of different kinds can be added up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, Problem, known
from ..graph.equations import Equations
from ..quality.ellipses import confidence_factor
from ..quality.levels import CONFIDENCE
from ..types import Array
from .patterns import Name, matching, patterns_of, unlike

LEAST = 1e-6
"""Redundancy number below which nothing controls an observation."""
MOST = 1e9
"""Figure of what is not controlled at all, relative to its limit."""
MET = 1e-9
"""Logarithm of figure and limit that is rounding: the limit is met."""
FLAT = 1e-10
"""Variance of an axis relative to the largest that is rounding: the axis has no part in a region.

Points that carry the datum of a free network have flat covariances by an S-transformation, whose
subtractions leave about 1e-13; an axis that is there is not 1e-5 of the largest.
"""


def _settle(target: object) -> None:
    for field in ("points", "observations"):
        if hasattr(target, field):
            object.__setattr__(target, field, patterns_of(getattr(target, field)))


@dataclass(frozen=True)
class SemiAxis:
    """No semi-major axis of a point's confidence ellipse, or ellipsoid, is longer."""

    at_most: float
    """Metres."""
    confidence: float = CONFIDENCE
    """Probability of the region, σ0 known."""
    points: tuple[str, ...] = ("*",)
    """Names, or patterns with ``*`` and ``?``."""
    dimension: Literal[2, 3] = 2
    """Ellipse in the horizon, or ellipsoid."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class PointPrecision:
    """No standard deviation of a coordinate is larger."""

    at_most: float
    """Metres."""
    points: tuple[str, ...] = ("*",)
    """Names, or patterns."""
    axes: str = "xyz"
    """Which coordinates."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class RedundancyNumber:
    """No redundancy number is smaller."""

    at_least: float
    """From 1e-6 to less than 1."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns; weighted unknowns by names such as ``point P1 x``."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class DetectableError:
    """No smallest detectable error is larger."""

    at_most: float
    """Multiples of the observation's own standard deviation."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class UndetectedShift:
    """No error that may stay undetected moves a point by more: √(∇x² + ∇y² + ∇z²).

    Observations do not always improve it: one that ties a point to another carries the errors of
    observations of that one to the point.
    """

    at_most: float
    """Metres."""
    points: tuple[str, ...] = ("*",)
    """Names, or patterns."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns, of the observations that may be wrong."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


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
        figure, bound = apart(self.figure, limit)
        return f"{self.item}: {describe(self.target)} {figure} {sign} {bound}"


def short(value: float, digits: int = 3) -> str:
    """Return a figure in three digits, rounding errors as zero."""
    return f"{value if abs(value) > 1e-12 else 0.0:.{digits}g}"


def apart(figure: float, limit: float) -> tuple[str, str]:
    """Return a figure and its limit in three digits, or as many as tell them apart."""
    for digits in range(3, 17):
        a, b = short(figure, digits), short(limit, digits)
        if a != b:
            break
    return a, b


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
        shown = f"{100 * target.confidence:g} %" if 0 < target.confidence < 1 else "confidence"
        return f"{shown} semi-axis of the {region} (m)"
    if isinstance(target, PointPrecision):
        return f"largest σ of {target.axes} (m)"
    if isinstance(target, RedundancyNumber):
        return "redundancy number"
    if isinstance(target, DetectableError):
        return "smallest detectable error (σ)"
    return "shift by an undetected error (m)"


def as_targets(given: Any) -> tuple[Target, ...]:
    """Return targets as a tuple; one alone is taken as such.

    Raises:
        InputError: what is none.
    """
    if isinstance(given, get_args(Target)):
        return (given,)
    valid = f"valid: {', '.join(c.__name__ for c in TARGETS.values())}, with a limit"
    try:
        wanted = tuple(given)
    except TypeError:
        raise InputError(f"targets must be a sequence of targets, not {given!r}; {valid}") from None
    problems = [
        Problem(f"is no target: {t!r}; {valid}", f"target {n}")
        for n, t in enumerate(wanted, 1)
        if not isinstance(t, get_args(Target))
    ]
    if problems:
        raise InputError(problems)
    return wanted


def limit_problems(targets: Sequence[Target], points: Sequence[str]) -> list[Problem]:
    """Return what is wrong with limits, and patterns that no point has."""
    problems = []
    for n, t in enumerate(targets, 1):
        wrong: list[str] = []
        limit = limit_of(t)
        if not _number(limit):
            wrong.append(f"its limit must be a number, not {limit!r}")
        elif isinstance(t, RedundancyNumber):
            if not LEAST <= limit < 1:
                wrong.append(
                    f"redundancy numbers lie between 0 and 1, and what has less than {LEAST:g} "
                    f"counts as not controlled: the limit must lie in [{LEAST:g}, 1), not {limit}"
                )
        elif not (np.isfinite(limit) and limit > 0):
            wrong.append(f"its limit must be greater than zero, not {limit}")
        if isinstance(t, SemiAxis):
            if not _number(t.confidence) or not 0 < t.confidence < 1:
                wrong.append(
                    f"the confidence must be a probability between 0 and 1, not {t.confidence!r}"
                )
            if isinstance(t.dimension, bool) or t.dimension not in (2, 3):
                wrong.append(f"the dimension must be 2 or 3, not {t.dimension!r}")
        if isinstance(t, PointPrecision):
            axes = isinstance(t.axes, str) and t.axes and set(t.axes) <= set("xyz")
            if not axes:
                wrong.append(f"axes are letters of xyz, not {t.axes!r}")
        if not isinstance(t, RedundancyNumber | DetectableError):
            wrong += unlike("point", t.points, points)
        problems += [Problem(what, _where(n, t)) for what in wrong]
    return problems


def check_targets(targets: Sequence[Target], points: Sequence[str]) -> None:
    """Check limits and names of points.

    Raises:
        InputError: every limit that nothing can meet, every pattern that no point has.
    """
    problems = limit_problems(targets, points)
    if problems:
        raise InputError(problems)


def observation_problems(
    targets: Sequence[Target], equations: Equations, also: Equations | None = None
) -> list[Problem]:
    """Return patterns that no observation has, and targets for points that cannot move.

    Args:
        targets: they.
        equations: of the design.
        also: of the design with all that may be added to it.
    """
    names, problems = names_of(also or equations), []
    table = equations.unknowns["point"]
    for n, t in enumerate(targets, 1):
        if isinstance(t, RowTarget):
            problems += [
                Problem(what, _where(n, t)) for what in unlike("observation", t.observations, names)
            ]
        if isinstance(t, UndetectedShift):
            on = matching(table.names, t.points)
            if on.any() and not np.any(on & (table.offset >= 0)):
                held = [n for n, o in zip(table.names, on, strict=True) if o]
                problems.append(
                    Problem(
                        f"all its points are held, nothing moves them: {known(held)}", _where(n, t)
                    )
                )
    return problems


def names_of(equations: Equations) -> list[str]:
    """Return all kinds of observations, and then all ids."""
    kinds = dict.fromkeys(b.kind for b in equations.blocks)
    return [*kinds, *(i for b in equations.blocks for i in b.ids)]


def _where(n: int, target: Target) -> str:
    try:
        return f"target {n}, {describe(target)}"
    except (TypeError, ValueError):
        return f"target {n}, {type(target).__name__}"


def _number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def for_points(target: Target, names: Sequence[str]) -> Target:
    """Return the target with its patterns written out for some points."""
    if isinstance(target, RedundancyNumber | DetectableError):
        return target
    chosen = matching(names, target.points)
    return replace(target, points=tuple(Name(n) for n, on in zip(names, chosen, strict=True) if on))


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

    What is nearer than 1e-9 meets it: covariances are no better.

    Args:
        target: what is asked.
        figures: (n,); infinite, or 0, where nothing controls an item.
    """
    limit = limit_of(target)
    if at_least(target):
        far = np.log(limit / np.maximum(figures, LEAST))
    else:
        ratio = np.where(np.isfinite(figures), figures / limit, MOST)
        far = np.log(np.clip(ratio, 1e-300, MOST))
    return np.asarray(np.where(far > MET, far, 0.0))
