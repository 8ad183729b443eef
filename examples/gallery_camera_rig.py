"""A rig of two cameras in a hall
==============================

Two cameras look to both sides of a rod that is carried through a hall. Their poses on it are
unknown but constant: the adjustment finds the rotation and the arm of the second one on the
first, its mount. Every photo has its own pose, tied to its carrier by a rigid mount.
At the end the camera slips by 5 mm at one place, and data snooping names it.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation, world_R_camera
from factorgraph_adj.simulation.measurement import measure

PARTS, MOUNT = ("rx", "ry", "rz", "x", "y", "z"), (0.01, 1.22, -0.03, 0.31, 0.02, 0.05)
FOCAL, PLACES = 12.0, 5

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the standard deviations of the centres")
options = parser.parse_args()


def hall(play: tuple[float, float] = (1e-8, 1e-6)) -> fga.Network:
    """Return the places of the rod and the points of the walls, with true values."""
    rng, network = np.random.default_rng(1), fga.Network("hall")
    for name in ("left", "right"):
        network.add_camera(name, NoDistortion(), {"c": FOCAL})
    network.set_mount("rod", free=PARTS, values=dict(zip(PARTS, MOUNT, strict=True)))
    turn = TURN_ABOUT_X @ exp_rotation(np.array(MOUNT[:3])) @ TURN_ABOUT_X
    for k in range(PLACES):
        x = np.array([4.0 * k, 0.0, 1.7]) + rng.normal(0, 0.2, 3)
        r = world_R_camera(np.pi / 2 + rng.normal(0, 0.05), rng.normal(0, 0.2) - 0.6, 0.0)
        network.add_photo(f"{k}", "left", position=x, rotation=r)
        arm = r @ TURN_ABOUT_X @ MOUNT[3:]
        other = {"carrier": f"{k}", "mount": "rod", "play": play}
        network.add_photo(f"{k} right", "right", position=x + arm, rotation=r @ turn, **other)
    walls = rng.uniform((-8, 6, -3), (24, 9, 6), (120, 3))
    for i, at in enumerate(walls):
        network.add_point(f"P{i}", at, fixed="xyz" if i < 4 else "")
    for name, photo in network.photos.items():
        p = (walls - photo.position) @ photo.rotation
        on = np.flatnonzero((p[:, 2] > 1) & (np.abs(p[:, :2] / p[:, 2:]) < 0.9).all(axis=1))
        network.add_image_points(name, [f"P{i}" for i in on], np.zeros((len(on), 2)), sigma=0.002)
    return network


network = measure(hall(), seed=3)
rig = fga.adjust(network)
mount = rig.unknown("mount", "rod")
off = np.abs((mount.values - MOUNT) / mount.sigmas).max()
print(f"n {rig.n_observations}, u {rig.n_unknowns}, σ̂0 {rig.sigma0:.2f}")
print(f"arm {mount.values[3:].round(4)} ± {1e3 * mount.sigmas[3:].max():.1f} mm, off {off:.1f} σ")
ties = [i for i, o in network.observations.items() if o.kind.startswith("relative")]
alone = fga.adjust(fga.without(network, ties))

slipped = measure(hall(play=(1e-4, 2e-4)), seed=3)
ident = next(i for i, o in slipped.observations.items() if i.startswith("3 right") and "pos" in i)
moved = np.add(slipped.observations[ident].value, (0.005, 0.0, 0.0))
slipped.observations[ident] = replace(slipped.observations[ident], value=tuple(moved))
for r in fga.snoop(slipped, alpha=1e-5).rejected:
    print(f"rejected: {r.id}, error {1e3 * r.final_error:.1f} mm, w {r.test:.1f}")

if options.plot:
    from matplotlib.figure import Figure

    axes = (figure := Figure(figsize=(7, 3), layout="constrained")).add_subplot()
    for shift, what, s in ((-0.2, "alone", alone), (0.2, "on the rig", rig)):
        sigma = [1e3 * np.linalg.norm(s.unknown("pose", n).sigmas[3:]) for n in s.network.photos]
        axes.bar(np.arange(len(sigma)) + shift, sigma, 0.4, label=f"photos {what}")
    axes.set(ylabel="σ of the projection centre [mm]", xlabel="photo")
    axes.legend()
    figure.savefig(options.plot, dpi=150)
