"""A part in the process that adjusts it: its network, equations, junctions, states, elimination."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import AdjustmentError, ApproximationError, InputError
from ..graph.equations import Equations, compile_network
from ..graph.variables import DEFAULT, State, Unknowns, calibration_name, camera_of_calibration
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..orientation.choice_of_start import choose_start
from ..solve.elimination_layers import layers_of
from ..solve.factorisation import EliminationPlan, Factorisation
from ..solve.normal_equations import NormalEquations, Solver
from ..start.start_values import Start
from ..types import Array, Index, Keys, Mask
from .junctions import (
    IterationState,
    JunctionSetup,
    PartStart,
    PartSurvey,
    SharedVariable,
    Variable,
)
from .part_files import Part, RunFolder, StoredPart, read_setup, write_setup

KEPT_STATES = 12
"""Number of states that are kept: the iteration may end at one of the last ten."""
STAMP_FILE = "stamp"
"""Name under which a finished part says of which run it is."""


@dataclass(frozen=True)
class PartJob:
    """A part of a run."""

    part: Part
    """The part."""
    number: int
    """Its number, from 0."""
    folder: RunFolder
    """The folder of the run."""
    run: str
    """Name of the call of `adjust_parts`; processes keep parts of one call only for it."""

    @property
    def own(self) -> RunFolder:
        """The folder of the part."""
        return self.folder.of_part(self.number)


@dataclass(frozen=True)
class PartElimination:
    """The eliminated interior of a part at one point of the iteration."""

    at: IterationState
    """The point of the iteration."""
    normal: NormalEquations
    """The linearisation."""
    added: Array
    """Terms that damping adds to the diagonal of N, (n_columns,)."""
    factor: Factorisation
    """The factor."""


class LoadedPart:
    """A part that is in memory."""

    last: PartElimination | None = None
    """The last elimination, which a step follows."""
    _weighed: tuple[int, Solver] | None = None

    def __init__(self, job: PartJob) -> None:
        """Read and compile a part.

        Raises:
            InputError: the part cannot be read.
        """
        self.job = job
        self._given: Start | None = None
        if isinstance(job.part.load, StoredPart):
            self.network, self._given = job.part.load.read()
        else:
            self.network = _read(job.part)
        self.whole = compile_network(self.network)

    # -- its variables ------------------------------------------------------------------------

    @property
    def unknowns(self) -> Unknowns:
        """The unknowns."""
        return self.whole.unknowns

    def number(self, variable: Variable) -> int:
        """Return the number of a variable among those of its kind."""
        return self.unknowns[variable.kind].number[variable.name]

    @cached_property
    def keys(self) -> dict[VariableKind, Keys]:
        """A 64-bit number for each variable, by kind.

        A default constant that is not stated and that no observation uses gets one of its own:
        it is no junction, whatever other parts state of theirs.
        """
        out: dict[VariableKind, Keys] = {
            kind: np.array([variable_key(kind, name) for name in table.names], dtype=np.uint64)
            for kind, table in self.unknowns.tables.items()
        }
        for kind, stated in self.network.parameters.items():
            number = self.unknowns[kind].number.get(DEFAULT)
            if number is None or DEFAULT in stated or self._uses(kind, number):
                continue
            out[kind][number] = variable_key(kind, f"unused in part {self.job.number}")
        return out

    def _uses(self, kind: VariableKind, number: int) -> bool:
        """Return whether an observation depends on a variable."""
        return any(
            bool((index == number).any())
            for block in self.whole.blocks
            for k, index in block.variables
            if k == kind
        )

    def surveyed(self) -> PartSurvey:
        """Return what the root has to know to find the junctions."""
        digest = hashlib.blake2b(digest_size=16)
        for kind, table in self.unknowns.tables.items():
            for values in (self.keys[kind], table.values, table.free, table.sigma):
                digest.update(np.ascontiguousarray(values).tobytes())
        for block in self.whole.blocks:
            digest.update(block.kind.encode())
            for _, index in block.variables:
                digest.update(np.ascontiguousarray(index).tobytes())
            for values in (block.observed, block.sigma, *block.constants.values()):
                digest.update(np.ascontiguousarray(values).tobytes())
        for cluster in self.whole.clusters:
            digest.update(np.ascontiguousarray(cluster.whitener).tobytes())
        keys = np.concatenate([np.zeros(0, dtype=np.uint64), *self.keys.values()])
        frame = repr(self.network.frame)
        return PartSurvey(keys, frame, self.network.datum == "free", digest.hexdigest())

    def stamp(self) -> tuple[str, str]:
        """Return what distinguishes the results of this part from those of another run."""
        return self.job.run, self.surveyed().digest

    def shared(self, keys: Keys) -> list[SharedVariable]:
        """Return the variables with some keys."""
        out = []
        for kind, mine in self.keys.items():
            table, model = self.unknowns[kind], _MODELS.get(kind)
            single = self.network.of_kind(kind) if UNKNOWNS[kind].single_turns else {}
            for number in np.flatnonzero(np.isin(mine, keys)).tolist():
                k = int(table.size[number])
                name = table.names[number]
                out.append(
                    SharedVariable(
                        Variable(kind, name),
                        self.unknowns.component_names(kind, number),
                        model(self.network, name) if model else "",
                        table.free[number, :k].copy(),
                        table.sigma[number, :k].copy(),
                        table.values[number].copy(),
                        single[name].values if name in single else (),
                        self._moves(name) if kind == "pose" else None,
                    )
                )
        return out

    def _moves(self, photo: str) -> bool | None:
        """Return whether a photo has a motion; None: the part has no image points of it."""
        own, _, _, _ = self.network.images.columns()
        if not (own == self.network.photo_number[photo]).any():
            return None
        return bool(self.network.of_photo(photo))

    def observations_at(self, keys: Keys) -> tuple[Keys, list[Index]]:
        """Return a number for each observation whose unknowns all have some keys, and its place.

        Observations of equal kind, unknowns, constants and values have equal numbers, (k,), and
        image points of equal photo and point. Their places are given block by block.
        """
        common = {kind: np.isin(mine, keys) for kind, mine in self.keys.items()}
        numbers, places = [np.zeros(0, dtype=np.uint64)], []
        for block in self.whole.blocks:
            on = np.full(block.n, not block.prior)
            number = np.full(block.n, variable_key(block.kind, ""), dtype=np.uint64)
            for kind, index in block.variables:
                on &= common[kind][index]
                number = _mixed(number ^ self.keys[kind][index])
            if block.lens is None:
                given = [np.asarray(c, dtype=float) for c in block.constants.values()]
                every = [c.reshape(block.n, -1).T for c in (block.observed, *given)]
                for values in np.ascontiguousarray(np.concatenate(every)):
                    number = _mixed(number ^ values.view(np.uint64))
            numbers.append(number[on])
            places.append(np.flatnonzero(on))
        return np.concatenate(numbers), places

    def labels_of(self, keys: Keys, numbers: Keys) -> list[tuple[str, str]]:
        """Return kind and name of observations by their numbers, see `observations_at`."""
        mine, places = self.observations_at(keys)
        wanted = np.isin(mine, numbers)
        out, first = [], 0
        for block, place in zip(self.whole.blocks, places, strict=True):
            chosen = place[wanted[first : first + len(place)]]
            out += [(block.kind, block.labels(int(i))) for i in chosen]
            first += len(place)
        return out

    # -- its junctions ------------------------------------------------------------------------

    def begin(self, setup: JunctionSetup) -> PartStart:
        """Take in the junctions, and write the first state."""
        for name in ("setup", "kept", "equations"):  # they follow from earlier junctions
            self.__dict__.pop(name, None)
        self.last = self._weighed = None
        write_setup(self.job.own, setup)
        self.job.own.write_arrays("keys", {str(kind): keys for kind, keys in self.keys.items()})
        try:
            state = self._started(setup)
        except ApproximationError as error:
            nothing = tuple(np.full(len(start), np.nan) for start in setup.start)
            return PartStart(nothing, tuple((p.where, p.what) for p in error.problems))
        self.write_state(0, state)
        start = tuple(state[v.kind][self.number(v)].copy() for v in setup.variables)
        nodes = self.solver_at(IterationState(0)).plan.nodes
        assert nodes is not None
        positions = np.zeros((len(setup.variables), 3))
        spread = np.zeros(len(setup.variables), dtype=bool)
        stands = nodes.positions(state)
        for i, v in enumerate(setup.variables):
            columns = self.unknowns.columns(v.kind, self.number(v))
            place = nodes.place_of[columns].max()
            spread[i] = place >= nodes.n * nodes.width
            if not spread[i]:
                positions[i] = stands[place // nodes.width]
        n = self.unknowns.n_unknowns - len(self.kept)
        return PartStart(start, (), self.equations.n_rows, n, positions, spread)

    def _started(self, setup: JunctionSetup) -> State:
        """Return the first state: what any part knows of the junctions, and approximate values.

        Raises:
            ApproximationError: the unknowns that it names have no approximate values.
        """
        known = {kind: table.values.copy() for kind, table in self.unknowns.tables.items()}
        for v, start in zip(setup.variables, setup.start, strict=True):
            number = self.number(v)
            own = known[v.kind][number]
            known[v.kind][number] = np.where(np.isnan(start), own, start)
        unknowns = copy(self.unknowns)
        unknowns.tables = {
            kind: replace(table, values=known[kind]) for kind, table in unknowns.tables.items()
        }
        state = dict(
            choose_start(replace(self.whole, unknowns=unknowns), "given", self._given).state
        )
        for v, start in zip(setup.variables, setup.start, strict=True):
            number = self.number(v)
            values = state[v.kind].copy()
            values[number] = np.where(np.isnan(start), values[number], start)
            state[v.kind] = values
        return state

    @cached_property
    def setup(self) -> JunctionSetup:
        """Results of the root for the junctions."""
        return read_setup(self.job.own)

    @cached_property
    def kept(self) -> Index:
        """Free columns of the junctions, in the order of the root, (m,)."""
        columns = [np.zeros(0, dtype=np.intp)]
        for v in self.setup.variables:
            own = self.unknowns.columns(v.kind, self.number(v))
            columns.append(own[self.unknowns.free[own]])
        return np.concatenate(columns)

    @cached_property
    def equations(self) -> Equations:
        """The equations, without given values of junctions that count in another part."""
        foreign: dict[VariableKind, list[int]] = {}
        for v, elsewhere in zip(self.setup.variables, self.setup.foreign, strict=True):
            if elsewhere:
                foreign.setdefault(v.kind, []).append(self.number(v))
        blocks, first = [], 0
        for block in self.whole.blocks:
            kind, index = block.variables[0]
            if block.prior and kind in foreign:
                stays = np.flatnonzero(~np.isin(index, foreign[kind]))
                if not len(stays):
                    continue
                block = block.select(stays)
            blocks.append(replace(block, first_row=first))
            first += block.observed.size
        # Clusters are among the observations before the given values, whose places do not change.
        return replace(self.whole, blocks=tuple(blocks))

    # -- its states ---------------------------------------------------------------------------

    def write_state(self, number: int, state: State, weights: int = 0) -> None:
        """Write a state, and forget one that is no longer needed.

        Args:
            number: its number.
            state: the values.
            weights: number of the state that gives the standard deviations, which stays.
        """
        self.job.own.write_arrays(f"state-{number}", {str(k): v for k, v in state.items()})
        if number > KEPT_STATES and number - KEPT_STATES != weights:
            self.job.own.forget(f"state-{number - KEPT_STATES}")

    def state(self, number: int) -> State:
        """Return a written state."""
        found = self.job.own.arrays(f"state-{number}")
        return {kind: found[kind] for kind in self.unknowns.tables}

    def solver_at(self, at: IterationState) -> Solver:
        """Return the equations with the weights of a point of the iteration, and their plan."""
        if self._weighed is None or self._weighed[0] != at.weights:
            equations = self.equations.weighted_at(self.state(at.weights))
            nothing = np.zeros(self.unknowns.n_columns, dtype=bool)
            layers = layers_of(equations, reduce_points=True, touched=nothing, kept=self.kept)
            solver = Solver(equations, EliminationPlan.of(equations, layers))
            self._weighed = (at.weights, solver)
            self.last = None
        return self._weighed[1]

    def eliminated(self, at: IterationState) -> PartElimination:
        """Return the eliminated interior at a point of the iteration.

        Raises:
            SingularError: the interior is not determined, even if the junctions are known.
            InputError: observations cannot be computed.
        """
        if self.last is None or self.last.at != at:
            before, self.last = self.last, None
            solver = self.solver_at(at)
            if before is not None and replace(before.at, damping=at.damping) == at:
                normal = before.normal
            else:
                normal = NormalEquations(solver, self.state(at.state))
            added = at.damping * normal.diagonal
            self.last = PartElimination(at, normal, added, normal.reduced(added))
        return self.last

    def with_known_junctions(self, at: IterationState) -> Equations:
        """Return the equations at a point of the iteration with all junctions held."""
        held = np.zeros(self.unknowns.n_columns, dtype=bool)
        held[self.kept] = True
        return replace(
            self.solver_at(at).equations, unknowns=_with_held_columns(self.unknowns, held)
        )


def _of_photo(network: Network, name: str) -> str:
    return f"calibration {calibration_name(network, name)!r}"


def _of_calibration(network: Network, name: str) -> str:
    camera = camera_of_calibration(network, name)
    read = (
        "" if camera.times() is None else f", read {camera.readout_towards} in {camera.readout} s"
    )
    return f"{camera.lens} in {camera.unit}{read}"


def _of_frame(network: Network, name: str) -> str:
    stated = network.frames[name]
    x, y, z, level = stated.constants
    place = f"point {stated.origin!r}" if stated.origin else f"({x:.10g}, {y:.10g}, {z:.10g})"
    return f"the origin {place}{' and is level' if level else ''}"


_MODELS: dict[VariableKind, Callable[[Network, str], str]] = {
    "pose": _of_photo,
    "calibration": _of_calibration,
    "frame": _of_frame,
}
"""What the values of a variable belong to, for kinds that do not say it all."""


def _read(part: Part) -> Network:
    """Return the network of a part.

    Raises:
        InputError: its function fails, or returns something else.
    """
    try:
        network = part.load()
    except AdjustmentError:
        raise
    except Exception as error:  # a user's function may fail in any way
        what = f"the function that reads it fails: {type(error).__name__}: {error}"
        raise InputError(what) from error
    if not isinstance(network, Network):
        raise InputError(f"the function that reads it must return a Network, not {network!r}")
    return network


def variable_key(kind: str, name: str) -> int:
    """Return a number that differs between any two names, but for a chance of 10⁻⁶ in 5 million."""
    digest = hashlib.blake2b(f"{kind}\0{name}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little")


def _mixed(x: Keys) -> Keys:
    """Return numbers whose bits all depend on all bits of x (splitmix64, Steele et al. 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _with_held_columns(unknowns: Unknowns, columns: Mask) -> Unknowns:
    """Return unknowns with some columns held."""
    out = copy(unknowns)
    out.free = unknowns.free & ~columns
    tables = {}
    for kind, table in unknowns.tables.items():
        every = table.offset[:, None] + np.arange(table.free.shape[1])
        has = (table.offset >= 0)[:, None] & (np.arange(table.free.shape[1]) < table.size[:, None])
        gone = has & columns[np.where(has, every, 0)]
        tables[kind] = replace(table, free=table.free & ~gone)
    out.tables = tables
    out.n_unknowns = int(out.free.sum())
    return out
