"""Kinds that the package does not know: a similarity, a trend, and observations that use them.

Two groups of points, such as the same marks in two epochs, are joined by an unknown similarity
X_b = e^λ R X_a + t. A trend is a polynomial of time whose degree each instrument chooses.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.frames import Frame
from factorgraph_adj.models.base import Linearised
from factorgraph_adj.models.datum_motions import Motions
from factorgraph_adj.models.unknown_registry import UNKNOWNS, Component, UnknownKind, UnknownTable
from factorgraph_adj.observations import (
    KINDS,
    HeightDifference,
    Observation,
    ObservationKind,
    SlopeDistance,
    VectorObservation,
)
from factorgraph_adj.observations.base import Sigma
from factorgraph_adj.observations.built_in_kinds import register_modules
from factorgraph_adj.observations.variances import LENGTHS
from factorgraph_adj.rotation import exp_rotation, log_rotation, skew
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array, Index

# -- a similarity ---------------------------------------------------------------------------------


def similarity_motions(motions: Motions, values: Array, at: Index) -> Array:
    """Return how S follows when both groups move with the object: S' = G S G⁻¹, (n, 7, 7)."""
    rotation, shift = values[:, :9].reshape(-1, 3, 3), values[:, 9:12]
    grown = np.exp(values[:, 12])[:, None, None] * rotation
    # What the motion does to the origin, and to where the similarity puts it.
    origin = motions.of_places(np.zeros_like(shift))
    out = np.zeros((len(values), 7, 7))
    out[:, :3] = rotation.transpose(0, 2, 1) @ motions.turn - motions.turn
    out[:, 3:6] = motions.of_places(shift) - grown @ origin
    return out


SIMILARITY = UnknownKind(
    "similarity",
    "similarity",
    "S",
    (
        *(Component(f"r{a}", "angle") for a in "xyz"),
        *(Component(f"t{a}", "length") for a in "xyz"),
        Component("ln_scale", "ppm"),
    ),
    rotates=True,
    motions=similarity_motions,
    connects=True,
    late=1,
    table=UnknownTable("similarities"),
)


@dataclass(frozen=True)
class SamePoint(VectorObservation):
    """The difference e^λ R X_a + t − X_b of one mark in two groups of points, metres."""

    kind: ClassVar[str] = "same_point"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    original: str
    """The mark in the first group, a."""
    moved: str
    """The mark in the second group, b."""
    similarity: str
    """Name of the similarity."""
    value: tuple[float, float, float]
    """Observed difference, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres."""


def same_point(
    frame: Frame, original: Array, similarity: Array, moved: Array, *, observed: Array
) -> Linearised:
    """Compute e^λ R X_a + t − X_b − observed, metres, (n, 3)."""
    grown = np.exp(similarity[:, 12])[:, None, None] * similarity[:, :9].reshape(-1, 3, 3)
    there = np.einsum("nij,nj->ni", grown, original)
    by_similarity = np.zeros((len(original), 3, 7))
    by_similarity[:, :, :3] = -grown @ skew(original)
    by_similarity[:, :, 3:6] = np.eye(3)
    by_similarity[:, :, 6] = there
    minus = np.broadcast_to(-np.eye(3), grown.shape)
    return Linearised(there + similarity[:, 9:12] - moved - observed, (grown, by_similarity, minus))


SAME_POINT = ObservationKind(
    SamePoint,
    (("point", "original"), ("similarity", "similarity"), ("point", "moved")),
    same_point,
)


@dataclass(frozen=True)
class MovedDistance(Observation):
    """The distance |e^λ R X_a + t − X_b| of a mark, once moved, from a mark of the second group."""

    kind: ClassVar[str] = "moved_distance"
    original: str
    """The mark in the first group, a."""
    moved: str
    """The mark in the second group, b."""
    similarity: str
    """Name of the similarity."""
    value: float
    """Observed distance, metres."""
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation."""


def moved_distance(
    frame: Frame, original: Array, similarity: Array, moved: Array, *, observed: Array
) -> Linearised:
    """Compute |e^λ R X_a + t − X_b| − observed, metres, (n, 1)."""
    d, partials = same_point(frame, original, similarity, moved, observed=np.zeros((1, 3)))
    length = np.linalg.norm(d, axis=1, keepdims=True)
    along = (d / length)[:, None, :]
    return Linearised(length - observed, tuple(along @ p for p in partials))


MOVED_DISTANCE = ObservationKind(
    MovedDistance, SAME_POINT.variables, moved_distance, weight=LENGTHS
)

# -- a trend of unknown degree --------------------------------------------------------------------

DEGREES = 6
TREND = UnknownKind(
    "trend",
    "trend of level",
    "T",
    tuple(Component(f"a{i}", "length") for i in range(DEGREES)),
    variable_size=True,
    late=2,
    table=UnknownTable("trends"),
    titles={"de": "Gang des Nivelliers"},
)


@dataclass(frozen=True)
class DriftingStep(Observation):
    """A height difference with a drift: z_b − z_a + Σ a_i τ^i, metres."""

    kind: ClassVar[str] = "drifting_step"
    station: str
    """From, a."""
    target: str
    """To, b."""
    value: float
    """Observed difference, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""
    trend: str
    """Name of the trend."""
    time: float = field(metadata={"quantity": "number"})
    """Time τ, a plain number."""


def drifting_step(
    frame: Frame, station: Array, target: Array, trend: Array, *, observed: Array, time: Array
) -> Linearised:
    """Compute z_b − z_a + Σ a_i τ^i − observed, metres, (n, 1)."""
    powers = time[:, None] ** np.arange(trend.shape[1])
    up = np.broadcast_to([[[0.0, 0.0, 1.0]]], (len(time), 1, 3))
    v = (target - station)[:, 2:] + np.sum(powers * trend, axis=1, keepdims=True) - observed
    return Linearised(v, (-up, up, powers[:, None, :]))


DRIFTING_STEP = ObservationKind(
    DriftingStep,
    (("point", "station"), ("point", "target"), ("trend", "trend")),
    drifting_step,
    ("time",),
    linear=True,
    titles={"de": "Höhenunterschied mit Gang"},
)


UNKNOWNS_IN_MODULE = (SIMILARITY, TREND)
KINDS_IN_MODULE = (SAME_POINT, MOVED_DISTANCE, DRIFTING_STEP)


@contextmanager
def registered() -> Iterator[None]:
    """Let the package know these kinds for a while."""
    assert tuple(register_modules([__name__])) == KINDS_IN_MODULE
    try:
        yield
    finally:
        for kind in UNKNOWNS_IN_MODULE:
            del UNKNOWNS[kind.name]
        for observed in KINDS_IN_MODULE:
            del KINDS[observed.name]


# -- networks -------------------------------------------------------------------------------------

MARKS = np.array(
    [
        *([0.0, 0.0, 0.0], [40.0, 3.0, 2.0], [35.0, 30.0, -3.0], [2.0, 33.0, 4.0]),
        *([18.0, 15.0, 9.0], [22.0, -8.0, 6.0]),
    ]
)
TURN = np.array([0.02, -0.03, 0.4])
SHIFT = np.array([3.0, -2.0, 1.0])
LN_SCALE = 4e-5
TRUE = np.array([*TURN, *SHIFT, LN_SCALE])
START = TRUE + np.array([2e-3, -1e-3, 3e-3, 0.02, -0.01, 0.03, -4e-5])


def two_epochs(
    *, datum: str = "given", similarity: dict[str, object] | None = None, seed: int = 1
) -> fga.Network:
    """Return a network of distances over two groups of marks that a similarity joins.

    Args:
        datum: ``given`` holds three marks of the first group, ``free`` none.
        similarity: further arguments of the unknown: ``fixed`` and ``sigma``.
        seed: seed of the errors.
    """
    network = fga.Network("two epochs", datum=datum)  # type: ignore[arg-type]
    moved = np.exp(LN_SCALE) * MARKS @ exp_rotation(TURN[None])[0].T + SHIFT
    held = {"A0": "xyz", "A1": "yz", "A3": "z"} if datum == "given" else {}
    for group, places in (("A", MARKS), ("B", moved)):
        for i, x in enumerate(places):
            network.add_point(f"{group}{i}", x, fixed=held.get(f"{group}{i}", ""))
    network.set_unknown("similarity", "shift", TRUE)
    names = list(network.points)
    for i, a in enumerate(names):
        for b in names[i + 1 :: 2 if a[0] == "A" else 1]:
            network.add(SlopeDistance(a, b, 1.0, sigma=0.002))
    sigma = fga.StandardDeviation(0.002, ppm=10)
    for i in range(len(MARKS)):
        for j in range(i + 1, len(MARKS)):
            network.add(MovedDistance(f"A{i}", f"B{j}", "shift", 1.0, sigma=sigma))
        if datum == "given":  # a difference in the axes of the network has a direction
            network.add(SamePoint(f"A{i}", f"B{i}", "shift", (0.0, 0.0, 0.0), sigma=(0.003,) * 3))
    network = measure(network, seed=seed)
    network.set_unknown("similarity", "shift", START, **(similarity or {}))  # type: ignore[arg-type]
    return network


def drifting_levels(seed: int = 1) -> fga.Network:
    """Return a levelling network with drifts of degree one and two."""
    network = fga.Network("drifting levels")
    heights = (100.0, 101.5, 99.2, 103.1)
    for i, z in enumerate(heights):
        network.add_point(f"P{i}", (10.0 * i, 0.0, z), fixed="xyz" if i == 0 else "xy")
    network.set_unknown("trend", "old", (0.002, -0.004))
    network.set_unknown("trend", "new", (0.001, 0.003, -0.002))
    for k in range(24):
        i, j = k % 4, (k + 1 + k // 8) % 4
        if i == j:
            continue
        trend = "old" if k % 2 else "new"
        network.add(
            DriftingStep(f"P{i}", f"P{j}", 0.0, sigma=3e-4, trend=trend, time=k / 8.0 - 1.0),
            HeightDifference(f"P{i}", f"P{j}", 0.0, sigma=5e-4),
        )
    return measure(network, seed=seed)


def given_of(stored: Array) -> Array:
    """Return rotation vector, shift and ln scale of a stored similarity."""
    turn = log_rotation(stored[:9].reshape(1, 3, 3))[0]
    return np.concatenate([turn, stored[9:]])
