"""The same rig as a dense adjustment with exact mounts: members have no poses of their own.

R_j = R B, X₀j = X₀ + R b. By the chain rule the partials by the pose of a member become those by
carrier and mount: ω_j = B'ᵀω + Dβ, δX_j = δX₀ − R [D b]× ω + R D δb, with B' = D B D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.variables import State
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import TURN_ABOUT_X as TURN
from factorgraph_adj.rotation import skew
from factorgraph_adj.types import Array, Index
from tests.networks.rigs import on_mount
from tests.support.differences import columns_of


@dataclass(frozen=True)
class Exact:
    """Result of the dense adjustment; columns are those of the network with ties."""

    equations: Equations
    state: State
    cofactors: Array
    """Of the columns ``kept``, (u, u)."""
    kept: Index
    """Columns of carriers, mounts and points, without those of members."""
    redundancy: int
    vtpv: float


def adjust_exactly(network: Network, iterations: int = 8) -> Exact:
    """Adjust the image points of a rig, whose ties are exact and its datum in held points."""
    equations = compile_network(network)
    unknowns = equations.unknowns
    state = unknowns.start()
    members = {
        o.photo2: (o.photo, o.mount)
        for o in network.observations.values()
        if o.kind == "relative_rotation"
    }
    poses = unknowns["pose"].number
    gone = np.concatenate([unknowns.columns("pose", poses[m]) for m in members])
    kept = np.setdiff1d(np.flatnonzero(unknowns.free), gone)
    for _ in range(iterations):
        _place(equations, state, members)
        a, v = _images(equations, state)
        whole = a @ _chain(equations, state, members)
        reduced = whole[:, kept]
        scale = np.linalg.norm(reduced, axis=0)
        q, r = np.linalg.qr(reduced / scale)
        step = np.zeros(unknowns.n_columns)
        step[kept] = -np.linalg.solve(r, q.T @ v) / scale
        state = unknowns.retract(state, step)
    _place(equations, state, members)
    v = _images(equations, state)[1]
    inverse = np.linalg.inv(r) / scale[:, None]
    redundancy = len(v) - len(kept)
    return Exact(equations, state, inverse @ inverse.T, kept, redundancy, float(v @ v))


def _place(equations: Equations, state: State, members: dict[str, tuple[str, str]]) -> None:
    poses, mounts = equations.unknowns["pose"].number, equations.unknowns["mount"]
    for member, (carrier, mount) in members.items():
        at = state["pose"][poses[carrier]]
        values = mounts_given(state, mounts.number[mount])
        rotation, centre = on_mount(at[:9].reshape(3, 3), at[9:], values)
        state["pose"][poses[member]] = np.concatenate([rotation.ravel(), centre])


def mounts_given(state: State, number: int) -> tuple[float, ...]:
    """Return rotation vector and arm of a mount."""
    return tuple(UNKNOWNS["mount"].given(state["mount"][number][None])[0].tolist())


def _images(equations: Equations, state: State) -> tuple[Array, Array]:
    """Return whitened partials and residuals of the image points."""
    rows, residuals = [], []
    for block in equations.blocks:
        if block.lens is None:
            continue
        linear = block.evaluate(equations.network.frame, state)
        partials = tuple(block.whiten(j) for j in linear.jacobians)
        rows.append(columns_of(equations.unknowns, block, partials))
        residuals.append(block.whiten(linear.residual).ravel())
    return np.concatenate(rows), np.concatenate(residuals)


def _chain(equations: Equations, state: State, members: dict[str, tuple[str, str]]) -> Array:
    """Return how all columns follow those that are kept, (n_columns, n_columns)."""
    unknowns = equations.unknowns
    out = np.eye(unknowns.n_columns)
    poses, mounts = unknowns["pose"].number, unknowns["mount"].number
    for member, (carrier, mount) in members.items():
        own = unknowns.columns("pose", poses[member])
        of_carrier = unknowns.columns("pose", poses[carrier])
        of_mount = unknowns.columns("mount", mounts[mount])
        stored = state["mount"][mounts[mount]]
        b = TURN @ stored[:9].reshape(3, 3) @ TURN
        rotation = state["pose"][poses[carrier], :9].reshape(3, 3)
        out[own] = 0.0
        out[np.ix_(own[:3], of_carrier[:3])] = b.T
        out[np.ix_(own[3:], of_carrier[:3])] = -rotation @ skew(TURN @ stored[9:])
        out[np.ix_(own[3:], of_carrier[3:])] = np.eye(3)
        if len(of_mount):
            out[np.ix_(own[:3], of_mount[:3])] = TURN
            out[np.ix_(own[3:], of_mount[3:])] = rotation @ TURN
    return out
