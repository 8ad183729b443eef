"""What a free network leaves open, and whether an arriving observation notices it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations, compile_rows
from ..graph.variables import State
from ..network.network import Network
from ..solve.datum import About, find_defects, generators, middle
from ..solve.linear import LinearSystem
from ..types import Array
from .local import local_network, local_state
from .register import Register
from .units import Unit

NOTICED = 1e-6
"""|A g| relative to Σ|A||g|, from which on an observation notices a motion."""


@dataclass(frozen=True)
class OpenMotions:
    """Motions of the object that no observation of the network notices."""

    mixture: Array
    """Combinations of the seven motions of a similarity transformation, (7, d)."""
    about: About
    """Their centre and the distance that scales them."""

    @classmethod
    def of(cls, equations: Equations, state: State) -> OpenMotions | None:
        """Find them for a whole network; none where it is not one connected part."""
        system = LinearSystem(equations, state)
        defects = find_defects(system, state, system.diagonal(), free=True)
        return cls(defects[0].mixture, middle(state)) if len(defects) == 1 else None

    def noticed(self, network: Network, register: Register, units: Iterable[Unit]) -> bool:
        """Return whether any of some units notices one of them."""
        local = local_network(network, Register(), units)
        equations = compile_rows(local)
        if not equations.unknowns.n_columns:
            return False
        state = local_state(equations, register)
        equations = equations.weighted_at(state)
        a = LinearSystem(equations, state).times(np.eye(equations.unknowns.n_columns))
        g = generators(equations, state, self.about) @ self.mixture
        return bool(np.any(np.abs(a @ g) > NOTICED * (np.abs(a) @ np.abs(g)) + 1e-300))
