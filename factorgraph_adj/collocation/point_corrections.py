"""Corrections of adjusted points from the residuals at control or check points: Ayeni's method 20.

After an adjustment of independent models or bundles, the differences

    ℓ = known − adjusted = A x + s + n

at control (weighted coordinates and `ControlPoint`, n with their σ), or at check points, have a
part that neighbours share, the systematic deformation s of the block. Collocation filters it from
the noise and predicts it at every point, with its σ. Components are east, north and up at each
point; distances are those in plan. East and north share a covariance function, heights have
another.

The adjustment has bent the block towards weighted control already, so that its residuals are
smaller than the signal; `factorgraph_adj.collocation.signal_variables` estimates block and signal
at once. Both agree where control only places the block, and determines none of its shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from ..errors import InputError, known, refuse_other_types, unknown_name
from ..frames import GeocentricFrame
from ..network.network import Network
from ..observations.positions import ControlPoint
from ..quality.point_precision import along_horizon, check_points
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import (
    ALPHA_OF_MODEL,
    chi2_lower_probability,
    chi2_upper_probability,
)
from ..types import Array
from .collocation import Collocation, Prediction, collocate
from .covariance_estimation import CovarianceEstimate, estimate_covariance
from .covariance_function import CovarianceFunction
from .signal_test import SignalTest, signal_test

KnownPoints: TypeAlias = Literal["control", "check"]
"""Which known coordinates are compared."""
StatedCovariance: TypeAlias = CovarianceFunction | str | None
"""Covariance function; or its kind, of which σ and L are estimated; None: no signal."""
COMPONENTS = ("east", "north", "up")
"""Components of corrections."""
PLAN, HEIGHT = slice(0, 2), slice(2, 3)
"""Those in plan and in height."""
FAR_NOISE = 10.0
"""Factor by which noise must exceed the RMS of residuals to be refused: no scatter of them."""
MILLIMETRES = 1.0
"""Smallest noise, metres, that is taken for one in millimetres."""
FAR_SIZE = 2.0
"""Factor between σ̂0 and 1 from which the stated covariance is doubted, if it is significant."""
ALPHA_OF_SIZE = 0.001
"""Error probability of both tests."""
LEAST_NOISE_M = 1e-9
"""σ of noise that stands for an errorless coordinate where only the ratios of σ count, metres."""


@dataclass(frozen=True)
class KnownResiduals:
    """Known − adjusted coordinates at points, along east, north and up, metres."""

    names: tuple[str, ...]
    """Names of the points, n."""
    plan: Array
    """Their places in plan, (n, 2)."""
    values: Array
    """Known − adjusted, (n, 3); NaN where a component is not known."""
    sigmas: Array
    """σ of the known coordinates, (n, 3); NaN where it is not known."""


@dataclass(frozen=True, eq=False, repr=False)
class PointCorrections(Shown):
    """Corrections of all points by collocation of the residuals at known ones, metres."""

    collocation: Collocation
    """Trend, signal and noise at the known points."""
    components: tuple[str, ...]
    """Its components: some of east, north, up."""
    names: tuple[str, ...]
    """Names of the corrected points, m."""
    prediction: Prediction
    """Corrections along east, north and up, with the covariance of their errors, m points."""
    coordinates: Array
    """Corrected coordinates in the frame of the network, (m, 3)."""
    formal_sigmas: Array
    """σ of the adjusted coordinates along east, north, up, (m, 3); NaN without a covariance."""
    estimates: tuple[CovarianceEstimate | None, CovarianceEstimate | None]
    """Estimated covariance functions in plan and in height; None where one was stated."""
    tests: tuple[SignalTest | None, SignalTest | None]
    """Moran's tests of a signal in plan and in height; None with fewer than three points."""
    remarks: tuple[str, ...]
    """What speaks against the corrections, as sentences."""

    @property
    def sigmas(self) -> Array:
        """σ of the corrected coordinates: of adjustment and prediction, as if independent, (m, 3).

        Components without a signal and a trend keep the σ of the adjustment.
        """
        return np.hypot(self.formal_sigmas, self.prediction.sigmas)

    def headline(self) -> str:
        """Return how many points there are, and remarks."""
        said = "".join(f"; {r}" for r in self.remarks)
        return (
            f"PointCorrections: {len(self.names)} points from {self.collocation.headline()}{said}"
        )

    def first_rows(self) -> Rows:
        """Return the corrections of the first points, metres."""
        cells = np.hstack([self.prediction.values, self.prediction.sigmas])
        return Rows(
            ("point", "east", "north", "up", "σ e", "σ n", "σ u"),
            ((n, *map(float, row)) for n, row in zip(self.names, cells, strict=True)),
            len(self.names),
        )


def known_residuals(solution: Solution, use: KnownPoints = "control") -> KnownResiduals:
    """Return known − adjusted coordinates of control or check points along east, north, up.

    Args:
        solution: the adjustment.
        use: ``control``: weighted coordinates and observed control; ``check``: check points, of
            whose coordinates no σ is known.

    Raises:
        InputError: there are no such points. Held coordinates have no residuals.
    """
    network = solution.network
    if use not in get_args(KnownPoints):
        raise InputError(f"use must be one of control, check, not {use!r}")
    if use == "check":
        checks = check_points(solution)
        if not checks.names:
            raise InputError("the network has no check points: state check coordinates of points")
        at = np.array([solution.point(n) for n in checks.names])
        values = -checks.east_north_up
        unknown = np.full(values.shape, np.nan)
        return KnownResiduals(checks.names, plan_of(network, at), values, unknown)
    controls = [o for o in network.observations.values() if isinstance(o, ControlPoint)]
    rows = [(o.point, *_of_control(o, solution)) for o in controls]
    for p in network.points.values():
        sigma = np.array(p.sigma if p.sigma is not None else (np.inf,) * 3)
        on = np.isfinite(sigma) & ~np.array(p.fixed)
        if on.any():
            d = np.where(on, np.array(p.coordinates) - solution.point(p.name), np.nan)
            rows.append(
                (p.name, *_turned(solution, p.name, d, np.diag(np.where(on, sigma, 0.0) ** 2)))
            )
    if not rows:
        raise InputError(
            "no control has residuals: give control coordinates a σ (held ones have none), or use "
            "check points"
        )
    names, differences, variances = zip(*rows, strict=True)
    values = np.array(differences)
    at = np.array([solution.point(n) for n in names])
    sigmas = np.where(np.isnan(values), np.nan, np.sqrt(np.array(variances)))
    return KnownResiduals(tuple(names), plan_of(network, at), values, sigmas)


def _of_control(o: ControlPoint, solution: Solution) -> tuple[Array, Array]:
    """Return known − adjusted along east, north, up, NaN where not known, and its variances."""
    own = covariance_of_control(o)
    difference, full = np.full(3, np.nan), np.zeros((3, 3))
    at = solution.point(o.point)
    if not o.local:
        on = ["xyz".index(a) for a in o.axes]
        difference[on], full[np.ix_(on, on)] = np.asarray(o.value) - at[on], own
        return _turned(solution, o.point, difference, full)
    on = ["enu".index(a) for a in o.axes]
    whole, _ = _turned(solution, o.point, np.asarray(o.value) - at, full)
    difference[on], full[np.ix_(on, on)] = whole[on], own
    return difference, np.diag(full)


def covariance_of_control(o: ControlPoint) -> Array:
    """Return the covariance of the components of observed control."""
    if o.covariance is not None:
        return np.asarray(o.covariance, dtype=float)
    return np.diag(np.square(np.array(o.sigma, dtype=float)))


def _turned(
    solution: Solution, point: str, difference: Array, covariance: Array
) -> tuple[Array, Array]:
    """Return a difference in the axes of the frame along east, north, up, and its variances."""
    frame, at = solution.network.frame, solution.point(point)[None]
    enu = frame.basis(at, np.zeros((1, 2))).enu[0]
    return along_horizon(frame, at, difference[None])[0], np.diag(enu @ covariance @ enu.T)


def plan_of(network: Network, at: Array) -> Array:
    """Return places in plan: east and north in the horizon at the middle of all points, (n, 2)."""
    every = np.array([p.coordinates for p in network.points.values()], dtype=float)
    middle = np.nanmean(every, axis=0)
    enu = network.frame.basis(middle[None], np.zeros((1, 2))).enu[0]
    return np.asarray((at - middle) @ enu[:2].T)


def point_corrections(
    solution: Solution,
    *,
    covariance: StatedCovariance = "gaussian",
    height: StatedCovariance | Literal["same"] = "same",
    trend: str = "none",
    use: KnownPoints = "control",
    noise: float | Sequence[float] | None = None,
    points: Sequence[str] | None = None,
    alpha: float = ALPHA_OF_MODEL,
) -> PointCorrections:
    """Predict corrections of all points from the residuals at control or check points.

    Args:
        solution: the adjustment.
        covariance: covariance function of east and north, metres; or its kind, of which σ and L
            are estimated from the residuals; None: no correction in plan.
        height: the same of heights; ``same``: kind, or function, of the plan.
        trend: ``none``, ``mean``, ``plane`` or ``similarity``, see
            `factorgraph_adj.collocation.trend`. The adjustment has placed the block on its
            control, which leaves no trend; at check points there may be one.
        use: ``control``, or ``check`` for the check points.
        noise: σ of the known coordinates instead of the stated ones, metres: of all components, or
            of east, north and up. Without it that of check points is estimated, together with the
            covariance function; a stated function needs it.
        points: names of the points that are corrected; by default all.
        alpha: probability with which the test finds a signal where there is none; 1: a signal is
            taken for granted.

    Returns:
        The corrections. A part, plan or heights, of which nothing is known and every coordinate is
        held has none: plan networks have no heights.

    Raises:
        InputError: there are no known points with residuals, the residuals have no signal from
            which a function could be estimated, they are far smaller than ``noise``, no noise is
            known where a function is stated, or a name is unknown.
    """
    refuse_other_types(solution, Solution, "point_corrections")
    residuals = known_residuals(solution, use)
    sigma = residuals.sigmas.copy()
    if noise is not None:
        sigma[:] = noise
    names = tuple(solution.network.points) if points is None else tuple(points)
    if unknown := [n for n in names if n not in solution.network.points]:
        raise InputError(unknown_name("point", unknown[0], solution.network.points))
    estimates: list[CovarianceEstimate | None] = []
    functions: list[CovarianceFunction | None] = []
    tests: list[SignalTest | None] = []
    remarks: list[str] = []
    for stated, part, word in ((covariance, PLAN, "plan"), (height, HEIGHT, "heights")):
        given = covariance if isinstance(stated, str) and stated == "same" else stated
        values = residuals.values[:, part]
        enough = np.isfinite(values).sum(axis=0).min() >= 3
        each = trend if trend != "similarity" or part is PLAN else "mean"
        if not enough and isinstance(given, str):
            if np.isfinite(values).any() or not _is_held(solution, part):
                remarks.append(f"{word}: fewer than three known points, no correction")
            given = None
        own: Array | None = np.maximum(sigma[:, part], LEAST_NOISE_M)
        if np.isnan(sigma[:, part][np.isfinite(values)]).any():
            own = None
            if isinstance(given, CovarianceFunction) and np.isfinite(values).any():
                raise InputError(
                    f"{word}: no σ of check coordinates is known: state the noise, or give only "
                    f"the kind of the covariance function, {given.kind}, with which it is estimated"
                )
        estimate: CovarianceEstimate | None = None
        test: SignalTest | None = None
        if isinstance(given, str):
            if noise is not None:
                _refuse_large_noise(values, sigma[:, part], word)
            try:
                estimate = estimate_covariance(
                    residuals.plan, values, kind=given, noise=own, trend=each, alpha=alpha
                )
            except InputError as error:
                raise InputError(f"{word}: {error}") from None
            given, test = estimate.function, estimate.test
            if own is None:
                sigma[:, part] = estimate.noise
            remarks += [f"{word}: {r}" for r in estimate.remarks]
        elif given is not None and enough:
            test = signal_test(
                residuals.plan,
                values,
                noise=1.0 if own is None else own,
                trend=each,
                alpha=min(alpha, 1 - 1e-12),
            )
            if not test.has_signal:
                remarks.append(f"{word}: {test.headline()}")
        if given is not None and np.isfinite(values).any():
            remarks += _wrong_size(residuals.plan, values, given, sigma[:, part], each, word)
        functions += [given] * values.shape[1]
        estimates.append(estimate)
        tests.append(test)
    values = residuals.values
    on = [k for k, f in enumerate(functions) if f is not None and np.isfinite(values[:, k]).any()]
    if not on:
        raise InputError(f"no component has a signal and known points: {known(remarks)}")
    usable = np.flatnonzero(np.isfinite(values[:, on]).any(axis=1))
    found = collocate(
        residuals.plan[usable],
        values[usable][:, on],
        covariance=[functions[k] for k in on],
        noise=sigma[usable][:, on],
        trend=trend,
        names=[residuals.names[i] for i in usable],
    )
    at = np.array([solution.point(n) for n in names])
    prediction = _of_all_components(found.predict(plan_of(solution.network, at)), on)
    enu = solution.network.frame.basis(at, np.zeros((len(at), 2))).enu
    corrected = at + np.einsum("nij,ni->nj", enu, prediction.values)
    return PointCorrections(
        found,
        tuple(COMPONENTS[k] for k in on),
        names,
        prediction,
        corrected,
        _formal_sigmas(solution, names, enu),
        (estimates[0], estimates[1]),
        (tests[0], tests[1]),
        tuple(remarks),
    )


def _is_held(solution: Solution, part: slice) -> bool:
    """Whether every point has its coordinates of a part held in a frame with heights as z."""
    network = solution.network
    if isinstance(network.frame, GeocentricFrame):
        return False
    return all(np.array(p.fixed)[part].all() for p in network.points.values())


def _refuse_large_noise(values: Array, sigma: Array, word: str) -> None:
    """Raise InputError if stated noise is far larger than all residuals of plan or heights."""
    on = np.isfinite(values) & (sigma > 0)
    v, own = values[on], sigma[on]
    square = float(np.sum((v / own) ** 2))
    far = square * FAR_NOISE**2 < len(v) and own.max(initial=0.0) >= MILLIMETRES
    if far and chi2_lower_probability(square, len(v)) < ALPHA_OF_SIZE:
        noise, rms = (float(np.sqrt(np.mean(x**2))) for x in (own, v))
        raise InputError(
            f"{word}: the stated noise, {noise:.4g} m, is far larger than the residuals, whose RMS "
            f"is {rms:.4g} m: state it in metres"
        )


def _wrong_size(
    places: Array,
    values: Array,
    function: CovarianceFunction,
    sigma: Array,
    trend: str,
    word: str,
) -> list[str]:
    """Return a remark if σ of signal and noise together are far from the residuals."""
    seen = np.isfinite(values).any(axis=1)
    columns = np.isfinite(values).any(axis=0)
    own, v = sigma[seen][:, columns], values[seen][:, columns]
    kind = trend if trend != "similarity" or columns.all() else "mean"
    found = collocate(places[seen], v, covariance=function, noise=own, trend=kind)
    if found.redundancy <= 0:
        return []
    tails = (
        chi2_lower_probability(found.vtpv, found.redundancy),
        chi2_upper_probability(found.vtpv, found.redundancy),
    )
    probability = 2.0 * min(tails)
    if 1.0 / FAR_SIZE <= found.sigma0 <= FAR_SIZE or probability >= ALPHA_OF_SIZE:
        return []
    on = np.isfinite(v)
    rms, noise = (float(np.sqrt(np.mean(x[on] ** 2))) for x in (v, own))
    return [
        f"{word}: σ̂0 {found.sigma0:.3g} of signal and noise together, where 1 is expected "
        f"(χ² test, probability {probability:.2g}): the residuals have an RMS of {rms:.4g} m, "
        f"signal and noise have σ {function.sigma:.4g} and {noise:.4g} m; state them in metres"
    ]


def _of_all_components(some: Prediction, on: Sequence[int]) -> Prediction:
    """Return a prediction of some components as one of all, 0 for the others."""
    m = len(some.values)
    values, covariances = np.zeros((m, 3)), np.zeros((m, 3, 3))
    values[:, on] = some.values
    covariances[np.ix_(range(m), on, on)] = some.covariances
    return Prediction(some.places, values, covariances)


def _formal_sigmas(solution: Solution, names: Sequence[str], enu: Array) -> Array:
    """Return σ of adjusted points along east, north and up, (m, 3)."""
    numbers = np.array([solution.number("point", n) for n in names], dtype=np.intp)
    covariances = solution.point_covariances[numbers]
    variances = np.einsum("nij,njk,nik->ni", enu, covariances, enu)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))
