"""A room sighted by scanners, trackers and theodolites, each in a frame of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import FrameDirection, FrameDistance, FrameZenith
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.units import ARCSEC
from tests.networks.every_kind import FRAMES
from tests.networks.frames import without_values

SIGMA_ANGLE = 4.0 * ARCSEC
SIGMA_DISTANCE = 5e-4
SIDE, CEILING = 16.0, 5.0
"""Extent of the room, metres."""
TURNS, OFFSET = ("rx", "ry", "rz"), ("x", "y", "z")


@dataclass(frozen=True)
class Instrument:
    """A sort of instrument."""

    free: tuple[str, ...] = (*TURNS, *OFFSET)
    """Free components of its frame."""
    at_point: bool = False
    """Whether it stands on a point (forced centring)."""
    level: bool = False
    """Whether it is levelled."""
    sigma: tuple[tuple[str, float], ...] = ()
    """Standard deviations of weighted components."""
    observes: str = "dzs"
    """Directions, zenith angles, distances."""


INSTRUMENTS = {
    "scanner": Instrument(),
    "tracker": Instrument(),
    "theodolite": Instrument(observes="dz"),
    "levelled scanner": Instrument(("rz", *OFFSET), level=True),
    "compensated scanner": Instrument(
        ("rz", *OFFSET), level=True, sigma=(("rx", 2e-5), ("ry", 2e-5))
    ),
    "on a tripod": Instrument(("rz",), at_point=True, level=True),
    "on a pillar, tilted": Instrument(TURNS, at_point=True),
    "levelled theodolite": Instrument(("rz", *OFFSET), level=True, observes="dz"),
}
"""Instruments by name."""


def room_of(
    seed: int,
    instruments: Sequence[str],
    *,
    points: int = 9,
    frame_name: str = "flat",
    held: int = 0,
    constants: bool = False,
    coarse: float | None = None,
    share: float = 1.0,
) -> fga.Network:
    """Return a simulated room; without held points its datum is free.

    Args:
        seed: of everything drawn.
        instruments: names of `INSTRUMENTS`, as often as one is wanted.
        points: number of targets.
        frame_name: name of a frame of the network, see `every_kind`.
        held: number of targets that are held.
        constants: whether distance meter, collimation and index error are unknown; every second
            sight is then in the second face.
        coarse: standard deviation of approximate coordinates, metres; None: there are none.
        share: share of the targets that an instrument sights.
    """
    rng = np.random.default_rng(seed)
    frame, place = FRAMES[frame_name]
    network = fga.Network("room", frame=frame, datum="given" if held else "free")
    enu = frame.basis(place[None], np.zeros((1, 2))).enu[0]

    def somewhere(low: float = 0.5) -> Any:
        at = rng.uniform(-low, low, 3) * [SIDE, SIDE, CEILING]
        return place + enu.T @ at

    for i in range(points):
        network.add_point(f"P{i}", somewhere(), fixed="xyz" if i < held else "")
    named: dict[str, str | None] = {"instrument": None, "collimation_error": None, "index": None}
    if constants:
        network.set_distance_meter("edm", zero=0.01, free=["zero"])
        network.set_unknown("collimation_error", "telescope", (3e-5,))
        network.set_unknown("index_error", "circle", (-4e-5,))
        named = {"instrument": "edm", "collimation_error": "telescope", "index": "circle"}
    for number, what in enumerate(instruments):
        sort = INSTRUMENTS[what]
        name = f"{what} {number}"
        turns = rng.uniform(-0.3, 0.3, 3)
        if "rx" not in sort.free:
            turns[:2] = rng.uniform(-1e-5, 1e-5, 2) if sort.sigma else 0.0
        turns[2] = rng.uniform(-3.0, 3.0)
        values = dict(zip(TURNS, turns.tolist(), strict=True))
        at = somewhere(0.35)
        if sort.at_point:
            network.add_point(f"S{number}", at)
            origin: Any = f"S{number}"
        else:
            origin = tuple(np.round(at).tolist())
            values |= dict(zip(OFFSET, rng.uniform(-0.4, 0.4, 3).tolist(), strict=True))
        network.add_frame(
            name,
            free=sort.free,
            values=values,
            sigma=dict(sort.sigma),
            origin=origin,
            level=sort.level,
        )
        chosen = rng.permutation(points)[: max(4, round(share * points))]
        for k, p in enumerate(sorted(chosen.tolist())):
            face = 2 if constants and k % 2 else 1
            angle: Any = {"sigma": SIGMA_ANGLE, "face": face}
            sights: dict[str, Any] = {
                "d": FrameDirection(
                    name, f"P{p}", 0.0, collimation_error=named["collimation_error"], **angle
                ),
                "z": FrameZenith(
                    name, f"P{p}", 0.0 if face == 2 else 1.0, index_error=named["index"], **angle
                ),
                "s": FrameDistance(
                    name, f"P{p}", 1.0, sigma=SIGMA_DISTANCE, instrument=named["instrument"]
                ),
            }
            network.add(*(sights[o] for o in sort.observes))
    network = measure(network, seed=seed)
    if coarse is None:
        network.points = {
            n: p if all(p.fixed) else replace(p, coordinates=(np.nan,) * 3)
            for n, p in network.points.items()
        }
    else:
        network = disturb(network, seed=seed, points=coarse)
    return without_values(network)
