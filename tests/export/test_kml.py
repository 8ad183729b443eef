"""KML: parsed again, on the ground, longitude first."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.export.geojson_kml import write_kml
from tests.networks.mapped import in_plane, in_utm, mapped

pytest.importorskip("pyproj", reason="the extra crs is not installed")

SPACE = {"k": "http://www.opengis.net/kml/2.2"}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    file = tmp_path_factory.mktemp("kml") / "block.kml"
    write_kml(in_utm(), file)
    return ET.parse(file).getroot()


def folder(root, name):
    (found,) = [
        f for f in root.iterfind(".//k:Folder", SPACE) if f.findtext("k:name", "", SPACE) == name
    ]
    return found


def test_each_layer_is_a_folder_with_a_style(root):
    names = [f.findtext("k:name", "", SPACE) for f in root.iterfind(".//k:Folder", SPACE)]
    assert names[0] == "points" and {"ellipses", "photos", "observations"} <= set(names)
    styles = {s.get("id") for s in root.iterfind(".//k:Style", SPACE)}
    used = {s.text for s in root.iterfind(".//k:styleUrl", SPACE)}
    assert used == {f"#{s}" for s in styles}


def test_points_lie_on_the_ground_with_their_height_as_data(root):
    """Altitudes of KML are above the geoid; 48 m lower than the ellipsoidal ones in Munich."""
    expected = fga.wgs84_coordinates(in_utm())
    marks = folder(root, "points").findall("k:Placemark", SPACE)
    assert [m.findtext("k:name", "", SPACE) for m in marks] == list(in_utm().network.points)
    for i, mark in enumerate(marks):
        longitude, latitude = mark.findtext(".//k:coordinates", "", SPACE).split(",")
        assert float(longitude) == expected.longitude_deg[i]
        assert float(latitude) == expected.latitude_deg[i]
        assert mark.findtext(".//k:altitudeMode", "", SPACE) == "clampToGround"
        data = {
            d.get("name"): d.findtext("k:value", "", SPACE)
            for d in mark.iterfind(".//k:Data", SPACE)
        }
        assert float(data["height_ellipsoidal_m"]) == pytest.approx(expected.height[i], abs=1e-9)


def test_polygons_are_closed(root):
    rings = folder(root, "ellipses").findall(".//k:LinearRing/k:coordinates", SPACE)
    assert len(rings) == 13
    for ring in rings:
        at = np.array([p.split(",") for p in ring.text.split()], dtype=float)
        assert len(at) == 73 and np.array_equal(at[0], at[-1])


def test_names_with_markup_and_control_characters_stay_readable(tmp_path):
    network = mapped(in_utm().network.crs)
    network.name = "<b>A & B</b> \x07"
    write_kml(fga.adjust(network), tmp_path / "a.kml")
    document = ET.parse(tmp_path / "a.kml").getroot()
    assert document.findtext("k:Document/k:name", "", SPACE) == "<b>A & B</b> \\x07"


def test_a_network_of_unknown_place_is_refused(tmp_path):
    with pytest.raises(fga.InputError, match="KML has longitude and latitude in WGS 84 only"):
        write_kml(in_plane(), tmp_path / "a.kml")
    assert not list(tmp_path.iterdir())
