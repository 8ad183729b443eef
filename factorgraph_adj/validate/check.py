"""What is wrong with a network before it is adjusted: structure, and geometry where given.

The checks need no solution and find all they can at once. They are necessary, not
sufficient: what only the numbers tell (a rank, a poor start) is left to the adjustment.
"""

from __future__ import annotations

from ..errors import InputError, Problem
from ..graph.equations import compile_network
from ..network.network import Network
from .counts import other_problems, photo_problems, point_problems
from .datum import datum_problems
from .geometry import geometry_problems, inside_the_earth
from .where import Sources


def check(network: Network, *, sources: Sources | None = None) -> tuple[Problem, ...]:
    """Return everything that is found wrong with a network, nothing if it seems fit.

    Nothing to adjust; points without observations or with too few; photos with too few points;
    unconnected parts; no datum without a free network asked for; and, from the given
    approximate values where there are any: sights without length, vertical sights with an
    azimuth, points behind a camera or in its focal plane.

    Args:
        network: what is to be adjusted.
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
        *other_problems(equations),
        *datum_problems(equations),
        *(inside or geometry_problems(equations)),
    )
