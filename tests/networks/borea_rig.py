"""A rig of four cameras on the delivered orientation of the aerial block of IGN.

A carrier without images flies the delivered poses, and its position and attitude are observed. One
camera looks down and three look at 45° forward, left and right; all have the lens and the format of
the block's camera. The points are those of the block, at their delivered places.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.network.composite_unknowns import RIGID
from factorgraph_adj.observations import ControlPoint, PhotoAttitude, PhotoPosition
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array, Mask
from tests.loaders.borea import FORMAT, PRINCIPAL_DISTANCE, Block
from tests.networks.borea_flight import SIGMA_ATTITUDE, SIGMA_CONTROL, SIGMA_GNSS, control_of
from tests.networks.rigs import PARTS, on_mount

SIGMA_IMAGE = 0.2
"""Pixels."""
CONTROL = 11
"""Number of control points; one of them, at the edge, only one camera sees, and it is left out."""
FEWEST = 6
"""Smallest number of points for which a camera has an image: at the edges some look off the block.
"""
NOTHING = (0.0, 0.0, 0.0)
"""Value of what is observed in a plan."""
OBLIQUE = float(np.radians(45.0))
MOUNTS: dict[str, tuple[float, ...]] = {
    "nadir": (0.0021, -0.0014, 0.0044, 0.35, -0.22, 0.18),
    "forward": (OBLIQUE + 0.003, 0.002, -0.004, 0.36, 0.05, 0.21),
    "left": (-0.002, -OBLIQUE + 0.004, 0.003, 0.12, -0.25, 0.19),
    "right": (0.004, OBLIQUE - 0.001, -0.002, 0.58, -0.24, 0.20),
}
"""Rotation vectors, radians, and arms, metres, of the cameras on the carrier."""


def rig_plan(block: Block, *, play: tuple[float, float] = RIGID) -> fga.Network:
    """Return the block with true values: its poses carry the cameras, its points are their points.

    Args:
        block: the block.
        play: of the cameras on their mounts, radians and metres.
    """
    plan = fga.Network("rig on the IGN block", frame=block.frame)
    control = control_of(block, CONTROL)
    places = {n: x for n, x in block.points.items() if block.seen.get(n, 0) >= 2} | control
    x = np.array(list(places.values()))
    for name, values in MOUNTS.items():
        lens = {"c": PRINCIPAL_DISTANCE}
        plan.add_camera(name, NoDistortion(), lens, unit="px", format=FORMAT)
        plan.set_mount(name, free=PARTS, values=dict(zip(PARTS, values, strict=True)))
    seen: dict[str, Mask] = {}
    for p in block.photos.values():
        plan.add_photo(p.name, "nadir", position=p.position, rotation=p.rotation)
        at, turn = (SIGMA_GNSS,) * 3, (SIGMA_ATTITUDE,) * 3
        plan.add(PhotoPosition(p.name, NOTHING, sigma=at, id=f"GNSS {p.name}"))
        plan.add(PhotoAttitude(p.name, NOTHING, sigma=turn, id=f"INS {p.name}"))
        for name, values in MOUNTS.items():
            rotation, centre = on_mount(p.rotation, p.position, values)
            inside = _in_image(rotation, centre, x)
            if inside.sum() < FEWEST:
                continue
            member = f"{p.name} {name}"
            pose = {"position": centre, "rotation": rotation}
            plan.add_photo(member, name, **pose, carrier=p.name, mount=name, play=play)
            seen[member] = inside
    used = np.sum(list(seen.values()), axis=0) >= 2
    names = np.array(list(places))
    plan.add_points(names[used].tolist(), x[used])
    for member, inside in seen.items():
        chosen = names[inside & used].tolist()
        plan.add_image_points(member, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE)
    for name in (n for n in control if n in plan.points):
        sigma = (SIGMA_CONTROL,) * 3
        plan.add(ControlPoint(name, NOTHING, sigma=sigma, id=f"control {name}"))
    return plan


def _in_image(rotation: Array, centre: Array, x: Array) -> Mask:
    """Return which points (n, 3) fall into the format of a camera."""
    p = (x - centre) @ rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(p[:, :2] / p[:, 2:]) * PRINCIPAL_DISTANCE
    return np.asarray((p[:, 2] > 0) & (off < np.array(FORMAT) / 2).all(axis=1))


def carried(plan: fga.Network, seed: int) -> fga.Network:
    """Return the plan with observations drawn; nothing is known of mounts and of the cameras."""
    network = measure(plan, seed=seed)
    for name in MOUNTS:
        network.set_mount(name, free=PARTS)
    carriers = set(carriers_of(plan))
    for name in plan.photos:
        if name not in carriers:
            network.photos[name] = replace(network.photos[name], position=None, rotation=None)
    return network


def carriers_of(plan: fga.Network) -> list[str]:
    """Return the names of the carriers."""
    return [o.photo for o in plan.observations.values() if isinstance(o, PhotoPosition)]


def slipped(plan: fga.Network, photo: str, turn: Array, shift: Array) -> fga.Network:
    """Return the plan with a camera turned and shifted in its own axes at one exposure."""
    out = plan.copy()
    f = plan.photos[photo]
    assert f.rotation is not None
    at = np.array(f.position) + f.rotation @ shift
    turned = f.rotation @ exp_rotation(turn)
    out.photos[photo] = replace(f, position=tuple(at.tolist()), rotation=turned)
    return out
