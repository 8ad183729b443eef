"""The search for approximate values: its steps in order; unknowns with one component.

Given values are kept. The most certain step that finds a value comes first: orientations, polar
points and heights, then frames and photos, then weaker intersections; a free network starts
anywhere. Unknowns with one component, such as sizes, levels and constants, come last: an unknown s
of which residuals depend as v(s) = v(0) + J s has the value −Jᵀv(0)/JᵀJ from each observation of
which all other unknowns are known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import ApproximationError, Problem
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.unknown_registry import Quantity, parameter_kinds
from ..network.network import DatumChoice
from ..observations import AstronomicLatitude, AstronomicLongitude
from ..types import Array, Mask
from .alignment_frames import (
    alignment_observations,
    frames_of_image_lines,
    place_alignments,
    place_image_lines,
)
from .frame_places import FramePlaces, fill_points_from_frames, place_frames, read_frame_places
from .image_rays import (
    GOOD_PARALLAX_RAD,
    MIN_PARALLAX_RAD,
    ImageRays,
    intersect_rays,
    intersect_single_rays,
    place_far_points,
    read_rays,
)
from .intersection import (
    GOOD_CROSSING_SINE,
    MIN_CROSSING_SINE,
    intersect_in_plan,
    intersect_spheres,
    start_from_slope_distances,
)
from .polar_points import orient_sets, orient_sets_by_model, place_clouds, place_polar_points
from .relative_blocks import join_blocks, observed_misfits, resolve_ambiguity, start_height
from .relative_positions import (
    RelativePoses,
    fill_given_coordinates,
    fill_heights,
    fill_mounts,
    fill_poses,
    fill_surface_heights,
    fill_vector_ends,
    given_positions,
    height_differences,
    open_mounts,
    read_relative_poses,
    share_gyro_constants,
    start_surface,
    start_with_photo,
)
from .resection import intersect_sights, orient_frames, resect_frames, resect_photos, start_frame
from .search_state import Horizon, SearchState, horizon_place
from .shape_fit import frames_of_shapes, place_shapes
from .terrestrial_readings import median_angle, read_survey
from .unreached_unknowns import problems_of_unreached

MAX_MISFIT_OF_GIVEN_VALUES = 0.05
"""Misfit of a length (relative) or an angle (radians) above which a coordinate must be rough."""


def fill_single_components(equations: Equations, state: State) -> list[Problem]:
    """Fill missing values of unknowns with one component; return a problem for each that is left.

    An unknown s of which residuals depend as v(s) = v(0) + J s has, from each observation of which
    all other unknowns are known, the value −Jᵀv(0)/JᵀJ; its start value is their median, that of
    angles about their circular mean.
    """
    problems = []
    for record in parameter_kinds():
        kind = record.name
        missing = np.isnan(state[kind])
        if record.size != 1 or record.rotates or not missing.any():
            continue
        found: dict[int, list[float]] = {}
        for block in equations.blocks:
            places = [j for j, (what, _) in enumerate(block.variables) if what == kind]
            for place in places:
                for number, value in _values_from_rows(equations, block, place, state):
                    found.setdefault(number, []).append(value)
        for number in np.flatnonzero(missing[:, 0]).tolist():
            if number in found:
                state[kind][number, 0] = _median_value(found[number], record.components[0].quantity)
                continue
            what = "no approximate value: no observation of it has all its other unknowns known"
            name = equations.unknowns[kind].names[number]
            problems.append(Problem(what, f"{record.noun} {name!r}"))
    return problems


def _median_value(values: list[float], quantity: Quantity) -> float:
    """Return the median of values, that of angles about their circular mean."""
    return median_angle(np.array(values)) if quantity == "angle" else float(np.median(values))


def _values_from_rows(
    equations: Equations, block: Block, place: int, state: State
) -> list[tuple[int, float]]:
    """Return number and value of the unknown at a place of the variables, from each row."""
    kind, index = block.variables[place]
    wanted = np.isnan(state[kind][index, 0])
    for j, (what, other) in enumerate(block.variables):
        if j != place:
            wanted &= ~np.isnan(state[what][other]).any(axis=1)
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return []
    chosen = block.select(rows)
    trial = {**state, kind: np.nan_to_num(state[kind])}
    computed = chosen.evaluate(equations.network.frame, trial)
    by_it: Array = computed.jacobians[place][:, :, 0]
    square = np.sum(by_it**2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = -np.sum(by_it * computed.residual, axis=1) / square
    sound = np.isfinite(values)
    return list(zip(index[rows][sound].tolist(), values[sound].tolist(), strict=True))


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
    state, problems = partial_approximation(equations, datum=datum)
    if problems:
        lost = [
            (kind, equations.unknowns[kind].names[i])
            for kind, values in state.items()
            for i in np.flatnonzero(np.isnan(values).any(axis=1)).tolist()
        ]
        photos = [name for kind, name in lost if kind == "pose"]
        raise ApproximationError(problems, photos=photos, unknowns=lost)
    return state


def partial_approximation(
    equations: Equations, *, datum: DatumChoice | None = None, apart: bool = False
) -> tuple[State, list[Problem]]:
    """Return start values as `approximate`, NaN if not found, and the problems of those.

    With ``apart`` points that share no observation help each other to no value.
    """
    state = equations.unknowns.start()
    relative = read_relative_poses(equations)
    mounts_wanted = bool(relative.wanted.any())
    if not mounts_wanted and not any(np.isnan(values).any() for values in state.values()):
        return state, []
    state["vertical"] = np.nan_to_num(state["vertical"])
    if mounts_wanted or any(np.isnan(state[kind]).any() for kind in ("point", "pose", "frame")):
        progress, seen = _search_input(equations, state, relative)
        free = (datum or equations.network.datum) == "free"
        before_search = progress.copy()
        _search(progress, seen, free=free, apart=apart)
        progress = _without_contradiction(
            equations, progress, before_search, seen, free=free, apart=apart
        )
        _fill_missing(progress, state)
        # The points of shapes and wires and the photos of lines come first.
        later = (
            frames_of_shapes(equations)
            | frames_of_image_lines(equations)
            | set(alignment_observations(equations))
        )
        progress.frame[sorted(later)] = 0.0
        problems = problems_of_unreached(
            equations, progress, seen.rays, seen.frames, seen.relative, free=free
        )
        if problems:
            return state, problems
    problems = [
        *place_shapes(equations, state),
        *place_image_lines(equations, state),
        *place_alignments(equations, state),
    ]
    if problems:
        return state, problems
    orient_sets_by_model(equations.blocks, equations.network.frame, state)
    return state, fill_single_components(equations, state)


@dataclass(frozen=True)
class _SearchInput:
    """Observations, in arrays, of which the steps of the search make values."""

    rays: ImageRays
    """Image rays."""
    frames: FramePlaces
    """Places that are observed in frames."""
    relative: RelativePoses
    """Relative poses of photos."""
    mounts: Array
    """Mounts as they were stated, (m, 12)."""


def _search_input(
    equations: Equations, state: State, relative: RelativePoses
) -> tuple[SearchState, _SearchInput]:
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
    horizon = Horizon(frame, horizon_place(frame, given, latitude, longitude))
    survey = read_survey(equations, horizon.curvature)
    progress = SearchState(
        survey,
        horizon,
        horizon.to_plan(state["point"]),
        np.concatenate([state["orientation"][:, 0], state["gyro"][survey.gyro, 0]]),
        state["pose"].copy(),
        state["frame"].copy(),
        open_mounts(state["mount"], relative.wanted),
        survey.above.height.copy(),
    )
    fill_given_coordinates(equations, progress)
    seen = _SearchInput(
        read_rays(equations), read_frame_places(equations), relative, state["mount"].copy()
    )
    return progress, seen


def _search(progress: SearchState, seen: _SearchInput, *, free: bool, apart: bool) -> None:
    """Repeat the most certain step that finds a value, until no step finds any."""
    rays, frames, relative = seen.rays, seen.frames, seen.relative
    steps: tuple[Callable[[], bool], ...] = (
        lambda: _sure_steps(progress),
        lambda: place_frames(progress, frames) | fill_points_from_frames(progress, frames),
        lambda: orient_frames(progress, frames),
        lambda: intersect_sights(progress, frames, parallax=GOOD_PARALLAX_RAD),
        lambda: intersect_rays(
            progress, rays, parallax=GOOD_PARALLAX_RAD, wanted=~progress.complete
        ),
        lambda: resect_frames(progress, frames),
        lambda: resect_photos(progress, rays, least=6),
        lambda: fill_mounts(progress, relative, seen.mounts),
        lambda: fill_poses(progress, relative),
        lambda: intersect_in_plan(progress, crossing=GOOD_CROSSING_SINE),
        lambda: resect_photos(progress, rays, least=4),
        lambda: intersect_in_plan(progress, crossing=MIN_CROSSING_SINE),
        lambda: intersect_spheres(progress),
        lambda: intersect_sights(progress, frames, parallax=MIN_PARALLAX_RAD),
        lambda: intersect_rays(
            progress, rays, parallax=MIN_PARALLAX_RAD, wanted=~progress.complete
        ),
        lambda: intersect_single_rays(progress, rays),
        lambda: not apart and place_far_points(progress, rays),
        lambda: resolve_ambiguity(progress, mirror=False),
        lambda: free and start_frame(progress, frames),
        lambda: join_blocks(progress, free=free),
        lambda: free and resolve_ambiguity(progress, mirror=True),
        lambda: free and start_from_slope_distances(progress),
        lambda: free and start_height(progress, height_differences(progress)[0]),
        lambda: free and start_with_photo(progress, relative),
        lambda: free and start_surface(progress),
    )
    while any(step() for step in steps):
        pass


def _without_contradiction(
    equations: Equations,
    first: SearchState,
    second: SearchState,
    seen: _SearchInput,
    *,
    free: bool,
    apart: bool,
) -> SearchState:
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
        apart: as in `partial_approximation`.
    """
    misfit = observed_misfits(first)
    table = equations.unknowns["point"]
    rough = table.free & ~np.isfinite(table.sigma)
    if (
        not (misfit > MAX_MISFIT_OF_GIVEN_VALUES).any()
        or not np.isfinite(table.values[rough]).any()
    ):
        return first
    given = second.plan.copy()
    second.plan = second.horizon.to_plan(np.where(rough, np.nan, table.values))
    fill_given_coordinates(equations, second)
    _search(second, seen, free=False, apart=apart)
    every = np.arange(len(given))
    second.set_plan(every, given[:, :2])
    second.set_height(every, given[:, 2])
    _search(second, seen, free=free, apart=apart)
    better = np.nansum(observed_misfits(second)) < np.nansum(misfit)
    return second if better and second.complete.sum() >= first.complete.sum() else first


def _sure_steps(progress: SearchState) -> bool:
    """Fill orientations, polar points, heights and ends of vectors; return whether any was."""
    found_any = False
    while (
        place_clouds(progress)
        | orient_sets(progress)
        | share_gyro_constants(progress)
        | place_polar_points(progress)
        | fill_heights(progress)
        | fill_surface_heights(progress)
        | fill_vector_ends(progress)
    ):
        found_any = True
    return found_any


def _fill_missing(progress: SearchState, state: State) -> None:
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
