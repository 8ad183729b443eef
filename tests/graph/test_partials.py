"""A user's factor whose Jacobian contradicts its error is refused by name."""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import SlopeDistance

HELD = {"A": (0.0, 0.0, 0.0), "B": (10.0, 0.0, 1.0), "C": (0.0, 10.0, 2.0), "D": (9.0, 9.0, 8.0)}
FREE = {"P": (3.0, 6.0, 5.0), "Q": (7.0, 5.0, 4.0)}
Spoil = Callable[[list[np.ndarray]], None]


def trilateration() -> fga.Network:
    """Return two points measured from four known ones."""
    network = fga.Network("trilateration")
    for name, place in HELD.items():
        network.add_point(name, place, fixed="xyz")
    for name, place in FREE.items():
        network.add_point(name, place)
        for a, other in HELD.items():
            value = float(np.linalg.norm(np.subtract(place, other)))
            network.add(SlopeDistance(a, name, value, sigma=0.002))
    return network


def tape(network: fga.Network, spoil: Spoil = lambda jacobians: None) -> gtsam.CustomFactor:
    """Return a taped distance, whose Jacobians are always asked for, and may be spoilt."""
    keys = fga.build_graph(network).keys
    p, q = (keys.key("point", name) for name in "PQ")
    true = float(np.linalg.norm(np.subtract(FREE["P"], FREE["Q"])))

    def error(_: object, values: gtsam.Values, jacobians: list[np.ndarray]) -> np.ndarray:
        d = values.atPoint3(q) - values.atPoint3(p)
        length = float(np.linalg.norm(d))
        jacobians[0], jacobians[1] = -d[None] / length, d[None] / length
        spoil(jacobians)
        return np.array([length - true])

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, 0.01), [p, q], error)


def sign(jacobians: list[np.ndarray]) -> None:
    """Turn the sign of all partials."""
    jacobians[0], jacobians[1] = -jacobians[0], -jacobians[1]


def exchanged(jacobians: list[np.ndarray]) -> None:
    """Exchange the first two columns by the second point."""
    jacobians[1] = jacobians[1][:, [1, 0, 2]]


def forgotten(jacobians: list[np.ndarray]) -> None:
    """Forget the partials by the second point."""
    jacobians[1] = np.zeros((1, 3))


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (sign, "the sign of its Jacobian is wrong"),
        (exchanged, r"'Q' is .*: its Jacobian is wrong"),
        (forgotten, r"component \d of point 'Q' is 0, but .* its Jacobian is wrong"),
    ],
)
def test_a_wrong_jacobian_is_named_with_its_factor_row_and_column(spoil, what):
    network = trilateration()
    with pytest.raises(fga.InputError, match=rf"^tape: its partial in row 1 by .*{what}"):
        fga.adjust(network, extra_factors={"right": tape(network), "tape": tape(network, spoil)})


def test_right_jacobians_and_small_neglects_are_taken():
    def neglected(jacobians: list[np.ndarray]) -> None:
        jacobians[0] = 1.005 * jacobians[0]

    network = trilateration()
    for spoil in (lambda jacobians: None, neglected):
        solution = fga.adjust(network, extra_factors=[tape(network, spoil)])
        assert solution.point("P") == pytest.approx(FREE["P"], abs=1e-6)


def test_partials_by_what_is_held_do_not_matter():
    def without_z(jacobians: list[np.ndarray]) -> None:
        for j in jacobians:
            j[:, 2] = 0.0

    network = trilateration()
    with pytest.raises(fga.InputError, match="by component 3 of point"):
        fga.adjust(network, extra_factors=[tape(network, without_z)])
    flat = fga.Network("flat")
    for name, place in HELD.items():
        flat.add_point(name, place, fixed="xyz")
    for name, place in FREE.items():
        flat.add_point(name, place, fixed="z")
    flat.add(*network.observations.values())
    assert fga.adjust(flat, extra_factors=[tape(flat, without_z)]).converged
