"""`Isam`: a network in GTSAM's iSAM2, with factors that enter, are tested and leave.

This is for those who come from GTSAM and want its own objects beside the network.
`IncrementalAdjustment` decides what waits, what is suspect and what comes back; here nothing is
decided, and native factors go straight in.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np

from ..blas_threads import with_one_thread
from ..constructors import ChecksArguments
from ..entities import Camera, Photo, Point
from ..errors import AdjustmentError, InputError, Problem, known
from ..graph.dependence import stated_late, variables_in_both
from ..graph.equations import Equations, compile_network, compile_rows
from ..graph.factors import held_factor, observation_factor
from ..graph.keys import KeyMap, insert, state_of, variable_in_error
from ..graph.observation_selection import without
from ..graph.partials_check import refuse_wrong_partials
from ..graph.user_factors import MakesFactor, made
from ..graph.variables import State, Unknowns
from ..models.unknown_registry import VariableKind
from ..network.additions import UnknownsGiven, add_entities, unknowns_by_kind
from ..network.network import DatumChoice, Network
from ..observations import AnyObservation
from ..orientation.choice_of_start import choose_start
from ..quality.reliability import check_probabilities
from ..solve.linearised_equations import LinearisedEquations
from ..start.approximate_values import approximate
from ..types import Array
from .factor_tests import EnteredFactor, FactorTests, factor_tests, sigmas_of
from .network_graph import held_sigmas, inner_constraints, observation_parts, with_eased_ties

THRESHOLD, SKIP = 0.01, 1
"""Threshold of relinearisation, units of the variables, and updates between two of them: with these
estimates of terrestrial networks are within about 10⁻³ σ of the batch at any time, with GTSAM's 0.1
and 10 within 0.3 σ; poses with σ of a centimetre are within 0.06 σ."""
MAX_RELINEARISATIONS = 30
"""Largest number of relinearisations of `Isam.settle`."""
MAX_WEIGHT_UPDATES = 5
"""Largest number of times that weights follow the lengths of sights there."""
AT_REST = 1e-12
"""Decrease of ½ vᵀPv, relative to 1 + ½ vᵀPv, below which `Isam.settle` ends."""


class Isam(metaclass=ChecksArguments):
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

    @with_one_thread
    def __init__(
        self,
        network: Network,
        *,
        datum: DatumChoice | None = None,
        params: gtsam.ISAM2Params | None = None,
    ) -> None:
        """Put the factors of a network into iSAM2; the network is copied.

        Args:
            network: the network; what it has must determine all of its unknowns. One without
                observations, such as a held pose, is a beginning.
            datum: given or free; by default that of the network. A free network has the inner
                constraints over the datum points that it has now.
            params: parameters of iSAM2; by default a relinearisation threshold of 0.01 at each
                update.

        Raises:
            InputError: the network has nothing to adjust: everything is held, or it is free and has
                no observations; or bad geometry.
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
        self._entered: dict[str, EnteredFactor] = {}
        self._numbers: dict[VariableKind, dict[str, int]] = {}
        self._starts: list[gtsam.Values] = []
        self._handed_out = 0
        chosen = network.datum if datum is None else datum
        empty = not (network.observations or network.n_image_points)
        begin = compile_rows if empty and chosen == "given" else compile_network
        equations = begin(self.network)
        start = choose_start(equations, chosen, None)
        system = LinearisedEquations(equations.weighted_at(start.state), start.state)
        self._equations = system.equations
        more = {}
        if chosen == "free":
            self._number(equations.unknowns)
            constraints = inner_constraints(system, system.diagonal(), start.origin, self.keys)
            if constraints is not None:
                more["inner constraints"] = constraints
        self._take(self.network, system, more)

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
        """The estimate in arrays by kind, in the order of ``keys.unknowns``.

        What no factor depends on has its start values, or its last estimate.
        """
        return state_of(self._equations, self.values, self.keys, partly=True)

    @property
    def keys(self) -> KeyMap:
        """Names ↔ keys: a variable keeps its key while the network grows."""
        return KeyMap(self._equations.unknowns, self._numbers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the factors: ids of observations, and names of your own factors."""
        return tuple(self._entered)

    def __len__(self) -> int:
        """Return the number of factors with a name."""
        return len(self._entered)

    def __repr__(self) -> str:
        """Return what it holds."""
        return (
            f"<Isam of {self.network.name!r}: {len(self)} factors, "
            f"{self.isam.getLinearizationPoint().size()} variables>"
        )

    @with_one_thread
    def covariance(self, kind: VariableKind, name: str) -> Array:
        """Return the covariance of a variable as `Solution` has it, see `KeyMap.covariance`.

        Raises:
            InputError: the network has no such variable, it is held altogether, or no factor
                depends on it.
        """
        keys = self.keys
        key = keys.key(kind, name)
        if not self.isam.getLinearizationPoint().exists(key):
            raise InputError(Problem("no factor depends on it", f"{kind} {name!r}"))
        marginal = self.isam.marginalCovariance(key)
        return keys.covariance(kind, name, marginal, self.values)

    @with_one_thread
    def add(
        self,
        observations: AnyObservation | Sequence[AnyObservation] = (),
        *,
        points: Iterable[Point] = (),
        photos: Iterable[Photo] = (),
        cameras: Iterable[Camera] = (),
        unknowns: UnknownsGiven | None = None,
        factors: Mapping[str, MakesFactor] | None = None,
    ) -> tuple[str, ...]:
        """Put observations and factors in with one update; return the names of their factors.

        Nothing is tested before, and nothing has changed where an error is raised.

        Args:
            observations: one or many; what they depend on must then be determined.
            points: new points.
            photos: new photos.
            cameras: new cameras.
            unknowns: new frames, mounts, shapes and unknowns of any other kind, by kind and name,
                as a scratch network states them: ``unknowns=scratch.parameters``.
            factors: GTSAM factors by name, each as a function of ``key(kind, name)``.

        Raises:
            InputError: everything that is wrong with the input.
            ApproximationError: new unknowns have no start values.
            AdjustmentError: something is not determined with them.
        """
        stated = unknowns_by_kind(unknowns)
        network = self.network.copy()
        problems = add_entities(
            network,
            points=tuple(points),
            photos=tuple(photos),
            cameras=tuple(cameras),
            unknowns=stated,
        )
        problems.extend(stated_late(stated, variables_in_both(self.network, network)))
        if problems:
            raise InputError(problems)
        given = observations if isinstance(observations, Sequence) else (observations,)
        made_here = dict(factors or {})
        ids = network.add(*given)
        taken = [
            n for n in (*ids, *made_here) if n in self._entered or (n in ids and n in made_here)
        ]
        if taken:
            raise InputError([Problem("is the name of another factor", repr(n)) for n in taken])
        equations = compile_network(network)
        here = self.state
        table = equations.unknowns
        state = table.carried(table.start(), self._equations.unknowns, here)
        if any(np.isnan(x).any() for x in state.values()):
            placed = _with_start(equations, state)
            state = approximate(placed)
        system = LinearisedEquations(equations.weighted_at(state), state)
        before = self._equations
        self._equations = system.equations
        try:
            self._number(equations.unknowns)
            made_ones = {n: made(n, make, self.keys) for n, make in made_here.items()}
            refuse_wrong_partials(made_ones, system.equations, system.state, self.keys)
            return self._take(network, system, made_ones)
        except BaseException:
            self._equations = before
            raise

    @with_one_thread
    def remove(self, names: str | Iterable[str]) -> None:
        """Take factors out, and the variables that no factor depends on any more.

        Raises:
            InputError: every name that there is not; nothing has changed then.
            AdjustmentError: something would not be determined without them.
        """
        wanted = dict.fromkeys(self._known(names))
        rest = [e for n, e in self._entered.items() if n not in wanted and e.keeps is None]
        touched = {key for e in rest for key in list(e.factor.keys())}
        wanted |= {
            n: None
            for n, e in self._entered.items()
            if e.keeps is not None and e.keeps not in touched
        }
        gone = [self._entered[n] for n in wanted]
        network = without(self.network, [i for e in gone for i in e.ids])
        equations, here = compile_network(network), self.state
        state = equations.unknowns.carried(
            equations.unknowns.start(), self._equations.unknowns, here
        )
        copy = gtsam.ISAM2(self.isam)
        self._update(copy, gtsam.NonlinearFactorGraph(), gtsam.Values(), gone)
        self.isam, self.network, self._equations = copy, network, _with_start(equations, state)
        for name in wanted:
            del self._entered[name]

    @with_one_thread
    def settle(self) -> int:
        """Relinearise everything until nothing moves; return the number of updates.

        Standard deviations that depend on the lengths of sights follow.
        """
        turns = self._relinearise()
        for _ in range(MAX_WEIGHT_UPDATES):
            if not self._reweigh():
                break
            turns += self._relinearise()
        return turns

    def _relinearise(self) -> int:
        force = gtsam.ISAM2UpdateParams()
        force.force_relinearize = True
        force.forceFullSolve = True
        before = np.inf
        for turn in range(1, MAX_RELINEARISATIONS + 1):
            self.isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), force)
            now = self.graph.error(self.isam.calculateBestEstimate())
            if abs(before - now) <= AT_REST * (1.0 + now):
                return turn
            before = now
        return MAX_RELINEARISATIONS

    def _reweigh(self) -> bool:
        """Replace factors whose weights have changed with the lengths of sights."""
        state, keys = self.state, self.keys
        equations = self._equations.weighted_at(state)
        system = LinearisedEquations(equations, state)
        diagonal = system.diagonal()
        changed: dict[str, EnteredFactor] = {}
        graph = gtsam.NonlinearFactorGraph()
        for name, parts, noise in observation_parts(with_eased_ties(equations, system, diagonal)):
            old = self._entered.get(name)
            if old is not None and not old.weighs_as(parts):
                factor = observation_factor(
                    self.network.frame, equations.unknowns, state, parts, noise(), keys
                )
                graph.push_back(factor)
                changed[name] = replace(old, factor=factor, sigmas=sigmas_of(parts))
        if not changed:
            return False
        copy = gtsam.ISAM2(self.isam)
        gone = [self._entered[n] for n in changed]
        slots = self._update(copy, graph, gtsam.Values(), gone)
        self.isam, self._equations = copy, equations
        self._entered |= {
            name: replace(e, slot=slot)
            for (name, e), slot in zip(changed.items(), slots, strict=True)
        }
        return True

    @property
    def n_arrivals(self) -> int:
        """Number of times that factors have come; the first are those of the network."""
        return len(self._starts)

    def new_factors(
        self, *, since: int | None = None
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Return factors and start values that came since some moment, for a solver of yours.

        Keys stay the same, so that they may go into another ISAM2, a fixed-lag smoother or a batch
        optimiser as they come. What has been removed in the meantime is left out, and weights are
        those of now; a solver that had a factor before keeps it.

        Args:
            since: `n_arrivals` at that moment, 0 for everything; by default at the last call.

        Raises:
            InputError: there was no such moment.
        """
        first = self._handed_out if since is None else since
        if not 0 <= first <= self.n_arrivals:
            raise InputError(f"since must be between 0 and {self.n_arrivals}, not {since}")
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for entered in self._entered.values():
            if entered.arrival >= first:
                graph.push_back(entered.factor)
        there = self.isam.getLinearizationPoint()
        for starts in self._starts[first:]:
            for key in starts.keys():  # noqa: SIM118 - it is no mapping
                if values.exists(key):
                    values.erase(key)
            values.insert(starts)
        for key in [k for k in values.keys() if not there.exists(k)]:  # noqa: SIM118
            values.erase(key)
        self._handed_out = self.n_arrivals
        return graph, values

    @with_one_thread
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
        factors = {n: self._entered[n].factor for n in wanted}
        return factor_tests(
            factors, self.values, self.isam.jointMarginalCovariance, alpha=alpha, power=power
        )

    def _known(self, names: str | Iterable[str]) -> list[str]:
        wanted = list(dict.fromkeys([names] if isinstance(names, str) else names))
        missing = [n for n in wanted if n not in self._entered]
        if missing:
            raise InputError(
                [
                    Problem(f"is no factor here; known: {known(self._entered, meant=n)}", repr(n))
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
        at = self.n_arrivals
        added: dict[str, EnteredFactor] = {}
        for name, part, noise in observation_parts(with_eased_ties(equations, system, diagonal)):
            if name not in self._entered:
                factor = observation_factor(network.frame, unknowns, state, part, noise(), keys)
                ids = dict.fromkeys(p.block.ids[i] for p in part for i in p.chosen.tolist())
                added[name] = EnteredFactor(factor, at, tuple(ids), sigmas_of(part))
        added |= {name: EnteredFactor(factor, at) for name, factor in more.items()}
        touched = {k for e in added.values() for k in list(e.factor.keys())}
        for (kind, number), sigma in held_sigmas(unknowns, diagonal).items():
            name, key = (
                f"held components of {kind} {unknowns[kind].names[number]}",
                keys.at(kind, number),
            )
            if name not in self._entered and key in touched:
                factor = held_factor(unknowns, state, kind, number, sigma, keys)
                added[name] = EnteredFactor(factor, at, keeps=key)
        there = self.isam.getLinearizationPoint()
        new = [
            v for v in unknowns.active() if (k := keys.at(*v)) in touched and not there.exists(k)
        ]
        values = gtsam.Values()
        insert(values, unknowns, state, new, [keys.at(*v) for v in new])
        graph = gtsam.NonlinearFactorGraph()
        for e in added.values():
            graph.push_back(e.factor)
        copy = gtsam.ISAM2(self.isam)
        slots = self._update(copy, graph, values, ())
        self.isam, self.network = copy, network
        self._entered |= {
            name: replace(e, slot=slot)
            for (name, e), slot in zip(added.items(), slots, strict=True)
        }
        self._starts.append(values)
        return tuple(added)

    def _update(
        self,
        isam: gtsam.ISAM2,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        gone: Sequence[EnteredFactor],
    ) -> list[int]:
        """Update a copy of iSAM2, which an error leaves without a tree."""
        try:
            result = isam.update(graph, values, [e.slot for e in gone])
        except RuntimeError as error:
            if where := variable_in_error(error, self._numbers):
                what = f"something is not determined, {where} or what it depends on"
            else:
                what = " ".join(str(error).strip().splitlines()[:2])
            raise AdjustmentError(f"iSAM2 reached no solution: {what}") from error
        return list(result.getNewFactorsIndices())


def _with_start(equations: Equations, state: State) -> Equations:
    """Return equations whose unknowns start at a state, NaN where unknown."""
    return replace(equations, unknowns=equations.unknowns.starting_at(state))
