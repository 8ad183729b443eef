"""Start of an adjustment from image points where no other approximate values are found."""

from __future__ import annotations

import numpy as np

from ..approximate.rounds import reach
from ..errors import ApproximationError, InputError, Problem
from ..graph.equations import compile_network
from ..network.network import Network
from ..solve.start import Start
from .orient import orient


def start_from_images(network: Network, error: ApproximationError) -> Start:
    """Return a start from image points, or say why there is none.

    Args:
        network: the network.
        error: what the search for approximate values has missed.

    Raises:
        ApproximationError: photos are not what was missed; PoseLib is not installed; or photos and
            points remain without values, which the error names.
    """
    state, _ = reach(compile_network(network))
    if not network.n_image_points or not np.isnan(state["pose"]).any():
        raise error
    try:
        found = orient(network)
    except (InputError, ApproximationError) as other:
        raise ApproximationError([*error.problems, *other.problems]) from None
    if found.start is None:
        lost = [Problem(why, f"photo {name!r}") for name, why in found.unoriented.items()]
        first = " ".join(found.sentences()[: len(found.parts)])
        raise ApproximationError(
            [
                Problem(f"not all photos and points were found from image points: {first}"),
                *lost,
                *(Problem(p) for p in found.problems),
            ]
        )
    return found.start
