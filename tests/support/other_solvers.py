"""Other solvers from the same start: scipy's trf, and GTSAM's LM with its native factors.

Both return a state of ours, so that one function computes all costs.
"""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import block_diag, csr_array

from factorgraph_adj.graph.equations import Equations
from factorgraph_adj.graph.variables import State
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import ControlPoint
from factorgraph_adj.rotation import TURN_ABOUT_X as TURN
from factorgraph_adj.rotation import exp_rotation, right_jacobian_inverse
from factorgraph_adj.solve.feasible_states import is_behind_camera
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array

MOST_DENSE = 320
"""Largest number of columns that trf solves by a dense SVD; more are solved by LSMR."""
MOST_EVALUATIONS = 100


def cost(equations: Equations, state: State) -> float:
    """Return vᵀPv; infinite where a point lies behind a camera or a value is not finite."""
    if not all(np.isfinite(values).all() for values in state.values()):
        return np.inf
    if is_behind_camera(equations, state).any():
        return np.inf
    v = equations.residuals(state)
    value = float(v @ v)
    return value if np.isfinite(value) else np.inf


def by_trf(equations: Equations, start: State, *, loss: str = "linear") -> State:
    """Minimise by ``least_squares(method="trf")`` over the tangent at the start.

    Args:
        equations: the network in arrays.
        start: values at which the iteration begins.
        loss: name of the loss, such as ``"cauchy"``, of residuals in standard deviations.
    """
    unknowns = equations.unknowns
    rows = np.arange(equations.n_rows)
    free = np.flatnonzero(unknowns.free)
    dense = len(free) <= MOST_DENSE

    def state_of(x: Array) -> State:
        step = np.zeros(unknowns.n_columns)
        step[free] = x
        return unknowns.retract(start, step)

    def residuals(x: Array) -> Array:
        v = equations.residuals(state_of(x))
        return np.where(np.isfinite(v), v, 1e10)

    def partials(x: Array) -> Array | csr_array:
        step = np.zeros(unknowns.n_columns)
        step[free] = x
        a = LinearisedEquations(equations, state_of(x)).sparse(rows)
        a = (a @ csr_array(_by_tangent_at_start(equations, step)))[:, free]
        return a.toarray() if dense else csr_array(a)

    found = least_squares(
        residuals,
        np.zeros(len(free)),
        jac=partials,
        method="trf",
        loss=loss,
        x_scale="jac",
        tr_solver="exact" if dense else "lsmr",
        max_nfev=MOST_EVALUATIONS,
    )
    return state_of(found.x)


def _by_tangent_at_start(equations: Equations, step: Array) -> csr_array:
    """Return the partials of local steps by steps from the start, (n_columns, n_columns)."""
    parts = []
    for kind, table in equations.unknowns.tables.items():
        for i in np.flatnonzero(table.offset >= 0).tolist():
            block = np.eye(int(table.size[i]))
            if UNKNOWNS[kind].rotates:
                w = step[table.offset[i] + np.arange(3)]
                block[:3, :3] = np.linalg.inv(right_jacobian_inverse(w[None])[0])
            parts.append(block)
    return csr_array(block_diag(parts))


# -- GTSAM ----------------------------------------------------------------------------------------


def native(
    equations: Equations, start: State, *, robust: bool = False
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return native factors of image points, control, positions and relative poses, and values.

    With ``robust`` the noise of image points is Cauchy's.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    letter = {"pose": "x", "point": "l", "calibration": "c"}

    def named(kind: str, number: int) -> int:
        return int(gtsam.symbol(letter[kind], number))

    for i, pose in enumerate(start["pose"]):
        at = gtsam.Pose3(gtsam.Rot3(pose[:9].reshape(3, 3)), gtsam.Point3(*pose[9:]))
        values.insert(named("pose", i), at)
        if equations.unknowns["pose"].offset[i] < 0:
            graph.add(gtsam.NonlinearEqualityPose3(named("pose", i), at))
    for i, point in enumerate(start["point"]):
        values.insert(named("point", i), gtsam.Point3(*point))
    images = [b for b in equations.blocks if b.kind == "image"]
    for i, k in enumerate(start["calibration"] if images else []):
        values.insert(named("calibration", i), gtsam.Cal3Bundler(k[0], k[3], k[4], 0.0, 0.0))
    pairs: dict[tuple[int, int], dict[str, tuple[Array, Array]]] = {}
    for block in equations.blocks:
        for n, (observed, sigma) in enumerate(zip(block.observed, block.sigma, strict=True)):
            index = [int(numbers[n]) for _, numbers in block.variables]
            noise = gtsam.noiseModel.Diagonal.Sigmas(sigma)
            match block.kind:
                case "image":
                    photo, calibration, point = index
                    at = gtsam.Point2(observed[0], -observed[1])
                    if robust:
                        cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(1.0)
                        noise = gtsam.noiseModel.Robust.Create(cauchy, noise)
                    keys = named("pose", photo), named("point", point)
                    own = named("calibration", calibration)
                    graph.add(gtsam.GeneralSFMFactor2Cal3Bundler(at, noise, *keys, own))
                case "control":  # a row for each coordinate, see below
                    continue
                case "photo_position":
                    at = gtsam.Point3(*observed)
                    graph.add(gtsam.GPSFactor(named("pose", index[0]), at, noise))
                case "relative_rotation" | "relative_position":
                    pairs.setdefault((index[0], index[1]), {})[block.kind] = observed, sigma
                case other:
                    raise ValueError(f"no native factor for {other}")
    for o in equations.network.observations.values():
        if isinstance(o, ControlPoint):
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(o.sigma))
            number = equations.unknowns["point"].number[o.point]
            graph.add(
                gtsam.PriorFactorPoint3(named("point", number), gtsam.Point3(*o.value), noise)
            )
    for (a, b), pair in pairs.items():
        (w, sw), (t, st) = pair["relative_rotation"], pair["relative_position"]
        between = gtsam.Pose3(
            gtsam.Rot3(TURN @ exp_rotation(w[None])[0] @ TURN), gtsam.Point3(*(TURN @ t))
        )
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([sw, st]))
        keys = named("pose", a), named("pose", b)
        graph.add(gtsam.BetweenFactorPose3(*keys, between, noise))
    return graph, values


def by_gtsam(equations: Equations, start: State, *, robust: bool = False) -> State:
    """Minimise by GTSAM's Levenberg-Marquardt with its default parameters; robust: as `native`."""
    graph, values = native(equations, start, robust=robust)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(MOST_EVALUATIONS)
    try:
        found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    except RuntimeError:  # an indeterminate system, or a point at infinity
        return {**start, "pose": np.full_like(start["pose"], np.nan)}
    state = {kind: given.copy() for kind, given in start.items()}
    for i in range(len(start["pose"])):
        pose = found.atPose3(gtsam.symbol("x", i))
        state["pose"][i] = np.concatenate([pose.rotation().matrix().ravel(), pose.translation()])
    for i in range(len(start["point"])):
        state["point"][i] = found.atPoint3(gtsam.symbol("l", i))
    if any(b.kind == "image" for b in equations.blocks):
        for i in range(len(start["calibration"])):
            k = found.atCal3Bundler(gtsam.symbol("c", i))
            state["calibration"][i, [0, 3, 4]] = k.fx(), k.k1(), k.k2()
    return state
