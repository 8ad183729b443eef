"""Frames of planes, plumb lines and wires from readings, and of lines in images.

The missing components of a frame of alignment, and the missing sizes that its observations share
with no other frame, are fitted to all its observations whose other unknowns are known: damped
Gauss–Newton steps, with the partials of the observations themselves, from several bearings and
places. The best fit is taken. Components that are held or given are kept.

The measured points of a line in a photo span a plane with the projection centre; the line has the
direction across the normals of all such planes, and the place nearest to all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ..errors import InputError, Problem, known
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.inverse_lens import directions
from ..models.lens import Lens
from ..models.sub_frame import horizons, in_frame
from ..models.unknown_registry import ROTATION, UNKNOWNS
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.kind_records import METROLOGY_KINDS
from ..observations.relations import ImageLine
from ..types import Array, Index
from .damped_fit import DampedFit, damped_fit, open_columns
from .shape_fit import rotation_onto_axis

TRIAL_BEARINGS = 8
"""Number of bearings from which a frame of unknown bearing is fitted."""
MAX_ALIGNMENT_STEPS = 60
"""Largest number of steps of a fit."""
MAX_OPEN_SINGULAR_RATIO = 3e-5
"""Ratio of the smallest to the largest singular value of the scaled partials at which observations
leave a combination of components open."""
MAX_COST_DIFFERENCE_OF_EQUAL_FITS = 1.0
"""Difference of vᵀPv within which two fits are equally good."""
MIN_DISTANCE_OF_OTHER_PLACE_M = 1e-3
"""Distance, metres, from which on two fits are different places."""

_ALIGNMENT_KINDS = frozenset(r.name for r in METROLOGY_KINDS if r.frames)
MIN_SINE_BETWEEN_PLANES = 1e-4
"""Sine of the angle between planes up to which they leave the line open."""


def alignment_observations(equations: Equations) -> dict[int, list[Block]]:
    """Return the observations of every frame that only readings of alignment refer to."""
    found: dict[int, list[Block]] = {}
    others: set[int] = set()
    for block in equations.blocks:
        numbers = [index for kind, index in block.variables if kind == "frame"]
        if block.prior or not numbers:
            continue
        if block.kind not in _ALIGNMENT_KINDS:
            others.update(np.unique(np.concatenate(numbers)).tolist())
            continue
        for f in np.unique(numbers[0]).tolist():
            found.setdefault(f, []).append(block.select(np.flatnonzero(numbers[0] == f)))
        for carrying in numbers[1:]:  # wires do not place the bodies that carry their sensors
            others.update(np.unique(carrying).tolist())
    return {f: blocks for f, blocks in found.items() if f not in others}


def place_alignments(equations: Equations, state: State) -> list[Problem]:
    """Fill missing frames of planes, plumb lines and wires; return a problem for each not found.

    Args:
        equations: the network.
        state: its values; frames, and sizes that belong to one frame, are filled.
    """
    problems = []
    table = equations.unknowns["frame"]
    for f, blocks in alignment_observations(equations).items():
        if not np.isnan(state["frame"][f]).any():
            continue
        why = _AlignmentFit(equations, state, f, blocks).run()
        if why:
            problems.append(Problem(why, f"frame {table.names[f]!r}"))
    return problems


class _AlignmentFit:
    """The fit of one frame."""

    def __init__(self, equations: Equations, state: State, f: int, blocks: list[Block]) -> None:
        self._equations = equations
        self._state = state
        self._frame = f
        record = UNKNOWNS["frame"]
        stated = equations.network.frames[equations.unknowns["frame"].names[f]]
        given = np.array(stated.values, dtype=float)
        self._given = given
        self._missing = np.flatnonzero(np.isnan(given))
        self._runs = {0, 2} <= set(self._missing.tolist())
        self._blocks, sizes = [], set()
        for block in blocks:
            ready = np.ones(block.n, dtype=bool)
            for kind, index in block.variables:
                lacking = np.isnan(state[kind][index]).any(axis=1)
                if kind == "size":
                    sizes |= set(index[lacking].tolist())
                elif kind == "frame":
                    ready &= ~lacking | (index == f)
                else:
                    ready &= ~lacking
            if ready.any():
                self._blocks.append(block.select(np.flatnonzero(ready)))
        self._n = sum(b.observed.size for b in self._blocks)
        self._sizes = sorted(sizes)
        names = equations.unknowns["size"].names
        self._open = [record.names()[i] for i in self._missing]
        self._open += [f"size {names[i]!r}" for i in self._sizes]

    def run(self) -> str:
        """Fill the frame and its sizes; return why not, empty if they are filled."""
        if self._n < len(self._open):
            return (
                f"no approximate value: {self._n} readings at known points cannot give its "
                f"{len(self._open)} unknowns ({', '.join(self._open)}); give values, or hold some"
            )
        fits = (
            damped_fit(start, self._system, self._moved, MAX_ALIGNMENT_STEPS)
            for start in self._starts()
        )
        ends = [m for m in fits if np.isfinite(m.cost)]
        if not ends:
            return "no approximate value: its readings contradict each other; give values"
        if self._runs:  # a sagging wire is as well one that runs the other way
            ahead = [m for m in ends if self._places(m.values)[:, 1].mean() > 0]
            ends = ahead or ends
        ends.sort(key=lambda m: m.cost)
        best = ends[0]
        left = self._left_open(best)
        if left:
            return (
                f"no approximate value: its {self._n} readings at known points leave open "
                f"{known(left)}; give values, or hold some"
            )
        other = next((m for m in ends[1:] if self._is_another(best, m)), None)
        if other is not None:
            a, b = (m.values["frame"][self._frame, 9:12] for m in (best, other))
            at = [", ".join(f"{v:.3f}" for v in c) for c in (a, b)]
            return (
                f"two positions fit equally well, offsets ({at[0]}) and ({at[1]}); give "
                "approximate values"
            )
        self._state["frame"][self._frame] = best.values["frame"][self._frame]
        for i in self._sizes:
            self._state["size"][i] = best.values["size"][i]
        return ""

    def _starts(self) -> Iterator[State]:
        """Iterate over start values: bearings, and places around the points."""
        record = UNKNOWNS["frame"]
        bearings = (
            np.arange(TRIAL_BEARINGS) * (2 * np.pi / TRIAL_BEARINGS)
            if 2 in self._missing
            else [None]
        )
        around = [(0.0, 0.0)]
        if {3, 4} <= set(self._missing.tolist()):
            around += [(np.cos(a), np.sin(a)) for a in np.arange(4) * (np.pi / 2) + 0.3]
        for bearing, (ahead, aside) in product(bearings, around):
            values = np.nan_to_num(self._given)
            if bearing is not None:
                values[2] = bearing
            state = dict(self._state)
            state["frame"] = self._state["frame"].copy()
            stored = record.store(values[None])[0]
            state["frame"][self._frame, : len(stored)] = stored
            state["size"] = np.nan_to_num(self._state["size"])
            q = self._places(state)
            spread = float(np.max(np.ptp(q, axis=0), initial=0.0)) or 1.0
            middle = q.mean(axis=0) + spread * np.array([ahead, aside, 0.0])
            for axis in range(3):
                if 3 + axis in self._missing:
                    state["frame"][self._frame, ROTATION + axis] = middle[axis]
            yield state

    def _places(self, state: State) -> Array:
        """Return the coordinates q (n, 3) of the points in the frame."""
        points = [i for b in self._blocks for k, i in b.variables if k == "point"]
        x = state["point"][np.unique(np.concatenate(points))]
        frame = self._equations.network.frame
        stored = np.repeat(state["frame"][self._frame][None], len(x), axis=0)
        at = self._equations.network.frames[
            self._equations.unknowns["frame"].names[self._frame]
        ].origin
        origin = None
        if at:
            number = self._equations.unknowns["point"].number[at]
            origin = np.repeat(state["point"][number][None], len(x), axis=0)
        return in_frame(frame, stored, x, origin, None).q

    def _system(self, state: State) -> tuple[Array, Array]:
        """Return whitened residuals (n,) and partials by the open components (n, u)."""
        v, a = [], []
        for block in self._blocks:
            try:
                found = block.evaluate(self._equations.network.frame, state)
            except InputError:  # degenerate geometry
                return np.full(self._n, np.inf), np.zeros((self._n, len(self._open)))
            v.append(block.whiten(found.residual).ravel())
            rows = np.zeros((block.n, block.dimension, len(self._open)))
            for (kind, index), part in zip(block.variables, found.jacobians, strict=True):
                if kind == "frame":
                    mine = (index == self._frame)[:, None, None]
                    rows[:, :, : len(self._missing)] += mine * part[:, :, self._missing]
                elif kind == "size":
                    for j, number in enumerate(self._sizes, len(self._missing)):
                        rows[:, :, j] += (index == number)[:, None] * part[:, :, 0]
            a.append(block.whiten(rows).reshape(-1, len(self._open)))
        return np.concatenate(v), np.concatenate(a)

    def _moved(self, state: State, step: Array) -> State:
        out = dict(state)
        whole = np.zeros((1, UNKNOWNS["frame"].size))
        whole[0, self._missing] = step[: len(self._missing)]
        out["frame"], out["size"] = state["frame"].copy(), state["size"].copy()
        row: Index = np.array([self._frame])
        out["frame"][row] = UNKNOWNS["frame"].retract(state["frame"][row], whole)
        out["size"][self._sizes, 0] += step[len(self._missing) :]
        return out

    def _left_open(self, m: DampedFit[State]) -> list[str]:
        """Return the names of the components that the observations leave open."""
        size = np.linalg.norm(m.partials, axis=0)
        left = open_columns(m.partials / np.where(size > 0, size, 1.0), MAX_OPEN_SINGULAR_RATIO)
        return [n for n, o in zip(self._open, left, strict=True) if o]

    def _is_another(self, best: DampedFit[State], m: DampedFit[State]) -> bool:
        """Return whether a fit is as good as the best one, and is somewhere else."""
        if m.cost > best.cost + MAX_COST_DIFFERENCE_OF_EQUAL_FITS or not {3, 4} <= set(
            self._missing.tolist()
        ):
            return False
        a, b = (x.values["frame"][self._frame] for x in (best, m))
        places = [s[:ROTATION].reshape(3, 3) @ s[9:12] for s in (a, b)]
        return bool(np.abs(places[0] - places[1]).max() > MIN_DISTANCE_OF_OTHER_PLACE_M)


def place_image_lines(equations: Equations, state: State) -> list[Problem]:
    """Fill the missing frames of lines in images; return a problem for each that is not found.

    Args:
        equations: the network.
        state: its values; poses are known.
    """
    network, table = equations.network, equations.unknowns["frame"]
    problems = []
    for name, lines in _lines(network).items():
        f = table.number[name]
        if not np.isnan(state["frame"][f]).any():
            continue
        planes = [_plane(equations, state, photo, own) for photo, own in lines.items()]
        found = [p for p in planes if p is not None]
        what = _fill_line(equations, state, f, found)
        if what:
            problems.append(Problem(what, f"line {name!r}"))
    return problems


def frames_of_image_lines(equations: Equations) -> set[int]:
    """Return the numbers of the frames of lines in images."""
    number = equations.unknowns["frame"].number
    return {number[name] for name in _lines(equations.network)}


def _lines(network: Network) -> dict[str, dict[str, list[ImageLine]]]:
    """Return the measured points by line and photo."""
    found: dict[str, dict[str, list[ImageLine]]] = {}
    for o in of_quantities(network.observations.values(), "point of a line in a photo"):
        found.setdefault(o.line, {}).setdefault(o.photo, []).append(o)
    return found


def _plane(
    equations: Equations, state: State, photo: str, own: list[ImageLine]
) -> tuple[Array, Array] | None:
    """Return the normal of the plane of a line, and its projection centre; none: one point."""
    network = equations.network
    pose = state["pose"][equations.unknowns["pose"].number[photo]]
    camera = network.cameras[network.photos[photo].camera]
    lens: Lens = camera.lens
    k = np.tile(np.array(camera.values), (len(own), 1))
    rays = directions(lens, np.array([(o.x, o.y) for o in own]), k)
    _, values, vt = np.linalg.svd(rays)
    if len(own) < 2 or not values[1] > 1e-9 * values[0]:
        return None
    return pose[:9].reshape(3, 3) @ vt[2], pose[9:]


def _fill_line(
    equations: Equations, state: State, f: int, planes: list[tuple[Array, Array]]
) -> str:
    """Fill the frame of a line; return what is wrong, empty if nothing is."""
    if len(planes) < 2:
        return (
            f"{len(planes)} photo{' has' if len(planes) == 1 else 's have'} two measured points of "
            "it or more: its approximate values need two, or give them"
        )
    normals = np.array([n for n, _ in planes])
    centres = np.array([c for _, c in planes])
    _, values, vt = np.linalg.svd(normals)
    if not values[1] > MIN_SINE_BETWEEN_PLANES * values[0]:
        return (
            f"its planes in {len(planes)} photos are the same, as it is parallel to the base: it "
            "needs a photo from elsewhere, or give its approximate values"
        )
    direction = vt[2]
    stored = state["frame"][f]
    origin = stored[13:16]
    # The place nearest to the origin: along the line nothing is asked for.
    a = np.vstack([normals, direction])
    b = np.append(np.einsum("ni,ni->n", normals, centres - origin), 0.0)
    place = np.linalg.lstsq(a, b, rcond=None)[0]
    basis = equations.network.frame.basis(origin[None], np.zeros((1, 2)))
    horizon = horizons(basis, stored[16:])[0]
    axis = horizon @ direction
    rotation = rotation_onto_axis(axis if axis[2] >= 0 else -axis)
    stored[:9] = rotation.ravel()
    stored[9:12], stored[12] = rotation.T @ horizon @ place, 0.0
    return ""
