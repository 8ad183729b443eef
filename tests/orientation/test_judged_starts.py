"""Starts that grossly misfit other observations are replaced, and good ones are not touched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.entities import ImageTable
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.orientation.choice_of_start import choose_start
from factorgraph_adj.orientation.similarity_start import GROSS_START_MISFIT
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.start.start_values import approximate_start
from factorgraph_adj.types import Array
from tests.networks.image_blocks import ImageBlock, aerial, ring

LONG = pytest.mark.slow(
    "other observations than control judge a start; short tests judge by control"
)

SAME = 1e-8
"""Relative difference of vᵀPv of two adjustments that end at one minimum."""
SIMILARITIES = {
    "tiny and turned": (0.04, (2.5, 0.4, 1.0), (3.0, -2.0, 1.0)),
    "huge and elsewhere": (80.0, (0.3, -0.2, 3.0), (9000.0, 4000.0, -7000.0)),
    "below the ground": (1.0, (0.0, 0.0, 0.0), (0.0, 0.0, -1500.0)),
    "turned by 180°": (1.0, (0.0, 0.0, np.pi), (0.0, 0.0, 0.0)),
}
"""Scale, rotation vector and shift of a reconstruction."""


@pytest.fixture(scope="module")
def flown() -> ImageBlock:
    """Return a small block with control."""
    return aerial(5, strips=2, photos=4, n_points=150)


@pytest.fixture(scope="module")
def around() -> ImageBlock:
    """Return a small ring without control."""
    return ring(6, photos=6, control=0)


def moved(network: fga.Network, scale: float, turn: Array, shift: Array) -> fga.Network:
    """Return a network whose poses and tie points are those of a reconstruction."""
    out, r = network.copy(), exp_rotation(np.array(turn, dtype=float))
    known = {o.point for o in network.observations.values() if isinstance(o, fga.ControlPoint)}
    for name, photo in network.photos.items():
        at = tuple((scale * r @ photo.position + shift).tolist())
        out.photos[name] = replace(photo, position=at, rotation=r @ np.array(photo.rotation))
    for name, point in network.points.items():
        if name not in known and not any(point.fixed) and point.sigma is None:
            at = tuple((scale * r @ point.coordinates + shift).tolist())
            out.points[name] = replace(point, coordinates=at)
    return out


@pytest.mark.parametrize("how", SIMILARITIES)
def test_a_reconstruction_in_axes_of_its_own_ends_at_the_minimum_of_the_truth(flown, how):
    found = fga.adjust(moved(flown.truth, *SIMILARITIES[how]))
    true = fga.adjust(flown.truth)
    assert found.converged
    assert found.vtpv == pytest.approx(true.vtpv, rel=SAME)
    assert "grossly misfit: rays to known points" in found.begun[0]
    assert "similarity" in found.begun[1]


def test_fifteen_percent_of_wrong_control_do_not_move_the_start(flown):
    network = flown.truth.copy()
    control = [i for i, o in network.observations.items() if isinstance(o, fga.ControlPoint)]
    wrong = network.observations[control[0]]
    at = tuple(np.add(wrong.value, [300.0, -200.0, 50.0]).tolist())
    network.observations[control[0]] = replace(wrong, value=at)
    start = choose_start(
        compile_network(moved(network, *SIMILARITIES["tiny and turned"])), "given", None
    )
    centres = start.state["pose"][:, 9:]
    assert np.abs(centres - flown.centres).max() < 1.0


def with_single_marks(block: ImageBlock) -> fga.Network:
    """Return a block of which each control point is measured in one photo."""
    out = block.truth.copy()
    known = {o.point for o in out.observations.values() if isinstance(o, fga.ControlPoint)}
    names = np.array(list(out.points), dtype=object)[out.images.columns()[1]]
    first = np.zeros(len(names), dtype=bool)
    first[np.unique(names.astype(str), return_index=True)[1]] = True
    out.image_mask(first | ~np.isin(names.astype(str), sorted(known)))
    return out


@pytest.mark.parametrize("how", SIMILARITIES)
def test_control_points_that_are_measured_once_place_a_reconstruction(flown, how):
    network = with_single_marks(flown)
    found = fga.adjust(moved(network, *SIMILARITIES[how]))
    true = fga.adjust(network)
    assert found.converged
    assert found.vtpv == pytest.approx(true.vtpv, rel=SAME)
    assert "rays to known points: scale" in found.begun[1]


@pytest.mark.parametrize("how", SIMILARITIES)
def test_fifteen_percent_of_wrong_image_marks_do_not_move_the_start(flown, how):
    """The marks are those of tie points and of control, and are anywhere in their photos."""
    rng = np.random.default_rng(5)
    network = flown.truth.copy()
    photo, point, xy, sigma = network.images.columns()
    wrong = rng.random(len(xy)) < 0.15
    anywhere = rng.uniform(xy.min(axis=0), xy.max(axis=0), xy.shape)
    network.images = ImageTable()
    network.images.append(photo, point, np.where(wrong[:, None], anywhere, xy), sigma)
    start = choose_start(compile_network(moved(network, *SIMILARITIES[how])), "given", None)
    depth = float(np.median(flown.centres[:, 2]) - np.median(flown.points[:, 2]))
    assert (
        np.abs(start.state["pose"][:, 9:] - flown.centres).max() < 0.1 * GROSS_START_MISFIT * depth
    )


def with_positions(block: ImageBlock) -> fga.Network:
    """Return a block with observed projection centres."""
    rng = np.random.default_rng(1)
    out = block.truth.copy()
    out.datum = "given"
    for name, at in zip(out.photos, block.centres, strict=True):
        value = tuple((at + rng.normal(0, 0.02, 3)).tolist())
        out.add(fga.PhotoPosition(name, value, sigma=(0.02, 0.02, 0.02)))
    return out


def with_distances(block: ImageBlock) -> fga.Network:
    """Return a free block with a distance between every two of six points."""
    out = block.truth.copy()
    names = list(out.points)[:6]
    for i, one in enumerate(names):
        for j, other in enumerate(names[:i]):
            length = float(np.linalg.norm(block.points[i] - block.points[j]))
            out.add(fga.SlopeDistance(one, other, length, sigma=0.001))
    return out


@LONG
@pytest.mark.parametrize(
    ("add", "what"),
    [(with_positions, "photo position"), (with_distances, "slope distance")],
    ids=["GNSS alone", "distances alone"],
)
@pytest.mark.parametrize("scale", [0.05, 30.0])
def test_other_observations_than_control_are_misfitted_too(
    around: ImageBlock, add: Callable[[ImageBlock], fga.Network], what: str, scale: float
):
    network = add(around)
    found = fga.adjust(moved(network, scale, (0.2, 0.1, 2.0), (5.0, 3.0, -4.0)))
    assert found.converged
    assert found.vtpv == pytest.approx(fga.adjust(network).vtpv, rel=SAME)
    assert f"grossly misfit: {what}" in found.begun[0]


def test_poses_that_fit_nothing_are_oriented_anew_from_images(flown):
    rng = np.random.default_rng(3)
    network = flown.truth.copy()
    for name, photo in network.photos.items():
        turn = exp_rotation(rng.normal(0, 0.5, 3))
        at = tuple((np.array(photo.position) + rng.normal(0, 200.0, 3)).tolist())
        network.photos[name] = replace(photo, position=at, rotation=turn @ np.array(photo.rotation))
    found = fga.adjust(network)
    assert found.converged
    assert found.vtpv == pytest.approx(fga.adjust(flown.truth).vtpv, rel=SAME)
    assert any("from image points" in s for s in found.begun)


@pytest.mark.parametrize("add", [lambda b: b.truth, with_positions, with_distances])
@pytest.mark.parametrize("wrong", [0.0, 0.3 * GROSS_START_MISFIT])
def test_a_start_that_is_not_grossly_wrong_is_not_touched(around, add, wrong):
    network = moved(add(around), 1.0 + wrong, (0.0, 0.0, wrong), (0.0, 0.0, 0.0))
    equations = compile_network(network)
    found = choose_start(equations, network.datum, None)
    given = approximate_start(equations, network.datum, None)
    assert not found.words
    for kind, values in given.state.items():
        assert np.array_equal(found.state[kind], values, equal_nan=True)
