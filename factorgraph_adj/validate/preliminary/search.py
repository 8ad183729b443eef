"""All preliminary checks of a network."""

from __future__ import annotations

from ...errors import InputError
from ...graph.equations import compile_rows
from ...network.network import Network
from .against_given import against_given
from .closures import closures
from .finding import Finding
from .heights import heights
from .in_frames import in_frames
from .repeated import repeated
from .traverses import traverses
from .undetermined import undetermined


def mistaken(network: Network) -> tuple[Finding, ...]:
    """Return mistakes of whole groups that given coordinates tell of: units, signs, axes."""
    try:
        return tuple(against_given(compile_rows(network)))
    except InputError:
        return ()


def preliminary(network: Network) -> tuple[Finding, ...]:
    """Check the readings of a network without adjusting it.

    The two faces of targets, where readings were reduced; levelled loops, loops of GNSS vectors,
    and traverses; places in frames of their own, and loops of such frames; distances measured
    several times, height differences forth and back; readings that are there twice; heights of
    instruments within a set-up; units, signs, frames, axes and rotations against given coordinates;
    points that these leave undetermined, or at either of two places. Nothing is changed.

    Args:
        network: the network.
    """
    try:
        equations = compile_rows(network)
    except InputError:  # `check` tells why
        return ()
    compared = tuple(against_given(equations))
    return (
        *(Finding(str(p), "look at the readings of both faces") for p in network.doubts),
        *repeated(network),
        *heights(network),
        *closures(equations),
        *traverses(network),
        *in_frames(equations),
        *compared,
        # Where given coordinates are wrong they say nothing of geometry.
        *(() if compared else undetermined(equations)),
    )
