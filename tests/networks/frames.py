"""Networks of frames of every sort, drawn by chance: models, tripods, levelled ones, plans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameCoordinate
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.types import Array
from tests.networks.every_kind import COVARIANCE, FRAMES

MILLIMETRE = 1e-3
SIDE, HEIGHT = 40.0, 12.0
"""Extent of the points in plan and in height, metres."""


@dataclass(frozen=True)
class Sort:
    """A sort of frames."""

    free: tuple[str, ...]
    """Free components."""
    at_point: bool = False
    """Whether the origin is a point."""
    level: bool = False
    """Whether its rotation counts from the horizon of its origin."""
    sigma: tuple[tuple[str, float], ...] = ()
    """Standard deviations of weighted components."""
    axes: str = "xyz"
    """Observed axes."""


_TURNS, _OFFSET = ("rx", "ry", "rz"), ("x", "y", "z")
SORTS = {
    "model": Sort((*_TURNS, *_OFFSET, "ln_scale")),
    "scan": Sort((*_TURNS, *_OFFSET)),
    "scan with a thermal scale": Sort((*_TURNS, *_OFFSET), sigma=(("ln_scale", 1e-5),)),
    "levelled model": Sort(("rz", *_OFFSET, "ln_scale"), level=True),
    "levelled scan": Sort(("rz", *_OFFSET), level=True),
    "nearly levelled scan": Sort(("rz", *_OFFSET), level=True, sigma=(("rx", 1e-4), ("ry", 1e-4))),
    "tripod": Sort(_TURNS, at_point=True),
    "levelled tripod": Sort(("rz",), at_point=True, level=True),
    "tripod without forced centring": Sort((*_TURNS, *_OFFSET), at_point=True),
    "plan": Sort(("rz", "x", "y", "ln_scale"), level=True, axes="xy"),
}
"""Frames by name, with seven components and fewer."""


def network_of_frames(
    seed: int,
    sorts: tuple[str, ...],
    *,
    frame_name: str = "flat",
    points: int = 7,
    coarse: float = 0.0,
) -> fga.Network:
    """Return points without datum, each observed in every frame; values of frames are not given.

    Args:
        seed: of everything drawn.
        sorts: names of `SORTS`, as often as a frame is wanted.
        frame_name: name of a frame of the network, see `every_kind`.
        points: number of points.
        coarse: standard deviation of approximate coordinates, metres.
    """
    rng = np.random.default_rng(seed)
    frame, place = FRAMES[frame_name]
    network = fga.Network("frames", frame=frame, datum="free")
    enu = frame.basis(place[None], np.zeros((1, 2))).enu[0]
    for i in range(points):
        at = rng.uniform(-0.5, 0.5, 3) * [SIDE, SIDE, HEIGHT]
        network.add_point(f"P{i}", place + enu.T @ at)
    names = list(network.points)
    for number, what in enumerate(sorts):
        sort = SORTS[what]
        turns = rng.uniform(-1.0, 1.0, 3) * (1.0 if "rx" in sort.free else 1e-4)
        turns[2] = rng.uniform(-np.pi, np.pi) if "rx" not in sort.free else turns[2]
        values = dict(zip(_TURNS, turns.tolist(), strict=True))
        values.update(zip(_OFFSET, rng.uniform(-5.0, 5.0, 3).tolist(), strict=True))
        values["ln_scale"] = float(rng.uniform(-0.5, 0.5)) if "ln_scale" in sort.free else 0.0
        moving = (*sort.free, *(n for n, _ in sort.sigma))
        stated = {n: v for n, v in values.items() if n in moving}
        origin = names[number % points] if sort.at_point else _near(place, enu, rng)
        network.add_frame(
            what if sorts.count(what) == 1 else f"{what} {number}",
            free=sort.free,
            values=stated,
            sigma=dict(sort.sigma),
            origin=origin,
            level=sort.level,
        )
        axes = ["xyz".index(a) for a in sort.axes]
        covariance = 1e-6 * COVARIANCE[np.ix_(axes, axes)]
        for name in names:
            if name != origin:
                zeros = (0.0,) * len(axes)
                network.add(
                    FrameCoordinate(
                        list(network.frames)[-1], name, zeros, axes=sort.axes, covariance=covariance
                    )
                )
    return without_values(disturb(measure(network, seed=seed), seed=seed, points=coarse))


def _near(place: Array, enu: Array, rng: np.random.Generator) -> tuple[float, ...]:
    """Return a constant origin some metres from the middle of the points."""
    return tuple((place + enu.T @ rng.uniform(-5.0, 5.0, 3)).tolist())


def without_values(network: fga.Network) -> fga.Network:
    """Return the network as it is in the field: tilts are read as zero, other values found."""
    out = network.copy()
    for name, p in network.frames.items():
        weighted = np.isfinite(p.sigma)
        values = [
            v if h or w else np.nan for v, h, w in zip(p.values, p.fixed, weighted, strict=True)
        ]
        values[:2] = [0.0 if w else v for v, w in zip(values[:2], weighted[:2], strict=True)]
        values[6] = p.values[6] if p.fixed[6] or weighted[6] else 0.0
        out.frames[name] = replace(p, values=tuple(values))
    return out
