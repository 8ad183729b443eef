"""Monitoring a wall, epoch by epoch
=================================

Four pillars are stable. The points of the wall are new ones in each epoch (W3@2): their shifts d
have a covariance D, and T² = dᵀ D⁻¹ d says whether one has moved (χ², 3 degrees of freedom, 0.1 %).
W3 moves by 1.2 mm each time from epoch 3 on; a distance of epoch 4 is 8 mm wrong.
"""

import argparse
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.units import GON

MM, MGON = 1e-3, GON / 1000
PILLARS = {"A": (0, 0, 0), "B": (60, 5, 1), "C": (55, 40, 0), "D": (-4, 38, 2)}
WALL = {f"W{i}": np.array([6.0 + 9 * i, 70.0, 3.0 + i % 3]) for i in range(1, 6)}
STEP, EPOCHS, CRITICAL = np.array([0.2, -1.1, -0.4]) * MM, 6, chi2.ppf(0.999, 3)

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the shifts by epoch")
options = parser.parse_args()


def measured(epoch: int) -> fga.Network:
    """Return an epoch with its readings: all pillars to all other points."""
    plan = fga.Network()
    wall = {f"{n}@{epoch}": x + (n == "W3") * max(0, epoch - 2) * STEP for n, x in WALL.items()}
    for name, xyz in (PILLARS | wall).items():
        plan.add_point(name, xyz)
    for number, station in enumerate(PILLARS):
        plan.set_orientation(station, set=str(epoch), value=1.0 + number + epoch)
        for target in (p for p in plan.points if p != station):
            ident, sight, angle = f"{epoch}: {station}-{target}", (station, target, 0.0), 0.3 * MGON
            plan.add(Direction(*sight, sigma=angle, set=str(epoch), id=f"r{ident}"))
            plan.add(ZenithAngle(*sight, sigma=angle, id=f"z{ident}"))
            plan.add(SlopeDistance(*sight, sigma=MM, id=f"s{ident}"))
    return measure(plan, seed=100 + epoch)


start = fga.Network("wall")
for name, xyz in PILLARS.items():
    start.add_point(name, xyz, fixed="xyz" if name == "A" else "x" if name == "D" else "")
inc = fga.IncrementalAdjustment(start, policy="reject")
shifts: dict[str, list[tuple[float, float]]] = {name: [] for name in WALL}
print("shifts since epoch 1 in mm (T² / critical value), * moved")
print("epoch  readings  redundancy     σ̂0" + "    ".join(f"{n:>14}" for n in WALL))
for epoch in range(1, EPOCHS + 1):
    today = measured(epoch)
    if epoch == 4:
        good = today.observations["s4: B-W5@4"]
        today.observations["s4: B-W5@4"] = replace(good, value=good.value + 8 * MM)
    new = [fga.Point(f"{name}@{epoch}", tuple(xyz)) for name, xyz in WALL.items()]
    arrival = inc.add(list(today.observations.values()), points=new)
    cells = ""
    for name in WALL:
        a, b = f"{name}@1", f"{name}@{epoch}"
        d, q = inc.estimate(b) - inc.estimate(a), inc.covariance(a, b)
        cov, length = inc.covariance(a) + inc.covariance(b) - q - q.T, np.sqrt(d @ d)
        shifts[name].append((length / MM, np.sqrt(d @ cov @ d) / (length or 1.0) / MM))  # and its σ
        test = d @ np.linalg.pinv(cov) @ d / CRITICAL
        cells += f"{'*' if test > 1 else '':>4}{length / MM:6.2f} ({test:5.2f})"
    print(f"{epoch:5}{len(today.observations):10}{inc.redundancy:12}{inc.sigma0:7.3f}{cells}")
    for v in (v for v in arrival.verdicts if v.verdict == "rejected"):
        print(f"       rejected {v.id}: error {-v.innovation[0] / MM:.1f} mm, w {v.w[0]:.1f}")

if options.plot:
    from matplotlib.figure import Figure

    axes = Figure().add_subplot(xlabel="epoch", ylabel="mm", title="shifts since epoch 1, ± σ")
    for first, (name, values) in zip(np.linspace(0.9, 1.1, 5), shifts.items(), strict=True):
        axes.errorbar(first + np.arange(EPOCHS), *np.transpose(values), fmt="o-", label=name)
    axes.legend().get_figure().savefig(options.plot, dpi=150)
