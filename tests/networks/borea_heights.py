"""The aerial block of IGN with a statoscope, profiles over the ground, a lake, horizon and sun."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import direction_of
from factorgraph_adj.models.positions import heights
from factorgraph_adj.rotation import TURN_ABOUT_X
from tests.loaders.borea import Block
from tests.networks.borea_flight import control_of

SIGMA_IMAGE, SIGMA_CONTROL = 0.2, 0.03
"""Pixels; metres."""
SIGMA_STATOSCOPE, SIGMA_APR, SIGMA_SHORE, SIGMA_TILT = 0.3, 0.2, 0.1, np.radians(0.01)
"""Metres and radians."""
FEWEST = 12
"""Points of a photo that is used, at least."""
IN_PHOTO, AT_SHORE = 15, 40
"""Points of each photo that are used at least, if it has them, and points at the shore."""
PER_EXPOSURE = 0.1
"""Unit of the profiles: ten exposures."""
SHIFTED = ("height", "height_t")


def plan_of(block: Block, *, control: int = 11) -> fga.Network:
    """Return the block with true values and images to be simulated; its lake is made level."""
    rng = np.random.default_rng(7)
    seen = {n: k for n, k in block.seen.items() if k >= 2 and n in block.points}
    used = [f for f, (names, _) in block.rays.items() if len(seen.keys() & {*names}) >= FEWEST]
    block = replace(
        block,
        photos={f: block.photos[f] for f in used},
        rays={f: block.rays[f] for f in used},
    )
    known = control_of(block, control)
    names = list(known)
    for seen, _ in block.rays.values():
        every = [n for n in seen if block.seen[n] >= 2 and n in block.points]
        names += every[:: max(1, len(every) // IN_PHOTO)]
    names = list(dict.fromkeys(names))
    network = block.network(points=names, sigma=SIGMA_IMAGE)
    frame = network.frame
    for name, x in known.items():
        at = tuple(x.tolist())
        network.points[name] = replace(network.points[name], coordinates=at)
        network.add(o.ControlPoint(name, at, sigma=(SIGMA_CONTROL,) * 3, id=f"control {name}"))
    at = np.array([network.points[n].coordinates for n in names])
    height, up = heights(frame, at)
    middle = np.median(at, axis=0)
    near = np.argsort(np.linalg.norm((at - middle)[:, :2], axis=1))
    wet = np.zeros(len(at), dtype=bool)
    wet[[i for i in near.tolist() if names[i] not in known][:AT_SHORE]] = True
    level = float(np.median(height[wet]))
    network.set_level("lake", level)
    at[wet] += (level - height[wet])[:, None] * up[wet]
    for i in np.flatnonzero(wet).tolist():
        name = names[i]
        network.points[name] = replace(network.points[name], coordinates=tuple(at[i].tolist()))
        network.add(o.LevelHeight(name, "lake", sigma=SIGMA_SHORE, id=f"shore {name}"))
    network.set_mount("horizon camera", free=("rx", "ry"), values={"rx": 0.02, "ry": -0.01})
    network.set_mount("periscope", free=("rx", "ry", "rz"), values={"rz": 0.3, "ry": 0.1})
    sun = direction_of(frame, middle, np.radians(140.0), np.radians(48.0))
    for strip, photos in block.strips.items():
        for what in ("statoscope", "recorder"):
            drawn = dict(zip(SHIFTED, rng.normal(0.0, (5.0, 1.0)).tolist(), strict=True))
            network.set_profile(f"{what} {strip}", free=SHIFTED, values=drawn)
        number = float(np.mean([p.number for p in photos]))
        for p in photos:
            time = PER_EXPOSURE * (p.number - number)
            network.add(
                o.ProfileHeight(
                    *(None, 0.0),
                    photo=p.name,
                    profile=f"statoscope {strip}",
                    time=time,
                    sigma=SIGMA_STATOSCOPE,
                    id=f"statoscope {p.name}",
                )
            )
            under = np.linalg.norm((at - p.position)[:, :2], axis=1)
            below = names[int(np.argmin(under))]
            network.add(
                o.ProfileHeight(
                    *(below, 0.0),
                    profile=f"recorder {strip}",
                    time=time,
                    sigma=SIGMA_APR,
                    id=f"recorder {p.name}",
                )
            )
            sigma = (SIGMA_TILT,) * 2
            tilt, sight = {"mount": "horizon camera"}, {"mount": "periscope"}
            seen = tuple((TURN_ABOUT_X @ p.rotation.T @ sun).tolist())
            network.add(
                o.PhotoTilt(p.name, (0.0, 0.0), sigma=sigma, id=f"tilt {p.name}", **tilt),
                o.PhotoSight(
                    *(p.name, tuple(sun.tolist()), seen), sigma=sigma, id=f"sun {p.name}", **sight
                ),
            )
    return network
