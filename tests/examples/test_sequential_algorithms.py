"""Sequential algorithms on one stream: they are the batch, and differ in cost alone."""

from __future__ import annotations

import numpy as np
import pytest

from examples.papers.sequential_algorithms import (
    Stream,
    filters,
    linearisation_errors,
    main,
    relaxation_table,
    run_filters,
)
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.network.network import Network
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block

ROUNDING = 1e-9
"""Differences relative to σ; the condition number of the scaled rows is about 500."""


def block(seed: int = 1) -> Network:
    return simulate_aerial_block(seed, image_points=200, points_per_photo=40).network


def stream_of(network: Network, seed: int = 1) -> Stream:
    equations = compile_network(network)
    return Stream.of(equations, equations.unknowns.start(), seed)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_algorithms_are_the_batch_after_additions_and_removals(seed: int) -> None:
    stream = stream_of(block(seed), seed)
    signs = [sign for _, sign in stream.changes]
    assert 1.0 in signs and -1.0 in signs
    for row in run_filters(stream):
        differences = (row.unknowns, row.sigmas, row.cofactors, row.vtv)
        assert max(differences) < ROUNDING, (row.name, differences)


def test_what_leaves_again_changes_nothing() -> None:
    stream = stream_of(block())
    (rows, _), *_ = stream.changes
    for name, one in filters(stream).items():
        x, q, vtv = one.x.copy(), one.cofactors().copy(), one.vtv
        sigma = np.sqrt(np.diag(q))
        one.change(rows, 1.0)
        assert np.abs((one.x - x) / sigma).max() > 1e-3, name
        assert one.vtv > vtv, name
        one.change(rows, -1.0)
        assert np.abs((one.x - x) / sigma).max() < ROUNDING, name
        assert np.abs((one.cofactors() - q) / np.outer(sigma, sigma)).max() < ROUNDING, name
        assert one.vtv == pytest.approx(vtv, rel=ROUNDING), name


def test_multiplications_are_those_of_the_literature() -> None:
    """Factors without square roots take half; the Kalman form grows with n², factors do not."""
    small, large = (
        {r.name: r for r in run_filters(stream_of(simulated))}
        for simulated in (
            block(),
            simulate_aerial_block(1, image_points=400, points_per_photo=40).network,
        )
    )
    ratio = small["triangular factor update"].operations / small["Givens rotations"].operations
    assert ratio == pytest.approx(0.5, abs=0.05)
    growth = {n: large[n].operations / small[n].operations for n in small if small[n].operations}
    assert growth["Kalman form"] > 2.0 > growth["Givens rotations"]
    assert large["Givens rotations"].numbers < large["Kalman form"].numbers / 3


def test_only_what_is_linearised_again_reaches_the_minimum() -> None:
    errors = linearisation_errors(block(), 1)
    linear, once, base, loose, tight, *ours = errors.values()
    assert linear > 1.0 > once
    assert linear > base > tight
    assert tight < loose < linear / 10  # iSAM2 linearises again what has moved most
    assert max(ours) < 0.01


def test_relaxations_take_the_longer_the_less_they_know() -> None:
    network = block()
    found = relaxation_table(stream_of(network), len(network.points))
    count = {(r.name, r.factor): r.iterations for r in found}
    assert all(n > 0 for n in count.values())
    assert count["Gauss-Seidel", 1.0] > min(n for (m, _), n in count.items() if m == "SOR")
    assert count["conjugate gradients, photos", 1.0] < count["conjugate gradients, Jacobi", 1.0]
    assert count["conjugate gradients, Jacobi", 1.0] * 10 < min(
        n for (m, _), n in count.items() if "SOR" in m
    )


def test_the_command_prints_its_tables(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--image-points", "160", "--points-per-photo", "40"])
    out = capsys.readouterr().out
    for words in ("Kalman form", "iSAM2 (GTSAM)", "by linearisation", "BSOR, photos"):
        assert words in out
