"""Planning a measurement
======================

How precise will the design be, what is missing, what is cheapest to add? A facade of 20 × 9 m has
twelve targets, one total station and two photos; nothing is measured yet. The design is checked
against targets, and additions are proposed, each with its cost in minutes.
"""

import argparse

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.entities import Photo, Point
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import Direction, ImagePoint, SlopeDistance, ZenithAngle
from factorgraph_adj.planning import targets
from factorgraph_adj.planning.candidates import Candidate, with_candidates
from factorgraph_adj.planning.plan import plan
from factorgraph_adj.planning.proposals import propose
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.units import GON

MM, MGON, MIDDLE = 1e-3, GON / 1000, np.array([10.0, 0.0, 5.0])
FACADE = {f"F{i + 1:02d}": (20 / 3 * (i % 4), 0.3 * (i % 2), 1 + 4.0 * (i // 4)) for i in range(12)}
STATIONS = {"S1": (8.0, -18.0, 1.5), "S2": (-2.0, -14.0, 1.5), "S3": (23.0, -15.0, 1.5)}
PHOTOS = {"left": (-3, -16, 2), "right": (23, -16, 2), "middle": (10, -17, 6), "high": (4, -15, 8)}
SIGHTS = {Direction: MGON, ZenithAngle: MGON, SlopeDistance: 1 * MM}
TARGETS = [targets.SemiAxis(1.5 * MM, points=("F*",), dimension=3)]
TARGETS += [targets.RedundancyNumber(0.15), targets.UndetectedShift(3.0 * MM, points=("F*",))]

parser = argparse.ArgumentParser()
parser.add_argument("--plot", metavar="FILE", help="draw the design as proposed")
options = parser.parse_args()


def station(name: str) -> Candidate:
    """Return a station with sights of the whole facade and of the first station."""
    sights = [(name, p, 0.0) for p in (*FACADE, "S1") if p != name]
    read = tuple(kind(*s, sigma=sigma) for s in sights for kind, sigma in SIGHTS.items())
    return Candidate(f"station {name}", read, 40, points=(Point(name, STATIONS[name]),))


def photo(name: str) -> Candidate:
    """Return a photo of the whole facade."""
    at = np.array(PHOTOS[name], dtype=float)
    rays = tuple(ImagePoint(name, p, 0.0, 0.0, sigma=0.0008) for p in FACADE)
    new = Photo(name, "camera", tuple(at), look_at(at, MIDDLE))
    return Candidate(f"photo {name}", rays, 5, photos=(new,))


design = fga.Network("facade")
design.add_point("S1", STATIONS["S1"], fixed="xyz")
for name, xyz in FACADE.items():
    design.add_point(name, xyz, fixed="x" if name == "F01" else "")
design.add_camera("camera", BrownLens(), {"c": 24.0})
design.add(*station("S1").observations)
design = with_candidates(design, [photo("left"), photo("right")])
candidates = [photo("middle"), photo("high"), station("S2"), station("S3")]
before = plan(design, TARGETS)
print(before)
for target in TARGETS:
    short = [s for s in before.shortfalls if s.target is target]
    print(f"{len(short):5} fall short, the worst: {short[0]}" if short else f"  met: {target}")
proposal = propose(design, candidates, TARGETS)
print(f"\nproposed of {len(candidates)} candidates, {proposal.cost:g} minutes:")
for step in proposal.steps:
    print(f"    {step.candidate.name:14}{step.candidate.cost:4g} min, then lacking {step.lack:.2f}")
print(proposal.plan)
for target in TARGETS:
    names, figures = proposal.plan.figures(target)
    i = figures.argmin() if targets.at_least(target) else figures.argmax()
    print(f"    {targets.describe(target)}: at worst {figures[i]:.3g} ({names[i]})")

if options.plot:
    from factorgraph_adj.report.plots import plot_network

    plot_network(proposal.plan.solution, view="south").savefig(options.plot, dpi=150)
    print(f"{options.plot}: the design as proposed, from the south, with its ellipses of 95 %")
