"""A whole track of positions in another datum: a frame with photos as points, FRAMES F7.6."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from tests.networks.small_flight import Plan, plan_of

SEVEN = ("rx", "ry", "rz", "x", "y", "z", "ln_scale")
TURN = np.array((0.01, -0.02, 0.3))
SHIFT, LN_SCALE = np.array((12.0, -30.0, 5.0)), 2e-4


def test_shift_rotation_and_scale_of_a_track_come_back() -> None:
    plan = plan_of(Plan(positions=False, attitudes=None, control=6))
    true = dict(zip(SEVEN, (*TURN, *SHIFT, LN_SCALE), strict=True))
    plan.add_frame("track", free=SEVEN, values=true, origin=(450.0, 270.0, 1000.0))
    for photo in plan.photos:
        at = (0.0, 0.0, 0.0)
        plan.add(FrameCoordinate("track", None, at, photo=photo, sigma=(0.05,) * 3))
    # Readings are X of the photos in the other datum: q = e^−ℓ Rᵀ (X − O) − c.
    network = measure(plan, seed=3, noise=False)
    photo = plan.photos["0b"]
    o = next(x for x in network.observations.values() if x.photos() == ("0b",))
    d = np.array(photo.position) - (450.0, 270.0, 1000.0)
    q = np.exp(-LN_SCALE) * exp_rotation(TURN[None])[0].T @ d - SHIFT
    np.testing.assert_allclose(o.value, q, rtol=0, atol=1e-9)
    network = measure(plan, seed=3)
    off = (0.05,) * 3 + (3.0,) * 3 + (0.01,)
    rough = {n: true[n] + by for n, by in zip(SEVEN, off, strict=True)}
    del network.frames["track"]
    network.add_frame("track", free=SEVEN, values=rough, origin=(450.0, 270.0, 1000.0))
    solution = fga.adjust(network)
    found = solution.unknown("frame", "track")
    errors = (found.values - list(true.values())) / found.sigmas
    assert np.abs(errors).max() < 3.0
    assert solution.sigma0 == pytest.approx(1.0, abs=0.2)
