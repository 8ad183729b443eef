"""Every writer: what it writes is read as the same network, and written again as the same files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.io.gnss import gvx, sinex
from factorgraph_adj.io.writers import WRITERS
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import (
    BodyVector,
    Correlated,
    GnssPosition,
    GnssVector,
    RelativePosition,
    RelativeRotation,
)
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation, log_rotation
from tests.networks.pixel_block import pixel_block
from tests.networks.small_block import small_block
from tests.networks.surveyed import surveyed

TENTH_MICROMETRE = 1e-7


def vectors() -> fga.Network:
    """Geocentric points and vectors with covariances, alone and in a session, seed 6."""
    places = {"A": (4.0e6, 1.0e6, 4.85e6), "B": (4.0001e6, 1.0002e6, 4.85e6)}
    places |= {"C": (4.0e6, 1.0003e6, 4.8499e6)}
    network, rng = fga.Network("vectors", frame=fga.GeocentricFrame()), np.random.default_rng(6)
    for name, at in places.items():
        network.add_point(name, at)
    one = np.array([[4e-6, 1e-6, 0], [1e-6, 4e-6, 2e-6], [0, 2e-6, 9e-6]])

    def vector(a: str, b: str, **more: Any) -> GnssVector:
        value = np.subtract(places[b], places[a]) + 0.002 * rng.normal(size=3)
        return GnssVector(a, b, tuple(value.tolist()), covariance=one, **more)

    network.add(vector("A", "B"))
    joint = np.kron([[1.0, 0.4], [0.4, 1.0]], one)
    network.add(Correlated((vector("A", "C", id="one"), vector("B", "C", id="two")), joint))
    return network


def held_vectors() -> fga.Network:
    """The vectors with a station that is held."""
    network = vectors()
    network.points["A"] = fga.Point("A", network.points["A"].coordinates, (True, True, True))
    return network


def positions() -> fga.Network:
    """Geocentric positions with a joint covariance."""
    network = fga.Network("positions", frame=fga.GeocentricFrame())
    places = {"AAAA": (4.0e6, 1.0e6, 4.85e6), "BBBB": (4.0001e6, 1.0002e6, 4.85e6)}
    for name, at in places.items():
        network.add_point(name, at)
    joint = np.kron([[1.0, 0.3], [0.3, 1.0]], np.diag([4e-6, 4e-6, 9e-6]))
    one = joint[:3, :3]
    network.add(
        Correlated([GnssPosition(n, at, covariance=one) for n, at in places.items()], joint)
    )
    return network


def pose_graph() -> fga.Network:
    """A body that goes around a mast, with edges of full covariances, seed 8."""
    rng = np.random.default_rng(8)
    network = fga.Network("around")
    network.add_camera("body", NoDistortion(), {"c": 1.0})
    turns = [exp_rotation(np.array([0.1 * k, -0.05 * k, 1.2 * k])) for k in range(4)]
    places = [np.array([3.0 * np.cos(k), 3.0 * np.sin(k), 0.1 * k]) for k in range(4)]
    for k, (turn, place) in enumerate(zip(turns, places, strict=True)):
        network.add_photo(
            str(k), "body", position=place, rotation=turn @ TURN_ABOUT_X, fixed=k == 0
        )
    mast = np.array([0.2, 0.1, 1.5])
    network.add_point("L7", tuple(mast))
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        root = 0.02 * np.eye(6) + np.tril(rng.normal(0.0, 0.005, (6, 6)))
        value = turns[i].T @ (places[j] - places[i]) + rng.normal(0.0, 0.02, 3)
        turn = log_rotation((turns[i].T @ turns[j])[None])[0] + rng.normal(0.0, 0.01, 3)
        step = RelativePosition(str(i), str(j), tuple(value), sigma=(0.02,) * 3)
        rotation = RelativeRotation(str(i), str(j), tuple(turn), sigma=(0.02,) * 3)
        network.add(Correlated((step, rotation), root @ root.T))
        seen = turns[i].T @ (mast - places[i]) + rng.normal(0.0, 0.02, 3)
        network.add(BodyVector(str(i), "L7", tuple(seen), covariance=root[:3, :3] @ root[:3, :3].T))
    return network


def trajectory() -> fga.Network:
    """Poses of a pose graph, named by their times."""
    network = fga.Network("path")
    network.add_camera("body", NoDistortion(), {"c": 1.0})
    for name, photo in pose_graph().photos.items():
        at = photo.position
        assert at is not None
        network.add_photo(f"1403636579.{name}5", "body", position=at, rotation=photo.rotation)
    return network


def scaled(affine: bool = False) -> fga.Network:
    """Photos with control, a scale bar, projection centres, and all of the camera unknown."""
    return pixel_block(affine=affine, free=("c", "x0", "y0", "k1", "k2", "k3", "p1", "p2"))


@dataclass(frozen=True)
class Trip:
    """A network that a format can express, and how it is written and read."""

    network: Callable[[], fga.Network]
    file: str
    """Name of the file, or of the folder."""
    read: Mapping[str, Any] = field(default_factory=dict)
    """Options of the reader."""
    write: Mapping[str, Any] = field(default_factory=dict)
    """Options of the writer."""
    keeps: str = "everything"
    """What the format keeps: "everything", "photos" (and points that they see), "points",
    "cameras"."""
    approximate: bool = False
    """Whether approximate coordinates of points are no part of the format."""
    held: str = ""
    """Point to hold before the adjustment, where the format holds none."""


STAR_NET = {"adjustment": "3D", "linear": "Meters", "weight_levels_by": "length"}
TRIPS = {
    "project": Trip(small_block, "block.toml"),
    "opf": Trip(scaled, "block.opf", approximate=True),
    "metashape": Trip(lambda: scaled(affine=True), "block.xml", approximate=True),
    "colmap": Trip(scaled, "model", write={"files": "text"}, keeps="photos"),
    "opencv": Trip(scaled, "camera.yml", keeps="cameras"),
    "star-net": Trip(surveyed, "job.dat", {"options": STAR_NET}),
    "jag3d": Trip(surveyed, "flat"),
    "landxml": Trip(surveyed, "points.xml", write={"points_only": True}, keeps="points"),
    "sinex": Trip(positions, "two.snx"),
    "dynaml": Trip(held_vectors, "network.xml"),
    "g2o": Trip(pose_graph, "around.g2o"),
    "trajectory": Trip(trajectory, "path.tum", {"axes": "body"}, keeps="photos"),
    "gvx": Trip(
        vectors,
        "vectors.gvx",
        write={"reference_system_id": 126, "reference_system": "NAD 83(2011)"},
        held="A",
    ),
}


def counts(network: fga.Network) -> Counter[str]:
    """Return the number of observations of each kind."""
    found = Counter(o.kind for o in network.observations.values())
    found["image points"] = network.n_image_points
    return found


def adjusted(network: fga.Network, trip: Trip) -> fga.Solution:
    if trip.held:
        at = network.points[trip.held].coordinates
        network.points[trip.held] = fga.Point(trip.held, at, (True, True, True))
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    return solution


def contents(folder: Path) -> dict[str, bytes]:
    """Return all files of a folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


WORD = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|[^-+\d]+|.", re.DOTALL)


def assert_same_words(a: bytes, b: bytes) -> None:
    """Compare files: words to the letter, numbers to 12 digits, as units change."""
    one, two = WORD.findall(a), WORD.findall(b)
    assert len(one) == len(two)
    for x, y in zip(one, two, strict=True):
        if x != y:
            assert float(x) == pytest.approx(float(y), rel=1e-12, abs=1e-15), (x, y)


def there(network: fga.Network, folder: Path, name: str, trip: Trip) -> fga.Network:
    """Write a network in a folder of its own, and return what is read of it."""
    folder.mkdir()
    fga.write(network, folder / trip.file, format=name, **trip.write)
    return fga.read(folder / trip.file, **trip.read)


def test_every_writer_makes_the_trip() -> None:
    assert set(TRIPS) == {w.name for w in WRITERS.entries}


@pytest.mark.parametrize("name", TRIPS)
def test_what_is_written_is_read_as_the_same_network(name: str, tmp_path: Path) -> None:
    """The same counts, parameters of cameras and points, and the same adjustment."""
    trip = TRIPS[name]
    given = trip.network()
    found = there(given, tmp_path / "once", name, trip)
    if trip.keeps == "cameras":
        (a,), (b,) = given.cameras.values(), found.cameras.values()
        one = dict(zip(a.lens.names, a.values, strict=True))
        two = dict(zip(b.lens.names, b.values, strict=True))
        for parameter, value in one.items():
            assert two[parameter] == pytest.approx(value, rel=1e-12, abs=1e-15), parameter
        return
    if trip.keeps == "photos":
        assert counts(found)["image points"] == counts(given)["image points"]
        assert list(found.photos) == list(given.photos)
        for photo in given.photos.values():
            assert np.allclose(found.photos[photo.name].position, photo.position, atol=1e-9)
            assert np.allclose(found.photos[photo.name].rotation, photo.rotation, atol=1e-12)
        return
    for point in given.points.values():
        kept = found.points[point.name].coordinates
        if not trip.approximate:
            assert kept is not None and point.coordinates is not None
            assert np.allclose(kept, point.coordinates, rtol=0, atol=TENTH_MICROMETRE)
    if trip.keeps == "points":
        assert all(p.coordinates is not None for p in found.points.values())
        return
    assert counts(found) == counts(given)
    one, two = adjusted(given, trip), adjusted(found, trip)
    for figure in ("n_observations", "n_unknowns", "redundancy"):
        assert getattr(one, figure) == getattr(two, figure), figure
    assert two.vtpv == pytest.approx(one.vtpv, rel=1e-6, abs=1e-12)
    for point in given.points:
        assert np.abs(one.point(point) - two.point(point)).max() < TENTH_MICROMETRE
        assert np.allclose(one.covariance(point), two.covariance(point), rtol=1e-5, atol=1e-16)


class Noon(datetime):
    """A clock that stands still, as files of some formats state when they were written."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> Noon:
        return cls(2026, 6, 21, 12, tzinfo=tz)


@pytest.mark.parametrize("name", TRIPS)
def test_what_is_read_is_written_as_the_same_files(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing that a writer writes is lost by the reader: the third copy is the second."""
    for module in (gvx, sinex):
        monkeypatch.setattr(module, "datetime", Noon)
    trip = TRIPS[name]
    first = there(trip.network(), tmp_path / "once", name, trip)
    second = there(first, tmp_path / "twice", name, trip)
    there(second, tmp_path / "thrice", name, trip)
    files = contents(tmp_path / "thrice")
    assert files
    twice = contents(tmp_path / "twice")
    assert set(files) == set(twice)
    for file in files:
        assert_same_words(files[file], twice[file])
    assert set(files) == set(contents(tmp_path / "once"))
