"""Models of COLMAP: truth and covariances of pycolmap, tables beside the model, round trips."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.photogrammetry.colmap import read_colmap, read_sparse_model
from factorgraph_adj.io.photogrammetry.colmap_binary_files import binary_files
from factorgraph_adj.io.photogrammetry.colmap_text_files import text_files
from factorgraph_adj.models.lens import BrownLens, NoDistortion
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import exp_rotation, skew
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.support.colmap import disturb, synthetic, written

PIXELS = 0.5
"""Standard deviation of simulated image coordinates."""
TURN = exp_rotation(np.array([[0.3, -0.2, 1.1]]))[0]
ORIGIN, SCALE = np.array([431_000.0, 5_310_000.0, 620.0]), 12.5
"""Another system in which models are adjusted."""


def elsewhere(x: Array) -> Array:
    """Return places in the other system, (n, 3)."""
    return np.asarray(SCALE * np.atleast_2d(x) @ TURN.T + ORIGIN)


def control_table(
    path: Path, rows: dict[str, Array], more: str = "fixed", value: str = "xyz"
) -> Path:
    lines = [f"name,x,y,z,{more}"]
    lines += [",".join([n, *map(repr, x.tolist()), value]) for n, x in rows.items()]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    "model, parameters",
    [
        ("SIMPLE_RADIAL", (1280.0, 512.0, 384.0, 0.05)),
        ("OPENCV", (1280.0, 1270.0, 512.0, 384.0, -0.1, 0.03, 1e-3, -5e-4)),
        ("OPENCV_FISHEYE", (600.0, 605.0, 512.0, 384.0, 0.02, -0.01, 2e-3, -1e-4)),
    ],
)
def test_estimates_lie_within_their_covariance_of_the_truth(
    model: str, parameters: tuple[float, ...], tmp_path: Path
) -> None:
    """χ² of all free points over seeds, with six fixed points; its expectation is the number."""
    chi2, n = 0.0, 0
    for seed in range(4):
        truth = synthetic(seed, model=model, parameters=parameters)
        true = {str(i): p.xyz.copy() for i, p in truth.points3D.items()}
        disturb(truth, pixels=PIXELS)
        folder = written(truth, tmp_path / f"{seed}")
        control = control_table(folder / "control.csv", {k: true[k] for k in list(true)[:6]})
        network = read_colmap(folder, sigma=PIXELS, control=control)
        solution = fga.adjust(network)
        assert solution.redundancy > 400
        for name in list(true)[6:]:
            off = solution.point(name) - true[name]
            chi2 += off @ np.linalg.solve(solution.covariance(name) / solution.sigma0**2, off)
            n += 3
    # The points of one solution are correlated by poses and calibration: the spread of the sum
    # is somewhat above √(2n).
    assert chi2 == pytest.approx(n, abs=5.0 * np.sqrt(2.0 * n))


def test_covariances_are_those_of_pycolmap(tmp_path: Path) -> None:
    """Two photos are held in both programs, σ is 1 px, the variance factor is not estimated.

    pycolmap's covariances of poses have rotations in half angles (of the quaternion). Those of its
    points are conditional on poses and calibration: the inverse of the block of the point alone.
    """
    pycolmap = pytest.importorskip("pycolmap")
    made = synthetic(3, rigs=1, frames=6, points=30)
    disturb(made, pixels=PIXELS)
    config = pycolmap.BundleAdjustmentConfig()
    for number in made.images:
        config.add_image(number)
    frames = sorted(made.frames)
    for number in frames[:2]:
        config.set_constant_rig_from_world_pose(number)
    network = read_colmap(written(made, tmp_path / "start"))
    network.datum = "given"
    held = [made.image(data.id).name for n in frames[:2] for data in made.frames[n].data_ids]
    for name in held:
        fixed = network.photos[name]
        network.photos[name] = type(fixed)(**{**vars(fixed), "fixed": (True,) * 6})
    solution = fga.adjust(network)
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.function_tolerance = 1e-14
    options.ceres.solver_options.gradient_tolerance = 1e-14
    options.ceres.solver_options.parameter_tolerance = 1e-14
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, made)
    done = adjuster.solve().ceres_summary
    assert 2.0 * done.final_cost == pytest.approx(solution.vtpv, rel=1e-8)
    found = pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), made, adjuster)
    assert found is not None
    (block,) = (b for b in solution.equations.blocks if b.lens is not None)
    by_point = block.evaluate(network.frame, solution.state).jacobians[2]
    of_point = block.variables[2][1]
    for i, (number, point) in enumerate(sorted(made.points3D.items())):
        np.testing.assert_allclose(solution.point(str(number)), point.xyz, atol=1e-6)
        theirs = found.get_point_cov(number)
        a = by_point[of_point == solution.number("point", str(number))].reshape(-1, 3)
        alone = np.linalg.inv(a.T @ a)
        np.testing.assert_allclose(theirs, alone, atol=1e-6 * np.abs(theirs).max())
        ours = solution.covariance(str(number))
        assert np.trace(ours) > 1.3 * np.trace(theirs), i
    for image in made.images.values():
        if image.name in held:
            continue
        pose = image.cam_from_world()
        # θ = −ω turns the world into the camera; t = −R X₀.
        by = np.zeros((6, 6))
        by[:3, :3] = -0.5 * np.eye(3)
        by[3:, :3] = skew(np.array(pose.translation))
        by[3:, 3:] = -pose.rotation.matrix()
        ours = by @ solution.pose_covariance(image.name) @ by.T
        theirs = found.get_cam_cov_from_world(image.image_id)
        size = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
        np.testing.assert_allclose(ours / size, theirs / size, atol=1e-5)


@pytest.mark.parametrize("files", ["binary", "text"])
@pytest.mark.parametrize("cameras", [1, 2])
def test_adjusted_model_is_read_by_pycolmap_and_comes_back(
    cameras: int, files: Any, tmp_path: Path
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    made = synthetic(5, cameras=cameras, frames=3)
    disturb(made)
    network = read_colmap(written(made, tmp_path / "start"), sigma=PIXELS)
    solution = fga.adjust(network)
    fga.write_colmap(solution, tmp_path / "out", files=files)

    theirs = pycolmap.Reconstruction(str(tmp_path / "out"))
    assert theirs.num_images() == len(network.photos)
    assert [len(r.non_ref_sensors) for r in theirs.rigs.values()] == [cameras - 1] * 2
    photo, point, xy, _ = network.images.columns()
    for number, at in theirs.points3D.items():
        np.testing.assert_allclose(at.xyz, solution.point(str(number)), rtol=1e-14)
    for image in theirs.images.values():
        pose = image.cam_from_world().inverse()
        ours = solution.pose(image.name)
        np.testing.assert_allclose(pose.translation, ours.position, atol=2e-6)
    # COLMAP computes the errors of the points itself; those in the file are ours.
    stated = {i: p.error for i, p in theirs.points3D.items()}
    theirs.update_point_3d_errors()
    for number, at in theirs.points3D.items():
        assert at.error == pytest.approx(stated[number], rel=1e-4)

    back = fga.read(tmp_path / "out", sigma=PIXELS)
    again = back.images.columns()
    assert list(back.photos) == list(network.photos)
    assert list(back.points) == list(network.points)
    np.testing.assert_array_equal(again[0], photo)
    np.testing.assert_array_equal(again[1], point)
    np.testing.assert_array_equal(again[2], xy)
    assert {c.lens for c in back.cameras.values()} == {c.lens for c in network.cameras.values()}
    assert list(back.mounts) == list(network.mounts)
    second = fga.adjust(back)
    assert second.vtpv == pytest.approx(solution.vtpv, rel=1e-6)
    assert second.redundancy == solution.redundancy


def test_network_that_is_not_adjusted_comes_back_to_the_last_digits(tmp_path: Path) -> None:
    made = synthetic(6, model="OPENCV", parameters=(800.0, 810.0, 512.0, 384.0, 0.1, 0.0, 1e-3, 0))
    network = read_colmap(written(made, tmp_path / "a"))
    fga.write_colmap(network, tmp_path / "b")
    back = read_colmap(tmp_path / "b")
    for name, photo in network.photos.items():
        other = back.photos[name]
        np.testing.assert_allclose(other.rotation, photo.rotation, atol=1e-15)
        np.testing.assert_allclose(other.position, photo.position, atol=5e-15 * 10)
    for name, camera in network.cameras.items():
        np.testing.assert_allclose(back.cameras[name].values, camera.values, rtol=1e-15, atol=1e-17)
        assert back.cameras[name].fixed == camera.fixed
    assert {n: p.coordinates for n, p in back.points.items()} == {
        n: p.coordinates for n, p in network.points.items()
    }


def test_text_and_binary_files_are_those_of_pycolmap(tmp_path: Path) -> None:
    made = synthetic(7, cameras=2)
    binary, text = written(made, tmp_path / "b"), written(made, tmp_path / "t", text=True)
    model = read_sparse_model(binary)
    for name, data in binary_files(model).items():
        assert data == (binary / name).read_bytes()
    for name, lines in text_files(read_sparse_model(text)).items():
        expected = (text / name).read_text().split("\n")
        rows = [[_value(w) for w in line.split()] for line in expected if not line.startswith("#")]
        ours = [[_value(w) for w in line.split()] for line in lines.split("\n") if line[:1] != "#"]
        assert ours == rows


def _value(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


def test_model_in_a_system_of_its_own_is_carried_to_that_of_the_tables(tmp_path: Path) -> None:
    """Control points by marks, positions of photos, and a check point, in grid coordinates."""
    made = synthetic(8, frames=5)
    true = {i: elsewhere(p.xyz)[0] for i, p in made.points3D.items()}
    rng = np.random.default_rng(1)
    chosen = sorted(true)[:5]
    control = {f"G{i}": true[i] + rng.normal(0.0, 0.005, 3) for i in chosen[:4]}
    check = true[chosen[4]]
    marks = ["photo,point,x,y,sigma"]
    for image in made.images.values():
        for i in chosen:
            x, y = image.project_point(made.points3D[i].xyz) + rng.normal(0.0, PIXELS, 2)
            marks.append(f"{image.name},G{i},{x},{y},{PIXELS}")
    priors = ["photo,x,y,z,sigma_m,sigma_z_cm"]
    for image in made.images.values():
        at = elsewhere(image.projection_center())[0] + rng.normal(0.0, [0.02, 0.02, 0.04])
        priors.append(f"{image.name},{at[0]},{at[1]},{at[2]},0.02,4")
    for table in (marks, priors):
        (tmp_path / f"{table is marks}.csv").write_text("\n".join(table) + "\n")
    rows = [",".join([n, *map(str, x.tolist()), "5", "", "", ""]) for n, x in control.items()]
    rows.append(",".join([f"G{chosen[4]}", "", "", "", "", *map(str, check.tolist())]))
    header = "name,x,y,z,sigma_mm,check_x,check_y,check_z"
    (tmp_path / "control.csv").write_text("\n".join([header, *rows]) + "\n")
    disturb(made, pixels=PIXELS)
    network = read_colmap(
        written(made, tmp_path / "m"),
        sigma=PIXELS,
        control=tmp_path / "control.csv",
        marks=tmp_path / "True.csv",
        priors=tmp_path / "False.csv",
    )
    assert network.datum == "given"
    solution = fga.adjust(network)
    assert 0.9 < solution.sigma0 < 1.1
    for i, at in true.items():
        off = (solution.point(str(i)) - at) / solution.standard_deviations(str(i))
        assert np.abs(off).max() < 4.5
    assert np.linalg.norm(solution.point(f"G{chosen[4]}") - check) < 0.1
    sources = {o.source for o in network.observations.values()}
    assert sources == {f"False.csv:{i}" for i in range(2, len(made.images) + 2)}
    assert "True.csv:2" in network.images.sources.values()


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (lambda x, y, h: (x, y), None),
        (lambda x, y, h: (x + 0.5, y + 0.5), None),
        (lambda x, y, h: (x, h - y), "with y counted upwards from the lower edge by 0"),
        (lambda x, y, h: (y, x), "with x and y exchanged by 0"),
        (lambda x, y, h: (0.5 * x, 0.5 * y), None),  # wrong, and no reason is known
    ],
)
def test_marks_along_other_axes_are_refused(tmp_path: Path, axes: Any, message: str | None) -> None:
    """The poses of the model tell it; an adjustment of such marks has no sense."""
    made = synthetic(8, frames=5)
    true = {i: elsewhere(p.xyz)[0] for i, p in made.points3D.items()}
    rng, rows = np.random.default_rng(1), ["photo,point,x,y"]
    for image in made.images.values():
        height = made.cameras[image.camera_id].height
        for i in sorted(true)[:5]:
            x, y = image.project_point(made.points3D[i].xyz) + rng.normal(0.0, PIXELS, 2)
            x, y = axes(x, y, height)
            rows.append(f"{image.name},G{i},{x},{y}")
    (tmp_path / "marks.csv").write_text("\n".join(rows) + "\n")
    control = {f"G{i}": true[i] for i in sorted(true)[:5]}
    tables = {
        "control": control_table(tmp_path / "control.csv", control),
        "marks": tmp_path / "marks.csv",
    }
    folder = written(made, tmp_path / "m")
    if message is None:
        assert read_colmap(folder, **tables).n_image_points == len(rows) - 1 + sum(
            p.track.length() for p in made.points3D.values()
        )
        return
    with pytest.raises(InputError, match=r"^marks\.csv: the rays of the marks of 5 .*" + message):
        read_colmap(folder, **tables)


def test_shift_brings_grid_coordinates_near_the_origin(tmp_path: Path) -> None:
    made = synthetic(9)
    control = {str(i): elsewhere(p.xyz)[0] for i, p in made.points3D.items()}
    table = control_table(tmp_path / "control.csv", control)
    network = read_colmap(written(made, tmp_path / "m"), control=table)
    fga.write_colmap(network, tmp_path / "out", shift=ORIGIN.tolist())
    back = read_colmap(tmp_path / "out")
    for name, at in control.items():
        np.testing.assert_allclose(back.points[name].coordinates, at - ORIGIN, atol=1e-8)
    for name, photo in network.photos.items():
        shifted = np.array(photo.position) - ORIGIN
        np.testing.assert_allclose(back.photos[name].position, shifted, atol=1e-8)


def test_keypoints_with_larger_scale_have_larger_sigma(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    path = tmp_path / "database.db"
    made = synthetic(10, database=path)
    folder = written(made, tmp_path / "m")
    rng = np.random.default_rng(2)
    database = pycolmap.Database.open(str(path))
    scales = {}
    for image in made.images.values():
        keypoints = database.read_keypoints(image.image_id)
        scale = rng.uniform(0.5, 8.0, len(keypoints)).astype(np.float32)
        table = np.column_stack([keypoints[:, :2], scale, np.zeros(len(scale))])
        scales[image.name] = (image.image_id, table.astype("<f4"))
    database.close()
    with sqlite3.connect(path) as raw:
        for number, table in scales.values():
            raw.execute(
                "UPDATE keypoints SET rows=?, cols=4, data=? WHERE image_id=?",
                (len(table), table.tobytes(), number),
            )
    raw.close()
    network = read_colmap(folder, sigma=0.7, sigma_by_scale=path)
    used = {
        image.name: [k for k, p in enumerate(image.points2D) if p.has_point3D()]
        for image in made.images.values()
    }
    every = np.concatenate([scales[n][1][used[n], 2] for n in used])
    _, _, _, sigma = network.images.columns()
    assert np.median(sigma) == pytest.approx(0.7)
    names = list(network.photos)
    photo = network.images.columns()[0]
    for i, name in enumerate(names):
        expected = 0.7 * scales[name][1][used[name], 2].astype(float) / np.median(every)
        np.testing.assert_allclose(sigma[photo == i, 0], expected, rtol=1e-7)


def test_simulated_ties_of_a_rig_are_still_those_of_a_rig(tmp_path: Path) -> None:
    """`measure` gives ties values of 10⁻⁸ rad."""
    network = read_colmap(written(synthetic(13, cameras=2, frames=3), tmp_path / "a"))
    fga.write_colmap(measure(network, seed=1), tmp_path / "b")
    assert list(read_colmap(tmp_path / "b").mounts) == list(network.mounts)


def test_calibration_and_mounts_can_be_held(tmp_path: Path) -> None:
    folder = written(synthetic(11, cameras=2), tmp_path)
    free = {
        calibration: read_colmap(folder, calibration=calibration).cameras["1"].fixed
        for calibration in ("colmap", "all", "held")
    }
    assert free["colmap"] == (False, True, True, False) + (True,) * 4
    assert free["all"] == (False, False, False, False) + (True,) * 4
    assert all(free["held"])
    mounts = read_colmap(folder, mounts="held").mounts
    assert list(mounts) == ["rig 1 camera 2", "rig 2 camera 4"]
    assert all(all(m.fixed) for m in mounts.values())


# -- what cannot be written -----------------------------------------------------------------------


def test_everything_that_colmap_cannot_express_is_named_at_once(tmp_path: Path) -> None:
    network = Network("several faults")
    network.add_camera("film", NoDistortion(), {"c": 50.0})
    network.add_camera("metric", BrownLens(), {"c": 5000.0}, unit="px", format=(4000, 3000))
    network.add_photo("a", "film")
    network.add_photo("b ", "metric", position=(0, 0, 5), omega_phi_kappa=(0, 0, 0))
    network.add_point("P")
    network.add_image_points("a", ["P"], [(1.0, 2.0)], sigma=0.01)
    (tmp_path / "cameras.txt").write_text("")
    with pytest.raises(InputError) as error:
        fga.write_colmap(network, tmp_path)
    told = str(error.value)
    for part in (
        "the folder has cameras.txt",
        "photo 'a': has no pose",
        "photo 'b ': a name with line breaks, or blanks at its ends",
        "point 'P': has no coordinates",
        "camera 'film': image coordinates are mm, not pixels",
        "camera 'film': needs a format in whole pixels",
        "camera 'metric': COLMAP has no camera model of the lens model 'brown'",
    ):
        assert part in told
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cameras.txt"]


def test_command_converts_a_model_to_a_project_and_back(tmp_path: Path) -> None:
    folder = written(synthetic(12, points=12, frames=3), tmp_path / "sparse")
    project = tmp_path / "project" / "project.toml"
    assert main(["convert", str(folder), str(project), "--set", "sigma=0.5"]) == 0
    assert main(["convert", str(project), str(tmp_path / "back"), "--to", "colmap"]) == 0
    there, back = read_colmap(folder), read_colmap(tmp_path / "back")
    np.testing.assert_array_equal(back.images.columns()[2], there.images.columns()[2])
    assert list(back.photos) == list(there.photos)
