"""Precision maps as files, read by parsers that know only their heads."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
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


def test_other_suffixes_and_objects_are_refused(tmp_path):
    s = in_plane()
    with pytest.raises(fga.InputError, match=r"a precision map is written as \.ply or \.txt"):
        fga.write_precision_map(s, tmp_path / "a.csv")
    with pytest.raises(fga.InputError, match="write_precision_map takes a"):
        fga.write_precision_map(s.network, tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())
