"""PLY files, read by a parser that knows only the header."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.export.dxf_ply import write_ply
from tests.networks.mapped import in_plane

TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1"}


def parsed(file):
    """Return the vertices of a PLY file with one element, by its header."""
    head, body = file.read_bytes().split(b"end_header\n", 1)
    lines = head.decode("ascii").splitlines()
    assert lines[0] == "ply"
    form = next(line.split()[1] for line in lines if line.startswith("format"))
    (n,) = [int(line.split()[2]) for line in lines if line.startswith("element vertex")]
    properties = [line.split()[1:] for line in lines if line.startswith("property")]
    dtype = np.dtype([(name, TYPES[kind]) for kind, name in properties])
    if form == "ascii":
        rows = [tuple(map(float, line.split())) for line in body.decode("ascii").splitlines()]
        found = np.array(rows, dtype=dtype)
    else:
        assert form == "binary_little_endian"
        found = np.frombuffer(body, dtype)
    assert len(found) == n
    return found


@pytest.mark.parametrize("binary", [True, False])
def test_vertices_are_points_and_then_projection_centres(tmp_path, binary):
    s = in_plane()
    write_ply(s, tmp_path / "a.ply", binary=binary)
    found = parsed(tmp_path / "a.ply")
    n, names = len(s.network.points), list(s.network.points)
    at = np.column_stack([found[a] for a in "xyz"])
    assert np.array_equal(at[:n], s.state["point"]), "every bit"
    assert np.array_equal(at[n:], [s.pose(f).position for f in s.network.photos])
    assert found["kind"].tolist() == [0] * n + [1] * 4
    sigma = np.column_stack([found[f"sigma_{a}"] for a in "xyz"])
    expected = [s.standard_deviations(name) for name in names]
    assert np.allclose(sigma[:n], expected, rtol=1e-6)
    expected = [np.sqrt(np.diag(s.pose_covariance(f))[3:]) for f in s.network.photos]
    assert np.allclose(sigma[n:], expected, rtol=1e-6)
    colours = {
        k: tuple(int(found[c][i]) for c in ("red", "green", "blue"))
        for k, i in (("new", names.index("P1")), ("check", names.index("P3")), ("photo", n))
    }
    assert len(set(colours.values())) == 3


def test_a_name_of_several_lines_does_not_break_the_header(tmp_path):
    s = in_plane()
    network = s.network.copy()
    network.name = "häuser\nend_header\nelement vertex 7"
    write_ply(fga.adjust(network), tmp_path / "a.ply")
    assert len(parsed(tmp_path / "a.ply")) == len(s.network.points) + 4


def test_a_network_without_photos_has_points_alone(tmp_path):
    network = fga.Network("line")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (9, 0, 0), fixed="yz")
    network.add(fga.SlopeDistance("A", "B", 10.0, sigma=0.01))
    write_ply(fga.adjust(network), tmp_path / "a.ply", binary=False)
    assert parsed(tmp_path / "a.ply")["x"].tolist() == pytest.approx([0.0, 10.0])
