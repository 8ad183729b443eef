"""What counts as a datum defect on the curved Earth: the same as on a plane."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import Frame, GeocentricFrame, LocalFrame
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    GnssPosition,
    GnssVector,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import disturb, measure

FRAMES: dict[str, tuple[Frame, tuple[float, float, float]]] = {
    "flat": (LocalFrame(), (0.0, 0.0, 0.0)),
    "curved": (LocalFrame(curvature=True), (0.0, 0.0, 0.0)),
    "geocentric": (GeocentricFrame(), (4.0e6, 8.0e5, 4.8e6)),
    "equator": (GeocentricFrame(), (6.378e6, 0.0, 0.0)),
}


def total_stations(
    frame: Frame,
    origin: tuple[float, float, float],
    size: float,
    azimuths: tuple[int, float] = (0, 1.0),
) -> fga.Network:
    """Return a free network of six stations that measure to each other; azimuths: number and σ."""
    rng = np.random.default_rng(3)
    network = fga.Network("total stations", frame=frame, datum="free")
    enu = frame.basis(np.array([origin]), np.zeros((1, 2))).enu[0]
    names = [f"P{i}" for i in range(6)]
    for name in names:
        offset = rng.uniform(-1.0, 1.0, 3) * [size, size, size / 10]
        network.add_point(name, np.array(origin) + enu.T @ offset)
        network.set_orientation(name, value=0.3)
    for a in names:
        for b in names:
            if a != b:
                network.add(
                    Direction(a, b, 0.0, sigma=1e-5),
                    ZenithAngle(a, b, 1.5, sigma=1e-5),
                    SlopeDistance(a, b, 1.0, sigma=0.001),
                )
    n, sigma = azimuths
    sights = [o for o in network.observations.values() if isinstance(o, Direction)]
    network.add(*(Azimuth(o.station, o.target, 0.0, sigma=sigma) for o in sights[:n]))
    return disturb(measure(network, seed=1), seed=1, points=0.01)


@pytest.mark.parametrize("size", [10.0, 1000.0, 50_000.0, 200_000.0])
@pytest.mark.parametrize("name", FRAMES)
def test_a_free_network_has_the_same_defects_in_every_frame(name: str, size: float) -> None:
    """Three shifts and the rotation about the vertical; σ as on the plane."""
    solution = fga.adjust(total_stations(*FRAMES[name], size))
    flat = fga.adjust(total_stations(*FRAMES["flat"], size))
    assert solution.converged
    assert solution.datum_defect == flat.datum_defect == 4
    ours, theirs = (
        np.sqrt(np.mean([np.sum(s.standard_deviations(p) ** 2) for p in s.network.points]))
        for s in (solution, flat)
    )
    assert ours == pytest.approx(theirs, rel=0.5)


@pytest.mark.parametrize("size", [5.0e3, 2.0e5])
def test_weak_positions_are_a_datum_beside_strong_vectors(size: float) -> None:
    """Two GNSS positions of 3 m tell where vectors of 3 mm are: all is as with a given datum."""
    rng = np.random.default_rng(3)
    origin = np.array([4.0e6, 8.0e5, 4.8e6])
    at = origin + rng.uniform(-size, size, (20, 3))
    network = fga.Network("vectors", frame=GeocentricFrame(), datum="free")
    for i, x in enumerate(at):
        network.add_point(f"P{i}", x + 20.0)
    for i in range(20):
        for j in range(i + 1, min(20, i + 4)):
            d = at[j] - at[i] + 0.003 * rng.normal(size=3)
            network.add(GnssVector(f"P{i}", f"P{j}", tuple(d), sigma=(0.003,) * 3))
    for i in range(2):
        x = at[i] + 3.0 * rng.normal(size=3)
        network.add(GnssPosition(f"P{i}", tuple(x), sigma=(3.0,) * 3))
    free, given = fga.adjust(network), fga.adjust(network, datum="given")
    assert free.converged and free.datum_defect == 0
    assert free.redundancy == given.redundancy
    assert free.vtpv == pytest.approx(given.vtpv, rel=1e-9)


@pytest.mark.parametrize(("n", "sigma"), [(1, 1e-3), (30, 1e-5)])
@pytest.mark.parametrize("size", [1000.0, 50_000.0])
@pytest.mark.parametrize("name", FRAMES)
def test_azimuths_tell_the_direction_as_on_the_plane_and_no_latitude(
    name: str, size: float, n: int, sigma: float
) -> None:
    """One of 3.4′ beside sights of 1e-5 counts; meridians that converge are no place."""
    found = []
    for frame in (name, "flat"):
        found.append(fga.adjust(total_stations(*FRAMES[frame], size, (n, sigma))))
    for solution in found:
        assert solution.converged
        assert solution.datum_defect == 3
    ours, theirs = (
        np.sqrt(np.mean([np.sum(s.standard_deviations(p) ** 2) for p in s.network.points]))
        for s in found
    )
    assert ours == pytest.approx(theirs, rel=0.5)
