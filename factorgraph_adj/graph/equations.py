"""The observation equations of a network: compilation, unknowns, blocks, clusters, weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import InputError, Problem
from ..models.base import Linearised
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..types import Array, Index
from .block_construction import by_kind, control_blocks, own_blocks, plain_blocks, weighted_blocks
from .blocks import Block
from .clusters import ClusterBatch, cluster_batches
from .image_blocks import ImageChunks, image_blocks
from .image_ids import ImageIds
from .variables import State, Unknowns
from .weights import Cluster, clusters_of, weigh

SAME_WEIGHTS = 1e-7
"""Relative change of standard deviations, times the rms of v/σ, that counts as none."""
MOST_DIGITS = 1e-12
"""Smallest relative change of standard deviations that is more than rounding."""


@dataclass(frozen=True)
class Equations:
    """The observation equations of a network in arrays."""

    network: Network
    """The network."""
    unknowns: Unknowns
    """The unknowns and their columns."""
    blocks: tuple[Block, ...]
    """Observations by kind; image coordinates last, one block for each lens model."""
    clusters: tuple[Cluster, ...]
    """Correlated rows across observations. The standard deviations of these rows in the blocks
    come from the diagonal of the covariance."""
    in_cluster: dict[int, Index]
    """Numbers of the observations in clusters, by the place of their block in ``blocks``."""

    @property
    def n_rows(self) -> int:
        """Number of scalar observations, weighted unknowns among them."""
        return sum(b.observed.size for b in self.blocks)

    @property
    def n_rays(self) -> int:
        """Number of image points."""
        return sum(b.n for b in self.blocks if b.lens is not None)

    @cached_property
    def images(self) -> dict[int, ImageChunks]:
        """All image coordinates in chunks, by the place of their block in ``blocks``."""
        return {
            place: ImageChunks(block, self.unknowns)
            for place, block in enumerate(self.blocks)
            if block.lens is not None
        }

    @cached_property
    def rays(self) -> dict[int, ImageChunks]:
        """Image coordinates that are linearised in chunks: those that are in no cluster."""
        return {k: chunks for k, chunks in self.images.items() if k not in self.in_cluster}

    def evaluated(self, state: State) -> dict[int, Linearised]:
        """Return residuals and partials of every block outside `rays`, by its place.

        Raises:
            InputError: observations cannot be computed at ``state``; the error names them.
        """
        return {
            place: block.evaluate(self.network.frame, state)
            for place, block in enumerate(self.blocks)
            if place not in self.rays
        }

    def residuals(
        self,
        state: State,
        *,
        whitened: bool = True,
        evaluated: Mapping[int, Linearised] | None = None,
    ) -> Array:
        """Return v (n_rows,), whitened or in units of the observations.

        Args:
            state: values of all variables.
            whitened: whether residuals are divided by their standard deviations.
            evaluated: what `evaluated` returns for ``state``; none: it is computed.

        Raises:
            InputError: observations cannot be computed at ``state``; the error names them.
        """
        out = np.empty(self.n_rows)
        raw = np.empty(self.n_rows) if self.clusters else out
        for place, block in enumerate(self.blocks):
            if place in self.rays:
                out[block.rows] = self.rays[place].residuals(state, whitened=whitened).ravel()
                continue
            if evaluated is None:
                v = block.evaluate(self.network.frame, state, jacobians=False).residual
            else:
                v = evaluated[place].residual
            out[block.rows] = (block.whiten(v) if whitened else v).ravel()
            if self.clusters:
                raw[block.rows] = v.ravel()
        if whitened:
            for batch in self.cluster_batches:
                out[batch.rows] = (batch.whitener @ raw[batch.rows][:, :, None])[:, :, 0]
        return out

    @cached_property
    def cluster_batches(self) -> tuple[ClusterBatch, ...]:
        """The clusters in batches of one pattern."""
        return cluster_batches(self.clusters, self.blocks, self.unknowns)

    def sigmas(self) -> Array:
        """Return the standard deviation of every scalar row (n_rows,)."""
        return np.concatenate([b.sigma.ravel() for b in self.blocks] or [np.zeros(0)])

    def id(self, row: int) -> str:
        """Return the id of the observation of a scalar row."""
        for block in self.blocks:
            if block.rows.start <= row < block.rows.stop:
                return block.ids[(row - block.first_row) // block.dimension]
        raise IndexError(row)

    def label(self, row: int) -> str:
        """Return a readable name of a scalar row."""
        for block in self.blocks:
            if block.rows.start <= row < block.rows.stop:
                i, component = divmod(row - block.first_row, block.dimension)
                name = block.components[component]
                return f"{block.labels(i)} {name}".strip()
        raise IndexError(row)

    @cached_property
    def observation_of_row(self) -> Index:
        """Number of the observation to which each scalar row belongs, (n_rows,).

        The rows of an observation are consecutive; each weighted unknown is one observation.
        """
        out, first = [np.zeros(0, dtype=np.intp)], 0
        for block in self.blocks:
            starts = np.ones(block.n, dtype=bool)
            if block.by_axis:
                # One row for each known coordinate.
                ids = np.array(list(block.ids), dtype=object)
                starts[1:] = ids[1:] != ids[:-1]
            number = np.cumsum(starts) - 1 + first
            out.append(np.repeat(number, block.dimension))
            first = int(number[-1]) + 1 if block.n else first
        return np.concatenate(out)

    @cached_property
    def reading_of_row(self) -> Index:
        """Number of the reading to which each scalar row belongs, (n_rows,).

        A reading is an observation, or the observations of one correlated group that are parts of
        one measurement (`ObservationKind.part_of`) between the same points and photos. Without such
        groups it is `observation_of_row` itself.
        """
        own, stated = self.observation_of_row, self.network.observations
        whole = np.arange(int(own[-1]) + 1 if len(own) else 0)
        for cluster in self.clusters:
            begin: dict[tuple[object, ...], int] = {}
            numbers, at = np.unique(own[cluster.rows], return_index=True)
            for number, row in zip(numbers.tolist(), cluster.rows[at].tolist(), strict=True):
                o = stated.get(self.id(row))
                if o is not None and o.record.part_of:
                    ends = o.record.part_of, o.frames(), o.points(), o.photos()
                    whole[number] = begin.setdefault(ends, number)
        if np.array_equal(whole, np.arange(len(whole))):
            return own
        return np.unique(whole, return_inverse=True)[1][own].astype(np.intp)

    def find(self, ids: Sequence[str]) -> list[Index]:
        """Return the scalar rows of each id; an id without observation has no rows."""
        out = [self._rows_of.get(ident, np.zeros(0, dtype=np.intp)) for ident in ids]
        for block in self.blocks:
            if isinstance(block.ids, ImageIds):
                at = block.ids.positions(ids)
                for i in np.flatnonzero(at >= 0).tolist():
                    out[i] = block.first_row + 2 * at[i] + np.arange(2)
        return out

    def touching(self, kind: VariableKind, numbers: Index) -> Index:
        """Return the scalar rows that depend on any of some variables of a kind."""
        wanted = np.zeros(len(self.unknowns[kind].names), dtype=bool)
        wanted[numbers] = True
        out = [np.zeros(0, dtype=np.intp)]
        for block in self.blocks:
            found = [wanted[index] for what, index in block.variables if what == kind]
            if found:
                at = np.flatnonzero(np.logical_or.reduce(found))
                first = block.first_row + block.dimension * at
                out.append((first[:, None] + np.arange(block.dimension)).ravel())
        return np.concatenate(out)

    def of_rows(self, rows: Index) -> Equations:
        """Return the equations of some observations, with all unknowns.

        Args:
            rows: scalar rows of whole observations, and of whole clusters, (k,).
        """
        on = np.zeros(self.n_rows, dtype=bool)
        on[rows] = True
        blocks: list[Block] = []
        in_cluster: dict[int, Index] = {}
        first = 0
        for place, block in enumerate(self.blocks):
            chosen = on[block.rows].reshape(block.observed.shape)[:, 0]
            if not chosen.any():
                continue
            if place in self.in_cluster:
                number = np.cumsum(chosen) - 1
                clustered = self.in_cluster[place]
                in_cluster[len(blocks)] = number[clustered[chosen[clustered]]]
            blocks.append(replace(block.select(np.flatnonzero(chosen)), first_row=first))
            first += blocks[-1].observed.size
        number = np.cumsum(on) - 1
        clusters = tuple(replace(c, rows=number[c.rows]) for c in self.clusters if on[c.rows].all())
        return replace(self, blocks=tuple(blocks), clusters=clusters, in_cluster=in_cluster)

    @cached_property
    def _rows_of(self) -> dict[str, Index]:
        """Rows of the observations other than image points, by id."""
        rows: dict[str, list[int]] = {}
        for block in self.blocks:
            if not isinstance(block.ids, ImageIds):
                first, d = block.first_row, block.dimension
                for i, ident in enumerate(block.ids):
                    rows.setdefault(ident, []).extend(range(first + i * d, first + (i + 1) * d))
        return {ident: np.array(r, dtype=np.intp) for ident, r in rows.items()}

    def weighted_at(self, state: State) -> Equations:
        """Return the equations with standard deviations for the geometry of ``state``.

        Parts such as ppm and centring depend on the lengths of sights.
        """
        out = replace(self, blocks=tuple(weigh(self.network, b, state) for b in self.blocks))
        if self.clusters:  # lengths change no weight of a cluster, and no place in the arrays
            out.__dict__["cluster_batches"] = self.cluster_batches
        return out

    def weighs_as(self, other: Equations, misfit: float = 1.0) -> bool:
        """Return whether a change of the weights moves nothing that counts.

        A relative change of standard deviations by ε moves unknowns by the order of ε times the
        root mean square of v/σ, relative to their own σ. That is to be below 1e-7.

        Args:
            other: the equations with the other weights.
            misfit: root mean square of v/σ; less than 1 counts as 1.
        """
        within = max(SAME_WEIGHTS / max(misfit, 1.0), MOST_DIGITS)
        pairs = zip(self.blocks, other.blocks, strict=True)
        return all(a is b or np.allclose(a.sigma, b.sigma, rtol=within, atol=0) for a, b in pairs)

    def reweighted(self, factors: Array) -> Equations:
        """Return the equations with every weight multiplied by a factor.

        Correlated observations get bifactor equivalent weights (Yang, Song & Xu 2002): with
        D = diag(γ), P' = √D P √D, hence W' = W √D and Σ' = D^(−½) Σ D^(−½). The correlations
        stay unchanged.

        Args:
            factors: γ > 0 of each scalar row, (n_rows,).

        Raises:
            InputError: wrong size, or a factor that is not a finite number > 0.
        """
        gamma = np.asarray(factors, dtype=float)
        if gamma.shape != (self.n_rows,):
            raise InputError(f"there must be {self.n_rows} factors of weights, not {gamma.shape}")
        bad = np.flatnonzero(~(np.isfinite(gamma) & (gamma > 0)))
        if len(bad):
            raise InputError(
                [
                    Problem(f"the factor of its weight must be > 0, not {gamma[i]}", self.label(i))
                    for i in bad.tolist()
                ]
            )
        root = np.sqrt(gamma)
        blocks = []
        for block in self.blocks:
            own = root[block.rows].reshape(block.observed.shape)
            whitener = None if block.whitener is None else block.whitener * own[:, None, :]
            blocks.append(replace(block, sigma=block.sigma / own, whitener=whitener))
        clusters = tuple(replace(c, whitener=c.whitener * root[c.rows]) for c in self.clusters)
        return replace(self, blocks=tuple(blocks), clusters=clusters)


def compile_network(network: Network) -> Equations:
    """Turn a network into arrays.

    Raises:
        InputError: nothing to adjust, or a point measured twice in one photo.
    """
    equations = compile_rows(network)
    if equations.n_rows == 0:
        why = f": {network.without_observations}" if network.without_observations else ""
        raise InputError(f"nothing to adjust: the network has no observations{why}")
    if equations.unknowns.n_columns == 0:
        raise InputError("nothing to adjust: everything is held")
    return equations


def compile_rows(network: Network) -> Equations:
    """Turn a network into arrays, even if the network has nothing to adjust.

    Raises:
        InputError: a point measured twice in one photo.
    """
    unknowns = Unknowns(network)
    groups = by_kind(network)
    blocks = [*plain_blocks(network, unknowns, groups)]
    blocks += control_blocks(network, unknowns, groups)
    blocks += [*own_blocks(network, unknowns), *weighted_blocks(unknowns)]
    blocks += image_blocks(network, unknowns)
    first, placed = 0, []
    for block in blocks:
        placed.append(replace(block, first_row=first))
        first += block.observed.size
    clusters, in_cluster = clusters_of(network, placed)
    return Equations(network, unknowns, tuple(placed), clusters, in_cluster)
