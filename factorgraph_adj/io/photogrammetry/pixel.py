"""Image coordinates of programs that count pixels: origin at a corner, y down.

In a network they are pixels with the origin at the upper left corner of the upper left pixel, x
right and y up: (column, −row). The centre of that pixel is (0.5, −0.5). The principal point
follows: y0 is minus the row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ...models.lens import Lens
from ...network.network import Network


def add_pixel_camera(
    network: Network,
    name: str,
    lens: Lens,
    values: Mapping[str, float],
    *,
    size: tuple[float, float] | None,
    free: Iterable[str] = (),
    sigma: Mapping[str, float] | None = None,
) -> None:
    """Add a camera whose image coordinates are pixels from the upper left corner.

    Args:
        network: the network.
        name: name of the camera.
        lens: its lens model.
        values: calibration in pixels; x0 is the column, y0 minus the row of the principal point.
        size: width and height, pixels; None where unknown.
        free: names of the free parameters.
        sigma: standard deviations of the weighted parameters by name.
    """
    network.add_camera(
        name,
        lens,
        values,
        free=free,
        sigma=sigma,
        unit="px",
        format=size,
        origin="upper left",
        y_down_in_files=True,
    )
