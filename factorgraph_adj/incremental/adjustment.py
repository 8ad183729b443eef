"""Observations one by one: tested before they count, absorbed, taken out again."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError
from ..graph.made import MakesFactor
from ..io.journal import Journal
from ..network.entities import Camera, Photo, Point
from ..network.network import DatumChoice, Network
from ..observations import AnyObservation, Observation
from ..quality.rejections import Snooping
from ..quality.reliability import Reliability, check_probabilities, reliability
from ..solve.estimates import CalibrationEstimate, PoseEstimate
from ..solve.solution import Solution
from ..types import Array
from ..validate.preliminary.copied_blocks import CopiedBlocks
from . import commands, contradicted_photos, points, records, sides
from .arrival import Arrival, Waiting, waiting_of
from .beginning import begin, replayed
from .flow import State
from .given import Given, listed
from .ledger import Ledger
from .one_at_a_time import one_at_a_time
from .rebasing import known_network, solution_of
from .rules import Engine, Rules
from .verdicts import Policy, Verdict


class IncrementalAdjustment:
    """A network that is adjusted while its observations arrive.

    Every observation is predicted from all others and tested before it counts; what is not
    determined yet waits and enters by itself; estimates and covariances are at any time within
    ``accuracy`` of a batch adjustment of the same observations, and after `settle` the same.

    Several threads may use one adjustment: each call is a whole, and calls of other threads wait
    until it has ended.

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

    @with_one_thread
    def __init__(
        self,
        network: Network,
        *,
        policy: Policy = "flag",
        alpha: float = 0.001,
        accuracy: float = 0.01,
        datum: DatumChoice | None = None,
        engine: Engine = "auto",
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
            engine: what carries the arrivals: ``isam2``, ``fronts``, or ``auto``: iSAM2 where the
                network has few image points and a given datum. Results do not depend on it.
            start: a solution of the network, which saves adjusting it.
            journal: a new file to which every change is appended before it counts.

        Raises:
            InputError: an option or the network's input is bad, or the journal has content.
        """
        (network,) = listed([network], "fga.Network: fga.read_project(FOLDER) reads one", Network)
        chosen = network.datum if datum is None else datum
        self.resumed = ""
        """What `resume` found torn at the end of its journal; empty if nothing."""
        self._lock = RLock()
        self._rules = Rules(policy, alpha, accuracy, chosen, engine)
        self._journal: Journal | None = None
        self._solution: tuple[State, Solution] | None = None
        self.latest = Arrival()
        """What the latest command came to; after `snoop`, the verdicts on what came back."""
        self._copies = CopiedBlocks()
        own = network.copy()
        own.datum = chosen
        self._state = begin(Ledger.of(own), self._rules, start)
        self._copies.add(self._state.ledger.observations())
        if journal is not None:
            head = records.header(network, asdict(self._rules))
            self._journal = Journal.create(journal, head, durable=False)

    @classmethod
    @with_one_thread
    def resume(
        cls,
        journal: str | Path,
        *,
        geoids: Collection[str] = (),
        allow_outside: bool = False,
    ) -> IncrementalAdjustment:
        """Rebuild the state from a journal, and go on with it.

        A torn last line, of an arrival in hand when the process ended, is left out; ``resumed``
        says so. The network, what waits and why, suspects and rejected observations are as they
        were; estimates are at rest.

        Args:
            journal: the file.
            geoids: paths of geoids that may be read although they lie outside the folder of the
                journal, which may come from anybody.
            allow_outside: whether the geoid may lie anywhere.

        Raises:
            InputError: no journal, or a damaged line before the last.
        """
        opened, header, entries, torn = Journal.open(journal, durable=False)
        try:
            place, folder = f"{journal}:1", Path(journal).parent
            network, rules = records.start_of(header, place, folder, geoids, allow_outside)
            out = cls.__new__(cls)
            network.datum = rules.datum
            out._rules, out._lock = rules, RLock()
            out.resumed, out._solution, out._journal = torn, None, None
            out.latest = Arrival()
            out._copies = CopiedBlocks()
            out._state = replayed(network, entries, out._rules, str(journal))
            out._copies.add(out._state.ledger.observations())
        except BaseException:
            opened.close()
            raise
        out._journal = opened
        return out

    @property
    def policy(self) -> Policy:
        """What becomes of observations beyond the critical value."""
        return self._rules.policy

    @property
    def alpha(self) -> float:
        """Probability of a false alarm of one test."""
        return self._rules.alpha

    def _changed(
        self, do: str, result: tuple[State, Arrival], fields: Mapping[str, Any] | None = None
    ) -> Arrival:
        """Write the difference of two ledgers to the journal, then take the new state over."""
        state, arrival = result
        if self._journal is not None:
            changed = records.difference(self._state.ledger, state.ledger)
            self._journal.append({"do": do, **(fields or {}), **changed})
        self._state, self.latest = state.recorded(), arrival
        return arrival

    @one_at_a_time
    def add(
        self,
        observations: AnyObservation | Sequence[AnyObservation] = (),
        *,
        points: Point | Iterable[Point] = (),
        photos: Photo | Iterable[Photo] = (),
        cameras: Camera | Iterable[Camera] = (),
        factors: Mapping[str, MakesFactor] | None = None,
    ) -> Arrival:
        """Test observations and absorb them; what they lack, they wait for.

        Each is compared with its prediction from everything else, see
        `factorgraph_adj.incremental.verdicts`. Of several that are beyond the critical value the
        worst goes first, as in data snooping. The arrival has a verdict on each observation given,
        then on those that entered by themselves.

        Args:
            observations: one or many, of any kind, correlated groups among them.
            points: new points, or approximate coordinates of points that have none yet.
            photos: new photos.
            cameras: new cameras.
            factors: factors of your own by id, each as a function of ``key(kind, name)`` that
                makes it, such as ``lambda key: gtsam.RangeFactor3(key("point", "A"), …)``. They
                are observations of the kind ``factor`` from then on. Not with a journal.

        Raises:
            InputError: everything that is wrong with the input; nothing has changed then.
        """
        given = Given.of(observations, points, photos, cameras, factors)
        if given.factors and self._journal is not None:
            raise InputError(
                "this adjustment keeps a journal, which cannot hold a factor: register a kind of "
                "observation (register_observation), or do without the journal"
            )
        result = commands.add(self._state, given, self._rules)
        new = records.entities(self._state.ledger.network, result[0].ledger.network, given)
        arrived = result[0].ledger.observations(self._state.ledger.rows.n)
        arrival = self._changed("add", result, new)
        self._copies.add(arrived)
        return arrival

    @one_at_a_time
    def remove(self, ids: str | Iterable[str]) -> Arrival:
        """Take observations out, wherever they are: in the graph, waiting, suspect or rejected.

        What they alone determined waits again, with all observations of it. Suspects and rejected
        observations that fit by now come back, see `factorgraph_adj.incremental.coming_back`.

        Args:
            ids: ids; ``photo/point`` for image points; names such as ``"point P1 x"`` for weighted
                unknowns, which are free without their given values.

        Raises:
            InputError: every id that there is not; nothing has changed then.
        """
        return self._changed("remove", commands.remove(self._state, ids, self._rules))

    @one_at_a_time
    def replace(self, id: str, observation: Observation) -> Arrival:
        """Put a new observation in the place of another, under the same id; it is tested.

        Raises:
            InputError: no such id, or what is wrong with the observation; nothing has changed.
        """
        result = commands.put_in_place(self._state, id, observation, self._rules)
        return self._changed("replace", result)

    @one_at_a_time
    def reweight(self, ids: str | Iterable[str], factor: float) -> Arrival:
        """Multiply the weights of observations by a factor: their σ are divided by its root.

        Suspects and rejected observations are tested anew.

        Args:
            ids: ids of observations; members of correlated groups reweight the group.
            factor: from 1e-12 to 1e12.

        Raises:
            InputError: unknown ids, or a bad factor; nothing has changed then.
        """
        result = commands.reweight(self._state, ids, factor, self._rules)
        return self._changed("reweight", result)

    @one_at_a_time
    def accept(self, ids: str | Iterable[str]) -> Arrival:
        """Put suspects, or rejected observations, in after all.

        Others that fit by now come back, as after `remove`.

        Raises:
            InputError: every id that is neither; nothing has changed then.
        """
        return self._changed("accept", commands.accept(self._state, ids, self._rules))

    @one_at_a_time
    def discard(self, ids: str | Iterable[str]) -> None:
        """Throw suspects out: they count as rejected.

        Raises:
            InputError: every id that is not a suspect; nothing has changed then.
        """
        self._changed("discard", (commands.discard(self._state, ids), Arrival()))

    @one_at_a_time
    def snoop(self, /, **options: Any) -> Snooping:
        """Search the whole network for gross errors, and take out what is found.

        Args:
            options: as those of `factorgraph_adj.snoop`.

        What it takes out is then among ``rejected``; only what is returned has its figures. What
        fits without it comes back, as after `remove`: ``latest`` has the verdicts, while the
        solution that is returned is the one without these.

        Raises:
            InputError: nothing is in the graph.
        """
        chosen = {"alpha": self.alpha, **options}
        there = self.network(), self.solution()
        after, self.latest, found = commands.snooped(self._state, *there, self._rules, chosen)
        if after is not self._state:
            self._changed("snoop", (after, self.latest))
        return found

    @one_at_a_time
    def settle(self) -> None:
        """Iterate to rest: no estimate is further than 1e-6 σ from the batch adjustment's.

        Where rounding hides more than that, as in networks that are hardly determined, it is no
        further than batch adjustments from nearby starts are from one another.
        In a free network the coordinates are then on the inner constraints over all datum points.
        """
        if self._state.system is not None or self.n_waiting:
            self._changed("settle", commands.settle(self._state, self._rules))

    @property
    @one_at_a_time
    def waiting(self) -> tuple[Waiting, ...]:
        """What waits, and what it lacks."""
        return tuple(waiting_of(self._state, self._state.ledger.having("waiting")))

    @one_at_a_time
    def latest_waiting(self, most: int) -> tuple[Waiting, ...]:
        """Return what began to wait last, the latest first: ``most`` units at most."""
        last = self._state.ledger.having("waiting")[-most:]
        return tuple(waiting_of(self._state, last))[::-1][:most]

    @property
    @one_at_a_time
    def n_waiting(self) -> int:
        """Number of observations that wait."""
        return self._state.ledger.count("waiting")

    @property
    @one_at_a_time
    def suspects(self) -> tuple[Verdict, ...]:
        """Observations beyond the critical value that are left out until they are decided on."""
        return tuple(self._state.ledger.verdicts("suspect"))

    @property
    @one_at_a_time
    def rejected(self) -> tuple[Verdict, ...]:
        """Observations that were rejected."""
        return tuple(self._state.ledger.verdicts("rejected"))

    @property
    @one_at_a_time
    def doubts(self) -> tuple[str, ...]:
        """Why the result may be wrong: points and photos at the wrong place, and copies.

        The solution tells of the places.
        """
        inside = self._state.ledger.is_accepted
        return (*self._places_in_doubt(), *self._copies.told(inside, lambda ident, _: repr(ident)))

    def _places_in_doubt(self) -> tuple[str, ...]:
        ledger = self._state.ledger
        return (*sides.doubts(ledger), *contradicted_photos.doubts(ledger))

    @one_at_a_time
    def network(self) -> Network:
        """Return the network as it stands: what is in the graph, to save or to adjust in batch.

        Approximate values that were found stand in it as given ones.
        """
        return known_network(self._state.ledger, self._state.system)

    @one_at_a_time
    def solution(self) -> Solution:
        """Return the solution: the same as that of the batch adjustment.

        Raises:
            InputError: nothing is in the graph.
        """
        if self._state.system is None:
            raise InputError("nothing is determined yet: there is no solution")
        if self._solution is None or self._solution[0] is not self._state:
            found = solution_of(self._state.ledger, self._state.system, self._rules)
            told = (*found.second_places, *self._places_in_doubt())
            self._solution = self._state, replace(found, second_places=told)
        return self._solution[1]

    @one_at_a_time
    def reliability(self, *, alpha: float | None = None, power: float = 0.80) -> Reliability:
        """Return the reliability of every observation, linearised where everything is by now.

        Raises:
            InputError: a bad probability, or nothing is in the graph.
            AdjustmentError: the network is too weak for it.
        """
        chosen = self.alpha if alpha is None else alpha
        check_probabilities(chosen, power)
        return reliability(self.solution(), alpha=chosen, power=power)

    @one_at_a_time
    def estimate(self, name: str) -> Array:
        """Return the coordinates of a point, (3,) metres.

        In a free network they belong to the inner constraints, which takes a whole solution.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        return points.estimate(self._state, name, self.solution)

    @one_at_a_time
    def covariance(self, a: str, b: str | None = None) -> Array:
        """Return the covariance of a point, or between two points, (3, 3) metres²; σ0 = 1.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        return points.covariance(self._state, a, a if b is None else b, self.solution)

    @one_at_a_time
    def standard_deviations(self, name: str) -> Array:
        """Return the standard deviations of a point, (3,) metres."""
        return np.sqrt(np.maximum(np.diag(self.covariance(name)), 0.0))

    @one_at_a_time
    def pose(self, photo: str) -> PoseEstimate:
        """Return the exterior orientation of a photo, as `Solution.pose`."""
        return points.pose(self._state, photo, self.solution)

    @one_at_a_time
    def calibration(self, camera: str) -> CalibrationEstimate:
        """Return the calibration of a camera, as `Solution.calibration`."""
        return self.solution().calibration(camera)

    @one_at_a_time
    def observation(self, id: str) -> Observation:
        """Return an observation by its id: in the graph, waiting, suspect or rejected.

        Raises:
            InputError: no such id.
        """
        return self._state.ledger.observation(id)

    @property
    @one_at_a_time
    def described(self) -> Network:
        """Everything that was described, with the observations in the graph; not to be changed."""
        return self._state.ledger.described

    @one_at_a_time
    def determined(self, name: str) -> bool:
        """Return whether a point is determined."""
        return self._state.system is not None and self._state.system.known("point", name)

    @property
    @one_at_a_time
    def n_observations(self) -> int:
        """Number of scalar rows in the graph, weighted unknowns among them."""
        system = self._state.system
        if system is None:
            return 0
        return self.solution().n_observations if system.doubt else system.n_rows

    @property
    @one_at_a_time
    def redundancy(self) -> int:
        """Redundancy of the network as it stands."""
        system = self._state.system
        if system is None:
            return 0
        return self.solution().redundancy if system.doubt else system.redundancy

    @property
    @one_at_a_time
    def vtpv(self) -> float:
        """VᵀPv, of the linear forms."""
        return 0.0 if self._state.system is None else self._state.system.vtpv

    @property
    @one_at_a_time
    def sigma0(self) -> float:
        """Standard deviation of unit weight √(vᵀPv/r); NaN without redundancy."""
        r = self.redundancy
        return float(np.sqrt(self.vtpv / r)) if r > 0 else np.nan

    @property
    @one_at_a_time
    def settled(self) -> bool:
        """Whether nothing has changed since it was at rest."""
        return self._state.settled

    @one_at_a_time
    def __len__(self) -> int:
        """Return the number of observations in the graph."""
        return self._state.ledger.count("accepted")

    @one_at_a_time
    def __repr__(self) -> str:
        """Say what is in the graph, and what is not."""
        return (
            f"<IncrementalAdjustment of {self._state.ledger.network.name!r}: {len(self)} "
            f"observations, redundancy {self.redundancy}, {self.n_waiting} waiting, "
            f"{len(self.suspects)} suspects, {len(self.rejected)} rejected"
            f"{''.join(f', BUT {doubt}' for doubt in self.doubts)}>"
        )
