"""Records as JSON come back to the bit, and a journal loses nothing but a torn last line."""

from __future__ import annotations

import errno
import gc
import json
import math
import os
import signal
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import GeocentricFrame, LocalFrame
from factorgraph_adj.io import journal as module
from factorgraph_adj.io import json_records as j
from factorgraph_adj.io.journal import Journal
from factorgraph_adj.io.numbers import Units
from factorgraph_adj.io.observation_fields import ImageAxes, RecordContext, vector_fields
from factorgraph_adj.io.project_writer import write_project
from factorgraph_adj.io.survey.gama import read_gama
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import KINDS
from factorgraph_adj.observations.airborne_observations import ABOUT, ANGLES
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.stochastic_model import COMBINATIONS, StandardDeviation
from tests.networks.every_kind import FRAMES as EVERY_FRAME
from tests.networks.every_kind import LENSES_USED, OBSERVED
from tests.networks.everything import FRAMES, everything
from tests.networks.small_block import small_block
from tests.support.places import data_dir
from tests.support.same import assert_same, assert_same_network

SEEDS = range(40)


def through_json(record: dict[str, object]) -> dict[str, object]:
    """Return a record as it comes out of a line of a file."""
    return json.loads(json.dumps(record, allow_nan=False))


def problems_of(read, *arguments, **options) -> list[tuple[str, str]]:
    """Return what is wrong and where."""
    with pytest.raises(InputError) as caught:
        read(*arguments, **options)
    return [(p.what, p.where) for p in caught.value.problems]


# -- observations ---------------------------------------------------------------------------------


def number(rng: np.random.Generator) -> float:
    """Draw a number of any size and sign, with all bits of a float64."""
    return float(rng.normal() * 10.0 ** rng.uniform(-12, 7))


def covariance(size: int, rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(size, size)) + 3 * np.eye(size)
    out = root @ root.T * 10.0 ** rng.uniform(-9, 3)
    out[0, -1] *= 1 + 4e-16  # not symmetric in the last bit
    return out


def drawn(kind: str, rng: np.random.Generator) -> o.Observation:
    """Draw an observation of a kind; every attribute that it has may be filled."""
    cls = KINDS[kind].observation
    have = {f.name: f for f in fields(cls)}
    either = {"point", "photo"} <= KINDS[kind].may_lack
    if either:
        del have[str(rng.choice(["point", "photo"]))]
    free = iter(rng.permutation(["1", "B, 2", "#C", '"D" ü', " E ", "7.50"]).tolist())
    names = ("station", "target", "station2", "target2", "point", "photo", "photo2")
    names += ("before", "after", "moved", "sensor")
    out = {n: next(free) for n in names if n in have}
    out |= {"point": out.get("point")} if either else {}
    needed = (*KINDS[kind].texts, *KINDS[kind].frames, *({"mark"} & {*have}))
    out |= {n: next(free) for n in needed if n not in KINDS[kind].optional and n not in out}
    texts = ["instrument", "refraction", "set", "drift"] + ["mount"] * ("photo" in out)
    texts += ["radius", "ring", "height", "focal"]
    out |= {n: str(rng.integers(9)) for n in texts if n in have and rng.random() < 0.5}
    choices = {"angle": ANGLES, "about": ABOUT}
    own = KINDS[kind].choices
    out |= {n: str(rng.choice(valid)) for n, valid in choices.items() if n in own}
    numbers = ("ux", "uy", "uz", "ratio", "x", "y")
    out |= {n: number(rng) for n in numbers if n in have}
    out |= {n: bool(rng.integers(2)) for n in ("condition", "horizon") if n in have}
    out |= {"time": number(rng)} if "time" in have else {}
    if "shutter" in have and rng.random() < 0.5:
        out |= {"shutter": "s", "velocity": tuple(number(rng) for _ in range(3))}
    out |= {n: number(rng) for n in have if n.endswith("_height") and rng.random() < 0.5}
    needed = {
        "horizontal",
        "zenith",
        "bearing",
        "reference_x",
        "reference_y",
        "length",
        "interval",
        "film_x",
        "film_y",
    } & {*have}
    out |= {n: abs(number(rng)) % 3.0 + 0.01 for n in needed if n not in out}
    out |= {n: next(free) for n in ("start", "end") if n in have}
    if "face" in have:
        out["face"] = int(rng.integers(1, 3))
        error = "index_error" if "index_error" in have else "collimation_error"
        out |= {error: "#5"} if rng.random() < 0.5 else {}
    if "strip" in have:
        out |= {"strip": next(free), "along": number(rng), "across": number(rng)}
    if "deformation" in have and rng.random() < 0.5:
        out |= {"deformation": next(free), "base": abs(number(rng))}
    if "length_km" in have:
        out["length_km"] = abs(number(rng))
    for name in vector_fields(kind):
        vector = np.array([number(rng) for _ in range(3)])
        unit = have[name].metadata.get("quantity") == "number"
        if name not in KINDS[kind].optional or (name == "lever_arm" and "photo" in out):
            out[name] = tuple((vector / np.linalg.norm(vector) if unit else vector).tolist())
    if kind == "image":
        out |= {"x": number(rng), "y": number(rng)}
        out["sigma"] = (abs(number(rng)), abs(number(rng)))
    elif "covariance" in have:
        axes: str | tuple[str, ...] = cls.components
        if "axes" in have:
            three = KINDS[kind].defaults["axes"] == "xyz"
            choices = ["xyz", "z", "yx"] if three else [*KINDS[kind].defaults["axes"]]
            choices += ["enu", "un"] if KINDS[kind].by_axis else []
            axes = out["axes"] = str(rng.choice(choices))
        elif kind == "unit_vector":
            axes = "xy"
        size = 3 if set(axes) & set("enu") else len(axes)
        small = 1e-9 if kind == "unit_vector" else 1.0
        out["value"] = tuple(small * number(rng) for _ in range(size))
        if cls.components == ("rx", "ry", "rz"):  # a rotation vector, of half a turn at most
            out["value"] = tuple(v / (1.0 + np.linalg.norm(out["value"])) for v in out["value"])
        if rng.random() < 0.5:
            out["covariance"] = covariance(len(axes), rng)
        else:
            out["sigma"] = tuple(abs(number(rng)) for _ in axes)
    else:
        out["value"] = abs(number(rng))
        if "index_error" in have:
            out["value"] = out["value"] % math.pi + math.pi * (out["face"] - 1)
        out["sigma"] = abs(number(rng))
        if have["sigma"].type == "Sigma" and rng.random() < 0.5:
            parts = {name: abs(number(rng)) for name in KINDS[kind].weight.parts}
            combine = str(rng.choice(COMBINATIONS))
            out["sigma"] = StandardDeviation(abs(number(rng)), **parts, combine=combine)
    return cls(**out)


@pytest.mark.parametrize("kind", KINDS)
def test_an_observation_of_any_kind_comes_back_to_the_bit(kind):
    for seed in SEEDS:
        given = drawn(kind, np.random.default_rng(seed))
        record = through_json(j.observation_fields(given, id="17"))
        again = j.observation_of(record, source="line 3")
        assert_same(given, again)
        assert (again.id, again.source) == ("17", "line 3")


@pytest.mark.parametrize("kind", OBSERVED)
def test_the_observations_of_every_kind_come_back_to_the_bit(kind):
    for given in OBSERVED[kind]():
        assert_same(given, j.observation_of(through_json(j.observation_fields(given, id=None))))


def test_correlated_observations_come_back_to_the_bit():
    kinds = [k for k in KINDS if k != "image"]
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        members = tuple(drawn(str(k), rng) for k in rng.choice(kinds, size=rng.integers(1, 5)))
        size = sum(len(m.component_names()) for m in members)
        given = o.Correlated(members, covariance(size, rng))
        ids = [f"c{i}" for i in range(len(members))]
        again = j.observation_of(through_json(j.observation_fields(given, id=ids)), source="a:1")
        assert_same(given, again)
        assert [m.id for m in again.observations] == ids
        assert {m.source for m in again.observations} == {"a:1"}


def test_a_record_has_numbers_and_no_source_and_keeps_an_id_of_its_own():
    given = o.Azimuth("A", "B", 1.5, sigma=1e-5, id="own", source="file.csv:3")
    assert j.observation_fields(given, id="other") == {
        **{"kind": "azimuth", "id": "own", "station": "A", "target": "B", "value": 1.5},
        **{"sigma_rad": 1e-5, "unit": "rad"},
    }
    again = j.observation_of(j.observation_fields(given, id=None))
    assert again == replace(given, source=None)


def test_minus_zero_and_the_smallest_and_largest_floats_come_back():
    for value in (-0.0, 5e-324, 1.7976931348623157e308, -2.2250738585072014e-308):
        given = o.HeightDifference("A", "B", value, sigma=5e-324, target_height=value)
        assert_same(given, j.observation_of(through_json(j.observation_fields(given, id=None))))


def test_what_no_record_can_say_is_not_written():
    given = o.Direction("A", "B", 0.7, sigma=1e-5, set="", id="")
    found = problems_of(j.observation_fields, given, id=None)
    assert [what for what, _ in found] == [
        "id must be text that is not empty, not ''",
        "set must be text that is not empty, not ''",
    ]
    assert {where for _, where in found} == {given.label()}


@pytest.mark.parametrize("unit", ["px", "mm", "um"])
def test_image_coordinates_come_back_in_the_unit_of_their_camera(unit):
    given = o.ImagePoint("f", "P", 1 / 3, -2 / 3, sigma=(0.1, 0.3))
    record = through_json(j.observation_fields(given, id=None, unit=unit))
    assert record[f"sigma_x_{unit}"] == 0.1
    project = RecordContext(Units(length="mm"), images={"f": ImageAxes(unit)})
    assert_same(given, j.observation_of(record))
    assert_same(given, j.observation_of(record, context=project))


def test_a_record_from_elsewhere_has_any_unit_and_numbers_as_text():
    record = {"kind": "slope_distance", "station": 1, "target": "B", "value": "12.5"}
    assert j.observation_of({**record, "sigma_mm": 2}) == o.SlopeDistance(
        "1", "B", 12.5, sigma=0.002
    )
    context = RecordContext(Units(length="mm"), {"slope_distance": {"sigma_mm": 3}})
    assert j.observation_of(record, context=context).value == 0.0125
    assert j.observation_of(record, context=context).sigma == 0.003


def test_members_without_a_standard_deviation_take_it_from_their_covariance():
    members = [
        {"kind": "control", "point": "A", "axes": "xz", "x": 1, "z": 2},
        {"kind": "azimuth", "station": "A", "target": "B", "value": 1, "unit": "rad"},
    ]
    matrix = np.diag([4e-4, 9e-4, 1e-10])
    record = {"kind": "correlated", "observations": members, "covariance_si": matrix.tolist()}
    found = j.observation_of(record)
    assert found.observations[0].sigma == pytest.approx((0.02, 0.03), rel=1e-15)
    assert found.observations[1].sigma == pytest.approx(1e-5, rel=1e-15)


AZIMUTH = {"kind": "azimuth", "station": "A", "target": "B", "value": 1, "sigma_mgon": 1}
PAIR = {"kind": "correlated", "observations": [AZIMUTH, AZIMUTH]}
IMAGE = {"kind": "image", "photo": "F", "point": "A", "x": 1, "y": 2, "sigma_mm": 0.01}
WRONG_OBSERVATIONS = {
    "no object": ([1], "a record must be an object {…}, not [1]", "in:4"),
    "no kind": ({"station": "A"}, "kind is missing", "in:4"),
    "kind is a list": ({"kind": ["azimuth"]}, "kind must be text, not ['azimuth']", "in:4"),
    "true": ({**AZIMUTH, "value": True}, "value: True is not a number", "in:4: azimuth A B"),
    "a list": ({**AZIMUTH, "value": [1]}, "value: [1] is not a number", "in:4: azimuth A B"),
    "a huge exponent": (
        {**AZIMUTH, "value": "1e99999999999999999999"},
        "value: '1e99999999999999999999' is too large or too small a number",
        "in:4: azimuth A B",
    ),
    "not finite": (
        {**AZIMUTH, "value": float("nan")},
        "value: 'nan' is not a finite number",
        "in:4: azimuth A B",
    ),
    "no covariance": (PAIR, "covariance_si is missing", "in:4: correlated"),
    "not square": (
        {**PAIR, "covariance_si": [[1, 0], [0]]},
        "covariance_si must be a square matrix: a list of rows as long as itself",
        "in:4: correlated",
    ),
    "not numbers": (
        {**PAIR, "covariance_si": [[1, 0], [0, "x"]]},
        "covariance_si: 'x' is not a number",
        "in:4: correlated",
    ),
    "of another size": (
        {**PAIR, "covariance_si": [[1]]},
        "covariance must be 2 × 2, not (1, 1)",
        "in:4: azimuth A B + in:4: azimuth A B",
    ),
    "no members": (
        {**PAIR, "observations": [], "covariance_si": []},
        "observations must be one record or more",
        "in:4: correlated",
    ),
    "members are no list": (
        {**PAIR, "observations": AZIMUTH, "covariance_si": [[1]]},
        f"observations must be a list of records, not {AZIMUTH!r}",
        "in:4: correlated",
    ),
    "a field that is none": (
        {**PAIR, "covariance_si": [[1, 0], [0, 1]], "id": "7"},
        "unknown field 'id'; known: kind, observations, covariance_si, remark; "
        "did you mean 'kind'?",
        "in:4: correlated",
    ),
    "an image among them": (
        {**PAIR, "observations": [AZIMUTH, IMAGE], "covariance_si": np.eye(3).tolist()},
        "image points are correlated with image points only; give the others apart",
        "in:4: azimuth A B + in:4: image F A",
    ),
}


@pytest.mark.parametrize("case", WRONG_OBSERVATIONS)
def test_what_is_wrong_with_an_observation_is_said_with_its_source(case):
    record, what, where = WRONG_OBSERVATIONS[case]
    assert problems_of(j.observation_of, record, source="in:4") == [(what, where)]


def test_all_that_is_wrong_with_correlated_observations_is_said_at_once():
    members = [{**AZIMUTH, "value": "x"}, AZIMUTH, {**AZIMUTH, "target": "A"}, 3]
    record = {"kind": "correlated", "observations": members, "covariance_si": 1}
    found = problems_of(j.observation_of, record, source="in:4")
    assert [where for _, where in found] == [
        "in:4: correlated",
        "in:4, observation 1: azimuth A B",
        "in:4, observation 3: azimuth A A",
        "in:4, observation 4",
    ]


def test_without_a_source_messages_begin_with_the_observation():
    assert problems_of(j.observation_of, {**AZIMUTH, "value": "x"}) == [
        ("value: 'x' is not a number", "azimuth A B")
    ]
    assert problems_of(j.observation_of, {}) == [("kind is missing", "")]


# -- points, photos, cameras ----------------------------------------------------------------------


@pytest.mark.parametrize("frame", FRAMES)
def test_points_photos_and_cameras_come_back_to_the_bit(frame):
    network = everything(frame)
    for point in network.points.values():
        assert_same(point, j.point_of(through_json(j.point_fields(point))))
        assert j.point_of(j.point_fields(point)).name == point.name
    for photo in network.photos.values():
        assert_same(photo, j.photo_of(through_json(j.photo_fields(photo)), frame=network.frame))
    for camera in network.cameras.values():
        assert_same(camera, j.camera_of(through_json(j.camera_fields(camera))))


def test_drawn_points_and_photos_come_back_to_the_bit():
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        xyz, sigma = tuple(number(rng) for _ in "xyz"), tuple(abs(number(rng)) for _ in "xyz")
        point = Point("P", xyz, sigma=sigma, check=tuple(number(rng) for _ in "xyz"))
        assert_same(point, j.point_of(through_json(j.point_fields(point))))
        u, _, vt = np.linalg.svd(rng.normal(size=(3, 3)))
        for rotation in (world_R_camera(*rng.uniform(-3, 3, 3)), u @ vt * np.linalg.det(u @ vt)):
            weight = {"sigma_position": sigma, "sigma_attitude": abs(number(rng))}
            photo = Photo("f", "c", xyz, rotation, **weight)
            assert_same(photo, j.photo_of(through_json(j.photo_fields(photo))))


@pytest.mark.parametrize("name", LENSES_USED)
def test_cameras_of_every_lens_come_back_to_the_bit(name):
    used = LENSES_USED[name]
    network = Network()
    network.add_camera("c", used.lens, used.values, free=["c"], sigma={"x0": 1 / 3}, per_photo=True)
    camera = network.cameras["c"]
    assert j.camera_of(through_json(j.camera_fields(camera))) == camera


def test_a_camera_has_the_keys_of_the_project():
    network = Network()
    lens = LENSES_USED["harmonic"].lens
    network.add_camera("c", lens, {"c": 30.0, "x0": 0.5}, free=["c"], sigma={"x0": 0.1}, unit="px")
    record = j.camera_fields(network.cameras["c"])
    parameters = record.pop("parameters")
    assert record == {
        "name": "c",
        "lens": {"model": "harmonic", "reference_radius": 10.0, "residuals": "measured"},
        "unit": "px",
    }
    assert parameters["c"] == {"value": 30.0, "free": True}
    assert parameters["x0"] == {"value": 0.5, "sigma": 0.1}
    assert parameters["y0"] == 0.0


def test_records_of_points_and_photos_take_what_the_tables_take():
    at = {"name": 7, "latitude": 47.5, "longitude": "11.25", "height": 500}
    found = j.point_of({**at, "datum": True}, frame=GeocentricFrame())
    assert (found.name, found.datum, np.isnan(found.coordinates).any()) == ("7", True, False)
    record = {"name": "f", "camera": "c", "x": 1, "y": 2, "z": 3}
    turned = record | {"omega": 90, "phi": 0, "kappa": "0", "fixed": True}
    photo = j.photo_of(turned, context=RecordContext(Units(angle="deg")))
    assert np.array_equal(photo.rotation, world_R_camera(np.pi / 2, 0, 0))
    assert photo.fixed == (True,) * 6
    assert j.photo_of({**record, "fixed": False}).fixed == (False,) * 6


CAMERA = {"name": "c", "parameters": {"c": 30.0}}
WRONG_ENTITIES = {
    "no name": (j.point_of, {"x": 1}, ["name is missing"], "in:4: point"),
    "bad numbers": (
        j.point_of,
        {"name": "P", "x": "a", "y": True, "sigma_mm": 0},
        ["x: 'a' is not a number", "y: True is not a number", "sigma_mm must be greater than zero"],
        "in:4: point 'P'",
    ),
    "an unknown field": (
        j.point_of,
        {"name": "P", "fixd": "x"},
        ["unknown field 'fixd'; did you mean 'fixed'?"],
        "in:4: point 'P'",
    ),
    "held without value": (
        j.point_of,
        {"name": "P", "fixed": "z"},
        ["z is held or weighted but has no value"],
        "in:4: point 'P'",
    ),
    "no camera": (j.photo_of, {"name": "f"}, ["camera is missing"], "in:4: photo 'f'"),
    "no rotation": (
        j.photo_of,
        {"name": "f", "camera": "c", "fixed": "yes"},
        ["a held or weighted photo needs its orientation"],
        "in:4: photo 'f'",
    ),
    "no lens": (
        j.camera_of,
        {**CAMERA, "lens": "stereographic", "unit": "ell"},
        ["unknown unit 'ell'", "unknown model 'stereographic'"],
        "in:4: camera 'c'",
    ),
    "no parameters": (j.camera_of, {"name": "c"}, ["parameters is missing"], "in:4: camera 'c'"),
    "a parameter that is none": (
        j.camera_of,
        {**CAMERA, "parameters": {"c": 30.0, "k9": 1}},
        ["unknown calibration parameter k9 of lens model 'none'"],
        "in:4: camera 'c'",
    ),
    "no object": (j.camera_of, "c", ["a record must be an object {…}, not 'c'"], "in:4"),
}


@pytest.mark.parametrize("case", WRONG_ENTITIES)
def test_what_is_wrong_with_an_entity_is_said_with_its_source(case):
    read, record, whats, begin = WRONG_ENTITIES[case]
    found = problems_of(read, record, source="in:4")
    assert len(found) == len(whats)
    for (what, where), expected in zip(found, whats, strict=True):
        assert what.startswith(expected)
        assert where.startswith(begin)


def test_a_photo_has_a_whole_position_or_none():
    with pytest.raises(InputError, match="position must be finite or none"):
        everything("local").add_photo("f9", "camera 0", position=(np.nan, 1.0, 2.0))
    found = problems_of(j.photo_of, {"name": "f", "camera": "c", "x": 1, "y": 2}, source="in:4")
    assert found == [("z is missing", "in:4: photo 'f'")]


def test_a_left_handed_frame_takes_no_photo():
    found = problems_of(
        j.photo_of, {"name": "f", "camera": "c"}, frame=LocalFrame(axes="ne"), source="in:4"
    )
    assert found[0][0].startswith("photos need a right-handed frame")


# -- networks -------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", FRAMES)
def test_a_network_comes_back_to_the_bit(frame):
    network = everything(frame)
    assert_same_network(network, j.network_of(through_json(j.network_files(network))))


def test_real_networks_come_back_to_the_bit():
    for file in sorted(data_dir("gama_3d_networks").glob("*.gkf")):
        network = read_gama(file)
        assert_same_network(network, j.network_of(through_json(j.network_files(network))))


@pytest.mark.parametrize("frame", EVERY_FRAME)
def test_a_network_with_nothing_in_it_comes_back(frame):
    network = Network("", frame=EVERY_FRAME[frame][0], datum="free")
    assert_same_network(network, j.network_of(j.network_files(network)))
    network.add_point("A")
    assert_same_network(network, j.network_of(j.network_files(network)))


def test_a_network_without_observations_keeps_its_unknowns():
    network = everything("geocentric")
    network.observations.clear()
    network.clusters.clear()
    network.image_mask(np.zeros(network.n_image_points, dtype=bool))
    assert len(network.orientations) == 3
    assert_same_network(network, j.network_of(j.network_files(network)))
    # Free orientations too that no direction states any more.
    network.orientations = {k: p for k, p in network.orientations.items() if k == ("B, 2", "1")}
    assert_same_network(network, j.network_of(j.network_files(network)))


def test_a_project_on_disk_has_the_same_files(tmp_path):
    network = small_block()
    write_project(network, tmp_path / "project.toml")
    written = {f.name: f.read_text(encoding="utf-8") for f in tmp_path.iterdir()}
    assert written == j.network_files(network)


@pytest.mark.parametrize("name", ["../out.csv", "a/b.csv", "", "..", "a\\b", "a\0"])
def test_files_of_a_network_have_plain_names(name):
    found = problems_of(j.network_of, {"project.toml": "", name: ""})
    assert found == [("must be a plain file name", f"files: {name!r}")]


def test_files_that_make_no_network_are_named():
    assert problems_of(j.network_of, {}) == [("project.toml is missing", "files")]
    files = {**j.network_files(small_block()), "points.csv": 3}
    assert problems_of(j.network_of, files) == [("must be text, not 3", "files: 'points.csv'")]
    files["points.csv"] = "name,x\nA,\ud800\n"
    what, where = problems_of(j.network_of, files)[0]
    assert where == "points.csv:2"
    assert what.startswith("is not UTF-8 text (byte 9)")


def test_half_a_character_is_no_name():
    with pytest.raises(InputError, match="a name cannot have control characters"):
        Network().add_point("A\ud800", (0, 0, 0))


# -- the journal ----------------------------------------------------------------------------------

HEADER = {"options": {"policy": "flag"}, "files": {"project.toml": 'name = "ü"\n'}}
ENTRIES = [
    {"do": "add", "observations": [AZIMUTH], "verdicts": {"1": "accepted"}},
    {"do": "remove", "ids": ["1", "a\nb\u2028c"]},
    {"do": "add", "value": 0.1 + 0.2, "names": ["Süd", "東"], "nested": {"x": [1e-17, -0.0]}},
]


@pytest.fixture
def path(tmp_path):
    """Return the path of a journal with a header and three entries."""
    file = tmp_path / "day.jsonl"
    with Journal.create(file, HEADER, durable=False) as journal:
        for entry in ENTRIES:
            journal.append(entry)
    return file


def entries_of(path) -> list[dict[str, object]]:
    """Return the entries of a journal in which nothing is torn."""
    journal, header, entries, torn = Journal.open(path, durable=False)
    journal.close()
    assert header == {"journal": module.JOURNAL_VERSION, **HEADER}
    assert torn == ""
    return entries


def test_a_journal_gives_back_what_was_recorded(path):
    assert entries_of(path) == ENTRIES
    lines = path.read_text(encoding="utf-8").split("\n")
    assert len(lines) == len(ENTRIES) + 2
    assert "東" in lines[3]
    with Journal.open(path)[0] as journal:
        journal.append({"do": "snoop"})
    assert entries_of(path) == [*ENTRIES, {"do": "snoop"}]


def test_an_entry_is_in_the_file_and_on_the_disk_before_append_returns(path, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(module.os, "fsync", lambda d: (synced.append(d), real(d)))
    journal = Journal.open(path, durable=True)[0]
    journal.append({"do": "snoop"})
    assert path.read_bytes().splitlines()[-1].startswith(b'{"do": "snoop", "line": 5, ')
    assert len(synced) == 1
    journal.durable = False
    journal.append({"do": "settle"})
    assert path.read_bytes().splitlines()[-1].startswith(b'{"do": "settle", "line": 6, ')
    assert len(synced) == 1
    journal.close()


def test_a_journal_torn_at_any_byte_of_its_last_line_goes_on(path):
    whole = path.read_bytes()
    begin = whole.rstrip(b"\n").rindex(b"\n") + 1
    assert json.loads(whole[begin:]).items() >= ENTRIES[-1].items()
    for cut in range(begin, len(whole) + 1):
        path.write_bytes(whole[:cut])
        journal, header, entries, torn = Journal.open(path, durable=False)
        kept = ENTRIES if cut >= len(whole) - 1 else ENTRIES[:-1]
        assert header == {"journal": module.JOURNAL_VERSION, **HEADER}
        assert entries == kept, cut
        if begin < cut < len(whole) - 1:
            assert torn.startswith(f"{path}:4: the last line was torn and is left out: '{{"), cut
        else:
            assert torn == ""
        assert path.read_bytes() == (whole if len(kept) == len(ENTRIES) else whole[:begin])
        journal.append({"do": "snoop"})
        journal.close()
        assert entries_of(path) == [*kept, {"do": "snoop"}]


@pytest.mark.parametrize("last", [b"\n", b"{\n", b"\0\0\0\0", b"\0\0\n", b"\xff", b"[1]\n", b"3"])
def test_a_last_line_that_is_no_object_is_torn_even_if_it_ends(path, last):
    whole = path.read_bytes()
    path.write_bytes(whole + last)
    journal, _, entries, torn = Journal.open(path)
    journal.close()
    assert entries == ENTRIES
    assert torn.startswith(f"{path}:5: ")
    assert path.read_bytes() == whole


def test_a_long_torn_line_is_shown_by_its_beginning(path):
    with path.open("ab") as stream:
        stream.write(b'{"do": "' + b"x" * 10_000)
    journal, _, _, torn = Journal.open(path)
    journal.close()
    assert torn.endswith("x'…")
    assert len(torn) < len(str(path)) + 130


def test_a_header_torn_at_any_byte_says_that_nothing_was_recorded(path):
    header = path.read_bytes().split(b"\n")[0] + b"\n"
    for cut in range(len(header) - 1):
        path.write_bytes(header[:cut])
        ((what, where),) = problems_of(Journal.open, path)
        assert what.endswith("nothing had been recorded"), cut
        assert where.startswith(str(path))
        assert path.read_bytes() == header[:cut]
    path.write_bytes(header[:-1])
    assert entries_of(path) == []
    assert path.read_bytes() == header


@pytest.mark.parametrize("torn", [b"", b'{"do": "ad'])
def test_bad_lines_before_the_last_are_all_named_and_nothing_is_changed(path, torn):
    lines = path.read_bytes().split(b"\n")
    lines[1], lines[2] = b'{"do": "add", "value": NaN}', b""
    path.write_bytes(b"\n".join(lines) + torn)
    before = path.read_bytes()
    assert problems_of(Journal.open, path) == [
        ('is not an object of JSON: \'{"do": "add", "value": NaN}\'', f"{path}:2"),
        ("is not an object of JSON: ''", f"{path}:3"),
    ]
    assert path.read_bytes() == before


FOREIGN = {
    "text": (b"kind,station\n", "is not a journal: the first line is not its header {…}"),
    "text of two lines": (b"kind,station\n1,2\n", "is not a journal: the first line is not"),
    "bytes": (bytes(range(256)), "is not a journal: the first line is not its header {…}"),
    "JSON": (b"[1, 2]\n", "is not a journal: the first line is not its header {…}"),
    "observations": (b'{"kind": "azimuth"}\n{}\n', 'is not a journal: its first line lacks "jo'),
    "another version": (b'{"journal": 3}\n', "is a journal of version 3; valid: 4"),
    "a version that is true": (b'{"journal": true}\n', "is a journal of version True; valid: 4"),
    "empty": (b"", "is empty: nothing had been recorded"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_what_is_no_journal_is_refused_and_left_as_it_is(tmp_path, case):
    content, expected = FOREIGN[case]
    path = tmp_path / "file"
    path.write_bytes(content)
    ((what, where),) = problems_of(Journal.open, path)
    assert what.startswith(expected)
    assert where.startswith(str(path))
    assert path.read_bytes() == content


def test_a_file_that_cannot_be_opened_is_named(tmp_path):
    missing = tmp_path / "none.jsonl"
    assert problems_of(Journal.open, missing) == [
        ("cannot be opened: no such file or folder", str(missing))
    ]
    assert problems_of(Journal.create, tmp_path, {}) == [
        ("cannot be opened: is a folder", str(tmp_path))
    ]
    inside = missing / "a.jsonl"
    assert problems_of(Journal.create, inside, {})[0][1] == str(inside)
    assert list(tmp_path.iterdir()) == []


def test_create_refuses_a_file_that_holds_something(path):
    before = path.read_bytes()
    assert problems_of(Journal.create, path, HEADER) == [
        ("holds something already: resume this journal, or choose another name", str(path))
    ]
    assert path.read_bytes() == before


def test_create_takes_an_empty_file(tmp_path):
    path = tmp_path / "empty"
    path.touch()
    Journal.create(path, HEADER).close()
    assert entries_of(path) == []


def test_what_cannot_stand_in_json_is_not_recorded(path):
    before = path.read_bytes()
    with Journal.open(path)[0] as journal:
        circle: list[object] = []
        circle.append(circle)
        for bad in (float("nan"), np.inf, object(), "\ud800", circle):
            ((what, where),) = problems_of(journal.append, {"do": "add", "value": bad})
            assert what.startswith("cannot be recorded: ")
            assert where == str(path)
    assert path.read_bytes() == before


def test_a_header_that_cannot_stand_in_json_makes_no_file(tmp_path):
    assert len(problems_of(Journal.create, tmp_path / "a", {"value": np.nan})) == 1
    assert list(tmp_path.iterdir()) == []


# -- one process at a time ------------------------------------------------------------------------

needs_locks = pytest.mark.skipif(sys.platform == "win32", reason="no flock")
IN_USE = "is in use already: two cannot record in one journal"


@needs_locks
def test_a_journal_in_use_is_refused_until_it_is_closed(path):
    before = path.read_bytes()
    with Journal.open(path)[0] as journal:
        assert problems_of(Journal.open, path) == [(IN_USE, str(path))]
        assert problems_of(Journal.create, path, {}) == [(IN_USE, str(path))]
        assert path.read_bytes() == before
        journal.append({"do": "snoop"})
    assert entries_of(path) == [*ENTRIES, {"do": "snoop"}]


@needs_locks
def test_a_journal_that_nobody_holds_any_more_is_free(path):
    journal = Journal.open(path)[0]
    del journal
    gc.collect()
    assert entries_of(path) == ENTRIES


@needs_locks
def test_a_file_system_without_locks_is_used_without(path, monkeypatch):
    def fail(*_):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(module.fcntl, "flock", fail)
    assert entries_of(path) == ENTRIES


def test_a_closed_journal_takes_nothing(path):
    journal = Journal.open(path)[0]
    journal.close()
    journal.close()
    assert problems_of(journal.append, {"do": "add"}) == [("the journal is closed", str(path))]
    assert entries_of(path) == ENTRIES


# -- errors of the disk ---------------------------------------------------------------------------


@pytest.mark.parametrize("taken", [0, 1, 20])
def test_a_full_disk_leaves_no_part_of_an_entry(path, monkeypatch, taken):
    before = path.read_bytes()
    real = os.write
    journal = Journal.open(path)[0]
    calls = []

    def full(descriptor, data):
        calls.append(data)
        if len(calls) == 1 and taken:
            return real(descriptor, data[:taken])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(module.os, "write", full)
        assert problems_of(journal.append, {"do": "add", "ids": ["1"] * 9}) == [
            ("cannot be written: no space left on device; nothing was recorded", str(path))
        ]
    assert len(calls) == (2 if taken else 1)
    assert path.read_bytes() == before
    journal.append({"do": "snoop"})
    journal.close()
    assert entries_of(path) == [*ENTRIES, {"do": "snoop"}]


@needs_locks
def test_a_limit_of_the_system_on_the_size_of_files_leaves_no_part_of_an_entry(path):
    import resource

    before = path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Journal.open(path, durable=False)[0] as journal:
        resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 10, hard))
        try:
            with pytest.raises(InputError) as caught:
                journal.append({"do": "add", "ids": ["1"] * 9})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert "cannot be written: file too large" in str(caught.value)
        assert path.read_bytes() == before
        journal.append({"do": "snoop"})
    assert entries_of(path) == [*ENTRIES, {"do": "snoop"}]


@pytest.mark.parametrize("error", [OSError(errno.EIO, "I/O error"), KeyboardInterrupt()])
def test_an_entry_that_did_not_reach_the_disk_is_taken_back(path, monkeypatch, error):
    def fail(_):
        raise error

    before = path.read_bytes()
    with Journal.open(path)[0] as journal:
        with monkeypatch.context() as patch:
            patch.setattr(module.os, "fsync", fail)
            expected = InputError if isinstance(error, OSError) else KeyboardInterrupt
            with pytest.raises(expected):
                journal.append({"do": "add"})
        assert path.read_bytes() == before
        journal.append({"do": "snoop"})
    assert entries_of(path) == [*ENTRIES, {"do": "snoop"}]


def test_a_part_that_cannot_be_taken_back_ends_the_journal_and_is_torn_on_resuming(
    path, monkeypatch
):
    real = os.write
    journal = Journal.open(path)[0]

    def full(descriptor, data):
        if len(data) > 10:
            return real(descriptor, data[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    def fail(*_):
        raise OSError(errno.EIO, "I/O error")

    with monkeypatch.context() as patch:
        patch.setattr(module.os, "write", full)
        patch.setattr(module.os, "ftruncate", fail)
        assert len(problems_of(journal.append, {"a": 12345678})) == 1
    ((what, _),) = problems_of(journal.append, {"do": "snoop"})
    assert what.startswith("a torn line could not be cut off (I/O error)")
    journal.close()
    journal, _, entries, torn = Journal.open(path)
    journal.close()
    assert entries == ENTRIES
    assert torn.startswith(f"{path}:5: ")


def test_a_header_that_cannot_be_written_leaves_no_file(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module.os, "write", full)
    ((what, _),) = problems_of(Journal.create, tmp_path / "a", HEADER)
    assert what.startswith("cannot be written: no space left on device")
    assert list(tmp_path.iterdir()) == []


# -- killed ---------------------------------------------------------------------------------------

MOST_SEEN = 2000
"""Entries after which a process is killed at the latest."""
WRITER = """
import sys
from factorgraph_adj.io.journal import Journal
journal = Journal.create(sys.argv[1], {}, durable=False)
n = 0
while True:
    journal.append({"n": n, "text": "ü" * (n % 4000)})
    print(n, flush=True)
    n += 1
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize("seed", range(3))
def test_a_process_that_is_killed_loses_no_entry_that_it_had_recorded(tmp_path, seed):
    path = tmp_path / "killed.jsonl"
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        seen = [int(process.stdout.readline())]
        if sys.platform != "win32":
            assert problems_of(Journal.open, path) == [(IN_USE, str(path))]
        for _ in range(int(np.random.default_rng(seed).integers(MOST_SEEN))):
            seen.append(int(process.stdout.readline()))
        process.send_signal(signal.SIGKILL)
        seen += [int(line) for line in process.stdout.readlines() if line.endswith("\n")]
    journal, _, entries, _ = Journal.open(path)
    journal.close()
    assert [entry["n"] for entry in entries] == list(range(len(entries)))
    # One more may have been written whose report did not come through.
    assert len(entries) - (seen[-1] + 1) in (0, 1)


def test_a_camera_that_arrives_keeps_its_format_in_the_journal_and_in_a_saved_solution(tmp_path):
    block = small_block()
    camera = replace(block.cameras["D3"], format=(36.0, 24.0), origin="lower left")
    inc = fga.IncrementalAdjustment(fga.Network("arriving"), journal=tmp_path / "day.jsonl")
    inc.add(cameras=[camera])
    assert inc.described.cameras["D3"] == camera
    del inc
    gc.collect()
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl")
    assert again.described.cameras["D3"] == camera
    block.cameras["D3"] = camera
    fga.adjust(block).save(tmp_path / "solution.npz")
    assert fga.load_solution(tmp_path / "solution.npz").network.cameras["D3"] == camera
