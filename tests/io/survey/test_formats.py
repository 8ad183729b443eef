"""Real field books, and the traps of GSI, SDR33, JobXML, LandXML and tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.gsi_words import gsi_blocks, read_gsi_length
from factorgraph_adj.io.source import TextSource
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance
from factorgraph_adj.units import GON, LENGTH
from tests.io.field_books.field_files import (
    EXAMPLE_FILES,
    MAPPING,
    columns,
    gsi,
    jobxml,
    landxml,
    sdr33,
)
from tests.support.places import data_dir

MM = LENGTH["mm"]


def problems(path, read, text: str, **options) -> list[str]:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read(path, **options)
    return [str(p) for p in caught.value.problems]


# -- real surveys ---------------------------------------------------------------------------------


def test_a_real_network_in_gsi_16_adjusts_as_its_instrument_promises():
    """22 stations, all targets in both faces and rounds; station and height in codes 21."""
    path = data_dir("field_files") / "geoeasy_network.GSI"
    network = fga.read(path, station_code=21)
    assert (len(network.points), len(network.observations)) == (22, 2100)
    assert not network.doubts
    solution = fga.adjust(network)
    assert solution.converged
    assert solution.redundancy == 1884
    assert 0.3 < solution.sigma0 < 0.7  # 1 mgon, 2 mm + 2 ppm and 1 mm centring are careful
    # The plan of the network is found from nothing, and known to a millimetre.
    assert max(solution.standard_deviations(p)[:2].max() for p in network.points) < 2 * MM


def test_heights_of_its_mutual_sights_close():
    """Height differences there and back sum up to less than heights of prisms are known."""
    network = fga.read(data_dir("field_files") / "geoeasy_network.GSI", station_code=21)
    rises: dict[tuple[str, str], list[float]] = {}
    slopes = {(o.station, o.target): o.value for o in network.observations.values()
              if isinstance(o, SlopeDistance)}  # fmt: skip
    for o in network.observations.values():
        if o.kind == "zenith_angle":
            s = slopes[o.station, o.target]
            k = 0.87 * (s * math.sin(o.value)) ** 2 / (2 * network.frame.radius)
            rise = s * math.cos(o.value) + o.instrument_height - o.target_height + k
            rises.setdefault((o.station, o.target), []).append(rise)
    closures = [
        np.mean(rises[a, b]) + np.mean(rises[b, a]) for a, b in rises if (b, a) in rises and a < b
    ]
    assert len(closures) > 20
    assert np.median(np.abs(closures)) < 3 * MM


def test_a_file_that_names_no_station_says_how_to_name_it():
    folder = data_dir("field_files")
    with pytest.raises(InputError) as caught:
        fga.read(folder / "geoeasy_network.GSI")
    assert "geoeasy_network.GSI:2: 1400 sights from here have no station" in str(caught.value)
    assert "give station_code=21 (--set station_code=21) if words 42" in str(caught.value)
    assert "line 60 has other readings of 'BP06'" in str(caught.value)
    assert "give station=NAME (--set station=NAME) if all are from one point" in str(caught.value)
    for name, count in (("RILIEVO.gsi", 24), ("leica_gsi16_gurob.gsi", 321)):
        network = fga.read(folder / name)
        assert "they are one set-up, whose station is called 'station'" in network.remarks[-1]
        assert len(network.points) == len(fga.read(folder / name, station="S").points) == count
    heights = {
        o.instrument_height
        for o in fga.read(folder / "leica_gsi16_gurob.gsi", station="S").observations.values()
    }
    assert heights == {1.324}


def test_blocks_of_gsi_8_in_one_line_and_distances_of_zero():
    """Points 100 and 101 have directions alone: their distances are 0, not measured."""
    network = fga.read(data_dir("field_files") / "RILIEVO.gsi", station="S")
    of = [o.kind for o in network.observations.values() if o.target == "100"]
    assert of == ["direction", "zenith_angle"]
    o = next(o for o in network.observations.values() if o.kind == "direction")
    assert math.isclose(o.value, 115.45200 * GON)


def test_a_real_survey_in_landxml_gives_the_coordinates_of_its_file():
    """TOPS writes east first, and circles oriented to north.

    Targets 901 and 902 of the file agree with one another within 1 mm, but belong to a station
    STAZLIB4 that lies 15 mm and 36 mm beside the one that the file states.
    """
    path = data_dir("field_files") / "landxml.xml"
    network = fga.read(path, order="EN", fixed="STAZLIB3,STAZLIB4", refraction=None)
    for station in ("STAZLIB3", "STAZLIB4"):
        network.set_orientation(station, set="1", value=0.0, fixed=True)
    given = {n: network.points[n].coordinates for n in ("850", "901", "902")}
    solution = fga.adjust(network)
    shift = {name: solution.point(name) - xyz for name, xyz in given.items()}
    assert np.max(np.abs(shift["850"])) < MM
    assert np.max(np.abs(shift["901"] - shift["902"])) < MM
    assert np.max(np.abs(shift["901"] - (-0.011, 0.010, 0.036))) < MM


def test_a_real_sdr33_of_coordinates():
    network = fga.read(data_dir("field_files") / "sokkia_sdr33.tops", format="sdr33")
    assert len(network.points) == 13
    assert network.points["00000031"].coordinates == (937.274, 509.97, 20.053)  # north first


# -- GSI ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("21.322+0000000016901313", 169.01313 * GON),
        ("21.323+0000000016901313", math.radians(169.01313)),
        ("21.024+0000000003545105", math.radians(35 + 45 / 60 + 10.5 / 3600)),
        ("21.325+0000000016000000", math.pi / 2),
    ],
)
def test_units_of_angles_in_gsi(tmp_path, word, value):
    path = tmp_path / "a.gsi"
    path.write_text(f"*110001+00000000000000P1 {word} 22.322+0000000010000000 \n", encoding="utf-8")
    network = fga.read(path, station="S")
    found = next(o for o in network.observations.values() if isinstance(o, Direction))
    assert math.isclose(found.value, value)


@pytest.mark.parametrize(
    ("word", "metres"),
    [
        ("31..00", 12.345678e3),
        ("31..06", 1234.5678),
        ("31..08", 123.45678),
        ("31..01", 3762.9626544),
    ],
)
def test_units_of_lengths_in_gsi(tmp_path, word, metres):
    path = tmp_path / "a.gsi"
    line = f"*110001+00000000000000P1 22.322+0000000010000000 {word}+0000000012345678 \n"
    path.write_text(line, encoding="utf-8")
    found = [o for o in fga.read(path, station="S").observations.values()
             if isinstance(o, SlopeDistance)]  # fmt: skip
    assert math.isclose(found[0].value, metres, rel_tol=1e-7)


def test_wrong_words_of_gsi_are_refused_with_their_line(tmp_path):
    good = gsi()
    path = tmp_path / "a.gsi"
    for old, new, said in (
        (
            "22.322+",
            "22.329+",
            "unit (2 gon, 3 degrees, 4 degrees-minutes-seconds, 5 mil) of word 22 '9' is unknown",
        ),
        ("31...6", "61...6", "word '61' is unknown; valid: 11, 12"),
        ("87...0+", "87...0 ", "is not a word of GSI"),
        ("*110010+", "*210010+", "a block must begin with word 11 or 41, not 21"),
        ("+0000000016901313", "", ""),
    ):
        if old in good:
            found = problems(path, fga.read_gsi, good.replace(old, new))
            assert any(said in p for p in found), found
            assert all(p.startswith("a.gsi:") for p in found)


def test_a_line_of_levels_there_and_back(tmp_path):
    """Method BF and BFFB: dh = mean of backsights − mean of foresights."""
    text = (
        "410001+?......2\n"
        "110002+0000000A 83..08+00000000\n"
        "110003+0000000A 32...8+02000000 331.08+00150000\n"
        "110004+0000000B 32...8+02100000 332.08+00120000\n"
        "110005+0000000B 32...8+02100000 336.08+00120010\n"
        "110006+0000000A 32...8+02000000 335.08+00150030\n"
        "110007+0000000B 83..08+00030000\n"
        "410008+?......1\n"
        "110009+0000000B 32...8+02000000 331.08+00110000\n"
        "110010+0000000X 32...8+01000000 333.08+00100000\n"
        "110011+0000000A 32...8+02000000 332.08+00140010\n"
    )
    path = tmp_path / "levels.gsi"
    path.write_text(text, encoding="utf-8")
    network = fga.read(path, fixed="A")
    found = [o for o in network.observations.values() if isinstance(o, HeightDifference)]
    assert [(o.station, o.target) for o in found] == [("A", "B"), ("B", "X"), ("B", "A")]
    assert np.allclose([o.value for o in found], [0.3001, 0.1, -0.3001], atol=1e-9)
    assert np.allclose([o.length_km for o in found], [0.041, 0.03, 0.04])
    solution = fga.adjust(network)
    assert np.allclose(solution.point("B"), (0, 0, 0.3001))
    found = problems(path, fga.read_gsi, "\n".join(text.split("\n")[:3]))
    assert "levels.gsi:3: the line ends with a backsight alone" in found


# -- SDR33 ----------------------------------------------------------------------------------------


def test_sdr2x_has_shorter_fields(tmp_path):
    path = tmp_path / "a.sdr"
    text = (
        "00NMSDR20 V03-05           01-Jan-04 16:26 111211\n"
        "02KI0001    10.000    20.000     1.500     1.600\n"
        "03NM     1.700\n"
        "09F100010002   100.000  90.00000   45.0000\n"
    )
    path.write_text(text, encoding="utf-8")
    network = fga.read(path)
    assert network.points["0001"].coordinates == (20.0, 10.0, 1.5)
    found = {o.kind: o.value for o in network.observations.values()}
    assert math.isclose(found["direction"], math.pi / 4)
    assert found["slope_distance"] == 100.0


def test_what_sdr_says_in_its_header_counts(tmp_path):
    path = tmp_path / "a.sdr"
    path.write_text(sdr33().replace("211111", "221121"), encoding="utf-8")  # feet, east first
    network = fga.read(path)
    assert np.allclose(network.points["B"].coordinates, (10 * 0.3048, 60 * 0.3048, 101 * 0.3048))
    text = sdr33()
    for old, new, said in (
        (
            "211111",
            "911111",
            "option 1, angles (1 degrees, 2 gon, 3 mil; 4 mil of Nikon), '9' is unknown",
        ),
        ("211111", "211112", "option 6, angles (1 clockwise), '2' is unknown; valid: 1"),
        ("03NM", "77NM", "record '77' is unknown; valid: 00, 01"),
        ("09F1S", "09F1X", "observation from 'X' at 'S'"),
        ("SDR33 V", "XYZ33 V", "the header must be"),
    ):
        found = problems(path, fga.read_sdr33, text.replace(old, new, 1))
        assert any(said in p for p in found), (said, found)


def test_deleted_records_of_sdr_are_left_out(tmp_path):
    path = tmp_path / "a.sdr"
    lines = sdr33().split("\n")
    i = next(i for i, line in enumerate(lines) if line.startswith("09F2"))
    path.write_text("\n".join([*lines[:i], "DD" + lines[i], *lines[i + 1 :]]), encoding="utf-8")
    network = fga.read(path, faces="both")
    assert sum(isinstance(o, Direction) for o in network.observations.values()) == 5


def test_vertical_readings_from_the_horizon(tmp_path):
    path = tmp_path / "a.sdr"
    text = sdr33().split("\n")
    text = [t[:50] + "2" + t[51:] if t.startswith("01NM") else t for t in text]
    rows = []
    for t in text:
        if t.startswith("09F"):
            v = float(t[52:68])
            t = t[:52] + f"{(100.0 - v) % 400:.8f}"[:16].ljust(16) + t[68:]
        rows.append(t)
    (tmp_path / "b.sdr").write_text(sdr33(), encoding="utf-8")
    path.write_text("\n".join(rows), encoding="utf-8")
    a, b = (fga.read(tmp_path / f"{n}.sdr") for n in "ab")
    for x, y in zip(a.observations.values(), b.observations.values(), strict=True):
        assert math.isclose(x.value, y.value, rel_tol=1e-7)


# -- JobXML ---------------------------------------------------------------------------------------


def test_prism_constant_and_ppm_of_jobxml_are_applied_once(tmp_path):
    values = []
    for constant, ppm in ((-0.035, 12.0), (0.0, 0.0)):
        path = tmp_path / "a.jxl"
        path.write_text(jobxml(constant, ppm), encoding="utf-8")
        values.append([o.value for o in fga.read(path).observations.values()
                       if isinstance(o, SlopeDistance)])  # fmt: skip
    assert np.allclose(*values, atol=2e-6)


def test_standard_errors_of_jobxml_count_unless_others_are_stated(tmp_path):
    path = EXAMPLE_FILES["jobxml"].write(tmp_path)

    def sigma(**options) -> float:
        found = fga.read(path, centring_mm=0, **options).observations.values()
        return next(o.sigma for o in found if isinstance(o, Direction))

    assert math.isclose(sigma(), math.radians(0.0006) / math.sqrt(2), rel_tol=1e-9)
    assert math.isclose(sigma(sigma_direction_mgon=2), 2e-3 * GON / math.sqrt(2))


def test_wrong_references_of_jobxml_are_refused(tmp_path):
    path = tmp_path / "a.jxl"
    for old, new, said in (
        ("<StationID>s1", "<StationID>s2", "there is no StationRecord 's2'; known: s1"),
        ("<TargetID>t1", "<TargetID>t9", "there is no TargetRecord 't9'"),
        ("Face1<", "Face3<", "<Face> 'Face3' is unknown; valid: Face1, Face2, FaceNull"),
        (
            "<TheodoliteHeight>1.5",
            "<TheodoliteHeight>high",
            "<TheodoliteHeight>: 'high' is not a number",
        ),
        ("JOBFile", "JobFile", "the root element must be <JOBFile>, not <JobFile>"),
    ):
        found = problems(path, fga.read_jobxml, jobxml().replace(old, new))
        assert any(said in p for p in found), found
        assert all(p.startswith("a.jxl:") for p in found)


def test_jobxml_is_told_from_landxml_by_its_content(tmp_path):
    for name, text in (("a.xml", jobxml()), ("b.xml", landxml())):
        (tmp_path / name).write_text(text, encoding="utf-8")
        assert len(fga.read(tmp_path / name).observations) == 9


# -- LandXML --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "text", "value"),
    [("decimal degrees", "45.5", 45.5), ("decimal dd.mm.ss", "45.3000", 45.5), ("grads", "50", 45)],
)
def test_angular_units_of_landxml(tmp_path, unit, text, value):
    body = landxml().replace("grads", unit)
    start = body.index('horizAngle="') + len('horizAngle="')
    body = body[:start] + text + body[body.index('"', start) :]
    body = (
        body[: body.index("</RawObservation>")]
        + "</RawObservation></ObservationGroup></Survey></LandXML>"
    )
    begin = body.index('zenithAngle="')
    body = body[:begin] + body[body.index('slopeDistance="') :]
    body = body.replace("<RawObservation ", '<RawObservation directFace="true" ')
    path = tmp_path / "a.xml"
    path.write_text(body, encoding="utf-8")
    found = next(o for o in fga.read(path).observations.values() if isinstance(o, Direction))
    assert math.isclose(math.degrees(found.value), value, abs_tol=1e-9)


def test_wrong_landxml_is_refused_with_its_line(tmp_path):
    path = tmp_path / "a.xml"
    for old, new, said in (
        (
            'angularUnit="grads"',
            'angularUnit="gon"',
            "angularUnit 'gon' is unknown; valid: radians, grads",
        ),
        (
            'linearUnit="meter"',
            'linearUnit="ell"',
            "linearUnit 'ell' is unknown; valid: millimeter",
        ),
        ('setupID="s1"', 'setupID="s2"', "the observation needs setupID; 's2' is none of s1"),
        ("<Units>", "<Unit>", "is not well-formed XML"),
        ('name="A">', 'name="A">1 ', "needs north, east and elevation, not 4 numbers"),
        ("<Survey>", '<Survey><GPSVector setupID_A="1"/>', "<GPSVector> is not read"),
    ):
        text = landxml().replace(old, new)
        found = problems(path, fga.read_landxml, text)
        assert any(said in p for p in found), (said, found)


def test_points_are_written_as_landxml_and_read_again(tmp_path):
    network = fga.read(EXAMPLE_FILES["gsi"].write(tmp_path), fixed="A,B,C")
    adjusted = fga.adjust(network).as_network()
    with pytest.raises(InputError, match="9 observations and photos are not written"):
        fga.write_landxml(adjusted, tmp_path / "out.xml")
    assert not (tmp_path / "out.xml").exists()
    fga.write_landxml(adjusted, tmp_path / "out.xml", points_only=True)
    back = fga.read(tmp_path / "out.xml")
    assert {n: p.coordinates for n, p in back.points.items()} == {
        n: p.coordinates for n, p in adjusted.points.items()
    }


# -- tables ---------------------------------------------------------------------------------------


def test_a_mapping_may_stand_in_a_toml_file_and_in_the_command(tmp_path):
    path = EXAMPLE_FILES["columns"].write(tmp_path)
    lines = ['decimal = ","']
    for section in ("points", "readings"):
        lines += [f"[{section}]", *(f"{k} = '{v}'" for k, v in MAPPING[section].items())]
    (tmp_path / "map.toml").write_text("\n".join(lines), encoding="utf-8")
    network = fga.read(path, mapping=str(tmp_path / "map.toml"))
    assert len(network.observations) == 9


def test_observations_of_any_kind_by_columns(tmp_path):
    path = tmp_path / "list.csv"
    rows = "From,To,Type,Obs,SD mm\nA,B,slope_distance,100.0,2\nA,C,height_difference,1.5,3\n"
    path.write_text(rows, encoding="utf-8")
    mapping = {
        "observations": {"station": "From", "target": "To", "kind": "Type", "value": "Obs",
                         "sigma_mm": "SD mm"},
    }  # fmt: skip
    network = fga.read(path, mapping=mapping)
    assert [(o.kind, o.value) for o in network.observations.values()] == [
        ("slope_distance", 100.0), ("height_difference", 1.5)
    ]  # fmt: skip
    assert set(network.points) == {"A", "B", "C"}
    mapping["observations"]["kind"] = "=slope_distance"
    assert fga.read(path, mapping=mapping).observations["2"].kind == "slope_distance"


def test_points_without_a_header_in_feet_east_second(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text("A 1000 2000 5 yes\nB 1100 2000 5 xy\n", encoding="utf-8")
    mapping = {
        "delimiter": "blank", "header": 0, "axes": "ne", "units": {"length": "mm"},
        "points": {"name": "1", "x": "2", "y": "3", "z": "4", "fixed": "5"},
    }  # fmt: skip
    network = fga.read(path, mapping=mapping)
    assert network.frame.axes == "ne"
    assert network.points["A"].held == "xyz" and network.points["B"].held == "xy"
    assert np.allclose(network.points["B"].coordinates, (1.1, 2.0, 0.005))


def test_mistakes_in_mapping_and_table_are_told_with_their_place(tmp_path):
    path = EXAMPLE_FILES["columns"].write(tmp_path)
    for change, said in (
        ({"decimals": ","}, "unknown key 'decimals'; valid: .*did you mean 'decimal'"),
        ({"decimal": ";"}, "decimal must be one of"),
        ({"encoding": "klingon"}, "unknown encoding"),
        ({"units": {"angle": "grade"}}, "unknown unit 'grade'"),
        ({"points": {"nam": "Punkt"}}, "points has no column 'nam'"),
        ({"points": {"file": "../x.csv", "name": "P"}}, "lies outside the folder of the project"),
        ({"readings": {"station": "=S", "target": "Zie"}},
         "book.csv:1: there is no column 'Zie'; columns: Ziel, .*did you mean 'Ziel'"),
        ({"decimal": "."}, "book.csv:2: direction: .* is not a number"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            fga.read(path, mapping={**MAPPING, **change})
    with pytest.raises(InputError, match="needs one of the tables points, readings, levelling"):
        fga.read(path, mapping={})
    text = columns()["book.csv"].encode("utf-8").replace(b"x", b"\xe4")
    path.write_bytes(text)
    with pytest.raises(InputError, match=r"book.csv:2: is not utf-8-sig text: state encoding"):
        fga.read(path, mapping=MAPPING)
    assert len(fga.read(path, mapping={**MAPPING, "encoding": "cp1252"}).observations) == 9


def test_the_circle_of_a_backsight_counts_where_no_raw_observation_repeats_it(tmp_path):
    body = landxml()
    back = '<Backsight id="b" setupID="s1" circle="12.5"><BacksightPoint name="{}"/></Backsight>'
    kinds = {}
    for name in ("A", "D"):
        path = tmp_path / f"{name}.xml"
        path.write_text(body.replace("<Survey>", "<Survey>" + back.format(name)), encoding="utf-8")
        found = [o for o in fga.read(path).observations.values() if o.target == name]
        kinds[name] = [(o.kind, o.set if isinstance(o, Direction) else "") for o in found]
        if name == "D":
            assert math.isclose(found[0].value, 12.5 * GON, rel_tol=1e-3)
    assert [k for k, _ in kinds["A"]] == ["direction", "zenith_angle", "slope_distance"]
    assert kinds["D"] == [("direction", "1")]


@pytest.mark.parametrize(
    ("word", "metres"),
    [
        ("83..10+0000000000151200", 151.2),
        ("31...6+0000000000250795", 25.0795),
        ("83..28+0000000010000001", 100.00001),
        ("87...1+0000000000001000", 0.3048),
    ],
)
def test_lengths_of_gsi_are_the_floats_of_their_decimals(tmp_path, word, metres):
    """151.2, not 151.20000000000002, so that a project written from it reads as the book does."""
    path = tmp_path / "book.gsi"
    path.write_text(f"*{word} ", encoding="utf-8")
    source = TextSource(path)
    (block,) = gsi_blocks(source)
    assert read_gsi_length(source.field(1, block.words[0][1], "word")) == metres


def test_a_table_without_a_mapping_and_with_commas_says_what_to_state(tmp_path):
    """A missing option is an error of the input, not of the program."""
    (tmp_path / "book.csv").write_text("P;H\nA;1,5\n", encoding="utf-8")
    with pytest.raises(InputError, match="needs a mapping of its columns"):
        fga.read(tmp_path / "book.csv")
    mapping = '[points]\nname = "P"\nz = "H"\n'
    (tmp_path / "map.toml").write_text(mapping, encoding="utf-8")
    with pytest.raises(InputError, match="write a decimal point, or state decimal = ',' in the"):
        fga.read(tmp_path / "book.csv", mapping=tmp_path / "map.toml")
