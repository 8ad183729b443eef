"""Files as instruments and other programs write them: code pages, missing values, joined codes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.units import ARCSEC
from tests.io.field_books import field_files

FULL = """\
*110001+00000000000000P1 81..10+0000000000100000 82..10+0000000000200000 83..10+0000000000050000
*110002+00000000000000P2 81..10+0000000000160000 82..10+0000000000210000 83..10+0000000000051000
*110003+00000000000000P3 81..10+0000000000080000 82..10+0000000000250000 83..10+0000000000053000
*110004+00000000000000ST 88..10+0000000000001500
*110005+00000000000000P1 21.322+0000000020096490 22.322+0000000010508370 31...0+0000000000250795 87..10+0000000000001500
*110006+00000000000000P3 21.322+0000000030511050 22.322+0000000009862060 31...0+0000000000461090 87..10+0000000000001500
"""  # noqa: E501
SDR_COORDINATES = """\
00NMSDR33V04-01     000001-Jan-24 09:00:111121
10NMJOB{job}            121111
01NM:INSTRUMENT      000000INSTRUMENT      000000{vertical}{vertical}0.000           0.000
08KI             101100.000         200.000         50.000
"""


def read(folder: Path, name: str, text: str, encoding: str = "utf-8", **options) -> fga.Network:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return fga.read(path, **options)


def test_a_height_of_dashes_was_not_measured(tmp_path):
    whole = read(tmp_path, "full.gsi", FULL, fixed="P1,P3")
    height = FULL.replace("83..10+0000000000051000", "83..10+00000000000-----")
    network = read(tmp_path, "book.gsi", height, fixed="P1,P3")
    assert [o.value for o in network.observations.values()] == [
        o.value for o in whole.observations.values()
    ]
    assert network.points["P2"].coordinates[:2] == (160.0, 210.0)
    assert network.points["P2"].coordinates[2] != network.points["P2"].coordinates[2]
    (left,) = network.left_out
    assert str(left) == (
        "values: 1 left out, as the file has dashes in their place: P2 83; first in book.gsi:2"
    )


def test_a_height_of_the_target_is_never_missing(tmp_path):
    text = FULL.replace("87..10+0000000000001500", "87..10+00000000000-----", 1)
    with pytest.raises(InputError, match=r"book\.gsi:5: word 87 must be a whole number, not '0+-+"):
        read(tmp_path, "book.gsi", text)


def test_the_difference_of_the_circle_to_its_orientation_is_not_needed(tmp_path):
    whole = read(tmp_path, "full.gsi", FULL)
    text = FULL.replace("ST 88", "ST 25.322+0000000000012340 88")
    network = read(tmp_path, "book.gsi", text)
    assert [o.value for o in network.observations.values()] == [
        o.value for o in whole.observations.values()
    ]
    assert network.points["ST"].held == whole.points["ST"].held


def test_a_height_of_the_instrument_may_stand_in_a_sight_alone(tmp_path):
    """Word 88 of the second sight counts for the set-up, whose station has coordinates alone."""
    whole = read(tmp_path, "full.gsi", FULL)
    station = "".join(f" {i}..10+0000000000{v}" for i, v in ((84, 120000), (85, 180000)))
    text = FULL.replace(" 88..10+0000000000001500", station)
    last = text.rstrip("\n") + " 88..10+0000000000001500\n"
    network = read(tmp_path, "book.gsi", last)
    assert network.observations == {
        k: replace(o, source=o.source.replace("full", "book"))
        for k, o in whole.observations.items()
    }


def test_coordinates_do_not_need_what_vertical_readings_begin_at(tmp_path):
    network = read(tmp_path, "a.sdr", SDR_COORDINATES.format(job="1", vertical=3))
    assert network.points["101"].coordinates == (100.0, 200.0, 50.0)
    lines = [t[:50] + "3" + t[51:] if t.startswith("01NM") else t
             for t in field_files.sdr33().split("\n")]  # fmt: skip
    with pytest.raises(InputError, match=r"a\.sdr:\d+: vertical readings .* '3' is unknown; valid"):
        read(tmp_path, "a.sdr", "\n".join(lines))


@pytest.mark.parametrize("page", ["cp1251", "cp1252"])
def test_a_code_page_is_read_as_windows_1252_and_said(tmp_path, page, capsys):
    job = "Ж" if page == "cp1251" else "ß"
    text = SDR_COORDINATES.format(job=job, vertical=1)
    network = read(tmp_path, "a.sdr", text, page)
    assert list(network.points) == ["101"]
    said = "1 line is not UTF-8: read as if in Windows-1252; first in a.sdr:2"
    assert network.remarks == [said]
    assert not read(tmp_path, "b.sdr", text).remarks


def test_the_remark_on_a_code_page_is_in_the_report_and_the_results(tmp_path):
    text = field_files.gsi().replace("0A ", "\xc4 ")
    network = read(tmp_path, "a.gsi", text, "cp1252", fixed="\xc4,B,C", refraction=None)
    said = "not UTF-8: read as if in Windows-1252; first in a.gsi:1"
    solution = fga.adjust(network)
    assert said in " ".join(fga.text_report(solution).split())
    fga.write_results(solution, tmp_path / "results.json")
    assert said in (tmp_path / "results.json").read_text(encoding="utf-8")


STAR_NET = """\
# Copyright {sign} 2024
.UNITS Meters DMS
.3D
.ORDER EN
C A 0 0 100 {three}
C B 200 20 104 ! ! !
DB S
DM A 10-00-00.0 100.0000 90-00-00.0 {errors} 1.600/1.600
DM B 110-00-00.0 173.0000 89-00-00.0 {errors} 1.600/1.600
DE
"""
SETTINGS = {
    **{"adjustment": "3D", "linear": "Meters", "angular": "DMS", "order": "EN"},
    **{"stations": "AtFromTo", "distances": "slope", "direction": 5.0, "zenith": 8.0},
    **{"distance": 0.003, "distance_ppm": 2.0, "refraction": 0.07},
    **{"centring_instrument": 0.001, "centring_target": 0.001, "centring_vertical": 0.001},
}


def test_codes_of_standard_errors_are_read_without_blanks_between(tmp_path):
    apart, joined = (
        read(tmp_path, "a.dat", STAR_NET.format(sign="", three=three, errors=errors),
             options=SETTINGS)
        for three, errors in (("! ! !", "& & *"), ("!!!", "&&*"))
    )  # fmt: skip
    assert joined.points["A"].held == apart.points["A"].held == "xyz"
    assert joined.observations == apart.observations
    zeniths = [o for o in joined.observations.values() if isinstance(o, fga.ZenithAngle)]
    assert all(o.sigma.constant > 1e4 * 7 * ARCSEC for o in zeniths)  # free


def test_a_sign_in_a_comment_of_star_net_is_no_problem(tmp_path):
    text = STAR_NET.format(sign="\xa9", three="!!!", errors="")
    network = read(tmp_path, "a.dat", text, "cp1252", options=SETTINGS)
    assert network.remarks == ["1 line is not UTF-8: read as if in Windows-1252; first in a.dat:1"]
    assert len(network.observations) == 6
