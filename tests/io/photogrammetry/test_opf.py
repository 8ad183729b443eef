"""Open Photogrammetry Format: there and back, with pyopf as a second reader, and its traps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.networks.pixel_block import assert_same_results, pixel_block, projected


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "block.opf"
    fga.write_opf(pixel_block(free=FREE), path)
    return path


FREE = ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2")


def change(path: Path, file: str, edit: object) -> None:
    """Change a document of a project."""
    target = path.parent / file
    document = json.loads(target.read_text(encoding="utf-8"))
    edit(document)  # type: ignore[operator]
    target.write_text(json.dumps(document, indent=1), encoding="utf-8")


# -- there and back -------------------------------------------------------------------------------


def test_what_is_written_is_read_again(written: Path) -> None:
    network, again = pixel_block(free=FREE), fga.read(written)
    assert list(again.photos) == list(network.photos)
    assert sorted(again.points) == sorted(network.points)
    assert again.cameras["DSC 1"] == network.cameras["DSC 1"]
    assert again.points["P4"].check == network.points["P4"].check
    for name, photo in network.photos.items():
        assert again.photos[name].position == photo.position
        assert np.asarray(again.photos[name].rotation) == pytest.approx(photo.rotation, abs=1e-14)
    assert_same_results(network, again)


def test_an_adjusted_block_is_read_at_its_minimum(tmp_path: Path) -> None:
    solution = fga.adjust(pixel_block(free=FREE))
    fga.write_opf(solution.as_network(), tmp_path / "adjusted.opf")
    again = fga.adjust(fga.read(tmp_path / "adjusted.opf"))
    assert again.vtpv == pytest.approx(solution.vtpv, rel=1e-9)


def test_pyopf_reads_what_is_written(written: Path) -> None:
    """The library of the format finds every item, and the same numbers."""
    pyopf = pytest.importorskip("pyopf")
    del pyopf
    from pyopf.io import load
    from pyopf.resolve import resolve

    objects = resolve(load(str(written)))
    network = pixel_block(free=FREE)
    cameras = objects.calibration.calibrated_cameras
    assert [tuple(c.position) for c in cameras.cameras] == [
        p.position for p in network.photos.values()
    ]
    internals = cameras.sensors[0].internals
    assert internals.focal_length_px == 1500.0
    assert tuple(internals.principal_point_px) == (1003.5, 748.25)
    control = objects.input_control_points
    assert len(control.gcps) == 6 and sum(g.is_checkpoint for g in control.gcps) == 1
    assert len(control.mtps) == 6
    (scale,) = objects.constraints.scale_constraints
    assert (scale.id_from, scale.id_to, scale.sigma) == ("P1", "P7", 0.002)


def test_the_tangential_terms_are_those_of_opencv(written: Path) -> None:
    """u = f (x d + 2 T1 x y + T2 (r² + 2x²)) + cx: pyopf's compute_reprojection_error."""
    network = pixel_block(observed=False)
    network.add_point("Q", (4.0, 3.0, 0.5))
    ours = projected(network, ["Q"])["IMG 1.jpg"][0]
    documents = written.parent / "calibrated-cameras.json"
    said = json.loads(documents.read_text(encoding="utf-8"))
    inner, pose = said["sensors"][0]["internals"], said["cameras"][1]
    from factorgraph_adj.rotation import world_R_photogrammetric

    rotation = world_R_photogrammetric(*np.deg2rad(pose["orientation_deg"]))
    q = rotation.T @ (np.array((4.0, 3.0, 0.5)) - pose["position"])
    x, y = q[0] / -q[2], -q[1] / -q[2]
    r2 = x * x + y * y
    d = 1 + np.dot(inner["radial_distortion"], (r2, r2**2, r2**3))
    t1, t2 = inner["tangential_distortion"]
    u = x * d + 2 * t1 * x * y + t2 * (r2 + 2 * x * x)
    v = y * d + 2 * t2 * x * y + t1 * (r2 + 2 * y * y)
    pixel = np.array(inner["principal_point_px"]) + inner["focal_length_px"] * np.array((u, v))
    assert np.array((ours[0], -ours[1])) == pytest.approx(pixel, abs=1e-9)


# -- traps ----------------------------------------------------------------------------------------


def test_ids_of_64_bits_are_kept_apart(written: Path) -> None:
    """18446744073709551615 and …614 are one number in double precision."""
    big = 2**64 - 1
    for file, key in (
        ("camera-list.json", "cameras"),
        ("calibrated-cameras.json", "cameras"),
    ):
        change(written, file, lambda d, k=key: _renumber(d[k], big))
    change(written, "input-cameras.json", lambda d: _renumber_captures(d["captures"], big))
    change(written, "input-control-points.json", lambda d: _renumber_marks(d, big))
    again = fga.read(written)
    assert list(again.photos) == [f"IMG {i}.jpg" for i in range(4)]
    assert again.n_image_points == 48


def _renumber(cameras: list[dict[str, int]], big: int) -> None:
    for camera in cameras:
        camera["id"] = big - camera["id"]


def _renumber_captures(captures: list[dict], big: int) -> None:
    for capture in captures:
        _renumber(capture["cameras"], big)
        capture["reference_camera_id"] = big - capture["reference_camera_id"]


def _renumber_marks(document: dict, big: int) -> None:
    for point in document["gcps"] + document["mtps"]:
        for mark in point["marks"]:
            mark["camera_id"] = big - mark["camera_id"]


def test_the_shift_is_added_after_scale_and_swap(written: Path) -> None:
    """Control in the base system alone: feet, northing first, recentred."""

    def base(document: dict) -> None:
        document["base_to_canonical"] = {
            "scale": [0.3048, 0.3048, 0.3048],
            "shift": [-100.0, -200.0, -30.0],
            "swap_xy": True,
        }

    def given(document: dict) -> None:
        place = document["gcps"][0]["geolocation"]
        place["coordinates"] = [300.0 / 0.3048, 150.0 / 0.3048, 40.0 / 0.3048]
        place["sigmas"] = [1.0, 2.0, 3.0]

    change(written, "scene-reference-frame.json", base)
    change(written, "input-control-points.json", given)
    change(written, "projected-control-points.json", lambda d: d["projected_gcps"].clear())
    network = fga.read(written, tie_points=False)
    control = next(o for o in network.observations.values() if o.kind == "control")
    assert isinstance(control, fga.ControlPoint)
    assert control.value == pytest.approx((50.0, 100.0, 10.0), abs=1e-12)
    assert control.sigma == pytest.approx((0.6096, 0.3048, 0.9144), abs=1e-12)
    change(
        written,
        "input-control-points.json",
        lambda d: d["gcps"][0]["geolocation"]["crs"].update(definition="EPSG:4326"),
    )
    with pytest.raises(InputError, match="need projected_control_points"):
        fga.read(written)


def test_accuracies_of_marks_are_multiples_of_the_given_standard_deviation(written: Path) -> None:
    network = fga.read(written, sigma_mark_px=3.0)
    assert np.unique(network.images.columns()[3]).tolist() == [1.5]


def test_a_bias_of_positions_is_refused_unless_they_are_left_out(written: Path) -> None:
    bias = {
        "format": "application/opf-gps-bias+json",
        "version": "1.0",
        "transform": {"rotation_deg": [1, 2, 3], "translation": [1, 1, 1], "scale": 1.0},
    }
    (written.parent / "gps-bias.json").write_text(json.dumps(bias), encoding="utf-8")
    entry = {"uri": "gps-bias.json", "format": "application/opf-gps-bias+json"}
    change(written, written.name, lambda d: d["items"][-1]["resources"].append(entry))
    with pytest.raises(InputError, match=r"gps_bias.*positions='leave out' \(--set"):
        fga.read(written)
    network = fga.read(written, positions="leave out")
    assert "photo_position" not in {o.kind for o in network.observations.values()}


def test_other_cameras_are_refused(written: Path) -> None:
    change(
        written,
        "calibrated-cameras.json",
        lambda d: d["sensors"][0]["internals"].update(type="fisheye"),
    )
    with pytest.raises(InputError, match=r"calibrated-cameras.json:\d+: a fisheye camera cannot"):
        fga.read(written)


def test_a_rig_is_refused_or_read_as_photos_apart(written: Path) -> None:
    def join(document: dict) -> None:
        first, second, *_ = document["captures"]
        first["cameras"] += second["cameras"]
        document["captures"].remove(second)

    change(written, "input-cameras.json", join)
    with pytest.raises(InputError, match=r"rigs=apart \(--set"):
        fga.read(written)
    assert len(fga.read(written, rigs="apart").photos) == 4


# -- tie points -----------------------------------------------------------------------------------


def add_cloud(path: Path, network: fga.Network) -> None:
    """Put the manual tie points into a point cloud instead, as Pix4D stores tie points."""
    names = [n for n in network.points if n in ("P1", "P3", "P5", "P7", "P8", "P10")]
    photo, point, xy, _ = network.images.columns()
    order = list(network.points)
    ranges, cameras, pixels = [], [], []
    for name in names:
        rows = np.flatnonzero(point == order.index(name))
        packed = len(cameras) | (len(rows) << 40)
        ranges.append((packed & 0xFFFFFFFF, packed >> 32))
        cameras += photo[rows].tolist()
        pixels += (xy[rows] * (1, -1)).tolist()
    place = np.array([network.points[n].coordinates for n in names]) - (100.0, 200.0, 50.0)
    columns = {
        "positions.bin": (place.astype("<f4"), 5126, "VEC3"),
        "ranges.bin": (np.array(ranges, "<u4"), 5125, "VEC2"),
        "cameras.bin": (np.array(cameras, "<u4"), 5125, "SCALAR"),
        "pixels.bin": (np.array(pixels, "<f4"), 5126, "VEC2"),
    }
    matrix = np.eye(4)
    matrix[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # z up to y up
    matrix[:3, 3] = matrix[:3, :3] @ (100.0, 200.0, 50.0)
    for name, (values, _, _) in columns.items():
        (path.parent / name).write_bytes(values.tobytes())
    matches = {
        "cameraUids": [1, 2, 3, 4],
        "cameraIds": 2,
        "pointIndexRanges": 1,
        "imagePoints": {"pixelCoordinates": 3, "featureIds": 3, "scales": 3},
    }
    primitive = {
        "attributes": {"POSITION": 0},
        "mode": 0,
        "extensions": {"OPF_mesh_primitive_matches": matches},
    }
    document = {
        "asset": {"version": "2.0", "extensions": {"OPF_asset_version": {"version": "1.0"}}},
        "accessors": [
            {"bufferView": i, "componentType": kind, "count": len(values), "type": wide}
            for i, (values, kind, wide) in enumerate(columns.values())
        ],
        "bufferViews": [{"buffer": i, "byteLength": 1, "byteOffset": 0} for i in range(4)],
        "buffers": [{"uri": n, "byteLength": 1} for n in columns],
        "meshes": [{"primitives": [primitive]}],
        "nodes": [{"mesh": 0, "matrix": matrix.T.ravel().tolist()}],
    }
    (path.parent / "sparse.gltf").write_text(json.dumps(document), encoding="utf-8")
    entry = {"uri": "sparse.gltf", "format": "model/gltf+json"}
    change(path, path.name, lambda d: d["items"][-1]["resources"].append(entry))
    change(path, "constraints.json", lambda d: d["scale_constraints"].clear())
    change(path, "input-control-points.json", lambda d: d["mtps"].clear())


def test_tie_points_of_the_point_cloud_are_read(written: Path) -> None:
    """Single precision: 5e-5 of a pixel in 2000, so that vᵀPv agrees to a part of 1e-3."""
    network = pixel_block(free=FREE)
    add_cloud(written, network)
    again = fga.read(written, sigma_px=0.5)
    ties = [n for n in again.points if n.startswith("tie ")]
    assert len(ties) == 6 and again.n_image_points == 48
    assert again.points["tie 1"].coordinates == pytest.approx(
        network.points["P3"].coordinates, abs=1e-4
    )
    without = network.copy()
    without.observations = {k: o for k, o in network.observations.items() if k != "bar"}
    a, b = fga.adjust(without), fga.adjust(again)
    assert (a.n_observations, a.n_unknowns) == (b.n_observations, b.n_unknowns)
    assert b.vtpv == pytest.approx(a.vtpv, rel=1e-3)


def test_a_cut_buffer_and_a_missing_one_are_told(written: Path) -> None:
    add_cloud(written, pixel_block(free=FREE))
    pixels = written.parent / "pixels.bin"
    pixels.write_bytes(pixels.read_bytes()[:40])
    with pytest.raises(InputError, match=r"gltf:1: pixels\.bin is cut: 192 bytes from byte 0, but"):
        fga.read(written)
    pixels.unlink()
    with pytest.raises(InputError, match=r"sparse\.gltf:\d+: file pixels\.bin cannot be read"):
        fga.read(written)


# -- writing --------------------------------------------------------------------------------------


def test_what_cannot_be_expressed_is_told_at_once(tmp_path: Path) -> None:
    network = pixel_block(affine=True)
    network.add(fga.HeightDifference("P0", "P2", 0.1, sigma=0.01))
    network.add_point("held", (1, 2, 3), fixed="xyz")
    with pytest.raises(InputError) as caught:
        fga.write_opf(network, tmp_path / "no.opf")
    told = "\n".join(map(str, caught.value.problems))
    for words in ("a height difference", "held coordinates", "the lens model 'normalised_affine'"):
        assert words in told
    assert not list(tmp_path.iterdir())


def test_addresses_outside_the_folder_are_refused(written: Path) -> None:
    for uri in ("../../etc/passwd", "file:///etc/passwd", "http://host/x.json"):
        change(
            written,
            written.name,
            lambda d, u=uri: d["items"][0]["resources"][0].update(uri=u),
        )
        with pytest.raises(InputError, match=r"must be a path relative|lies outside the folder"):
            fga.read(written)
