"""Networks of Comp3D: total stations, and deflections of the vertical."""

from __future__ import annotations

from tests.loaders import comp3d
from tests.support.places import data_dir

LATITUDE, REFRACTION = 44.38, 0.12
"""Of the project comp3d_topo (its file ex_ref.comp), degrees."""


def network_of_topo(frame=None):
    folder = data_dir("comp3d_topo")
    return comp3d.read_network(
        folder / "figure.cor",
        folder / "figure.obs",
        latitude=LATITUDE,
        refraction=REFRACTION,
        frame=frame,
    )


ORIGIN = comp3d.Origin(48.8)
"""Of the project comp3d_dev_vert (its file ex_ref.comp)."""


def deflected(*, deflections=True):
    folder = data_dir("comp3d_dev_vert")
    return comp3d.read_network(
        folder / "coord.cor",
        folder / "obs.obs",
        latitude=ORIGIN.latitude,
        refraction=REFRACTION,
        deflections=deflections,
    )
