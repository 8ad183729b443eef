"""Blocks from image points alone: every start leads to the minimum that the truth leads to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.models.ray_lens import FisheyeLens
from factorgraph_adj.rotation import log_rotation
from tests.networks.image_blocks import (
    CAMERA,
    KINDS,
    ImageBlock,
    aerial,
    look_at,
    ring,
    two_parts,
)
from tests.support.studies import cases

LONG = pytest.mark.slow(
    "blocks of particular kinds from images alone; short tests orient the ordinary ones"
)

SAME = 1e-9
"""Relative difference of vᵀPv of two adjustments that end at one minimum."""
SEEDS = cases(range(4), [0, 3])


def minimum(network: fga.Network, start=None) -> fga.Solution:
    solution = fga.adjust(network, start=start)
    assert solution.converged, solution.reason
    return solution


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["aerial", "ring", "two parts", "unknown calibration"])
def test_a_block_ends_where_the_truth_leads(kind, seed):
    block = KINDS[kind](seed)
    found = fga.orient(block.network)
    assert len(found.parts) == (2 if kind == "two parts" else 1)
    assert sum(len(p.photos) for p in found.parts) == len(block.network.photos)
    assert not found.doubtful and not found.unoriented and not found.unreached
    assert found.start is not None
    solution = minimum(block.network, found.start)
    assert solution.vtpv == pytest.approx(minimum(block.truth).vtpv, rel=SAME)
    assert solution.iterations <= 12
    if kind == "unknown calibration":
        assert found.found_distances[CAMERA] == pytest.approx(28.0, rel=2e-3)
        assert solution.calibration(CAMERA)["c"] == pytest.approx(28.0, abs=0.02)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("seed", SEEDS)
def test_mismatches_are_named_and_stay_in_the_network(seed):
    block = KINDS["mismatches"](seed)
    n = block.network.n_image_points
    found = fga.orient(block.network)
    assert block.network.n_image_points == n
    assert not found.unoriented
    assert block.mismatched <= set(found.doubtful)
    # A good image point is doubted only where its point has no second one.
    lost = set(found.unreached)
    wrongly = set(found.doubtful) - block.mismatched
    assert {name.split("/")[1] for name in wrongly} <= lost
    clean = found.without_doubtful()
    assert clean.n_image_points == n - len(found.doubtful)
    solution = minimum(clean, found.start)
    assert solution.vtpv == pytest.approx(minimum(without(block, found)).vtpv, rel=SAME)
    assert 0.95 < solution.sigma0 < 1.05


def without(block: ImageBlock, found) -> fga.Network:
    """Return the truth without what a start doubts, made by other means."""
    lost = set(found.unreached)
    rays = [f"{i.photo}/{i.point}" for i in block.truth.image_points()]
    gone = set(found.doubtful) - {r for r in rays if r.split("/")[1] in lost}
    truth = block.truth.copy()
    keep = [r not in gone and r.split("/")[1] not in lost for r in rays]
    truth.image_mask(np.array(keep))
    from factorgraph_adj.graph.observation_selection import without as taken_out

    return taken_out(truth, (), points=sorted(lost))


def test_adjust_begins_from_images_by_itself_and_says_so():
    block = ring(1, control=0)
    length = float(np.linalg.norm(block.points[3] - block.points[40]))
    block.network.add(fga.SlopeDistance("P3", "P40", length, sigma=1e-4, id="bar"))
    solution = minimum(block.network)
    said = " ".join(solution.begun)
    assert "16 photos from the pair" in said and "14 by resection" in said
    assert "scale from 1 known length" in said
    assert np.linalg.norm(solution.point("P3") - solution.point("P40")) == pytest.approx(length)
    assert shape_error(block, solution) < 3e-3
    text = " ".join(fga.text_report(solution).split())
    assert "Start from image points: 16 photos from the pair" in text


def shape_error(block: ImageBlock, solution: fga.Solution) -> float:
    """Return the largest distance of a point from the truth after the best rotation and shift."""
    names = list(solution.network.points)
    ours = np.array([solution.point(n) for n in names])
    true = block.points[[int(n[1:]) for n in names]]
    a, b = ours - ours.mean(axis=0), true - true.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    assert np.linalg.det(u @ vt) > 0
    return float(np.abs(a @ u @ vt - b).max())


def test_without_anything_known_the_base_is_one():
    block = ring(2, control=0)
    found = fga.orient(block.network)
    assert "the base of the start pair has the length 1" in found.parts[0].datum
    assert not found.parts[0].placed
    solution = minimum(block.network, found.start)
    assert solution.datum_defect == 7
    # In a free network the shape is that of the truth times one scale.
    names = found.parts[0].start
    base = np.linalg.norm(solution.pose(names[0]).position - solution.pose(names[1]).position)
    assert base == pytest.approx(1.0, rel=0.02)


@LONG
def test_a_saved_solution_still_says_how_it_began(tmp_path):
    block = ring(1, photos=6)
    solution = fga.adjust(block.network, start=fga.orient(block.network).start)
    assert solution.begun
    solution.save(tmp_path / "ring.npz")
    assert fga.load_solution(tmp_path / "ring.npz").begun == solution.begun


def test_approximate_values_come_first():
    """Four control points in each photo: no part is grown."""
    block = ring(0, control=30)
    assert minimum(block.network).begun == ()


@LONG
def test_the_command_and_the_check_begin_from_images(tmp_path, capsys):
    block = ring(3, photos=8, control=0)
    fga.write_project(block.network, tmp_path / "ring" / "project.toml")
    assert main(["adjust", str(tmp_path / "ring"), "--full"]) == 0
    assert "Start from image points: 8 photos" in " ".join(capsys.readouterr().out.split())
    assert main(["check", str(tmp_path / "ring")]) == 0
    assert "approximate values are there" in capsys.readouterr().out


# -- datum ----------------------------------------------------------------------------------------


def test_projection_centres_give_the_datum():
    block = aerial(5, control=0)
    network = block.network
    network.datum = "given"
    for i, at in enumerate(block.centres):
        network.add(fga.PhotoPosition(f"F{i}", tuple(at), sigma=(0.05,) * 3))
    found = fga.orient(network)
    assert found.parts[0].datum == "18 known projection centres"
    solution = minimum(network, found.start)
    assert not solution.datum_defect
    for i in (0, 9, 17):
        assert np.linalg.norm(solution.pose(f"F{i}").position - block.centres[i]) < 0.3


@LONG
def test_two_parts_of_which_one_has_control_are_told():
    block = two_parts(1, control=0)
    network = block.network
    network.datum = "given"
    for p in (3, 40, 90, 120):
        network.add(fga.ControlPoint(f"P{p}", tuple(block.points[p]), sigma=(1e-4,) * 3))
    found = fga.orient(network)
    assert [p.placed for p in found.parts].count(True) == 1
    lost = next(p for p in found.parts if not p.placed)
    assert "nothing joins it to the other parts" in lost.datum
    with pytest.raises(fga.DatumError):
        fga.adjust(network, start=found.start)


def test_a_held_photo_and_one_coordinate_of_another_give_the_datum():
    block = ring(4, control=0)
    network = block.network
    network.datum = "given"
    photos = network.photos
    photos["F0"] = replace(
        photos["F0"],
        position=tuple(block.centres[0]),
        rotation=block.rotations[0],
        fixed=(True,) * 6,
    )
    photos["F7"] = replace(
        photos["F7"],
        position=(float(block.centres[7, 0]), np.nan, np.nan),
        fixed=(False,) * 3 + (True, False, False),
    )
    solution = minimum(network)
    assert "attitudes" in " ".join(solution.begun)
    turned = log_rotation((block.rotations[5].T @ solution.pose("F5").rotation)[None])
    assert np.linalg.norm(turned) < 2e-3
    assert np.linalg.norm(solution.pose("F5").position - block.centres[5]) < 0.02


def test_one_wrong_control_point_does_not_bend_the_start():
    block = ring(6, control=6)
    network = block.network
    name = next(iter(network.observations))
    bad = network.observations[name]
    network.observations[name] = replace(bad, value=tuple(np.add(bad.value, (5.0, 0, 0))))
    found = fga.orient(network)
    assert found.start is not None
    x = found.start.state["point"]
    true = np.array([block.points[int(n[1:])] for n in network.points])
    assert np.abs(x - true).max() < 0.05


@LONG
def test_control_in_plan_and_control_in_height_place_a_block():
    block = aerial(4, control=0)
    chosen = [int(n[1:]) for n in list(block.network.points)[::45]]
    for network in (block.network, block.truth):
        network.datum = "given"
        for p in chosen[:4]:
            at = tuple(block.points[p, :2])
            network.add(fga.ControlPoint(f"P{p}", at, axes="xy", sigma=(0.02,) * 2))
        for p in chosen[4:]:
            at = (float(block.points[p, 2]),)
            network.add(fga.ControlPoint(f"P{p}", at, axes="z", sigma=(0.02,)))
    solution = minimum(block.network)
    assert "known coordinates of" in solution.begun[0]
    assert solution.vtpv == pytest.approx(minimum(block.truth).vtpv, rel=SAME)


@LONG
def test_coordinates_of_another_frame_are_told_by_their_misfit():
    """Control with x and y exchanged is a mirror image: no similarity leads to it."""
    block = ring(6)
    swapped = fga.orient(block.network).parts[0].misfit
    for name, o in block.network.observations.items():
        x, y, z = o.value
        block.network.observations[name] = replace(o, value=(y, x, z))
    assert fga.orient(block.network).parts[0].misfit > 100 * swapped


# -- cameras --------------------------------------------------------------------------------------


@LONG
@pytest.mark.parametrize("distortion", [0.0, 2e-5])
def test_a_calibration_for_each_photo(distortion):
    block = ring(0, control=0, distortion=distortion)
    for network in (block.network, block.truth):
        network.cameras[CAMERA] = replace(network.cameras[CAMERA], per_photo=True)
    solution = minimum(block.network, fga.orient(block.network).start)
    assert solution.vtpv == pytest.approx(minimum(block.truth).vtpv, rel=SAME)


@LONG
def test_two_cameras_are_calibrated_together():
    block = ring(2, control=0, distortion=2e-5)
    for network in (block.network, block.truth):
        network.cameras["other"] = replace(network.cameras[CAMERA], name="other")
        for name in list(network.photos)[::2]:
            network.photos[name] = replace(network.photos[name], camera="other")
    solution = minimum(block.network, fga.orient(block.network).start)
    assert solution.vtpv == pytest.approx(minimum(block.truth).vtpv, rel=SAME)


@LONG
def test_fisheye_photos_that_see_behind_themselves():
    """Rays beyond 79° to the axis orient nothing, and are not doubted for that."""
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (160, 3)) * [1.5, 1.5, 1.0]
    network = fga.Network("fisheye", datum="free")
    network.add_camera("fisheye", FisheyeLens(), {"c": 12.0})
    truth = network.copy()
    for i, at in enumerate(x):
        network.add_point(f"P{i}")
        truth.add_point(f"P{i}", at)
    for f in range(12):
        turn = 2 * np.pi * f / 12
        centre = np.array([2.2 * np.cos(turn), 2.2 * np.sin(turn), 0.3 * (f % 3)])
        r = look_at(centre, rng.normal(0, 0.3, 3))
        p = (x - centre) @ r
        rho = np.hypot(p[:, 0], p[:, 1])
        angle = np.arctan2(rho, p[:, 2])
        xy = 12.0 * np.stack([p[:, 0], -p[:, 1]], 1) * (angle / rho)[:, None]
        seen = np.flatnonzero(angle < np.radians(100))
        xy = xy[seen] + rng.normal(0, 0.002, (len(seen), 2))
        network.add_photo(f"F{f}", "fisheye")
        truth.add_photo(f"F{f}", "fisheye", position=centre, rotation=r)
        for n in (network, truth):
            n.add_image_points(f"F{f}", [f"P{i}" for i in seen], xy, sigma=0.002)
    found = fga.orient(network)
    assert not found.doubtful and not found.unoriented
    solution = minimum(network, found.start)
    assert solution.vtpv == pytest.approx(minimum(truth).vtpv, rel=SAME)


# -- what is left out -----------------------------------------------------------------------------


def test_photos_with_too_few_points_are_named_with_the_reason():
    block = ring(0)
    network = block.network
    photo, *_ = network.images.columns()
    rows = np.flatnonzero(photo == 5)
    keep = np.ones(len(photo), dtype=bool)
    keep[rows[3:]] = False
    network.image_mask(keep)
    found = fga.orient(network)
    assert list(found.unoriented) == ["F5"]
    assert "3 of its 3 image points" in found.unoriented["F5"]
    assert found.start is None
    assert "F5" in " ".join(found.sentences())
    with pytest.raises(fga.ApproximationError, match="F5"):
        fga.adjust(ring_without_control(network))
    solution = minimum(found.without_doubtful())
    assert len(solution.network.photos) == 15


def ring_without_control(network: fga.Network) -> fga.Network:
    out = network.copy()
    out.observations = {}
    out.datum = "free"
    return out


def test_a_point_with_one_ray_is_named_and_taken_out_with_the_doubtful_ones():
    block = ring(3)
    block.network.add_point("lone")
    block.network.add_image_points("F0", ["lone"], np.array([[1.0, 2.0]]), sigma=0.003)
    found = fga.orient(block.network)
    assert found.doubtful == ("F0/lone",) and found.unreached == ("lone",)
    clean = found.without_doubtful()
    assert "lone" not in clean.points
    assert minimum(clean, found.start).vtpv == pytest.approx(minimum(block.truth).vtpv, rel=SAME)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("make", [aerial, ring])
def test_a_fifth_of_mismatches_is_named(make):
    block = make(7, mismatches=0.2)
    found = fga.orient(block.network)
    assert not found.unoriented
    assert block.mismatched <= set(found.doubtful)
    wrongly = {n.split("/")[1] for n in set(found.doubtful) - block.mismatched}
    assert wrongly <= set(found.unreached)


@pytest.mark.slow("many photos: local and whole adjustments in turns")
@pytest.mark.parametrize(("strips", "photos"), cases([(5, 16), (10, 30)], [(5, 16)]))
def test_many_photos_are_oriented_in_one_part(strips, photos):
    n = strips * photos
    block = aerial(1, strips=strips, photos=photos, n_points=40 * n, mismatches=0.02)
    found = fga.orient(block.network)
    assert [len(p.photos) for p in found.parts] == [n]
    assert block.mismatched <= set(found.doubtful)
    assert 0.99 < minimum(found.without_doubtful(), found.start).sigma0 < 1.01


def test_all_parts_of_a_block_are_told_in_words():
    block = two_parts(0)
    said = fga.orient(block.network).sentences()
    assert [s.split(":")[0] for s in said] == [
        "Start from image points, part 1",
        "Start from image points, part 2",
    ]
    assert "placed in the frame by" in said[0]


def test_the_result_shows_itself():
    found = fga.orient(ring(0, photos=5).network)
    assert repr(found).startswith("<BlockStart: 5 of 5 photos in 1 part, 0 of ")
    assert "start pair" in found._repr_html_()


@LONG
def test_the_order_of_photos_and_points_does_not_matter():
    block = ring(7)
    one = minimum(block.network, fga.orient(block.network).start)
    other = fga.Network("turned round", datum="given")
    other.cameras = dict(block.network.cameras)
    for name in reversed(block.network.points):
        other.add_point(name)
    for name in reversed(block.network.photos):
        other.add_photo(name, CAMERA)
    other.add(*block.network.observations.values())
    for i in reversed(list(block.network.image_points())):
        other.add_image_points(i.photo, [i.point], np.array([[i.x, i.y]]), sigma=i.sigma)
    again = minimum(other, fga.orient(other).start)
    assert again.vtpv == pytest.approx(one.vtpv, rel=SAME)
    np.testing.assert_allclose(again.point("P9"), one.point("P9"), atol=1e-7)


# -- refused --------------------------------------------------------------------------------------


def test_a_network_without_image_points_is_refused():
    network = fga.Network("levelling")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    with pytest.raises(fga.InputError, match="no image points"):
        fga.orient(network)


@pytest.mark.parametrize(
    ("distances", "why"),
    [
        ({"other": [30.0]}, "unknown camera 'other'"),
        ({CAMERA: [0.0]}, "> 0"),
        ({CAMERA: []}, "> 0"),
    ],
)
def test_wrong_principal_distances_are_refused(distances, why):
    with pytest.raises(fga.InputError, match=why):
        fga.orient(ring(0, photos=4).network, principal_distances=distances)


@LONG
def test_stated_principal_distances_are_tried():
    block = ring(8, photos=8, guess=60.0)
    found = fga.orient(block.network, principal_distances={CAMERA: [60.0, 29.0]})
    assert found.found_distances[CAMERA] == pytest.approx(28.0, rel=5e-3)


def test_photos_that_share_nothing_are_refused():
    block = ring(0, photos=4)
    rng = np.random.default_rng(0)
    network = fga.Network("noise")
    network.cameras = dict(block.network.cameras)
    for i in range(40):
        network.add_point(f"P{i}")
    for f in "AB":
        network.add_photo(f, CAMERA)
    network.add_image_points(
        "A", [f"P{i}" for i in range(20)], rng.normal(0, 5, (20, 2)), sigma=0.01
    )
    network.add_image_points(
        "B", [f"P{i}" for i in range(20, 40)], rng.normal(0, 5, (20, 2)), sigma=0.01
    )
    with pytest.raises(fga.ApproximationError, match="no pair of photos"):
        fga.orient(network)


@pytest.mark.slow(
    "whole blocks from image points alone are compared with the truth; short tests take their steps"
)
@pytest.mark.parametrize("seed", cases(range(3), [0]))
def test_image_points_without_any_sense_are_refused_or_told(seed):
    """Random image coordinates: no traceback, and no start that calls them good."""
    rng = np.random.default_rng(seed)
    network = fga.Network("noise", datum="free")
    network.cameras = dict(ring(0, photos=4).network.cameras)
    names = [f"P{i}" for i in range(60)]
    for n in names:
        network.add_point(n)
    for f in "ABCD":
        network.add_photo(f, CAMERA)
        network.add_image_points(f, names, rng.uniform(-12, 12, (60, 2)), sigma=0.003)
    try:
        found = fga.orient(network)
    except fga.ApproximationError:
        return
    assert len(found.doubtful) + len(found.unoriented) * 60 > 150
