"""Gross errors in readings of a network."""

from __future__ import annotations

from dataclasses import replace

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import SlopeDistance


def shift_image(network: Network, ident: str, dx: float, dy: float = 0.0) -> None:
    """Add an error to an image point, ``photo/point``, image units."""
    names = [f"{o.photo}/{o.point}" for o in network.image_points()]
    _, _, xy, _ = network.images.columns()
    moved = xy.copy()
    moved[names.index(ident)] += (dx, dy)
    network.images.xy = [moved]


def shift_first_distance(network: Network, by: float) -> None:
    """Add an error to the first slope distance, metres."""
    every = network.observations
    ident, distance = next((i, o) for i, o in every.items() if isinstance(o, SlopeDistance))
    every[ident] = replace(distance, value=distance.value + by)
