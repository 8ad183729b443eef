"""Local networks of arrivals: limits, datum, Gauss-Newton steps, blunders, oriented photos.

Photos may arrive without poses. Resection from known points and observations of a pose come first,
as approximate values. Photos for which these do not suffice are oriented from image points, against
oriented photos and among themselves, as a block is; known photos and points that it touches
determine its place in the frame. Photos that cannot be oriented wait.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ..errors import AdjustmentError, ApproximationError, Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.unknown_registry import parameter_kinds
from ..network.network import DatumChoice, Network
from ..observations.base import of_quantities
from ..observations.registry import POSITION_QUANTITIES
from ..observations.user_factor import OwnFactor
from ..orientation.block_start import BlockStart
from ..orientation.choice_of_start import block_start_from_images
from ..orientation.partial_block import MIN_PAIR_POINTS
from ..quality.snooping import snoop
from ..solve.datum_defects import connected_parts as parts_of
from ..solve.linearised_equations import LinearisedEquations
from ..solve.solution import Solution
from ..types import Mask

DISAGREES = "fewer than two of its image points agree with the photos that were oriented"
"""Reason of a point without enough agreeing image points."""
MISMATCH = "it does not agree with the block that its photo was oriented in"
"""Reason of an image point that waits until its point is known."""
_FRAMES = tuple(k.name for k in parameter_kinds() if k.rotates and k.connects)
"""Kinds of parameters that place what is measured in them, once they are known."""


@dataclass(frozen=True)
class Limits:
    """Limits of the search for determined unknowns."""

    disturbed: float = 3.0
    """Value of σ̂0 of a local adjustment above which gross errors have displaced it."""
    gross: float = 50.0
    """Largest whitened residual of a local adjustment whose tests may wait until everything has
    moved: up to it linear forms hold, and the tests leave out one error after the other."""
    rounds: int = 30
    """Largest number of rounds of snooping in a local network."""
    iterations: int = 30
    """Largest number of iterations of each adjustment in the snooping of a local network."""
    spare: int = 1
    """A point with at most this many redundant readings may be postponed."""
    share: float = 1e-6
    """Share of the squared length of a null vector from which a variable counts as moved by it."""
    steps: int = 5
    """Largest number of steps of entering unknowns without an adjustment of their own."""
    near: float = 1.0
    """Largest movement, in conditional standard deviations, after which they make no further step:
    partials then hold far better than to the promised accuracy."""
    at_rest: float = 1e-7
    """Bound of the last step of the local adjustment that begins a free network."""
    small: int = 64
    """Largest number of rows of a part that is examined together with others: the cost of a small
    local network is that of its arrays, whatever is in them."""


LIMITS = Limits()
"""The limits of `find` and `determined`."""


def gauss_newton_steps(system: LinearisedEquations) -> State | None:
    """Return the state after a few Gauss-Newton steps; None where these do not become short."""
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
        system = LinearisedEquations(equations.weighted_at(state), state)
    return None


def is_undisturbed(solution: Solution) -> bool:
    """Return whether no part of a network is disturbed, by σ̂0 of each."""
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


def has_datum(local: Network) -> bool:
    """Return whether anything determines where a local network is, without its rank."""
    return (
        any(p.sigma is not None or any(p.fixed) for p in local.points.values())
        or any(f.sigma_position is not None or any(f.fixed[3:]) for f in local.photos.values())
        or any(of_quantities(local.observations.values(), *POSITION_QUANTITIES))
        or any(all(p.fixed) for kind in _FRAMES for p in local.of_kind(kind).values())
    )


def may_have_datum(local: Network) -> bool:
    """Return whether an observation may determine the position of a local network, by its rank."""
    every = local.observations.values()
    return any(isinstance(o, OwnFactor) or o.record.fixes != "nothing" for o in every)


def without_blunders(solution: Solution, alpha: float) -> Solution:
    """Return the solution of the network without significant observations."""
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


def oriented_block(
    equations: Equations, datum: DatumChoice, state: State, problems: list[Problem]
) -> BlockStart | None:
    """Return the block of photos that were oriented from their image points.

    Args:
        equations: a local network; known variables are held.
        datum: ``free`` for the beginning of a free network.
        state: approximate values as far as they were found, NaN elsewhere.
        problems: variables without approximate values.

    Returns:
        None: no photo without a pose has `MIN_PAIR_POINTS` points in common with another one, or
        none could be oriented.
    """
    lost: Mask = np.asarray(np.isnan(state["pose"]).any(axis=1))
    if not lost.any() or not _common(equations.network, lost):
        return None
    names = equations.unknowns["pose"].names
    error = ApproximationError(problems, photos=[names[i] for i in np.flatnonzero(lost)])
    with suppress(ApproximationError):
        return block_start_from_images(equations, datum, error, whole=False)
    return None


def _common(network: Network, lost: Mask) -> bool:
    """Return whether a photo without a pose has enough points in common with any other."""
    photo, point, _, _ = network.images.columns()
    if not len(photo):
        return False
    ones = np.ones(len(photo), dtype=np.int64)
    table = sparse.csr_array((ones, (photo, point)), shape=(len(lost), len(network.points)))
    common = (table[lost] @ table.T).tocoo()
    own = np.flatnonzero(lost)[common.row] == common.col
    return bool((common.data[~own] >= MIN_PAIR_POINTS).any())


def orientation_methods(local: Network, block: BlockStart | None) -> Mapping[str, str]:
    """Return in words how the entering photos of a local network were oriented.

    Args:
        local: the local network, in which known photos and points are held.
        block: the block that was oriented from image points; None: no photo was.
    """
    out: dict[str, str] = {}
    of_block = {} if block is None else {f: p for p in block.parts for f in p.photos}
    photo, point, _, _ = local.images.columns()
    held = np.array([all(p.fixed) for p in local.points.values()], dtype=bool)
    known = np.bincount(photo[held[point]], minlength=len(local.photos)) if len(photo) else ()
    for number, (name, f) in enumerate(local.photos.items()):
        if f.rotation is not None:
            continue
        part = of_block.get(name)
        if part is not None:
            standing = sum(local.photos[o].rotation is not None for o in part.photos)
            among = f"{len(part.photos)} photos" + (
                f", {standing} of which had poses" * bool(standing)
            )
            out[name] = (
                f"from image points among {among}: start pair {part.start[0]}, {part.start[1]}; "
                f"{part.datum}"
            )
        elif len(known) and known[number] >= 3:
            out[name] = f"by resection from {known[number]} known points"
        else:
            out[name] = "by approximate values of what entered with it"
    return out
