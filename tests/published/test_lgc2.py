"""LGC2: offsets, wires, water levels, inclinometers and directions with the results of its tests.

The figures are those that its tests expect (tests_with_ScaleInstr.cpp, testMixingObservation.cpp,
testWPSR.cpp, testHLSR.cpp, testINCL.cpp, testCAM.cpp): coordinates to 10⁻⁷ m, σ to 10⁻⁴ mm.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.survey.lgc2 import CONDITION_SIGMA_M
from factorgraph_adj.observations import LineOffset
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array
from factorgraph_adj.units import GON
from tests.loaders import lgc2
from tests.support.places import data_dir

pytestmark = pytest.mark.published

TENTH_MICRON = 1e-7
SIGMA_MM = 1e-4
STAGES = (1.0, 1e-2, 1e-4, CONDITION_SIGMA_M)
"""Standard deviations of conditions, metres: a coarse start wants soft ones first."""


def text(name: str, case: str = "") -> str:
    """Return an input of LGC2: a file, or a string in a header."""
    path = data_dir("lgc2") / name
    return lgc2.texts(path)[case] if case else path.read_text(encoding="latin-1")


def read(source: str, *, tiny: float = CONDITION_SIGMA_M) -> fga.Network:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "input.lgc2"
        path.write_text(source, encoding="utf-8")
        return fga.read_lgc2(path, condition=tiny)


def adjusted(source: str) -> fga.Solution:
    found = None
    for tiny in STAGES:
        found = fga.adjust(read(source, tiny=tiny), start=found)
    assert found is not None
    assert found.converged
    return found


def sigma0(s: fga.Solution) -> float:
    return float(np.sqrt(s.vtpv / s.redundancy))


def assert_point(
    s: fga.Solution, name: str, xy: tuple[float, ...], sigma_mm: tuple[float, ...], scale: float
) -> None:
    found = s.unknown("point", name)
    n = len(xy)
    assert np.allclose(found.values[:n], xy, rtol=0, atol=TENTH_MICRON)
    assert np.allclose(1e3 * scale * found.sigmas[: len(sigma_mm)], sigma_mm, rtol=0, atol=SIGMA_MM)


def test_offsets_from_plumb_lines() -> None:
    s = fga.adjust(read(text("testECVE.lgc2")))
    assert (s.equations.n_rows, s.redundancy) == (29, 1)
    assert_point(s, "D1", (2088.1677910, 2221.3525452), (1.0183, 0.7650), 1.0)
    assert_point(s, "I1", (2235.1141657, 2423.6068480), (5.3252, 3.8861), 1.0)


def test_offsets_from_the_vertical_plane_of_a_theodolite() -> None:
    s = fga.adjust(read(text("testECTH.lgc2").replace("*LEP", "*OLOC")))
    assert_point(s, "BS1", (3050.0000171, 3000.4000200), (0.0094, 0.1421), sigma0(s))
    assert_point(s, "CS3", (2968.8129740, 3095.0129437), (0.1599, 0.0532), sigma0(s))


def test_offsets_from_a_vertical_plane_over_the_geoid_of_1985() -> None:
    """The printed result is of the version before, LGC1, which rounds verticals to 10⁻⁷ rad."""
    s = fga.adjust(read(text("testECTH.lgc2")))
    found = s.point("BS1")
    assert np.allclose(found, (3050.0003269, 3000.4003066, 2451.8527088), rtol=0, atol=5e-7)


DIRECTIONS = {
    1: {"R": 100.0005631, "Z100": 99.9999112, "AS1": 99.2358619, "BS1": 99.4929110},
    2: {
        **{"Z240": 240.0000061, "AS2": 239.2357388, "BS2": 239.4916916, "CS2": 239.8099373},
        **{"DS2": 239.2354481, "ES2": 239.4904048, "FS2": 239.8088737},
    },
}
DIRECTIONS[1]["CS1"] = 99.8086316
ZENITHS = {
    **{"R": 100.0006039, "Z100": 100.0008838, "AS1": 97.4551914, "BS1": 97.4556929},
    **{"CS1": 98.0907310, "Z240": 100.0005868, "AS2": 97.4555339, "BS2": 97.4547181},
    **{"CS2": 98.0911424, "DS2": 102.5442291, "ES2": 103.8152366, "FS2": 98.0914197},
}
DISTANCES = {
    **{"AS1": 25.0215755, "BS1": 50.0414341, "CS1": 100.0450487, "AS2": 25.0220386},
    **{"BS2": 50.0419100, "CS2": 100.0460034, "DS2": 25.0216248, "ES2": 50.0909242},
    **{"FS2": 100.0461469, "Z100": 100.0},
}
OFFSETS = {"AS1": (1.0446548, 2e-4), "BS1": (2.0403191, 5e-4), "CS1": (3.0147676, 5e-4)}
PLACES = {
    **{"S": (3000.0, 3000.0, 450.0), "R": (3120.0, 3000.0, 450.0)},
    **{"Z240": (2941.22147, 2919.0983, 450.0), "Z100": (3100.0, 3000.0, 450.0)},
    **{"AS1": (3025.0, 3000.3, 451.0), "BS1": (3050.0, 3000.4, 452.0)},
    **{"CS1": (3100.0, 3000.3, 453.0), "AS2": (2985.548074, 2979.598240, 451.0)},
    **{"BS2": (2970.934344, 2959.314036, 452.0), "CS2": (2941.464180, 2918.921965, 453.0)},
    **{"DS2": (2985.548074, 2979.598240, 449.0), "ES2": (2970.934344, 2959.314036, 447.0)},
    "FS2": (2941.464180, 2918.921965, 453.0),
}


def test_offsets_from_a_line_through_two_points() -> None:
    """The readings of the test ecsp_OLOC, which no file has."""
    network = fga.Network("ecsp_OLOC")
    for name, at in PLACES.items():
        network.add_point(name, at, fixed="xyz" if name in ("S", "R", "Z240") else "z")
    cc5 = 5e-4 * GON
    for number, targets in DIRECTIONS.items():
        for target, gon in targets.items():
            network.add(fga.Direction("S", target, gon * GON, sigma=cc5, set=str(number)))
            network.add(fga.ZenithAngle("S", target, ZENITHS[target] * GON, sigma=cc5))
    for target, value in DISTANCES.items():
        network.add(fga.SlopeDistance("S", target, value, sigma=1e-4))
    for point, (value, sigma) in OFFSETS.items():
        network.add(LineOffset(point, "S", "Z100", value, sigma=sigma))
    s = fga.adjust(network)
    assert_point(s, "BS1", (3049.9998622, 3000.3988332), (0.1001686, 0.5522184), 1.0)
    assert_point(s, "ES2", (2970.9348900, 2959.3143758), (0.4556394, 0.3329624), 1.0)


def test_the_file_with_offsets_from_sights_is_understood() -> None:
    """The file has no expected result; its offsets are those from the sights of a theodolite."""
    s = fga.adjust(read(text("testECSP.lgc2")))
    assert (s.equations.n_rows, s.redundancy) == (38, 7)


def test_a_bearing_that_is_held_on_the_sphere() -> None:
    """The test holds the bearing of a magnet; the file that of another point."""
    source = text("testPDOR.lgc2")
    held = "*PDOR   QFA____61610S     272.50910"
    assert held in source
    s = fga.adjust(read(source.replace(held, "*PDOR\nZS_____61638E 100.0")))
    scale = sigma0(s)
    first = (4176.4377368, 6627.9083784, 2400.7350565)
    assert_point(s, "QFA____61610S", first, (0.2732, 0.1101), scale)
    second = (4230.3293623, 6627.5797501, 2400.7508631)
    assert_point(s, "MST____61779S", second, (1.7518, 0.8167), scale)
    third = (4257.8602335, 6627.4266159, 2400.5550652)
    assert_point(s, "VEBW___61876E", third, (2.3346, 1.2862), scale)


# -- wires ----------------------------------------------------------------------------------------

_TURN = 6.3451035 * GON
"""Bearing or slope of the wires: atan 0.1."""
WIRES: dict[int, tuple[float, float, float, float, float]] = {
    # bearing, dx, dz, rise of the chord per horizontal metre, sag
    1: (0.0, -0.1, 0.2, 0.0, 0.0),
    2: (_TURN, 0.0, 0.0, 0.0, 0.0),
    3: (0.0, 0.0, 0.0, 0.1, 0.0),
    4: (_TURN, np.cos(_TURN), 0.0, 0.0, 0.0),
    5: (0.0, 0.0, 1.0, 0.1, 0.0),
    6: (_TURN, np.cos(_TURN), 1 - 0.1 * np.sin(_TURN) * np.cos(_TURN), 0.1 * np.cos(_TURN), 0.0),
    7: (0.0, 0.0, 0.0, 0.0, 1.0),
    8: (0.0, 0.0, 1.0, 0.0, 1.0),
    9: (0.0, 0.0, 1.0, 0.1, 1.0),
    10: (_TURN, np.cos(_TURN), 1 - 0.1 * np.sin(_TURN) * np.cos(_TURN), 0.1 * np.cos(_TURN), 1.0),
}
MIDDLE = np.array([0.0, 2.5, 0.0])
"""The middle of the anchors, from which the offsets of wires are stated."""


def chord(s: fga.Solution, wire: str) -> tuple[Array, Array]:
    """Return a point and the direction of a wire."""
    frame = s.unknown("frame", wire).values
    r = exp_rotation(frame[None, :3])[0]
    origin = np.array(s.network.frames[wire].constants[:3])
    return origin + r @ frame[3:6], r[:, 1]


@pytest.mark.parametrize("case", WIRES)
def test_wires_are_as_they_were_made(case: int) -> None:
    s = adjusted(text("testWPSR.h", f"ECWI_OLOC_{case}"))
    bearing, dx, dz, rise, sag = WIRES[case]
    at, along = chord(s, "WPSRight")
    level = float(np.hypot(along[0], along[1]))
    assert np.arctan2(along[0], along[1]) == pytest.approx(bearing, abs=1e-7 * GON)
    assert along[2] / level == pytest.approx(rise, abs=1e-9)
    # Across the bearing, and where the foot of the middle lies on the wire.
    across = np.array([np.cos(bearing), -np.sin(bearing), 0.0])
    assert across @ (at - MIDDLE) == pytest.approx(dx, abs=TENTH_MICRON)
    t = (MIDDLE - at)[:2] @ along[:2] / level**2
    assert (at + t * along)[2] == pytest.approx(dz, abs=TENTH_MICRON)
    assert s.unknown("size", "sag of WPSRight").values[0] == pytest.approx(sag, abs=TENTH_MICRON)
    assert s.redundancy == 14 - 5
    assert sigma0(s) < 1e-10


@pytest.mark.parametrize("case", [11, 12, 13, 14, 15, 16])
def test_wires_with_turned_sensors_and_free_bodies_have_the_same_sag(case: int) -> None:
    s = adjusted(text("testWPSR.h", f"ECWI_OLOC_{case}"))
    assert s.unknown("size", "sag of WPSRight").values[0] == pytest.approx(1.0, abs=TENTH_MICRON)
    _, along = chord(s, "WPSRight")
    back = np.sign(along[1])
    assert np.arctan2(back * along[0], back * along[1]) == pytest.approx(_TURN, abs=1e-7 * GON)


def test_a_held_sag_is_no_unknown() -> None:
    s = adjusted(text("testWPSR.h", "ECWI_OLOC_18"))
    assert s.redundancy == 14 - 4


def test_the_wires_and_water_levels_of_the_low_beta_magnets_at_point_8() -> None:
    s = fga.adjust(read(text("testWPSR.h", "ECWI_LEP_1")))
    expected = {
        "BEAM_LHC.MQXA.3L8.E": (4492.732871, 5055.338695, 2329.826748),
        "BEAM_LHC.MCBX.3R8.E": (4452.234637, 4956.401203, 2330.272103),
        "LHC.MQXB.B2R8.A": (4459.348359, 4974.880233, 2330.734785),
    }
    for name, at in expected.items():
        assert np.allclose(s.point(name), at, rtol=0, atol=1.5e-5), name


# -- water, inclinometers, directions -------------------------------------------------------------


def test_two_water_levels_and_sensors_that_read_up_and_down() -> None:
    s = adjusted(text("testHLSR.h", "ECWS_OLOC_1"))
    for name, level in (("LHC.L2.HLS_LO", 0.5), ("LHC.L2.HLS_HI", 0.6)):
        assert s.unknown("level", name).values[0] == pytest.approx(level, abs=TENTH_MICRON)
    for name, z in (("ROOTPT1", 0.5), ("Q3_A_HLS_LO_RefPtet", 0.3), ("Q3_A_HLS_LO_RefPt", 0.7)):
        assert s.point(name)[2] == pytest.approx(z, abs=TENTH_MICRON)
    for name, z in (("Q3_A_HLS_LO", 1.0), ("Q3_A_HLS_LOTH", 0.2)):
        assert s.point(f"{name}/origin")[2] == pytest.approx(z, abs=TENTH_MICRON)


@pytest.mark.parametrize("kind", ["INCLY", "ROLLY"])
def test_an_inclinometer_turns_its_frame(kind: str) -> None:
    """LGC2: the estimated rotation about y is the reading, here the mean of four."""
    source = text("testINCL.h", "INCLY_S0_VALIDATION_TEST").replace("*INCLY", f"*{kind}")
    s = adjusted(source)
    assert s.redundancy == 3
    turn = -s.unknown("frame", "TEST").values[1]  # rotations of LGC2 count the other way
    assert turn == pytest.approx(0.01 * GON, abs=1e-6 * GON)
    cc = 1e-4 * GON
    assert s.unknown("frame", "TEST").sigmas[1] == pytest.approx(2 * cc / 2, rel=1e-6)


def test_a_reference_angle_is_a_turn_of_the_instrument() -> None:
    """LGC2: a frame turned by 15 gon, and a reference angle of 15 gon, give the same."""
    s = adjusted(text("testINCL.h", "INCLY_REF_ANGLE_TEST"))
    a, b = (s.unknown("frame", f"freeFrame{i}").values for i in (1, 2))
    assert np.allclose(a, b, rtol=0, atol=1e-6 * GON)
    at = [s.point(f"freeFrame{i}/origin") for i in (1, 2)]
    assert np.allclose(*at, rtol=0, atol=1e-6)


UNIT_VECTORS = [
    *("UVD_ROOT_1", "UVD_ROOT_1_SUBF1", "UVD_SUBF_1", "UVD_SUBF_2", "UVD_SUBFNOTORIG_1"),
    *("UVD_2ST_ROOT", "UVD_2ST_1STINSUBF", "UVD_2STSUBF"),
    *("UVEC_ROOT_1", "UVEC_ROOT_1_SUBF", "UVEC_ROOTNOTORIG_1_SUBF", "UVEC_SUBF"),
    *("UVEC_SUBFNOTORIG_1", "UVEC_2ST_ROOT", "UVEC_2ST_1STINSUBF", "UVEC_2STSUBF"),
]


@pytest.mark.parametrize("case", UNIT_VECTORS)
def test_unit_vectors_from_stations_in_free_and_fixed_frames(case: str) -> None:
    s = adjusted(text("testCAM.h", case))
    assert np.allclose(s.point("P2VAR"), 100.0, rtol=0, atol=TENTH_MICRON)
    for name, p in s.network.frames.items():
        if not all(p.fixed):
            assert np.allclose(s.unknown("frame", name).values[:3], 0.0, rtol=0, atol=1e-7 * GON)


# -- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "why"),
    [
        ("*TITR\nx\n*RS2K\n", "geoid of 2000"),
        ("*TITR\nx\n*OLOC\n*SIMU 10\n", r"input.lgc2:4: \*SIMU is not understood"),
        ("*OLOC\n*FRAME F 0 0 0 0 0 0 1.5\n", "scale 1.5"),
        ("*OLOC\n*FRAME F 0 0 0 0 0 0 1\n*VXY\nA 1 2 3\n", r"\*VXY in a frame"),
        ("*OLOC\n*CALA\nA 1 2\n", "three coordinates"),
    ],
)
def test_what_is_not_understood_is_refused(source: str, why: str) -> None:
    with pytest.raises(fga.InputError, match=why):
        read(source)
