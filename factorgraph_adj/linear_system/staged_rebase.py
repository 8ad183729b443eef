"""New base in stages, one with each arrival, before the room for rows beside the old one is full.

Every arrival after rows beside the base have become many adds one stage: the present network is
compiled, then ordered for its elimination and moved by the first step, then adjusted; then the
later observations are put beside it. No arrival waits for all stages.


"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..solve.normal_equations import Solver
from ..start.start_values import Start
from ..types import Index
from .front_system import FrontSystem
from .joint_tests import RowsBesideBase
from .linearisation_error import near_minimum
from .rebase import EFFORT, Draft

RENEWAL_FILL = 0.65
"""Share of the largest number of rows beside a base from which a new one is made: there is room for
some arrivals until it is ready."""


@dataclass(frozen=True, eq=False)
class Renewal:
    """A new base under construction."""

    old: FrontSystem
    """A system beside the base that it will replace."""
    draft: Draft
    """The network when it was begun."""
    solver: Solver | None = None
    """The same in the order of its elimination; None: that is the next stage."""
    made: FrontSystem | None = None
    """The adjusted network; None: it is not adjusted yet."""


def next_stage(
    renewal: Renewal | None, ledger: Ledger, system: FrontSystem, rules: Options
) -> tuple[FrontSystem, Renewal | None]:
    """Return the system and the renewal of its base after the next stage.

    Args:
        renewal: the renewal; None: none has begun.
        ledger: the ledger.
        system: its system.
        rules: the options.
    """
    many = len(system.update.signs) >= RENEWAL_FILL * system.most_beside
    if not many or system.section is not None or system.doubt or system.is_free:
        return system, None
    with suppress(AdjustmentError):
        inside = ledger.having("accepted")
        if (
            renewal is None
            or renewal.old.base is not system.base
            or not np.isin(renewal.draft.rows, inside).all()
        ):
            return system, Renewal(system, Draft.of(ledger, system, rules.datum))
        if renewal.solver is None:
            draft, solver = _stepped(renewal.draft)
            return system, replace(renewal, draft=draft, solver=solver)
        if renewal.made is None:
            found = renewal.draft.adjusted(
                rules.datum, tolerances=(EFFORT.close,), solver=renewal.solver
            )
            made = found.prepared() if isinstance(found, FrontSystem) else None
            return system, None if made is None else replace(renewal, made=made)
        since = np.setdiff1d(inside, renewal.draft.rows)
        return _with(renewal.made, ledger, since, system, rules) or system, None
    return system, None


def _stepped(draft: Draft) -> tuple[Draft, Solver]:
    """Return a network after a Gauss-Newton step, and its solver with its order."""
    normal, nothing = draft.normal(None)
    step = normal.factorise(nothing).solve(-normal.gradient[:, None])[:, 0]
    unknowns, start = draft.equations.unknowns, draft.start
    moved = Start(unknowns, unknowns.retract(start.state, step), start.origin)
    return replace(draft, start=moved), normal.solver


def _with(
    made: FrontSystem, ledger: Ledger, rows: Index, old: FrontSystem, rules: Options
) -> FrontSystem | None:
    """Return a new base with the later observations; None where they do not fit beside it.

    Args:
        made: the base.
        ledger: the ledger.
        rows: the later observations.
        old: the present estimates.
        rules: the options.
    """
    if not len(rows):
        return made
    found = made.bordered(ledger, rows, old.carried)
    joint = None if found is None else RowsBesideBase.of(*found)
    return None if joint is None else near_minimum(ledger, joint.after, rules, joint.forms)
