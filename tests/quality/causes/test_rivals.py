"""Errors that cannot be told from one another are listed together, and others alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csc_array

import factorgraph_adj as fga
from factorgraph_adj.observations import (
    Direction,
    HeightDifference,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.quality.causes import cause_search
from factorgraph_adj.quality.causes.cause_search import sized_causes
from factorgraph_adj.quality.causes.readings import Readings
from factorgraph_adj.quality.causes.shared_error_tests import (
    conditional_error_tests,
    shared_error_tests,
    t2_of_errors,
    whitening_matrix,
)
from factorgraph_adj.quality.causes.shared_errors import shared_error_columns
from tests.networks.building_site import site

TARGET = "the centring of the target"
LOOP = ((0, 1), (1, 2), (2, 0), (2, 3))
"""Lines of a loop, and of one to a second given height: redundancy 2."""


def levelling(seed: int, error: float, lines: tuple[tuple[int, int], ...] = LOOP) -> fga.Network:
    """Return levelled lines between two given heights, the second too high by an error."""
    rng = np.random.default_rng([seed, 9])
    network = fga.Network("levelling")
    true = {k: rng.uniform(0.0, 10.0) for k in range(4)}
    for k, z in true.items():
        given = z + (error if k == 3 else 0.0)
        network.add_point(f"P{k}", (10.0 * k, 7.0, given), fixed="xyz" if k in (0, 3) else "xy")
    for i, (a, b) in enumerate(lines):
        sigma = 1e-3 * rng.uniform(0.5, 2.0)
        value = true[b] - true[a] + sigma * rng.normal()
        network.add(HeightDifference(f"P{a}", f"P{b}", value, sigma=sigma, id=str(i)))
    return network


def sights(readings: list[Observation], station: str, target: str) -> list[int]:
    """Return the places of the readings of a sight at a total station."""
    return [
        i
        for i, o in enumerate(readings)
        if isinstance(o, (Direction, ZenithAngle, SlopeDistance))
        and (o.station, o.target) == (station, target)
    ]


def causes_with(network: fga.Network, readings: list[Observation]) -> cause_search.Causes:
    """Return the causes of misfits of a network with readings."""
    whole = network.copy()
    whole.add(*readings)
    return fga.causes(fga.reliability(fga.adjust(whole)))


def gross(seed: int, kind: type, times: float) -> tuple[cause_search.Causes, str]:
    """Return the causes where one reading of a kind is wrong by a multiple of σ, and its sight."""
    network, readings, _ = site(seed)
    of_kind = [i for i, o in enumerate(readings) if isinstance(o, kind)]
    at = of_kind[int(np.random.default_rng(seed).integers(len(of_kind)))]
    one: Any = readings[at]
    value = one.value + times * one.sigma
    readings[at] = replace(one, value=value % (2 * np.pi) if kind is Direction else value)
    return causes_with(network, readings), f"{one.station} {one.target}"


@pytest.mark.parametrize("seed", range(8))
def test_a_given_height_is_listed_with_the_line_that_it_is_identical_to(seed: int) -> None:
    """Also where its own T² of one unknown more or less is not beyond its critical value."""
    alpha = 1e-4
    clean = fga.reliability(fga.adjust(levelling(seed, 0.0)), alpha=alpha)
    sigma = float(next(v for v in clean.given_values if v.name == "P3").together.sigma[0])
    size = np.random.default_rng(seed).uniform(4.0, 6.0) * sigma
    found = fga.causes(fga.reliability(fga.adjust(levelling(seed, size)), alpha=alpha))
    if found.readings:
        assert found.most_probable is None
        assert any("'P3'" in text for text in found.undecided)


def test_of_two_redundant_lines_an_estimated_sigma_tells_nothing() -> None:
    """One degree of freedom is left for σ0 then: a wrong line would be named as often."""
    for seed in range(8):
        solution = fga.adjust(levelling(seed, 0.1), variance="a-posteriori")
        found = fga.causes(fga.reliability(solution))
        assert found.most_probable is None
        assert found.readings == ()
        assert found.found == ()


@pytest.mark.parametrize("seed", [0, 3])
def test_the_height_of_a_target_is_listed_with_the_zenith_angle_that_shares_it(seed: int) -> None:
    """The distance has hardly a part in it on a flat sight, and cannot contradict."""
    network, readings, _ = site(seed)
    rng = np.random.default_rng(seed)
    flat = [o for o in readings if isinstance(o, ZenithAngle) and abs(o.value - np.pi / 2) < 0.02]
    one = flat[int(rng.integers(len(flat)))]
    for i in sights(readings, one.station, one.target):
        spoiled: Any = readings[i]
        readings[i] = replace(spoiled, target_height=spoiled.target_height + 0.03)
    found = causes_with(network, readings)
    texts = found.undecided or (f"{found.most_probable}",)
    assert any("height of the target" in text and repr(one.target) in text for text in texts)


@pytest.mark.parametrize("kind", [Direction, SlopeDistance])
@pytest.mark.parametrize("times", [60.0, 200.0])
def test_a_gross_reading_is_named_alone_where_the_others_of_its_sight_can_tell(
    kind: type, times: float
) -> None:
    """An error of centring that explains it would have shown in the distance, or the direction."""
    for seed in (0, 1, 2):
        found, sight = gross(seed, kind, times)
        assert found.undecided == ()
        assert found.most_probable is None
        assert sight in found.readings[0]


def test_an_error_beside_another_one_is_what_dense_matrices_say() -> None:
    network, readings, _ = site(0)
    network.add(*readings)
    solution = fga.adjust(network)
    w = whitening_matrix(solution.equations)
    every = list(shared_error_columns(Readings.of(solution.equations, solution.state)))
    columns = next(h for h in every if h.cause == "the centring of the instrument").columns[:, :4]
    z = csc_array(w @ columns)
    one, two = np.array([0, 1]), np.array([2, 3])
    first, second, left = conditional_error_tests(solution, z, one, two)
    system = solution.normal().system
    a = system.times(np.eye(solution.equations.unknowns.n_columns))
    m = np.eye(len(a)) - a @ solution.cofactor_times(a.T)
    dense = z.toarray()
    s, u = dense.T @ m @ dense, dense.T @ system.residual
    assert first.t2 == pytest.approx(u[:2] @ np.linalg.solve(s[:2, :2], u[:2]))
    assert first.t2 + second.t2 == pytest.approx(u @ np.linalg.solve(s, u))
    assert np.linalg.inv(left) == pytest.approx(np.linalg.inv(s)[2:, 2:])


def test_the_places_with_the_largest_test_are_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """By T² itself, not by the part of it that needs no solution."""
    network, readings, _ = site(0)
    network.add(*readings)
    solution = fga.adjust(network)

    def of_sights() -> list[cause_search.Cause]:
        found = sized_causes(solution, ())
        return [c for c in found if c.cause == TARGET and "seen from" in c.where]

    every = of_sights()
    monkeypatch.setattr(cause_search, "MAX_PLACES_OF_CAUSE", 3)
    few = of_sights()
    assert len(every) > len(few) == 3
    largest = sorted((c.t2 for c in every), reverse=True)[:3]
    assert sorted((c.t2 for c in few), reverse=True) == pytest.approx(largest)
    w = whitening_matrix(solution.equations)
    for h in shared_error_columns(Readings.of(solution.equations, solution.state)):
        z, q = csc_array(w @ h.columns), len(h.sizes)
        groups = list(np.arange(z.shape[1]).reshape(-1, q))
        t2 = [e.t2 for e in shared_error_tests(solution, z, groups)]
        assert t2_of_errors(solution, z, q) == pytest.approx(np.nan_to_num(t2))


def test_a_target_beside_its_mark_for_all_is_listed_with_the_instrument_there() -> None:
    """Where the point is free, it moves with the one, and the other is off the other way."""
    for seed in range(4):
        network, readings, true = site(seed)
        by = true["S2"] + np.array([0.03, 0.0, 0.0])
        moved = [
            replace(o, value=_seen(o, true, by))
            if isinstance(o, (Direction, SlopeDistance)) and o.target == "S2"
            else o
            for o in readings
        ]
        found = causes_with(network, moved)
        assert found.most_probable is None or found.most_probable.cause == TARGET
        told = found.undecided or [f"{found.most_probable.cause} {found.most_probable.where}"]
        assert any(t.startswith(f"{TARGET} at 'S2'") for t in told), (seed, told)


def _seen(o: Direction | SlopeDistance, true: dict[str, Any], by: Any) -> float:
    """Return what is read to a place beside a target."""
    a, b = true[o.station], true[o.target]
    if isinstance(o, SlopeDistance):
        return o.value + float(np.linalg.norm(by - a) - np.linalg.norm(b - a))
    bearing = [np.arctan2(*(p - a)[:2]) for p in (by, b)]
    return o.value + float(bearing[0] - bearing[1])
