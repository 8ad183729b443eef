"""An aerial block whose observed positions drift in every run of some photos."""

from __future__ import annotations

from dataclasses import replace

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import PhotoPosition
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block

FREE = ("x", "y", "z", "x_t", "y_t", "z_t")
ARM = ("x", "y")
"""Components of the lever arm that strips flown in both directions determine."""


def drifting_block(
    drifts: int, *, photos_each: int = 10, points_per_photo: int = 100, arm: bool = True
) -> Network:
    """Return a simulated block with an unknown shift and drift of every run of photos.

    Args:
        drifts: their number; the block has a few photos more, which have none.
        photos_each: number of photos of each.
        points_per_photo: image points of a photo.
        arm: whether all photos share an unknown lever arm.
    """
    size = drifts * photos_each * points_per_photo
    made = simulate_aerial_block(1, image_points=size, points_per_photo=points_per_photo)
    network = made.network
    for number in range(drifts):
        network.set_drift(f"run {number}", free=FREE)
    if arm:
        network.set_mount("antenna", free=ARM)
    place = {photo: i for i, photo in enumerate(network.photos)}
    for ident, o in network.observations.items():
        if not isinstance(o, PhotoPosition):
            continue
        run, time = divmod(place[o.photo], photos_each)
        drift = f"run {run}" if run < drifts else None
        network.observations[ident] = replace(
            o, drift=drift, mount="antenna" if arm else None, time=float(time)
        )
    return network
