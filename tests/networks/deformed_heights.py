"""Heights of a block with a signal between it and its control: known truth for collocation."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.collocation.covariance_function import CovarianceFunction
from factorgraph_adj.types import Array

SIGNAL = CovarianceFunction("gaussian", 0.030, 400.0)
NOISE = 0.008


def levelled(seed: int = 2, *, rise_sigma: float = 1e-5) -> tuple[fga.Network, Array, Array]:
    """Return heights that rises determine up to a shift, control with a signal, and the truth.

    Returns:
        The network, places (n, 2), and the true heights in the system of the control.
    """
    rng = np.random.default_rng(seed)
    n = 30
    where = rng.uniform(0.0, 1500.0, (n, 2))
    block = rng.normal(scale=5.0, size=n)
    root = np.linalg.cholesky(SIGNAL.between(where) + 1e-12 * np.eye(n))
    truth = block + root @ rng.normal(size=n)
    network = fga.Network("heights of a block")
    for i, (x, y) in enumerate(where):
        network.add_point(f"P{i}", (x, y, block[i]), fixed="xy")
    for i in range(1, n):
        rise = block[i] - block[i - 1] + rng.normal(scale=rise_sigma)
        network.add(fga.HeightDifference(f"P{i - 1}", f"P{i}", rise, sigma=rise_sigma))
    for i in range(0, n, 2):
        z = truth[i] + rng.normal(scale=NOISE)
        network.add(fga.ControlPoint(f"P{i}", (z,), axes="z", sigma=(NOISE,)))
    return network, where, truth
