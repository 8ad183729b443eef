"""Motions during the readout: full circles of a drone block through OPF and Metashape, refusals."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import DatumError, InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.io.photogrammetry.block_source import add_pixel_camera
from factorgraph_adj.io.photogrammetry.metashape_cameras import calibration_parameters
from factorgraph_adj.io.photogrammetry.opf import read_opf
from factorgraph_adj.models.lens import NormalisedLens
from factorgraph_adj.models.rolling_shutter import Towards
from factorgraph_adj.observations import ControlPoint, PhotoPosition
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.statistical_tests import global_test
from tests.networks import photo_files
from tests.networks.rolling_drone import FOCAL, READOUT, SENSOR, SIGMA_PX, flown, true_motions

FREE = ("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2")
"""What is unknown of the calibration: OPF frees all."""
TURNING: dict[str, Any] = {"readout": READOUT, "sigma_turn": 0.01}
"""Options of a camera that turns during the readout, by 1/3 rad/s."""


@pytest.fixture(scope="module")
def plan() -> fga.Network:
    """Return the drone block with a camera as programs that count pixels have it."""
    network = flown()
    network.cameras.clear()
    values = {"c": FOCAL, "x0": SENSOR[0] / 2, "y0": -SENSOR[1] / 2, "k1": -0.01}
    add_pixel_camera(
        network,
        "camera",
        NormalisedLens(),
        values,
        size=SENSOR,
        free=FREE,
        readout=(READOUT, "down"),
    )
    return network


@pytest.fixture(scope="module")
def flight(plan: fga.Network) -> fga.Network:
    """Return the block as measured, with rough poses, as a program that lost the motions has it."""
    network = disturb(measure(plan, seed=7), seed=7, points=0.3, centres=0.3, attitudes=0.005)
    network.cameras["camera"] = replace(network.cameras["camera"], readout=None)
    network.parameters.clear()
    return network


Motion = Callable[[str], tuple[np.ndarray, np.ndarray]]
"""Shift and turn of the whole readout of a photo that a file states."""


@pytest.fixture(scope="module")
def true(plan: fga.Network) -> Motion:
    """Return the true shift and turn of the whole readout of a photo."""
    motions = true_motions(plan)
    return lambda photo: (READOUT * motions[photo][:3], READOUT * motions[photo][3:])


def opf(network: fga.Network, folder: Path, motion: Motion | None) -> Path:
    """Write a project whose calibrated cameras have Δc, the shift of half the readout."""
    folder.mkdir(exist_ok=True)
    fga.write_opf(network, folder / "block.opf")
    target = folder / "calibrated-cameras.json"
    document = json.loads(target.read_text(encoding="utf-8"))
    for photo, camera in zip(network.photos, document["cameras"], strict=True):
        if motion is not None:
            camera["rolling_shutter"] = (motion(photo)[0] / 2).tolist()
    target.write_text(json.dumps(document, indent=1), encoding="utf-8")
    return folder / "block.opf"


def numbers(values: Any) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


def metashape(network: fga.Network, folder: Path, motion: Motion | None, part: float = 2.0) -> Path:
    """Write a project whose cameras have location and rotation of a part of the readout.

    A ray p is seen along R (p − t) in the last row.
    """
    folder.mkdir(exist_ok=True)
    camera = network.cameras["camera"]
    values = dict(zip(camera.lens.names, camera.values, strict=True))
    parameters = calibration_parameters(camera.lens, values, SENSOR)
    assert parameters is not None
    calibration = "".join(f"<{n}>{v!r}</{n}>" for n, v in parameters.items())
    cameras, ids = [], {p: i for i, p in enumerate(network.photos)}
    centres = {o.photo: o for o in network.observations.values() if isinstance(o, PhotoPosition)}
    for name, photo in network.photos.items():
        matrix = np.eye(4)
        assert photo.rotation is not None and photo.position is not None
        matrix[:3, :3], matrix[:3, 3] = photo.rotation, photo.position
        moved = ""
        if motion is not None:
            shift, turn = motion(name)
            location = photo.rotation.T @ shift / part
            rotation = exp_rotation(turn[None] / part)[0].T
            moved = (
                f"<rolling_shutter><rotation>{numbers(rotation)}</rotation>"
                f"<location>{numbers(location)}</location></rolling_shutter>"
            )
        x, y, z = centres[name].value
        sx, sy, sz = centres[name].sigma or (1.0, 1.0, 1.0)
        cameras.append(
            f'<camera id="{ids[name]}" sensor_id="0" label="{name}">'
            f"<transform>{numbers(matrix)}</transform>{moved}"
            f'<reference x="{x!r}" y="{y!r}" z="{z!r}" sx="{sx}" sy="{sy}" sz="{sz}"/></camera>'
        )
    control = {o.point: o for o in network.observations.values() if isinstance(o, ControlPoint)}
    markers, locations = [], []
    photo, point, xy, _ = network.images.columns()
    for number, name in enumerate(network.points):
        reference = ""
        if name in control:
            x, y, z = control[name].value
            reference = f'<reference x="{x!r}" y="{y!r}" z="{z!r}" sxyz="0.02"/>'
        markers.append(f'<marker id="{number}" label="{name}">{reference}</marker>')
        seen = "".join(
            f'<location camera_id="{photo[i]}" x="{float(xy[i, 0])!r}" y="{-float(xy[i, 1])!r}"/>'
            for i in np.flatnonzero(point == number)
        )
        locations.append(f'<marker marker_id="{number}">{seen}</marker>')
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="1.2.0"><chunks><chunk id="0" label="drone block">
<sensors><sensor id="0" label="camera" type="frame">
<resolution width="{SENSOR[0]:g}" height="{SENSOR[1]:g}"/>
<property name="rolling_shutter" value="true"/>
<calibration type="frame" class="adjusted">{calibration}</calibration>
<covariance><params>f cx cy k1 k2 k3 p1 p2</params></covariance></sensor></sensors>
<cameras>
{chr(10).join(cameras)}
</cameras>
<markers>{"".join(markers)}</markers>
<settings><property name="accuracy_projections" value="{SIGMA_PX}"/></settings>
<frames><frame id="0"><markers>{"".join(locations)}</markers></frame></frames>
</chunk></chunks></document>
"""
    with zipfile.ZipFile(folder / "block.psz", "w") as archive:
        archive.writestr("doc.xml", text.replace(chr(10) + chr(10), chr(10)))
    return folder / "block.psz"


WRITERS = {"opf": opf, "metashape": metashape}


def moving_opf(folder: Path) -> dict[str, bytes]:
    """Return a project of OPF whose photos move during the readout."""
    files = photo_files.opf(folder)
    document = json.loads(files["calibrated-cameras.json"])
    for i, camera in enumerate(document["cameras"]):
        camera["rolling_shutter"] = [0.03 + 0.01 * i, -0.02, 0.005]
    files["calibrated-cameras.json"] = json.dumps(document, indent=1).encode()
    return files


def moving_metashape(folder: Path) -> dict[str, bytes]:
    """Return an export of Metashape whose photos move during the readout."""
    text = photo_files.metashape(folder)["cameras.xml"].decode()
    rotation = exp_rotation(np.array([[0.002, -0.001, 0.003]]))[0]
    moved = (
        f"\n<rolling_shutter>\n<rotation>{numbers(rotation)}</rotation>\n"
        "<location>0.02 -0.01 0.005</location>\n</rolling_shutter>"
    )
    text = re.sub(r"<camera .*?</transform>", lambda m: m[0] + moved, text, flags=re.DOTALL)
    return {"cameras.xml": text.encode()}


EXAMPLE_FILES = {
    "opf of a rolling shutter": replace(
        photo_files.EXAMPLE_FILES["opf"], contents=moving_opf, options={"readout": 0.03}
    ),
    "metashape-xml of a rolling shutter": replace(
        photo_files.EXAMPLE_FILES["metashape-xml"],
        contents=moving_metashape,
        options={"rolling_shutter": "half readout"},
    ),
}


def motion_of(solution: Solution, photo: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion of a photo and its standard deviations, NaN where it is held."""
    found = solution.unknown("photo_motion", photo)
    return np.array(found.values), np.array(found.sigmas)


# -- full circles ---------------------------------------------------------------------------------


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("choice", ["half readout", "estimate"])
def test_motions_of_a_simulated_block_are_recovered(
    form: str, choice: str, plan: fga.Network, flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """Whether the file states them or they begin at zero: the same minimum, within 4 σ."""
    path = WRITERS[form](flight, tmp_path, true)
    solution = fga.adjust(fga.read(path, rolling_shutter=choice, **TURNING))
    assert solution.converged and global_test(solution).accepted
    errors = []
    for photo, motion in true_motions(plan).items():
        found, sigma = motion_of(solution, photo)
        errors.append((found - motion) / sigma)
        assert sigma[:3].max() < 10.0  # the weight alone gives 33 m/s
    assert np.abs(errors).max() < 4.0
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.35)


def test_the_formats_and_a_network_of_our_own_give_the_same_motions(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """OPF states no turns: those of its photos begin at zero, and are weighted about it."""
    half = {"rolling_shutter": "half readout"}
    whole = {"rolling_shutter": "whole readout"}
    for path, options, turns in (
        (opf(flight, tmp_path / "opf", true), {}, False),
        (metashape(flight, tmp_path / "half", true), half, True),
        (metashape(flight, tmp_path / "whole", true, part=1.0), whole, True),
    ):
        own = flight.copy()
        own.cameras["camera"] = replace(own.cameras["camera"], readout=READOUT)
        for photo in own.photos:
            shift, turn = true(photo)
            start = np.concatenate([shift, turns * turn]) / READOUT
            deviations = np.repeat([1.0, TURNING["sigma_turn"]], 3) / READOUT
            own.set_unknown("photo_motion", photo, start, sigma=deviations)
        read = fga.read(path, **options, **TURNING)
        for photo, motion in read.of_kind("photo_motion").items():
            stated = own.of_kind("photo_motion")[photo]
            np.testing.assert_allclose(motion.values, stated.values, atol=1e-9)
        ours, theirs = fga.adjust(own), fga.adjust(read)
        for photo in flight.photos:
            a, b = motion_of(ours, photo), motion_of(theirs, photo)
            np.testing.assert_allclose(a, b, atol=1e-5)


def test_without_a_readout_time_motions_are_those_of_the_whole_readout(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    path = opf(flight, tmp_path, true)
    network = fga.read(path)
    assert network.cameras["camera"].readout == 1.0
    assert any("its time is unknown: motions are those of the whole" in r for r in network.remarks)
    known = fga.adjust(fga.read(path, readout=READOUT))
    unknown = fga.adjust(network)
    for photo in flight.photos:
        assert network.of_kind("photo_motion")[photo].values[:3] == pytest.approx(true(photo)[0])
        a, b = motion_of(known, photo)[0], motion_of(unknown, photo)[0]
        np.testing.assert_allclose(READOUT * a, b, atol=1e-7)
        assert not b[3:].any()
    assert unknown.vtpv == pytest.approx(known.vtpv, rel=1e-9)


def test_turns_are_unknown_but_where_the_file_has_none(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    def straight(photo: str) -> tuple[np.ndarray, np.ndarray]:
        return true(photo)[0], np.zeros(3)

    psz, turning = metashape(flight, tmp_path / "psz", straight), metashape(flight, tmp_path, true)
    half = {"rolling_shutter": "half readout"}
    for path, options, sigma in (
        (psz, half, None),
        (psz, {"rolling_shutter": "estimate"}, 0.01),
        (psz, {**half, "sigma_turn": 0.002}, 0.002),
        (turning, half, 0.01),
        (turning, {**half, "sigma_turn": 0.0}, None),
    ):
        for motion in fga.read(path, **options).of_kind("photo_motion").values():
            assert motion.fixed == (False,) * 3 + (sigma is None,) * 3
            assert motion.sigma == (1.0,) * 3 + (np.inf if sigma is None else sigma,) * 3


def test_photos_that_stand_still_do_not_fit(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """What it is for: σ̂0 of the poses alone; what is left out is told."""
    network = fga.read(opf(flight, tmp_path, true), rolling_shutter="leave out")
    assert network.cameras["camera"].readout is None
    assert not network.of_kind("photo_motion")
    left = {e.what: e.count for e in network.left_out}
    assert left["motions of photos during the readout"] == len(network.photos)
    still = fga.adjust(network)
    assert still.sigma0 > global_test(still).upper


# -- what the files say ---------------------------------------------------------------------------


def test_a_motion_of_metashape_is_seen_as_an_open_library_projects_it(tmp_path: Path) -> None:
    """PlaCamera, test MatchesMetashapeRollingShutterProjectionAndInverseRay: its figures."""
    rotation = exp_rotation(np.array([[0.0012, -0.0008, 0.0005]]))[0]
    camera = (
        '<camera id="0" sensor_id="0" label="F"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1'
        f"</transform><rolling_shutter><rotation>{numbers(rotation)}</rotation>"
        "<location>0.04 -0.025 0.012</location></rolling_shutter></camera>"
    )
    path = tmp_path / "cameras.xml"
    path.write_text(
        '<?xml version="1.0"?>\n<document version="1.4.0">\n<chunk><sensors><sensor id="0" '
        'label="c" type="frame"><resolution width="1000" height="600"/><calibration type="frame" '
        'class="adjusted"><f>700</f><cx>-100</cx><cy>0</cy></calibration></sensor></sensors>\n'
        f"<cameras>{camera}</cameras></chunk>\n</document>\n",
        encoding="utf-8",
    )
    network = fga.read(path, rolling_shutter="half readout")
    network.set_unknown(
        "photo_motion", "F", network.of_kind("photo_motion")["F"].values, fixed=True
    )
    network.photos["F"] = replace(network.photos["F"], fixed=(True,) * 6)
    network.add_point("P", (0.25, -0.1, 1.0), fixed="xyz")
    at = (581.4944620108606, 226.09080567129956)
    network.add_image_points("F", ["P"], [(at[0], -at[1])], sigma=1.0)
    equations = compile_network(network)
    v = equations.residuals(equations.unknowns.start())
    np.testing.assert_allclose(v, 0.0, atol=1e-5)  # that library iterates the row


def test_motions_of_metashape_need_an_option_that_says_what_they_are(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    path = metashape(flight, tmp_path, true)
    with pytest.raises(InputError) as caught:
        fga.read(path)
    (problem,) = caught.value.problems
    for part in (
        "photo 'F0' moves during the readout of a rolling shutter (photos that move: 8)",
        "Metashape does not state of which part of the readout",
        "valid: rolling_shutter='estimate'",
    ):
        assert part in str(problem)
    solution = fga.adjust(fga.read(path, rolling_shutter="estimate"))  # the option, and no other
    assert solution.converged and global_test(solution).accepted


@pytest.mark.parametrize(
    ("moved", "message"),
    [
        ("<rotation>1 0 0 0 1 0 0 0</rotation>", "<rotation>"),
        ("<rotation>2 0 0 0 2 0 0 0 2</rotation>", "is no rotation"),
        ("<location>1 2 x</location>", "<location>"),
        ("<speed>1</speed>", "unknown element <speed>"),
        (
            "<location>1 2 3</location><translation>1 2 3</translation>",
            "<translation> states the location a second time",
        ),
    ],
)
def test_motions_that_are_none_are_refused(
    moved: str, message: str, flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    path = metashape(flight, tmp_path, true)
    with zipfile.ZipFile(path) as archive:
        text = archive.read("doc.xml").decode()
    begin = text.index("<rolling_shutter>") + len("<rolling_shutter>")
    end = text.index("</rolling_shutter>")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("doc.xml", text[:begin] + moved + text[end:])
    with pytest.raises(InputError, match=message):
        fga.read(path, rolling_shutter="estimate")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rolling_shutter": "guess"}, "unknown rolling_shutter 'guess'; valid: refuse"),
        ({"readout": 0.0}, "readout must be > 0, not 0"),
        ({"readout_towards": "back"}, "unknown readout_towards 'back'"),
        ({"sigma_shift": float("nan")}, "sigma_shift must be > 0, not nan"),
        ({"sigma_turn": -1.0}, "sigma_turn must be ≥ 0, not -1"),
    ],
)
def test_options_that_are_none_are_refused(
    options: dict[str, Any], message: str, flight: fga.Network, tmp_path: Path
) -> None:
    path = opf(flight, tmp_path, None)
    with pytest.raises(InputError, match=message):
        read_opf(path, **options)


def test_a_sensor_with_a_rolling_shutter_and_no_motions_is_remarked(
    flight: fga.Network, tmp_path: Path
) -> None:
    network = fga.read(metashape(flight, tmp_path, None))
    assert network.cameras["camera"].readout is None
    assert any("rolling shutter whose photos have no motion: camera" in r for r in network.remarks)


def rewritten(path: Path, old: str, new: str) -> Path:
    """Replace a text in a project of Metashape."""
    with zipfile.ZipFile(path) as archive:
        text = archive.read("doc.xml").decode()
    assert old in text
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("doc.xml", text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("said", "rolling"),
    [
        ('<property name="rolling_shutter_flags" value="3"/>', True),
        ('<property name="rolling_shutter_flags" value="63"/>', True),
        ('<property name="rolling_shutter_flags" value="0"/>', False),
        (
            '<property name="rolling_shutter" value="true"/>'
            '<property name="rolling_shutter_flags" value="63"/>',
            True,
        ),
        (
            '<property name="rolling_shutter" value="false"/>'
            '<property name="rolling_shutter_flags" value="63"/>',
            False,
        ),
        ("", False),
    ],
)
def test_flags_of_a_rolling_shutter_tell_that_a_sensor_has_one(
    said: str, rolling: bool, flight: fga.Network, tmp_path: Path
) -> None:
    """PlaCamera reads flags alone, 3 as Metashape's Regularized."""
    path = metashape(flight, tmp_path, None)
    network = fga.read(rewritten(path, '<property name="rolling_shutter" value="true"/>', said))
    assert any("cameras with a rolling shutter" in r for r in network.remarks) == rolling


def test_the_shift_may_be_called_a_translation(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    options: dict[str, Any] = {"rolling_shutter": "half readout", **TURNING}
    path = metashape(flight, tmp_path, true)
    first = fga.read(path, **options).of_kind("photo_motion")
    text = "location>"  # <location camera_id=…> of markers has attributes
    second = fga.read(
        rewritten(
            rewritten(path, f"<{text}", "<translation>"),
            f"{text}</rolling",
            "translation></rolling",
        ),
        **options,
    ).of_kind("photo_motion")
    for photo, motion in first.items():
        assert second[photo].values == motion.values and any(motion.values[:3])


@pytest.mark.parametrize(
    ("controls", "centres", "bars", "directions", "weighted"),
    [
        (1, 0, 0, 0, False),
        (0, 1, 0, 0, False),
        (1, 1, 0, 0, False),
        (1, 0, 0, 1, False),
        (0, 0, 1, 0, False),
        (1, 1, 0, 1, True),
        (2, 1, 0, 0, True),
        (0, 3, 0, 0, True),
    ],
)
def test_shifts_are_weighted_where_scale_and_orientation_are_known(
    controls: int,
    centres: int,
    bars: int,
    directions: int,
    weighted: bool,
    flight: fga.Network,
    true: Motion,
    tmp_path: Path,
) -> None:
    """A weight about zero shrinks a network of open scale, and shifts turn with it."""
    network, ends = flight.copy(), list(flight.points)[:2]
    kept = {ControlPoint: controls, PhotoPosition: centres}
    for key, observation in list(network.observations.items()):
        if kept.get(type(observation), 0) <= 0:
            del network.observations[key]
        else:
            kept[type(observation)] -= 1
    a, b = (np.array(network.points[n].coordinates) for n in ends)
    length = float(np.linalg.norm(b - a))
    if bars:
        network.add(fga.SlopeDistance(*ends, length, sigma=0.01))
    if directions:
        network.add(fga.PointDirection(*ends, *((b - a) / length).tolist(), sigma=0.001))
    path = opf(network, tmp_path, true)
    for choice in ("estimate", "half readout"):
        read = fga.read(path, rolling_shutter=choice, readout=READOUT)
        motions = read.of_kind("photo_motion").values()
        sigma = 1.0 / READOUT if weighted else None
        for motion in motions:
            found = list(motion.sigma[:3])
            assert found == [pytest.approx(sigma)] * 3 if weighted else not np.isfinite(found).any()
        assert any("may be open" in r for r in read.remarks) != weighted


def test_a_scale_bar_and_no_position_leave_shifts_free(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """With weights about zero this free network does not converge."""
    network, ends = flight.copy(), list(flight.points)[:2]
    network.observations.clear()
    a, b = (np.array(network.points[n].coordinates) for n in ends)
    network.add(fga.SlopeDistance(*ends, float(np.linalg.norm(b - a)), sigma=0.01))
    read = fga.read(opf(network, tmp_path, true), rolling_shutter="estimate", **TURNING)
    solution = fga.adjust(read)
    assert solution.converged and global_test(solution).accepted


def test_one_control_point_leaves_the_scale_open(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """The error tells it; velocities about zero do not shrink the block instead."""
    network = flight.copy()
    first = next(k for k, o in network.observations.items() if isinstance(o, ControlPoint))
    for key in list(network.observations):
        if key != first:
            del network.observations[key]
    read = fga.read(opf(network, tmp_path, true), rolling_shutter="estimate", **TURNING)
    with pytest.raises(DatumError, match="scale"):
        fga.adjust(read)


def test_the_readout_may_proceed_to_another_side(
    flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """A sensor that is read upwards moves the other way: the same image points and start."""
    path = opf(flight, tmp_path, true)
    down = fga.adjust(fga.read(path, readout=READOUT))
    network = fga.read(path, readout=READOUT, readout_towards="up")
    up = fga.adjust(network)
    for photo in flight.photos:
        a, b = motion_of(down, photo)[0], motion_of(up, photo)[0]
        np.testing.assert_allclose(a, -b, atol=1e-6)
        start = network.of_kind("photo_motion")[photo].values[:3]
        np.testing.assert_allclose(start, -true(photo)[0] / READOUT, rtol=1e-12)
    with pytest.raises(InputError, match="those from row to row; valid: readout_towards='down' or"):
        fga.read(path, readout_towards="left")
    aside = fga.read(path, readout_towards="left", rolling_shutter="estimate")
    assert aside.cameras["camera"].readout_towards == "left"


@pytest.mark.parametrize("towards", ["down", "up"])
def test_adjusted_velocities_are_written_as_opf_has_them(
    towards: Towards, flight: fga.Network, true: Motion, tmp_path: Path
) -> None:
    """They are read again as they were adjusted; pyopf finds the same numbers."""
    pyopf = pytest.importorskip("pyopf.io")
    path = opf(flight, tmp_path / "first", true)
    options: dict[str, Any] = {"readout": READOUT, "readout_towards": towards}
    solution = fga.adjust(fga.read(path, **options))
    fga.write_opf(solution.as_network(), tmp_path / "second" / "block.opf")
    again = fga.read(tmp_path / "second" / "block.opf", **options)
    document = json.loads((tmp_path / "second" / "input-cameras.json").read_text("utf-8"))
    assert [s["shutter_type"] for s in document["sensors"]] == ["rolling"]
    stored = pyopf.load(str(tmp_path / "second" / "calibrated-cameras.json"))
    sign = {"down": 0.5, "up": -0.5}[towards] * READOUT
    for photo, camera in zip(flight.photos, stored.cameras, strict=True):
        found = motion_of(solution, photo)[0]
        read = again.of_kind("photo_motion")[photo].values
        np.testing.assert_allclose(camera.rolling_shutter, sign * found[:3], rtol=1e-12)
        np.testing.assert_allclose(read[:3], found[:3], rtol=1e-12)


def test_velocities_of_columns_are_refused_by_opf(flight: fga.Network, tmp_path: Path) -> None:
    network = flight.copy()
    network.cameras["camera"] = replace(
        network.cameras["camera"], readout=READOUT, readout_towards="left"
    )
    network.set_unknown("photo_motion", "F0", (1.0, 0, 0, 0, 0, 0))
    with pytest.raises(InputError, match="OPF cannot express the motion of a photo but a velocity"):
        fga.write_opf(network, tmp_path / "block.opf")
