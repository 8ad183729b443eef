"""A network in GTSAM's iSAM2: its factors arrive, are tested by the update itself, and leave.

This is for those who come from GTSAM and want its own objects beside the network.
`IncrementalAdjustment` decides what waits, what is suspect and what comes back; here nothing is
decided, and native factors go straight in.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from ..approximate import approximate
from ..block_orientation.begin import start_of
from ..errors import AdjustmentError, InputError, Problem, known
from ..graph.equations import Equations, compile_network
from ..graph.factors import Part, held_factor, observation_factor
from ..graph.keys import KeyMap, insert, state_of
from ..graph.made import MakesFactor, made
from ..graph.variables import State, Unknowns
from ..models.variables import VariableKind
from ..network.additions import add_entities
from ..network.entities import Camera, Photo, Point
from ..network.network import DatumChoice, Network
from ..observations import AnyObservation
from ..quality.groups import noncentrality_of_group
from ..quality.leave_out import Tested, critical_t2
from ..quality.reliability import UNCONTROLLED, check_probabilities
from ..solve.linear import LinearisedEquations
from ..types import Array, Index
from .build import held_sigmas, observation_parts, with_eased_ties
from .inner_constraints import inner_constraints

THRESHOLD, SKIP = 0.01, 1
"""Threshold of relinearisation, units of the variables, and updates between two of them: with these
estimates are within about 10⁻³ σ of the batch at any time, with GTSAM's 0.1 and 10 within 0.3 σ."""
MOST_TURNS = 30
"""Largest number of relinearisations of `Isam.settle`."""
MOST_WEIGHTS = 5
"""Largest number of times that weights follow the lengths of sights there."""
AT_REST = 1e-12
"""Decrease of ½ vᵀPv, relative to 1 + ½ vᵀPv, below which `Isam.settle` ends."""


@dataclass(frozen=True, eq=False)
class FactorTests:
    """Tests of n factors with k whitened rows, each factor against everything else."""

    names: tuple[str, ...]
    """Names of the factors."""
    t2: Array
    """T² = vᵀ M⁺ v of all rows of a factor, with M = I − A Q Aᵀ, (n,)."""
    dof: Index
    """Its degrees of freedom, the rank of M, (n,)."""
    critical: Array
    """Its critical value, the quantile 1 − α of χ², (n,); NaN where nothing else controls it."""
    rows: tuple[Index, ...]
    """Rows of each factor."""
    w: Array
    """Test values v / √M_ii of the rows, (k,); NaN where nothing else controls them."""
    redundancy_numbers: Array
    """M_ii, (k,)."""
    mdb: Array
    """Smallest detectable errors δ0 / √M_ii of the rows, in their σ, (k,); infinite where nothing
    else controls them."""

    @property
    def suspects(self) -> tuple[str, ...]:
        """Names of the factors beyond their critical values, the worst first."""
        ratio = np.nan_to_num(self.t2 / self.critical)
        return tuple(self.names[i] for i in np.argsort(-ratio).tolist() if ratio[i] > 1.0)


class Isam:
    """A network in GTSAM's iSAM2.

    Example:
        >>> import factorgraph_adj as fga
        >>> from factorgraph_adj.observations import SlopeDistance
        >>> net = fga.Network("two distances")
        >>> net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        >>> net.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
        >>> net.add(SlopeDistance("A", "B", 10.002, sigma=0.002, id="first"))
        >>> isam = fga.Isam(net)
        >>> names = isam.add(SlopeDistance("A", "B", 10.012, sigma=0.002, id="second"))
        >>> isam.test(names).suspects
        ('second',)
        >>> isam.remove(names)
        >>> round(float(isam.covariance("point", "B")[0, 0] ** 0.5), 6)
        0.002
    """

    def __init__(
        self,
        network: Network,
        *,
        datum: DatumChoice | None = None,
        params: gtsam.ISAM2Params | None = None,
    ) -> None:
        """Put the factors of a network into iSAM2; the network is copied.

        Args:
            network: the network; what it has must determine all of its unknowns.
            datum: given or free; by default that of the network. A free network has the inner
                constraints over the datum points that it has now.
            params: parameters of iSAM2; by default a relinearisation threshold of 0.01 at each
                update.

        Raises:
            InputError: the network has nothing to adjust, or bad geometry.
            ApproximationError: start values are missing and cannot be found.
            AdjustmentError: its unknowns are not determined.
        """
        if params is None:
            params = gtsam.ISAM2Params()
            params.setRelinearizeThreshold(THRESHOLD)
            params.relinearizeSkip = SKIP
            params.findUnusedFactorSlots = True
        self.isam = gtsam.ISAM2(params)
        """GTSAM's object: yours to ask, and to update with factors of your own."""
        self.network = network.copy()
        """The network with all that has arrived."""
        self._factors: dict[str, gtsam.NonlinearFactor] = {}
        self._slots: dict[str, int] = {}
        self._numbers: dict[VariableKind, dict[str, int]] = {}
        self._since: tuple[gtsam.NonlinearFactorGraph, gtsam.Values] = (
            gtsam.NonlinearFactorGraph(),
            gtsam.Values(),
        )
        equations = compile_network(self.network)
        chosen = network.datum if datum is None else datum
        start = start_of(equations, chosen, None)
        system = LinearisedEquations(equations.weighted_at(start.state), start.state)
        self._equations = system.equations
        more = {}
        if chosen == "free":
            self._number(equations.unknowns)
            constraints = inner_constraints(system, system.diagonal(), start.origin, self.keys)
            if constraints is not None:
                more["inner constraints"] = constraints
        self._take(self.network, system, more)

    # -- what there is ------------------------------------------------------------------------

    @property
    def graph(self) -> gtsam.NonlinearFactorGraph:
        """The factors in iSAM2, those of your own among them."""
        return self.isam.getFactorsUnsafe()

    @property
    def values(self) -> gtsam.Values:
        """The estimate."""
        return self.isam.calculateEstimate()

    @property
    def state(self) -> State:
        """The estimate in arrays by kind, in the order of ``keys.unknowns``."""
        return state_of(self._equations, self.values, self.keys)

    @property
    def keys(self) -> KeyMap:
        """Names ↔ keys: a variable keeps its key while the network grows."""
        return KeyMap(self._equations.unknowns, self._numbers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the factors: ids of observations, and names of your own factors."""
        return tuple(self._slots)

    def __len__(self) -> int:
        """Return the number of factors with a name."""
        return len(self._slots)

    def __repr__(self) -> str:
        """Return what it holds."""
        return (
            f"<Isam of {self.network.name!r}: {len(self)} factors, "
            f"{self.isam.getLinearizationPoint().size()} variables>"
        )

    def covariance(self, kind: VariableKind, name: str) -> Array:
        """Return the covariance of a variable as `Solution` has it, see `KeyMap.covariance`.

        Raises:
            InputError: the network has no such variable, or it is held altogether.
        """
        keys = self.keys
        marginal = self.isam.marginalCovariance(keys.key(kind, name))
        return keys.covariance(kind, name, marginal, self.values)

    # -- what comes and goes ------------------------------------------------------------------

    def add(
        self,
        observations: AnyObservation | Sequence[AnyObservation] = (),
        *,
        points: Iterable[Point] = (),
        photos: Iterable[Photo] = (),
        cameras: Iterable[Camera] = (),
        factors: Mapping[str, MakesFactor] | None = None,
    ) -> tuple[str, ...]:
        """Put observations and factors in with one update; return the names of their factors.

        Nothing is tested before, and nothing has changed where an error is raised.

        Args:
            observations: one or many; what they depend on must then be determined.
            points: new points.
            photos: new photos.
            cameras: new cameras.
            factors: GTSAM factors by name, each as a function of ``key(kind, name)``.

        Raises:
            InputError: everything that is wrong with the input.
            ApproximationError: new unknowns have no start values.
            AdjustmentError: something is not determined with them.
        """
        network = self.network.copy()
        problems = add_entities(
            network, points=tuple(points), photos=tuple(photos), cameras=tuple(cameras)
        )
        if problems:
            raise InputError(problems)
        given = observations if isinstance(observations, Sequence) else (observations,)
        network.add(*given)
        equations = compile_network(network)
        unknowns = equations.unknowns
        here = self.state
        state = unknowns.carried(unknowns.start(), self._equations.unknowns, here)
        if any(np.isnan(x).any() for x in state.values()):
            placed = _with_start(equations, state)
            state = approximate(placed)
        system = LinearisedEquations(equations.weighted_at(state), state)
        before = self._equations, dict(self._slots)
        self._equations = system.equations
        try:
            self._number(unknowns)
            made_ones = {n: made(n, make, self.keys) for n, make in (factors or {}).items()}
            return self._take(network, system, made_ones)
        except BaseException:
            self._equations, self._slots = before
            raise

    def remove(self, names: str | Iterable[str]) -> None:
        """Take factors out, and the variables that no factor depends on any more.

        Raises:
            InputError: every name that there is not; nothing has changed then.
            AdjustmentError: something would not be determined without them.
        """
        wanted = self._known(names)
        copy = gtsam.ISAM2(self.isam)
        self._update(copy, gtsam.NonlinearFactorGraph(), gtsam.Values(), wanted)
        self.isam = copy
        for name in wanted:
            del self._slots[name], self._factors[name]

    def settle(self) -> int:
        """Relinearise everything until nothing moves; return the number of updates.

        Standard deviations that depend on the lengths of sights follow.
        """
        turns = self._relinearise()
        for _ in range(MOST_WEIGHTS):
            if not self._reweigh():
                break
            turns += self._relinearise()
        return turns

    def _relinearise(self) -> int:
        force = gtsam.ISAM2UpdateParams()
        force.force_relinearize = True
        force.forceFullSolve = True
        before = np.inf
        for turn in range(1, MOST_TURNS + 1):
            self.isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), force)
            now = self.graph.error(self.isam.calculateBestEstimate())
            if abs(before - now) <= AT_REST * (1.0 + now):
                return turn
            before = now
        return MOST_TURNS

    def _reweigh(self) -> bool:
        """Replace factors whose weights have changed with the lengths of sights."""
        state, keys = self.state, self.keys
        equations = self._equations.weighted_at(state)
        if equations.weighs_as(self._equations):
            return False
        system = LinearisedEquations(equations, state)
        diagonal = system.diagonal()
        old = {name: parts for name, parts, _ in observation_parts(self._equations)}
        changed: dict[str, gtsam.NonlinearFactor] = {}
        for name, parts, noise in observation_parts(with_eased_ties(equations, system, diagonal)):
            if name in self._slots and not _weigh_alike(parts, old[name]):
                changed[name] = observation_factor(
                    self.network.frame, equations.unknowns, state, parts, noise(), keys
                )
        graph = gtsam.NonlinearFactorGraph()
        for factor in changed.values():
            graph.push_back(factor)
        copy = gtsam.ISAM2(self.isam)
        slots = self._update(copy, graph, gtsam.Values(), list(changed))
        self.isam, self._equations = copy, equations
        self._slots |= dict(zip(changed, slots, strict=True))
        self._factors |= changed
        return True

    def new_factors(self) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Return factors and start values that came since the last call, for a solver of yours.

        Keys stay the same, so that they may go into another ISAM2, a fixed-lag smoother or a batch
        optimiser as they come.
        """
        out, self._since = self._since, (gtsam.NonlinearFactorGraph(), gtsam.Values())
        return out

    # -- tests --------------------------------------------------------------------------------

    def test(
        self, names: str | Iterable[str] | None = None, *, alpha: float = 0.001, power: float = 0.8
    ) -> FactorTests:
        """Test factors, each against everything else, the others among them in.

        iSAM2 has the variables of what came last at its root, so that their joint covariance Q is
        cheap after the update. With whitened residuals v and partials A at the estimate,

            M = I − A Q Aᵀ,   T² = vᵀ M⁺ v,   w_i = v_i/√M_ii,   r_i = M_ii,

        the figures of the innovation test before they came.

        Args:
            names: factors that came together or touch few variables; none: all.
            alpha: probability of a false alarm of one test.
            power: of the smallest detectable errors.

        Raises:
            InputError: every name that there is not, or a bad probability.
        """
        check_probabilities(alpha, power)
        wanted = self._known(self.names if names is None else names)
        values = self.values
        own_keys = {n: list(self._factors[n].keys()) for n in wanted}
        keys = list(dict.fromkeys(k for own in own_keys.values() for k in own))
        first = dict(zip(keys, _starts(values, keys), strict=True))
        a, v, rows, at = [], [], [], 0
        size = sum(_size(values, k) for k in keys)
        for name in wanted:
            part, b = gtsam.JacobianFactor(self._factors[name].linearize(values)).jacobian()
            wide = np.zeros((len(b), size))
            column = 0
            for key in own_keys[name]:
                own = _size(values, key)
                wide[:, first[key] : first[key] + own] += part[:, column : column + own]
                column += own
            a.append(wide)
            v.append(-np.asarray(b))
            rows.append(np.arange(at, at + len(b)))
            at += len(b)
        q = self.isam.jointMarginalCovariance(keys).fullMatrix()
        every = np.vstack(a)
        m = np.eye(at) - every @ q @ every.T
        residual = np.concatenate(v)
        tested = Tested(rows, residual, lambda u: m[:, u])
        t2, dof = tested.statistics()
        r = np.diag(m)
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(np.where(r > UNCONTROLLED, r, np.nan))
            w, mdb = residual / root, np.sqrt(noncentrality_of_group(alpha, power, 1)) / root
        critical = np.array([critical_t2(alpha, int(k)) for k in dof])
        return FactorTests(
            tuple(wanted), t2, dof, critical, tuple(rows), w, r, np.nan_to_num(mdb, nan=np.inf)
        )

    # -- helpers ------------------------------------------------------------------------------

    def _known(self, names: str | Iterable[str]) -> list[str]:
        wanted = list(dict.fromkeys([names] if isinstance(names, str) else names))
        missing = [n for n in wanted if n not in self._slots]
        if missing:
            raise InputError(
                [
                    Problem(f"is no factor here; known: {known(self._slots, meant=n)}", repr(n))
                    for n in missing
                ]
            )
        return wanted

    def _number(self, unknowns: Unknowns) -> None:
        """Give numbers to new variables; those that were there keep theirs."""
        for kind, table in unknowns.tables.items():
            numbers = self._numbers.setdefault(kind, {})
            for name in table.names:
                numbers.setdefault(name, len(numbers))

    def _take(
        self,
        network: Network,
        system: LinearisedEquations,
        more: Mapping[str, gtsam.NonlinearFactor],
    ) -> tuple[str, ...]:
        """Put what is new in; return its names."""
        equations, state = system.equations, system.state
        unknowns, diagonal = equations.unknowns, system.diagonal()
        self._number(unknowns)
        keys = self.keys
        added: dict[str, gtsam.NonlinearFactor] = {}
        for name, part, noise in observation_parts(with_eased_ties(equations, system, diagonal)):
            if name not in self._slots:
                added[name] = observation_factor(
                    network.frame, unknowns, state, part, noise(), keys
                )
        for (kind, number), sigma in held_sigmas(unknowns, diagonal).items():
            name = f"held components of {kind} {unknowns[kind].names[number]}"
            if name not in self._slots:
                added[name] = held_factor(unknowns, state, kind, number, sigma, keys)
        added |= more
        there = self.isam.getLinearizationPoint()
        new = [v for v in unknowns.active() if not there.exists(keys.at(*v))]
        touched = {k for f in added.values() for k in list(f.keys())}
        new = [v for v in new if keys.at(*v) in touched]
        values = gtsam.Values()
        insert(values, unknowns, state, new, [keys.at(*v) for v in new])
        graph = gtsam.NonlinearFactorGraph()
        for factor in added.values():
            graph.push_back(factor)
        copy = gtsam.ISAM2(self.isam)
        slots = self._update(copy, graph, values, ())
        self.isam, self.network = copy, network
        self._slots |= dict(zip(added, slots, strict=True))
        self._factors |= added
        for factor in added.values():
            self._since[0].push_back(factor)
        self._since[1].insert(values)
        return tuple(added)

    def _update(
        self,
        isam: gtsam.ISAM2,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        gone: Sequence[str],
    ) -> list[int]:
        """Update a copy of iSAM2, which an error leaves without a tree."""
        try:
            result = isam.update(graph, values, [self._slots[n] for n in gone])
        except RuntimeError as error:
            what = str(error).strip().splitlines()
            raise AdjustmentError(
                f"iSAM2 reached no solution: {' '.join(what[:2])}: something is not determined"
            ) from error
        return list(result.getNewFactorsIndices())


def _weigh_alike(a: Sequence[Part], b: Sequence[Part]) -> bool:
    """Return whether observations have the same standard deviations within 1e-7."""
    return all(
        np.allclose(p.block.sigma[p.chosen], q.block.sigma[q.chosen], rtol=1e-7, atol=0.0)
        for p, q in zip(a, b, strict=True)
    )


def _with_start(equations: Equations, state: State) -> Equations:
    """Return equations whose unknowns start at a state, NaN where unknown."""
    return replace(equations, unknowns=equations.unknowns.starting_at(state))


def _size(values: gtsam.Values, key: int) -> int:
    try:
        return len(values.atVector(key))
    except RuntimeError:
        return 6


def _starts(values: gtsam.Values, keys: Sequence[int]) -> list[int]:
    ends = np.cumsum([_size(values, k) for k in keys], dtype=np.intp)
    return [0, *(int(e) for e in ends[:-1])]
