"""Repeated readings, also forth and back, that differ; duplicates; blocks of copied readings.

Readings of the same quantity, forth, back or again, must agree within their standard deviations.

One reading may equal another by chance, and repeated sets do so within the rounding of a display.
Readings in a row that equal earlier ones, with the same kinds, names and values in the same order,
`MIN_COPIED_VALUES` numbers or more, are no chance unless the resolution of the display makes them:
a file was read twice. They count where less than `MAX_CHANCE_OF_COPIES` such blocks are expected
among all readings. Back readings of levelled lines that are the forth ones with the sign turned
were copied, too.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite, pi, sqrt
from typing import Any

import numpy as np

from ..entities import REFRACTION_OF_THE_NETWORK
from ..frames import MEAN_EARTH_RADIUS
from ..network.network import Network
from ..observations import Observation, Sight
from ..observations.base import of_quantities
from ..observations.registry import DISTANCE_QUANTITIES, INCLINATION_QUANTITIES
from ..observations.variances import Along
from ..statistical_tests import TOLERANCE_IN_SIGMAS, poisson_upper_probability
from ..stochastic_model import StandardDeviation
from ..types import Array
from ..units import ANGLE
from .findings import Finding
from .loop_misclosures import line_sigma

REFRACTION_OF_HEIGHTS = 0.13
"""Coefficient of refraction with which height differences forth and back are compared."""
SIGMA_OF_REFRACTION = 0.3
"""Standard deviation of it, for the tolerance."""

MAX_CHANCE_OF_COPIES = 0.05
"""Probability with which so many equal readings are no copies, above which nothing is doubted."""
MIN_SCATTER_STEPS = 2.0
"""Scatter of repeated readings in steps of their resolution, below which equal ones are common."""
ROUNDING_UNITS = tuple(ANGLE[unit] for unit in ("rad", "gon", "deg", "arcsec"))
"""Metre, gon, degree and second: in one of them readings are rounded."""
MAX_TRIED_DECIMALS = 8
"""Number of decimals that are tried."""
FINEST_RESOLUTION = 1e-9
"""Resolution of readings that are rounded in no unit."""
STEP_ROUNDING = 1e-4
"""Distance from a whole number of steps that is rounding of double precision."""
MIN_COPIED_VALUES = 5
"""Smallest number of observed values in a row that are reported."""
MAX_EARLIER_READINGS = 4
"""Largest number of earlier readings that equal one, of which the latest are looked at."""
MIN_EQUAL_RETURNS = 3
"""Smallest number of lines that are noted: of one or two nobody knows."""


def reading_sigma(o: Observation, length: float) -> float:
    """Return the standard deviation of a reading over a sight of a length, unit of its value.

    Vectors of one component state it, or their covariance, for each component.
    """
    sigma = o.sigma  # type: ignore[attr-defined]
    if sigma is None:
        return float(np.sqrt(np.ravel(o.covariance)[0]))  # type: ignore[attr-defined]
    if not isinstance(sigma, StandardDeviation):
        return float(np.ravel(sigma)[0])
    weight = o.record.weight
    assert weight is not None
    return float(np.sqrt(weight.variance([sigma], Along(max(length, 1e-3)))[0]))


def differing_repetitions(network: Network) -> Iterator[Finding]:
    """Iterate over readings of the same thing that do not agree."""
    yield from _duplicates(network)
    yield from _distances(network)
    yield from _heights(network)


def _duplicates(network: Network) -> Iterator[Finding]:
    """Rows that are there twice more often than independent readings would be equal.

    Two readings with resolution u and standard deviation s are equal with p ≈ u / (2 √π s); of n
    readings n (n − 1) / 2 pairs may be. Where repeated readings differ by some steps of their
    resolution only, equal ones say nothing.
    """
    by_kind: dict[str, dict[tuple[object, ...], list[Observation]]] = {}
    for o in network.observations.values():
        key = (o.names(), repr(getattr(o, "sigma", None)), getattr(o, "set", None))
        by_kind.setdefault(o.kind, defaultdict(list))[key].append(o)
    for kind, again in by_kind.items():
        pairs = [pair for some in again.values() for pair in pairwise(_sorted(some))]
        copies = [
            (a, b) for a, b in pairs if np.array_equal(observed_values(a), observed_values(b))
        ]
        if not copies:
            continue
        groups = [np.array([observed_values(o) for o in some]) for some in again.values()]
        step = decimal_resolution(np.concatenate([x.ravel() for x in groups]))
        scatter = repetition_scatter(groups)
        if scatter is not None and scatter < MIN_SCATTER_STEPS * step:
            continue
        expected = 0.0
        for some in again.values():
            expected += len(some) * (len(some) - 1) / 2 * chance_of_equal(some[0], step, scatter)
        if expected and poisson_upper_probability(len(copies), expected) > MAX_CHANCE_OF_COPIES:
            continue
        (first, second), n = copies[0], len(copies) - 1
        more = f", and {n} more of kind {kind}" if n else ""
        yield Finding(
            f"{second.label()} has the same names, value and σ as {first.label()}{more}",
            "remove one if the reading was copied: two of them make the result look more "
            "precise than it is",
        )


def observed_values(o: Observation) -> Array:
    """Return the observed values (q,); what has no value equals itself alone."""
    return np.atleast_1d(np.asarray(getattr(o, "value", np.nan), dtype=float)).ravel()


def _sorted(some: list[Observation]) -> list[Observation]:
    return sorted(some, key=lambda o: tuple(observed_values(o)))


def repetition_scatter(groups: list[Array]) -> float | None:
    """Return the standard deviation of repeated readings within their groups; none: all are equal.

    Copies are counted once, as they would make it smaller.
    """
    different = [np.unique(x, axis=0) for x in groups]
    number = sum((len(x) - 1) * x.shape[1] for x in different)
    if not number:
        return None
    return float(np.sqrt(sum(np.sum((x - x.mean(axis=0)) ** 2) for x in different) / number))


def chance_of_equal(o: Observation, step: float, scatter: float | None) -> float:
    """Return the probability with which a second reading equals this one; 0 if σ is not known.

    Of the stated σ and the scatter of repeated readings the smaller one counts: where the σ are
    stated too large, honest readings are equal more often than these say.
    """
    values = observed_values(o)
    known = [scatter] if scatter is not None else []
    if len(values) == 1:
        known.append(reading_sigma(o, float(abs(values[0]))))
    if not known:
        return 0.0
    s = min(known)
    return chance_of_equal_values(step, s) ** len(values)


def chance_of_equal_values(step: float, s: float) -> float:
    """Return p = u / (2 √π s) of two values of resolution u and standard deviation s, at most 1."""
    return min(1.0, step / (2.0 * sqrt(pi) * s)) if isfinite(s) and s > 0 else 1.0


def decimal_resolution(readings: Array) -> float:
    """Return the coarsest decimal step of readings, in metres, gon, degrees or seconds."""
    finite = readings[np.isfinite(readings)]
    tried = (
        u * m / 10.0**d
        for u in ROUNDING_UNITS
        for d in range(MAX_TRIED_DECIMALS)
        for m in (5.0, 2.0, 1.0)
    )
    fits = [s for s in tried if np.all(np.abs(finite / s - np.round(finite / s)) < STEP_ROUNDING)]
    return max([FINEST_RESOLUTION, *fits])


def _distances(network: Network) -> Iterator[Finding]:
    """The same distance with the same heights, and horizontal distances forth and back."""
    same: dict[tuple[object, ...], list[Sight]] = defaultdict(list)
    for o in of_quantities(network.observations.values(), *DISTANCE_QUANTITIES):
        if o.record.quantity == "horizontal distance":
            same["horizontal", *sorted((o.station, o.target))].append(o)
        else:
            ends = sorted(((o.station, o.instrument_height), (o.target, o.target_height)))
            same["slope", *ends].append(o)
    for group in same.values():
        values = np.array([o.value for o in group])
        # A reading of a monitoring station has thousands of others to be compared with: its σ is
        # computed once.
        sigmas = np.array([reading_sigma(o, o.value) for o in group])
        if np.ptp(values) <= TOLERANCE_IN_SIGMAS * np.sqrt(2.0) * sigmas.min():
            continue  # no two of them differ by more
        for i, a in enumerate(group):
            w = values[i] - values[i + 1 :]
            limit = TOLERANCE_IN_SIGMAS * np.hypot(sigmas[i], sigmas[i + 1 :])
            for j in np.flatnonzero(np.abs(w) > limit).tolist():
                yield Finding(
                    f"{a.label()} and {group[i + 1 + j].label()} differ",
                    "look for a wrong reading or name",
                    1e3 * float(w[j]),
                    1e3 * float(limit[j]),
                    "mm",
                )


def _elevations(network: Network) -> Iterator[tuple[Sight, float, float]]:
    """Iterate over vertical angles: a reading, the elevation in radians, and its σ as a part of σ.

    An index error that is unknown cancels in the mean of both faces of a sight, and explains any
    difference of readings in one face; so does a deflection of the vertical.
    """
    faces: dict[tuple[object, ...], list[Any]] = defaultdict(list)
    for o in of_quantities(network.observations.values(), *INCLINATION_QUANTITIES):
        if o.station in network.verticals:
            continue
        if o.record.quantity == "vertical angle":
            yield o, float(o.value), 1.0
        elif o.index_error is None:
            yield o, np.pi / 2 - o.in_face_one, 1.0
        else:
            sight = o.station, o.target, o.instrument_height, o.target_height, o.index_error
            faces[sight].append(o)
    for some in faces.values():
        first, second = ([o.in_face_one for o in some if o.face == face] for face in (1, 2))
        if first and second:
            mean = (np.mean(first) + np.mean(second)) / 2
            part = float(np.sqrt(1 / len(first) + 1 / len(second)) / 2)
            yield some[0], np.pi / 2 - float(mean), part


def _bends(network: Network, o: Observation) -> float:
    """Return c − κ of a sight, c = 1 if the frame has the curvature of the Earth, else 0.

    κ is that of its group where it is held or weighted, as field books state κ = k − 1 in a flat
    frame; otherwise k of standard air in a frame with curvature, and 0 in a flat one.
    """
    curvature = 1.0 if getattr(network.frame, "curvature", True) else 0.0
    group = getattr(o, "refraction", None) or REFRACTION_OF_THE_NETWORK
    stated = network.of_kind("refraction").get(group)
    if stated is None or not (all(stated.fixed) or np.isfinite(stated.sigma).all()):
        return curvature * (1.0 - REFRACTION_OF_HEIGHTS)
    return curvature - stated.values[0]


def _heights(network: Network) -> Iterator[Finding]:
    """Height differences and horizontal distances from zenith angles forth and back."""
    lengths: dict[tuple[str, str, float, float], float] = {}
    for o in of_quantities(network.observations.values(), "slope distance"):
        lengths[o.station, o.target, o.instrument_height, o.target_height] = o.value
    rises: dict[tuple[str, str], list[tuple[Observation, float, float, float]]] = defaultdict(list)
    for o, up, part in _elevations(network):
        s = lengths.get((o.station, o.target, o.instrument_height, o.target_height))
        if s is None:
            continue
        bend = (s * np.cos(up)) ** 2 / (2 * MEAN_EARTH_RADIUS)
        rise = s * np.sin(up) + _bends(network, o) * bend
        rise += o.instrument_height - o.target_height
        sigma = float(
            np.hypot(s * np.cos(up) * part * reading_sigma(o, s), SIGMA_OF_REFRACTION * bend)
        )
        rises[o.station, o.target].append((o, float(rise), sigma, s))
    for (a, b), there in rises.items():
        forth, sigmas = (np.array([each[k] for each in there]) for k in (1, 2))
        for back in rises.get((b, a), ()) if a < b else ():
            w = forth + back[1]
            limit = TOLERANCE_IN_SIGMAS * np.hypot(sigmas, back[2])
            for i in np.flatnonzero(np.abs(w) > limit).tolist():
                yield Finding(
                    f"the height differences of {there[i][0].label()} and {back[0].label()}, "
                    "forth and back, do not cancel",
                    "look for a wrong height of instrument or target, or zenith angle",
                    1e3 * float(w[i]),
                    1e3 * float(limit[i]),
                    "mm",
                )


ReadingKey = tuple[object, ...]
PlaceText = Callable[[str, Observation], str]
"""Says where a reading is, from its id and itself."""


@dataclass
class _Block:
    """Readings from ``first`` on that repeat those from ``earlier`` on; numbers of readings."""

    earlier: int
    first: int
    length: int
    values: int = 0
    """Number of observed values in it."""


@dataclass
class CopiedBlocks:
    """Readings in the order of their arrival, and the blocks of them that repeat earlier ones."""

    _readings: list[tuple[str, Observation]] = field(default_factory=list)
    _compared: int = 0
    """How many of them have been compared with earlier ones: not before somebody asks."""
    _numbers: dict[ReadingKey, list[int]] = field(default_factory=dict)
    _open: dict[int, _Block] = field(default_factory=dict)
    """Blocks that end at the latest reading, by the number of the earlier reading at their end."""
    _blocks: list[_Block] = field(default_factory=list)

    def add(self, readings: Iterable[tuple[str, Observation]]) -> CopiedBlocks:
        """Take further readings in, with their ids; return the same object."""
        self._readings += readings
        return self

    def _compare(self) -> None:
        """Compare with earlier readings what has come since."""
        for number in range(self._compared, len(self._readings)):
            key = _reading_key(self._readings[number][1])
            earlier = self._numbers.setdefault(key, [])
            going: dict[int, _Block] = {}
            for j in earlier:
                block = self._open.get(j - 1)
                if block is None:
                    block = _Block(j, number, 0)
                if j < block.first:  # what repeats itself is reported once
                    if block.values < MIN_COPIED_VALUES <= block.values + len(key) - 2:
                        self._blocks.append(block)
                    block.length += 1
                    block.values += len(key) - 2
                    going[j] = block
            self._open = going
            earlier.append(number)
            del earlier[:-MAX_EARLIER_READINGS]
        self._compared = len(self._readings)

    def told(
        self, there: Callable[[str], bool] = lambda _: True, place: PlaceText | None = None
    ) -> list[str]:
        """Return a sentence for each block of copies.

        Args:
            there: whether a reading is still in use, by its id.
            place: says where a reading is; none: its label says it.
        """
        self._compare()
        out, seen = [], set[int]()
        for block in self._blocks:
            mine = [
                k
                for k in range(block.length)
                if block.first + k not in seen and there(self._readings[block.first + k][0])
            ]
            values = sum(len(observed_values(self._readings[block.first + k][1])) for k in mine)
            if values < MIN_COPIED_VALUES or self._by_chance(block, mine):
                continue
            seen.update(block.first + k for k in mine)
            ends = [
                (place or _place_text)(*self._readings[at + k])
                for at in (block.first, block.earlier)
                for k in (mine[0], mine[-1])
            ]
            out.append(
                f"{len(mine)} readings in a row, {ends[0]} to {ends[1]}, repeat {ends[2]} to "
                f"{ends[3]} in all digits and in their order: if a file was read twice, leave one "
                "out, as copies make the result look more precise than it is"
            )
        return out

    def _by_chance(self, block: _Block, mine: list[int]) -> bool:
        """Return whether honest readings would repeat each other so."""
        kinds = {self._readings[block.first + k][1].kind for k in mine}
        of_kind = {kind: self._figures(kind) for kind in kinds}
        p = 1.0
        for k in mine:
            o = self._readings[block.first + k][1]
            step, scatter = of_kind[o.kind]
            if scatter is not None and scatter < MIN_SCATTER_STEPS * step:
                continue  # equal ones say nothing
            p *= chance_of_equal(o, step, scatter)
        return p * len(self._readings) > MAX_CHANCE_OF_COPIES

    def _figures(self, kind: str) -> tuple[float, float | None]:
        """Return resolution and scatter of the readings of a kind."""
        groups: dict[ReadingKey, list[np.ndarray]] = defaultdict(list)
        for _, o in self._readings:
            if o.kind == kind:
                groups[o.names()].append(observed_values(o))
        every = [np.array(some) for some in groups.values()]
        return decimal_resolution(np.concatenate([x.ravel() for x in every])), repetition_scatter(
            every
        )


def copied_blocks(network: Network) -> list[str]:
    """Return a sentence for each block of readings of a network that repeats an earlier one."""
    return CopiedBlocks().add(network.observations.items()).told()


def _place_text(ident: str, o: Observation) -> str:
    unknown = o.id is None and o.source is None
    return f"{o.label()} (id {ident})" if unknown else o.label()


def _reading_key(o: Observation) -> ReadingKey:
    """Return kind and names, and the observed values."""
    return (o.kind, o.names(), *observed_values(o).tolist())


def copied_returns(network: Network) -> list[str]:
    """Return a note on back readings that equal the forth ones in all digits; none: they do not.

    More lines than chance makes were computed, or copied, and count twice.
    """
    lines: dict[tuple[str, str], list[Sight]] = defaultdict(list)
    for o in of_quantities(network.observations.values(), "height difference"):
        if o.instrument_height == o.target_height == 0.0:
            lines[o.station, o.target].append(o)
    pairs = [
        (forth, back)
        for (a, b), some in lines.items()
        if a < b and len(some) == 1 and len(lines.get((b, a), ())) == 1
        for forth, back in zip(some, lines[b, a], strict=True)
    ]
    equal = [(forth, back) for forth, back in pairs if forth.value == -back.value]
    if len(equal) < MIN_EQUAL_RETURNS:
        return []
    step = decimal_resolution(np.concatenate([observed_values(o) for pair in pairs for o in pair]))
    expected = 0.0
    for forth, _ in pairs:
        ends = (np.array(network.points[n].coordinates) for n in (forth.station, forth.target))
        expected += chance_of_equal_values(step, line_sigma(forth, *ends))
    if poisson_upper_probability(len(equal), expected) > MAX_CHANCE_OF_COPIES:
        return []
    first, second = equal[0]
    return [
        f"{len(equal)} of {len(pairs)} lines that were levelled forth and back have the same value "
        f"with the other sign in all digits, the first {first.label()} and {second.label()}: if "
        "the back readings were copied, leave them out, as they make the result look more precise "
        "than it is"
    ]
