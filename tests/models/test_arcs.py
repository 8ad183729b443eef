"""Places on orbits against an integrator, their partials, and arcs in axes that turn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.models.arcs import GM, SPIN, arc_places, two_bodies
from factorgraph_adj.models.base import DegenerateError
from factorgraph_adj.types import Array

MOON, EARTH = 4.9028e12, 3.986004418e14
TIMES = np.array([-3000.0, -40.0, 0.0, 1.0, 700.0, 9000.0])


def integrated(place: Array, velocity: Array, gm: float, time: float, turn: float = 0.0) -> Array:
    """Return the place at a time, in axes that turn about z, by an integrator of eighth order."""
    if time == 0.0:
        return place
    spin = np.array([0.0, 0.0, turn])

    def rate(_: float, y: Array) -> Array:
        r, v = y[:3], y[3:]
        pull = -gm * r / np.linalg.norm(r) ** 3
        apparent = -2.0 * np.cross(spin, v) - np.cross(spin, np.cross(spin, r))
        return np.concatenate([v, pull + apparent])

    start = np.concatenate([place, velocity - np.cross(spin, place)])
    found = solve_ivp(rate, (0.0, time), start, method="DOP853", rtol=1e-13, atol=1e-7)
    return np.asarray(found.y[:3, -1])


def orbits(gm: float, speed: float, seed: int) -> tuple[Array, Array]:
    """Return places and velocities; ``speed`` 1 is that of circles, √2 that of parabolas."""
    rng = np.random.default_rng(seed)
    n = len(TIMES)
    place = rng.normal(size=(n, 3))
    radius = 1.05 * (1.7374e6 if gm == MOON else 6.378e6)
    place *= radius / np.linalg.norm(place, axis=1, keepdims=True)
    across = np.cross(place, rng.normal(size=(n, 3))) / radius
    velocity = across / np.linalg.norm(across, axis=1, keepdims=True) + 0.2 * place / radius
    velocity *= speed * np.sqrt(gm / radius) / np.linalg.norm(velocity, axis=1, keepdims=True)
    return place, velocity


@pytest.mark.parametrize("gm", [MOON, EARTH])
@pytest.mark.parametrize("speed", [0.9, 1.0, np.sqrt(2.0), 1.7])
def test_orbits_are_those_of_an_integrator(gm: float, speed: float) -> None:
    place, velocity = orbits(gm, speed, 1)
    found = two_bodies(place, velocity, np.full(len(TIMES), gm), TIMES)
    for i, time in enumerate(TIMES.tolist()):
        expected = integrated(place[i], velocity[i], gm, time)
        # The integrator keeps 13 digits a step, of which there are hundreds.
        assert np.abs(found.place[i] - expected).max() < 1e-9 * np.linalg.norm(expected)


@pytest.mark.parametrize("speed", [0.8, 1.0, np.sqrt(2.0), 1.7])
def test_energy_and_angular_momentum_stay(speed: float) -> None:
    place, velocity = orbits(EARTH, speed, 2)
    found = two_bodies(place, velocity, np.full(len(TIMES), EARTH), TIMES)
    np.testing.assert_allclose(
        np.cross(found.place, found.velocity), np.cross(place, velocity), rtol=1e-9, atol=1e-3
    )

    def energy(r: Array, v: Array) -> Array:
        return np.asarray(np.sum(v**2, axis=1) / 2.0 - EARTH / np.linalg.norm(r, axis=1))

    scale = EARTH / np.linalg.norm(place, axis=1)
    difference = energy(found.place, found.velocity) - energy(place, velocity)
    assert np.abs(difference / scale).max() < 1e-12


@pytest.mark.parametrize("frame", [GeocentricFrame(), TopocentricFrame(0.8, 0.2, 300.0)])
def test_partials_of_arcs_are_differences(frame: GeocentricFrame | TopocentricFrame) -> None:
    place, velocity = orbits(EARTH, 1.1, 3)
    if isinstance(frame, TopocentricFrame):
        place, velocity = frame.from_geocentric(place), velocity @ frame.axes_in_geocentric.T
    terms = np.tile([0.1, -0.2, 0.3, 1e-4, 2e-4, -3e-4], (len(TIMES), 1))
    constants = np.tile([EARTH, 7.292115e-5], (len(TIMES), 1))
    arc = np.concatenate([place, velocity, constants, terms], axis=1)
    _, by = arc_places(frame, arc, TIMES)
    steps = np.array([50.0] * 3 + [0.05] * 3 + [1e-5 * EARTH, 1e-8] + [1e-2] * 3 + [1e-4] * 3)
    for j, step in enumerate(steps.tolist()):
        moved = np.zeros(arc.shape[1])
        moved[j] = step
        ends = (arc_places(frame, arc + s * moved, TIMES)[0] for s in (1.0, -1.0))
        difference = np.subtract(*ends) / (2.0 * step)
        scale = max(float(np.abs(by[:, :, j]).max()), 1e-30)
        assert np.abs(difference - by[:, :, j]).max() < 2e-6 * scale, j


def test_an_arc_in_axes_that_turn_obeys_the_apparent_forces() -> None:
    place, velocity = orbits(MOON, 1.05, 4)
    spin = 1e-4
    arc = np.concatenate([place, velocity, np.tile([MOON, spin], (len(TIMES), 1))], axis=1)
    found, _ = arc_places(LocalFrame(), arc, TIMES)
    for i, time in enumerate(TIMES.tolist()):
        expected = integrated(place[i], velocity[i], MOON, time, spin)
        assert np.abs(found[i] - expected).max() < 1e-9 * np.linalg.norm(expected)


def test_without_gm_an_arc_is_a_polynomial() -> None:
    rng = np.random.default_rng(5)
    coefficients = rng.normal(size=(6, 3))
    arc = np.zeros(20)
    arc[:6], arc[8:] = coefficients[:2].ravel(), coefficients[2:].ravel()
    time = np.linspace(-2.0, 2.0, 7)
    found, by = arc_places(LocalFrame(), np.tile(arc, (7, 1)), time)
    powers = time[:, None] ** np.arange(6)
    np.testing.assert_allclose(found, powers @ coefficients, rtol=1e-13, atol=1e-13)
    states = [*range(6), *range(8, 20)]
    np.testing.assert_allclose(
        by[:, 0][:, [c for c in states if c % 3 == (0 if c < 6 else 2)]], powers
    )
    assert not by[:, :, GM].any()
    assert by[:, :2, SPIN].any()


def test_an_orbit_from_the_centre_or_with_negative_gm_is_refused() -> None:
    one = np.ones(1)
    with pytest.raises(DegenerateError, match="begins at the centre"):
        two_bodies(np.zeros((1, 3)), np.ones((1, 3)), one, one)
    with pytest.raises(DegenerateError, match="negative"):
        two_bodies(np.ones((1, 3)), np.ones((1, 3)), -one, one)
