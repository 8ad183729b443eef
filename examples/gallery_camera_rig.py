"""A rig of four cameras over a terrain
=====================================

A nadir camera carries three oblique ones. Nothing is known of how they sit on it: their start
values come from photos that were resected separately, and the adjustment finds rotations and arms.
Every member has a pose of its own, tied to the nadir camera by a rigid mount. The same images
without the rig leave the projection centres of the oblique cameras to their own few rays. At the
end one camera slips on its mount at one exposure, and data snooping names it.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation, world_R_camera
from factorgraph_adj.simulation.simulate import measure

PARTS = ("rx", "ry", "rz", "x", "y", "z")
MOUNTS = {
    "forward": (0.62, 0.01, -0.02, 0.02, 0.31, 0.05),
    "left": (0.01, -0.61, 0.03, -0.28, 0.02, 0.04),
    "right": (-0.02, 0.63, -0.01, 0.29, -0.01, 0.06),
}
FOCAL, HALF, HEIGHT = 35.0, (18.0, 12.0), 150.0

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the standard deviations of the centres")
options = parser.parse_args()


def block(play: tuple[float, float] = (1e-8, 1e-6)) -> fga.Network:
    """Return two strips with four exposures each, with true values."""
    rng = np.random.default_rng(1)
    network = fga.Network("four cameras")
    for name in ("nadir", *MOUNTS):
        network.add_camera(name, NoDistortion(), {"c": FOCAL})
    for name, values in MOUNTS.items():
        network.set_mount(name, free=PARTS, values=dict(zip(PARTS, values, strict=True)))
    for strip in range(2):
        for k in range(4):
            x = np.array([70.0 * strip, 45.0 * k, HEIGHT]) + rng.normal(0, 2, 3)
            omega, phi, kappa = rng.normal(0, 0.03, 3)
            r = world_R_camera(omega, phi, kappa + np.pi * strip)
            carrier = f"{strip}-{k}"
            network.add_photo(carrier, "nadir", position=x, rotation=r)
            network.add(fga.PhotoPosition(carrier, (0, 0, 0), sigma=(0.02, 0.02, 0.03)))
            for name, values in MOUNTS.items():
                b = exp_rotation(np.array(values[:3]))
                network.add_photo(
                    f"{carrier} {name}",
                    name,
                    position=x + r @ TURN_ABOUT_X @ values[3:],
                    rotation=r @ TURN_ABOUT_X @ b @ TURN_ABOUT_X,
                    carrier=carrier,
                    mount=name,
                    play=play,
                )
    grid = np.stack(np.meshgrid(np.arange(-90, 230, 16.0), np.arange(-90, 270, 16.0)), -1)
    xy = grid.reshape(-1, 2) + rng.uniform(-6, 6, (grid.size // 2, 2))
    ground = np.column_stack([xy, 10 * np.sin(xy[:, 0] / 60) * np.cos(xy[:, 1] / 45)])
    seen = np.array([sees(f, ground) for f in network.photos.values()])
    used = np.flatnonzero(seen.sum(axis=0) > 2)
    names = [f"P{i}" for i in used]
    network.add_points(names, ground[used])
    for photo, on in zip(network.photos, seen[:, used], strict=True):
        chosen = [n for n, o in zip(names, on, strict=True) if o]
        network.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=0.002)
    for i in (0, len(used) // 2, -1):
        network.add(fga.ControlPoint(names[i], tuple(ground[used[i]]), sigma=(0.01,) * 3))
    return network


def sees(photo: fga.Photo, x: np.ndarray) -> np.ndarray:
    """Return which points are in the image of a photo."""
    p = (x - photo.position) @ photo.rotation
    return (p[:, 2] > 10) & (np.abs(p[:, :2] / p[:, 2:]) * FOCAL < HALF).all(axis=1)


# Nothing is known of the mounts.
network = measure(block(), seed=3)
for name in MOUNTS:
    network.set_mount(name, free=PARTS)
rig = fga.adjust(network)
print(f"n {rig.n_observations}, u {rig.n_unknowns}, σ̂0 {rig.sigma0:.2f}")
for name, true in MOUNTS.items():
    mount = rig.unknown("mount", name)
    off = (mount.values - true) / mount.sigmas
    print(f"{name}: arm {mount.values[3:].round(3)} m, errors {np.abs(off).max():.1f} σ at most")

# The same images, without the rig.
ties = [i for i, o in network.observations.items() if o.kind.startswith("relative")]
alone = fga.adjust(fga.without(network, ties))
members = [n for n in network.photos if " " in n]
sigma = {
    what: np.array([np.linalg.norm(s.unknown("pose", n).sigmas[3:]) for n in members])
    for what, s in (("alone", alone), ("on the rig", rig))
}
for what, values in sigma.items():
    print(f"centres of oblique cameras, {what}: σ {1e3 * np.median(values):.0f} mm")

# One camera has slipped by 0.25 m at one exposure; its tie may move by 5 mm.
slipped = measure(block(play=(2e-4, 0.005)), seed=3)
ident = "1-2 left on 1-2 position"
wrong = slipped.observations[ident]
slipped.observations[ident] = replace(wrong, value=tuple(np.add(wrong.value, (0.0, 0.25, 0.0))))
for r in fga.snoop(slipped, alpha=1e-5).rejected:
    print(f"set aside: {r.id}, error {r.final_error:.2f} m, w {r.test:.1f}")

if options.plot:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.2), layout="constrained")
    axes = figure.add_subplot(ylabel="σ of the projection centre [mm]")
    at = np.arange(len(members))
    for shift, what, colour in ((-0.2, "alone", "0.6"), (0.2, "on the rig", "C0")):
        axes.bar(at + shift, 1e3 * sigma[what], 0.4, label=f"oblique cameras {what}", color=colour)
    axes.set_xticks(at, members, rotation=90, fontsize=7)
    axes.legend()
    figure.savefig(options.plot, dpi=150)
    print(f"{options.plot}: what the rig does for its oblique cameras")
