"""Groups that contradict given coordinates: signs, axes, photos, points behind cameras, scale.

Where both ends of readings have given coordinates, rough ones too, computed values show gross
mistakes of whole groups. A mistake is reported where another reading of a whole group fits the
coordinates `MIN_FIT_IMPROVEMENT` times better, in the median of the misfits.

The rays of a photo with given orientation are compared with the directions to its points, as they
are and as they would be with other axes, with a principal point on the other side, or with a
transposed rotation. The principal point counts: coordinates in pixels begin at a corner, so that a
wrong direction of y looks different according to the sign with which y0 was given.

Where new points have no coordinates, distances cannot be compared one by one. Traverses between
held points can: from end to end they are as long as their ends are apart. So can places in a frame
whose scale is held. Where one factor explains them all, it is that of a unit, or of a scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ..errors import known
from ..frames import LocalFrame
from ..graph.equations import Equations
from ..models.base import circular_mean, wrap
from ..models.image import ALONG_X, ALONG_Y, EXCHANGED, OTHER, in_front
from ..models.terrestrial_observations import direction_in_face_one
from ..network.network import Network
from ..start.image_axes import known_points, ray_misfits
from ..types import Array, Index
from ..units import significant
from .findings import (
    MIN_FIT_IMPROVEMENT,
    MIN_READINGS_OF_GROUP,
    Finding,
    computed_values,
    given_rows,
    median_size,
)
from .reference_frames import exchanged_latitudes, mixed_heights, vector_frames
from .traverse_misclosures import TraverseReadings, traverses_between_held_points
from .wrong_units import length_factors, wrong_units

MAX_ORIGIN_DISTANCE_M = 100_000.0
"""Distance from the origin of a curved local frame, metres, beyond which it is reported: the error
of the sphere that stands for the Earth is more than 1e-4 of the curvature there."""
MIN_DIRECTION_MISFIT_RAD = 1e-5
"""Misfit of directions, radians, below which no other order of axes is looked for: rounding, and
the errors of good directions."""
MIN_TRAVERSES_OF_SCALE = 2
"""Smallest number of traverses that determine a factor."""
MAX_UNIT_FACTOR_DIFFERENCE = 0.01
"""Largest relative difference of a factor from that of a unit."""
MIN_SCALE_DIFFERENCE = 0.1
"""Smallest difference of a factor from 1 that is reported: smaller ones are scales that an
adjustment tests as causes."""
TRANSPOSED_ROTATION = "transposed"
OTHER_SIGN_OF_Y0 = "the other side"
PHOTO_MISTAKES: Mapping[str, tuple[str, str]] = {
    ALONG_Y: (
        "with the image y axis the other way",
        "state y_axis, and y0 in the direction of y; of some photos alone, change the sign of y",
    ),
    ALONG_X: ("with the image x axis the other way", "change the sign of x, or its origin"),
    EXCHANGED: ("with x and y of the image exchanged", "exchange the columns x and y"),
    TRANSPOSED_ROTATION: ("with transposed rotation matrices", "turn the matrices"),
    OTHER_SIGN_OF_Y0: (
        "with the other sign of y0",
        "give y0 in the direction of y, as y_axis says: y0 as given lies outside the image",
    ),
}
"""What may be wrong with photos, and what to do."""


def points_behind_cameras(equations: Equations) -> Iterator[Finding]:
    """Find points behind cameras among others that lie in front.

    Where most rays of known points, or of the others, have their points behind the cameras, poses
    and points are those of a reconstruction in axes of its own, which the adjustment moves.
    """
    state = equations.unknowns.start()
    known_ = known_points(equations.network)
    for block, rows in given_rows(equations, "image"):
        assert block.lens is not None
        photo, point = block.variables[0][1][rows], block.variables[2][1][rows]
        depth = in_front(state["pose"][photo], state["point"][point], block.lens)
        for own in (known_[point], ~known_[point]):
            behind = np.flatnonzero(own & (depth < 0))
            if not 0 < len(behind) <= own.sum() / 2:
                continue
            names = [f"{block.labels(int(rows[i]))} ({-depth[i]:.3g} m)" for i in behind]
            yield Finding(
                f"the points of {len(behind)} image points lie behind the camera, by the given "
                f"coordinates and orientation: {known(names)}",
                "correct them, or leave approximate ones out",
            )


def wrong_photo_axes(equations: Equations) -> Iterator[Finding]:
    """Iterate over photos whose rotations, or image axes, fit the given orientation otherwise."""
    for block, rows in given_rows(equations, "image"):
        assert block.lens is not None
        if block.lens.takes == "places":
            continue
        poses = equations.unknowns["pose"].values
        (_, photo), (_, camera), (_, point) = ((k, i[rows]) for k, i in block.variables[:3])
        calibration = equations.unknowns["calibration"].values[camera][:, : len(block.lens.names)]
        away = equations.unknowns["point"].values[point] - poses[photo, 9:]
        rotation = poses[photo, :9].reshape(-1, 3, 3)
        xy, at = block.observed[rows], calibration[:, 1:3]

        now = ray_misfits(block.lens, calibration, xy, rotation, away)
        otherwise: list[tuple[str, Array]] = []
        for cause, axes in OTHER:
            other = axes(xy, at)
            otherwise.append((cause, ray_misfits(block.lens, calibration, other, rotation, away)))
        turned = np.swapaxes(rotation, 1, 2)
        otherwise.append(
            (TRANSPOSED_ROTATION, ray_misfits(block.lens, calibration, xy, turned, away))
        )
        moved = calibration * np.where(np.arange(calibration.shape[1]) == 2, -1.0, 1.0)
        across = ray_misfits(block.lens, moved, xy, rotation, away)

        better: dict[str, list[tuple[int, float]]] = {}
        order = np.argsort(photo, kind="stable")
        numbers, first = np.unique(photo[order], return_index=True)
        for number, own in zip(numbers.tolist(), np.split(order, first[1:]), strict=True):
            if len(own) < MIN_READINGS_OF_GROUP:
                continue
            left = [(median_size(found[own]), how) for how, found in otherwise]
            if _outside(xy[own, 1], at[own, 1]):
                left.append((median_size(across[own]), OTHER_SIGN_OF_Y0))
            best, how = min(left)
            if best * MIN_FIT_IMPROVEMENT < median_size(now[own]):
                better.setdefault(how, []).append(
                    (number, median_size(now[own]) / max(best, 1e-12))
                )
        names = equations.unknowns["pose"].names
        for how, found in better.items():
            what, remedy = PHOTO_MISTAKES[how]
            every = "s" if len(found) > 1 else ""
            times = float(np.median([t for _, t in found]))
            yield Finding(
                f"the rays of {len(found)} photo{every} with given orientation fit "
                f"{times:.0f} times better {what}: {known([names[i] for i, _ in found])}",
                remedy,
            )


def _outside(y: Array, y0: Array) -> bool:
    """Return whether a principal point lies outside the image, and would not with another sign."""
    low, high = float(y.min()), float(y.max())
    middle = float(np.median(y0))
    return not low <= middle <= high and low <= -middle <= high


def group_contradictions(
    equations: Equations, *, length: str = "m", angle: str = "gon"
) -> Iterator[Finding]:
    """Iterate over mistakes that given coordinates show.

    Where places are on another part of the Earth, nothing else is compared with them.

    Args:
        equations: the network.
        length: unit of lengths in its files.
        angle: unit of angles in its files.
    """
    elsewhere = tuple(exchanged_latitudes(equations))
    yield from elsewhere
    if elsewhere:
        return
    yield from wrong_units(equations, length, angle)
    yield from _signs(equations)
    yield from vector_frames(equations)
    yield from mixed_heights(equations.network)
    yield from _axes(equations)
    yield from _origin(equations.network)
    yield from wrong_photo_axes(equations)


def _signs(equations: Equations) -> Iterator[Finding]:
    """Height differences that fit with the other sign."""
    for block, rows in given_rows(equations, "height_difference"):
        observed, computed = computed_values(equations, block, rows)
        usual = max(median_size(observed - computed), 1e-3)
        off, turned = np.abs(observed - computed)[:, 0], np.abs(observed + computed)[:, 0]
        wrong = np.flatnonzero(
            (off > MIN_FIT_IMPROVEMENT * usual) & (turned * MIN_FIT_IMPROVEMENT < off)
        )
        for i in wrong.tolist():
            yield Finding(
                f"{block.labels(int(rows[i]))} contradicts the given heights of its points, and "
                "fits with the other sign",
                "look at its sign, and at the order of its points",
                float(off[i]),
                float(MIN_FIT_IMPROVEMENT * usual),
                "m",
            )


def _axes(equations: Equations) -> Iterator[Finding]:
    """Control with X and Y exchanged: readings turn the other way round.

    A direction is α − o with the orientation o of its set; with X and Y exchanged α becomes
    π/2 − α, so that the sum of azimuth and reading is the same for a set, not the difference.
    """
    held = np.all(~equations.unknowns["point"].free[:, :2], axis=1)
    for block, given in given_rows(equations, "direction"):
        by = {what: index for what, index in block.variables if what == "orientation"}
        ends = [index for what, index in block.variables if what == "point"]
        rows = given[held[ends[0][given]] & held[ends[1][given]]]
        if len(rows) < MIN_READINGS_OF_GROUP:
            continue
        points = np.nan_to_num(equations.unknowns["point"].values)  # heights may be unknown
        start = points[ends[0][rows]]
        enu = equations.network.frame.basis(start, np.zeros((len(rows), 2))).enu
        d = np.einsum("nij,nj->ni", enu, points[ends[1][rows]] - start)
        azimuth = np.arctan2(d[:, 0], d[:, 1])
        reading = direction_in_face_one(block.observed[rows, 0], block.constants["face"][rows])
        group = by["orientation"][rows]
        now, other = (_spread(azimuth - sign * reading, group) for sign in (1.0, -1.0))
        if max(other, MIN_DIRECTION_MISFIT_RAD) * MIN_FIT_IMPROVEMENT < now:
            yield Finding(
                f"{len(rows)} directions between held points run the other way round",
                "X and Y of the control, or the axes of the frame, are exchanged",
                float(np.rad2deg(now)),
                float(np.rad2deg(MIN_FIT_IMPROVEMENT * other)),
                "degrees",
            )


def _spread(angle: Array, group: Index) -> float:
    """Return the median deviation of angles from the mean of their group; one alone has none."""
    out = []
    for g in np.unique(group).tolist():
        own = angle[group == g]
        if len(own) > 1:
            out.append(np.abs(wrap(own - circular_mean(own))))
    return float(np.median(np.concatenate(out))) if out else 0.0


def _origin(network: Network) -> Iterator[Finding]:
    """Coordinates far from the origin of a curved local frame."""
    frame = network.frame
    if not isinstance(frame, LocalFrame) or not frame.curvature:
        return
    names = list(network.points)
    xyz = np.array([p.coordinates for p in network.points.values()]).reshape(-1, 3)
    far = np.linalg.norm((xyz - np.array(frame.origin))[:, :2], axis=1)
    far = np.nan_to_num(far)
    if len(far) and far.max() > MAX_ORIGIN_DISTANCE_M:
        yield Finding(
            f"{int((far > MAX_ORIGIN_DISTANCE_M).sum())} points lie far from the origin of the "
            f"curved frame, the farthest {names[int(far.argmax())]!r}",
            "give the frame an origin in the middle of the network",
            float(far.max()) / 1e3,
            MAX_ORIGIN_DISTANCE_M / 1e3,
            "km",
        )


def factor_meaning(factor: float, length: str) -> str:
    """Return what a factor between lengths and coordinates may mean; empty: no unit has it.

    Args:
        factor: factor by which lengths fit the coordinates.
        length: unit of lengths in the files.
    """
    factors = length_factors(length)
    unit = min(factors, key=lambda n: abs(np.log(factors[n] / factor)))
    if abs(factors[unit] / factor - 1.0) > MAX_UNIT_FACTOR_DIFFERENCE:
        return ""
    return f", as {unit}"


def traverse_scale(network: Network, length: str) -> Iterator[Finding]:
    """Report the factor by which traverses are as long as the held points at their ends are apart.

    Args:
        network: the network.
        length: unit of lengths in its files.
    """
    if not isinstance(network.frame, LocalFrame):
        return
    survey = TraverseReadings.of(network)
    factors = []
    for t in traverses_between_held_points(survey):
        x = t.computed()[0]
        reached = float(np.hypot(*(x[-1] - x[0])))
        apart = float(np.hypot(*(survey.held[t.points[-1]] - survey.held[t.points[0]])))
        if reached > 0.0 and apart > 0.0:
            factors.append(apart / reached)
    if len(factors) < MIN_TRAVERSES_OF_SCALE:
        return
    ln = np.log(factors)
    middle = float(np.median(ln))
    spread = float(np.max(np.abs(ln - middle)))
    if abs(np.expm1(middle)) < MIN_SCALE_DIFFERENCE or spread * MIN_FIT_IMPROVEMENT > abs(middle):
        return
    factor = float(np.exp(middle))
    yield Finding(
        f"{len(factors)} traverses between held points are as long as these are apart with the "
        f"factor {significant(factor, 4)}{factor_meaning(factor, length)}",
        f"state the unit of the distances, or that of the coordinates ({length} is stated)",
    )
