"""Published blocks from their image points alone: poses and points are taken away.

Each ends at the minimum that its program publishes, see `test_dbat` and `test_aicon`. What stays of
the datum are control points (DBAT), a scale bar (AICON) or observed projection centres (Borea).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.observation_selection import filtered
from factorgraph_adj.rotation import exp_rotation, omega_phi_kappa
from tests.loaders.borea import Block, read_borea
from tests.networks.aicon import CAMERA as AICON_CAMERA
from tests.networks.aicon import read_aicon
from tests.networks.dbat import CAMCAL, read_camcal, read_roma, read_sxb
from tests.networks.image_blocks import images_alone
from tests.support.dbat_report import read_report
from tests.support.places import data_dir

pytestmark = [
    pytest.mark.published,
    pytest.mark.slow("real blocks from images alone; short tests orient simulated ones"),
]


def from_images(network: fga.Network, photos: int) -> tuple[fga.Solution, object]:
    """Orient a network and adjust it; check that all photos were oriented in one part."""
    found = fga.orient(network)
    assert [len(p.photos) for p in found.parts] == [photos]
    assert found.start is not None and not found.unoriented
    solution = fga.adjust(network, start=found.start, variance="a-posteriori")
    assert solution.converged, solution.reason
    return solution, found


def test_the_aerial_block_ends_at_the_published_minimum() -> None:
    folder = data_dir("dbat_sxb")
    solution, found = from_images(images_alone(read_sxb(folder)), 5)
    assert np.sqrt(solution.vtpv) == pytest.approx(41.8527, abs=0.5e-4)
    assert solution.sigma0 == pytest.approx(1.17860, abs=0.5e-5)
    assert not found.doubtful


@pytest.mark.parametrize(
    ("model", "sigma0", "c"),
    [(3, 1.6148043, 7.456995), (4, 1.6124744, 7.457019), (-1, 1.6216815, 7.457482)],
)
def test_a_camera_is_calibrated_from_its_nominal_focal_length(
    model: int, sigma0: float, c: float
) -> None:
    """The distortion, 2 % of the principal distance at the corners, is not known at the start."""
    folder = data_dir("dbat_camcal")
    solution, found = from_images(images_alone(read_camcal(folder, model=model)), 21)
    assert solution.sigma0 == pytest.approx(sigma0, abs=0.5e-7)
    assert solution.calibration(CAMCAL)["c"] == pytest.approx(c, abs=0.5e-6)
    assert len(found.doubtful) < 10


@pytest.mark.parametrize("c", [4.0, 14.0])
def test_a_wrong_guess_of_the_principal_distance_ends_at_the_same_minimum(c: float) -> None:
    """7.457 mm is true: the guesses are half and twice as long."""
    network = images_alone(read_camcal(data_dir("dbat_camcal")))
    camera = network.cameras[CAMCAL]
    network.cameras[CAMCAL] = replace(camera, values=(c, *camera.values[1:]))
    solution, _ = from_images(network, 21)
    assert solution.sigma0 == pytest.approx(1.6148043, abs=0.5e-7)


@pytest.mark.slow("a whole close-range block from its images; short tests take small blocks")
def test_the_close_range_block_ends_at_the_published_minimum() -> None:
    """115 photos; a distance between two targets gives the scale, nothing else the datum."""
    network = images_alone(read_aicon(data_dir("aicon_jaicov"), start="photos astray"))
    solution, found = from_images(network, 115)
    assert solution.sigma0 == pytest.approx(0.81073, abs=0.5e-5)
    assert solution.sigma0 * 0.0005 == pytest.approx(0.000405, abs=0.5e-6)
    assert solution.redundancy == 18804
    assert solution.calibration(AICON_CAMERA)["c"] == pytest.approx(28.78507, abs=0.5e-5)
    length = np.linalg.norm(solution.point("507") - solution.point("506"))
    assert length == pytest.approx(1.3896880, abs=1e-9)
    assert "scale from 1 known length" in found.parts[0].datum


@pytest.mark.slow("data snooping of a whole block; short tests take small blocks")
def test_image_points_that_aicon_rejected_are_doubted_or_small() -> None:
    """The block with the rejected image points starts like the one without them."""
    folder = data_dir("aicon_jaicov")
    network = images_alone(read_aicon(folder, start="photos astray", with_rejected=True))
    found = fga.orient(network)
    clean = found.without_doubtful()
    solution = fga.adjust(clean, start=found.start)
    v = solution.observations.residuals
    block = next(b for b in solution.equations.blocks if b.kind == "image")
    assert np.abs(v[block.rows].reshape(-1, 2) / block.sigma).max() < 25
    assert len(found.doubtful) < 0.02 * network.n_image_points


@pytest.mark.slow("60 photos and 26 321 points: skeleton, turns and the end in seconds")
def test_roma_ends_at_the_published_minimum() -> None:
    folder = data_dir("dbat_roma")
    solution, found = from_images(images_alone(read_roma(folder), datum="free"), 60)
    report = read_report(folder / "result/report.txt")
    assert np.sqrt(solution.vtpv) == pytest.approx(185.940, abs=0.5e-3)
    assert solution.sigma0 == pytest.approx(report.sigma0.value, abs=report.sigma0.half)
    assert solution.redundancy == 101801
    assert not found.doubtful


@pytest.mark.slow("the datum of 60 photos from one held pose and one coordinate of another")
def test_roma_by_adjust_alone_with_the_datum_of_dbat() -> None:
    """Photo 1 and Y of photo 19 are held, as DBAT has it; the minimum is the published one."""
    given = read_roma(data_dir("dbat_roma"))
    network = images_alone(given)
    network.photos["1"] = given.photos["1"]
    y = given.photos["19"].position
    assert y is not None
    held = replace(given.photos["19"], position=(np.nan, y[1], np.nan), rotation=None)
    network.photos["19"] = held
    solution = fga.adjust(network)
    assert solution.converged and solution.datum_defect == 0
    assert np.sqrt(solution.vtpv) == pytest.approx(185.940, abs=0.5e-3)
    assert "60 photos" in solution.begun[0]


# -- IGN ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def borea(borea_folder: Path) -> Block:
    return read_borea(borea_folder)


@pytest.fixture(scope="module")
def borea_folder() -> Path:
    return data_dir("borea")


def with_observed_centres(block: Block, *, delivered: bool) -> fga.Network:
    """Return the photos with four image points or more, with observed centres (σ = 5 cm).

    Args:
        block: the block.
        delivered: whether poses and points start from the delivered ones.
    """
    network = block.network(coordinates=delivered, poses=delivered)
    photo, _, _, _ = network.images.columns()
    names = list(network.photos)
    few = {n for n, k in zip(names, np.bincount(photo, minlength=len(names)), strict=True) if k < 4}
    network.image_mask(np.array([names[f] not in few for f in photo.tolist()]))
    point = network.images.columns()[1]
    rays = np.bincount(point, minlength=len(network.points))
    network.image_mask(rays[point] >= 2)
    seen = {n for n, k in zip(network.points, rays, strict=True) if k >= 2}
    rng = np.random.default_rng(1)
    for name, p in block.photos.items():
        if name not in few:
            at = tuple(p.position + rng.normal(0, 0.05, 3))
            network.add(fga.PhotoPosition(name, at, sigma=(0.05,) * 3))
    kept = {"pose": set(names) - few, "point": seen}
    return filtered(network, lambda kind, name: name in kept.get(kind, {name}))


def test_two_flights_of_ign_end_where_their_delivered_orientation_leads(borea: Block) -> None:
    """Two parts share no point; both come into the frame by their projection centres."""
    expected = fga.adjust(with_observed_centres(borea, delivered=True))
    network = with_observed_centres(borea, delivered=False)
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    assert "part 1: 36 photos" in solution.begun[0]
    assert "part 2: 24 photos" in solution.begun[1]
    assert solution.vtpv == pytest.approx(expected.vtpv, rel=1e-9)
    d = [solution.pose(n).position - expected.pose(n).position for n in network.photos]
    assert np.abs(d).max() < 1e-4


FEW = {
    "23FD1305x00026_01300": 1,
    "23FD1305x00054_05621": 1,
    "23FD1305x00054_05622": 2,
    "23FD1305x00054_05623": 3,
    "23FD1305x00054_05624": 1,
    "23FD1305x00054_05675": 1,
    "23FD1305x00055_05940": 1,
    "23FD1305x00055_05991": 1,
}
"""Photos with fewer than four image points, and how many they have."""


def all_photos(block: Block, *, delivered: bool, attitudes: bool = False) -> fga.Network:
    """Return all 68 photos with observed centres (σ = 5 cm), and attitudes (σ = 0.005°)."""
    network = block.network(coordinates=delivered, poses=delivered)
    rng = np.random.default_rng(1)
    turned = np.random.default_rng(2)
    for name, p in block.photos.items():
        at = tuple(p.position + rng.normal(0, 0.05, 3))
        network.add(fga.PhotoPosition(name, at, sigma=(0.05,) * 3))
        if attitudes:
            wrong = exp_rotation(turned.normal(0, np.radians(0.005), 3))
            attitude = tuple(omega_phi_kappa(p.rotation @ wrong))
            network.add(fga.PhotoAttitude(name, attitude, sigma=(np.radians(0.005),) * 3))
    return network


def test_eight_photos_of_ign_are_not_determined_by_their_centres(borea: Block) -> None:
    """Defect 11, from the delivered orientation: three photos turn about their only ray (3); five
    share three points with one another only: 5 · 6 + 3 · 3 unknowns, 8 · 2 + 5 · 3 readings (8).
    """
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(all_photos(borea, delivered=True))
    assert error.value.defect == 11
    assert {name for kind, name in error.value.unknowns if kind == "pose"} == set(FEW)


def test_from_images_these_photos_are_named_with_the_reason(borea: Block) -> None:
    found = fga.orient(all_photos(borea, delivered=False))
    assert set(found.unoriented) == set(FEW)
    for name, n in FEW.items():
        assert f"of its {n} image points" in found.unoriented[name]
        assert "observe its attitude" in found.unoriented[name]
    assert sum(len(p.photos) for p in found.parts) == 60


def test_with_observed_attitudes_all_sixty_eight_begin(borea: Block) -> None:
    expected = fga.adjust(all_photos(borea, delivered=True, attitudes=True))
    solution = fga.adjust(all_photos(borea, delivered=False, attitudes=True))
    assert solution.converged
    assert len(solution.network.photos) == 68 and not solution.datum_defect
    assert solution.vtpv == pytest.approx(expected.vtpv, rel=1e-9)


@pytest.mark.parametrize("given", [None, 75.0, 310.0])
def test_an_aerial_block_without_its_principal_distance_finds_it(given: float | None) -> None:
    """DBAT states 123.9392 mm. Given is nothing, or 0.6 or 2.5 times as much: one minimum."""
    network = images_alone(read_sxb(data_dir("dbat_sxb")))
    ((name, camera),) = network.cameras.items()
    free = replace(camera, fixed=(False, *camera.fixed[1:]))
    truth = network.copy()
    truth.cameras[name] = free
    if given is None:
        del network.cameras[name]
        values = dict(zip(camera.lens.names[1:], camera.values[1:], strict=True))
        network.add_camera(name, camera.lens, values, free=["c"], format=camera.format)
    else:
        network.cameras[name] = replace(free, values=(given, *camera.values[1:]))
    solution, found = from_images(network, 5)
    assert found.found_distances[name] == pytest.approx(123.9392, rel=0.1)  # a start
    expected = fga.adjust(truth)
    assert solution.vtpv == pytest.approx(expected.vtpv, rel=1e-9)
    c = solution.calibration(name)["c"]
    sigma = np.sqrt(solution.variable_covariance(("calibration", name))[0, 0])
    assert abs(c - 123.9392) < 4 * sigma
