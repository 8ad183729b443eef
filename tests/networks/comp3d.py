"""Networks of Comp3D: total stations, and deflections of the vertical."""

from __future__ import annotations

import factorgraph_adj as fga
from factorgraph_adj.io.survey.comp3d_grid import Comp3dOrigin
from tests.support.places import data_dir

LATITUDE, REFRACTION = 44.38, 0.12
"""Of the project comp3d_topo (its file ex_ref.comp), degrees."""


def network_of_topo(earth="sphere"):
    return fga.read_comp3d(data_dir("comp3d_topo") / "ex_ref.comp", earth=earth)


ORIGIN = Comp3dOrigin(48.8)
"""Of the project comp3d_dev_vert (its file ex_ref.comp)."""


def deflected(*, deflections="as stated"):
    return fga.read_comp3d(data_dir("comp3d_dev_vert") / "ex_ref.comp", deflections=deflections)
