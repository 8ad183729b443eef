"""Two epochs of a dam, in two adjustments and in one
==================================================

A reference point slips, and two points of the crest move together. Each epoch is adjusted alone and
both are compared; then one adjustment has both epochs, in which a stable point occurs once and any
other twice. Displacements are the same; only the two σ̂0 change their standard deviations.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--plot", help="file of the picture")
options, _ = parser.parse_known_args()

PLACES = {
    **{"R1": (0, 0), "R2": (420, 30), "R3": (390, 360), "R4": (-20, 340), "R5": (180, -80)},
    **{"D1": (150, 150), "D2": (190, 165), "D3": (230, 175)},
}
MOVED = {"R3": (0.008, -0.011), "D2": (0.006, 0.009), "D3": (0.006, 0.009)}
MM = 1e-3

# %%
# Distances and directions between all points, in both epochs.


def measured(epoch: int) -> fga.Network:
    """Return an epoch with its readings."""
    rng = np.random.default_rng(epoch)
    true = {n: np.array(at) + (epoch == 2) * np.array(MOVED.get(n, 0)) for n, at in PLACES.items()}
    network = fga.Network(f"epoch {epoch}", datum="free")
    for name, at in PLACES.items():
        network.add_point(name, (*at, 0), fixed="z")
    for a, b in ((a, b) for a in PLACES for b in PLACES if a != b):
        de, dn = true[b] - true[a]
        read = np.hypot(de, dn) + rng.normal(0, MM), np.arctan2(de, dn) + rng.normal(0, 5e-6)
        network.add(fga.HorizontalDistance(a, b, read[0], sigma=MM))
        turned = read[1] % (2 * np.pi)
        network.add(fga.Direction(a, b, turned, sigma=5e-6, set=f"epoch {epoch}"))
    return network


first, second = measured(1), measured(2)
found = fga.congruence(fga.adjust(first), fga.adjust(second), objects=["D1", "D2", "D3"])
crest = fga.block_motion(found, ["D2", "D3"])
print(found, "stable:", *found.stable)
print(f"crest moved {crest['tx'] / MM:.1f} {crest['ty'] / MM:.1f} mm (true: 6.0 9.0)")

# %%
# Both epochs in one adjustment: unstable points have a second place in the second epoch.
both = first.copy()
later = {n: f"{n} later" for n in PLACES if n not in found.stable}
for name, other in later.items():
    both.add_point(other, both.points[name].coordinates, fixed="z")
for o in second.observations.values():
    ends = {end: later.get(getattr(o, end), getattr(o, end)) for end in ("station", "target")}
    both.add(replace(o, **ends, id=None))
joint = fga.congruence(fga.adjust(both), pairs=later)
for name in later:
    cells = [
        f"{x.vector[0] / MM:6.2f}{x.vector[1] / MM:7.2f} ± {x.sigmas[0] / MM:.2f}"
        for x in (found.displacement(name), joint.displacement(name))
    ]
    print(f"{name} {' | '.join(cells)} mm{'  moved' * found.displacement(name).moved}")

if options.plot:
    from factorgraph_adj.report.plots import plot_displacements

    plot_displacements(found, blocks=[crest]).savefig(options.plot, dpi=100)
