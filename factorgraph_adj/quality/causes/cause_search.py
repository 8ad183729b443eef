"""Search for all causes of misfits in an adjustment, the most probable first, with what remains.

Two searches make one list. Errors of some size (heights, constants, centring, turned directions,
given values that are held) are columns, tested in the adjustment of everything
(`shared_error_tests`). Exchanges (of targets, names, ends, faces, image axes) are searched for in
the clean solution (`mistaken_identity`), as they displace an adjustment beyond its linear model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csc_array, hstack

from ...blas_threads import with_one_thread
from ...errors import taking
from ...graph.equations import Equations
from ...models.unknown_registry import UNKNOWNS
from ...result_display import FIRST, Rows, Shown
from ...solve.solution import Solution
from ...statistical_tests import chi2_quantile
from ...types import Array, Index
from ..reliability import Reliability
from .evidence import MOST_COMPONENTS_NAMED, Cause, VarianceFactor, evidence, three_digits
from .exchanged_images import exchanged_image_points, exchanged_photos
from .mistaken_axes import mirrored_block, photos_with_other_axes
from .mistaken_identity import MistakenIdentity, mistaken_identities
from .readings import Readings
from .separability import (
    MAX_LINEAR_TEST_VALUE,
    NO_OBSERVATION,
    WholeObservation,
    best_whole_observation,
    inseparable_causes,
    inseparable_readings,
    rival_causes,
    separability_tolerance,
)
from .shared_error_tests import (
    AxisScale,
    GivenValue,
    SharedErrorTest,
    axis_scales,
    given_values,
    shared_error_tests,
    t2_of_errors,
    whitening_matrix,
)
from .shared_errors import ErrorColumns, ErrorQuantity, refocusing_columns, shared_error_columns

MAX_PLACES_OF_CAUSE = 50
"""Largest number of places at which a cause is examined: those with the largest T²."""
MAX_PLACE_ELEMENTS = 30_000_000
"""Largest number of elements of the solutions by which the places are chosen: unknowns times
components of all places of all causes."""
MAX_CHANCE_OF_CAUSE = 0.01
"""Largest probability with which good readings make any of the tested causes more probable."""
MIN_SHARE_OF_ONLY_CAUSE = 0.9
"""Share of the excess of vᵀPv over its redundancy that one cause explains where it is the only one:
the rest is curvature of the model. Where it explains less, there are others besides."""
MIN_SHARE_OF_LARGE_CAUSE = 0.5
"""The same where the error is larger than `MAX_LINEAR_TEST_VALUE`, so that curvature leaves a
lot."""
MIN_SHARING_OBSERVATIONS = 2
"""Smallest number of observations that share a cause; an error of one is tested as its own."""
EXCHANGES_NOTE = (
    "exchanges (of targets, names of points, ends of vectors, faces, axes of photos) are tested by "
    "data snooping only (adjust --snoop)"
)
"""What is to be known of causes in an adjustment without data snooping."""


def every_mistaken_identity(
    equations: Equations,
    clean: Solution,
    aside: Sequence[str],
    above: Sequence[str],
    alpha: float,
    *,
    again: bool,
    estimated: bool,
) -> tuple[MistakenIdentity, ...]:
    """Search for the identities under which observations that do not fit would fit.

    Args:
        equations: the network with them.
        clean: the solution without those rejected.
        aside: ids of the observations rejected.
        above: ids of those above the critical value that have stayed.
        alpha: probability with which a reading that is right does not fit.
        again: whether the network may be adjusted again with other images.
        estimated: whether σ0 is that of the clean solution; otherwise it is 1.
    """
    weight = VarianceFactor.left_by(clean, estimated=estimated)
    found = (
        *mistaken_identities(equations, clean, aside, alpha, weight),
        *photos_with_other_axes(equations, clean, aside, alpha, weight),
        *exchanged_image_points(equations, clean, aside, alpha, weight),
    )
    if again:
        bad = [*aside, *above]
        block = tuple(mirrored_block(equations, clean, bad, alpha, weight))
        pairs = () if block else tuple(exchanged_photos(equations, clean, bad, alpha, weight))
        found = (*block, *pairs, *found)
    return tuple(m.judged_by(weight.variance) for m in found)


@dataclass(frozen=True, eq=False, repr=False)
class Causes(Shown):
    """Causes beyond their critical values, the most probable first."""

    solution: Solution
    """The adjustment of everything."""
    found: tuple[Cause, ...]
    """The causes."""
    single: float
    """T² of the single observation with the largest test value, w² / σ0²."""
    tested: int
    """Number of hypotheses."""
    alpha: float
    """Probability of a false alarm of one test."""
    given: tuple[GivenValue, ...] = field(default=())
    """Tests of all given values that are held."""
    readings: tuple[str, ...] = ()
    """Labels of the observations that cannot be distinguished from the one with the largest test
    value, that one first; empty where no test value is more than good readings make, see
    `MAX_CHANCE_OF_CAUSE`."""
    rivals: tuple[str, ...] = ()
    """Causes that cannot be distinguished from it."""
    freedom: float = np.inf
    """Degrees of freedom of the σ0 of `single`; infinite where it is known."""
    whole: WholeObservation = NO_OBSERVATION
    """The observation of several components that explains most, by evidence and likelihood."""
    below: tuple[Cause, ...] = field(default=(), repr=False)
    """Causes that were tested and are not beyond their critical values."""

    def headline(self) -> str:
        """Return how many causes were found."""
        return f"Causes: {len(self.found)} of {self.tested} tested beyond their critical values"

    def first_rows(self) -> Rows:
        """Return the most probable causes."""
        rows = ((f"{c.cause} {c.where}", c.t2, c.dof) for c in self.found[:FIRST])
        return Rows(("cause", "T²", "dof"), rows, len(self.found))

    @property
    def more_probable(self) -> tuple[Cause, ...]:
        """Exchanges, and causes that explain significantly more than any single observation.

        Those only that good readings make as likely as this, at any of the places tested, with a
        probability below `MAX_CHANCE_OF_CAUSE`; and of a size that such an error has.
        """
        least = float(np.log(max(self.tested, 1) / MAX_CHANCE_OF_CAUSE))
        single = max(evidence(self.single, 1, self.freedom), self.whole.evidence)
        single += separability_tolerance(single)
        whole = self.whole.likelihood + separability_tolerance(self.whole.likelihood)

        def more_probable(c: Cause) -> bool:
            return c.evidence > max(least, single) and c.likelihood > whole

        return tuple(c for c in self.found if not c.sizes or (more_probable(c) and c.possible))

    @property
    def most_probable(self) -> Cause | None:
        """The cause that explains significantly more than single readings and all other causes."""
        first = next(iter(self.more_probable), None)
        return None if self.undecided else first

    def left(self, c: Cause) -> tuple[float, int]:
        """Return vᵀPv of all readings with a cause as an unknown, and its redundancy."""
        vtpv, r = self.solution.vtpv, self.solution.redundancy - c.dof
        if np.isinf(c.freedom):
            return max(vtpv - c.t2, 0.0), r
        return vtpv * c.freedom / (c.freedom + c.t2), r

    def share(self, c: Cause) -> float:
        """Return the share of the excess of vᵀPv over its redundancy that a cause explains, ≤ 1."""
        vtpv, (left, r) = self.solution.vtpv, self.left(c)
        return float(np.clip((vtpv - left) / max(vtpv - max(r, 0), vtpv - left), 0.0, 1.0))

    def alone(self, c: Cause) -> bool:
        """Return whether no other error need be searched for after a cause.

        With it as an unknown the global test is accepted, or it explains `MIN_SHARE_OF_ONLY_CAUSE`
        of the excess, `MIN_SHARE_OF_LARGE_CAUSE` beyond the linear model. Of an estimated σ0 nobody
        knows an excess.
        """
        left, r = self.left(c)
        if not c.sizes or np.isfinite(c.freedom) or r <= 0:
            return True
        enough = (
            MIN_SHARE_OF_ONLY_CAUSE if c.t2 < MAX_LINEAR_TEST_VALUE**2 else MIN_SHARE_OF_LARGE_CAUSE
        )
        return left <= chi2_quantile(1.0 - self.alpha, r) or self.share(c) >= enough

    def consequence(self, c: Cause) -> str:
        """Return what a cause leaves of σ̂0 of all readings; empty for an exchange."""
        left, r = self.left(c)
        if not c.sizes or r <= 0:
            return ""
        after, before = three_digits(np.sqrt(left / r)), three_digits(self.solution.sigma0)
        if self.alone(c):
            return f"; σ̂0 of all readings would be {after} with it in place of {before}"
        return (
            f"; it explains {100.0 * self.share(c):.0f} % of what vᵀPv is too large by, and σ̂0 of "
            f"all readings would be {after} in place of {before}"
        )

    @property
    def undecided(self) -> tuple[str, ...]:
        """All errors of which one has happened; empty if the observations determine which.

        They are the causes that cannot be distinguished from the first one, or the observations,
        and the causes, that cannot be distinguished from the observation with the largest test
        value.
        """
        more_probable = self.more_probable
        if more_probable:
            first, more = more_probable[0], (*self.found, *self.below)
            rest = [c for c in more if c.sizes and c.possible and c is not first]
            same = inseparable_causes([first, *rest], first.evidence, first.likelihood)
            return () if not first.sizes or len(same) < 2 else _cause_texts(same)
        every = (*self.readings, *self.rivals) if self.readings else ()
        return every if len(every) > 1 else ()

    @property
    def undecided_sentences(self) -> list[str]:
        """A sentence on errors of which the observations do not determine the right one, if any."""
        every = self.undecided
        if not every:
            return []
        size = float(np.sqrt(self.more_probable[0].t2 if self.more_probable else self.single))
        return [
            f"an error of {size:.1f} times its standard deviation shows; with this redundancy "
            f"the observations do not determine in which of: {'; '.join(every)}"
        ]

    def most_probable_text(self, sentence: Callable[[Cause], str]) -> str:
        """Return the most probable cause with what it leaves of σ̂0; empty if there is none.

        Args:
            sentence: writes a cause with its size and its test.
        """
        first = self.most_probable
        if first is None:
            return ""
        what = "most probable cause" if self.alone(first) else "one of several errors"
        return f"{what}: {sentence(first)}{self.consequence(first)}"


def _cause_texts(found: Iterable[Cause]) -> tuple[str, ...]:
    return tuple(f"{c.cause} {c.where}" for c in found)


@taking(Reliability)
@with_one_thread
def causes(
    rel: Reliability, found: Iterable[MistakenIdentity] = (), *, estimated: bool | None = None
) -> Causes:
    """Test the causes that surveyors know, in an adjustment of everything.

    Args:
        rel: reliability of the adjustment; its α0 is that of each test.
        found: exchanges that were found in the clean solution.
        estimated: whether σ0 is estimated, for each cause from what it leaves of vᵀPv; false: it
            is 1; None: it is estimated for an a-posteriori solution.

    Raises:
        SingularError: the normal equations are singular at the solution.
    """
    solution, given = rel.solution, rel.given_values
    if estimated is None:
        estimated = solution.variance == "a-posteriori"
    every = sized_causes(solution, given)
    tested = [_judged(solution, c, rel.alpha, estimated) for c in every if c.dof]
    exchanges = sorted((_of_match(m) for m in found), key=lambda c: -c.t2)
    w = np.where(rel.controlled, np.nan_to_num(rel.w), 0.0)
    t2 = float(np.max(w * w, initial=0.0))
    weight = VarianceFactor.left_by(solution, estimated=estimated, t2=t2, dof=1)
    single, freedom = t2 / weight.variance, weight.freedom
    out = Causes(
        solution,
        (*exchanges, *ordered_causes(c for c in tested if c.t2 > c.critical)),
        single,
        len(every),
        rel.alpha,
        given,
        freedom=freedom,
        whole=best_whole_observation(rel, w, estimated=estimated),
        below=tuple(c for c in tested if not c.t2 > c.critical),
    )
    here = evidence(single, 1, freedom)
    if not here > np.log((len(w) + len(every)) / MAX_CHANCE_OF_CAUSE):
        return out
    first = int(np.argmax(np.abs(w)))
    rows = inseparable_readings(rel, w, first, estimated=estimated)
    others = rival_causes(rel, ordered_causes(tested), first, here, estimated=estimated)
    readings = tuple(map(solution.equations.label, rows))
    return replace(out, readings=readings, rivals=_cause_texts(others))


def _judged(solution: Solution, c: Cause, alpha: float, estimated: bool) -> Cause:
    """Return a cause with T² and σ by the σ0 that it leaves."""
    weight = VarianceFactor.left_by(solution, estimated=estimated, t2=c.t2, dof=c.dof)
    sigma = c.sigma * np.sqrt(weight.variance)
    critical = weight.critical(c.dof, alpha)
    return replace(
        c, t2=c.t2 / weight.variance, sigma=sigma, critical=critical, freedom=weight.freedom
    )


def exchanges_as_causes(
    solution: Solution, found: Iterable[MistakenIdentity], alpha: float
) -> Causes:
    """Return exchanges as the causes in an adjustment without a minimum, which has no tests.

    Args:
        solution: where the adjustment ended.
        found: the exchanges.
        alpha: probability of a false alarm of one test.
    """
    every = tuple(sorted((_of_match(m) for m in found), key=lambda c: -c.t2))
    return Causes(solution, every, 0.0, len(every), alpha)


def sized_causes(solution: Solution, given: Iterable[GivenValue] | None = None) -> list[Cause]:
    """Return all causes that have a size, with what each explains; critical values are NaN.

    Args:
        solution: the adjustment of everything.
        given: tests of given values; None: they are made.
    """
    equations, state = solution.equations, solution.state
    shared = [
        *shared_error_columns(Readings.of(equations, state)),
        *refocusing_columns(equations, state),
    ]
    held = given_values(solution) if given is None else given
    return [
        *_tested(solution, shared),
        *(_of_given(v) for v in held if v.possible),
        *map(_of_axis, axis_scales(solution)),
    ]


def ordered_causes(found: Iterable[Cause]) -> list[Cause]:
    """Return causes, the most probable first; of those that explain as much, the plainest.

    Causes whose evidence or likelihood differs by less than `separability_tolerance` are not
    distinguishable: the cause of one set-up comes before that of several.
    """
    left = sorted(((c.evidence, c.likelihood, c) for c in found), key=lambda row: -row[0])
    out: list[Cause] = []
    while left:
        # What is equal counts whatever is left of the difference: of infinity, nothing.
        most, likelihood, first = left[0]
        least = most - separability_tolerance(most)
        enough = likelihood - separability_tolerance(likelihood)
        same = [c for e, k, c in left if c is first or e == most or e > least or k > enough]
        out += sorted(same, key=lambda c: c.rank)
        chosen = set(map(id, same))
        left = [row for row in left if id(row[2]) not in chosen]
    return out


def _of_match(m: MistakenIdentity) -> Cause:
    none = np.zeros(0)
    gain = m.before - m.after
    return Cause(m.cause, m.where, (), (), none, none, gain, 1, 0.0, m.ids, same=m.same)


def _of_given(v: GivenValue) -> Cause:
    components = v.components if len(v.components) > 1 else ()
    what = f"the given {', '.join(v.components)}"
    where = f"of {UNKNOWNS[v.kind].noun} {v.name!r}"
    if len(components) > MOST_COMPONENTS_NAMED:
        what, where = "the coefficients", where.replace("of calibration of", "of", 1)
    return replace(_cause(what, where, components, v.sizes, v.together, ()), given=v)


def _of_axis(a: AxisScale) -> Cause:
    where = f"along {a.axis}, of {a.points} held points"
    found = _cause("the scale of the given coordinates", where, (), ("ratio",), a.found, ())
    return replace(found, rank=2)


def _cause(
    cause: str,
    where: str,
    components: tuple[str, ...],
    sizes: tuple[ErrorQuantity, ...],
    what: SharedErrorTest,
    ids: tuple[str, ...],
) -> Cause:
    figures = what.error, what.sigma, what.t2, what.dof
    return Cause(cause, where, components, sizes, *figures, np.nan, ids)


def _tested(solution: Solution, every: Iterable[ErrorColumns]) -> Iterator[Cause]:
    """Iterate over causes at places, of each the `MAX_PLACES_OF_CAUSE` with the largest T².

    T² of all places is computed if `MAX_PLACE_ELEMENTS` allows; otherwise of those with the largest
    (zᵀr)² / zᵀz, a lower bound of it. There is no upper bound without the solution for z by which
    T² itself is known.
    """
    equations = solution.equations
    residual = solution.normal().system.residual
    w, observation = whitening_matrix(equations), equations.observation_of_row
    kinds = list(every)
    at_most = MAX_PLACE_ELEMENTS // max(
        equations.unknowns.n_columns * sum(len(h.sizes) for h in kinds), 1
    )
    chosen: list[tuple[ErrorColumns, int]] = []
    parts: list[csc_array] = []
    groups: list[Index] = []
    first = 0
    for h in kinds:
        z = csc_array(w @ h.columns)
        q = len(h.sizes)
        places = np.flatnonzero(_observations(z, q, observation) >= MIN_SHARING_OBSERVATIONS)
        if len(places) > MAX_PLACES_OF_CAUSE:
            total = np.asarray(z.multiply(z).sum(axis=0)).ravel()
            least = (z.T @ residual) ** 2 / np.where(total > 0, total, 1.0)
            places = _largest(places, least.reshape(-1, q).sum(axis=1)[places], at_most)
            places = _largest(
                places, t2_of_errors(solution, _of_places(z, places, q), q), MAX_PLACES_OF_CAUSE
            )
        for number in places.tolist():
            chosen.append((h, number))
            groups.append(first + np.arange(q))
            first += q
        parts.append(_of_places(z, places, q))
    if not chosen:
        return
    z = csc_array(hstack(parts))
    for (h, number), group, what in zip(
        chosen, groups, shared_error_tests(solution, z, groups), strict=True
    ):
        rows = np.unique(z.indices[z.indptr[group[0]] : z.indptr[group[-1] + 1]])
        ids = tuple(dict.fromkeys(map(equations.id, rows.tolist())))
        cause = _cause(h.cause, h.where[number], h.components, h.sizes, what, ids)
        recorded = np.nan if h.recorded is None else float(h.recorded[number])
        columns = _of_places(h.columns, np.array([number]), len(h.sizes))
        yield replace(cause, rank=h.rank, recorded=recorded, columns=columns)


def _of_places(z: csc_array, places: Index, q: int) -> csc_array:
    """Return the columns of some places, q each."""
    return csc_array(z[:, (places[:, None] * q + np.arange(q)).ravel()])


def _largest(places: Index, sizes: Array, most: int) -> Index:
    """Return the places of the largest sizes, at least `MAX_PLACES_OF_CAUSE` of them."""
    return places[np.argsort(-sizes, kind="stable")[: max(most, MAX_PLACES_OF_CAUSE)]]


def _observations(z: csc_array, q: int, observation: Index) -> Index:
    """Return the number of observations that q columns each touch, (h,)."""
    column = np.repeat(np.arange(z.shape[1]), np.diff(z.indptr))
    pairs = np.unique(np.stack([column // q, observation[z.indices]]), axis=1)
    return np.bincount(pairs[0], minlength=z.shape[1] // q)
