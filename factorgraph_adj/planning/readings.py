"""Readings computed from the given values of a network."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from ..errors import InputError, Problem
from ..network.entities import ImageTable
from ..network.network import Network
from ..simulation.simulate import measure

NO_TURN = 0.0
"""Orientation of a planned set of directions, radians; partials are independent of it."""


def as_planned(network: Network) -> Network:
    """Return the network with all readings computed from its given values.

    Args:
        network: coordinates and orientations as planned; the observed values are ignored.

    Raises:
        InputError: every point without coordinates and every photo without position or rotation.
    """
    problems = [
        Problem("a plan needs its coordinates", f"point {name!r}")
        for name, p in network.points.items()
        if not np.isfinite(p.coordinates).all()
    ]
    problems += [
        Problem("a plan needs its position and rotation", f"photo {name!r}")
        for name, f in network.photos.items()
        if f.position is None or f.rotation is None
    ]
    if problems:
        raise InputError(problems)
    plan = copy(network)
    plan.parameters = {
        kind: {
            key: p if np.isfinite(p.values).all() else replace(p, values=(NO_TURN,) * len(p.values))
            for key, p in given.items()
        }
        for kind, given in network.parameters.items()
    }
    read = measure(plan, seed=0, noise=False)
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
