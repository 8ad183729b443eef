"""SDR33 as Sokkia, Nikon and Spectra write it: backsights, sets, resections, units, code pages."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction
from factorgraph_adj.units import FOOT, GON, US_SURVEY_FOOT
from tests.io.field_books.field_files import sdr33

HEADER = "00NMSDR33 V04-04.02     01-Jan-04 16:26 211111\n"
NIKON_HEADER = "00NMSDR33V04-01     000027-Sep-18 14:20:111111\n"
INSTRUMENT = "01NM:" + "SET530".ljust(16) + "000000" + "SET530".ljust(16) + "000000" + "31\n"
MILLIMETRE = 1e-3


def fields(*values: float | str) -> str:
    return "".join((v if isinstance(v, str) else f"{v:.6f}").ljust(16) for v in values) + "\n"


def sight(station: str, target: str, direction: float, code: str = "09F1") -> str:
    return code + fields(station, target, 50.0, 100.0, direction, "")


def read(folder: Path, text: str, **options) -> fga.Network:
    path = folder / "book.sdr"
    path.write_bytes(text.encode("latin-1"))
    return fga.read(path, **options)


def directions(network: fga.Network) -> list[tuple[str, str, float]]:
    return [
        (o.set, o.target, round(o.value / GON, 4))
        for o in network.observations.values()
        if isinstance(o, Direction)
    ]


STATION = "02KI" + fields("S", 0.0, 0.0, 0.0, 1.5)


@pytest.mark.parametrize(
    ("records", "expected"),
    [
        # no observation repeats the backsight: its circle reading orients the set
        ("07KI" + fields("S", "B", 10.0, 20.0) + sight("S", "1", 30.0),
         [("1", "1", 30.0), ("1", "B", 20.0)]),
        # an observation repeats it
        ("07KI" + fields("S", "B", 10.0, 20.0) + sight("S", "B", 20.001) + sight("S", "1", 30.0),
         [("1", "B", 20.001), ("1", "1", 30.0)]),
        # it follows its observation, or begins a further round
        (sight("S", "B", 20.0) + "07TP" + fields("S", "B", 10.0, 20.001) + sight("S", "1", 30.0),
         [("1", "B", 20.0), ("1", "1", 30.0)]),
        # the circle was turned
        ("07KI" + fields("S", "B", 10.0, 20.0) + sight("S", "1", 30.0)
         + "07KI" + fields("S", "B", 10.0, 120.0) + sight("S", "2", 150.0),
         [("1", "1", 30.0), ("1", "B", 20.0), ("2", "2", 150.0), ("2", "B", 120.0)]),
        # a second station
        ("07KI" + fields("S", "B", 10.0, 20.0) + sight("S", "1", 30.0)
         + "02KI" + fields("T", 9.0, 0.0, 0.0, 1.4) + sight("T", "2", 150.0),
         [("1", "1", 30.0), ("1", "B", 20.0), ("1", "2", 150.0)]),
        # without a reading the backsight states an azimuth alone
        ("07KI" + fields("S", "B", 10.0, "") + sight("S", "1", 30.0), [("1", "1", 30.0)]),
        # sets of directions
        ("12SC" + "S".ljust(16) + "002001111\n" + sight("S", "1", 30.0)
         + "12SC" + "S".ljust(16) + "002002111\n" + sight("S", "2", 40.0),
         [("1", "1", 30.0), ("2", "2", 40.0)]),
    ],
)  # fmt: skip
def test_a_circle_that_was_turned_begins_a_set(tmp_path, records, expected):
    network = read(tmp_path, HEADER + INSTRUMENT + STATION + records)
    assert sorted(directions(network)) == sorted(expected)


@pytest.mark.parametrize(
    ("count", "left"), [("002", ["1", "2"]), ("   ", ["1", "2", "3"]), ("000", [])]
)
def test_observations_of_a_bad_set_are_left_out_by_their_number(tmp_path, count, left):
    text = HEADER + INSTRUMENT + STATION + "12SC" + "S".ljust(16) + f"{count}001211\n"
    text += "".join(sight("S", name, 30.0) for name in "123")
    text += "12SC" + "S".ljust(16) + "001002111\n" + sight("S", "4", 30.0)
    network = read(tmp_path, text)
    assert [n for record in network.left_out for n in record.names] == left
    assert [t for _, t, _ in directions(network)] == [n for n in "1234" if n not in left]


def test_the_last_resection_before_a_station_is_its_first_set(tmp_path):
    """Spectra writes readings of a resection as notes; those begun again are left out."""
    note = "13NMStart of Resection\n"
    text = NIKON_HEADER.replace("111111", "211111") + INSTRUMENT + (
        note + sight("0", "A", 0.0, "13F1") + sight("0", "B", 0.001, "13F1")
        + note + sight("0", "A", 0.0, "13F1") + sight("0", "B", 90.0, "13F1")
        + "08KI" + fields("S", 1.0, 2.0, 3.0) + "02KI" + fields("S", 1.0, 2.0, 3.0, 1.5)
        + "07KI" + fields("S", "A", 77.0, 77.0) + sight("S", "1", 30.0)
        + note + sight("0", "C", 0.0, "13F1")
    )  # fmt: skip
    network = read(tmp_path, text)
    assert directions(network) == [
        *(("1", "A", 0.0), ("1", "B", 90.0)),
        *(("2", "1", 30.0), ("2", "A", 77.0)),
    ]
    (left,) = network.left_out
    assert (left.names, left.count) == (("A", "B", "C"), 3)
    assert {o.instrument_height for o in network.observations.values()} == {1.5}
    # a note without the words before it is a note
    assert not read(tmp_path, HEADER + STATION + "13F1 taken twice\n").observations


@pytest.mark.parametrize(
    ("numbers", "vertical"),
    [
        ("31" + "     0.000" * 3, "1"),
        ("32" + "     0.000" * 3, "2"),
        ("31" + "   -35.000" + "     0.000" * 2, "1"),
    ],
)
def test_mount_and_vertical_code_stand_before_the_numbers_of_an_instrument(
    tmp_path, numbers, vertical
):
    """The name of a Nikon has 17 characters, twice: the columns of Sokkia end in its number."""
    name = 'Nikon FOCUS 6W 5"'
    assert len(name) == 17
    instrument = f"01KI1{name}900723{name}900723{numbers}\n"
    network = read(tmp_path, NIKON_HEADER + instrument + STATION + "09F1" +
                   fields("S", "1", 50.0, 80.0, 30.0))  # fmt: skip
    (zenith,) = [o.value for o in network.observations.values() if o.kind == "zenith_angle"]
    assert math.degrees(zenith) == pytest.approx(80.0 if vertical == "1" else 10.0)


def test_numbers_of_16_columns_do_not_move_the_vertical_code(tmp_path):
    instrument = INSTRUMENT.rstrip("1\n") + "2" + fields("35.000", "0.000", "0.000")
    network = read(tmp_path, HEADER + instrument + STATION + "09F1" +
                   fields("S", "1", 50.0, 80.0, 30.0))  # fmt: skip
    (zenith,) = [o.value for o in network.observations.values() if o.kind == "zenith_angle"]
    assert zenith / GON == pytest.approx(20.0)


def test_a_note_narrows_feet_and_contradicts_metres(tmp_path):
    text = sdr33().replace("211111", "221111")
    for note, metres in (("", FOOT), ("13DU2:Feet:\n", FOOT), ("13DU3:US Feet:\n", US_SURVEY_FOOT)):
        network = read(tmp_path, text.replace("10NM", note + "10NM", 1))
        assert network.points["B"].coordinates[2] == 101.0 * metres
    with pytest.raises(InputError, match=r"book\.sdr:2: .*\(13DU.*\) is 3, option 2 of the header"):
        read(tmp_path, sdr33().replace("10NM", "13DU3:US Feet:\n10NM", 1))


@pytest.mark.parametrize(
    ("header", "mil"), [(HEADER, "3"), (NIKON_HEADER, "3"), (NIKON_HEADER, "4")]
)
def test_mils_are_option_3_and_of_nikon_4(tmp_path, header, mil):
    header = header[:-7] + mil + "11111\n"
    network = read(tmp_path, header + INSTRUMENT + STATION + sight("S", "1", 1600.0))
    assert directions(network)[0][2] == 100.0
    with pytest.raises(InputError, match="option 1, angles"):
        read(tmp_path, HEADER[:-7] + "411111\n" + STATION)


def test_a_typed_azimuth_is_no_reduced_observation(tmp_path):
    text = HEADER + STATION + "11KI" + fields("S", "B", 12.0, "", "", "BS AZ")
    text += "11KI" + fields("S", "B", 12.0, 50.0, 1.0, "PEG")
    assert [left.what for left in read(tmp_path, text).left_out] == [
        "typed azimuths",
        "reduced observations",
    ]


def test_names_in_another_code_page_stay_apart(tmp_path):
    """Bytes 0x81 and 0x8d, Б and Н of page 866, are no characters of Windows-1252."""
    text = HEADER.encode() + b"".join(
        b"08KI" + fields(n, 1.0 * i, 2.0, 3.0).encode("cp866") for i, n in enumerate("БН")
    )
    (tmp_path / "book.sdr").write_bytes(text)
    network = fga.read(tmp_path / "book.sdr")
    assert len(network.points) == 2
    said = "2 lines are not UTF-8: read as if in Windows-1252; first in book.sdr:2"
    assert network.remarks == [said]
    fga.write_project(network, tmp_path / "project.toml")
    assert list(fga.read(tmp_path / "project.toml").points) == list(network.points)


@pytest.mark.parametrize("name", ["book.tops", "book.txt", "book"])
def test_an_sdr_file_is_known_by_its_header(tmp_path, name):
    path = tmp_path / name
    path.write_text("\x02\n" + sdr33(), encoding="utf-8")
    assert READERS.of(path).name == "sdr33"
    path.write_text("13NM a note\n" + sdr33(), encoding="utf-8")
    assert not READERS.named("sdr33").recognises(path)


def test_points_agree_with_those_that_the_instrument_stored(tmp_path):
    """Sokkia SET630RK: sights (09F1) and the points it stored beside them (08TP).

    Numbers of sokkia_sdr33_polar.tops, which Total Open Station had until its commit 2acc86b7.
    """
    stored = {"1": (19.914, 9.217, 0.975), "3": (11.870, 18.789, 1.659)}
    text = HEADER + INSTRUMENT + "02TP" + fields("S", 0.0, 0.0, 0.0, 1.475)
    text += "08KI" + fields("1", *stored["1"]) + "03NM0.000\n"
    text += "09F1" + fields("S", "1", 21.949, 101.4508, 27.5962)
    text += "09F1" + fields("S", "3", 22.225, 99.4740, 64.1306)
    solution = fga.adjust(read(tmp_path, text, fixed="S,1", refraction=None))
    north, east, up = stored["3"]
    assert np.max(np.abs(solution.point("3") - (east, north, up))) < MILLIMETRE
