"""A drawing for CAD programs: entities, layers, and the ellipses as ellipses."""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.export.dxf_ply import write_dxf
from tests.networks.mapped import geocentric, in_plane, in_utm
from tests.networks.small_block import blundered

ezdxf = pytest.importorskip("ezdxf", reason="the extra dxf is not installed")


def drawn(file):
    """Return the drawing after an audit that finds nothing."""
    document = ezdxf.readfile(file)
    audit = document.audit()
    assert not audit.errors and not audit.fixes
    return document


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    file = tmp_path_factory.mktemp("dxf") / "block.dxf"
    write_dxf(in_plane(), file, exaggeration=1.0)
    return drawn(file)


def test_entities_stand_on_their_layers(plane):
    s = in_plane()
    found = Counter((e.dxftype(), e.dxf.layer) for e in plane.modelspace())
    n = len(s.network.points)
    assert found["POINT", "POINTS"] == found["TEXT", "POINT_NAMES"] == n
    assert found["POINT", "PHOTOS"] == found["TEXT", "PHOTO_NAMES"] == 4
    assert found["POLYLINE", "FOOTPRINTS"] == 2, "the others see the horizon in a corner"
    assert found["ELLIPSE", "ELLIPSES"] + found["LINE", "ELLIPSES"] == n - 1
    assert plane.units == 6 and plane.dxfversion == "AC1024"
    assert not any(layer == "IMAGE_RAYS" for _, layer in found)
    observed = s.network.observations.values()
    pairs = {frozenset(o.points()) for o in observed if len(o.points()) == 2}
    assert found["LINE", "OBSERVATIONS"] == len(pairs), "each line once"


def test_points_have_the_adjusted_coordinates(plane):
    at = [tuple(e.dxf.location) for e in plane.modelspace().query('POINT[layer=="POINTS"]')]
    assert at == [tuple(in_plane().point(n)) for n in in_plane().network.points]


def test_an_ellipse_has_its_axes_and_its_azimuth(plane):
    s = in_plane()
    expected = [fga.error_ellipse(s, n) for n in s.network.points]
    expected = [e for e in expected if e.semi_axes[1] > 1e-6 * e.semi_axes[0]]
    found = list(plane.modelspace().query("ELLIPSE"))
    assert len(found) == len(expected)
    for ellipse, e in zip(found, expected, strict=True):
        a, b = e.semi_axes
        major = np.array(ellipse.dxf.major_axis)
        assert np.allclose(ellipse.dxf.center, e.centre, atol=1e-12)
        assert np.linalg.norm(major) == pytest.approx(a, rel=1e-9)
        assert ellipse.dxf.ratio == pytest.approx(b / a, rel=1e-9)
        azimuth = np.arctan2(major[0], major[1]) % np.pi
        assert abs((azimuth - e.azimuth + np.pi / 2) % np.pi - np.pi / 2) < 1e-6


def test_suspects_have_a_layer_of_their_own(tmp_path):
    write_dxf(fga.adjust(blundered()), tmp_path / "a.dxf", rays=True)
    found = Counter(e.dxf.layer for e in drawn(tmp_path / "a.dxf").modelspace())
    assert found["SUSPECTS"] >= 2 and found["IMAGE_RAYS"] > 30
    write_dxf(in_plane(), tmp_path / "b.dxf", rays=True)
    clean = Counter(e.dxf.layer for e in drawn(tmp_path / "b.dxf").modelspace())
    assert clean["IMAGE_RAYS"] + clean["SUSPECTS"] == 48


def test_a_drawing_is_in_the_grid_where_there_is_one(tmp_path):
    pytest.importorskip("pyproj")
    write_dxf(in_utm(), tmp_path / "a.dxf")
    found = drawn(tmp_path / "a.dxf").modelspace().query('POINT[layer=="POINTS"]')
    at = [tuple(e.dxf.location) for e in found]
    assert np.abs(np.array(at) - fga.grid_coordinates(in_utm()).coordinates).max() < 5e-9


def test_a_geocentric_network_has_no_plan(tmp_path):
    with pytest.raises(fga.InputError, match=r"DXF has a plan in metres.*projected"):
        write_dxf(fga.adjust(geocentric()), tmp_path / "a.dxf")
    assert not list(tmp_path.iterdir())


def test_the_same_solution_gives_the_same_file(tmp_path):
    for name in "ab":
        write_dxf(in_plane(), tmp_path / f"{name}.dxf")
    assert (tmp_path / "a.dxf").read_bytes() == (tmp_path / "b.dxf").read_bytes()
    assert ezdxf.options.write_fixed_meta_data_for_testing is False


def test_text_has_the_height_that_is_asked_for(tmp_path):
    write_dxf(in_plane(), tmp_path / "a.dxf", text_height=0.25)
    texts = drawn(tmp_path / "a.dxf").modelspace().query("TEXT")
    assert {t.dxf.height for t in texts} == {0.25}
    with pytest.raises(fga.InputError, match="text_height must be greater than zero, not -1"):
        write_dxf(in_plane(), tmp_path / "b.dxf", text_height=-1)


def test_without_ezdxf_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr("factorgraph_adj.export.dxf_ply.find_spec", lambda _: None)
    with pytest.raises(fga.InputError, match=r"pip install 'factorgraph_adj\[dxf\]'"):
        write_dxf(in_plane(), tmp_path / "a.dxf")


def test_other_drawings_keep_their_dates():
    assert sys.modules["ezdxf"].options.write_fixed_meta_data_for_testing is False
