"""Findings, and what checks share: readings computed from given values, and likely slips.

Readings whose points and photos all have given coordinates are computed from them. What a reading
may be instead of what it seems to be: another unit, the other sign, exchanged components. What a
coordinate may be: the other sign, or two neighbouring digits exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations, pairwise
from math import nan

import numpy as np

from ..errors import InputError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..statistical_tests import chi2_upper_probability
from ..types import Array, Index
from ..units import significant

COORDINATE_DECIMALS = 4
"""Number of decimals of a coordinate, metres, that are looked at for exchanged digits."""
MIN_MM_SHOWN_IN_METRES = 1e5
"""Size in millimetres from which a misfit is reported in metres."""
CONTRADICTION_FACTOR = 6.0
"""Multiple of its standard deviation from which a reading contradicts given coordinates. Smaller
misfits are for the adjustment to judge, with all other readings."""
MIN_FIT_IMPROVEMENT = 5.0
"""How many times better another reading of a group must fit to be reported."""
MIN_READINGS_OF_GROUP = 4
"""Smallest number of readings of a group."""


@dataclass(frozen=True)
class Finding:
    """A doubt about readings or given values; nothing has been changed."""

    what: str
    """What does not fit, with the readings concerned."""
    remedy: str
    """What to look at, or to do."""
    size: float = nan
    """How large the misfit is, in ``unit``; NaN if it has no size."""
    tolerance: float = nan
    """How large it may be: `TOLERANCE_IN_SIGMAS` times its standard deviation, in ``unit``; NaN if
    there is none."""
    unit: str = ""
    """Unit of both."""
    ids: tuple[str, ...] = ()
    """Ids of the observations that share the mistake; empty where a finding is of something else,
    or of one reading alone."""
    cause: str = ""
    """The one mistake of those that people make that explains the misfit; empty: none does."""
    statistic: float = nan
    """Test statistic of the misfit, χ² if nothing is wrong; NaN if there is none."""
    freedom: int = 0
    """Degrees of freedom of the statistic."""

    @property
    def probability(self) -> float:
        """Probability of a statistic as large by chance, of one comparison; NaN without one."""
        if self.statistic != self.statistic:
            return nan
        return chi2_upper_probability(self.statistic, self.freedom)

    def __str__(self) -> str:
        """Return the finding as text."""
        size = ""
        if self.size == self.size:
            large = self.unit == "mm" and abs(self.size) >= MIN_MM_SHOWN_IN_METRES
            one, unit = (1e-3, "m") if large else (1.0, self.unit)
            size = f": {significant(one * self.size, 4)} {unit}".rstrip()
        if self.tolerance == self.tolerance:
            size += f", tolerance {significant(self.tolerance, 3)} {self.unit}".rstrip()
        if self.statistic == self.statistic:
            by_chance = f"{self.probability:.0e}" if self.probability > 1e-99 else "below 1e-99"
            size += f" (χ² {self.statistic:.4g} with {self.freedom} degrees of freedom, "
            size += f"by chance {by_chance})"
        return f"{self.what}{size}; {self.remedy}"


def given_rows(
    equations: Equations, kind: str, *, whole: bool = False
) -> Iterator[tuple[Block, Index]]:
    """Iterate over the blocks of a kind, and the rows whose points have given coordinates.

    Blocks with fewer than `MIN_READINGS_OF_GROUP` of them are left out.

    Args:
        equations: the network.
        kind: kind of the observations.
        whole: whether all other unknowns of a row must have a value as well.
    """
    state = equations.unknowns.start()
    for block in equations.blocks:
        if block.kind != kind or block.prior:
            continue
        fine = np.ones(block.n, dtype=bool)
        for what, index in block.variables:
            if whole or what in ("point", "pose"):
                fine &= np.isfinite(state[what][index]).all(axis=1)
        rows = np.flatnonzero(fine)
        if len(rows) >= MIN_READINGS_OF_GROUP:
            yield block, rows


def computed_values(equations: Equations, block: Block, rows: Index) -> tuple[Array, Array]:
    """Return observed and computed values of rows, (k, d); observed ones where there is no answer.

    Points may coincide in rough coordinates, and sights be vertical.
    """
    state = {k: np.nan_to_num(v) for k, v in equations.unknowns.start().items()}
    part, frame = block.select(rows), equations.network.frame
    try:
        v = part.evaluate(frame, state, jacobians=False).residual
    except InputError:
        v = np.zeros_like(part.observed)
        for i in range(part.n):
            with suppress(InputError):
                one = part.select(np.array([i]))
                v[i] = one.evaluate(frame, state, jacobians=False).residual[0]
    return part.observed, v + part.observed


def median_size(misfit: Array) -> float:
    """Return the median of the sizes of misfits."""
    return float(np.median(np.abs(misfit)))


def reading_covariance(block: Block) -> Array:
    """Return the covariances of readings, (k, d, d)."""
    if block.whitener is not None:
        inverse = np.linalg.inv(block.whitener)
        return np.asarray(np.einsum("nij,nkj->nik", inverse, inverse))
    return np.asarray(np.einsum("ni,ij->nij", np.square(block.sigma), np.eye(block.dimension)))


def exchanged_components(value: Array) -> Iterator[tuple[str, Array]]:
    """Iterate over vectors with two components exchanged, with a name for each, (3,).

    Vectors of other numbers of components have none.
    """
    for i, j in combinations(range(len(value)), 2) if len(value) == 3 else ():
        order = [0, 1, 2]
        order[i], order[j] = j, i
        yield f"with {'xyz'[i]} and {'xyz'[j]} exchanged", value[order]


def other_signs(value: Array) -> Iterator[tuple[str, Array]]:
    """Iterate over values with the other sign, and vectors with that of one component, (d,)."""
    yield "with the other sign", -value
    for i in range(len(value)) if len(value) == 3 else ():
        sign = np.ones(3)
        sign[i] = -1.0
        yield f"with the other sign of {'xyz'[i]}", sign * value


def mistyped_coordinates(value: float) -> Iterator[tuple[str, float]]:
    """Iterate over what a coordinate may be: with the other sign, or with two digits exchanged.

    Args:
        value: the coordinate as given, metres.
    """
    yield "with the other sign", -value
    digits = f"{abs(value):.{COORDINATE_DECIMALS}f}"
    sign = "-" if value < 0 else ""
    places = [i for i, c in enumerate(digits) if c != "."]
    for a, b in pairwise(places):
        if digits[a] != digits[b]:
            other = list(digits)
            other[a], other[b] = other[b], other[a]
            text = sign + "".join(other).rstrip("0").rstrip(".")
            yield f"as {text} m", float(text)
