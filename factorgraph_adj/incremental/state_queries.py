"""Queries of the state: estimates, precision, outcomes, doubts, reliability, network, solution."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from threading import RLock
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..blas_threads import one_at_a_time
from ..constructors import ChecksArguments
from ..entities import Photo, Point
from ..errors import InputError, Problem, unknown_name
from ..graph.dependence import Variable
from ..ledger.command_input import Options
from ..ledger.retired_unknowns import LastEstimate, Retired
from ..ledger.verdicts import Verdict
from ..linear_system import engines
from ..linear_system.rebase import known_network, solution_of
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import Observation
from ..quality.causes.cause_search import Causes
from ..quality.reliability import Reliability, check_probabilities, reliability
from ..quality.snooping import snoop
from ..solve.estimates import CalibrationEstimate, PoseEstimate
from ..solve.solution import Solution
from ..types import Array
from ..validate.repeated_readings import CopiedBlocks
from . import doubts, manual_decisions, nonlinear_tests, readmission, retirement
from .arrival import Waiting, waiting_of
from .worklist import IncrementalState

if TYPE_CHECKING:
    import gtsam


def point_estimate(state: IncrementalState, name: str, solution: Callable[[], Solution]) -> Array:
    """Return the coordinates of a point, (3,) metres.

    Args:
        state: the state.
        name: the point.
        solution: returns the whole solution, which a free network takes.

    Raises:
        InputError: no such point, or it is not determined yet.
    """
    _require(state, name)
    system = state.system
    value = None if system is None else system.value("point", name)
    if value is None:
        return np.array(state.ledger.network.points[name].coordinates)
    free = system is not None and system.is_free
    return solution().point(name) if free else value


def point_covariance(
    state: IncrementalState, a: str, b: str, solution: Callable[[], Solution]
) -> Array:
    """Return the covariance between two points, (3, 3) metres²; σ0 = 1.

    Args:
        state: the state.
        a: a point.
        b: a point; it may be the same.
        solution: returns the whole solution, which a free network takes.

    Raises:
        InputError: no such point, or it is not determined yet.
    """
    for name in (a, b):
        _require(state, name)
    system, out = state.system, np.zeros((3, 3))
    if system is None or not all(system.known("point", n) for n in (a, b)):
        return out
    if system.is_free:
        return solution().covariance(a, b)
    found = system.cofactors(("point", a), ("point", b))
    out[: found.shape[0], : found.shape[1]] = found
    return out


def photo_pose(
    state: IncrementalState, photo: str, solution: Callable[[], Solution]
) -> PoseEstimate:
    """Return the exterior orientation of a photo.

    Args:
        state: the state.
        photo: the photo.
        solution: returns the whole solution, which a free network takes.

    Raises:
        InputError: no such photo, or it is not determined yet.
    """
    _require(state, photo, "pose")
    system = state.system
    stored = None if system is None else system.value("pose", photo)
    if system is None or stored is None or system.is_free:
        return solution().pose(photo)
    of_photo: Variable = ("pose", photo)
    sigmas = np.sqrt(np.maximum(np.diag(system.cofactors(of_photo, of_photo)), 0.0))
    return PoseEstimate(stored[9:].copy(), stored[:9].reshape(3, 3).copy(), sigmas)


def photo_covariance(
    state: IncrementalState, photo: str, solution: Callable[[], Solution]
) -> Array:
    """Return the covariance of a photo, (6, 6); see `photo_pose` for the arguments and errors."""
    _require(state, photo, "pose")
    system = state.system
    of_photo: Variable = ("pose", photo)
    if system is None or system.value(*of_photo) is None or system.is_free:
        return solution().pose_covariance(photo)
    return system.cofactors(of_photo, of_photo)


def _require(state: IncrementalState, name: str, kind: Literal["point", "pose"] = "point") -> None:
    """Refuse a point, or a photo, that is not there, or not determined."""
    network, system = state.ledger.network, state.system
    described: Mapping[str, Point | Photo]
    noun, described = ("point", network.points) if kind == "point" else ("photo", network.photos)
    retired = state.ledger.retired
    if (
        name not in described
        and retired is not None
        and (message := retired.retirement_note((kind, name)))
    ):
        argument = f", kind={kind!r}" if kind == "pose" else ""
        what = f"{message}, and last_estimate({name!r}{argument})"
        raise InputError(Problem(f"{what} returns what was known of it then", f"{noun} {name!r}"))
    if name not in described:
        text = unknown_name(noun, name, described)
        raise InputError(text)
    if (system is None or not system.known(kind, name)) and not all(described[name].fixed):
        lacks = state.ledger.lacks.get((kind, name), "no observation has determined it yet")
        raise InputError(Problem(f"is not determined: {lacks}", f"{noun} {name!r}"))


class StateQueries(metaclass=ChecksArguments):
    """Queries of an adjustment: what has arrived, and the results."""

    _lock: RLock
    _rules: Options
    _state: IncrementalState
    _solution: tuple[IncrementalState, Solution] | None
    _copies: CopiedBlocks
    _next_try: float = 0.0
    _not_retired: str = ""
    _suspects_doubts: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    """Ids of suspects, and the doubts about them; None: a command has changed the network."""

    @property
    @one_at_a_time
    def retired(self) -> Retired | None:
        """What was retired; None: nothing was, or everything was taken back."""
        return self._state.ledger.retired

    @one_at_a_time
    def last_estimate(self, name: str, *, kind: VariableKind = "point") -> LastEstimate:
        """Return the estimate of a point, or another unknown, at its retirement.

        Raises:
            InputError: it was not retired.
        """
        retired = self._state.ledger.retired
        found = None if retired is None else retired.last_estimate((kind, name))
        if found is None:
            noun = UNKNOWNS[kind].noun if kind in UNKNOWNS else kind
            raise InputError(Problem("was not retired", f"{noun} {name!r}"))
        return found

    @property
    @one_at_a_time
    def waiting(self) -> tuple[Waiting, ...]:
        """Waiting observations, with what they lack."""
        return tuple(waiting_of(self._state, self._state.ledger.having("waiting")))

    @one_at_a_time
    def latest_waiting(self, most: int) -> tuple[Waiting, ...]:
        """Return the latest waiting observations, the last one first: up to ``most`` units."""
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
        """Observations beyond the critical value that are left out until a decision on them."""
        return tuple(self._state.ledger.verdicts("suspect"))

    @property
    @one_at_a_time
    def rejected(self) -> tuple[Verdict, ...]:
        """Observations that were rejected."""
        return tuple(self._state.ledger.verdicts("rejected"))

    @property
    @one_at_a_time
    def decided(self) -> frozenset[str]:
        """Ids of observations that were accepted or discarded by hand; `revoke` takes that back."""
        return manual_decisions.decided(self._state.ledger)

    @one_at_a_time
    def with_groups(self, ids: Iterable[str]) -> tuple[str, ...]:
        """Return ids of observations with those of their correlated groups."""
        ledger = self._state.ledger
        return tuple(ledger.ids_of(ledger.find(ids)))

    @one_at_a_time
    def tested_now(self) -> tuple[Verdict, ...]:
        """Return verdicts on suspects and rejected observations with tests against all others.

        Those of `suspects` and `rejected` are of the time when they were made, and those after
        `snoop` have none. Nothing changes.
        """
        return tuple(readmission.tested_now(self._state, self._rules))

    @property
    @one_at_a_time
    def doubts(self) -> tuple[str, ...]:
        """Why the result may be wrong: no minimum, agreeing suspects, wrong positions, copies.

        The solution names the positions, and ``converged`` says whether there is a minimum.
        """
        inside = self._state.ledger.is_accepted
        copied = self._copies.told(inside, lambda ident, _: repr(ident))
        minimum = doubts.minimum_doubts(self._state, self._rules)
        found = (*minimum, *self._doubts_of_suspects(), *self._places_in_doubt())
        return (*found, *self._doubts_of_retired(), *copied)

    def _doubts_of_suspects(self) -> tuple[str, ...]:
        """Return what several suspects contradict; computed again when these change."""
        ids = tuple(v.id for v in self.suspects)
        if self._suspects_doubts is None or self._suspects_doubts[0] != ids:
            self._suspects_doubts = ids, doubts.suspects_doubts(self._state, self._rules)
        return self._suspects_doubts[1]

    @property
    @one_at_a_time
    def missed_step(self) -> float:
        """Bound, to second order, of the deviation of the linear rows of all retired observations.

        No estimate is further from its value with everything in the graph, relative to its σ; see
        `solve.marginalisation`. Infinite where it is not known.

        Raises:
            AdjustmentError: there is no minimum.
        """
        return retirement.missed_step(self._state)

    def _doubts_of_retired(self) -> tuple[str, ...]:
        """Return where linear rows do not hold, and what could not be retired."""
        why = [self._not_retired] if self._not_retired else []
        if message := retirement.doubt(self._state, self._rules):
            why.append(message)
        return tuple(why)

    def _places_in_doubt(self) -> tuple[str, ...]:
        ledger = self._state.ledger
        return (*nonlinear_tests.side_doubts(ledger), *doubts.photo_doubts(ledger))

    @one_at_a_time
    def network(self) -> Network:
        """Return the network as it is: observations in the graph, to save or to adjust in batch.

        Computed approximate values are given ones in it. Everything retired is in it, too, which
        takes the memory of all observations that there have been.
        """
        if self._state.ledger.retired is not None:
            return retirement.whole_network(self._state)
        return known_network(self._state.ledger, self._state.system)

    @one_at_a_time
    def solution(self) -> Solution:
        """Return the solution: the same as that of the batch adjustment.

        Retired observations are not in it except as linear rows, which count as rows of a factor;
        its ``network`` alone is not that of the whole adjustment.

        Raises:
            InputError: nothing is in the graph.
        """
        if self._state.system is None:
            raise InputError("nothing is determined yet: there is no solution")
        if self._solution is None or self._solution[0] is not self._state:
            found = solution_of(self._state.ledger, self._state.system, self._rules)
            places = (*found.second_places, *self._places_in_doubt())
            self._solution = self._state, replace(found, second_places=places)
        return self._solution[1]

    @one_at_a_time
    def reliability(self, *, alpha: float | None = None, power: float = 0.80) -> Reliability:
        """Return the reliability of every observation, linearised at the present estimates.

        Raises:
            InputError: a bad probability, or nothing is in the graph.
            AdjustmentError: the network is too weak for it.
        """
        chosen = self._rules.alpha if alpha is None else alpha
        check_probabilities(chosen, power)
        return reliability(self.solution(), alpha=chosen, power=power)

    @one_at_a_time
    def causes(self, *, alpha: float | None = None) -> Causes | None:
        """Search for causes that several observations share, such as a wrong instrument height.

        Everything is examined in batch, as by `factorgraph_adj.snoop`: accepted observations,
        suspects, and rejected ones that may be readmitted; it takes several adjustments. Nothing
        changes.

        Args:
            alpha: probability of a false alarm of one test; None: that of this adjustment.

        Returns:
            The causes, the most probable first (``most_probable`` explains more than single
            readings and all others); None where there is no misfit.

        Raises:
            InputError: nothing is in the graph; something was retired.
            AdjustmentError: errors of `factorgraph_adj.snoop`.
        """
        if self.retired is not None:
            raise InputError("a search for causes needs all observations: settle(all=True) first")
        if self._state.system is None:
            raise InputError("nothing is determined yet: there are no causes of misfits")
        network = readmission.with_what_was_left_out(self._state)
        return snoop(network, alpha=self._rules.alpha if alpha is None else alpha).causes

    @one_at_a_time
    def estimate(self, name: str) -> Array:
        """Return the coordinates of a point, (3,) metres.

        In a free network they refer to the inner constraints, for which the whole is solved.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        return point_estimate(self._state, name, self.solution)

    @one_at_a_time
    def covariance(self, a: str, b: str | None = None) -> Array:
        """Return the covariance of a point, or between two points, (3, 3) metres²; σ0 = 1.

        Raises:
            InputError: no such point, or it is not determined yet.
        """
        return point_covariance(self._state, a, a if b is None else b, self.solution)

    @one_at_a_time
    def standard_deviations(self, name: str) -> Array:
        """Return the standard deviations of a point, (3,) metres."""
        return np.sqrt(np.maximum(np.diag(self.covariance(name)), 0.0))

    @one_at_a_time
    def pose(self, photo: str) -> PoseEstimate:
        """Return the exterior orientation of a photo, as `Solution.pose`."""
        return photo_pose(self._state, photo, self.solution)

    @one_at_a_time
    def pose_covariance(self, photo: str) -> Array:
        """Return the covariance of a photo, (6, 6), as `Solution.pose_covariance`; σ0 = 1.

        Raises:
            InputError: no such photo, or it is not determined yet.
        """
        return photo_covariance(self._state, photo, self.solution)

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
        """The network as described, with the observations in the graph; not to be changed."""
        return self._state.ledger.described

    @property
    @one_at_a_time
    def entities(self) -> Network:
        """Points, photos, cameras and unknowns as described, without observations; not to change.

        It costs nothing, while ``described`` goes through all observations after each arrival.
        """
        return self._state.ledger.network

    @one_at_a_time
    def determined(self, name: str) -> bool:
        """Return whether a point is determined."""
        return self._state.system is not None and self._state.system.known("point", name)

    @property
    @one_at_a_time
    def n_observations(self) -> int:
        """Number of scalar rows in the graph, weighted unknowns among them.

        Rows that were retired count, minus the unknowns that they determined.
        """
        system = self._state.system
        if system is None:
            return 0
        return self.solution().n_observations if system.doubt else system.n_rows

    @property
    @one_at_a_time
    def redundancy(self) -> int:
        """Redundancy of the network as it is."""
        system = self._state.system
        if system is None:
            return 0
        return self.solution().redundancy if system.doubt else system.redundancy

    @property
    @one_at_a_time
    def vtpv(self) -> float:
        """VᵀPv of the linear forms; without a minimum, of everything in the graph as it is.

        See `doubts`, and ``converged`` and ``reason`` of the solution. Infinite where an
        observation is degenerate there, or its residual has no finite square.
        """
        system = self._state.system
        if system is None:
            return 0.0
        return self.solution().vtpv if system.doubt else system.vtpv

    @property
    @one_at_a_time
    def sigma0(self) -> float:
        """Standard deviation of unit weight √(vᵀPv/r); NaN without redundancy."""
        r = self.redundancy
        return float(np.sqrt(self.vtpv / r)) if r > 0 else np.nan

    @property
    @one_at_a_time
    def settled(self) -> bool:
        """Whether nothing has changed since it converged."""
        return self._state.settled

    @one_at_a_time
    def __len__(self) -> int:
        """Return the number of observations in the graph."""
        return self._state.ledger.count("accepted")

    @property
    @one_at_a_time
    def engine(self) -> Literal["isam2", "fronts"]:
        """Engine that holds the linear system now: iSAM2, or fronts."""
        return "fronts" if self._state.system is None else self._state.system.engine

    @property
    @one_at_a_time
    def isam(self) -> gtsam.ISAM2:
        """A copy of the live iSAM2: linear factors of whitened rows on movements δ of variables.

        Covariances are those of σ0 = 1. For the nonlinear graph see `factorgraph_adj.build_graph`
        and `factorgraph_adj.Isam`.

        Raises:
            InputError: the network is in fronts, see `engine`.
        """
        if (found := engines.copied_isam2(self._state.system)) is None:
            raise InputError(
                "this network is in fronts, not in iSAM2: engine='isam2' takes iSAM2 where "
                "the network is not free and has few image points; fga.Isam takes any network"
            )
        return found

    @one_at_a_time
    def __repr__(self) -> str:
        """Return the numbers of observations in the graph, waiting, suspect and rejected."""
        return (
            f"<IncrementalAdjustment of {self._state.ledger.network.name!r}: {len(self)} "
            f"observations, redundancy {self.redundancy}, {self.n_waiting} waiting, "
            f"{len(self.suspects)} suspects, {len(self.rejected)} rejected, "
            f"{'iSAM2' if self.engine == 'isam2' else 'fronts'}"
            f"{f'; {self.retired}' if self.retired else ''}"
            f"{''.join(f', BUT {doubt}' for doubt in self.doubts)}>"
        )
