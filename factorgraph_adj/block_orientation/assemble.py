"""The parts of a block in one frame, values of everything else, and what was left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..approximate.rays import nearest_to_rays
from ..approximate.rounds import approximate, reach
from ..errors import ApproximationError
from ..graph.equations import Equations, compile_network
from ..graph.variables import State
from ..network.network import DatumChoice, Network
from ..solve.start import Start
from ..types import Array, Mask
from .beside import by_given, stand, why_not
from .block_start import BlockStart, OrientedPart
from .build import Part
from .diagnosis import doubts
from .focal import Distances
from .growth import RULES, Growth
from .known import Known, given, lengths
from .place import Placed, place
from .robust_poses import RAYLEIGH_MEDIAN, ray_misses
from .views import Views

NEAR_STATED = 10.0
"""Multiple of the limit of misses within which an image point agrees with stated coordinates."""
ALL_OF_IT = 3
"""Number of known coordinates that place a part without values found by other steps."""


@dataclass
class Assembly:
    """Parts of a block on their way into the frame of its network."""

    equations: Equations
    """The network in arrays."""
    views: Views
    """Its image points."""
    parts: list[Part]
    """The parts, in axes of their own."""
    datum: DatumChoice | None = None
    """Given or free; none: the datum of the network."""

    def start(self, distances: Distances) -> BlockStart:
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
        known = given(equations)
        whole = self._whole(pose, point)
        fits |= stand(whole, known)
        some = np.zeros(len(pose), dtype=bool)
        if any(at.complete for at in placed):
            some, agree = by_given(whole, known)
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
            doubts(v, self.parts, distances),
        )
        if state is None:
            return found
        begun = replace(
            state, words=found.sentences(), doubtful=found.doubtful, unreached=unreached
        )
        return replace(found, start=begun)

    def placed(self, equations: Equations) -> list[Placed]:
        """Return the place of each part, the best known one first; later ones may join it."""
        there = given(equations)
        measured = list(lengths(equations))
        places = np.isfinite(np.concatenate([there.point, there.pose[:, 9:]])).all(axis=1)
        if places.sum() < ALL_OF_IT and len(self.equations.network.observations):
            state, _ = reach(equations, datum=self.datum)
            there = there.filled(state)
        joined = np.zeros(len(there.point), dtype=bool)
        out: list[Placed | None] = [None] * len(self.parts)
        open_ = list(range(len(self.parts)))
        while open_:
            trials = {
                i: place(self.parts[i].growth, equations, there, measured, joined) for i in open_
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
            there = Known(moved, there.pose)
        return [p for p in out if p is not None]

    def _whole(self, pose: Array, point: Array) -> Growth:
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
        out[rows[miss <= NEAR_STATED * growth.limit]] = True
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
        r = at[:, :9]
        d = r[:, 0::3] * t[:, :1] - r[:, 1::3] * t[:, 1:] + r[:, 2::3]
        number, first, group = np.unique(v.point[rows], return_index=True, return_inverse=True)
        unit = d / np.linalg.norm(d, axis=1, keepdims=True)
        x, strength = nearest_to_rays(at[:, 9:], unit, group, len(number))
        miss = ray_misses(r.reshape(-1, 3, 3), at[:, 9:], x[group], t)
        worst = np.zeros(len(number))
        np.maximum.at(worst, group, np.nan_to_num(miss, nan=np.inf))
        usable = (strength > RULES.least_parallax) & (worst < 1.0)
        depth = self._depths(pose, point)
        ahead = at[first, 9:] + depth[v.photo[rows[first]], None] * d[first]
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

    def _unoriented(self, pose: Array, point: Array, known: Known) -> dict[str, str]:
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
            name: why_not(int(every[i]), int(count[i]), int(alone[i]), centred=bool(centred[i]))
            for i, name in enumerate(v.photos)
            if np.isnan(pose[i, 0]) and every[i] and not given_[i]
        }

    def _told(self, part: Part, at: Placed) -> OrientedPart:
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
