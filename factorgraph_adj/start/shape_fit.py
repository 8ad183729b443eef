"""Frames and sizes of shapes, such as planes, cylinders and cones, from points on them.

Several directions of the axis are tried: those of the extents of the points, and directions all
over a sphere. In each, circles, spheres and cones are fitted linearly; the best few are improved by
damped Gauss–Newton steps, with the partials of the shape itself, and the best one is taken.
Components and sizes that are held or given are kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np

from ..errors import Problem
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.base import DegenerateError
from ..models.shapes import SHAPES, Shape
from ..models.sub_frame import horizons
from ..models.unknown_registry import UNKNOWNS
from ..observations import observation_kind
from ..rotation import exp_rotation, skew
from ..types import Array, Index
from .damped_fit import damped_fit, open_columns

TRIAL_AXES = 80
"""Number of axes that are tried all over a sphere, some 23° from each other."""
MAX_IMPROVED_TRIALS, MAX_FIRST_STEPS = 40, 10
"""Number of trials that are improved by a few steps, and the number of these steps."""
_MIN_VERTICAL_COMPONENT = 1e-6
"""Smallest vertical component of an axis that distinguishes its two senses."""
MAX_FINAL_TRIALS, MAX_FINAL_STEPS = 5, 80
"""Number of trials that are improved further, and the largest number of steps of each."""
MAX_TRIAL_POINTS = 300
"""Largest number of points with which axes are tried."""
MAX_SINGULAR_RATIO_OF_OPEN_SHAPE = 1e-6
"""Ratio of the smallest to the largest singular value of the partials at which points leave a
combination of components open."""


class ShapeObservations(NamedTuple):
    """Observations of one kind that belong to one frame."""

    shape: Shape
    point: Index
    """Numbers of the points, (n,)."""
    observed: Array
    """Distances from the shape, (n, d)."""
    sizes: tuple[tuple[str, Index], ...]
    """Kind and numbers (n,) of each size."""


def place_shapes(equations: Equations, state: State) -> list[Problem]:
    """Fill the missing frames and sizes of shapes; return a problem for each that is not found.

    Args:
        equations: the network.
        state: its values; frames and sizes of shapes are filled from the points in it.
    """
    table = equations.unknowns["frame"]
    every: dict[int, list[ShapeObservations]] = {}
    for f, part in shape_observations(equations):
        every.setdefault(f, []).append(part)
    problems = []
    for f, parts in every.items():
        keys = dict.fromkeys((k, int(i)) for p in parts for k, n in p.sizes for i in np.unique(n))
        lost = [(k, i) for k, i in keys if np.isnan(state[k][i]).any()]
        if not np.isnan(state["frame"][f]).any() and not lost:
            continue
        x = state["point"]
        points = sorted({i for p in parts for i in p.point.tolist() if np.isfinite(x[i]).all()})
        if not points:
            what = "no approximate value: no point on it has coordinates"
        else:
            stated = equations.network.frames[table.names[f]]
            with np.errstate(all="ignore"):  # trials may be anything
                what = ShapeFit(equations, state, f, parts, lost, np.array(stated.values)).run()
        if what:
            problems.append(Problem(what, f"shape {table.names[f]!r}"))
    return problems


def frames_of_shapes(equations: Equations) -> set[int]:
    """Return the numbers of the frames of shapes."""
    return {f for f, _ in shape_observations(equations)}


def shape_observations(equations: Equations) -> Iterator[tuple[int, ShapeObservations]]:
    """Yield the observations on each shape, by the number of its frame."""
    for block in equations.blocks:
        if block.prior or block.image:
            continue
        model = observation_kind(block.kind).model
        if not isinstance(model, Shape):
            continue
        frame, point = block.variables[0][1], block.variables[1][1]
        sizes = block.arguments[len(block.arguments) - len(model.sizes) :]
        for f in np.unique(frame).tolist():
            rows = np.flatnonzero(frame == f)
            own = tuple((k, n[rows]) for k, n in sizes)
            yield f, ShapeObservations(model, point[rows], block.observed[rows], own)


class ShapeFit:
    """A shape that is fitted to points which are known."""

    def __init__(
        self,
        equations: Equations,
        state: State,
        f: int,
        parts: list[ShapeObservations],
        lost: list[tuple[str, int]],
        given: Array,
    ) -> None:
        """Prepare the fit of frame ``f`` with the given components (7,), NaN: to be found."""
        self.state, self.f, self.lost = state, f, lost
        self.names = equations.unknowns["frame"].names
        stored = state["frame"][f]
        origin = equations.network.frames[self.names[f]].origin
        number = equations.unknowns["point"].number
        at = state["point"][number[origin]] if origin else stored[13:16]
        basis = equations.network.frame.basis(at[None], np.zeros((1, 2)))
        self.horizon = horizons(basis, stored[16:])[0]
        if not np.isnan(stored).any():
            given = UNKNOWNS["frame"].given(stored[None])[0]
        self.open = np.flatnonzero(np.isnan(given[:6]))
        self.given, self.ln_scale = given, float(np.nan_to_num(given[6]))
        known_ones = [np.isfinite(state["point"][p.point]).all(axis=1) for p in parts]
        self.parts = [
            ShapeObservations(
                p.shape,
                p.point[k],
                p.observed[k],
                tuple((kind, n[k]) for kind, n in p.sizes),
            )
            for p, k in zip(parts, known_ones, strict=True)
            if k.any()
        ]
        self.at = at
        self.y = [
            np.exp(-self.ln_scale) * (state["point"][p.point] - at) @ self.horizon.T
            for p in self.parts
        ]
        self.columns = [*(("frame", int(c)) for c in self.open), *lost]

    def run(self) -> str:
        """Fill the frame and its sizes; return what is wrong, empty if nothing is."""
        n = len({i for p in self.parts for i in p.point.tolist()})
        rows = sum(p.observed.size for p in self.parts)
        names = [self._name(c) for c in self.columns]
        if not np.isfinite(self.at).all():
            return "no approximate value: the point at its origin is not known"
        if rows < len(names):
            return (
                f"{n} of its points {'is' if n == 1 else 'are'} known, which is {rows} "
                f"condition{'s' * (rows > 1)} for {len(names)} unknowns ({', '.join(names)}): it "
                "needs more points, or values of some of them"
            )
        trials = [t for r in self._rotations() for t in self._trials(r)]
        trials.sort(key=lambda t: t.cost)
        better = sorted(
            (self._improved(t, MAX_FIRST_STEPS) for t in trials[:MAX_IMPROVED_TRIALS]),
            key=lambda t: t.cost,
        )
        ends = [self._improved(t, MAX_FINAL_STEPS) for t in better[:MAX_FINAL_TRIALS]]
        # Representations of the same shape differ by rounding; the one with positive sizes counts.
        ends = [e for e in ends if np.isfinite(e.cost)]
        if not ends:
            return "no approximate value: no shape near its points was found; give its values"
        least = min(e.cost for e in ends)
        extent = max(float(np.abs(y - y.mean(axis=0)).max()) for y in self.y) or 1.0
        near = [e for e in ends if e.cost <= 1.001 * least + (1e-9 * extent) ** 2 * rows]
        best = max(
            near,
            key=lambda e: (
                sum(v > 0 for v in e.sizes.values()),
                e.rotation[2, 2]
                > -_MIN_VERTICAL_COMPONENT,  # of an axis and its opposite the one that points up
                -e.cost,
            ),
        )
        loose = self._loose(best, extent)
        if loose:
            return (
                f"its {n} known points leave {' and '.join(loose)} open: they lie so that it may "
                "be turned or shifted without leaving them; observe others, or hold a component"
            )
        self._take(best)
        return ""

    def _name(self, column: tuple[str, int]) -> str:
        kind, number = column
        if kind == "frame":
            return UNKNOWNS["frame"].components[number].name
        return UNKNOWNS[kind].noun

    # -- trials -----------------------------------------------------------------------------------

    def _rotations(self) -> Iterator[Array]:
        """Yield the rotations R that are tried."""
        given = exp_rotation(np.nan_to_num(self.given[None, :3]))[0]
        tilts = [c for c in (0, 1) if c in self.open]
        yield given
        if len(tilts) == 1:
            for angle in np.linspace(0.0, 2.0 * np.pi, 37)[1:-1]:
                turn = np.zeros((1, 3))
                turn[0, tilts[0]] = angle
                yield np.asarray(given @ exp_rotation(turn)[0])
        if len(tilts) < 2:
            return
        y = np.concatenate(self.y)
        _, _, vt = np.linalg.svd(y - y.mean(axis=0), full_matrices=True)
        which = {"least": vt[2:], "most": vt[:1], "any": vt}[self.parts[0].shape.axis]
        axes = [s * a for a in which for s in (1.0, -1.0)]
        if self.parts[0].shape.axis == "any":
            i = np.arange(TRIAL_AXES) + 0.5
            z, turn = 1.0 - 2.0 * i / TRIAL_AXES, np.pi * (1.0 + 5.0**0.5) * i
            r = np.sqrt(1.0 - z**2)
            axes += list(np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1))
        # An axis near that of the object keeps its sense: shapes are shown upwards.
        for axis in sorted(axes, key=lambda a: -a[2]):
            yield rotation_onto_axis(axis)

    def _trials(self, rotation: Array) -> Iterator[_Trial]:
        """Yield the shapes with this rotation that fit linearly."""
        first = self.parts[0]
        chosen = slice(None)
        if first.sizes:  # points with the same sizes
            key = np.stack([n for _, n in first.sizes], axis=1)
            each, which = np.unique(key, axis=0, return_inverse=True)
            largest = int(np.bincount(which.ravel(), minlength=len(each)).argmax())
            chosen = np.flatnonzero(which.ravel() == largest)[:MAX_TRIAL_POINTS]  # type: ignore[assignment]
        y = self.y[0][chosen] @ rotation
        centres = [SHAPE_OFFSETS[first.shape.name](y)]
        if first.shape.name in FURTHER_SHAPE_OFFSETS:
            centres += FURTHER_SHAPE_OFFSETS[first.shape.name](y)
        for centre in centres:
            trial = self._at(rotation, centre)
            if trial is not None:
                yield trial

    def _at(self, rotation: Array, centre: Array) -> _Trial | None:
        """Return the shape with a rotation and a centre, with the sizes that follow."""
        offset = self.given[3:6].copy()
        missing = np.isnan(offset)
        offset[missing] = centre[missing]
        sizes: dict[tuple[str, int], float] = {}
        for part, y in zip(self.parts, self.y, strict=True):
            q = y @ rotation - offset
            for number, (kind, index) in enumerate(part.sizes):
                for i in np.unique(index).tolist():
                    if (kind, i) in self.lost and (kind, i) not in sizes:
                        own = SHAPE_SIZES[part.shape.name](q[index == i])
                        sizes[kind, i] = float(own[number])
        trial = _Trial(rotation, offset, sizes, np.inf)
        values = np.array([*offset, *sizes.values()])
        return self._costed(trial) if np.isfinite(values).all() else None

    def _costed(self, trial: _Trial) -> _Trial:
        v, _ = self._residuals(trial)
        return trial._replace(cost=float(v @ v))

    def _residuals(self, t: _Trial) -> tuple[Array, Array]:
        """Return the distances (m,) of all points from a trial, and their partials (m, columns)."""
        residuals, partials = [], []
        try:
            for part, y in zip(self.parts, self.y, strict=True):
                q = y @ t.rotation - t.offset
                sizes = [
                    np.array([self._size(t, kind, i) for i in index.tolist()])
                    for kind, index in part.sizes
                ]
                found = part.shape.distances(q, *sizes)
                v = found.f - part.observed
                by = np.zeros((*v.shape, len(self.columns)))
                by_frame = np.concatenate(
                    [skew(q + t.offset), np.tile(-np.eye(3), (len(q), 1, 1))], 2
                )
                by_frame = found.by_q @ by_frame
                for j, (kind, number) in enumerate(self.columns):
                    if kind == "frame":
                        by[:, :, j] = by_frame[:, :, number]
                        continue
                    for (what, index), s in zip(part.sizes, found.by_sizes, strict=True):
                        if what == kind:
                            by[:, :, j] += s * (index == number)[:, None]
                residuals.append(v.ravel())
                partials.append(by.reshape(v.size, -1))
        except DegenerateError:
            m = sum(p.observed.size for p in self.parts)
            return np.full(m, np.inf), np.zeros((m, len(self.columns)))
        return np.concatenate(residuals), np.concatenate(partials)

    def _size(self, t: _Trial, kind: str, number: int) -> float:
        own = t.sizes.get((kind, number))
        return float(self.state[kind][number, 0]) if own is None else own

    def _improved(self, t: _Trial, steps: int) -> _Trial:
        """Return a trial after damped Gauss–Newton steps."""
        end = damped_fit(t, self._residuals, self._moved, steps)
        return end.values._replace(cost=end.cost)

    def _moved(self, t: _Trial, step: Array) -> _Trial:
        turn, offset, sizes = np.zeros(3), t.offset.copy(), dict(t.sizes)
        for (kind, number), by in zip(self.columns, step.tolist(), strict=True):
            if kind != "frame":
                sizes[kind, number] += by
            elif number < 3:
                turn[number] = by
            else:
                offset[number - 3] += by
        length = float(np.linalg.norm(turn))
        turn = turn if length < 1.0 else turn / length
        return _Trial(t.rotation @ exp_rotation(turn[None])[0], offset, sizes, np.inf)

    def _loose(self, t: _Trial, extent: float) -> list[str]:
        """Return the names of the unknowns that the points leave open."""
        _, a = self._residuals(t)
        turning = np.array([(k == "frame" and n < 3) or k == "angle" for k, n in self.columns])
        a = a / np.where(turning, extent, 1.0)
        return [
            self._name(c)
            for c, o in zip(
                self.columns, open_columns(a, MAX_SINGULAR_RATIO_OF_OPEN_SHAPE), strict=True
            )
            if o
        ]

    def _take(self, t: _Trial) -> None:
        stored = self.state["frame"][self.f]
        if len(self.open):
            stored[:9], stored[9:12], stored[12] = t.rotation.ravel(), t.offset, self.ln_scale
        for (kind, number), value in t.sizes.items():
            self.state[kind][number, 0] = value


class _Trial(NamedTuple):
    """A shape that is tried."""

    rotation: Array
    offset: Array
    sizes: dict[tuple[str, int], float]
    cost: float
    """Sum of the squares of the distances, square metres."""


def rotation_onto_axis(axis: Array) -> Array:
    """Return the rotation R (3, 3) with R e_z = axis that turns e_z the shortest way."""
    w = np.array([-axis[1], axis[0], 0.0])
    sine = float(np.hypot(w[0], w[1]))
    angle = np.arctan2(sine, axis[2])
    w = w * (angle / sine) if sine > 0 else np.array([angle, 0.0, 0.0])
    return np.asarray(exp_rotation(w[None])[0])


# -- shapes whose axis is known -------------------------------------------------------------------

OffsetFit: TypeAlias = Callable[[Array], Array]
"""Points (n, 3) in axes of a shape → the offset c (3,) of the shape."""


def _solved(a: Array, b: Array) -> Array:
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0])


def _circle(y: Array) -> Array:
    """Return the centre of the circle in plan (Kåsa), and the mean height."""
    m = y.mean(axis=0)
    p = y - m
    a = np.column_stack([2.0 * p[:, :2], np.ones(len(p))])
    found = _solved(a, np.sum(p[:, :2] ** 2, axis=1))
    return np.asarray(m + np.array([found[0], found[1], 0.0]))


def _sphere(y: Array) -> Array:
    m = y.mean(axis=0)
    p = y - m
    a = np.column_stack([2.0 * p, np.ones(len(p))])
    return np.asarray(m + _solved(a, np.sum(p**2, axis=1))[:3])


def _cone(y: Array) -> Array:
    """Return the apex: x² + y² = 2ax + 2by + k z² − 2 k z₀ z + const."""
    m = y.mean(axis=0)
    p = y - m
    a = np.column_stack([2.0 * p[:, :2], p[:, 2] ** 2, p[:, 2], np.ones(len(p))])
    found = _solved(a, np.sum(p[:, :2] ** 2, axis=1))
    if not found[2] > 0:
        return np.full(3, np.nan)
    return np.asarray(m + np.array([found[0], found[1], -0.5 * found[3] / found[2]]))


def _paraboloid(y: Array) -> Array:
    """Return the apex: z = k (x² + y²) + b x + d y + const."""
    m = y.mean(axis=0)
    p = y - m
    a = np.column_stack([np.sum(p[:, :2] ** 2, axis=1), p[:, :2], np.ones(len(p))])
    k, b, d, constant = _solved(a, p[:, 2])
    apex = np.array([-0.5 * b / k, -0.5 * d / k])
    return np.asarray(m + np.array([*apex, constant - k * float(apex @ apex)]))


SHAPE_OFFSETS: dict[str, OffsetFit] = {
    "plane": lambda y: y.mean(axis=0),
    "line": lambda y: y.mean(axis=0),
    "circle": _circle,
    "cylinder": _circle,
    "sphere": _sphere,
    "cone": _cone,
    "torus": _circle,
    "paraboloid": _paraboloid,
}
"""Offsets of shapes by name."""


def _offsets_at_side(y: Array) -> list[Array]:
    """Return centres beside the points: the ring of a bend has its centre away from them."""
    middle = y.mean(axis=0)
    extent = float(np.sqrt(np.mean(np.sum((y - middle) ** 2, axis=1))))
    return [
        middle + s * extent * np.array([np.cos(a), np.sin(a), 0.0])
        for s in (1.0, 2.0, 4.0)
        for a in np.arange(8) * np.pi / 4
    ]


def _offsets_below(y: Array) -> list[Array]:
    """Return apexes below the points, on the axis of a circle and in their middle."""
    middle = y.mean(axis=0)
    extent = float(np.sqrt(np.mean(np.sum((y - middle) ** 2, axis=1))))
    down = [s * extent * np.array([0.0, 0.0, 1.0]) for s in (1.0, 2.0, 4.0)]
    return [at - d for at in (middle, _circle(y)) for d in down]


FURTHER_SHAPE_OFFSETS: dict[str, Callable[[Array], list[Array]]] = {
    "torus": _offsets_at_side,
    "cone": _offsets_below,
}
"""Further offsets that are tried, by the name of the shape."""


def _rho(q: Array) -> Array:
    return np.hypot(q[:, 0], q[:, 1])


def _tube(q: Array) -> tuple[float, float]:
    ring = float(_rho(q).mean())
    return float(np.sqrt(np.mean((_rho(q) - ring) ** 2 + q[:, 2] ** 2))), ring


SHAPE_SIZES: dict[str, Callable[[Array], tuple[float, ...]]] = {
    "plane": lambda q: (),
    "line": lambda q: (),
    "circle": lambda q: (float(_rho(q).mean()), float(q[:, 2].mean())),
    "cylinder": lambda q: (float(_rho(q).mean()),),
    "sphere": lambda q: (float(np.linalg.norm(q, axis=1).mean()),),
    "cone": lambda q: (float(np.arctan(_rho(q) @ q[:, 2] / (q[:, 2] @ q[:, 2]))),),
    "torus": _tube,
    "paraboloid": lambda q: (float(0.25 * (_rho(q) ** 4).sum() / (q[:, 2] @ _rho(q) ** 2)),),
}
"""Sizes of shapes by name, from places q (n, 3) in their frames."""
assert SHAPE_OFFSETS.keys() == SHAPE_SIZES.keys() == SHAPES.keys()
