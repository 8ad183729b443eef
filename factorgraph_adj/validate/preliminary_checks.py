"""All checks of readings before an adjustment: `preliminary`; mistakes that explain misfits."""

from __future__ import annotations

from ..blas_threads import with_one_thread
from ..errors import InputError, taking
from ..graph.equations import compile_rows
from ..network.network import Network
from .contradicting_groups import group_contradictions, points_behind_cameras, traverse_scale
from .contradicting_readings import contradicting_readings
from .findings import Finding
from .frame_mistakes import misfitting_frames
from .loop_misclosures import lines_between_given, open_loops
from .repeated_readings import differing_repetitions
from .stated_values import (
    contradicting_surfaces,
    differing_heights,
    doubtful_distortion_tables,
    exchanged_heights,
    intervals_without_readout,
    places_beyond_coefficients,
    places_beyond_tables,
)
from .traverse_misclosures import open_traverses
from .undetermined_points import weakly_determined_points
from .wrong_units import angles_beyond_circle, compared_kinds, level_sights


def named_mistakes(
    network: Network, *, length: str = "m", angle: str = "gon"
) -> tuple[Finding, ...]:
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
        *group_contradictions(equations, length=length, angle=angle),
        *exchanged_heights(network),
    )
    if groups:
        return groups
    single = (
        *contradicting_readings(equations, length=length, angle=angle),
        *open_loops(equations),
        *lines_between_given(equations),
    )
    return tuple({f.cause: f for f in reversed(single) if f.cause}.values())


@taking(Network)
@with_one_thread
def preliminary(network: Network, *, length: str = "m", angle: str = "gon") -> tuple[Finding, ...]:
    """Check the readings of a network without adjusting it.

    The two faces of targets, where readings were reduced; rows that a reader left out; levelled
    loops, loops of GNSS vectors, and traverses; readings and
    lines between given points; places in frames of their own, and loops of such
    frames; distances measured several times, height differences forth and back; readings that are
    there twice; angles beyond the circle, and zenith angles that are level in another unit; heights
    of instruments within a set-up; intervals of motions without a readout time; image points beyond
    the table of distortions of their lens, tables in another unit than the image, points far
    outside the range of rational polynomials; stated heights of surfaces, points behind cameras,
    units, signs, frames, axes and rotations against given
    coordinates; points that these leave undetermined, or at either of two places. Nothing is
    changed.

    Args:
        network: the network.
        length: unit of lengths in its files, in which findings are reported.
        angle: unit of angles in its files.
    """
    try:
        equations = compile_rows(network)
    except InputError:  # `check` states why
        return ()
    compared = tuple(group_contradictions(equations, length=length, angle=angle))
    turned = tuple(exchanged_heights(network))
    return (
        # What whole groups have in common explains what does not fit one by one.
        *compared,
        *turned,
        *(Finding(str(p), "look at the readings of both faces") for p in network.doubts),
        *(Finding(str(left), "correct the file") for left in network.left_out if left.doubtful),
        *(() if compared else traverse_scale(network, length)),
        *(() if compared else contradicting_readings(equations, length=length, angle=angle)),
        *angles_beyond_circle(network, angle),
        *level_sights(network, angle, compared_kinds(equations)),
        *differing_repetitions(network),
        *(() if turned else differing_heights(network)),
        *intervals_without_readout(network),
        *doubtful_distortion_tables(equations),
        *places_beyond_tables(equations),
        *places_beyond_coefficients(equations),
        *open_loops(equations),
        *(() if compared else lines_between_given(equations)),
        *open_traverses(network),
        *misfitting_frames(equations, length, angle),
        *contradicting_surfaces(equations),
        *points_behind_cameras(equations),
        # Where given coordinates are wrong they say nothing of geometry.
        *(() if compared else weakly_determined_points(equations)),
    )
