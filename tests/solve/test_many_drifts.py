"""Drifts that few photos have are nodes of the dense fronts: the results are those of QR."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.solve.elimination_layers import RULE
from tests.networks.drifting_block import drifting_block
from tests.support.elimination_rules import everything_by_qr

DRIFTS = 12


def block() -> fga.Network:
    return drifting_block(DRIFTS, photos_each=5, points_per_photo=40)


def test_drifts_and_what_all_photos_share_have_the_same_adjustment() -> None:
    """Estimates to 1e-6 σ, covariances to 1e-6, redundancy numbers to 1e-8."""
    network = block()
    with everything_by_qr():
        by_qr = fga.adjust(network)
        expected = fga.reliability(by_qr)
    assert by_qr.run.solver.layers.by_qr
    solution = fga.adjust(network)
    layers = solution.run.solver.layers
    assert not layers.by_qr
    assert len(layers.alone["drift"]) == DRIFTS
    assert not len(layers.alone["mount"])  # all photos have it
    assert solution.vtpv == pytest.approx(by_qr.vtpv, rel=1e-9)
    for kind, name in (*(("drift", f"run {i}") for i in range(DRIFTS)), ("mount", "antenna")):
        a, b = (s.unknown(kind, name) for s in (solution, by_qr))
        on = b.sigmas > 0
        assert on.any()
        assert (np.abs(a.values - b.values)[on] < 1e-6 * b.sigmas[on]).all()
        np.testing.assert_allclose(a.sigmas, b.sigmas, rtol=1e-6)
        other = (kind, name), ("drift", "run 3")
        q, p = (s.variable_covariance(*other) for s in (solution, by_qr))
        scale = np.outer(b.sigmas, by_qr.unknown("drift", "run 3").sigmas)
        assert (np.abs(q - p)[scale > 0] < 1e-6 * scale[scale > 0]).all()
    found = fga.reliability(solution)
    for r, r_qr in (
        (found.redundancy_numbers, expected.redundancy_numbers),
        (found.e1, expected.e1),
        (found.e2, expected.e2),
    ):
        np.testing.assert_allclose(r, r_qr, atol=1e-8)


def test_drifts_do_not_fill_the_border() -> None:
    """Only the arm, which all photos have, and the calibration are full columns."""
    solution = fga.adjust(block())
    nodes = solution.factor.nodes
    assert nodes.side < 20
    assert nodes.width <= RULE.max_photo_node_components


def test_a_few_drifts_make_no_node_wider() -> None:
    few = RULE.max_placed_in_border - 3
    solution = fga.adjust(drifting_block(few, photos_each=5, points_per_photo=40))
    assert not solution.run.solver.layers.alone


def test_nodes_of_drifts_stand_between_their_photos() -> None:
    solution = fga.adjust(block())
    nodes = solution.factor.nodes
    at = nodes.positions(solution.state)[-DRIFTS:]
    centres = solution.state["pose"][:, 9:]
    for i, x in enumerate(at):
        np.testing.assert_allclose(x, centres[5 * i : 5 * i + 5].mean(axis=0), atol=1e-6)
