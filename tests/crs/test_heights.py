"""Heights above geoids: levelling, offsets, deflections, and damaged files of geoids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.crs.geoid import geoid
from factorgraph_adj.errors import AdjustmentError, InputError
from tests.networks.geoids import EAST, LATITUDE, LONGITUDE, NORTH, tilted, write_gtx, write_ntv2

pytest.importorskip("pyproj", reason="the extra crs is not installed")

PLACES = np.array([[48.0, 11.5], [48.05, 11.52], [47.97, 11.44], [48.02, 11.6]])
HUNDREDTH_MM = 1e-5
LONG_LINES = 5e-5
"""What ½ (u_i + u_j)·d differs from Δh over lines of 10 km, metres."""


def test_gtx_and_ntv2_in_both_byte_orders_have_the_same_geoid(tmp_path: Path) -> None:
    """N of a plane is exact in both, to what 4-byte floats have; west is not east."""
    phi, lam = np.radians(PLACES).T
    expected = [tilted(*p) for p in PLACES]
    files = [write_gtx(tmp_path / "a b.gtx")]
    files += [write_ntv2(tmp_path / f"{o}.gsb", order=c) for o, c in (("l", "<"), ("b", ">"))]
    degree = np.degrees(1.0) / 6_371_000.0
    for file in files:
        found = geoid(str(file)).at(phi, lam)
        np.testing.assert_allclose(found.undulation, expected, rtol=0, atol=5e-6)
        np.testing.assert_allclose(found.xi, -NORTH * degree, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.eta, -EAST * degree / np.cos(phi), rtol=0, atol=3e-8)


def test_a_table_of_points_has_undulations_and_deflections_by_name(tmp_path: Path) -> None:
    file = tmp_path / "geoid.csv"
    file.write_text("point,N,xi,eta\nA,46.1,1.5,-2\nB,46.2,1.6,-2.1\n", encoding="utf-8")
    system = fga.ReferenceSystem("EPSG:25832", geoid=str(file))
    _, _, h = system.to_geodetic(np.array([[7e5, 5.3e6, 500.0]] * 2), ["B", "A"])
    np.testing.assert_allclose(h, [546.2, 546.1], rtol=0, atol=1e-9)
    with pytest.raises(InputError, match=r"point 'C': has no row in .*geoid.csv"):
        system.to_geodetic(np.array([[7e5, 5.3e6, 500.0]]), ["C"])
    with pytest.raises(InputError, match="places have no names"):
        system.to_geodetic(np.array([[7e5, 5.3e6, 500.0]]))


def levelled(file: Path) -> tuple[fga.Network, fga.ReferenceSystem, np.ndarray]:
    """Return levelling lines of 5 km in the grid, held at A, and the true heights."""
    system = fga.ReferenceSystem("EPSG:25832", geoid=str(file))
    phi, lam = np.radians(PLACES).T
    true = np.array([500.0, 520.0, 480.0, 505.0])
    grid = system.from_geodetic(phi, lam, true + [tilted(*p) for p in PLACES])
    np.testing.assert_allclose(grid[:, 2], true, rtol=0, atol=1e-5)
    network = fga.Network("levelling")
    network.add_point("A", grid[0], fixed="xyz")
    for name, enh in zip("BCD", grid[1:], strict=True):
        network.add_point(name, [*enh[:2], enh[2] + 3.0], sigma=(0.01, 0.01, np.inf))
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        network.add(fga.HeightDifference("ABCD"[i], "ABCD"[j], true[j] - true[i], sigma=0.001))
    return network, system, true


@pytest.mark.parametrize("deflections", ["none", "held"])
@pytest.mark.parametrize("suffix", [".gtx", ".gsb"])
def test_levelling_gives_heights_above_the_geoid(
    tmp_path: Path, suffix: str, deflections: str
) -> None:
    """The geoid falls 0.25 m between these points; with its verticals or without, H is right."""
    write = write_gtx if suffix == ".gtx" else write_ntv2
    network, system, true = levelled(write(tmp_path / f"geoid{suffix}"))
    made = fga.from_grid(network, system, deflections=deflections)  # type: ignore[arg-type]
    solution = fga.adjust(made)
    found = fga.grid_coordinates(solution)
    np.testing.assert_allclose(found.coordinates[:, 2], true, rtol=0, atol=LONG_LINES)
    assert np.ptp(found.places.undulation) > 0.2
    assert solution.sigma0 < 0.05
    held = solution.network.of_kind("vertical")
    assert len(held) == (4 if deflections == "held" else 0)


def test_levelling_without_the_geoid_differs_by_the_undulations(tmp_path: Path) -> None:
    """A constant geoid leaves the height differences as they are: H is then above an ellipsoid."""
    network, _, true = levelled(write_gtx(tmp_path / "geoid.gtx"))
    constant = fga.ReferenceSystem("EPSG:25832", geoid=46.0)
    solution = fga.adjust(fga.from_grid(network, constant))
    found = fga.grid_coordinates(solution).coordinates[:, 2]
    np.testing.assert_allclose(found, true, rtol=0, atol=LONG_LINES)


def test_a_common_offset_of_the_geoid_is_found_from_gnss_and_levelled_heights() -> None:
    """By hand: w = mean of h − H − N over k points, σ² = (σ_h² + σ_H²)/k, with the prior."""
    offset, sigma_h, sigma_H, prior = 0.137, 0.02, 0.005, 0.1
    rng = np.random.default_rng(2)
    system = fga.ReferenceSystem("EPSG:25832", geoid=46.0)
    network = fga.Network("offset")
    k = 5
    at = np.column_stack([7e5 + 300.0 * np.arange(k), 5.3e6 + 200.0 * np.arange(k) ** 2, [5e2] * k])
    difference = []
    for i, enh in enumerate(at):
        h, gnss = rng.normal(0, sigma_H), offset + rng.normal(0, sigma_h)
        network.add_point(f"{i}", [*enh[:2], enh[2] + h], sigma=(np.inf, np.inf, sigma_H))
        given = (enh[0], enh[1], enh[2] + gnss)
        network.add(fga.GnssPosition(f"{i}", given, sigma=(0.01, 0.01, sigma_h)))
        difference.append(gnss - h)
    solution = fga.adjust(fga.from_grid(network, system, geoid_offset=prior))
    weights = k / (sigma_h**2 + sigma_H**2), 1.0 / prior**2
    found = solution.unknown("level", "geoid")
    expected = np.mean(difference) * weights[0] / sum(weights)
    assert found.values[0] == pytest.approx(expected, abs=1e-6)
    assert found.sigmas[0] == pytest.approx(sum(weights) ** -0.5, rel=1e-6)
    free = fga.adjust(fga.from_grid(network, system, geoid_offset=np.inf))
    assert free.unknown("level", "geoid").values[0] == pytest.approx(np.mean(difference), abs=1e-6)
    # Without it levelled and GNSS heights contradict one another.
    assert fga.adjust(fga.from_grid(network, system)).sigma0 > 3.0 * free.sigma0


def test_a_held_height_and_a_held_plan_are_held_to_their_hundredth_of_a_millimetre() -> None:
    """Held components of the grid are none of the frame, 20 km from its origin."""
    system = fga.ReferenceSystem("EPSG:25832", geoid=46.0)
    network = fga.Network("partly held")
    grid = {"A": (7e5, 5.30e6, 500.0), "B": (7.2e5, 5.32e6, 700.0), "C": (7.1e5, 5.33e6, 600.0)}
    network.add_point("A", grid["A"], fixed="xyz")
    network.add_point("B", grid["B"], fixed="z")
    network.add_point("C", (*grid["C"][:2], np.nan), fixed="xy")
    for name, enh in grid.items():
        network.add(fga.GnssPosition(name, tuple(np.add(enh, 0.3)), sigma=(0.1, 0.1, 0.1)))
    solution = fga.adjust(fga.from_grid(network, system))
    found = fga.grid_coordinates(solution)
    np.testing.assert_allclose(found.point("A"), grid["A"], rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.point("B")[2], 700.0, rtol=0, atol=HUNDREDTH_MM)
    np.testing.assert_allclose(found.point("B")[:2], [7.2e5 + 0.3, 5.32e6 + 0.3], atol=1e-4)
    np.testing.assert_allclose(found.point("C")[:2], grid["C"][:2], rtol=0, atol=HUNDREDTH_MM)
    assert found.point("C")[2] == pytest.approx(600.3, abs=1e-4)
    sigma = found.places.sigma
    assert sigma[1, 2] < 2e-5 < sigma[1, 0]


def test_weighted_deflections_are_those_of_the_geoid(tmp_path: Path) -> None:
    network, system, _ = levelled(write_ntv2(tmp_path / "geoid.gsb"))
    sigma = np.radians(1.0 / 3600.0)
    made = fga.from_grid(network, system, deflections=sigma)
    degree = np.degrees(1.0) / 6_371_000.0
    for name in "ABCD":
        stated = made.of_kind("vertical")[name]
        assert stated.values[0] == pytest.approx(-NORTH * degree, abs=1e-8)
        assert stated.sigma == (sigma, sigma)
    east = -EAST * degree / np.cos(np.radians(LATITUDE))
    assert made.of_kind("vertical")["A"].values[1] == pytest.approx(east, abs=1e-8)


# -- damaged files --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no points"),
        ("point,N\nA,x\n", "geoid.csv:2: not all of x are numbers"),
        ("point,H\nA,1\n", "columns must be point, N"),
        ("A,46\nA,47\n", "geoid.csv:2: duplicate point 'A'"),
        ("A,4600\n", "must be within"),
        ("A\n", "a row has point, N"),
    ],
)
def test_wrong_tables_are_refused_with_their_line(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "geoid.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        geoid(str(file))


def test_other_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file of a geoid"):
        geoid(str(tmp_path / "missing.gtx"))
    other = tmp_path / "geoid.xyz"
    other.write_text("1 2 3", encoding="utf-8")
    with pytest.raises(InputError, match=r"unknown kind of geoid file '\.xyz'; valid: \.gtx"):
        geoid(str(other))


@pytest.mark.parametrize("suffix", [".gtx", ".gsb", ".csv"])
def test_damaged_geoids_give_a_message_or_a_geoid(tmp_path: Path, suffix: str) -> None:
    """70 damaged files of each kind: cut, overwritten, or with bytes changed in the header."""
    whole = tmp_path / f"whole{suffix}"
    if suffix == ".csv":
        whole.write_text("point,N,xi,eta\nA,46.1,1.5,-2\nB,46.2,1.6,-2.1\n", encoding="utf-8")
    else:
        (write_gtx if suffix == ".gtx" else write_ntv2)(whole)
    data = whole.read_bytes()
    rng = np.random.default_rng(7)
    file = tmp_path / f"damaged{suffix}"
    for turn in range(70):
        damaged = bytearray(data)
        if turn % 3 == 0:
            damaged = damaged[: rng.integers(0, len(data))]
        else:
            end = min(len(data), 360) if turn % 3 == 1 else len(data)
            for at in rng.integers(0, end, 6):
                damaged[at] = rng.integers(0, 256)
        file.write_bytes(bytes(damaged))
        try:
            found = geoid(str(file)).at(np.radians([LATITUDE]), np.radians([LONGITUDE]), ["A"])
        except AdjustmentError as error:
            assert str(error)
        else:
            assert found.undulation.shape == (1,)
