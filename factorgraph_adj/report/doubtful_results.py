"""Sentences on doubts about the result of an adjustment, and notes on it, for all reports."""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Protocol

import numpy as np

from ..errors import UnknownLeftOut, known
from ..models.unknown_registry import UNKNOWNS
from ..network.network import Network
from ..quality.point_precision import CheckPoints
from ..quality.rejections import GroupLoss, Snooping
from ..quality.variance_components import VarianceComponents
from ..statistical_tests import (
    AdjustmentFigures,
    global_test,
    normal_upper_probability,
    poisson_upper_probability,
    student_upper_probability,
)
from ..types import Array
from ..validate.findings import Finding
from ..validate.instrument_axes import left_handed_frames
from ..validate.repeated_readings import copied_blocks, copied_returns

MAX_NAMES_IN_DOUBT = 6
"""Largest number of names or ids that a doubt lists."""
DECIMALS_OF_EQUAL_TESTS = 6
"""Decimal digits to which test values of indistinguishable readings agree."""
MIN_PROBABILITY_OF_CHANCE = 0.01
"""Probability with which the number, or the largest, of good test values raises a doubt."""
MAX_CHECK_POINT_RATIO = 10.0
"""Largest difference at a check point without a doubt, in its standard deviation.

Known coordinates have errors of their own, which nobody states: differences of some standard
deviations are common."""


class AdjustmentOutcome(AdjustmentFigures, Protocol):
    """An adjustment that says how it ended."""

    @property
    def converged(self) -> bool:
        """Whether the iteration converged."""
        ...

    @property
    def reason(self) -> str:
        """Why the iteration ended."""
        ...

    @property
    def second_places(self) -> tuple[str, ...]:
        """Sentences on points that fit equally well at a second place."""
        ...


def doubts_of_solution(solution: AdjustmentOutcome) -> list[str]:
    """Return why the result of an adjustment may be wrong.

    It is not at rest; or a point fits equally well at another place, or σ̂0 is too large. One that
    is too small is no doubt, see `notes_of_solution`.
    """
    test = global_test(solution)
    if not solution.converged:
        return [f"not converged: {solution.reason}"]
    places = solution.second_places
    found = list(places[:MAX_NAMES_IN_DOUBT])
    if more := len(places) - len(found):
        found.append(
            f"{more} more point{'s' * (more != 1)} at a second place ({len(places)} in all)"
        )
    if not test.accepted and not test.too_good:
        bounds = f"accepted from {test.lower:.4f} to {test.upper:.4f}"
        found.append(f"global test failed: σ̂0 = {test.sigma0:.4f}, {bounds}")
    return found


def doubts_of_provenance(
    snooping: Snooping | None, components: VarianceComponents | None
) -> list[str]:
    """Return what data snooping and the estimation of variance components left open."""
    found = []
    if components is not None and not components.converged:
        found.append(f"variance components not converged: {components.reason}")
    if snooping is not None and (left := len(snooping.unresolved)):
        found.append(
            f"{left} observation{'s' * (left != 1)} above the critical value could not be rejected"
        )
    return found


def notes_of_solution(solution: AdjustmentOutcome) -> list[str]:
    """Return what is striking about a result without making it doubtful.

    Readings that fit better than their σ say have σ that are stated too large, or were rounded,
    copied or computed; the adjusted values are as good as the stated σ at least.
    """
    test = global_test(solution)
    if not solution.converged or not test.too_good:
        return []
    return [
        f"the readings fit better than their σ say: σ̂0 = {test.sigma0:.4f}, expected from "
        f"{test.lower:.4f} to {test.upper:.4f}; this is no sign of a gross error: the σ are stated "
        "too large, or readings are not independent"
    ]


def notes_of_network(network: Network) -> list[str]:
    """Return what is striking about what was adjusted without making the result doubtful."""
    return [*listed_points_text(network), *copied_returns(network)]


def listed_points_text(network: Network) -> list[str]:
    """Return how many points only a list has; none: there are no such points."""
    names = list(network.listed_points)
    if not names:
        return []
    one = len(names) == 1
    count = "1 listed point has" if one else f"{len(names)} listed points have"
    stays = "it stays" if one else "they stay"
    return [f"{count} no observation: {stays} as listed, not adjusted: {known(names)}"]


def doubts_of_network(network: Network) -> list[str]:
    """Return doubts about what was adjusted.

    They are how many readings did not agree when they were reduced, with the first of them, what
    a reader left out although it was to be used, frames that no rotation leads to, and blocks of
    readings that repeat earlier ones in all digits.
    """
    n = len(network.doubts)
    found = [str(f) for f in left_handed_frames(network)]
    found += [str(left) for left in network.left_out if left.doubtful]
    found += copied_blocks(network)
    if n:
        first = network.doubts[0]
        found.append(
            f"{n} doubt{'s' * (n != 1)} about the two faces of targets, the first: {first}"
        )
    return found


class WithUnknownsLeftOut(Protocol):
    """A network, or a result, that names what was left out of it."""

    @property
    def unknowns_left_out(self) -> Sequence[UnknownLeftOut]:
        """What was left out, as nothing determines it."""
        ...


def unknowns_left_out(reduced: WithUnknownsLeftOut) -> list[str]:
    """Return a sentence with all that was left out, as nothing determines it; none: nothing was."""
    gone = reduced.unknowns_left_out
    if not gone:
        return []
    by_reason: dict[tuple[str, str], list[str]] = {}
    for each in gone:
        by_reason.setdefault((UNKNOWNS[each.kind].noun, each.why), []).append(each.name)
    said = (
        f"{noun}{'s' * (len(names) > 1)} {', '.join(names)} ({why})"
        for (noun, why), names in by_reason.items()
    )
    n, many = len({i for each in gone for i in each.ids}), len(gone) > 1
    return [
        f"{len(gone)} unknown{'s' * many} left out with {n} observation{'s' * (n != 1)}: "
        f"{'; '.join(said)}"
    ]


def findings_on_misfits(found: Sequence[Finding], wrong: Set[str]) -> list[str]:
    """Return the preliminary findings that are a likely reason for readings that do not fit.

    Args:
        found: what was found before the adjustment.
        wrong: ids of the observations that were rejected, or stay above the critical value.
    """
    out = []
    for finding in found:
        own = [i for i in finding.ids if i in wrong]
        if own:
            n, more = len(own), f", … {len(own)} in all" if len(own) > MAX_NAMES_IN_DOUBT else ""
            concerned = "the observation" if n == 1 else "observations"
            out.append(
                f"found before the adjustment: {finding}; this concerns {concerned} "
                f"{', '.join(own[:MAX_NAMES_IN_DOUBT])}{more}"
            )
    return out


def loss_sentences(found: Sequence[GroupLoss]) -> list[str]:
    """Return the groups of which data snooping has rejected much, each kind in one sentence."""
    out = []
    for noun in dict.fromkeys(loss.noun for loss in found):
        own = [loss for loss in found if loss.noun == noun]
        rest = [repr(loss.name) for loss in own[1:MAX_NAMES_IN_DOUBT]]
        more = f", … {len(own)} in all" if len(own) > MAX_NAMES_IN_DOUBT else ""
        others = f"; too much also of {noun}s {', '.join(rest)}{more}" if rest else ""
        out.append(f"{own[0]}{others}")
    return out


def exceedance_doubts(
    values: Array, critical: float, name: str, alpha: float, redundancy: int | None = None
) -> list[str]:
    """Return how many test values are above the critical value; nothing if chance makes as many.

    Args:
        values: test values, NaN for observations that nothing controls.
        critical: the critical value.
        name: symbol of the test value, w or τ.
        alpha: probability of a test value above it without an error.
        redundancy: r of the adjustment, if the values are τ; none: they are w.
    """
    n = int(np.sum(np.abs(values) > critical))
    if not n or exceeded_by_chance(values, critical, alpha, redundancy):
        return []
    expected = alpha * np.isfinite(values).sum()
    chance = f"chance makes about {expected:.0f}" if expected >= 1 else ""
    if chance and n <= expected:
        chance += f", but not the largest, {np.nanmax(np.abs(values)):.2f}"
    said = f" ({chance})" if chance else ""
    return [f"{n} test value{'s' * (n != 1)} above the critical |{name}| {critical:.2f}{said}"]


def exceeded_by_chance(
    values: Array, critical: float, alpha: float, redundancy: int | None = None
) -> bool:
    """Return whether test values above the critical value are what chance makes of good ones.

    Of n test values without an error α n are above it. They are taken for chance if as many are
    expected in one of `MIN_PROBABILITY_OF_CHANCE` such networks (Poisson), and if the largest is
    not less probable than the largest of n is with that probability (Šidák). Readings that are
    not distinguishable, such as lines of one levelled section, have one test value and count once.
    Pope's τ is bounded by √r: its probability is that of Student's t = τ √((r − 1)/(r − τ²)), r − 1
    degrees of freedom.

    Args:
        values: test values, NaN for observations that nothing controls.
        critical: the critical value.
        alpha: probability of a test value above it without an error.
        redundancy: r of the adjustment, if the values are τ; none: they are w.
    """
    size = np.abs(values[np.isfinite(values)])
    size = np.unique(np.round(size, DECIMALS_OF_EQUAL_TESTS))
    tested, n = len(size), int(np.sum(size > critical))
    if not n:
        return False
    each = -np.expm1(np.log1p(-MIN_PROBABILITY_OF_CHANCE) / tested)
    return (
        poisson_upper_probability(n, alpha * tested) >= MIN_PROBABILITY_OF_CHANCE
        and _beyond(float(size[-1]), redundancy) >= each
    )


def _beyond(value: float, redundancy: int | None) -> float:
    """Return the probability that |w|, or |τ| with a redundancy, is larger than a value."""
    if redundancy is None:
        return 2.0 * normal_upper_probability(value)
    left = redundancy - value**2
    if redundancy < 2 or left <= 0.0:
        return 0.0
    return 2.0 * student_upper_probability(
        float(value * np.sqrt((redundancy - 1) / left)), redundancy - 1
    )


def check_point_doubts(found: CheckPoints, *, free: bool = False) -> list[str]:
    """Return the check points that lie far from where their known coordinates say.

    Args:
        found: the differences.
        free: whether the network is free: then they depend on its datum, and nothing is doubted.
    """
    off = np.abs(found.normalised)
    worst = np.nanmax(off, axis=1, initial=0.0)
    far = np.flatnonzero(worst > MAX_CHECK_POINT_RATIO)
    if free or not len(far):
        return []
    first = int(far[np.argmax(worst[far])])
    axis = int(np.nanargmax(off[first]))
    size = f"{abs(float(found.differences[first, axis])):.3f} m"
    one = len(far) == 1
    where = "1 check point lies" if one else f"{len(far)} check points lie"
    return [
        f"{where} more than {MAX_CHECK_POINT_RATIO:.0f} standard deviations off"
        f"{': ' if one else ', the farthest: '}{found.names[first]} by {size} in {'xyz'[axis]}, "
        f"σ {float(found.sigmas[first, axis]):.3f} m"
    ]
