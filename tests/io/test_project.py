"""Projects on disk: what is written reads back the same, to the bit."""

from __future__ import annotations

import json
import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io import numbers
from factorgraph_adj.io.adjustment_options import AdjustOptions
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.io.observation_fields import (
    ImageAxes,
    RecordContext,
    name_fields,
    text_fields,
    vector_fields,
)
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.io.project import load_project, read_project
from factorgraph_adj.io.project_writer import exact_angles, write_project
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.models import lens
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import KINDS
from factorgraph_adj.observations.airborne_observations import ABOUT, ANGLES
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.units import ANGLE, ARCSEC, GON, LENGTH
from tests.networks.everything import FRAMES, everything
from tests.networks.projects import FILES, OBSERVATIONS, POINTS, PROJECT, write
from tests.networks.small_block import small_block
from tests.support.places import data_dir
from tests.support.same import assert_same, assert_same_network

UNITS = {
    "metres and gon": Units(),
    "millimetres and degrees": Units("mm", "deg", "dms", "um", "arcsec"),
    "kilometres and dms": Units("km", "dms", "rad", "mm", "cc"),
    "SI": Units("m", "rad", "rad", "m", "rad"),
}


def test_the_network_of_everything_has_every_kind():
    n = everything("geocentric")
    assert {x.kind for x in n.observations.values()} | {"image"} == set(KINDS)
    assert {type(c.lens) for c in n.cameras.values()} == set(LENSES.values())


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("units", UNITS)
def test_a_project_reads_back_to_the_bit_in_any_units(tmp_path, units, frame):
    network = everything(frame)
    write_project(network, tmp_path / "p.toml", units=UNITS[units])
    again = load_project(tmp_path / "p.toml")
    assert again.units == UNITS[units]
    assert_same_network(network, again.network)


@pytest.mark.parametrize("frame", FRAMES)
def test_residuals_after_a_round_trip_are_the_same_floats(tmp_path, frame):
    network = everything(frame)
    write_project(network, tmp_path / "p.toml")
    before, after = compile_network(network), compile_network(read_project(tmp_path / "p.toml"))
    rng = np.random.default_rng(5)
    state = {
        kind: np.where(np.isnan(v), rng.normal(size=v.shape), v)
        for kind, v in before.unknowns.start().items()
    }
    far = {"geocentric": 6.4e6}.get(frame, 0.0)
    state["point"] = state["point"] + np.array([far, 0.0, 0.0])
    for whitened in (False, True):
        assert np.array_equal(
            before.residuals(state, whitened=whitened), after.residuals(state, whitened=whitened)
        )


def test_a_round_trip_adjusts_to_the_same_floats(tmp_path):
    network = small_block()
    write_project(network, tmp_path / "p.toml")
    before, after = adjust(network), adjust(read_project(tmp_path / "p.toml"))
    assert before.vtpv == after.vtpv
    assert before.iterations == after.iterations
    for name in network.points:
        assert np.array_equal(before.point(name), after.point(name))
        assert np.array_equal(before.covariance(name), after.covariance(name))


@pytest.mark.parametrize("folder", ["gama_3d_networks", "gama_levelling", "krumm_textbook"])
def test_real_networks_survive_the_round_trip(tmp_path, folder):
    files = sorted(data_dir(folder).glob("*.gkf"))
    assert files
    for file in files:
        network = read_gama(file)
        write_project(network, tmp_path / "p.toml")
        assert_same_network(network, read_project(tmp_path / "p.toml"))


def test_a_second_round_trip_writes_the_same_files(tmp_path):
    write_project(everything("topocentric"), tmp_path / "a" / "p.toml")
    write_project(read_project(tmp_path / "a" / "p.toml"), tmp_path / "b" / "p.toml")
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_writing_again_does_not_pick_up_tables_of_an_earlier_project(tmp_path):
    write_project(everything("topocentric"), tmp_path / "p.toml")
    network = Network("two")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (1, 0, 0), fixed="yz")
    network.add(o.SlopeDistance("A", "B", 1.0, sigma=0.1))
    write_project(network, tmp_path / "p.toml")
    assert (tmp_path / "verticals.csv").exists()
    assert_same_network(network, read_project(tmp_path / "p.toml"))


# -- numbers --------------------------------------------------------------------------------------

FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12)


@given(value=FINITE, unit=st.sampled_from(["", *LENGTH, *ANGLE, "dms", "ppm", "mm2", "arcsec2"]))
def test_every_number_is_read_back_as_it_was_in_every_unit(value, unit):
    if unit == "dms" and abs(value) > 1e3:
        value = math.fmod(value, 1e3)
    again = numbers.parse_quantity(numbers.write_quantity(value, unit), unit)
    assert again == value
    assert math.copysign(1, again) == math.copysign(1, value)


@pytest.mark.parametrize("unit", [*LENGTH, *ANGLE])
def test_exact_units_agree_with_the_table_of_units(unit):
    assert float(numbers.unit_factor(unit)) == pytest.approx((LENGTH | ANGLE)[unit], rel=1e-15)


def test_a_number_in_millimetres_is_the_float_that_metres_give():
    assert numbers.parse_quantity("0.3", "mm") == float("0.0003")
    assert numbers.write_quantity(0.0003, "mm") == "0.3"
    assert numbers.write_quantity(numbers.parse_quantity("399.1234", "gon"), "gon") == "399.1234"
    assert (
        numbers.write_quantity(numbers.parse_quantity("41-28-15.8", "dms"), "dms") == "41-28-15.8"
    )


@pytest.mark.parametrize("text", ["1_000", "0x10", "١٢", "1 2", "--1", "1e", ""])
def test_what_only_python_takes_for_a_number_is_none(text):
    with pytest.raises(ValueError, match="is not a number"):
        numbers.parse_quantity(text)


# -- records --------------------------------------------------------------------------------------

NAME = st.text(
    st.characters(exclude_categories=("Cs", "Cc", "Zl", "Zp")), min_size=1, max_size=8
).filter(lambda s: s == s.strip() and s.split())
SIGMA = st.floats(min_value=1e-9, max_value=1e3)
VALUE = st.floats(min_value=-1e7, max_value=1e7)
PART = st.floats(min_value=0, max_value=10)
UNIT_VECTORS = ((1.0, 0.0, 0.0), (0.36, -0.48, 0.8), (2 / 3, -1 / 3, -2 / 3))


@st.composite
def any_observation(draw):
    """Draw an observation of any kind but image."""
    kind = draw(st.sampled_from([k for k in KINDS if k != "image"]))
    cls = KINDS[kind].observation
    names = {f.name for f in fields(cls)}
    either = {"point", "photo"} <= KINDS[kind].may_lack
    if either:
        names -= {draw(st.sampled_from(["point", "photo"]))}
    points = ("station", "target", "station2", "target2", "point", "photo", "photo2")
    points += ("before", "after", "moved", "sensor")
    have = [n for n in points if n in names]
    chosen = draw(st.lists(NAME, min_size=len(have), max_size=len(have), unique=True))
    arguments = dict(zip(have, chosen, strict=True))
    arguments = ({"point": None} if either else {}) | arguments
    needed = (*KINDS[kind].texts, *KINDS[kind].frames, *({"mark"} & names))
    of = [n for n in needed if n not in KINDS[kind].optional]
    drawn = draw(st.lists(NAME, min_size=len(of), max_size=len(of), unique=True))
    arguments |= dict(zip(of, drawn, strict=True))
    arguments |= {n: draw(SIGMA) for n in ("ux", "uy", "uz", "x", "y") if n in names}
    needed = (n for n in vector_fields(kind) if n not in KINDS[kind].optional)
    arguments |= {n: draw(st.sampled_from(UNIT_VECTORS)) for n in needed}
    numbers_needed = {"horizontal", "zenith", "bearing", "reference_x", "reference_y", "length"}
    numbers_needed |= {"interval", "film_x", "film_y"}
    numbers_needed |= {"time"} - KINDS[kind].optional
    arguments |= {n: draw(st.floats(0.01, 3.0)) for n in sorted(numbers_needed & names)}
    ends = sorted({"start", "end"} & names)
    arguments |= {n: f"{n} of {arguments['point']}" for n in ends}
    if "lever_arm" in names and "photo" in have:
        arguments["lever_arm"] = (draw(SIGMA), draw(VALUE), draw(VALUE))
    if "angle" in KINDS[kind].choices:
        arguments["angle"] = draw(st.sampled_from(ANGLES))
    if "about" in names:
        arguments["about"] = draw(st.sampled_from(ABOUT))
    arguments |= {n: draw(VALUE) for n in ("along", "across") if n in names and "strip" in names}
    for height in ("instrument_height", "target_height", "target2_height"):
        if height in names:
            arguments[height] = draw(VALUE)
    if "covariance" in names:
        axes = cls.components
        if "axes" in names:
            three = KINDS[kind].defaults["axes"] == "xyz"
            some = ["xyz", "z", "yx", "xz"] if three else [*KINDS[kind].defaults["axes"]]
            axes = arguments["axes"] = draw(st.sampled_from(some))
        elif kind == "unit_vector":
            axes = "xy"
        part = st.floats(-0.7, 0.7) if kind == "unit_vector" else VALUE
        arguments["value"] = tuple(draw(part) for _ in axes)
        if cls.components == ("rx", "ry", "rz"):  # a rotation vector, of half a turn at most
            length = 1.0 + math.hypot(*arguments["value"])
            arguments["value"] = tuple(v / length for v in arguments["value"])
        if draw(st.booleans()):
            arguments["sigma"] = tuple(draw(SIGMA) for _ in axes)
        else:
            arguments["covariance"] = np.diag([draw(SIGMA) for _ in axes])
        return cls(**arguments)
    arguments["value"] = draw(VALUE)
    if cls.nonnegative:
        arguments["value"] = abs(arguments["value"])
    if "index_error" in names:
        arguments["value"] = abs(arguments["value"]) % math.pi
    arguments["sigma"] = draw(SIGMA)
    if kind in ("slope_distance", "horizontal_distance") and draw(st.booleans()):
        arguments["sigma"] = StandardDeviation(draw(PART), ppm=draw(SIGMA))
    if kind == "height_difference" and draw(st.booleans()):
        arguments["sigma"] = StandardDeviation(draw(PART), per_sqrt_km=draw(SIGMA))
        arguments["length_km"] = draw(SIGMA)
    return cls(**arguments)


@settings(max_examples=200, deadline=None)
@given(found=any_observation(), units=st.sampled_from(list(UNITS.values())))
def test_record_and_observation_are_the_same_thing(found, units):
    again = observation_from_record(
        observation_record(found, units=units), context=RecordContext(units)
    )
    assert_same(found, again)


@settings(max_examples=50, deadline=None)
@given(found=any_observation())
def test_a_record_survives_json_as_numbers(found):
    units = UNITS["SI"]
    fields_of = observation_record(found, units=units)
    texts = {"kind", "id", "station", "target", "target2", "point", "photo", "axes", "set", "unit"}
    texts |= {
        "angle",
        "about",
        *(n for k in KINDS.values() for n in (*k.frames, *k.texts, *k.named)),
        *(n for k in KINDS for n in (*name_fields(k), *text_fields(k))),
    }
    as_numbers = {k: v if k in texts or not v else float(v) for k, v in fields_of.items()}
    line = json.loads(json.dumps(as_numbers))
    assert_same(found, observation_from_record(line, context=RecordContext(units)))


def test_a_record_may_state_its_own_unit():
    fields_of = {"kind": "azimuth", "station": "A", "target": "B", "value": 90, "sigma_arcsec": 1}
    found = observation_from_record(fields_of | {"unit": "deg"})
    assert found.value == math.pi / 2
    assert (
        observation_from_record(fields_of | {"unit": "dms", "value": "90-00-00"}).value
        == math.pi / 2
    )
    assert observation_from_record(fields_of).value == pytest.approx(90 * GON, rel=1e-15)


def test_image_coordinates_may_be_pixels_from_the_upper_left_corner():
    axes = {"f": ImageAxes("px", y_down=True)}
    fields_of = {"kind": "image", "photo": "f", "point": "P", "x": 10, "y": 20.5, "sigma_px": 0.3}
    found = observation_from_record(fields_of, context=RecordContext(images=axes))
    assert (found.x, found.y, found.sigma) == (10.0, -20.5, (0.3, 0.3))
    assert observation_record(found, axes=axes["f"])["y"] == "20.5"


# -- what a project may say -----------------------------------------------------------------------


def test_y_down_turns_the_principal_point_with_the_images(tmp_path):
    project = PROJECT.replace('unit = "mm"', 'unit = "px"\ny_axis = "down"').replace(
        "sigma_um = 5", "sigma_px = 0.5"
    )
    project = project.replace("c = 100.0", "c = 100.0\ny0 = 12.5")
    network = read_project(write(tmp_path, project=project))
    camera = network.cameras["cam"]
    assert camera.values[camera.lens.names.index("y0")] == -12.5
    _, _, xy, sigma = network.images.columns()
    assert xy[0].tolist() == [-50.0, 10.0]
    assert set(sigma.ravel().tolist()) == {0.5}


SENSORS = {
    "": (None, None),
    "format = [36, 24]": ([-18.0, -12.0], [18.0, 12.0]),
    'y_axis = "down"\nformat = [36, 24]': ([0.0, -24.0], [36.0, 0.0]),
    'y_axis = "down"\nformat = [36, 24]\norigin = "centre"': ([-18.0, -12.0], [18.0, 12.0]),
    'format = [36, 24]\norigin = "lower left"': ([0.0, 0.0], [36.0, 24.0]),
}


@pytest.mark.parametrize("stated", SENSORS)
def test_the_format_lies_about_the_origin_of_the_image_coordinates(tmp_path, stated):
    project = PROJECT.replace('unit = "mm"', f'unit = "mm"\n{stated}')
    network = read_project(write(tmp_path, project=project))
    corners = network.cameras["cam"].corners()
    expected = SENSORS[stated]
    assert corners is None if expected[0] is None else [c.tolist() for c in corners] == [*expected]
    write_project(network, tmp_path / "again" / "project.toml")
    again = read_project(tmp_path / "again")
    assert again.cameras["cam"] == network.cameras["cam"]


FORMATS = {
    "format = [36]": "format must be [width, height] in the unit of the camera, not [36]",
    'format = "36 x 24"': "format must be [width, height] in the unit of the camera",
    "format = [36, 0]": "height must be greater than zero, not 0",
    'format = ["a", 24]': "width: 'a' is not a number",
    'format = [36, 24]\norigin = "left"': "unknown origin 'left'; valid: centre, upper left",
    'origin = "centre"': "origin says where on the sensor x = y = 0 is: it needs format",
}


@pytest.mark.parametrize("stated", FORMATS)
def test_a_format_that_is_none_is_named_with_its_file_and_camera(tmp_path, stated):
    project = PROJECT.replace('unit = "mm"', f'unit = "mm"\n{stated}')
    with pytest.raises(InputError) as caught:
        read_project(write(tmp_path, project=project))
    (problem,) = caught.value.problems
    assert FORMATS[stated] in problem.what
    last = stated.split("\n")[-1]
    line = project.split("\n").index(last) + 1
    assert problem.where.startswith(f"project.toml:{line}: [[camera]] 'cam'")


@pytest.mark.parametrize("format", [(36.0,), (36.0, -1.0), (36.0, np.nan), (np.inf, 24.0), 36.0])
def test_the_network_refuses_a_format_that_is_none(format):
    with pytest.raises(InputError, match="camera 'c': format must be width and height"):
        Network().add_camera("c", lens.Lens(), {"c": 1.0}, format=format)
    with pytest.raises(InputError, match="camera 'c': unknown origin 'top'; valid: centre"):
        Network().add_camera("c", lens.Lens(), {"c": 1.0}, format=(36, 24), origin="top")


def test_standard_deviations_come_from_the_row_or_else_from_the_project(tmp_path):
    network = read_project(write(tmp_path))
    assert network.observations["1"].sigma == StandardDeviation(0.002, ppm=1.0)
    assert network.observations["3"].sigma == 0.0015
    assert network.observations["7"].sigma == numbers.parse_quantity("1", "mgon")
    assert network.observations["8"].sigma == numbers.parse_quantity("2", "mgon")
    assert set(network.images.columns()[3].ravel().tolist()) == {0.005}


def test_every_observation_knows_its_file_and_line(tmp_path):
    network = read_project(write(tmp_path))
    assert network.observations["7"].label() == "observations.csv:8: zenith_angle A C (id 7)"
    assert next(network.image_points()).label() == "images.csv:2: image P A"


def test_semicolons_empty_lines_and_remarks_are_read(tmp_path):
    points = "# surveyed in May\n" + POINTS.replace(",", ";").replace("fixed", "remark;fixed")
    lines = points.splitlines()
    for i, line in enumerate(lines[2:], start=2):
        name, *middle, fixed = line.split(";")
        lines[i] = ";".join([name, *middle, "north, by the wall", fixed])
    lines.insert(3, "")
    network = read_project(write(tmp_path, points="\n".join(lines)))
    assert_same_network(network, read_project(write(tmp_path / "plain")))


def test_rows_without_an_id_get_a_number_that_no_other_row_has(tmp_path):
    rows = OBSERVATIONS.replace("slope_distance,2,", "slope_distance,,").replace(
        "slope_distance,3,", "slope_distance,,"
    )
    network = read_project(write(tmp_path, observations=rows))
    assert list(network.observations)[:4] == ["1", "2", "3", "4"]


def test_latitude_and_longitude_are_read_in_a_geocentric_frame(tmp_path):
    project = 'name = "globe"\n[frame]\nkind = "geocentric"\nellipsoid = "GRS80"\n[units]\n'
    points = "name,latitude,longitude,height\nA,47-30-00,11-15-00,500\n"
    files = {"project.toml": project + 'geographic = "dms"\n', "points.csv": points}
    path = write(tmp_path, files)
    at = (np.radians([47.5]), np.radians([11.25]), np.array([500.0]))
    found = np.array(read_project(path).points["A"].coordinates)
    assert np.allclose(found, ellipsoid("GRS80").to_cartesian(*at)[0], rtol=0, atol=1e-8)


def test_a_levelling_project_needs_no_plan_coordinates(tmp_path):
    project = 'name = "levels"\ndimension = 1\n[sigma.height_difference]\nsqrt_km_mm = 1\n'
    points = "name,z,fixed\nA,100,z\nB,,\n"
    rows = "kind,station,target,value,length_km\nheight_difference,A,B,1.5,0.25\n"
    files = {"project.toml": project, "points.csv": points, "observations.csv": rows}
    solution = adjust(read_project(write(tmp_path, files)))
    assert solution.point("B").tolist() == [0.0, 0.0, 101.5]
    assert solution.standard_deviations("B")[2] == pytest.approx(0.0005)


def test_a_plane_project_holds_heights(tmp_path):
    files = {
        "project.toml": 'name = "plane"\ndimension = 2\n',
        "points.csv": "name,x,y,fixed\nA,0,0,xy\nB,5,1,\n",
    }
    assert read_project(write(tmp_path, files)).points["B"].fixed == (False, False, True)


def test_the_project_may_say_how_it_wants_to_be_adjusted(tmp_path):
    project = PROJECT + '[adjust]\nvariance = "a-posteriori"\nmax_iterations = 7\n'
    assert load_project(write(tmp_path, project=project)).options == AdjustOptions(
        "a-posteriori", 7
    )


def test_a_network_without_its_project_says_which_options_it_leaves(tmp_path):
    """The command scales standard deviations as the project states; `adjust` as it is called."""
    project = PROJECT + '[adjust]\nvariance = "a-posteriori"\n'
    folder = write(tmp_path, project=project)
    for network in (read_project(folder), fga.read(folder)):
        (remark,) = network.remarks
        assert "variance='a-posteriori' in [adjust]" in remark and "iterations" not in remark
        assert " ".join(remark.split()) in " ".join(fga.text_report(fga.adjust(network)).split())
    assert not load_project(folder).network.remarks
    assert not read_project(write(tmp_path / "usual")).remarks


def test_a_folder_stands_for_its_project_toml(tmp_path):
    write(tmp_path)
    assert read_project(tmp_path).name == "yard"


def test_deflections_stand_in_columns_with_their_unit(tmp_path):
    path = write(tmp_path, verticals="station,xi_arcsec,eta_arcsec,sigma_arcsec\nC,3,-4,0.5\n")
    vertical = read_project(path).verticals["C"]
    assert vertical.values == pytest.approx((3 * ARCSEC, -4 * ARCSEC), rel=1e-15)
    assert vertical.sigma == pytest.approx((0.5 * ARCSEC,) * 2, rel=1e-15)


# -- writing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [" A", "A ", "A\u00a0"])
def test_names_that_a_cell_cannot_hold_are_refused(tmp_path, name):
    network = Network()
    network.add_point(name, (0, 0, 0))
    with pytest.raises(InputError, match="blanks at its ends"):
        write_project(network, tmp_path / "p.toml")
    assert list(tmp_path.iterdir()) == []


def test_a_unit_that_no_reader_knows_is_refused(tmp_path):
    network = Network()
    network.add_camera("c", lens.Lens(), {"c": 1.0}, unit="furlong")
    with pytest.raises(InputError, match="unit 'furlong' cannot be written; valid: px, m, dm"):
        write_project(network, tmp_path / "p.toml")


def test_units_that_are_none_are_named_all_at_once():
    with pytest.raises(InputError) as caught:
        Units(length="ell", angle="grad")
    assert [p.where for p in caught.value.problems] == ["length", "angle"]


def test_writing_that_fails_leaves_the_old_project(tmp_path, monkeypatch):
    write(tmp_path)
    before = {f.name: f.read_bytes() for f in tmp_path.iterdir()}
    import os

    moves = []
    real = os.replace

    def fail_on_the_third(source, target):
        moves.append(target)
        if len(moves) == 3:
            raise KeyboardInterrupt
        real(source, target)

    monkeypatch.setattr("factorgraph_adj.io.file_transaction.os.replace", fail_on_the_third)
    with pytest.raises(KeyboardInterrupt):
        write_project(small_block(), tmp_path / "project.toml")
    assert {f.name: f.read_bytes() for f in tmp_path.iterdir()} == before
    assert set(before) == set(FILES)


def test_a_new_folder_disappears_again_when_writing_fails(tmp_path, monkeypatch):
    def fail(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("factorgraph_adj.io.file_transaction._move", fail)
    with pytest.raises(KeyboardInterrupt):
        write_project(small_block(), tmp_path / "new" / "p.toml")
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=200, deadline=None)
@given(angles=st.tuples(*[st.floats(min_value=-math.pi, max_value=math.pi)] * 3))
def test_angles_found_for_a_rotation_give_the_same_matrix(angles):
    rotation = world_R_camera(*angles)
    found = exact_angles(rotation)
    if found is not None:  # otherwise the matrix itself is written
        assert np.array_equal(world_R_camera(*found), rotation)


def test_angles_are_found_again_for_most_photos():
    rng = np.random.default_rng(3)
    drawn = rng.uniform(-np.pi, np.pi, size=(200, 3)) * [1.0, 0.5, 1.0]
    found = [exact_angles(world_R_camera(*angles)) for angles in drawn.tolist()]
    assert sum(f is not None for f in found) >= 190
