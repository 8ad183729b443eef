"""Grid coordinates of other programs: IGN's aerial block in Lambert-93 with its geoid."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from tests.support.places import ROOT, data_dir

pytest.importorskip("pyproj", reason="the extra crs is not installed")
pytestmark = pytest.mark.published

HUNDREDTH_MM = 1e-5


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
