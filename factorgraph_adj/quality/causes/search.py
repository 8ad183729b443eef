"""The causes of misfits that surveyors know, the likeliest first.

Two searches make one list. Errors of some size (heights, constants, centring, turned directions,
given values that are held) are columns, tested in the adjustment of everything (`columns`).
Exchanges (of targets, names, ends, faces) are looked up in the clean solution (`matches`), as they
bend an adjustment too far for its linear model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csc_array, hstack
from scipy.special import gammaincc, gammaln

from ...models.variables import UNKNOWNS
from ...shown import FIRST, Rows, Shown
from ...solve.solution import Solution
from ...types import Array, Index
from ...units import significant
from ..distributions import chi2_quantile
from ..reliability import Reliability
from .columns import Explained, explain, whitening
from .given import GivenValue, given_values
from .hypotheses import Hypotheses, Size, hypotheses
from .matches import Match
from .readings import Readings
from .separable import SAME, SEPARABLE, indifference

MOST = 50
"""Largest number of places at which a cause is tested in full: those that may explain most."""
CHANCE = 0.01
"""Largest probability with which good readings make any of the tested causes likelier."""
SHARED = 2
"""Smallest number of observations that share a cause; an error of one is tested as its own."""

PLAUSIBLE: dict[Size, float] = {
    "length": 1.0,
    "angle": np.pi / 200,
    "ppm": 1e4,
    "image": np.inf,
    "number": np.inf,
}
"""Largest error, SI, that heights, constants and centring have in the field: a metre, a gon, one
percent. Where an error would have to be larger, readings belong to something else."""
EXCHANGES = (
    "exchanges (of targets, names of points, ends of vectors, faces, axes of photos) are tested by "
    "data snooping only (adjust --snoop)"
)
"""What is to be known of causes in an adjustment without data snooping."""

_UNIT: dict[Size, tuple[float, str]] = {
    "length": (1e-3, "mm"),
    "angle": (np.pi / 200e3, "mgon"),
    "ppm": (1.0, "ppm"),
    "image": (1.0, ""),
    "number": (1.0, ""),
}


def _figure(value: float) -> str:
    """Return a number with three significant digits, or as a whole number."""
    return significant(value, 3)


@dataclass(frozen=True, eq=False)
class Cause:
    """A cause that explains misfits."""

    cause: str
    """What is wrong: ``the height of the instrument``."""
    where: str
    """The place, and of an exchange what is right: ``at 'S3' (1.454 m)``."""
    components: tuple[str, ...]
    """Names of the components of its size, (q,); empty for a single one, and for an exchange."""
    sizes: tuple[Size, ...]
    """Quantity of each component, (q,)."""
    error: Array
    """Estimated error, recorded − true, (q,): metres, radians, image units or ppm; empty for an
    exchange."""
    sigma: Array
    """Its standard deviations, σ0 = 1, (q,)."""
    t2: float
    """T²: by how much less vᵀPv would be with it as an unknown, or after the exchange."""
    dof: int
    """Degrees of freedom of T²."""
    critical: float
    """Critical value of T²."""
    ids: tuple[str, ...]
    """Ids of the observations that share it."""
    rank: int = 0
    """Place among causes that explain as much: what one set-up makes comes first."""
    given: GivenValue | None = None
    """The held value that is wrong; None for other causes."""
    same: tuple[str, ...] = ()
    """Other places of an exchange, after which all readings would fit as well."""

    def __str__(self) -> str:
        """Return the cause, its size and its test, in millimetres and milligons."""
        return self.said(_UNIT.__getitem__, _figure)

    def said(
        self,
        unit: Callable[[Size], tuple[float, str]],
        figure: Callable[[float], str],
        *,
        space: str = " ",
    ) -> str:
        """Return the cause, its size and its test as a sentence without a stop.

        Args:
            unit: returns the unit of a size, SI, and its name.
            figure: writes a number.
            space: what divides numbers and units.
        """
        sizes = []
        named = zip(self.components or ("",), self.sizes, self.error, self.sigma, strict=False)
        for name, size, error, sigma in named:
            if np.isfinite(error):
                one, symbol = unit(size)
                parts = (name, figure(error / one), "±", figure(sigma / one), symbol)
                sizes.append(space.join(p for p in parts if p))
        test = f"T² {figure(self.t2)}"
        if self.sizes:
            test += f", {self.dof} degree{'s' * (self.dof != 1)} of freedom, critical "
            test += f"{self.critical:.1f}"
        text = f"{self.cause} {self.where}"
        if self.same:
            text += f", or {', or '.join(self.same)}: nothing tells which"
        return (f"{text}: {', '.join(sizes)}" if sizes else text) + f" ({test})"

    @property
    def plausible(self) -> bool:
        """Whether an error of this size is one that people make, see `PLAUSIBLE`."""
        limits = np.array([PLAUSIBLE[size] for size in self.sizes])
        return not np.any(np.abs(self.error) > limits)

    @property
    def possible(self) -> bool:
        """Whether it may be a likely cause: a given value of any size may have been mistyped."""
        return self.given is not None or self.plausible

    @property
    def evidence(self) -> float:
        """−ln P(χ² > T²) without an error: it compares causes of different numbers of unknowns."""
        return evidence(self.t2, self.dof)


@dataclass(frozen=True, eq=False, repr=False)
class Causes(Shown):
    """Causes beyond their critical values, the likeliest first."""

    solution: Solution
    """The adjustment of everything."""
    found: tuple[Cause, ...]
    """The causes."""
    single: float
    """T² of the single observation with the largest test value, w²."""
    tested: int
    """Number of hypotheses."""
    alpha: float
    """Probability of a false alarm of one test."""
    given: tuple[GivenValue, ...] = field(default=())
    """Tests of all given values that are held."""
    readings: tuple[str, ...] = ()
    """Labels of the observations that cannot be told from the one with the largest test value, that
    one first; empty where no test value is more than good readings make, see `CHANCE`."""

    def headline(self) -> str:
        """Return how many causes were found."""
        return f"Causes: {len(self.found)} of {self.tested} tested beyond their critical values"

    def first_rows(self) -> Rows:
        """Return the likeliest causes."""
        rows = ((f"{c.cause} {c.where}", c.t2, c.dof) for c in self.found[:FIRST])
        return Rows(("cause", "T²", "dof"), rows, len(self.found))

    @property
    def likelier(self) -> tuple[Cause, ...]:
        """Exchanges, and causes that explain significantly more than any single observation.

        Those only that good readings make as likely as this, at any of the places tested, with a
        probability below `CHANCE`; and of a size that such an error has.
        """
        least = float(np.log(max(self.tested, 1) / CHANCE))
        single = evidence(self.single, 1) + 0.5 * indifference(self.single)
        return tuple(
            c for c in self.found if not c.sizes or (c.evidence > max(least, single) and c.possible)
        )

    @property
    def likeliest(self) -> Cause | None:
        """The cause that explains significantly more than single readings and all other causes."""
        first = next(iter(self.likelier), None)
        return None if self.undecided else first

    @property
    def undecided(self) -> tuple[str, ...]:
        """All errors of which one has happened, and nothing tells which; empty if something does.

        They are the causes that cannot be told from the first one, or the observations, and the
        causes, that cannot be told from the observation with the largest test value.
        """
        likelier = self.likelier
        if likelier:
            same = _alike(likelier, likelier[0].t2, indifference(likelier[0].t2))
            return () if not likelier[0].sizes or len(same) < 2 else _said(same)
        if not self.readings:
            return ()
        same = _alike(
            [c for c in self.found if c.possible and c.sizes], self.single, SEPARABLE * self.single
        )
        every = (*self.readings, *_said(same))
        return every if len(every) > 1 else ()


def _alike(found: Sequence[Cause], t2: float, within: float) -> list[Cause]:
    """Return the causes whose T² differ by little; of one cause at one set of readings the first.

    A cause at a station is the same as everywhere, where there is no other station.
    """
    out: list[Cause] = []
    for c in found:
        twice = any(c.ids and o.cause == c.cause and set(o.ids) == set(c.ids) for o in out)
        if abs(c.t2 - t2) < within and not twice:
            out.append(c)
    return out


def _said(found: Iterable[Cause]) -> tuple[str, ...]:
    return tuple(f"{c.cause} {c.where}" for c in found)


def evidence(t2: float, dof: int) -> float:
    """Return −ln P(χ² > T²); where it underflows, by the first term of its expansion."""
    half = 0.5 * t2
    found = float(gammaincc(0.5 * dof, half))
    if found > 0.0:
        return -float(np.log(found))
    return float(half - (0.5 * dof - 1.0) * np.log(half) + gammaln(0.5 * dof))


def causes(rel: Reliability, found: Iterable[Match] = (), *, sigma0: float | None = None) -> Causes:
    """Test the causes that surveyors know, in an adjustment of everything.

    Args:
        rel: reliability of the adjustment; its α0 is that of each test.
        found: exchanges that were found in the clean solution.
        sigma0: standard deviation of unit weight by which test values are divided; none: σ̂0 of an
            a-posteriori solution, otherwise 1.

    Raises:
        SingularError: the normal equations are singular at the solution.
    """
    solution, alpha = rel.solution, rel.alpha
    given = rel.given_values
    variance = solution.variance_factor if sigma0 is None else sigma0**2
    tested = [replace(c, t2=c.t2 / variance) for c in explanations(solution, given)]
    out: list[Cause] = []
    for c in tested:
        critical = chi2_quantile(1.0 - alpha, c.dof) if c.dof else np.inf
        if c.t2 > critical:
            out.append(replace(c, critical=critical))
    out = [*sorted((_of_match(m) for m in found), key=lambda c: -c.t2), *_ordered(out)]
    w = np.where(rel.controlled, np.abs(rel.w), 0.0)
    single = float(np.max(w * w, initial=0.0)) / variance
    chance = len(w) + len(tested)
    shows = evidence(single, 1) > np.log(chance / CHANCE)
    readings = _readings_alike(rel, w) if shows else ()
    return Causes(solution, tuple(out), single, len(tested), alpha, given, readings)


def exchanges_alone(solution: Solution, found: Iterable[Match], alpha: float) -> Causes:
    """Return exchanges as the causes in an adjustment without a minimum, which has no tests.

    Args:
        solution: where the adjustment ended.
        found: the exchanges.
        alpha: probability of a false alarm of one test.
    """
    every = tuple(sorted((_of_match(m) for m in found), key=lambda c: -c.t2))
    return Causes(solution, every, 0.0, len(every), alpha)


def _readings_alike(rel: Reliability, w: Array) -> tuple[str, ...]:
    """Return the labels of the observations that cannot be told from the largest one."""
    first, equations = int(np.argmax(w)), rel.solution.equations
    rho = np.nan_to_num(rel.correlations_with(np.array([first]))[:, 0])
    alike = rel.controlled & (1.0 - rho**2 < SEPARABLE)
    alike[first] = False
    return tuple(equations.label(int(row)) for row in (first, *np.flatnonzero(alike).tolist()))


def explanations(solution: Solution, given: Iterable[GivenValue] | None = None) -> list[Cause]:
    """Return all causes that have a size, with what each explains; critical values are NaN.

    Args:
        solution: the adjustment of everything.
        given: tests of given values; none: they are made.
    """
    readings = Readings.of(solution.equations, solution.state)
    held = given_values(solution) if given is None else given
    return [*_tested(solution, hypotheses(readings)), *(_of_given(v) for v in held if v.possible)]


def _ordered(found: Iterable[Cause]) -> list[Cause]:
    """Return causes, the likeliest first; of those that explain as much, the plainest.

    What differs by less than `SAME` in T² cannot be told apart: the cause of one set-up comes
    before that of several.
    """
    left = sorted(found, key=lambda c: -c.evidence)
    out: list[Cause] = []
    while left:
        same = [
            c
            for c in left
            if c.t2 > left[0].t2 - indifference(left[0].t2) and c.evidence > left[0].evidence - SAME
        ]
        out += sorted(same, key=lambda c: c.rank)
        left = [c for c in left if c not in same]
    return out


def _of_match(m: Match) -> Cause:
    none = np.zeros(0)
    gain = m.before - m.after
    return Cause(m.cause, m.where, (), (), none, none, gain, 1, 0.0, m.ids, same=m.same)


def _of_given(v: GivenValue) -> Cause:
    components = v.components if len(v.components) > 1 else ()
    what = f"the given {', '.join(v.components)}"
    where = f"of {UNKNOWNS[v.kind].noun} {v.name!r}"
    return replace(_cause(what, where, components, v.sizes, v.together, ()), given=v)


def _cause(
    cause: str,
    where: str,
    components: tuple[str, ...],
    sizes: tuple[Size, ...],
    what: Explained,
    ids: tuple[str, ...],
) -> Cause:
    figures = what.error, what.sigma, what.t2, what.dof
    return Cause(cause, where, components, sizes, *figures, np.nan, ids)


def _tested(solution: Solution, every: Iterable[Hypotheses]) -> Iterator[Cause]:
    """Iterate over causes at places; at most `MOST` places of each."""
    equations = solution.equations
    residual = solution.normal().system.residual
    w, observation = whitening(equations), equations.observation_of_row
    chosen: list[tuple[Hypotheses, int]] = []
    parts: list[csc_array] = []
    groups: list[Index] = []
    first = 0
    for h in every:
        z = csc_array(w @ h.columns)
        q = len(h.sizes)
        total = np.asarray(z.multiply(z).sum(axis=0)).ravel()
        gain = (z.T @ residual) ** 2 / np.where(total > 0, total, 1.0)
        most = np.argsort(-gain.reshape(-1, q).sum(axis=1), kind="stable")[:MOST]
        for number in most.tolist():
            own = z[:, number * q : (number + 1) * q]
            if len(np.unique(observation[own.indices])) < SHARED:
                continue
            chosen.append((h, number))
            parts.append(own)
            groups.append(first + np.arange(q))
            first += q
    if not parts:
        return
    z = csc_array(hstack(parts))
    for (h, number), group, what in zip(chosen, groups, explain(solution, z, groups), strict=True):
        rows = np.unique(z[:, group].indices)
        ids = tuple(dict.fromkeys(equations.id(int(row)) for row in rows))
        cause = _cause(h.cause, h.where[number], h.components, h.sizes, what, ids)
        yield replace(cause, rank=h.rank)
