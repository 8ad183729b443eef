"""What an incremental adjustment says of itself at any time."""

from __future__ import annotations

from dataclasses import replace
from threading import RLock
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..errors import InputError, Problem
from ..models.variables import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import Observation
from ..quality.reliability import Reliability, check_probabilities, reliability
from ..solve.estimates import CalibrationEstimate, PoseEstimate
from ..solve.solution import Solution
from ..types import Array
from ..validate.preliminary.copied_blocks import CopiedBlocks
from . import contradicted_photos, points, retirement, sides
from .archive import LastEstimate
from .arrival import Waiting, waiting_of
from .flow import State
from .in_tree import InTree
from .one_at_a_time import one_at_a_time
from .rebasing import known_network, solution_of
from .retired import Retired
from .rules import Rules
from .verdicts import Verdict

if TYPE_CHECKING:
    import gtsam


class Results:
    """What an adjustment says of what has arrived, and of what it comes to."""

    _lock: RLock
    _rules: Rules
    _state: State
    _solution: tuple[State, Solution] | None
    _copies: CopiedBlocks
    _next_try: int = 0
    _not_retired: str = ""

    @property
    @one_at_a_time
    def retired(self) -> Retired | None:
        """What was retired; none: nothing was, or everything was taken back."""
        return self._state.ledger.retired

    @one_at_a_time
    def last_estimate(self, name: str, *, kind: VariableKind = "point") -> LastEstimate:
        """Return what was known of a point, or another unknown, when it was retired.

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
        copied = self._copies.told(inside, lambda ident, _: repr(ident))
        return (*self._places_in_doubt(), *self._doubts_of_retired(), *copied)

    def _doubts_of_retired(self) -> tuple[str, ...]:
        """Say where linear rows do not hold, and where something could not be retired."""
        why = [self._not_retired] if self._not_retired else []
        if told := retirement.doubt(self._state, self._rules):
            why.append(told)
        return tuple(why)

    def _places_in_doubt(self) -> tuple[str, ...]:
        ledger = self._state.ledger
        return (*sides.doubts(ledger), *contradicted_photos.doubts(ledger))

    @one_at_a_time
    def network(self) -> Network:
        """Return the network as it stands: what is in the graph, to save or to adjust in batch.

        Approximate values that were found stand in it as given ones. What was retired is in it,
        too, which takes the memory of all that there has been.
        """
        if self._state.ledger.retired is not None:
            return retirement.whole_network(self._state)
        return known_network(self._state.ledger, self._state.system)

    @one_at_a_time
    def solution(self) -> Solution:
        """Return the solution: the same as that of the batch adjustment.

        What was retired is not in it but for the linear rows in its place, which count as rows of
        a factor; its ``network`` alone is not that of the whole adjustment.

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
        chosen = self._rules.alpha if alpha is None else alpha
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
        """Number of scalar rows in the graph, weighted unknowns among them.

        Rows that were retired count less the unknowns that they determined.
        """
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

    @property
    @one_at_a_time
    def engine(self) -> Literal["isam2", "fronts"]:
        """What carries the network now: iSAM2, or fronts."""
        return "isam2" if isinstance(self._state.system, InTree) else "fronts"

    @property
    @one_at_a_time
    def isam(self) -> gtsam.ISAM2:
        """A copy of the live iSAM2: linear factors of whitened rows on movements δ of variables.

        Covariances are those of σ0 = 1. For the nonlinear graph see `factorgraph_adj.build_graph`
        and `factorgraph_adj.Isam`.

        Raises:
            InputError: fronts carry the network, see `engine`.
        """
        if not isinstance(self._state.system, InTree):
            raise InputError(
                "fronts carry this network, and no iSAM2: engine='isam2' lets iSAM2 do it where "
                "nothing is free and few image points are there; fga.Isam takes any network"
            )
        return self._state.system.tree.copied()

    @one_at_a_time
    def __repr__(self) -> str:
        """Say what is in the graph, and what is not."""
        return (
            f"<IncrementalAdjustment of {self._state.ledger.network.name!r}: {len(self)} "
            f"observations, redundancy {self.redundancy}, {self.n_waiting} waiting, "
            f"{len(self.suspects)} suspects, {len(self.rejected)} rejected, "
            f"{'iSAM2' if self.engine == 'isam2' else 'fronts'}"
            f"{f'; {self.retired}' if self.retired else ''}"
            f"{''.join(f', BUT {doubt}' for doubt in self.doubts)}>"
        )
