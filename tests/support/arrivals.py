"""Networks taken apart and put together again observation by observation, against the batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from factorgraph_adj import IncrementalAdjustment, Network, Solution, adjust, reliability
from factorgraph_adj.errors import AdjustmentError
from factorgraph_adj.graph.dependence import variables_of
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.models.base import wrap
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import AnyObservation, Correlated, ImagePoint
from factorgraph_adj.quality.reliability import Reliability
from factorgraph_adj.types import Array, Mask


def bare(network: Network) -> Network:
    """Return the network without observations."""
    out = network.copy()
    out.observations, out.clusters = {}, []
    out.image_mask(np.zeros(network.n_image_points, dtype=bool))
    return out


def items(network: Network) -> list[AnyObservation]:
    """Return its observations in file order, correlated groups where their first member stands."""
    group_of = {i: n for n, (ids, _) in enumerate(network.clusters) for i in ids}
    out: list[AnyObservation] = []
    done: set[int] = set()
    for ident, o in network.observations.items():
        number = group_of.get(ident)
        if number is None:
            out.append(replace(o, id=ident))
        elif number not in done:
            done.add(number)
            ids, covariance = network.clusters[number]
            members = tuple(replace(network.observations[i], id=i) for i in ids)
            out.append(Correlated(members, covariance))
    alone = np.flatnonzero(~network.images.is_joint)
    return [*out, *network.image_groups(), *network.image_points(alone)]


def split(network: Network, kind: str, name: str) -> tuple[Network, list[AnyObservation]]:
    """Return the network without an unknown, and what depends on it."""
    late = {i for i, o in network.observations.items() if (kind, name) in variables_of(network, o)}
    assert late
    first = network.copy()
    later = [item for item in items(network) if late & set(ids_of(item))]
    gone = {i for item in later for i in ids_of(item)}
    first.observations = {i: o for i, o in network.observations.items() if i not in gone}
    first.clusters = [c for c in network.clusters if gone.isdisjoint(c[0])]
    del first.of_kind(kind)[name]
    return first, later


def ids_of(item: AnyObservation) -> list[str]:
    """Return the ids of an observation or a group."""
    members = item.observations if isinstance(item, Correlated) else (item,)
    return [
        o.id or f"{o.photo}/{o.point}" if isinstance(o, ImagePoint) else str(o.id) for o in members
    ]


def variables(solution: Solution) -> Iterator[tuple[str, str]]:
    """Return kind and name of all variables that own columns."""
    unknowns = solution.equations.unknowns
    for kind, number in unknowns.active():
        yield kind, unknowns[kind].names[number]


@dataclass(frozen=True)
class Difference:
    """How far two solutions are from each other."""

    estimates: float
    """Largest difference of an estimate, relative to its σ."""
    sigmas: float
    """Largest relative difference of a σ."""

    @property
    def largest(self) -> float:
        """Both of them."""
        return max(self.estimates, self.sigmas)


def difference(
    a: Solution, b: Solution, *, shared: bool = False, shapes: bool = True
) -> Difference:
    """Compare the variables of a with those of b.

    Args:
        a: one solution.
        b: the other.
        shared: compare those that both have; otherwise they have the same.
        shapes: whether frames of shapes are compared: the normal of a plane or the axis of a
            cylinder may point either way, at the same minimum.
    """
    estimates = sigmas = 0.0
    ours, theirs = set(variables(a)), set(variables(b))
    assert shared or ours == theirs
    frames = b.equations.network.frames
    for kind, name in ours & theirs:
        if kind == "frame" and not shapes and frames[name].fixed[:3] == (False, False, True):
            continue
        free, qb = deviations(b, kind, name)
        if not free.any():
            continue
        qa = np.sqrt(np.maximum(np.diag(a.variable_covariance((kind, name))), 0.0))
        moved = between(a, b, kind, name)
        estimates = max(estimates, float(np.max(np.abs(moved[free]) / qb[free])))
        sigmas = max(sigmas, float(np.max(np.abs(qa[free] / qb[free] - 1.0))))
    return Difference(estimates, sigmas)


NOTHING = 1e-2
"""Standard deviation relative to the conditional one 1/√N_ii: less is only the rounding of zero.
Two datum points and a direction between them have nothing but inner constraints."""


def deviations(solution: Solution, kind: str, name: str) -> tuple[Mask, Array]:
    """Return which components of a variable have a σ, and their σ."""
    unknowns = solution.equations.unknowns
    columns = unknowns.columns(kind, solution.number(kind, name))
    weight = np.maximum(solution.normal().diagonal[columns], 0.0)
    sigma = np.sqrt(np.maximum(np.diag(solution.variable_covariance((kind, name))), 0.0))
    return sigma * np.sqrt(weight) > NOTHING, sigma


def between(a: Solution, b: Solution, kind: str, name: str) -> Array:
    """Return the step of the tangent that moves a variable of ``b`` to where ``a`` has it."""
    record = UNKNOWNS[kind]
    va, vb = (s.state[kind][s.number(kind, name)][None] for s in (a, b))
    size = len(b.equations.unknowns.component_names(kind, b.number(kind, name)))
    moved = record.local(vb, va)[0, :size]
    circular = np.array([c.circular for c in record.components[:size]], dtype=bool)
    if circular.any():
        moved = np.where(circular, wrap(moved), moved)
    return moved


TOLERANCES = (1e-9, 1e-7, 1e-5)
"""What the batch adjustment is asked for, relative to σ: networks that are hardly determined yet
have rounding errors of 1e-6 σ, free ones do not come closer to their inner constraints."""


def batch(inc: IncrementalAdjustment, *, tolerances: Sequence[float] = TOLERANCES) -> Solution:
    """Return the batch adjustment of the same observations, to the least tolerance it reaches."""
    network, start = inc.network(), inc.solution()
    for tolerance in tolerances:
        found = adjust(network, start=start, tolerance=tolerance)
        if found.converged:
            break
    return found


# -- a whole network, arriving -------------------------------------------------------------------

EQUALLY_WELL = 1.0
"""Difference of vᵀPv of two places between which the observations do not decide."""
FEW = 8
"""Points that are asked for directly at each moment."""


@dataclass(frozen=True)
class Moment:
    """A comparison with the batch adjustment of the same observations."""

    when: str
    """How many have arrived, and what happened last."""
    settled: bool
    estimates: float
    """Largest difference of an estimate, relative to its σ."""
    sigmas: float
    """Largest relative difference of a σ."""
    redundancy: float
    """Largest difference of a redundancy number."""
    n_waiting: int
    no_batch: str = ""
    """Why there is nothing to compare with: the batch adjustment does not come to rest either, or
    has no redundancy numbers."""

    @property
    def promise(self) -> float:
        """What the differences are in units of what was promised: at most 1."""
        bound, share = (1e-6, 1e-6) if self.settled else (1e-2, 1e-3)
        parts = self.estimates / bound, self.sigmas / bound, self.redundancy / share
        return float(np.max(parts))  # NaN where any is

    def __str__(self) -> str:
        """Return a line of a table."""
        if self.no_batch:
            return f"{self.when}: {self.no_batch}"
        return (
            f"{self.when}: x {self.estimates:.1e} σ {self.sigmas:.1e} r {self.redundancy:.1e}, "
            f"{self.n_waiting} wait"
        )


def chunks(
    network: Network, seed: int | None, *, by_photo: bool = False
) -> list[list[AnyObservation]]:
    """Return what arrives together, in file order or in a seeded random one.

    Args:
        network: all of it.
        seed: of the order; none: as in the file.
        by_photo: all image points of a photo together, in the order of the photos; the other
            observations one by one in any case.
    """
    photos: dict[str, list[AnyObservation]] = {}
    out: list[list[AnyObservation]] = []
    for item in items(network):
        if by_photo and isinstance(item, ImagePoint):
            if item.photo not in photos:
                out.append(photos.setdefault(item.photo, []))
            photos[item.photo].append(item)
        else:
            out.append([item])
    if seed is None:
        return out
    rng = np.random.default_rng(seed)
    return [out[i] for i in rng.permutation(len(out))]


def compare(
    inc: IncrementalAdjustment, when: str, *, rng: np.random.Generator, shares: bool = True
) -> Moment | None:
    """Compare with the batch; none while nothing is determined.

    Args:
        inc: what has arrived.
        when: says so.
        rng: chooses points that are asked for directly.
        shares: whether redundancy numbers are compared too; all rows are linearised anew for
            them, which further arrivals must not always find.
    """
    if not len(inc):
        return None
    names = inc.network().points
    chosen = [str(n) for n in rng.permutation(list(names))[:FEW]]
    asked = [(inc.estimate(n), inc.standard_deviations(n)) for n in chosen]
    ours = inc.solution()
    theirs = batch(inc)
    settled = when.endswith("settled")
    if not theirs.converged:
        return Moment(when, settled, 0.0, 0.0, 0.0, inc.n_waiting, theirs.reason)
    found = difference(ours, theirs)
    if theirs.second_places and not settled and found.estimates > 1.0:
        # Where two places fit, the state stays in its own until it settles, and the batch looks
        # both ways at once.
        assert ours.vtpv >= theirs.vtpv - 1e-6
        assert ours.vtpv - theirs.vtpv < EQUALLY_WELL
        return Moment(when, settled, 0.0, 0.0, 0.0, inc.n_waiting)
    estimates, sigmas = found.estimates, found.sigmas
    for name, (at, deviation) in zip(chosen, asked, strict=True):
        if theirs.equations.unknowns["point"].offset[theirs.number("point", name)] < 0:
            assert not deviation.any()
            continue
        free, sigma = deviations(theirs, "point", name)
        if free.any():
            step = np.abs(at - theirs.point(name))[free] / sigma[free]
            estimates = max(estimates, float(step.max()))
            sigmas = max(sigmas, float(np.abs(deviation[free] / sigma[free] - 1.0).max()))
    redundancy = 0.0
    if shares and ours.redundancy > 0:  # else every one of them is 0
        try:
            expected = figures(reliability(theirs))
        except AdjustmentError as error:
            return Moment(when, settled, estimates, sigmas, 0.0, inc.n_waiting, str(error))
        r = figures(inc.reliability())
        assert r.keys() == expected.keys()
        redundancy = max(float(np.abs(r[k] - expected[k]).max()) for k in r)
    return Moment(when, settled, estimates, sigmas, redundancy, inc.n_waiting)


def figures(found: Reliability) -> dict[tuple[str, str], Array]:
    """Return the redundancy numbers of every observation, by kind and id."""
    out: dict[tuple[str, str], list[float]] = {}
    rows = found.solution.observations
    for row, r in zip(rows, found.redundancy_numbers.tolist(), strict=True):
        out.setdefault((row.kind, row.id), []).append(r)
    return {k: np.array(v) for k, v in out.items()}


MOST_OUT = 10
"""Observations and groups that are taken out together."""


def play(
    network: Network,
    seed: int | None,
    *,
    moments: int = 5,
    by_photo: bool = False,
    engine: Engine | None = None,
) -> Iterator[Moment]:
    """Let a network arrive, with removals in between; compare with the batch.

    At each of the moments some of what has arrived is taken out, of correlated groups a part;
    at the next it comes back, after other arrivals. At the middle one, and in the end, when
    everything is in, it settles.

    Args:
        network: all of it.
        seed: of order and removals; none: file order.
        moments: how often.
        by_photo: see `chunks`.
        engine: what carries the arrivals; none: the default.

    Yields:
        Every comparison, the last one settled.
    """
    rng = np.random.default_rng(0 if seed is None else seed)
    chosen: dict[str, Any] = {} if engine is None else {"engine": engine}
    inc = IncrementalAdjustment(bare(network), policy="accept", **chosen)
    arrivals = chunks(network, seed, by_photo=by_photo)
    stops = np.unique(np.linspace(0, len(arrivals), moments + 1).astype(int)[1:]).tolist()
    here: list[AnyObservation] = []
    out: list[AnyObservation] = []

    def moment(when: str, *, shares: bool = True) -> Iterator[Moment]:
        found = compare(inc, f"{count} of {len(arrivals)}{when}", rng=rng, shares=shares)
        if found is not None:
            yield found

    for count, arriving in enumerate(arrivals, start=1):
        inc.add(arriving)
        here += arriving
        if count not in stops:
            continue
        yield from moment("", shares=False)
        come_back(inc, out)
        yield from moment(", what was out is back", shares=False)
        if count == stops[len(stops) // 2]:
            inc.settle()
            yield from moment(", settled")
        most = min(MOST_OUT, len(here) // 4) + 1
        out = [here[i] for i in rng.permutation(len(here))[: rng.integers(1, most + 1)]]
        take_out(inc, out, rng)
        yield from moment(f", {len(out)} out")
    come_back(inc, out)
    yield from moment(", all again")
    assert len(inc) + inc.n_waiting == len(network.observations) + network.n_image_points
    inc.settle()
    yield from moment(", settled")


def take_out(
    inc: IncrementalAdjustment, out: Sequence[AnyObservation], rng: np.random.Generator
) -> None:
    """Take observations out together, and of every group some members."""
    ids: list[str] = []
    for item in out:
        own = ids_of(item)
        ids += [own[i] for i in rng.permutation(len(own))[: rng.integers(1, len(own) + 1)]]
    inc.remove(ids)


def come_back(inc: IncrementalAdjustment, out: Sequence[AnyObservation]) -> None:
    """Put observations in again one by one; groups come back whole, their rest goes before."""
    there = {w.id for w in inc.waiting}
    network = inc.network()
    there |= {*network.observations} | {i for o in network.image_points() for i in ids_of(o)}
    for item in out:
        rest = [i for i in ids_of(item) if i in there]
        if rest:
            inc.remove(rest)
        inc.add(item)


def assert_any_order_ends_at_the_batch(network: Network) -> None:
    """Let the observations of a network arrive in twelve groups by chance, and compare the end."""
    every = items(network)
    order = np.random.default_rng(6).permutation(len(every))
    inc = IncrementalAdjustment(bare(network), policy="accept")
    for some in np.array_split(order, 12):
        inc.add([every[i] for i in some])
    inc.settle()
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-5
