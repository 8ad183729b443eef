"""Lines in space from their images: planes through projection centres intersect in a line.

The measured points of a line in a photo span a plane with the projection centre; the line has the
direction across all normals, and the place nearest to all planes.
"""

from __future__ import annotations

import numpy as np

from ..errors import Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.inverse import directions
from ..models.lens import Lens
from ..models.sub_frame import horizons
from ..network.network import Network
from ..observations.relations import ImageLine
from ..types import Array
from .shapes import with_axis

FLAT = 1e-4
"""Sine of the angle between planes up to which they leave the line open."""


def place_image_lines(equations: Equations, state: State) -> list[Problem]:
    """Fill the missing frames of lines in images; return a problem for each that is not found.

    Args:
        equations: the network.
        state: its values; poses are known.
    """
    network, table = equations.network, equations.unknowns["frame"]
    problems = []
    for name, lines in _lines(network).items():
        f = table.number[name]
        if not np.isnan(state["frame"][f]).any():
            continue
        planes = [_plane(equations, state, photo, own) for photo, own in lines.items()]
        found = [p for p in planes if p is not None]
        what = _take(equations, state, f, found)
        if what:
            problems.append(Problem(what, f"line {name!r}"))
    return problems


def lines_in_images(equations: Equations) -> set[int]:
    """Return the numbers of the frames of lines in images."""
    number = equations.unknowns["frame"].number
    return {number[name] for name in _lines(equations.network)}


def _lines(network: Network) -> dict[str, dict[str, list[ImageLine]]]:
    """Return the measured points by line and photo."""
    found: dict[str, dict[str, list[ImageLine]]] = {}
    for o in network.observations.values():
        if isinstance(o, ImageLine):
            found.setdefault(o.line, {}).setdefault(o.photo, []).append(o)
    return found


def _plane(
    equations: Equations, state: State, photo: str, own: list[ImageLine]
) -> tuple[Array, Array] | None:
    """Return the normal of the plane of a line, and its projection centre; none: one point."""
    network = equations.network
    pose = state["pose"][equations.unknowns["pose"].number[photo]]
    camera = network.cameras[network.photos[photo].camera]
    lens: Lens = camera.lens
    k = np.tile(np.array(camera.values), (len(own), 1))
    rays = directions(lens, np.array([(o.x, o.y) for o in own]), k)
    _, values, vt = np.linalg.svd(rays)
    if len(own) < 2 or not values[1] > 1e-9 * values[0]:
        return None
    return pose[:9].reshape(3, 3) @ vt[2], pose[9:]


def _take(equations: Equations, state: State, f: int, planes: list[tuple[Array, Array]]) -> str:
    """Fill the frame of a line; return what is wrong, empty if nothing is."""
    if len(planes) < 2:
        return (
            f"{len(planes)} photo{' has' if len(planes) == 1 else 's have'} two measured points of "
            "it or more: its approximate values need two, or give them"
        )
    normals = np.array([n for n, _ in planes])
    centres = np.array([c for _, c in planes])
    _, values, vt = np.linalg.svd(normals)
    if not values[1] > FLAT * values[0]:
        return (
            f"its planes in {len(planes)} photos are the same, as it is parallel to the base: it "
            "needs a photo from elsewhere, or give its approximate values"
        )
    direction = vt[2]
    stored = state["frame"][f]
    origin = stored[13:16]
    # The place nearest to the origin: along the line nothing is asked for.
    a = np.vstack([normals, direction])
    b = np.append(np.einsum("ni,ni->n", normals, centres - origin), 0.0)
    place = np.linalg.lstsq(a, b, rcond=None)[0]
    basis = equations.network.frame.basis(origin[None], np.zeros((1, 2)))
    horizon = horizons(basis, stored[16:])[0]
    axis = horizon @ direction
    rotation = with_axis(axis if axis[2] >= 0 else -axis)
    stored[:9] = rotation.ravel()
    stored[9:12], stored[12] = rotation.T @ horizon @ place, 0.0
    return ""
