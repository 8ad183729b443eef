"""Result of a comparison of two epochs: displacements, tests, variance ratio, common scale.

A common scale s of the reference points of two free epochs is found with

    d = s r + noise,  s = rᵀWd/(rᵀWr),  T = s² rᵀWr,

with r from the middle of the points, in space or in plan, whichever fits better (levelled heights
have the scale of the staffs), and d and W of `factorgraph_adj.epochs.congruence_tests`. The
comparison itself is `factorgraph_adj.epochs.congruence`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Literal

import numpy as np

from ..columns import Columns
from ..errors import InputError, known
from ..network.network import Network
from ..quality.error_ellipses import ErrorEllipse, frame_ellipses
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..types import Array
from .congruence_tests import (
    HypothesisTest,
    LocalisationStep,
    UnitVariance,
    motion_basis,
    weight_of_differences,
)
from .differences import HELD_IN_ONE, Differences, PointRoles

MIN_OBSERVED_SCALE_PART = 1e-6
"""Part of r outside of the open motions below which no observation determines the scale."""
MAX_DISTANCE_OF_SAME_PLACE_M = 1e-5
"""Distance, metres, below which the coordinates of a point held in both epochs are the same: what
files with five decimals round."""
MIN_OPEN_PART = 1e-7
"""Part of an axis in an open direction below which the direction is across the axis."""


@dataclass(frozen=True)
class ScaleChange:
    """A common scale of the second epoch relative to the first."""

    value: float
    """The scale s: lengths of the second epoch are 1 + s times as long."""
    sigma: float
    """Its standard deviation."""
    test: HypothesisTest
    """Test of the hypothesis s = 0."""
    rest: HypothesisTest
    """Congruence test of the reference points once s is taken off."""
    in_plan: bool
    """Whether it is one of plan alone, which fits better than one of space."""

    @property
    def significant(self) -> bool:
        """Whether the epochs differ in scale, if nothing moved."""
        return not self.test.accepted

    def __str__(self) -> str:
        """Say how large it is."""
        return f"{1e6 * self.value:+.1f} ± {1e6 * self.sigma:.1f} ppm" + " in plan" * self.in_plan


def reference_scale_change(
    found: Differences, reference: Sequence[str], scale: UnitVariance, alpha: float
) -> ScaleChange | None:
    """Return the common scale of the reference points; none: nothing determines it.

    Args:
        found: the differences of the epochs.
        reference: the reference points.
        scale: variance of unit weight.
        alpha: probability of a false alarm of the tests.
    """
    if not reference or not found.motions.size:
        return None
    rows = found.rows(reference)
    numbers = [found.names.index(n) for n in reference]
    axes = ["xyz".index(a) for a in found.axes]
    places = found.places[numbers]
    r = places - places.mean(axis=0)
    up = found.frame.basis(places, np.zeros((len(places), 2))).enu[:, 2]
    flat = r - np.sum(r * up, axis=1, keepdims=True) * up
    g = motion_basis(found.motions[rows])
    w, d = weight_of_differences(found.cofactor[np.ix_(rows, rows)], g), found.d[rows]
    h = len(rows) - g.shape[1] - 1
    out = []
    for by, in_plan in ((r[:, axes].ravel(), False), (flat[:, axes].ravel(), True)):
        if np.linalg.norm(by - g @ (g.T @ by)) <= MIN_OBSERVED_SCALE_PART * np.linalg.norm(by):
            continue
        normal = float(by @ w @ by)
        s = float(by @ w @ d) / normal
        omega = s**2 * normal
        rest = max(float(d @ w @ d) - omega, 0.0)
        sigma = float(np.sqrt(scale.variance / normal))
        tests = scale.test(omega, 1, alpha), scale.test(rest, h, alpha)
        out.append(ScaleChange(s, sigma, *tests, in_plan))
    return min(out, key=lambda c: c.rest.value, default=None)


@dataclass(frozen=True)
class VarianceRatioTest:
    """Comparison of the variances of unit weight of two adjustments."""

    sigma0: tuple[float, float]
    """σ̂0 of the first and the second epoch."""
    redundancy: tuple[int, int]
    """Redundancies."""
    ratio: float
    """The larger variance divided by the smaller one."""
    critical: float
    """Critical value of the ratio, two-sided."""

    @property
    def accepted(self) -> bool:
        """Whether the epochs can have the same accuracy relative to their weights."""
        return self.ratio <= self.critical


@dataclass(frozen=True, eq=False)
class Displacement:
    """Displacement of a point against the points that stayed.

    A stable point is compared with the other stable points. These may be too few to hold every
    motion that the observations leave open; ``open`` then has the directions in which the point
    cannot be seen to move, and the rest is the part of the displacement across them.
    """

    name: str
    """Name in the first epoch."""
    stable: bool
    """Whether the point is one of the stable reference points."""
    place: Array
    """Coordinates of the first epoch, (3,) metres."""
    vector: Array
    """Displacement, (3,) metres; zero in coordinates that are not compared."""
    covariance: Array
    """Covariance of the displacement, (3, 3) metres², with the σ0² of the tests."""
    test: HypothesisTest
    """Test of the hypothesis that the point kept its place."""
    detectable: float
    """Smallest displacement that the test finds with the power asked for, in the direction in
    which it finds it hardest, metres."""
    hardest: Array
    """That direction, a unit vector (3,)."""
    open: Array
    """Directions in which the displacement is not determined, (3, m) unit vectors; m = 0 for all
    points but stable ones of a small reference. The detectable displacement is infinite then."""

    @property
    def moved(self) -> bool:
        """Whether the displacement is significant."""
        return not self.test.accepted

    @property
    def verdict(self) -> Literal["untested", "stable", "doubtful", "moved", "kept"]:
        """What the test says: nothing, if the point cannot be seen to move in any direction.

        A stable point whose own test rejects is doubtful.
        """
        if self.test.freedom[0] == 0:
            return "untested"
        if self.stable:
            return "doubtful" if self.moved else "stable"
        return "moved" if self.moved else "kept"

    @property
    def length(self) -> float:
        """Length of the displacement, metres."""
        return float(np.linalg.norm(self.vector))

    @property
    def sigmas(self) -> Array:
        """Standard deviations of the components, (3,) metres; infinite where they are open."""
        told = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return np.where(np.abs(self.open).max(axis=1, initial=0.0) > MIN_OPEN_PART, np.inf, told)


@dataclass(frozen=True, eq=False, repr=False)
class EpochComparison(Shown):
    """Result of the comparison of the coordinates of two epochs."""

    differences: Differences
    """What was compared."""
    ratio: VarianceRatioTest | None
    """Comparison of the two variances; None for both epochs in one adjustment."""
    scale: UnitVariance
    """Variance of unit weight of all tests."""
    roles: PointRoles
    """What each point is: reference, object, held, or not compared."""
    stable: tuple[str, ...]
    """Reference points that are taken as stable."""
    steps: tuple[LocalisationStep, ...]
    """The congruence tests of the reference points; empty without reference points."""
    displacements: Mapping[str, Displacement]
    """Displacement of every point by its name, reference points first."""
    joint: Array
    """Joint cofactors of the displacements of the points that are not stable, in the order of
    `displacements`, (n k, n k) metres²."""
    alpha: float
    """Probability of a false alarm of each test."""
    power: float
    """Power of the smallest detectable displacements."""
    scale_change: ScaleChange | None = None
    """A common scale of the reference points of free networks; none: nothing determines it."""

    @property
    def reference(self) -> tuple[str, ...]:
        """Reference points that were tested for their shape."""
        return self.roles.reference

    @property
    def held_apart(self) -> Mapping[str, float]:
        """Held points with other coordinates in the second epoch, and how far they are, metres.

        Points whose coordinates no open motion moves are compared: others have a datum of their
        own in each epoch.
        """
        if self.differences.motions.size:
            return {}
        axes = ["xyz".index(a) for a in self.differences.axes]
        apart = {n: float(np.linalg.norm(v[axes])) for n, v in self.roles.held.items()}
        return {n: size for n, size in apart.items() if size > MAX_DISTANCE_OF_SAME_PLACE_M}

    @property
    def held_in_one(self) -> Mapping[str, tuple[str, ...]]:
        """Points that one epoch alone holds, by the words for it: they cannot be compared."""
        found: dict[str, tuple[str, ...]] = {}
        for name, why in self.roles.not_compared.items():
            if why in HELD_IN_ONE:
                found[why] = (*found.get(why, ()), name)
        return found

    @property
    def fine(self) -> bool:
        """Whether variances agree, stable and held points fit, and both epochs hold the same."""
        fine = not self.held_apart and not self.held_in_one
        fine &= self.ratio is None or self.ratio.accepted
        # Points that all moved against one another leave no reference: another mistake may be why.
        return fine and (not self.steps or (bool(self.stable) and self.steps[-1].test.accepted))

    def ellipses(self, *, confidence: float | None = None) -> tuple[ErrorEllipse, ...]:
        """Return the ellipses of the displacements in plan, at the ends of their vectors.

        They lie in the horizon of each point. A displacement in plan is significant if and only if
        its beginning is outside of its ellipse with the confidence 1 − α of the tests.

        Args:
            confidence: probability of the ellipses; None: 1 − α of the tests.
        """
        every = list(self.displacements.values())
        return frame_ellipses(
            self.differences.frame,
            [(x.name, None) for x in every],
            np.array([x.place + x.vector for x in every]).reshape(-1, 3),
            np.array([x.covariance for x in every]).reshape(-1, 3, 3),
            1.0 - self.alpha if confidence is None else confidence,
            redundancy=None if np.isinf(self.scale.freedom) else int(self.scale.freedom),
        )

    @property
    def global_test(self) -> HypothesisTest | None:
        """Congruence test of all reference points; None without reference points."""
        return self.steps[0].test if self.steps else None

    @property
    def moved(self) -> tuple[str, ...]:
        """Names of the points whose displacement is significant, reference points first."""
        return tuple(n for n, x in self.displacements.items() if x.moved and not x.stable)

    def displacement(self, name: str) -> Displacement:
        """Return the displacement of a point.

        Raises:
            InputError: the point was not compared.
        """
        if name not in self.displacements:
            raise InputError(
                f"point {name!r} was not compared; known: {known(self.displacements, meant=name)}"
            )
        return self.displacements[name]

    def headline(self) -> str:
        """Return what moved."""
        points = f"{len(self.displacements)} points of two epochs"
        objects = f"{len(self.moved)} points moved"
        if self.global_test is None:
            return f"{points}: {objects}"
        same = "kept" if self.global_test.accepted else "changed"
        shape = f"{len(self.reference)} reference points {same} their shape"
        tested = len(self.stable) < len(self.displacements)
        return f"{points}: {shape}, {objects if tested else 'no objects were tested'}"

    def first_rows(self) -> Rows:
        """Return the first displacements."""
        rows = (
            (x.name, *(1000.0 * x.vector), x.test.value, x.test.critical, x.moved)
            for x in self.displacements.values()
        )
        header = ("point", "dx [mm]", "dy [mm]", "dz [mm]", "T", "critical", "moved")
        return Rows(header, rows, len(self.displacements))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Congruence(EpochComparison):
    """Result of the comparison of two epochs by their adjustments."""

    solutions: tuple[Solution, ...]
    """The adjustments: of the first and the second epoch, or of both in one."""
    alternatives: tuple[str, ...] = ()
    """Sentences on what may explain the differences instead of displacements."""

    @property
    def network(self) -> Network:
        """The network of the first epoch."""
        return self.solutions[0].network

    @property
    def fine(self) -> bool:
        """Whether the adjustments converged, variances agree, and stable and held points fit.

        Both epochs hold the same points, and nothing but displacements explains the differences as
        well, see `alternatives`.
        """
        converged = all(s.converged for s in self.solutions)
        return converged and not self.alternatives and super().fine

    def table(self) -> Columns:
        """Return the displacements as columns; metres."""
        # Reports are above this module.
        reports = import_module("factorgraph_adj.report.epochs_report")
        found: Columns = reports.displacement_frame(self)
        return found
