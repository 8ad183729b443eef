"""How every test network arrives observation by observation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.ledger.command_input import Engine
from tests.networks import aicon, dbat
from tests.networks.adjusted import ADJUSTED
from tests.networks.gama import FOLDER, solved
from tests.support.arrivals import Moment, play
from tests.support.places import data_dir

ORDERS = (None, 1, 2, 3)
"""File order, and the seeds of random ones."""


@dataclass(frozen=True)
class Case:
    """How a network arrives."""

    make: Callable[[], fga.Network]
    by_photo: bool = False
    """All image points of a photo together."""
    moments: int = 5
    orders: tuple[int | None, ...] = ORDERS
    """All that are studied."""

    def play(
        self, order: int | None, moments: int, *, engine: Engine | None = None
    ) -> Iterator[Moment]:
        """Let it arrive."""
        return play(self.make(), order, moments=moments, by_photo=self.by_photo, engine=engine)


def some_photos(network: fga.Network, names: list[str], *, rays: int = 2) -> fga.Network:
    """Return a network of image points with some photos, and the points that ``rays`` of them see.

    Args:
        network: without other observations of points that go.
        names: of the photos that stay.
        rays: how many rays a point needs to stay.
    """
    out = fga.Network(network.name, frame=network.frame, datum=network.datum)
    chosen = set(names)
    used = {network.photos[n].camera for n in names}
    out.cameras = {n: c for n, c in network.cameras.items() if n in used}
    images = [o for o in network.image_points() if o.photo in chosen]
    count: dict[str, int] = {}
    for o in images:
        count[o.point] = count.get(o.point, 0) + 1
    for f in network.photos.values():
        if f.name in chosen:
            out.add_photo(f.name, f.camera, position=f.position, rotation=f.rotation, fixed=f.fixed)
    for p in network.points.values():
        if count.get(p.name, 0) >= rays:
            held = "".join(a for a, on in zip("xyz", p.fixed, strict=True) if on)
            out.add_point(p.name, p.coordinates, fixed=held, sigma=p.sigma, datum=p.datum)
    out.add(*(o for o in images if o.point in out.points))
    out.add(
        *(
            o
            for o in network.observations.values()
            if all(n in out.points for n in o.names())  # type: ignore[attr-defined]
        )
    )
    return out


def aicon_sample() -> fga.Network:
    """A tenth of the photos, at random; every one sees many of the 150 points."""
    network = aicon.read_aicon(data_dir("aicon_jaicov"))
    names = np.random.default_rng(5).permutation(list(network.photos))[:12]
    return some_photos(network, [str(n) for n in names], rays=3)


def roma_sample() -> fga.Network:
    """Neighbouring photos and every tenth of their points, as a free network."""
    network = dbat.read_roma(data_dir("dbat_roma"))
    network.datum = "free"
    network.photos = {n: replace(f, fixed=(False,) * 6) for n, f in network.photos.items()}
    network.points = {n: replace(p, fixed=(False,) * 3) for n, p in network.points.items()}
    return thinned(some_photos(network, list(network.photos)[:8], rays=3), 10)


def thinned(network: fga.Network, every: int) -> fga.Network:
    """Return the network with every so many of its free points."""
    free = [n for n, p in network.points.items() if not any(p.fixed)]
    gone = set(free) - set(free[::every])
    keep = [o for o in network.image_points() if o.point not in gone]
    out = network.copy()
    out.image_mask(np.zeros(network.n_image_points, dtype=bool))
    out.points = {n: p for n, p in network.points.items() if n not in gone}
    out.point_number = {n: i for i, n in enumerate(out.points)}
    out.add(*keep)
    return out


def gama(name: str) -> Callable[[], fga.Network]:
    return lambda: solved(name).network


LARGE: dict[str, Case] = {
    "AICON": Case(ADJUSTED["AICON"], by_photo=True, moments=4),
    "Roma": Case(ADJUSTED["Roma"], by_photo=True, moments=2),
    "Ladybug, a cut": Case(ADJUSTED["Ladybug, a cut"], by_photo=True, moments=3),
}


SAMPLES: dict[str, Case] = {
    "AICON, 12 photos": Case(aicon_sample, by_photo=True),
    "Roma, 8 photos": Case(roma_sample, by_photo=True),
}


PHOTOS = (
    "sxb",
    "sxb with camera positions",
    "camcal, model 3",
    "camcal, model 4",
    "camcal, model 1",
    "camcal, forward",
    "camcal, weighted",
    "camcal, free",
)
"""They arrive photo by photo."""


NETWORKS: dict[str, Callable[[], fga.Network]] = {**{n: gama(n) for n in FOLDER}, **ADJUSTED}


CASES: dict[str, Case] = {
    **{n: Case(make, by_photo=n in PHOTOS) for n, make in NETWORKS.items() if n not in LARGE},
    **SAMPLES,
    **LARGE,
}
