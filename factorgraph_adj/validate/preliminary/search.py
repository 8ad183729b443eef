"""All preliminary checks of a network."""

from __future__ import annotations

from ...blas_threads import with_one_thread
from ...errors import InputError
from ...graph.equations import compile_rows
from ...network.network import Network
from .against_given import against_given
from .behind_cameras import behind_cameras
from .between_given import between_given
from .circles import beyond_circle, level_sights
from .closures import closures, lines_between_given
from .finding import Finding
from .given_units import compared_kinds
from .heights import exchanged_heights, heights
from .in_frames import in_frames
from .repeated import repeated
from .scale import traverse_scale
from .surfaces import surfaces
from .traverses import traverses
from .undetermined import undetermined


def mistaken(network: Network, *, length: str = "m", angle: str = "gon") -> tuple[Finding, ...]:
    """Return mistakes with a name: of whole groups, such as units, signs and axes, and of one.

    One reading, or one given height, alone explains what does not fit.

    Args:
        network: the network.
        length: unit of lengths in its files.
        angle: unit of angles in its files.
    """
    try:
        equations = compile_rows(network)
    except InputError:
        return ()
    groups = (
        *against_given(equations, length=length, angle=angle),
        *exchanged_heights(network),
    )
    if groups:
        return groups
    single = (
        *between_given(equations, length=length, angle=angle),
        *closures(equations),
        *lines_between_given(equations),
    )
    return tuple({f.cause: f for f in reversed(single) if f.cause}.values())


@with_one_thread
def preliminary(network: Network, *, length: str = "m", angle: str = "gon") -> tuple[Finding, ...]:
    """Check the readings of a network without adjusting it.

    The two faces of targets, where readings were reduced; rows that a reader left out; levelled
    loops, loops of GNSS vectors, and traverses; readings and
    lines between given points; places in frames of their own, and loops of such
    frames; distances measured several times, height differences forth and back; readings that are
    there twice; angles beyond the circle, and zenith angles that are level in another unit; heights
    of instruments within a set-up; stated heights of surfaces, points behind cameras, units, signs,
    frames, axes and
    rotations against given coordinates;
    points that these leave undetermined, or at either of two places. Nothing is changed.

    Args:
        network: the network.
        length: unit of lengths in its files, in which findings are told.
        angle: unit of angles in its files.
    """
    try:
        equations = compile_rows(network)
    except InputError:  # `check` tells why
        return ()
    compared = tuple(against_given(equations, length=length, angle=angle))
    turned = tuple(exchanged_heights(network))
    return (
        # What whole groups have in common explains what does not fit one by one.
        *compared,
        *turned,
        *(Finding(str(p), "look at the readings of both faces") for p in network.doubts),
        *(Finding(str(left), "correct the file") for left in network.left_out if left.doubtful),
        *(() if compared else traverse_scale(network, length)),
        *(() if compared else between_given(equations, length=length, angle=angle)),
        *beyond_circle(network, angle),
        *level_sights(network, angle, compared_kinds(equations)),
        *repeated(network),
        *(() if turned else heights(network)),
        *closures(equations),
        *(() if compared else lines_between_given(equations)),
        *traverses(network),
        *in_frames(equations, length, angle),
        *surfaces(equations),
        *behind_cameras(equations),
        # Where given coordinates are wrong they say nothing of geometry.
        *(() if compared else undetermined(equations)),
    )
