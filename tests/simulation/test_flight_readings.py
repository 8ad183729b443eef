"""Readings of rotations are composed, not added: noise-free measurements have no residuals."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.networks.every_kind import FRAMES, flight_equations

RIGHT_HANDED = [n for n, (f, _) in FRAMES.items() if not f.left_handed]


def residuals(network: fga.Network) -> dict[str, Array]:
    """Return the residuals of each kind at the given values."""
    equations = compile_network(network)
    state = equations.unknowns.start()
    return {
        b.kind: b.evaluate(network.frame, state, jacobians=False).residual for b in equations.blocks
    }


@pytest.mark.parametrize("frame", RIGHT_HANDED)
def test_measurements_without_noise_have_no_residuals(frame: str) -> None:
    network = flight_equations(frame)[0].network
    far = np.linalg.norm(FRAMES[frame][1])
    for kind, v in residuals(measure(network, seed=1, noise=False)).items():
        assert np.abs(v).max() < 1e-12 + 4e-16 * far, kind


@pytest.mark.parametrize("about", ["body", "angles"])
def test_readings_of_any_attitude_have_the_residuals_of_their_errors(about: str) -> None:
    """Seeds draw the same errors; the rotation is anything, and errors are a radian."""
    rng = np.random.default_rng(4)
    network = fga.Network("tumbling")
    network.add_camera("camera", fga.models.lens.NoDistortion(), {"c": 100.0})
    for i in range(50):
        turn = world_R_camera(*rng.uniform(-np.pi, np.pi, 3))
        network.add_photo(f"{i}", "camera", position=rng.normal(size=3), rotation=turn)
        for kind in (o.PhotoAttitude, o.NavigationAttitude):
            network.add(kind(f"{i}", (0.0,) * 3, sigma=(0.3, 0.2, 0.4), about=about))
    drawn = residuals(measure(network, seed=7))
    for v in drawn.values():
        # By angles, partials at φ near ±90° are large, and errors then come round.
        small = np.linalg.norm(v, axis=1) < 2.0
        rms = np.sqrt(np.mean(v[small] ** 2, axis=0))
        np.testing.assert_allclose(rms, [0.3, 0.2, 0.4], rtol=0.35)
