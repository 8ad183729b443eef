"""Grid coordinates of other programs: Comp3D in Lambert-93, IGN's aerial block with its geoid."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations.relations import CoordinateDifference
from tests.support.places import ROOT, data_dir

pytest.importorskip("pyproj", reason="the extra crs is not installed")
pytestmark = pytest.mark.published

HUNDREDTH_MM = 1e-5


def test_comp3d_in_lambert_93_from_its_grid_coordinates() -> None:
    """σ̂0 11.5456: the sides of the square are 115 mm per km longer than in the grid.

    Comp3D has σ of control in its computation frame, ours is in the grid: 1e-4 of 0.01 mm.
    """
    folder = data_dir("comp3d_frames") / "geo_mini_L93"
    text = (folder / "ex_ref.comp").read_text(encoding="utf-8", errors="replace")
    theirs = json.loads(text[text.index("{") :])
    network = fga.Network("geo_mini_L93")
    for line in (folder / "coord.cor").read_text(encoding="utf-8").splitlines():
        words = line.split("*")[0].split()
        if words:
            network.add_point(words[1], [float(w) for w in words[2:5]], sigma=1e-5)
    network.add_point("E", network.points["A"].coordinates)
    for a, b in zip("ABCD", "BCDA", strict=True):
        network.add(fga.SlopeDistance(a, b, 100.0, sigma=0.001))
    network.add(CoordinateDifference("A", "E", (0.0, 0.0, 0.0), sigma=0.001))
    system = fga.ReferenceSystem("EPSG:2154", heights="ellipsoidal")
    solution = fga.adjust(fga.from_grid(network, system))
    computation = theirs["computation"]
    assert (solution.n_observations, solution.n_unknowns) == (19, 15)
    assert computation["sigma_0_final"] == pytest.approx(11.5456, abs=5e-5)
    assert solution.sigma0 == pytest.approx(computation["sigma_0_final"], rel=2e-4)
    found = fga.grid_coordinates(solution)
    for name, point in theirs["points"].items():
        expected = point["coord_compensated_georef"]
        np.testing.assert_allclose(found.point(name), expected, rtol=0, atol=1e-7)


def test_photos_of_ign_from_lambert_93_and_altitudes_are_those_of_its_own_formulas() -> None:
    """E, N, altitude, ω φ κ → topocentric: projection, convergence, verticals and geoid.

    The loader has IGN's formulas of the projection and interpolates RAF20 itself.
    """
    pytest.importorskip("PIL")
    from tests.loaders.borea import read_borea

    folder = data_dir("borea")
    block = read_borea(folder, projection_scale=False)
    network = fga.Network("IGN")
    network.add_camera("c", NoDistortion(), {"c": 100.0})
    for line in (folder / "23FD1305_alt_2.OPK").read_text().splitlines():
        words = line.split()
        if words and words[0] in block.photos:
            numbers = [float(w) for w in words[1:7]]
            network.add_photo(
                words[0], "c", position=numbers[:3], omega_phi_kappa=np.radians(numbers[3:])
            )
    network.add_point("P", network.photos[next(iter(network.photos))].position)
    system = fga.ReferenceSystem("EPSG:2154", geoid=str(folder / "fr_ign_RAF20.tif"))
    made = fga.from_grid(network, system, frame=block.frame)
    assert len(made.photos) == 68
    for name, expected in block.photos.items():
        photo = made.photos[name]
        np.testing.assert_allclose(photo.position, expected.position, rtol=0, atol=HUNDREDTH_MM)
        np.testing.assert_allclose(photo.rotation, expected.rotation, rtol=0, atol=1e-9)


OWN_GEOID = """
import sys
import numpy as np, pyproj
import factorgraph_adj as fga
system = fga.ReferenceSystem("EPSG:9794+5720")
try:
    system.checked()
except fga.InputError as error:
    assert "fr_ign_RAF20.tif" in str(error), error
pyproj.datadir.append_data_dir(sys.argv[1])
own = fga.ReferenceSystem("EPSG:9794+5720")
stated = fga.ReferenceSystem("EPSG:9794", geoid="fr_ign_RAF20.tif")
grid = np.array([[657723.0, 6860710.0, 100.0], [900000.0, 6500000.0, 1200.0]])
for a, b in zip(own.to_geodetic(grid), stated.to_geodetic(grid)):
    assert np.abs(a - b).max() < 1e-6, (a, b)
phi, lam, h = own.to_geodetic(grid)
assert np.abs(own.from_geodetic(phi, lam, h) - grid).max() < 1e-5
one, two = own.geoid_at(phi, lam), stated.geoid_at(phi, lam)
assert np.abs(one.undulation - two.undulation).max() < 1e-5
assert np.abs(one.xi - two.xi).max() < 1e-9 and np.abs(one.eta - two.eta).max() < 1e-9
"""


def test_the_vertical_system_of_a_code_takes_the_geoid_that_proj_has() -> None:
    """NGF-IGN69 with RAF20 in a folder of PROJ: the same as the file by its name, or its path."""
    ran = subprocess.run(
        [sys.executable, "-c", OWN_GEOID, str(data_dir("borea"))],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert ran.returncode == 0, ran.stderr
