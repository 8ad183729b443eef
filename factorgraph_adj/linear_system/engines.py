"""Operations on a linear system in either engine: its choice, rows that join or leave, convergence.

The functions do not change a system; they return another one, or None where this takes a new batch
adjustment.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..ledger.waiting_observations import Candidates, NothingKnown
from ..quality.group_tests import LeaveOneOutTests
from ..start.start_values import Start
from ..types import NO_ROWS, Index
from .arrival_decisions import MOTION_SIGMAS, SINGULAR_REDUNDANCY, JointTest
from .front_system import FrontSystem
from .isam2_system import EnteredRows, ISAM2System
from .joint_tests import RowsBesideBase
from .linear_system import LinearSystem
from .linearisation_error import is_small, near_minimum
from .rebase import EFFORT, Draft, notices_motion

if TYPE_CHECKING:
    import gtsam


def downdated(system: FrontSystem, ids: Sequence[str]) -> FrontSystem | None:
    """Return a system without observations; None where an update cannot determine it.

    Args:
        system: the system.
        ids: first ids of units, ids of image points, and names of weighted unknowns.
    """
    found = _reduced(system, ids)
    if found is None or not found.update.trusted or found.update.condition <= SINGULAR_REDUNDANCY:
        return None
    return found


def determined_only_by(system: FrontSystem, ids: Sequence[str]) -> set[Variable] | None:
    """Return the variables that observations alone determine; None where that is not known.

    With M of the rows that leave, a null vector z of M is a motion x = Q Aᵀ z that only these rows
    determine.
    """
    found = _reduced(system, ids)
    if found is None:
        return None
    update = found.update
    leave = update.signs < 0
    inner, spread = update.inner, update.spread
    e, g = inner[np.ix_(leave, leave)], spread[:, leave]
    if (~leave).any():
        gain = np.linalg.solve(inner[np.ix_(~leave, ~leave)], inner[np.ix_(~leave, leave)])
        e = e - inner[np.ix_(leave, ~leave)] @ gain
        g = g - spread[:, ~leave] @ gain
    values, vectors = np.linalg.eigh(-0.5 * (e + e.T))
    weight = np.sqrt(np.where(found.unknowns.free, system.base.normal().diagonal, 0.0))
    far = np.zeros(len(weight))
    for z in vectors[:, values <= SINGULAR_REDUNDANCY].T:
        far = np.maximum(far, np.abs(system.lifted.unknowns(g @ z, found.slots)) * weight)
    unknowns = system.unknowns
    return {
        (kind, unknowns[kind].names[number])
        for kind, number in unknowns.active()
        if (far[unknowns.columns(kind, number)] > MOTION_SIGMAS).any()
    }


def _reduced(system: FrontSystem, ids: Sequence[str]) -> FrontSystem | None:
    """Return a system without observations, determined or not; None: they are too many."""
    joined = dict(system.joined)
    gone = [joined.pop(i) for i in ids if i in joined]
    update = system.update
    if gone:
        stays = np.ones(len(update.signs), dtype=bool)
        stays[np.concatenate(gone)] = False
        update = update.only(np.flatnonzero(stays))
        new = np.cumsum(stays) - 1
        joined = {i: new[rows] for i, rows in joined.items()}
    own = [i for i in ids if i not in system.joined]
    equations = system.base.equations
    of_own = equations.find(own)
    if system.section is not None and not all(map(len, of_own)):
        return None  # the rest has one
    rows = np.concatenate([NO_ROWS, *of_own])
    for c in equations.clusters:
        if np.isin(c.rows, rows).any():
            rows = np.union1d(rows, c.rows)
    slots = dict(system.slots)
    if len(rows):
        if len(update.signs) + len(rows) > system.most_beside:
            return None
        a = system.base.normal().system.sparse(rows)
        columns: Index = np.unique(a.indices).astype(np.intp)
        slots = system.lifted.with_slots(columns, slots)
        if not system.has_room(slots):
            return None
        f = system.lifted.expand(columns, a[:, columns].toarray(), slots)
        v = system.base.normal().system.residual[rows]
        if system.offset is not None:
            v = v + a @ system.offset
        update = update.with_rows(f.at, f.b, v, sign=-1.0)
    return replace(system, update=update, joined=joined, slots=slots, drift=None)


class RefusedNetwork(NamedTuple):
    """Size of a network when iSAM2 refused it, without growth of which it would do so again.

    Cholesky's factorisation in iSAM2 refuses a weak datum: further observations between known
    variables do not strengthen it, unless they determine the position of the network.
    """

    n_variables: int
    """Number of the variables that observations touch, constants among them."""
    n_free: int
    """Number of its unknown components."""
    n_placing: int
    """Number of observations and weights that determine its position."""

    @classmethod
    def of(cls, system: FrontSystem, ledger: Ledger) -> RefusedNetwork:
        """Return the size of a network."""
        equations = system.base.equations
        beside = [unit for _, unit in ledger.rows.units(ledger.find(system.joined))]
        touched: set[Variable] = {v for unit in beside for v in unit.variables}
        for block in equations.blocks:
            for kind, index in block.variables:
                names = equations.unknowns[kind].names
                touched |= {(kind, names[i]) for i in np.unique(index).tolist()}
        placing = sum(b.n for b in equations.blocks if b.prior or b.fixes != "nothing")
        placing += sum(o.record.fixes != "nothing" for unit in beside for o in unit.observations)
        return cls(len(touched), equations.unknowns.n_unknowns, placing)


def in_chosen_engine(
    system: LinearSystem | None,
    ledger: Ledger,
    rules: Options,
    refused: RefusedNetwork | None = None,
) -> tuple[LinearSystem | None, RefusedNetwork | None]:
    """Return a system in the engine that the options choose, where it suits the network.

    Args:
        system: the system.
        ledger: its observations.
        rules: the options.
        refused: size of the network when iSAM2 refused it last; None: it has not.

    Returns:
        The system, and its size where iSAM2 refuses it.
    """
    if isinstance(system, ISAM2System) and system.outgrown:
        with suppress(AdjustmentError):
            return system.fronts.prepared(), None
    if not isinstance(system, FrontSystem) or rules.engine == "fronts":
        return system, None
    if not ISAM2System.suits(system, rules):
        return system, refused
    now = None if refused is None else RefusedNetwork.of(system, ledger)
    if now is not None and now == refused:
        return system, refused
    found = ISAM2System.of(system, ledger, rules)
    return (system, now or RefusedNetwork.of(system, ledger)) if found is None else (found, None)


def in_fronts(system: LinearSystem | None) -> FrontSystem | None:
    """Return a system in fronts; None: nothing is known.

    Raises:
        AdjustmentError: there is no minimum.
    """
    if isinstance(system, ISAM2System):
        return system.fronts
    return system if isinstance(system, FrontSystem) else None


def with_border_adjusted(system: LinearSystem | None, ledger: Ledger) -> FrontSystem | None:
    """Return a system in fronts that has all unknowns in its base or section; see `in_fronts`.

    Raises:
        AdjustmentError: there is no minimum.
    """
    found = in_fronts(system)
    if found is None or not found.border.unknowns:
        return found
    draft = Draft.of(ledger, found, "given")
    result = draft.adjusted("given", tolerances=(EFFORT.close,))
    return result if isinstance(result, FrontSystem) else found


def converged(system: LinearSystem, found: FrontSystem) -> LinearSystem:
    """Return a converged system, in its engine if that converges at the same values.

    Args:
        system: the system.
        found: the batch adjustment of it.
    """
    tree = system.converged(found) if isinstance(system, ISAM2System) else None
    return tree or found.prepared()


def copied_isam2(system: LinearSystem | None) -> gtsam.ISAM2 | None:
    """Return a copy of the tree of a system; None: it is in fronts."""
    return system.tree.copied() if isinstance(system, ISAM2System) else None


# -- rows that enter ------------------------------------------------------------------------------


def joined_on_trial(
    system: LinearSystem,
    ledger: Ledger,
    rows: Index,
    starts: Sequence[Start],
    new: Collection[Variable],
) -> JointTest | None:
    """Return observations joined to a system, to be tested; None where it cannot take them.

    Args:
        system: the system.
        ledger: the ledger with them.
        rows: the observations.
        starts: values of the variables that enter with them.
        new: these variables. iSAM2 does not take points that may be on the other side of their
            readings: a batch adjustment examines both sides.

    Raises:
        InputError: names observations with degenerate geometry.
    """
    if isinstance(system, ISAM2System):
        joint = system.entered(ledger, rows, starts)
        return None if joint is None or joint.images(new) else joint
    if not isinstance(system, FrontSystem) or ledger.n_scalars(rows) > system.most_beside:
        return None
    return _bordered(system, ledger, rows, starts) if new else rows_beside(system, ledger, rows)


def rows_beside(system: FrontSystem, ledger: Ledger, rows: Index) -> RowsBesideBase | None:
    """Return observations between known variables beside a base; None where it cannot take them.

    Raises:
        InputError: names observations with degenerate geometry.
    """
    if system.section is not None:
        variables = Candidates(ledger, NothingKnown(), rows).links.variables
        reaching = system.reaching(variables)
        if reaching is None:
            return None
        system = reaching
    forms = system.forms(ledger, rows)
    held = system.datum_solution
    datum = None if held is None else held.datum
    if datum is not None and notices_motion(forms.a, datum.motions[forms.columns]):
        return None
    return RowsBesideBase.of(system, forms)


def _bordered(
    system: FrontSystem, ledger: Ledger, rows: Index, starts: Sequence[Start]
) -> RowsBesideBase | None:
    """Put new unknowns beside a base with the rows that determine them.

    A small network gets a new base: this takes little time there, and it is linearised at the
    present estimates.
    """
    if system.section is not None or system.doubt or system.is_free or is_small(system):
        return None

    def values(unknowns: Unknowns, state: State) -> State:
        moving = unknowns.moving()
        for start in starts:
            state = unknowns.carried(state, start.unknowns, start.state, where=moving)
        return state

    found = system.bordered(ledger, rows, values)
    return None if found is None else RowsBesideBase.of(*found)


def committed(
    system: LinearSystem, joint: JointTest, ledger: Ledger, rules: Options
) -> LinearSystem | None:
    """Return a system at its minimum with observations that joined; None: it is not near enough.

    Args:
        system: the system without them.
        joint: the observations that joined.
        ledger: the ledger with them.
        rules: the options.

    Raises:
        InputError: names observations that are degenerate at the present state.
    """
    if isinstance(joint, RowsBesideBase):
        return near_minimum(ledger, joint.after, rules, joint.forms)
    if isinstance(system, ISAM2System) and isinstance(joint, EnteredRows):
        return system.after(joint, ledger)
    return None


def joined_directly(
    system: LinearSystem,
    ledger: Ledger,
    rows: Index,
    starts: Sequence[Start],
    new: Collection[Variable],
    fits: Callable[[LeaveOneOutTests], bool],
    equations: Equations | None = None,
) -> tuple[LinearSystem, JointTest] | None:
    """Join observations with new variables that need no local adjustment before: in iSAM2 alone.

    None: they need one, because one does not fit or may be on the other side of its readings.

    Args:
        system: the system.
        ledger: the ledger with them.
        rows: the observations.
        starts: values of the variables that enter with them.
        new: these variables.
        fits: returns whether tests show no gross error.
        equations: the observations alone; None: they have not been compiled.
    """
    if not isinstance(system, ISAM2System):
        return None
    joint = system.entered(ledger, rows, starts, equations)
    if joint is None or not fits(joint.tested()):
        return None
    after = system.after(joint, ledger)
    if after is None or joint.images(new):
        return None
    renewed = joint.renewed()
    return (after, renewed) if renewed is joint or fits(renewed.tested()) else None


# -- rows that leave ------------------------------------------------------------------------------


def reduced(
    system: LinearSystem, ids: Sequence[str], ledger: Ledger, rules: Options
) -> LinearSystem | None:
    """Return a system at its minimum without observations; None where it loses more.

    Args:
        system: the system.
        ids: first ids of units, ids of image points, and names of weighted unknowns.
        ledger: the ledger without them.
        rules: the options.
    """
    with suppress(AdjustmentError):
        if isinstance(system, ISAM2System):
            return system.without(ids, ledger)
        if isinstance(system, FrontSystem) and not system.doubt and not system.border.unknowns:
            after = downdated(system, ids)
            return None if after is None else near_minimum(ledger, after, rules)
    return None
