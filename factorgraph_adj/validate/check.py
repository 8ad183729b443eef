"""Checks of a network before the adjustment: its structure and its given geometry.

The checks need no solution and report all problems at once. A network that passes can still fail
in the adjustment, because of its rank or of poor start values.
"""

from __future__ import annotations

from ..approximate.image_axes import problems_of_marks
from ..errors import InputError, Problem
from ..graph.equations import compile_network
from ..network.network import Network
from .counts import frame_problems, other_problems, photo_problems, point_problems
from .datum import datum_problems
from .geometry import geometry_problems, inside_the_earth
from .shapes import shape_problems
from .where import Sources


def check(network: Network, *, sources: Sources | None = None) -> tuple[Problem, ...]:
    """Return all problems that the checks find in a network.

    The problems are: nothing to adjust; points without observations or with too few; photos with
    too few points; frames with too few common places; unconnected parts; a missing datum in a
    network that is not free; marks of known points along other axes than stated, and known points
    that all have the same coordinates; and, for given approximate values: sights without length,
    vertical sights with an azimuth, points in the focal plane of a camera.

    Args:
        network: the network.
        sources: file and line of points and photos, by ("point" or "photo", name).
    """
    at = sources or {}
    try:
        equations = compile_network(network)
    except InputError as error:
        return error.problems
    inside = tuple(inside_the_earth(network, at))
    return (
        *point_problems(equations, at),
        *photo_problems(equations, at),
        *frame_problems(equations),
        *shape_problems(equations),
        *other_problems(equations),
        *datum_problems(equations),
        *problems_of_marks(network),
        *(inside or geometry_problems(equations)),
    )
