"""RW5 of Carlson and TDS: the survey of all field books, units, directions, faces, GNSS."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction
from factorgraph_adj.units import FOOT, GON, US_SURVEY_FOOT
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, left_out_but_notes, sights

MODE = "MO,AD0,UN1,SF1.00000000,EC0,EO0.0,AU1\n"
FEET = "MO,AD0,UN0,SF1.00000000,EC1,EO0.0,AU0\n"


def rw5() -> str:
    """Return the survey as RW5, gon."""
    lines = ["JB,NMQUARRY,DT06-27-2003,TM14:21:53", MODE.strip(), "--SurvCE Version 1.61.01"]
    lines += [f"SP,PN{n},N {y:.4f},E {x:.4f},EL{z:.4f},--PEG" for n, (x, y, z) in KNOWN.items()]
    lines += ["OC,OPS,--", f"LS,HI{HEIGHT:.4f},HR{TARGET:.4f}", "BK,OPS,BP,BS,BC0.0000"]
    for s in sights():
        readings = f"AR{s.direction / GON:.8f},ZE{s.zenith / GON:.8f},SD{s.distance:.6f}"
        lines.append(f"{'FD' if s.face == 1 else 'FR'},OPS,FP{s.target},{readings},--PEG")
    return "\n".join(lines) + "\n"


EXAMPLE_FILES = {
    "rw5": Example(
        "rw5",
        {"book.rw5": rw5()},
        "book.rw5",
        HELD,
        unread=(
            r"\|JB,|\|--",  # job and notes
            r"--PEG|\|word\|[^|]*\|OC,OPS,--|\|value\|(SF|EC|EO|AD)",
            r"\|(value|word)\|BC|\|value\|BK,|\|BK,OPS,BP,",  # a backsight without a name
        ),
        is_field_book=True,
    ),
}


def read(folder, text: str, **options) -> fga.Network:
    path = folder / "book.rw5"
    path.write_bytes(text.encode("cp1252"))
    return fga.read(path, **options)


def directions(network: fga.Network) -> list[tuple[str, str, float]]:
    return [
        (o.set, o.target, round(math.degrees(o.value), 6) % 360)
        for o in network.observations.values()
        if isinstance(o, Direction)
    ]


def sight(field: str, target: str = "1", code: str = "SS") -> str:
    return f"{code},OPS,FP{target},{field},ZE90.0000,SD100.000,--\n"


SETUP = FEET + "OC,OPS,N 10.0,E 20.0,EL30.0,--\nLS,HI5.0,HR6.0\n"


@pytest.mark.parametrize(
    ("field", "back", "expected"),
    [
        ("AR30.3000", "BS,BC10.0000", [("1", "1", 30.5), ("1", "B", 10.0)]),
        ("AL30.3000", "BS,BC10.0000", [("1", "1", 339.5), ("1", "B", 10.0)]),
        ("DR30.3000", "BS,BC10.0000", [("1", "1", 220.5), ("1", "B", 10.0)]),
        ("DL30.3000", "BS,BC10.0000", [("1", "1", 159.5), ("1", "B", 10.0)]),
        ("AZ30.3000", "BS,BC", [("1", "1", 30.5)]),
        ("BRN30.3000W", "BS,BC", [("1", "1", 329.5)]),
        ("BRS30.3000E", "BS,BC", [("1", "1", 149.5)]),
        ("BRS30.3000W", "BS,BC", [("1", "1", 210.5)]),
        ("BRN30.3000E", "BS,BC", [("1", "1", 30.5)]),
    ],
)
def test_a_direction_has_one_of_six_fields(tmp_path, field, back, expected):
    network = read(tmp_path, SETUP + f"BK,OPS,BPB,{back}\n" + sight(field))
    assert directions(network) == expected
    with pytest.raises(InputError, match=r"has (angle right|bearing|.*) and|valid: one of them"):
        read(tmp_path, SETUP + sight(field + ",AR1.0,AZ1.0"))


def test_azimuths_are_a_set_of_their_own(tmp_path):
    text = SETUP + "BK,OPS,BPB,BS50.0000,BC0.0000\n"
    text += sight("AR10.0", "1") + sight("AZ20.0", "2") + sight("AZ30.0", "3")
    sets = [(s, t) for s, t, _ in directions(read(tmp_path, text))]
    assert sets == [("1", "1"), ("1", "B"), ("2", "2"), ("2", "3")]


def test_the_sight_of_a_backsight_replaces_its_circle_reading(tmp_path):
    text = SETUP + "BK,OPS,BPB,BS,BC0.0000\n" + sight("AR0.0002", "B", "BD") + sight("AR10.0")
    network = read(tmp_path, text)
    assert [t for _, t, _ in directions(network)] == ["B", "1"]
    assert "circle readings of backsights: 1 left out" in str(network.left_out[0])


def test_heights_count_until_the_next_and_may_follow_the_station(tmp_path):
    text = FEET + "OC,OPS,N 0,E 0,EL0\nLS,HI5.0\nLS,HR6.0\n" + sight("AR1.0", "1")
    text += "LS,HR7.0\n" + sight("AR2.0", "2") + "LS,HI4.0\n" + sight("AR3.0", "3")
    text += "OC,OPT,N 9,E 9,EL0\nSS,OPT,FP4,AR1.0,ZE90.0,SD10.0\n"
    heights = [
        (round(o.instrument_height / FOOT, 9), round(o.target_height / FOOT, 9))
        for o in read(tmp_path, text).observations.values()
        if isinstance(o, Direction)
    ]
    assert heights == [(5.0, 6.0), (5.0, 7.0), (4.0, 7.0), (4.0, 7.0)]


@pytest.mark.parametrize(("code", "metres"), [("0", FOOT), ("1", 1.0), ("2", US_SURVEY_FOOT)])
def test_lengths_have_the_unit_of_the_mode(tmp_path, code, metres):
    network = read(tmp_path, rw5().replace("UN1", f"UN{code}"))
    expected = [metres * v for v in KNOWN["B"]]
    assert network.points["B"].coordinates == pytest.approx(expected)
    without = rw5().replace(MODE, "--" + MODE)
    with pytest.raises(InputError) as error:
        read(tmp_path, without)
    assert "book.rw5:4: the unit of length is missing: no record MO is before" in str(error.value)
    unit = {"0": "ft", "1": "m", "2": "us-ft"}[code]
    again = read(tmp_path, without, length_unit=unit, angle_unit="gon")
    assert [o.value for o in again.observations.values()] == [
        o.value for o in network.observations.values()
    ]


def test_gon_of_the_mode_is_refused_where_an_azimuth_is_in_degrees(tmp_path):
    """Nikon's export for TDS states AU1 beside D.MMSS: 45° 30′ from S to B by coordinates."""
    azimuth = math.radians(45.5)
    text = SETUP.replace("AU0", "AU1") + (
        f"SP,PNB,N {10 + 500 * math.cos(azimuth):.4f},E {20 + 500 * math.sin(azimuth):.4f},EL0\n"
        "BK,OPS,BPB,BS45.3000,BC0.0000\n"
    ) + sight("AR10.3000")  # fmt: skip
    with pytest.raises(InputError, match=r"not gon \(AU1\): BS45\.3000 .* give angle_unit=dms"):
        read(tmp_path, text)
    assert ("1", "1", 10.5) in directions(read(tmp_path, text, angle_unit="dms"))
    gon = text.replace("BS45.3000", f"BS{azimuth / GON:.4f}")
    assert ("1", "1", 9.27) in directions(read(tmp_path, gon))


def test_faces_are_those_of_the_records_and_of_the_zenith(tmp_path):
    text = SETUP + (
        "BD,OPS,FPB,AR0.0000,ZE90.5408,SD100.0\nFD,OPS,FP1,AR89.1420,ZE89.2229,SD50.0\n"
        "FR,OPS,FP1,AR269.1418,ZE270.3719,SD50.0\nBR,OPS,FPB,AR179.5958,ZE269.0541,SD100.0\n"
    )
    network = read(tmp_path, text)
    found = {t: v for _, t, v in directions(network)}
    assert found["1"] == pytest.approx(89 + 14 / 60 + 19 / 3600, abs=1e-6)
    assert found["B"] % 360 == pytest.approx(360 - 1 / 3600, abs=1e-6)
    assert directions(read(tmp_path, text.replace("FD,", "SS,").replace("FR,", "SS,")))[1][1] == "1"


def test_the_last_coordinates_count_and_differences_are_said(tmp_path):
    text = SETUP + sight("AR0.0") + "SP,PNC,N 1.0,E 2.0,EL0.0,--\nSP,PNC,N 1.0,E 2.0,EL500.0\n"
    network = read(tmp_path, text, fixed="C")
    assert network.points["C"].coordinates == pytest.approx((2 * FOOT, FOOT, 500 * FOOT))
    assert network.remarks == [
        "coordinates of 1 point are stated again with other values, of which the last count; "
        "they differ in C by 152.4000 m (book.rw5:5)"
    ]


def test_a_backsight_that_was_not_measured_has_no_zenith(tmp_path):
    text = SETUP + "BD,OPS,FPB,AR0.0000,ZE90.0000,SD0.000\n" + sight("AR10.0")
    network = read(tmp_path, text)
    kinds = [(o.kind, o.target) for o in network.observations.values()]
    assert kinds.count(("direction", "B")) == 1
    assert ("zenith_angle", "B") not in kinds
    assert "zenith readings: 1 left out" in str(network.left_out[0])


def test_records_of_gnss_and_offsets_are_left_out_and_counted(tmp_path):
    gnss = "BP,PN9,LA47.25,LN9.37,EL452.5,AG0.0,--\nGPS,PN7,LA47.25,LN9.37,EL452.2,--\n"
    network = read(tmp_path, rw5() + gnss + "OF,AR90.0,ZE90.0,SD1.0\n")
    assert [(left.what, left.count) for left in left_out_but_notes(network)] == [
        ("records of GNSS", 2),
        ("records", 1),
    ]
    with pytest.raises(InputError) as error:
        read(tmp_path, "JB,NMA,DT1,TM2\n" + MODE + gnss)
    assert str(error.value).startswith(
        "book.rw5:1: holds neither points nor observations; records of GNSS: 2 left out, as sights"
    )


def test_several_carriage_returns_end_one_line(tmp_path):
    network = read(tmp_path, rw5().replace("\n", "\r\r\r\n"))
    first = next(iter(network.observations.values()))
    assert first.source == "book.rw5:10"


@pytest.mark.parametrize("name", ["job.raw", "job.txt", "job"])
def test_a_book_is_known_by_its_first_records(tmp_path, name):
    path = tmp_path / name
    path.write_text("-- TPS1200 RW5 format file\n\n" + rw5(), encoding="utf-8")
    assert READERS.of(path).name == "rw5"
    path.write_text("OC,PN=STN1,E=5000.000\n", encoding="utf-8")  # of FieldGenius
    assert not READERS.named("rw5").recognises(path)


def test_wrong_records_are_all_named(tmp_path):
    text = rw5() + "XX,1\nSS,OPT,FP1,AR1.0,ZE90.0,SD1.0\nSS,OPS,FP1,AR1.0,CE5.0,HD1.0\n"
    text += "SS,OPS,FP1,AR1.0,ZE-61.5,SD1.0\nSS,OPS,FP1,AR1.0,QQ7,SD1.0,SD2.0\nRB,OPS,FP1\n"
    text += "SS,OPS,FP1,BRX1.0,ZE90.0,VA0.0,SD1.0\n"
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    said = str(error.value)
    for what in (
        "book.rw5:16: record 'XX' is unknown",
        "book.rw5:17: a reading from 'T' at 'S': record OC is missing",
        "book.rw5:18: change of elevation (CE) is not read",
        "book.rw5:19: zenith (ZE) must be of the circle",
        "book.rw5:20: word 'QQ' is unknown",
        "book.rw5:20: field 'SD' stands twice",
        "book.rw5:21: record 'RB' has readings of several sights",
        "book.rw5:22: bearing must be a bearing such as N12.3456W, not 'X1.0'",
        "book.rw5:22: has zenith and vertical; valid: one of them",
    ):
        assert what in said


def test_a_traverse_closes(tmp_path):
    """Four legs of 100 m, sighted forward and back: the last point comes out as the first."""
    corners = {"1": (0, 0), "2": (0, 100), "3": (100, 100), "4": (100, 0), "5": (0, 0)}
    names = list(corners)
    lines = [MODE, "SP,PN1,N 0.0,E 0.0,EL0.0\n", "SP,PN4,N 0.0,E 100.0,EL0.0\n"]
    for i, at in enumerate(names[:4]):
        back = names[i - 1] if i else "4"
        lines.append(f"OC,OP{at},N 0,E 0,EL0\nLS,HI1.5,HR1.5\n" if i == 0 else f"OC,OP{at}\n")
        lines.append(f"BK,OP{at},BP{back},BS,BC0.0000\n")
        lines.append(f"BD,OP{at},FP{back},AR0.0000,ZE100.0,SD100.0\n")
        lines.append(f"FD,OP{at},FP{names[i + 1]},AR300.0,ZE100.0,SD100.0\n")
    solution = fga.adjust(read(tmp_path, "".join(lines), fixed="1,4", refraction=None))
    assert np.max(np.abs(solution.point("5") - solution.point("1"))) < 1e-6
