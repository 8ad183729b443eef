"""The aerial block of IGN with GNSS and inertial observations on its delivered orientation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import (
    ControlPoint,
    NavigationAttitude,
    PhotoAttitude,
    PhotoPosition,
)
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.loaders.borea import Block

SIGMA_GNSS, SIGMA_CONTROL = 0.05, 0.03
"""Metres."""
SIGMA_ATTITUDE = np.radians(0.004)
ARM = (0.35, -0.22, 0.0)
"""Lever arm that is put on, metres."""
BORESIGHT = np.radians((0.12, -0.08, 0.25))
"""Boresight that is put on."""
TURNS, OFFSETS = ("rx", "ry", "rz"), ("x", "y", "z")
MOUNT = dict(zip((*TURNS, *OFFSETS), (*BORESIGHT.tolist(), *ARM), strict=True))
SHIFT, RATE = 0.15, 0.02
"""Standard deviations of what shifts and drifts are drawn from: metres, and per exposure."""
SHIFTED = tuple(a + power for power in ("", "_t") for a in OFFSETS)
"""Components of a shift and a drift."""


@dataclass(frozen=True)
class Flight:
    """What is observed in the flight, and what is unknown of it."""

    control: int = 2
    """Number of control points: the two of the block, then delivered points that are far apart."""
    mount: tuple[str, ...] = ()
    """Free components of the mount."""
    drift: tuple[str, ...] = ()
    """Free components of the shift and drift of each strip."""
    drawn: bool = True
    """Whether shifts and drifts have values; otherwise they are zero."""
    navigation: bool = False
    """Whether attitudes are roll, pitch and heading, and not ω, φ, κ."""
    attitudes: bool = True
    """Whether attitudes are observed."""
    sigma_image: float = 0.2
    """Pixels."""
    points: int | None = None
    """Number of points; None: all."""


def plan_of(block: Block, flight: Flight, seed: int = 1) -> fga.Network:
    """Return the block with true values; what is put on follows from the flight."""
    rng = np.random.default_rng(seed)
    control = control_of(block, flight.control)
    names = [n for n, k in block.seen.items() if k >= 2]
    if flight.points is not None:
        chosen = names[:: max(1, len(names) // flight.points)]
        names = list(dict.fromkeys([*chosen, *control]))
    network = block.network(points=names, sigma=flight.sigma_image)
    for name, x in control.items():
        network.points[name] = replace(network.points[name], coordinates=tuple(x.tolist()))
        at = tuple(x.tolist())
        network.add(ControlPoint(name, at, sigma=(SIGMA_CONTROL,) * 3, id=f"control {name}"))
    lost = [n for n, p in network.points.items() if not np.isfinite(p.coordinates).all()]
    if lost:
        found = fga.adjust(block.network(points=lost, held=True))
        for name in lost:
            at = tuple(found.point(name).tolist())
            network.points[name] = replace(network.points[name], coordinates=at)
    values = {n: v for n, v in MOUNT.items() if n in flight.mount}
    network.set_mount("imu", free=flight.mount, values=values)
    for strip, photos in block.strips.items():
        shift = rng.normal(0.0, np.repeat([SHIFT, RATE], 3))
        drawn = dict(zip(SHIFTED, shift.tolist(), strict=True)) if flight.drawn else {}
        drawn = {n: v for n, v in drawn.items() if n in flight.drift}
        network.set_drift(strip, free=flight.drift, values=drawn)
        middle = np.mean([p.number for p in photos])
        for p in photos:
            name, time = p.name, float(p.number - middle)
            network.add(
                PhotoPosition(
                    name,
                    (0.0,) * 3,
                    sigma=(SIGMA_GNSS,) * 3,
                    mount="imu",
                    drift=strip,
                    time=time,
                    id=f"GNSS {name}",
                )
            )
            if flight.attitudes:
                kind = NavigationAttitude if flight.navigation else PhotoAttitude
                sigma = (SIGMA_ATTITUDE,) * 3
                network.add(kind(name, (0.0,) * 3, sigma=sigma, mount="imu", id=f"INS {name}"))
    return network


def control_of(block: Block, count: int) -> dict[str, Array]:
    """Return the control points of the block and further points, each far from those before it."""
    out = dict(block.control)
    names = [n for n, x in block.points.items() if block.seen.get(n, 0) >= 3]
    places = np.array([block.points[n] for n in names])
    while len(out) < count:
        off = np.min([np.linalg.norm(places - x, axis=1) for x in out.values()], axis=0)
        chosen = int(np.argmax(off))
        out[names[chosen]] = places[chosen]
    return out


def flown(plan: fga.Network, seed: int, *, measured_images: bool = False) -> fga.Network:
    """Return the plan with observations drawn, and unknowns of the flight that start at zero.

    Args:
        plan: true values.
        seed: of the errors.
        measured_images: whether image coordinates and control are those of the block.
    """
    network = measure(plan, seed=seed)
    if measured_images:
        network.images = plan.images.copy()
        for ident, o in plan.observations.items():
            if isinstance(o, ControlPoint):
                network.observations[ident] = o
    for kind in ("mount", "drift", "attitude_drift", "shutter"):
        for name, p in network.of_kind(kind).items():
            values = tuple(v if f else 0.0 for v, f in zip(p.values, p.fixed, strict=True))
            network.of_kind(kind)[name] = replace(p, values=values)
    return network


def errors_of(solution: fga.Solution, plan: fga.Network, kind: str) -> Array:
    """Return the errors of all free components of a kind in units of their σ."""
    out = []
    for name, p in plan.of_kind(kind).items():
        e = solution.unknown(kind, name)
        free = ~np.array(p.fixed)
        out += ((e.values - p.values)[free] / e.sigmas[free]).tolist()
    return np.array(out)
