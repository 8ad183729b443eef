"""Commands with coordinates of a grid: a field book in UTM, simulated by formulas of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.cli.command_line import main
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.units import GON
from tests.networks.grids import GRIDS

pytest.importorskip("pyproj", reason="the extra crs is not installed")

UTM = GRIDS["UTM 32"]
N, K = 46.5, 0.13
PLACES = {
    "A": (48.0, 11.5, 560.0),
    "B": (48.008, 11.512, 640.0),
    "C": (48.011, 11.494, 575.0),
    "P": (48.006, 11.503, 700.0),
}
"""Latitude, longitude (degrees), ellipsoidal height (m)."""
MAPPING = """[points]
file = "points.csv"
name = "name"
x = "E"
y = "N"
z = "H"
fixed = "fixed"
[readings]
station = "from"
target = "to"
direction = "Hz"
zenith = "V"
distance = "S"
[units]
angle = "gon"
"""


def grid(name: str) -> np.ndarray:
    latitude, longitude, h = PLACES[name]
    plan = UTM.to_grid(np.radians(np.array([latitude])), np.radians(np.array([longitude])))
    return np.array([*np.ravel(plan), h - N])


def reading(a: str, b: str) -> tuple[float, float, float]:
    """Return direction (from true north + 50 gon), zenith angle and slope distance, gon and m."""
    globe = ellipsoid("GRS80")
    phi, lam = np.radians(PLACES[a][:2])
    xyz = [
        globe.to_cartesian(*np.radians([[p[0]], [p[1]]]), np.array([p[2]]))[0]
        for p in (PLACES[a], PLACES[b])
    ]
    sp, cp, sl, cl = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    enu = np.array([[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
    e, n, u = enu @ (xyz[1] - xyz[0])
    distance = float(np.sqrt(e * e + n * n + u * u))
    bent = np.arccos(u / distance) - K * np.hypot(e, n) / (2 * 6_371_000.0)
    return (np.arctan2(e, n) / GON + 50) % 400, bent / GON, distance


def field_book(folder: Path) -> Path:
    points = ["name,E,N,H,fixed"]
    for name in PLACES:
        east, north, height = grid(name) + (0.0 if name in "AB" else [0.4, -0.3, 0.2])
        points.append(f"{name},{east:.5f},{north:.5f},{height:.5f},{'yes' if name in 'AB' else ''}")
    (folder / "points.csv").write_text("\n".join(points) + "\n", encoding="utf-8")
    rows = ["from,to,Hz,V,S"]
    for a in "ABC":
        for b in PLACES:
            if a != b:
                rows.append(f"{a},{b}," + ",".join(f"{v:.6f}" for v in reading(a, b)))
    (folder / "mapping.toml").write_text(MAPPING, encoding="utf-8")
    (folder / "survey.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder / "survey.csv"


def run(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def test_a_field_book_in_utm_is_converted_and_adjusted_from_the_command_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    book, out = field_book(tmp_path), tmp_path / "site" / "project.toml"
    mapping = f"mapping={tmp_path / 'mapping.toml'}"
    in_utm = ("--set", mapping, "--crs", "EPSG:25832", "--geoid", N)
    assert run("convert", book, out, *in_utm) == 0
    network = fga.read(out)
    assert isinstance(network.frame, fga.TopocentricFrame)
    assert network.refractions[""].values[0] == pytest.approx(K)
    solution = fga.adjust(network)
    assert solution.sigma0 < 0.01  # micrometres, of readings with σ of millimetres
    found = fga.grid_coordinates(solution)
    for name in PLACES:
        np.testing.assert_allclose(found.point(name), grid(name), rtol=0, atol=1e-4)
    # Readings without errors fit better than their σ say, which is a note and no doubt.
    assert run("adjust", book, *in_utm, "--full", "--out", tmp_path / "r") == 0
    said = capsys.readouterr().out
    assert "ETRS89 / UTM zone 32N" in said
    assert "easting" in (tmp_path / "r" / "points.csv").read_text().splitlines()[0]


def test_a_flat_adjustment_of_the_same_book_is_wrong(tmp_path: Path) -> None:
    book = field_book(tmp_path)
    flat = fga.adjust(fga.read_columns(book, mapping=tmp_path / "mapping.toml"))
    assert np.abs(flat.point("C") - grid("C")).max() > 0.05


def test_the_frame_may_be_geocentric(tmp_path: Path) -> None:
    book, out = field_book(tmp_path), tmp_path / "g" / "project.toml"
    mapping = f"mapping={tmp_path / 'mapping.toml'}"
    arguments = ("--crs", "EPSG:25832", "--geoid", N, "--frame", "geocentric")
    assert run("convert", book, out, "--set", mapping, *arguments) == 0
    again = fga.read(out)
    height = np.array([PLACES["A"][2]])
    xyz = ellipsoid("GRS80").to_cartesian(*np.radians([[48.0], [11.5]]), height)
    np.testing.assert_allclose(again.points["A"].coordinates, xyz[0], rtol=0, atol=1e-4)
    found = fga.grid_coordinates(fga.adjust(again))
    np.testing.assert_allclose(found.point("P"), grid("P"), rtol=0, atol=1e-4)


def test_a_network_on_the_earth_gets_the_system_of_its_results(tmp_path: Path) -> None:
    network = fga.Network("gnss", frame=fga.GeocentricFrame())
    xyz = ellipsoid("GRS80").to_cartesian(*np.radians([[48.0], [11.5]]), np.array([560.0]))[0]
    network.add_point("A", xyz, fixed="xyz")
    network.add_point("B")
    network.add(fga.GnssVector("A", "B", (10.0, 20.0, 5.0), sigma=(0.01,) * 3))
    fga.write_project(network, tmp_path / "g" / "project.toml")
    out = tmp_path / "o" / "project.toml"
    assert run("convert", tmp_path / "g", out, "--crs", "EPSG:25832", "--geoid", N) == 0
    coordinates = fga.grid_coordinates(fga.adjust(fga.read(out)))
    np.testing.assert_allclose(coordinates.point("A"), grid("A"), rtol=0, atol=1e-5)


def test_readers_of_grids_take_the_system_themselves(tmp_path: Path) -> None:
    east, north, height = grid("A")
    (tmp_path / "a.gps").write_text(
        f"C A {north:.5f} {east:.5f} {height:.5f} ! ! !\n"
        "G1 A-B 10 20 5\nG2 1e-6 1e-6 1e-6\nG3 0 0 0\n",
        encoding="utf-8",
    )
    (tmp_path / "a.toml").write_text(
        'adjustment = "3D"\nlinear = "Meters"\norder = "NE"\n', encoding="utf-8"
    )
    settings = ("--set", f"options={tmp_path / 'a.toml'}", "--crs", "EPSG:25832")
    out = tmp_path / "o" / "project.toml"
    assert run("convert", tmp_path / "a.gps", out, *settings, "--geoid", N) == 0
    assert fga.read(out).crs is not None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--geoid", "46"), "--geoid: state the reference system too, --crs"),
        (("--crs", "EPSG:25832"), "does not tell what heights are"),
        (("--crs", "EPSG:0", "--geoid", "46"), "unknown reference system 'EPSG:0'"),
        (("--crs", "EPSG:25832", "--geoid", "none.gtx"), "no such file of a geoid"),
        (("--crs", "EPSG:25832", "--geoid", "46", "--grid", "azimuth=true"), "'azimuth'"),
        (("--crs", "EPSG:25832", "--geoid", "46", "--grid", "crs=1"), "no option 'crs'"),
        (("--crs", "EPSG:25832", "--geoid", "46", "--grid", "azimuths=x"), "unknown azimuths"),
    ],
)
def test_what_is_missing_or_wrong_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    book, out = field_book(tmp_path), tmp_path / "site" / "project.toml"
    mapping = f"mapping={tmp_path / 'mapping.toml'}"
    assert run("convert", book, out, "--set", mapping, *arguments) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_a_project_that_states_its_system_takes_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    book, out = field_book(tmp_path), tmp_path / "site" / "project.toml"
    in_utm = ("--crs", "EPSG:25832", "--geoid", N)
    assert run("convert", book, out, "--set", f"mapping={tmp_path / 'mapping.toml'}", *in_utm) == 0
    assert run("convert", out, tmp_path / "x.toml", *in_utm) == 2
    assert "states its reference system itself" in capsys.readouterr().err
    assert run("convert", book, out, "--frame", "geocentric") == 2
