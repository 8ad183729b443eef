"""Projects of STAR*NET 13.0.2: a pre-analysis and a level network, and what their listings print.

Facts of jeelojacko/webnet, tests/fixtures: camp_design_preanalysis_traverse_only.dat and
camp_design_preanalysis_output.lst, industry_case_leveling_input.txt and …_output.txt.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.star_net_projects import star_net_project

pytestmark = pytest.mark.published

POINTS = """
GPS1 682579.733 5090745.219 65 0.005 0.005 0.01; GPS2 683005.038 5090804.624 39 0.005 0.005 0.01;
GPS3 682770.787 5091288.078 17 0.005 0.005 0.01; GPS4 682590.839 5090466.658 83 0.005 0.005 !;
GPS5 683186.559 5090575.718 46 0.005 0.005 0.01; GPS6 682736.72 5091053.517 35 0.005 0.005 0.01;
FRDN 681416.428 5089320.311 117 ! ! !; 100 682643.05 5090565.131 78;
101 682660.993 5090500.146 80; 102 682675.737 5090479.215 79; 103 682742.462 5090462.755 77;
104 682880.71 5090569.48 67; 105 682985.308 5090664.84 54; 106 683030.421 5090543.498 60;
107 683106.771 5090490.151 58; 108 683142.617 5090504.128 54; 109 682979.351 5090926.628 30;
110 682920.129 5090886.545 39; 111 682823.423 5090809.883 51; 112 682816.253 5090871.842 47;
113 682781.514 5090883.411 49; 114 682920.52 5091055.211 23; 115 682825.264 5090977.285 38;
116 682878.427 5091225.089 13; 117 682718.089 5091277.136 21; 118 682685.863 5091218.792 26;
119 682638.17 5091094.422 34; 120 682543.107 5090942.726 50; 121 682594.925 5090796.907 61;
122 682680.342 5090826.936 54; 123 682742.847 5090748.17 58; 124 682686.515 5090632.827 71;
125 682522.801 5090682.042 73; 126 682565.901 5090563.474 80; 127 682778.057 5091004.059 38;
128 682916.792 5090448.563 75; 129 682971.313 5090426.702 72; FM1 682628.95 5090893.569 51;
PEAT 682655.928 5090526.962 79; PITA 683074.918 5090482.434 61; POT 683172.088 5090520.232 50;
GATE 682960.388 5091114.327 15; TIMS 682852.981 5090655.002 60;
Meridian 682864.078 5090804.797 0; OLDA 682826.727 5091000.544 0
"""
"""Name, easting, northing, elevation, and standard errors of what is not free."""
SETS = """
128 103 104 TIMS 129; 129 128 PITA; 100 126 GPS4 124 PEAT; 101 PEAT 102; 102 101 GPS4 103;
103 102 104; 104 103 124 TIMS 105; 105 104 111 GPS2 106; 106 105 108 PITA POT; 107 PITA 108;
108 107 106 POT; 109 GPS2 110 114; 110 GPS2 115 109 127 OLDA; 111 105 112 Meridian;
112 Meridian 111 113 FM1; 113 112 115 122 OLDA; 114 109 GATE; 115 110 113 127; 116 GATE GPS3;
117 GPS3 118; 118 117 119; 119 118 GPS6 120; 120 119 FM1; 121 FM1 GPS1; 122 113 FM1 123;
123 122 TIMS 124; 124 GPS1 123 104 100; 125 GPS1 126; 126 100 125 GPS4; 127 GPS6 110 115;
GPS1 125 121 124; GPS2 110 109 105 GPS5; GPS3 116 117; GPS4 126 100 102; GPS5 POT GPS2;
GPS6 127 119 FM1; FM1 120 GPS6 122 112 121; PEAT 100 101; TIMS 104 123; PITA 106 107;
POT 108 106 GPS5; GATE 114 116
"""
"""Station and targets of the sets, each of which is measured twice: 244 sights."""
LISTED = """
GPS1 2233 2265 486 5606 5401 146-11 952; GPS2 2144 2271 625 5612 5191 21-20 1225;
GPS3 2893 2273 840 7085 5560 87-19 1647; GPS4 2553 2303 0 6480 5370 118-15 0;
GPS5 2180 2280 736 5604 5311 16-26 1443; GPS6 2268 2150 640 5560 5254 80-07 1255;
100 2352 2224 310 5855 5338 116-26 608; 101 2507 2284 407 6227 5490 111-03 797;
102 2511 2230 339 6199 5398 105-25 665; 103 2513 2218 450 6158 5421 95-43 881;
104 2303 2192 485 5719 5279 64-04 950; 105 2199 2254 572 5658 5234 35-40 1122;
106 2269 2334 650 5857 5401 34-51 1274; 107 2379 2402 710 6152 5534 42-21 1391;
108 2313 2388 694 6067 5423 36-39 1359; 109 2159 2301 666 5634 5285 2-10 1305;
110 2137 2206 627 5400 5230 4-32 1230; 111 2200 2218 647 5469 5346 34-16 1268;
112 2179 2169 608 5334 5309 95-11 1192; 113 2162 2141 594 5293 5240 96-27 1165;
114 2415 2360 775 5920 5768 76-26 1520; 115 2198 2153 629 5407 5243 114-20 1232;
116 2731 2342 847 6744 5662 104-08 1660; 117 2872 2297 819 7070 5573 80-00 1606;
118 2682 2278 780 6636 5491 75-02 1529; 119 2364 2248 682 5937 5339 59-12 1336;
120 2243 2436 659 5964 5490 2-13 1291; 121 2220 2269 548 5592 5395 153-34 1074;
122 2185 2180 556 5411 5272 132-17 1089; 123 2209 2163 515 5427 5273 111-44 1009;
124 2258 2166 421 5582 5242 114-14 824; 125 2290 2422 477 5978 5552 159-36 934;
126 2372 2334 327 6106 5390 131-16 642; 127 2207 2154 639 5402 5271 91-53 1252;
128 2511 2293 586 6267 5476 66-15 1148; 129 2564 2352 650 6436 5579 63-38 1274;
FM1 2160 2210 556 5410 5287 0-20 1089; PEAT 2453 2283 401 6097 5488 113-31 785;
PITA 2380 2398 675 6100 5587 42-33 1323; POT 2245 2373 698 5940 5354 28-48 1368;
GATE 2544 2487 818 6277 6037 117-18 1604; TIMS 2254 2218 542 5535 5410 67-20 1063;
Meridian 2279 2281 835 5652 5510 43-45 1636; OLDA 2307 2260 790 5687 5492 116-45 1549
"""
"""Station; σ of E, N and elevation; semi-axes, azimuth and height of 95 %; micrometres."""
LISTED_RELATIVE = """
105 Meridian 2751 2201 46-33 1424; 116 Meridian 5726 3599 91-25 1843;
115 118 4384 2798 68-26 1235; 103 108 4040 2924 155-05 1282; 109 128 4056 2980 105-56 1269;
GPS2 GPS5 1873 3 141-35 1091; 117 124 6837 3303 89-35 1488; 112 GPS4 4905 2690 122-25 1192;
118 120 4691 2549 115-03 1198; 116 127 4384 3207 103-25 1365; 101 125 3609 2462 50-21 1082;
117 126 7385 3863 97-59 1597
"""
"""Twelve of the 990 relative ellipses, spread at random: two stations, then as above."""
LEVELS = """
GPS3-GATE -3.452559 311.322; GPS3-GATE -3.451928 311.333; GATE-GPS3 3.451953 313.389;
GATE-GPS3 3.452123 313.390; GPS2-GPS6 -3.399673 393.317; GPS2-GPS6 -3.399693 393.335;
GPS6-GPS2 3.400005 393.045; GPS6-GPS2 3.399985 393.051; FM1-GPS6 -18.400838 223.285;
FM1-GPS6 -18.400867 223.300; GPS6-FM1 18.401244 223.467; GPS6-FM1 18.401184 223.279;
GPS2-TIMS 21.485000 339.620; GPS2-TIMS 21.484670 339.660; TIMS-GPS2 -21.485020 340.080;
TIMS-GPS2 -21.485360 340.120; GPS5-GPS2 -6.991572 290.206; GPS5-GPS2 -6.991921 290.210;
GPS2-GPS5 6.990872 290.955; GPS2-GPS5 6.990922 290.974; POT-GPS5 -4.639954 119.447;
POT-GPS5 -4.640285 119.554; GPS5-POT 4.640755 118.265; GPS5-POT 4.640995 118.229;
PITA-POT -10.403176 123.531; PITA-POT -10.403188 123.670; POT-PITA 10.403466 123.912;
POT-PITA 10.403053 123.924; TIMS-PITA 0.550833 304.486; TIMS-PITA 0.551255 304.535;
PITA-TIMS -0.551766 305.009; PITA-TIMS -0.552004 304.938;
PEAT-TIMS -15.978460 429.940 0.000393405; PEAT-TIMS -15.979110 429.910 0.000393405;
TIMS-PEAT 15.977280 443.620; TIMS-PEAT 15.976280 443.570; OOP-APOG 17.758100 425.440;
OOP-APOG 17.759100 425.110; APOG-OOP -17.758980 421.870; APOG-OOP -17.759420 422.030;
OOP-TIMS -5.696550 433.630; OOP-TIMS -5.696880 433.640; TIMS-OOP 5.695970 432.680;
TIMS-OOP 5.696260 432.670; OOP-FM1 -12.177970 177.140; OOP-FM1 -12.178390 177.130;
FM1-OOP 12.178740 177.090; FM1-OOP 12.178060 177.190; PEAT-APOG 7.478990 142.970;
PEAT-APOG 7.478990 143.010; APOG-PEAT -7.479110 143.570; APOG-PEAT -7.479460 143.570;
GPS3-GPS6 17.4922 480.682; GPS3-GPS6 17.49228 480.707; GPS6-GPS3 -17.49172 483.463;
GPS6-GPS3 -17.49177 483.478; GATE-GPS2 24.344570 376.420; GATE-GPS2 24.343300 376.330;
GPS2-GATE -24.342880 389.610; GPS2-GATE -24.343920 391.060
"""
"""Names, height difference, length of the line, and a standard error where it is stated; metres."""
LISTED_HEIGHTS = """
GPS3 51.9278 535; GATE 48.4755 527; GPS2 72.8191 406; GPS6 69.4199 388; FM1 87.8214 291;
TIMS 94.3032 341; GPS5 79.8106 480; POT 84.4512 482; PITA 94.8545 467; PEAT 110.2814 367;
APOG 117.7601 368
"""
"""Station, adjusted elevation (metres), σ (micrometres)."""
HALF_MICROMETRE = 0.5e-6
ROUNDING = 0.2e-6
"""Of the ellipse by the elevation and by coordinates of the grid that STAR*NET iterates, metres."""
CONFIDENCE_2D, CONFIDENCE_1D = 2.4477468306808161, 1.9599639845400545
HELD = 1e-5
"""σ of a component that is held in the grid (m): `factorgraph_adj.network.grid.transformation`."""


def rows(text: str) -> list[list[str]]:
    return [part.split() for part in text.replace("\n", " ").split(";") if part.strip()]


def design(folder: Path) -> fga.Plan:
    lines = ["B GPS2-GPS5 N60-29-49.36W !", ".INSTRUMENT SX12", ".rel /EVERY"]
    lines += [f"C {' '.join(words)}" for words in rows(POINTS)]
    for station, *targets in rows(SETS):
        lines += 2 * [f"DB {station}", *(f"DM {target}" for target in targets), "DE"]
    (folder / "Traverse_Only.dat").write_text("\n".join(lines), encoding="utf-8")
    text = star_net_project(
        ["Traverse_Only.dat"],
        local_or_grid_adjustment="1",
        coordinate_system_name="UTM83-19",
        fixed_angular_std_err="1.0001e-03",
        zenith_std_err="1.0",
        target_centering_error="0.00075",
        library={
            "SX12": {
                "distance_std_err": "0.001",
                "edm_ppm": "1.5",
                "angle_std_err": "1.414",
                "direction_std_err": "1.0",
                "azimuth_std_err": "1.414",
                "zenith_std_err": "1.0",
                "instrument_centering_error": "0.00075",
                "target_centering_error": "0.00075",
                "vertical_centering_error": "0.0005",
            }
        },
    )
    (folder / "Camp_Design.snproj").write_text(text, encoding="utf-8")
    return fga.plan(fga.read_star_net_project(folder / "Camp_Design.snproj", readings=False))


def ellipse(covariance: np.ndarray) -> tuple[float, float, float, float]:
    """Return semi-axes (m), azimuth of the major one (degrees) and the height (m), 95 %."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    azimuth = np.degrees(np.arctan2(vectors[0, 1], vectors[1, 1])) % 180
    minor, major = CONFIDENCE_2D * np.sqrt(np.maximum(values, 0.0))
    return major, minor, azimuth, CONFIDENCE_1D * np.sqrt(covariance[2, 2])


def assert_ellipse(covariance: np.ndarray, words: list[str], held: float = 0.0) -> None:
    """Compare with a listed ellipse; ``held`` is the σ that ours has of a held elevation."""
    major, minor, azimuth, height = ellipse(covariance)
    listed = [1e-6 * float(words[i]) for i in (0, 1, 3)]
    listed[2] = np.hypot(listed[2], CONFIDENCE_1D * held)
    found = np.array([major, minor, height])
    np.testing.assert_allclose(found, listed, rtol=0, atol=HALF_MICROMETRE + ROUNDING)
    degrees, minutes = words[2].split("-")
    off = (azimuth - float(degrees) - float(minutes) / 60 + 90) % 180 - 90
    # A minute is printed; axes that are rounded by a micrometre turn a nearly round ellipse.
    assert abs(np.radians(off)) < np.radians(0.5 / 60) + 1.5 * HALF_MICROMETRE / (major - minor)


def test_a_design_has_the_precision_that_the_pre_analysis_lists(tmp_path: Path) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    solution = design(tmp_path).solution
    grid = fga.grid_coordinates(solution)
    number = {name: i for i, name in enumerate(solution.network.points)}
    jacobian = dict(zip(number, grid.places.jacobians, strict=True))
    observed = solution.network.observations.values()
    kinds = [o.kind for o in observed]
    sights = [kinds.count(k) for k in ("direction", "slope_distance", "zenith_angle", "azimuth")]
    assert sights == [244, 244, 244, 1]
    assert len(rows(LISTED)) == 44
    for name, *words in rows(LISTED):
        east, north, up = (1e-6 * float(w) for w in words[:3])
        # All elevations refer to that of GPS4, which is held.
        listed = (east, north, np.hypot(up, HELD))
        found = grid.places.sigma[number[name]]
        np.testing.assert_allclose(found, listed, rtol=0, atol=HALF_MICROMETRE + ROUNDING)
        j = jacobian[name]
        assert_ellipse(j @ solution.covariance(name) @ j.T, words[3:], HELD)
    for a, b, *words in rows(LISTED_RELATIVE):
        ja, jb = jacobian[a], jacobian[b]
        both = ja @ solution.covariance(a, b) @ jb.T
        own = ja @ solution.covariance(a) @ ja.T + jb @ solution.covariance(b) @ jb.T
        assert_ellipse(own - both - both.T, words, HELD if "GPS4" in (a, b) else 0.0)


def test_a_level_network_has_the_heights_and_the_summary_of_its_listing(tmp_path: Path) -> None:
    """60 observations, 11 unknowns; sum of squares 40.156, error factor 0.905."""
    lines = ["C OOP 682579.733 5090745.219 100 ! ! !", *(f"L {' '.join(w)}" for w in rows(LEVELS))]
    (tmp_path / "Level.dat").write_text("\n".join(lines), encoding="utf-8")
    text = star_net_project(["Level.dat"], adjustment_type="Lev")
    (tmp_path / "Level.snproj").write_text(text, encoding="utf-8")
    solution = fga.adjust(fga.read(tmp_path / "Level.snproj"))
    assert (solution.n_observations, solution.n_unknowns, solution.redundancy) == (60, 11, 49)
    assert solution.vtpv == pytest.approx(40.156, abs=0.5e-3)
    assert solution.sigma0 == pytest.approx(0.905, abs=0.5e-3)
    for name, height, sigma in rows(LISTED_HEIGHTS):
        assert solution.point(name)[2] == pytest.approx(float(height), abs=0.5e-4)
        found = np.sqrt(solution.covariance(name)[2, 2])
        assert found == pytest.approx(1e-6 * float(sigma), abs=HALF_MICROMETRE)
