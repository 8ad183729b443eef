"""Weights of observations: parts that depend on lengths, and covariances across observations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, Problem
from ..models.registry import KINDS
from ..models.sight import sight
from ..network.network import Network
from ..observations import AstronomicLatitude, ControlPoint, HeightDifference, Observation
from ..stochastic import StandardDeviation, whitening
from ..types import Array, Index
from .blocks import Block
from .variables import State


@dataclass(frozen=True)
class Cluster:
    """Scalar rows that share a covariance."""

    rows: Index
    """Their numbers among all rows."""
    whitener: Array
    """W = L⁻¹ of the covariance L Lᵀ."""


def constant_sigma(o: Observation) -> float:
    """Return the constant part of the standard deviation (any positive value stands in)."""
    sigma = o.sigma  # type: ignore[attr-defined]
    if isinstance(sigma, StandardDeviation):
        return sigma.constant or 1.0
    return float(sigma)


def vector_weights(observations: list[Observation]) -> tuple[Array, Array | None]:
    """Return σ (n, d) and, where covariances are given, W (n, d, d)."""
    covariances = [
        np.diag(np.square(o.sigma)) if o.covariance is None else np.asarray(o.covariance)  # type: ignore[attr-defined]
        for o in observations
    ]
    sigma = np.sqrt(np.array([np.diag(c) for c in covariances]))
    if all(o.covariance is None for o in observations):  # type: ignore[attr-defined]
        return sigma, None
    return sigma, np.array([whitening(c) for c in covariances])


def weigh(network: Network, block: Block, state: State) -> Block:
    """Return the block with standard deviations that depend on lengths evaluated."""
    if block.kind not in KINDS or block.whitener is not None or block.dimension > 1:
        return block
    observations = [network.observations[i] for i in block.ids]
    # The standard deviation of a clustered observation is that of its cluster.
    clustered = {ident for ids, _ in network.clusters for ident in ids}
    sigmas = [
        None if isinstance(o, AstronomicLatitude) else o.sigma  # type: ignore[attr-defined]
        for o in observations
    ]
    rows = np.array(
        [
            i
            for i, s in enumerate(sigmas)
            if isinstance(s, StandardDeviation) and block.ids[i] not in clustered
        ],
        dtype=np.intp,
    )
    if not len(rows):
        return block
    part = block.select(rows)
    chosen = [sigmas[i] for i in rows]
    constant, ppm, per_km, ci, ct = (
        np.array([getattr(s, name) for s in chosen])
        for name in (
            "constant",
            "ppm",
            "per_sqrt_km",
            "centring_instrument",
            "centring_target",
        )
    )
    x = [state[kind][index] for kind, index in part.variables]
    q = sight(
        network.frame, *x[:4], *(part.constants[c] for c in ("instrument_height", "target_height"))
    ).q
    slope, level = np.linalg.norm(q, axis=1), np.hypot(q[:, 0], q[:, 1])
    if block.kind in ("slope_distance", "horizontal_distance"):
        length = np.abs(part.observed[:, 0])
        variance = (constant + 1e-6 * ppm * length) ** 2 + ci**2 + ct**2
    elif block.kind == "height_difference":
        km = np.array(
            [
                o.length_km if isinstance(o, HeightDifference) and o.length_km is not None else h
                for o, h in zip((observations[i] for i in rows), level / 1000.0, strict=True)
            ]
        )
        variance = constant**2 + per_km**2 * km + ci**2 + ct**2
    elif block.kind in ("vertical_angle", "zenith_angle"):
        variance = constant**2 + (ci**2 + ct**2) / slope**2
    elif block.kind == "horizontal_angle":
        q2 = sight(
            network.frame,
            x[0],
            x[1],
            x[4],
            x[5],
            part.constants["instrument_height"],
            part.constants["target2_height"],
        ).q
        level2 = np.hypot(q2[:, 0], q2[:, 1])
        across = np.hypot(q2[:, 0] - q[:, 0], q2[:, 1] - q[:, 1])
        variance = (
            constant**2
            + ci**2 * (across / (level * level2)) ** 2
            + ct**2 * (1 / level**2 + 1 / level2**2)
        )
    else:
        variance = constant**2 + (ci**2 + ct**2) / level**2
    problems = [
        Problem("the standard deviation is zero here: none of its parts applies", part.labels(i))
        for i in np.flatnonzero(~(variance > 0)).tolist()
    ]
    if problems:
        raise InputError(problems)
    sigma = block.sigma.copy()
    sigma[rows, 0] = np.sqrt(variance)
    return replace(block, sigma=sigma)


def clusters_of(
    network: Network, blocks: list[Block]
) -> tuple[tuple[Cluster, ...], dict[int, Index]]:
    """Find the rows of the network's clusters and of control points with a covariance."""
    groups = list(network.clusters)
    groups += [
        ((ident,), np.asarray(o.covariance))
        for ident, o in network.observations.items()
        if isinstance(o, ControlPoint)
        and o.covariance is not None
        and not any(ident in g for g, _ in network.clusters)
    ]
    if not groups:
        return (), {}
    rows_of: dict[str, list[int]] = {}
    place: dict[str, list[tuple[int, int]]] = {}
    for number, block in enumerate(blocks):
        if block.kind == "image" or block.kind.startswith("weighted"):
            continue
        for i, ident in enumerate(block.ids):
            first = block.first_row + i * block.dimension
            rows_of.setdefault(ident, []).extend(range(first, first + block.dimension))
            place.setdefault(ident, []).append((number, i))
    clusters = []
    members: dict[int, list[int]] = {}
    for ids, covariance in groups:
        rows = np.array([r for ident in ids for r in rows_of[ident]], dtype=np.intp)
        clusters.append(Cluster(rows, whitening(covariance)))
        for ident in ids:
            for number, i in place[ident]:
                members.setdefault(number, []).append(i)
    for number in members:
        # A clustered observation is weighted by its cluster; σ for reports is the diagonal's.
        block = blocks[number]
        sigma = block.sigma.copy()
        for c, (_, covariance) in zip(clusters, groups, strict=True):
            own = (c.rows >= block.rows.start) & (c.rows < block.rows.stop)
            sigma.ravel()[c.rows[own] - block.first_row] = np.sqrt(np.diag(covariance))[own]
        whitener = block.whitener
        if whitener is not None:
            whitener = whitener.copy()
        blocks[number] = replace(block, sigma=sigma, whitener=whitener)
    return tuple(clusters), {n: np.array(sorted(i), dtype=np.intp) for n, i in members.items()}
