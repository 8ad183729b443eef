"""A field book in grid coordinates: the curvature of the Earth counts once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.units import GON

pytest.importorskip("pyproj", reason="the extra crs is not installed")

UNDULATION = 46.12
REFRACTION = 0.13
RADIUS = 6371000.0
HUNDREDTH_MM = 1e-5
CONTROL = {
    "A": (690000.0, 5340000.0, 520.0),
    "B": (691500.0, 5340300.0, 541.0),
    "C": (690700.0, 5341400.0, 533.0),
}
NEW = (690600.0, 5340700.0, 528.0)


def _book(path: Path, system: fga.ReferenceSystem) -> Path:
    """Write errorless sights from a free station in UTM, to 1e-8 gon and 1 µm, as a table."""
    places = np.array([NEW, *CONTROL.values()])
    phi, lam, h = system.to_geodetic(places)
    frame = fga.TopocentricFrame(phi[0], lam[0], h[0])  # its axes are those of the station
    sights = frame.from_geocentric(system.ellipsoid.to_cartesian(phi, lam, h))[1:]
    lines = ["target;direction;zenith;distance"]
    for name, (east, north, up) in zip(CONTROL, sights, strict=True):
        across, length = np.hypot(east, north), np.linalg.norm((east, north, up))
        beta = np.arctan2(up, across) + REFRACTION * across / (2.0 * RADIUS)
        reading = (np.arctan2(east, north) - 1.0) % (2.0 * np.pi)
        zenith = np.pi / 2.0 - beta
        lines.append(f"{name};{reading / GON:.9f};{zenith / GON:.9f};{length:.6f}")
    points = ["name;x;y;z;fixed"]
    points += [f"{n};{e};{k};{z};yes" for n, (e, k, z) in CONTROL.items()]
    path.joinpath("points.csv").write_text("\n".join(points), encoding="utf-8")
    path.joinpath("mapping.toml").write_text(
        '[units]\nangle = "gon"\n[points]\nfile = "points.csv"\nname = "name"\nx = "x"\ny = "y"\n'
        'z = "z"\nfixed = "fixed"\n[readings]\nstation = "=P"\ntarget = "target"\n'
        'direction = "direction"\nzenith = "zenith"\ndistance = "distance"\n',
        encoding="utf-8",
    )
    file = path / "book.csv"
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


@pytest.mark.parametrize("through_a_project", [False, True])
def test_heights_of_a_field_book_in_utm_are_right(tmp_path: Path, through_a_project: bool) -> None:
    """The reader states κ = k − 1 for its flat frame; the curved one gets κ = k, and σ̂0 is 0.

    With κ = k − 1 in the curved frame, P would be 6 cm too low over 0.9 km.
    """
    system = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
    network = fga.read(_book(tmp_path, system), mapping=tmp_path / "mapping.toml")
    assert network.refractions[""].values == (pytest.approx(REFRACTION - 1.0),)
    if through_a_project:
        fga.write_project(network, tmp_path / "project/project.toml")
        file = tmp_path / "project/project.toml"
        told = file.read_text(encoding="utf-8").replace(
            "[units]", f'[crs]\nsystem = "EPSG:25832"\ngeoid = {UNDULATION}\n\n[units]'
        )
        start, end = told.index("[frame]"), told.index("[crs]")
        file.write_text(told[:start] + told[end:], encoding="utf-8")
        moved = fga.read_project(file)
    else:
        moved = fga.from_grid(network, system)
    assert moved.refractions[""].values == (pytest.approx(REFRACTION),)
    assert moved.refractions[""].fixed == (True,)
    solution = fga.adjust(moved)
    np.testing.assert_allclose(
        fga.grid_coordinates(solution).point("P"), NEW, rtol=0, atol=HUNDREDTH_MM
    )
    assert solution.sigma0 < 1e-3


@pytest.mark.parametrize("kappa", [0.13, 0.0, -0.2])
def test_a_coefficient_without_curvature_is_kept(tmp_path: Path, kappa: float) -> None:
    """A project in a grid states k itself, since its frame is curved."""
    system = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
    network = fga.read(_book(tmp_path, system), mapping=tmp_path / "mapping.toml")
    network.set_refraction(value=kappa, fixed=True)
    assert fga.from_grid(network, system).refractions[""].values == (kappa,)


def test_another_zone_is_told_where_vectors_of_gnss_say_so() -> None:
    """Coordinates of zone 32 read in zone 33 are as far apart, and turned: only vectors tell."""
    right = fga.ReferenceSystem("EPSG:25832", geoid=UNDULATION)
    phi, lam, h = right.to_geodetic(np.array(list(CONTROL.values())))
    xyz = right.ellipsoid.to_cartesian(phi, lam, h)
    network = fga.Network("wrong zone")
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz" if name != "C" else "")
    for i, j in ((0, 1), (1, 2), (0, 2), (2, 0)):
        a, b = list(CONTROL)[i], list(CONTROL)[j]
        network.add(fga.GnssVector(a, b, tuple(xyz[j] - xyz[i]), sigma=(0.003,) * 3))
    for code, told in (("EPSG:25832", False), ("EPSG:25833", True)):
        system = fga.ReferenceSystem(code, geoid=UNDULATION)
        moved = fga.from_grid(network, system, vectors="geocentric")
        found = [str(f) for f in fga.preliminary(moved)]
        zone = f"or the coordinates are not those of {system.name}: look at its zone and datum"
        assert [zone in f for f in found] == [True] * told
