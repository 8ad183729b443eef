"""Reasons why unknowns have no approximate values, grouped by reason."""

from __future__ import annotations

import numpy as np

from ..errors import Problem, Unreached, known
from ..graph.equations import Equations
from ..observations.registry import PLANE_ADVICE
from ..types import Array, Index, Mask
from .frame_places import FramePlaces
from .image_rays import ImageRays, posed_photos
from .intersection import (
    MIN_COMPARED_MISFIT,
    MIN_CROSSING_SINE,
    ambiguous_positions,
    crossings,
    figure_size,
    loci_of_points,
    positions_in_space,
)
from .relative_positions import RelativePoses
from .resection import MAX_RAY_MISS_RAD, MIN_POINTS_OF_UNIQUE_POSE, direction_misses, resect
from .search_state import SearchState
from .terrestrial_readings import StationObservations

MIN_MIRRORED_SHARE = 0.8
"""Smallest share of the known points of a photo that fit if its image is mirrored."""

NOTHING_KNOWN = (
    "nothing to start from: no point has coordinates and no photo a pose; give coordinates of "
    "some points, or ask for a free network"
)
ONLY_IMAGES = (
    "nothing to start from: image measurements alone do not start a free network; give the "
    "orientation of two photos or the coordinates of four points, in any frame, or the start of "
    "fga.orient(network)"
)


def problems_of_unreached(
    equations: Equations,
    progress: SearchState,
    rays: ImageRays,
    frames: FramePlaces,
    relative: RelativePoses,
    *,
    free: bool,
) -> list[Problem]:
    """Return a problem for every point, photo, frame and set without approximate values."""
    missing = np.flatnonzero(~progress.complete)
    photos = np.flatnonzero(~posed_photos(progress))
    lost = np.flatnonzero(np.isnan(progress.frame).any(axis=1))
    if not len(missing) and not len(photos) and not len(lost):
        return []
    if not np.isfinite(progress.plan).any() and len(photos) == len(progress.pose):
        return [Problem(ONLY_IMAGES if free else NOTHING_KNOWN, "network")]
    names = equations.unknowns["point"].names
    frame_names = equations.unknowns["frame"].names
    joined = _PointConnections(progress, rays, names, frames, frame_names, _observed(equations))
    reasons: dict[tuple[str, str], list[str]] = {}
    for p in missing.tolist():
        reasons.setdefault(("point", joined.why(p)), []).append(names[p])
    for f in photos.tolist():
        why = _why_no_pose(progress, rays, relative, f)
        reasons.setdefault(("photo", why), []).append(equations.unknowns["pose"].names[f])
    for f in lost.tolist():
        why = _why_no_frame(progress, frames, f)
        reasons.setdefault(("frame", why), []).append(equations.unknowns["frame"].names[f])
    for s in _unoriented(progress).tolist():
        why = "neither its station with a target, nor its orientation could be reached"
        reasons.setdefault(("set", why), []).append(equations.unknowns["orientation"].names[s])
    return [
        Unreached(why, f"{what}{'s' if len(who) > 1 else ''} {known(who)}", what, frozenset(who))
        for (what, why), who in reasons.items()
    ]


def _unoriented(progress: SearchState) -> Index:
    """Return the sets that have directions but no orientation."""
    used = np.zeros(len(progress.orientation), dtype=bool)
    used[progress.survey.directions.third] = True
    used[len(used) - len(progress.survey.gyro) :] = False
    return np.flatnonzero(used & np.isnan(progress.orientation))


def _why_no_frame(progress: SearchState, frames: FramePlaces, frame: int) -> str:
    rows = frames.frame == frame
    point, seen = frames.point[rows], np.isfinite(frames.q[rows]).any(axis=0)
    sights = frames.sights
    partly = (sights.frame == frame) & ~sights.whole
    blind = [
        a
        for a, v, s in zip("xyz", frames.given[frame, 3:6], seen, strict=True)
        if np.isnan(v) and not s
    ]
    if not len(point) and frame in progress.survey.of_vectors:
        return (
            "only vectors are observed in it, which do not place its rotation: state values of rx, "
            "ry, rz, such as 0 for reference frames of GNSS"
        )
    if not len(point) and not partly.any():
        return "nothing is observed in it: hold its components, or take it out"
    if blind and len(point):
        return f"none of its places is observed along {' and '.join(blind)}: hold this offset"
    turns = np.isnan(frames.given[frame, :3]).sum()
    need = "three that do not lie in one line" if turns > 1 else "two, as it turns about one axis"
    if not len(point):
        point = sights.point[partly]
        need = "four with direction and zenith angle, or its station and the directions to two"
    n = int(np.count_nonzero(progress.complete[point[point >= 0]]))
    return (
        f"only {n} of its {len(point)} places are known; its approximate values need {need}, or "
        "give them"
    )


def _why_no_pose(
    progress: SearchState, rays: ImageRays, relative: RelativePoses, photo: int
) -> str:
    joined = np.flatnonzero((relative.first == photo) | (relative.second == photo))
    if len(joined):
        return _why_not_by_relative_poses(progress, rays, relative, photo, joined)
    return _why_not_resected(progress, rays, photo)


def _why_not_by_relative_poses(
    progress: SearchState, rays: ImageRays, relative: RelativePoses, photo: int, joined: Index
) -> str:
    """Return why a photo with relative poses was not reached along any of them."""
    n = len(joined)
    loose = np.isnan(progress.mount[relative.mount[joined]]).any(axis=1)
    far = np.where(relative.first[joined] == photo, relative.second[joined], relative.first[joined])
    apart = ~posed_photos(progress)[far]
    why = "all photos that its relative poses lead to are not reached either"
    if not apart.all():
        why = (
            "its mount is unknown, as no photo on it was found by its own image points"
            if loose.any()
            else f"its {n} relative pose{'s' * (n > 1)} lack the rotation or the position"
        )
    if not np.any(rays.photo == photo):
        return f"it has no image points, and {why}"
    return f"{_why_not_resected(progress, rays, photo)}; {why}"


def _why_not_resected(progress: SearchState, rays: ImageRays, photo: int) -> str:
    seen = rays.point[rays.photo == photo]
    n = int(np.count_nonzero(progress.complete[seen]))
    if n >= 4:
        why = (
            f"{n} of its {len(seen)} image points belong to known points, but no pose in front of "
            "them fits"
        )
        if _fits_mirrored(progress, rays, photo):
            return (
                f"{why}, while one of its mirror image does: x and y of its image coordinates are "
                "exchanged, or one of them has the wrong direction"
            )
        return f"{why}: check names, coordinates and calibration, or give its orientation"
    return (
        f"only {n} of its {len(seen)} image points belong to points that are known or could be "
        "reached; a resection needs 4, or 2 with a given projection centre or attitude"
    )


def _fits_mirrored(progress: SearchState, rays: ImageRays, photo: int) -> bool:
    """Return whether nearly all known points of a photo fit the mirror image."""
    rows = np.flatnonzero((rays.photo == photo) & progress.complete[rays.point])
    x = progress.horizon.from_plan(progress.plan[rays.point[rows]])
    d = rays.direction[rows] * [1.0, -1.0, 1.0]
    pose = resect(x, d)
    if len(rows) < MIN_POINTS_OF_UNIQUE_POSE or pose is None:
        return False
    fits = direction_misses(pose[0][None], pose[1][None], x, d)[0] < MAX_RAY_MISS_RAD
    return int(fits.sum()) > MIN_MIRRORED_SHARE * len(rows)


def _observed(equations: Equations) -> Mask:
    """Return which points have an observation that is not their own coordinates."""
    found = np.zeros(len(equations.unknowns["point"].names), dtype=bool)
    for block in equations.blocks:
        for kind, index in block.variables:
            if kind == "point" and not block.prior:
                found[index] = True
    return found


class _PointConnections:
    """The observations that connect every point with others."""

    def __init__(
        self,
        progress: SearchState,
        rays: ImageRays,
        names: tuple[str, ...],
        frames: FramePlaces,
        frame_names: tuple[str, ...],
        observed: Mask,
    ) -> None:
        self._progress = progress
        self._names = names
        self._frames, self._frame_names = frames, frame_names
        self._observed = observed
        self._known = progress.complete
        s = progress.survey
        self._kinds: list[tuple[str, StationObservations]] = [
            ("direction", s.directions),
            ("azimuth", s.azimuths),
            ("angle", s.angles),
            ("slope distance", s.slopes),
            ("horizontal distance", s.levels),
            ("zenith angle", s.zeniths),
            ("height difference", s.steps),
            ("GNSS vector", s.vectors),
        ]
        self._kinds = [(kind, sighted) for kind, sighted in self._kinds if sighted.n]
        self._placed = progress.placed
        n = s.n_points
        has_pose = posed_photos(progress)
        self._rays = np.bincount(rays.point[has_pose[rays.photo]], minlength=n)
        self._blind = np.bincount(rays.point[~has_pose[rays.photo]], minlength=n)
        self._loci = loci_of_points(progress)
        self._doubt: dict[int, list[Array]] = dict(ambiguous_positions(progress))
        self._in_space = {p for p, found in positions_in_space(progress) if len(found) > 1}

    def why(self, p: int) -> str:
        """Return why point ``p`` could not be reached."""
        if self._placed[p]:
            return self._why_no_height(p)
        if p in self._doubt:
            # Positions differ from point to point: such points are listed one by one.
            a, b = (self._position(at) for at in self._doubt[p])
            return f"two positions fit equally well, near {a} and {b}; give approximate coordinates"
        if p in self._in_space:
            return (
                "two positions fit its slope distances equally well, on either side of the points "
                "it was measured from; give approximate coordinates"
            )
        parts = []
        others: dict[int, None] = {}
        for kind, sighted in self._kinds:
            ends: tuple[Index, ...] = (sighted.station, sighted.target)
            if kind == "angle":
                ends = (*ends, sighted.third)
            mine = np.any([e == p for e in ends], axis=0)
            if mine.any():
                parts.append(_count(int(mine.sum()), kind))
                for e in ends:
                    others.update(dict.fromkeys(e[mine & (e != p)].tolist()))
        if self._rays[p]:
            parts.append(_count(int(self._rays[p]), "image ray"))
        if self._blind[p]:
            parts.append(_count(int(self._blind[p]), "image ray") + " from photos without pose")
        if not parts:
            return self._why_not_by_frames(p)
        found = ", ".join(parts)
        away = [self._names[q] for q in others if not self._known[q]]
        if others and len(away) == len(others) and not self._rays[p]:
            return f"{found}, joined only to points that are not reached themselves: {known(away)}"
        if set(parts) <= {"1 image ray"}:
            return "1 image ray, no distance"
        if self._rays[p] >= 2 and not others:
            return f"{found} that do not meet in front of the photos"
        if contradiction := self._contradiction(p):
            return f"{found} that contradict one another: {contradiction}"
        return f"{found}: not enough to find its position" + (
            f"; not reached either: {known(away)}" if away else ""
        )

    def _contradiction(self, p: int) -> str:
        """Return by how much what is observed of a point misses; empty if it does not."""
        own = self._loci.get(p)
        if own is None or own.count < 3:
            return ""
        size = figure_size(own)
        places = [c for c in crossings(own, size) if c.crossing >= MIN_CROSSING_SINE]
        advice = "correct what is wrong, or give approximate coordinates"
        if not places:
            return f"no two of them meet; {advice}"
        if places[0].misfit <= MIN_COMPARED_MISFIT:
            return ""
        miss = places[0].misfit * size * own.count / (own.count - 2)
        return f"where two of them meet, the rest misses by {miss:.3f} m at the least; {advice}"

    def _why_not_by_frames(self, p: int) -> str:
        """Return why a point that nothing but frames sees could not be reached."""
        observed = self._frames.frame[self._frames.point == p]
        inside = np.union1d(observed, np.flatnonzero(self._frames.origin == p)).tolist()
        if not inside and self._observed[p]:
            return "its observations give no approximate coordinates: state some"
        if not inside:
            return "no observation joins it to anything"
        lost: Mask = np.any(np.isnan(self._progress.frame), axis=1)
        named = known([self._frame_names[f] for f in inside])
        if lost[inside].all():
            return f"it is joined to frames alone that are not reached themselves: {named}"
        return f"what frames observe of it, {named}, is not enough to find its position"

    def _position(self, plan: Array) -> str:
        """Return the frame coordinates of a position in plan (2,), as text."""
        horizon = self._progress.horizon
        xyz = horizon.from_plan(np.array([[*plan, 0.0]]))[0]
        shown = xyz[:2] if horizon.by_component else xyz
        return f"({', '.join(f'{v:.3f}' for v in shown)})"

    def _why_no_height(self, p: int) -> str:
        s = self._progress.survey
        if p in s.above.point:
            return "the height of the surface above which it was measured is not known"
        known_height: Mask = np.isfinite(self._progress.plan[:, 2])
        joined = False
        for sighted in (s.steps, s.zeniths, s.slopes, s.vectors):
            joined |= bool(np.any((sighted.station == p) | (sighted.target == p)))
        if not joined:
            in_space = any(len(seen.station) for seen in (s.steps, s.zeniths, s.slopes, s.vectors))
            advice = (
                f"observe it, hold z, or {PLANE_ADVICE}"
                if in_space
                else "hold z in a plane network"
            )
            return f"its height is not observed; {advice}"
        if not known_height.any():
            return "no height is known in the network; give one, or ask for a free network"
        return "its height is not joined to a known height"


def _count(n: int, what: str) -> str:
    """Return ``1 image ray`` or ``2 image rays``."""
    return f"{n} {what}" + ("s" if n != 1 else "")
