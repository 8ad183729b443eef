"""Stations and observations of LINZ SNAP in delimited text: against the same in SNAP's own files.

Rows with their printed errors are of testvecc, regression test of github.com/linz/snap
(BSD-3-Clause); all others have numbers of their own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.units import ARCSEC
from tests.hostile.examples import Example

STATIONS = """mark,system,lon,lat,h,N,c_Mark,c_Order,remark
A,NZGD1949,173.0000,-41.0000,120.00,12.5,PIN,1,North
B,NZGD1949,173.0125,-41.0100,180.00,12.6,TUBE,1,"East, of the ""road"" here"
C,NZGD1949,173.0010,-41.0125,90.00,12.7,,2,
"""
STATION_FORMAT = """FORMAT_NAME marks
! columns of the register
FORMAT CSV HEADER=Y
CODE @mark
NAME @remark
COORDINATE_SYSTEM @system
HEIGHT_TYPE "ellipsoidal"
LONGITUDE @lon
LATITUDE @lat
HEIGHT @h
GEOID_UNDULATION @N
CLASSIFICATION_COLUMNS c_**
ANGLE_FORMAT $angles
"""
SITE = """Three stations
NZGD1949
options ellipsoidal_heights geoid_heights degrees c=Mark c=Order
A -41.0000 173.0000 120.00 12.5 PIN 1 North
B -41.0100 173.0125 180.00 12.6 TUBE 1 East, of the "road" here
C -41.0125 173.0010 90.00 12.7 - 2
"""
READINGS = """at|to|hi|ht|kind|value|error|set|status|tool|when
A|B|1.5|1.6|SD|1400.10|0.005||ok|T1|2008-02-03
A|B|1.5|1.6|ZD|87.55|0.002||ok||2008-02-03 10:30
A|B|||HA|0.0|0.001|7|ok||
A|C|||HA|45.35|0.001|7|ok||
A|C|||HA|90.15|0.001|8|bad||
C|A|||AZ|356.51|0.003||ok||
B||||OH|167.4|0.02||ok||
B||||LT|-41.0100|0.0001||ok||
A|C|||GB|-940.0 -20.1 -1020.2|0.01 0.012 0.02 0.1 -0.2 0.3||ok||
"""
READING_FORMAT = """FORMAT DELIMITER=| QUOTE=" ESCAPE=" HEADER=Y
LOOKUP used
ok N
bad Y
END_LOOKUP
OBSERVATION
TYPE @kind
INSTRUMENT_STATION @at
INSTRUMENT_HEIGHT @hi default 0
TARGET_STATION @to
TARGET_HEIGHT @ht default 0
VALUE @value
ERROR @error
SET_ID @set
REJECTED used(@status)
VECTOR_ERROR_TYPE "enu_correlation"
CLASSIFICATION tool @tool
DATETIME @when
DATETIME_FORMAT "YMD hm"
END_OBSERVATION
"""
PLAIN = """The same readings
#classification tool
#date 2008-02-03
#deg_angles
#data SD error tool
A 1.5 B 1.6 1400.10 0.005 T1
#data ZD error
A 1.5 B 1.6 87.55 0.002
#data HA error no_heights
A
B 0.0 0.001
C 45.35 0.001
#end_set
#data AZ error no_heights
C A 356.51 0.003
#data OH error no_heights
B 167.4 0.02
#data LT error no_heights
B -41.0100 0.0001
"""
COMMANDS = "fix all\ndistance_scale_error use tool\ndistance_scale_error T1 4.0\n"
JOB = (
    "coordinate_file site.csv csv format=marks angles=degrees\n"
    "data_file readings.csv csv format=readings\n"
)
EXAMPLE_FILES = {
    "snap-csv": Example(
        "snap",
        {
            "site.snp": JOB + COMMANDS,
            "site.csv": STATIONS,
            "marks.dtf": STATION_FORMAT,
            "readings.csv": READINGS,
            "readings.dtf": READING_FORMAT,
        },
        "site.snp",
        unread=(
            r"marks\.dtf\|.*\|(FORMAT_NAME|! columns)",
            r"readings\.dtf\|line\|[^|]*\|(LOOKUP used|ok N|bad Y)",  # a word that no row has
            r"site\.csv\|word\|,qz7x\|mark",  # a column that the format does not name
            r"site\.csv\|value\|(PIN|TUBE|c_\w+|North|East.*|of|the|.*road.*|here.?|1|2)\|",
        ),
    )
}


def written(folder: Path, **changed: str) -> Path:
    """Write the job in delimited text; return its command file."""
    files = {
        "site.snp": JOB + COMMANDS,
        "site.csv": STATIONS,
        "marks.dtf": STATION_FORMAT,
        "readings.csv": READINGS,
        "readings.dtf": READING_FORMAT,
    }
    for name, text in (files | {k.replace("_", "."): v for k, v in changed.items()}).items():
        (folder / name).write_text(text)
    return folder / "site.snp"


def test_delimited_text_makes_the_network_of_snaps_own_files(tmp_path: Path) -> None:
    """Points, and all readings but the vector, whose correlations in e, n, u only tables have."""
    own = tmp_path / "own"
    own.mkdir()
    (own / "site.crd").write_text(SITE)
    (own / "readings.dat").write_text(PLAIN)
    (own / "site.snp").write_text(f"coordinate_file site.crd\ndata_file readings.dat\n{COMMANDS}")
    expected, network = fga.read(own / "site.snp"), fga.read(written(tmp_path))
    assert list(network.points) == list(expected.points) == ["A", "B", "C"]
    for name, point in expected.points.items():
        np.testing.assert_array_equal(network.points[name].coordinates, point.coordinates)
    found = [o for o in network.observations.values() if o.kind != "gnss_vector"]
    others = list(expected.observations.values())
    assert len(found) == len(others) == 7
    for one, other in zip(found, others, strict=True):
        assert one.kind == other.kind
        assert one.names() == other.names()
        assert one.value == pytest.approx(other.value, abs=1e-15)
        assert one.sigma == pytest.approx(other.sigma, rel=1e-12)
    assert network.of_kind("edm")["T1"].values[0] == expected.of_kind("edm")["T1"].values[0]


def test_correlations_of_a_vector_count_in_east_north_and_up(tmp_path: Path) -> None:
    network = fga.read(written(tmp_path))
    (vector,) = (o for o in network.observations.values() if o.kind == "gnss_vector")
    ends = [np.array(network.points[n].coordinates) for n in "AC"]
    ups = [network.frame.basis(p[None], np.zeros((1, 2))).enu[0, 2] for p in ends]
    up = (ups[0] + ups[1]) / np.linalg.norm(ups[0] + ups[1])
    east = np.cross([0.0, 0.0, 1.0], up) / np.hypot(up[0], up[1])
    axes = np.array([east, np.cross(up, east), up])
    sigma = np.array([0.01, 0.012, 0.02])
    correlation = np.array([[1, 0.1, -0.2], [0.1, 1, 0.3], [-0.2, 0.3, 1]])
    found = axes @ np.asarray(vector.covariance) @ axes.T
    np.testing.assert_allclose(found, correlation * np.outer(sigma, sigma), atol=1e-12)


ERRORS = """FORMAT CSV
OBSERVATION
TYPE @kind
INSTRUMENT_STATION "BU34"
TARGET_STATION @to
VALUE @value
ERROR @error
DISTANCE_ERROR_TYPE "calculated"
ANGLE_ERROR_TYPE "calculated"
ZENITH_DISTANCE_ERROR_TYPE "calculated"
HEIGHT_DIFFERENCE_ERROR_TYPE "calculated"
END_OBSERVATION
"""
MARKS = """code,lat,lon,height
BU34,-36.41330980,174.66985338,151.124
BUZZ,-36.41330980,174.66785338,251.124
C5MH,-36.41132630,174.67215746,154.516
"""
MARK_FORMAT = """FORMAT CSV
CODE @code
COORDINATE_SYSTEM "NZGD2000"
HEIGHT_TYPE "ellipsoidal"
LATITUDE @lat
LONGITUDE @lon
HEIGHT @height
"""


@pytest.mark.published
@pytest.mark.parametrize(
    ("row", "printed", "half"),
    [
        ("SD,C5MH,583.21,6mm 20ppm", 0.0131, 0.5e-4),
        ("HA,C5MH,124.5,6sec 10mm", 9.1 * ARCSEC, 0.05 * ARCSEC),
        ("ZD,BUZZ,60.1,6sec 0mmh 0mmv", 6.0 * ARCSEC, 0.05 * ARCSEC),
        ("ZD,BUZZ,60.1,0sec 100mmh 0mmv", 50.1 * ARCSEC, 0.05 * ARCSEC),
        ("ZD,BUZZ,60.1,0sec 0mmh 100mmv", 87.1 * ARCSEC, 0.05 * ARCSEC),
        ("ZD,BUZZ,85.1,0sec 0mmh 100mmv", 100.1 * ARCSEC, 0.05 * ARCSEC),
        ("ZD,C5MH,89.35,6sec 10mmh 20mmv", 14.9 * ARCSEC, 0.05 * ARCSEC),
        ("LV,BUZZ,100.1,1 mm", 0.0010, 0.5e-4),
        ("LV,BUZZ,100.1,3 mmrkm sqrt 1440.0", 0.0036, 0.5e-4),
        ("LV,BUZZ,100.1,2.5 mm 2 mmrkm sqrt 1440.0", 0.0035, 0.5e-4),
    ],
)
def test_errors_of_instruments_are_those_of_the_listing(
    tmp_path: Path, row: str, printed: float, half: float
) -> None:
    """testvecc: rows of its files, and the column +/- of its listing."""
    (tmp_path / "marks.csv").write_text(MARKS)
    (tmp_path / "stn.dtf").write_text(MARK_FORMAT)
    (tmp_path / "obs.dtf").write_text(ERRORS)
    (tmp_path / "obs.csv").write_text(f"kind,to,value,error\n{row}\n")
    path = tmp_path / "job.snp"
    path.write_text(
        "coordinate_file marks.csv csv\ndeformation none\ndata_file obs.csv csv\nmode data_check\n"
    )
    (observation,) = fga.read(path).observations.values()
    assert observation.sigma == pytest.approx(printed, abs=half)


@pytest.mark.parametrize(
    ("form", "angle"),
    [
        ("dms", "41 28 15.8"),
        ("dms", "41 28 15.80"),
        ("hp", "41.28158"),
        ("degrees", "41.471055555556"),
    ],
)
def test_angles_have_the_form_that_the_format_states(tmp_path: Path, form: str, angle: str) -> None:
    text = READING_FORMAT.replace("SET_ID", f'ANGLE_FORMAT "{form}"\nSET_ID')
    rows = READINGS.splitlines()[0] + f"\nA|B|||AZ|{angle}|9||ok||\n"
    network = fga.read(written(tmp_path, readings_dtf=text, readings_csv=rows))
    (observation,) = network.observations.values()
    assert observation.value == pytest.approx((41 * 3600 + 28 * 60 + 15.8) * ARCSEC, abs=1e-11)
    unit = np.pi / 180.0 if form == "degrees" else ARCSEC
    assert observation.sigma == pytest.approx(9 * unit, rel=1e-12)


@pytest.mark.parametrize("latitude", ["S 41 00 36", "41 00 36.0S", "-41 00 36"])
def test_latitudes_have_their_hemisphere_at_either_end(tmp_path: Path, latitude: str) -> None:
    job = JOB.replace("angles=degrees", "angles=dms") + COMMANDS
    stations = STATIONS.replace("173.0000,-41.0000", "173 00 00 E,41 00 00 S")
    stations = stations.replace("173.0125,-41.0100", f"173 00 45 E,{latitude}")
    stations = stations.replace("173.0010,-41.0125", "173 00 03.6E,S 41 00 45")
    network = fga.read(written(tmp_path, site_snp=job, site_csv=stations))
    expected = fga.read(written(tmp_path))
    at, there = (n.points["B"].coordinates for n in (network, expected))
    np.testing.assert_allclose(at, there, atol=1e-6)


def test_text_may_be_delimited_by_blanks_without_a_header(tmp_path: Path) -> None:
    form = (
        "FORMAT WHITESPACE HEADER=N\nSKIP_LINES 1\nCOLUMNS at to length\nOBSERVATION\nTYPE SD\n"
        "INSTRUMENT_STATION @at\nTARGET_STATION @to\nVALUE @length\nERROR 0.002\n"
        "IGNORE_MISSING_OBSERVATIONS\nEND_OBSERVATION\n"
    ).replace("TYPE SD", 'TYPE "SD"')
    rows = "distances of the day\nA B 1399.5\nA   C  1393.2\nB C\n"
    network = fga.read(written(tmp_path, readings_dtf=form, readings_csv=rows))
    assert [o.value for o in network.observations.values()] == [1399.5, 1393.2]


@pytest.mark.parametrize(
    ("name", "old", "new", "problem"),
    [
        ("site.snp", "format=marks", "format=points", "the format definition points.dtf is not"),
        ("site.snp", "angles=degrees", "angles=gon", "angle_format 'gon' is unknown; valid: deg"),
        ("site.snp", "site.csv csv", "site.csv xml", "coordinate_file as 'xml"),
        ("marks.dtf", "CODE @mark", "", "marks.dtf:13: stations need code"),
        ("marks.dtf", "LATITUDE", "LATITUDES", "marks.dtf:9: command 'latitudes' is unknown"),
        ("marks.dtf", "@lon", "@longitude", "site.csv:1: lacks the columns longitude of marks"),
        ("marks.dtf", "HEADER=Y", "HEADER=maybe", "marks.dtf:3: FORMAT 'CSV HEADER=maybe' is unkn"),
        ("marks.dtf", "@lat", "@lat +3", "marks.dtf:9: '+3' is no part of a value"),
        ("site.csv", "B,NZGD1949", "B,NZGD2000", "site.csv:3: is in NZGD2000, and stations"),
        ("site.csv", "B,NZGD", "A,NZGD", "site.csv:3: station 'A' is there already, in line 2"),
        ("site.csv", ",90.00,", ",,", "site.csv:4: height is missing"),
        ("site.csv", "-41.0100", "-141.0100", "site.csv:3: latitude must be from -90 to 90"),
        ("site.csv", ",2,", ",2,x,y", "site.csv:4: has 10 fields, and 9 columns have names"),
        ("readings.dtf", "END_LOOKUP\n", "", "readings.dtf:2: the table that begins here has no"),
        ("readings.dtf", "TYPE @kind", "", "readings.dtf:6: the observation needs TYPE"),
        ("readings.dtf", "used(@", "usable(@", "table 'usable' is unknown; valid: used"),
        ("readings.dtf", '"YMD hm"', '"YMD hh"', "readings.dtf:19: the form of dates 'YMD hh'"),
        ("readings.dtf", "OBSERVATION\nTYPE", "TYPE", "'type' is not within OBSERVATION"),
        ("readings.csv", "C|A|||AZ", "C|A|||AS", "readings.csv:7: type 'AS' is unknown; valid"),
        ("readings.csv", "|bad|", "|good|", "readings.csv:6: status 'good' is not in the table"),
        ("readings.csv", "0.1 -0.2 0.3", "0.1 -0.2", "readings.csv:10: error needs 6 numbers"),
        ("readings.csv", "2008-02-03 10", "2008-02-33 10", "readings.csv:3: datetime must be a da"),
        ("readings.csv", "1.6|SD|1400.10", "1.6|SD|", "readings.csv:2: value is missing"),
        ("readings.csv", "B||||OH", "D||||OH", "readings.csv:8: station 'D' is not in"),
        ("readings.csv", "A|C|||AZ", 'A|"C|||AZ', ""),
    ],
)
def test_wrong_files_are_refused_with_their_lines(
    tmp_path: Path, name: str, old: str, new: str, problem: str
) -> None:
    path = written(tmp_path)
    text = (tmp_path / name).read_text()
    if problem:
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new))
    else:
        (tmp_path / name).write_text(text.replace("C|A|||AZ", 'C|"A|||AZ'))
        problem = "readings.csv:7: is not delimited text: unexpected end of data"
    with pytest.raises(fga.InputError) as caught:
        fga.read(path)
    assert problem in str(caught.value)


def test_a_blank_value_has_the_next_default(tmp_path: Path) -> None:
    """A column that is absent, then an option that is not stated, then a literal."""
    form = STATION_FORMAT.replace("@system", '@datum default $datum default "NZGD1949"')
    stations = STATIONS.replace("system,", "other,").replace("NZGD1949", "ITRF2008")
    network = fga.read(written(tmp_path, marks_dtf=form, site_csv=stations))
    assert network.frame.ellipsoid.name == "International1924"
    path = written(
        tmp_path,
        marks_dtf=form,
        site_csv=stations,
        site_snp=JOB.replace("csv f", "csv datum=NZGD2000 f", 1) + COMMANDS,
    )
    assert fga.read(path, deformation="none").frame.ellipsoid.name == "GRS80"


def test_a_column_of_classifications_must_be_there(tmp_path: Path) -> None:
    form = STATION_FORMAT.replace("c_**", "c_** c_Age")
    with pytest.raises(fga.InputError, match=r"site\.csv:1: lacks the columns c_age of marks\.dtf"):
        fga.read(written(tmp_path, marks_dtf=form))


def test_names_of_columns_beside_a_header_are_refused(tmp_path: Path) -> None:
    """SNAP's manual and its program differ in which of them count."""
    text = STATION_FORMAT + "COLUMNS mark system lon lat h N c_Mark c_Order remark\n"
    with pytest.raises(fga.InputError, match=r"names of COLUMNS and a header"):
        fga.read(written(tmp_path, marks_dtf=text))
