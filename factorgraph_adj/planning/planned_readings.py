"""Readings computed from the given values of a network."""

from __future__ import annotations

import numpy as np

from ..entities import ImageTable
from ..network.network import Network
from ..simulation.measurement import measure


def as_planned(network: Network) -> Network:
    """Return the network with all readings computed from its given values.

    Args:
        network: coordinates and places as planned; the observed values are ignored.

    Raises:
        InputError: points, photos and other unknowns without the values that a plan needs, as
            `factorgraph_adj.simulation.given_values.with_given_values`.
    """
    read = measure(network, seed=0, noise=False)
    return _with_names(network, read)


def _with_names(network: Network, read: Network) -> Network:
    """Return the network with readings, its image points in the first order with their ids."""
    photo, point, _, sigma = network.images.columns()
    if not len(photo):
        return read
    of_photo, of_point, xy, _ = read.images.columns()
    n = len(network.points)
    order = np.argsort(of_photo * n + of_point)
    place = np.searchsorted((of_photo * n + of_point)[order], photo * n + point)
    images = ImageTable()
    images.append(photo, point, xy[order][place], sigma)
    images.ids, images.sources = dict(network.images.ids), dict(network.images.sources)
    read.images = images
    return read
