"""Retirement of unknowns: linear rows in their place, and their archive, from which they return.

A retired unknown leaves with all observations that touch it, whatever their outcome. The
information of its accepted observations on the remaining unknowns is kept as linear rows
(`factorgraph_adj.solve.marginalisation`), at the values of that moment. Its last estimate and its
observations are kept in an archive, from which everything can be taken back.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..entities import Key, parameter_name
from ..errors import AdjustmentError, InputError, Problem, known
from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.observation_selection import keep_entities
from ..graph.variables import calibration_name
from ..ledger import journal_entries
from ..ledger.command_input import Options
from ..ledger.journal_entries import packed, packed_symmetric, unpacked, unpacked_symmetric
from ..ledger.ledger import Ledger
from ..ledger.retired_unknowns import LastEstimate, Retired
from ..ledger.row_store import REMOVED
from ..ledger.waiting_observations import Candidates, NothingKnown
from ..linear_system import engines
from ..linear_system.rebase import EFFORT, Draft, NoMinimum, known_network
from ..models.unknown_registry import UNKNOWNS, VariableKind, parameter_kinds
from ..network.network import Network
from ..solve.added_factors import Prior, UnknownGroup
from ..solve.marginalisation import (
    MAX_SECOND_DERIVATIVE_UNKNOWNS,
    NO_MISSED_STEP,
    RETIRED_ROWS_NAME,
    MissedStep,
    marginalise,
    unknown_missed_step,
)
from ..types import Array, Index
from .retirement_window import is_stated, stated_at
from .worklist import IncrementalState

SMALL_PARTS = ("scale", "constant", "linear")
"""Parts of `MissedStep` that the journal has with seven digits."""
NO_MINIMUM = "there is no minimum at which retired observations could be linear rows"


class Leaving(NamedTuple):
    """Unknowns and rows that are to be retired."""

    variables: tuple[Variable, ...]
    """The unknowns."""
    rows: Index
    """All rows of the ledger that touch them, and others between given points."""
    between: tuple[str, ...] = ()
    """Ids of these others."""

    @classmethod
    def of(
        cls, ledger: Ledger, variables: Iterable[Variable], between: Collection[str] = ()
    ) -> Leaving:
        """Return some unknowns with orientations, motions and calibrations of no further use.

        Args:
            ledger: the ledger with their rows.
            variables: the unknowns.
            between: ids of further observations, which touch only what is given.
        """
        gone = dict.fromkeys(variables)
        for name in [name for kind, name in gone if kind == "pose"]:
            gone |= dict.fromkeys(ledger.network.of_photo(name))
            lens = calibration_name(ledger.network, name)
            if "@" in lens and lens not in ledger.network.cameras:
                gone["calibration", lens] = None
        every = Candidates(ledger, NothingKnown(), np.flatnonzero(ledger.rows.status != REMOVED))
        rows = every.touching(gone)
        for kind, name in every.only(rows).links.variables:
            needs_no_one = UNKNOWNS[kind].absent == "found"
            needs_no_one &= not is_stated(ledger.network, kind, name)
            if needs_no_one and np.isin(every.touching([(kind, name)]), rows).all():
                gone[kind, name] = None
        return cls(tuple(gone), np.union1d(rows, ledger.find(between)), tuple(between))


class Rest(NamedTuple):
    """Information of the retired observations on the remaining unknowns."""

    prior: Prior
    """Linear rows."""
    missed: MissedStep = NO_MISSED_STEP
    """Deviation of the linear rows."""

    @classmethod
    def of(cls, retired: Retired | None) -> Rest:
        """Return the linear rows until now."""
        if retired is None:
            return cls(Prior(r=np.zeros((0, 0)), z=np.zeros(0), name=RETIRED_ROWS_NAME))
        return cls(retired.prior, retired.missed)

    def fields(self) -> dict[str, Any]:
        """Return the fields of the journal for it."""
        r, z = self.prior.r, self.prior.z
        assert r is not None and z is not None
        groups = [
            {
                "kind": g.kind,
                "names": list(g.names),
                "reference": g.reference.tolist(),
                "columns": g.columns.tolist(),
            }
            for g in self.prior.groups
        ]
        rows = {"r": r.tolist(), "z": z.tolist(), "apart": self.prior.apart}
        return {"groups": groups, "width": r.shape[1], **rows, "missed": _fields_of(self.missed)}

    @classmethod
    def read(cls, fields: Mapping[str, Any]) -> Rest:
        """Return it from the fields of the journal."""
        groups = tuple(
            UnknownGroup(
                g["kind"],
                tuple(g["names"]),
                np.array(g["reference"], dtype=float),
                np.array(g["columns"], dtype=np.intp),
            )
            for g in fields["groups"]
        )
        z: Array = np.array(fields["z"], dtype=float)
        r = np.array(fields["r"], dtype=float).reshape(len(z), int(fields["width"]))  # may be 0
        prior = Prior(groups=groups, r=r, z=z, apart=int(fields["apart"]), name=RETIRED_ROWS_NAME)
        return cls(prior, _missed_of(fields["missed"], r.shape[1]))


def _fields_of(missed: MissedStep) -> dict[str, Any]:
    """Return the fields of the journal for a deviation of rows; none where it is not known."""
    if not missed.is_known:
        return {}
    most, quadratic = packed_symmetric(missed.quadratic)
    fields: dict[str, Any] = {k: packed(a) for k, a in zip(SMALL_PARTS, missed[:3], strict=True)}
    fields |= {"most": most, "quadratic": quadratic, "remainder": missed.remainder}
    return {"rank": len(missed.constant), **fields}


def _missed_of(fields: Mapping[str, Any], width: int) -> MissedStep:
    """Return the deviation of rows from the fields of the journal."""
    if not fields:
        return unknown_missed_step(width)
    k = int(fields["rank"])
    shapes = (k, width), (k,), (k, k)
    scale, constant, linear = (
        unpacked(fields[name], *shape) for name, shape in zip(SMALL_PARTS, shapes, strict=True)
    )
    quadratic = unpacked_symmetric(float(fields["most"]), fields["quadratic"], k)
    return MissedStep(scale, constant, linear, quadratic, float(fields["remainder"]))


def retire(
    state: IncrementalState,
    variables: Collection[Variable],
    rules: Options,
    between: Collection[str] = (),
) -> tuple[IncrementalState, dict[str, Any]]:
    """Retire unknowns; return the state without them, and the journal's record of it.

    Args:
        state: the state.
        variables: the unknowns.
        rules: the options.
        between: ids of further observations, which touch only what is given.

    Raises:
        InputError: something of it cannot be retired; all problems.
        AdjustmentError: there is no minimum.
    """
    if rules.datum == "free":
        what = "nothing of a free network can be retired: its datum is that of all datum points"
        raise InputError(f"{what}; give it a datum (fixed or weighted points)")
    ledger = state.ledger
    _refuse(ledger, variables)
    leaving = Leaving.of(ledger, variables, between)
    inside = ledger.rows.among(leaving.rows, "accepted")
    problems = [
        Problem(
            "your own factor cannot be kept, and therefore not be retired", f"factor {u.ids[0]!r}"
        )
        for _, u in ledger.rows.units(leaving.rows)
        for o in u.observations
        if o.kind == "factor"
    ]
    if problems:
        raise InputError(problems)
    rest, system = Rest.of(ledger.retired), state.system
    touched = not set(rest.prior.variables).isdisjoint(leaving.variables)
    if system is not None and (len(inside) or touched):
        if system.doubt:
            raise AdjustmentError(f"{NO_MINIMUM}: {system.doubt}")
        rest = _marginal(Draft.of(ledger, system, rules.datum), leaving, ledger.retired)
    estimates = [_last_estimate(state, v, ledger) for v in leaving.variables]
    line = {
        "unknowns": [[*v] for v in leaving.variables],
        "between": list(leaving.between),
        "values": [None if e.value is None else e.value.tolist() for e in estimates],
        "covariances": [
            None if e.covariance is None else e.covariance.ravel().tolist() for e in estimates
        ],
        "rest": rest.fields(),
    }
    after = without(ledger, leaving, rest, estimates)
    if system is None:
        return IncrementalState(after, None, settled=False), line
    if not len(after.having("accepted")):
        raise InputError("nothing would remain in the graph: there must be something to adjust")
    found = Draft.of(after, system, rules.datum, dropped=leaving.variables).adjusted(
        rules.datum, tolerances=(EFFORT.close,)
    )
    if isinstance(found, NoMinimum):
        raise AdjustmentError(f"{NO_MINIMUM} without it: {found.reason}")
    return IncrementalState(after, found.prepared(), settled=False), line


def retired_again(ledger: Ledger, line: Mapping[str, Any]) -> Ledger:
    """Return the ledger after a retirement that the journal records."""
    variables: list[Variable] = [(kind, name) for kind, name in line["unknowns"]]
    every = Candidates(ledger, NothingKnown(), np.flatnonzero(ledger.rows.status != REMOVED))
    rows = np.union1d(every.touching(variables), ledger.find(line["between"]))
    leaving = Leaving(tuple(variables), rows, tuple(line["between"]))
    moment = moment_of(ledger)
    estimates = []
    for (kind, name), value, covariance in zip(
        variables, line["values"], line["covariances"], strict=True
    ):
        q = None if covariance is None else np.array(covariance, dtype=float)
        if q is not None:
            q = q.reshape(2 * (round(len(q) ** 0.5),))
        x = None if value is None else np.array(value, dtype=float)
        estimates.append(LastEstimate(kind, name, moment, x, q))
    return without(ledger, leaving, Rest.read(line["rest"]), estimates)


def taken_back(state: IncrementalState, rules: Options) -> IncrementalState:
    """Return the state with everything that was retired, converged.

    Raises:
        AdjustmentError: there is no minimum with it.
    """
    retired = state.ledger.retired
    assert retired is not None
    ledger, values = with_everything(state.ledger), dict(retired.archive.determined(retired.number))
    ledger, system = _with_values(ledger, values), state.fronts
    if system is None and not values:
        return IncrementalState(ledger, None, settled=False)
    draft = Draft.of(ledger, system, rules.datum, new=values, there=values)
    draft = replace(draft, looked={})
    found = draft.adjusted(rules.datum, tolerances=EFFORT.at_rest)
    if isinstance(found, NoMinimum):
        what = "no minimum was found with everything that was retired; it stays retired"
        raise AdjustmentError(f"{what}: {found.reason}")
    return IncrementalState(ledger, found.prepared(), settled=True)


def missed_step(state: IncrementalState) -> float:
    """Return the bound of the step that linear rows miss, relative to σ: √(gᵀQg) + ρ.

    It is infinite where it is not known. See `factorgraph_adj.solve.marginalisation`; Q is Q_xx.

    Raises:
        AdjustmentError: there is no minimum.
    """
    retired = state.ledger.retired
    if retired is None or not retired.prior.groups:
        return 0.0
    if (fronts := engines.in_fronts(state.system)) is None:
        return 0.0
    solution = fronts.solution
    moved = retired.prior.movement(solution.equations, solution.state)
    gradient, remainder = retired.missed.at(moved)
    columns = np.zeros(len(gradient), dtype=np.intp)
    for group in retired.prior.groups:
        for name, places in zip(group.names, group.columns, strict=True):
            own = fronts.columns(group.kind, name)
            columns[places[: len(own)]] = own
    f = fronts.expand(columns, gradient[None])
    variance = fronts.update.between(f.at, f.b, f.at, f.b) + f.own
    return float(np.sqrt(max(variance[0, 0], 0.0))) + remainder


def doubt(state: IncrementalState, rules: Options) -> str:
    """Return a sentence where linear rows may miss more than promised; empty otherwise."""
    if state.system is None or state.system.doubt:
        return ""
    missed = missed_step(state)
    if missed <= rules.accuracy:
        return ""
    if np.isinf(missed):
        return (
            "what was retired had observations in common with so much of the rest, more than "
            f"{MAX_SECOND_DERIVATIVE_UNKNOWNS} components at once, that it is not known what their "
            "linear rows miss: settle(all=True) takes them back"
        )
    return (
        "what remains has moved since others were retired, whose linear rows may miss "
        f"{missed:.2g} σ by now: settle(all=True) takes them back"
    )


def whole_network(state: IncrementalState) -> Network:
    """Return the network of all observations in the graph, now or when they were retired."""
    retired = state.ledger.retired
    assert retired is not None
    values = dict(retired.archive.determined(retired.number))
    ledger = _with_values(with_everything(state.ledger), values)
    return known_network(ledger, state.system, new=values)


def _with_values(ledger: Ledger, values: Mapping[Variable, Array]) -> Ledger:
    """Write last estimates into the ledger, where no approximate values were given."""
    kinds: tuple[VariableKind, ...] = ("point", "pose")
    for kind in kinds:
        own = {n: x.tolist() for (k, n), x in values.items() if k == kind}
        ledger = ledger.with_values(kind, own)
    return ledger


def with_everything(ledger: Ledger) -> Ledger:
    """Return a ledger with everything that was retired; raise where an id occurs twice."""
    retired, clock = ledger.retired, ledger.clock
    if retired is None:
        return ledger
    ledger = replace(ledger, retired=None)
    for line in retired.archive.lines(retired.number):
        if twice := ledger.ids_of(ledger.find(journal_entries.ids_of(line))):
            what = "has the id of a retired one, which cannot be taken back beside it: remove it"
            raise InputError([Problem(what, f"observation {i!r}") for i in twice])
        ledger = journal_entries.replay(line, ledger, where="what was retired")
        ledger = replace(ledger, clock=clock)
    return ledger


# -- the rows that remain -------------------------------------------------------------------------


def _marginal(draft: Draft, leaving: Leaving, before: Retired | None) -> Rest:
    """Return the information of observations on the unknowns that do not leave."""
    normal, _ = draft.normal(None)
    equations = normal.system.equations
    unknowns = equations.unknowns
    gone = []
    for kind, name in leaving.variables:
        number = unknowns[kind].number.get(name)
        if number is not None and unknowns[kind].offset[number] >= 0:
            gone.append(unknowns.columns(kind, number))
    rows = _rows_of(equations, leaving.variables)
    rows = np.unique(np.concatenate([rows, *equations.find(leaving.between)]))
    earlier = () if before is None else (before.prior, before.missed)
    return Rest(*marginalise(normal, rows, gone, *earlier))


def _rows_of(equations: Equations, variables: Collection[Variable]) -> Index:
    """Return all rows that touch some variables, with the other rows of their groups."""
    by_kind: dict[VariableKind, list[int]] = {}
    for kind, name in variables:
        number = equations.unknowns[kind].number.get(name)
        if number is not None:
            by_kind.setdefault(kind, []).append(number)
    on = np.zeros(equations.n_rows, dtype=bool)
    for kind, numbers in by_kind.items():
        on[equations.touching(kind, np.array(numbers, dtype=np.intp))] = True
    for cluster in equations.clusters:
        if on[cluster.rows].any():
            on[cluster.rows] = True
    return np.flatnonzero(on)


def without(
    ledger: Ledger, leaving: Leaving, rest: Rest, estimates: Collection[LastEstimate]
) -> Ledger:
    """Return the ledger without retired unknowns and rows, which go to the archive.

    Args:
        ledger: the ledger before.
        leaving: unknowns and rows that are retired.
        rest: their information on the remaining unknowns.
        estimates: last estimates of the retired unknowns.
    """
    before = ledger.retired
    archive = Retired(rest.prior) if before is None else before
    moment = moment_of(ledger)
    names = {kind: {n for k, n in leaving.variables if k == kind} for kind in ("point", "pose")}
    units = [u for _, u in ledger.rows.units(leaving.rows)]
    archive.archive.put(
        archive.number + 1,
        moment,
        estimates,
        [*(i for u in units for i in u.ids), *ledger.rows.own_ids(leaving.rows)],
        journal_entries.everything_of(ledger, leaving.rows, names["point"], names["pose"]),
    )
    keys: dict[Variable, Key] = {
        (kind, parameter_name(key)): key
        for u in units
        for o in u.observations
        for kind, key in o.parameters()
        if UNKNOWNS[kind].absent == "found"
    }
    keys |= {(kind, parameter_name(key)): key for kind, key in archive.found}
    inside = ledger.rows.among(leaving.rows, "accepted")
    scalars = len(ledger.ids_of(inside))
    held = tuple(n for n in sorted(names["point"]) if not ledger.needs(("point", n))[0])
    retired = replace(
        archive,
        **rest._asdict(),
        number=archive.number + 1,
        points=archive.points + len(names["point"]),
        photos=archive.photos + len(names["pose"]),
        observations=archive.observations + scalars,
        held_points=archive.held_points + held,
        found=tuple((v[0], keys[v]) for v in rest.prior.variables if v in keys),
    )
    return _shrunk(ledger, leaving, names["point"], names["pose"], retired)


def _shrunk(
    ledger: Ledger, leaving: Leaving, points: set[str], photos: set[str], retired: Retired
) -> Ledger:
    """Return the ledger without rows and unknowns, with the names that are left renumbered."""
    network = ledger.network.copy()
    keep_entities(
        network,
        [n for n in network.photos if n not in photos],
        [n for n in network.points if n not in points],
    )
    gone = set(leaving.variables)
    for kind in parameter_kinds():
        table = network.of_kind(kind.name)
        for key in [k for k in table if (kind.name, parameter_name(k)) in gone]:
            del table[key]
    there = ledger.rows.status != REMOVED
    there[leaving.rows] = False
    photo, point = (
        np.array([numbers.get(n, -1) for n in every], dtype=np.intp)
        for numbers, every in (
            (network.photo_number, ledger.names.photos),
            (network.point_number, ledger.names.points),
        )
    )
    rows = ledger.rows.only(there, photo, point)
    ids = set(ledger.ids_of(leaving.rows))
    lacks = {v: why for v, why in ledger.lacks.items() if v not in gone and v not in ids}
    sides = {i: s for i, s in ledger.sides.items() if i not in ids and s.point not in points}
    return replace(
        ledger,
        network=network,
        names=type(ledger.names).of(network),
        rows=rows,
        lacks=lacks,
        sides=sides,
        sizes={},
        causes={},
        retired=retired,
    )


def moment_of(ledger: Ledger) -> str:
    """Return the moment of a retirement in words: after which photo or point."""
    for noun, names in (("photo", ledger.names.photos), ("point", ledger.names.points)):
        if names:
            return f"when {noun} {names[-1]!r} was the last that had come"
    return "at the beginning"


def _last_estimate(state: IncrementalState, variable: Variable, ledger: Ledger) -> LastEstimate:
    """Return the last estimate of an unknown."""
    system, moment = state.system, moment_of(ledger)
    value = None if system is None else system.value(*variable)
    if system is None or value is None:
        return LastEstimate(*variable, moment, None, None)
    return LastEstimate(*variable, moment, value, system.cofactors(variable, variable))


# -- refusals -------------------------------------------------------------------------------------


def _refuse(ledger: Ledger, variables: Collection[Variable]) -> None:
    """Refuse names that do not exist, and points for which something else was stated."""
    network = ledger.network
    problems: list[Problem] = []
    for kind, name in (v for v in variables if v[0] in ("point", "pose")):
        there = network.points if kind == "point" else network.photos
        noun = UNKNOWNS[kind].noun
        if name not in there:
            message = "" if ledger.retired is None else ledger.retired.retirement_note((kind, name))
            what = message or f"unknown {noun}; known: {known(there, meant=name)}"
            problems.append(Problem(what, f"{noun} {name!r}"))
        elif kind == "point" and (what := stated_at(network, name)):
            problems.append(Problem(f"cannot be retired: {what}", f"point {name!r}"))
    if problems:
        raise InputError(problems)
