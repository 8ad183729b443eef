"""The observation equations of a network: unknowns, blocks of observations, clusters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..network import Network
from ..types import Array, Index
from .blocks import Block
from .image_blocks import image_blocks
from .make_blocks import control_blocks, plain_blocks, weighted_blocks
from .variables import State, Unknowns
from .weights import Cluster, clusters_of, weigh


@dataclass(frozen=True)
class Equations:
    """Everything that an adjustment needs to know of a network, in arrays."""

    network: Network
    """The network."""
    unknowns: Unknowns
    """The unknowns and their columns."""
    blocks: tuple[Block, ...]
    """Observations by kind; image coordinates last, one block for each lens model."""
    clusters: tuple[Cluster, ...]
    """Correlated rows across observations; their own standard deviations are those of the
    covariance's diagonal."""
    in_cluster: dict[int, Index]
    """For each block with clustered rows, by its place: the observations in clusters."""

    @property
    def n_rows(self) -> int:
        """Number of scalar observations, weighted unknowns among them."""
        return sum(b.observed.size for b in self.blocks)

    def residuals(self, state: State, *, whitened: bool = True) -> Array:
        """Return v (n_rows,), whitened or in units of the observations."""
        out = np.empty(self.n_rows)
        raw = np.empty(self.n_rows) if self.clusters else out
        for block in self.blocks:
            v = block.evaluate(self.network.frame, state, jacobians=False).residual
            out[block.rows] = (block.whiten(v) if whitened else v).ravel()
            if self.clusters:
                raw[block.rows] = v.ravel()
        if whitened:
            for c in self.clusters:
                out[c.rows] = c.whitener @ raw[c.rows]
        return out

    def sigmas(self) -> Array:
        """Return the standard deviation of every scalar row (n_rows,)."""
        return np.concatenate([b.sigma.ravel() for b in self.blocks] or [np.zeros(0)])

    def label(self, row: int) -> str:
        """Return a readable name of a scalar row."""
        for block in self.blocks:
            if block.rows.start <= row < block.rows.stop:
                i, component = divmod(row - block.first_row, block.dimension)
                name = block.components[component]
                return f"{block.labels(i)} {name}".strip()
        raise IndexError(row)

    def weighted_at(self, state: State) -> Equations:
        """Return the equations with standard deviations for the geometry of ``state``.

        Parts such as ppm and centring depend on the lengths of sights.
        """
        return replace(self, blocks=tuple(weigh(self.network, b, state) for b in self.blocks))


def compile_network(network: Network) -> Equations:
    """Turn a network into arrays.

    Raises:
        InputError: nothing to adjust, or a point measured twice in one photo.
    """
    unknowns = Unknowns(network)
    blocks = [*plain_blocks(network, unknowns), *control_blocks(network, unknowns)]
    blocks += [*weighted_blocks(unknowns), *image_blocks(network, unknowns)]
    first, placed = 0, []
    for block in blocks:
        placed.append(replace(block, first_row=first))
        first += block.observed.size
    if first == 0:
        raise InputError("nothing to adjust: the network has no observations")
    if unknowns.n_columns == 0:
        raise InputError("nothing to adjust: everything is held")
    clusters, in_cluster = clusters_of(network, placed)
    return Equations(network, unknowns, tuple(placed), clusters, in_cluster)
