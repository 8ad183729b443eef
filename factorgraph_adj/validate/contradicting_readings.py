"""Single readings that contradict given coordinates of all their points, and likely reasons.

With all points held, or weighted, a distance, an angle, a height difference or a vector is known:
v = computed − observed has the covariance

    S = R + J Σ Jᵀ + (J_t u ½ L²/R_E δk)²

with R of the reading, Σ of the given coordinates, and for angles the doubt δk of the refraction
that lifts the target t of a sight of length L along the vertical u. The orientation of a set of
directions is eliminated by the reading j whose v is the median: v_i − v_j has the covariance

    R_i + R_j + (J_i − J_j) Σ (J_i − J_j)ᵀ,

as both have the station in common. A reading with vᵀ S⁻¹ v > `CONTRADICTION_FACTOR`² contradicts
them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..crs.reference_system import ReferenceSystem
from ..errors import InputError
from ..frames import MEAN_EARTH_RADIUS
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..graph.weights import weigh
from ..models.base import wrap
from ..observations import KINDS
from ..types import Array, Index, Mask
from ..units import ANGLE, LENGTH, decimal_angle
from .findings import (
    CONTRADICTION_FACTOR,
    Finding,
    exchanged_components,
    other_signs,
    reading_covariance,
)
from .reference_frames import other_zone_text
from .repeated_readings import SIGMA_OF_REFRACTION
from .wrong_units import ANGLE_UNIT_NAMES, length_factors

MAX_LISTED_READINGS = 12
"""Largest number of readings that are listed one by one."""
MIN_LENGTH_TEST = CONTRADICTION_FACTOR**2
"""Smallest square of a length by the coordinates, relative to its variance, of which units are
told."""
MIN_RELATIVE_PARTIAL = 1e-9
"""Largest partial, relative to the others of a reading, of a coordinate that does not matter."""


@dataclass(frozen=True)
class _Compared:
    """Readings of a block with given coordinates at all their points, (k)."""

    block: Block
    """The readings."""
    residual: Array
    """Computed − observed, (k, d)."""
    covariance: Array
    """S, (k, d, d)."""
    points: Index
    """Numbers of their points, (k, m)."""
    sets: Index | None
    """Number of the set of directions of each, (k,); None for other kinds."""
    axes_of_files: Mapping[str, Array]
    """Rotations (d, d) from the axes in which some were read to those of the network, by id."""

    def as_read(self, i: int) -> tuple[Array, Array, Array]:
        """Return observed and computed values (d,) and S (d, d) along the axes of the file."""
        observed = self.block.observed[i]
        computed = observed + self.relative(self.residual)[i]
        turn = self.axes_of_files.get(self.block.ids[i])
        if turn is None:
            return observed, computed, self.covariance[i]
        return observed @ turn, computed @ turn, turn.T @ self.covariance[i] @ turn

    def test(self, residual: Array) -> Array:
        """Return √(vᵀ S⁻¹ v) in units of `CONTRADICTION_FACTOR`, (k,)."""
        inner = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(self.covariance), residual)
        return np.asarray(np.sqrt(np.maximum(inner, 0.0)) / CONTRADICTION_FACTOR)

    def relative(self, residual: Array) -> Array:
        """Return residuals of angles between −π and π, those of sets from that of their median."""
        if self.block.unit == "rad":
            residual = wrap(residual)
        if self.sets is None:
            return residual
        out = residual.copy()
        for own in _members(self.sets):
            out[own] = wrap(residual[own] - residual[own[_middle(residual[own, 0])]])
        return out

    @property
    def references(self) -> Index:
        """Number of the reading from which each is counted, (k,); −1 where there is none."""
        out = np.full(self.block.n, -1, dtype=np.intp)
        if self.sets is not None:
            for own in _members(self.sets):
                out[own] = own[_middle(self.residual[own, 0])]
        return out


def _members(sets: Index) -> list[Index]:
    """Return the numbers of the members of each set."""
    return [np.flatnonzero(sets == s) for s in np.unique(sets)]


def _middle(angles: Array) -> int:
    """Return the number of the angle from which the sum of the distances of all others is least."""
    return int(np.argmin(np.abs(wrap(angles[:, None] - angles[None, :])).sum(axis=0)))


def contradicting_readings(
    equations: Equations, *, length: str = "m", angle: str = "gon"
) -> Iterator[Finding]:
    """Iterate over readings that contradict the given coordinates of all their points.

    What explains them is reported: exchanged coordinates of one point or of all, another unit, the
    other sign, angles that count the other way.

    Args:
        equations: the network.
        length: unit of lengths in its files.
        angle: unit of angles in its files.
    """
    given = _Given.of(equations)
    every = [c for block in equations.blocks if (c := given.compared(block)) is not None]
    wrong = [c.test(c.relative(c.residual)) > 1.0 for c in every]
    if not any(w.any() for w in wrong):
        return
    explained = _exchanged(given, every, wrong)
    if explained is not None:
        what, ids = explained
        one = len(ids) == 1
        readings = "1 reading" if one else f"{len(ids)} readings"
        yield Finding(
            f"{readings} between given points contradict{'s' * one} their coordinates, and "
            f"fit{'s' * one} with {what}",
            "look at the order of the columns of the points",
            ids=ids,
            cause=what,
        )
        return
    yield from _one_by_one(equations.network.crs, every, wrong, length, angle)


def _one_by_one(
    crs: ReferenceSystem | None,
    every: Sequence[_Compared],
    wrong: Sequence[Mask],
    length: str,
    angle: str,
) -> Iterator[Finding]:
    """Iterate over contradicting readings; those of a kind with one reason are one finding."""
    found: list[tuple[float, Finding]] = []
    for c, off in zip(every, wrong, strict=True):
        reasons: dict[str, list[int]] = {}
        for i in np.flatnonzero(off).tolist():
            reasons.setdefault(_reason(c, i, length, angle), []).append(i)
        tests = c.test(c.relative(c.residual))
        for why, rows in reasons.items():
            several = bool(why) and len(rows) > 1
            for i in rows[:1] if several else rows:
                text = _contradiction_text(c, i, length, angle)
                if several:
                    kind = c.block.kind.replace("_", " ")
                    text = f"{len(rows)} {kind}s between given points, of which {text}"
                observed, computed, covariance = c.as_read(i)
                residual = computed - observed
                worst = int(np.argmax(np.abs(residual)))
                sigma = float(np.sqrt(covariance[worst, worst]))
                scale = 1e3 if c.block.unit == "m" else 1e3 / ANGLE[decimal_angle(angle)]
                unit = "mm" if c.block.unit == "m" else f"m{decimal_angle(angle)}"
                finding = Finding(
                    f"{text}{why and f', and fits {why}'}",
                    "look at the reading, its names and units, and at the coordinates"
                    + (other_zone_text(crs, abs(residual[worst])) if c.block.unit == "m" else ""),
                    float(scale * residual[worst]),
                    scale * CONTRADICTION_FACTOR * sigma,
                    unit,
                    tuple(c.block.ids[j] for j in (rows if several else [i])),
                    why,
                )
                found.append((float(tests[i]), finding))
    found.sort(key=lambda each: -each[0])
    for _, finding in found[:MAX_LISTED_READINGS]:
        yield finding
    if len(found) > MAX_LISTED_READINGS:
        ids = tuple(i for _, f in found[MAX_LISTED_READINGS:] for i in f.ids)
        yield Finding(
            f"{len(ids)} more readings contradict the given coordinates of their points",
            "look at the coordinates of the points that they have in common",
            ids=ids,
        )


def _contradiction_text(c: _Compared, i: int, length: str, angle: str) -> str:
    """Return a contradiction in words, with both values."""
    observed, computed, _ = c.as_read(i)
    if c.block.unit == "m":
        unit, scale, digits = length, LENGTH[length], 3
    else:
        unit = decimal_angle(angle)
        scale, digits = ANGLE[unit], 4
    values = (
        ", ".join(f"{x / scale:.{digits}f}" for x in v.tolist()) for v in (observed, computed)
    )
    read, known = values
    beside = ""
    if (other := int(c.references[i])) >= 0:
        beside = f" beside {c.block.labels(other)}"
    return (
        f"{c.block.labels(i)}{beside} contradicts the given coordinates: observed {read}, "
        f"computed {known} {unit}"
    )


def _reason(c: _Compared, i: int, length: str, angle: str) -> str:
    """Return the first that makes a contradicting reading fit; empty if nothing does."""
    observed, computed, covariance = c.as_read(i)
    if c.block.unit == "m" and computed @ np.linalg.solve(covariance, computed) < MIN_LENGTH_TEST:
        return ""  # in large units anything is near zero
    other = int(c.references[i])
    if other >= 0:
        computed = observed + c.residual[i]
    for why, value in _readings(observed, c.block, length, angle):
        v = computed - value
        if other >= 0:  # the same change makes another reading of the reference
            reference = dict(_readings(c.block.observed[other], c.block, length, angle))[why]
            v = v - (c.block.observed[other] + c.residual[other] - reference)
        v = wrap(v) if c.block.unit == "rad" else v
        if float(v @ np.linalg.solve(covariance, v)) < CONTRADICTION_FACTOR**2:
            return why
    return ""


def _readings(
    observed: Array, block: Block, length: str, angle: str
) -> Iterator[tuple[str, Array]]:
    """Iterate over what a reading may be instead of what it seems to be, (d,), with a reason."""
    record = KINDS.get(block.kind)
    if block.unit == "m":
        for unit, factor in length_factors(length).items():
            yield f"as {unit} (factor {factor:.4g})", factor * observed
        yield from other_signs(observed)
        yield from exchanged_components(observed)
    else:
        stated = decimal_angle(angle)
        for unit, noun in ANGLE_UNIT_NAMES.items():
            if unit != stated:
                yield (
                    f"in {noun}, not {ANGLE_UNIT_NAMES.get(stated, stated)}",
                    observed * ANGLE[unit] / ANGLE[stated],
                )
        yield "with the other sign, or counted anticlockwise", -observed
        if record is not None and record.level_reading is not None:
            yield "as the angle from the zenith, or from the horizon, instead", np.pi / 2 - observed


def _exchanged(
    given: _Given, every: Sequence[_Compared], wrong: Sequence[Mask]
) -> tuple[str, tuple[str, ...]] | None:
    """Return whose exchanged x and y explain contradictions, and their ids; None: nobody's does.

    All readings must fit then, those that do not contradict too; a point alone is tried first.
    """
    count: Counter[int] = Counter()
    for c, off in zip(every, wrong, strict=True):
        count.update(np.unique(c.points[off]).tolist())
    ids = tuple(
        c.block.ids[i]
        for c, off in zip(every, wrong, strict=True)
        for i in np.flatnonzero(off).tolist()
    )
    names = given.equations.unknowns["point"].names
    tried = [[p] for p, _ in count.most_common()]
    if len(given.points) > 1:
        tried.append(list(given.points))
    fitting = []
    for points in tried:
        exchanged = given.exchanged(points)
        again = [exchanged.compared(c.block) for c in every]
        if all(c is not None and (c.test(c.relative(c.residual)) <= 1.0).all() for c in again):
            fitting.append(points)
    single = [names[p[0]] for p in fitting if len(p) == 1]
    if single:
        named = " or ".join(repr(n) for n in single)
        return f"x and y of point {named} exchanged", ids
    return ("x and y of all given points exchanged", ids) if fitting else None


@dataclass(frozen=True)
class _Given:
    """Given coordinates with their standard deviations."""

    equations: Equations
    """The network."""
    state: State
    """Given values; unknown coordinates have some value that no geometry makes special."""
    sigma: Array
    """Standard deviations of coordinates, (p, 3): 0 of held ones, infinite of unknown ones."""

    @classmethod
    def of(cls, equations: Equations) -> _Given:
        """Return what is given in a network."""
        table = equations.unknowns["point"]
        sigma = np.where(table.free, table.sigma, 0.0)
        sigma = np.where(np.isfinite(table.values), sigma, np.inf)
        start = equations.unknowns.start()
        state = {k: np.nan_to_num(v) for k, v in start.items()}
        some = np.random.default_rng(0).uniform(1.0, 100.0, table.values.shape)
        state["point"] = np.where(np.isfinite(table.values), table.values, some)
        return cls(equations, state, sigma)

    @property
    def points(self) -> Index:
        """Numbers of the points whose x and y are given."""
        return np.asarray(np.flatnonzero(np.isfinite(self.sigma[:, :2]).all(axis=1)))

    def exchanged(self, points: Sequence[int]) -> _Given:
        """Return the same with x and y of some points exchanged."""
        xyz, sigma = self.state["point"].copy(), self.sigma.copy()
        xyz[points], sigma[points] = xyz[points][:, [1, 0, 2]], sigma[points][:, [1, 0, 2]]
        return replace(self, state={**self.state, "point": xyz}, sigma=sigma)

    def compared(self, block: Block) -> _Compared | None:
        """Return the readings of a block that given coordinates tell; None: there are none."""
        record = KINDS.get(block.kind)
        if record is None or block.prior or block.lens is not None or record.moved is not None:
            return None
        if record.unit not in ("m", "rad"):
            return None
        ends = [j for j, (kind, _) in enumerate(block.variables) if kind == "point"]
        if len(ends) < 2:
            return None
        # What is not a point must be held, but for the orientations of sets.
        fine = np.ones(block.n, dtype=bool)
        for kind, index in block.variables:
            table = self.equations.unknowns[kind]
            if kind not in ("point", "orientation"):
                fine &= ~table.free[index].any(axis=1) & np.isfinite(table.values[index]).all(
                    axis=1
                )
            if kind == "point":
                fine &= np.isfinite(self.sigma[index]).any(axis=1)
        rows = np.flatnonzero(fine)
        if not len(rows):
            return None
        part, frame = (
            weigh(self.equations.network, block.select(rows), self.state),
            self.equations.network.frame,
        )
        try:
            found = part.evaluate(frame, self.state)
        except InputError:  # two points in one place, which `check` refuses
            return None
        covariance = reading_covariance(part)
        known, by_point = np.ones(part.n, dtype=bool), list[Array]()
        for j in ends:
            index, a = part.variables[j][1], found.jacobians[j]
            size = np.abs(a).max(axis=(1, 2), keepdims=True)
            matters = (np.abs(a) > MIN_RELATIVE_PARTIAL * np.maximum(size, 1e-300)).any(axis=1)
            sigma = self.sigma[index]
            known &= ~(matters & ~np.isfinite(sigma)).any(axis=1)
            by_point.append(a * np.where(np.isfinite(sigma), sigma, 0.0)[:, None, :])
        if part.unit == "rad":
            covariance = covariance + self._refraction(part, ends, found.jacobians[ends[-1]])
        every = np.column_stack([part.variables[j][1] for j in ends])
        covariance = covariance + _in_common(every, by_point, every, by_point)
        sets = next((i for kind, i in part.variables if kind == "orientation"), None)
        keep = np.flatnonzero(known)
        if sets is not None:
            alone = np.bincount(sets[keep], minlength=int(sets.max(initial=0)) + 1) < 2
            keep = keep[~alone[sets[keep]]]
        if not len(keep):
            return None
        residual = np.asarray(found.residual)[keep]
        if sets is not None:
            sets = sets[keep]
        points, by_point = every[keep], [b[keep] for b in by_point]
        axes = self.equations.network.axes_of_files
        out = _Compared(part.select(keep), residual, covariance[keep], points, sets, axes)
        if sets is None:
            return out
        other = out.references
        both = _in_common(points, by_point, points[other], [b[other] for b in by_point])
        both = both + np.swapaxes(both, 1, 2)
        total = out.covariance + out.covariance[other] - both
        # The reference beside itself has no difference: its own covariance stands there.
        itself = other == np.arange(len(other))
        return replace(out, covariance=np.where(itself[:, None, None], out.covariance, total))

    def _refraction(self, part: Block, ends: Sequence[int], by_target: Array) -> Array:
        """Return the variances of angles by the doubt about refraction, (k, 1, 1)."""
        a, b = (self.state["point"][part.variables[j][1]] for j in (ends[0], ends[-1]))
        up = self.equations.network.frame.basis(b, np.zeros((len(b), 2))).enu[:, 2]
        lift = SIGMA_OF_REFRACTION * np.sum((b - a) ** 2, axis=1) / (2.0 * MEAN_EARTH_RADIUS)
        effect = np.einsum("nij,nj->ni", by_target, up) * lift[:, None]
        return np.asarray(np.einsum("ni,nj->nij", effect, effect))


def _in_common(
    points: Index, by_point: Sequence[Array], others: Index, by_other: Sequence[Array]
) -> Array:
    """Return the covariances of readings with others by the points in common, (k, d, d).

    Args:
        points: numbers of the points of the readings, (k, m).
        by_point: J σ of each of them, (k, d, 3).
        others: numbers of the points of the others, (k, m).
        by_other: J σ of these.
    """
    out = np.zeros((len(points), by_point[0].shape[1], by_point[0].shape[1]))
    for i, a in enumerate(by_point):
        for j, b in enumerate(by_other):
            same = points[:, i] == others[:, j]
            out += same[:, None, None] * np.einsum("nij,nkj->nik", a, b)
    return out
