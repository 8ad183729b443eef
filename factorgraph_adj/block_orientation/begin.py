"""Start of an adjustment from image points where no other approximate values are found."""

from __future__ import annotations

from ..errors import ApproximationError, DatumError, InputError, Problem
from ..graph.equations import compile_network
from ..network.network import Network
from ..solve.start import Start, start_of
from .orient import orient


def problems_of_start(network: Network) -> tuple[Problem, ...]:
    """Return the unknowns that `adjust` finds no start values for, from image points either."""
    try:
        start_of(compile_network(network), network.datum, None)
    except ApproximationError as error:
        try:
            start_from_images(network, error)
        except ApproximationError as other:
            return other.problems
    except DatumError as error:
        return (Problem(str(error)),)
    return ()


def leaving_out(start: Start, error: InputError) -> InputError:
    """Return an error of an adjustment that began from image points, with what it may come from."""
    if not start.words:
        return error
    what = (
        "the adjustment began from image points alone, and uses those too that do not agree: "
        "found = fga.orient(network) names them, and found.without_doubtful() has none of them"
    )
    return InputError([*error.problems, Problem(what)])


def start_from_images(network: Network, error: ApproximationError) -> Start:
    """Return a start from image points, or say why there is none.

    Args:
        network: the network.
        error: what the search for approximate values has missed.

    Raises:
        ApproximationError: photos are not what was missed; PoseLib is not installed; or photos and
            points remain without values, which the error names.
    """
    if not network.n_image_points or not error.photos:
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
