"""An adjustment from approximate values, where what is at rest does not fit.

Observations that arrive one by one find an unknown from the first few of them, which several values
may fit, as a frame does that two points leave on either side. Later observations show which it is,
and the iteration from the other one may end in a minimum of its own, at any distance. Where vᵀPv
exceeds what chance explains, the network is adjusted from approximate values of all that is in,
and the smaller vᵀPv counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..block_orientation.begin import start_of
from ..errors import AdjustmentError
from ..network.network import DatumChoice
from ..solve.start import Start
from .rebasing import Draft
from .system import System

BEYOND_CHANCE = 4.0
"""Excess of vᵀPv over the redundancy r, in units of its standard deviation √(2r), from which on a
network is adjusted from approximate values."""
LOWER = 1e-6
"""Decrease of vᵀPv relative to vᵀPv from which another minimum counts as better."""


def better_of(
    draft: Draft, found: System, datum: DatumChoice, *, tolerances: Sequence[float]
) -> System:
    """Return the system with the smaller vᵀPv: as found, or adjusted from approximate values.

    Args:
        draft: the whole network, from where everything was.
        found: its system at rest.
        datum: given or free.
        tolerances: bounds of the last step, as for `Draft.adjusted`.
    """
    if not exceeds_chance(found):
        return found
    with suppress(AdjustmentError):  # no approximate values, or nothing can be computed there
        values = start_of(draft.equations, datum, None).state
        begin = Start(draft.equations.unknowns, values, draft.start.origin)
        anew = replace(draft, start=begin).adjusted(datum, tolerances=tolerances)
        if isinstance(anew, System) and anew.base.converged:
            return anew if anew.vtpv < (1.0 - LOWER) * found.vtpv else found
    return found


def exceeds_chance(system: System) -> bool:
    """Return whether vᵀPv is larger than chance explains."""
    r = system.redundancy
    return r > 0 and system.vtpv - r > BEYOND_CHANCE * np.sqrt(2.0 * r)
