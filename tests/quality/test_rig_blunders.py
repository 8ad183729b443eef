"""Blunders of rigs and odometry are found with the predicted power."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj import Network, adjust, reliability, snoop
from factorgraph_adj.observations import RelativePosition
from factorgraph_adj.simulation.measurement import measure
from tests.networks.aerial_rig import aerial_rig
from tests.networks.odometry import odometry
from tests.networks.rigs import rig

POWER = 0.8
SEEDS = 40
ALPHA = 1e-5
"""Of one test: two thousand of them are made."""
TOLERANCE = 3 * np.sqrt(POWER * (1 - POWER) / SEEDS)
"""Three standard deviations of a share of the seeds."""


def with_error(network: Network, ident: str, component: int, size: float) -> Network:
    """Return the network with an error in one component of a relative position."""
    out = network.copy()
    o = out.observations[ident]
    assert isinstance(o, RelativePosition)
    value = np.array(o.value)
    value[component] += size
    out.observations[ident] = replace(o, value=tuple(value.tolist()))
    return out


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
@pytest.mark.parametrize(
    ("plan", "ident"),
    [
        (rig(6, held_points=32, play=(1e-3, 0.005)), "E5 right on E5 position"),
        (odometry(joint=False), "step 0 6"),
    ],
)
def test_an_error_of_the_smallest_detectable_size_is_found_with_its_power(
    plan: Network, ident: str
) -> None:
    start = adjust(measure(plan, seed=0, noise=False))
    r = reliability(start)
    row = r.row(ident, "x")
    size = float(r.mdb[row])
    found = []
    for seed in range(SEEDS):
        wrong = with_error(measure(plan, seed=seed), ident, 0, size)
        w = reliability(adjust(wrong, start=start)).w[row]
        found.append(abs(w) > r.critical_w)
    assert abs(np.mean(found) - POWER) < TOLERANCE


def test_snooping_rejects_a_displaced_member_and_nothing_else() -> None:
    """One member has slipped by 0.2 m at one exposure: its tie is rejected."""
    network = measure(aerial_rig(play=(2e-4, 0.005)), seed=3)
    wrong = with_error(network, "1-1 right on 1-1 position", 1, 0.2)
    assert {r.id for r in snoop(wrong, alpha=ALPHA).rejected} == {"1-1 right on 1-1 position"}


def test_snooping_names_a_member_that_slipped_on_a_stiff_mount() -> None:
    """Its photo was taken from another place: the images tell, and its tie is what is wrong.

    Of an error of a tie with a play of 10 µm the residual shows one part in ten thousand.
    """
    plan = rig(6, held_points=32, play=(1e-7, 1e-5))
    name = "E5 right"
    photo = plan.photos[name]
    assert photo.rotation is not None
    assert photo.position is not None
    moved = plan.copy()
    slipped = np.array(photo.position) + np.array([0.03, 0.0, 0.0])
    moved.photos[name] = replace(photo, position=tuple(slipped.tolist()))
    measured = measure(moved, seed=2)
    for ident, o in plan.observations.items():
        measured.observations[ident] = o
    rejected = {r.id for r in snoop(measured, alpha=ALPHA).rejected}
    assert rejected == {f"{name} on E5 position"}


def test_snooping_rejects_a_wrong_step_of_odometry_and_nothing_else() -> None:
    network = measure(odometry(joint=False), seed=5)
    for ident in ("step 0 6", "step 11 0"):
        found = snoop(with_error(network, ident, 2, 0.4))
        assert {r.id for r in found.rejected} <= {ident, *sharing(network, ident)}
        assert found.rejected


def sharing(network: Network, ident: str) -> set[str]:
    """Return the steps of the same loop, whose errors have the same effect."""
    first, last = (int(n) for n in ident.split()[1:])
    steps = [i for i in network.observations if i.startswith("step")]
    return set(steps) if first > last or last - first > 1 else {ident}
