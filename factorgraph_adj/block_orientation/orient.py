"""Orientation of a block from its image points alone: parts, their place in the frame, the start.

Every part starts from a pair of photos and grows by resection and intersection; known coordinates,
attitudes and lengths bring it into the frame of the network. Nothing is taken out of the network:
the result is a start of the adjustment, and names what does not agree with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import ApproximationError, InputError, Problem, known
from ..graph.equations import Equations, compile_network
from ..network.network import DatumChoice, Network
from .assemble import Assembly
from .block_start import BlockStart
from .build import build_parts
from .diagnosis import why_none
from .focal import Distances
from .known import given
from .robust_poses import solvers
from .views import Views


@with_one_thread
def orient(
    network: Network, *, principal_distances: Mapping[str, Sequence[float]] | None = None
) -> BlockStart:
    """Find poses of all photos and coordinates of all points from the image points of a network.

    No photo needs a pose and no point coordinates. Pairs of photos are oriented relatively from
    five points at a time; from the best pair the block grows by resection and intersection, with
    adjustments on the way. Mismatches are left out of the start by their misses: they stay in the
    network, and are listed. Control points, weighted points and photos, observed positions and
    attitudes, known lengths and the frame of what other observations determine give scale and
    datum.

    Args:
        network: the network; it is not changed. The calibration of its cameras is approximate, or
            held. A free principal distance may be a guess: where the block does not fit with it,
            others are tried.
        principal_distances: by camera, values to try in the place of the given one, image units,
            such as those of the description of a lens.

    Returns:
        The start, for ``adjust(network, start=found.start)``, and what was left out.

    Raises:
        InputError: there are no image points, PoseLib is not installed (extra ``images``), or a
            camera is unknown.
        ApproximationError: no two photos have enough common points that fit.
    """
    if not network.n_image_points:
        raise InputError("the network has no image points to orient photos from")
    return orient_equations(compile_network(network), principal_distances=principal_distances)


def orient_equations(
    equations: Equations,
    *,
    datum: DatumChoice | None = None,
    principal_distances: Mapping[str, Sequence[float]] | None = None,
) -> BlockStart:
    """Orient the photos of a network in arrays, see `orient`.

    Args:
        equations: the network in arrays.
        datum: given or free; none: the datum of the network.
        principal_distances: as for `orient`.
    """
    solvers()
    network = equations.network
    views = Views.of(network)
    problems = [
        Problem(f"unknown camera {name!r}; known: {known(network.cameras, meant=name)}")
        for name in (principal_distances or {})
        if name not in network.cameras
    ]
    problems += [
        Problem("principal distances must be numbers > 0", f"camera {name!r}")
        for name, values in (principal_distances or {}).items()
        if not len(values) or not all(np.isfinite(v) and v > 0 for v in values)
    ]
    if problems:
        raise InputError(problems)
    distances = Distances(views, principal_distances or {}, given(equations).point)
    parts = build_parts(views, distances)
    if not parts:
        raise ApproximationError(
            [Problem(why_none(views, views.rays(distances.first())), "network")]
        )
    return Assembly(equations, views, parts, datum).start(distances)
