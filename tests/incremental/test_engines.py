"""The engine that carries a network is named, chosen by what it is, and given as a copy."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import HeightDifference
from tests.networks.small_block import images_only


def levels(**options: object) -> fga.IncrementalAdjustment:
    """Return three bench marks, of which one is held."""
    network = fga.Network("levels")
    network.add_point("A", (0.0, 0.0, 10.0), fixed="xyz")
    for name in ("P", "Q"):
        network.add_point(name, (50.0, 0.0, 10.0), fixed="xy")
    network.add(HeightDifference("A", "P", 1.0, sigma=0.001))
    network.add(HeightDifference("P", "Q", 0.5, sigma=0.001))
    return fga.IncrementalAdjustment(network, **options)  # type: ignore[arg-type]


def test_a_levelling_network_is_in_isam2_from_the_beginning_and_after_it_has_settled() -> None:
    inc = levels(engine="auto")
    assert inc.engine == "isam2" and repr(inc).endswith("iSAM2>")
    inc.add(HeightDifference("A", "Q", 1.501, sigma=0.001))
    inc.settle()
    assert inc.engine == "isam2" and inc.settled
    batch = fga.adjust(inc.network(), tolerance=1e-10)
    assert inc.estimate("Q")[2] == pytest.approx(batch.point("Q")[2], abs=1e-10)
    assert inc.solution().converged


def test_fronts_carry_it_where_they_are_asked_for() -> None:
    inc = levels(engine="fronts")
    assert inc.engine == "fronts" and repr(inc).endswith("fronts>")
    with pytest.raises(InputError, match="fronts carry this network"):
        _ = inc.isam


def test_photos_and_free_networks_are_for_fronts() -> None:
    photos = fga.IncrementalAdjustment(images_only(), datum="free", engine="auto")
    assert photos.engine == "fronts"


def test_the_live_tree_is_given_as_a_copy() -> None:
    inc = levels(engine="isam2")
    tree = inc.isam
    assert isinstance(tree, gtsam.ISAM2)
    before = inc.estimate("Q")
    sigmas = sorted(
        float(np.sqrt(tree.marginalCovariance(key)[0, 0]))
        for key in range(tree.getLinearizationPoint().size())
    )
    assert sigmas == pytest.approx([0.001, 0.001 * np.sqrt(2.0)], rel=1e-9)
    tree.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [1])
    assert (inc.estimate("Q") == before).all()
