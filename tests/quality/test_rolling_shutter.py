"""Blunders in images of photos that move, plans, free networks and what leaves such photos out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.planning.candidates import difference
from factorgraph_adj.planning.targets import PointPrecision
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.networks.rolling_drone import SIGMA_PX, flown, measured

BLOCK = (4, 2, 240)


@pytest.fixture(scope="module")
def network() -> Network:
    return measured(flown(*BLOCK), 1)


@pytest.fixture(scope="module")
def clean(network: Network) -> fga.Solution:
    return fga.adjust(network)


def with_error(network: Network, ident: str, error: Array) -> Network:
    """Return a network with an error in an image point, (2,) px."""
    (wrong,) = (o for o in network.image_points() if f"{o.photo}/{o.point}" == ident)
    out = without(network, [ident])
    x, y = np.array([wrong.x, wrong.y]) + error
    out.add(ImagePoint(wrong.photo, wrong.point, float(x), float(y), sigma=SIGMA_PX))
    return out


def best_controlled(solution: fga.Solution, photo: str) -> tuple[str, fga.Reliability]:
    """Return the image point of a photo with the largest redundancy numbers."""
    rel = fga.reliability(solution)
    ids = [f"{o.photo}/{o.point}" for o in solution.network.image_points() if o.photo == photo]
    numbers = {i: rel.redundancy_numbers[solution.equations.find([i])[0]].min() for i in ids}
    return max(ids, key=lambda i: numbers[i]), rel


@pytest.mark.parametrize("axis", [0, 1])
def test_an_error_of_the_size_of_the_mdb_moves_its_test_value_by_delta0(
    network: Network, clean: fga.Solution, axis: int
) -> None:
    """The time of a row follows its measured coordinate: 1 px of 3648 is 8 µs, 0.1 mm of way."""
    ident, rel = best_controlled(clean, "F2")
    row = clean.equations.find([ident])[0][axis]
    error = np.zeros(2)
    error[axis] = rel.mdb[row]
    wrong = fga.adjust(with_error(network, ident, error))
    there = wrong.equations.find([ident])[0][axis]
    moved = abs(fga.reliability(wrong).w[there] - rel.w[row])
    assert moved == pytest.approx(rel.delta0, rel=0.02)


def test_a_blunder_in_a_photo_that_moves_is_found(network: Network, clean: fga.Solution) -> None:
    ident, rel = best_controlled(clean, "F5")
    row = clean.equations.find([ident])[0][1]
    wrong = with_error(network, ident, np.array([0.0, 5.0 * rel.mdb[row]]))
    found = fga.snoop(wrong)
    # The block has an error of 3.4 σ by chance.
    by_chance = [r.id for r in fga.snoop(network).rejected]
    assert ident not in by_chance
    assert {r.id for r in found.rejected} == {ident, *by_chance}
    kept = without(network, [ident, *by_chance])
    assert found.solution.vtpv == pytest.approx(fga.adjust(kept).vtpv, rel=1e-6)
    assert {*found.solution.network.of_kind("photo_motion")} == {*network.photos}


def test_a_plan_has_the_precision_of_motions_that_the_adjustment_has() -> None:
    design = flown(*BLOCK)
    plan = fga.plan(design)
    made = fga.adjust(measure(design, seed=1, noise=False))
    for photo in design.photos:
        planned, found = (s.unknown("photo_motion", photo) for s in (plan.solution, made))
        np.testing.assert_allclose(planned.sigmas, found.sigmas, rtol=1e-6)
        np.testing.assert_allclose(planned.values, found.values, atol=1e-9)


def test_a_free_network_leaves_motions_in_the_axes_of_its_photos(network: Network) -> None:
    """Speeds, turns and vᵀPv are those of any other datum; velocities scale with the object."""
    alone = without(network, [*network.observations])
    free = fga.adjust(alone, datum="free")
    assert free.datum_defect == 7
    given = alone.copy()
    x, y, z = free.pose("F0").position
    given.photos["F0"] = replace(
        given.photos["F0"], position=(x, y, z), rotation=free.pose("F0").rotation, fixed=(True,) * 6
    )
    far = free.pose("F3").position
    given.photos["F3"] = replace(
        given.photos["F3"],
        position=(float(far[0]), float(far[1]), float(far[2])),
        fixed=(False,) * 3 + (True, False, False),
    )
    held = fga.adjust(given)
    assert held.vtpv == pytest.approx(free.vtpv, rel=1e-8)
    for photo in network.photos:
        one, two = (s.unknown("photo_motion", photo) for s in (free, held))
        np.testing.assert_allclose(one.values, two.values, atol=1e-4)
        # Turns about the axes of the camera do not depend on the datum; velocities do.
        np.testing.assert_allclose(one.sigmas[3:], two.sigmas[3:], rtol=1e-5)


def test_photos_without_poses_are_oriented_as_if_they_stood_still(
    network: Network, clean: fga.Solution
) -> None:
    lost = network.copy()
    for photo in ("F1", "F5"):
        lost.photos[photo] = replace(lost.photos[photo], position=None, rotation=None)
    found = fga.adjust(lost)
    assert found.vtpv == pytest.approx(clean.vtpv, rel=1e-8)


def test_a_motion_that_nothing_tells_is_named(network: Network) -> None:
    photo, _, xy, _ = network.images.columns()
    narrow = network.copy()
    narrow.image_mask((photo != 1) | (np.abs(xy[:, 1]) < 60.0))
    with pytest.raises(fga.DatumError) as caught:
        fga.adjust(narrow)
    said = str(caught.value)
    assert "motion of photo 'F1' is not determined" in said
    assert "tie it to the neighbouring photos" in said


def strip() -> Network:
    network = measured(flown(*BLOCK), 1)
    network.add_strip_motions(
        {f"F{i}": 4.0 * i for i in range(4)}, sigma_velocity=1.0, sigma_rate=0.1
    )
    return network


def test_photos_keep_their_motions_without_the_ties_of_others() -> None:
    network = strip()
    left = without(network, [], photos=["F1"])
    assert {*left.of_kind("photo_motion")} == {*network.photos} - {"F1"}
    ties = [o for o in left.observations.values() if o.kind == "photo_shift"]
    found = [(o.moving_photo, o.before, o.after) for o in ties]  # type: ignore[attr-defined]
    assert found == [("F3", "F2", "F3")]
    ids = [i for i, o in network.observations.items() if o.kind in ("photo_shift", "photo_turn")]
    assert without(network, ids).of_kind("photo_motion") == network.of_kind("photo_motion")


def test_what_is_said_of_a_motion_is_never_said_of_a_photo_that_stands_still() -> None:
    network = strip()
    del network.of_kind("photo_motion")["F1"]
    with pytest.raises(fga.InputError, match=r"photo_shift.*photo 'F1' has no motion"):
        compile_network(network)


def test_a_photo_that_moves_may_be_proposed(network: Network) -> None:
    larger = flown(*BLOCK)
    seen = np.bincount(without(larger, [], photos=["F1"]).images.columns()[1])
    lone = [p for p, n in zip(larger.points, seen.tolist(), strict=False) if n < 2]
    larger = without(larger, [], points=lone)
    design = without(larger, [], photos=["F1"])
    added = difference("another photo", design, larger)
    assert added.brings == {("photo", "F1"), ("photo_motion", "F1")}
    best = fga.plan(larger).solution
    sigma = max(max(best.standard_deviations(p)) for p in design.points)
    found = fga.propose(design, [added], PointPrecision(1.01 * sigma))
    motion = found.plan.solution.unknown("photo_motion", "F1")
    np.testing.assert_allclose(motion.sigmas, best.unknown("photo_motion", "F1").sigmas, rtol=1e-6)
