"""Points that only instruments in frames and cameras see are eliminated first; so is the result.

Large networks are eliminated so; here small ones are, whatever their size.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import ControlPoint, FrameDirection, FrameZenith
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from factorgraph_adj.solve import elimination_layers
from factorgraph_adj.solve.step_refinements import state_after_inner_iterations
from factorgraph_adj.types import Array
from tests.benchmarks.scans import hall, network_of
from tests.networks.every_kind import FRAMES
from tests.networks.frames import network_of_frames
from tests.networks.instruments import INSTRUMENTS, SIGMA_ANGLE, room_of
from tests.support.elimination_rules import everything_by_qr, set_rule


def with_photos() -> fga.Network:
    """Photos of a room that scanners sight too: some points belong to both, some to one."""
    network = room_of(6, ["scanner"] * 3, points=14, coarse=0.0)
    network = fga.adjust(network).as_network()
    for name in list(network.points)[:3]:
        x = network.points[name].coordinates
        network.add(ControlPoint(name, x, axes="xyz", sigma=(1e-3,) * 3))
    network.datum = "given"
    middle = np.mean([p.coordinates for p in network.points.values()], axis=0)
    network.add_camera("camera", BrownLens(), {"c": 20.0}, free=("c", "x0", "y0"))
    for i, at in enumerate(((25.0, 0, 8), (0, 25.0, 9), (-25.0, 3, 7), (2, -25.0, 8))):
        centre = middle + np.array(at)
        rotation = look_at(centre, middle)
        network.add_photo(f"F{i}", "camera", position=centre, rotation=rotation)
        names = [n for k, n in enumerate(network.points) if (k + i) % 5]
        network.add_image_points(f"F{i}", names, np.zeros((len(names), 2)), sigma=3e-3)
    for j in range(6):
        name = f"Q{j}"
        network.add_point(name, middle + np.array([j - 3.0, 2.0 - j, 0.4 * j]))
        for i in range(4):
            network.add_image_points(f"F{i}", [name], np.zeros((1, 2)), sigma=3e-3)
    return disturb(measure(network, seed=6), seed=6, points=0.01, centres=0.01, attitudes=1e-3)


def far_target() -> fga.Network:
    """Two theodolites see a target six thousand of their bases away: a pivot of 3·10⁻⁷."""
    network = room_of(8, ["theodolite"] * 2, points=8, held=4)
    network = fga.adjust(network).as_network()
    network.add_point("far", (4.5e4, 3.6e4, 3e3))
    for frame in network.frames:
        network.add(
            FrameDirection(frame, "far", 0.0, sigma=SIGMA_ANGLE * 3e-3),
            FrameZenith(frame, "far", 1.0, sigma=SIGMA_ANGLE * 3e-3),
        )
    return measure(network, seed=8)


MIXED = ("compensated scanner", "tracker", "levelled theodolite")
NETWORKS: dict[str, Callable[[], fga.Network]] = {
    "scanners": lambda: room_of(1, ["scanner"] * 3, held=3),
    "theodolites without distances": lambda: room_of(2, ["theodolite"] * 3, held=4),
    "unknown constants": lambda: room_of(3, ["scanner", "tracker"] * 5, constants=True, points=14),
    "every instrument, free": lambda: room_of(4, list(INSTRUMENTS), coarse=0.1),
    "partly sighted": lambda: room_of(5, ["levelled scanner"] * 9, points=20, share=0.4, held=3),
    "forced centring": lambda: room_of(
        10, ["on a tripod"] * 4 + ["on a pillar, tilted"] * 3, points=14, held=4, share=0.7
    ),
    "forced centring, free": lambda: room_of(
        12, ["on a tripod"] * 3 + ["scanner"] * 2, points=10, coarse=0.1, constants=True
    ),
    "photos too": with_photos,
    "a far target": far_target,
    "frame coordinates": lambda: network_of_frames(4, ("scan", "model", "levelled scan", "plan")),
    **{
        f"{name}": lambda name=name: room_of(
            7,
            ["compensated scanner", "tracker", "levelled theodolite"],
            frame_name=name,
            coarse=0.1,
        )
        for name in FRAMES
    },
}


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", NETWORKS)
def test_points_that_only_instruments_see_are_eliminated_first(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Estimates to 1e-6 σ, covariances to 1e-6, redundancy numbers and their parts to 1e-8."""
    network = NETWORKS[name]()
    with everything_by_qr():
        by_qr = fga.adjust(network, tolerance=1e-8)
        expected, covariances = fga.reliability(by_qr), by_qr.point_covariances
    set_rule(monkeypatch, max_qr_variables=0, max_placed_in_border=0)
    solution = fga.adjust(network, tolerance=1e-8)
    assert solution.converged and not solution.run.solver.layers.by_qr
    assert not solution.run.solver.qr_everywhere
    assert solution.run.solver.plan.rays is not None
    assert solution.run.solver.plan.rays.spokes is not None
    found = fga.reliability(solution)
    sigma = np.sqrt(np.einsum("pii->pi", covariances))
    moved = np.abs(solution.state["point"] - by_qr.state["point"])
    assert np.all(moved <= 1e-6 * sigma + 1e-11 * (1.0 + np.abs(by_qr.state["point"])))
    scale = np.maximum(sigma[:, :, None] * sigma[:, None, :], 1e-12)
    assert np.max(np.abs(solution.point_covariances - covariances) / scale) < 1e-6
    for a, b in (
        (found.redundancy_numbers, expected.redundancy_numbers),
        (found.e1, expected.e1),
        (found.e2, expected.e2),
        (found.e12, expected.e12),
    ):
        # The far target takes six digits of the covariances, in either way.
        close = {"rtol": 1e-6, "atol": 1e-6} if "far" in name else {"rtol": 1e-9, "atol": 1e-8}
        np.testing.assert_allclose(a, b, **close)
    for kind in ("frame", "edm", "index_error"):
        for number in np.flatnonzero(by_qr.equations.unknowns[kind].offset >= 0).tolist():
            v = (kind, by_qr.equations.unknowns[kind].names[number])
            a, b = (s.variable_covariance(v) for s in (solution, by_qr))
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-6 * np.abs(b).max())


def test_a_hall_of_scanners_is_cut_into_small_fronts() -> None:
    """40 stations with 6 000 sights; its tree would have 2 000 variables and more."""
    network = network_of(hall(40, 6_000))
    solution = fga.adjust(network)
    layers, fronts = solution.run.solver.layers, solution.factor.fronts
    assert solution.converged and not layers.by_qr and len(layers.alone["frame"])
    assert int(layers.reduced.sum()) == sum(not all(p.fixed) for p in network.points.values())
    assert len(fronts.fronts) > 1
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-7)
    assert solution.sigma0 == pytest.approx(1.0, abs=0.04)
    assert fga.memory_needed(network).total > 0


def test_points_follow_their_instruments() -> None:
    """Inner iterations find the points of held instruments, and leave the others alone."""
    network = room_of(9, ["scanner"] * 10, points=12, held=3)
    solution = fga.adjust(network)
    equations = compile_network(network)
    layers = elimination_layers.layers_of(
        equations,
        reduce_points=True,
        touched=np.zeros(equations.unknowns.n_columns, dtype=bool),
        kept=np.zeros(0, dtype=np.intp),
    )
    assert layers.reduced.sum() == 9
    wrong = {**solution.state, "point": solution.state["point"].copy()}
    rng = np.random.default_rng(1)
    wrong["point"][layers.reduced] += 0.02 * rng.normal(size=(9, 3))
    found = state_after_inner_iterations(equations, layers, wrong, wrong)
    before, after = (_distance(s["point"], solution) for s in (wrong, found))
    assert after < 1e-3 * before


def _distance(points: Array, solution: fga.Solution) -> float:
    return float(np.abs(points - solution.state["point"]).max())
