"""Local networks: what arrives beside what is known, which is held."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError
from ..graph.variables import State
from ..models.variables import parameter_kinds
from ..network.network import Network
from ..observations import ControlPoint, PhotoPosition
from ..observations.own import OwnFactor
from ..quality.snooping import snoop
from ..solve.datum import parts as parts_of
from ..solve.linear import LinearSystem
from ..solve.solution import Solution


@dataclass(frozen=True)
class Limits:
    """Limits of the search."""

    disturbed: float = 3.0
    """Value of σ̂0 of a local adjustment above which gross errors have moved it."""
    gross: float = 50.0
    """Largest whitened residual of a local adjustment that is tested after everything has moved:
    linear forms then still hold, and the tests leave out one error after the other."""
    rounds: int = 30
    """Largest number of rounds of snooping in a local network."""
    iterations: int = 30
    """Largest number of iterations of each adjustment in the snooping of a local network."""
    spare: int = 1
    """Readings beyond the number of its components that a point may have and still wait on."""
    share: float = 1e-6
    """Part of the squared length of a null vector from which on a variable is moved by it."""
    steps: int = 5
    """Largest number of steps of what enters without an adjustment of its own."""
    near: float = 1.0
    """Largest movement, in conditional standard deviations, after which it makes no further step:
    partials then hold far better than to the accuracy that is promised."""
    at_rest: float = 1e-7
    """Bound of the last step of the local adjustment that begins a free network."""
    small: int = 64
    """Largest number of rows of a part that is looked at together with others: the cost of a small
    local network is that of its arrays, whatever is in them."""


LIMITS = Limits()
"""The limits of `find` and `determined`."""


def nearer(system: LinearSystem) -> State | None:
    """Return the state after a few Gauss-Newton steps; none where they do not become short."""
    equations, state = system.equations, system.state
    for _ in range(LIMITS.steps):
        a = system.sparse(np.arange(equations.n_rows)).toarray()
        if not (np.isfinite(a).all() and np.isfinite(system.residual).all()):
            return None
        scale = np.sqrt(np.sum(a**2, axis=0))
        moving = equations.unknowns.free & (scale > 0.0)
        step = np.linalg.lstsq(a[:, moving] / scale[moving], -system.residual, rcond=None)[0]
        whole = np.zeros(len(scale))
        whole[moving] = step / scale[moving]
        state = equations.unknowns.retract(state, whole)
        if np.abs(step).max(initial=0.0) < LIMITS.near:
            return state
        system = LinearSystem(equations.weighted_at(state), state)
    return None


def calm(solution: Solution) -> bool:
    """Return whether no part of a network is disturbed: σ̂0 of each."""
    equations = solution.equations
    unknowns, label = equations.unknowns, parts_of(equations)
    of_rows = [
        np.repeat(
            label[np.max([unknowns[kind].offset[at] for kind, at in b.variables], axis=0)],
            b.dimension,
        )
        for b in equations.blocks
    ]
    rows = np.concatenate(of_rows)
    v = equations.residuals(solution.state)
    vtpv = np.bincount(rows, weights=v**2, minlength=len(label))
    spare = np.bincount(rows, minlength=len(label))
    spare -= np.bincount(label[unknowns.free], minlength=len(label))
    return bool((vtpv <= LIMITS.disturbed**2 * np.maximum(spare, 1)).all())


def placed(local: Network) -> bool:
    """Return whether anything says where a local network is; its rank need not be looked at."""
    return (
        any(p.sigma is not None or any(p.fixed) for p in local.points.values())
        or any(f.sigma_position is not None or any(f.fixed[3:]) for f in local.photos.values())
        or any(isinstance(o, ControlPoint | PhotoPosition) for o in local.observations.values())
        or any(all(p.fixed) for kind in _FRAMES for p in local.of_kind(kind).values())
    )


def may_be_placed(local: Network) -> bool:
    """Return whether an observation may say where a local network is; its rank tells."""
    every = local.observations.values()
    return any(isinstance(o, OwnFactor) or o.record.fixes != "nothing" for o in every)


_FRAMES = tuple(k.name for k in parameter_kinds() if k.rotates and k.connects)
"""Kinds of parameters that place what is measured in them, once they are known."""


def without_blunders(solution: Solution, alpha: float) -> Solution:
    """Return the solution where the network is without what stands out."""
    try:
        clean = snoop(
            solution.network,
            start=solution,
            alpha=alpha,
            max_rounds=LIMITS.rounds,
            max_iterations=LIMITS.iterations,
        )
    except AdjustmentError:
        return solution
    unknowns, found = solution.equations.unknowns, clean.solution
    state = unknowns.carried(solution.state, found.equations.unknowns, found.state)
    return replace(solution, state=state)
