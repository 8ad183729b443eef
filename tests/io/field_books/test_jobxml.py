"""JobXML whose points have no names, or which lacks records of stations."""

from __future__ import annotations

import re

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from tests.io.field_books.field_files import jobxml


def read(folder, text: str) -> fga.Network:
    path = folder / "book.jxl"
    path.write_text(text, encoding="utf-8")
    return fga.read(path)


def left_out(network: fga.Network) -> list[tuple[str, str, tuple[str, ...]]]:
    """Return what the example does not have by itself: it has one deleted record."""
    return [(left.what, left.why, left.names) for left in network.left_out if "off" not in left.why]


def test_a_point_without_a_name_is_left_out_and_counted(tmp_path):
    whole = read(tmp_path, jobxml())
    text = jobxml().replace("<PointRecord ID='p0'><Name>A</Name>", "<PointRecord ID='p0'>")
    network = read(tmp_path, text.replace("<Name>B</Name>", "<Name></Name>", 1))
    assert left_out(network) == [("records of points", "they have no name (<Name>)", ("kB", "p0"))]
    assert 0 < len(network.observations) < len(whole.observations) + 1
    assert network.points["B"].coordinates != whole.points["B"].coordinates


def test_sights_of_a_file_without_station_records_are_left_out_and_counted(tmp_path):
    text = re.sub(r"<StationRecord.*?</StationRecord>", "", jobxml(), flags=re.DOTALL)
    network = read(tmp_path, text)
    why = "the file has no record of their station (StationRecord)"
    assert left_out(network) == [("sights", why, ("A", "B", "C"))]
    assert list(network.points) == ["A", "B", "C"]
    assert not network.observations
    alone = re.sub(r"<Grid>.*?</Grid>", "", text, flags=re.DOTALL)
    with pytest.raises(InputError) as error:
        read(tmp_path, alone)
    assert str(error.value) == (
        "book.jxl:1: holds neither points nor observations; sights: 6 left out, as "
        f"{why}; points and observations: 1 left out, as they are switched off in the file"
    )


def test_a_sight_without_a_station_is_left_out_and_one_of_another_is_refused(tmp_path):
    text = jobxml().replace("<StationID>s1</StationID>", "", 1)
    assert left_out(read(tmp_path, text))[0][2] == ("A",)
    with pytest.raises(InputError, match="there is no StationRecord 's2'; known: s1"):
        read(tmp_path, jobxml().replace("<StationID>s1", "<StationID>s2", 1))


@pytest.mark.parametrize("tag", ["Point", "PointRecord"])
def test_points_of_the_reductions_may_lack_the_element_grid(tmp_path, tag):
    numbers = "<North>7</North><East>8</East><Elevation>9</Elevation>"
    for grid in (numbers, f"<Grid>{numbers}</Grid>"):
        row = f"<Reductions><{tag} ID='r'><Name>R</Name>{grid}</{tag}></Reductions></JOBFile>"
        network = read(tmp_path, jobxml().replace("</JOBFile>", row))
        assert network.points["R"].coordinates == (8.0, 7.0, 9.0)
    row = f"<Reductions><{tag}><Name>R</Name><Latitude>4</Latitude></{tag}></Reductions></JOBFile>"
    assert left_out(read(tmp_path, jobxml().replace("</JOBFile>", row)))[0][2] == ("R",)
