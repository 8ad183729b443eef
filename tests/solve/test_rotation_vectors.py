"""Standard deviations of rotation vectors: those of the values, not of turns about turned axes."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.quality.parameter_significance import significance
from factorgraph_adj.report.result_files import write_solution
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.networks.rigs import rig
from tests.networks.three_frames import three_frames

TURN = (-0.15, 0.3, -2.1)
"""A station that is tilted a little and turned far about z."""
STEP = 1e-6
"""Step of central differences, radians: their error is about 10⁻¹² / 10⁻⁶ · 10⁻³."""
RUNS = 500
SCATTER = 4.0 / np.sqrt(2 * RUNS)
"""Four standard deviations of a standard deviation from as many runs, relative."""


def station(seed: int, *, noise: bool = True) -> Network:
    """Return seven held points in a flat slab, measured in a turned frame."""
    rng = np.random.default_rng(1)
    network = Network("station")
    network.add_frame(
        "LT2", origin=(5.0, 5.0, 1.0), values=dict(zip(("rx", "ry", "rz"), TURN, strict=True))
    )
    for i in range(7):
        network.add_point(f"P{i}", tuple(rng.uniform((0, 0, 0), (20, 10, 1))), fixed="xyz")
        network.add(
            FrameCoordinate("LT2", f"P{i}", (0.0, 0.0, 0.0), axes="xyz", sigma=(1e-3, 1e-3, 3e-3))
        )
    return measure(network, seed=seed, noise=noise)


@cache
def solution() -> fga.Solution:
    return fga.adjust(station(0, noise=False))


def by_turns(vector: Array) -> Array:
    """Return ∂ Log(R Exp(ω))/∂ω by central differences, (3, 3)."""
    r = exp_rotation(vector[None])[0]
    columns = [
        (
            log_rotation((r @ exp_rotation(STEP * a))[None])
            - log_rotation((r @ exp_rotation(-STEP * a))[None])
        )[0]
        / (2 * STEP)
        for a in np.eye(3)
    ]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("kind", [k.name for k in UNKNOWNS.values() if k.rotates])
@pytest.mark.parametrize("vector", [TURN, (0.0, 0.0, 0.0), (0.3, -0.2, 0.1), (1.8, 1.8, -1.7)])
def test_the_partials_of_values_are_central_differences(
    kind: str, vector: tuple[float, float, float]
) -> None:
    record = UNKNOWNS[kind]
    given = np.concatenate([vector, np.arange(1.0, record.size - 2)])[None]
    constants = np.zeros((1, len(record.constants)))
    stored = np.concatenate([record.store(given), constants], axis=1)
    steps = STEP * np.eye(record.size)
    numerical = np.stack(
        [
            (
                record.given(record.retract(stored, s[None]))
                - record.given(record.retract(stored, -s[None]))
            )[0]
            / (2 * STEP)
            for s in steps
        ],
        axis=1,
    )
    np.testing.assert_allclose(record.by_step(stored)[0], numerical, atol=1e-8)


def test_sigmas_of_a_frame_are_those_of_its_rotation_vector() -> None:
    """The figures about the turned axes are others by more than half for a turn of 2.1 rad."""
    s = solution()
    e = s.unknown("frame", "LT2")
    about_axes = s.variable_covariance(("frame", "LT2"))
    j = np.eye(7)
    j[:3, :3] = by_turns(e.values[:3])
    expected = j @ about_axes @ j.T
    np.testing.assert_allclose(e.sigmas, np.sqrt(np.diag(expected)), rtol=1e-7)
    scale = np.where(e.sigmas > 0, e.sigmas, 1.0)
    np.testing.assert_allclose(e.correlation, expected / np.outer(scale, scale), atol=1e-7)
    ratio = e.sigmas[:3] / np.sqrt(np.diag(about_axes))[:3]
    assert np.abs(ratio - 1.0).max() > 0.4


@pytest.mark.slow(
    "values scatter by their standard deviations in repeated simulation; short tests "
    "compare one adjustment"
)
def test_values_scatter_by_their_standard_deviations() -> None:
    found = np.array(
        [
            fga.adjust(station(seed), start=solution()).unknown("frame", "LT2").values[:6]
            for seed in range(1, 1 + RUNS)
        ]
    )
    sigmas = solution().unknown("frame", "LT2").sigmas[:6]
    np.testing.assert_allclose(found.std(axis=0), sigmas, rtol=SCATTER)


def test_tables_print_the_standard_deviations_of_the_values(tmp_path: Path) -> None:
    s = fga.adjust(three_frames())
    write_solution(s, tmp_path)
    with open(tmp_path / "unknowns.csv", encoding="utf-8") as file:
        rows = {(r["name"], r["component"]): r for r in csv.DictReader(file)}
    table = s.unknown_table()
    at = {(n, c): i for i, (n, c) in enumerate(zip(table["name"], table["component"], strict=True))}
    e = s.unknown("frame", "model")
    for component, sigma in zip(e.names[:3], e.sigmas, strict=False):
        row = rows["model", component]
        assert float(row["sigma"]) * np.pi / 200 == pytest.approx(sigma, rel=1e-8)
        assert table["sigma"][at["model", component]] == pytest.approx(sigma, rel=1e-12)


def test_mounts_are_tested_with_the_sigma_and_correlations_of_their_values() -> None:
    s = fga.adjust(measure(rig(), seed=3))
    found = significance(s, correlation=1e-9)
    for mount in s.network.mounts:
        e = s.unknown("mount", mount)
        tangent = s.variable_covariance(("mount", mount))[:3, :3]
        j = by_turns(e.values[:3])
        expected = j @ tangent @ j.T
        for i, component in enumerate(e.names[:3]):
            tested = found[mount, component]
            assert tested.sigma == pytest.approx(np.sqrt(expected[i, i]), rel=1e-6)
            assert tested.t == pytest.approx((tested.value - tested.reference) / tested.sigma)
        listed = {
            (c.a[2], c.b[2]): c.value
            for c in found.correlations
            if c.a[:2] == c.b[:2] == ("mount", mount)
        }
        rho = expected[0, 1] / np.sqrt(expected[0, 0] * expected[1, 1])
        assert listed["rx", "ry"] == pytest.approx(rho, abs=1e-6)
