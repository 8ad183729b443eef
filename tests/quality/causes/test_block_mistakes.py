"""Mistakes that bend a block of photos are named, and not what was given of the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.network.network import Network
from factorgraph_adj.quality.causes.block_mistakes import block_mistakes
from factorgraph_adj.quality.causes.exchanged_images import ImagePointExchange, with_exchanged_names
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import Provenance, ReportOptions
from tests.networks.facade import CONTROL, FOCAL, facade
from tests.support.shifted import shift_image
from tests.support.studies import cases

pytest.importorskip("poselib", reason="blocks are looked at from images alone, by PoseLib")


def exchanged_images(network: Network) -> Network:
    pair = ImagePointExchange("F3", ("N2", "N3"), ("", ""), 0.0, 0.0)
    return with_exchanged_names(network, [pair])


def exchanged_twice(network: Network) -> Network:
    pair = ImagePointExchange("F1", ("N5", "N8"), ("", ""), 0.0, 0.0)
    return with_exchanged_names(exchanged_images(network), [pair])


def wrong_sign(network: Network) -> Network:
    return moved(network, "K3", (0.0, 0.0, -2.0 * CONTROL["K3"][2]))


def wrong_x(network: Network) -> Network:
    return moved(network, "K2", (-10.0, 0.0, 0.0))


def moved(network: Network, name: str, by: tuple[float, float, float]) -> Network:
    out = network.copy()
    point = out.points[name]
    at = tuple((np.array(point.coordinates) + by).tolist())
    out.points[name] = replace(point, coordinates=at)
    return out


def exchanged_control(network: Network) -> Network:
    out = network.copy()
    a, b = out.points["K1"], out.points["K2"]
    out.points["K1"], out.points["K2"] = replace(b, name="K1"), replace(a, name="K2")
    return out


def in_another_unit(network: Network) -> Network:
    """Return the block with the principal distance in metres."""
    out = network.copy()
    camera = out.cameras["camera"]
    out.cameras["camera"] = replace(camera, values=(camera.values[0] / 1000.0, *camera.values[1:]))
    return out


IMAGES = "two image points, exchanged: 'N2' and 'N3' in photo 'F3'"
MISTAKES: dict[str, tuple[Callable[[Network], Network], set[str]]] = {
    "image points": (exchanged_images, {IMAGES}),
    "image points of two photos": (
        exchanged_twice,
        {IMAGES, "two image points, exchanged: 'N5' and 'N8' in photo 'F1'"},
    ),
    "sign": (wrong_sign, {"the sign of the given z of point 'K3'"}),
    "x": (wrong_x, {"the given coordinates of point 'K2'"}),
    "control": (exchanged_control, {"the given coordinates, exchanged, of points 'K1' and 'K2'"}),
}


def named(network: Network) -> set[str]:
    """Return the mistakes in a block; all of them can be told from others."""
    found = block_mistakes(fga.adjust(network), 0.001)
    assert not any(m.match.same for m in found)
    return {f"{m.match.cause} {m.match.where}" for m in found}


@pytest.mark.parametrize("mistake", ["image points", "image points of two photos", "x"])
def test_a_mistake_in_a_block_is_named(mistake: str) -> None:
    made, said = MISTAKES[mistake]
    assert named(made(facade(1))) == said


@pytest.mark.parametrize("seed", [3, 6])
def test_a_wrong_sign_ends_no_adjustment_at_a_camera_without_principal_distance(seed: int) -> None:
    """With c = 0 all image points are at the principal point, a minimum of ideal coordinates."""
    network = wrong_sign(facade(seed, held=False))
    camera = network.cameras["camera"]
    network.cameras["camera"] = replace(camera, lens=camera.lens.in_ideal_coordinates)
    solution = fga.adjust(network)
    assert solution.converged
    assert 0.25 * FOCAL < solution.calibration("camera")["c"] < FOCAL


@pytest.mark.parametrize("seed", [3, 6])
def test_a_distortion_that_folds_the_image_ends_with_the_advice_to_snoop(seed: int) -> None:
    """Its k1 takes some rays past the fold, where measured coordinates are not unique."""
    solution = fga.adjust(wrong_sign(facade(seed, held=False)))
    assert solution.calibration("camera")["c"] > FOCAL
    assert not solution.converged
    assert "gross errors" in solution.reason


def test_an_adjustment_that_takes_points_behind_cameras_ends_in_no_error() -> None:
    """Its cause can then be looked for, whichever end rounding lets it take."""
    solution = fga.adjust(wrong_x(facade(4, held=False)), max_iterations=40)
    assert not solution.converged


@pytest.mark.slow(
    "exchanged control, other seeds and a free camera; short tests take one seed each"
)
@pytest.mark.parametrize(
    ("held", "seed"), cases(product([True, False], [2, 3]), [(True, 2), (False, 3)])
)
@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named_with_a_held_and_with_a_free_camera(
    mistake: str, held: bool, seed: int
) -> None:
    made, said = MISTAKES[mistake]
    assert named(made(facade(seed, held=held))) == said


@pytest.mark.slow("a principal distance in metres is named, after all control points were tried")
def test_a_held_principal_distance_in_another_unit_is_named_with_the_right_one() -> None:
    for seed in (1, 2):
        (said,) = named(in_another_unit(facade(seed)))
        assert said.startswith("the given c of camera 'camera', 0.02, where ")
        assert float(said.split()[-2]) == pytest.approx(FOCAL, rel=0.005)


def test_a_principal_distance_is_not_blamed_on_control_nor_control_on_it() -> None:
    """In a block that is bent by less the linear tests tell."""
    network = facade(1)
    camera = network.cameras["camera"]
    network.cameras["camera"] = replace(camera, values=(1.05 * FOCAL, *camera.values[1:]))
    solution = fga.adjust(network)
    assert block_mistakes(solution, 0.001) == ()
    first = fga.causes(fga.reliability(solution)).most_probable
    assert first is not None
    assert first.cause.startswith("the given c")


def test_a_good_block_and_one_with_a_gross_error_have_no_mistake() -> None:
    network = facade(1)
    assert named(network) == set()
    shift_image(network, "F1/N3", 3.0)
    assert named(network) == set()


@pytest.mark.parametrize(("photo", "pair"), [("F3", ("N2", "N3")), ("F2", ("N1", "N9"))])
def test_snooping_sets_exchanged_image_points_alone_aside(
    photo: str, pair: tuple[str, str]
) -> None:
    """Both where they bend the block, and where they lie side by side and nothing is bent."""
    exchanged = ImagePointExchange(photo, pair, ("", ""), 0.0, 0.0)
    found = fga.snoop(with_exchanged_names(facade(1), [exchanged]))
    ids = {f"{photo}/{name}" for name in pair}
    by_chance = {r.id for r in fga.snoop(without(facade(1), sorted(ids))).rejected}
    assert {r.id for r in found.rejected} == ids | by_chance
    assert found.causes is not None
    first = found.causes.most_probable
    assert first is not None
    assert f"{first.cause} {first.where}" == f"two image points, exchanged: {exchanged}"


def test_a_plain_adjustment_names_the_mistake_too() -> None:
    network = exchanged_images(facade(1))
    solution = fga.adjust(network)
    report = Report(solution, ReportOptions(), Provenance(None, network))
    (said,) = report.more_probable
    assert said.startswith(f"readings fit without a mistake: {IMAGES}")
