"""Components that are named with rejected observations: those that misfit the clean solution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import ControlPoint, GnssVector, Observation
from factorgraph_adj.quality.robust_estimation import Estimator
from factorgraph_adj.report.rejected_observations import set_aside
from factorgraph_adj.types import Array

SIGMA = 0.003
OFF = {"o1": (0.5, 0.7, 0.0), "o2": (0.0, 1.0, 0.0)}
"""Gross errors. With o2 in the adjustment, y of o1 misfits by less than its x."""


def vector(ident: str, at: Array, covariance: Array) -> Observation:
    return GnssVector("A", "P", tuple(at.tolist()), covariance=covariance, id=ident)


def control(ident: str, at: Array, covariance: Array) -> Observation:
    return ControlPoint("P", tuple(at.tolist()), covariance=covariance, id=ident)


@pytest.mark.parametrize("kind", [vector, control])
@pytest.mark.parametrize("correlation", [0.0, 0.3])
@pytest.mark.parametrize("robust", [None, "huber"])
def test_the_component_is_that_which_misfits_the_clean_solution(
    kind: Callable[[str, Array, Array], Observation], correlation: float, robust: Estimator | None
) -> None:
    rng, network = np.random.default_rng(5), fga.Network("repeated")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("P", (30, 20, 10))
    covariance = SIGMA**2 * (np.eye(3) + correlation * (1 - np.eye(3)))
    for i in range(5):
        name = f"o{i}"
        at = np.array([30.0, 20, 10]) + rng.normal(0, SIGMA, 3) + OFF.get(name, (0, 0, 0))
        network.add(kind(name, at, covariance))
    found = fga.snoop(network, robust=robust)
    assert {r.id for r in found.rejected} == set(OFF)
    predicted = set_aside(found.solution, list(OFF), network)
    numbers = predicted.rows.equations.find(list(OFF))
    for ident, rows in zip(OFF, numbers, strict=True):
        (r,) = [r for r in found.rejected if r.id == ident]
        w = predicted.w[np.isin(predicted.numbers, rows)]
        worst = int(np.argmax(np.abs(w)))
        assert r.component == "xyz"[worst] == "y"
        assert r.label.endswith(" y")
        assert r.final_test == pytest.approx(w[worst])
        assert r.final_error == pytest.approx(OFF[ident][worst], abs=5 * SIGMA)


def test_the_first_test_value_is_that_of_the_named_component() -> None:
    network = fga.Network("repeated")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("P", (30, 20, 10))
    for i in range(5):
        at = np.array([30.0, 20, 10]) + OFF.get(f"o{i}", (0, 0, 0))
        network.add(vector(f"o{i}", at, SIGMA**2 * np.eye(3)))
    first = fga.reliability(fga.adjust(network))
    found = fga.snoop(network)
    (r,) = [r for r in found.rejected if r.id == "o1"]
    assert r.round == 1
    rows = first.solution.equations.find(["o1"])[0]
    assert int(np.argmax(np.abs(first.w[rows]))) == 0  # x
    assert r.test == pytest.approx(first.w[rows[1]])
    assert r.estimated_error == pytest.approx(first.estimated_errors[rows[1]])
