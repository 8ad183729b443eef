"""How far linear forms hold: what a look and a prediction are made of, from dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.linear_system import linearisation_error
from factorgraph_adj.linear_system.front_system import FrontSystem
from factorgraph_adj.types import Array
from tests.networks.arriving import CASES
from tests.support.arrivals import bare, items


def late_rows(name: str, n: int) -> FrontSystem:
    """Return a network with rows beside its base."""
    network = CASES[name].make()
    some = items(network)
    inc = fga.IncrementalAdjustment(bare(network), policy="accept", engine="fronts")
    inc.add(some[:-n])
    inc.settle()
    for item in some[-n:]:
        inc.add(item)
    system = inc._state.system
    assert system is not None
    return system


@pytest.mark.parametrize("name", ["combined block", "camcal, weighted", "local_3d"])
def test_movements_since_a_look_are_measured_with_the_one_before(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """√(dxᵀN dx) since the look, and dxᵀN dx' with the movement dx' until then.

    The base itself has moved before, along its gradient. The networks count as large ones.
    """
    monkeypatch.setattr(linearisation_error, "MAX_SMALL_UNKNOWNS", 0)
    system = late_rows(name, 3)
    k, n = len(system.update.signs), system.unknowns.n_columns
    assert k
    a = system.base.normal().system.times(np.eye(n))
    rng = np.random.default_rng(4)
    g = a.T @ (0.1 * rng.normal(size=len(a)))
    followed = linearisation_error._following(system, g)
    then = rng.normal(size=k - 1)

    def moved(w: Array) -> Array:
        return followed.lifted.unknowns(-(followed.update.spread @ w), followed.slots)

    padded = np.append(then, 0.0)
    since, before = moved(followed.weights - padded), moved(padded) + followed.shift
    length, inner = linearisation_error._since(followed, then)
    assert length == pytest.approx(np.linalg.norm(a @ since), rel=1e-6)
    scale = np.linalg.norm(a @ since) * np.linalg.norm(a @ before)
    assert inner == pytest.approx(float((a @ since) @ (a @ before)), abs=1e-6 * scale)
    assert abs(float((a @ since) @ (a @ followed.shift))) > 1e-3 * scale
