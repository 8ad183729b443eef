"""Observations one by one: tested before they count, absorbed, taken out again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AdjustmentError, InputError, Problem, known
from ..network.entities import Camera, Photo, Point
from ..network.network import DatumChoice, Network
from ..observations import AnyObservation, Correlated, Observation
from ..quality.rejections import Snooping
from ..quality.reliability import Reliability, check_probabilities, reliability
from ..quality.snooping import snoop
from ..solve.estimates import CalibrationEstimate, PoseEstimate
from ..solve.solution import Solution
from ..stochastic import StandardDeviation
from ..types import Array
from . import records
from .absorbing import Absorbing, Arrival, joined
from .book import Book
from .engine import Engine
from .journal import Journal
from .local import known_network
from .trial import MOST_ROWS, parts
from .units import Unit, named
from .verdicts import Policy, Verdict
from .view import solution_of, without_tree

POLICIES = ("accept", "flag", "reject")
MOST_WEIGHT = 1e12
"""Factor of weights beyond which nothing is meant by it."""


@dataclass(frozen=True)
class Waiting:
    """An observation that waits."""

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name."""
    lacks: str
    """What is missing until it can enter."""


class IncrementalAdjustment(Absorbing):
    """A network that is adjusted while its observations arrive.

    Every observation is predicted from all others and tested before it counts; what is not
    determined yet waits and enters by itself; estimates and covariances are at any time within
    ``accuracy`` of a batch adjustment of the same observations, and after `settle` the same.

    Example:
        >>> import factorgraph_adj as fga
        >>> from factorgraph_adj.observations import SlopeDistance
        >>> net = fga.Network("three distances")
        >>> net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        >>> net.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
        >>> inc = fga.IncrementalAdjustment(net)
        >>> for value in (10.002, 10.000, 10.050):
        ...     verdict = inc.add(SlopeDistance("A", "B", value, sigma=0.002)).verdicts[0]
        ...     print(verdict.verdict, round(verdict.test, 1))
        accepted nan
        accepted 0.2
        suspect 6.0
    """

    def __init__(
        self,
        network: Network,
        *,
        policy: Policy = "flag",
        alpha: float = 0.001,
        accuracy: float = 0.01,
        datum: DatumChoice | None = None,
        start: Solution | None = None,
        journal: str | Path | None = None,
    ) -> None:
        """Start from a network; it is copied.

        Args:
            network: points, cameras, photos and what is known of other unknowns; observations, if
                there are any, enter without a test, those that are not determined yet wait.
            policy: what becomes of an observation beyond the critical value: ``accept`` (it is in,
                its verdict tells), ``flag`` (suspect: left out until it is accepted or discarded)
                or ``reject``.
            alpha: probability of a false alarm of one test.
            accuracy: largest deviation from the batch adjustment, relative to each standard
                deviation, until `settle` removes it.
            datum: as in `adjust`.
            start: a solution of the network, which saves adjusting it.
            journal: a new file to which every change is appended before it counts.

        Raises:
            InputError: an option or the network's input is bad, or the journal has content.
        """
        _check_options(policy, alpha, accuracy, datum)
        self.policy: Policy = policy
        """What becomes of observations beyond the critical value."""
        self.alpha = alpha
        """Probability of a false alarm of one test."""
        self.resumed = ""
        """What `resume` found torn at the end of its journal; empty if nothing."""
        self._journal: Journal | None = None
        self._solution: Solution | None = None
        self._spared = set()
        self._depth, self._starting_over, self._most_split = 0, False, np.inf
        self._was = None
        chosen = network.datum if datum is None else datum
        self._book = Book(network.copy())
        self._book.network.datum = chosen
        self._engine = Engine(self._book.network, datum=chosen, accuracy=accuracy)
        self._begin(start)
        if journal is not None:
            options = {"policy": policy, "alpha": alpha, "accuracy": accuracy, "datum": chosen}
            self._journal = Journal.create(journal, records.header(network, options), durable=False)

    def _begin(self, start: Solution | None) -> None:
        """Put the network's own observations in; what they do not determine waits."""
        book = self._book
        if not book.inside:
            return
        loose: list[Unit] = []
        network = book.adjustable()
        solution = self._adjusted(network, start)
        if solution is None or not solution.converged:
            loose = self._set_aside()
            if loose:
                network = book.adjustable()
                solution = self._adjusted(network, start)
        if book.inside:
            try:
                self._hold(network, solution, start)
            except AdjustmentError:
                loose = [*book.take_all(), *loose]
            else:
                self._engine.settled = False
                book.fill(self._engine.register)
        if loose:
            self._absorb(loose, test=False)

    @classmethod
    def resume(cls, journal: str | Path) -> IncrementalAdjustment:
        """Rebuild the state from a journal, and go on with it.

        A torn last line, of an arrival in hand when the process ended, is left out; ``resumed``
        says so. The network, what waits, suspects and rejected observations are as they were;
        estimates are at rest.

        Raises:
            InputError: no journal, or a damaged line before the last.
        """
        opened, header, entries, torn = Journal.open(journal, durable=False)
        try:
            network, options = records.start_of(header)
            _check_options(options["policy"], options["alpha"], options["accuracy"], None)
            out = cls.__new__(cls)
            out.policy, out.alpha = options["policy"], options["alpha"]
            out.resumed, out._solution, out._journal = torn, None, None
            out._spared, out._depth = set(), 0
            out._starting_over, out._most_split, out._was = False, np.inf, None
            out._book = Book(network)
            network.datum = options["datum"]
            out._engine = Engine(network, datum=options["datum"], accuracy=options["accuracy"])
            out._begin(None)
            for line, entry in enumerate(entries, start=2):
                records.replay(entry, out._book, where=f"{journal}:{line}")
            out._restore()
        except BaseException:
            opened.close()
            raise
        out._journal = opened
        return out

    # -- arriving -----------------------------------------------------------------------------

    def add(
        self,
        observations: AnyObservation | Sequence[AnyObservation] = (),
        *,
        points: Iterable[Point] = (),
        photos: Iterable[Photo] = (),
        cameras: Iterable[Camera] = (),
    ) -> Arrival:
        """Test observations and absorb them; what they lack, they wait for.

        Each is compared with its prediction from everything else, see
        `factorgraph_adj.incremental.verdicts`. Of several that are beyond the critical value the
        worst goes first, as in data snooping.

        Args:
            observations: one or many, of any kind, correlated groups among them.
            points: new points.
            photos: new photos.
            cameras: new cameras.

        Returns:
            A verdict for each observation given, then for those that entered by themselves.

        Raises:
            InputError: everything that is wrong with the input; nothing has changed then.
        """
        observations = _listed(observations)
        new = tuple(points), tuple(photos), tuple(cameras)
        draft = self._book.with_entities(*new) if any(new) else self._book.network
        units = self._book.units(draft, list(observations))
        entry = self._entry("add", **records.entities(*new))
        if sum(u.n_scalars for u in units) > MOST_ROWS:
            with self._all_or_nothing(entry):
                self._take_over(draft)
                found = Arrival()
                for part in parts(units):
                    found = joined(found, self._absorb(part, test=True))
            return found
        before = self._book.network
        self._take_over(draft)
        try:
            return self._absorb(units, test=True, entry=entry)
        except BaseException:
            if draft is not before:
                self._take_over(before)
            raise

    # -- changing -----------------------------------------------------------------------------

    def remove(self, ids: str | Iterable[str]) -> Arrival:
        """Take observations out, wherever they are: in the graph, waiting, suspect or rejected.

        What they alone determined waits again, with all observations of it.

        Args:
            ids: ids; ``photo/point`` for image points; names such as ``"point P1 x"`` for weighted
                unknowns, which are free without their given values.

        Raises:
            InputError: every id that there is not; nothing has changed then.
        """
        wanted = self._known_ids([ids] if isinstance(ids, str) else list(ids))
        with self._all_or_nothing({"do": "remove"}):
            waits = self._remove(wanted)
        return Arrival((), waits)

    def replace(self, id: str, observation: Observation) -> Arrival:
        """Put a new observation in the place of another, under the same id; it is tested.

        Raises:
            InputError: no such id, or what is wrong with the observation; nothing has changed.
        """
        self._known_ids([id])
        with self._all_or_nothing({"do": "replace"}):
            self._remove([id])
            units = self._book.units(self._book.network, [named(observation, id)])
            found = self._absorb(units, test=True)
        return found

    def reweight(self, ids: str | Iterable[str], factor: float) -> Arrival:
        """Multiply the weights of observations by a factor: their σ are divided by its root.

        Suspects and rejected observations are tested anew.

        Args:
            ids: ids of observations; members of correlated groups reweight the group.
            factor: from 1e-12 to 1e12.

        Raises:
            InputError: unknown ids, or a bad factor; nothing has changed then.
        """
        wanted = self._known_ids([ids] if isinstance(ids, str) else list(ids))
        if not 1.0 / MOST_WEIGHT <= factor <= MOST_WEIGHT:
            what = f"the factor of weights must be between {1 / MOST_WEIGHT:g} and {MOST_WEIGHT:g}"
            raise InputError(f"{what}, not {factor}")
        with self._all_or_nothing({"do": "reweight"}):
            units = list({u.ids[0]: u for u in map(self._book.unit, wanted)}.values())
            left_out = [self._book.status(u.ids[0]) in ("suspect", "rejected") for u in units]
            self._remove([i for u in units for i in u.ids])
            scaled = [_scaled(u, 1.0 / np.sqrt(factor)) for u in units]
            found = Arrival()
            for test in (False, True):
                part = [u for u, out in zip(scaled, left_out, strict=True) if out == test]
                if part:
                    found = joined(found, self._absorb(part, test=test))
        return found

    def accept(self, ids: str | Iterable[str]) -> Arrival:
        """Put suspects, or rejected observations, in after all.

        Raises:
            InputError: every id that is neither; nothing has changed then.
        """
        wanted = [ids] if isinstance(ids, str) else list(ids)
        with self._all_or_nothing({"do": "accept"}):
            units = self._book.release(wanted)
            self._solution = None
            found = self._absorb(units, test=False)
        return found

    def discard(self, ids: str | Iterable[str]) -> None:
        """Throw suspects out: they count as rejected.

        Raises:
            InputError: every id that is not a suspect; nothing has changed then.
        """
        wanted = [ids] if isinstance(ids, str) else list(ids)
        with self._all_or_nothing({"do": "discard"}):
            self._book.discard(wanted)

    def snoop(self, **options: Any) -> Snooping:
        """Search the whole network for gross errors, and take out what is found.

        Args:
            options: as those of `factorgraph_adj.snoop`.

        What it takes out is then among ``rejected``, with verdicts that have no figures: those are
        in what is returned.

        Raises:
            InputError: nothing is in the graph.
        """
        found = snoop(self.network(), start=self.solution(), **{"alpha": self.alpha, **options})
        ids = [r.id for r in found.rejected]
        ids += [i for p in found.points_set_aside for i in p.rays]
        if ids:
            with self._all_or_nothing({"do": "snoop"}):
                inside = [i for i in dict.fromkeys(ids) if self._book.in_graph(i)]
                weights = [i for i in dict.fromkeys(ids) if i not in inside]
                units = list(dict.fromkeys(self._book.unit(i) for i in inside))
                self._remove([*(i for u in units for i in u.ids), *weights])
                self._book.reject(units)
        return found

    def settle(self) -> None:
        """Iterate to rest: no estimate is further than 1e-6 σ from the batch adjustment's.

        In a free network the coordinates are then on the inner constraints over all datum points.
        """
        book = self._book
        if self._engine.empty and not book.pool:
            return
        with self._all_or_nothing(self._entry("settle")):
            self._solution = None
            if not self._engine.empty:
                self._engine.settle()
                self._let_go(())
            if book.pool:
                book.retries.clear()
                found = self._absorb(list(book.pool.values()), test=True)
                if any(v.verdict != "waiting" for v in found.verdicts):
                    self._engine.settle()

    # -- asking -------------------------------------------------------------------------------

    @property
    def waiting(self) -> tuple[Waiting, ...]:
        """What waits, and what it lacks."""
        return tuple(w for u in self._book.pool.values() for w in self._waiting_of(u))

    def latest_waiting(self, most: int) -> tuple[Waiting, ...]:
        """Return what began to wait last, the latest first: ``most`` units at most."""
        units = islice(reversed(self._book.pool.values()), most)
        return tuple(w for u in units for w in self._waiting_of(u))

    @property
    def n_waiting(self) -> int:
        """Number of observations that wait."""
        return sum(len(u.ids) for u in self._book.pool.values())

    def _waiting_of(self, unit: Unit) -> Iterator[Waiting]:
        lacks = self._book.why(unit, self._engine.register)
        for ident, o in zip(unit.ids, unit.observations, strict=True):
            yield Waiting(ident, o.kind, o.label(), lacks)

    @property
    def suspects(self) -> tuple[Verdict, ...]:
        """Observations beyond the critical value that are left out until they are decided on."""
        return tuple(v for _, found in self._book.suspects.values() for v in found)

    @property
    def rejected(self) -> tuple[Verdict, ...]:
        """Observations that were rejected."""
        return tuple(v for _, found in self._book.rejected.values() for v in found)

    def network(self) -> Network:
        """Return the network as it stands: what is in the graph, to save or to adjust in batch.

        Approximate values that were found stand in it as given ones.
        """
        return known_network(self._book.network, self._engine.register)

    def solution(self) -> Solution:
        """Return the solution: the same as that of the batch adjustment.

        Its covariances are those of iSAM2's Bayes tree.

        Raises:
            InputError: nothing is in the graph.
        """
        if self._solution is None:
            if self._engine.empty:
                raise InputError("nothing is determined yet: there is no solution")
            self._engine.to_datum()
            self._solution = solution_of(self._engine)
        return self._solution

    def reliability(self, *, alpha: float | None = None, power: float = 0.80) -> Reliability:
        """Return the reliability of every observation, from iSAM2's own Bayes tree.

        All observations are linearised anew for it. Where that is not precise enough for points
        with next to nothing to say where they are, the normal equations are factorised as by
        `adjust`.

        Raises:
            InputError: a bad probability, or nothing is in the graph.
            AdjustmentError: the network is too weak even for that.
        """
        chosen = self.alpha if alpha is None else alpha
        check_probabilities(chosen, power)
        if not self._engine.settled and not self._engine.empty:
            self._solution = None
            self._engine.linearise_here()
        solution = self.solution()
        with suppress(AdjustmentError):
            return reliability(solution, alpha=chosen, power=power)
        return reliability(without_tree(solution), alpha=chosen, power=power)

    def estimate(self, name: str) -> Array:
        """Return the coordinates of a point, (3,) metres.

        In a free network they belong to the inner constraints, which takes a whole solution.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        if self._engine.held:
            return self.solution().point(self._determined(name))
        table = self._engine.register["point"]
        self._determined(name)
        if name not in table.number:
            return np.array(self._book.network.points[name].coordinates)
        return np.array(table.value.view[table.number[name]])

    def covariance(self, a: str, b: str | None = None) -> Array:
        """Return the covariance of a point, or between two points, (3, 3) metres²; σ0 = 1.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        names = [self._determined(n) for n in ((a,) if b is None or a == b else (a, b))]
        if self._engine.held:
            return self.solution().covariance(a, b)
        return self._engine.point_covariance(names[0], names[-1])

    def standard_deviations(self, name: str) -> Array:
        """Return the standard deviations of a point, (3,) metres."""
        return np.sqrt(np.maximum(np.diag(self.covariance(name)), 0.0))

    def pose(self, photo: str) -> PoseEstimate:
        """Return the exterior orientation of a photo, as `Solution.pose`."""
        return self.solution().pose(photo)

    def calibration(self, camera: str) -> CalibrationEstimate:
        """Return the calibration of a camera, as `Solution.calibration`."""
        return self.solution().calibration(camera)

    def observation(self, id: str) -> Observation:
        """Return an observation by its id: in the graph, waiting, suspect or rejected.

        Raises:
            InputError: no such id.
        """
        unit = self._book.unit(id)
        return unit.observations[unit.ids.index(id)]

    @property
    def described(self) -> Network:
        """Everything that was described, what is not determined yet among it; not to be changed.

        Its observations are those in the graph.
        """
        return self._book.network

    @property
    def n_observations(self) -> int:
        """Number of scalar rows in the graph, weighted unknowns among them."""
        return self._engine.store.n_scalars

    @property
    def redundancy(self) -> int:
        """Redundancy of the network as it stands."""
        return self._engine.redundancy

    @property
    def vtpv(self) -> float:
        """VᵀPv, of the linear forms."""
        return self._engine.store.vtpv()

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight √(vᵀPv/r); NaN without redundancy."""
        r = self.redundancy
        return float(np.sqrt(self.vtpv / r)) if r > 0 else np.nan

    @property
    def settled(self) -> bool:
        """Whether nothing has changed since it was at rest."""
        return self._engine.settled

    def __len__(self) -> int:
        """Return the number of observations in the graph."""
        network = self._book.network
        return len(network.observations) + network.n_image_points

    def __repr__(self) -> str:
        """Say what is in the graph, and what is not."""
        book = self._book
        return (
            f"<IncrementalAdjustment of {book.network.name!r}: {len(self)} observations, "
            f"redundancy {self.redundancy}, {len(self.waiting)} waiting, {len(self.suspects)} "
            f"suspects, {len(self.rejected)} rejected>"
        )

    # -- helpers ------------------------------------------------------------------------------

    def _determined(self, name: str) -> str:
        points = self._book.network.points
        if name not in points:
            raise InputError(f"unknown point {name!r}; known: {known(points)}")
        if self._engine.register.known("point", name) or all(points[name].fixed):
            return name
        lacks = self._book.lacks.get(("point", name), "no observation has determined it yet")
        raise InputError(Problem(f"is not determined: {lacks}", f"point {name!r}"))

    def _known_ids(self, ids: Sequence[str]) -> list[str]:
        wanted = list(dict.fromkeys(ids))
        problems = [
            Problem("unknown observation", f"observation {i!r}")
            for i in wanted
            if not self._book.has(i) and i not in self._engine.store.places
        ]
        if problems:
            raise InputError(problems)
        return wanted

    # -- resuming -----------------------------------------------------------------------------


def _check_options(policy: str, alpha: float, accuracy: float, datum: str | None) -> None:
    problems = []
    if policy not in POLICIES:
        problems.append(Problem(f"unknown policy {policy!r}; valid: {', '.join(POLICIES)}"))
    if not 0 < alpha < 1:
        problems.append(Problem(f"alpha must be between 0 and 1, not {alpha}"))
    if not 0 < accuracy <= 0.1:
        problems.append(Problem(f"accuracy must be in (0, 0.1], not {accuracy}"))
    if datum not in (None, "given", "free"):
        problems.append(Problem(f"unknown datum {datum!r}; valid: given, free"))
    if problems:
        raise InputError(problems)


def _listed(given: object) -> list[AnyObservation]:
    """Return observations as a list."""
    if isinstance(given, Observation | Correlated):
        return [given]
    several = isinstance(given, Iterable) and not isinstance(given, str)
    items: list[Any] = list(given) if several else [given]  # type: ignore[call-overload]
    problems = [
        Problem("is no observation: see factorgraph_adj.observations", repr(i)[:80])
        for i in items
        if not isinstance(i, Observation | Correlated)
    ]
    if problems:
        raise InputError(problems)
    return items


def _scaled(unit: Unit, by: float) -> Unit:
    """Return the unit with its standard deviations multiplied."""
    covariance = None if unit.covariance is None else unit.covariance * by**2
    return Unit(
        unit.ids,
        tuple(_scaled_observation(o, by) for o in unit.observations),
        covariance,
        unit.variables,
        unit.unknowns,
    )


def _scaled_observation(o: Observation, by: float) -> Observation:
    changes: dict[str, Any] = {}
    sigma = getattr(o, "sigma", None)
    if isinstance(sigma, StandardDeviation):
        changes["sigma"] = sigma.scaled(by)
    elif isinstance(sigma, tuple):
        changes["sigma"] = tuple(s * by for s in sigma)
    elif sigma is not None:
        changes["sigma"] = sigma * by
    covariance = getattr(o, "covariance", None)
    if covariance is not None:
        changes["covariance"] = np.asarray(covariance) * by**2
    return replace(o, **changes)
