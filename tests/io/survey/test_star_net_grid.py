"""STAR*NET in a grid: positions, heights, vectors, instruments, further files, damage."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.errors import InputError
from factorgraph_adj.units import ARCSEC
from tests.hostile.damage import DAMAGES
from tests.networks.grids import GRIDS

pytest.importorskip("pyproj", reason="the extra crs is not installed")

METRIC: dict[str, Any] = {
    **{"adjustment": "3D", "linear": "Meters", "angular": "DMS", "order": "NE"},
    **{"stations": "AtFromTo", "distances": "slope", "refraction": 0.07, "azimuth": 5.0},
    **{"distance": 0.002, "distance_ppm": 2.0, "weight_levels_by": "length"},
    **{"centring_instrument": 0.001, "centring_target": 0.001, "longitude": "west positive"},
    "centring_vertical": 0.001,
}
KINDS_OF_GRID = ("azimuth", "horizontal_distance", "ellipsoid_distance")
"""Kinds that .GRID and .MEASURE concern."""
GRID = "EPSG:25832"
UTM = GRIDS["UTM 32"]
N = 46.5
PLACES = {"A": (48.0, 11.5, 560.0), "B": (48.01, 11.52, 575.0), "P": (48.004, 11.507, 591.4)}
"""Latitude, longitude east (degrees) and ellipsoidal height (m)."""


def xyz(name: str) -> np.ndarray:
    latitude, longitude, height = PLACES[name]
    place = (np.radians([latitude]), np.radians([longitude]), np.array([height]))
    return ellipsoid("GRS80").to_cartesian(*place)[0]


def grid(name: str) -> np.ndarray:
    latitude, longitude, height = PLACES[name]
    plan = UTM.to_grid(np.radians(np.array([latitude])), np.radians(np.array([longitude])))
    return np.array([*np.ravel(plan), height - N])


def dms(degrees: float) -> str:
    seconds = round(abs(degrees) * 3600, 6)
    d, m = int(seconds // 3600), int(seconds % 3600 // 60)
    return f"{'-' if degrees < 0 else ''}{d}-{m:02d}-{seconds - 3600 * d - 60 * m:09.6f}"


def line_of(code: str, name: str, errors: str = "") -> str:
    latitude, longitude, height = PLACES[name]
    east, north, elevation = grid(name)
    up = height if code.endswith("H") else elevation
    if code[0] == "P":
        return f"{code} {name} {dms(latitude)} {dms(-longitude)} {up:.6f} {errors}"
    return f"{code} {name} {north:.6f} {east:.6f} {up:.6f} {errors}"


def vector(a: str, b: str, *rest: str) -> str:
    value = " ".join(f"{v:.6f}" for v in xyz(b) - xyz(a))
    weights = rest or ("G2 4e-6 9e-6 1e-5", "G3 1e-6 -2e-6 3e-6")
    return "\n".join((f"G1 {a}-{b} {value}", *weights))


def read(folder: Path, text: str, *, changes: dict[str, Any] | None = None, **more: Any) -> Any:
    path = folder / "job.dat"
    path.write_text(text, encoding="utf-8")
    options = {**METRIC, **(changes or {})}
    return fga.read_star_net(path, options=options, **{"crs": GRID, "geoid": N, **more})


def problems(folder: Path, text: str, **more: Any) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, text, **more)
    return str(caught.value)


@pytest.mark.parametrize("codes", ["C C", "CH P", "P CH", "PH PH", "C PH"])
def test_points_of_every_data_type_are_the_same_places(tmp_path: Path, codes: str) -> None:
    a, b = codes.split()
    network = read(tmp_path, f"{line_of(a, 'A', '! ! !')}\n{line_of(b, 'B')}\n{vector('A', 'B')}")
    assert isinstance(network.frame, fga.TopocentricFrame) and network.points["A"].held == "xyz"
    for name in "AB":
        there = network.frame.to_geocentric(np.array([network.points[name].coordinates]))
        np.testing.assert_allclose(there[0], xyz(name), rtol=0, atol=1e-5)


def test_a_vector_network_is_adjusted_in_the_grid(tmp_path: Path) -> None:
    text = "\n".join([line_of("PH", "A", "! ! !"), vector("A", "P"), vector("A", "B"),
                      vector("B", "P")])  # fmt: skip
    solution = fga.adjust(read(tmp_path, text))
    assert solution.redundancy == 3 and solution.sigma0 < 1e-3
    coordinates = fga.grid_coordinates(solution)
    np.testing.assert_allclose(coordinates.point("P"), grid("P"), rtol=0, atol=1e-5)
    # Covariances of two ways, and the vector between them: weights add.
    c = np.array([[4e-6, 1e-6, -2e-6], [1e-6, 9e-6, 3e-6], [-2e-6, 3e-6, 1e-5]])
    k = solution.network.frame.axes_in_geocentric
    expected = k @ np.linalg.inv(np.linalg.inv(c) + np.linalg.inv(2 * c)) @ k.T
    np.testing.assert_allclose(solution.covariance("P"), expected, rtol=1e-6, atol=1e-14)


def test_standard_errors_and_correlations_are_covariances(tmp_path: Path) -> None:
    head = line_of("C", "A", "! ! !") + "\n"
    one = read(tmp_path, head + vector("A", "B", "G2 4e-6 9e-6 1.6e-5", "G3 1e-6 -2e-6 3e-6"))
    text = head + ".GPS WEIGHT STDERRCORRELATION\n" + vector(
        "A", "B", "G2 0.002 0.003 0.004", f"G3 {1 / 6} -0.25 0.25"
    )  # fmt: skip
    two = read(tmp_path, text)
    a, b = (next(iter(n.observations.values())).covariance for n in (one, two))
    np.testing.assert_allclose(a, b, rtol=1e-12)
    alone = head + ".GPS WEIGHT STDERRORS\n" + vector("A", "B", "G2 0.003 0.003 0.003")
    found = next(iter(read(tmp_path, alone).observations.values())).covariance
    np.testing.assert_allclose(found, 9e-6 * np.eye(3), rtol=0, atol=1e-18)


def test_factors_multiply_along_the_horizon_and_up(tmp_path: Path) -> None:
    head = line_of("C", "A", "! ! !") + "\n.GPS WEIGHT STDERRORS\n"
    text = head + ".GPS FACTOR 2 VERT 5\n" + vector("A", "B", "G2 0.003 0.003 0.003")
    network = read(tmp_path, text)
    o = next(iter(network.observations.values()))
    e = network.frame.basis(np.array([network.points["A"].coordinates]), np.zeros((1, 2))).enu[0]
    np.testing.assert_allclose(
        e @ o.covariance @ e.T, np.diag([4, 4, 25]) * 9e-6, rtol=1e-6, atol=1e-12
    )


def test_distances_directions_and_bearings_of_a_grid_are_not_those_of_a_plane(
    tmp_path: Path,
) -> None:
    """Measured distances stay; a bearing counts from grid north, here 1.86° east of true."""
    east, north, _ = grid("B") - grid("A")
    bearing = dms(np.degrees(np.arctan2(east, north)) % 360)
    distance = float(np.linalg.norm(xyz("B") - xyz("A")))
    text = "\n".join(
        [
            line_of("C", "A", "! ! !"),
            line_of("C", "B"),
            f"B A-B {bearing} 1",
            f"D A-B {distance:.6f} 0.002",
            f"L A-B {grid('B')[2] - grid('A')[2]:.6f} 9",
        ]
    )
    solution = fga.adjust(read(tmp_path, text, changes={"level": 0.001}))
    np.testing.assert_allclose(fga.grid_coordinates(solution).point("B"), grid("B"), atol=0.001)
    assert abs(np.hypot(east, north) - distance) > 0.1
    turned = read(tmp_path, text, azimuths="true", changes={"level": 0.001})
    difference = next(o for o in turned.observations.values() if o.kind == "azimuth").value
    grid_one = next(o for o in solution.network.observations.values() if o.kind == "azimuth").value
    assert np.degrees(grid_one - difference) == pytest.approx(1.86, abs=0.01)


def test_grid_and_measure_change_what_follows_as_the_options_change_all(tmp_path: Path) -> None:
    """Each of the lines behind an option is that of a file where it holds for all."""
    body = "B A-B 53-0-0 1\n.DELTA ON\nD A-B 1860.5 0.002\n.DELTA OFF\n"
    head = "\n".join([line_of("C", "A", "! ! !"), line_of("C", "B")]) + "\n"
    parts = (
        ("", {}),
        (".MEASURE BEAR DIST=ELLIP\n", {"azimuths": "true", "horizontal_distances": "ellipsoid"}),
        (".GRID AZIMUTHS DISTANCES\n", {"horizontal_distances": "grid"}),
        (".MEASURED DIST=GROUND\n", {}),
    )
    together = read(tmp_path, head + "".join(option + body for option, _ in parts))
    found = [(o.kind, o.value) for o in together.observations.values() if o.kind in KINDS_OF_GRID]
    expected = []
    for _, options in parts:
        network = read(tmp_path, head + body, **options)
        expected += [
            (o.kind, o.value) for o in network.observations.values() if o.kind in KINDS_OF_GRID
        ]
    assert found == expected
    assert len(set(expected[1::2])) == 3 and len(set(expected[::2])) == 2


def test_azimuths_at_points_without_coordinates_get_approximate_ones(tmp_path: Path) -> None:
    """B is on a polar sight from A; the azimuth there turns with the convergence at that place."""
    east, north, _ = grid("A") - grid("B")
    bearing = np.degrees(np.arctan2(east, north)) % 360
    distance = float(np.linalg.norm(xyz("B") - xyz("A")))
    up = grid("B")[2] - grid("A")[2]
    text = "\n".join(
        [
            line_of("C", "A", "! ! !"),
            f"E B {grid('B')[2]:.4f} !",
            f"B B-A {dms(bearing)} 1",
            f"D A-B {distance:.6f} 0.002",
        ]
    )
    assert abs(up) < distance
    solution = fga.adjust(read(tmp_path, text))
    np.testing.assert_allclose(fga.grid_coordinates(solution).point("B"), grid("B"), atol=0.001)


def test_refraction_of_a_grid_project_is_gauss_k(tmp_path: Path) -> None:
    text = "\n".join([line_of("C", "A", "! ! !"), line_of("C", "B"), "V A-B 89-30-00 3"])
    network = read(tmp_path, text)
    assert network.refractions[""].values[0] == pytest.approx(0.14)


def test_a_2d_project_lies_at_its_elevation(tmp_path: Path) -> None:
    a, b = grid("A"), grid("B")
    text = (f"C A {a[1]:.5f} {a[0]:.5f} ! !\nC B {b[1]:.5f} {b[0]:.5f}\nD A-B 1860.5\n"
            "B A-B 53-0-0")  # fmt: skip
    assert "elevation_of_project" in problems(tmp_path, text, changes={"adjustment": "2D"})
    changes = {"adjustment": "2D", "elevation_of_project": 520.0}
    solution = fga.adjust(read(tmp_path, text, changes=changes))
    assert fga.grid_coordinates(solution).point("B")[2] == pytest.approx(520.0, abs=1e-6)


def test_instruments_have_standard_errors_of_their_own(tmp_path: Path) -> None:
    text = "C A 1 2 3 ! ! !\nC B 9 9 3\n.INST total\nB A-B 10-0-0\n.INST\nB A-B 10-0-1\n.inst gone"
    instruments = {"TOTAL": {"azimuth": 2.0}}
    changes = {"instruments": instruments}
    path = tmp_path / "job.dat"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"job\.dat:7: \.INSTRUMENT gone.*stated: TOTAL"):
        fga.read_star_net(path, options={**METRIC, **changes})
    path.write_text(text.replace("\n.inst gone", ""), encoding="utf-8")
    network = fga.read_star_net(path, options={**METRIC, **changes})
    sigmas = [o.sigma for o in network.observations.values()]
    np.testing.assert_allclose(sigmas, np.array([2.0, METRIC["azimuth"]]) * ARCSEC)
    with pytest.raises(InputError, match="instrument 'TOTAL' has an unknown setting 'azimut'"):
        fga.StarNetOptions(instruments={"TOTAL": {"azimut": 2.0}})


def test_further_files_go_on_with_lines_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "more.gps").write_text(f"# one\n{vector('A', 'B')}\n", encoding="utf-8")
    network = read(tmp_path, line_of("C", "A", "! ! !"), files=[tmp_path / "more.gps"])
    assert next(iter(network.observations.values())).source == "more.gps:2"
    (tmp_path / "more.gps").write_text("# one\nG1 A-B 1 2\nX\n", encoding="utf-8")
    said = problems(tmp_path, "Y\n", files=[str(tmp_path / "more.gps")])
    for part in (
        "job.dat:1: data type 'Y' is unknown",
        "more.gps:2: G1 takes",
        "more.gps:3: data type 'X' is unknown",
    ):
        assert part in said


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("P A 95-0-0 11-0-0 1", "job.dat:1: latitudes are within 90"),
        ("P A 48-0-0 -11-0-0 1\nP A 48-0-1 -11-0-0 1", "another position in line 1"),
        ("P A 48-0-0 170-0-0 1 ! ! !", "job.dat:1: point 'A': is far outside of the area"),
        ("C B 1 1 1\nC A 500000 5400000 1 ! ! !", "job.dat:2: point 'A': is far outside"),
        ("EH A 500 !", "job.dat:1: an ellipsoidal height needs the plan coordinates"),
        ("G1 A-B 1 2 3", "job.dat:1: the vector has no G2 line"),
        ("G1 A-B 1 2 3\nG2 1 1 1", "has no G3 line, which COVARIANCE needs"),
        ("G1 A-B 1 2 3\nG2 1 1 1\nG3 2 0 0", "are no covariance"),
        (
            "G1 A-B 1 2 3\nG2 1 0 1\nG3 0 0 0",
            "job.dat:2: variance of G2 must be greater than zero, not 0",
        ),
        ("G2 1 1 1", "job.dat:1: G2 without G1"),
        ("G1 A-B 1 2 3\nG3 0 0 0", "job.dat:2: G3 follows G2"),
        (".GPS WEIGHT HEAVY", "valid: COVARIANCE, STDERRCORRELATION, STDERRORS"),
        (".GPS FACTOR -1", "factor of .GPS must be greater than zero, not -1"),
        (".GPS CENTERING 0.002", ".GPS CENTERING is not built: add the centring"),
        (".GPS WHAT", ".GPS WHAT is unknown"),
        (".LONGITUDE WHAT", ".LONGITUDE WHAT: valid: POS"),
        (".GRID ANGLES", ".GRID ANGLES: valid: BEARINGS, DISTANCES; directions and angles are as"),
        (".GRID", ".GRID takes BEARINGS or DISTANCES"),
        (".GRID DIST=GROUND", ".GRID DISTANCES=GROUND: valid without ="),
        (".MEASURE DIST=MOON", ".MEASURE DISTANCES=MOON: valid: DIST=GROUND, =ELLIPSOIDAL"),
        (".MEASURE BEAR=GRID", ".MEASURE BEARINGS=GRID: valid"),
        (".SCALE 0.9996", "inline option .SCALE belongs to local projects"),
        ("GT A 1 2", "data type GT is not built"),
    ],
)
def test_what_is_wrong_in_a_grid_project_is_told(tmp_path: Path, text: str, said: str) -> None:
    assert said in problems(tmp_path, text)


def test_what_a_reference_system_must_tell(tmp_path: Path) -> None:
    text = line_of("C", "A", "! ! !")
    assert "does not tell what heights are" in problems(tmp_path, text, geoid=None)
    assert "counts in US survey foot" in problems(tmp_path, text, crs="EPSG:2263")
    assert "has no grid coordinates" in problems(tmp_path, text, crs="EPSG:4326", geoid=0.0)
    assert "geoid= belongs to the reference system" in problems(tmp_path, text, crs=None)
    assert "a LEV project" in problems(tmp_path, text, changes={"adjustment": "LEV"})
    unsigned = {"longitude": None}
    said = problems(tmp_path, line_of("P", "A"), changes=unsigned)
    assert "job.dat:1: needs the setting 'longitude'" in said


EVERYTHING = "\n".join(
    [
        line_of("PH", "A", "! ! !"),
        line_of("C", "B", "0.01 0.02 0.03"),
        line_of("C", "P"),
        ".GPS FACTOR 2 VERT 3",
        vector("A", "P"),
        vector("B", "P"),
        "D A-P 711.9 0.01 1.5/1.6",
        "V A-P 87-30-00 5",
        "B A-P 49-0-0 5",
        "L A-P 31.401 0.7 0.01",
        "DB P\nDN A 10-0-0 3\nDN B 190-0-0 3\nDE",
        "A P-A-B 180-0-0 3",
    ]
)


def test_a_grid_project_comes_back_from_the_file_and_adjusts_alike(tmp_path: Path) -> None:
    network = read(tmp_path, EVERYTHING)
    out = tmp_path / "out.dat"
    fga.write_star_net(network, out)
    assert f"# grid: {network.crs.name}; elevations above: geoid (constant)" in out.read_text()
    again = fga.read_star_net(
        out, options={"adjustment": "3D", "linear": "Meters"}, crs=GRID, geoid=N
    )
    assert network.frame == again.frame
    for name in PLACES:
        np.testing.assert_allclose(
            network.points[name].coordinates, again.points[name].coordinates, atol=1e-8
        )
    one, two = fga.adjust(network), fga.adjust(again)
    assert one.redundancy == two.redundancy
    assert one.vtpv == pytest.approx(two.vtpv, rel=1e-6)
    np.testing.assert_allclose(one.point("P"), two.point("P"), rtol=0, atol=1e-7)
    np.testing.assert_allclose(one.covariance("P"), two.covariance("P"), rtol=1e-5)


def test_an_adjusted_grid_project_is_written_at_its_adjusted_coordinates(tmp_path: Path) -> None:
    text = "\n".join([line_of("PH", "A", "! ! !"), vector("A", "P"), vector("A", "P")])
    solution = fga.adjust(read(tmp_path, text))
    fga.write_star_net(solution.as_network(), tmp_path / "out.dat")
    line = next(s for s in (tmp_path / "out.dat").read_text().splitlines() if s[:4] == "C P ")
    np.testing.assert_allclose([float(v) for v in line.split()[2:5]], grid("P"), atol=1e-5)


def test_bearings_and_reduced_distances_are_written_as_they_were_read(tmp_path: Path) -> None:
    body = "B A-B 53-0-0 1\n.MEASURE DIST=ELLIP\n.DELTA ON\nD A-B 1860.5 0.002\n"
    network = read(tmp_path, line_of("C", "A", "! ! !") + "\n" + line_of("C", "B") + "\n" + body)
    fga.write_star_net(network, tmp_path / "out.dat")
    options = {"adjustment": "3D", "linear": "Meters"}
    again = fga.read_star_net(tmp_path / "out.dat", options=options, crs=GRID, geoid=N)
    assert [o.kind for o in again.observations.values()] == ["azimuth", "ellipsoid_distance"]
    for one, two in zip(network.observations.values(), again.observations.values(), strict=True):
        assert two.value == pytest.approx(one.value, abs=1e-9)


def test_points_of_a_grid_are_written_as_landxml_with_its_code(tmp_path: Path) -> None:
    network = read(tmp_path, EVERYTHING)
    network.add_point("no place")
    with pytest.raises(InputError, match="'no place': has no east and north"):
        fga.write_landxml(network, tmp_path / "a.xml", points_only=True)
    del network.points["no place"]
    fga.write_landxml(network, tmp_path / "a.xml", points_only=True)
    assert 'epsgCode="25832"' in (tmp_path / "a.xml").read_text()
    again = fga.read_landxml(tmp_path / "a.xml")
    for name in PLACES:
        np.testing.assert_allclose(again.points[name].coordinates, grid(name), atol=1e-5)


def test_what_a_grid_project_cannot_hold_is_refused_all_at_once(tmp_path: Path) -> None:
    network = read(tmp_path, EVERYTHING)
    network.add(fga.GnssVector("A", "B", (1, 2, 3), sigma=(1, 1, 1), target_height=1.5))
    network.add(fga.ControlPoint("P", network.points["P"].coordinates, axes="enu",
                                 covariance=[[4, 1, 0], [1, 4, 0], [0, 0, 4]]))  # fmt: skip
    with pytest.raises(InputError) as caught:
        fga.write_star_net(network, tmp_path / "no.dat")
    assert "correlated control" in str(caught.value)
    del network.observations[list(network.observations)[-1]]
    with pytest.raises(InputError, match="heights of antennas"):
        fga.write_star_net(network, tmp_path / "no.dat")
    plain = fga.Network("no grid", frame=fga.GeocentricFrame())
    with pytest.raises(InputError, match="or one with the reference system of a grid"):
        fga.write_star_net(plain, tmp_path / "no.dat")
    assert not (tmp_path / "no.dat").exists()


@pytest.mark.slow(
    "hundreds of damaged files are read or refused; short tests read and refuse single ones"
)
def test_200_damaged_grid_projects(tmp_path: Path) -> None:
    text = "\n".join([line_of("PH", "A", "! ! !"), line_of("CH", "B", "0.01 0.01 0.02"),
                      ".GPS WEIGHT COVARIANCE", ".GPS FACTOR 2 VERT 3", vector("A", "B"),
                      "G0 'two", vector("A", "P"), vector("B", "P"), "D A-P 700 0.01",
                      "B A-P 50-0-0 5"])  # fmt: skip
    rng = np.random.default_rng(22)
    small = [d for d in DAMAGES if d.__name__ not in ("long_line", "nest", "paths")]
    path, refused = tmp_path / "job.dat", 0
    for _ in range(200):
        path.write_bytes(small[int(rng.integers(len(small)))](rng, "job.dat", text.encode()))
        try:
            network = fga.read_star_net(path, options=METRIC, crs=GRID, geoid=N)
        except InputError as error:
            refused += 1
            assert all("job.dat" in str(p) for p in error.problems), str(error)
            continue
        assert all(np.isfinite(o.value).all() for o in network.observations.values())
    assert refused > 50
