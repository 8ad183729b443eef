"""Precision maps as files, read by parsers that know only their heads."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.export import precision_files
from factorgraph_adj.quality.precision_maps import PrecisionMap
from tests.networks.mapped import in_plane


def test_vertices_of_ply_have_standard_deviations_in_metres(tmp_path):
    s = in_plane()
    found = fga.precision_map(s)
    fga.write_precision_map(found, tmp_path / "a.PLY")
    head, body = (tmp_path / "a.PLY").read_bytes().split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = ["x", "y", "z", "sx", "sy", "sz"]
    expected = [f"property double {name}" for name in names] + ["property int photos"]
    assert [line for line in lines if line.startswith("property")] == expected
    assert f"element vertex {len(found.points)}" in lines
    out = np.frombuffer(body, dtype=[*((n, "<f8") for n in names), ("photos", "<i4")])
    assert np.array_equal(np.column_stack([out[n] for n in names[:3]]), s.state["point"])
    sigmas = np.array([s.standard_deviations(n) for n in s.network.points])
    assert np.allclose(np.column_stack([out[n] for n in names[3:]]), sigmas, rtol=1e-12)
    assert np.array_equal(out["photos"], found.photos)


def test_tables_have_millimetres_and_covariances(tmp_path):
    s = in_plane()
    fga.write_precision_map(s, tmp_path / "a.txt")
    fga.write(s, tmp_path / "b.txt")
    text = (tmp_path / "a.txt").read_text(encoding="ascii")
    assert text == (tmp_path / "b.txt").read_text(encoding="ascii")
    head, *lines = text.splitlines()
    columns = "X(m) Y(m) Z(m) sX(mm) sY(mm) sZ(mm)"
    columns += " covXX(m2) covXY(m2) covXZ(m2) covYY(m2) covYZ(m2) covZZ(m2)"
    assert head == columns.replace(" ", "\t")
    table = np.array([[float(v) for v in line.split("\t")] for line in lines])
    assert np.array_equal(table[:, :3], s.state["point"]), "every bit"
    for row, name in zip(table, s.network.points, strict=True):
        covariance = s.covariance(name)
        assert np.allclose(row[3:6], 1000.0 * np.sqrt(np.diag(covariance)), rtol=1e-8)
        assert np.allclose(row[6:], covariance[np.triu_indices(3)], rtol=1e-8, atol=1e-24)


def test_clouds_of_las_have_standard_deviations_as_extra_dimensions(tmp_path):
    laspy = pytest.importorskip("laspy")
    s = in_plane()
    found = fga.precision_map(s)
    fga.write_precision_map(found, tmp_path / "a.las")
    fga.write(s, tmp_path / "b.las")
    assert (tmp_path / "a.las").read_bytes() == (tmp_path / "b.las").read_bytes()
    cloud = laspy.read(tmp_path / "a.las")
    assert str(cloud.header.version) == "1.4"
    assert np.allclose(cloud.xyz, found.points, rtol=0, atol=0.5001e-6), "steps of 1 µm"
    fields = {d.name: d.dtype for d in cloud.point_format.extra_dimensions}
    sigmas, covariances = [f"sigma_{a}" for a in "xyz"], ["cov_xy", "cov_xz", "cov_yz"]
    assert fields == dict.fromkeys([*sigmas, *covariances], np.float32) | {"photos": np.int32}
    digits = np.finfo(np.float32).eps
    for i, name in enumerate(sigmas):
        assert np.allclose(cloud[name], found.sigmas[:, i], rtol=digits), name
    for (i, j), name in zip(((0, 1), (0, 2), (1, 2)), covariances, strict=True):
        assert np.allclose(cloud[name], found.covariances[:, i, j], rtol=digits), name
    assert np.array_equal(cloud["photos"], found.photos)


@pytest.mark.parametrize(("length", "step"), [(4e3, 1e-6), (40e3, 1e-5), (420e3, 1e-4)])
def test_coordinates_of_las_keep_a_tenth_of_a_millimetre(tmp_path, length, step):
    """Coordinates of a grid, 6 000 km from its origin; a point without a covariance has NaN."""
    laspy = pytest.importorskip("laspy")
    points = np.array([[5e5, 6e6, 100.0], [5e5 + length, 6e6 + 0.98765432, -3.1234567]])
    covariances = np.array([np.diag([1e-6, 4e-6, 9e-6]), np.full((3, 3), np.nan)])
    found = PrecisionMap(points, covariances, np.array([3, 1]))
    fga.write_precision_map(found, tmp_path / "a.las")
    cloud = laspy.read(tmp_path / "a.las")
    assert np.array_equal(cloud.header.scales, [step] * 3)
    assert np.abs(cloud.xyz - points).max() <= 0.5001 * step <= 0.1e-3
    assert np.allclose(cloud["sigma_z"], [3e-3, np.nan], equal_nan=True)


def test_clouds_that_las_cannot_hold_are_refused(tmp_path):
    pytest.importorskip("laspy")
    found = PrecisionMap(np.diag([9e5, 0.0, 0.0]), np.zeros((3, 3, 3)), np.zeros(3, dtype=int))
    with pytest.raises(fga.InputError, match=r"points are 450 km away; valid: \.ply or \.txt"):
        fga.write_precision_map(found, tmp_path / "a.las")
    assert not list(tmp_path.iterdir())


def test_a_cloud_of_las_may_be_empty(tmp_path):
    laspy = pytest.importorskip("laspy")
    none = PrecisionMap(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=int))
    fga.write_precision_map(none, tmp_path / "a.las")
    assert len(laspy.read(tmp_path / "a.las")) == 0


def test_without_laspy_the_message_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setattr(precision_files, "find_spec", lambda name: None)
    with pytest.raises(fga.InputError, match=r"pip install 'factorgraph_adj\[las\]'"):
        fga.write_precision_map(in_plane(), tmp_path / "a.las")


def test_other_suffixes_and_objects_are_refused(tmp_path):
    s = in_plane()
    with pytest.raises(
        fga.InputError, match=r"a precision map is written as \.ply or \.las or \.txt"
    ):
        fga.write_precision_map(s, tmp_path / "a.csv")
    with pytest.raises(fga.InputError, match="write_precision_map takes a"):
        fga.write_precision_map(s.network, tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())
