"""Covariances of variables: pairs of kind and name, and what is none."""

from __future__ import annotations

import re

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import HeightDifference


@pytest.fixture(scope="module")
def solution() -> fga.Solution:
    network = fga.Network("levels")
    network.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    for name, other in (("27", "A"), ("28", "27")):
        network.add_point(name, (10.0, 0.0, 100.0), fixed="xy")
        network.add(HeightDifference(other, name, 0.1, sigma=0.002))
    return fga.adjust(network)


def test_two_variables_are_two_pairs(solution: fga.Solution) -> None:
    a, b = ("point", "27"), ("point", "28")
    assert solution.variable_covariance(a)[2, 2] == pytest.approx(4e-6)
    assert solution.variable_covariance(a, b)[2, 2] == pytest.approx(4e-6)
    np.testing.assert_array_equal(
        solution.variable_covariance(a, a), solution.variable_covariance(a)
    )
    assert solution.variable_covariance(b, b)[2, 2] == pytest.approx(8e-6)


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        (("point", "27"), "'point'"),
        (("27",), "'27'"),
        (("A2",), "'A2'"),
        ((("point", "27"), "28"), "'28'"),
        ((("point", 27),), "('point', 27)"),
        ((("point", "27", "28"),), "('point', '27', '28')"),
    ],
)
def test_what_is_no_pair_is_refused(solution: fga.Solution, given: tuple, wrong: str) -> None:
    valid = "a variable is a pair of kind and name, such as ('point', 'P1'), not "
    with pytest.raises(InputError, match=re.escape(valid + wrong)):
        solution.variable_covariance(*given)


@pytest.mark.parametrize(
    ("variable", "message"),
    [
        (("points", "27"), "unknown kind of unknowns 'points'"),
        (("point", "29"), "unknown point '29'; known: A, 27, 28"),
    ],
)
def test_unknown_kinds_and_names_are_refused(
    solution: fga.Solution, variable: tuple[str, str], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        solution.variable_covariance(variable)
