"""Radial triangulation against the bundle of the same photos, and errors of radial centres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.plan_blocks import (
    plan_station,
    radial_directions,
    radial_observations,
)
from factorgraph_adj.types import Array
from tests.networks.strip_of_photos import measured_strip, strip_plan

TIGHT = 1e-8


def seen(tilt: float, relief: float) -> tuple[Array, Array, Array]:
    """Return rays p, rotations and true directions of points around a photo tilted about x.

    Args:
        tilt: radians.
        relief: height of the points over flying height.
    """
    azimuth = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    ground = np.stack([0.6 * np.sin(azimuth), 0.6 * np.cos(azimuth), relief - 1.0 + 0 * azimuth], 1)
    rotation = exp_rotation(np.array([[tilt, 0.0, 0.0]]))[0]
    p = ground @ rotation
    p = p / -p[:, 2:]
    return p, np.tile(rotation, (24, 1, 1)), azimuth


def off(centre: str, tilt: float, relief: float) -> Array:
    """Return errors of directions from the place that the radial centre shows on flat ground."""
    p, rotation, azimuth = seen(tilt, relief)
    angle, *_ = radial_directions(p, rotation, centre)  # type: ignore[arg-type]
    # Turned about x the camera looks along y; it is t/2 to the isocentre, t to the principal point.
    y = np.tan({"isocentre": 0.5 * tilt, "principal": tilt}.get(centre, 0.0))
    azimuth = np.arctan2(0.6 * np.sin(azimuth), 0.6 * np.cos(azimuth) - y)
    error = (angle - azimuth + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(error)


THREE_DEGREES = np.deg2rad(3.0)


def test_directions_of_rays_turned_to_the_horizon_are_exact() -> None:
    assert np.abs(off("horizon", THREE_DEGREES, 0.1)).max() < 1e-12


def test_directions_from_the_isocentre_are_exact_on_flat_ground() -> None:
    assert np.abs(off("isocentre", THREE_DEGREES, 0.0)).max() < 1e-12
    assert np.abs(off("isocentre", THREE_DEGREES, 0.1)).max() > 1e-3


def test_relief_does_not_turn_directions_from_the_nadir() -> None:
    """Images of a vertical line lie on one ray from the nadir; tilt leaves t²/4 about the mean."""
    flat, high = off("nadir", THREE_DEGREES, 0.0), off("nadir", THREE_DEGREES, 0.1)
    np.testing.assert_allclose(flat, high, atol=1e-12)
    assert np.abs(flat).max() == pytest.approx(THREE_DEGREES**2 / 4, rel=0.02)


def test_relief_turns_directions_from_the_principal_point() -> None:
    """(Δh/H) (c t/r) sin α to first order in t and relief (FRAMES F14)."""
    relief = 0.01
    p, _, azimuth = seen(1e-3, 0.0)
    turned = off("principal", 1e-3, relief) - off("principal", 1e-3, 0.0)
    radius = np.hypot(p[:, 0], p[:, 1])
    expected = relief * 1e-3 / radius * np.sin(azimuth)
    assert np.corrcoef(np.abs(turned), np.abs(expected))[0, 1] > 0.999
    np.testing.assert_allclose(np.abs(turned), np.abs(expected), atol=0.03 * np.abs(expected).max())


def test_the_partials_give_the_weights() -> None:
    p, rotation, _ = seen(THREE_DEGREES, 0.05)
    for centre in ("horizon", "nadir", "isocentre", "principal"):
        _, _, across = radial_directions(p, rotation, centre)  # type: ignore[arg-type]
        for axis in (0, 1):
            step = np.zeros(3)
            step[axis] = 1e-6
            plus, minus = (radial_directions(p + s * step, rotation, centre)[0] for s in (1, -1))  # type: ignore[arg-type]
            slope = ((plus - minus + np.pi) % (2 * np.pi) - np.pi) / 2e-6
            np.testing.assert_allclose(slope, across[:, axis], atol=1e-7)


def test_without_errors_the_plan_is_that_of_the_ground() -> None:
    plan = strip_plan(5, overlap=0.6)
    network = radial_observations(measure(plan, seed=0, noise=False))
    solution = fga.adjust(network, tolerance=TIGHT)
    assert solution.vtpv < 1e-6
    for name, p in plan.points.items():
        if name in network.points:
            np.testing.assert_allclose(solution.point(name)[:2], p.coordinates[:2], atol=1e-4)
    at = solution.point(plan_station("2"))[:2]
    np.testing.assert_allclose(at, plan.photos["2"].position[:2], atol=1e-4)


def test_the_bundle_in_plan_is_more_precise() -> None:
    """Directions hold what image points say across the radius; along it nothing is left."""
    plan = strip_plan(5, overlap=0.6)
    true = measure(plan, seed=0, noise=False)
    bundle, radial = fga.adjust(true), fga.adjust(radial_observations(true))
    free = [n for n in radial.network.points if n in plan.points and radial.covariance(n).any()]
    ratio = np.array(
        [radial.standard_deviations(n)[:2] / bundle.standard_deviations(n)[:2] for n in free]
    )
    assert 1.0 < np.median(ratio) < 3.0
    # Most points lose; points of two rays along the base lose most.
    assert np.mean(ratio > 0.99) > 0.95


def test_estimates_scatter_as_their_covariance_says() -> None:
    """Known tilts: directions of measured images."""
    plan = strip_plan(5, overlap=0.6)
    z, vtpv = [], []
    for seed in range(12):
        network = radial_observations(measure(plan, seed=seed))
        solution = fga.adjust(network)
        free = [n for n in network.points if n in plan.points and solution.covariance(n).any()]
        for n in free:
            e = (solution.point(n) - plan.points[n].coordinates)[:2]
            z += (e / solution.standard_deviations(n)[:2]).tolist()
        vtpv.append(solution.vtpv / solution.redundancy)
    assert np.std(z) == pytest.approx(1.0, abs=0.1)
    assert np.mean(vtpv) == pytest.approx(1.0, abs=0.1)


def test_tilts_that_are_not_known_bend_the_plan() -> None:
    """From the principal point, with tilts of two degrees and hills: σ̂0 says so."""
    plan = strip_plan(5, overlap=0.6)
    network = measure(plan, seed=1)
    good, bad = (
        fga.adjust(radial_observations(network, centre=c)) for c in ("horizon", "principal")
    )
    assert good.sigma0 < 1.3
    assert bad.sigma0 > 3 * good.sigma0
    by_nadir = fga.adjust(radial_observations(network, centre="nadir"))
    assert good.sigma0 < by_nadir.sigma0 < bad.sigma0


def test_reliability_and_a_wrong_image_point() -> None:
    """A direction says nothing of errors along the radius: only half the errors are seen."""
    network = measured_strip(strip_plan(6, overlap=0.8), seed=2)
    solution = fga.adjust(radial_observations(network))
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    in_plan = radial_observations(network)
    ident = next(i for i, o in in_plan.observations.items() if o.target == "P40")
    wrong = in_plan.observations[ident]
    in_plan.observations[ident] = replace(wrong, value=(wrong.value + 0.01) % (2 * np.pi))
    assert ident in [r.id for r in fga.snoop(in_plan).rejected]


def test_two_control_points_in_plan_are_needed() -> None:
    plan = strip_plan(4, overlap=0.7)
    held = [n for n, p in plan.points.items() if any(p.fixed)]
    for n in held[1:]:
        plan.points[n] = replace(plan.points[n], fixed=(False,) * 3)
    network = radial_observations(measure(plan, seed=1))
    with pytest.raises(fga.DatumError):
        fga.adjust(network)
    plan.points[held[-1]] = replace(plan.points[held[-1]], fixed=(True, True, False))
    assert fga.adjust(radial_observations(measure(plan, seed=1))).converged


def test_bad_input_is_named() -> None:
    plan = strip_plan(3, overlap=0.6)
    with pytest.raises(fga.InputError, match="unknown radial centre 'centre'; valid: horizon"):
        radial_observations(plan, centre="centre")  # type: ignore[arg-type]
