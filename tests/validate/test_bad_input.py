"""Bad input ends in a list of all problems, each with file, line, observation and what is valid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factorgraph_adj.errors import InputError, known
from factorgraph_adj.frames import GeocentricFrame
from factorgraph_adj.io.observation_records import observation_from_record
from factorgraph_adj.io.project import load_project, read_project
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import KINDS as REGISTERED
from factorgraph_adj.observations import Direction, GnssVector, SlopeDistance
from factorgraph_adj.validate.network_structure import check
from tests.networks.projects import IMAGES, OBSERVATIONS, PHOTOS, POINTS, PROJECT, write

TEXTS = {
    "project": PROJECT,
    "points": POINTS,
    "photos": PHOTOS,
    "images": IMAGES,
    "observations": OBSERVATIONS,
}
KINDS = known(REGISTERED, most=80)
LENGTHS = "m, dm, cm, mm, um, km"
ANGLES = "rad, mrad, gon, mgon, cc, deg, arcmin, arcsec"


def problems(path: Path) -> list[str]:
    """Return the problems of reading a project, or else of checking it."""
    try:
        project = load_project(path)
    except InputError as error:
        return [str(p) for p in error.problems]
    return [str(p) for p in check(project.network, sources=project.sources)]


def test_the_project_that_the_others_break_has_no_problems(tmp_path):
    assert problems(write(tmp_path)) == []


NAMED = "".join(f'{t} = "{t}.csv"\n' for t in ("observations", "photos", "images"))
"""The tables of the project."""
READING = {
    # name: table, what stands there, what is put there, the problem
    "a number that cannot be read": (
        *("points", "C,5.01,8,1,", "C,5.01,8,1o,"),
        "points.csv:4: point 'C': z: '1o' is not a number",
    ),
    "a decimal comma": (
        *("observations", "1,A,C,9.487", '1,A,C,"9,487"'),
        "observations.csv:2: slope_distance A C (id 1): value: '9,487' is not a number; "
        "write a decimal point",
    ),
    "NaN": (
        *("points", "C,5.01,8,1,", "C,5.01,nan,1,"),
        "points.csv:4: point 'C': y: 'nan' is not a finite number",
    ),
    "infinity": (
        *("observations", "1,A,C,9.487", "1,A,C,inf"),
        "observations.csv:2: slope_distance A C (id 1): value: 'inf' is not a finite number",
    ),
    "a number beyond all floats": (
        *("images", "P,A,-50", "P,A,1e999"),
        "images.csv:2: image point P/A: x: '1e999' is not a finite number",
    ),
    "an image coordinate that cannot be read": (
        *("images", "P,A,-50", "P,A,-50.."),
        "images.csv:2: image point P/A: x: '-50..' is not a number",
    ),
    "an unknown point": (
        *("observations", "1,A,C,9.487", "1,A,G,9.487"),
        "observations.csv:2: slope_distance A G (id 1): unknown point 'G'; known: A, B, C, D, E, F",
    ),
    "an unknown point in a photo": (
        *("images", "P,A,-50", "P,G,-50"),
        "images.csv:2: unknown point 'G'; known: A, B, C, D, E, F",
    ),
    "an unknown photo": (
        *("images", "P,A,-50", "Q,A,-50"),
        "images.csv:2: unknown photo 'Q'; known: P",
    ),
    "an unknown camera": (
        *("photos", "P,cam", "P,can"),
        "photos.csv:2: photo 'P': unknown camera 'can'; known: cam; did you mean 'cam'?",
    ),
    "a duplicate point": (
        *("points", "F,5,5,3,", "F,5,5,3,\nF,5,5,4,"),
        "points.csv:8: point 'F': duplicate name of a point; first in line 7",
    ),
    "a duplicate id": (
        *("observations", "2,B,C,9.487", "1,B,C,9.487"),
        "observations.csv:3: slope_distance B C (id 1): duplicate id '1'",
    ),
    "a point twice in a photo": (
        *("images", "P,C,0,0", "P,B,0,0\nP,C,0,0"),
        "images.csv:4: image point P/B: the point is measured more than once in this photo; "
        "first in line 3",
    ),
    "a missing name": (
        *("observations", "1,A,C,9.487", "1,A,,9.487"),
        "observations.csv:2: slope_distance A (id 1): target is missing",
    ),
    "a held coordinate without a value": (
        *("points", "A,0,0,0,xyz", "A,0,0,,xyz"),
        "points.csv:2: point 'A': z is held or weighted but has no value",
    ),
    "held components that are none": (
        *("points", "B,10,0,0,xyz", "B,10,0,0,xyw"),
        "points.csv:3: point 'B': fixed must be some of x, y, z, not 'xyw'",
    ),
    "half an attitude": (
        *("photos", "100,0,0", "100,0,"),
        "photos.csv:2: photo 'P': kappa is missing",
    ),
    "a row that is too long": (
        *("points", "C,5.01,8,1,", "C,5.01,8,1,,7"),
        "points.csv:4: 6 cells, but the header has 5 columns",
    ),
    "a decimal comma between commas": (
        *("points", "C,5.01,8,1,", "C,5,01,8,1,"),
        "points.csv:4: 6 cells, but the header has 5 columns; is one of the commas a decimal "
        "comma? Write numbers with a decimal point",
    ),
    "a decimal comma in quotation marks": (
        *("points", "C,5.01,", 'C,"5,01",'),
        "points.csv:4: point 'C': x: '5,01' is not a number; write a decimal point",
    ),
    "a decimal comma after a point for thousands": (
        *("points", "C,5.01,", 'C,"1.005,01",'),
        "points.csv:4: point 'C': x: '1.005,01' is not a number; write a decimal point",
    ),
    "a decimal comma in TOML": (
        *("project", 'name = "yard"', 'name = "yard"\n[adjust]\nmax_iterations = 1,5'),
        "project.toml:3: 1,5 is not a number: write a decimal point, 1.5 (is not TOML: Expected "
        "newline or end of document after a statement (at line 3, column 19))",
    ),
    "a decimal comma in an inline table of TOML": (
        *("project", "value = 0.01, sigma", "value = 0,01, sigma"),
        "project.toml:13: 0,01 is not a number: write a decimal point, 0.01 (is not TOML: Expected "
        "'=' after a key in a key/value pair (at line 13, column 20))",
    ),
    "σ of a point in east, north, up": (
        *("points", "name,x,y,z,fixed", "name,x,y,z,sigma_e_mm"),
        "points.csv:1: unknown column 'sigma_e_mm': a table of points has σ along x, y, z of the "
        "frame; σ along east, north, up is that of a control point: a row of observations.csv of "
        "the kind control with axes enu, all of x, y, z, and sigma_e_mm",
    ),
    "σ of zero": (
        *("observations", "6.344,1.5", "6.344,0"),
        "observations.csv:4: slope_distance A D (id 3): sigma_mm must be greater than zero, not 0",
    ),
    "σ below zero": (
        *("observations", "95.0,,2", "95.0,,-2"),
        "observations.csv:9: zenith_angle A D (id 8): sigma_mgon must be greater than zero, not -2",
    ),
    "no σ": (
        *("observations", "direction,12,A,C,0,,1", "direction,12,A,C,0,,"),
        "observations.csv:13: direction A C (id 12): no standard deviation: give sigma_mgon "
        "(or another unit) here or in [sigma.direction] of the project",
    ),
    "σ in a unit of something else": (
        *("observations", "direction,12,A,C,0,,1", "direction,12,A,C,0,1,1"),
        "observations.csv:13: direction A C (id 12): sigma_mm does not apply to direction; it "
        "takes: kind, id, station, target, value, unit, instrument_height, target_height, face, "
        "set, collimation_error, sigma_mgon, centring_instrument_mm, centring_target_mm, combine",
    ),
    "an unknown unit of a column": (
        *("observations", "sigma_mgon", "sigma_mgrad"),
        f"observations.csv:1: unknown unit 'mgrad' in 'sigma_mgrad'; valid: {LENGTHS}, {ANGLES}, "
        "px",
    ),
    "an unknown unit of angles": (
        *("project", 'angle = "gon"', 'angle = "grad"'),
        f"project.toml:4: [units]: angle: unknown unit 'grad'; valid: {ANGLES}, dms",
    ),
    "an unknown unit of a camera": (
        *("project", 'unit = "mm"', 'unit = "inch"'),
        f"project.toml:9: [[camera]] 'cam': unknown unit 'inch'; valid: px, {LENGTHS}",
    ),
    "an unknown kind": (
        *("observations", "zenith_angle,7", "zenit,7"),
        f"observations.csv:8: zenit A C (id 7): unknown kind 'zenit'; valid: {KINDS}",
    ),
    "an unknown kind of default": (
        *("project", "[sigma.slope_distance]", "[sigma.distance]"),
        f"project.toml:15: [sigma]: unknown kind 'distance'; valid: {KINDS}; did you mean "
        "'slope_distance'?",
    ),
    "a default σ below zero": (
        *("project", "sigma_mm = 2", "sigma_mm = -2"),
        "project.toml:16: [sigma.slope_distance]: sigma_mm must be greater than zero, not -2",
    ),
    "σ of image coordinates of zero": (
        *("project", "sigma_um = 5", "sigma_um = 0"),
        "project.toml:10: [[camera]] 'cam': sigma_um must be greater than zero, not 0",
    ),
    "σ of a calibration parameter of zero": (
        *("project", "sigma = 0.02", "sigma = 0"),
        "project.toml:13: [[camera]] 'cam' parameter x0: sigma must be greater than zero, not 0",
    ),
    "an unknown lens model": (
        *("project", 'model = "harmonic"', 'model = "stereographic"'),
        "project.toml:8: [[camera]] 'cam' lens: unknown model 'stereographic'; valid: "
        + ", ".join(LENSES),
    ),
    "an unknown calibration parameter": (
        *("project", "c = 100.0", "c = 100.0\nk1 = 0.0"),
        "project.toml:13: camera 'cam': unknown calibration parameter k1 of lens model 'harmonic'; "
        "known: c, x0, y0, a00, a11, b11, a20, a22, b22, a31, b31, a33, b33",
    ),
    "a camera inside out": (
        *("project", "c = 100.0", "c = -100.0"),
        "project.toml:6: camera 'cam': the principal distance must be positive, not -100.0; one "
        "that is unknown may be left out if it is free and the format is given",
    ),
    "a missing column": (
        *("images", "photo,point,x,y", "photo,point,x,z"),
        "images.csv:1: missing column 'y'; columns: photo, point, x, z",
    ),
    "a misspelt column": (
        *("points", "z,fixed", "z,fixd"),
        "points.csv:1: unknown column 'fixd'; did you mean 'fixed'?",
    ),
    "a column twice": (*("points", "x,y,z", "x,y,y"), "points.csv:1: duplicate column 'y'"),
    "no columns at all": (
        *("points", POINTS, ""),
        "points.csv: is empty: the first line must name the columns",
    ),
    "an observation from a point to itself": (
        *("observations", "1,A,C,9.487", "1,C,C,9.487"),
        "observations.csv:2: slope_distance C C (id 1): an observation cannot join a point to "
        "itself",
    ),
    "a broken quotation": (
        *("points", "F,5,5,3,", 'F,5,5,"3'),
        "points.csv:7: is not CSV: unexpected end of data",
    ),
    "broken TOML": (
        *("project", 'name = "yard"', "name = yard"),
        "project.toml:1: is not TOML: Invalid value (at line 1, column 8)",
    ),
    "an unknown datum": (
        *("project", 'name = "yard"', 'name = "yard"\ndatum = "loose"'),
        "project.toml:2: unknown datum 'loose'; valid: given, free",
    ),
    "an unknown key": (
        *("project", 'name = "yard"', 'name = "yard"\nnote = "old"'),
        "project.toml:2: unknown key 'note'; known: name, datum, dimension, frame, crs, units, "
        "files, camera, sigma, readings, adjust",
    ),
    "an unknown frame": (
        *("project", 'name = "yard"', 'name = "yard"\n[frame]\nkind = "flat"'),
        "project.toml:3: [frame]: unknown kind 'flat'; valid: local, geocentric, topocentric",
    ),
    "left-handed axes with photos": (
        *("project", 'name = "yard"', 'name = "yard"\n[frame]\naxes = "ne"'),
        "photos.csv:2: photo 'P': photos need a right-handed frame: choose axes en, nw, ws or se",
    ),
    "a table that is not there": (
        *("project", 'name = "yard"', 'name = "yard"\n[files]\n' + NAMED + 'verticals = "v.csv"'),
        "v.csv: cannot be read: no such file or folder",
    ),
}


@pytest.mark.parametrize("name", READING)
def test_reading_names_file_line_and_what_is_valid(tmp_path, name):
    table, good, bad, expected = READING[name]
    assert good in TEXTS[table]
    found = problems(write(tmp_path, **{table: TEXTS[table].replace(good, bad, 1)}))
    assert expected in found
    # One cause, one problem: what follows from it is not listed; a missing column is unknown too.
    assert len(found) == (2 if name == "a missing column" else 1)


def test_every_problem_is_found_in_one_run(tmp_path):
    path = write(
        tmp_path,
        project=PROJECT.replace('angle = "gon"', 'angle = "grad"').replace("c = 100.0", "c = 0"),
        points=POINTS.replace("C,5.01,8,1,", "C,x,y,1,"),
        photos=PHOTOS.replace("5,-10,1", "5,-1O,1"),
        images=IMAGES.replace("P,A,-50", "P,A,?"),
        observations=OBSERVATIONS.replace("1,A,C,9.487,,", "1,A,A,9..487,0,").replace(
            "direction,14", "direktion,14"
        ),
    )
    assert problems(path) == [
        f"project.toml:4: [units]: angle: unknown unit 'grad'; valid: {ANGLES}, dms",
        "project.toml:6: camera 'cam': the principal distance must be positive, not 0.0; one that "
        "is unknown may be left out if it is free and the format is given",
        "points.csv:4: point 'C': x: 'x' is not a number",
        "points.csv:4: point 'C': y: 'y' is not a number",
        "photos.csv:2: photo 'P': y: '-1O' is not a number",
        "images.csv:2: image point P/A: x: '?' is not a number",
        "observations.csv:2: slope_distance A A (id 1): value: '9..487' is not a number",
        "observations.csv:2: slope_distance A A (id 1): sigma_mm must be greater than zero, not 0",
        "observations.csv:2: slope_distance A A (id 1): an observation cannot join a point to "
        "itself",
        f"observations.csv:15: direktion A B (id 14): unknown kind 'direktion'; valid: {KINDS}; "
        "did you mean 'direction'?",
    ]


def test_bad_numbers_do_not_hide_a_bad_structure(tmp_path):
    path = write(
        tmp_path,
        points=POINTS.replace(",xyz", ","),
        observations=OBSERVATIONS.replace("1,A,C,9.487", "1,A,C,9.4x7"),
    )
    numbers, datum = problems(path)
    assert numbers.endswith("value: '9.4x7' is not a number")
    assert datum.startswith("network 'yard': no datum: nothing holds x, y, z of the network")


def test_an_unknown_name_in_many_rows_of_images_is_one_problem(tmp_path):
    path = write(tmp_path, images=IMAGES.replace("P,", "Q,"))
    assert problems(path) == [
        "images.csv:2: unknown photo 'Q'; known: P (also in lines 3, 4, 5, 6, 7)"
    ]


def test_text_that_is_not_utf_8_is_named(tmp_path):
    path = write(tmp_path)
    (tmp_path / "points.csv").write_bytes(POINTS.replace("A,", "Ä,", 1).encode("latin-1"))
    assert problems(path)[0] == (
        "points.csv:2: is not UTF-8 text (byte 17): the last character of 'Ä' is in another "
        "encoding, such as Latin-1 (Windows-1252); save the file as UTF-8 (of a spreadsheet: as "
        "CSV UTF-8)"
    )
    path = write(tmp_path)
    text = '# lines\nname = "Höhennetz"\n'
    path.write_bytes(text.encode("latin-1"))
    assert problems(path)[0].startswith("project.toml:2: is not UTF-8 text (byte 17): the last")
    path.write_bytes(text.encode("utf-16") + b"x")
    assert problems(path) == ["project.toml: is damaged UTF-16 text: save it as UTF-8"]


def test_text_in_utf_16_is_read(tmp_path):
    path = write(tmp_path)
    path.write_text(path.read_text(), encoding="utf-16")
    assert len(load_project(path).network.points) == 6


def test_sigma_in_east_north_up_without_its_axes_is_told_what_to_state(tmp_path):
    control = "kind,point,x,y,z,sigma_e_mm,sigma_n_mm,sigma_u_mm\ncontrol,C,5,8,1,3,3,5\n"
    assert problems(write(tmp_path, observations=control))[0] == (
        "observations.csv:2: control C: no standard deviation of x: give sigma_x_mm or sigma_mm; "
        "sigma_e_mm belongs to axes enu: state axes = enu"
    )


THREE_PHOTOS = "name,x,y,z,omega,phi,kappa,camera\n" + "".join(
    f"P{i},5,5,20,0,0,0,CAM\n" for i in "123"
)


@pytest.mark.parametrize(
    ("good", "bad", "expected"),
    [
        ('name = "cam"', 'nam = "CAM"', "project.toml:6: [[camera]] 1: name is missing"),
        ("[[camera]]", "[camera]", "project.toml:6: camera: cameras must be tables [[camera]]"),
        ("[[camera]]", "[[cameras]]", "project.toml:6: unknown key 'cameras'; known: "),
        (
            *('name = "cam"', 'name = "cam"'),
            "photos.csv:2: photo 'P1': unknown camera 'CAM'; known: cam; did you mean 'cam'? "
            "(also in photos.csv:3, photos.csv:4)",
        ),
    ],
)
def test_photos_do_not_repeat_what_is_wrong_with_their_camera(tmp_path, good, bad, expected):
    project = PROJECT.replace(good, bad, 1)
    if bad == "[[cameras]]":
        project = project.replace("[camera.parameters]", "[cameras.parameters]")
    path = write(tmp_path, project=project, photos=THREE_PHOTOS, images=IMAGES.replace("P,", "P1,"))
    found = problems(path)
    assert found[0].startswith(expected)
    assert sum("camera" in p for p in found) == 1 + (bad.startswith("nam ="))


def test_a_project_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml: cannot be read: no such file"):
        read_project(tmp_path / "nowhere.toml")


# -- covariances ----------------------------------------------------------------------------------

VECTORS = """\
kind,id,station,target,x,y,z,sigma_mm
gnss_vector,v1,A,C,5.01,8,1,
gnss_vector,v2,B,C,-4.99,8,1,
"""
DIAGONAL = "".join(f"k,{v},{a},{v},{a},4\n" for v in ("v1", "v2") for a in "xyz")
HEADER = "cluster,id,component,id2,component2,covariance_mm2\n"


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (
            DIAGONAL + "k,v1,x,v2,x,5\n",
            "covariances.csv:2: cluster 'k': the covariance matrix is not positive definite "
            "(smallest eigenvalue of the correlations -2.50e-01)",
        ),
        (
            DIAGONAL + "k,v1,x,v3,x,1\n",
            "covariances.csv:2: cluster 'k': unknown id 'v3'; known: v1, v2",
        ),
        (
            DIAGONAL + "k,v1,x,v2,w,1\n",
            "covariances.csv:8: cluster 'k': unknown component 'w' of 'v2'; valid: x, y, z",
        ),
        (
            DIAGONAL.replace("k,v2,z,v2,z,4\n", ""),
            "covariances.csv:2: cluster 'k': the variance is missing of v2 z",
        ),
        (
            DIAGONAL + "k,v1,x,v2,x,1..\n",
            "covariances.csv:8: cluster 'k': covariance_mm2: '1..' is not a number",
        ),
        (
            DIAGONAL + "l,v1,x,v2,x,1\n",
            "covariances.csv:8: cluster 'l': observation 'v1' is in cluster 'k' too",
        ),
    ],
)
def test_a_covariance_that_is_none_is_named(tmp_path, rows, expected):
    vectors = VECTORS.replace(",\n", ",3\n")
    path = write(tmp_path, observations=vectors, covariances=HEADER + rows)
    assert expected in problems(path)


def test_members_of_a_cluster_need_no_standard_deviation_of_their_own(tmp_path):
    path = write(tmp_path, observations=VECTORS, covariances=HEADER + DIAGONAL)
    ids, covariance = read_project(path).clusters[0]
    assert ids == ("v1", "v2")
    assert np.array_equal(covariance, np.diag([4e-6] * 6))


def test_the_covariance_of_one_vector_must_be_positive_definite():
    fields = {"kind": "gnss_vector", "station": "A", "target": "C", "x": 1, "y": 2, "z": 3}
    fields |= {f"covariance_{a}{a}_mm2": 1 for a in "xyz"}
    with pytest.raises(InputError) as caught:
        observation_from_record(fields | {"covariance_xy_mm2": 2}, source="stream:7")
    assert str(caught.value) == (
        "stream:7: gnss_vector A C: the covariance matrix is not positive definite "
        "(smallest eigenvalue of the correlations -1.00e+00)"
    )


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"value": "5,3"}, "value must be a finite number, not '5,3'"),
        ({"value": "5.3"}, "value must be a finite number, not '5.3'"),
        ({"value": None}, "value must be a finite number, not None"),
        ({"sigma": "2mm"}, "sigma must be a finite number, not '2mm'"),
        ({"instrument_height": float("nan")}, "instrument_height must be a finite number, not nan"),
        ({"target": 7}, "target must be text, not 7"),
        ({"set": 1}, "set must be text, not 1"),
        ({"id": 5}, "id must be text, not 5"),
    ],
)
def test_values_of_the_wrong_type_name_the_observation(wrong, expected):
    given = {"station": "A", "target": "P", "value": 5.3, "sigma": 2e-5, "id": "r1"} | wrong
    with pytest.raises(InputError) as caught:
        Direction(**given)
    assert str(caught.value) == f"direction A {given['target']} (id {given['id']}): {expected}"


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"value": None}, "value must be a finite number, not None"),
        ({"value": ("1", "x", 2)}, "value must be a finite number, not ('1', 'x', 2)"),
        ({"value": ((1,), (2, 3))}, "value must be a finite number, not ((1,), (2, 3))"),
        ({"value": (1, 2)}, "value must have 3 components, not (1, 2)"),
        ({"value": 3.0}, "value must have 3 components, not 3.0"),
        ({"covariance": "x"}, "covariance must be a finite number, not 'x'"),
        ({"covariance": None, "sigma": 0.1}, "sigma must be 3 standard deviations, not 0.1"),
    ],
)
def test_vectors_of_the_wrong_type_or_shape_are_named(wrong, expected):
    given = {"value": (1.0, 2.0, 3.0), "covariance": np.eye(3), "id": "v1"} | wrong
    with pytest.raises(InputError) as caught:
        GnssVector("A", "P", **given)
    assert str(caught.value) == f"gnss_vector A P (id v1): {expected}"


def test_an_unknown_kind_is_told_with_what_the_record_says_of_itself():
    record = {"kind": "slope_distnce", "station": "A", "target": "C", "id": "x5"}
    with pytest.raises(InputError, match=r"A C \(id x5\): unknown kind 'slope_distnce'"):
        observation_from_record(record, source="stream:5")


def test_a_vector_with_a_covariance_cannot_join_a_point_to_itself_either():
    with pytest.raises(InputError, match="cannot join a point to itself"):
        GnssVector("A", "A", (0.0, 0.0, 0.0), covariance=np.eye(3))


def test_a_distance_meter_with_a_standard_deviation_of_zero_is_not_free():
    with pytest.raises(InputError, match="standard deviations must be 2 numbers > 0"):
        Network().set_distance_meter("EDM", sigma_scale=0.0)


# -- structure and geometry -----------------------------------------------------------------------

LOOSE = POINTS + "G,1,2,3,\nH,2,2,3,\nI,4,5,6,\nJ,3,5,2,\n"
BETWEEN = "".join(
    f"slope_distance,{20 + i},{pair[0]},{pair[1]},3,,\n"
    for i, pair in enumerate(("GH", "GI", "GJ", "HI", "HJ", "IJ"))
)


def with_datum_points(points: str, names: str) -> str:
    """Return a table of points with a column of datum points."""
    head, *rows = points.splitlines()
    flagged = (f"{r},{'yes' if r[0] in names else ''}" for r in rows)
    return "\n".join([f"{head},datum", *flagged, ""])


CHECKING = {
    "no datum": (
        {"points": POINTS.replace(",xyz", ",")},
        "network 'yard': no datum: nothing holds x, y, z of the network; fix or weight "
        'coordinates, give control or GNSS positions, or ask for a free network (datum = "free")',
    ),
    "half a datum": (
        {"points": POINTS.replace("A,0,0,0,xyz", "A,0,0,0,x").replace("10,0,0,xyz", "10,0,0,z")},
        "network 'yard': no datum: nothing holds y of the network; fix or weight "
        'coordinates, give control or GNSS positions, or ask for a free network (datum = "free")',
    ),
    "unconnected parts": (
        {"points": LOOSE, "observations": OBSERVATIONS + BETWEEN},
        "unconnected part of G, H, I, J: no observation joins this part to the rest "
        "(C, D, E, F, photo P), and nothing holds its x, y, z: observe between them, or give it "
        "control",
    ),
    "unconnected parts of a free network": (
        {
            "project": PROJECT.replace('"yard"', '"yard"\ndatum = "free"'),
            "points": LOOSE.replace(",xyz", ","),
            "observations": OBSERVATIONS + BETWEEN,
        },
        "unconnected part of G, H, I, J: no observation joins this part to the rest "
        "(A, B, C, D, E, F, … (7 in all)), and nothing holds its x, y, z: observe between them, "
        "or give it control",
    ),
    "a datum point that nothing observes": (
        {"points": with_datum_points(POINTS + "G,1,2,3,\n", "G")},
        "points.csv:8: point 'G': no observation: observe it, hold it (column fixed), take it "
        "out, or adjust --leave-out-undetermined",
    ),
    "a point with one ray": (
        {"points": POINTS + "G,1,2,3,\n", "images": IMAGES + "P,G,0,0\n"},
        "points.csv:8: point 'G': only 1 image ray for 3 free coordinates: observe it more, give "
        "control, hold coordinates (column fixed), or adjust --leave-out-undetermined",
    ),
    "a photo with too few points": (
        {
            "images": "".join(IMAGES.splitlines(keepends=True)[:3]),
            "points": POINTS.replace("F,5,5,3,", "F,5,5,3,xyz"),
        },
        "photos.csv:2: photo 'P': 2 image points: its 6 unknowns need at least 3",
    ),
    "a vertical sight with a direction": (
        {
            "points": POINTS.replace("D,2,6.01", "D,0,0"),
            "observations": OBSERVATIONS.replace("zenith_angle,8,A,D", "zenith_angle,8,A,E"),
        },
        "observations.csv:14: direction A D (id 13): the sight is vertical: it has no azimuth",
    ),
    "a sight without length": (
        {
            "points": POINTS.replace("D,2,6.01,0.5", "D,0,0,0"),
            "observations": OBSERVATIONS.replace(
                "zenith_angle,8,A,D", "zenith_angle,8,A,E"
            ).replace("13,A,D", "13,A,E"),
        },
        "observations.csv:4: slope_distance A D (id 3): station and target coincide: the sight "
        "has no length",
    ),
    "a point in the focal plane": (
        {"points": POINTS.replace("F,5,5,3", "F,7,-10,3")},
        "images.csv:7: image P F: the point lies in the focal plane of the photo: it has no image",
    ),
    "no observations": (
        {
            "project": PROJECT.replace("{ value = 0.01, sigma = 0.02 }", "0.01"),
            "images": "photo,point,x,y\n",
            "observations": "kind,id\n",
        },
        "nothing to adjust: the network has no observations",
    ),
    "nothing unknown": (
        {
            "project": PROJECT.replace("{ value = 0.01, sigma = 0.02 }", "0.01"),
            "points": POINTS.replace(",\n", ",xyz\n"),
            "photos": "name,camera,x,y,z,omega,phi,kappa,fixed\nP,cam,5,-10,1,100,0,0,yes\n",
            "observations": "".join(OBSERVATIONS.splitlines(keepends=True)[:-3]),
        },
        "nothing to adjust: everything is held",
    ),
}


MORE = ("unconnected parts of a free network",)


@pytest.mark.parametrize("name", CHECKING)
def test_checking_names_what_is_missing_before_adjusting(tmp_path, name):
    changed, expected = CHECKING[name]
    found = problems(write(tmp_path, **changed))
    assert expected in found
    # The two parts of a free network lack each other.
    assert len(found) == (2 if name in MORE else 1)


def test_two_parts_with_a_datum_each_are_a_network(tmp_path):
    held = LOOSE
    for name in "GHI":
        line = next(x for x in held.splitlines() if x.startswith(f"{name},"))
        held = held.replace(line, line + "xyz")
    path = write(tmp_path, points=held, observations=OBSERVATIONS + BETWEEN)
    assert problems(path) == []


def test_unknowns_that_nothing_depends_on_are_named(tmp_path):
    path = write(
        tmp_path,
        distance_meters="name,scale_ppm,free\nEDM,1,scale\ntape,1,\n",
        refractions="name,value,sigma\n,0.13,0.05\nnorth,0.1,\n",
    )
    what = "it is unknown, but no observation depends on it: hold it, or take it out"
    assert problems(path) == [f"refraction group 'north': {what}", f"distance meter 'EDM': {what}"]


def test_points_that_nothing_observes_are_listed_and_no_problem(tmp_path):
    assert problems(write(tmp_path, points=LOOSE)) == []


def test_datum_points_are_found_idle_together(tmp_path):
    path = write(tmp_path, points=with_datum_points(LOOSE, "GHIJ"))
    assert problems(path)[0].startswith("points.csv:8: points 'G', 'H', 'I', 'J': no observation")


def test_unknown_keys_of_a_camera_are_told_the_standard_deviations(tmp_path):
    path = write(tmp_path, project=TEXTS["project"].replace("[[camera]]", "[[camera]]\nsigma = 1"))
    (found,) = problems(path)
    assert "unknown key 'sigma'; known: name, lens, " in found
    assert ", sigma_px, " in found and ", sigma_y_um, " in found


def test_local_coordinates_in_a_geocentric_frame_are_refused():
    network = Network(frame=GeocentricFrame())
    network.add_point("A", (100.0, 200.0, 0.0), fixed="xyz")
    network.add_point("B", (4e6, 1e6, 4.8e6))
    network.add(SlopeDistance("A", "B", 10.0, sigma=0.1))
    (found,) = (p for p in check(network) if "geocentric" in p.what)
    assert str(found) == (
        "point 'A': it lies 0.224 km from the centre of the ellipsoid GRS80: a geocentric frame "
        "needs geocentric coordinates"
    )


@pytest.mark.parametrize(("name", "least"), [("Moon", 1717), ("GRS80", 6302)])
def test_geocentric_coordinates_are_near_the_ellipsoid_of_the_frame(name, least):
    network = Network(frame=GeocentricFrame(name))
    for at, kilometres in (("low", least - 1.0), ("deep", least + 1.0), ("high", least + 500.0)):
        network.add_point(at, (0.6e3 * kilometres, 0.0, 0.8e3 * kilometres), fixed="xyz")
    network.add_point("new", (0.0, 0.0, 1e3 * least + 2e3))
    network.add(SlopeDistance("new", "high", 10.0, sigma=0.1))
    found = [str(p) for p in check(network) if "geocentric" in p.what]
    assert len(found) == 1
    assert found[0].startswith(
        f"point 'low': it lies {least - 1}.000 km from the centre of the ellipsoid {name}:"
    )


# -- anything at all ------------------------------------------------------------------------------

EXTRAS = {
    "orientations": "station,set,value,sigma_mgon,fixed\nA,1,300,5,\n",
    "refractions": "name,value,sigma,fixed\n,0.13,0.05,\nnorth,0.1,,yes\n",
    "verticals": "station,xi_arcsec,eta_arcsec,sigma_arcsec,fixed\nC,1,-1,2,\n",
    "distance_meters": "name,scale_ppm,zero_mm,sigma_zero_mm,free\nEDM,1,2,3,\n",
    "covariances": HEADER + "k,1,,1,,4\nk,1,,2,,1\nk,2,,2,,4\n",
}
SPLINTERS = [
    *(",", ";", "\n", '"', "-", ".", "e", "0", "nan", "inf", "1e999", "x", "[", "]", "{", "}"),
    *(
        "=",
        "#",
        " ",
        "\t",
        "\0",
        "é",
        "true",
        "[[camera]]",
        "kind",
        "xyz",
        "A",
        "fixed",
        "sigma_mm",
    ),
]


@pytest.mark.slow(
    "hundreds of damaged projects are read or refused; short tests refuse single mistakes"
)
@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_project_is_read_or_refused_but_never_a_traceback(tmp_path, seed):
    rng = np.random.default_rng(seed)
    whole = TEXTS | EXTRAS
    assert problems(write(tmp_path, **whole)) == []
    for _ in range(25):
        damaged = dict(whole)
        for _ in range(int(rng.integers(1, 4))):
            name = str(rng.choice(list(damaged)))
            text = damaged[name]
            at, width = int(rng.integers(len(text) + 1)), int(rng.integers(0, 6))
            splinter = str(rng.choice(SPLINTERS))
            damaged[name] = text[:at] + splinter + text[at + width :]
        for problem in problems(write(tmp_path, **damaged)):
            assert problem
            assert "Traceback" not in problem
