"""GNSS in a datum of its own: a similarity with given, weighted or unknown parameters."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.units import ARCSEC

SIGMA = 0.003
TURN = np.array([1.2, -0.8, 2.1]) * ARCSEC
"""Rotation vector of the GNSS datum in the old one."""
PPM = 4.0
PLACES = np.radians([[48.0, 11.5], [48.1, 11.7], [48.05, 11.35], [47.9, 11.6], [48.02, 11.55]])
HEIGHTS = np.array([520.0, 710.0, 640.0, 580.0, 900.0])
NAMES = ("A", "B", "C", "D", "P")
PAIRS = ("AP", "BP", "CP", "DP", "AB", "BC", "CD", "DA", "AC")
FRAME = fga.TopocentricFrame(*PLACES[4], 0.0)


def truth() -> np.ndarray:
    xyz = ellipsoid("GRS80").to_cartesian(PLACES[:, 0], PLACES[:, 1], HEIGHTS)
    return FRAME.from_geocentric(xyz)


def vectors(seed: int = 3) -> dict[str, np.ndarray]:
    """Return measured vectors in the datum of GNSS, its axes parallel to the frame but for TURN."""
    rng, xyz = np.random.default_rng(seed), dict(zip(NAMES, truth(), strict=True))
    into = np.exp(-PPM * 1e-6) * exp_rotation(TURN[None])[0].T
    return {p: into @ (xyz[p[1]] - xyz[p[0]]) + rng.normal(0, SIGMA, 3) for p in PAIRS}


def old_control() -> fga.Network:
    network = fga.Network("old control", frame=FRAME)
    for name, at in zip(NAMES[:4], truth(), strict=False):
        network.add_point(name, at, fixed="xyz")
    network.add_point("P")
    return network


def in_frame(network: fga.Network) -> fga.Network:
    for (a, b), d in vectors().items():
        network.add(fga.FrameVector("GNSS", a, b, tuple(d.tolist()), sigma=(SIGMA,) * 3))
    return network


def test_unknown_rotation_and_scale_are_found_and_points_are_right() -> None:
    network = old_control()
    network.add_frame("GNSS", free=("rotation", "scale"), values={"rx": 0.0, "ry": 0.0, "rz": 0.0})
    solution = fga.adjust(in_frame(network))
    assert solution.redundancy == 27 - 3 - 4
    assert 0.6 < solution.sigma0 < 1.5
    found = solution.unknown("frame", "GNSS")
    error = np.array(found.values)[[0, 1, 2, 6]] - [*TURN, PPM * 1e-6]
    assert np.all(np.abs(error) < 4 * np.array(found.sigmas)[[0, 1, 2, 6]])
    assert np.all(np.array(found.sigmas)[:3] < 0.1 * ARCSEC)
    assert np.abs(solution.point("P") - truth()[4]).max() < 4 * SIGMA


def test_vectors_that_are_taken_as_in_the_datum_of_control_do_not_fit() -> None:
    """1 ppm and 0.2″ are a millimetre in a kilometre: 20 km from control to control."""
    network = old_control()
    for (a, b), d in vectors().items():
        network.add(fga.GnssVector(a, b, tuple(d.tolist()), sigma=(SIGMA,) * 3))
    assert fga.adjust(network).sigma0 > 10.0


def test_held_parameters_are_the_vectors_in_the_datum_of_control() -> None:
    held, plain = old_control(), old_control()
    values = dict(zip(("rx", "ry", "rz"), TURN.tolist(), strict=True))
    held.add_frame("GNSS", free=(), values={**values, "ln_scale": PPM * 1e-6})
    back = np.exp(PPM * 1e-6) * exp_rotation(TURN[None])[0]
    for (a, b), d in vectors().items():
        sigma = (SIGMA * float(np.exp(PPM * 1e-6)),) * 3
        plain.add(fga.GnssVector(a, b, tuple((back @ d).tolist()), sigma=sigma))
    one, two = fga.adjust(in_frame(held)), fga.adjust(plain)
    np.testing.assert_allclose(one.point("P"), two.point("P"), rtol=0, atol=1e-8)
    assert one.vtpv == pytest.approx(two.vtpv, rel=1e-6)
    np.testing.assert_allclose(one.covariance("P"), two.covariance("P"), rtol=1e-6, atol=1e-18)


def test_weighted_parameters_lie_between_held_and_unknown_ones() -> None:
    def rotation_sigma(**stated: object) -> float:
        network = old_control()
        network.add_frame("GNSS", values={"rx": 0, "ry": 0, "rz": 0}, **stated)  # type: ignore[arg-type]
        return float(fga.adjust(in_frame(network)).unknown("frame", "GNSS").sigmas[2])

    free = rotation_sigma(free=("rotation", "scale"))
    prior = 0.5 * free
    weighted = rotation_sigma(free=("scale",), sigma=dict.fromkeys(("rx", "ry", "rz"), prior))
    assert weighted == pytest.approx((free**-2 + prior**-2) ** -0.5, rel=0.02)


def test_a_geocentric_network_finds_the_same_similarity() -> None:
    """Axes of the Earth: the offset of 6000 km to its centre has no part in vectors."""
    frame = fga.GeocentricFrame()
    network = fga.Network("geocentric", frame=frame)
    xyz = ellipsoid("GRS80").to_cartesian(PLACES[:, 0], PLACES[:, 1], HEIGHTS)
    for name, at in zip(NAMES[:4], xyz, strict=False):
        network.add_point(name, at, fixed="xyz")
    network.add_point("P")
    network.add_frame("GNSS", free=("rotation", "scale"), values={"rx": 0.0, "ry": 0.0, "rz": 0.0})
    k = FRAME.axes_in_geocentric.T
    for (a, b), d in vectors().items():
        network.add(fga.FrameVector("GNSS", a, b, tuple((k @ d).tolist()), sigma=(SIGMA,) * 3))
    solution = fga.adjust(network)
    found = np.array(solution.unknown("frame", "GNSS").values)
    assert found[6] == pytest.approx(PPM * 1e-6, abs=1e-6)
    np.testing.assert_allclose(found[:3], k @ TURN, rtol=0, atol=0.3 * ARCSEC)
    assert np.abs(solution.point("P") - xyz[4]).max() < 4 * SIGMA


def test_vectors_of_a_network_get_a_datum_of_their_own() -> None:
    """With their ids, covariances and sources; the result is that of vectors stated in a frame."""
    network, stated = old_control(), old_control()
    stated.add_frame("GNSS", free=("rotation", "scale"), values={"rx": 0.0, "ry": 0.0, "rz": 0.0})
    for (a, b), d in vectors().items():
        network.add(fga.GnssVector(a, b, tuple(d.tolist()), sigma=(SIGMA,) * 3, source="a.gvx:1"))
    moved = fga.vectors_in_own_datum(network)
    assert list(moved.observations) == list(network.observations)
    assert {o.source for o in moved.observations.values()} == {"a.gvx:1"}  # type: ignore[attr-defined]
    one, two = fga.adjust(moved), fga.adjust(in_frame(stated))
    assert one.vtpv == pytest.approx(two.vtpv, rel=1e-9)
    assert fga.adjust(network).sigma0 > 10.0 > one.sigma0


def test_what_has_no_datum_of_its_own_is_told() -> None:
    network = old_control()
    with pytest.raises(fga.InputError, match="has no GNSS vectors"):
        fga.vectors_in_own_datum(network)
    network.add(fga.GnssVector("A", "P", (1, 2, 3), sigma=(1, 1, 1), target_height=1.5))
    with pytest.raises(fga.InputError, match="has heights of antennas"):
        fga.vectors_in_own_datum(network)
    with pytest.raises(fga.InputError, match="there is no GNSS vector 'x'; known: 1"):
        fga.vectors_in_own_datum(network, ids=["x"])
    with pytest.raises(fga.AdjustmentError, match="only vectors are observed in it"):
        free = old_control()
        free.add_frame("GNSS", free=("rotation", "scale"))
        fga.adjust(in_frame(free))


def test_a_frame_of_vectors_goes_with_a_network_from_a_grid() -> None:
    """A held offset beside free rotations, which count from axes of the grid, is converted."""
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    grid = fga.Network("UTM")
    places = ((686e3, 5319e3, 500.0), (688e3, 5319e3, 550.0), (686e3, 5322e3, 520.0))
    for name, at in zip("ABC", places, strict=True):
        grid.add_point(name, at, fixed="xyz")
    zero = {"rx": 0.0, "ry": 0.0, "rz": 0.0}
    grid.add_frame("local", free=("rotation", "scale"), values=zero, origin=places[0])
    for a, b in ("AB", "AC", "BC"):
        d = np.subtract(places["ABC".index(b)], places["ABC".index(a)])
        grid.add(fga.FrameVector("local", a, b, tuple(d.tolist()), sigma=(0.01,) * 3))
    system = fga.ReferenceSystem("EPSG:25832", geoid=46.0)
    found = fga.adjust(fga.from_grid(grid, system)).unknown("frame", "local")
    # The axes of the grid, 1.85° west of north here, and its combined factor of 0.999936.
    assert np.degrees(np.array(found.values[:3])) == pytest.approx([0, 0, -1.85], abs=0.03)
    assert found.values[6] == pytest.approx(1 - 0.999936, abs=4e-6)
