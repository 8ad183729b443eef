"""Networks in which image points of a photo err together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import factorgraph_adj as fga


def jointly_measured(
    network: fga.Network, photos: Sequence[str], *, signal: float = 0.004, length: float = 15.0
) -> fga.Network:
    """Return the network with a joint covariance for the image points of each of some photos.

        Σ_ij = s² exp(−d²/L²) [1 0.3; 0.3 1] + δ_ij diag(σ_x², σ_y²)

    Args:
        network: the network.
        photos: names of the photos.
        signal: s, image units.
        length: L, image units.
    """
    out = network.copy()
    photo, _, xy, sigma = network.images.columns()
    groups = []
    keep = np.ones(network.n_image_points, dtype=bool)
    for name in photos:
        rows = np.flatnonzero(photo == network.photo_number[name])
        distance = np.linalg.norm(xy[rows][:, None] - xy[rows], axis=2)
        kernel = signal**2 * np.exp(-((distance / length) ** 2))
        covariance = np.kron(kernel, [[1.0, 0.3], [0.3, 1.0]])
        covariance += np.diag(sigma[rows].ravel() ** 2)
        groups.append(fga.Correlated(tuple(network.image_points(rows)), covariance))
        keep[rows] = False
    out.image_mask(keep)
    out.add(*groups)
    return out
