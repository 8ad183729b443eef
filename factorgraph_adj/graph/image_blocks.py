"""Image coordinates by lens model: blocks, chunks, partials, sums by point.

A chunk has the rays of several whole or partial photos. Each component of residuals and partials
is a contiguous array over the rays of the chunk, so that every operation runs through the cache of
one core, and rotations are one matrix product for each photo.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..errors import InputError, Problem
from ..models.base import DegenerateError
from ..models.image import by_rotation, components, in_front
from ..models.lens import Pair
from ..models.rolling_shutter import MOTION, VELOCITY, Turns
from ..network.network import Network
from ..types import Array, Index
from .blocks import Block
from .image_ids import ImageIds
from .variables import DEFAULT, State, Unknowns, calibration_name

POSE = 6
"""Number of components of the tangent of a pose."""
DIGIT = 16
"""Bits that are sorted at once: numpy sorts numbers of 16 bits by radix, longer ones by merging,
which takes five times as long."""
RAYS = 12_000
"""Largest number of rays of a chunk. An array over them has 96 kB: some twenty stay in the cache,
and the allocator reuses their memory (it maps new pages from 128 kB)."""


def image_blocks(network: Network, unknowns: Unknowns) -> Iterable[Block]:
    """Yield the image coordinates, photo by photo.

    There is one block for each lens model, for each readout of cameras whose photos move, and for
    cameras with correlated coordinates. Image points with a joint covariance are in further blocks.
    """
    photo, point, xy, sigma = network.images.columns()
    correlation = network.images.correlation
    if not len(photo):
        return
    _refuse_duplicates(network, photo, point)
    calibration = np.array(
        [unknowns["calibration"].number[calibration_name(network, f)] for f in network.photos],
        dtype=np.intp,
    )
    camera_of = [f.camera for f in network.photos.values()]
    stated = unknowns["photo_motion"].number
    motion = np.array([stated.get(f, stated[DEFAULT]) for f in network.photos], dtype=np.intp)
    # All photos of a camera are in the same block, because they share its calibration.
    readouts = network.readouts()
    correlated = {camera_of[f] for f in np.unique(photo[correlation != 0.0]).tolist()}
    forms = [(network.cameras[c].lens, readouts.get(c), c in correlated) for c in camera_of]
    distinct = {form: number for number, form in enumerate(dict.fromkeys(forms))}
    form_of_row = np.array([distinct[form] for form in forms])[photo]
    joint = network.images.is_joint
    chosen = [
        (form, np.flatnonzero((form_of_row == number) & together))
        for together in ((~joint, joint) if joint.any() else (True,))
        for form, number in distinct.items()
    ]
    for (lens, readout, is_correlated), rows in chosen:
        if not len(rows):
            continue
        # Rows of a photo are adjacent, because sums are formed for each photo.
        rows = rows[np.argsort(photo[rows], kind="stable")]
        ids = ImageIds(network, rows, photo[rows], point[rows])
        moving = (("photo_motion", motion[photo[rows]]),) if readout is not None else ()
        yield Block(
            "image",
            "image",
            (
                ("pose", photo[rows]),
                ("calibration", calibration[photo[rows]]),
                ("point", point[rows]),
                *moving,
            ),
            xy[rows],
            sigma[rows],
            ids,  # type: ignore[arg-type]
            ("x", "y"),
            ids.label,
            _whitener(sigma[rows], correlation[rows]) if is_correlated else None,
            lens=lens,
            readout=readout,
        )


def _whitener(sigma: Array, correlation: Array) -> Array:
    """Return W (n, 2, 2) with W Σ Wᵀ = I for σ (n, 2) and correlations (n,).

    W = [1/σ_x, 0; −ρ/(σ_x s), 1/(σ_y s)],   s² = 1 − ρ²
    """
    s = np.sqrt((1.0 - correlation) * (1.0 + correlation))
    w = np.zeros((len(sigma), 2, 2))
    w[:, 0, 0] = 1.0 / sigma[:, 0]
    w[:, 1, 0] = -correlation / (sigma[:, 0] * s)
    w[:, 1, 1] = 1.0 / (sigma[:, 1] * s)
    return w


def _refuse_duplicates(network: Network, photo: Index, point: Index) -> None:
    code = np.sort(photo * len(network.points) + point)
    twice = np.unique(code[1:][code[1:] == code[:-1]])
    if len(twice):
        photos, points = tuple(network.photos), tuple(network.points)
        raise InputError(
            [
                Problem(
                    "the point is measured more than once in this photo",
                    f"image point {photos[c // len(points)]}/{points[c % len(points)]}",
                )
                for c in twice
            ]
        )


def stable_order(numbers: Index, count: int) -> Index:
    """Return the order in which numbers from 0 to ``count`` − 1 ascend; equal ones keep theirs.

    Args:
        numbers: the numbers, (n,).
        count: a number that none of them reaches.
    """
    order: Index = np.argsort(numbers.astype(np.uint16), kind="stable")
    for shift in range(DIGIT, max(count - 1, 0).bit_length(), DIGIT):
        digits = (numbers >> shift).astype(np.uint16)  # the higher bits are cut off
        order = order[np.argsort(digits[order], kind="stable")]
    return order


@dataclass(frozen=True)
class Chunk:
    """Some consecutive rays of a block."""

    rows: slice
    """Numbers of the rays in the block."""
    parts: tuple[tuple[int, int, int], ...]
    """Number of the photo, first ray and end of each run of rays of one photo, in the chunk."""
    calibration: int
    """Number of the calibration of all rays; −1: each photo has its own."""


@dataclass(frozen=True)
class RayPartials:
    """Whitened residuals and partials of the rays of a chunk."""

    chunk: Chunk
    """The rays."""
    rows: Array
    """[A v], (own + k + 1, 2, m)."""

    @property
    def a(self) -> Array:
        """Partials by what is the photo's own and by the lens's free parameters, (own + k, 2, m).

        The photo's own are the pose's tangent [ω, δX₀] and, with a rolling shutter, its motion.

        Partials by the object point are those by X₀ with the opposite sign. Held components have
        partials too.
        """
        return self.rows[:-1]

    @property
    def v(self) -> Array:
        """Residuals, (2, m)."""
        v: Array = self.rows[-1]
        return v


@dataclass(frozen=True)
class PointSums:
    """Sums over the rays to the same point."""

    points: Index
    """Numbers of the points, in ascending order, (u,)."""
    incidence: csr_array
    """One for each ray in the row of its point, (u, m)."""

    @classmethod
    def of(cls, number: Index, count: int, ones: Array) -> PointSums:
        """Sort rays by their points.

        Args:
            number: number of the point of each ray, (m,).
            count: number of points.
            ones: m ones or more.
        """
        order = stable_order(number, count).astype(np.int32)
        ordered = number[order]
        starts: Index = np.flatnonzero(np.diff(ordered, prepend=-1))
        first = np.append(starts, len(number)).astype(np.int32)
        points = ordered[first[:-1]]
        shape = (len(points), len(number))
        return cls(points, csr_array((ones[: len(number)], order, first), shape=shape))

    def add(self, out: Array, values: Array) -> None:
        """Add values (m, k) of the rays to those of their points, out (n, k)."""
        out[self.points] += self.incidence @ values


@dataclass(frozen=True)
class ImageChunks:
    """The rays of one block in chunks; a network makes them once."""

    block: Block
    """The image coordinates, photo by photo."""
    unknowns: Unknowns = field(repr=False)
    """The unknowns of the network."""

    @cached_property
    def lens_free(self) -> Index:
        """Parameters of the lens that are free in any calibration of the block, (k,)."""
        table = self.unknowns["calibration"]
        used = np.unique(self.block.variables[1][1])
        free = table.free[used[table.offset[used] >= 0]]
        return np.flatnonzero(free.any(axis=0)) if len(free) else np.zeros(0, dtype=np.intp)

    @property
    def own(self) -> int:
        """Number of components of the photo's own: of its pose, and of its motion if it has one."""
        return POSE + (0 if self.block.readout is None else self.block.readout.components)

    @cached_property
    def alone(self) -> Index:
        """Numbers of the calibrations that only one photo uses."""
        photo, calibration = self.block.variables[0][1], self.block.variables[1][1]
        numbers, first = np.unique(photo, return_index=True)
        users = np.bincount(calibration[first]) if len(numbers) else np.zeros(0, dtype=np.intp)
        return np.flatnonzero(users == 1)

    @cached_property
    def chunks(self) -> tuple[Chunk, ...]:
        """The chunks, in the order of the rays."""
        photo, calibration = self.block.variables[0][1], self.block.variables[1][1]
        camera = np.where(np.isin(calibration, self.alone), -1, calibration)
        n = len(photo)
        change: Index = np.flatnonzero(photo[1:] != photo[:-1]) + 1
        starts = np.concatenate([[0], change]).astype(np.intp)
        stops = np.append(change, n)
        out: list[Chunk] = []
        parts: list[tuple[int, int, int]] = []
        first = 0

        def finish(end: int) -> None:
            nonlocal parts, first
            if parts:
                out.append(Chunk(slice(first, end), tuple(parts), int(camera[first])))
            parts, first = [], end

        for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
            if camera[start] != camera[first] or stop - first > RAYS:
                finish(start)
            while stop - start > RAYS:  # a photo with very many rays
                parts.append((int(photo[start]), 0, RAYS))
                finish(start + RAYS)
                start = first
            parts.append((int(photo[start]), start - first, stop - first))
        finish(n)
        return tuple(out)

    @cached_property
    def sums(self) -> tuple[PointSums, ...]:
        """Sums over the rays of each chunk to each of its points."""
        number = self.block.variables[2][1]
        ones = np.ones(min(RAYS, max(len(number), 1)))
        count = len(self.unknowns["point"].names)
        return tuple(PointSums.of(number[c.rows], count, ones) for c in self.chunks)

    @cached_property
    def _observed(self) -> Array:
        return np.ascontiguousarray(self.block.observed.T)

    @cached_property
    def _weights(self) -> Array:
        """Whiteners: (1, 1) or (2, n) reciprocal σ, or (4, n) elements of W."""
        block = self.block
        if block.whitener is not None:
            return np.ascontiguousarray(block.whitener.reshape(-1, 4).T)
        if block.equal_sigma:
            return 1.0 / block.sigma[:1, :1]
        return np.ascontiguousarray(1.0 / block.sigma.T)

    def depths(self, state: State) -> Array:
        """Return how far the point of each ray is on the side that its photo sees, (n,) metres.

        See `in_front`.
        """
        lens = self.block.lens
        if lens is not None and lens.takes != "tangents":
            (_, photos), _, (_, seen), *_ = self.block.variables
            return in_front(state["pose"][photos], state["point"][seen], lens)
        number = self.block.variables[2][1]
        points, poses = state["point"], state["pose"]
        out = np.empty(self.block.n)
        for chunk in self.chunks:
            d = np.take(points, number[chunk.rows], axis=0)
            for photo, start, stop in chunk.parts:
                axis = poses[photo, 2:9:3]
                depth = d[start:stop] @ axis
                depth -= axis @ poses[photo, 9:]
                out[chunk.rows.start + start : chunk.rows.start + stop] = depth
        return out

    def residuals(self, state: State, *, whitened: bool = True) -> Array:
        """Return v (n, 2).

        Raises:
            InputError: rays in the focal plane of their photo; the message names all of them.
        """
        out = np.empty((self.block.n, 2))
        for rays in self._every(state, jacobians=False, whitened=whitened):
            out[rays.chunk.rows] = rays.v.T
        return out

    def linearise(self, state: State) -> list[RayPartials]:
        """Return whitened residuals and partials of every chunk.

        Raises:
            InputError: as `residuals`.
        """
        return list(self._every(state, jacobians=True, whitened=True))

    def _every(self, state: State, *, jacobians: bool, whitened: bool) -> Iterator[RayPartials]:
        points = np.ascontiguousarray(state["point"].T)
        problems: list[Problem] = []
        for chunk in self.chunks:
            try:
                found = self._evaluate(chunk, state, points, jacobians, whitened)
            except DegenerateError as error:
                rows = error.rows + chunk.rows.start
                problems += [Problem(error.why, self.block.labels(int(i))) for i in rows]
                continue
            if not problems:
                yield RayPartials(chunk, found)
        if problems:
            raise InputError(problems)

    def _evaluate(
        self, chunk: Chunk, state: State, points: Array, jacobians: bool, whitened: bool
    ) -> Array:
        """Return [A v] (own + k + 1, 2, m) of a chunk; without partials v alone (1, 2, m)."""
        block, rows = self.block, chunk.rows
        assert block.lens is not None
        number = block.variables[2][1][rows]
        m = len(number)
        d = np.take(points, number, axis=1)
        x, y = self._observed[:, rows]
        turns = self._move(chunk, state, d, x, y)
        q = np.empty((3, m))
        rotations = []
        for photo, start, stop in chunk.parts:
            stored = state["pose"][photo]
            turn = stored[:9].reshape(3, 3)
            rotations.append(turn)
            part = d[:, start:stop]
            part -= stored[9:, None]
            np.matmul(turn.T, part, out=q[:, start:stop])
        seen = ray = components(q)
        if turns is not None:
            seen = components(turns.to_camera(q))
        k = len(block.lens.names)
        if chunk.calibration >= 0:
            calibration = state["calibration"][chunk.calibration, None, :k]
        else:
            own = state["calibration"][block.variables[1][1][rows], :k]
            calibration = np.asfortranarray(own)  # one contiguous array for each parameter
        found = block.lens.seen(seen, x, y, calibration, jacobians=jacobians)
        free, lens_from = self.lens_free, self.own
        a = np.empty((lens_from + len(free) + 1 if jacobians else 1, 2, m))
        weigh = self._whiten if whitened else _copy
        weigh(found.v, rows, a[-1])
        if not jacobians:
            return a
        g = np.empty((3, 2, m))
        for pair, out in zip(found.by_p, g, strict=True):
            weigh(pair, rows, out)
        for parameter, out in zip(free.tolist(), a[lens_from:-1], strict=True):
            weigh(found.by_k[parameter], rows, out)
        if turns is not None:
            at_row = [np.stack(by_rotation(seen, components(g[:, row]))) for row in range(2)]
            by_vector = turns.by_vector(np.stack(at_row, axis=1))
            g = turns.to_middle(g)
        for row in range(2):
            turned = by_rotation(ray, (g[0, row], g[1, row], g[2, row]))
            a[0, row], a[1, row], a[2, row] = turned
        for turn, (_, start, stop) in zip(rotations, chunk.parts, strict=True):
            for row in range(2):
                np.matmul(-turn, g[:, row, start:stop], out=a[3:6, row, start:stop])
        if turns is not None:
            for j, power in enumerate(turns.powers):
                first = POSE + MOTION * j
                np.multiply(a[3:6], power, out=a[first : first + VELOCITY])
                np.multiply(by_vector, power, out=a[first + VELOCITY : first + MOTION])
        return a

    def _move(self, chunk: Chunk, state: State, d: Array, x: Array, y: Array) -> Turns | None:
        """Move points d (3, m) back by the shifts of their photos; return the turns of these.

        Args:
            chunk: the rays.
            state: values of the unknowns.
            d: object points, changed in place.
            x: measured coordinates x, (m,).
            y: measured coordinates y, (m,).

        Returns:
            The turns since the middle row; None: the photos have no motion.
        """
        readout = self.block.readout
        if readout is None:
            return None
        motion = state["photo_motion"][self.block.variables[3][1][chunk.rows]]
        turns, shift = Turns.of(motion[:, : readout.components], readout.times(x, y))
        d -= shift.T
        return turns

    def _whiten(self, pair: Pair, rows: slice, out: Array) -> None:
        """Write values of both components times the whitener to out (2, m)."""
        w, (x, y) = self._weights, pair
        w = w if w.shape[1] == 1 else w[:, rows]
        if len(w) <= 2:
            np.multiply(x, w[0], out=out[0])
            np.multiply(y, w[-1], out=out[1])
        else:
            out[0] = w[0] * x + w[1] * y
            out[1] = w[2] * x + w[3] * y


def _copy(pair: Pair, rows: slice, out: Array) -> None:
    """Write values of both components to out (2, m), as `ImageChunks._whiten` without weights."""
    out[0], out[1] = pair
