"""Weights of observations: σ that depend on lengths, covariances of vectors, and clusters."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, Problem
from ..frames import Frame
from ..models.line_of_sight import sight
from ..models.sub_frame import in_frame
from ..network.network import Network
from ..observations import Observation, observation_kind
from ..stochastic_model import StandardDeviation, whitenings
from ..types import NO_ROWS, Array, Index
from .blocks import Block
from .image_ids import ImageIds
from .variables import State


@dataclass(frozen=True)
class Cluster:
    """Scalar rows that share a covariance."""

    rows: Index
    """Numbers of the rows among all rows of the network."""
    whitener: Array
    """W = L⁻¹ of the covariance L Lᵀ."""


def constant_sigma(o: Observation) -> float:
    """Return the constant part of the standard deviation; 1 stands for 0 until `weigh`."""
    sigma = o.sigma  # type: ignore[attr-defined]
    if isinstance(sigma, StandardDeviation):
        return sigma.constant or 1.0
    return float(sigma)


def vector_weights(observations: Sequence[Observation]) -> tuple[Array, Array | None]:
    """Return σ (n, d) and, for given covariances, W (n, d, d)."""
    given = [getattr(o, "covariance", None) for o in observations]
    covariances = [
        np.diag(np.square(o.sigma)) if c is None else np.asarray(c)  # type: ignore[attr-defined]
        for o, c in zip(observations, given, strict=True)
    ]
    sigma = np.sqrt(np.array([np.diag(c) for c in covariances]))
    if all(c is None for c in given):
        return sigma, None
    return sigma, whitenings(np.array(covariances))


@dataclass(frozen=True)
class _Geometry:
    """Quantities on which the variances of some observations of a block depend."""

    frame: Frame
    block: Block
    observations: Sequence[Observation]
    state: State

    @property
    def observed(self) -> Array:
        """Observed values, (n,)."""
        return np.asarray(self.block.observed[:, 0])

    def sight(self, target: str = "target") -> Array:
        """Return the line from the instrument to ``target``, (n, 3).

        East, north, up, metres; or in the frame of an instrument, its unit.
        """
        block = self.block
        x = {
            (kind, attribute): self.state[kind][index]
            for attribute, (kind, index) in zip(block.named, block.arguments, strict=True)
        }
        if ("frame", "frame") in x:
            place = x["point", observation_kind(block.kind).points[0]]
            origin, vertical = x.get(("point", "frame.origin")), x["vertical", "frame.origin"]
            return in_frame(self.frame, x["frame", "frame"], place, origin, vertical).q
        zero = np.zeros(block.n)
        ends = (("point", "station"), ("vertical", "station"), ("point", target))
        heights = ("instrument_height", f"{target}_height")
        return sight(
            self.frame,
            *(x.get(end, np.zeros((block.n, 2))) for end in (*ends, ("vertical", target))),
            *(block.constants.get(h, zero) for h in heights),
        ).q

    def number(self, attribute: str) -> Array:
        """Return a numeric attribute of each observation, (n,); NaN where the value is None."""
        found = [getattr(o, attribute, None) for o in self.observations]
        return np.array([np.nan if v is None else v for v in found], dtype=float)


def weigh(network: Network, block: Block, state: State) -> Block:
    """Return the block with the standard deviations for the lengths at ``state``."""
    rows = of_parts(network, block)
    if not len(rows):
        return block
    observations = [network.observations[block.ids[i]] for i in rows.tolist()]
    sigma = block.sigma.copy()
    sigma[rows, 0] = sigma_at(network.frame, block.select(rows), observations, state)
    return replace(block, sigma=sigma)


def of_parts(network: Network, block: Block) -> Index:
    """Return the observations of a block whose standard deviations have parts, by their places.

    The standard deviation of a clustered observation is that of its cluster.
    """
    if block.prior or block.lens is not None or observation_kind(block.kind).weight is None:
        return NO_ROWS
    given = (network.observations[i].sigma for i in block.ids)  # type: ignore[attr-defined]
    found = [i for i, s in enumerate(given) if isinstance(s, StandardDeviation)]
    clustered = {ident for ids, _ in network.clusters for ident in ids} if found else set()
    return np.array([i for i in found if block.ids[i] not in clustered], dtype=np.intp)


def sigma_at(
    frame: Frame, block: Block, observations: Sequence[Observation], state: State
) -> Array:
    """Return the standard deviations of observations of parts for the lengths at a state, (n,).

    Raises:
        InputError: names observations none of whose parts applies.
    """
    weight = observation_kind(block.kind).weight
    assert weight is not None
    geometry = _Geometry(frame, block, observations, state)
    variance = weight.variance([o.sigma for o in observations], geometry)  # type: ignore[attr-defined]
    problems = [
        Problem("the standard deviation is zero here: none of its parts applies", block.labels(i))
        for i in np.flatnonzero(~(variance > 0)).tolist()
    ]
    if problems:
        raise InputError(problems)
    return np.sqrt(variance)


def weighed_where_known(network: Network, block: Block, state: State) -> Block:
    """Return the block with its standard deviations, where ``state`` knows their lengths.

    A standard deviation whose parts depend on an unknown length is NaN.
    """
    if block.prior or block.lens is not None or observation_kind(block.kind).weight is None:
        return block
    known = np.ones(block.n, dtype=bool)
    for kind, index in block.variables:
        if kind in ("point", "frame"):  # lengths are those between points, or in frames
            known &= np.isfinite(state[kind][index]).all(axis=1)
    given = (network.observations[i].sigma for i in block.ids)  # type: ignore[attr-defined]
    sigma = block.sigma.copy()
    sigma[~known & [isinstance(s, StandardDeviation) for s in given]] = np.nan
    rows = np.flatnonzero(known)
    if len(rows):
        sigma[rows] = weigh(network, block.select(rows), state).sigma
    return replace(block, sigma=sigma)


def clusters_of(
    network: Network, blocks: list[Block]
) -> tuple[tuple[Cluster, ...], dict[int, Index]]:
    """Find the rows of the network's clusters and of control points with a covariance."""
    groups: list[tuple[Sequence[str | int], Array]] = [*network.clusters]
    # Image points are known by their rows in the table of all of them.
    groups += [(rows.tolist(), covariance) for rows, covariance in network.images.joint]
    groups += [
        ((ident,), np.asarray(o.covariance))  # type: ignore[attr-defined]
        for ident, o in network.observations.items()
        if o.record.by_axis
        and o.covariance is not None  # type: ignore[attr-defined]
        and not any(ident in g for g, _ in network.clusters)
    ]
    if not groups:
        return (), {}
    rows_of: dict[str | int, list[int]] = {}
    place: dict[str | int, list[tuple[int, int]]] = {}
    joint = network.images.is_joint
    for number, block in enumerate(blocks):
        if block.prior:
            continue
        names: Iterable[str | int] = block.ids
        if isinstance(block.ids, ImageIds):
            names = block.ids.rows.tolist() if joint[block.ids.rows].any() else ()
        for i, ident in enumerate(names):
            first = block.first_row + i * block.dimension
            rows_of.setdefault(ident, []).extend(range(first, first + block.dimension))
            place.setdefault(ident, []).append((number, i))
    by_size: dict[int, list[int]] = {}
    for number, (_, covariance) in enumerate(groups):
        by_size.setdefault(len(covariance), []).append(number)
    whiteners: dict[int, Array] = {}
    for some in by_size.values():
        found = whitenings(np.array([groups[number][1] for number in some], dtype=float))
        whiteners |= zip(some, found, strict=True)
    clusters = []
    members: dict[int, list[int]] = {}
    for number, (ids, _) in enumerate(groups):
        rows = np.array([r for ident in ids for r in rows_of[ident]], dtype=np.intp)
        clusters.append(Cluster(rows, whiteners[number]))
        for ident in ids:
            for block_number, i in place[ident]:
                members.setdefault(block_number, []).append(i)
    every = np.concatenate([c.rows for c in clusters])
    sigmas = np.sqrt(np.concatenate([np.diag(covariance) for _, covariance in groups]))
    for number in members:
        # The cluster weights the observation; the diagonal gives σ for reports.
        block = blocks[number]
        sigma = block.sigma.copy()
        own = (every >= block.rows.start) & (every < block.rows.stop)
        sigma.ravel()[every[own] - block.first_row] = sigmas[own]
        whitener = block.whitener
        if whitener is not None:
            whitener = whitener.copy()
        blocks[number] = replace(block, sigma=sigma, whitener=whitener)
    return tuple(clusters), {n: np.array(sorted(i), dtype=np.intp) for n, i in members.items()}
