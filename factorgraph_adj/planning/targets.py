"""Targets of a network: kinds, limits, patterns of names, items that fail them, their lack.

Every target has figures, one for each of its items (points, or scalar observations), and a limit.
The lack of an item is |ln(figure/limit)| if it fails its target, so that figures of different kinds
can be added up.

``*`` matches any characters and ``?`` one character; all other characters, also brackets, match
themselves. A single string is one pattern.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, Problem, known
from ..graph.equations import Equations
from ..quality.error_ellipses import confidence_factor
from ..statistical_tests import ALPHA_OF_MODEL, CONFIDENCE_OF_REGION, POWER_OF_TEST
from ..types import Array, Mask

LEAST = 1e-6
"""Redundancy number below which an observation is uncontrolled."""
MAX_SHORTFALLS_LISTED = 12
"""Maximum number of shortfalls that a message lists."""
MOST = 1e9
"""Largest ratio of figure and limit; uncontrolled observations have this ratio."""
MET = 1e-9
"""Logarithm of figure/limit up to which it is rounding error, and the limit is met."""
FLAT = 1e-10
"""Variance of an axis, relative to the largest, up to which it is rounding error and the axis is
left out of the region.

Datum points of a free network have flat covariances from an S-transformation, whose subtractions
leave relative variances of about 1e-13. The length of a real axis is more than 1e-5 of the largest.
"""


class Name(str):
    """A literal name, in which ``*`` and ``?`` match only themselves."""

    __slots__ = ()


def patterns_of(given: Any) -> tuple[str, ...]:
    """Return patterns as a tuple; a single string is one pattern."""
    if isinstance(given, str):
        return (given,)
    try:
        return tuple(given)
    except TypeError:
        return (given,)


def matching(names: Sequence[str], patterns: Sequence[str]) -> Mask:
    """Return which names match one of the patterns, (n,)."""
    exact: Collection[str] = {str(p) for p in patterns if _literal(p)}
    parts = [
        "".join({"*": ".*", "?": "."}.get(c, re.escape(c)) for c in p)
        for p in patterns
        if not _literal(p)
    ]
    like = re.compile("|".join(parts), re.DOTALL) if parts else None
    return np.array(
        [n in exact or (like is not None and like.fullmatch(n) is not None) for n in names],
        dtype=bool,
    )


def _literal(pattern: str) -> bool:
    return isinstance(pattern, Name) or not ("*" in pattern or "?" in pattern)


def unlike(what: str, patterns: Sequence[Any], names: Sequence[str]) -> list[str]:
    """Return the errors of patterns: an empty list of patterns, or patterns without a match.

    Args:
        what: "point" or "observation".
        patterns: the patterns.
        names: all existing names; kinds of observations first.
    """
    there = f"; there are: {known(names)}"
    if not patterns:
        return [f"it names no {what}s; '*' stands for all" + there]
    wrong = []
    like = "has an id or kind" if what == "observation" else "is named"
    for p in patterns:
        if not isinstance(p, str):
            wrong.append(f"names of {what}s are strings, not {p!r}")
        elif not matching(names, (p,)).any():
            wrong.append(f"no {what} {like} like {str(p)!r}" + there)
    return wrong


def _settle(target: object) -> None:
    for field in ("points", "observations", "reference"):
        if hasattr(target, field):
            object.__setattr__(target, field, patterns_of(getattr(target, field)))


@dataclass(frozen=True)
class SemiAxis:
    """Limit for the semi-major axis of the confidence ellipse, or ellipsoid, of each point."""

    at_most: float
    """Largest allowed semi-major axis, metres."""
    confidence: float = CONFIDENCE_OF_REGION
    """Probability of the region, σ0 known."""
    points: tuple[str, ...] = ("*",)
    """Names of points, or patterns with ``*`` and ``?``."""
    dimension: Literal[2, 3] = 2
    """2 for the ellipse in the horizon, 3 for the ellipsoid."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class PointPrecision:
    """Limit for the standard deviations of coordinates."""

    at_most: float
    """Largest allowed standard deviation, metres."""
    points: tuple[str, ...] = ("*",)
    """Names of points, or patterns."""
    axes: str = "xyz"
    """Coordinates to which the target applies."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class PositionError:
    """Limit for the position error √(σx² + σy² + σz²) of each point, the root of the trace."""

    at_most: float
    """Largest allowed position error, metres."""
    points: tuple[str, ...] = ("*",)
    """Names of points, or patterns."""
    axes: str = "xyz"
    """Coordinates whose variances are summed: ``xy`` in plan, ``z`` the height."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class RedundancyNumber:
    """Limit for redundancy numbers."""

    at_least: float
    """Smallest allowed redundancy number, from 1e-6 to less than 1."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns; weighted unknowns by names such as ``point P1 x``."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class DetectableError:
    """Limit for smallest detectable errors."""

    at_most: float
    """Largest allowed error, in multiples of the observation's own standard deviation."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class UndetectedShift:
    """Limit for the shift √(∇x² + ∇y² + ∇z²) of a point by an undetected error.

    More observations do not always reduce the shift: an observation between two points transfers
    the errors of observations of one point to the other.
    """

    at_most: float
    """Largest allowed shift, metres."""
    points: tuple[str, ...] = ("*",)
    """Names of points, or patterns."""
    observations: tuple[str, ...] = ("*",)
    """Ids or kinds, or patterns, of the observations that may be wrong."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


@dataclass(frozen=True)
class DetectableDisplacement:
    """Limit for the smallest detectable displacement of a point between two epochs of the design.

    Both epochs are measured as designed, and the points are tested against stable reference points
    as `congruence` tests them with known σ0. `factorgraph_adj.planning.plan` has the
    formulas.
    """

    at_most: float
    """Largest allowed displacement, metres, in the direction in which it is hardest to find."""
    points: tuple[str, ...] = ("*",)
    """Names of the points that may move, or patterns."""
    reference: tuple[str, ...] = ("*",)
    """Names of the reference points, or patterns; those of ``points`` are left out. None: the datum
    of the design, with its held points, is the reference."""
    alpha: float = ALPHA_OF_MODEL
    """Probability of a false alarm of the test of a point."""
    power: float = POWER_OF_TEST
    """Probability with which a displacement of this size is found."""

    def __post_init__(self) -> None:
        """Take a string as one pattern."""
        _settle(self)


PointTarget: TypeAlias = SemiAxis | PointPrecision | PositionError
RowTarget: TypeAlias = RedundancyNumber | DetectableError | UndetectedShift
Target: TypeAlias = PointTarget | RowTarget | DetectableDisplacement
TARGETS: dict[str, type[Target]] = {
    "semi_axis": SemiAxis,
    "point_precision": PointPrecision,
    "position_error": PositionError,
    "redundancy_number": RedundancyNumber,
    "detectable_error": DetectableError,
    "undetected_shift": UndetectedShift,
    "detectable_displacement": DetectableDisplacement,
}
"""Classes of targets by their names in files."""


@dataclass(frozen=True)
class Shortfall:
    """An item that fails a target."""

    target: Target
    """The target."""
    item: str
    """Name of the point, or label of the observation."""
    figure: float
    """Figure of the item; infinite, or 0, for an uncontrolled observation."""

    def __str__(self) -> str:
        """Return the item with its figure and limit."""
        limit, sign = limit_of(self.target), "<" if at_least(self.target) else ">"
        figure, bound = apart(self.figure, limit)
        return f"{self.item}: {describe(self.target)} {figure} {sign} {bound}"


def short(value: float, digits: int = 3) -> str:
    """Return a figure with three digits; rounding errors are shown as zero."""
    return f"{value if abs(value) > 1e-12 else 0.0:.{digits}g}"


def apart(figure: float, limit: float) -> tuple[str, str]:
    """Return a figure and its limit with three digits, or with as many as make them differ."""
    for digits in range(3, 17):
        a, b = short(figure, digits), short(limit, digits)
        if a != b:
            break
    return a, b


def limit_of(target: Target) -> float:
    """Return the limit of a target."""
    return target.at_least if isinstance(target, RedundancyNumber) else target.at_most


def at_least(target: Target) -> bool:
    """Return whether the limit is a lower one."""
    return isinstance(target, RedundancyNumber)


def describe(target: Target) -> str:
    """Return a text that names the figures of a target."""
    if isinstance(target, SemiAxis):
        region = "ellipse" if target.dimension == 2 else "ellipsoid"
        shown = f"{100 * target.confidence:g} %" if 0 < target.confidence < 1 else "confidence"
        return f"{shown} semi-axis of the {region} (m)"
    if isinstance(target, PointPrecision):
        return f"largest σ of {target.axes} (m)"
    if isinstance(target, PositionError):
        return f"position error of {target.axes} (m)"
    if isinstance(target, RedundancyNumber):
        return "redundancy number"
    if isinstance(target, DetectableError):
        return "smallest detectable error (σ)"
    if isinstance(target, DetectableDisplacement):
        return "smallest detectable displacement between two epochs (m)"
    return "shift by an undetected error (m)"


def as_targets(given: Any) -> tuple[Target, ...]:
    """Return targets as a tuple; a single target gives a tuple of one.

    Raises:
        InputError: a value that is no target.
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
    """Return invalid limits, and patterns that match no point."""
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
        if isinstance(t, PointPrecision | PositionError):
            axes = isinstance(t.axes, str) and t.axes and set(t.axes) <= set("xyz")
            if not axes:
                wrong.append(f"axes are letters of xyz, not {t.axes!r}")
        if isinstance(t, DetectableDisplacement):
            numbers = _number(t.alpha) and _number(t.power)
            if not numbers or not 0 < t.alpha < t.power < 1:
                wrong.append(
                    f"alpha and power must be 0 < alpha < power < 1, not {t.alpha!r}, {t.power!r}"
                )
            wrong += _reference_problems(t, points) if t.reference else []
        if not isinstance(t, RedundancyNumber | DetectableError):
            wrong += unlike("point", t.points, points)
        problems += [Problem(what, _where(n, t)) for what in wrong]
    return problems


def _reference_problems(target: DetectableDisplacement, points: Sequence[str]) -> list[str]:
    """Return patterns of the reference that match no point, or none beside those of ``points``."""
    wrong = unlike("point", target.reference, points)
    if wrong or unlike("point", target.points, points):
        return wrong
    if target.reference == DetectableDisplacement.reference:
        return wrong
    objects = matching(points, target.points)
    without = [p for p in target.reference if not (matching(points, (p,)) & ~objects).any()]
    named = ", ".join(repr(str(p)) for p in target.points)
    return [
        f"the reference {str(p)!r} has no effect, since points, {named}, names the same ones: name "
        "in points those that may move"
        for p in without
    ]


def check_targets(targets: Sequence[Target], points: Sequence[str]) -> None:
    """Check limits and names of points.

    Raises:
        InputError: all limits that no design can meet, and all patterns that match no point.
    """
    problems = limit_problems(targets, points)
    if problems:
        raise InputError(problems)


def observation_problems(
    targets: Sequence[Target], equations: Equations, also: Equations | None = None
) -> list[Problem]:
    """Return patterns that match no observation, and targets for held points.

    Args:
        targets: all targets.
        equations: equations of the design.
        also: equations of the design with all candidates.
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
    """Return the target with its patterns replaced by the names of matching points."""
    if isinstance(target, RedundancyNumber | DetectableError):
        return target
    points = _named(target.points, names)
    if isinstance(target, DetectableDisplacement):
        return replace(target, points=points, reference=_named(target.reference, names))
    return replace(target, points=points)


def _named(patterns: Sequence[str], names: Sequence[str]) -> tuple[Name, ...]:
    """Return the names that match patterns, as names that no pattern is read into."""
    on = matching(names, patterns)
    return tuple(Name(n) for n, o in zip(names, on, strict=True) if o)


def point_figures(target: PointTarget, blocks: Array, horizon: Array) -> Array:
    """Return the figures of points, (n,).

    Args:
        target: the target.
        blocks: covariances in the frame of the network, (n, 3, 3), metres².
        horizon: unit vectors east and north at each point in the frame, (n, 2, 3).
    """
    if isinstance(target, PointPrecision | PositionError):
        chosen = ["xyz".index(a) for a in target.axes]
        variances = np.maximum(np.einsum("nii->ni", blocks)[:, chosen], 0.0)
        joined = variances.max(axis=1) if isinstance(target, PointPrecision) else variances.sum(1)
        return np.asarray(np.sqrt(joined))
    k = target.dimension
    regions = blocks if k == 3 else horizon @ blocks @ np.swapaxes(horizon, 1, 2)
    values = np.linalg.eigvalsh(regions)
    # Without its held axes the region is an interval or an ellipse.
    free = np.sum(values > FLAT * values[:, -1:], axis=1)
    factors = np.array([0.0, *(confidence_factor(d, target.confidence) for d in range(1, k + 1))])
    return np.asarray(factors[free] * np.sqrt(np.maximum(values[:, -1], 0.0)))


def lacking(target: Target, figures: Array) -> Array:
    """Return the lack |ln(figure/limit)| of figures, (n,); 0 for figures that meet the target.

    A lack of less than 1e-9 counts as 0, since covariances have this accuracy.

    Args:
        target: the target.
        figures: figures of the items, (n,); infinite, or 0, for uncontrolled items.
    """
    limit = limit_of(target)
    if at_least(target):
        far = np.log(limit / np.maximum(figures, LEAST))
    else:
        ratio = np.where(np.isfinite(figures), figures / limit, MOST)
        far = np.log(np.clip(ratio, 1e-300, MOST))
    return np.asarray(np.where(far > MET, far, 0.0))
