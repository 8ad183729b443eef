"""Mistakes without which a bent block fits: exchanged names, wrong control, principal distances.

Two image points of a photo with each other's names, a control point with the coordinates of
another or with a height of the wrong sign, a principal distance in another unit: the adjustment of
such a block ends far from the truth, where what was given of the camera seems to explain most. So
the block is adjusted again from its approximate values, once for each mistake as if it had not been
made: with the names exchanged, without the coordinates of the point, with the principal distance
unknown. The mistake is that without which nearly everything fits. Mistakes without which everything
fits as well are named together.

Which image points may have other names is known before any adjustment: they do not agree with the
orientation from image points, and lie where the other point is computed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...adjustment import adjust
from ...errors import AdjustmentError
from ...graph.equations import Equations
from ...graph.observation_selection import without
from ...graph.variables import State
from ...network.network import Network
from ...orientation.choice_of_start import image_start
from ...solve.solution import Solution
from ...start.start_values import Start
from ...statistical_tests import normal_quantile
from ...types import Array
from ...units import significant
from .evidence import VarianceFactor
from .exchanged_images import (
    EXCHANGED_IMAGE_POINTS,
    blocks_of_images,
    ids_of_rays,
    image_misfits,
    image_point_exchanges,
    with_exchanged_names,
)
from .mistaken_identity import MistakenIdentity
from .separability import MIN_T2_DIFFERENCE

BENT_TEST_VALUE = 100.0
"""Test value of a row beyond which a block may be bent."""
MAX_RAYS_OF_BENT_BLOCK = 5000
"""Largest number of image points of a block that is adjusted for every mistake."""
MAX_MISTAKE_ITERATIONS = 15
"""Largest number of iterations of an adjustment: without the mistake it is near its minimum."""
MIN_FIT_WITHOUT_MISTAKE = 0.95
"""Smallest share of all rows that fit without the mistake; the others may be gross errors."""
MAX_VTPV_SHARE = 0.01
"""Largest part of vᵀPv that a mistake leaves."""
MAX_TRIED_CONTROL_POINTS = 6
"""Largest number of control points that are tried, those whose rays misfit most."""
MAX_FIT_OF_BENT_BLOCK = 0.7
"""Share of the rows that fit from which on a block is not bent as a whole: then control and cameras
are left to linear tests."""
C_DIGITS = 5
"""Digits of a principal distance."""
MAX_SIGN_MISFIT_SIGMAS = 10.0
"""Largest distance of a coordinate from that with the other sign, in standard deviations."""


@dataclass(frozen=True, eq=False)
class _Mistake:
    """A mistake, and the network as if it had not been made."""

    cause: str
    places: tuple[str, ...]
    network: Network
    ids: tuple[tuple[str, ...], ...]
    """Ids of the image points that are concerned, for each place."""
    named: Callable[[Solution], str] | None = None
    """Returns what is wrong from the adjustment without it; None: `cause`."""
    fitting: Callable[[Solution], str] | None = None
    """Returns what fits, as an addition to the place; None: no addition."""
    aside: bool = False
    """Whether its image points may be rejected for it."""


@dataclass(frozen=True, eq=False)
class _Fitting:
    """A mistake without which nearly everything fits."""

    mistake: _Mistake
    solution: Solution

    @property
    def named(self) -> str:
        """What was wrong."""
        m = self.mistake
        return m.cause if m.named is None else m.named(self.solution)


@dataclass(frozen=True, eq=False)
class BlockMistake:
    """A mistake without which nearly everything in a block fits."""

    match: MistakenIdentity
    """Its description."""
    solution: Solution
    """The adjustment without it."""
    aside: tuple[str, ...]
    """Ids of what may be rejected for it; empty if it is in given values."""


def block_mistakes(
    solution: Solution, alpha: float, *, estimated: bool = False
) -> tuple[BlockMistake, ...]:
    """Look for a mistake without which nearly everything in a bent block fits.

    Args:
        solution: the adjustment of everything, or where it ended.
        alpha: probability with which a row that is right does not fit.
        estimated: whether σ0 is estimated; otherwise it is 1.
    """
    equations = solution.equations
    if solution.extra.n_rows or not 0 < equations.n_rays <= MAX_RAYS_OF_BENT_BLOCK:
        return ()
    v = np.abs(np.nan_to_num(equations.residuals(solution.state)))
    unit = float(np.median(v)) if estimated else 1.0
    if not np.max(v, initial=0.0) > BENT_TEST_VALUE * unit:
        return ()
    begin = image_start(solution.network, None)
    state = solution.start if begin is None else begin.state
    critical = unit * normal_quantile(1.0 - 0.5 * alpha)
    bent = float(np.mean(v <= critical)) < MAX_FIT_OF_BENT_BLOCK
    off = _rays_off(equations, state)
    for every in (
        _image_names(equations, state),
        _as_single_errors(solution.network, begin) if bent else (),
        (*_control(equations, off), *_cameras(equations)) if bent else (),
        _exchanged_control(equations, off) if bent else (),
    ):
        fitting = [f for m in every if (f := _without(m, solution, alpha, estimated)) is not None]
        if fitting:
            return tuple(_found(fitting, float(v @ v)))
    return ()


def _as_single_errors(network: Network, begin: Start | None) -> Iterator[_Mistake]:
    """Iterate over the network without image points that do not agree with the others.

    Where it fits, these are gross errors of single readings, and no other mistake was made.
    """
    if begin is not None and begin.doubtful and not begin.unreached:
        yield _Mistake("", (), without(network, begin.doubtful), ())


def _without(
    mistake: _Mistake, solution: Solution, alpha: float, estimated: bool
) -> _Fitting | None:
    """Return a mistake, if nearly everything fits without it."""
    try:
        found = adjust(
            mistake.network,
            datum="given" if solution.datum is None else "free",
            max_iterations=MAX_MISTAKE_ITERATIONS,
        )
    except AdjustmentError:
        return None
    if not found.converged or not found.vtpv < MAX_VTPV_SHARE * solution.vtpv:
        return None
    squares = np.square(found.equations.residuals(found.state))
    critical = VarianceFactor.left_by(found, estimated=estimated).limit(1, alpha)
    return (
        _Fitting(mistake, found)
        if np.mean(squares <= critical) >= MIN_FIT_WITHOUT_MISTAKE
        else None
    )


def _found(fitting: list[_Fitting], before: float) -> Iterator[BlockMistake]:
    """Iterate over the places of the mistake that explains most; others as good go with it."""
    best = min(fitting, key=lambda f: f.solution.vtpv)
    after, mistake = best.solution.vtpv, best.mistake
    others = [f for f in fitting if f is not best and f.solution.vtpv < after + MIN_T2_DIFFERENCE]
    same = tuple(f"{f.named} {place}" for f in others for place in f.mistake.places)
    more = "" if mistake.fitting is None else mistake.fitting(best.solution)
    for place, ids in zip(mistake.places, mistake.ids, strict=True):
        match = MistakenIdentity(best.named, place + more, ids, before, after, same=same)
        yield BlockMistake(match, best.solution, ids if mistake.aside else ())


# -- image points --------------------------------------------------------------------------------


def _image_names(equations: Equations, state: State) -> Iterator[_Mistake]:
    """Iterate over all image points that lie where others are computed, exchanged together."""
    found = tuple(image_point_exchanges(equations, state, lambda off: off > BENT_TEST_VALUE))
    if found:
        network = with_exchanged_names(equations.network, found)
        ids = tuple(e.ids for e in found)
        yield _Mistake(EXCHANGED_IMAGE_POINTS, tuple(map(str, found)), network, ids, aside=True)


def _rays_off(equations: Equations, state: State) -> Array:
    """Return the largest misfit of the rays of each point in a state, (n,)."""
    out = np.zeros(len(equations.unknowns["point"].names))
    for block in blocks_of_images(equations):
        np.maximum.at(out, dict(block.variables)["point"], image_misfits(equations, block, state))
    return out


# -- control -------------------------------------------------------------------------------------


def _control_points(equations: Equations, off: Array) -> list[str]:
    """Return the points with given coordinates that are tried, those off most first."""
    table = equations.unknowns["point"]
    given = (~table.free | np.isfinite(table.sigma)).any(axis=1) & (off > 0.0)
    order = np.argsort(-off, kind="stable")
    return [table.names[p] for p in order.tolist() if given[p]][:MAX_TRIED_CONTROL_POINTS]


def _control(equations: Equations, off: Array) -> Iterator[_Mistake]:
    """Iterate over control points as if nothing were given of them."""
    for name in _control_points(equations, off):
        network = equations.network.copy()
        point = network.points[name]
        network.points[name] = replace(point, fixed=(False,) * 3, sigma=None)
        named = _ControlName(name, np.array(point.coordinates))
        ids = (ids_of_rays(equations, "point", (name,)),)
        yield _Mistake("the given coordinates", (f"of point {name!r}",), network, ids, named)


@dataclass(frozen=True, eq=False)
class _ControlName:
    """What is wrong with given coordinates, by where the point is without them."""

    name: str
    given: Array

    def __call__(self, solution: Solution) -> str:
        at, sigma = solution.point(self.name), solution.standard_deviations(self.name)
        wrong = np.abs(at - self.given) > MAX_SIGN_MISFIT_SIGMAS * sigma
        mirrored = wrong & (np.abs(at + self.given) <= MAX_SIGN_MISFIT_SIGMAS * sigma)
        if mirrored.any() and not (wrong & ~mirrored).any():
            axes = [a for a, m in zip("xyz", mirrored, strict=True) if m]
            return f"the sign of the given {' and '.join(axes)}"
        return "the given coordinates"


def _exchanged_control(equations: Equations, off: Array) -> Iterator[_Mistake]:
    """Iterate over pairs of control points with the coordinates of each other."""
    for a, b in combinations(sorted(_control_points(equations, off)), 2):
        network = equations.network.copy()
        one, other = network.points[a], network.points[b]
        network.points[a] = replace(other, name=a)
        network.points[b] = replace(one, name=b)
        places = (f"of points {a!r} and {b!r}",)
        ids = (ids_of_rays(equations, "point", (a, b)),)
        yield _Mistake("the given coordinates, exchanged,", places, network, ids)


# -- cameras -------------------------------------------------------------------------------------


def _cameras(equations: Equations) -> Iterator[_Mistake]:
    """Iterate over cameras whose principal distance is held, as if it were unknown."""
    used = {photo.camera for photo in equations.network.photos.values()}
    for name in sorted(used):
        camera = equations.network.cameras[name]
        at = camera.lens.names.index("c") if "c" in camera.lens.names else None
        if at is None or not camera.fixed[at]:
            continue
        network = equations.network.copy()
        fixed = tuple(f and k != at for k, f in enumerate(camera.fixed))
        network.cameras[name] = replace(camera, fixed=fixed)
        of_camera = [n for n, p in network.photos.items() if p.camera == name]
        ids = ids_of_rays(equations, "pose", of_camera)
        where = (f"of camera {name!r}",)
        fitting = _FittingDistance(name, camera.values[at])
        yield _Mistake("the given c", where, network, (ids,), fitting=fitting)


@dataclass(frozen=True)
class _FittingDistance:
    """The principal distance that fits."""

    camera: str
    given: float

    def __call__(self, solution: Solution) -> str:
        fitting = solution.calibration(self.camera)["c"]
        return f", {significant(self.given, C_DIGITS)}, where {significant(fitting, C_DIGITS)} fits"
