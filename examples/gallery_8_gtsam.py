"""The factor graph in GTSAM
=========================

GTSAM's own optimiser and marginals are compared with ``adjust``: distances and zenith angles from
three pillars to three new points, with two photos. ``build_graph`` gives a
``gtsam.NonlinearFactorGraph`` with values, which GTSAM treats like any other graph. GTSAM calls
back into Python for every factor, so this is for small networks. Conversely, the library tests a
factor of GTSAM, in a batch or an incremental adjustment.
"""

import gtsam
import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import disturb, look_at, measure
from factorgraph_adj.units import GON

PILLARS = {"A": (0.0, 0.0, 0.0), "B": (30.0, 2.0, 0.5), "C": (14.0, 26.0, 1.0)}
NEW = {"P": (12.0, 9.0, 2.0), "Q": (17.0, 13.0, 3.0), "R": (15.0, 5.0, 1.0)}
CAMERAS = {"1": np.array([4.0, -12.0, 3.0]), "2": np.array([27.0, -10.0, 4.0])}

plan = fga.Network("three pillars, two photos")
for name, xyz in PILLARS.items():
    plan.add_point(name, xyz, fixed="xyz")
for name, xyz in NEW.items():
    plan.add_point(name, xyz)
    for pillar in PILLARS:
        plan.add(
            SlopeDistance(pillar, name, 0.0, sigma=0.002),
            ZenithAngle(pillar, name, 0.0, sigma=0.001 * GON),
        )
plan.add_camera("camera", BrownLens(), {"c": 35.0}, sigma={"c": 0.02})
for name, at in CAMERAS.items():
    plan.add_photo(name, "camera", position=at, rotation=look_at(at, np.array([15.0, 9.0, 1.5])))
    plan.add_image_points(name, [*PILLARS, *NEW], np.zeros((6, 2)), sigma=0.004)
network = disturb(measure(plan, seed=4), seed=4, points=0.05, centres=0.1, attitudes=0.005)

# %%
# GTSAM alone.
built = fga.build_graph(network)
print(f"{built.graph.size()} factors, {built.values.size()} variables, ½ vᵀPv {built.error:.1f}")
parameters = gtsam.LevenbergMarquardtParams()
parameters.setRelativeErrorTol(1e-14)
parameters.setAbsoluteErrorTol(1e-14)
optimiser = gtsam.LevenbergMarquardtOptimizer(built.graph, built.values, parameters)
values = optimiser.optimize()
marginals = gtsam.Marginals(built.graph, values)

# %%
# The library, compared with GTSAM.
solution = fga.adjust(network)
print(f"{'':12}{'GTSAM':>14}{'fga.adjust':>14}{'difference':>14}")
print(f"{'iterations':12}{optimiser.iterations():14}{solution.iterations:14}")
ours, theirs = solution.vtpv, 2 * optimiser.error()
print(f"{'vᵀPv':12}{theirs:14.6f}{ours:14.6f}{theirs - ours:14.1e}")
for name in NEW:
    key = built.keys.key("point", name)
    at, sigma = values.atPoint3(key), np.sqrt(np.diag(marginals.marginalCovariance(key)))
    for axis, g, f in zip("xyz", at, solution.point(name), strict=True):
        print(f"{f'{name} {axis}, m':12}{g:14.6f}{f:14.6f}{g - f:14.1e}")
    ours = 1e3 * solution.standard_deviations(name)
    for axis, g, f in zip("xyz", 1e3 * sigma, ours, strict=True):
        print(f"{f'{name} σ{axis}, mm':12}{g:14.6f}{f:14.6f}{g - f:14.1e}")
scale = built.keys.scale("calibration", "camera")[0]
g = scale * values.atVector(built.keys.key("calibration", "camera"))[0]
print(f"{'c, mm':12}{g:14.6f}{(f := solution.calibration('camera')['c']):14.6f}{g - f:14.1e}")

# %%
# A factor of GTSAM among the observations: a taped distance, in batch and incremental adjustment.
tape = {
    "tape": lambda key: gtsam.RangeFactor3(
        key("point", "P"), key("point", "Q"), 6.484, gtsam.noiseModel.Isotropic.Sigma(1, 0.002)
    )
}
tested = fga.reliability(fga.adjust(network, extra_factors=tape)).factor("tape")
(verdict,) = fga.IncrementalAdjustment(network).add(factors=tape).verdicts
print(f"tape: batch w {tested.w[0]:.3f}, on arrival w {verdict.w[0]:.3f}, {verdict.verdict}")
