"""The test on arrival: how often it is wrong, how often right, and that its figures are exact.

A thousand trials are a thousand small networks side by side, with drawn errors and no common
unknown: as independent as a thousand adjustments, and solved at once.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from every_kind import FRAMES, GEOMETRIES, OBSERVED, sight_equations
from scipy.stats import binom, chi2, kstest, norm

import factorgraph_adj as fga
from factorgraph_adj import IncrementalAdjustment, Network, Solution
from factorgraph_adj.experiment.simulate import look_at, measure
from factorgraph_adj.incremental.adjustment import Arrival
from factorgraph_adj.incremental.verdicts import Policy, Verdict
from factorgraph_adj.models.lens import NoDistortion
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
from factorgraph_adj.quality.groups import noncentrality_of_group
from factorgraph_adj.quality.reliability import noncentrality
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC

TRIALS = 1000
AT_ONCE = 25
"""Networks into which an observation arrives at the same time."""
POWER = 0.80
SURE = 0.999
"""Probability of the bounds: a right program fails one of a thousand seeds."""
EXACT = 1e-6
"""Relative to each figure, or to σ."""
SMALL = 1e-3
"""Innovation relative to σ that leaves the network where it is: what is said before an arrival
then holds after it, second powers aside."""
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
    network = Network("a thousand networks")
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz")
    rng = np.random.default_rng(3)
    return network, rng.uniform([10.0, 8.0, -2.0], [30.0, 25.0, 3.0], (TRIALS, 2, 3))


def _total_stations() -> tuple[Network, list[AnyObservation]]:
    """A station resects itself and measures a target; a distance B to target arrives."""
    network, at = _site()
    for i in range(TRIALS):
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
    return network, [SlopeDistance("B", f"T{i}", 1.0, sigma=0.002, id=f"new{i}") for i in range(TRIALS)]


def _levelling() -> tuple[Network, list[AnyObservation]]:
    """Two new bench marks in a line; a third height difference arrives."""
    network, at = _site()
    for i in range(TRIALS):
        for name, place in zip("HK", at[i], strict=True):
            network.add_point(f"{name}{i}", place, fixed="xy")
        network.add(
            HeightDifference("A", f"H{i}", 0.0, sigma=0.001, id=f"a{i}"),
            HeightDifference(f"H{i}", f"K{i}", 0.0, sigma=0.0015, id=f"b{i}"),
            HeightDifference(f"K{i}", "B", 0.0, sigma=0.001, id=f"c{i}"),
        )
    return network, [
        HeightDifference("C", f"K{i}", 0.0, sigma=0.0012, id=f"new{i}") for i in range(TRIALS)
    ]


def _photos() -> tuple[Network, list[AnyObservation]]:
    """A photo resects itself, two held photos intersect a point; its image arrives."""
    network, at = _site()
    middle = np.array([20.0, 16.0, 1.0])
    network.add_camera("cam", NoDistortion(), {"c": 30.0})
    for name, place in (("L", (-10.0, -20.0, 12.0)), ("R", (50.0, -18.0, 14.0))):
        where = np.array(place)
        network.add_photo(
            name, "cam", position=place, rotation=look_at(where, middle), fixed=True
        )
    for i in range(TRIALS):
        t, f = f"T{i}", f"F{i}"
        network.add_point(t, at[i, 0])
        where = np.array([15.0, 60.0, 15.0]) + at[i, 1] - middle
        network.add_photo(f, "cam", position=where, rotation=look_at(where, middle))
        for photo in "LR":
            network.add(ImagePoint(photo, t, 0.0, 0.0, sigma=0.005))
        for p in CONTROL:
            network.add(ImagePoint(f, p, 0.0, 0.0, sigma=0.005))
    return network, [ImagePoint(f"F{i}", f"T{i}", 0.0, 0.0, sigma=0.005) for i in range(TRIALS)]


NETWORKS = {"terrestrial": _total_stations, "levelling": _levelling, "image": _photos}


@cache
def solved(kind: str) -> tuple[Network, Solution, tuple[AnyObservation, ...]]:
    """Return measured networks, their solution, and what arrives."""
    plan, arriving = NETWORKS[kind]()
    plan.add(*arriving)
    ids = [o.id or f"{o.photo}/{o.point}" for o in arriving]
    measured = measure(plan, seed=len(kind))
    network = fga.without(measured, ids)
    by_id = {f"{o.photo}/{o.point}": o for o in measured.image_points()} | measured.observations
    return network, fga.adjust(network), tuple(by_id[i] for i in ids)


def verdicts(kind: str, arriving: list[AnyObservation], alpha: float) -> list[Verdict]:
    network, solution, _ = solved(kind)
    inc = IncrementalAdjustment(network, start=solution, alpha=alpha)
    out: list[Verdict] = []
    for first in range(0, TRIALS, AT_ONCE):
        out += inc.add(arriving[first : first + AT_ONCE]).verdicts
    return out


@pytest.mark.parametrize("kind", NETWORKS)
@pytest.mark.parametrize("alpha", [0.05, 0.01])
def test_good_observations_are_suspect_as_often_as_alpha_says(kind, alpha):
    found = verdicts(kind, list(solved(kind)[2]), alpha)
    suspects = sum(v.verdict == "suspect" for v in found)
    low, high = binom.interval(SURE, TRIALS, alpha)
    assert low <= suspects <= high
    assert suspects == sum(v.test > 1 for v in found)


@pytest.mark.parametrize("kind", NETWORKS)
def test_test_values_of_good_observations_have_the_distribution_that_is_claimed(kind):
    found = verdicts(kind, list(solved(kind)[2]), 0.001)
    w = np.array([v.w for v in found])
    t2 = np.array([v.t2 for v in found])
    assert {v.dof for v in found} == {2 if kind == "image" else 1}
    assert kstest(t2, chi2(found[0].dof).cdf).pvalue > 1 - SURE
    for component in w.T:
        assert kstest(component, norm.cdf).pvalue > 1 - SURE


@pytest.mark.parametrize("kind", NETWORKS)
@pytest.mark.parametrize("alpha", [0.05, 0.001])
def test_errors_of_the_smallest_detectable_size_are_caught_at_the_power_they_are_defined_by(
    kind, alpha
):
    """∇ = δ0 σ of the innovation; of two components ∇ᵀD⁻¹∇ = λ0, and D⁻¹ = Σ⁻¹ R.

    For small α the other tail of the two-sided test adds nothing: power is 80 % exactly.
    """
    _, solution, arriving = solved(kind)
    wrong: list[AnyObservation] = []
    if kind == "image":
        r = fga.predict(solution, list(arriving)).redundancy_numbers.reshape(-1, 2)
        size = np.sqrt(noncentrality_of_group(alpha, POWER, 2) / r) * 0.005
        for i, (o, by) in enumerate(zip(arriving, size.tolist(), strict=True)):
            assert isinstance(o, ImagePoint)
            wrong.append(replace(o, x=o.x + by[0]) if i % 2 else replace(o, y=o.y - by[1]))
    else:
        sigma = fga.predict(solution, list(arriving)).sigma
        size = noncentrality(alpha, POWER) * sigma
        for i, (o, by) in enumerate(zip(arriving, size.tolist(), strict=True)):
            wrong.append(replace(o, value=o.value + (by if i % 2 else -by)))
    caught = sum(v.verdict == "suspect" for v in verdicts(kind, wrong, alpha))
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
    plan.add(
        Direction("i", "j", 0.0, sigma=0.001), Direction("i", "k", 0.0, sigma=0.001)
    )
    for name in plan.verticals:
        plan.verticals[name] = replace(plan.verticals[name], sigma=(1e-4, 1e-4))
    return measure(plan, seed=1), measure(plan, seed=2)


@cache
def at_rest(frame: str) -> tuple[Network, Solution]:
    """Return the network at rest."""
    network, _ = every_sight(frame)
    solution = fga.adjust(network, tolerance=1e-10)
    return network, solution


def fresh(network: Network, start: Solution, policy: Policy = "accept") -> IncrementalAdjustment:
    inc = IncrementalAdjustment(network, start=start, policy=policy)
    inc.settle()
    return inc


def named(o: Observation, ident: str) -> Observation:
    return replace(o, id=ident)  # type: ignore[call-arg]


def assert_predicted(arrival: Arrival, solution: Solution, what: list[AnyObservation]) -> None:
    """Verdicts are what `fga.predict` says from the state before."""
    p = fga.predict(solution, what)
    assert [v.id for v in arrival.verdicts] == list(p.ids)
    single = len(what) == 1
    for n, v in enumerate(arrival.verdicts):
        part = p.components(n)
        assert v.verdict == "accepted" and v.controlled
        if not single:
            continue
        assert v.innovation / p.sigma[part] == pytest.approx(
            p.innovation[part] / p.sigma[part], abs=EXACT
        )
        assert v.sigma == pytest.approx(p.sigma[part], rel=EXACT)
        assert v.w == pytest.approx(p.w[part], rel=EXACT, abs=EXACT)
        assert v.redundancy_numbers == pytest.approx(p.redundancy_numbers[part], abs=EXACT)


def assert_kept(inc: IncrementalAdjustment, arrival: Arrival) -> None:
    """Verdicts are what reliability and standard deviations say afterwards."""
    inc.settle()
    solution = inc.solution()
    rel = fga.reliability(solution, alpha=inc.alpha)
    for v in arrival.verdicts:
        rows = solution.equations.find([v.id])[0]
        assert v.redundancy_numbers == pytest.approx(rel.redundancy_numbers[rows], abs=EXACT)
        assert v.w == pytest.approx(rel.w[rows], abs=EXACT)
        for gain in v.gains:
            assert gain.after == pytest.approx(
                solution.standard_deviations(gain.point), rel=EXACT, abs=1e-12
            )


FRAMES_USED = ("flat", "curved", "geocentric", "topocentric")


def of(frame: str, kind: str, network: Network) -> list[Observation]:
    """Return the observations of a kind in the network of a frame."""
    return [
        named(o, i)
        for i, o in network.observations.items()
        if o.kind == kind and not i.startswith("held")
    ]


@pytest.mark.parametrize("frame", FRAMES_USED)
@pytest.mark.parametrize("kind", [k for k in OBSERVED if k != "photo_position"])
def test_a_verdict_is_the_prediction_before_and_the_reliability_after(frame, kind):
    network, solution = at_rest(frame)
    again = of(frame, kind, every_sight(frame)[1])
    if not again:
        assert kind.startswith("astronomic") and frame in ("flat", "curved")
        pytest.skip("astronomic observations need an ellipsoid")
    repeated = named(again[0], "new")
    inc = fresh(network, solution)
    before = inc.solution()
    assert_predicted(inc.add(repeated), before, [repeated])
    # Once more, so near to what is expected that the network stays where it is.
    inc = fresh(network, solution)
    p = fga.predict(before, repeated)
    value = np.atleast_1d(np.asarray(repeated.value, dtype=float))
    gentle = value + p.innovation - SMALL * p.sigma if len(value) == len(p.sigma) else None
    if gentle is None:  # e, n, u of a position: along the axes that are known
        assert kind == "control"
        return
    near = replace(
        repeated, value=tuple(gentle.tolist()) if isinstance(repeated.value, tuple) else gentle[0]
    )
    assert_kept(inc, inc.add(near))
