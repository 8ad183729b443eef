"""The test on arrival: how often it is wrong, how often right, and that its figures are exact.

A thousand trials are a thousand small networks with drawn errors. A hundred at a time lie side by
side without a common unknown: as independent as a hundred adjustments, and solved at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, chi2, kstest, norm

import factorgraph_adj as fga
from factorgraph_adj import IncrementalAdjustment, Network, Solution
from factorgraph_adj.ledger.verdicts import Verdict
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import (
    AnyObservation,
    ControlPoint,
    Correlated,
    Direction,
    HeightDifference,
    ImagePoint,
    Observation,
    PhotoPosition,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.quality.group_tests import noncentrality_of_group
from factorgraph_adj.quality.reliability import noncentrality
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC
from tests.networks.every_kind import GEOMETRIES, OBSERVED, sight_equations
from tests.networks.small_block import plan
from tests.support.predicted import of_the_group

pytestmark = pytest.mark.slow(
    "verdicts of many seeded arrivals and their frequencies; "
    "short tests compare single verdicts with the batch"
)

SIDE_BY_SIDE, PARTS = 100, 10
TRIALS = SIDE_BY_SIDE * PARTS
ALPHA = 0.05
"""Of false alarms: often enough to be counted."""
SMALL_ALPHA = 0.001
SIGMA_IMAGE = 0.005
"""Millimetres."""
AT_ONCE = 5
"""Networks into which an observation arrives at the same time."""
POWER = 0.80
SURE = 0.999
"""Probability of the bounds: a right program fails one of a thousand seeds."""
EXACT = 1e-6
"""Relative to each figure, or to σ."""
SMALL = 1e-4
"""Innovation relative to σ that leaves the network where it is: what is said before an arrival
then holds after it, second powers aside."""
LARGE = ("polynomial", "model_deformation", "mount", "size", "angle")
"""Kinds of unknowns that few observations determine badly, or not at all."""
CONTROL = {
    "A": (0.0, 0.0, 0.0),
    "B": (42.0, 3.0, 1.5),
    "C": (18.0, 36.0, -1.0),
    "D": (30.0, -5.0, 4.0),
    "E": (4.0, 25.0, 3.0),
    "F": (38.0, 30.0, 2.0),
}
"""Held points that all networks see: constants join nothing."""


# -- a thousand networks --------------------------------------------------------------------------


def _site() -> tuple[Network, Array]:
    network = Network("a hundred networks")
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz")
    rng = np.random.default_rng(3)
    return network, rng.uniform([10.0, 8.0, -2.0], [30.0, 25.0, 3.0], (SIDE_BY_SIDE, 2, 3))


def _total_stations() -> tuple[Network, list[AnyObservation]]:
    """A station resects itself and measures a target; a distance B to target arrives."""
    network, at = _site()
    for i in range(SIDE_BY_SIDE):
        s, t = f"S{i}", f"T{i}"
        network.add_point(s, at[i, 0])
        network.add_point(t, at[i, 1] + [0.0, 0.0, 2.5])
        network.set_orientation(s, value=0.5)
        for k, p in enumerate((*"ABC", t)):
            network.add(
                Direction(s, p, 0.0, sigma=10 * ARCSEC, id=f"r{i}.{k}"),
                SlopeDistance(s, p, 1.0, sigma=0.002, id=f"s{i}.{k}"),
                ZenithAngle(s, p, 1.5, sigma=15 * ARCSEC, id=f"z{i}.{k}"),
            )
    return network, [
        SlopeDistance("B", f"T{i}", 1.0, sigma=0.002, id=f"new{i}") for i in range(SIDE_BY_SIDE)
    ]


def _levelling() -> tuple[Network, list[AnyObservation]]:
    """Two new bench marks in a line; a third height difference arrives."""
    network, at = _site()
    for i in range(SIDE_BY_SIDE):
        for name, place in zip("HK", at[i], strict=True):
            network.add_point(f"{name}{i}", place, fixed="xy")
        network.add(
            HeightDifference("A", f"H{i}", 0.0, sigma=0.001, id=f"a{i}"),
            HeightDifference(f"H{i}", f"K{i}", 0.0, sigma=0.0015, id=f"b{i}"),
            HeightDifference(f"K{i}", "B", 0.0, sigma=0.001, id=f"c{i}"),
        )
    return network, [
        HeightDifference("C", f"K{i}", 0.0, sigma=0.0012, id=f"new{i}") for i in range(SIDE_BY_SIDE)
    ]


def _photos() -> tuple[Network, list[AnyObservation]]:
    """A photo resects itself, two held photos intersect a point; its image arrives."""
    network, at = _site()
    middle = np.array([20.0, 16.0, 1.0])
    network.add_camera("cam", NoDistortion(), {"c": 30.0})
    for name, place in (("L", (-10.0, -20.0, 12.0)), ("R", (50.0, -18.0, 14.0))):
        where = np.array(place)
        network.add_photo(name, "cam", position=place, rotation=look_at(where, middle), fixed=True)
    for i in range(SIDE_BY_SIDE):
        t, f = f"T{i}", f"F{i}"
        network.add_point(t, at[i, 0])
        where = np.array([15.0, 60.0, 15.0]) + at[i, 1] - middle
        network.add_photo(f, "cam", position=where, rotation=look_at(where, middle))
        for photo in "LR":
            network.add(ImagePoint(photo, t, 0.0, 0.0, sigma=SIGMA_IMAGE))
        for p in CONTROL:
            network.add(ImagePoint(f, p, 0.0, 0.0, sigma=SIGMA_IMAGE))
    return network, [
        ImagePoint(f"F{i}", f"T{i}", 0.0, 0.0, sigma=SIGMA_IMAGE) for i in range(SIDE_BY_SIDE)
    ]


NETWORKS = {"terrestrial": _total_stations, "levelling": _levelling, "image": _photos}


KINDS = [
    pytest.param(
        kind,
        marks=()
        if kind == "levelling"
        else pytest.mark.slow(
            "a thousand networks whose equations bend: that linear prediction is good enough for "
            "tests of directions and rays; levelling is linear"
        ),
    )
    for kind in NETWORKS
]


@cache
def solved(kind: str, part: int) -> tuple[Network, Solution, tuple[AnyObservation, ...]]:
    """Return a hundred measured networks, their solution, and what arrives."""
    plan, arriving = NETWORKS[kind]()
    plan.add(*arriving)
    ids = [o.id or f"{o.photo}/{o.point}" for o in arriving]
    measured = measure(plan, seed=part)
    network = fga.without(measured, ids)
    by_id = {f"{o.photo}/{o.point}": o for o in measured.image_points()} | measured.observations
    return network, fga.adjust(network), tuple(by_id[i] for i in ids)


def verdicts(
    kind: str, part: int, arriving: Sequence[AnyObservation], alpha: float
) -> list[Verdict]:
    network, solution, _ = solved(kind, part)
    inc = IncrementalAdjustment(network, start=solution, alpha=alpha)
    out: list[Verdict] = []
    for first in range(0, SIDE_BY_SIDE, AT_ONCE):
        out += inc.add(arriving[first : first + AT_ONCE]).verdicts
    return out


@cache
def verdicts_of_good_ones(kind: str) -> tuple[Verdict, ...]:
    found = (verdicts(kind, part, solved(kind, part)[2], ALPHA) for part in range(PARTS))
    return tuple(v for part in found for v in part)


@pytest.mark.parametrize("kind", KINDS)
def test_good_observations_are_suspect_as_often_as_alpha_says(kind):
    found = verdicts_of_good_ones(kind)
    suspects = sum(v.verdict == "suspect" for v in found)
    low, high = binom.interval(SURE, TRIALS, ALPHA)
    assert low <= suspects <= high
    assert suspects == sum(v.test > 1 for v in found)


@pytest.mark.parametrize("kind", KINDS)
def test_test_values_of_good_observations_have_the_distribution_that_is_claimed(kind):
    """So that false alarms are right for every α: T² is χ², every w normal."""
    found = verdicts_of_good_ones(kind)
    w = np.array([v.w for v in found])
    t2 = np.array([v.t2 for v in found])
    assert {v.dof for v in found} == {2 if kind == "image" else 1}
    assert kstest(t2, chi2(found[0].dof).cdf).pvalue > 1 - SURE
    for component in w.T:
        assert kstest(component, norm.cdf).pvalue > 1 - SURE


def with_errors(kind: str, part: int) -> list[AnyObservation]:
    """Return what arrives, with errors of the smallest detectable size and both signs."""
    _, solution, arriving = solved(kind, part)
    before = fga.predict(solution, list(arriving))
    wrong: list[AnyObservation] = []
    if kind == "image":
        r = before.redundancy_numbers.reshape(-1, 2)
        size = np.sqrt(noncentrality_of_group(SMALL_ALPHA, POWER, 2) / r) * SIGMA_IMAGE
        for i, (o, by) in enumerate(zip(arriving, size.tolist(), strict=True)):
            assert isinstance(o, ImagePoint)
            wrong.append(replace(o, x=o.x + by[0]) if i % 2 else replace(o, y=o.y - by[1]))
    else:
        size = noncentrality(SMALL_ALPHA, POWER) * before.sigma
        for i, (o, by) in enumerate(zip(arriving, size.tolist(), strict=True)):
            value: float = o.value  # type: ignore[union-attr]
            wrong.append(replace(o, value=value + (by if i % 2 else -by)))  # type: ignore[call-arg]
    return wrong


@pytest.mark.parametrize("kind", KINDS)
def test_errors_of_the_smallest_detectable_size_are_caught_at_their_power(kind):
    """∇ = δ0 σ of the innovation; of two components ∇ᵀD⁻¹∇ = λ0, where D⁻¹ = Σ⁻¹ R.

    For so small an α the other tail of the two-sided test adds nothing.
    """
    caught = 0
    for part in range(PARTS):
        found = verdicts(kind, part, with_errors(kind, part), SMALL_ALPHA)
        caught += sum(v.verdict == "suspect" for v in found)
    low, high = binom.interval(SURE, TRIALS, POWER)
    assert low <= caught <= high


# -- the figures of a verdict ---------------------------------------------------------------------


@cache
def every_sight(frame: str) -> tuple[Network, Network]:
    """Return a network with every kind of observation, measured, and the same repeated."""
    equations, _ = sight_equations(frame, GEOMETRIES["ordinary"])
    plan = equations.network
    for name, p in plan.points.items():
        plan.add(ControlPoint(name, p.coordinates, sigma=(0.02, 0.03, 0.04), id=f"held {name}"))
    plan.add(Direction("i", "j", 0.0, sigma=0.001), Direction("i", "k", 0.0, sigma=0.001))
    for name, vertical in plan.verticals.items():
        plan.verticals[name] = replace(vertical, sigma=(1e-4, 1e-4))
    for name, body in plan.frames.items():
        plan.frames[name] = replace(body, sigma=(*(1e-4,) * 3, *(0.01,) * 3, 1e-5))
    size = {"length": 0.01, "angle": 1e-4, "ppm": 1e-5}
    for record in (
        r
        for r in UNKNOWNS.values()
        if r.on_earth or r.name in (*LARGE, "heading", "arc", "point_motion")
    ):
        for name, given in plan.of_kind(record.name).items():
            sigma = tuple(size.get(c.quantity, 0.01) for c in record.components)
            plan.of_kind(record.name)[name] = replace(given, sigma=sigma[: len(given.values)])
    return measure(plan, seed=1), measure(plan, seed=2)


@cache
def sights_of(kind: str) -> Network:
    """Return the topocentric one with observations of one kind, and of those that all have.

    Every other kind bends by itself, and the adjustment of all of them takes 20 iterations.
    """
    measured, _ = every_sight("topocentric")
    kept = {kind, *IN_OTHERS, *DISTANCES}
    others = [i for i, o in measured.observations.items() if o.kind not in kept]
    return fga.without(measured, [i for i in others if not i.startswith("held")])


@cache
def every_image() -> tuple[Network, Network]:
    """Return a block with image coordinates, positions of photos and sights; and repeated."""
    block = plan()
    lever = (0.1, -0.05, 0.1)
    for f in block.photos:
        block.add(PhotoPosition(f, (0.0,) * 3, sigma=(0.01, 0.02, 0.03), lever_arm=lever))
    return measure(block, seed=1), measure(block, seed=2)


@cache
def at_rest(network: str) -> tuple[Network, Solution]:
    """Return a network and its solution: the block, a frame, or a frame and a kind."""
    frame, _, kind = network.partition(", ")
    if kind:
        measured = sights_of(kind)
    else:
        measured, _ = every_image() if network == "block" else every_sight(frame)
    return measured, fga.adjust(measured, tolerance=1e-10)


@cache
def settled(network: str) -> IncrementalAdjustment:
    """Return an adjustment of a network, at rest, which only its copies change."""
    measured, solution = at_rest(network)
    inc = IncrementalAdjustment(measured, start=solution, policy="accept")
    inc.settle()
    return inc


def fresh(network: str) -> IncrementalAdjustment:
    """Return an adjustment of a network, at rest: its state is a value, which a copy shares."""
    return copy(settled(network))


def repeated(network: str, kind: str) -> list[AnyObservation]:
    """Return the observations of a kind, measured a second time."""
    _, again = every_image() if network == "block" else every_sight(network)
    return [
        replace(o, id=f"again {i}")  # type: ignore[call-arg,misc]
        for i, o in again.observations.items()
        if o.kind == kind and not i.startswith("held")
    ]


def nearer(o: Any, innovation: Array, sigma: Array) -> Any:
    """Return an observation that is all but what is expected."""
    by = innovation - SMALL * sigma
    if isinstance(o, ImagePoint):
        return replace(o, x=o.x + float(by[0]), y=o.y + float(by[1]))
    if isinstance(o, ControlPoint) and len(o.value) > len(by):
        return None  # its position is geocentric, its axes are of the horizon
    value = np.atleast_1d(np.asarray(o.value, dtype=float)) + by
    return replace(
        o, value=tuple(value.tolist()) if isinstance(o.value, tuple) else float(value[0])
    )


def members(item: AnyObservation) -> tuple[Observation, ...]:
    return item.observations if isinstance(item, Correlated) else (item,)


def assert_verdict_is_exact(network: str, item: AnyObservation) -> None:
    """What a verdict says is the prediction before, and the reliability after."""
    inc = fresh(network)
    before = inc.solution()
    expected = fga.predict(before, item)
    w, r, t2 = expected.w, expected.redundancy_numbers, expected.t2[0]
    if isinstance(item, Correlated):  # predicted one by one; a verdict is about all of them
        w, r, t2 = of_the_group(before, expected)
    found = inc.add(item).verdicts
    assert [v.id for v in found] == list(expected.ids)
    for n, v in enumerate(found):
        part = expected.components(n)
        scale = expected.sigma[part]
        assert v.verdict == "accepted" and v.controlled
        assert v.w == pytest.approx(w[part], rel=EXACT, abs=EXACT)
        assert v.redundancy_numbers == pytest.approx(r[part], abs=EXACT)
        assert v.t2 == pytest.approx(t2, rel=EXACT, abs=EXACT)
        assert v.dof == len(w)
        assert v.innovation / scale == pytest.approx(expected.innovation[part] / scale, abs=EXACT)
        assert v.sigma == pytest.approx(scale, rel=EXACT)
        for gain in v.gains:
            sigma = before.standard_deviations(gain.point)
            assert gain.before == pytest.approx(sigma, rel=EXACT, abs=1e-9)
    # Once more, so near to what is expected that the network stays where it is.
    near = tuple(
        nearer(o, expected.innovation[part], expected.sigma[part])
        for o, part in zip(members(item), map(expected.components, range(len(found))), strict=True)
    )
    if None in near:
        return
    inc = fresh(network)
    found = inc.add(Correlated(near, item.covariance) if isinstance(item, Correlated) else near[0])
    after = fga.adjust(inc.network(), start=inc.solution(), tolerance=1e-8)
    rel = fga.reliability(after)
    for v in found.verdicts:
        rows = after.equations.find([v.id])[0]
        assert v.redundancy_numbers == pytest.approx(rel.redundancy_numbers[rows], abs=EXACT)
        assert v.w == pytest.approx(rel.w[rows], abs=EXACT)
        assert v.gains or not any(o.points() for o in members(item))
        for gain in v.gains:
            sigma = after.standard_deviations(gain.point)
            assert gain.after == pytest.approx(sigma, rel=EXACT, abs=1e-12)
            assert np.all(gain.after <= gain.before * (1 + EXACT))


OTHER = pytest.mark.slow("shows in other frames that verdicts do not look at the frame")
REST = pytest.mark.slow("shows it for every other kind, each by its own partials")
OTHERS = ("flat", "curved", "geocentric")
IN_OTHERS = ("direction", "zenith_angle", "gnss_vector", "astronomic_latitude", "frame_coordinate")
"""Kinds that are compared among all others, and in other frames too: the network is the same."""
DISTANCES = ("slope_distance", "horizontal_distance")
"""Kinds that only together determine the constants of the distance meter."""
KINDS_OF_POINTS = [k for k, make in OBSERVED.items() if any(not o.photos() for o in make())]


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        *(("topocentric", k) for k in KINDS_OF_POINTS if k in IN_OTHERS),
        *(
            pytest.param("topocentric", k, marks=REST)
            for k in KINDS_OF_POINTS
            if k not in IN_OTHERS
        ),
        *(pytest.param(f, k, marks=OTHER) for f in OTHERS for k in IN_OTHERS),
    ],
)
def test_the_verdict_of_a_sight_is_its_prediction_and_its_reliability(frame, kind):
    found = repeated(frame, kind)
    if not found:  # there is no ellipsoid
        assert kind.startswith("astronomic") and frame in ("flat", "curved")
        return
    among_all = frame != "topocentric" or kind in IN_OTHERS
    assert_verdict_is_exact(frame if among_all else f"{frame}, {kind}", found[0])


@pytest.mark.parametrize("number", [0, 17, 40])
def test_the_verdict_of_an_image_point_is_its_prediction_and_its_reliability(number):
    """The point is measured in a photo from which it had been taken out."""
    measured, _ = every_image()
    o = list(measured.image_points())[number]
    network = fga.without(measured, [f"{o.photo}/{o.point}"])
    solution = fga.adjust(network, tolerance=1e-10)
    inc = IncrementalAdjustment(network, start=solution, policy="accept")
    inc.settle()
    before = inc.solution()
    p = fga.predict(before, o)
    v = inc.add(o).verdicts[0]
    assert v.innovation / p.sigma == pytest.approx(p.innovation / p.sigma, abs=EXACT)
    assert v.sigma == pytest.approx(p.sigma, rel=EXACT)
    assert v.w == pytest.approx(p.w, rel=EXACT, abs=EXACT)
    assert v.t2 == pytest.approx(p.t2[0], rel=EXACT)
    inc = IncrementalAdjustment(network, start=solution, policy="accept")
    inc.settle()
    near = nearer(o, p.innovation, p.sigma)  # but for distortion
    p = fga.predict(before, near)
    v = inc.add(nearer(near, p.innovation, p.sigma)).verdicts[0]
    inc.settle()
    after = inc.solution()
    rel = fga.reliability(after)
    rows = after.equations.find([v.id])[0]
    assert v.redundancy_numbers == pytest.approx(rel.redundancy_numbers[rows], abs=EXACT)
    assert v.w == pytest.approx(rel.w[rows], abs=EXACT)
    assert [g.point for g in v.gains] == [o.point]
    for gain in v.gains:
        assert gain.after == pytest.approx(after.standard_deviations(gain.point), rel=EXACT)
        assert gain.before == pytest.approx(before.standard_deviations(gain.point), rel=EXACT)


def test_the_verdict_of_the_position_of_a_photo_is_its_prediction_and_its_reliability():
    for o in repeated("block", "photo_position")[:2]:
        inc = fresh("block")
        before = inc.solution()
        p = fga.predict(before, o)
        v = inc.add(o).verdicts[0]
        assert v.innovation / p.sigma == pytest.approx(p.innovation / p.sigma, abs=EXACT)
        assert v.w == pytest.approx(p.w, rel=EXACT, abs=EXACT)
        assert v.redundancy_numbers == pytest.approx(p.redundancy_numbers, abs=EXACT)
        assert v.t2 == pytest.approx(p.t2[0], rel=EXACT)
        assert v.gains == ()  # it touches no point


@pytest.mark.parametrize("frame", ["flat", "geocentric"])
def test_the_verdicts_of_a_correlated_group_are_their_predictions_and_reliability(frame):
    """A GNSS vector, a height difference and a distance, all correlated."""
    o = [repeated(frame, k)[0] for k in ("gnss_vector", "height_difference", "slope_distance")]
    sigma = np.array([2.0, 1.7, 2.2, 0.01, 0.01])
    rho = 0.4 * np.ones((5, 5)) + 0.6 * np.eye(5)
    assert_verdict_is_exact(frame, Correlated(tuple(o), rho * np.outer(sigma, sigma)))  # type: ignore[arg-type]
