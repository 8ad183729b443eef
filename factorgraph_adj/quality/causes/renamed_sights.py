"""Core network without misfitting points; sights of set-ups, fitted to it under other names.

The core is what is left of a network without the points of readings that do not fit. These points
(the suspects) leave the network, and what is left is adjusted. Stations, and points that place the
network, stay without the sights that do not fit.

Let x be the coordinates of a few points that the core lacks, and l the readings to them, some
of them as if they had been read to another target. With innovations d = f(x, x̂) − l, the cofactors
D = Σ + A Q Aᵀ and the partials B by x,

    x̂ = argmin dᵀ D⁻¹ d,   T² = min dᵀ D⁻¹ d,

T² is χ² with as many degrees of freedom as readings less the rank of B, if the names are right. The
core itself stays the same, so that no wrong name bends it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ...adjustment import adjust
from ...errors import AdjustmentError, InputError
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...graph.observation_selection import without
from ...graph.variables import State
from ...network.network import Network
from ...observations.registry import INCLINATION_QUANTITIES
from ...solve.solution import Solution
from ...types import Array, Index, Mask
from ..innovations import Innovations
from ..reliability import Reliability, reliability
from .evidence import VarianceFactor
from .readings import ONE_TARGET, TARGET_HEIGHT, Readings, station_and_target, vertical_place
from .separability import MAX_LINEAR_TEST_VALUE

MAX_FIT_STEPS = 12
"""Largest number of Gauss–Newton steps of a fit."""
FIT_TOLERANCE = 1e-3
"""Step relative to σ below which a fit has converged."""
FIT_RANK_RATIO = 1e-10
"""Ratio of singular values of a fit below which the readings do not determine a direction."""
MAX_SUSPECTS = 40
"""Largest number of points that may leave the network: exchanges are few."""
MAX_CORE_ADJUSTMENTS = 5
"""Largest number of times that points leave the core, since its readings do not fit."""
MIN_CORE_TEST_SHARE = 0.4
"""Part of the largest test value of the core from which on readings leave it together."""


@dataclass(frozen=True, eq=False)
class ReadingFit:
    """Readings fitted under some names."""

    t2: float
    """T²; infinite where there is none."""
    dof: int
    """Its degrees of freedom."""
    coordinates: Mapping[int, Array]
    """Coordinates (3,) of the new points, by number."""


NO_FIT = ReadingFit(np.inf, 0, {})
"""The fit of readings that have none."""


class RenamedReadings:
    """Readings to points that a solution lacks."""

    def __init__(self, equations: Equations, solution: Solution, points: Sequence[int]) -> None:
        """Prepare the fits.

        Args:
            equations: the equations with the readings.
            solution: the solution without them.
            points: numbers of the points that no solution places, in ``equations``.
        """
        names = equations.unknowns["point"].names
        new = {names[p]: np.zeros(3) for p in points}
        self.equations, self.solution = equations, solution
        self.innovations = Innovations(equations, solution, points=new)
        self.columns = len(solution.equations.unknowns.free)
        self.first = {p: self.columns + 3 * i for i, p in enumerate(points)}
        self.lost = {kind: mask.copy() for kind, mask in self.innovations.lost.items()}
        self.lost["point"][list(points)] = True

    def fit(
        self,
        observations: Mapping[int, Index],
        names: Mapping[tuple[int, int], tuple[int, float | None]],
        start: Mapping[int, Array],
    ) -> ReadingFit:
        """Fit new points to readings.

        Args:
            observations: numbers of the observations in each block, by place of the block.
            names: other targets of readings, by place of the block and number in it: the number of
                the target, and its height; None: as recorded.
            start: approximate coordinates of the points that are fitted, (3,) metres.
        """
        blocks = [
            _renamed(b, i, names, self.equations) for i, b in enumerate(self.equations.blocks)
        ]
        renamed = replace(self.equations, blocks=tuple(blocks))
        rows = self._rows(renamed, observations, start)
        if not len(rows):
            return NO_FIT
        try:
            return self._descend(renamed, rows, start)
        except (InputError, np.linalg.LinAlgError):
            return NO_FIT

    def at(self, observations: Mapping[int, Index], points: Mapping[int, Array]) -> ReadingFit:
        """Return T² of readings under their own names, with the points where they are.

        Args:
            observations: as for `fit`.
            points: coordinates of the points, (3,) metres.
        """
        rows = self._rows(self.equations, observations, points)
        try:
            v, _ = self._moved(self.equations, points).linearise(rows).whitened(self.solution)
        except (InputError, np.linalg.LinAlgError):
            return NO_FIT
        return ReadingFit(float(v @ v), len(rows), points)

    def _rows(
        self,
        equations: Equations,
        observations: Mapping[int, Index],
        points: Mapping[int, Array],
    ) -> Index:
        rows = [self._known(equations.blocks[at], n, points) for at, n in observations.items()]
        return np.sort(np.concatenate([np.zeros(0, dtype=np.intp), *rows]))

    def _known(self, block: Block, numbers: Index, start: Mapping[int, Array]) -> Index:
        """Return the rows of readings that touch nothing unknown but the points of the fit."""
        fine = np.ones(len(numbers), dtype=bool)
        for kind, index in block.variables:
            lost = self.lost[kind][index[numbers]]
            if kind == "point":
                lost &= ~np.isin(index[numbers], list(start))
            fine &= ~lost
        first = block.first_row + block.dimension * numbers[fine]
        return np.asarray((first[:, None] + np.arange(block.dimension)).ravel())

    def _moved(self, equations: Equations, points: Mapping[int, Array]) -> Innovations:
        """Return the innovations of renamed equations, with the points at their places."""
        out = copy(self.innovations)
        out.equations, out.state = equations, dict(out.state)
        out.state["point"] = out.state["point"].copy()
        for p, x in points.items():
            out.state["point"][p] = x
        return out

    def _descend(self, equations: Equations, rows: Index, start: Mapping[int, Array]) -> ReadingFit:
        here = self._moved(equations, start)
        own = [self.first[p] + np.arange(3) for p in start]
        columns = np.concatenate([np.zeros(0, dtype=np.intp), *own])
        for _ in range(MAX_FIT_STEPS):
            v, a = here.linearise(rows).whitened(self.solution)
            b = a[:, columns]
            step, _, rank, _ = np.linalg.lstsq(b, -v, rcond=FIT_RANK_RATIO)
            t2 = float(np.sum((v + b @ step) ** 2))
            for i, p in enumerate(start):
                here.state["point"][p] += step[3 * i : 3 * i + 3]
            if np.linalg.norm(b @ step) < FIT_TOLERANCE * max(1.0, np.sqrt(t2)):
                found = {p: here.state["point"][p].copy() for p in start}
                return ReadingFit(t2, len(rows) - int(rank), found)
        return NO_FIT


def _renamed(
    block: Block,
    place: int,
    names: Mapping[tuple[int, int], tuple[int, float | None]],
    equations: Equations,
) -> Block:
    """Return a block with other targets of some readings."""
    changes = {n: to for (at, n), to in names.items() if at == place}
    ends = station_and_target(block) if changes else None
    if ends is None:
        return block
    variables, constants = list(block.variables), dict(block.constants)
    index = variables[ends[1]][1].copy()
    for n, (target, height) in changes.items():
        index[n] = target
        if height is not None and TARGET_HEIGHT in constants:
            constants[TARGET_HEIGHT] = constants[TARGET_HEIGHT].copy()
            constants[TARGET_HEIGHT][n] = height
    variables[ends[1]] = ("point", index)
    vertical = vertical_place(block, ends[1])
    if vertical is not None:
        own = equations.unknowns["vertical"].number
        point_names = equations.unknowns["point"].names
        at = variables[vertical][1].copy()
        for n, (target, _) in changes.items():
            at[n] = own.get(point_names[target], own.get("", 0))
        variables[vertical] = ("vertical", at)
    return replace(block, variables=tuple(variables), constants=constants)


@dataclass(frozen=True)
class SetUp:
    """A set-up: the station, and the height of the instrument."""

    station: int
    """Number of the station."""
    height: float
    """Height of the instrument, metres."""


@dataclass(frozen=True)
class Sight:
    """All that was read from a set-up to a target."""

    readings: tuple[tuple[int, int], ...]
    """Place of the block and number of the observation in it, of each reading."""
    ids: tuple[str, ...]
    """Ids of the readings."""
    heights: tuple[float, ...]
    """Heights of the target recorded with them."""


def sights_by_set_up(equations: Equations, solution: Solution) -> dict[SetUp, dict[int, Sight]]:
    """Return the sights of each set-up by the number of the target."""
    r = Readings.of(equations, solution.state).of_quantities(ONE_TARGET)
    above, target_height = r.constant("instrument_height"), r.constant(TARGET_HEIGHT)
    inclined = np.isin(r.quantity, list(INCLINATION_QUANTITIES))
    heights: dict[int, set[float]] = defaultdict(set)
    for station, height in zip(r.station[inclined].tolist(), above[inclined].tolist(), strict=True):
        heights[station].add(height)
    rows: dict[tuple[SetUp, int], list[int]] = defaultdict(list)
    ends = zip(r.station.tolist(), r.target.tolist(), above.tolist(), strict=True)
    for i, (station, target, height) in enumerate(ends):
        known = heights[station]
        # Directions are often recorded without a height: they belong to all of the station.
        for h in [height] if height in known else known or {0.0}:
            rows[SetUp(station, h), target].append(i)
    out: dict[SetUp, dict[int, Sight]] = defaultdict(dict)
    for (set_up, target), at in rows.items():
        out[set_up][target] = Sight(
            tuple((int(r.block[i]), int(r.number[i])) for i in at),
            tuple(r.equations.id(int(r.row[i])) for i in at),
            tuple(dict.fromkeys(float(h) for h in target_height[at])),
        )
    return out


def sighted_places(
    equations: Equations, state: State, station: int, above: float, targets: Mapping[int, Sight]
) -> dict[int, Array]:
    """Return the places (3,) of the targets of a set-up, metres.

        X = X_i + h_i u + D (e sin A sin z + n cos A sin z + u cos z) − h_t u

    Without refraction, so that they are good to centimetres. NaN: the readings, the orientation or
    the station do not give it; without an inclination the height alone is NaN.

    Args:
        equations: the equations with the readings.
        state: values of the station and of the orientations.
        station: number of the station.
        above: height of the instrument, metres.
        targets: sights by the number of the target.
    """
    at = state["point"][station]
    if not np.isfinite(at).all():
        return {t: np.full(3, np.nan) for t in targets}
    e, n, u = equations.network.frame.basis(at[None], np.zeros((1, 2))).enu[0]
    out: dict[int, Array] = {}
    for target, sight in targets.items():
        azimuth, slope, plan, zenith, height = [], [], [], [], []
        for place, number in sight.readings:
            block = equations.blocks[place]
            value = float(block.observed[number, 0])
            match block.quantity:
                case "direction":
                    index = next(i for kind, i in block.variables if kind == "orientation")
                    azimuth.append(value + float(state["orientation"][index[number], 0]))
                case "azimuth":
                    azimuth.append(value)
                case "slope distance":
                    slope.append(value)
                case "horizontal distance":
                    plan.append(value)
                case "zenith angle":
                    zenith.append(value)
                case "vertical angle":
                    zenith.append(0.5 * np.pi - value)
            if block.quantity in INCLINATION_QUANTITIES:
                height.append(float(block.constants[TARGET_HEIGHT][number]))
        z = zenith[0] if zenith else 0.5 * np.pi
        across = slope[0] * np.sin(z) if slope else plan[0] if plan else np.nan
        bearing = azimuth[0] if azimuth else np.nan
        rise = across / np.tan(z) + above - height[0] if zenith else np.nan
        flat = at + across * (e * np.sin(bearing) + n * np.cos(bearing))
        out[target] = flat + rise * u if zenith else flat + np.array([0.0, 0.0, np.nan])
    return out


@dataclass(frozen=True, eq=False)
class CoreNetwork:
    """The adjustment of what does not concern the suspects."""

    solution: Solution
    reliability: Reliability
    suspects: frozenset[int]
    """Points of readings that do not fit, by number in the whole network."""
    weight: VarianceFactor
    """σ0² by which readings beside it are judged."""

    @classmethod
    def of(
        cls,
        equations: Equations,
        solution: Solution,
        bad: Collection[str],
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
        *,
        estimated: bool,
    ) -> CoreNetwork | None:
        """Return the core; None: it is not determined, or everything is suspect.

        A wrong name may agree better with a point than what places it. So of suspects that place
        the network this alone stays, where the network is determined without their sights.

        Args:
            equations: the whole network.
            solution: an adjustment of it, or of a part, for approximate values.
            bad: ids of the readings that do not fit there.
            sights: the sights of every set-up.
            alpha: probability with which a reading that is right does not fit.
            estimated: whether σ0 is that of the core; otherwise it is 1.
        """
        for placing in (True, False):
            out = cls._of(equations, solution, bad, sights, alpha, estimated, placing=placing)
            if out is not None:
                return out
        return None

    @classmethod
    def _of(
        cls,
        equations: Equations,
        solution: Solution,
        bad: Collection[str],
        sights: Mapping[SetUp, Mapping[int, Sight]],
        alpha: float,
        estimated: bool,
        *,
        placing: bool,
    ) -> CoreNetwork | None:
        fixing = _placing(equations)
        aside = set(bad)
        out: CoreNetwork | None = None
        for _ in range(MAX_CORE_ADJUSTMENTS):
            suspects, ids = _suspects(sights, aside)
            if not suspects or len(suspects) > MAX_SUSPECTS:
                return out
            names = equations.unknowns["point"].names
            leave = [names[p] for p in suspects & removable_points(equations, sights)]
            gone = ids | aside
            if placing:
                alone = suspects & fixing.keys()
                gone |= {
                    i for own in sights.values() for p in alone & own.keys() for i in own[p].ids
                }
                gone -= {i for p in alone for i in fixing[p]}
            try:
                network = without(equations.network, gone, points=leave)
                rel = reliability(_adjusted(network, solution), alpha=alpha)
            except AdjustmentError:
                return out
            core = rel.solution
            if not core.converged:
                return out
            weight = VarianceFactor.left_by(core, estimated=estimated)
            out = cls(core, rel, frozenset(suspects), weight)
            values, critical = (rel.tau, rel.critical_tau) if estimated else (rel.w, rel.critical_w)
            w = np.nan_to_num(np.abs(values))
            if not w.max(initial=0.0) > critical:
                break
            worst = np.flatnonzero(w >= max(critical, MIN_CORE_TEST_SHARE * float(w.max())))
            aside |= {core.equations.id(int(row)) for row in worst}
        return out


def _adjusted(network: Network, start: Solution) -> Solution:
    """Return the adjustment of a part; from its own approximate values, if they lead further down.

    What has bent the whole may have bent the start.
    """
    out = adjust(network, start=start)
    if out.converged and out.vtpv < MAX_LINEAR_TEST_VALUE**2:
        return out
    with suppress(AdjustmentError):
        other = adjust(network)
        if other.converged and not (out.converged and out.vtpv <= other.vtpv):
            return other
    return out


def _suspects(
    sights: Mapping[SetUp, Mapping[int, Sight]], bad: Collection[str]
) -> tuple[set[int], set[str]]:
    """Return the targets of readings that do not fit, and all that was read in these sights."""
    points: set[int] = set()
    ids: set[str] = set()
    for targets in sights.values():
        for target, sight in targets.items():
            if not set(bad).isdisjoint(sight.ids):
                points.add(target)
                ids.update(sight.ids)
    return points, ids


def removable_points(equations: Equations, sights: Mapping[SetUp, Mapping[int, Sight]]) -> set[int]:
    """Return the points without which a network still has its stations and its datum."""
    stations = {s.station for s in sights}
    return (
        set(range(len(equations.unknowns["point"].names))) - stations - _placing(equations).keys()
    )


def _placing(equations: Equations) -> dict[int, set[str]]:
    """Return the points that place the network, with the ids of the observations that do."""
    free: Mask = np.array(equations.unknowns["point"].free.all(axis=1))
    out: dict[int, set[str]] = {p: set() for p in np.flatnonzero(~free).tolist()}
    for block in equations.blocks:
        if block.fixes == "coordinates":
            for kind, index in block.variables:
                if kind == "point":
                    for p, ident in zip(index.tolist(), block.ids, strict=True):
                        out.setdefault(p, set()).add(ident)
    return out


def uncontrolled_targets(
    equations: Equations, core: CoreNetwork, sights: Mapping[SetUp, Mapping[int, Sight]]
) -> frozenset[int]:
    """Return the targets of the core whose readings nothing controls."""
    own, number = core.solution.equations, equations.unknowns["point"].number
    controlled: set[int] = set()
    for block in own.blocks:
        rows = core.reliability.controlled[block.rows].reshape(block.n, block.dimension)
        for kind, index in block.variables:
            if kind == "point":
                names = own.unknowns["point"].names
                fine = index[rows.any(axis=1)]
                controlled |= {number[names[p]] for p in np.unique(fine).tolist()}
    targets = {t for own_targets in sights.values() for t in own_targets}
    return frozenset(targets - controlled)
