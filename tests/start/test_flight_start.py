"""Photos without a pose stand where positions and attitudes were observed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import NavigationAttitude, PhotoAttitude
from tests.networks.small_flight import EVERY, FLAT, RATE, TILTED, TURNS, Plan, observed, plan_of


def bare(network: fga.Network) -> fga.Network:
    """Return the network without any approximate value."""
    out = network.copy()
    nothing = {"position": None, "rotation": None}
    out.photos = {n: replace(f, **nothing) for n, f in network.photos.items()}
    out.points = {n: replace(p, coordinates=(np.nan,) * 3) for n, p in network.points.items()}
    return out


@pytest.mark.parametrize("kind", [PhotoAttitude, NavigationAttitude])
@pytest.mark.parametrize("frame", [FLAT, TILTED])
def test_a_block_with_observed_attitudes_needs_no_approximate_values(frame, kind) -> None:
    """One control point, from which no photo could be resected."""
    plan = plan_of(Plan(frame, mount=EVERY, attitudes=kind, drift=RATE, control=1))
    network = observed(plan, 1)
    assert fga.adjust(bare(network)).vtpv == pytest.approx(fga.adjust(network).vtpv, rel=1e-8)


def test_a_stated_boresight_of_any_size_is_used() -> None:
    network = observed(plan_of(Plan(mount=TURNS, control=1)), 1)
    turned = np.array([0.3, 0.2, 2.5])
    network.set_mount("imu", free=TURNS, values=dict(zip(TURNS, turned.tolist(), strict=True)))
    from factorgraph_adj.models.attitude import from_omega_phi_kappa, to_omega_phi_kappa
    from factorgraph_adj.rotation import exp_rotation

    for ident, o in network.observations.items():
        if isinstance(o, PhotoAttitude):
            body = from_omega_phi_kappa(np.array([o.value])) @ exp_rotation(turned[None])
            value = tuple(to_omega_phi_kappa(body)[0].tolist())
            network.observations[ident] = replace(o, value=value)
    solution = fga.adjust(bare(network))
    assert solution.converged
    assert solution.sigma0 == pytest.approx(1.0, abs=0.2)
