"""An adjustment from approximate values, which may end in another minimum than where everything is.

Observations that arrive one by one find an unknown from the first few of them, which several values
may fit, as a frame does that two points leave on either side; a gross error that was in for a time
may have led an unknown there, too. Later observations show which it is, and the iteration from the
other one may end in a minimum of its own, at any distance. At rest, the network is therefore
adjusted from approximate values of all that is in as well, as `adjust` does it. The smaller vᵀPv
counts, and the solution tells of the other one. In large networks, where this takes as long as the
rest, it is done where vᵀPv exceeds what chance explains.

"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..block_orientation.begin import start_of
from ..errors import AdjustmentError
from ..linear_system.front_system import FrontSystem
from ..linear_system.rebase import Draft
from ..network.network import DatumChoice
from ..solve.second_start import describe_other_minimum
from ..solve.start import Start

MAX_CHANCE_EXCESS = 4.0
"""Excess of vᵀPv over the redundancy r, in units of its standard deviation √(2r), from which on a
network is adjusted from approximate values."""
MIN_RELATIVE_DECREASE = 1e-6
"""Decrease of vᵀPv, relative to 1 + vᵀPv, from which another minimum counts as better."""
LARGE_NETWORK_UNKNOWNS = 3_000
"""Number of unknowns from which on a network is large."""


def smaller_minimum(
    draft: Draft, found: FrontSystem, datum: DatumChoice, *, tolerances: Sequence[float]
) -> FrontSystem:
    """Return the system with the smaller vᵀPv: as found, or adjusted from approximate values.

    It tells of the other, if these are two.

    Args:
        draft: the whole network, from where everything was.
        found: its system at rest.
        datum: given or free.
        tolerances: bounds of the last step, as for `Draft.adjusted`.
    """
    if draft.equations.unknowns.n_columns > LARGE_NETWORK_UNKNOWNS and not exceeds_chance(found):
        return found
    with suppress(AdjustmentError):  # no approximate values, or nothing can be computed there
        values = start_of(draft.equations, datum, None).state
        begin = Start(draft.equations.unknowns, values, draft.start.origin)
        anew = replace(draft, start=begin).adjusted(datum, tolerances=tolerances)
        if isinstance(anew, FrontSystem) and anew.converged:
            least = MIN_RELATIVE_DECREASE * (1.0 + min(found.vtpv, anew.vtpv))
            if anew.vtpv < found.vtpv - least:
                return _with_other(anew, found)
            if found.vtpv < anew.vtpv - least:
                return _with_other(found, anew)
    return found


def _with_other(system: FrontSystem, other: FrontSystem) -> FrontSystem:
    """Return a system at rest whose solution tells of another minimum."""
    return system.with_second_place(describe_other_minimum(system.solution, other.solution))


def exceeds_chance(system: FrontSystem) -> bool:
    """Return whether vᵀPv is larger than chance explains."""
    r = system.redundancy
    return r > 0 and system.vtpv - r > MAX_CHANCE_EXCESS * np.sqrt(2.0 * r)
