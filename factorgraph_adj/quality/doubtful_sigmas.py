"""Groups whose standard deviations may have a wrong unit, by the factor from their residuals.

The residuals of a group of observations of one kind say by which factor f its standard deviation
would fit: f² = vᵀPv / r with its redundancy r. A group whose σ is stated 1000 times too large fits
far too well beside others, f is near 1/1000, and the weights of the others hardly depend on it. One
whose σ is far too small bends the others, so that the factors are estimated together
(`components_of_trial`); a gross error shows in few residuals of a group,
a wrong σ in all.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError
from ..graph.blocks import Block
from ..graph.weights import weigh
from ..solve.solution import Solution
from ..statistical_tests import chi2_quantile, global_test
from ..stochastic_model import PARTS, StandardDeviation
from ..types import Array
from ..units import ANGLE
from .reliability import Reliability
from .variance_components import components_of_trial

MIN_DOUBTFUL_FACTOR = 30.0
"""Factor from which a σ is doubted: σ that are stated carefully lie within a few times the truth,
and unit mistakes are of 1000, or of √1000 where the length of a line was taken in metres."""
UNIT_FACTOR = 1000.0
"""Factor between metres and millimetres, kilometres and metres, gon and milligon."""
MAX_NEAR_FACTOR = 3.0
"""Factor within which a group is near its σ, and within which a factor is that of a unit."""
MIN_DOUBTED_REDUNDANCY = 3 - 1e-6
"""Smallest redundancy of a group that is examined. Sums of redundancy
numbers are whole up to rounding."""
MAX_LOG_FACTOR_DIFFERENCE = 0.3
"""Largest difference of ln f, beside twice its standard deviation, of a σ with one part in another
unit, which fits the residuals of its group."""
MIN_MEDIAN_RESIDUAL = 0.3
"""Smallest median of |v|/σ_v with the estimated σ: of normal residuals it is 0.67, and one gross
error in a group leaves the others far below it."""
MAX_SUCCESSIVE_RESIDUAL_RATIO = 3.0
"""Largest ratio of successive values among the larger half of |v|/σ_v: gross errors exceed it."""
MAX_NORMALISED_RESIDUAL = 4.5
"""Largest |v|/σ with the estimated σ."""
MAX_ROWS_OF_DOUBT = 3000
"""Number of scalar observations up to which variance components are estimated for a doubt."""


@dataclass(frozen=True)
class DoubtfulSigma:
    """A group whose standard deviation may be stated in a wrong unit."""

    group: str
    """Kind of its observations."""
    n: int
    """Number of its scalar observations."""
    factor: float
    """σ by the residuals / stated σ."""
    stated: float
    """Median of its standard deviations as stated, unit of the observation."""
    unit: str
    """m, rad or another."""
    reason: str
    """The likely mistake; empty if no unit explains it."""

    def __str__(self) -> str:
        """Return the doubt as text."""
        small = self.factor < 1.0
        times = 1.0 / self.factor if small else self.factor
        scale, unit = {"m": (1e3, " mm"), "rad": (1.0 / ANGLE["mgon"], " mgon")}.get(
            self.unit, (1.0, "")
        )
        shown = (f"{scale * s:.3g}{unit}" for s in (self.stated, self.stated * self.factor))
        stated, fitting = shown
        why = f"; {self.reason}" if self.reason else ""
        return (
            f"the standard deviation of the group {self.group!r} ({self.n} values) may be stated "
            f"about {times:.2g} times too {'large' if small else 'small'}: {stated} in the median, "
            f"by the residuals {fitting}{why}"
        )


def doubtful_sigmas(found: Reliability) -> list[DoubtfulSigma]:
    """Return the groups whose standard deviation may be stated in a wrong unit.

    Given values of weighted unknowns are left out: a weak weight is often meant.
    """
    s = found.solution
    if not s.converged or s.redundancy < MIN_DOUBTED_REDUNDANCY:
        return []
    v = s.equations.residuals(s.state)
    groups: dict[str, list[Block]] = {}
    for block in s.equations.blocks:
        if not block.prior:
            groups.setdefault(block.kind, []).append(block)
    factors: dict[str, float] = {}
    for kind, blocks in groups.items():
        rows = _rows(s, blocks)
        r = float(found.redundancy_numbers[rows].sum())
        if r >= MIN_DOUBTED_REDUNDANCY:
            factors[kind] = float(np.sqrt(np.sum(np.square(v[rows])) / r))
    if any(1.0 / MAX_NEAR_FACTOR < f < MAX_NEAR_FACTOR for f in factors.values()):
        large = {k: f for k, f in factors.items() if 0.0 < f < 1.0 / MIN_DOUBTFUL_FACTOR}
        if large:
            found_large = [_doubt(s, k, groups[k], f) for k, f in large.items()]
            return [d for d in found_large if d.reason]  # others are stated carefully
    if global_test(s).accepted or global_test(s).too_good or len(v) > MAX_ROWS_OF_DOUBT:
        return []
    if _one_reading_explains(found):
        return []
    return _groups_with_small_sigmas(s, groups)


def _one_reading_explains(found: Reliability) -> bool:
    """Return whether one gross error explains all misfits: without it the global test is passed.

    In small loops it spreads over all residuals, as σ that are too small do.
    """
    w = np.where(found.controlled, np.nan_to_num(found.w), 0.0)
    r, left = found.solution.redundancy - 1, found.solution.vtpv - float(np.max(w * w, initial=0.0))
    return left <= chi2_quantile(1.0 - found.alpha, r) if r > 0 else True


def _groups_with_small_sigmas(s: Solution, groups: dict[str, list[Block]]) -> list[DoubtfulSigma]:
    """Return the groups whose σ are far too small, if larger ones make everything fit."""
    try:
        with np.errstate(all="ignore"):  # only a trial: gross errors make weights of any size
            estimated = components_of_trial(
                s, {k: [i for b in blocks for i in b.ids] for k, blocks in groups.items()}
            )
    except AdjustmentError:
        return []
    again = estimated.solution
    if not estimated.converged or not again.converged or not global_test(again).accepted:
        return []
    off: list[DoubtfulSigma] = []
    near = 0
    for component in estimated.components:
        blocks = groups[component.name]
        f = component.factor
        if not component.estimated or component.redundancy < MIN_DOUBTED_REDUNDANCY:
            continue
        if 1.0 / MAX_NEAR_FACTOR < f < MAX_NEAR_FACTOR:
            near += 1
            continue
        doubt = _doubt(s, component.name, blocks, f, component.sigma / f)
        rows = _rows(s, blocks)
        w = np.abs(again.equations.residuals(again.state)[rows])
        w = np.sort(w) / np.sqrt(component.redundancy / len(w))
        upper = np.maximum(w[len(w) // 2 :], MIN_MEDIAN_RESIDUAL)
        even = (
            np.median(w) > MIN_MEDIAN_RESIDUAL
            and w[-1] < MAX_NORMALISED_RESIDUAL
            and np.all(upper[1:] < MAX_SUCCESSIVE_RESIDUAL_RATIO * upper[:-1])
        )
        if (
            f < 1.0
            or not even
            or not (doubt.reason or (f >= MIN_DOUBTFUL_FACTOR and _near_unit(f)))
        ):
            return []
        off.append(doubt)
    return off if near or len(off) > 1 else []


def _near_unit(factor: float) -> bool:
    """Return whether a factor is that of a unit, 1000, or of the square root of one."""
    return any(
        f / MAX_NEAR_FACTOR < factor < f * MAX_NEAR_FACTOR
        for f in (UNIT_FACTOR, np.sqrt(UNIT_FACTOR))
    )


def _rows(s: Solution, blocks: Sequence[Block]) -> Array:
    """Return the scalar rows of blocks."""
    return np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in blocks])


def _doubt(
    s: Solution, kind: str, blocks: Sequence[Block], factor: float, doubt: float = 0.0
) -> DoubtfulSigma:
    """Return the doubt about a group; ``doubt``: standard deviation of ln of its factor."""
    sigma = s.equations.sigmas()[_rows(s, blocks)]
    unit = blocks[0].unit
    name = kind.replace("_", " ")
    return DoubtfulSigma(
        name, len(sigma), factor, float(np.median(sigma)), unit, _reason(s, blocks, factor, doubt)
    )


def _reason(s: Solution, blocks: Sequence[Block], factor: float, doubt: float) -> str:
    """Return the likely mistake of a unit; empty if there is none."""
    for by in (UNIT_FACTOR, 1.0 / UNIT_FACTOR):
        for part in ("constant", *PARTS):
            changed = _with_part(s, blocks, part, by)
            if changed is None:
                continue
            before = np.concatenate([np.square(b.sigma).ravel() for b in blocks])
            ratio = float(np.sqrt(changed.mean() / before.mean()))
            # Where a part is made small, what is left of σ does not depend on the unit of the part.
            specific = by > 1.0 or factor < 1.0 / MIN_DOUBTFUL_FACTOR
            alike = abs(np.log(factor / ratio)) < MAX_LOG_FACTOR_DIFFERENCE + 2.0 * doubt
            if specific and alike and not 0.5 < ratio < 2.0:
                said = "constant part" if part == "constant" else f"part {part}"
                return f"a unit may be wrong: with its {said} {_times(by)} it fits"
    if UNIT_FACTOR / MAX_NEAR_FACTOR < max(factor, 1.0 / factor) < UNIT_FACTOR * MAX_NEAR_FACTOR:
        return "a unit may be wrong, by the factor 1000: millimetres and metres, gon and milligon"
    root = float(np.sqrt(UNIT_FACTOR))
    if root / 2 < max(factor, 1.0 / factor) < root * 2:
        lengths = [getattr(s.network.observations.get(i), "length_km", None) for i in blocks[0].ids]
        if any(x is not None for x in lengths):
            return "the lengths of the lines may be in metres, not in kilometres (factor √1000)"
    return ""


def _times(by: float) -> str:
    return f"{by:.0f} times larger" if by > 1.0 else f"{1.0 / by:.0f} times smaller"


def _with_part(s: Solution, blocks: Sequence[Block], part: str, by: float) -> Array | None:
    """Return the variances of blocks with one part changed; None: they have no such part."""
    network = copy(s.network)
    network.observations = dict(network.observations)
    ids = [i for b in blocks for i in b.ids]
    touched = False
    for i in ids:
        o = network.observations.get(i)
        sigma = getattr(o, "sigma", None)
        value = getattr(sigma, part) if isinstance(sigma, StandardDeviation) else None
        if o is not None and isinstance(sigma, StandardDeviation) and value:
            changed = replace(sigma, **{part: by * value})
            network.observations[i] = replace(o, sigma=changed)  # type: ignore[call-arg]
            touched = True
    if not touched:
        return None
    found = [weigh(network, b, s.state).sigma for b in blocks]
    return np.concatenate([np.square(x).ravel() for x in found])
