"""The search for approximate values: steps are repeated until no further value can be found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import ApproximationError, Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..network.network import DatumChoice
from ..observations import AstronomicLatitude, AstronomicLongitude
from ..types import Array, Mask
from .additive import solve_additive
from .alignments import align, aligned
from .clouds import join_clouds
from .diagnosis import not_reached
from .frame_sights import intersect_sights, orient_frames, resect_frames, start_frame
from .free_start import join_blocks, observed_misfits, resolve_doubt, start_heights
from .horizon import Horizon, place_of
from .image_lines import lines_in_images, place_image_lines
from .in_frames import InFrames, read_frames
from .intersection import GOOD_CROSSING, LEAST_CROSSING, intersect
from .levelling import height_differences, heights
from .orientation import orient, orient_by_model
from .polar import polar
from .progress import Progress
from .rays import GOOD_PARALLAX, LEAST_PARALLAX, ImageRays, intersect_rays, read_rays
from .relative_poses import (
    RelativePoses,
    along_relative_poses,
    mounts_of_photos,
    open_mounts,
    read_relative_poses,
    start_anywhere,
)
from .resection import resections
from .shapes import on_shapes, place_shapes
from .single_ray import far_points, ray_and_more
from .spheres import spheres, start_in_space
from .sub_frames import place_frames, places_in_frames
from .surfaces import above_surfaces, share_gyros, start_surface
from .survey import read_survey
from .vectors import given_positions, known_coordinates, vectors

ROUGH = 0.05
"""Misfit of a length (relative) or an angle (radians) above which a coordinate must be rough."""


@with_one_thread
def approximate(equations: Equations, *, datum: DatumChoice | None = None) -> State:
    """Return start values of all unknowns; given values are kept.

    Orientation unknowns, points and photos without values are computed in rounds from known
    values, see the modules of this package.

    Args:
        equations: the equations of a network.
        datum: overrides the datum of the network; ``free`` allows an arbitrary start of a network
            without known points.

    Raises:
        ApproximationError: some unknowns have no approximate values; the error lists every such
            point, photo and set, and the reason.
    """
    state, problems = reach(equations, datum=datum)
    if problems:
        lost = [
            (kind, equations.unknowns[kind].names[i])
            for kind, values in state.items()
            for i in np.flatnonzero(np.isnan(values).any(axis=1)).tolist()
        ]
        photos = [name for kind, name in lost if kind == "pose"]
        raise ApproximationError(problems, photos=photos, unknowns=lost)
    return state


def reach(
    equations: Equations, *, datum: DatumChoice | None = None, apart: bool = False
) -> tuple[State, list[Problem]]:
    """Return start values as `approximate`, NaN if not found, and the problems of those.

    With ``apart`` points that share no observation help each other to no value.
    """
    state = equations.unknowns.start()
    relative = read_relative_poses(equations)
    looked_for = bool(relative.wanted.any())
    if not looked_for and not any(np.isnan(values).any() for values in state.values()):
        return state, []
    state["vertical"] = np.nan_to_num(state["vertical"])
    if looked_for or any(np.isnan(state[kind]).any() for kind in ("point", "pose", "frame")):
        progress, seen = _begin(equations, state, relative)
        free = (datum or equations.network.datum) == "free"
        forgetful = progress.copy()
        _search(progress, seen, free=free, apart=apart)
        progress = _without_contradiction(
            equations, progress, forgetful, seen, free=free, apart=apart
        )
        _take_over(progress, state)
        # The points of shapes and wires and the photos of lines come first.
        later = on_shapes(equations) | lines_in_images(equations) | set(aligned(equations))
        progress.frame[sorted(later)] = 0.0
        problems = not_reached(
            equations, progress, seen.rays, seen.frames, seen.relative, free=free
        )
        if problems:
            return state, problems
    problems = [
        *place_shapes(equations, state),
        *place_image_lines(equations, state),
        *align(equations, state),
    ]
    if problems:
        return state, problems
    orient_by_model(equations, state)
    return state, solve_additive(equations, state)


@dataclass(frozen=True)
class _Seen:
    """Observations, in arrays, of which the steps of the search make values."""

    rays: ImageRays
    """Image rays."""
    frames: InFrames
    """Places that are observed in frames."""
    relative: RelativePoses
    """Relative poses of photos."""
    mounts: Array
    """Mounts as they were stated, (m, 12)."""


def _begin(equations: Equations, state: State, relative: RelativePoses) -> tuple[Progress, _Seen]:
    frame = equations.network.frame
    latitude, longitude = (
        float(
            np.median(
                [o.value for o in equations.network.observations.values() if type(o) is kind]
                or [0.0]
            )
        )
        for kind in (AstronomicLatitude, AstronomicLongitude)
    )
    given = np.concatenate([state["point"], given_positions(equations.network)])
    horizon = Horizon(frame, place_of(frame, given, latitude, longitude))
    survey = read_survey(equations, horizon.curvature)
    progress = Progress(
        survey,
        horizon,
        horizon.to_plan(state["point"]),
        np.concatenate([state["orientation"][:, 0], state["gyro"][survey.gyro, 0]]),
        state["pose"].copy(),
        state["frame"].copy(),
        open_mounts(state["mount"], relative.wanted),
        survey.above.height.copy(),
    )
    known_coordinates(equations, progress)
    seen = _Seen(read_rays(equations), read_frames(equations), relative, state["mount"].copy())
    return progress, seen


def _search(progress: Progress, seen: _Seen, *, free: bool, apart: bool) -> None:
    """Repeat the most certain step that finds a value, until no step finds any."""
    rays, frames, relative = seen.rays, seen.frames, seen.relative
    steps: tuple[Callable[[], bool], ...] = (
        lambda: _sure_steps(progress),
        lambda: place_frames(progress, frames) | places_in_frames(progress, frames),
        lambda: orient_frames(progress, frames),
        lambda: intersect_sights(progress, frames, parallax=GOOD_PARALLAX),
        lambda: intersect_rays(progress, rays, parallax=GOOD_PARALLAX, wanted=~progress.complete),
        lambda: resect_frames(progress, frames),
        lambda: resections(progress, rays, least=6),
        lambda: mounts_of_photos(progress, relative, seen.mounts),
        lambda: along_relative_poses(progress, relative),
        lambda: intersect(progress, crossing=GOOD_CROSSING),
        lambda: resections(progress, rays, least=4),
        lambda: intersect(progress, crossing=LEAST_CROSSING),
        lambda: spheres(progress),
        lambda: intersect_sights(progress, frames, parallax=LEAST_PARALLAX),
        lambda: intersect_rays(progress, rays, parallax=LEAST_PARALLAX, wanted=~progress.complete),
        lambda: ray_and_more(progress, rays),
        lambda: not apart and far_points(progress, rays),
        lambda: resolve_doubt(progress, mirror=False),
        lambda: free and start_frame(progress, frames),
        lambda: join_blocks(progress, free=free),
        lambda: free and resolve_doubt(progress, mirror=True),
        lambda: free and start_in_space(progress),
        lambda: free and start_heights(progress, height_differences(progress)[0]),
        lambda: free and start_anywhere(progress, relative),
        lambda: free and start_surface(progress),
    )
    while any(step() for step in steps):
        pass


def _without_contradiction(
    equations: Equations,
    first: Progress,
    second: Progress,
    seen: _Seen,
    *,
    free: bool,
    apart: bool,
) -> Progress:
    """Search again without the approximate coordinates of free points if they contradict.

    One rough coordinate may turn a whole set of directions. The second search starts from held,
    weighted and control coordinates, and uses approximate coordinates only where it ends. The
    better of the two results is returned.

    Args:
        equations: the equations.
        first: result of the search with all given values.
        second: the given values; is filled.
        seen: observations of which the steps make values.
        free: whether the datum is free.
        apart: as in `reach`.
    """
    misfit = observed_misfits(first)
    table = equations.unknowns["point"]
    rough = table.free & ~np.isfinite(table.sigma)
    if not (misfit > ROUGH).any() or not np.isfinite(table.values[rough]).any():
        return first
    given = second.plan.copy()
    second.plan = second.horizon.to_plan(np.where(rough, np.nan, table.values))
    known_coordinates(equations, second)
    _search(second, seen, free=False, apart=apart)
    every = np.arange(len(given))
    second.set_plan(every, given[:, :2])
    second.set_height(every, given[:, 2])
    _search(second, seen, free=free, apart=apart)
    better = np.nansum(observed_misfits(second)) < np.nansum(misfit)
    return second if better and second.complete.sum() >= first.complete.sum() else first


def _sure_steps(progress: Progress) -> bool:
    """Fill orientations, polar points, heights and ends of vectors; return whether any was."""
    led_on = False
    while (
        join_clouds(progress)
        | orient(progress)
        | share_gyros(progress)
        | polar(progress)
        | heights(progress)
        | above_surfaces(progress)
        | vectors(progress)
    ):
        led_on = True
    return led_on


def _take_over(progress: Progress, state: State) -> None:
    """Fill the missing values of the state; given values are kept."""
    missing = np.isnan(state["point"])
    rows = np.flatnonzero(missing.any(axis=1))
    found = progress.horizon.from_plan(progress.plan[rows])
    state["point"][rows] = np.where(missing[rows], found, state["point"][rows])
    state["pose"] = np.where(np.isnan(state["pose"]), progress.pose, state["pose"])
    # Its offset belongs to the scale with which it was found, whatever scale was to start with.
    lost: Mask = np.any(np.isnan(state["frame"]), axis=1)
    state["frame"] = np.where(lost[:, None], progress.frame, state["frame"])
    state["mount"] = np.where(np.isnan(progress.mount), state["mount"], progress.mount)
