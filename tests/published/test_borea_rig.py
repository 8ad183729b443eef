"""A simulated rig of four cameras on the delivered poses and points of the block of IGN.

Nothing is known of the four mounts, nor of the poses of the cameras, before the adjustment.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.loaders.borea import read_borea
from tests.networks.borea_rig import MOUNTS, carried, rig_plan, slipped
from tests.support.places import data_dir

pytestmark = [
    pytest.mark.published,
    pytest.mark.slow(
        "a real flight of a rig with a camera that slipped; short tests take simulated rigs"
    ),
]

FIRST, *_ = SEEDS = (1, 2, 3)
WITHIN, SHARE = 2.5, 0.95
PLAY = (2e-6, 2e-3)
"""Play of mounts of which one slips, radians and metres."""
ALPHA = 1e-6
"""Of one test: ninety thousand are made."""


@cache
def plan_with(play: tuple[float, float] | None = None) -> fga.Network:
    block = read_borea(data_dir("borea"))
    return rig_plan(block) if play is None else rig_plan(block, play=play)


@cache
def from_nothing() -> fga.Solution:
    """Return the adjustment of the first seed: cameras by resection, mounts from what they give."""
    return fga.adjust(carried(plan_with(), FIRST))


def adjusted(seed: int) -> fga.Solution:
    """Return the adjustment of another seed, from the first one."""
    return fga.adjust(carried(plan_with(), seed), start=from_nothing())


def errors(solution: fga.Solution) -> dict[str, Array]:
    """Return the errors of each mount, (6,) radians and metres."""
    kind, table = UNKNOWNS["mount"], solution.equations.unknowns["mount"]
    out = {}
    for name, values in MOUNTS.items():
        found = solution.state["mount"][table.number[name]][None]
        out[name] = kind.local(kind.store(np.array([values])), found)[0]
    return out


def in_sigma(solution: fga.Solution) -> Array:
    """Return the errors of all mounts in units of their σ, (4, 6)."""
    return np.array([e / solution.unknown("mount", n).sigmas for n, e in errors(solution).items()])


@pytest.mark.slow("repeats a whole rig; short tests compare one adjustment with what is published")
def test_boresights_and_arms_come_back_within_their_covariance() -> None:
    """Of normal errors 98.8 % are within 2.5 σ; a hundred seeds, run once, have 98.4 %."""
    off, squares = [], 0.0
    for seed in SEEDS:
        s = from_nothing() if seed == FIRST else adjusted(seed)
        assert s.converged
        # The square of σ̂0 scatters by √(2/r).
        assert s.sigma0 == pytest.approx(1.0, abs=3 / np.sqrt(2 * s.redundancy))
        off.append(in_sigma(s))
        for name, e in errors(s).items():
            q = s.variable_covariance(("mount", name))
            squares += float(e @ np.linalg.solve(q, e))
    every = np.abs(np.array(off))
    assert np.mean(every < WITHIN) >= SHARE
    assert every.max() < 4.5
    # Mounts share control and carriers; were they independent, the sum were χ² of 72.
    assert squares < 72 + 6 * np.sqrt(2 * 72)


def test_boresights_are_found_to_two_arcseconds_and_arms_to_centimetres() -> None:
    s = from_nothing()
    for name in MOUNTS:
        sigmas = s.unknown("mount", name).sigmas
        assert (np.degrees(sigmas[:3]) * 3600 < 2.2).all()
        assert (sigmas[3:5] < 0.01).all()
        assert sigmas[5] < 0.02


@pytest.mark.parametrize("part", ["rotation", "position"])
def test_snooping_names_a_camera_that_slipped_at_one_exposure(part: str) -> None:
    """It is turned by 0.01 gon, or displaced by 0.25 m, against its mount."""
    plan = plan_with(PLAY)
    members = [f for f in plan.photos if f.endswith(" left")]
    name = members[len(members) // 2]
    turn = np.array([0.0, 1.6e-4, 0.0]) if part == "rotation" else np.zeros(3)
    shift = np.array([0.25, 0.0, 0.0]) if part == "position" else np.zeros(3)
    wrong = measure(slipped(plan, name, turn, shift), seed=4)
    right = measure(plan, seed=4)
    # The ties say what the mount says; the images are those of the camera that has slipped.
    for ident in plan.observations:
        wrong.observations[ident] = right.observations[ident]
    assert not fga.snoop(right, alpha=ALPHA).rejected
    rejected = {r.id for r in fga.snoop(wrong, alpha=ALPHA).rejected}
    carrier = name.removesuffix(" left")
    assert rejected == {f"{name} on {carrier} {part}"}
