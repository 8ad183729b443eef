"""A measured day
==============

Every observation is tested when it is added, and three of them have gross errors. The network is
the industry block of ``industry_block.py`` with directions from five total stations; levelling,
stations, tape and photos are added one after the other. The picture shows the standard deviations
of some points against the number of additions.
"""

import argparse
from dataclasses import replace

import numpy as np

import factorgraph_adj as fga
from examples.published_blocks.industry_1981 import simulate_industry_block
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.units import GON

MGON, MM = GON / 1000, 1e-3
UNITS = {"direction": (MGON, "mgon"), "image": (1.0, "mm")}
STATIONS, REACH = ("P36", "P12", "P19", "P52", "P59"), 10.5
CHOSEN = ("P05", "P24", "P36", "P47", "P66")

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw σ of some points against the arrivals")
options = parser.parse_args()

# %%
# What will be measured today.

simulated = simulate_industry_block(seed=2)
block, truth = simulated.network, simulated.truth.points
sights = fga.Network("sights")
for name, xyz in truth.items():
    sights.add_point(name, xyz)
for number, station in enumerate(STATIONS):
    sights.set_orientation(station, value=1.0 + number)
    for target, xyz in truth.items():
        if 0 < np.linalg.norm(xyz - truth[station]) < REACH:
            sights.add(Direction(station, target, 0.0, sigma=3 * MGON))
            sights.add(SlopeDistance(station, target, 0.0, sigma=1 * MM))
sighted = measure(sights, seed=2).observations.values()
known = block.observations.values()
day = {"levelling": [o for o in known if isinstance(o, HeightDifference)]}
for station in STATIONS:
    day[f"station {station}"] = [replace(o, id=None) for o in sighted if o.names()[0] == station]
tape = [o for o in known if isinstance(o, SlopeDistance)]
for i in range(0, len(tape), 30):
    day[f"tape {i // 30 + 1}"] = tape[i : i + 30]
for photo in block.photos:
    day[photo] = [o for o in block.image_points() if o.photo == photo]


def spoil(arrival: str, which: int, **by: float) -> str:
    """Add a gross error to an observation of an arrival; return its name."""
    good = day[arrival][which]
    day[arrival][which] = replace(good, **{k: getattr(good, k) + v for k, v in by.items()})
    return good.label()


print("three gross errors:")
print(" ", spoil("station P52", 10, value=60 * MGON), "60 mgon")
print(" ", spoil("tape 2", 7, value=10 * MM), "10 mm")
print(" ", spoil("photo 5", 20, x=0.08), "0.08 mm in x")

# %%
# The day.

inc = fga.IncrementalAdjustment(fga.Network("a measured day"), policy="reject")
inc.add(points=block.points.values(), cameras=block.cameras.values())
growth: dict[str, list[float]] = {name: [] for name in CHOSEN}
caught: dict[int, str] = {}
print(f"\n{'arrival':12}{'observations':>13}{'points':>8}{'waiting':>9}{'mean σ, mm':>12}")
for number, (name, observations) in enumerate(day.items()):
    arrival = inc.add(observations, photos=[block.photos[name]] if name in block.photos else [])
    sigma = {p: inc.standard_deviations(p) for p in inc.network().points}
    for point, values in growth.items():
        values.append(float(np.linalg.norm(sigma[point])) if point in sigma else np.nan)
    mean = np.mean(list(sigma.values())) / MM if sigma else np.nan
    print(f"{name:12}{len(observations):13}{len(sigma):8}{inc.n_waiting:9}{mean:12.2f}")
    for v in arrival.verdicts:
        if v.verdict == "rejected":
            k = int(np.nanargmax(np.abs(v.w)))
            size, unit = UNITS.get(v.kind, (MM, "mm"))
            error = f"{-v.innovation[k] / size:.2f} ± {v.sigma[k] / size:.2f} {unit}"
            print(f"    rejected: {v.label}: error {error}, w {v.w[k]:.1f}")
            label = v.label.split(" (")[0]
            caught[number] = f"{caught[number]}, {label}" if number in caught else label
print(f"σ̂0 {inc.sigma0:.3f}, redundancy {inc.redundancy}")

# %%
# The batch adjustment in the evening, for comparison.

evening = block.copy()
evening.observations = {}
evening.image_mask(np.zeros(block.n_image_points, dtype=bool))
evening.add(*(o for observations in day.values() for o in observations))
solution = fga.adjust(evening)
print(f"\nall of it in one batch: σ̂0 {solution.sigma0:.3f}; largest test values:")
for suspect in fga.reliability(solution).suspects(8):
    print(f"    w {suspect.value:6.1f}  {suspect.label}")

if options.plot:
    from factorgraph_adj.report.plots import plot_growth

    figure = plot_growth(
        list(day), growth, caught=caught, title="a measured day", solution=inc.solution()
    )
    figure.savefig(options.plot, dpi=150)
    print(f"\n{options.plot}: σ of {', '.join(CHOSEN)}")
