"""Block orientation without start values: `orient`, and parts brought into the network's frame.

Every part starts from a pair of photos and grows by resection and intersection; known coordinates,
attitudes and lengths bring it into the frame of the network. Nothing is taken out of the network:
the result is a start of the adjustment, with values of all other unknowns, and names what does not
agree with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import ApproximationError, InputError, Problem, taking, unknown_name
from ..graph.equations import Equations, compile_network
from ..graph.variables import State
from ..network.network import DatumChoice, Network
from ..start.approximate_values import approximate, partial_approximation
from ..start.image_rays import nearest_to_rays
from ..start.start_values import Start
from ..types import Array, Mask
from .block_growth import BlockPart, build_parts
from .block_input import KnownPlaces, Views, given_places, known_lengths, ray_directions
from .block_placement import PartPlacement, place_part
from .block_start import (
    BlockStart,
    OrientedPart,
    add_photos_of_known_pose,
    doubts_of_parts,
    orient_by_given_centre_or_attitude,
    reason_no_pair,
    reason_not_oriented,
)
from .partial_block import GROWTH, PartialBlock
from .robust_poses import RAYLEIGH_MEDIAN, poselib_solvers, ray_misses
from .unknown_calibration import PrincipalDistances

MAX_MISS_RATIO_AT_STATED_POINT = 10.0
"""Multiple of the limit of misses within which an image point agrees with stated coordinates."""
MIN_KNOWN_PLACES = 3
"""Number of known coordinates that place a part without values found by other steps."""


@dataclass
class Assembly:
    """Parts of a block on their way into the frame of its network."""

    equations: Equations
    """The network in arrays."""
    views: Views
    """Its image points."""
    parts: list[BlockPart]
    """The parts, in axes of their own."""
    datum: DatumChoice | None = None
    """Given or free; none: the datum of the network."""

    def start(self, distances: PrincipalDistances) -> BlockStart:
        """Return the start of the adjustment."""
        equations = self.equations
        placed = self.placed(equations)
        v = self.views
        pose = np.full((len(v.photos), 12), np.nan)
        point = np.full((len(v.points), 3), np.nan)
        fits = np.zeros(v.n, dtype=bool)
        for part, at in zip(self.parts, placed, strict=True):
            g = part.growth
            pose[g.posed] = at.to_frame.of_poses(g.pose[g.posed])
            new = g.placed & np.isnan(point[:, 0])
            point[new] = at.to_frame.of(g.point[new])
            fits |= part.fits
        known = given_places(equations)
        whole = self._whole(pose, point)
        fits |= add_photos_of_known_pose(whole, known)
        some = np.zeros(len(pose), dtype=bool)
        if any(at.complete for at in placed):
            some, agree = orient_by_given_centre_or_attitude(whole, known)
            fits |= agree
        pose, point = whole.pose, whole.point
        at_once = known.point
        stated = np.isfinite(at_once).all(axis=1) & np.isnan(point[:, 0])
        point[stated] = at_once[stated]
        fits |= self._near_stated(pose, point, stated)
        unreached = self._rough_points(pose, point)
        judged = np.isfinite(pose[v.photo, 0]) & self.parts[0].growth.rays.usable
        doubtful = ~fits & judged
        state, problems = self._state(equations, pose, point)
        found = BlockStart(
            self.equations.network,
            state,
            tuple(self._told(p, at) for p, at in zip(self.parts, placed, strict=True)),
            tuple(v.label(int(row)) for row in np.flatnonzero(doubtful)),
            doubtful,
            self._unoriented(pose, point, known),
            unreached,
            distances.found(self.parts[0].growth.calibrations),
            problems,
            tuple(np.array(v.photos, dtype=object)[some].tolist()),
            doubts_of_parts(v, self.parts, distances),
        )
        if state is None:
            return found
        begun = replace(
            state, words=found.sentences(), doubtful=found.doubtful, unreached=unreached
        )
        return replace(found, start=begun)

    def placed(self, equations: Equations) -> list[PartPlacement]:
        """Return the place of each part, the best known one first; later ones may join it."""
        there = given_places(equations)
        measured = list(known_lengths(equations))
        places = np.isfinite(np.concatenate([there.point, there.pose[:, 9:]])).all(axis=1)
        if places.sum() < MIN_KNOWN_PLACES and len(self.equations.network.observations):
            state, _ = partial_approximation(equations, datum=self.datum)
            there = there.filled(state)
        joined = np.zeros(len(there.point), dtype=bool)
        out: list[PartPlacement | None] = [None] * len(self.parts)
        open_ = list(range(len(self.parts)))
        while open_:
            trials = {
                i: place_part(self.parts[i].growth, equations, there, measured, joined)
                for i in open_
            }
            best = max(
                open_, key=lambda i: (trials[i].complete, np.isfinite(trials[i].misfits).sum(), -i)
            )
            found = trials[best]
            if (
                not found.complete
                and not np.isfinite(found.misfits).any()
                and out.count(None) < len(out)
            ):
                words = f"{found.words}; nothing joins it to the other parts"
                found = replace(found, words=words)
            out[best] = found
            open_.remove(best)
            growth = self.parts[best].growth
            new = growth.placed & ~np.isfinite(there.point).all(axis=1)
            moved = there.point.copy()
            moved[new] = found.to_frame.of(growth.point[new])
            joined |= new
            there = KnownPlaces(moved, there.pose)
        return [p for p in out if p is not None]

    def _whole(self, pose: Array, point: Array) -> PartialBlock:
        """Return all parts as one, in the frame of the network."""
        growth = self.parts[0].growth.copy()
        growth.pose, growth.point = pose.copy(), point.copy()
        growth.wanted, growth.ended = growth.rays.usable, True
        return growth

    def _near_stated(self, pose: Array, point: Array, stated: Mask) -> Mask:
        """Return the image points of stated points that are near them, (n,).

        Such a point has too few rays that meet: its coordinates are compared in the frame of the
        network, to which the whole part was brought by other coordinates.
        """
        v, growth = self.views, self.parts[0].growth
        rows = np.flatnonzero(stated[v.point] & np.isfinite(pose[v.photo, 0]))
        at = pose[v.photo[rows]]
        r, tangent = at[:, :9].reshape(-1, 3, 3), growth.rays.tangent[rows]
        miss = ray_misses(r, at[:, 9:], point[v.point[rows]], tangent) / growth.rays.unit[rows]
        out = np.zeros(v.n, dtype=bool)
        out[rows[miss <= MAX_MISS_RATIO_AT_STATED_POINT * growth.limit]] = True
        return out

    def _rough_points(self, pose: Array, point: Array) -> tuple[str, ...]:
        """Give rough coordinates to points of oriented photos that have none; return their names.

        They are where the rays are nearest to one another if that is in front of all photos, and
        otherwise at the typical depth on the first ray.
        """
        v = self.views
        rays = self.parts[0].growth.rays
        oriented = np.isfinite(pose[:, 0])
        rows = np.flatnonzero(oriented[v.photo] & np.isnan(point[v.point, 0]))
        if not len(rows):
            return ()
        at, t = pose[v.photo[rows]], rays.tangent[rows]
        number, first, group = np.unique(v.point[rows], return_index=True, return_inverse=True)
        unit = ray_directions(t, at)
        x, strength = nearest_to_rays(at[:, 9:], unit, group, len(number))
        miss = ray_misses(at[:, :9].reshape(-1, 3, 3), at[:, 9:], x[group], t)
        worst = np.zeros(len(number))
        np.maximum.at(worst, group, np.nan_to_num(miss, nan=np.inf))
        usable = (strength > GROWTH.least_parallax) & (worst < 1.0)
        along = self._depths(pose, point)[v.photo[rows]] / (unit * at[:, 2:9:3]).sum(axis=1)
        ahead = at[first, 9:] + (along[:, None] * unit)[first]
        point[number] = np.where(usable[:, None], x, ahead)
        names = np.array(v.points, dtype=object)[number]
        return tuple(names.tolist())

    def _depths(self, pose: Array, point: Array) -> Array:
        """Return the median depth of the known points of each photo, (photos,)."""
        v = self.views
        rows = np.flatnonzero(np.isfinite(pose[v.photo, 0]) & np.isfinite(point[v.point, 0]))
        at = pose[v.photo[rows]]
        depth = ((point[v.point[rows]] - at[:, 9:]) * at[:, 2:9:3]).sum(axis=1)
        out = np.full(len(pose), float(np.median(depth)))
        for photo in np.unique(v.photo[rows]).tolist():
            out[photo] = float(np.median(depth[v.photo[rows] == photo]))
        return out

    def _unoriented(self, pose: Array, point: Array, known: KnownPlaces) -> dict[str, str]:
        """Return the photos with image points that have no pose, and why."""
        v = self.views
        known_ = np.isfinite(point[v.point, 0])
        every = np.bincount(v.photo, minlength=len(pose))
        count = np.bincount(v.photo[known_], minlength=len(pose))
        rays = np.bincount(v.point, minlength=len(point))
        alone = np.bincount(v.photo[rays[v.point] < 2], minlength=len(pose))
        given_ = [f.rotation is not None for f in self.equations.network.photos.values()]
        centred = np.all(np.isfinite(known.pose[:, 9:]), axis=1)
        return {
            name: reason_not_oriented(
                int(every[i]), int(count[i]), int(alone[i]), centred=bool(centred[i])
            )
            for i, name in enumerate(v.photos)
            if np.isnan(pose[i, 0]) and every[i] and not given_[i]
        }

    def _told(self, part: BlockPart, at: PartPlacement) -> OrientedPart:
        g = part.growth
        rows = np.flatnonzero(part.fits)
        names = np.array(self.views.photos, dtype=object)
        return OrientedPart(
            tuple(names[g.posed].tolist()),
            part.start,
            int(g.placed.sum()),
            int(part.fits.sum()),
            float(np.median(g.misses(rows))) / RAYLEIGH_MEDIAN,
            at.words,
            at.complete,
            float(np.median(off)) if len(off := at.misfits[np.isfinite(at.misfits)]) else np.nan,
        )

    def _state(
        self, equations: Equations, pose: Array, point: Array
    ) -> tuple[Start | None, tuple[str, ...]]:
        """Return a start with all other unknowns found from poses and points, or the reasons."""
        given_, moving = equations.unknowns.start(), equations.unknowns.moving()
        own: State = {**given_, "pose": pose, "point": point}
        own["calibration"] = self._calibrations(equations)
        state: State = {}
        for kind, values in given_.items():
            take = moving[kind] & np.isfinite(own[kind])
            state[kind] = np.where(take | np.isnan(values), own[kind], values)
        filled = _with_poses_and_points(self.equations.network, state)
        try:
            found = approximate(compile_network(filled), datum=self.datum)
        except ApproximationError as error:
            return None, tuple(str(p) for p in error.problems)
        found = {**found, "calibration": state["calibration"]}
        origin = {k: np.where(np.isnan(values), found[k], values) for k, values in given_.items()}
        return Start(equations.unknowns, found, origin), ()

    def _calibrations(self, equations: Equations) -> Array:
        """Return the calibrations that the largest part found."""
        table = equations.unknowns["calibration"]
        out = table.values.copy()
        best = max(self.parts, key=lambda p: p.n_photos)
        for camera, values in zip(self.views.cameras, best.growth.calibrations, strict=True):
            row = table.number.get(camera.name)
            if row is not None:
                out[row, : len(values)] = values
        return out


def _with_poses_and_points(network: Network, state: State) -> Network:
    """Return a network with given values where a state has some."""
    out = network.copy()
    for (name, point), at in zip(network.points.items(), state["point"].tolist(), strict=True):
        out.points[name] = replace(point, coordinates=tuple(at))
    for (name, photo), stored in zip(network.photos.items(), state["pose"], strict=True):
        if np.isfinite(stored).all():
            at = tuple(stored[9:].tolist())
            out.photos[name] = replace(photo, position=at, rotation=stored[:9].reshape(3, 3))
    return out


@taking(Network)
@with_one_thread
def orient(
    network: Network, *, principal_distances: Mapping[str, Sequence[float]] | None = None
) -> BlockStart:
    """Find poses of all photos and coordinates of all points from the image points of a network.

    No photo needs a pose and no point coordinates. Pairs of photos are oriented relatively from
    five points at a time; from the best pair the block grows by resection and intersection, with
    adjustments on the way. Mismatches are left out of the start by their misses: they stay in the
    network, and are listed. Control points, weighted points and photos, observed positions and
    attitudes, known lengths and the frame of what other observations determine give scale and
    datum.

    Args:
        network: the network; it is not changed. The calibration of its cameras is approximate, or
            held. A free principal distance may be a guess: where the block does not fit with it,
            others are tried.
        principal_distances: by camera, values to try in the place of the given one, image units,
            such as those of the description of a lens.

    Returns:
        The start, for ``adjust(network, start=found.start)``, and what was left out.

    Raises:
        InputError: there are no image points, PoseLib is not installed (extra ``images``), or a
            camera is unknown.
        ApproximationError: no two photos have enough common points that fit.
    """
    if not network.n_image_points:
        raise InputError("the network has no image points to orient photos from")
    return orient_equations(compile_network(network), principal_distances=principal_distances)


def orient_equations(
    equations: Equations,
    *,
    datum: DatumChoice | None = None,
    principal_distances: Mapping[str, Sequence[float]] | None = None,
) -> BlockStart:
    """Orient the photos of a network in arrays, see `orient`.

    Args:
        equations: the network in arrays.
        datum: given or free; none: the datum of the network.
        principal_distances: as for `orient`.
    """
    poselib_solvers()
    network = equations.network
    views = Views.of(network)
    problems = [
        Problem(unknown_name("camera", name, network.cameras))
        for name in (principal_distances or {})
        if name not in network.cameras
    ]
    problems += [
        Problem("principal distances must be numbers > 0", f"camera {name!r}")
        for name, values in (principal_distances or {}).items()
        if not len(values) or not all(np.isfinite(v) and v > 0 for v in values)
    ]
    if problems:
        raise InputError(problems)
    distances = PrincipalDistances(views, principal_distances or {}, given_places(equations).point)
    parts = build_parts(views, distances)
    if not parts:
        raise ApproximationError(
            [Problem(reason_no_pair(views, views.rays(distances.first())), "network")]
        )
    return Assembly(equations, views, parts, datum).start(distances)
