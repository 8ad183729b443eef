"""Frames of planes, plumb lines and wires from what was read at known points.

The missing components of a frame, and the missing sizes that its observations share with no other
frame, are fitted to all its observations whose other unknowns are known: damped Gauss–Newton steps,
with the partials of the observations themselves, from several bearings and places. The best fit is
taken. Components that are held or given are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..errors import InputError, Problem, known
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.sub_frame import in_frame
from ..models.variables import ROTATION, UNKNOWNS
from ..observations.records_metrology import RECORDS
from ..types import Array, Index

BEARINGS = 8
"""Number of bearings from which a frame of unknown bearing is fitted."""
STEPS = 60
"""Largest number of steps of a fit."""
OPEN = 1e-9
"""Ratio of the smallest to the largest singular value of the scaled partials at which observations
leave a combination of components open."""
SMALL_PART = 0.2
"""Part of a component in an open combination from which on it is named."""
EQUAL = 1.0
"""Difference of vᵀPv within which two fits are equally good."""
APART = 1e-3
"""Distance, metres, from which on two fits are different places."""

_KINDS = frozenset(r.name for r in RECORDS if r.frames)


def aligned(equations: Equations) -> dict[int, list[Block]]:
    """Return the observations of every frame that only readings of alignment refer to."""
    found: dict[int, list[Block]] = {}
    others: set[int] = set()
    for block in equations.blocks:
        numbers = [index for kind, index in block.variables if kind == "frame"]
        if block.prior or not numbers:
            continue
        if block.kind not in _KINDS:
            others.update(np.unique(np.concatenate(numbers)).tolist())
            continue
        for f in np.unique(numbers[0]).tolist():
            found.setdefault(f, []).append(block.select(np.flatnonzero(numbers[0] == f)))
        for carrying in numbers[1:]:  # wires do not place the bodies that carry their sensors
            others.update(np.unique(carrying).tolist())
    return {f: blocks for f, blocks in found.items() if f not in others}


def align(equations: Equations, state: State) -> list[Problem]:
    """Fill missing frames of planes, plumb lines and wires; return a problem for each not found.

    Args:
        equations: the network.
        state: its values; frames, and sizes that belong to one frame, are filled.
    """
    problems = []
    table = equations.unknowns["frame"]
    for f, blocks in aligned(equations).items():
        if not np.isnan(state["frame"][f]).any():
            continue
        why = _Fit(equations, state, f, blocks).run()
        if why:
            problems.append(Problem(why, f"frame {table.names[f]!r}"))
    return problems


@dataclass(frozen=True)
class _Minimum:
    """The end of a fit."""

    state: State
    """Values of all unknowns."""
    cost: float
    """vᵀPv."""
    partials: Array
    """Whitened partials by the open components, (n, u)."""


class _Fit:
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
        ends = [m for start in self._starts() if (m := self._descend(start)) is not None]
        if not ends:
            return "no approximate value: its readings contradict each other; give values"
        if self._runs:  # a sagging wire is as well one that runs the other way
            ahead = [m for m in ends if self._places(m.state)[:, 1].mean() > 0]
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
            a, b = (m.state["frame"][self._frame, 9:12] for m in (best, other))
            at = [", ".join(f"{v:.3f}" for v in c) for c in (a, b)]
            return (
                f"two positions fit equally well, offsets ({at[0]}) and ({at[1]}); give "
                "approximate values"
            )
        self._state["frame"][self._frame] = best.state["frame"][self._frame]
        for i in self._sizes:
            self._state["size"][i] = best.state["size"][i]
        return ""

    def _starts(self) -> Iterator[State]:
        """Iterate over start values: bearings, and places around the points."""
        record = UNKNOWNS["frame"]
        bearings = np.arange(BEARINGS) * (2 * np.pi / BEARINGS) if 2 in self._missing else [None]
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
            found = block.evaluate(self._equations.network.frame, state)
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

    def _descend(self, state: State) -> _Minimum | None:
        """Return the minimum that is reached from a start (Levenberg, Marquardt)."""
        try:
            v, a = self._system(state)
        except InputError:  # degenerate geometry at the start
            return None
        damping = 1e-3
        for _ in range(STEPS):
            normal, gradient = a.T @ a, a.T @ v
            scale = np.diag(np.maximum(np.diag(normal), 1e-300))
            step = np.asarray(-np.linalg.lstsq(normal + damping * scale, gradient)[0], dtype=float)
            trial = self._moved(state, step)
            try:
                v_new, a_new = self._system(trial)
            except InputError:
                damping *= 10.0
                continue
            if not v_new @ v_new <= v @ v:
                damping *= 10.0
                if damping > 1e12:
                    break
                continue
            gain = float(v @ v - v_new @ v_new)
            state, v, a = trial, v_new, a_new
            damping = max(damping / 10.0, 1e-12)
            if gain <= 1e-9 * (1.0 + float(v @ v)):
                break
        return _Minimum(state, float(v @ v), a)

    def _left_open(self, m: _Minimum) -> list[str]:
        """Return the names of the components that the observations leave open."""
        size = np.linalg.norm(m.partials, axis=0)
        empty = [n for n, s in zip(self._open, size, strict=True) if s == 0]
        if empty:
            return empty
        _, values, vt = np.linalg.svd(m.partials / size, full_matrices=False)
        weak = values <= np.sqrt(OPEN) * values[0]
        parts = np.abs(vt[weak]).max(axis=0, initial=0.0)
        return [n for n, p in zip(self._open, parts, strict=True) if p > SMALL_PART]

    def _is_another(self, best: _Minimum, m: _Minimum) -> bool:
        """Return whether a fit is as good as the best one, and is somewhere else."""
        if m.cost > best.cost + EQUAL or not {3, 4} <= set(self._missing.tolist()):
            return False
        a, b = (x.state["frame"][self._frame] for x in (best, m))
        places = [s[:ROTATION].reshape(3, 3) @ s[9:12] for s in (a, b)]
        return bool(np.abs(places[0] - places[1]).max() > APART)
