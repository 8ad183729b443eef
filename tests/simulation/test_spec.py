"""Specs: checked, written and read without loss, varied, and the same again from one seed."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

import factorgraph_adj as fga
from examples.published_blocks.spec_parts import (
    Aerial1986,
    CloseRange1986,
    IndustryBlock,
    IspBlock,
)
from factorgraph_adj.entities import ImageTable
from factorgraph_adj.errors import InputError
from factorgraph_adj.network.network import Network
from factorgraph_adj.simulation.disturbances import DropOut, Errors, GrossError
from factorgraph_adj.simulation.generate.control import Control
from factorgraph_adj.simulation.generate.flight_observations import Gnss, Lake, Statoscope
from factorgraph_adj.simulation.generate.metrology import Shapes, Trackers
from factorgraph_adj.simulation.generate.photo_blocks import Aerial, CloseRange, CrossStrips
from factorgraph_adj.simulation.generate.rigs_and_models import Rig
from factorgraph_adj.simulation.generate.scene import Camera
from factorgraph_adj.simulation.generate.terrestrial_additions import (
    Astronomic,
    Azimuths,
    Directions,
    DistanceMeter,
    Distances,
    HeightDifferences,
    VerticalAngles,
)
from factorgraph_adj.simulation.generate.terrestrial_networks import (
    LevellingLoops,
    Monitoring,
    Traverse,
    TriangulationGrid,
)
from factorgraph_adj.simulation.spec import Approximate, Earth, Spec, design, read_spec, simulate
from factorgraph_adj.simulation.systematic_errors import (
    AffineFilm,
    LensDistortion,
    Refraction,
    Systematic,
    TapeCalibration,
)

SMALL = Aerial(strips=2, photos_per_strip=4, points_per_photo=12)
EVERYTHING = Spec(
    name='every "kind" of part, and ½ of all errors',
    seed=7,
    earth=Earth(frame="topocentric", latitude_deg=47.1, longitude_deg=8.3, refraction=0.13),
    parts=(
        replace(
            SMALL,
            camera=Camera(
                lens="gruen",
                lens_options={"image_base": 92.0},
                free=("c", "x0"),
                sigma={"y0": 0.01},
            ),
        ),
        Distances(distance_meter=DistanceMeter("EDM", unknown=("scale",))),
        Distances(between="given", lines=(("1", "2"), ("2", "3"))),
        HeightDifferences(between="nearest", count=5),
        Directions(count=5),
        Azimuths(count=3),
        VerticalAngles(count=3),
        Astronomic(count=3),
        Monitoring(),
        CloseRange(prefix="c", of_parts=(8,), distance=40.0, size=(10.0, 10.0, 10.0)),
        Traverse(),
        TriangulationGrid(),
        LevellingLoops(),
        Trackers(prefix="t"),
        Shapes(shapes=("plane", "circle"), measured_mm=0.5),
        CrossStrips(parts=(0,), camera=Camera("cross")),
        Gnss(arm=(0.1, 0.2, 0.3), shift_mm=0.1 + 0.2, time_error_ms=-4.0, parts=(0,)),
        Statoscope(parts=(0,), profiles="weighted"),
        Lake(parts=(0,), height=1.5, middle=(0.25, 1 / 3)),
        Rig(parts=(0,), camera=Camera("side", c_mm=120.0)),
    ),
    control=Control("perimeter", "full", horizontal_count=8, sigma_vertical_mm=5.0),
    errors=Errors(
        systematic=(
            LensDistortion(radii_mm=(50.0, 100.0), distortion_um=(3.0, -1 / 3)),
            AffineFilm(scale_um=15.0, shear_um=0.1 + 0.2),
            Refraction(0.05),
            TapeCalibration(ppm=20.0, zero_mm=1e-300, distance_meter="EDM"),
        ),
        gross=(
            GrossError(ids=("1/1/1",), component="x", size=0.1),
            GrossError(count=2, observations="slope_distance", times_sigma=20.0),
        ),
        drop_outs=(DropOut(0.05, observations="image"),),
    ),
    approximate=Approximate(0.1, 0.2, 0.3),
)


def readings(network: Network) -> list[object]:
    """Return everything that is read and given in a network, to the bit."""
    return [
        [c.tolist() for c in network.images.columns()],
        [(i, o.kind, o.names(), o.value) for i, o in network.observations.items()],
        [(p.name, p.coordinates, p.fixed) for p in network.points.values()],
        [(f.name, f.position, f.rotation.tolist()) for f in network.photos.values()],
        list(network.refractions.values()),
        list(network.distance_meters.values()),
    ]


def fields_of(cls: type) -> list[str]:
    """Return the keys of a table."""
    return [f.name for f in fields(cls)]


def problems(spec_or_error: str | pytest.ExceptionInfo[InputError]) -> dict[str, str]:
    """Return what is wrong by the path of its key."""
    if isinstance(spec_or_error, str):
        with pytest.raises(InputError) as error:
            design(read_spec(spec_or_error))
        spec_or_error = error
    return {p.where: p.what for p in spec_or_error.value.problems}


# -- TOML -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spec",
    [
        EVERYTHING,
        Spec(parts=(IspBlock(),)),
        Spec(parts=(IndustryBlock(distances=40),)),
        Spec(parts=(Aerial1986(distances=24),), datum="free"),
        Spec(parts=(CloseRange1986(), Distances(between="given", lines=(("11", "12"),)))),
    ],
)
def test_a_spec_is_read_as_it_was_written(spec: Spec) -> None:
    again = read_spec(spec.to_toml())
    assert again == spec
    assert again.to_toml() == spec.to_toml()


def test_a_spec_read_from_a_file_makes_the_same_network(tmp_path) -> None:
    path = tmp_path / "spec.toml"
    path.write_text(EVERYTHING.to_toml(), encoding="utf-8")
    assert readings(simulate(read_spec(path)).network) == readings(simulate(EVERYTHING).network)


def test_a_short_file_takes_the_defaults() -> None:
    spec = read_spec('[[parts]]\nkind = "aerial"\nstrips = 2\n[control]\n')
    assert spec == Spec(parts=(Aerial(strips=2),), control=Control())


def test_a_table_keeps_what_it_leaves_out_of_the_default_of_its_part() -> None:
    spec = read_spec('[[parts]]\nkind = "close_range"\ncamera.c_mm = 35.0\n')
    assert spec.parts == (CloseRange(camera=replace(CloseRange().camera, c_mm=35.0)),)


# -- seeds ----------------------------------------------------------------------------------------


def test_the_same_spec_and_seed_make_the_same_network_to_the_bit() -> None:
    a, b = simulate(EVERYTHING, seed=3), simulate(EVERYTHING, seed=3)
    assert readings(a.network) == readings(b.network)
    assert a.gross_errors == b.gross_errors
    assert a.dropped == b.dropped


def test_another_seed_changes_the_errors_but_not_the_geometry() -> None:
    a, b = simulate(EVERYTHING, seed=3), simulate(EVERYTHING, seed=4)
    assert readings(a.network) != readings(b.network)
    assert list(a.truth.points) == list(b.truth.points)
    assert np.array_equal(list(a.truth.points.values()), list(b.truth.points.values()))


def test_the_seed_of_the_spec_changes_the_geometry() -> None:
    spec = Spec(parts=(SMALL,))
    a, b = design(spec), design(spec.varied({"seed": 1}))
    assert a.points["1"].coordinates != b.points["1"].coordinates


def test_a_part_has_the_same_geometry_whatever_follows() -> None:
    alone = design(Spec(parts=(SMALL,)))
    together = design(Spec(parts=(SMALL, Monitoring())))
    assert all(together.points[n].coordinates == p.coordinates for n, p in alone.points.items())


def test_a_design_reads_what_is_true() -> None:
    plan = design(Spec(parts=(SMALL, Distances(count=3)), control=Control()))
    for o in plan.observations.values():
        a, b = (np.array(plan.points[n].coordinates) for n in o.names())
        assert o.value == pytest.approx(np.linalg.norm(a - b), abs=1e-9)
    corner = next(p for p in plan.points.values() if all(p.fixed))
    assert corner.check is None
    free = next(p for p in plan.points.values() if not any(p.fixed))
    assert free.check == free.coordinates


# -- variation ------------------------------------------------------------------------------------


def test_levels_of_factors_change_what_stands_at_their_path() -> None:
    spec = Spec(
        parts=(SMALL, Distances()),
        errors=Errors(gross=(GrossError(ids=("1/1/1",), size=0.1),)),
    )
    varied = spec.varied({"parts.1.count": 12, "errors.gross.0.size": 1e-4, "control": Control()})
    assert varied.parts[1].count == 12
    assert varied.errors.gross[0].size == 1e-4
    assert varied.control == Control()
    assert spec.parts[1].count == 24


def test_levels_that_are_valid_only_together_are_changed_together() -> None:
    spec = Spec(parts=(replace(SMALL, scale=4000.0),))
    varied = spec.varied({"parts.0.flying_height": 500, "parts.0.scale": None})
    assert varied.parts[0].height == 500.0


def test_a_level_may_be_a_number_of_numpy() -> None:
    varied = Spec(parts=(SMALL,)).varied({"parts.0.strips": np.int64(3)})
    assert varied.parts[0].strips == 3
    assert read_spec(varied.to_toml()) == varied


def test_levels_at_unknown_paths_are_all_refused() -> None:
    with pytest.raises(InputError) as error:
        Spec(parts=(SMALL,)).varied({"parts.0.overlap": 1, "parts.3.strips": 2, "part": 1})
    found = problems(error)
    assert set(found) == {"parts.0.overlap", "parts", "part"}
    assert "forward_overlap" in found["parts.0.overlap"]
    assert "0 to 0" in found["parts"]


def test_a_path_is_understood_as_python_writes_it() -> None:
    spec = Spec(parts=(SMALL,), errors=Errors(gross=(GrossError(ids=("1/1/1",), size=0.1),)))
    varied = spec.varied({"parts[0].strips": 3, "errors.gross[0].size": 0.2})
    assert varied == spec.varied({"parts.0.strips": 3, "errors.gross.0.size": 0.2})
    assert varied.parts[0].strips == 3


def test_the_path_of_a_message_is_one_that_can_be_varied() -> None:
    spec = Spec(parts=(SMALL, Distances()))
    with pytest.raises(InputError) as error:
        spec.varied({"parts.1.count": -1})
    (where,) = problems(error)
    assert spec.varied({where: 3}).parts[1].count == 3


def test_a_level_below_a_table_that_is_not_there_is_told_how_to_give_it() -> None:
    spec = Spec(parts=(SMALL,))
    with pytest.raises(InputError) as error:
        spec.varied({"control.horizontal": "full", "parts.0.strips.first": 2})
    found = problems(error)
    assert set(found) == {"control", "parts.0.strips"}
    assert "is not there" in found["control"]
    assert "{'control': {'horizontal': 'full'}}" in found["control"]
    assert "is 2, which has no 'first'" in found["parts.0.strips"]
    varied = spec.varied({"control": {"horizontal": "full"}})
    assert varied.control == Control("full")


def test_keys_that_are_not_set_are_written_as_comments() -> None:
    text = Spec(parts=(SMALL,), earth=Earth(), control=Control()).to_toml()
    for key in ("scale", "flying_height", "horizontal_count", "vertical_count", "refraction"):
        assert f"# {key} = …  (not set)" in text.splitlines()
    assert "# [parts.camera.sigma]  (empty)" in text.splitlines()
    assert "# control = …  (not set)" in Spec(parts=(SMALL,)).to_toml().splitlines()
    every = {key for cls in (Aerial, Camera, Control, Earth) for key in fields_of(cls)}
    assert all(key in text for key in every)


# -- what is wrong --------------------------------------------------------------------------------

GRID = '[[parts]]\nkind = "triangulation_grid"\n'
DISTANCES = '[[parts]]\nkind = "distances"\ncount = 3\n'
DISTORTED = '[[errors.systematic]]\nkind = "lens_distortion"\ncoefficients_um = [0.0, 5.0]\n'
FILM = '[[errors.systematic]]\nkind = "affine_film"\nshear_um = 5.0\n'
TAPE = '[[errors.systematic]]\nkind = "tape"\nzero_mm = 5.0\n'
REFRACTION = '[[errors.systematic]]\nkind = "refraction"\n'
AERIAL = '[[parts]]\nkind = "aerial"\nstrips = 2\nphotos_per_strip = 4\n'


@pytest.mark.parametrize(
    ("text", "where", "what"),
    [
        ('[[parts]]\nkind = "arial"\n', "parts.0.kind", "unknown kind 'arial'; valid: .*aerial"),
        ("[[parts]]\nkind = [1]\n", "parts.0.kind", r"unknown kind \[1\]"),
        (
            '[[parts]]\nkind = "industry_1981"\ndistances = 5000\n',
            "parts.0.distances",
            "is 5000, but there are only",
        ),
        ("[[parts]]\nstrips = 2\n", "parts.0.kind", "has no kind; valid: .*aerial"),
        ("parts = []\n", "parts", "at least one part"),
        ('name = "x"\n', "parts", "is missing"),
        (AERIAL + "overlap = 0.6\n", "parts.0.overlap", "unknown key; valid: .*forward_overlap"),
        (AERIAL + "forward_overlap = 1.0\n", "parts.0.forward_overlap", "≥ 0 and < 1"),
        (AERIAL + "side_overlap = -0.1\n", "parts.0.side_overlap", "-0.1, but must be ≥ 0"),
        (AERIAL + "forward_overlap = 0.45\n", "parts.0.forward_overlap", "one ray; valid: .*0.5"),
        (AERIAL + 'points = "hexagons"\n', "parts.0.points", "'hexagons'; valid: grid, von_gru"),
        ('[[parts]]\nkind = "aerial"\nstrips = "two"\n', "parts.0.strips", "a whole number"),
        (AERIAL + "relief = true\n", "parts.0.relief", "must be a number, not True"),
        (AERIAL + "relief = nan\n", "parts.0.relief", "finite"),
        (AERIAL + "relief = 400.0\n", "parts.0.relief", "400 m, but the photos are only 765 m"),
        (AERIAL + "points_per_photo = 20.5\n", "parts.0.points_per_photo", "a whole number"),
        (AERIAL + "scale = 5e3\nflying_height = 9e2\n", "parts.0.flying_height", "either scale"),
        (AERIAL + "camera = 3\n", "parts.0.camera", "must be a table"),
        (AERIAL + "camera.format_mm = [230]\n", "parts.0.camera.format_mm", "2 values, not 1"),
        (
            AERIAL + 'camera.free = ["k1"]\n',
            "parts.0.camera.free",
            "unknown calibration parameter 'k1' of lens 'none'; valid: c, x0, y0",
        ),
        (
            AERIAL + "camera.lens_options.radius = 1.0\n",
            "parts.0.camera.lens_options",
            "does not take",
        ),
        (
            AERIAL + '[[parts]]\nkind = "distances"\nparts = [2]\n',
            "parts.1.parts",
            "no earlier part 2; valid: 0 to 0",
        ),
        (
            AERIAL + '[[parts]]\nkind = "distances"\ncount = 5000\n',
            "parts.1.count",
            "is 5000, but there are only",
        ),
        (
            AERIAL + '[[parts]]\nkind = "azimuths"\nbetween = "given"\nlines = [["1", "no"]]\n',
            "parts.1.lines.0",
            "unknown point 'no'; known: 1, 2",
        ),
        (AERIAL + AERIAL, "parts.1.prefix", "exist already .* another prefix"),
        (
            AERIAL + '[[parts]]\nkind = "astronomic"\n',
            "parts.1.kind",
            "earth.frame = 'topocentric'",
        ),
        (
            '[[parts]]\nkind = "close_range"\ndistance = 3.0\n',
            "parts.0.distance",
            "within the object; valid: above 4.2",
        ),
        (
            '[[parts]]\nkind = "close_range"\ncamera.c_mm = 900.0\n',
            "parts.0.distance",
            "points are on the photos",
        ),
        ('[[parts]]\nkind = "monitoring"\ndistance = 5.0\n', "parts.0.distance", "above 10 m"),
        (AERIAL + '[control]\nhorizontal = "edge"\n', "control.horizontal", "valid: full, perim"),
        (
            AERIAL + '[control]\nhorizontal = "named"\nhorizontal_points = ["P9"]\n',
            "control.horizontal_points",
            "unknown point 'P9'; known: 1, 2",
        ),
        (AERIAL + '[control]\nvertical = "named"\n', "control.vertical_points", "goes with"),
        (AERIAL + "[control]\nparts = [1]\n", "control.parts", "no part 1; valid: 0 to 0"),
        (
            AERIAL + '[[errors.gross]]\nids = ["1/1/x"]\nsize = 1.0\n',
            "errors.gross.0.ids",
            "unknown observation '1/1/x'; known: 1/1/",
        ),
        (
            AERIAL + '[[errors.gross]]\ncount = 3\nobservations = "azimuth"\nsize = 1.0\n',
            "errors.gross.0.count",
            "is 3, but there are 0 such readings",
        ),
        (
            AERIAL + '[[errors.gross]]\nids = ["1/1/1"]\n',
            "errors.gross.0.size",
            "either size or times_sigma",
        ),
        (
            AERIAL + '[[errors.gross]]\nids = ["1/1/1"]\nsize = 1.0\ncomponent = "z"\n',
            "errors.gross.0.component",
            "no component 'z'; valid: x, y",
        ),
        (
            AERIAL + '[[errors.systematic]]\nkind = "tape"\ndistance_meter = "T"\n',
            "errors.systematic.0.distance_meter",
            "unknown distance meter 'T'; known: none",
        ),
        (
            AERIAL + '[[errors.systematic]]\nkind = "lens_distortion"\n',
            "errors.systematic.0.coefficients_um",
            "either",
        ),
        (
            AERIAL + "[[errors.drop_outs]]\nprobability = 1.0\n",
            "errors.drop_outs.0.probability",
            "is 1, but must be ≥ 0 and < 1",
        ),
        (AERIAL + "[earth]\nrefraction_unknown = true\n", "earth.refraction_unknown", "a value"),
        (
            AERIAL
            + GRID
            + '[control]\nparts = [0]\nvertical = "named"\nvertical_points = ["G1"]\n',
            "control.vertical_points",
            "'G1' is not in these parts; known: 1, 2",
        ),
        (
            AERIAL + DISTANCES + "[control]\nparts = [1]\n",
            "control.parts",
            "these parts have no points",
        ),
        (
            AERIAL + "[control]\nvertical_count = 9\n",
            "control.vertical_count",
            "is 9, but 'corners' has 4 points; valid: up to that",
        ),
        (
            AERIAL + '[control]\nhorizontal = "none"\nhorizontal_count = 1\n',
            "control.horizontal_count",
            "is 1, but 'none' has 0 points",
        ),
        (
            AERIAL
            + '[control]\nvertical = "named"\nvertical_points = ["1", "2"]\nvertical_count = 1\n',
            "control.vertical_count",
            "goes with a pattern, not with vertical = 'named'",
        ),
        (GRID + DISTORTED, "errors.systematic.0", "changes no reading: .* no image points"),
        (GRID + FILM, "errors.systematic.0", "changes no reading: .* no image points"),
        (AERIAL + TAPE, "errors.systematic.0", "changes no reading: .* no distances"),
        (AERIAL + REFRACTION, "errors.systematic.0", "no reading: .* no zenith and no vertical"),
        ("seed = -1\n" + AERIAL, "seed", "is -1, but must be ≥ 0"),
        ("seeds = 1\n" + AERIAL, "seeds", "unknown key; valid: parts, name, seed"),
    ],
)
def test_what_is_wrong_is_named_with_its_key_and_what_is_valid(
    text: str, where: str, what: str
) -> None:
    with pytest.raises(InputError, match=what) as error:
        design(read_spec(text))
    assert list(problems(error)) == [where]


@pytest.mark.parametrize(
    "error",
    [LensDistortion(coefficients_um=(0.0,)), AffineFilm(), Refraction(0.0), TapeCalibration()],
    ids=lambda error: error.kind,
)
def test_a_systematic_error_of_size_zero_needs_no_readings(error: Systematic) -> None:
    """As a level of an experiment it is the case without."""
    part = LevellingLoops()
    simulate(Spec(parts=(part,), control=Control("none"), errors=Errors(systematic=(error,))))


def test_a_systematic_error_of_one_instrument_needs_readings_of_it() -> None:
    own = Distances(distance_meter=DistanceMeter("EDM", unknown=("scale",)), count=3)
    cameras = (SMALL, replace(SMALL, prefix="b", camera=Camera(name="other")))
    tape, film = TapeCalibration(ppm=1.0, distance_meter="EDM"), AffineFilm("other", scale_um=1.0)
    design(Spec(parts=(*cameras, own), errors=Errors(systematic=(tape, film))))
    plan = design(Spec(parts=(*cameras, own)))
    without = fga.without(plan, list(plan.observations))
    without.set_distance_meter("EDM")
    without.images = ImageTable()
    for error in (tape, film):
        assert error.unknown(plan, "it") == []
        (problem,) = error.unknown(without, "it")
        assert problem.where == "it"
        assert "has no" in problem.what


@pytest.mark.parametrize("seed", ["a", 1.0, -1, True])
def test_a_seed_that_is_none_is_refused(seed: object) -> None:
    with pytest.raises(InputError, match="seed: must be a whole number ≥ 0, not"):
        simulate(Spec(parts=(SMALL,)), seed=seed)  # type: ignore[arg-type]


def test_everything_that_is_wrong_is_said_at_once() -> None:
    found = problems(
        'seed = "x"\n[[parts]]\nkind = "aerial"\nside_overlap = 2.0\n'
        '[[parts]]\nkind = "levels"\n[control]\nvertical = "top"\n'
    )
    keys = {"seed", "parts.0.side_overlap", "parts.1.kind", "control.vertical"}
    assert set(found) == keys


def test_control_and_gross_errors_that_do_not_exist_are_said_at_once() -> None:
    spec = Spec(
        parts=(SMALL,),
        control=Control("named", "none", horizontal_points=("A", "B")),
        errors=Errors(gross=(GrossError(ids=("7",), size=1.0),)),
    )
    with pytest.raises(InputError) as error:
        simulate(spec)
    where = [p.where for p in error.value.problems]
    assert where == ["control.horizontal_points"] * 2 + ["errors.gross.0.ids"]


def test_a_part_that_fails_is_not_blamed_on_those_that_need_it() -> None:
    spec = Spec(parts=(CloseRange(camera=Camera(c_mm=5000.0)), Distances(), Distances(parts=(0,))))
    with pytest.raises(InputError) as error:
        design(spec)
    assert [p.where for p in error.value.problems] == ["parts.0.distance"]


def test_text_that_is_not_toml_and_files_that_are_not_there_are_named(tmp_path) -> None:
    with pytest.raises(InputError, match="spec:1: is not TOML"):
        read_spec("parts = [\n")
    with pytest.raises(InputError, match=r"none\.toml: cannot be read"):
        read_spec(tmp_path / "none.toml")
